//! Storage of a record in flash: two slots, with one record in each at most.
//!
//! A save goes to the slot that does not hold the active record. A power cut at any moment leaves
//! the old record or the new one, whole. A slot is one erase unit. It begins with a header that is
//! the same in every version of the format, little-endian throughout:
//!
//! | byte | content |
//! |---|---|
//! | 0 | mark `APLB` |
//! | 4 | version of the body's encoding (16 bits) |
//! | 6 | length of the body in bytes (16 bits) |
//! | 8 | sequence number (32 bits): of two valid records the higher one is active |
//! | 12 | CRC-32 (ISO HDLC) of bytes 4 to 11 and of the body |
//! | 16 | body: see `encoding` |
//!
//! [`load`] reports a body of a later version than this code reads; a save leaves that slot alone
//! while the other one is free. Saving erases flash, which stalls the core of an STM32F4 for up to
//! half a second, and for twice that if both slots are erased: save at rest and on command only.
//!
//! ```
//! use aplomb::settings::{Record, storage};
//! # use embedded_storage::nor_flash::*;
//! # struct Ram([u8; 1024]);
//! # impl ErrorType for Ram { type Error = NorFlashErrorKind; }
//! # impl ReadNorFlash for Ram {
//! #     const READ_SIZE: usize = 1;
//! #     fn read(&mut self, at: u32, bytes: &mut [u8]) -> Result<(), NorFlashErrorKind> {
//! #         bytes.copy_from_slice(&self.0[at as usize..][..bytes.len()]);
//! #         Ok(())
//! #     }
//! #     fn capacity(&self) -> usize { 1024 }
//! # }
//! # impl NorFlash for Ram {
//! #     const WRITE_SIZE: usize = 4;
//! #     const ERASE_SIZE: usize = 512;
//! #     fn erase(&mut self, from: u32, to: u32) -> Result<(), NorFlashErrorKind> {
//! #         self.0[from as usize..to as usize].fill(0xFF);
//! #         Ok(())
//! #     }
//! #     fn write(&mut self, at: u32, bytes: &[u8]) -> Result<(), NorFlashErrorKind> {
//! #         self.0[at as usize..][..bytes.len()].copy_from_slice(bytes);
//! #         Ok(())
//! #     }
//! # }
//! # impl MultiwriteNorFlash for Ram {}
//! # let mut flash = Ram([0xFF; 1024]);
//! // `flash` is any NOR flash with two erase units.
//! let mut record = Record::default();
//! record.preferences.rate_hz = 200;
//! storage::save(&mut flash, &record)?;
//! assert_eq!(storage::load(&mut flash).record, Some(record));
//! # Ok::<(), storage::SaveError<NorFlashErrorKind>>(())
//! ```

use core::fmt;
use core::ops::Range;

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};
use embedded_storage::nor_flash::{MultiwriteNorFlash, NorFlash};

use super::encoding::{BODY_CAPACITY, Stored, Writer, body};
use super::record::Record;

/// Longest record with its header, in bytes, in this and every later version.
pub const LONGEST_RECORD: usize = HEADER_LENGTH + BODY_CAPACITY;

/// Content of the flash at start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Loaded<T = Record> {
    /// Active record, if there is one.
    pub record: Option<T>,
    /// Problem of the slots. One of them may hold a record nevertheless. A save ends the problem.
    pub problem: Option<LoadProblem>,
}

/// Reason why a slot that is not blank gave no record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum LoadProblem {
    /// The content is not a whole record, as after a power cut during a save.
    Damaged,
    /// Neither slot holds a whole record.
    BothDamaged,
    /// The slot holds a whole record, newer than the active one, of a later version than this
    /// firmware reads.
    NewerFormat {
        /// Version of that record's encoding.
        version: u16,
    },
}

impl core::error::Error for LoadProblem {}

impl fmt::Display for LoadProblem {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damaged => {
                formatter.write_str("one stored record is damaged, as by a power cut during a save")
            }
            Self::BothDamaged => {
                formatter.write_str("both stored records are damaged: calibrate again, then save")
            }
            Self::NewerFormat { version } => write!(
                formatter,
                "the newest stored record has format {version}, \
                 this firmware reads up to {}: update it or save anew",
                Record::VERSION
            ),
        }
    }
}

