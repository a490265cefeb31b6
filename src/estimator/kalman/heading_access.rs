//! Read access for the [`heading`](crate::estimator::heading) filter.
//!
//! The heading filter has states of its own, and their cross-covariance with the error state of
//! this filter. It repeats on the cross-covariance what a covariance step does to the covariance.
//! It changes nothing here, so the attitude does not depend on it.
//!
//! Measurements of a step are repeated after the step, from its result P⁺. The heading filter has
//! the states f and the cross-covariance X; its module has a table of the symbols. Measurement i
//! has the value z_i, for the state x_i, and the variance r_i. With p_i = X·e_i before the step,
//!
//! ```text
//! X ← X − Σ_i p_i·(P⁺·e_i)ᵀ/r_i
//! f ← f + Σ_i p_i·(z_i − x_i − δ_i)/r_i
//! ```
//!
//! because S⁻¹·H·P = N⁻¹·H·P⁺, and S⁻¹·y = N⁻¹·(y − H·δ) (the gain in
//! terms of the covariance afterwards: Gelb, *Applied Optimal Estimation*, 1974, §4.2). There H
//! has the rows e_iᵀ, N the r_i on its diagonal, S is H·P·Hᵀ + N, and y has the z_i − x_i.

use super::prior::FIRST_WITH_PRIOR;
use super::propagation::{
    DYNAMIC, GYROSCOPE_PARAMETERS, PARAMETERS, State, TILT_EAST, TILT_NORTH, VELOCITY_EAST,
    VELOCITY_NORTH,
};
use super::slices::MOST_MEASUREMENTS;
use super::{Kalman, Tilt};
use crate::attitude::{Quaternion, Vector3};
use crate::estimator::arithmetic::square;

/// Number of error states: tilt (2), velocity (2), gyroscope bias (3) and matrix (9), accelerometer
/// bias (3). The heading filter needs all of them. The errors of tilt and accelerometer bias mostly
/// cancel in the velocity. Without the bias, each measured velocity would shrink the covariance of
/// the heading filter by too much, until it is indefinite.
pub(in crate::estimator) const ERROR_STATES: usize = DYNAMIC + PARAMETERS;

/// Error states of the velocity.
pub(in crate::estimator) const VELOCITY: core::ops::Range<usize> = VELOCITY_NORTH..DYNAMIC;
/// First of the gyroscope's parameters among the error states.
pub(in crate::estimator) const FIRST_GYROSCOPE: usize = DYNAMIC;
/// Number of the gyroscope's parameters.
pub(in crate::estimator) const GYROSCOPE: usize = GYROSCOPE_PARAMETERS;
/// Most measurements of a covariance step.
pub(in crate::estimator) const MEASUREMENTS: usize = MOST_MEASUREMENTS;

/// Measurement of the last covariance step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::estimator) struct TiltMeasurement {
    /// The measured error state.
    pub(in crate::estimator) state: usize,
    /// 1/r, the inverse of the measurement's variance.
    pub(in crate::estimator) weight: f32,
    /// z − x − δ, what the step has left of the innovation.
    pub(in crate::estimator) residual: f32,
}

impl TiltMeasurement {
    /// Returns the measured parameter; `None` for the velocity.
    pub(in crate::estimator) fn parameter(self) -> Option<usize> {
        self.state.checked_sub(DYNAMIC)
    }
}

impl Kalman {
    /// Returns whether a tilt has been set, and by more than a single sample.
    #[inline]
    pub(in crate::estimator) fn has_tilt(&self) -> bool {
        self.tilt != Tilt::Unknown && !self.is_from_one_sample
    }

    /// Returns whether a covariance step is due or under way.
    #[inline]
    pub(in crate::estimator) fn is_step_pending(&self) -> bool {
        self.is_step_pending
    }

    /// Returns whether a covariance step is under way. Its result is not that of the state then.
    #[inline]
    pub(in crate::estimator) fn is_step_under_way(&self) -> bool {
        self.step.is_under_way()
    }

