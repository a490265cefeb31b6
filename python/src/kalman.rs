//! The filter: sample by sample, and over arrays.

use std::sync::{Mutex, PoisonError};

use aplomb_recordings::batches;
use aplomb_recordings::plateau::Plateaus;
use aplomb_recordings::rate::{ROWS_AHEAD, divider_of_period, sample_rate_divider, unsigned};
use library::attitude::Vector3;
use library::calibration::Mount;
use library::estimator::heading::CompassKnowledge;
use library::estimator::kalman::{AccelerometerKnowledge, GyroscopeKnowledge};
use library::estimator::{LONGEST_DELAY_US, Sample};
use library::mpu6050::Part;
use library::pipeline::{CompassPipeline, Pipeline, Settings};
use library::units::{MagneticField, radians};
use numpy::PyArrayLike1;
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;

use crate::attitudes::{Attitude, Attitudes, Columns};
use crate::copies::not_pickled;
use crate::recording::Recording;
use crate::times::{SingleTimes, count_on, time_us, times_us};
use crate::units::{Units, warn};
use crate::vectors::{Vectors, three, vector};

/// Largest delay of a compass, µs: none is slower.
const LONGEST_COMPASS_DELAY_US: u32 = 1_000_000;

/// Kalman filter for the attitude of a body, with the sensor's mount.
///
/// Parameters
/// ----------
/// rate_hz : float, optional
///     Samples a second. `run` finds it in the times if it is left out; `update` needs it. Times
///     whose steps are 31.6 times longer or shorter are in another unit, and refused.
/// mount : str
///     The sensor axes along which the body's forward and down axes point, such as "+x-z".
///     "z-up" (the default): the sensor lies face up and reads +9.81 m/s2 along z at rest.
/// sensor_delay_us : int
///     Age of a sample's content at its time, 100,000 at most. Attitudes are extrapolated by it.
/// accelerometer : str, optional
///     Knowledge of the accelerometer's offset: "factory" (as the sensor came), "six-poses" or
///     "calibrated" (twelve poses, or by its maker). Without it the recording's statement counts,
///     else "calibrated", as in `aplomb replay`.
/// gyroscope : str, optional
///     Knowledge of the gyroscope's scale: "factory" or "calibrated". Without it, that of the
///     accelerometer counts: calibrated with "calibrated", else factory. `calibrate_accelerometer`
///     leaves the gyroscope as it is: "factory".
/// compass : str
///     Knowledge of the compass's hard iron: "factory" (none, so no heading before the body has
///     turned), "hard-iron" (removed, as an earlier run found it) or "calibrated".
/// compass_delay_us : int
///     Age of the compass's readings against the samples of their rows, 1,000,000 at most.
/// declination_deg : float
///     Declination of the place, east positive: the heading is then from true north.
#[pyclass(module = "aplomb", frozen)]
pub struct Kalman {
    settings: Settings,
    knowledge: Knowledge,
    compass: Compass,
    rate_hz: Option<f64>,
    /// Filter of `update`. `run` has its own, so other threads may call both at a time.
    single: Mutex<Single>,
}

/// Filter that takes sample by sample.
struct Single {
    pipeline: CompassPipeline,
    plateaus: Plateaus,
    times: SingleTimes,
}

/// Statements on how the sensor is calibrated.
#[derive(Clone, Copy)]
struct Knowledge {
    accelerometer: Option<AccelerometerKnowledge>,
    gyroscope: Option<GyroscopeKnowledge>,
}

impl Knowledge {
    /// Returns the statements, or what is wrong with them.
    fn new(accelerometer: Option<&str>, gyroscope: Option<&str>) -> PyResult<Self> {
        let accelerometer = accelerometer.map(|name| {
            AccelerometerKnowledge::from_name(name).ok_or_else(|| {
                PyValueError::new_err("accelerometer is factory, six-poses or calibrated")
            })
        });
        let gyroscope = match gyroscope {
            None => None,
            Some("factory") => Some(GyroscopeKnowledge::Factory),
            Some("calibrated") => Some(GyroscopeKnowledge::Calibrated),
            Some(_) => {
                let reason = "gyroscope is factory or calibrated";
                return Err(PyValueError::new_err(reason));
            }
        };
        Ok(Self {
            accelerometer: accelerometer.transpose()?,
            gyroscope,
        })
    }

