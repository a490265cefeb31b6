//! `aplomb bench` from the outside.

mod common;

use std::fmt::Write as _;

use common::{aplomb, file, path};

/// Ten seconds at 200 Hz of a sensor that lies still, tilted by this much about x, with this much offset in the accelerometer's y.
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

#[test]
fn every_filter_is_scored_on_every_recording_with_truth() {
    file("bench/still", "a.csv", log(0.0, 0.0));
    // An accelerometer that errs by 3° makes every filter err by 3°.
    file(
        "bench/wrong",
        "b.csv",
        log(0.0, 9.80665 * 3_f64.to_radians().tan()),
    );
    file(
        "bench/wrong",
        "without-truth.csv",
        "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n",
    );
    file("bench/wrong", "notes.txt", "no recording");
    let (folder, output) = (path("bench", ""), path("bench-output", ""));
    let result = aplomb(&[
        "bench".as_ref(),
        folder.as_os_str(),
        "--output".as_ref(),
        output.as_os_str(),
        "--sensor-delay-us".as_ref(),
        "still=1000".as_ref(),
    ]);
    let printed = String::from_utf8(result.stdout).unwrap();
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{errors}");
    assert!(printed.contains("1 of 3 files have no truth"), "{printed}");
    assert!(printed.contains("still (1)"), "{printed}");
    assert!(
        printed.contains("still: samples are 1000 µs late"),
        "{printed}"
    );
    assert!(printed.contains("million/s"), "{printed}");
    let csv = std::fs::read_to_string(output.join("accuracy.csv")).unwrap();
    let mut filters = 0;
    for line in csv.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let rms: f64 = cells[5].parse().unwrap();
        assert_eq!(cells[4], "1000", "rows after 5 s: {line}");
        match cells[..3] {
            ["still", "a.csv", "1000"] => assert!(rms < 0.05, "{line}"),
            // It starts there or comes from level, within ten seconds.
            ["wrong", "b.csv", "0"] => assert!((2.0..3.5).contains(&rms), "{line}"),
            _ => panic!("{line}"),
        }
        filters += 1;
    }
    assert!(filters >= 14 && filters % 2 == 0, "{filters}");
    let picture = std::fs::read(output.join("accuracy.png")).unwrap();
    assert!(picture.starts_with(b"\x89PNG"));
}

#[test]
fn a_malformed_recording_is_named() {
    let bad = file("bench-bad/set", "bad.csv", log(0.0, 0.0) + "1,2\n");
    let result = aplomb(&["bench".as_ref(), path("bench-bad", "").as_os_str()]);
    assert_eq!(result.status.code(), Some(1));
    let message = String::from_utf8(result.stderr).unwrap();
    assert!(
        message.contains(&format!("{}:2002: ", bad.display())),
        "{message}"
    );
    let missing = aplomb(&["bench", "/no/such/folder"]);
    assert!(!missing.status.success());
}

#[test]
fn without_recordings_flights_are_simulated_and_it_says_so() {
    let empty = path("bench-empty", "");
    let output = path("bench-simulated", "");
    let result = aplomb(&[
        "bench".as_ref(),
        empty.as_os_str(),
        "--output".as_ref(),
        output.as_os_str(),
    ]);
    let printed = String::from_utf8(result.stdout).unwrap();
    assert!(result.status.success());
    assert!(printed.contains("simulated flights"), "{printed}");
    assert!(printed.contains("simulated (8)"), "{printed}");
    let csv = std::fs::read_to_string(output.join("accuracy.csv")).unwrap();
    assert!(csv.contains("simulated,flight 1000,1900,vqf,"), "{csv}");
}
