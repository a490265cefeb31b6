//! Scores of recordings, and their summary by set.

use aplomb_recordings::score::Score;

use crate::recording::{Recording, Reference};

/// Scores of one recording.
pub struct Row<'a> {
    /// The recording.
    pub recording: &'a Recording,
    /// Scores in the order of the filters.
    pub scores: Vec<Score>,
}

/// Scores of one set.
pub struct Set {
    /// Name.
    pub name: String,
    /// Reference of its recordings.
    pub reference: Reference,
    /// Delay of its recordings, µs.
    pub delay_us: u32,
    /// Root mean squares of all recordings in degrees, ascending, for each filter.
    pub rms: Vec<Vec<f64>>,
}

/// Summarises scores by set and reference.
pub fn summarise(rows: &[Row<'_>], filters: usize) -> Vec<Set> {
    let mut sets: Vec<Set> = Vec::new();
    for row in rows {
        let recording = row.recording;
        let is_its = |set: &Set| set.name == recording.set && set.reference == recording.reference;
        let place = sets.iter().position(is_its);
        let place = place.unwrap_or_else(|| {
            sets.push(Set {
                name: recording.set.clone(),
                reference: recording.reference,
                delay_us: recording.delay_us,
                rms: vec![Vec::new(); filters],
            });
            sets.len() - 1
        });
        for (all, score) in sets[place].rms.iter_mut().zip(&row.scores) {
            all.push(score.rms);
        }
    }
    for all in sets.iter_mut().flat_map(|set| &mut set.rms) {
        all.sort_by(f64::total_cmp);
    }
    sets
}

#[cfg(test)]
mod tests {
    use aplomb::estimator::kalman::AccelerometerKnowledge;
    use aplomb_recordings::score::{mean, median};

    use crate::filter::Choice;
    use crate::folders::recordings_of;
    use crate::parallel;
    use crate::promise::exceeds;
    use crate::simulated::{EVALUATION_SEEDS, flights};

    use super::*;

    /// Figures that README.md and docs/results.md are made of.
    const FIGURES: &str = include_str!("../../docs/results.toml");
    /// Largest relative change of a figure, and half of its last digit.
    const TOLERANCE: f64 = 0.02;
    const ROUNDING_DEG: f64 = 0.005;

    /// Returns the number of recordings of a set, and median and mean of the errors, degrees.
    fn figures(set: &str) -> (usize, [f64; 2]) {
        let section = FIGURES.split_once(&format!("[filters.{set}]\n"));
        let section = section.expect("a section").1;
        let value = |key: &str| {
            let mut lines = section.lines().take_while(|line| !line.starts_with('['));
            let value = lines.find_map(|line| line.strip_prefix(key)?.strip_prefix(" = "));
            value.expect(key).trim_matches('"')
        };
        let (median, mean) = value("kalman").split_once('/').expect("two numbers");
        (
            value("recordings").parse().expect("a number"),
            [median, mean].map(|number| number.parse().expect("a number")),
        )
    }

    /// Returns the differences from the figures that are too large.
    fn changes(set: &str, errors_deg: &[f64]) -> Vec<String> {
        let (recordings, figures_deg) = figures(set);
        assert_eq!(errors_deg.len(), recordings, "{set}: recordings");
        let found_deg = [median(errors_deg), mean(errors_deg)];
        println!("{set}: {found_deg:.3?}, and docs/results.toml has {figures_deg:?}");
        let pairs = ["median", "mean"]
            .into_iter()
            .zip(found_deg.into_iter().zip(figures_deg));
        let changed = pairs.filter(|(_, (found, figure))| {
            exceeds((found - figure).abs(), TOLERANCE * figure + ROUNDING_DEG)
        });
        changed.map(|change| format!("{set}: {change:?}")).collect()
    }

    /// Returns the errors of the default filter, degrees, ascending.
    fn errors_deg(recordings: &[Recording]) -> Vec<f64> {
        let scores = parallel::map(recordings, |one| one.score(Choice::Kalman));
        let scores = scores
            .into_iter()
            .map(|score| score.expect("rows that count").rms);
        let mut errors: Vec<f64> = scores.collect();
        errors.sort_by(f64::total_cmp);
        errors
    }

    /// A change of the filter that costs accuracy fails here: `cargo xtask results` measures the
    /// figures anew.
    #[test]
    fn the_default_filter_is_as_accurate_as_the_pages_say() {
        for set in ["broad", "tumvi"] {
            if let Some(recordings) = recordings_of(&[set]) {
                assert_eq!(changes(set, &errors_deg(&recordings)), [""; 0]);
            }
        }
        for (set, knowledge) in [
            ("simulated", AccelerometerKnowledge::Factory),
            ("calibrated", AccelerometerKnowledge::Calibrated),
        ] {
            let errors = errors_deg(&flights(EVALUATION_SEEDS, knowledge));
            assert_eq!(changes(set, &errors), [""; 0]);
        }
    }

    #[test]
    fn a_figure_may_change_by_two_percent_only() {
        let (recordings, [median, _]) = figures("broad");
        let with = |share: f64| changes("broad", &vec![share * median; recordings]);
        let medians = |share| {
            with(share)
                .iter()
                .filter(|text| text.contains("median"))
                .count()
        };
        assert_eq!([0.9, 0.99, 1.0, 1.02, 1.05].map(medians), [1, 0, 0, 0, 1]);
        assert_eq!(medians(f64::NAN), 1);
    }
}
