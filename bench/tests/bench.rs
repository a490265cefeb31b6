//! `aplomb-bench` from the outside.

use std::ffi::OsStr;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use aplomb_models::motion::quadrotor::Quadrotor;
use aplomb_recordings::simulated::{LOG_HEADER, samples};

/// Runs the program with these arguments.
fn bench<A: AsRef<OsStr>>(arguments: &[A]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_aplomb-bench"))
        .args(arguments)
        .output()
        .expect("the program runs")
}

/// Returns a path in a folder of the test's own.
fn path(test: &str, name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test);
    std::fs::create_dir_all(&folder).expect("the target folder can be written");
    folder.join(name)
}

/// Writes a file of the test's own.
fn file(test: &str, name: &str, contents: impl AsRef<[u8]>) -> PathBuf {
    let path = path(test, name);
    std::fs::write(&path, contents).expect("the target folder can be written");
    path
}

/// Returns ten seconds at 200 Hz of a sensor at rest, tilted about x, with an offset in y.
fn log(tilt_degrees: f64, offset_m_s2: f64) -> String {
    let tilt = tilt_degrees.to_radians();
    let (y, z) = (9.80665 * tilt.sin() + offset_m_s2, 9.80665 * tilt.cos());
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov\n");
    for index in 0..2_000 {
        let time_us = index * 5_000;
        let (sine, cosine) = (0.5 * tilt).sin_cos();
        writeln!(text, "{time_us},0,{y},{z},0,0,0,{cosine},{sine},0,0,1").unwrap();
    }
    text
}

const UNKNOWN: &str = "t_us,ax,ay,az,gx,gy,gz\n";

/// Returns ten seconds at 200 Hz without truth, at rest, with this reading of the z axis.
fn resting(z: f64) -> String {
    (0..2_000).fold(String::from(UNKNOWN), |text, index| {
        format!("{text}{},0,0,{z},0,0,0\n", index * 5_000)
    })
}

/// Returns three seconds of rest at 200 Hz, then seventeen of a turn about x at this rate, rad/s.
/// The rates are multiplied by a factor, as in another unit.
fn turned(factor: f64, rate_rad_s: f64) -> String {
    let mut text = String::from("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov\n");
    for index in 0..4_000 {
        let turning = f64::from((index - 600).max(0));
        let angle = 0.005 * rate_rad_s * turning;
        let (y, z) = angle.sin_cos();
        let (sine, cosine) = (0.5 * angle).sin_cos();
        let rate_rad_s = if turning > 0.0 { rate_rad_s } else { 0.0 };
        let (time_us, rate) = (index * 5_000, factor * rate_rad_s);
        let (y, z) = (9.80665 * y, 9.80665 * z);
        writeln!(text, "{time_us},0,{y},{z},{rate},0,0,{cosine},{sine},0,0,1").unwrap();
    }
    text
}

/// Checks a row of accuracy.csv.
fn check_row(line: &str) {
    let cells: Vec<&str> = line.split(',').collect();
    let rms: f64 = cells[6].parse().unwrap();
    assert!(
        ["999", "1000"].contains(&cells[5]),
        "rows after 5 s: {line}"
    );
    match cells[..4] {
        ["still", "a.csv", "truth", "1000"] => assert!(rms < 0.05, "{line}"),
        // The filter starts there or comes from level, within ten seconds.
        ["wrong", "b.csv", "truth", "0"] => assert!((2.0..3.5).contains(&rms), "{line}"),
        ["unknown" | "counted", "resting.csv", "rest", "0"] => assert!(rms < 0.1, "{line}"),
        _ => panic!("{line}"),
    }
    // Only the Kalman filter reports σ, which is judged where there is a truth.
    let has_sigma = cells[4] == "kalman" && cells[2] == "truth";
    assert_eq!(
        !cells[9].is_empty() && !cells[10].is_empty(),
        has_sigma,
        "{line}"
    );
    if has_sigma {
        let [within, median] = [9, 10].map(|cell| cells[cell].parse::<f64>().unwrap());
        // The filter cannot know the error of the accelerometer.
        let expected = if cells[0] == "still" {
            0.0..=1.0
        } else {
            2.0..=12.0
        };
        assert!(
            (0.0..=1.0).contains(&within) && expected.contains(&median),
            "{line}"
        );
    }
}

