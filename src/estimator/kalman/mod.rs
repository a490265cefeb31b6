//! KALMANDOC

mod covariance;
mod matrix;
mod mean;
mod rest;
mod tuning;

pub use tuning::Tuning;

use crate::attitude::{Quaternion, Vector3};
use crate::units::{STANDARD_GRAVITY_M_S2, radians};
use covariance::{Measurement, State, Step};
use matrix::{Column, Covariance, TURNING, Transition};
use mean::{EarthStep, Mean};
use rest::Rest;

/// The zero-rate offset ends here: 20 °/s, and 20 more over temperature (product specification §6.1).
const LARGEST_BIAS_RAD_S: f32 = radians(40.0);
/// The accelerometer's ends here: 80 mg, and 60 more over temperature (ibidem, §6.2).
const LARGEST_FORCE_BIAS_M_S2: f32 = 0.14 * STANDARD_GRAVITY_M_S2;
/// The gyroscope's scale is within 3 %, its axes within 2 % (ibidem, §6.1); and some more.
const LARGEST_MATRIX_ERROR: f32 = 0.1;

/// The bias counts as known when the σ of each axis is below this.
const KNOWN_BIAS_RAD_S: f32 = radians(0.5);

/// A full-scale reading hides how fast the body turns: tilt variance per second, rad²/s.
const SATURATED_TILT: f32 = 0.3;
/// The same for how hard it is pushed: velocity variance per second, (m/s)²/s.
const SATURATED_VELOCITY: f32 = 100.0;
/// Between samples farther apart than this the rate is not known to change linearly, s.
const LONG_STEP_S: f32 = 0.015;

/// Time constant in which the mean specific force has to agree with gravity, s.
const RECOVERY_TIME_S: f32 = 1.5;
/// σ of the tilt after a recovery, rad.
const RECOVERED_TILT_RAD: f32 = 0.3;

/// The filter's state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Kalman {
    tuning: &'static Tuning,
    delay_s: f32,
    is_armed: bool,
    has_tilt: bool,
    is_bias_known: bool,
    mean: Mean,
    step: Step,
    interval: Interval,
    rest: Rest,
    usual: UsualVelocity,
    /// Variance of each bias's prior, (rad/s)².
    bias_prior: [f32; 3],
    /// The mean specific force in earth axes over [`RECOVERY_TIME_S`], m/s².
    mean_force_m_s2: Vector3,
}

/// Sums since the last covariance step began.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Interval {
    transition: Transition,
    velocity_m_s: [f32; 2],
    duration_s: f32,
    /// ∫|ω|² dt, rad²/s.
    squared_rate: f32,
    /// Tilt variance of what was not measured, rad².
    tilt_variance: f32,
    /// Velocity variance of the same, (m/s)².
    velocity_variance: f32,
}

impl Interval {
    const EMPTY: Self = Self {
        transition: Transition::NONE,
        velocity_m_s: [0.0; 2],
        duration_s: 0.0,
        squared_rate: 0.0,
        tilt_variance: 0.0,
        velocity_variance: 0.0,
    };
}

/// How much the vehicle has been moving of late.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct UsualVelocity {
    smooth_m_s: [f32; 2],
    squared: f32,
    age_s: f32,
}

impl UsualVelocity {
    const NONE: Self = Self {
        smooth_m_s: [0.0; 2],
        squared: 0.0,
        age_s: 0.5,
    };

    fn update(&mut self, velocity_m_s: [f32; 2], duration_s: f32, tuning: &Tuning) {
        let share = duration_s / (tuning.velocity_smoothing_s + duration_s);
        for (smooth, velocity) in self.smooth_m_s.iter_mut().zip(velocity_m_s) {
            *smooth += share * (velocity - *smooth);
        }
        // A plain average at first, which then forgets.
        self.age_s = (self.age_s + duration_s).min(tuning.velocity_time_s);
        let [north, east] = self.smooth_m_s;
        self.squared +=
            duration_s / (self.age_s + duration_s) * (north * north + east * east - self.squared);
    }
}

/// What one sample brings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Reading {
    pub(super) rate_rad_s: Vector3,
    pub(super) force_m_s2: Vector3,
    pub(super) is_rate_saturated: bool,
    pub(super) is_force_saturated: bool,
}

