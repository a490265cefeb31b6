//! Roll and pitch by one angle and bias Kalman filter each, around an exact quaternion.
//!
//! The tutorial's two filters, without its two shortcuts: the angles are proper Euler angles from
//! arctangents, and the gyroscope moves them by the full kinematics. The kinematics run on a
//! quaternion, which has no singularity and costs no trigonometry. Each sample then corrects it by
//! two scalar innovations, roll and pitch. Each is the angle between two directions, so it lies
//! within ±π. A roll correction turns about the forward axis, a pitch correction about the level
//! axis at right angles to it. Neither changes the other angle or yaw.
//!
//! Near pitch ±90° roll is not defined, and the accelerometer measures it with the variance
//! R/cos²(pitch). At the pole only the gyroscope propagates roll.
//!
//! Terms: "down" is the direction of gravity in body axes, measured as minus the specific force.
//! Cost: two arctangents, two square roots and three divisions per sample.

use super::angle_bias::{AngleBias, R_MEASURE};
use crate::attitude::{Quaternion, Vector3};
use crate::estimator::filter::Filter;
use crate::estimator::sample::Sample;
use crate::units::radians;

/// Largest zero-rate offset of the family: 20 °/s, and 20 more over temperature (product
/// specification §6.1). It limits the effect of long accelerations on the bias.
const LARGEST_BIAS_RAD_S: f32 = radians(40.0);

/// Smallest cos² of pitch at which the measured roll is used: 0.6° from the pole. Nearer to it,
/// the accelerometer's noise alone turns the measured roll by half a turn.
const LEAST_PITCH_COSINE_SQUARED: f32 = 1.0e-4;

/// Filter state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AxisKalman {
    attitude: Quaternion,
    /// The last sample's rate. Between samples the rate is assumed to change linearly.
    rate_rad_s: Vector3,
    roll: AngleBias,
    pitch: AngleBias,
    /// Cosine and sine of roll; they keep their last values at the pole.
    roll_cosine: f32,
    roll_sine: f32,
    has_tilt: bool,
}

impl Filter for AxisKalman {
    fn restart(&mut self) {
        *self = Self {
            attitude: Quaternion::IDENTITY.with_sign_of(self.attitude),
            ..Self::new()
        };
    }

    fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        self.roll = AngleBias::new();
        self.pitch = AngleBias::new();
        self.rate_rad_s = sample.angular_rate_rad_s;
        if shows_gravity {
            self.set_tilt(-sample.specific_force_m_s2);
        }
    }

    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        self.predict(sample.angular_rate_rad_s, dt_s);
        if shows_gravity && self.has_tilt {
            self.correct(-sample.specific_force_m_s2);
        } else if shows_gravity {
            self.set_tilt(-sample.specific_force_m_s2);
        }
        self.attitude = self.attitude.normalize();
    }

    fn attitude(&self) -> Quaternion {
        self.attitude
    }

    fn body_rates_rad_s(&self) -> Vector3 {
        self.rate_rad_s
    }
}

impl Default for AxisKalman {
    fn default() -> Self {
        Self::new()
    }
}

impl AxisKalman {
    /// Creates a filter without an attitude.
    pub const fn new() -> Self {
        Self {
            attitude: Quaternion::IDENTITY,
            rate_rad_s: Vector3::ZERO,
            roll: AngleBias::new(),
            pitch: AngleBias::new(),
            roll_cosine: 1.0,
            roll_sine: 0.0,
            has_tilt: false,
        }
    }

    fn predict(&mut self, rate_rad_s: Vector3, dt_s: f32) {
        let mean_rate = (self.rate_rad_s + rate_rad_s).scale(0.5);
        self.rate_rad_s = rate_rad_s;
        let bias = self.in_body(self.roll.bias, self.pitch.bias);
        self.turn((mean_rate - bias).scale(dt_s));
        self.roll.predict(dt_s);
        self.pitch.predict(dt_s);
    }

