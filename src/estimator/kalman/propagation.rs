//! Propagation of the error state over an interval: its transition, and the noise that it adds.
//!
//! An interval lasts from one covariance step to the next. The nominal state is integrated through
//! it, and these sums accumulate with it. They propagate the covariance over the whole interval at
//! once.

use super::recovery::ForceSum;
use crate::attitude::Vector3;
use crate::serialize::StateVisitor;

/// Dynamic states, which change by themselves: tilt about north and east, velocity to north and
/// east.
pub(super) const DYNAMIC: usize = 4;
pub(super) const TILT_NORTH: usize = 0;
pub(super) const TILT_EAST: usize = 1;
pub(super) const VELOCITY_NORTH: usize = 2;
pub(super) const VELOCITY_EAST: usize = 3;
/// Parameter states of the sensor: gyroscope bias (3), gyroscope matrix by rows (9), accelerometer
/// bias (3).
pub(super) const PARAMETERS: usize = 15;
/// The gyroscope's parameters, which come first. The accelerometer's bias is the rest.
pub(super) const GYROSCOPE_PARAMETERS: usize = 12;

/// A state of the filter.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) enum State {
    /// A dynamic state, by index.
    Dynamic(usize),
    /// A parameter, by index.
    Parameter(usize),
}

/// The error's transition over an interval: `dynamic ← A·dynamic − B·parameters`.
///
/// The parameters stay, so F = [A, −B; 0, I].
///
/// A is the identity but for the velocity error that a tilt error gathers under the specific force.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Transition {
    /// The tilt rows of B: effect of each gyroscope parameter on the tilt error, north and east.
    ///
    /// The first three entries are ∫R dt, the upper two rows of the rotation matrix. They are the
    /// velocity rows of B for the accelerometer's bias as well.
    pub(super) tilt: [[f32; 2]; GYROSCOPE_PARAMETERS],
    /// The off-diagonal entry of A: ∫f_down dt, m/s. About −g times the interval.
    pub(super) down_m_s: f32,
}

impl Transition {
    /// Transition of an empty interval.
    pub(super) const IDENTITY: Self = Self {
        tilt: [[0.0; 2]; GYROSCOPE_PARAMETERS],
        down_m_s: 0.0,
    };

    /// Returns the entries of B for a parameter, north and east.
    pub(super) fn effect(&self, parameter: usize) -> Effect {
        if let Some(entries) = self.tilt.get(parameter) {
            return Effect::Tilt(*entries);
        }
        let axis = parameter.wrapping_sub(GYROSCOPE_PARAMETERS);
        Effect::Velocity(self.tilt.get(axis).copied().unwrap_or([0.0; 2]))
    }

    /// Propagates an error: `dynamic ← A·dynamic − B·parameters`.
    pub(super) fn apply(&self, dynamic: &mut [f32; DYNAMIC], parameters: &[f32; PARAMETERS]) {
        let [mut north, mut east] = [0.0; 2];
        for (b, parameter) in self.tilt.iter().zip(parameters) {
            north += b[0] * parameter;
            east += b[1] * parameter;
        }
        let [mut north_m_s, mut east_m_s] = [0.0; 2];
        for (b, parameter) in self.tilt.iter().zip(&parameters[GYROSCOPE_PARAMETERS..]) {
            north_m_s += b[0] * parameter;
            east_m_s += b[1] * parameter;
        }
        dynamic[2] += self.down_m_s * dynamic[1] - north_m_s;
        dynamic[3] -= self.down_m_s * dynamic[0] + east_m_s;
        dynamic[0] -= north;
        dynamic[1] -= east;
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self { tilt, down_m_s } = self;
        visitor.f32s(tilt.as_flattened_mut());
        visitor.f32(down_m_s);
    }
}

/// Dynamic states that a parameter's error affects, per unit, with entries for north and east.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Effect {
    /// Tilt, affected by the parameters of the gyroscope.
    Tilt([f32; 2]),
    /// Velocity, affected by the accelerometer's bias.
    Velocity([f32; 2]),
}

/// Sums since the last covariance step began.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Interval {
    /// The error's transition.
    pub(super) transition: Transition,
    /// Change of the horizontal velocity, north and east.
    pub(super) velocity_change_m_s: [f32; 2],
    /// Length of the interval.
    pub(super) duration_s: f32,
    /// ∫|ω|² dt, rad²/s.
    pub(super) squared_rate: f32,
    /// Tilt variance of unobserved motion, per axis, rad².
    pub(super) unseen_tilt_rad2: f32,
    /// Velocity variance of unobserved motion, per axis, (m/s)².
    pub(super) unseen_velocity_m2_s2: f32,
}

impl Interval {
    /// Interval of no length.
    pub(super) const EMPTY: Self = Self {
        transition: Transition::IDENTITY,
        velocity_change_m_s: [0.0; 2],
        duration_s: 0.0,
        squared_rate: 0.0,
        unseen_tilt_rad2: 0.0,
        unseen_velocity_m2_s2: 0.0,
    };

    /// Returns the sum of the specific force without bias.
    pub(super) fn force_sum(&self) -> ForceSum {
        let [north, east] = self.velocity_change_m_s;
        ForceSum {
            integral_m_s: Vector3::new(north, east, self.transition.down_m_s),
            duration_s: self.duration_s,
        }
    }

    /// Returns whether the mean force may not be the true one: readings were clipped, or a pause
    /// hid them.
    pub(super) fn hides_force(&self) -> bool {
        self.unseen_velocity_m2_s2 > 0.0
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            transition,
            velocity_change_m_s,
            duration_s,
            squared_rate,
            unseen_tilt_rad2,
            unseen_velocity_m2_s2,
        } = self;
        transition.visit_state(visitor);
        visitor.f32s(velocity_change_m_s);
        visitor.f32(duration_s);
        visitor.f32(squared_rate);
        visitor.f32(unseen_tilt_rad2);
        visitor.f32(unseen_velocity_m2_s2);
    }
}
