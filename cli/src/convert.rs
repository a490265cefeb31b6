//! `aplomb convert`: flight logs, bursts and recordings into each other, burst by burst.

mod replay_hint;
mod writers;

use std::collections::VecDeque;
use std::error::Error;
use std::path::{Path, PathBuf};

use aplomb::calibration::Mount;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{
    AccelerometerCounts, Burst, Config, GyroscopeCounts, Part, RawSample, TemperatureCounts,
};
use aplomb::pipeline::{CompassReading, Settings};
use aplomb::telemetry::bursts;
use aplomb_recordings::flight_log;
use aplomb_recordings::form::Form;
use aplomb_recordings::log::{LogFault, Row, Rows};
use aplomb_recordings::output::OutputFile;
use aplomb_recordings::rate::{ROWS_AHEAD, divider_of_bursts, sample_rate_divider};
use aplomb_recordings::terminal::print_line;
use aplomb_recordings::units::RowOptions;

use crate::arming::{LoggedArming, bursts_arm};
use crate::burst_rows::BurstRows;
use crate::count_options::{RangeOptions, check_rows_of_bursts};
use crate::progress;
use crate::usage::Usage;

use replay_hint::{Readings, Replayed};
use writers::{Target, write_bursts, write_csv, write_log};

/// Convert a recording into another form.
///
/// INPUT is a flight log (what the module sends with `format log`), a bursts.csv or a recording in
/// SI units, plain or gzipped. OUTPUT's name decides on its form: *.log a flight log, *bursts.csv
/// bursts, any other *.csv a recording in SI units and the sensor's axes, as `replay` reads it,
/// with mx,my,mz in µT if a flight log has readings of a compass; they are corrected. All three
/// forms keep the armed state and the knowledge of the accelerometer that the input states. A
/// recording in SI units becomes counts at 16 g and 2000 degrees per second, rounded; its truth is
/// left out. Bursts and CSV recordings have no place for a flight log's mount and calibration:
/// `convert` prints the options to replay them with. The values are the sensor's own, without the
/// flight's calibration. A CSV made of them says so in its first line, `# --accelerometer factory`.
/// Bursts of other ranges than 16 g and 2000 degrees per second begin with lines such as
/// `# --accel-range 2`.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb convert flight.log flight-bursts.csv
  aplomb convert recording.csv.gz recording.log

JSON: input, output, bursts, bursts_lost, damaged_pieces,
clipped_values (of a recording in SI units, beyond the ranges), left_out (what the output has no
place for: temperature, flags, truth, compass), armed_unknown (true if a flight log's armed state
cannot be read), readings (of a compass, if any were written), replay_options (for the output's
replay, if it is made of bursts or of a flight log).")]
pub struct Options {
    /// The recording
    input: PathBuf,
    /// The file to write
    output: PathBuf,
    /// Mount of a flight log that is made of bursts or of CSV [default: z-up]
    #[arg(long, allow_hyphen_values = true)]
    mount: Option<Mount>,
    /// Number of the flight, in a flight log with several starts of the module, counted from 1
    #[arg(long, value_name = "N")]
    flight: Option<usize>,
    #[command(flatten)]
    ranges: RangeOptions,
    #[command(flatten)]
    rows: RowOptions,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// Kind of a recording.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    FlightLog,
    Bursts,
    Csv,
}

impl Kind {
    /// Returns the kind by the name of the output.
    fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.ends_with(".log") {
            Some(Self::FlightLog)
        } else if name.ends_with("bursts.csv") {
            Some(Self::Bursts)
        } else if name.ends_with(".csv") {
            Some(Self::Csv)
        } else {
            None
        }
    }

    /// Returns the name.
    fn name(self) -> &'static str {
        match self {
            Self::FlightLog => "a flight log",
            Self::Bursts => "a table of bursts",
            Self::Csv => "a recording in SI units",
        }
    }

    /// Refuses a conversion into the present kind, and options that mean nothing.
    fn check(self, options: &Options, into: Self) -> Result<(), Usage> {
        let input = options.input.display();
        let rows = options.rows.given();
        let given = rows.iter().find(|(_, is_given)| *is_given);
        if let Some((name, _)) = given.filter(|_| self == Self::Csv && into == Self::Csv) {
            return Err(format!(
                "{input}: `convert` changes the form of a recording, and no CSV into another: \
                 `replay`, `plot` and `calibrate` take {name} themselves"
            )
            .into());
        }
        if self == into {
            return Err(format!("{input}: it is {} already: copy it", self.name()).into());
        }
        if options.mount.is_some() && into != Self::FlightLog {
            let into = into.name();
            return Err(
                format!("{input}: --mount would change nothing: {into} does not say it").into(),
            );
        }
        let ranges = options.ranges.given().into_iter();
        let own = ranges.filter(|_| self != Self::Bursts);
        let own = own.chain([(
            "--flight",
            options.flight.is_some() && self != Self::FlightLog,
        )]);
        let rows = rows.into_iter().filter(|_| self == Self::FlightLog);
        let mut unused = own.chain(rows).filter(|(_, is_given)| *is_given);
        if let Some((name, _)) = unused.next() {
            let own = self.name();
            return Err(format!("{input}: {name} would change nothing: it is {own}").into());
        }
        match self {
            Self::Bursts => check_rows_of_bursts(&options.rows),
            Self::FlightLog | Self::Csv => Ok(()),
        }
    }
}

