//! Rates that a sensor at rest cannot have: its offset in °/s, read as rad/s.
//!
//! A rest shows the gyroscope's offset alone, which is up to 20 °/s. Read as rad/s, an offset of
//! 4 °/s is a turn of 229 °/s. Such a turn moves the force in sensor axes, except for its part
//! about the vertical. Two things decide, while the force keeps its size and direction:
//!
//! - The mean rate across the force is large for three seconds: no turn leaves the force in place.
//! - The mean rate along the force is large for twenty seconds from the first row, without one slow
//!   row. A turntable starts from rest, or stops sooner.
//!
//! A smaller offset, and one along the vertical in a shorter rest, shows nothing.

use aplomb_models::motion::geometry::{Vector, add, angle_between, cross, norm, scale};
use aplomb_models::motion::truth::STANDARD_GRAVITY_M_S2;

use crate::row::Row;

/// Time over which a mean is taken, µs.
const BLOCK_US: u64 = 1_000_000;
/// Fewest rows of a mean.
const FEWEST_ROWS: u32 = 5;
/// Least length of the mean of the force's directions: they deviate by 3.6°, root mean square.
const LEAST_RESULTANT: f64 = 0.998;
/// Largest difference of the force from gravity, as a share: offset and scale of a sensor at rest.
const GRAVITY_SHARE: f64 = 0.1;
/// Largest turn of the force from one mean to the next, rad.
const STILL_RAD: f64 = 1.0 / 180.0 * std::f64::consts::PI;
/// Largest mean rate of a sensor at rest, rad/s: twice the offset of ±20 °/s.
const LARGEST_REST_RATE_RAD_S: f64 = 0.7;
/// Rate below which a row shows that the sensor rests or begins to turn, rad/s.
const SLOW_RAD_S: f64 = LARGEST_REST_RATE_RAD_S / 2.0;
/// Means in a row that show a rate across the force.
const BLOCKS_ACROSS: u32 = 3;
/// Means in a row that show a rate along the force.
const BLOCKS_ALONG: u32 = 20;

/// Watch over the rates of a sensor whose force keeps its direction, row by row.
#[derive(Clone, Debug, Default)]
pub(crate) struct StillRates {
    start_us: i64,
    rows: u32,
    /// Sums of the force's directions, and of the rates.
    sums: [Vector; 2],
    /// Sum of the force's sizes.
    size: f64,
    /// Direction of the force in the last still block.
    direction: Option<Vector>,
    /// Still blocks in a row with a rate across the force, and along it.
    across: u32,
    along: u32,
    has_slow_row: bool,
}

impl StillRates {
    /// Takes a row in m/s² and rad/s. Returns the mean rate, rad/s, if it is none of a sensor at
    /// rest.
    pub(crate) fn row(&mut self, row: &Row) -> Option<f64> {
        let ended = self.rows > 0 && row.time_us.abs_diff(self.start_us) >= BLOCK_US;
        let found = if ended { self.close() } else { None };
        if self.rows == 0 {
            self.start_us = row.time_us;
        }
        let size = norm(row.specific_force_m_s2);
        let direction = scale(row.specific_force_m_s2, size.max(f64::MIN_POSITIVE).recip());
        self.sums = [
            add(self.sums[0], direction),
            add(self.sums[1], row.rates_rad_s),
        ];
        self.size += size;
        self.rows += 1;
        self.has_slow_row |= norm(row.rates_rad_s) < SLOW_RAD_S;
        found
    }

