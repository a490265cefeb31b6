//! The calibration slots of the on-chip flash, which rigless does not change. Programming clears
//! bits and erasing sets them. Both take the datasheet's time, and the power can fail in the middle
//! of either.
//!
//! The cells are those of sectors 1 and 2 alone; the rest of the flash holds the image and cannot
//! be written here. The core's accesses to the two sectors come here ([`Cells::read`],
//! [`Cells::store`]) instead of to rigless's memory. The registers are rigless's, with the keys,
//! the lock and the erase's flags. [`FlashInterface`] adds programming (RM0090, sections 3.6 and
//! 3.9, for the STM32F405).
//!
//! While an operation runs, the core of a real chip waits at its next fetch from flash. Here the
//! recorder holds the core until then ([`Cells::busy_until_ns`]). Instructions between the
//! operation's start and the next access to the interface are not delayed.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::Width;
use rigless::soc::stm32f427::generated::flash::{Register, acr, cr, sr};
use rigless::soc::stm32f427::peripherals::flash::Flash;
use rigless::time::{EventId, VirtualNanos};

use crate::delegate::delegate;
use aplomb_models::random::Random;

/// Addresses of the slots.
pub const SLOTS: Range<u64> = 0x0800_4000..0x0800_C000;
/// A slot: a sector of 16 KiB.
pub const SLOT_BYTES: usize = 0x4000;
/// The number of the first slot's sector.
const FIRST_SECTOR: u64 = 1;

/// The longest erase of a 16 KiB sector, 32 bits at a time, and the longest programming of a word
/// (STM32F405 datasheet, table "Flash memory programming").
const ERASE_NS: u64 = 500_000_000;
const PROGRAM_NS: u64 = 100_000;

/// The lowest supply for 32 bits at a time, mV (RM0090, table 7).
const LOWEST_MILLIVOLTS: u32 = 2_700;

/// PSIZE for 32 bits at a time, all that a supply of 3.3 V is used for here.
const WORDS: u64 = 0b10;

/// One step of a change, at which the power can go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A sector was erased.
    Erase {
        /// 0 or 1.
        slot: usize,
    },
    /// A word was programmed.
    Program {
        /// Distance from the first slot's start, in bytes.
        offset: usize,
        /// The requested value. A cell stays set only where both old and new value have a one.
        word: u32,
    },
}

/// Bytes of a line of the data cache (RM0090, 3.5.2).
const LINE_BYTES: usize = 16;

/// The contents of both slots, and their changes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FlashRecord {
    /// At the start of the run.
    before: Vec<u8>,
    /// At its end.
    pub bytes: Vec<u8>,
    /// The changes, in order.
    pub steps: Vec<Step>,
    /// Start of each change, ns since power-up.
    pub begun_ns: Vec<u64>,
}

impl FlashRecord {
    /// Blank slots.
    #[must_use]
    pub fn blank() -> Self {
        Self::holding(vec![0xFF; 2 * SLOT_BYTES])
    }

    /// Slots with these contents. Missing bytes are blank; bytes beyond the slots are left out.
    #[must_use]
    pub fn holding(mut bytes: Vec<u8>) -> Self {
        bytes.resize(2 * SLOT_BYTES, 0xFF);
        Self {
            before: bytes.clone(),
            bytes,
            steps: Vec::new(),
            begun_ns: Vec::new(),
        }
    }

    /// Returns the slots after a power cut within step number `step`. The steps before it are
    /// complete and those after it have not begun. Of its own bits some are old and some new; an
    /// erase, which first programs every cell, leaves some that are neither.
    #[must_use]
    pub fn cut_in(&self, step: usize, seed: u64) -> Vec<u8> {
        let mut bytes = self.before.clone();
        for step in self.steps.iter().take(step) {
            apply(&mut bytes, *step);
        }
        if let Some(&step) = self.steps.get(step) {
            apply_in_part(&mut bytes, step, seed);
        }
        bytes
    }
}

