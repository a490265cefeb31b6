//! Arithmetic of the filters' numbers.

/// Returns the square.
#[inline]
pub(crate) const fn square(number: f32) -> f32 {
    number * number
}

/// Returns the smaller number, and `limit` for a NaN. `f32::min` checks both numbers for NaN, which
/// takes five more instructions.
#[inline]
pub(crate) const fn smaller(number: f32, limit: f32) -> f32 {
    if number < limit { number } else { limit }
}

/// Returns the larger number, and `limit` for a NaN.
#[inline]
pub(crate) const fn larger(number: f32, limit: f32) -> f32 {
    if number > limit { number } else { limit }
}
