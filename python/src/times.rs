//! Times of rows: whole microseconds, of whatever type. Those in another unit are refused.

use numpy::{
    AllowTypeChange, PyArrayDescrMethods as _, PyArrayLike1, PyUntypedArray,
    PyUntypedArrayMethods as _,
};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

/// Shortest usual step, µs: the fastest sensors give 32,000 samples a second.
const SHORTEST_STEP_US: f64 = 31.0;

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
            whole(&times)
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
    let steps = times.windows(2).map(|pair| pair[1] - pair[0]);
    let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
    steps.sort_unstable_by(f64::total_cmp);
    match steps.get(steps.len() / 2) {
        Some(step) if *step < SHORTEST_STEP_US => Err(PyValueError::new_err(format!(
            "the time between rows is mostly {step}, where 31 µs or more are usual: of times in \
             seconds pass np.round(t * 1e6).astype(np.int64), in milliseconds \
             np.round(t * 1e3).astype(np.int64)"
        ))),
        _ => Ok(whole),
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
