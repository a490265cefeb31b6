//! The calibration for C, and its record in the form of the module's flash.

use core::ffi::c_char;

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::calibration::{
    AccelerometerCorrection, Calibration, CompassCorrection, GyroscopeOffset,
    ImplausibleCalibration, Matrix3, SymmetricMatrix, TemperatureModel,
};
use aplomb::settings::{CompassSettings, Record, storage};
use embedded_storage::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashErrorKind, ReadNorFlash,
};

use crate::AplombStatus;
use crate::mount;

/// Bytes of a record.
pub const APLOMB_RECORD_BYTES: usize = 512;

/// Calibration as bytes with a checksum, to keep in flash or in a file. The form is that of the
/// module's flash, with slots of 256 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AplombRecord {
    /// Contents, to be kept as they are.
    pub bytes: [u8; APLOMB_RECORD_BYTES],
}

/// Calibration of one sensor and its compass, in SI units. That of the sensor is in its own axes.
/// All zero is none.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AplombCalibration {
    /// Mount as in the settings; empty if the settings say it.
    pub mount: [c_char; 8],
    /// Not 0 if the gyroscope's offset and temperature are known.
    pub has_gyroscope: u8,
    /// Not 0 if the offset over temperature is known.
    pub has_temperature: u8,
    /// Not 0 if the accelerometer's offset and matrix are known.
    pub has_accelerometer: u8,
    /// Not 0 if the level is known.
    pub has_level: u8,
    /// Offset of the gyroscope, rad/s.
    pub gyroscope_offset_rad_s: [f32; 3],
    /// Die temperature of that offset, degrees Celsius.
    pub gyroscope_celsius: f32,
    /// Reference of the offset over temperature, degrees Celsius.
    pub temperature_reference_celsius: f32,
    /// Offset at the reference, rad/s.
    pub temperature_offset_rad_s: [f32; 3],
    /// Slope, rad/s per degree Celsius.
    pub temperature_slope_rad_s_per_celsius: [f32; 3],
    /// Curvature, rad/s per square of a degree Celsius.
    pub temperature_curvature_rad_s_per_celsius2: [f32; 3],
    /// Coldest temperature that was measured, degrees Celsius.
    pub temperature_coldest_celsius: f32,
    /// Warmest temperature that was measured, degrees Celsius.
    pub temperature_warmest_celsius: f32,
    /// Offset of the accelerometer, m/s²: force = matrix * (reading - offset).
    pub accelerometer_offset_m_s2: [f32; 3],
    /// Symmetric matrix: xx, yy, zz, xy, xz, yz.
    pub accelerometer_matrix: [f32; 6],
    /// Quaternion w, x, y, z of a small rotation from the mounted sensor to the body.
    pub level: [f32; 4],
    /// Mount of the compass, as in the settings; empty if it is that of the sensor.
    pub compass_mount: [c_char; 8],
    /// Not 0 if the compass's matrix and hard iron are known.
    pub has_compass: u8,
    /// Not 0 if the gyroscope's matrix is known.
    pub has_gyroscope_matrix: u8,
    /// Zero; reserved.
    pub reserved: [u8; 2],
    /// Matrix of the compass by rows, in body axes: field = matrix * reading - hard iron.
    pub compass_matrix: [f32; 9],
    /// Hard iron, µT in body axes.
    pub compass_hard_iron_ut: [f32; 3],
    /// Matrix of the gyroscope by rows, in sensor axes: rate = matrix * (reading - offset).
    /// `aplomb calibrate` finds it.
    pub gyroscope_matrix: [f32; 9],
}

