//! The flight log: every burst, and what it takes to make the same attitudes of them again, to the bit.
//!
//! # Frames
//!
//! A frame is a body of at most [`BODY_CAPACITY`] bytes and its CRC-32 (ISO-HDLC, low byte first), stuffed by COBS so that no byte
//! in it is zero, between two zeros. Each frame has both its zeros, so a damaged one spoils no other, and each
//! means the same whatever was lost before it. Whatever else comes on the line (lines of text, halves of frames) is
//! counted and skipped. Why 32 bits: of ten minutes with 1 % of the bytes flipped, 16 would let a wrong frame through
//! every few logs.
//!
//! | kind | body | when |
//! |---|---|---|
//! | 1 | configuration: versions, the settings with the calibration, and the burst from which on they hold | at start, once a second, after a change |
//! | 2 | a burst: its number, what the board said of it, time (48 bits of µs), missed edges, 14 bytes | each |
//! | 3 | an attitude with time, rates, flags | at the rate that is set: to see, and to check a replay against |
//! | 4 | a piece of the filter's state | at start, every ten seconds, after a change |
//! | 5 | a message as text | as it comes |
//!
//! # How a replay is exact
//!
//! An attitude depends on every burst since the filter's start. A log may begin in mid-flight and have holes, so the
//! state itself travels: [`Pipeline::exchange`](crate::pipeline::Pipeline::exchange) as bytes (1.7 KiB), in pieces that
//! go between the bursts. A replay that has all pieces of a state, and every burst from that state's number on, gives
//! the same attitudes as the filter in flight until a burst is lost or the settings change; the next state makes it exact again. That
//! holds for the same [`REVISION`] of the filters.
//!
//! # The line
//!
//! At 1 kHz and 50 attitudes a second it takes 40 kB/s, 44 % of 921,600 baud, and 1.5 % of the core at 168 MHz ([`BYTES_PER_BURST`] says what a burst
//! takes). [`Sender`] never waits: what does not fit is left out, and the gap in the bursts' numbers says so. Configurations come
//! first, then bursts, then pieces of the state.

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

use super::Output;
use crate::estimator::{Filter, REVISION};
use crate::health::Flags;
use crate::mpu6050::{BURST_LENGTH, Burst, Part};
use crate::pipeline::{Pipeline, Settings, Snapshot};
use crate::state::{Exchange, Reader, Window};

/// The version of the frames' form. A decoder refuses the configuration of another.
pub const FORM: u8 = 1;

/// The longest body.
pub const BODY_CAPACITY: usize = 240;

/// The longest frame: the body, its CRC, one byte of COBS (up to 254 bytes take no more), two zeros.
pub const FRAME_CAPACITY: usize = BODY_CAPACITY + CRC_LENGTH + 1 + 2;

/// Bytes of a burst's frame: kind, number, flags, time, missed edges, data, CRC, COBS, two zeros.
pub const BYTES_PER_BURST: usize = 1 + 4 + 4 + 6 + 1 + BURST_LENGTH + CRC_LENGTH + 1 + 2;

/// Bytes of an attitude's frame: kind, time, quaternion, rates, flags, CRC, COBS, two zeros.
pub const BYTES_PER_ATTITUDE: usize = 1 + 8 + 16 + 12 + 4 + CRC_LENGTH + 1 + 2;

/// The longest text of a message; what is longer is cut.
pub const TEXT_CAPACITY: usize = BODY_CAPACITY - 2;

/// Bytes of a state in one piece.
pub const PIECE_LENGTH: usize = 96;

/// The time between two configurations, µs.
const CONFIGURATION_PERIOD_US: u64 = 1_000_000;

/// The time between two states, µs.
const STATE_PERIOD_US: u64 = 10_000_000;

/// So many pieces go with one call, that bursts find room.
const PIECES_AT_ONCE: usize = 4;

