//! `virtual-board faults`: flies a campaign, or one flight of it.

use std::collections::BTreeSet;
use std::fs::{self, File, OpenOptions};
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use virtual_board::campaign::{self, Case, Coverage, Entry, Report, Table};
use virtual_board::flight::Outcome;
use virtual_board::outputs;
use virtual_board::plot::Labels;
use virtual_board::profile::ProcessorPool;
use virtual_board::schedule::DRAWN;

use super::subtitle;

/// Flights of a campaign that begin with each kind of fault that is drawn.
const RUNS_PER_KIND: u64 = 20;

/// Options of the command.
#[derive(Args)]
pub struct Faults {
    /// The firmware image; `cargo xtask faults` builds it and gives it.
    #[arg(long, value_name = "PATH")]
    elf: PathBuf,
    /// Number of flights. The default begins 20 with each kind of fault that is drawn.
    #[arg(long, value_name = "NUMBER", default_value_t = RUNS_PER_KIND * DRAWN as u64)]
    runs: u64,
    /// The seed of the first flight; the others count on from it.
    #[arg(long, value_name = "NUMBER", default_value_t = 1)]
    seed: u64,
    /// Number of flights at a time. Default: the number of cores.
    #[arg(long, value_name = "NUMBER")]
    jobs: Option<usize>,
    /// Go on with an interrupted campaign of the same firmware and first seed.
    #[arg(long)]
    resume: bool,
    /// Folder for the journal, and for the files of a failed flight, in a folder of its seed, or of
    /// a single one.
    #[arg(long, value_name = "FOLDER", default_value = "target/faults")]
    output: PathBuf,
}

/// Results of the flights so far.
struct Results {
    table: Table,
    coverage: Coverage,
    failed: u64,
    with_heading: u64,
    journal: File,
}

impl Results {
    /// Adds a flight.
    fn add(&mut self, case: &Case, entry: &Entry) {
        self.table.add(&entry.faults);
        self.coverage.add(case, &entry.steps);
        self.failed += u64::from(entry.has_failed);
        self.with_heading += u64::from(entry.has_heading);
    }
}

/// Flies a campaign, or one flight of it.
pub fn faults(options: &Faults) -> Result<(), String> {
    let started = Instant::now();
    if options.runs == 1 {
        return one_case(options);
    }
    let (results, flown) = open_journal(options)?;
    let jobs = options
        .jobs
        .or_else(|| std::thread::available_parallelism().ok().map(usize::from))
        .unwrap_or(1);
    let bar = ProgressBar::new(options.runs);
    if let Ok(style) =
        ProgressStyle::with_template("{bar:40} {pos}/{len} flights, {msg} left {eta}")
    {
        bar.set_style(style);
    }
    bar.set_position(flown.len() as u64);
    bar.reset_eta();
    let (next, pool) = (AtomicU64::new(0), Arc::default());
    let results = Mutex::new(results);
    std::thread::scope(|scope| {
        for _ in 0..jobs.max(1) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= options.runs {
                        return;
                    }
                    let seed = options.seed.wrapping_add(number);
                    if !flown.contains(&seed) {
                        fly(options, seed, &pool, &results, &bar);
                    }
                }
            });
        }
    });
    bar.finish_and_clear();
    let results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    println!("{}\n{}", results.table, results.coverage);
    println!("flights with a valid heading: {}", results.with_heading);
    println!(
        "{} flights from seed {} on in {:.0} s, {} failed",
        options.runs,
        options.seed,
        started.elapsed().as_secs_f64(),
        results.failed,
    );
    if results.failed == 0 {
        Ok(())
    } else {
        Err(format!(
            "{} of {} flights failed",
            results.failed, options.runs
        ))
    }
}

/// Flies a case of a campaign, and adds it to the results.
fn fly(
    options: &Faults,
    seed: u64,
    pool: &Arc<ProcessorPool>,
    results: &Mutex<Results>,
    bar: &ProgressBar,
) {
    let case = Case::by_seed(seed);
    let (report, outcome) = campaign::run(&case, pool, &options.elf);
    let record = outcome.as_ref().map(|outcome| &outcome.record);
    let entry = Entry::new(seed, &report, record);
    let mut results = results.lock().unwrap_or_else(PoisonError::into_inner);
    results.add(&case, &entry);
    if let Err(error) = writeln!(results.journal, "{entry}") {
        bar.suspend(|| eprintln!("warning: the journal: {error}"));
    }
    let failed = results.failed;
    if entry.has_failed {
        bar.set_message(format!("{failed} failed,"));
        let outcome = outcome.ok_or_else(|| "the flight did not come to its end".to_owned());
        let written = outcome.and_then(|outcome| write_case(options, &case, &outcome));
        bar.suspend(|| print_failure(&case, &report, &written));
    }
    bar.inc(1);
    let flown = bar.position();
    let shares = if options.runs < 5_000 { 10 } else { 100 };
    let share = |flown: u64| shares * flown / options.runs;
    // Nobody watches a bar in a log.
    if bar.is_hidden() && share(flown) > share(flown - 1) {
        eprintln!("{flown} of {} flights, {failed} failed", options.runs);
    }
}

