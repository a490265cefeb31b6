//! Error of the filters when the gyroscope clips, in copies of the recordings.
//!
//! Each axis of a copy stops at a share of the largest rate of the recording. The default filter
//! runs once on the samples as they are, and once with the clipped samples marked as saturated.

use std::fmt::Write as _;

use aplomb_recordings::score::{mean, median};

use crate::filter::Choice;
use crate::parallel;
use crate::recording::{Recording, Reference};

/// Full scales, as shares of a recording's largest rate.
const SHARES: [f64; 4] = [1.0, 0.6, 0.5, 0.4];

/// Scores of one copy: the root mean square in degrees, and the share of rows within 3 σ.
struct Outcome {
    unmarked: [f64; 2],
    marked: [f64; 2],
    vqf: [f64; 2],
    is_found: bool,
}

/// Returns a row for each set and share: median/mean over its recordings, and the mean share of
/// rows within 3 σ.
pub fn table(recordings: &[Recording]) -> Result<String, String> {
    let with_truth = |recording: &&Recording| recording.reference == Reference::Truth;
    let recordings: Vec<&Recording> = recordings.iter().filter(with_truth).collect();
    if recordings.is_empty() {
        return Err("there are no recordings with truth: name their folder".into());
    }
    let mut text = "| set | full scale / largest rate | clipping found | unmarked | within 3 σ | \
                    marked | within 3 σ | VQF |\n|---|---|---|---|---|---|---|---|\n"
        .to_owned();
    let mut sets: Vec<&str> = recordings.iter().map(|one| one.set.as_str()).collect();
    sets.dedup();
    for set in sets {
        let of_set: Vec<&Recording> = recordings
            .iter()
            .copied()
            .filter(|one| one.set == set)
            .collect();
        for share in SHARES {
            let outcomes = parallel::map_with_bar("clipping", &of_set, |one| run(one, share));
            let all = |value: fn(&Outcome) -> f64| -> Vec<f64> {
                let mut values: Vec<f64> = outcomes.iter().map(value).collect();
                values.sort_by(f64::total_cmp);
                values
            };
            let rms = |value: fn(&Outcome) -> f64| {
                let values = all(value);
                format!("{:.2}/{:.2}", median(&values), mean(&values))
            };
            let within = |value: fn(&Outcome) -> f64| format!("{:.0} %", 100.0 * mean(&all(value)));
            let found = outcomes.iter().filter(|outcome| outcome.is_found).count();
            let _ = writeln!(
                text,
                "| {set} | {:.0} % | {found} of {} | {} | {} | {} | {} | {} |",
                100.0 * share,
                outcomes.len(),
                rms(|outcome| outcome.unmarked[0]),
                within(|outcome| outcome.unmarked[1]),
                rms(|outcome| outcome.marked[0]),
                within(|outcome| outcome.marked[1]),
                rms(|outcome| outcome.vqf[0]),
            );
        }
    }
    Ok(text)
}

fn run(recording: &Recording, share: f64) -> Outcome {
    let mut copy = clipped(recording, share);
    let scores = |copy: &Recording, filter| {
        let score = copy.score(filter);
        let within = score.and_then(|score| Some(score.consistency?.within_3_sigma));
        [score.map(|score| score.rms), within].map(|value| value.unwrap_or(f64::NAN))
    };
    let (unmarked, vqf) = (scores(&copy, Choice::Kalman), scores(&copy, Choice::Vqf));
    copy.mark_clipping();
    Outcome {
        unmarked,
        marked: scores(&copy, Choice::Kalman),
        vqf,
        is_found: copy.clipping.is_some(),
    }
}

