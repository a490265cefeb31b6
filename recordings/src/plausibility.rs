//! Plausibility of a log: its units by the size of the numbers, and rows that no sensor gave.
//!
//! The first rows are judged together, by their medians, which a few odd rows do not move. Each
//! row is then judged alone. Numbers can tell units apart where they differ enough: gravity is
//! 9.8 m/s² or 1 g, and nothing turns at 1,000 rad/s. Slow rates in °/s are found when the sensor
//! turns too fast, or rests: then the gyroscope's offset is the rate.

use std::ops::RangeInclusive;

use aplomb_models::motion::geometry::{Vector, norm};

use crate::fault::{LogFault, UnitGuess};
use crate::milliseconds::{RateScale, Watch};
use crate::row::{COLUMNS, Row};
use crate::still_rates::StillRates;
use crate::units::RowOptions;

/// Rows that are judged together.
pub const JUDGED_ROWS: usize = 256;
/// Fewest rows that are judged together.
const FEWEST_JUDGED_ROWS: usize = 8;

/// Largest plausible force, m/s² (100 g).
pub(crate) const LARGEST_FORCE_M_S2: f64 = 1000.0;
/// Largest plausible rate, rad/s (4,100 °/s): sensors end at 4,000 °/s.
pub(crate) const LARGEST_RATE_RAD_S: f64 = 72.0;
/// Largest plausible rate in a log whose unit is given, rad/s (11,000 °/s).
const LARGEST_GIVEN_RATE_RAD_S: f64 = 200.0;
/// Median lengths of the specific force, m/s²: gravity within a tenth.
const GRAVITY_M_S2: RangeInclusive<f64> = 8.8..=10.8;
/// Largest median length, rad/s, of rates that stand where the force belongs. Faster turns are
/// rare, and half of gravity is no force.
const LARGEST_EXCHANGED_RATE_RAD_S: f64 = 4.9;
/// Largest plausible mean rate over [`MEAN_RATE_US`], rad/s: three turns a second. A person who
/// spins a sensor reaches 14 rad/s.
const LARGEST_MEAN_RATE_RAD_S: f64 = 20.0;
/// Units that large rates suggest, with their options.
const MEANT_RATES: &str = "°/s (--rate-unit deg/s) or register counts (--raw)";
/// Time over which the mean rate is taken, µs.
const MEAN_RATE_US: u64 = 2_000_000;
/// Longest pause of a logger, µs: an hour.
const LONGEST_GAP_US: u64 = 3_600_000_000;
/// Shortest plausible time between rows, µs: the fastest sensors give 32,000 samples a second.
const SHORTEST_STEP_US: f64 = 31.0;
/// Longest plausible time between rows, µs: 5 rows a second are of no use to a filter.
const LONGEST_STEP_US: f64 = 200_000.0;
/// Magnetic field of the earth, for messages.
const USUAL_FIELD: &str = "22 to 67 µT";
/// Largest length of a field in tesla, with the hard iron of any vehicle.
const LARGEST_TESLA: f64 = 1e-3;
/// Lengths of a field that is normalized to 1.
const NORMALIZED: RangeInclusive<f64> = 0.97..=1.03;
/// Largest length of a field in gauss. The earth's is 22 µT at least.
const LARGEST_GAUSS: f64 = 5.0;
/// Least length of a field that may be in milligauss, µT.
const LEAST_MILLIGAUSS: f64 = 200.0;
/// Time between rows from which on each row is flagged `GAP`, µs.
const GAP_US: f64 = 500_000.0;

/// Judge of a log's rows, in their order.
#[derive(Clone, Debug)]
pub struct Judge {
    options: RowOptions,
    /// The values are register counts.
    is_raw: bool,
    before_us: Option<i64>,
    /// Usual time between rows, µs.
    step_us: Option<f64>,
    /// Watch over times that may be milliseconds.
    watch: Option<Watch>,
    /// Start, sum and number of the rates whose mean is being taken.
    mean: (i64, f64, u32),
    still: StillRates,
}

impl Judge {
    /// Creates the judge of a log with these options; `is_raw` if its values are register counts.
    #[must_use]
    pub fn new(options: RowOptions, is_raw: bool) -> Self {
        Self {
            options,
            is_raw,
            before_us: None,
            step_us: None,
            watch: None,
            mean: (0, 0.0, 0),
            still: StillRates::default(),
        }
    }

