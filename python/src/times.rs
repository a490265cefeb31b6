//! Times of rows: whole microseconds, of whatever type. Those in another unit are refused. Those of
//! a clock of 32 bits are counted on where it begins again.

use std::collections::VecDeque;

use aplomb_recordings::rate::ROWS_AHEAD;
use aplomb_recordings::wrap::Wraps;
use numpy::{
    AllowTypeChange, PyArrayDescrMethods as _, PyArrayLike1, PyUntypedArray,
    PyUntypedArrayMethods as _,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Shortest usual step, µs: the fastest sensors give 32,000 samples a second.
const SHORTEST_STEP_US: f64 = 31.0;
/// Fewest steps that show the usual step.
const FEWEST_STEPS: usize = 7;
/// Largest factor between the usual step and that of the rate. Units are a thousand apart, so the
/// limit is the root of a thousand.
const LARGEST_FACTOR: f64 = 31.6;
/// Largest share of a step that rounding may change: a tenth.
const LARGEST_ROUNDING: f64 = 0.1;

/// Reads an array of times, in any order of memory.
///
/// Raises ValueError if they are not whole microseconds, with what to pass.
pub fn times_us(times: &Bound<'_, PyAny>) -> PyResult<Vec<i64>> {
    let numpy = times.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (times,))?;
    let array = array.cast_into::<PyUntypedArray>()?;
    if array.ndim() != 1 {
        let dimensions = array.ndim();
        return Err(PyValueError::new_err(format!(
            "t_us has {dimensions} dimensions and needs one"
        )));
    }
    let dtype = array.dtype();
    match dtype.kind() {
        b'i' => {
            let times: PyArrayLike1<'_, i64, AllowTypeChange> = array.extract()?;
            Ok(times.as_array().to_vec())
        }
        b'u' => {
            let times: PyArrayLike1<'_, u64, AllowTypeChange> = array.extract()?;
            let times = times.as_array();
            let signed = times
                .iter()
                .map(|time| i64::try_from(*time).map_err(|_| too_large(time)));
            signed.collect()
        }
        b'f' => {
            let times: PyArrayLike1<'_, f64, AllowTypeChange> = array.extract()?;
            let times = times.as_array().to_vec();
            let whole = whole(&times)?;
            resolved(&times, dtype.itemsize())?;
            Ok(whole)
        }
        kind @ (b'M' | b'm') => {
            let name = if kind == b'M' {
                "datetime64"
            } else {
                "timedelta64"
            };
            Err(PyValueError::new_err(format!(
                "t_us is {dtype}, and whole microseconds are needed: \
                 pass t.astype('{name}[us]').astype(np.int64)"
            )))
        }
        _ => Err(PyValueError::new_err(format!(
            "t_us is an array of {dtype}, and whole microseconds are needed: pass int64"
        ))),
    }
}

/// Converts times with decimals, which have to be whole numbers of microseconds.
fn whole(times: &[f64]) -> PyResult<Vec<i64>> {
    let mut whole = Vec::with_capacity(times.len());
    for time in times {
        if !time.is_finite() {
            return Err(PyValueError::new_err(format!(
                "t_us has {}, which is no time",
                time.to_string().to_lowercase()
            )));
        }
        if time.fract() != 0.0 {
            return Err(PyValueError::new_err(format!(
                "t_us has {time}, and whole microseconds are needed: of times in seconds pass \
                 np.round(t * 1e6).astype(np.int64), in milliseconds \
                 np.round(t * 1e3).astype(np.int64)"
            )));
        }
        // Beyond ±2⁶³ a cast saturates.
        if time.abs() >= 9.2e18 {
            return Err(too_large(&format!("{time:e}").replace('e', "e+")));
        }
        whole.push(*time as i64);
    }
    match usual_step(times) {
        Some(step) if step < SHORTEST_STEP_US => Err(PyValueError::new_err(format!(
            "the time between rows is mostly {step}, where 31 µs or more are usual: of times in \
             seconds pass np.round(t * 1e6).astype(np.int64), in milliseconds \
             np.round(t * 1e3).astype(np.int64)"
        ))),
        _ => Ok(whole),
    }
}

