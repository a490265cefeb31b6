//! Visits every field of a state, to write it as bytes or to read it back.
//!
//! A flight log carries the filter's whole state, so that a replay can start in mid-flight. Each
//! type lists its fields once, in `visit_state`, and passes each of them to a [`StateVisitor`]. The
//! same list serves both directions, so writing and reading cannot disagree:
//!
//! - [`StateWriter`] copies the fields to bytes. It can copy a section only, so that a long state
//!   is sent in pieces.
//! - [`StateReader`] sets the fields from bytes.
//!
//! Integers are little-endian, floats are their IEEE 754 bits. The layout of a
//! filter's state belongs to one [`REVISION`](crate::estimator::REVISION); other revisions cannot
//! read it. The layout of [`Settings`](crate::pipeline::Settings) is the same in all revisions.
//!
//! ```
//! use aplomb::mpu6050::Part;
//! use aplomb::pipeline::{Pipeline, Settings};
//! use aplomb::serialize::{StateReader, StateWriter};
//!
//! let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
//! let mut bytes = [0; 4096];
//! let mut writer = StateWriter::new(&mut bytes, 0);
//! pipeline.visit_state(&mut writer);
//! let length = writer.length().expect("this state has a byte form");
//!
//! let mut restored = Pipeline::new(&Settings::new(&Part::MPU_6050));
//! let mut reader = StateReader::new(&bytes[..length]);
//! restored.visit_state(&mut reader);
//! assert!(reader.is_complete() && restored == pipeline);
//! ```

use crate::attitude::{Quaternion, Vector3};

/// Visits the fields of a state in a fixed order; each method may read or replace the field.
///
/// Only [`bytes`](Self::bytes) and [`reject`](Self::reject) have to be implemented.
pub trait StateVisitor {
    /// Visits raw bytes.
    fn bytes(&mut self, bytes: &mut [u8]);

    /// Marks the state as invalid: a field has no byte form, or the bytes read are no valid value
    /// of it.
    fn reject(&mut self);

    /// Visits a byte.
    #[inline(never)]
    fn u8(&mut self, value: &mut u8) {
        self.bytes(core::slice::from_mut(value));
    }

    /// Visits a 16-bit integer.
    #[inline(never)]
    fn u16(&mut self, value: &mut u16) {
        let mut bytes = value.to_le_bytes();
        self.bytes(&mut bytes);
        *value = u16::from_le_bytes(bytes);
    }

    /// Visits a signed 16-bit integer.
    #[inline(never)]
    fn i16(&mut self, value: &mut i16) {
        let mut bytes = value.to_le_bytes();
        self.bytes(&mut bytes);
        *value = i16::from_le_bytes(bytes);
    }

    /// Visits a 32-bit integer.
    #[inline(never)]
    fn u32(&mut self, value: &mut u32) {
        let mut bytes = value.to_le_bytes();
        self.bytes(&mut bytes);
        *value = u32::from_le_bytes(bytes);
    }

    /// Visits a 64-bit integer.
    #[inline(never)]
    fn u64(&mut self, value: &mut u64) {
        let mut bytes = value.to_le_bytes();
        self.bytes(&mut bytes);
        *value = u64::from_le_bytes(bytes);
    }

    /// Visits a boolean, one byte: 0 or 1. Rejects other bytes.
    #[inline(never)]
    fn bool(&mut self, value: &mut bool) {
        let mut byte = u8::from(*value);
        self.u8(&mut byte);
        if byte > 1 {
            self.reject();
        }
        *value = byte == 1;
    }

    /// Visits an index below 256, one byte. Rejects bytes of `limit` or more.
    #[inline(never)]
    fn index(&mut self, value: &mut usize, limit: usize) {
        let mut byte = *value as u8;
        self.u8(&mut byte);
        if usize::from(byte) < limit {
            *value = byte.into();
        } else {
            self.reject();
        }
    }

    /// Visits a float, to the bit.
    #[inline(never)]
    fn f32(&mut self, value: &mut f32) {
        let mut bits = value.to_bits();
        self.u32(&mut bits);
        *value = f32::from_bits(bits);
    }

    /// Visits floats in order, without their count.
    #[inline(never)]
    fn f32s(&mut self, values: &mut [f32]) {
        for value in values {
            self.f32(value);
        }
    }

    /// Visits x, y and z.
    #[inline(never)]
    fn vector(&mut self, value: &mut Vector3) {
        self.f32(&mut value.x);
        self.f32(&mut value.y);
        self.f32(&mut value.z);
    }

    /// Visits w, x, y and z.
    #[inline(never)]
    fn quaternion(&mut self, value: &mut Quaternion) {
        self.f32(&mut value.w);
        self.f32(&mut value.x);
        self.f32(&mut value.y);
        self.f32(&mut value.z);
    }

