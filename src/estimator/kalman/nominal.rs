//! The nominal state: attitude, velocity, the sensor's parameters, and the increments since the
//! last earth step.
//!
//! Each sample adds its increments in body axes, which is cheap. Every few samples an *earth step*
//! turns the sums to earth axes, where gravity and velocity are.

use super::prior::FIRST_WITH_PRIOR;
use super::propagation::{DYNAMIC, PARAMETERS, Transition};
use super::tuning::{
    LARGEST_ACCELEROMETER_BIAS_M_S2, LARGEST_GYROSCOPE_BIAS_RAD_S, LARGEST_MATRIX_ERROR,
};
use crate::attitude::{Quaternion, Vector3};
use crate::estimator::arithmetic::{larger, square};
use crate::serialize::StateVisitor;

const IDENTITY: [Vector3; 3] = [
    Vector3::new(1.0, 0.0, 0.0),
    Vector3::new(0.0, 1.0, 0.0),
    Vector3::new(0.0, 0.0, 1.0),
];

/// The nominal state.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct NominalState {
    /// Body to earth at the last earth step, at the time of the motion (before the sensor's delay).
    pub(super) attitude: Quaternion,
    /// Horizontal velocity at the last covariance step, north and east.
    pub(super) velocity_m_s: [f32; 2],
    /// Bias b of the gyroscope, body axes.
    pub(super) gyroscope_bias_rad_s: Vector3,
    /// Bias a of the accelerometer, body axes.
    pub(super) accelerometer_bias_m_s2: Vector3,
    /// Rows of C, which turns readings without bias into rates.
    gyroscope_matrix: [Vector3; 3],
    /// C·b, so that a rate costs one product and one difference.
    rate_offset_rad_s: Vector3,
    /// The last sample's rate ω = C·(g − b).
    pub(super) rate_rad_s: Vector3,
    /// The last sample's specific force, bias included.
    pub(super) force_m_s2: Vector3,
    /// Rotation since the last earth step, body axes.
    pub(super) rotation_rad: Vector3,
    /// Integral of the specific force since the last earth step, body axes, bias included.
    force_integral_m_s: Vector3,
    /// Time since the last earth step, s.
    pub(super) elapsed_s: f32,
}

/// Increments of one earth step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EarthStep {
    /// Length of the step.
    pub(super) duration_s: f32,
    /// Rotation during the step, body axes.
    pub(super) rotation_rad: Vector3,
    /// Integral of the specific force during the step, body axes, bias included.
    pub(super) force_integral_body_m_s: Vector3,
    /// Integral of the specific force during the step, without bias: north, east, down.
    pub(super) force_integral_ned_m_s: Vector3,
}

impl NominalState {
    /// Creates the state of a perfect sensor at rest in the identity attitude.
    pub(super) const fn new() -> Self {
        Self {
            attitude: Quaternion::IDENTITY,
            velocity_m_s: [0.0; 2],
            gyroscope_bias_rad_s: Vector3::ZERO,
            accelerometer_bias_m_s2: Vector3::ZERO,
            gyroscope_matrix: IDENTITY,
            rate_offset_rad_s: Vector3::ZERO,
            rate_rad_s: Vector3::ZERO,
            force_m_s2: Vector3::ZERO,
            rotation_rad: Vector3::ZERO,
            force_integral_m_s: Vector3::ZERO,
            elapsed_s: 0.0,
        }
    }

    /// Returns the rate of a gyroscope reading: C·(g − b).
    #[inline]
    fn rate_of(&self, reading: Vector3) -> Vector3 {
        multiply(&self.gyroscope_matrix, reading) - self.rate_offset_rad_s
    }

    /// Returns the rate of a reading at a start or after a pause: out of line, which takes less
    /// flash.
    #[inline(never)]
    pub(super) fn rate_after_pause(&self, reading: Vector3) -> Vector3 {
        self.rate_of(reading)
    }

    /// Sets the gyroscope's bias.
    pub(super) fn set_gyroscope_bias(&mut self, bias_rad_s: Vector3) {
        self.gyroscope_bias_rad_s = bias_rad_s;
        self.rate_offset_rad_s = multiply(&self.gyroscope_matrix, bias_rad_s);
    }

    /// Resets the parameters to those of a perfect sensor, but for the gyroscope's bias.
    pub(super) fn reset_parameters(&mut self) {
        self.accelerometer_bias_m_s2 = Vector3::ZERO;
        self.gyroscope_matrix = IDENTITY;
        self.set_gyroscope_bias(self.gyroscope_bias_rad_s);
    }

