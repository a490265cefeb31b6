//! One burst in, one snapshot out: the only file that knows the order of the steps.
//!
//! decode → calibrate and align (one affine map for each sensor, from counts to the body's axes) → estimate → health.
//!
//! There is a snapshot for every burst, from the first one on; it carries [`Flags::CALIBRATING`] until
//! the gyroscope's offset is known. [`FilterKind::Kalman`] looks for it by itself, at rest and in motion,
//! while it runs, and is sure of it after a second of rest. The other filters wait for the start-up average: with the sample after it they start
//! again, offsets removed, and yaw starts again at zero.
//!
//! After a snapshot is published, [`Pipeline::collect`] does what has time: it collects rest for a calibration and
//! follows the temperature.
//!
//! Deadline: a fraction of the sample period, 1 ms. There is no loop in it and no wait, and the
//! longest path is a few hundred instructions longer than the shortest.

use crate::attitude::{EulerAngles, Quaternion, Vector3};
use crate::calibration::{
    AccelerometerCorrection, AtRest, Calibration, Mount, RestProgress, RestScale, RestWatch,
};
use crate::estimator::kalman::{Kalman, Known};
use crate::estimator::{
    AnyFilter, ClassicAngles, EVERYDAY_STEP_US, Estimator, Everyday, Filter, FilterKind, Look,
    Sample,
};
use crate::health::{
    self, DEGRADED_TILT_RAD, Flags, FreezeWatch, LOST_TILT_RAD, UNSEEN_RATE_RAD_S,
};
use crate::mpu6050::{BURST_LENGTH, Burst, Config, Part, RawSample, TemperatureCounts};
use crate::state::Exchange;
use crate::units::{SECONDS_PER_MICROSECOND, STANDARD_GRAVITY_M_S2, radians};

/// σ of a stored gyroscope offset at the temperature where it was measured, rad/s: it is not the same from one
/// power-up to the next, nor in every pose (0.1 °/s per g, product specification §6.1).
const STORED_OFFSET_SIGMA_RAD_S: f32 = radians(0.1);
/// And what a °C of difference adds, rad/s: ±20 °/s over −40 to 85 °C (ibidem) is 0.16 at most.
const STORED_OFFSET_SIGMA_PER_CELSIUS: f32 = radians(0.1);
/// No offset is known so badly that the filter's own prior is better.
const LARGEST_STORED_SIGMA_RAD_S: f32 = radians(3.0);
/// σ of the temperature model within its range, rad/s.
const MODEL_SIGMA_RAD_S: f32 = radians(0.15);
/// Samples between two looks at the temperature.
const TEMPERATURE_SAMPLES: u8 = 64;

/// What the pipeline has to know beforehand.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Settings {
    /// How the sensor is configured: its full scales give the bytes their meaning.
    pub sensor: Config,
    /// Which part it is: its temperature scale.
    pub part: &'static Part,
    /// How it is mounted, unless `calibration` knows better. Default: face up, X forward.
    pub mount: Mount,
    /// What is known about the sensor. Default: nothing.
    pub calibration: Calibration,
    /// Which filter runs, unless [`Pipeline::with_filter`] names one. Default:
    /// [`FilterKind::Kalman`].
    pub filter: FilterKind,
    /// Samples at rest to average at start. Default: 1000. Zero removes no offsets at all. Only for
    /// the filters that do not look for offsets themselves.
    pub averaging_samples: u16,
    /// By how much a sample's content is older than its time, in µs. Default: `None`, the
    /// gyroscope's delay in the low-pass filter of `sensor`; the time is that of the data-ready edge.
    pub sensor_delay_us: Option<u32>,
}

impl Settings {
    /// The defaults, for this part.
    pub const fn new(part: &'static Part) -> Self {
        Self {
            sensor: Config::DEFAULT,
            part,
            mount: Mount::Z_UP,
            calibration: Calibration::NONE,
            filter: FilterKind::Kalman,
            averaging_samples: 1000,
            sensor_delay_us: None,
        }
    }