/// Reason why a record was not saved. The record that was active before still is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum SaveError<E> {
    /// The record has a value that could not be read back: a number that is not finite, or a rate
    /// of zero.
    Unstorable,
    /// The flash reported an error.
    Flash(E),
    /// The slot does not read back as written: the flash is worn out, or its supply is too low.
    NotKept,
}

impl<E: fmt::Debug + fmt::Display> core::error::Error for SaveError<E> {}

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

/// Returns the active record, and any problem, whatever the flash holds.
///
/// The first two erase units of `flash` are the slots. A read that fails counts as a damaged slot.
pub fn load<F: NorFlash>(flash: &mut F) -> Loaded {
    load_as(flash)
}

/// Makes `record` the active one, and reads it back. Erases nothing if it is active already, and
/// the other slot is blank or has a record too.
///
/// # Errors
///
/// Returns a [`SaveError`]. An error or a power cut leaves the record that was active before.
pub fn save<F: MultiwriteNorFlash>(
    flash: &mut F,
    record: &Record,
) -> Result<(), SaveError<F::Error>> {
    save_as(flash, record)
}

/// Returns a record as bytes with a checksum, for other memory than flash; `None` if it has a value
/// that could not be read back.
pub fn to_bytes(record: &Record) -> Option<[u8; LONGEST_RECORD]> {
    encode(record, 1)
}

/// Returns the record of these bytes, and the problem if they give none. Erased bytes give neither.
///
/// The checksum shows that the bytes are as they were written. [`Calibration::check`] shows that a
/// sensor can have such a calibration.
///
/// ```
/// use aplomb::calibration::{Calibration, ImplausibleCalibration};
/// use aplomb::settings::{Record, storage};
///
/// /// Returns the calibration of these bytes, and none without a record.
/// fn calibration(
///     bytes: &[u8; storage::LONGEST_RECORD],
/// ) -> Result<Calibration, ImplausibleCalibration> {
///     let record = storage::from_bytes(bytes).record.unwrap_or_default();
///     record.calibration.check()?;
///     Ok(record.calibration)
/// }
/// # let bytes = storage::to_bytes(&Record::default()).ok_or("unstorable")?;
/// # assert!(calibration(&bytes)? == Calibration::NONE);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// [`Calibration::check`]: crate::calibration::Calibration::check
pub fn from_bytes(bytes: &[u8; LONGEST_RECORD]) -> Loaded {
    let (record, problem) = match decode(bytes) {
        Slot::Valid { record, .. } => (Some(record), None),
        Slot::Blank => (None, None),
        Slot::Damaged => (None, Some(LoadProblem::Damaged)),
        Slot::NewerFormat { version, .. } => (None, Some(LoadProblem::NewerFormat { version })),
    };
    Loaded { record, problem }
}

/// Returns whether both records have the same bytes in flash.
pub(crate) fn has_same_bytes(left: &Record, right: &Record) -> bool {
    body(left) == body(right)
}

/// Erases both slots, the active record last: a power cut leaves that record or none, never an
/// older one. The firmware's command `forget` clears the record in use instead, and `save` stores
/// that.
///
/// # Errors
///
/// Returns the flash's own error; a record may be left then.
pub fn forget<F: NorFlash>(flash: &mut F) -> Result<(), F::Error> {
    let slots = [read(flash, 0), read(flash, 1)].map(|image| decode::<Record>(&image));
    let last = active_slot(&slots).unwrap_or(0);
    let other = 1 - last;
    erase(flash, other..other + 1)?;
    erase(flash, last..last + 1)
}

/// Length of the header, in bytes.
const HEADER_LENGTH: usize = 16;

/// First bytes of a slot.
const MARK: [u8; 4] = *b"APLB";

/// Value of an erased byte.
const ERASED: u8 = 0xFF;

