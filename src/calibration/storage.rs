//! Keeping a record when the power goes: two slots of flash, one record in each at most.
//!
//! A save goes to the slot that does not hold the record in force, so a power cut at any moment leaves the old
//! record or the new one, whole. A slot is one erase unit; it begins with a header that is the same in every
//! version of the format, little-endian throughout:
//!
//! | byte | what |
//! |---|---|
//! | 0 | the mark `APLB` |
//! | 4 | the version of the body's format (16 bits) |
//! | 6 | the length of the body in bytes (16 bits) |
//! | 8 | the sequence number (32 bits): of two valid records the higher one is in force |
//! | 12 | the CRC-32 (ISO HDLC) of bytes 4 to 11 and of the body |
//! | 16 | the body: see `encoding` |
//!
//! A body of a later version than this code knows is refused and said so; a save leaves it alone while another
//! slot is free. Saving erases flash, which stalls the core for up to half a second on an STM32F4: only ever
//! at rest and on command.

use core::fmt;

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};
use embedded_storage::nor_flash::{MultiwriteNorFlash, NorFlash};

use super::Record;
use super::encoding::{Stored, Writer};

/// The longest record with its header, in bytes, in this and every later version.
pub const LONGEST_RECORD: usize = 256;

/// What the flash held at start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Loaded<T = Record> {
    /// The record in force, if there is one.
    pub record: Option<T>,
    /// What is wrong with a slot. There may be a record all the same.
    pub problem: Option<LoadProblem>,
}

/// Why a slot that is not blank gave no record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum LoadProblem {
    /// The content is no whole record, as after a power cut during a save.
    Damaged,
    /// A whole record, newer than the one in force, in a later format than this firmware reads.
    NewerFormat {
        /// The version of that format.
        version: u16,
    },
}

impl fmt::Display for LoadProblem {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damaged => {
                formatter.write_str("one stored record is damaged, as by a power cut during a save")
            }
            Self::NewerFormat { version } => write!(
                formatter,
                "the newest stored record has format {version}, this firmware reads up to {}: update it or save anew",
                Record::VERSION
            ),
        }
    }
}

/// Why a record was not saved. The record that was in force before still is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SaveError<E> {
    /// The record has a value that could not be read back: a number that is not finite, or a rate of zero.
    Unstorable,
    /// The flash refused.
    Flash(E),
    /// What was written does not read back: the flash is worn out or its supply too low.
    NotKept,
}

impl<E: fmt::Display> fmt::Display for SaveError<E> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unstorable => {
                formatter.write_str("a value is not finite or zero where it may not be")
            }
            Self::Flash(error) => write!(formatter, "the flash refused: {error}"),
            Self::NotKept => {
                formatter.write_str("the flash did not keep what was written: worn out?")
            }
        }
    }
}

/// The record in force. Whatever the flash holds, this returns.
///
/// The first two erase units of `flash` are the slots.
pub fn load<F: NorFlash>(flash: &mut F) -> Loaded {
    load_as(flash)
}

/// Makes `record` the one in force, and reads it back. Erases nothing if it is in force already.
///
/// # Errors
///
/// See [`SaveError`]. An error or a power cut leaves the record that was in force before.
pub fn save<F: MultiwriteNorFlash>(
    flash: &mut F,
    record: &Record,
) -> Result<(), SaveError<F::Error>> {
    save_as(flash, record)
}

/// Erases both slots, the record in force last: a power cut leaves that record or none, never an older one.
///
/// # Errors
///
/// Returns the flash's own error; then a record may be left.
pub fn forget<F: NorFlash>(flash: &mut F) -> Result<(), F::Error> {
    let slots = [read(flash, 0), read(flash, 1)].map(|image| decode::<Record>(&image));
    let last = in_force(&slots).unwrap_or(0);
    erase(flash, 1 - last)?;
    erase(flash, last)
}

/// Bytes of a slot that come before the body.
const HEADER_LENGTH: usize = 16;

/// What a slot of ours begins with.
const MARK: [u8; 4] = *b"APLB";

/// What an erased byte reads.
const ERASED: u8 = 0xFF;

/// Without a table, which would take 1 KiB: a record is short.
static CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// What a slot holds.
#[derive(Clone, Copy)]
enum Slot<T> {
    Blank,
    Damaged,
    NewerFormat { version: u16, sequence: u32 },
    Valid { record: T, sequence: u32 },
}

impl<T> Slot<T> {
    /// The sequence number of a whole record, zero without one: saves count from one.
    fn sequence(&self) -> u32 {
        match *self {
            Self::Blank | Self::Damaged => 0,
            Self::NewerFormat { sequence, .. } | Self::Valid { sequence, .. } => sequence,
        }
    }
}

/// The bytes of a slot that a record can take.
type Image = [u8; LONGEST_RECORD];

fn load_as<F: NorFlash, T: Stored>(flash: &mut F) -> Loaded<T> {
    let slots = [read(flash, 0), read(flash, 1)].map(|image| decode::<T>(&image));
    let (record, newest) = match in_force(&slots).map(|index| slots[index]) {
        Some(Slot::Valid { record, sequence }) => (Some(record), sequence),
        _ => (None, 0),
    };
    let newer_format = slots.iter().find_map(|slot| match *slot {
        Slot::NewerFormat { version, sequence } if sequence > newest => {
            Some(LoadProblem::NewerFormat { version })
        }
        _ => None,
    });
    let damaged = || {
        let is_damaged = slots.iter().any(|slot| matches!(slot, Slot::Damaged));
        is_damaged.then_some(LoadProblem::Damaged)
    };
    Loaded {
        record,
        problem: newer_format.or_else(damaged),
    }
}

