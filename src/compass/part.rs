//! A compass chip: registers, identity, settings, decoding. One file per chip implements the trait.

use crate::attitude::Vector3;

/// Length of the longest read, bytes.
pub const LONGEST_READ: usize = 9;

/// Bytes of a read; those beyond its length are meaningless.
pub type Bytes = [u8; LONGEST_READ];

/// Neighbouring registers that are read together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Registers {
    /// Address of the first register.
    pub(super) first: u8,
    /// Number of registers: two or more, as a transfer by DMA needs.
    pub(super) length: u8,
}

impl Registers {
    pub(super) const fn new(first: u8, length: u8) -> Self {
        Self { first, length }
    }
}

/// Step of a configuration. [`TURN_MS`](super::TURN_MS) pass after each, longer than any part
/// needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// Writes a value to a register.
    Write(u8, u8),
    /// Reads a register back, which must hold this value.
    Verify(u8, u8),
    /// Reads three factory trims from this register on.
    Trim(u8),
    /// Reads a status register, in which a genuine part has set this bit.
    Genuine(u8, u8),
}

/// Condition of a reading, by the part's status.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Status {
    /// The reading is new.
    Ready,
    /// No new reading.
    NotReady,
    /// The field exceeds the range.
    Overflow,
    /// The bytes are none that the part can send.
    Garbled,
}

/// Plan of a self-test: the part makes a field of its own and measures it.
#[derive(Debug)]
pub(super) struct SelfTestPlan {
    /// Steps that start the test.
    pub(super) steps: &'static [Step],
    /// Lowest and highest response of each axis, counts.
    pub(super) limits: [[f32; 2]; 3],
}

/// Compass chip.
pub(super) trait Part: Sync {
    /// Returns the bus address, 7 bits.
    fn address(&self) -> u8;

    /// Returns the registers that identify the part.
    fn identity(&self) -> Registers;

    /// Returns whether these bytes are the part's identity.
    fn is_identity(&self, bytes: &Bytes) -> bool;

    /// Returns the steps that configure the part in any state, and read its settings back.
    fn configuration(&self) -> &'static [Step];

    /// Returns a register with settings, and its value. The session reads it now and then.
    fn setting(&self) -> (u8, u8);

    /// Returns the registers of a reading.
    fn reading(&self) -> Registers;

    /// Returns the condition of a reading.
    fn status(&self, bytes: &Bytes) -> Status;

    /// Returns the mean age of the field in a reading, µs: half a period of the chip, and half a
    /// measurement.
    fn mean_age_us(&self) -> u32;

    /// Decodes a reading: counts along the registers' X, Y and Z.
    fn counts(&self, bytes: &Bytes) -> [i16; 3];

    /// Scales counts, with the factory trims: counts of equal sensitivity along X, Y and Z.
    fn adjust(&self, counts: [i16; 3], _trims: [u8; 3]) -> [f32; 3] {
        counts.map(f32::from)
    }

    /// Converts adjusted counts to µT along the axes of the [module](super).
    fn field_ut(&self, counts: [f32; 3]) -> Vector3;

    /// Returns the plan of the self-test; `None` if the part has none.
    fn self_test(&self) -> Option<&'static SelfTestPlan> {
        None
    }
}

/// Decodes three little-endian counts.
pub(super) const fn little_endian([xl, xh, yl, yh, zl, zh]: [u8; 6]) -> [i16; 3] {
    [
        i16::from_le_bytes([xl, xh]),
        i16::from_le_bytes([yl, yh]),
        i16::from_le_bytes([zl, zh]),
    ]
}
