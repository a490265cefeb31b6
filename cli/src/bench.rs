//! `aplomb bench`: the library's filters beside those of other crates, on the same recordings, in one run.
//!
//! Accuracy is the root mean square of the inclination error over the rows that count after 5 s. Timing is treated
//! alike: every filter is fed so that its attitude is that of the last sample, and is then extrapolated by the
//! recording's stated delay with the last rates. Nothing that is found goes without a word: a recording without truth is
//! checked where it rests, and what cannot be used is named with the reason.

use std::error::Error;
use std::fmt::{self, Write as _};
use std::path::{Path, PathBuf};

use aplomb::mpu6050::{AccelerometerRange, GyroscopeRange};

use crate::filter::Choice;
use crate::input::{parse_accelerometer_range, parse_gyroscope_range};
use crate::output::OutputFile;
use crate::recording::{Found, Handling, Recording, Reference, files, is_table};
use crate::score::{Honesty, Score, mean, median};
use crate::simulated::{self, EVALUATION_SEEDS};
use crate::{accuracy, gains, leave_one_out, parallel, picture, throughput};

/// Where recordings lie if nothing else is said.
const DEFAULT_FOLDER: &str = "../shared/data";
/// Sets whose samples are known to be late: BROAD's inertial data lag its optical truth, by their correlation.
const KNOWN_DELAYS_US: [(&str, u32); 1] = [("broad", 4_000)];
/// Sets that are known to hold register counts, and at which ranges: by their publisher.
const KNOWN_RANGES: [(&str, AccelerometerRange, GyroscopeRange); 1] = [(
    "mpu6050-raw",
    AccelerometerRange::G8,
    GyroscopeRange::Degrees250,
)];

/// Compare the accuracy and the speed of filters on recordings
///
/// Every log below DIR counts, plain or gzipped; its folder is its set. One with truth is scored by it, one without is
/// checked where it rests. What cannot be scored is named with
/// the reason. If no DIR is named and there are no recordings, simulated flights take their place.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb bench
  aplomb bench recordings --counts raw=8,250 --output target/bench
  aplomb bench recordings --json

JSON: scores, one for each recording and filter (set, recording, reference, sensor_delay_us, filter, inclination_samples,
inclination_rms_deg, inclination_p95_deg, inclination_max_deg, within_3_sigma (a share), median_error_per_sigma), and not_scored (file, line if one is to blame, reason).")]
pub struct Options {
    /// Folders of recordings [default: ../shared/data, if it is there]
    #[arg(value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// By how much the samples of a set are late, in microseconds [known: broad=4000]
    #[arg(long = "sensor-delay-us", value_name = "SET=N", value_parser = parse_delay)]
    delays_us: Vec<(String, u32)>,
    /// A set holds register counts, at this range in g and this one in degrees per second [known: mpu6050-raw=8,250]
    #[arg(long = "counts", value_name = "SET=G,DPS", value_parser = parse_ranges)]
    ranges: Vec<(String, (AccelerometerRange, GyroscopeRange))>,
    /// Where accuracy.csv and accuracy.png go
    #[arg(long, value_name = "DIR", default_value = "target/bench")]
    output: PathBuf,
    /// Print the scores as JSON; neither speed nor files
    #[arg(long, conflicts_with = "instead")]
    json: bool,
    /// Instead: tune the filter on all sets but one, and judge it on that one; for each set (minutes)
    #[arg(long, group = "instead")]
    leave_one_out: bool,
    /// Instead: the gains with which the filters of other crates do best on the recordings (minutes)
    #[arg(long, group = "instead")]
    scan_gains: bool,
    /// Instead: draw the default filter, VQF and the classic one through a simulated flight, as a PNG file
    #[arg(long, value_name = "FILE", group = "instead")]
    picture: Option<PathBuf>,
}