/// Burst of a recording, with the conditions that the board reported.
struct Recorded {
    row: bursts::Row,
    /// Reading of the compass that was added after the burst.
    reading: Option<CompassReading>,
    /// Values beyond the ranges, which were clipped.
    clipped_values: usize,
}

/// Bursts of a recording, in order.
type Bursts = Box<dyn Iterator<Item = Result<Recorded, Box<dyn Error>>>>;

/// Sums over the bursts that were written.
#[derive(Default)]
struct Written {
    bursts: usize,
    clipped_values: usize,
    /// A burst has flags, or samples before it are missing.
    has_flags: bool,
    readings: Readings,
}

impl Written {
    fn count(&mut self, recorded: &Recorded, replayed: Option<&Replayed>) {
        if let (Some(reading), Some(replayed)) = (&recorded.reading, replayed) {
            self.readings.add(reading, replayed);
        }
        self.bursts += 1;
        self.clipped_values += recorded.clipped_values;
        let row = &recorded.row;
        self.has_flags |= row.burst.missed_before > 0 || !row.board.is_empty();
    }
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let output = &options.output;
    let into = Kind::of_name(output).ok_or_else(|| {
        Usage::from(format!(
            "{}: the name has to end with .log, bursts.csv or .csv, which says what to write",
            output.display()
        ))
    })?;
    let mut found = open(options, into)?;
    let flown = found.replayed.as_ref().and_then(Replayed::mount);
    let settings = Settings {
        sensor: found.config,
        mount: options.mount.or(flown).unwrap_or(Mount::Z_UP),
        ..Settings::new(found.part)
    };
    let has_compass = found.has_readings;
    let target = Target {
        settings,
        has_compass,
        has_armed: found.has_armed,
        knowledge: found.knowledge,
    };
    let write = match into {
        Kind::FlightLog => write_log,
        Kind::Bursts => write_bursts,
        Kind::Csv => write_csv,
    };
    let mut file = OutputFile::create(output, &[&options.input])?;
    let (mut written, mut failure) = (Written::default(), None);
    let mut bursts = found.bursts.by_ref().map_while(|recorded| match recorded {
        Ok(recorded) => {
            written.count(&recorded, found.replayed.as_ref());
            Some(recorded)
        }
        Err(error) => {
            failure = Some(error);
            None
        }
    });
    write(&mut file, &target, &mut bursts).map_err(|error| file.failed(&error))?;
    if let Some(failure) = failure {
        return Err(failure);
    }
    if written.bursts == 0 {
        let input = options.input.display();
        return Err(format!("{input}: there is no row after the header").into());
    }
    file.finish()?;
    report(options, into, &found, &mut written)
}

/// Prints what was written, and what was left out.
fn report(
    options: &Options,
    into: Kind,
    found: &Input,
    written: &mut Written,
) -> Result<(), Box<dyn Error>> {
    let writes_readings = into == Kind::Csv && written.readings.count > 0;
    let left_out = found.left_out(into, written.has_flags);
    let replayed = found.replayed.as_ref();
    let replay_options = replayed.and_then(|it| it.options(into, &mut written.readings));
    let summary = Summary {
        input: options.input.display().to_string(),
        output: options.output.display().to_string(),
        bursts: written.bursts,
        bursts_lost: found.bursts_lost,
        damaged_pieces: found.damaged_pieces,
        clipped_values: written.clipped_values,
        left_out,
        armed_unknown: found.is_armed_unknown,
        readings: writes_readings.then_some(written.readings.count),
        replay_options,
    };
    if options.json {
        print_line(&serde_json::to_string(&summary)?);
        return Ok(());
    }
    if found.bursts_lost + found.damaged_pieces > 0 {
        print_line(&format!(
            "{}: {} bursts are missing, {} damaged pieces skipped",
            summary.input, found.bursts_lost, found.damaged_pieces
        ));
    }
    if written.clipped_values > 0 {
        print_line(&format!(
            "{}: {} values are beyond 16 g or 2000 degrees per second and were clipped",
            summary.input, written.clipped_values
        ));
    }
    print_line(&format!("{}: {} bursts", summary.output, summary.bursts));
    if !summary.left_out.is_empty() {
        let left_out = summary.left_out.join(" and ");
        print_line(&format!(
            "left out, as {} has no place for it: {left_out}",
            into.name()
        ));
    }
    if summary.armed_unknown {
        print_line(&format!(
            "{}: the armed state is not in it, because no state of the filter can be read: \
             replay it with --armed-from, if it was armed",
            summary.output
        ));
    }
    if let Some((replayed, replay_options)) = replayed.zip(summary.replay_options) {
        for line in replayed.lines(into, &replay_options, &written.readings) {
            print_line(&line);
        }
    }
    Ok(())
}

