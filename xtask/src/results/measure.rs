//! Measures the figures with the programs of the workspace.

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{SystemTime, UNIX_EPOCH};

use super::data::{Data, Section};
use crate::build::{self, BOARDS, Board, Firmware};
use crate::setup::Toolchain;
use crate::{cost, examples, recordings, size, step};

/// Filters whose accuracy is kept, by the names of `aplomb-bench`.
const FILTERS: [&str; 7] = [
    "kalman",
    "vqf",
    "fusion",
    "madgwick",
    "mahony",
    "axis-kalman",
    "classic",
];

/// Figures of a flight that are kept, by their names in `summary.json`.
const FLIGHT: [&str; 14] = [
    "samples",
    "missed",
    "timestamp_error_us_max",
    "instructions_per_sample_mean",
    "io_instructions_per_sample_mean",
    "instructions_per_sample_max",
    "cpu_load_percent",
    "edge_to_attitude_us_mean",
    "edge_to_attitude_us_max",
    "inclination_rms_deg",
    "inclination_max_deg",
    "flash_bytes",
    "ram_bytes",
    "stack_bytes_used",
];

/// File and line with the revision of the filters.
const ESTIMATOR: &str = "src/estimator/mod.rs";
const REVISION_LINE: &str = "pub const REVISION: u16 = ";

/// Length of the long flights in memory, h.
const DAY_H: u32 = 24;

/// Flights of the campaign with faults.
pub const CAMPAIGN_RUNS: &str = "2000";

/// Measures everything that is in the file but the figures by hand, and calls `save` after each
/// part.
///
/// `is_long` adds the flights of an hour and of a day, and the campaign with faults.
pub fn all(
    data: &mut Data,
    is_long: bool,
    save: impl Fn(&Data) -> Result<(), String>,
) -> Result<(), String> {
    // First, because the source may change while the programs that are built from it run.
    let revision = revision_of(&super::read(ESTIMATOR)?)?;
    let toolchain = Toolchain::for_target()?;
    let virtual_board = build::virtual_board()?;
    let default = flights(data, &toolchain, &virtual_board)?;
    save(data)?;
    sizes(data, &toolchain)?;
    save(data)?;
    recorded(data, &virtual_board, &default)?;
    save(data)?;
    calibration(data)?;
    save(data)?;
    cost::bless()?;
    take_costs(data)?;
    save(data)?;
    filters(data)?;
    save(data)?;
    if is_long {
        let (board, hour) = (Board::default(), ["--seconds", "3600"]);
        let hour = fly(&virtual_board, &default, board, &hour, "hour")?;
        data.replace(hour.with_revision(revision));
        save(data)?;
        data.replace(day()?.with_revision(revision));
        save(data)?;
        let campaign = campaign(&virtual_board, &default)?;
        data.replace(campaign.with_revision(revision));
        save(data)?;
    }
    Ok(())
}

/// Copies the committed table of the filters' costs.
pub fn take_costs(data: &mut Data) -> Result<(), String> {
    let mut section = Section::new("cost", &today()?);
    for (name, cells) in cost::committed()?.iter().map(cost_line) {
        section.put(&name, cells);
    }
    data.replace(section);
    Ok(())
}

/// Flies every board. Returns the default board's image.
fn flights(
    data: &mut Data,
    toolchain: &Toolchain,
    virtual_board: &Path,
) -> Result<PathBuf, String> {
    let mut default = None;
    for board in BOARDS {
        let elf = Firmware::full(board).build(toolchain)?;
        let name = format!("board.{}", board.name);
        data.replace(fly(
            virtual_board,
            &elf,
            board,
            &["--seconds", "20"],
            &name,
        )?);
        if default.is_none() {
            data.replace(fly(
                virtual_board,
                &elf,
                board,
                &["--seconds", "60"],
                "fly",
            )?);
            default = Some(elf);
        }
    }
    default.ok_or_else(|| "there is no board".to_owned())
}

/// Flies an image, and returns the figures of the flight as a section of this name.
pub fn fly(
    virtual_board: &Path,
    elf: &Path,
    board: Board,
    arguments: &[&str],
    name: &str,
) -> Result<Section, String> {
    let folder = step::target_folder().join("results").join(name);
    step::timed(&format!("measuring: {name}"), || {
        let mut fly = step::command(virtual_board);
        fly.args(["fly", "--board", board.name]).args(arguments);
        // The firmware's log would be thousands of lines.
        fly.stdout(Stdio::null());
        step::run(fly.arg("--elf").arg(elf).arg("--output").arg(&folder))
    })?;
    let path = folder.join("summary.json");
    let summary = std::fs::read_to_string(&path)
        .map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    let mut section = Section::new(name, &today()?);
    for key in FLIGHT {
        let value =
            field(&summary, key).ok_or_else(|| format!("{} has no `{key}`", path.display()))?;
        section.put(key, rounded(value)?);
    }
    Ok(section)
}

