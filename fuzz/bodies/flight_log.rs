//! Any bytes as a flight log: what the decoder accepts is a frame that encodes to itself, and it finds its feet again.

use aplomb::telemetry::log::{Decoder, FRAME_CAPACITY, Frame, Text, encode};

/// Runs the bytes through a decoder.
///
/// # Panics
///
/// When something is not as it should be.
pub fn run(bytes: &[u8]) {
    let mut decoder = Decoder::new();
    let mut found = 0;
    for byte in bytes {
        let Some(frame) = decoder.push(*byte) else {
            continue;
        };
        found += 1;
        let mut place = [0; FRAME_CAPACITY];
        let again: Vec<_> = {
            let mut second = Decoder::new();
            let bytes = encode(&frame, &mut place).iter();
            bytes.filter_map(|byte| second.push(*byte)).collect()
        };
        // Bit patterns that are no number are not equal to themselves, but look alike.
        assert_eq!(format!("{again:?}"), format!("{:?}", [frame]));
    }
    let counts = decoder.counts();
    assert_eq!(counts.frames, found);
    assert!(counts.damaged_bytes <= bytes.len() as u64);

    let whole = Frame::Text(Text::new("all is well"));
    let mut place = [0; FRAME_CAPACITY];
    let next = encode(&whole, &mut place)
        .iter()
        .filter_map(|byte| decoder.push(*byte))
        .last();
    assert_eq!(next, Some(whole));
}
