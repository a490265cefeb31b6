//! `aplomb replay` and `aplomb plot` on recordings that clip or vibrate too much.

mod common;

use std::fmt::Write as _;

use common::{aplomb, file, path};

const GRAVITY: f64 = 9.80665;

/// Returns the log of a sensor that rolls to and fro by 60°, sampled at 200 Hz. Its rates reach
/// 260 °/s but stop at this limit, and it has a vibration of this amplitude.
fn log(limit_deg_s: f64, vibration_g: f64) -> String {
    let mut text = "t_us,ax,ay,az,gx,gy,gz\n".to_owned();
    for row in 0..2_000 {
        let time_s = f64::from(row) * 0.005;
        let (since_s, omega) = ((time_s - 1.0).max(0.0), 4.3);
        let roll = 60_f64.to_radians() * (1.0 - (omega * since_s).cos());
        let rate = 60_f64.to_radians() * omega * (omega * since_s).sin();
        let limit = limit_deg_s.to_radians();
        let shake = vibration_g * GRAVITY * (397.0 * time_s).sin();
        let force_y = GRAVITY * roll.sin() + shake;
        writeln!(
            text,
            "{},0,{force_y:.4},{:.4},{:.6},0,0",
            row * 5_000,
            GRAVITY * roll.cos(),
            rate.clamp(-limit, limit)
        )
        .unwrap();
    }
    text
}

fn run(arguments: &[&str]) -> String {
    let result = aplomb(arguments);
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{errors}");
    String::from_utf8(result.stdout).unwrap()
}

#[test]
fn clipped_samples_are_reported_and_flagged_as_saturated() {
    let whole = file("warnings", "whole.csv", log(1_000.0, 0.0));
    let printed = run(&["replay", whole.to_str().unwrap()]);
    assert!(!printed.contains("clipped"), "{printed}");
    assert!(!printed.contains("SATURATED"), "{printed}");

    let clipped = file("warnings", "clipped.csv", log(200.0, 0.0));
    let printed = run(&["replay", clipped.to_str().unwrap()]);
    let message = "clipped: gyroscope gx at 200.00 °/s in ";
    assert!(printed.contains(message), "{printed}");
    assert!(printed.contains("; gyroscope gx at -200.00 °/s in "));
    let (_, flagged) = printed.split_once("GYROSCOPE_SATURATED: ").unwrap();
    let flagged: u32 = flagged.split_once(" rows").unwrap().0.parse().unwrap();
    assert!(flagged > 500, "{printed}");
    assert!(!printed.contains("ACCELEROMETER_SATURATED"), "{printed}");

    let json = run(&["replay", clipped.to_str().unwrap(), "--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let warning = json["warnings"][0].as_str().unwrap();
    assert!(warning.starts_with(message), "{json}");

    let picture = path("warnings", "clipped.png");
    let (input, output) = (clipped.to_str().unwrap(), picture.to_str().unwrap());
    let printed = run(&["plot", input, "--output", output]);
    assert!(printed.contains(message), "{printed}");
}

#[test]
fn vibration_is_reported_when_it_is_too_strong() {
    for (amplitude_g, is_too_strong) in [(3.0, false), (10.0, true)] {
        let input = file("warnings", "shaken.csv", log(1_000.0, amplitude_g));
        let printed = run(&["replay", input.to_str().unwrap()]);
        let message = "vibration too strong: 7.1 g rms at ";
        assert_eq!(printed.contains(message), is_too_strong, "{printed}");
    }
}

/// Returns a simulated flight whose columns keep their values from 15 s to 20 s.
fn stuck(columns: &[usize]) -> String {
    let flight = path("warnings", "flight.csv");
    let output = flight.to_str().unwrap();
    run(&["simulate", "--seconds", "25", "--output", output]);
    let text = std::fs::read_to_string(&flight).unwrap();
    let table = text.lines().skip(1);
    let mut rows: Vec<Vec<&str>> = table.map(|row| row.split(',').collect()).collect();
    let held = rows[15_000].clone();
    for row in &mut rows[15_001..20_000] {
        for &column in columns {
            row[column] = held[column];
        }
    }
    let rows: Vec<String> = rows.into_iter().map(|row| row.join(",")).collect();
    rows.join("\n")
}

#[test]
fn a_stuck_axis_of_a_recording_is_frozen_like_that_of_bursts() {
    // From 0.26 s after the start of the motion to one window after its end.
    for (columns, frozen) in [
        (&[][..], 0..1),
        (&[4], 4_500..5_200),
        (&[1], 4_500..5_200),
        (&[4, 5, 6], 4_500..5_200),
        (&[1, 2, 3, 4, 5, 6], 4_880..4_920),
    ] {
        let input = file("warnings", "stuck.csv", stuck(columns));
        let printed = run(&["replay", input.to_str().unwrap(), "--json"]);
        let json: serde_json::Value = serde_json::from_str(&printed).unwrap();
        let rows = json["flags"]["FROZEN"].as_u64().unwrap_or(0);
        assert!(frozen.contains(&rows), "{columns:?}: {rows}");
    }
}

#[test]
fn rates_that_do_not_fit_the_force_are_reported() {
    let input = file("warnings", "rolls.csv", log(1_000.0, 0.0));
    let picture = path("warnings", "rolls.png");
    let (input, picture) = (input.to_str().unwrap(), picture.to_str().unwrap());
    for command in [
        &["replay", input][..],
        &["plot", input, "--output", picture],
    ] {
        let errors = |more: &[&str]| {
            let result = aplomb(&[command, more].concat());
            assert!(result.status.success());
            String::from_utf8(result.stderr).unwrap()
        };
        assert_eq!(errors(&[]), "");
        let warning = errors(&["--rate-unit", "deg/s"]);
        assert_eq!(warning.lines().count(), 1, "{warning}");
        let expected = "turns about x of the force, the gyroscope turns otherwise, mostly by 0.02";
        assert!(warning.contains(expected), "{warning}");
        assert!(warning.contains("--rate-unit"), "{warning}");
    }
}
