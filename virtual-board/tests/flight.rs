//! The rules of a flight: no missed sample, right times, the library's exact bits, and identical
//! files every time.

mod common;

use std::fs;
use std::path::Path;

use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{Burst, PARTS};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb_models::motion::Quaternion;
use aplomb_models::motion::rest::Rest;
use common::{firmware, firmware_without_compass, minimal_firmware};
use virtual_board::faults::{BusByte, Fault};
use virtual_board::flight::{Outcome, Run};
use virtual_board::kit::Kit;
use virtual_board::outputs;
use virtual_board::plot::Labels;
use virtual_board::recorder::Sample;

/// Makes a run that must be possible.
fn fly(run: Run) -> Outcome {
    run.run().unwrap()
}

/// All of a snapshot, as bits.
fn bits(snapshot: &Snapshot) -> (u64, [u32; 8], u32) {
    let (attitude, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
    let floats = [
        attitude.w,
        attitude.x,
        attitude.y,
        attitude.z,
        rates.x,
        rates.y,
        rates.z,
        snapshot.tilt_variance_rad2,
    ];
    (
        snapshot.t_us,
        floats.map(f32::to_bits),
        snapshot.flags.bits(),
    )
}

/// Runs the library on this computer with the bytes that the bus delivered and compares every bit.
fn assert_the_library_agrees(samples: &[Sample]) {
    let part = PARTS.iter().find(|part| part.who_am_i == 0x68).unwrap();
    let mut pipeline = Pipeline::new(&Settings::new(part));
    for (index, sample) in samples.iter().enumerate() {
        let flags = sample.snapshot.flags;
        let burst = Burst {
            bytes: sample.burst.bytes,
            captured_at_us: sample.snapshot.t_us,
            missed_before: u8::from(flags.contains(Flags::MISSED)),
        };
        // What the board alone knows.
        let board = BoardFlags::from_bits_truncate(flags.bits());
        let replayed = pipeline.update(&burst, board);
        assert_eq!(bits(&replayed), bits(&sample.snapshot), "sample {index}");
    }
}

#[test]
fn a_flight_keeps_its_promises() {
    let outcome = fly(Run::new(firmware()).seconds(10.0).seed(3));
    let summary = &outcome.summary;
    assert_eq!(outcome.issues, Vec::<String>::new());
    assert!(summary.samples > 9500, "{summary:?}");
    assert_eq!(summary.missed, 0);
    assert!(
        summary.timestamp_error_us_max.is_some_and(|it| it <= 1.0),
        "{summary:?}"
    );
    assert!(
        summary
            .io_instructions_per_sample_mean
            .is_some_and(|it| it <= 240.0),
        "{summary:?}"
    );
    assert!(
        summary
            .instructions_per_sample_mean
            .is_some_and(|it| it <= 1_050.0),
        "{summary:?}"
    );
    assert!(
        summary
            .instructions_per_sample_max
            .is_some_and(|it| it <= 6_000),
        "{summary:?}"
    );
    assert!(
        summary
            .edge_to_attitude_us_max
            .is_some_and(|it| it <= 395.0),
        "{summary:?}"
    );
    assert!(
        summary.cpu_load_percent.is_some_and(|it| it <= 0.95),
        "{summary:?}"
    );
    // `cargo xtask size` holds the build without compass to 128 KiB.
    assert!(summary.flash_bytes <= 160 * 1024, "{summary:?}");
    assert!(summary.ram_bytes <= 16 * 1024, "{summary:?}");
    assert!(summary.stack_bytes_used > 0, "{summary:?}");
    // docs/results.md has the largest error of this flight: 2.70°.
    assert!(
        summary.inclination_rms_deg.is_some_and(|it| it <= 2.1),
        "{summary:?}"
    );
    assert!(
        summary.inclination_max_deg.is_some_and(|it| it <= 2.8),
        "{summary:?}"
    );
    assert_the_library_agrees(outcome.samples());
}

/// Checks 10 s of a flight with a smaller build.
fn assert_a_smaller_build(outcome: &Outcome, flash_kib: u64) {
    let summary = &outcome.summary;
    assert_eq!(outcome.issues, Vec::<String>::new());
    assert!(summary.samples > 9500, "{summary:?}");
    assert_eq!(summary.missed, 0);
    assert!(
        summary
            .edge_to_attitude_us_max
            .is_some_and(|it| it <= 395.0),
        "{summary:?}"
    );
    assert!(summary.flash_bytes <= flash_kib * 1024, "{summary:?}");
    let is_line = |text: &str| text.starts_with("roll:");
    let lines = outcome.uart_lines.iter();
    let lines = lines.filter(|line| is_line(&line.text)).count();
    assert!((450..=510).contains(&lines), "{lines} lines at 50 Hz");
    assert_the_library_agrees(outcome.samples());
}

#[test]
fn the_minimal_firmware_keeps_the_same_promises_in_64_kib() {
    let outcome = fly(Run::new(minimal_firmware()).seconds(10.0).seed(3));
    assert_a_smaller_build(&outcome, 64);
}

/// The board has a compass, which this build leaves alone.
#[test]
fn the_firmware_without_compass_keeps_the_same_promises_in_128_kib() {
    let run = Run::new(firmware_without_compass()).kit(Kit::Gy87);
    let outcome = fly(run.seconds(10.0).seed(3).command(8.0, "status"));
    assert_a_smaller_build(&outcome, 128);
    assert!(outcome.uart_reports("# ok status: "));
    let lines = outcome.uart_lines.iter();
    let of_compass: Vec<&str> = lines
        .map(|line| line.text.as_str())
        .filter(|line| line.contains("compass") || line.contains("COMPASS"))
        .collect();
    assert_eq!(of_compass, [""; 0]);
}

#[test]
fn the_library_agrees_to_the_bit_when_samples_are_missing() {
    let nack = Fault::Nack {
        byte: BusByte::Pointer,
        // Between two readings of a setting, which send a pointer, too.
        from_s: 4.02,
        count: 2,
    };
    let outcome = fly(Run::new(firmware()).seconds(6.0).fault(nack));
    assert_eq!(outcome.summary.missed, 2);
    assert!(
        outcome
            .samples()
            .iter()
            .any(|sample| sample.snapshot.flags.contains(Flags::MISSED))
    );
    assert_the_library_agrees(outcome.samples());
}

#[test]
fn every_instruction_is_accounted_for_once() {
    let outcome = fly(Run::new(firmware()).seconds(2.0));
    assert_eq!(
        outcome.record.instructions.iter().sum::<u64>(),
        outcome.record.last.0
    );
    let credited: u64 = outcome
        .samples()
        .iter()
        .filter_map(|sample| sample.instructions)
        .sum();
    assert!(credited > 0 && credited < outcome.record.last.0);
    let uncredited = outcome
        .samples()
        .iter()
        .filter(|sample| sample.instructions.is_none())
        .count();
    assert!(uncredited <= 1, "{uncredited} samples without an account");
}

#[test]
fn the_account_is_the_one_of_single_steps() {
    let run = || Run::new(firmware()).seconds(1.0);
    let (quick, stepped) = (fly(run()), fly(run().step_everything()));
    assert_eq!(quick.record.instructions, stepped.record.instructions);
    let costs = |outcome: &Outcome| -> Vec<_> {
        let samples = outcome.samples().iter();
        samples
            .map(|sample| {
                (
                    sample.published_ns,
                    sample.instructions,
                    sample.input_instructions,
                )
            })
            .collect()
    };
    assert!(costs(&quick).len() > 500);
    assert_eq!(
        costs(&quick),
        costs(&stepped),
        "and the steps change nothing in the run"
    );
}

#[test]
fn the_attitude_is_right_at_rest() {
    for (roll_deg, pitch_deg) in [(25.0_f64, 0.0_f64), (0.0, -20.0), (-40.0, 30.0)] {
        let attitude = Quaternion::from_euler(roll_deg.to_radians(), pitch_deg.to_radians(), 0.0);
        let outcome = fly(Run::new(firmware())
            .seconds(4.0)
            .motion(Rest::new(attitude)));
        let euler = outcome.samples().last().unwrap().snapshot.euler();
        let (roll, pitch) = (
            f64::from(euler.roll_rad).to_degrees(),
            f64::from(euler.pitch_rad).to_degrees(),
        );
        // The sensor's own offsets of up to 50 mg tilt it by 3 degrees.
        assert!(
            (roll - roll_deg).abs() < 4.0 && (pitch - pitch_deg).abs() < 4.0,
            "{roll} {pitch}"
        );
    }
}

#[test]
fn the_counter_wraps_in_flight_and_nobody_notices() {
    let outcome = fly(Run::new(firmware())
        .seconds(4.0)
        .fault(Fault::TimerStartsAt(u32::MAX - 2_000_000)));
    let times: Vec<u64> = outcome
        .samples()
        .iter()
        .map(|sample| sample.snapshot.t_us)
        .collect();
    assert!(
        times.first().is_some_and(|&it| it < 1 << 32)
            && times.last().is_some_and(|&it| it > 1 << 32),
        "it wraps while samples come: {:?} to {:?}",
        times.first(),
        times.last()
    );
    for pair in times.windows(2) {
        let period_us = pair[1] - pair[0];
        assert!((980..=1020).contains(&period_us), "{pair:?}");
    }
    assert!(
        outcome
            .summary
            .timestamp_error_us_max
            .is_some_and(|it| it <= 1.0),
        "{:?}",
        outcome.summary
    );
    assert_eq!(outcome.summary.missed, 0);
    assert!(
        outcome
            .samples()
            .iter()
            .all(|sample| !sample.snapshot.flags.contains(Flags::GAP))
    );
    assert!(
        outcome
            .samples()
            .iter()
            .all(|sample| !sample.snapshot.flags.contains(Flags::TIME))
    );
}

#[test]
fn text_and_log_report_what_was_published() {
    let outcome = fly(Run::new(firmware()).seconds(3.0));
    let lines: Vec<&str> = outcome
        .uart_lines
        .iter()
        .map(|line| line.text.as_str())
        .filter(|text| text.starts_with("roll:"))
        .collect();
    assert!(
        (125..=140).contains(&lines.len()),
        "{} lines at 50 Hz",
        lines.len()
    );
    let mut buffer = [0; aplomb::telemetry::text::LINE_LENGTH];
    let published: Vec<String> = outcome
        .samples()
        .iter()
        .map(|sample| {
            let line = aplomb::telemetry::text::encode(&sample.snapshot, &mut buffer);
            String::from_utf8_lossy(line).trim_end().to_owned()
        })
        .collect();
    for line in lines {
        assert!(published.iter().any(|text| text == line), "{line}");
        assert!(
            outcome
                .log()
                .iter()
                .any(|logged| logged.text.ends_with(line)),
            "{line}"
        );
    }
}

/// Writes a run's files to a folder of its own.
fn written(name: &str, outcome: &Outcome) -> std::path::PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let labels = Labels {
        title: "title".into(),
        subtitle: "subtitle".into(),
    };
    outputs::write(&folder, outcome, &labels).unwrap();
    folder
}

