//! Random bytes in the calibration slots: a record that loads is one that was saved whole.
//!
//! The first byte selects the form of the rest: unchanged, or as the body of a record. The harness
//! adds a right header to a body, so that it reaches the decoder. It builds the header
//! independently of the library.

use aplomb::settings::storage;
use embedded_storage::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashErrorKind, ReadNorFlash,
};

/// Length of the longest record: the library reads no more of a slot.
const SLOT: usize = storage::LONGEST_RECORD;

/// Version of the encoding.
const VERSION: u16 = 4;

/// Writes the bytes to the first slot and loads.
///
/// # Panics
///
/// Panics if an invariant is violated.
pub fn run(bytes: &[u8]) {
    let [layout, rest @ ..] = bytes else { return };
    let rest = &rest[..rest.len().min(SLOT - 16)];
    let slot = match layout % 3 {
        0 => rest.to_vec(),
        1 => image(VERSION, rest),
        _ => image(u16::from(*layout), rest),
    };
    let mut flash = Memory([0xFF; 2 * SLOT]);
    flash.0[..slot.len()].copy_from_slice(&slot);
    let loaded = storage::load(&mut flash);
    let Some(record) = loaded.record else {
        let is_blank = flash.0[..16] == [0xFF; 16];
        assert_eq!(loaded.problem.is_none(), is_blank);
        return;
    };
    // Each record has exactly one encoding: saved to blank flash it gives the same bytes.
    let mut again = Memory([0xFF; 2 * SLOT]);
    storage::save(&mut again, &record).expect("what was read can be saved");
    let length = 16 + usize::from(u16::from_le_bytes([slot[6], slot[7]]));
    let mut body = slot[16..length].to_vec();
    if slot[4] == 1 {
        // Version 1 had no compass: found by itself, no mount, no correction.
        body.extend([0; 3]);
    }
    if slot[4] < 3 {
        // Version 2 had no declination.
        body.extend([0; 4]);
    }
    let longer = usize::from(slot[4] < 4);
    let saved = &again.0[16..16 + body.len() + longer];
    if slot[4] < 4 {
        // Version 3 had no byte for the gyroscope's matrix.
        let is_all_else = |at: usize| {
            saved[at] == 0 && saved[..at] == body[..at] && saved[at + 1..] == body[at..]
        };
        assert!((0..saved.len()).any(is_all_else), "{saved:?} {body:?}");
        body = saved.to_vec();
    }
    let expected = image(VERSION, &body);
    assert_eq!(again.0[..expected.len()], expected);
    assert_eq!(storage::load(&mut again).record, Some(record));
}

/// A slot with a right header, sequence number 1.
pub fn image(version: u16, body: &[u8]) -> Vec<u8> {
    let mut covered = version.to_le_bytes().to_vec();
    covered.extend((body.len() as u16).to_le_bytes());
    covered.extend(1_u32.to_le_bytes());
    let header = [&b"APLB"[..], &covered].concat();
    covered.extend(body);
    [
        &header,
        &crate::checksums::crc_32(&covered).to_le_bytes()[..],
        body,
    ]
    .concat()
}

/// Flash without faults.
struct Memory([u8; 2 * SLOT]);

impl ErrorType for Memory {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Memory {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        bytes.copy_from_slice(&self.0[offset as usize..][..bytes.len()]);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Memory {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SLOT;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        self.0[from as usize..to as usize].fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        for (cell, byte) in self.0[offset as usize..].iter_mut().zip(bytes) {
            *cell &= byte;
        }
        Ok(())
    }
}

impl MultiwriteNorFlash for Memory {}
