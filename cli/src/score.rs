//! How far an estimate is from the truth.

use std::fmt;

use virtual_board::motion::geometry::{Quaternion, angle_between};

/// Rows before this much of the recording do not count, in µs: a filter may take time to start.
pub const START_US: i64 = 5_000_000;

/// Inclination errors: the angles between the estimated and the true "up" in the sensor's axes.
///
/// The measure of Laidig and others, *BROAD*, Data 6(7), 2021.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    degrees: Vec<f64>,
}

/// What there is to say about the errors, in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// How many rows counted.
    pub rows: usize,
    /// Root mean square.
    pub rms: f64,
    /// So large are the largest 5 % at least.
    pub p95: f64,
    /// The largest.
    pub maximum: f64,
}

impl Errors {
    /// Notes the angle between an estimated "up" and the true one.
    pub fn add(&mut self, estimated_up: [f64; 3], true_up: [f64; 3]) {
        self.degrees
            .push(angle_between(estimated_up, true_up).to_degrees());
    }

    /// The score; `None` if no row counted.
    pub fn score(&mut self) -> Option<Score> {
        self.degrees.sort_by(f64::total_cmp);
        let rows = self.degrees.len();
        let &maximum = self.degrees.last()?;
        let squares: f64 = self.degrees.iter().map(|error| error * error).sum();
        Some(Score {
            rows,
            rms: (squares / rows as f64).sqrt(),
            p95: self.degrees[(rows * 95).div_ceil(100) - 1],
            maximum,
        })
    }
}

impl fmt::Display for Score {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            rms,
            p95,
            maximum,
            rows,
        } = self;
        write!(
            formatter,
            "rms {rms:.3}°, 95 % within {p95:.3}°, maximum {maximum:.3}° over {rows} rows"
        )
    }
}

/// "Up" in the sensor's axes by the rotation sensor → earth with z up.
pub fn up_in_sensor(sensor_to_earth: Quaternion) -> [f64; 3] {
    sensor_to_earth.conjugate().rotate([0.0, 0.0, 1.0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_angles_and_blind_to_yaw() {
        let (sine, cosine) = 0.05_f64.sin_cos();
        let tilted = up_in_sensor(Quaternion::new(cosine, sine, 0.0, 0.0));
        let yawed = up_in_sensor(Quaternion::new(cosine, 0.0, 0.0, sine));
        let mut errors = Errors::default();
        errors.add(tilted, yawed);
        let score = errors.score().unwrap();
        assert!((score.rms - 0.1_f64.to_degrees()).abs() < 1e-9);
        assert_eq!(score.rows, 1);
    }

    #[test]
    fn a_score_is_of_all_rows() {
        assert_eq!(Errors::default().score(), None);
        let mut errors = Errors {
            degrees: (1..=200).rev().map(f64::from).collect(),
        };
        let score = errors.score().unwrap();
        assert_eq!((score.rows, score.p95, score.maximum), (200, 190.0, 200.0));
        // Σk² = n(n+1)(2n+1)/6.
        assert!((score.rms - (201.0_f64 * 401.0 / 6.0).sqrt()).abs() < 1e-9);
    }
}
