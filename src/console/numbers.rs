//! Numbers in commands: digits and nothing else, except where a command takes a sign or decimals.

use core::ops::RangeInclusive;

/// Parses digits, and nothing else.
pub(super) fn number(text: &str) -> Option<u32> {
    let is_number = text.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { text.parse().ok() } else { None }
}

/// Parses nine elements of a matrix in this range, with commas between them.
pub(super) fn elements(text: &str, range: RangeInclusive<i16>) -> Option<[i16; 9]> {
    let mut elements = [0; 9];
    let mut rest = text;
    for (index, element) in elements.iter_mut().enumerate() {
        let (word, others) = match index {
            8 => (rest, ""),
            _ => rest.split_once(',')?,
        };
        let size = i16::try_from(number(word.strip_prefix('-').unwrap_or(word))?).ok()?;
        *element = if word.starts_with('-') { -size } else { size };
        if !range.contains(element) {
            return None;
        }
        rest = others;
    }
    Some(elements)
}

/// Parses degrees with up to two decimals, as hundredths of a degree.
pub(super) fn centidegrees(text: &str) -> Option<i16> {
    let size = text.strip_prefix(['-', '+']).unwrap_or(text);
    let (whole, decimals) = size.split_once('.').unwrap_or((size, "0"));
    let unit = match decimals.len() {
        1 => 10,
        2 => 1,
        _ => return None,
    };
    let hundredths = number(whole)?.checked_mul(100)?;
    let hundredths = hundredths.checked_add(number(decimals)? * unit)?;
    let size = i16::try_from(hundredths).ok()?;
    Some(if text.starts_with('-') { -size } else { size })
}

/// Returns the rate of these that is within a tenth of this one.
pub(super) fn nearest_rate(rate: u32, rates: &[u32]) -> Option<u32> {
    let is_near = |known: &&u32| known.abs_diff(rate) <= **known / 10;
    rates.iter().find(is_near).copied()
}
