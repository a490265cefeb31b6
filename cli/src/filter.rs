//! The filters that can be chosen, the library's own and others, in one seat.

use aplomb::attitude::Quaternion;
use aplomb::estimator::{Estimate, Estimator, FilterKind, Sample};

use crate::peers::Peer;

/// Which filter runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// One of the library's.
    Library(FilterKind),
    /// Mahony's, of the `ahrs` crate.
    Mahony,
}

const MAHONY: &str = "mahony";

impl Choice {
    /// The filter of this name; an error lists the names.
    pub fn parse(name: &str) -> Result<Self, String> {
        match FilterKind::parse(name) {
            Some(kind) => Ok(Self::Library(kind)),
            None if name == MAHONY => Ok(Self::Mahony),
            None => {
                let names = FilterKind::ALL.map(FilterKind::name).join(", ");
                Err(format!("choose one of {names}, {MAHONY}"))
            }
        }
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Library(kind) => kind.name(),
            Self::Mahony => MAHONY,
        }
    }
}

/// A filter at work.
pub enum Filter {
    /// One of the library's.
    Library(Estimator),
    /// Another crate's.
    Peer(Peer),
}

impl Filter {
    /// The chosen filter, before its first sample.
    pub fn new(choice: Choice) -> Self {
        match choice {
            Choice::Library(kind) => Self::Library(Estimator::new(kind)),
            Choice::Mahony => Self::Peer(Peer::mahony()),
        }
    }

    /// Takes one sample and gives the attitude at its time, when the sensor is not late.
    pub fn update(&mut self, sample: &Sample) -> Estimate {
        match self {
            Self::Library(estimator) => estimator.update(sample),
            Self::Peer(peer) => peer.update(sample),
        }
    }
}

/// The attitude `delay_s` later, if the body turns on as it does.
pub fn extrapolate(estimate: &Estimate, delay_s: f32) -> Quaternion {
    let turn = estimate.body_rates_rad_s.scale(delay_s);
    estimate
        .attitude
        .multiply(Quaternion::from_rotation_vector(turn))
        .normalize()
}
