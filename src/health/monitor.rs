//! Checks the bytes of each sample, and decides whether its attitude is valid.

use super::flags::Flags;
use super::monitored_sensor::MonitoredSensor;
use super::stuck_axis::StuckAxis;
use crate::serialize::StateVisitor;
use crate::units::radians;

/// σ of the tilt above which an attitude is degraded, in rad.
pub const DEGRADED_TILT_RAD: f32 = radians(5.0);

/// σ of the tilt above which an attitude is not valid, in rad: six σ are half a turn.
pub const LOST_TILT_RAD: f32 = radians(30.0);

/// Rated range of the die temperature, °C (product specification §6.2).
const COLDEST_CELSIUS: f32 = -40.0;
const HOTTEST_CELSIUS: f32 = 85.0;

/// Time of identical samples that means [`Flags::FROZEN`], for a low-pass filter of 98 Hz and more,
/// s.
///
/// With that bandwidth, a repetition of all six axes after 11 ms of noise (product specification
/// §6.1 and §6.2) has a probability below one in 10,000. 22 ms hold two such intervals.
const FROZEN_S: f32 = 0.022;
/// Time of identical samples for narrower low-pass filters, s: successive samples often repeat.
const FROZEN_NARROW_S: f32 = 0.099;
/// Fewest identical samples of that time, where samples are rare: a board may read one twice.
const FEWEST_FROZEN: u8 = 5;

/// Monitor of the samples: sets the flags of an attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Monitor {
    last: Fingerprint,
    repetitions: u8,
    frozen_samples: u8,
    stuck_axis: StuckAxis,
    coldest_counts: i16,
    hottest_counts: i16,
    was_still: bool,
    awaits_scale_check: bool,
}

impl Monitor {
    /// Creates a monitor for this sensor.
    pub fn new(sensor: &MonitoredSensor) -> Self {
        let frozen_s = if sensor.bandwidth_hz >= 98 {
            FROZEN_S
        } else {
            FROZEN_NARROW_S
        };
        let counts =
            |celsius: f32| ((celsius - sensor.celsius_at_zero) / sensor.celsius_per_count) as i16;
        Self {
            last: Fingerprint::default(),
            repetitions: 0,
            frozen_samples: ((frozen_s * sensor.sample_rate_hz) as u8).max(FEWEST_FROZEN),
            stuck_axis: StuckAxis::new(sensor),
            coldest_counts: counts(COLDEST_CELSIUS),
            hottest_counts: counts(HOTTEST_CELSIUS),
            was_still: false,
            awaits_scale_check: false,
        }
    }

    /// Returns the number of identical samples in a row after which they are flagged as frozen.
    pub const fn frozen_samples(&self) -> u8 {
        self.frozen_samples
    }

    /// Checks a sample's 14 bytes and its temperature: [`Flags::REJECTED`], [`Flags::FROZEN`],
    /// [`Flags::TEMPERATURE`].
    #[inline]
    pub fn inspect(&mut self, bytes: &[u8; 14], temperature_counts: i16) -> Flags {
        let mut flags = Flags::empty();
        let (fingerprint, is_blank) = Fingerprint::of(bytes);
        if fingerprint == self.last {
            self.repetitions = self.repetitions.saturating_add(1);
            flags.set(Flags::FROZEN, self.repetitions >= self.frozen_samples);
        } else {
            self.last = fingerprint;
            self.repetitions = 0;
            self.stuck_axis.update(bytes);
        }
        flags.set(Flags::REJECTED, is_blank);
        if self.has_stuck_axis() {
            flags |= Flags::FROZEN;
        }
        let range = self.coldest_counts..=self.hottest_counts;
        flags.set(Flags::TEMPERATURE, !range.contains(&temperature_counts));
        flags
    }

    /// Returns whether one axis is frozen, and not the whole sample.
    pub(crate) const fn has_stuck_axis(&self) -> bool {
        self.stuck_axis.is_stuck()
    }

