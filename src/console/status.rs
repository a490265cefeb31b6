//! Texts of the answers to `status` and `show`.

use core::fmt;

use super::answer::{Decimal, Triple};
use super::module::State;
use super::procedure::Procedure;
use crate::attitude::Vector3;
use crate::calibration::{Calibration, Mount};
use crate::compass::{self, Choice, CompassStatus};
use crate::mpu6050::Part;
use crate::settings::{CompassSettings, Preferences, Record};
use crate::units::{MagneticField, degrees};

/// Answer to `status`.
pub(super) struct Status<'a> {
    pub(super) state: &'a State,
    /// Calibration in use.
    pub(super) calibration: &'a Calibration,
    /// Settings of the compass in use.
    pub(super) compass: &'a CompassSettings,
    /// Mount in use.
    pub(super) mount: Mount,
    pub(super) is_armed: bool,
    pub(super) has_unsaved: bool,
    /// Lines dropped since start.
    pub(super) lines_dropped: u32,
    /// Name of the running procedure.
    pub(super) doing: Option<&'static str>,
    /// Running procedure, if it takes stationary means.
    pub(super) procedure: Option<&'a Procedure>,
}

impl fmt::Display for Status<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let state = self.state;
        let is_default = self.calibration.mount.is_none();
        write!(
            formatter,
            "flags={} sensor={}{}{} mount={}{} calibrated={} bias_dps={} bias_sigma_dps={}{} \
             tilt_sigma_deg={} temperature_c={} armed={} unsaved={} bursts_failed={} \
             missed={} refused={} uart_errors={} lines_dropped={} frames_dropped={}{}",
            state.flags,
            SensorName(state.sensor),
            CompassText(&state.compass),
            HeadingText(state, self.compass),
            self.mount,
            if is_default { "(default)" } else { "" },
            CalibratedParts(self.calibration, self.compass),
            Triple(state.bias_rad_s.scale(degrees(1.0)), 3),
            Decimal(degrees(state.bias_sigma_rad_s), 3),
            AccelerometerOffset(state.accelerometer_offset_m_s2),
            Decimal(degrees(state.tilt_sigma_rad), 2),
            Decimal(state.temperature_celsius, 1),
            yes_no(self.is_armed),
            yes_no(self.has_unsaved),
            state.bursts_failed,
            state.times_missed,
            state.times_refused,
            state.reception_errors,
            self.lines_dropped,
            state.frames_dropped,
            RunningProcedure(self.doing, self.procedure),
        )
    }
}

/// Name and address of the sensor.
struct SensorName(Option<(&'static Part, u8)>);

impl fmt::Display for SensorName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some((part, address)) => write!(formatter, "{}@0x{address:02x}", part.name),
            None => formatter.write_str("none"),
        }
    }
}

/// Name, address, fault, field, its strength and the hard iron that the heading filter has found;
/// nothing without a compass.
struct CompassText<'a>(&'a CompassStatus);

impl fmt::Display for CompassText<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let status = self.0;
        if let Some((name, address)) = status.part {
            write!(formatter, " compass={name}@0x{address:02x}")?;
        }
        if let Some(fault) = status.fault {
            write!(formatter, " compass_fault={}", fault.name())?;
        }
        if let Some(MagneticField { ut: [x, y, z] }) = status.field {
            let field = Vector3::new(x, y, z);
            write!(formatter, " field_ut={}", Triple(field, 1))?;
            if compass::IS_BUILT_IN {
                write!(formatter, " strength_ut={}", Decimal(field.norm(), 1))?;
            }
        }
        if let Some(hard_iron_ut) = status.hard_iron_ut {
            write!(formatter, " hard_iron_ut={}", Triple(hard_iron_ut, 1))?;
        }
        Ok(())
    }
}

/// Offset of the accelerometer that the filter has found, if there is one.
struct AccelerometerOffset(Option<Vector3>);

impl fmt::Display for AccelerometerOffset {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(offset_m_s2) => write!(formatter, " accel_found_m_s2={}", Triple(offset_m_s2, 3)),
            None => Ok(()),
        }
    }
}

/// Heading, its σ, whether it is valid, and the north it is from; nothing without a compass.
struct HeadingText<'a>(&'a State, &'a CompassSettings);

impl fmt::Display for HeadingText<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(state, settings) = self;
        if !compass::IS_BUILT_IN || state.compass.part.is_none() {
            return Ok(());
        }
        let Some(heading) = state.heading else {
            return formatter.write_str(" heading_deg=unknown");
        };
        let north = if settings.declination_rad == 0.0 {
            "magnetic"
        } else {
            "true"
        };
        write!(
            formatter,
            " heading_deg={} heading_sigma_deg={} heading_valid={} north={north}",
            Decimal(heading.heading_deg, 2),
            Decimal(heading.sigma_deg, 2),
            yes_no(heading.is_valid),
        )
    }
}

const fn yes_no(is: bool) -> &'static str {
    if is { "yes" } else { "no" }
}

/// Names of the calibrated parts.
struct CalibratedParts<'a>(&'a Calibration, &'a CompassSettings);

