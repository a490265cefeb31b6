//! `aplomb replay --calibration`: the calibration of one recording, applied to another.

mod common;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use common::{aplomb, file, path};

const GRAVITY: f64 = 9.80665;
/// Distortion of the accelerometer: offset in m/s² and scale, per axis.
const OFFSET_M_S2: [f64; 3] = [0.6, -0.5, 0.4];
const SCALE: [f64; 3] = [1.03, 0.97, 1.02];
/// Distortion of the gyroscope about x.
const RATE_SCALE: f64 = 1.04;
/// Distortion of the compass: its y axis points to minus x, and iron is fixed to it.
const IRON_UT: [f64; 3] = [120.0, -80.0, 60.0];

/// A row in true values.
struct Moment {
    roll_rad: f64,
    force_m_s2: [f64; 3],
    rate_x_rad_s: f64,
}

impl Moment {
    /// A sensor face up that rests for 3 s and then rolls to and fro by 30°, at 100 Hz.
    fn new(index: u32) -> Self {
        let time_s = (f64::from(index) * 0.01 - 3.0).max(0.0);
        let roll_rad = 30_f64.to_radians() * (1.0 - time_s.cos());
        Self {
            roll_rad,
            force_m_s2: [0.0, GRAVITY * roll_rad.sin(), GRAVITY * roll_rad.cos()],
            rate_x_rad_s: 30_f64.to_radians() * time_s.sin(),
        }
    }

    /// Returns the readings of the distorted sensor.
    fn readings(&self) -> ([f64; 3], f64) {
        let read = |axis: usize| self.force_m_s2[axis] / SCALE[axis] + OFFSET_M_S2[axis];
        ([read(0), read(1), read(2)], self.rate_x_rad_s / RATE_SCALE)
    }
}

/// Writes the calibration of the distorted sensor as `aplomb calibrate --json` does.
fn calibration(test: &str) -> PathBuf {
    let [x, y, z] = SCALE;
    let json = format!(
        "{{\"rule\":\"rest\",\"poses\":12,\"offset_m_s2\":{OFFSET_M_S2:?},\
         \"matrix\":[[{x},0,0],[0,{y},0],[0,0,{z}]],\"cross_axis_fitted\":true,\
         \"gyroscope\":{{\"turns\":12,\"matrix\":[[{RATE_SCALE},0,0],[0,1,0],[0,0,1]]}},\
         \"compass\":{{\"readings\":900,\"matrix\":[[0,-1,0],[1,0,0],[0,0,1]],\
         \"hard_iron_ut\":{IRON_UT:?}}}}}"
    );
    file(test, "calibration.json", json)
}

fn run(arguments: &[&str]) -> Result<String, String> {
    let result = aplomb(arguments);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("text");
    if result.status.success() {
        Ok(text(result.stdout))
    } else {
        Err(text(result.stderr))
    }
}

/// Replays a file with these options, and returns a column of the attitudes.
fn column(test: &str, input: &Path, options: &[&str], name: &str) -> Vec<f64> {
    let output = path(test, "attitude.csv");
    let mut arguments = vec!["replay", input.to_str().expect("a path")];
    arguments.extend(["--output", output.to_str().expect("a path")]);
    arguments.extend(options);
    run(&arguments).expect("a replay");
    let text = std::fs::read_to_string(output).expect("attitudes");
    let mut lines = text.lines();
    let header = lines.next().expect("a header");
    let place = header.split(',').position(|column| column == name);
    let place = place.expect(name);
    let field = |line: &str| {
        line.split(',')
            .nth(place)
            .and_then(|text| text.parse().ok())
    };
    lines.map(|line| field(line).unwrap_or(f64::NAN)).collect()
}

