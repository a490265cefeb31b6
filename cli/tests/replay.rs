//! `aplomb replay` from the outside: input, output, refusals.

mod common;

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

use aplomb::attitude::Vector3;
use aplomb::calibration::Mount;
use aplomb::estimator::{Estimator, Sample};
use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{BURST_LENGTH, Burst, Part};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::telemetry::bursts;
use aplomb::units::degrees;
use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_models::motion::truth::up_in_body;
use aplomb_recordings::score::{Errors, START_US};
use aplomb_recordings::simulated::{CONFIG, samples};
use common::{aplomb, file, path};

const HEADER: &str = "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov";
const GRAVITY: f64 = 9.80665;

/// Returns the log of a sensor face up that rolls to and fro by 30°, at 100 Hz, late by `delay_s`.
fn log(rows: u32, delay_s: f64) -> String {
    let mut text = format!("{HEADER}\n");
    for index in 0..rows {
        let now_s = f64::from(index) * 0.01;
        let then_s = now_s - delay_s;
        let roll = |time_s: f64| 30_f64.to_radians() * (2.0 * time_s).sin();
        let rate = 60_f64.to_radians() * (2.0 * then_s).cos();
        let (force_y, force_z) = (GRAVITY * roll(then_s).sin(), GRAVITY * roll(then_s).cos());
        let (half_sine, half_cosine) = (0.5 * roll(now_s)).sin_cos();
        let moving = u8::from(index % 100 != 99);
        writeln!(
            text,
            "{},0,{force_y:.5},{force_z:.5},{rate:.6},0,0,\
             {half_cosine:.6},{half_sine:.6},0,0,{moving}",
            index * 10_000
        )
        .unwrap();
    }
    text
}

/// Replays and returns what it printed and what it wrote.
fn replay(test: &str, input: &Path, options: &[&str]) -> (String, String) {
    let output = path(test, "output.csv");
    let mut arguments = vec!["replay", input.to_str().unwrap()];
    arguments.extend(["--output", output.to_str().unwrap()]);
    arguments.extend(options);
    let result = aplomb(&arguments);
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{errors}");
    let printed = String::from_utf8(result.stdout).unwrap();
    (printed, std::fs::read_to_string(output).unwrap())
}

/// Returns the printed root mean square.
fn rms(printed: &str) -> f64 {
    let (_, after) = printed.split_once("rms ").expect(printed);
    after.split_once('°').unwrap().0.parse().unwrap()
}

fn column<'a>(output: &'a str, name: &str) -> Vec<&'a str> {
    let mut lines = output.lines();
    let header = lines.next().unwrap();
    let place = header.split(',').position(|column| column == name).unwrap();
    lines
        .map(|line| line.split(',').nth(place).unwrap())
        .collect()
}

/// Returns a log of a sensor that lies face up with its x axis to the east, for five seconds, then
/// turns to the left and back so many times. Every fourth row has a reading of the compass.
fn compass_log(turns: u32) -> String {
    let mut log = "t_us,ax,ay,az,gx,gy,gz,mx,my,mz\n".to_owned();
    for index in 0..1_000 + 800 * turns {
        let phase = std::f64::consts::TAU * f64::from(index.saturating_sub(1_000)) / 800.0;
        let (turned, rate) = (0.75 * (1.0 - phase.cos()), 1.178 * phase.sin());
        // North is to the left of x; the field points down.
        let (sine, cosine) = turned.sin_cos();
        let field = match index % 4 {
            0 => format!("{:.2},{:.2},-44", 20.0 * sine + 0.1, 20.0 * cosine),
            _ => ",,".to_owned(),
        };
        writeln!(
            log,
            "{},0,0.0{},9.8,0,0,{rate:.4},{field}",
            5_000 * index,
            index % 3
        )
        .unwrap();
    }
    log
}

#[test]
fn a_log_with_a_compass_gives_the_heading() {
    let input = file("compass", "compass.csv", compass_log(3).into_bytes());
    let options = ["--compass", "calibrated", "--declination", "3"];
    let (printed, output) = replay("compass", &input, &options);
    assert!(printed.contains("HEADING_VALID: "), "{printed}");
    let last = |name| -> f64 { column(&output, name).last().unwrap().parse().unwrap() };
    assert!((last("heading_deg") - 93.0).abs() < 1.0, "{printed}");
    assert!((last("heading_deg") - last("yaw_deg") - last("yaw_offset_deg")).abs() < 1e-3);
    assert!((1.0..20.0).contains(&last("heading_sigma_deg")));
    assert_eq!(column(&output, "heading_deg").first(), Some(&""));
    let flags = column(&output, "flags");
    assert!(
        flags.last().unwrap().contains("VALID|HEADING_VALID"),
        "{flags:?}"
    );
    // At rest the heading is known, and not yet valid.
    let at_rest = flags[..1_000].iter();
    assert!(
        at_rest
            .clone()
            .all(|flags| !flags.contains("HEADING_VALID"))
    );
    let input = file("compass", "rest.csv", compass_log(0).into_bytes());
    // Hard iron of which nothing is known: at rest there is no heading.
    let (_, output) = replay("compass", &input, &[]);
    assert_eq!(column(&output, "heading_deg").last(), Some(&""));
}

