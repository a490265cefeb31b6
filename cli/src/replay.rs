//! `aplomb replay`: a recording through the library, one attitude for each row.
//!
//! Rows of a log go through the pipeline as they are, in SI units; bursts from their bytes on, as they do on a board, and
//! give the same attitudes to the last bit. So both have the flags that samples tell,
//! `VALID` among them; what the bus, the registers and the chip's own clock did is in bursts alone, as far as the board noted it.

use std::collections::{BTreeMap, VecDeque};
use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};

use aplomb::attitude::{EulerAngles, Quaternion, Vector3};
use aplomb::calibration::Mount;
use aplomb::estimator::{REVISION, Sample};
use aplomb::health::Flags;
use aplomb::mpu6050::{
    AccelerometerCounts, AccelerometerRange, GyroscopeCounts, GyroscopeRange, Part,
};
use aplomb::pipeline::{Settings, Snapshot};
use aplomb::telemetry::bursts;
use aplomb::units::degrees;
use aplomb_models::motion::geometry::Quaternion as Truth;
use aplomb_recordings::log::{Lines, Row, parse_row};

use crate::counts::counts;
use crate::device::{Device, FilterName};
use crate::filter::up_in_body;
use crate::flight_log::{self, Flight};
use crate::input::{Counts, Form};
use crate::number;
use crate::output::OutputFile;
use crate::progress;
use crate::score::{Errors, START_US, Score, up_in_sensor};

/// The first line of the output.
pub const HEADER: &str = "t_us,qw,qx,qy,qz,roll_deg,pitch_deg,yaw_deg,roll_rate_dps,pitch_rate_dps,yaw_rate_dps,up_x,up_y,up_z,tilt_sigma_deg,flags";

/// One second: no low-pass filter or bus is so slow, and no turn goes on for so long.
const LONGEST_DELAY_US: i64 = 1_000_000;

/// So many rows of a log tell how far apart they are.
const ROWS_AHEAD: usize = 101;

/// Run a recording through a filter: one attitude for each row.
///
/// INPUT is a log (t_us,ax,ay,az,gx,gy,gz[,qw,qx,qy,qz[,mov]]; microseconds, m/s², rad/s; truth sensor to earth with z
/// up), a bursts.csv (t_us,bytes,flags) or a flight log (what the module sends with `format log`), plain or gzipped; - is standard
/// input, for all but flight logs. A flight log brings its own settings, and its attitudes are compared with those of the flight: of the options for reading it takes
/// --filter and --flight alone. With truth in it, the inclination error is printed, over the
/// rows with mov 1 after 5 s.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb replay recording.csv.gz --output attitude.csv
  aplomb replay flight.log --json
  aplomb replay counts.csv --raw --accel-range 8 --gyro-range 250 --mount z-down

JSON: input, filter, mount, samples, seconds, flags (how many samples have each); with truth inclination_samples, inclination_rms_deg,
inclination_p95_deg, inclination_max_deg, within_3_sigma (a share), median_error_per_sigma; of a flight log also log with bursts_lost,
damaged_pieces, damaged_bytes, cut_off (a gzip file that ends too early), exact, compared, different, revision_flown.")]
pub struct Options {
    #[command(flatten)]
    reading: Reading,
    /// Write the attitudes to this file; zipped if its name ends with .gz
    #[arg(long, value_name = "OUT.csv")]
    output: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// How a recording is read.
#[derive(clap::Args)]
pub struct Reading {
    /// The recording
    pub input: PathBuf,
    /// Which filter: kalman, axis-kalman, classic [default: kalman]
    #[arg(long, value_name = "NAME")]
    filter: Option<FilterName>,
    /// Where the body's forward and down axes point in sensor axes, for example +x-z [default: z-up]
    #[arg(long, allow_hyphen_values = true, value_parser = parse_mount)]
    mount: Option<Mount>,
    /// By how much samples are late, in microseconds: attitudes are extrapolated by it (logs: 0 unless told
    /// otherwise; bursts: the delay of the sensor's low-pass filter)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=LONGEST_DELAY_US))]
    sensor_delay_us: Option<u32>,
    /// Which flight of a flight log in which the module started several times, counted from 1
    #[arg(long, value_name = "N")]
    pub flight: Option<usize>,
    #[command(flatten)]
    counts: Counts,
}

/// What is read, as far as options go.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A log or bursts.
    Recording,
    FlightLog,
    /// Attitudes, with which a truth in the sensor's axes is compared, or nothing is.
    Attitudes {
        has_truth: bool,
    },
}

