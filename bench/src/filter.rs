//! The filters to compare, the library's own and others, behind one interface.

use aplomb::estimator::classic::{AxisKalman, Tutorial};
use aplomb::estimator::kalman::{AccelerometerKnowledge, GyroscopeKnowledge, Kalman, Tuning};
use aplomb::estimator::{Estimate, Estimator, Sample};
use aplomb_recordings::attitude::extrapolate;

use crate::peers::{self, Fusion, Gains, Madgwick, Mahony, Peer, Vqf};

/// A filter to compare.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// The library's Kalman filter.
    Kalman,
    /// The tutorial's two Kalman filters with exact kinematics.
    AxisKalman,
    /// The tutorial's formulas.
    Classic,
    /// VQF without magnetometer.
    Vqf,
    /// x-io Technologies' Fusion, of the `fusion-ahrs` crate.
    Fusion,
    /// Madgwick's, of the `ahrs` crate.
    Madgwick,
    /// Mahony's, of the `ahrs` crate.
    Mahony,
}

impl Choice {
    /// Every filter: the library's, its default first, then the others.
    pub const ALL: [Self; 7] = [
        Self::Kalman,
        Self::AxisKalman,
        Self::Classic,
        Self::Vqf,
        Self::Fusion,
        Self::Madgwick,
        Self::Mahony,
    ];

    /// Filters of others.
    pub const PEERS: [Self; 4] = [Self::Vqf, Self::Fusion, Self::Madgwick, Self::Mahony];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Kalman => "kalman",
            Self::AxisKalman => "axis-kalman",
            Self::Classic => "classic",
            Self::Vqf => "vqf",
            Self::Fusion => "fusion",
            Self::Madgwick => "madgwick",
            Self::Mahony => "mahony",
        }
    }

    /// Returns the gains in use, of a filter of others.
    pub const fn gains(self) -> Option<Gains> {
        const fn of<F: peers::Filter>() -> Option<Gains> {
            Some(F::GAINS)
        }
        match self {
            Self::Kalman | Self::AxisKalman | Self::Classic => None,
            Self::Vqf => of::<Vqf>(),
            Self::Fusion => of::<Fusion>(),
            Self::Madgwick => of::<Madgwick>(),
            Self::Mahony => of::<Mahony>(),
        }
    }
}

/// A running filter. Its attitudes are extrapolated by the delay of the sensor.
pub struct Filter {
    variant: Variant,
    /// Extrapolation of the filters that know no delay, s.
    delay_s: f32,
}

#[allow(
    clippy::large_enum_variant,
    reason = "there are as many as filters, and each is used for a whole recording"
)]
enum Variant {
    Kalman(Estimator),
    AxisKalman(Estimator<AxisKalman>),
    Classic(Estimator<Tutorial>),
    Peer(Peer),
}

impl Filter {
    /// Creates a filter for samples that are about `step_s` apart, and `delay_us` late.
    pub fn new(choice: Choice, step_s: f32, delay_us: u32) -> Self {
        Self::with_gains(choice, step_s, delay_us, None)
    }

    /// Sets what is known of the accelerometer, and what that implies of the gyroscope. Only the
    /// Kalman filter uses it.
    pub fn with_knowledge(mut self, accelerometer: AccelerometerKnowledge) -> Self {
        if let Variant::Kalman(estimator) = &mut self.variant {
            let filter = estimator.filter_mut();
            filter.set_accelerometer_knowledge(accelerometer);
            filter.set_gyroscope_knowledge(GyroscopeKnowledge::implied_by(accelerometer));
        }
        self
    }

    /// Creates a filter, with other gains than those in use if it is one of others.
    pub fn with_gains(choice: Choice, step_s: f32, delay_us: u32, gains: Option<Gains>) -> Self {
        let variant = match choice {
            Choice::Kalman => return Self::with_tuning(&Tuning::DEFAULT, delay_us),
            Choice::AxisKalman => Variant::AxisKalman(Estimator::with_filter(AxisKalman::new())),
            Choice::Classic => Variant::Classic(Estimator::with_filter(Tutorial::new())),
            Choice::Mahony => Variant::Peer(Peer::new::<Mahony>(step_s, gains)),
            Choice::Madgwick => Variant::Peer(Peer::new::<Madgwick>(step_s, gains)),
            Choice::Fusion => Variant::Peer(Peer::new::<Fusion>(step_s, gains)),
            Choice::Vqf => Variant::Peer(Peer::new::<Vqf>(step_s, gains)),
        };
        Self {
            variant,
            delay_s: delay_us as f32 * 1e-6,
        }
    }

