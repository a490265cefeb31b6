//! The firmware's own figures against those that the emulator counts from outside.

mod common;

use std::collections::BTreeMap;

use aplomb_models::motion::rest::Rest;
use common::firmware;
use virtual_board::faults::{Fault, FaultKind, ScheduledFault};
use virtual_board::flight::{Outcome, Run};
use virtual_board::recorder::Sample;

/// Begin and end of the measurement, s.
const SPAN_S: (f64, f64) = (3.0, 13.0);

/// Returns the figures of `measure show`: one to three numbers each.
fn own_figures(outcome: &Outcome) -> BTreeMap<String, Vec<f64>> {
    let answer = outcome.uart_lines.iter().find_map(|line| {
        let text = line.text.strip_prefix("# ok measure: ")?;
        text.starts_with("seconds").then_some(text)
    });
    let fields = answer.expect("figures").split(' ');
    let numbers = |text: &str| {
        text.split(',')
            .map(|number| number.parse().unwrap())
            .collect()
    };
    fields
        .map(|field| field.split_once('=').expect("a name"))
        .map(|(name, value)| (name.to_owned(), numbers(value)))
        .collect()
}

/// Returns the mean and the largest of a figure of the samples within the span.
fn of_samples(outcome: &Outcome, figure: impl Fn(&Sample) -> Option<f64>) -> (f64, f64) {
    let is_within = |sample: &&Sample| {
        let published_s = sample.published_ns as f64 * 1e-9;
        (SPAN_S.0..SPAN_S.1).contains(&published_s)
    };
    let samples = outcome.samples().iter().filter(is_within);
    let figures: Vec<f64> = samples.filter_map(figure).collect();
    assert!(figures.len() > 7_000, "{}", figures.len());
    let mean = figures.iter().sum::<f64>() / figures.len() as f64;
    (mean, figures.iter().copied().fold(0.0, f64::max))
}

/// Returns the mean and the standard deviation of the readings at `place` in the bursts.
fn of_readings(outcome: &Outcome, place: usize) -> (f64, f64) {
    let reading = |sample: &Sample| {
        let bytes = sample.burst.bytes;
        f64::from(i16::from_be_bytes([bytes[place], bytes[place + 1]]))
    };
    let (mean, _) = of_samples(outcome, |sample| Some(reading(sample)));
    let (variance, _) = of_samples(outcome, |sample| Some((reading(sample) - mean).powi(2)));
    (mean, variance.sqrt())
}

/// The timer counts microseconds.
const RESOLUTION_US: f64 = 1.0;

#[test]
fn own_figures_are_those_that_the_emulator_counts() {
    let fly = |seconds: f64| Run::new(firmware()).seconds(seconds);
    // The measurement changes what the core executes, so another flight is counted.
    let measured = fly(SPAN_S.1 + 0.5)
        .command(SPAN_S.0, "measure on")
        .command(SPAN_S.1, "measure show")
        .run()
        .unwrap();
    assert_eq!(measured.issues, Vec::<String>::new());
    let (before, after) = (fly(SPAN_S.0).run().unwrap(), fly(SPAN_S.1).run().unwrap());
    let own = own_figures(&measured);
    let compare = |name: &str, place: usize, outside: f64, resolution: f64| {
        let inside = own[name][place];
        println!("{name}[{place}]: {inside}, outside {outside}");
        let limit = (0.01 * outside).max(resolution);
        assert!(
            (inside - outside).abs() <= limit,
            "{name}[{place}]: {inside}, outside {outside}"
        );
    };
    let (mean, most) = of_samples(&after, |sample| Some(sample.instructions? as f64));
    compare("cycles", 0, mean, 0.0);
    compare("cycles", 1, most, 0.0);
    let (mean, most) = of_samples(&after, |sample| Some(sample.input_instructions? as f64));
    compare("interrupt_cycles", 0, mean, 0.0);
    compare("interrupt_cycles", 1, most, 0.0);
    let (mean, most) = of_samples(&after, |sample| {
        Some((sample.published_ns - sample.edge?.time_ns) as f64 * 1e-3)
    });
    compare("edge_to_attitude_us", 0, mean, RESOLUTION_US);
    compare("edge_to_attitude_us", 1, most, RESOLUTION_US);
    let ((first, first_ns), (last, last_ns)) = (before.record.last, after.record.last);
    let available = (last_ns - first_ns) as f64 * own["core_mhz"][0] * 1e-3;
    compare(
        "load_percent",
        0,
        100.0 * (last - first) as f64 / available,
        0.0,
    );
    let edges = after.record.edges.iter();
    let edges_us: Vec<f64> = edges.map(|edge| edge.time_ns as f64 * 1e-3).collect();
    let periods = edges_us.len() - 1;
    compare(
        "period_us",
        0,
        (edges_us[periods] - edges_us[0]) / periods as f64,
        0.0,
    );
    compare(
        "stack_bytes",
        0,
        measured.record.stack_bytes_used as f64,
        0.0,
    );
    assert_eq!((own["missed"][0], after.summary.missed), (0.0, 0));
}

