//! Milliseconds that look like microseconds: few rows a second have the numbers of very many.
//!
//! A step of 50 is 20 rows a second in ms, and 20,000 in µs. Two things decide:
//!
//! - While the sensor turns, the force turns by the rate times the step. A straight line through
//!   the origin relates both changes, and its slope shows the step.
//! - A recording that would last less than a second in µs was not meant so.
//!
//! A sensor at rest shows nothing. A long recording at rest passes with a warning.

use std::ops::RangeInclusive;

use aplomb_models::motion::geometry::{Vector, add, cross, dot, scale, subtract};

use crate::fault::LogFault;
use crate::row::Row;

/// Steps that may be milliseconds, µs: those of 3 to 33 rows a second.
const MISTAKEN_STEPS_US: RangeInclusive<f64> = 30.0..=300.0;
/// Longest recording that is too short to be meant, µs.
const SHORT_US: u64 = 1_000_000;
/// Fewest steps that show a turn.
const FEWEST_STEPS: u64 = 64;
/// Least share of the force's changes that the rates explain, if the slope is to be believed.
const EXPLAINED_SHARE: f64 = 0.6;
/// Largest error of the slope, as a factor.
const SLOPE_FACTOR: f64 = 3.0;
/// Least sum of squares, in those of the force's changes, that excludes milliseconds.
const EXCLUDING_SQUARES: f64 = 4.0;

/// Unit of the rates, rad/s, as far as it is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RateScale {
    /// The rates are in rad/s.
    Known,
    /// The rates may be in °/s.
    Assumed,
    /// The rates are register counts.
    Counts,
}

impl RateScale {
    /// Returns the least and the largest rate that a 1 may be, rad/s.
    fn bounds(self) -> (f64, f64) {
        match self {
            Self::Known => (1.0, 1.0),
            Self::Assumed => (1_f64.to_radians(), 1.0),
            // Full scales of 250 and 2,000 °/s.
            Self::Counts => (
                (250.0_f64 / 32_768.0).to_radians(),
                (2_000.0_f64 / 32_768.0).to_radians(),
            ),
        }
    }
}

/// Watch over times that may be milliseconds, row by row.
#[derive(Clone, Debug)]
pub(crate) struct Watch {
    /// Usual step, µs.
    step_us: f64,
    scale: RateScale,
    first_us: Option<i64>,
    last: Option<Row>,
    steps: u64,
    /// Sums of the force's changes, and of the turns in ms.
    sums: [Vector; 2],
    /// Sums of products: of the changes, of the turns, and of both.
    squares: [f64; 3],
}

/// Mean products about the means, which leave out the gyroscope's offset.
struct Moments {
    changes: f64,
    turns: f64,
    mixed: f64,
}

impl Watch {
    /// Starts the watch for this usual step, µs; `None` if the step cannot be mistaken.
    pub(crate) fn new(step_us: f64, scale: RateScale) -> Option<Self> {
        MISTAKEN_STEPS_US.contains(&step_us).then_some(Self {
            step_us,
            scale,
            first_us: None,
            last: None,
            steps: 0,
            sums: [[0.0; 3]; 2],
            squares: [0.0; 3],
        })
    }

    /// Takes the next row.
    ///
    /// # Errors
    ///
    /// Returns the fault if the turns show milliseconds.
    pub(crate) fn row(&mut self, row: &Row) -> Result<(), LogFault> {
        self.first_us.get_or_insert(row.time_us);
        let Some(last) = self.last.replace(*row) else {
            return Ok(());
        };
        let step = row.time_us.saturating_sub(last.time_us) as f64;
        if !(0.0..4.0 * self.step_us).contains(&step) {
            return Ok(());
        }
        let middle = |first: Vector, second: Vector| -> Vector { scale(add(first, second), 0.5) };
        let force = middle(last.specific_force_m_s2, row.specific_force_m_s2);
        let rate = middle(last.rates_rad_s, row.rates_rad_s);
        // A force that stays in earth axes turns against the sensor.
        let turn = scale(cross(force, rate), step * 1e-3);
        let change = subtract(row.specific_force_m_s2, last.specific_force_m_s2);
        let squares = [dot(change, change), dot(turn, turn), dot(turn, change)];
        if !squares.iter().all(|square| square.is_finite()) {
            return Ok(());
        }
        for (sum, square) in self.squares.iter_mut().zip(squares) {
            *sum += square;
        }
        self.sums = [add(self.sums[0], change), add(self.sums[1], turn)];
        self.steps += 1;
        if self.steps.is_power_of_two() && self.turns_show_it() {
            return Err(self.fault(None));
        }
        Ok(())
    }

    /// Judges the whole recording after its last row. Returns a warning if nothing is certain.
    ///
    /// # Errors
    ///
    /// Returns the fault if the times are milliseconds, or the recording is too short.
    pub(crate) fn end(&self) -> Result<Option<String>, LogFault> {
        if self.turns_show_it() {
            return Err(self.fault(None));
        }
        if self.turns_exclude_it() {
            return Ok(None);
        }
        let times = self.first_us.zip(self.last.map(|row| row.time_us));
        let duration_us = times.map_or(0, |(first, last)| last.abs_diff(first));
        if duration_us < SHORT_US {
            return Err(self.fault(Some(duration_us as f64 * 1e-6)));
        }
        let rate = 1e6 / self.step_us;
        Ok(Some(format!(
            "the time between rows is mostly {:.0} µs, which is {rate:.0} rows a second: \
             if it is ms, add --time-unit ms, else --time-unit us",
            self.step_us
        )))
    }

