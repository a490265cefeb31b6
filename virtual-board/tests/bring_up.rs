//! `aplomb bring-up` from the outside, with a person who does as told, on good and on bad wiring.

#![cfg(unix)]

mod common;

use std::f64::consts::{FRAC_PI_2, PI};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use aplomb_models::motion::turn::Turn;
use aplomb_models::motion::{Motion, Mount, Quaternion, Truth};
use common::pooled_run;
use virtual_board::faults::{Fault, FaultKind, ScheduledFault};
use virtual_board::flight::Run;
use virtual_board::mcu::ReceivedByte;
use virtual_board::port::Port;
use virtual_board::recorder::Observer;

/// Virtual seconds per second of real time.
const PACE: f64 = 3.0;
/// Virtual length of a flight until the supply is off, s. All steps before take less.
const FIRST_FLIGHT_S: f64 = 240.0;
/// Length of the flight after that, and of one that the end of the test ends, s.
const LAST_FLIGHT_S: f64 = 100_000.0;
/// Time of a turn by hand, s.
const TURN_S: f64 = 1.0;

/// A body that is turned as it is told.
struct Hand {
    orders: Receiver<Quaternion>,
    pose: Quaternion,
    turn: Option<(f64, Turn)>,
}

impl Motion for Hand {
    fn at(&mut self, time_s: f64) -> Truth {
        let is_resting = self
            .turn
            .is_none_or(|(start_s, _)| time_s > start_s + TURN_S);
        if is_resting && let Ok(next) = self.orders.try_recv() {
            self.turn = Some((time_s, Turn::new(self.pose, next, TURN_S)));
            self.pose = next;
        }
        let (attitude, body_rates_rad_s) = match &self.turn {
            None => (self.pose, [0.0; 3]),
            Some((start_s, turn)) => turn.at(time_s - start_s),
        };
        Truth {
            body_rates_rad_s,
            ..Truth::at_rest(attitude)
        }
    }
}

/// The board's UART at the port, at a steady pace until there is a hurry.
struct Wire {
    port: Arc<Mutex<Port>>,
    started: Instant,
    is_hurried: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
}

impl Observer for Wire {
    fn uart(&mut self, now_ns: u64, received: &[ReceivedByte]) -> Vec<u8> {
        // A flight has no other end than its time.
        while self.is_over.load(Ordering::Relaxed) {
            thread::park();
        }
        let due = Duration::from_secs_f64(now_ns as f64 * 1e-9 / PACE);
        let ahead = due.saturating_sub(self.started.elapsed());
        if ahead > Duration::from_millis(5) && !self.is_hurried.load(Ordering::Relaxed) {
            thread::sleep(ahead);
        }
        let port = self.port.lock().expect("the port");
        port.send(received.iter().map(|received| received.byte).collect());
        port.receive()
    }

    fn keeps_record(&self) -> bool {
        false
    }
}

/// A board on the table, with a person who moves it.
struct Table {
    port: String,
    orders: Sender<Quaternion>,
    is_hurried: Arc<AtomicBool>,
    is_over: Arc<AtomicBool>,
}

impl Drop for Table {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

impl Table {
    /// Switches a board on. After the first flight its supply is off for a moment.
    fn new(prepare: impl Fn(Run) -> Run + Send + 'static, first_s: f64) -> Self {
        let (port, name) = Port::pseudo_terminal().expect("a pseudo-terminal");
        let port = Arc::new(Mutex::new(port));
        let (orders, ordered) = channel();
        let is_hurried = Arc::new(AtomicBool::new(false));
        let is_over = Arc::new(AtomicBool::new(false));
        let (hurry, over) = (Arc::clone(&is_hurried), Arc::clone(&is_over));
        thread::spawn(move || {
            let wire = || Wire {
                port: Arc::clone(&port),
                started: Instant::now(),
                is_hurried: Arc::clone(&hurry),
                is_over: Arc::clone(&over),
            };
            let hand = Hand {
                orders: ordered,
                pose: Quaternion::IDENTITY,
                turn: None,
            };
            let start = || prepare(pooled_run());
            let flight = start().boxed_motion(Box::new(hand)).seconds(first_s);
            let outcome = flight.observer(wire()).run().expect("a flight");
            hurry.store(false, Ordering::Relaxed);
            let flight = start().flash(outcome.flash.bytes).seconds(LAST_FLIGHT_S);
            let level = aplomb_models::motion::rest::Rest::level();
            flight
                .motion(level)
                .observer(wire())
                .run()
                .expect("a flight");
        });
        Self {
            port: name,
            orders,
            is_hurried,
            is_over,
        }
    }

