//! Frames encoded and decoded, damaged streams, and a sender with little room.

use proptest::prelude::*;

use super::super::output::Output;
use super::frame::CRC;
use super::*;
use crate::attitude::{Quaternion, Vector3};
use crate::calibration::{
    AccelerometerCorrection, Calibration, GyroscopeOffset, Matrix3, Mount, SymmetricMatrix,
    TemperatureModel,
};
use crate::estimator::REVISION;
use crate::estimator::heading::{CompassKnowledge, Heading, HeadingEstimate};
use crate::health::{BoardFlags, Flags};
use crate::mpu6050::{
    AccelerometerRange, BURST_LENGTH, Burst, Config, GyroscopeRange, LowPass, Part,
};
use crate::pipeline::{CompassReading, Pipeline, Settings, Snapshot};
use crate::serialize::{StateReader, StateWriter};
use crate::units::MagneticField;

/// Settings with every optional part.
fn full_settings() -> Settings {
    let vector = Vector3::new(1.5, -2.5, 1.0e-3);
    Settings {
        sensor: Config {
            accelerometer_range: AccelerometerRange::G8,
            gyroscope_range: GyroscopeRange::Degrees500,
            low_pass: LowPass::Hertz42,
            sample_rate_divider: 3,
        },
        part: Part::from_who_am_i(0x98).expect("a known part"),
        mount: Mount::Z_DOWN,
        calibration: Calibration {
            mount: Mount::parse("-y+x"),
            gyroscope: Some(GyroscopeOffset {
                offset_rad_s: vector,
                temperature_celsius: 21.25,
            }),
            temperature: Some(TemperatureModel {
                reference_celsius: 30.0,
                offset_rad_s: vector,
                slope_rad_s_per_celsius: -vector,
                curvature_rad_s_per_celsius2: vector,
                coldest_celsius: 10.0,
                warmest_celsius: 50.0,
            }),
            accelerometer: Some(AccelerometerCorrection {
                offset_m_s2: vector,
                matrix: SymmetricMatrix {
                    xx: 1.01,
                    yy: 0.99,
                    zz: 1.0,
                    xy: 0.001,
                    xz: -0.002,
                    yz: 0.003,
                },
            }),
            level: Some(Quaternion::IDENTITY),
            gyroscope_matrix: Some(Matrix3 { rows: [vector; 3] }),
        },
        verifies_scales: true,
        sensor_delay_us: Some(123_456),
    }
}

fn examples() -> [Frame; 8] {
    [
        Frame::Configuration(Configuration {
            revision: 7,
            from_number: 0x0102_0304,
            settings: full_settings(),
        }),
        Frame::Burst(NumberedBurst {
            number: u32::MAX,
            flags: BoardFlags::SENSOR_RESET,
            burst: Burst {
                bytes: [0, 1, 0, 255, 0, 0, 0, 0, 0, 0, 0, 0, 0, 9],
                captured_at_us: (1 << 48) - 1,
                missed_before: 3,
            },
        }),
        Frame::Attitude(Snapshot {
            t_us: 123,
            attitude: Quaternion::IDENTITY,
            body_rates_rad_s: Vector3::new(-0.0, 1.0, f32::MIN_POSITIVE),
            flags: Flags::GAP | Flags::MISSED,
            tilt_variance_rad2: f32::INFINITY,
        }),
        Frame::StatePiece(StatePiece {
            number: 5,
            offset: 96,
            state_length: 200,
            data: [0x5A; PIECE_LENGTH],
        }),
        Frame::Text(Text::new("the sensor does not answer, 5 °C")),
        Frame::Reading(READING),
        Frame::HeadingPiece(StatePiece {
            number: 9,
            offset: 0,
            state_length: 5,
            data: {
                let mut data = [0; PIECE_LENGTH];
                data[..5].fill(0xA5);
                data
            },
        }),
        Frame::Heading(HEADING),
    ]
}

#[test]
fn a_configuration_of_format_1_is_read_and_a_later_format_is_refused() {
    let mut settings = full_settings();
    settings.calibration.gyroscope_matrix = None;
    let expected = Frame::Configuration(Configuration {
        revision: 15,
        from_number: 3,
        settings,
    });
    let mut stuffed = stream(&[expected]);
    let length = stuffed.len();
    let whole = cobs::decode_in_place(&mut stuffed[1..length - 1]).expect("a frame");
    let body = &stuffed[1..=whole - 4];
    // Kind and version come first; format 1 ends before the matrix.
    for (version, length, is_read) in [
        (1, body.len() - 1, true),
        (FORMAT_VERSION, body.len(), true),
        (1, body.len(), false),
        (FORMAT_VERSION, body.len() - 1, false),
        (FORMAT_VERSION + 1, body.len(), false),
        (0, body.len() - 1, false),
    ] {
        let mut body = body[..length].to_vec();
        body[1] = version;
        body.extend(CRC.checksum(&body).to_le_bytes());
        let mut stuffed = [0; FRAME_CAPACITY];
        let length = cobs::encode(&body, &mut stuffed);
        let decoded = decode(&mut stuffed[..length]);
        assert_eq!(decoded == Some(expected), is_read, "{version}, {length}");
    }
}

