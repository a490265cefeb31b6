//! From calibrated samples to attitude: one file per filter, one seat for all of them.
//!
//! [`Estimator`] keeps the time and refuses what is not a number, so that a filter sees only finite
//! samples and steps between 1 µs and 0.5 s. The filter is its type parameter; by default it is
//! [`AnyFilter`], of which [`FilterKind`] chooses one at run time:
//!
//! - [`kalman`], the default: one Kalman filter for tilt, velocity and everything that is wrong with
//!   the sensor;
//! - [`axis_kalman`]: an angle and bias Kalman filter each for roll and pitch, around an exact
//!   quaternion;
//! - [`classic`]: the same two filters with the formulas of the well-known tutorial.
//!
//! Neither sees a compass: yaw starts at zero and is only ever relative.

pub mod angle_bias;
pub mod axis_kalman;
pub mod classic;
mod filter;
pub mod kalman;

pub use classic::ClassicAngles;
pub use filter::{AnyFilter, Filter};

use crate::attitude::{Quaternion, Vector3};
use crate::state::Exchange;
use crate::units::{SECONDS_PER_MICROSECOND, STANDARD_GRAVITY_M_S2, radians};
use kalman::Kalman;

/// Counts the changes after which a filter gives other attitudes, if only in one bit. A log says which one flew.
/// `tests/revision.rs` notices a change that did not raise it.
pub const REVISION: u16 = 2;

/// A longer pause between samples is a gap: what happened in it is unknown.
pub const LONGEST_STEP_US: u64 = 500_000;

/// Up to here a step hides nothing that a filter has to allow for.
pub const EVERYDAY_STEP_US: u32 = 15_000;

/// Below a quarter of gravity the accelerometer's own offset (80 mg, product specification §6.2) may
/// turn its direction by 20° and more, so it says nothing about down.
pub const LEAST_SPECIFIC_FORCE_M_S2: f32 = 0.25 * STANDARD_GRAVITY_M_S2;

/// From one sample to the next a rate at most doubles, but for this much, in rad/s: 50 °/s. An airframe
/// gains less than that in a millisecond; a gyroscope whose full scale has changed by itself, or that was
/// hit, does not.
const RATE_JUMP_RAD_S: f32 = radians(50.0);

/// No sensor of this family reaches a tenth of these; beyond them a sample is not a measurement.
const LARGEST_SPECIFIC_FORCE_M_S2: f32 = 10_000.0;
const LARGEST_RATE_RAD_S: f32 = 1_000.0;

/// Which filter estimates the attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FilterKind {
    /// [`kalman`].
    #[default]
    Kalman,
    /// [`axis_kalman`].
    AxisKalman,
    /// [`classic`].
    Classic,
}

impl FilterKind {
    /// Every filter.
    pub const ALL: [Self; 3] = [Self::Kalman, Self::AxisKalman, Self::Classic];

    /// The name by which it is chosen.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Kalman => "kalman",
            Self::AxisKalman => "axis-kalman",
            Self::Classic => "classic",
        }
    }

    /// The filter of this name.
    pub const fn parse(name: &str) -> Option<Self> {
        match name.as_bytes() {
            b"kalman" => Some(Self::Kalman),
            b"axis-kalman" => Some(Self::AxisKalman),
            b"classic" => Some(Self::Classic),
            _ => None,
        }
    }
}

impl FilterKind {
    /// Is shown to `state`, or set by it.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        let mut index = *self as usize;
        state.index(&mut index, Self::ALL.len());
        *self = Self::ALL.get(index).copied().unwrap_or_default();
    }
}

/// A calibrated sample in body axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sample {
    /// When it was taken, in microseconds since start.
    pub t_us: u64,
    /// Specific force: at rest and level (0, 0, −9.81).
    pub specific_force_m_s2: Vector3,
    /// Angular rate; whoever averages its offset at rest has removed it.
    pub angular_rate_rad_s: Vector3,
    /// Whether an axis of the gyroscope reads full scale.
    pub is_rate_saturated: bool,
    /// Whether an axis of the accelerometer reads full scale.
    pub is_force_saturated: bool,
}

impl Sample {
    /// The squares of specific force and angular rate, (m/s²)² and (rad/s)².
    #[inline(always)]
    fn squares(&self) -> (f32, f32) {
        let (force, rate) = (self.specific_force_m_s2, self.angular_rate_rad_s);
        (force.dot(force), rate.dot(rate))
    }
}

