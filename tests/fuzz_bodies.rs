//! The fuzz targets' bodies, each with a bounded number of random inputs: noise, and text that is nearly right.

use proptest::prelude::*;

#[path = "../fuzz/bodies/commands.rs"]
mod commands;

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
}
