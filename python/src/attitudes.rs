//! Attitudes: one, and those of a recording as arrays.

use library::attitude::Quaternion;
use library::estimator::heading::HeadingEstimate;
use library::health::Flags;
use library::pipeline::{Pipeline, Snapshot};
use numpy::{PyArray1, PyArray2, PyArrayMethods as _};
use pyo3::prelude::*;

use crate::copies::not_pickled;

/// Attitude at one sample: forward, right, down against north, east, down.
#[pyclass(module = "aplomb", frozen, get_all)]
pub struct Attitude {
    /// Time of the sample, microseconds.
    pub t_us: i64,
    /// Body to earth: (w, x, y, z).
    pub quaternion: (f32, f32, f32, f32),
    /// Right wing down positive, rad.
    pub roll_rad: f32,
    /// Nose up positive, rad.
    pub pitch_rad: f32,
    /// Clockwise from above positive, rad, relative to the heading at start.
    pub yaw_rad: f32,
    /// Body rates p, q, r without bias, rad/s.
    pub rates_rad_s: (f32, f32, f32),
    /// Sigma of the direction of down, both axes together, rad.
    pub tilt_sigma_rad: f32,
    /// Gyroscope bias about the body's axes, rad/s.
    pub bias_rad_s: (f32, f32, f32),
    /// Flags as a number; `flag_names` gives their names.
    pub flags: u32,
    /// Direction of forward, clockwise from north, rad; None while it is unknown.
    pub heading_rad: Option<f32>,
    /// Sigma of the heading, rad; None while it is unknown.
    pub heading_sigma_rad: Option<f32>,
    /// Heading minus yaw, rad; None while it is unknown.
    pub yaw_offset_rad: Option<f32>,
}

#[pymethods]
impl Attitude {
    /// True if the tilt is wrong by no more than the larger of 5 degrees and six sigma.
    #[getter]
    fn is_valid(&self) -> bool {
        Flags::from_bits_retain(self.flags).contains(Flags::VALID)
    }

    /// True if the heading is wrong by no more than the larger of 15 degrees and six sigma.
    #[getter]
    fn is_heading_valid(&self) -> bool {
        Flags::from_bits_retain(self.flags).contains(Flags::HEADING_VALID)
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(not_pickled("an Attitude", "keep the numbers that you need"))
    }

    fn __repr__(&self) -> String {
        let [roll, pitch, yaw] = [self.roll_rad, self.pitch_rad, self.yaw_rad].map(f32::to_degrees);
        let flags = Flags::from_bits_retain(self.flags);
        format!(
            "Attitude(t_us={}, roll={roll:.2}°, pitch={pitch:.2}°, yaw={yaw:.2}°, {flags})",
            self.t_us
        )
    }
}

/// Attitudes of a recording: one row for each sample.
#[pyclass(module = "aplomb", frozen)]
pub struct Attitudes {
    /// Times, microseconds: int64, shape (n,).
    #[pyo3(get)]
    t_us: Py<PyArray1<i64>>,
    /// Body to earth, w x y z: float32, shape (n, 4).
    #[pyo3(get)]
    quaternion: Py<PyArray2<f32>>,
    /// Body rates p, q, r without bias, rad/s: float32, shape (n, 3).
    #[pyo3(get)]
    rates_rad_s: Py<PyArray2<f32>>,
    /// Sigma of the direction of down, rad: float32, shape (n,).
    #[pyo3(get)]
    tilt_sigma_rad: Py<PyArray1<f32>>,
    /// Gyroscope bias about the body's axes, rad/s: float32, shape (n, 3).
    #[pyo3(get)]
    bias_rad_s: Py<PyArray2<f32>>,
    /// Flags as numbers: uint32, shape (n,).
    #[pyo3(get)]
    flags: Py<PyArray1<u32>>,
    /// Heading, its sigma, and heading minus yaw; None for a run without a compass.
    headings: Option<[Py<PyArray1<f32>>; 3]>,
}

#[pymethods]
impl Attitudes {
    /// Direction of forward, clockwise from north, rad, NaN while unknown: float32, shape (n,).
    #[getter]
    fn heading_rad(&self, python: Python<'_>) -> PyResult<Py<PyArray1<f32>>> {
        self.heading_column(python, 0)
    }

    /// Sigma of the heading, rad, NaN while unknown: float32, shape (n,).
    #[getter]
    fn heading_sigma_rad(&self, python: Python<'_>) -> PyResult<Py<PyArray1<f32>>> {
        self.heading_column(python, 1)
    }

    /// Heading minus yaw, rad, NaN while unknown: float32, shape (n,).
    #[getter]
    fn yaw_offset_rad(&self, python: Python<'_>) -> PyResult<Py<PyArray1<f32>>> {
        self.heading_column(python, 2)
    }