impl Default for Kalman {
    fn default() -> Self {
        Self::new()
    }
}

impl Kalman {
    /// A filter without an attitude.
    pub const fn new() -> Self {
        Self::with_tuning(&Tuning::DEFAULT)
    }

    /// A filter with a tuning of one's own.
    pub const fn with_tuning(tuning: &'static Tuning) -> Self {
        Self {
            tuning,
            delay_s: 0.0,
            is_armed: false,
            has_tilt: false,
            is_bias_known: false,
            mean: Mean::new(),
            step: Step::new(),
            interval: Interval::EMPTY,
            rest: Rest::new(),
            usual: UsualVelocity::NONE,
            bias_prior: [square(tuning.start_bias_rad_s); 3],
            mean_force_m_s2: Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2),
        }
    }

    /// Says by how much the sensor lags the motion, s; the attitude is extrapolated by that.
    pub const fn set_delay(&mut self, delay_s: f32) {
        self.delay_s = delay_s;
    }

    /// Switches off (`true`) what is only safe on the ground: taking stillness for rest.
    pub const fn set_armed(&mut self, is_armed: bool) {
        self.is_armed = is_armed;
    }

    /// Starts from a known gyroscope bias (rad/s, body axes) with a σ per axis; call it before the first sample.
    pub fn set_bias(&mut self, bias_rad_s: Vector3, sigma_rad_s: f32) {
        self.mean.bias_rad_s = bias_rad_s;
        self.mean.derive_offset();
        self.bias_prior = [square(sigma_rad_s); 3];
    }

    /// Forgets everything but its settings and the quaternion's sign.
    pub(super) fn restart(&mut self) {
        *self = Self {
            delay_s: self.delay_s,
            is_armed: self.is_armed,
            ..Self::with_tuning(self.tuning)
        };
    }

    /// The first sample, or the first after a gap: takes roll and pitch from the specific force if it shows gravity, and keeps yaw and what is known of the sensor.
    pub(super) fn start(&mut self, reading: &Reading, shows_gravity: bool) {
        let tuning = self.tuning;
        if !self.has_tilt {
            self.step.covariance = start_covariance(tuning, &self.bias_prior);
        }
        self.forget_motion(square(tuning.start_tilt_rad));
        if shows_gravity {
            let down = -reading.force_m_s2;
            self.mean.attitude = self.mean.attitude.with_down(down);
            self.has_tilt = true;
        }
        self.rest.begin(reading.rate_rad_s, reading.force_m_s2);
        self.mean.begin(reading.rate_rad_s, reading.force_m_s2);
    }

    /// One step of `dt_s` seconds.
    pub(super) fn update(&mut self, reading: &Reading, dt_s: f32, shows_gravity: bool) {
        if !self.has_tilt && shows_gravity {
            self.start(reading, true);
            return;
        }
        if dt_s > LONG_STEP_S || reading.is_rate_saturated || reading.is_force_saturated {
            self.note_what_is_missed(reading, dt_s);
        }
        let elapsed_s = self.mean.add(reading.rate_rad_s, reading.force_m_s2, dt_s);
        let is_earth_step = elapsed_s >= self.tuning.earth_period_s;
        if is_earth_step {
            let step = self.mean.step(&mut self.interval.transition);
            self.note(&step);
            self.rest.update(
                reading.rate_rad_s,
                reading.force_m_s2,
                step.duration_s,
                self.tuning,
            );
        }
        // One slice a sample, where a step in earth axes leaves room; more where samples are rare.
        if !is_earth_step || dt_s > SLICE_TIME_S {
            let mut slices = 1 + ((dt_s * (1.0 / SLICE_TIME_S)) as u32).min(MOST_SLICES);
            while slices > 0 && self.slice() {
                slices -= 1;
            }
        }
    }

    /// Body to earth, extrapolated from the time of the last sample's motion to that of its stamp.
    pub(super) fn attitude(&self) -> Quaternion {
        self.mean.ahead(self.delay_s)
    }

    /// The body's rates p, q, r, rad/s: the last reading without bias, scale error and misalignment.
    pub(super) fn body_rates_rad_s(&self) -> Vector3 {
        self.mean.rate_rad_s
    }

    /// The gyroscope's bias, rad/s in body axes.
    pub fn bias_rad_s(&self) -> Vector3 {
        self.mean.bias_rad_s
    }

    /// σ of [`bias_rad_s`](Self::bias_rad_s), rad/s.
    pub fn bias_sigma_rad_s(&self) -> Vector3 {
        let sigma = |axis| sigma(self.step.covariance.constant_variance(axis));
        Vector3::new(sigma(0), sigma(1), sigma(2))
    }

    /// The accelerometer's bias, m/s² in body axes.
    pub fn force_bias_m_s2(&self) -> Vector3 {
        self.mean.force_bias_m_s2
    }

    /// σ of [`force_bias_m_s2`](Self::force_bias_m_s2), m/s².
    pub fn force_bias_sigma_m_s2(&self) -> Vector3 {
        let sigma = |axis| sigma(self.step.covariance.constant_variance(TURNING + axis));
        Vector3::new(sigma(0), sigma(1), sigma(2))
    }

    /// σ of the direction of down, rad: the root of the sum of both tilt variances.
    pub fn tilt_sigma_rad(&self) -> f32 {
        sigma(self.step.covariance.moving_variance(0) + self.step.covariance.moving_variance(1))
    }

    /// The acceleration of the body without gravity, m/s² in body axes.
    pub fn linear_acceleration_m_s2(&self) -> Vector3 {
        let gravity = self
            .mean
            .ahead(0.0)
            .down_in_body()
            .scale(STANDARD_GRAVITY_M_S2);
        self.mean.force_m_s2 - self.mean.force_bias_m_s2 + gravity
    }

    /// Whether the gyroscope's bias is known to [`KNOWN_BIAS_RAD_S`] on every axis.
    pub fn is_bias_known(&self) -> bool {
        self.is_bias_known
    }

    /// What saturation and long steps hide.
    #[cold]
    fn note_what_is_missed(&mut self, reading: &Reading, dt_s: f32) {
        if dt_s > LONG_STEP_S {
            let change = self.mean.corrected(reading.rate_rad_s) - self.mean.rate_rad_s;
            self.interval.tilt_variance += change.dot(change) * square(0.25 * dt_s);
        }
        if reading.is_rate_saturated {
            self.interval.tilt_variance += SATURATED_TILT * dt_s;
        }
        if reading.is_force_saturated {
            self.interval.velocity_variance += SATURATED_VELOCITY * dt_s;
        }
    }

    /// Keeps the sums that a covariance step needs.
    fn note(&mut self, step: &EarthStep) {
        let interval = &mut self.interval;
        let [north, east] = &mut interval.velocity_m_s;
        *north += step.velocity_m_s.x;
        *east += step.velocity_m_s.y;
        interval.duration_s += step.duration_s;
        interval.squared_rate += step.turned_rad.dot(step.turned_rad) / step.duration_s;
    }

    /// Does the next piece of covariance work; false if there is none.
    fn slice(&mut self) -> bool {
        if self.step.is_idle() {
            let is_due = self.interval.duration_s >= self.tuning.covariance_period_s;
            if is_due && self.has_tilt {
                self.begin();
            }
            return is_due;
        }
        if self.step.slice() {
            self.correct();
        }
        true
    }

    /// Closes the interval and begins its covariance step.
    fn begin(&mut self) {
        let tuning = self.tuning;
        let interval = core::mem::replace(&mut self.interval, Interval::EMPTY);
        let duration_s = interval.duration_s;
        let velocity = &mut self.mean.velocity_m_s;
        let velocity_m_s = [
            velocity[0] + interval.velocity_m_s[0],
            velocity[1] + interval.velocity_m_s[1],
        ];
        *velocity = velocity_m_s;
        if self.recover(&interval) {
            return;
        }

        let usual = self.usual.squared;
        let covariance = &mut self.step.covariance;
        // Q, but for the constants' own: what the interval adds that no state explains.
        let tilt = covariance.moving_variance(0) + covariance.moving_variance(1);
        let bias = covariance.constant_variance(0)
            + covariance.constant_variance(1)
            + covariance.constant_variance(2);
        let tilt_noise = square(tuning.rate_noise) * duration_s
            + square(tuning.rate_noise_per_rate) * interval.squared_rate
            + square(tuning.coupling) * bias * tilt * duration_s
            + interval.tilt_variance;
        let velocity_noise = (square(tuning.force_noise)
            + square(tuning.force_noise_per_velocity) * usual)
            * duration_s
            + interval.velocity_variance;
        self.step
            .begin(&interval.transition, [tilt_noise, velocity_noise]);
        let covariance = &mut self.step.covariance;
        for axis in 0..3 {
            covariance.add_to_constant(axis, square(tuning.bias_walk) * duration_s);
            covariance.add_to_constant(TURNING + axis, square(tuning.force_bias_walk) * duration_s);
        }

        self.usual.update(velocity_m_s, duration_s, tuning);
        let mut velocity_variance = (square(tuning.velocity)
            + square(tuning.velocity_per_velocity) * self.usual.squared)
            .min(square(tuning.velocity_limit));
        let rest = if self.is_armed {
            None
        } else {
            self.rest.bias_rad_s(tuning)
        };
        match rest {
            Some(bias_rad_s) => {
                let [north, east] = interval.velocity_m_s;
                let acceleration = square(1.0 / (STANDARD_GRAVITY_M_S2 * duration_s))
                    * (north * north + east * east);
                if acceleration < 16.0 * tilt + square(0.03) {
                    velocity_variance = velocity_variance.min(square(tuning.rest_velocity));
                }
                self.measure_bias(bias_rad_s, square(tuning.rest_rate) / duration_s);
            }
            None => self.doubt_the_prior(),
        }
        let [north, east] = velocity_m_s;
        for (state, velocity) in [(2, north), (3, east)] {
            self.step.measure(Measurement {
                state: State::Moving(state),
                innovation: -velocity,
                variance: velocity_variance / duration_s,
            });
        }
    }

    /// At rest the gyroscope reads its bias, if that is likely.
    fn measure_bias(&mut self, reading_rad_s: Vector3, variance: f32) {
        let difference = reading_rad_s - self.mean.bias_rad_s;
        let innovations = [difference.x, difference.y, difference.z];
        let is_likely = innovations.iter().enumerate().all(|(axis, innovation)| {
            let prior = self.bias_prior.get(axis).copied().unwrap_or(0.0);
            let own = self.step.covariance.constant_variance(axis);
            // As long as the prior is all there is, any bias that the part may have is likely.
            let own = if own > 0.25 * prior {
                square(LARGEST_BIAS_RAD_S)
            } else {
                own
            };
            square(*innovation) < 16.0 * (own + square(self.tuning.rest_rate))
        });
        if is_likely {
            for (axis, innovation) in innovations.into_iter().enumerate() {
                self.step.measure(Measurement {
                    state: State::Constant(axis),
                    innovation,
                    variance,
                });
            }
        }
    }

    /// Widens the prior of a bias that lies where the prior said it would not.
    ///
    /// The prior is a measurement "zero, variance p"; to replace p by 2p is to take back a
    /// measurement of variance 2p, which is to make one of variance −2p.
    fn doubt_the_prior(&mut self) {
        let bias = self.mean.bias_rad_s;
        for (axis, bias) in [bias.x, bias.y, bias.z].into_iter().enumerate() {
            let own = self.step.covariance.constant_variance(axis);
            let Some(prior) = self.bias_prior.get_mut(axis) else {
                return;
            };
            let learned = (*prior - own).max(0.02 * *prior);
            if square(bias) > square(self.tuning.surprise) * learned
                && *prior < square(LARGEST_BIAS_RAD_S)
                && own < *prior * 1.5
            {
                self.step.measure(Measurement {
                    state: State::Constant(axis),
                    innovation: -bias,
                    variance: -2.0 * *prior,
                });
                *prior *= 2.0;
            }
        }
    }

    /// Finds a tilt that is so wrong that the linear model does not lead back.
    fn recover(&mut self, interval: &Interval) -> bool {
        let inverse = 1.0 / interval.duration_s;
        let [north, east] = interval.velocity_m_s;
        let force = Vector3::new(north, east, interval.transition.vertical_m_s).scale(inverse);
        let share = (interval.duration_s / RECOVERY_TIME_S).min(1.0);
        self.mean_force_m_s2 = self.mean_force_m_s2 + (force - self.mean_force_m_s2).scale(share);
        let mean = self.mean_force_m_s2;
        let squared = mean.dot(mean);
        const LEAST: f32 = 0.7 * STANDARD_GRAVITY_M_S2;
        const GREATEST: f32 = 1.4 * STANDARD_GRAVITY_M_S2;
        let is_gravity = (LEAST * LEAST..GREATEST * GREATEST).contains(&squared);
        let is_down = mean.z < 0.0 && 2.0 * square(mean.z) > squared;
        if !is_gravity || is_down {
            return false;
        }
        self.mean.attitude = shortest_to_up(mean)
            .multiply(self.mean.attitude)
            .normalize();
        self.forget_motion(square(RECOVERED_TILT_RAD));
        true
    }

    /// Forgets velocity and what is known of tilt, and whatever covariance step was under way.
    fn forget_motion(&mut self, tilt_variance: f32) {
        let velocity_variance = square(self.tuning.start_velocity_m_s);
        let covariance = &mut self.step.covariance;
        for (state, variance) in [
            tilt_variance,
            tilt_variance,
            velocity_variance,
            velocity_variance,
        ]
        .into_iter()
        .enumerate()
        {
            covariance.reset_moving(state, variance);
        }
        self.step.abandon();
        self.interval = Interval::EMPTY;
        self.mean.velocity_m_s = [0.0; 2];
        self.mean_force_m_s2 = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
    }

    /// Applies the corrections of the covariance step, carried from its time to now.
    fn correct(&mut self) {
        let Column {
            mut moving,
            constants,
        } = self.step.correction;
        self.interval.transition.carry(&mut moving, &constants);
        let is_sound = moving
            .iter()
            .chain(&constants)
            .all(|change| change.abs() < 1.0e3)
            && self.step.covariance.is_sound();
        if !is_sound {
            // Only readings that no sensor delivers lead here. Begin again, at once, and keep yaw.
            let attitude = self.mean.attitude;
            self.restart();
            self.mean.attitude = attitude;
            return;
        }
        self.mean.correct(&moving, &constants);
        let bias_sigma = self.bias_sigma_squared();
        self.is_bias_known = bias_sigma < square(KNOWN_BIAS_RAD_S);
    }

    fn bias_sigma_squared(&self) -> f32 {
        let variance = |axis| self.step.covariance.constant_variance(axis);
        variance(0).max(variance(1)).max(variance(2))
    }
}