const CRC_LENGTH: usize = 4;
// Without a table: 1 KiB of flash less. The whole log takes 1.5 % of the core at 1 kHz all the same.
static CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// A frame.
#[derive(Debug, Clone, Copy, PartialEq)]
#[allow(clippy::large_enum_variant)]
pub enum Frame {
    /// What the log is of.
    Configuration(Configuration),
    /// A burst.
    Burst(NumberedBurst),
    /// An attitude.
    Attitude(Snapshot),
    /// A piece of the filter's state.
    StatePiece(StatePiece),
    /// A message.
    Text(Text),
}

/// What the log is of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configuration {
    /// [`REVISION`] of the filters that flew.
    pub revision: u16,
    /// The number of the first burst that these settings hold for.
    pub from_number: u32,
    /// The settings, the sensor's and the calibration among them.
    pub settings: Settings,
}

/// A burst with its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NumberedBurst {
    /// Bursts that the pipeline has taken before this one.
    pub number: u32,
    /// What the board had to say of it: the pipeline takes it into account.
    pub flags: Flags,
    /// The burst. Of its time the log keeps 48 bits: nine years of microseconds.
    pub burst: Burst,
}

/// A piece of the filter's state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatePiece {
    /// The number of the burst that comes next.
    pub number: u32,
    /// Where the piece begins.
    pub offset: u16,
    /// How long the whole is.
    pub whole: u16,
    /// The bytes; fewer count in the last piece, see [`StatePiece::bytes`].
    data: [u8; PIECE_LENGTH],
}

impl StatePiece {
    /// The bytes of the piece.
    pub fn bytes(&self) -> &[u8] {
        let left = usize::from(self.whole).saturating_sub(self.offset.into());
        self.data.get(..left.min(PIECE_LENGTH)).unwrap_or_default()
    }
}

/// A message's text.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Text {
    bytes: [u8; TEXT_CAPACITY],
    length: u8,
}

impl Text {
    /// The text, cut at a character's end if it is too long.
    pub fn new(text: &str) -> Self {
        let mut length = text.len().min(TEXT_CAPACITY);
        while !text.is_char_boundary(length) {
            length -= 1;
        }
        let mut bytes = [0; TEXT_CAPACITY];
        for (place, byte) in bytes.iter_mut().zip(text.bytes().take(length)) {
            *place = byte;
        }
        Self {
            bytes,
            length: length as u8,
        }
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        let bytes = self.bytes.get(..self.length.into()).unwrap_or_default();
        core::str::from_utf8(bytes).unwrap_or_default()
    }
}

impl Frame {
    /// The kind that this body is of, with nothing in it yet.
    fn blank(kind: u8) -> Option<Self> {
        Some(match kind {
            1 => Self::Configuration(Configuration {
                revision: 0,
                from_number: 0,
                settings: Settings::new(&Part::MPU_6050),
            }),
            2 => Self::Burst(NumberedBurst {
                number: 0,
                flags: Flags::NONE,
                burst: Burst {
                    bytes: [0; BURST_LENGTH],
                    captured_at_us: 0,
                    missed_before: 0,
                },
            }),
            3 => Self::Attitude(Snapshot::default()),
            4 => Self::StatePiece(StatePiece {
                number: 0,
                offset: 0,
                whole: 0,
                data: [0; PIECE_LENGTH],
            }),
            5 => Self::Text(Text {
                bytes: [0; TEXT_CAPACITY],
                length: 0,
            }),
            _ => return None,
        })
    }

    const fn kind(&self) -> u8 {
        match self {
            Self::Configuration(_) => 1,
            Self::Burst(_) => 2,
            Self::Attitude(_) => 3,
            Self::StatePiece(_) => 4,
            Self::Text(_) => 5,
        }
    }