/// Returns the median of the steps forward.
fn usual_step(times: &[f64]) -> Option<f64> {
    let steps = times.windows(2).map(|pair| pair[1] - pair[0]);
    let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
    steps.sort_unstable_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// Refuses times of a type with so many bytes, if it rounds them by too much of a step.
fn resolved(times: &[f64], bytes: usize) -> PyResult<()> {
    let digits = match bytes {
        4 => f32::MANTISSA_DIGITS,
        2 => 11,
        _ => return Ok(()),
    };
    let largest = times
        .iter()
        .fold(1.0, |largest: f64, time| largest.max(time.abs()));
    let rounding = largest.log2().floor().exp2() / f64::from(1_u32 << (digits - 1));
    match usual_step(times) {
        Some(step) if rounding > LARGEST_ROUNDING * step => Err(PyValueError::new_err(format!(
            "t_us is float{}, which rounds {largest} to {rounding} µs, and the time between rows \
             is mostly {step} µs: take int64 or float64 where the times come from",
            8 * bytes
        ))),
        _ => Ok(()),
    }
}

/// Counts times on where a clock of 32 bits begins again. Returns whether it does.
pub fn count_on(times: &mut [i64]) -> bool {
    let (mut wraps, mut has_wrapped) = (Wraps::default(), false);
    for time in times {
        let (counted, wraps_here) = wraps.count(*time);
        *time = counted;
        has_wrapped |= wraps_here;
    }
    has_wrapped
}

/// Refuses times that mostly decrease. The flags show single ones that do.
pub fn check_order(times: &[i64]) -> PyResult<()> {
    let back = times.windows(2).filter(|pair| pair[1] < pair[0]).count();
    let forward = times.windows(2).filter(|pair| pair[1] > pair[0]).count();
    if back <= forward {
        return Ok(());
    }
    Err(PyValueError::new_err(
        "t_us mostly decreases: sort all rows by time, as np.argsort(t_us, kind='stable') orders \
         them. If it is right, add check_units=False",
    ))
}

/// Refuses times whose first steps are not those of the rate.
pub fn check_rate(times: &[i64], rate_hz: f64) -> PyResult<()> {
    let first = &times[..times.len().min(ROWS_AHEAD)];
    let pairs = first.windows(2).filter(|pair| pair[1] > pair[0]);
    check_steps(
        pairs.map(|pair| pair[1].abs_diff(pair[0])).collect(),
        rate_hz,
    )
}

/// Refuses steps, µs, whose median is far from the period of the rate. Too few show nothing.
fn check_steps(mut steps: Vec<u64>, rate_hz: f64) -> PyResult<()> {
    if steps.len() < FEWEST_STEPS {
        return Ok(());
    }
    steps.sort_unstable();
    let (step, period_us) = (steps[steps.len() / 2], 1e6 / rate_hz);
    let factor = period_us / step as f64;
    let instead = if factor > LARGEST_FACTOR * 1e3 {
        "of times in seconds pass t * 1e6, rounded,"
    } else if factor > LARGEST_FACTOR {
        "of times in milliseconds pass t * 1000,"
    } else if factor < 1.0 / LARGEST_FACTOR {
        "of times in nanoseconds pass t // 1000,"
    } else {
        return Ok(());
    };
    Err(PyValueError::new_err(format!(
        "the time between rows is mostly {step} µs, and rate_hz={rate_hz} means {period_us:.0} \
         µs: {instead} or correct rate_hz"
    )))
}

/// Times of one sample after the other.
#[derive(Default)]
pub struct SingleTimes {
    wraps: Wraps,
    last_us: Option<i64>,
    /// First steps forward, µs, until they have shown the rate.
    steps: VecDeque<u64>,
    is_checked: bool,
}

impl SingleTimes {
    /// Takes the next time. Returns it counted on where a clock of 32 bits has begun again.
    ///
    /// Raises ValueError while the first steps are not those of the rate.
    pub fn next(&mut self, time_us: i64, rate_hz: f64) -> PyResult<i64> {
        let (time_us, _) = self.wraps.count(time_us);
        if self.is_checked {
            return Ok(time_us);
        }
        let last_us = self.last_us.replace(time_us).unwrap_or(time_us);
        if time_us > last_us {
            self.steps.push_back(time_us.abs_diff(last_us));
        }
        if self.steps.len() > FEWEST_STEPS {
            self.steps.pop_front();
        }
        check_steps(self.steps.iter().copied().collect(), rate_hz)?;
        self.is_checked = self.steps.len() == FEWEST_STEPS;
        Ok(time_us)
    }
}

fn too_large(time: &impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(format!("t_us has {time}, which is no time in microseconds"))
}

/// Reads one time, µs.
///
/// Raises TypeError if it is not an integer.
pub fn time_us(time: &Bound<'_, PyAny>) -> PyResult<i64> {
    time.extract().map_err(|_| {
        PyTypeError::new_err(format!(
            "t_us is {time}, and whole microseconds are needed: of seconds pass round(t * 1e6)"
        ))
    })
}
