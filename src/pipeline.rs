//! One burst in, one snapshot out: the only file that knows the order of the steps.
//!
//! decode → align (sensor to body) → calibrate (offsets at rest) → estimate → health.
//!
//! There is a snapshot for every burst, from the first one on; it carries [`Flags::CALIBRATING`] until
//! the gyroscope's offset is known. [`FilterKind::Kalman`] finds it by itself, at rest and in motion,
//! while it runs. The other filters wait for the start-up average: with the sample after it they start
//! again, offsets removed, and yaw starts again at zero.
//!
//! Deadline: a fraction of the sample period, 1 ms. There is no loop in it and no wait, and the
//! longest path is a few hundred instructions longer than the shortest.

use crate::attitude::{EulerAngles, Quaternion, Vector3};
use crate::calibration::{AtRest, Mount, Progress, StartupAverage, StartupScale};
use crate::estimator::kalman::{Kalman, Known};
use crate::estimator::{AnyFilter, ClassicAngles, Estimate, Estimator, Filter, FilterKind, Sample};
use crate::health::{
    self, DEGRADED_TILT_RAD, Flags, FreezeWatch, LOST_TILT_RAD, UNSEEN_RATE_RAD_S,
};
use crate::mpu6050::{Burst, Config, Part, RawSample};
use crate::units::{SECONDS_PER_MICROSECOND, STANDARD_GRAVITY_M_S2, radians};

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
    /// Which filter runs, unless [`Pipeline::with_filter`] names one. Default:
    /// [`FilterKind::Kalman`].
    pub filter: FilterKind,
    /// Samples at rest to average at start. Default: 1000. Zero removes no offsets at all. Only for
    /// the filters that do not look for offsets themselves.
    pub averaging_samples: u16,
    /// By how much a sample's content is older than its time, in µs. Default: `None`, the
    /// gyroscope's delay in the low-pass filter of `sensor`; the time is that of the data-ready edge.
    pub sensor_delay_us: Option<u32>,
    /// The gyroscope's offset from an earlier calibration. Default: `None`.
    pub stored_bias: Option<StoredBias>,
}

/// A gyroscope offset from an earlier calibration: where [`FilterKind::Kalman`] starts from.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct StoredBias {
    /// The offset, rad/s in body axes.
    pub bias_rad_s: Vector3,
    /// How far it may have wandered since: σ per axis, rad/s.
    pub sigma_rad_s: f32,
}

