//! A body at rest, optionally nudged once: motion whose every quantity has a closed form.

use super::Motion;
use super::geometry::Quaternion;
use super::truth::Truth;
use super::turn::Turn;

/// Rest in one attitude, until a nudge turns the body out and back.
#[derive(Clone, Debug)]
pub struct Rest {
    attitude: Quaternion,
    nudge: Option<Nudge>,
}

#[derive(Clone, Debug)]
struct Nudge {
    start_s: f64,
    half_s: f64,
    out: Turn,
    back: Turn,
}

impl Rest {
    /// Rest in `attitude`, body → earth.
    #[must_use]
    pub fn new(attitude: Quaternion) -> Self {
        Self {
            attitude,
            nudge: None,
        }
    }

    /// Rest on a level table.
    #[must_use]
    pub fn level() -> Self {
        Self::new(Quaternion::IDENTITY)
    }

    /// Adds a nudge: from `start_s` on the body rolls by `angle_rad` and back, in `duration_s`
    /// altogether.
    #[must_use]
    pub fn nudged(self, start_s: f64, duration_s: f64, angle_rad: f64) -> Self {
        let out = self
            .attitude
            .multiply(Quaternion::from_rotation_vector([angle_rad, 0.0, 0.0]));
        let half_s = 0.5 * duration_s;
        Self {
            nudge: Some(Nudge {
                start_s,
                half_s,
                out: Turn::new(self.attitude, out, half_s),
                back: Turn::new(out, self.attitude, half_s),
            }),
            ..self
        }
    }
}

impl Motion for Rest {
    fn at(&mut self, time_s: f64) -> Truth {
        let (attitude, body_rates_rad_s) = match &self.nudge {
            None => (self.attitude, [0.0; 3]),
            Some(nudge) => {
                let elapsed = time_s - nudge.start_s;
                if elapsed < nudge.half_s {
                    nudge.out.at(elapsed)
                } else {
                    nudge.back.at(elapsed - nudge.half_s)
                }
            }
        };
        Truth::turning(attitude, body_rates_rad_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::geometry::norm;
    use crate::motion::truth::{STANDARD_GRAVITY_M_S2, inclination_error_rad};

    #[test]
    fn rest_is_constant() {
        let attitude = Quaternion::from_euler(0.3, 0.1, 0.0);
        let mut rest = Rest::new(attitude);
        assert_eq!(rest.at(0.0), rest.at(100.0));
        assert_eq!(rest.at(0.0).attitude, Some(attitude));
        assert!((norm(rest.at(0.0).specific_force_m_s2) - STANDARD_GRAVITY_M_S2).abs() < 1e-12);
    }

    #[test]
    fn a_nudge_goes_out_and_comes_back() {
        let mut rest = Rest::level().nudged(1.0, 0.4, 0.2);
        let tilt =
            |truth: Truth| inclination_error_rad(truth.attitude.unwrap(), Quaternion::IDENTITY);
        assert_eq!(rest.at(0.9), Rest::level().at(0.0));
        assert!(norm(rest.at(1.1).body_rates_rad_s) > 0.5);
        assert!((tilt(rest.at(1.2)) - 0.2).abs() < 1e-12);
        assert!(rest.at(1.3).body_rates_rad_s[0] < -0.5);
        assert!(tilt(rest.at(1.4)) < 1e-12);
        assert_eq!(rest.at(2.0).body_rates_rad_s, [0.0; 3]);
    }
}