impl Kind {
    /// The options that mean something for it.
    fn takes(self) -> &'static [&'static str] {
        match self {
            Self::Recording => &[
                "--filter",
                "--mount",
                "--sensor-delay-us",
                "--raw",
                "--accel-range",
                "--gyro-range",
            ],
            Self::FlightLog => &["--filter", "--flight"],
            Self::Attitudes { has_truth: true } => &["--mount"],
            Self::Attitudes { has_truth: false } => &[],
        }
    }

    /// Why it takes no others.
    fn reason(self) -> &'static str {
        match self {
            Self::Recording => "it holds one flight",
            Self::FlightLog => "a flight log brings its mount, its ranges and its delay",
            Self::Attitudes { .. } => "these are attitudes, which a filter has made already",
        }
    }
}

/// Does it.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let reading = &options.reading;
    if flight_log::is_one(&reading.input) {
        return run_flight_log(options);
    }
    let lines = progress::lines(&reading.input)?;
    let mut source = reading.open(lines)?;
    let summary = replay(options, reading.mount(), reading.filter(), &mut *source)?;
    summary.say(options.json)
}

impl Reading {
    /// Refuses options that mean nothing for what is read.
    pub fn check(&self, kind: Kind) -> Result<(), String> {
        let own = [
            ("--filter", self.filter.is_some()),
            ("--mount", self.mount.is_some()),
            ("--sensor-delay-us", self.sensor_delay_us.is_some()),
            ("--flight", self.flight.is_some()),
        ];
        let given = own.into_iter().chain(self.counts.given());
        let unused = given.filter(|(name, is_given)| *is_given && !kind.takes().contains(name));
        let unused: Vec<&str> = unused.map(|(name, _)| name).collect();
        if unused.is_empty() {
            return Ok(());
        }
        Err(format!(
            "{}: {} would change nothing: {}",
            self.input.display(),
            unused.join(" "),
            kind.reason()
        ))
    }

    /// A log or bursts, whose header is the next of the lines.
    pub fn open(&self, mut lines: Lines) -> Result<Box<dyn Source>, Box<dyn Error>> {
        self.check(Kind::Recording)?;
        let form = Form::read(&mut lines)?;
        self.counts.check(form)?;
        Ok(match form {
            Form::Bursts => Box::new(Bursts::new(self, lines)),
            Form::Log(columns) => Box::new(Log::new(self, lines, columns)?),
        })
    }

    /// The mount that is told of, or the usual one.
    pub fn mount(&self) -> Mount {
        self.mount.unwrap_or(Mount::Z_UP)
    }

    fn filter(&self) -> FilterName {
        self.filter.unwrap_or_default()
    }

    /// A flight of a flight log.
    pub fn open_flight<'a>(&self, flight: &'a Flight) -> Result<Logged<'a>, String> {
        self.check(Kind::FlightLog)?;
        flight_log::Replay::new(flight, self.filter())
            .map(|replay| Logged { replay })
            .map_err(|reason| format!("{}: {reason}", self.input.display()))
    }
}

/// What is printed in the end; the names are those of the JSON.
#[derive(serde::Serialize)]
struct Summary {
    input: String,
    filter: &'static str,
    mount: &'static str,
    samples: u64,
    seconds: f64,
    flags: BTreeMap<&'static str, u64>,
    #[serde(flatten)]
    score: Option<Score>,
    #[serde(skip_serializing_if = "Option::is_none")]
    log: Option<LogSummary>,
}

/// How far the replay of a flight log is the flight.
#[derive(serde::Serialize)]
struct LogSummary {
    bursts_lost: u64,
    damaged_pieces: u64,
    damaged_bytes: u64,
    cut_off: bool,
    exact: u64,
    compared: u64,
    different: u64,
    revision_flown: u16,
}

impl Summary {
    fn say(&self, as_json: bool) -> Result<(), Box<dyn Error>> {
        if as_json {
            crate::say(&serde_json::to_string(self)?);
            return Ok(());
        }
        crate::say(&format!(
            "{}: {} rows, {:.1} s, filter {}, mount {}",
            self.input, self.samples, self.seconds, self.filter, self.mount,
        ));
        for (name, _) in Flags::all().iter_names() {
            if let Some(count) = self.flags.get(name) {
                crate::say(&format!("{name}: {count} rows"));
            }
        }
        crate::say(&match &self.score {
            Some(score) => format!("inclination error: {score}"),
            None => "inclination error: unknown, the recording has no truth that counts".to_owned(),
        });
        let Some(log) = &self.log else {
            return Ok(());
        };
        crate::say(&format!(
            "log: {} bursts lost, {} damaged pieces ({} bytes) skipped",
            log.bursts_lost, log.damaged_pieces, log.damaged_bytes
        ));
        crate::say(&format!(
            "exact: {} of {} attitudes; {} compared with the flight's own, {} differ",
            log.exact, self.samples, log.compared, log.different
        ));
        if log.revision_flown != REVISION {
            crate::say(&format!(
                "the filters that flew are of revision {}, these of {REVISION}: nothing can be exact",
                log.revision_flown
            ));
        }
        Ok(())
    }
}

