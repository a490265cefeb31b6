//! The console with a fake module that records every request.

use std::collections::VecDeque;

use proptest::prelude::*;

use super::super::answer::ANSWER_CAPACITY;
use super::super::module::State;
use super::*;
use crate::attitude::{BodyVector, EulerAngles, Quaternion, Vector3};
use crate::calibration::accelerometer::Pose;
use crate::calibration::compass::CompassFitter;
use crate::calibration::{
    AccelerometerCorrection, Axis, Calibration, CompassCorrection, GyroscopeOffset, Matrix3,
    MotionReason, StationaryMean, StationaryProgress, SymmetricMatrix, TemperatureModel,
};
use crate::compass::{Choice, CompassStatus, PartId};
use crate::health::{CoreFigures, Flags, SampleFigures, WorkFigures};
use crate::mpu6050::Part;
use crate::pipeline::Settings;
use crate::settings::storage::LoadProblem;
use crate::settings::{CompassSettings, OutputFormat};
use crate::telemetry::heading::Line as HeadingLine;
use crate::units::{MagneticField, degrees, radians};

/// Request to the module.
#[derive(Debug, Clone, PartialEq)]
enum Call {
    Calibration(Calibration),
    Compass(CompassSettings, Mount),
    StartFitter,
    StopFitter,
    StartDetector(u16),
    StopDetector,
    Armed(bool),
    Measuring(bool),
    Baud(u32),
    Begin(Job),
}

#[derive(Default)]
struct FakeModule {
    received: VecDeque<u8>,
    has_error: bool,
    progress: VecDeque<StationaryProgress>,
    outcome: Option<Outcome>,
    is_sending: bool,
    has_no_sensor: bool,
    state: Option<State>,
    work: WorkFigures,
    fitter: Option<CompassFitter>,
    calls: Vec<Call>,
}

impl Module for FakeModule {
    fn receive(&mut self) -> Option<u8> {
        self.received.pop_front()
    }

    fn take_reception_error(&mut self) -> bool {
        core::mem::take(&mut self.has_error)
    }

    fn state(&mut self) -> State {
        if let Some(state) = self.state {
            return state;
        }
        State {
            flags: Flags::VALID | Flags::MISSED,
            sensor: (!self.has_no_sensor).then_some((&Part::MPU_6050, 0x68)),
            temperature_celsius: 31.25,
            bias_rad_s: Vector3::new(radians(0.5), radians(-1.0), 0.0),
            bias_sigma_rad_s: radians(0.05),
            tilt_sigma_rad: radians(0.4),
            times_missed: 3,
            times_refused: 2,
            ..State::default()
        }
    }

    fn set_calibration(&mut self, calibration: &Calibration) {
        self.calls.push(Call::Calibration(*calibration));
    }

    fn set_compass(&mut self, settings: &CompassSettings, imu_mount: Mount) {
        self.calls.push(Call::Compass(*settings, imu_mount));
    }

    fn start_compass_fitter(&mut self) {
        self.calls.push(Call::StartFitter);
        self.fitter = Some(CompassFitter::new());
    }

    fn stop_compass_fitter(&mut self) {
        self.calls.push(Call::StopFitter);
        self.fitter = None;
    }

    fn compass_fitter(&mut self) -> Option<CompassFitter> {
        self.fitter
    }

    fn start_detector(&mut self, samples: u16) {
        self.calls.push(Call::StartDetector(samples));
    }

    fn stop_detector(&mut self) {
        self.calls.push(Call::StopDetector);
    }

    fn take_detector_progress(&mut self) -> Option<StationaryProgress> {
        self.progress.pop_front()
    }

    fn detector_percent(&mut self) -> u8 {
        40
    }

    fn set_measuring(&mut self, is_on: bool) {
        self.calls.push(Call::Measuring(is_on));
    }

    fn work_figures(&mut self) -> WorkFigures {
        self.work
    }

    fn set_armed(&mut self, is_armed: bool) {
        self.calls.push(Call::Armed(is_armed));
    }

    fn set_baud(&mut self, baud: u32) -> bool {
        if !self.is_sending {
            self.received.clear();
            self.calls.push(Call::Baud(baud));
        }
        !self.is_sending
    }

    fn begin(&mut self, job: Job) {
        self.calls.push(Call::Begin(job));
    }

    fn take_outcome(&mut self) -> Option<Outcome> {
        self.outcome.take()
    }
}

struct Harness {
    console: Console,
    module: FakeModule,
    now_us: u32,
}

fn noise_model() -> NoiseModel {
    Settings::new(&Part::MPU_6050).noise_model()
}

impl Harness {
    fn new() -> Self {
        Self::with(None)
    }

    fn with(stored: Option<Record>) -> Self {
        Self::with_compass(stored, Choice::Auto)
    }

    /// Of a build with this default of the compass.
    fn with_compass(stored: Option<Record>, choice: Choice) -> Self {
        let loaded = Loaded {
            record: stored,
            problem: None,
        };
        Self::with_loaded(loaded, choice)
    }

    fn with_loaded(loaded: Loaded, choice: Choice) -> Self {
        let noise = noise_model();
        Self {
            console: Console::new(loaded, noise, 1000.0, Mount::Z_UP, choice, false),
            module: FakeModule::default(),
            // The clock wraps soon.
            now_us: u32::MAX - 3_000_000,
        }
    }

    /// One poll, 20 ms after the one before.
    fn poll(&mut self) -> Option<String> {
        self.now_us = self.now_us.wrapping_add(20_000);
        let mut answer = String::new();
        let kind = self
            .console
            .poll(self.now_us, &mut self.module, &mut answer);
        assert_eq!(kind.is_some(), !answer.is_empty(), "{answer}");
        assert!(
            kind.is_none_or(|kind| answer.starts_with(kind.name())),
            "{answer}"
        );
        kind.map(|_| answer)
    }

    /// All answers within this many seconds.
    fn wait(&mut self, seconds: f32) -> Vec<String> {
        let polls = (seconds * 50.0) as u32;
        (0..polls).filter_map(|_| self.poll()).collect()
    }

    fn receive(&mut self, bytes: impl AsRef<[u8]>) {
        self.module.received.extend(bytes.as_ref());
    }

    /// The answer to a line, at the next poll.
    fn ask(&mut self, line: &str) -> String {
        self.receive(format!("{line}\n"));
        self.poll()
            .unwrap_or_else(|| panic!("`{line}` has no answer"))
    }

    fn calls(&mut self) -> Vec<Call> {
        core::mem::take(&mut self.module.calls)
    }

    fn detector(&mut self, progress: impl IntoIterator<Item = StationaryProgress>) {
        self.module.progress.extend(progress);
    }

    fn working(&self) -> &Record {
        self.console.working()
    }
}

fn at_rest(gyroscope_degrees_s: [f32; 3], accelerometer_g: Vector3) -> StationaryProgress {
    let noise = noise_model();
    let [x, y, z] = gyroscope_degrees_s.map(|rate| rate * noise.counts_per_degree_s);
    StationaryProgress::Done(StationaryMean {
        gyroscope_counts: Vector3::new(x, y, z),
        accelerometer_counts: accelerometer_g.scale(noise.counts_per_g),
        gyroscope_sigma_counts: Vector3::new(1.0, 1.0, 1.0),
        temperature_celsius: 31.0,
        samples: 1000,
        ..StationaryMean::default()
    })
}

