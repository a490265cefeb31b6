//! Recordings: read, simulated, and as a calibration.

use std::fmt::Display;
use std::path::PathBuf;
use std::str::FromStr;

use aplomb_models::motion::Motion;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::swing::Swing;
use aplomb_recordings::log::Log;
use aplomb_recordings::motion::truth_of;
use aplomb_recordings::simulated::{CONFIG, MOUNT, Simulated, samples};
use aplomb_recordings::units::{BadRows, RowOptions};
use library::attitude::Vector3;
use library::calibration::accelerometer::fit;
use library::estimator::kalman::AccelerometerKnowledge;
use library::units::STANDARD_GRAVITY_M_S2;
use numpy::{PyArray1, PyArray2, PyArrayMethods as _};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::copies::not_pickled;
use crate::units::{INSTEAD_OF_COUNTS, warn};
use crate::vectors::Vectors;

/// Longest simulation, s.
const LONGEST_FLIGHT_S: u64 = 86_400;
/// Samples that are simulated between two looks for Ctrl-C.
const BLOCK_SAMPLES: usize = 10_000;
/// Largest length of poses that are in g, not in m/s².
const LARGEST_POSE_IN_G: f64 = 2.0;
/// Largest length of poses in m/s². Those in mg or in counts are longer.
const LARGEST_POSE_M_S2: f64 = 20.0;

/// Recording of a sensor, in its own axes.
#[pyclass(module = "aplomb", frozen, get_all)]
pub struct Recording {
    /// Times, microseconds: int64, shape (n,).
    pub t_us: Py<PyArray1<i64>>,
    /// Specific force, m/s2: float64, shape (n, 3).
    pub accel: Py<PyArray2<f64>>,
    /// Angular rates, rad/s: float64, shape (n, 3).
    pub gyro: Py<PyArray2<f64>>,
    /// Magnetic field, microtesla, NaN where there is no new reading: float64, (n, 3); None if the
    /// recording has no compass.
    pub mag: Option<Py<PyArray2<f64>>>,
    /// True attitude, sensor to earth with z up, w x y z, NaN where unknown: float64, (n, 4).
    truth: Py<PyArray2<f64>>,
    /// True where the row counts for scores, as in the column mov: bool, shape (n,). Without that
    /// column all rows count, also those of a sensor at rest.
    scored: Py<PyArray1<bool>>,
    /// True where the vehicle is armed, as in the column armed: bool, shape (n,); None if the
    /// recording has no such state. `Kalman.run` takes it.
    pub armed: Option<Py<PyArray1<bool>>>,
    /// Knowledge of the accelerometer that the recording states: "factory", "six-poses" or
    /// "calibrated"; None without a line such as `# --accelerometer factory`.
    pub accelerometer: Option<&'static str>,
}

#[pymethods]
impl Recording {
    fn __len__(&self, python: Python<'_>) -> PyResult<usize> {
        self.t_us.bind(python).len()
    }

    fn __repr__(&self, python: Python<'_>) -> String {
        let times = self.t_us.bind(python).readonly();
        let times = times.as_array();
        let ends = times.first().zip(times.last());
        let seconds = ends.map_or(0.0, |(first, last)| last.abs_diff(*first) as f64 * 1e-6);
        let compass = if self.mag.is_some() {
            ", a compass"
        } else {
            ""
        };
        format!("Recording({} rows, {seconds:.1} s{compass})", times.len())
    }

    fn __reduce__(&self) -> PyResult<()> {
        let instead = "read it again, or save its arrays, with np.savez";
        Err(not_pickled("a Recording", instead))
    }
}

/// Returns the name of a knowledge, as `Kalman` takes it.
fn knowledge_name(knowledge: AccelerometerKnowledge) -> &'static str {
    match knowledge {
        AccelerometerKnowledge::Factory => "factory",
        AccelerometerKnowledge::SixPoses => "six-poses",
        AccelerometerKnowledge::Calibrated => "calibrated",
    }
}

/// Columns of a recording.
#[derive(Default)]
struct Columns {
    t_us: Vec<i64>,
    accel: Vec<f64>,
    gyro: Vec<f64>,
    mag: Vec<f64>,
    truth: Vec<f64>,
    scored: Vec<bool>,
    /// Empty if no row has a state.
    armed: Vec<bool>,
    accelerometer: Option<AccelerometerKnowledge>,
}

impl Columns {
    /// Adds simulated samples.
    fn simulate(&mut self, samples: impl Iterator<Item = Simulated>) {
        for sample in samples {
            let force = sample.raw.accelerometer.to_m_s2(CONFIG.accelerometer_range);
            let rates = sample.raw.gyroscope.to_rad_s(CONFIG.gyroscope_range);
            self.t_us.push(sample.t_us.cast_signed());
            self.accel
                .extend([force.x, force.y, force.z].map(f64::from));
            self.gyro.extend([rates.x, rates.y, rates.z].map(f64::from));
            let truth = sample
                .truth
                .attitude
                .map(|attitude| truth_of(attitude, MOUNT));
            let truth = truth.map_or([f64::NAN; 4], |q| [q.w, q.x, q.y, q.z]);
            self.truth.extend(truth);
            self.scored.push(sample.truth.scored);
        }
    }