    /// True where the tilt is wrong by no more than the larger of 5 degrees and six sigma: bool,
    /// shape (n,). Computed at each access.
    #[getter]
    fn is_valid<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        self.have(python, Flags::VALID)
    }

    /// True where the heading is wrong by no more than the larger of 15 degrees and six sigma:
    /// bool, shape (n,). Computed at each access.
    #[getter]
    fn is_heading_valid<'py>(&self, python: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        self.have(python, Flags::HEADING_VALID)
    }

    fn __len__(&self, python: Python<'_>) -> PyResult<usize> {
        self.t_us.bind(python).len()
    }

    fn __repr__(&self, python: Python<'_>) -> PyResult<String> {
        let valid = self.have(python, Flags::VALID).readonly();
        let count = valid.as_array().len();
        let valid = valid.as_array().iter().filter(|state| **state).count();
        Ok(format!("Attitudes({count} rows, {valid} valid)"))
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(not_pickled(
            "an Attitudes",
            "save its arrays, with np.savez",
        ))
    }

    /// Roll, pitch, yaw, rad: float32, shape (n, 3). Computed at each access.
    #[getter]
    fn euler_rad<'py>(&self, python: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let quaternion = self.quaternion.bind(python).readonly();
        let table = quaternion.as_array();
        let mut angles = Vec::with_capacity(3 * table.nrows());
        for row in table.rows() {
            let (w, x, y, z) = (row[0], row[1], row[2], row[3]);
            let euler = Quaternion { w, x, y, z }.to_euler();
            angles.extend([euler.roll_rad, euler.pitch_rad, euler.yaw_rad]);
        }
        PyArray1::from_vec(python, angles).reshape([table.nrows(), 3])
    }
}

impl Attitudes {
    /// Returns which rows have a flag.
    fn have<'py>(&self, python: Python<'py>, flag: Flags) -> Bound<'py, PyArray1<bool>> {
        let flags = self.flags.bind(python).readonly();
        let has = |bits: &u32| Flags::from_bits_retain(*bits).contains(flag);
        PyArray1::from_vec(python, flags.as_array().iter().map(has).collect())
    }

    /// Returns a column of `headings`. A run without a compass pays for NaN only if asked.
    fn heading_column(&self, python: Python<'_>, place: usize) -> PyResult<Py<PyArray1<f32>>> {
        let column = self
            .headings
            .as_ref()
            .and_then(|columns| columns.get(place));
        if let Some(column) = column {
            return Ok(column.clone_ref(python));
        }
        let count = self.t_us.bind(python).len()?;
        Ok(PyArray1::from_vec(python, vec![f32::NAN; count]).unbind())
    }
}

/// Columns of the attitudes of a recording.
pub struct Columns {
    quaternion: Vec<[f32; 4]>,
    rates_rad_s: Vec<[f32; 3]>,
    tilt_sigma_rad: Vec<f32>,
    bias_rad_s: Vec<[f32; 3]>,
    flags: Vec<u32>,
    /// Heading, its sigma, and heading minus yaw, of a run with a compass.
    headings: Option<[Vec<f32>; 3]>,
}

impl Columns {
    /// Returns empty columns for this number of rows.
    pub fn with_capacity(count: usize, has_compass: bool) -> Self {
        let single = || Vec::with_capacity(count);
        Self {
            quaternion: Vec::with_capacity(count),
            rates_rad_s: Vec::with_capacity(count),
            tilt_sigma_rad: single(),
            bias_rad_s: Vec::with_capacity(count),
            flags: Vec::with_capacity(count),
            headings: has_compass.then(|| [single(), single(), single()]),
        }
    }

    /// Adds a row.
    pub fn push(
        &mut self,
        snapshot: &Snapshot,
        pipeline: &Pipeline,
        heading: Option<HeadingEstimate>,
    ) {
        let (q, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
        let bias = pipeline.kalman().bias_rad_s();
        self.quaternion.push([q.w, q.x, q.y, q.z]);
        self.rates_rad_s.push([rates.x, rates.y, rates.z]);
        self.tilt_sigma_rad.push(snapshot.tilt_sigma_rad());
        self.bias_rad_s.push([bias.x, bias.y, bias.z]);
        self.flags.push(snapshot.flags.bits());
        let Some(headings) = &mut self.headings else {
            return;
        };
        let row = heading.map_or([f32::NAN; 3], |heading| {
            let angle = heading.heading_rad(snapshot.euler().yaw_rad);
            [angle, heading.sigma_rad, heading.yaw_offset_rad]
        });
        for (column, value) in headings.iter_mut().zip(row) {
            column.push(value);
        }
    }

    /// Makes arrays of the columns, beside these times.
    pub fn into_arrays(self, python: Python<'_>, times: Vec<i64>) -> PyResult<Attitudes> {
        Ok(Attitudes {
            quaternion: table(python, self.quaternion)?,
            rates_rad_s: table(python, self.rates_rad_s)?,
            bias_rad_s: table(python, self.bias_rad_s)?,
            t_us: PyArray1::from_vec(python, times).unbind(),
            tilt_sigma_rad: PyArray1::from_vec(python, self.tilt_sigma_rad).unbind(),
            flags: PyArray1::from_vec(python, self.flags).unbind(),
            headings: self
                .headings
                .map(|columns| columns.map(|column| PyArray1::from_vec(python, column).unbind())),
        })
    }
}

/// Makes an array of shape (n, `COLUMNS`).
fn table<const COLUMNS: usize>(
    python: Python<'_>,
    rows: Vec<[f32; COLUMNS]>,
) -> PyResult<Py<PyArray2<f32>>> {
    let shape = [rows.len(), COLUMNS];
    let array = PyArray1::from_vec(python, rows.into_flattened());
    Ok(array.reshape(shape)?.unbind())
}

/// Returns the names of flags, such as "VALID|DEGRADED".
#[pyfunction]
pub fn flag_names(flags: u32) -> String {
    Flags::from_bits_truncate(flags).to_string()
}