/// Opens the journal. Returns the results that it has, and the seeds of those flights.
fn open_journal(options: &Faults) -> Result<(Results, BTreeSet<u64>), String> {
    let path = options.output.join(format!("journal-{}.txt", options.seed));
    let unusable = |error| format!("cannot use {}: {error}", path.display());
    let firmware = fs::read(&options.elf)
        .map_err(|error| format!("cannot read {}: {error}", options.elf.display()))?;
    let judge = std::env::current_exe().and_then(fs::read);
    let judge = judge.map_err(|error| format!("cannot read the program itself: {error}"))?;
    let head = format!(
        "firmware {:016x} judge {:016x}",
        fnv_1a(&firmware),
        fnv_1a(&judge)
    );
    fs::create_dir_all(&options.output).map_err(unusable)?;
    let text = if options.resume {
        fs::read_to_string(&path).map_err(unusable)?
    } else {
        String::new()
    };
    if options.resume && text.lines().next() != Some(&head) {
        return Err(unusable(std::io::Error::other(
            "it is of another firmware or of another build of this program: leave --resume out to \
             start again",
        )));
    }
    // The flight of a line that was cut is flown again.
    let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
    let entries = whole.lines().skip(1).filter_map(Entry::parse);
    let range = options.seed..options.seed.saturating_add(options.runs);
    let entries = entries.filter(|entry| range.contains(&entry.seed));
    let entries: Vec<Entry> = entries.collect();
    let kept = entries.iter().map(|entry| format!("{entry}\n"));
    let kept: String = std::iter::once(format!("{head}\n")).chain(kept).collect();
    fs::write(&path, kept).map_err(unusable)?;
    let journal = OpenOptions::new().append(true).open(&path);
    let mut results = Results {
        table: Table::default(),
        coverage: Coverage::default(),
        failed: 0,
        with_heading: 0,
        journal: journal.map_err(unusable)?,
    };
    let mut flown = BTreeSet::new();
    for entry in &entries {
        results.add(&Case::by_seed(entry.seed), entry);
        flown.insert(entry.seed);
        if entry.has_failed {
            println!("seed {} had failed", entry.seed);
        }
    }
    if options.resume {
        eprintln!("{} flights are in {}", flown.len(), path.display());
    }
    Ok((results, flown))
}

/// The 64-bit FNV-1a hash of a file's bytes.
fn fnv_1a(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, &byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// Prints the failures of a case, where its picture is, and the command that repeats it.
fn print_failure(case: &Case, report: &Report, written: &Result<PathBuf, String>) {
    println!("seed {}:", case.seed);
    for failure in &report.failures {
        println!("  {failure}");
    }
    match written {
        Ok(folder) => println!("  picture: {}", folder.join(outputs::PICTURE).display()),
        Err(error) => println!("  no picture: {error}"),
    }
    println!("  again: cargo xtask faults --runs 1 --seed {}", case.seed);
}

/// Writes the files of a case into the folder of its seed. Returns the folder.
fn write_case(options: &Faults, case: &Case, outcome: &Outcome) -> Result<PathBuf, String> {
    let labels = Labels {
        title: format!("flight of seed {} with faults", case.seed),
        subtitle: subtitle(outcome),
    };
    let folder = options.output.join(case.seed.to_string());
    outputs::write(&folder, outcome, &labels).map_err(|error| error.to_string())?;
    Ok(folder)
}

/// Flies one case, shows what happened, and writes its files.
fn one_case(options: &Faults) -> Result<(), String> {
    let case = Case::by_seed(options.seed);
    println!(
        "{:.3} s with these faults:\n{}{}",
        case.seconds, case.schedule, case.conditions
    );
    let outcome = case.fly(&options.elf)?;
    let report = campaign::report(&case, &outcome);
    for line in outcome
        .uart_lines
        .iter()
        .filter(|line| line.text.starts_with('#'))
    {
        println!("{:10.3} s  {}", line.at_ns as f64 * 1e-9, line.text);
    }
    let folder = write_case(options, &case, &outcome)?;
    println!("\nwritten to {}", folder.display());
    for fault in &report.faults {
        println!(
            "{}: {}, {}",
            fault.kind,
            if fault.is_detected {
                "detected"
            } else {
                "not detected"
            },
            fault
                .recovery_ns
                .map_or("not recovered in time".into(), |recovery_ns| format!(
                    "recovered in {:.1} ms",
                    recovery_ns as f64 * 1e-6
                ))
        );
    }
    if report.failures.is_empty() {
        Ok(())
    } else {
        Err(report.failures.join("\n       "))
    }
}
