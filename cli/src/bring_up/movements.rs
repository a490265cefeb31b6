//! Steps in which a person moves the board: six poses, and turns by hand.

use std::time::{Duration, Instant};

use aplomb::units::STANDARD_GRAVITY_M_S2;
use aplomb_recordings::terminal::print_line;

use super::report::Finding;
use super::wiring::show;
use crate::stream::{Item, field, numbers};
use crate::talk::Talk;

/// Largest offsets, mg (product specification, 6.2).
const MOST_OFFSET_MG: [f64; 3] = [50.0, 50.0, 80.0];
/// Largest error of scale (product specification, 6.2).
const MOST_SCALE: f64 = 0.03;

/// Smallest turn that counts, degrees.
const TURN_DEG: f32 = 25.0;
/// Largest tilt of a level body, degrees.
const LEVEL_DEG: f32 = 12.0;

/// Measures six poses against gravity.
pub fn poses(talk: &mut Talk, patience: Duration) -> Result<Finding, String> {
    let text = match talk.perform("calibrate accel", patience, show) {
        Ok(Ok(text)) => text,
        stopped => {
            // Otherwise the module would measure on.
            let is_stopped = talk.ask_in_any_case("calibrate stop");
            let reason = stopped?.err().unwrap_or_default();
            is_stopped?;
            return Ok(Finding::skipped(reason));
        }
    };
    // Six poses with six parameters always leave no residual: only the result can be wrong.
    let Some((is_good, found)) = within_datasheet(&talk.ask("show")?) else {
        return Ok(Finding::bad(text, "`show` names no calibration: repeat it"));
    };
    Ok(Finding::new(is_good, format!("{text}; {found}")).advise(
        "repeat it on a flat table, with the module's edges as feet; a part that stays beyond \
         its datasheet (3 % of scale, 50 to 80 mg of offset) is a clone, or damaged",
    ))
}

/// Returns whether offset and scale in an answer to `show` are within the datasheet, and both as
/// text; `None` if there are none.
fn within_datasheet(answer: &str) -> Option<(bool, String)> {
    let offset = numbers(answer, "accel_offset");
    let matrix = numbers(answer, "accel_matrix");
    let (&[x, y, z], &[xx, yy, zz, ..]) = (&offset[..], &matrix[..]) else {
        return None;
    };
    let offset_mg = [x, y, z].map(|m_s2| m_s2 / f64::from(STANDARD_GRAVITY_M_S2) * 1000.0);
    // The matrix is the inverse of the scale.
    let scale = [xx, yy, zz].map(|element| 1.0 / element - 1.0);
    let offsets = offset_mg.iter().zip(MOST_OFFSET_MG);
    let is_good = offsets
        .into_iter()
        .all(|(offset, most)| offset.abs() <= most)
        && scale.iter().all(|scale| scale.abs() <= MOST_SCALE);
    let ([ox, oy, oz], [sx, sy, sz]) = (offset_mg, scale.map(|scale| 100.0 * scale));
    Some((
        is_good,
        format!("offset {ox:.0} {oy:.0} {oz:.0} mg, scale {sx:+.1} {sy:+.1} {sz:+.1} %"),
    ))
}

/// Angles of an attitude, degrees.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Angles {
    roll: f32,
    pitch: f32,
    yaw: f32,
}

/// Turn by hand.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turn {
    Level,
    RightDown,
    NoseUp,
    Clockwise,
}

impl Turn {
    const ALL: [Self; 6] = [
        Self::Level,
        Self::RightDown,
        Self::Level,
        Self::NoseUp,
        Self::Level,
        Self::Clockwise,
    ];

    const fn instruction(self) -> &'static str {
        match self {
            Self::Level => "lay it level, as it will fly",
            Self::RightDown => "tip its right side down, by 40 degrees",
            Self::NoseUp => "lift its nose, by 40 degrees",
            Self::Clockwise => "turn it level by 60 degrees, clockwise as seen from above",
        }
    }

    /// Returns the verdict on an attitude, once there is one: the observation if it is wrong.
    /// `start` is the attitude at the instruction.
    fn judge(self, start: Angles, now: Angles) -> Option<Result<(), String>> {
        let tilt = now.roll.abs().max(now.pitch.abs());
        let yaw = (now.yaw - start.yaw + 540.0).rem_euclid(360.0) - 180.0;
        let expect = |name: &str, expected: f32, other_name: &str, other: f32| {
            if expected > TURN_DEG && other.abs() < TURN_DEG {
                Some(Ok(()))
            } else if expected < -TURN_DEG {
                Some(Err(format!(
                    "{name} goes the wrong way: {expected:.0} degrees"
                )))
            } else if other.abs() > TURN_DEG {
                Some(Err(format!(
                    "{other_name} moves instead of {name}: {other:.0} degrees"
                )))
            } else {
                None
            }
        };
        match self {
            Self::Level => (tilt < LEVEL_DEG).then_some(Ok(())),
            Self::RightDown => expect("roll", now.roll, "pitch", now.pitch),
            Self::NoseUp => expect("pitch", now.pitch, "roll", now.roll),
            Self::Clockwise => expect("yaw", yaw, "tilt", tilt),
        }
    }
}

