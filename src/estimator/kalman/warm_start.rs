//! Start that continues an earlier run.

use crc::{CRC_32_ISO_HDLC, Crc, NoTable};

use crate::attitude::{Quaternion, Vector3};

/// Number of values of a [`WarmStart`].
pub(crate) const VALUES: usize = 15;
/// Largest error of the squared length of the attitude's quaternion.
const LARGEST_LENGTH_ERROR: f32 = 1.0e-3;
/// Largest magnitude of a value, in its unit: that of the squared velocity at 1 km/s.
const LARGEST: f32 = 1.0e6;
/// Layout of the byte form. A change of [`WarmStart::values`] needs another number.
const LAYOUT: u8 = 1;

static CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// State of an earlier run, from which the filter continues.
///
/// Its byte form is for memory that survives a reset. Damaged or blank bytes give `None`:
///
/// ```
/// use aplomb::attitude::{Quaternion, Vector3};
/// use aplomb::estimator::kalman::WarmStart;
///
/// let start = WarmStart {
///     attitude: Quaternion::IDENTITY,
///     tilt_sigma_rad: 0.01,
///     bias_rad_s: Vector3::new(0.01, -0.02, 0.0),
///     bias_change_rad_s: Vector3::ZERO,
///     bias_sigma_rad_s: 0.001,
///     accelerometer_bias_m_s2: [0.1, 0.0],
///     squared_velocity_m2_s2: 0.0,
/// };
/// let mut bytes = start.to_bytes();
/// assert_eq!(WarmStart::from_bytes(&bytes), Some(start));
/// bytes[7] ^= 0x10;
/// assert_eq!(WarmStart::from_bytes(&bytes), None);
/// assert_eq!(WarmStart::from_bytes(&[0; WarmStart::LENGTH]), None);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct WarmStart {
    /// Body to earth.
    pub attitude: Quaternion,
    /// σ of the tilt, both axes together, rad: π if it is unknown. From 30° on, the specific
    /// force sets the tilt.
    pub tilt_sigma_rad: f32,
    /// The gyroscope's bias in body axes, rad/s.
    pub bias_rad_s: Vector3,
    /// Change of the bias since the last rest, or else since it was stored, rad/s. Motion confirms
    /// the bias only if it then is within 0.2 °/s of that rest's.
    pub bias_change_rad_s: Vector3,
    /// σ of the bias per axis, rad/s. From 0.5 °/s on, the bias is not known.
    pub bias_sigma_rad_s: f32,
    /// Bias of the accelerometer along the body's forward and right axes, m/s².
    pub accelerometer_bias_m_s2: [f32; 2],
    /// Mean squared horizontal velocity of the last seconds, (m/s)²: 0 for a vehicle that has
    /// stayed in place. The filter assumes 2 at least, because the vehicle may have begun to move.
    /// The faster it moves, the less its accelerations say of the tilt.
    pub squared_velocity_m2_s2: f32,
}

impl WarmStart {
    /// Length of the byte form.
    pub const LENGTH: usize = 4 * (VALUES + 1);

    /// Returns the byte form: the values as little-endian `f32`, and a CRC-32.
    pub fn to_bytes(&self) -> [u8; Self::LENGTH] {
        let mut bytes = [0; Self::LENGTH];
        let (words, _) = bytes.as_chunks_mut();
        for (word, value) in words.iter_mut().zip(self.values()) {
            *word = value.to_le_bytes();
        }
        let sum = checksum(&bytes).to_le_bytes();
        if let Some(last) = bytes.last_chunk_mut() {
            *last = sum;
        }
        bytes
    }

    /// Returns the state that these bytes hold; `None` if they are damaged or of another layout.
    pub fn from_bytes(bytes: &[u8; Self::LENGTH]) -> Option<Self> {
        let (words, _) = bytes.as_chunks();
        let mut values = [0.0; VALUES];
        for (value, word) in values.iter_mut().zip(words) {
            *value = f32::from_le_bytes(*word);
        }
        let is_whole = bytes.last_chunk() == Some(&checksum(bytes).to_le_bytes());
        let start = Self::from_values(&values);
        (is_whole && start.is_plausible()).then_some(start)
    }

    /// Returns all values, in the order of the byte form.
    #[inline(never)]
    pub(crate) fn values(&self) -> [f32; VALUES] {
        let Self {
            attitude: q,
            tilt_sigma_rad,
            bias_rad_s: bias,
            bias_change_rad_s: change,
            bias_sigma_rad_s,
            accelerometer_bias_m_s2: [forward, right],
            squared_velocity_m2_s2,
        } = *self;
        [
            q.w,
            q.x,
            q.y,
            q.z,
            bias.x,
            bias.y,
            bias.z,
            change.x,
            change.y,
            change.z,
            tilt_sigma_rad,
            bias_sigma_rad_s,
            forward,
            right,
            squared_velocity_m2_s2,
        ]
    }

    /// Returns the state with these [`values`](Self::values).
    #[inline(never)]
    pub(crate) fn from_values(values: &[f32; VALUES]) -> Self {
        let [
            w,
            x,
            y,
            z,
            bias_x,
            bias_y,
            bias_z,
            change_x,
            change_y,
            change_z,
            tilt_sigma_rad,
            bias_sigma_rad_s,
            forward,
            right,
            squared_velocity_m2_s2,
        ] = *values;
        Self {
            attitude: Quaternion::new(w, x, y, z),
            tilt_sigma_rad,
            bias_rad_s: Vector3::new(bias_x, bias_y, bias_z),
            bias_change_rad_s: Vector3::new(change_x, change_y, change_z),
            bias_sigma_rad_s,
            accelerometer_bias_m_s2: [forward, right],
            squared_velocity_m2_s2,
        }
    }

    /// Returns whether a filter can have given this state: the attitude is a rotation, each σ is
    /// above zero, and no value is NaN, infinite or absurdly large.
    pub fn is_plausible(&self) -> bool {
        let length_error = self.attitude.dot(self.attitude) - 1.0;
        // A NaN fails every comparison.
        length_error.abs() < LARGEST_LENGTH_ERROR
            && self.tilt_sigma_rad > 0.0
            && self.bias_sigma_rad_s > 0.0
            && self.values().iter().all(|value| value.abs() < LARGEST)
    }
}

/// Returns the CRC of the values of a byte form.
fn checksum(bytes: &[u8; WarmStart::LENGTH]) -> u32 {
    let mut digest = CRC.digest();
    digest.update(&[LAYOUT]);
    let (values, _) = bytes.split_at(WarmStart::LENGTH - 4);
    digest.update(values);
    digest.finalize()
}
