//! What every filter can do, so that one estimator serves them all.
//!
//! A firmware names its filter as a type, and the others are not linked; a host tool takes
//! [`AnyFilter`] and chooses at run time.

use super::axis_kalman::AxisKalman;
use super::classic::{Classic, ClassicAngles};
use super::kalman::Kalman;
use super::{FilterKind, Measurement, Sample};
use crate::attitude::Quaternion;
use crate::state::Exchange;

/// A filter, as [`Estimator`](super::Estimator) sees it: it gets finite samples only, and steps
/// between 1 µs and 0.5 s.
pub trait Filter {
    /// Forgets everything but its settings and the quaternion's sign.
    fn restart(&mut self);

    /// The first sample, or the first after a gap: takes the tilt from the specific force if it
    /// shows gravity, and keeps yaw.
    fn start(&mut self, sample: &Sample, shows_gravity: bool);

    /// One step of `dt_s` seconds.
    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool);

    /// Whether a step of this length, or saturation, hides something from [`update`](Self::update), and how much. Comes before
    /// it, for every sample but those that are neither saturated nor more than [`EVERYDAY_STEP_US`](super::EVERYDAY_STEP_US) after the last.
    fn allow_for(&mut self, _sample: &Sample, _dt_s: f32, _shows_gravity: bool) {}

    /// Body to earth, at the last sample's time.
    fn attitude(&self) -> Quaternion;

    /// Walks through everything it remembers. Its kind comes first.
    fn exchange(&mut self, state: &mut impl Exchange);

    /// The [`Kalman`] filter that this is, if it is.
    fn kalman(&self) -> Option<&Kalman> {
        None
    }

    /// The same, to set it up.
    fn kalman_mut(&mut self) -> Option<&mut Kalman> {
        None
    }

    /// The numbers of the classic tutorial, if this is its filter.
    fn classic_angles(&self) -> Option<ClassicAngles> {
        None
    }
}

impl Filter for Kalman {
    fn restart(&mut self) {
        self.restart();
    }

    #[inline]
    fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        self.start(sample, shows_gravity);
    }

    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        self.update(sample, dt_s, shows_gravity);
    }

    fn allow_for(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        self.allow_for(sample, dt_s, shows_gravity);
    }

    fn attitude(&self) -> Quaternion {
        self.attitude()
    }

    fn exchange(&mut self, state: &mut impl Exchange) {
        expect(FilterKind::Kalman, state);
        self.exchange(state);
    }

    #[inline]
    fn kalman(&self) -> Option<&Kalman> {
        Some(self)
    }

    #[inline]
    fn kalman_mut(&mut self) -> Option<&mut Kalman> {
        Some(self)
    }
}

impl Filter for AxisKalman {
    fn restart(&mut self) {
        self.restart();
    }

    fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        self.start(&Measurement::of(sample, shows_gravity));
    }

    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        self.update(&Measurement::of(sample, shows_gravity), dt_s);
    }

    fn attitude(&self) -> Quaternion {
        self.attitude()
    }

    fn exchange(&mut self, state: &mut impl Exchange) {
        expect(FilterKind::AxisKalman, state);
        self.exchange(state);
    }
}

impl Filter for Classic {
    fn restart(&mut self) {
        self.restart();
    }

    fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        self.start(&Measurement::of(sample, shows_gravity));
    }

    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        self.update(&Measurement::of(sample, shows_gravity), dt_s);
    }

    fn attitude(&self) -> Quaternion {
        self.attitude()
    }

    fn exchange(&mut self, state: &mut impl Exchange) {
        expect(FilterKind::Classic, state);
        self.exchange(state);
    }

    fn classic_angles(&self) -> Option<ClassicAngles> {
        Some(self.angles())
    }
}

/// A filter of one kind takes no other's memory.
fn expect(kind: FilterKind, state: &mut impl Exchange) {
    let mut found = kind;
    found.exchange(state);
    if found != kind {
        state.refuse();
    }
}

/// A filter that is chosen at run time.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[allow(clippy::large_enum_variant)]
pub enum AnyFilter {
    /// [`FilterKind::Kalman`].
    Kalman(Kalman),
    /// [`FilterKind::AxisKalman`].
    AxisKalman(AxisKalman),
    /// [`FilterKind::Classic`].
    Classic(Classic),
}

impl AnyFilter {
    /// A filter of this kind, without an attitude.
    pub const fn new(kind: FilterKind) -> Self {
        match kind {
            FilterKind::Kalman => Self::Kalman(Kalman::new()),
            FilterKind::AxisKalman => Self::AxisKalman(AxisKalman::new()),
            FilterKind::Classic => Self::Classic(Classic::new()),
        }
    }
}

impl Filter for AnyFilter {
    fn restart(&mut self) {
        match self {
            Self::Kalman(filter) => Filter::restart(filter),
            Self::AxisKalman(filter) => Filter::restart(filter),
            Self::Classic(filter) => Filter::restart(filter),
        }
    }

    #[inline]
    fn start(&mut self, sample: &Sample, shows_gravity: bool) {
        match self {
            Self::Kalman(filter) => Filter::start(filter, sample, shows_gravity),
            Self::AxisKalman(filter) => Filter::start(filter, sample, shows_gravity),
            Self::Classic(filter) => Filter::start(filter, sample, shows_gravity),
        }
    }

    #[inline]
    fn update(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        match self {
            Self::Kalman(filter) => Filter::update(filter, sample, dt_s, shows_gravity),
            Self::AxisKalman(filter) => Filter::update(filter, sample, dt_s, shows_gravity),
            Self::Classic(filter) => Filter::update(filter, sample, dt_s, shows_gravity),
        }
    }

    fn allow_for(&mut self, sample: &Sample, dt_s: f32, shows_gravity: bool) {
        if let Some(filter) = self.kalman_mut() {
            filter.allow_for(sample, dt_s, shows_gravity);
        }
    }

    #[inline]
    fn attitude(&self) -> Quaternion {
        match self {
            Self::Kalman(filter) => Filter::attitude(filter),
            Self::AxisKalman(filter) => Filter::attitude(filter),
            Self::Classic(filter) => Filter::attitude(filter),
        }
    }

    fn exchange(&mut self, state: &mut impl Exchange) {
        let kind = match self {
            Self::Kalman(_) => FilterKind::Kalman,
            Self::AxisKalman(_) => FilterKind::AxisKalman,
            Self::Classic(_) => FilterKind::Classic,
        };
        let mut found = kind;
        found.exchange(state);
        if found != kind {
            *self = Self::new(found);
        }
        match self {
            Self::Kalman(filter) => filter.exchange(state),
            Self::AxisKalman(filter) => filter.exchange(state),
            Self::Classic(filter) => filter.exchange(state),
        }
    }

    #[inline]
    fn kalman(&self) -> Option<&Kalman> {
        match self {
            Self::Kalman(filter) => Some(filter),
            Self::AxisKalman(_) | Self::Classic(_) => None,
        }
    }

    fn kalman_mut(&mut self) -> Option<&mut Kalman> {
        match self {
            Self::Kalman(filter) => Some(filter),
            Self::AxisKalman(_) | Self::Classic(_) => None,
        }
    }

    fn classic_angles(&self) -> Option<ClassicAngles> {
        match self {
            Self::Classic(filter) => Some(filter.angles()),
            Self::Kalman(_) | Self::AxisKalman(_) => None,
        }
    }
}
