//! Numbers as text: the shortest form that reads back as the same number, without an exponent.
//!
//! The text is that of `{}` in Rust's own formatting, at several times its speed.

use std::io::Write as _;

/// Appends `number` to `text`.
pub fn append(text: &mut Vec<u8>, number: f32) {
    let mut buffer = zmij::Buffer::new();
    if number.is_finite() {
        let shortest = buffer.format_finite(number);
        if !is_special(number, shortest) {
            let shortest = shortest.strip_suffix(".0").unwrap_or(shortest);
            text.extend_from_slice(shortest.as_bytes());
            return;
        }
    }
    // Rare, so its speed does not matter.
    write!(text, "{number}").expect("a vector takes everything");
}

/// Returns whether the standard library may write another text: with an exponent, or if there are
/// two shortest forms, equally near.
fn is_special(number: f32, shortest: &str) -> bool {
    let Some((_, decimals)) = shortest.split_once('.') else {
        return true;
    };
    if decimals.contains('e') {
        return true;
    }
    // Exact: 24 bits of the number and 28 of 5¹². Half way is an odd number of halves. With more
    // decimals a number of nine digits is too small to be half way.
    POWERS_OF_TEN.get(decimals.len()).is_some_and(|power| {
        let halves = f64::from(number) * power * 2.0;
        let whole = halves as i64;
        whole % 2 != 0 && whole as f64 == halves
    })
}

const POWERS_OF_TEN: [f64; 13] = [
    1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_is_that_of_the_standard_library() {
        let mut random = 1_u32;
        let edges = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            100.0,
            1e7,
            1.6777216e7,
            1e10,
            1e16,
            1e17,
            1e-3,
            1e-5,
            1e-6,
            1e-7,
            f32::MAX,
            f32::MIN_POSITIVE,
            1e-45,
            1.0e6,
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
        ];
        let any = (0..200_000).map(|_| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f32::from_bits(random)
        });
        // Numbers with few binary digits: half of them lie half way between two short forms.
        let short = (0..200_000_i32).map(|index| (index - 100_000) as f32 / 128.0);
        let small = (0..200_000_i32).map(|index| index as f32 * 1.1e-9);
        let tiny = (0..200_000_i32).map(|index| index as f32 / (1 << 24) as f32);
        let numbers = edges.into_iter().chain(any).chain(short);
        for number in numbers.chain(small).chain(tiny) {
            let mut text = Vec::new();
            append(&mut text, number);
            assert_eq!(String::from_utf8(text).unwrap(), format!("{number}"));
        }
    }
}
