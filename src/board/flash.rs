//! Driver of the two calibration slots in on-chip flash, sectors 1 and 2: NOR flash for
//! `settings::storage`.
//!
//! Registers and procedures are RM0090 (STM32F405), RM0368 (F401), RM0383 (F411) and RM0390 (F446),
//! chapter 3 each, which agree. While a sector is erased or a word programmed, every fetch from
//! flash waits, so the whole firmware stops. A sector takes 0.25 s, at most 0.5 s; a word, 32 bits
//! at a time, takes 16 µs, at most 100 µs (STM32F405 datasheet, table "Flash memory
//! programming"). Therefore the caller stops the bursts first, and sets a watchdog limit beyond
//! that time. A sector endures 10,000 erases (table "Flash memory endurance and data retention").
//! Saves alternate, so there are 20,000 saves.
//!
//! The HAL's own flash driver waits without limit, programs bytes, and panics if the unlocking
//! fails.

use core::fmt;

use embedded_storage::nor_flash::{
    ErrorType, MultiwriteNorFlash, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash,
    check_erase, check_read, check_write,
};
use stm32f4xx_hal::pac::FLASH;

use super::{supply, timebase};

/// Start address of sector 1, the first slot.
const START: usize = 0x0800_4000;
/// Number of the first slot's sector.
const FIRST_SECTOR: u32 = 1;
/// Size of a sector (RM0090, table 5).
const SECTOR_BYTES: usize = 16 * 1024;
/// Size of both slots.
const CAPACITY: usize = 2 * SECTOR_BYTES;

/// Keys that unlock the control register, in this order (RM0090, section 3.6.1).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// Twice the datasheet's longest erase of a 16 KiB sector, in microseconds.
const ERASE_DEADLINE_US: u32 = 1_000_000;
/// Ten times the datasheet's longest programming of a word, in microseconds.
const PROGRAM_DEADLINE_US: u32 = 1_000;

/// Calibration slots. The time base must run.
pub struct CalibrationFlash {
    interface: FLASH,
}

/// Error of a flash operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, defmt::Format)]
pub enum FlashError {
    /// The range is outside the slots, or not in whole words or sectors.
    OutOfBounds,
    /// The control register does not unlock, as after a wrong key. Only a reset unlocks it.
    Locked,
    /// An option byte protects the sector (WRPERR).
    WriteProtected,
    /// The interface reports an error of the procedure (PGSERR, PGPERR, PGAERR, OPERR): the bits of
    /// its status register.
    Refused(u8),
    /// The supply is below what programming and erasing need.
    LowSupply,
    /// An operation, or the watchdog's new limit before it, took far longer than the datasheet
    /// allows.
    Timeout,
}

impl fmt::Display for FlashError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::OutOfBounds => formatter.write_str("outside of the slots"),
            Self::Locked => formatter.write_str("it stays locked until the next reset"),
            Self::WriteProtected => formatter.write_str("an option byte protects sectors 1 and 2"),
            Self::Refused(status) => write!(formatter, "status {status:#04x}"),
            Self::LowSupply => {
                formatter.write_str("the supply is below 2.8 V: check it, then save again")
            }
            Self::Timeout => formatter.write_str("no end within the deadline"),
        }
    }
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            _ => NorFlashErrorKind::Other,
        }
    }
}

impl From<NorFlashErrorKind> for FlashError {
    fn from(_: NorFlashErrorKind) -> Self {
        Self::OutOfBounds
    }
}

impl CalibrationFlash {
    /// Takes the flash interface, and starts to watch the supply. Only for init. The wait states
    /// belong to the clocks and do not change.
    pub fn new(interface: FLASH) -> Self {
        supply::watch();
        Self { interface }
    }

    /// Unlocks, runs `work`, and locks again, after errors too.
    fn unlocked(
        &mut self,
        work: impl FnOnce(&Self) -> Result<(), FlashError>,
    ) -> Result<(), FlashError> {
        let flash = &self.interface;
        // Writing ones clears the flags of an earlier operation. SAFETY: all bits of this register
        // are flags.
        flash.sr().write(|w| unsafe { w.bits(FLAGS) });
        // A write to the control register would wait for the end of an operation, without limit
        // (RM0090, section 3.6.1).
        self.wait(PROGRAM_DEADLINE_US)?;
        if flash.cr().read().lock().bit_is_set() {
            for key in KEYS {
                // SAFETY: the key register takes any value, and these two values unlock.
                flash.keyr().write(|w| unsafe { w.bits(key) });
            }
            if flash.cr().read().lock().bit_is_set() {
                return Err(FlashError::Locked);
            }
        }
        let outcome = work(self);
        if outcome == Err(FlashError::Timeout) {
            return outcome;
        }
        // The reset value except for the lock: no operation is selected.
        flash.cr().write(|w| w.lock().set_bit());
        self.forget_cached();
        outcome
    }

