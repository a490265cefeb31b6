//! One burst in, one snapshot out: the only file that knows the order of the steps.
//!
//! decode → align (sensor to body) → calibrate (offsets at rest) → estimate → health.
//!
//! There is a snapshot for every burst, from the first one on; until the start-up average is
//! complete it carries [`Flags::CALIBRATING`]. At that moment the filter starts again with the
//! offsets removed, and yaw starts again at zero.
//!
//! Deadline: a fraction of the sample period, 1 ms. There is no loop in it and no wait, and the
//! longest path is a few hundred instructions longer than the shortest.

use crate::attitude::{EulerAngles, Quaternion, Vector3};
use crate::calibration::{AtRest, Mount, Progress, StartupAverage, StartupScale};
use crate::estimator::{ClassicAngles, Estimator, FilterKind, Sample};
use crate::health::{Flags, FreezeWatch};
use crate::mpu6050::{Burst, Config, Part, RawSample};
use crate::units::STANDARD_GRAVITY_M_S2;

/// What the pipeline has to know beforehand.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Settings {
    /// How the sensor is configured: its full scales give the bytes their meaning.
    pub sensor: Config,
    /// Which part it is: its temperature scale.
    pub part: &'static Part,
    /// How it is mounted. Default: face up, X forward.
    pub mount: Mount,
    /// Which filter runs. Default: [`FilterKind::AxisKalman`].
    pub filter: FilterKind,
    /// Samples at rest to average at start. Default: 1000. Zero removes no offsets at all.
    pub averaging_samples: u16,
}

impl Settings {
    /// The defaults, for this part.
    pub const fn new(part: &'static Part) -> Self {
        Self {
            sensor: Config::DEFAULT,
            part,
            mount: Mount::Z_UP,
            filter: FilterKind::AxisKalman,
            averaging_samples: 1000,
        }
    }
}

/// An attitude, at one moment, with what there is to say about it.
///
/// The layout is part of the interface: debuggers and emulators read it from memory.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Snapshot {
    /// When the sample was captured, in microseconds since start.
    pub t_us: u64,
    /// Body (forward-right-down) to earth (north-east-down). Its sign is continuous.
    pub attitude: Quaternion,
    /// The body's rates p, q, r about forward, right and down, offsets at rest removed.
    pub body_rates_rad_s: Vector3,
    /// What there is to say about the sample.
    pub flags: Flags,
}

const _: () = assert!(size_of::<Snapshot>() == 40);
const _: () = assert!(core::mem::offset_of!(Snapshot, attitude) == 8);
const _: () = assert!(core::mem::offset_of!(Snapshot, body_rates_rad_s) == 24);
const _: () = assert!(core::mem::offset_of!(Snapshot, flags) == 36);

impl Snapshot {
    /// Roll, pitch and yaw. Yaw is relative to the heading at start.
    pub fn euler(&self) -> EulerAngles {
        self.attitude.to_euler()
    }
}

/// The whole trip of a sample, with the state it needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pipeline {
    settings: Settings,
    m_s2_per_count: f32,
    rad_s_per_count: f32,
    startup: Option<StartupAverage>,
    /// Offsets in body axes.
    rate_offset_rad_s: Vector3,
    force_offset_m_s2: Vector3,
    estimator: Estimator,
    freeze_watch: FreezeWatch,
    sample: Sample,
    temperature_celsius: f32,
}

impl Pipeline {
    /// A pipeline that waits for its first burst.
    pub fn new(settings: &Settings) -> Self {
        let Config {
            accelerometer_range,
            gyroscope_range,
            ..
        } = settings.sensor;
        let scale = StartupScale {
            counts_per_degree_s: gyroscope_range.counts_per_degree_s(),
            counts_per_g: accelerometer_range.counts_per_g(),
        };
        let samples = settings.averaging_samples;
        Self {
            settings: *settings,
            m_s2_per_count: accelerometer_range.m_s2_per_count(),
            rad_s_per_count: gyroscope_range.rad_s_per_count(),
            startup: (samples > 0).then(|| StartupAverage::new(samples, scale)),
            rate_offset_rad_s: Vector3::ZERO,
            force_offset_m_s2: Vector3::ZERO,
            estimator: Estimator::new(settings.filter),
            freeze_watch: FreezeWatch::new(),
            sample: Sample::default(),
            temperature_celsius: 0.0,
        }
    }

