//! The virtual board's serial port for other programs: raw bytes over TCP and a pseudo-terminal,
//! and a ground station of pymavlink.

mod common;

#[path = "../../tests/pymavlink/python.rs"]
mod python;

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::firmware;

/// Longest wait for an answer, which only ends a test that hangs. The image is compiled first.
const PATIENCE: Duration = Duration::from_secs(300);

/// A flight in real time, which ends with the test.
struct Flight {
    child: Child,
    /// Name of the port.
    port: String,
}

impl Flight {
    fn new(options: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_virtual-board"))
            .args(["fly", "--elf"])
            .arg(firmware())
            .args(options)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program runs");
        let mut line = String::new();
        let mut errors = BufReader::new(child.stderr.take().expect("it is piped"));
        errors.read_line(&mut line).expect("the program speaks");
        let port = line.trim().strip_prefix("serial port: ").expect(&line);
        Self {
            port: port.to_owned(),
            child,
        }
    }

    fn tcp() -> Self {
        let mut flight = Self::new(&["--tcp", "127.0.0.1:0"]);
        flight.port = flight
            .port
            .strip_prefix("tcp:")
            .expect("an address")
            .to_owned();
        flight
    }
}

impl Drop for Flight {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// Sends these bytes until a line with this beginning comes, and returns the line.
fn ask(to: &mut impl Write, from: &mut impl Read, bytes: &[u8], start: &str) -> String {
    let deadline = Instant::now() + PATIENCE;
    let mut next_question = Instant::now();
    let mut line = Vec::new();
    while Instant::now() < deadline {
        if Instant::now() >= next_question {
            to.write_all(bytes).expect("the port takes bytes");
            next_question += Duration::from_secs(2);
        }
        let mut byte = [0];
        if from.read(&mut byte).is_ok_and(|length| length == 0) {
            panic!("the port was closed");
        }
        if byte != *b"\n" {
            line.extend(byte);
            continue;
        }
        let text = String::from_utf8_lossy(&line).into_owned();
        if text.starts_with(start) {
            return text;
        }
        line.clear();
    }
    panic!("no answer to {bytes:?}")
}

#[test]
fn any_bytes_pass_a_tcp_port_and_programs_may_come_and_go() {
    let flight = Flight::tcp();
    for _ in 0..2 {
        let mut stream = TcpStream::connect(&flight.port).expect("it listens");
        let mut reading = BufReader::new(stream.try_clone().expect("a second end"));
        // The beginning of a MAVLink frame is no UTF-8.
        let bytes = b"\xFD\x00\xFF\nstatus\n";
        let answer = ask(&mut stream, &mut reading, bytes, "# ok status: ");
        assert!(answer.contains("frames_dropped="), "{answer}");
    }
}

#[cfg(unix)]
#[test]
fn a_pseudo_terminal_is_the_boards_serial_port() {
    let flight = Flight::new(&["--pty"]);
    for _ in 0..2 {
        let open = || {
            std::fs::File::options()
                .read(true)
                .write(true)
                .open(&flight.port)
        };
        let (mut to, from) = (open().expect("a port"), open().expect("a port"));
        let bytes = b"\xFD\x00\xFF\nstatus\n";
        let answer = ask(&mut to, &mut BufReader::new(from), bytes, "# ok status: ");
        assert!(answer.contains("frames_dropped="), "{answer}");
    }
}

#[test]
fn a_ground_station_of_pymavlink_reads_sets_and_commands() {
    let Some(python) = python::with_pymavlink(Path::new(env!("CARGO_TARGET_TMPDIR"))) else {
        return;
    };
    let seconds = std::env::var("APLOMB_PORT_SECONDS").unwrap_or_else(|_| "5".into());
    let flight = Flight::tcp();
    let station = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/port/station.py");
    let result = Command::new(python)
        .arg(station)
        .args([&flight.port, &seconds])
        .output()
        .expect("Python starts");
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{errors}");
    let report: serde_json::Value = serde_json::from_slice(&result.stdout).expect("JSON");
    println!("{report}");
    assert!(report["parameters"].as_u64() >= Some(5), "{report}");
    // 3: MAV_RESULT_UNSUPPORTED.
    assert_eq!(report["results"]["9999/0"], 3, "{report}");
    let attitudes = report["counts"]["ATTITUDE_QUATERNION"]
        .as_f64()
        .unwrap_or(0.0)
        + report["counts"]["ATTITUDE"].as_f64().unwrap_or(0.0);
    let seconds = report["seconds"].as_f64().expect("a number");
    assert!(attitudes / seconds > 20.0, "{report}");
    assert_eq!(report["lost"], 0, "{report}");
}
