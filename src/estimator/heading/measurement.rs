//! Measurement of a step: the mean field of the interval in level axes.
//!
//! ```text
//! z = c + d + W·b + n      z = mean of R·m      W = mean of R
//! ```
//!
//! It is linear in field c, hard iron b and local deviation d; n is noise. A tilt error θ moves z
//! by −θ × c. Tilt and all other states of the tilt filter are *considered* (Schmidt,
//! *Application of State-Space Methods to Navigation Problems*, 1966): their errors widen the
//! innovation and shape the gains, but no gain moves them.
//!
//! The [module](super) has a table of the symbols.

use super::covariance::{CORRELATED, DEVIATION, FIELD, IRON, STATES};
use super::step::{FieldSlice, share};
use super::{Heading, HeadingEstimate};
use crate::attitude::{Quaternion, Vector3, wrap_pi};
use crate::estimator::arithmetic::{larger, smaller, square};
use crate::estimator::filter::Filter as _;
use crate::estimator::kalman::Kalman;
use crate::units::MagneticField;

/// Largest sum of a reading's components, µT: no compass of this kind reaches it.
const LARGEST_FIELD_UT: f32 = 15_000.0;

/// Age beyond which a reading says nothing of the present attitude, µs. An age that underflows, in
/// a program that subtracts two times, is beyond it too.
const OLDEST_READING_US: u32 = 1_000_000;

/// Limit of a squared innovation per expected one, so that no single one counts for long.
const LARGEST_INCONSISTENCY: f32 = 100.0;

/// Least squared horizontal field that has a direction, µT². The earth's is above 1 µT² almost
/// everywhere; before the first reading the field is zero.
const LEAST_HORIZONTAL_UT2: f32 = 1.0e-2;

/// Longest time from the first attitude to the turns that count, s.
const LONGEST_TURN_S: f32 = 15.0;

/// Row h of the measurement, without its two ones at field and local deviation.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    /// Entries at the hard iron.
    iron: [f32; 3],
    /// Entries at the tilt, north and east.
    tilt: [f32; 2],
}

impl Heading {
    /// Returns whether [`add_field`](Self::add_field) uses a reading of this field and age, µs.
    #[inline]
    pub fn uses_field(field: MagneticField, age_us: u32) -> bool {
        let [x, y, z] = field.ut;
        let size = x.abs() + y.abs() + z.abs();
        // A NaN fails the comparison.
        size < LARGEST_FIELD_UT && age_us <= OLDEST_READING_US
    }