    /// Runs one Kalman step per angle.
    fn correct(&mut self, measured_down: Vector3) {
        let innovation = self.innovation(measured_down);
        let mut roll_change = 0.0;
        if let Some(roll) = innovation.roll {
            let variance = R_MEASURE / innovation.pitch_cosine_squared;
            roll_change = self.roll.correct(roll, variance);
            self.roll.bias = clamp_bias(self.roll.bias);
        }
        let pitch_change = self.pitch.correct(innovation.pitch, R_MEASURE);
        self.pitch.bias = clamp_bias(self.pitch.bias);
        self.turn(self.in_body(roll_change, pitch_change));
    }

    /// Sets roll and pitch as measured and keeps yaw. At the pole it keeps roll too.
    fn set_tilt(&mut self, measured_down: Vector3) {
        let innovation = self.innovation(measured_down);
        // Large turns do not add up, so one follows the other. The first is pitch about its own
        // axis, which does not change roll; the second is roll about the forward axis.
        self.turn(self.in_body(0.0, innovation.pitch));
        if let Some(roll) = innovation.roll {
            self.turn(self.in_body(roll, 0.0));
        }
        self.has_tilt = true;
    }

    /// Returns measured minus predicted angles. Also updates the axis of pitch.
    fn innovation(&mut self, measured: Vector3) -> Innovation {
        let predicted = self.attitude.down_in_body();
        // The component of each direction at right angles to the forward axis depends on roll.
        let measured_squared = measured.y * measured.y + measured.z * measured.z;
        let predicted_squared = predicted.y * predicted.y + predicted.z * predicted.z;
        let measured_across = libm::sqrtf(measured_squared);
        let predicted_across = libm::sqrtf(predicted_squared);
        if predicted_squared > LEAST_PITCH_COSINE_SQUARED {
            let inverse = 1.0 / predicted_across;
            self.roll_cosine = predicted.z * inverse;
            self.roll_sine = predicted.y * inverse;
        }
        let measured_cosine_squared =
            measured_squared / (measured_squared + measured.x * measured.x);
        let pitch_cosine_squared = measured_cosine_squared.min(predicted_squared);
        // Each is atan2(sin, cos) of the difference of the two angles.
        let roll = libm::atan2f(
            measured.y * predicted.z - measured.z * predicted.y,
            measured.y * predicted.y + measured.z * predicted.z,
        );
        let pitch = libm::atan2f(
            predicted.x * measured_across - measured.x * predicted_across,
            measured_across * predicted_across + measured.x * predicted.x,
        );
        Innovation {
            roll: (pitch_cosine_squared > LEAST_PITCH_COSINE_SQUARED).then_some(roll),
            pitch,
            pitch_cosine_squared,
        }
    }

    /// Turns changes of roll and pitch (or their rates) into a rotation vector in body axes.
    fn in_body(&self, roll: f32, pitch: f32) -> Vector3 {
        Vector3::new(roll, pitch * self.roll_cosine, -pitch * self.roll_sine)
    }

    fn turn(&mut self, rotation_rad: Vector3) {
        let rotation = Quaternion::from_rotation_vector(rotation_rad);
        self.attitude = self.attitude.multiply(rotation);
    }
}

/// Difference of the measured from the predicted direction of down.
struct Innovation {
    /// In radians, within ±π; none at the pole.
    roll: Option<f32>,
    /// In radians.
    pitch: f32,
    /// The smaller of the measured and the predicted cos² of pitch.
    pitch_cosine_squared: f32,
}