/// A number to three decimals, as the data file has it.
fn rounded(value: &str) -> Result<f64, String> {
    let number: f64 = value
        .parse()
        .map_err(|_| format!("`{value}` is not a number"))?;
    Ok((number * 1e3).round() / 1e3)
}

fn sizes(data: &mut Data, toolchain: &Toolchain) -> Result<(), String> {
    let mut section = Section::new("size", &today()?);
    section.put("kalman_flash_bytes", size::check_kalman(toolchain)?);
    let without_compass = Firmware::without_compass(Board::default()).build(toolchain)?;
    let bytes = size::measure(&without_compass)?.flash;
    section.put("without_compass_flash_bytes", bytes);
    let minimal = Firmware::minimal(Board::default()).build(toolchain)?;
    section.put("minimal_flash_bytes", size::measure(&minimal)?.flash);
    let examples = examples::build(toolchain)?;
    let rtic = examples::rtic(&examples)?;
    section.put("rtic_flash_bytes", size::measure(rtic)?.flash);
    data.replace(section);
    Ok(())
}

/// Flies two recordings, if they are at hand.
fn recorded(data: &mut Data, virtual_board: &Path, elf: &Path) -> Result<(), String> {
    let mut section = Section::new("recorded", &today()?);
    for (key, file) in [
        ("broad_01_rms_deg", "broad/01.csv.gz"),
        ("tumvi_room1_rms_deg", "tumvi/room1.csv.gz"),
    ] {
        let path = recordings::folder().join(file);
        if !path.is_file() {
            return skip("flights of recordings", &path);
        }
        let path = path.to_string_lossy().into_owned();
        let flown = fly(virtual_board, elf, Board::default(), &["--log", &path], key)?;
        section.put(key, flown.text("inclination_rms_deg")?);
    }
    data.replace(section);
    Ok(())
}

/// Compares the filters on the recordings, if they are at hand, and on simulated flights.
fn filters(data: &mut Data) -> Result<(), String> {
    let bench = build::bench()?;
    for set in ["broad", "tumvi", "simulated", "calibrated"] {
        let mut command = step::command(&bench);
        command.arg("--json");
        if ["simulated", "calibrated"].contains(&set) {
            // Without recordings it takes simulated flights, and there are none beside this folder.
            let folder = step::target_folder().join("results");
            std::fs::create_dir_all(&folder)
                .map_err(|error| format!("cannot make {}: {error}", folder.display()))?;
            command.current_dir(folder);
            if set == "calibrated" {
                command.args(["--accelerometer", "calibrated"]);
            }
        } else {
            let folder = recordings::folder().join(set);
            if !folder.is_dir() {
                skip("the accuracy on recordings", &folder)?;
                continue;
            }
            command.arg(folder);
        }
        let json = step::timed(&format!("measuring: filters on {set}"), || {
            step::output(&mut command)
                .ok_or_else(|| "aplomb-bench failed: run `cargo xtask bench` to see why".to_owned())
        })?;
        let mut section = Section::new(&format!("filters.{set}"), &today()?);
        for (index, filter) in FILTERS.into_iter().enumerate() {
            let errors = errors_deg(&json, filter);
            if errors.is_empty() {
                return Err(format!("aplomb-bench has no scores of `{filter}` on {set}"));
            }
            if index == 0 {
                section.put("recordings", errors.len());
            }
            section.put(filter, median_and_mean(&errors));
        }
        data.replace(section);
    }
    Ok(())
}

/// The errors of a filter on each recording with truth, in ascending order.
fn errors_deg(json: &str, filter: &str) -> Vec<f64> {
    let mut errors: Vec<f64> = json
        .split('{')
        .filter(|score| field(score, "filter") == Some(filter))
        .filter(|score| field(score, "reference") == Some("truth"))
        .filter_map(|score| field(score, "inclination_rms_deg")?.parse().ok())
        .collect();
    errors.sort_by(f64::total_cmp);
    errors
}

/// Median and mean of numbers in ascending order.
fn median_and_mean(sorted: &[f64]) -> String {
    let middle = sorted.len() / 2;
    let median = if sorted.len().is_multiple_of(2) {
        (sorted[middle - 1] + sorted[middle]) / 2.0
    } else {
        sorted[middle]
    };
    let mean = sorted.iter().sum::<f64>() / sorted.len() as f64;
    format!("{median:.2}/{mean:.2}")
}

