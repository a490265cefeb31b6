//! Filters of others with a magnetometer, under equal conditions.
//!
//! They get the same steps as in [`peers`](crate::peers), and each new reading of the compass
//! turned to the time of the last sample. Each starts at the heading of the first reading.
//!
//! VQF keeps the tuning of its authors. Gains of the others: the best of a coarse scan on the 14
//! trials of `broad-mag`.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::{LONGEST_STEP_US, Sample};
use aplomb::units::MagneticField;
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

/// Times of a recording that filters need, s.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// From sample to sample.
    pub step_s: f32,
    /// From reading to reading of the compass, on average.
    pub field_step_s: f32,
    /// Delay of the samples.
    pub delay_s: f32,
    /// Age of a reading against the sample of its row.
    pub age_s: f32,
}

/// Runs a filter, and calls `note` with the index and the absolute attitude of each sample from the
/// first reading on: body to north, east, down.
pub fn run(
    choice: Choice,
    times: Times,
    rows: impl Iterator<Item = (Sample, Option<MagneticField>)>,
    note: impl FnMut(usize, Quaternion),
) {
    let step_s = times.step_s;
    match choice {
        Choice::Vqf => {
            let new = |_| Vqf::with_magnetometer(step_s, times.field_step_s, Vqf::GAINS);
            run_filter(new, times, rows, note);
        }
        Choice::Fusion => {
            let new = |start| Fusion::new(start, step_s, [0.3, 90.0]);
            run_filter(new, times, rows, note);
        }
        Choice::Madgwick => {
            let new = |start| Madgwick::new(start, step_s, [0.2, 0.0]);
            run_filter(new, times, rows, note);
        }
        Choice::Mahony => {
            let new = |start| Mahony::new(start, step_s, [1.0, 0.0]);
            run_filter(new, times, rows, note);
        }
    }
}

fn run_filter<F: Filter>(
    new: impl Fn([f32; 4]) -> F,
    times: Times,
    rows: impl Iterator<Item = (Sample, Option<MagneticField>)>,
    mut note: impl FnMut(usize, Quaternion),
) {
    let mut running: Option<(F, Sample)> = None;
    for (index, (sample, field)) in rows.enumerate() {
        let rates = sample.angular_rate_rad_s;
        let turn = Quaternion::from_rotation_vector(rates.scale(-times.age_s));
        let field = field.map(|MagneticField { ut: [x, y, z] }| {
            let present = turn.rotate(Vector3::new(x, y, z));
            flip(present)
        });
        let Some((filter, last)) = &mut running else {
            running = field.map(|field| {
                let start = start(flip(sample.specific_force_m_s2), field);
                (new(start), sample)
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
        note(index, extrapolate(attitude, rates, times.delay_s));
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
