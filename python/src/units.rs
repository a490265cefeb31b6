//! Units of the arrays of a run, by the size of their numbers: the guards of `read_log`, with
//! messages that say what to pass instead.

use std::ffi::CString;

use aplomb_recordings::log::{LogFault, Row};
use aplomb_recordings::unit_check::{ROWS_TOGETHER, UnitCheck};
use aplomb_recordings::units::{RowOptions, TimeUnit};
use numpy::ndarray::ArrayView2;
use pyo3::exceptions::{PyUserWarning, PyValueError};
use pyo3::prelude::*;

use crate::times::{check_order, check_rate};
use crate::vectors::vector;

/// Advice on register counts for Python.
pub const INSTEAD_OF_COUNTS: &str = "(multiply them by full scale / 32768)";

/// Options that messages name, and what an array needs instead. Those with a bracket come first.
const INSTEAD: [(&str, &str); 17] = [
    ("(--time-unit ms)", "(pass t_us * 1000)"),
    ("(--time-unit ns)", "(pass t_us // 1000)"),
    ("(--force-unit g)", "(pass accel * 9.80665)"),
    ("(--force-unit mg)", "(pass accel * 0.00980665)"),
    ("(--rate-unit deg/s)", "(pass np.radians(gyro))"),
    ("(--field-unit T)", "(pass mag * 1e6)"),
    ("(--field-unit G)", "(pass mag * 100)"),
    ("(--field-unit norm)", "(pass mag * 50)"),
    ("(--raw)", INSTEAD_OF_COUNTS),
    (
        "(add --raw and both ranges, for replay, plot and calibrate)",
        INSTEAD_OF_COUNTS,
    ),
    (" (--rate-unit)", ""),
    (
        "add --time-unit ms, else --time-unit us",
        "pass t_us * 1000, else add check_units=False",
    ),
    ("add --field-unit mG", "pass mag * 0.1"),
    ("--time-unit us", "check_units=False"),
    ("--force-unit m/s2", "check_units=False"),
    ("--rate-unit rad/s", "check_units=False"),
    ("--field-unit uT", "check_units=False"),
];

/// Writes the options of the program in a message as what to pass.
fn for_arrays(mut message: String) -> String {
    for (option, instead) in INSTEAD {
        message = message.replace(option, instead);
    }
    message
}

/// Check of a run's arrays.
pub struct Units(UnitCheck);

impl Units {
    /// Checks the order of the times, and the first rows together. A rate that is known shows the
    /// unit of the times.
    ///
    /// Raises ValueError if the numbers suggest another unit, or exchanged arrays.
    pub fn new(
        times: &[i64],
        rate_hz: Option<f64>,
        gyro: ArrayView2<'_, f64>,
        accel: ArrayView2<'_, f64>,
        mag: Option<ArrayView2<'_, f64>>,
    ) -> PyResult<Self> {
        check_order(times)?;
        let mut options = RowOptions::default();
        if let Some(rate_hz) = rate_hz {
            check_rate(times, rate_hz)?;
            options.time_unit = Some(TimeUnit::Microseconds);
        }
        let row = |(row, time_us): (usize, &i64)| Row {
            time_us: *time_us,
            specific_force_m_s2: vector(accel, row),
            rates_rad_s: vector(gyro, row),
            field_ut: mag
                .map(|mag| vector(mag, row))
                .filter(|field| field.iter().all(|value| value.is_finite())),
            attitude: None,
            scored: false,
            armed: None,
        };
        let first = times.iter().take(ROWS_TOGETHER).enumerate();
        let first: Vec<Row> = first.map(row).collect();
        let check = UnitCheck::new(&first, options);
        check.map(Self).map_err(|fault| refusal(&fault, None))
    }

    /// Checks a row: its number, time, rates and force, and whether one of them reads full scale.
    ///
    /// Raises ValueError if the numbers suggest another unit.
    pub fn row(
        &mut self,
        row: usize,
        time_us: i64,
        [gyro, accel]: [[f64; 3]; 2],
        is_saturated: bool,
    ) -> PyResult<()> {
        let checked = self.0.row(time_us, accel, gyro, is_saturated);
        checked.map_err(|fault| refusal(&fault, Some(row)))
    }

    /// Judges the arrays as a whole, and warns with UserWarning.
    ///
    /// Raises ValueError if the numbers suggest another unit.
    pub fn end(self, python: Python<'_>) -> PyResult<()> {
        let warnings = self.0.end().map_err(|fault| refusal(&fault, None))?;
        let mut warnings = warnings.into_iter();
        warnings.try_for_each(|warning| warn(python, for_arrays(warning)))
    }
}

/// Warns with UserWarning.
pub fn warn(python: Python<'_>, text: String) -> PyResult<()> {
    let category = python.get_type::<PyUserWarning>();
    let text = CString::new(text.replace('\0', " "))?;
    PyErr::warn(python, &category, &text, 1)
}

/// Returns the error for a fault, of one row if it has a number.
fn refusal(fault: &LogFault, row: Option<usize>) -> PyErr {
    let mut text = for_arrays(fault.to_string());
    if let (LogFault::Implausible { .. }, Some(row)) = (fault, row) {
        text = format!("in row {row} {text} If it is right, add check_units=False");
    }
    PyValueError::new_err(text)
}
