//! The digital low-pass filter, with both of the datasheet's figures: the bandwidth (−3 dB) and
//! the delay.
//!
//! The datasheet gives no filter structure. Settings 1 to 4 fit a single pole of the stated
//! bandwidth behind about 1 ms of pure delay. At 10 and 5 Hz the stated delay is *shorter* than
//! that of such a pole. So:
//!
//! - where the delay is at least the pole's own, the filter is one pole and a pure delay for the
//!   rest;
//! - where it is shorter, the filter is two poles and a zero at half the bandwidth. They meet both
//!   figures with at most 0.8 dB of peaking. Up to a tenth of the bandwidth the delay is within a
//!   fifth of the stated one;
//! - a stated delay of zero (the accelerometer's setting 0) is impossible for a causal filter.
//!   There it is one pole, whose own delay at 260 Hz is 0.6 ms.
//!
//! "Delay" is the group delay at low frequencies. Both forms are made by the bilinear transform,
//! prewarped so that the bandwidth is exact on the 8 kHz grid.
//!
//! Derivation of the second, with Ω = tan(ωT/2), k = Ω at the bandwidth, x = Ω/k and
//! d = 2kτ/T: H = (1 + jZx) / (1 − a²x² + jbx). Delay d at x = 0 needs b = Z + d. Half power
//! at x = 1 needs (1 − a²)² = Z² − 2dZ + 2 − d².

use crate::motion::Vector;
use crate::motion::geometry::{add, interpolate, scale};

/// The datasheet's two figures for one filter setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Frequency at which the power is halved, Hz.
    pub bandwidth_hz: f64,
    /// Group delay at low frequencies, ms.
    pub delay_ms: f64,
}

/// Z: the bandwidth in units of the zero's frequency.
const ZERO_RATIO: f64 = 2.0;

/// A filter for the three axes of one sensor, fed once per internal tick.
#[derive(Clone, Debug)]
pub struct LowPass {
    section: Section,
    delay: Delay,
}

impl LowPass {
    /// A filter at rest at zero, for inputs every `tick_s` seconds.
    #[must_use]
    pub fn new(response: Response, tick_s: f64) -> Self {
        let k = libm::tan(std::f64::consts::PI * response.bandwidth_hz * tick_s);
        let delay_ticks = response.delay_ms * 1e-3 / tick_s;
        // The pole's own delay is 1/(2k) ticks.
        let remaining_ticks = delay_ticks - 0.5 / k;
        if remaining_ticks >= 0.0 || response.delay_ms == 0.0 {
            Self {
                section: Section::new([1.0, 1.0, 0.0], [1.0 + 1.0 / k, 1.0 - 1.0 / k, 0.0]),
                delay: Delay::new(remaining_ticks.max(0.0)),
            }
        } else {
            let z = ZERO_RATIO;
            let d = 2.0 * k * delay_ticks;
            let a_squared = 1.0 + (z * z - 2.0 * d * z + 2.0 - d * d).sqrt();
            let (first, second, lead) = ((z + d) / k, a_squared / (k * k), z / k);
            Self {
                section: Section::new(
                    [1.0 + lead, 2.0, 1.0 - lead],
                    [
                        1.0 + first + second,
                        2.0 - 2.0 * second,
                        1.0 - first + second,
                    ],
                ),
                delay: Delay::new(0.0),
            }
        }
    }

    /// Takes one input and gives the output at the same instant.
    pub fn update(&mut self, input: Vector) -> Vector {
        self.delay.update(self.section.update(input))
    }

    /// Puts the filter into the state it would have after `input` for ever.
    pub fn settle(&mut self, input: Vector) {
        self.section.settle(input);
        self.delay.inputs.fill(input);
    }
}

/// A second-order section, direct form II transposed.
#[derive(Clone, Debug)]
struct Section {
    numerator: [f64; 3],
    denominator: [f64; 2],
    state: [Vector; 2],
}

impl Section {
    fn new(numerator: [f64; 3], denominator: [f64; 3]) -> Self {
        let [leading, first, second] = denominator;
        Self {
            numerator: numerator.map(|coefficient| coefficient / leading),
            denominator: [first / leading, second / leading],
            state: [[0.0; 3]; 2],
        }
    }

    fn update(&mut self, input: Vector) -> Vector {
        let output = add(scale(input, self.numerator[0]), self.state[0]);
        self.state[0] = add(
            add(
                scale(input, self.numerator[1]),
                scale(output, -self.denominator[0]),
            ),
            self.state[1],
        );
        self.state[1] = add(
            scale(input, self.numerator[2]),
            scale(output, -self.denominator[1]),
        );
        output
    }

    fn settle(&mut self, input: Vector) {
        // With gain 1 at zero frequency the output is the input.
        self.state[1] = scale(input, self.numerator[2] - self.denominator[1]);
        self.state[0] = add(
            scale(input, self.numerator[1] - self.denominator[0]),
            self.state[1],
        );
    }
}

