//! Processes one burst to one snapshot: the only place that defines the order of the steps.
//!
//! ```text
//! Burst ─► inspect ─► decode, correct, align ─► estimate ─► judge ─► Snapshot
//! ```
//!
//! Before the estimate, a rate that no body can have is replaced (`suspect_data.rs`), and the
//! temperature may move the offset (`thermal_drift.rs`).
//!
//! Every burst gives a snapshot, from the first one on. The snapshot carries [`Flags::CALIBRATING`]
//! until the gyroscope's offset is known: after a second of rest. Until then σ is much larger. A
//! stored offset counts within 4.9 °C of its temperature, or within the range of a temperature
//! model. The offset is then known from the start, and the attitude `VALID` after 0.16 s.
//! [`Pipeline::update`] does all the work, housekeeping included, so a caller cannot forget any.
//!
//! Deadline: a fraction of the sample period, 1 ms. No loop's length depends on data, and no step
//! waits.
//!
//! ```
//! use aplomb::health::BoardFlags;
//! use aplomb::mpu6050::{AccelerometerCounts, Burst, Part, RawSample};
//! use aplomb::pipeline::{Pipeline, Settings};
//!
//! let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
//! // A sensor that lies face up, rolled by 30°: 2048 counts are one g.
//! let sample = RawSample {
//!     accelerometer: AccelerometerCounts([0, 1024, 1774]),
//!     ..RawSample::default()
//! };
//! let burst = Burst {
//!     bytes: sample.encode(), // 14 bytes: yours come from the bus
//!     captured_at_us: 1_000,
//!     missed_before: 0,
//! };
//! let snapshot = pipeline.update(&burst, BoardFlags::empty());
//! let roll_deg = snapshot.euler().roll_rad.to_degrees();
//! assert!((roll_deg - 30.0).abs() < 0.1);
//! ```

mod alignment;
pub mod classic;
mod compass;
mod learned;
mod offset;
#[cfg(not(feature = "firmware"))]
mod sample_order;
mod samples;
mod settings;
mod snapshot;
mod suspect_data;
mod thermal_drift;

#[cfg(test)]
mod tests;

pub use compass::{CompassPipeline, CompassReading, compass_knowledge};
pub use settings::{ImplausibleSettings, Settings};
pub use snapshot::Snapshot;

use core::f32::consts::PI;

use crate::attitude::Vector3;
use crate::calibration::{Calibration, StationaryDetector, StationaryMean};
use crate::estimator::arithmetic::smaller;
use crate::estimator::kalman::{AccelerometerKnowledge, GyroscopeKnowledge, Kalman, WarmStart};
use crate::estimator::{Estimator, Filter, Issues, Sample};
#[cfg(not(feature = "firmware"))]
use crate::health::SampleMonitor;
use crate::health::{BoardFlags, Flags, Monitor, Vibration};
use crate::mpu6050::{Burst, RawSample, TemperatureCounts};
use crate::serialize::StateVisitor;
use crate::units::SECONDS_PER_MICROSECOND;
use alignment::Alignment;
use offset::StoredOffset;
#[cfg(not(feature = "firmware"))]
use sample_order::SampleOrder;
use suspect_data::SuspectData;
use thermal_drift::ThermalDrift;

/// Samples between two updates of the temperature compensation.
const TEMPERATURE_SAMPLES: u8 = 64;

/// All steps from a burst to a snapshot, with their state.
///
/// The fields keep this order in memory, because a core reaches the first kilobyte with shorter
/// code.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pipeline {
    alignment: Alignment,
    /// The gyroscope offset that the alignment removes, rad/s in sensor axes: stored, or by
    /// temperature.
    gyroscope_offset_rad_s: Vector3,
    temperature_celsius: f32,
    /// Samples until the temperature compensation is updated; zero before the first sample.
    samples_to_temperature: u8,
    thermal_drift: ThermalDrift,
    monitor: Monitor,
    suspect: SuspectData,
    sample: Sample,
    estimator: Estimator,
    settings: Settings,
    vibration: Vibration,
    /// The firmware takes bursts only, and has no memory to spare.
    #[cfg(not(feature = "firmware"))]
    sample_monitor: SampleMonitor,
    #[cfg(not(feature = "firmware"))]
    order: SampleOrder,
}

