//! The console on a bench: a module that notes what is asked of it.

use std::collections::VecDeque;

use proptest::prelude::*;

use super::*;
use crate::attitude::Quaternion;
use crate::calibration::accelerometer::Pose;
use crate::calibration::{
    AccelerometerCorrection, AtRest, Axis, GyroscopeOffset, MotionReason, OutputFormat,
    TemperatureModel,
};
use crate::pipeline::Settings;
use crate::units::radians;

/// What was asked of the module.
#[derive(Debug, Clone, PartialEq)]
enum Call {
    Calibration(Calibration),
    StartRest(u16),
    StopRest,
    Armed(bool),
    Baud(u32),
    Begin(Task),
}

#[derive(Default)]
struct Bench {
    received: VecDeque<u8>,
    has_error: bool,
    rests: VecDeque<RestProgress>,
    outcome: Option<Outcome>,
    is_sending: bool,
    has_no_sensor: bool,
    calls: Vec<Call>,
}

impl Module for Bench {
    fn receive(&mut self) -> Option<u8> {
        self.received.pop_front()
    }

    fn take_reception_error(&mut self) -> bool {
        core::mem::take(&mut self.has_error)
    }

    fn state(&mut self) -> State {
        State {
            flags: Flags::VALID | Flags::MISSED,
            sensor: (!self.has_no_sensor).then_some((&Part::MPU_6050, 0x68)),
            temperature_celsius: 31.25,
            bias_rad_s: Vector3::new(radians(0.5), radians(-1.0), 0.0),
            bias_sigma_rad_s: radians(0.05),
            tilt_sigma_rad: radians(0.4),
            ..State::default()
        }
    }

    fn set_calibration(&mut self, calibration: &Calibration) {
        self.calls.push(Call::Calibration(*calibration));
    }

    fn start_rest(&mut self, samples: u16) {
        self.calls.push(Call::StartRest(samples));
    }

    fn stop_rest(&mut self) {
        self.calls.push(Call::StopRest);
    }

    fn take_rest(&mut self) -> Option<RestProgress> {
        self.rests.pop_front()
    }

    fn rest_percent(&mut self) -> u8 {
        40
    }

    fn set_armed(&mut self, is_armed: bool) {
        self.calls.push(Call::Armed(is_armed));
    }

    fn set_baud(&mut self, baud: u32) -> bool {
        if !self.is_sending {
            self.calls.push(Call::Baud(baud));
        }
        !self.is_sending
    }

    fn begin(&mut self, task: Task) {
        self.calls.push(Call::Begin(task));
    }

    fn take_outcome(&mut self) -> Option<Outcome> {
        self.outcome.take()
    }
}

struct Desk {
    console: Console,
    bench: Bench,
    now_us: u32,
}

fn scale() -> RestScale {
    Settings::new(&Part::MPU_6050).rest_scale()
}

impl Desk {
    fn new() -> Self {
        Self::with(None)
    }

    fn with(stored: Option<Record>) -> Self {
        Self {
            console: Console::new(stored, scale(), 1000.0, Mount::Z_UP),
            bench: Bench::default(),
            // Shortly before the clock wraps.
            now_us: u32::MAX - 3_000_000,
        }
    }

    /// One poll, 20 ms after the one before.
    fn poll(&mut self) -> Option<String> {
        self.now_us = self.now_us.wrapping_add(20_000);
        let mut answer = String::new();
        let kind = self.console.poll(self.now_us, &mut self.bench, &mut answer);
        assert_eq!(kind.is_some(), !answer.is_empty(), "{answer}");
        assert!(
            kind.is_none_or(|kind| answer.starts_with(kind.name())),
            "{answer}"
        );
        kind.map(|_| answer)
    }

    /// All answers in so many seconds.
    fn wait(&mut self, seconds: f32) -> Vec<String> {
        let polls = (seconds * 50.0) as u32;
        (0..polls).filter_map(|_| self.poll()).collect()
    }

    fn say(&mut self, bytes: impl AsRef<[u8]>) {
        self.bench.received.extend(bytes.as_ref());
    }

