//! Vibration that is too strong for a filter, found in the specific force of a recording.
//!
//! The measure is the root mean square of the force about its mean over 0.1 s, of all three axes
//! together, for a second. Motion changes little in 0.1 s, vibration goes through many periods. The
//! limit comes from the measured table in `docs/vibration.md`: above it the tilt can be wrong by a
//! degree and more, and the converters may clip ahead of the low-pass filter, where no flag can
//! show it.
//!
//! The library's flag `VIBRATION` has the same limit. To cost little, it takes 50 forces a second,
//! and needs a window of 0.2 s. This measurement takes every sample, at any rate, and also returns
//! the strength.

use aplomb_models::motion::Vector;
use aplomb_models::motion::geometry::{add, dot, scale};
use aplomb_models::motion::truth::STANDARD_GRAVITY_M_S2;

/// Full scale of the accelerometer in most recordings, g.
pub const FULL_SCALE_G: f64 = 16.0;
/// Strongest vibration that does not matter at that full scale, g root mean square of all axes
/// together. At another one it is the same share.
pub const LIMIT_G: f64 = 6.0;

/// Time over which the mean is taken, µs.
const WINDOW_US: i64 = 100_000;
/// Windows that one measurement takes.
const WINDOWS: u32 = 10;

/// Measurement of the vibration in a recording, sample by sample.
#[derive(Clone, Copy, Debug)]
pub struct Vibration {
    limit_g: f64,
    window: Window,
    first_us: Option<i64>,
    /// Squares about the means in m²/s⁴, samples and windows since the last measurement.
    squares: f64,
    samples: u32,
    windows: u32,
    /// Strongest second: its strength in g, and its end in s.
    strongest: Option<(f64, f64)>,
    /// Number of measurements above the limit.
    too_strong: u32,
}

/// Sums of one window.
#[derive(Clone, Copy, Debug, Default)]
struct Window {
    start_us: i64,
    samples: u32,
    sum: Vector,
    squares: f64,
}

impl Vibration {
    /// Creates a measurement for an accelerometer with this full scale, g.
    #[must_use]
    pub fn new(full_scale_g: f64) -> Self {
        Self {
            limit_g: LIMIT_G / FULL_SCALE_G * full_scale_g,
            window: Window::default(),
            first_us: None,
            squares: 0.0,
            samples: 0,
            windows: 0,
            strongest: None,
            too_strong: 0,
        }
    }

    /// Takes one sample of the specific force.
    pub fn add(&mut self, t_us: i64, force_m_s2: Vector) {
        let first_us = *self.first_us.get_or_insert(t_us);
        let since_us = t_us.saturating_sub(self.window.start_us);
        if self.window.samples > 0 && !(0..WINDOW_US).contains(&since_us) {
            self.close_window(t_us.saturating_sub(first_us) as f64 * 1e-6);
        }
        if self.window.samples == 0 {
            self.window.start_us = t_us;
        }
        self.window.samples += 1;
        self.window.sum = add(self.window.sum, force_m_s2);
        self.window.squares += dot(force_m_s2, force_m_s2);
    }

    /// Returns the vibration of the strongest second, g root mean square; `None` in a recording of
    /// less than a second.
    #[must_use]
    pub fn strongest_g(&self) -> Option<f64> {
        self.strongest.map(|(strength_g, _)| strength_g)
    }

    /// Returns a message if the vibration is too strong.
    #[must_use]
    pub fn message(&self) -> Option<String> {
        let (strongest_g, at_s) = self.strongest.filter(|_| self.too_strong > 0)?;
        Some(format!(
            "vibration too strong: {strongest_g:.1} g rms at {at_s:.1} s, above {} g for {} s. \
             The tilt can be wrong by degrees. Balance the rotors, or mount the sensor on \
             something soft",
            self.limit_g, self.too_strong
        ))
    }

    fn close_window(&mut self, now_s: f64) {
        let Window {
            samples,
            sum,
            squares,
            ..
        } = std::mem::take(&mut self.window);
        let of_mean = dot(sum, scale(sum, f64::from(samples).recip()));
        self.squares += (squares - of_mean).max(0.0);
        self.samples += samples;
        self.windows += 1;
        if self.windows < WINDOWS {
            return;
        }
        let strength_g = (self.squares / f64::from(self.samples)).sqrt() / STANDARD_GRAVITY_M_S2;
        (self.squares, self.samples, self.windows) = (0.0, 0, 0);
        self.too_strong += u32::from(strength_g > self.limit_g);
        if self
            .strongest
            .is_none_or(|(strongest_g, _)| strength_g > strongest_g)
        {
            self.strongest = Some((strength_g, now_s));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the measurement of ten seconds: a sine on one axis from 4 s to 7 s, on top of a
    /// swing of the gravity.
    fn measure(amplitude_g: f64, full_scale_g: f64, rate_hz: u32) -> Vibration {
        let hertz = 67.0;
        let mut vibration = Vibration::new(full_scale_g);
        for row in 0..10 * rate_hz {
            let time_s = f64::from(row) / f64::from(rate_hz);
            let tilt = libm::sin(3.0 * time_s);
            let shake = if (4.0..7.0).contains(&time_s) {
                amplitude_g * libm::sin(std::f64::consts::TAU * hertz * time_s)
            } else {
                0.0
            };
            let force_g = [libm::sin(tilt), shake, libm::cos(tilt)];
            let force_m_s2 = scale(force_g, STANDARD_GRAVITY_M_S2);
            vibration.add((time_s * 1e6) as i64 - 5_000_000, force_m_s2);
        }
        vibration
    }

    #[test]
    fn the_strength_is_that_of_the_vibration_alone() {
        for rate_hz in [200, 286, 1_000] {
            let still = measure(0.0, 16.0, rate_hz);
            assert!(still.strongest_g().unwrap() < 0.1, "{still:?}");
            assert_eq!(still.message(), None);
            let weak = measure(8.0, 16.0, rate_hz);
            let strength_g = weak.strongest_g().unwrap();
            assert!(
                (strength_g - 8.0 * 0.5_f64.sqrt()).abs() < 0.1,
                "{strength_g}"
            );
            assert_eq!(weak.message(), None);
            let message = measure(10.0, 16.0, rate_hz).message().unwrap();
            assert!(
                message.starts_with("vibration too strong: 7.1 g rms at "),
                "{message}"
            );
            assert!(message.contains("above 6 g for 3 s"), "{message}");
            let message = measure(1.2, 2.0, rate_hz).message().unwrap();
            assert!(message.contains("above 0.75 g for 3 s"), "{message}");
        }
    }

    #[test]
    fn a_clock_that_jumps_or_stops_does_no_harm() {
        let mut vibration = Vibration::new(FULL_SCALE_G);
        for t_us in [0, i64::MAX, i64::MIN, 5, 5, 5, -7, i64::MAX] {
            vibration.add(t_us, [1.0, 2.0, f64::NAN]);
        }
        assert_eq!(vibration.message(), None);
    }
}
