//! Encoding of a record: its fields in a fixed order, without padding.
//!
//! Integers are little-endian, floats their IEEE 754 bits, a mount its four-letter name. An
//! optional field is a byte 0, or a byte 1 and the field. Each record has exactly one encoding:
//! bytes that decode encode to the same bytes. The decoder refuses anything else, such as bytes
//! left over or a number that is not finite.
//!
//! A change that this code could not read raises [`Stored::VERSION`]; `decode` keeps reading the
//! earlier versions.

use heapless::Vec;

use super::compass::CompassSettings;
use super::preferences::{OutputFormat, Preferences};
use super::record::Record;
use crate::attitude::{Quaternion, Vector3};
use crate::calibration::{
    AccelerometerCorrection, Calibration, CompassCorrection, GyroscopeOffset, Matrix3, Mount,
    SymmetricMatrix, TemperatureModel,
};
use crate::compass::Choice;

/// Longest body, in bytes, in this and every later version.
pub(super) const BODY_CAPACITY: usize = 240;

/// True if the settings of the compass are read. The minimal firmware has no compass and never
/// saves.
const READS_COMPASS: bool = cfg!(any(feature = "full", not(feature = "firmware")));

/// Buffer of a body.
pub(super) type Writer = Vec<u8, BODY_CAPACITY>;

/// Data that can be kept in flash.
pub(super) trait Stored: Copy {
    /// Version of the encoding that [`encode`](Self::encode) writes; the first is 1.
    const VERSION: u16;

    /// Appends the body; an error if it is too long.
    fn encode(&self, body: &mut Writer) -> Result<(), TooLong>;

    /// Decodes a body of a version up to [`VERSION`](Self::VERSION); `None` if it is not valid.
    fn decode(version: u16, body: &[u8]) -> Option<Self>;
}

/// The body is longer than [`BODY_CAPACITY`].
#[derive(Debug)]
pub(super) struct TooLong;

impl Stored for Record {
    const VERSION: u16 = 4;

    fn encode(&self, body: &mut Writer) -> Result<(), TooLong> {
        let calibration = &self.calibration;
        put_optional(body, calibration.mount, put_mount)?;
        put_optional(body, calibration.gyroscope, |body, gyroscope| {
            put_vector(body, gyroscope.offset_rad_s)?;
            put_numbers(body, &[gyroscope.temperature_celsius])
        })?;
        put_optional(body, calibration.temperature, |body, model| {
            put_numbers(body, &[model.reference_celsius])?;
            put_vector(body, model.offset_rad_s)?;
            put_vector(body, model.slope_rad_s_per_celsius)?;
            put_vector(body, model.curvature_rad_s_per_celsius2)?;
            put_numbers(body, &[model.coldest_celsius, model.warmest_celsius])
        })?;
        put_optional(body, calibration.accelerometer, |body, correction| {
            put_vector(body, correction.offset_m_s2)?;
            let m = correction.matrix;
            put_numbers(body, &[m.xx, m.yy, m.zz, m.xy, m.xz, m.yz])
        })?;
        put_optional(body, calibration.level, |body, level| {
            put_numbers(body, &[level.w, level.x, level.y, level.z])
        })?;
        let preferences = &self.preferences;
        let is_format = |format: &OutputFormat| *format == preferences.format;
        let format = OutputFormat::ALL.iter().position(is_format);
        put(body, &[format.unwrap_or_default() as u8])?;
        put(body, &preferences.rate_hz.to_le_bytes())?;
        put(body, &preferences.baud.to_le_bytes())?;
        put_optional(body, calibration.gyroscope_matrix, |body, matrix| {
            put_rows(body, matrix.rows)
        })?;
        put_compass(body, &self.compass)?;
        put_numbers(body, &[self.compass.declination_rad])
    }

    fn decode(version: u16, body: &[u8]) -> Option<Self> {
        if !matches!(version, 1..=4) {
            return None;
        }
        let mut body = Reader(body);
        let mut calibration = Calibration {
            mount: body.optional(Reader::mount)?,
            gyroscope: body.optional(|body| {
                Some(GyroscopeOffset {
                    offset_rad_s: body.vector()?,
                    temperature_celsius: body.number()?,
                })
            })?,
            temperature: body.optional(|body| {
                Some(TemperatureModel {
                    reference_celsius: body.number()?,
                    offset_rad_s: body.vector()?,
                    slope_rad_s_per_celsius: body.vector()?,
                    curvature_rad_s_per_celsius2: body.vector()?,
                    coldest_celsius: body.number()?,
                    warmest_celsius: body.number()?,
                })
            })?,
            accelerometer: body.optional(|body| {
                let offset_m_s2 = body.vector()?;
                let [xx, yy, zz, xy, xz, yz] = body.numbers()?;
                let matrix = SymmetricMatrix {
                    xx,
                    yy,
                    zz,
                    xy,
                    xz,
                    yz,
                };
                Some(AccelerometerCorrection {
                    offset_m_s2,
                    matrix,
                })
            })?,
            level: body.optional(|body| {
                let [w, x, y, z] = body.numbers()?;
                Some(Quaternion { w, x, y, z })
            })?,
            gyroscope_matrix: None,
        };
        let preferences = Preferences {
            format: {
                let [format] = body.take()?;
                *OutputFormat::ALL.get(usize::from(format))?
            },
            rate_hz: u16::from_le_bytes(body.take()?),
            baud: u32::from_le_bytes(body.take()?),
        };
        // Version 3 knew no gyroscope matrix.
        if version >= 4 {
            let rows = body.optional(Reader::rows)?;
            calibration.gyroscope_matrix = rows.map(|rows| Matrix3 { rows });
        }
        // Version 1 knew no compass.
        let compass = match version {
            2.. if READS_COMPASS => body.compass(version)?,
            _ => CompassSettings::default(),
        };
        let is_read = body.0.is_empty() || !READS_COMPASS;
        let is_usable = preferences.rate_hz != 0 && preferences.baud != 0;
        (is_usable && is_read).then_some(Self {
            calibration,
            preferences,
            compass,
        })
    }
}