    /// The answer to a line, at the next poll.
    fn ask(&mut self, line: &str) -> String {
        self.say(format!("{line}\n"));
        self.poll()
            .unwrap_or_else(|| panic!("`{line}` has no answer"))
    }

    fn calls(&mut self) -> Vec<Call> {
        core::mem::take(&mut self.bench.calls)
    }

    fn rests(&mut self, rests: impl IntoIterator<Item = RestProgress>) {
        self.bench.rests.extend(rests);
    }

    fn working(&self) -> &Record {
        self.console.working()
    }
}

fn at_rest(gyroscope_degrees_s: [f32; 3], accelerometer_g: Vector3) -> RestProgress {
    let scale = scale();
    let [x, y, z] = gyroscope_degrees_s.map(|rate| rate * scale.counts_per_degree_s);
    RestProgress::Done(AtRest {
        gyroscope_counts: Vector3::new(x, y, z),
        accelerometer_counts: accelerometer_g.scale(scale.counts_per_g),
        gyroscope_sigma_counts: Vector3::new(1.0, 1.0, 1.0),
        temperature_celsius: 31.0,
        samples: 1000,
        ..AtRest::default()
    })
}

const UP: Vector3 = Vector3::new(0.0, 0.0, 1.0);
const MOVED: RestProgress = RestProgress::Moved(MotionReason::Turned(Axis::X));

/// Everything is calibrated, with the longest numbers.
fn full() -> Record {
    let long = Vector3::new(-12.3456, -12.3456, -12.3456);
    Record {
        calibration: Calibration {
            mount: Mount::parse("-x-y"),
            gyroscope: Some(GyroscopeOffset {
                offset_rad_s: Vector3::new(radians(-39.9999), radians(-39.9999), radians(-39.9999)),
                temperature_celsius: -40.0,
            }),
            temperature: Some(TemperatureModel {
                reference_celsius: 0.0,
                offset_rad_s: long,
                slope_rad_s_per_celsius: long,
                curvature_rad_s_per_celsius2: long,
                coldest_celsius: -39.9,
                warmest_celsius: 104.9,
            }),
            accelerometer: Some(AccelerometerCorrection {
                offset_m_s2: Vector3::new(-1.9613, -1.9613, -1.9613),
                matrix: [1.0, 1.0, 1.0, -0.1, -0.1, -0.1],
            }),
            level: Some(Quaternion::from_rotation_vector(Vector3::new(
                radians(-14.9),
                0.0,
                0.0,
            ))),
        },
        preferences: Preferences {
            format: OutputFormat::Classic,
            rate_hz: 1000,
            baud: 921_600,
        },
    }
}

#[test]
fn every_command_is_answered_with_one_line() {
    let mut desk = Desk::new();
    for (line, answer) in [
        (
            "help",
            "ok help: help, status, show, calibrate gyro|accel|level|temperature|done|stop, \
             mount find|<forward><down>, self-test, rate <hz>, format text|classic|teleplot|teapot|mavlink|log, baud <bps>, save, forget, arm, disarm",
        ),
        (
            "status",
            "ok status: flags=MISSED|VALID sensor=MPU-6050@0x68 mount=+x-z(default) calibrated=none bias_dps=0.500,-1.000,0.000 \
             bias_sigma_dps=0.050 tilt_sigma_deg=0.40 temperature_c=31.3 armed=no unsaved=no bursts_failed=0 \
             uart_errors=0 lines_dropped=0 frames_dropped=0",
        ),
        (
            "show",
            "ok show: mount=default gyro=none temperature=none accel_offset=none level=none format=text rate=50 \
             baud=115200",
        ),
        ("mount z-down", "ok mount +x+z; \"save\" keeps it"),
        ("rate 100", "ok text, 100 a second; \"save\" keeps it"),
        (
            "format classic",
            "ok classic, 100 a second; \"save\" keeps it",
        ),
        (
            "rate 1000",
            "error 1000 lines of classic a second are too many for 115200 baud: \"rate 213\" fits, or a higher baud rate",
        ),
        (
            "baud 9600",
            "error 9600 baud are too few for 100 lines of classic a second: \"rate 17\" first",
        ),
        ("baud 115200", "ok baud 115200: as before"),
        ("calibrate done", "error calibrate done: nothing goes on"),
        ("calibrate stop", "ok calibrate stop: nothing went on"),
        (
            "show",
            "ok show: mount=+x+z gyro=none temperature=none accel_offset=none level=none format=classic rate=100 \
             baud=115200",
        ),
        (
            "forget",
            "ok forget: nothing is calibrated, mount +x-z; \"save\" makes it permanent, a restart undoes it",
        ),
        ("arm", "ok arm"),
        ("disarm", "ok disarm"),
        (
            "stats",
            "error there is no command \"stats\", did you mean \"status\"?",
        ),
    ] {
        assert_eq!(desk.ask(line), answer, "{line}");
        assert_eq!(desk.poll(), None, "{line} has one answer");
    }
}

