//! Settings of a pipeline for C, and their checks.

use core::f32::consts::PI;
use core::ffi::c_char;

use aplomb::calibration::CompassAlignment;
use aplomb::estimator::LONGEST_DELAY_US;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::{AccelerometerRange, Config, GyroscopeRange, LowPass, Part};
use aplomb::pipeline::{Settings, compass_knowledge};

use crate::AplombStatus;
use crate::mount;
use crate::record::AplombCalibration;

/// Knowledge of the accelerometer's offset.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AplombAccelerometerKnowledge {
    /// As the calibration says.
    ByCalibration = 0,
    /// A sensor as it left the factory.
    Factory = 1,
    /// Calibrated on six sides.
    SixPoses = 2,
    /// Calibrated with cross-axis terms. Implies a calibrated gyroscope.
    Calibrated = 3,
}

/// Knowledge of the compass's hard iron.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AplombCompassKnowledge {
    /// As the calibration says.
    ByCalibration = 0,
    /// A compass that was never calibrated: no heading before the body has turned.
    Factory = 1,
    /// A compass whose readings are calibrated.
    Calibrated = 2,
    /// A compass whose readings lack the hard iron that the filter found in an earlier run.
    HardIron = 3,
}

/// Settings of a pipeline. Begin with `aplomb_default_settings`, and change what differs.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AplombSettings {
    /// The sensor axes along which forward and down point, such as "+x-z"; "z-up" (chip face up),
    /// "z-down". A mount of the calibration comes first.
    pub mount: [c_char; 8],
    /// Full scale of the accelerometer: 2, 4, 8 or 16 g.
    pub accelerometer_range_g: u16,
    /// Full scale of the gyroscope: 250, 500, 1000 or 2000 degrees per second.
    pub gyroscope_range_deg_s: u16,
    /// Bandwidth of the low-pass filter: 256, 188, 98, 42, 20, 10 or 5 Hz.
    pub low_pass_hz: u16,
    /// Divider of the sample rate, register SMPLRT_DIV. There are 1,000 / (divider + 1) samples a
    /// second, or 8,000 / (divider + 1) if `low_pass_hz` is 256. An MPU-6500 ignores the divider at
    /// 256 Hz: set 0. The divider has to match the real rate, that of samples in SI units too: 3 at
    /// 256 Hz for 2,000 a second. Slower samples are pauses.
    pub sample_rate_divider: u8,
    /// Answer of the sensor's register WHO_AM_I, 0x75, which is to be read: 0x68 for an MPU-6050.
    /// Delay, temperature and some registers of others differ.
    pub who_am_i: u8,
    /// Age of a sample's content at the sample's time, µs, 100,000 at most. Negative: that of the
    /// low-pass filter.
    pub sensor_delay_us: i32,
    /// A value of `AplombAccelerometerKnowledge`.
    pub accelerometer_knowledge: u32,
    /// A value of `AplombCompassKnowledge`, for a pipeline with a compass.
    pub compass_knowledge: u32,
    /// Declination of the place, rad, east positive: the heading is then from true north.
    pub declination_rad: f32,
    /// Not 0 if the caller reads the sensor's full scales back while `aplomb_awaits_scale_check`
    /// returns true, and then reports `APLOMB_FLAG_SCALES_VERIFIED`.
    pub verifies_scales: u8,
    /// Zero; reserved.
    pub reserved: [u8; 3],
    /// Calibration of the sensor.
    pub calibration: AplombCalibration,
}