    fn into_arrays(self, python: Python<'_>) -> PyResult<Recording> {
        let count = self.t_us.len();
        let table = |values: Vec<f64>, columns: usize| {
            let array = PyArray1::from_vec(python, values);
            Ok::<_, PyErr>(array.reshape([count, columns])?.unbind())
        };
        let has_compass = self.mag.iter().any(|value| value.is_finite());
        let mag = has_compass.then(|| table(self.mag, 3)).transpose()?;
        Ok(Recording {
            mag,
            t_us: PyArray1::from_vec(python, self.t_us).unbind(),
            accel: table(self.accel, 3)?,
            gyro: table(self.gyro, 3)?,
            truth: table(self.truth, 4)?,
            scored: PyArray1::from_vec(python, self.scored).unbind(),
            armed: (!self.armed.is_empty())
                .then(|| PyArray1::from_vec(python, self.armed).unbind()),
            accelerometer: self.accelerometer.map(knowledge_name),
        })
    }
}

/// Reads a recording: t_us,ax,ay,az,gx,gy,gz[,mx,my,mz][,qw,qx,qy,qz[,mov]][,armed], plain or
/// gzipped.
///
/// Parameters
/// ----------
/// path : str or path
///     The file.
/// time_unit : str, optional
///     Unit of its times: "us" (the default), "ms", "s" or "ns".
/// force_unit : str, optional
///     Unit of its specific force: "m/s2" (the default), "g" or "mg".
/// rate_unit : str, optional
///     Unit of its rates: "rad/s" (the default), "deg/s" or "mdeg/s".
/// field_unit : str, optional
///     Unit of its magnetic field: "uT" (the default), "mG", "G", "nT", "T", or "norm" for length
///     1, which is taken as 50 uT.
/// bad_rows : str, optional
///     Rule for damaged rows and those that no sensor gave: "refuse" (the default) or "skip".
///
/// Raises ValueError with file, line and reason if it is malformed, or if its numbers suggest
/// another unit than a default. Warns with UserWarning of what is unusual or left out.
#[pyfunction]
#[pyo3(signature = (
    path, *, time_unit=None, force_unit=None, rate_unit=None, field_unit=None, bad_rows=None
))]
pub fn read_log(
    python: Python<'_>,
    path: PathBuf,
    time_unit: Option<&str>,
    force_unit: Option<&str>,
    rate_unit: Option<&str>,
    field_unit: Option<&str>,
    bad_rows: Option<&str>,
) -> PyResult<Recording> {
    let options = RowOptions {
        time_unit: choice("time_unit", time_unit)?,
        force_unit: choice("force_unit", force_unit)?,
        rate_unit: choice("rate_unit", rate_unit)?,
        field_unit: choice("field_unit", field_unit)?,
        bad_rows: match bad_rows {
            None => None,
            Some("refuse") => Some(BadRows::Refuse),
            Some("skip") => Some(BadRows::Skip),
            Some(_) => {
                let reason = "bad_rows: choose one of refuse, skip";
                return Err(PyValueError::new_err(reason));
            }
        },
    };
    let read = python.detach(|| {
        let (log, notices) =
            Log::read_quietly(&path, options).map_err(|error| error.to_string())?;
        let mut columns = Columns {
            accelerometer: log.accelerometer(),
            ..Columns::default()
        };
        let has_states = log.rows().iter().any(|row| row.armed.is_some());
        let mut is_armed = false;
        for row in log.rows() {
            is_armed = row.armed.unwrap_or(is_armed);
            columns.armed.extend(has_states.then_some(is_armed));
            columns.t_us.push(row.time_us);
            columns.accel.extend(row.specific_force_m_s2);
            columns.gyro.extend(row.rates_rad_s);
            columns.mag.extend(row.field_ut.unwrap_or([f64::NAN; 3]));
            let truth = row.attitude.map_or([f64::NAN; 4], |q| [q.w, q.x, q.y, q.z]);
            columns.truth.extend(truth);
            columns.scored.push(row.scored);
        }
        Ok::<_, String>((columns, notices))
    });
    let (columns, notices) = read.map_err(|error| PyValueError::new_err(arguments(error)))?;
    for notice in notices {
        warn(python, arguments(notice))?;
    }
    columns.into_arrays(python)
}

/// Advice on register counts, which names options that `read_log` lacks.
const COUNT_OPTIONS: [&str; 2] = [
    "(--raw)",
    "(add --raw and both ranges, for replay, plot and calibrate)",
];

/// Returns the choice of an argument.
fn choice<T>(argument: &str, name: Option<&str>) -> PyResult<Option<T>>
where
    T: FromStr<Err: Display>,
{
    let choice = name.map(str::parse).transpose();
    choice.map_err(|error| PyValueError::new_err(format!("{argument}: {error}")))
}