/// An everyday sample has a larger force than this, (m/s²)²: half of gravity. More than [`LEAST_SPECIFIC_FORCE_M_S2`], and more than is
/// left where the accelerometer reads zero, which is its correction: 0.45 g at most.
const LEAST_EVERYDAY_FORCE_SQUARED: f32 = 0.25 * STANDARD_GRAVITY_M_S2 * STANDARD_GRAVITY_M_S2;

/// Within these a sample is nothing to remark. Squares, so that no root is taken.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(crate) struct Everyday {
    /// The longest step from the sample before, µs. Zero: no sample is an everyday one.
    pub(crate) most_step_us: u32,
    /// How many numbers there are from [`LEAST_EVERYDAY_FORCE_SQUARED`] to the largest specific force, (m/s²)².
    force_range_bits: u32,
    /// The largest angular rate, (rad/s)².
    most_rate_squared: f32,
}

impl Everyday {
    /// Nothing is.
    pub(crate) const NEVER: Self = Self {
        most_step_us: 0,
        force_range_bits: 0,
        most_rate_squared: 0.0,
    };

    /// Up to this force, m/s², and this rate, rad/s; but never yet.
    pub(crate) fn up_to(force_m_s2: f32, rate_rad_s: f32) -> Self {
        let most_force_squared = force_m_s2 * force_m_s2;
        Self {
            most_step_us: 0,
            force_range_bits: most_force_squared
                .to_bits()
                .saturating_sub(LEAST_EVERYDAY_FORCE_SQUARED.to_bits()),
            most_rate_squared: rate_rad_s * rate_rad_s,
        }
    }
}

/// What a sample led to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Estimate {
    /// Body to earth.
    pub attitude: Quaternion,
    /// The body's own rates p, q, r.
    pub body_rates_rad_s: Vector3,
    /// What was wrong with the sample.
    pub remarks: Remarks,
    /// The filter does not know the gyroscope's bias well yet. Only [`kalman`] looks for it.
    pub is_calibrating: bool,
    /// The rate is more than twice the one before and 50 °/s, as if the full scale had changed.
    pub has_jumped: bool,
}

/// What was wrong with a sample, and what was done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Remarks {
    /// Time stood still or ran backwards: the attitude is held, time continues from here.
    pub time_went_back: bool,
    /// The step was longer than [`LONGEST_STEP_US`]: roll and pitch start again from the
    /// accelerometer, yaw is kept.
    pub gap: bool,
    /// A value was not finite or absurd: the sample is ignored.
    pub rejected: bool,
    /// The specific force was under [`LEAST_SPECIFIC_FORCE_M_S2`]: the gyroscope alone was used.
    pub no_gravity: bool,
}

impl Remarks {
    /// Whether there is anything to remark.
    #[inline]
    pub const fn any(self) -> bool {
        self.time_went_back | self.gap | self.rejected | self.no_gravity
    }
}

/// [`Remarks`] in the bits of one word, so that a single comparison tells that there are none.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Look(u32);

impl Look {
    /// The sample is an everyday one.
    pub(crate) const EVERYDAY: Self = Self(0);
    /// It has been examined.
    const UNUSUAL: Self = Self(1 << 0);
    const REJECTED: Self = Self(1 << 1);
    const NO_GRAVITY: Self = Self(1 << 2);
    const TIME_WENT_BACK: Self = Self(1 << 3);
    const GAP: Self = Self(1 << 4);

    #[inline(always)]
    const fn has(self, one: Self) -> bool {
        self.0 & one.0 != 0
    }

    #[inline(always)]
    const fn add(&mut self, one: Self) {
        self.0 |= one.0;
    }

    pub(crate) const fn remarks(self) -> Remarks {
        Remarks {
            time_went_back: self.has(Self::TIME_WENT_BACK),
            gap: self.has(Self::GAP),
            rejected: self.has(Self::REJECTED),
            no_gravity: self.has(Self::NO_GRAVITY),
        }
    }
}

/// An [`Estimate`] on its way.
pub(crate) struct Taken {
    pub(crate) attitude: Quaternion,
    pub(crate) body_rates_rad_s: Vector3,
    pub(crate) look: Look,
    pub(crate) is_calibrating: bool,
}