    /// Checks the units by the first rows. A unit that is given is taken as it is.
    ///
    /// # Errors
    ///
    /// Returns the fault, with the unit that the numbers suggest.
    pub fn units<'a>(
        &mut self,
        rows: impl Iterator<Item = &'a Row> + Clone,
    ) -> Result<(), LogFault> {
        let forces: Vec<f64> = rows
            .clone()
            .map(|row| norm(row.specific_force_m_s2))
            .filter(|force| force.is_finite())
            .collect();
        let times: Vec<i64> = rows.clone().map(|row| row.time_us).collect();
        if times.len() < FEWEST_JUDGED_ROWS {
            return Ok(());
        }
        let steps = times.windows(2).map(|pair| pair[1].abs_diff(pair[0]));
        let steps = steps.filter(|step| *step > 0).map(|step| step as f64);
        self.step_us = upper_median(steps.collect());
        if self.options.time_unit.is_none() {
            time_unit(self.step_us)?;
            let scale = match (self.is_raw, self.options.rate_unit) {
                (true, _) => RateScale::Counts,
                (false, Some(_)) => RateScale::Known,
                (false, None) => RateScale::Assumed,
            };
            self.watch = (self.step_us).and_then(|step_us| Watch::new(step_us, scale));
        }
        if self.options.force_unit.is_none() && !self.is_raw {
            let rates = rows.clone().map(|row| norm(row.rates_rad_s));
            let rates = rates.filter(|rate| rate.is_finite()).collect();
            force_unit(upper_median(forces), upper_median(rates))?;
        }
        if self.options.field_unit.is_none() {
            field_unit(fields(rows))?;
        }
        Ok(())
    }

    /// Returns a warning on the magnetic field of these first rows, if it may be in milligauss.
    pub fn field_warning<'a>(&self, rows: impl Iterator<Item = &'a Row>) -> Option<String> {
        let field = upper_median(fields(rows)).filter(|field| *field > LEAST_MILLIGAUSS)?;
        self.options.field_unit.is_none().then(|| {
            format!(
                "the magnetic field is mostly {field:.0} µT, where {USUAL_FIELD} is usual: if it \
                 is mG, add --field-unit mG; if a magnet adds to it, add --field-unit uT"
            )
        })
    }

    /// Returns a warning on the time between these first rows, if no filter can use such rows.
    pub fn time_warning<'a>(&self, rows: impl Iterator<Item = &'a Row>) -> Option<String> {
        let times: Vec<i64> = rows.map(|row| row.time_us).collect();
        if times.len() < FEWEST_JUDGED_ROWS {
            return None;
        }
        let steps = times
            .windows(2)
            .map(|pair| pair[1].abs_diff(pair[0]) as f64);
        let step = upper_median(steps.filter(|step| *step > 0.0).collect())?;
        let is_usual = (SHORTEST_STEP_US..=GAP_US).contains(&step);
        (!is_usual).then(|| {
            format!(
                "the time between rows is mostly {step:.0} µs, where 31 to 500,000 µs are usual: \
                 check --time-unit"
            )
        })
    }

    /// Returns whether the times may be milliseconds, so that [`watch`](Self::watch) is needed.
    pub(crate) fn is_watching(&self) -> bool {
        self.watch.is_some()
    }

    /// Watches the times and turns of a row that is used.
    ///
    /// # Errors
    ///
    /// Returns the fault if the times are milliseconds.
    pub fn watch(&mut self, row: &Row) -> Result<(), LogFault> {
        let watch = self.watch.as_mut();
        watch.map_or(Ok(()), |watch| watch.row(row))
    }

    /// Judges the times after the last row. Returns a warning if their unit is uncertain.
    ///
    /// # Errors
    ///
    /// Returns the fault if the times are milliseconds.
    pub fn end(&mut self) -> Result<Option<String>, LogFault> {
        self.watch.take().map_or(Ok(None), |watch| watch.end())
    }

    /// Returns whether a row was accepted.
    #[must_use]
    pub fn has_row(&self) -> bool {
        self.before_us.is_some()
    }

    /// Checks that a sensor can have measured this row, after the accepted rows before it.
    ///
    /// # Errors
    ///
    /// Returns the fault.
    pub fn row(&mut self, row: &Row) -> Result<(), LogFault> {
        let values = row.specific_force_m_s2.into_iter().chain(row.rates_rad_s);
        for (value, column) in values.zip(&COLUMNS[1..]) {
            if !value.is_finite() {
                return Err(LogFault::NotFinite { column, value });
            }
        }
        let now = row.time_us;
        if let Some(before) = self.before_us {
            if before >= now {
                return Err(LogFault::NotIncreasing { before, now });
            }
            if now.abs_diff(before) > LONGEST_GAP_US {
                return Err(LogFault::Gap { before, now });
            }
        }
        if !self.is_raw {
            self.size(row)?;
        }
        self.before_us = Some(now);
        Ok(())
    }

    /// Returns whether the time of a row is corrupt, because those of the next two rows fit the
    /// rows before and not this one. If either of two rows may be corrupt, the usual step decides.
    #[must_use]
    pub fn is_misplaced(&self, now: i64, after: [Option<i64>; 2]) -> bool {
        let Some(next) = after[0] else {
            return false;
        };
        if !follows(self.before_us, now) || follows(Some(now), next) {
            return false;
        }
        let (rows, deviation_us) =
            self.accepted(std::iter::once(now).chain(after.into_iter().flatten()));
        let (others, other_us) = self.accepted(after.into_iter().flatten());
        others > rows || (others == rows && other_us < deviation_us)
    }

    /// Returns how many of these times follow each other, and how far their steps are from usual
    /// ones, µs.
    fn accepted(&self, times: impl Iterator<Item = i64>) -> (usize, f64) {
        let (mut rows, mut deviation_us, mut before) = (0, 0.0, self.before_us);
        for now in times {
            if !follows(before, now) {
                continue;
            }
            if let (Some(before), Some(usual_us)) = (before, self.step_us) {
                deviation_us += (now.abs_diff(before) as f64 - usual_us).abs();
            }
            rows += 1;
            before = Some(now);
        }
        (rows, deviation_us)
    }

    /// Checks the size of a row's values, which are in SI units.
    fn size(&mut self, row: &Row) -> Result<(), LogFault> {
        self.spike(row)?;
        self.rates(row)
    }

    /// Checks that a sensor can have measured the values of a row, in SI units.
    ///
    /// # Errors
    ///
    /// Returns the fault, with the unit that the numbers suggest.
    pub(crate) fn spike(&self, row: &Row) -> Result<(), LogFault> {
        let force = row.specific_force_m_s2;
        if norm(force) > LARGEST_FORCE_M_S2 {
            return Err(implausible(
                force,
                1,
                "m/s²",
                "mg (--force-unit mg) or register counts (--raw)",
            ));
        }
        let largest = if self.options.rate_unit.is_some() {
            LARGEST_GIVEN_RATE_RAD_S
        } else {
            LARGEST_RATE_RAD_S
        };
        if norm(row.rates_rad_s) > largest {
            return Err(implausible(row.rates_rad_s, 4, "rad/s", MEANT_RATES));
        }
        Ok(())
    }

    /// Checks that the rates until this row are in rad/s, whatever single rows hold. A unit that
    /// is given is taken as it is.
    ///
    /// # Errors
    ///
    /// Returns the fault, with the unit that the rates suggest.
    pub fn rates(&mut self, row: &Row) -> Result<(), LogFault> {
        let rate = norm(row.rates_rad_s);
        let is_number = (rate + norm(row.specific_force_m_s2)).is_finite();
        if self.is_raw || self.options.rate_unit.is_some() || !is_number {
            return Ok(());
        }
        let (start_us, sum, number) = &mut self.mean;
        if row.time_us.abs_diff(*start_us) > MEAN_RATE_US || *number == 0 {
            (*start_us, *sum, *number) = (row.time_us, 0.0, 0);
        }
        // A few rows that no sensor gave do not decide.
        *sum += rate.min(LARGEST_RATE_RAD_S);
        *number += 1;
        let mean = *sum / f64::from(*number);
        let is_long = row.time_us.abs_diff(*start_us) > MEAN_RATE_US / 2 && *number > 20;
        if is_long && mean > LARGEST_MEAN_RATE_RAD_S {
            return Err(LogFault::Unit(Box::new(UnitGuess {
                quantity: "the rate",
                value: mean,
                usual: "up to 20 rad/s",
                meant: MEANT_RATES,
                option: "--rate-unit rad/s",
            })));
        }
        let is_plausible = rate <= LARGEST_RATE_RAD_S;
        match is_plausible.then(|| self.still.row(row)).flatten() {
            Some(value) => Err(LogFault::Unit(Box::new(UnitGuess {
                quantity: "the rate, while the force keeps its direction,",
                value,
                usual: "up to 0.7 rad/s",
                meant: "°/s (--rate-unit deg/s)",
                option: "--rate-unit rad/s",
            }))),
            None => Ok(()),
        }
    }
}