    /// Returns a pipeline. Without a statement the samples count as calibrated.
    fn pipeline(&self, settings: &Settings) -> Pipeline {
        let mut pipeline = Pipeline::new(settings);
        let accelerometer = self.accelerometer;
        let accelerometer = accelerometer.unwrap_or(AccelerometerKnowledge::Calibrated);
        pipeline.set_accelerometer_knowledge(accelerometer);
        if let Some(gyroscope) = self.gyroscope {
            pipeline.set_gyroscope_knowledge(gyroscope);
        }
        pipeline
    }
}

/// Settings of the compass.
#[derive(Clone, Copy)]
struct Compass {
    knowledge: CompassKnowledge,
    delay_us: u32,
    declination_rad: f32,
}

impl Compass {
    /// Returns the settings, or what is wrong with them.
    fn new(knowledge: &str, delay_us: u32, declination_deg: f32) -> PyResult<Self> {
        let knowledge = CompassKnowledge::from_name(knowledge)
            .ok_or_else(|| PyValueError::new_err("compass is factory, hard-iron or calibrated"))?;
        if declination_deg.is_nan() || declination_deg.abs() > 180.0 {
            return Err(PyValueError::new_err(
                "declination_deg has to be from -180 to 180",
            ));
        }
        Ok(Self {
            knowledge,
            delay_us,
            declination_rad: radians(declination_deg),
        })
    }

    /// Adds the compass to a pipeline.
    fn added_to(&self, pipeline: Pipeline) -> CompassPipeline {
        let mut pipeline = CompassPipeline::with_pipeline(pipeline, self.knowledge);
        pipeline
            .heading_filter_mut()
            .set_declination(self.declination_rad);
        pipeline
    }

    /// Passes a row's reading on, µT in the sensor's axes. A row with a NaN has none.
    fn update(&self, pipeline: &mut CompassPipeline, [x, y, z]: [f64; 3]) {
        if x.is_nan() || y.is_nan() || z.is_nan() {
            return;
        }
        let mount = pipeline.pipeline().settings().mount();
        let field = mount.to_body(Vector3::new(x as f32, y as f32, z as f32)).0;
        let field = MagneticField {
            ut: [field.x, field.y, field.z],
        };
        pipeline.update_field(field, self.delay_us);
    }
}

