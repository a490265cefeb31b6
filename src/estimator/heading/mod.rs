//! Heading from a compass, beside the tilt filter.
mod covariance;
mod interval;
mod tuning;

pub use tuning::Tuning;

use super::kalman::Kalman;
use super::kalman::follow::{ERROR_STATES, FIRST_GYROSCOPE, GYROSCOPE, MEASUREMENTS};
use crate::attitude::wrap_pi;
use crate::units::{MagneticField, SECONDS_PER_MICROSECOND};
use covariance::{Covariance, CrossRow, STATES};
use interval::Interval;

const FIELD: usize = 0;
const IRON: usize = 3;
const DEVIATION: usize = 6;

/// Knowledge of the compass's hard iron before the first reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CompassKnowledge {
    /// Nothing.
    #[default]
    Factory,
    /// Calibrated.
    Calibrated,
}

impl CompassKnowledge {
    /// Returns σ of the hard iron per axis, µT.
    pub const fn sigma_ut(self) -> f32 {
        match self {
            Self::Factory => 200.0,
            Self::Calibrated => 0.5,
        }
    }
}

/// Next part of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
enum Phase {
    /// Waits for the tilt filter to begin a covariance step.
    Idle,
    /// Waits for it to end that step.
    Waiting,
    /// The step's propagation, from this row on.
    Propagate(usize),
    Prepare,
    /// The step's measurement of this index, from this row on.
    Follow(usize, usize),
    /// The covariance of the field states by the step's measurements.
    Close,
    /// The drift of yaw by this parameter.
    Drift(usize),
    TurnField,
    Predict,
    Gate,
    Correct(usize),
    CorrectRows(usize, usize),
    Finish,
}

/// Heading of the level frame, and its σ.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HeadingEstimate {
    /// Heading minus yaw, rad.
    pub yaw_offset_rad: f32,
    /// σ of the heading, rad.
    pub sigma_rad: f32,
    /// True if the heading is valid.
    pub is_valid: bool,
}

/// The heading filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heading {
    tuning: &'static Tuning,
    knowledge: CompassKnowledge,
    declination_rad: f32,
    state: [f32; STATES],
    covariance: Covariance,
    phase: Phase,
    elapsed_s: f32,
    seen_s: f32,
    interval: Interval,
    closed: Interval,
    before: [[f32; STATES]; MEASUREMENTS],
    column: CrossRow,
    own: [f32; STATES],
    inverse: f32,
    activity: f32,
    excess: f32,
    noise: f32,
    tilt_sigma: f32,
    mean_innovation: f32,
    mean_length: f32,
    misfit_s: f32,
    age_s: f32,
    last_length: f32,
    field_reading: [f32; 3],
    estimate: Option<HeadingEstimate>,
    /// Restarts.
    pub restarts: u32,
}

impl Heading {
    /// Creates a filter.
    pub fn new(knowledge: CompassKnowledge) -> Self {
        Self::with_tuning(knowledge, &Tuning::DEFAULT)
    }

    /// Creates a filter with this tuning.
    pub fn with_tuning(knowledge: CompassKnowledge, tuning: &'static Tuning) -> Self {
        let mut filter = Self {
            tuning,
            knowledge,
            declination_rad: 0.0,
            state: [0.0; STATES],
            covariance: Covariance::ZERO,
            phase: Phase::Idle,
            elapsed_s: 0.0,
            seen_s: 0.0,
            interval: Interval::EMPTY,
            closed: Interval::EMPTY,
            before: [[0.0; STATES]; MEASUREMENTS],
            column: [0.0; ERROR_STATES],
            own: [0.0; STATES],
            inverse: 0.0,
            activity: 0.0,
            excess: 0.0,
            noise: 0.0,
            tilt_sigma: 0.0,
            mean_innovation: 0.0,
            mean_length: 0.0,
            misfit_s: 0.0,
            age_s: 0.0,
            last_length: 0.0,
            field_reading: [0.0; 3],
            estimate: None,
            restarts: 0,
        };
        filter.reset_field();
        filter.reset_iron(square(knowledge.sigma_ut()));
        filter
    }

