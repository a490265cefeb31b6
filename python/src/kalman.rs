//! The filter: sample by sample, and over arrays.

use aplomb_recordings::plateau::Plateaus;
use aplomb_recordings::rate::{ROWS_AHEAD, divider_of_period, sample_rate_divider, unsigned};
use library::attitude::{Quaternion, Vector3};
use library::calibration::Mount;
use library::estimator::Sample;
use library::estimator::kalman::AccelerometerKnowledge;
use library::health::Flags;
use library::mpu6050::Part;
use library::pipeline::{Pipeline, Settings, Snapshot};
use numpy::{AllowTypeChange, PyArray1, PyArray2, PyArrayLike1, PyArrayLike2, PyArrayMethods as _};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// Array of rows of three numbers; any type of number is converted.
pub type Vectors<'py> = PyArrayLike2<'py, f64, AllowTypeChange>;
/// Array of times, microseconds; any type of number is converted.
pub type Times<'py> = PyArrayLike1<'py, i64, AllowTypeChange>;

/// Kalman filter for the attitude of a body, with the sensor's mount.
///
/// Parameters
/// ----------
/// rate_hz : float, optional
///     Samples a second. `run` finds it in the times if it is left out; `update` needs it.
/// mount : str
///     The sensor axes along which the body's forward and down axes point, such as "+x-z".
///     "z-up" (the default): the sensor lies face up and reads +9.81 m/s2 along z at rest.
/// sensor_delay_us : int
///     Age of a sample's content at its time. Attitudes are extrapolated by it.
/// accelerometer : str
///     Knowledge of the accelerometer's offset: "factory", "six-poses" or "calibrated".
#[pyclass(module = "aplomb")]
pub struct Kalman {
    settings: Settings,
    knowledge: AccelerometerKnowledge,
    has_rate: bool,
    pipeline: Pipeline,
    plateaus: Plateaus,
}

/// Attitude at one sample: forward, right, down against north, east, down.
#[pyclass(module = "aplomb", frozen, get_all)]
pub struct Attitude {
    /// Time of the sample, microseconds.
    t_us: i64,
    /// Body to earth: (w, x, y, z).
    quaternion: (f32, f32, f32, f32),
    /// Right wing down positive, rad.
    roll_rad: f32,
    /// Nose up positive, rad.
    pitch_rad: f32,
    /// Clockwise from above positive, rad, relative to the heading at start.
    yaw_rad: f32,
    /// Body rates p, q, r without bias, rad/s.
    rates_rad_s: (f32, f32, f32),
    /// Sigma of the direction of down, both axes together, rad.
    tilt_sigma_rad: f32,
    /// Gyroscope bias about the body's axes, rad/s.
    bias_rad_s: (f32, f32, f32),
    /// Flags as a number; `flag_names` gives their names.
    flags: u32,
}

#[pymethods]
impl Attitude {
    /// True if the tilt is wrong by no more than the larger of 5 degrees and six sigma.
    #[getter]
    fn is_valid(&self) -> bool {
        Flags::from_bits_retain(self.flags).contains(Flags::VALID)
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
#[pyclass(module = "aplomb", frozen, get_all)]
pub struct Attitudes {
    /// Times, microseconds: int64, shape (n,).
    t_us: Py<PyArray1<i64>>,
    /// Body to earth, w x y z: float32, shape (n, 4).
    quaternion: Py<PyArray2<f32>>,
    /// Body rates p, q, r without bias, rad/s: float32, shape (n, 3).
    rates_rad_s: Py<PyArray2<f32>>,
    /// Sigma of the direction of down, rad: float32, shape (n,).
    tilt_sigma_rad: Py<PyArray1<f32>>,
    /// Gyroscope bias about the body's axes, rad/s: float32, shape (n, 3).
    bias_rad_s: Py<PyArray2<f32>>,
    /// Flags as numbers: uint32, shape (n,).
    flags: Py<PyArray1<u32>>,
}

#[pymethods]
impl Attitudes {
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

#[pymethods]
impl Kalman {
    #[new]
    #[pyo3(signature = (
        rate_hz=None, *, mount="z-up", sensor_delay_us=0, accelerometer="calibrated"
    ))]
    fn new(
        rate_hz: Option<f64>,
        mount: &str,
        sensor_delay_us: u32,
        accelerometer: &str,
    ) -> PyResult<Self> {
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.sensor_delay_us = Some(sensor_delay_us);
        let mount: Result<Mount, _> = mount.parse();
        settings.mount = mount.map_err(|error| PyValueError::new_err(error.to_string()))?;
        if let Some(rate_hz) = rate_hz {
            if !(rate_hz.is_finite() && rate_hz > 0.0) {
                return Err(PyValueError::new_err("rate_hz has to be above zero"));
            }
            settings.sensor.sample_rate_divider = divider_of_period((1e6 / rate_hz) as u64);
        }
        let knowledge = AccelerometerKnowledge::from_name(accelerometer).ok_or_else(|| {
            PyValueError::new_err("accelerometer is factory, six-poses or calibrated")
        })?;
        Ok(Self {
            pipeline: pipeline(&settings, knowledge),
            settings,
            knowledge,
            has_rate: rate_hz.is_some(),
            plateaus: Plateaus::default(),
        })
    }