/// Makes a change of which some bits are old and some new. An erase leaves some that are neither.
fn apply_in_part(bytes: &mut [u8], step: Step, seed: u64) {
    let range = step.range();
    let mut after = bytes.to_vec();
    apply(&mut after, step);
    let mut random = Random::new(seed, "power cut");
    // Early and late cuts: from nothing changed to everything.
    let (changed, programmed) = (random.uniform(0.0, 1.0), random.uniform(0.0, 1.0));
    let is_erase = matches!(step, Step::Erase { .. });
    for (byte, new) in bytes[range.clone()].iter_mut().zip(&after[range]) {
        for bit in (0..8).map(|bit| 1 << bit) {
            if random.uniform(0.0, 1.0) < changed {
                *byte = (*byte & !bit) | (new & bit);
            } else if is_erase && random.uniform(0.0, 1.0) < programmed {
                *byte &= !bit;
            }
        }
    }
}

impl Step {
    /// The bytes that it may change, from the first slot's start.
    fn range(self) -> Range<usize> {
        match self {
            Self::Erase { slot } => slot * SLOT_BYTES..(slot + 1) * SLOT_BYTES,
            Self::Program { offset, .. } => offset..offset + 4,
        }
    }
}

fn apply(bytes: &mut [u8], step: Step) {
    match step {
        Step::Erase { slot } => bytes[slot * SLOT_BYTES..][..SLOT_BYTES].fill(0xFF),
        Step::Program { offset, word } => {
            for (cell, byte) in bytes[offset..].iter_mut().zip(word.to_le_bytes()) {
                *cell &= byte;
            }
        }
    }
}

/// The cells, which both the core's accesses and the interface's registers reach.
#[derive(Clone, Debug)]
pub struct SharedCells(Arc<Mutex<Cells>>);

/// The cells and what the interface lets the core do to them.
#[derive(Debug)]
pub struct Cells {
    record: FlashRecord,
    /// CR as it stands.
    control: u64,
    /// Error flags that stores have raised.
    errors: u64,
    /// End of the operation that runs, ns since power-up.
    busy_until_ns: u64,
    /// True if the supply is too low for an operation to complete.
    is_supply_low: bool,
    /// The bytes that the last change may have changed, as they were before it.
    overwritten: Vec<u8>,
    /// True if the data cache is on.
    has_data_cache: bool,
    /// The lines that the core has read since the cache was reset, by their offset.
    cached: BTreeMap<usize, Vec<u8>>,
}

impl SharedCells {
    /// Cells that hold this.
    #[must_use]
    pub fn new(record: FlashRecord) -> Self {
        Self(Arc::new(Mutex::new(Cells {
            record,
            control: cr::LOCK.mask(),
            errors: 0,
            busy_until_ns: 0,
            is_supply_low: false,
            overwritten: Vec::new(),
            has_data_cache: false,
            cached: BTreeMap::new(),
        })))
    }

    /// Does something with the cells.
    pub fn with<T>(&self, work: impl FnOnce(&mut Cells) -> T) -> T {
        work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The cells now, and what was done to them.
    #[must_use]
    pub fn record(&self) -> FlashRecord {
        self.with(|cells| cells.record.clone())
    }
}

impl Cells {
    /// Returns the end of the operation that was started last, ns since power-up.
    #[must_use]
    pub fn busy_until_ns(&self) -> u64 {
        self.busy_until_ns
    }

    /// Returns the value that the core reads: that of its first read of the line, until the data
    /// cache is reset. The chip's cache, of eight lines, may drop a line sooner.
    pub fn read(&mut self, address: u64, width: Width) -> u64 {
        let start = (address - SLOTS.start) as usize;
        let read = |at: usize| {
            let line = at / LINE_BYTES * LINE_BYTES;
            let end = self.record.bytes.len().min(line + LINE_BYTES);
            let now = &self.record.bytes[line..end];
            let byte = if self.has_data_cache {
                let cached = self.cached.entry(line).or_insert_with(|| now.to_vec());
                cached.get(at - line)
            } else {
                now.get(at - line)
            };
            byte.copied().unwrap_or(0xFF)
        };
        let bytes: Vec<u8> = (start..start + width.bytes() as usize).map(read).collect();
        let bytes = bytes.iter().rev();
        bytes.fold(0, |value, &byte| value << 8 | u64::from(byte))
    }