const UP: Vector3 = Vector3::new(0.0, 0.0, 1.0);
const MOVED: StationaryProgress = StationaryProgress::Moved(MotionReason::Rotation(Axis::X));

/// A record with every calibration and the longest numbers.
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
                matrix: SymmetricMatrix {
                    xy: -0.1,
                    xz: -0.1,
                    yz: -0.1,
                    ..SymmetricMatrix::IDENTITY
                },
            }),
            level: Some(Quaternion::from_rotation_vector(Vector3::new(
                radians(-14.9),
                0.0,
                0.0,
            ))),
            gyroscope_matrix: Some(Matrix3 { rows: [long; 3] }),
        },
        preferences: Preferences {
            format: OutputFormat::Classic,
            rate_hz: 1000,
            baud: 921_600,
        },
        compass: CompassSettings {
            choice: Choice::Named(PartId::Qmc5883l),
            mount: Mount::parse("-x-y"),
            correction: Some(CompassCorrection {
                hard_iron_ut: Vector3::new(-1234.5, -1234.5, -1234.5),
                matrix: [Vector3::new(-1.2345, -1.2345, -1.2345); 3],
            }),
            declination_rad: radians(-180.0),
        },
    }
}

#[test]
fn a_record_from_before_a_reset_continues_unsaved() {
    let mut harness = Harness::new();
    harness.console.continue_with(full());
    assert!(harness.console.has_unsaved());
    assert_eq!(harness.console.working().calibration, full().calibration);
    harness.ask("save");
    harness.module.outcome = Some(Outcome::new(true, &"stored"));
    assert_eq!(harness.wait(0.1), ["done save: stored"]);
    assert!(!harness.console.has_unsaved());
}

#[test]
fn every_command_is_answered_with_one_line() {
    let mut harness = Harness::new();
    for (line, answer) in [
        (
            "help",
            "ok help: help, status, show, \
             calibrate gyro|accel|level|temperature|compass|keep|done|stop, \
             gyro-matrix <nine numbers>, \
             mount find|<forward><down>, \
             compass auto|off|ak8963|qmc5883l|qmc5883p|hmc5883l|keep|<forward><down>, \
             declination <degrees>, self-test, registers, measure on|show|off, rate <hz>, format \
             text|classic|teleplot|teapot|mavlink|log, baud <bps>, save, forget, arm, disarm",
        ),
        (
            "status",
            "ok status: flags=MISSED|VALID sensor=MPU-6050@0x68 mount=+x-z(default) \
             calibrated=none bias_dps=0.500,-1.000,0.000 \
             bias_sigma_dps=0.050 tilt_sigma_deg=0.40 temperature_c=31.3 armed=no unsaved=no \
             bursts_failed=0 missed=3 refused=2 \
             uart_errors=0 lines_dropped=0 frames_dropped=0",
        ),
        (
            "show",
            "ok show: mount=default gyro=none temperature=none accel_offset=none level=none \
             format=text rate=50 \
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
            "error 1000 lines of classic a second are too many for 115200 baud: \"rate 213\" \
             fits, or a higher baud rate",
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
            "ok show: mount=+x+z gyro=none temperature=none accel_offset=none level=none \
             format=classic rate=100 \
             baud=115200",
        ),
        (
            "forget",
            "ok forget: nothing is calibrated, mount +x-z; \"save\" makes it permanent, a restart \
             undoes it",
        ),
        ("arm", "ok arm"),
        ("disarm", "ok disarm"),
        (
            "stats",
            "error there is no command \"stats\", did you mean \"status\"?",
        ),
    ] {
        assert_eq!(harness.ask(line), answer, "{line}");
        assert_eq!(harness.poll(), None, "{line} has one answer");
    }
}

#[test]
fn save_writes_what_has_changed_and_nothing_else() {
    let mut harness = Harness::new();
    let nothing = "ok save: nothing has changed, nothing is written";
    assert_eq!(harness.ask("save"), nothing);
    harness.ask("mount z-down");
    harness.ask("mount z-up");
    harness.ask("forget");
    assert_eq!(harness.ask("save"), nothing, "back to what it was");
    harness.ask("rate 20");
    harness.calls();
    assert_eq!(
        harness.ask("save"),
        "ok save: the sensor stops for a second"
    );
    let expected = Record {
        preferences: Preferences {
            rate_hz: 20,
            ..Preferences::default()
        },
        ..Record::default()
    };
    assert_eq!(harness.calls(), [Call::Begin(Job::Save)]);
    assert_eq!(*harness.working(), expected);
    // Other input waits meanwhile.
    harness.receive("status\n");
    assert_eq!(harness.wait(0.5), [""; 0]);
    harness.module.outcome = Some(Outcome::new(false, &"the flash refuses"));
    assert_eq!(
        harness.poll().as_deref(),
        Some("failed save: the flash refuses")
    );
    let status = harness.poll().expect("the line that waited");
    assert!(status.contains("unsaved=yes"), "{status}");
    harness.ask("save");
    harness.module.outcome = Some(Outcome::new(true, &"stored"));
    assert_eq!(harness.poll().as_deref(), Some("done save: stored"));
    assert_eq!(harness.console.stored(), &expected);
    assert_eq!(harness.ask("save"), nothing);
}

/// A damaged or newer record in flash lasts until something is written there.
#[test]
fn save_writes_an_unchanged_record_after_a_problem_at_start() {
    for (record, problem) in [
        (Some(full()), LoadProblem::Damaged),
        (Some(full()), LoadProblem::NewerFormat { version: 9 }),
        (None, LoadProblem::BothDamaged),
    ] {
        let problem = Some(problem);
        let mut harness = Harness::with_loaded(Loaded { record, problem }, Choice::Auto);
        for (is_ok, unsaved) in [(false, "unsaved=yes"), (true, "unsaved=no")] {
            assert_eq!(
                harness.ask("save"),
                "ok save: the sensor stops for a second"
            );
            assert_eq!(harness.calls(), [Call::Begin(Job::Save)]);
            harness.module.outcome = Some(Outcome::new(is_ok, &"it ended"));
            harness.poll();
            let status = harness.ask("status");
            assert!(status.contains(unsaved), "{problem:?}: {status}");
        }
        let nothing = "ok save: nothing has changed, nothing is written";
        assert_eq!(harness.ask("save"), nothing);
    }
}

/// A byte of noise does not cost the command that is typed a second later. Half a command is none,
/// whatever the pause, if a character of its first half is left.
#[test]
fn noise_is_forgotten_after_a_pause_and_half_a_line_is_not() {
    let mut harness = Harness::new();
    let answer = "ok help: ";
    for noise in [&b"\xFD"[..], b"\xFE\xFF\x00", b"help\n\xFD", b"\xFF\n\xFD"] {
        harness.receive(noise);
        harness.wait(1.1);
        assert!(harness.ask("help").starts_with(answer), "{noise:?}");
    }
    harness.module.has_error = true;
    harness.wait(1.1);
    assert!(
        harness.ask("help").starts_with(answer),
        "an error of the port"
    );
    for (start, pause_s) in [("\u{FD}", 0.9), ("dis\u{FD}", 5.0), ("\u{FD}dis", 5.0)] {
        harness.receive(start);
        harness.wait(pause_s);
        harness.receive("arm\n");
        harness.wait(0.1);
        assert!(!harness.console.is_armed(), "{start:?}, {pause_s} s");
        harness.wait(2.0);
    }
    harness.receive("dis");
    harness.poll();
    harness.module.has_error = true;
    harness.wait(5.0);
    harness.receive("arm\n");
    harness.wait(0.1);
    assert!(!harness.console.is_armed());
}

