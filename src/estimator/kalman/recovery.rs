//! Restarts: at a rest that contradicts the state, from the mean specific force, from unusable
//! numbers.

use super::consistency::Consistency;
use super::measurements::STATIONARY_FORCE_SHARE;
use super::propagation::Interval;
use super::recent_velocity::RecentVelocity;
use super::stationary::StationaryReadings;
use super::{Kalman, Tilt};
use crate::attitude::{Quaternion, Vector3};
use crate::estimator::arithmetic::square;
use crate::serialize::StateVisitor;
use crate::units::{STANDARD_GRAVITY_M_S2, radians};

/// Averaging time of the specific force that may contradict the tilt, s. A vehicle that dashes
/// sideways at 60° contradicts it for seven tenths of that.
const FORCE_AVERAGE_S: f32 = 2.0;
/// Averaging time while the tilt is uncertain, s: after a start in motion, it may be wrong by any
/// angle.
const UNCERTAIN_FORCE_AVERAGE_S: f32 = 0.7;
/// σ of the tilt, both axes together, rad, from which on six σ include 45°.
const UNCERTAIN_TILT_RAD: f32 = radians(7.5);
/// σ of the tilt after unusable numbers, rad.
const RECOVERED_TILT_RAD: f32 = 0.3;

/// σ of the tilt from the mean force at rest, both axes together, rad: the accelerometer's bias.
const STATIONARY_TILT_RAD: f32 = 1.4 * STATIONARY_FORCE_SHARE;
/// σ of the bias from the mean rate at rest, per axis, rad/s: motion that the average still
/// contains.
const STATIONARY_BIAS_RAD_S: f32 = radians(0.1);

/// σ of a known bias after a restart in the air, per axis, rad/s: it stays known.
const KEPT_BIAS_RAD_S: f32 = radians(0.4);

impl Kalman {
    /// Restarts from the mean readings at rest: takes bias and tilt from them, and resets the other
    /// parameters.
    pub(super) fn restart_at_rest(&mut self, readings: &StationaryReadings) {
        let force = self.nominal.attitude.rotate(readings.force_m_s2);
        self.level(force);
        self.restart_with(
            readings.rate_rad_s,
            STATIONARY_BIAS_RAD_S,
            STATIONARY_TILT_RAD,
        );
        self.has_rested = true;
    }

    /// Restarts from the present attitude with this bias, their σ, and the priors of the other
    /// parameters.
    #[inline(never)]
    fn restart_with(&mut self, bias_rad_s: Vector3, bias_sigma_rad_s: f32, tilt_sigma_rad: f32) {
        self.reset_parameters();
        self.consistency = Consistency::NONE;
        self.start_with(bias_rad_s, bias_sigma_rad_s, tilt_sigma_rad);
        self.tilt = Tilt::Known;
    }

    /// Returns every parameter but the gyroscope's bias to its prior.
    pub(super) fn reset_parameters(&mut self) {
        self.nominal.reset_parameters();
        self.step.covariance.reset_parameters(&self.priors);
    }

    /// Takes the tilt from the mean specific force: from that of the interval, if a single sample
    /// has set it; or from that of some time, if it contradicts the tilt: about one g, over 45°
    /// from up. Returns whether it has compared them; the next slice begins the step then.
    ///
    /// No vehicle that holds its height reads such a force: a sideways acceleration of one g would
    /// give 1.4 g.
    #[inline(never)]
    pub(super) fn compare_force(&mut self) -> bool {
        let average_s = if self.is_from_one_sample {
            self.add_force();
            0.0
        } else if self.step.tilt_variance_rad2() < square(UNCERTAIN_TILT_RAD) {
            FORCE_AVERAGE_S
        } else {
            UNCERTAIN_FORCE_AVERAGE_S
        };
        let sum = &mut self.force_sum;
        if sum.duration_s < average_s {
            return false;
        }
        // Without usable readings the mean is a NaN, and not gravity.
        let mean = sum.integral_m_s.scale(1.0 / sum.duration_s);
        *sum = ForceSum::NONE;
        let is_gravity = is_gravity(mean);
        let is_up = mean.z < 0.0 && 2.0 * square(mean.z) > mean.dot(mean);
        if self.is_from_one_sample {
            self.has_work = false;
            if is_gravity {
                self.confirm_start(mean);
            } else {
                self.tilt = Tilt::Lost;
            }
        } else if is_gravity && !is_up {
            self.level(mean);
            self.reset_motion(square(self.tuning.start_tilt_rad));
        }
        true
    }

    /// Takes the tilt from this mean force, earth axes, instead of that of a single sample.
    fn confirm_start(&mut self, force: Vector3) {
        self.level(force);
        let unseen_tilt_rad2 = self.interval.unseen_tilt_rad2;
        self.interval = Interval::EMPTY;
        self.interval.unseen_tilt_rad2 = unseen_tilt_rad2;
        self.rest_watch.variance_rad2 = 0.0;
        self.is_from_one_sample = false;
    }

    /// Adds the interval to the force that is compared, unless its readings hide some.
    pub(super) fn add_force(&mut self) {
        if self.interval.unseen_velocity_m2_s2 == 0.0 {
            let sum = &mut self.force_sum;
            sum.integral_m_s = sum.integral_m_s + self.interval.gained_m_s();
            sum.duration_s += self.interval.duration_s;
        }
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
        self.restart_with(bias_rad_s, sigma_rad_s, RECOVERED_TILT_RAD);
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
    integral_m_s: Vector3,
    duration_s: f32,
}

impl ForceSum {
    pub(super) const NONE: Self = Self {
        integral_m_s: Vector3::ZERO,
        duration_s: 0.0,
    };

    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.vector(&mut self.integral_m_s);
        visitor.f32(&mut self.duration_s);
    }
}

/// Returns whether this specific force, m/s², is about one g.
fn is_gravity(force: Vector3) -> bool {
    const LEAST: f32 = 0.7 * STANDARD_GRAVITY_M_S2;
    const GREATEST: f32 = 1.4 * STANDARD_GRAVITY_M_S2;
    (square(LEAST)..square(GREATEST)).contains(&force.dot(force))
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
