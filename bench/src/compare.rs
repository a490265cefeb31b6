//! Comparison of the filters on recordings, and the program's options.
//!
//! Accuracy is the root mean square of the inclination error over the rows that count after 5 s.
//! Timing is the same for every filter: it is fed so that its attitude is that of the last sample,
//! and is then extrapolated by the recording's stated delay with the last rates. Every file has its
//! place in the output: a recording without truth is checked where it rests, and files that cannot
//! be used are named with the reason.

use std::error::Error;
use std::path::{Path, PathBuf};

use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb_recordings::output::OutputFile;
use aplomb_recordings::score::Score;
use aplomb_recordings::terminal::print_line;
use aplomb_recordings::units::knowledge;

use crate::filter::Choice;
use crate::folders::{Folders, Ranges};
use crate::recording::{Recording, Reference};
use crate::results::{Row, Set, summarise};
use crate::simulated::{self, EVALUATION_SEEDS};
use crate::{
    accuracy, clipping, gains, heading, heading_picture, heading_promise, leave_one_out, long,
    motion_starts, parallel, picture, report, throughput, vibration,
};

/// Compare the accuracy and the speed of filters on recordings
///
/// Every recording below DIR counts, plain or gzipped; its folder is its set. One with truth is
/// scored by it, one without is checked where it rests; one with a compass is scored by its
/// heading. What cannot be scored is named with the reason. If no DIR is named and there are no
/// recordings, simulated flights take their place.
#[derive(clap::Parser)]
#[command(version, name = "aplomb-bench")]
#[command(after_help = "Examples:
  aplomb-bench
  aplomb-bench recordings --counts raw=8,250 --output target/bench
  aplomb-bench recordings --json

JSON: scores, one for each recording and filter (set, recording, reference, sensor_delay_us, filter,
inclination_samples, inclination_rms_deg, inclination_p95_deg, inclination_max_deg,
within_3_sigma (a share), median_error_per_sigma); headings of recordings with a compass, if there
are any (set, recording, filter, heading_known, heading_rms_deg, heading_rms_without_offset_deg,
heading_offset_deg, heading_within_3_sigma, median_heading_error_per_sigma); not_scored
(file, line if one is to blame, reason), and warnings of clipping and vibration, if there are any.

Exit codes: 0 fine, 1 failed (the reason is on standard error), 2 wrong usage.")]
pub struct Options {
    /// Folders of recordings [default: ../shared/data, if it is there]
    #[arg(value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// Delay of the samples of a set, in microseconds [known: broad=4000,
    /// broad-mag=4000]
    #[arg(long = "sensor-delay-us", value_name = "SET=N", value_parser = parse_delay)]
    delays_us: Vec<(String, u32)>,
    /// Age of a set's compass readings against the samples of their rows, in microseconds
    /// [known: broad-mag=10000]
    #[arg(long = "compass-delay-us", value_name = "SET=N", value_parser = parse_delay)]
    compass_delays_us: Vec<(String, u32)>,
    /// A set holds register counts, at this range in g and this one in degrees per second [known:
    /// mpu6050-raw=8,250]
    #[arg(long = "counts", value_name = "SET=G,DPS", value_parser = parse_ranges)]
    ranges: Vec<(String, Ranges)>,
    /// Knowledge of the sensors: factory, six-poses, calibrated (the gyroscope too) [default:
    /// calibrated for SI units, factory for counts and simulated flights, whose sensors are then
    /// calibrated so]
    #[arg(long, value_name = "KNOWLEDGE", value_parser = knowledge)]
    accelerometer: Option<AccelerometerKnowledge>,
    /// Folder of accuracy.csv and accuracy.png
    #[arg(long, value_name = "DIR", default_value = "target/bench")]
    output: PathBuf,
    /// Print the scores as JSON; neither speed nor files
    #[arg(long, conflicts_with = "instead")]
    json: bool,
    /// Instead: tune the filter on all sets but one, and judge it on that one; for each set
    /// (minutes)
    #[arg(long, group = "instead")]
    leave_one_out: bool,
    /// Instead: the gains with which the filters of others do best on the recordings
    /// (minutes)
    #[arg(long, group = "instead")]
    scan_gains: bool,
    /// Instead: fly the firmware's pipeline through four simulated flights of this length, in
    /// seconds, and score each hour (an hour takes half a minute)
    #[arg(long, value_name = "SECONDS", group = "instead",
        value_parser = clap::value_parser!(u64).range(120..=1_000_000))]
    long: Option<u64>,
    /// Instead: the error of the default filter and VQF when the gyroscope of the recordings clips,
    /// with and without its detection
    #[arg(long, group = "instead")]
    clipping: bool,
    /// Instead: the error of the default filter, VQF and Madgwick's against vibration, in simulated
    /// flights and hovers (minutes)
    #[arg(long, group = "instead")]
    vibration: bool,
    /// Instead: fly this many starts beside a magnet, and as many with faulty readings of the
    /// compass, swings about one axis, such swings for five minutes, and flights with the hard
    /// iron of an earlier one; fail if a heading is HEADING_VALID and wrong (500: ten minutes of
    /// each core)
    #[arg(long, value_name = "FLIGHTS", group = "instead", num_args = 0..=1,
        default_missing_value = "500", value_parser = clap::value_parser!(u64).range(1..=100_000))]
    heading_promise: Option<u64>,
    /// Instead: the error of the default filter and of VQF after starts in the middle of the
    /// motion: of the tilt, and of the heading where there is a compass; and the heading with
    /// 200 µT of hard iron that nobody calibrated
    #[arg(long, group = "instead")]
    motion_starts: bool,
    /// Instead: draw the default filter, VQF and the classic one through a simulated flight, as a
    /// PNG file
    #[arg(long, value_name = "FILE", group = "instead")]
    picture: Option<PathBuf>,
    /// Instead: draw the heading of the library and of VQF 9D through a simulated flight in which a
    /// magnet passes, as a PNG file
    #[arg(long, value_name = "FILE", group = "instead")]
    heading_picture: Option<PathBuf>,
}