/// Every flight of a log, one after the other. That an attitude of the log differs is an error.
fn run_flight_log(options: &Options) -> Result<(), Box<dyn Error>> {
    let reading = &options.reading;
    let log = flight_log::read(&reading.input)?;
    let place = reading.input.display();
    if !options.json {
        for message in &log.messages {
            crate::say(&format!("# {message}"));
        }
    }
    let takes_one = reading.flight.is_some() || options.output.is_some() || options.json;
    let flights: Vec<&Flight> = if takes_one {
        let flight = log.flight(reading.flight);
        vec![flight.map_err(|reason| format!("{place}: {reason}"))?]
    } else {
        log.flown().collect()
    };
    for flight in flights {
        let mut source = reading.open_flight(flight)?;
        let (mount, filter) = (source.mount(), source.filter());
        let mut summary = replay(options, mount, filter, &mut source)?;
        let agreement = source.replay.agreement();
        summary.log = Some(LogSummary {
            bursts_lost: flight.lost(),
            damaged_pieces: log.counts.damaged,
            damaged_bytes: log.counts.damaged_bytes,
            cut_off: log.is_cut_off,
            exact: agreement.exact,
            compared: agreement.compared,
            different: agreement.different,
            revision_flown: agreement.other_revision.unwrap_or(REVISION),
        });
        summary.say(options.json)?;
        if let Some(t_us) = agreement.first_difference_us {
            return Err(format!(
                "{place}: the attitude at {t_us} us is not the flight's, although nothing is missing before it"
            )
            .into());
        }
    }
    Ok(())
}

/// What there is to say of one row.
pub struct Point {
    /// Its time, in its own microseconds.
    pub t_us: i64,
    /// Body to earth.
    pub attitude: Quaternion,
    /// The body's own rates.
    pub body_rates_rad_s: Vector3,
    /// σ of the tilt, if the filter has one.
    pub tilt_sigma_rad: Option<f32>,
    /// What the pipeline says.
    pub flags: Flags,
    /// What the accelerometer said, in body axes, if that is known.
    pub specific_force_m_s2: Option<Vector3>,
    /// The true attitude, sensor to earth with z up, if it is known.
    pub truth: Option<Truth>,
    /// Whether the row counts for scores.
    pub counts: bool,
}

impl Point {
    /// Whether its error counts, in a recording that begins then.
    pub fn is_scored(&self, first_us: i64) -> bool {
        self.counts && self.t_us.saturating_sub(first_us) >= START_US
    }
}

/// A sequence of rows.
pub trait Source {
    /// The next row; `None` after the last.
    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>>;

    /// Whether flags are known.
    fn has_flags(&self) -> bool {
        true
    }
}

fn replay(
    options: &Options,
    mount: Mount,
    filter: FilterName,
    source: &mut dyn Source,
) -> Result<Summary, Box<dyn Error>> {
    let input = &options.reading.input;
    let mut output = match &options.output {
        Some(path) => Some(Attitudes::create(path, input)?),
        None => None,
    };
    let mut errors = Errors::default();
    let mut flagged: Vec<_> = Flags::all()
        .iter_names()
        .map(|(name, flag)| (name, flag, 0))
        .collect();
    let (mut samples, mut first_us, mut last_us) = (0_u64, None, 0);
    while let Some(point) = source.next()? {
        let first_us = *first_us.get_or_insert(point.t_us);
        last_us = point.t_us;
        samples += 1;
        let up = mount.to_sensor(up_in_body(point.attitude));
        if let Some(truth) = point.truth.filter(|_| point.is_scored(first_us)) {
            errors.add(
                [up.x, up.y, up.z].map(f64::from),
                up_in_sensor(truth),
                point.tilt_sigma_rad,
            );
        }
        for (_, flag, count) in &mut flagged {
            *count += u64::from(point.flags.contains(*flag));
        }
        if let Some(output) = &mut output {
            output.write(&point, up)?;
        }
    }
    let Some(first_us) = first_us else {
        return Err(format!("{}: there is no row after the header", input.display()).into());
    };
    if let Some(output) = output {
        output.file.finish()?;
    }
    Ok(Summary {
        input: input.display().to_string(),
        filter: filter.name(),
        mount: mount.name(),
        samples,
        seconds: last_us.saturating_sub(first_us) as f64 * 1e-6,
        flags: flagged
            .into_iter()
            .filter(|(_, _, count)| *count > 0)
            .map(|(name, _, count)| (name, count))
            .collect(),
        score: errors.score(),
        log: None,
    })
}

