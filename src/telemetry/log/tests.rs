//! Frames encoded and decoded, damaged streams, and a sender with little room.

use proptest::prelude::*;

use super::super::output::Output;
use super::frame::CRC;
use super::*;
use crate::attitude::{Quaternion, Vector3};
use crate::calibration::{
    AccelerometerCorrection, Calibration, GyroscopeOffset, Mount, SymmetricMatrix, TemperatureModel,
};
use crate::estimator::REVISION;
use crate::health::{BoardFlags, Flags};
use crate::mpu6050::{
    AccelerometerRange, BURST_LENGTH, Burst, Config, GyroscopeRange, LowPass, Part,
};
use crate::pipeline::{Pipeline, Settings, Snapshot};
use crate::serialize::StateReader;

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
        },
        verifies_scales: true,
        sensor_delay_us: Some(123_456),
    }
}

fn examples() -> [Frame; 5] {
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
    ]
}

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
    assert_eq!((counts.frames, counts.damaged), (5, 0));
}

#[test]
fn frames_have_their_documented_lengths_and_fit_the_uart() {
    let [_, burst, attitude, ..] = examples();
    assert_eq!(stream(&[burst]).len(), BYTES_PER_BURST);
    assert_eq!(stream(&[attitude]).len(), BYTES_PER_ATTITUDE);
    // At 1 kHz with 50 attitudes, a configuration each second and a state in ten.
    let configuration = stream(&examples()[..1]).len();
    let piece = stream(&examples()[3..4]).len();
    let state = 2048_usize.div_ceil(PIECE_LENGTH) * piece;
    let a_second =
        1000 * BYTES_PER_BURST + 50 * stream(&[attitude]).len() + configuration + state / 10;
    assert!(a_second < 41_000, "{a_second}");
    assert!(a_second * 10 < 921_600 / 2, "half of the line is free");
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
    assert_eq!(found.len(), 10);
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
        sender.fill(round * 10_000, &mut output, || {
            (next < limit).then(|| {
                next += 1;
                burst(next - 1)
            })
        });
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