#[test]
fn save_writes_what_has_changed_and_nothing_else() {
    let mut desk = Desk::new();
    let nothing = "ok save: nothing has changed, nothing is written";
    assert_eq!(desk.ask("save"), nothing);
    desk.ask("mount z-down");
    desk.ask("mount z-up");
    desk.ask("forget");
    assert_eq!(desk.ask("save"), nothing, "back to what it was");
    desk.ask("rate 20");
    desk.calls();
    assert_eq!(desk.ask("save"), "ok save: the sensor stops for a second");
    let expected = Record {
        preferences: Preferences {
            rate_hz: 20,
            ..Preferences::default()
        },
        ..Record::default()
    };
    assert_eq!(desk.calls(), [Call::Begin(Task::Save(expected))]);
    // Whatever comes meanwhile waits.
    desk.say("status\n");
    assert_eq!(desk.wait(0.5), [""; 0]);
    desk.bench.outcome = Some(Outcome::new(false, "the flash refuses"));
    assert_eq!(
        desk.poll().as_deref(),
        Some("failed save: the flash refuses")
    );
    let status = desk.poll().expect("the line that waited");
    assert!(status.contains("unsaved=yes"), "{status}");
    desk.ask("save");
    desk.bench.outcome = Some(Outcome::new(true, "stored"));
    assert_eq!(desk.poll().as_deref(), Some("done save: stored"));
    assert_eq!(desk.console.stored(), &expected);
    assert_eq!(desk.ask("save"), nothing);
}

#[test]
fn what_is_stored_is_in_use_and_forgetting_it_keeps_the_baud_rate() {
    let mut desk = Desk::with(Some(full()));
    assert_eq!(desk.console.mount().name(), "-x-y");
    assert!(!desk.console.has_unsaved());
    desk.ask("forget");
    let baud = Preferences {
        baud: 921_600,
        ..Preferences::default()
    };
    assert_eq!(
        desk.working(),
        &Record {
            preferences: baud,
            ..Record::default()
        }
    );
    assert!(desk.console.has_unsaved());
    // Nonsense in flash is replaced.
    let nonsense = Preferences {
        rate_hz: 0,
        baud: 0,
        format: OutputFormat::Text,
    };
    let desk = Desk::with(Some(Record {
        preferences: nonsense,
        ..full()
    }));
    assert_eq!(
        desk.working().preferences,
        Preferences {
            rate_hz: 1,
            baud: 115_200,
            format: OutputFormat::Text
        }
    );
}

#[test]
fn armed_nothing_is_changed() {
    let mut desk = Desk::with(Some(full()));
    desk.ask("rate 500");
    desk.ask("calibrate accel");
    desk.calls();
    assert_eq!(desk.ask("arm"), "ok arm: \"calibrate accel\" is given up");
    assert_eq!(desk.calls(), [Call::StopRest, Call::Armed(true)]);
    let working = *desk.working();
    for line in [
        "save",
        "forget",
        "self-test",
        "rate 10",
        "baud 9600",
        "format text",
        "mount find",
        "mount z-up",
        "calibrate gyro",
        "calibrate accel",
        "calibrate level",
        "calibrate temperature",
        "calibrate done",
        "calibrate stop",
    ] {
        assert_eq!(
            desk.ask(line),
            "error refused while armed: \"disarm\" first",
            "{line}"
        );
    }
    for line in ["help", "status", "show", "arm"] {
        assert!(desk.ask(line).starts_with("ok "), "{line}");
    }
    assert_eq!(desk.calls(), [Call::Armed(true)]);
    assert_eq!(desk.working(), &working);
    desk.ask("disarm");
    assert!(desk.ask("rate 10").starts_with("ok "));
}