/// Runs the test that calibrates two hundred chips, and keeps the lines that it prints.
fn calibration(data: &mut Data) -> Result<(), String> {
    let mut command = step::host_cargo("test");
    command.args(["--release", "--workspace", "--test", "calibration"]);
    command.args(["two_hundred", "--", "--nocapture"]);
    let text = step::timed("measuring: calibration", || {
        step::output(&mut command).ok_or_else(|| {
            "the test failed: `cargo test -p aplomb-models --test calibration` shows why".to_owned()
        })
    })?;
    let mut section = Section::new("calibration", &today()?);
    for line in text.lines() {
        if let Some((name, figures)) = line.split_once(": worst ") {
            section.put(name, format!("worst {figures}"));
        }
    }
    if section.figures().next().is_none() {
        return Err("the test `calibration` printed no figures".into());
    }
    data.replace(section);
    Ok(())
}

/// Flies the pipeline in memory for a day with each of four seeds.
fn day() -> Result<Section, String> {
    let bench = build::bench()?;
    let seconds = (DAY_H * 3_600).to_string();
    let text = step::timed("measuring: flights of a day", || {
        let failed = || format!("run `cargo xtask bench --long {seconds}` to see why it failed");
        step::output(step::command(&bench).args(["--long", &seconds])).ok_or_else(failed)
    })?;
    let mut section = Section::new("day", &today()?);
    section.put("hours", DAY_H);
    for (seed, cells) in flight_rows(&text) {
        section.put(seed, cells);
    }
    if section.figures().count() == 1 {
        return Err("aplomb-bench printed no flights".into());
    }
    Ok(section)
}

/// The rows of the table with one for each flight, after the one for hours: seed and other cells.
fn flight_rows(text: &str) -> impl Iterator<Item = (&str, &str)> {
    let (_, table) = text.split_once("\n\n").unwrap_or_default();
    table.lines().skip(2).filter_map(|row| {
        let cells = row.strip_prefix("| ")?.strip_suffix(" |")?;
        cells.split_once(" | ")
    })
}

/// Flies two thousand times with faults by chance.
fn campaign(virtual_board: &Path, elf: &Path) -> Result<Section, String> {
    let mut command = step::command(virtual_board);
    command.args(["faults", "--runs", CAMPAIGN_RUNS, "--elf"]);
    let text = step::timed("measuring: flights with faults", || {
        let failed = || "flights have failed: run `cargo xtask faults --runs 2000`".to_owned();
        step::output(command.arg(elf)).ok_or_else(failed)
    })?;
    let mut section = Section::new("campaign", &today()?);
    let [runs, seed, failed] = text
        .lines()
        .find_map(campaign_result)
        .ok_or("the campaign printed no result")?;
    section.put("runs", runs);
    section.put("seed", seed);
    section.put("failed", failed);
    let (_, rows) = text
        .split_once("worst recovery ms\n")
        .ok_or("the campaign printed no table")?;
    for row in rows.lines().map_while(campaign_row) {
        let (fault, cells) = row;
        section.put(fault, cells);
    }
    Ok(section)
}

/// The last line of the campaign: flights, seed of the first one, failed flights.
fn campaign_result(line: &str) -> Option<[u64; 3]> {
    let (runs, rest) = line.split_once(" flights from seed ")?;
    let (seed, rest) = rest.split_once(" on in ")?;
    let (_, failed) = rest.strip_suffix(" failed")?.rsplit_once(", ")?;
    let number = |text: &str| text.parse().ok();
    Some([number(runs)?, number(seed)?, number(failed)?])
}

/// A row of the campaign's table: the fault, then runs, recovered, worst recovery in ms.
fn campaign_row(row: &str) -> Option<(&str, String)> {
    let cells: Vec<&str> = row.split_whitespace().collect();
    let [fault, runs, _detected, recovered, worst] = cells[..] else {
        return None;
    };
    Some((fault, format!("{runs} {recovered} {worst}")))
}

/// Reads the revision of the filters in their source.
fn revision_of(source: &str) -> Result<u16, String> {
    let line = source.lines().find_map(|l| l.strip_prefix(REVISION_LINE));
    let number = line.and_then(|rest| rest.strip_suffix(';')?.parse().ok());
    number.ok_or_else(|| format!("{ESTIMATOR} has no line `{REVISION_LINE}…;`"))
}

/// A row of the table of costs as a line of the data file.
pub fn cost_line(row: &cost::Row) -> (String, String) {
    let cells = format!(
        "{:.1} {} {} {} {}",
        row.mean, row.maximum, row.first, row.flash, row.ram
    );
    (row.name.clone(), cells)
}

