//! `cargo xtask results`: measures once, and writes the figures of README.md, `docs/results.md` and
//! `cli/src/virtual_board.toml`.
//!
//! All figures are in one file, `docs/results.toml`. Measuring takes minutes to an hour and writes
//! that file. Rendering writes the other three from it. The check takes no time, and fails if one
//! disagrees with the file. [`hold`] compares the file with the images and the flight of
//! `cargo xtask test`.

mod data;
mod measure;
mod pages;

use std::path::Path;

use data::{Data, Section};

use crate::build::Board;
use crate::{cost, size};

const DATA: &str = "docs/results.toml";
const RESULTS: &str = "docs/results.md";
const README: &str = "README.md";
/// The boards' figures, for `aplomb measure`: a package holds no file from outside its folder.
const BOARDS_OF_CLI: &str = "cli/src/virtual_board.toml";

/// Largest relative change of a figure that [`hold`] accepts. One compiler repeats each figure
/// exactly. The sizes and counts of another differ a little.
const TOLERANCE: f64 = 0.02;
/// Tolerance of figures that a few samples decide, such as the worst sample.
const TOLERANCE_OF_EXTREMES: f64 = 0.1;

/// Figures of a flight that [`hold`] compares, with their tolerances.
const HELD: [(&str, f64); 9] = [
    ("missed", 0.0),
    ("samples", 0.001),
    ("instructions_per_sample_mean", TOLERANCE),
    ("io_instructions_per_sample_mean", TOLERANCE),
    ("instructions_per_sample_max", TOLERANCE_OF_EXTREMES),
    ("cpu_load_percent", TOLERANCE),
    ("edge_to_attitude_us_mean", TOLERANCE),
    ("edge_to_attitude_us_max", TOLERANCE),
    ("inclination_rms_deg", TOLERANCE_OF_EXTREMES),
];

/// Work that is asked for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Mode {
    /// Measures, but keeps the flights of an hour and of a day, and the campaign with faults.
    Measure,
    /// Measures everything: more than an hour.
    MeasureLong,
    /// Writes the pages from the data file.
    Render,
    /// Fails if a page disagrees with the data file.
    Check,
}

impl Mode {
    /// The mode for the arguments after `results`; `None` if they are wrong.
    pub fn parse(arguments: &[String]) -> Option<Self> {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        match arguments[..] {
            [] => Some(Self::Measure),
            ["--long"] => Some(Self::MeasureLong),
            ["--render"] => Some(Self::Render),
            ["--check"] => Some(Self::Check),
            _ => None,
        }
    }
}

/// Does it.
pub fn run(mode: Mode) -> Result<(), String> {
    match mode {
        Mode::Measure | Mode::MeasureLong => {
            let mut data = load()?;
            measure::all(&mut data, mode == Mode::MeasureLong, |data| {
                write(DATA, &data.to_text())
            })?;
            render(&data)
        }
        Mode::Render => render(&load()?),
        Mode::Check => check(),
    }
}

/// Copies the committed table of costs into the data file, and writes the pages.
pub fn take_costs() -> Result<(), String> {
    let mut data = load()?;
    measure::take_costs(&mut data)?;
    write(DATA, &data.to_text())?;
    render(&data)
}

/// Fails if a page, or the committed table of costs, disagrees with the data file.
pub fn check() -> Result<(), String> {
    let data = load()?;
    check_cost(&data, &cost::committed()?)?;
    for (file, expected) in rendered(&data)? {
        compare(file, &read(file)?, &expected)?;
    }
    Ok(())
}

/// Holds what was built and flown to the data file.
///
/// `images` are the boards' ELF files, the default board's first. `flash_bytes` are the figures of
/// the section `size`, each with its key.
pub fn hold(
    virtual_board: &Path,
    images: &[(Board, std::path::PathBuf)],
    flash_bytes: &[(&str, u64)],
) -> Result<(), String> {
    let data = load()?;
    let mut changes = Vec::new();
    for (board, elf) in images {
        let section = data.section(&format!("board.{}", board.name))?;
        let sizes = size::measure(elf)?;
        for (key, bytes) in [("flash_bytes", sizes.flash), ("ram_bytes", sizes.ram)] {
            changes.extend(change(section, key, bytes as f64, TOLERANCE)?);
        }
    }
    changes.extend(size_changes(data.section("size")?, flash_bytes)?);
    let Some((board, elf)) = images.first() else {
        return Err("there is no image".into());
    };
    let flown = measure::fly(virtual_board, elf, *board, &["--seconds", "60"], "fly")?;
    for (key, tolerance) in HELD {
        changes.extend(change(
            data.section("fly")?,
            key,
            flown.number(key)?,
            tolerance,
        )?);
    }
    if changes.is_empty() {
        return Ok(());
    }
    Err(format!(
        "{DATA} is out of date:\n  {}\n\
         if that is meant, run `cargo xtask results` and commit {DATA}, {RESULTS}, {README} and \
         {BOARDS_OF_CLI}",
        changes.join("\n  ")
    ))
}

/// Describes the changes of all figures of the section `size`. Fails if one is not measured.
fn size_changes(size: &Section, flash_bytes: &[(&str, u64)]) -> Result<Vec<String>, String> {
    let mut changes = Vec::new();
    for (key, _) in size.figures() {
        let measured = flash_bytes.iter().find(|(measured, _)| *measured == key);
        let (_, bytes) = measured.ok_or_else(|| format!("nothing holds {key} of {DATA}"))?;
        changes.extend(change(size, key, *bytes as f64, TOLERANCE)?);
    }
    Ok(changes)
}

