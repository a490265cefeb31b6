//! Measurements of a covariance step: a small velocity in motion, zero velocity and zero rate at
//! rest, and the width of the bias prior.

use super::confirmation::Confirmation;
use super::propagation::{State, VELOCITY_EAST, VELOCITY_NORTH};
use super::rest_detector::{RestReadings, SETTLED_S};
use super::slices::Measurement;
use super::tuning::LARGEST_GYROSCOPE_BIAS_RAD_S;
use super::{Kalman, Tilt, USABLE_TILT_RAD};
use crate::attitude::Vector3;
use crate::estimator::arithmetic::{larger, smaller, square};
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Bias gate of the zero-rate update, in σ of each axis.
const ZERO_RATE_GATE_SIGMA: f32 = 4.0;
/// Bias gate of the first zero-rate update, in σ. Beyond it the filter restarts at the rest.
const FIRST_REST_GATE_SIGMA: f32 = 2.0;
/// Largest change of the bias from one rest to the next that is accepted at once, rad/s. After
/// contradictions σ of the bias is large, and the gate alone would accept a swing.
const LARGEST_BIAS_CHANGE_RAD_S: f32 = radians(0.5);
/// Time for which a rest has to fail the bias gate before the filter restarts at it, s. By then
/// the rate of most swings has drifted.
const RESTART_AFTER_CONTRADICTION_S: f32 = 3.0;
/// Gate of the velocity at rest, in σ. A larger velocity is steady motion, not an error of the
/// tilt.
const COASTING_GATE_SIGMA: f32 = 3.0;
/// Gate of the velocity at the first rest, in σ. That σ is large if the vehicle was never at
/// rest, so steady motion hides in it.
const FIRST_COASTING_GATE_SIGMA: f32 = 2.0;

/// σ of the bias below which one axis a step is measured at rest, rad/s.
const WELL_KNOWN_BIAS_RAD_S: f32 = radians(0.1);

/// Drift of the specific force that ends a rest, m/s²: after 0.6° a turn is no rest, however
/// slow and steady it is.
const LARGEST_FORCE_DRIFT_M_S2: f32 = 0.1;
/// Drift of the mean rate that ends a rest, rad/s. In revision 27 with 0.4 °/s 19 of 120 buoys
/// were `VALID` and wrong, with 0.2 °/s 4 (`bench/src/valid/swings.rs`).
const LARGEST_RATE_DRIFT_RAD_S: f32 = radians(0.2);
/// Drift of the specific force up to which a rest is steady, m/s²: three σ of its noise.
const STEADY_FORCE_DRIFT_M_S2: f32 = 0.03;
/// Drift of the mean rate up to which a rest is steady, rad/s: 0.1 °/s that the averages contain
/// of the motion when they have settled, and noise.
const STEADY_RATE_DRIFT_RAD_S: f32 = radians(0.15);
/// Time at rest after which the bias is no longer that of a swing, s. With 1.5 s swings that an
/// interruption follows lost the bias of a true rest (`bench/src/valid/interruptions.rs`).
const LEAST_RESTED_S: f32 = 1.0;
/// Time without motion after which the first rest is believed with a larger drift, s. By then a
/// turn of 1 °/s about a horizontal axis has exceeded the largest one.
const DRIFTING_FIRST_REST_S: f32 = 1.125;
/// Longest time from the check of a rest to its measurement, s, at 8 samples a second or more: the
/// check is a slice earlier.
const CHECK_AGE_S: f32 = 0.125;
/// Largest rate that a rest may hide, rad/s.
const HIDDEN_RATE_RAD_S: f32 = radians(0.4);

/// Gate of the horizontal force at rest, in σ of the tilt.
const REST_FORCE_GATE_SIGMA: f32 = 4.0;
/// Largest horizontal force at rest that the tilt's σ does not explain, as a share of one g: the
/// accelerometer's bias.
pub(super) const REST_FORCE_SHARE: f32 = 0.03;