/// Number of long flights.
const LONG_FLIGHTS: usize = 4;

/// Runs the program.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    if let Some(path) = &options.picture {
        let drawn = picture::flight(&simulated::flight(picture::SEED)).png();
        return Ok(write(path, options, &drawn)?);
    }
    if let Some(path) = &options.heading_picture {
        let drawn = heading_picture::draw(&heading_picture::flight()).png();
        return Ok(write(path, options, &drawn)?);
    }
    if let Some(table) = of_simulations(options)? {
        print_line(table.trim_end());
        return Ok(());
    }
    let folders = Folders {
        paths: &options.folders,
        delays_us: &options.delays_us,
        compass_delays_us: &options.compass_delays_us,
        ranges: &options.ranges,
    };
    let (mut recordings, not_scored) = folders.read()?;
    if recordings.is_empty() && !options.folders.is_empty() {
        return Err(folders.nothing_to_score(&not_scored).into());
    }
    let warnings: Vec<String> = recordings.iter().flat_map(Recording::warnings).collect();
    if !options.json {
        for not_scored in &not_scored {
            print_line(&format!("not scored: {not_scored}"));
        }
        for warning in &warnings {
            print_line(warning);
        }
    }
    if let Some(knowledge) = options.accelerometer {
        for recording in &mut recordings {
            recording.accelerometer = knowledge;
        }
    }
    if options.motion_starts {
        print_line(motion_starts::tables(&recordings)?.trim());
        return Ok(());
    }
    let (with_compass, mut recordings): (Vec<Recording>, Vec<Recording>) = recordings
        .into_iter()
        .partition(|recording| recording.compass.is_some());
    if options.clipping {
        print_line(clipping::table(&recordings)?.trim_end());
        return Ok(());
    }
    if options.leave_one_out || options.scan_gains {
        return search(options, recordings);
    }
    let headings = heading::score(&with_compass);
    if recordings.is_empty() && headings.is_empty() {
        if !options.json {
            print_line(&format!(
                "There are no recordings to score here, so these are {} simulated flights of one \
                 minute: seeds {} and up, beyond those of the tuning; gyroscope offset 4 °/s, not \
                 calibrated; the rest of the sensor as --accelerometer states.",
                EVALUATION_SEEDS.count(),
                EVALUATION_SEEDS.start
            ));
        }
        let knowledge = options
            .accelerometer
            .unwrap_or(AccelerometerKnowledge::Factory);
        recordings = simulated::flights(EVALUATION_SEEDS, knowledge);
    }
    let rows = score(&recordings);
    let names = Choice::ALL.map(Choice::name);
    if options.json {
        let all = report::json(&names, &rows, &headings, warnings, &not_scored)?;
        print_line(&all);
        return Ok(());
    }
    print_line(&heading::table(&headings));
    print_and_draw(options, &names, &rows)
}