    /// Returns the heading.
    pub fn estimate(&self) -> Option<HeadingEstimate> {
        self.estimate
    }

    /// Returns the states.
    pub fn states(&self) -> &[f32; 9] {
        &self.state
    }

    fn reset_field(&mut self) {
        for axis in 0..3 {
            self.state[FIELD + axis] = 0.0;
            self.state[DEVIATION + axis] = 0.0;
            self.covariance
                .reset(FIELD + axis, square(self.tuning.start_field_ut));
            self.covariance
                .reset(DEVIATION + axis, square(self.tuning.deviation_ut));
        }
        self.estimate = None;
        self.mean_innovation = 0.0;
        self.mean_length = 0.0;
        self.misfit_s = 0.0;
        self.excess = 0.0;
        self.age_s = 0.0;
    }

    fn reset_iron(&mut self, variance: f32) {
        for axis in 0..3 {
            self.covariance.reset(IRON + axis, variance);
        }
    }

    /// Adds a reading.
    pub fn add_field(&mut self, kalman: &Kalman, field: MagneticField, age_us: u32) {
        let [x, y, z] = field.ut;
        if !(x.abs() + y.abs() + z.abs() < 1.0e4) || !kalman.has_tilt() {
            return;
        }
        let age_s = age_us as f32 * SECONDS_PER_MICROSECOND;
        self.field_reading = field.ut;
        self.interval.add_reading(kalman, field, age_s);
    }

    /// Follows the tilt filter, after each of its samples.
    pub fn follow(&mut self, kalman: &Kalman, dt_s: f32) {
        self.elapsed_s += dt_s;
        if kalman.is_at_earth_step() {
            self.interval.add_earth_step(kalman, self.elapsed_s);
            self.elapsed_s = 0.0;
            self.interval.unseen_rad2 = kalman.unseen_tilt_rad2().max(self.interval.unseen_rad2);
        }
        if kalman.interval_s() == 0.0 && self.interval.duration_s > 0.0 {
            self.close(kalman);
        }
        if self.phase == Phase::Waiting && !kalman.is_step_under_way() {
            self.phase = Phase::Propagate(0);
        }
        while !matches!(self.phase, Phase::Waiting | Phase::Idle) {
            self.slice(kalman);
        }
    }

    fn close(&mut self, kalman: &Kalman) {
        self.closed = self.interval;
        self.interval = Interval::EMPTY;
        if kalman.is_motion_reset() {
            for state in 0..FIRST_GYROSCOPE {
                self.covariance.scale_cross(state, 0.0);
            }
            if kalman.are_parameters_reset() {
                for state in FIRST_GYROSCOPE..ERROR_STATES {
                    self.covariance.scale_cross(state, 0.0);
                }
            }
            self.reset_field();
            self.phase = Phase::Idle;
            return;
        }
        self.phase = Phase::Waiting;
    }