    /// The body behind the kind, both ways.
    fn exchange(&mut self, state: &mut impl Exchange) {
        match self {
            Self::Configuration(configuration) => {
                let mut form = FORM;
                state.byte(&mut form);
                if form != FORM {
                    state.refuse();
                }
                state.short(&mut configuration.revision);
                state.word(&mut configuration.from_number);
                configuration.settings.exchange(state);
            }
            Self::Burst(NumberedBurst {
                number,
                flags,
                burst,
            }) => {
                state.word(number);
                flags.exchange(state);
                let [a, b, c, d, e, f, _, _] = burst.captured_at_us.to_le_bytes();
                let mut time = [a, b, c, d, e, f];
                state.bytes(&mut time);
                let [a, b, c, d, e, f] = time;
                burst.captured_at_us = u64::from_le_bytes([a, b, c, d, e, f, 0, 0]);
                state.byte(&mut burst.missed_before);
                state.bytes(&mut burst.bytes);
            }
            Self::Attitude(snapshot) => {
                let Snapshot {
                    t_us,
                    attitude,
                    body_rates_rad_s,
                    flags,
                } = snapshot;
                state.long(t_us);
                state.quaternion(attitude);
                state.vector(body_rates_rad_s);
                flags.exchange(state);
            }
            Self::StatePiece(piece) => {
                state.word(&mut piece.number);
                state.short(&mut piece.offset);
                state.short(&mut piece.whole);
                let left = usize::from(piece.whole.saturating_sub(piece.offset));
                if left == 0 {
                    state.refuse();
                }
                if let Some(bytes) = piece.data.get_mut(..left.min(PIECE_LENGTH)) {
                    state.bytes(bytes);
                }
            }
            Self::Text(text) => {
                state.byte(&mut text.length);
                match text.bytes.get_mut(..text.length.into()) {
                    Some(bytes) => {
                        state.bytes(bytes);
                        if core::str::from_utf8(bytes).is_err() {
                            state.refuse();
                        }
                    }
                    None => state.refuse(),
                }
            }
        }
    }
}

/// Writes a frame and returns it.
#[inline(never)]
pub fn encode<'a>(frame: &Frame, output: &'a mut [u8; FRAME_CAPACITY]) -> &'a [u8] {
    let mut body = [0; BODY_CAPACITY + CRC_LENGTH];
    let mut frame = *frame;
    let mut window = Window::new(&mut body, 0);
    window.byte(&mut frame.kind());
    frame.exchange(&mut window);
    let length = window.length().unwrap_or_default();
    let (Some(checked), Some(whole)) = (body.get(..length), length.checked_add(CRC_LENGTH)) else {
        return &[];
    };
    let checksum = CRC.checksum(checked).to_le_bytes();
    if let Some(place) = body.get_mut(length..whole) {
        place.copy_from_slice(&checksum);
    }
    let (Some(source), Some((start, stuffed))) = (body.get(..whole), output.split_first_mut())
    else {
        return &[];
    };
    *start = 0;
    let Ok(length) = cobs::try_encode(source, stuffed) else {
        return &[];
    };
    if let Some(end) = stuffed.get_mut(length) {
        *end = 0;
    }
    output.get(..length + 2).unwrap_or_default()
}

/// Reads the bytes between two zeros; `None` if they are no frame. Spoils them.
pub fn decode(stuffed: &mut [u8]) -> Option<Frame> {
    let length = cobs::decode_in_place(stuffed).ok()?;
    let (body, checksum) = stuffed
        .get(..length)?
        .split_at_checked(length.checked_sub(CRC_LENGTH)?)?;
    if checksum != CRC.checksum(body).to_le_bytes() {
        return None;
    }
    let (kind, rest) = body.split_first()?;
    let mut frame = Frame::blank(*kind)?;
    let mut reader = Reader::new(rest);
    frame.exchange(&mut reader);
    reader.is_complete().then_some(frame)
}

/// Finds the frames in a stream of bytes, whatever is between them.
#[derive(Debug, Clone)]
pub struct Decoder {
    stuffed: [u8; FRAME_CAPACITY],
    length: usize,
    counts: Counts,
}

/// What a [`Decoder`] has seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Whole frames.
    pub frames: u64,
    /// Pieces between zeros that were no frames: damaged ones, and anything else.
    pub damaged: u64,
    /// Bytes of those.
    pub damaged_bytes: u64,
}

