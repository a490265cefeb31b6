//! Frames of the flight log, and their bytes.

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

use crate::estimator::heading::{CompassKnowledge, Heading, HeadingEstimate};
use crate::health::{BoardFlags, Flags};
use crate::mpu6050::{BURST_LENGTH, Burst, Part};
use crate::pipeline::{CompassReading, Settings, Snapshot};
use crate::serialize::{StateReader, StateVisitor, StateWriter};
use crate::units::MagneticField;

/// Version of the frames' format. A decoder refuses a configuration of a later version. One of
/// version 1 has no gyroscope matrix.
pub const FORMAT_VERSION: u8 = 2;

/// Length of the longest body, in bytes.
pub const BODY_CAPACITY: usize = 240;

/// Length of the longest frame, in bytes: body, CRC, one byte of COBS (enough up to 254 bytes), two
/// zeros.
pub const FRAME_CAPACITY: usize = BODY_CAPACITY + CRC_LENGTH + 1 + 2;

/// Length of a burst's frame, in bytes: kind, number, flags, time, missed edges, data, CRC, COBS,
/// two zeros.
pub const BYTES_PER_BURST: usize = 1 + 4 + 4 + 6 + 1 + BURST_LENGTH + CRC_LENGTH + 1 + 2;

/// Length of an attitude's frame, in bytes: kind, time, quaternion, rates, flags, CRC, COBS, two
/// zeros.
pub const BYTES_PER_ATTITUDE: usize = 1 + 8 + 16 + 12 + 4 + CRC_LENGTH + 1 + 2;

/// Length of a compass reading's frame, in bytes: kind, number, times of sample and measurement,
/// knowledge, field, CRC, COBS, two zeros.
pub const BYTES_PER_READING: usize = 1 + 4 + 6 + 4 + 1 + 12 + 4 + CRC_LENGTH + 1 + 2;

/// Length of a heading's frame, in bytes: kind, time, state, offset, σ, CRC, COBS, two zeros.
pub const BYTES_PER_HEADING: usize = 1 + 6 + 1 + 4 + 4 + CRC_LENGTH + 1 + 2;

/// Length of the longest text of a message, in bytes; a longer one is cut.
pub const TEXT_CAPACITY: usize = BODY_CAPACITY - 2;

/// Bytes of a state in one piece.
pub const PIECE_LENGTH: usize = 96;

const CRC_LENGTH: usize = 4;
// Without a table, which takes 1 KiB. The whole log still takes only 1.5 % of the core at 1 kHz.
pub(super) static CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// Frame of a flight log.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Frame {
    /// Settings.
    Configuration(Configuration),
    /// Burst.
    Burst(NumberedBurst),
    /// Attitude.
    Attitude(Snapshot),
    /// Piece of the filter's state.
    StatePiece(StatePiece),
    /// Message.
    Text(Text),
    /// Reading of the compass.
    Reading(CompassReading),
    /// Piece of the heading filter's state: a [`HeadingState`] as bytes.
    HeadingPiece(StatePiece),
    /// Heading.
    Heading(TimedHeading),
}

/// Settings of the flight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Configuration {
    /// [`REVISION`](crate::estimator::REVISION) of the filters that flew.
    pub revision: u16,
    /// Number of the first burst that these settings hold for.
    pub from_number: u32,
    /// Settings of the pipeline, with sensor and calibration.
    pub settings: Settings,
}

/// Burst with its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NumberedBurst {
    /// Number of bursts that the pipeline has processed before this one.
    pub number: u32,
    /// Board's flags, an input of the pipeline.
    pub flags: BoardFlags,
    /// Burst. The log keeps 48 bits of its time: nine years of microseconds.
    pub burst: Burst,
}

/// Piece of the filter's state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StatePiece {
    /// Number of the next burst.
    pub number: u32,
    /// Offset of the piece in the state, bytes.
    pub offset: u16,
    /// Length of the whole state, bytes.
    pub state_length: u16,
    /// Bytes; the last piece uses fewer, see [`StatePiece::bytes`].
    pub(super) data: [u8; PIECE_LENGTH],
}

impl StatePiece {
    /// Returns the bytes of the piece.
    pub fn bytes(&self) -> &[u8] {
        let left = usize::from(self.state_length).saturating_sub(self.offset.into());
        self.data.get(..left.min(PIECE_LENGTH)).unwrap_or_default()
    }
}

/// State of the heading filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadingState {
    /// Number of the compass's next reading.
    pub next_reading: u32,
    /// The filter; `None` while it waits for a reading.
    pub filter: Option<Heading>,
}

