//! Calibration slots in memory, for the library's `save` and `load`: the code of the firmware.

use aplomb::settings::{Record, storage};
use embedded_storage::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashErrorKind, ReadNorFlash,
};

use crate::flash::SLOT_BYTES;

/// The bytes of both calibration slots.
pub struct Slots(pub Vec<u8>);

impl Slots {
    /// Both slots erased.
    #[must_use]
    pub fn erased() -> Self {
        Self(vec![0xFF; 2 * SLOT_BYTES])
    }

    /// Slots with this record, as a `save` leaves them.
    #[must_use]
    pub fn with_record(record: &Record) -> Self {
        let mut slots = Self::erased();
        // A record fits into erased slots.
        storage::save(&mut slots, record).ok();
        slots
    }
}

impl ErrorType for Slots {
    type Error = NorFlashErrorKind;
}

impl ReadNorFlash for Slots {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), Self::Error> {
        let stored = self.0.get(offset as usize..).unwrap_or_default();
        let stored = stored.get(..bytes.len());
        bytes.copy_from_slice(stored.ok_or(NorFlashErrorKind::OutOfBounds)?);
        Ok(())
    }

    fn capacity(&self) -> usize {
        self.0.len()
    }
}

impl NorFlash for Slots {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SLOT_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), Self::Error> {
        let erased = self.0.get_mut(from as usize..to as usize);
        erased.ok_or(NorFlashErrorKind::OutOfBounds)?.fill(0xFF);
        Ok(())
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), Self::Error> {
        let cells = self.0.get_mut(offset as usize..);
        let cells = cells.and_then(|cells| cells.get_mut(..bytes.len()));
        for (cell, byte) in cells
            .ok_or(NorFlashErrorKind::OutOfBounds)?
            .iter_mut()
            .zip(bytes)
        {
            *cell &= byte;
        }
        Ok(())
    }
}

impl MultiwriteNorFlash for Slots {}