#[test]
fn one_thing_goes_on_at_a_time() {
    let mut desk = Desk::new();
    desk.ask("calibrate temperature");
    for line in [
        "calibrate gyro",
        "mount find",
        "mount z-up",
        "save",
        "forget",
        "self-test",
        "baud 9600",
    ] {
        let expected =
            "error refused while \"calibrate temperature\" goes on: \"calibrate stop\" ends it";
        assert_eq!(desk.ask(line), expected, "{line}");
    }
    assert!(desk.ask("rate 10").starts_with("ok "));
    assert_eq!(
        desk.ask("calibrate stop"),
        "ok calibrate stop: \"calibrate temperature\" is given up"
    );
    desk.bench.has_no_sensor = true;
    assert_eq!(
        desk.ask("calibrate gyro"),
        "error calibrate gyro: there is no sensor yet"
    );
}

#[test]
fn the_gyroscope_starts_over_when_it_moves_and_tells_no_more_than_once_a_second() {
    let mut desk = Desk::new();
    assert_eq!(
        desk.ask("calibrate gyro"),
        "ok calibrate gyro: keep it still for 4 s, in any pose"
    );
    assert_eq!(desk.calls(), [Call::StartRest(4000)]);
    assert_eq!(desk.wait(2.1), ["progress calibrate gyro: 40 %"; 2]);
    // Shaken for two seconds.
    for _ in 0..20 {
        desk.rests([MOVED]);
        for _ in 0..5 {
            let told = desk.poll();
            let expected = "progress calibrate gyro: waits for rest, it turned about x";
            assert!(told.is_none_or(|told| told == expected));
        }
    }
    desk.rests([at_rest([2.5, -0.25, 0.125], UP)]);
    assert_eq!(
        desk.wait(1.0),
        ["done calibrate gyro: offset 2.500,-0.250,0.125 deg/s at 31.0 C; \"save\" keeps it"]
    );
    let offset = desk
        .working()
        .calibration
        .gyroscope
        .expect("it is measured");
    assert!((offset.offset_rad_s.x - radians(2.5)).abs() < 1e-6);
    let calls = desk.calls();
    assert_eq!(
        calls,
        [
            Call::StopRest,
            Call::Calibration(desk.working().calibration)
        ]
    );
    assert!(desk.console.has_unsaved());
}

#[test]
fn six_poses_calibrate_the_accelerometer() {
    let mut desk = Desk::new();
    let offset = Vector3::new(0.03, -0.04, 0.07);
    let lay = |pose: Pose| at_rest([0.0; 3], pose.up() + offset);
    assert_eq!(
        desk.ask("calibrate accel"),
        "ok calibrate accel: lay it still for 2 s in each pose, the arrows of the sensor's axes as told; first: z up"
    );
    let mut told = Vec::new();
    for (index, pose) in Pose::GUIDE.into_iter().take(6).enumerate() {
        desk.rests([MOVED, MOVED, lay(pose)]);
        told.extend(desk.wait(0.1));
        if index == 1 {
            // Left where it is: not a word. Put back into a pose that there is: told.
            desk.rests([lay(pose), lay(pose), MOVED, lay(Pose::GUIDE[0])]);
            told.extend(desk.wait(0.1));
            assert_eq!(
                desk.ask("calibrate done"),
                "error calibrate accel: 2 of at least 6 poses"
            );
        }
    }
    assert_eq!(
        told,
        [
            "progress calibrate accel: pose 1 is z up, next: z down",
            "progress calibrate accel: pose 2 is z down, next: x up",
            "progress calibrate accel: this is pose 1 again: turn it to another side; next: x up",
            "progress calibrate accel: pose 3 is x up, next: x down",
            "progress calibrate accel: pose 4 is x down, next: y up",
            "progress calibrate accel: pose 5 is y up, next: y down",
            "progress calibrate accel: pose 6 is y down, all six sides are there; keep it still for 5 s more, \
             or go on with: x up and y up, halfway between",
        ]
    );
    desk.rests(vec![lay(Pose::GUIDE[5]); 4]);
    assert_eq!(desk.wait(0.2), [""; 0]);
    desk.rests([lay(Pose::GUIDE[5])]);
    let done = desk.wait(0.2);
    assert_eq!(done.len(), 1, "{done:?}");
    assert!(
        done[0].starts_with("done calibrate accel: 6 poses, offset and scale: residual ")
            && done[0].ends_with(" mg before, 0.00 mg after; \"save\" keeps it"),
        "{done:?}"
    );
    let correction = desk
        .working()
        .calibration
        .accelerometer
        .expect("it is fitted");
    assert!((correction.offset_m_s2 - offset.scale(9.80665)).norm() < 0.01);
    // Unless told otherwise, a rest is asked for again after each one.
    let starts = desk
        .calls()
        .iter()
        .filter(|call| **call == Call::StartRest(1000))
        .count();
    assert_eq!(starts, 1 + 6 + 3 + 4);
}

