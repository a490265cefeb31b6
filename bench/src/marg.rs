//! Filters of other crates with a magnetometer, under equal conditions.
//!
//! They get the same steps as in [`peers`](crate::peers), and each new reading of the compass
//! turned to the time of the last sample. Each starts at the heading of the first reading.
//!
//! The `vqf` crate has no magnetometer. [`Vqf9`] adds the heading correction and the rejection of
//! disturbances as the filter's authors describe them (Laidig and Seel, *VQF*, Information Fusion
//! 91, 2023, §3.4 and §3.6), with their parameters.
//!
//! Gains of the others: the best of a coarse scan on the 14 trials of `broad-mag`.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::{LONGEST_STEP_US, Sample};
use aplomb::units::{MagneticField, degrees};
use aplomb_recordings::attitude::extrapolate;

use crate::peers::{Filter, Fusion, Madgwick, Mahony, Step, Vqf, flip, tilt};

/// Filter with a magnetometer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// VQF with magnetometer.
    Vqf,
    /// x-io Technologies' Fusion.
    Fusion,
    /// Madgwick's.
    Madgwick,
    /// Mahony's.
    Mahony,
}

impl Choice {
    /// Every filter.
    pub const ALL: [Self; 4] = [Self::Vqf, Self::Fusion, Self::Madgwick, Self::Mahony];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Vqf => "vqf 9d",
            Self::Fusion => "fusion",
            Self::Madgwick => "madgwick",
            Self::Mahony => "mahony",
        }
    }
}

/// Runs a filter, and calls `note` with the index and the absolute attitude of each sample from the
/// first reading on: body to north, east, down.
pub fn run(
    choice: Choice,
    step_s: f32,
    delays_s: [f32; 2],
    rows: impl Iterator<Item = (Sample, Option<MagneticField>)>,
    note: impl FnMut(usize, Quaternion),
) {
    match choice {
        Choice::Vqf => run_filter::<Vqf9>(Vqf::GAINS, step_s, delays_s, rows, note),
        Choice::Fusion => run_filter::<Fusion>([0.3, 90.0], step_s, delays_s, rows, note),
        Choice::Madgwick => run_filter::<Madgwick>([0.2, 0.0], step_s, delays_s, rows, note),
        Choice::Mahony => run_filter::<Mahony>([1.0, 0.0], step_s, delays_s, rows, note),
    }
}

fn run_filter<F: Filter>(
    gains: [f32; 2],
    step_s: f32,
    [delay_s, age_s]: [f32; 2],
    rows: impl Iterator<Item = (Sample, Option<MagneticField>)>,
    mut note: impl FnMut(usize, Quaternion),
) {
    let mut running: Option<(F, Sample)> = None;
    for (index, (sample, field)) in rows.enumerate() {
        let rates = sample.angular_rate_rad_s;
        let turn = Quaternion::from_rotation_vector(rates.scale(-age_s));
        let field = field.map(|MagneticField { ut: [x, y, z] }| {
            let present = turn.rotate(Vector3::new(x, y, z));
            flip(present)
        });
        let Some((filter, last)) = &mut running else {
            running = field.map(|field| {
                let start = start(flip(sample.specific_force_m_s2), field);
                (F::new(start, step_s, gains), sample)
            });
            continue;
        };
        if sample.t_us > last.t_us && sample.t_us - last.t_us <= LONGEST_STEP_US {
            let step = Step {
                field,
                ..Step::new(last, &sample)
            };
            filter.step(&step);
        }
        *last = sample;
        let [w, x, y, z] = filter.attitude();
        let attitude = Quaternion::new(w, x, -y, -z);
        note(index, extrapolate(attitude, rates, delay_s));
    }
}

/// Returns the rotation to north, west, up of a sensor at rest in this field.
fn start(force: [f32; 3], field: [f32; 3]) -> [f32; 4] {
    let [w, x, y, z] = tilt(force);
    let level = Quaternion::new(w, x, y, z);
    let horizontal = level.rotate(Vector3::new(field[0], field[1], field[2]));
    let turn = Vector3::new(0.0, 0.0, -horizontal.y.atan2(horizontal.x));
    let Quaternion { w, x, y, z } = Quaternion::from_rotation_vector(turn).multiply(level);
    [w, x, y, z]
}

/// VQF with magnetometer: the heading correction on top of [`Vqf`].
struct Vqf9 {
    filter: Vqf,
    /// Heading of the filter without magnetometer, rad.
    delta_rad: f32,
    /// Gain of the first readings, whose mean counts.
    first_gain: f32,
    since_s: f32,
    /// Norm and dip of the undisturbed field, and of a new one.
    reference: [f32; 2],
    candidate: [f32; 2],
    is_disturbed: bool,
    undisturbed_s: f32,
    candidate_s: f32,
    rejected_s: f32,
}