/// Returns the point of a snapshot, without its truth.
fn point(device: &Device, snapshot: &Snapshot, t_us: i64) -> Point {
    Point {
        t_us,
        attitude: snapshot.attitude,
        body_rates_rad_s: snapshot.body_rates_rad_s,
        tilt_sigma_rad: device.tilt_sigma_rad(snapshot),
        flags: snapshot.flags,
        specific_force_m_s2: Some(device.specific_force_m_s2()),
        truth: None,
        counts: false,
    }
}

/// A log's rows through the pipeline, as samples in SI units.
struct Log {
    lines: Lines,
    columns: usize,
    mount: Mount,
    ranges: Option<(AccelerometerRange, GyroscopeRange)>,
    /// Rows that were read ahead.
    ahead: VecDeque<LogRow>,
    device: Device,
}

/// A row of a log.
struct LogRow {
    t_us: i64,
    /// In body axes.
    sample: Sample,
    truth: Option<Truth>,
    counts: bool,
}

impl Log {
    /// A log whose header has been read. The first rows say how far apart they all are: then more is a pause.
    fn new(options: &Reading, lines: Lines, columns: usize) -> Result<Self, Box<dyn Error>> {
        let delay_us = options.sensor_delay_us.unwrap_or(0);
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.sensor_delay_us = Some(delay_us);
        let mut log = Self {
            lines,
            columns,
            mount: options.mount(),
            ranges: options.counts.ranges(),
            ahead: VecDeque::new(),
            device: Device::for_samples(options.filter(), &settings, delay_us),
        };
        while log.ahead.len() < ROWS_AHEAD
            && let Some(row) = log.read()?
        {
            log.ahead.push_back(row);
        }
        settings.sensor.sample_rate_divider = log.sample_rate_divider();
        log.device = Device::for_samples(options.filter(), &settings, delay_us);
        Ok(log)
    }

    /// What a sensor is set to that takes a sample as often as the log has a row; rounded up, for rows come irregularly.
    fn sample_rate_divider(&self) -> u8 {
        let pairs = self.ahead.iter().zip(self.ahead.iter().skip(1));
        let mut steps_us: Vec<u64> = pairs
            .map(|(before, after)| before.t_us.abs_diff(after.t_us))
            .collect();
        steps_us.sort_unstable();
        let median_us = steps_us.get(steps_us.len() / 2).copied().unwrap_or(0);
        let periods = median_us.div_ceil(1_000).saturating_sub(1);
        periods.try_into().unwrap_or(u8::MAX)
    }

    fn read(&mut self) -> Result<Option<LogRow>, Box<dyn Error>> {
        let Some(line) = self.lines.next_line()? else {
            return Ok(None);
        };
        let row = parse_row(line, self.columns).map_err(|fault| self.lines.refuse(fault))?;
        let sample = self
            .sample(&row)
            .map_err(|reason| format!("{}: {reason}", self.lines.place()))?;
        Ok(Some(LogRow {
            t_us: row.time_us,
            sample,
            truth: row.attitude,
            counts: row.moving,
        }))
    }

    /// The row as a sample in body axes.
    fn sample(&self, row: &Row) -> Result<Sample, String> {
        let t_us = unsigned(row.time_us);
        let Some((accelerometer_range, gyroscope_range)) = self.ranges else {
            return Ok(Sample {
                t_us,
                specific_force_m_s2: self.mount.to_body(vector(row.specific_force_m_s2)),
                angular_rate_rad_s: self.mount.to_body(vector(row.rates_rad_s)),
                ..Sample::default()
            });
        };
        let [force, rates] = counts(row)?;
        let (force, rates) = (AccelerometerCounts(force), GyroscopeCounts(rates));
        Ok(Sample {
            t_us,
            specific_force_m_s2: self.mount.to_body(force.to_m_s2(accelerometer_range)),
            angular_rate_rad_s: self.mount.to_body(rates.to_rad_s(gyroscope_range)),
            is_force_saturated: force.is_saturated(),
            is_rate_saturated: rates.is_saturated(),
        })
    }
}

