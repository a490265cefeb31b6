//! Runs of the fuzz targets' bodies, each with a bounded number of random inputs: noise, and almost
//! valid text.

use proptest::prelude::*;

#[path = "../fuzz/bodies/checksums.rs"]
mod checksums;
#[path = "../fuzz/bodies/command_words.rs"]
mod command_words;
#[path = "../fuzz/bodies/commands.rs"]
mod commands;
#[path = "../fuzz/bodies/flight_log.rs"]
mod flight_log;
#[cfg(feature = "mavlink")]
#[path = "../fuzz/bodies/mavlink.rs"]
mod mavlink;
#[path = "../fuzz/bodies/sensor.rs"]
mod sensor;
#[path = "../fuzz/bodies/state.rs"]
mod state;
#[path = "../fuzz/bodies/stored_record.rs"]
mod stored_record;
#[path = "../fuzz/bodies/text_formats.rs"]
mod text_formats;

/// Bytes, pieces of commands and line ends.
fn nearly_commands() -> impl Strategy<Value = Vec<u8>> {
    let mut words = command_words::WORDS.to_vec();
    words.extend(["baud ", "921600", "1", "\r", "\r\n"]);
    // A line is short.
    words.extend(["\n"; 3]);
    let piece = prop_oneof![
        8 => prop::sample::select(words).prop_map(|word| word.as_bytes().to_vec()),
        1 => prop::collection::vec(any::<u8>(), 0..20),
    ];
    prop::collection::vec(piece, 0..200).prop_map(|pieces| pieces.concat())
}

/// Frames of a flight log, whole and damaged, and noise.
fn nearly_a_log() -> impl Strategy<Value = Vec<u8>> {
    use aplomb::estimator::heading::{CompassKnowledge, HeadingEstimate};
    use aplomb::mpu6050::Burst;
    use aplomb::pipeline::{CompassReading, Snapshot};
    use aplomb::telemetry::log::{
        FRAME_CAPACITY, Frame, NumberedBurst, Text, TimedHeading, encode,
    };
    let bytes = |frame: Frame| encode(&frame, &mut [0; FRAME_CAPACITY]).to_vec();
    let burst = (any::<u32>(), any::<[u8; 14]>()).prop_map(move |(number, data)| {
        bytes(Frame::Burst(NumberedBurst {
            number,
            flags: aplomb::health::BoardFlags::empty(),
            burst: Burst {
                bytes: data,
                captured_at_us: number.into(),
                missed_before: 0,
            },
        }))
    });
    let reading = any::<(u32, [f32; 3], bool)>().prop_map(move |(number, ut, starts_filter)| {
        bytes(Frame::Reading(CompassReading {
            number,
            sample_t_us: number.into(),
            measured_us: number,
            field: aplomb::units::MagneticField { ut },
            knowledge: CompassKnowledge::Calibrated,
            declination_rad: 0.1,
            starts_filter,
        }))
    });
    let heading = prop::option::of(any::<(f32, f32, bool)>()).prop_map(move |estimate| {
        let estimate = estimate.map(|(yaw_offset_rad, sigma_rad, is_valid)| HeadingEstimate {
            yaw_offset_rad,
            sigma_rad,
            is_valid,
        });
        bytes(Frame::Heading(TimedHeading { t_us: 7, estimate }))
    });
    let piece = prop_oneof![
        4 => burst,
        2 => reading,
        1 => heading,
        1 => Just(bytes(Frame::Attitude(Snapshot::default()))),
        1 => "[ -~]{0,90}".prop_map(move |text| bytes(Frame::Text(Text::new(&text)))),
        1 => prop::collection::vec(any::<u8>(), 0..30),
    ];
    let flip = prop::option::weighted(0.3, (any::<prop::sample::Index>(), 1..=255_u8));
    let damaged = (piece, flip).prop_map(|(mut piece, flip)| {
        if let Some((place, bits)) = flip
            && !piece.is_empty()
        {
            let place = place.index(piece.len());
            piece[place] ^= bits;
        }
        piece
    });
    let stream = prop::collection::vec(damaged, 0..40).prop_map(|pieces| pieces.concat());
    // Bodies of frames: a kind, and bytes of about the right length, of which the first are
    // plausible.
    let body = (
        1_u8..=8,
        prop::sample::select(vec![29_usize, 40, 104, 20, 60, 27, 15]),
        any::<u8>(),
    )
        .prop_flat_map(|(kind, length, text)| {
            let byte =
                prop_oneof![4 => 0_u8..6, 1 => any::<u8>(), 1 => Just(0x68), 1 => 97_u8..123];
            prop::collection::vec(byte, length).prop_map(move |mut rest| {
                if kind == 5 {
                    rest[0] = (length - 1) as u8 - (text & 1);
                }
                [vec![length as u8 + 1, kind], rest].concat()
            })
        });
    let bodies = prop::collection::vec(body, 0..10).prop_map(|bodies| bodies.concat());
    prop_oneof![
        stream.prop_map(|stream| [vec![0], stream].concat()),
        bodies.prop_map(|bodies| [vec![1], bodies].concat()),
    ]
}

