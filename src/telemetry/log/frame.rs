//! Frames of the flight log, and their bytes.

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

use crate::health::{BoardFlags, Flags};
use crate::mpu6050::{BURST_LENGTH, Burst, Part};
use crate::pipeline::{Settings, Snapshot};
use crate::serialize::{StateReader, StateVisitor, StateWriter};

/// Version of the frames' format. A decoder refuses a configuration of another version.
pub const FORMAT_VERSION: u8 = 1;

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
            4 => Self::StatePiece(StatePiece {
                number: 0,
                offset: 0,
                state_length: 0,
                data: [0; PIECE_LENGTH],
            }),
            5 => Self::Text(Text {
                bytes: [0; TEXT_CAPACITY],
                length: 0,
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
        }
    }

    /// Visits the fields of the body after the kind.
    fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        match self {
            Self::Configuration(configuration) => {
                let mut version = FORMAT_VERSION;
                visitor.u8(&mut version);
                if version != FORMAT_VERSION {
                    visitor.reject();
                }
                visitor.u16(&mut configuration.revision);
                visitor.u32(&mut configuration.from_number);
                configuration.settings.visit_state(visitor);
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
                let [a, b, c, d, e, f, _, _] = burst.captured_at_us.to_le_bytes();
                let mut time = [a, b, c, d, e, f];
                visitor.bytes(&mut time);
                let [a, b, c, d, e, f] = time;
                burst.captured_at_us = u64::from_le_bytes([a, b, c, d, e, f, 0, 0]);
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
            Self::StatePiece(piece) => {
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
