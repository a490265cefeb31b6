//! Sine and cosine of the rotors' angles, with the bits of [`libm::sincos`] in a fraction of its
//! time.
//!
//! A rotor turns through 500 rad each second. After an hour its angle is beyond 2²⁰·π/2, where
//! libm's reduction to ±π/4 takes ten times as long. The reductions here are those of libm for
//! angles from 8 to 2³¹ rad, in a straight line. Everything else goes to libm.
//!
//! Derived from FreeBSD's msun (`e_rem_pio2.c`, `k_rem_pio2.c`, `k_sin.c` and `k_cos.c`):
//!
//! > Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved.
//! >
//! > Developed at SunPro, a Sun Microsystems, Inc. business. Permission to use, copy, modify, and
//! > distribute this software is freely granted, provided that this notice is preserved.

use std::f64::consts::FRAC_2_PI;

/// Smallest angle that is reduced here.
const LEAST: f64 = 8.0;

/// Angles from about 2²⁰·π/2 on need more digits of π.
const LARGE: f64 = f64::from_bits(0x4139_21fb_0000_0000);

/// Angles from here on go to libm.
const LIMIT: f64 = 2_147_483_648.0;

/// An angle less `quadrant` times π/2, as a sum of two numbers.
#[derive(Clone, Copy)]
struct Reduced {
    quadrant: u32,
    head: f64,
    tail: f64,
}

/// Returns sines and cosines of some angles, rad, bit for bit those of [`libm::sincos`].
#[must_use]
#[inline]
pub fn sines_and_cosines<const N: usize>(angles_rad: &[f64; N]) -> [(f64, f64); N] {
    let mut reduced = [Reduced {
        quadrant: 0,
        head: 0.0,
        tail: 0.0,
    }; N];
    for (reduced, angle) in reduced.iter_mut().zip(angles_rad) {
        match reduce(*angle) {
            Some(result) => *reduced = result,
            None => return angles_rad.map(libm::sincos),
        }
    }
    let (mut sines, mut cosines) = ([0.0; N], [0.0; N]);
    for index in 0..N {
        sines[index] = sine(reduced[index].head, reduced[index].tail);
        cosines[index] = cosine(reduced[index].head, reduced[index].tail);
    }
    let mut results = [(0.0, 0.0); N];
    for index in 0..N {
        results[index] = in_quadrant(reduced[index].quadrant, sines[index], cosines[index]);
    }
    results
}

/// Returns sine and cosine of an angle from those of the angle less `quadrant` times π/2.
#[inline]
fn in_quadrant(quadrant: u32, sine: f64, cosine: f64) -> (f64, f64) {
    let (first, second) = if quadrant & 1 == 0 {
        (sine, cosine)
    } else {
        (cosine, sine)
    };
    let sign = |quadrant: u32| u64::from(quadrant & 2) << 62;
    (
        f64::from_bits(first.to_bits() ^ sign(quadrant)),
        f64::from_bits(second.to_bits() ^ sign(quadrant.wrapping_add(1))),
    )
}

/// Reduces an angle to ±π/4, or leaves it to libm.
#[inline]
fn reduce(angle: f64) -> Option<Reduced> {
    if (LEAST..LARGE).contains(&angle) {
        reduce_medium(angle)
    } else if (LARGE..LIMIT).contains(&angle) {
        reduce_large(angle)
    } else {
        None
    }
}

/// Reduces an angle below 2²⁰·π/2 with 85 or 118 bits of π/2, unless that cancels too many of
/// them.
#[inline]
#[expect(clippy::excessive_precision, reason = "the digits are those of msun")]
fn reduce_medium(angle: f64) -> Option<Reduced> {
    /// Adding this rounds to an integer.
    const TO_INTEGER: f64 = 1.5 / f64::EPSILON;
    /// First 33 bits of π/2, and its rest.
    const FIRST: f64 = 1.570_796_326_734_125_614_17e+00;
    const FIRST_REST: f64 = 6.077_100_506_506_192_249_32e-11;
    /// Second 33 bits of π/2, and its rest.
    const SECOND: f64 = 6.077_100_506_303_965_976_60e-11;
    const SECOND_REST: f64 = 2.022_266_248_795_950_631_54e-21;
    /// Binary digits that may cancel with the rest of the first and of the second 33 bits.
    const CANCELLED: [u64; 2] = [16, 49];

    let turns = angle * FRAC_2_PI + TO_INTEGER - TO_INTEGER;
    let mut difference = angle - turns * FIRST;
    let mut rest = turns * FIRST_REST;
    let mut head = difference - rest;
    if exponent(angle) > exponent(head) + CANCELLED[0] {
        let before = difference;
        let second = turns * SECOND;
        difference = before - second;
        rest = turns * SECOND_REST - ((before - difference) - second);
        head = difference - rest;
        if exponent(angle) > exponent(head) + CANCELLED[1] {
            return None;
        }
    }
    Some(Reduced {
        quadrant: turns as u32,
        head,
        tail: (difference - head) - rest,
    })
}

