//! The filters that can be chosen, the library's own and others, in one seat.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::kalman::{Kalman, Tuning};
use aplomb::estimator::{AnyFilter, Estimate, Estimator, FilterKind, Sample};

use crate::peers::{self, Fusion, Gains, Madgwick, Mahony, Peer, Vqf, VqfAsIs};

/// Which filter runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// One of the library's.
    Library(FilterKind),
    /// Mahony's, of the `ahrs` crate.
    Mahony,
    /// Madgwick's, of the `ahrs` crate.
    Madgwick,
    /// x-io Technologies' Fusion, of the `fusion-ahrs` crate.
    Fusion,
    /// VQF without magnetometer, of the `vqf` crate, mended.
    Vqf,
    /// The same as the crate has it.
    VqfAsIs,
}

impl Choice {
    /// Filters of other crates.
    pub const PEERS: [Self; 5] = [
        Self::Vqf,
        Self::VqfAsIs,
        Self::Fusion,
        Self::Madgwick,
        Self::Mahony,
    ];

    /// Every filter: the library's, its default first, then the others.
    pub fn all() -> Vec<Self> {
        let default = FilterKind::default();
        let others = FilterKind::ALL.into_iter().filter(|kind| *kind != default);
        std::iter::once(default)
            .chain(others)
            .map(Self::Library)
            .chain(Self::PEERS)
            .collect()
    }

    /// The filters that a recording can be replayed with; an error lists their names.
    pub fn parse(name: &str) -> Result<Self, String> {
        match FilterKind::parse(name) {
            Some(kind) => Ok(Self::Library(kind)),
            None if name == Self::Mahony.name() => Ok(Self::Mahony),
            None => {
                let names = FilterKind::ALL.map(FilterKind::name).join(", ");
                Err(format!("choose one of {names}, {}", Self::Mahony.name()))
            }
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Library(kind) => kind.name(),
            Self::Mahony => "mahony",
            Self::Madgwick => "madgwick",
            Self::Fusion => "fusion",
            Self::Vqf => "vqf",
            Self::VqfAsIs => "vqf as is",
        }
    }

    /// The gains in use, of another crate's filter.
    pub fn gains(self) -> Option<Gains> {
        fn of<F: peers::Filter>() -> Option<Gains> {
            Some(F::GAINS)
        }
        match self {
            Self::Library(_) => None,
            Self::Mahony => of::<Mahony>(),
            Self::Madgwick => of::<Madgwick>(),
            Self::Fusion => of::<Fusion>(),
            Self::Vqf => of::<Vqf>(),
            Self::VqfAsIs => of::<VqfAsIs>(),
        }
    }
}

/// A filter at work, whose attitudes are extrapolated by the delay of the sensor.
pub struct Filter {
    seat: Seat,
    /// What is left for this side to make up for, in s.
    delay_s: f32,
}

#[allow(
    clippy::large_enum_variant,
    reason = "there are as many as filters, and each is used for a whole recording"
)]
enum Seat {
    Library(Estimator),
    Peer(Peer),
}

impl Filter {
    /// The chosen filter, before its first sample. Samples will be about `step_s` apart, and `delay_us` late.
    pub fn new(choice: Choice, step_s: f32, delay_us: u32) -> Self {
        Self::with_gains(choice, step_s, delay_us, None)
    }

    /// The same with gains of one's own, if it is another crate's.
    pub fn with_gains(choice: Choice, step_s: f32, delay_us: u32, gains: Option<Gains>) -> Self {
        let seat = match choice {
            Choice::Library(kind) => {
                Seat::Library(Estimator::new(kind).with_sensor_delay_us(delay_us))
            }
            Choice::Mahony => Seat::Peer(Peer::new::<Mahony>(step_s, gains)),
            Choice::Madgwick => Seat::Peer(Peer::new::<Madgwick>(step_s, gains)),
            Choice::Fusion => Seat::Peer(Peer::new::<Fusion>(step_s, gains)),
            Choice::Vqf => Seat::Peer(Peer::new::<Vqf>(step_s, gains)),
            Choice::VqfAsIs => Seat::Peer(Peer::new::<VqfAsIs>(step_s, gains)),
        };
        let delay_s = match choice {
            Choice::Library(FilterKind::Kalman) => 0.0,
            _ => delay_us as f32 * 1e-6,
        };
        Self { seat, delay_s }
    }

    /// The library's default filter with a tuning of one's own.
    pub fn with_tuning(tuning: &'static Tuning, delay_us: u32) -> Self {
        let filter = AnyFilter::Kalman(Kalman::with_tuning(tuning));
        Self {
            seat: Seat::Library(Estimator::with_filter(filter).with_sensor_delay_us(delay_us)),
            delay_s: 0.0,
        }
    }

