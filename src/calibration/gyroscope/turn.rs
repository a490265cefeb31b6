//! Integral of the rates from one stationary pose to the next.

use super::super::matrix::Matrix3;
use super::super::noise::NoiseModel;
use super::super::stationary::StationaryMean;
use crate::attitude::Vector3;
use crate::units::{SECONDS_PER_MICROSECOND, radians};

/// Longest time between two samples of a turn, µs. The rates may change unseen in a longer one.
const LONGEST_STEP_US: u64 = 25_000;
/// Trace of a rotation by 30°. A smaller turn shows the error of the poses, not of the rates.
const SMALLEST_TURN_TRACE: f32 = 2.732;
/// Largest sum of the angles turned, rad: beyond two full circles the error is no longer small.
const LONGEST_PATH_RAD: f32 = radians(720.0);

/// Turn between two stationary poses, in sensor axes.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Turn {
    /// Mean accelerometer reading of the pose before, g, not corrected.
    pub(super) start: Vector3,
    /// Mean accelerometer reading of the pose after, g, not corrected.
    pub(super) end: Vector3,
    /// Integral of the measured rates.
    pub(super) integral: Integral,
}

/// Integral of rates.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Integral {
    /// Columns R_j of the rotation from the present axes to those at the start.
    columns: [Vector3; 3],
    /// Integrals ∫R_j·ω_l dt, rad, at `[j][l]`.
    pub(super) effects: [[Vector3; 3]; 3],
    /// Integrals ∫R_j dt, s: the effect of an offset.
    offset_effects: [Vector3; 3],
    path_rad: f32,
}

impl Integral {
    const START: Self = Self {
        columns: Matrix3::IDENTITY.rows,
        effects: [[Vector3::ZERO; 3]; 3],
        offset_effects: [Vector3::ZERO; 3],
        path_rad: 0.0,
    };

    /// Adds a step with this mean rate.
    fn add(&mut self, rate_rad_s: Vector3, step_s: f32) {
        let angle = rate_rad_s.scale(step_s);
        let turn = self.at_start(angle);
        for (j, column) in self.columns.iter_mut().enumerate() {
            // The series of the rotation to third order: 4e-6 rad wrong in a step of 0.1 rad.
            let half = turn.cross(*column).scale(0.5);
            let square = turn.cross(half);
            let half_way = *column + half;
            *column = half_way + half + square + turn.cross(square).scale(1.0 / 3.0);
            if let (Some([x, y, z]), Some(offset)) =
                (self.effects.get_mut(j), self.offset_effects.get_mut(j))
            {
                *x = *x + half_way.scale(angle.x);
                *y = *y + half_way.scale(angle.y);
                *z = *z + half_way.scale(angle.z);
                *offset = *offset + half_way.scale(step_s);
            }
        }
        self.path_rad += angle.norm();
    }

    /// Removes an offset of the rates, rad/s.
    fn remove_offset(&mut self, Vector3 { x, y, z }: Vector3) {
        let [by_x, by_y, by_z] = self.offset_effects;
        let wrong_rad = by_x.scale(x) + by_y.scale(y) + by_z.scale(z);
        for column in &mut self.columns {
            *column = *column - wrong_rad.cross(*column);
        }
    }

    /// Turns a vector from the present axes to those at the start.
    pub(super) fn at_start(&self, Vector3 { x, y, z }: Vector3) -> Vector3 {
        let [by_x, by_y, by_z] = self.columns;
        by_x.scale(x) + by_y.scale(y) + by_z.scale(z)
    }

    /// Returns whether the integral is a turn of 30° at least, without much to and fro.
    fn is_turn(&self) -> bool {
        let [x, y, z] = self.columns;
        x.x + y.y + z.z < SMALLEST_TURN_TRACE && self.path_rad < LONGEST_PATH_RAD
    }
}

/// Integrates the rates between stationary poses.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TurnIntegrator {
    rad_s_per_count: f32,
    g_per_count: f32,
    /// Pose before the turn; `None` before the first one, and after a gap or a full-scale reading.
    start: Option<StationaryMean>,
    last_us: Option<u64>,
    /// Last rate without the offset of the pose before the turn, rad/s.
    rate_rad_s: Vector3,
    integral: Integral,
}

impl TurnIntegrator {
    /// Creates an integrator that waits for its first pose, for readings of this scale.
    pub fn new(noise: &NoiseModel) -> Self {
        Self {
            rad_s_per_count: radians(1.0) / noise.counts_per_degree_s,
            g_per_count: 1.0 / noise.counts_per_g,
            start: None,
            last_us: None,
            rate_rad_s: Vector3::ZERO,
            integral: Integral::START,
        }
    }

    /// Returns whether it waits for a pose: before the first one, and after a gap or a full-scale
    /// reading.
    pub const fn is_waiting(&self) -> bool {
        self.start.is_none()
    }

    /// Adds a reading of the gyroscope, counts about sensor x, y, z, at `t_us` of any clock.
    ///
    /// After a gap of more than 25 ms or a full-scale reading the turn is unknown, and
    /// [`finish`](Self::finish) returns `None`.
    pub fn update(&mut self, gyroscope: [i16; 3], t_us: u64) {
        let Some(start) = &self.start else {
            return;
        };
        let [x, y, z] = gyroscope.map(f32::from);
        let reading = Vector3::new(x, y, z);
        let rate_rad_s = (reading - start.gyroscope_counts).scale(self.rad_s_per_count);
        let last_us = self.last_us.replace(t_us).unwrap_or(t_us);
        let before_rad_s = core::mem::replace(&mut self.rate_rad_s, rate_rad_s);
        // A time that goes back gives a long step.
        let step_us = t_us.wrapping_sub(last_us);
        if step_us > LONGEST_STEP_US || !reading.is_within(f32::from(i16::MAX) - 1.0) {
            self.start = None;
            return;
        }
        let mean_rad_s = (before_rad_s + rate_rad_s).scale(0.5);
        let step_s = step_us as f32 * SECONDS_PER_MICROSECOND;
        self.integral.add(mean_rad_s, step_s);
    }

    /// Ends the turn in this pose, from which the next turn starts.
    ///
    /// Returns `None` if it is the first pose, if readings are missing or at full scale, if the
    /// sensor turned by less than 30°, or if it turned to and fro by more than 720°.
    pub fn finish(&mut self, at_rest: &StationaryMean) -> Option<Turn> {
        let start = self.start.replace(*at_rest);
        let mut integral = core::mem::replace(&mut self.integral, Integral::START);
        self.last_us = None;
        self.rate_rad_s = Vector3::ZERO;
        let start = start?;
        // The offset depends on the pose: half of its change is the mean over the turn.
        let change = at_rest.gyroscope_counts - start.gyroscope_counts;
        integral.remove_offset(change.scale(0.5 * self.rad_s_per_count));
        integral.is_turn().then(|| Turn {
            start: start.accelerometer_counts.scale(self.g_per_count),
            end: at_rest.accelerometer_counts.scale(self.g_per_count),
            integral,
        })
    }
}
