//! An upper estimate in cycles, where the virtual board counts instructions.
//!
//! The emulated core takes a cycle an instruction. The estimate adds what a chip takes at most, on
//! average over a sample:
//!
//! | cost | cycles | source |
//! |---|---|---|
//! | instruction: loads, taken branches, floating point | 1 more each | Cortex-M4 TRM, table 3-1 |
//! | fetch: the cache misses each line of four instructions | 5 a line | RM0090, 3.5.1, table 10 |
//! | exception: entry 12, exit 10, lazy stacking 17, vector 5 | 44 each | PM0214, 2.3.7; AN298 |
//! | access of a peripheral on APB1, at a quarter of the core's clock | 12 each | RM0090, 2.1 |
//!
//! Five wait states are those of 168 MHz from 2.7 V on; slower boards have fewer.
//!
//! Each period of SCL is longer by the rise time, because the port counts its high time from the
//! level on the line. Fast mode allows 300 ns (UM10204, table 10).

/// More cycles of an instruction than one: its execution, and its share of a missed line.
const CYCLES_PER_INSTRUCTION: f64 = 1.0 + 1.0 + 5.0 / 4.0;
const CYCLES_PER_EXCEPTION: f64 = 44.0;
const CYCLES_PER_ACCESS: f64 = 12.0;

/// Periods of SCL from START to the last acknowledge of a burst: 17 bytes, of nine periods each.
const PERIODS_OF_BURST: f64 = 17.0 * 9.0;
const RISE_TIME_US: f64 = 0.3;

/// The counts of an average sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// Instructions.
    pub instructions: f64,
    /// Exceptions that were entered.
    pub exceptions: f64,
    /// Accesses of peripherals.
    pub accesses: f64,
}

impl Work {
    /// Returns the cycles that a chip takes at most.
    #[must_use]
    pub fn cycles(&self) -> f64 {
        CYCLES_PER_INSTRUCTION * self.instructions
            + CYCLES_PER_EXCEPTION * self.exceptions
            + CYCLES_PER_ACCESS * self.accesses
    }

    /// Returns the longest time from edge to attitude on a chip, in µs. `counted_us` is that of
    /// the virtual board.
    #[must_use]
    pub fn edge_to_attitude_us(&self, counted_us: f64, core_hz: u64) -> f64 {
        let more_cycles = self.cycles() - self.instructions;
        counted_us + PERIODS_OF_BURST * RISE_TIME_US + more_cycles * 1e6 / core_hz as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cost_counts() {
        let none = Work {
            instructions: 1_000.0,
            exceptions: 0.0,
            accesses: 0.0,
        };
        assert_eq!(none.cycles(), 3_250.0);
        let all = Work {
            exceptions: 8.0,
            accesses: 50.0,
            ..none
        };
        assert_eq!(all.cycles(), 3_250.0 + 352.0 + 600.0);
        // 45.9 us of rise times, and 3,202 cycles of 1 us.
        let longest_us = all.edge_to_attitude_us(390.0, 1_000_000);
        assert!(
            (longest_us - (390.0 + 45.9 + 3_202.0)).abs() < 1e-9,
            "{longest_us}"
        );
    }
}