impl AplombCalibration {
    /// Returns the calibration of the library.
    pub(crate) fn checked(&self) -> Result<Calibration, AplombStatus> {
        let vector = |[x, y, z]: [f32; 3]| Vector3::new(x, y, z);
        let mut calibration = Calibration::NONE;
        if self.mount[0] != 0 {
            let mount = mount::parse(&self.mount);
            calibration.mount = Some(mount.ok_or(AplombStatus::WrongMount)?);
        }
        calibration.gyroscope = (self.has_gyroscope != 0).then_some(GyroscopeOffset {
            offset_rad_s: vector(self.gyroscope_offset_rad_s),
            temperature_celsius: self.gyroscope_celsius,
        });
        calibration.temperature = (self.has_temperature != 0).then_some(TemperatureModel {
            reference_celsius: self.temperature_reference_celsius,
            offset_rad_s: vector(self.temperature_offset_rad_s),
            slope_rad_s_per_celsius: vector(self.temperature_slope_rad_s_per_celsius),
            curvature_rad_s_per_celsius2: vector(self.temperature_curvature_rad_s_per_celsius2),
            coldest_celsius: self.temperature_coldest_celsius,
            warmest_celsius: self.temperature_warmest_celsius,
        });
        let [xx, yy, zz, xy, xz, yz] = self.accelerometer_matrix;
        let correction = AccelerometerCorrection {
            offset_m_s2: vector(self.accelerometer_offset_m_s2),
            matrix: SymmetricMatrix {
                xx,
                yy,
                zz,
                xy,
                xz,
                yz,
            },
        };
        calibration.accelerometer = (self.has_accelerometer != 0).then_some(correction);
        let [w, x, y, z] = self.level;
        calibration.level = (self.has_level != 0).then_some(Quaternion { w, x, y, z });
        let matrix = Matrix3 {
            rows: rows(self.gyroscope_matrix),
        };
        calibration.gyroscope_matrix = (self.has_gyroscope_matrix != 0).then_some(matrix);
        calibration.check().map_err(status_of)?;
        Ok(calibration)
    }

    /// Returns the compass's settings of the library.
    pub(crate) fn compass(&self) -> Result<CompassSettings, AplombStatus> {
        let mut compass = CompassSettings::default();
        if self.compass_mount[0] != 0 {
            let mount = mount::parse(&self.compass_mount);
            compass.mount = Some(mount.ok_or(AplombStatus::WrongMount)?);
        }
        if self.has_compass != 0 {
            let [x, y, z] = self.compass_hard_iron_ut;
            let numbers = [&self.compass_matrix[..], &self.compass_hard_iron_ut];
            let is_finite = numbers.into_iter().flatten().all(|it| it.is_finite());
            let correction = CompassCorrection {
                matrix: rows(self.compass_matrix),
                hard_iron_ut: Vector3::new(x, y, z),
            };
            if !is_finite {
                return Err(AplombStatus::NotStorable);
            }
            if !correction.is_plausible() {
                return Err(AplombStatus::WrongCompass);
            }
            compass.correction = Some(correction);
        }
        Ok(compass)
    }
}

impl From<&Record> for AplombCalibration {
    fn from(record: &Record) -> Self {
        let calibration = &record.calibration;
        let array = |vector: Vector3| [vector.x, vector.y, vector.z];
        let mut found = Self::default();
        if let Some(mount) = calibration.mount {
            found.mount = mount::padded(mount.name());
        }
        if let Some(gyroscope) = calibration.gyroscope {
            found.has_gyroscope = 1;
            found.gyroscope_offset_rad_s = array(gyroscope.offset_rad_s);
            found.gyroscope_celsius = gyroscope.temperature_celsius;
        }
        if let Some(model) = calibration.temperature {
            found.has_temperature = 1;
            found.temperature_reference_celsius = model.reference_celsius;
            found.temperature_offset_rad_s = array(model.offset_rad_s);
            found.temperature_slope_rad_s_per_celsius = array(model.slope_rad_s_per_celsius);
            found.temperature_curvature_rad_s_per_celsius2 =
                array(model.curvature_rad_s_per_celsius2);
            found.temperature_coldest_celsius = model.coldest_celsius;
            found.temperature_warmest_celsius = model.warmest_celsius;
        }
        if let Some(correction) = calibration.accelerometer {
            let m = correction.matrix;
            found.has_accelerometer = 1;
            found.accelerometer_offset_m_s2 = array(correction.offset_m_s2);
            found.accelerometer_matrix = [m.xx, m.yy, m.zz, m.xy, m.xz, m.yz];
        }
        if let Some(level) = calibration.level {
            found.has_level = 1;
            found.level = [level.w, level.x, level.y, level.z];
        }
        if let Some(matrix) = calibration.gyroscope_matrix {
            found.has_gyroscope_matrix = 1;
            found.gyroscope_matrix = elements(matrix.rows);
        }
        if let Some(mount) = record.compass.mount {
            found.compass_mount = mount::padded(mount.name());
        }
        if let Some(correction) = record.compass.correction {
            found.has_compass = 1;
            found.compass_matrix = elements(correction.matrix);
            found.compass_hard_iron_ut = array(correction.hard_iron_ut);
        }
        found
    }
}

