//! Turns of the force that the gyroscope does not show: a wrong unit, sign or order of the rates.
//!
//! The mean force over 0.1 s shows down, while its size stays within 5 % of gravity and within 15 %
//! of its mean. Its direction turns by 40° in up to a second, or in up to four seconds once a rest
//! has shown the gyroscope's offset. The rates about the same axis have to give this turn. Their
//! share of it is 1: in recordings by hand, the median is 0.8 to 1.1. Zeros and rates in a unit
//! that is too small give 0, a sign gives −1, exchanged axes 0, twice the unit 2.
//!
//! A horizontal acceleration turns a force of that size by 35° at most. In the recordings of BROAD
//! and TUM-VI, one turn of 130 contradicts. Four that do are a warning, if they are half of those
//! about an axis, or of all.
//!
//! Turns about the vertical, flights whose force stays along one axis, recordings without slow
//! turns of 40°, and those below 20 rows a second show nothing.

use std::collections::VecDeque;

use aplomb_models::motion::Vector;
use aplomb_models::motion::geometry::{add, angle_between, cross, dot, norm, scale, subtract};
use aplomb_models::motion::truth::STANDARD_GRAVITY_M_S2;

/// Time over which a mean is taken, µs.
const BLOCK_US: i64 = 100_000;
/// Longest time between two rows, µs.
const LONGEST_STEP_US: i64 = 100_000;
/// Fewest rows of a mean.
const FEWEST_ROWS: u32 = 2;
/// Largest difference of the force from gravity, as a share.
const GRAVITY_SHARE: f64 = 0.05;
/// Largest deviation of the force from its mean, root mean square as a share of gravity.
const DEVIATION_SHARE: f64 = 0.15;
/// Turn that is compared, rad. A horizontal acceleration turns a force of that size by 35°.
const TURN_RAD: f64 = 40.0 / 180.0 * std::f64::consts::PI;
/// Means of a turn before the offset is known.
const SHORT_TURN: usize = 10;
/// Means of a turn with a known offset.
const LONG_TURN: usize = 40;
/// Means of a rest.
const REST: usize = 10;
/// Turn of the force that a rest allows, rad.
const REST_RAD: f64 = 1.0 / 180.0 * std::f64::consts::PI;
/// Shares of a turn that do not contradict.
const FITTING: std::ops::Range<f64> = 0.6..1.5;
/// Share of the rotation axis along an axis of the sensor, of a turn about that axis.
const ALONG: f64 = 0.8;
/// Fewest turns that contradict.
const FEWEST_WRONG: usize = 4;
/// Most turns that are kept.
const MOST_TURNS: usize = 10_000;

/// Comparison of the turns of force and gyroscope, row by row.
#[derive(Clone, Debug, Default)]
pub struct Turns {
    block: Block,
    last_us: Option<i64>,
    /// Last blocks whose force shows down, without a gap.
    steady: VecDeque<Block>,
    /// Offset of the gyroscope in the quietest rest, rad/s, and the variance of its means.
    offset: Option<(Vector, f64)>,
    /// Rotation axis in sensor axes, and share of the turn that the gyroscope shows.
    turns: Vec<(Vector, f64)>,
}

/// Sums of one block; then mean force.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    start_us: i64,
    rows: u32,
    force: Vector,
    squares: f64,
    /// Integral of the rates, rad, and its time, s.
    turn_rad: Vector,
    time_s: f64,
    is_broken: bool,
}

impl Turns {
    /// Takes one row in sensor axes: force in m/s², rates in rad/s, and whether one of them reads
    /// full scale.
    pub fn add(&mut self, t_us: i64, force_m_s2: Vector, rates_rad_s: Vector, is_saturated: bool) {
        let last_us = self.last_us.replace(t_us).unwrap_or(t_us);
        let step_us = t_us.saturating_sub(last_us);
        let since_us = t_us.saturating_sub(self.block.start_us);
        if self.block.rows > 0 && !(0..BLOCK_US).contains(&since_us) {
            self.close_block();
        }
        let block = &mut self.block;
        if block.rows == 0 {
            block.start_us = t_us;
        }
        let is_number = norm(force_m_s2).is_finite() && norm(rates_rad_s).is_finite();
        let is_near = (0..=LONGEST_STEP_US).contains(&step_us);
        block.rows += 1;
        block.is_broken |= is_saturated || !is_number || !is_near;
        let step_s = step_us as f64 * 1e-6;
        block.time_s += step_s;
        block.turn_rad = add(block.turn_rad, scale(rates_rad_s, step_s));
        block.force = add(block.force, force_m_s2);
        block.squares += dot(force_m_s2, force_m_s2);
    }