    fn slice(&mut self, kalman: &Kalman) {
        self.phase = match self.phase {
            Phase::Idle | Phase::Waiting => return,
            Phase::Propagate(row) => {
                if let Some(entries) = self.covariance.cross.get_mut(row) {
                    kalman.propagate_row(entries);
                    Phase::Propagate(row + 1)
                } else {
                    Phase::Prepare
                }
            }
            Phase::Prepare => {
                let (relaxed, factor) = kalman.relaxed();
                self.covariance.scale_cross(relaxed, factor);
                if kalman.is_velocity_reset() {
                    self.covariance.scale_cross(2, 0.0);
                    self.covariance.scale_cross(3, 0.0);
                }
                for (index, before) in self.before.iter_mut().enumerate() {
                    if let Some(followed) = kalman.followed(index) {
                        for (entry, row) in before.iter_mut().zip(&self.covariance.cross) {
                            *entry = row[followed.state] * followed.weight;
                        }
                    }
                }
                Phase::Follow(0, 0)
            }
            Phase::Follow(index, row) => self.follow_measurement(kalman, index, row),
            Phase::Close => {
                for (index, before) in self.before.iter().enumerate() {
                    let Some(followed) = kalman.followed(index) else {
                        break;
                    };
                    let mut column = [0.0; STATES];
                    for (entry, row) in column.iter_mut().zip(&self.covariance.cross) {
                        *entry = row[followed.state];
                    }
                    for (row, gain) in before.iter().enumerate() {
                        self.covariance.subtract(row, *gain, &column);
                        self.state[row] += gain * followed.residual;
                    }
                }
                self.column = [0.0; ERROR_STATES];
                Phase::Drift(0)
            }
            Phase::Drift(parameter) => {
                if parameter < GYROSCOPE {
                    let mut column = [0.0; ERROR_STATES];
                    kalman.copy_column(FIRST_GYROSCOPE + parameter, &mut column);
                    let effect = self.closed.yaw[parameter];
                    for (sum, entry) in self.column.iter_mut().zip(&column) {
                        *sum += effect * entry;
                    }
                    Phase::Drift(parameter + 1)
                } else {
                    Phase::TurnField
                }
            }
            Phase::TurnField => {
                self.turn_field(kalman);
                Phase::Predict
            }
            Phase::Predict => {
                self.predict(kalman);
                if self.closed.readings > 0.0 {
                    Phase::Gate
                } else {
                    Phase::Finish
                }
            }
            Phase::Gate => {
                if self.gate(kalman) {
                    Phase::Correct(0)
                } else {
                    Phase::Finish
                }
            }
            Phase::Correct(axis) => {
                if axis < 3 {
                    self.correct(kalman, axis);
                    Phase::CorrectRows(axis, 0)
                } else {
                    Phase::Finish
                }
            }
            Phase::CorrectRows(axis, row) => {
                if row < STATES {
                    let gain = self.own[row] * self.inverse;
                    self.covariance.subtract(row, gain, &self.own);
                    self.covariance.subtract_cross(row, gain, &self.column);
                    Phase::CorrectRows(axis, row + 1)
                } else {
                    Phase::Correct(axis + 1)
                }
            }
            Phase::Finish => {
                self.finish();
                Phase::Idle
            }
        };
    }

    fn follow_measurement(&mut self, kalman: &Kalman, index: usize, row: usize) -> Phase {
        let Some(followed) = kalman.followed(index) else {
            return Phase::Close;
        };
        if row == 0 {
            kalman.copy_column(followed.state, &mut self.column);
        }
        if row < STATES {
            let gain = self.before[index][row];
            self.covariance.subtract_cross(row, gain, &self.column);
            Phase::Follow(index, row + 1)
        } else {
            Phase::Follow(index + 1, 0)
        }
    }

    /// Turns the field by the drift of yaw.
    fn turn_field(&mut self, kalman: &Kalman) {
        let yaw = &self.closed.yaw;
        let [x, y, ..] = self.state;
        let [gx, gy] = [-y, x];
        let variance: f32 = yaw
            .iter()
            .zip(&self.column[FIRST_GYROSCOPE..])
            .map(|(effect, entry)| effect * entry)
            .sum();
        let unseen = self.closed.unseen_rad2;
        let noise = kalman.turn_noise_rad2(self.closed.duration_s, self.closed.squared_rate)
            + square(self.tuning.yaw_walk) * self.closed.duration_s
            + unseen;
        let variance = variance + noise;
        let mut own = [0.0; STATES];
        for (entry, row) in own.iter_mut().zip(&self.covariance.cross) {
            let parameters = &row[FIRST_GYROSCOPE..];
            *entry = yaw.iter().zip(parameters).map(|(a, b)| a * b).sum();
        }
        let c = &mut self.covariance;
        for row in 0..STATES {
            match row {
                0 => c.add(0, 0, 2.0 * gx * own[0] + gx * gx * variance),
                1 => {
                    c.add(1, 1, 2.0 * gy * own[1] + gy * gy * variance);
                    c.add(1, 0, gy * own[0] + gx * own[1] + gx * gy * variance);
                }
                _ => {
                    c.add(row, 0, gx * own[row]);
                    c.add(row, 1, gy * own[row]);
                }
            }
        }
        c.subtract_cross(0, -gx, &self.column);
        c.subtract_cross(1, -gy, &self.column);
        let corrections = kalman.gyroscope_correction();
        let turn: f32 = yaw.iter().zip(corrections).map(|(a, b)| a * b).sum();
        self.state[0] += gx * turn;
        self.state[1] += gy * turn;
    }