#[test]
fn level_is_measured_with_what_is_known_already() {
    let mut desk = Desk::new();
    assert_eq!(
        desk.ask("calibrate level"),
        "ok calibrate level: keep it still for 2 s with the vehicle level"
    );
    // The sensor sits 2 degrees right wing down: up is to its left, which is its +Y when it lies face up.
    let tilted = Vector3::new(0.0, radians(2.0).sin(), radians(2.0).cos());
    desk.rests([at_rest([0.0; 3], tilted)]);
    assert_eq!(
        desk.wait(0.1),
        ["done calibrate level: trim 2.00 deg of roll, 0.00 deg of pitch; \"save\" keeps it"]
    );
    assert!(desk.working().calibration.level.is_some());
    assert_eq!(
        desk.ask("mount +y-z"),
        "ok mount +y-z, its level is to be calibrated again; \"save\" keeps it"
    );
    assert_eq!(desk.working().calibration.level, None);
    desk.ask("calibrate level");
    desk.rests([at_rest([0.0; 3], Vector3::new(1.0, 0.0, 0.0))]);
    assert_eq!(
        desk.wait(0.1),
        ["failed calibrate level: it is 90 degrees from level, more than 15: is the mount right?"]
    );
    assert_eq!(desk.working().calibration.level, None);
}

#[test]
fn two_poses_find_the_mount() {
    let mut desk = Desk::new();
    assert_eq!(
        desk.ask("mount find"),
        "ok mount find: keep it still for 2 s with the vehicle level, then with its nose down"
    );
    let mount = Mount::parse("-y+z").expect("a name");
    let up_when = |body: Vector3| at_rest([0.0; 3], mount.to_sensor(body));
    let level = up_when(Vector3::new(0.0, 0.0, -1.0));
    let nose_down = up_when(Vector3::new(-1.0, 0.0, 0.0));
    desk.rests([level, level, MOVED, level, nose_down]);
    assert_eq!(
        desk.wait(0.2),
        [
            "progress mount find: level is known; now the nose down, as far as it goes",
            "progress mount find: the nose is 0 degrees from the level pose: point it straight down",
            "done mount find: mount -y+z; \"save\" keeps it",
        ]
    );
    assert_eq!(desk.working().calibration.mount, Some(mount));
}