/// Writes the options of the program in a message as arguments: `--time-unit ms` as
/// `time_unit="ms"`.
fn arguments(mut message: String) -> String {
    for of_counts in COUNT_OPTIONS {
        message = message.replace(of_counts, INSTEAD_OF_COUNTS);
    }
    for (option, _) in RowOptions::default().given() {
        let argument = option.trim_start_matches("--").replace('-', "_");
        let with_value = format!("{option} ");
        while let Some(start) = message.find(&with_value) {
            let value = start + with_value.len();
            let rest = &message[value..];
            let length = rest.find([' ', ')', ',', ';']).unwrap_or(rest.len());
            let given = format!("{argument}=\"{}\"", &rest[..length]);
            message.replace_range(start..value + length, &given);
        }
        message = message.replace(option, &argument);
    }
    message
}

/// Simulates a motion with its truth, 1000 samples a second, as `aplomb simulate` does.
///
/// Parameters
/// ----------
/// kind : str
///     "flight" (a quadrotor), "swing" or "rest".
/// seed : int
///     Seed of the motion and of the sensor: one seed, one recording.
/// seconds : int
///     Duration, 1 to 86,400.
#[pyfunction]
#[pyo3(signature = (kind="flight", *, seed=1_000, seconds=60))]
pub fn simulate(python: Python<'_>, kind: &str, seed: u64, seconds: u64) -> PyResult<Recording> {
    let motion: Box<dyn Motion> = match kind {
        "flight" => Box::new(Quadrotor::by_seed(seed)),
        "swing" => Box::new(Swing::by_seed(seed, 3.0)),
        "rest" => Box::new(Rest::level()),
        _ => return Err(PyValueError::new_err("kind is flight, swing or rest")),
    };
    if !(1..=LONGEST_FLIGHT_S).contains(&seconds) {
        return Err(PyValueError::new_err("seconds has to be from 1 to 86400"));
    }
    let mut columns = Columns {
        accelerometer: Some(AccelerometerKnowledge::Factory),
        ..Columns::default()
    };
    let mut samples = samples(motion, seed, seconds);
    loop {
        let before = columns.t_us.len();
        python.detach(|| columns.simulate(samples.by_ref().take(BLOCK_SAMPLES)));
        // Ctrl-C.
        python.check_signals()?;
        if columns.t_us.len() == before {
            return columns.into_arrays(python);
        }
    }
}
/// Fits the accelerometer's calibration to mean readings at rest: force = matrix @ (reading -
/// offset).
///
/// Parameters
/// ----------
/// poses : array (n, 3)
///     Mean specific force of each pose, m/s2: six sides for offset and scale, nine poses or more
///     for the cross-axis terms too.
///
/// Returns
/// -------
/// dict
///     offset_m_s2 (3,), matrix (3, 3), residual_before_m_s2, residual_after_m_s2.
///
/// Raises ValueError if the poses do not determine the calibration.
#[pyfunction]
pub fn calibrate_accelerometer<'py>(
    python: Python<'py>,
    poses: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyDict>> {
    let gravity = f64::from(STANDARD_GRAVITY_M_S2);
    let poses = Vectors::new(poses, "poses")?.rows();
    let length = |[x, y, z]: &[f64; 3]| x.hypot(*y).hypot(*z);
    let is_in_g = |pose: &[f64; 3]| length(pose) < LARGEST_POSE_IN_G;
    if !poses.is_empty() && poses.iter().all(is_in_g) {
        return Err(PyValueError::new_err(
            "the poses seem to be in g: pass m/s2, so multiply by 9.80665",
        ));
    }
    let too_long = poses
        .iter()
        .map(length)
        .find(|length| *length > LARGEST_POSE_M_S2);
    if let Some(length) = too_long {
        return Err(PyValueError::new_err(format!(
            "a pose has the length {length:.0}, and at rest it is 9.81 m/s2: of mg multiply by \
             0.00980665, of counts by 9.80665 / (counts per g)"
        )));
    }
    let in_g = |[x, y, z]: [f64; 3]| {
        let [x, y, z] = [x, y, z].map(|value| (value / gravity) as f32);
        Vector3::new(x, y, z)
    };
    let readings: Vec<Vector3> = poses.into_iter().map(in_g).collect();
    let found = fit(&readings).map_err(|error| PyValueError::new_err(error.to_string()))?;
    let (offset, m) = (found.correction.offset_m_s2, found.correction.matrix);
    let matrix = [m.xx, m.xy, m.xz, m.xy, m.yy, m.yz, m.xz, m.yz, m.zz];
    let dict = PyDict::new(python);
    let offset = PyArray1::from_vec(python, vec![offset.x, offset.y, offset.z]);
    dict.set_item("offset_m_s2", offset)?;
    let matrix = PyArray1::from_vec(python, matrix.to_vec()).reshape([3, 3])?;
    dict.set_item("matrix", matrix)?;
    for (name, residual_g) in [
        ("residual_before_m_s2", found.residual_before_g),
        ("residual_after_m_s2", found.residual_after_g),
    ] {
        dict.set_item(name, f64::from(residual_g) * gravity)?;
    }
    Ok(dict)
}
