//! Reports of scores: tables, CSV and JSON.

use std::fmt::Write as _;

use aplomb_recordings::score::{Score, SigmaConsistency, mean, median};

use crate::folders::NotScored;
use crate::heading;
use crate::recording::{Recording, Reference};
use crate::results::{Row, Set};

/// Returns the table of the sets with one reference.
pub fn table(names: &[&str], reference: Reference, sets: &[&Set]) -> String {
    let mut text = String::from(match reference {
        Reference::Truth => {
            "\nInclination error, root mean square in degrees: median/mean over recordings\n\n"
        }
        Reference::Rest => {
            "\nWithout truth, so a check and no measure: \
             the same against the mean specific force, where the recording rests\n\n"
        }
    });
    let _ = write!(text, "{:<12}", "");
    for set in sets {
        let title = format!("{} ({})", set.name, set.rms[0].len());
        let _ = write!(text, "{title:>17}");
    }
    for (index, name) in names.iter().enumerate() {
        let _ = write!(text, "\n{name:<12}");
        for set in sets {
            let rms = &set.rms[index];
            let _ = write!(
                text,
                "{:>17}",
                format!("{:.2}/{:.2}", median(rms), mean(rms))
            );
        }
    }
    for set in sets.iter().filter(|set| set.delay_us > 0) {
        let _ = write!(
            text,
            "\n{}: samples are {} µs late, which every filter makes up for",
            set.name, set.delay_us
        );
    }
    text.push('\n');
    text
}

/// Returns the first filter's scores, one line a recording, and the consistency of its σ.
pub fn one_by_one(names: &[&str], rows: &[Row<'_>]) -> String {
    let titles: Vec<String> = rows
        .iter()
        .map(|row| format!("{}/{}", row.recording.set, row.recording.name))
        .collect();
    let width = titles.iter().map(String::len).max().unwrap_or(0);
    let mut text = format!(
        "\n{}, recording by recording, in degrees; \
         how much of the time the error is within 3 sigma; \
         median of error/sigma (ideal: 0.83)\n\n\
         {:<width$}{:>8}{:>8}{:>9}{:>10}{:>8}\n",
        names[0], "", "rms", "95 %", "maximum", "<= 3 s", "median"
    );
    for (row, title) in rows.iter().zip(titles) {
        let Some(score) = row.scores.first() else {
            continue;
        };
        let _ = write!(
            text,
            "{title:<width$}{:>8.2}{:>8.2}{:>9.2}",
            score.rms, score.p95, score.maximum
        );
        if let Some(consistency) = score.consistency {
            let percent = 100.0 * consistency.within_3_sigma;
            let _ = write!(text, "{percent:>8.2} %{:>8.2}", consistency.median);
        } else {
            text.push_str("    at rest");
        }
        text.push('\n');
    }
    text
}

/// Returns all scores as CSV.
pub fn csv(names: &[&str], rows: &[Row<'_>]) -> String {
    let mut text = String::from(
        "set,recording,reference,sensor_delay_us,filter,rows,rms_deg,p95_deg,maximum_deg,\
         within_3_sigma,median_error_per_sigma\n",
    );
    for row in rows {
        let Recording {
            set,
            name: recording,
            reference,
            delay_us,
            ..
        } = row.recording;
        let reference = reference.name();
        for (name, score) in names.iter().zip(&row.scores) {
            let Score {
                rows,
                rms,
                p95,
                maximum,
                consistency,
            } = score;
            let _ = write!(
                text,
                "{set},{recording},{reference},{delay_us},{name},{rows},{rms},{p95},{maximum}"
            );
            let _ = match consistency {
                Some(SigmaConsistency {
                    within_3_sigma,
                    median,
                }) => writeln!(text, ",{within_3_sigma},{median}"),
                None => writeln!(text, ",,"),
            };
        }
    }
    text
}

/// Returns all scores as JSON.
pub fn json(
    names: &[&str],
    rows: &[Row<'_>],
    headings: &[heading::Row<'_>],
    warnings: Vec<String>,
    not_scored: &[NotScored],
) -> serde_json::Result<String> {
    #[derive(serde::Serialize)]
    struct Scores<'a> {
        scores: Vec<Scored<'a>>,
        #[serde(skip_serializing_if = "Vec::is_empty")]
        headings: Vec<heading::Scored<'a>>,
        #[serde(skip_serializing_if = "Vec::is_empty")]
        warnings: Vec<String>,
        not_scored: &'a [NotScored],
    }
    #[derive(serde::Serialize)]
    struct Scored<'a> {
        set: &'a str,
        recording: &'a str,
        reference: &'static str,
        sensor_delay_us: u32,
        filter: &'a str,
        #[serde(flatten)]
        score: Score,
    }
    let scores = rows.iter().flat_map(|row| {
        let recording = row.recording;
        names.iter().zip(&row.scores).map(|(filter, score)| Scored {
            set: &recording.set,
            recording: &recording.name,
            reference: recording.reference.name(),
            sensor_delay_us: recording.delay_us,
            filter,
            score: *score,
        })
    });
    serde_json::to_string(&Scores {
        scores: scores.collect(),
        headings: heading::scored(headings),
        warnings,
        not_scored,
    })
}
