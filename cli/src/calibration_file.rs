//! Calibration in a file: the JSON of `aplomb calibrate`.

use std::path::Path;

use aplomb::attitude::Vector3;
use aplomb::calibration::{
    AccelerometerCorrection, Calibration, CompassCorrection, Matrix3, SymmetricMatrix,
};
use aplomb_recordings::text::read_small;

/// Largest hard iron, µT: the full scale of the widest compass, the AK8963 with 4,912.
const MOST_IRON_UT: f32 = 5_000.0;

/// Calibration of accelerometer, gyroscope and compass. At least one is there.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationFile {
    /// Calibration of accelerometer and gyroscope.
    pub sensors: Calibration,
    /// Correction of the compass, in the sensor's axes.
    pub compass: Option<CompassCorrection>,
}

impl CalibrationFile {
    /// Reads a file. The error names it.
    pub fn read(path: &Path) -> Result<Self, String> {
        let text = read_small(path).map_err(|error| error.to_string());
        text.and_then(|text| Self::parse(&text))
            .map_err(|reason| format!("{}: {reason}", path.display()))
    }

    fn parse(json: &str) -> Result<Self, String> {
        let file: Json = serde_json::from_str(json)
            .map_err(|error| format!("{error}: write it with `aplomb calibrate --json`"))?;
        if let Some(rule) = file.rule.filter(|rule| rule != "rest") {
            return Err(format!(
                "its rule is {rule}, which is too inexact to count as a calibration: lay the \
                 sensor still in its poses, and calibrate again"
            ));
        }
        let mut sensors = Calibration::NONE;
        sensors.accelerometer = match (file.offset_m_s2, file.matrix) {
            (Some(offset), Some([[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]])) => {
                if [xy, xz, yz] != [yx, zx, zy] {
                    return Err("its matrix is not symmetric".into());
                }
                Some(AccelerometerCorrection {
                    offset_m_s2: vector(offset),
                    matrix: SymmetricMatrix {
                        xx,
                        yy,
                        zz,
                        xy,
                        xz,
                        yz,
                    },
                })
            }
            (None, None) => None,
            _ => return Err("it has only one of offset_m_s2 and matrix".into()),
        };
        sensors.gyroscope_matrix = file.gyroscope.map(|found| Matrix3 {
            rows: found.matrix.map(vector),
        });
        sensors.check().map_err(|reason| reason.to_string())?;
        let compass = file.compass.map(|found| CompassCorrection {
            matrix: found.matrix.map(vector),
            hard_iron_ut: vector(found.hard_iron_ut),
        });
        if !compass.as_ref().is_none_or(is_plausible) {
            return Err(
                "no compass has the correction in \"compass\": its hard iron has to be below 5000 \
                 uT, the mean gain of its matrix from 0.1 to 10, and its rows in different \
                 directions"
                    .into(),
            );
        }
        if sensors == Calibration::NONE && compass.is_none() {
            return Err("there is no calibration in it".into());
        }
        Ok(Self { sensors, compass })
    }
}

/// Returns whether a compass can have this correction, and its hard iron can be that of a vehicle.
fn is_plausible(correction: &CompassCorrection) -> bool {
    let Vector3 { x, y, z } = correction.hard_iron_ut;
    let is_small = [x, y, z].iter().all(|iron| iron.abs() <= MOST_IRON_UT);
    is_small && correction.is_plausible()
}

/// The file's names; those of `aplomb calibrate --json`.
#[derive(serde::Deserialize)]
struct Json {
    /// Rule that found the accelerometer's part; a file of another program names none.
    rule: Option<String>,
    offset_m_s2: Option<[f32; 3]>,
    matrix: Option<[[f32; 3]; 3]>,
    gyroscope: Option<JsonGyroscope>,
    compass: Option<JsonCompass>,
}

#[derive(serde::Deserialize)]
struct JsonGyroscope {
    matrix: [[f32; 3]; 3],
}

#[derive(serde::Deserialize)]
struct JsonCompass {
    matrix: [[f32; 3]; 3],
    hard_iron_ut: [f32; 3],
}

fn vector([x, y, z]: [f32; 3]) -> Vector3 {
    Vector3::new(x, y, z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const IDENTITY: &str = "[[1,0,0],[0,1,0],[0,0,1]]";

    fn accelerometer(rule: &str) -> String {
        format!("{{{rule}\"offset_m_s2\":[0.1,0,0],\"matrix\":{IDENTITY}}}")
    }

    #[test]
    fn a_calibration_of_nearly_still_moments_is_refused() {
        for rule in ["", "\"rule\":\"rest\","] {
            assert!(
                CalibrationFile::parse(&accelerometer(rule)).is_ok(),
                "{rule}"
            );
        }
        let refused = CalibrationFile::parse(&accelerometer("\"rule\":\"nearly_still\","));
        let reason = refused.expect_err("nearly still");
        assert!(reason.starts_with("its rule is nearly_still"), "{reason}");
    }

    fn compass(matrix: &str, iron: &str) -> String {
        format!("{{\"compass\":{{\"matrix\":{matrix},\"hard_iron_ut\":[{iron},2,3]}}}}")
    }

    #[test]
    fn a_compass_may_be_all_there_is() {
        let mirrored = compass("[[0,2,0],[1,0,0],[0,0,0.5]]", "-900");
        assert!(CalibrationFile::parse(&mirrored).is_ok());
        let file = CalibrationFile::parse(&compass(IDENTITY, "1")).expect("a calibration");
        assert_eq!(file.sensors, Calibration::NONE);
        let iron = file.compass.map(|compass| compass.hard_iron_ut);
        assert_eq!(iron, Some(Vector3::new(1.0, 2.0, 3.0)));
    }

    #[test]
    fn what_is_no_calibration_is_refused_with_the_reason() {
        for (json, reason) in [
            ("{}", "there is no calibration in it"),
            ("{\"offset_m_s2\":[0,0,0]}", "only one of"),
            (&accelerometer("").replace("0.1", "9"), "above 0.2 g"),
            (
                &accelerometer("").replace("[[1,0,0]", "[[1,0.1,0]"),
                "not symmetric",
            ),
            ("t_us,ax", "aplomb calibrate --json"),
            (&compass("[[0,0,0],[0,0,0],[0,0,0]]", "1"), "no compass has"),
            (&compass("[[1,0,0],[0,1,0],[1,1,0]]", "1"), "no compass has"),
            (
                &compass("[[90,0,0],[0,90,0],[0,0,90]]", "1"),
                "no compass has",
            ),
            (&compass(IDENTITY, "1e39"), "no compass has"),
        ] {
            let refused = CalibrationFile::parse(json).expect_err(json);
            assert!(refused.contains(reason), "{json}: {refused}");
        }
    }
}