#[pymethods]
impl Kalman {
    #[new]
    #[pyo3(signature = (
        rate_hz=None, *, mount="z-up", sensor_delay_us=0, accelerometer=None, gyroscope=None,
        compass="factory", compass_delay_us=0, declination_deg=0.0
    ))]
    #[allow(clippy::too_many_arguments, reason = "each has a name in Python")]
    fn new(
        rate_hz: Option<f64>,
        mount: &str,
        sensor_delay_us: u32,
        accelerometer: Option<&str>,
        gyroscope: Option<&str>,
        compass: &str,
        compass_delay_us: u32,
        declination_deg: f32,
    ) -> PyResult<Self> {
        for (name, delay_us, longest_us) in [
            ("sensor_delay_us", sensor_delay_us, LONGEST_DELAY_US),
            (
                "compass_delay_us",
                compass_delay_us,
                LONGEST_COMPASS_DELAY_US,
            ),
        ] {
            if delay_us > longest_us {
                let reason = format!("{name} has to be {longest_us} at most, in microseconds");
                return Err(PyValueError::new_err(reason));
            }
        }
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
        let knowledge = Knowledge::new(accelerometer, gyroscope)?;
        let compass = Compass::new(compass, compass_delay_us, declination_deg)?;
        let single = Single {
            pipeline: compass.added_to(knowledge.pipeline(&settings)),
            plateaus: Plateaus::default(),
            times: SingleTimes::default(),
        };
        Ok(Self {
            settings,
            knowledge,
            compass,
            rate_hz,
            single: Mutex::new(single),
        })
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(not_pickled("a Kalman", "make one with the same arguments"))
    }

    /// Processes one sample: rad/s and m/s2 in the sensor's axes. Returns the attitude at its time.
    ///
    /// The mount turns the sample. No calibration is applied: correct the sample before, and
    /// let `accelerometer` state how.
    ///
    /// `mag` is a new reading of the compass, microtesla in the sensor's axes. The next attitudes
    /// use it. `armed` is True in flight: the filter then takes no steady motion for a rest.
    ///
    /// `t_us` is whole microseconds, and counted on where a clock of 32 bits begins again. Raises
    /// ValueError if the first steps are not those of `rate_hz`.
    #[pyo3(signature = (t_us, gyro, accel, mag=None, *, armed=false))]
    fn update(
        &self,
        t_us: &Bound<'_, PyAny>,
        gyro: &Bound<'_, PyAny>,
        accel: &Bound<'_, PyAny>,
        mag: Option<&Bound<'_, PyAny>>,
        armed: bool,
    ) -> PyResult<Attitude> {
        let rate_hz = self
            .rate_hz
            .ok_or_else(|| PyValueError::new_err("`update` needs the rate: Kalman(rate_hz=…)"))?;
        let t_us = time_us(t_us)?;
        let (gyro, accel) = (three(gyro, "gyro")?, three(accel, "accel")?);
        let mag = mag.map(|mag| three(mag, "mag")).transpose()?;
        let mount = self.settings.mount();
        // No thread waits here: each holds the interpreter's lock meanwhile.
        let mut single = self.single.lock().unwrap_or_else(PoisonError::into_inner);
        let t_us = single.times.next(t_us, rate_hz)?;
        let Single {
            pipeline, plateaus, ..
        } = &mut *single;
        let sample = sample(mount, plateaus, t_us, gyro, accel);
        pipeline.pipeline_mut().set_armed(armed);
        let snapshot = pipeline.update_sample(&sample);
        if let Some(reading) = mag {
            self.compass.update(pipeline, reading);
        }
        let (q, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
        let bias = pipeline.pipeline().kalman().bias_rad_s();
        let (angles, heading) = (snapshot.euler(), pipeline.heading());
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
            heading_rad: heading.map(|heading| heading.heading_rad(angles.yaw_rad)),
            heading_sigma_rad: heading.map(|heading| heading.sigma_rad),
            yaw_offset_rad: heading.map(|heading| heading.yaw_offset_rad),
        })
    }

    /// Processes a whole recording from a new start, and leaves `update` alone. As in `update`, the
    /// mount turns the samples, and no calibration is applied.
    ///
    /// Parameters
    /// ----------
    /// t_us : array (n,) or Recording
    ///     Times, whole microseconds. Other units and datetime64 are refused. Those of a clock of
    ///     32 bits are counted on where it begins again, with a warning. Those that come in batches
    ///     are spread evenly, with a warning.
    ///     A recording has the other columns too, and what is known of its accelerometer:
    ///     `Kalman().run(recording)` gives the bits of `aplomb replay`.
    /// gyro : array (n, 3)
    ///     Angular rates in the sensor's axes, rad/s.
    /// accel : array (n, 3)
    ///     Specific force in the sensor's axes, m/s2.
    /// mag : array (n, 3), optional
    ///     Magnetic field in the sensor's axes, microtesla; NaN where there is no new reading.
    /// armed : array (n,) of bool, optional
    ///     True in flight: the filter then takes no steady motion for a rest, and measures
    ///     nothing at a rest. Without it, the filter is never armed.
    /// check_units : bool
    ///     False skips the checks of units and leaves the times. True (the default) checks them as
    ///     `read_log` does. A recording was checked before.
    ///
    /// Raises ValueError if the numbers suggest another unit or exchanged arrays, with what to
    /// pass, or if the times mostly decrease. Warns with UserWarning if they may be in another
    /// unit, or if the rates do not fit the force.
    #[pyo3(signature = (t_us, gyro=None, accel=None, mag=None, *, armed=None, check_units=true))]
    #[allow(clippy::too_many_arguments, reason = "one is the interpreter")]
    fn run<'py>(
        &self,
        python: Python<'py>,
        t_us: Bound<'py, PyAny>,
        gyro: Option<Bound<'py, PyAny>>,
        accel: Option<Bound<'py, PyAny>>,
        mag: Option<Bound<'py, PyAny>>,
        armed: Option<Bound<'py, PyAny>>,
        check_units: bool,
    ) -> PyResult<Attitudes> {
        let input = Input::new(python, t_us, [gyro, accel, mag, armed])?;
        let mut times = times_us(&input.t_us)?;
        if !input.is_recording && count_on(&mut times) {
            let text = "t_us begins again, as a clock of 32 bits does after 71.6 minutes: it is \
                        counted on";
            warn(python, text.to_owned())?;
        }
        if check_units
            && !input.is_recording
            && let Some(message) = batches::spread(&mut times)
        {
            warn(python, message)?;
        }
        let count = times.len();
        let gyro = Vectors::of_count(&input.gyro, "gyro", count)?;
        let accel = Vectors::of_count(&input.accel, "accel", count)?;
        let mag = (input.mag.as_ref()).map(|mag| Vectors::of_count(mag, "mag", count));
        let mag = mag.transpose()?;
        let armed = (input.armed.as_ref()).map(|armed| states(armed, count));
        let armed = armed.transpose()?;
        let mut run = Run::new(self, input.knowledge, &times, mag.is_some());
        let (gyro, accel) = (gyro.view(), accel.view());
        let mag = mag.as_ref().map(Vectors::view);
        let mut units = (check_units && !input.is_recording)
            .then(|| Units::new(&times, self.rate_hz, gyro, accel, mag))
            .transpose()?;
        for first in (0..times.len()).step_by(BLOCK_ROWS) {
            let block = first..times.len().min(first + BLOCK_ROWS);
            // Other threads may change the arrays as soon as the lock is free.
            run.samples.clear();
            for row in block.clone() {
                let (gyro, accel) = (vector(gyro, row), vector(accel, row));
                let sample = sample(run.mount, &mut run.plateaus, times[row], gyro, accel);
                if let Some(units) = &mut units {
                    let is_saturated = sample.is_force_saturated || sample.is_rate_saturated;
                    units.row(row, times[row], [gyro, accel], is_saturated)?;
                }
                run.samples.push(sample);
            }
            run.armed.clear();
            if let Some(armed) = &armed {
                run.armed.extend_from_slice(&armed[block.clone()]);
            }
            run.readings.clear();
            if let Some(mag) = mag {
                run.readings.extend(block.map(|row| vector(mag, row)));
            }
            python.detach(|| run.process());
            // Ctrl-C.
            python.check_signals()?;
        }
        units.map_or(Ok(()), |units| units.end(python))?;
        run.columns.into_arrays(python, times)
    }
}