/// A slice of covariance work is due in this time, s.
const SLICE_TIME_S: f32 = 2.0e-3;
/// More than a whole covariance step has.
const MOST_SLICES: u32 = 80;

#[inline]
const fn square(number: f32) -> f32 {
    number * number
}

fn sigma(variance: f32) -> f32 {
    libm::sqrtf(variance.max(0.0))
}

/// Before the first sample: everything at its prior.
fn start_covariance(tuning: &Tuning, bias_prior: &[f32; 3]) -> Covariance {
    let mut covariance = Covariance::ZERO;
    for (axis, prior) in bias_prior.iter().enumerate() {
        covariance.add_to_constant(axis, *prior);
        covariance.add_to_constant(TURNING + axis, square(tuning.force_bias_m_s2));
        for column in 0..3 {
            let sigma = if column == axis {
                tuning.scale
            } else {
                tuning.misalignment_rad
            };
            covariance.add_to_constant(3 + 3 * axis + column, square(sigma));
        }
    }
    covariance
}

/// The shortest turn that brings this direction, which is not zero, up: to (0, 0, −1).
fn shortest_to_up(direction: Vector3) -> Quaternion {
    let norm = direction.norm();
    // w = 1 + cos and the axis is direction × up; both vanish where it points straight down.
    let w = norm - direction.z;
    if w < 1.0e-3 * norm {
        return Quaternion::new(0.0, 1.0, 0.0, 0.0);
    }
    Quaternion::new(w, -direction.y, direction.x, 0.0).normalize()
}