impl Source for Log {
    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let row = match self.ahead.pop_front() {
            Some(row) => Some(row),
            None => self.read()?,
        };
        Ok(row.map(|row| {
            let snapshot = self.device.update_sample(&row.sample);
            Point {
                truth: row.truth,
                counts: row.counts,
                ..point(&self.device, &snapshot, row.t_us)
            }
        }))
    }
}

/// Bursts through the whole pipeline.
struct Bursts {
    lines: Lines,
    device: Device,
}

impl Bursts {
    fn new(options: &Reading, lines: Lines) -> Self {
        let mut settings = Settings::new(&Part::MPU_6050);
        settings.mount = options.mount();
        settings.sensor_delay_us = options.sensor_delay_us;
        settings.sensor = options.counts.config();
        Self {
            lines,
            device: Device::for_bursts(options.filter(), &settings),
        }
    }
}

impl Source for Bursts {
    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let Some(line) = self.lines.next_line()? else {
            return Ok(None);
        };
        let (burst, flags) =
            bursts::decode(line).map_err(|reason| format!("{}: {reason}", self.lines.place()))?;
        let t_us = i64::try_from(burst.captured_at_us)
            .map_err(|reason| format!("{}: t_us: {reason}", self.lines.place()))?;
        let snapshot = self.device.update(&burst, flags);
        Ok(Some(point(&self.device, &snapshot, t_us)))
    }
}

/// A flight of a flight log.
pub struct Logged<'a> {
    replay: flight_log::Replay<'a>,
}

impl Logged<'_> {
    /// How the sensor was mounted.
    pub fn mount(&self) -> Mount {
        self.replay.device().settings().mount()
    }

    /// The filter that runs.
    fn filter(&self) -> FilterName {
        self.replay.device().filter()
    }
}

impl Source for Logged<'_> {
    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let Some(snapshot) = self.replay.next() else {
            return Ok(None);
        };
        let t_us = i64::try_from(snapshot.t_us)?;
        Ok(Some(point(self.replay.device(), &snapshot, t_us)))
    }
}

/// The file of attitudes.
struct Attitudes {
    file: OutputFile,
    line: Vec<u8>,
}

impl Attitudes {
    fn create(path: &Path, input: &Path) -> Result<Self, String> {
        let mut file = OutputFile::create(path, &[input])?;
        writeln!(file, "{HEADER}").map_err(|error| file.failed(&error))?;
        Ok(Self {
            file,
            line: Vec::new(),
        })
    }

    fn write(&mut self, point: &Point, up: Vector3) -> Result<(), String> {
        let EulerAngles {
            roll_rad,
            pitch_rad,
            yaw_rad,
        } = point.attitude.to_euler();
        let (q, rates) = (point.attitude, point.body_rates_rad_s);
        let numbers = [
            q.w,
            q.x,
            q.y,
            q.z,
            degrees(roll_rad),
            degrees(pitch_rad),
            degrees(yaw_rad),
            degrees(rates.x),
            degrees(rates.y),
            degrees(rates.z),
            up.x,
            up.y,
            up.z,
        ];
        self.line.clear();
        let mut written = write!(self.line, "{}", point.t_us);
        for value in numbers {
            self.line.push(b',');
            number::append(&mut self.line, value);
        }
        self.line.push(b',');
        if let Some(sigma_rad) = point.tilt_sigma_rad {
            number::append(&mut self.line, degrees(sigma_rad));
        }
        self.line.push(b',');
        if !point.flags.is_empty() {
            written = written.and_then(|()| write!(self.line, "{}", point.flags));
        }
        self.line.push(b'\n');
        written
            .and_then(|()| self.file.write_all(&self.line))
            .map_err(|error| self.file.failed(&error))
    }
}

/// The same moments on a scale without a sign: only differences matter to a filter.
pub fn unsigned(time_us: i64) -> u64 {
    time_us.cast_unsigned() ^ (1 << 63)
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3::new(x as f32, y as f32, z as f32)
}

/// An option's mount.
pub fn parse_mount(name: &str) -> Result<Mount, String> {
    Mount::parse(name).ok_or_else(|| {
        "name the sensor axes to which forward and down point, such as +x-z, or z-up or z-down"
            .into()
    })
}
