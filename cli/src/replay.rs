//! `aplomb replay`: a recording through the library, one attitude for each row.
//!
//! The pipeline takes the rows of a log as samples in SI units. It takes bursts as bytes, as on a
//! board, and gives the same attitudes to the last bit. Both have the flags that depend on samples,
//! `VALID` included. Flags of the bus, the registers and the chip's clock come with bursts alone,
//! as far as the board noted them.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};

use aplomb::attitude::{BodyVector, EulerAngles, Vector3};
use aplomb::calibration::Mount;
use aplomb::estimator::REVISION;
use aplomb::health::Flags;
use aplomb::units::degrees;
use aplomb_recordings::attitude::up_in_body;
use aplomb_recordings::flight_log::{self, Flight};
use aplomb_recordings::heading::{self, HeadingErrors, HeadingScore};
use aplomb_recordings::number;
use aplomb_recordings::output::OutputFile;
use aplomb_recordings::score::{Errors, Score, up_in_sensor};
use aplomb_recordings::terminal::print_line;

use crate::any_pipeline::FilterName;
use crate::flight_replay::Agreement;
use crate::progress;
use crate::read_options::ReadOptions;
use crate::source::{Point, Source};
use crate::vibration_monitor::VibrationMonitor;

/// First line of the output.
const HEADER: &str = "t_us,qw,qx,qy,qz,roll_deg,pitch_deg,yaw_deg,\
    roll_rate_dps,pitch_rate_dps,yaw_rate_dps,up_x,up_y,up_z,tilt_sigma_deg,flags,\
    heading_deg,heading_sigma_deg,yaw_offset_deg";

/// Run a recording through a filter: one attitude for each row.
///
/// INPUT is a recording (t_us,ax,ay,az,gx,gy,gz[,mx,my,mz][,qw,qx,qy,qz[,mov]][,armed];
/// microseconds, m/s², rad/s, µT; truth sensor to earth with x east, y north, z up; armed is 1 or
/// 0 from its row on, empty where it stays), a bursts.csv (t_us,bytes,flags, with ARMED among the
/// flags) or a flight log (what the module sends with `format log`), plain or gzipped; - is
/// standard input, for all but flight logs. A flight log brings its own settings, and its attitudes
/// are compared with those of the flight: of the options for reading it takes --filter and --flight
/// alone. With truth in it, the inclination error is printed, over the rows with mov 1 after 5 s;
/// with a compass in it also the heading error.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb replay recording.csv.gz --output attitude.csv
  aplomb replay flight.log --json
  aplomb replay compass.csv --compass calibrated --compass-delay-us 10000 --sensor-delay-us 4000
  aplomb replay ride.csv --armed-from 5
  aplomb replay ride.csv --calibration calibration.json
  aplomb replay counts.csv --raw --accel-range 8 --gyro-range 250 --mount z-down

Output: one row for each sample. tilt_sigma_deg is empty without a tilt, the heading's columns while
the heading is unknown.

JSON: input, filter, mount, samples, seconds, flags (how many samples have each); with truth
inclination_samples, inclination_rms_deg, inclination_p95_deg, inclination_max_deg,
within_3_sigma (a share), median_error_per_sigma; with a compass and truth heading_known (a share),
heading_rms_deg, heading_rms_without_offset_deg, heading_offset_deg, heading_within_3_sigma,
median_heading_error_per_sigma; warnings (of clipping, and of vibration that is
too strong), if there are any; of a flight log also log with bursts_lost,
damaged_pieces, damaged_bytes, cut_off (a gzip file that ends too early), exact, compared,
different, revision_flown, and with a compass in it compass with readings, readings_lost,
heading_exact, heading_compared, heading_different.")]
pub struct Options {
    #[command(flatten)]
    reading: ReadOptions,
    /// Write the attitudes to this file; zipped if its name ends with .gz
    #[arg(long, value_name = "OUT.csv")]
    output: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let reading = &options.reading;
    if flight_log::is_flight_log(&reading.input) {
        return run_flight_log(options);
    }
    let lines = progress::lines(&reading.input)?;
    let mut source = reading.open(lines)?;
    let summary = replay(options, reading.mount(), reading.filter(), &mut *source)?;
    summary.print(options.json)
}

/// Summary of a replay. The names are those of the JSON.
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
    #[serde(flatten)]
    heading: Option<HeadingScore>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    log: Option<LogSummary>,
}

/// Summary of a flight log, and its agreement with the flight.
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
    #[serde(skip_serializing_if = "Option::is_none")]
    compass: Option<LoggedCompass>,
}

/// Compass of a flight log, and the heading's agreement with the flight.
#[derive(serde::Serialize)]
struct LoggedCompass {
    readings: u64,
    readings_lost: u64,
    heading_exact: u64,
    heading_compared: u64,
    heading_different: u64,
}

impl LoggedCompass {
    /// Returns the figures of a replayed flight; `None` without a compass.
    fn new(flight: &Flight, agreement: &Agreement) -> Option<Self> {
        (flight.readings > 0).then_some(Self {
            readings: flight.readings,
            readings_lost: flight.readings_lost,
            heading_exact: agreement.heading_exact,
            heading_compared: agreement.heading_compared,
            heading_different: agreement.heading_different,
        })
    }
}

