//! Commands on the UART of the real image: every one once, a flood of bytes, and a whole
//! calibration.

#[path = "../../fuzz/bodies/command_words.rs"]
mod command_words;
mod common;

use std::fmt::Write;
use std::fs;
use std::path::Path;

use aplomb::calibration::accelerometer::PoseCollector;
use aplomb::calibration::gyroscope::{TurnCollector, TurnIntegrator};
use aplomb::calibration::{ImuReading, StationaryDetector, StationaryProgress};
use aplomb::console::command::Command;
use aplomb::health::Flags;
use aplomb::mpu6050::{Part, RawSample};
use aplomb::pipeline::Settings;
use aplomb::telemetry::bursts;
use aplomb_models::motion::poses::Poses;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::{Quaternion, inclination_error_rad};
use aplomb_models::random::Random;
use aplomb_models::sensor::SensorErrors;
use command_words::WORDS;
use common::pooled_run;
use virtual_board::faults::Fault;
use virtual_board::flight::{Outcome, Run};
use virtual_board::kit::Kit;
use virtual_board::outputs;
use virtual_board::schedule::Schedule;
use virtual_board::script::Script;

/// Makes a run that must be possible.
fn fly(run: Run) -> Outcome {
    run.run().unwrap()
}

/// The lines of a run that are no telemetry, each with its time in seconds.
fn answers(outcome: &Outcome) -> Vec<(f64, &str)> {
    let lines = outcome.uart_lines.iter();
    lines
        .filter_map(|line| Some((line.at_ns as f64 * 1e-9, line.text.strip_prefix("# ")?)))
        .collect()
}

fn says(outcome: &Outcome, text: &str) -> bool {
    answers(outcome)
        .iter()
        .any(|(_, answer)| answer.contains(text))
}

/// Compares with a file beside the tests, or writes it if `APLOMB_BLESS` is set.
fn assert_golden(name: &str, text: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name);
    if std::env::var_os("APLOMB_BLESS").is_some() {
        return fs::write(path, text).unwrap();
    }
    let golden = fs::read_to_string(&path).unwrap();
    for (number, (got, golden)) in text.lines().zip(golden.lines()).enumerate() {
        assert_eq!(got, golden, "{name}:{}", number + 1);
    }
    assert_eq!(text.lines().count(), golden.lines().count(), "{name}");
}

/// Every command once, right and wrong, with time to answer.
const EVERY_COMMAND: &str = "
    0.6 help
    0.8 status
    1.0 show
    1.2 stauts
    1.4 calibrate
    1.6 calibrate giro
    1.8 rate 2000
    2.0 mount z-donw
    2.2 save
    2.4 rate 20
    2.6 format classic
    3.0 format text
    3.1 gyro-matrix 1,2,3
    3.2 calibrate gyro
    3.4 calibrate level
    8.0 calibrate level
    11.0 calibrate accel
    11.2 calibrate done
    11.4 calibrate stop
    11.6 calibrate temperature
    14.0 status
    14.2 calibrate done
    14.4 calibrate stop
    14.6 mount find
    16.5 calibrate stop
    16.7 mount z-up
    17.0 self-test
    20.0 save
    23.0 save
    23.2 show
    23.3 declination 200
    23.4 arm
    23.6 forget
    23.8 status
    24.0 disarm
    24.2 forget
    24.4 show
    24.6 baud 460800
    26.0 baud 115200
    26.2 status
    26.4 baud 921600
    38.0 status
";

#[test]
fn every_command_is_answered_as_before() {
    let script = Script::parse(EVERY_COMMAND).unwrap();
    let outcome = fly(pooled_run()
        .seconds(39.0)
        .motion(Rest::level())
        .commands(&script));
    assert_eq!(outcome.issues, Vec::<String>::new());
    let mut sent = script.lines().iter().peekable();
    let mut text = String::new();
    for (at_s, answer) in answers(&outcome) {
        while let Some((command_s, command)) = sent.next_if(|(command_s, _)| *command_s <= at_s) {
            writeln!(text, "{command_s:5.1} > {command}").unwrap();
        }
        // To a tenth of a second: which tick of the telemetry answers goes with every instruction
        // at start.
        writeln!(text, "{at_s:5.1}   {answer}").unwrap();
    }
    assert_golden("commands.txt", &text);
    // Both outputs agree.
    for (_, answer) in answers(&outcome) {
        assert!(
            outcome.log().iter().any(|line| line.text.ends_with(answer)),
            "{answer}"
        );
    }
}