    /// Returns [`Flags::CALIBRATING`], and [`Flags::MOVED`] when the sensor begins to move. Call it
    /// with each sample while the gyroscope's offset is unknown.
    #[inline]
    pub fn update_calibration(&mut self, is_still: bool) -> Flags {
        let mut flags = Flags::CALIBRATING;
        flags.set(Flags::MOVED, self.was_still && !is_still);
        self.was_still = is_still;
        flags
    }

    /// Requires the sensor's full scales to be read back: the rate has jumped as if they had
    /// changed. Until [`confirm_scales`](Self::confirm_scales), each attitude is degraded, and none
    /// is valid.
    pub const fn require_scale_check(&mut self) {
        self.awaits_scale_check = true;
    }

    /// Returns whether the full scales have to be read back.
    pub const fn awaits_scale_check(&self) -> bool {
        self.awaits_scale_check
    }

    /// Confirms that the full scales have been read back, and are right.
    pub const fn confirm_scales(&mut self) {
        self.awaits_scale_check = false;
    }

    /// Restarts the calibration phase, and forgets its motion.
    pub const fn restart(&mut self) {
        self.was_still = false;
    }

    /// Adds [`Flags::VALID`] and [`Flags::DEGRADED`] to the flags of an attitude with this tilt
    /// variance, in rad². One of the two is always set.
    #[inline]
    pub fn judge(&self, mut flags: Flags, tilt_variance_rad2: f32) -> Flags {
        let is_certain = tilt_variance_rad2 <= DEGRADED_TILT_RAD * DEGRADED_TILT_RAD;
        if !is_certain || self.awaits_scale_check || flags.intersects(Flags::DEGRADING) {
            flags |= Flags::DEGRADED;
        }
        let is_known = tilt_variance_rad2 < LOST_TILT_RAD * LOST_TILT_RAD;
        if is_known && !self.awaits_scale_check && !flags.intersects(Flags::INVALIDATING) {
            flags |= Flags::VALID;
        }
        flags
    }

    /// Visits every field.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.u64(&mut self.last.accelerometer);
        visitor.u64(&mut self.last.gyroscope);
        visitor.u8(&mut self.repetitions);
        visitor.u8(&mut self.frozen_samples);
        self.stuck_axis.visit_state(visitor);
        visitor.i16(&mut self.coldest_counts);
        visitor.i16(&mut self.hottest_counts);
        visitor.bool(&mut self.was_still);
        visitor.bool(&mut self.awaits_scale_check);
    }
}

/// The six axes of a sample as two numbers. Without the temperature, which may change while a hung
/// converter repeats the axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
struct Fingerprint {
    accelerometer: u64,
    gyroscope: u64,
}

