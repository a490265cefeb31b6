//! Restarts: at a rest that contradicts the state, from the mean specific force, from unusable
//! numbers.
//!
//! Three tests compare readings with the state. Comments call them by these names:
//!
//! | name | compares | where |
//! |---|---|---|
//! | force check | mean specific force and tilt, before each covariance step | `check_tilt` |
//! | consistency test | sum of the corrections and its covariance, in motion | `consistency.rs` |
//! | bias gate | mean rate and bias, at rest | `measure_at_rest` |

use super::consistency::Consistency;
use super::measurements::REST_FORCE_SHARE;
use super::recent_velocity::RecentVelocity;
use super::rest_detector::RestReadings;
use super::{Kalman, Tilt};
use crate::attitude::{Quaternion, Vector3};
use crate::estimator::arithmetic::square;
use crate::serialize::StateVisitor;
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Time for which the force check has to fail before an ambiguous tilt is set from the force, s:
/// longer than a vehicle dashes while it falls. A tilt that is not ambiguous is not `VALID` from
/// then on.
const CONTRADICTION_S: f32 = 1.3;
/// Time for which it has to fail before a tilt that is not ambiguous is set, s: longer than an
/// aeroplane pushes over.
const LONG_CONTRADICTION_S: f32 = 4.0;
/// σ of the tilt, both axes together, rad, from which on it is ambiguous: six σ are 60°.
const AMBIGUOUS_TILT_RAD: f32 = radians(10.0);
/// σ of the tilt after unusable numbers, rad.
const RECOVERED_TILT_RAD: f32 = 0.3;

/// σ of the tilt from the mean force at rest, both axes together, rad: the accelerometer's bias.
const STATIONARY_TILT_RAD: f32 = 1.4 * REST_FORCE_SHARE;
/// σ of the bias from the mean rate at rest, per axis, rad/s: motion that the average still
/// contains.
const STATIONARY_BIAS_RAD_S: f32 = radians(0.1);

/// σ of a known bias after a restart in the air, per axis, rad/s: it stays known.
const KEPT_BIAS_RAD_S: f32 = radians(0.4);

impl Kalman {
    /// Restarts from the mean readings at rest: takes bias and tilt from them, and resets the other
    /// parameters.
    #[inline(never)]
    pub(super) fn restart_at_rest(&mut self, readings: &RestReadings) {
        let force = self.nominal.attitude.rotate(readings.force_m_s2);
        self.level(force);
        self.bias_prior.reference_rad_s = readings.rate_rad_s;
        self.restart_from(
            readings.rate_rad_s,
            STATIONARY_BIAS_RAD_S,
            STATIONARY_TILT_RAD,
        );
        self.has_rested = true;
    }

    /// Restarts from the present attitude with this bias, their σ, and the priors of the other
    /// parameters.
    #[inline(never)]
    fn restart_from(&mut self, bias_rad_s: Vector3, bias_sigma_rad_s: f32, tilt_sigma_rad: f32) {
        self.reset_parameters();
        self.consistency = Consistency::NONE;
        self.start_from_attitude(bias_rad_s, bias_sigma_rad_s, tilt_sigma_rad);
        self.tilt = Tilt::Known;
    }

    /// Returns every parameter but the gyroscope's bias to its prior.
    pub(super) fn reset_parameters(&mut self) {
        self.nominal.reset_parameters();
        self.step
            .covariance
            .reset_parameters(&self.parameter_priors);
    }

    /// Runs the force check: the tilt against the mean specific force. Sets the tilt from it if a
    /// single sample has set the tilt, or if the mean is about one g and over 45° from up. Both
    /// end the interval without a covariance step.
    ///
    /// No vehicle that holds its height reads such a force: a sideways acceleration of one g would
    /// give 1.4 g. But a vehicle that dashes and falls may have such a mean, and an aeroplane that
    /// pushes over. So each interval has to contradict a tilt that is not ambiguous, for longer
    /// than a push-over. Shaking hides gravity from single intervals, so the mean alone counts
    /// while the tilt is ambiguous, as after a start in motion. Intervals with a hidden force do
    /// not count.
    #[inline(never)]
    pub(super) fn check_tilt(&mut self) {
        let latest = self.interval.force_sum();
        if self.is_from_one_sample {
            self.confirm_start(&latest);
            return;
        }
        if self.interval.hides_force() {
            return;
        }
        let is_ambiguous = self.step.tilt_variance_rad2() > square(AMBIGUOUS_TILT_RAD);
        let sum = &mut self.force_sum;
        sum.integral_m_s = sum.integral_m_s + latest.integral_m_s;
        sum.duration_s += latest.duration_s;
        let is_contradicted = sum.is_gravity_down() && (is_ambiguous || latest.is_gravity_down());
        let is_over = if is_ambiguous {
            sum.duration_s > CONTRADICTION_S
        } else {
            !is_contradicted || sum.duration_s > LONG_CONTRADICTION_S
        };
        if is_over {
            if is_contradicted {
                let integral_m_s = sum.integral_m_s;
                self.level(integral_m_s);
                // Ends the sum, too.
                self.reset_tilt_and_velocity(square(self.tuning.start_tilt_rad));
            } else {
                *sum = ForceSum::NONE;
            }
        }
    }