#[test]
fn the_formats_and_rates_are_what_was_asked_for() {
    let outcome = fly(pooled_run()
        .seconds(7.0)
        .motion(Rest::level())
        .command(1.0, "rate 20")
        .command(3.0, "format classic")
        .command(5.0, "rate 200"));
    let lines = |from_s: f64, to_s: f64, start: &str| {
        let lines = outcome.uart_lines.iter();
        lines
            .filter(|line| (from_s..to_s).contains(&(line.at_ns as f64 * 1e-9)))
            .filter(|line| line.text.starts_with(start))
            .count()
    };
    assert!(
        (39..=41).contains(&lines(1.0, 3.0, "roll:")),
        "{}",
        lines(1.0, 3.0, "roll:")
    );
    assert!(
        (38..=41).contains(&lines(3.0, 5.0, "Roll:")),
        "{}",
        lines(3.0, 5.0, "Roll:")
    );
    assert_eq!(lines(3.1, 7.0, "roll:"), 0);
    assert!(
        (340..=400).contains(&lines(5.0, 7.0, "Roll:")),
        "{}",
        lines(5.0, 7.0, "Roll:")
    );
    let classic = outcome
        .uart_lines
        .iter()
        .find(|line| line.text.starts_with("Roll:"));
    assert!(aplomb::telemetry::classic::decode(&classic.unwrap().text).is_some());
    assert_eq!(outcome.summary.missed, 0);
}

#[test]
fn a_flood_changes_neither_samples_nor_times_nor_anything_else() {
    let mut random = Random::new(9, "flood");
    // Three seconds of bytes back to back, with commands in between that nobody sent.
    let mut bytes: Vec<u8> = (0..34_000)
        .map(|_| random.uniform(0.0, 256.0) as u8)
        .collect();
    for at in (0..33_000).step_by(1_500) {
        bytes[at..at + 8].copy_from_slice(b"\xFFsave\xFF\r\n");
    }
    let run = || pooled_run().seconds(6.0).seed(4);
    let quiet = fly(run());
    let flooded = fly(run()
        .send(1.5, &bytes)
        .command(5.0, "")
        .command(5.2, "status"));
    assert_eq!(flooded.issues, Vec::<String>::new());
    assert_eq!(flooded.summary.missed, 0);
    assert!(
        flooded
            .summary
            .timestamp_error_us_max
            .is_some_and(|it| it <= 1.0),
        "{:?}",
        flooded.summary
    );
    let published = |outcome: &Outcome| -> Vec<_> {
        outcome
            .samples()
            .iter()
            .map(|sample| sample.snapshot)
            .collect()
    };
    assert!(
        published(&quiet) == published(&flooded),
        "every attitude is the same, to the bit"
    );
    let latest = |outcome: &Outcome| outcome.summary.edge_to_attitude_us_max.unwrap();
    assert!(
        latest(&flooded) <= latest(&quiet) + 0.5,
        "{} {}",
        latest(&flooded),
        latest(&quiet)
    );
    assert!(says(&flooded, "lines dropped"));
    assert!(says(&flooded, "unsaved=no"));
    let answered = answers(&flooded).len() - answers(&quiet).len();
    assert!(
        (2..=20).contains(&answered),
        "{answered} answers to three seconds of noise"
    );
}

#[test]
fn a_flood_of_commands_costs_no_sample_either() {
    let flood = b"status\n".repeat(4_000);
    let outcome = fly(pooled_run().seconds(4.0).send(1.0, &flood));
    assert_eq!(outcome.summary.missed, 0);
    assert!(
        outcome
            .summary
            .timestamp_error_us_max
            .is_some_and(|it| it <= 1.0),
        "{:?}",
        outcome.summary
    );
    let answered = answers(&outcome)
        .iter()
        .filter(|(_, text)| text.starts_with("ok status"))
        .count();
    assert!(answered > 20, "{answered}");
}