/// Force upwards from which on an acceleration may explain a force at rest that contradicts the
/// tilt, m/s². With less the vehicle would fall, or the tilt is more than 35° wrong.
const LEAST_UP_M_S2: f32 = 8.0;
/// Longest time for which an acceleration explains that force, per force upwards beyond
/// [`LEAST_UP_M_S2`], s/(m/s²): 6.8 s if the vehicle keeps its height.
const LONGEST_ACCELERATION_S3_M: f32 = 3.75;

/// Least share of the bias prior's variance that counts as learned, so that the gate of a bias that
/// motion has hardly observed is not zero.
const LEAST_LEARNED_SHARE: f32 = 0.02;
/// Ratio of the bias's variance to its prior's above which the prior is not widened. At 2 the
/// measurement of variance −2p would make the bias's variance infinite, and negative beyond.
const LARGEST_WIDENED_RATIO: f32 = 1.5;

impl Kalman {
    /// Adds this step's measurements. The covariance is propagated to the interval's end.
    ///
    /// Each branch queues those of parameters first, then those of the velocity: the heading
    /// filter repeats them, and needs this order (`heading/step.rs`).
    pub(super) fn measure(&mut self) {
        let before = self.step.measured();
        let duration_s = self.step.duration_s();
        self.recent
            .update(self.nominal.velocity_m_s, duration_s, self.tuning);
        let stationary = self.rest_detector.stationary_readings(self.tuning);
        let stationary =
            stationary.filter(|_| !self.is_armed && (self.has_rested || self.is_rest_certain()));
        self.is_first_rest = stationary.is_some() && !self.has_rested;
        match stationary {
            Some(readings) => {
                if !self.measure_at_rest(&readings, duration_s) {
                    self.tilt = Tilt::Restarting;
                    self.is_bias_known = false;
                }
            }
            None => {
                if !self.is_bias_measured() {
                    self.widen_prior();
                }
                self.measure_small_velocity(duration_s);
            }
        }
        // A damaged state of an earlier run may hold others before these.
        debug_assert!(self.step.are_parameters_first(before), "order of the queue");
    }

    /// Returns whether the first rest may measure the bias, which is not known yet. The specific
    /// force must have been steady up to the last check of its drift, or the rest must be long.
    fn is_rest_certain(&self) -> bool {
        let still_s = self.rest_detector.still_s();
        still_s < self.steady_until_s + CHECK_AGE_S || still_s > DRIFTING_FIRST_REST_S
    }

    /// Ends a rest that drifts. Until the averages contain no motion, the drift is measured anew.
    ///
    /// - The mean rate drifts: a swing.
    /// - The specific force drifts: a slow, steady turn, because gravity turns in the body.
    ///
    /// A rest that has drifted most of the time was motion from the beginning. The bias that it has
    /// measured is then unknown again: in a swing if rests of less than 1 s in all have measured
    /// it, because they were parts of the swing too; in a turn if the gyroscope shows less turn
    /// than gravity.
    #[inline(never)]
    pub(super) fn check_rest_drift(&mut self) {
        let still_s = self.rest_detector.still_s();
        if self.rest_detector.needs_drift_reference() {
            self.rest_detector.set_drift_reference(self.has_rested);
        }
        let squared_force_drift = self.rest_detector.squared_force_drift();
        let squared_rate_drift = self.rest_detector.squared_rate_drift();
        if squared_force_drift < square(STEADY_FORCE_DRIFT_M_S2)
            && squared_rate_drift < square(STEADY_RATE_DRIFT_RAD_S)
        {
            self.steady_until_s = still_s;
        }
        let is_swing = squared_rate_drift > square(LARGEST_RATE_DRIFT_RAD_S);
        if !is_swing && squared_force_drift < square(LARGEST_FORCE_DRIFT_M_S2) {
            return;
        }
        let bias_rad_s = self.nominal.gyroscope_bias_rad_s;
        // The first averages are up to a covariance step older.
        let drift_s = still_s - SETTLED_S + self.tuning.covariance_period_s;
        let is_mostly_drift = 2.0 * (still_s - self.steady_until_s) > drift_s;
        let shown = self.rest_detector.average_rate_rad_s() - bias_rad_s;
        let turned_rad_s = LARGEST_FORCE_DRIFT_M_S2 / STANDARD_GRAVITY_M_S2 / drift_s;
        // A drift that takes over 1.46 s is a turn of less than `HIDDEN_RATE_RAD_S`, which the
        // gyroscope need not show. The limit below is negative then, and nothing is within it.
        let has_measured_motion = if is_swing {
            self.rested_s < LEAST_RESTED_S
        } else {
            shown.is_within(turned_rad_s - HIDDEN_RATE_RAD_S)
        };
        if self.has_rested && is_mostly_drift && has_measured_motion {
            self.set_bias_prior(bias_rad_s, self.tuning.gyroscope_bias_rad_s);
        }
        self.rest_detector.interrupt();
    }

