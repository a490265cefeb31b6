//! Vibration that is too strong for the sensor. Its converters clip before the low-pass filter, so
//! no sample reads full scale.
//!
//! The measure is the root mean square of the specific force about its mean over 0.2 s, of all axes
//! together, for a second. Motion changes little in 0.2 s, vibration goes through many periods. The
//! limit comes from the measured table in `docs/vibration.md`.
//!
//! A force every 13 to 24 ms is enough: 50 a second at 1 kHz. The gap varies, because a fixed one
//! would show a vibration of that period as a constant.
//!
//! The measurement of a recording in `recordings/src/vibration.rs` has the same limit. It takes
//! every sample, so a window of 0.1 s is enough there. Here that would hold five forces only.

use super::flags::Flags;
use crate::attitude::Vector3;
use crate::serialize::StateVisitor;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Strongest vibration that does little harm, as a share of full scale: 6 of 16 g. Root mean square
/// of all axes together.
const LIMIT: f32 = 6.0 / 16.0;

/// Forces of a window: 0.2 s.
const WINDOW_FORCES: u8 = 10;
/// Windows of a measurement.
const WINDOWS: u8 = 5;

/// Measurement of the vibration, from about 50 forces a second.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Vibration {
    samples_to_force: u8,
    gap: u8,
    smallest_gap: u8,
    largest_gap: u8,
    forces: u8,
    windows: u8,
    /// [`Flags::VIBRATION`] or none.
    flags: Flags,
    /// Strongest vibration that does little harm, m²/s⁴.
    limit: f32,
    /// Sums over the window: force, m/s², and its square.
    sum: Vector3,
    squares: f32,
    /// Sum of the squares about the means of the windows so far, m²/s⁴.
    deviations: f32,
}

impl Vibration {
    /// Creates a measurement for samples at this rate (Hz) of a sensor with this full scale (g).
    pub fn new(sample_rate_hz: f32, full_scale_g: u16) -> Self {
        let gap = |seconds: f32| ((sample_rate_hz * seconds) as u8).max(1);
        let smallest_gap = gap(0.013);
        let limit_m_s2 = LIMIT * f32::from(full_scale_g) * STANDARD_GRAVITY_M_S2;
        Self {
            samples_to_force: 1,
            gap: smallest_gap,
            smallest_gap,
            largest_gap: gap(0.024),
            forces: 0,
            windows: 0,
            flags: Flags::empty(),
            limit: limit_m_s2 * limit_m_s2,
            sum: Vector3::ZERO,
            squares: 0.0,
            deviations: 0.0,
        }
    }

    /// Takes a sample's specific force, m/s². Returns [`Flags::VIBRATION`] if the vibration of the
    /// last whole second was too strong.
    #[inline(always)]
    pub fn update(&mut self, force_m_s2: &Vector3) -> Flags {
        self.samples_to_force = self.samples_to_force.wrapping_sub(1);
        if self.samples_to_force == 0 {
            self.add(*force_m_s2);
        }
        self.flags
    }

    #[cold]
    #[inline(never)]
    fn add(&mut self, force_m_s2: Vector3) {
        self.gap = if self.gap < self.largest_gap {
            self.gap + 1
        } else {
            self.smallest_gap
        };
        self.samples_to_force = self.gap;
        self.sum = self.sum + force_m_s2;
        self.squares += force_m_s2.dot(force_m_s2);
        self.forces = self.forces.wrapping_add(1);
        if self.forces >= WINDOW_FORCES {
            self.close_window();
        }
    }

    fn close_window(&mut self) {
        const SHARE: f32 = 1.0 / WINDOW_FORCES as f32;
        const DEGREES_OF_FREEDOM: f32 = (WINDOW_FORCES as f32 - 1.0) * WINDOWS as f32;
        self.deviations += self.squares - SHARE * self.sum.dot(self.sum);
        self.forces = 0;
        self.sum = Vector3::ZERO;
        self.squares = 0.0;
        self.windows = self.windows.wrapping_add(1);
        if self.windows >= WINDOWS {
            self.windows = 0;
            let is_too_strong = self.deviations > DEGREES_OF_FREEDOM * self.limit;
            self.flags.set(Flags::VIBRATION, is_too_strong);
            self.deviations = 0.0;
        }
    }

    /// Visits every field.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.u8(&mut self.samples_to_force);
        visitor.u8(&mut self.gap);
        visitor.u8(&mut self.smallest_gap);
        visitor.u8(&mut self.largest_gap);
        visitor.u8(&mut self.forces);
        visitor.u8(&mut self.windows);
        let mut is_too_strong = !self.flags.is_empty();
        visitor.bool(&mut is_too_strong);
        self.flags.set(Flags::VIBRATION, is_too_strong);
        visitor.f32(&mut self.limit);
        visitor.vector(&mut self.sum);
        visitor.f32(&mut self.squares);
        visitor.f32(&mut self.deviations);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the seconds that were too strong, of ten: a sine on one axis from 3.1 s to 6.9 s, on
    /// top of a swing of gravity. `rms_g` is its root mean square.
    fn seconds_too_strong(rms_g: f32, hertz: f32, rate_hz: u16, full_scale_g: u16) -> f32 {
        let mut vibration = Vibration::new(f32::from(rate_hz), full_scale_g);
        let mut samples = 0_u16;
        for index in 0..10 * rate_hz {
            let time_s = f32::from(index) / f32::from(rate_hz);
            let tilt_rad = libm::sinf(3.0 * time_s);
            let shake_g = if (3.1..6.9).contains(&time_s) {
                core::f32::consts::SQRT_2
                    * rms_g
                    * libm::sinf(core::f32::consts::TAU * hertz * time_s)
            } else {
                0.0
            };
            let force_g = Vector3::new(libm::sinf(tilt_rad), shake_g, -libm::cosf(tilt_rad));
            let flags = vibration.update(&force_g.scale(STANDARD_GRAVITY_M_S2));
            samples += u16::from(flags == Flags::VIBRATION);
        }
        f32::from(samples) / f32::from(rate_hz)
    }

    #[test]
    fn vibration_above_the_limit_is_flagged_at_each_frequency() {
        for rate_hz in [200, 286, 500, 1_000] {
            // 143 Hz has the period of seven samples at 1 kHz, and half the rate of 286 Hz.
            for hertz in [37.0, 67.0, 81.0, 143.0, 221.0] {
                if 2.0 * hertz == f32::from(rate_hz) {
                    continue;
                }
                let weak = seconds_too_strong(5.0, hertz, rate_hz, 16);
                assert!(weak == 0.0, "{hertz} Hz at {rate_hz}: {weak}");
                let strong = seconds_too_strong(8.0, hertz, rate_hz, 16);
                assert!(
                    strong > 0.7 && strong < 5.0,
                    "{hertz} Hz at {rate_hz}: {strong}"
                );
            }
        }
    }

    #[test]
    fn a_smaller_full_scale_has_a_lower_limit() {
        assert_eq!(seconds_too_strong(0.6, 67.0, 1_000, 2), 0.0);
        assert!(seconds_too_strong(1.0, 67.0, 1_000, 2) > 0.7);
    }

    #[test]
    fn a_force_that_is_no_number_does_not_last() {
        let mut vibration = Vibration::new(1_000.0, 16);
        vibration.update(&Vector3::new(f32::NAN, 0.0, 0.0));
        for _ in 0..3_000 {
            let flags = vibration.update(&Vector3::new(0.0, 0.0, -9.81));
            assert!(flags.is_empty());
        }
    }
}