#[test]
fn forget_returns_to_the_compass_of_the_build() {
    for choice in [Choice::Off, Choice::Named(PartId::Hmc5883l)] {
        let fresh = Harness::with_compass(None, choice);
        assert_eq!(fresh.working(), &Record::with_compass(choice));
        assert!(!fresh.console.has_unsaved());
        let mut harness = Harness::with_compass(Some(full()), choice);
        assert_eq!(harness.working(), &full());
        harness.ask("forget");
        assert_eq!(harness.working().compass, CompassSettings::new(choice));
        let call = Call::Compass(CompassSettings::new(choice), Mount::Z_UP);
        assert!(harness.calls().contains(&call));
    }
}

#[test]
fn other_commands_wait_for_a_job_and_for_a_change_of_the_baud_rate() {
    let mut harness = Harness::new();
    assert!(!harness.console.is_busy());
    harness.ask("self-test");
    harness.poll();
    assert!(harness.console.is_busy());
    harness.module.outcome = Some(Outcome::new(true, &"passed"));
    harness.poll();
    assert!(!harness.console.is_busy());
    harness.ask("baud 921600");
    assert!(harness.console.is_busy(), "the answer goes out first");
    harness.poll();
    assert!(!harness.console.is_busy(), "a command confirms the rate");
    // The answer goes out at the new rate.
    harness.wait(9.9);
    harness.module.is_sending = true;
    harness.wait(0.2);
    assert!(harness.console.is_busy());
    harness.module.is_sending = false;
    harness.poll().expect("the old rate returns");
    assert!(!harness.console.is_busy());
}

#[test]
fn the_stored_record_is_in_use_and_forget_keeps_the_baud_rate() {
    let mut harness = Harness::with(Some(full()));
    assert_eq!(harness.console.mount().name(), "-x-y");
    assert!(!harness.console.has_unsaved());
    harness.ask("forget");
    let baud = Preferences {
        baud: 921_600,
        ..Preferences::default()
    };
    assert_eq!(
        harness.working(),
        &Record {
            preferences: baud,
            ..Record::default()
        }
    );
    assert!(harness.console.has_unsaved());
    // Impossible preferences in flash are replaced.
    let nonsense = Preferences {
        rate_hz: 0,
        baud: 0,
        format: OutputFormat::Text,
    };
    let harness = Harness::with(Some(Record {
        preferences: nonsense,
        ..full()
    }));
    assert_eq!(
        harness.working().preferences,
        Preferences {
            rate_hz: 1,
            baud: 115_200,
            format: OutputFormat::Text
        }
    );
}

#[test]
fn commands_change_nothing_while_armed() {
    let mut harness = Harness::with(Some(full()));
    harness.ask("rate 500");
    harness.ask("calibrate accel");
    harness.calls();
    assert_eq!(
        harness.ask("arm"),
        "ok arm: \"calibrate accel\" is given up"
    );
    assert_eq!(harness.calls(), [Call::StopDetector, Call::Armed(true)]);
    let working = *harness.working();
    for line in [
        "save",
        "forget",
        "self-test",
        "rate 10",
        "baud 9600",
        "format text",
        "mount find",
        "mount z-up",
        "compass keep",
        "calibrate keep",
        "calibrate gyro",
        "calibrate accel",
        "calibrate level",
        "calibrate temperature",
        "calibrate done",
        "calibrate stop",
        "measure on",
    ] {
        assert_eq!(
            harness.ask(line),
            "error refused while armed: \"disarm\" first",
            "{line}"
        );
    }
    for line in ["help", "status", "show", "measure show", "arm"] {
        assert!(harness.ask(line).starts_with("ok "), "{line}");
    }
    assert_eq!(harness.calls(), [Call::Armed(true)]);
    assert_eq!(harness.working(), &working);
    harness.ask("disarm");
    assert!(harness.ask("rate 10").starts_with("ok "));
}

#[test]
fn one_procedure_runs_at_a_time() {
    let mut harness = Harness::new();
    harness.ask("calibrate temperature");
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
        assert_eq!(harness.ask(line), expected, "{line}");
    }
    assert!(harness.ask("rate 10").starts_with("ok "));
    assert_eq!(
        harness.ask("calibrate stop"),
        "ok calibrate stop: \"calibrate temperature\" is given up"
    );
    harness.module.has_no_sensor = true;
    assert_eq!(
        harness.ask("calibrate gyro"),
        "error calibrate gyro: there is no sensor yet"
    );
}

#[test]
fn motion_restarts_the_gyroscope_and_is_reported_once_a_second() {
    let mut harness = Harness::new();
    assert_eq!(
        harness.ask("calibrate gyro"),
        "ok calibrate gyro: keep it still for 4 s, in any pose"
    );
    assert_eq!(harness.calls(), [Call::StartDetector(4000)]);
    assert_eq!(harness.wait(2.1), ["progress calibrate gyro: 40 %"; 2]);
    // Shaken for two seconds.
    for _ in 0..20 {
        harness.detector([MOVED]);
        for _ in 0..5 {
            let answer = harness.poll();
            let expected = "progress calibrate gyro: waits for rest, it turned about x";
            assert!(answer.is_none_or(|answer| answer == expected));
        }
    }
    harness.detector([at_rest([2.5, -0.25, 0.125], UP)]);
    assert_eq!(
        harness.wait(1.0),
        ["done calibrate gyro: offset 2.500,-0.250,0.125 deg/s at 31.0 C; \"save\" keeps it"]
    );
    let offset = harness
        .working()
        .calibration
        .gyroscope
        .expect("it is measured");
    assert!((offset.offset_rad_s.x - radians(2.5)).abs() < 1e-6);
    let calls = harness.calls();
    assert_eq!(
        calls,
        [
            Call::StopDetector,
            Call::Calibration(harness.working().calibration)
        ]
    );
    assert!(harness.console.has_unsaved());
}

#[test]
fn a_procedure_reports_a_sensor_without_data_and_goes_on_after_it() {
    for (command, period_s) in [
        ("calibrate gyro", 1.0),
        ("calibrate accel", 5.0),
        ("calibrate level", 1.0),
        ("calibrate temperature", 10.0),
        ("mount find", 5.0),
    ] {
        for flag in [Flags::STALE, Flags::FROZEN, Flags::REJECTED] {
            let mut harness = Harness::new();
            let good = harness.module.state();
            assert!(harness.ask(command).starts_with("ok"), "{command}");
            // It moved before: what counts is that nothing comes now.
            harness.detector([MOVED]);
            harness.module.state = Some(State {
                flags: flag | Flags::DEGRADED,
                ..good
            });
            let expected = format!("progress {command}: no data: check the sensor's wires");
            let answers = harness.wait(2.0 * period_s + 0.1);
            assert_eq!(answers, [expected.clone(), expected.clone()], "{flag}");
            harness.module.state = Some(good);
            let answers = harness.wait(2.0 * period_s);
            assert!(!answers.contains(&expected), "{answers:?}");
            let stopped = format!("ok calibrate stop: \"{command}\" is given up");
            assert_eq!(harness.ask("calibrate stop"), stopped);
        }
    }
}

