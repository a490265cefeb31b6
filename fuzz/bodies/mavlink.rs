//! Random bytes from a ground station: answers are whole frames with consecutive numbers.
//!
//! The first byte selects the form of the rest: unchanged, or as payloads of frames. Each payload
//! follows two bytes with its message and length. The harness adds the checksum to payloads, so
//! that they reach the decoder. It builds frames independently of the library.

use aplomb::compass::CompassStatus;
use aplomb::estimator::Sample;
use aplomb::settings::Record;
use aplomb::telemetry::Output;
use aplomb::telemetry::mavlink::{Outcome, Session, Vehicle};

/// Number and extra checksum byte of each known message, and of an unknown one.
pub const MESSAGES: [(u8, u8); 8] = [
    (0, 50),
    (20, 214),
    (21, 159),
    (23, 168),
    (43, 132),
    (75, 158),
    (76, 152),
    (4, 237),
];

/// Runs the bytes through a session.
///
/// # Panics
///
/// Panics if an invariant is violated.
pub fn run(bytes: &[u8]) {
    match bytes {
        [choice, payloads @ ..] if choice & 1 == 1 => hear(&framed(payloads)),
        [_, stream @ ..] => hear(stream),
        [] => {}
    }
}

/// Builds MAVLink 2 frames with right checksums.
fn framed(mut payloads: &[u8]) -> Vec<u8> {
    let mut stream = Vec::new();
    while let [choice, length, rest @ ..] = payloads {
        let (payload, others) = rest.split_at(rest.len().min((*length).into()));
        payloads = others;
        let (message, extra) = MESSAGES[usize::from(choice % 8)];
        let start = stream.len();
        stream.extend([0xFD, payload.len() as u8, 0, 0, 7, 255, 190, message, 0, 0]);
        stream.extend(payload);
        let covered = [&stream[start + 1..], &[extra]].concat();
        stream.extend(crc_16(&covered).to_le_bytes());
    }
    stream
}

/// CRC-16/MCRF4XX bit by bit: reflected, polynomial 0x1021.
fn crc_16(bytes: &[u8]) -> u16 {
    bytes.iter().fold(u16::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u16::from(byte), |crc, _| {
            (crc >> 1) ^ (0x8408 & 0_u16.wrapping_sub(crc & 1))
        })
    })
}

fn hear(bytes: &[u8]) {
    let mut session = Session::new();
    let (sample, record) = (Sample::default(), Record::default());
    let mut text = 0;
    let mut next_number = 0_u8;
    let mut now_us = 0;
    for chunk in bytes.chunks(97) {
        now_us += 20_000;
        for byte in chunk {
            session.receive(*byte, now_us, &mut |_| text += 1);
        }
        while let Some((ticket, _)) = session.take_action() {
            session.answer(ticket, Outcome::NotNow);
        }
        let mut buffer = [0; 300];
        let mut output = Output::new(&mut buffer);
        let vehicle = Vehicle {
            snapshot: None,
            is_due: false,
            sample: &sample,
            temperature_celsius: 0.0,
            heading: None,
            compass: CompassStatus::default(),
            record: &record,
            baud: 115_200,
            is_armed: false,
            bursts_failed: 0,
        };
        session.fill(now_us, &vehicle, &mut output);
        let length = output.length();
        let mut sent = &buffer[..length];
        while let [start, payload, _, _, number, ..] = *sent {
            assert_eq!((start, number), (0xFD, next_number));
            next_number = next_number.wrapping_add(1);
            sent = &sent[12 + usize::from(payload)..];
        }
        assert!(sent.is_empty());
    }
    assert!(text <= bytes.len());
    // Every byte is released in the end.
    session.poll(now_us + 1_000_000, &mut |_| text += 1);
    let before = text;
    session.receive(b'x', now_us + 1_000_001, &mut |_| text += 1);
    assert_eq!(text, before + 1);
}