    /// Creates the library's Kalman filter with this tuning.
    pub fn with_tuning(tuning: &'static Tuning, delay_us: u32) -> Self {
        let mut filter = Kalman::with_tuning(tuning);
        filter.set_delay_us(delay_us);
        Self {
            variant: Variant::Kalman(Estimator::with_filter(filter)),
            delay_s: 0.0,
        }
    }

    /// Takes one sample, and returns the attitude at its time.
    pub fn update(&mut self, sample: &Sample) -> Estimate {
        let mut estimate = match &mut self.variant {
            Variant::Kalman(estimator) => estimator.update(sample),
            Variant::AxisKalman(estimator) => estimator.update(sample),
            Variant::Classic(estimator) => estimator.update(sample),
            Variant::Peer(peer) => peer.update(sample),
        };
        if self.delay_s > 0.0 {
            let (attitude, rates) = (estimate.attitude, estimate.body_rates_rad_s);
            estimate.attitude = extrapolate(attitude, rates, self.delay_s);
        }
        estimate
    }

    /// Returns the σ of roll and pitch, if the filter knows it.
    pub fn tilt_sigma_rad(&self) -> Option<f32> {
        match &self.variant {
            Variant::Kalman(estimator) => Some(estimator.filter().tilt_sigma_rad()),
            Variant::AxisKalman(_) | Variant::Classic(_) | Variant::Peer(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb::attitude::{BodyVector, EulerAngles, Quaternion, Vector3};
    use aplomb::units::{STANDARD_GRAVITY_M_S2, radians};
    use aplomb_recordings::attitude::up_in_body;

    /// Returns the angle between a filter's "up" and the true one in degrees, after turning at this
    /// rate.
    fn error_degrees(
        choice: Choice,
        step_us: u32,
        start: EulerAngles,
        rate_rad_s: Vector3,
        steps: u32,
    ) -> f32 {
        let step_s = step_us as f32 * 1e-6;
        let mut filter = Filter::new(choice, step_s, 0);
        let mut truth = Quaternion::from_euler(start);
        let mut estimate = Estimate::default();
        for step in 0..steps {
            estimate = filter.update(&Sample::new(
                u64::from(step * step_us),
                BodyVector(up_in_body(truth).scale(STANDARD_GRAVITY_M_S2)),
                BodyVector(rate_rad_s),
            ));
            if step + 1 < steps {
                let turn = Quaternion::from_rotation_vector(rate_rad_s.scale(step_s));
                truth = truth.multiply(turn).normalize();
            }
        }
        let (estimated, expected) = (up_in_body(estimate.attitude), up_in_body(truth));
        let sine = estimated.cross(expected).norm();
        sine.atan2(estimated.dot(expected)).to_degrees()
    }

    /// A low-pass filter in `f32` loses gravity at 1 kHz.
    #[test]
    fn every_filter_finds_gravity_at_rest_in_the_same_axes() {
        let tilts = [
            (0.0, 0.0),
            (5.0, 0.0),
            (20.0, 0.0),
            (40.0, 0.0),
            (0.0, -35.0),
            (-20.0, 50.0),
        ];
        for choice in Choice::ALL {
            for (roll, pitch) in tilts {
                // The classic angles are no Euler angles: each is right alone.
                if choice == Choice::Classic && roll * pitch != 0.0 {
                    continue;
                }
                let start = EulerAngles {
                    roll_rad: radians(roll),
                    pitch_rad: radians(pitch),
                    yaw_rad: 0.0,
                };
                for (step_us, steps) in [(5_000, 10_000), (1_000, 30_000)] {
                    let error = error_degrees(choice, step_us, start, Vector3::ZERO, steps);
                    let name = choice.name();
                    assert!(error < 0.1, "{name} {roll} {pitch} {step_us} µs: {error}");
                }
            }
        }
    }

    #[test]
    fn every_filter_turns_the_same_way_and_in_time() {
        // 90 °/s about the right axis for a third of a second: half a step of lead or lag is
        // 0.2°.
        let rate = Vector3::new(0.0, radians(90.0), 0.0);
        for choice in Choice::ALL {
            let error = error_degrees(choice, 5_000, EulerAngles::default(), rate, 67);
            // The classic filter lags by design.
            let limit = match choice {
                Choice::Classic => 1.0,
                _ => 0.1,
            };
            assert!(error < limit, "{}: {error}", choice.name());
        }
    }
}
