//! Comparison of headings on recordings with a compass.

use std::fmt::Write as _;

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::mpu6050::Part;
use aplomb::pipeline::{CompassPipeline, Settings};
use aplomb::units::degrees;
use aplomb_models::motion::geometry::Quaternion as Truth;
use aplomb_recordings::heading::{HeadingErrors, HeadingScore, error_deg};
use aplomb_recordings::score::{mean, median};

use crate::compass::Compass;
use crate::marg::{self, Choice, Times};
use crate::parallel;
use crate::recording::Recording;

/// Name of the library's filter.
const OURS: &str = "kalman";

/// Scores of all filters on one recording, the library's first.
pub struct Row<'a> {
    recording: &'a Recording,
    scores: Vec<(&'static str, HeadingScore)>,
}

/// Scores every filter on every recording with a compass.
pub fn score(recordings: &[Recording]) -> Vec<Row<'_>> {
    let scores = parallel::map(recordings, |recording| {
        let compass = recording.compass.as_ref()?;
        let mut scores = vec![(OURS, ours(recording, compass)?)];
        for choice in Choice::ALL {
            scores.push((choice.name(), peer(choice, recording, compass)?));
        }
        Some(scores)
    });
    let rows = recordings.iter().zip(scores);
    rows.filter_map(|(recording, scores)| {
        let scores = scores?;
        Some(Row { recording, scores })
    })
    .collect()
}

fn ours(recording: &Recording, compass: &Compass) -> Option<HeadingScore> {
    let mut errors = HeadingErrors::default();
    run(recording, |index, heading| {
        if let Some(truth) = truth_at(recording, index) {
            errors.add(heading.map(|(absolute, sigma_deg)| {
                (error_deg(absolute, truth, compass.mount), Some(sigma_deg))
            }));
        }
    });
    errors.score()
}

/// Runs the library's filter on a recording with a compass, and calls `note` with the index of
/// each sample, and if the heading is known with the absolute attitude (body to north, east, down)
/// and σ of the heading in degrees.
pub fn run(recording: &Recording, mut note: impl FnMut(usize, Option<(Quaternion, f64)>)) {
    let Some(compass) = &recording.compass else {
        return;
    };
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.sensor_delay_us = Some(recording.delay_us);
    settings.sensor.sample_rate_divider = (recording.step_s() * 1_000.0).ceil() as u8 - 1;
    let mut pipeline = CompassPipeline::new(&settings, compass.knowledge);
    let knowledge = recording.accelerometer;
    pipeline
        .pipeline_mut()
        .set_accelerometer_knowledge(knowledge);
    for (index, sample) in recording.samples.iter().enumerate() {
        let snapshot = pipeline.update_sample(sample);
        if let Some(Some(field)) = compass.fields.get(index) {
            pipeline.update_field(*field, compass.delay_us);
        }
        let heading = pipeline.heading().map(|heading| {
            let turn = Vector3::new(0.0, 0.0, heading.yaw_offset_rad);
            let turn = Quaternion::from_rotation_vector(turn);
            let sigma_deg = f64::from(degrees(heading.sigma_rad));
            (turn.multiply(snapshot.attitude), sigma_deg)
        });
        note(index, heading);
    }
}

fn peer(choice: Choice, recording: &Recording, compass: &Compass) -> Option<HeadingScore> {
    let mut errors = HeadingErrors::default();
    run_peer(choice, recording, |index, attitude| {
        if let Some(truth) = truth_at(recording, index) {
            errors.add(Some((error_deg(attitude, truth, compass.mount), None)));
        }
    });
    errors.score()
}

/// Runs another filter on a recording with a compass, and calls `note` like [`marg::run`].
pub fn run_peer(choice: Choice, recording: &Recording, note: impl FnMut(usize, Quaternion)) {
    let Some(compass) = &recording.compass else {
        return;
    };
    let times = Times {
        step_s: recording.step_s(),
        field_step_s: field_step_s(recording, compass),
        delay_s: recording.delay_us as f32 * 1e-6,
        age_s: compass.delay_us as f32 * 1e-6,
    };
    let fields = compass.fields.iter().copied();
    let rows = recording.samples.iter().copied().zip(fields);
    marg::run(choice, times, rows, note);
}

/// Returns the mean time from one reading of the compass to the next, s; that of the samples if
/// there are fewer than two.
fn field_step_s(recording: &Recording, compass: &Compass) -> f32 {
    let rows = recording.samples.iter().zip(&compass.fields);
    let times_us = rows.filter_map(|(sample, field)| field.map(|_| sample.t_us));
    let times_us: Vec<u64> = times_us.collect();
    match times_us[..] {
        [first, .., last] if last > first => {
            (last - first) as f32 * 1e-6 / (times_us.len() - 1) as f32
        }
        _ => recording.step_s(),
    }
}

/// Returns the truth of a row that counts.
pub fn truth_at(recording: &Recording, index: usize) -> Option<Truth> {
    let sample = recording.samples.get(index)?;
    let truth = *recording.compass.as_ref()?.truth.get(index)?;
    truth.filter(|_| sample.t_us >= recording.start_us())
}

/// Returns the table of the sets, and that of the recordings; nothing without recordings.
pub fn table(rows: &[Row<'_>]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let mut text = String::from(
        "\nHeading error, root mean square in degrees: median/mean over recordings, \
         as it is and without its mean\n",
    );
    let mut sets: Vec<&str> = rows.iter().map(|row| row.recording.set.as_str()).collect();
    sets.dedup();
    for set in sets {
        let rows = rows.iter().filter(|row| row.recording.set == set);
        let rows: Vec<&Row<'_>> = rows.collect();
        let _ = writeln!(text, "\n{set} ({})", rows.len());
        let filters = rows.first().map_or(0, |row| row.scores.len());
        for filter in 0..filters {
            let all = |figure: fn(&HeadingScore) -> f64| {
                let figures = rows.iter().map(|row| figure(&row.scores[filter].1));
                let mut figures: Vec<f64> = figures.collect();
                figures.sort_by(f64::total_cmp);
                format!("{:.2}/{:.2}", median(&figures), mean(&figures))
            };
            let (raw, free) = (
                all(|score| score.rms),
                all(|score| score.rms_without_offset),
            );
            let _ = writeln!(text, "{:<12}{raw:>17}{free:>17}", rows[0].scores[filter].0);
        }
    }
    let _ = writeln!(text, "\n{OURS}, recording by recording");
    for row in rows {
        let (set, name) = (&row.recording.set, &row.recording.name);
        let _ = writeln!(text, "{set}/{name}: {}", row.scores[0].1);
    }
    text
}

/// Score of one filter on one recording, for JSON.
#[derive(serde::Serialize)]
pub struct Scored<'a> {
    set: &'a str,
    recording: &'a str,
    filter: &'static str,
    #[serde(flatten)]
    score: HeadingScore,
}

/// Returns all scores for JSON.
pub fn scored<'a>(rows: &'a [Row<'a>]) -> Vec<Scored<'a>> {
    let scored = rows.iter().flat_map(|row| {
        row.scores.iter().map(|(filter, score)| Scored {
            set: &row.recording.set,
            recording: &row.recording.name,
            filter,
            score: *score,
        })
    });
    scored.collect()
}