#[test]
fn a_gyroscope_matrix_is_set_shown_and_kept() {
    let mut harness = Harness::new();
    assert_eq!(
        harness.ask("gyro-matrix -277,-150,80,118,257,-184,-92,160,-196"),
        "ok gyro-matrix: the filter starts again if it is new; \"save\" keeps it"
    );
    let calibration = harness.working().calibration;
    let [x, _, z] = calibration.gyroscope_matrix.expect("it is set").rows;
    assert!((x - Vector3::new(0.9723, -0.015, 0.008)).is_within(1e-6));
    assert!((z - Vector3::new(-0.0092, 0.016, 0.9804)).is_within(1e-6));
    assert_eq!(harness.calls(), [Call::Calibration(calibration)]);
    assert!(harness.console.has_unsaved());
    let status = harness.ask("status");
    assert!(status.contains(" calibrated=gyro-scale "), "{status}");
    let shown = harness.ask("show");
    assert!(
        shown.contains(
            " gyro_matrix=0.9723,-0.0150,0.0080,0.0118,1.0257,-0.0184,-0.0092,0.0160,0.9804 "
        ),
        "{shown}"
    );
    harness.ask("gyro-matrix 0,0,0,0,0,0,0,0,0");
    assert_eq!(harness.working().calibration.gyroscope_matrix, None);
    let status = harness.ask("status");
    assert!(status.contains(" calibrated=none "), "{status}");
    harness.ask("arm");
    assert_eq!(
        harness.ask("gyro-matrix 0,0,0,0,0,0,0,0,0"),
        "error refused while armed: \"disarm\" first"
    );
}

#[test]
fn six_poses_calibrate_the_accelerometer() {
    let mut harness = Harness::new();
    let offset = Vector3::new(0.03, -0.04, 0.07);
    let lay = |pose: Pose| at_rest([0.0; 3], pose.up() + offset);
    assert_eq!(
        harness.ask("calibrate accel"),
        "ok calibrate accel: lay it still for 2 s in each pose, the arrows of the sensor's axes \
         as told; first: z up"
    );
    let mut answer = Vec::new();
    for (index, pose) in Pose::GUIDE.into_iter().take(6).enumerate() {
        harness.detector([MOVED, MOVED, lay(pose)]);
        answer.extend(harness.wait(0.1));
        if index == 1 {
            // Left in place: no answer. Put back into a known pose: an answer.
            harness.detector([lay(pose), lay(pose), MOVED, lay(Pose::GUIDE[0])]);
            answer.extend(harness.wait(0.1));
            assert_eq!(
                harness.ask("calibrate done"),
                "error calibrate accel: 2 of at least 6 poses"
            );
        }
    }
    assert_eq!(
        answer,
        [
            "progress calibrate accel: pose 1 is z up, next: z down",
            "progress calibrate accel: pose 2 is z down, next: x up",
            "progress calibrate accel: this is pose 1 again: turn it to another side; next: x up",
            "progress calibrate accel: pose 3 is x up, next: x down",
            "progress calibrate accel: pose 4 is x down, next: y up",
            "progress calibrate accel: pose 5 is y up, next: y down",
            "progress calibrate accel: pose 6 is y down, all six sides are there; keep it still \
             for 5 s more, \
             or go on with: x up and y up, halfway between",
        ]
    );
    harness.detector(vec![lay(Pose::GUIDE[5]); 4]);
    assert_eq!(harness.wait(0.2), [""; 0]);
    harness.detector([lay(Pose::GUIDE[5])]);
    let done = harness.wait(0.2);
    assert_eq!(done.len(), 1, "{done:?}");
    assert!(
        done[0].starts_with("done calibrate accel: 6 poses, offset and scale: residual ")
            && done[0].ends_with(" mg before, 0.00 mg after; \"save\" keeps it"),
        "{done:?}"
    );
    let correction = harness
        .working()
        .calibration
        .accelerometer
        .expect("it is fitted");
    assert!((correction.offset_m_s2 - offset.scale(9.80665)).norm() < 0.01);
    // The detector restarts after each mean.
    let starts = harness
        .calls()
        .iter()
        .filter(|call| **call == Call::StartDetector(1000))
        .count();
    assert_eq!(starts, 1 + 6 + 3 + 4);
}

#[test]
fn poses_without_a_fit_end_in_a_failure() {
    let mut harness = Harness::new();
    harness.ask("calibrate accel");
    // The x axis reads 15 % too much, which no part does.
    let lay = |pose: Pose| {
        let up = pose.up();
        at_rest([0.0; 3], Vector3::new(1.15 * up.x, up.y, up.z))
    };
    for pose in Pose::GUIDE.into_iter().take(6) {
        harness.detector([MOVED, lay(pose)]);
        harness.wait(0.1);
    }
    harness.detector(vec![lay(Pose::GUIDE[5]); 5]);
    let answers = harness.wait(0.5);
    assert_eq!(answers.len(), 1, "{answers:?}");
    assert!(
        answers[0].starts_with("failed calibrate accel: "),
        "{answers:?}"
    );
    assert_eq!(
        harness.ask("calibrate stop"),
        "ok calibrate stop: nothing went on"
    );
    assert_eq!(harness.working().calibration.accelerometer, None);
}

#[test]
fn level_is_measured_with_the_calibration_in_use() {
    let mut harness = Harness::new();
    assert_eq!(
        harness.ask("calibrate level"),
        "ok calibrate level: keep it still for 2 s with the vehicle level"
    );
    // The sensor sits 2 degrees right wing down: up is to its left, which is its +Y when it lies
    // face up.
    let tilted = Vector3::new(0.0, radians(2.0).sin(), radians(2.0).cos());
    harness.detector([at_rest([0.0; 3], tilted)]);
    assert_eq!(
        harness.wait(0.1),
        ["done calibrate level: trim 2.00 deg of roll, 0.00 deg of pitch; \"save\" keeps it"]
    );
    assert!(harness.working().calibration.level.is_some());
    assert_eq!(
        harness.ask("mount +y-z"),
        "ok mount +y-z, its level is to be calibrated again; \"save\" keeps it"
    );
    assert_eq!(harness.working().calibration.level, None);
    harness.ask("calibrate level");
    harness.detector([at_rest([0.0; 3], Vector3::new(1.0, 0.0, 0.0))]);
    assert_eq!(
        harness.wait(0.1),
        ["failed calibrate level: it is 90 degrees from level, more than 15: is the mount right?"]
    );
    assert_eq!(harness.working().calibration.level, None);
}