    /// Follows a write of the access control register (RM0090, 3.9.1). The data cache can be reset
    /// only while it is off.
    fn control_cache(&mut self, control: u64) {
        self.has_data_cache = acr::DCEN.is_set(control);
        if acr::DCRST.is_set(control) && !self.has_data_cache {
            self.cached.clear();
        }
    }

    /// Programs what the core stores, or raises the error flag (RM0090, sections 3.6.4 and 3.9.5).
    pub fn store(&mut self, now: VirtualNanos, address: u64, width: Width, value: u64) {
        let is_ready = cr::PG.is_set(self.control)
            && !cr::LOCK.is_set(self.control)
            && now.0 >= self.busy_until_ns;
        if !is_ready {
            self.errors |= sr::PGSERR.mask();
        } else if cr::PSIZE.get(self.control) != WORDS || width != Width::W32 {
            self.errors |= sr::PGPERR.mask();
        } else if !address.is_multiple_of(4) {
            self.errors |= sr::PGAERR.mask();
        } else {
            let step = Step::Program {
                offset: (address - SLOTS.start) as usize,
                word: value as u32,
            };
            self.change(step, now.0, PROGRAM_NS);
        }
    }

    /// Makes a change that takes this time, in part if the supply is too low for it.
    fn change(&mut self, step: Step, now_ns: u64, duration_ns: u64) {
        self.busy_until_ns = now_ns + duration_ns;
        self.record.begun_ns.push(now_ns);
        self.overwritten = self.record.bytes[step.range()].to_vec();
        self.record.steps.push(step);
        if self.is_supply_low {
            self.spoil(step);
        } else {
            apply(&mut self.record.bytes, step);
        }
    }

    /// Makes a change in part. The number of steps decides about each bit.
    fn spoil(&mut self, step: Step) {
        let seed = self.record.steps.len() as u64;
        apply_in_part(&mut self.record.bytes, step, seed);
    }

    /// The supply changes. Below 2.7 V an operation of 32 bits at a time does not complete, also
    /// one that runs (RM0090, 3.6.2).
    pub fn set_supply(&mut self, now_ns: u64, millivolts: u32) {
        self.is_supply_low = millivolts < LOWEST_MILLIVOLTS;
        if self.is_supply_low {
            self.interrupt(now_ns);
        }
    }

    /// Leaves the operation that runs, if one does, incomplete. A second interruption of the same
    /// operation changes nothing.
    fn interrupt(&mut self, now_ns: u64) {
        let running = self.record.steps.last().copied();
        if let Some(step) = running.filter(|_| now_ns < self.busy_until_ns) {
            self.record.bytes[step.range()].copy_from_slice(&self.overwritten);
            self.spoil(step);
        }
    }

    /// Follows a reset of the core. The cells stay, and the interface is locked. The contents are
    /// not guaranteed if an operation runs (ST's HAL, notes of the FLASH driver).
    fn restart(&mut self, now_ns: u64) {
        self.interrupt(now_ns);
        self.control = cr::LOCK.mask();
        self.errors = 0;
        self.busy_until_ns = 0;
        self.has_data_cache = false;
        self.cached.clear();
    }
}

/// The interface's registers.
#[derive(Debug)]
pub struct FlashInterface {
    /// The model of rigless.
    pub model: Flash,
    /// The cells behind it.
    pub cells: SharedCells,
}

impl FlashInterface {
    /// The flags that stores have raised, and that an operation runs.
    fn status(&self, now: VirtualNanos) -> u64 {
        self.cells.with(|cells| {
            let busy = u64::from(now.0 < cells.busy_until_ns);
            sr::BSY.set(cells.errors, busy)
        })
    }
}

impl Device for FlashInterface {
    type Register = Register;