/// A delay of a whole and a fractional number of ticks; the fraction by a straight line between two
/// inputs.
#[derive(Clone, Debug)]
struct Delay {
    /// A ring; `newest` is the place of the last input.
    inputs: Vec<Vector>,
    newest: usize,
    fraction: f64,
}

impl Delay {
    fn new(ticks: f64) -> Self {
        let whole = ticks.floor();
        Self {
            inputs: vec![[0.0; 3]; whole as usize + 2],
            newest: 0,
            fraction: ticks - whole,
        }
    }

    fn update(&mut self, input: Vector) -> Vector {
        let length = self.inputs.len();
        let after = |index| if index + 1 == length { 0 } else { index + 1 };
        self.newest = after(self.newest);
        self.inputs[self.newest] = input;
        // The ring is just long enough: the oldest two inputs are the ones on either side of the
        // delay.
        let second = after(self.newest);
        let oldest = self.inputs[second];
        let next = self.inputs[after(second)];
        interpolate(next, oldest, self.fraction)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::identity::Identity;
    use std::f64::consts::TAU;

    const TICK_S: f64 = 1.0 / 8000.0;

    /// Gain and delay in seconds of the filter for a sine of `frequency_hz`, by correlation over
    /// whole periods.
    fn measure(response: Response, frequency_hz: f64) -> (f64, f64) {
        let mut filter = LowPass::new(response, TICK_S);
        let period = (1.0 / (frequency_hz * TICK_S)).round();
        let step = TAU / period;
        // Twenty time constants of the slowest pole die away first.
        let settling = (20.0 * ZERO_RATIO / (TAU * response.bandwidth_hz * TICK_S)) as usize + 4000;
        let start = settling.div_ceil(period as usize) * period as usize;
        let (mut sine, mut cosine) = (0.0, 0.0);
        for tick in 0..start + period as usize {
            let phase = tick as f64 * step;
            let output = filter.update([libm::sin(phase), 0.0, 0.0])[0];
            if tick >= start {
                sine += output * libm::sin(phase);
                cosine += output * libm::cos(phase);
            }
        }
        let gain = 2.0 / period * sine.hypot(cosine);
        (gain, -libm::atan2(cosine, sine) / step * TICK_S)
    }

    #[test]
    fn every_setting_has_the_datasheets_bandwidth_and_delay() {
        for who_am_i in [0x68, 0x70] {
            let identity = Identity::of(who_am_i);
            let filters = identity
                .gyroscope_filters
                .into_iter()
                .chain(identity.accelerometer_filters);
            for response in filters.filter(|response| response.bandwidth_hz < 1000.0) {
                // At an eightieth of the bandwidth the phase delay is the group delay at zero to
                // within 1 %.
                let (gain, delay_s) = measure(response, response.bandwidth_hz / 80.0);
                assert!((gain - 1.0).abs() < 0.03, "{response:?}: gain {gain}");
                // The one delay that no causal filter has: see the module's header.
                let expected_ms = if response.delay_ms == 0.0 {
                    0.61
                } else {
                    response.delay_ms
                };
                let tolerance_ms = 0.02 + 0.01 * expected_ms;
                assert!(
                    (delay_s * 1e3 - expected_ms).abs() < tolerance_ms,
                    "{response:?}: {delay_s} s"
                );
                let (half_power, _) = measure(response, response.bandwidth_hz);
                assert!(
                    (half_power - 0.5_f64.sqrt()).abs() < 0.02,
                    "{response:?}: {half_power}"
                );
            }
        }
    }

    #[test]
    fn the_response_is_flat_below_and_falls_above() {
        for response in Identity::of(0x68).gyroscope_filters {
            for share in [0.05, 0.1, 0.2, 0.4] {
                let (gain, _) = measure(response, response.bandwidth_hz * share);
                assert!(
                    (0.92..1.1).contains(&gain),
                    "{response:?} at {share}: {gain}"
                );
            }
            let (above, _) = measure(response, response.bandwidth_hz * 4.0);
            assert!(above < 0.3, "{response:?}: {above}");
        }
    }

    #[test]
    fn a_constant_passes_unchanged_on_every_axis() {
        let mut filter = LowPass::new(Identity::of(0x68).gyroscope_filters[1], TICK_S);
        let output = (0..8000).fold([0.0; 3], |_, _| filter.update([1.0, -2.0, 3.0]));
        for (value, expected) in output.iter().zip([1.0, -2.0, 3.0]) {
            assert!((value - expected).abs() < 1e-9);
        }
    }

    #[test]
    fn a_ramp_comes_out_late_by_the_delay() {
        let response = Identity::of(0x68).gyroscope_filters[1];
        let mut filter = LowPass::new(response, TICK_S);
        let mut output = 0.0;
        for tick in 0..8000 {
            output = filter.update([f64::from(tick) * TICK_S, 0.0, 0.0])[0];
        }
        let late_s = 7999.0 * TICK_S - output;
        assert!((late_s * 1e3 - response.delay_ms).abs() < 1e-6, "{late_s}");
    }
}
