//! Receiver: finds MAVLink 2 frames in received bytes, and passes on the rest as text.
//!
//! A frame begins with 0xFD, which no printable text contains, and holds its length. A candidate
//! with a wrong checksum is no frame: its first byte goes to the text, and the search starts again
//! with the second. A candidate that stays incomplete for [`FRAME_TIMEOUT_US`] is treated alike, so
//! that a typed line reaches the console after any noise. That time counts only once all received
//! bytes are read: the rest of a frame may wait for longer in the ring. The checksum of an unknown
//! message cannot be checked; such a frame is dropped whole. A frame of MAVLink 1, which begins
//! with 0xFE, is dropped too.

use ::mavlink::{MessageData, calculate_crc, dialects::common};

use super::wire::{Command, Payload};

/// Longest pause between two bytes of a frame, µs, while none waits to be read.
pub const FRAME_TIMEOUT_US: u64 = 100_000;

/// STX, then length, flags (2), sequence, system, component, message (3).
const HEADER_LENGTH: usize = 10;
const CHECKSUM_LENGTH: usize = 2;
const SIGNATURE_LENGTH: usize = 13;
/// Length of the longest frame of MAVLink 2.
const CAPACITY: usize = HEADER_LENGTH + 255 + CHECKSUM_LENGTH + SIGNATURE_LENGTH;

const START: u8 = 0xFD;
/// First byte of a frame of MAVLink 1; its length follows.
const START_1: u8 = 0xFE;
/// Length of a frame of MAVLink 1 without its payload.
const OVERHEAD_1: usize = 8;
/// Incompatibility flag: a signature follows.
const SIGNED: u8 = 0x01;

/// Received frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Received {
    pub(super) system: u8,
    pub(super) component: u8,
    pub(super) message: u32,
    pub(super) payload: Payload,
}

/// Buffer of bytes that may be a frame.
#[derive(Debug, Clone)]
pub(super) struct Receiver {
    bytes: [u8; CAPACITY],
    length: usize,
    /// Time at which the last byte was read, µs.
    last_us: u64,
}

/// Classification of a candidate.
enum Verdict {
    Incomplete,
    NoFrame,
    /// A frame of this length, with its content if the message is known.
    Frame(usize, Option<Received>),
}

impl Receiver {
    pub(super) const fn new() -> Self {
        Self {
            bytes: [0; CAPACITY],
            length: 0,
            last_us: 0,
        }
    }

    /// Discards the candidate.
    pub(super) const fn clear(&mut self) {
        self.length = 0;
    }

    /// Adds a byte, and passes on the text and frames that it completes.
    pub(super) fn push(
        &mut self,
        byte: u8,
        now_us: u64,
        text: &mut impl FnMut(u8),
        frame: &mut impl FnMut(&Received),
    ) {
        self.last_us = now_us;
        if let Some(place) = self.bytes.get_mut(self.length) {
            *place = byte;
            self.length += 1;
        }
        self.process(text, frame);
    }

    /// Passes on a candidate as text after the timeout. Call it when all received bytes are read.
    pub(super) fn poll(
        &mut self,
        now_us: u64,
        text: &mut impl FnMut(u8),
        frame: &mut impl FnMut(&Received),
    ) {
        while self.length > 0 && now_us.saturating_sub(self.last_us) > FRAME_TIMEOUT_US {
            self.remove_front(1, text);
            self.process(text, frame);
        }
    }

    /// Passes on text and frames until the candidate is incomplete.
    #[inline(never)]
    fn process(&mut self, text: &mut impl FnMut(u8), frame: &mut impl FnMut(&Received)) {
        while self.length > 0 {
            match self.classify() {
                Verdict::Incomplete => return,
                Verdict::NoFrame => self.remove_front(1, text),
                Verdict::Frame(length, received) => {
                    if let Some(received) = received {
                        frame(&received);
                    }
                    self.remove_front(length, &mut |_| {});
                }
            }
        }
    }