/// Checks that accuracy.csv has a row for each filter on each recording, and no other.
fn check_names(csv: &str) {
    const RECORDINGS: [&str; 4] = [
        "counted,resting.csv",
        "still,a.csv",
        "unknown,resting.csv",
        "wrong,b.csv",
    ];
    const FILTERS: [&str; 7] = [
        "kalman",
        "axis-kalman",
        "classic",
        "vqf",
        "fusion",
        "madgwick",
        "mahony",
    ];
    let found: Vec<String> = (csv.lines().skip(1))
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            format!("{},{},{}", cells[0], cells[1], cells[4])
        })
        .collect();
    let each = |recording| FILTERS.map(|filter| format!("{recording},{filter}"));
    assert_eq!(found, RECORDINGS.map(each).concat());
}

/// Checks that the JSON has the scores of accuracy.csv.
fn check_json(json: &[u8], csv: &str, not_scored: usize) {
    let found: serde_json::Value = serde_json::from_slice(json).unwrap();
    assert_eq!(found["not_scored"].as_array().unwrap().len(), not_scored);
    let scores = found["scores"].as_array().unwrap();
    assert_eq!(scores.len(), csv.lines().count() - 1);
    for (score, line) in scores.iter().zip(csv.lines().skip(1)) {
        let cells: Vec<&str> = line.split(',').collect();
        let names = ["set", "recording", "reference", "sensor_delay_us", "filter"];
        for (name, cell) in names.iter().zip(&cells) {
            let value = score[name].to_string();
            assert_eq!(value.trim_matches('"'), *cell, "{name}: {line}");
        }
        let rms: f64 = cells[6].parse().unwrap();
        let found = score["inclination_rms_deg"].as_f64().unwrap();
        assert!((found - rms).abs() < 1e-12, "{line}");
        assert_eq!(
            score.get("within_3_sigma").is_some(),
            !cells[9].is_empty(),
            "{line}"
        );
    }
}

#[test]
fn every_filter_is_scored_on_every_recording_with_truth() {
    file("bench/still", "a.csv", log(0.0, 0.0));
    // An accelerometer that errs by 3° makes every filter err by 3°.
    file(
        "bench/wrong",
        "b.csv",
        log(0.0, 9.80665 * 3_f64.to_radians().tan()),
    );
    file("bench/wrong", "notes.txt", "no recording");
    file("bench/wrong", "other.csv", "a,b\n1,2\n");
    // Without truth: one rests, one turns all the time. In register counts: one is stated, one is
    // not.
    let turning = (0..2_000).fold(String::from(UNKNOWN), |text, index| {
        let (y, z) = (0.005 * f64::from(index)).sin_cos();
        format!("{text}{},0,{},{},1,0,0\n", index * 5_000, 9.8 * y, 9.8 * z)
    });
    file("bench/unknown", "turning.csv", turning);
    file("bench/unknown", "resting.csv", resting(9.8));
    file("bench/counted", "resting.csv", resting(4_096.0));
    file("bench/uncounted", "resting.csv", resting(-4_096.0));
    // Truth does not make up for wrong units.
    let in_g = log(0.0, 0.0).replace("9.80665", "1");
    file("bench/units", "g.csv", in_g);
    let in_milliseconds = log(0.0, 0.0).replace("000,0,0,", ",0,0,");
    file("bench/units", "ms.csv", in_milliseconds);
    file("bench/units", "deg.csv", turned(57.295_78, 0.8));
    let (folder, output) = (path("bench", ""), path("bench-output", ""));
    let result = bench(&[
        folder.as_os_str(),
        "--output".as_ref(),
        output.as_os_str(),
        "--sensor-delay-us".as_ref(),
        "still=1000".as_ref(),
        "--counts=counted=8,250".as_ref(),
    ]);
    let printed = String::from_utf8(result.stdout).unwrap();
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{errors}");
    let reasons = [
        ("wrong/notes.txt", "no .csv"),
        ("wrong/other.csv", "it is no recording"),
        ("unknown/turning.csv", "does not lie still"),
        ("uncounted/resting.csv", "--counts SET=G,DPS"),
        (
            "units/g.csv",
            "the specific force is mostly 1.000, where about 9.8",
        ),
        ("units/ms.csv", "the time between rows is mostly 5.000"),
        ("units/deg.csv", "where up to 20 rad/s is usual: convert it"),
    ];
    for (name, reason) in reasons {
        let line = printed.lines().find(|line| line.contains(name));
        let line = line.unwrap_or_else(|| panic!("{name} is not in {printed}"));
        assert!(
            line.starts_with("not scored: ") && line.contains(reason),
            "{line}"
        );
    }
    assert_eq!(printed.matches("not scored: ").count(), reasons.len());
    assert!(printed.contains("still (1)"), "{printed}");
    assert!(
        printed.contains("still: samples are 1000 µs late"),
        "{printed}"
    );
    assert!(printed.contains("million/s"), "{printed}");
    let csv = std::fs::read_to_string(output.join("accuracy.csv")).unwrap();
    csv.lines().skip(1).for_each(check_row);
    check_names(&csv);
    let picture = std::fs::read(output.join("accuracy.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG"));
    let result = bench(&[
        folder.as_os_str(),
        "--sensor-delay-us=still=1000".as_ref(),
        "--counts=counted=8,250".as_ref(),
        "--json".as_ref(),
    ]);
    check_json(&result.stdout, &csv, reasons.len());
}