#[test]
fn options_of_a_compass_are_refused_where_there_is_none() {
    let with = file("refused", "with.csv", compass_log(0).into_bytes());
    let without = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/roll.csv");
    let cases: [(&Path, &[&str], &str); 3] = [
        (
            &without,
            &["--compass", "factory"],
            "its header lacks mx,my,mz",
        ),
        (
            &without,
            &["--compass-delay-us", "10000"],
            "its header lacks mx,my,mz",
        ),
        (
            &with,
            &["--declination", "3", "--filter", "classic"],
            "leave --filter out",
        ),
    ];
    for (input, options, expected) in cases {
        let arguments = [&["replay", input.to_str().unwrap()], options].concat();
        let result = aplomb(&arguments);
        let errors = String::from_utf8_lossy(&result.stderr);
        assert!(
            !result.status.success() && errors.contains(expected),
            "{errors}"
        );
    }
}

#[test]
fn the_output_is_the_golden_one() {
    let input = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/roll.csv");
    for filter in ["kalman", "axis-kalman", "classic"] {
        let options = ["--filter", filter, "--sensor-delay-us", "2000"];
        let (_, output) = replay("golden", &input, &options);
        assert_golden(&format!("replay-{filter}.csv"), &output);
    }
}

#[test]
fn the_estimate_follows_and_is_in_the_files_axes() {
    let input = file("follow", "input.csv", log(1_000, 0.0));
    for filter in ["kalman", "axis-kalman"] {
        let (printed, output) = replay("follow", &input, &["--filter", filter]);
        assert!(rms(&printed) < 0.2, "{filter}: {printed}");
        // 495 of the 500 rows after 5 s have mov 1.
        assert!(printed.contains("over 495 rows"), "{printed}");
        assert_eq!(printed.contains("within 3 sigma"), filter == "kalman");
        let last = |name| column(&output, name)[999].parse::<f64>().unwrap();
        let roll = 30_f64.to_radians() * (2.0 * 9.99_f64).sin();
        // Face up, the file's y points left: left side up is positive roll.
        assert!((last("up_y") - roll.sin()).abs() < 0.01, "{filter}");
        assert!((last("up_z") - roll.cos()).abs() < 0.01, "{filter}");
        assert!(
            (last("roll_deg") - roll.to_degrees()).abs() < 0.5,
            "{filter}"
        );
        assert_eq!(column(&output, "t_us")[999], "9990000");
    }
}

#[test]
fn up_in_the_files_axes_does_not_depend_on_the_mount() {
    let input = file("mount", "input.csv", log(300, 0.0));
    let (_, expected) = replay("mount", &input, &[]);
    for mount in ["z-down", "-y+x", "+z+y"] {
        let (_, output) = replay("mount", &input, &["--mount", mount]);
        for (name, tolerance) in [("up_x", 0.01), ("up_y", 0.01), ("up_z", 0.01)] {
            let pairs = column(&output, name)
                .into_iter()
                .zip(column(&expected, name));
            for (up, expected) in pairs.skip(100) {
                let difference = up.parse::<f64>().unwrap() - expected.parse::<f64>().unwrap();
                assert!(difference.abs() < tolerance, "{mount} {name}");
            }
        }
    }
}

#[test]
fn the_summary_is_told_as_json_too() {
    let input = file("json", "input.csv", log(1_000, 0.0));
    let (printed, _) = replay("json", &input, &[]);
    let (json, _) = replay("json", &input, &["--json"]);
    let summary: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(summary["samples"], 1_000);
    assert_eq!(summary["filter"], "kalman");
    assert_eq!(summary["mount"], "+x-z");
    assert_eq!(summary["inclination_samples"], 495);
    let found = summary["inclination_rms_deg"].as_f64().unwrap();
    assert!((found - rms(&printed)).abs() < 5.1e-4, "{json}");
    for (flag, count) in summary["flags"].as_object().unwrap() {
        assert!(
            printed.contains(&format!("{flag}: {count} rows")),
            "{printed}"
        );
    }
    assert!(summary.get("log").is_none());
    let without = "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n";
    let (json, _) = replay("json", &file("json", "short.csv", without), &["--json"]);
    let summary: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!(summary.get("inclination_rms_deg").is_none(), "{json}");
}

#[test]
fn a_late_sensor_is_made_up_for() {
    let input = file("delay", "input.csv", log(1_500, 0.02));
    for filter in ["kalman", "axis-kalman"] {
        let (late, _) = replay("delay", &input, &["--filter", filter]);
        let options = ["--filter", filter, "--sensor-delay-us", "20000"];
        let (in_time, _) = replay("delay", &input, &options);
        // 20 ms at up to 60 °/s.
        assert!(rms(&late) > 0.7, "{filter}: {late}");
        assert!(rms(&in_time) < 0.3 * rms(&late), "{filter}: {in_time}");
    }
}

#[test]
fn zipped_logs_and_windows_line_ends_read_alike() {
    let text = log(200, 0.0);
    let (_, expected) = replay("forms", &file("forms", "plain.csv", &text), &[]);
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(text.as_bytes()).unwrap();
    let zipped = file("forms", "zipped", encoder.finish().unwrap());
    assert_eq!(replay("forms", &zipped, &[]).1, expected);
    let windows = file("forms", "windows.csv", text.replace('\n', "\r\n"));
    assert_eq!(replay("forms", &windows, &[]).1, expected);
    let no_end = file("forms", "no-end.csv", text.trim_end());
    assert_eq!(replay("forms", &no_end, &[]).1, expected);
}