    /// Does as a line of the program says.
    fn obey(&self, line: &str) {
        let tilted = |roll: f64, pitch: f64, yaw: f64| {
            let radians = [roll, pitch, yaw].map(f64::to_radians);
            Quaternion::from_euler(radians[0], radians[1], radians[2])
        };
        let told = ["first: ", "next: "]
            .iter()
            .find_map(|word| line.split_once(word));
        // The chip lies face up, its x axis forward.
        let pose = match told.map(|(_, pose)| pose) {
            Some("z up") => Some(Quaternion::IDENTITY),
            Some("z down") => Some(Quaternion::from_euler(PI, 0.0, 0.0)),
            Some("x up") => Some(Quaternion::from_euler(0.0, FRAC_PI_2, 0.0)),
            Some("x down") => Some(Quaternion::from_euler(0.0, -FRAC_PI_2, 0.0)),
            Some("y up") => Some(Quaternion::from_euler(FRAC_PI_2, 0.0, 0.0)),
            Some("y down") => Some(Quaternion::from_euler(-FRAC_PI_2, 0.0, 0.0)),
            _ if line.contains("you: lay it level") => Some(Quaternion::IDENTITY),
            _ if line.contains("you: tip its right side down") => Some(tilted(40.0, 0.0, 0.0)),
            _ if line.contains("you: lift its nose") => Some(tilted(0.0, 40.0, 0.0)),
            _ if line.contains("you: turn it level") => Some(tilted(0.0, 0.0, 60.0)),
            _ => None,
        };
        if let Some(pose) = pose {
            self.orders.send(pose).ok();
        }
        if line.contains("you: disconnect the board's supply") {
            self.is_hurried.store(true, Ordering::Relaxed);
        }
    }
}

/// Returns the program `aplomb`, which `cargo xtask test` builds beside the virtual board's.
fn program() -> PathBuf {
    let program = Path::new(env!("CARGO_BIN_EXE_virtual-board")).with_file_name("aplomb");
    assert!(
        program.exists(),
        "first: cargo build --release -p aplomb-cli --ignore-rust-version"
    );
    program
}

/// Walks through a bring-up. Returns true if no step is bad, and the report.
fn bring_up(name: &str, table: &Table, arguments: &[&str]) -> (bool, String) {
    let report = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("bring-up-{name}.md"));
    for extension in ["md", "png", "log"] {
        std::fs::remove_file(report.with_extension(extension)).ok();
    }
    let mut child = Command::new(program())
        .args(["bring-up", "--port", &table.port, "--output"])
        .arg(&report)
        .args(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program runs");
    let output = BufReader::new(child.stdout.take().expect("it is piped"));
    for line in output.lines() {
        let line = line.expect("text");
        println!("{line}");
        table.obey(&line);
    }
    let mut errors = String::new();
    child
        .stderr
        .take()
        .expect("it is piped")
        .read_to_string(&mut errors)
        .ok();
    println!("{errors}");
    let is_good = child.wait().expect("it ends").success();
    (is_good, std::fs::read_to_string(&report).expect("a report"))
}

/// Returns the row of a step in the report.
fn row<'a>(report: &'a str, step: &str) -> &'a str {
    let start = format!("| {step} | ");
    let row = report.lines().find_map(|line| line.strip_prefix(&start));
    row.unwrap_or_else(|| panic!("no {step}: {report}"))
}

/// A fault that lasts from power-up on.
fn wired_wrong(kind: FaultKind) -> impl Fn(Run) -> Run + Send + 'static {
    move |run| {
        run.fault(Fault::Scheduled(ScheduledFault {
            kind,
            start_ns: 0,
            duration_ns: u64::MAX / 2,
        }))
    }
}

/// Steps without movement, quickly.
const QUICK: [&str; 8] = [
    "--skip", "noise", "--skip", "poses", "--skip", "turns", "--skip", "power",
];