/// Rates in °/s that are too slow to be refused are a warning.
#[test]
fn rates_that_contradict_the_force_are_a_warning() {
    file("bench-slow/set", "slow.csv", turned(57.295_78, 0.2));
    file("bench-slow/set", "good.csv", turned(1.0, 0.2));
    let result = bench(&[path("bench-slow", "").as_os_str(), "--json".as_ref()]);
    let found: serde_json::Value = serde_json::from_slice(&result.stdout).unwrap();
    let [warning] = &found["warnings"].as_array().unwrap()[..] else {
        panic!("{found}")
    };
    let warning = warning.as_str().unwrap();
    assert!(
        warning.starts_with("set/slow.csv: the rates do not fit the force"),
        "{warning}"
    );
}

#[test]
fn a_malformed_recording_is_named() {
    let bad = file("bench-bad/set", "bad.csv", log(0.0, 0.0) + "1,2\n");
    let result = bench(&[path("bench-bad", "").as_os_str()]);
    assert_eq!(result.status.code(), Some(1));
    let message = String::from_utf8(result.stderr).unwrap();
    assert!(
        message.contains(&format!("{}:2002: ", bad.display())),
        "{message}"
    );
    let missing = bench(&["/no/such/folder"]);
    assert!(!missing.status.success());
}

#[test]
fn what_cannot_be_scored_ends_nothing_but_is_no_flight_either() {
    file("bench-some/set", "good.csv", log(0.0, 0.0));
    let bad = file("bench-some/set", "bad.csv", log(0.0, 0.0) + "1,2\n");
    let json = |path: &Path| bench(&[path.as_os_str(), "--json".as_ref()]);
    let result = json(&path("bench-some", ""));
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{errors}");
    let found: serde_json::Value = serde_json::from_slice(&result.stdout).unwrap();
    assert_eq!(found["scores"][0]["recording"], "good.csv");
    let [not_scored] = &found["not_scored"].as_array().unwrap()[..] else {
        panic!("{found}")
    };
    assert_eq!(not_scored["file"], bad.to_str().unwrap());
    assert_eq!(not_scored["line"], 2_002);
    // Whoever names something does not ask for simulated flights.
    let other = file("bench-none", "other.csv", "a,b\n1,2\n");
    for (named, reason) in [
        (other.as_path(), "it is no recording"),
        (&bad, "2 columns"),
        (&path("bench-nothing", ""), "no recording in it"),
    ] {
        let result = json(named);
        assert_eq!(result.status.code(), Some(1), "{}", named.display());
        assert!(result.stdout.is_empty());
        let message = String::from_utf8(result.stderr).unwrap();
        assert!(
            message.contains(named.to_str().unwrap()) && message.contains(reason),
            "{message}"
        );
    }
}

