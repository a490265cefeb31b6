//! Units of rows in memory: the guards of a file's rows, for rows whose times may have any order.
//!
//! A row with a NaN, and a time that goes back, is no question of units. The filter flags it.
//!
//! The guards look at motions of seconds. So rows that follow faster than each 10 ms are averaged
//! for them, which takes a fifth of the time. A spike is found in its own row.

use aplomb_models::motion::geometry::{Vector, add, dot, scale};

use crate::fault::LogFault;
use crate::plausibility::{JUDGED_ROWS, Judge, LARGEST_FORCE_M_S2, LARGEST_RATE_RAD_S};
use crate::row::Row;
use crate::turns::Turns;
use crate::units::RowOptions;

/// Rows whose values are judged together, by their medians.
pub const ROWS_TOGETHER: usize = JUDGED_ROWS;
/// Time whose rows are averaged, µs.
const GROUP_US: i64 = 10_000;

/// Check of the units, row by row.
#[derive(Clone, Debug)]
pub struct UnitCheck {
    judge: Judge,
    turns: Turns,
    warnings: Vec<String>,
    group: Group,
}

/// Sums of the rows that are averaged.
#[derive(Clone, Copy, Debug, Default)]
struct Group {
    start_us: i64,
    last_us: i64,
    rows: u32,
    force: Vector,
    rates: Vector,
    /// True if a row has a NaN or reads full scale.
    is_broken: bool,
}

impl UnitCheck {
    /// Starts with the first rows, [`ROWS_TOGETHER`] if there are as many. A unit of `options` is
    /// taken as it is.
    ///
    /// # Errors
    ///
    /// Returns the fault, with the unit that the numbers suggest.
    pub fn new(first: &[Row], options: RowOptions) -> Result<Self, LogFault> {
        let mut judge = Judge::new(options, false);
        judge.units(first.iter())?;
        let warnings = judge.field_warning(first.iter()).into_iter().collect();
        Ok(Self {
            judge,
            turns: Turns::default(),
            warnings,
            group: Group::default(),
        })
    }

    /// Checks the next row: time in µs, m/s² and rad/s. `is_saturated` if one of them reads full
    /// scale.
    ///
    /// # Errors
    ///
    /// Returns the fault, with the unit that the numbers suggest.
    #[inline]
    pub fn row(
        &mut self,
        time_us: i64,
        force_m_s2: Vector,
        rates_rad_s: Vector,
        is_saturated: bool,
    ) -> Result<(), LogFault> {
        let since_us = time_us.wrapping_sub(self.group.start_us);
        if !(0..GROUP_US).contains(&since_us) || self.group.rows == 0 {
            self.close_group()?;
            self.group.start_us = time_us;
        }
        let is_usual = dot(force_m_s2, force_m_s2) <= LARGEST_FORCE_M_S2.powi(2)
            && dot(rates_rad_s, rates_rad_s) <= LARGEST_RATE_RAD_S.powi(2);
        if !is_usual || self.judge.is_watching() {
            self.check(time_us, force_m_s2, rates_rad_s)?;
        }
        let group = &mut self.group;
        group.last_us = time_us;
        group.is_broken |= is_saturated;
        group.rows += 1;
        group.force = add(group.force, force_m_s2);
        group.rates = add(group.rates, rates_rad_s);
        Ok(())
    }

    /// Checks a row of its own.
    #[cold]
    #[inline(never)]
    fn check(
        &mut self,
        time_us: i64,
        force_m_s2: Vector,
        rates_rad_s: Vector,
    ) -> Result<(), LogFault> {
        let mut values = force_m_s2.iter().chain(&rates_rad_s);
        if !values.all(|value| value.is_finite()) {
            return Ok(());
        }
        let row = row(time_us, force_m_s2, rates_rad_s);
        self.judge.spike(&row)?;
        self.judge.watch(&row)
    }

    /// Checks the mean of the rows since the last one.
    fn close_group(&mut self) -> Result<(), LogFault> {
        let group = std::mem::take(&mut self.group);
        if group.rows == 0 {
            return Ok(());
        }
        let share = f64::from(group.rows).recip();
        let (force, rates) = (scale(group.force, share), scale(group.rates, share));
        let is_number = force.iter().chain(&rates).all(|value| value.is_finite());
        let is_broken = group.is_broken || !is_number;
        self.turns.add(group.last_us, force, rates, is_broken);
        if is_number {
            self.judge.rates(&row(group.last_us, force, rates))?;
        }
        Ok(())
    }

    /// Judges the rows as a whole. Returns the warnings.
    ///
    /// # Errors
    ///
    /// Returns the fault, with the unit that the numbers suggest.
    pub fn end(mut self) -> Result<Vec<String>, LogFault> {
        self.close_group()?;
        self.warnings.extend(self.judge.end()?);
        self.warnings.extend(self.turns.warning());
        Ok(self.warnings)
    }
}