/// The bound that docs/commands.md states, also while commands change the calibration.
#[test]
fn commands_by_chance_delay_no_attitude_by_much() {
    const COMMANDS: [&str; 18] = [
        "mount +x-z",
        "mount -x-z",
        "mount +y-z",
        "mount find",
        "calibrate gyro",
        "calibrate level",
        "calibrate accel",
        "calibrate temperature",
        "calibrate done",
        "calibrate stop",
        "gyro-matrix 5,0,-1,0,7,0,2,0,-9",
        "show",
        "status",
        "rate 50",
        "rate 10",
        "declination 3.5",
        "arm",
        "disarm",
    ];
    // With a compass a changed mount restarts the heading too.
    for (kit, seed) in [0, 1, 2, 3]
        .map(|seed| (Kit::default(), seed))
        .into_iter()
        .chain([(Kit::Gy87, 0), (Kit::Gy87, 1)])
    {
        let mut random = Random::new(seed, "commands");
        let mut run = pooled_run()
            .kit(kit)
            .seconds(20.0)
            .seed(seed)
            .motion(Rest::level());
        let mut at_s = 1.5;
        while at_s < 19.0 {
            let index = random.uniform(0.0, COMMANDS.len() as f64) as usize;
            run = run.command(at_s, COMMANDS[index]);
            at_s += random.uniform(0.02, 0.3);
        }
        let outcome = fly(run);
        assert_eq!(outcome.summary.missed, 0, "{kit:?} {seed}");
        let latest_us = outcome.summary.edge_to_attitude_us_max;
        assert!(
            latest_us.is_some_and(|it| it <= 430.0),
            "{kit:?} {seed}: {latest_us:?}"
        );
    }
}

#[test]
fn a_thousand_lines_by_chance_leave_the_module_alive() {
    let mut random = Random::new(1, "lines");
    let mut run = pooled_run().seconds(46.0).motion(Rest::level());
    for index in 0..1_000_u32 {
        let count = 1 + random.uniform(0.0, 5.0) as usize;
        let mut line = Vec::new();
        for _ in 0..count {
            let piece = WORDS[random.uniform(0.0, WORDS.len() as f64) as usize];
            line.extend(piece.as_bytes());
            if random.uniform(0.0, 1.0) < 0.1 {
                line.push(random.uniform(0.0, 256.0) as u8);
            }
        }
        line.push(b'\n');
        run = run.send(1.5 + 0.04 * f64::from(index), &line);
    }
    let outcome = fly(run.command(44.0, "").command(44.5, "status"));
    assert_eq!(outcome.issues, Vec::<String>::new());
    let last = answers(&outcome)
        .into_iter()
        .rfind(|(at_s, _)| *at_s > 44.5);
    assert!(
        last.is_some_and(|(_, text)| text.starts_with("ok status")),
        "{last:?}"
    );
    let after = outcome.samples().last().expect("there are samples");
    assert!(after.snapshot.t_us > 45_900_000, "{}", after.snapshot.t_us);
}

#[test]
fn a_noisy_line_is_counted_and_its_commands_dropped() {
    let garbled = Fault::ReceptionGarbled {
        noise_per_million: 10_000,
        framing_per_million: 10_000,
    };
    let mut run = pooled_run().seconds(8.0).fault(garbled);
    for tenth in 10..70 {
        let line = if tenth % 2 == 0 {
            "mount z-down"
        } else {
            "status"
        };
        run = run.command(f64::from(tenth) * 0.1, line);
    }
    let outcome = fly(run);
    assert_eq!(outcome.summary.missed, 0);
    let count = |start: &str| {
        answers(&outcome)
            .iter()
            .filter(|(_, text)| text.starts_with(start))
            .count()
    };
    let (understood, dropped) = (count("ok "), count("error "));
    assert!(understood > 20 && understood < 60, "{understood}");
    assert!(dropped > 0, "{dropped}");
    // The firmware understands exactly what was sent.
    assert_eq!(count("ok "), count("ok mount +x+z;") + count("ok status:"));
    let (_, last) = *answers(&outcome)
        .iter()
        .rfind(|(_, text)| text.starts_with("ok status"))
        .unwrap();
    assert!(!last.contains("uart_errors=0"), "{last}");
}

