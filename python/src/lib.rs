//! aplomb from Python. Nothing is estimated here: the module converts, and calls the library. So a
//! recording gives the bits of `aplomb replay`.

mod attitudes;
mod copies;
mod kalman;
mod recording;
mod times;
mod units;
mod vectors;

use numpy::{PyArray1, PyArrayMethods as _};
use pyo3::prelude::*;

/// Attitude from an inertial sensor: a Kalman filter with sigma and flags.
#[pymodule]
mod aplomb {
    #[pymodule_export]
    use super::attitudes::{Attitude, Attitudes, flag_names};
    #[pymodule_export]
    use super::kalman::Kalman;
    #[pymodule_export]
    use super::recording::{Recording, calibrate_accelerometer, read_log, simulate};

    use super::{Bound, PyModule, PyModuleMethods as _, PyResult, touch_numpy};
    use library::health::Flags;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        touch_numpy(module.py())?;
        for (name, flag) in Flags::all().iter_names() {
            module.add(name, flag.bits())?;
        }
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}

/// Loads the parts of NumPy that arrays need. Their first use panics if it is interrupted, such as
/// by Ctrl-C.
fn touch_numpy(python: Python<'_>) -> PyResult<()> {
    python.import("numpy")?;
    let array = PyArray1::<f64>::zeros(python, 1, false);
    let _ = array.try_readonly();
    Ok(())
}