    /// Time update of the field states.
    fn predict(&mut self, kalman: &Kalman) {
        let tuning = self.tuning;
        let t = self.closed.duration_s;
        let mut north = [0.0; ERROR_STATES];
        let mut east = [0.0; ERROR_STATES];
        kalman.copy_column(0, &mut north);
        kalman.copy_column(1, &mut east);
        let tilt = north[0] + east[1];
        self.tilt_sigma = libm::sqrtf(tilt);
        let [cx, cy, cz, ..] = self.state;
        let coupling =
            square(tuning.coupling) * tilt * tilt * (cx * cx + cy * cy + cz * cz) * t;
        for axis in 0..3 {
            self.covariance
                .add(axis, axis, square(tuning.field_walk) * t + coupling);
            let walk = square(tuning.hard_iron_walk) + tuning.excess_to_hard_iron * self.excess;
            self.covariance.add(IRON + axis, IRON + axis, walk * t);
        }
        let motion = libm::sqrtf(self.closed.squared_rate / t) / tuning.moving_rate_rad_s
            + libm::sqrtf(self.closed.squared_acceleration / t) / tuning.moving_acceleration_m_s2;
        let motion = if kalman.is_still() { 0.0 } else { motion.min(1.0) };
        let decay = (t / tuning.moving_hold_s).min(1.0);
        self.activity = motion.max(self.activity * (1.0 - decay));
        let moving = if self.activity >= tuning.least_motion {
            self.activity / tuning.deviation_moving_s
        } else {
            0.0
        };
        let keep = 1.0 / (1.0 + t * (1.0 / tuning.deviation_still_s + moving));
        let variance = square(tuning.deviation_ut) + tuning.excess_to_deviation * self.excess;
        for state in DEVIATION..DEVIATION + 3 {
            self.covariance.scale(state, keep);
            self.covariance
                .add(state, state, variance * (1.0 - keep * keep));
            self.state[state] *= keep;
        }
    }

    /// Returns the measurement's row over hard iron and tilt.
    fn mean_turn(&self, axis: usize) -> [f32; 3] {
        self.closed.turn[axis].map(|entry| entry / self.closed.readings)
    }

    /// Measured field in level axes without hard iron.
    fn measured(&self) -> [f32; 3] {
        let [bx, by, bz] = [self.state[3], self.state[4], self.state[5]];
        [0, 1, 2].map(|axis| {
            let [x, y, z] = self.mean_turn(axis);
            self.closed.field_ut[axis] / self.closed.readings - x * bx - y * by - z * bz
        })
    }

    fn tilt_row(&self, axis: usize) -> [f32; 2] {
        let [x, y, z] = self.measured();
        match axis {
            0 => [0.0, -z],
            1 => [z, 0.0],
            _ => [-y, x],
        }
    }

    fn innovation(&self) -> [f32; 3] {
        let v = self.measured();
        [0, 1, 2].map(|axis| v[axis] - self.state[axis] - self.state[DEVIATION + axis])
    }