/// A level trim that was found without the accelerometer's correction has hidden its offset. The
/// pose that was level stays level, and a correction of the compass turns with the body axes.
#[test]
fn a_calibrated_accelerometer_leaves_the_level() {
    let mut harness = Harness::new();
    let offset = Vector3::new(0.06, -0.05, 0.02);
    let lay = |pose: Pose| at_rest([0.0; 3], pose.up() + offset);
    harness.ask("calibrate level");
    harness.detector([lay(Pose::GUIDE[0])]);
    harness.wait(0.1);
    let angles = |harness: &Harness| {
        let level = harness.working().calibration.level.expect("a level");
        let angles = level.to_euler();
        [degrees(angles.roll_rad), degrees(angles.pitch_rad)]
    };
    let [roll, pitch] = angles(&harness);
    assert!(roll.abs() > 2.5 && pitch.abs() > 3.0, "{roll} {pitch}");
    // The mount in use is kept with it: another build may have another default.
    assert_eq!(harness.working().calibration.mount, Some(Mount::Z_UP));
    harness.console.working.compass.correction = Some(CompassCorrection {
        matrix: [
            Vector3::new(1.1, 0.02, 0.0),
            Vector3::new(0.0, 0.9, 0.03),
            Vector3::new(0.01, 0.0, 1.0),
        ],
        hard_iron_ut: Vector3::new(30.0, -20.0, 10.0),
    });
    let field = |harness: &Harness| {
        let working = harness.working();
        let level = working.calibration.level.expect("a level");
        let correction = working.compass.correction.expect("a correction");
        let mounted = |field| level.conjugate().rotate(field);
        mounted(correction.apply(Vector3::new(15.0, 25.0, 40.0)))
    };
    let before = field(&harness);
    harness.ask("calibrate accel");
    for pose in Pose::GUIDE.into_iter().take(6) {
        harness.detector([MOVED, MOVED, lay(pose)]);
        harness.wait(0.1);
    }
    assert!(
        harness
            .ask("calibrate done")
            .starts_with("done calibrate accel: ")
    );
    let [roll, pitch] = angles(&harness);
    assert!(roll.abs() < 0.1 && pitch.abs() < 0.1, "{roll} {pitch}");
    let after = field(&harness);
    assert!((after - before).norm() < 0.01, "{before:?} {after:?}");
    let last = harness.calls().pop().expect("calls");
    assert!(matches!(last, Call::Compass(_, Mount::Z_UP)), "{last:?}");
}

#[test]
fn two_poses_find_the_mount() {
    let mut harness = Harness::new();
    assert_eq!(
        harness.ask("mount find"),
        "ok mount find: keep it still for 2 s with the vehicle level, then with its nose down"
    );
    harness.console.working.compass.correction = Some(CompassCorrection::NONE);
    let mount = Mount::parse("-y+z").expect("a name");
    let up_when = |body: Vector3| at_rest([0.0; 3], mount.to_sensor(BodyVector(body)));
    let level = up_when(Vector3::new(0.0, 0.0, -1.0));
    let nose_down = up_when(Vector3::new(-1.0, 0.0, 0.0));
    harness.detector([level, level, MOVED, level, nose_down]);
    assert_eq!(
        harness.wait(0.2),
        [
            "progress mount find: level is known; now the nose down, as far as it goes",
            "progress mount find: the nose is 0 degrees from the level pose: point it straight \
             down",
            "done mount find: mount -y+z, a level or a compass is to be calibrated again; \"save\" \
             keeps it",
        ]
    );
    assert_eq!(harness.working().calibration.mount, Some(mount));
    assert_eq!(harness.working().compass.correction, None);
}

#[test]
fn temperature_is_learned_until_the_data_are_enough() {
    let mut harness = Harness::new();
    harness.ask("calibrate temperature");
    harness.detector([at_rest([1.0, 0.0, 0.0], UP)]);
    assert_eq!(
        harness.wait(10.2),
        ["progress calibrate temperature: 1 temperatures from 31.0 to 31.0 C"]
    );
    let answer = harness.ask("calibrate done");
    assert!(
        answer.starts_with("error calibrate temperature: only 1 temperatures"),
        "{answer}"
    );
    let status = harness.ask("status");
    assert!(
        status.ends_with("doing=\"calibrate temperature, 1 temperatures from 31.0 to 31.0 C\""),
        "{status}"
    );
    warm_up(&mut harness, 31.0, 40);
    let done = harness.ask("calibrate done");
    assert_eq!(
        done,
        "done calibrate temperature: 20 temperatures from 31.0 to 50.5 C; \"save\" keeps it"
    );
    let model = harness
        .working()
        .calibration
        .temperature
        .expect("it is learned");
    let (offset, weight) = model.offset_at(41.0);
    assert!((offset.x - radians(1.4)).abs() < radians(0.02) && weight == 1.0);
    // A second warm-up over a part of the range keeps the rest of it.
    harness.ask("calibrate temperature");
    warm_up(&mut harness, 36.0, 20);
    let done = harness.ask("calibrate done");
    assert_eq!(
        done,
        "done calibrate temperature: 12 temperatures from 31.0 to 50.5 C; \"save\" keeps it"
    );
    let again = harness.working().calibration.temperature.expect("a model");
    for celsius in [31.0, 41.0, 50.5] {
        let change = again.offset_at(celsius).0 - model.offset_at(celsius).0;
        assert!(change.norm() < radians(0.02), "{celsius}: {change:?}");
    }
    // Without enough measurements the model stays, and the procedure goes on.
    harness.ask("calibrate temperature");
    warm_up(&mut harness, 36.0, 1);
    for _ in 0..2 {
        let refused = harness.ask("calibrate done");
        assert!(
            refused.starts_with("error calibrate temperature: only 1 temperatures"),
            "{refused}"
        );
    }
    assert_eq!(harness.working().calibration.temperature, Some(again));
}

/// Reports rests while the die warms up from this temperature by half a degree each.
fn warm_up(harness: &mut Harness, from_celsius: f32, rests: u8) {
    for step in 0..rests {
        let celsius = from_celsius + 0.5 * f32::from(step);
        let StationaryProgress::Done(mut rest) =
            at_rest([1.0 + 0.04 * (celsius - 31.0), 0.0, 0.0], UP)
        else {
            unreachable!();
        };
        rest.temperature_celsius = celsius;
        harness.detector([StationaryProgress::Done(rest)]);
        harness.poll();
    }
}

#[test]
fn the_flight_log_is_refused_at_a_rate_that_loses_attitudes() {
    let mut harness = Harness::new();
    harness.console.working.preferences.baud = 921_600;
    harness.ask("rate 251");
    assert_eq!(
        harness.ask("format log"),
        "error 251 lines of log a second are too many for 921600 baud: \"rate 250\" fits"
    );
    harness.ask("rate 250");
    assert_eq!(
        harness.ask("format log"),
        "ok log, 250 a second; \"save\" keeps it"
    );
}

#[test]
fn a_baud_rate_without_a_command_is_reverted() {
    let mut harness = Harness::new();
    let answer = harness.ask("baud 921600");
    assert_eq!(
        answer,
        "ok baud 921600 from now on; say something at 921600 within 10 s, or it is 115200 again"
    );
    harness.module.is_sending = true;
    harness.poll();
    assert_eq!(harness.calls(), [], "the answer goes out first");
    harness.module.is_sending = false;
    harness.poll();
    assert_eq!(harness.calls(), [Call::Baud(921_600)]);
    // A line that is no command does not count.
    harness.receive("\x00\x7e\x13\nhelo\n");
    assert_eq!(harness.wait(9.0).len(), 2);
    assert_eq!(
        harness.wait(1.2),
        ["failed baud: nothing was understood at 921600, it is 115200 again"]
    );
    assert_eq!(harness.calls(), [Call::Baud(115_200)]);
    assert!(!harness.console.has_unsaved());

    harness.ask("baud 921600");
    harness.poll();
    assert!(harness.ask("status").contains("unsaved=yes"), "it stays");
    assert_eq!(harness.wait(20.0), [""; 0]);
    assert_eq!(harness.calls(), [Call::Baud(921_600)]);
    assert_eq!(harness.working().preferences.baud, 921_600);
}

