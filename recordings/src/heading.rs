//! Errors of headings against the truth.

use aplomb::attitude::{BodyVector, Quaternion as Attitude};
use aplomb::calibration::Mount;
use aplomb_models::motion::geometry::Quaternion;

use crate::score::median;

/// Errors of headings, with their σ.
#[derive(Clone, Debug, Default)]
pub struct HeadingErrors {
    errors_deg: Vec<f64>,
    per_sigma: Vec<f64>,
    /// Rows that count, with and without a heading.
    rows: usize,
}

/// Statistics of heading errors, degrees. The names are those of the JSON.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct HeadingScore {
    /// Share of the rows with a heading.
    #[serde(rename = "heading_known")]
    pub known: f64,
    /// Root mean square.
    #[serde(rename = "heading_rms_deg")]
    pub rms: f64,
    /// Root mean square after a constant is removed.
    #[serde(rename = "heading_rms_without_offset_deg")]
    pub rms_without_offset: f64,
    /// The constant.
    #[serde(rename = "heading_offset_deg")]
    pub offset: f64,
    /// Share of the headings with an error of at most 3 σ; `None` without σ.
    #[serde(
        rename = "heading_within_3_sigma",
        skip_serializing_if = "Option::is_none"
    )]
    pub within_3_sigma: Option<f64>,
    /// Median of error/σ; `None` without σ.
    #[serde(
        rename = "median_heading_error_per_sigma",
        skip_serializing_if = "Option::is_none"
    )]
    pub median_per_sigma: Option<f64>,
}

impl HeadingErrors {
    /// Adds a row that counts: the error and σ in degrees, if there is a heading.
    pub fn add(&mut self, heading: Option<(f64, Option<f64>)>) {
        self.rows += 1;
        if let Some((error, sigma)) = heading {
            self.errors_deg.push(error);
            self.per_sigma
                .extend(sigma.map(|sigma| error.abs() / sigma));
        }
    }

    /// Returns the score; `None` without a heading.
    #[must_use]
    pub fn score(&self) -> Option<HeadingScore> {
        let errors = &self.errors_deg;
        if errors.is_empty() {
            return None;
        }
        let count = errors.len() as f64;
        let sums = errors.iter().map(|error| error.to_radians().sin_cos());
        let (sine, cosine) = sums.fold((0.0, 0.0), |(s, c), (sine, cosine)| (s + sine, c + cosine));
        let offset = sine.atan2(cosine).to_degrees();
        let rms = |offset: f64| {
            let squares = errors.iter().map(|error| wrap(error - offset).powi(2));
            (squares.sum::<f64>() / count).sqrt()
        };
        let mut per_sigma = self.per_sigma.clone();
        per_sigma.sort_unstable_by(f64::total_cmp);
        let within = per_sigma.iter().filter(|multiple| **multiple <= 3.0);
        let within = within.count() as f64 / per_sigma.len() as f64;
        let has_sigma = !per_sigma.is_empty();
        Some(HeadingScore {
            known: count / self.rows as f64,
            rms: rms(0.0),
            rms_without_offset: rms(offset),
            offset,
            within_3_sigma: has_sigma.then_some(within),
            median_per_sigma: has_sigma.then(|| median(&per_sigma)),
        })
    }
}

impl std::fmt::Display for HeadingScore {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            formatter,
            "rms {:.2}°, {:.2}° without its mean {:.2}°, known in {:.1} % of the rows",
            self.rms,
            self.rms_without_offset,
            self.offset,
            100.0 * self.known
        )?;
        if let (Some(within), Some(median)) = (self.within_3_sigma, self.median_per_sigma) {
            let percent = 100.0 * within;
            write!(
                formatter,
                "; {percent:.2} % within 3 sigma, median {median:.2} sigma"
            )?;
        }
        Ok(())
    }
}

