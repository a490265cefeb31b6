//! The content of the RAM: random after power-up, kept over a reset.
//!
//! RM0090 states no content after power-up, and chips differ. A firmware that takes such a content
//! for its own data works on a RAM of zeros, and fails on a chip.

use aplomb_models::random::Random;
use rigless::emulator::Memory;
use rigless::soc::Width;

/// Start and length of the largest RAM of the boards (STM32F405 datasheet, memory map).
const START: u64 = 0x2000_0000;
const LENGTH: u64 = 128 << 10;

/// Bytes that one access writes.
const STEP: u64 = 8;

/// The supply below which the RAM loses its content, mV. No document states it. It is chosen below
/// the threshold of the reset, so that flights meet a RAM that keeps its content and one that does
/// not.
pub const RAM_MILLIVOLTS: u32 = 1_000;

/// The RAM of a board, by its content at power-up.
#[derive(Debug)]
pub struct Ram {
    random: Random,
    /// The content after the last power-up.
    content: Vec<u64>,
    power_ups: usize,
    /// True from the loss of the content until the supply is back.
    is_lost: bool,
}

impl Ram {
    /// A RAM whose contents follow from the seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            random: Random::new(seed, "RAM at power-up"),
            content: Vec::new(),
            power_ups: 0,
            is_lost: false,
        }
    }

    /// Fills the memory with new random bits.
    pub fn power_up(&mut self, memory: &mut dyn Memory) {
        self.power_ups += 1;
        self.content = (0..LENGTH / STEP).map(|_| self.random.bits()).collect();
        for (address, &bits) in (START..).step_by(STEP as usize).zip(&self.content) {
            // A chip with less RAM ignores the rest.
            memory.write(address, Width::W64, bits).ok();
        }
    }

    /// Follows the supply. The content is lost once in each failure that is deep enough.
    pub fn follow_supply(&mut self, millivolts: u32, memory: &mut dyn Memory) {
        let loses = millivolts < RAM_MILLIVOLTS;
        if loses && !self.is_lost {
            self.power_up(memory);
        }
        self.is_lost = loses;
    }

    /// Returns how many random contents there were: that of the start, and one after each loss.
    #[must_use]
    pub fn power_ups(&self) -> usize {
        self.power_ups
    }

    /// Returns the word that the last power-up left at this address.
    #[must_use]
    pub fn word_at_power_up(&self, address: u64) -> Option<u32> {
        let offset = address.checked_sub(START)?;
        let bits = self.content.get(usize::try_from(offset / STEP).ok()?)?;
        Some((bits >> (8 * (offset % STEP))) as u32)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rigless::emulator::Error;

    use super::*;

    /// A memory of the words that were written to it.
    #[derive(Default)]
    struct Words(BTreeMap<u64, u64>);

    impl Memory for Words {
        fn read(&mut self, address: u64, width: Width) -> Result<u64, Error> {
            let word = self.0.get(&address).copied();
            word.ok_or(Error::Memory { address, width })
        }

        fn write(&mut self, address: u64, _width: Width, value: u64) -> Result<(), Error> {
            self.0.insert(address, value);
            Ok(())
        }
    }

    fn powered(seed: u64) -> (Ram, Words) {
        let (mut ram, mut memory) = (Ram::new(seed), Words::default());
        ram.power_up(&mut memory);
        (ram, memory)
    }

    #[test]
    fn every_word_is_random_and_follows_from_the_seed() {
        let (ram, memory) = powered(1);
        assert_eq!(memory.0.len() as u64, LENGTH / STEP);
        let ones: u32 = memory.0.values().map(|word| word.count_ones()).sum();
        let share = f64::from(ones) / (8 * LENGTH) as f64;
        assert!((0.49..0.51).contains(&share), "{share}");
        assert_eq!(memory.0, powered(1).1.0);
        assert_ne!(memory.0, powered(2).1.0);
        for address in [START, START + 8, START + LENGTH - 8] {
            let [low, high] = [0, 4].map(|offset| ram.word_at_power_up(address + offset));
            let [low, high] = [low, high].map(|word| u64::from(word.unwrap()));
            assert_eq!(memory.0[&address], high << 32 | low);
        }
        assert_eq!(ram.word_at_power_up(START + LENGTH), None);
        assert_eq!(ram.word_at_power_up(START - 4), None);
    }

    #[test]
    fn a_supply_that_fails_loses_the_content_once_if_it_is_low_enough() {
        let (mut ram, mut memory) = powered(1);
        let first = memory.0.clone();
        for millivolts in [3_300, 1_500, RAM_MILLIVOLTS, 3_300] {
            ram.follow_supply(millivolts, &mut memory);
        }
        assert_eq!(memory.0, first);
        ram.follow_supply(RAM_MILLIVOLTS - 1, &mut memory);
        let second = memory.0.clone();
        assert_ne!(second, first);
        ram.follow_supply(0, &mut memory);
        assert_eq!(memory.0, second);
        ram.follow_supply(3_300, &mut memory);
        assert_eq!(memory.0, second);
        ram.follow_supply(0, &mut memory);
        assert_ne!(memory.0, second);
        assert_eq!(ram.power_ups(), 3);
    }
}
