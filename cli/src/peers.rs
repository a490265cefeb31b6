//! Filters of other crates behind one interface, so that all are treated alike.
//!
//! Each gets the same samples in forward-left-up axes and gives a rotation to an earth with z up; the change to
//! and from the library's axes is made here. Each is started from the direction of the first specific
//! force. A sample's rate is that of its instant, so what moves a filter from one sample to the next is the mean of
//! the two rates: then its attitude is that of the last sample's time, with no lead of half a step.

use ahrs::Ahrs as _;
use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::{Estimate, LONGEST_STEP_US, Remarks, Sample};

/// A filter that turns in forward-left-up axes.
pub trait Filter {
    /// Takes one step of `dt_s` seconds: rates in rad/s, specific force in m/s².
    fn step(&mut self, rates: [f32; 3], force: [f32; 3], dt_s: f32);
    /// w, x, y, z: sensor → earth with z up.
    fn attitude(&self) -> [f32; 4];
}

/// A filter of another crate, with the time and the axes of the library.
pub struct Peer {
    filter: Box<dyn Filter>,
    make: fn([f32; 4]) -> Box<dyn Filter>,
    last: Option<(u64, Vector3)>,
}

impl Peer {
    /// Mahony's filter of the `ahrs` crate, with its own default gains.
    pub fn mahony() -> Self {
        Self::new(|start| Box::new(Mahony::new(start)))
    }

    fn new(make: fn([f32; 4]) -> Box<dyn Filter>) -> Self {
        Self {
            filter: make([1.0, 0.0, 0.0, 0.0]),
            make,
            last: None,
        }
    }

    /// Takes one sample and gives the attitude at its time.
    pub fn update(&mut self, sample: &Sample) -> Estimate {
        let (force, rates) = (sample.specific_force_m_s2, sample.angular_rate_rad_s);
        let mut remarks = Remarks {
            rejected: !(force.is_within(f32::MAX) && rates.is_within(f32::MAX)),
            ..Remarks::default()
        };
        if !remarks.rejected {
            match self.last {
                None => self.filter = (self.make)(tilt(flip(force))),
                Some((last_us, _)) if sample.t_us <= last_us => remarks.time_went_back = true,
                Some((last_us, _)) if sample.t_us - last_us > LONGEST_STEP_US => remarks.gap = true,
                Some((last_us, last_rates)) => {
                    let dt_s = (sample.t_us - last_us) as f32 * 1e-6;
                    let mean = (last_rates + rates).scale(0.5);
                    self.filter.step(flip(mean), flip(force), dt_s);
                }
            }
            self.last = Some((sample.t_us, rates));
        }
        Estimate {
            attitude: self.attitude(),
            body_rates_rad_s: self.last.map_or(Vector3::ZERO, |(_, rates)| rates),
            remarks,
        }
    }

    fn attitude(&self) -> Quaternion {
        let [w, x, y, z] = self.filter.attitude();
        Quaternion::new(w, x, -y, -z)
    }
}

/// Forward-right-down to forward-left-up.
fn flip(vector: Vector3) -> [f32; 3] {
    [vector.x, -vector.y, -vector.z]
}

/// The rotation with no heading in which a sensor at rest feels this specific force.
fn tilt([x, y, z]: [f32; 3]) -> [f32; 4] {
    let (roll, pitch) = (0.5 * y.atan2(z), 0.5 * (-x).atan2(y.hypot(z)));
    [
        roll.cos() * pitch.cos(),
        roll.sin() * pitch.cos(),
        roll.cos() * pitch.sin(),
        -roll.sin() * pitch.sin(),
    ]
}

struct Mahony(ahrs::Mahony<f32>);

impl Mahony {
    fn new([w, x, y, z]: [f32; 4]) -> Self {
        let start = nalgebra::Quaternion::new(w, x, y, z);
        let start = nalgebra::UnitQuaternion::new_normalize(start);
        Self(ahrs::Mahony::new_with_quat(0.0, 0.5, 0.0, start))
    }
}

impl Filter for Mahony {
    fn step(&mut self, rates: [f32; 3], force: [f32; 3], dt_s: f32) {
        *self.0.sample_period_mut() = dt_s;
        // Without any force there is nothing to learn from it.
        if self.0.update_imu(&rates.into(), &force.into()).is_err() {
            self.0.update_gyro(&rates.into());
        }
    }

    fn attitude(&self) -> [f32; 4] {
        let q = self.0.quat();
        [q.w, q.i, q.j, q.k]
    }
}