    fn moments(&self) -> Moments {
        let count = self.steps as f64;
        let [changes, turns] = self.sums;
        let about = |square: f64, first: Vector, second: Vector| {
            (square - dot(first, second) / count) / count
        };
        Moments {
            changes: about(self.squares[0], changes, changes),
            turns: about(self.squares[1], turns, turns),
            mixed: about(self.squares[2], turns, changes),
        }
    }

    /// Returns whether the force turns with the rates as it does in milliseconds.
    fn turns_show_it(&self) -> bool {
        let (least, largest) = self.scale.bounds();
        let Moments {
            changes,
            turns,
            mixed,
        } = self.moments();
        let slope = mixed / turns;
        let plausible = least / SLOPE_FACTOR..=largest * SLOPE_FACTOR;
        self.steps >= FEWEST_STEPS
            && plausible.contains(&slope)
            && slope * mixed > EXPLAINED_SHARE * changes
    }

    /// Returns whether the force would have turned far more in milliseconds.
    fn turns_exclude_it(&self) -> bool {
        let (least, _) = self.scale.bounds();
        let Moments {
            changes,
            turns,
            mixed,
        } = self.moments();
        let left = changes - 2.0 * least * mixed + least * least * turns;
        self.steps >= FEWEST_STEPS && left > EXCLUDING_SQUARES * changes
    }

    fn fault(&self, seconds: Option<f64>) -> LogFault {
        LogFault::Milliseconds {
            step: self.step_us,
            seconds,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAVITY: f64 = 9.806_65;

    /// Motion of a sensor: angle about x, rad, and its rate, rad/s, at a time in s.
    type Motion = fn(f64) -> (f64, f64);

    /// Turned to and fro by hand.
    const BY_HAND: Motion = |time_s| (1.2 * (1.1 * time_s).sin(), 1.32 * (1.1 * time_s).cos());
    /// At rest, with a gyroscope's offset of 3 °/s.
    const AT_REST: Motion = |_| (0.4, 0.05);

    /// Returns the judgement of so many seconds of a sensor with noise, whose times are true to
    /// `unit_s`, s. The rates are in `rate_unit`, rad/s.
    fn judge(
        motion: Motion,
        rate_hz: f64,
        seconds: f64,
        unit_s: f64,
        (rate_unit, scale): (f64, RateScale),
    ) -> Result<Option<String>, String> {
        let mut state = 1_u64;
        let mut noise = |size: f64| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            ((state >> 40) as f64 / f64::from(1_u32 << 23) - 1.0) * size
        };
        let step = (1.0 / rate_hz / unit_s).round();
        let mut watch = Watch::new(step, scale).expect("such steps are watched");
        for index in 0..(seconds * rate_hz) as u32 {
            let (angle, rate) = motion(f64::from(index) / rate_hz);
            let force = [0.0, GRAVITY * angle.sin(), GRAVITY * angle.cos()];
            let row = Row {
                time_us: (f64::from(index) / rate_hz / unit_s).round() as i64,
                specific_force_m_s2: force.map(|value| value + noise(0.08)),
                rates_rad_s: [rate, 0.0, 0.0].map(|value| (value + noise(0.01)) / rate_unit),
                field_ut: None,
                attitude: None,
                scored: true,
                armed: None,
            };
            watch.row(&row).map_err(|fault| fault.to_string())?;
        }
        watch.end().map_err(|fault| fault.to_string())
    }

    const SCALES: [(f64, RateScale); 5] = [
        (1.0, RateScale::Known),
        (1.0, RateScale::Assumed),
        (0.017_453_3, RateScale::Assumed),
        (0.000_133, RateScale::Counts),
        (0.001_065, RateScale::Counts),
    ];

    #[test]
    fn milliseconds_are_found_at_each_rate() {
        for rate_hz in [4.0, 5.0, 8.0, 10.0, 12.5, 20.0, 25.0, 30.0, 32.0] {
            for scale in SCALES {
                // An hour, of which the first rows are enough, and twenty seconds.
                for seconds in [20.0, 3_600.0] {
                    let message = judge(BY_HAND, rate_hz, seconds, 1e-3, scale)
                        .expect_err("these are milliseconds");
                    assert!(message.contains("(--time-unit ms)"), "{message}");
                }
                let message = judge(AT_REST, rate_hz, 60.0, 1e-3, scale).expect_err("too short");
                assert!(message.contains("would last 0.0"), "{message}");
                let long = judge(AT_REST, rate_hz, 3_600.0, 1e-3, scale).expect("at rest");
                let warning = long.expect("a warning");
                assert!(warning.contains("rows a second"), "{warning}");
            }
        }
    }

    #[test]
    fn microseconds_pass_at_each_rate() {
        // A motor's vibration, which turns the sensor in step.
        let vibrating: Motion = |time_s| {
            let (angle, rate) = BY_HAND(time_s);
            let phase = 1_000.0 * time_s;
            (angle + 0.01 * phase.sin(), rate + 10.0 * phase.cos())
        };
        for rate_hz in [3_400.0, 4_000.0, 8_000.0, 16_000.0, 32_000.0] {
            for scale in SCALES {
                for motion in [BY_HAND, vibrating] {
                    let judged = judge(motion, rate_hz, 3.0, 1e-6, scale);
                    assert!(judged.is_ok(), "{rate_hz} {scale:?}: {judged:?}");
                }
                assert!(judge(AT_REST, rate_hz, 3.0, 1e-6, scale).is_ok());
            }
            // Half a second is enough, if the rates exclude milliseconds.
            let scale = (1.0, RateScale::Known);
            assert_eq!(judge(vibrating, rate_hz, 0.5, 1e-6, scale), Ok(None));
        }
        assert!(Watch::new(400.0, RateScale::Known).is_none());
        assert!(Watch::new(1_000.0, RateScale::Known).is_none());
    }
}
