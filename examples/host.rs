//! Estimates attitude on a computer, from a file of samples or from a simulated motion of ten
//! seconds.
//!
//! ```sh
//! cargo run --example host                  # simulated: rolls to 30 degrees and back
//! cargo run --example host -- samples.csv
//! ```
//!
//! A line of the file is `t_us,ax,ay,az,gx,gy,gz`: m/s² and rad/s in body axes, Z down.
//!
//! In a project of your own: `aplomb = { git = "…" }` without features.

use std::error::Error;

use aplomb::attitude::Vector3;
use aplomb::estimator::{Estimator, Sample};

fn main() -> Result<(), Box<dyn Error>> {
    let samples = match std::env::args().nth(1) {
        Some(path) => read(&std::fs::read_to_string(path)?)?,
        None => made_up(),
    };
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

/// Returns one sample for each line that begins with a number.
fn read(csv: &str) -> Result<Vec<Sample>, Box<dyn Error>> {
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
            Vector3::new(ax, ay, az),
            Vector3::new(gx, gy, gz),
        ))
    };
    lines.map(sample).collect()
}

/// Simulates ten seconds at 1 kHz: two of rest, then a roll to 30° and back.
fn made_up() -> Vec<Sample> {
    let roll = |t_s: f32| 0.26 * (1.0 - ((t_s - 2.0).max(0.0) * std::f32::consts::FRAC_PI_4).cos());
    let at = |millisecond: u16| {
        let t_s = f32::from(millisecond) * 1e-3;
        let (sine, cosine) = roll(t_s).sin_cos();
        let rate = (roll(t_s + 5e-4) - roll(t_s - 5e-4)) * 1e3;
        // At rest the specific force is one g upwards.
        let force = Vector3::new(0.0, -9.81 * sine, -9.81 * cosine);
        Sample::new(
            u64::from(millisecond) * 1000,
            force,
            Vector3::new(rate, 0.0, 0.0),
        )
    };
    (0..10_000).map(at).collect()
}