/// A line that is garbled while telemetry is being sent is dropped, though the next bytes are sound
/// before the console reads again. Noise that happens to be a line end may still end its line.
#[test]
fn the_halves_of_a_garbled_line_are_no_command() {
    let mut schedule = String::new();
    // At 9600 baud, telemetry is being sent most of the time.
    let mut run = pooled_run()
        .seconds(14.0)
        .motion(Rest::level())
        .command(1.0, "rate 8")
        .command(1.5, "baud 9600")
        .command(2.0, "status");
    for line in 0..20 {
        let at_s = 3.0 + 0.511 * f64::from(line);
        writeln!(schedule, "{} 0.005 uart-noise", at_s + 0.2).unwrap();
        run = run.send(at_s, b"declination 11").send(at_s + 0.23, b"2\n");
    }
    let outcome = fly(run
        .schedule(&Schedule::parse("noise", &schedule).unwrap())
        .command(13.8, "status"));

    assert!(says(&outcome, "baud 9600 from now on"));
    assert!(says(&outcome, "status: "));
    assert!(
        !says(&outcome, "ok declination 112"),
        "{:#?}",
        answers(&outcome)
    );
}

/// The offset that the first one stores shortens neither of the others.
#[test]
fn a_repeated_calibration_takes_as_long_as_the_first() {
    let outcome = fly(pooled_run()
        .seconds(14.0)
        .motion(Rest::level())
        .command(1.0, "calibrate gyro")
        .command(6.0, "calibrate gyro")
        .command(11.0, "calibrate level"));
    let ends: Vec<f64> = answers(&outcome)
        .iter()
        .filter(|(_, answer)| answer.starts_with("done "))
        .map(|(at_s, _)| *at_s)
        .collect();
    // Four seconds each, and two.
    for (end, expected) in ends.iter().zip([5.0, 10.0, 13.0]) {
        assert!((end - expected).abs() < 0.2, "{ends:?}");
    }
    assert_eq!(ends.len(), 3, "{ends:?}");
}

/// A frozen sensor is no rest: it would give the pose from before.
#[test]
fn a_calibration_waits_while_the_sensor_is_frozen() {
    let (froze_s, thawed_s) = (3.0, 8.0);
    let schedule = format!("{froze_s} {} frozen", thawed_s - froze_s);
    let rolled = Quaternion::from_euler(0.15, 0.0, 0.0);
    let outcome = fly(pooled_run()
        .seconds(13.0)
        .motion(Poses::new(&[(froze_s + 0.2, rolled)]))
        .schedule(&Schedule::parse("frozen", &schedule).unwrap())
        .command(5.0, "calibrate level"));
    let (done_s, _) = *answers(&outcome)
        .iter()
        .find(|(_, text)| text.starts_with("done calibrate level: "))
        .unwrap_or_else(|| panic!("{:#?}", answers(&outcome)));
    assert!(done_s > thawed_s, "{done_s}");
    // The module says why it waits, once a second.
    let expected = "progress calibrate level: no data: check the sensor's wires";
    let reported_s: Vec<f64> = answers(&outcome)
        .iter()
        .filter(|(_, text)| text.starts_with(expected))
        .map(|(at_s, _)| *at_s)
        .collect();
    assert!((2..=3).contains(&reported_s.len()), "{reported_s:?}");
    assert!(reported_s.iter().all(|at_s| (5.9..8.1).contains(at_s)));
    // The trim is that of the pose after the freeze.
    let inclination = inclination_deg(&outcome, 12.0, 13.0);
    assert!(
        (inclination - 0.15_f64.to_degrees()).abs() < 2.0,
        "{inclination}"
    );
}

