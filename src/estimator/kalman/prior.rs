//! Priors of the parameters: what is known of them before the first sample.

use super::propagation::GYROSCOPE_PARAMETERS;
use crate::attitude::Vector3;
use crate::estimator::arithmetic::square;
use crate::serialize::StateVisitor;
use crate::units::STANDARD_GRAVITY_M_S2;

/// Prior of the gyroscope's bias.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct BiasPrior {
    /// Reference, rad/s in body axes: as stored, kept by a restart, or measured by the last rest.
    /// Until a rest it is the prior's mean.
    pub(super) reference_rad_s: Vector3,
    /// Variance per axis, (rad/s)².
    pub(super) variance: [f32; 3],
}

impl BiasPrior {
    pub(super) const fn new(reference_rad_s: Vector3, sigma_rad_s: f32) -> Self {
        Self {
            reference_rad_s,
            variance: [square(sigma_rad_s); 3],
        }
    }

    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            reference_rad_s,
            variance,
        } = self;
        visitor.vector(reference_rad_s);
        visitor.f32s(variance);
    }
}

/// Knowledge of the accelerometer's offset, which decides its prior.
///
/// | knowledge | σ per axis | source |
/// |---|---|---|
/// | factory | 20 mg | ±50 mg x and y (product specification §6.2), cross-axis ±2 %, as 2.8 σ |
/// | six poses | 10 mg | cross-axis terms of ±2 % as 2.8 σ, which six poses leave; drift |
/// | offset found in flight | 10 mg | error of the bias that 96 simulated flights left: 10 mg |
/// | calibrated | 7 mg | drift of up to 0.86 mg/°C (§6.2) over 8 °C |
///
/// A flight shows the offset along the forward and right axes. The prior of the down axis narrows
/// with them, which harms nothing: in level flight this offset does not turn the tilt.
///
/// A wide prior keeps σ honest for a sensor with a large offset. A narrow one is more accurate for
/// a calibrated sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum AccelerometerKnowledge {
    /// Nothing but the datasheet.
    Factory,
    /// Calibrated in six poses: offset and scale. Or its offset was found in flight:
    /// [`certain_accelerometer_bias_m_s2`](super::Kalman::certain_accelerometer_bias_m_s2).
    SixPoses,
    /// Calibrated in twelve poses, or by its maker: offset, scale and cross-axis terms.
    #[default]
    Calibrated,
}

impl AccelerometerKnowledge {
    /// Returns the knowledge of this name: `factory`, `six-poses` or `calibrated`.
    ///
    /// ```
    /// use aplomb::estimator::kalman::AccelerometerKnowledge;
    ///
    /// let knowledge = AccelerometerKnowledge::from_name("six-poses");
    /// assert_eq!(knowledge, Some(AccelerometerKnowledge::SixPoses));
    /// ```
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "factory" => Some(Self::Factory),
            "six-poses" => Some(Self::SixPoses),
            "calibrated" => Some(Self::Calibrated),
            _ => None,
        }
    }

    /// Returns σ of the offset per axis, m/s².
    pub const fn sigma_m_s2(self) -> f32 {
        let sigma_g = match self {
            Self::Factory => 0.020,
            Self::SixPoses => 0.010,
            Self::Calibrated => 0.007,
        };
        sigma_g * STANDARD_GRAVITY_M_S2
    }
}

/// Knowledge of the gyroscope's scale and cross-axis terms, which decides their priors.
///
/// | knowledge | σ of a scale | σ of a cross-axis term | source |
/// |---|---|---|---|
/// | factory | 1.1 % | 0.7 % | ±3 % and ±2 % (product specification §6.1) as 2.8 σ |
/// | calibrated | 0.6 % | 0.3 % | error of a fit 0.28 %; ±2 % over temperature (§6.1) |
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GyroscopeKnowledge {
    /// Not calibrated: the datasheet's tolerances.
    Factory,
    /// Calibrated by the turns between twelve poses, or by its maker.
    #[default]
    Calibrated,
}

impl GyroscopeKnowledge {
    /// Returns the knowledge that a calibration of the accelerometer implies: twelve poses, or the
    /// maker, calibrate both.
    pub const fn implied_by(accelerometer: AccelerometerKnowledge) -> Self {
        match accelerometer {
            AccelerometerKnowledge::Factory | AccelerometerKnowledge::SixPoses => Self::Factory,
            AccelerometerKnowledge::Calibrated => Self::Calibrated,
        }
    }

    /// Returns σ of each scale, 1.
    pub const fn scale_sigma(self) -> f32 {
        match self {
            Self::Factory => 0.011,
            Self::Calibrated => 0.006,
        }
    }

    /// Returns σ of each cross-axis term, rad.
    pub const fn misalignment_sigma_rad(self) -> f32 {
        match self {
            Self::Factory => 0.007,
            Self::Calibrated => 0.003,
        }
    }
}

/// First parameter that returns to a fixed prior. Those before it are the gyroscope's bias.
pub(super) const FIRST_WITH_PRIOR: usize = 3;

/// σ of each parameter before the first sample, but for the gyroscope's bias.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) struct ParameterPriors {
    /// σ of each scale of the gyroscope, 1.
    pub(super) gyroscope_scale: f32,
    /// σ of each cross-axis term of the gyroscope, rad.
    pub(super) gyroscope_misalignment_rad: f32,
    /// σ of the accelerometer's bias per axis, m/s².
    pub(super) accelerometer_m_s2: f32,
}

impl ParameterPriors {
    /// Creates the priors of a sensor of which this is known.
    pub(super) const fn new(
        accelerometer: AccelerometerKnowledge,
        gyroscope: GyroscopeKnowledge,
    ) -> Self {
        Self {
            gyroscope_scale: gyroscope.scale_sigma(),
            gyroscope_misalignment_rad: gyroscope.misalignment_sigma_rad(),
            accelerometer_m_s2: accelerometer.sigma_m_s2(),
        }
    }

    /// Returns the variance before the first sample of a parameter that is no gyroscope bias.
    #[inline]
    pub(super) fn variance(&self, parameter: usize) -> f32 {
        square(match parameter {
            // The diagonal of the gyroscope's matrix.
            3 | 7 | 11 => self.gyroscope_scale,
            ..GYROSCOPE_PARAMETERS => self.gyroscope_misalignment_rad,
            _ => self.accelerometer_m_s2,
        })
    }

    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let Self {
            gyroscope_scale,
            gyroscope_misalignment_rad,
            accelerometer_m_s2,
        } = self;
        visitor.f32(gyroscope_scale);
        visitor.f32(gyroscope_misalignment_rad);
        visitor.f32(accelerometer_m_s2);
    }
}
