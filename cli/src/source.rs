//! Sources of attitudes: the rows of a recording, bursts, or a flight of a flight log, through a
//! pipeline.

use std::collections::VecDeque;
use std::error::Error;

use aplomb::attitude::{BodyVector, Quaternion, Vector3};
use aplomb::calibration::{
    AccelerometerCorrection, Calibration, CompassCorrection, Matrix3, Mount,
};
use aplomb::estimator::Sample;
use aplomb::estimator::heading::{CompassKnowledge, HeadingEstimate};
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::health::Flags;
use aplomb::mpu6050::{
    AccelerometerCounts, AccelerometerRange, Config, GyroscopeCounts, GyroscopeRange, Part,
};
use aplomb::pipeline::{Settings, Snapshot};
use aplomb::telemetry::bursts;
use aplomb::units::MagneticField;
use aplomb_models::motion::geometry::Quaternion as Truth;
use aplomb_recordings::counts::counts;
use aplomb_recordings::flight_log::{Flight, FlightLog};
use aplomb_recordings::log::{Lines, LogColumns, Row, Rows};
use aplomb_recordings::plateau::Plateaus;
use aplomb_recordings::rate::{ROWS_AHEAD, divider_of_bursts, sample_rate_divider, unsigned};
use aplomb_recordings::score::START_US;
use aplomb_recordings::terminal::print_message;
use aplomb_recordings::turns::Turns;
use aplomb_recordings::units::RowOptions;

use crate::any_pipeline::{AnyPipeline, FilterName};
use crate::arming::Arming;
use crate::burst_rows::BurstRows;
use crate::flight_replay::{Agreement, Replay};

/// Attitude at one row, with its truth.
pub struct Point {
    /// Time of the row, µs.
    pub t_us: i64,
    /// Body to earth.
    pub attitude: Quaternion,
    /// Body rates p, q, r, rad/s.
    pub body_rates_rad_s: Vector3,
    /// σ of the tilt, if the filter knows it.
    pub tilt_sigma_rad: Option<f32>,
    /// Heading, if a compass shows it.
    pub heading: Option<HeadingEstimate>,
    /// Flags of the pipeline.
    pub flags: Flags,
    /// Specific force in body axes, if it is known.
    pub specific_force_m_s2: Option<Vector3>,
    /// True attitude, sensor to earth with z up, if it is known.
    pub truth: Option<Truth>,
    /// True if the row counts for scores.
    pub scored: bool,
}

impl Point {
    /// Returns whether the row counts for scores and comes late enough, in a recording that starts
    /// at `first_us`.
    pub fn is_scored_after_start(&self, first_us: i64) -> bool {
        self.scored && self.t_us.saturating_sub(first_us) >= START_US
    }

    /// Returns the attitude turned to this heading: body to magnetic or true north, east, down.
    pub fn absolute_attitude(&self, heading: &HeadingEstimate) -> Quaternion {
        let turn = Vector3::new(0.0, 0.0, heading.yaw_offset_rad);
        Quaternion::from_rotation_vector(turn).multiply(self.attitude)
    }

    /// Returns the point of a snapshot, without its truth.
    fn new(pipeline: &AnyPipeline, snapshot: &Snapshot, t_us: i64) -> Self {
        Self {
            t_us,
            attitude: snapshot.attitude,
            body_rates_rad_s: snapshot.body_rates_rad_s,
            tilt_sigma_rad: pipeline.tilt_sigma_rad(snapshot),
            heading: pipeline.heading(),
            flags: snapshot.flags,
            specific_force_m_s2: Some(pipeline.specific_force_m_s2()),
            truth: None,
            scored: false,
        }
    }
}

/// Sequence of attitudes.
pub trait Source {
    /// Returns the next point; `None` after the last.
    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>>;

    /// Returns whether flags are known.
    fn has_flags(&self) -> bool {
        true
    }

    /// Returns the accelerometer's full scale, g. Default: that of the module.
    fn full_scale_g(&self) -> u16 {
        Config::DEFAULT.accelerometer_range.full_scale_g()
    }

    /// Returns messages on what harms the accuracy of the points so far.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }
}