/// Returns whether a row of this time can follow the one before, if there is one.
fn follows(before: Option<i64>, now: i64) -> bool {
    before.is_none_or(|before| before < now && now.abs_diff(before) <= LONGEST_GAP_US)
}

/// Checks the time between rows, µs.
fn time_unit(step_us: Option<f64>) -> Result<(), LogFault> {
    let meant = match step_us {
        Some(step) if step < SHORTEST_STEP_US => "ms (--time-unit ms)",
        Some(step) if step > LONGEST_STEP_US => "ns (--time-unit ns)",
        _ => return Ok(()),
    };
    Err(LogFault::Unit(Box::new(UnitGuess {
        quantity: "the time between rows",
        value: step_us.unwrap_or_default(),
        usual: "31 to 200,000 µs",
        meant,
        option: "--time-unit us",
    })))
}

/// Checks the size of the specific force. Rates of the size of gravity are the force.
fn force_unit(force: Option<f64>, rate: Option<f64>) -> Result<(), LogFault> {
    let are_exchanged = rate.is_some_and(|rate| GRAVITY_M_S2.contains(&rate));
    let meant = match force {
        Some(force) if are_exchanged && (0.6..1.8).contains(&force) => {
            "g (--force-unit g), or to exchange force and rates, as the rates have the size of \
             gravity"
        }
        Some(force) if are_exchanged && force < LARGEST_EXCHANGED_RATE_RAD_S => {
            "to exchange force and rates, as the rates have the size of gravity"
        }
        Some(force) if (0.6..1.8).contains(&force) => "g (--force-unit g)",
        Some(force) if (600.0..1_500.0).contains(&force) => "mg (--force-unit mg)",
        Some(force) if force >= 1_500.0 => {
            "register counts (add --raw and both ranges, for replay, plot and calibrate)"
        }
        _ => return Ok(()),
    };
    Err(LogFault::Unit(Box::new(UnitGuess {
        quantity: "the specific force",
        value: force.unwrap_or_default(),
        usual: "about 9.8 m/s²",
        meant,
        option: "--force-unit m/s2",
    })))
}