/// Returns a copy with a gyroscope that clips at this share of the largest rate.
fn clipped(recording: &Recording, share: f64) -> Recording {
    let mut copy = recording.clone();
    let rates = copy.samples.iter().map(|sample| sample.angular_rate_rad_s);
    let largest = rates.fold(0.0_f32, |largest, rate| {
        let axes = rate.x.abs().max(rate.y.abs()).max(rate.z.abs());
        largest.max(axes)
    });
    let limit = largest * share as f32;
    for sample in &mut copy.samples {
        let rate = &mut sample.angular_rate_rad_s;
        for axis in [&mut rate.x, &mut rate.y, &mut rate.z] {
            *axis = axis.clamp(-limit, limit);
        }
    }
    copy
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::folders::recordings_of;
    use crate::simulated::flight_for;
    use aplomb::attitude::Vector3;
    use aplomb::estimator::Sample;

    /// Smallest full scale that the detector takes for one, rad/s.
    const LEAST_RATE_RAD_S: f32 = 100.0 * std::f32::consts::PI / 180.0;

    /// Most clipped samples of a copy that stay unmarked, at all six ends together.
    const MOST_UNMARKED: usize = 60;

    #[test]
    fn a_clipped_copy_stops_at_its_share_and_is_found() {
        let mut recording = flight_for(1_000, 20);
        // A flight turns slowly: without noise from register counts, as if four times as fast.
        for sample in &mut recording.samples {
            sample.angular_rate_rad_s = sample.angular_rate_rad_s.scale(4.0);
        }
        recording.mark_clipping();
        assert_eq!(recording.clipping, None);
        let mut copy = clipped(&recording, 0.5);
        copy.mark_clipping();
        let message = copy.clipping.clone().unwrap();
        assert!(message.starts_with("clipped: gyroscope g"), "{message}");
        assert!(copy.samples.iter().any(|sample| sample.is_rate_saturated));
        assert!(copy.samples.iter().all(|sample| !sample.is_force_saturated));
        assert!(copy.warnings()[0].starts_with("simulated/flight 1000: clipped: "));
    }

    /// A tilt that full scale hides is kept: gravity alone knows less of a body that turns so fast.
    #[test]
    fn a_clipped_gyroscope_costs_less_than_it_costs_vqf() {
        let Some(recordings) = recordings_of(&["broad"]) else {
            return;
        };
        for share in [0.6, 0.5] {
            let outcomes = parallel::map(&recordings, |one| run(one, share));
            let of = |rms: fn(&Outcome) -> f64| -> Vec<f64> { outcomes.iter().map(rms).collect() };
            let ours = mean(&of(|outcome| outcome.marked[0]));
            let vqf = mean(&of(|outcome| outcome.vqf[0]));
            assert!(ours < 0.8 * vqf, "{share}: {ours} and {vqf}");
        }
    }

    #[test]
    fn recordings_at_hand_are_not_clipped_but_their_clipped_copies_are() {
        let Some(recordings) = recordings_of(&["broad", "tumvi", "xio"]) else {
            return;
        };
        assert!(recordings.len() >= 18, "{}", recordings.len());
        let mut found = 0;
        for recording in &recordings {
            assert_eq!(recording.warnings(), [""; 0]);
            for share in SHARES.into_iter().skip(1) {
                let mut copy = clipped(recording, share);
                copy.mark_clipping();
                let components = |rate: Vector3| [rate.x, rate.y, rate.z].map(f32::abs);
                let rates = copy.samples.iter().map(|sample| sample.angular_rate_rad_s);
                let limit = rates.flat_map(components).fold(0.0, f32::max);
                if limit < LEAST_RATE_RAD_S {
                    continue;
                }
                let is_at_limit =
                    |sample: &&Sample| components(sample.angular_rate_rad_s).contains(&limit);
                let at_limit = copy.samples.iter().filter(is_at_limit).count();
                let marked = copy
                    .samples
                    .iter()
                    .filter(|sample| sample.is_rate_saturated);
                let marked = marked.count();
                let name = format!("{}/{} {share}", copy.set, copy.name);
                // The evidence of each end takes a few samples.
                let range = marked..=marked + MOST_UNMARKED;
                assert!(range.contains(&at_limit), "{name}: {marked} of {at_limit}");
                found += usize::from(copy.clipping.is_some());
            }
        }
        assert!(found >= 45, "{found}");
    }
}