/// Checks signs and mount by turns.
pub fn turns(talk: &mut Talk, patience: Duration) -> Result<Finding, String> {
    const ADVICE: &str =
        "the mount is wrong: `mount find`, then `save`; or name it with `mount`, see `status`";
    for turn in Turn::ALL {
        print_line(&format!("   you: {}", turn.instruction()));
        let (mut start, mut last) = (None, None);
        let until = Instant::now() + patience;
        let judged = loop {
            let Some(item) = talk.next(until)? else {
                break None;
            };
            let Item::Attitude(attitude) = item else {
                continue;
            };
            let now = Angles {
                roll: attitude.roll_deg,
                pitch: attitude.pitch_deg,
                yaw: attitude.yaw_deg.unwrap_or_default(),
            };
            last = Some(now);
            if let Some(judged) = turn.judge(*start.get_or_insert(now), now) {
                break Some(judged);
            }
        };
        match (judged, last) {
            (Some(Ok(())), _) => print_line("   seen"),
            (Some(Err(saw)), _) => return Ok(Finding::bad(saw, ADVICE)),
            (None, Some(Angles { roll, pitch, .. })) if turn == Turn::Level => {
                let saw = format!("level, it shows roll {roll:.0} and pitch {pitch:.0} degrees");
                return Ok(Finding::bad(saw, ADVICE));
            }
            (None, _) => {
                let instruction = turn.instruction();
                return Ok(Finding::skipped(format!("not done: {instruction}")));
            }
        }
    }
    let mount = talk.ask("status")?;
    let mount = field(&mount, "mount").unwrap_or("unknown").to_owned();
    Ok(Finding::new(
        true,
        format!(
            "right side down: roll positive; nose up: pitch positive; \
         clockwise: yaw positive; mount {mount}"
        ),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_offset_or_a_scale_beyond_the_datasheet_is_bad() {
        let answer = |offset: &str, diagonal: &str| {
            format!(
                "show mount=+x-z accel_offset={offset} accel_matrix={diagonal},0,0,0 level=none"
            )
        };
        for (offset, diagonal, is_good) in [
            ("0.485,-0.485,0.780", "1.0300,0.9715,1", true),
            ("0.495,0,0", "1,1,1", false),
            ("0,-0.495,0", "1,1,1", false),
            ("0,0,0.790", "1,1,1", false),
            ("0,0,0", "1,0.9695,1", false),
            ("0,0,0", "1,1,1.0320", false),
        ] {
            let judged = within_datasheet(&answer(offset, diagonal));
            assert_eq!(judged.expect("an offset").0, is_good, "{offset} {diagonal}");
        }
        assert_eq!(within_datasheet("show accel_offset=none level=none"), None);
    }

    #[test]
    fn a_turn_is_judged_by_axis_and_sign() {
        let at = |roll, pitch, yaw| Angles { roll, pitch, yaw };
        let start = at(0.0, 0.0, 170.0);
        for (turn, now, is_right) in [
            (Turn::Level, at(5.0, -5.0, 0.0), Some(true)),
            (Turn::Level, at(0.0, 90.0, 0.0), None),
            (Turn::RightDown, at(20.0, 3.0, 170.0), None),
            (Turn::RightDown, at(40.0, 3.0, 170.0), Some(true)),
            (Turn::RightDown, at(-40.0, 3.0, 170.0), Some(false)),
            (Turn::RightDown, at(3.0, 40.0, 170.0), Some(false)),
            (Turn::NoseUp, at(3.0, 40.0, 170.0), Some(true)),
            (Turn::NoseUp, at(3.0, -40.0, 170.0), Some(false)),
            (Turn::NoseUp, at(40.0, 3.0, 170.0), Some(false)),
            // Over the seam of 180 degrees.
            (Turn::Clockwise, at(0.0, 0.0, -150.0), Some(true)),
            (Turn::Clockwise, at(0.0, 0.0, 120.0), Some(false)),
            (Turn::Clockwise, at(40.0, 0.0, 170.0), Some(false)),
        ] {
            let judged = turn.judge(start, now).map(|judged| judged.is_ok());
            assert_eq!(judged, is_right, "{turn:?} {now:?}");
        }
    }
}
