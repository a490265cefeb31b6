//! Measures the cost of the filters on the Cortex-M4F, and holds it to a table that is committed.
//!
//! `rigs/src/bin/cost.rs` counts instructions in QEMU. The code of a filter is the difference
//! between its image and one without a filter. QEMU has no cycle model: these figures are without
//! flash wait states and the core's pipeline.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::setup::{self, Toolchain};
use crate::{qemu, rigs, size, step};

/// Ours may change by this much before someone has to look.
const TOLERANCE: f64 = 0.02;
/// The library's default filter and its lines; the others are there to compare.
const OURS: &str = "kalman";

/// The names that the application knows.
const FILTERS: [&str; 9] = [
    OURS,
    "kalman + extrapolation",
    "kalman + sigma",
    "kalman + heading",
    "axis-kalman",
    "classic",
    "fusion",
    "madgwick",
    "mahony",
];
/// Name of an image without a filter.
const NONE: &str = "none";

const EXPLANATION: &str = "\
The cost of one update on the Cortex-M4F: sample in, quaternion and body rates out, one filter to an
image. Instructions are counted in QEMU (-icount shift=0) over a minute of rest, turns and
accelerations at 1 kHz, each run twice with the same result; the first sample, which starts the
filter, is not in the maximum. Flash is code and constants, RAM the state, both in bytes; the
library's state is as large as its largest filter's. VQF is not among them: the comparison has
it in f64, for a computer. Written by `cargo xtask cost --bless`.
";

/// One filter.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Name of the filter.
    pub name: String,
    /// Instructions per update, on average.
    pub mean: f64,
    /// Instructions of the worst update after the first.
    pub maximum: u64,
    /// Instructions of the first update.
    pub first: u64,
    /// Bytes of code and constants.
    pub flash: u64,
    /// Bytes of state.
    pub ram: u64,
}

/// Measures, prints, and compares with the committed table.
pub fn run() -> Result<(), String> {
    let rows = measure()?;
    println!("\n{}", table(&rows));
    compare(&rows, &committed()?)
}

/// Reads the committed table.
pub fn committed() -> Result<Vec<Row>, String> {
    let path = golden();
    let text = std::fs::read_to_string(&path)
        .map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    parse_table(&text).ok_or_else(|| format!("{}: not a table of costs", path.display()))
}

/// Measures and writes the table.
pub fn bless() -> Result<(), String> {
    let table = table(&measure()?);
    println!("\n{table}");
    let path = golden();
    std::fs::write(&path, table)
        .map_err(|error| format!("cannot write {}: {error}", path.display()))
}

fn golden() -> PathBuf {
    crate::root().join("tests/golden/cost.txt")
}

fn measure() -> Result<Vec<Row>, String> {
    setup::qemu()?;
    let toolchain = Toolchain::for_target()?;
    step::timed("measuring the filters in QEMU", || {
        let without = size::measure(&rigs::cost(&toolchain, NONE)?)?.flash;
        let mut rows = Vec::new();
        for name in FILTERS {
            let elf = rigs::cost(&toolchain, name)?;
            let mut row = parse_line(count(&elf)?.trim())?;
            row.flash = size::measure(&elf)?.flash.saturating_sub(without);
            rows.push(row);
        }
        Ok(rows)
    })
}

/// Runs the application and returns its output.
fn count(elf: &Path) -> Result<String, String> {
    let result = qemu::run_counting(elf)?;
    if result.status.success() {
        Ok(String::from_utf8_lossy(&result.stdout).into_owned())
    } else {
        Err(String::from_utf8_lossy(&result.stderr).into_owned())
    }
}

/// Reads the application's line: name, mean, maximum, first, bytes of state.
fn parse_line(line: &str) -> Result<Row, String> {
    let mut cells = line.split(',');
    let mut row = || {
        Some(Row {
            name: cells.next()?.to_owned(),
            mean: cells.next()?.parse().ok()?,
            maximum: cells.next()?.parse().ok()?,
            first: cells.next()?.parse().ok()?,
            ram: cells.next()?.parse().ok()?,
            flash: 0,
        })
    };
    row().ok_or_else(|| format!("the application printed no costs: {line}"))
}

