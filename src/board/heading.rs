//! Heading beside the attitude: the filter, and its published estimate.
//!
//! The attitude task publishes the attitude first. Then the filter follows, and a new estimate is
//! published, about five times a second. Deadline: that of the attitude task. No attitude waits
//! for it. Without a reading of a compass the filter does not run, and a sample costs the check of
//! two flags.
//!
//! # Publication
//!
//! A debugger reads the symbol `APLOMB_HEADING`. Its content is words of four bytes:
//!
//! | offset | content |
//! |---|---|
//! | 0 | time of the sample at which the estimate changed, µs, low word first; 0: not running |
//! | 8 | heading minus yaw, rad, as `f32`; the heading is from true north with a declination |
//! | 12 | σ of the heading, rad, as `f32` |
//! | 16 | 0: unknown, 1: known, 3: known and valid while the attitude is valid |
//! | 20 | number of publications |
//!
//! The attitude task alone writes it (`publication.rs`).

use core::sync::atomic::{AtomicU32, Ordering};

use super::publication::Publication;
use crate::estimator::heading::{CompassKnowledge, Heading, HeadingEstimate};
use crate::pipeline::Pipeline;
use crate::units::MagneticField;

/// Bits of the published state.
const KNOWN: u32 = 1;
const VALID: u32 = 2;

/// Heading filter, and the publication of its estimate.
pub struct HeadingPublisher {
    filter: Heading,
    /// Number of the estimate that was published.
    published: u8,
}

impl HeadingPublisher {
    /// Creates the publisher. The filter waits for a reading.
    pub fn new(knowledge: CompassKnowledge) -> Self {
        let filter = Heading::new(knowledge);
        Self {
            published: filter.changes(),
            filter,
        }
    }

    /// Returns whether the filter needs each sample.
    pub const fn is_running(&self) -> bool {
        self.filter.is_running()
    }

    /// Updates the filter with the last sample. Call it after each update of the pipeline.
    #[inline(always)]
    pub fn update(&mut self, pipeline: &Pipeline) {
        if self.is_running() {
            pipeline.update_heading(&mut self.filter);
            if self.filter.changes() != self.published {
                self.publish(pipeline);
            }
        }
    }

    /// Returns the filter; `None` while it waits for a reading.
    pub const fn filter(&self) -> Option<&Heading> {
        if self.is_running() {
            Some(&self.filter)
        } else {
            None
        }
    }

    /// Adds a reading that was measured at this time on the microsecond timer. Returns whether the
    /// filter starts with it.
    #[inline(never)]
    pub fn add_reading(
        &mut self,
        pipeline: &Pipeline,
        field: MagneticField,
        measured_us: u32,
    ) -> bool {
        let was_running = self.is_running();
        let age_us = pipeline.reading_age_us(measured_us);
        self.filter.add_field(field, age_us);
        !was_running && self.is_running()
    }

    /// Starts the filter again with this knowledge and declination (rad), and publishes that no
    /// heading is known. This takes some 25 µs, so it is for commands, not for the attitude task.
    pub fn restart(&mut self, knowledge: CompassKnowledge, declination_rad: f32) {
        if self.is_running() {
            store(0, None);
        }
        *self = Self::new(knowledge);
        self.set_declination(declination_rad);
    }

    /// Turns the heading to this declination, rad. The next sample publishes it.
    pub fn set_declination(&mut self, declination_rad: f32) {
        self.filter.set_declination(declination_rad);
    }

    #[inline(never)]
    fn publish(&mut self, pipeline: &Pipeline) {
        self.published = self.filter.changes();
        store(pipeline.sample().t_us, self.filter.estimate());
    }
}

/// Words of an estimate.
const WORDS: usize = 5;

/// Latest estimate. A debugger reads it by this symbol.
#[unsafe(no_mangle)]
static APLOMB_HEADING: Publication<WORDS> = Publication::new();

/// Publishes an estimate. Only the attitude task, or a task that holds its lock, calls this.
fn store(t_us: u64, estimate: Option<HeadingEstimate>) {
    let (offset_rad, sigma_rad, state) = match estimate {
        None => (0.0, 0.0, 0),
        Some(estimate) => (
            estimate.yaw_offset_rad,
            estimate.sigma_rad,
            KNOWN | if estimate.is_valid { VALID } else { 0 },
        ),
    };
    let store = |place: &AtomicU32, word: u32| place.store(word, Ordering::Relaxed);
    APLOMB_HEADING.publish(|[low, high, offset, sigma, known]| {
        store(low, t_us as u32);
        store(high, (t_us >> 32) as u32);
        store(offset, offset_rad.to_bits());
        store(sigma, sigma_rad.to_bits());
        store(known, state);
    });
}

/// Returns the latest heading; `None` while it is unknown. Only for tasks of lower priority than
/// the attitude task.
pub fn latest() -> Option<HeadingEstimate> {
    latest_change()?.1
}

/// Returns the latest heading with the time of the sample at which it changed, µs; `None` before
/// the first publication. The time is 0 while the filter does not run. Only for tasks of lower
/// priority than the attitude task.
pub fn latest_change() -> Option<(u64, Option<HeadingEstimate>)> {
    let ([low, high, offset, sigma, state], _) = APLOMB_HEADING.latest()?;
    let t_us = u64::from(high) << 32 | u64::from(low);
    let estimate = (state & KNOWN != 0).then_some(HeadingEstimate {
        yaw_offset_rad: f32::from_bits(offset),
        sigma_rad: f32::from_bits(sigma),
        is_valid: state & VALID != 0,
    });
    Some((t_us, estimate))
}