impl Pipeline {
    /// Creates a pipeline without a burst.
    ///
    /// Does not check the settings: call [`Settings::check`] if they come from outside. With a
    /// calibration that no sensor has, wrong attitudes are flagged [`Flags::VALID`].
    ///
    /// ```
    /// use aplomb::calibration::Calibration;
    /// use aplomb::mpu6050::{Config, Part};
    /// use aplomb::pipeline::{ImplausibleSettings, Pipeline, Settings};
    ///
    /// fn start(calibration: Calibration) -> Result<Pipeline, ImplausibleSettings> {
    ///     let mut settings = Settings::for_sensor(&Part::MPU_6050, &Config::DEFAULT);
    ///     settings.calibration = calibration;
    ///     settings.check()?;
    ///     Ok(Pipeline::new(&settings))
    /// }
    /// # assert!(start(Calibration::NONE).is_ok());
    /// ```
    pub fn new(settings: &Settings) -> Self {
        let sensor = &settings.sensor;
        let monitor = Monitor::new(&settings.monitored_sensor());
        let mut pipeline = Self {
            settings: *settings,
            alignment: Alignment::new(settings, Vector3::ZERO),
            gyroscope_offset_rad_s: Vector3::ZERO,
            temperature_celsius: settings.calibration.usual_celsius(),
            samples_to_temperature: 0,
            thermal_drift: ThermalDrift::NONE,
            monitor,
            suspect: SuspectData::new(sensor.sample_rate_hz(), monitor.frozen_samples()),
            vibration: Vibration::new(
                sensor.sample_rate_hz(),
                sensor.accelerometer_range.full_scale_g(),
            ),
            estimator: Estimator::new(),
            sample: Sample::default(),
            #[cfg(not(feature = "firmware"))]
            sample_monitor: SampleMonitor::new(),
            #[cfg(not(feature = "firmware"))]
            order: SampleOrder::new(),
        };
        let filter = pipeline.estimator.filter_mut();
        filter.set_delay_us(settings.delay_us());
        filter.set_sample_period(1.0 / sensor.sample_rate_hz());
        filter.set_accelerometer_knowledge(settings.accelerometer_knowledge());
        filter.set_gyroscope_knowledge(settings.gyroscope_knowledge());
        pipeline.apply_stored_offset();
        pipeline
    }

    /// Processes one burst with the conditions that the board reports. Returns the attitude at the
    /// burst's time.
    ///
    /// Times increase. A burst that is not later than the one before is flagged [`Flags::TIME`],
    /// and is never valid. It is ignored if it is late by at most 0.5 s. After a larger step back
    /// the clock goes on from that burst, and the next one starts roll and pitch from gravity. With
    /// a feature `board-…` no burst is ignored: the times of the burst reader increase.
    #[inline]
    pub fn update(&mut self, burst: &Burst, board: BoardFlags) -> Snapshot {
        let temperature = RawSample::decode(&burst.bytes).temperature;
        let mut flags = self.monitor.inspect(&burst.bytes, temperature.0);
        flags |= Flags::from(board);
        flags.set(Flags::MISSED, burst.missed_before > 0);
        self.take_scale_check(board);
        #[cfg(not(feature = "firmware"))]
        if self.is_late(burst.captured_at_us) {
            return self.skip(burst.captured_at_us, flags | Flags::TIME);
        }
        if flags.intersects(Flags::UNUSABLE_SAMPLE) {
            return self.skip(burst.captured_at_us, flags);
        }
        self.follow_temperature(temperature);
        if board.contains(BoardFlags::INTERNAL_CLOCK) {
            self.follow_sensor_clock(burst.captured_at_us, board);
        }
        // The other readings are decoded only here, which takes fewer registers.
        let raw = RawSample::decode(&burst.bytes);
        let sample = self.alignment.apply(&raw, burst.captured_at_us);
        self.process(&sample, flags)
    }

    /// Corrects the internal oscillator, which may be wrong by 8 %, by the sensor's clock. Bursts
    /// that a timer has started do not show that clock.
    #[cold]
    #[inline(never)]
    fn follow_sensor_clock(&mut self, t_us: u64, board: BoardFlags) {
        if !board.contains(BoardFlags::POLLED) {
            let period_s = 1.0 / self.settings.sensor.sample_rate_hz();
            self.estimator.follow_sensor_clock(t_us, period_s);
        }
    }