/// Arguments of a run, or the columns of a recording.
struct Input<'py> {
    t_us: Bound<'py, PyAny>,
    gyro: Bound<'py, PyAny>,
    accel: Bound<'py, PyAny>,
    mag: Option<Bound<'py, PyAny>>,
    armed: Option<Bound<'py, PyAny>>,
    /// Knowledge of the accelerometer that the recording states.
    knowledge: Option<AccelerometerKnowledge>,
    /// True for the columns of a recording, whose units and times were checked before.
    is_recording: bool,
}

impl<'py> Input<'py> {
    fn new(
        python: Python<'py>,
        t_us: Bound<'py, PyAny>,
        [gyro, accel, mag, armed]: [Option<Bound<'py, PyAny>>; 4],
    ) -> PyResult<Self> {
        if let Ok(recording) = t_us.cast::<Recording>() {
            if gyro.is_some() || accel.is_some() {
                return Err(PyTypeError::new_err(
                    "gyro and accel are those of the recording: pass the recording alone",
                ));
            }
            return Ok(recording.get().input(python, mag, armed));
        }
        let (Some(gyro), Some(accel)) = (gyro, accel) else {
            return Err(PyTypeError::new_err(
                "run takes a recording, or t_us, gyro and accel",
            ));
        };
        Ok(Self {
            t_us,
            gyro,
            accel,
            mag,
            armed,
            knowledge: None,
            is_recording: false,
        })
    }
}

impl Recording {
    /// Returns the columns for a run. These readings and states have precedence.
    fn input<'py>(
        &self,
        python: Python<'py>,
        mag: Option<Bound<'py, PyAny>>,
        armed: Option<Bound<'py, PyAny>>,
    ) -> Input<'py> {
        let own_mag = self.mag.as_ref();
        let own_armed = self.armed.as_ref();
        Input {
            t_us: self.t_us.bind(python).clone().into_any(),
            gyro: self.gyro.bind(python).clone().into_any(),
            accel: self.accel.bind(python).clone().into_any(),
            mag: mag.or_else(|| own_mag.map(|mag| mag.bind(python).clone().into_any())),
            armed: armed.or_else(|| own_armed.map(|armed| armed.bind(python).clone().into_any())),
            knowledge: (self.accelerometer).and_then(AccelerometerKnowledge::from_name),
            is_recording: true,
        }
    }
}

