//! Tuning of the heading filter: one set of numbers for every compass.
//!
//! Units are µT, rad and s. Noises are standard deviations (σ) or densities per root of time; the
//! rest are times, ratios and limits.
//!
//! # Sources
//!
//! The *prototype* is a joint filter of 28 states in Python, tuned on BROAD's trials with a compass
//! (Laidig and others, *Data* 6(7), 2021). No search is recorded. The *promise* is that of
//! `aplomb-bench --heading-promise`. Its limits were set with seeds 20000 to 20249 and 60000 to
//! 60249.
//!
//! | numbers | source |
//! |---|---|
//! | `start_field_ut`, walks, `deviation_still_s`, `moving_*`, `least_motion` | prototype |
//! | `gate`, `excess_*`, `largest_excess_ut`, `restart_*`, `known_rad` | prototype |
//! | `drift_memory_s` | first guess; 30 and 120 s have BROAD's mean 0.02 higher and 0.01 lower |
//! | `noise_ut` | prototype; with the true attitude BROAD's residual is 0.9 to 1.2 µT |
//! | `noise_per_rate` | prototype: 1; BROAD's residual does not grow up to 8.5 rad/s |
//! | `deviation_ut` | prototype: 3.5; BROAD with magnets has 1.29/2.15° instead of 1.32/2.21° |
//! | `deviation_moving_s` | prototype; 0.1 s made a heading of the promise wrong |
//! | `consistency_s` | no reason is recorded |
//! | `valid_rad`, `valid_tilt_rad` | were 0.26 and 0.1; lowered for the promise |
//! | `valid_inconsistency`, `valid_silence_s`, `verified_half_sine`, 2.5 s | the promise |
//! | `verified_uncalibrated_after_s` | of 500 flights with faults 1 was wrong instead of 5 |

/// Largest σ of the tilt, both axes together, of a valid heading, rad: 4°. The flag
/// `HEADING_VALID` has this limit with any tuning, beside [`HeadingTuning::valid_tilt_rad`].
pub(crate) const VALID_TILT_RAD: f32 = 0.07;

/// The heading filter's tuning.
///
/// Every number is positive and finite: the filter divides by some of them, and checks none.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct HeadingTuning {
    /// σ of the field at start, per axis, µT.
    pub start_field_ut: f32,
    /// Random walk of the field, µT/√s.
    pub field_walk: f32,
    /// Random walk of yaw beyond the gyroscope's noise, rad/√s.
    pub yaw_walk: f32,
    /// Time in which the corrections of yaw add up to their rate, s. Shorter: follows an offset
    /// that changes faster, but also disturbances.
    pub drift_memory_s: f32,
    /// Random walk of the hard iron, µT/√s. Larger: follows a change sooner.
    pub hard_iron_walk: f32,
    /// σ of the slow local deviation, per axis, µT.
    pub deviation_ut: f32,
    /// Time constant of the local deviation in motion, s: a new place has another deviation.
    pub deviation_moving_s: f32,
    /// Time constant of the local deviation at rest, s. Larger: a wrong field at rest is averaged
    /// less.
    pub deviation_still_s: f32,
    /// Rate that counts as full motion, rad/s.
    pub moving_rate_rad_s: f32,
    /// Acceleration that counts as full motion, m/s².
    pub moving_acceleration_m_s2: f32,
    /// Time for which motion counts after its end, s.
    pub moving_hold_s: f32,
    /// Share of full motion below which nothing moves.
    pub least_motion: f32,
    /// σ of the mean field of one interval, per axis, µT. The prototype's intervals had 0.1 s;
    /// those of today have 0.22 s at 1 kHz.
    pub noise_ut: f32,
    /// Noise per rate, µT per rad/s: errors of time and of the axes. 0.5: an error of 10 ms in a
    /// field of 50 µT.
    pub noise_per_rate: f32,
    /// Share of the expected squared innovation from which on the rest is a disturbance.
    pub gate: f32,
    /// Variance of the noise per excess of the squared innovation, both in µT².
    pub excess_to_noise: f32,
    /// Time for which an excess opens the models, s.
    pub excess_s: f32,
    /// Variance of the local deviation per excess, both in µT².
    pub excess_to_deviation: f32,
    /// Noise of the hard iron per excess, 1/s: a magnet may have been attached.
    pub excess_to_hard_iron: f32,
    /// Largest excess, µT.
    pub largest_excess_ut: f32,
    /// Averaging time of the innovation that restarts the filter, s.
    pub restart_average_s: f32,
    /// Time of contradiction after which the filter restarts, s.
    pub restart_after_s: f32,
    /// Squared innovation per squared error of the field's length that is a contradiction.
    pub restart_ratio: f32,
    /// Least innovation that is a contradiction, µT.
    pub restart_floor_ut: f32,
    /// σ of the hard iron after a restart, beyond that at start, µT.
    pub restart_hard_iron_ut: f32,
    /// Averaging time of the innovation's consistency, s.
    pub consistency_s: f32,
    /// σ of the heading below which it is reported, rad.
    pub known_rad: f32,
    /// σ of the heading below which it may be valid, rad.
    pub valid_rad: f32,
    /// σ of the tilt below which turns count and the heading may be valid, rad.
    pub valid_tilt_rad: f32,
    /// Mean squared innovation per expected one below which the heading may be valid.
    pub valid_inconsistency: f32,
    /// Time without readings after which the heading is not valid any more, s.
    pub valid_silence_s: f32,
    /// Sine of half the smallest turn that counts, about each axis: it shows iron, magnets and a
    /// wrong mount. 0.105: 12°.
    pub verified_half_sine: f32,
    /// Time in motion beyond that turn after which the heading may be valid, s.
    pub verified_after_s: f32,
    /// `verified_after_s` for a compass whose hard iron is unknown, which hides a wrong mount for
    /// longer.
    pub verified_uncalibrated_after_s: f32,
}

impl HeadingTuning {
    /// The default tuning.
    pub const DEFAULT: Self = Self {
        start_field_ut: 60.0,
        field_walk: 0.02,
        yaw_walk: 0.007,
        drift_memory_s: 60.0,
        hard_iron_walk: 0.005,
        deviation_ut: 3.0,
        deviation_moving_s: 0.2,
        deviation_still_s: 10.0,
        moving_rate_rad_s: 0.5,
        moving_acceleration_m_s2: 2.0,
        moving_hold_s: 0.5,
        least_motion: 0.15,
        noise_ut: 2.0,
        noise_per_rate: 0.5,
        gate: 0.2,
        excess_to_noise: 20.0,
        excess_s: 1.0,
        excess_to_deviation: 0.02,
        excess_to_hard_iron: 0.05,
        largest_excess_ut: 60.0,
        restart_average_s: 10.0,
        restart_after_s: 5.0,
        restart_ratio: 10.0,
        restart_floor_ut: 6.0,
        restart_hard_iron_ut: 10.0,
        consistency_s: 5.0,
        known_rad: 0.5,
        valid_rad: 0.22,
        valid_tilt_rad: VALID_TILT_RAD,
        valid_inconsistency: 0.4,
        valid_silence_s: 1.0,
        verified_half_sine: 0.105,
        verified_after_s: 2.5,
        verified_uncalibrated_after_s: 6.0,
    };
}

impl Default for HeadingTuning {
    fn default() -> Self {
        Self::DEFAULT
    }
}