/// The value of a key in the text of one JSON object, without its quotes.
fn field<'a>(json: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = json.split_once(&format!("\"{key}\":"))?;
    let end = rest.find([',', '}', '\n']).unwrap_or(rest.len());
    Some(rest[..end].trim().trim_matches('"')).filter(|value| *value != "null")
}

fn skip(work: &str, path: &Path) -> Result<(), String> {
    let reason = format!("{}. The old figures stay", recordings::absence(path));
    step::skip(work, &reason);
    Ok(())
}

/// Today's date in UTC, as 2026-11-22.
fn today() -> Result<String, String> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    let days = since.map_err(|error| error.to_string())?.as_secs() / 86_400;
    Ok(date(days))
}

/// The date so many days after 1970-01-01.
fn date(days: u64) -> String {
    let is_leap = |year: u64| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    let (mut year, mut day) = (1970, days);
    loop {
        let length = 365 + u64::from(is_leap(year));
        if day < length {
            break;
        }
        day -= length;
        year += 1;
    }
    let february = 28 + u64::from(is_leap(year));
    let mut month = 1;
    for length in [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31] {
        if day < length {
            break;
        }
        day -= length;
        month += 1;
    }
    format!("{year}-{month:02}-{:02}", day + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_json_are_found() {
        let json = "{\n  \"samples\": 19000,\n  \"x\": null,\n  \"name\": \"a\"}";
        assert_eq!(field(json, "samples"), Some("19000"));
        assert_eq!(field(json, "name"), Some("a"));
        assert_eq!(field(json, "x"), None);
        assert_eq!(field(json, "y"), None);
    }

    #[test]
    fn numbers_have_three_decimals() {
        assert_eq!(rounded("1016.6681956928682"), Ok(1016.668));
        assert_eq!(rounded("59297"), Ok(59_297.0));
        assert!(rounded("a").is_err());
    }

    #[test]
    fn errors_are_those_of_the_filter_with_truth() {
        let score = |filter, reference, error| {
            format!(
                "{{\"reference\":\"{reference}\",\"filter\":\"{filter}\",\
                 \"inclination_rms_deg\":{error}}}"
            )
        };
        let scores = [
            score("kalman", "truth", 0.5),
            score("vqf", "truth", 0.1),
            score("kalman", "rest", 9.0),
            score("kalman", "truth", 0.3),
        ];
        let json = format!("{{\"scores\":[{}]}}", scores.join(","));
        let errors = errors_deg(&json, "kalman");
        assert_eq!(errors, [0.3, 0.5]);
        assert_eq!(median_and_mean(&errors), "0.40/0.40");
        assert_eq!(median_and_mean(&[0.1, 0.2, 0.9]), "0.20/0.40");
    }

    #[test]
    fn rows_of_the_campaign_are_read() {
        let row = "sda-low                 93        93         93               9.0";
        assert_eq!(campaign_row(row), Some(("sda-low", "93 93 9.0".to_owned())));
        let last = "2000 flights from seed 1 on in 900 s, 0 failed";
        assert_eq!(campaign_row(last), None);
        assert_eq!(campaign_result(last), Some([2000, 1, 0]));
        assert_eq!(campaign_result(row), None);
    }

    #[test]
    fn the_revision_is_that_of_the_source() {
        let source = "//! a\n\npub const REVISION: u16 = 19;\n";
        assert_eq!(revision_of(source), Ok(19));
        assert!(revision_of("const REVISION: u16 = 19;").is_err_and(|e| e.contains(ESTIMATOR)));
        let committed = super::super::read(ESTIMATOR).expect("the source is there");
        assert!(revision_of(&committed).is_ok_and(|revision| revision >= 19));
    }

    #[test]
    fn the_flights_follow_the_hours() {
        let text = "| seed | hour | rms |\n|---|---|---|\n| 1000 | 1 | 0.80° |\n\n\
                    | seed | `VALID` | rms |\n|---|---|---|\n\
                    | 1000 | 100.000 % | 0.81° |\n| 1001 | 99.990 % | 0.90° |\n";
        let rows: Vec<_> = flight_rows(text).collect();
        assert_eq!(
            rows,
            [("1000", "100.000 % | 0.81°"), ("1001", "99.990 % | 0.90°")]
        );
        assert_eq!(flight_rows("error").count(), 0);
    }

    #[test]
    fn days_become_dates() {
        for (days, text) in [
            (0, "1970-01-01"),
            (59, "1970-03-01"),
            (789, "1972-02-29"),
            (11_016, "2000-02-29"),
            (20_779, "2026-11-22"),
        ] {
            assert_eq!(date(days), text);
        }
    }
}
