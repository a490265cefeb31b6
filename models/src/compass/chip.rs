//! A compass chip by its registers: the boundary between the parts and the bus.

use crate::motion::geometry::Vector;

/// A measurement to be made.
pub struct Conversion<'a> {
    /// The field along the axes that are printed on the part, µT.
    pub field_ut: Vector,
    /// Draws a standard normal deviate.
    pub normal: &'a mut dyn FnMut() -> f64,
    /// True if the result does not reach the data registers.
    pub is_frozen: bool,
    /// True if the measurement is never reported.
    pub is_never_ready: bool,
}

/// A chip by its registers.
pub trait Chip: Send {
    /// The 7-bit bus address.
    fn address(&self) -> u8;

    /// Time from the supply to usable registers.
    fn start_up_ns(&self) -> u64;

    /// The register after this one, as the address pointer moves.
    fn next(&self, register: u8) -> u8 {
        register.wrapping_add(1)
    }

    /// The value of a register, with what reading it does.
    fn read(&mut self, register: u8) -> u8;

    /// A value for a register.
    fn write(&mut self, register: u8, value: u8, now_ns: u64);

    /// Returns true for data and status registers.
    fn is_output(&self, register: u8) -> bool;

    /// Returns true for the registers that identify the part.
    fn is_identity(&self, register: u8) -> bool;

    /// The end of the next measurement.
    fn next_conversion_ns(&self) -> Option<u64>;

    /// Ends the measurement that is due.
    fn convert(&mut self, conversion: &mut Conversion<'_>);
}

/// Rounds to counts within limits; the flag tells that they were exceeded.
pub fn to_counts(value: f64, lowest: i16, highest: i16) -> (i16, bool) {
    let rounded = value.round();
    let is_beyond = rounded < f64::from(lowest) || rounded > f64::from(highest);
    (
        rounded.clamp(f64::from(lowest), f64::from(highest)) as i16,
        is_beyond,
    )
}