/// The poses of the sensor, one after the other: face up, face down, X up, X down, Y up, Y down.
fn six_poses() -> [Quaternion; 6] {
    let pose =
        |roll: f64, pitch: f64| Quaternion::from_euler(roll.to_radians(), pitch.to_radians(), 0.0);
    // Body axes: the sensor lies face up, so its Y points left.
    [
        pose(0.0, 0.0),
        pose(180.0, 0.0),
        pose(0.0, 90.0),
        pose(0.0, -90.0),
        pose(90.0, 0.0),
        pose(-90.0, 0.0),
    ]
}

/// The mean inclination error at rest between two times, degrees.
fn inclination_deg(outcome: &Outcome, from_s: f64, to_s: f64) -> f64 {
    let errors: Vec<f64> = outcome
        .samples()
        .iter()
        .filter(|sample| (from_s..to_s).contains(&(sample.published_ns as f64 * 1e-9)))
        .filter_map(|sample| {
            let truth = sample.edge?.truth.attitude?;
            let attitude = sample.snapshot.attitude;
            let [w, x, y, z] = [attitude.w, attitude.x, attitude.y, attitude.z].map(f64::from);
            Some(inclination_error_rad(Quaternion { w, x, y, z }, truth).to_degrees())
        })
        .collect();
    errors.iter().sum::<f64>() / errors.len() as f64
}

/// A chip with offsets and scales at the datasheet's limits, and hardly any cross-axis sensitivity,
/// which six poses do not show.
fn poor_chip() -> SensorErrors {
    let milli_g = 9.80665e-3;
    let mut errors = SensorErrors::typical(6);
    errors.accelerometer.offset = [45.0 * milli_g, -48.0 * milli_g, 75.0 * milli_g];
    errors.accelerometer.sensitivity = [
        [1.028, 0.001, -0.001],
        [-0.001, 0.973, 0.001],
        [0.001, 0.001, 1.025],
    ];
    errors.gyroscope.offset = [12.0_f64, -15.0, 9.0].map(f64::to_radians);
    errors
}

/// A pose that no calibration has seen.
fn tilted() -> Quaternion {
    Quaternion::from_euler(0.5, -0.4, 0.3)
}

#[test]
fn a_calibration_outlives_the_power_and_takes_the_tilt_out() {
    let run = || pooled_run().sensor_errors(poor_chip());
    let trial = || run().seconds(10.0).motion(Poses::new(&[(1.5, tilted())]));

    let uncalibrated = fly(trial());
    let before_deg = inclination_deg(&uncalibrated, 8.0, 10.0);

    // Every pose is held for three seconds, the last one until it is done; then level again.
    let [_, poses @ ..] = six_poses();
    let mut motion: Vec<(f64, Quaternion)> = poses
        .into_iter()
        .enumerate()
        .map(|(index, pose)| (8.0 + 3.0 * index as f64, pose))
        .collect();
    motion.push((29.0, Quaternion::IDENTITY));
    let calibration = fly(run()
        .seconds(36.0)
        .motion(Poses::new(&motion))
        .command(1.0, "calibrate gyro")
        .command(6.0, "calibrate accel")
        .command(31.0, "calibrate level")
        .command(34.0, "save"));
    assert_eq!(calibration.issues, Vec::<String>::new());
    for text in [
        "done calibrate gyro: offset ",
        "pose 6 is ",
        "done calibrate accel: 6 poses, offset and scale: residual ",
        "done calibrate level: trim ",
        "done save: stored",
    ] {
        assert!(
            says(&calibration, text),
            "{text}: {:#?}",
            answers(&calibration)
        );
    }
    // The first attitude after the pause has the flag of a pause.
    let samples = calibration.samples();
    let gaps = samples
        .iter()
        .filter(|sample| sample.snapshot.flags.contains(Flags::GAP));
    assert_eq!(gaps.count(), 1);

    let calibrated = fly(trial().flash(calibration.flash.bytes.clone()));
    assert!(says(&calibrated, "stored calibration and settings in use"));
    let after_deg = inclination_deg(&calibrated, 8.0, 10.0);
    eprintln!(
        "inclination error in an unseen pose: {before_deg:.2} degrees, calibrated {after_deg:.2}"
    );
    assert!(before_deg > 2.0, "{before_deg}");
    assert!(after_deg < 0.3, "{after_deg}");
    // The offset is known from the first second on.
    let rates = calibrated.samples()[1000].snapshot.body_rates_rad_s;
    assert!(rates.norm().to_degrees() < 0.3, "{rates:?}");
}