/// A filter with its sense of time. Total: whatever comes in, the attitude stays a finite rotation,
/// and good samples bring it back.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Estimator<F = AnyFilter> {
    filter: F,
    last_t_us: Option<u64>,
    body_rates_rad_s: Vector3,
    rate_squared: f32,
}

impl Estimator {
    /// An estimator that starts with its first sample.
    pub const fn new(kind: FilterKind) -> Self {
        Self::with_filter(AnyFilter::new(kind))
    }
}

impl<F: Filter> Estimator<F> {
    /// An estimator around this filter, which it links alone.
    pub const fn with_filter(filter: F) -> Self {
        Self {
            filter,
            last_t_us: None,
            body_rates_rad_s: Vector3::ZERO,
            rate_squared: 0.0,
        }
    }

    /// By how much the sensor lags the motion, in µs: [`kalman`] extrapolates by that, so that the
    /// attitude is the one at the sample's time.
    #[must_use]
    pub fn with_sensor_delay_us(mut self, delay_us: u32) -> Self {
        if let Some(filter) = self.filter.kalman_mut() {
            filter.set_delay(delay_us as f32 * SECONDS_PER_MICROSECOND);
        }
        self
    }

    /// A gyroscope bias known beforehand, with its σ per axis, both rad/s: shortens the start of
    /// [`kalman`]. The other filters want it removed from the samples.
    #[must_use]
    pub fn with_bias(mut self, bias_rad_s: Vector3, sigma_rad_s: f32) -> Self {
        self.set_bias(bias_rad_s, sigma_rad_s);
        self
    }

    /// The same for an estimator that is there already; it works until the first sample.
    pub fn set_bias(&mut self, bias_rad_s: Vector3, sigma_rad_s: f32) {
        if let Some(filter) = self.filter.kalman_mut() {
            filter.set_bias(bias_rad_s, sigma_rad_s);
        }
    }

    /// From the next sample on the rates have this more of an offset, rad/s, because somebody removes less (or more, where
    /// negative) before: the attitude goes on as if nothing had happened.
    pub fn shift_bias(&mut self, change_rad_s: Vector3) {
        if let Some(filter) = self.filter.kalman_mut() {
            filter.shift_bias(change_rad_s);
        }
    }

    /// Goes on from what an earlier run knew; see [`Kalman::resume`]. Call it before the first sample.
    pub fn resume(&mut self, known: &kalman::Known) {
        if let Some(filter) = self.filter.kalman_mut() {
            filter.resume(known);
        }
    }

    /// The [`kalman`] filter, to be told what the samples do not show; `None` with any other.
    pub fn kalman_mut(&mut self) -> Option<&mut Kalman> {
        self.filter.kalman_mut()
    }

    /// When the last sample was taken, in microseconds since start.
    pub const fn last_t_us(&self) -> Option<u64> {
        self.last_t_us
    }

    /// The body's rates at that sample, rad/s.
    pub const fn body_rates_rad_s(&self) -> Vector3 {
        self.body_rates_rad_s
    }

    /// Armed (`true`), nothing is done that is only safe on the ground. Default: false.
    pub fn set_armed(&mut self, is_armed: bool) {
        if let Some(filter) = self.filter.kalman_mut() {
            filter.set_armed(is_armed);
        }
    }

    /// The [`kalman`] filter with all it knows; `None` with any other.
    pub fn kalman(&self) -> Option<&Kalman> {
        self.filter.kalman()
    }

    /// Walks through everything it remembers.
    pub fn exchange(&mut self, state: &mut impl Exchange) {
        self.filter.exchange(state);
        state.optional(&mut self.last_t_us, 0, |state, t_us| state.long(t_us));
        state.vector(&mut self.body_rates_rad_s);
        state.number(&mut self.rate_squared);
    }

    /// Does what can be done before the first sample; it costs that sample time otherwise.
    pub fn prepare(&mut self) {
        if let Some(filter) = self.filter.kalman_mut() {
            filter.prepare();
        }
    }

    /// Forgets everything but the quaternion's sign; yaw starts at zero again.
    pub fn restart(&mut self) {
        self.last_t_us = None;
        self.filter.restart();
    }

    /// Has the next sample set the tilt from its specific force, as after a gap; yaw and what is known of
    /// the sensor are kept.
    pub const fn forget_tilt(&mut self) {
        self.last_t_us = None;
    }

