//! Transfers with the compass between two bursts.
//!
//! The attitude task requests a transfer after a burst. A read takes the steps of a burst, with the
//! compass's address and other memory. A write takes its own: START, address, register, value,
//! STOP. An address without acknowledge costs nothing else. A compass that stops the bus costs what
//! any bus fault costs: the bus is recovered, and the sensor's settings are read back.

use core::cell::UnsafeCell;
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, compiler_fence};

use super::{
    BurstReader, Transaction, dma, enable_event_interrupts, i2c1, mask_unexpected_event, send_stop,
};
use crate::board::timebase;
use crate::compass::{Bytes, LONGEST_READ, Outcome, Transfer};
use crate::fault::{BurstFault, BurstStep};
use crate::health::BoardFlags;

/// Longest duration of a transfer, in µs: the longest takes 300 µs, and the next edge comes 600
/// µs after the burst before.
const DEADLINE_US: u32 = 500;

/// State of the slot: none, or stages of one transfer.
const FREE: u8 = 0;
const REQUESTED: u8 = 1;
const RUNNING: u8 = 2;
const READ: u8 = 3;
const WRITTEN: u8 = 4;
const NO_ANSWER: u8 = 5;
const HUNG: u8 = 6;

/// Transfer, its bytes, and its start.
struct TransferSlot {
    state: AtomicU8,
    started_us: AtomicU32,
    transfer: UnsafeCell<Transfer>,
    bytes: UnsafeCell<Bytes>,
}

// SAFETY: the state gives the transfer and the bytes to one side at a time: to the attitude task
// while it is `FREE` or shows an outcome, to the reader and DMA while it is `REQUESTED` or
// `RUNNING`.
unsafe impl Sync for TransferSlot {}

static TRANSFER_SLOT: TransferSlot = TransferSlot {
    state: AtomicU8::new(FREE),
    started_us: AtomicU32::new(0),
    transfer: UnsafeCell::new(Transfer::Read {
        address: 0,
        register: 0,
        length: 2,
    }),
    bytes: UnsafeCell::new([0; LONGEST_READ]),
};

/// True if bursts have to be flagged with [`BoardFlags::COMPASS_FAULT`].
static HAS_FAULT: AtomicBool = AtomicBool::new(false);

/// Flags bursts with [`BoardFlags::COMPASS_FAULT`] from the next transfer or check on.
pub fn set_compass_fault(has_fault: bool) {
    HAS_FAULT.store(has_fault, Ordering::Relaxed);
}

/// Port of the attitude task to the transfers. There is one.
pub struct CompassTransfers(());

impl CompassTransfers {
    /// Creates the port.
    pub const fn new() -> Self {
        Self(())
    }

    /// Returns whether the outcome of each requested transfer has been taken.
    pub fn is_free(&self) -> bool {
        TRANSFER_SLOT.state.load(Ordering::Relaxed) == FREE
    }

    /// Requests a transfer. Only while the slot [is free](Self::is_free).
    pub fn request(&mut self, transfer: Transfer) {
        // SAFETY: the state is `FREE`, so the reader does not look at the transfer.
        unsafe { *TRANSFER_SLOT.transfer.get() = transfer };
        compiler_fence(Ordering::Release);
        TRANSFER_SLOT.state.store(REQUESTED, Ordering::Relaxed);
        super::request_transaction();
    }

