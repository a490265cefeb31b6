//! `aplomb calibrate` from the outside: what it finds, and what it refuses with which reason.

mod common;

use std::fmt::Write as _;
use std::path::PathBuf;

use aplomb::calibration::accelerometer::Pose;
use aplomb_models::motion::geometry::Quaternion;
use aplomb_models::sensor::SensorErrors;
use common::{aplomb, file, path};

const GRAVITY: f64 = 9.80665;

/// Returns counts at ±8 g and ±250 °/s of a sensor with known errors: two seconds in each pose
/// and a turn between them, at 100 Hz.
fn recording(poses: &[Pose], moving_degrees_s: f64) -> String {
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    let mut noise = 1_u32;
    let mut random = || {
        noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(noise >> 8) / f64::from(1 << 24) - 0.5
    };
    let mut row = 0;
    for pose in poses {
        let up = pose.up();
        let [x, y, z] = [up.x, up.y, up.z].map(f64::from);
        // Scale, cross-axis and offset: the fit has to find (30, −40, 60) mg.
        let read = [
            1.02 * x + 0.01 * y + 0.030,
            0.01 * x + 0.99 * y - 0.040,
            1.01 * z + 0.060,
        ];
        for step in 0..230 {
            let is_turning = step >= 200;
            write!(text, "{}", row * 10_000).unwrap();
            for value in read {
                let shake = if is_turning { 2000.0 } else { 40.0 };
                write!(text, ",{:.0}", value * 4096.0 + shake * random()).unwrap();
            }
            for _ in 0..3 {
                let rate = if is_turning { 60.0 } else { moving_degrees_s };
                let rate = rate * (f64::from(step) * 0.7).sin();
                write!(text, ",{:.0}", 131.0 * (rate + 0.3 * random()) + 300.0).unwrap();
            }
            text.push('\n');
            row += 1;
        }
    }
    text
}

const RAW: [&str; 5] = ["--raw", "--accel-range", "8", "--gyro-range", "250"];

/// Returns the output, or the error.
fn calibrate(test: &str, text: &str, options: &[&str]) -> Result<String, String> {
    let input = file(test, "input.csv", text);
    let mut arguments = vec!["calibrate", input.to_str().unwrap()];
    arguments.extend(options);
    let result = aplomb(&arguments);
    let errors = String::from_utf8(result.stderr).unwrap();
    if result.status.success() {
        Ok(String::from_utf8(result.stdout).unwrap())
    } else {
        Err(errors)
    }
}

#[test]
fn rests_are_found_and_the_known_errors_with_them() {
    let text = recording(&Pose::GUIDE, 0.0);
    let printed = calibrate("rests", &text, &RAW).unwrap();
    assert!(printed.contains("pose 1 at "), "{printed}");
    assert!(printed.contains("pose 12 at "), "{printed}");
    assert!(printed.contains("rests repeat a pose"), "{printed}");
    assert!(printed.contains("not at rest"), "{printed}");
    assert!(
        printed.contains("12 poses, offset, scale and cross-axis"),
        "{printed}"
    );

    let json = calibrate("rests-json", &text, &[&RAW[..], &["--json"]].concat()).unwrap();
    let found: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&found["rule"], &found["poses"]),
        (&"rest".into(), &12.into())
    );
    let offset = found["offset_m_s2"].as_array().unwrap();
    for (found, expected) in offset.iter().zip([0.030, -0.040, 0.060]) {
        assert!(
            (found.as_f64().unwrap() / GRAVITY - expected).abs() < 0.001,
            "{json}"
        );
    }
    assert_eq!(found["matrix"][2].as_array().unwrap().len(), 3);
    assert_eq!(found["held_out"], serde_json::Value::Null);
}

/// Pauses of a minute, one in each pose: the mean rate falls to 4 Hz.
#[test]
fn pauses_of_the_logger_do_not_shorten_the_rests() {
    let text = recording(&Pose::GUIDE, 0.0);
    let mut paused = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    for (index, row) in text.lines().skip(1).enumerate() {
        let (t_us, readings) = row.split_once(',').unwrap();
        let pauses = (index + 130) / 230;
        let t_us = t_us.parse::<usize>().unwrap() + 60_000_000 * pauses;
        writeln!(paused, "{t_us},{readings}").unwrap();
    }
    let printed = calibrate("pauses", &paused, &RAW).unwrap();
    assert!(printed.contains("pose 12 at "), "{printed}");
    let repeated = printed.split_once(" rests").unwrap().0;
    let repeated = repeated.rsplit_once([' ', '\n']).unwrap().1;
    // Four rests of half a second in each pose.
    assert!(repeated.parse::<usize>().unwrap() <= 36, "{printed}");
}

