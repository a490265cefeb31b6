//! Vibration of the sensor's place on a vehicle, on top of any motion.
//!
//! The place shakes along all three axes, and rocks about them, at the frequency of a rotor and its
//! harmonics. The frequency wanders slowly. All axes have the same strength, and phases of their
//! own. Attitude, rates and specific force agree at every instant:
//!
//! - `q = q₀ ⊗ exp(θ)`, with the rocking angle θ;
//! - `ω = exp(−θ)·ω₀ + J(θ)·θ'`, with the right Jacobian J of SO(3);
//! - `f = exp(−θ)·(f₀ + a)`, with the shaking acceleration a in axes of the unshaken vehicle.
//!
//! The mean of a is zero there, so the vehicle flies as before. Force and rocking are correlated,
//! so what a sensor's filter takes from them leaves coning and sculling errors.

use std::f64::consts::{SQRT_2, TAU};

use super::geometry::{Quaternion, Vector, add, cross, norm, scale};
use super::{Motion, Truth};
use crate::random::Random;

/// Amplitudes of the fundamental and its harmonics. The fourth harmonic of 250 Hz is at 1 kHz,
/// where sampling at 1 kHz turns it into a slowly changing force.
const AMPLITUDES: [f64; 4] = [1.0, 0.5, 0.25, 0.125];

/// Share by which the frequency wanders to both sides.
const WANDER: f64 = 0.02;
/// Frequency of the wandering, Hz.
const WANDER_HZ: f64 = 0.3;

/// Strength and frequency of a vibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strength {
    /// Specific force of each axis, root mean square, m/s².
    pub force_rms_m_s2: f64,
    /// Mean frequency of the fundamental, Hz.
    pub frequency_hz: f64,
    /// Lever between the force and the axis of the rocking, m: the angular acceleration of each
    /// axis is that of the force over this length.
    pub lever_m: f64,
    /// Start, s.
    pub start_s: f64,
    /// Time in which the vibration grows from nothing, s.
    pub growth_s: f64,
}

/// A motion with vibration.
pub struct Vibrating<M> {
    motion: M,
    strength: Strength,
    wander_phase: f64,
    force_phases: [[Angle; AMPLITUDES.len()]; 3],
    rocking_phases: [[Angle; AMPLITUDES.len()]; 3],
}

/// Sine and cosine of an angle. Those of a sum of angles need no further sine.
#[derive(Clone, Copy)]
struct Angle {
    sine: f64,
    cosine: f64,
}

impl Angle {
    fn from_rad(angle_rad: f64) -> Self {
        let (sine, cosine) = libm::sincos(angle_rad);
        Self { sine, cosine }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            sine: self.sine * other.cosine + self.cosine * other.sine,
            cosine: self.cosine * other.cosine - self.sine * other.sine,
        }
    }
}

/// The vibration at one instant, in the axes of the unshaken vehicle.
struct Shake {
    force_m_s2: Vector,
    angle_rad: Vector,
    angle_rate_rad_s: Vector,
}

impl<M: Motion> Vibrating<M> {
    /// Adds a vibration to a motion. The seed decides the phases.
    #[must_use]
    pub fn new(motion: M, strength: Strength, seed: u64) -> Self {
        let mut random = Random::new(seed, "vibration");
        let mut phases = || {
            [[(); AMPLITUDES.len()]; 3]
                .map(|axis| axis.map(|()| Angle::from_rad(random.uniform(0.0, TAU))))
        };
        Self {
            motion,
            strength,
            force_phases: phases(),
            rocking_phases: phases(),
            wander_phase: random.uniform(0.0, TAU),
        }
    }

    fn shake(&self, time_s: f64) -> Shake {
        let strength = &self.strength;
        let since_s = time_s - strength.start_s;
        let growth = (since_s / strength.growth_s).clamp(0.0, 1.0);
        let growth_per_s = if (0.0..strength.growth_s).contains(&since_s) {
            1.0 / strength.growth_s
        } else {
            0.0
        };
        // The phase is the integral of the wandering frequency.
        let wander = TAU * WANDER_HZ * time_s + self.wander_phase;
        let carrier = TAU * strength.frequency_hz;
        let phase = carrier * (time_s - WANDER / (TAU * WANDER_HZ) * libm::cos(wander));
        let phase_per_s = carrier * (1.0 + WANDER * libm::sin(wander));
        let squares: f64 = AMPLITUDES.iter().map(|share| share * share).sum();
        let unit = strength.force_rms_m_s2 * SQRT_2 / squares.sqrt();
        let mut shake = Shake {
            force_m_s2: [0.0; 3],
            angle_rad: [0.0; 3],
            angle_rate_rad_s: [0.0; 3],
        };
        let fundamental = Angle::from_rad(phase);
        let mut of_harmonic = fundamental;
        for (index, share) in AMPLITUDES.iter().enumerate() {
            let harmonic = (index + 1) as f64;
            let frequency = harmonic * carrier;
            let angle = unit * share / (strength.lever_m * frequency * frequency);
            for axis in 0..3 {
                let force = of_harmonic.plus(self.force_phases[axis][index]);
                shake.force_m_s2[axis] += growth * unit * share * force.sine;
                let rocking = of_harmonic.plus(self.rocking_phases[axis][index]);
                shake.angle_rad[axis] += growth * angle * rocking.sine;
                shake.angle_rate_rad_s[axis] +=
                    growth * angle * harmonic * phase_per_s * rocking.cosine
                        + growth_per_s * angle * rocking.sine;
            }
            of_harmonic = of_harmonic.plus(fundamental);
        }
        shake
    }
}

