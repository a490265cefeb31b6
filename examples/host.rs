//! Estimates attitude on a computer, from a file of samples or from a simulated motion of ten
//! seconds.
//!
//! ```sh
//! cargo run --example host                  # simulated: rolls to 30 degrees and back
//! cargo run --example host -- samples.csv
//! cargo run --example host -- samples.csv z-down
//! ```
//!
//! A line of the file is `t_us,ax,ay,az,gx,gy,gz`: m/s² and rad/s in the sensor's axes, as in the
//! project's own logs. The second argument says how the sensor is mounted: `z-up` (the default) has
//! its Z axis up, so that it reads +9.81 along Z at rest. The filter takes body axes, with Z down,
//! where a level body at rest reads −9.81. [`Mount::to_body`] converts.
//!
//! In a project of your own: `aplomb = { path = "../aplomb" }` without features.

use std::error::Error;

use aplomb::attitude::{BodyVector, Vector3};
use aplomb::calibration::Mount;
use aplomb::estimator::{Estimator, Sample};

fn main() -> Result<(), Box<dyn Error>> {
    let mount: Mount = match std::env::args().nth(2) {
        Some(name) => name
            .parse()
            .map_err(|_| "a mount is z-up, z-down, or such as +x-z")?,
        None => Mount::Z_UP,
    };
    let samples = match std::env::args().nth(1) {
        Some(path) => read(&std::fs::read_to_string(path)?, mount)?,
        None => made_up(),
    };
    if let Some(warning) = samples.first().and_then(upside_down) {
        eprintln!("{warning}");
    }
    let mut estimator = Estimator::new();
    for (number, sample) in samples.iter().enumerate() {
        let estimate = estimator.update(sample);
        if number % 100 == 0 {
            let angles = estimate.euler();
            let [roll, pitch, sigma] =
                [angles.roll_rad, angles.pitch_rad, estimate.tilt_sigma_rad()].map(f32::to_degrees);
            println!(
                "{:5.1} s  roll {roll:6.2}  pitch {pitch:6.2}  sigma {sigma:5.2}",
                sample.t_us as f64 * 1e-6
            );
        }
    }
    Ok(())
}

/// Returns a warning if the body is upside down at first, which is rarely meant.
fn upside_down(first: &Sample) -> Option<&'static str> {
    let is_upside_down = first.specific_force_m_s2.z > 5.0;
    is_upside_down.then_some(
        "warning: by the first sample the body is upside down. \
         Does the sensor's Z axis point down? Then give the mount z-down",
    )
}

/// Returns one sample in body axes for each line that begins with a number.
fn read(csv: &str, mount: Mount) -> Result<Vec<Sample>, Box<dyn Error>> {
    let lines = csv
        .lines()
        .filter(|line| line.starts_with(|c: char| c.is_ascii_digit()));
    let sample = |line: &str| {
        let (t_us, values) = line
            .split_once(',')
            .ok_or("a line is t_us,ax,ay,az,gx,gy,gz")?;
        let values: Result<Vec<f32>, _> = values
            .split(',')
            .map(|value| value.trim().parse())
            .collect();
        let &[ax, ay, az, gx, gy, gz, ..] = values?.as_slice() else {
            return Err(format!("six values should follow the time in `{line}`").into());
        };
        Ok(Sample::new(
            t_us.trim().parse()?,
            mount.to_body(Vector3::new(ax, ay, az)),
            mount.to_body(Vector3::new(gx, gy, gz)),
        ))
    };
    lines.map(sample).collect()
}

/// Simulates ten seconds at 1 kHz in body axes: two of rest, then a roll to 30° and back.
fn made_up() -> Vec<Sample> {
    let roll = |t_s: f32| 0.26 * (1.0 - ((t_s - 2.0).max(0.0) * std::f32::consts::FRAC_PI_4).cos());
    let at = |millisecond: u16| {
        let t_s = f32::from(millisecond) * 1e-3;
        let (sine, cosine) = roll(t_s).sin_cos();
        let rate = (roll(t_s + 5e-4) - roll(t_s - 5e-4)) * 1e3;
        // At rest the specific force is one g upwards.
        let force = BodyVector::new(0.0, -9.81 * sine, -9.81 * cosine);
        Sample::new(
            u64::from(millisecond) * 1000,
            force,
            BodyVector::new(rate, 0.0, 0.0),
        )
    };
    (0..10_000).map(at).collect()
}