/// Does it.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    if let Some(path) = &options.picture {
        let drawn = picture::flight(&simulated::flight(picture::SEED)).png();
        return Ok(write(path, options, &drawn)?);
    }
    let (mut recordings, not_scored) = read(options)?;
    if recordings.is_empty() && !options.folders.is_empty() {
        return Err(nothing_to_score(options, &not_scored).into());
    }
    if !options.json {
        for not_scored in &not_scored {
            crate::say(&format!("not scored: {not_scored}"));
        }
    }
    if options.leave_one_out || options.scan_gains {
        recordings.retain(|recording| recording.reference == Reference::Truth);
        if recordings.is_empty() {
            return Err("there are no recordings with truth: name their folder".into());
        }
        if options.leave_one_out {
            crate::say(&leave_one_out::run(recordings));
        } else {
            crate::say(&gains::scan(&recordings));
        }
        return Ok(());
    }
    if recordings.is_empty() && options.json {
        recordings = simulated::flights(EVALUATION_SEEDS);
    }
    if recordings.is_empty() {
        crate::say(&format!(
            "There are no recordings to score here, so these are {} simulated flights of one minute: seeds {} and up, \
             which nothing was tuned on; gyroscope offset 4 °/s, not calibrated.",
            EVALUATION_SEEDS.count(),
            EVALUATION_SEEDS.start
        ));
        recordings = simulated::flights(EVALUATION_SEEDS);
    }
    let filters = Choice::ALL;
    let scores = parallel::map_with_bar("filtering", &recordings, |recording| {
        let scores = filters.iter().map(|filter| recording.score(*filter));
        scores.collect::<Option<Vec<Score>>>()
    });
    let rows: Vec<Row<'_>> = recordings
        .iter()
        .zip(scores)
        .filter_map(|(recording, scores)| {
            Some(Row {
                recording,
                scores: scores?,
            })
        })
        .collect();
    let names: Vec<&str> = filters.iter().map(|filter| filter.name()).collect();
    if options.json {
        crate::say(&json(&names, &rows, &not_scored)?);
        return Ok(());
    }
    let sets = summarise(&rows, filters.len());
    for reference in [Reference::Truth, Reference::Rest] {
        let sets: Vec<&Set> = sets
            .iter()
            .filter(|set| set.reference == reference)
            .collect();
        if !sets.is_empty() {
            crate::say(&table(&names, reference, &sets));
        }
    }
    crate::say(&one_by_one(&names, &rows));
    // Those with truth are sampled regularly, unlike some others.
    let longest = rows.iter().max_by_key(|row| {
        let has_truth = row.recording.reference == Reference::Truth;
        (has_truth, row.recording.samples.len())
    });
    if let Some(row) = longest {
        crate::say(&throughput::measure(row.recording));
    }
    let in_folder = |name| options.output.join(name);
    let table = csv(&names, &rows);
    write(&in_folder("accuracy.csv"), options, table.as_bytes())?;
    let picture = accuracy::picture(&names, &sets);
    write(&in_folder("accuracy.png"), options, &picture.png())?;
    crate::say(&format!(
        "\nwritten: accuracy.csv and accuracy.png in {}",
        options.output.display()
    ));
    Ok(())
}

/// One recording's scores, in the order of the filters.
struct Row<'a> {
    recording: &'a Recording,
    scores: Vec<Score>,
}

/// The scores of one set.
pub struct Set {
    /// Its name.
    pub name: String,
    /// What its recordings are judged by.
    pub reference: Reference,
    /// The delay of its recordings.
    delay_us: u32,
    /// For each filter the root mean squares of all recordings, in degrees, in ascending order.
    pub rms: Vec<Vec<f64>>,
}

/// A file that cannot be scored.
#[derive(serde::Serialize)]
struct NotScored {
    file: String,
    /// The line that is to blame, if one is.
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<u64>,
    reason: String,
}

impl fmt::Display for NotScored {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(formatter, "{}:{line}: {}", self.file, self.reason),
            None => write!(formatter, "{}: {}", self.file, self.reason),
        }
    }
}