    /// Takes one sample and gives the attitude at its time.
    pub fn update(&mut self, sample: &Sample) -> Estimate {
        let (step_us, look, has_jumped) = self.examine(sample);
        let taken = self.take(sample, step_us, look);
        Estimate {
            attitude: taken.attitude,
            body_rates_rad_s: taken.body_rates_rad_s,
            remarks: taken.look.remarks(),
            has_jumped,
            is_calibrating: taken.is_calibrating,
        }
    }

    /// The step to a sample that is remarkable neither by that nor by its size, in µs: [`take`](Self::take) then needs no
    /// [`examine`](Self::examine). Else zero.
    #[inline(always)]
    pub(crate) fn everyday_step_us(&mut self, sample: &Sample, everyday: &Everyday) -> u32 {
        let Some(last_t_us) = self.last_t_us else {
            return 0;
        };
        let step_us = (sample.t_us as u32).wrapping_sub(last_t_us as u32);
        let (force_squared, rate_squared) = sample.squares();
        // No number is negative here, so their bits compare as they do; and those of a NaN are more than any.
        let force_bits = force_squared.to_bits();
        let is_everyday = sample.t_us >> 32 == last_t_us >> 32
            && step_us.wrapping_sub(1) < everyday.most_step_us
            && force_bits.wrapping_sub(LEAST_EVERYDAY_FORCE_SQUARED.to_bits())
                < everyday.force_range_bits
            && (rate_squared.to_bits() <= (RATE_JUMP_RAD_S * RATE_JUMP_RAD_S).to_bits()
                || (rate_squared <= self.rate_jump_squared()
                    && rate_squared <= everyday.most_rate_squared));
        if !is_everyday {
            return 0;
        }
        self.rate_squared = rate_squared;
        self.last_t_us = Some(sample.t_us);
        step_us
    }

    /// What there is to remark about any sample, once before it is taken: the step that [`take`](Self::take) is to make, in µs (none if
    /// zero), the remarks, and whether its rate has jumped.
    #[inline]
    pub(crate) fn examine(&mut self, sample: &Sample) -> (u32, Look, bool) {
        let (force_squared, rate_squared) = sample.squares();
        let has_jumped = rate_squared > self.rate_jump_squared();
        // A NaN fails every comparison.
        let is_measurement = force_squared
            <= LARGEST_SPECIFIC_FORCE_M_S2 * LARGEST_SPECIFIC_FORCE_M_S2
            && rate_squared <= LARGEST_RATE_RAD_S * LARGEST_RATE_RAD_S;
        let mut look = Look::UNUSUAL;
        if !is_measurement {
            look.add(Look::REJECTED);
            return (0, look, has_jumped);
        }
        self.rate_squared = rate_squared;
        let shows_gravity = force_squared >= LEAST_SPECIFIC_FORCE_M_S2 * LEAST_SPECIFIC_FORCE_M_S2;
        if !shows_gravity {
            look.add(Look::NO_GRAVITY);
        }
        let step_us = match self.last_t_us.replace(sample.t_us) {
            // The first sample only sets the tilt.
            None => 0,
            Some(last) if sample.t_us <= last => {
                look.add(Look::TIME_WENT_BACK);
                return (0, look, has_jumped);
            }
            Some(last) => sample.t_us - last,
        };
        if step_us > LONGEST_STEP_US {
            look.add(Look::GAP);
        }
        if step_us == 0 || step_us > LONGEST_STEP_US {
            self.filter.start(sample, shows_gravity);
            return (0, look, has_jumped);
        }
        let step_us = step_us as u32;
        self.filter.allow_for(
            sample,
            step_us as f32 * SECONDS_PER_MICROSECOND,
            shows_gravity,
        );
        (step_us, look, has_jumped)
    }

    /// A larger rate than this, squared, is a jump.
    #[inline(always)]
    fn rate_jump_squared(&self) -> f32 {
        4.0 * self.rate_squared + RATE_JUMP_RAD_S * RATE_JUMP_RAD_S
    }

