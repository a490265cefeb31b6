//! `aplomb bench`: the library's filters beside those of other crates, on the same recordings, in one run.
//!
//! Accuracy is the root mean square of the inclination error over the rows that count after 5 s. Timing is treated
//! alike: every filter is fed so that its attitude is that of the last sample, and is then extrapolated by the
//! recording's stated delay with the last rates. Throughput is that of the update alone, on samples in
//! memory, in each filter's own axes.

use std::error::Error;
use std::fmt::Write as _;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use aplomb::estimator::{Estimator, FilterKind, Sample};
use indicatif::{ProgressBar, ProgressStyle};

use crate::filter::Choice;
use crate::peers::{self, Fusion, Madgwick, Mahony, Step, Vqf, VqfAsIs, tilt};
use crate::plot;
use crate::recording::{Recording, files};
use crate::score::Score;
use crate::simulated::{self, FIRST_EVALUATION_SEED};

/// Where recordings lie if nothing else is said.
const DEFAULT_FOLDER: &str = "../shared/data";
/// How many flights are simulated if there are no recordings.
const FLIGHTS: u64 = 8;
/// Sets whose samples are known to be late: BROAD's inertial data lag its optical truth, by their correlation.
const KNOWN_DELAYS_US: [(&str, u32); 1] = [("broad", 4_000)];

/// Compare the accuracy and the speed of filters on recordings with truth
///
/// Every log with truth below DIR counts; its folder is its set. Without recordings, simulated flights take their place.
#[derive(clap::Args)]
pub struct Options {
    /// Folders of recordings [default: ../shared/data, if it is there]
    #[arg(value_name = "DIR")]
    folders: Vec<PathBuf>,
    /// By how much the samples of a set are late, in microseconds [known: broad=4000]
    #[arg(long = "sensor-delay-us", value_name = "SET=N", value_parser = parse_delay)]
    delays_us: Vec<(String, u32)>,
    /// Where accuracy.csv and accuracy.png go
    #[arg(long, value_name = "DIR", default_value = "target/bench")]
    output: PathBuf,
}

/// Does it.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let mut recordings = read(options)?;
    if recordings.is_empty() {
        crate::say(&format!(
            "There are no recordings with truth here, so these are {FLIGHTS} simulated flights of one minute: seeds \
             {FIRST_EVALUATION_SEED} and up, which nothing was tuned on; gyroscope offset 4 °/s, not calibrated."
        ));
        let seeds: Vec<u64> = (FIRST_EVALUATION_SEED..FIRST_EVALUATION_SEED + FLIGHTS).collect();
        recordings = in_parallel("simulating", &seeds, |seed| simulated::flight(*seed));
    }
    let filters = Choice::all();
    let scores = in_parallel("filtering", &recordings, |recording| {
        let scores = filters.iter().map(|filter| recording.score(*filter));
        scores.collect::<Option<Vec<Score>>>()
    });
    let rows: Vec<Row> = recordings
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
    let sets = summarise(&rows, filters.len());
    crate::say(&table(&names, &sets));
    let longest = rows.iter().max_by_key(|row| row.recording.samples.len());
    if let Some(row) = longest {
        crate::say(&throughput(row.recording));
    }
    write(
        &options.output,
        "accuracy.csv",
        csv(&names, &rows).as_bytes(),
    )?;
    write(
        &options.output,
        "accuracy.png",
        &plot::accuracy(&names, &sets)?,
    )?;
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
    /// The delay of its recordings.
    delay_us: u32,
    /// For each filter the root mean squares of all recordings, in degrees, in ascending order.
    pub rms: Vec<Vec<f64>>,
}

/// The middle one of ascending numbers, or the mean of the two in the middle.
pub fn median(ascending: &[f64]) -> f64 {
    let length = ascending.len();
    match (
        ascending.get(length.wrapping_sub(1) / 2),
        ascending.get(length / 2),
    ) {
        (Some(lower), Some(upper)) => 0.5 * (lower + upper),
        _ => f64::NAN,
    }
}

