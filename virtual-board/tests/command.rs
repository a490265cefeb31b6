//! The command line.

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use common::firmware;

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::create_dir_all(&folder).unwrap();
    folder
}

fn fly(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_virtual-board"));
    command
        .arg("fly")
        .arg("--elf")
        .arg(firmware())
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn a_malformed_log_is_refused_with_file_line_and_reason_before_anything_runs() {
    let folder = folder("malformed");
    let output = folder.join("output");
    let log = folder.join("bad.csv");
    fs::write(
        &log,
        "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n1000,0,0,oops,0,0,0\n",
    )
    .unwrap();
    let refused = fly(&[
        "--log",
        log.to_str().unwrap(),
        "--output",
        output.to_str().unwrap(),
    ]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success());
    assert!(
        message.contains("bad.csv") && message.contains('3') && message.contains("oops"),
        "{message}"
    );
    assert!(!output.exists());
    assert!(!message.contains("flown"), "{message}");
}

#[test]
fn a_recording_flies_until_it_ends() {
    let folder = folder("recording");
    let log = folder.join("log.csv");
    let rows: String = (0..200)
        .map(|row| format!("{},0,0,9.80665,0,0,0,1,0,0,0\n", row * 5000))
        .collect();
    fs::write(&log, format!("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz\n{rows}")).unwrap();
    let flown = fly(&[
        "--log",
        log.to_str().unwrap(),
        "--output",
        folder.to_str().unwrap(),
    ]);
    assert!(
        flown.status.success(),
        "{}",
        String::from_utf8_lossy(&flown.stderr)
    );
    let summary = fs::read_to_string(folder.join("summary.json")).unwrap();
    // Three seconds of rest, one of turning, and 199 intervals of 5 ms.
    assert!(summary.contains("\"virtual_seconds\": 4.995,"), "{summary}");
    assert!(summary.contains("\"missed\": 0,"), "{summary}");
    assert!(
        !summary.contains("\"inclination_rms_deg\": null"),
        "{summary}"
    );
    let shown = String::from_utf8_lossy(&flown.stdout).into_owned();
    assert!(
        shown.contains("gyroscope's offset measured, ready"),
        "the log is shown: {shown}"
    );
    assert!(shown.contains("edge to attitude"), "and the table: {shown}");
}

#[test]
fn without_truth_there_are_no_scores() {
    let folder = folder("no truth");
    let log = folder.join("log.csv");
    let rows: String = (0..50)
        .map(|row| format!("{},0,0,9.80665,0,0,0\n", row * 5000))
        .collect();
    fs::write(&log, format!("t_us,ax,ay,az,gx,gy,gz\n{rows}")).unwrap();
    let flown = fly(&[
        "--log",
        log.to_str().unwrap(),
        "--output",
        folder.to_str().unwrap(),
    ]);
    assert!(
        flown.status.success(),
        "{}",
        String::from_utf8_lossy(&flown.stderr)
    );
    let summary = fs::read_to_string(folder.join("summary.json")).unwrap();
    assert!(
        summary.contains("\"inclination_rms_deg\": null,"),
        "{summary}"
    );
    assert!(
        summary.contains("\"inclination_max_deg\": null,"),
        "{summary}"
    );
}

#[test]
fn options_that_make_no_sense_are_refused() {
    for (arguments, reason) in [
        (["--mount", "+x+x"], "no such mount"),
        (["--board", "toaster"], "no such board"),
        (["--seconds", "0"], "above 0"),
    ] {
        let refused = fly(&arguments);
        let message = String::from_utf8_lossy(&refused.stderr).into_owned();
        assert!(
            !refused.status.success() && message.contains(reason),
            "{arguments:?}: {message}"
        );
    }
}

#[test]
fn a_file_that_is_no_image_is_refused() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_virtual-board"));
    let refused = command
        .args(["fly", "--elf", file!()])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(!refused.status.success());
    assert!(!String::from_utf8_lossy(&refused.stderr).is_empty());
}
