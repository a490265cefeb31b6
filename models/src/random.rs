//! Seeded random numbers: the one source of chance in the virtual world.
//!
//! Every use names its own stream, so that adding a draw in one place moves no draw in another. The
//! generator (PCG-64, multiplicative) and the elementary functions are portable: one seed gives the
//! same bits everywhere.

use rand_pcg::Pcg64Mcg;
use rand_pcg::rand_core::{Rng, SeedableRng};

/// A stream of random numbers.
#[derive(Clone, Debug)]
pub struct Random {
    generator: Pcg64Mcg,
    /// The polar method makes two normal deviates at once; this is the second.
    spare: Option<f64>,
}

impl Random {
    /// The stream named `stream` of the world seeded with `seed`.
    #[must_use]
    pub fn new(seed: u64, stream: &str) -> Self {
        Self {
            generator: Pcg64Mcg::seed_from_u64(seed ^ fnv_1a(stream)),
            spare: None,
        }
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.generator.next_u64()
    }

    /// Uniform in `[low, high)`.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        // The upper 53 bits fill a double's mantissa exactly.
        let unit = (self.bits() >> 11) as f64 / (1_u64 << 53) as f64;
        low + (high - low) * unit
    }

    /// −1 or 1.
    pub fn sign(&mut self) -> f64 {
        if self.uniform(0.0, 1.0) < 0.5 {
            -1.0
        } else {
            1.0
        }
    }

    /// Standard normal deviate, by Marsaglia's polar method (SIAM Review 6, 1964).
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        loop {
            let (x, y) = (self.uniform(-1.0, 1.0), self.uniform(-1.0, 1.0));
            let square = x * x + y * y;
            if square > 0.0 && square < 1.0 {
                let factor = (-2.0 * libm::log(square) / square).sqrt();
                self.spare = Some(y * factor);
                return x * factor;
            }
        }
    }

    /// Normal deviate of standard deviation `sigma`, drawn again until it lies within ±`bound`.
    ///
    /// This is how parts reach a customer: spread normally, and the ones beyond the tolerance
    /// discarded.
    pub fn within_tolerance(&mut self, sigma: f64, bound: f64) -> f64 {
        if sigma == 0.0 {
            return 0.0;
        }
        loop {
            let value = sigma * self.normal();
            if value.abs() <= bound {
                return value;
            }
        }
    }
}

/// The 64-bit FNV-1a hash, which turns a stream's name into bits.
fn fnv_1a(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_seed_and_name_give_one_stream() {
        let draw = |seed, name| {
            let mut random = Random::new(seed, name);
            (random.uniform(0.0, 1.0), random.normal(), random.normal())
        };
        assert_eq!(draw(1, "a"), draw(1, "a"));
        assert_ne!(draw(1, "a"), draw(2, "a"));
        assert_ne!(draw(1, "a"), draw(1, "b"));
    }

    #[test]
    fn the_normal_deviate_has_zero_mean_unit_variance_and_normal_tails() {
        let mut random = Random::new(7, "normal");
        let count = 200_000;
        let values: Vec<f64> = (0..count).map(|_| random.normal()).collect();
        let mean = values.iter().sum::<f64>() / f64::from(count);
        let variance = values.iter().map(|value| value * value).sum::<f64>() / f64::from(count);
        let beyond_two =
            values.iter().filter(|value| value.abs() > 2.0).count() as f64 / f64::from(count);
        assert!(mean.abs() < 0.01, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.01, "variance {variance}");
        assert!((beyond_two - 0.0455).abs() < 0.003, "tail {beyond_two}");
    }

    #[test]
    fn a_tolerance_is_never_exceeded() {
        let mut random = Random::new(3, "tolerance");
        let values: Vec<f64> = (0..10_000)
            .map(|_| random.within_tolerance(1.0, 1.5))
            .collect();
        assert!(values.iter().all(|value| value.abs() <= 1.5));
        assert!(values.iter().any(|value| value.abs() > 1.4));
        assert_eq!(random.within_tolerance(0.0, 1.0), 0.0);
    }
}