/// Reduces an angle from 2²⁰·π/2 to 2³¹ rad.
///
/// The product of angle and 2/π is an integer with 96 bits more than the digits that decide. Its
/// fraction, in digits of 24 bits, is multiplied by π/2.
#[inline]
#[expect(clippy::excessive_precision, reason = "the digits are those of msun")]
fn reduce_large(angle: f64) -> Option<Reduced> {
    /// 2/π, in digits of 24 bits.
    const TWO_OVER_PI: [u64; 5] = [0xA2_F983, 0x6E_4E44, 0x15_29FC, 0x27_57D1, 0xF5_34DD];
    /// π/2, in pieces of 24 bits.
    const HALF_PI: [f64; 5] = [
        1.570_796_251_296_997_070_31e+00,
        7.549_789_415_861_596_353_35e-08,
        5.390_302_529_957_764_765_54e-15,
        3.282_003_415_807_912_941_23e-22,
        1.270_655_753_080_676_073_49e-29,
    ];
    /// Places of the fraction's digits below the highest: 2 above the 96 bits, and 4.
    const DIGITS: usize = 6;

    let mantissa = (angle.to_bits() & ((1 << 52) - 1)) | 1 << 52;
    let [first, second, third] = [
        mantissa >> 29,
        mantissa >> 5 & 0xFF_FFFF,
        mantissa << 19 & 0xFF_FFFF,
    ];
    let two_over_pi = TWO_OVER_PI;
    let products = [
        first * two_over_pi[0],
        first * two_over_pi[1] + second * two_over_pi[0],
        first * two_over_pi[2] + second * two_over_pi[1] + third * two_over_pi[0],
        first * two_over_pi[3] + second * two_over_pi[2] + third * two_over_pi[1],
        first * two_over_pi[4] + second * two_over_pi[3] + third * two_over_pi[2],
    ];
    // What is lost at the top is a multiple of 8 quadrants.
    let product = products.iter().fold(0_u128, |sum, product| {
        (sum << 24).wrapping_add(u128::from(*product))
    });
    // Between 17 and 27 bits of the fraction lie above the lower 96.
    let upper_bits = 1023 + 47 - exponent(angle);
    let one = 1_u128 << (96 + upper_bits);
    let mut quadrant = (product >> (96 + upper_bits)) as u32;
    let mut fraction = product & (one - 1);
    let is_upper_half = fraction >= one / 2;
    if is_upper_half {
        quadrant = quadrant.wrapping_add(1);
        fraction = one - fraction;
    }
    if fraction >> 96 == 0 {
        return None;
    }
    // 2^(24 − upper_bits)
    let mut unit = f64::from_bits((1023 + 24 - upper_bits) << 52);
    let mut digits = [0.0; DIGITS];
    for (index, digit) in digits.iter_mut().enumerate() {
        *digit = unit * f64::from((fraction >> (120 - 24 * index)) as u32 & 0xFF_FFFF);
        unit *= f64::from_bits((1023 - 24) << 52);
    }
    let mut sums = [0.0; DIGITS];
    for (index, sum) in sums.iter_mut().enumerate() {
        for (place, piece) in HALF_PI.iter().enumerate().take(index + 1) {
            *sum += piece * digits[index - place];
        }
    }
    let head = sums.iter().rev().fold(0.0, |sum, value| sum + value);
    let tail = sums[1..]
        .iter()
        .fold(sums[0] - head, |sum, value| sum + value);
    let sign = if is_upper_half { -1.0 } else { 1.0 };
    Some(Reduced {
        quadrant,
        head: sign * head,
        tail: sign * tail,
    })
}