    /// Takes one sample this long after the one before, of which [`examine`](Self::examine) has said this, and gives the attitude at
    /// its time.
    #[inline(always)]
    pub(crate) fn take(&mut self, sample: &Sample, step_us: u32, look: Look) -> Taken {
        if step_us != 0 {
            let dt_s = step_us as f32 * SECONDS_PER_MICROSECOND;
            self.filter
                .update(sample, dt_s, !look.has(Look::NO_GRAVITY));
        }
        match self.filter.kalman() {
            Some(filter) => self.body_rates_rad_s = filter.body_rates_rad_s(),
            None if look.has(Look::REJECTED) => {}
            None => self.body_rates_rad_s = sample.angular_rate_rad_s,
        }
        Taken {
            attitude: self.attitude(),
            body_rates_rad_s: self.body_rates_rad_s,
            look,
            is_calibrating: self
                .filter
                .kalman()
                .is_some_and(|filter| !filter.is_bias_known()),
        }
    }

    /// The attitude after the last sample, body to earth.
    pub fn attitude(&self) -> Quaternion {
        self.filter.attitude()
    }

    /// The numbers of the classic tutorial; `None` with any other filter.
    pub fn classic_angles(&self) -> Option<ClassicAngles> {
        self.filter.classic_angles()
    }
}

/// A sample, with a specific force only where it shows gravity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Measurement {
    pub(crate) specific_force_m_s2: Option<Vector3>,
    pub(crate) angular_rate_rad_s: Vector3,
}

impl Measurement {
    fn of(sample: &Sample, shows_gravity: bool) -> Self {
        Self {
            specific_force_m_s2: shows_gravity.then_some(sample.specific_force_m_s2),
            angular_rate_rad_s: sample.angular_rate_rad_s,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::attitude::EulerAngles;

    const GRAVITY: Vector3 = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);

    /// What an ideal sensor in this attitude, turning so and not accelerating, reads.
    pub(crate) fn sample(t_us: u64, attitude: Quaternion, rate_rad_s: Vector3) -> Sample {
        Sample {
            t_us,
            specific_force_m_s2: attitude.conjugate().rotate(GRAVITY),
            angular_rate_rad_s: rate_rad_s,
            ..Sample::default()
        }
    }

    pub(crate) fn from_degrees(roll: f32, pitch: f32, yaw: f32) -> Quaternion {
        Quaternion::from_euler(EulerAngles {
            roll_rad: roll.to_radians(),
            pitch_rad: pitch.to_radians(),
            yaw_rad: yaw.to_radians(),
        })
    }

    /// The angle between two attitudes, in degrees.
    pub(crate) fn angle_between(a: Quaternion, b: Quaternion) -> f32 {
        let difference = a.conjugate().multiply(b).normalize();
        let vector = Vector3::new(difference.x, difference.y, difference.z);
        2.0 * f32::atan2(vector.norm(), difference.w.abs()).to_degrees()
    }

    fn is_rotation(attitude: Quaternion) -> bool {
        (attitude.dot(attitude) - 1.0).abs() < 1e-3
    }

    fn all() -> [Estimator; 3] {
        FilterKind::ALL.map(Estimator::new)
    }

    #[test]
    fn filters_have_names() {
        for kind in FilterKind::ALL {
            assert_eq!(FilterKind::parse(kind.name()), Some(kind));
        }
        assert_eq!(FilterKind::parse("kalman?"), None);
        assert_eq!(FilterKind::default(), FilterKind::Kalman);
    }

    #[test]
    fn the_first_sample_sets_the_tilt_and_yaw_is_zero() {
        for mut estimator in all() {
            let pose = from_degrees(35.0, -20.0, 0.0);
            let estimate = estimator.update(&sample(1_000, pose, Vector3::ZERO));
            assert_eq!(estimate.remarks, Remarks::default());
            // The classic angles are not Euler angles: its roll is that of a level nose.
            let tolerance = match estimator.filter {
                AnyFilter::Kalman(_) | AnyFilter::AxisKalman(_) => 1e-3,
                AnyFilter::Classic(_) => 4.0,
            };
            assert!(angle_between(estimate.attitude, pose) < tolerance);
            assert!(estimate.attitude.to_euler().yaw_rad.abs() < 1e-6);
        }
    }

    #[test]
    fn what_is_no_measurement_changes_nothing() {
        for mut estimator in all() {
            let pose = from_degrees(10.0, 0.0, 0.0);
            let rate = Vector3::new(0.1, 0.2, 0.3);
            let good = estimator.update(&sample(1_000, pose, rate));
            let before = estimator;
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 2.0e4, f32::MIN] {
                let mut wrong_force = sample(2_000, pose, rate);
                wrong_force.specific_force_m_s2.y = bad;
                let mut wrong_rate = sample(2_000, pose, rate);
                wrong_rate.angular_rate_rad_s.z = bad;
                for wrong in [wrong_force, wrong_rate] {
                    let estimate = estimator.update(&wrong);
                    assert!(estimate.remarks.rejected);
                    assert_eq!(estimate.attitude, good.attitude);
                    assert_eq!(estimate.body_rates_rad_s, rate);
                    assert_eq!(estimator, before);
                }
            }
        }
    }