fn save_as<F: MultiwriteNorFlash, T: Stored>(
    flash: &mut F,
    record: &T,
) -> Result<(), SaveError<F::Error>> {
    const {
        assert!(LONGEST_RECORD.is_multiple_of(F::WRITE_SIZE));
        assert!(LONGEST_RECORD.is_multiple_of(F::READ_SIZE));
    }
    let images = [read(flash, 0), read(flash, 1)];
    let slots = images.each_ref().map(decode::<T>);
    let sequence = slots[0].sequence().max(slots[1].sequence()) + 1;
    let image = encode(record, sequence).ok_or(SaveError::Unstorable)?;

    let kept = in_force(&slots);
    if let Some(index) = kept {
        // A power cut may have left bits of this record weak, so that they read right today and wrong
        // tomorrow. Programming the same bits again makes them firm before the other slot goes.
        program(flash, index, &images[index]).map_err(SaveError::Flash)?;
        if content(&images[index]) == content(&image) {
            return Ok(());
        }
    }
    let target = match kept {
        Some(index) => 1 - index,
        None if slots[1].sequence() < slots[0].sequence() => 1,
        None => 0,
    };
    // A slot that reads blank is erased too: an erase that was cut short may have left it so.
    erase(flash, target).map_err(SaveError::Flash)?;
    program(flash, target, &image).map_err(SaveError::Flash)?;
    if read(flash, target) == image {
        Ok(())
    } else {
        Err(SaveError::NotKept)
    }
}

/// The index of the slot whose record is in force.
fn in_force<T>(slots: &[Slot<T>; 2]) -> Option<usize> {
    match slots {
        [
            Slot::Valid { sequence: a, .. },
            Slot::Valid { sequence: b, .. },
        ] => Some((b > a) as usize),
        [Slot::Valid { .. }, _] => Some(0),
        [_, Slot::Valid { .. }] => Some(1),
        _ => None,
    }
}

/// The start of a slot. What cannot be read is neither erased nor a record.
fn read<F: NorFlash>(flash: &mut F, index: usize) -> Image {
    let mut image = [0; LONGEST_RECORD];
    match flash.read(start_of::<F>(index), &mut image) {
        Ok(()) => image,
        Err(_) => [0; LONGEST_RECORD],
    }
}

fn erase<F: NorFlash>(flash: &mut F, index: usize) -> Result<(), F::Error> {
    let start = start_of::<F>(index);
    flash.erase(start, start + F::ERASE_SIZE as u32)
}

/// Programs an image, but not the erased words at its end.
fn program<F: NorFlash>(flash: &mut F, index: usize, image: &Image) -> Result<(), F::Error> {
    let length = image
        .iter()
        .rposition(|&byte| byte != ERASED)
        .map_or(0, |last| (last + 1).next_multiple_of(F::WRITE_SIZE));
    flash.write(start_of::<F>(index), image.get(..length).unwrap_or(image))
}

fn start_of<F: NorFlash>(index: usize) -> u32 {
    (index * F::ERASE_SIZE) as u32
}

/// The bytes of a slot, erased ones after the record. `None` if it would not read back.
fn encode<T: Stored>(record: &T, sequence: u32) -> Option<Image> {
    let mut body = Writer::new();
    record.encode(&mut body).ok()?;
    let mut image: Image = [ERASED; LONGEST_RECORD];
    let (header, rest) = image.split_first_chunk_mut::<HEADER_LENGTH>()?;
    for (place, byte) in rest.iter_mut().zip(&body) {
        *place = *byte;
    }
    let form = u32::from(T::VERSION) | (body.len() as u32) << 16;
    let (words, _) = header.as_chunks_mut::<4>();
    let [mark, version_and_length, number, _] = words else {
        return None;
    };
    *mark = MARK;
    *version_and_length = form.to_le_bytes();
    *number = sequence.to_le_bytes();
    let crc = checksum(header, &body);
    *header.last_chunk_mut()? = crc.to_le_bytes();
    matches!(decode::<T>(&image), Slot::Valid { .. }).then_some(image)
}

/// All but the sequence number and the CRC over it: version, length and body.
fn content(image: &Image) -> (Option<&[u8]>, Option<&[u8]>) {
    (image.get(..8), image.get(HEADER_LENGTH..))
}

fn decode<T: Stored>(image: &Image) -> Slot<T> {
    let Some((header, rest)) = image.split_first_chunk::<HEADER_LENGTH>() else {
        return Slot::Damaged;
    };
    if header.iter().all(|&byte| byte == ERASED) {
        return Slot::Blank;
    }
    let &[
        m0,
        m1,
        m2,
        m3,
        v0,
        v1,
        l0,
        l1,
        s0,
        s1,
        s2,
        s3,
        c0,
        c1,
        c2,
        c3,
    ] = header;
    let version = u16::from_le_bytes([v0, v1]);
    let length = u16::from_le_bytes([l0, l1]);
    let sequence = u32::from_le_bytes([s0, s1, s2, s3]);
    let Some(body) = rest.get(..length.into()) else {
        return Slot::Damaged;
    };
    // The first and the last number are none that a save gives.
    let is_whole = [m0, m1, m2, m3] == MARK
        && sequence != 0
        && sequence != u32::MAX
        && u32::from_le_bytes([c0, c1, c2, c3]) == checksum(header, body);
    if !is_whole {
        return Slot::Damaged;
    }
    if version > T::VERSION {
        return Slot::NewerFormat { version, sequence };
    }
    match T::decode(version, body) {
        Some(record) => Slot::Valid { record, sequence },
        None => Slot::Damaged,
    }
}

fn checksum(header: &[u8; HEADER_LENGTH], body: &[u8]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(&header[4..12]);
    digest.update(body);
    digest.finalize()
}

#[cfg(test)]
mod tests;
