//! The chip's end of an I2C transaction: register pointer, data held still during it, bursts as
//! they were delivered.

use super::registers::{DATA_LENGTH, address};

/// The 14 data registers of one sample.
#[derive(Clone, Copy, Debug, Default)]
pub struct DataRegisters {
    /// ACCEL_XOUT_H to GYRO_ZOUT_L.
    pub bytes: [u8; DATA_LENGTH],
    /// The data-ready edge that announced this sample, if one did.
    pub edge: Option<u64>,
}

impl DataRegisters {
    /// Puts a big-endian value at `offset` from ACCEL_XOUT_H.
    pub fn put(&mut self, offset: usize, value: i16) {
        self.bytes[offset..offset + 2].copy_from_slice(&value.to_be_bytes());
    }
}

/// A complete read of the 14 data registers in one transaction, as the bus delivered it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Burst {
    /// Index of the data-ready edge whose sample this is; `None` if the sample raised no edge.
    pub edge: Option<u64>,
    /// ACCEL_XOUT_H to GYRO_ZOUT_L.
    pub bytes: [u8; DATA_LENGTH],
    /// Time of delivery of the last byte, ns since power-up.
    pub completed_ns: u64,
}

/// The state of the transaction.
#[derive(Clone, Debug, Default)]
pub struct Bus {
    /// From the start condition that addressed the chip to the stop condition.
    pub busy: bool,
    /// The next written byte is the register pointer.
    pub pointer_expected: bool,
    /// The register that the next byte is for.
    pub pointer: u8,
    collected: usize,
    bytes: [u8; DATA_LENGTH],
}

impl Bus {
    /// A start condition addressed the chip.
    pub fn start(&mut self, read: bool) {
        self.busy = true;
        self.pointer_expected = !read;
        self.collected = 0;
    }

    /// A stop condition, or a start condition for another chip.
    pub fn release(&mut self) {
        self.busy = false;
        self.pointer_expected = false;
        self.collected = 0;
    }

    /// Moves the pointer to the next register; the FIFO's port is the one register that stays
    /// (section 4.31).
    pub fn advance_pointer(&mut self) {
        if self.pointer != address::FIFO_R_W {
            self.pointer = self.pointer.wrapping_add(1);
        }
    }

    /// Notes that `value` was delivered from `register`. Gives the 14 bytes when they are complete.
    pub fn delivered(&mut self, register: u8, value: u8) -> Option<[u8; DATA_LENGTH]> {
        let offset = usize::from(register.wrapping_sub(address::ACCEL_XOUT_H));
        if offset == self.collected && offset < DATA_LENGTH {
            self.bytes[offset] = value;
            self.collected += 1;
            return (self.collected == DATA_LENGTH).then_some(self.bytes);
        }
        None
    }
}