#[test]
fn a_command_before_the_change_does_not_confirm_a_baud_rate() {
    let mut harness = Harness::new();
    harness.receive("rate 30\nbaud 921600\nrate 20\nsave\nrate");
    assert_eq!(harness.wait(1.0).len(), 2);
    harness.receive(" 40\n");
    assert_eq!(
        harness.wait(10.0),
        [
            "error there is no command \"40\"; \"help\" names all",
            "failed baud: nothing was understood at 921600, it is 115200 again"
        ]
    );
    assert_eq!(harness.working().preferences.rate_hz, 30);
    assert_eq!(harness.calls(), [Call::Baud(921_600), Call::Baud(115_200)]);
}

#[test]
fn noise_is_answered_once_a_second() {
    let mut harness = Harness::new();
    // Two seconds of lines that cannot be read, then two of wrong words.
    let mut answers = Vec::new();
    for _ in 0..100 {
        harness.receive([0xFF, b'\n', 0x00, b'\n', b'x', 0x80, b'\n']);
        answers.extend(harness.poll());
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
        harness.receive("asdf\n");
        answers.extend(harness.poll());
    }
    let wrong = answers
        .iter()
        .filter(|answer| answer.contains("asdf"))
        .count();
    assert!(
        (6..=9).contains(&wrong) && answers.len() <= 12,
        "{answers:?}"
    );
    // A right command is answered at once.
    assert!(harness.ask("status").contains(" lines_dropped="));
}

#[test]
fn an_error_of_the_receiver_drops_the_line() {
    let mut harness = Harness::new();
    harness.ask("rate 20");
    harness.calls();
    harness.receive("sa");
    harness.poll();
    harness.module.has_error = true;
    harness.receive("ve\n");
    let answer = harness.wait(2.0);
    assert!(
        answer.len() == 1 && answer[0].starts_with("error 1 line dropped"),
        "{answer:?}"
    );
    assert_eq!(harness.calls(), []);
}

#[test]
fn the_compass_is_named_mounted_and_shown() {
    let mut harness = Harness::new();
    let part = Choice::Named(PartId::Qmc5883l);
    assert_eq!(
        harness.ask("compass qmc5883l"),
        "ok compass qmc5883l; \"save\" keeps it"
    );
    let mut expected = CompassSettings::new(part);
    assert_eq!(harness.calls(), [Call::Compass(expected, Mount::Z_UP)]);
    assert_eq!(
        harness.ask("compass +y-z"),
        "ok compass +y-z; \"save\" keeps it"
    );
    expected.mount = Mount::parse("+y-z");
    assert_eq!(harness.calls(), [Call::Compass(expected, Mount::Z_UP)]);
    // The IMU's mount counts for a compass without its own.
    harness.ask("mount z-down");
    assert_eq!(
        harness.calls().last(),
        Some(&Call::Compass(expected, Mount::Z_DOWN))
    );
    let shown = harness.ask("show");
    assert!(
        shown.ends_with(" compass=qmc5883l compass_mount=+y-z"),
        "{shown}"
    );
    // A correction belongs to one part and one mount.
    let mut harness = Harness::with(Some(full()));
    assert_eq!(
        harness.ask("compass +y-z"),
        "ok compass +y-z, it is to be calibrated again; \"save\" keeps it"
    );
    assert_eq!(harness.console.working().compass.correction, None);
    harness.ask("forget");
    let defaults = CompassSettings::default();
    assert_eq!(harness.console.working().compass, defaults);
    assert!(
        harness
            .calls()
            .contains(&Call::Compass(defaults, Mount::Z_UP))
    );
}

#[test]
fn a_declination_is_set_shown_and_kept() {
    let mut harness = Harness::with(Some(full()));
    assert_eq!(
        harness.ask("declination 3.5"),
        "ok declination 3.50, the heading is from true north; \"save\" keeps it"
    );
    // The compass goes on with its correction.
    let mut expected = full().compass;
    expected.declination_rad = radians(3.5);
    let mount = full().calibration.mount.expect("it has one");
    assert_eq!(harness.calls(), [Call::Compass(expected, mount)]);
    assert!(harness.ask("show").ends_with(" declination=3.50"));
    assert!(harness.console.has_unsaved());
    harness.ask("save");
    assert_eq!(harness.calls(), [Call::Begin(Job::Save)]);
    harness.module.outcome = Some(Outcome::new(true, &"stored"));
    harness.poll();
    harness.ask("declination 3.50");
    assert!(!harness.console.has_unsaved(), "it is the same");
    // Another compass is in the same place, and so is one without a correction.
    harness.ask("compass ak8963");
    assert_eq!(harness.working().compass.declination_rad, radians(3.5));
    assert_eq!(
        harness.ask("declination 181"),
        "error \"181\" is no declination: -180 to 180 degrees, east positive, two \
         decimals at most, such as \"declination 3.5\""
    );
    assert_eq!(
        harness.ask("declination 0"),
        "ok declination 0.00, the heading is from magnetic north; \"save\" keeps it"
    );
    assert!(!harness.ask("show").contains("declination"));
    // A measurement does not refuse it.
    harness.ask("calibrate gyro");
    assert!(
        harness
            .ask("declination -22.05")
            .starts_with("ok declination -22.05, ")
    );
    harness.ask("calibrate stop");
    harness.ask("arm");
    assert!(
        harness
            .ask("declination 3")
            .starts_with("error refused while armed")
    );
    harness.ask("disarm");
    harness.ask("forget");
    assert_eq!(harness.working().compass.declination_rad, 0.0);
}

#[test]
fn status_has_the_heading_of_a_compass() {
    let mut harness = Harness::new();
    assert!(
        !harness.ask("status").contains("heading"),
        "there is no compass"
    );
    let mut state = State {
        compass: CompassStatus {
            part: Some(("AK8963", 0x0C)),
            fault: None,
            field: Some(MagneticField {
                ut: [18.0, -0.5, 44.0],
            }),
            hard_iron_ut: None,
        },
        ..State::default()
    };
    harness.module.state = Some(state);
    let status = harness.ask("status");
    let unknown = " compass=AK8963@0x0c field_ut=18.0,-0.5,44.0 strength_ut=47.5 \
                   heading_deg=unknown mount=";
    assert!(status.contains(unknown), "{status}");
    state.heading = Some(HeadingLine {
        heading_deg: 271.354,
        sigma_deg: 2.1,
        is_valid: true,
    });
    harness.module.state = Some(state);
    let known = " heading_deg=271.35 heading_sigma_deg=2.10 heading_valid=yes north=magnetic ";
    let status = harness.ask("status");
    assert!(status.contains(known), "{status}");
    harness.ask("declination 3.5");
    state.heading = state.heading.map(|heading| HeadingLine {
        is_valid: false,
        ..heading
    });
    harness.module.state = Some(state);
    assert!(
        harness
            .ask("status")
            .contains(" heading_valid=no north=true ")
    );
    // A fault leaves the heading to the gyroscope.
    state.compass.fault = Some(compass::Fault::Frozen);
    state.compass.field = None;
    harness.module.state = Some(state);
    let status = harness.ask("status");
    let faulty = " compass_fault=frozen heading_deg=271.35 ";
    assert!(status.contains(faulty), "{status}");
    // A vehicle without a compass has no heading, whatever it had before.
    state.compass.part = None;
    harness.module.state = Some(state);
    assert!(!harness.ask("status").contains("heading"));
}