/// Checks the lengths of the magnetic field.
fn field_unit(mut fields: Vec<f64>) -> Result<(), LogFault> {
    fields.sort_unstable_by(f64::total_cmp);
    let most = fields.len() / 10..fields.len() - fields.len() / 10;
    let is_normalized = fields[most].iter().all(|field| NORMALIZED.contains(field));
    let Some(field) = upper_median(fields) else {
        return Ok(());
    };
    let meant = if field < LARGEST_TESLA {
        "T (--field-unit T)"
    } else if is_normalized {
        "normalized (--field-unit norm)"
    } else if field < LARGEST_GAUSS {
        "G (--field-unit G)"
    } else {
        return Ok(());
    };
    Err(LogFault::Unit(Box::new(UnitGuess {
        quantity: "the magnetic field",
        value: field,
        usual: USUAL_FIELD,
        meant,
        option: "--field-unit uT",
    })))
}

/// Returns the lengths of the magnetic field in these rows. A compass that fails reads zeros.
fn fields<'a>(rows: impl Iterator<Item = &'a Row>) -> Vec<f64> {
    let fields = rows.filter_map(|row| row.field_ut).map(norm);
    fields.filter(|field| *field > 0.0).collect()
}

/// Returns the median, which is the upper one of two middle values; `None` without a value.
fn upper_median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Returns the fault of the largest of these values.
fn implausible(
    vector: Vector,
    first_column: usize,
    unit: &'static str,
    meant: &'static str,
) -> LogFault {
    let largest = (0..3).fold(0, |best, axis| {
        if vector[axis].abs() > vector[best].abs() {
            axis
        } else {
            best
        }
    });
    LogFault::Implausible {
        column: COLUMNS[first_column + largest],
        value: vector[largest],
        unit,
        meant,
    }
}