#[test]
fn what_cannot_be_used_is_refused_with_its_reason() {
    let restless = calibrate("restless", &recording(&Pose::GUIDE, 40.0), &RAW).unwrap_err();
    assert!(
        restless.contains("too restless for the device's rule"),
        "{restless}"
    );
    assert!(restless.contains("the rates vary by 2"), "{restless}");

    let flat = recording(&[Pose::GUIDE[0]; 4], 0.0);
    let flat = calibrate("flat", &flat, &RAW).unwrap_err();
    assert!(flat.contains("1 of at least 6 poses"), "{flat}");

    let five = calibrate("five", &recording(&Pose::GUIDE[..5], 0.0), &RAW).unwrap_err();
    assert!(five.contains("5 of at least 6 poses"), "{five}");
    assert!(
        five.contains("lay it still on the missing sides, y down"),
        "{five}"
    );

    let half: Vec<Pose> = Pose::GUIDE[2..8].to_vec();
    let half = calibrate("half", &recording(&half, 0.0), &RAW).unwrap_err();
    assert!(half.contains("missing z up, z down"), "{half}");

    let forgotten = calibrate("forgotten", &recording(&Pose::GUIDE, 0.0), &[]).unwrap_err();
    assert!(forgotten.contains("add --raw"), "{forgotten}");
    let text = turned(1.0, 0.0);
    let row = text.lines().nth(499).unwrap();
    let mut cells: Vec<&str> = row.split(',').collect();
    cells[1] = "170";
    let glitch = text.replace(row, &cells.join(","));
    let glitch = calibrate("glitch", &glitch, &[]).unwrap_err();
    assert!(
        glitch.contains(":500: 17.3 g is more than any range of the sensor"),
        "{glitch}"
    );
    let empty = calibrate("empty", "t_us,ax,ay,az,gx,gy,gz\n", &[]).unwrap_err();
    assert!(empty.contains("too few to find a rest in"), "{empty}");
    let other = calibrate("other", "a,b\n", &[]).unwrap_err();
    assert!(other.contains("the header is"), "{other}");
    let header = "time,ax,ay,az,gx,gy,gz\n";
    let renamed = calibrate("renamed", header, &[]).unwrap_err();
    let cause = ":1: t_us is missing; rename the column, or add it: the header is";
    assert!(renamed.contains(cause), "{renamed}");
}

#[test]
fn nearly_still_moments_serve_where_nothing_rests_and_it_says_so() {
    let poses: Vec<Pose> = Pose::GUIDE.into_iter().cycle().take(24).collect();
    let printed = calibrate("nearly-still", &recording(&poses, 6.0), &RAW).unwrap();
    assert!(
        printed.contains("too restless for the device's rule"),
        "{printed}"
    );
    assert!(printed.contains("instead: "), "{printed}");
    assert!(printed.contains("held out: fitted on "), "{printed}");
    let times = printed.split_once("after, ").unwrap().1;
    let times: f64 = times.split_once(" times").unwrap().0.parse().unwrap();
    assert!(times > 3.0, "{printed}");
}

