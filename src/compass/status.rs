//! Status of the compass, for people.

use super::fault::Fault;
use crate::attitude::Vector3;
use crate::units::MagneticField;

/// Status of the compass: part, fault and latest field.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CompassStatus {
    /// Name and bus address, once a compass has shown its identity.
    pub part: Option<(&'static str, u8)>,
    /// Reason why there are no readings.
    pub fault: Option<Fault>,
    /// Latest field, calibrated; `None` without readings.
    pub field: Option<MagneticField>,
    /// Hard iron that the heading filter has found, µT in body axes, beyond the calibration's;
    /// `None` until it is certain.
    pub hard_iron_ut: Option<Vector3>,
}