/// Returns the status of a calibration that no sensor has.
const fn status_of(error: ImplausibleCalibration) -> AplombStatus {
    match error {
        ImplausibleCalibration::Accelerometer => AplombStatus::WrongAccelerometer,
        ImplausibleCalibration::GyroscopeOffset => AplombStatus::WrongGyroscopeOffset,
        ImplausibleCalibration::TemperatureModelOffset => AplombStatus::WrongTemperatureOffset,
        ImplausibleCalibration::TemperatureModelRange => AplombStatus::WrongTemperatureRange,
        ImplausibleCalibration::GyroscopeMatrix => AplombStatus::WrongGyroscopeMatrix,
        ImplausibleCalibration::Level => AplombStatus::WrongLevel,
        // The enum may grow.
        _ => AplombStatus::NotStorable,
    }
}

/// Returns the rows of a matrix.
fn rows([xx, xy, xz, yx, yy, yz, zx, zy, zz]: [f32; 9]) -> [Vector3; 3] {
    [
        Vector3::new(xx, xy, xz),
        Vector3::new(yx, yy, yz),
        Vector3::new(zx, zy, zz),
    ]
}

/// Returns the elements of a matrix by rows.
fn elements([x, y, z]: [Vector3; 3]) -> [f32; 9] {
    [x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z]
}

/// Writes a calibration as a record, that of the compass included.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_encode_record(
    calibration: Option<&AplombCalibration>,
    record: Option<&mut AplombRecord>,
) -> AplombStatus {
    let (Some(calibration), Some(out)) = (calibration, record) else {
        return AplombStatus::NullPointer;
    };
    let mut record = Record::default();
    match (calibration.checked(), calibration.compass()) {
        (Ok(sensor), Ok(compass)) => {
            record.calibration = sensor;
            record.compass = compass;
        }
        (Err(status), _) | (_, Err(status)) => return status,
    }
    let mut memory = Memory([0xFF; APLOMB_RECORD_BYTES]);
    if storage::save(&mut memory, &record).is_err() {
        return AplombStatus::NotStorable;
    }
    out.bytes = memory.0;
    AplombStatus::Ok
}

/// Reads the calibration of a record.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_decode_record(
    record: Option<&AplombRecord>,
    calibration: Option<&mut AplombCalibration>,
) -> AplombStatus {
    let (Some(record), Some(out)) = (record, calibration) else {
        return AplombStatus::NullPointer;
    };
    let Some(record) = storage::load(&mut Memory(record.bytes)).record else {
        return AplombStatus::NoRecord;
    };
    *out = AplombCalibration::from(&record);
    AplombStatus::Ok
}

/// A record's bytes as flash of two slots.
struct Memory([u8; APLOMB_RECORD_BYTES]);

impl Memory {
    /// Returns the bytes from `start` on.
    fn range(&mut self, start: u32, length: usize) -> Result<&mut [u8], NorFlashErrorKind> {
        let start = start as usize;
        let end = start.checked_add(length);
        let bytes = end.and_then(|end| self.0.get_mut(start..end));
        bytes.ok_or(NorFlashErrorKind::OutOfBounds)
    }
}

impl ErrorType for Memory {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 1;

    fn read(&mut self, start: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
        let found = self.range(start, bytes.len())?;
        bytes
            .iter_mut()
            .zip(found)
            .for_each(|(to, from)| *to = *from);
        Ok(())
    }

    fn capacity(&self) -> usize {
        APLOMB_RECORD_BYTES
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = APLOMB_RECORD_BYTES / 2;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
        let length = to.saturating_sub(from) as usize;
        self.range(from, length)?.fill(0xFF);
        Ok(())
    }

    fn write(&mut self, start: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
        let found = self.range(start, bytes.len())?;
        found
            .iter_mut()
            .zip(bytes)
            .for_each(|(to, from)| *to = *from);
        Ok(())
    }
}

impl MultiwriteNorFlash for Memory {}