    /// Confirms the full scales if the caller has read them back, or never does.
    #[inline]
    fn take_scale_check(&mut self, board: BoardFlags) {
        if board.contains(BoardFlags::SCALES_VERIFIED) || !self.settings.verifies_scales {
            self.monitor.confirm_scales();
        }
    }

    /// Returns whether a sample at this time is late.
    #[cfg(not(feature = "firmware"))]
    #[inline]
    fn is_late(&mut self, t_us: u64) -> bool {
        (self.order).is_late(&mut self.estimator, t_us, &self.settings.sensor)
    }

    /// Estimates the attitude, and completes the flags.
    #[inline]
    fn process(&mut self, sample: &Sample, mut flags: Flags) -> Snapshot {
        flags.set(Flags::GYROSCOPE_SATURATED, sample.is_rate_saturated);
        let held;
        let sample = if self.suspect.may_be_spurious(sample) {
            let (estimator, last) = (&mut self.estimator, &self.sample);
            held = self.suspect.replace_spurious_rate(estimator, last, sample);
            &held
        } else {
            sample
        };
        flags.set(Flags::ACCELEROMETER_SATURATED, sample.is_force_saturated);
        flags |= self.vibration.update(&sample.specific_force_m_s2);
        self.suspect
            .inflate(&mut self.estimator, &self.sample, sample, flags);
        let estimate = self.estimator.update(sample);
        if !estimate.issues.is_empty() {
            flags |= flags_of(estimate.issues);
            if estimate.issues.contains(Issues::RATE_JUMP) {
                self.monitor.require_scale_check();
                suspect_data::inflate_jump(&mut self.estimator, &self.sample, sample);
            }
        }
        if !flags.contains(Flags::REJECTED) {
            self.sample = *sample;
        }
        if !estimate.is_bias_known {
            let is_still = self.estimator.filter().is_still();
            flags |= self.monitor.update_calibration(is_still);
        }
        Snapshot {
            t_us: sample.t_us,
            attitude: estimate.attitude,
            body_rates_rad_s: estimate.body_rates_rad_s,
            flags: self.monitor.judge(flags, estimate.tilt_variance_rad2),
            tilt_variance_rad2: estimate.tilt_variance_rad2,
        }
    }

    /// Skips a sample that is no measurement or comes late: for the filter it is missing.
    #[cold]
    #[inline(never)]
    fn skip(&mut self, t_us: u64, flags: Flags) -> Snapshot {
        self.suspect.skip(flags);
        if self.monitor.has_stuck_axis() {
            // It has turned the attitude wrongly for a while.
            self.kalman_mut().lose_tilt();
        }
        self.hold(t_us, flags)
    }

    /// Returns the snapshot at `t_us` (µs since start) while no samples come: the last attitude,
    /// flagged [`Flags::STALE`], with a growing σ.
    pub fn stale(&self, t_us: u64, board: BoardFlags) -> Snapshot {
        self.hold(t_us, Flags::from(board) | Flags::STALE)
    }

    /// Returns the snapshot for a time without a sample: the last attitude, with a σ that grows
    /// with its age.
    #[cold]
    #[inline(never)]
    fn hold(&self, t_us: u64, mut flags: Flags) -> Snapshot {
        flags.set(Flags::CALIBRATING, !self.kalman().is_bias_known());
        let estimate = self.estimator.estimate();
        let age_us = t_us.saturating_sub(self.estimator.last_t_us().unwrap_or(0));
        let age_us = u32::try_from(age_us).unwrap_or(u32::MAX);
        let age_s = age_us as f32 * SECONDS_PER_MICROSECOND;
        let tilt_variance_rad2 =
            estimate.tilt_variance_rad2 + 2.0 * self.kalman().pause_variance_rad2(age_s);
        Snapshot {
            t_us,
            attitude: estimate.attitude,
            body_rates_rad_s: estimate.body_rates_rad_s,
            flags: self.monitor.judge(flags, tilt_variance_rad2),
            tilt_variance_rad2,
        }
    }