fn table(rows: &[Row]) -> String {
    let mut text = format!("{EXPLANATION}\n");
    let title = ["filter", "mean", "maximum", "first", "flash", "RAM"];
    let [name, mean, maximum, first, flash, ram] = title;
    let _ = writeln!(
        text,
        "{name:<24}{mean:>10}{maximum:>10}{first:>10}{flash:>10}{ram:>10}"
    );
    for row in rows {
        let Row {
            name,
            mean,
            maximum,
            first,
            flash,
            ram,
        } = row;
        let _ = writeln!(
            text,
            "{name:<24}{mean:>10.1}{maximum:>10}{first:>10}{flash:>10}{ram:>10}"
        );
    }
    text
}

fn parse_table(text: &str) -> Option<Vec<Row>> {
    let (_, rows) = text.split_once("RAM\n")?;
    let rows = rows.lines().map(|line| {
        let mut words = line.split_whitespace().rev();
        let ram = words.next()?.parse().ok()?;
        let flash = words.next()?.parse().ok()?;
        let first = words.next()?.parse().ok()?;
        let maximum = words.next()?.parse().ok()?;
        let mean = words.next()?.parse().ok()?;
        let name: Vec<&str> = words.rev().collect();
        Some(Row {
            name: name.join(" "),
            mean,
            maximum,
            first,
            flash,
            ram,
        })
    });
    rows.collect()
}

/// An error if ours has changed by more than the tolerance, with the new figures.
fn compare(rows: &[Row], expected: &[Row]) -> Result<(), String> {
    let mut changes = String::new();
    for row in rows.iter().filter(|row| row.name.starts_with(OURS)) {
        let Some(before) = expected.iter().find(|before| before.name == row.name) else {
            let _ = writeln!(changes, "{} is new", row.name);
            continue;
        };
        for (figure, new, old) in [
            ("mean instructions", row.mean, before.mean),
            (
                "maximum instructions",
                row.maximum as f64,
                before.maximum as f64,
            ),
            (
                "instructions of the first sample",
                row.first as f64,
                before.first as f64,
            ),
            ("bytes of flash", row.flash as f64, before.flash as f64),
            ("bytes of RAM", row.ram as f64, before.ram as f64),
        ] {
            if (new - old).abs() > TOLERANCE * old {
                let _ = writeln!(changes, "{}: {new} {figure}, and it was {old}", row.name);
            }
        }
    }
    if changes.is_empty() {
        Ok(())
    } else {
        Err(format!(
            "the cost of the filter has changed:\n{changes}\
             if that is meant, run `cargo xtask cost --bless` and commit tests/golden/cost.txt"
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(name: &str, mean: f64, maximum: u64) -> Row {
        Row {
            name: name.to_owned(),
            mean,
            maximum,
            first: 1_400,
            flash: 5_000,
            ram: 1_000,
        }
    }

    #[test]
    fn the_table_reads_back() {
        let rows = [
            row("kalman", 300.5, 900),
            row("kalman + sigma", 400.0, 1_000),
        ];
        assert_eq!(parse_table(&table(&rows)), Some(rows.to_vec()));
        assert_eq!(parse_table("filter RAM\nkalman 1 2 3\n"), None);
        assert_eq!(parse_table(""), None);
    }

    #[test]
    fn the_committed_table_is_one_and_has_ours() {
        let text = std::fs::read_to_string(golden()).expect("the table is committed");
        let rows = parse_table(&text).expect("it is a table");
        assert_eq!(table(&rows), text);
        assert!(rows.iter().any(|row| row.name == OURS));
    }

    #[test]
    fn what_the_application_prints_is_read() {
        let row = parse_line("kalman + sigma,450.6,860,1460,1512").expect("a line");
        assert_eq!(row.name, "kalman + sigma");
        assert_eq!((row.mean, row.maximum), (450.6, 860));
        assert_eq!((row.first, row.ram), (1460, 1512));
        assert!(parse_line("").is_err());
        assert!(parse_line("panicked").is_err());
    }

    #[test]
    fn ours_may_change_a_little_and_others_as_they_like() {
        let before = [row("kalman", 300.0, 900), row("mahony", 200.0, 200)];
        let after = |mean, maximum| [row("kalman", mean, maximum), row("mahony", 300.0, 250)];
        assert_eq!(compare(&after(305.9, 918), &before), Ok(()));
        let slower = compare(&after(306.1, 900), &before).unwrap_err();
        assert!(
            slower.contains("kalman: 306.1 mean instructions, and it was 300"),
            "{slower}"
        );
        assert!(compare(&after(293.0, 900), &before).is_err());
        assert!(compare(&after(300.0, 919), &before).is_err_and(|e| e.contains("919 maximum")));
        assert!(compare(&[row("kalman + x", 1.0, 1)], &before).is_err_and(|e| e.contains("new")));
    }
}