/// Within a third of a second the mean force of a turn of 180 °/s is 4 % too small.
#[test]
fn steady_turns_are_no_rest() {
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz\n");
    let mut attitude = Quaternion::IDENTITY;
    for row in 0..4_800 {
        let axis = [[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [1.0, 0.0, 1.0]][row / 1_600];
        let rate = axis.map(|part: f64| part * std::f64::consts::PI * 0.5_f64.sqrt());
        let step = Quaternion::from_rotation_vector(rate.map(|rate| 0.005 * rate));
        attitude = attitude.multiply(step);
        let [ax, ay, az] = attitude.conjugate().rotate([0.0, 0.0, GRAVITY]);
        let [gx, gy, gz] = rate;
        writeln!(text, "{},{ax},{ay},{az},{gx},{gy},{gz}", 5_000 * row).unwrap();
    }
    let refused = calibrate("steady", &text, &[]).unwrap_err();
    assert!(refused.contains("its 0 nearly still moments"), "{refused}");
}

#[test]
fn the_poses_are_drawn() {
    let picture = path("poses", "poses.png");
    let result = aplomb(&["calibrate", "--draw-poses", picture.to_str().unwrap()]);
    assert!(result.status.success());
    let bytes = std::fs::read(picture).unwrap();
    assert!(bytes.starts_with(b"\x89PNG"));
    assert!(!aplomb(&["calibrate"]).status.success());
}

#[test]
fn the_picture_of_the_poses_does_not_replace_the_recording() {
    let text = recording(&Pose::GUIDE, 0.0);
    let name = path("poses-over", "input.csv");
    let draw = ["--draw-poses", name.to_str().unwrap()];
    let refused = calibrate("poses-over", &text, &[&RAW[..], &draw].concat()).unwrap_err();
    assert!(refused.contains("replace the input"), "{refused}");
    assert_eq!(std::fs::read_to_string(&name).unwrap(), text);
}

/// Known hard iron of the compass, µT in sensor axes.
const HARD_IRON_UT: [f64; 3] = [30.0, -42.0, 15.0];

/// Returns a log at 200 Hz of a sensor that rests for two seconds and is then turned about all axes
/// by these shares of a whole turn. `magnet_ut` sways in sensor axes.
fn turned(shares: f64, magnet_ut: f64) -> String {
    let attitude = |time_s: f64| {
        let t = (time_s - 2.0).max(0.0);
        Quaternion::from_euler(
            shares * 3.0 * (0.9 * t).sin(),
            shares * 1.5 * (0.53 * t).sin(),
            shares * 2.8 * (0.31 * t).sin(),
        )
    };
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz,mx,my,mz\n");
    for index in 0..7_000 {
        let time_s = 0.005 * f64::from(index);
        let to_sensor = attitude(time_s).conjugate();
        let turn = attitude(time_s - 0.0025).conjugate();
        let turn = turn
            .multiply(attitude(time_s + 0.0025))
            .to_rotation_vector();
        let [ax, ay, az] = to_sensor.rotate([0.0, 0.0, GRAVITY]);
        let [gx, gy, gz] = turn.map(|angle| angle / 0.005);
        write!(text, "{},{ax},{ay},{az},{gx},{gy},{gz}", 5_000 * index).unwrap();
        if index % 2 > 0 {
            text.push_str(",,,\n");
            continue;
        }
        // Earth axes with z up: north along x, and the field points down.
        let [x, y, z] = to_sensor.rotate([20.0, 0.0, -44.0]);
        let sway = magnet_ut * (2.5 * time_s).sin();
        let [hx, hy, hz] = HARD_IRON_UT;
        let reading = [1.1 * x + hx + sway, 0.9 * y + hy - sway, z + hz];
        let [x, y, z] = reading;
        writeln!(text, ",{x:.2},{y:.2},{z:.2}").unwrap();
    }
    text
}

#[test]
fn a_compass_is_calibrated_with_its_iron_and_gains() {
    let text = turned(1.0, 0.0);
    let printed = calibrate("compass", &text, &[]).unwrap();
    assert!(printed.contains("compass: "), "{printed}");
    assert!(printed.contains("residual"), "{printed}");
    let json = calibrate("compass-json", &text, &["--json"]).unwrap();
    let found: serde_json::Value = serde_json::from_str(&json).unwrap();
    let compass = &found["compass"];
    assert_eq!(compass["is_mount_that_of_the_imu"], true, "{json}");
    // The matrix takes gains and hard iron away: that of the readings is the matrix's inverse.
    for (row, (gain, hard_iron)) in [1.1, 0.9, 1.0].into_iter().zip(HARD_IRON_UT).enumerate() {
        let element = compass["matrix"][row][row].as_f64().unwrap();
        assert!((element * gain - 1.0).abs() < 0.02, "{json}");
        let found = compass["hard_iron_ut"][row].as_f64().unwrap();
        assert!((found / element - hard_iron).abs() < 1.5, "{json}");
    }
    assert!(
        (compass["dip_deg"].as_f64().unwrap() - 65.6).abs() < 2.0,
        "{json}"
    );
}

#[test]
fn a_compass_that_was_turned_too_little_or_disturbed_is_refused_with_the_reason() {
    let little = calibrate("compass-little", &turned(0.2, 0.0), &[]).unwrap_err();
    assert!(little.contains("compass: it was never "), "{little}");
    let disturbed = calibrate("compass-magnet", &turned(1.0, 25.0), &[]).unwrap_err();
    assert!(
        disturbed.contains("compass: the readings contradict the motion"),
        "{disturbed}"
    );
}

/// Returns the rotation that turns this direction of the sensor up.
fn lay(pose: Pose) -> Quaternion {
    let up = pose.up();
    let [x, y, z] = [up.x, up.y, up.z].map(f64::from);
    let angle = z.clamp(-1.0, 1.0).acos();
    let length = x.hypot(y);
    let axis = if length > 0.01 {
        [y / length, -x / length, 0.0]
    } else {
        [1.0, 0.0, 0.0]
    };
    Quaternion::from_rotation_vector(axis.map(|part| part * angle))
}

/// Returns a log at 200 Hz of twelve poses, two seconds each, and of turns about all axes.
fn posed_and_turned() -> String {
    let attitude = |time_s: f64| {
        let nth = (time_s / 3.5) as usize;
        if nth >= 12 {
            let t = time_s - 42.0;
            return Quaternion::from_euler(
                3.0 * (0.9 * t).sin(),
                1.5 * (0.53 * t).sin(),
                2.8 * (0.31 * t).sin(),
            );
        }
        let from = lay(Pose::GUIDE[nth]);
        let to = Pose::GUIDE
            .get(nth + 1)
            .map_or(Quaternion::IDENTITY, |pose| lay(*pose));
        let part = ((time_s - 3.5 * nth as f64 - 2.0) / 1.5).max(0.0);
        let part = 0.5 - 0.5 * (std::f64::consts::PI * part).cos();
        let way = from.conjugate().multiply(to).to_rotation_vector();
        from.multiply(Quaternion::from_rotation_vector(
            way.map(|angle| part * angle),
        ))
    };
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz,mx,my,mz\n");
    for index in 0..15_000 {
        let time_s = 0.005 * f64::from(index);
        let to_sensor = attitude(time_s).conjugate();
        let turn = attitude(time_s - 0.0025).conjugate();
        let turn = turn.multiply(attitude(time_s + 0.0025));
        let [gx, gy, gz] = turn.to_rotation_vector().map(|angle| angle / 0.005);
        let [ax, ay, az] = to_sensor.rotate([0.0, 0.0, GRAVITY]);
        let (ax, ay, az) = (ax + 0.6, ay - 0.6, az + 0.8);
        let (gx, gy) = (1.03 * gx, 0.97 * gy);
        let [x, y, z] = to_sensor.rotate([20.0, 0.0, -44.0]);
        let [hx, hy, hz] = HARD_IRON_UT;
        let (x, y, z) = (x + hx, y + hy, z + hz);
        writeln!(
            text,
            "{},{ax},{ay},{az},{gx},{gy},{gz},{x},{y},{z}",
            5_000 * index
        )
        .unwrap();
    }
    text
}

#[test]
fn the_compass_is_fitted_with_the_calibration_of_the_other_sensors() {
    let json = calibrate("compass-after", &posed_and_turned(), &["--json"]).unwrap();
    let found: serde_json::Value = serde_json::from_str(&json).unwrap();
    let compass = &found["compass"];
    assert!(
        compass["residual_ut"].as_f64().is_some_and(|it| it < 0.3),
        "{json}"
    );
    for (row, hard_iron) in HARD_IRON_UT.into_iter().enumerate() {
        let found = compass["hard_iron_ut"][row].as_f64().unwrap();
        assert!((found - hard_iron).abs() < 0.3, "{json}");
    }
}

#[test]
fn a_turn_at_full_scale_in_si_units_is_discarded() {
    let text = with_rates(|_, rate| rate.clamp(-1.9, 1.9));
    let input = file("clipped", "input.csv", &text);
    let result = aplomb(&["calibrate", input.to_str().unwrap()]);
    let printed = String::from_utf8(result.stdout).unwrap();
    assert!(printed.contains("or a full-scale rate"), "{printed}");
    let warned = String::from_utf8(result.stderr).unwrap();
    assert!(warned.contains("clipped: gyroscope gx at "), "{warned}");
}

/// Returns the log of twelve poses with other rates, by their columns.
fn with_rates(change: impl Fn(usize, f64) -> f64) -> String {
    let mut text = String::new();
    for row in posed_and_turned().lines().take(8_400) {
        let cells = row.split(',').take(7).enumerate();
        let cells = cells.map(|(index, cell)| match cell.parse::<f64>() {
            Ok(rate) if index > 3 => change(index, rate).to_string(),
            _ => cell.to_owned(),
        });
        writeln!(text, "{}", cells.collect::<Vec<_>>().join(",")).unwrap();
    }
    text
}

#[test]
fn rates_of_a_wrong_sign_or_range_are_named() {
    let about_x =
        |factor: f64| with_rates(|column, rate| if column == 4 { factor * rate } else { rate });
    let negated = calibrate("negated", &about_x(-1.0), &[]).unwrap();
    assert!(negated.contains("an axis has the wrong sign"), "{negated}");
    let quarter = calibrate("quarter", &about_x(0.25), &[]).unwrap();
    assert!(quarter.contains("; 1 shorter than 30°"), "{quarter}");
}

#[test]
fn a_compass_without_enough_readings_is_told_what_to_do() {
    let text = turned(1.0, 0.0);
    let rows: Vec<&str> = text.lines().collect();
    let part = |from: usize, to: usize| [&rows[..1], &rows[from..to]].concat().join("\n") + "\n";
    let at_once = calibrate("compass-at-once", &part(500, 1_300), &[]).unwrap_err();
    assert!(
        at_once.contains("came before the tilt was known: begin with a rest of 3 s"),
        "{at_once}"
    );
    let short = calibrate("compass-short", &part(1, 901), &[]).unwrap_err();
    assert!(short.contains("readings: record longer"), "{short}");
}

#[test]
fn a_pause_is_named_where_the_compass_contradicts_the_motion() {
    let text = turned(1.0, 25.0);
    let rows: Vec<&str> = text.lines().collect();
    let paused = [&rows[..3_002], &rows[3_401..]].concat().join("\n") + "\n";
    let paused = calibrate("compass-pause", &paused, &[]).unwrap_err();
    assert!(
        paused.contains("the recording pauses for 2.0 s at 15.0 s: record it in one piece"),
        "{paused}"
    );
}

#[test]
fn a_field_that_points_up_is_named() {
    let mut text = String::new();
    for row in turned(1.0, 0.0).lines() {
        let (cells, z) = row.rsplit_once(',').unwrap();
        let sign = if z.is_empty() || z == "mz" { "" } else { "-" };
        writeln!(text, "{cells},{}", format!("{sign}{z}").replace("--", "")).unwrap();
    }
    let printed = calibrate("compass-up", &text, &[]).unwrap();
    assert!(printed.contains("the field points up"), "{printed}");
    let json = calibrate("compass-up", &text, &["--json"]).unwrap();
    assert!(json.contains("\"dip_deg\":-"), "{json}");
}

/// Writes a simulated recording of twelve poses, and returns its path.
fn simulated_poses(test: &str, seed: &str) -> PathBuf {
    let poses = path(test, "poses.csv");
    let simulated = aplomb(&[
        "simulate",
        "--kind",
        "poses",
        "--seconds",
        "40",
        "--seed",
        seed,
        "--output",
        poses.to_str().unwrap(),
    ]);
    assert!(simulated.status.success(), "{simulated:?}");
    poses
}

#[test]
fn turns_between_twelve_poses_show_the_gyroscopes_matrix() {
    for seed in ["7", "8", "9"] {
        let poses = simulated_poses("gyroscope", seed);
        let printed = aplomb(&["calibrate", poses.to_str().unwrap()]);
        let printed = String::from_utf8(printed.stdout).unwrap();
        assert!(printed.contains("\n11 turns, gyroscope scale and cross-axis: residual "));
        let command = printed
            .split_once("\non the board: gyro-matrix ")
            .unwrap()
            .1;
        let typed: Vec<f64> = command
            .trim()
            .split(',')
            .map(|element| element.parse().unwrap())
            .collect();

        let json = aplomb(&["calibrate", poses.to_str().unwrap(), "--json"]);
        let json: serde_json::Value = serde_json::from_slice(&json.stdout).unwrap();
        let found = &json["gyroscope"];
        assert_eq!(found["turns"], 11);
        let matrix = |row: usize, column: usize| found["matrix"][row][column].as_f64().unwrap();
        let errors = SensorErrors::typical(seed.parse().unwrap());
        // Both triads are small rotations away from the body's axes. The matrix leads from the
        // gyroscope's to the accelerometer's, whose skew part the poses do not show.
        let [rates, forces] = [errors.gyroscope, errors.accelerometer].map(|it| it.sensitivity);
        for row in 0..3 {
            for column in 0..3 {
                let one = if row == column { 1.0 } else { 0.0 };
                let typed = 1.0e-4 * typed[3 * row + column] + one;
                assert!((typed - matrix(row, column)).abs() < 0.6e-4);
                let turned = 0.5 * (forces[row][column] - forces[column][row]);
                let expected = 2.0 * one - rates[row][column] + turned;
                let error = matrix(row, column) - expected;
                // What the first order leaves out is (3 %)².
                assert!(error.abs() < 0.002, "{seed}, {row}, {column}: {error}");
            }
        }
        assert!(
            found["residual_after_deg"]
                .as_f64()
                .is_some_and(|it| it < 0.1),
            "{json}"
        );
    }
}

#[test]
fn a_slow_recording_finds_the_same_matrix_and_one_with_gaps_names_them() {
    let poses = simulated_poses("slow", "7");
    let text = std::fs::read_to_string(&poses).unwrap();
    let (_, text) = text.split_once('\n').expect("a comment");
    let every = |step: usize| -> String {
        let rows = text.lines().skip(1).step_by(step);
        let header = text.lines().next().into_iter();
        header.chain(rows).flat_map(|row| [row, "\n"]).collect()
    };
    let diagonal = |step: usize| -> [f64; 3] {
        let json = calibrate("slow", &every(step), &["--json"]).unwrap();
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        [0, 1, 2].map(|axis| json["gyroscope"]["matrix"][axis][axis].as_f64().unwrap())
    };
    // 1 kHz and 100 Hz.
    for (fast, slow) in diagonal(1).into_iter().zip(diagonal(10)) {
        assert!((fast - slow).abs() < 0.001, "{fast} {slow}");
    }
    let printed = calibrate("gaps", &every(33), &[]).unwrap();
    assert!(
        printed.contains("; 11 with a gap of more than 25 ms or a full-scale rate: record"),
        "{printed}"
    );
}

#[test]
fn without_turns_the_gyroscope_is_not_calibrated_and_the_reason_is_told() {
    let text = recording(&Pose::GUIDE, 0.0);
    let printed = calibrate("turns", &text, &RAW).unwrap();
    assert!(
        printed.contains("gyroscope scale not found: 0 of at least 8 turns; 11 shorter than 30°"),
        "{printed}"
    );
    let six = recording(&Pose::GUIDE[..6], 0.0);
    let json = calibrate("turns-of-six", &six, &[&RAW[..], &["--json"]].concat()).unwrap();
    let found: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        found["gyroscope_refused"],
        "it needs the accelerometer's cross-axis terms: nine poses at least"
    );
}

