//! A filter's memory as bytes, and back: what a log needs so that a replay can start in mid-flight.
//!
//! Each type walks through its fields once, in [`exchange`](crate::pipeline::Pipeline::exchange), and lets an
//! [`Exchange`] look at every one of them. A [`Window`] takes a part of the bytes out, so that a long state can
//! travel in pieces; a [`Reader`] puts them back in. One walk for both directions cannot disagree with itself. What it
//! forgets shows in the tests, which compare the whole.
//!
//! Numbers are little-endian, floats their IEEE 754 bits. The form belongs to one revision of the filter and is
//! kept nowhere for long.

use crate::attitude::{Quaternion, Vector3};

/// Someone who is shown every field, and may change it.
pub trait Exchange {
    /// Is shown the next bytes.
    fn bytes(&mut self, bytes: &mut [u8]);

    /// Is told that the value does not go into bytes, or that bytes were not such a value.
    fn refuse(&mut self);

    /// A byte.
    #[inline(never)]
    fn byte(&mut self, value: &mut u8) {
        self.bytes(core::slice::from_mut(value));
    }

    /// A number of 16 bits.
    #[inline(never)]
    fn short(&mut self, value: &mut u16) {
        let mut bytes = value.to_le_bytes();
        self.bytes(&mut bytes);
        *value = u16::from_le_bytes(bytes);
    }

    /// A number of 32 bits.
    #[inline(never)]
    fn word(&mut self, value: &mut u32) {
        let mut bytes = value.to_le_bytes();
        self.bytes(&mut bytes);
        *value = u32::from_le_bytes(bytes);
    }

    /// A number of 64 bits.
    #[inline(never)]
    fn long(&mut self, value: &mut u64) {
        let mut bytes = value.to_le_bytes();
        self.bytes(&mut bytes);
        *value = u64::from_le_bytes(bytes);
    }

    /// A truth.
    #[inline(never)]
    fn truth(&mut self, value: &mut bool) {
        let mut byte = u8::from(*value);
        self.byte(&mut byte);
        if byte > 1 {
            self.refuse();
        }
        *value = byte == 1;
    }

    /// An index that is below 256, and on the way back below `limit`.
    #[inline(never)]
    fn index(&mut self, value: &mut usize, limit: usize) {
        let mut byte = *value as u8;
        self.byte(&mut byte);
        if usize::from(byte) < limit {
            *value = byte.into();
        } else {
            self.refuse();
        }
    }

    /// A float, to the bit.
    #[inline(never)]
    fn number(&mut self, value: &mut f32) {
        let mut bits = value.to_bits();
        self.word(&mut bits);
        *value = f32::from_bits(bits);
    }

    /// Floats, one by one.
    #[inline(never)]
    fn numbers(&mut self, values: &mut [f32]) {
        for value in values {
            self.number(value);
        }
    }

    /// A vector.
    #[inline(never)]
    fn vector(&mut self, value: &mut Vector3) {
        self.number(&mut value.x);
        self.number(&mut value.y);
        self.number(&mut value.z);
    }

    /// A quaternion.
    #[inline(never)]
    fn quaternion(&mut self, value: &mut Quaternion) {
        self.number(&mut value.w);
        self.number(&mut value.x);
        self.number(&mut value.y);
        self.number(&mut value.z);
    }

    /// Something that may be missing; `blank` is where a walk over what is read begins.
    fn optional<T>(
        &mut self,
        value: &mut Option<T>,
        blank: T,
        exchange: impl FnOnce(&mut Self, &mut T),
    ) where
        Self: Sized,
    {
        let mut is_there = value.is_some();
        self.truth(&mut is_there);
        if is_there {
            exchange(self, value.get_or_insert(blank));
        } else {
            *value = None;
        }
    }
}

/// Takes the bytes from `skip` on, as many as there is room for.
pub struct Window<'a> {
    part: &'a mut [u8],
    skip: usize,
    position: usize,
    is_refused: bool,
}

impl<'a> Window<'a> {
    /// A window of this place and size; an empty one only measures.
    pub fn new(part: &'a mut [u8], skip: usize) -> Self {
        Self {
            part,
            skip,
            position: 0,
            is_refused: false,
        }
    }

    /// How many bytes went by, or `None` if the value does not go into bytes.
    pub fn length(&self) -> Option<usize> {
        (!self.is_refused).then_some(self.position)
    }
}

impl Exchange for Window<'_> {
    #[inline(never)]
    fn bytes(&mut self, bytes: &mut [u8]) {
        for byte in bytes {
            if let Some(place) = self
                .position
                .checked_sub(self.skip)
                .and_then(|index| self.part.get_mut(index))
            {
                *place = *byte;
            }
            self.position += 1;
        }
    }

    fn refuse(&mut self) {
        self.is_refused = true;
    }
}

/// Puts bytes into the fields.
pub struct Reader<'a> {
    rest: &'a [u8],
    is_refused: bool,
}

impl<'a> Reader<'a> {
    /// A reader of all these bytes.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes,
            is_refused: false,
        }
    }

    /// Whether there were just as many bytes as fields, and each was a value. If not, what was read is worth nothing.
    pub const fn is_complete(&self) -> bool {
        self.rest.is_empty() && !self.is_refused
    }

    /// The bytes that are left, or `None` if what was read so far was refused.
    pub const fn rest(&self) -> Option<&'a [u8]> {
        if self.is_refused {
            None
        } else {
            Some(self.rest)
        }
    }
}

impl Exchange for Reader<'_> {
    fn bytes(&mut self, bytes: &mut [u8]) {
        match self.rest.split_at_checked(bytes.len()) {
            Some((these, rest)) => {
                bytes.copy_from_slice(these);
                self.rest = rest;
            }
            None => self.is_refused = true,
        }
    }

    fn refuse(&mut self) {
        self.is_refused = true;
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
        fn exchange(&mut self, state: &mut impl Exchange) {
            state.byte(&mut self.byte);
            state.truth(&mut self.truth);
            state.index(&mut self.index, 7);
            state.number(&mut self.number);
            state.optional(&mut self.optional, 0, |state, value| state.word(value));
            state.long(&mut self.long);
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
        let mut window = Window::new(&mut bytes, 0);
        value.exchange(&mut window);
        let length = window.length().expect("it goes into bytes");
        bytes[..length].to_vec()
    }

    #[test]
    fn a_value_survives_and_pieces_make_the_whole() {
        let whole = written(VALUE);
        assert_eq!(whole.len(), 1 + 1 + 1 + 4 + 5 + 8);
        let mut pieces = Vec::new();
        while pieces.len() < whole.len() {
            let mut part = [0; 3];
            let mut value = VALUE;
            value.exchange(&mut Window::new(&mut part, pieces.len()));
            pieces.extend(part);
        }
        assert_eq!(pieces[..whole.len()], whole);
        let mut read = Everything::default();
        let mut reader = Reader::new(&whole);
        read.exchange(&mut reader);
        assert!(reader.is_complete());
        assert_eq!(read, VALUE);
        assert!(read.number.is_sign_negative());
    }

    #[test]
    fn what_is_no_value_is_refused() {
        let whole = written(VALUE);
        let is_complete = |bytes: &[u8]| {
            let mut reader = Reader::new(bytes);
            Everything::default().exchange(&mut reader);
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
