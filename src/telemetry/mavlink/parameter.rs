//! MAVLink parameters: preferences and mount, which can be set, and the calibration, which cannot.
//!
//! All values are floats, so that no ground station has to guess how an integer is packed into one.
//!
//! ```
//! use aplomb::settings::Record;
//! use aplomb::telemetry::mavlink::Action;
//! use aplomb::telemetry::mavlink::parameter::Parameter;
//!
//! assert_eq!(Parameter::find(b"OUT_RATE_HZ"), Some(0));
//! assert_eq!(Parameter::Rate.value(&Record::default()), 50.0);
//! assert_eq!(Parameter::Rate.action(100.0), Some(Action::SetRate(100)));
//! assert_eq!(Parameter::Level.action(1.0), None);
//! ```

use super::action::Action;
use crate::calibration::{Axis, Calibration, Mount};
use crate::settings::{OutputFormat, Record};

/// Parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Parameter {
    /// Attitudes per second.
    Rate,
    /// Bits per second on the UART.
    Baud,
    /// Telemetry format, as the index in [`OutputFormat::ALL`].
    Format,
    /// Mount, as the index in [`Mount::ALL`]; −1 if none is stored.
    Mount,
    /// Stored gyroscope offset about this axis, rad/s.
    GyroscopeOffset(Axis),
    /// Accelerometer offset along this axis, m/s².
    AccelerometerOffset(Axis),
    /// Accelerometer scale along this axis: the diagonal of the correction's matrix.
    AccelerometerScale(Axis),
    /// 1 if the gyroscope's offset follows a temperature model, else 0.
    Temperature,
    /// 1 if there is a level trim, else 0.
    Level,
}

/// Every parameter with its name of up to 16 letters, in the order of their indices.
pub const PARAMETERS: [(Parameter, &str); 15] = [
    (Parameter::Rate, "OUT_RATE_HZ"),
    (Parameter::Baud, "OUT_BAUD"),
    (Parameter::Format, "OUT_FORMAT"),
    (Parameter::Mount, "MOUNT"),
    (Parameter::GyroscopeOffset(Axis::X), "GYR_OFF_X_RAD_S"),
    (Parameter::GyroscopeOffset(Axis::Y), "GYR_OFF_Y_RAD_S"),
    (Parameter::GyroscopeOffset(Axis::Z), "GYR_OFF_Z_RAD_S"),
    (Parameter::AccelerometerOffset(Axis::X), "ACC_OFF_X_M_S2"),
    (Parameter::AccelerometerOffset(Axis::Y), "ACC_OFF_Y_M_S2"),
    (Parameter::AccelerometerOffset(Axis::Z), "ACC_OFF_Z_M_S2"),
    (Parameter::AccelerometerScale(Axis::X), "ACC_SCALE_X"),
    (Parameter::AccelerometerScale(Axis::Y), "ACC_SCALE_Y"),
    (Parameter::AccelerometerScale(Axis::Z), "ACC_SCALE_Z"),
    (Parameter::Temperature, "CAL_TEMPERATURE"),
    (Parameter::Level, "CAL_LEVEL"),
];

impl Parameter {
    /// Returns the index of the parameter with this name.
    #[inline(never)]
    pub fn find(name: &[u8]) -> Option<u16> {
        PARAMETERS
            .iter()
            .position(|(_, known)| known.as_bytes() == name)
            .map(|index| index as u16)
    }

    /// Returns the value that a record gives the parameter.
    #[inline(never)]
    pub fn value(self, record: &Record) -> f32 {
        let Calibration {
            mount,
            gyroscope,
            temperature,
            accelerometer,
            level,
            gyroscope_matrix: _,
        } = &record.calibration;
        match self {
            Self::Rate => record.preferences.rate_hz.into(),
            Self::Baud => record.preferences.baud as f32,
            Self::Format => index_of(&OutputFormat::ALL, &record.preferences.format),
            Self::Mount => mount.map_or(-1.0, |mount| index_of(&Mount::ALL, &mount)),
            Self::GyroscopeOffset(axis) => {
                gyroscope.map_or(0.0, |stored| axis.component(stored.offset_rad_s))
            }
            Self::AccelerometerOffset(axis) => {
                accelerometer.map_or(0.0, |stored| axis.component(stored.offset_m_s2))
            }
            Self::AccelerometerScale(axis) => accelerometer.map_or(1.0, |stored| match axis {
                Axis::X => stored.matrix.xx,
                Axis::Y => stored.matrix.yy,
                Axis::Z => stored.matrix.zz,
            }),
            Self::Temperature => f32::from(u8::from(temperature.is_some())),
            Self::Level => f32::from(u8::from(level.is_some())),
        }
    }

    /// Returns the action that sets the parameter to this value; `None` if it cannot be set, or not
    /// to this value.
    #[inline(never)]
    pub fn action(self, value: f32) -> Option<Action> {
        // A cast saturates; only a whole number comes back as the same float.
        let whole = value as u32;
        if whole as f32 != value {
            return None;
        }
        match self {
            Self::Rate => u16::try_from(whole).ok().map(Action::SetRate),
            Self::Baud => Some(Action::SetBaud(whole)),
            Self::Format => OutputFormat::ALL
                .get(whole as usize)
                .copied()
                .map(Action::SetFormat),
            Self::Mount => Mount::ALL
                .get(whole as usize)
                .copied()
                .map(Action::SetMount),
            _ => None,
        }
    }
}

/// Returns the index of a value as a float, −1 if it is not there.
fn index_of<T: PartialEq>(all: &[T], value: &T) -> f32 {
    all.iter()
        .position(|known| known == value)
        .map_or(-1.0, |index| index as f32)
}