impl HeadingState {
    /// Visits every field.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        visitor.u32(&mut self.next_reading);
        let blank = Heading::new(CompassKnowledge::Factory);
        visitor.optional(&mut self.filter, blank, |visitor, filter| {
            filter.visit_state(visitor);
        });
    }
}

/// Heading, with the time of the sample at which it changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedHeading {
    /// Time of the sample, µs since start; 0 if the filter does not run. The log keeps 48 bits.
    pub t_us: u64,
    /// Estimate; `None` while the heading is unknown.
    pub estimate: Option<HeadingEstimate>,
}

/// Text of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Text {
    bytes: [u8; TEXT_CAPACITY],
    length: u8,
}

impl Text {
    /// Creates a text, cut at a character's end after [`TEXT_CAPACITY`] bytes.
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

    /// Returns the text.
    pub fn as_str(&self) -> &str {
        let bytes = self.bytes.get(..self.length.into()).unwrap_or_default();
        core::str::from_utf8(bytes).unwrap_or_default()
    }
}

impl Frame {
    /// Returns an empty frame of this kind; `None` for an unknown kind.
    fn blank(kind: u8) -> Option<Self> {
        const PIECE: StatePiece = StatePiece {
            number: 0,
            offset: 0,
            state_length: 0,
            data: [0; PIECE_LENGTH],
        };
        Some(match kind {
            1 => Self::Configuration(Configuration {
                revision: 0,
                from_number: 0,
                settings: Settings::new(&Part::MPU_6050),
            }),
            2 => Self::Burst(NumberedBurst {
                number: 0,
                flags: BoardFlags::empty(),
                burst: Burst {
                    bytes: [0; BURST_LENGTH],
                    captured_at_us: 0,
                    missed_before: 0,
                },
            }),
            3 => Self::Attitude(Snapshot {
                tilt_variance_rad2: f32::INFINITY,
                ..Snapshot::default()
            }),
            4 => Self::StatePiece(PIECE),
            5 => Self::Text(Text {
                bytes: [0; TEXT_CAPACITY],
                length: 0,
            }),
            6 => Self::Reading(CompassReading {
                number: 0,
                sample_t_us: 0,
                measured_us: 0,
                field: MagneticField { ut: [0.0; 3] },
                knowledge: CompassKnowledge::Factory,
                declination_rad: 0.0,
                starts_filter: false,
            }),
            7 => Self::HeadingPiece(PIECE),
            8 => Self::Heading(TimedHeading {
                t_us: 0,
                estimate: None,
            }),
            _ => return None,
        })
    }

    /// Returns the number of the kind.
    const fn kind(&self) -> u8 {
        match self {
            Self::Configuration(_) => 1,
            Self::Burst(_) => 2,
            Self::Attitude(_) => 3,
            Self::StatePiece(_) => 4,
            Self::Text(_) => 5,
            Self::Reading(_) => 6,
            Self::HeadingPiece(_) => 7,
            Self::Heading(_) => 8,
        }
    }

    /// Visits the fields of the body after the kind.
    fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        match self {
            Self::Configuration(configuration) => {
                let mut version = FORMAT_VERSION;
                visitor.u8(&mut version);
                if !(1..=FORMAT_VERSION).contains(&version) {
                    visitor.reject();
                }
                visitor.u16(&mut configuration.revision);
                visitor.u32(&mut configuration.from_number);
                let settings = &mut configuration.settings;
                settings.visit_state(visitor);
                if version >= 2 {
                    settings.calibration.visit_gyroscope_matrix(visitor);
                }
            }
            Self::Burst(NumberedBurst {
                number,
                flags,
                burst,
            }) => {
                visitor.u32(number);
                let mut bits = flags.bits();
                visitor.u32(&mut bits);
                *flags = BoardFlags::from_bits_truncate(bits);
                visit_time(&mut burst.captured_at_us, visitor);
                visitor.u8(&mut burst.missed_before);
                visitor.bytes(&mut burst.bytes);
            }
            Self::Attitude(snapshot) => {
                let Snapshot {
                    t_us,
                    attitude,
                    body_rates_rad_s,
                    flags,
                    // Not in the frame: a replay computes it.
                    tilt_variance_rad2: _,
                } = snapshot;
                visitor.u64(t_us);
                visitor.quaternion(attitude);
                visitor.vector(body_rates_rad_s);
                let mut bits = flags.bits();
                visitor.u32(&mut bits);
                *flags = Flags::from_bits_truncate(bits);
            }
            Self::StatePiece(piece) | Self::HeadingPiece(piece) => visit_piece(piece, visitor),
            Self::Reading(reading) => visit_reading(reading, visitor),
            Self::Heading(heading) => visit_heading(heading, visitor),
            Self::Text(text) => {
                visitor.u8(&mut text.length);
                match text.bytes.get_mut(..text.length.into()) {
                    Some(bytes) => {
                        visitor.bytes(bytes);
                        if core::str::from_utf8(bytes).is_err() {
                            visitor.reject();
                        }
                    }
                    None => visitor.reject(),
                }
            }
        }
    }
}

