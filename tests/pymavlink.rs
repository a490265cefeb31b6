//! Tests MAVLink against pymavlink, an independent implementation of the same definitions.
//!
//! The test installs pymavlink into a folder of its own under `target`. Without Python, or where
//! the installation fails, it reports that and proves nothing.

#![cfg(feature = "mavlink")]

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use aplomb::compass::CompassStatus;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{
    AccelerometerCounts, Burst, GyroscopeCounts, Part, RawSample, TemperatureCounts,
};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::settings::Record;
use aplomb::telemetry::Output;
use aplomb::telemetry::mavlink::parameter::PARAMETERS;
use aplomb::telemetry::mavlink::{Action, Calibrate, Outcome, Session, Vehicle};
use aplomb::telemetry::message::Severity;

#[path = "pymavlink/python.rs"]
mod python;

/// Rounds of 20 ms.
const TURNS: u64 = 500;

#[test]
fn pymavlink_and_the_module_decode_each_other() {
    let Some(python) = python::with_pymavlink(Path::new(env!("CARGO_TARGET_TMPDIR"))) else {
        return;
    };
    let station = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/pymavlink/station.py");
    let mut child = Command::new(python)
        .arg(station)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("Python starts");
    let mut to_station = child.stdin.take().expect("it is piped");
    let mut from_station = child.stdout.take().expect("it is piped");

    let mut module = Module::new();
    let mut flown = BTreeMap::new();
    for turn in 0..TURNS {
        let (bytes, snapshot) = module.turn(turn);
        flown.insert((snapshot.t_us / 1000).to_string(), snapshot);
        to_station
            .write_all(&(bytes.len() as u32).to_le_bytes())
            .expect("it listens");
        to_station.write_all(&bytes).expect("it listens");
        to_station.flush().expect("it listens");
        let mut length = [0; 4];
        from_station.read_exact(&mut length).expect("it answers");
        let mut answer = vec![0; u32::from_le_bytes(length) as usize];
        from_station.read_exact(&mut answer).expect("it answers");
        module.receive(&answer);
    }
    to_station
        .write_all(&u32::MAX.to_le_bytes())
        .expect("it listens");
    drop(to_station);
    let mut report = String::new();
    from_station
        .read_to_string(&mut report)
        .expect("the report is text");
    assert!(child.wait().expect("it ends").success());
    check(&report, &flown);
    assert_eq!(
        module.done,
        [
            Action::SetRate(25),
            Action::Calibrate(Calibrate::Gyroscope),
            Action::Calibrate(Calibrate::Level),
        ]
    );
    assert_eq!(
        module.text, b"status\n",
        "a line of text reaches the console"
    );
}

/// Message of the report: its name, and its fields in Python's notation.
type Seen<'a> = (&'a str, BTreeMap<&'a str, &'a str>);

fn check(report: &str, flown: &BTreeMap<String, Snapshot>) {
    let seen: Vec<Seen<'_>> = report.lines().map(parse).collect();
    let all = |name: &str| -> Vec<&BTreeMap<&str, &str>> {
        let of_name = seen.iter().filter(|(kind, _)| *kind == name);
        of_name.map(|(_, fields)| fields).collect()
    };
    assert_eq!(all("GAP").len() + all("STRANGER").len(), 0);
    assert_eq!(all("HEARTBEAT").len(), 10);
    // One more than heartbeats: when the attitude becomes valid.
    assert_eq!(all("SYS_STATUS").len(), 11);

    let attitudes = all("ATTITUDE");
    assert_eq!(attitudes.len() as u64, TURNS);
    for fields in attitudes {
        let snapshot = &flown[fields["time_boot_ms"]];
        let angles = snapshot.euler();
        for (name, expected) in [
            ("roll", angles.roll_rad),
            ("pitch", angles.pitch_rad),
            ("yaw", angles.yaw_rad),
            ("rollspeed", snapshot.body_rates_rad_s.x),
            ("yawspeed", snapshot.body_rates_rad_s.z),
        ] {
            // A float of the message, printed as a double.
            assert_eq!(number(fields[name]) as f32, expected, "{name}");
        }
    }
    let quaternions = all("ATTITUDE_QUATERNION");
    assert_eq!(quaternions.len() as u64, TURNS);
    for fields in quaternions {
        let attitude = flown[fields["time_boot_ms"]].attitude;
        assert_eq!(number(fields["q1"]) as f32, attitude.w);
        assert_eq!(number(fields["q2"]) as f32, attitude.x);
    }
    assert_eq!(all("HIGHRES_IMU").len() as u64, TURNS);

    let parameters = all("PARAM_VALUE");
    let names: Vec<_> = parameters
        .iter()
        .map(|fields| fields["param_id"].trim_matches('\''))
        .collect();
    let listed = &names[..PARAMETERS.len()];
    assert_eq!(listed, PARAMETERS.map(|(_, name)| name));
    let after: Vec<_> = parameters[PARAMETERS.len()..]
        .iter()
        .map(|fields| {
            (
                fields["param_id"].trim_matches('\''),
                number(fields["param_value"]),
            )
        })
        .collect();
    assert_eq!(after, [("OUT_RATE_HZ", 25.0), ("OUT_BAUD", 115_200.0)]);

    let answers: Vec<_> = all("COMMAND_ACK")
        .iter()
        .map(|fields| (fields["command"].to_owned(), fields["result"].to_owned()))
        .collect();
    let answer = |command: &str, result: &str| (command.to_owned(), result.to_owned());
    assert_eq!(
        answers,
        [
            answer("241", "5"),
            answer("241", "0"),
            answer("241", "5"),
            answer("241", "0"),
            answer("31999", "3"),
            answer("512", "0"),
        ]
    );
    let counts = all("MISSION_COUNT");
    assert_eq!((counts.len(), counts[0]["count"]), (1, "0"));
    assert_eq!(all("AUTOPILOT_VERSION").len(), 1);
    let texts: Vec<_> = all("STATUSTEXT")
        .iter()
        .map(|fields| fields["text"])
        .collect();
    assert_eq!(texts, ["'calibrated'", "'calibrated'"]);
}