impl Summary {
    fn print(&self, as_json: bool) -> Result<(), Box<dyn Error>> {
        if as_json {
            print_line(&serde_json::to_string(self)?);
            return Ok(());
        }
        print_line(&format!(
            "{}: {} rows, {:.1} s, filter {}, mount {}",
            self.input, self.samples, self.seconds, self.filter, self.mount,
        ));
        for (name, _) in Flags::all().iter_names() {
            if let Some(count) = self.flags.get(name) {
                print_line(&format!("{name}: {count} rows"));
            }
        }
        print_line(&match &self.score {
            Some(score) => format!("inclination error: {score}"),
            None => "inclination error: unknown, the recording has no truth that counts".to_owned(),
        });
        if let Some(heading) = &self.heading {
            print_line(&format!("heading error: {heading}"));
        }
        for warning in &self.warnings {
            print_line(warning);
        }
        let Some(log) = &self.log else {
            return Ok(());
        };
        print_line(&format!(
            "flight log: {} bursts lost, {} damaged pieces ({} bytes) skipped",
            log.bursts_lost, log.damaged_pieces, log.damaged_bytes
        ));
        print_line(&format!(
            "exact: {} of {} attitudes; {} compared with the flight's own, {} differ",
            log.exact, self.samples, log.compared, log.different
        ));
        if let Some(compass) = &log.compass {
            print_line(&format!(
                "compass: {} readings, {} lost; {} headings exact; \
                 {} compared with the flight's own, {} differ",
                compass.readings,
                compass.readings_lost,
                compass.heading_exact,
                compass.heading_compared,
                compass.heading_different
            ));
        }
        if log.revision_flown != REVISION {
            print_line(&format!(
                "the filters that flew are of revision {}, these of {REVISION}: \
                 nothing can be exact",
                log.revision_flown
            ));
        }
        Ok(())
    }
}

/// Replays every flight of a flight log, or the chosen one. A difference from a logged attitude is
/// an error.
fn run_flight_log(options: &Options) -> Result<(), Box<dyn Error>> {
    let reading = &options.reading;
    let log = flight_log::read(&reading.input)?;
    let place = reading.input.display();
    if !options.json {
        for message in &log.messages {
            print_line(&format!("# {message}"));
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
        let mut source = reading.open_flight(&log, flight)?;
        let mut summary = replay(options, source.mount(), reading.filter(), &mut source)?;
        let agreement = source.agreement();
        summary.log = Some(LogSummary {
            bursts_lost: flight.lost(),
            damaged_pieces: log.counts.damaged,
            damaged_bytes: log.counts.damaged_bytes,
            cut_off: log.is_cut_off,
            exact: agreement.exact,
            compared: agreement.compared,
            different: agreement.different,
            revision_flown: agreement.other_revision.unwrap_or(REVISION),
            compass: LoggedCompass::new(flight, agreement),
        });
        summary.print(options.json)?;
        if let Some(t_us) = agreement.first_difference_us {
            return Err(format!(
                "{place}: the attitude or the heading at {t_us} us is not the flight's, \
                 although nothing is missing before it"
            )
            .into());
        }
    }
    Ok(())
}

fn replay(
    options: &Options,
    mount: Mount,
    filter: FilterName,
    source: &mut dyn Source,
) -> Result<Summary, Box<dyn Error>> {
    let input = &options.reading.input;
    let mut source = VibrationMonitor::new(source);
    let mut output = match &options.output {
        Some(path) => Some(Attitudes::create(path, &options.reading.inputs())?),
        None => None,
    };
    let (mut errors, mut headings) = (Errors::default(), HeadingErrors::default());
    let mut flagged: Vec<_> = Flags::all()
        .iter_names()
        .map(|(name, flag)| (name, flag, 0))
        .collect();
    let (mut samples, mut first_us, mut last_us) = (0_u64, None, 0);
    while let Some(point) = source.next()? {
        let first_us = *first_us.get_or_insert(point.t_us);
        last_us = point.t_us;
        samples += 1;
        let up = mount.to_sensor(BodyVector(up_in_body(point.attitude)));
        if let Some(truth) = point
            .truth
            .filter(|_| point.is_scored_after_start(first_us))
        {
            errors.add(
                [up.x, up.y, up.z].map(f64::from),
                up_in_sensor(truth),
                point.tilt_sigma_rad,
            );
            headings.add(point.heading.map(|heading| {
                let error = heading::error_deg(point.absolute_attitude(&heading), truth, mount);
                (error, Some(degrees(heading.sigma_rad).into()))
            }));
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
        heading: headings.score(),
        warnings: source.warnings(),
        log: None,
    })
}

/// Output file of attitudes.
struct Attitudes {
    file: OutputFile,
    line: Vec<u8>,
}

impl Attitudes {
    fn create(path: &Path, inputs: &[&Path]) -> Result<Self, String> {
        let mut file = OutputFile::create(path, inputs)?;
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
        match point.heading {
            Some(heading) => {
                for angle_rad in [
                    heading.heading_rad(yaw_rad),
                    heading.sigma_rad,
                    heading.yaw_offset_rad,
                ] {
                    self.line.push(b',');
                    number::append(&mut self.line, degrees(angle_rad));
                }
            }
            None => self.line.extend_from_slice(b",,,"),
        }
        self.line.push(b'\n');
        written
            .and_then(|()| self.file.write_all(&self.line))
            .map_err(|error| self.file.failed(&error))
    }
}