/// A flight shows the accelerometer's offset. `calibrate keep` and `save` give it to the next.
#[test]
fn the_accelerometer_s_offset_of_a_flight_serves_the_next() {
    let mut chip = SensorErrors::typical(4);
    chip.accelerometer.offset = [0.35, -0.35, 0.2];
    let run = || pooled_run().sensor_errors(chip);
    let taught = fly(run()
        .seed(21)
        .seconds(72.0)
        .command(1.5, "calibrate keep")
        .command(68.0, "status")
        .command(69.0, "calibrate keep")
        .command(70.0, "save"));
    assert_eq!(taught.issues, Vec::<String>::new());
    for text in [
        "error calibrate keep: the accelerometer's offset is not certain yet",
        " accel_found_m_s2=",
        "ok calibrate keep: added accelerometer offset ",
        "done save: stored",
    ] {
        assert!(says(&taught, text), "{text}: {:#?}", answers(&taught));
    }
    let next = || run().seed(22).seconds(40.0).command(38.0, "status");
    let untaught = fly(next());
    let taught = fly(next().flash(taught.flash.bytes.clone()));
    assert!(says(&taught, " calibrated=accel-offset "));
    let [before_deg, after_deg] =
        [untaught, taught].map(|outcome| inclination_deg(&outcome, 6.0, 40.0));
    eprintln!("inclination error: {before_deg:.2} degrees, with the kept offset {after_deg:.2}");
    assert!(after_deg < 0.8 * before_deg, "{before_deg} {after_deg}");
}

/// Returns the command that calibrates the gyroscope, as `aplomb calibrate` finds it in a
/// recording of twelve poses.
fn gyroscope_matrix(recording: &Outcome) -> String {
    let noise = Settings::new(&Part::MPU_6050).noise_model();
    let mut detector = StationaryDetector::new(&noise, 1000);
    let mut poses = PoseCollector::new(&noise);
    let mut integrator = TurnIntegrator::new(&noise);
    let mut turns = TurnCollector::new();
    let mut file = Vec::new();
    outputs::write_bursts(&mut file, recording.samples()).unwrap();
    for line in String::from_utf8(file).unwrap().lines().skip(1) {
        let bursts::Row { burst, .. } = bursts::decode(line).unwrap();
        let raw = RawSample::decode(&burst.bytes);
        integrator.update(raw.gyroscope.0, burst.captured_at_us);
        if let StationaryProgress::Done(mean) = detector.update(&ImuReading {
            gyroscope: raw.gyroscope.0,
            accelerometer: raw.accelerometer.0,
            temperature_celsius: 25.0,
        }) {
            // A pose is seen twice, and refused the second time.
            poses.add(&mean).ok();
            integrator
                .finish(&mean)
                .iter()
                .for_each(|turn| turns.add(turn));
        }
    }
    let accelerometer = poses.fit().expect("twelve poses");
    let gyroscope = turns.fit(&accelerometer.correction).expect("eleven turns");
    Command::GyroscopeMatrix(gyroscope.matrix.to_ten_thousandths()).to_string()
}

/// At this attitude no byte of the quaternion is above 0x7F, so half of the packets are text.
#[test]
fn teapot_packets_stay_out_of_the_firmware_log() {
    let tilted = Quaternion::from_euler(22.0_f64.to_radians(), 13.6_f64.to_radians(), 0.0);
    let mut chip = SensorErrors::none();
    chip.gyroscope.noise_density = SensorErrors::typical(1).gyroscope.noise_density;
    let outcome = fly(pooled_run()
        .sensor_errors(chip)
        .seconds(7.0)
        .motion(Rest::new(tilted))
        .command(1.0, "format teapot"));
    let sent = outcome.record.received.windows(2);
    let sent = sent.filter(|pair| [pair[0].byte, pair[1].byte] == *b"$\x02");
    assert!(sent.count() > 250);
    let is_packet = |text: &str| text.contains('\u{2}');
    let packets = outcome.log().iter().filter(|line| is_packet(&line.text));
    assert_eq!(packets.count(), 0);
}

