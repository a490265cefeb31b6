//! Heading correction of VQF, and its rejection of magnetic disturbances.
//!
//! One angle turns the attitude without magnetometer to north. A first-order filter moves it. Norm
//! and dip of the field decide whether a reading counts.

use std::f64::consts::PI;

use aplomb_models::motion::geometry::{Vector, norm};

use super::low_pass::LowPass;

/// Time constant of the heading correction, s.
const CORRECTION_S: f64 = 9.0;
/// Time constant of the field's norm and dip, s.
const FIELD_S: f64 = 0.05;
/// Time constant with which a reference follows the field, s.
const REFERENCE_S: f64 = 20.0;
/// Largest distance of a norm from its reference, as a share of it.
const NORM_TOLERANCE: f64 = 0.1;
/// Largest distance of a dip from its reference: 10°.
const DIP_TOLERANCE_RAD: f64 = 10.0 / 180.0 * PI;
/// Time near the reference after which a disturbance is over, s.
const UNDISTURBED_S: f64 = 0.5;
/// Time in motion after which another field becomes the reference, s.
const ANOTHER_S: f64 = 20.0;
/// Time in motion after which the first field becomes the reference, s.
const FIRST_S: f64 = 5.0;
/// Least rate that counts as motion here: 20 °/s.
const MOTION_RAD_S: f64 = 20.0 / 180.0 * PI;
/// Longest full rejection of disturbed readings, s.
const REJECTION_S: f64 = 60.0;
/// Factor by which a long disturbance slows the correction, and by which undisturbed time restores
/// the time of rejection.
const REJECTION_FACTOR: f64 = 2.0;

/// Norm, in the unit of the readings, and dip, rad, of a field.
#[derive(Clone, Copy)]
struct NormDip {
    norm: f64,
    dip_rad: f64,
}

impl NormDip {
    /// Returns whether a field is near this reference.
    fn is_near(self, field: Self) -> bool {
        (field.norm - self.norm).abs() < NORM_TOLERANCE * self.norm
            && (field.dip_rad - self.dip_rad).abs() < DIP_TOLERANCE_RAD
    }

    fn follow(&mut self, field: Self, gain: f64) {
        self.norm += gain * (field.norm - self.norm);
        self.dip_rad += gain * (field.dip_rad - self.dip_rad);
    }
}

/// Heading correction.
pub struct HeadingCorrection {
    step_s: f64,
    /// Turn about "up" from the frame without magnetometer to east, north, up, rad.
    offset_rad: f64,
    /// Number of readings, as long as their mean counts.
    first_readings: Option<u32>,
    disturbance: Disturbance,
    rejected_s: f64,
}

impl HeadingCorrection {
    /// Creates a correction for readings that are `step_s` apart.
    pub fn new(step_s: f64) -> Self {
        Self {
            step_s,
            offset_rad: 0.0,
            first_readings: Some(0),
            disturbance: Disturbance::new(step_s),
            // An unknown field counts from the start, though less.
            rejected_s: REJECTION_S,
        }
    }

    /// Returns the turn about "up" to east, north, up, rad.
    pub const fn offset_rad(&self) -> f64 {
        self.offset_rad
    }

    /// Takes a reading in the level frame without magnetometer, and the size of the low-passed
    /// rate, rad/s.
    pub fn update(&mut self, level: Vector, rate_rad_s: f64) {
        self.disturbance.update(level, rate_rad_s);
        let disagreement = wrap(level[0].atan2(level[1]) - self.offset_rad);
        let gain = self.steady_gain().max(self.first_gain());
        self.offset_rad = wrap(self.offset_rad + gain * disagreement);
    }

    /// Returns the gain by the time constant and the disturbance.
    fn steady_gain(&mut self) -> f64 {
        let gain = gain_of(CORRECTION_S, self.step_s);
        if !self.disturbance.is_present {
            let restored = self.rejected_s - REJECTION_FACTOR * self.step_s;
            self.rejected_s = restored.max(0.0);
            gain
        } else if self.rejected_s <= REJECTION_S {
            self.rejected_s += self.step_s;
            0.0
        } else {
            gain / REJECTION_FACTOR
        }
    }

    /// Returns the gain that makes the offset the mean of the first readings.
    fn first_gain(&mut self) -> f64 {
        let Some(readings) = self.first_readings else {
            return 0.0;
        };
        let goes_on = f64::from(readings + 2) * self.step_s < CORRECTION_S;
        self.first_readings = goes_on.then_some(readings + 1);
        1.0 / f64::from(readings + 1)
    }
}

/// Detector of magnetic disturbances.
struct Disturbance {
    step_s: f64,
    field: LowPass<2>,
    /// Field that is not disturbed.
    reference: NormDip,
    /// Field that may become the reference.
    candidate: NormDip,
    has_reference: bool,
    is_present: bool,
    undisturbed_s: f64,
    candidate_s: f64,
}

impl Disturbance {
    fn new(step_s: f64) -> Self {
        let none = NormDip {
            norm: 0.0,
            dip_rad: 0.0,
        };
        Self {
            step_s,
            field: LowPass::new(FIELD_S, step_s),
            reference: none,
            candidate: none,
            has_reference: false,
            is_present: true,
            undisturbed_s: 0.0,
            candidate_s: 0.0,
        }
    }

    fn update(&mut self, level: Vector, rate_rad_s: f64) {
        let size = norm(level);
        let [norm, dip_rad] = self.field.update([size, -(level[2] / size).asin()]);
        let field = NormDip { norm, dip_rad };
        let gain = gain_of(REFERENCE_S, self.step_s);
        if self.reference.is_near(field) {
            self.undisturbed_s += self.step_s;
            if self.undisturbed_s >= UNDISTURBED_S {
                self.is_present = false;
                self.reference.follow(field, gain);
            }
        } else {
            self.undisturbed_s = 0.0;
            self.is_present = true;
        }
        if !self.candidate.is_near(field) {
            self.candidate = field;
            self.candidate_s = 0.0;
            return;
        }
        if rate_rad_s >= MOTION_RAD_S {
            self.candidate_s += self.step_s;
        }
        self.candidate.follow(field, gain);
        let needed_s = if self.has_reference {
            ANOTHER_S
        } else {
            FIRST_S
        };
        if self.is_present && self.candidate_s >= needed_s {
            self.reference = self.candidate;
            self.has_reference = true;
            self.is_present = false;
            self.undisturbed_s = UNDISTURBED_S;
        }
    }
}

/// Returns the gain of a first-order filter of this time constant.
fn gain_of(time_s: f64, step_s: f64) -> f64 {
    1.0 - (-step_s / time_s).exp()
}

/// Wraps an angle of up to three half turns, rad.
fn wrap(angle_rad: f64) -> f64 {
    if angle_rad > PI {
        angle_rad - 2.0 * PI
    } else if angle_rad < -PI {
        angle_rad + 2.0 * PI
    } else {
        angle_rad
    }
}