    /// Returns whether a tilt that is not ambiguous has failed the force check for 1.3 s. The sum
    /// of an ambiguous tilt ends by then.
    pub(super) fn is_tilt_contradicted(&self) -> bool {
        self.force_sum.duration_s > CONTRADICTION_S
    }

    /// Turns the attitude by the shortest rotation that makes this force, which is given in earth
    /// axes, point up.
    pub(super) fn level(&mut self, force: Vector3) {
        let rotation = shortest_to_up(force);
        self.nominal.attitude = rotation.multiply(self.nominal.attitude).normalize();
    }

    /// Restarts from numbers that are no longer usable, and keeps what is still known: the attitude
    /// with a large σ, and the gyroscope's bias.
    ///
    /// Only readings that no sensor delivers lead here. A vehicle in the air would not rest for
    /// another measurement of the bias.
    pub(super) fn restart_from_unusable_numbers(&mut self) {
        let attitude = self.nominal.attitude;
        let bias_rad_s = self.nominal.gyroscope_bias_rad_s;
        // Corrections limit the bias, so only a NaN fails.
        let is_usable =
            (attitude.dot(attitude) - 1.0).abs() < 1.0e-3 && !bias_rad_s.dot(bias_rad_s).is_nan();
        let prior_rad_s = self.tuning.gyroscope_bias_rad_s;
        let (bias_rad_s, sigma_rad_s) = match (is_usable, self.is_bias_known) {
            (true, true) => (bias_rad_s, KEPT_BIAS_RAD_S),
            (true, false) => (bias_rad_s, prior_rad_s),
            (false, _) => (Vector3::ZERO, prior_rad_s),
        };
        self.recent = RecentVelocity::NONE;
        self.restart_from(bias_rad_s, sigma_rad_s, RECOVERED_TILT_RAD);
        if !is_usable {
            self.nominal.attitude = Quaternion::IDENTITY;
            self.tilt = Tilt::Unknown;
        }
    }
}

/// Specific force over some time, for its mean.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct ForceSum {
    /// Integral of the force, earth axes.
    pub(super) integral_m_s: Vector3,
    pub(super) duration_s: f32,
}

impl ForceSum {
    pub(super) const NONE: Self = Self {
        integral_m_s: Vector3::ZERO,
        duration_s: 0.0,
    };

    /// Returns whether the mean is about one g, and over 45° from up.
    fn is_gravity_down(&self) -> bool {
        self.is_gravity_up() == Some(false)
    }

    /// Returns whether the mean is within 45° of up; `None` if it is not about one g.
    #[inline(never)]
    pub(super) fn is_gravity_up(&self) -> Option<bool> {
        let force = self.integral_m_s;
        let squared = force.dot(force);
        // Within 45°, z is negative, and its square more than half of the whole.
        let is_up = -2.0 * force.z * force.z.abs() > squared;
        // From 0.7 to 1.4 g.
        let least = square(0.7 * STANDARD_GRAVITY_M_S2 * self.duration_s);
        (least..4.0 * least).contains(&squared).then_some(is_up)
    }

    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            integral_m_s,
            duration_s,
        } = self;
        visitor.vector(integral_m_s);
        visitor.f32(duration_s);
    }
}

/// Returns the shortest rotation that turns this nonzero direction up, to (0, 0, −1), as a
/// quaternion that is not normalised.
fn shortest_to_up(direction: Vector3) -> Quaternion {
    let norm = direction.norm();
    // w = 1 + cos, and the axis is direction × up. Both vanish where the direction points straight
    // down.
    let w = norm - direction.z;
    if w < 1.0e-3 * norm {
        return Quaternion::new(0.0, 1.0, 0.0, 0.0);
    }
    Quaternion::new(w, -direction.y, direction.x, 0.0)
}
