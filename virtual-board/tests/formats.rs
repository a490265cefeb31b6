//! The binary formats of the real image: what its UART sent, against the files of the same flight.

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use aplomb::mpu6050::{Burst, Part};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::serialize::StateReader;
use aplomb::telemetry::bursts;
use aplomb::telemetry::log::{Decoder, Frame};
use common::firmware;

#[path = "../../tests/pymavlink/python.rs"]
mod python;

/// The files that `fly` has written into its folder.
struct Flight {
    folder: PathBuf,
    uart: Vec<u8>,
    /// Quaternions by their time, as bits.
    attitudes: BTreeMap<u64, [u32; 4]>,
    bursts: BTreeMap<u64, Burst>,
}

fn fly(name: &str, commands: &str, seconds: &str) -> Flight {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::create_dir_all(&folder).unwrap();
    let script = folder.join("commands.txt");
    fs::write(&script, commands).unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_virtual-board"))
        .args(["fly", "--seconds", seconds, "--elf"])
        .arg(firmware())
        .arg("--commands")
        .arg(script)
        .arg("--output")
        .arg(&folder)
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{printed}");
    let read = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    let attitudes = read("attitude.csv")
        .lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<_> = line.split(',').collect();
            let bits = |index: usize| cells[index].parse::<f32>().unwrap().to_bits();
            (cells[0].parse().unwrap(), [1, 2, 3, 4].map(bits))
        })
        .collect();
    let bursts = read("bursts.csv")
        .lines()
        .skip(1)
        .map(|line| bursts::decode(line).unwrap())
        .map(|row| (row.burst.captured_at_us, row.burst))
        .collect();
    Flight {
        uart: fs::read(folder.join("uart.log")).unwrap(),
        folder,
        attitudes,
        bursts,
    }
}

#[test]
fn a_flight_log_has_every_burst_and_replays_to_the_bit() {
    let flight = fly(
        "flight-log",
        "1.0 baud 921600\n1.5 status\n2.0 format log\n12.5 format text\n12.7 status\n",
        "13",
    );
    // An attitude waits while a state is being sent.
    let text = String::from_utf8_lossy(&flight.uart);
    assert!(
        text.contains(" frames_dropped=0"),
        "{}",
        &text[text.len() - 600..]
    );
    let mut decoder = Decoder::new();
    let mut logged = Vec::new();
    let mut states: BTreeMap<u32, Vec<u8>> = BTreeMap::new();
    let mut attitudes = 0;
    for frame in flight.uart.iter().filter_map(|byte| decoder.push(*byte)) {
        match frame {
            Frame::Burst(burst) => logged.push(burst),
            Frame::Attitude(snapshot) => {
                let q = snapshot.attitude;
                let bits = [q.w, q.x, q.y, q.z].map(f32::to_bits);
                assert_eq!(flight.attitudes.get(&snapshot.t_us), Some(&bits));
                attitudes += 1;
            }
            Frame::StatePiece(piece) => {
                let state = states.entry(piece.number).or_default();
                assert_eq!(state.len(), usize::from(piece.offset));
                state.extend_from_slice(piece.bytes());
            }
            _ => {}
        }
    }
    assert!(logged.len() > 10_000, "{}", logged.len());
    assert!(attitudes > 500, "{attitudes}");
    assert!(
        logged
            .windows(2)
            .all(|pair| pair[1].number == pair[0].number + 1)
    );
    for numbered in &logged {
        let burst = numbered.burst;
        assert_eq!(
            flight.bursts.get(&burst.captured_at_us).map(|b| b.bytes),
            Some(burst.bytes)
        );
    }

    // From the first state on, what the library makes of the log is what the firmware published.
    assert_eq!(states.len(), 2, "one at the start, one ten seconds later");
    let (number, state) = states.first_key_value().unwrap();
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut reader = StateReader::new(state);
    pipeline.visit_state(&mut reader);
    assert!(reader.is_complete());
    let mut compared = 0;
    for numbered in logged.iter().skip_while(|burst| burst.number < *number) {
        let snapshot = pipeline.update(&numbered.burst, numbered.flags);
        let q = snapshot.attitude;
        let bits = [q.w, q.x, q.y, q.z].map(f32::to_bits);
        let t_us = numbered.burst.captured_at_us;
        assert_eq!(flight.attitudes.get(&t_us), Some(&bits), "at {t_us} us");
        compared += 1;
    }
    assert!(compared > 10_000, "{compared}");
}

#[test]
fn pymavlink_reads_a_flight() {
    let Some(python) = python::with_pymavlink(Path::new(env!("CARGO_TARGET_TMPDIR"))) else {
        return;
    };
    let flight = fly(
        "mavlink",
        "1.0 format mavlink\n2.0 status\n7.0 format text\n",
        "7.5",
    );
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/pymavlink/read.py");
    let output = Command::new(python)
        .arg(script)
        .arg(flight.folder.join("uart.log"))
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let report = String::from_utf8(output.stdout).unwrap();
    let count = |start: &str| {
        report
            .lines()
            .filter(|line| line.starts_with(start))
            .count()
    };
    // Text before and after, and nothing between.
    assert_eq!((count("GAP"), count("OTHER")), (0, 2), "{report}");
    assert_eq!(count("HEARTBEAT"), 6);
    assert!(count("STATUSTEXT") >= 2, "the answer to status");
    let milliseconds: BTreeMap<u64, [u32; 4]> = flight
        .attitudes
        .iter()
        .map(|(t_us, bits)| (t_us / 1000, *bits))
        .collect();
    let mut attitudes = 0;
    for line in report.lines().filter_map(|line| line.strip_prefix("Q ")) {
        let cells: Vec<_> = line.split(' ').collect();
        let bits = [1, 2, 3, 4]
            .map(|index: usize| (cells[index].parse::<f64>().unwrap() as f32).to_bits());
        assert_eq!(
            milliseconds.get(&cells[0].parse().unwrap()),
            Some(&bits),
            "{line}"
        );
        attitudes += 1;
    }
    assert!((295..=300).contains(&attitudes), "{attitudes}");
}
