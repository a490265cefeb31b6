//! Promise of `VALID`: a tilt is wrong by no more than the larger of 5° and six σ.
//!
//! A comparison with NaN is false, so each one here is written such that NaN breaks the promise.

/// Largest error of a valid tilt: the larger of this angle, degrees, and so many σ.
const ALLOWED_DEG: f64 = 5.0;
const ALLOWED_SIGMAS: f64 = 6.0;
/// Largest σ of a valid tilt, degrees. With more, six σ are half a turn, which promises nothing.
/// It has a margin for the rounding of `f32`.
const LARGEST_SIGMA_DEG: f64 = 30.0 * (1.0 + 1e-5);

/// Returns the largest error that the promise allows at this σ, degrees.
pub fn allowed_deg(sigma_deg: f64) -> f64 {
    larger(ALLOWED_DEG, ALLOWED_SIGMAS * sigma_deg)
}

/// Returns whether a valid tilt with this error and this σ, degrees, breaks the promise.
pub fn is_broken(error_deg: f64, sigma_deg: f64) -> bool {
    exceeds(error_deg, allowed_deg(sigma_deg)) || exceeds(sigma_deg, LARGEST_SIGMA_DEG)
}

/// Returns whether a number is larger than its limit. NaN is.
pub fn exceeds(number: f64, limit: f64) -> bool {
    let is_within = number <= limit;
    !is_within
}

/// Returns the larger number; NaN if one is NaN.
pub fn larger(first: f64, second: f64) -> f64 {
    if first.is_nan() || first >= second {
        first
    } else {
        second
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    #[test]
    fn a_promise_is_kept_up_to_its_limit_and_broken_by_nan() {
        let (nan, infinite) = (f64::NAN, f64::INFINITY);
        for (error_deg, sigma_deg) in [(5.0, 0.1), (12.0, 2.0), (170.0, 29.9)] {
            assert!(!is_broken(error_deg, sigma_deg), "{error_deg} {sigma_deg}");
        }
        for (error_deg, sigma_deg) in [
            (5.1, 0.1),
            (12.1, 2.0),
            (nan, 0.1),
            (1.0, nan),
            (nan, nan),
            (infinite, 29.0),
            (1.0, infinite),
            (1.0, 30.1),
        ] {
            assert!(is_broken(error_deg, sigma_deg), "{error_deg} {sigma_deg}");
        }
    }

    #[test]
    fn the_largest_number_is_nan_if_one_is() {
        let largest = |numbers: [f64; 3]| numbers.into_iter().fold(0.0, larger);
        assert_eq!(largest([1.0, PI, 2.0]), PI);
        for place in 0..3 {
            let mut numbers = [1.0; 3];
            numbers[place] = f64::NAN;
            assert!(largest(numbers).is_nan(), "{place}");
        }
    }
}