#[test]
fn temperature_is_learned_until_it_is_enough() {
    let mut desk = Desk::new();
    desk.ask("calibrate temperature");
    desk.rests([at_rest([1.0, 0.0, 0.0], UP)]);
    assert_eq!(
        desk.wait(10.2),
        ["progress calibrate temperature: 1 temperatures from 31.0 to 31.0 C"]
    );
    let told = desk.ask("calibrate done");
    assert!(
        told.starts_with("error calibrate temperature: only 1 temperatures"),
        "{told}"
    );
    let status = desk.ask("status");
    assert!(
        status.ends_with("doing=\"calibrate temperature, 1 temperatures from 31.0 to 31.0 C\""),
        "{status}"
    );
    for step in 0..40_u8 {
        let RestProgress::Done(mut rest) = at_rest([1.0 + 0.02 * f32::from(step), 0.0, 0.0], UP)
        else {
            unreachable!();
        };
        rest.temperature_celsius = 31.0 + 0.5 * f32::from(step);
        desk.rests([RestProgress::Done(rest)]);
        desk.poll();
    }
    let done = desk.ask("calibrate done");
    assert_eq!(
        done,
        "done calibrate temperature: 20 temperatures from 31.0 to 50.5 C; \"save\" keeps it"
    );
    let model = desk
        .working()
        .calibration
        .temperature
        .expect("it is learned");
    let (offset, weight) = model.offset_at(41.0);
    assert!((offset.x - radians(1.4)).abs() < radians(0.02) && weight == 1.0);
}

#[test]
fn a_baud_rate_that_nobody_speaks_is_taken_back() {
    let mut desk = Desk::new();
    let told = desk.ask("baud 921600");
    assert_eq!(
        told,
        "ok baud 921600 from now on; say something at 921600 within 10 s, or it is 115200 again"
    );
    desk.bench.is_sending = true;
    desk.poll();
    assert_eq!(desk.calls(), [], "the answer goes out first");
    desk.bench.is_sending = false;
    desk.poll();
    assert_eq!(desk.calls(), [Call::Baud(921_600)]);
    // What is no command does not count.
    desk.say("\x00\x7e\x13\nhelo\n");
    assert_eq!(desk.wait(9.0).len(), 2);
    assert_eq!(
        desk.wait(1.2),
        ["failed baud: nothing was understood at 921600, it is 115200 again"]
    );
    assert_eq!(desk.calls(), [Call::Baud(115_200)]);
    assert!(!desk.console.has_unsaved());

    desk.ask("baud 921600");
    desk.poll();
    assert!(desk.ask("status").contains("unsaved=yes"), "it stays");
    assert_eq!(desk.wait(20.0), [""; 0]);
    assert_eq!(desk.calls(), [Call::Baud(921_600)]);
    assert_eq!(desk.working().preferences.baud, 921_600);
}

#[test]
fn noise_is_answered_once_a_second() {
    let mut desk = Desk::new();
    // Two seconds of lines that cannot be read, then two of wrong words.
    let mut answers = Vec::new();
    for _ in 0..100 {
        desk.say([0xFF, b'\n', 0x00, b'\n', b'x', 0x80, b'\n']);
        answers.extend(desk.poll());
    }
    assert!((1..=3).contains(&answers.len()), "{answers:?}");
    assert!(
        answers[0].ends_with(
            "dropped: too long, unreadable or too many wrong ones; is the baud rate right?"
        ),
        "{answers:?}"
    );
    answers.clear();
    for _ in 0..100 {
        desk.say("asdf\n");
        answers.extend(desk.poll());
    }
    let wrong = answers
        .iter()
        .filter(|answer| answer.contains("asdf"))
        .count();
    assert!(
        (6..=9).contains(&wrong) && answers.len() <= 12,
        "{answers:?}"
    );
    // Then it is heard at once.
    assert!(desk.ask("status").contains(" lines_dropped="));
}

#[test]
fn an_error_of_the_receiver_drops_the_line() {
    let mut desk = Desk::new();
    desk.ask("rate 20");
    desk.calls();
    desk.say("sa");
    desk.poll();
    desk.bench.has_error = true;
    desk.say("ve\n");
    let told = desk.wait(2.0);
    assert!(
        told.len() == 1 && told[0].starts_with("error 1 line dropped"),
        "{told:?}"
    );
    assert_eq!(desk.calls(), []);
}