/// Frames as ground stations send them, with right and wrong checksums, and noise.
#[cfg(feature = "mavlink")]
fn nearly_frames() -> impl Strategy<Value = Vec<u8>> {
    let frame = (
        prop::sample::select(mavlink::MESSAGES.to_vec()),
        prop::collection::vec(prop_oneof![Just(0_u8), Just(1), any::<u8>()], 0..40),
        prop::bool::weighted(0.8),
    )
        .prop_map(|((message, extra), payload, is_right)| {
            let mut bytes = vec![0xFD, payload.len() as u8, 0, 0, 7, 255, 190, message, 0, 0];
            bytes.extend(payload);
            let checksum = ::mavlink::calculate_crc(&bytes[1..], extra);
            bytes.extend((checksum ^ u16::from(!is_right)).to_le_bytes());
            bytes
        });
    let piece = prop_oneof![
        6 => frame,
        1 => Just(b"format text\n".to_vec()),
        1 => prop::collection::vec(any::<u8>(), 0..30),
    ];
    let stream = prop::collection::vec(piece, 0..40).prop_map(|pieces| pieces.concat());
    let payloads = prop::collection::vec((any::<u8>(), any::<[u8; 12]>()), 0..20).prop_map(|all| {
        all.into_iter()
            .flat_map(|(message, payload)| [message, 12].into_iter().chain(payload))
            .collect()
    });
    prop_oneof![
        4 => stream.prop_map(|stream| [vec![0], stream].concat()),
        1 => payloads.prop_map(|payloads: Vec<u8>| [vec![1], payloads].concat()),
    ]
}

/// An optional field of this many numbers, most of them plausible.
fn nearly_optional(numbers: usize) -> impl Strategy<Value = Vec<u8>> {
    let number = prop_oneof![
        30 => -1.0e3_f32..1.0e3,
        1 => prop::sample::select(vec![f32::NAN, f32::INFINITY, -0.0, f32::MAX]),
    ];
    let present = prop::collection::vec(number, numbers).prop_map(|numbers| {
        let bytes = numbers.iter().flat_map(|number| number.to_le_bytes());
        [1].into_iter().chain(bytes).collect()
    });
    prop_oneof![10 => present, 10 => Just(vec![0]), 1 => Just(vec![2])]
}

/// Settings of a compass as a record has them: choice, mount, correction.
fn compasses() -> Vec<Vec<u8>> {
    let mut corrected = vec![1, 0, 1];
    corrected.extend((1..=12_u8).flat_map(|nth| f32::from(nth).to_le_bytes()));
    vec![vec![0; 3], [&[5, 1][..], b"+y-z", &[0]].concat(), corrected]
}