    /// Ends a block. Returns the mean rate, if it is none of a sensor at rest.
    fn close(&mut self) -> Option<f64> {
        let rows = f64::from(std::mem::take(&mut self.rows));
        let [direction, rate] = std::mem::take(&mut self.sums).map(|sum| scale(sum, rows.recip()));
        let size = std::mem::take(&mut self.size) / rows;
        let is_still = rows >= f64::from(FEWEST_ROWS)
            && norm(direction) > LEAST_RESULTANT
            && (size / STANDARD_GRAVITY_M_S2 - 1.0).abs() < GRAVITY_SHARE
            && (self.direction).is_none_or(|before| angle_between(before, direction) < STILL_RAD);
        self.direction = is_still.then_some(direction);
        let across = norm(cross(direction, rate));
        let count = |blocks: u32, is_fast: bool| if is_still && is_fast { blocks + 1 } else { 0 };
        self.across = count(self.across, across > LARGEST_REST_RATE_RAD_S);
        self.along = count(self.along, norm(rate) > LARGEST_REST_RATE_RAD_S);
        let is_found =
            self.across >= BLOCKS_ACROSS || (self.along >= BLOCKS_ALONG && !self.has_slow_row);
        is_found.then(|| norm(rate))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use aplomb_models::random::Random;

    use super::*;

    const GRAVITY: f64 = 9.806_65;

    /// Returns the time of the finding, s, in a recording of so many seconds at 100 Hz; a motion
    /// gives force and rate at a time.
    fn found_s(seconds: u32, motion: impl Fn(f64) -> (Vector, Vector)) -> Option<f64> {
        let mut still = StillRates::default();
        let mut random = Random::new(1, "still rates");
        let mut noise = |size: f64| random.uniform(-size, size);
        (0..seconds * 100).map(f64::from).find_map(|index| {
            let (force, rates) = motion(index * 0.01);
            let row = Row {
                time_us: (index * 10_000.0) as i64,
                specific_force_m_s2: force.map(|value| value + noise(0.2)),
                rates_rad_s: rates.map(|value| value + noise(0.05)),
                field_ut: None,
                attitude: None,
                scored: true,
                armed: None,
            };
            still.row(&row).map(|_| index * 0.01)
        })
    }

    /// Returns a turn about a horizontal or tilted axis in a plane with x and z, at this rate.
    fn turning(rate: f64, tilt: f64) -> impl Fn(f64) -> (Vector, Vector) {
        move |time_s| {
            let (sin, cos) = (rate * time_s).sin_cos();
            let force = [
                GRAVITY * tilt.sin() * cos,
                -GRAVITY * tilt.sin() * sin,
                GRAVITY * tilt.cos(),
            ];
            (force, [0.0, 0.0, rate])
        }
    }

    #[test]
    fn an_offset_in_degrees_per_second_is_found_in_a_rest() {
        for offset in [[4.0, 0.0, 0.0], [0.5, -0.6, 7.0], [-9.0, 9.0, 2.0]] {
            let found = found_s(10, |_| ([0.3, 0.1, GRAVITY], offset));
            assert!(found.is_some_and(|time_s| time_s < 3.5), "{found:?}");
        }
        // Along the vertical it is a turntable's rate, until it is too long.
        let along = |_| ([0.0, 0.0, -GRAVITY], [0.1, 0.1, 4.0]);
        assert_eq!(found_s(19, along), None);
        assert!(found_s(60, along).is_some_and(|time_s| time_s < 21.0));
    }

    #[test]
    fn turns_and_offsets_of_a_sensor_in_radians_pass() {
        // The largest offset of a part.
        assert_eq!(
            found_s(60, |_| ([0.0, 0.0, GRAVITY], [0.35, -0.35, 0.35])),
            None
        );
        // Whole turns in a block, too.
        for rate in [0.8, 1.5, TAU, 2.0 * TAU, 30.0] {
            for tilt in [0.02, 0.1, 0.5, 1.57] {
                assert_eq!(found_s(19, turning(rate, tilt)), None, "{rate} {tilt}");
            }
            // A turntable: rest, ten minutes of a turn, rest.
            let table = |time_s: f64| {
                let rate = if (1.0..600.0).contains(&time_s) {
                    rate
                } else {
                    0.0
                };
                ([0.2, 0.0, GRAVITY], [0.05, -0.05, rate])
            };
            assert_eq!(found_s(700, table), None, "{rate}");
        }
    }
}
