//! Table of the supported chips.

use super::ak8963::Ak8963;
use super::hmc5883l::Hmc5883l;
use super::part::Part;
use super::qmc5883l::Qmc5883l;
use super::qmc5883p::Qmc5883p;

/// Supported chip.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum PartId {
    /// AK8963, inside an MPU-9250 or MPU-9255.
    Ak8963,
    /// QMC5883L. Many are sold as HMC5883L; the chip is marked 5883L or DB5883.
    Qmc5883l,
    /// QMC5883P, the successor of the QMC5883L.
    Qmc5883p,
    /// HMC5883L, and its clone that is marked DA5883.
    Hmc5883l,
}

impl PartId {
    /// Every part, in the order of the search. An early QMC5883L also answers at the HMC5883L's
    /// address with its identity, so the search asks there last.
    pub const ALL: [Self; 4] = [Self::Ak8963, Self::Qmc5883l, Self::Qmc5883p, Self::Hmc5883l];

    /// Returns the name in lower case, as a command takes it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Ak8963 => "ak8963",
            Self::Qmc5883l => "qmc5883l",
            Self::Qmc5883p => "qmc5883p",
            Self::Hmc5883l => "hmc5883l",
        }
    }

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Ak8963 => "AK8963",
            Self::Qmc5883l => "QMC5883L",
            Self::Qmc5883p => "QMC5883P",
            Self::Hmc5883l => "HMC5883L",
        }
    }

    /// Returns the bus address, 7 bits.
    pub fn address(self) -> u8 {
        self.part().address()
    }

    pub(super) const fn part(self) -> &'static dyn Part {
        match self {
            Self::Ak8963 => &Ak8963,
            Self::Qmc5883l => &Qmc5883l,
            Self::Qmc5883p => &Qmc5883p,
            Self::Hmc5883l => &Hmc5883l,
        }
    }
}
