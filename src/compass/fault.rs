//! Reasons why a compass gives no readings, with the remedy in their text.

use core::fmt;

use super::part_id::PartId;

/// Reason why there are no readings of the compass.
///
/// ```
/// use aplomb::compass::Fault;
///
/// assert!(Fault::Overflow.to_string().contains("magnet"));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Fault {
    /// No chip acknowledges the address.
    Absent(PartId),
    /// A chip of another kind answers at the address.
    WrongIdentity {
        /// Bus address, 7 bits.
        address: u8,
        /// Bytes of the identity registers.
        identity: [u8; 3],
    },
    /// The named compass is absent, and this one is there.
    Other {
        /// Named part.
        named: PartId,
        /// Part that answers.
        found: PartId,
    },
    /// The compass no longer acknowledges.
    Lost(PartId),
    /// A register does not keep its setting.
    Settings {
        /// Part.
        part: PartId,
        /// Address of the register.
        register: u8,
        /// Value written.
        written: u8,
        /// Value read.
        read: u8,
    },
    /// The factory's sensitivity adjustments are impossible.
    Trim([u8; 3]),
    /// The compass has acknowledged, but reports no measurement.
    NeverReady,
    /// The readings repeat to the last bit.
    Frozen,
    /// All bytes are the same, as on a stuck bus.
    Blank,
    /// The field exceeds the range.
    Overflow,
    /// The bytes are none that the part can send.
    Garbled,
    /// The bus stopped during a transfer with the compass.
    HoldsBus,
}

impl Fault {
    /// Returns the name in one word, for `status`.
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Absent(_) => "absent",
            Self::WrongIdentity { .. } => "unknown-chip",
            Self::Other { .. } => "other-part",
            Self::Lost(_) => "lost",
            Self::Settings { .. } => "settings",
            Self::Trim(_) => "trim",
            Self::NeverReady => "never-ready",
            Self::Frozen => "frozen",
            Self::Blank => "blank",
            Self::Overflow => "overflow",
            Self::Garbled => "garbled",
            Self::HoldsBus => "holds-bus",
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Absent(part) => write!(
                formatter,
                "no {} answers at 0x{:02x}: check its wiring and supply, or \"compass auto\"",
                part.name(),
                part.address()
            ),
            Self::WrongIdentity {
                address,
                identity: [a, b, c],
            } => write!(
                formatter,
                "the chip at 0x{address:02x} is no known compass, its identity is \
                 {a:02x} {b:02x} {c:02x}: \"compass off\" ignores it"
            ),
            Self::Other { named, found } => write!(
                formatter,
                "no {} answers, but a {}: boards are often sold under another part's name; \
                 \"compass {}\" uses it",
                named.name(),
                found.name(),
                found.word()
            ),
            Self::Lost(part) => write!(
                formatter,
                "the {} does not answer any more: check its wiring and supply",
                part.name()
            ),
            Self::Settings {
                part,
                register,
                written,
                read,
            } => write!(
                formatter,
                "the {} did not keep register 0x{register:02x}: wrote 0x{written:02x}, \
                 read 0x{read:02x}: check its supply",
                part.name()
            ),
            Self::Trim([x, y, z]) => write!(
                formatter,
                "the AK8963's sensitivity adjustment reads {x:02x} {y:02x} {z:02x}: \
                 switch the power off and on"
            ),
            Self::NeverReady => {
                formatter.write_str("it reports no measurement: configuring it again")
            }
            Self::Frozen => {
                formatter.write_str("its readings repeat to the last bit: configuring it again")
            }
            Self::Blank => formatter.write_str(
                "all its bytes are equal: check its wiring and supply; configuring it again",
            ),
            Self::Overflow => formatter.write_str(
                "the field exceeds its range: move it away from the magnet or the motor",
            ),
            Self::HoldsBus => formatter.write_str(
                "it has stopped the bus, and is left alone for a while: check its wiring and \
                 supply, or \"compass off\"",
            ),
            Self::Garbled => formatter.write_str(
                "its bytes are impossible: check the wiring and the pull-ups; configuring it again",
            ),
        }
    }
}

impl core::error::Error for Fault {}