/// Returns the table of the simulations that an option asks for.
fn of_simulations(options: &Options) -> Result<Option<String>, Box<dyn Error>> {
    Ok(if let Some(seconds) = options.long {
        let seeds: Vec<u64> = EVALUATION_SEEDS.take(LONG_FLIGHTS).collect();
        Some(long::table(&seeds, seconds, print_line))
    } else if let Some(runs) = options.heading_promise {
        Some(heading_promise::run(runs)?)
    } else {
        options.vibration.then(vibration::tables)
    })
}

/// Searches a tuning or gains on the recordings with truth.
fn search(options: &Options, mut recordings: Vec<Recording>) -> Result<(), Box<dyn Error>> {
    recordings.retain(|recording| recording.reference == Reference::Truth);
    if recordings.is_empty() {
        return Err("there are no recordings with truth: name their folder".into());
    }
    print_line(&if options.leave_one_out {
        leave_one_out::run(recordings)
    } else {
        gains::scan(&recordings)
    });
    Ok(())
}

/// Scores every filter on every recording.
fn score(recordings: &[Recording]) -> Vec<Row<'_>> {
    let scores = parallel::map_with_bar("filtering", recordings, |recording| {
        let scores = Choice::ALL.iter().map(|filter| recording.score(*filter));
        scores.collect::<Option<Vec<Score>>>()
    });
    let rows = recordings.iter().zip(scores);
    rows.filter_map(|(recording, scores)| {
        Some(Row {
            recording,
            scores: scores?,
        })
    })
    .collect()
}

/// Prints the tables, and writes accuracy.csv and accuracy.png.
fn print_and_draw(
    options: &Options,
    names: &[&str],
    rows: &[Row<'_>],
) -> Result<(), Box<dyn Error>> {
    if rows.is_empty() {
        return Ok(());
    }
    let sets = summarise(rows, names.len());
    for reference in [Reference::Truth, Reference::Rest] {
        let sets: Vec<&Set> = sets
            .iter()
            .filter(|set| set.reference == reference)
            .collect();
        if !sets.is_empty() {
            print_line(&report::table(names, reference, &sets));
        }
    }
    print_line(&report::one_by_one(names, rows));
    // Recordings with truth are sampled regularly, unlike some others.
    let longest = rows.iter().max_by_key(|row| {
        let has_truth = row.recording.reference == Reference::Truth;
        (has_truth, row.recording.samples.len())
    });
    if let Some(row) = longest {
        print_line(&throughput::measure(row.recording));
    }
    let in_folder = |name| options.output.join(name);
    let table = report::csv(names, rows);
    write(&in_folder("accuracy.csv"), options, table.as_bytes())?;
    let picture = accuracy::picture(names, &sets);
    write(&in_folder("accuracy.png"), options, &picture.png())?;
    print_line(&format!(
        "\nwritten: accuracy.csv and accuracy.png in {}",
        options.output.display()
    ));
    Ok(())
}

fn parse_delay(text: &str) -> Result<(String, u32), String> {
    text.split_once('=')
        .and_then(|(set, delay)| Some((set.to_owned(), delay.parse().ok()?)))
        .ok_or_else(|| "say for instance broad=4000".into())
}

fn parse_ranges(text: &str) -> Result<(String, Ranges), String> {
    let parse = || {
        let (set, ranges) = text.split_once('=')?;
        let (force, rate) = ranges.split_once(',')?;
        Some((set.to_owned(), (force.parse().ok()?, rate.parse().ok()?)))
    };
    parse().ok_or_else(|| "say for instance mpu6050-raw=8,250".into())
}

/// Writes a file, and its folder if need be.
fn write(path: &Path, options: &Options, contents: &[u8]) -> Result<(), String> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder)
            .map_err(|error| format!("{}: cannot be made: {error}", folder.display()))?;
    }
    let inputs: Vec<&Path> = options.folders.iter().map(PathBuf::as_path).collect();
    OutputFile::write(path, &inputs, contents)
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb::mpu6050::{AccelerometerRange, GyroscopeRange};

    #[test]
    fn sets_are_stated_with_their_delays_and_ranges() {
        assert_eq!(parse_delay("broad=1000"), Ok(("broad".to_owned(), 1_000)));
        let ranges = (AccelerometerRange::G2, GyroscopeRange::Degrees500);
        assert_eq!(parse_ranges("raw=2,500"), Ok(("raw".to_owned(), ranges)));
        assert!(parse_delay("broad").is_err() && parse_delay("x=y").is_err());
        assert!(parse_ranges("x=8").is_err() && parse_ranges("x=9,250").is_err());
    }
}