    /// Scales the deviation of a parameter from that of a perfect sensor. The gyroscope's bias
    /// stays.
    pub(super) fn scale_parameter(&mut self, parameter: usize, factor: f32) {
        let Some(index) = parameter.checked_sub(FIRST_WITH_PRIOR) else {
            return;
        };
        let (row, column) = (index / 3, index % 3);
        let perfect = if row == column { 1.0 } else { 0.0 };
        let vector = match self.gyroscope_matrix.get_mut(row) {
            Some(vector) => vector,
            // The fourth row of the parameters.
            None => &mut self.accelerometer_bias_m_s2,
        };
        let entry = match column {
            0 => &mut vector.x,
            1 => &mut vector.y,
            _ => &mut vector.z,
        };
        *entry = perfect + factor * (*entry - perfect);
        self.set_gyroscope_bias(self.gyroscope_bias_rad_s);
    }

    /// Starts the integration at the first sample, or the first after a gap.
    pub(super) fn start(&mut self, rate_reading: Vector3, force_m_s2: Vector3) {
        self.rate_rad_s = self.rate_after_pause(rate_reading);
        self.force_m_s2 = force_m_s2;
        self.rotation_rad = Vector3::ZERO;
        self.force_integral_m_s = Vector3::ZERO;
        self.elapsed_s = 0.0;
    }

    /// Prepares the integration over a pause, so that no single sample counts for all of it: the
    /// mean rate and force become the shorter vectors of both ends. `rate_rad_s` and `force_m_s2`
    /// are those of the sample after the pause.
    pub(super) fn bridge_pause(&mut self, rate_rad_s: Vector3, force_m_s2: Vector3) {
        bridge(&mut self.rate_rad_s, rate_rad_s);
        bridge(&mut self.force_m_s2, force_m_s2);
    }

    /// Integrates from the previous sample to this one by the trapezoid rule.
    ///
    /// Adds the terms for coning (½·θ×Δθ) and sculling (½·(θ×Δv + v×Δθ)).
    /// Returns the time since the last earth step, s.
    #[inline]
    pub(super) fn integrate(
        &mut self,
        rate_reading: Vector3,
        force_m_s2: Vector3,
        dt_s: f32,
    ) -> f32 {
        let rate_rad_s = self.rate_of(rate_reading);
        let quarter_s = 0.25 * dt_s;
        // ½·Δθ and ½·Δv.
        let half_angle = (self.rate_rad_s + rate_rad_s).scale(quarter_s);
        let half_velocity = (self.force_m_s2 + force_m_s2).scale(quarter_s);
        let (rotation, velocity) = (self.rotation_rad, self.force_integral_m_s);
        self.rotation_rad = rotation + half_angle + half_angle + rotation.cross(half_angle);
        self.force_integral_m_s = velocity
            + half_velocity
            + half_velocity
            + rotation.cross(half_velocity)
            + velocity.cross(half_angle);
        self.rate_rad_s = rate_rad_s;
        self.force_m_s2 = force_m_s2;
        self.elapsed_s += dt_s;
        self.elapsed_s
    }

    /// Returns the attitude this long after the last sample's motion, at its rate.
    #[inline(always)]
    pub(super) fn extrapolate(&self, delay_s: f32) -> Quaternion {
        let rotation_rad = self.rotation_rad + self.rate_rad_s.scale(delay_s);
        self.attitude
            .multiply(Quaternion::from_rotation_vector(rotation_rad))
    }

    /// Turns the increments to earth axes, advances the attitude, and adds to the interval's
    /// transition.
    pub(super) fn step_in_earth_axes(&mut self, transition: &mut Transition) -> EarthStep {
        let t = self.elapsed_s;
        let rotation_rad = self.rotation_rad;
        let after = self
            .attitude
            .multiply(Quaternion::from_rotation_vector(rotation_rad))
            .normalize();
        let [north, east, down] = rows_half_way(self.attitude, after);
        let force_integral_body_m_s = self.force_integral_m_s;
        let unbiased = force_integral_body_m_s - self.accelerometer_bias_m_s2.scale(t);
        let force_integral_ned_m_s =
            Vector3::new(north.dot(unbiased), east.dot(unbiased), down.dot(unbiased));
        transition.down_m_s += force_integral_ned_m_s.z;
        let columns = [[north.x, east.x], [north.y, east.y], [north.z, east.z]];
        let add = |sum: &mut [f32; 2], [n, e]: [f32; 2], factor: f32| {
            sum[0] += n * factor;
            sum[1] += e * factor;
        };
        // ∫R dt for the bias, ∫R·ω dt for the matrix: its rows act on the axes of the body.
        let [b0, b1, b2, matrix @ ..] = &mut transition.tilt;
        let (matrix_rows, _) = matrix.as_chunks_mut::<3>();
        for ((b, [m0, m1, m2]), column) in [b0, b1, b2].into_iter().zip(matrix_rows).zip(columns) {
            add(b, column, t);
            add(m0, column, rotation_rad.x);
            add(m1, column, rotation_rad.y);
            add(m2, column, rotation_rad.z);
        }
        self.attitude = after;
        self.rotation_rad = Vector3::ZERO;
        self.force_integral_m_s = Vector3::ZERO;
        self.elapsed_s = 0.0;
        EarthStep {
            duration_s: t,
            rotation_rad,
            force_integral_body_m_s,
            force_integral_ned_m_s,
        }
    }

