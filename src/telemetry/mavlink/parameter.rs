//! What of the module shows as a parameter: the outputs' settings and the mount, to be set; the calibration, to be seen.
//!
//! All are floats, so that no ground station has to guess how an integer is packed into one.

use super::Action;
use crate::calibration::{Calibration, Mount, OutputFormat, Record};

/// A parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// Attitudes per second.
    Rate,
    /// Bits per second on the UART.
    Baud,
    /// The format, as its place in [`OutputFormat::ALL`].
    Format,
    /// The mount, as its place in [`Mount::ALL`]; −1 if none is stored.
    Mount,
    /// The gyroscope's stored offset about this sensor axis, rad/s.
    GyroscopeOffset(usize),
    /// The accelerometer's offset along this sensor axis, m/s².
    AccelerometerOffset(usize),
    /// The accelerometer's scale along this sensor axis.
    AccelerometerScale(usize),
    /// 1 if the gyroscope's offset follows a temperature model.
    Temperature,
    /// 1 if the module is levelled.
    Level,
}

/// Every parameter with its name of up to 16 letters, in the order of their indices.
pub const PARAMETERS: [(Parameter, &str); 15] = [
    (Parameter::Rate, "OUT_RATE_HZ"),
    (Parameter::Baud, "OUT_BAUD"),
    (Parameter::Format, "OUT_FORMAT"),
    (Parameter::Mount, "MOUNT"),
    (Parameter::GyroscopeOffset(0), "GYR_OFF_X_RAD_S"),
    (Parameter::GyroscopeOffset(1), "GYR_OFF_Y_RAD_S"),
    (Parameter::GyroscopeOffset(2), "GYR_OFF_Z_RAD_S"),
    (Parameter::AccelerometerOffset(0), "ACC_OFF_X_M_S2"),
    (Parameter::AccelerometerOffset(1), "ACC_OFF_Y_M_S2"),
    (Parameter::AccelerometerOffset(2), "ACC_OFF_Z_M_S2"),
    (Parameter::AccelerometerScale(0), "ACC_SCALE_X"),
    (Parameter::AccelerometerScale(1), "ACC_SCALE_Y"),
    (Parameter::AccelerometerScale(2), "ACC_SCALE_Z"),
    (Parameter::Temperature, "CAL_TEMPERATURE"),
    (Parameter::Level, "CAL_LEVEL"),
];

impl Parameter {
    /// The index of the parameter with this name.
    #[inline(never)]
    pub fn find(name: &[u8]) -> Option<u16> {
        PARAMETERS
            .iter()
            .position(|(_, known)| known.as_bytes() == name)
            .map(|index| index as u16)
    }

    /// What a record says of it.
    #[inline(never)]
    pub fn value(self, record: &Record) -> f32 {
        let Calibration {
            mount,
            gyroscope,
            temperature,
            accelerometer,
            level,
        } = &record.calibration;
        let of = |vector: crate::attitude::Vector3, axis: usize| match axis {
            0 => vector.x,
            1 => vector.y,
            _ => vector.z,
        };
        match self {
            Self::Rate => record.preferences.rate_hz.into(),
            Self::Baud => record.preferences.baud as f32,
            Self::Format => place(&OutputFormat::ALL, &record.preferences.format),
            Self::Mount => mount.map_or(-1.0, |mount| place(&Mount::ALL, &mount)),
            Self::GyroscopeOffset(axis) => {
                gyroscope.map_or(0.0, |known| of(known.offset_rad_s, axis))
            }
            Self::AccelerometerOffset(axis) => {
                accelerometer.map_or(0.0, |known| of(known.offset_m_s2, axis))
            }
            Self::AccelerometerScale(axis) => {
                accelerometer.map_or(1.0, |known| known.matrix.get(axis).copied().unwrap_or(1.0))
            }
            Self::Temperature => f32::from(u8::from(temperature.is_some())),
            Self::Level => f32::from(u8::from(level.is_some())),
        }
    }

    /// What setting it asks for; `None` if it cannot be set, or not to this.
    #[inline(never)]
    pub fn action(self, value: f32) -> Option<Action> {
        // A cast saturates; what comes back as the same float was a whole number.
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

fn place<T: PartialEq>(all: &[T], value: &T) -> f32 {
    all.iter()
        .position(|known| known == value)
        .map_or(-1.0, |index| index as f32)
}