/// Options of a recording.
#[derive(Clone, Copy)]
pub struct LogOptions {
    /// Columns of the recording.
    pub columns: LogColumns,
    /// Filter to run.
    pub filter: FilterName,
    /// Mount of the sensor.
    pub mount: Mount,
    /// Delay of the samples, µs.
    pub delay_us: u32,
    /// Ranges of the register counts, if the recording holds counts.
    pub ranges: Option<(AccelerometerRange, GyroscopeRange)>,
    /// Calibration of accelerometer and gyroscope, which the rows do not have yet.
    pub calibration: Calibration,
    /// Knowledge of accelerometer and gyroscope; `None` for the calibration's, or the default of
    /// the kind.
    pub accelerometer: Option<AccelerometerKnowledge>,
    /// Compass, if the recording has its columns.
    pub compass: CompassOptions,
    /// Armed state, where the rows have none.
    pub arming: Arming,
    /// Units of the rows, and the rule for bad ones.
    pub rows: RowOptions,
}

/// Options of a recording's compass.
#[derive(Clone, Copy)]
pub struct CompassOptions {
    /// Knowledge of its hard iron.
    pub knowledge: CompassKnowledge,
    /// Correction in the sensor's axes, which the rows do not have yet.
    pub correction: CompassCorrection,
    /// Age of a reading against the sample of its row, µs.
    pub delay_us: u32,
    /// Declination, rad.
    pub declination_rad: f32,
}

/// Rows of a recording through the pipeline, as samples in SI units.
pub struct LogSource {
    rows: Rows,
    options: LogOptions,
    /// Rows that were read ahead.
    ahead: VecDeque<LogRow>,
    pipeline: AnyPipeline,
    plateaus: Plateaus,
    turns: Turns,
    has_warned: bool,
}

/// Row of a recording.
struct LogRow {
    t_us: i64,
    /// In body axes.
    sample: Sample,
    /// In body axes.
    field: Option<MagneticField>,
    truth: Option<Truth>,
    scored: bool,
    armed: Option<bool>,
}

impl LogSource {
    /// Starts a recording after its header. The first rows show the usual time between rows: a
    /// longer one is a pause.
    pub fn new(lines: Lines, options: LogOptions) -> Result<Self, Box<dyn Error>> {
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.sensor_delay_us = Some(options.delay_us);
        settings.calibration = options.calibration;
        if let Some((accelerometer, gyroscope)) = options.ranges {
            settings.sensor.accelerometer_range = accelerometer;
            settings.sensor.gyroscope_range = gyroscope;
        }
        let rows = Rows::new(
            lines,
            options.columns,
            options.rows,
            options.ranges.is_some(),
        )?;
        let mut log = Self {
            rows,
            options,
            ahead: VecDeque::new(),
            pipeline: AnyPipeline::for_samples(options.filter, &settings, options.delay_us),
            plateaus: Plateaus::default(),
            turns: Turns::default(),
            has_warned: false,
        };
        while log.ahead.len() < ROWS_AHEAD
            && let Some(row) = log.read()?
        {
            log.ahead.push_back(row);
        }
        let times_us: Vec<i64> = log.ahead.iter().map(|row| row.t_us).collect();
        settings.sensor.sample_rate_divider = sample_rate_divider(&times_us);
        log.pipeline = AnyPipeline::for_samples(options.filter, &settings, options.delay_us);
        if options.calibration.accelerometer.is_none() {
            let knowledge = options.accelerometer.unwrap_or(match options.ranges {
                Some(_) => AccelerometerKnowledge::Factory,
                None => AccelerometerKnowledge::Calibrated,
            });
            log.pipeline.set_accelerometer_knowledge(knowledge);
        }
        if options.columns.has_compass() {
            let compass = options.compass;
            let pipeline = &mut log.pipeline;
            pipeline.add_compass(compass.knowledge, compass.declination_rad);
        }
        Ok(log)
    }