const READING: CompassReading = CompassReading {
    number: 0x0506_0708,
    sample_t_us: (1 << 48) - 2,
    measured_us: u32::MAX,
    field: MagneticField {
        ut: [20.0, -0.0, 44.5],
    },
    knowledge: CompassKnowledge::Calibrated,
    declination_rad: -0.05,
    starts_filter: true,
};

const HEADING: TimedHeading = TimedHeading {
    t_us: 0x0102_0304_0506,
    estimate: Some(HeadingEstimate {
        yaw_offset_rad: -1.5,
        sigma_rad: 0.03,
        is_valid: true,
    }),
};

fn stream(frames: &[Frame]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for frame in frames {
        bytes.extend_from_slice(encode(frame, &mut [0xFF; FRAME_CAPACITY]));
    }
    bytes
}

fn decoded(bytes: &[u8]) -> (Vec<Frame>, Counts) {
    let mut decoder = Decoder::new();
    let frames = bytes
        .iter()
        .filter_map(|byte| decoder.push(*byte))
        .collect();
    (frames, decoder.counts())
}

#[test]
fn every_kind_of_frame_survives() {
    let frames = examples();
    for (index, frame) in frames.iter().enumerate() {
        let bytes = stream(&[*frame]);
        assert!(bytes.len() > 8 && bytes.starts_with(&[0]) && bytes.ends_with(&[0]));
        assert!(!bytes[1..bytes.len() - 1].contains(&0));
        assert_eq!(decoded(&bytes).0, [*frame], "{index}");
    }
    let (all, counts) = decoded(&stream(&frames));
    assert_eq!(all, frames);
    assert_eq!((counts.frames, counts.damaged), (8, 0));
}

#[test]
fn every_knowledge_and_every_state_of_a_heading_survives() {
    let valid = HEADING.estimate.expect("a heading");
    let headings = [
        None,
        Some(valid),
        Some(HeadingEstimate {
            is_valid: false,
            ..valid
        }),
    ];
    let headings = headings.map(|estimate| Frame::Heading(TimedHeading { t_us: 5, estimate }));
    let readings = CompassKnowledge::ALL.into_iter().flat_map(|knowledge| {
        [false, true].map(|starts_filter| {
            Frame::Reading(CompassReading {
                knowledge,
                starts_filter,
                ..READING
            })
        })
    });
    let frames: Vec<Frame> = headings.into_iter().chain(readings).collect();
    assert_eq!(decoded(&stream(&frames)).0, frames);
}

#[test]
fn frames_have_their_documented_lengths_and_fit_the_uart() {
    let [_, burst, attitude, ..] = examples();
    assert_eq!(stream(&[burst]).len(), BYTES_PER_BURST);
    assert_eq!(stream(&[attitude]).len(), BYTES_PER_ATTITUDE);
    assert_eq!(stream(&[Frame::Reading(READING)]).len(), BYTES_PER_READING);
    assert_eq!(stream(&[Frame::Heading(HEADING)]).len(), BYTES_PER_HEADING);
    // At 1 kHz with 50 attitudes, a configuration each second and a state in ten.
    let configuration = stream(&examples()[..1]).len();
    let piece = stream(&examples()[3..4]).len();
    let state = 2048_usize.div_ceil(PIECE_LENGTH) * piece;
    let a_second =
        1000 * BYTES_PER_BURST + 50 * stream(&[attitude]).len() + configuration + state / 10;
    assert!(a_second < 41_000, "{a_second}");
    assert!(a_second * 10 < 921_600 / 2, "half of the line is free");
    // With a compass, 50 readings, seven headings and the state of the heading filter.
    let mut heading_state = HeadingState {
        next_reading: 1,
        filter: Some(Heading::new(CompassKnowledge::Calibrated)),
    };
    let mut measure = StateWriter::new(&mut [], 0);
    heading_state.visit_state(&mut measure);
    let length = measure.length().expect("it has a byte form");
    assert!(length < 1_920, "{length}");
    let pieces = length.div_ceil(PIECE_LENGTH) * piece / 10;
    let compass = 50 * BYTES_PER_READING + 7 * BYTES_PER_HEADING + pieces;
    assert!(a_second + compass < 43_500, "{a_second} {compass}");
    assert!((a_second + compass) * 10 < 921_600 / 2);
}

