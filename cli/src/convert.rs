//! `aplomb convert`: flight logs, bursts and CSV logs into each other.

use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};

use aplomb::calibration::Mount;
use aplomb::health::Flags;
use aplomb::mpu6050::{
    AccelerometerCounts, Burst, Config, GyroscopeCounts, Part, RawSample, TemperatureCounts,
};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::bursts;
use virtual_board::motion::log::parse_row;

use crate::flight_log::{self, Recorder};
use crate::input::Form;
use crate::output::OutputFile;
use crate::{number, progress, replay};

/// Convert a recording into another form.
///
/// INPUT is a flight log (what the module sends with `format log`), a bursts.csv or a log in SI units, plain or gzipped.
/// OUTPUT's name says what it becomes: *.log a flight log, *bursts.csv bursts, any other *.csv a log in SI units and the sensor's
/// axes, as `replay` reads it. A log in SI units becomes counts at 16 g and 2000 degrees per second, rounded.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb convert flight.log flight-bursts.csv
  aplomb convert recording.csv.gz recording.log

JSON: input, output, bursts, bursts_lost, damaged_pieces.")]
pub struct Options {
    /// The recording
    input: PathBuf,
    /// The file to write
    output: PathBuf,
    /// What a flight log that is made of bursts or of CSV says about the mount
    #[arg(long, default_value = "z-up", allow_hyphen_values = true, value_parser = replay::parse_mount)]
    mount: Mount,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// A burst, and what the board said of it.
type FlaggedBurst = (Burst, Flags);

/// Does it.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let found = read(&options.input)?;
    let settings = Settings {
        sensor: found.config,
        mount: options.mount,
        ..Settings::new(found.part)
    };
    let output = &options.output;
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    let write: fn(&mut OutputFile, &Settings, &[FlaggedBurst]) -> std::io::Result<()> =
        if name.ends_with(".log") {
            write_log
        } else if name.ends_with("bursts.csv") {
            write_bursts
        } else if name.ends_with(".csv") {
            write_csv
        } else {
            return Err(format!(
                "{}: the name has to end with .log, bursts.csv or .csv, which says what to write",
                output.display()
            )
            .into());
        };
    let mut file = OutputFile::create(output, &[&options.input])?;
    write(&mut file, &settings, &found.bursts).map_err(|error| file.failed(&error))?;
    file.finish()?;
    let summary = Summary {
        input: options.input.display().to_string(),
        output: output.display().to_string(),
        bursts: found.bursts.len(),
        bursts_lost: found.bursts_lost,
        damaged_pieces: found.damaged_pieces,
    };
    if options.json {
        crate::say(&serde_json::to_string(&summary)?);
        return Ok(());
    }
    if found.bursts_lost + found.damaged_pieces > 0 {
        crate::say(&format!(
            "{}: {} bursts are missing, {} damaged pieces skipped",
            summary.input, found.bursts_lost, found.damaged_pieces
        ));
    }
    crate::say(&format!("{}: {} bursts", summary.output, summary.bursts));
    Ok(())
}

/// What is printed in the end; the names are those of the JSON.
#[derive(serde::Serialize)]
struct Summary {
    input: String,
    output: String,
    bursts: usize,
    bursts_lost: u64,
    damaged_pieces: u64,
}

/// What is in a recording.
struct Found {
    config: Config,
    part: &'static Part,
    bursts: Vec<FlaggedBurst>,
    bursts_lost: u64,
    damaged_pieces: u64,
}

fn read(path: &Path) -> Result<Found, Box<dyn Error>> {
    if flight_log::is_one(path) {
        let log = flight_log::read(path)?;
        let Some(first) = log
            .flights
            .iter()
            .find_map(|flight| flight.configurations.first())
        else {
            return Err(format!("{}: there is no configuration in it", path.display()).into());
        };
        let bursts = log.flights.iter().flat_map(|flight| &flight.bursts);
        let bursts = bursts
            .map(|numbered| (numbered.burst, numbered.flags))
            .collect();
        return Ok(Found {
            config: first.settings.sensor,
            part: first.settings.part,
            bursts,
            bursts_lost: log.flights.iter().map(flight_log::Flight::lost).sum(),
            damaged_pieces: log.counts.damaged,
        });
    }
    let mut lines = progress::lines(path)?;
    let form = Form::read(&mut lines)?;
    let mut found = Vec::new();
    while let Some(line) = lines.next_line()? {
        let burst = match form {
            Form::Bursts => bursts::decode(line).map_err(|error| error.to_string()),
            Form::Log(columns) => match parse_row(line, columns) {
                Err(fault) => return Err(lines.refuse(fault).into()),
                Ok(row) => {
                    let burst = Burst {
                        bytes: counts_of(row.specific_force_m_s2, row.rates_rad_s).encode(),
                        captured_at_us: u64::try_from(row.time_us)
                            .map_err(|_| format!("{}: t_us is negative", lines.place()))?,
                        missed_before: 0,
                    };
                    Ok((burst, Flags::NONE))
                }
            },
        };
        found.push(burst.map_err(|reason| format!("{}: {reason}", lines.place()))?);
    }
    Ok(Found {
        config: Config::DEFAULT,
        part: &Part::MPU_6050,
        bursts: found,
        bursts_lost: 0,
        damaged_pieces: 0,
    })
}

/// What the default full scales make of SI units.
fn counts_of(force_m_s2: [f64; 3], rates_rad_s: [f64; 3]) -> RawSample {
    let config = Config::DEFAULT;
    let count = |values: [f64; 3], unit: f32| {
        // A cast saturates, as the sensor does.
        values.map(|value| (value / f64::from(unit)).round() as i16)
    };
    RawSample {
        accelerometer: AccelerometerCounts(count(
            force_m_s2,
            config.accelerometer_range.m_s2_per_count(),
        )),
        // 25 °C (register map §4.18).
        temperature: TemperatureCounts(-3_920),
        gyroscope: GyroscopeCounts(count(rates_rad_s, config.gyroscope_range.rad_s_per_count())),
    }
}

fn write_log(
    file: &mut OutputFile,
    settings: &Settings,
    bursts: &[FlaggedBurst],
) -> std::io::Result<()> {
    let mut recorder = Recorder::new(file, Pipeline::new(settings), 0);
    bursts
        .iter()
        .try_for_each(|(burst, flags)| recorder.add(burst, *flags).map(|_| ()))
}

fn write_bursts(
    file: &mut OutputFile,
    _: &Settings,
    bursts: &[FlaggedBurst],
) -> std::io::Result<()> {
    writeln!(file, "{}", bursts::HEADER)?;
    bursts
        .iter()
        .try_for_each(|(burst, flags)| writeln!(file, "{}", bursts::Line(burst, *flags)))
}

fn write_csv(
    file: &mut OutputFile,
    settings: &Settings,
    bursts: &[FlaggedBurst],
) -> std::io::Result<()> {
    writeln!(file, "t_us,ax,ay,az,gx,gy,gz")?;
    let mut line = Vec::new();
    for (burst, _) in bursts {
        let raw = RawSample::decode(&burst.bytes);
        let force = raw
            .accelerometer
            .to_m_s2(settings.sensor.accelerometer_range);
        let rates = raw.gyroscope.to_rad_s(settings.sensor.gyroscope_range);
        line.clear();
        write!(line, "{}", burst.captured_at_us)?;
        for value in [force.x, force.y, force.z, rates.x, rates.y, rates.z] {
            line.push(b',');
            number::append(&mut line, value);
        }
        line.push(b'\n');
        file.write_all(&line)?;
    }
    Ok(())
}