/// The true roll is the oracle: positive about forward, as the sensor rolls.
#[test]
fn every_form_of_recording_is_corrected() {
    const TEST: &str = "calibrated-forms";
    const ROWS: u32 = 1_500;
    let mut values = "t_us,ax,ay,az,gx,gy,gz\n".to_owned();
    let mut counts = values.clone();
    let mut bursts = "t_us,bytes,flags\n".to_owned();
    for index in 0..ROWS {
        let ([x, y, z], rate) = Moment::new(index).readings();
        let t_us = index * 10_000;
        // No value repeats for long, as if the sensor were frozen.
        let noise = f64::from(index * 7 % 11 % 5) * 0.002;
        let [x, y, z] = [x + noise, y - noise, z + noise];
        let rates = [rate + noise * 0.1, noise * 0.1, -noise * 0.1];
        let [p, q, r] = rates;
        writeln!(values, "{t_us},{x:.5},{y:.5},{z:.5},{p:.6},{q:.6},{r:.6}").expect("text");
        let force = |counts_per_g: f64| {
            [x, y, z].map(|value| (value / GRAVITY * counts_per_g).round() as i16)
        };
        let rates = rates.map(|rate| (rate.to_degrees() * 16.384).round() as i16);
        let ([x, y, z], [p, q, r]) = (force(4_096.0), rates);
        writeln!(counts, "{t_us},{x},{y},{z},{p},{q},{r}").expect("text");
        // The module's full scale is 16 g.
        let words = force(2_048.0).into_iter().chain([0]).chain(rates);
        let bytes: String = words.map(|word| format!("{:04x}", word as u16)).collect();
        writeln!(bursts, "{t_us},{bytes},").expect("text");
    }
    let calibration = calibration(TEST);
    let calibrated = ["--calibration", calibration.to_str().expect("a path")];
    let raw = ["--raw", "--accel-range", "8", "--gyro-range", "2000"];
    for (name, text, form) in [
        ("values.csv", values, &[][..]),
        ("counts.csv", counts, &raw),
        ("bursts.csv", bursts, &[]),
    ] {
        let input = file(TEST, name, text);
        let worst = |options: &[&str]| {
            let roll = column(TEST, &input, options, "roll_deg");
            let errors = roll.iter().zip(0..).skip(300).map(|(roll, index)| {
                (roll.abs() - Moment::new(index).roll_rad.to_degrees().abs()).abs()
            });
            errors.fold(
                0.0,
                |worst: f64, error| if error > worst { error } else { worst },
            )
        };
        let (before, after) = (worst(form), worst(&[form, &calibrated[..]].concat()));
        assert!(before > 2.0, "{name}: {before}°");
        assert!(after < 0.5, "{name}: {after}°");
    }
}

#[test]
fn a_compass_is_corrected_in_the_sensors_axes() {
    const TEST: &str = "calibrated-compass";
    let mut log = "t_us,ax,ay,az,gx,gy,gz,mx,my,mz\n".to_owned();
    for index in 0..3_400_u32 {
        let phase = std::f64::consts::TAU * f64::from(index.saturating_sub(1_000)) / 800.0;
        let (turned, rate) = (0.75 * (1.0 - phase.cos()), 1.178 * phase.sin());
        let (sine, cosine) = turned.sin_cos();
        // North is to the left of x, and the field points down.
        let field = [20.0 * sine, 20.0 * cosine, -44.0];
        let [x, y, z] = std::array::from_fn(|axis| field[axis] + IRON_UT[axis]);
        let noise = index % 3;
        let reading = match index % 4 {
            0 => format!("{y:.2},{:.2},{z:.2}", -x),
            _ => ",,".to_owned(),
        };
        let [fx, fy, fz] = [0.0, 0.0, 9.8].map(|force| force + f64::from(noise) * 0.01);
        let [fx, fy, fz] = [
            fx / SCALE[0] + OFFSET_M_S2[0],
            fy / SCALE[1] + OFFSET_M_S2[1],
            fz / SCALE[2] + OFFSET_M_S2[2],
        ];
        let t_us = 5_000 * index;
        writeln!(
            log,
            "{t_us},{fx:.4},{fy:.4},{fz:.4},0,0,{rate:.4},{reading}"
        )
        .expect("text");
    }
    let input = file(TEST, "compass.csv", log);
    let calibration = calibration(TEST);
    let options = ["--calibration", calibration.to_str().expect("a path")];
    let heading = column(TEST, &input, &options, "heading_deg");
    let last = heading.last().expect("a row");
    assert!((last - 90.0).abs() < 1.0, "{last}°");
    let sigma = column(TEST, &input, &options, "heading_sigma_deg");
    assert!(sigma.last().is_some_and(|sigma| *sigma < 20.0));
}