    /// Moves the error state into the nominal state.
    pub(super) fn add_error(&mut self, dynamic: &[f32; DYNAMIC], parameters: &[f32; PARAMETERS]) {
        let [north, east, north_m_s, east_m_s] = *dynamic;
        // The rotation's series to the second order.
        let w = 1.0 - 0.125 * (square(north) + square(east));
        let tilt = Quaternion::new(w, 0.5 * north, 0.5 * east, 0.0);
        self.attitude = tilt.multiply(self.attitude).normalize();
        let [velocity_north, velocity_east] = &mut self.velocity_m_s;
        *velocity_north += north_m_s;
        *velocity_east += east_m_s;
        let [bx, by, bz, matrix @ .., ax, ay, az] = parameters;
        self.accelerometer_bias_m_s2 = self.accelerometer_bias_m_s2 + Vector3::new(*ax, *ay, *az);
        let (errors, _) = matrix.as_chunks::<3>();
        for (row, [x, y, z]) in self.gyroscope_matrix.iter_mut().zip(errors) {
            *row = *row - Vector3::new(*x, *y, *z);
        }
        let bias_rad_s = self.gyroscope_bias_rad_s + Vector3::new(*bx, *by, *bz);
        self.set_gyroscope_bias(clamp(bias_rad_s, LARGEST_GYROSCOPE_BIAS_RAD_S));
    }

    /// Returns whether accelerometer bias and gyroscope matrix are within the part's tolerances.
    pub(super) fn is_plausible(&self) -> bool {
        let [x, y, z] = self.gyroscope_matrix;
        let [ix, iy, iz] = IDENTITY;
        let (x, y, z) = (x - ix, y - iy, z - iz);
        self.accelerometer_bias_m_s2
            .is_within(LARGEST_ACCELEROMETER_BIAS_M_S2)
            && x.dot(x) + y.dot(y) + z.dot(z) < LARGEST_MATRIX_ERROR * LARGEST_MATRIX_ERROR
    }

    /// Visits every field.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            attitude,
            velocity_m_s,
            gyroscope_bias_rad_s,
            accelerometer_bias_m_s2,
            gyroscope_matrix,
            rate_offset_rad_s,
            rate_rad_s,
            force_m_s2,
            rotation_rad,
            force_integral_m_s,
            elapsed_s,
        } = self;
        visitor.quaternion(attitude);
        visitor.f32s(velocity_m_s);
        visitor.vector(gyroscope_bias_rad_s);
        visitor.vector(accelerometer_bias_m_s2);
        for row in gyroscope_matrix {
            visitor.vector(row);
        }
        visitor.vector(rate_offset_rad_s);
        visitor.vector(rate_rad_s);
        visitor.vector(force_m_s2);
        visitor.vector(rotation_rad);
        visitor.vector(force_integral_m_s);
        visitor.f32(elapsed_s);
    }
}

/// Returns the rows of the rotation matrix half-way between two attitudes: north, east, down.
fn rows_half_way(before: Quaternion, after: Quaternion) -> [Vector3; 3] {
    let middle_of_chord = Quaternion::new(
        before.w + after.w,
        before.x + after.x,
        before.y + after.y,
        before.z + after.z,
    );
    let squared_norm = larger(middle_of_chord.dot(middle_of_chord), 0.5);
    middle_of_chord.matrix_rows(squared_norm)
}

#[inline]
fn multiply([x, y, z]: &[Vector3; 3], vector: Vector3) -> Vector3 {
    Vector3::new(x.dot(vector), y.dot(vector), z.dot(vector))
}

fn clamp(vector: Vector3, limit: f32) -> Vector3 {
    Vector3::new(
        vector.x.clamp(-limit, limit),
        vector.y.clamp(-limit, limit),
        vector.z.clamp(-limit, limit),
    )
}

/// Replaces `before` so that the trapezoid of both ends has the mean of the shorter one.
#[inline(never)]
fn bridge(before: &mut Vector3, after: Vector3) {
    let is_shorter = before.dot(*before) < after.dot(after);
    let mean = if is_shorter { *before } else { after };
    *before = mean.scale(2.0) - after;
}