    #[test]
    fn a_lost_sample_is_bridged_by_the_next() {
        // 100 °/s of roll; the estimator does not see the samples between 40 and 60 ms.
        let rate = Vector3::new(100_f32.to_radians(), 0.0, 0.0);
        let mut estimator = Estimator::new(FilterKind::AxisKalman);
        for millisecond in (0..100).filter(|ms| !(40..60).contains(ms)) {
            let pose = from_degrees(0.1 * millisecond as f32, 0.0, 0.0);
            let estimate = estimator.update(&sample(1_000 * millisecond, pose, rate));
            assert!(angle_between(estimate.attitude, pose) < 1e-3);
            assert_eq!(estimate.remarks, Remarks::default());
        }
    }

    #[test]
    fn time_that_stands_still_or_runs_back_holds_the_attitude() {
        let rate = Vector3::new(1.0, 0.0, 0.0);
        for mut estimator in all() {
            let pose = from_degrees(5.0, 5.0, 0.0);
            let held = estimator.update(&sample(1_000_000, pose, rate)).attitude;
            for t_us in [1_000_000, 999_999, 0] {
                let estimate = estimator.update(&sample(t_us, pose, rate));
                assert!(estimate.remarks.time_went_back, "{t_us}");
                assert_eq!(estimate.attitude, held);
            }
            // It went back to zero, and goes on from there.
            let estimate = estimator.update(&sample(10_000, pose, rate));
            assert_eq!(estimate.remarks, Remarks::default());
            assert_ne!(estimate.attitude, held);
        }
    }

    #[test]
    fn after_a_gap_the_tilt_is_new_and_yaw_is_kept() {
        let mut estimator = Estimator::new(FilterKind::AxisKalman);
        let turn = Vector3::new(0.0, 0.0, 1.0);
        for millisecond in 0..=500 {
            estimator.update(&sample(millisecond * 1000, Quaternion::IDENTITY, turn));
        }
        let yaw = estimator.attitude().to_euler().yaw_rad;
        assert!((yaw - 0.5).abs() < 1e-3);
        let pose = from_degrees(60.0, -40.0, 0.0);
        let t_us = 500_000 + LONGEST_STEP_US;
        let estimate = estimator.update(&sample(t_us, pose, Vector3::ZERO));
        assert!(!estimate.remarks.gap);
        let estimate = estimator.update(&sample(t_us + LONGEST_STEP_US + 1, pose, Vector3::ZERO));
        assert!(estimate.remarks.gap);
        let angles = estimate.attitude.to_euler();
        assert!((angles.roll_rad.to_degrees() - 60.0).abs() < 1e-3);
        assert!((angles.pitch_rad.to_degrees() + 40.0).abs() < 1e-3);
    }

    #[test]
    fn without_gravity_the_gyroscope_alone_turns() {
        let rate = Vector3::new(0.5, 0.0, 0.0);
        let mut estimator = Estimator::new(FilterKind::AxisKalman);
        estimator.update(&sample(0, Quaternion::IDENTITY, rate));
        for millisecond in 1..=1000 {
            let mut falling = sample(millisecond * 1000, Quaternion::IDENTITY, rate);
            // Whatever is left points the wrong way.
            falling.specific_force_m_s2 = Vector3::new(0.9 * LEAST_SPECIFIC_FORCE_M_S2, 0.0, 0.0);
            let estimate = estimator.update(&falling);
            assert!(estimate.remarks.no_gravity);
        }
        let angles = estimator.attitude().to_euler();
        assert!((angles.roll_rad - 0.5).abs() < 1e-4, "{angles:?}");
        assert!(angles.pitch_rad.abs() < 1e-4);
    }

