//! Collector of the mean readings of poses.

use core::fmt;

use super::super::gravity::{MAX_GRAVITY_G, MIN_GRAVITY_G};
use super::super::noise::NoiseModel;
use super::super::stationary::StationaryMean;
use super::fit::{AccelerometerFit, FitError, fit};
use super::pose::{DIRECTION_COSINE, Pose, covers};
use crate::attitude::Vector3;

/// Largest number of poses.
pub const MAX_POSES: usize = 24;

/// Smallest angle between two different poses: cosine of 20°.
const SAME_POSE_COSINE: f32 = 0.939_692_6;

/// Collects the mean readings of poses, and fits them.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PoseCollector {
    g_per_count: f32,
    count: usize,
    /// Mean readings, g along the sensor's axes.
    readings: [Vector3; MAX_POSES],
}

/// Pose that was added to a [`PoseCollector`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AcceptedPose {
    /// Number of poses with this one.
    pub count: u8,
    /// Pose of the guide within 30°, if there is one.
    pub pose: Option<Pose>,
}

/// Reason why a pose was refused. The collected poses are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum PoseError {
    /// The pose is within 20° of a collected one.
    Repeated {
        /// Number of the collected pose, from 1.
        number: u8,
    },
    /// The specific force is not about one g.
    NoGravity,
    /// An axis reads full scale.
    Saturated,
    /// The collector holds [`MAX_POSES`] poses.
    Full,
}

impl fmt::Display for PoseError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Repeated { number } => {
                write!(
                    formatter,
                    "this is pose {number} again: turn it to another side"
                )
            }
            Self::NoGravity => formatter.write_str("the accelerometer reads no gravity"),
            Self::Saturated => formatter.write_str("the accelerometer reads full scale"),
            Self::Full => write!(formatter, "there are {MAX_POSES} poses already"),
        }
    }
}

impl core::error::Error for PoseError {}

impl PoseCollector {
    /// Creates an empty collector for means of this scale.
    pub fn new(noise: &NoiseModel) -> Self {
        Self {
            g_per_count: 1.0 / noise.counts_per_g,
            count: 0,
            readings: [Vector3::ZERO; MAX_POSES],
        }
    }

    /// Adds the mean reading of a pose.
    ///
    /// # Errors
    ///
    /// Returns a [`PoseError`] if the reading is no gravity or shows a pose again, or if the
    /// collector is full.
    pub fn add(&mut self, mean: &StationaryMean) -> Result<AcceptedPose, PoseError> {
        let counts = mean.accelerometer_counts;
        if !counts.is_within(f32::from(i16::MAX) - 1.0) {
            return Err(PoseError::Saturated);
        }
        let reading = counts.scale(self.g_per_count);
        let norm = reading.norm();
        if !(MIN_GRAVITY_G..=MAX_GRAVITY_G).contains(&norm) {
            return Err(PoseError::NoGravity);
        }
        let is_same =
            |other: &Vector3| reading.dot(*other) > SAME_POSE_COSINE * norm * other.norm();
        if let Some(index) = self.readings().iter().position(is_same) {
            let number = index as u8 + 1;
            return Err(PoseError::Repeated { number });
        }
        let place = self.readings.get_mut(self.count).ok_or(PoseError::Full)?;
        *place = reading;
        self.count += 1;
        Ok(AcceptedPose {
            count: self.count as u8,
            pose: Pose::GUIDE
                .into_iter()
                .find(|guide| guide.up().dot(reading) > DIRECTION_COSINE * norm),
        })
    }

    /// Returns the number of collected poses.
    pub const fn count(&self) -> usize {
        self.count
    }

    /// Returns the first pose of the guide that is not collected, or its first pose if all are.
    pub fn next_pose(&self) -> Pose {
        let [first, ..] = Pose::GUIDE;
        let is_missing = |guide: &Pose| !covers(self.readings(), guide.up());
        Pose::GUIDE.into_iter().find(is_missing).unwrap_or(first)
    }

    /// Fits the collected poses; see [`fit`].
    ///
    /// # Errors
    ///
    /// Returns a [`FitError`]; more poses may help.
    pub fn fit(&self) -> Result<AccelerometerFit, FitError> {
        fit(self.readings())
    }

    /// Returns the mean readings, g along the sensor's axes.
    pub fn readings(&self) -> &[Vector3] {
        self.readings.get(..self.count).unwrap_or(&self.readings)
    }
}
