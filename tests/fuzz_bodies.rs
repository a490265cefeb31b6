//! The fuzz targets' bodies, each with a bounded number of random inputs: noise, and text that is nearly right.

use proptest::prelude::*;

#[path = "../fuzz/bodies/commands.rs"]
mod commands;
#[path = "../fuzz/bodies/flight_log.rs"]
mod flight_log;
#[cfg(feature = "mavlink")]
#[path = "../fuzz/bodies/mavlink.rs"]
mod mavlink;

#[path = "../fuzz/bodies/stored_record.rs"]
mod stored_record;

/// Bytes, pieces of commands and line ends.
fn nearly_commands() -> impl Strategy<Value = Vec<u8>> {
    let words = [
        "help",
        "status",
        "show",
        "save",
        "forget",
        "self-test",
        "arm",
        "disarm",
        "calibrate ",
        "gyro",
        "accel",
        "level",
        "temperature",
        "done",
        "stop",
        "mount ",
        "find",
        "+x-z",
        "z-up",
        "rate ",
        "baud ",
        "format ",
        "text",
        "classic",
        "9600",
        "921600",
        "50",
        "1",
        " ",
        "\n",
        "\n",
        "\n",
        "\r",
        "\r\n",
        "\x08",
    ];
    let piece = prop_oneof![
        8 => prop::sample::select(words.to_vec()).prop_map(|word| word.as_bytes().to_vec()),
        1 => prop::collection::vec(any::<u8>(), 0..20),
    ];
    prop::collection::vec(piece, 0..200).prop_map(|pieces| pieces.concat())
}

/// Frames of a flight log, whole and damaged, and noise.
fn nearly_a_log() -> impl Strategy<Value = Vec<u8>> {
    use aplomb::mpu6050::Burst;
    use aplomb::pipeline::Snapshot;
    use aplomb::telemetry::log::{FRAME_CAPACITY, Frame, NumberedBurst, Text, encode};
    let bytes = |frame: Frame| encode(&frame, &mut [0; FRAME_CAPACITY]).to_vec();
    let burst = (any::<u32>(), any::<[u8; 14]>()).prop_map(move |(number, data)| {
        bytes(Frame::Burst(NumberedBurst {
            number,
            flags: aplomb::health::Flags::NONE,
            burst: Burst {
                bytes: data,
                captured_at_us: number.into(),
                missed_before: 0,
            },
        }))
    });
    let piece = prop_oneof![
        4 => burst,
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
    prop::collection::vec(damaged, 0..40).prop_map(|pieces| pieces.concat())
}

/// Frames as ground stations send them, with right and wrong checksums, and noise.
#[cfg(feature = "mavlink")]
fn nearly_frames() -> impl Strategy<Value = Vec<u8>> {
    // Number and the byte that goes into the checksum, of what is understood and of one that is not.
    let known = [
        (0, 50),
        (20, 214),
        (21, 159),
        (23, 168),
        (43, 132),
        (75, 158),
        (76, 152),
        (4, 237),
    ];
    let frame = (
        prop::sample::select(known.to_vec()),
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
    prop::collection::vec(piece, 0..40).prop_map(|pieces| pieces.concat())
}

/// A field that may be absent, of so many numbers, most of them ordinary.
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

/// Records, right and nearly right, as the fuzz target's body takes them.
fn nearly_records() -> impl Strategy<Value = Vec<u8>> {
    let mounts = [
        &b"\0"[..],
        b"\x01+x-z",
        b"\x01-z+y",
        b"\x01z-up",
        b"\x01+x+x",
    ];
    let ends = [&b""[..], b"", b"", b"\0"];
    let body = (
        prop::sample::select(mounts.to_vec()),
        nearly_optional(4),
        nearly_optional(12),
        nearly_optional(9),
        nearly_optional(4),
        (0_u8..4, 0_u16..3, 0_u32..3),
        prop::sample::select(ends.to_vec()),
    );
    let record = body
        .prop_map(|(mount, a, b, c, d, (format, rate, baud), end)| {
            let preferences = [&[format][..], &rate.to_le_bytes(), &baud.to_le_bytes()].concat();
            [&[1], mount, &a, &b, &c, &d, &preferences, end].concat()
        })
        .boxed();
    prop_oneof![
        10 => record.clone(),
        // Laid into the slot whole, with bytes changed here and there.
        1 => (record, prop::collection::vec((any::<usize>(), any::<u8>()), 0..3)).prop_map(
            |(record, changes)| {
                let mut slot = stored_record::image(1, &record[1..]);
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

proptest! {
    #[test]
    fn stored_records_hold(bytes in prop_oneof![
        10 => nearly_records(),
        1 => prop::collection::vec(any::<u8>(), 0..300),
    ]) {
        stored_record::run(&bytes);
    }

    #[test]
    fn commands_hold(bytes in prop_oneof![nearly_commands(), prop::collection::vec(any::<u8>(), 0..2000)]) {
        commands::run(&bytes);
    }

    #[test]
    fn flight_logs_hold(bytes in prop_oneof![nearly_a_log(), prop::collection::vec(any::<u8>(), 0..2000)]) {
        flight_log::run(&bytes);
    }
}

#[cfg(feature = "mavlink")]
proptest! {
    #[test]
    fn ground_stations_hold(bytes in prop_oneof![nearly_frames(), prop::collection::vec(any::<u8>(), 0..2000)]) {
        mavlink::run(&bytes);
    }
}
