//! The fuzz targets' bodies, each with a bounded number of random inputs: noise, and text that is nearly right.

use proptest::prelude::*;

#[path = "../fuzz/bodies/commands.rs"]
mod commands;
#[path = "../fuzz/bodies/flight_log.rs"]
mod flight_log;
#[cfg(feature = "mavlink")]
#[path = "../fuzz/bodies/mavlink.rs"]
mod mavlink;

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

proptest! {
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
