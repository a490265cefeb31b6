//! Report of what a recording shows, as text and as JSON.

use aplomb::attitude::Vector3;
use aplomb::calibration::accelerometer::{self, AccelerometerFit};
use aplomb::calibration::gyroscope::GyroscopeFit;
use aplomb::calibration::{Calibration, SymmetricMatrix};
use aplomb::units::STANDARD_GRAVITY_M_S2;

use super::compass::CompassFound;
use super::gyroscope::{self, GyroscopeSummary};

/// Returns the results as JSON. At least one is there.
pub fn json(
    accelerometer: &Result<Found, String>,
    compass: Option<&Result<CompassFound, String>>,
) -> serde_json::Result<String> {
    serde_json::to_string(&Results {
        accelerometer: accelerometer.as_ref().ok().map(Found::summary),
        accelerometer_refused: accelerometer.as_ref().err(),
        compass: compass.and_then(|found| found.as_ref().ok()),
        compass_refused: compass.and_then(|found| found.as_ref().err()),
    })
}

/// Results in the form of the JSON.
#[derive(serde::Serialize)]
struct Results<'a> {
    #[serde(flatten)]
    accelerometer: Option<Summary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    accelerometer_refused: Option<&'a String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    compass: Option<&'a CompassFound>,
    #[serde(skip_serializing_if = "Option::is_none")]
    compass_refused: Option<&'a String>,
}

/// Calibration that was found.
pub struct Found {
    pub rule: &'static str,
    pub poses: Vec<Vector3>,
    pub fit: AccelerometerFit,
    pub gyroscope: Result<GyroscopeFit, String>,
}

/// Fit on every other pose, and its residual on the rest.
#[derive(serde::Serialize)]
struct HeldOut {
    fitted: usize,
    held_out: usize,
    #[serde(rename = "residual_before_g")]
    before_g: f32,
    #[serde(rename = "residual_after_g")]
    after_g: f32,
}

impl Found {
    fn held_out(&self) -> Option<HeldOut> {
        let half = |first: usize| -> Vec<Vector3> {
            self.poses.iter().skip(first).step_by(2).copied().collect()
        };
        let (fitted, held_out) = (half(0), half(1));
        let fit = accelerometer::fit(&fitted).ok()?;
        let correction = fit.correction;
        Some(HeldOut {
            fitted: fitted.len(),
            held_out: held_out.len(),
            before_g: rms(held_out.iter().map(|pose| pose.norm())),
            after_g: rms(held_out.iter().map(|pose| {
                let force = correction.apply(pose.scale(STANDARD_GRAVITY_M_S2));
                force.norm() / STANDARD_GRAVITY_M_S2
            })),
        })
    }

    /// Returns the calibration of both sensors, without the gyroscope's offset.
    pub fn calibration(&self) -> Calibration {
        let mut calibration = Calibration::NONE;
        calibration.accelerometer = Some(self.fit.correction);
        calibration.gyroscope_matrix = self.gyroscope.as_ref().ok().map(|fit| fit.matrix);
        calibration
    }

    /// Refuses a fit that improves nothing for poses that it has not seen.
    pub fn check_held_out(&self) -> Result<(), String> {
        match self.held_out() {
            Some(HeldOut {
                before_g, after_g, ..
            }) if after_g < before_g => Ok(()),
            Some(HeldOut {
                before_g, after_g, ..
            }) => Err(format!(
                "a fit to half of its nearly still moments does not improve the others: residual \
                 {:.2} mg before, {:.2} mg after",
                1000.0 * before_g,
                1000.0 * after_g,
            )),
            None => Err("half of its nearly still moments do not show every direction".into()),
        }
    }

    pub fn describe(&self, report: &mut String) {
        let correction = &self.fit.correction;
        let offset = correction.offset_m_s2.scale(1000.0 / STANDARD_GRAVITY_M_S2);
        let SymmetricMatrix {
            xx,
            yy,
            zz,
            xy,
            xz,
            yz,
        } = correction.matrix;
        *report += &format!("{}\n", self.fit);
        *report += &format!(
            "offset {:+.1} {:+.1} {:+.1} mg, scale {xx:.4} {yy:.4} {zz:.4}, \
             cross-axis xy {xy:+.4} xz {xz:+.4} yz {yz:+.4}\n",
            offset.x, offset.y, offset.z,
        );
        match self.held_out() {
            Some(HeldOut {
                fitted,
                held_out,
                before_g,
                after_g,
            }) => {
                *report += &format!(
                    "held out: fitted on {fitted} poses, residual of the other {held_out}: \
                     {:.2} mg before, {:.2} mg after, {:.2} times better\n",
                    1000.0 * before_g,
                    1000.0 * after_g,
                    before_g / after_g,
                );
            }
            None => {
                *report += "held out: half of the poses are too few to fit\n";
            }
        }
        gyroscope::describe(&self.gyroscope, report);
    }

    fn summary(&self) -> Summary {
        let fit = &self.fit;
        let offset = fit.correction.offset_m_s2;
        let m = fit.correction.matrix;
        Summary {
            rule: self.rule,
            poses: fit.poses,
            offset_m_s2: [offset.x, offset.y, offset.z],
            matrix: [[m.xx, m.xy, m.xz], [m.xy, m.yy, m.yz], [m.xz, m.yz, m.zz]],
            cross_axis_fitted: fit.has_cross_axis,
            residual_before_g: fit.residual_before_g,
            residual_after_g: fit.residual_after_g,
            held_out: self.held_out(),
            gyroscope: self.gyroscope.as_ref().ok().map(GyroscopeSummary::of),
            gyroscope_refused: self.gyroscope.as_ref().err().cloned(),
        }
    }
}

/// Calibration in the form of the JSON.
#[derive(serde::Serialize)]
struct Summary {
    rule: &'static str,
    poses: usize,
    offset_m_s2: [f32; 3],
    matrix: [[f32; 3]; 3],
    cross_axis_fitted: bool,
    residual_before_g: f32,
    residual_after_g: f32,
    held_out: Option<HeldOut>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gyroscope: Option<GyroscopeSummary>,
    #[serde(skip_serializing_if = "Option::is_none")]
    gyroscope_refused: Option<String>,
}

fn rms(norms: impl Iterator<Item = f32>) -> f32 {
    let (mut sum, mut number) = (0.0, 0);
    for norm in norms {
        sum += (norm - 1.0) * (norm - 1.0);
        number += 1;
    }
    (sum / number.max(1) as f32).sqrt()
}

#[cfg(test)]
mod tests {
    use aplomb::calibration::accelerometer::Pose;

    use super::*;

    #[test]
    fn a_fit_that_makes_the_held_out_poses_worse_is_refused() {
        let found = |even_g: f32, odd_g: f32| {
            let poses = Pose::GUIDE.into_iter().flat_map(|pose| {
                [even_g, odd_g].map(|offset| pose.up() + Vector3::new(offset, 0.0, 0.0))
            });
            let poses: Vec<Vector3> = poses.collect();
            Found {
                rule: "nearly_still",
                fit: accelerometer::fit(&poses).expect("a fit"),
                poses,
                gyroscope: Err(String::new()),
            }
        };
        assert_eq!(found(0.03, 0.02).check_held_out(), Ok(()));
        let refused = found(0.03, -0.03).check_held_out().unwrap_err();
        assert!(refused.contains("does not improve the others"), "{refused}");
    }
}