    /// Adds the small-velocity measurement of motion: the more noise, the faster the vehicle has
    /// moved.
    #[inline(never)]
    fn measure_small_velocity(&mut self, duration_s: f32) {
        let tuning = self.tuning;
        let density = square(tuning.velocity_noise)
            + square(tuning.velocity_noise_per_velocity) * self.recent.squared;
        let density = smaller(density, square(tuning.velocity_noise_limit));
        self.measure_velocity(density / duration_s);
    }

    #[inline(never)]
    fn measure_velocity(&mut self, variance: f32) {
        for (index, velocity) in self.nominal.velocity_m_s.into_iter().enumerate() {
            self.step.queue_measurement(Measurement {
                state: State::Dynamic(VELOCITY_NORTH + index),
                innovation: -velocity,
                variance,
            });
        }
    }

    /// Adds zero-rate and zero-velocity updates, each only if it passes its gate.
    ///
    /// Returns false if the next sample must restart the filter from the readings:
    ///
    /// - First rest: they fail the bias gate, or the tilt is too uncertain for the linear model.
    /// - Later rest: they fail the bias gate for 3 s, and no motion explains that.
    /// - Any rest: the force contradicts the tilt for longer than a vehicle accelerates.
    #[inline(never)]
    fn measure_at_rest(&mut self, readings: &RestReadings, duration_s: f32) -> bool {
        let tuning = self.tuning;
        let difference = readings.rate_rad_s - self.nominal.gyroscope_bias_rad_s;
        let tilt = self.step.tilt_variance_rad2();
        let is_usable = tilt < square(USABLE_TILT_RAD);
        let agrees =
            self.has_rested || is_usable && self.passes_gate(difference, FIRST_REST_GATE_SIGMA);
        if !agrees {
            return false;
        }
        let force = self.nominal.attitude.rotate(readings.force_m_s2);
        // An error θ of the tilt gives f_h = g·sin θ and up = g·cos θ, so θ² ≈
        // f_h²/(up·g). With g² a force that points down would be explained too.
        let up_m_s2 = -force.z;
        let is_explained = square(force.x) + square(force.y)
            < up_m_s2
                * (square(REST_FORCE_GATE_SIGMA) * STANDARD_GRAVITY_M_S2 * tilt
                    + square(REST_FORCE_SHARE) * STANDARD_GRAVITY_M_S2);
        let is_long =
            self.rest_detector.still_s() > LONGEST_ACCELERATION_S3_M * (up_m_s2 - LEAST_UP_M_S2);
        if !is_explained && is_long {
            return false;
        }
        // A first rest whose force does not fit the tilt measures no bias yet.
        if is_explained || self.has_rested {
            let change = readings.rate_rad_s - self.bias_prior.reference_rad_s;
            let is_near = !self.has_rested || change.is_within(LARGEST_BIAS_CHANGE_RAD_S);
            self.has_rested = true;
            let rate_variance = self.rest_detector.rate_variance();
            if is_near && self.passes_gate(difference, ZERO_RATE_GATE_SIGMA) {
                self.bias_prior.reference_rad_s = readings.rate_rad_s;
                self.confirmation = Confirmation::Confirmed;
                let variance = square(tuning.stationary_rate_noise) / duration_s;
                self.measure_bias(difference, variance);
                self.rested_s += duration_s;
                self.rest_detector.agree();
                self.rest_watch.add_rest(rate_variance);
            } else if self.rest_detector.contradicted_s() > RESTART_AFTER_CONTRADICTION_S
                && !self.rest_watch.is_motion(rate_variance)
            {
                return false;
            }
        }
        if is_explained {
            let variance = square(tuning.stationary_velocity_noise) / duration_s;
            self.reset_coasting(variance);
            self.measure_velocity(variance);
        } else {
            self.measure_small_velocity(duration_s);
        }
        true
    }