    /// Returns the measured field in level axes without hard iron, µT.
    fn measured(&self) -> [f32; 3] {
        let [.., bx, by, bz, _, _, _] = self.state;
        let mut measured = self.closed().field_ut;
        for (sum, [x, y, z]) in measured.iter_mut().zip(&self.closed().rotation) {
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

    /// Returns the squared innovation of all axes, µT².
    fn squared_innovation_ut2(&self) -> f32 {
        let [x, y, z] = self.innovation();
        square(x) + square(y) + square(z)
    }

    /// Returns the measurement's row of an axis.
    fn row(&self, axis: usize) -> Row {
        let [x, y, z] = self.measured();
        let [first, second, third] = self.closed().rotation;
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

    /// Adds the expected squared innovation of an axis without noise: h·J·hᵀ.
    pub(super) fn expect(&mut self, kalman: &Kalman, axis: u8) -> FieldSlice {
        let place = usize::from(axis);
        let row = self.row(place);
        let [north, east] = row.tilt;
        let [nn, ne, ee] = kalman.tilt_covariance();
        let tilt = square(north) * nn + 2.0 * north * east * ne + square(east) * ee;
        let covariance = &self.covariance;
        let (c, d) = (FIELD + place, DEVIATION + place);
        let mut linear = north * covariance.cross_entry(c, 0)
            + east * covariance.cross_entry(c, 1)
            + covariance.entry(d, c);
        let mut iron = 0.0;
        for (index, factor) in row.iron.into_iter().enumerate() {
            let state = IRON + index;
            linear += factor
                * (covariance.entry(state, c)
                    + covariance.entry(d, state)
                    + north * covariance.cross_entry(state, 0)
                    + east * covariance.cross_entry(state, 1));
            for (other, other_factor) in row.iron.into_iter().enumerate().take(index) {
                iron += 2.0 * factor * other_factor * covariance.entry(state, IRON + other);
            }
            iron += square(factor) * covariance.entry(state, state);
        }
        let own = covariance.entry(c, c) + covariance.entry(d, d);
        self.expected_ut2 += own + iron + 2.0 * linear + tilt;
        if axis < 2 {
            FieldSlice::Expect(axis + 1)
        } else {
            FieldSlice::Gate
        }
    }

    /// Compares the squared innovation with the expected one, and adds the part beyond the gate's
    /// share of it to the noise.
    pub(super) fn gate(&mut self, kalman: &Kalman) -> FieldSlice {
        self.verify(kalman);
        let tuning = self.tuning;
        let duration_s = self.closed().duration_s;
        let mean_square_rate = self.closed().squared_rate / duration_s;
        let noise = square(tuning.noise_ut) + square(tuning.noise_per_rate) * mean_square_rate;
        let squared = self.squared_innovation_ut2();
        let expected = self.expected_ut2 + 3.0 * noise;
        let excess = (squared - tuning.gate * expected) * (1.0 / 3.0);
        let excess = excess.clamp(0.0, 1.0e6);
        let limit = square(tuning.largest_excess_ut);
        self.excess = larger(self.excess, smaller(excess, limit));
        self.noise_ut2 = noise + tuning.excess_to_noise * excess;
        let share = share(duration_s, tuning.consistency_s);
        let ratio = smaller(squared / expected, LARGEST_INCONSISTENCY);
        self.inconsistency += share * (ratio - self.inconsistency);
        if self.inconsistency > tuning.valid_inconsistency {
            self.verified_s = 0.0;
        }
        FieldSlice::Watch
    }

    /// Adds to the time for which the body has moved, turned away from where the field was first
    /// seen. Before, iron on the body, a magnet beside it and a wrong mount look like north.
    ///
    /// Turns count from an attitude of the last 15 s, because yaw drifts, and an old drift would be
    /// a turn about the vertical that no motion has made.
    ///
    /// While the gyroscope's bias is unknown, no turn is known well enough. A compass whose hard
    /// iron is unknown needs turns about two axes: turns about one leave the hard iron along it
    /// open, and soft iron hides the rest.
    fn verify(&mut self, kalman: &Kalman) {
        if !kalman.is_bias_known() {
            self.forget_turns();
            return;
        }
        let attitude = kalman.attitude_at_earth_step();
        if self.since_first_s > LONGEST_TURN_S {
            self.first_attitude = attitude;
            self.largest_turn = Vector3::ZERO;
            self.since_first_s = 0.0;
        }
        // The axis, times the sine of half the angle.
        let Quaternion { x, y, z, .. } = self.first_attitude.conjugate().multiply(attitude);
        let turn = Vector3::new(x, y, z);
        let least = square(self.tuning.verified_half_sine);
        if turn.dot(turn) < least {
            return;
        }
        // The part of the smaller turn across the larger one: a small turn's axis is uncertain.
        let (before, now) = (self.largest_turn.dot(self.largest_turn), turn.dot(turn));
        let across = self.largest_turn.cross(turn);
        self.has_two_axes |= across.dot(across) > least * larger(before, now);
        if now > before {
            self.largest_turn = turn;
        }
        if self.has_two_axes || self.is_iron_known {
            self.verified_s += self.motion * self.closed().duration_s;
        }
    }

    /// Forgets where the field was first seen, and the turns since then.
    pub(super) fn forget_turns(&mut self) {
        self.since_first_s = f32::INFINITY;
        self.has_two_axes = false;
        self.verified_s = 0.0;
    }

    /// Watches the innovation, and restarts the filter when it has contradicted the field for long:
    /// the innovation is large, though the field's length fits.
    pub(super) fn watch(&mut self) -> FieldSlice {
        let tuning = self.tuning;
        let duration_s = self.closed().duration_s;
        let [cx, cy, cz, ..] = self.state;
        let [mx, my, mz] = self.measured();
        let measured = square(mx) + square(my) + square(mz);
        let level = square(cx) + square(cy) + square(cz);
        let length = libm::sqrtf(measured) - libm::sqrtf(level);
        let contradiction = self.squared_innovation_ut2() - tuning.restart_ratio * square(length);
        let share = share(duration_s, tuning.restart_average_s);
        self.contradiction += share * (contradiction - self.contradiction);
        let is_lasting = self.contradiction > square(tuning.restart_floor_ut);
        self.contradicted_s = if is_lasting {
            self.contradicted_s + duration_s
        } else {
            0.0
        };
        if self.contradicted_s > tuning.restart_after_s {
            self.restart();
            return FieldSlice::Idle;
        }
        FieldSlice::Project(0)
    }

    /// Computes J·hᵀ at f for an axis, but for the hard iron's part.
    pub(super) fn project_own(&mut self, axis: u8) -> FieldSlice {
        let place = usize::from(axis);
        let [north, east] = self.row(place).tilt;
        let covariance = &self.covariance;
        self.own_scratch = [0.0; STATES];
        for (entry, [to_north, to_east, ..]) in self.own_scratch.iter_mut().zip(&covariance.cross) {
            *entry = north * to_north + east * to_east;
        }
        covariance.add_column(FIELD + place, 1.0, &mut self.own_scratch);
        covariance.add_column(DEVIATION + place, 1.0, &mut self.own_scratch);
        FieldSlice::ProjectIron(axis)
    }

    /// Completes J·hᵀ at f for an axis.
    pub(super) fn project_iron(&mut self, axis: u8) -> FieldSlice {
        let [wx, wy, wz] = self.row(axis.into()).iron;
        for (state, factor) in [(IRON, wx), (IRON + 1, wy), (IRON + 2, wz)] {
            self.covariance
                .add_column(state, factor, &mut self.own_scratch);
        }
        FieldSlice::ProjectCross(axis)
    }

    /// Computes J·hᵀ at ε for an axis, but for the tilt's part.
    pub(super) fn project_cross(&mut self, axis: u8) -> FieldSlice {
        let [first, second, third, bx, by, bz] = &self.covariance.cross;
        let field = match axis {
            0 => first,
            1 => second,
            _ => third,
        };
        let [wx, wy, wz] = self.row(axis.into()).iron;
        let sources = field.iter().zip(bx).zip(by).zip(bz);
        for (sum, (((c, x), y), z)) in self.cross_scratch.iter_mut().zip(sources) {
            *sum = c + wx * x + wy * y + wz * z;
        }
        FieldSlice::CorrectStates(axis)
    }

    /// Completes J·hᵀ at ε for an axis, and corrects the states and the drift of yaw.
    pub(super) fn correct_states(&mut self, kalman: &Kalman, axis: u8) -> FieldSlice {
        let place = usize::from(axis);
        let row = self.row(place);
        let [wx, wy, wz] = row.iron;
        kalman.add_tilt_columns(row.tilt, &mut self.cross_scratch);
        let own = |state: usize| self.own_scratch.get(state).copied().unwrap_or(0.0);
        let [to_north, to_east, ..] = self.cross_scratch;
        let variance = own(FIELD + place)
            + own(DEVIATION + place)
            + wx * own(IRON)
            + wy * own(IRON + 1)
            + wz * own(IRON + 2)
            + row.tilt[0] * to_north
            + row.tilt[1] * to_east
            + self.noise_ut2;
        self.inverse_variance = 1.0 / variance;
        let innovation = self.innovation().into_iter().nth(place).unwrap_or(0.0);
        let gain = innovation * self.inverse_variance;
        if self.estimate.is_some_and(|estimate| estimate.is_valid) {
            let ([x, y, ..], [to_x, to_y, ..]) = (self.state, self.own_scratch);
            let turn_rad = gain * (x * to_y - y * to_x) / (square(x) + square(y));
            self.drift_rad_s += turn_rad / self.tuning.drift_memory_s;
        }
        for (state, entry) in self.state.iter_mut().zip(&self.own_scratch) {
            *state += gain * entry;
        }
        FieldSlice::Correct(axis, 0)
    }

    /// Corrects rows of O and X: J ← J − J·hᵀ·h·J/s.
    pub(super) fn correct_rows(&mut self, axis: u8, first: u8) -> FieldSlice {
        let start = usize::from(first);
        // The last rows have no row of X.
        let rows = match start {
            0..4 => 2,
            4..CORRELATED => 1,
            _ => 3,
        };
        for (row, own) in self.own_scratch.iter().enumerate().skip(start).take(rows) {
            let gain = own * self.inverse_variance;
            self.covariance.subtract(row, gain, &self.own_scratch);
            self.covariance
                .subtract_cross(row, gain, &self.cross_scratch);
        }
        if start + rows < STATES {
            FieldSlice::Correct(axis, first + rows as u8)
        } else if axis < 2 {
            FieldSlice::Project(axis + 1)
        } else {
            FieldSlice::Check
        }
    }

    /// Checks the numbers. Readings that no compass delivers may make them unusable.
    pub(super) fn check(&mut self) -> FieldSlice {
        let sum: f32 = self.state.iter().map(|state| state.abs()).sum();
        // A NaN fails the comparison.
        if self.covariance.is_sound() && sum < 1.0e5 {
            return FieldSlice::Finish;
        }
        self.restart();
        FieldSlice::Idle
    }

    /// Turns the field to the present level frame, and updates the heading and its σ.
    pub(super) fn finish(&mut self, kalman: &Kalman) -> FieldSlice {
        self.turn_field(self.late_turn_rad);
        let [cx, cy, ..] = self.state;
        let covariance = &self.covariance;
        let variance = square(cy) * covariance.entry(0, 0) + square(cx) * covariance.entry(1, 1)
            - 2.0 * cx * cy * covariance.entry(1, 0);
        let horizontal = square(cx) + square(cy) + 1.0e-3;
        // The open interval comes after the step.
        let unseen_rad2 = self.intervals.open(self.open).unseen_rad2;
        let variance = variance / square(horizontal) + unseen_rad2;
        let sigma_rad = if horizontal > LEAST_HORIZONTAL_UT2 {
            libm::sqrtf(larger(variance, 0.0))
        } else {
            f32::INFINITY
        };
        let tuning = self.tuning;
        self.silent_s = if self.closed().has_readings() {
            0.0
        } else {
            self.silent_s + self.closed().duration_s
        };
        let is_tilt_known = self.is_tilt_known(kalman);
        if !is_tilt_known {
            // A correction of the tilt looks like a turn: turns count from the attitude after it.
            self.since_first_s = f32::INFINITY;
        }
        let verified_after_s = if self.is_iron_known {
            tuning.verified_after_s
        } else {
            tuning.verified_uncalibrated_after_s
        };
        let estimate = (sigma_rad < tuning.known_rad).then(|| HeadingEstimate {
            yaw_offset_rad: wrap_pi(self.declination_rad - libm::atan2f(cy, cx)),
            sigma_rad,
            is_valid: sigma_rad < tuning.valid_rad
                && is_tilt_known
                && self.inconsistency < tuning.valid_inconsistency
                && self.silent_s < tuning.valid_silence_s
                && self.verified_s > verified_after_s,
        });
        self.set_estimate(estimate);
        FieldSlice::Idle
    }

    /// Inflates σ of the published heading by this variance of yaw, rad²: motion that no sample
    /// has shown. The step that takes it into account comes later.
    #[cold]
    #[inline(never)]
    pub(super) fn inflate_estimate(&mut self, kalman: &Kalman, variance: f32) {
        let Some(mut estimate) = self.estimate else {
            return;
        };
        estimate.sigma_rad = libm::sqrtf(square(estimate.sigma_rad) + variance);
        estimate.is_valid = estimate.is_valid
            && estimate.sigma_rad < self.tuning.valid_rad
            && self.is_tilt_known(kalman);
        self.set_estimate(Some(estimate));
    }

    /// Returns whether the tilt is certain enough for a valid heading.
    fn is_tilt_known(&self, kalman: &Kalman) -> bool {
        kalman.tilt_variance_rad2() < square(self.tuning.valid_tilt_rad)
    }
}