/// Summary of a conversion. The names are those of the JSON.
#[derive(serde::Serialize)]
struct Summary {
    input: String,
    output: String,
    bursts: usize,
    bursts_lost: u64,
    damaged_pieces: u64,
    clipped_values: usize,
    left_out: Vec<&'static str>,
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    armed_unknown: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    readings: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    replay_options: Option<String>,
}

/// Recording whose bursts are still to be read.
struct Input {
    config: Config,
    /// Settings for a replay of its bursts; `None` of a recording in SI units.
    replayed: Option<Replayed>,
    /// Knowledge of accelerometer and gyroscope, if it is known.
    knowledge: Option<AccelerometerKnowledge>,
    part: &'static Part,
    bursts: Bursts,
    bursts_lost: u64,
    damaged_pieces: u64,
    /// The recording has a truth.
    has_truth: bool,
    /// The recording has readings of a compass.
    has_readings: bool,
    /// The recording arms.
    has_armed: bool,
    /// The recording is a flight log whose armed state cannot be read.
    is_armed_unknown: bool,
    /// The recording has no temperature: 25 °C stands for it.
    is_csv: bool,
}

impl Input {
    /// Returns what this kind of output has no place for.
    fn left_out(&self, into: Kind, has_flags: bool) -> Vec<&'static str> {
        let lost = [
            ("the temperature", into == Kind::Csv && !self.is_csv),
            ("the board's flags", into == Kind::Csv && has_flags),
            ("the truth", self.has_truth),
            ("the compass", self.has_readings && into != Kind::Csv),
        ];
        let lost = lost.into_iter().filter(|(_, is_lost)| *is_lost);
        lost.map(|(name, _)| name).collect()
    }
}

/// Opens the input of the options, to be converted into this kind.
fn open(options: &Options, into: Kind) -> Result<Input, Box<dyn Error>> {
    let path = &options.input;
    if flight_log::is_flight_log(path) {
        return open_flight_log(options, into);
    }
    let mut lines = progress::lines(path)?;
    let form = Form::read(&mut lines)?;
    let stated = *lines.stated();
    let table = |has_armed: bool, (divider, bursts): (u8, Bursts)| Input {
        config: Config::DEFAULT.with_sample_rate_divider(divider),
        replayed: None,
        knowledge: stated.accelerometer,
        part: &Part::MPU_6050,
        bursts,
        bursts_lost: 0,
        damaged_pieces: 0,
        has_truth: false,
        has_readings: false,
        has_armed,
        is_armed_unknown: false,
        is_csv: false,
    };
    match form {
        Form::Bursts => {
            Kind::Bursts.check(options, into)?;
            let mut rows = BurstRows::new(lines, options.rows.bad_rows);
            let next = move || next_burst(&mut rows).transpose();
            let bursts = std::iter::from_fn(next);
            let has_armed = into == Kind::Csv && bursts_arm(path);
            let (divider, bursts) = with_divider(bursts, divider_of_bursts);
            let config = options.ranges.config(&stated);
            let config = config.with_sample_rate_divider(divider);
            let knowledge = stated
                .accelerometer
                .unwrap_or(AccelerometerKnowledge::Factory);
            Ok(Input {
                config,
                replayed: Some(Replayed::of_bursts(config, knowledge)),
                knowledge: Some(knowledge),
                ..table(has_armed, (divider, bursts))
            })
        }
        Form::Log(columns) => {
            Kind::Csv.check(options, into)?;
            let mut rows = Rows::new(lines, columns, options.rows, false)?;
            let mut is_armed = false;
            let next = move || next_row(&mut rows, &mut is_armed).transpose();
            let bursts = std::iter::from_fn(next);
            Ok(Input {
                has_truth: columns.has_truth(),
                has_readings: columns.has_compass(),
                is_csv: true,
                ..table(
                    columns.has_armed(),
                    with_divider(bursts, sample_rate_divider),
                )
            })
        }
    }
}