#[test]
fn one_seed_gives_the_same_files_every_time_and_another_seed_others() {
    let folder =
        |name: &str, seed| written(name, &fly(Run::new(firmware()).seconds(3.0).seed(seed)));
    let (first, second, other) = (folder("first", 5), folder("second", 5), folder("other", 6));
    for file in [
        "attitude.csv",
        "bursts.csv",
        "truth.csv",
        "uart.log",
        "attitude.png",
    ] {
        let read = |folder: &Path| fs::read(folder.join(file)).unwrap();
        assert!(!read(&first).is_empty());
        assert!(
            read(&first) == read(&second),
            "{file} differs between two runs"
        );
        assert!(
            read(&first) != read(&other),
            "{file} does not depend on the seed"
        );
    }
    let summary = |folder: &Path| {
        let text = fs::read_to_string(folder.join("summary.json")).unwrap();
        text.lines()
            .filter(|line| !line.contains("wall_seconds"))
            .collect::<Vec<_>>()
            .join("\n")
    };
    assert_eq!(summary(&first), summary(&second));
}

#[test]
fn the_files_have_the_agreed_form() {
    let outcome = fly(Run::new(firmware()).seconds(2.0));
    let folder = written("form", &outcome);
    let lines = |file: &str| -> Vec<String> {
        fs::read_to_string(folder.join(file))
            .unwrap()
            .lines()
            .map(str::to_owned)
            .collect()
    };
    let (attitude, bursts, truth) = (
        lines("attitude.csv"),
        lines("bursts.csv"),
        lines("truth.csv"),
    );
    assert_eq!(
        attitude[0],
        "t_us,qw,qx,qy,qz,roll_deg,pitch_deg,yaw_deg,\
         roll_rate_dps,pitch_rate_dps,yaw_rate_dps,flags"
    );
    assert_eq!(bursts[0], "t_us,bytes,flags");
    assert_eq!(attitude.len(), outcome.samples().len() + 1);
    assert_eq!(bursts.len(), attitude.len());
    assert_eq!(truth.len(), attitude.len());
    for (row, sample) in attitude[1..].iter().zip(outcome.samples()) {
        let cells: Vec<&str> = row.split(',').collect();
        assert_eq!(cells.len(), 12);
        assert_eq!(cells[0].parse(), Ok(sample.snapshot.t_us));
        let attitude = sample.snapshot.attitude;
        let read: Vec<f32> = cells[1..5]
            .iter()
            .map(|cell| cell.parse().unwrap())
            .collect();
        assert_eq!(
            read,
            [attitude.w, attitude.x, attitude.y, attitude.z],
            "numbers read back as themselves"
        );
        assert_eq!(cells[11].parse(), Ok(sample.snapshot.flags));
    }
    for (row, sample) in bursts[1..].iter().zip(outcome.samples()) {
        let cells: Vec<&str> = row.split(',').collect();
        let bytes: Vec<u8> = (0..14)
            .map(|n| u8::from_str_radix(&cells[1][2 * n..2 * n + 2], 16).unwrap())
            .collect();
        assert_eq!((cells.len(), cells[1].len()), (3, 28));
        assert_eq!(bytes, sample.burst.bytes);
    }
    let summary = lines("summary.json");
    let names: Vec<&str> = summary
        .iter()
        .filter_map(|line| line.trim().strip_prefix('"')?.split('"').next())
        .collect();
    // Among them is how often each flag was set, for those that ever were.
    let is_flag = |name: &&str| name.parse::<Flags>().is_ok();
    let (flags, names): (Vec<&str>, Vec<&str>) = names.into_iter().partition(is_flag);
    assert_eq!(flags, ["CALIBRATING", "DEGRADED", "VALID"]);
    assert_eq!(
        names,
        [
            "samples",
            "missed",
            "virtual_seconds",
            "wall_seconds",
            "instructions_per_sample_mean",
            "instructions_per_sample_max",
            "io_instructions_per_sample_mean",
            "cycles_per_sample_estimate",
            "cpu_load_percent",
            "edge_to_attitude_us_mean",
            "edge_to_attitude_us_max",
            "edge_to_attitude_us_estimate",
            "timestamp_error_us_max",
            "inclination_rms_deg",
            "inclination_max_deg",
            "flags",
            "flash_bytes",
            "ram_bytes",
            "stack_bytes_used",
        ]
    );
}
