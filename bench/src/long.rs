//! Long simulated flights through the whole pipeline, in memory: the attitude must stay right.

use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::motion::geometry::angle_between;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::truth;
use aplomb_recordings::attitude;
use aplomb_recordings::simulated::samples;

use crate::parallel;
use crate::promise::{is_broken, larger};

const HOUR_S: u64 = 3_600;
/// Start of a flight that does not count, µs.
const START_US: u64 = 60_000_000;

/// Scores of one part of a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Score {
    rows: u64,
    squares_deg2: f64,
    sum_of_sigmas_deg: f64,
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

    /// Returns the mean σ, degrees.
    #[cfg(test)]
    fn mean_sigma_deg(&self) -> f64 {
        self.sum_of_sigmas_deg / self.rows as f64
    }

    /// Returns the share of rows that are `VALID`.
    pub fn valid_share(&self) -> f64 {
        self.valid as f64 / self.rows as f64
    }

    /// Returns the share of rows with an error of at most 3 σ.
    pub fn within_3_sigma(&self) -> f64 {
        self.within_3_sigma as f64 / self.rows as f64
    }

    /// Returns the scores of this part and another together.
    fn with(self, other: &Self) -> Self {
        Self {
            rows: self.rows + other.rows,
            squares_deg2: self.squares_deg2 + other.squares_deg2,
            sum_of_sigmas_deg: self.sum_of_sigmas_deg + other.sum_of_sigmas_deg,
            maximum_deg: larger(self.maximum_deg, other.maximum_deg),
            valid: self.valid + other.valid,
            within_3_sigma: self.within_3_sigma + other.within_3_sigma,
            violations: self.violations + other.violations,
        }
    }

    fn add(&mut self, error_rad: f64, sigma_rad: f64, flags: Flags) {
        let error_deg = error_rad.to_degrees();
        self.rows += 1;
        self.squares_deg2 += error_deg * error_deg;
        self.sum_of_sigmas_deg += sigma_rad.to_degrees();
        self.maximum_deg = larger(self.maximum_deg, error_deg);
        self.within_3_sigma += u64::from(error_rad <= 3.0 * sigma_rad);
        if flags.contains(Flags::VALID) {
            self.valid += 1;
            self.violations += u64::from(is_broken(error_deg, sigma_rad.to_degrees()));
        }
    }
}

/// Flies the flight of this seed, and scores each part of `part_s` seconds. Calls `show` with the
/// number and the score of each part that has ended.
fn fly(seed: u64, seconds: u64, part_s: u64, show: impl Fn(usize, &Score)) -> Vec<Score> {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let parts = seconds.div_ceil(part_s) as usize;
    let mut scores = vec![Score::default()];
    for simulated in samples(Box::new(Quadrotor::by_seed(seed)), seed, seconds) {
        let snapshot = pipeline.update(&simulated.burst(), BoardFlags::SCALES_VERIFIED);
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
        while scores.len() <= part && scores.len() < parts {
            if let Some(ended) = scores.last() {
                show(scores.len(), ended);
            }
            scores.push(Score::default());
        }
        if let Some(score) = scores.get_mut(part) {
            score.add(error_rad, snapshot.tilt_sigma_rad().into(), snapshot.flags);
        }
    }
    if let Some(ended) = scores.last() {
        show(scores.len(), ended);
    }
    scores
}

/// First lines of the table with a row for each hour.
const HOURS_HEADER: &str = "\
| seed | hour | rms | largest | `VALID` | within 3 σ | wrong while `VALID` |
|---|---|---|---|---|---|---|";

/// First lines of the table with a row for each flight.
const FLIGHTS_HEADER: &str = "\
| seed | `VALID` | rms, hour 2 | rms, last hour | largest | within 3 σ | wrong while `VALID` |
|---|---|---|---|---|---|---|";

