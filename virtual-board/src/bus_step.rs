//! The steps of a transfer on the sensor's bus, as a campaign counts them.

/// A step of a transfer on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum BusStep {
    /// No transfer.
    Idle,
    /// The controller has requested or made a START.
    Start,
    /// The address for writing is on the wire.
    AddressWrite,
    /// A byte for the sensor is on the wire, or has been acknowledged.
    Written,
    /// The address for reading is on the wire.
    AddressRead,
    /// The byte of this number is on the wire, from 1 on; 14 is also all that follows.
    Read(u8),
}

impl BusStep {
    /// The number of the last byte of a burst.
    pub const LAST_BYTE: u8 = 14;

    /// All steps.
    pub fn all() -> impl Iterator<Item = Self> {
        let first = [
            Self::Idle,
            Self::Start,
            Self::AddressWrite,
            Self::Written,
            Self::AddressRead,
        ];
        first
            .into_iter()
            .chain((1..=Self::LAST_BYTE).map(Self::Read))
    }

    /// Returns the name, of five characters at most.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Idle => "idle".into(),
            Self::Start => "start".into(),
            Self::AddressWrite => "adr+w".into(),
            Self::Written => "write".into(),
            Self::AddressRead => "adr+r".into(),
            Self::Read(byte) => format!("rd{byte}"),
        }
    }
}