    delegate!(layout peek on_request on_access on_refused on_clock reset_line);

    fn read(
        &mut self,
        register: Register,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        let value = Device::read(&mut self.model, register, registers, context);
        if register != Register::Sr {
            return value;
        }
        let value = value.unwrap_or_else(|| registers.get(Register::Sr));
        Some(value | self.status(context.now()))
    }

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let was_busy = sr::BSY.is_set(registers.get(Register::Sr));
        Device::write(&mut self.model, register, value, registers, context);
        if register == Register::Acr {
            self.cells.with(|cells| cells.control_cache(value));
        }
        let control = registers.get(Register::Cr);
        let starts =
            !was_busy && sr::BSY.is_set(registers.get(Register::Sr)) && cr::SER.is_set(control);
        self.cells.with(|cells| {
            cells.control = control;
            if register == Register::Sr {
                cells.errors &= !value;
            }
            let slot = cr::SNB.get(control).checked_sub(FIRST_SECTOR);
            if let Some(slot @ 0..=1) = slot.filter(|_| starts) {
                let step = Step::Erase {
                    slot: slot as usize,
                };
                cells.change(step, context.now().0, ERASE_NS);
            }
        });
    }

    fn on_event(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::on_event(&mut self.model, event, registers, context);
        let control = registers.get(Register::Cr);
        self.cells.with(|cells| cells.control = control);
    }

    fn reset(&mut self) {
        Device::reset(&mut self.model);
        // Without a time, nothing runs.
        self.restart(u64::MAX);
    }
}

impl FlashInterface {
    /// Follows a reset of the core at this time, ns since power-up.
    pub fn restart(&mut self, now_ns: u64) {
        self.cells.with(|cells| cells.restart(now_ns));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_in_the_data_cache_is_stale_until_the_cache_is_reset() {
        let cells = SharedCells::new(FlashRecord::blank());
        let control = |value: u64| cells.with(|cells| cells.control_cache(value));
        let word = |nth: u64| cells.with(|cells| cells.read(SLOTS.start + 4 * nth, Width::W32));
        let program = |offset: usize| {
            cells.with(|cells| cells.change(Step::Program { offset, word: 7 }, 0, 0));
        };
        assert_eq!(word(0), 0xFFFF_FFFF);
        program(0);
        assert_eq!(word(0), 7, "without the cache");
        control(acr::DCEN.mask());
        assert_eq!([word(1), word(4)], [0xFFFF_FFFF; 2]);
        program(4);
        assert_eq!(word(1), 0xFFFF_FFFF);
        control(acr::DCEN.mask() | acr::DCRST.mask());
        assert_eq!(word(1), 0xFFFF_FFFF, "not reset while it is on");
        control(acr::DCRST.mask());
        control(acr::DCEN.mask());
        assert_eq!(word(1), 7);
    }

    #[test]
    fn a_reset_leaves_the_operation_that_runs_incomplete() {
        let mut record = FlashRecord::blank();
        record.bytes[..SLOT_BYTES].fill(0x55);
        let erase = Step::Erase { slot: 0 };
        let after = |reset_ns: u64| {
            let cells = SharedCells::new(record.clone());
            cells.with(|cells| {
                cells.change(erase, 1_000, ERASE_NS);
                cells.restart(reset_ns);
                cells.restart(reset_ns);
            });
            cells.record()
        };
        let complete = after(1_000 + ERASE_NS);
        assert_eq!(complete.bytes, FlashRecord::blank().bytes);
        assert_eq!(complete.begun_ns, [1_000]);
        let incomplete = after(1_000 + ERASE_NS - 1).bytes;
        assert!(incomplete != complete.bytes && incomplete != record.bytes);
        assert_eq!(incomplete[SLOT_BYTES..], complete.bytes[SLOT_BYTES..]);
    }
}