#[test]
fn every_row_gives_one_whatever_it_holds() {
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    for (time, rest) in [
        ("0", "0,0,9.8,0,0,0"),
        ("1000", "0,0,9.8,0,0,0"),
        ("1000", "0,0,9.8,0,0,0"),
        ("500", "0,0,9.8,0,0,0"),
        ("2000", "nan,0,9.8,0,0,0"),
        ("3000", "0,0,9.8,inf,0,0"),
        ("4000", "0,0,0,0,0,0"),
        ("900000", "0,0,9.8,0,0,0"),
        ("901000", "0,0,1e30,0,0,0"),
        ("902000", "0,0,9.8,0.1,0,0"),
    ] {
        writeln!(text, "{time},{rest}").unwrap();
    }
    let input = file("total", "input.csv", text);
    for filter in ["kalman", "axis-kalman", "classic"] {
        let (printed, output) =
            replay("total", &input, &["--filter", filter, "--bad-rows", "keep"]);
        let flags = column(&output, "flags");
        assert_eq!(flags.len(), 10);
        let expected = ["TIME", "TIME", "REJECTED", "REJECTED"];
        for (flags, expected) in flags[2..6].iter().zip(expected) {
            assert!(flags.contains(expected), "{filter}: {flags}");
        }
        assert!(flags[7].contains("GAP"), "{filter}: {flags:?}");
        for row in [1, 9] {
            let at_first = ["", "CALIBRATING|DEGRADED"];
            assert!(at_first.contains(&flags[row]), "{filter}: {flags:?}");
        }
        assert!(printed.contains("TIME: 2 rows"), "{printed}");
        assert!(printed.contains("no truth"), "{printed}");
        for line in output.lines().skip(1) {
            for cell in line.split(',').take(14) {
                assert!(cell.parse::<f64>().unwrap().is_finite(), "{filter}: {line}");
            }
        }
    }
}

#[test]
fn counts_and_si_values_give_the_same() {
    let (mut counts, mut values) = (String::new(), String::new());
    for text in [&mut counts, &mut values] {
        text.push_str("t_us,ax,ay,az,gx,gy,gz\n");
    }
    for index in 0..300_i32 {
        let raw = [index, -300, 4_000 + index % 7, 200 + index, -index, 131];
        let si = |index: usize| {
            let range = if index < 3 {
                GRAVITY / 4096.0
            } else {
                1_f64.to_radians() / 131.0
            };
            f64::from(raw[index]) * range
        };
        let time = index * 9_000;
        let [ax, ay, az, gx, gy, gz] = raw;
        writeln!(counts, "{time},{ax},{ay},{az},{gx},{gy},{gz}").unwrap();
        let [ax, ay, az, gx, gy, gz] = core::array::from_fn(si);
        writeln!(values, "{time},{ax},{ay},{az},{gx},{gy},{gz}").unwrap();
    }
    writeln!(counts, "5000000,0,0,4096,32768,0,-32768").unwrap();
    let raw = ["--raw", "--accel-range", "8", "--gyro-range", "250"];
    let (printed, of_counts) = replay("raw", &file("raw", "counts.csv", counts), &raw);
    let factory = ["--accelerometer", "factory"];
    let (_, of_values) = replay("raw", &file("raw", "values.csv", values), &factory);
    assert!(printed.contains("GYROSCOPE_SATURATED: 1 rows"), "{printed}");
    for name in ["roll_deg", "up_x", "yaw_rate_dps"] {
        for (left, right) in column(&of_counts, name)
            .iter()
            .zip(column(&of_values, name))
        {
            let difference = left.parse::<f64>().unwrap() - right.parse::<f64>().unwrap();
            assert!(difference.abs() < 1e-3, "{name}: {left} {right}");
        }
    }
}

/// Returns rest, motion, a pause, a jump of the rates, a gap, a saturated gyroscope, free fall:
/// time in µs and counts.
fn eventful() -> Vec<(u64, [i16; 6])> {
    let mut t_us = 5_000;
    (0..9_000_u32)
        .map(|index| {
            // No axis repeats its count for long, as if it were stuck.
            let noise = (index * 7 % 11 % 5) as i16;
            let turn = if index < 3_500 {
                0.0
            } else {
                (f64::from(index) / 300.0).sin()
            };
            let wave = |amplitude: f64| (amplitude * turn) as i16 + noise;
            let mut counts = [noise, -noise, 2_048 - noise, wave(700.0), noise, 12 - noise];
            t_us += match index {
                4_000 => 40_000,
                6_000 => 700_000,
                _ => 1_000,
            };
            match index {
                5_000 => counts[4] = 3_000,
                7_000..7_004 => counts[5] = i16::MAX,
                8_000..8_050 => counts[2] = noise,
                _ => {}
            }
            (t_us, counts)
        })
        .collect()
}

/// Returns the row of a burst without conditions.
fn disarmed(burst: Burst) -> bursts::Row {
    bursts::Row {
        burst,
        board: BoardFlags::empty(),
        is_armed: false,
    }
}

