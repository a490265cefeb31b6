//! Units of a recording's columns, and how rows that no sensor gave are treated: the options of
//! every program that reads recordings.

use std::fmt;
use std::str::FromStr;

use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::units::{DEGREES_PER_RADIAN, STANDARD_GRAVITY_M_S2};

use crate::row::Row;

/// Options for reading a recording. Nothing given: µs, m/s², rad/s and µT, guarded against other
/// units, and a bad row is an error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "options", derive(clap::Args))]
pub struct RowOptions {
    /// The recording's times are in this unit: us, ms, s or ns [default: us]
    #[cfg_attr(feature = "options", arg(long, value_name = "UNIT"))]
    pub time_unit: Option<TimeUnit>,
    /// The recording's specific force is in this unit: m/s2, g or mg [default: m/s2]
    #[cfg_attr(feature = "options", arg(long, value_name = "UNIT"))]
    pub force_unit: Option<ForceUnit>,
    /// The recording's rates are in this unit: rad/s, deg/s or mdeg/s [default: rad/s]
    #[cfg_attr(feature = "options", arg(long, value_name = "UNIT"))]
    pub rate_unit: Option<RateUnit>,
    /// The recording's magnetic field is in this unit: uT, mG, G, nT, T, or norm for length 1,
    /// which is taken as 50 uT [default: uT]
    #[cfg_attr(feature = "options", arg(long, value_name = "UNIT"))]
    pub field_unit: Option<FieldUnit>,
    /// Rows of the recording that are damaged, or that no sensor gave (time that goes back, gaps of
    /// more than an hour, NaN): refuse, skip, or keep those with numbers [default: refuse]
    #[cfg_attr(feature = "options", arg(long, value_name = "RULE"))]
    pub bad_rows: Option<BadRows>,
}

/// Rule for rows that no sensor gave.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BadRows {
    /// A bad row is an error.
    #[default]
    Refuse,
    /// Bad rows are left out and counted.
    Skip,
    /// Numbers may have any value, and times any order. A row that cannot be read is an error, and
    /// so are rates that suggest another unit.
    Keep,
}

/// Unit of times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeUnit {
    /// µs.
    Microseconds,
    /// ms.
    Milliseconds,
    /// s.
    Seconds,
    /// ns.
    Nanoseconds,
}

/// Unit of the specific force.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ForceUnit {
    /// m/s².
    MetresPerSecondSquared,
    /// g.
    G,
    /// 1/1000 g.
    MilliG,
}

/// Unit of rates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RateUnit {
    /// rad/s.
    RadiansPerSecond,
    /// °/s.
    DegreesPerSecond,
    /// 1/1000 °/s.
    MillidegreesPerSecond,
}

/// Unit of the magnetic field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldUnit {
    /// µT.
    Microtesla,
    /// 1/1000 gauss, which is 0.1 µT.
    Milligauss,
    /// Gauss, which is 100 µT.
    Gauss,
    /// nT.
    Nanotesla,
    /// T.
    Tesla,
    /// Length of the earth's field, taken as 50 µT.
    Normalized,
}

impl FieldUnit {
    /// Returns the unit's size, µT.
    const fn microtesla(self) -> f64 {
        match self {
            Self::Microtesla => 1.0,
            Self::Milligauss => 0.1,
            Self::Gauss => 100.0,
            Self::Nanotesla => 1e-3,
            Self::Tesla => 1e6,
            Self::Normalized => 50.0,
        }
    }
}

