//! `attitude.png`: roll, pitch and yaw against the truth, and the inclination error, over time. In
//! a flight with faults these are shaded and named, and a row for each flag shows when it was set.

use aplomb::health::Flags;

use crate::flight::Outcome;
use crate::recorder::Sample;
use crate::summary::inclination_deg;
use aplomb_plot::chart::{
    Chart, FAULT_SHADE, FIRST, Lane, NARROWEST_DEG, Panel, SECOND, SHADE, Shade, THIRD, TRUTH,
    error_panel, flag_lanes,
};
use aplomb_plot::picture::Color;
use aplomb_plot::timeline::Trace;

/// The picture, in pixels.
const SIZE: (u32, u32) = (1600, 1280);

/// The texts of the picture.
#[derive(Clone, Debug)]
pub struct Labels {
    /// The first line, for instance the board and the motion.
    pub title: String,
    /// The second line, for instance the figures.
    pub subtitle: String,
}

/// The picture as a PNG file.
#[must_use]
pub fn png(outcome: &Outcome, labels: &Labels) -> Vec<u8> {
    let samples = outcome.samples();
    let still_until_s = samples
        .iter()
        .filter(|sample| sample.snapshot.flags.contains(Flags::CALIBRATING))
        .map(time_s)
        .reduce(f64::max);
    let at_rest = still_until_s.map(|until_s| Shade {
        span_s: (0.0, until_s),
        color: SHADE,
        name: "at rest".into(),
    });
    let (faults, lanes) = faults_and_flags(outcome);
    let chart = Chart {
        width: SIZE.0,
        height: SIZE.1,
        title: labels.title.clone(),
        subtitle: labels.subtitle.clone(),
        legend: Vec::new(),
        time_s: (0.0, samples.last().map_or(1.0, time_s)),
        time_name: "time since power-up (s)",
        panels: panels(samples),
        shades: at_rest.into_iter().chain(faults).collect(),
        lanes,
        others: Vec::new(),
    };
    chart.draw().png()
}

fn time_s(sample: &Sample) -> f64 {
    sample.published_ns as f64 * 1e-9
}

/// Returns the faults, and a lane for each flag that is ever set. Empty without a schedule of
/// faults.
fn faults_and_flags(outcome: &Outcome) -> (Vec<Shade>, Vec<Lane>) {
    if outcome.faults.is_empty() {
        return Default::default();
    }
    let end_ns = outcome.record.last.1;
    let faults = outcome.faults.iter().map(|fault| Shade {
        span_s: (
            fault.start_ns as f64 * 1e-9,
            fault.end_ns().min(end_ns) as f64 * 1e-9,
        ),
        color: FAULT_SHADE,
        name: fault.kind.to_string(),
    });
    let samples = outcome.samples().iter();
    let mut flags: Vec<(u64, Flags)> = samples
        .map(|sample| (sample.published_ns, sample.snapshot.flags))
        .chain(
            outcome
                .record
                .stale
                .iter()
                .map(|stale| (stale.published_ns, stale.snapshot.flags)),
        )
        .collect();
    flags.sort_by_key(|&(at_ns, _)| at_ns);
    let named = Flags::all()
        .iter_names()
        .map(|(name, flag)| (name, spans(&flags, flag, end_ns)));
    let lanes = flag_lanes(named, "VALID");
    (faults.collect(), lanes)
}

/// Returns the spans in which a flag was set, s. Each publication stands until the next one.
fn spans(published: &[(u64, Flags)], flag: Flags, end_ns: u64) -> Vec<(f64, f64)> {
    let mut spans: Vec<(f64, f64)> = Vec::new();
    for (nth, &(at_ns, flags)) in published.iter().enumerate() {
        if !flags.contains(flag) {
            continue;
        }
        let next_ns = published.get(nth + 1).map_or(end_ns, |next| next.0);
        let (start_s, end_s) = (at_ns as f64 * 1e-9, next_ns as f64 * 1e-9);
        match spans.last_mut() {
            Some(last) if last.1 == start_s => last.1 = end_s,
            _ => spans.push((start_s, end_s)),
        }
    }
    spans
}

/// The panels.
fn panels(samples: &[Sample]) -> Vec<Panel> {
    let shift_deg = yaw_difference_deg(samples);
    let angle = |name: &str, color: Color, index: usize, shift_deg: f64| {
        let (mut truth, mut estimate) = (Trace::of_angles(), Trace::of_angles());
        for sample in samples {
            let euler = sample.snapshot.euler();
            let angles = [euler.roll_rad, euler.pitch_rad, euler.yaw_rad];
            estimate.push(time_s(sample), f64::from(angles[index]).to_degrees());
            if let Some(attitude) = sample.edge.and_then(|edge| edge.truth.attitude) {
                truth.push(
                    time_s(sample),
                    attitude.to_euler_degrees()[index] + shift_deg,
                );
            }
        }
        let mut curves = vec![(color, "estimate", &estimate)];
        if !truth.is_empty() {
            curves.insert(0, (TRUTH, "truth", &truth));
        }
        Panel::around(&format!("{name} (degrees)"), NARROWEST_DEG, curves)
    };
    let mut panels = vec![
        angle("roll", FIRST, 0, 0.0),
        angle("pitch", SECOND, 1, 0.0),
        angle("yaw, relative", THIRD, 2, shift_deg),
    ];
    let errors = samples
        .iter()
        .filter_map(|sample| Some((time_s(sample), inclination_deg(sample)?)));
    let errors = Trace::through(errors);
    if !errors.is_empty() {
        panels.push(error_panel(&errors, None));
    }
    panels
}

/// Returns the angle to add to the true yaw so that it starts where the estimate does: the
/// estimate's zero is the heading at rest.
fn yaw_difference_deg(samples: &[Sample]) -> f64 {
    let first = samples.iter().find_map(|sample| {
        let attitude = sample.edge?.truth.attitude?;
        let is_ready = !sample.snapshot.flags.contains(Flags::CALIBRATING);
        is_ready.then(|| {
            f64::from(sample.snapshot.euler().yaw_rad).to_degrees() - attitude.to_euler_degrees()[2]
        })
    });
    first.unwrap_or(0.0)
}