    /// Takes one sample and gives the attitude at its time.
    pub fn update(&mut self, sample: &Sample) -> Estimate {
        let mut estimate = match &mut self.seat {
            Seat::Library(estimator) => estimator.update(sample),
            Seat::Peer(peer) => peer.update(sample),
        };
        if self.delay_s > 0.0 {
            estimate.attitude = extrapolate(&estimate, self.delay_s);
        }
        estimate
    }

    /// How sure it is of roll and pitch, if it knows.
    pub fn tilt_sigma_rad(&self) -> Option<f32> {
        match &self.seat {
            Seat::Library(estimator) => estimator.kalman().map(Kalman::tilt_sigma_rad),
            Seat::Peer(_) => None,
        }
    }
}

/// The attitude `delay_s` later, if the body turns on as it does.
fn extrapolate(estimate: &Estimate, delay_s: f32) -> Quaternion {
    let turn = estimate.body_rates_rad_s.scale(delay_s);
    estimate
        .attitude
        .multiply(Quaternion::from_rotation_vector(turn))
        .normalize()
}

/// The direction opposite to gravity, in body axes.
pub fn up_in_body(attitude: Quaternion) -> Vector3 {
    -attitude.down_in_body()
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb::attitude::EulerAngles;
    use aplomb::units::{STANDARD_GRAVITY_M_S2, radians};

    const STEP_S: f32 = 0.005;

    /// The angle in degrees between a filter's "up" and the true one, after seconds of turning in this way.
    fn error_degrees(choice: Choice, start: EulerAngles, rate_rad_s: Vector3, steps: u32) -> f32 {
        let mut filter = Filter::new(choice, STEP_S, 0);
        let mut truth = Quaternion::from_euler(start);
        let mut estimate = Estimate::default();
        for step in 0..steps {
            estimate = filter.update(&Sample {
                t_us: u64::from(step) * 5_000,
                specific_force_m_s2: up_in_body(truth).scale(STANDARD_GRAVITY_M_S2),
                angular_rate_rad_s: rate_rad_s,
                ..Sample::default()
            });
            if step + 1 < steps {
                let turn = Quaternion::from_rotation_vector(rate_rad_s.scale(STEP_S));
                truth = truth.multiply(turn).normalize();
            }
        }
        let (estimated, expected) = (up_in_body(estimate.attitude), up_in_body(truth));
        let sine = estimated.cross(expected).norm();
        sine.atan2(estimated.dot(expected)).to_degrees()
    }

    #[test]
    fn every_filter_finds_gravity_at_rest_in_the_same_axes() {
        for choice in Choice::all() {
            for (roll, pitch) in [(0.0, 0.0), (40.0, 0.0), (0.0, -35.0), (-20.0, 50.0)] {
                // The classic angles are no Euler angles: each is right alone.
                if choice == Choice::Library(FilterKind::Classic) && roll * pitch != 0.0 {
                    continue;
                }
                let start = EulerAngles {
                    roll_rad: radians(roll),
                    pitch_rad: radians(pitch),
                    yaw_rad: 0.0,
                };
                let error = error_degrees(choice, start, Vector3::ZERO, 10_000);
                // At low frequencies `f32` is too short for the second-order low-pass of the vqf crate.
                let limit = match choice {
                    Choice::Vqf | Choice::VqfAsIs => 1.5,
                    _ => 0.1,
                };
                assert!(error < limit, "{} {roll} {pitch}: {error}", choice.name());
            }
        }
    }

    #[test]
    fn every_filter_turns_the_same_way_and_in_time() {
        // 90 °/s about the right axis for a third of a second: half a step of lead or lag is 0.2°.
        let rate = Vector3::new(0.0, radians(90.0), 0.0);
        for choice in Choice::all() {
            let error = error_degrees(choice, EulerAngles::default(), rate, 67);
            // The classic filter lags by design.
            let limit = match choice {
                Choice::Library(FilterKind::Classic) => 1.0,
                _ => 0.1,
            };
            assert!(error < limit, "{}: {error}", choice.name());
        }
    }

    #[test]
    fn names_choose_what_can_be_replayed() {
        for kind in FilterKind::ALL {
            assert_eq!(Choice::parse(kind.name()), Ok(Choice::Library(kind)));
        }
        assert_eq!(Choice::parse("mahony"), Ok(Choice::Mahony));
        assert!(Choice::parse("vqf").is_err_and(|error| error.contains("mahony")));
    }

    #[test]
    fn attitudes_are_extrapolated_about_the_bodys_own_axes() {
        let estimate = Estimate {
            attitude: Quaternion::from_euler(EulerAngles {
                yaw_rad: radians(90.0),
                ..EulerAngles::default()
            }),
            body_rates_rad_s: Vector3::new(radians(100.0), 0.0, 0.0),
            ..Estimate::default()
        };
        let angles = extrapolate(&estimate, 0.1).to_euler();
        assert!((angles.roll_rad - radians(10.0)).abs() < 1e-5);
        assert!((angles.yaw_rad - radians(90.0)).abs() < 1e-5);
    }
}