/// Readings of a vehicle that is turned about all axes, in a field with hard iron. The compass's
/// right axis has this sign.
fn turned(readings: u16, sign: f32) -> CompassFitter {
    let mut fitter = CompassFitter::new();
    for nth in 0..readings {
        let t_s = f32::from(nth) * 0.02;
        let attitude = Quaternion::from_euler(EulerAngles {
            roll_rad: 3.0 * (0.9 * t_s).sin(),
            pitch_rad: 1.5 * (0.53 * t_s + 0.4).sin(),
            yaw_rad: 2.8 * (0.31 * t_s).sin(),
        });
        let mut field = attitude.conjugate().rotate(Vector3::new(20.0, 0.0, 44.0));
        field.y *= sign;
        fitter.add(attitude, field + Vector3::new(30.0, -20.0, 10.0));
    }
    fitter
}

#[test]
fn a_compass_calibration_shows_its_coverage_and_is_refused_or_put_in_use() {
    let mut harness = Harness::new();
    assert_eq!(
        harness.ask("calibrate compass"),
        "error calibrate compass: there are no readings of a compass (none answers)"
    );
    harness.module.state = Some(State {
        compass: CompassStatus {
            part: Some(("AK8963", 0x0C)),
            fault: None,
            field: Some(MagneticField { ut: [1.0; 3] }),
            hard_iron_ut: None,
        },
        ..State::default()
    });
    let started = harness.ask("calibrate compass");
    assert!(
        started.starts_with("ok calibrate compass: turn it"),
        "{started}"
    );
    assert_eq!(harness.calls(), [Call::StartFitter]);
    assert_eq!(
        harness.ask("save"),
        "error refused while \"calibrate compass\" goes on: \"calibrate stop\" ends it"
    );
    let status = harness.ask("status");
    assert!(status.ends_with(" doing=\"calibrate compass\""), "{status}");
    let waited = harness.wait(2.1);
    assert!(
        waited.contains(&"progress calibrate compass: 0 %, next: nose down".into()),
        "{waited:?}"
    );
    assert_eq!(
        harness.ask("calibrate done"),
        "error calibrate compass: 0 of at least 500 readings"
    );
    harness.module.fitter = Some(turned(1_500, 1.0));
    let waited = harness.wait(29.0).concat();
    assert!(
        waited.contains("100 %, go on turning")
            && waited.contains("done calibrate compass: mount +x-z, hard iron 30.0,-20.0,10.0 uT")
            && !waited.contains("the field points up"),
        "{waited}"
    );
    let correction = harness.console.working().compass.correction;
    let expected = correction.map(|correction| correction.hard_iron_ut);
    assert!(
        expected.is_some_and(|iron| (iron - Vector3::new(30.0, -20.0, 10.0)).norm() < 0.1),
        "{expected:?}"
    );
    assert!(harness.console.has_unsaved());
    assert_eq!(harness.working().calibration.mount, Some(Mount::Z_UP));
    // A wrong sign shows as a field that points up.
    harness.ask("calibrate compass");
    harness.module.fitter = Some(turned(1_500, -1.0));
    let answer = harness.ask("calibrate done");
    assert!(
        answer.contains(" dip -65.6 deg, ") && answer.contains("; the field points up: right only"),
        "{answer}"
    );
    // Arming gives it up, and so does nothing for two minutes.
    harness.ask("calibrate compass");
    assert_eq!(
        harness.ask("arm"),
        "ok arm: \"calibrate compass\" is given up"
    );
    harness.ask("disarm");
    harness.ask("calibrate compass");
    let waited = harness.wait(125.0);
    let last = "failed calibrate compass: 0 of at least 500 readings";
    assert_eq!(waited.last().map(String::as_str), Some(last));
}

#[test]
fn the_hard_iron_of_the_heading_filter_is_kept() {
    let mut harness = Harness::new();
    let refused = harness.ask("compass keep");
    assert!(
        refused.starts_with("error compass keep: the hard iron is not certain yet; turn"),
        "{refused}"
    );
    let found = Vector3::new(30.0, -20.0, 10.0);
    harness.module.state = Some(State {
        compass: CompassStatus {
            part: Some(("AK8963", 0x0C)),
            hard_iron_ut: Some(found),
            ..CompassStatus::default()
        },
        ..State::default()
    });
    let status = harness.ask("status");
    assert!(
        status.contains(" hard_iron_ut=30.0,-20.0,10.0 "),
        "{status}"
    );
    assert_eq!(
        harness.ask("compass keep"),
        "ok compass keep: hard iron 30.0,-20.0,10.0 uT, and the heading restarts with it; \
         \"save\" keeps it"
    );
    let kept = harness.console.working().compass.correction.expect("kept");
    assert_eq!((kept.hard_iron_ut, kept.has_soft_iron()), (found, false));
    let status = harness.ask("status");
    assert!(status.contains(" calibrated=hard-iron "), "{status}");
    assert!(harness.console.has_unsaved());
    // What the filter finds later adds to it.
    harness.ask("compass keep");
    let kept = harness.working().compass.correction.expect("kept");
    assert_eq!(kept.hard_iron_ut, found + found);
    // A calibration is better.
    let correction = &mut harness.console.working.compass.correction;
    correction.as_mut().expect("kept").matrix[0].x = 1.1;
    let refused = harness.ask("compass keep");
    assert!(
        refused.starts_with("error compass keep: its calibration is better"),
        "{refused}"
    );
}

#[test]
fn the_accelerometer_s_offset_of_the_filter_is_kept() {
    let mut harness = Harness::new();
    let refused = harness.ask("calibrate keep");
    assert!(
        refused.starts_with("error calibrate keep: the accelerometer's offset is not certain yet;"),
        "{refused}"
    );
    harness.module.state = Some(State {
        accelerometer_offset_m_s2: Some(Vector3::new(0.2, -0.1, 0.0)),
        ..State::default()
    });
    let status = harness.ask("status");
    assert!(
        status.contains(" accel_found_m_s2=0.200,-0.100,0.000 "),
        "{status}"
    );
    assert_eq!(
        harness.ask("calibrate keep"),
        "ok calibrate keep: added accelerometer offset 0.200,-0.100,0.000 m/s2 forward, right, \
         down; \"save\" keeps it"
    );
    assert!(matches!(
        harness.calls()[..],
        [Call::Calibration(calibration)] if calibration == harness.working().calibration
    ));
    // The default mount: the sensor's Y axis points to the left.
    let offset = |harness: &Harness| {
        let correction = harness.working().calibration.accelerometer;
        correction.expect("kept").offset_m_s2
    };
    assert_eq!(offset(&harness), Vector3::new(0.2, 0.1, 0.0));
    let status = harness.ask("status");
    assert!(status.contains(" calibrated=accel-offset "), "{status}");
    assert!(harness.console.has_unsaved());
    // What the filter finds later adds to it.
    harness.ask("calibrate keep");
    assert_eq!(offset(&harness), Vector3::new(0.4, 0.2, 0.0));
    // A calibration is better.
    let correction = &mut harness.console.working.calibration.accelerometer;
    correction.as_mut().expect("kept").matrix.xx = 1.01;
    let refused = harness.ask("calibrate keep");
    assert!(
        refused.starts_with("error calibrate keep: the accelerometer's calibration is better"),
        "{refused}"
    );
}