/// Returns a row without a compass and a truth.
fn row(time_us: i64, specific_force_m_s2: Vector, rates_rad_s: Vector) -> Row {
    Row {
        time_us,
        specific_force_m_s2,
        rates_rad_s,
        field_ut: None,
        attitude: None,
        scored: false,
        armed: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the warnings on a body that rolls to and fro, or the fault, at so many rows a second
    /// for 20 s.
    fn check(rate_hz: u32, force: f64, rate: f64, time: f64) -> Result<Vec<String>, String> {
        let rows: Vec<Row> = (0..20 * rate_hz)
            .map(|index| {
                let time_s = f64::from(index) / f64::from(rate_hz);
                let (angle, speed) = (1.2 * (1.1 * time_s).sin(), 1.32 * (1.1 * time_s).cos());
                let forces = [0.0, 9.81 * angle.sin(), 9.81 * angle.cos()];
                let time_us = (time_s * 1e6 * time).round() as i64;
                row(time_us, scale(forces, force), [speed * rate, 0.0, 0.0])
            })
            .collect();
        let fault = |fault: LogFault| fault.to_string();
        let first = &rows[..ROWS_TOGETHER];
        let mut units = UnitCheck::new(first, RowOptions::default()).map_err(fault)?;
        for row in &rows {
            let (force, rates) = (row.specific_force_m_s2, row.rates_rad_s);
            units.row(row.time_us, force, rates, false).map_err(fault)?;
        }
        units.end().map_err(fault)
    }

    #[test]
    fn other_units_are_found() {
        for rate_hz in [20, 100, 250, 1_000] {
            assert_eq!(check(rate_hz, 1.0, 1.0, 1.0), Ok(Vec::new()), "{rate_hz}");
            for (force, rate, meant) in [
                (1.0 / 9.81, 1.0, "did you mean g"),
                (1_000.0 / 9.81, 1.0, "did you mean mg"),
                (1.0, 57.3, "did you mean °/s"),
                (1.0, 17.0, "did you mean °/s"),
            ] {
                let fault = check(rate_hz, force, rate, 1.0).expect_err(meant);
                assert!(fault.contains(meant), "{rate_hz}: {fault}");
            }
            let warnings = check(rate_hz, 1.0, -1.0, 1.0).expect("a sign is a warning");
            assert!(warnings[0].contains("do not fit the force"), "{warnings:?}");
        }
        for (rate_hz, time, meant) in [
            (20, 1e-3, "did you mean ms"),
            (100, 1e-3, "did you mean ms"),
            (20, 1e3, "did you mean ns"),
            (1_000, 1e3, "did you mean ns"),
        ] {
            let fault = check(rate_hz, 1.0, 1.0, time).expect_err(meant);
            assert!(fault.contains(meant), "{rate_hz}: {fault}");
        }
    }

    #[test]
    fn exchanged_force_and_rates_are_found() {
        let exchanged = |rates_rad_s: Vector, given: RowOptions| {
            let rows = [row(0, rates_rad_s, [0.3, -5.0, 8.4]); 20];
            let units = UnitCheck::new(&rows, given);
            units.map(|_| ()).map_err(|fault| fault.to_string())
        };
        for (rate, meant) in [
            (0.0, "did you mean to exchange force and rates"),
            (0.07, "did you mean to exchange force and rates"),
            (
                1.3,
                "did you mean g (--force-unit g), or to exchange force and rates",
            ),
            (4.0, "did you mean to exchange force and rates"),
        ] {
            let fault = exchanged([rate, 0.0, 0.0], RowOptions::default()).expect_err(meant);
            assert!(fault.contains(meant), "{rate}: {fault}");
        }
        // A fast turn in gravity, and a unit that is given.
        assert_eq!(exchanged([0.0, 0.0, 9.8], RowOptions::default()), Ok(()));
        let given = RowOptions {
            force_unit: Some(crate::units::ForceUnit::MetresPerSecondSquared),
            ..RowOptions::default()
        };
        assert_eq!(exchanged([0.07, 0.0, 0.0], given), Ok(()));
    }

    #[test]
    fn damaged_rows_and_any_order_of_times_pass() {
        let mut units = UnitCheck::new(&[], RowOptions::default()).expect("no rows");
        for (time_us, value) in [(0, 9.8), (i64::MAX, f64::NAN), (i64::MIN, 9.8), (-5, 9.8)] {
            let checked = units.row(time_us, [0.0, 0.0, value], [0.1, 0.0, 0.0], false);
            assert!(checked.is_ok(), "{time_us}");
        }
        assert!(units.end().expect("no fault").is_empty());
    }
}