/// Twelve poses show the gyroscope's scale. `gyro-matrix` and `save` give it to every flight.
#[test]
fn the_gyroscope_s_matrix_of_twelve_poses_serves_a_flight() {
    let run = || pooled_run().sensor_errors(SensorErrors::typical(8));
    let recording = fly(run()
        .seconds(52.0)
        .motion(Poses::twelve(4.0))
        .command(1.0, "calibrate accel")
        .command(48.0, "calibrate done")
        .command(49.0, "save"));
    for text in [
        "done calibrate accel: 12 poses, offset, scale and cross-axis: residual ",
        "done save: stored",
    ] {
        assert!(says(&recording, text), "{text}: {:#?}", answers(&recording));
    }
    let command = gyroscope_matrix(&recording);

    let saved = fly(run()
        .seconds(5.0)
        .flash(recording.flash.bytes.clone())
        .motion(Rest::level())
        .command(1.0, &command)
        .command(2.0, "save"));
    for text in ["ok gyro-matrix: ", "done save: stored"] {
        assert!(says(&saved, text), "{text}: {:#?}", answers(&saved));
    }
    let flight = |run: Run, flash: &[u8]| {
        fly(run
            .seed(23)
            .seconds(40.0)
            .flash(flash.to_vec())
            .command(38.0, "status"))
    };
    let mut exact = SensorErrors::typical(8);
    exact.gyroscope.sensitivity = SensorErrors::none().gyroscope.sensitivity;
    let exact = pooled_run().sensor_errors(exact);
    let flights = [
        flight(run(), &recording.flash.bytes),
        flight(run(), &saved.flash.bytes),
        flight(exact, &recording.flash.bytes),
    ];
    assert!(says(&flights[1], " calibrated=gyro-scale,accel "));
    let [before, after, exact] = flights.map(|outcome| inclination_deg(&outcome, 6.0, 40.0));
    eprintln!(
        "inclination error: {before:.2} degrees, with the matrix {after:.2}; of a gyroscope \
         without scale error {exact:.2}"
    );
    assert!(after < before - 0.2, "{before} {after}");
    assert!(after < exact + 0.1, "{after} {exact}");
}

/// A short outage leaves no other trace in a text format. Without samples the tilt is uncertain by
/// what the body may have turned meanwhile: six sigma of both axes are 180 °/s each.
#[test]
fn status_counts_refused_samples_and_its_sigma_grows() {
    let outages = Schedule::parse("outages", "2.0 0.05 zeros\n3.0 1.5 sensor-silent").unwrap();
    let outcome = fly(pooled_run()
        .seconds(4.6)
        .schedule(&outages)
        .command(1.9, "status")
        .command(2.5, "status")
        .command(4.4, "status"));
    let number = |answer: &str, name: &str| -> f64 {
        let (_, rest) = answer.split_once(name).expect(name);
        rest.split(' ').next().unwrap().parse().expect(name)
    };
    let statuses: Vec<[f64; 2]> = answers(&outcome)
        .iter()
        .filter(|(_, answer)| answer.starts_with("ok status: "))
        .map(|(_, answer)| [" refused=", " tilt_sigma_deg="].map(|name| number(answer, name)))
        .collect();
    let [before, after, silent] = statuses[..] else {
        panic!("{statuses:?}");
    };
    assert_eq!(before[0], 0.0);
    // Blank data are one event, whether they are found blank or frozen first.
    assert!((1.0..=2.0).contains(&after[0]), "{after:?}");
    assert!(before[1] < 3.0 && after[1] < 5.0, "{statuses:?}");
    let turned_deg = 30.0 * 2_f64.sqrt() * 1.4;
    assert!((silent[1] - turned_deg).abs() < 6.0, "{silent:?}");
}