#[test]
fn other_lines_between_frames_are_skipped_and_counted() {
    let frames = examples();
    let mut bytes = b"# aplomb on a board\nroll:1.00\n".to_vec();
    let noise = bytes.len() as u64;
    bytes.extend(stream(&frames));
    // Half a frame, as at the end of a cut log.
    bytes.extend(&stream(&frames)[..9]);
    bytes.extend(stream(&frames));
    let (found, counts) = decoded(&bytes);
    assert_eq!(found.len(), 16);
    assert_eq!((counts.damaged, counts.damaged_bytes), (2, noise + 8));
}

#[test]
fn a_long_message_goes_in_several_frames() {
    let text = "é".repeat(200);
    let mut buffer = [0; 640];
    let mut output = Output::new(&mut buffer);
    assert!(put_text(&text, &mut output));
    assert!(
        !put_text(&text, &mut output),
        "there is no room for another"
    );
    let length = output.length();
    let parts: Vec<_> = decoded(&buffer[..length])
        .0
        .iter()
        .map(|frame| match frame {
            Frame::Text(text) => text.as_str().to_owned(),
            other => panic!("{other:?}"),
        })
        .collect();
    assert!(parts.concat().starts_with(&text));
    assert_eq!(parts[0].len(), TEXT_CAPACITY);
}

#[test]
fn unknown_kinds_are_refused() {
    let mut body = [0; 30];
    body[0] = 9;
    let checksum = CRC.checksum(&body[..20]).to_le_bytes();
    body[20..24].copy_from_slice(&checksum);
    let mut stuffed = [0; 40];
    let length = cobs::encode(&body[..24], &mut stuffed);
    assert_eq!(decode(&mut stuffed[..length]), None);
}

#[test]
fn a_sender_sends_a_state_in_pieces_and_never_more_than_fits() {
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let burst = |number: u32| NumberedBurst {
        number,
        flags: BoardFlags::empty(),
        burst: Burst {
            bytes: [number as u8; BURST_LENGTH],
            captured_at_us: u64::from(number) * 1000,
            missed_before: 0,
        },
    };
    let mut sender = Sender::new(10);
    assert!(sender.wants_state(0));
    sender.copy_state(&pipeline, 10);
    sender.measure_state(0);
    assert!(!sender.wants_state(1));
    let mut next = 10;
    let mut all = Vec::new();
    for round in 0..100_u64 {
        let mut buffer = [0; 512];
        let mut output = Output::new(&mut buffer);
        let limit = 10 + 10 * (round as u32 + 1);
        let bursts = || {
            (next < limit).then(|| {
                next += 1;
                burst(next - 1)
            })
        };
        sender.fill(round * 10_000, &mut output, bursts, || None);
        let length = output.length();
        all.extend_from_slice(&buffer[..length]);
    }
    let (frames, counts) = decoded(&all);
    assert_eq!(counts.damaged, 0);
    let numbers: Vec<u32> = frames
        .iter()
        .filter_map(|frame| match frame {
            Frame::Burst(burst) => Some(burst.number),
            _ => None,
        })
        .collect();
    assert_eq!(numbers, (10..next).collect::<Vec<_>>());
    let mut state = Vec::new();
    for frame in &frames {
        if let Frame::StatePiece(piece) = frame {
            assert_eq!((piece.number, usize::from(piece.offset)), (10, state.len()));
            state.extend_from_slice(piece.bytes());
        }
    }
    let mut restored = Pipeline::new(&full_settings());
    let mut reader = StateReader::new(&state);
    restored.visit_state(&mut reader);
    assert!(reader.is_complete());
    assert_eq!(restored, pipeline);
    assert_eq!(
        restored.update(&burst(10).burst, BoardFlags::empty()),
        pipeline.update(&burst(10).burst, BoardFlags::empty())
    );
    assert!(matches!(frames[0], Frame::Configuration(configuration)
        if configuration.from_number == 10 && configuration.revision == REVISION));
}

/// Everything that a sender writes in one call with this much room.
fn filled(
    sender: &mut Sender,
    now_us: u64,
    room: usize,
    mut readings: impl FnMut() -> Option<CompassReading>,
) -> Vec<Frame> {
    let mut buffer = vec![0; room];
    let mut output = Output::new(&mut buffer);
    sender.fill(now_us, &mut output, || None, &mut readings);
    let length = output.length();
    decoded(&buffer[..length]).0
}