    /// Takes one burst and gives the attitude at its time.
    pub fn update(&mut self, burst: &Burst) -> Snapshot {
        let raw = RawSample::decode(&burst.bytes);
        self.temperature_celsius = raw.temperature.to_celsius(self.settings.part);
        let startup_flags = self.average_at_rest(&raw);

        self.sample = Sample {
            t_us: burst.captured_at_us,
            specific_force_m_s2: self.in_body(raw.accelerometer.0, self.m_s2_per_count)
                - self.force_offset_m_s2,
            angular_rate_rad_s: self.in_body(raw.gyroscope.0, self.rad_s_per_count)
                - self.rate_offset_rad_s,
        };
        let estimate = self.estimator.update(&self.sample);

        let remarks = estimate.remarks;
        let flags = startup_flags
            .with(Flags::MISSED, burst.missed_before > 0)
            .with(Flags::GAP, remarks.gap)
            .with(Flags::TIME, remarks.time_went_back)
            .with(Flags::REJECTED, remarks.rejected)
            .with(Flags::FREE_FALL, remarks.no_gravity)
            .with(Flags::GYROSCOPE_SATURATED, raw.gyroscope.is_saturated())
            .with(
                Flags::ACCELEROMETER_SATURATED,
                raw.accelerometer.is_saturated(),
            )
            .with(Flags::FROZEN, self.freeze_watch.update(&burst.bytes));
        Snapshot {
            t_us: burst.captured_at_us,
            attitude: estimate.attitude,
            body_rates_rad_s: estimate.body_rates_rad_s,
            flags,
        }
    }

    /// The settings it runs with.
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The last sample, calibrated, in body axes.
    pub const fn sample(&self) -> &Sample {
        &self.sample
    }

    /// The die temperature of the last sample in °C.
    pub const fn temperature_celsius(&self) -> f32 {
        self.temperature_celsius
    }

    /// The gyroscope's offset in body axes; zero until the average is complete.
    pub const fn rate_offset_rad_s(&self) -> Vector3 {
        self.rate_offset_rad_s
    }

    /// The numbers of the classic tutorial; `None` unless [`FilterKind::Classic`] runs.
    pub fn classic_angles(&self) -> Option<ClassicAngles> {
        self.estimator.classic_angles()
    }

    fn average_at_rest(&mut self, raw: &RawSample) -> Flags {
        let Some(startup) = &mut self.startup else {
            return Flags::NONE;
        };
        let progress = startup.update(
            raw.gyroscope.0,
            raw.accelerometer.0,
            self.temperature_celsius,
        );
        match progress {
            Progress::Averaging => Flags::CALIBRATING,
            Progress::Moved => Flags::CALIBRATING | Flags::MOVED,
            Progress::Done(at_rest) => {
                self.startup = None;
                self.calibrate(&at_rest);
                Flags::NONE
            }
        }
    }

    fn calibrate(&mut self, at_rest: &AtRest) {
        let mount = self.settings.mount;
        let [x, y, z] = at_rest.gyroscope_counts;
        self.rate_offset_rad_s = mount
            .to_body(Vector3::new(x, y, z))
            .scale(self.rad_s_per_count);
        if self.settings.filter == FilterKind::Classic {
            // The tutorial takes the table for level: whatever is not one g upwards is offset.
            let [x, y, z] = at_rest.accelerometer_counts;
            let gravity = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
            self.force_offset_m_s2 = mount
                .to_body(Vector3::new(x, y, z))
                .scale(self.m_s2_per_count)
                - gravity;
        }
        self.estimator.restart();
    }

    fn in_body(&self, [x, y, z]: [i16; 3], per_count: f32) -> Vector3 {
        let sensor = Vector3::new(f32::from(x), f32::from(y), f32::from(z));
        self.settings.mount.to_body(sensor).scale(per_count)
    }
}
