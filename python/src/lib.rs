//! aplomb from Python. Nothing is estimated here: the module converts, and calls the library. So a
//! recording gives the bits of `aplomb replay`.

mod kalman;
mod recording;
mod times;

use pyo3::prelude::*;

/// Attitude from an inertial sensor: a Kalman filter with sigma and flags.
#[pymodule]
mod aplomb {
    #[pymodule_export]
    use super::kalman::{Attitude, Attitudes, Kalman, flag_names};
    #[pymodule_export]
    use super::recording::{Recording, calibrate_accelerometer, read_log, simulate};

    use super::{Bound, PyModule, PyModuleMethods as _, PyResult};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