impl Fingerprint {
    /// Returns the axes, and whether accelerometer and temperature are blank: all zeros or all
    /// ones. Noise excludes both, so the bus or the sensor is dead.
    #[inline]
    fn of(bytes: &[u8; 14]) -> (Self, bool) {
        let [first @ .., _, _, _, _, _, _] = bytes;
        let [_, _, _, _, _, _, last @ ..] = bytes;
        let (first, last) = (u64::from_le_bytes(*first), u64::from_le_bytes(*last));
        let axes = Self {
            accelerometer: first & 0xFFFF_FFFF_FFFF,
            gyroscope: last >> 16,
        };
        (axes, first == 0 || first == u64::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn monitor(bandwidth_hz: u16) -> Monitor {
        Monitor::new(&MonitoredSensor {
            bandwidth_hz,
            ..MonitoredSensor::MPU_6050
        })
    }

    #[test]
    fn data_are_frozen_after_repetitions_until_the_first_change() {
        for (bandwidth_hz, limit) in [(188, 22), (98, 22), (42, 99)] {
            let mut monitor = monitor(bandwidth_hz);
            let mut bytes = [7; 14];
            for _ in 0..300 {
                bytes[13] ^= 1;
                assert!(monitor.inspect(&bytes, 0).is_empty());
            }
            for repetition in 1..=1000 {
                let is_frozen = monitor.inspect(&bytes, 0).contains(Flags::FROZEN);
                assert_eq!(is_frozen, repetition >= limit, "{repetition}");
            }
            bytes[0] ^= 1;
            assert!(monitor.inspect(&bytes, 0).is_empty());
        }
    }

    #[test]
    fn axes_that_repeat_beside_a_live_temperature_are_frozen() {
        for (bandwidth_hz, limit) in [(188, 22), (42, 99)] {
            let mut monitor = monitor(bandwidth_hz);
            let mut bytes = [7; 14];
            monitor.inspect(&bytes, 0);
            for repetition in 1..=300 {
                bytes[7] ^= 1;
                let is_frozen = monitor.inspect(&bytes, 0).contains(Flags::FROZEN);
                assert_eq!(is_frozen, repetition >= limit, "{repetition}");
            }
        }
    }

    #[test]
    fn data_are_frozen_after_the_same_time_at_any_rate() {
        for (rate_hz, bandwidth_hz, limit) in [
            (500.0, 188, 11),
            (200.0, 98, 5),
            (100.0, 98, 5),
            (100.0, 42, 9),
            (10.0, 42, 5),
        ] {
            let mut monitor = Monitor::new(&MonitoredSensor {
                sample_rate_hz: rate_hz,
                bandwidth_hz,
                ..MonitoredSensor::MPU_6050
            });
            monitor.inspect(&[7; 14], 0);
            for repetition in 1..=20 {
                let is_frozen = monitor.inspect(&[7; 14], 0).contains(Flags::FROZEN);
                assert_eq!(is_frozen, repetition >= limit, "{rate_hz}: {repetition}");
            }
        }
    }

    #[test]
    fn all_zeros_and_all_ones_are_rejected() {
        let is_rejected = |bytes| monitor(98).inspect(&bytes, 0).contains(Flags::REJECTED);
        assert!(is_rejected([0; 14]) && is_rejected([0xFF; 14]));
        // A burst of a sensor in free fall, at rest about every axis, at 36.53 °C: one count of
        // noise.
        for place in 0..8 {
            let mut bytes = [0; 14];
            bytes[place] = 1;
            assert!(!is_rejected(bytes), "{place}");
        }
        assert!(!is_rejected([0x55; 14]));
    }

    #[test]
    fn temperatures_outside_the_rated_range_are_flagged() {
        let is_extreme = |counts| {
            let flags = monitor(98).inspect(&[7; 14], counts);
            flags.contains(Flags::TEMPERATURE)
        };
        assert!(is_extreme(-26_021) && !is_extreme(-26_020));
        assert!(!is_extreme(16_479) && is_extreme(16_480));
    }

    #[test]
    fn sigma_determines_valid_and_degraded() {
        let monitor = monitor(98);
        let judged = |flags, sigma_deg| {
            let sigma = radians(sigma_deg);
            monitor.judge(flags, sigma * sigma)
        };
        assert_eq!(judged(Flags::empty(), 1.0), Flags::VALID);
        assert_eq!(judged(Flags::empty(), 6.0), Flags::VALID | Flags::DEGRADED);
        assert_eq!(judged(Flags::empty(), 31.0), Flags::DEGRADED);
        assert_eq!(judged(Flags::empty(), f32::INFINITY), Flags::DEGRADED);
        let polled = Flags::POLLED | Flags::DEGRADED | Flags::VALID;
        assert_eq!(judged(Flags::POLLED, 1.0), polled);
        assert_eq!(judged(Flags::TIME, 1.0), Flags::TIME | Flags::DEGRADED);
        assert_eq!(judged(Flags::empty(), f32::NAN), Flags::DEGRADED);
    }

    #[test]
    fn a_jump_of_the_rate_is_not_valid_until_the_scales_are_confirmed() {
        let mut monitor = monitor(98);
        monitor.require_scale_check();
        assert_eq!(monitor.judge(Flags::empty(), 0.0), Flags::DEGRADED);
        monitor.confirm_scales();
        assert_eq!(monitor.judge(Flags::empty(), 0.0), Flags::VALID);
    }

    #[test]
    fn motion_is_flagged_when_it_begins() {
        let mut monitor = monitor(98);
        let moved = [false, true, false, false, true, false]
            .map(|is_still| monitor.update_calibration(is_still).contains(Flags::MOVED));
        assert_eq!(moved, [false, false, true, false, false, true]);
    }
}