/// Returns the exponent of a positive number as it is stored.
#[inline]
fn exponent(value: f64) -> u64 {
    value.to_bits() >> 52 & 0x7FF
}

/// Returns the sine of `x + y`, for sums within ±π/4.
#[inline]
#[expect(clippy::excessive_precision, reason = "the digits are those of msun")]
fn sine(x: f64, y: f64) -> f64 {
    const S1: f64 = -1.666_666_666_666_663_243_48e-01;
    const S2: f64 = 8.333_333_333_322_489_461_24e-03;
    const S3: f64 = -1.984_126_982_985_794_931_34e-04;
    const S4: f64 = 2.755_731_370_707_006_767_89e-06;
    const S5: f64 = -2.505_076_025_340_686_341_95e-08;
    const S6: f64 = 1.589_690_995_211_550_102_21e-10;

    let z = x * x;
    let w = z * z;
    let r = S2 + z * (S3 + z * S4) + z * w * (S5 + z * S6);
    let v = z * x;
    x - ((z * (0.5 * y - v * r) - y) - v * S1)
}

/// Returns the cosine of `x + y`, for sums within ±π/4.
#[inline]
#[expect(clippy::excessive_precision, reason = "the digits are those of msun")]
fn cosine(x: f64, y: f64) -> f64 {
    const C1: f64 = 4.166_666_666_666_660_190_37e-02;
    const C2: f64 = -1.388_888_888_887_410_957_49e-03;
    const C3: f64 = 2.480_158_728_947_672_941_78e-05;
    const C4: f64 = -2.755_731_435_139_066_330_35e-07;
    const C5: f64 = 2.087_572_321_298_174_827_90e-09;
    const C6: f64 = -1.135_964_755_778_819_482_65e-11;

    let z = x * x;
    let w = z * z;
    let r = z * (C1 + z * (C2 + z * C3)) + w * w * (C4 + z * (C5 + z * C6));
    let half = 0.5 * z;
    let w = 1.0 - half;
    w + (((1.0 - w) - half) + (z * r - x * y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;

    /// Asserts that four angles give the bits of libm.
    fn check(angles: [f64; 4]) {
        let ours = sines_and_cosines(&angles);
        for (angle, ours) in angles.iter().zip(ours) {
            let (sine, cosine) = libm::sincos(*angle);
            let bits = [ours.0.to_bits(), ours.1.to_bits()];
            assert_eq!(bits, [sine.to_bits(), cosine.to_bits()], "{angle:e}");
        }
    }

    #[test]
    fn every_angle_has_the_bits_of_libm() {
        let mut random = Random::new(1, "sines");
        for _ in 0..500_000 {
            check(
                [(-1.0, 3.0), (2.0, 6.5), (6.2, 7.2), (7.0, 9.6)].map(|(low, high)| {
                    let size = libm::pow(10.0, random.uniform(low, high));
                    if random.uniform(0.0, 100.0) < 1.0 {
                        -size
                    } else {
                        size
                    }
                }),
            );
        }
    }

    #[test]
    fn angles_beside_multiples_of_half_pi_have_the_bits_of_libm() {
        let mut random = Random::new(2, "sines");
        for _ in 0..200_000 {
            let [medium, large] = [1e6, 1.3e9].map(|limit| random.uniform(5.0, limit).floor());
            check([medium, medium + 0.5, large, large + 0.5].map(|turns| {
                let angle = turns * std::f64::consts::FRAC_PI_2;
                f64::from_bits(angle.to_bits() + (random.uniform(0.0, 8.0) as u64))
            }));
        }
    }

    #[test]
    fn the_limits_of_the_reductions_have_the_bits_of_libm() {
        for limit in [LEAST, LARGE, LIMIT, 1_048_576.0, 2_097_152.0, 1e9] {
            let bits = limit.to_bits();
            check([bits - 2, bits - 1, bits, bits + 1].map(f64::from_bits));
        }
        check([0.0, -0.0, 1e300, 8.0]);
    }

    #[test]
    fn ordinary_angles_are_reduced_here() {
        for angle in [8.0, 1234.5, 1.6e6, 1.7e6, 3.3e6, 1e7, 4.3e7, 3e8, 2.1e9] {
            assert!(reduce(angle).is_some(), "{angle}");
        }
    }
}
