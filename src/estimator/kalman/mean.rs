//! The mean: attitude, what is known of the sensor, and the increments between two earth steps.
//!
//! Increments are summed in body axes at every sample, which costs little. Earth axes, where gravity
//! and velocity are, are visited every few samples.

use super::matrix::{CONSTANTS, MOVING, Transition};
use super::{LARGEST_BIAS_RAD_S, LARGEST_FORCE_BIAS_M_S2, LARGEST_MATRIX_ERROR};
use crate::attitude::{Quaternion, Vector3};
use crate::state::Exchange;

const UNITY: [Vector3; 3] = [
    Vector3::new(1.0, 0.0, 0.0),
    Vector3::new(0.0, 1.0, 0.0),
    Vector3::new(0.0, 0.0, 1.0),
];

fn clamp(vector: Vector3, limit: f32) -> Vector3 {
    Vector3::new(
        vector.x.clamp(-limit, limit),
        vector.y.clamp(-limit, limit),
        vector.z.clamp(-limit, limit),
    )
}

/// The state of the motion and of the sensor, as far as it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct Mean {
    /// Body to earth at the end of the last earth step, in the time of the motion.
    pub(super) attitude: Quaternion,
    /// Gyroscope bias.
    pub(super) bias_rad_s: Vector3,
    /// Accelerometer bias.
    pub(super) force_bias_m_s2: Vector3,
    /// C, by rows: what turns readings without bias into rates.
    pub(super) matrix: [Vector3; 3],
    /// C·b, so that a rate is one product and one difference.
    offset_rad_s: Vector3,
    /// Horizontal velocity at the last covariance step.
    pub(super) velocity_m_s: [f32; 2],
    /// The last sample's rate, corrected.
    pub(super) rate_rad_s: Vector3,
    /// The last sample's specific force, its bias included.
    pub(super) force_m_s2: Vector3,
    /// What came together since the last earth step: angle, velocity (its bias included), time.
    turned_rad: Vector3,
    pushed_m_s: Vector3,
    elapsed_s: f32,
}

/// What happened between two earth steps.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct EarthStep {
    pub(super) duration_s: f32,
    pub(super) turned_rad: Vector3,
    pub(super) velocity_m_s: Vector3,
}

impl Mean {
    pub(super) fn exchange(&mut self, state: &mut impl Exchange) {
        state.quaternion(&mut self.attitude);
        state.vector(&mut self.bias_rad_s);
        state.vector(&mut self.force_bias_m_s2);
        for row in &mut self.matrix {
            state.vector(row);
        }
        state.vector(&mut self.offset_rad_s);
        state.numbers(&mut self.velocity_m_s);
        state.vector(&mut self.rate_rad_s);
        state.vector(&mut self.force_m_s2);
        state.vector(&mut self.turned_rad);
        state.vector(&mut self.pushed_m_s);
        state.number(&mut self.elapsed_s);
    }

    pub(super) const fn new() -> Self {
        Self {
            attitude: Quaternion::IDENTITY,
            bias_rad_s: Vector3::ZERO,
            force_bias_m_s2: Vector3::ZERO,
            matrix: UNITY,
            offset_rad_s: Vector3::ZERO,
            velocity_m_s: [0.0; 2],
            rate_rad_s: Vector3::ZERO,
            force_m_s2: Vector3::ZERO,
            turned_rad: Vector3::ZERO,
            pushed_m_s: Vector3::ZERO,
            elapsed_s: 0.0,
        }
    }

    /// C·(g − b).
    #[inline]
    pub(super) fn corrected(&self, rate: Vector3) -> Vector3 {
        let [x, y, z] = &self.matrix;
        Vector3::new(x.dot(rate), y.dot(rate), z.dot(rate)) - self.offset_rad_s
    }

    /// After a change of bias or matrix.
    pub(super) fn derive_offset(&mut self) {
        let [x, y, z] = &self.matrix;
        let b = self.bias_rad_s;
        self.offset_rad_s = Vector3::new(x.dot(b), y.dot(b), z.dot(b));
    }

    /// Forgets what has been learned of the sensor but the gyroscope's bias.
    pub(super) fn forget_sensor(&mut self) {
        self.force_bias_m_s2 = Vector3::ZERO;
        self.matrix = UNITY;
    }

    /// The first sample of all, or after a gap.
    pub(super) fn begin(&mut self, rate: Vector3, force: Vector3) {
        self.rate_rad_s = self.corrected(rate);
        self.force_m_s2 = force;
        self.turned_rad = Vector3::ZERO;
        self.pushed_m_s = Vector3::ZERO;
        self.elapsed_s = 0.0;
    }

