//! Gate in front of every filter: checks each sample, and measures the time since the previous one.

use super::sample::{Issues, Sample};
use crate::serialize::StateVisitor;
use crate::units::{SECONDS_PER_MICROSECOND, STANDARD_GRAVITY_M_S2, radians};

/// Longest step that a filter bridges, in µs. After a longer one the motion in between is unknown.
pub const LONGEST_STEP_US: u64 = 500_000;

/// Smallest specific force that shows where down is, in m/s²: a quarter of gravity. Below it the
/// accelerometer's offset (80 mg, product specification §6.2) may turn its direction by 20° and
/// more.
pub const LEAST_SPECIFIC_FORCE_M_S2: f32 = 0.25 * STANDARD_GRAVITY_M_S2;

/// Largest increase of the rate from one sample to the next beyond a doubling, in rad/s: 50 °/s. No
/// airframe gains as much in a millisecond. A changed full scale does, and so does a blow to the
/// sensor.
const RATE_JUMP_RAD_S: f32 = radians(50.0);

/// Beyond these limits a sample is no measurement: no sensor of this family reaches a tenth of
/// them.
const LARGEST_SPECIFIC_FORCE_M_S2: f32 = 10_000.0;
const LARGEST_RATE_RAD_S: f32 = 1_000.0;

/// Action of the filter on a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    /// Holds the attitude.
    Hold,
    /// Starts from the sample, which is the first one or the first after a gap.
    Start,
    /// Advances by a time step.
    Advance {
        /// Time since the previous sample in seconds, from 1 µs to [`LONGEST_STEP_US`].
        dt_s: f32,
    },
}

/// Gate: time and rate of the last accepted sample.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Gate {
    last_t_us: Option<u64>,
    rate_squared: f32,
}

impl Gate {
    /// Creates a gate without a sample.
    pub(super) const fn new() -> Self {
        Self {
            last_t_us: None,
            rate_squared: 0.0,
        }
    }

    /// Time of the last accepted sample, in µs.
    pub(super) const fn last_t_us(&self) -> Option<u64> {
        self.last_t_us
    }

    /// Forgets the last sample's time, so that the next sample starts the filter.
    pub(super) const fn reset(&mut self) {
        self.last_t_us = None;
    }

    /// Checks a sample. Returns the filter's action and the issues found.
    #[inline]
    pub(super) fn check(&mut self, sample: &Sample) -> (Step, Issues) {
        let force = sample.specific_force_m_s2;
        let rate = sample.angular_rate_rad_s;
        let (force_squared, rate_squared) = (force.dot(force), rate.dot(rate));
        // A NaN fails every comparison.
        let is_measurement = force_squared <= square(LARGEST_SPECIFIC_FORCE_M_S2)
            && rate_squared <= square(LARGEST_RATE_RAD_S);
        if !is_measurement {
            return (Step::Hold, Issues::REJECTED);
        }
        let mut issues = Issues::empty();
        if force_squared < square(LEAST_SPECIFIC_FORCE_M_S2) {
            issues |= Issues::NO_GRAVITY;
        }
        if rate_squared > 4.0 * self.rate_squared + square(RATE_JUMP_RAD_S) {
            issues |= Issues::RATE_JUMP;
        }
        self.rate_squared = rate_squared;
        let Some(last_t_us) = self.last_t_us.replace(sample.t_us) else {
            return (Step::Start, issues);
        };
        if sample.t_us <= last_t_us {
            return (Step::Hold, issues | Issues::TIME_WENT_BACK);
        }
        let step_us = sample.t_us - last_t_us;
        if step_us > LONGEST_STEP_US {
            return (Step::Start, issues | Issues::GAP);
        }
        let dt_s = step_us as u32 as f32 * SECONDS_PER_MICROSECOND;
        (Step::Advance { dt_s }, issues)
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.optional(&mut self.last_t_us, 0, StateVisitor::u64);
        visitor.f32(&mut self.rate_squared);
    }
}

const fn square(number: f32) -> f32 {
    number * number
}
