//! Wind: a constant mean and gusts.
//!
//! Each component of the gust is a first-order Gauss–Markov process with standard deviation σ
//! and correlation time L/V. Its spectrum has the shape of the Dryden model's longitudinal one
//! (MIL-F-8785C, section 3.7.2) at one fixed air speed.

use super::geometry::Vector;
use crate::random::Random;

/// Wind over the earth, in earth axes.
#[derive(Clone, Debug)]
pub struct Wind {
    mean_m_s: Vector,
    gust_sigma_m_s: f64,
    gust_time_s: f64,
    gust_m_s: Vector,
    decay: Decay,
    random: Random,
}

/// Change of a gust in one step of the time.
#[derive(Clone, Copy, Debug)]
struct Decay {
    step_s: f64,
    /// Factor of the gust before.
    kept: f64,
    /// Standard deviation of what is new, m/s.
    fresh_m_s: f64,
}

impl Wind {
    /// No wind.
    #[must_use]
    pub fn calm() -> Self {
        Self::new(0, [0.0; 3], 0.0, 1.0)
    }

    /// A mean in earth axes (m/s), and gusts of standard deviation `gust_sigma_m_s` and correlation
    /// time `gust_time_s`.
    #[must_use]
    pub fn new(seed: u64, mean_m_s: Vector, gust_sigma_m_s: f64, gust_time_s: f64) -> Self {
        let mut random = Random::new(seed, "gusts");
        let gust_m_s = [0; 3].map(|_| gust_sigma_m_s * random.normal());
        Self {
            mean_m_s,
            gust_sigma_m_s,
            gust_time_s,
            gust_m_s,
            decay: Decay {
                step_s: 0.0,
                kept: 1.0,
                fresh_m_s: 0.0,
            },
            random,
        }
    }

    /// A breeze of up to 5 m/s with gusts of up to 1.5 m/s.
    #[must_use]
    pub fn by_seed(seed: u64) -> Self {
        let mut random = Random::new(seed, "wind");
        let (speed, heading) = (
            random.uniform(0.0, 5.0),
            random.uniform(0.0, std::f64::consts::TAU),
        );
        let mean = [speed * libm::cos(heading), speed * libm::sin(heading), 0.0];
        let sigma = random.uniform(0.5, 1.5);
        // A length of 10 to 20 m at 5 m/s.
        Self::new(seed, mean, sigma, random.uniform(2.0, 4.0))
    }

    /// The wind now, m/s.
    #[must_use]
    pub fn velocity_m_s(&self) -> Vector {
        super::geometry::add(self.mean_m_s, self.gust_m_s)
    }

    /// Lets `step_s` seconds pass; the exact discretisation of the process.
    pub fn step(&mut self, step_s: f64) {
        if self.gust_sigma_m_s == 0.0 {
            return;
        }
        if self.decay.step_s != step_s {
            let kept = libm::exp(-step_s / self.gust_time_s);
            self.decay = Decay {
                step_s,
                kept,
                fresh_m_s: self.gust_sigma_m_s * (1.0 - kept * kept).sqrt(),
            };
        }
        for gust in &mut self.gust_m_s {
            *gust = self.decay.kept * *gust + self.decay.fresh_m_s * self.random.normal();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gusts_have_their_deviation_and_correlation_time() {
        let mut wind = Wind::new(1, [3.0, 0.0, 0.0], 1.5, 2.0);
        let step_s = 0.1;
        let values: Vec<f64> = (0..200_000)
            .map(|_| {
                wind.step(step_s);
                wind.velocity_m_s()[0]
            })
            .collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let covariance = |lag: usize| {
            let pairs = values.iter().zip(&values[lag..]);
            pairs.map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>() / (values.len() - lag) as f64
        };
        assert!((mean - 3.0).abs() < 0.1, "{mean}");
        assert!((covariance(0).sqrt() - 1.5).abs() < 0.05);
        // After one correlation time 1/e is left.
        assert!((covariance(20) / covariance(0) - (-1.0_f64).exp()).abs() < 0.05);
    }

    #[test]
    fn calm_is_calm() {
        let mut wind = Wind::calm();
        wind.step(1.0);
        assert_eq!(wind.velocity_m_s(), [0.0; 3]);
    }
}
