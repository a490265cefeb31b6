//! Errors after a hard beginning: tilt and heading after starts in the middle of a recording's
//! motion, and the heading with hard iron that nobody calibrated.
//!
//! All cut or change copies of the recordings. A start in motion knows neither the gyroscope's
//! bias nor the tilt. The hard iron is constant in body axes.

use std::fmt::Write as _;

use aplomb::attitude::Quaternion;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb_models::motion::geometry::angle_between;
use aplomb_recordings::attitude::up_in_body;
use aplomb_recordings::heading::error_deg;
use aplomb_recordings::score::{mean, median};

use crate::compass::Compass;
use crate::filter::{self, Filter};
use crate::heading;
use crate::marg;
use crate::parallel;
use crate::recording::{Recording, Reference};

/// Time from one start in motion to the next, s.
const START_PERIOD_S: u64 = 4;
/// Times after a start at which its error counts, s.
const AFTER_S: [u64; 4] = [2, 5, 10, 20];
/// Share of the starts that have at most the reported error.
const SHARE: f64 = 0.9;
/// Error of a heading that is unknown, degrees.
const UNKNOWN_DEG: f64 = 180.0;
/// Added hard iron in body axes, µT: 200 µT together.
const HARD_IRON_UT: [f32; 3] = [120.0, -100.0, 124.9];
/// Time in motion after which the error with hard iron counts, s.
const FOUND_AFTER_S: u64 = 20;

const MICROSECONDS: u64 = 1_000_000;

/// Filter to run on a recording.
#[derive(Clone, Copy, Debug)]
enum Runs {
    Ours,
    Vqf,
}