/// `NAME field=value field=value`; a value may have blanks in it only if it is the last.
fn parse(line: &str) -> Seen<'_> {
    let (name, rest) = line.split_once(' ').unwrap_or((line, ""));
    let fields = rest.split(' ').filter_map(|field| field.split_once('='));
    (name, fields.collect())
}

fn number(text: &str) -> f64 {
    text.parse()
        .unwrap_or_else(|_| panic!("{text} is no number"))
}

/// Module without hardware: a pipeline in flight, and a session.
struct Module {
    pipeline: Pipeline,
    session: Session,
    record: Record,
    now_us: u64,
    text: Vec<u8>,
    done: Vec<Action>,
}

impl Module {
    fn new() -> Self {
        Self {
            pipeline: Pipeline::new(&Settings::new(&Part::MPU_6050)),
            session: Session::new(),
            record: Record::default(),
            now_us: 0,
            text: Vec::new(),
            done: Vec::new(),
        }
    }

    fn receive(&mut self, bytes: &[u8]) {
        for byte in bytes {
            let text = &mut self.text;
            self.session
                .receive(*byte, self.now_us, &mut |byte| text.push(byte));
        }
    }

    /// Runs twenty samples, then returns the output at 115,200 baud.
    fn turn(&mut self, turn: u64) -> (Vec<u8>, Snapshot) {
        let mut snapshot = Snapshot::default();
        for step in 1..=20_u64 {
            let t_us = 1_000_000 + turn * 20_000 + step * 1000;
            let wave = |period: u64, height: i64| {
                let phase = (t_us / 1000 % period) as i64;
                let period = period as i64;
                ((phase.min(period - phase) * 4 - period) * height / period) as i16
            };
            let raw = RawSample {
                accelerometer: AccelerometerCounts([wave(700, 90), wave(900, 120), 2048]),
                temperature: TemperatureCounts(-3_900),
                gyroscope: GyroscopeCounts([
                    wave(1_000, 1_500),
                    wave(1_300, 900),
                    wave(2_100, 400),
                ]),
            };
            let burst = Burst {
                bytes: raw.encode(),
                captured_at_us: t_us,
                missed_before: 0,
            };
            snapshot = self.pipeline.update(&burst, BoardFlags::empty());
        }
        self.now_us = snapshot.t_us;
        let mut buffer = [0; 640];
        let mut output = Output::new(&mut buffer);
        while let Some((ticket, action)) = self.session.take_action() {
            match action {
                Action::SetRate(rate_hz) => self.record.preferences.rate_hz = rate_hz,
                _ => {
                    self.session.answer(ticket, Outcome::InProgress);
                    assert!(self.session.send_text(
                        Severity::Information,
                        "calibrated",
                        &mut output
                    ));
                }
            }
            self.session.answer(ticket, Outcome::Accepted);
            self.done.push(action);
        }
        let vehicle = Vehicle {
            snapshot: Some(&snapshot),
            is_due: true,
            sample: self.pipeline.sample(),
            temperature_celsius: self.pipeline.temperature_celsius(),
            heading: None,
            compass: CompassStatus::default(),
            record: &self.record,
            baud: self.record.preferences.baud,
            is_armed: false,
            bursts_failed: 0,
        };
        self.session.fill(self.now_us, &vehicle, &mut output);
        let length = output.length();
        (buffer[..length].to_vec(), snapshot)
    }
}
