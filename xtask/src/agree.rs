//! Holds the virtual board, `aplomb replay` and QEMU to the same attitudes from the same bursts, to
//! the last bit.
//!
//! Flies a simulated flight, armed for a part of it, and a whole recorded trial where recordings
//! are at hand. A simulated flight with a compass is held to its own flight log, heading included.
//! `rigs/tests/qemu.rs` compares QEMU with the library.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use crate::build::{self, Board, Firmware};
use crate::setup::{self, Toolchain};
use crate::{recordings, rigs, step};

/// Seconds of the simulated flight, from power-up to the middle of its manoeuvres.
const SIMULATED_SECONDS: &str = "30";
/// Commands of the simulated flight.
const ARM_COMMANDS: &str = "8.0 arm\n26.0 disarm\n";
/// Commands of the flight with a compass, whose log is replayed.
const LOG_COMMANDS: &str = "0.5 baud 921600\n1.0 format log\n";
/// Rows at the start of a log that come before the states of the filters: 0.5 s.
const ROWS_BEFORE_STATES: usize = 500;
/// The recorded trial: 141 s of walking about with the sensor in the hand.
const RECORDING: &str = "tumvi/room1.csv.gz";

/// Builds what it takes, and does it.
pub fn build_and_run() -> Result<(), String> {
    let toolchain = Toolchain::for_target()?;
    let firmware = Firmware::full(Board::default());
    let elf = firmware.build(&toolchain)?;
    run(&toolchain, &build::virtual_board()?, &elf)
}

/// Flies the image, and replays its bursts here and in QEMU.
pub fn run(toolchain: &Toolchain, virtual_board: &Path, elf: &Path) -> Result<(), String> {
    let bursts = fly_and_replay(virtual_board, elf)?;
    step::timed("a flight with a compass, and the replay of its log", || {
        fly_with_compass(virtual_board, elf)
    })?;
    let bursts = std::env::join_paths(bursts)
        .map_err(|error| format!("the target folder's name is no part of a list: {error}"))?;
    step::timed("QEMU tests", || {
        setup::qemu()?;
        let elf = rigs::qemu(toolchain)?;
        let mut test = step::host_cargo("test");
        test.args(["--release", "--workspace", "--test", "qemu"]);
        test.args(["--", "--nocapture"]);
        test.env("APLOMB_QEMU_ELF", elf);
        step::run(test.env("APLOMB_BURSTS", bursts))
    })
}

/// Returns the files of bursts.
fn fly_and_replay(virtual_board: &Path, elf: &Path) -> Result<Vec<PathBuf>, String> {
    let aplomb = build::program()?;
    let commands = write_commands("simulated", ARM_COMMANDS)?;
    let simulated = ["--seconds", SIMULATED_SECONDS, "--commands"].map(str::to_owned);
    let mut simulated = simulated.to_vec();
    simulated.push(commands.to_string_lossy().into_owned());
    let mut flights = vec![("simulated", simulated)];
    let recording = recordings::folder().join(RECORDING);
    if recording.is_file() {
        let path = recording.to_string_lossy().into_owned();
        flights.push(("recorded", vec!["--log".to_owned(), path]));
    } else {
        step::skip(
            "a recorded trial through board, replay and QEMU",
            &recordings::absence(&recording),
        );
    }
    let mut bursts = Vec::new();
    for (name, motion) in flights {
        let folder = step::target_folder().join("agree").join(name);
        step::timed(&format!("a {name} flight, and its replay"), || {
            let mut fly = step::command(virtual_board);
            fly.arg("fly").args(motion).arg("--output").arg(&folder);
            step::run(fly.arg("--elf").arg(elf))?;
            let replayed = folder.join("replayed.csv");
            let mut replay = step::command(&aplomb);
            replay.arg("replay").arg(folder.join("bursts.csv"));
            step::run(replay.arg("--output").arg(&replayed))?;
            let flown = folder.join("attitude.csv");
            let rows = compare(&read(&flown)?, &read(&replayed)?)
                .map_err(|error| format!("{} as replayed: {error}", flown.display()))?;
            eprintln!("   {rows} attitudes agree to the bit");
            Ok(())
        })?;
        bursts.push(folder.join("bursts.csv"));
    }
    Ok(bursts)
}