/// A correction is in body axes, so it belongs to the mounts of the compass and of the IMU.
#[test]
fn another_mount_discards_the_correction_of_the_compass() {
    for (line, own_mount, is_kept) in [
        ("compass +y-z", None, false),
        ("compass +x-z", None, true),
        ("compass +x-z", Mount::parse("+y-z"), false),
        ("compass auto", None, true),
        ("compass ak8963", None, false),
        ("mount +y-z", None, false),
        ("mount +x-z", None, true),
        ("mount +y-z", Mount::parse("+x-z"), false),
    ] {
        let mut harness = Harness::new();
        let compass = &mut harness.console.working.compass;
        compass.mount = own_mount;
        compass.correction = Some(CompassCorrection::NONE);
        let answer = harness.ask(line);
        let is_there = harness.working().compass.correction.is_some();
        assert_eq!(is_there, is_kept, "{line}");
        let is_reported = answer.contains("to be calibrated again");
        assert_eq!(is_reported, !is_kept, "{answer}");
    }
}

#[test]
fn the_longest_answers_fit() {
    let mut harness = Harness::with(Some(full()));
    let show = harness.ask("show");
    assert!(
        show.ends_with(
            " format=classic rate=1000 baud=921600 compass=qmc5883l compass_mount=-x-y \
             compass_iron=-1234.5,-1234.5,-1234.5 compass_matrix=-1.2345,-1.2345,-1.2345,\
             -1.2345,-1.2345,-1.2345,-1.2345,-1.2345,-1.2345 declination=-180.00"
        ),
        "{show}"
    );
    // The text "magnetic" is longer than "true".
    harness.ask("declination 0");
    harness.ask("calibrate temperature");
    let long = Vector3::new(-39.99, -39.99, -39.99);
    let state = State {
        flags: Flags::all(),
        sensor: Some((&Part::MPU_6050, 0x69)),
        compass: CompassStatus {
            part: Some(("HMC5883L/DA5883", 0x1E)),
            // There is no field during a fault.
            fault: None,
            field: Some(MagneticField { ut: [-1234.5; 3] }),
            hard_iron_ut: Some(Vector3::new(-1234.5, -1234.5, -1234.5)),
        },
        heading: Some(HeadingLine {
            heading_deg: 359.99,
            sigma_deg: 28.65,
            is_valid: false,
        }),
        temperature_celsius: -39.99,
        bias_rad_s: long,
        bias_sigma_rad_s: -39.99,
        accelerometer_offset_m_s2: Some(Vector3::new(-0.999, -0.999, -0.999)),
        tilt_sigma_rad: -39.99,
        bursts_failed: u16::MAX,
        times_missed: u16::MAX,
        times_refused: u16::MAX,
        reception_errors: u32::MAX,
        frames_dropped: u32::MAX,
    };
    harness.module.state = Some(state);
    harness.console.errors.dropped = u32::MAX;
    let status = harness.ask("status");
    assert!(
        status.ends_with("doing=\"calibrate temperature, nothing seen yet\""),
        "{status}"
    );
    harness.module.work = largest_work_figures();
    let figures = harness.ask("measure show");
    assert!(figures.contains(" temperature_c="), "{figures}");
    for line in [&show, &status, &figures] {
        assert!(line.len() + 60 <= ANSWER_CAPACITY, "{} {line}", line.len());
    }
}

/// Returns the figures with the longest numbers.
fn largest_work_figures() -> WorkFigures {
    let mut samples = SampleFigures::new();
    samples.add(0, u32::MAX >> 1, u8::MAX, &[0x80; 14]);
    samples.add(99_999, u32::MAX >> 1, 0, &[0x80; 14]);
    samples.missed = u32::MAX;
    let mut core = CoreFigures {
        busy_cycles: u64::MAX,
        elapsed_us: u64::MAX,
        ..CoreFigures::new()
    };
    core.sample_cycles.add(i32::MAX);
    core.interrupt_cycles.add(i32::MAX);
    WorkFigures {
        core,
        samples,
        core_mhz: 1,
        stack_used_bytes: u32::MAX,
        stack_bytes: u32::MAX,
    }
}

#[test]
fn a_measurement_is_started_shown_and_ended() {
    let mut harness = Harness::with(None);
    let mut samples = SampleFigures::new();
    // 2048 counts are 1 g, and 164 are 10 deg/s.
    let bytes = |x: i16| {
        let [high, low] = x.to_be_bytes();
        [high, low, 0, 0, 0, 0, 0, 0, 0, 164, 0, 0, 0, 0]
    };
    for (edge_us, x) in [(0, 2_047), (1_001, 2_049), (2_000, 2_047), (3_001, 2_049)] {
        samples.add(edge_us, 388, 0, &bytes(x));
    }
    let mut core = CoreFigures {
        busy_cycles: 1_680,
        elapsed_us: 1_000,
        ..CoreFigures::new()
    };
    core.sample_cycles.add(1_000);
    core.sample_cycles.add(1_025);
    core.interrupt_cycles.add(236);
    harness.module.work = WorkFigures {
        core,
        samples,
        core_mhz: 168,
        stack_used_bytes: 7_800,
        stack_bytes: 12_288,
    };
    let started = harness.ask("measure on");
    assert!(started.starts_with("ok measure: on; "), "{started}");
    assert_eq!(
        harness.ask("measure show"),
        "ok measure: seconds=0.0 samples=4 missed=0 cycles=1012.50,1025 \
         interrupt_cycles=236.00,236 edge_to_attitude_us=388.00,388 load_percent=1.000 \
         period_us=1000.333,999,1001 period_sigma_us=0.94 core_mhz=168 stack_bytes=7800,12288 \
         accel_mg=1000.000,0.000,0.000 accel_sigma_mg=0.488,0.000,0.000 \
         gyro_dps=10.000,0.000,0.000 gyro_sigma_dps=0.000,0.000,0.000 temperature_c=36.5"
    );
    assert_eq!(harness.ask("measure off"), "ok measure: off");
    let calls = [Call::Measuring(true), Call::Measuring(false)];
    assert_eq!(harness.calls(), calls);
}

/// Returns whether a command changes something while disarmed and without a procedure.
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
            "save", "sav", "forget", "rate ", "50", "mount ", "+x-z", "baud ", "9600",
            "calibrate ", "gyro", "format ", "text", "arm", "self-test", " ", "\x08",
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
        let mut harness = Harness::with(Some(full()));
        harness.receive(&bytes);
        for _ in 0..40 {
            harness.poll();
        }
        prop_assert_eq!(harness.working(), &full());
        prop_assert_eq!(harness.calls(), []);
    }

    /// Only whole lines store something: one that changes something, then `save`. The oracle splits
    /// the text at its line ends and searches for those two.
    #[test]
    fn only_a_change_and_save_store_a_record(bytes in nearly_commands()) {
        let mut harness = Harness::with(Some(full()));
        harness.receive(&bytes);
        for _ in 0..80 {
            harness.poll();
        }
        let is_stored = harness.calls().contains(&Call::Begin(Job::Save));
        let understood = |line: &[u8]| {
            // Backspace makes lines that a split does not find.
            let text = core::str::from_utf8(line).ok()?;
            if text.contains('\x08') { Some(None) } else { Some(text.parse::<Command>().ok()) }
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

    /// Answers stay within their budget for any input.
    #[test]
    fn wrong_lines_are_not_answered_one_by_one(
        bytes in prop::collection::vec(prop_oneof![Just(b'\n'), any::<u8>()], 0..3000),
    ) {
        let mut harness = Harness::new();
        let mut answers = 0;
        for chunk in bytes.chunks(100) {
            harness.receive(chunk);
            answers += harness.wait(0.02).len();
        }
        // 0.6 s: four at once, one more after half a second, one for those that were dropped.
        prop_assert!(answers <= 7, "{}", answers);
    }
}
