//! Tests: streams of every format, whole, mixed and damaged.

use aplomb::attitude::{EulerAngles, Quaternion, Vector3};
use aplomb::compass::CompassStatus;
use aplomb::estimator::Sample;
use aplomb::estimator::heading::HeadingEstimate;
use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{Burst, Part};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::telemetry::heading;
use aplomb::telemetry::log::{self, Frame, NumberedBurst, TimedHeading};
use aplomb::telemetry::mavlink::{Session, Vehicle};
use aplomb::telemetry::message::Severity;
use aplomb::telemetry::{FRAME_CAPACITY, Output, encode};
use aplomb::units::{degrees, radians};
use aplomb_recordings::flight_log::Recorder;
use proptest::prelude::*;

use super::log::update;
use super::*;

fn snapshot() -> Snapshot {
    Snapshot {
        t_us: 2_000_000,
        attitude: Quaternion::from_euler(EulerAngles {
            roll_rad: radians(12.0),
            pitch_rad: radians(-5.0),
            yaw_rad: radians(40.0),
        }),
        body_rates_rad_s: Vector3::new(0.1, -0.2, 0.3),
        flags: Flags::VALID,
        tilt_variance_rad2: 1e-4,
    }
}

fn frame(format: OutputFormat, counter: u8) -> Vec<u8> {
    let mut frame = [0; FRAME_CAPACITY];
    encode(format, &snapshot(), counter, &mut frame).to_vec()
}

