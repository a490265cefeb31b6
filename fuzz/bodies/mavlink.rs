//! Any bytes from a ground station: what is answered is made of whole frames with numbers in a row.

use aplomb::calibration::Record;
use aplomb::estimator::Sample;
use aplomb::telemetry::Output;
use aplomb::telemetry::mavlink::{Outcome, Session, Vehicle};

/// Runs the bytes through a session.
///
/// # Panics
///
/// When something is not as it should be.
pub fn run(bytes: &[u8]) {
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
            sample: &sample,
            temperature_celsius: 0.0,
            record: &record,
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
    // Nothing is kept back for ever.
    session.poll(now_us + 1_000_000, &mut |_| text += 1);
    let before = text;
    session.receive(b'x', now_us + 1_000_001, &mut |_| text += 1);
    assert_eq!(text, before + 1);
}