/// Time constant of the heading correction, s.
const CORRECTION_S: f32 = 9.0;
/// Time constant of the reference, s.
const REFERENCE_S: f32 = 20.0;
/// Tolerances of the norm, as a share, and of the dip, rad.
const TOLERANCES: [f32; 2] = [0.1, 10.0 / 57.3];
/// Time after which a field counts as undisturbed, s.
const UNDISTURBED_S: f32 = 0.5;
/// Time after which a new field is accepted, and the first one, s.
const NEW_S: f32 = 20.0;
const FIRST_S: f32 = 5.0;
/// Least rate at which a new field is looked at, °/s.
const NEW_RATE_DEG_S: f32 = 20.0;
/// Longest rejection, s.
const REJECTION_S: f32 = 60.0;
/// Divisor of the gain after that.
const REJECTION_FACTOR: f32 = 2.0;

impl Filter for Vqf9 {
    const GAINS: [f32; 2] = Vqf::GAINS;

    fn new(start: [f32; 4], step_s: f32, gains: [f32; 2]) -> Self {
        Self {
            filter: Vqf::new(start, step_s, gains),
            delta_rad: 0.0,
            first_gain: 1.0,
            since_s: 0.0,
            reference: [0.0; 2],
            candidate: [-1.0, 0.0],
            is_disturbed: true,
            undisturbed_s: 0.0,
            candidate_s: 0.0,
            // The first field is followed, slowly, before it is accepted.
            rejected_s: REJECTION_S,
        }
    }

    fn step(&mut self, step: &Step) {
        self.filter.step(step);
        self.since_s += step.dt_s;
        if let Some(field) = step.field {
            let [x, y, z] = step.rates;
            self.correct(field, degrees(Vector3::new(x, y, z).norm()));
            self.since_s = 0.0;
        }
    }

    fn attitude(&self) -> [f32; 4] {
        let [w, x, y, z] = self.filter.attitude();
        let turn = Vector3::new(0.0, 0.0, self.delta_rad);
        let Quaternion { w, x, y, z } =
            Quaternion::from_rotation_vector(turn).multiply(Quaternion::new(w, x, y, z));
        [w, x, y, z]
    }
}

impl Vqf9 {
    fn correct(&mut self, [mx, my, mz]: [f32; 3], rate_deg_s: f32) {
        let t = self.since_s;
        let [w, x, y, z] = self.filter.attitude();
        let level = Quaternion::new(w, x, y, z).rotate(Vector3::new(mx, my, mz));
        let norm = level.norm();
        self.judge([norm, -(level.z / norm).asin()], rate_deg_s, t);
        let disagreement = wrap(-level.y.atan2(level.x) - self.delta_rad);
        let mut gain = 1.0 - (-t / CORRECTION_S).exp();
        if !self.is_disturbed {
            self.rejected_s = (self.rejected_s - REJECTION_FACTOR * t).max(0.0);
        } else if self.rejected_s <= REJECTION_S {
            self.rejected_s += t;
            gain = 0.0;
        } else {
            gain /= REJECTION_FACTOR;
        }
        if self.first_gain > 0.0 {
            gain = gain.max(self.first_gain);
            self.first_gain /= self.first_gain + 1.0;
            if self.first_gain * CORRECTION_S < t {
                self.first_gain = 0.0;
            }
        }
        self.delta_rad = wrap(self.delta_rad + gain * disagreement);
    }

    /// Judges whether norm and dip are those of the undisturbed field.
    fn judge(&mut self, now: [f32; 2], rate_deg_s: f32, t: f32) {
        let gain = 1.0 - (-t / REFERENCE_S).exp();
        let is_near = |other: [f32; 2]| {
            (now[0] - other[0]).abs() < TOLERANCES[0] * other[0]
                && (now[1] - other[1]).abs() < TOLERANCES[1]
        };
        let follow = |other: &mut [f32; 2]| {
            for (other, now) in other.iter_mut().zip(now) {
                *other += gain * (now - *other);
            }
        };
        if is_near(self.reference) {
            self.undisturbed_s += t;
            if self.undisturbed_s >= UNDISTURBED_S {
                self.is_disturbed = false;
                follow(&mut self.reference);
            }
        } else {
            self.undisturbed_s = 0.0;
            self.is_disturbed = true;
        }
        if !is_near(self.candidate) {
            self.candidate_s = 0.0;
            self.candidate = now;
            return;
        }
        if rate_deg_s >= NEW_RATE_DEG_S {
            self.candidate_s += t;
        }
        follow(&mut self.candidate);
        let is_first = self.reference[0] == 0.0 && self.candidate_s >= FIRST_S;
        if self.is_disturbed && (is_first || self.candidate_s >= NEW_S) {
            self.reference = self.candidate;
            self.is_disturbed = false;
            self.undisturbed_s = UNDISTURBED_S;
        }
    }
}

fn wrap(angle_rad: f32) -> f32 {
    aplomb::attitude::wrap_pi(angle_rad)
}