fn decode(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Item> {
    let mut items = Vec::new();
    decoder.push(bytes, &mut items);
    items
}

fn attitudes(items: &[Item]) -> Vec<Attitude> {
    let attitude = |item: &Item| match item {
        Item::Attitude(attitude) => Some(*attitude),
        _ => None,
    };
    items.iter().filter_map(attitude).collect()
}

/// Frames of every format, lines, and noise; some with a byte changed.
fn nearly_a_stream() -> impl Strategy<Value = Vec<u8>> {
    let formats = [
        OutputFormat::Text,
        OutputFormat::Teapot,
        OutputFormat::Classic,
        OutputFormat::Teleplot,
    ];
    let of_format = (prop::sample::select(formats.to_vec()), any::<u8>())
        .prop_map(|(format, counter)| frame(format, counter));
    let message = prop::option::of("[ -~é°]{0,120}");
    let of_session = message.prop_map(|text| mavlink(&mut Session::new(), text.as_deref()));
    let of_log =
        (any::<u32>(), any::<[u8; 14]>(), any::<u32>()).prop_map(|(number, bytes, flags)| {
            let captured_at_us = u64::from(number) * 1_000;
            let burst = Burst {
                bytes,
                captured_at_us,
                missed_before: 0,
            };
            let flags = BoardFlags::from_bits_retain(flags);
            let configuration = log::Configuration {
                revision: aplomb::estimator::REVISION,
                from_number: number,
                settings: Settings::new(&Part::MPU_6050),
            };
            let frames = [
                Frame::Burst(NumberedBurst {
                    number,
                    flags,
                    burst,
                }),
                Frame::Configuration(configuration),
                Frame::Attitude(snapshot()),
                Frame::Text(log::Text::new("text")),
            ];
            let mut place = [0; log::FRAME_CAPACITY];
            log::encode(&frames[number as usize % 4], &mut place).to_vec()
        });
    let line = "# (attitude: |ok status: flags=)?[A-Z|]{0,20}( x=1)?\n|\
                t_us,(qw,qx,qy,qz|roll_deg,pitch_deg,yaw_deg)(,flags)?\n|\
                -?[0-9]{1,4}(,(1|0|nan)){3,4}(,VALID)?\n|>[a-z_]{3,5}:[0-9.]{1,5}\n|.{0,9}";
    let piece = prop_oneof![
        4 => of_format,
        2 => of_session,
        4 => of_log,
        4 => line.prop_map(String::into_bytes),
        1 => prop::collection::vec(any::<u8>(), 0..40),
    ];
    let change = prop::option::weighted(0.2, (any::<prop::sample::Index>(), any::<u8>()));
    let piece = (piece, change).prop_map(|(mut piece, change)| {
        if let Some((place, byte)) = change
            && !piece.is_empty()
        {
            let place = place.index(piece.len());
            piece[place] = byte;
        }
        piece
    });
    prop::collection::vec(piece, 0..20).prop_map(|pieces| pieces.concat())
}

proptest! {
    #[test]
    fn any_stream_is_decoded_alike_in_any_pieces_and_a_whole_line_is_found_after_it(
        stream in nearly_a_stream(),
        size in 1_usize..50,
    ) {
        let mut whole = Decoder::default();
        let mut items = decode(&mut whole, &stream);
        let mut pieces = Decoder::default();
        let in_pieces: Vec<Item> = stream
            .chunks(size)
            .flat_map(|piece| decode(&mut pieces, piece))
            .collect();
        // Numbers that are none are not equal to themselves, but look alike.
        prop_assert_eq!(format!("{items:?}"), format!("{in_pieces:?}"));
        prop_assert_eq!(whole.counts(), pieces.counts());
        prop_assert_eq!(whole.format(), pieces.format());
        items.retain(|item| matches!(item, Item::Attitude(_)));
        prop_assert_eq!(items.len() as u64, whole.counts().attitudes);
        let next = [b"\n", &frame(OutputFormat::Text, 0)[..]].concat();
        let found = attitudes(&decode(&mut whole, &next));
        prop_assert!(found.last().is_some_and(|found| (found.roll_deg - 12.0).abs() < 0.02));
        prop_assert_eq!(whole.format(), Some(Format::Module(OutputFormat::Text)));
    }
}

/// Returns the last σ.
fn sigma_of(items: &[Item]) -> Option<f32> {
    items.iter().rev().find_map(|item| match item {
        Item::TiltSigma(sigma) => Some(*sigma),
        _ => None,
    })
}

fn mavlink(session: &mut Session, says: Option<&str>) -> Vec<u8> {
    mavlink_of(session, &snapshot(), says)
}

fn mavlink_of(session: &mut Session, snapshot: &Snapshot, says: Option<&str>) -> Vec<u8> {
    let mut buffer = [0; 2000];
    let mut output = Output::new(&mut buffer);
    let vehicle = Vehicle {
        snapshot: Some(snapshot),
        is_due: true,
        sample: &Sample::default(),
        temperature_celsius: 31.5,
        heading: None,
        compass: CompassStatus::default(),
        record: &aplomb::settings::Record::default(),
        baud: 115_200,
        is_armed: false,
        bursts_failed: 0,
    };
    session.fill(2_000_000, &vehicle, &mut output);
    if let Some(text) = says {
        assert!(session.send_text(Severity::Information, text, &mut output));
    }
    let length = output.length();
    buffer[..length].to_vec()
}

#[test]
fn every_format_of_a_frame_is_found_by_itself_and_so_are_changes() {
    let mut decoder = Decoder::default();
    for format in [
        OutputFormat::Text,
        OutputFormat::Teapot,
        OutputFormat::Classic,
        OutputFormat::Teleplot,
        OutputFormat::Text,
    ] {
        let items = decode(&mut decoder, &frame(format, 0));
        let [attitude] = attitudes(&items)[..] else {
            panic!("{format:?}: {items:?}");
        };
        assert_eq!(decoder.format(), Some(Format::Module(format)));
        assert!((attitude.roll_deg - 12.0).abs() < 0.02, "{attitude:?}");
        assert!((attitude.pitch_deg + 5.0).abs() < 0.02, "{attitude:?}");
        let yaw = attitude.yaw_deg;
        assert_eq!(yaw.is_some(), format != OutputFormat::Classic);
        assert!(yaw.is_none_or(|yaw| (yaw - 40.0).abs() < 0.02));
        let has_health = matches!(format, OutputFormat::Text | OutputFormat::Teleplot);
        assert_eq!(attitude.flags, has_health.then_some(Flags::VALID));
    }
    assert_eq!(decoder.counts().damaged, 0);
    let items = decode(&mut decoder, &mavlink(&mut Session::new(), None));
    assert_eq!(
        decoder.format(),
        Some(Format::Module(OutputFormat::Mavlink))
    );
    assert!((attitudes(&items)[0].roll_deg - 12.0).abs() < 1e-3);
    assert!(items.contains(&Item::Temperature(31.5)));
}

#[test]
fn text_says_whether_it_is_valid_and_a_message_why_it_is_not() {
    let mut decoder = Decoder::default();
    let lines = "# attitude: VALID|DEGRADED|POLLED\nroll:1.00\tpitch:-2.50\tyaw:90.00\t\
                roll_rate:0.00\tpitch_rate:0.12\tyaw_rate:-3.00\tvalid:0\n";
    let items = decode(&mut decoder, lines.as_bytes());
    let [attitude] = attitudes(&items)[..] else {
        panic!("{items:?}");
    };
    assert_eq!(attitude.flags, Some(Flags::DEGRADED | Flags::POLLED));
    // A status names them before anything changes, what has just happened too.
    let lines = "# ok status: flags=CALIBRATING|MISSED|DEGRADED sensor=none\n\
                roll:1.00\tpitch:-2.50\tyaw:90.00\t\
                roll_rate:0.00\tpitch_rate:0.12\tyaw_rate:-3.00\tvalid:0\n";
    let items = decode(&mut decoder, lines.as_bytes());
    let flags = Flags::CALIBRATING | Flags::DEGRADED;
    assert_eq!(attitudes(&items)[0].flags, Some(flags));
    // The window is over when an attitude is valid.
    let items = decode(&mut decoder, &frame(OutputFormat::Text, 0));
    assert_eq!(attitudes(&items)[0].flags, Some(Flags::VALID));
    let items = decode(&mut decoder, b"# attitude: VALID\n");
    assert_eq!(items, [Item::Message("attitude: VALID".into())]);
    let items = decode(&mut decoder, &frame(OutputFormat::Text, 0));
    assert_eq!(attitudes(&items)[0].flags, Some(Flags::VALID));
}

#[test]
fn a_frame_that_is_found_late_takes_no_line_with_it() {
    let mut decoder = Decoder::default();
    let heartbeat = &mavlink(&mut Session::new(), None)[..21];
    let line = frame(OutputFormat::Text, 0);
    // What begins like a frame is none only when its last byte is there, which is the line's.
    let length = (3 + heartbeat.len() + 1 + line.len() - Mavlink::OVERHEAD) as u8;
    let start = [Mavlink::START, length, 0];
    let items = decode(&mut decoder, &[&start, heartbeat, b"\n", &line].concat());
    assert_eq!(attitudes(&items).len(), 1);
    assert_eq!(decoder.format(), Some(Format::Module(OutputFormat::Text)));
}

#[test]
fn losses_are_counted_by_the_numbers_that_frames_have() {
    let mut decoder = Decoder::default();
    for counter in [254, 255, 0, 3] {
        decode(&mut decoder, &frame(OutputFormat::Teapot, counter));
    }
    assert_eq!((decoder.counts().attitudes, decoder.counts().lost), (4, 2));
    let mut decoder = Decoder::default();
    let mut session = Session::new();
    decode(&mut decoder, &mavlink(&mut session, None));
    let mut bytes = mavlink(&mut session, None);
    // A byte of the first message is wrong.
    bytes[12] ^= 1;
    decode(&mut decoder, &bytes);
    assert_eq!((decoder.counts().lost, decoder.counts().damaged), (1, 1));
}

#[test]
fn what_goes_by_in_another_format_is_not_lost() {
    let mut decoder = Decoder::default();
    let mut session = Session::new();
    let burst = |number| {
        let mut buffer = [0; log::FRAME_CAPACITY];
        let burst = Burst {
            bytes: [0; 14],
            captured_at_us: 1000 * u64::from(number),
            missed_before: 0,
        };
        let burst = NumberedBurst {
            number,
            flags: BoardFlags::empty(),
            burst,
        };
        log::encode(&Frame::Burst(burst), &mut buffer).to_vec()
    };
    for number in [0, 50, 100] {
        decode(&mut decoder, &burst(number));
        decode(&mut decoder, &frame(OutputFormat::Teapot, number as u8));
        decode(&mut decoder, &mavlink(&mut session, None));
        mavlink(&mut session, None);
        decode(&mut decoder, &frame(OutputFormat::Text, 0));
    }
    let counts = decoder.counts();
    assert_eq!((counts.bursts, counts.attitudes, counts.lost), (3, 9, 0));
}

#[test]
fn a_long_message_comes_in_pieces() {
    let mut decoder = Decoder::default();
    let text = "z".repeat(120);
    let items = decode(&mut decoder, &mavlink(&mut Session::new(), Some(&text)));
    assert_eq!(items.last(), Some(&Item::Message(text)));
}

/// Returns the messages of a stream of these frames of a long message and of a short one, "end".
fn messages_of(pieces: &[usize]) -> Vec<String> {
    let mut session = Session::new();
    // The frames before the message.
    let mut bytes = mavlink(&mut session, None);
    let mut buffer = [0; 2000];
    let mut output = Output::new(&mut buffer);
    let text = ["a", "b", "c", "d"]
        .map(|letter| letter.repeat(50))
        .concat()
        + "e";
    assert!(session.send_text(Severity::Information, &text, &mut output));
    let long = output.length();
    assert!(session.send_text(Severity::Information, "end", &mut output));
    let length = output.length();
    let mut frames = Vec::new();
    let mut rest = &buffer[..long];
    while let [_, payload, ..] = rest {
        let (frame, others) = rest.split_at(usize::from(*payload) + 12);
        frames.push(frame);
        rest = others;
    }
    assert_eq!(frames.len(), 5);
    for piece in pieces {
        bytes.extend_from_slice(frames[*piece]);
    }
    bytes.extend_from_slice(&buffer[long..length]);
    let items = decode(&mut Decoder::default(), &bytes);
    let message = |item: &Item| match item {
        Item::Message(text) => Some(text.clone()),
        _ => None,
    };
    items.iter().filter_map(message).collect()
}

#[test]
fn a_lost_piece_of_a_message_shows_as_an_ellipsis() {
    for (pieces, expected) in [
        (&[0, 1, 2, 3, 4][..], Some("abcde")),
        (&[0, 1, 3, 4], Some("ab…de")),
        (&[0, 3, 4], Some("a…de")),
        (&[1, 2, 3, 4], Some("…bcde")),
        (&[0, 1, 2, 3], Some("abcd…")),
        (&[4], Some("…e")),
        (&[], None),
    ] {
        let mut messages = messages_of(pieces);
        assert_eq!(messages.pop().as_deref(), Some("end"));
        for message in &mut messages {
            for letter in ["a", "b", "c", "d"] {
                *message = message.replace(&letter.repeat(50), letter);
            }
        }
        let expected: Vec<&str> = expected.into_iter().collect();
        assert_eq!(messages, expected, "{pieces:?}");
    }
}

#[test]
fn a_half_line_at_the_start_is_no_damage_and_a_wrong_one_later_is() {
    let mut decoder = Decoder::default();
    let mut bytes = b"_rate:1.00\n".to_vec();
    bytes.extend(frame(OutputFormat::Text, 0));
    let items = decode(&mut decoder, &bytes);
    assert_eq!((attitudes(&items).len(), decoder.counts().damaged), (1, 0));
    decode(&mut decoder, b"roll:1.00\tpi\n# a message\r\n\n");
    assert_eq!(decoder.counts().damaged, 1);
}

#[test]
fn a_log_gives_attitudes_sigma_and_what_is_missing() {
    let settings = Settings::new(&Part::MPU_6050);
    let mut recorder = Recorder::new(Vec::new(), Pipeline::new(&settings), 0);
    // Level and face up, at rest: 1 g along z at 2048 counts each.
    let mut bytes = [0; 14];
    bytes[4..6].copy_from_slice(&2048_i16.to_be_bytes());
    let mut pipeline = Pipeline::new(&settings);
    let mut sigma_rad = f32::NAN;
    for index in 0..12_000_u64 {
        // The last bit trembles, as in any sensor that lives.
        bytes[9] = (index * 7 % 5) as u8;
        let burst = Burst {
            bytes,
            captured_at_us: 1000 * index,
            missed_before: 0,
        };
        recorder
            .add(&burst, BoardFlags::empty())
            .expect("a vector takes everything");
        if index <= 11_980 {
            sigma_rad = update(
                &mut pipeline,
                &NumberedBurst {
                    number: index as u32,
                    flags: BoardFlags::empty(),
                    burst,
                },
            )
            .tilt_sigma_rad();
        }
    }
    let log = recorder.into_inner();
    let mut decoder = Decoder::default();
    let items = decode(&mut decoder, &log);
    assert_eq!(decoder.format(), Some(Format::Module(OutputFormat::Log)));
    let counts = decoder.counts();
    assert_eq!(
        (counts.attitudes, counts.bursts, counts.lost, counts.damaged),
        (600, 12_000, 0, 0)
    );
    let sigma = sigma_of(&items);
    let expected = degrees(sigma_rad);
    assert_eq!(sigma, Some(expected));
    // Begun in the middle: the module's next state, ten seconds after its start, brings the same
    // σ.
    assert_eq!(
        sigma_of(&decode(&mut Decoder::default(), &log[log.len() / 2..])),
        sigma
    );
    // A hole in it, from the middle of a frame to the middle of another.
    let mut decoder = Decoder::default();
    decode(&mut decoder, &log[..40_000]);
    decode(&mut decoder, &log[42_000..]);
    let counts = decoder.counts();
    assert_eq!(counts.lost, 12_000 - counts.bursts);
    assert!(counts.lost > 40 && counts.damaged >= 1, "{counts:?}");
}

#[test]
fn a_message_in_the_log_is_put_together() {
    for length in [5, 238, 300, 476, 500] {
        let text = "°".repeat(length / 2);
        let mut buffer = [0; 1000];
        let mut output = Output::new(&mut buffer);
        assert!(log::put_text(&text, &mut output));
        log::put_attitude(&snapshot(), &mut output);
        let end = output.length();
        let items = decode(&mut Decoder::default(), &buffer[..end]);
        assert_eq!(items[0], Item::Message(text));
        assert_eq!(attitudes(&items[1..]).len(), 1);
    }
}

#[test]
fn the_heading_of_text_and_teleplot_is_no_attitude_and_no_damage() {
    use aplomb::telemetry::heading::{self, Line};

    let line = Line {
        heading_deg: 271.25,
        sigma_deg: 2.5,
        is_valid: true,
    };
    let mut buffer = [0; heading::LINES_LENGTH];
    for format in [OutputFormat::Text, OutputFormat::Teleplot] {
        let encoded = match format {
            OutputFormat::Text => heading::encode(&line, &mut buffer),
            _ => heading::encode_teleplot(&line, &mut buffer),
        };
        let mut stream = Vec::new();
        for _ in 0..20 {
            stream.extend(frame(format, 0));
            stream.extend_from_slice(encoded);
        }
        let mut decoder = Decoder::default();
        let items = decode(&mut decoder, &stream);
        let headings = items.iter().filter(|item| **item == Item::Heading(line));
        assert!(headings.count() >= 15, "{format:?} {items:?}");
        assert!((15..=20).contains(&attitudes(&items).len()), "{format:?}");
        assert_eq!(decoder.counts().damaged, 0, "{format:?}");
    }
}

#[test]
fn an_attitude_table_is_read_by_its_columns() {
    let mut decoder = Decoder::default();
    let table = "t_us,qw,roll_deg,pitch_deg,yaw_deg,tilt_sigma_deg,flags\n\
                 1000,1,1.5,-2,3,0.5,VALID|MISSED\n\
                 2000,1,1.5,-2,x,0.5,\n";
    let items = decode(&mut decoder, table.as_bytes());
    let flags = Flags::VALID | Flags::MISSED;
    assert_eq!(
        items,
        [
            Item::Attitude(Attitude {
                t_us: Some(1000),
                roll_deg: 1.5,
                pitch_deg: -2.0,
                yaw_deg: Some(3.0),
                rates_deg_s: [None; 3],
                flags: Some(flags)
            }),
            Item::TiltSigma(0.5)
        ]
    );
    assert_eq!(decoder.counts().damaged, 1);
}

#[test]
fn the_heading_of_a_log_comes_with_each_attitude_until_it_is_unknown() {
    let estimate = HeadingEstimate {
        yaw_offset_rad: radians(20.0),
        sigma_rad: radians(2.0),
        is_valid: true,
    };
    let bytes = |estimate| {
        let mut bytes = Vec::new();
        let timed = TimedHeading { t_us: 5, estimate };
        for frame in [
            Frame::Heading(timed),
            Frame::Attitude(snapshot()),
            Frame::Attitude(snapshot()),
        ] {
            bytes.extend_from_slice(log::encode(&frame, &mut [0; log::FRAME_CAPACITY]));
        }
        bytes
    };
    let headings = |items: &[Item]| -> Vec<heading::Line> {
        let heading = |item: &Item| match item {
            Item::Heading(line) => Some(*line),
            _ => None,
        };
        items.iter().filter_map(heading).collect()
    };
    let mut decoder = Decoder::default();
    let items = decode(&mut decoder, &bytes(Some(estimate)));
    let found = headings(&items);
    assert_eq!(found, [heading::Line::new(&snapshot(), &estimate); 2]);
    assert!((found[0].heading_deg - 60.0).abs() < 0.1, "{found:?}");
    let items = decode(&mut decoder, &bytes(None));
    assert_eq!((attitudes(&items).len(), headings(&items).len()), (2, 0));
    assert_eq!(decoder.counts().damaged, 0);
}

#[test]
fn mavlink_brings_the_health_of_each_sensor_and_an_absent_compass_is_healthy() {
    let sensors = |flags: Flags| {
        let snapshot = Snapshot {
            flags,
            ..snapshot()
        };
        let bytes = mavlink_of(&mut Session::new(), &snapshot, None);
        let items = decode(&mut Decoder::default(), &bytes);
        let found = items.iter().find_map(|item| match item {
            Item::Sensors(sensors) => Some(*sensors),
            _ => None,
        });
        found.expect("SYS_STATUS")
    };
    assert_eq!(sensors(Flags::VALID).unhealthy(), [""; 0]);
    let clipped = sensors(Flags::VALID | Flags::ACCELEROMETER_SATURATED);
    assert_eq!(clipped.unhealthy(), ["ACCELEROMETER"]);
}