    /// Returns whether the last sample ended an earth step.
    #[inline]
    pub(in crate::estimator) fn is_at_earth_step(&self) -> bool {
        self.nominal.elapsed_s == 0.0
    }

    /// Returns the time since the last covariance step began, s.
    #[inline]
    pub(in crate::estimator) fn interval_s(&self) -> f32 {
        self.interval.duration_s
    }

    /// Returns the tilt variance of unobserved motion in the interval, per axis, rad².
    pub(in crate::estimator) fn unseen_tilt_rad2(&self) -> f32 {
        self.interval.unseen_tilt_rad2
    }

    /// Returns whether tilt and velocity have just been reset: they correlate with nothing.
    pub(in crate::estimator) fn are_tilt_and_velocity_reset(&self) -> bool {
        !self.step.is_under_way()
            && self.is_uncorrelated(TILT_NORTH)
            && self.is_uncorrelated(TILT_EAST)
    }

    /// Returns whether the velocity has been reset alone: it correlates with no parameter.
    pub(in crate::estimator) fn is_velocity_reset(&self) -> bool {
        VELOCITY
            .into_iter()
            .all(|state| self.is_uncorrelated(state))
    }

    /// Returns whether a dynamic state correlates with no axis of the gyroscope's bias. One axis
    /// alone says nothing: while it is exactly vertical, it turns neither tilt nor velocity.
    #[inline]
    fn is_uncorrelated(&self, state: usize) -> bool {
        (0..FIRST_WITH_PRIOR).all(|axis| self.step.covariance.cross_entry(axis, state) == 0.0)
    }

    /// Returns the attitude at the last earth step.
    #[inline]
    pub(in crate::estimator) fn attitude_at_earth_step(&self) -> Quaternion {
        self.nominal.attitude
    }

    /// Returns the rotation from the last earth step to `age_s` before the last sample, rad in body
    /// axes.
    #[inline]
    pub(in crate::estimator) fn rotation_since_earth_step(&self, age_s: f32) -> Vector3 {
        self.nominal.rotation_rad - self.nominal.rate_rad_s.scale(age_s)
    }

    /// Returns the last rate, rad/s.
    #[inline]
    pub(in crate::estimator) fn rate_rad_s(&self) -> Vector3 {
        self.nominal.rate_rad_s
    }

    /// Returns the last specific force without bias, m/s² in body axes.
    #[inline]
    pub(in crate::estimator) fn force_m_s2(&self) -> Vector3 {
        self.nominal.force_m_s2 - self.nominal.accelerometer_bias_m_s2
    }

    /// Returns the covariance of the tilt in rad²: north, north with east, east.
    pub(in crate::estimator) fn tilt_covariance(&self) -> [f32; 3] {
        self.step.covariance.tilt()
    }

    /// Adds the columns of the tilt, north and east, times these factors.
    pub(in crate::estimator) fn add_tilt_columns(
        &self,
        factors: [f32; 2],
        column: &mut [f32; ERROR_STATES],
    ) {
        self.add_dynamic_columns(TILT_NORTH, factors, column);
    }

    /// Adds the columns of the velocity, north and east, times these factors.
    pub(in crate::estimator) fn add_velocity_columns(
        &self,
        factors: [f32; 2],
        column: &mut [f32; ERROR_STATES],
    ) {
        self.add_dynamic_columns(VELOCITY.start, factors, column);
    }

    #[inline(never)]
    fn add_dynamic_columns(
        &self,
        first: usize,
        factors: [f32; 2],
        column: &mut [f32; ERROR_STATES],
    ) {
        if let Some((dynamic, rest)) = column.split_first_chunk_mut::<DYNAMIC>()
            && let Some(parameters) = rest.first_chunk_mut::<PARAMETERS>()
        {
            let covariance = &self.step.covariance;
            covariance.add_dynamic_columns(first, factors, dynamic, parameters);
        }
    }

