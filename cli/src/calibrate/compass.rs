//! Calibration of the compass in a recording, with the device's own fit.

use std::fmt;

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::calibration::compass::{CompassFit, CompassFitError, CompassFitter};
use aplomb::calibration::{Calibration, Mount};
use aplomb::pipeline::Pipeline;
use aplomb::units::{SECONDS_PER_MICROSECOND, degrees, radians};
use aplomb_recordings::rate::{ROWS_AHEAD, sample_rate_divider, unsigned};

use super::Recording;

/// Largest σ of the tilt of an attitude that the fit uses.
const LARGEST_TILT_SIGMA_RAD: f32 = radians(5.0);
/// Mount for the filter. The fit does not depend on it.
const MOUNT: Mount = Mount::Z_UP;

/// Calibration that was found, in sensor axes.
#[derive(serde::Serialize)]
pub struct CompassFound {
    readings: u32,
    /// Rows of the matrix.
    matrix: [[f32; 3]; 3],
    hard_iron_ut: [f32; 3],
    strength_ut: f32,
    dip_deg: f32,
    residual_ut: f32,
    is_mount_that_of_the_imu: bool,
}

/// Finds the calibration of the compass, if there is one. Readings are this much older than the
/// samples of their rows. The calibration of the other sensors improves the attitudes. The error is
/// the reason why there is none.
pub fn find(
    recording: &Recording,
    delay_us: u32,
    sensors: &Calibration,
) -> Option<Result<CompassFound, String>> {
    let mut fields = recording.samples.iter().map(|sample| sample.field_ut);
    if fields.all(|field| field.is_none()) {
        return None;
    }
    let mut settings = recording.settings;
    settings.mount = MOUNT;
    settings.calibration = *sensors;
    settings.verifies_scales = false; // nothing is read back here
    let times_us = recording.samples.iter().take(ROWS_AHEAD);
    let times_us: Vec<i64> = times_us.map(|sample| sample.t_us).collect();
    settings.sensor.sample_rate_divider = sample_rate_divider(&times_us);
    let mut pipeline = Pipeline::new(&settings);
    let mut fitter = CompassFitter::new();
    let mut without_tilt = 0;
    let age_s = delay_us as f32 * SECONDS_PER_MICROSECOND;
    for sample in &recording.samples {
        let raw = &sample.raw;
        let force = raw
            .accelerometer
            .to_m_s2(settings.sensor.accelerometer_range);
        let rates = raw.gyroscope.to_rad_s(settings.sensor.gyroscope_range);
        let mut corrected = pipeline.calibrated_sample(unsigned(sample.t_us), force, rates);
        corrected.is_force_saturated = raw.accelerometer.is_saturated();
        corrected.is_rate_saturated = raw.gyroscope.is_saturated();
        let snapshot = pipeline.update_sample(&corrected);
        let Some([x, y, z]) = sample.field_ut else {
            continue;
        };
        // Unknown, it is not finite.
        if snapshot.tilt_sigma_rad() < LARGEST_TILT_SIGMA_RAD {
            let back = snapshot.body_rates_rad_s.scale(-age_s);
            let attitude = snapshot
                .attitude
                .multiply(Quaternion::from_rotation_vector(back));
            let reading = MOUNT.to_body(Vector3::new(x as f32, y as f32, z as f32)).0;
            fitter.add(attitude, reading);
        } else {
            without_tilt += 1;
        }
    }
    let found = fitter.fit(MOUNT);
    Some(
        found
            .map(|fit| CompassFound::new(&fit, fitter.readings()))
            .map_err(|error| refusal(&error, without_tilt, recording)),
    )
}

/// Returns why there is no calibration, and what to do.
fn refusal(error: &CompassFitError, without_tilt: u32, recording: &Recording) -> String {
    let mut text = error.to_string();
    if let CompassFitError::TooFew { have } = *error {
        text += &if without_tilt > have {
            format!("; {without_tilt} came before the tilt was known: begin with a rest of 3 s")
        } else {
            ": record longer".to_owned()
        };
    }
    if let Some((seconds, at_s)) = recording.longest_pause_s() {
        text += &format!(
            "; the recording pauses for {seconds:.1} s at {at_s:.1} s: record it in one piece"
        );
    }
    text
}

impl CompassFound {
    /// Turns the fit from body axes to sensor axes.
    fn new(fit: &CompassFit, readings: u32) -> Self {
        let correction = &fit.correction;
        let to_sensor = |body| MOUNT.to_sensor(aplomb::attitude::BodyVector(body));
        let hard_iron = to_sensor(correction.hard_iron_ut);
        let column = |x, y, z| {
            let body = fit.mount.to_body(Vector3::new(x, y, z)).0;
            let [x, y, z] = correction.matrix.map(|row| row.dot(body));
            to_sensor(Vector3::new(x, y, z))
        };
        let columns = [
            column(1.0, 0.0, 0.0),
            column(0.0, 1.0, 0.0),
            column(0.0, 0.0, 1.0),
        ];
        Self {
            readings,
            matrix: [
                columns.map(|column| column.x),
                columns.map(|column| column.y),
                columns.map(|column| column.z),
            ],
            hard_iron_ut: [hard_iron.x, hard_iron.y, hard_iron.z],
            strength_ut: fit.strength_ut,
            dip_deg: degrees(fit.dip_rad),
            residual_ut: fit.residual_ut,
            is_mount_that_of_the_imu: fit.mount == MOUNT,
        }
    }
}

impl fmt::Display for CompassFound {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            readings,
            matrix,
            hard_iron_ut: [x, y, z],
            strength_ut,
            dip_deg,
            residual_ut,
            is_mount_that_of_the_imu,
        } = self;
        writeln!(
            formatter,
            "compass: {readings} readings, field {strength_ut:.1} µT, dip {dip_deg:.1}°, \
             residual {residual_ut:.2} µT"
        )?;
        writeln!(
            formatter,
            "corrected field = matrix × reading − hard iron, in sensor axes"
        )?;
        writeln!(formatter, "hard iron {x:+.2} {y:+.2} {z:+.2} µT")?;
        for (name, [x, y, z]) in ["matrix", "      ", "      "].into_iter().zip(matrix) {
            writeln!(formatter, "{name} {x:+.4} {y:+.4} {z:+.4}")?;
        }
        // No fit tells a compass with a negated axis from one in the opposite field.
        if *dip_deg < 0.0 {
            writeln!(
                formatter,
                "the field points up, which is right only in the south: else an axis has the \
                 wrong sign, and the heading is 180° wrong"
            )?;
        }
        if !is_mount_that_of_the_imu {
            writeln!(
                formatter,
                "the axes of the compass are not those of the IMU: the matrix turns them"
            )?;
        }
        Ok(())
    }
}