    /// Waits for the end of the operation, and returns its result.
    fn wait(&self, deadline_us: u32) -> Result<(), FlashError> {
        let start = timebase::now();
        // The flag rises at most a cycle after the write that starts an operation.
        cortex_m::asm::dsb();
        loop {
            let is_late = timebase::elapsed(start, deadline_us);
            let status = self.interface.sr().read();
            if status.bsy().bit_is_clear() {
                let errors = status.bits() & ERRORS;
                return match errors {
                    0 => Ok(()),
                    _ if status.wrperr().bit_is_set() => Err(FlashError::WriteProtected),
                    _ => Err(FlashError::Refused(errors as u8)),
                };
            }
            // The time is read before the flag, so an operation that stalls this loop is no
            // timeout.
            if is_late {
                return Err(FlashError::Timeout);
            }
        }
    }

    /// Empties the data cache, which does not see that flash changes (RM0090, section 3.5.2). The
    /// slots hold no code, so the instruction cache can stay.
    fn forget_cached(&self) {
        let access = self.interface.acr();
        let was_on = access.read().dcen().bit_is_set();
        // The cache may be reset only while it is off.
        access.modify(|_, w| w.dcen().clear_bit());
        access.modify(|_, w| w.dcrst().set_bit());
        access.modify(|_, w| w.dcrst().clear_bit());
        access.modify(|_, w| w.dcen().bit(was_on));
    }
}

/// Refuses to start an operation that the supply would not complete.
fn check_supply() -> Result<(), FlashError> {
    if supply::is_low() {
        Err(FlashError::LowSupply)
    } else {
        Ok(())
    }
}

/// OPERR, WRPERR, PGAERR, PGPERR and PGSERR of the status register (RM0090, section 3.9.5).
const ERRORS: u32 = 0b1111_0010;
/// The error flags and EOP.
const FLAGS: u32 = ERRORS | 1;

impl ErrorType for CalibrationFlash {
    type Error = FlashError;
}

impl ReadNorFlash for CalibrationFlash {
    const READ_SIZE: usize = 1;

    fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        check_read(self, offset, bytes.len())?;
        let first = (START + offset as usize) as *const u8;
        for (index, byte) in bytes.iter_mut().enumerate() {
            // SAFETY: `check_read` keeps the address within the slots, which are readable on every
            // chip. Volatile, because the compiler does not see their changes.
            *byte = unsafe { first.add(index).read_volatile() };
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        CAPACITY
    }
}

impl NorFlash for CalibrationFlash {
    const WRITE_SIZE: usize = 4;
    const ERASE_SIZE: usize = SECTOR_BYTES;

    fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        check_erase(self, from, to)?;
        self.unlocked(|this| {
            for offset in (from..to).step_by(SECTOR_BYTES) {
                check_supply()?;
                let sector = FIRST_SECTOR + offset / SECTOR_BYTES as u32;
                let control = this.interface.cr();
                // SAFETY: `check_erase` allows sectors 1 and 2 only, neither of which holds code.
                control.write(|w| unsafe {
                    w.lock()
                        .clear_bit()
                        .psize()
                        .psize32()
                        .ser()
                        .set_bit()
                        .snb()
                        .bits(sector as u8)
                });
                control.modify(|_, w| w.strt().set_bit());
                this.wait(ERASE_DEADLINE_US)?;
            }
            Ok(())
        })
    }

    fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        check_write(self, offset, bytes.len())?;
        self.unlocked(|this| {
            // A supply of 2.7 V or more allows 32 bits at a time (RM0090, section 3.6.2).
            this.interface
                .cr()
                .write(|w| w.lock().clear_bit().psize().psize32().pg().set_bit());
            let first = (START + offset as usize) as *mut u32;
            let (words, _) = bytes.as_chunks::<4>();
            for (index, word) in words.iter().enumerate() {
                check_supply()?;
                // SAFETY: `check_write` keeps the address within the slots and aligned to words.
                // Nothing else refers to this memory, and the flash interface takes the store.
                unsafe { first.add(index).write_volatile(u32::from_le_bytes(*word)) };
                this.wait(PROGRAM_DEADLINE_US)?;
            }
            Ok(())
        })
    }
}

/// Programming may be repeated, and clears bits (RM0090, section 3.6.4): this flash has no error
/// correction.
impl MultiwriteNorFlash for CalibrationFlash {}