/// CRC without a table, which would take 1 KiB: a record is short.
static CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// Content of a slot.
#[derive(Clone, Copy)]
enum Slot<T> {
    Blank,
    Damaged,
    NewerFormat { version: u16, sequence: u32 },
    Valid { record: T, sequence: u32 },
}

impl<T> Slot<T> {
    /// Returns the sequence number of a whole record, or 0: saves count from 1.
    fn sequence(&self) -> u32 {
        match *self {
            Self::Blank | Self::Damaged => 0,
            Self::NewerFormat { sequence, .. } | Self::Valid { sequence, .. } => sequence,
        }
    }
}

/// Bytes of a slot that a record can take.
type Image = [u8; LONGEST_RECORD];

fn load_as<F: NorFlash, T: Stored>(flash: &mut F) -> Loaded<T> {
    let slots = [read(flash, 0), read(flash, 1)].map(|image| decode::<T>(&image));
    let (record, newest) = match active_slot(&slots).map(|index| slots[index]) {
        Some(Slot::Valid { record, sequence }) => (Some(record), sequence),
        _ => (None, 0),
    };
    let newer_format = slots.iter().find_map(|slot| match *slot {
        Slot::NewerFormat { version, sequence } if sequence > newest => {
            Some(LoadProblem::NewerFormat { version })
        }
        _ => None,
    });
    let damaged = match slots {
        [Slot::Damaged, Slot::Damaged] => Some(LoadProblem::BothDamaged),
        [Slot::Damaged, _] | [_, Slot::Damaged] => Some(LoadProblem::Damaged),
        _ => None,
    };
    Loaded {
        record,
        problem: newer_format.or(damaged),
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

    let kept = active_slot(&slots);
    if let Some(index) = kept {
        // A power cut may have left bits of this record weak: right today, wrong tomorrow.
        // Programming the same bits again makes them firm before the other slot is erased.
        program(flash, index, &images[index]).map_err(SaveError::Flash)?;
        let other = &slots[1 - index];
        let is_sound = matches!(other, Slot::Blank | Slot::Valid { .. });
        if is_sound && content(&images[index]) == content(&image) {
            return Ok(());
        }
    }
    let target = match kept {
        Some(index) => 1 - index,
        None if slots[1].sequence() < slots[0].sequence() => 1,
        None => 0,
    };
    // Without a record of any format, a damaged slot is erased too. No later save would reach it.
    let is_damaged = sequence == 1 && slots.iter().any(|slot| matches!(slot, Slot::Damaged));
    let erased = if is_damaged { 0..2 } else { target..target + 1 };
    // A slot that reads blank is erased too: an erase that was cut short may have left it so.
    erase(flash, erased).map_err(SaveError::Flash)?;
    program(flash, target, &image).map_err(SaveError::Flash)?;
    if read(flash, target) == image {
        Ok(())
    } else {
        Err(SaveError::NotKept)
    }
}

/// Returns the index of the slot with the active record.
fn active_slot<T>(slots: &[Slot<T>; 2]) -> Option<usize> {
    match slots {
        [
            Slot::Valid { sequence: a, .. },
            Slot::Valid { sequence: b, .. },
        ] => Some(usize::from(b > a)),
        [Slot::Valid { .. }, _] => Some(0),
        [_, Slot::Valid { .. }] => Some(1),
        _ => None,
    }
}

/// Reads the start of a slot. A slot that cannot be read is neither blank nor a record.
fn read<F: NorFlash>(flash: &mut F, index: usize) -> Image {
    let mut image = [0; LONGEST_RECORD];
    match flash.read(start_of::<F>(index), &mut image) {
        Ok(()) => image,
        Err(_) => [0; LONGEST_RECORD],
    }
}

fn erase<F: NorFlash>(flash: &mut F, slots: Range<usize>) -> Result<(), F::Error> {
    flash.erase(start_of::<F>(slots.start), start_of::<F>(slots.end))
}

/// Programs an image without the erased words at its end.
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

/// Encodes a slot, with erased bytes after the record; `None` if it would not read back.
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

/// Returns an image without its sequence number and CRC: version, length and body.
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
    // No save gives the first or the last number.
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