    fn read(&mut self) -> Result<Option<LogRow>, Box<dyn Error>> {
        let Some(row) = self.rows.next_row()? else {
            self.warn();
            return Ok(None);
        };
        let mut sample = self
            .options
            .sample(&row)
            .map_err(|reason| format!("{}: {reason}", self.rows.place()))?;
        if self.options.ranges.is_none() {
            let clipped = (self.plateaus).check(row.specific_force_m_s2, row.rates_rad_s);
            (sample.is_force_saturated, sample.is_rate_saturated) = (clipped.force, clipped.rate);
        }
        let sensor = |body| {
            let Vector3 { x, y, z } = self.options.mount.to_sensor(BodyVector(body));
            [x, y, z].map(f64::from)
        };
        self.turns.add(
            row.time_us,
            sensor(sample.specific_force_m_s2),
            sensor(sample.angular_rate_rad_s),
            sample.is_force_saturated || sample.is_rate_saturated,
        );
        Ok(Some(LogRow {
            t_us: row.time_us,
            sample,
            field: row.field_ut.map(|field| {
                let field = self.options.compass.correction.apply(vector(field));
                let Vector3 { x, y, z } = self.options.mount.to_body(field).0;
                MagneticField { ut: [x, y, z] }
            }),
            truth: row.attitude,
            scored: row.scored,
            armed: row.armed,
        }))
    }
}

impl LogSource {
    /// Reports once, on standard error, rates that do not fit the force.
    fn warn(&mut self) {
        if !std::mem::replace(&mut self.has_warned, true)
            && let Some(warning) = self.turns.warning()
        {
            print_message(&format!("warning: {}: {warning}", self.rows.name()));
        }
    }
}

impl LogOptions {
    /// Returns the row as a sample in body axes.
    fn sample(&self, row: &Row) -> Result<Sample, String> {
        let t_us = unsigned(row.time_us);
        let Some((accelerometer_range, gyroscope_range)) = self.ranges else {
            let (force, rates) = (vector(row.specific_force_m_s2), vector(row.rates_rad_s));
            return Ok(self.calibrated(t_us, force, rates));
        };
        let [force, rates] = counts(row)?;
        let (force, rates) = (AccelerometerCounts(force), GyroscopeCounts(rates));
        let mut sample = self.calibrated(
            t_us,
            force.to_m_s2(accelerometer_range),
            rates.to_rad_s(gyroscope_range),
        );
        sample.is_force_saturated = force.is_saturated();
        sample.is_rate_saturated = rates.is_saturated();
        Ok(sample)
    }

    /// Returns the sample of readings in the sensor's axes.
    fn calibrated(&self, t_us: u64, force_m_s2: Vector3, rates_rad_s: Vector3) -> Sample {
        let accelerometer = self.calibration.accelerometer;
        let accelerometer = accelerometer.unwrap_or(AccelerometerCorrection::NONE);
        let gyroscope = self.calibration.gyroscope_matrix;
        let gyroscope = gyroscope.unwrap_or(Matrix3::IDENTITY);
        Sample::new(
            t_us,
            self.mount.to_body(accelerometer.apply(force_m_s2)),
            self.mount.to_body(gyroscope.times(rates_rad_s)),
        )
    }
}

impl Source for LogSource {
    fn full_scale_g(&self) -> u16 {
        full_scale_g(self.pipeline.settings())
    }

    fn warnings(&self) -> Vec<String> {
        self.plateaus.message().into_iter().collect()
    }

    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let row = match self.ahead.pop_front() {
            Some(row) => Some(row),
            None => self.read()?,
        };
        let refused = |reason| format!("{}: {reason}", self.rows.name());
        let arming = &mut self.options.arming;
        let Some(row) = row else {
            arming.end().map_err(|reason| refused(reason.to_owned()))?;
            return Ok(None);
        };
        let is_armed = arming.at(row.t_us, row.armed).map_err(refused)?;
        self.pipeline.set_armed(is_armed);
        let snapshot = self.pipeline.update_sample(&row.sample);
        if let Some(field) = row.field {
            let delay_us = self.options.compass.delay_us;
            self.pipeline.update_field(field, delay_us);
        }
        Ok(Some(Point {
            truth: row.truth,
            scored: row.scored,
            ..Point::new(&self.pipeline, &snapshot, row.t_us)
        }))
    }
}

/// Bursts through the whole pipeline.
pub struct BurstSource {
    rows: BurstRows,
    /// Bursts that were read ahead.
    ahead: VecDeque<TimedBurst>,
    /// Fault after them.
    fault: Option<Box<dyn Error>>,
    arming: Arming,
    pipeline: AnyPipeline,
}