#[test]
fn a_calibration_that_contradicts_or_changes_nothing_is_refused() {
    const TEST: &str = "calibrated-refused";
    let log = file(TEST, "log.csv", "t_us,ax,ay,az,gx,gy,gz\n");
    let compass = "{\"compass\":{\"matrix\":[[1,0,0],[0,1,0],[0,0,1]],\"hard_iron_ut\":[0,0,0]}}";
    let alone = file(TEST, "compass.json", compass);
    let both = calibration(TEST);
    for (calibration, options, reason) in [
        (
            &both,
            &["--accelerometer", "factory"][..],
            "leave --accelerometer out",
        ),
        (
            &alone,
            &[],
            "calibrates a compass alone, and the recording has none",
        ),
        (&path(TEST, "none.json"), &[], "none.json"),
    ] {
        let mut arguments = vec!["replay", log.to_str().expect("a path")];
        arguments.extend(["--calibration", calibration.to_str().expect("a path")]);
        arguments.extend(options);
        let refused = run(&arguments).expect_err(reason);
        assert!(refused.contains(reason), "{refused}");
    }
    let header = "t_us,ax,ay,az,gx,gy,gz,mx,my,mz\n";
    let with_compass = file(TEST, "with.csv", header);
    let mut arguments = vec!["replay", with_compass.to_str().expect("a path")];
    arguments.extend(["--calibration", both.to_str().expect("a path")]);
    arguments.extend(["--compass", "factory"]);
    let refused = run(&arguments).expect_err("two statements");
    assert!(refused.contains("leave --compass out"), "{refused}");
}

#[test]
fn a_calibration_saved_by_an_editor_is_read_or_named() {
    const TEST: &str = "calibrated-encodings";
    let input = file(TEST, "log.csv", "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n");
    let input = input.to_str().expect("a path");
    let json = std::fs::read_to_string(calibration(TEST)).expect("a calibration");
    let marked = file(TEST, "marked.json", format!("\u{FEFF}{json}"));
    let marked = marked.to_str().expect("a path");
    run(&["replay", input, "--calibration", marked]).expect("a replay");
    let words = "\u{FEFF}".encode_utf16().chain(json.encode_utf16());
    let wide: Vec<u8> = words.flat_map(u16::to_le_bytes).collect();
    let wide = file(TEST, "wide.json", wide);
    let arguments = ["replay", input, "--calibration"];
    let refused = run(&[&arguments[..], &[wide.to_str().expect("a path")]].concat());
    let refused = refused.expect_err("UTF-16");
    assert!(
        refused.contains("wide.json: it is a UTF-16 text: save it as UTF-8"),
        "{refused}"
    );
}

#[test]
fn a_recording_that_is_calibrated_is_not_corrected_twice() {
    const TEST: &str = "calibrated-twice";
    let identity = "[[1,0,0],[0,1,0],[0,0,1]]";
    let gyroscope = format!("{{\"gyroscope\":{{\"matrix\":{identity}}}}}");
    let gyroscope = file(TEST, "gyroscope.json", gyroscope);
    let both = calibration(TEST);
    let picture = path(TEST, "picture.png");
    let picture = picture.to_str().expect("a path");
    for (knowledge, calibration, is_taken) in [
        ("factory", &both, true),
        ("six-poses", &both, false),
        ("calibrated", &both, false),
        ("factory", &gyroscope, true),
        ("six-poses", &gyroscope, true),
        ("calibrated", &gyroscope, false),
    ] {
        let text =
            format!("# --accelerometer {knowledge}\nt_us,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n");
        let input = file(TEST, "log.csv", text);
        let input = input.to_str().expect("a path");
        let calibration = calibration.to_str().expect("a path");
        for command in [
            &["replay", input][..],
            &["plot", input, "--output", picture],
        ] {
            let result = aplomb(&[command, &["--calibration", calibration]].concat());
            let message = String::from_utf8_lossy(&result.stderr);
            let code = if is_taken { 0 } else { 2 };
            assert_eq!(result.status.code(), Some(code), "{knowledge}: {message}");
            assert_eq!(
                message.contains("calibrated already, and would be corrected twice"),
                !is_taken,
                "{message}"
            );
        }
    }
}

#[test]
fn a_compass_matrix_that_gives_no_field_is_refused() {
    const TEST: &str = "calibrated-singular";
    let input = file(
        TEST,
        "log.csv",
        "t_us,ax,ay,az,gx,gy,gz,mx,my,mz\n0,0,0,9.8,0,0,0,20,0,-44\n",
    );
    for (matrix, is_taken) in [
        ("[[0,0,0],[0,0,0],[0,0,0]]", false),
        ("[[1,0,0],[1,0,0],[0,0,1]]", false),
        ("[[0,-1,0],[1,0,0],[0,0,1]]", true),
    ] {
        let json = format!("{{\"compass\":{{\"matrix\":{matrix},\"hard_iron_ut\":[1,2,3]}}}}");
        let calibration = file(TEST, "compass.json", json);
        let arguments = ["replay", input.to_str().expect("a path"), "--calibration"];
        let result = run(&[&arguments[..], &[calibration.to_str().expect("a path")]].concat());
        match result {
            Ok(_) => assert!(is_taken, "{matrix}"),
            Err(message) => {
                assert!(!is_taken && message.contains("no compass has"), "{message}");
            }
        }
    }
}