    #[test]
    fn a_start_in_free_fall_finds_the_tilt_later() {
        for mut estimator in all() {
            for millisecond in 0..10 {
                let mut falling = sample(millisecond * 1000, Quaternion::IDENTITY, Vector3::ZERO);
                falling.specific_force_m_s2 = Vector3::ZERO;
                let estimate = estimator.update(&falling);
                assert!(estimate.remarks.no_gravity);
                assert_eq!(estimate.attitude, Quaternion::IDENTITY);
            }
            let pose = from_degrees(0.0, 30.0, 0.0);
            let estimate = estimator.update(&sample(10_000, pose, Vector3::ZERO));
            assert!(angle_between(estimate.attitude, pose) < 0.1);
        }
    }

    #[test]
    fn a_restart_zeroes_yaw_and_takes_the_tilt_afresh() {
        for mut estimator in all() {
            for millisecond in 0..300 {
                let rate = Vector3::new(0.3, 0.0, 1.0);
                estimator.update(&sample(millisecond * 1000, Quaternion::IDENTITY, rate));
            }
            assert!(estimator.attitude().to_euler().yaw_rad > 0.2);
            estimator.restart();
            let pose = from_degrees(0.0, 10.0, 0.0);
            let estimate = estimator.update(&sample(300_000, pose, Vector3::ZERO));
            assert!(angle_between(estimate.attitude, pose) < 0.1);
            // The jump is no motion: the classic rate does not show it.
            if let Some(angles) = estimator.classic_angles() {
                assert_eq!(angles.pitch_rate_deg_s, 0.0);
            }
        }
    }

    #[test]
    fn a_restart_keeps_the_sign_of_the_quaternion() {
        for mut estimator in all() {
            // A steady turn about the vertical must not be taken for rest.
            estimator.set_armed(true);
            // After 300° of yaw the scalar part is negative.
            for millisecond in 0..3_000 {
                let rate = Vector3::new(0.0, 0.0, 100_f32.to_radians());
                estimator.update(&sample(millisecond * 1000, Quaternion::IDENTITY, rate));
            }
            let before = estimator.attitude();
            assert!(before.w < -0.8);
            estimator.restart();
            let level = sample(3_000_000, Quaternion::IDENTITY, Vector3::ZERO);
            let after = estimator.update(&level).attitude;
            assert!(after.w < -0.99 && after.dot(before) > 0.8, "{after:?}");
        }
    }

    #[test]
    fn anything_in_leaves_a_rotation_and_good_samples_repair_it() {
        let extremes = [
            0.0,
            -0.0,
            f32::NAN,
            f32::INFINITY,
            f32::MAX,
            f32::MIN_POSITIVE,
            9_999.0,
            -999.0,
            1.0,
            -9.8,
        ];
        let times = [0, 1, 1, 700_000, 700_001, u64::MAX, 3, 1_000_003, 1_000_103];
        for mut estimator in all() {
            let mut index = 0_usize;
            let mut next = || {
                index = index
                    .wrapping_mul(6364136223846793005)
                    .wrapping_add(1442695040888963407);
                index >> 33
            };
            for _ in 0..50_000 {
                let mut number = || extremes[next() % extremes.len()];
                let specific_force_m_s2 = Vector3::new(number(), number(), number());
                let angular_rate_rad_s = Vector3::new(number(), number(), number());
                let estimate = estimator.update(&Sample {
                    t_us: times[next() % times.len()],
                    specific_force_m_s2,
                    angular_rate_rad_s,
                    ..Sample::default()
                });
                assert!(is_rotation(estimate.attitude), "{estimate:?}");
                assert!(estimate.body_rates_rad_s.is_within(1.0e3));
            }
            let pose = from_degrees(12.0, 0.0, 0.0);
            let mut last = estimator.attitude();
            for millisecond in 0..8_000 {
                let good = sample(2_000_000_000 + millisecond * 1000, pose, Vector3::ZERO);
                last = estimator.update(&good).attitude;
            }
            let tilt_error = (last.down_in_body() - pose.down_in_body()).norm();
            // What the nonsense taught of the accelerometer's bias goes away more slowly.
            let tolerance = match estimator.filter {
                AnyFilter::Kalman(_) => 2e-2,
                AnyFilter::AxisKalman(_) | AnyFilter::Classic(_) => 2e-3,
            };
            assert!(tilt_error < tolerance, "{estimator:?}");
        }
    }
}