    /// Returns a warning if the turns of the force are not those of the gyroscope.
    #[must_use]
    pub fn warning(&self) -> Option<String> {
        let shares = |is_meant: &dyn Fn(&Vector) -> bool| -> Vec<f64> {
            let meant = self.turns.iter().filter(|(axis, _)| is_meant(axis));
            meant.map(|(_, share)| *share).collect()
        };
        let about = |index: usize| shares(&|axis| axis[index].abs() > ALONG);
        let axes = [about(0), about(1), about(2), shares(&|_| true)];
        let names = [" about x", " about y", " about z", ""];
        let contradicting = axes.into_iter().zip(names).find_map(|(mut shares, name)| {
            let turns = shares.len();
            let wrong = shares.iter().filter(|share| !FITTING.contains(share));
            let wrong = wrong.count();
            if wrong < FEWEST_WRONG || 2 * wrong < turns {
                return None;
            }
            shares.sort_unstable_by(f64::total_cmp);
            Some((wrong, turns, name, shares[turns / 2]))
        });
        contradicting.map(|(wrong, turns, name, share)| {
            format!(
                "the rates do not fit the force: in {wrong} of {turns} turns{name} of the force, \
                 the gyroscope turns otherwise, mostly by {share:.2} of it. Check the unit of the \
                 rates (--rate-unit), and the signs and the order of the columns"
            )
        })
    }

    fn close_block(&mut self) {
        let mut block = std::mem::take(&mut self.block);
        let rows = f64::from(block.rows);
        block.force = scale(block.force, rows.recip());
        let variance = block.squares / rows - dot(block.force, block.force);
        let gravity = STANDARD_GRAVITY_M_S2;
        let is_steady = !block.is_broken
            && block.rows >= FEWEST_ROWS
            && (norm(block.force) / gravity - 1.0).abs() < GRAVITY_SHARE
            && variance.max(0.0).sqrt() < DEVIATION_SHARE * gravity;
        if !is_steady {
            self.steady.clear();
            return;
        }
        self.steady.push_back(block);
        self.measure_offset();
        let longest = self.offset.map_or(SHORT_TURN, |_| LONG_TURN);
        while self.steady.len() > longest + 1 {
            self.steady.pop_front();
        }
        self.compare();
    }

    /// Takes the mean rates of the last second for the offset, if the force rests and the rates
    /// vary less than in each rest before.
    fn measure_offset(&mut self) {
        let Some(first) = self.steady.len().checked_sub(REST) else {
            return;
        };
        let rest = self.steady.range(first..);
        let last = self.steady[first + REST - 1].force;
        let is_rest = |block: &Block| angle_between(block.force, last) < REST_RAD;
        if !rest.clone().all(is_rest) {
            return;
        }
        let rates = rest.map(|block| scale(block.turn_rad, block.time_s.recip()));
        let sum = rates.clone().fold([0.0; 3], add);
        let mean = scale(sum, (REST as f64).recip());
        let squares: f64 = rates
            .map(|rate| subtract(rate, mean))
            .map(|difference| dot(difference, difference))
            .sum();
        if self.offset.is_none_or(|(_, least)| squares < least) {
            self.offset = Some((mean, squares));
        }
    }