/// Records, valid and almost valid, as the fuzz target's body takes them.
fn nearly_records() -> impl Strategy<Value = Vec<u8>> {
    let mounts = [
        &b"\0"[..],
        b"\x01+x-z",
        b"\x01-z+y",
        b"\x01z-up",
        b"\x01+x+x",
    ];
    // The declination, that of version 2, and one byte too many.
    let ends = [
        &b"\0\0\0\0"[..],
        b"\0\0\x80\xBD",
        b"",
        b"\0\0\0\0\0",
        b"\0\0\xC0\x7F",
    ];
    let body = (
        prop::sample::select(mounts.to_vec()),
        nearly_optional(4),
        nearly_optional(12),
        nearly_optional(9),
        nearly_optional(4),
        (0_u8..4, 0_u16..3, 0_u32..3),
        (
            prop::sample::select(compasses()),
            prop::sample::select(ends.to_vec()),
        ),
    );
    let record = body
        .prop_map(
            |(mount, a, b, c, d, (format, rate, baud), (compass, end))| {
                let preferences =
                    [&[format][..], &rate.to_le_bytes(), &baud.to_le_bytes()].concat();
                [&[1], mount, &a, &b, &c, &d, &preferences, &compass, end].concat()
            },
        )
        .boxed();
    prop_oneof![
        10 => record.clone(),
        // The whole record is in the slot, with some bytes changed.
        1 => (record, prop::collection::vec((any::<usize>(), any::<u8>()), 0..3)).prop_map(
            |(record, changes)| {
                let mut slot = stored_record::image(3, &record[1..]);
                for (place, byte) in changes {
                    let place = place % slot.len();
                    slot[place] = byte;
                }
                slot.insert(0, 0);
                slot
            }
        ),
    ]
}

/// An attitude's 32 bytes, then lines and packets as the module and `bursts.csv` have them, some
/// with a byte changed.
fn nearly_text() -> impl Strategy<Value = Vec<u8>> {
    let number = "-?[0-9]{1,5}\\.[0-9]{2}|nan|-?180\\.00|-0\\.00|[0-9.e+-]{0,9}";
    let fields = |labels: [&'static str; 6], before: &'static str, after: &'static str| {
        prop::collection::vec(number, 6).prop_map(move |numbers| {
            let fields = labels.iter().zip(numbers);
            let fields = fields.map(|(label, number)| format!("{before}{label}:{number}{after}"));
            fields.collect::<String>() + before + "valid:1\n"
        })
    };
    let labels = [
        "roll",
        "pitch",
        "yaw",
        "roll_rate",
        "pitch_rate",
        "yaw_rate",
    ];
    let classic = prop::collection::vec(number, 4)
        .prop_map(|n| format!("Roll:{}({}),\tPitch:{}({})\r\n", n[0], n[1], n[2], n[3]));
    let heading = prop::collection::vec(number, 2).prop_map(|n| {
        format!(
            "heading:{}\theading_sigma:{}\theading_valid:1\n",
            n[0], n[1]
        )
    });
    let burst = "[0-9]{1,21},[0-9a-fA-F]{28},((MISSED|LATE|POLLED|VALID|x)[|]?){0,3}\n";
    let line = prop_oneof![
        fields(labels, "", "\t"),
        fields(labels, ">", "\n"),
        classic,
        heading,
        burst
    ];
    let packet = (any::<[u8; 8]>(), any::<u8>())
        .prop_map(|(numbers, counter)| [&b"$\x02"[..], &numbers, &[0, counter], b"\r\n"].concat());
    let piece = prop_oneof![4 => line.prop_map(String::into_bytes), 1 => packet];
    let change = prop::option::weighted(0.3, (any::<prop::sample::Index>(), any::<u8>()));
    let piece = (piece, change).prop_map(|(mut piece, change)| {
        if let Some((place, byte)) = change {
            let place = place.index(piece.len());
            piece[place] = byte;
        }
        piece
    });
    let number = prop_oneof![any::<f32>(), -4.0_f32..4.0, -1.0e6_f32..1.0e6];
    let attitude = prop::collection::vec(number, 8)
        .prop_map(|numbers| numbers.into_iter().flat_map(f32::to_le_bytes).collect());
    (attitude, prop::collection::vec(piece, 0..10))
        .prop_map(|(attitude, pieces): (Vec<u8>, _)| [attitude, pieces.concat()].concat())
}

