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

/// Step of a configuration. [`SLOT_MS`](super::SLOT_MS) pass after each, longer than any part
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
    /// Reads registers, and drops their bytes.
    Drop(Registers),
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

/// Facts of a chip that the session needs.
#[derive(Debug)]
pub(super) struct Facts {
    /// Registers that identify the part.
    pub(super) identification: Registers,
    /// First bytes of these registers in this part.
    pub(super) identity: &'static [u8],
    /// Steps that configure the part in any state, and read its settings back.
    pub(super) configuration: &'static [Step],
    /// A register with settings, and its value. The session reads it now and then.
    pub(super) setting: (u8, u8),
    /// Registers of a reading.
    pub(super) reading: Registers,
    /// Mean age of the field in a reading, µs: [`mean_age_us`].
    pub(super) mean_age_us: u32,
    /// Scale of the counts, µT.
    pub(super) ut_per_count: f32,
    /// Plan of the self-test; `None` if the part has none.
    pub(super) self_test: Option<&'static SelfTestPlan>,
}

/// Compass chip.
pub(super) trait Part: Sync {
    /// Returns the facts.
    fn facts(&self) -> &'static Facts;

    /// Returns the condition of a reading.
    fn status(&self, bytes: &Bytes) -> Status;

    /// Decodes a reading: counts along the registers' X, Y and Z.
    fn counts(&self, bytes: &Bytes) -> [i16; 3];

    /// Scales counts, with the factory trims: counts of equal sensitivity along X, Y and Z.
    fn adjust(&self, counts: [i16; 3], _trims: [u8; 3]) -> [f32; 3] {
        counts.map(f32::from)
    }

    /// Rotates a vector from the registers' axes to those of the [module](super).
    fn to_module_axes(&self, vector: Vector3) -> Vector3 {
        vector
    }

    /// Returns whether these bytes are the part's identity.
    fn is_identity(&self, bytes: &Bytes) -> bool {
        bytes.starts_with(self.facts().identity)
    }

    /// Converts adjusted counts to µT along the axes of the [module](super).
    fn field_ut(&self, [x, y, z]: [f32; 3]) -> Vector3 {
        self.to_module_axes(Vector3::new(x, y, z).scale(self.facts().ut_per_count))
    }
}

/// Returns the mean age of the field in a reading, µs: half a period of the chip, because a
/// reading begins at any time in it, and half a measurement.
pub(super) const fn mean_age_us(period_us: u32, measurement_us: u32) -> u32 {
    (period_us + measurement_us) / 2
}

/// Decodes three little-endian counts.
pub(super) const fn little_endian([xl, xh, yl, yh, zl, zh]: [u8; 6]) -> [i16; 3] {
    [
        i16::from_le_bytes([xl, xh]),
        i16::from_le_bytes([yl, yh]),
        i16::from_le_bytes([zl, zh]),
    ]
}
