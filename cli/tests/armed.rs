//! Tests of the armed state: the column of a recording, the flag of bursts, and `--armed-from`.

mod common;

use std::path::{Path, PathBuf};

use aplomb::attitude::Vector3;
use aplomb::calibration::Mount;
use aplomb::estimator::Sample;
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::telemetry::bursts;
use common::{aplomb, file, path};

/// Rows from which on the recording is armed and disarmed.
const ARMED: std::ops::Range<usize> = 5_000..15_000;

/// Returns the rows of a simulated rest of 20 s: time, force and rates. Armed, the filter learns
/// nothing from it.
fn rest(test: &str) -> Vec<String> {
    let log = path(test, "rest.csv");
    let name = log.to_str().unwrap();
    let simulated = aplomb(&[
        "simulate",
        "--kind",
        "rest",
        "--seconds",
        "20",
        "--output",
        name,
    ]);
    assert!(simulated.status.success());
    let text = std::fs::read_to_string(log).unwrap();
    let sensor = |line: &str| line.split(',').take(7).collect::<Vec<_>>().join(",");
    text.lines().skip(2).map(sensor).collect()
}

/// Writes these rows, with a column `armed` that has a cell at each change alone, or without one.
fn written(test: &str, name: &str, rows: &[String], has_armed: bool) -> PathBuf {
    let mut text = format!(
        "t_us,ax,ay,az,gx,gy,gz{}\n",
        if has_armed { ",armed" } else { "" }
    );
    for (index, row) in rows.iter().enumerate() {
        text += row;
        if has_armed {
            text.push(',');
            text += match index {
                _ if index == ARMED.start => "1",
                _ if index == ARMED.end => "0",
                _ => "",
            };
        }
        text.push('\n');
    }
    file(test, name, text)
}

/// Replays a recording with these options, and returns the bits of its quaternions.
fn replayed(input: &Path, options: &[&str]) -> Vec<[u32; 4]> {
    let output = input.with_extension("attitude.csv");
    let mut arguments = vec!["replay", input.to_str().unwrap()];
    arguments.extend(["--output", output.to_str().unwrap()]);
    arguments.extend(options);
    let result = aplomb(&arguments);
    let message = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{message}");
    let text = std::fs::read_to_string(output).unwrap();
    let rows = text.lines().skip(1).map(|line| {
        let mut cells = line.split(',').skip(1);
        [(); 4].map(|()| cells.next().unwrap().parse::<f32>().unwrap().to_bits())
    });
    rows.collect()
}

fn bits(snapshot: &Snapshot) -> [u32; 4] {
    let q = snapshot.attitude;
    [q.w, q.x, q.y, q.z].map(f32::to_bits)
}

/// Returns the library's attitudes of these rows, with this armed state.
fn expected(rows: &[String], is_armed: impl Fn(usize) -> bool) -> Vec<[u32; 4]> {
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.sensor_delay_us = Some(0);
    let mut pipeline = Pipeline::new(&settings);
    pipeline.set_accelerometer_knowledge(AccelerometerKnowledge::Calibrated);
    let rows = rows.iter().enumerate().map(|(index, row)| {
        let t_us = row.split(',').next().unwrap().parse().unwrap();
        let numbers: Vec<f64> = row.split(',').map(|cell| cell.parse().unwrap()).collect();
        let vector = |first: usize| {
            let [x, y, z] = [0, 1, 2].map(|axis| numbers[first + axis] as f32);
            Mount::Z_UP.to_body(Vector3::new(x, y, z))
        };
        pipeline.set_armed(is_armed(index));
        bits(&pipeline.update_sample(&Sample::new(t_us, vector(1), vector(4))))
    });
    rows.collect()
}

#[test]
fn a_column_arms_from_its_row_on_and_the_option_from_its_time_on() {
    let rows = rest("armed");
    let armed = expected(&rows, |index| ARMED.contains(&index));
    let never = expected(&rows, |_| false);
    assert!(armed != never, "arming matters");
    let with_column = written("armed", "column.csv", &rows, true);
    assert!(replayed(&with_column, &[]) == armed);
    let plain = written("armed", "plain.csv", &rows, false);
    assert!(replayed(&plain, &[]) == never);
    let from_5_s = replayed(&plain, &["--armed-from", "5"]);
    assert!(from_5_s == expected(&rows, |index| index >= 5_000));
    let whole = replayed(&plain, &["--armed-from", "0"]);
    assert!(whole == expected(&rows, |_| true));
    for format in ["png", "svg"] {
        let picture = path("armed", &format!("plot.{format}"));
        let arguments = [
            "plot",
            plain.to_str().unwrap(),
            "--armed-from",
            "5",
            "--output",
        ];
        let picture = picture.to_str().unwrap();
        let result = aplomb(&[arguments.as_slice(), &[picture]].concat());
        assert!(result.status.success());
    }
}