    /// Compares the shortest turn of the force that ends now.
    fn compare(&mut self) {
        let Some((last, before)) = self.steady.make_contiguous().split_last() else {
            return;
        };
        let mut turn_rad = scale(last.turn_rad, 0.5);
        let mut time_s = 0.5 * last.time_s;
        for block in before.iter().rev() {
            let angle_rad = angle_between(block.force, last.force);
            if angle_rad > TURN_RAD {
                let turn_rad = add(turn_rad, scale(block.turn_rad, 0.5));
                let time_s = time_s + 0.5 * block.time_s;
                let offset = self.offset.map_or([0.0; 3], |(offset, _)| offset);
                let turn_rad = subtract(turn_rad, scale(offset, time_s));
                // The body turns against the force.
                let axis = cross(last.force, block.force);
                let axis = scale(axis, norm(axis).recip());
                if self.turns.len() < MOST_TURNS && norm(axis).is_finite() {
                    self.turns.push((axis, dot(turn_rad, axis) / angle_rad));
                }
                let last = *last;
                self.steady.clear();
                self.steady.push_back(last);
                return;
            }
            turn_rad = add(turn_rad, block.turn_rad);
            time_s += block.time_s;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GRAVITY: f64 = STANDARD_GRAVITY_M_S2;

    /// Rolls, then pitches to and fro by 45° for 30 s each, after a rest of 2 s, with an offset of
    /// 10 °/s. Returns the warning on what this function makes of the rates.
    fn warning(change: impl Fn(Vector) -> Vector) -> Option<String> {
        let mut turns = Turns::default();
        for row in 0..62 * 200_i32 {
            let time_s = f64::from(row) / 200.0;
            let since_s = (time_s - 2.0).max(0.0);
            let (angle, rate) = (0.8 * since_s.sin(), 0.8 * since_s.cos());
            let rate = if time_s < 2.0 { 0.0 } else { rate };
            let (sine, cosine) = (GRAVITY * angle.sin(), GRAVITY * angle.cos());
            let (force, rates) = if time_s < 32.0 {
                ([0.0, sine, cosine], [rate, 0.0, 0.0])
            } else {
                ([-sine, 0.0, cosine], [0.0, rate, 0.0])
            };
            let rates = add(rates, [0.17, -0.17, 0.17]);
            turns.add(i64::from(row) * 5_000, force, change(rates), false);
        }
        turns.warning()
    }

    #[test]
    fn rates_that_fit_the_force_give_no_warning() {
        assert_eq!(warning(|rates| rates), None);
        for factor in [0.8, 1.2] {
            assert_eq!(warning(|rates| scale(rates, factor)), None);
        }
    }

    #[test]
    fn a_wrong_unit_sign_or_order_of_the_rates_is_reported() {
        type Change = fn(Vector) -> Vector;
        let changes: [(Change, &str); 6] = [
            (
                |rates| scale(rates, 0.0174),
                "about x of the force, the gyroscope turns otherwise, mostly by 0.02",
            ),
            (|rates| scale(rates, 2.0), "mostly by 2."),
            (|_| [0.0; 3], "mostly by 0.00"),
            (|[x, y, z]| [-x, y, z], "turns about x"),
            (|[x, y, z]| [x, -y, z], "turns about y"),
            (|[x, y, z]| [y, x, z], "turns about x"),
        ];
        for (change, expected) in changes {
            let warning = warning(change).expect(expected);
            assert!(warning.contains(expected), "{expected}: {warning}");
        }
    }

    #[test]
    fn a_force_that_does_not_turn_or_that_gravity_does_not_turn_is_no_evidence() {
        for reach_m_s2 in [0.0, 9.0] {
            let mut turns = Turns::default();
            for row in 0..20_000_i32 {
                let time_s = f64::from(row) / 200.0;
                let push = reach_m_s2 * (3.0 * time_s).sin();
                turns.add(
                    i64::from(row) * 5_000,
                    [push, 0.0, GRAVITY],
                    [0.0; 3],
                    false,
                );
            }
            assert_eq!(turns.warning(), None);
        }
    }

    #[test]
    fn numbers_that_are_none_gaps_and_full_scale_are_no_evidence() {
        for (force, step_us, is_saturated) in [
            (f64::NAN, 5_000, false),
            (0.0, 150_000, false),
            (0.0, i64::MAX / 10_000, false),
            (0.0, 5_000, true),
        ] {
            let mut turns = Turns::default();
            for row in 0..10_000 {
                let angle = f64::from(row) * 0.005;
                let force = [force, GRAVITY * angle.sin(), GRAVITY * angle.cos()];
                turns.add(i64::from(row) * step_us, force, [0.0; 3], is_saturated);
            }
            assert_eq!(turns.warning(), None);
        }
    }
}