    /// Returns whether the rate has jumped as if the gyroscope's full scale had changed. The caller
    /// should then read the full scales back, and report [`BoardFlags::SCALES_VERIFIED`]. Until
    /// then no attitude is valid.
    ///
    /// Always `false` unless [`Settings::verifies_scales`] is set.
    pub const fn awaits_scale_check(&self) -> bool {
        self.settings.verifies_scales && self.monitor.awaits_scale_check()
    }

    /// Continues from an earlier run, whose σ belong to `t_us` on the clock of the bursts, in µs.
    /// Call it before the first burst, which comes later. Returns false, and changes nothing, if
    /// the state is damaged. After a burst, which it does not check, it replaces attitude and
    /// biases too. See [`Estimator::resume`], and [`resume_aged`](Self::resume_aged) for an old
    /// state.
    pub fn resume(&mut self, start: &WarmStart, t_us: u64) -> bool {
        let [forward, right] = start.accelerometer_bias_m_s2;
        let removed = self.alignment.accelerometer_offset_m_s2();
        let start = WarmStart {
            bias_rad_s: start.bias_rad_s - self.alignment.gyroscope_offset_rad_s(),
            accelerometer_bias_m_s2: [forward - removed.x, right - removed.y],
            ..*start
        };
        let is_resumed = self.estimator.resume(&start, t_us);
        if is_resumed {
            // The bias already belongs to the present temperature.
            self.samples_to_temperature = TEMPERATURE_SAMPLES;
            self.thermal_drift.leave_model();
        }
        is_resumed
    }

    /// Returns the state from which a later run can continue, with its present σ; `None` until a
    /// rest, of this run or an earlier one, has measured the gyroscope's bias. A later run has to
    /// get the latest state, or none: σ of an older one does not cover what has happened since.
    ///
    /// `latest` is the latest snapshot, a [stale](Self::stale) one included.
    pub fn warm_start(&self, latest: &Snapshot) -> Option<WarmStart> {
        let filter = self.estimator.filter();
        let bias_sigma_rad_s = filter.kept_bias_sigma_rad_s()?;
        let removed = self.alignment.accelerometer_offset_m_s2();
        let accelerometer = removed + filter.accelerometer_bias_m_s2();
        Some(WarmStart {
            attitude: latest.attitude,
            // Infinite without a tilt.
            tilt_sigma_rad: smaller(latest.tilt_sigma_rad(), PI),
            bias_rad_s: self.gyroscope_offset_body_rad_s(),
            bias_change_rad_s: filter.bias_change_rad_s(),
            bias_sigma_rad_s,
            accelerometer_bias_m_s2: [accelerometer.x, accelerometer.y],
            squared_velocity_m2_s2: filter.squared_velocity_m2_s2(),
        })
    }

    /// Returns the calibration in use.
    pub const fn calibration(&self) -> &Calibration {
        &self.settings.calibration
    }

    /// Replaces the calibration, from the next sample on. For one that comes from outside call
    /// [`Calibration::check`] before.
    ///
    /// The attitude continues, unless the mount, the level or the gyroscope's matrix changes. Then
    /// the rates in body axes change, and the filter restarts. Returns whether it does: a heading
    /// filter of the caller has to restart too.
    pub fn set_calibration(&mut self, calibration: &Calibration) -> bool {
        let before = self.settings;
        let removed_before = self.alignment.gyroscope_offset_rad_s();
        self.settings.calibration = *calibration;
        if before.calibration.accelerometer != calibration.accelerometer {
            let knowledge = self.settings.accelerometer_knowledge();
            self.kalman_mut().set_accelerometer_knowledge(knowledge);
        }
        let has_other_matrix = before.calibration.gyroscope_matrix != calibration.gyroscope_matrix;
        let has_other_rates = has_other_matrix
            || before.mount() != self.settings.mount()
            || before.calibration.level != calibration.level;
        if has_other_matrix {
            let knowledge = self.settings.gyroscope_knowledge();
            self.kalman_mut().set_gyroscope_knowledge(knowledge);
        }
        if has_other_rates {
            self.estimator.restart();
            self.monitor.restart();
            self.alignment = Alignment::new(&self.settings, self.gyroscope_offset_rad_s);
            self.apply_stored_offset();
        } else {
            let stored = StoredOffset::at(calibration, self.temperature_celsius);
            self.gyroscope_offset_rad_s = stored.offset_rad_s;
            self.alignment = Alignment::new(&self.settings, stored.offset_rad_s);
            // The filter estimates the offset that the alignment leaves.
            let change = removed_before - self.alignment.gyroscope_offset_rad_s();
            self.kalman_mut().shift_bias(change);
        }
        has_other_rates
    }

