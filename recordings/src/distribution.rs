//! Distribution of numbers that are not negative, in bounded memory.
//!
//! Up to half a million numbers are kept as they are. More are counted in bins whose width is
//! 1/4096 of the octave, so that a quantile is right to 0.02 %.

use std::collections::BTreeMap;

/// Most numbers that are kept as they are.
const MOST_EXACT: usize = 500_000;
/// Bits of a number below those that name its bin.
const BITS_IN_A_BIN: u32 = 52 - 12;

/// Numbers that are not negative; infinity may be among them.
#[derive(Clone, Debug, Default)]
pub struct Distribution {
    exact: Vec<f64>,
    /// Numbers in bins, by the first bits of the number: their order is that of the numbers.
    bins: BTreeMap<u64, usize>,
    /// Counts and sums of the numbers in bins.
    binned: usize,
    squares: f64,
    maximum: f64,
}

impl Distribution {
    /// Adds a number.
    pub fn add(&mut self, number: f64) {
        self.exact.push(number);
        if self.exact.len() < MOST_EXACT && self.binned == 0 {
            return;
        }
        for number in self.exact.drain(..) {
            *self
                .bins
                .entry(number.to_bits() >> BITS_IN_A_BIN)
                .or_default() += 1;
            self.binned += 1;
            self.squares += number * number;
            self.maximum = self.maximum.max(number);
        }
    }

    /// Returns how many numbers there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.exact.len() + self.binned
    }

    /// Returns the sum of the squares.
    #[must_use]
    pub fn squares(&mut self) -> f64 {
        self.exact.sort_by(f64::total_cmp);
        self.squares + self.exact.iter().map(|number| number * number).sum::<f64>()
    }

    /// Returns the largest number; `None` if there is none.
    #[must_use]
    pub fn maximum(&mut self) -> Option<f64> {
        self.nth(self.count().checked_sub(1)?)
    }

    /// Returns the number of this place in ascending order, counted from 0.
    #[must_use]
    pub fn nth(&mut self, place: usize) -> Option<f64> {
        if self.binned == 0 {
            self.exact.sort_by(f64::total_cmp);
            return self.exact.get(place).copied();
        }
        if place + 1 == self.binned {
            return Some(self.maximum);
        }
        let mut before = 0;
        for (bin, count) in &self.bins {
            before += count;
            if place < before {
                let middle = (bin << BITS_IN_A_BIN) | (1 << (BITS_IN_A_BIN - 1));
                let middle = f64::from_bits(middle);
                // Infinity has a bin of its own.
                return Some(if middle.is_nan() {
                    f64::INFINITY
                } else {
                    middle
                });
            }
        }
        None
    }

    /// Returns the median; NaN without a number.
    #[must_use]
    pub fn median(&mut self) -> f64 {
        median_by_place(self.count(), |place| self.nth(place))
    }
}

/// Returns the median of `count` numbers; NaN without a number. `nth` returns the number of a place
/// in ascending order, counted from 0.
pub(crate) fn median_by_place(count: usize, mut nth: impl FnMut(usize) -> Option<f64>) -> f64 {
    match (nth(count.wrapping_sub(1) / 2), nth(count / 2)) {
        (Some(lower), Some(upper)) => 0.5 * (lower + upper),
        _ => f64::NAN,
    }
}

impl FromIterator<f64> for Distribution {
    fn from_iter<T: IntoIterator<Item = f64>>(numbers: T) -> Self {
        let mut distribution = Self::default();
        numbers
            .into_iter()
            .for_each(|number| distribution.add(number));
        distribution
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_numbers_are_exact_and_many_nearly_so_in_little_memory() {
        let number = |index: usize| (index as f64 * 0.618_034).fract().powi(3) * 50.0;
        for count in [1, 2, 1_001, 600_000, 2_000_000] {
            let mut found = Distribution::default();
            let mut all: Vec<f64> = (0..count).map(number).collect();
            all.iter().for_each(|number| found.add(*number));
            all.sort_by(f64::total_cmp);
            assert_eq!(found.count(), count);
            assert_eq!(found.maximum(), all.last().copied());
            for place in [count / 2, count * 95 / 100, count / 10] {
                let (nth, expected) = (found.nth(place).unwrap(), all[place]);
                let tolerance = if count > MOST_EXACT {
                    2e-4 * expected
                } else {
                    0.0
                };
                assert!((nth - expected).abs() <= tolerance, "{nth} {expected}");
            }
            let squares: f64 = all.iter().map(|number| number * number).sum();
            assert!((found.squares() / squares - 1.0).abs() < 1e-9 || squares == 0.0);
            assert!(found.exact.len() < MOST_EXACT && found.bins.len() < 200_000);
        }
        assert!(Distribution::default().median().is_nan());
        assert_eq!(Distribution::default().maximum(), None);
    }

    #[test]
    fn infinity_is_the_largest() {
        let mut found = Distribution::default();
        (0..MOST_EXACT).for_each(|_| found.add(1.0));
        found.add(f64::INFINITY);
        found.add(f64::INFINITY);
        assert_eq!(found.nth(MOST_EXACT), Some(f64::INFINITY));
        assert!((found.median() - 1.0).abs() < 2e-4);
    }
}