impl RowOptions {
    /// Returns the options, and whether they were given.
    #[must_use]
    pub fn given(&self) -> [(&'static str, bool); 5] {
        [
            ("--time-unit", self.time_unit.is_some()),
            ("--force-unit", self.force_unit.is_some()),
            ("--rate-unit", self.rate_unit.is_some()),
            ("--field-unit", self.field_unit.is_some()),
            ("--bad-rows", self.bad_rows.is_some()),
        ]
    }

    /// Reads a time, µs. Without a unit it is a whole number of microseconds.
    pub(crate) fn time_us(&self, cell: &str) -> Option<i64> {
        let whole: Option<i64> = cell.parse().ok();
        let per_unit = match (self.time_unit, whole) {
            (None | Some(TimeUnit::Microseconds), Some(_)) => return whole,
            (None, None) => return None,
            (Some(TimeUnit::Milliseconds), Some(whole)) => return whole.checked_mul(1_000),
            (Some(TimeUnit::Seconds), Some(whole)) => return whole.checked_mul(1_000_000),
            (Some(TimeUnit::Nanoseconds), Some(whole)) => return Some(whole.div_euclid(1_000)),
            (Some(TimeUnit::Microseconds), None) => 1.0,
            (Some(TimeUnit::Milliseconds), None) => 1e3,
            (Some(TimeUnit::Seconds), None) => 1e6,
            (Some(TimeUnit::Nanoseconds), None) => 1e-3,
        };
        let time_us: f64 = cell.parse::<f64>().ok()? * per_unit;
        // Whole numbers beyond ±2⁶² would lose more than microseconds.
        (time_us.abs() < 4.6e18).then(|| time_us.round() as i64)
    }

    /// Returns the unit of the magnetic field, µT.
    pub(crate) fn field_ut(&self) -> f64 {
        let unit = self.field_unit.unwrap_or(FieldUnit::Microtesla);
        unit.microtesla()
    }

    /// Converts the values of a row to m/s² and rad/s.
    pub(crate) fn convert(&self, row: &mut Row) {
        let gravity = f64::from(STANDARD_GRAVITY_M_S2);
        let force = match self.force_unit {
            None | Some(ForceUnit::MetresPerSecondSquared) => 1.0,
            Some(ForceUnit::G) => gravity,
            Some(ForceUnit::MilliG) => gravity * 1e-3,
        };
        let rate = match self.rate_unit {
            None | Some(RateUnit::RadiansPerSecond) => 1.0,
            Some(RateUnit::DegreesPerSecond) => 1.0 / f64::from(DEGREES_PER_RADIAN),
            Some(RateUnit::MillidegreesPerSecond) => 1e-3 / f64::from(DEGREES_PER_RADIAN),
        };
        if force != 1.0 {
            row.specific_force_m_s2 = row.specific_force_m_s2.map(|value| value * force);
        }
        if rate != 1.0 {
            row.rates_rad_s = row.rates_rad_s.map(|value| value * rate);
        }
    }
}

/// Error of a name that is none of the choices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoSuchChoice(&'static str);

impl fmt::Display for NoSuchChoice {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "choose one of {}", self.0)
    }
}

impl std::error::Error for NoSuchChoice {}

/// Returns the choice of this name. `names` lists all names in the message of an error.
fn choose<T: Copy>(
    name: &str,
    choices: &[(&str, T)],
    names: &'static str,
) -> Result<T, NoSuchChoice> {
    let found = choices.iter().find(|(known, _)| *known == name);
    found.map(|(_, choice)| *choice).ok_or(NoSuchChoice(names))
}

impl FromStr for TimeUnit {
    type Err = NoSuchChoice;

    fn from_str(name: &str) -> Result<Self, NoSuchChoice> {
        let choices = [
            ("us", Self::Microseconds),
            ("µs", Self::Microseconds),
            ("ms", Self::Milliseconds),
            ("s", Self::Seconds),
            ("ns", Self::Nanoseconds),
        ];
        choose(name, &choices, "us, ms, s, ns")
    }
}

impl FromStr for ForceUnit {
    type Err = NoSuchChoice;

    fn from_str(name: &str) -> Result<Self, NoSuchChoice> {
        let choices = [
            ("m/s2", Self::MetresPerSecondSquared),
            ("m/s²", Self::MetresPerSecondSquared),
            ("g", Self::G),
            ("mg", Self::MilliG),
        ];
        choose(name, &choices, "m/s2, g, mg")
    }
}

impl FromStr for RateUnit {
    type Err = NoSuchChoice;

    fn from_str(name: &str) -> Result<Self, NoSuchChoice> {
        let choices = [
            ("rad/s", Self::RadiansPerSecond),
            ("deg/s", Self::DegreesPerSecond),
            ("°/s", Self::DegreesPerSecond),
            ("dps", Self::DegreesPerSecond),
            ("mdeg/s", Self::MillidegreesPerSecond),
            ("mdps", Self::MillidegreesPerSecond),
        ];
        choose(name, &choices, "rad/s, deg/s, mdeg/s")
    }
}

impl FromStr for FieldUnit {
    type Err = NoSuchChoice;

    fn from_str(name: &str) -> Result<Self, NoSuchChoice> {
        let choices = [
            ("uT", Self::Microtesla),
            ("µT", Self::Microtesla),
            ("mG", Self::Milligauss),
            ("G", Self::Gauss),
            ("nT", Self::Nanotesla),
            ("T", Self::Tesla),
            ("norm", Self::Normalized),
        ];
        choose(name, &choices, "uT, mG, G, nT, T, norm")
    }
}

impl FromStr for BadRows {
    type Err = NoSuchChoice;

    fn from_str(name: &str) -> Result<Self, NoSuchChoice> {
        let choices = [
            ("refuse", Self::Refuse),
            ("skip", Self::Skip),
            ("keep", Self::Keep),
        ];
        choose(name, &choices, "refuse, skip, keep")
    }
}

/// Returns the knowledge of an accelerometer's offset of this name, for an option.
///
/// # Errors
///
/// Returns the names, for any other.
pub fn knowledge(name: &str) -> Result<AccelerometerKnowledge, NoSuchChoice> {
    AccelerometerKnowledge::from_name(name).ok_or(NoSuchChoice("factory, six-poses, calibrated"))
}
