//! The fuzz targets' bodies, each with a bounded number of random inputs: noise, and text that is nearly right.

use proptest::prelude::*;

#[path = "../fuzz/bodies/commands.rs"]
mod commands;

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

proptest! {
    #[test]
    fn commands_hold(bytes in prop_oneof![nearly_commands(), prop::collection::vec(any::<u8>(), 0..2000)]) {
        commands::run(&bytes);
    }
}
