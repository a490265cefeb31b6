//! Self-test: the part makes a field of its own, and measures it within limits.

use core::fmt;

use super::part_id::PartId;

/// Result of a compass's self-test.
///
/// ```
/// use aplomb::compass::{PartId, SelfTest};
///
/// let limits = [[-200.0, 200.0], [-200.0, 200.0], [-3200.0, -800.0]];
/// let test = SelfTest { part: PartId::Ak8963, response: Some(([12.0, -4.0, -1900.0], limits)) };
/// assert_eq!(test.has_passed(), Some(true));
/// assert!(test.to_string().starts_with("compass passed"));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct SelfTest {
    /// Part.
    pub part: PartId,
    /// Response of each axis, and its limits, counts; `None` if the part has no self-test, or none
    /// with limits in its datasheet.
    pub response: Option<([f32; 3], [[f32; 2]; 3])>,
}

impl SelfTest {
    /// Returns whether each axis is within its limits; `None` if the part has no self-test.
    pub fn has_passed(&self) -> Option<bool> {
        let (response, limits) = self.response?;
        let mut axes = response.into_iter().zip(limits);
        Some(axes.all(|(response, [low, high])| (low..=high).contains(&response)))
    }
}

impl fmt::Display for SelfTest {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some((response, limits)) = self.response else {
            return write!(formatter, "a {} has no self-test", self.part.name());
        };
        formatter.write_str(match self.has_passed() {
            Some(false) => "compass FAILED:",
            _ => "compass passed:",
        })?;
        for ((axis, response), [low, high]) in ["x", "y", "z"].into_iter().zip(response).zip(limits)
        {
            let (response, low, high) = (response as i32, low as i32, high as i32);
            write!(formatter, " {axis} {response} in {low}..{high}")?;
        }
        Ok(())
    }
}
