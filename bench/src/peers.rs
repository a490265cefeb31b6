//! Filters of others behind one interface, under equal conditions.
//!
//! Each filter gets samples in forward-left-up axes and returns a rotation to an earth with z up.
//! This module converts to and from the library's axes. A rate is that of its instant, so the mean
//! of two rates moves a filter from one sample to the next. Its attitude is then that of the last
//! sample's time, without a lead of half a step. For this reason, filters that compare the specific
//! force with the attitude of the sample before get that sample's force. Filters that take a step's
//! length get it; the others get the recording's median. Filters that take a first attitude get
//! that of the first specific force; the others find their own.
//!
//! Gains: one set for all recordings, the best that `aplomb-bench --scan-gains` found on 14 trials
//! of BROAD and three rooms of TUM-VI by the mean error, with equal weights for both sets. VQF
//! keeps the tuning of its authors, which is meant to fit everything ([`vqf`]).

use std::f64::consts::FRAC_1_SQRT_2;

use ahrs::Ahrs as _;
use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::{Estimate, LONGEST_STEP_US, Sample};
use aplomb::units::{STANDARD_GRAVITY_M_S2, degrees};
use aplomb_models::motion::geometry::Quaternion as Quaternion64;
use nalgebra::UnitQuaternion;

use crate::vqf;

/// Step from one sample to the next, in forward-left-up axes.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// Mean of the two samples' rates, rad/s.
    pub rates: [f32; 3],
    /// Specific force at the beginning, m/s².
    pub force_before: [f32; 3],
    /// Specific force at the end, m/s².
    pub force: [f32; 3],
    /// Length, s.
    pub dt_s: f32,
    /// Magnetic field at the end, if there is a new reading, µT.
    pub field: Option<[f32; 3]>,
}

impl Step {
    /// Returns the step between two samples.
    pub fn new(before: &Sample, after: &Sample) -> Self {
        let rates = before.angular_rate_rad_s + after.angular_rate_rad_s;
        Self {
            rates: flip(rates.scale(0.5)),
            force_before: flip(before.specific_force_m_s2),
            force: flip(after.specific_force_m_s2),
            dt_s: after.t_us.saturating_sub(before.t_us) as f32 * 1e-6,
            field: None,
        }
    }
}

/// Gains of a filter, at most two numbers; each filter documents its own.
pub type Gains = [f32; 2];

/// Filter in forward-left-up axes.
pub trait Filter {
    /// Gains in use.
    const GAINS: Gains;
    /// Creates a filter that starts in this attitude, for samples that are `step_s` apart.
    fn new(start: [f32; 4], step_s: f32, gains: Gains) -> Self;
    /// Takes one step.
    fn step(&mut self, step: &Step);
    /// Returns the rotation sensor → earth with z up, as w, x, y, z.
    fn attitude(&self) -> [f32; 4];
}

/// Filter of others, with the library's axes and timing.
pub struct Peer {
    filter: Box<dyn Turning>,
    restart: fn([f32; 4], f32, Gains) -> Box<dyn Turning>,
    step_s: f32,
    gains: Gains,
    last: Option<Sample>,
}

/// Part of [`Filter`] that works on a trait object.
trait Turning {
    fn step(&mut self, step: &Step);
    fn attitude(&self) -> [f32; 4];
}

impl<F: Filter> Turning for F {
    fn step(&mut self, step: &Step) {
        Filter::step(self, step);
    }

    fn attitude(&self) -> [f32; 4] {
        Filter::attitude(self)
    }
}

impl Peer {
    /// Creates a filter for samples that are about `step_s` apart, with these gains or those in
    /// use.
    pub fn new<F: Filter + 'static>(step_s: f32, gains: Option<Gains>) -> Self {
        let gains = gains.unwrap_or(F::GAINS);
        Self {
            filter: Box::new(F::new([1.0, 0.0, 0.0, 0.0], step_s, gains)),
            restart: |start, step_s, gains| Box::new(F::new(start, step_s, gains)),
            step_s,
            gains,
            last: None,
        }
    }

    /// Takes one sample, and returns the attitude at its time.
    pub fn update(&mut self, sample: &Sample) -> Estimate {
        let (force, rates) = (sample.specific_force_m_s2, sample.angular_rate_rad_s);
        let is_measurement = force.is_within(f32::MAX) && rates.is_within(f32::MAX);
        if is_measurement {
            match &self.last {
                None => self.filter = (self.restart)(tilt(flip(force)), self.step_s, self.gains),
                // The attitude is held where time went back, and over a gap.
                Some(last) if sample.t_us <= last.t_us => {}
                Some(last) if sample.t_us - last.t_us > LONGEST_STEP_US => {}
                Some(last) => self.filter.step(&Step::new(last, sample)),
            }
            self.last = Some(*sample);
        }
        let mut estimate = Estimate::default();
        estimate.attitude = self.attitude();
        if let Some(last) = &self.last {
            estimate.body_rates_rad_s = last.angular_rate_rad_s;
        }
        estimate
    }

    fn attitude(&self) -> Quaternion {
        let [w, x, y, z] = self.filter.attitude();
        Quaternion::new(w, x, -y, -z)
    }
}

/// Converts forward-right-down to forward-left-up.
pub fn flip(vector: Vector3) -> [f32; 3] {
    [vector.x, -vector.y, -vector.z]
}

/// Returns the rotation without heading in which a sensor at rest feels this specific force,
/// forward-left-up.
pub fn tilt([x, y, z]: [f32; 3]) -> [f32; 4] {
    let (roll, pitch) = (0.5 * y.atan2(z), 0.5 * (-x).atan2(y.hypot(z)));
    [
        roll.cos() * pitch.cos(),
        roll.sin() * pitch.cos(),
        roll.cos() * pitch.sin(),
        -roll.sin() * pitch.sin(),
    ]
}