#[test]
fn the_longest_answers_fit() {
    let mut desk = Desk::with(Some(full()));
    let show = desk.ask("show");
    assert!(
        show.ends_with(" format=classic rate=1000 baud=921600"),
        "{show}"
    );
    desk.ask("calibrate temperature");
    let long = Vector3::new(-39.99, -39.99, -39.99);
    let state = State {
        flags: Flags::from_bits(u32::MAX),
        sensor: Some((&Part::MPU_6050, 0x69)),
        temperature_celsius: -39.99,
        bias_rad_s: long,
        bias_sigma_rad_s: -39.99,
        tilt_sigma_rad: -39.99,
        bursts_failed: u16::MAX,
        reception_errors: u32::MAX,
        frames_dropped: u32::MAX,
    };
    desk.console.dropped = u32::MAX;
    let mut status = String::new();
    desk.console.status(&state, &mut Reply(&mut status));
    assert!(
        status.ends_with("doing=\"calibrate temperature, nothing seen yet\""),
        "{status}"
    );
    for line in [&show, &status] {
        assert!(line.len() + 60 <= answer::ANSWER_CAPACITY, "{}", line.len());
    }
}

/// What changes something, if it is said disarmed with nothing going on.
fn changes(command: Command) -> bool {
    use Command::{Arm, Calibrate as Measure, Disarm, Help, Save, Show, Status};
    !matches!(
        command,
        Help | Status | Show | Save | Arm | Disarm | Measure(Calibrate::Done | Calibrate::Stop)
    )
}

/// Pieces of commands, line ends and noise.
fn nearly_commands() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        4 => prop::sample::select(vec![
            "save", "sav", "forget", "rate ", "50", "mount ", "+x-z", "baud ", "9600", "calibrate ", "gyro", "format ",
            "text", "arm", "self-test", " ", "\x08",
        ]).prop_map(|text| text.as_bytes().to_vec()),
        3 => Just(b"\n".to_vec()),
        1 => Just(b"\r\n".to_vec()),
        1 => any::<u8>().prop_map(|byte| vec![byte]),
    ];
    prop::collection::vec(piece, 0..60).prop_map(|pieces| pieces.concat())
}

proptest! {
    /// Random bytes never change anything, stored or in use.
    #[test]
    fn random_bytes_change_nothing(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
        let mut desk = Desk::with(Some(full()));
        desk.say(&bytes);
        for _ in 0..40 {
            desk.poll();
        }
        prop_assert_eq!(desk.working(), &full());
        prop_assert_eq!(desk.calls(), []);
    }

    /// Nothing is stored that was not asked for by whole lines: one that changes something, then `save`. The oracle splits the text
    /// at its line ends and looks for those two.
    #[test]
    fn nothing_is_stored_but_by_a_change_and_save(bytes in nearly_commands()) {
        let mut desk = Desk::with(Some(full()));
        desk.say(&bytes);
        for _ in 0..80 {
            desk.poll();
        }
        let is_stored = desk.calls().iter().any(|call| matches!(call, Call::Begin(Task::Save(_))));
        let understood = |line: &[u8]| {
            // Backspace makes lines that a split does not see.
            let text = core::str::from_utf8(line).ok()?;
            if text.contains('\x08') { Some(None) } else { Some(command::parse(text).ok()) }
        };
        let mut has_changed = false;
        let mut may_store = false;
        for line in bytes.split(|byte| matches!(byte, b'\r' | b'\n')) {
            match understood(line) {
                Some(None) => has_changed = true,
                Some(Some(Command::Save)) => may_store |= has_changed,
                Some(Some(command)) => has_changed |= changes(command),
                None => {}
            }
            let has_backspace = line.contains(&0x08);
            may_store |= has_backspace && has_changed;
        }
        prop_assert!(may_store || !is_stored);
    }

    /// Answers stay within their budget, whatever comes.
    #[test]
    fn wrong_lines_are_not_answered_one_by_one(bytes in prop::collection::vec(prop_oneof![Just(b'\n'), any::<u8>()], 0..3000)) {
        let mut desk = Desk::new();
        let mut answers = 0;
        for chunk in bytes.chunks(100) {
            desk.say(chunk);
            answers += desk.wait(0.02).len();
        }
        // 0.6 s: four at once, one more after half a second, one for those that were dropped.
        prop_assert!(answers <= 7, "{}", answers);
    }
}