#[test]
fn a_good_board_passes_every_step() {
    let table = Table::new(|run| run, FIRST_FLIGHT_S);
    let (is_good, report) = bring_up("good", &table, &["--rest", "6", "--patience", "200"]);
    assert!(is_good, "{report}");
    assert!(report.contains("11 good, 0 bad, 0 skipped"), "{report}");
    assert!(
        row(&report, "identity").contains("MPU-6050@0x68, WHO_AM_I 0x68"),
        "{report}"
    );
    assert!(row(&report, "registers").contains("0x6b=01,00"), "{report}");
    assert!(row(&report, "six poses").contains("6 poses"), "{report}");
    assert!(report.contains("](bring-up-good.png)"), "{report}");
    let picture = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bring-up-good.png");
    assert!(
        std::fs::read(picture)
            .expect("a picture")
            .starts_with(b"\x89PNG")
    );
}

#[test]
fn each_wrong_wire_is_found_with_advice() {
    for (name, kind, step, saw, advice) in [
        (
            "sda",
            FaultKind::SdaLow(None),
            "bus",
            "SDA (PB9) stays low",
            "look for a short",
        ),
        (
            "scl",
            FaultKind::SclLow,
            "bus",
            "SCL (PB8) stays low",
            "look for a short",
        ),
        (
            "vcc",
            FaultKind::AddressNack(None),
            "bus",
            "no sensor answers",
            "3.3 V at VCC",
        ),
        (
            "int",
            FaultKind::IntMissing,
            "INT pin",
            "no edge on the INT pin",
            "INT to PA1",
        ),
    ] {
        let table = Table::new(wired_wrong(kind), LAST_FLIGHT_S);
        let (is_good, report) = bring_up(name, &table, &QUICK);
        assert!(!is_good && report.contains(" 1 bad, "), "{name}: {report}");
        let row = row(&report, step);
        assert!(row.starts_with("BAD | "), "{name}: {report}");
        assert!(
            row.contains(saw) && row.contains(advice),
            "{name}: {report}"
        );
    }
}

#[test]
fn a_sensor_at_the_other_address_is_as_good() {
    let table = Table::new(|run| run.sensor_address(0x69), LAST_FLIGHT_S);
    let (is_good, report) = bring_up("ad0", &table, &QUICK);
    assert!(is_good && report.contains(" 0 bad, "), "{report}");
    let bus = row(&report, "bus");
    assert!(
        bus.starts_with("good | a sensor answers at 0x68 or 0x69 | "),
        "{bus}"
    );
    let identity = row(&report, "identity");
    assert!(
        identity.contains("MPU-6050@0x69, WHO_AM_I 0x68"),
        "{identity}"
    );
}

#[test]
fn an_unknown_part_is_named_with_its_byte_and_what_to_do() {
    let unknown = Fault::Identity(0x19, 0.0..2.0 * LAST_FLIGHT_S);
    let table = Table::new(move |run| run.fault(unknown.clone()), LAST_FLIGHT_S);
    let (is_good, report) = bring_up("unknown", &table, &QUICK);
    assert!(!is_good && report.contains(" 1 bad, "), "{report}");
    let bus = row(&report, "bus");
    for part in [
        "BAD | ",
        "a sensor answers at 0x68 or 0x69",
        "the chip at 0x68 has WHO_AM_I 0x19",
        "report the byte in an issue",
    ] {
        assert!(bus.contains(part), "{part}: {bus}");
    }
    // No step after it blames another wire.
    let identity = row(&report, "identity");
    assert!(identity.contains("needs the step \"bus\""), "{identity}");
}

#[test]
fn a_wrong_mount_is_found_by_turns() {
    let mount = Mount::parse("+y-z").expect("a mount");
    let table = Table::new(move |run| run.mount(mount), LAST_FLIGHT_S);
    let skipped = ["noise", "poses", "power", "edges", "self-test"];
    let arguments: Vec<&str> = skipped.iter().flat_map(|step| ["--skip", step]).collect();
    let (is_good, report) = bring_up("mount", &table, &arguments);
    assert!(!is_good, "{report}");
    let row = row(&report, "turns by hand");
    assert!(
        row.starts_with("BAD | ") && row.contains("mount find"),
        "{report}"
    );
    assert!(row.contains("pitch moves instead of roll"), "{report}");
}
