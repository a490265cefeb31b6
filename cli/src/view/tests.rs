//! Screens as golden text: the letters, then a letter for each background colour.
//! `APLOMB_BLESS=1 cargo test …` writes them anew.

use std::fmt::Write as _;
use std::path::Path;

use aplomb::health::Flags;
use aplomb::settings::OutputFormat;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::buffer::Buffer;
use ratatui::style::Color;

use super::live::next_baud;
use super::model::{Connection, Model, Speaker};
use super::player::changed_speed;
use super::{horizon, parse_speed, screen};
use crate::stream::{Attitude, Counts, Format, Item, Sensors};

fn drawn(model: &Model, width: u16, height: u16) -> Buffer {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).expect("it takes everything");
    terminal
        .draw(|frame| screen::draw(model, frame.area(), frame.buffer_mut()))
        .expect("it takes everything");
    terminal.backend().buffer().clone()
}

/// Returns the letters, and below them the backgrounds: sky, ground, good, bad, and `.` for others.
fn text(buffer: &Buffer) -> String {
    let mut text = String::new();
    let area = buffer.area;
    for is_colour in [false, true] {
        for y in 0..area.height {
            let mut row = String::new();
            for x in 0..area.width {
                let cell = &buffer[(x, y)];
                let colour = match cell.bg {
                    horizon::SKY => "s",
                    horizon::GROUND => "G",
                    Color::Indexed(28) => "+",
                    Color::Indexed(160) => "!",
                    _ => ".",
                };
                row += if is_colour { colour } else { cell.symbol() };
            }
            writeln!(text, "{}", row.trim_end()).expect("a string takes everything");
        }
    }
    text
}

fn assert_golden(name: &str, buffer: &Buffer) {
    let text = text(buffer);
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/golden")
        .join(name);
    if std::env::var_os("APLOMB_BLESS").is_some() {
        return std::fs::write(&path, text).expect("the folder can be written");
    }
    let golden = std::fs::read_to_string(&path).expect("a golden file");
    for (number, (got, golden)) in text.lines().zip(golden.lines()).enumerate() {
        assert_eq!(got, golden, "{name}:{}", number + 1);
    }
    assert_eq!(text.lines().count(), golden.lines().count(), "{name}");
}

/// Returns a module that swings for 25 s, and sends the flight log and a few messages.
fn swinging(flags: Flags) -> Model {
    let mut model = Model::new("/dev/ttyUSB0".into(), Connection::Open(Some(921_600)));
    let mut counts = Counts::default();
    model.add_message(0.3, Speaker::Module, "MPU-6050 at 0x68 configured".into());
    model.add_message(
        1.2,
        Speaker::Module,
        "gyroscope's offset measured, ready".into(),
    );
    for index in 0..=1250 {
        let at_s = f64::from(index) * 0.02;
        let phase = (at_s * 0.7) as f32;
        let attitude = Attitude {
            t_us: Some((at_s * 1e6) as u64),
            roll_deg: 25.0 * phase.sin() + 5.0,
            pitch_deg: 12.0 * (1.7 * phase).cos(),
            yaw_deg: Some(-30.0),
            rates_deg_s: [
                Some(17.5 * phase.cos()),
                Some(-14.3 * (1.7 * phase).sin()),
                Some(3.0),
            ],
            flags: Some(flags),
        };
        counts.attitudes += 1;
        counts.bursts += 20;
        model.take(at_s, Item::Attitude(attitude));
        model.tick(at_s, Some(Format::Module(OutputFormat::Log)), counts);
    }
    model.take(25.0, Item::TiltSigma(0.58));
    model.take(25.0, Item::Temperature(31.4));
    model
}

#[test]
fn a_valid_attitude() {
    let model = swinging(Flags::VALID);
    assert_golden("view-valid-80x24.txt", &drawn(&model, 80, 24));
    assert_golden("view-valid-120x40.txt", &drawn(&model, 120, 40));
}

#[test]
fn a_fresh_heading_is_beside_the_attitude() {
    let mut model = swinging(Flags::VALID);
    let heading = aplomb::telemetry::heading::Line {
        heading_deg: 271.35,
        sigma_deg: 2.1,
        is_valid: true,
    };
    model.take(25.0, Item::Heading(heading));
    let status = "ok status: flags=VALID|HEADING_VALID field_ut=18.6,0.0,46.1 mount=+x-z";
    model.take(25.0, Item::Message(status.into()));
    for (width, height) in [(80, 24), (120, 40)] {
        let text = text(&drawn(&model, width, height));
        assert!(text.contains("head    271.35°  ± 2.10°"), "{text}");
        assert!(text.contains("·   ·   W   ·   ·"), "{text}");
        assert!(text.contains(" 49.7 µT, dip "), "{text}");
    }
    model.tick(26.5, model.format, model.counts);
    assert!(!text(&drawn(&model, 80, 24)).contains("head "));
}

#[test]
fn an_attitude_that_is_not_valid_says_so_with_the_reasons() {
    let flags = [
        Flags::DEGRADED,
        Flags::CALIBRATING,
        Flags::MISSED,
        Flags::BUS_FAULT,
        Flags::POLLED,
    ];
    let mut model = swinging(
        flags
            .into_iter()
            .fold(Flags::empty(), |all, flag| all | flag),
    );
    model.counts.lost = 12;
    model.recording = Some(("aplomb-1.log".into(), 1_234_567));
    model.add_message(24.0, Speaker::Person, "calibrate gyro".into());
    let error = "error refused while \"calibrate accel\" goes on: \"calibrate stop\" ends it";
    model.add_message(24.1, Speaker::Module, error.into());
    assert_golden("view-not-valid-80x24.txt", &drawn(&model, 80, 24));
    assert_golden("view-not-valid-120x40.txt", &drawn(&model, 120, 40));
}

