//! What a calibration is, and what else the module keeps when the power goes: everything that is stored.
//!
//! All of it is in the sensor's own axes and in SI units, so that a new mount or a new full scale does not
//! spoil it. What was never measured is `None`, and the pipeline then does without.

use super::Mount;
use crate::attitude::{Quaternion, Vector3};
use crate::state::Exchange;

/// What is known about one sensor and how it sits. Default: nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Calibration {
    /// How the sensor is mounted.
    pub mount: Option<Mount>,
    /// The gyroscope's offset at rest.
    pub gyroscope: Option<GyroscopeOffset>,
    /// How that offset goes with temperature.
    pub temperature: Option<TemperatureModel>,
    /// The accelerometer's offset, scales and cross-axis terms.
    pub accelerometer: Option<AccelerometerCorrection>,
    /// What is left between the mounted sensor's axes and the body's: a small rotation, mounted axes to body.
    pub level: Option<Quaternion>,
}

impl Calibration {
    /// Nothing is known.
    pub const NONE: Self = Self {
        mount: None,
        gyroscope: None,
        temperature: None,
        accelerometer: None,
        level: None,
    };

    /// The temperature that is likely as long as none was measured, °C: that of the stored offset.
    pub(crate) fn usual_celsius(&self) -> f32 {
        match (&self.gyroscope, &self.temperature) {
            (Some(stored), _) => stored.temperature_celsius,
            (None, Some(model)) => model.reference_celsius,
            (None, None) => 25.0,
        }
    }
}

impl Calibration {
    /// Walks through everything that is known.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        state.optional(&mut self.mount, Mount::Z_UP, |state, mount| {
            mount.exchange(state);
        });
        let gyroscope = GyroscopeOffset {
            offset_rad_s: Vector3::ZERO,
            temperature_celsius: 0.0,
        };
        state.optional(&mut self.gyroscope, gyroscope, |state, gyroscope| {
            state.vector(&mut gyroscope.offset_rad_s);
            state.number(&mut gyroscope.temperature_celsius);
        });
        let model = TemperatureModel {
            reference_celsius: 0.0,
            offset_rad_s: Vector3::ZERO,
            slope_rad_s_per_celsius: Vector3::ZERO,
            curvature_rad_s_per_celsius2: Vector3::ZERO,
            coldest_celsius: 0.0,
            warmest_celsius: 0.0,
        };
        state.optional(&mut self.temperature, model, |state, model| {
            state.number(&mut model.reference_celsius);
            state.vector(&mut model.offset_rad_s);
            state.vector(&mut model.slope_rad_s_per_celsius);
            state.vector(&mut model.curvature_rad_s_per_celsius2);
            state.number(&mut model.coldest_celsius);
            state.number(&mut model.warmest_celsius);
        });
        let correction = AccelerometerCorrection {
            offset_m_s2: Vector3::ZERO,
            matrix: [0.0; 6],
        };
        state.optional(&mut self.accelerometer, correction, |state, correction| {
            state.vector(&mut correction.offset_m_s2);
            state.numbers(&mut correction.matrix);
        });
        state.optional(&mut self.level, Quaternion::IDENTITY, |state, level| {
            state.quaternion(level);
        });
    }
}

/// A gyroscope offset that was measured at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopeOffset {
    /// The offset, rad/s in sensor axes.
    pub offset_rad_s: Vector3,
    /// The die temperature while it was measured, °C.
    pub temperature_celsius: f32,
}

/// What the accelerometer's readings need: f = matrix · (reading − offset).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AccelerometerCorrection {
    /// The offset, m/s² in sensor axes.
    pub offset_m_s2: Vector3,
    /// The symmetric matrix: xx, yy, zz, xy, xz, yz.
    pub matrix: [f32; 6],
}

/// The gyroscope's offset as a parabola of the die temperature, per axis, inside the range that was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TemperatureModel {
    /// The temperature about which it is written, °C.
    pub reference_celsius: f32,
    /// The offset there, rad/s in sensor axes.
    pub offset_rad_s: Vector3,
    /// Its slope there, rad/s per °C.
    pub slope_rad_s_per_celsius: Vector3,
    /// Its curvature, rad/s per °C²: the factor of (T − reference)².
    pub curvature_rad_s_per_celsius2: Vector3,
    /// The coldest temperature that was seen, °C.
    pub coldest_celsius: f32,
    /// The warmest, °C.
    pub warmest_celsius: f32,
}

/// What the outputs look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Preferences {
    /// What is sent.
    pub format: OutputFormat,
    /// How often, per second.
    pub rate_hz: u16,
    /// Bits per second on the UART.
    pub baud: u32,
}

/// A telemetry format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum OutputFormat {
    /// Labelled text.
    #[default]
    Text,
    /// The classic tutorial's line.
    Classic,
    /// Lines for Teleplot.
    Teleplot,
    /// The packet of the teapot demo.
    Teapot,
    /// MAVLink 2.
    Mavlink,
    /// The flight log.
    Log,
}

impl OutputFormat {
    /// Every format, in the order of [`OutputFormat::NAMES`]. A stored format is its place in here, so new ones come last.
    pub const ALL: [Self; 6] = [
        Self::Text,
        Self::Classic,
        Self::Teleplot,
        Self::Teapot,
        Self::Mavlink,
        Self::Log,
    ];

    /// Their names.
    pub const NAMES: [&str; 6] = ["text", "classic", "teleplot", "teapot", "mavlink", "log"];

    /// The format of this name.
    pub fn parse(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Text => "text",
            Self::Classic => "classic",
            Self::Teleplot => "teleplot",
            Self::Teapot => "teapot",
            Self::Mavlink => "mavlink",
            Self::Log => "log",
        }
    }
}

impl Default for Preferences {
    fn default() -> Self {
        Self {
            format: OutputFormat::Text,
            rate_hz: 50,
            baud: 115_200,
        }
    }
}

/// Everything that is stored.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Record {
    /// What is known about the sensor.
    pub calibration: Calibration,
    /// What the outputs look like.
    pub preferences: Preferences,
}
