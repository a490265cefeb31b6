//! Measurement of a step: the mean field of the interval in level axes.
//!
//! ```text
//! s = c + d + W·b + n      s = mean of R·m      W = mean of R
//! ```
//!
//! It is linear in field c, hard iron b and local deviation d. A tilt error θ moves s by −θ × c.
//! Tilt and all other states of the tilt filter are *considered* (Schmidt, *Application of
//! State-Space Methods to Navigation Problems*, 1966): their errors widen the innovation and shape
//! the gains, but no gain moves them.

use super::covariance::{CrossRow, DEVIATION, FIELD, IRON, STATES};
use super::step::Phase;
use super::tuning::square;
use super::{Heading, HeadingEstimate};
use crate::attitude::wrap_pi;
use crate::estimator::kalman::Kalman;
use crate::estimator::kalman::follow::ERROR_STATES;

/// Rows of O and X that a slice corrects.
const ROWS: usize = 3;

/// Row h of the measurement, without its two ones at field and local deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    /// Entries at the hard iron.
    iron: [f32; 3],
    /// Entries at the tilt, north and east.
    tilt: [f32; 2],
}

impl Heading {
    /// Returns the measured field in level axes without hard iron, µT.
    fn measured(&self) -> [f32; 3] {
        let [.., bx, by, bz, _, _, _] = self.state;
        let mut measured = self.closed.field_ut;
        for (sum, [x, y, z]) in measured.iter_mut().zip(&self.closed.turn) {
            *sum -= x * bx + y * by + z * bz;
        }
        measured
    }

    /// Returns the innovation of each axis, µT.
    fn innovation(&self) -> [f32; 3] {
        let [mx, my, mz] = self.measured();
        let [cx, cy, cz, _, _, _, dx, dy, dz] = self.state;
        [mx - cx - dx, my - cy - dy, mz - cz - dz]
    }

    /// Returns the measurement's row of an axis.
    fn row(&self, axis: usize) -> Row {
        let [x, y, z] = self.measured();
        let [first, second, third] = self.closed.turn;
        match axis {
            0 => Row {
                iron: first,
                tilt: [0.0, -z],
            },
            1 => Row {
                iron: second,
                tilt: [z, 0.0],
            },
            _ => Row {
                iron: third,
                tilt: [-y, x],
            },
        }
    }

    /// Returns P·hᵀ at a field state.
    #[inline]
    fn project(&self, row: &Row, axis: usize, state: usize) -> f32 {
        let covariance = &self.covariance;
        let [wx, wy, wz] = row.iron;
        let [north, east] = row.tilt;
        let tilt = match covariance.cross.get(state) {
            Some([to_north, to_east, ..]) => north * to_north + east * to_east,
            None => 0.0,
        };
        covariance.entry(state, FIELD + axis)
            + covariance.entry(state, DEVIATION + axis)
            + wx * covariance.entry(state, IRON)
            + wy * covariance.entry(state, IRON + 1)
            + wz * covariance.entry(state, IRON + 2)
            + tilt
    }

    /// Adds the expected squared innovation of an axis without noise: h·P·hᵀ.
    pub(super) fn expect(&mut self, kalman: &Kalman, axis: usize) -> Phase {
        let row = self.row(axis);
        let [wx, wy, wz] = row.iron;
        let [north, east] = row.tilt;
        let [nn, ne, ee] = kalman.tilt_covariance();
        let mut expected = square(north) * nn + 2.0 * north * east * ne + square(east) * ee;
        let states = [
            (FIELD + axis, 1.0),
            (DEVIATION + axis, 1.0),
            (IRON, wx),
            (IRON + 1, wy),
            (IRON + 2, wz),
        ];
        for (state, factor) in states {
            let crossed = match self.covariance.cross.get(state) {
                Some([to_north, to_east, ..]) => north * to_north + east * to_east,
                None => 0.0,
            };
            expected += factor * (self.project(&row, axis, state) + crossed);
        }
        self.expected += expected;
        if axis < 2 {
            Phase::Expect(axis + 1)
        } else {
            Phase::Gate
        }
    }

    /// Compares the innovation with the expected one: adds what exceeds it to the noise, and
    /// restarts after a lasting contradiction.
    pub(super) fn gate(&mut self) -> Phase {
        let tuning = self.tuning;
        let duration_s = self.closed.duration_s;
        let mean_square_rate = self.closed.squared_rate / duration_s;
        let noise = square(tuning.noise_ut) + square(tuning.noise_per_rate) * mean_square_rate;
        let [x, y, z] = self.innovation();
        let squared = square(x) + square(y) + square(z);
        let expected = self.expected + 3.0 * noise;
        let excess = (squared - tuning.gate * expected) / 3.0;
        let excess = excess.clamp(0.0, 1.0e6);
        let decay = (duration_s / tuning.excess_s).min(1.0);
        let limit = square(tuning.largest_excess_ut);
        self.excess = (self.excess * (1.0 - decay)).max(excess.min(limit));
        self.noise = noise + tuning.excess_to_noise * excess;
        if self.watch(squared, squared / expected) {
            self.restarts = self.restarts.saturating_add(1);
            self.restart();
            return Phase::Idle;
        }
        Phase::Project(0)
    }

