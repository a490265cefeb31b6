//! Refusal of copies and of pickling.

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

/// Returns the error for what can be neither pickled nor copied.
pub fn not_pickled(what: &str, instead: &str) -> PyErr {
    PyTypeError::new_err(format!("{what} cannot be pickled or copied: {instead}"))
}