#[test]
fn options_that_would_change_nothing_are_refused() {
    let input = file("unused", "input.csv", recording(&Pose::GUIDE[..2], 0.0));
    let input = input.to_str().unwrap();
    let picture = path("unused", "poses.png");
    let _ = std::fs::remove_file(&picture);
    let draw = ["--draw-poses", picture.to_str().unwrap()];
    let bus = ["--i2c", "/dev/i2c-none"];
    let of_compass = "--compass-delay-us and --field-unit";
    for (start, options, name) in [
        (&[input][..], &["--compass-delay-us", "9"][..], of_compass),
        (&[input], &["--field-unit", "mG"], of_compass),
        (&draw, &["--json"], "--json"),
        (&draw, &RAW, "--raw"),
        (&draw, &["--bad-rows", "skip"], "--bad-rows"),
        (&draw, &["--compass-delay-us", "9"], "--compass-delay-us"),
        (&bus, &RAW, "--raw"),
        (&bus, &["--rate-unit", "deg/s"], "--rate-unit"),
        (&bus, &["--sensor-mount", "+y-z"], "--sensor-mount"),
        (&bus, &["--calibration", "none.json"], "--calibration"),
    ] {
        let mut arguments = vec!["calibrate"];
        arguments.extend(start);
        if start == [input] {
            arguments.extend(RAW);
        }
        arguments.extend(options);
        let result = aplomb(&arguments);
        let message = String::from_utf8(result.stderr).unwrap();
        assert_eq!(result.status.code(), Some(2), "{arguments:?}: {message}");
        let reason = format!("error: {name} would change nothing");
        assert!(message.starts_with(&reason), "{arguments:?}: {message}");
        assert!(!picture.exists());
    }
}