/// Visits the low 48 bits of a time, µs.
fn visit_time(t_us: &mut u64, visitor: &mut impl StateVisitor) {
    let [a, b, c, d, e, f, _, _] = t_us.to_le_bytes();
    let mut time = [a, b, c, d, e, f];
    visitor.bytes(&mut time);
    let [a, b, c, d, e, f] = time;
    *t_us = u64::from_le_bytes([a, b, c, d, e, f, 0, 0]);
}

/// Visits a piece of a state.
#[inline(never)]
fn visit_piece(piece: &mut StatePiece, visitor: &mut impl StateVisitor) {
    visitor.u32(&mut piece.number);
    visitor.u16(&mut piece.offset);
    visitor.u16(&mut piece.state_length);
    let left = usize::from(piece.state_length.saturating_sub(piece.offset));
    if left == 0 {
        visitor.reject();
    }
    if let Some(bytes) = piece.data.get_mut(..left.min(PIECE_LENGTH)) {
        visitor.bytes(bytes);
    }
}

/// Visits a reading of the compass.
#[inline(never)]
fn visit_reading(reading: &mut CompassReading, visitor: &mut impl StateVisitor) {
    const CALIBRATED: usize = 1;
    const STARTS: usize = 2;
    const HARD_IRON: usize = 4;
    visitor.u32(&mut reading.number);
    visit_time(&mut reading.sample_t_us, visitor);
    visitor.u32(&mut reading.measured_us);
    let mut bits = match reading.knowledge {
        CompassKnowledge::Factory => 0,
        CompassKnowledge::Calibrated => CALIBRATED,
        CompassKnowledge::HardIron => HARD_IRON,
    };
    if reading.starts_filter {
        bits |= STARTS;
    }
    visitor.index(&mut bits, (CALIBRATED | STARTS | HARD_IRON) + 1);
    reading.starts_filter = bits & STARTS != 0;
    match bits & !STARTS {
        0 => reading.knowledge = CompassKnowledge::Factory,
        CALIBRATED => reading.knowledge = CompassKnowledge::Calibrated,
        HARD_IRON => reading.knowledge = CompassKnowledge::HardIron,
        _ => visitor.reject(),
    }
    visitor.f32s(&mut reading.field.ut);
    visitor.f32(&mut reading.declination_rad);
}

/// Visits a heading. Its frame is as long if the heading is unknown.
#[inline(never)]
fn visit_heading(heading: &mut TimedHeading, visitor: &mut impl StateVisitor) {
    visit_time(&mut heading.t_us, visitor);
    // 0: unknown, 1: known, 2: known and valid while the attitude is valid.
    let mut state = heading
        .estimate
        .map_or(0, |it| 1 + usize::from(it.is_valid));
    visitor.index(&mut state, 3);
    let mut estimate = heading.estimate.unwrap_or(HeadingEstimate {
        yaw_offset_rad: 0.0,
        sigma_rad: 0.0,
        is_valid: false,
    });
    visitor.f32(&mut estimate.yaw_offset_rad);
    visitor.f32(&mut estimate.sigma_rad);
    estimate.is_valid = state == 2;
    heading.estimate = (state > 0).then_some(estimate);
}

/// Encodes a frame, and returns its bytes.
#[inline(never)]
pub fn encode<'a>(frame: &Frame, output: &'a mut [u8; FRAME_CAPACITY]) -> &'a [u8] {
    let mut body = [0; BODY_CAPACITY + CRC_LENGTH];
    let mut frame = *frame;
    let mut window = StateWriter::new(&mut body, 0);
    window.u8(&mut frame.kind());
    frame.visit_state(&mut window);
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

/// Decodes the bytes between two zeros, in place; `None` if they are no frame.
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
    let mut reader = StateReader::new(rest);
    frame.visit_state(&mut reader);
    reader.is_complete().then_some(frame)
}