#[test]
fn the_heading_filter_follows_the_pipeline_in_pieces_and_comes_back() {
    let pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut heading = Heading::new(CompassKnowledge::Calibrated);
    heading.set_declination(0.25);
    let mut sender = Sender::new(10);
    assert!(!sender.wants_heading());
    sender.copy_state(&pipeline, 10);
    sender.measure_state(0);
    let mut calls = 0;
    while !sender.wants_heading() {
        calls += 1;
        assert!(calls < 10, "the pipeline is sent in time");
        let frames = filled(&mut sender, calls, 992, || None);
        assert!(!frames.iter().any(|it| matches!(it, Frame::HeadingPiece(_))));
    }
    sender.copy_heading(Some(&heading), 7, 42);
    assert!(!sender.wants_heading());
    sender.measure_state(100);
    assert!(!sender.wants_state(9_999_000) && sender.wants_state(10_000_000));
    let mut state = Vec::new();
    for call in 0..10 {
        for frame in filled(&mut sender, 101 + call, 992, || None) {
            let Frame::HeadingPiece(piece) = frame else {
                panic!("{frame:?}");
            };
            assert_eq!((piece.number, usize::from(piece.offset)), (42, state.len()));
            state.extend_from_slice(piece.bytes());
        }
    }
    let mut restored = HeadingState {
        next_reading: 0,
        filter: None,
    };
    let mut reader = StateReader::new(&state);
    restored.visit_state(&mut reader);
    assert!(reader.is_complete());
    assert_eq!((restored.next_reading, restored.filter), (7, Some(heading)));
    assert!(
        !sender.wants_heading(),
        "once for each state of the pipeline"
    );
}

#[test]
fn without_a_reading_no_heading_filter_is_sent() {
    let mut sender = Sender::new(0);
    sender.copy_state(&Pipeline::new(&Settings::new(&Part::MPU_6050)), 0);
    sender.measure_state(0);
    while !sender.wants_heading() {
        filled(&mut sender, 1, 992, || None);
    }
    sender.copy_heading(None, 0, 5);
    sender.measure_state(2);
    assert!(!sender.wants_heading());
    assert_eq!(filled(&mut sender, 3, 992, || None), []);
}

#[test]
fn readings_wait_for_room_in_order() {
    let mut sender = Sender::new(0);
    let mut number = 0;
    let mut readings = || {
        number += 1;
        Some(CompassReading { number, ..READING })
    };
    let room = 2 * BYTES_PER_READING + 5;
    let mut found = filled(&mut sender, 0, room, &mut readings);
    assert_eq!(found.len(), 2);
    found.extend(filled(&mut sender, 1, room, &mut readings));
    let numbers: Vec<u32> = found
        .iter()
        .map(|frame| match frame {
            Frame::Reading(reading) => reading.number,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(numbers, [1, 2, 3, 4]);
}

#[test]
fn a_heading_is_sent_when_it_changes_and_after_a_second() {
    let mut sender = Sender::new(0);
    let mut send = |now_us, heading| {
        let mut buffer = [0; 64];
        let mut output = Output::new(&mut buffer);
        sender.put_heading(now_us, heading, &mut output);
        let length = output.length();
        decoded(&buffer[..length]).0
    };
    assert_eq!(send(0, HEADING), [Frame::Heading(HEADING)]);
    assert_eq!(send(999_999, HEADING), []);
    let next = TimedHeading {
        t_us: HEADING.t_us + 1,
        ..HEADING
    };
    assert_eq!(send(999_999, next), [Frame::Heading(next)]);
    assert_eq!(send(1_999_998, next), []);
    assert_eq!(send(1_999_999, next), [Frame::Heading(next)]);
}

proptest! {
    #[test]
    fn any_bytes_are_skipped_or_decode_to_their_own_encoding(bytes: Vec<u8>) {
        for frame in decoded(&bytes).0 {
            // An accepted frame is read back from its own encoding.
            prop_assert_eq!(decoded(&stream(&[frame])).0, [frame]);
        }
    }

    #[test]
    fn a_damaged_byte_costs_its_own_frame_alone(place: prop::sample::Index, flip in 1..=255_u8) {
        let frames = examples();
        let mut bytes = stream(&frames);
        let place = place.index(bytes.len());
        bytes[place] ^= flip;
        let mut damaged = 0;
        let mut start = 0;
        for (index, frame) in frames.iter().enumerate() {
            start += stream(&[*frame]).len();
            if place < start {
                damaged = index;
                break;
            }
        }
        let found = decoded(&bytes).0;
        for (index, frame) in frames.iter().enumerate() {
            prop_assert!(index == damaged || found.contains(frame), "{index} of {damaged}");
        }
        prop_assert!(found.iter().all(|frame| frames.contains(frame)));
    }

    #[test]
    fn a_text_is_cut_at_a_character(text in "[a°€😀]{0,200}") {
        let cut = Text::new(&text);
        prop_assert!(text.starts_with(cut.as_str()));
        prop_assert!(text.len() <= TEXT_CAPACITY || cut.as_str().len() > TEXT_CAPACITY - 4);
    }
}