/// Reads the first bursts ahead, and returns the sensor's divider by their times, with all bursts.
fn with_divider(
    mut bursts: impl Iterator<Item = Result<Recorded, Box<dyn Error>>> + 'static,
    divider: fn(&[i64]) -> u8,
) -> (u8, Bursts) {
    let first: VecDeque<_> = bursts.by_ref().take(ROWS_AHEAD).collect();
    let times_us: Vec<i64> = first
        .iter()
        .flatten()
        .map(|recorded| recorded.row.burst.captured_at_us.cast_signed())
        .collect();
    (
        divider(&times_us),
        Box::new(first.into_iter().chain(bursts)),
    )
}

/// Opens a flight of a flight log.
fn open_flight_log(options: &Options, into: Kind) -> Result<Input, Box<dyn Error>> {
    let path = &options.input;
    Kind::FlightLog.check(options, into)?;
    let log = flight_log::read(path)?;
    let at = |reason: String| format!("{}: {reason}", path.display());
    let flight = log.flight(options.flight).map_err(at)?;
    let first = flight
        .configuration
        .as_ref()
        .ok_or_else(|| at("there is no configuration in it".to_owned()))?;
    let mut arming = LoggedArming::read(log.steps(flight)?, first);
    let (has_armed, is_armed_unknown) = match &arming {
        Some(arming) => (arming.arms(), false),
        None => (false, true),
    };
    let steps = log.steps(flight)?;
    let Settings { part, sensor, .. } = first.settings;
    Ok(Input {
        config: sensor,
        replayed: Some(Replayed::of_flight(first.settings)),
        // The values are the sensor's own: no calibration of the flight counts.
        knowledge: Some(AccelerometerKnowledge::Factory),
        part,
        bursts: Box::new(steps.map(move |step| {
            let number = step.numbered.number;
            Ok(Recorded {
                row: bursts::Row {
                    burst: step.numbered.burst,
                    board: step.numbered.flags,
                    is_armed: arming.as_mut().is_some_and(|arming| arming.at(number)),
                },
                reading: step.reading,
                clipped_values: 0,
            })
        })),
        bursts_lost: flight.lost(),
        damaged_pieces: log.counts.damaged,
        has_truth: false,
        has_readings: flight.readings > 0,
        has_armed,
        is_armed_unknown,
        is_csv: false,
    })
}

/// Returns the next burst of a table of bursts.
fn next_burst(rows: &mut BurstRows) -> Result<Option<Recorded>, Box<dyn Error>> {
    let row = rows.next_row()?;
    Ok(row.map(|row| Recorded {
        row,
        reading: None,
        clipped_values: 0,
    }))
}

/// Returns the next row of a recording as a burst. Updates the armed state before.
fn next_row(rows: &mut Rows, is_armed: &mut bool) -> Result<Option<Recorded>, Box<dyn Error>> {
    let Some(row) = rows.next_row()? else {
        return Ok(None);
    };
    *is_armed = row.armed.unwrap_or(*is_armed);
    let (raw, clipped_values) = counts_of(&row).map_err(|fault| rows.refuse(fault))?;
    let burst = Burst {
        bytes: raw.encode(),
        captured_at_us: u64::try_from(row.time_us)
            .map_err(|_| format!("{}: t_us is negative", rows.place()))?,
        missed_before: 0,
    };
    Ok(Some(Recorded {
        row: bursts::Row {
            burst,
            board: BoardFlags::empty(),
            is_armed: *is_armed,
        },
        reading: None,
        clipped_values,
    }))
}

/// Converts a row to counts at the default full scales. Returns the number of clipped values too.
fn counts_of(row: &Row) -> Result<(RawSample, usize), LogFault> {
    let names = ["ax", "ay", "az", "gx", "gy", "gz"];
    let values = row.specific_force_m_s2.into_iter().chain(row.rates_rad_s);
    for (column, value) in names.into_iter().zip(values) {
        if !value.is_finite() {
            return Err(LogFault::NotFinite { column, value });
        }
    }
    let config = Config::DEFAULT;
    let mut clipped = 0;
    let mut count = |values: [f64; 3], unit: f32| {
        values.map(|value| {
            let count = (value / f64::from(unit)).round();
            clipped += usize::from(count < i16::MIN.into() || count > i16::MAX.into());
            // A cast saturates, as the sensor does.
            count as i16
        })
    };
    let accelerometer = count(
        row.specific_force_m_s2,
        config.accelerometer_range.m_s2_per_count(),
    );
    let gyroscope = count(row.rates_rad_s, config.gyroscope_range.rad_s_per_count());
    let raw = RawSample {
        accelerometer: AccelerometerCounts(accelerometer),
        // 25 °C (register map §4.18).
        temperature: TemperatureCounts(-3_920),
        gyroscope: GyroscopeCounts(gyroscope),
    };
    Ok((raw, clipped))
}