fn mean(numbers: &[f64]) -> f64 {
    numbers.iter().sum::<f64>() / numbers.len() as f64
}

fn read(options: &Options) -> Result<Vec<Recording>, Box<dyn Error>> {
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
    let results = in_parallel("reading", &paths, |path| {
        let set = path.parent().and_then(Path::file_name).unwrap_or_default();
        Recording::read(path, delay_us(&set.to_string_lossy(), &options.delays_us))
    });
    let count = results.len();
    let mut recordings = Vec::new();
    for result in results {
        recordings.extend(result?);
    }
    if count > recordings.len() {
        crate::say(&format!(
            "{} of {count} files have no truth and are left out",
            count - recordings.len()
        ));
    }
    Ok(recordings)
}

fn delay_us(set: &str, stated: &[(String, u32)]) -> u32 {
    let known = KNOWN_DELAYS_US.iter().map(|(name, delay)| (*name, *delay));
    let stated = stated.iter().map(|(name, delay)| (name.as_str(), *delay));
    stated
        .chain(known)
        .find(|(name, _)| *name == set)
        .map_or(0, |(_, delay)| delay)
}

fn parse_delay(text: &str) -> Result<(String, u32), String> {
    text.split_once('=')
        .and_then(|(set, delay)| Some((set.to_owned(), delay.parse().ok()?)))
        .ok_or_else(|| "say for instance broad=4000".into())
}