impl Decoder {
    /// A decoder that has seen nothing.
    pub const fn new() -> Self {
        Self {
            stuffed: [0; FRAME_CAPACITY],
            length: 0,
            counts: Counts {
                frames: 0,
                damaged: 0,
                damaged_bytes: 0,
            },
        }
    }

    /// Takes the next byte, and gives the frame that it completes. The end of a stream is like a zero.
    pub fn push(&mut self, byte: u8) -> Option<Frame> {
        if byte != 0 {
            if let Some(place) = self.stuffed.get_mut(self.length) {
                *place = byte;
            }
            self.length += 1;
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if length == 0 {
            return None;
        }
        let frame = self.stuffed.get_mut(..length).and_then(decode);
        if frame.is_some() {
            self.counts.frames += 1;
        } else {
            self.counts.damaged += 1;
            self.counts.damaged_bytes += length as u64;
        }
        frame
    }

    /// What was seen so far.
    pub const fn counts(&self) -> Counts {
        self.counts
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// What the module sends of a log, and when.
///
/// The low-priority task owns it. It asks [`wants_state`](Self::wants_state), copies the pipeline if so, and then lets
/// [`fill`](Self::fill) write as much as there is room for.
#[derive(Debug, Clone)]
pub struct Sender<F> {
    state: Option<Captured<F>>,
    next_state_us: u64,
    next_configuration_us: u64,
    from_number: u32,
}

/// The pipeline at a moment.
#[derive(Debug, Clone, Copy)]
struct Captured<F> {
    pipeline: Pipeline<F>,
    number: u32,
    /// Bytes that have been sent; the whole once all have.
    sent: usize,
    whole: usize,
}

impl<F: Filter + Copy> Sender<F> {
    /// A sender at the beginning of a log, before the burst of this number.
    pub const fn new(next_number: u32) -> Self {
        Self {
            state: None,
            next_state_us: 0,
            next_configuration_us: 0,
            from_number: next_number,
        }
    }

    /// Says that the settings change with the burst of this number: a state is wanted at once, and a configuration follows it.
    pub fn restart(&mut self, next_number: u32) {
        *self = Self::new(next_number);
    }

    /// Whether a copy of the pipeline is wanted now.
    pub fn wants_state(&self, now_us: u64) -> bool {
        now_us >= self.next_state_us
    }

    /// Takes a copy of the pipeline before the burst of this number: no more than that, since the pipeline is locked meanwhile.
    /// [`measure_state`](Self::measure_state) follows it.
    #[inline(never)]
    pub fn copy_state(&mut self, pipeline: &Pipeline<F>, next_number: u32) {
        self.state = Some(Captured {
            pipeline: *pipeline,
            number: next_number,
            sent: 0,
            whole: 0,
        });
    }

    /// Finds out how long the copied state is, and when the next one is due.
    #[inline(never)]
    pub fn measure_state(&mut self, now_us: u64) {
        let Some(state) = &mut self.state else {
            return;
        };
        let mut measure = Window::new(&mut [], 0);
        state.pipeline.exchange(&mut measure);
        // A pipeline that still averages has no state to send; it is asked again.
        let (whole, pause_us) = match measure.length() {
            Some(whole) => (whole, STATE_PERIOD_US),
            None => (0, CONFIGURATION_PERIOD_US),
        };
        state.whole = whole;
        self.next_state_us = now_us + pause_us;
    }

    /// Writes what there is to write, as far as there is room. `bursts` gives the oldest burst that was not sent yet.
    #[inline(never)]
    pub fn fill(
        &mut self,
        now_us: u64,
        output: &mut Output<'_>,
        mut bursts: impl FnMut() -> Option<NumberedBurst>,
    ) {
        let mut bytes = [0; FRAME_CAPACITY];
        if let Some(state) = &self.state
            && now_us >= self.next_configuration_us
        {
            let configuration = Frame::Configuration(Configuration {
                revision: REVISION,
                from_number: self.from_number,
                settings: *state.pipeline.settings(),
            });
            if output.put(encode(&configuration, &mut bytes)) {
                self.next_configuration_us = now_us + CONFIGURATION_PERIOD_US;
            }
        }
        while output.has_room(BYTES_PER_BURST)
            && let Some(burst) = bursts()
        {
            output.put(encode(&Frame::Burst(burst), &mut bytes));
        }
        let Some(state) = &mut self.state else {
            return;
        };
        for _ in 0..PIECES_AT_ONCE {
            if state.sent >= state.whole {
                return;
            }
            let mut piece = StatePiece {
                number: state.number,
                offset: state.sent as u16,
                whole: state.whole as u16,
                data: [0; PIECE_LENGTH],
            };
            let mut window = Window::new(&mut piece.data, state.sent);
            state.pipeline.exchange(&mut window);
            if !output.put(encode(&Frame::StatePiece(piece), &mut bytes)) {
                return;
            }
            state.sent += PIECE_LENGTH;
        }
    }
}

/// Writes an attitude; false if there was no room.
#[inline(never)]
pub fn put_attitude(snapshot: &Snapshot, output: &mut Output<'_>) -> bool {
    let mut bytes = [0; FRAME_CAPACITY];
    output.put(encode(&Frame::Attitude(*snapshot), &mut bytes))
}

/// Writes a message, a long one in several frames; false if there was no room for all of it.
#[inline(never)]
pub fn put_text(text: &str, output: &mut Output<'_>) -> bool {
    let mut bytes = [0; FRAME_CAPACITY];
    let mut rest = text;
    while !rest.is_empty() {
        let part = Text::new(rest);
        if !output.put(encode(&Frame::Text(part), &mut bytes)) {
            return false;
        }
        rest = rest.get(part.as_str().len()..).unwrap_or_default();
    }
    true
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::attitude::{Quaternion, Vector3};
    use crate::calibration::{
        AccelerometerCorrection, Calibration, GyroscopeOffset, Mount, TemperatureModel,
    };
    use crate::estimator::FilterKind;
    use crate::mpu6050::{AccelerometerRange, Config, GyroscopeRange, LowPass};

    /// Everything that a configuration can hold.
    fn full_settings() -> Settings {
        let vector = Vector3::new(1.5, -2.5, 1.0e-3);
        Settings {
            sensor: Config {
                accelerometer_range: AccelerometerRange::G8,
                gyroscope_range: GyroscopeRange::Degrees500,
                low_pass: LowPass::Hertz42,
                sample_rate_divider: 3,
            },
            part: Part::from_who_am_i(0x98).expect("a known part"),
            mount: Mount::Z_DOWN,
            calibration: Calibration {
                mount: Mount::parse("-y+x"),
                gyroscope: Some(GyroscopeOffset {
                    offset_rad_s: vector,
                    temperature_celsius: 21.25,
                }),
                temperature: Some(TemperatureModel {
                    reference_celsius: 30.0,
                    offset_rad_s: vector,
                    slope_rad_s_per_celsius: -vector,
                    curvature_rad_s_per_celsius2: vector,
                    coldest_celsius: 10.0,
                    warmest_celsius: 50.0,
                }),
                accelerometer: Some(AccelerometerCorrection {
                    offset_m_s2: vector,
                    matrix: [1.01, 0.99, 1.0, 0.001, -0.002, 0.003],
                }),
                level: Some(Quaternion::IDENTITY),
            },
            filter: FilterKind::AxisKalman,
            averaging_samples: 777,
            sensor_delay_us: Some(123_456),
        }
    }

    fn examples() -> [Frame; 5] {
        [
            Frame::Configuration(Configuration {
                revision: 7,
                from_number: 0x0102_0304,
                settings: full_settings(),
            }),
            Frame::Burst(NumberedBurst {
                number: u32::MAX,
                flags: Flags::SENSOR_RESET,
                burst: Burst {
                    bytes: [0, 1, 0, 255, 0, 0, 0, 0, 0, 0, 0, 0, 0, 9],
                    captured_at_us: (1 << 48) - 1,
                    missed_before: 3,
                },
            }),
            Frame::Attitude(Snapshot {
                t_us: 123,
                attitude: Quaternion::IDENTITY,
                body_rates_rad_s: Vector3::new(-0.0, 1.0, f32::MIN_POSITIVE),
                flags: Flags::GAP | Flags::MISSED,
            }),
            Frame::StatePiece(StatePiece {
                number: 5,
                offset: 96,
                whole: 200,
                data: [0x5A; PIECE_LENGTH],
            }),
            Frame::Text(Text::new("the sensor does not answer, 5 °C")),
        ]
    }

    fn stream(frames: &[Frame]) -> Vec<u8> {
        let mut bytes = Vec::new();
        for frame in frames {
            bytes.extend_from_slice(encode(frame, &mut [0xFF; FRAME_CAPACITY]));
        }
        bytes
    }

    fn decoded(bytes: &[u8]) -> (Vec<Frame>, Counts) {
        let mut decoder = Decoder::new();
        let frames = bytes
            .iter()
            .filter_map(|byte| decoder.push(*byte))
            .collect();
        (frames, decoder.counts())
    }

    #[test]
    fn every_kind_of_frame_survives() {
        let frames = examples();
        for (index, frame) in frames.iter().enumerate() {
            let bytes = stream(&[*frame]);
            assert!(bytes.len() > 8 && bytes.starts_with(&[0]) && bytes.ends_with(&[0]));
            assert!(!bytes[1..bytes.len() - 1].contains(&0));
            assert_eq!(decoded(&bytes).0, [*frame], "{index}");
        }
        let (all, counts) = decoded(&stream(&frames));
        assert_eq!(all, frames);
        assert_eq!((counts.frames, counts.damaged), (5, 0));
    }

    #[test]
    fn a_burst_takes_what_it_is_said_to_take_and_the_line_carries_it() {
        let [_, burst, attitude, ..] = examples();
        assert_eq!(stream(&[burst]).len(), BYTES_PER_BURST);
        assert_eq!(stream(&[attitude]).len(), BYTES_PER_ATTITUDE);
        // At 1 kHz with 50 attitudes, a configuration each second and a state in ten.
        let configuration = stream(&examples()[..1]).len();
        let piece = stream(&examples()[3..4]).len();
        let state = 2048_usize.div_ceil(PIECE_LENGTH) * piece;
        let a_second =
            1000 * BYTES_PER_BURST + 50 * stream(&[attitude]).len() + configuration + state / 10;
        assert!(a_second < 41_000, "{a_second}");
        assert!(a_second * 10 < 921_600 / 2, "half of the line is free");
    }

    #[test]
    fn other_lines_between_frames_are_skipped_and_counted() {
        let frames = examples();
        let mut bytes = b"# aplomb on a board\nroll:1.00\n".to_vec();
        let noise = bytes.len() as u64;
        bytes.extend(stream(&frames));
        // Half a frame, as a log has it that is cut off.
        bytes.extend(&stream(&frames)[..9]);
        bytes.extend(stream(&frames));
        let (found, counts) = decoded(&bytes);
        assert_eq!(found.len(), 10);
        assert_eq!((counts.damaged, counts.damaged_bytes), (2, noise + 8));
    }

    #[test]
    fn a_long_message_goes_in_several_frames() {
        let text = "é".repeat(200);
        let mut buffer = [0; 640];
        let mut output = Output::new(&mut buffer);
        assert!(put_text(&text, &mut output));
        assert!(
            !put_text(&text, &mut output),
            "there is no room for another"
        );
        let length = output.length();
        let parts: Vec<_> = decoded(&buffer[..length])
            .0
            .iter()
            .map(|frame| match frame {
                Frame::Text(text) => text.as_str().to_owned(),
                other => panic!("{other:?}"),
            })
            .collect();
        assert!(parts.concat().starts_with(&text));
        assert_eq!(parts[0].len(), TEXT_CAPACITY);
    }

    #[test]
    fn another_form_and_other_kinds_are_refused() {
        let mut body = [0; 30];
        body[0] = 9;
        let checksum = CRC.checksum(&body[..20]).to_le_bytes();
        body[20..24].copy_from_slice(&checksum);
        let mut stuffed = [0; 40];
        let length = cobs::encode(&body[..24], &mut stuffed);
        assert_eq!(decode(&mut stuffed[..length]), None);
    }

    #[test]
    fn a_sender_sends_a_state_in_pieces_and_never_more_than_fits() {
        use crate::estimator::kalman::Kalman;
        let mut pipeline = Pipeline::with_filter(&Settings::new(&Part::MPU_6050), Kalman::new());
        let burst = |number: u32| NumberedBurst {
            number,
            flags: Flags::NONE,
            burst: Burst {
                bytes: [number as u8; BURST_LENGTH],
                captured_at_us: u64::from(number) * 1000,
                missed_before: 0,
            },
        };
        let mut sender = Sender::new(10);
        assert!(sender.wants_state(0));
        sender.copy_state(&pipeline, 10);
        sender.measure_state(0);
        assert!(!sender.wants_state(1));
        let mut next = 10;
        let mut all = Vec::new();
        for round in 0..100_u64 {
            let mut buffer = [0; 512];
            let mut output = Output::new(&mut buffer);
            let limit = 10 + 10 * (round as u32 + 1);
            sender.fill(round * 10_000, &mut output, || {
                (next < limit).then(|| {
                    next += 1;
                    burst(next - 1)
                })
            });
            let length = output.length();
            all.extend_from_slice(&buffer[..length]);
        }
        let (frames, counts) = decoded(&all);
        assert_eq!(counts.damaged, 0);
        let numbers: Vec<u32> = frames
            .iter()
            .filter_map(|frame| match frame {
                Frame::Burst(burst) => Some(burst.number),
                _ => None,
            })
            .collect();
        assert_eq!(numbers, (10..next).collect::<Vec<_>>());
        let mut state = Vec::new();
        for frame in &frames {
            if let Frame::StatePiece(piece) = frame {
                assert_eq!((piece.number, usize::from(piece.offset)), (10, state.len()));
                state.extend_from_slice(piece.bytes());
            }
        }
        let mut restored = Pipeline::with_filter(&full_settings(), Kalman::new());
        let mut reader = Reader::new(&state);
        restored.exchange(&mut reader);
        assert!(reader.is_complete());
        assert_eq!(restored, pipeline);
        assert_eq!(
            restored.update(&burst(10).burst),
            pipeline.update(&burst(10).burst)
        );
        assert!(matches!(frames[0], Frame::Configuration(configuration)
            if configuration.from_number == 10 && configuration.revision == REVISION));
    }

    proptest! {
        #[test]
        fn any_bytes_are_skipped_or_say_what_they_mean(bytes: Vec<u8>) {
            for frame in decoded(&bytes).0 {
                // What was accepted encodes to itself.
                prop_assert_eq!(decoded(&stream(&[frame])).0, [frame]);
            }
        }

        #[test]
        fn a_damaged_byte_costs_its_own_frame_alone(place: prop::sample::Index, flip in 1..=255_u8) {
            let frames = examples();
            let mut bytes = stream(&frames);
            let place = place.index(bytes.len());
            bytes[place] ^= flip;
            let mut damaged = 0;
            let mut start = 0;
            for (index, frame) in frames.iter().enumerate() {
                start += stream(&[*frame]).len();
                if place < start {
                    damaged = index;
                    break;
                }
            }
            let found = decoded(&bytes).0;
            for (index, frame) in frames.iter().enumerate() {
                prop_assert!(index == damaged || found.contains(frame), "{index} of {damaged}");
            }
            prop_assert!(found.iter().all(|frame| frames.contains(frame)));
        }

        #[test]
        fn a_text_is_cut_at_a_character(text in "[a°€😀]{0,200}") {
            let cut = Text::new(&text);
            prop_assert!(text.starts_with(cut.as_str()));
            prop_assert!(text.len() <= TEXT_CAPACITY || cut.as_str().len() > TEXT_CAPACITY - 4);
        }
    }
}
