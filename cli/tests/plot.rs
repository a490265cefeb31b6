//! `aplomb plot` and `aplomb simulate` from the outside.

mod common;

use std::path::{Path, PathBuf};
use std::process::Command;

use aplomb_models::motion::Mount;
use aplomb_recordings::motion::Recording;
use common::{aplomb, file, path};

/// Runs it with these arguments, and gives what it printed.
fn run(arguments: &[&str]) -> String {
    let result = aplomb(arguments);
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(result.status.success(), "{arguments:?}: {errors}");
    String::from_utf8(result.stdout).unwrap()
}

fn refused(arguments: &[&str], reason: &str) {
    ended_with(1, arguments, reason);
}

fn ended_with(code: i32, arguments: &[&str], reason: &str) {
    let result = aplomb(arguments);
    assert_eq!(result.status.code(), Some(code), "{arguments:?}");
    let errors = String::from_utf8_lossy(&result.stderr);
    assert!(errors.contains(reason), "{errors}");
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Writes a simulated motion.
fn simulate(test: &str, name: &str, options: &[&str]) -> PathBuf {
    let output = path(test, name);
    let mut arguments = vec!["simulate", "--output", text(&output)];
    arguments.extend(options);
    run(&arguments);
    output
}

/// Returns the texts of an SVG, and the number of points of its curves.
fn words(svg: &Path) -> (Vec<String>, usize) {
    let svg = std::fs::read_to_string(svg).unwrap();
    assert!(svg.starts_with("<svg") && svg.ends_with("</svg>\n"));
    let texts = svg.lines().filter(|line| line.starts_with("<text"));
    let texts = texts.map(|line| {
        let inner = &line[line.find('>').unwrap() + 1..];
        inner.strip_suffix("</text>").unwrap().to_owned()
    });
    let curves = svg.lines().filter(|line| line.starts_with("<polyline"));
    let points = curves.map(|line| line.matches(',').count()).sum();
    (texts.collect(), points)
}

#[test]
fn a_simulated_motion_is_one_by_its_seed() {
    let read = |path: &Path| std::fs::read(path).unwrap();
    let seconds = ["--seconds", "8"];
    let seeded = |name: &str, seed: &str| {
        let options = [&seconds[..], &["--seed", seed]].concat();
        read(&simulate("seeds", name, &options))
    };
    let first = seeded("a.csv", "3");
    assert!(first == seeded("b.csv", "3"));
    assert!(first != seeded("c.csv", "4"));
    for kind in ["swing", "rest", "poses"] {
        let options = [&seconds[..], &["--seed", "3", "--kind", kind]].concat();
        assert!(
            read(&simulate("seeds", "kind.csv", &options)) != first,
            "{kind}"
        );
    }
    let rows = String::from_utf8(first).unwrap();
    let mut lines = rows.lines();
    assert_eq!(lines.next(), Some("# --accelerometer factory"));
    assert_eq!(lines.next(), Some("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov"));
    assert_eq!(lines.clone().count(), 8_000);
    let (first, last) = (lines.next().unwrap(), lines.next_back().unwrap());
    assert!(first.starts_with("1000,") && last.starts_with("8000000,") && last.ends_with(",1"));
}

#[test]
fn what_is_simulated_flies_and_is_replayed() {
    for kind in ["flight", "swing", "rest", "poses"] {
        let options = ["--kind", kind, "--seconds", "10"];
        let log = simulate("round", &format!("{kind}.csv.gz"), &options);
        assert!(std::fs::read(&log).unwrap().starts_with(&[0x1F, 0x8B]));
        // What `fly --log` reads it with.
        let recording = Recording::open(&log, Mount::Z_UP).unwrap();
        assert!(recording.end_s() > 10.0, "{kind}");
        let printed = run(&["replay", text(&log), "--sensor-delay-us", "1900", "--json"]);
        let summary: serde_json::Value = serde_json::from_str(&printed).unwrap();
        assert_eq!(summary["samples"], 10_000);
        let rms = summary["inclination_rms_deg"].as_f64().unwrap();
        assert!((0.01..3.0).contains(&rms), "{kind}: {rms}");
    }
}

#[test]
fn a_simulated_accelerometer_is_as_good_as_its_calibration() {
    let error_deg = |knowledge: &str| {
        let accelerometer = ["--accelerometer", knowledge];
        let options = [&["--kind", "rest", "--seconds", "10"][..], &accelerometer].concat();
        let log = simulate("knowledge", &format!("{knowledge}.csv"), &options);
        let replay = ["replay", text(&log), "--json", "--sensor-delay-us", "1900"];
        let printed = run(&[&replay[..], &accelerometer].concat());
        let summary: serde_json::Value = serde_json::from_str(&printed).unwrap();
        summary["inclination_rms_deg"].as_f64().unwrap()
    };
    // At rest the tilt errs by the accelerometer's offset, and six poses leave cross-axis terms.
    let [factory, six, twelve] = ["factory", "six-poses", "calibrated"].map(error_deg);
    assert!(
        factory > 2.0 * six && six > 4.0 * twelve,
        "{factory} {six} {twelve}"
    );
}

#[test]
fn a_simulated_recording_states_the_knowledge_of_its_sensor() {
    let within = |log: &Path, options: &[&str]| {
        let replay = ["replay", text(log), "--json", "--sensor-delay-us", "1900"];
        let printed = run(&[&replay[..], options].concat());
        let summary: serde_json::Value = serde_json::from_str(&printed).unwrap();
        (summary["within_3_sigma"].as_f64().unwrap(), printed)
    };
    let options = ["--seed", "2004", "--seconds", "30"];
    let factory = simulate("stated", "factory.csv.gz", &options);
    let (share, stated) = within(&factory, &[]);
    assert!(share > 0.99, "{share}");
    assert_eq!(stated, within(&factory, &["--accelerometer", "factory"]).1);
    // An option has precedence.
    let (small, _) = within(&factory, &["--accelerometer", "calibrated"]);
    assert!(small < share - 0.05, "{small}");
    let mut poses = options.to_vec();
    poses.extend(["--accelerometer", "six-poses"]);
    let poses = simulate("stated", "six-poses.csv", &poses);
    let (_, stated) = within(&poses, &[]);
    assert_eq!(stated, within(&poses, &["--accelerometer", "six-poses"]).1);
}

#[test]
fn a_file_is_zipped_whatever_the_case_of_its_name() {
    let upper = simulate("zipped", "upper.csv.GZ", &["--seconds", "1"]);
    assert!(std::fs::read(upper).unwrap().starts_with(&[0x1F, 0x8B]));
}

#[test]
fn a_picture_of_a_flight_has_everything() {
    let log = simulate("plot", "flight.csv", &["--seconds", "20"]);
    let delay = ["--sensor-delay-us", "1900"];
    let (svg, png) = (path("plot", "flight.svg"), path("plot", "flight.png"));
    let plot = ["plot", text(&log), "--output"];
    let printed = run(&[&plot[..], &[text(&svg)], &delay].concat());
    assert!(printed.contains("20000 rows in 20.0 s"), "{printed}");
    assert!(printed.contains("peak at"), "{printed}");
    let (words, points) = words(&svg);
    for word in [
        "flight.csv",
        "roll (degrees)",
        "pitch (degrees)",
        "yaw, relative (degrees)",
        "body rates (degrees per second)",
        "inclination error (degrees)",
        "within 3 sigma",
        "truth",
        "valid",
        "calibrating",
        "frequency (Hz)",
    ] {
        assert!(words.iter().any(|other| other == word), "{word}: {words:?}");
    }
    // The peak that is marked is the one that is printed.
    let peak = words.iter().find(|word| word.ends_with(" Hz")).unwrap();
    assert!(printed.contains(&format!("peak at {peak}")), "{printed}");
    assert!((5_000..60_000).contains(&points), "{points}");
    run(&[&plot[..], &[text(&png)], &delay].concat());
    assert!(std::fs::read(png).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn attitudes_are_drawn_with_a_truth_of_their_own_file() {
    let log = simulate("truth", "flight.csv", &["--seconds", "12"]);
    let attitudes = path("truth", "attitude.csv");
    let delay = ["--sensor-delay-us", "1900"];
    run(&[
        &["replay", text(&log), "--output", text(&attitudes)],
        &delay[..],
    ]
    .concat());
    let svg = path("truth", "picture.svg");
    let plot = ["plot", text(&attitudes), "--output", text(&svg)];
    let without = run(&plot);
    assert!(without.contains("no spectrum"), "{without}");
    assert!(!words(&svg).0.contains(&"truth".to_owned()));
    let with = run(&[&plot[..], &["--truth", text(&log)]].concat());
    assert!(words(&svg).0.contains(&"truth".to_owned()));
    // The same error as that of the log itself, in which its truth is.
    let of_log = run(&[&["plot", text(&log), "--output", text(&svg)], &delay[..]].concat());
    let error = |printed: &str| {
        let (_, after) = printed.split_once("inclination error ").unwrap();
        after
            .split_once(';')
            .map_or(after.trim(), |(error, _)| error)
            .to_owned()
    };
    assert_eq!(error(&with), error(&of_log));
    // The truth of another time is none.
    let late = std::fs::read_to_string(&log)
        .unwrap()
        .lines()
        .nth(1)
        .expect("a header")
        .to_owned()
        + "\n99000000,0,0,9.8,0,0,0,1,0,0,0,1\n";
    let late = file("truth", "late.csv", late);
    refused(
        &[&plot[..], &["--truth", text(&late)]].concat(),
        "none of its times",
    );
}

/// Returns the printed root mean square, degrees.
fn plotted_rms(printed: &str) -> f64 {
    let (_, after) = printed.split_once("inclination error ").expect(printed);
    after.split_once(' ').unwrap().0.parse().unwrap()
}

#[test]
fn the_error_is_that_of_replay() {
    let delay = ["--sensor-delay-us", "1900"];
    // With rows that do not count, and with an error at the start.
    let log = simulate("same", "flight.csv", &["--seconds", "12"]);
    let attitudes = path("same", "attitude.csv");
    let replay = ["replay", text(&log), "--json", "--output", text(&attitudes)];
    let replayed = run(&[&replay[..], &delay].concat());
    let summary: serde_json::Value = serde_json::from_str(&replayed).unwrap();
    let rms = summary["inclination_rms_deg"].as_f64().unwrap();
    let svg = path("same", "picture.svg");
    let output = ["--output", text(&svg)];
    let of_log = run(&[&["plot", text(&log)][..], &output, &delay].concat());
    assert!(
        (plotted_rms(&of_log) - rms).abs() < 0.0051,
        "{of_log} {rms}"
    );
    // The truth of a flight says which rows are scored.
    let mut truth = String::from("t_us,qw,qx,qy,qz,scored\n");
    for line in std::fs::read_to_string(&attitudes).unwrap().lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        let t_us: u32 = cells[0].parse().unwrap();
        // Half a turn off, where it does not count.
        let (attitude, scored) = match t_us % 4_000 {
            0 => ("0,1,0,0".to_owned(), 0),
            _ => (cells[1..5].join(","), 1),
        };
        truth += &format!("{t_us},{attitude},{scored}\n");
    }
    let truth = file("same", "truth.csv", truth);
    let plot = ["plot", text(&attitudes), "--truth", text(&truth)];
    let printed = run(&[&plot[..], &output].concat());
    assert!(plotted_rms(&printed) < 0.005, "{printed}");
    // A table without flags is not called invalid.
    let printed = run(&[&["plot", text(&truth)][..], &output].concat());
    assert!(!printed.contains("valid"), "{printed}");
}

#[test]
fn the_truth_of_a_flight_log_is_seen_through_its_own_mount() {
    // Recorded face up, and its flight log says so or the opposite.
    let log = simulate("mounted", "flight.csv", &["--seconds", "8"]);
    let svg = path("mounted", "picture.svg");
    for mount in ["z-up", "z-down", "+y-z"] {
        let flight = path("mounted", "flight.log");
        run(&["convert", text(&log), text(&flight), "--mount", mount]);
        let plot = [
            "plot",
            text(&flight),
            "--truth",
            text(&log),
            "--output",
            text(&svg),
        ];
        let printed = run(&plot);
        assert!(plotted_rms(&printed) < 3.0, "{mount}: {printed}");
    }
}

#[test]
fn bursts_and_flight_logs_are_drawn_too() {
    let log = simulate("kinds", "flight.csv", &["--seconds", "5"]);
    for name in ["flight.log", "flight-bursts.csv"] {
        let converted = path("kinds", name);
        run(&["convert", text(&log), text(&converted)]);
        let svg = path("kinds", "picture.svg");
        let printed = run(&["plot", text(&converted), "--output", text(&svg)]);
        assert!(printed.contains("5000 rows in 5.0 s"), "{name}: {printed}");
        assert!(
            words(&svg).0.contains(&"frequency (Hz)".to_owned()),
            "{name}"
        );
    }
}

#[test]
fn what_cannot_be_drawn_is_refused() {
    let log = simulate("refused", "flight.csv", &["--seconds", "1"]);
    let plot = ["plot", text(&log), "--output"];
    ended_with(
        2,
        &[&plot[..], &["picture.jpg"]].concat(),
        "has to end with .png or .svg",
    );
    refused(
        &[&plot[..], &["/no/such/folder/x.png"]].concat(),
        "there is no folder",
    );
    let bad = file(
        "refused",
        "bad.csv",
        "t_us,qw,qx,qy,qz\n1,1,0,0,0\n2,1,0,x,0\n",
    );
    refused(&["plot", text(&bad)], "bad.csv:3: \"x\" is not a number");
    let empty = file("refused", "empty.csv", "");
    refused(&["plot", text(&empty)], "empty");
    let no_rows = file("refused", "none.csv", "t_us,qw,qx,qy,qz\n");
    refused(&["plot", text(&no_rows)], "no row");
    // An input is never replaced.
    let named = path("refused", "log.svg");
    std::fs::copy(&log, &named).unwrap();
    refused(
        &["plot", text(&named), "--output", text(&named)],
        "replace the input",
    );
    refused(
        &[
            "plot",
            text(&log),
            "--truth",
            text(&named),
            "--output",
            text(&named),
        ],
        "replace the input",
    );
}

#[test]
fn the_truth_of_a_file_goes_before_that_of_the_recording() {
    let input = path("truths", "flight.csv");
    let (input, picture) = (input.to_str().unwrap(), path("truths", "flight.png"));
    let picture = picture.to_str().unwrap();
    let simulated = aplomb(&["simulate", "--seconds", "8", "--output", input]);
    assert!(simulated.status.success());
    let other = path("truths", "other.csv");
    std::fs::copy(input, &other).unwrap();
    let other = other.to_str().unwrap();
    let errors = |more: &[&str]| {
        let drawn = aplomb(&[&["plot", input, "--output", picture], more].concat());
        assert!(drawn.status.success());
        String::from_utf8(drawn.stderr).unwrap()
    };
    assert_eq!(errors(&[]), "");
    let expected = format!("note: the truth is that of {other}, not that of {input}\n");
    assert_eq!(errors(&["--truth", other]), expected);
}

#[test]
fn a_magnet_after_the_end_is_refused() {
    let output = path("magnet", "magnet.csv");
    let output = output.to_str().unwrap();
    for (at_s, is_refused) in [("3", false), ("4", true)] {
        let arguments = [
            "simulate",
            "--seconds",
            "3",
            "--compass",
            "calibrated",
            "--magnet",
            at_s,
        ];
        let result = aplomb(&[&arguments[..], &["--output", output]].concat());
        let errors = String::from_utf8(result.stderr).unwrap();
        assert_eq!(errors.contains("is after the end"), is_refused, "{errors}");
    }
}

/// The unit of times is that of the recording, whether it is the input or its truth.
#[test]
fn a_truth_has_the_unit_of_times_of_the_recording() {
    let log = simulate("time-unit", "flight.csv", &["--seconds", "12"]);
    let attitudes = path("time-unit", "attitude.csv");
    run(&["replay", text(&log), "--output", text(&attitudes)]);
    let microseconds = std::fs::read_to_string(&log).unwrap();
    let in_ms = microseconds.lines().fold(String::new(), |mut rows, row| {
        match row.split_once(',') {
            Some((t_us, rest)) if t_us.ends_with("000") => {
                rows += &format!("{},{rest}\n", &t_us[..t_us.len() - 3]);
            }
            Some(("0", rest)) => rows += &format!("0,{rest}\n"),
            _ => rows += &format!("{row}\n"),
        }
        rows
    });
    let slow = file("time-unit", "slow.csv", in_ms);
    let picture = path("time-unit", "picture.svg");
    let output = ["--output", text(&picture)];
    let error_of = |printed: &str| {
        let (_, error) = printed.split_once("inclination error").unwrap();
        error.split_once(';').unwrap().0.to_owned()
    };
    let plot =
        |input: &Path, more: &[&str]| run(&[&["plot", text(input)][..], &output, more].concat());
    let expected = error_of(&plot(&log, &["--truth", text(&log)]));
    let in_ms = ["--truth", text(&slow), "--time-unit", "ms"];
    assert_eq!(error_of(&plot(&slow, &in_ms)), expected);
    assert_eq!(error_of(&plot(&attitudes, &in_ms)), expected);
    let arguments = ["plot", text(&attitudes), "--truth", text(&attitudes)];
    let result = aplomb(&[&arguments[..], &["--time-unit", "ms"]].concat());
    let message = String::from_utf8_lossy(&result.stderr);
    assert_eq!(result.status.code(), Some(2), "{message}");
    assert!(
        message.contains("--time-unit would change nothing"),
        "{message}"
    );
}

/// A pipe can be read once.
#[test]
fn a_truth_on_standard_input_is_read_once() {
    let log = simulate("pipe", "flight.csv", &["--seconds", "12"]);
    let attitudes = path("pipe", "attitude.csv");
    run(&["replay", text(&log), "--output", text(&attitudes)]);
    let svg = path("pipe", "picture.svg");
    let plot = |input: &str, truth: &Path, more: &[&str]| {
        let result = Command::new(env!("CARGO_BIN_EXE_aplomb"))
            .args(["plot", input, "--truth", "-", "--output", text(&svg)])
            .args(more)
            .stdin(std::fs::File::open(truth).unwrap())
            .output()
            .unwrap();
        let printed = [result.stdout, result.stderr].concat();
        (result.status.code(), String::from_utf8(printed).unwrap())
    };
    let (code, without) = plot(text(&attitudes), &log, &[]);
    assert_eq!(code, Some(0), "{without}");
    let with = plot(text(&attitudes), &log, &["--time-unit", "us"]);
    assert_eq!(with, (Some(0), without));
    let (code, refused) = plot(text(&attitudes), &attitudes, &["--time-unit", "us"]);
    assert_eq!(code, Some(2), "{refused}");
    assert!(refused.contains("would change nothing"), "{refused}");
    let (code, refused) = plot("-", &log, &[]);
    assert_eq!(code, Some(2), "{refused}");
    assert!(
        refused.contains("cannot both be standard input"),
        "{refused}"
    );
}