    /// Sets what is known of the accelerometer's offset, for samples that are calibrated elsewhere:
    /// those of a recording in SI units. With a calibrated accelerometer the gyroscope's scale and
    /// cross-axis terms count as calibrated too, until
    /// [`set_gyroscope_knowledge`](Self::set_gyroscope_knowledge). Default: by the calibration of
    /// the settings.
    pub fn set_accelerometer_knowledge(&mut self, knowledge: AccelerometerKnowledge) {
        let gyroscope = match self.settings.gyroscope_knowledge() {
            GyroscopeKnowledge::Calibrated => GyroscopeKnowledge::Calibrated,
            GyroscopeKnowledge::Factory => GyroscopeKnowledge::implied_by(knowledge),
        };
        let kalman = self.kalman_mut();
        kalman.set_accelerometer_knowledge(knowledge);
        kalman.set_gyroscope_knowledge(gyroscope);
    }

    /// Sets what is known of the gyroscope's scale and cross-axis terms, for samples that are
    /// calibrated elsewhere. Call it after
    /// [`set_accelerometer_knowledge`](Self::set_accelerometer_knowledge). Default: by the
    /// calibration of the settings.
    pub fn set_gyroscope_knowledge(&mut self, knowledge: GyroscopeKnowledge) {
        self.kalman_mut().set_gyroscope_knowledge(knowledge);
    }

    /// Arms (`true`) the filter. An armed filter skips the updates that are only safe on the
    /// ground. Default: `false`.
    pub const fn set_armed(&mut self, is_armed: bool) {
        self.kalman_mut().set_armed(is_armed);
    }

    /// Creates a stationary detector for this sensor that needs `samples` at rest. A stored
    /// offset does not shorten them, so that a repeated calibration is as exact as the first.
    pub fn stationary_detector(&self, samples: u16) -> StationaryDetector {
        StationaryDetector::new(&self.settings.noise_model(), samples)
    }

    /// Returns the mean specific force at rest, m/s² in mounted axes: corrected and mounted, but
    /// not levelled. The result is the input of [`level::trim`](crate::calibration::level::trim).
    pub fn mounted_force_m_s2(&self, at_rest: &StationaryMean) -> Vector3 {
        let reading = at_rest.specific_force_m_s2(&self.settings.noise_model());
        let correction = self.settings.calibration.accelerometer;
        let sensor = correction.map_or(reading, |correction| correction.apply(reading));
        self.settings.mount().to_body(sensor).0
    }

    /// Returns the settings.
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the filter, with biases and their σ.
    pub const fn kalman(&self) -> &Kalman {
        self.estimator.filter()
    }

    const fn kalman_mut(&mut self) -> &mut Kalman {
        self.estimator.filter_mut()
    }

    /// Returns the last sample that was a measurement, calibrated, in body axes. The rate before
    /// replaces a spurious full-scale reading.
    pub const fn sample(&self) -> &Sample {
        &self.sample
    }

    /// Returns the die temperature of the last sample that was a measurement, °C.
    pub const fn temperature_celsius(&self) -> f32 {
        self.temperature_celsius
    }

    /// Returns the gyroscope's whole offset, rad/s in body axes: the stored part plus the estimated
    /// part.
    pub fn gyroscope_offset_body_rad_s(&self) -> Vector3 {
        self.alignment.gyroscope_offset_rad_s() + self.kalman().bias_rad_s()
    }

    /// Returns the accelerometer's offset that motion has shown beyond the calibration, m/s² in
    /// body axes; `None` until it is certain. Always `None` for an accelerometer that was
    /// calibrated in poses, which is better.
    ///
    /// The next run can start with it: [`Calibration::add_accelerometer_offset`].
    pub fn certain_accelerometer_offset_m_s2(&self) -> Option<Vector3> {
        let correction = &self.settings.calibration.accelerometer;
        if correction.is_some_and(|correction| correction.is_from_poses()) {
            return None;
        }
        self.kalman().certain_accelerometer_bias_m_s2()
    }