    /// Computes P·hᵀ for an axis; returns h·P·hᵀ.
    fn project(&mut self, kalman: &Kalman, axis: usize) -> f32 {
        let [wx, wy, wz] = self.mean_turn(axis);
        let tilt = self.tilt_row(axis);
        let c = &self.covariance;
        for row in 0..STATES {
            self.own[row] = c.entry(row, FIELD + axis)
                + c.entry(row, DEVIATION + axis)
                + wx * c.entry(row, IRON)
                + wy * c.entry(row, IRON + 1)
                + wz * c.entry(row, IRON + 2)
                + tilt[0] * c.cross[row][0]
                + tilt[1] * c.cross[row][1];
        }
        let mut north = [0.0; ERROR_STATES];
        let mut east = [0.0; ERROR_STATES];
        kalman.copy_column(0, &mut north);
        kalman.copy_column(1, &mut east);
        for state in 0..ERROR_STATES {
            self.column[state] = c.cross[FIELD + axis][state]
                + c.cross[DEVIATION + axis][state]
                + wx * c.cross[IRON][state]
                + wy * c.cross[IRON + 1][state]
                + wz * c.cross[IRON + 2][state]
                + tilt[0] * north[state]
                + tilt[1] * east[state];
        }
        let own = &self.own;
        own[FIELD + axis]
            + own[DEVIATION + axis]
            + wx * own[IRON]
            + wy * own[IRON + 1]
            + wz * own[IRON + 2]
            + tilt[0] * self.column[0]
            + tilt[1] * self.column[1]
    }

    fn gate(&mut self, kalman: &Kalman) -> bool {
        let tuning = self.tuning;
        let t = self.closed.duration_s;
        let noise = square(tuning.noise_ut)
            + tuning.noise_per_rate * self.closed.squared_rate / t;
        let y = self.innovation();
        let squared: f32 = y.iter().map(|y| y * y).sum();
        let trace: f32 = (0..3).map(|axis| self.project(kalman, axis)).sum();
        let mut excess = ((squared - tuning.gate * (trace + 3.0 * noise)) / 3.0).max(0.0);
        let [bx, by, bz] = [self.state[3], self.state[4], self.state[5]];
        let [mx, my, mz] = self.field_reading;
        let body = square(mx - bx) + square(my - by) + square(mz - bz);
        let [cx, cy, cz, ..] = self.state;
        let length = libm::sqrtf(body) - libm::sqrtf(cx * cx + cy * cy + cz * cz);
        let share = (t / tuning.restart_average_s).min(1.0);
        self.age_s += t;
        self.mean_innovation += share * (squared - self.mean_innovation);
        self.mean_length += share * (length * length - self.mean_length);
        let contradicts = self.age_s > 5.0
            && self.mean_innovation
                > tuning.restart_ratio * self.mean_length + square(tuning.restart_floor_ut);
        self.misfit_s = if contradicts { self.misfit_s + t } else { 0.0 };
        if self.misfit_s > tuning.restart_after_s {
            self.restarts += 1;
            self.reset_field();
            let iron =
                square(self.knowledge.sigma_ut()) + square(tuning.restart_hard_iron_ut);
            self.reset_iron(iron);
            return false;
        }
        excess = excess.min(1.0e6);
        let decayed = self.excess * (1.0 - (t / tuning.excess_s).min(1.0));
        self.excess = decayed.max(excess.min(square(tuning.largest_excess_ut)));
        self.noise = noise + tuning.excess_to_noise * excess;
        true
    }

    fn correct(&mut self, kalman: &Kalman, axis: usize) {
        let variance = self.project(kalman, axis) + self.noise;
        self.inverse = 1.0 / variance;
        let gain = self.innovation()[axis] * self.inverse;
        for (state, column) in self.state.iter_mut().zip(&self.own) {
            *state += gain * column;
        }
    }

    fn finish(&mut self) {
        let [cx, cy, ..] = self.state;
        let c = &self.covariance;
        let variance = cy * cy * c.entry(0, 0) + cx * cx * c.entry(1, 1)
            - 2.0 * cx * cy * c.entry(0, 1);
        let sigma_rad = libm::sqrtf(variance.max(0.0)) / (cx * cx + cy * cy + 1.0e-3);
        let yaw_offset_rad = wrap_pi(self.declination_rad - libm::atan2f(cy, cx));
        self.estimate = (sigma_rad < 0.5).then_some(HeadingEstimate {
            yaw_offset_rad,
            sigma_rad,
            is_valid: sigma_rad < 0.25,
        });
    }
}

fn square(number: f32) -> f32 {
    number * number
}