/// Returns the body of a record; `None` if it is too long.
pub(super) fn body(record: &Record) -> Option<Writer> {
    let mut body = Writer::new();
    record.encode(&mut body).ok()?;
    Some(body)
}

// Functions that run once a save are not inlined: size counts here, time does not.
#[inline(never)]
fn put(body: &mut Writer, bytes: &[u8]) -> Result<(), TooLong> {
    body.extend_from_slice(bytes).map_err(|_| TooLong)
}

#[inline(never)]
fn put_numbers(body: &mut Writer, numbers: &[f32]) -> Result<(), TooLong> {
    numbers
        .iter()
        .try_for_each(|number| put(body, &number.to_le_bytes()))
}

fn put_mount(body: &mut Writer, mount: Mount) -> Result<(), TooLong> {
    put(body, mount.name().as_bytes())
}

fn put_compass(body: &mut Writer, compass: &CompassSettings) -> Result<(), TooLong> {
    let is_choice = |choice: &Choice| *choice == compass.choice;
    let choice = Choice::ALL.iter().position(is_choice);
    put(body, &[choice.unwrap_or_default() as u8])?;
    put_optional(body, compass.mount, put_mount)?;
    put_optional(body, compass.correction, |body, correction| {
        put_rows(body, correction.matrix)?;
        put_vector(body, correction.hard_iron_ut)
    })
}

fn put_vector(body: &mut Writer, vector: Vector3) -> Result<(), TooLong> {
    put_numbers(body, &[vector.x, vector.y, vector.z])
}

fn put_rows(body: &mut Writer, rows: [Vector3; 3]) -> Result<(), TooLong> {
    rows.into_iter().try_for_each(|row| put_vector(body, row))
}

fn put_optional<T>(
    body: &mut Writer,
    field: Option<T>,
    put_field: impl FnOnce(&mut Writer, T) -> Result<(), TooLong>,
) -> Result<(), TooLong> {
    put(body, &[field.is_some().into()])?;
    field.map_or(Ok(()), |field| put_field(body, field))
}

/// Unread part of a body.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*taken)
    }

    #[inline(never)]
    fn number(&mut self) -> Option<f32> {
        let number = f32::from_le_bytes(self.take()?);
        number.is_finite().then_some(number)
    }

    fn numbers<const N: usize>(&mut self) -> Option<[f32; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number()?;
        }
        Some(numbers)
    }

    fn vector(&mut self) -> Option<Vector3> {
        let [x, y, z] = self.numbers()?;
        Some(Vector3 { x, y, z })
    }

    fn rows(&mut self) -> Option<[Vector3; 3]> {
        Some([self.vector()?, self.vector()?, self.vector()?])
    }

    fn mount(&mut self) -> Option<Mount> {
        let name = self.take::<4>()?;
        let mount = Mount::parse(core::str::from_utf8(&name).ok()?)?;
        // An alias would be a second encoding.
        (mount.name().as_bytes() == name).then_some(mount)
    }

    fn compass(&mut self, version: u16) -> Option<CompassSettings> {
        let [choice] = self.take()?;
        Some(CompassSettings {
            choice: *Choice::ALL.get(usize::from(choice))?,
            mount: self.optional(Self::mount)?,
            correction: self.optional(|body| {
                Some(CompassCorrection {
                    matrix: body.rows()?,
                    hard_iron_ut: body.vector()?,
                })
            })?,
            // Version 2 knew no declination.
            declination_rad: match version {
                2 => 0.0,
                _ => self.number()?,
            },
        })
    }

    /// Reads an optional field: `Some(None)` if it is absent, `None` if it is not valid.
    fn optional<T>(&mut self, field: impl FnOnce(&mut Self) -> Option<T>) -> Option<Option<T>> {
        match self.take()? {
            [0] => Some(None),
            [1] => field(self).map(Some),
            _ => None,
        }
    }
}