fn read(options: &Options) -> Result<(Vec<Recording>, Vec<NotScored>), Box<dyn Error>> {
    let default = Path::new(DEFAULT_FOLDER);
    let folders = if options.folders.is_empty() && default.is_dir() {
        vec![default.to_owned()]
    } else {
        options.folders.clone()
    };
    let mut paths = Vec::new();
    for folder in &folders {
        let found = files(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        paths.extend(found);
    }
    let results = parallel::map_with_bar("reading", &paths, |path| {
        // What somebody names is read whatever it is called.
        if !is_table(path) && !folders.contains(path) {
            return Ok(Found::Unusable("it is no .csv or .csv.gz".to_owned()));
        }
        let set = path.parent().and_then(Path::file_name).unwrap_or_default();
        Recording::read(path, options.handling(&set.to_string_lossy()))
    });
    let (mut recordings, mut not_scored) = (Vec::new(), Vec::new());
    for (path, result) in paths.iter().zip(results) {
        let (line, reason) = match result {
            Ok(Found::Recording(recording)) => {
                recordings.push(recording);
                continue;
            }
            Ok(Found::Unusable(reason)) => (None, reason),
            Err(error) => (error.line, error.reason.to_string()),
        };
        not_scored.push(NotScored {
            file: path.display().to_string(),
            line,
            reason,
        });
    }
    Ok((recordings, not_scored))
}

/// Why nothing of what was named can be scored.
fn nothing_to_score(options: &Options, not_scored: &[NotScored]) -> String {
    let named = options
        .folders
        .iter()
        .map(|path| path.display().to_string());
    let named = named.collect::<Vec<_>>().join(" ");
    if not_scored.is_empty() {
        return format!("{named}: there is no recording in it");
    }
    let mut text = format!("{named}: nothing of it can be scored");
    for not_scored in not_scored {
        let _ = write!(text, "\n  {not_scored}");
    }
    text
}

impl Options {
    /// What is stated of a set, or else known.
    fn handling(&self, set: &str) -> Handling {
        let stated = self.delays_us.iter().find(|(name, _)| name == set);
        let known = KNOWN_DELAYS_US.iter().find(|(name, _)| *name == set);
        let delay_us = stated.map(|(_, delay)| *delay);
        let ranges = self.ranges.iter().find(|(name, _)| name == set);
        let known_ranges = KNOWN_RANGES.iter().find(|(name, ..)| *name == set);
        Handling {
            delay_us: delay_us.or(known.map(|(_, delay)| *delay)).unwrap_or(0),
            ranges: ranges
                .map(|(_, ranges)| *ranges)
                .or(known_ranges.map(|&(_, force, rate)| (force, rate))),
        }
    }
}

fn parse_delay(text: &str) -> Result<(String, u32), String> {
    text.split_once('=')
        .and_then(|(set, delay)| Some((set.to_owned(), delay.parse().ok()?)))
        .ok_or_else(|| "say for instance broad=4000".into())
}

fn parse_ranges(text: &str) -> Result<(String, (AccelerometerRange, GyroscopeRange)), String> {
    let parse = || {
        let (set, ranges) = text.split_once('=')?;
        let (force, rate) = ranges.split_once(',')?;
        let force = parse_accelerometer_range(force).ok()?;
        Some((set.to_owned(), (force, parse_gyroscope_range(rate).ok()?)))
    };
    parse().ok_or_else(|| "say for instance mpu6050-raw=8,250".into())
}

fn summarise(rows: &[Row<'_>], filters: usize) -> Vec<Set> {
    let mut sets: Vec<Set> = Vec::new();
    for row in rows {
        let recording = row.recording;
        let is_its = |set: &Set| set.name == recording.set && set.reference == recording.reference;
        let place = sets.iter().position(is_its);
        let place = place.unwrap_or_else(|| {
            sets.push(Set {
                name: recording.set.clone(),
                reference: recording.reference,
                delay_us: recording.delay_us,
                rms: vec![Vec::new(); filters],
            });
            sets.len() - 1
        });
        for (all, score) in sets[place].rms.iter_mut().zip(&row.scores) {
            all.push(score.rms);
        }
    }
    for all in sets.iter_mut().flat_map(|set| &mut set.rms) {
        all.sort_by(f64::total_cmp);
    }
    sets
}

fn table(names: &[&str], reference: Reference, sets: &[&Set]) -> String {
    let mut text = String::from(match reference {
        Reference::Truth => {
            "\nInclination error, root mean square in degrees: median/mean over recordings\n\n"
        }
        Reference::Rest => {
            "\nWithout truth, so a check and no measure: the same against the mean specific force, where the recording rests\n\n"
        }
    });
    let _ = write!(text, "{:<12}", "");
    for set in sets {
        let title = format!("{} ({})", set.name, set.rms[0].len());
        let _ = write!(text, "{title:>17}");
    }
    for (index, name) in names.iter().enumerate() {
        let _ = write!(text, "\n{name:<12}");
        for set in sets {
            let rms = &set.rms[index];
            let _ = write!(
                text,
                "{:>17}",
                format!("{:.2}/{:.2}", median(rms), mean(rms))
            );
        }
    }
    for set in sets.iter().filter(|set| set.delay_us > 0) {
        let _ = write!(
            text,
            "\n{}: samples are {} µs late, which every filter makes up for",
            set.name, set.delay_us
        );
    }
    text.push('\n');
    text
}

/// The first filter's scores, one line a recording, and how honest its σ is.
fn one_by_one(names: &[&str], rows: &[Row<'_>]) -> String {
    let titles: Vec<String> = rows
        .iter()
        .map(|row| format!("{}/{}", row.recording.set, row.recording.name))
        .collect();
    let width = titles.iter().map(String::len).max().unwrap_or(0);
    let mut text = format!(
        "\n{}, recording by recording, in degrees; how much of the time the error is within 3 sigma; median of error/sigma (ideal: 0.83)\n\n\
         {:<width$}{:>8}{:>8}{:>9}{:>10}{:>8}\n",
        names[0], "", "rms", "95 %", "maximum", "<= 3 s", "median"
    );
    for (row, title) in rows.iter().zip(titles) {
        let Some(score) = row.scores.first() else {
            continue;
        };
        let _ = write!(
            text,
            "{title:<width$}{:>8.2}{:>8.2}{:>9.2}",
            score.rms, score.p95, score.maximum
        );
        if let Some(honesty) = score.honesty {
            let percent = 100.0 * honesty.within_3_sigma;
            let _ = write!(text, "{percent:>8.2} %{:>8.2}", honesty.median);
        } else {
            text.push_str("    at rest");
        }
        text.push('\n');
    }
    text
}

fn csv(names: &[&str], rows: &[Row<'_>]) -> String {
    let mut text = String::from(
        "set,recording,reference,sensor_delay_us,filter,rows,rms_deg,p95_deg,maximum_deg,within_3_sigma,median_error_per_sigma\n",
    );
    for row in rows {
        let Recording {
            set,
            name: recording,
            reference,
            delay_us,
            ..
        } = row.recording;
        let reference = reference.name();
        for (name, score) in names.iter().zip(&row.scores) {
            let Score {
                rows,
                rms,
                p95,
                maximum,
                honesty,
            } = score;
            let _ = write!(
                text,
                "{set},{recording},{reference},{delay_us},{name},{rows},{rms},{p95},{maximum}"
            );
            let _ = match honesty {
                Some(Honesty {
                    within_3_sigma,
                    median,
                }) => writeln!(text, ",{within_3_sigma},{median}"),
                None => writeln!(text, ",,"),
            };
        }
    }
    text
}

fn json(names: &[&str], rows: &[Row<'_>], not_scored: &[NotScored]) -> serde_json::Result<String> {
    #[derive(serde::Serialize)]
    struct Scores<'a> {
        scores: Vec<Scored<'a>>,
        not_scored: &'a [NotScored],
    }
    #[derive(serde::Serialize)]
    struct Scored<'a> {
        set: &'a str,
        recording: &'a str,
        reference: &'static str,
        sensor_delay_us: u32,
        filter: &'a str,
        #[serde(flatten)]
        score: Score,
    }
    let scores = rows.iter().flat_map(|row| {
        let recording = row.recording;
        names.iter().zip(&row.scores).map(|(filter, score)| Scored {
            set: &recording.set,
            recording: &recording.name,
            reference: recording.reference.name(),
            sensor_delay_us: recording.delay_us,
            filter,
            score: *score,
        })
    });
    serde_json::to_string(&Scores {
        scores: scores.collect(),
        not_scored,
    })
}

/// Writes a file into a folder, which is made if need be.
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

    #[test]
    fn what_is_stated_of_a_set_comes_before_what_is_known() {
        let options = |delays_us: &[&str], ranges: &[&str]| Options {
            folders: Vec::new(),
            delays_us: delays_us
                .iter()
                .map(|text| parse_delay(text).unwrap())
                .collect(),
            ranges: ranges
                .iter()
                .map(|text| parse_ranges(text).unwrap())
                .collect(),
            output: PathBuf::new(),
            leave_one_out: false,
            scan_gains: false,
            picture: None,
            json: false,
        };
        let none = options(&[], &[]);
        assert_eq!(none.handling("broad").delay_us, 4_000);
        assert_eq!(none.handling("other"), Handling::default());
        let eight = (AccelerometerRange::G8, GyroscopeRange::Degrees250);
        assert_eq!(none.handling("mpu6050-raw").ranges, Some(eight));
        let some = options(&["broad=1000", "x=7"], &["mpu6050-raw=2,500"]);
        assert_eq!(some.handling("broad").delay_us, 1_000);
        assert_eq!(some.handling("x").delay_us, 7);
        let two = (AccelerometerRange::G2, GyroscopeRange::Degrees500);
        assert_eq!(some.handling("mpu6050-raw").ranges, Some(two));
        assert!(parse_delay("broad").is_err() && parse_delay("x=y").is_err());
        assert!(parse_ranges("x=8").is_err() && parse_ranges("x=9,250").is_err());
    }
}