/// Writes the commands of this flight to a file, and returns its path.
fn write_commands(flight: &str, text: &str) -> Result<PathBuf, String> {
    let folder = step::target_folder().join("agree").join(flight);
    let commands = folder.join("commands.txt");
    std::fs::create_dir_all(&folder)
        .and_then(|()| std::fs::write(&commands, text))
        .map_err(|error| format!("{}: {error}", commands.display()))?;
    Ok(commands)
}

/// Flies with a compass, and holds the replay of the flight log to what the firmware published.
fn fly_with_compass(virtual_board: &Path, elf: &Path) -> Result<(), String> {
    let folder = step::target_folder().join("agree").join("compass");
    let commands = write_commands("compass", LOG_COMMANDS)?;
    let mut fly = step::command(virtual_board);
    fly.args(["fly", "--sensor", "gy87", "--seconds", SIMULATED_SECONDS]);
    fly.arg("--commands").arg(&commands);
    step::run(fly.arg("--output").arg(&folder).arg("--elf").arg(elf))?;
    let replayed = folder.join("replayed.csv");
    let mut replay = step::command(&build::program()?);
    replay.arg("replay").arg(folder.join("uart.log"));
    step::run(replay.arg("--output").arg(&replayed))?;
    let flown = folder.join("attitude.csv");
    let (flown_rows, replayed_rows) = logged(&read(&flown)?, &read(&replayed)?);
    let rows = compare(&flown_rows, &replayed_rows)
        .map_err(|error| format!("{} as replayed: {error}", flown.display()))?;
    let headings = column(&flown_rows, "yaw_offset_deg")?;
    let headings = headings.iter().filter(|cell| !cell.is_empty()).count();
    eprintln!("   {rows} attitudes and {headings} headings agree to the bit");
    if headings < rows / 2 {
        return Err(format!(
            "{headings} headings for {rows} attitudes are too few"
        ));
    }
    Ok(())
}

/// Returns the rows of both tables from the log's first states on, without flags: the published
/// ones do not have the heading's.
fn logged(flown: &str, replayed: &str) -> (String, String) {
    let time = |row: &str| row.split(',').next().unwrap_or_default().to_owned();
    let mut replayed = replayed.lines();
    let mut late: Vec<&str> = replayed.next().into_iter().collect();
    late.extend(replayed.skip(ROWS_BEFORE_STATES));
    let times: HashSet<String> = late.iter().copied().map(time).collect();
    let flown = flown.lines().filter(|row| times.contains(&time(row)));
    let flown: Vec<&str> = flown.collect();
    let flags = flown.first().map_or(0, |header| {
        let columns = header.split(',');
        columns.take_while(|name| *name != "flags").count()
    });
    let without_flags = |row: &&str| {
        let cells = row.split(',').enumerate();
        let cells = cells.filter(|(index, _)| *index != flags);
        cells.map(|(_, cell)| cell).collect::<Vec<_>>().join(",")
    };
    let flown: Vec<String> = flown.iter().map(without_flags).collect();
    (flown.join("\n"), late.join("\n"))
}

/// Returns the cells of a column.
fn column<'a>(table: &'a str, name: &str) -> Result<Vec<&'a str>, String> {
    let mut rows = table.lines();
    let header = rows.next().unwrap_or_default();
    let place = header.split(',').position(|column| column == name);
    let place = place.ok_or_else(|| format!("column {name:?} is missing"))?;
    Ok(rows.filter_map(|row| row.split(',').nth(place)).collect())
}

fn read(path: &Path) -> Result<String, String> {
    std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))
}

