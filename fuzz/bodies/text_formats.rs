//! Random bytes as the module's text formats, as a teapot packet, and as a line of `bursts.csv`. An
//! accepted input encodes to the same numbers, and every encoder's output is accepted.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::classic::ClassicAngles;
use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::Burst;
use aplomb::pipeline::Snapshot;
use aplomb::telemetry::{bursts, classic, heading, teapot, teleplot, text};

/// Decodes the bytes line by line in every format, and encodes an attitude made of the first of
/// them.
///
/// # Panics
///
/// Panics if an invariant is violated.
pub fn run(bytes: &[u8]) {
    for line in bytes.split(|byte| *byte == b'\n') {
        if let Ok(line) = std::str::from_utf8(line) {
            read(line);
        }
    }
    for packet in bytes.windows(teapot::PACKET_LENGTH) {
        let packet = packet.try_into().expect("a window has its length");
        if let Some((attitude, counter)) = teapot::decode(packet) {
            assert_eq!(teapot::encode(attitude, counter), *packet);
        }
    }
    if let Some(bytes) = bytes.first_chunk() {
        write(bytes);
    }
}

fn read(line: &str) {
    match bursts::decode(line) {
        Ok(row) => {
            let again = row.to_string();
            assert!(again.len() <= bursts::LINE_LENGTH);
            assert_eq!(bursts::decode(&again), Ok(row));
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    match text::decode(line) {
        Ok(numbers) => {
            let mut place = [0; text::LINE_LENGTH];
            let again = text_of(text::encode_line(&numbers, &mut place));
            assert_eq!(numbers_of(text::decode(again)), numbers_of(Ok(numbers)));
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    if let Some(angles) = classic::decode(line) {
        let mut place = [0; classic::LINE_LENGTH];
        let again = classic::decode(text_of(classic::encode(&angles, &mut place)));
        assert_eq!(format!("{again:?}"), format!("{:?}", Some(plain(angles))));
    }
    if let Some(line) = heading::decode(line) {
        let mut place = [0; heading::LINES_LENGTH];
        let again = heading::decode(text_of(heading::encode(&line, &mut place)));
        // Minus zero is written as zero.
        let plain = |line: heading::Line| {
            let numbers = [line.heading_deg + 0.0, line.sigma_deg + 0.0];
            format!("{numbers:?} {}", line.is_valid)
        };
        assert_eq!(again.map(plain), Some(plain(line)));
    }
    if let Some((label, value)) = teleplot::decode(line) {
        assert!(line.starts_with(&format!(">{label}:")));
        assert!(value.is_nan() || value.abs() < 100_000.0);
    }
}

/// Encodes an attitude of any numbers in every format: each is read back, and they agree.
fn write(bytes: &[u8; 32]) {
    let words = bytes
        .as_chunks()
        .0
        .iter()
        .map(|word| u32::from_le_bytes(*word));
    let words: Vec<u32> = words.collect();
    let number = |place: usize| f32::from_bits(words[place]);
    let snapshot = Snapshot {
        t_us: 0,
        attitude: Quaternion::new(number(0), number(1), number(2), number(3)),
        body_rates_rad_s: Vector3::new(number(4), number(5), number(6)),
        flags: Flags::from_bits_retain(words[7]),
        tilt_variance_rad2: number(7),
    };
    let mut place = [0; text::LINE_LENGTH];
    let written = text_of(text::encode(&snapshot, &mut place));
    assert!(written.ends_with('\n'));
    let numbers = text::decode(written).expect("what is written is read");
    let expected = text::Line::from(&snapshot);
    assert_eq!(numbers.is_valid, expected.is_valid);
    for (read, expected) in [
        (numbers.roll_deg, expected.roll_deg),
        (numbers.pitch_deg, expected.pitch_deg),
        (numbers.yaw_deg, expected.yaw_deg),
        (numbers.roll_rate_deg_s, expected.roll_rate_deg_s),
        (numbers.pitch_rate_deg_s, expected.pitch_rate_deg_s),
        (numbers.yaw_rate_deg_s, expected.yaw_rate_deg_s),
    ] {
        check(read, expected);
    }

    let mut place = [0; teleplot::LINES_LENGTH];
    let lines = text_of(teleplot::encode(&snapshot, &mut place)).lines();
    let values: Vec<String> = lines
        .map(|line| teleplot::decode(line).expect("what is written is read").1)
        .map(|value| (value + 0.0).to_string())
        .collect();
    assert_eq!(values, numbers_of(Ok(numbers)));

    let mut place = [0; classic::LINE_LENGTH];
    let expected = classic::angles_of(&snapshot);
    let read = classic::decode(text_of(classic::encode(&expected, &mut place)));
    let read = read.expect("what is written is read");
    check(read.roll_deg, expected.roll_deg);
    check(read.roll_rate_deg_s, expected.roll_rate_deg_s);
    check(read.pitch_deg, expected.pitch_deg);
    check(read.pitch_rate_deg_s, expected.pitch_rate_deg_s);

    assert!(teapot::decode(&teapot::encode(snapshot.attitude, bytes[31])).is_some());

    let flags = Flags::from_bits_truncate(words[7]);
    assert_eq!(flags.to_string().parse(), Ok(flags));

    let burst = Burst {
        bytes: std::array::from_fn(|place| bytes[place]),
        captured_at_us: u64::from(words[4]) << 32 | u64::from(words[5]),
        missed_before: bytes[31] & 1,
    };
    let row = bursts::Row {
        burst,
        board: BoardFlags::from_bits_truncate(words[7]),
        is_armed: bytes[31] & 2 != 0,
    };
    assert_eq!(bursts::decode(&row.to_string()), Ok(row));
}

/// Compares a decoded number with the original: two decimals, at most 99999.99 either way, and
/// 180° instead of −180°.
fn check(read: f32, expected: f32) {
    if expected.is_nan() {
        return assert!(read.is_nan(), "{read}");
    }
    let written = expected.clamp(-99_999.99, 99_999.99);
    // Half a hundredth, and the rounding of a number of this size.
    let tolerance = 0.005_001 + written.abs() * f32::EPSILON;
    let is_half_turn = read == 180.0 && written < -179.99;
    assert!(
        (read - written).abs() <= tolerance || is_half_turn,
        "{expected} {read}"
    );
}

fn text_of(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).expect("ASCII")
}

/// Returns the numbers of a line, comparable: NaNs are equal, −180° is 180°, and −0 is 0.
fn numbers_of(line: Result<text::Line, text::DecodeError>) -> [String; 7] {
    let line = line.expect("what is written is read");
    let angle = |degrees: f32| if degrees == -180.0 { 180.0 } else { degrees };
    [
        angle(line.roll_deg),
        line.pitch_deg,
        angle(line.yaw_deg),
        line.roll_rate_deg_s,
        line.pitch_rate_deg_s,
        line.yaw_rate_deg_s,
        f32::from(u8::from(line.is_valid)),
    ]
    .map(|number| (number + 0.0).to_string())
}

/// Replaces −0 by 0.
fn plain(angles: ClassicAngles) -> ClassicAngles {
    ClassicAngles {
        roll_deg: angles.roll_deg + 0.0,
        roll_rate_deg_s: angles.roll_rate_deg_s + 0.0,
        pitch_deg: angles.pitch_deg + 0.0,
        pitch_rate_deg_s: angles.pitch_rate_deg_s + 0.0,
    }
}