    /// Adds what one sample and the one before say of the time between (the trapezoid rule), and
    /// gives the time since the last earth step.
    #[inline]
    pub(super) fn add(&mut self, rate: Vector3, force: Vector3, dt_s: f32) -> f32 {
        let rate = self.corrected(rate);
        let half = 0.5 * dt_s;
        self.turned_rad = self.turned_rad + (self.rate_rad_s + rate).scale(half);
        self.pushed_m_s = self.pushed_m_s + (self.force_m_s2 + force).scale(half);
        self.rate_rad_s = rate;
        self.force_m_s2 = force;
        self.elapsed_s += dt_s;
        self.elapsed_s
    }

    /// The attitude so long after the last sample.
    #[inline]
    pub(super) fn ahead(&self, delay_s: f32) -> Quaternion {
        let rotation = self.turned_rad + self.rate_rad_s.scale(delay_s);
        self.attitude
            .multiply(Quaternion::from_rotation_vector(rotation))
    }

    /// Whether accelerometer bias and gyroscope matrix are such as the parts may have: farther off,
    /// they were learned from what was no motion.
    pub(super) fn is_plausible(&self) -> bool {
        let [x, y, z] = self.matrix;
        let [ux, uy, uz] = UNITY;
        let (x, y, z) = (x - ux, y - uy, z - uz);
        self.force_bias_m_s2.is_within(LARGEST_FORCE_BIAS_M_S2)
            && x.dot(x) + y.dot(y) + z.dot(z) < LARGEST_MATRIX_ERROR * LARGEST_MATRIX_ERROR
    }

    /// Takes the error state into the mean.
    pub(super) fn correct(&mut self, moving: &[f32; MOVING], constants: &[f32; CONSTANTS]) {
        let [north, east, north_m_s, east_m_s] = *moving;
        let tilt = Quaternion::from_rotation_vector(Vector3::new(north, east, 0.0));
        self.attitude = tilt.multiply(self.attitude).normalize();
        let [velocity_north, velocity_east] = &mut self.velocity_m_s;
        *velocity_north += north_m_s;
        *velocity_east += east_m_s;
        let [bx, by, bz, matrix @ .., fx, fy, fz] = constants;
        self.bias_rad_s = clamp(
            self.bias_rad_s + Vector3::new(*bx, *by, *bz),
            LARGEST_BIAS_RAD_S,
        );
        self.force_bias_m_s2 = self.force_bias_m_s2 + Vector3::new(*fx, *fy, *fz);
        let (errors, _) = matrix.as_chunks::<3>();
        for (row, [x, y, z]) in self.matrix.iter_mut().zip(errors) {
            *row = *row - Vector3::new(*x, *y, *z);
        }
        self.derive_offset();
    }

    /// Turns the increments to earth axes, and adds to the sums of the error's transition.
    pub(super) fn step(&mut self, sums: &mut Transition) -> EarthStep {
        let t = self.elapsed_s;
        let turned = self.turned_rad;
        let before = self.attitude;
        let after = before
            .multiply(Quaternion::from_rotation_vector(turned))
            .normalize();
        // The chord's middle is the rotation half-way.
        let (w, x, y, z) = (
            before.w + after.w,
            before.x + after.x,
            before.y + after.y,
            before.z + after.z,
        );
        let s = 2.0 / (w * w + x * x + y * y + z * z).max(0.5);
        let (sx, sy, sz) = (s * x, s * y, s * z);
        let north = Vector3::new(1.0 - (y * sy + z * sz), x * sy - w * sz, x * sz + w * sy);
        let east = Vector3::new(x * sy + w * sz, 1.0 - (x * sx + z * sz), y * sz - w * sx);
        let down = Vector3::new(x * sz - w * sy, y * sz + w * sx, 1.0 - (x * sx + y * sy));
        let pushed = self.pushed_m_s - self.force_bias_m_s2.scale(t);
        let velocity = Vector3::new(north.dot(pushed), east.dot(pushed), down.dot(pushed));
        sums.vertical_m_s += velocity.z;
        let rows = [[north.x, east.x], [north.y, east.y], [north.z, east.z]];
        let add = |sum: &mut [f32; 2], [n, e]: [f32; 2], by: f32| {
            sum[0] += n * by;
            sum[1] += e * by;
        };
        let [b0, b1, b2, m @ ..] = &mut sums.tilt_per;
        let (chunks, _) = m.as_chunks_mut::<3>();
        for ((b, [m0, m1, m2]), row) in [b0, b1, b2].into_iter().zip(chunks).zip(rows) {
            add(b, row, t);
            add(m0, row, turned.x);
            add(m1, row, turned.y);
            add(m2, row, turned.z);
        }
        let step = EarthStep {
            duration_s: t,
            turned_rad: turned,
            velocity_m_s: velocity,
        };
        self.attitude = after;
        self.turned_rad = Vector3::ZERO;
        self.pushed_m_s = Vector3::ZERO;
        self.elapsed_s = 0.0;
        step
    }
}
