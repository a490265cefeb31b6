//! Sums of one interval: from the begin of a covariance step of the tilt filter to that of the
//! next.

use super::tuning::HeadingTuning;
use crate::attitude::Quaternion;
use crate::estimator::arithmetic::{larger, smaller, square};
use crate::estimator::kalman::Kalman;
use crate::estimator::kalman::heading_access::GYROSCOPE;
use crate::serialize::StateVisitor;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Sums of an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct FieldInterval {
    /// Sum of the readings in level axes, µT; z of the measurement once averaged.
    pub(super) field_ut: [f32; 3],
    /// Sum of the rotation matrices at the readings, by rows; W of the measurement once averaged.
    pub(super) rotation: [[f32; 3]; 3],
    /// Number of readings.
    pub(super) readings: f32,
    /// ψ, the effect of each gyroscope parameter on yaw: ∫R_down dt, and ∫R_down,j·ω_l dt.
    pub(super) yaw: [f32; GYROSCOPE],
    /// Length, s.
    pub(super) duration_s: f32,
    /// ∫|ω|² dt, rad²/s.
    pub(super) squared_rate: f32,
    /// ∫|acceleration|² dt, m²/s³.
    pub(super) squared_acceleration: f32,
    /// Yaw variance of unobserved motion, rad².
    pub(super) unseen_rad2: f32,
}

/// Two intervals: the open one collects sums; the closed one is that of the step under way.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct IntervalPair([FieldInterval; 2]);

/// `open` is the place of the open interval, 0 or 1.
impl IntervalPair {
    /// Two intervals of no length.
    pub(super) const EMPTY: Self = Self([FieldInterval::EMPTY; 2]);

    /// Returns the open interval.
    #[inline]
    pub(super) fn open(&self, open: u8) -> &FieldInterval {
        let [first, second] = &self.0;
        if open == 0 { first } else { second }
    }

    /// Returns the open interval, for changes.
    #[inline]
    pub(super) fn open_mut(&mut self, open: u8) -> &mut FieldInterval {
        let [first, second] = &mut self.0;
        if open == 0 { first } else { second }
    }

    /// Returns the closed interval.
    #[inline]
    pub(super) fn closed(&self, open: u8) -> &FieldInterval {
        let [first, second] = &self.0;
        if open == 0 { second } else { first }
    }

    /// Returns the closed interval, for changes.
    #[inline]
    pub(super) fn closed_mut(&mut self, open: u8) -> &mut FieldInterval {
        let [first, second] = &mut self.0;
        if open == 0 { second } else { first }
    }

    /// Visits both intervals.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        for interval in &mut self.0 {
            interval.visit_state(visitor);
        }
    }
}

impl FieldInterval {
    /// Interval of no length.
    pub(super) const EMPTY: Self = Self {
        field_ut: [0.0; 3],
        rotation: [[0.0; 3]; 3],
        readings: 0.0,
        yaw: [0.0; GYROSCOPE],
        duration_s: 0.0,
        squared_rate: 0.0,
        squared_acceleration: 0.0,
        unseen_rad2: 0.0,
    };

    /// Adds an earth step of this length, which has just ended.
    pub(super) fn add_earth_step(&mut self, kalman: &Kalman, t: f32) {
        let down = kalman.attitude_at_earth_step().down_in_body();
        let rate = kalman.rate_rad_s();
        let force = kalman.force_m_s2();
        self.duration_s += t;
        self.squared_rate += rate.dot(rate) * t;
        // |R·f + g|² without the rotation.
        let g = STANDARD_GRAVITY_M_S2;
        let squared = force.dot(force) + 2.0 * g * down.dot(force) + g * g;
        self.squared_acceleration += larger(squared, 0.0) * t;
        let [x, y, z, matrix @ ..] = &mut self.yaw;
        let (rows, _) = matrix.as_chunks_mut::<3>();
        for ((bias, row), down) in [x, y, z]
            .into_iter()
            .zip(rows)
            .zip([down.x, down.y, down.z])
        {
            let share = down * t;
            *bias += share;
            row[0] += share * rate.x;
            row[1] += share * rate.y;
            row[2] += share * rate.z;
        }
    }

    /// Adds a reading, whose motion was `age_s` before that of the last sample.
    pub(super) fn add_reading(&mut self, kalman: &Kalman, [mx, my, mz]: [f32; 3], age_s: f32) {
        // A rotation of 2·atan(φ/2): for φ = 0.2 rad it is short by 0.04°.
        let half = kalman.rotation_since_earth_step(age_s).scale(0.5);
        let rotation = Quaternion::new(1.0, half.x, half.y, half.z);
        let attitude = kalman.attitude_at_earth_step().multiply(rotation);
        let rows = attitude.matrix_rows(1.0 + half.dot(half));
        for ((sum, rotation), row) in self.field_ut.iter_mut().zip(&mut self.rotation).zip(rows) {
            *sum += row.x * mx + row.y * my + row.z * mz;
            rotation[0] += row.x;
            rotation[1] += row.y;
            rotation[2] += row.z;
        }
        self.readings += 1.0;
    }

    /// Turns the sums of the readings into means.
    pub(super) fn average_readings(&mut self) {
        if self.readings > 0.0 {
            let share = 1.0 / self.readings;
            let sums = self.rotation.as_flattened_mut().iter_mut();
            for sum in sums.chain(&mut self.field_ut) {
                *sum *= share;
            }
        }
    }

    /// Returns whether there was a reading.
    pub(super) fn has_readings(&self) -> bool {
        self.readings > 0.0
    }

    /// Returns how much the body moved: 0 at rest, at most 1. Turns and accelerations add as
    /// squares; in the prototype (see `tuning.rs`) they add as they are.
    pub(super) fn motion(&self, tuning: &HeadingTuning) -> f32 {
        let inverse = 1.0 / self.duration_s;
        let rate = self.squared_rate * inverse / square(tuning.moving_rate_rad_s);
        let acceleration =
            self.squared_acceleration * inverse / square(tuning.moving_acceleration_m_s2);
        libm::sqrtf(smaller(rate + acceleration, 1.0))
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            field_ut,
            rotation,
            readings,
            yaw,
            duration_s,
            squared_rate,
            squared_acceleration,
            unseen_rad2,
        } = self;
        visitor.f32s(field_ut);
        visitor.f32s(rotation.as_flattened_mut());
        visitor.f32(readings);
        visitor.f32s(yaw);
        visitor.f32(duration_s);
        visitor.f32(squared_rate);
        visitor.f32(squared_acceleration);
        visitor.f32(unseen_rad2);
    }
}