fn summarise(rows: &[Row], filters: usize) -> Vec<Set> {
    let mut sets: Vec<Set> = Vec::new();
    for row in rows {
        let recording = row.recording;
        let place = sets.iter().position(|set| set.name == recording.set);
        let place = place.unwrap_or_else(|| {
            sets.push(Set {
                name: recording.set.clone(),
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

fn table(names: &[&str], sets: &[Set]) -> String {
    let mut text = String::from(
        "\nInclination error, root mean square in degrees: median/mean over recordings\n\n",
    );
    let _ = write!(text, "{:<12}", "");
    for set in sets {
        let title = format!("{} ({})", set.name, set.rms[0].len());
        let _ = write!(text, "{title:>16}");
    }
    for (index, name) in names.iter().enumerate() {
        let _ = write!(text, "\n{name:<12}");
        for set in sets {
            let rms = &set.rms[index];
            let _ = write!(
                text,
                "{:>16}",
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

fn csv(names: &[&str], rows: &[Row]) -> String {
    let mut text =
        String::from("set,recording,sensor_delay_us,filter,rows,rms_deg,p95_deg,maximum_deg\n");
    for row in rows {
        let Recording {
            set,
            name: recording,
            delay_us,
            ..
        } = row.recording;
        for (name, score) in names.iter().zip(&row.scores) {
            let Score {
                rows,
                rms,
                p95,
                maximum,
            } = score;
            let _ = writeln!(
                text,
                "{set},{recording},{delay_us},{name},{rows},{rms},{p95},{maximum}"
            );
        }
    }
    text
}

fn write(folder: &Path, name: &str, contents: &[u8]) -> Result<(), String> {
    let path = folder.join(name);
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, contents))
        .map_err(|error| format!("{}: cannot be written: {error}", path.display()))
}

/// Does the same with every item, on every core, and shows how far it is.
fn in_parallel<T: Sync, R: Send>(
    what: &'static str,
    items: &[T],
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let style = ProgressStyle::with_template("{msg} {wide_bar} {pos}/{len}");
    let bar = ProgressBar::new(items.len() as u64)
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        .with_message(what);
    let next = AtomicUsize::new(0);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut results: Vec<(usize, R)> = std::thread::scope(|scope| {
        let worker = || {
            let mut done = Vec::new();
            loop {
                let index = next.fetch_add(1, Ordering::Relaxed);
                let Some(item) = items.get(index) else {
                    return done;
                };
                done.push((index, work(item)));
                bar.inc(1);
            }
        };
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(worker)).collect();
        let joined = workers.into_iter().flat_map(|worker| match worker.join() {
            Ok(done) => done,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        joined.collect()
    });
    bar.finish_and_clear();
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, result)| result).collect()
}

/// How often each filter runs through the recording; the fastest counts, as it was disturbed least.
const RUNS: usize = 25;

fn throughput(recording: &Recording) -> String {
    let step_s = recording.step_s();
    let samples = &recording.samples;
    let steps: Vec<Step> = samples
        .iter()
        .zip(samples.iter().skip(1))
        .map(|(before, after)| Step::new(before, after))
        .collect();
    type Run<'a> = Box<dyn Fn() + 'a>;
    let mut runs: Vec<(&str, Run)> = Vec::new();
    for choice in Choice::all() {
        let steps = &steps;
        let run: Run = match choice {
            Choice::Library(kind) => Box::new(move || run_library(kind, samples)),
            Choice::Vqf => Box::new(move || run_peer::<Vqf>(step_s, steps)),
            Choice::VqfAsIs => Box::new(move || run_peer::<VqfAsIs>(step_s, steps)),
            Choice::Fusion => Box::new(move || run_peer::<Fusion>(step_s, steps)),
            Choice::Madgwick => Box::new(move || run_peer::<Madgwick>(step_s, steps)),
            Choice::Mahony => Box::new(move || run_peer::<Mahony>(step_s, steps)),
        };
        runs.push((choice.name(), run));
    }
    let mut fastest_s = vec![f64::INFINITY; runs.len()];
    for _ in 0..RUNS {
        for (fastest, (_, run)) in fastest_s.iter_mut().zip(&runs) {
            let start = Instant::now();
            run();
            *fastest = fastest.min(start.elapsed().as_secs_f64());
        }
    }
    let mut text = format!(
        "\nThroughput of the update alone on this computer, one core, {} samples in memory, fastest of {RUNS} runs\n\n",
        samples.len()
    );
    for (seconds, (name, _)) in fastest_s.iter().zip(&runs) {
        let millions_per_s = samples.len() as f64 / seconds * 1e-6;
        let ratio = fastest_s[0] / seconds;
        let _ = writeln!(
            text,
            "{name:<12}{millions_per_s:>7.1} million/s, {ratio:.2} times {}",
            runs[0].0
        );
    }
    text
}

fn run_library(kind: FilterKind, samples: &[Sample]) {
    let mut estimator = Estimator::new(kind);
    for sample in samples {
        black_box(estimator.update(black_box(sample)));
    }
}

fn run_peer<F: peers::Filter>(step_s: f32, steps: &[Step]) {
    let start = steps.first().map_or([0.0, 0.0, 1.0], |step| step.force);
    let mut filter = F::new(tilt(start), step_s);
    for step in steps {
        filter.step(black_box(step));
        black_box(filter.attitude());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_are_of_the_middle() {
        assert_eq!(median(&[1.0, 2.0, 10.0]), 2.0);
        assert_eq!(median(&[1.0, 2.0, 4.0, 10.0]), 3.0);
        assert!(median(&[]).is_nan());
    }

    #[test]
    fn delays_are_those_stated_before_those_known() {
        assert_eq!(delay_us("broad", &[]), 4_000);
        assert_eq!(delay_us("other", &[]), 0);
        let stated = [
            parse_delay("broad=1000").unwrap(),
            parse_delay("x=7").unwrap(),
        ];
        assert_eq!(delay_us("broad", &stated), 1_000);
        assert_eq!(delay_us("x", &stated), 7);
        assert!(parse_delay("broad").is_err() && parse_delay("x=y").is_err());
    }

    #[test]
    fn work_in_parallel_keeps_its_order() {
        let items: Vec<u32> = (0..100).collect();
        assert_eq!(
            in_parallel("test", &items, |item| item * 2),
            items.iter().map(|item| item * 2).collect::<Vec<_>>()
        );
    }
}
