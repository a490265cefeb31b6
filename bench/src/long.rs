//! Long simulated flights through the whole pipeline, in memory: the attitude must stay right.

use std::fmt::Write as _;

use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{Burst, Part};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::motion::geometry::angle_between;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::truth;
use aplomb_recordings::attitude;
use aplomb_recordings::simulated::samples;

use crate::parallel;

const HOUR_S: u64 = 3_600;
/// Start of a flight that does not count, µs.
const START_US: u64 = 60_000_000;

/// Scores of one part of a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    rows: u64,
    squares_deg2: f64,
    /// Largest inclination error, degrees.
    pub maximum_deg: f64,
    valid: u64,
    within_3_sigma: u64,
    /// Rows that are `VALID` although the error exceeds the larger of 5° and six σ.
    pub violations: u64,
}

impl Score {
    /// Returns the root mean square of the inclination error, degrees.
    pub fn rms_deg(&self) -> f64 {
        (self.squares_deg2 / self.rows as f64).sqrt()
    }

    /// Returns the share of rows that are `VALID`.
    pub fn valid_share(&self) -> f64 {
        self.valid as f64 / self.rows as f64
    }

    /// Returns the share of rows with an error of at most 3 σ.
    pub fn within_3_sigma(&self) -> f64 {
        self.within_3_sigma as f64 / self.rows as f64
    }

    fn add(&mut self, error_rad: f64, sigma_rad: f64, flags: Flags) {
        let error_deg = error_rad.to_degrees();
        self.rows += 1;
        self.squares_deg2 += error_deg * error_deg;
        self.maximum_deg = self.maximum_deg.max(error_deg);
        self.within_3_sigma += u64::from(error_rad <= 3.0 * sigma_rad);
        if flags.contains(Flags::VALID) {
            self.valid += 1;
            let limit_rad = (6.0 * sigma_rad).max(5_f64.to_radians());
            self.violations += u64::from(error_rad > limit_rad);
        }
    }
}

/// Flies the flight of this seed, and scores each part of `part_s` seconds.
pub fn fly(seed: u64, seconds: u64, part_s: u64) -> Vec<Score> {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let parts = seconds.div_ceil(part_s) as usize;
    let mut scores = vec![Score::default(); parts];
    for simulated in samples(Box::new(Quadrotor::by_seed(seed)), seed, seconds) {
        let burst = Burst {
            bytes: simulated.raw.encode(),
            captured_at_us: simulated.t_us,
            missed_before: 0,
        };
        let snapshot = pipeline.update(&burst, BoardFlags::SCALES_VERIFIED);
        let motion = simulated.truth;
        let Some(true_attitude) = motion.attitude.filter(|_| motion.scored) else {
            continue;
        };
        if simulated.t_us < START_US {
            continue;
        }
        let up = attitude::up_in_body(snapshot.attitude);
        let up = [up.x, up.y, up.z].map(f64::from);
        let error_rad = angle_between(up, truth::up_in_body(true_attitude));
        let part = (simulated.t_us / (part_s * 1_000_000)) as usize;
        if let Some(score) = scores.get_mut(part) {
            score.add(error_rad, snapshot.tilt_sigma_rad().into(), snapshot.flags);
        }
    }
    scores
}

/// Flies the flights of these seeds, and returns a table with a row for each hour of each.
pub fn table(seeds: &[u64], seconds: u64) -> String {
    let flights = parallel::map_with_bar("flying", seeds, |seed| fly(*seed, seconds, HOUR_S));
    let mut text = "| seed | hour | rms | largest | `VALID` | within 3 σ | wrong while `VALID` |\n\
                    |---|---|---|---|---|---|---|\n"
        .to_owned();
    for (seed, scores) in seeds.iter().zip(flights) {
        for (hour, score) in scores.iter().enumerate() {
            let _ = writeln!(
                text,
                "| {seed} | {} | {:.2}° | {:.2}° | {:.3} % | {:.2} % | {} |",
                hour + 1,
                score.rms_deg(),
                score.maximum_deg,
                100.0 * score.valid_share(),
                100.0 * score.within_3_sigma(),
                score.violations
            );
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The short form of `--long`. Without a memory of the parameters the error of a flight doubles
    /// within an hour and a half, and then the filter restarts.
    #[test]
    fn an_hour_of_flight_stays_as_good_as_its_beginning() {
        const QUARTER_S: u64 = HOUR_S / 4;
        // Seeds that nothing was tuned on.
        let seeds = [5_001, 5_002];
        let flights = parallel::map(&seeds, |seed| fly(*seed, HOUR_S, QUARTER_S));
        for (seed, quarters) in seeds.iter().zip(flights) {
            for quarter in &quarters {
                assert!(quarter.valid_share() >= 0.9999, "{seed}: {quarters:?}");
                assert!(quarter.within_3_sigma() >= 0.99, "{seed}: {quarters:?}");
                assert_eq!(quarter.violations, 0, "{seed}: {quarters:?}");
            }
            let [_, second, _, last] = quarters[..] else {
                panic!("{seed}: {} quarters", quarters.len());
            };
            assert!(
                last.rms_deg() <= 1.1 * second.rms_deg(),
                "{seed}: {quarters:?}"
            );
        }
    }
}
