//! Confirmation of the bias: whether it may have changed, and what that means for σ of the tilt.
//!
//! A bias may be wrong, and its covariance small:
//!
//! - A stored bias may have changed since it was measured.
//! - Motion contradicts a bias that has changed, and one of a vehicle that turns for long: in a
//!   coordinated turn of minutes a wrong tilt and a wrong bias explain all readings together.
//! - A wide turn moves tilt and bias so slowly that nothing contradicts them. At 50 m/s a bank of
//!   9° reads as level with a bias of 0.3 °/s.
//! - A reset of the core or a pause hides motion. So for up to 20 s no correction fails the
//!   consistency test, and for some seconds more none may have done so yet. Meanwhile the tilt may
//!   become that of level flight in a turn.
//!
//! Therefore the bias has a reference: that of the last rest, which a reset keeps, or else the
//! stored bias. A bias that may be wrong has to be confirmed: by a rest, or by motion that leads it
//! back to within 0.2 °/s of the reference and makes it certain. Until then σ of the tilt has a
//! least value, in motion or while armed (`tilt_variance.rs`):
//!
//! | state | least σ of the tilt | known, with σ below 0.5 °/s |
//! |---|---|---|
//! | `Confirmed` | 4° under suspicion, else none | yes |
//! | `Drifted` | 4° | yes |
//! | `Stored` | 4° and the bank that the force shows | yes |
//! | `Suspect` | 6.4° and that bank | within 1 °/s of the reference |
//!
//! These events change the state, each from any state unless the table limits it. All others keep
//! it. The last three are judged after each correction (`judge_bias`). "Near" is within 0.2 °/s of
//! the reference, with a small σ, while the consistency test is not suspended.
//!
//! | event | new state | from | where |
//! |---|---|---|---|
//! | a new filter, `restart` | `Confirmed` | | `fresh` |
//! | a stored bias | `Stored` | | `set_bias` |
//! | a rest measures the bias | `Confirmed` | | `measure_at_rest` |
//! | the corrections fail the consistency test | `Suspect` | | `admit_changed_bias` |
//! | core reset, wrong samples | `Suspect` | | `resume`, `inflate_motion` |
//! | a hidden turn of 2° or more, such as a pause | `Suspect` | | `inflate_tilt` |
//! | a gap, or a sample that sets a lost tilt | `Suspect` | | `level_to` |
//! | near, and the consistency test is conclusive | `Confirmed` | | `judge_bias` |
//! | near, and it is not conclusive yet | `Drifted` | `Suspect` | `judge_bias` |
//! | a known bias is farther than 0.2 °/s | `Drifted` | `Confirmed` | `judge_bias` |
//!
//! Five terms, which are not the same:
//!
//! | term | field | meaning |
//! |---|---|---|
//! | rested | `has_rested` | a rest of this run has measured the bias |
//! | measured before | `has_measured_prior` | a rest of an earlier run had; the start has its σ |
//! | measured | `is_bias_measured()` | either of both |
//! | known | `is_bias_known` | measured, with a small σ, and the last column above |
//! | confirmed | `confirmation` | nothing has put the measured bias in question since |

use super::{KNOWN_BIAS_RAD_S, Kalman};
use crate::estimator::arithmetic::{larger, square};
use crate::serialize::StateVisitor;
use crate::units::radians;

/// Largest σ of a bias that is confirmed, of the two axes that are known best, together: below
/// that of a stored bias at the start. In level flight σ of the third one, about the vertical,
/// grows.
const CONFIRMED_SIGMA_RAD_S: f32 = radians(0.42);
/// Largest change of a bias that is confirmed, from the reference. With 0.3 °/s two of 112 flights
/// in wide turns and circles were `VALID` and wrong, one for four minutes.
const CONFIRMED_CHANGE_RAD_S: f32 = radians(0.2);
/// Largest change of a suspect bias that is known: a flight in turns had one of 5 °/s.
const KNOWN_CHANGE_RAD_S: f32 = radians(1.0);

/// Confirmation of the bias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub(super) enum Confirmation {
    /// Confirmed; or nothing has put it in question.
    Confirmed,
    /// Drifted by over 0.2 °/s from its reference, and not contradicted.
    Drifted,
    /// Contradicted by motion, or motion was hidden by a reset or a pause.
    Suspect,
    /// Stored, and not confirmed since the start.
    Stored,
}

impl Confirmation {
    /// Visits the variant, as its number.
    pub(super) fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        let mut number = *self as usize;
        visitor.index(&mut number, 4);
        *self = match number {
            0 => Self::Confirmed,
            1 => Self::Drifted,
            2 => Self::Suspect,
            _ => Self::Stored,
        };
    }
}

impl Kalman {
    /// Updates after a correction whether the bias is confirmed and known.
    ///
    /// - Near its reference and certain, it is confirmed. But while unseen motion suspends the
    ///   consistency test, nothing changes. When the test runs again, a suspect bias counts as
    ///   drifted, and once the test is conclusive, as confirmed.
    /// - Farther off, a confirmed and known bias has drifted. An unknown one still converges.
    #[inline(never)]
    pub(super) fn judge_bias(&mut self) {
        let [x, y, z] = self.step.covariance.bias_variances();
        let variance = larger(larger(x, y), z);
        let better_two = x + y + z - variance;
        let change = self.bias_change_rad_s();
        let squared_change = change.dot(change);
        if squared_change < square(CONFIRMED_CHANGE_RAD_S) {
            if better_two < square(CONFIRMED_SIGMA_RAD_S) && !self.consistency.is_suspended() {
                if self.consistency.is_conclusive() {
                    self.confirmation = Confirmation::Confirmed;
                } else if self.confirmation == Confirmation::Suspect {
                    self.confirmation = Confirmation::Drifted;
                }
            }
        } else if self.is_bias_known && self.confirmation == Confirmation::Confirmed {
            self.confirmation = Confirmation::Drifted;
        }
        self.is_bias_known = variance < square(KNOWN_BIAS_RAD_S)
            && (squared_change < square(KNOWN_CHANGE_RAD_S)
                || self.confirmation != Confirmation::Suspect)
            && self.is_bias_measured();
    }
}