    /// Removes bytes from the front and passes them on as text.
    #[inline(never)]
    fn remove_front(&mut self, count: usize, text: &mut impl FnMut(u8)) {
        let count = count.min(self.length);
        for byte in self.bytes.iter().take(count) {
            text(*byte);
        }
        // Cells let one loop read ahead of its writes.
        let bytes = core::cell::Cell::from_mut(self.bytes.as_mut_slice()).as_slice_of_cells();
        let kept = bytes.iter().skip(count);
        for (place, byte) in bytes.iter().zip(kept) {
            place.set(byte.get());
        }
        self.length -= count;
    }

    /// Classifies the bytes in the buffer.
    #[inline(never)]
    fn classify(&self) -> Verdict {
        let bytes = self.bytes.get(..self.length).unwrap_or_default();
        if bytes.first() == Some(&START_1) {
            return match bytes.get(1) {
                // Noise before a frame, rather than one of 253 bytes.
                Some(&START) => Verdict::NoFrame,
                Some(&length) if bytes.len() >= OVERHEAD_1 + usize::from(length) => {
                    Verdict::Frame(OVERHEAD_1 + usize::from(length), None)
                }
                _ => Verdict::Incomplete,
            };
        }
        if bytes.first() != Some(&START) {
            return Verdict::NoFrame;
        }
        let Some((header, rest)) = bytes.split_at_checked(HEADER_LENGTH) else {
            return Verdict::Incomplete;
        };
        let &[
            _,
            length,
            incompatible,
            _,
            _,
            system,
            component,
            low,
            middle,
            high,
        ] = header
        else {
            return Verdict::Incomplete;
        };
        if incompatible & !SIGNED != 0 {
            return Verdict::NoFrame;
        }
        let signature = if incompatible & SIGNED != 0 {
            SIGNATURE_LENGTH
        } else {
            0
        };
        let length = usize::from(length);
        let Some((payload, rest)) = rest.split_at_checked(length) else {
            return Verdict::Incomplete;
        };
        if rest.len() < CHECKSUM_LENGTH + signature {
            return Verdict::Incomplete;
        }
        let message = u32::from_le_bytes([low, middle, high, 0]);
        let whole = HEADER_LENGTH + length + CHECKSUM_LENGTH + signature;
        let Some(extra) = extra_of(message) else {
            return Verdict::Frame(whole, None);
        };
        let checked = bytes.get(1..HEADER_LENGTH + length).unwrap_or_default();
        let [low, high, ..] = rest else {
            return Verdict::Incomplete;
        };
        if calculate_crc(checked, extra) != u16::from_le_bytes([*low, *high]) {
            return Verdict::NoFrame;
        }
        let received = Received {
            system,
            component,
            message,
            payload: Payload::new(payload),
        };
        Verdict::Frame(whole, Some(received))
    }
}

/// Returns the extra byte of a message's checksum, which distinguishes its versions; `None` for a
/// message that is not read.
const fn extra_of(message: u32) -> Option<u8> {
    use common::{
        COMMAND_INT_DATA, COMMAND_LONG_DATA, HEARTBEAT_DATA, MISSION_REQUEST_LIST_DATA,
        PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA,
    };
    match message {
        HEARTBEAT_DATA::ID => Some(HEARTBEAT_DATA::EXTRA_CRC),
        PARAM_REQUEST_LIST_DATA::ID => Some(PARAM_REQUEST_LIST_DATA::EXTRA_CRC),
        PARAM_REQUEST_READ_DATA::ID => Some(PARAM_REQUEST_READ_DATA::EXTRA_CRC),
        PARAM_SET_DATA::ID => Some(PARAM_SET_DATA::EXTRA_CRC),
        MISSION_REQUEST_LIST_DATA::ID => Some(MISSION_REQUEST_LIST_DATA::EXTRA_CRC),
        Command::INT => Some(COMMAND_INT_DATA::EXTRA_CRC),
        Command::LONG => Some(COMMAND_LONG_DATA::EXTRA_CRC),
        _ => None,
    }
}