    /// Takes the outcome of the transfer: `work` gets it, and the time of the transfer's start on
    /// the microsecond timer. `None` while there is no outcome.
    pub fn take<R>(&mut self, work: impl FnOnce(&Outcome<'_>, u32) -> R) -> Option<R> {
        let state = TRANSFER_SLOT.state.load(Ordering::Relaxed);
        compiler_fence(Ordering::Acquire);
        let outcome = match state {
            // SAFETY: the transfer has ended, so DMA does not write the bytes.
            READ => Outcome::Read(unsafe { &*TRANSFER_SLOT.bytes.get() }),
            WRITTEN => Outcome::Written,
            NO_ANSWER => Outcome::NoAnswer,
            HUNG => Outcome::Hung,
            REQUESTED => {
                // The bus was not free.
                super::request_transaction();
                return None;
            }
            _ => return None,
        };
        let result = work(&outcome, TRANSFER_SLOT.started_us.load(Ordering::Relaxed));
        compiler_fence(Ordering::Release);
        TRANSFER_SLOT.state.store(FREE, Ordering::Relaxed);
        Some(result)
    }
}

impl Default for CompassTransfers {
    fn default() -> Self {
        Self::new()
    }
}

impl BurstReader {
    /// Starts the requested transfer. Returns whether there is one.
    pub(super) fn start_transfer(&mut self) -> bool {
        let has_fault = HAS_FAULT.load(Ordering::Relaxed);
        self.latched_flags.set(BoardFlags::COMPASS_FAULT, has_fault);
        self.flags.set(BoardFlags::COMPASS_FAULT, has_fault);
        if TRANSFER_SLOT.state.load(Ordering::Relaxed) != REQUESTED {
            return false;
        }
        compiler_fence(Ordering::Acquire);
        let now = timebase::now();
        TRANSFER_SLOT.started_us.store(now, Ordering::Relaxed);
        TRANSFER_SLOT.state.store(RUNNING, Ordering::Relaxed);
        timebase::set_burst_alarm(now.wrapping_add(DEADLINE_US));
        // SAFETY: the state gives the transfer to the reader.
        match unsafe { *TRANSFER_SLOT.transfer.get() } {
            Transfer::Read {
                address,
                register,
                length,
            } => {
                self.transaction = Transaction::CompassRead;
                self.address_byte = address << 1;
                self.pointer = register;
                let length = u16::from(length).min(LONGEST_READ as u16);
                dma::prepare(TRANSFER_SLOT.bytes.get() as u32, length);
                self.send_start();
            }
            Transfer::Write { .. } => {
                self.transaction = Transaction::CompassWrite { events: 0 };
                self.send_start();
                self.step = BurstStep::Setting;
            }
        }
        true
    }

    /// Handles an I2C1 event of a write: START, address, register, value.
    #[cold]
    #[inline(never)]
    pub(super) fn on_write_event(&mut self) {
        // SAFETY: the state gives the transfer to the reader.
        let Transfer::Write {
            address,
            register,
            value,
        } = (unsafe { *TRANSFER_SLOT.transfer.get() })
        else {
            return;
        };
        let Transaction::CompassWrite { events } = &mut self.transaction else {
            return;
        };
        let i2c = i2c1();
        let status = i2c.sr1().read();
        match *events {
            0 if status.sb().bit() => i2c.dr().write(|w| w.dr().set(address << 1)),
            1 if status.addr().bit() => {
                i2c.sr2().read();
                i2c.dr().write(|w| w.dr().set(register))
            }
            2 if status.btf().bit() => i2c.dr().write(|w| w.dr().set(value)),
            3 if status.btf().bit() => {
                TRANSFER_SLOT.state.store(WRITTEN, Ordering::Release);
                self.leave_transfer();
                return;
            }
            _ => {
                mask_unexpected_event();
                return;
            }
        };
        *events += 1;
    }

    /// Ends a read. Bytes that came with a bus error do not count.
    pub(super) fn end_compass_read(&self) {
        let state = if self.is_suspect { NO_ANSWER } else { READ };
        TRANSFER_SLOT.state.store(state, Ordering::Release);
    }

    /// Handles a failed transfer. Returns true if the bus is free, and nothing else has to be done.
    pub(super) fn fail_transfer(&mut self, fault: BurstFault) -> bool {
        let is_bus_known = matches!(fault, BurstFault::NotAcknowledged | BurstFault::BusError);
        let state = if is_bus_known { NO_ANSWER } else { HUNG };
        TRANSFER_SLOT.state.store(state, Ordering::Release);
        if is_bus_known {
            enable_event_interrupts();
            dma::stop();
            self.leave_transfer();
        }
        is_bus_known
    }

    /// Stops the transfer, and returns to bursts. An edge that has come meanwhile is lost: such a
    /// transfer takes 100 µs, and the edge is 250 µs away or more at its end.
    fn leave_transfer(&mut self) {
        send_stop();
        self.return_to_bursts();
        if core::mem::take(&mut self.is_edge_waiting) {
            self.count_missed();
        }
        self.await_next_burst();
    }
}
