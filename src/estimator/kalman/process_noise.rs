//! Process noise of a covariance step: Q, a bias that has changed, and the slow return of the
//! parameters to their priors.

use super::Kalman;
use super::confirmation::Confirmation;
use super::prior::FIRST_WITH_PRIOR;
use super::propagation::{Interval, PARAMETERS};
use crate::estimator::arithmetic::{smaller, square};

impl Kalman {
    /// Begins a covariance step in two slices. The first checks the tilt, which may end the
    /// interval without a step. The second closes the interval: it adds its velocity, and begins
    /// its step with the process noise.
    pub(super) fn begin_covariance_step(&mut self) {
        self.is_tilt_checked = !self.is_tilt_checked;
        if self.is_tilt_checked {
            self.check_tilt();
            return;
        }
        let tuning = self.tuning;
        let duration_s = self.interval.duration_s;
        let velocity = self.nominal.velocity_m_s.iter_mut();
        for (velocity, change) in velocity.zip(self.interval.velocity_change_m_s) {
            *velocity += change;
        }
        self.nominal_tilt_rad2 = self.covariance_tilt_variance();
        let walk = (square(tuning.gyroscope_bias_walk) + self.added_bias_walk) * duration_s;
        let covariance = &mut self.step.covariance;
        let mut bias = 0.0;
        for axis in 0..3 {
            bias += covariance.parameter_variance(axis);
            covariance.add_to_parameter(axis, walk);
        }
        let tilt = covariance.tilt_variance();
        let rate_density = square(tuning.rate_noise) + square(tuning.coupling) * bias * tilt;
        let tilt_noise = rate_density * duration_s
            + square(tuning.rate_noise_per_rate) * self.interval.squared_rate
            + self.interval.unseen_tilt_rad2;
        // A still sensor does not shake, even after much motion.
        let shaking = if self.rest_detector.is_still() {
            0.0
        } else {
            square(tuning.force_noise_per_velocity) * self.recent.squared
        };
        let force_density = square(tuning.force_noise) + shaking;
        let velocity_noise = force_density * duration_s + self.interval.unseen_velocity_m2_s2;
        let transition = &self.interval.transition;
        self.step
            .begin(transition, tilt_noise, velocity_noise, duration_s);
        self.interval = Interval::EMPTY;
    }

    /// Makes tilt and bias uncertain again if the last steps' corrections fail the consistency
    /// test. The bias has to be confirmed then.
    ///
    /// The correction of the first rest is not among them.
    pub(super) fn admit_changed_bias(&mut self) {
        let Some(change) = self.consistency.take_contradiction() else {
            return;
        };
        self.confirmation = Confirmation::Suspect;
        self.interval.unseen_tilt_rad2 += change.tilt_rad2;
        for (axis, prior) in self.bias_prior.variance.iter_mut().enumerate() {
            *prior += change.bias_variance;
            let covariance = &mut self.step.covariance;
            covariance.add_to_parameter(axis, change.bias_variance);
        }
    }

    /// Lets one parameter return towards its prior, each in turn.
    ///
    /// A first-order Gauss-Markov process (Gelb, *Applied Optimal Estimation*, 1974, §3.8): the
    /// deviation decays by φ, and noise of (1 − φ²) times the prior's variance keeps the prior
    /// stationary. One parameter a step is cheap, and its turn comes every three seconds.
    pub(super) fn relax_parameter(&mut self, duration_s: f32) {
        let parameter = match usize::from(self.last_relaxed) + 1 {
            next @ FIRST_WITH_PRIOR..PARAMETERS => next,
            _ => FIRST_WITH_PRIOR,
        };
        self.last_relaxed = parameter as u8;
        let factor = self.relaxation(duration_s);
        let added = (1.0 - square(factor)) * self.parameter_priors.variance(parameter);
        let covariance = &mut self.step.covariance;
        covariance.scale_parameter(parameter, factor, added);
        self.nominal.scale_parameter(parameter, factor);
    }

    /// Returns the factor with which a parameter's error decays in its turn.
    #[inline(always)]
    pub(super) fn relaxation(&self, duration_s: f32) -> f32 {
        const TURNS: f32 = (PARAMETERS - 3) as f32;
        1.0 - smaller(TURNS * duration_s / self.tuning.parameter_memory_s, 1.0)
    }
}