    /// Resets a velocity that the tilt's error cannot explain: the vehicle moves steadily, and the
    /// readings are those of rest.
    fn reset_coasting(&mut self, variance: f32) {
        let [north, east] = self.nominal.velocity_m_s;
        let covariance = &mut self.step.covariance;
        let explained = covariance.dynamic_variance(VELOCITY_NORTH)
            + covariance.dynamic_variance(VELOCITY_EAST)
            + 2.0 * variance;
        let gate = if self.is_first_rest {
            square(FIRST_COASTING_GATE_SIGMA)
        } else {
            square(COASTING_GATE_SIGMA)
        };
        if square(north) + square(east) > gate * explained {
            covariance.reset_dynamic(VELOCITY_NORTH, variance);
            covariance.reset_dynamic(VELOCITY_EAST, variance);
            self.nominal.velocity_m_s = [0.0; 2];
        }
    }

    /// Adds the zero-rate update: at rest the gyroscope reads its bias.
    fn measure_bias(&mut self, difference: Vector3, variance: f32) {
        // Well-known axes are measured in turn, which is cheaper.
        self.last_measured_axis = if self.last_measured_axis < 2 {
            self.last_measured_axis + 1
        } else {
            0
        };
        let innovations = [difference.x, difference.y, difference.z];
        for (axis, innovation) in innovations.into_iter().enumerate() {
            let own = self.step.covariance.parameter_variance(axis);
            if own > square(WELL_KNOWN_BIAS_RAD_S) || axis == usize::from(self.last_measured_axis) {
                self.step.queue_measurement(Measurement {
                    state: State::Parameter(axis),
                    innovation,
                    variance,
                });
            }
        }
    }

    /// Returns whether a bias innovation, rad/s, is within this number of σ on each axis. σ² is
    /// the bias variance before the update plus the noise of a mean of one second. The update
    /// averages over less time, so this gate is stricter than one on the innovation's own σ.
    fn passes_gate(&self, difference: Vector3, sigmas: f32) -> bool {
        let noise = square(self.tuning.stationary_rate_noise);
        let differences = [difference.x, difference.y, difference.z];
        (0..3).zip(differences).all(|(axis, difference)| {
            let own = self.step.covariance.parameter_variance(axis);
            square(difference) < square(sigmas) * (own + noise)
        })
    }

    /// Returns whether a rest, of this run or an earlier one, has measured the bias.
    pub(super) fn is_bias_measured(&self) -> bool {
        self.has_rested || self.has_measured_prior
    }

    /// Doubles the prior variance of a bias that has turned out to lie outside its prior, unless a
    /// rest has measured the bias: the rest's measurement is no prior.
    ///
    /// The prior is a measurement of the bias with variance p. Replacing p by 2p removes a
    /// measurement of variance 2p, which is the same as adding one of variance −2p. Repeated,
    /// this maximises the likelihood over the prior's width.
    fn widen_prior(&mut self) {
        let bias = self.bias_change_rad_s();
        let variances = &mut self.bias_prior.variance;
        let deviations = [bias.x, bias.y, bias.z];
        for (axis, (bias, variance)) in deviations.into_iter().zip(variances).enumerate() {
            let own = self.step.covariance.parameter_variance(axis);
            let learned = larger(*variance - own, LEAST_LEARNED_SHARE * *variance);
            if square(bias) > square(self.tuning.prior_gate_sigma) * learned
                && *variance < square(LARGEST_GYROSCOPE_BIAS_RAD_S)
                && own < *variance * LARGEST_WIDENED_RATIO
            {
                self.step.queue_measurement(Measurement {
                    state: State::Parameter(axis),
                    innovation: -bias,
                    variance: -2.0 * *variance,
                });
                *variance *= 2.0;
            }
        }
    }
}
