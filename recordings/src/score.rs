//! Errors of attitudes against the truth.

use std::fmt;

use aplomb_models::motion::geometry::{Quaternion, angle_between};

use crate::distribution::{Distribution, median_by_place};

/// Start of a recording whose rows do not count, µs: a filter may take time to start.
pub const START_US: i64 = 5_000_000;

/// Inclination errors: the angles between the estimated and the true "up" in the sensor's axes.
///
/// The measure of Laidig and others, *BROAD*, Data 6(7), 2021.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    degrees: Distribution,
    /// Errors as multiples of the reported σ, and how many are at most 3.
    per_sigma: Distribution,
    within_3_sigma: usize,
}

/// Statistics of the errors, degrees. The names in JSON are those of a virtual flight's
/// `summary.json`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Score {
    /// Number of rows that counted.
    #[serde(rename = "inclination_samples")]
    pub rows: usize,
    /// Root mean square.
    #[serde(rename = "inclination_rms_deg")]
    pub rms: f64,
    /// 95th percentile.
    #[serde(rename = "inclination_p95_deg")]
    pub p95: f64,
    /// Largest error.
    #[serde(rename = "inclination_max_deg")]
    pub maximum: f64,
    /// Consistency of the reported σ with the errors, if the filter reports one.
    #[serde(flatten)]
    pub consistency: Option<SigmaConsistency>,
}

/// Consistency of the reported σ with the errors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SigmaConsistency {
    /// Share of rows with an error of at most 3 σ.
    pub within_3_sigma: f64,
    /// Median of error/σ. It is 0.83 for two independent normal errors, where σ is the root of
    /// the sum of their variances.
    #[serde(rename = "median_error_per_sigma")]
    pub median: f64,
}

impl Errors {
    /// Adds the angle between an estimated "up" and the true one, with the reported σ.
    pub fn add(&mut self, estimated_up: [f64; 3], true_up: [f64; 3], sigma_rad: Option<f32>) {
        let error_rad = angle_between(estimated_up, true_up);
        // NaN is no number of a distribution, and no error is as large.
        let is_number = !error_rad.is_nan();
        let error_rad = if is_number { error_rad } else { f64::INFINITY };
        self.degrees.add(error_rad.to_degrees());
        if let Some(sigma_rad) = sigma_rad {
            let multiple = error_rad / f64::from(sigma_rad);
            self.within_3_sigma += usize::from(multiple <= 3.0);
            self.per_sigma.add(if multiple.is_nan() {
                f64::INFINITY
            } else {
                multiple
            });
        }
    }

    /// Returns the score; `None` if no row counted.
    pub fn score(&mut self) -> Option<Score> {
        let rows = self.degrees.count();
        let maximum = self.degrees.maximum()?;
        Some(Score {
            rows,
            rms: (self.degrees.squares() / rows as f64).sqrt(),
            p95: self.degrees.nth((rows * 95).div_ceil(100) - 1)?,
            maximum,
            consistency: self.consistency(),
        })
    }

    fn consistency(&mut self) -> Option<SigmaConsistency> {
        let rows = self.per_sigma.count();
        (rows > 0).then(|| SigmaConsistency {
            within_3_sigma: self.within_3_sigma as f64 / rows as f64,
            median: self.per_sigma.median(),
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
            consistency,
        } = self;
        write!(
            formatter,
            "rms {rms:.3}°, 95 % within {p95:.3}°, maximum {maximum:.3}° over {rows} rows"
        )?;
        let Some(SigmaConsistency {
            within_3_sigma,
            median,
        }) = consistency
        else {
            return Ok(());
        };
        let percent = 100.0 * within_3_sigma;
        write!(
            formatter,
            "; {percent:.2} % within 3 sigma, median {median:.2} sigma"
        )
    }
}

/// Returns the median of ascending numbers; NaN without a number.
#[must_use]
pub fn median(ascending: &[f64]) -> f64 {
    median_by_place(ascending.len(), |place| ascending.get(place).copied())
}

/// Returns the mean.
#[must_use]
pub fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len() as f64
}

/// Returns "up" in the sensor's axes, from the rotation sensor → earth with z up.
#[must_use]
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
        errors.add(tilted, yawed, None);
        let score = errors.score().unwrap();
        assert!((score.rms - 0.1_f64.to_degrees()).abs() < 1e-9);
        assert_eq!((score.rows, score.consistency), (1, None));
    }

    #[test]
    fn a_sigma_is_held_to_the_errors() {
        let up = [0.0, 0.0, 1.0];
        let mut errors = Errors::default();
        for (error_rad, sigma_rad) in [(0.1_f64, 0.1), (0.2, 0.1), (0.29, 0.1), (0.31, 0.1)] {
            let (sine, cosine) = error_rad.sin_cos();
            errors.add([sine, 0.0, cosine], up, Some(sigma_rad));
        }
        let consistency = errors.score().unwrap().consistency.unwrap();
        assert_eq!(consistency.within_3_sigma, 0.75);
        assert!((consistency.median - 2.45).abs() < 1e-6, "{consistency:?}");
        // An error with a σ of zero or NaN is not within 3 σ.
        errors.add([1.0, 0.0, 0.0], up, Some(0.0));
        errors.add([1.0, 0.0, 0.0], up, Some(f32::NAN));
        let consistency = errors.score().unwrap().consistency.unwrap();
        assert_eq!(consistency.within_3_sigma, 0.5);
    }

    #[test]
    fn an_attitude_that_is_no_number_is_the_largest_error() {
        let up = [0.0, 0.0, 1.0];
        let mut errors = Errors::default();
        for found in [up, [f64::NAN; 3], up] {
            errors.add(found, up, Some(0.1));
        }
        let score = errors.score().unwrap();
        assert_eq!((score.rms, score.maximum), (f64::INFINITY, f64::INFINITY));
        assert!(score.consistency.unwrap().within_3_sigma < 0.67);
    }

    #[test]
    fn medians_are_of_the_middle() {
        assert_eq!(median(&[1.0, 2.0, 10.0]), 2.0);
        assert_eq!(median(&[1.0, 2.0, 4.0, 10.0]), 3.0);
        assert!(median(&[]).is_nan());
    }

    #[test]
    fn a_score_is_of_all_rows() {
        assert_eq!(Errors::default().score(), None);
        let mut errors = Errors {
            degrees: (1..=200).rev().map(f64::from).collect(),
            ..Errors::default()
        };
        let score = errors.score().unwrap();
        assert_eq!((score.rows, score.p95, score.maximum), (200, 190.0, 200.0));
        // Σk² = n(n+1)(2n+1)/6.
        assert!((score.rms - (201.0_f64 * 401.0 / 6.0).sqrt()).abs() < 1e-9);
    }
}