#[test]
fn the_armed_state_goes_through_every_form() {
    let rows = rest("armed-forms");
    let csv = written("armed-forms", "armed.csv", &rows, true);
    let convert = |input: &Path, name: &str| {
        let output = path("armed-forms", name);
        let result = aplomb(&["convert", input.to_str().unwrap(), output.to_str().unwrap()]);
        assert!(result.status.success());
        output
    };
    let bursts = convert(&csv, "armed-bursts.csv");
    let text = std::fs::read_to_string(&bursts).unwrap();
    let decoded: Vec<_> = text.lines().skip(1).map(bursts::decode).collect();
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let attitudes = decoded.iter().enumerate().map(|(index, row)| {
        let row = row.expect("a row");
        assert_eq!(row.is_armed, ARMED.contains(&index), "{index}");
        pipeline.set_armed(row.is_armed);
        bits(&pipeline.update(&row.burst, row.board))
    });
    let attitudes: Vec<_> = attitudes.collect();
    assert!(replayed(&bursts, &[]) == attitudes);
    // A flight log begins new settings at each change, with the state of the filter.
    let log = convert(&bursts, "armed.log");
    assert!(replayed(&log, &[]) == attitudes);
    let from_log = convert(&log, "from-log-bursts.csv");
    assert!(std::fs::read(&from_log).unwrap() == std::fs::read(&bursts).unwrap());
    for (input, name) in [(&bursts, "again.csv"), (&log, "from-log.csv")] {
        let text = std::fs::read_to_string(convert(input, name)).unwrap();
        let header = "# --accelerometer factory\nt_us,ax,ay,az,gx,gy,gz,armed\n";
        assert!(text.starts_with(header), "{name}");
        for (index, line) in text.lines().skip(2).enumerate() {
            let cell = if ARMED.contains(&index) { ",1" } else { ",0" };
            assert!(line.ends_with(cell), "{name}: {index}: {line}");
        }
    }
    let unarmed = convert(
        &written("armed-forms", "plain.csv", &rows, false),
        "p-bursts.csv",
    );
    let text = std::fs::read_to_string(convert(&unarmed, "unarmed.csv")).unwrap();
    assert!(text.starts_with("# --accelerometer factory\nt_us,ax,ay,az,gx,gy,gz\n"));
}

#[test]
fn what_holds_its_armed_state_or_cannot_be_armed_is_refused() {
    let rows = rest("armed-refused");
    let column = written("armed-refused", "column.csv", &rows, true);
    let plain = written("armed-refused", "plain.csv", &rows, false);
    let output = |name: &str| path("armed-refused", name);
    for name in ["a-bursts.csv", "a.log"] {
        let result = aplomb(&[
            "convert".as_ref(),
            column.as_os_str(),
            output(name).as_os_str(),
        ]);
        assert!(result.status.success());
    }
    let text = std::fs::read_to_string(&column).unwrap();
    let bad = text.replacen(
        &format!("{},1\n", rows[ARMED.start]),
        "9000000,0,0,9,0,0,0,on\n",
        1,
    );
    let bad = file("armed-refused", "bad.csv", bad);
    let attitude = file(
        "armed-refused",
        "attitude.csv",
        "t_us,qw,qx,qy,qz\n0,1,0,0,0\n",
    );
    for (command, input, options, reason) in [
        (
            "replay",
            &column,
            "--armed-from 5",
            "column armed holds the armed state: leave out",
        ),
        (
            "plot",
            &column,
            "--armed-from 5",
            "column armed holds the armed state: leave out",
        ),
        (
            "replay",
            &output("a-bursts.csv"),
            "--armed-from 1",
            "us, so it holds the armed state",
        ),
        (
            "replay",
            &output("a.log"),
            "--armed-from 1",
            "--armed-from would change nothing",
        ),
        (
            "plot",
            &attitude,
            "--armed-from 1",
            "--armed-from would change nothing",
        ),
        (
            "replay",
            &plain,
            "--armed-from 20.5",
            "--armed-from is after the last row",
        ),
        (
            "replay",
            &plain,
            "--armed-from -1",
            "a number of seconds from 0 on",
        ),
        (
            "replay",
            &plain,
            "--armed-from nan",
            "a number of seconds from 0 on",
        ),
        (
            "replay",
            &plain,
            "--armed-from 5 --filter classic",
            "this filter cannot be armed",
        ),
        (
            "replay",
            &bad,
            "",
            "bad.csv:5002: armed is \"on\", but must be 0 or 1, or empty",
        ),
    ] {
        let mut arguments = vec![command, input.to_str().unwrap()];
        arguments.extend(options.split_whitespace());
        let result = aplomb(&arguments);
        let message = String::from_utf8(result.stderr).unwrap();
        assert!(!result.status.success(), "{arguments:?}");
        assert!(message.contains(reason), "{arguments:?}: {message}");
    }
}