/// Row of a table of bursts.
struct TimedBurst {
    t_us: i64,
    row: bursts::Row,
}

impl BurstSource {
    /// Starts bursts after their header. The first ones show the sensor's sample rate, which is not
    /// taken from the settings.
    pub fn new(rows: BurstRows, filter: FilterName, mut settings: Settings) -> Self {
        let mut source = Self {
            rows,
            ahead: VecDeque::new(),
            fault: None,
            arming: Arming::default(),
            pipeline: AnyPipeline::for_bursts(filter, &settings),
        };
        while source.ahead.len() < ROWS_AHEAD && source.fault.is_none() {
            match source.read() {
                Ok(Some(burst)) => source.ahead.push_back(burst),
                Ok(None) => break,
                Err(fault) => source.fault = Some(fault),
            }
        }
        let times_us: Vec<i64> = source.ahead.iter().map(|burst| burst.t_us).collect();
        settings.sensor.sample_rate_divider = divider_of_bursts(&times_us);
        source.pipeline = AnyPipeline::for_bursts(filter, &settings);
        source
    }

    fn read(&mut self) -> Result<Option<TimedBurst>, Box<dyn Error>> {
        let Some(row) = self.rows.next_row()? else {
            return Ok(None);
        };
        let t_us = i64::try_from(row.burst.captured_at_us)
            .map_err(|reason| format!("{}: t_us: {reason}", self.rows.place()))?;
        Ok(Some(TimedBurst { t_us, row }))
    }

    /// Sets the armed state of bursts that have none.
    pub fn set_arming(&mut self, arming: Arming) {
        self.arming = arming;
    }

    /// Sets what is known of the accelerometer's offset. Default: nothing.
    pub fn set_accelerometer_knowledge(&mut self, knowledge: AccelerometerKnowledge) {
        self.pipeline.set_accelerometer_knowledge(knowledge);
    }
}

impl Source for BurstSource {
    fn full_scale_g(&self) -> u16 {
        full_scale_g(self.pipeline.settings())
    }

    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let next = match self.ahead.pop_front() {
            Some(burst) => Some(burst),
            None => match self.fault.take() {
                Some(fault) => return Err(fault),
                None => self.read()?,
            },
        };
        let refused = |reason| format!("{}: {reason}", self.rows.name());
        let Some(TimedBurst { t_us, row }) = next else {
            let ended = self.arming.end();
            ended.map_err(|reason| refused(reason.to_owned()))?;
            return Ok(None);
        };
        let is_armed = self.arming.at(t_us, Some(row.is_armed)).map_err(refused)?;
        self.pipeline.set_armed(is_armed);
        let snapshot = self.pipeline.update(&row.burst, row.board);
        Ok(Some(Point::new(&self.pipeline, &snapshot, t_us)))
    }
}

/// Flight of a flight log through the whole pipeline.
pub struct FlightSource {
    replay: Replay,
}

impl FlightSource {
    /// Starts the replay of a flight.
    pub fn new(log: &FlightLog, flight: &Flight, filter: FilterName) -> Result<Self, String> {
        let replay = Replay::new(log, flight, filter)?;
        Ok(Self { replay })
    }

    /// Returns the mount of the sensor.
    pub fn mount(&self) -> Mount {
        self.replay.pipeline().settings().mount()
    }

    /// Returns the agreement with the flight so far.
    pub fn agreement(&self) -> &Agreement {
        self.replay.agreement()
    }
}

impl Source for FlightSource {
    fn full_scale_g(&self) -> u16 {
        full_scale_g(self.replay.pipeline().settings())
    }

    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let Some(snapshot) = self.replay.next() else {
            return Ok(None);
        };
        let t_us = i64::try_from(snapshot.t_us)?;
        Ok(Some(Point::new(self.replay.pipeline(), &snapshot, t_us)))
    }
}

/// Returns the accelerometer's full scale, g.
fn full_scale_g(settings: &Settings) -> u16 {
    settings.sensor.accelerometer_range.full_scale_g()
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3::new(x as f32, y as f32, z as f32)
}