fn clamp_bias(bias_rad_s: f32) -> f32 {
    bias_rad_s.clamp(-LARGEST_BIAS_RAD_S, LARGEST_BIAS_RAD_S)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::BodyVector;
    use crate::estimator::Estimator;
    use crate::estimator::tests::{angle_between, from_degrees, sample};

    /// Returns a sample in body axes; the filter alone does not look at its time.
    fn untimed(force_m_s2: Vector3, rate_rad_s: Vector3) -> Sample {
        Sample::new(0, BodyVector(force_m_s2), BodyVector(rate_rad_s))
    }

    /// Turns a true attitude by body rates that change with time, and follows it with the filter.
    /// Returns the largest angle between the two, in degrees.
    fn follow(
        start: Quaternion,
        step_us: impl Fn(u64) -> u64,
        seconds: f32,
        rate_rad_s: impl Fn(f32) -> Vector3,
    ) -> f32 {
        let mut estimator = Estimator::with_filter(AxisKalman::new());
        let mut truth = start;
        let mut worst = 0.0_f32;
        let mut last = None;
        let (mut t_us, mut index) = (0, 0);
        while (t_us as f32) < seconds * 1e6 {
            let rate = rate_rad_s(t_us as f32 * 1e-6);
            let attitude = estimator.update(&sample(t_us, truth, rate)).attitude;
            worst = worst.max(angle_between(attitude, truth));
            assert!(
                attitude.dot(last.unwrap_or(attitude)) > 0.9,
                "the sign jumped"
            );
            last = Some(attitude);
            let step = step_us(index);
            // Much finer than the filter's own steps.
            for part in 0..20 {
                let at = t_us as f32 * 1e-6 + (part as f32 + 0.5) * 0.05 * step as f32 * 1e-6;
                let turn = rate_rad_s(at).scale(step as f32 * 0.05e-6);
                truth = truth
                    .multiply(Quaternion::from_rotation_vector(turn))
                    .normalize();
            }
            t_us += step;
            index += 1;
        }
        worst
    }

    const fn degrees_s(x: f32, y: f32, z: f32) -> Vector3 {
        Vector3::new(radians(x), radians(y), radians(z))
    }

    #[test]
    fn roll_follows_full_turns() {
        let worst = follow(
            Quaternion::IDENTITY,
            |_| 1000,
            4.0,
            |_| degrees_s(720.0, 0.0, 0.0),
        );
        assert!(worst < 0.05, "{worst}");
    }

    #[test]
    fn roll_that_swings_about_180_degrees_does_not_jump() {
        let worst = follow(
            from_degrees(180.0, 0.0, 0.0),
            |_| 1000,
            4.0,
            |t| degrees_s(200.0 * (6.0 * t).cos(), 0.0, 0.0),
        );
        assert!(worst < 0.05, "{worst}");
    }

    #[test]
    fn pitch_goes_over_the_poles() {
        // With some roll rate as well, so that the poles are passed on both sides.
        for roll_rate in [0.0, 3.0, -20.0] {
            let worst = follow(
                Quaternion::IDENTITY,
                |_| 1000,
                8.0,
                |_| degrees_s(roll_rate, 120.0, 0.0),
            );
            assert!(worst < 0.5, "{roll_rate}: {worst}");
        }
    }

    #[test]
    fn a_pose_at_the_pole_is_held() {
        for pitch in [90.0, -90.0, 89.9, -89.5] {
            let pose = from_degrees(0.0, pitch, 0.0);
            let worst = follow(pose, |_| 1000, 5.0, |_| Vector3::ZERO);
            assert!(worst < 0.1, "{pitch}: {worst}");
        }
    }

    #[test]
    fn a_sample_at_the_exact_pole_leaves_a_finite_attitude() {
        // Neither the measured nor the predicted direction has anything left across the axis.
        let mut filter = AxisKalman::new();
        filter.attitude = Quaternion::new(0.5_f32.sqrt(), 0.0, 0.5_f32.sqrt(), 0.0);
        filter.has_tilt = true;
        let update = |filter: &mut AxisKalman, force| {
            filter.update(&untimed(force, Vector3::ZERO), 1e-3, true);
        };
        let before = filter.attitude;
        for _ in 0..1000 {
            update(&mut filter, Vector3::new(9.8, 0.0, 0.0));
        }
        assert!(angle_between(filter.attitude, before) < 1e-3);
        // Away from the pole roll is corrected as usual.
        let pose = from_degrees(20.0, 0.0, 0.0);
        for _ in 0..10_000 {
            update(&mut filter, -pose.down_in_body().scale(9.8));
        }
        let tilt_error = (filter.attitude.down_in_body() - pose.down_in_body()).norm();
        assert!(tilt_error < 1e-3, "{filter:?}");
    }

    #[test]
    fn roll_is_not_corrected_while_either_direction_is_at_the_pole() {
        let at = |roll, pitch| {
            let mut filter = AxisKalman::new();
            filter.attitude = from_degrees(roll, pitch, 0.0);
            filter
        };
        let down = |roll, pitch| from_degrees(roll, pitch, 0.0).down_in_body();
        assert!(at(0.0, 89.9).innovation(down(20.0, 45.0)).roll.is_none());
        assert!(at(20.0, 45.0).innovation(down(0.0, -89.9)).roll.is_none());
        let roll = at(10.0, 60.0).innovation(down(15.0, -60.0)).roll;
        assert!(roll.is_some_and(|roll| (roll.to_degrees() - 5.0).abs() < 1e-3));
    }

    #[test]
    fn near_the_pole_the_accelerometer_corrects_roll_less() {
        // Correction of a settled filter by one measurement of a roll 1° away.
        let pull = |pitch: f32| {
            let down = |roll| from_degrees(roll, pitch, 0.0).down_in_body();
            let mut filter = AxisKalman::new();
            for _ in 0..5_000 {
                filter.update(&untimed(-down(0.0).scale(9.8), Vector3::ZERO), 1e-3, true);
            }
            filter.correct(down(1.0));
            filter.attitude.to_euler().roll_rad.to_degrees()
        };
        // R grows as 1/cos² and the gain falls a little slower, since the variance grows with it.
        let ratio = pull(80.0) / pull(0.0);
        assert!((0.05..0.3).contains(&ratio), "{ratio}");
    }

    #[test]
    fn the_quaternion_keeps_its_length() {
        let mut filter = AxisKalman::new();
        for _ in 0..300_000 {
            filter.update(
                &untimed(Vector3::ZERO, degrees_s(300.0, -200.0, 100.0)),
                1e-3,
                false,
            );
        }
        let squared = filter.attitude.dot(filter.attitude);
        assert!((squared - 1.0).abs() < 1e-6, "{squared}");
    }

    #[test]
    fn both_axes_tilted_turn_into_each_other() {
        // A yaw of the body with the wing down 60° and the nose up 40° moves every Euler angle.
        let worst = follow(
            from_degrees(60.0, 40.0, 0.0),
            |_| 1000,
            5.0,
            |t| degrees_s(30.0 * t.sin(), 20.0, 90.0),
        );
        assert!(worst < 0.5, "{worst}");
    }

    #[test]
    fn uneven_steps_make_no_difference() {
        let steps = [1000, 1, 3000, 999, 20_000, 1000, 500];
        let worst = follow(
            Quaternion::IDENTITY,
            |index| steps[index as usize % steps.len()],
            5.0,
            |t| degrees_s(100.0 * (3.0 * t).sin(), 60.0 * (2.0 * t).cos(), 30.0),
        );
        assert!(worst < 0.2, "{worst}");
    }

    #[test]
    fn tilt_converges_and_the_bias_is_found() {
        let mut estimator = Estimator::with_filter(AxisKalman::new());
        let pose = from_degrees(-30.0, 20.0, 0.0);
        // Both in Euler rates: pitch moves by q·cos(roll) − r·sin(roll).
        let bias = degrees_s(2.0, -3.0, 0.0);
        let mut after_five_seconds = 0.0_f32;
        for millisecond in 0..20_000 {
            let attitude = estimator
                .update(&sample(millisecond * 1000, pose, bias))
                .attitude;
            let error = (attitude.down_in_body() - pose.down_in_body()).norm();
            if millisecond > 5_000 {
                after_five_seconds = after_five_seconds.max(error.to_degrees());
            }
        }
        assert!(after_five_seconds < 0.05, "{after_five_seconds}");
    }

    #[test]
    fn a_wrong_tilt_decays_along_the_shorter_arc() {
        // The filter starts at 170° of roll. The truth is −170°: 20° further, not 340° back.
        let mut filter = AxisKalman::new();
        filter.set_tilt(from_degrees(170.0, 0.0, 0.0).down_in_body());
        let force = -from_degrees(-170.0, 0.0, 0.0).down_in_body().scale(9.8);
        let sample = untimed(force, Vector3::ZERO);
        let mut roll = 170.0;
        for _ in 0..5_000 {
            filter.update(&sample, 1e-3, true);
            roll = filter.attitude().to_euler().roll_rad.to_degrees();
            assert!(roll.abs() > 160.0, "{roll}");
        }
        assert!((roll + 170.0).abs() < 0.1, "{roll}");
    }

    #[test]
    fn a_correction_changes_neither_yaw_nor_the_other_angle() {
        let mut filter = AxisKalman::new();
        filter.attitude = from_degrees(50.0, 30.0, 80.0);
        filter.has_tilt = true;
        let force = |roll, pitch| -from_degrees(roll, pitch, 0.0).down_in_body().scale(9.8);
        // First a measurement that disagrees in roll alone, then in pitch alone.
        for (roll, pitch) in [(52.0, 30.0), (50.0, 33.0)] {
            let mut filter = filter;
            for _ in 0..10_000 {
                filter.update(&untimed(force(roll, pitch), Vector3::ZERO), 1e-3, true);
            }
            let angles = filter.attitude().to_euler();
            assert!(
                (angles.roll_rad.to_degrees() - roll).abs() < 0.02,
                "{angles:?}"
            );
            assert!(
                (angles.pitch_rad.to_degrees() - pitch).abs() < 0.02,
                "{angles:?}"
            );
            assert!(
                (angles.yaw_rad.to_degrees() - 80.0).abs() < 0.05,
                "{angles:?}"
            );
        }
    }

    #[test]
    fn yaw_integrates_from_zero() {
        let mut estimator = Estimator::with_filter(AxisKalman::new());
        for millisecond in 0..=2_000 {
            let truth = from_degrees(0.0, 0.0, 0.09 * millisecond as f32);
            let estimate = estimator.update(&sample(
                millisecond * 1000,
                truth,
                degrees_s(0.0, 0.0, 90.0),
            ));
            assert!(angle_between(estimate.attitude, truth) < 0.01);
        }
        let yaw = estimator
            .estimate()
            .attitude
            .to_euler()
            .yaw_rad
            .to_degrees();
        assert!((yaw.abs() - 180.0).abs() < 0.01, "{yaw}");
    }

    #[test]
    fn the_bias_stays_within_the_datasheet() {
        let mut filter = AxisKalman::new();
        for step in 0..20_000 {
            // A centrifuge: the force shows 90° of roll, the gyroscope shows no rotation.
            let sideways = Vector3::new(0.0, if step < 10_000 { -9.8 } else { 9.8 }, 0.1);
            filter.update(
                &untimed(sideways, degrees_s(500.0, -500.0, 0.0)),
                1e-3,
                true,
            );
            assert!(filter.roll.bias.abs() <= LARGEST_BIAS_RAD_S);
            assert!(filter.pitch.bias.abs() <= LARGEST_BIAS_RAD_S);
        }
        assert_eq!(filter.roll.bias.abs(), LARGEST_BIAS_RAD_S);
    }
}