    /// Adds two rows of the covariance, a short and a long one, or the middle one, to its product
    /// with a vector that has entries at the gyroscope's parameters only. Returns false after the
    /// last rows.
    pub(in crate::estimator) fn add_product(
        &self,
        part: usize,
        vector: &[f32; GYROSCOPE_PARAMETERS],
        column: &mut [f32; ERROR_STATES],
    ) -> bool {
        let last = (PARAMETERS - 1).saturating_sub(part);
        if let Some((dynamic, rest)) = column.split_first_chunk_mut::<DYNAMIC>()
            && let Some(parameters) = rest.first_chunk_mut::<PARAMETERS>()
        {
            let covariance = &self.step.covariance;
            covariance.add_row_product(last, vector, dynamic, parameters);
            if part < last {
                covariance.add_row_product(part, vector, dynamic, parameters);
            }
        }
        part + 1 < last
    }

    /// Propagates a row of the cross-covariance through the last covariance step.
    pub(in crate::estimator) fn propagate_row(&self, row: &mut [f32; ERROR_STATES]) {
        if let Some((dynamic, rest)) = row.split_first_chunk_mut::<DYNAMIC>()
            && let Some(parameters) = rest.first_chunk::<PARAMETERS>()
        {
            self.step.transition().apply(dynamic, parameters);
        }
    }

    /// Returns the error state that the last covariance step has let return towards its prior, and
    /// the factor of its error.
    pub(in crate::estimator) fn relaxed(&self) -> (usize, f32) {
        let factor = self.relaxation(self.step.duration_s());
        (DYNAMIC + usize::from(self.last_relaxed), factor)
    }

    /// Returns a measurement of the last covariance step: those of parameters come first, then
    /// those of the velocity.
    pub(in crate::estimator) fn last_step_measurement(
        &self,
        index: usize,
    ) -> Option<TiltMeasurement> {
        let measurement = self.step.measurement(index)?;
        let correction = &self.step.correction;
        let (state, correction) = match measurement.state {
            State::Dynamic(state) => (state, correction.dynamic.get(state)?),
            State::Parameter(parameter) => {
                let correction = correction.parameters.get(parameter)?;
                (DYNAMIC + parameter, correction)
            }
        };
        Some(TiltMeasurement {
            state,
            weight: 1.0 / measurement.variance,
            residual: measurement.innovation - correction,
        })
    }

    /// Returns whether the last velocity measurement was too certain for `f32` correlations.
    ///
    /// With the variances v before it and v⁺ after it, v⁺/r = 1 − r/(v + r). The error of a
    /// correlation is then (v/r)² times that of an `f32`. The limit is v/r = 255.
    pub(in crate::estimator) fn has_lost_digits(&self) -> bool {
        const LARGEST: f32 = 1.0 - 1.0 / 256.0;
        let variance = self.step.covariance.dynamic_variance(VELOCITY_EAST);
        let measured = self.step.last_measurement();
        measured.is_some_and(|measured| variance > LARGEST * measured.variance)
    }

    /// Adds the column of a parameter times a factor.
    pub(in crate::estimator) fn add_parameter_column(
        &self,
        parameter: usize,
        factor: f32,
        column: &mut [f32; ERROR_STATES],
    ) {
        if let Some((dynamic, rest)) = column.split_first_chunk_mut::<DYNAMIC>()
            && let Some(parameters) = rest.first_chunk_mut::<PARAMETERS>()
        {
            let covariance = &self.step.covariance;
            covariance.add_parameter_column(parameter, factor, dynamic, parameters);
        }
    }

    /// Returns the correction of the gyroscope's parameters by the last covariance step.
    pub(in crate::estimator) fn gyroscope_correction(&self) -> &[f32] {
        let parameters = &self.step.correction.parameters;
        parameters.get(..GYROSCOPE_PARAMETERS).unwrap_or(&[])
    }

    /// Returns the yaw noise of the interval like that of the tilt, rad², for ∫|ω|² dt in
    /// rad²/s.
    pub(in crate::estimator) fn turn_noise_rad2(&self, duration_s: f32, squared_rate: f32) -> f32 {
        square(self.tuning.rate_noise) * duration_s
            + square(self.tuning.rate_noise_per_rate) * squared_rate
    }
}