#[test]
fn a_sensor_that_mavlink_reports_as_unhealthy_is_named() {
    let mut model = swinging(Flags::VALID);
    for index in 0..10 {
        let attitude = Attitude {
            roll_deg: index as f32,
            ..Attitude::default()
        };
        model.take(25.0, Item::Attitude(attitude));
    }
    let healthy = Sensors {
        gyroscope: true,
        accelerometer: true,
        attitude: true,
        compass: true,
    };
    let accelerometer = false;
    for (sensors, banner, name) in [
        (healthy, "SENSORS HEALTHY", ""),
        (
            Sensors {
                accelerometer,
                ..healthy
            },
            "SENSOR UNHEALTHY",
            "ACCELEROMETER",
        ),
    ] {
        model.take(25.0, Item::Sensors(sensors));
        for (width, height) in [(80, 24), (120, 40)] {
            let text = text(&drawn(&model, width, height));
            assert!(text.contains(banner) && text.contains(name), "{text}");
        }
    }
}

#[test]
fn a_port_that_is_gone_leaves_no_attitude_on_the_screen() {
    let mut model = swinging(Flags::VALID);
    model.connection = Connection::Away("Broken pipe".into());
    model.tick(31.0, model.format, model.counts);
    assert_golden("view-unplugged-80x24.txt", &drawn(&model, 80, 24));
}

#[test]
fn a_format_without_health_and_yaw_says_so_and_help_lies_above_all() {
    let mut model = Model::new("recording.uart".into(), Connection::Open(None));
    let format = Some(Format::Module(OutputFormat::Classic));
    let attitude = Attitude {
        roll_deg: -35.0,
        pitch_deg: 8.0,
        rates_deg_s: [Some(-0.001), Some(2.0), None],
        ..Attitude::default()
    };
    model.take(0.0, Item::Attitude(attitude));
    model.tick(0.1, format, Counts::default());
    model.typed = Some("mount z-do".into());
    assert_golden("view-classic-80x24.txt", &drawn(&model, 80, 24));
    model.typed = None;
    model.shows_help = true;
    assert_golden("view-help-80x24.txt", &drawn(&model, 80, 24));
}

#[test]
fn any_size_and_any_number_can_be_drawn() {
    let mut model = swinging(Flags::empty());
    for value in [f32::NAN, f32::INFINITY, f32::MAX, -1e9] {
        let attitude = Attitude {
            roll_deg: value,
            pitch_deg: value,
            yaw_deg: Some(value),
            rates_deg_s: [Some(value); 3],
            flags: Some(Flags::all()),
            t_us: None,
        };
        model.take(25.0, Item::Attitude(attitude));
        for (width, height) in [
            (0, 0),
            (1, 1),
            (79, 24),
            (80, 23),
            (80, 24),
            (81, 25),
            (300, 90),
        ] {
            drawn(&model, width, height);
        }
    }
}

#[test]
fn of_a_long_name_the_end_is_shown_whatever_its_letters() {
    let mut model = swinging(Flags::VALID);
    for letters in 1..40 {
        model.name = format!("/{}/flug.log", "ü€".repeat(letters));
        let header = text(&drawn(&model, 80, 24));
        assert!(
            header
                .lines()
                .next()
                .is_some_and(|line| line.contains("ü€/flug.log "))
        );
    }
}

#[test]
fn a_key_never_turns_a_speed_the_other_way() {
    for text in ["0.01", "0.1", "1", "64", "1000"] {
        let speed = parse_speed(text).expect("it can be chosen");
        assert!(
            changed_speed(speed, 2.0) >= speed && changed_speed(speed, 0.5) <= speed,
            "{text}"
        );
    }
}

#[test]
fn every_baud_rate_is_tried_once_in_a_round() {
    let mut tried = vec![115_200];
    while tried.len() < 8 {
        tried.push(next_baud(tried[tried.len() - 1]));
    }
    assert_eq!(next_baud(tried[7]), 115_200);
    assert_eq!(tried[1], 921_600);
    tried.sort_unstable();
    assert_eq!(tried, aplomb::console::command::BAUD_RATES);
}

#[test]
fn no_count_is_cut_on_a_narrow_screen() {
    for counts in [
        [0; 4],
        [1, 0, 12, 0],
        [12, 3, 456, 7],
        [99_999, 99_999, 99_999, 99_999],
    ] {
        let [lost, damaged, dropped, failed] = counts;
        let mut model = swinging(Flags::VALID);
        (model.counts.lost, model.counts.damaged) = (lost, damaged);
        (model.frames_dropped, model.bursts_failed) = (Some(dropped), Some(failed));
        let buffer = drawn(&model, 80, 24);
        let row: String = (0..80)
            .map(|x| buffer[(x, 12)].symbol().to_owned())
            .collect::<String>();
        let row = row[row.find("lost").expect(&row)..].trim_end().to_owned();
        let words: Vec<&str> = row.split(' ').collect();
        for (name, count) in ["lost", "bad", "dropped", "failed"].iter().zip(counts) {
            let Some(at) = words.iter().position(|word| word == name) else {
                assert!(count == 0 || row.ends_with('…'), "{name}: {row}");
                continue;
            };
            let expected = match count {
                99_999 => "99k".to_owned(),
                _ => count.to_string(),
            };
            assert_eq!(words.get(at + 1), Some(&expected.as_str()), "{row}");
        }
    }
}