#[test]
fn a_log_says_of_its_rows_what_a_board_says_of_its_bursts() {
    let mut log = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    let mut text = format!("{}\n", bursts::HEADER);
    for (t_us, [ax, ay, az, gx, gy, gz]) in eventful() {
        writeln!(log, "{t_us},{ax},{ay},{az},{gx},{gy},{gz}").unwrap();
        let mut bytes = [0; BURST_LENGTH];
        // 25 °C.
        let registers = [ax, ay, az, -3_920, gx, gy, gz];
        for (pair, count) in bytes.chunks_exact_mut(2).zip(registers) {
            pair.copy_from_slice(&count.to_be_bytes());
        }
        let burst = Burst {
            bytes,
            captured_at_us: t_us,
            missed_before: 0,
        };
        writeln!(text, "{}", disarmed(burst)).unwrap();
    }
    let (_, of_bursts) = replay("valid", &file("valid", "bursts.csv", text), &[]);
    let raw = ["--raw", "--accel-range", "16", "--gyro-range", "2000"];
    let delay = ["--sensor-delay-us", "1900"];
    let log = file("valid", "log.csv", log);
    let (printed, of_log) = replay("valid", &log, &[raw.as_slice(), &delay].concat());
    let (flags, expected) = (column(&of_log, "flags"), column(&of_bursts, "flags"));
    for (row, (flags, expected)) in flags.iter().zip(&expected).enumerate() {
        assert_eq!(flags, expected, "row {row}");
    }
    let with = |flag| flags.iter().filter(|flags| flags.contains(flag)).count();
    assert!(with("VALID") > 4_000, "{printed}");
    for flag in [
        "GAP",
        "GYROSCOPE_SATURATED",
        "FREE_FALL",
        "DEGRADED",
        "CALIBRATING",
    ] {
        assert!(with(flag) > 0, "{flag}: {printed}");
    }
    // After a pause and a jump σ says that something went unseen.
    let sigma = |row: usize| {
        column(&of_log, "tilt_sigma_deg")[row]
            .parse::<f64>()
            .unwrap()
    };
    assert!(
        sigma(4_000) > sigma(3_999) + 0.5,
        "{} {}",
        sigma(3_999),
        sigma(4_000)
    );
    assert_ne!(flags[5_000], "VALID", "the rates have jumped");
}

#[test]
fn a_slow_recording_is_no_sequence_of_pauses_in_any_form() {
    for (name, step_us) in [("a", 10_000), ("b", 50_000)] {
        let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
        for index in 0..800_u32 {
            let noise = |share: u32| (f64::from(index * 7 % share % 5) - 2.0) * 0.002;
            let (x, y, z) = (noise(11), noise(13), noise(17));
            let t_us = index * step_us;
            let (force_x, force_y, force_z) = (5.0 * x, 5.0 * y, 9.8 + 5.0 * z);
            writeln!(text, "{t_us},{force_x},{force_y},{force_z},{x},{y},{z}").unwrap();
        }
        let csv = file("slow-forms", &format!("{name}.csv"), text);
        let bursts = path("slow-forms", &format!("{name}-bursts.csv"));
        let (log, other) = (
            path("slow-forms", &format!("{name}.log")),
            path("slow-forms", &format!("{name}-other.log")),
        );
        for (input, output) in [(&csv, &bursts), (&csv, &log), (&bursts, &other)] {
            let result = aplomb(&["convert".as_ref(), input.as_os_str(), output.as_os_str()]);
            let errors = String::from_utf8_lossy(&result.stderr);
            assert!(result.status.success(), "{errors}");
        }
        for input in [&csv, &bursts, &log, &other] {
            let (printed, output) = replay("slow-forms", input, &[]);
            let flags = column(&output, "flags");
            assert!(
                flags[400..].iter().all(|flags| *flags == "VALID"),
                "{}: {printed}",
                input.display()
            );
        }
    }
}

#[test]
fn rows_far_apart_are_no_pauses_if_all_of_them_are() {
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    for index in 0..400_u32 {
        let noise = f64::from(index * 7 % 5) * 1e-3;
        writeln!(text, "{},{noise},0,9.8,0,{noise},0", index * 50_000).unwrap();
    }
    let (printed, output) = replay("slow", &file("slow", "input.csv", text), &[]);
    let flags = column(&output, "flags");
    assert!(
        flags[200..].iter().all(|flags| *flags == "VALID"),
        "{printed}"
    );
}