    /// Visits the settings and every field that later attitudes depend on.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        self.settings.visit_state(visitor);
        self.settings.calibration.visit_gyroscope_matrix(visitor);
        visitor.vector(&mut self.gyroscope_offset_rad_s);
        visitor.f32(&mut self.temperature_celsius);
        visitor.u8(&mut self.samples_to_temperature);
        self.thermal_drift.visit_state(visitor);
        self.monitor.visit_state(visitor);
        self.suspect.visit_state(visitor);
        visitor.u64(&mut self.sample.t_us);
        visitor.vector(&mut self.sample.angular_rate_rad_s);
        self.vibration.visit_state(visitor);
        self.estimator.visit_state(visitor);
        // A state in a flight log is that of a module, which has no late samples.
        #[cfg(not(feature = "firmware"))]
        {
            self.order = SampleOrder::new();
        }
        self.alignment = Alignment::new(&self.settings, self.gyroscope_offset_rad_s);
    }

    /// Applies the stored offset and its σ, before the filter's first sample.
    fn apply_stored_offset(&mut self) {
        let stored = StoredOffset::at(&self.settings.calibration, self.temperature_celsius);
        self.set_gyroscope_offset(stored.offset_rad_s);
        if stored.is_known() {
            let sigma_rad_s = stored.start_sigma_rad_s();
            self.kalman_mut().set_bias(Vector3::ZERO, sigma_rad_s);
        }
    }

    /// Compensates the temperature: applies the stored offset at the first sample, and moves it
    /// along the temperature model.
    #[inline]
    fn follow_temperature(&mut self, counts: TemperatureCounts) {
        self.temperature_celsius = counts.to_celsius(self.settings.part);
        match self.samples_to_temperature {
            0 => {
                self.samples_to_temperature = TEMPERATURE_SAMPLES;
                if self.settings.calibration.has_gyroscope_offset() {
                    // Before, the temperature was taken for that of the stored offset.
                    self.estimator.restart();
                    self.apply_stored_offset();
                }
            }
            1 => {
                self.samples_to_temperature = TEMPERATURE_SAMPLES;
                self.compensate_temperature();
            }
            _ => self.samples_to_temperature -= 1,
        }
    }

    /// Follows the temperature model within its range, while the register is credible. Otherwise
    /// the offset that has been removed stays. When the model is followed again, the estimated bias
    /// loses what is removed anew.
    #[inline(never)]
    fn compensate_temperature(&mut self) {
        let celsius = self.temperature_celsius;
        let dt_s = f32::from(TEMPERATURE_SAMPLES) / self.settings.sensor.sample_rate_hz();
        let model = &self.settings.calibration.temperature;
        let (offset_rad_s, weight) =
            (model.as_ref()).map_or((Vector3::ZERO, 0.0), |model| model.offset_at(celsius));
        let followed_before = self.thermal_drift.follows_model();
        let walk = self.thermal_drift.update(celsius, dt_s, weight >= 1.0);
        if self.thermal_drift.follows_model() {
            let before = self.alignment.gyroscope_offset_rad_s();
            self.set_gyroscope_offset(offset_rad_s);
            if !followed_before {
                let change = self.alignment.gyroscope_offset_rad_s() - before;
                self.kalman_mut().shift_bias(-change);
            }
        }
        self.kalman_mut().set_added_bias_walk(walk);
    }

    fn set_gyroscope_offset(&mut self, offset_rad_s: Vector3) {
        self.gyroscope_offset_rad_s = offset_rad_s;
        self.alignment.set_gyroscope_offset(offset_rad_s);
    }
}

/// Returns the flags of a sample's issues.
fn flags_of(issues: Issues) -> Flags {
    let mut flags = Flags::empty();
    flags.set(Flags::TIME, issues.contains(Issues::TIME_WENT_BACK));
    flags.set(Flags::GAP, issues.contains(Issues::GAP));
    flags.set(Flags::REJECTED, issues.contains(Issues::REJECTED));
    flags.set(Flags::FREE_FALL, issues.contains(Issues::NO_GRAVITY));
    flags
}