impl Settings {
    /// The defaults, for this part.
    pub const fn new(part: &'static Part) -> Self {
        Self {
            sensor: Config::DEFAULT,
            part,
            mount: Mount::Z_UP,
            filter: FilterKind::Kalman,
            averaging_samples: 1000,
            sensor_delay_us: None,
            stored_bias: None,
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
pub struct Pipeline<F = AnyFilter> {
    settings: Settings,
    m_s2_per_count: f32,
    rad_s_per_count: f32,
    startup: Option<StartupAverage>,
    /// Offsets in body axes.
    rate_offset_rad_s: Vector3,
    force_offset_m_s2: Vector3,
    estimator: Estimator<F>,
    was_still: bool,
    freeze_watch: FreezeWatch,
    sample: Sample,
    temperature_celsius: f32,
    /// A longer step than this between samples leaves some of the motion unseen, µs.
    longest_step_us: u32,
    /// The same, or zero if the next sample has to be looked at anyway.
    pause_us: u32,
    /// For how long the gyroscope has been reading full scale, µs.
    saturated_us: u32,
    /// The low half of the time at which the data were last seen to change, and how long they had been
    /// frozen when that was last taken into σ, µs.
    thawed_at_us: u32,
    frozen_us: u32,
    /// The low half of the last sample's time, µs.
    last_t_us: u32,
    temperature_limits: (i16, i16),
    /// The rate has jumped as if by a changed full scale, and nobody has read that back yet.
    is_suspect: bool,
    /// What the samples before have left to say of the next one, [`Flags::VALID`] included.
    standing: Flags,
    tilt_variance_rad2: f32,
    samples_to_stocktaking: u32,
}

impl Pipeline {
    /// A pipeline that waits for its first burst.
    pub fn new(settings: &Settings) -> Self {
        Self::with_filter(settings, AnyFilter::new(settings.filter))
    }
}

impl<F: Filter> Pipeline<F> {
    /// The same with this filter, whatever the settings say: no other is linked.
    pub fn with_filter(settings: &Settings, filter: F) -> Self {
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
        let averages = samples > 0 && filter.kalman().is_none();
        let delay_us = settings
            .sensor_delay_us
            .unwrap_or(settings.sensor.low_pass.gyroscope_delay_us().into());
        let mut estimator = Estimator::with_filter(filter).with_sensor_delay_us(delay_us);
        if let Some(stored) = settings.stored_bias {
            estimator = estimator.with_bias(stored.bias_rad_s, stored.sigma_rad_s);
        }
        Self {
            settings: *settings,
            m_s2_per_count: accelerometer_range.m_s2_per_count(),
            rad_s_per_count: gyroscope_range.rad_s_per_count(),
            startup: averages.then(|| StartupAverage::new(samples, scale)),
            rate_offset_rad_s: Vector3::ZERO,
            force_offset_m_s2: Vector3::ZERO,
            estimator,
            was_still: false,
            freeze_watch: FreezeWatch::new(settings.sensor.low_pass.gyroscope_bandwidth_hz()),
            sample: Sample::default(),
            temperature_celsius: 0.0,
            longest_step_us: (PERIODS_UNSEEN * 1.0e6 / settings.sensor.sample_rate_hz()) as u32,
            pause_us: u32::MAX,
            saturated_us: 0,
            thawed_at_us: 0,
            frozen_us: 0,
            last_t_us: 0,
            temperature_limits: health::temperature_limits(
                settings.part.temperature.celsius_per_count,
                settings.part.temperature.celsius_at_zero,
            ),
            is_suspect: false,
            standing: Flags::NONE,
            tilt_variance_rad2: f32::INFINITY,
            samples_to_stocktaking: 0,
        }
    }

    /// Takes one burst and gives the attitude at its time.
    pub fn update(&mut self, burst: &Burst) -> Snapshot {
        let snapshot = self.update_with(burst, Flags::NONE, |_, _| {});
        // Nobody can read the sensor's settings back here.
        self.confirm_scales();
        snapshot
    }

    /// The same with what the board has to say of the burst: [`Flags::BUS_FAULT`],
    /// [`Flags::SENSOR_RESET`], [`Flags::LATE`], [`Flags::POLLED`], [`Flags::INTERNAL_CLOCK`]. The
    /// snapshot goes to `publish` as soon as it is there, with the variance of its tilt (rad², both axes
    /// together); what is done afterwards is for the next one.
    #[inline]
    pub fn update_with(
        &mut self,
        burst: &Burst,
        board_flags: Flags,
        publish: impl FnOnce(&Snapshot, f32),
    ) -> Snapshot {
        let raw = RawSample::decode(&burst.bytes);
        self.sample = Sample {
            t_us: burst.captured_at_us,
            specific_force_m_s2: self.in_body(raw.accelerometer.0, self.m_s2_per_count)
                - self.force_offset_m_s2,
            angular_rate_rad_s: self.in_body(raw.gyroscope.0, self.rad_s_per_count)
                - self.rate_offset_rad_s,
            is_rate_saturated: raw.gyroscope.is_saturated(),
            is_force_saturated: raw.accelerometer.is_saturated(),
        };
        let t_us = burst.captured_at_us as u32;
        let is_pause = t_us.wrapping_sub(self.last_t_us) > self.pause_us;
        self.last_t_us = t_us;
        if is_pause
            || health::is_blank(&burst.bytes)
            || !board_flags.is_empty()
            || self.sample.is_rate_saturated
        {
            self.doubt(burst, board_flags);
        }
        let estimate = self.estimator.update(&self.sample);
        let startup_flags = self.average_at_rest(&raw);
        let remarks = estimate.remarks;
        let mut flags = (startup_flags | self.standing | board_flags)
            .with(Flags::MISSED, burst.missed_before > 0)
            .with(Flags::GYROSCOPE_SATURATED, self.sample.is_rate_saturated)
            .with(
                Flags::ACCELEROMETER_SATURATED,
                self.sample.is_force_saturated,
            );
        let is_odd = flags.intersects(Flags::ODD) | estimate.is_calibrating | estimate.has_jumped;
        if is_odd | remarks.any() | self.is_suspect {
            flags = self.judge(flags, &estimate);
        }
        let snapshot = Snapshot {
            t_us: burst.captured_at_us,
            attitude: estimate.attitude,
            body_rates_rad_s: estimate.body_rates_rad_s,
            flags,
        };
        publish(&snapshot, self.tilt_variance_rad2);
        match self.samples_to_stocktaking.checked_sub(1) {
            Some(left) => self.samples_to_stocktaking = left,
            None => self.take_stock(burst, &raw),
        }
        snapshot
    }

    /// The snapshot to publish at `t_us` when no sample has come: the last attitude, with
    /// [`Flags::STALE`]. [`tilt_variance_rad2`](Self::tilt_variance_rad2) says how its σ grows.
    pub fn stale(&self, t_us: u64, flags: Flags) -> Snapshot {
        Snapshot {
            t_us,
            attitude: self.estimator.attitude(),
            body_rates_rad_s: self.estimator.body_rates_rad_s(),
            flags: flags | Flags::STALE | Flags::DEGRADED,
        }
    }

    /// The variance of the tilt, both axes together, at `t_us`, rad²: the filter's, and what may have
    /// happened since the last sample. Infinite without an attitude, or with a filter that does not
    /// know it.
    pub fn tilt_variance_rad2(&self, t_us: u64) -> f32 {
        let known = self.known_tilt_variance();
        let age_us = t_us.saturating_sub(self.estimator.last_t_us().unwrap_or(0));
        if age_us <= u64::from(self.longest_step_us) {
            return known;
        }
        known + 2.0 * unseen_variance(age_us)
    }

    /// Goes on from what an earlier run knew. Before the first burst.
    pub fn resume(&mut self, known: &Known) {
        self.estimator.resume(known);
    }

    /// What a later run has to know to go on from here; `None` if there is nothing worth it.
    pub fn known(&self) -> Option<Known> {
        let filter = self.estimator.kalman()?;
        let sigma = filter.bias_sigma_rad_s();
        let is_worth_it = filter.is_bias_known() && self.standing.contains(Flags::VALID);
        is_worth_it.then(|| Known {
            attitude: filter.attitude(),
            tilt_sigma_rad: filter.tilt_sigma_rad(),
            bias_rad_s: filter.bias_rad_s(),
            bias_sigma_rad_s: sigma.x.max(sigma.y).max(sigma.z),
        })
    }

    /// Whether the rate has jumped as if the gyroscope's full scale had changed. It should then be read
    /// back at once; until [`confirm_scales`](Self::confirm_scales), nothing is valid.
    pub const fn is_suspect(&self) -> bool {
        self.is_suspect
    }

    /// The sensor's full scales have been read back since the last sample, and are what they should be.
    pub const fn confirm_scales(&mut self) {
        self.is_suspect = false;
    }

    /// Whether the last sample was one of those, some milliseconds apart, after which things are looked
    /// at that take time: others may do so, too.
    #[inline]
    pub const fn has_taken_stock(&self) -> bool {
        self.samples_to_stocktaking == SAMPLES_BETWEEN_STOCKTAKINGS - 1
    }

    /// What pauses, samples that are no measurements, and what the board says do to what is known.
    #[cold]
    #[inline(never)]
    fn doubt(&mut self, burst: &Burst, board_flags: Flags) {
        let last_t_us = self.estimator.last_t_us().unwrap_or(0);
        if health::is_blank(&burst.bytes) {
            // Not a number, so that the estimator rejects it; and what is rejected does not end a pause.
            self.sample.specific_force_m_s2.x = f32::NAN;
            self.last_t_us = last_t_us as u32;
            return;
        }
        let step_us = burst.captured_at_us.saturating_sub(last_t_us);
        let longest_step_us = u64::from(self.longest_step_us);
        self.pause_us = self.longest_step_us;
        let was_saturated_us = self.saturated_us;
        if self.sample.is_rate_saturated {
            self.pause_us = 0;
            self.saturated_us = was_saturated_us.saturating_add(step_us as u32);
        } else if was_saturated_us > 0 {
            self.saturated_us = 0;
            if was_saturated_us >= LONG_SATURATION_US {
                // Nobody knows how far it has turned: down is where the force says.
                self.estimator.forget_tilt();
                self.samples_to_stocktaking = 0;
                return;
            }
        }
        let filter = self.estimator.kalman_mut();
        let Some(filter) = filter.filter(|filter| filter.has_tilt()) else {
            return;
        };
        if step_us > longest_step_us {
            filter.doubt_tilt(unseen_variance(step_us));
        }
        if self.sample.is_rate_saturated {
            let total = |saturated_us: u32| {
                let turn_rad = HIDDEN_RATE_RAD_S * SECONDS_PER_MICROSECOND * saturated_us as f32;
                turn_rad * turn_rad
            };
            filter.doubt_tilt(total(self.saturated_us) - total(was_saturated_us));
        }
        if board_flags.contains(Flags::SENSOR_RESET) {
            filter.doubt_motion(WRONG_SETTINGS_TILT_RAD * WRONG_SETTINGS_TILT_RAD);
        }
        self.take_stock_of_variance();
        // The snapshot after this one knows for good.
        self.samples_to_stocktaking = 0;
    }

    /// While data are frozen, the motion goes unseen as in a pause.
    #[cold]
    #[inline(never)]
    fn doubt_frozen(&mut self, t_us: u32) {
        let before_us = self.frozen_us;
        self.frozen_us = t_us.wrapping_sub(self.thawed_at_us);
        if let Some(filter) = self.estimator.kalman_mut() {
            let variance = |us: u32| unseen_variance(us.into());
            filter.doubt_tilt((variance(self.frozen_us) - variance(before_us)).max(0.0));
        }
    }

    /// Decides what to say of a sample with something to remark, and whether its attitude is valid.
    #[cold]
    #[inline(never)]
    fn judge(&mut self, flags: Flags, estimate: &Estimate) -> Flags {
        let is_still = self.estimator.kalman().is_some_and(Kalman::is_still);
        let has_moved = estimate.is_calibrating && self.was_still && !is_still;
        self.was_still = is_still;
        let remarks = estimate.remarks;
        let flags = flags
            .with(Flags::CALIBRATING, estimate.is_calibrating)
            .with(Flags::MOVED, has_moved)
            .with(Flags::GAP, remarks.gap)
            .with(Flags::TIME, remarks.time_went_back)
            .with(Flags::REJECTED, remarks.rejected)
            .with(Flags::FREE_FALL, remarks.no_gravity);
        self.is_suspect |= estimate.has_jumped;
        let flags = flags.with(Flags::DEGRADED, flags.intersects(Flags::DEGRADES));
        if !self.is_suspect && !flags.intersects(Flags::SPOILS) {
            flags
        } else {
            flags.without(Flags::VALID)
        }
    }

    /// What a sample leaves to say of the next ones. Nobody waits for this.
    #[inline(never)]
    fn take_stock(&mut self, burst: &Burst, raw: &RawSample) {
        self.temperature_celsius = raw.temperature.to_celsius(self.settings.part);
        self.samples_to_stocktaking = SAMPLES_BETWEEN_STOCKTAKINGS - 1;
        let (coldest, hottest) = self.temperature_limits;
        let is_frozen = self.freeze_watch.update(&burst.bytes);
        self.pause_us = self.pause_us.min(self.longest_step_us);
        if is_frozen {
            self.doubt_frozen(burst.captured_at_us as u32);
        } else {
            self.thawed_at_us = burst.captured_at_us as u32;
            self.frozen_us = 0;
        }
        let is_extreme = raw.temperature.0 < coldest || raw.temperature.0 > hottest;
        self.standing = Flags::NONE
            .with(Flags::TEMPERATURE, is_extreme)
            .with(Flags::FROZEN, is_frozen);
        self.take_stock_of_variance();
    }

    fn take_stock_of_variance(&mut self) {
        let variance = self.known_tilt_variance();
        self.tilt_variance_rad2 = variance;
        let is_known = variance < LOST_TILT_RAD * LOST_TILT_RAD;
        let is_large =
            variance > DEGRADED_TILT_RAD * DEGRADED_TILT_RAD && self.estimator.kalman().is_some();
        self.standing = self
            .standing
            .without(Flags::VALID | Flags::DEGRADED)
            .with(Flags::VALID, is_known)
            .with(Flags::DEGRADED, is_large);
    }

    #[inline]
    fn known_tilt_variance(&self) -> f32 {
        match self.estimator.kalman() {
            Some(filter) if filter.has_tilt() => filter.tilt_variance_rad2(),
            _ => f32::INFINITY,
        }
    }

    /// Armed (`true`), the filter does nothing that is only safe on the ground. Default: false.
    pub fn set_armed(&mut self, is_armed: bool) {
        self.estimator.set_armed(is_armed);
    }

    /// The filter: with [`Estimator::kalman`], biases and how sure it is.
    pub const fn estimator(&self) -> &Estimator<F> {
        &self.estimator
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

    /// The gyroscope's offset in body axes, as far as it is known: zero until the average is complete,
    /// or what [`FilterKind::Kalman`] makes of it so far.
    pub fn rate_offset_rad_s(&self) -> Vector3 {
        match self.estimator.kalman() {
            Some(filter) => filter.bias_rad_s(),
            None => self.rate_offset_rad_s,
        }
    }

    /// The numbers of the classic tutorial; `None` unless [`FilterKind::Classic`] runs.
    pub fn classic_angles(&self) -> Option<ClassicAngles> {
        self.estimator.classic_angles()
    }

    fn average_at_rest(&mut self, raw: &RawSample) -> Flags {
        // Known when compiled for one filter, so that the average is not linked in vain.
        if self.estimator.kalman().is_some() {
            return Flags::NONE;
        }
        let Some(startup) = &mut self.startup else {
            return Flags::NONE;
        };
        let progress = startup.update(
            raw.gyroscope.0,
            raw.accelerometer.0,
            raw.temperature.to_celsius(self.settings.part),
        );
        match progress {
            Progress::Averaging => Flags::CALIBRATING,
            Progress::Moved => Flags::CALIBRATING | Flags::MOVED,
            Progress::Done(at_rest) => {
                self.startup = None;
                self.calibrate(&at_rest);
                Flags::CALIBRATING
            }
        }
    }

    fn calibrate(&mut self, at_rest: &AtRest) {
        let mount = self.settings.mount;
        self.rate_offset_rad_s = mount
            .to_body(at_rest.gyroscope_counts)
            .scale(self.rad_s_per_count);
        if self.estimator.classic_angles().is_some() {
            // The tutorial takes the table for level: whatever is not one g upwards is offset.
            let gravity = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
            self.force_offset_m_s2 = mount
                .to_body(at_rest.accelerometer_counts)
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

/// More sample periods than this without a sample are a pause in which the motion went unseen.
const PERIODS_UNSEEN: f32 = 3.5;

/// So many samples apart is looked at what changes slowly or takes time to tell: 11 ms, so that nothing
/// that repeats itself every few samples looks frozen.
const SAMPLES_BETWEEN_STOCKTAKINGS: u32 = 11;

/// σ per axis of the tilt that a changed full scale can have done before it was noticed.
const WRONG_SETTINGS_TILT_RAD: f32 = radians(5.0);

/// A gyroscope that reads full scale may be wrong by so much, one σ per axis, in rad/s: six of them are
/// more than the whole scale.
const HIDDEN_RATE_RAD_S: f32 = radians(400.0);

/// After reading full scale for so long, the gyroscope has lost the tilt: 20° of it.
const LONG_SATURATION_US: u32 = 10_000;

/// Variance per axis of a turn that no sample shows, rad².
fn unseen_variance(duration_us: u64) -> f32 {
    let duration_s = duration_us.min(LONGEST_UNSEEN_US) as u32 as f32 * SECONDS_PER_MICROSECOND;
    let turn_rad = UNSEEN_RATE_RAD_S * duration_s;
    turn_rad * turn_rad
}

/// After a minute nothing is known at all.
const LONGEST_UNSEEN_US: u64 = 60_000_000;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mpu6050::{AccelerometerCounts, GyroscopeCounts, TemperatureCounts};
    use crate::units::radians;

    /// A burst of body-axis values (m/s², °/s) as a sensor in this mount delivers it at ±16 g and
    /// ±2000 °/s.
    fn burst(mount: Mount, t_us: u64, force_m_s2: Vector3, rate_degrees_s: Vector3) -> Burst {
        let counts = |body: Vector3, counts_per_unit: f32| {
            let sensor = mount.to_sensor(body).scale(counts_per_unit);
            [sensor.x, sensor.y, sensor.z].map(|value| value.round() as i16)
        };
        let sample = RawSample {
            accelerometer: AccelerometerCounts(counts(force_m_s2, 2048.0 / STANDARD_GRAVITY_M_S2)),
            temperature: TemperatureCounts(-3920),
            gyroscope: GyroscopeCounts(counts(rate_degrees_s, 16.4)),
        };
        Burst {
            bytes: sample.encode(),
            captured_at_us: t_us,
            missed_before: 0,
        }
    }

    fn force(roll_degrees: f32, pitch_degrees: f32) -> Vector3 {
        let attitude = Quaternion::from_euler(EulerAngles {
            roll_rad: radians(roll_degrees),
            pitch_rad: radians(pitch_degrees),
            yaw_rad: 0.0,
        });
        -attitude.down_in_body().scale(STANDARD_GRAVITY_M_S2)
    }

    const LEVEL: Vector3 = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);

    fn settings() -> Settings {
        Settings::new(&Part::MPU_6050)
    }

    /// Settings of a filter that waits for the average.
    fn averaging() -> Settings {
        Settings {
            filter: FilterKind::AxisKalman,
            ..settings()
        }
    }

    fn without_averaging() -> Settings {
        Settings {
            averaging_samples: 0,
            ..averaging()
        }
    }

    #[test]
    fn the_defaults_are_the_documented_ones() {
        let settings = settings();
        assert_eq!(settings.sensor, Config::default());
        assert_eq!(settings.mount, Mount::default());
        assert_eq!(settings.filter, FilterKind::default());
        assert_eq!(settings.averaging_samples, 1000);
    }

    #[test]
    fn the_average_ends_with_the_thousandth_sample_and_removes_the_offset() {
        let mut pipeline = Pipeline::new(&averaging());
        let offset = Vector3::new(5.0, -3.0, 10.0);
        let mut last = Snapshot::default();
        for index in 0..2000_u64 {
            let t_us = 7_000 + index * 1000;
            last = pipeline.update(&burst(Mount::Z_UP, t_us, LEVEL, offset));
            assert_eq!(last.t_us, t_us);
            let calibrating = index < 1000;
            assert_eq!(
                last.flags.contains(Flags::CALIBRATING),
                calibrating,
                "{index}"
            );
            let rate = last.body_rates_rad_s.z.to_degrees();
            let expected = if calibrating { 10.0 } else { 0.0 };
            assert!((rate - expected).abs() < 1e-4, "{index}: {rate}");
            if index == 1000 {
                assert_eq!(last.euler().yaw_rad, 0.0);
            }
        }
        let angles = last.euler();
        assert!(angles.yaw_rad.abs() < 1e-5, "{angles:?}");
        assert!(angles.roll_rad.abs() < 1e-5 && angles.pitch_rad.abs() < 1e-5);
        let removed = pipeline.rate_offset_rad_s().scale(16.4_f32.to_degrees());
        assert!((removed - Vector3::new(82.0, -49.0, 164.0)).norm() < 1e-3);
        assert!((pipeline.temperature_celsius() - 25.0).abs() < 0.01);
        assert!((pipeline.sample().specific_force_m_s2 - LEVEL).norm() < 1e-5);
    }

    #[test]
    fn the_default_filter_finds_the_offset_without_an_average() {
        let mut pipeline = Pipeline::new(&settings());
        let offset = Vector3::new(5.0, -3.0, 10.0);
        let mut last = Snapshot::default();
        let mut known = None;
        for index in 0..4000_u64 {
            // One count of noise, as the last digit of a sensor has it.
            let noise = Vector3::new(0.06, -0.06, 0.06).scale((index % 2) as f32);
            let burst = burst(Mount::Z_UP, index * 1000, LEVEL, offset + noise);
            last = pipeline.update(&burst);
            if !last.flags.contains(Flags::CALIBRATING) {
                known.get_or_insert(index);
            }
        }
        let known = known.expect("an offset");
        assert!((800..2500).contains(&known), "{known} ms");
        assert_eq!(last.flags, Flags::VALID);
        assert!(last.body_rates_rad_s.norm().to_degrees() < 0.2);
        let found = pipeline.rate_offset_rad_s().scale(1_f32.to_degrees());
        assert!((found - offset).norm() < 0.2, "{found:?}");
        let angles = last.euler();
        assert!(angles.roll_rad.abs() < 0.01 && angles.pitch_rad.abs() < 0.01);

        let stored = StoredBias {
            bias_rad_s: pipeline.rate_offset_rad_s(),
            sigma_rad_s: radians(0.1),
        };
        let mut pipeline = Pipeline::new(&Settings {
            stored_bias: Some(stored),
            ..settings()
        });
        let snapshot = pipeline.update(&burst(Mount::Z_UP, 0, LEVEL, offset));
        assert!(snapshot.body_rates_rad_s.norm().to_degrees() < 0.2);
    }

    #[test]
    fn the_delay_of_the_low_pass_filter_is_made_up_for() {
        let yaw_after = |low_pass, sensor_delay_us| {
            let mut settings = Settings {
                sensor_delay_us,
                ..settings()
            };
            settings.sensor.low_pass = low_pass;
            let mut pipeline = Pipeline::new(&settings);
            let mut last = Snapshot::default();
            for index in 0..10_u64 {
                let turn = Vector3::new(0.0, 0.0, 1000.0);
                last = pipeline.update(&burst(Mount::Z_UP, index * 1000, LEVEL, turn));
            }
            last.euler().yaw_rad.to_degrees()
        };
        // 9 ms at 1000 °/s, and 4.8 ms more; or what the settings say.
        let delayed = yaw_after(crate::mpu6050::LowPass::Hertz42, None);
        assert!((delayed - 13.8).abs() < 0.05, "{delayed}");
        let told = yaw_after(crate::mpu6050::LowPass::Hertz42, Some(1_000));
        assert!((told - 10.0).abs() < 0.05, "{told}");
    }

    #[test]
    fn motion_restarts_the_average_and_says_so_once() {
        let mut pipeline = Pipeline::new(&averaging());
        let mut moved = Vec::new();
        let mut done = None;
        for index in 0..2000_u64 {
            let rate = if index == 520 { 50.0 } else { 0.0 };
            let rate = Vector3::new(0.0, rate, 0.0);
            let flags = pipeline
                .update(&burst(Mount::Z_UP, index * 1000, LEVEL, rate))
                .flags;
            if flags.contains(Flags::MOVED) {
                assert!(flags.contains(Flags::CALIBRATING));
                moved.push(index);
            }
            if !flags.contains(Flags::CALIBRATING) {
                done.get_or_insert(index);
            }
        }
        assert_eq!(moved, [599]);
        assert_eq!(done, Some(1600));
    }

    #[test]
    fn every_mount_tells_the_same_story() {
        let mut stories = Mount::ALL.map(|mount| {
            let mut pipeline = Pipeline::new(&Settings {
                mount,
                ..without_averaging()
            });
            let mut story = Vec::new();
            for index in 0..200_u64 {
                let rate = Vector3::new(30.0, -20.0, 50.0);
                let force = force(0.03 * index as f32, -0.02 * index as f32);
                story.push(pipeline.update(&burst(mount, index * 1000, force, rate)));
            }
            story
        });
        let [first, others @ ..] = &mut stories;
        assert!(
            first
                .iter()
                .any(|snapshot| snapshot.euler().roll_rad > 0.05)
        );
        for other in others {
            assert_eq!(first, other);
        }
    }

    #[test]
    fn signs_reach_the_snapshot() {
        let mut pipeline = Pipeline::new(&without_averaging());
        let rates = Vector3::new(1.0, -2.0, 3.0);
        let snapshot = pipeline.update(&burst(Mount::Z_UP, 0, force(30.0, 10.0), rates));
        let angles = snapshot.euler();
        assert!((angles.roll_rad.to_degrees() - 30.0).abs() < 0.05);
        assert!((angles.pitch_rad.to_degrees() - 10.0).abs() < 0.05);
        let rates = snapshot.body_rates_rad_s;
        assert!((rates.x.to_degrees() - 1.0).abs() < 0.05);
        assert!((rates.y.to_degrees() + 2.0).abs() < 0.05);
        assert!((rates.z.to_degrees() - 3.0).abs() < 0.05);
    }

    #[test]
    fn only_the_classic_filter_takes_the_table_for_level() {
        for (filter, expected) in [(FilterKind::Classic, 0.0), (FilterKind::AxisKalman, 4.0)] {
            for mount in [Mount::Z_UP, Mount::Z_DOWN] {
                let mut pipeline = Pipeline::new(&Settings {
                    filter,
                    mount,
                    ..settings()
                });
                let mut last = Snapshot::default();
                for index in 0..1500_u64 {
                    let table = force(4.0, -3.0);
                    last = pipeline.update(&burst(mount, index * 1000, table, Vector3::ZERO));
                }
                assert_eq!(
                    last.flags,
                    Flags::FROZEN | Flags::DEGRADED,
                    "a noiseless sensor"
                );
                let roll = last.euler().roll_rad.to_degrees();
                assert!((roll - expected).abs() < 0.05, "{filter:?} {mount}: {roll}");
                assert_eq!(
                    pipeline.classic_angles().is_some(),
                    filter == FilterKind::Classic
                );
            }
        }
    }

    #[test]
    fn the_classic_chip_face_down_at_2_g_reads_its_tutorial_counts() {
        // Level, face down, ±2 g and ±250 °/s: z reads −16384 and some offset, which is removed.
        let mut settings = Settings {
            mount: Mount::Z_DOWN,
            filter: FilterKind::Classic,
            averaging_samples: 10,
            ..settings()
        };
        settings.sensor.accelerometer_range = crate::mpu6050::AccelerometerRange::G2;
        settings.sensor.gyroscope_range = crate::mpu6050::GyroscopeRange::Degrees250;
        let mut pipeline = Pipeline::new(&settings);
        let mut update = |t_us, accelerometer, gyroscope| {
            let sample = RawSample {
                accelerometer: AccelerometerCounts(accelerometer),
                temperature: TemperatureCounts(0),
                gyroscope: GyroscopeCounts(gyroscope),
            };
            let snapshot = pipeline.update(&Burst {
                bytes: sample.encode(),
                captured_at_us: t_us,
                missed_before: 0,
            });
            (snapshot, *pipeline.sample(), pipeline.classic_angles())
        };
        for index in 0..10 {
            update(index * 1000, [300, -200, -16000], [-158, 40, 0]);
        }
        // One degree per second about x; 30° of roll.
        let accelerometer = [300, -200 - 8192, -16000 + 16384 - 14189];
        let (_, sample, _) = update(10_000, accelerometer, [-158 + 131, 40, 0]);
        let force_g = sample
            .specific_force_m_s2
            .scale(1.0 / STANDARD_GRAVITY_M_S2);
        assert!(
            (force_g - Vector3::new(0.0, -0.5, -0.866_03)).norm() < 1e-4,
            "{force_g:?}"
        );
        assert!((sample.angular_rate_rad_s.x.to_degrees() - 1.0).abs() < 1e-4);
        for index in 11..10_000 {
            update(index * 1000, accelerometer, [-158, 40, 0]);
        }
        let (snapshot, _, angles) = update(10_000_000, accelerometer, [-158, 40, 0]);
        let angles = angles.expect("classic");
        assert!((angles.roll_deg - 30.0).abs() < 0.01, "{angles:?}");
        assert!(angles.pitch_deg.abs() < 0.03, "{angles:?}");
        assert!((snapshot.euler().roll_rad.to_degrees() - 30.0).abs() < 0.01);
    }

    #[test]
    fn faults_are_flagged_on_their_sample_and_nowhere_else() {
        let mut pipeline = Pipeline::new(&without_averaging());
        let mut t_us = 0;
        let mut update = |force, rate, step_us: i64, missed| {
            t_us += step_us;
            let mut burst = burst(Mount::Z_UP, t_us as u64, force, rate);
            burst.missed_before = missed;
            pipeline.update(&burst).flags
        };
        let still = Vector3::ZERO;
        let fast = Vector3::new(0.0, 0.0, 3000.0);
        let hard = Vector3::new(0.0, 0.0, 300.0);
        assert_eq!(update(LEVEL, still, 1000, 0), Flags::NONE);
        assert_eq!(update(LEVEL, still, 1000, 3), Flags::MISSED);
        assert_eq!(
            update(LEVEL, fast, 1000, 0),
            Flags::GYROSCOPE_SATURATED | Flags::DEGRADED
        );
        assert_eq!(update(LEVEL, still, 1000, 0), Flags::NONE);
        assert_eq!(update(hard, still, 1000, 0), Flags::ACCELEROMETER_SATURATED);
        assert_eq!(update(still, still, 1000, 0), Flags::FREE_FALL);
        assert_eq!(update(LEVEL, still, 500_000, 0), Flags::NONE);
        assert_eq!(update(LEVEL, still, 500_001, 0), Flags::GAP);
        let back = Flags::TIME | Flags::DEGRADED;
        assert_eq!(update(LEVEL, still, -5, 0), back);
        assert_eq!(update(LEVEL, still, 0, 255), back | Flags::MISSED);
        assert_eq!(update(LEVEL, still, 1000, 0), Flags::NONE);
    }

    /// A pipeline that has been at rest for three seconds, with a count of noise, and the time.
    fn settled() -> (Pipeline, u64) {
        let mut pipeline = Pipeline::new(&settings());
        for index in 0..3000 {
            let burst = noisy(index * 1000, LEVEL);
            let flags = pipeline.update(&burst).flags;
            assert!(!flags.contains(Flags::VALID | Flags::CALIBRATING));
        }
        let flags = pipeline.update(&noisy(3_000_000, LEVEL)).flags;
        assert_eq!(flags, Flags::VALID);
        (pipeline, 3_000_000)
    }

    /// At rest about every axis, never the same twice running.
    fn noisy(t_us: u64, force_m_s2: Vector3) -> Burst {
        let noise = 0.06 * (t_us / 1000 % 2) as f32;
        burst(Mount::Z_UP, t_us, force_m_s2, Vector3::new(noise, 0.0, 0.0))
    }

    #[test]
    fn what_is_no_measurement_is_not_valid_and_changes_nothing() {
        for byte in [0x00, 0xFF] {
            let (mut pipeline, t_us) = settled();
            let attitude = pipeline.estimator().attitude();
            for step in 1..=300 {
                let snapshot = pipeline.update(&Burst {
                    bytes: [byte; 14],
                    captured_at_us: t_us + step * 1000,
                    missed_before: 0,
                });
                assert!(snapshot.flags.contains(Flags::REJECTED | Flags::DEGRADED));
                assert!(!snapshot.flags.contains(Flags::VALID));
                assert_eq!(snapshot.attitude, attitude);
            }
            // The first good sample may still carry that the data had been frozen.
            for step in 301..312 {
                pipeline.update(&noisy(t_us + step * 1000, LEVEL));
            }
            let after = pipeline.update(&noisy(t_us + 312_000, LEVEL));
            assert!(after.flags.contains(Flags::VALID), "{}", after.flags);
        }
    }

    #[test]
    fn sigma_grows_while_samples_are_missing_and_is_kept_by_the_next_one() {
        let (mut pipeline, t_us) = settled();
        let before = pipeline.tilt_variance_rad2(t_us);
        assert_eq!(pipeline.tilt_variance_rad2(t_us + 3_000), before);
        let mut last = before;
        for age_ms in [5, 20, 100, 300] {
            let variance = pipeline.tilt_variance_rad2(t_us + age_ms * 1000);
            assert!(variance > last, "{age_ms} ms");
            last = variance;
        }
        // 30 °/s per axis for 0.3 s.
        let sigma_deg = libm::sqrtf(last - before).to_degrees();
        assert!((sigma_deg - 12.73).abs() < 0.01, "{sigma_deg}");
        let stale = pipeline.stale(t_us + 300_000, Flags::BUS_FAULT);
        let said = Flags::STALE | Flags::DEGRADED | Flags::BUS_FAULT;
        assert_eq!((stale.t_us, stale.flags), (t_us + 300_000, said));

        let flags = pipeline.update(&noisy(t_us + 300_000, LEVEL)).flags;
        assert!(flags.contains(Flags::VALID), "{flags}");
        let kept = pipeline.tilt_variance_rad2(t_us + 300_000);
        assert!((kept / last - 1.0).abs() < 1e-3, "{kept} {last}");
        let flags = pipeline.update(&noisy(t_us + 301_000, LEVEL)).flags;
        assert_eq!(flags, Flags::VALID | Flags::DEGRADED);
    }

    #[test]
    fn a_gyroscope_stuck_at_full_scale_is_not_believed() {
        for milliseconds in [1, 5, 9, 11, 50, 400] {
            let (mut pipeline, t_us) = settled();
            for step in 1..=milliseconds {
                let mut raw = RawSample::decode(&noisy(t_us + step * 1000, LEVEL).bytes);
                raw.gyroscope = GyroscopeCounts([i16::MAX, 0, 0]);
                let snapshot = pipeline.update(&Burst {
                    bytes: raw.encode(),
                    captured_at_us: t_us + step * 1000,
                    missed_before: 0,
                });
                assert!(!snapshot.flags.contains(Flags::VALID));
            }
            for step in milliseconds + 1..milliseconds + 300 {
                let snapshot = pipeline.update(&noisy(t_us + step * 1000, LEVEL));
                let error = libm::acosf(snapshot.attitude.down_in_body().z.min(1.0));
                let sigma = libm::sqrtf(pipeline.tilt_variance_rad2(snapshot.t_us));
                let allowed = (6.0 * sigma).max(radians(5.0));
                let is_valid = snapshot.flags.contains(Flags::VALID);
                assert!(error < allowed || !is_valid, "{step}: {error} {sigma}");
                assert!(is_valid || step < milliseconds + 10, "{step}");
            }
        }
    }

    #[test]
    fn while_data_are_frozen_sigma_grows() {
        let (mut pipeline, t_us) = settled();
        let frozen = burst(Mount::Z_UP, 0, LEVEL, Vector3::new(100.0, 0.0, 0.0));
        for step in 1..=300 {
            let burst = Burst {
                captured_at_us: t_us + step * 1000,
                ..frozen
            };
            let flags = pipeline.update(&burst).flags;
            let is_frozen = flags.contains(Flags::FROZEN);
            assert!(
                is_frozen == (step > 36) || (20..=36).contains(&step),
                "{step}"
            );
            assert!(!flags.contains(Flags::VALID | Flags::FROZEN));
        }
        // The filter has turned on at 100 °/s.
        for step in 301..=320 {
            let snapshot = pipeline.update(&noisy(t_us + step * 1000, LEVEL));
            let turned = libm::acosf(snapshot.attitude.down_in_body().z.min(1.0));
            let sigma = libm::sqrtf(pipeline.tilt_variance_rad2(snapshot.t_us));
            assert!(turned > radians(20.0) && turned < 6.0 * sigma, "{sigma}");
            assert!(snapshot.flags.contains(Flags::VALID) || step < 315);
        }
    }

    #[test]
    fn a_temperature_that_the_part_is_not_made_for_is_not_valid() {
        for (counts, is_good) in [(-26_000, true), (-26_100, false), (16_500, false)] {
            let (mut pipeline, t_us) = settled();
            let mut flags = Flags::NONE;
            for step in 1..=13 {
                let mut raw = RawSample::decode(&noisy(t_us + step * 1000, LEVEL).bytes);
                raw.temperature = TemperatureCounts(counts);
                flags = pipeline
                    .update(&Burst {
                        bytes: raw.encode(),
                        captured_at_us: t_us + step * 1000,
                        missed_before: 0,
                    })
                    .flags;
            }
            assert_eq!(flags.contains(Flags::VALID), is_good, "{counts}");
            assert_eq!(flags.contains(Flags::TEMPERATURE), !is_good, "{counts}");
        }
    }

    #[test]
    fn rates_that_a_changed_full_scale_would_show_are_valid_once_it_is_read_back() {
        for (before, after, is_jump) in [
            (10.0, 80.0, true),    // ±2000 °/s become ±250 °/s.
            (-10.0, -40.0, false), // ±2000 °/s become ±500 °/s: 30 °/s too much for 40 ms are 1.2°.
            (-20.0, -80.0, true),
            (200.0, 220.0, false),
            (0.0, 49.0, false),
        ] {
            let (mut pipeline, mut t_us) = settled();
            let mut turn = |pipeline: &mut Pipeline, rate| {
                t_us += 1000;
                let rates = Vector3::new(0.0, 0.0, rate + 0.1 * (t_us / 1000 % 2) as f32);
                let burst = burst(Mount::Z_UP, t_us, LEVEL, rates);
                let snapshot = pipeline.update_with(&burst, Flags::NONE, |_, _| {});
                snapshot.flags.contains(Flags::VALID)
            };
            for part in 1..=20 {
                assert!(turn(&mut pipeline, before * 0.05 * part as f32));
            }
            for _ in 0..3 {
                assert_eq!(turn(&mut pipeline, after), !is_jump, "{before} {after}");
                assert_eq!(pipeline.is_suspect(), is_jump);
            }
            pipeline.confirm_scales();
            assert!(turn(&mut pipeline, after), "{before} {after}");
        }
    }

    #[test]
    fn lost_settings_cost_certainty_and_not_the_attitude() {
        let (mut pipeline, t_us) = settled();
        let burst = noisy(t_us + 50_000, LEVEL);
        let mut published = None;
        let snapshot = pipeline.update_with(&burst, Flags::SENSOR_RESET, |snapshot, variance| {
            published = Some((*snapshot, variance));
        });
        let variance = pipeline.tilt_variance_rad2(t_us + 50_000);
        assert_eq!(published, Some((snapshot, variance)));
        let said = Flags::VALID | Flags::DEGRADED | Flags::SENSOR_RESET;
        assert_eq!(snapshot.flags, said);
        let sigma = libm::sqrtf(variance).to_degrees();
        assert!((7.0..8.0).contains(&sigma), "{sigma}");
    }

    #[test]
    fn what_an_earlier_run_knew_is_gone_on_from() {
        let (pipeline, _) = settled();
        let mut known = pipeline.known().expect("it is settled");
        known.attitude = Quaternion::from_euler(EulerAngles {
            roll_rad: 0.1,
            pitch_rad: -0.2,
            yaw_rad: 0.3,
        });
        known.tilt_sigma_rad = 0.1;
        let mut pipeline = Pipeline::new(&settings());
        assert_eq!(pipeline.known(), None);
        pipeline.resume(&known);
        let first = pipeline.update(&noisy(5_000, LEVEL));
        assert_eq!(first.flags & Flags::CALIBRATING, Flags::NONE);
        let angles = first.euler();
        assert!((angles.roll_rad - 0.1).abs() < 0.01 && (angles.yaw_rad - 0.3).abs() < 0.01);
        let second = pipeline.update(&noisy(6_000, LEVEL));
        assert!(second.flags.contains(Flags::VALID), "{}", second.flags);
        assert!(pipeline.rate_offset_rad_s() == known.bias_rad_s);
    }

    #[test]
    fn a_sensor_that_repeats_itself_is_frozen() {
        let mut pipeline = Pipeline::new(&without_averaging());
        for index in 0..200_u64 {
            let flags = pipeline
                .update(&burst(Mount::Z_UP, index * 1000, LEVEL, Vector3::ZERO))
                .flags;
            // Every eleventh is compared with the one before, and the sample after it tells.
            assert_eq!(flags.contains(Flags::FROZEN), index > 22, "{index}");
        }
    }

    #[test]
    fn a_sensor_that_returns_zeros_never_calibrates() {
        let mut pipeline = Pipeline::new(&averaging());
        for index in 0..5000_u64 {
            let flags = pipeline
                .update(&Burst {
                    bytes: [0; 14],
                    captured_at_us: index * 1000,
                    missed_before: 0,
                })
                .flags;
            assert!(flags.contains(Flags::CALIBRATING | Flags::REJECTED));
        }
    }
}