impl fmt::Display for CalibratedParts<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let has_poses = (self.0.accelerometer).map(|correction| correction.is_from_poses());
        let has_soft_iron = (self.1.correction).map(|correction| correction.has_soft_iron());
        let names = [
            (self.0.gyroscope.is_some(), "gyro"),
            (self.0.gyroscope_matrix.is_some(), "gyro-scale"),
            (has_poses == Some(true), "accel"),
            (has_poses == Some(false), "accel-offset"),
            (self.0.level.is_some(), "level"),
            (self.0.temperature.is_some(), "temperature"),
            (has_soft_iron == Some(true), "compass"),
            (has_soft_iron == Some(false), "hard-iron"),
        ];
        let mut separator = "";
        for (_, name) in names.into_iter().filter(|(is_there, _)| *is_there) {
            write!(formatter, "{separator}{name}")?;
            separator = ",";
        }
        formatter.write_str(if separator.is_empty() { "none" } else { "" })
    }
}

/// Running procedure, if there is one.
struct RunningProcedure<'a>(Option<&'static str>, Option<&'a Procedure>);

impl fmt::Display for RunningProcedure<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(name) = self.0 else {
            return Ok(());
        };
        write!(formatter, " doing=\"{name}")?;
        if let Some(detail) = self.1.and_then(Procedure::detail) {
            write!(formatter, ", {detail}")?;
        }
        formatter.write_str("\"")
    }
}

/// Writes a matrix by rows, as `gyro_matrix=` and nine numbers.
#[inline(never)]
fn write_matrix(
    formatter: &mut fmt::Formatter<'_>,
    name: &str,
    rows: &[Vector3; 3],
) -> fmt::Result {
    let [x, y, z] = rows.map(|row| Triple(row, 4));
    write!(formatter, " {name}_matrix={x},{y},{z}")
}

/// Record as text: the answer to `show`. Of a temperature model it has the range alone.
pub(super) struct RecordText<'a>(pub(super) &'a Record);

impl fmt::Display for RecordText<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Record {
            calibration,
            preferences,
            compass,
        } = self.0;
        formatter.write_str("mount=")?;
        match calibration.mount {
            Some(mount) => write!(formatter, "{mount}")?,
            None => formatter.write_str("default")?,
        }
        formatter.write_str(" gyro=")?;
        match calibration.gyroscope {
            Some(gyroscope) => write!(
                formatter,
                "{}@{}C",
                Triple(gyroscope.offset_rad_s.scale(degrees(1.0)), 3),
                Decimal(gyroscope.temperature_celsius, 1)
            )?,
            None => formatter.write_str("none")?,
        }
        formatter.write_str(" temperature=")?;
        match calibration.temperature {
            Some(model) => write!(
                formatter,
                "{}..{}C",
                Decimal(model.coldest_celsius, 1),
                Decimal(model.warmest_celsius, 1)
            )?,
            None => formatter.write_str("none")?,
        }
        formatter.write_str(" accel_offset=")?;
        match calibration.accelerometer {
            Some(correction) => {
                let matrix = &correction.matrix;
                write!(
                    formatter,
                    "{} accel_matrix={},{}",
                    Triple(correction.offset_m_s2, 3),
                    Triple(Vector3::new(matrix.xx, matrix.yy, matrix.zz), 4),
                    Triple(Vector3::new(matrix.xy, matrix.xz, matrix.yz), 4)
                )?;
            }
            None => formatter.write_str("none")?,
        }
        formatter.write_str(" level=")?;
        match calibration.level {
            Some(trim) => {
                let angles = trim.to_euler();
                let angle = |radians| Decimal(degrees(radians), 2);
                write!(
                    formatter,
                    "{},{}",
                    angle(angles.roll_rad),
                    angle(angles.pitch_rad)
                )?;
            }
            None => formatter.write_str("none")?,
        }
        if let Some(matrix) = calibration.gyroscope_matrix {
            write_matrix(formatter, "gyro", &matrix.rows)?;
        }
        let Preferences {
            format,
            rate_hz,
            baud,
        } = preferences;
        write!(
            formatter,
            " format={} rate={rate_hz} baud={baud}",
            format.name(),
        )?;
        CompassSettingsText(compass).fmt(formatter)
    }
}

/// Settings of the compass, as far as they are not the default.
struct CompassSettingsText<'a>(&'a CompassSettings);

impl fmt::Display for CompassSettingsText<'_> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let compass = self.0;
        if compass.choice != Choice::Auto {
            write!(formatter, " compass={}", compass.choice)?;
        }
        if let Some(mount) = compass.mount {
            write!(formatter, " compass_mount={mount}")?;
        }
        if let Some(correction) = compass.correction {
            write!(
                formatter,
                " compass_iron={}",
                Triple(correction.hard_iron_ut, 1)
            )?;
            if correction.has_soft_iron() {
                write_matrix(formatter, "compass", &correction.matrix)?;
            }
        }
        if compass::IS_BUILT_IN && compass.declination_rad != 0.0 {
            let declination_deg = degrees(compass.declination_rad);
            write!(formatter, " declination={}", Decimal(declination_deg, 2))?;
        }
        Ok(())
    }
}