/// Returns the first columns of a row, up to the rates.
fn first_columns(snapshot: &Snapshot) -> String {
    let (q, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
    let angles = snapshot.euler();
    let angles = [angles.roll_rad, angles.pitch_rad, angles.yaw_rad].map(degrees);
    let rates = [rates.x, rates.y, rates.z].map(degrees);
    let numbers = [q.w, q.x, q.y, q.z].into_iter().chain(angles).chain(rates);
    numbers.fold(snapshot.t_us.to_string(), |row, number| {
        format!("{row},{number}")
    })
}

#[test]
fn bursts_go_through_the_whole_pipeline_to_the_bit() {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut input = format!("{}\n", bursts::HEADER);
    let mut expected = Vec::new();
    for index in 0..1_500_u16 {
        let mut bytes = [0; BURST_LENGTH];
        let swing = if index < 1_100 {
            0
        } else {
            9 * (index - 1_100)
        };
        // No axis repeats its count for long, as if it were stuck.
        let noise = index * 7 % 11 % 5;
        for (pair, count) in bytes.chunks_exact_mut(2).zip([
            noise,
            30 + noise,
            2_048 - noise,
            0xF000,
            swing + noise,
            20 - noise,
            65_530 - noise,
        ]) {
            pair.copy_from_slice(&count.to_be_bytes());
        }
        let burst = Burst {
            bytes,
            captured_at_us: 1_000 * u64::from(index) + u64::from(noise),
            missed_before: u8::from(index == 1_200),
        };
        let mut board = BoardFlags::empty();
        board.set(BoardFlags::SENSOR_RESET, index == 1_250);
        board.set(BoardFlags::INTERNAL_CLOCK, index > 1_300);
        let row = bursts::Row {
            burst,
            board,
            is_armed: (1_150..1_400).contains(&index),
        };
        writeln!(input, "{row}").unwrap();
        pipeline.set_armed(row.is_armed);
        let snapshot = pipeline.update(&burst, board);
        expected.push((first_columns(&snapshot), snapshot.flags.to_string()));
    }
    let (printed, output) = replay("bursts", &file("bursts", "bursts.csv", input), &[]);
    let is_calibrating = |(_, flags): &&(String, String)| flags.contains("CALIBRATING");
    let calibrating = expected.iter().filter(is_calibrating).count();
    let counted = format!("CALIBRATING: {calibrating} rows");
    assert!(calibrating > 0 && printed.contains(&counted), "{printed}");
    assert!(printed.contains("MISSED: 1 rows"), "{printed}");
    assert_eq!(output.lines().count(), 1 + expected.len());
    for (line, (start, flags)) in output.lines().skip(1).zip(&expected) {
        assert!(line.starts_with(start), "{line} is not {start}");
        // Bursts have no compass, so the columns of the heading are empty.
        assert!(line.ends_with(&format!(",{flags},,,")), "{line}: {flags}");
    }
    assert!(
        column(&output, "tilt_sigma_deg")
            .iter()
            .all(|sigma| !sigma.is_empty())
    );
    check_averaging_filters();
}

/// Checks that the tutorial's filters average at rest for a second, and report no σ.
fn check_averaging_filters() {
    let bursts = path("bursts", "bursts.csv");
    let (_, simple) = replay("bursts", &bursts, &["--filter", "axis-kalman"]);
    let flags = column(&simple, "flags");
    assert!(
        flags[..1_000]
            .iter()
            .all(|flags| flags.contains("CALIBRATING"))
    );
    assert!(
        flags[1_001..]
            .iter()
            .all(|flags| !flags.contains("CALIBRATING"))
    );
    assert!(flags[1_200].contains("MISSED"), "{}", flags[1_200]);
    let sigmas = column(&simple, "tilt_sigma_deg");
    assert!(sigmas.iter().all(|sigma| sigma.is_empty()));
    // Bursts bring the low-pass filter's delay, which these filters do not compensate.
    let late = ["--filter", "axis-kalman", "--sensor-delay-us", "20000"];
    assert_eq!(replay("bursts", &bursts, &late).1, simple);
}

#[test]
fn what_is_malformed_is_named_by_file_line_and_reason() {
    let good = log(3, 0.0);
    let bursts = format!("{}\n", bursts::HEADER);
    for (name, contents, line, reason) in [
        ("row", format!("{good}4,5\n"), ":5", "2 columns"),
        ("cell", good.replacen(",0,0,", ",0,o,", 1), ":2", "\"o\""),
        ("header", "time,x\n1,2\n".into(), ":1", "the header"),
        ("empty", String::new(), "", "empty"),
        ("no-rows", format!("{HEADER}\n"), "", "no row"),
        ("burst", format!("{bursts}1,00,\n"), ":2", "28 hexadecimal"),
        ("no-bursts", bursts.clone(), "", "no row"),
    ] {
        let input = file("malformed", name, contents);
        let output = path("malformed", "output.csv");
        let result = aplomb(&[
            "replay".as_ref(),
            input.as_os_str(),
            "--output".as_ref(),
            output.as_os_str(),
        ]);
        assert_eq!(result.status.code(), Some(1), "{name}");
        let message = String::from_utf8(result.stderr).unwrap();
        let place = format!("error: {}{line}: ", input.display());
        assert!(message.starts_with(&place), "{name}: {message}");
        assert!(message.contains(reason), "{name}: {message}");
        // Half an output is none.
        assert!(!output.exists() && !path("malformed", "output.csv.unfinished").exists());
    }
    let missing = aplomb(&["replay", "/no/such.csv"]);
    let message = String::from_utf8(missing.stderr).unwrap();
    assert!(message.contains("/no/such.csv: the file cannot be opened"));
}

#[test]
fn a_byte_order_mark_is_skipped_and_standard_input_is_read() {
    let text = log(200, 0.0);
    let (_, expected) = replay("input", &file("input", "plain.csv", &text), &[]);
    let marked = file("input", "marked.csv", format!("\u{FEFF}{text}"));
    assert_eq!(replay("input", &marked, &[]).1, expected);
    let output = path("input", "of-standard-input.csv");
    let result = std::process::Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .args(["replay", "-", "--output"])
        .arg(&output)
        .stdin(std::fs::File::open(path("input", "plain.csv")).unwrap())
        .output()
        .unwrap();
    assert!(result.status.success());
    assert_eq!(std::fs::read_to_string(output).unwrap(), expected);
}

#[test]
fn a_gzip_file_that_is_cut_off_is_refused() {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(log(5_000, 0.0).as_bytes()).unwrap();
    let whole = encoder.finish().unwrap();
    for length in [2, 9, whole.len() / 2, whole.len() - 1] {
        let input = file("cut", "input.csv.gz", &whole[..length]);
        let result = aplomb(&["replay".as_ref(), input.as_os_str()]);
        let message = String::from_utf8(result.stderr).unwrap();
        assert_eq!(result.status.code(), Some(1), "{length}: {message}");
        assert!(
            message.contains("cut off or damaged"),
            "{length}: {message}"
        );
    }
}

#[test]
fn what_cannot_be_written_or_must_not_is_left_alone() {
    let input = file("output", "input.csv", log(3, 0.0));
    let folder = input.parent().unwrap();
    let refusal = |output: &Path| {
        let result = aplomb(&[
            "replay".as_ref(),
            input.as_os_str(),
            "--output".as_ref(),
            output.as_os_str(),
        ]);
        assert_eq!(result.status.code(), Some(1), "{}", output.display());
        String::from_utf8(result.stderr).unwrap()
    };
    let missing = refusal(&folder.join("no/such/output.csv"));
    assert!(missing.contains("there is no folder") && missing.contains("no/such"));
    assert!(refusal(folder).contains("cannot be written"));
    assert!(refusal(&input).contains("would replace the input"));
    assert_eq!(std::fs::read_to_string(&input).unwrap(), log(3, 0.0));
}

/// A file must not replace a pipe, or /dev/null.
#[cfg(unix)]
#[test]
fn a_pipe_is_written_to_and_stays_one() {
    use std::os::unix::fs::FileTypeExt as _;

    let input = file("pipe", "input.csv", log(3, 0.0));
    let (_, expected) = replay("pipe", &input, &[]);
    let pipe = path("pipe", "pipe");
    let _ = std::fs::remove_file(&pipe);
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    let reader = std::thread::spawn({
        let pipe = pipe.clone();
        move || std::fs::read_to_string(pipe).unwrap()
    });
    let arguments = ["replay", input.to_str().unwrap(), "--output"];
    let result = aplomb(&[&arguments[..], &[pipe.to_str().unwrap()]].concat());
    assert!(result.status.success());
    assert!(pipe.metadata().unwrap().file_type().is_fifo());
    assert_eq!(reader.join().unwrap(), expected);
}

#[cfg(unix)]
#[test]
fn where_a_link_leads_is_written_and_the_link_stays() {
    use std::os::unix::fs::symlink;

    let input = file("link", "input.csv", log(3, 0.0));
    let (_, expected) = replay("link", &input, &[]);
    // To a file, to one that is not there yet, to a link, and to nothing that could be written.
    let target = file("link", "target.csv", "old");
    let missing = path("link", "missing.csv");
    let _ = std::fs::remove_file(&missing);
    for (name, leads_to, is_there) in [
        ("one.csv", "target.csv", &target),
        ("two.csv", "one.csv", &target),
        ("new.csv", "missing.csv", &missing),
    ] {
        let link = path("link", name);
        let _ = std::fs::remove_file(&link);
        symlink(leads_to, &link).unwrap();
        let arguments = ["replay", input.to_str().unwrap(), "--output"];
        let result = aplomb(&[&arguments[..], &[link.to_str().unwrap()]].concat());
        assert!(result.status.success(), "{name}");
        assert_eq!(link.read_link().unwrap(), Path::new(leads_to));
        assert_eq!(std::fs::read_to_string(is_there).unwrap(), expected);
        std::fs::write(&target, "old").unwrap();
    }
    let round = path("link", "round.csv");
    let _ = std::fs::remove_file(&round);
    symlink("round.csv", &round).unwrap();
    let arguments = ["replay", input.to_str().unwrap(), "--output"];
    let result = aplomb(&[&arguments[..], &[round.to_str().unwrap()]].concat());
    assert_eq!(result.status.code(), Some(1));
    assert!(round.is_symlink());
}

/// A shell redirects it: standard output stays the output, whatever file that is. By a
/// link of its own, as /dev/stdout is one, since a test must not touch that.
#[cfg(target_os = "linux")]
#[test]
fn standard_output_can_be_named() {
    let input = file("stdout", "input.csv", log(3, 0.0));
    let (summary, expected) = replay("stdout", &input, &[]);
    let redirected = path("stdout", "redirected.txt");
    let link = path("stdout", "link");
    let _ = std::fs::remove_file(&link);
    std::os::unix::fs::symlink("/proc/self/fd/1", &link).unwrap();
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_aplomb"))
        .arg("replay")
        .arg(&input)
        .arg("--output")
        .arg(&link)
        .stdout(std::fs::File::create(&redirected).unwrap())
        .status();
    assert!(status.unwrap().success());
    let found = std::fs::read_to_string(redirected).unwrap();
    assert_eq!(found, expected + &summary);
    assert!(link.is_symlink());
}

#[test]
fn another_file_is_not_overwritten_on_the_way() {
    let input = file("unfinished", "input.csv", log(3, 0.0));
    let other = file("unfinished", "output.csv.unfinished", "somebody's");
    replay("unfinished", &input, &[]);
    assert_eq!(std::fs::read_to_string(other).unwrap(), "somebody's");
    assert!(!path("unfinished", "output.csv.unfinished2").exists());
}

/// Ctrl-C comes while the input, a pipe, is still open.
#[cfg(unix)]
#[test]
fn what_is_interrupted_leaves_no_file() {
    let (output, unfinished) = (
        path("interrupted", "output.csv"),
        path("interrupted", "output.csv.unfinished"),
    );
    for file in [&output, &unfinished] {
        let _ = std::fs::remove_file(file);
    }
    let mut running = aplomb_with_default_signals()
        .args(["replay", "-", "--output"])
        .arg(&output)
        .stdin(std::process::Stdio::piped())
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let mut pipe = running.stdin.take().unwrap();
    // More than is read ahead and than a pipe holds.
    pipe.write_all(log(10_000, 0.0).as_bytes()).unwrap();
    wait_for(|| unfinished.exists().then_some(())).expect("an unfinished file");
    let id = running.id().to_string();
    let sent = std::process::Command::new("kill")
        .args(["-s", "INT", &id])
        .status();
    assert!(sent.unwrap().success());
    let Some(status) = wait_for(|| running.try_wait().unwrap()) else {
        running.kill().unwrap();
        panic!("SIGINT did not end it: does the parent of this test ignore SIGINT?");
    };
    assert_eq!(
        status.code(),
        Some(130),
        "{status}: SIGHUP or SIGTERM ignored?"
    );
    assert!(!unfinished.exists() && !output.exists());
}

/// Returns a command that runs the program with the default signal handling. A shell's background
/// job inherits an ignored SIGINT, and `nohup` an ignored SIGHUP: then no handler is set.
///
/// The `env` of some systems cannot restore the handling. There the program inherits it.
#[cfg(unix)]
fn aplomb_with_default_signals() -> std::process::Command {
    const RESTORE: &str = "--default-signal=HUP,INT,TERM";
    let program = env!("CARGO_BIN_EXE_aplomb");
    let tried = std::process::Command::new("env")
        .args([RESTORE, "true"])
        .output();
    if tried.is_ok_and(|output| output.status.success()) {
        let mut command = std::process::Command::new("env");
        command.args([RESTORE, program]);
        command
    } else {
        std::process::Command::new(program)
    }
}

/// Polls until there is a result; `None` after 30 s.
#[cfg(unix)]
fn wait_for<T>(mut poll: impl FnMut() -> Option<T>) -> Option<T> {
    let start = std::time::Instant::now();
    loop {
        let result = poll();
        if result.is_some() || start.elapsed().as_secs() >= 30 {
            return result;
        }
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
}

#[test]
fn times_may_be_as_far_apart_as_they_like() {
    let input = file(
        "far",
        "input.csv",
        format!(
            "t_us,ax,ay,az,gx,gy,gz\n{},0,0,9.8,0,0,0\n{},0,0,9.8,0,0,0\n{},0,0,9.8,0,0,0\n",
            i64::MIN,
            i64::MAX,
            i64::MIN
        ),
    );
    let (printed, output) = replay("far", &input, &["--bad-rows", "keep"]);
    assert!(printed.contains("GAP: 1 rows") && printed.contains("TIME: 1 rows"));
    assert_eq!(column(&output, "t_us")[1], i64::MAX.to_string());
}

#[test]
fn every_mount_can_be_named() {
    let input = file("mounts", "input.csv", log(3, 0.0));
    let names = Mount::ALL.map(Mount::name);
    for name in names.into_iter().chain(["z-up", "z-down"]) {
        for arguments in [vec!["--mount", name], vec![&*format!("--mount={name}")]] {
            let (printed, _) = replay("mounts", &input, &arguments);
            let stated = Mount::parse(name).unwrap().name();
            assert!(printed.contains(&format!("mount {stated}")), "{printed}");
        }
    }
}

#[test]
fn options_that_do_not_go_together_are_refused() {
    let input = file("options", "input.csv", log(3, 0.0));
    let bursts = file("options", "bursts.csv", format!("{}\n", bursts::HEADER));
    for (input, options, reason) in [
        (&input, vec!["--raw"], "--accel-range"),
        (&input, vec!["--accel-range", "8"], "--raw"),
        (&input, vec!["--filter", "best"], "axis-kalman"),
        (&input, vec!["--mount", "+x+x"], "+x-z"),
        (&input, vec!["--mount", "Z-UP"], "z-up"),
        (&input, vec!["--sensor-delay-us", "100001"], "100000"),
        (&input, vec!["--fitler", "kalman"], "--filter"),
        (
            &input,
            vec!["--raw", "--accel-range", "9", "--gyro-range", "250"],
            "2, 4, 8 and 16",
        ),
        (
            &bursts,
            vec!["--raw", "--accel-range", "8", "--gyro-range", "250"],
            "for recordings",
        ),
    ] {
        let mut arguments = vec!["replay", input.to_str().unwrap()];
        arguments.extend(&options);
        let result = aplomb(&arguments);
        let message = String::from_utf8(result.stderr).unwrap();
        assert!(!result.status.success(), "{options:?}");
        assert!(message.contains(reason), "{options:?}: {message}");
    }
}

/// Holds `contents` to the golden file of this name; `APLOMB_BLESS=1` writes it instead.
fn assert_golden(name: &str, contents: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name);
    if std::env::var_os("APLOMB_BLESS").is_some() {
        std::fs::write(&path, contents).expect("the golden file can be written");
        return;
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    for (number, (line, expected)) in contents.lines().zip(expected.lines()).enumerate() {
        assert_eq!(line, expected, "{}:{}", path.display(), number + 1);
    }
    assert_eq!(
        contents.lines().count(),
        expected.lines().count(),
        "{}: run with APLOMB_BLESS=1 if the change is meant",
        path.display()
    );
}

#[test]
fn a_simulated_flight_has_the_error_of_the_librarys_own_filter() {
    let log = path("simulated", "flight.csv");
    let name = log.to_str().unwrap();
    let simulated = aplomb(&["simulate", "--seed", "1000", "--output", name]);
    assert!(simulated.status.success());
    let options = "--json --sensor-delay-us 1900 --accelerometer calibrated";
    let options: Vec<&str> = options.split(' ').collect();
    let (json, _) = replay("simulated", &log, &options);
    let replayed: serde_json::Value = serde_json::from_str(&json).unwrap();
    let mut estimator = Estimator::new();
    estimator.filter_mut().set_delay_us(1_900);
    let mut errors = Errors::default();
    for simulated in samples(Box::new(Quadrotor::by_seed(1_000)), 1_000, 60) {
        let raw = simulated.raw;
        let to_body = |reading: Vector3| Mount::Z_UP.to_body(reading);
        let mut sample = Sample::new(
            simulated.t_us,
            to_body(raw.accelerometer.to_m_s2(CONFIG.accelerometer_range)),
            to_body(raw.gyroscope.to_rad_s(CONFIG.gyroscope_range)),
        );
        sample.is_force_saturated = raw.accelerometer.is_saturated();
        sample.is_rate_saturated = raw.gyroscope.is_saturated();
        let estimate = estimator.update(&sample);
        let truth = simulated.truth.attitude.filter(|_| simulated.truth.scored);
        if let Some(truth) = truth
            && simulated.t_us >= 1_000 + START_US.unsigned_abs()
        {
            let up = -estimate.attitude.down_in_body();
            errors.add([up.x, up.y, up.z].map(f64::from), up_in_body(truth), None);
        }
    }
    let score = errors.score().unwrap();
    assert_eq!(replayed["inclination_samples"], score.rows);
    for (name, expected) in [
        ("rms", score.rms),
        ("p95", score.p95),
        ("max", score.maximum),
    ] {
        let value = replayed[format!("inclination_{name}_deg")]
            .as_f64()
            .unwrap();
        assert!(
            (value - expected).abs() < 1e-6,
            "{name}: {value} and {expected}"
        );
    }
}

#[test]
fn slow_polling_is_degraded_and_very_slow_polling_never_valid() {
    let simulated = path("slow", "flight.csv");
    let name = simulated.to_str().unwrap();
    let result = aplomb(&["simulate", "--seconds", "30", "--output", name]);
    assert!(result.status.success());
    let log = std::fs::read_to_string(&simulated).unwrap();
    // Samples a second, whether the pipeline knows that rate, and shares of VALID and DEGRADED.
    for (rate, is_known, valid, degraded) in [
        (200, false, 0.9..1.0, 0.5..1.0),
        // σ is near its limit of 5° for a third of the flight. Hovering for a second is no rest.
        (20, true, 0.9..1.0, 0.0..0.16),
        (5, true, 0.5..1.0, 0.5..1.0),
        (1, true, 0.0..0.01, 0.9..1.01),
    ] {
        let rows = log.lines().skip(2).step_by(1_000 / rate);
        let mut pipeline = {
            let mut settings = Settings::new(&Part::MPU_6050);
            if is_known {
                settings.sensor.sample_rate_divider = (1_000 / rate - 1).min(255) as u8;
            }
            Pipeline::new(&settings)
        };
        let (mut flags, mut count, mut jumps) = ([0.0; 2], 0.0, 0.0);
        for row in rows {
            let cells: Vec<f32> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
            let vector = |first: usize| {
                let [x, y, z] = [0, 1, 2].map(|axis| cells[first + axis]);
                Mount::Z_UP.to_body(Vector3::new(x, y, z))
            };
            let t_us = row.split(',').next().unwrap().parse().unwrap();
            let snapshot = pipeline.update_sample(&Sample::new(t_us, vector(1), vector(4)));
            count += 1.0;
            // The rate has jumped as if the full scale had changed.
            let is_certain = snapshot.tilt_sigma_rad() < 5.0_f32.to_radians();
            if snapshot.flags == Flags::DEGRADED && is_certain {
                jumps += 1.0;
                continue;
            }
            for (sum, flag) in flags.iter_mut().zip([Flags::VALID, Flags::DEGRADED]) {
                *sum += f64::from(u8::from(snapshot.flags.contains(flag)));
            }
        }
        assert!(jumps < 0.02 * count, "{rate} Hz: {jumps} jumps");
        let [is_valid, is_degraded] = flags.map(|sum| sum / count);
        assert!(valid.contains(&is_valid), "{rate} Hz: {is_valid} VALID");
        assert!(
            degraded.contains(&is_degraded),
            "{rate} Hz: {is_degraded} DEGRADED"
        );
    }
}