/// Settings, a mostly known identity, and few faults, so that the driver runs most of its code.
fn nearly_a_sensor() -> impl Strategy<Value = Vec<u8>> {
    let identity = prop_oneof![
        4 => prop::sample::select(aplomb::mpu6050::PARTS.map(|part| part.who_am_i).to_vec()),
        1 => any::<u8>(),
    ];
    let fate = prop_oneof![60 => Just(0_u8), 1 => 1..=3_u8, 1 => any::<u8>()];
    let fates = prop_oneof![
        Just(Vec::new()),
        prop::collection::vec(fate, 0..500),
        // No sensor answers, for this many transfers.
        (0..500_usize).prop_map(|count| vec![1; count]),
    ];
    (any::<u8>(), identity, fates).prop_map(|(settings, identity, fates)| {
        [settings, identity].into_iter().chain(fates).collect()
    })
}

/// A filter, changes of its state or the state of an earlier run, and bursts, many like a sensor's.
fn nearly_a_state() -> impl Strategy<Value = Vec<u8>> {
    let changes = prop::collection::vec(any::<[u8; 3]>(), 0..30)
        .prop_map(|changes| [vec![changes.len() as u8], changes.concat()].concat());
    let known = (-1.0_f32..1.0, 0.0_f32..4.0, -0.5_f32..0.5, 0.0_f32..70.0).prop_map(
        |(w, tilt, bias, sigma)| {
            // A rotation about the first axis.
            let attitude = [w, (1.0 - w * w).sqrt(), 0.0, 0.0];
            let known = [&attitude[..], &[tilt, bias, -bias, 3.0 * bias, sigma]].concat();
            let bytes = known.into_iter().flat_map(f32::to_le_bytes);
            [0].into_iter().chain(bytes).collect::<Vec<u8>>()
        },
    );
    let level = any::<[u8; 2]>().prop_map(|[noise, pause]| {
        let [high, low] = 2048_i16.to_be_bytes();
        let mut step = [0; 16];
        (step[4], step[5], step[13], step[14]) = (high, low, noise, pause % 16);
        step
    });
    let bursts = prop::collection::vec(prop_oneof![level, any::<[u8; 16]>()], 0..60);
    (any::<u8>(), changes, known, bursts).prop_map(|(kind, changes, known, bursts)| {
        let before = if kind & 8 == 0 { changes } else { known };
        [vec![kind], before, bursts.concat()].concat()
    })
}

proptest! {
    #[test]
    fn text_formats_hold(bytes in prop_oneof![
        10 => nearly_text(),
        1 => prop::collection::vec(any::<u8>(), 0..300),
    ]) {
        text_formats::run(&bytes);
    }

    #[test]
    fn sensors_hold(bytes in prop_oneof![
        10 => nearly_a_sensor(),
        1 => prop::collection::vec(any::<u8>(), 0..300),
    ]) {
        sensor::run(&bytes);
    }

    #[test]
    fn states_hold(bytes in prop_oneof![
        10 => nearly_a_state(),
        1 => prop::collection::vec(any::<u8>(), 0..300),
    ]) {
        state::run(&bytes);
    }

    #[test]
    fn stored_records_hold(bytes in prop_oneof![
        10 => nearly_records(),
        1 => prop::collection::vec(any::<u8>(), 0..300),
    ]) {
        stored_record::run(&bytes);
    }

    #[test]
    fn commands_hold(bytes in prop_oneof![
        nearly_commands(),
        prop::collection::vec(any::<u8>(), 0..2000),
    ]) {
        commands::run(&bytes);
    }

    #[test]
    fn flight_logs_hold(bytes in prop_oneof![
        nearly_a_log(),
        prop::collection::vec(any::<u8>(), 0..2000),
    ]) {
        flight_log::run(&bytes);
    }
}

#[cfg(feature = "mavlink")]
proptest! {
    #[test]
    fn ground_stations_hold(bytes in prop_oneof![
        nearly_frames(),
        prop::collection::vec(any::<u8>(), 0..2000),
    ]) {
        mavlink::run(&bytes);
    }
}
