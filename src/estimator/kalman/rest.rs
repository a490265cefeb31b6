//! Whether the sensor rests: what it reads has not changed for a while, and is about one g.
//!
//! Rest can be mimicked by steady motion, so nobody has to believe it: the filter takes what rest
//! would show only as far as its covariance allows.

use super::LARGEST_BIAS_RAD_S;
use super::tuning::Tuning;
use crate::attitude::Vector3;
use crate::state::Exchange;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Readings are compared with their average over this time, s.
const AVERAGING_TIME_S: f32 = 0.5;

/// At first there is nothing to compare with: so long, s, it is a plain average of what there was, and what the
/// sensor's own filter makes of its start, the first sample or two, does not count as motion.
const FIRST_AVERAGE_S: f32 = 0.07;

/// So long without motion is a moment, s.
const STILL_S: f32 = 0.3;

/// How far one g may seem off: 80 mg of offset and 3 % of scale (product specification §6.2).
const GRAVITY_TOLERANCE: f32 = 0.12;

/// The watch.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Rest {
    average_rate_rad_s: Vector3,
    average_force_m_s2: Vector3,
    /// How long nothing has moved; during the first average, how long it has lasted, negative.
    quiet_s: f32,
}

impl Rest {
    pub(super) fn exchange(&mut self, state: &mut impl Exchange) {
        state.vector(&mut self.average_rate_rad_s);
        state.vector(&mut self.average_force_m_s2);
        state.number(&mut self.quiet_s);
    }

    pub(super) const fn new() -> Self {
        Self {
            average_rate_rad_s: Vector3::ZERO,
            average_force_m_s2: Vector3::ZERO,
            quiet_s: 0.0,
        }
    }

    /// Starts from one sample's readings.
    pub(super) fn begin(&mut self, rate_rad_s: Vector3, force_m_s2: Vector3) {
        *self = Self {
            average_rate_rad_s: rate_rad_s,
            average_force_m_s2: force_m_s2,
            quiet_s: -f32::MIN_POSITIVE,
        };
    }

    /// The rates to come are higher by this, rad/s, though nothing turns.
    pub(super) fn shift(&mut self, change_rad_s: Vector3) {
        self.average_rate_rad_s = self.average_rate_rad_s + change_rad_s;
    }

    /// Takes a sample's readings, `duration_s` after the one that it took before.
    pub(super) fn update(
        &mut self,
        rate_rad_s: Vector3,
        force_m_s2: Vector3,
        duration_s: f32,
        tuning: &Tuning,
    ) {
        let rate = rate_rad_s - self.average_rate_rad_s;
        let force = force_m_s2 - self.average_force_m_s2;
        let is_first = self.quiet_s < 0.0;
        let averaged_s = if is_first {
            duration_s - self.quiet_s
        } else {
            AVERAGING_TIME_S
        };
        let share = (duration_s / averaged_s).min(1.0);
        self.average_rate_rad_s = self.average_rate_rad_s + rate.scale(share);
        self.average_force_m_s2 = self.average_force_m_s2 + force.scale(share);
        if is_first {
            self.quiet_s = if averaged_s < FIRST_AVERAGE_S {
                -averaged_s
            } else {
                averaged_s
            };
            return;
        }
        let is_quiet = rate.dot(rate) < tuning.rest_rate_rad_s * tuning.rest_rate_rad_s
            && force.dot(force) < tuning.rest_force_m_s2 * tuning.rest_force_m_s2;
        self.quiet_s = if is_quiet {
            self.quiet_s + duration_s
        } else {
            0.0
        };
    }

    /// Whether nothing has moved for a moment.
    pub(super) fn is_still(&self) -> bool {
        self.quiet_s > STILL_S
    }

    /// The mean readings of gyroscope and accelerometer if the sensor rests.
    pub(super) fn readings(&self, tuning: &Tuning) -> Option<(Vector3, Vector3)> {
        const LEAST: f32 = (1.0 - GRAVITY_TOLERANCE) * STANDARD_GRAVITY_M_S2;
        const GREATEST: f32 = (1.0 + GRAVITY_TOLERANCE) * STANDARD_GRAVITY_M_S2;
        let force = self.average_force_m_s2;
        let squared = force.dot(force);
        let is_gravity = squared > LEAST * LEAST && squared < GREATEST * GREATEST;
        // A faster steady turn is none: no offset is so large.
        let is_offset = self.average_rate_rad_s.is_within(LARGEST_BIAS_RAD_S);
        (self.quiet_s > tuning.rest_after_s && is_gravity && is_offset)
            .then_some((self.average_rate_rad_s, force))
    }
}