impl AplombSettings {
    /// Returns the settings of the library.
    pub(crate) fn checked(&self) -> Result<Settings, AplombStatus> {
        let mount = mount::parse(&self.mount);
        let accelerometer_range = AccelerometerRange::ALL
            .into_iter()
            .find(|range| range.full_scale_g() == self.accelerometer_range_g);
        let gyroscope_range = GyroscopeRange::ALL
            .into_iter()
            .find(|range| range.full_scale_degrees_s() == self.gyroscope_range_deg_s);
        let low_pass = LowPass::ALL
            .into_iter()
            .find(|filter| filter.gyroscope_bandwidth_hz() == self.low_pass_hz);
        let part = Part::from_who_am_i(self.who_am_i).ok_or(AplombStatus::UnknownPart)?;
        let mut settings = Settings::new(part);
        let sensor = &mut settings.sensor;
        sensor.accelerometer_range = accelerometer_range.ok_or(AplombStatus::WrongRange)?;
        sensor.gyroscope_range = gyroscope_range.ok_or(AplombStatus::WrongRange)?;
        sensor.low_pass = low_pass.ok_or(AplombStatus::WrongLowPass)?;
        sensor.sample_rate_divider = self.sample_rate_divider;
        settings.mount = mount.ok_or(AplombStatus::WrongMount)?;
        settings.calibration = self.calibration.checked()?;
        settings.verifies_scales = self.verifies_scales != 0;
        settings.sensor_delay_us = u32::try_from(self.sensor_delay_us).ok();
        if (settings.sensor_delay_us).is_some_and(|delay_us| delay_us > LONGEST_DELAY_US) {
            return Err(AplombStatus::WrongDelay);
        }
        Ok(settings)
    }

    /// Returns the knowledge of the accelerometer; `None` if the calibration says it.
    pub(crate) fn accelerometer(&self) -> Result<Option<AccelerometerKnowledge>, AplombStatus> {
        const KNOWLEDGE: [Option<AccelerometerKnowledge>; 4] = [
            None,
            Some(AccelerometerKnowledge::Factory),
            Some(AccelerometerKnowledge::SixPoses),
            Some(AccelerometerKnowledge::Calibrated),
        ];
        let index = self.accelerometer_knowledge as usize;
        KNOWLEDGE
            .get(index)
            .copied()
            .ok_or(AplombStatus::WrongKnowledge)
    }

    /// Returns the compass's place and correction.
    pub(crate) fn compass_alignment(&self) -> Result<CompassAlignment, AplombStatus> {
        let mount = self.checked()?.mount();
        Ok(self.calibration.compass()?.alignment(mount))
    }

    /// Returns the knowledge of this compass's hard iron.
    pub(crate) fn compass_knowledge(
        &self,
        alignment: &CompassAlignment,
    ) -> Result<CompassKnowledge, AplombStatus> {
        match self.compass_knowledge {
            0 => Ok(compass_knowledge(alignment)),
            1 => Ok(CompassKnowledge::Factory),
            2 => Ok(CompassKnowledge::Calibrated),
            3 => Ok(CompassKnowledge::HardIron),
            _ => Err(AplombStatus::WrongKnowledge),
        }
    }

    /// Returns the declination, rad.
    pub(crate) fn declination(&self) -> Result<f32, AplombStatus> {
        if self.declination_rad.abs() <= PI {
            Ok(self.declination_rad)
        } else {
            Err(AplombStatus::WrongDeclination)
        }
    }
}

/// Returns the settings of an MPU-6050 at 1,000 samples a second, chip face up, X forward.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_default_settings() -> AplombSettings {
    let config = Config::DEFAULT;
    AplombSettings {
        mount: mount::padded("z-up"),
        accelerometer_range_g: config.accelerometer_range.full_scale_g(),
        gyroscope_range_deg_s: config.gyroscope_range.full_scale_degrees_s(),
        low_pass_hz: config.low_pass.gyroscope_bandwidth_hz(),
        sample_rate_divider: config.sample_rate_divider,
        who_am_i: Part::MPU_6050.who_am_i,
        sensor_delay_us: -1,
        accelerometer_knowledge: AplombAccelerometerKnowledge::ByCalibration as u32,
        compass_knowledge: AplombCompassKnowledge::ByCalibration as u32,
        declination_rad: 0.0,
        verifies_scales: 0,
        reserved: [0; 3],
        calibration: AplombCalibration::default(),
    }
}