/// VQF, with the default tuning of its authors but for its gain.
pub struct Vqf {
    filter: vqf::Vqf,
    has_field: bool,
}

impl Vqf {
    /// Creates a filter for samples that are `step_s` apart, and readings of the magnetometer that
    /// are `field_step_s` apart.
    pub fn with_magnetometer(step_s: f32, field_step_s: f32, [force_s, _]: Gains) -> Self {
        // A whole number of microseconds, which `f32` rounds.
        let exact = |step_s: f32| (f64::from(step_s) * 1e6).round() * 1e-6;
        Self {
            filter: vqf::Vqf::new(force_s.into(), exact(step_s), exact(field_step_s)),
            has_field: false,
        }
    }
}

impl Filter for Vqf {
    /// Time constant of the specific force's low-pass filter, s, as its authors chose it.
    const GAINS: Gains = [vqf::FORCE_S as f32, 0.0];

    fn new(_: [f32; 4], step_s: f32, gains: Gains) -> Self {
        Self::with_magnetometer(step_s, step_s, gains)
    }

    fn step(&mut self, step: &Step) {
        let (rates, force) = (step.rates.map(f64::from), step.force.map(f64::from));
        self.filter.update(rates, force);
        if let Some(field) = step.field {
            self.filter.update_field(field.map(f64::from));
            self.has_field = true;
        }
    }

    fn attitude(&self) -> [f32; 4] {
        let attitude = if self.has_field {
            EAST_TO_NORTH.multiply(self.filter.attitude())
        } else {
            self.filter.level_attitude()
        };
        [attitude.w, attitude.x, attitude.y, attitude.z].map(|part| part as f32)
    }
}

/// Turn of the coordinates from east, north, up to north, west, up.
const EAST_TO_NORTH: Quaternion64 = Quaternion64 {
    w: FRAC_1_SQRT_2,
    x: 0.0,
    y: 0.0,
    z: -FRAC_1_SQRT_2,
};

/// Madgwick's filter of 2010, of the `ahrs` crate.
pub struct Madgwick(ahrs::Madgwick<f32>);

impl Filter for Madgwick {
    /// β, in rad/s.
    const GAINS: Gains = [0.015, 0.0];

    fn new(start: [f32; 4], step_s: f32, [beta, _]: Gains) -> Self {
        Self(ahrs::Madgwick::new_with_quat(step_s, beta, unit(start)))
    }

    fn step(&mut self, step: &Step) {
        let (rates, force) = (step.rates.into(), step.force_before.into());
        *self.0.sample_period_mut() = step.dt_s;
        // A zero force gives no correction.
        let corrected = match step.field {
            Some(field) => self.0.update(&rates, &force, &field.into()),
            None => self.0.update_imu(&rates, &force),
        };
        if corrected.is_err() {
            self.0.update_gyro(&rates);
        }
    }

    fn attitude(&self) -> [f32; 4] {
        let q = self.0.quat();
        [q.w, q.i, q.j, q.k]
    }
}

/// Mahony's filter, of the `ahrs` crate.
pub struct Mahony(ahrs::Mahony<f32>);

impl Filter for Mahony {
    /// Proportional, in 1/s, and integral, in 1/s².
    const GAINS: Gains = [0.15, 0.0003];

    fn new(start: [f32; 4], step_s: f32, [proportional, integral]: Gains) -> Self {
        Self(ahrs::Mahony::new_with_quat(
            step_s,
            proportional,
            integral,
            unit(start),
        ))
    }

    fn step(&mut self, step: &Step) {
        let (rates, force) = (step.rates.into(), step.force_before.into());
        *self.0.sample_period_mut() = step.dt_s;
        let corrected = match step.field {
            Some(field) => self.0.update(&rates, &force, &field.into()),
            None => self.0.update_imu(&rates, &force),
        };
        if corrected.is_err() {
            self.0.update_gyro(&rates);
        }
    }

    fn attitude(&self) -> [f32; 4] {
        let q = self.0.quat();
        [q.w, q.i, q.j, q.k]
    }
}

/// x-io Technologies' Fusion, of the `fusion-ahrs` crate.
pub struct Fusion(fusion_ahrs::Ahrs);

impl Filter for Fusion {
    /// Gain, 1/s, and the angle from which on it rejects accelerations, degrees; 0 for never.
    const GAINS: Gains = [0.15, 90.0];

    fn new(_: [f32; 4], step_s: f32, [gain, acceleration_rejection]: Gains) -> Self {
        Self(fusion_ahrs::Ahrs::with_settings(
            fusion_ahrs::AhrsSettings {
                sample_rate: 1.0 / step_s,
                convention: fusion_ahrs::Convention::Nwu,
                gain,
                acceleration_rejection,
                // The settings are those of its authors' example.
                rejection_timeout: 5.0,
                ..Default::default()
            },
        ))
    }

    fn step(&mut self, step: &Step) {
        self.0.set_sample_period(step.dt_s);
        let rates = step.rates.map(degrees);
        let force = step.force_before.map(|part| part / STANDARD_GRAVITY_M_S2);
        match step.field {
            Some(field) => self.0.update(rates, force, field),
            None => self.0.update_no_magnetometer(rates, force),
        }
    }

    fn attitude(&self) -> [f32; 4] {
        let q = self.0.quaternion();
        [q.w, q.x, q.y, q.z]
    }
}

fn unit([w, x, y, z]: [f32; 4]) -> UnitQuaternion<f32> {
    UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z))
}
