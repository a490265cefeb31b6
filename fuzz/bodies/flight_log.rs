//! Any bytes as a flight log: what the decoder accepts is a frame that encodes to itself, and it finds its feet again.
//!
//! The first byte chooses: the rest as it is, or as bodies of frames, each after a byte that says how long it is, so that the
//! check of the CRC does not keep everything from the decoder. Frames are put together here, apart from the library.

use aplomb::telemetry::log::{Decoder, FRAME_CAPACITY, Frame, Text, encode};

/// Runs the bytes through a decoder.
///
/// # Panics
///
/// When something is not as it should be.
pub fn run(bytes: &[u8]) {
    match bytes {
        [choice, bodies @ ..] if choice & 1 == 1 => read(&framed(bodies)),
        [_, stream @ ..] => read(stream),
        [] => {}
    }
}

/// The bodies with their CRCs, stuffed by COBS, between zeros.
fn framed(mut bodies: &[u8]) -> Vec<u8> {
    let mut stream = Vec::new();
    while let [length, rest @ ..] = bodies {
        let (body, others) = rest.split_at(rest.len().min((*length).into()));
        bodies = others;
        let whole = [body, &crate::checksums::crc_32(body).to_le_bytes()].concat();
        stream.push(0);
        // Each run without a zero is at most 254 bytes long, and begins with its length and one; a longer one has no zero behind it.
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