/// Holds every column of `flown` to that of the same name in `replayed`: numbers by their bits, the
/// rest as text. Returns how many rows there are.
fn compare(flown: &str, replayed: &str) -> Result<usize, String> {
    let (mut flown, mut replayed) = (flown.lines(), replayed.lines());
    let columns: Vec<&str> = flown.next().unwrap_or_default().split(',').collect();
    let others: Vec<&str> = replayed.next().unwrap_or_default().split(',').collect();
    let places = columns.iter().map(|name| {
        let place = others.iter().position(|other| other == name);
        place.ok_or_else(|| format!("column {name:?} is missing"))
    });
    let places = places.collect::<Result<Vec<usize>, String>>()?;
    let mut rows = 0;
    loop {
        let (row, other) = match (flown.next(), replayed.next()) {
            (None, None) if rows > 0 => return Ok(rows),
            (Some(row), Some(other)) => (row, other),
            _ => return Err(format!("one of both ends after {rows} rows")),
        };
        rows += 1;
        let (cells, others): (Vec<&str>, Vec<&str>) =
            (row.split(',').collect(), other.split(',').collect());
        for ((name, place), cell) in columns.iter().zip(&places).zip(&cells) {
            let other = others.get(*place).copied().unwrap_or_default();
            if !is_same(cell, other) {
                return Err(format!("row {rows}: {name} is {cell:?} and {other:?}"));
            }
        }
        if cells.len() != columns.len() {
            return Err(format!("row {rows} has {} columns", cells.len()));
        }
    }
}

/// Times are whole and longer than an `f32`: they are compared as text, as flags are.
fn is_same(cell: &str, other: &str) -> bool {
    let bits = |text: &str| text.parse().map(f32::to_bits);
    match (bits(cell), bits(other)) {
        (Ok(one), Ok(two)) if cell.contains('.') => one == two,
        _ => cell == other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FLOWN: &str = "t_us,qw,flags\n16777217,0.1,MISSED\n16777218,-0,\n";

    #[test]
    fn columns_agree_by_name_and_numbers_by_bits() {
        let replayed = "t_us,up_x,flags,qw\n16777217,9,MISSED,0.10000000149\n16777218,9,,-0\n";
        assert_eq!(compare(FLOWN, replayed), Ok(2));
    }

    #[test]
    fn a_log_is_compared_from_its_states_on_without_flags() {
        let mut flown = "t_us,qw,flags,yaw_offset_deg\n".to_owned();
        let mut replayed = "t_us,qw,flags,heading_deg,yaw_offset_deg\n".to_owned();
        for t_us in 0..600 {
            flown += &format!("{t_us},0.5,VALID,{}\n", if t_us < 550 { "" } else { "1.5" });
        }
        for t_us in 10..590 {
            // Before the states, the replay may differ.
            let qw = if t_us < 500 { "0.4" } else { "0.5" };
            let heading = if t_us < 550 { "," } else { "9.0,1.5" };
            replayed += &format!("{t_us},{qw},VALID|HEADING_VALID,{heading}\n");
        }
        let (flown, replayed) = logged(&flown, &replayed);
        assert_eq!(compare(&flown, &replayed), Ok(80));
        let offsets = column(&flown, "yaw_offset_deg").unwrap();
        assert_eq!(offsets.iter().filter(|cell| !cell.is_empty()).count(), 40);
        let wrong = replayed.replacen("9.0,1.5", "9.0,1.25", 1);
        assert!(
            compare(&flown, &wrong)
                .unwrap_err()
                .contains("yaw_offset_deg")
        );
    }

    #[test]
    fn what_differs_is_named() {
        for (from, to, what) in [
            (",0.1,", ",0.10000001,", "row 1: qw"),
            (",-0,", ",0,", "row 2: qw"),
            (",-0,", ",,", "row 2: qw"),
            ("MISSED", "GAP", "row 1: flags"),
            ("16777217", "16777216", "row 1: t_us"),
            ("qw", "qx", "column \"qw\" is missing"),
            ("16777218,-0,\n", "", "after 1 rows"),
        ] {
            let error = compare(FLOWN, &FLOWN.replacen(from, to, 1)).unwrap_err();
            assert!(error.contains(what), "{error}");
        }
        assert!(
            compare("t_us\n", "t_us\n").is_err(),
            "nothing agrees with nothing"
        );
        let short = compare("t_us,qw,flags\n1,0.1\n", "t_us,qw,flags\n1,0.1,\n");
        assert!(short.is_err_and(|error| error.contains("2 columns")));
    }
}