/// Returns the heading error in degrees: the turn about down from the true attitude to the
/// estimated one, clockwise positive.
///
/// `estimated` is body (forward, right, down) to north, east, down. `truth` is sensor to east,
/// north, up. The turn is the twist of their difference about down, so it is defined at any pitch.
#[must_use]
pub fn error_deg(estimated: Attitude, truth: Quaternion, mount: Mount) -> f64 {
    let Attitude { w, x, y, z } = estimated;
    let estimated = Quaternion::new(w.into(), x.into(), y.into(), z.into());
    let body = [0, 1, 2].map(|axis| {
        let mut unit = [0.0; 3];
        unit[axis] = 1.0;
        let [x, y, z] = unit;
        let sensor = mount.to_sensor(BodyVector::new(x, y, z));
        let sensor = [sensor.x, sensor.y, sensor.z].map(f64::from);
        let [east, north, up] = truth.rotate(sensor);
        (estimated.rotate(unit.map(f64::from)), [north, east, -up])
    });
    // The rotation from true to estimated axes is D = Σ e·tᵀ. Its twist about down follows
    // from D_xx + D_yy and D_yx − D_xy.
    let (mut cosine, mut sine) = (0.0_f64, 0.0_f64);
    for (estimated, truth) in body {
        cosine += estimated[0] * truth[0] + estimated[1] * truth[1];
        sine += estimated[1] * truth[0] - estimated[0] * truth[1];
    }
    sine.atan2(cosine).to_degrees()
}

/// Returns the angle in (−180, 180].
#[must_use]
pub fn wrap(degrees: f64) -> f64 {
    let turned = degrees.rem_euclid(360.0);
    if turned > 180.0 {
        turned - 360.0
    } else {
        turned
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb::attitude::EulerAngles;
    use aplomb::units::radians;

    /// Returns the attitude with these angles in degrees.
    fn attitude(roll: f32, pitch: f32, yaw: f32) -> Attitude {
        Attitude::from_euler(EulerAngles {
            roll_rad: radians(roll),
            pitch_rad: radians(pitch),
            yaw_rad: radians(yaw),
        })
    }

    #[test]
    fn an_error_is_the_turn_about_down() {
        // A sensor face up, its x to the north: turned by 90° from east, north, up.
        let half = 45.0_f64.to_radians();
        let truth = Quaternion::new(half.cos(), 0.0, 0.0, half.sin());
        let error = |estimated| error_deg(estimated, truth, Mount::Z_UP);
        assert!(error(attitude(0.0, 0.0, 0.0)).abs() < 1e-4);
        assert!((error(attitude(0.0, 0.0, 20.0)) - 20.0).abs() < 1e-4);
        assert!((error(attitude(0.0, 0.0, -170.0)) + 170.0).abs() < 1e-4);
        // A tilt error alone is no heading error.
        assert!(error(attitude(10.0, 0.0, 0.0)).abs() < 1e-4);
    }

    #[test]
    fn a_score_has_the_mean_apart_and_counts_rows_without_a_heading() {
        let mut errors = HeadingErrors::default();
        assert_eq!(errors.score(), None);
        for error in [3.0, 5.0, 7.0] {
            errors.add(Some((error, Some(2.0))));
        }
        errors.add(None);
        let score = errors.score().unwrap();
        assert!((score.offset - 5.0).abs() < 1e-2, "{score}");
        assert!((score.rms - (83.0_f64 / 3.0).sqrt()).abs() < 1e-9);
        assert!((score.rms_without_offset - (8.0_f64 / 3.0).sqrt()).abs() < 1e-3);
        assert_eq!(score.known, 0.75);
        assert_eq!(score.within_3_sigma, Some(2.0 / 3.0));
        assert_eq!(score.median_per_sigma, Some(2.5));
    }

    #[test]
    fn errors_wrap_around_the_south() {
        assert_eq!(
            [wrap(190.0), wrap(-190.0), wrap(180.0)],
            [-170.0, 170.0, 180.0]
        );
        let mut errors = HeadingErrors::default();
        for error in [179.0, -179.0] {
            errors.add(Some((error, None)));
        }
        let score = errors.score().unwrap();
        assert!((score.rms_without_offset - 1.0).abs() < 1e-9, "{score}");
        assert_eq!(score.within_3_sigma, None);
    }
}