    /// Visits an optional value: a boolean, then the value if there is one. Reading starts from
    /// `blank`.
    fn optional<T>(
        &mut self,
        value: &mut Option<T>,
        blank: T,
        visit: impl FnOnce(&mut Self, &mut T),
    ) where
        Self: Sized,
    {
        let mut is_some = value.is_some();
        self.bool(&mut is_some);
        if is_some {
            visit(self, value.get_or_insert(blank));
        } else {
            *value = None;
        }
    }
}

/// Copies a section of a state's bytes to a buffer.
#[derive(Debug)]
pub struct StateWriter<'a> {
    section: &'a mut [u8],
    start: usize,
    position: usize,
    is_rejected: bool,
}

impl<'a> StateWriter<'a> {
    /// Creates a writer of the bytes from `start` on, as many as `section` holds. An empty section
    /// only measures the length.
    pub fn new(section: &'a mut [u8], start: usize) -> Self {
        Self {
            section,
            start,
            position: 0,
            is_rejected: false,
        }
    }

    /// Returns the length of the whole state in bytes; `None` if the state has no byte form.
    pub fn length(&self) -> Option<usize> {
        (!self.is_rejected).then_some(self.position)
    }
}

impl StateVisitor for StateWriter<'_> {
    #[inline(never)]
    fn bytes(&mut self, bytes: &mut [u8]) {
        for byte in bytes {
            if let Some(place) = self
                .position
                .checked_sub(self.start)
                .and_then(|index| self.section.get_mut(index))
            {
                *place = *byte;
            }
            self.position += 1;
        }
    }

    fn reject(&mut self) {
        self.is_rejected = true;
    }
}

/// Sets the fields of a state from bytes.
#[derive(Debug)]
pub struct StateReader<'a> {
    rest: &'a [u8],
    is_rejected: bool,
}

impl<'a> StateReader<'a> {
    /// Creates a reader of all these bytes.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes,
            is_rejected: false,
        }
    }

    /// Returns whether every byte was used and every field was valid. If not, discard the state.
    pub const fn is_complete(&self) -> bool {
        self.rest.is_empty() && !self.is_rejected
    }

    /// Returns the unread bytes; `None` after an invalid field.
    pub const fn rest(&self) -> Option<&'a [u8]> {
        if self.is_rejected {
            None
        } else {
            Some(self.rest)
        }
    }
}

impl StateVisitor for StateReader<'_> {
    fn bytes(&mut self, bytes: &mut [u8]) {
        match self.rest.split_at_checked(bytes.len()) {
            Some((these, rest)) => {
                bytes.copy_from_slice(these);
                self.rest = rest;
            }
            None => self.is_rejected = true,
        }
    }

    fn reject(&mut self) {
        self.is_rejected = true;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, Clone, Copy, PartialEq, Default)]
    struct Everything {
        byte: u8,
        truth: bool,
        index: usize,
        number: f32,
        optional: Option<u32>,
        long: u64,
    }

    impl Everything {
        fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
            visitor.u8(&mut self.byte);
            visitor.bool(&mut self.truth);
            visitor.index(&mut self.index, 7);
            visitor.f32(&mut self.number);
            visitor.optional(&mut self.optional, 0, StateVisitor::u32);
            visitor.u64(&mut self.long);
        }
    }

    const VALUE: Everything = Everything {
        byte: 250,
        truth: true,
        index: 6,
        number: -0.0,
        optional: Some(0xDEAD_BEEF),
        long: u64::MAX - 1,
    };

    fn written(mut value: Everything) -> Vec<u8> {
        let mut bytes = [0; 100];
        let mut window = StateWriter::new(&mut bytes, 0);
        value.visit_state(&mut window);
        let length = window.length().expect("it goes into bytes");
        bytes[..length].to_vec()
    }

    #[test]
    fn a_value_survives_a_round_trip_in_one_piece_and_in_many() {
        let whole = written(VALUE);
        assert_eq!(whole.len(), 1 + 1 + 1 + 4 + 5 + 8);
        let mut pieces = Vec::new();
        while pieces.len() < whole.len() {
            let mut part = [0; 3];
            let mut value = VALUE;
            value.visit_state(&mut StateWriter::new(&mut part, pieces.len()));
            pieces.extend(part);
        }
        assert_eq!(pieces[..whole.len()], whole);
        let mut read = Everything::default();
        let mut reader = StateReader::new(&whole);
        read.visit_state(&mut reader);
        assert!(reader.is_complete());
        assert_eq!(read, VALUE);
        assert!(read.number.is_sign_negative());
    }

    #[test]
    fn invalid_bytes_are_rejected() {
        let whole = written(VALUE);
        let is_complete = |bytes: &[u8]| {
            let mut reader = StateReader::new(bytes);
            Everything::default().visit_state(&mut reader);
            reader.is_complete()
        };
        assert!(is_complete(&whole));
        assert!(!is_complete(&whole[1..]));
        assert!(!is_complete(&[&whole[..], &[0]].concat()));
        for (place, value) in [(1, 2), (2, 7), (7, 2)] {
            let mut broken = whole.clone();
            broken[place] = value;
            assert!(!is_complete(&broken), "{place}");
        }
    }
}