/// Flies the flights of these seeds, and returns a table with a row for each. Calls `show` with a
/// row of each hour that has ended.
pub fn table(seeds: &[u64], seconds: u64, show: impl Fn(&str) + Sync) -> String {
    show(HOURS_HEADER);
    let flights = parallel::map_with_bar("flying", seeds, |seed| {
        fly(*seed, seconds, HOUR_S, |hour, score| {
            show(&hour_row(*seed, hour, score));
        })
    });
    let mut text = format!("\n{FLIGHTS_HEADER}\n");
    for (seed, hours) in seeds.iter().zip(flights) {
        text.push_str(&flight_row(*seed, &hours));
    }
    text
}

/// Returns the row of an hour with [`HOURS_HEADER`].
fn hour_row(seed: u64, hour: usize, score: &Score) -> String {
    format!(
        "| {seed} | {hour} | {:.2}° | {:.2}° | {:.3} % | {:.2} % | {} |",
        score.rms_deg(),
        score.maximum_deg,
        100.0 * score.valid_share(),
        100.0 * score.within_3_sigma(),
        score.violations
    )
}

/// Returns the row of a flight with [`FLIGHTS_HEADER`].
fn flight_row(seed: u64, hours: &[Score]) -> String {
    let rms = |score: Option<&Score>| {
        score.map_or("–".to_owned(), |score| format!("{:.2}°", score.rms_deg()))
    };
    let flight = hours.iter().fold(Score::default(), Score::with);
    format!(
        "| {seed} | {:.3} % | {} | {} | {:.2}° | {:.2} % | {} |\n",
        100.0 * flight.valid_share(),
        rms(hours.get(1)),
        rms(hours.last()),
        flight.maximum_deg,
        100.0 * flight.within_3_sigma(),
        flight.violations
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The short form of `--long`. Without a memory of the parameters the error of a flight doubles
    /// within an hour and a half, and then the filter restarts.
    #[test]
    fn an_hour_of_flight_stays_as_good_as_its_beginning() {
        const QUARTER_S: u64 = HOUR_S / 4;
        let seeds = [5_001, 5_002];
        let flights = parallel::map(&seeds, |seed| fly(*seed, HOUR_S, QUARTER_S, |_, _| ()));
        for (seed, quarters) in seeds.iter().zip(flights) {
            for quarter in &quarters {
                assert!(quarter.valid_share() >= 0.9999, "{seed}: {quarters:?}");
                assert!(quarter.within_3_sigma() >= 0.99, "{seed}: {quarters:?}");
                assert_eq!(quarter.violations, 0, "{seed}: {quarters:?}");
                // A large σ would keep any promise.
                let sigma_deg = quarter.mean_sigma_deg();
                println!("{seed}: mean σ {sigma_deg:.2} degrees");
                assert!(sigma_deg < 30.0, "{seed}: {quarters:?}");
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

    #[test]
    fn the_row_of_a_flight_is_of_all_its_hours() {
        let mut hours = [Score::default(); 3];
        for (hour, errors_deg) in hours.iter_mut().zip([[3.5, 3.5], [1.0, 1.0], [2.0, 7.0]]) {
            for error_deg in errors_deg {
                // 7° at a σ of 1° break the promise. They and 3.5° are beyond 3 σ.
                hour.add(f64::to_radians(error_deg), 1_f64.to_radians(), Flags::VALID);
            }
        }
        hours[0].add(0.0, 0.1, Flags::default());
        assert_eq!(
            flight_row(7, &hours),
            "| 7 | 85.714 % | 1.00° | 5.15° | 7.00° | 57.14 % | 1 |\n"
        );
        let row = flight_row(7, &hours[..1]);
        assert!(row.contains("| – | 2.86° |"), "{row}");
        hours[1].add(f64::NAN, 0.1, Flags::VALID);
        let row = flight_row(7, &hours);
        assert!(
            row.contains("| NaN° |") && row.ends_with("| 2 |\n"),
            "{row}"
        );
    }
}