    /// Processes one sample: rad/s and m/s2 in the sensor's axes. Returns the attitude at its time.
    fn update(&mut self, t_us: i64, gyro: [f64; 3], accel: [f64; 3]) -> PyResult<Attitude> {
        if !self.has_rate {
            return Err(PyValueError::new_err(
                "`update` needs the rate: Kalman(rate_hz=…)",
            ));
        }
        let snapshot = step(&mut self.pipeline, &mut self.plateaus, t_us, gyro, accel);
        let (q, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
        let (angles, bias) = (snapshot.euler(), self.pipeline.kalman().bias_rad_s());
        Ok(Attitude {
            t_us,
            quaternion: (q.w, q.x, q.y, q.z),
            roll_rad: angles.roll_rad,
            pitch_rad: angles.pitch_rad,
            yaw_rad: angles.yaw_rad,
            rates_rad_s: (rates.x, rates.y, rates.z),
            tilt_sigma_rad: snapshot.tilt_sigma_rad(),
            bias_rad_s: (bias.x, bias.y, bias.z),
            flags: snapshot.flags.bits(),
        })
    }

    /// Processes a whole recording from a new start, and leaves `update` alone.
    ///
    /// Parameters
    /// ----------
    /// t_us : array (n,)
    ///     Times, microseconds.
    /// gyro : array (n, 3)
    ///     Angular rates in the sensor's axes, rad/s.
    /// accel : array (n, 3)
    ///     Specific force in the sensor's axes, m/s2.
    fn run<'py>(
        &self,
        python: Python<'py>,
        t_us: Times<'py>,
        gyro: Vectors<'py>,
        accel: Vectors<'py>,
    ) -> PyResult<Attitudes> {
        let times = t_us.readonly().to_vec()?;
        let (gyro, accel) = (rows(&gyro, "gyro")?, rows(&accel, "accel")?);
        if times.len() != gyro.len() || times.len() != accel.len() {
            return Err(PyValueError::new_err(format!(
                "t_us has {} rows, gyro {} and accel {}: they need equal numbers",
                times.len(),
                gyro.len(),
                accel.len()
            )));
        }
        let columns = python.detach(|| self.columns(&times, &gyro, &accel));
        columns.into_arrays(python, times)
    }
}

/// Columns of the attitudes of a recording.
#[derive(Default)]
struct Columns {
    quaternion: Vec<f32>,
    rates_rad_s: Vec<f32>,
    tilt_sigma_rad: Vec<f32>,
    bias_rad_s: Vec<f32>,
    flags: Vec<u32>,
}

impl Kalman {
    fn columns(&self, times: &[i64], gyro: &[[f64; 3]], accel: &[[f64; 3]]) -> Columns {
        let mut settings = self.settings;
        if !self.has_rate {
            let first = times.len().min(ROWS_AHEAD);
            settings.sensor.sample_rate_divider = sample_rate_divider(&times[..first]);
        }
        let mut pipeline = pipeline(&settings, self.knowledge);
        let (mut plateaus, mut columns) = (Plateaus::default(), Columns::default());
        for ((&t_us, &gyro), &accel) in times.iter().zip(gyro).zip(accel) {
            let snapshot = step(&mut pipeline, &mut plateaus, t_us, gyro, accel);
            let (q, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
            let bias = pipeline.kalman().bias_rad_s();
            columns.quaternion.extend([q.w, q.x, q.y, q.z]);
            columns.rates_rad_s.extend([rates.x, rates.y, rates.z]);
            columns.tilt_sigma_rad.push(snapshot.tilt_sigma_rad());
            columns.bias_rad_s.extend([bias.x, bias.y, bias.z]);
            columns.flags.push(snapshot.flags.bits());
        }
        columns
    }
}

impl Columns {
    fn into_arrays(self, python: Python<'_>, times: Vec<i64>) -> PyResult<Attitudes> {
        let count = times.len();
        let table = |values: Vec<f32>, columns: usize| {
            let array = PyArray1::from_vec(python, values);
            Ok::<_, PyErr>(array.reshape([count, columns])?.unbind())
        };
        Ok(Attitudes {
            quaternion: table(self.quaternion, 4)?,
            rates_rad_s: table(self.rates_rad_s, 3)?,
            bias_rad_s: table(self.bias_rad_s, 3)?,
            t_us: PyArray1::from_vec(python, times).unbind(),
            tilt_sigma_rad: PyArray1::from_vec(python, self.tilt_sigma_rad).unbind(),
            flags: PyArray1::from_vec(python, self.flags).unbind(),
        })
    }
}

/// Returns the names of flags, such as "VALID|DEGRADED".
#[pyfunction]
pub fn flag_names(flags: u32) -> String {
    Flags::from_bits_truncate(flags).to_string()
}

fn pipeline(settings: &Settings, knowledge: AccelerometerKnowledge) -> Pipeline {
    let mut pipeline = Pipeline::new(settings);
    pipeline.set_accelerometer_knowledge(knowledge);
    pipeline
}

/// Processes one sample in SI units and sensor axes; a clipped one is marked as saturated.
fn step(
    pipeline: &mut Pipeline,
    plateaus: &mut Plateaus,
    t_us: i64,
    gyro: [f64; 3],
    accel: [f64; 3],
) -> Snapshot {
    let mount = pipeline.settings().mount();
    let body = |[x, y, z]: [f64; 3]| mount.to_body(Vector3::new(x as f32, y as f32, z as f32));
    let mut sample = Sample::new(unsigned(t_us), body(accel), body(gyro));
    let clipped = plateaus.check(accel, gyro);
    sample.is_force_saturated = clipped.force;
    sample.is_rate_saturated = clipped.rate;
    pipeline.update_sample(&sample)
}

/// Returns the rows of an array of shape (n, 3).
pub fn rows(array: &Vectors<'_>, name: &str) -> PyResult<Vec<[f64; 3]>> {
    let view = array.as_array();
    if view.ncols() != 3 {
        return Err(PyValueError::new_err(format!(
            "{name} has {} columns and needs three: x, y, z",
            view.ncols()
        )));
    }
    let row = |row: numpy::ndarray::ArrayView1<'_, f64>| [row[0], row[1], row[2]];
    Ok(view.rows().into_iter().map(row).collect())
}
