//! A reset of the core in flight: samples are missing, and the pipeline continues from the state
//! that RAM has kept.

use aplomb::estimator::kalman::WarmStart;
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb_models::random::Random;

use crate::heading_promise::{KEEP_US, after_reset};

/// A reset.
pub struct Reset {
    from_us: u64,
    until_us: u64,
    kept: Option<WarmStart>,
    is_over: bool,
}

/// Draws the time for which a reset stops the samples, µs: the watchdog's limit, or a crash.
pub fn duration_us(random: &mut Random) -> u64 {
    let is_hang = random.uniform(0.0, 1.0) < 0.7;
    let (shortest, longest) = if is_hang {
        (2.0e5, 5.6e5)
    } else {
        (4.0e3, 6.0e3)
    };
    random.uniform(shortest, longest) as u64
}

impl Reset {
    /// A reset at this time.
    pub fn at(from_us: u64, random: &mut Random) -> Self {
        Self {
            from_us,
            until_us: from_us + duration_us(random),
            kept: None,
            is_over: false,
        }
    }

    /// Returns whether the core misses a sample of this time. Before the first sample after the
    /// reset, it replaces the pipeline by one that continues from the kept state.
    pub fn skip_or_resume(
        &mut self,
        t_us: u64,
        pipeline: &mut Pipeline,
        settings: &Settings,
    ) -> bool {
        if t_us >= self.until_us && !self.is_over {
            self.is_over = true;
            *pipeline = Pipeline::new(settings);
            if let Some(kept) = self.kept {
                pipeline.resume(&after_reset(kept), self.until_us - 1);
            }
        }
        (self.from_us..self.until_us).contains(&t_us)
    }

    /// Keeps the state as the firmware does.
    pub fn keep(&mut self, t_us: u64, pipeline: &Pipeline, snapshot: &Snapshot) {
        if t_us < self.from_us && t_us.is_multiple_of(KEEP_US) {
            self.kept = pipeline.warm_start(snapshot);
        }
    }

    /// Returns whether the reset has ended by this time.
    pub fn has_ended(&self, t_us: u64) -> bool {
        t_us >= self.until_us
    }
}
