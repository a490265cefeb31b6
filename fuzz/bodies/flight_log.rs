//! Random bytes as a flight log: an accepted frame is read back from its own encoding, and the
//! decoder recovers after any input.
//!
//! The first byte selects the form of the rest: unchanged, or as bodies of frames, each after a
//! byte with its length. The harness adds the CRC to bodies, so that they reach the decoder. It
//! builds frames independently of the library.

use aplomb::telemetry::log::{Decoder, FRAME_CAPACITY, Frame, Text, encode};

/// Runs the bytes through a decoder.
///
/// # Panics
///
/// Panics if an invariant is violated.
pub fn run(bytes: &[u8]) {
    match bytes {
        [choice, bodies @ ..] if choice & 1 == 1 => read(&framed(bodies)),
        [_, stream @ ..] => read(stream),
        [] => {}
    }
}

/// Builds frames: bodies with their CRCs, stuffed by COBS, between zeros.
fn framed(mut bodies: &[u8]) -> Vec<u8> {
    let mut stream = Vec::new();
    while let [length, rest @ ..] = bodies {
        let (body, others) = rest.split_at(rest.len().min((*length).into()));
        bodies = others;
        let whole = [body, &crate::checksums::crc_32(body).to_le_bytes()].concat();
        stream.push(0);
        // A run without a zero is at most 254 bytes long and begins with its length plus one. A
        // longer run is split, without a zero after the parts.
        for run in whole.split(|byte| *byte == 0) {
            let mut parts = run.chunks(254).peekable();
            if parts.peek().is_none() {
                stream.push(1);
            }
            while let Some(part) = parts.next() {
                stream.push(part.len() as u8 + 1);
                stream.extend(part);
                if part.len() == 254 && parts.peek().is_none() {
                    stream.push(1);
                }
            }
        }
        stream.push(0);
    }
    stream
}

fn read(bytes: &[u8]) {
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
        // A NaN is not equal to itself, but its text is.
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
