//! Classic tutorial's line: `Roll:<angle>(<rate>),⇥Pitch:<angle>(<rate>)`.
//!
//! Angles are degrees, rates °/s, both with two decimals. The rates are the derivatives of the
//! angles, not the body's own. Roll is positive right wing down and pitch positive nose up, as in
//! the tutorial for a chip that lies face down.
//!
//! ```
//! use aplomb::telemetry::classic;
//!
//! let angles = classic::decode("Roll:12.34(-5.60),\tPitch:-0.50(0.00)\n").unwrap();
//! assert_eq!((angles.roll_deg, angles.roll_rate_deg_s), (12.34, -5.6));
//! ```

use super::decimal::{self, LONGEST_NUMBER, Writer};
use crate::attitude::sine_cosine;
use crate::estimator::classic::ClassicAngles;
use crate::pipeline::Snapshot;
use crate::units::degrees;

/// Lower limit of the cosine of pitch, 0.06° from the vertical, where the rate of roll has no
/// limit.
const MIN_PITCH_COSINE: f32 = 1.0e-3;

/// Length of the longest line with its newline, in bytes.
pub const LINE_LENGTH: usize = "Roll:(),\tPitch:()\n".len() + 4 * LONGEST_NUMBER;

/// Returns roll and pitch of a snapshot with their derivatives.
///
/// φ' = p + (q sin φ + r cos φ) tan θ and θ' = q cos φ − r sin φ, with roll φ, pitch θ
/// and the body's rates p, q, r.
#[inline(never)]
pub fn angles_of(snapshot: &Snapshot) -> ClassicAngles {
    let angles = snapshot.euler();
    let rates = snapshot.body_rates_rad_s;
    let (roll_sine, roll_cosine) = sine_cosine(angles.roll_rad);
    let (pitch_sine, pitch_cosine) = sine_cosine(angles.pitch_rad);
    let yaw_share =
        (rates.y * roll_sine + rates.z * roll_cosine) / pitch_cosine.max(MIN_PITCH_COSINE);
    ClassicAngles {
        roll_deg: degrees(angles.roll_rad),
        roll_rate_deg_s: degrees(rates.x + yaw_share * pitch_sine),
        pitch_deg: degrees(angles.pitch_rad),
        pitch_rate_deg_s: degrees(rates.y * roll_cosine - rates.z * roll_sine),
    }
}

/// Encodes a line with its newline, and returns it.
#[inline(never)]
pub fn encode<'a>(angles: &ClassicAngles, line: &'a mut [u8; LINE_LENGTH]) -> &'a [u8] {
    let mut writer = Writer::new(line);
    writer.text("Roll:");
    writer.number(angles.roll_deg);
    writer.text("(");
    writer.number(angles.roll_rate_deg_s);
    writer.text("),\tPitch:");
    writer.number(angles.pitch_deg);
    writer.text("(");
    writer.number(angles.pitch_rate_deg_s);
    writer.text(")\n");
    writer.finish()
}

/// Decodes a line, with or without its end; `None` if it is not one.
pub fn decode(line: &str) -> Option<ClassicAngles> {
    let line = line.strip_suffix('\n').unwrap_or(line);
    let line = line.strip_suffix('\r').unwrap_or(line);
    let line = line.strip_prefix("Roll:")?;
    let (roll, line) = line.split_once('(')?;
    let (roll_rate, line) = line.split_once("),\tPitch:")?;
    let (pitch, line) = line.split_once('(')?;
    let pitch_rate = line.strip_suffix(')')?;
    Some(ClassicAngles {
        roll_deg: decimal::parse(roll)?,
        roll_rate_deg_s: decimal::parse(roll_rate)?,
        pitch_deg: decimal::parse(pitch)?,
        pitch_rate_deg_s: decimal::parse(pitch_rate)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const EXAMPLE: ClassicAngles = ClassicAngles {
        roll_deg: 12.34,
        roll_rate_deg_s: -5.6,
        pitch_deg: -0.5,
        pitch_rate_deg_s: 0.0,
    };

    #[test]
    fn the_line_has_the_format_of_the_tutorial_and_reads_back() {
        let mut line = [0; LINE_LENGTH];
        let text = core::str::from_utf8(encode(&EXAMPLE, &mut line)).expect("ASCII");
        assert_eq!(text, "Roll:12.34(-5.60),\tPitch:-0.50(0.00)\n");
        assert_eq!(decode(text), Some(EXAMPLE));
        assert_eq!(decode(&text.replace("Pitch", "pitch")), None);
        assert_eq!(decode(&text.replace(")\n", "\n")), None);
    }

    #[test]
    fn the_rates_are_those_of_the_angles() {
        use crate::attitude::{EulerAngles, Quaternion, Vector3};
        use crate::units::radians;

        let rates = Vector3::new(radians(30.0), radians(-50.0), radians(70.0));
        for (roll, pitch) in [(0.0, 0.0), (25.0, -40.0), (-100.0, 60.0), (170.0, 10.0)] {
            let attitude = Quaternion::from_euler(EulerAngles {
                roll_rad: radians(roll),
                pitch_rad: radians(pitch),
                yaw_rad: 1.0,
            });
            let at = |seconds: f32| {
                let turn = Quaternion::from_rotation_vector(rates.scale(seconds));
                angles_of(&Snapshot {
                    attitude: attitude.multiply(turn),
                    body_rates_rad_s: rates,
                    ..Snapshot::default()
                })
            };
            // The oracle is the difference of the angles over 20 ms.
            let (before, now, after) = (at(-0.01), at(0.0), at(0.01));
            let roll_rate = (after.roll_deg - before.roll_deg) / 0.02;
            let pitch_rate = (after.pitch_deg - before.pitch_deg) / 0.02;
            assert!(
                (now.roll_rate_deg_s - roll_rate).abs() < 0.6,
                "{now:?} {roll_rate}"
            );
            assert!(
                (now.pitch_rate_deg_s - pitch_rate).abs() < 0.6,
                "{now:?} {pitch_rate}"
            );
        }
        // Straight up, where roll and yaw are one: still numbers.
        let up = Snapshot {
            attitude: Quaternion::from_rotation_vector(Vector3::new(0.0, radians(90.0), 0.0)),
            body_rates_rad_s: rates,
            ..Snapshot::default()
        };
        assert!(angles_of(&up).roll_rate_deg_s.is_finite());
    }

    #[test]
    fn the_longest_line_fits_exactly() {
        let worst = f32::NEG_INFINITY;
        let angles = ClassicAngles {
            roll_deg: worst,
            roll_rate_deg_s: worst,
            pitch_deg: worst,
            pitch_rate_deg_s: worst,
        };
        let mut line = [0; LINE_LENGTH];
        let text = encode(&angles, &mut line);
        assert_eq!(text.len(), LINE_LENGTH);
        assert!(text.ends_with(b")\n"));
    }
}
