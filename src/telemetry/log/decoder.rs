//! Decoder: finds the frames in a stream of bytes.

use super::frame::{FRAME_CAPACITY, Frame, decode};

/// Decoder of a stream of bytes with frames in it.
#[derive(Debug, Clone)]
pub struct Decoder {
    stuffed: [u8; FRAME_CAPACITY],
    length: usize,
    counts: Counts,
}

/// Counters of a [`Decoder`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Whole frames.
    pub frames: u64,
    /// Pieces between zeros that were no frame: damaged ones, and other bytes.
    pub damaged: u64,
    /// Bytes of those pieces.
    pub damaged_bytes: u64,
}

impl Decoder {
    /// Creates a decoder with all counters at 0.
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

    /// Adds a byte, and returns the frame that it completes. Add a 0 at the end of a stream.
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

    /// Returns the counters.
    pub const fn counts(&self) -> Counts {
        self.counts
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}