impl Runs {
    const ALL: [(Self, &'static str); 2] = [(Self::Ours, "aplomb"), (Self::Vqf, "VQF")];

    /// Calls `note` with the time of each row that has a truth, µs, and the error there, degrees:
    /// of the heading if the recording has a compass, else of the tilt.
    fn errors(self, recording: &Recording, note: impl FnMut(u64, f64)) {
        if recording.compass.is_some() {
            self.heading_errors(recording, note);
        } else {
            self.tilt_errors(recording, note);
        }
    }

    fn tilt_errors(self, recording: &Recording, mut note: impl FnMut(u64, f64)) {
        let choice = match self {
            Self::Ours => filter::Choice::Kalman,
            Self::Vqf => filter::Choice::Vqf,
        };
        let mut filter = Filter::new(choice, recording.step_s(), recording.delay_us)
            .with_knowledge(recording.accelerometer);
        for (sample, true_up) in recording.samples.iter().zip(&recording.true_up) {
            let up = up_in_body(filter.update(sample).attitude);
            if let Some(true_up) = *true_up {
                let up = [up.x, up.y, up.z].map(f64::from);
                note(sample.t_us, angle_between(up, true_up).to_degrees());
            }
        }
    }

    fn heading_errors(self, recording: &Recording, mut note: impl FnMut(u64, f64)) {
        let Some(compass) = &recording.compass else {
            return;
        };
        let mut add = |index: usize, attitude: Option<Quaternion>| {
            let truth = compass.truth.get(index).copied().flatten();
            if let (Some(sample), Some(truth)) = (recording.samples.get(index), truth) {
                let error = attitude.map_or(UNKNOWN_DEG, |attitude| {
                    error_deg(attitude, truth, compass.mount).abs()
                });
                note(sample.t_us, error);
            }
        };
        match self {
            Self::Ours => heading::run(recording, |index, heading| {
                add(index, heading.map(|(attitude, _)| attitude));
            }),
            Self::Vqf => heading::run_peer(marg::Choice::Vqf, recording, |index, attitude| {
                add(index, Some(attitude));
            }),
        }
    }
}

/// Returns the tables.
pub fn tables(recordings: &[Recording]) -> Result<String, String> {
    let with_truth = |recording: &&Recording| {
        recording.compass.is_some() || recording.reference == Reference::Truth
    };
    let recordings: Vec<&Recording> = recordings.iter().filter(with_truth).collect();
    let mut sets: Vec<&str> = recordings.iter().map(|one| one.set.as_str()).collect();
    sets.dedup();
    let mut text = String::new();
    for set in sets {
        let of_set = recordings.iter().filter(|one| one.set == set).copied();
        let of_set: Vec<&Recording> = of_set.collect();
        add_starts(&mut text, set, &of_set);
        if of_set.iter().all(|one| one.compass.is_some()) {
            add_hard_iron(&mut text, set, &of_set);
        }
    }
    if text.is_empty() {
        return Err("there are no recordings with truth: name their folder".into());
    }
    Ok(text)
}

/// Adds the table of the starts in motion.
fn add_starts(text: &mut String, set: &str, recordings: &[&Recording]) {
    let starts = recordings.iter().flat_map(|one| starts_in_motion(one));
    let starts: Vec<Recording> = starts.collect();
    let has_compass = starts.iter().all(|start| start.compass.is_some());
    let _ = write!(
        text,
        "\n{set}, {} starts in motion: {} error in degrees that {:.0} % have at most, and the \
         largest one\n\n\
         | filter | after 2 s | after 5 s | after 10 s | after 20 s |\n|---|---|---|---|---|\n",
        starts.len(),
        if has_compass { "heading" } else { "tilt" },
        100.0 * SHARE,
    );
    for (runs, name) in Runs::ALL {
        let run = |start: &Recording| errors_after(runs, start);
        let errors = parallel::map_with_bar("starting", &starts, run);
        let cells = [0, 1, 2, 3].map(|place| {
            let mut errors: Vec<f64> = errors.iter().map(|errors| errors[place]).collect();
            errors.sort_by(f64::total_cmp);
            let largest = errors.last().copied().unwrap_or(UNKNOWN_DEG);
            format!("{:.1}, {largest:.1}", largest_of_share(&errors))
        });
        let _ = writeln!(text, "| {name} | {} |", cells.join(" | "));
    }
}

/// Adds the table of the headings with hard iron.
fn add_hard_iron(text: &mut String, set: &str, recordings: &[&Recording]) {
    let _ = write!(
        text,
        "\n{set}, 200 µT of hard iron that nobody calibrated: heading error, root mean square in \
         degrees over the moving rows from {FOUND_AFTER_S} s after the first one on, median/mean \
         over {} recordings\n\n| filter | error |\n|---|---|\n",
        recordings.len()
    );
    let with_iron: Vec<Recording> = recordings.iter().map(|one| with_hard_iron(one)).collect();
    for (runs, name) in Runs::ALL {
        let errors = parallel::map(&with_iron, |recording| error_once_found(runs, recording));
        let mut errors: Vec<f64> = errors.into_iter().flatten().collect();
        errors.sort_by(f64::total_cmp);
        let (median, mean) = (median(&errors), mean(&errors));
        let _ = writeln!(text, "| {name} | {median:.2}/{mean:.2} |");
    }
}

/// Cuts a recording at regular times, where it moves and goes on for long enough.
fn starts_in_motion(recording: &Recording) -> Vec<Recording> {
    let (Some(first), Some(last)) = (recording.samples.first(), recording.samples.last()) else {
        return Vec::new();
    };
    let longest_us = (AFTER_S[3] + 1) * MICROSECONDS;
    let times = (first.t_us..last.t_us.saturating_sub(longest_us))
        .step_by((START_PERIOD_S * MICROSECONDS) as usize);
    let place = |t_us| {
        recording
            .samples
            .partition_point(|sample| sample.t_us < t_us)
    };
    let starts = times.filter_map(|t_us| {
        let rows = place(t_us)..place(t_us + longest_us);
        let moves = recording.true_up.get(rows.start)?.is_some();
        moves.then(|| Recording {
            samples: recording.samples[rows.clone()].to_vec(),
            known_up: recording.known_up[rows.clone()].to_vec(),
            true_up: recording.true_up[rows.clone()].to_vec(),
            compass: recording.compass.as_ref().map(|compass| Compass {
                fields: compass.fields[rows.clone()].to_vec(),
                truth: compass.truth[rows].to_vec(),
                ..*compass
            }),
            set: recording.set.clone(),
            name: recording.name.clone(),
            clipping: None,
            ..*recording
        })
    });
    starts.collect()
}

/// Returns the error of the last row that counts before each of the times after a start.
fn errors_after(runs: Runs, start: &Recording) -> [f64; 4] {
    let mut errors = [UNKNOWN_DEG; 4];
    let first_us = start.samples.first().map_or(0, |first| first.t_us);
    runs.errors(start, |t_us, error| {
        for (place, after_s) in errors.iter_mut().zip(AFTER_S) {
            if t_us < first_us + after_s * MICROSECONDS {
                *place = error;
            }
        }
    });
    errors
}

/// Returns the error that the share has at most.
fn largest_of_share(errors: &[f64]) -> f64 {
    let place = ((SHARE * errors.len() as f64).ceil() as usize).saturating_sub(1);
    errors.get(place).copied().unwrap_or(UNKNOWN_DEG)
}

/// Returns a copy with hard iron that the filter does not know.
fn with_hard_iron(recording: &Recording) -> Recording {
    let mut copy = recording.clone();
    if let Some(compass) = &mut copy.compass {
        compass.knowledge = CompassKnowledge::Factory;
        for field in compass.fields.iter_mut().flatten() {
            for (axis, iron) in field.ut.iter_mut().zip(HARD_IRON_UT) {
                *axis += iron;
            }
        }
    }
    copy
}

/// Returns the root mean square of the error after some time in motion; `None` if the motion ends
/// before.
fn error_once_found(runs: Runs, recording: &Recording) -> Option<f64> {
    let (mut moves_from_us, mut squares, mut rows) = (None, 0.0, 0_u32);
    runs.errors(recording, |t_us, error| {
        let found_us = *moves_from_us.get_or_insert(t_us) + FOUND_AFTER_S * MICROSECONDS;
        if t_us >= found_us {
            squares += error * error;
            rows += 1;
        }
    });
    (rows > 0).then(|| (squares / f64::from(rows)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb_models::compass::Magnetism;
    use aplomb_recordings::simulated::errors;

    use crate::folders::recordings_of;
    use crate::simulated::{FIRST_EVALUATION_SEED as SEED, flight_with_compass};
    use aplomb::estimator::kalman::AccelerometerKnowledge;

    fn flight() -> Recording {
        flight_with_compass(
            SEED,
            errors(SEED, AccelerometerKnowledge::Calibrated),
            Magnetism::calibrated(SEED),
            CompassKnowledge::Calibrated,
        )
    }

    /// The flight rests for three seconds, moves for 57, and an end of 21 s is no start.
    #[test]
    fn a_recording_is_cut_where_it_moves() {
        let starts = starts_in_motion(&flight());
        let begins: Vec<u64> = starts.iter().map(|start| start.samples[0].t_us).collect();
        assert_eq!(starts.len(), 9, "{begins:?}");
        assert!(begins[0] >= 4 * MICROSECONDS, "{begins:?}");
        for start in &starts {
            let length_us = start.samples.last().unwrap().t_us - start.samples[0].t_us;
            assert!(
                length_us.abs_diff(21 * MICROSECONDS) < 10_000,
                "{length_us}"
            );
            let compass = start.compass.as_ref().unwrap();
            assert_eq!(compass.fields.len(), start.samples.len());
            assert_eq!(compass.truth.len(), start.samples.len());
        }
    }

    #[test]
    fn a_heading_counts_where_it_is_known() {
        let mut flight = flight();
        let [.., late] = errors_after(Runs::Ours, &flight);
        assert!(late < 5.0, "{late}");
        let compass = flight.compass.as_mut().unwrap();
        compass.fields.fill(None);
        assert_eq!(errors_after(Runs::Ours, &flight), [UNKNOWN_DEG; 4]);
    }

    /// A tilt that was wrong in fast motion stayed wrong for 20 s.
    #[test]
    fn a_start_in_a_recording_finds_its_tilt() {
        let Some(recordings) = recordings_of(&["broad"]) else {
            return;
        };
        let starts: Vec<Recording> = recordings.iter().flat_map(starts_in_motion).collect();
        let errors = parallel::map(&starts, |start| errors_after(Runs::Ours, start));
        let largest = |place: usize| {
            let mut errors: Vec<f64> = errors.iter().map(|errors| errors[place]).collect();
            errors.sort_by(f64::total_cmp);
            (largest_of_share(&errors), errors.last().copied().unwrap())
        };
        let (early, late) = (largest(1), largest(3));
        assert!(early.0 < 10.0 && early.1 < 120.0, "{early:?}");
        assert!(late.0 < 3.0 && late.1 < 40.0, "{late:?}");
    }

    /// VQF takes the iron for the field, so its error shows that the iron is there.
    #[test]
    fn unknown_hard_iron_is_found_by_the_library_alone() {
        let with_iron = with_hard_iron(&flight());
        let [ours, vqf] = [Runs::Ours, Runs::Vqf].map(|runs| error_once_found(runs, &with_iron));
        assert!(ours.unwrap() < 15.0, "{ours:?}");
        assert!(vqf.unwrap() > 45.0, "{vqf:?}");
    }

    #[test]
    fn a_share_of_the_errors_is_at_most_the_reported_one() {
        let errors: Vec<f64> = (0..100).map(f64::from).collect();
        assert_eq!(largest_of_share(&errors), 89.0);
        assert_eq!(largest_of_share(&[]), UNKNOWN_DEG);
    }
}