#[test]
fn noise_offset_and_jitter_at_rest_are_those_of_the_bus() {
    let outcome = Run::new(firmware())
        .seconds(SPAN_S.1 + 0.5)
        .motion(Rest::level())
        .without_account()
        .command(SPAN_S.0, "measure on")
        .command(SPAN_S.1, "measure show")
        .command(SPAN_S.1 + 0.2, "measure off")
        .run()
        .unwrap();
    let own = own_figures(&outcome);
    // The ranges of the firmware: 2048 counts are 1 g, and 16.4 are 1 deg/s.
    let (mg, dps) = (1e3 / 2048.0, 1.0 / 16.4);
    for (name, unit, first, scale) in [("accel", "mg", 0, mg), ("gyro", "dps", 8, dps)] {
        let (means, sigmas) = (
            &own[&format!("{name}_{unit}")],
            &own[&format!("{name}_sigma_{unit}")],
        );
        for (place, (own_mean, own_sigma)) in (first..).step_by(2).zip(means.iter().zip(sigmas)) {
            let (mean, sigma) = of_readings(&outcome, place);
            // The spans differ by a tick of the telemetry.
            assert!(
                (own_mean - scale * mean).abs() < 0.05 * own_sigma,
                "{place}: {own:?}"
            );
            assert!(
                (own_sigma / (scale * sigma) - 1.0).abs() < 0.01,
                "{place}: {own:?}"
            );
        }
    }
    // The sensor's clock has no jitter, so the timer's resolution is all.
    let [mean, least, most] = own["period_us"][..] else {
        panic!("{own:?}");
    };
    assert!(
        least > mean - RESOLUTION_US && most < mean + RESOLUTION_US,
        "{own:?}"
    );
    assert!(own["period_sigma_us"][0] <= 0.51, "{own:?}");
}

#[test]
fn a_measurement_survives_faults_and_a_save() {
    let fly = || {
        let silence = ScheduledFault {
            kind: FaultKind::SensorSilent,
            start_ns: 3_200_000_000,
            duration_ns: 200_000_000,
        };
        Run::new(firmware())
            .seconds(12.0)
            .fault(Fault::Scheduled(silence))
            .command(4.0, "rate 20")
            .command(4.2, "save")
    };
    let outcome = fly()
        .without_account()
        .command(SPAN_S.0, "measure on")
        .command(11.0, "measure show")
        .run()
        .unwrap();
    assert_eq!(outcome.issues, Vec::<String>::new());
    let own = own_figures(&outcome);
    let (seconds, samples) = (own["seconds"][0], own["samples"][0]);
    // Without the pauses of 0.2 s and 0.6 s.
    assert!((7.0..7.3).contains(&seconds), "{own:?}");
    // The sensor's clock is within 1 % of 1 kHz.
    assert!((990.0..1010.0).contains(&(samples / seconds)), "{own:?}");
    // The sample after a pause takes the longest.
    let outside = fly().run().unwrap();
    let (_, most) = of_samples(&outside, |sample| Some(sample.instructions? as f64));
    assert!(
        (own["cycles"][1] / most - 1.0).abs() < 0.01,
        "{most} {own:?}"
    );
}