/// Describes the change of a figure beyond its tolerance.
fn change(
    section: &Section,
    key: &str,
    now: f64,
    tolerance: f64,
) -> Result<Option<String>, String> {
    let before = section.number(key)?;
    let is_same = (now - before).abs() <= tolerance * before.abs();
    Ok((!is_same).then(|| format!("{key} is {now}, and the file has {before}")))
}

fn check_cost(data: &Data, rows: &[cost::Row]) -> Result<(), String> {
    let section = data.section("cost")?;
    let committed: Vec<(String, String)> = rows.iter().map(measure::cost_line).collect();
    let stored = section
        .figures()
        .map(|(key, cells)| (key.to_owned(), cells.to_owned()));
    if stored.eq(committed) {
        return Ok(());
    }
    Err(format!(
        "{DATA} and tests/golden/cost.txt disagree: run `cargo xtask cost --bless`, and commit both"
    ))
}

fn render(data: &Data) -> Result<(), String> {
    for (file, text) in rendered(data)? {
        write(file, &text)?;
    }
    Ok(())
}

/// The files with the text that belongs into them.
fn rendered(data: &Data) -> Result<[(&'static str, String); 3], String> {
    let name = |error| format!("{DATA}: {error}");
    Ok([
        (RESULTS, pages::results(data).map_err(name)?),
        (README, pages::readme(&read(README)?, data).map_err(name)?),
        (BOARDS_OF_CLI, data.part("board.").to_text()),
    ])
}

fn compare(file: &str, text: &str, expected: &str) -> Result<(), String> {
    if text == expected {
        return Ok(());
    }
    let mut lines = text.lines().zip(expected.lines()).enumerate();
    let place = match lines.find(|(_, (line, expected))| line != expected) {
        Some((index, (line, expected))) => {
            format!("line {} is\n  {line}\nand not\n  {expected}", index + 1)
        }
        None => "its length differs".to_owned(),
    };
    Err(format!(
        "{file} disagrees with {DATA}: {place}\nrun `cargo xtask results --render`"
    ))
}

fn load() -> Result<Data, String> {
    Data::parse(&read(DATA)?).map_err(|error| format!("{DATA}, {error}"))
}

fn read(file: &str) -> Result<String, String> {
    std::fs::read_to_string(crate::root().join(file))
        .map_err(|error| format!("cannot read {file}: {error}"))
}

fn write(file: &str, text: &str) -> Result<(), String> {
    std::fs::write(crate::root().join(file), text)
        .map_err(|error| format!("cannot write {file}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_choose_the_work() {
        let parse = |arguments: &[&str]| {
            let arguments: Vec<String> = arguments.iter().map(|text| (*text).to_owned()).collect();
            Mode::parse(&arguments)
        };
        assert_eq!(parse(&[]), Some(Mode::Measure));
        assert_eq!(parse(&["--long"]), Some(Mode::MeasureLong));
        assert_eq!(parse(&["--render"]), Some(Mode::Render));
        assert_eq!(parse(&["--check"]), Some(Mode::Check));
        assert_eq!(parse(&["--checks"]), None);
        assert_eq!(parse(&["--check", "--long"]), None);
    }

    #[test]
    fn the_committed_pages_agree_with_the_data() {
        assert_eq!(check(), Ok(()));
    }

    #[test]
    fn a_changed_page_fails() {
        let [(file, expected), ..] = rendered(&load().expect("data")).expect("pages");
        assert_eq!(compare(file, &expected, &expected), Ok(()));
        let changed = expected.replacen("missed", "lost", 1);
        let error = compare(file, &changed, &expected).expect_err("a word differs");
        assert!(error.contains(file) && error.contains("line "), "{error}");
        assert!(compare(file, "", &expected).is_err_and(|error| error.contains("length")));
    }

    #[test]
    fn a_changed_cost_fails() {
        let data = load().expect("data");
        let mut rows = cost::committed().expect("a table");
        assert_eq!(check_cost(&data, &rows), Ok(()));
        rows[0].maximum += 1;
        assert!(check_cost(&data, &rows).is_err_and(|error| error.contains("cost.txt")));
    }

    #[test]
    fn every_size_of_the_file_is_held() {
        let data = load().expect("data");
        let size = data.section("size").expect("a section");
        let measured = |key, bytes| {
            let figures = size.figures().map(|(other, stored)| {
                let stored = stored.parse().expect("a number");
                (other, if other == key { bytes } else { stored })
            });
            figures.collect::<Vec<(&str, u64)>>()
        };
        assert_eq!(size_changes(size, &measured("", 0)), Ok(vec![]));
        for key in ["without_compass_flash_bytes", "rtic_flash_bytes"] {
            let changes = size_changes(size, &measured(key, 1)).expect("all are measured");
            assert!(
                changes.len() == 1 && changes[0].contains(key),
                "{changes:?}"
            );
        }
        let error = size_changes(size, &measured("", 0)[1..]).expect_err("one is missing");
        assert!(error.contains("kalman_flash_bytes"), "{error}");
    }

    #[test]
    fn a_figure_may_change_within_its_tolerance_only() {
        let mut section = Section::new("fly", "2026-11-22");
        section.put("flash_bytes", 100_000);
        section.put("missed", 0);
        let change = |key, now, tolerance| change(&section, key, now, tolerance).expect("a number");
        assert_eq!(change("flash_bytes", 102_000.0, 0.02), None);
        assert!(change("flash_bytes", 102_001.0, 0.02).is_some_and(|text| text.contains("100000")));
        assert!(change("flash_bytes", 97_999.0, 0.02).is_some());
        assert_eq!(change("missed", 0.0, 0.0), None);
        assert!(change("missed", 1.0, 0.0).is_some());
        assert!(change("missed", f64::NAN, 0.0).is_some());
    }
}
