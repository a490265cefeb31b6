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