/// Rows that are read and processed at a time: they stay in the processor's cache.
const BLOCK_ROWS: usize = 2_048;

/// Run over a recording.
struct Run {
    mount: Mount,
    compass: Compass,
    pipeline: CompassPipeline,
    plateaus: Plateaus,
    columns: Columns,
    /// Samples of a block.
    samples: Vec<Sample>,
    /// Armed states beside them; none if the filter is never armed.
    armed: Vec<bool>,
    /// Readings of the compass beside them; none without a compass.
    readings: Vec<[f64; 3]>,
}

impl Run {
    fn new(
        kalman: &Kalman,
        stated: Option<AccelerometerKnowledge>,
        times: &[i64],
        has_compass: bool,
    ) -> Self {
        let mut knowledge = kalman.knowledge;
        knowledge.accelerometer = knowledge.accelerometer.or(stated);
        let mut settings = kalman.settings;
        if kalman.rate_hz.is_none() {
            let first = times.len().min(ROWS_AHEAD);
            settings.sensor.sample_rate_divider = sample_rate_divider(&times[..first]);
        }
        Self {
            mount: settings.mount(),
            compass: kalman.compass,
            pipeline: (kalman.compass).added_to(knowledge.pipeline(&settings)),
            plateaus: Plateaus::default(),
            columns: Columns::with_capacity(times.len(), has_compass),
            samples: Vec::with_capacity(BLOCK_ROWS.min(times.len())),
            armed: Vec::new(),
            readings: Vec::new(),
        }
    }

    /// Processes the samples of a block.
    fn process(&mut self) {
        for (row, sample) in self.samples.iter().enumerate() {
            if let Some(is_armed) = self.armed.get(row) {
                self.pipeline.pipeline_mut().set_armed(*is_armed);
            }
            let snapshot = self.pipeline.update_sample(sample);
            if let Some(reading) = self.readings.get(row) {
                self.compass.update(&mut self.pipeline, *reading);
            }
            let heading = self.pipeline.heading();
            self.columns
                .push(&snapshot, self.pipeline.pipeline(), heading);
        }
    }
}

/// Returns a sample in body axes, of one in SI units and sensor axes. A clipped one is marked as
/// saturated.
fn sample(
    mount: Mount,
    plateaus: &mut Plateaus,
    t_us: i64,
    gyro: [f64; 3],
    accel: [f64; 3],
) -> Sample {
    let body = |[x, y, z]: [f64; 3]| mount.to_body(Vector3::new(x as f32, y as f32, z as f32));
    let mut sample = Sample::new(unsigned(t_us), body(accel), body(gyro));
    let clipped = plateaus.check(accel, gyro);
    sample.is_force_saturated = clipped.force;
    sample.is_rate_saturated = clipped.rate;
    sample
}

/// Returns the armed states of `count` rows.
fn states(armed: &Bound<'_, PyAny>, count: usize) -> PyResult<Vec<bool>> {
    let Ok(array) = armed.extract::<PyArrayLike1<'_, bool>>() else {
        return Err(PyValueError::new_err(
            "armed has to be an array of bool, such as t_us >= take_off_us",
        ));
    };
    let states = array.as_array().to_vec();
    if states.len() == count {
        return Ok(states);
    }
    Err(PyValueError::new_err(format!(
        "t_us has {count} rows and armed {}: they need equal numbers",
        states.len()
    )))
}