    /// Watches the innovation. Returns whether it contradicts the field for so long that the filter
    /// must restart: the innovation is large, though the field's length fits.
    fn watch(&mut self, squared: f32, per_expected: f32) -> bool {
        let tuning = self.tuning;
        let duration_s = self.closed.duration_s;
        let [cx, cy, cz, bx, by, bz, ..] = self.state;
        let [mx, my, mz] = self.reading_ut;
        let body = square(mx - bx) + square(my - by) + square(mz - bz);
        let level = square(cx) + square(cy) + square(cz);
        let length = libm::sqrtf(body) - libm::sqrtf(level);
        self.age_s += duration_s;
        let share = (duration_s / tuning.restart_average_s).min(1.0);
        self.mean_innovation += share * (squared - self.mean_innovation);
        self.mean_length += share * (square(length) - self.mean_length);
        let share = (duration_s / tuning.consistency_s).min(1.0);
        self.inconsistency += share * (per_expected.min(100.0) - self.inconsistency);
        let limit = tuning.restart_ratio * self.mean_length + square(tuning.restart_floor_ut);
        let contradicts = self.age_s > tuning.restart_after_s && self.mean_innovation > limit;
        self.contradicted_s = if contradicts {
            self.contradicted_s + duration_s
        } else {
            0.0
        };
        self.contradicted_s > tuning.restart_after_s
    }

    /// Computes O·hᵀ of an axis.
    pub(super) fn project_own(&mut self, axis: usize) -> Phase {
        let row = self.row(axis);
        let mut own = [0.0; STATES];
        for (state, entry) in own.iter_mut().enumerate() {
            *entry = self.project(&row, axis, state);
        }
        self.own = own;
        Phase::ProjectCross(axis)
    }

    /// Computes X·hᵀ of an axis and the inverse of the innovation's variance, and corrects the
    /// states.
    pub(super) fn project_cross(&mut self, kalman: &Kalman, axis: usize) -> Phase {
        let row = self.row(axis);
        let mut column = [0.0; ERROR_STATES];
        kalman.add_tilt_columns(row.tilt, &mut column);
        let [first, second, third, bx, by, bz] = &self.covariance.cross;
        let field = [first, second, third].into_iter().nth(axis);
        let [wx, wy, wz] = row.iron;
        for (source, factor) in [(field, 1.0), (Some(bx), wx), (Some(by), wy), (Some(bz), wz)] {
            add(&mut column, source, factor);
        }
        let own = |state: usize| self.own.get(state).copied().unwrap_or(0.0);
        let [to_north, to_east, ..] = column;
        let variance = own(FIELD + axis)
            + own(DEVIATION + axis)
            + wx * own(IRON)
            + wy * own(IRON + 1)
            + wz * own(IRON + 2)
            + row.tilt[0] * to_north
            + row.tilt[1] * to_east
            + self.noise;
        self.column = column;
        self.inverse = 1.0 / variance;
        let innovation = self.innovation().into_iter().nth(axis).unwrap_or(0.0);
        let gain = innovation * self.inverse;
        for (state, entry) in self.state.iter_mut().zip(&self.own) {
            *state += gain * entry;
        }
        Phase::Correct(axis, 0)
    }

    /// Corrects rows of O and X: P ← P − P·hᵀ·h·P/s.
    pub(super) fn correct(&mut self, axis: usize, first: usize) -> Phase {
        let rows = self.own.iter().enumerate().skip(first).take(ROWS);
        for (row, own) in rows {
            let gain = own * self.inverse;
            self.covariance.subtract(row, gain, &self.own);
            self.covariance.subtract_cross(row, gain, &self.column);
        }
        if first + ROWS < STATES {
            Phase::Correct(axis, first + ROWS)
        } else if axis < 2 {
            Phase::Project(axis + 1)
        } else {
            Phase::Finish
        }
    }

    /// Updates the heading and its σ.
    pub(super) fn finish(&mut self, kalman: &Kalman) -> Phase {
        let sum: f32 = self.state.iter().map(|state| state.abs()).sum();
        // A NaN fails the comparison.
        if !(self.covariance.is_sound() && sum < 1.0e5) {
            self.restart();
            return Phase::Idle;
        }
        let [cx, cy, ..] = self.state;
        let covariance = &self.covariance;
        let variance = square(cy) * covariance.entry(0, 0) + square(cx) * covariance.entry(1, 1)
            - 2.0 * cx * cy * covariance.entry(1, 0);
        let horizontal = square(cx) + square(cy) + 1.0e-3;
        let sigma_rad = libm::sqrtf(variance.max(0.0)) / horizontal;
        let tuning = self.tuning;
        self.estimate = (sigma_rad < tuning.known_rad).then(|| HeadingEstimate {
            yaw_offset_rad: wrap_pi(self.declination_rad - libm::atan2f(cy, cx)),
            sigma_rad,
            is_valid: sigma_rad < tuning.valid_rad
                && kalman.tilt_sigma_rad() < tuning.valid_tilt_rad
                && self.inconsistency < tuning.valid_inconsistency,
        });
        Phase::Idle
    }
}

/// Adds a multiple of a row.
fn add(column: &mut CrossRow, source: Option<&CrossRow>, factor: f32) {
    for (sum, entry) in column.iter_mut().zip(source.into_iter().flatten()) {
        *sum += factor * entry;
    }
}
