//! Arrays and sequences of three numbers a row. A wrong shape is refused by the argument's name.

use numpy::ndarray::ArrayView2;
use numpy::{AllowTypeChange, PyArrayLike2, PyUntypedArray, PyUntypedArrayMethods as _};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Array of rows of three numbers.
pub struct Vectors<'py>(PyArrayLike2<'py, f64, AllowTypeChange>);

impl<'py> Vectors<'py> {
    /// Reads an argument of shape (n, 3). Any type of number is converted.
    ///
    /// Raises ValueError with the name if it has another shape, or is no array of numbers.
    pub fn new(argument: &Bound<'py, PyAny>, name: &str) -> PyResult<Self> {
        let array = argument.extract().map_err(|error| {
            let reason = match shape(argument) {
                Ok(shape) if shape.len() != 2 => format!("has the shape {}", tuple(&shape)),
                _ => format!("cannot be converted: {error}"),
            };
            PyValueError::new_err(format!("{name} {reason}, and needs (n, 3)"))
        });
        let vectors = Self(array?);
        match vectors.view().ncols() {
            3 => Ok(vectors),
            columns => Err(PyValueError::new_err(format!(
                "{name} has {columns} columns and needs three: x, y, z"
            ))),
        }
    }

    /// Reads an argument of shape (`count`, 3).
    pub fn of_count(argument: &Bound<'py, PyAny>, name: &str, count: usize) -> PyResult<Self> {
        let vectors = Self::new(argument, name)?;
        let rows = vectors.view().nrows();
        if rows == count {
            return Ok(vectors);
        }
        Err(PyValueError::new_err(format!(
            "t_us has {count} rows and {name} {rows}: they need equal numbers"
        )))
    }

    /// Returns the rows as they are.
    pub fn view(&self) -> ArrayView2<'_, f64> {
        self.0.as_array()
    }

    /// Returns a copy of the rows.
    pub fn rows(&self) -> Vec<[f64; 3]> {
        let view = self.view();
        (0..view.nrows()).map(|row| vector(view, row)).collect()
    }
}

/// Returns a row of an array of shape (n, 3).
pub fn vector(array: ArrayView2<'_, f64>, row: usize) -> [f64; 3] {
    [array[(row, 0)], array[(row, 1)], array[(row, 2)]]
}

/// Reads an argument of three numbers.
///
/// Raises ValueError with the name if it is something else.
pub fn three(argument: &Bound<'_, PyAny>, name: &str) -> PyResult<[f64; 3]> {
    argument.extract().map_err(|error: PyErr| {
        PyValueError::new_err(format!("{name} needs three numbers, x, y, z: {error}"))
    })
}

fn shape(argument: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    let numpy = argument.py().import("numpy")?;
    let array = numpy.call_method1("asarray", (argument,))?;
    Ok(array.cast::<PyUntypedArray>()?.shape().to_vec())
}

/// Writes a shape as Python does.
fn tuple(shape: &[usize]) -> String {
    match shape {
        [length] => format!("({length},)"),
        _ => {
            let lengths: Vec<String> = shape.iter().map(usize::to_string).collect();
            format!("({})", lengths.join(", "))
        }
    }
}