#[test]
fn what_is_scored_is_not_replaced() {
    let text = log(0.0, 0.0);
    let input = file("bench-over", "accuracy.csv", &text);
    let result = bench(&[
        input.as_os_str(),
        "--output".as_ref(),
        input.parent().unwrap().as_os_str(),
    ]);
    assert_eq!(result.status.code(), Some(1));
    assert_eq!(std::fs::read_to_string(input).unwrap(), text);
}

#[test]
fn without_recordings_flights_are_simulated_and_it_says_so() {
    let output = path("bench-simulated", "");
    // The folder has no folder of recordings beside it.
    let result = Command::new(env!("CARGO_BIN_EXE_aplomb-bench"))
        .args(["--output", "."])
        .current_dir(&output)
        .output()
        .unwrap();
    let printed = String::from_utf8(result.stdout).unwrap();
    assert!(result.status.success());
    assert!(printed.contains("simulated flights"), "{printed}");
    assert!(printed.contains("simulated (24)"), "{printed}");
    let csv = std::fs::read_to_string(output.join("accuracy.csv")).unwrap();
    assert!(
        csv.contains("simulated,flight 1000,truth,1900,vqf,"),
        "{csv}"
    );
    // From a file, the flight has the error of the simulated one.
    let mut log = format!("{LOG_HEADER}\n").into_bytes();
    for sample in samples(Box::new(Quadrotor::by_seed(1_000)), 1_000, 60) {
        sample.write_row(&mut log);
    }
    let log = file("bench-simulated/file", "flight.csv", log);
    let delay = "--sensor-delay-us=file=1900".as_ref();
    let accelerometer = "--accelerometer=factory".as_ref();
    let scored = bench(&[log.as_os_str(), delay, accelerometer, "--json".as_ref()]);
    let scored: serde_json::Value = serde_json::from_slice(&scored.stdout).unwrap();
    let start = "simulated,flight 1000,truth,1900,kalman,";
    let row = csv.lines().find(|row| row.starts_with(start)).unwrap();
    let cells: Vec<f64> = row[start.len()..]
        .split(',')
        .map(|cell| cell.parse().unwrap())
        .collect();
    let names = ["samples", "rms_deg", "p95_deg", "max_deg"];
    for (name, cell) in names.iter().zip(&cells) {
        let value = scored["scores"][0][format!("inclination_{name}")].as_f64();
        let value = value.unwrap_or_else(|| panic!("{name}: {scored}"));
        assert!((value - cell).abs() < 1e-6, "{name}: {value} and {cell}");
    }
}

#[test]
fn the_picture_is_drawn_by_one_command() {
    let picture = path("bench-picture", "flight.png");
    let result = bench(&["--picture".as_ref(), picture.as_os_str()]);
    assert!(result.status.success());
    assert!(std::fs::read(picture).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn gains_are_scanned_on_recordings_with_truth() {
    file("bench-scan/still", "a.csv", log(0.0, 0.0));
    let result = bench(&["--scan-gains".as_ref(), path("bench-scan", "").as_os_str()]);
    let printed = String::from_utf8(result.stdout).unwrap();
    assert!(result.status.success());
    assert_eq!(printed.matches("<- in use").count(), 4, "{printed}");
    for search in ["--scan-gains", "--leave-one-out"] {
        let empty = path("bench-empty", "");
        let nothing = bench(&[search.as_ref(), empty.as_os_str()]);
        assert_eq!(nothing.status.code(), Some(1));
    }
}

#[test]
fn wrong_usage_and_failures_have_the_documented_exit_codes() {
    for (arguments, code) in [
        (&["--json", "--scan-gains"][..], 2),
        (&["--counts", "x=8"], 2),
        (&["/no/such"], 1),
        (&["--version"], 0),
    ] {
        let result = bench(arguments);
        assert_eq!(result.status.code(), Some(code), "{arguments:?}");
        assert_eq!(result.stderr.is_empty(), code == 0, "{arguments:?}");
    }
}