    /// Is shown to `state`, or set by it.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        self.sensor.exchange(state);
        let mut who_am_i = self.part.who_am_i;
        state.byte(&mut who_am_i);
        match Part::from_who_am_i(who_am_i) {
            Some(part) => self.part = part,
            None => state.refuse(),
        }
        self.mount.exchange(state);
        self.calibration.exchange(state);
        self.filter.exchange(state);
        state.short(&mut self.averaging_samples);
        state.optional(&mut self.sensor_delay_us, 0, |state, delay_us| {
            state.word(delay_us);
        });
    }

    /// The mount that holds: the calibration's, or else the one that is set.
    pub fn mount(&self) -> Mount {
        self.calibration.mount.unwrap_or(self.mount)
    }

    /// What a count is worth, and what noise to expect behind the low-pass filter.
    pub fn rest_scale(&self) -> RestScale {
        let sensor = &self.sensor;
        RestScale::new(
            [
                sensor.gyroscope_range.counts_per_degree_s(),
                sensor.accelerometer_range.counts_per_g(),
            ],
            [
                sensor.low_pass.gyroscope_bandwidth_hz().into(),
                sensor.low_pass.accelerometer_bandwidth_hz().into(),
            ],
            sensor.sample_rate_hz(),
        )
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

/// What a sample leaves to do when its snapshot is out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Aftermath(u32);

impl Aftermath {
    /// Beside the flags, which do not use this bit, so that one comparison tells that there is nothing to do.
    const STOCKTAKING: u32 = 1 << 31;

    /// The snapshot's flags.
    pub const fn flags(self) -> Flags {
        Flags::from_bits(self.0 & !Self::STOCKTAKING)
    }

    /// Whether the sample was one of those, some milliseconds apart, after which things are looked at that take time: others may do so,
    /// too.
    pub const fn has_taken_stock(self) -> bool {
        self.0 & Self::STOCKTAKING != 0
    }

    /// Whether the sample leaves these flags, and no more.
    #[inline(always)]
    pub const fn is_just(self, flags: Flags) -> bool {
        self.0 == flags.bits()
    }
}

/// The whole trip of a sample, with the state it needs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pipeline<F = AnyFilter> {
    settings: Settings,
    accelerometer_map: Affine,
    gyroscope_map: Affine,
    /// What the gyroscope's map removes, rad/s in sensor axes: stored, or by temperature.
    rate_offset_rad_s: Vector3,
    has_started: bool,
    estimator: Estimator<F>,
    was_still: bool,
    freeze_watch: FreezeWatch,
    sample: Sample,
    temperature_celsius: f32,
    /// Samples until the temperature is looked at again.
    until_temperature: u8,
    rest: Option<RestWatch>,
    /// The rest is the one that a filter without a bias of its own waits for.
    is_averaging: bool,
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
    temperature_limits: (i16, i16),
    /// The rate has jumped as if by a changed full scale, and nobody has read that back yet.
    is_suspect: bool,
    /// A sample within these, about which nothing else is to be said, is not looked at any closer.
    everyday: Everyday,
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
        let averages = settings.averaging_samples > 0 && filter.kalman().is_none();
        let delay_us = settings
            .sensor_delay_us
            .unwrap_or(settings.sensor.low_pass.gyroscope_delay_us().into());
        let mut pipeline = Self {
            settings: *settings,
            accelerometer_map: Affine::NONE,
            gyroscope_map: Affine::NONE,
            rate_offset_rad_s: Vector3::ZERO,
            has_started: false,
            estimator: Estimator::with_filter(filter).with_sensor_delay_us(delay_us),
            was_still: false,
            freeze_watch: FreezeWatch::new(settings.sensor.low_pass.gyroscope_bandwidth_hz()),
            sample: Sample::default(),
            temperature_celsius: 0.0,
            until_temperature: 1,
            rest: averages
                .then(|| RestWatch::new(&settings.rest_scale(), settings.averaging_samples)),
            is_averaging: averages,
            longest_step_us: 0,
            pause_us: 0,
            saturated_us: 0,
            thawed_at_us: 0,
            frozen_us: 0,
            temperature_limits: (0, 0),
            is_suspect: false,
            everyday: Everyday::NEVER,
            standing: Flags::NONE,
            tilt_variance_rad2: f32::INFINITY,
            samples_to_stocktaking: 0,
        };
        pipeline.derive_limits();
        pipeline.pause_us = pipeline.longest_step_us;
        pipeline.choose_everyday();
        pipeline.begin(settings.calibration.usual_celsius());
        pipeline
    }

    /// Takes one burst and gives the attitude at its time.
    pub fn update(&mut self, burst: &Burst) -> Snapshot {
        self.update_flagged(burst, Flags::NONE)
    }

    /// The same with what the board had to say of the burst, one or more of [`Flags::OF_BOARD`]: for a recording.
    pub fn update_flagged(&mut self, burst: &Burst, board_flags: Flags) -> Snapshot {
        let snapshot = self.update_with(burst, board_flags, |_, _| {});
        // Nobody can read the sensor's settings back here.
        self.confirm_scales();
        snapshot
    }

    /// Takes a sample of which nobody has kept the bytes, as of a recording in SI units: calibrated, in body axes. What only
    /// bytes tell is left out: blank and frozen data, the temperature, and an average at rest.
    pub fn update_sample(&mut self, sample: &Sample) -> Snapshot {
        self.sample = *sample;
        // Bytes about which there is nothing to say: not blank, and never twice the same.
        let mut bytes = [0x55; BURST_LENGTH];
        if let Some(place) = bytes.last_chunk_mut() {
            *place = sample.t_us.to_be_bytes();
        }
        let (coldest, hottest) = self.temperature_limits;
        let raw = RawSample {
            temperature: TemperatureCounts(coldest.midpoint(hottest)),
            ..RawSample::default()
        };
        let burst = Burst {
            bytes,
            captured_at_us: sample.t_us,
            missed_before: 0,
        };
        let is_saturated = [sample.is_rate_saturated, sample.is_force_saturated];
        let (snapshot, _) =
            self.judge_sample(&burst, &raw, is_saturated, Flags::NONE, |_| {}, |_, _| {});
        self.confirm_scales();
        snapshot
    }

    /// The same as [`update_flagged`](Self::update_flagged) where the sensor's settings are read back. The
    /// snapshot goes to `publish` as soon as it is there, with the variance of its tilt (rad², both axes
    /// together); what is done afterwards is for the next one.
    #[inline]
    pub fn update_with(
        &mut self,
        burst: &Burst,
        board_flags: Flags,
        publish: impl FnOnce(&Snapshot, f32),
    ) -> Snapshot {
        self.take_burst(burst, board_flags, |_| {}, publish).0
    }

    /// The same where each instruction counts: the variance goes to `show`, and only before a snapshot for which it has
    /// changed in the meantime; after a stocktaking, [`shown_variance_rad2`](Self::shown_variance_rad2) has it for the next one.
    #[inline(always)]
    pub fn update_and_publish(
        &mut self,
        burst: &Burst,
        board_flags: Flags,
        show: impl FnOnce(f32),
        publish: impl FnOnce(&Snapshot),
    ) -> Aftermath {
        self.take_burst(burst, board_flags, show, |snapshot, _| publish(snapshot))
            .1
    }

    #[inline(always)]
    fn take_burst(
        &mut self,
        burst: &Burst,
        board_flags: Flags,
        show: impl FnOnce(f32),
        publish: impl FnOnce(&Snapshot, f32),
    ) -> (Snapshot, Aftermath) {
        let raw = RawSample::decode(&burst.bytes);
        self.sample = Sample {
            t_us: burst.captured_at_us,
            specific_force_m_s2: self.accelerometer_map.apply(raw.accelerometer.0),
            angular_rate_rad_s: self.gyroscope_map.apply(raw.gyroscope.0),
            // Which is looked at where the size is not an everyday one, and once more after that.
            ..self.sample
        };
        self.judge_sample(burst, &raw, [false; 2], board_flags, show, publish)
    }

    /// The way of the sample that is in `self.sample`, and came with these bytes.
    #[inline(always)]
    fn judge_sample(
        &mut self,
        burst: &Burst,
        raw: &RawSample,
        is_saturated: [bool; 2],
        board_flags: Flags,
        show: impl FnOnce(f32),
        publish: impl FnOnce(&Snapshot, f32),
    ) -> (Snapshot, Aftermath) {
        let mut look = Look::EVERYDAY;
        let mut step_us = 0;
        if board_flags.is_empty() && is_saturated == [false; 2] {
            step_us = self
                .estimator
                .everyday_step_us(&self.sample, &self.everyday);
        }
        if step_us == 0 {
            (step_us, look) = self.look_closer(burst, raw, is_saturated, board_flags);
        }
        let estimate = self.estimator.take(&self.sample, step_us, look);
        let mut flags = (self.average_at_rest(raw) | self.standing)
            .with(Flags::MISSED, burst.missed_before > 0);
        if estimate.is_calibrating {
            let is_still = self.estimator.kalman().is_some_and(Kalman::is_still);
            flags = (flags | Flags::CALIBRATING | Flags::DEGRADED)
                .without(Flags::VALID)
                .with(Flags::MOVED, self.was_still && !is_still);
            self.was_still = is_still;
        }
        if estimate.look != Look::EVERYDAY {
            flags = self.judge(flags | board_flags, estimate.look);
            show(self.tilt_variance_rad2);
        }
        let snapshot = Snapshot {
            t_us: burst.captured_at_us,
            attitude: estimate.attitude,
            body_rates_rad_s: estimate.body_rates_rad_s,
            flags,
        };
        publish(&snapshot, self.tilt_variance_rad2);
        let mut aftermath = Aftermath(flags.bits());
        let (left, is_due) = self.samples_to_stocktaking.overflowing_sub(1);
        self.samples_to_stocktaking = left;
        if is_due {
            self.take_stock(burst, raw);
            aftermath.0 |= Aftermath::STOCKTAKING;
        }
        (snapshot, aftermath)
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
        let known = Known {
            bias_rad_s: known.bias_rad_s - self.body_offset(),
            ..*known
        };
        self.estimator.resume(&known);
        // At which temperature it began, the earlier run has seen to.
        self.has_started = true;
    }

    /// What a later run has to know to go on from here; `None` if there is nothing worth it.
    pub fn known(&self) -> Option<Known> {
        self.known_with(self.estimator.attitude())
    }

    /// The same with the last snapshot's attitude, which takes time to find.
    pub fn known_with(&self, attitude: Quaternion) -> Option<Known> {
        let filter = self.estimator.kalman()?;
        let is_worth_it = filter.is_bias_known() && self.standing.contains(Flags::VALID);
        is_worth_it.then(|| Known {
            attitude,
            tilt_sigma_rad: filter.tilt_sigma_rad(),
            bias_rad_s: self.rate_offset_rad_s(),
            bias_sigma_rad_s: filter.largest_bias_sigma_rad_s(),
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

    /// The variance of the tilt, both axes together, that goes with the next snapshot, rad².
    pub const fn shown_variance_rad2(&self) -> f32 {
        self.tilt_variance_rad2
    }

    /// Examines a sample that is not like every other, and gives what there is to remark about it.
    #[cold]
    #[inline(never)]
    fn look_closer(
        &mut self,
        burst: &Burst,
        raw: &RawSample,
        [is_rate_saturated, is_force_saturated]: [bool; 2],
        board_flags: Flags,
    ) -> (u32, Look) {
        self.sample.is_rate_saturated = is_rate_saturated | raw.gyroscope.is_saturated();
        self.sample.is_force_saturated = is_force_saturated | raw.accelerometer.is_saturated();
        let step_us = |last_t_us: u64| self.sample.t_us.wrapping_sub(last_t_us) as u32;
        let last_t_us = self.estimator.last_t_us();
        let is_pause = last_t_us.is_some_and(|last_t_us| step_us(last_t_us) > self.pause_us);
        if health::is_blank(&burst.bytes) {
            // Not a number, so that the estimator rejects it; and what is rejected does not end a pause.
            self.sample.specific_force_m_s2.x = f32::NAN;
        } else if is_pause || !board_flags.is_empty() || self.sample.is_rate_saturated {
            self.doubt(burst, board_flags);
        }
        let (step_us, look, has_jumped) = self.estimator.examine(&self.sample);
        self.is_suspect |= has_jumped;
        self.choose_everyday();
        (step_us, look)
    }

    /// What pauses, saturated samples and what the board says do to what is known.
    fn doubt(&mut self, burst: &Burst, board_flags: Flags) {
        let last_t_us = self.estimator.last_t_us().unwrap_or(0);
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
    fn judge(&mut self, flags: Flags, look: Look) -> Flags {
        let remarks = look.remarks();
        let flags = flags
            .with(Flags::GYROSCOPE_SATURATED, self.sample.is_rate_saturated)
            .with(
                Flags::ACCELEROMETER_SATURATED,
                self.sample.is_force_saturated,
            )
            .with(Flags::GAP, remarks.gap)
            .with(Flags::TIME, remarks.time_went_back)
            .with(Flags::REJECTED, remarks.rejected)
            .with(Flags::FREE_FALL, remarks.no_gravity);
        let is_odd = flags.intersects(Flags::ODD.without(Flags::CALIBRATING));
        if !(is_odd | remarks.any() | self.is_suspect) {
            return flags;
        }
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
        if is_frozen {
            // Blank samples are a pause already, and it counts when it ends.
            if !health::is_blank(&burst.bytes) {
                self.doubt_frozen(burst.captured_at_us as u32);
            }
        } else {
            self.thawed_at_us = burst.captured_at_us as u32;
            self.frozen_us = 0;
        }
        let is_extreme = raw.temperature.0 < coldest || raw.temperature.0 > hottest;
        self.standing = Flags::NONE
            .with(Flags::TEMPERATURE, is_extreme)
            .with(Flags::FROZEN, is_frozen);
        self.choose_everyday();
        if let Some(filter) = self.estimator.kalman_mut() {
            filter.take_stock();
        }
        self.take_stock_of_variance();
    }

    /// Has each sample looked at more closely while there is something to say of each.
    #[inline(never)]
    fn choose_everyday(&mut self) {
        let is_watched = self.is_suspect
            | self.sample.is_rate_saturated
            | self.sample.is_force_saturated
            | self.standing.intersects(Flags::ODD);
        self.everyday.most_step_us = if is_watched {
            0
        } else {
            self.pause_us.min(EVERYDAY_STEP_US)
        };
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

    #[inline(never)]
    fn known_tilt_variance(&self) -> f32 {
        match self.estimator.kalman() {
            Some(filter) if filter.has_tilt() => filter.tilt_variance_rad2(),
            _ => f32::INFINITY,
        }
    }

    /// What has time until the attitude is out: call it after each [`update`](Self::update), with the same burst.
    ///
    /// Follows the temperature, and feeds the rest that [`start_rest`](Self::start_rest) asked for; `None` if none is being collected.
    pub fn collect(&mut self, burst: &Burst) -> Option<RestProgress> {
        self.until_temperature = self.until_temperature.saturating_sub(1);
        if self.until_temperature == 0 {
            self.until_temperature = TEMPERATURE_SAMPLES;
            self.follow_temperature();
        }
        if self.is_averaging {
            return None;
        }
        let rest = self.rest.as_mut()?;
        let raw = RawSample::decode(&burst.bytes);
        let progress = rest.update(
            raw.gyroscope.0,
            raw.accelerometer.0,
            self.temperature_celsius,
        );
        if matches!(progress, RestProgress::Done(_)) {
            self.rest = None;
        }
        Some(progress)
    }

    /// Begins to collect rest: so many samples of it, in which nothing moves. Motion starts it over.
    /// A stored offset that still holds shortens it to a quarter.
    pub fn start_rest(&mut self, samples: u16) {
        let watch = RestWatch::new(&self.settings.rest_scale(), samples);
        let (expected_rad_s, sigma_rad_s) = self.known_offset(self.temperature_celsius);
        self.rest = Some(watch.expecting(expected_rad_s, sigma_rad_s));
        self.is_averaging = false;
    }

    /// Ends that.
    pub fn stop_rest(&mut self) {
        if !self.is_averaging {
            self.rest = None;
        }
    }

    /// How much of the rest is collected, 0 to 100; `None` if none is.
    pub fn rest_progress_percent(&self) -> Option<u8> {
        self.rest.as_ref().map(RestWatch::progress_percent)
    }

    /// Walks through its settings and everything that the attitudes to come depend on. Rest that is being collected is
    /// left out, and a pipeline that has to average before its filter can start refuses.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        self.settings.exchange(state);
        self.derive_limits();
        self.accelerometer_map.exchange(state);
        self.gyroscope_map.exchange(state);
        state.vector(&mut self.rate_offset_rad_s);
        state.truth(&mut self.has_started);
        self.estimator.exchange(state);
        state.truth(&mut self.was_still);
        self.freeze_watch.exchange(state);
        state.number(&mut self.temperature_celsius);
        state.byte(&mut self.until_temperature);
        state.word(&mut self.pause_us);
        self.pause_us = self.pause_us.min(self.longest_step_us);
        state.word(&mut self.saturated_us);
        // Of the last sample's time, which the estimator has, too.
        state.word(&mut { self.estimator.last_t_us().unwrap_or(0) as u32 });
        state.word(&mut self.thawed_at_us);
        state.word(&mut self.frozen_us);
        state.truth(&mut self.is_suspect);
        self.standing.exchange(state);
        state.number(&mut self.tilt_variance_rad2);
        state.word(&mut self.samples_to_stocktaking);
        let mut is_averaging = self.is_averaging;
        state.truth(&mut is_averaging);
        if is_averaging {
            state.refuse();
        }
        self.is_averaging = is_averaging;
        self.choose_everyday();
    }

    /// What is known about the sensor.
    pub const fn calibration(&self) -> &Calibration {
        &self.settings.calibration
    }

    /// Takes over what is now known about the sensor, from the next sample on.
    ///
    /// The attitude goes on unless the mount or the level changes: then the body has other axes, and the filter
    /// starts again, as does one that waits for an average.
    pub fn set_calibration(&mut self, calibration: &Calibration) {
        let before = self.settings;
        let rate_before = self.body_offset();
        self.settings.calibration = *calibration;
        let has_other_axes = before.mount() != self.settings.mount()
            || before.calibration.level != calibration.level;
        let waits_for_average = self.settings.averaging_samples > 0 && !self.is_kalman();
        if waits_for_average {
            self.start_rest(self.settings.averaging_samples);
            self.is_averaging = true;
        }
        if has_other_axes || waits_for_average {
            self.estimator.restart();
            self.was_still = false;
            self.begin(self.temperature_celsius);
        } else {
            self.rate_offset_rad_s = self.known_offset(self.temperature_celsius).0;
            self.derive_maps();
            // What the map removes now, the filter need not any more.
            self.estimator.shift_bias(rate_before - self.body_offset());
        }
    }

    /// The mean specific force of a rest, m/s² in mounted axes: corrected and mounted, but not levelled.
    /// What [`level`](crate::calibration::level::level) wants.
    pub fn mounted_force_m_s2(&self, at_rest: &AtRest) -> Vector3 {
        let reading = at_rest.specific_force_m_s2(&self.settings.rest_scale());
        let correction = self.settings.calibration.accelerometer;
        let sensor = correction.map_or(reading, |correction| correction.apply(reading));
        self.settings.mount().to_body(sensor)
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
        let stored = self.body_offset();
        match self.estimator.kalman() {
            Some(filter) => stored + filter.bias_rad_s(),
            None => stored,
        }
    }

    /// The numbers of the classic tutorial; `None` unless [`FilterKind::Classic`] runs.
    pub fn classic_angles(&self) -> Option<ClassicAngles> {
        self.estimator.classic_angles()
    }

    /// Known when compiled for one filter, so that the average is not linked in vain.
    fn is_kalman(&self) -> bool {
        self.estimator.kalman().is_some()
    }

    fn average_at_rest(&mut self, raw: &RawSample) -> Flags {
        if self.is_kalman() {
            return Flags::NONE;
        }
        let Some(rest) = self.rest.as_mut().filter(|_| self.is_averaging) else {
            return Flags::NONE;
        };
        let progress = rest.update(
            raw.gyroscope.0,
            raw.accelerometer.0,
            raw.temperature.to_celsius(self.settings.part),
        );
        match progress {
            RestProgress::Collecting => Flags::CALIBRATING,
            RestProgress::Moved(_) => Flags::CALIBRATING | Flags::MOVED,
            RestProgress::Done(at_rest) => {
                self.rest = None;
                self.is_averaging = false;
                self.apply_average(&at_rest);
                Flags::CALIBRATING
            }
        }
    }

    fn apply_average(&mut self, at_rest: &AtRest) {
        self.rate_offset_rad_s = self.settings.rest_scale().rad_s(at_rest.gyroscope_counts);
        self.derive_maps();
        if self.estimator.classic_angles().is_some() {
            // The tutorial takes the table for level: whatever is not one g upwards is offset.
            let gravity = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);
            let map = &mut self.accelerometer_map;
            map.offset = gravity - map.turn(at_rest.accelerometer_counts);
        }
        self.estimator.restart();
    }

    /// What the settings say of samples that are normal.
    fn derive_limits(&mut self) {
        let sensor = self.settings.sensor;
        let most_counts = EVERYDAY_SHARE * f32::from(i16::MAX);
        self.everyday = Everyday::up_to(
            most_counts * sensor.accelerometer_range.m_s2_per_count(),
            most_counts * sensor.gyroscope_range.rad_s_per_count(),
        );
        let period_us = 1.0e6 / sensor.sample_rate_hz();
        self.longest_step_us = (PERIODS_UNSEEN * period_us) as u32;
        let temperature = self.settings.part.temperature;
        self.temperature_limits =
            health::temperature_limits(temperature.celsius_per_count, temperature.celsius_at_zero);
        self.choose_everyday();
    }

    /// Tells maps and filter what is known, at this temperature in °C, before their first sample.
    #[inline(never)]
    fn begin(&mut self, celsius: f32) {
        let (offset_rad_s, sigma_rad_s) = self.known_offset(celsius);
        self.rate_offset_rad_s = offset_rad_s;
        self.derive_maps();
        if sigma_rad_s < LARGEST_STORED_SIGMA_RAD_S {
            self.estimator.set_bias(Vector3::ZERO, sigma_rad_s);
            if self.is_averaging {
                let expecting = |rest: RestWatch| rest.expecting(offset_rad_s, sigma_rad_s);
                self.rest = self.rest.map(expecting);
            }
        }
        self.estimator.prepare();
    }

    /// The gyroscope's offset at this temperature as it is known without the filter, rad/s in sensor axes, and its σ.
    fn known_offset(&self, celsius: f32) -> (Vector3, f32) {
        let calibration = &self.settings.calibration;
        let (stored, stored_sigma) = match calibration.gyroscope {
            None => (Vector3::ZERO, LARGEST_STORED_SIGMA_RAD_S),
            Some(stored) => {
                let away = celsius - stored.temperature_celsius;
                let drift = STORED_OFFSET_SIGMA_PER_CELSIUS * away;
                let variance =
                    STORED_OFFSET_SIGMA_RAD_S * STORED_OFFSET_SIGMA_RAD_S + drift * drift;
                let sigma = libm::sqrtf(variance).min(LARGEST_STORED_SIGMA_RAD_S);
                (stored.offset_rad_s, sigma)
            }
        };
        match calibration.temperature {
            None => (stored, stored_sigma),
            Some(model) => {
                let (offset, weight) = model.offset_at(celsius);
                let rest = 1.0 - weight;
                (
                    offset.scale(weight) + stored.scale(rest),
                    MODEL_SIGMA_RAD_S * weight + stored_sigma * rest,
                )
            }
        }
    }

    /// Moves the offset along the temperature model; outside of its range it stays where it is. The first time it tells
    /// the filter, which has one sample by then, at which temperature it really began.
    #[inline(never)]
    fn follow_temperature(&mut self) {
        let celsius = self.temperature_celsius;
        let calibration = &self.settings.calibration;
        if !self.has_started {
            self.has_started = true;
            if calibration.gyroscope.is_some() || calibration.temperature.is_some() {
                self.estimator.restart();
                self.begin(celsius);
            }
            return;
        }
        let Some(model) = calibration.temperature else {
            return;
        };
        let (_, weight) = model.offset_at(celsius);
        if weight > 0.0 && !self.is_averaging {
            self.rate_offset_rad_s = self.known_offset(celsius).0;
            self.gyroscope_map.remove(self.rate_offset_rad_s);
        }
    }

    /// What the gyroscope's map removes, rad/s in body axes.
    fn body_offset(&self) -> Vector3 {
        -self.gyroscope_map.offset
    }

    fn derive_maps(&mut self) {
        let sensor = &self.settings.sensor;
        let mount = self.settings.mount();
        let level = self.settings.calibration.level;
        let to_body = |sensor: Vector3| {
            let mounted = mount.to_body(sensor);
            level.map_or(mounted, |level| level.rotate(mounted))
        };
        let correction = self
            .settings
            .calibration
            .accelerometer
            .unwrap_or(AccelerometerCorrection::NONE);
        self.accelerometer_map = Affine::new(
            |sensor| to_body(correction.times(sensor)),
            sensor.accelerometer_range.m_s2_per_count(),
        );
        self.accelerometer_map.remove(correction.offset_m_s2);
        self.gyroscope_map = Affine::new(to_body, sensor.gyroscope_range.rad_s_per_count());
        self.gyroscope_map.remove(self.rate_offset_rad_s);
    }
}

/// Counts in sensor axes to SI units in body axes: scale, correction, mount and level in one.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Affine {
    /// What one count along each sensor axis is in the body's axes.
    columns: [Vector3; 3],
    offset: Vector3,
    counts_per_unit: f32,
}

impl Affine {
    fn exchange(&mut self, state: &mut impl Exchange) {
        for column in &mut self.columns {
            state.vector(column);
        }
        state.vector(&mut self.offset);
        state.number(&mut self.counts_per_unit);
    }

    const NONE: Self = Self {
        columns: [Vector3::ZERO; 3],
        offset: Vector3::ZERO,
        counts_per_unit: 1.0,
    };

    /// The map that a linear one makes of units per count.
    fn new(linear: impl Fn(Vector3) -> Vector3, per_count: f32) -> Self {
        Self {
            columns: [
                linear(Vector3::new(1.0, 0.0, 0.0)).scale(per_count),
                linear(Vector3::new(0.0, 1.0, 0.0)).scale(per_count),
                linear(Vector3::new(0.0, 0.0, 1.0)).scale(per_count),
            ],
            offset: Vector3::ZERO,
            counts_per_unit: 1.0 / per_count,
        }
    }

    /// From now on this reading, in units along the sensor's axes, becomes zero.
    fn remove(&mut self, reading: Vector3) {
        self.offset = -self.turn(reading.scale(self.counts_per_unit));
    }

    #[inline]
    fn apply(&self, [x, y, z]: [i16; 3]) -> Vector3 {
        self.turn(Vector3::new(f32::from(x), f32::from(y), f32::from(z))) + self.offset
    }

    #[inline]
    fn turn(&self, counts: Vector3) -> Vector3 {
        let [x, y, z] = self.columns;
        x.scale(counts.x) + y.scale(counts.y) + z.scale(counts.z)
    }
}

/// More sample periods than this without a sample are a pause in which the motion went unseen.
const PERIODS_UNSEEN: f32 = 3.5;

/// So many samples apart is looked at what changes slowly or takes time to tell: 11 ms, so that nothing
/// that repeats itself every few samples looks frozen.
const SAMPLES_BETWEEN_STOCKTAKINGS: u32 = 11;

/// An everyday sample reads less than this share of full scale, so that none of its axes is at full scale: a correction keeps 0.7 of
/// a force or more (its matrix differs from one by 0.1 per part at most, `calibration::accelerometer`) and takes 0.2 g per axis off;
/// what is taken off the rate is below 100 °/s (±20 °/s and another ±20 over temperature, product specification §6.1).
const EVERYDAY_SHARE: f32 = 0.6;

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
    use crate::calibration::{GyroscopeOffset, TemperatureModel};
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

        let mut known = settings();
        known.calibration.gyroscope = Some(GyroscopeOffset {
            offset_rad_s: Mount::Z_UP.to_sensor(pipeline.rate_offset_rad_s()),
            temperature_celsius: 25.0,
        });
        let mut pipeline = Pipeline::new(&known);
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
        assert_eq!(moved, [601]);
        assert_eq!(done, Some(1602));
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

    /// Everything that a calibration can hold, with errors that it describes exactly.
    fn calibration() -> Calibration {
        Calibration {
            mount: Some(Mount::Z_DOWN),
            gyroscope: Some(GyroscopeOffset {
                offset_rad_s: Vector3::new(0.1, -0.2, 0.05),
                temperature_celsius: 25.0,
            }),
            temperature: None,
            accelerometer: Some(AccelerometerCorrection {
                offset_m_s2: Vector3::new(0.3, -0.4, 0.5),
                matrix: [1.02, 0.98, 1.01, 0.01, -0.005, 0.008],
            }),
            level: Some(Quaternion::from_euler(EulerAngles {
                roll_rad: radians(2.0),
                pitch_rad: radians(-3.0),
                yaw_rad: 0.0,
            })),
        }
    }

    #[test]
    fn a_calibration_is_applied_step_by_step_in_one_map() {
        let calibration = calibration();
        let mut pipeline = Pipeline::new(&Settings {
            calibration,
            ..settings()
        });
        let raw = RawSample {
            accelerometer: AccelerometerCounts([300, -1200, 1500]),
            temperature: TemperatureCounts(-3920),
            gyroscope: GyroscopeCounts([500, -700, 900]),
        };
        pipeline.update(&Burst {
            bytes: raw.encode(),
            captured_at_us: 0,
            missed_before: 0,
        });
        // The same, one step after the other.
        let config = settings().sensor;
        let reading = raw.accelerometer.to_m_s2(config.accelerometer_range);
        let corrected = calibration.accelerometer.expect("set above").apply(reading);
        let level = calibration.level.expect("set above");
        let force = level.rotate(Mount::Z_DOWN.to_body(corrected));
        let rate = raw.gyroscope.to_rad_s(config.gyroscope_range) - Vector3::new(0.1, -0.2, 0.05);
        let rate = level.rotate(Mount::Z_DOWN.to_body(rate));
        let sample = pipeline.sample();
        assert!(
            (sample.specific_force_m_s2 - force).norm() < 1e-5,
            "{sample:?} {force:?}"
        );
        assert!(
            (sample.angular_rate_rad_s - rate).norm() < 1e-6,
            "{sample:?} {rate:?}"
        );
        let offset = pipeline.rate_offset_rad_s();
        let expected = level.rotate(Mount::Z_DOWN.to_body(Vector3::new(0.1, -0.2, 0.05)));
        assert!((offset - expected).norm() < 1e-6);
    }

    #[test]
    fn a_new_mount_starts_the_filter_again_and_other_changes_do_not() {
        let mut pipeline = Pipeline::new(&settings());
        let tilted = force(10.0, 0.0);
        let turn = Vector3::new(0.0, 0.0, 30.0);
        for index in 0..1000_u64 {
            pipeline.update(&burst(Mount::Z_UP, index * 1000, tilted, turn));
        }
        let yaw = pipeline.estimator().attitude().to_euler().yaw_rad;
        assert!(yaw.to_degrees() > 20.0, "{yaw}");
        let mut known = Calibration {
            gyroscope: calibration().gyroscope,
            ..Calibration::NONE
        };
        let before = pipeline.rate_offset_rad_s();
        pipeline.set_calibration(&known);
        assert!((pipeline.rate_offset_rad_s() - before).norm() < 1e-6);
        let after = pipeline.update(&burst(Mount::Z_UP, 1_000_000, tilted, turn));
        assert!((after.euler().yaw_rad - yaw).abs() < radians(0.1));
        known.mount = Some(Mount::Z_DOWN);
        pipeline.set_calibration(&known);
        let after = pipeline.update(&burst(Mount::Z_DOWN, 1_001_000, tilted, turn));
        assert!(after.euler().yaw_rad.abs() < radians(0.1), "{after:?}");
        assert!((after.euler().roll_rad.to_degrees() - 10.0).abs() < 0.5);
    }

    #[test]
    fn the_temperature_model_moves_the_offset_and_stays_where_it_ends() {
        let mut calibration = Calibration::NONE;
        calibration.temperature = Some(TemperatureModel {
            reference_celsius: 25.0,
            offset_rad_s: Vector3::new(radians(1.0), 0.0, 0.0),
            slope_rad_s_per_celsius: Vector3::new(radians(0.1), 0.0, 0.0),
            curvature_rad_s_per_celsius2: Vector3::ZERO,
            coldest_celsius: 20.0,
            warmest_celsius: 40.0,
        });
        let mut pipeline = Pipeline::new(&Settings {
            calibration,
            ..settings()
        });
        let mut offset_at = |celsius: f32, from: u64| {
            let mut sample = RawSample::decode(&burst(Mount::Z_UP, 0, LEVEL, Vector3::ZERO).bytes);
            sample.temperature = TemperatureCounts(((celsius - 36.53) * 340.0) as i16);
            for index in 0..100_u64 {
                let burst = Burst {
                    bytes: sample.encode(),
                    captured_at_us: (from + index) * 1000,
                    missed_before: 0,
                };
                pipeline.update(&burst);
                assert_eq!(pipeline.collect(&burst), None);
            }
            pipeline.body_offset().x.to_degrees()
        };
        for (celsius, expected, from) in [
            (25.0, 1.0, 0),
            (40.0, 2.5, 100),
            (45.0, 3.0, 200),
            // Beyond the range and its margin the last value holds.
            (70.0, 3.0, 300),
            (20.0, 0.5, 400),
        ] {
            let offset = offset_at(celsius, from);
            assert!((offset - expected).abs() < 0.01, "{celsius}: {offset}");
        }
    }

    #[test]
    fn rest_is_collected_while_the_attitude_goes_on() {
        let mut pipeline = Pipeline::new(&settings());
        let mut twin = Pipeline::new(&settings());
        pipeline.start_rest(500);
        let mut done = None;
        for index in 0..600_u64 {
            let burst = burst(
                Mount::Z_UP,
                index * 1000,
                LEVEL,
                Vector3::new(1.0, 2.0, 3.0),
            );
            assert_eq!(pipeline.update(&burst), twin.update(&burst));
            assert_eq!(twin.collect(&burst), None);
            match pipeline.collect(&burst) {
                Some(RestProgress::Done(at_rest)) => done = Some((index, at_rest)),
                Some(RestProgress::Collecting) => {
                    assert!(pipeline.rest_progress_percent() < Some(100));
                }
                other => assert!(other.is_none() && index >= 500, "{index}: {other:?}"),
            }
        }
        let (index, at_rest) = done.expect("it rests");
        assert_eq!(index, 499);
        let offset = at_rest.gyroscope_offset(&pipeline.settings().rest_scale());
        let expected = Vector3::new(radians(1.0), radians(-2.0), radians(-3.0));
        assert!(
            (offset.offset_rad_s - expected).is_within(radians(0.04)),
            "{offset:?}"
        );
        let force = pipeline.mounted_force_m_s2(&at_rest);
        assert!((force - LEVEL).norm() < 0.01, "{force:?}");
        pipeline.start_rest(500);
        pipeline.stop_rest();
        assert_eq!(pipeline.rest_progress_percent(), None);
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
    fn full_scale_is_flagged_and_blank_data_rejected_at_every_range_and_with_every_correction() {
        use crate::mpu6050::{AccelerometerRange, GyroscopeRange};
        let accelerometer = [
            AccelerometerRange::G2,
            AccelerometerRange::G4,
            AccelerometerRange::G8,
            AccelerometerRange::G16,
        ];
        let gyroscope = [
            GyroscopeRange::Degrees250,
            GyroscopeRange::Degrees500,
            GyroscopeRange::Degrees1000,
            GyroscopeRange::Degrees2000,
        ];
        let offset = 0.2 * STANDARD_GRAVITY_M_S2;
        // The largest corrections that a fit may have, by which readings grow and shrink most.
        let corrections = [
            (1.0, 0.0, 0.0),
            (0.9, -0.1, 1.0),
            (0.9, 0.1, -1.0),
            (1.1, 0.1, -1.0),
        ];
        for (range, (diagonal, cross, sign)) in
            (0..4).flat_map(|range| corrections.map(|correction| (range, correction)))
        {
            let mut settings = without_averaging();
            settings.sensor.accelerometer_range = accelerometer[range];
            settings.sensor.gyroscope_range = gyroscope[range];
            settings.calibration.accelerometer = Some(AccelerometerCorrection {
                offset_m_s2: Vector3::new(sign * offset, sign * offset, sign * offset),
                matrix: [diagonal, diagonal, diagonal, cross, cross, cross],
            });
            settings.calibration.gyroscope = Some(crate::calibration::GyroscopeOffset {
                offset_rad_s: Vector3::new(radians(40.0), radians(40.0), radians(-40.0)),
                temperature_celsius: 25.0,
            });
            let g = settings.sensor.accelerometer_range.counts_per_g() as i16;
            let mut pipeline = Pipeline::new(&settings);
            let mut t_us = 0;
            let mut flags = |accelerometer: [i16; 3], temperature, gyroscope: [i16; 3]| {
                t_us += 1_000;
                let sample = RawSample {
                    accelerometer: AccelerometerCounts(accelerometer),
                    temperature: TemperatureCounts(temperature),
                    gyroscope: GyroscopeCounts(gyroscope),
                };
                let burst = Burst {
                    bytes: sample.encode(),
                    captured_at_us: t_us,
                    missed_before: 0,
                };
                pipeline.update(&burst).flags
            };
            let seldom =
                Flags::GYROSCOPE_SATURATED | Flags::ACCELEROMETER_SATURATED | Flags::REJECTED;
            for full in [i16::MIN, -i16::MAX, i16::MAX] {
                for axis in 0..3 {
                    for others in [0, g / 3] {
                        let mut rate = [others; 3];
                        rate[axis] = full;
                        let found = flags([0, 0, g], -3920, rate) & seldom;
                        assert_eq!(found, Flags::GYROSCOPE_SATURATED, "{range} {rate:?}");
                        assert_eq!(flags([0, 0, g], -3920, [0; 3]) & seldom, Flags::NONE);
                        let mut force = [others; 3];
                        force[axis] = full;
                        let found = flags(force, -3920, [0; 3]) & seldom;
                        assert_eq!(found, Flags::ACCELEROMETER_SATURATED, "{range} {force:?}");
                        assert_eq!(flags([0, 0, g], -3920, [0; 3]) & seldom, Flags::NONE);
                    }
                }
            }
            for blank in [0, -1] {
                let found = flags([blank; 3], blank, [blank; 3]) & seldom;
                assert_eq!(found, Flags::REJECTED, "{range} {blank}");
            }
        }
    }

    #[test]
    fn a_step_that_is_a_millisecond_after_the_counter_s_wrap_is_a_gap() {
        let mut pipeline = Pipeline::new(&without_averaging());
        let mut flags = |t_us| {
            pipeline
                .update(&burst(Mount::Z_UP, t_us, LEVEL, Vector3::ZERO))
                .flags
        };
        for index in 1..10 {
            assert_eq!(flags(index * 1_000) & Flags::GAP, Flags::NONE);
        }
        // 32 bits of the step are those of one millisecond.
        assert_eq!(flags(10_000 + (1 << 32)) & Flags::GAP, Flags::GAP);
        assert_eq!(flags(11_000) & Flags::TIME, Flags::TIME);
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
    fn a_pause_of_blank_data_counts_once() {
        let (mut pipeline, t_us) = settled();
        for step in 1..=400 {
            let burst = Burst {
                bytes: [0xFF; 14],
                captured_at_us: t_us + step * 1000,
                missed_before: 0,
            };
            assert!(!pipeline.update(&burst).flags.contains(Flags::VALID));
        }
        // 0.4 s at 30 °/s about two axes are 17°; frozen data on top would make 24°, and more with each look at them.
        let first = pipeline.update(&noisy(t_us + 401_000, LEVEL));
        let sigma = libm::sqrtf(pipeline.tilt_variance_rad2(first.t_us));
        assert!(sigma < radians(18.0), "{sigma}");
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