impl<M: Motion> Motion for Vibrating<M> {
    fn at(&mut self, time_s: f64) -> Truth {
        let truth = self.motion.at(time_s);
        if time_s <= self.strength.start_s {
            return truth;
        }
        let shake = self.shake(time_s);
        let rocking = Quaternion::from_rotation_vector(shake.angle_rad);
        let unshaken = rocking.conjugate();
        let rates = jacobian(shake.angle_rad, shake.angle_rate_rad_s);
        Truth {
            specific_force_m_s2: unshaken.rotate(add(truth.specific_force_m_s2, shake.force_m_s2)),
            body_rates_rad_s: add(unshaken.rotate(truth.body_rates_rad_s), rates),
            attitude: truth.attitude.map(|attitude| attitude.multiply(rocking)),
            ..truth
        }
    }
}

/// Returns J(θ)·θ', the body rates of exp(θ), with the right Jacobian of SO(3)
/// (Chirikjian, *Stochastic Models, Information Theory, and Lie Groups*, vol. 2, 2012).
fn jacobian(angle: Vector, angle_rate: Vector) -> Vector {
    let length = norm(angle);
    let (first, second) = if length < 1e-4 {
        (0.5, 1.0 / 6.0)
    } else {
        let square = length * length;
        (
            (1.0 - libm::cos(length)) / square,
            (length - libm::sin(length)) / (square * length),
        )
    };
    let once = cross(angle, angle_rate);
    let twice = cross(angle, once);
    add(angle_rate, add(scale(once, -first), scale(twice, second)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::geometry::subtract;
    use crate::motion::rest::Rest;
    use crate::motion::swing::Swing;

    const STRENGTH: Strength = Strength {
        force_rms_m_s2: 20.0,
        frequency_hz: 80.0,
        lever_m: 0.1,
        start_s: 1.0,
        growth_s: 0.5,
    };

    #[test]
    fn the_rates_are_those_of_the_attitude() {
        for seed in 0..5 {
            let motion = Swing::by_seed(seed, 0.5);
            let mut shaken = Vibrating::new(motion, STRENGTH, seed);
            for step in 0..2_000 {
                let time_s = 1.001 + f64::from(step) * 0.0011;
                let [before, middle, after] = [-1e-6, 0.0, 1e-6].map(|by| shaken.at(time_s + by));
                let [before, after] = [before, after].map(|truth| truth.attitude.unwrap());
                let turn = before.conjugate().multiply(after).to_rotation_vector();
                let difference = subtract(scale(turn, 0.5e6), middle.body_rates_rad_s);
                assert!(norm(difference) < 1e-4, "{seed} {time_s}: {difference:?}");
            }
        }
    }

    #[test]
    fn the_force_has_its_strength_on_every_axis_and_no_mean_in_the_vehicles_axes() {
        let mut shaken = Vibrating::new(Rest::level(), STRENGTH, 3);
        assert_eq!(shaken.at(1.0), Rest::level().at(1.0));
        let gravity = Rest::level().at(0.0).specific_force_m_s2;
        let (mut sum, mut squares, mut count) = ([0.0; 3], [0.0; 3], 0.0);
        for step in 0..80_000 {
            let truth = shaken.at(2.0 + f64::from(step) * 1.25e-4);
            let force = truth.attitude.unwrap().rotate(truth.specific_force_m_s2);
            let shake = subtract(force, gravity);
            sum = add(sum, shake);
            squares = add(squares, shake.map(|part| part * part));
            count += 1.0;
        }
        for axis in 0..3 {
            assert!((sum[axis] / count).abs() < 0.02, "{sum:?}");
            let rms = (squares[axis] / count).sqrt();
            assert!((rms - STRENGTH.force_rms_m_s2).abs() < 0.2, "{rms}");
        }
    }

    /// A filter that integrates samples at 1 kHz must see the slow force of the fourth harmonic.
    #[test]
    fn sampling_at_1_khz_makes_a_slow_force_of_the_fourth_harmonic_of_250_hz() {
        let slow = |frequency_hz| {
            let strength = Strength {
                frequency_hz,
                ..STRENGTH
            };
            let mut shaken = Vibrating::new(Rest::level(), strength, 1);
            let window = 100;
            let mut largest = 0.0_f64;
            for start in 0..200 {
                let mean: f64 = (0..window)
                    .map(|step| {
                        let time_s = 2.0 + f64::from(start * window + step) * 1e-3;
                        shaken.at(time_s).specific_force_m_s2[0] / f64::from(window)
                    })
                    .sum();
                largest = largest.max(mean.abs());
            }
            largest
        };
        let (aliased, clean) = (slow(250.0), slow(110.0));
        assert!(aliased > 2.0 && clean < 1.0, "{aliased} {clean}");
    }
}
