//! Flights with faults of a schedule: what stays as it was, and that one seed is one flight.

mod common;

use std::fs;
use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::telemetry::bursts;
use common::{POOL, firmware, pooled_run};
use virtual_board::campaign::Case;
use virtual_board::flight::Outcome;
use virtual_board::outputs;
use virtual_board::plot::Labels;
use virtual_board::profile::ProcessorPool;
use virtual_board::schedule::Schedule;

fn fly(seconds: f64, schedule: &str) -> Outcome {
    let schedule = Schedule::parse("test", schedule).unwrap();
    pooled_run()
        .seconds(seconds)
        .schedule(&schedule)
        .run()
        .unwrap()
}

fn times(outcome: &Outcome) -> Vec<u64> {
    let samples = outcome.samples().iter();
    samples.map(|sample| sample.snapshot.t_us).collect()
}

#[test]
fn a_flooded_uart_and_a_probe_pulled_off_change_neither_samples_nor_times() {
    let undisturbed = fly(2.5, "");
    for fault in ["uart-flood", "uart-noise", "probe-detach"] {
        let outcome = fly(2.5, &format!("1 1 {fault}"));
        assert_eq!(outcome.summary.missed, 0, "{fault}");
        assert!(times(&outcome) == times(&undisturbed), "{fault}");
        assert!(
            outcome
                .summary
                .timestamp_error_us_max
                .is_some_and(|it| it <= 1.0),
            "{fault}: {:?}",
            outcome.summary
        );
        let lines = outcome
            .uart_lines
            .iter()
            .filter(|line| (1_000_000_000..2_000_000_000).contains(&line.at_ns))
            .count();
        assert!(lines >= 45, "{fault}: {lines} lines by UART in that second");
    }
}

#[test]
fn a_probe_that_is_pulled_off_reads_nothing() {
    let outcome = fly(2.5, "1 1 probe-detach");
    let read = |from_s: f64, to_s: f64| {
        let within = |at_ns: u64| (from_s..to_s).contains(&(at_ns as f64 * 1e-9));
        outcome
            .log()
            .iter()
            .filter(|line| within(line.at_ns))
            .count()
    };
    assert!(read(0.5, 0.999) > 10);
    assert_eq!(read(1.001, 1.999), 0);
    assert!(read(2.01, 2.5) > 10);
}

/// Returns the bits of attitude and rates.
fn bits(snapshot: &Snapshot) -> [u32; 7] {
    let (q, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
    [q.w, q.x, q.y, q.z, rates.x, rates.y, rates.z].map(f32::to_bits)
}

#[test]
fn the_bursts_of_a_flight_with_faults_replay_to_the_bit() {
    let outcome = fly(
        6.0,
        "2.0 0.05 sensor-silent\n2.5 0.1 sensor-brownout\n3.2 0.03 sda-low\n\
         3.6 0.2 int-missing\n4.2 0 crystal-dies\n\
         4.8 0.02 zeros\n5.2 0.0015 address-nack\n5.4 0.1 saturated:gx\n",
    );
    let mut file = Vec::new();
    outputs::write_bursts(&mut file, outcome.samples()).unwrap();
    let text = String::from_utf8(file).unwrap();
    let mut seen = Flags::empty();
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut plain = pipeline;
    let mut differ_without_flags = 0;
    let lines = text.lines().skip(1);
    assert_eq!(lines.clone().count(), outcome.samples().len());
    for (line, sample) in lines.zip(outcome.samples()) {
        let row = bursts::decode(line).unwrap();
        let flown = &sample.snapshot;
        let replayed = pipeline.update(&row.burst, row.board);
        assert_eq!(bits(&replayed), bits(flown), "at {} us: {line}", flown.t_us);
        // Only when the settings were read back is not in the file.
        let known = |flags: Flags| flags - Flags::VALID;
        assert_eq!(
            known(replayed.flags),
            known(flown.flags),
            "at {} us",
            flown.t_us
        );
        seen |= Flags::from(row.board);
        seen.set(
            Flags::MISSED,
            seen.contains(Flags::MISSED) || row.burst.missed_before > 0,
        );
        let unflagged = plain.update(&row.burst, BoardFlags::empty());
        differ_without_flags += usize::from(bits(&unflagged) != bits(flown));
    }
    let expected = Flags::MISSED
        | Flags::BUS_FAULT
        | Flags::SENSOR_RESET
        | Flags::POLLED
        | Flags::INTERNAL_CLOCK;
    assert!(seen.contains(expected), "{seen}");
    assert!(
        differ_without_flags > 1_000,
        "the flags matter: {differ_without_flags}"
    );
}

/// Armed, the filter takes no rest for a rest.
#[test]
fn the_bursts_of_a_flight_that_arms_and_disarms_replay_to_the_bit() {
    let run = pooled_run().seconds(6.0);
    let run = run.command(2.0, "arm").command(4.0, "disarm");
    let outcome = run.run().unwrap();
    let mut file = Vec::new();
    outputs::write_bursts(&mut file, outcome.samples()).unwrap();
    let text = String::from_utf8(file).unwrap();
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let mut never_armed = pipeline;
    let (mut armed, mut differ_unarmed) = (0, 0);
    for (line, sample) in text.lines().skip(1).zip(outcome.samples()) {
        let row = bursts::decode(line).unwrap();
        let flown = &sample.snapshot;
        pipeline.set_armed(row.is_armed);
        let replayed = pipeline.update(&row.burst, row.board);
        assert_eq!(bits(&replayed), bits(flown), "at {} us: {line}", flown.t_us);
        armed += usize::from(row.is_armed);
        let unarmed = never_armed.update(&row.burst, row.board);
        differ_unarmed += usize::from(bits(&unarmed) != bits(flown));
    }
    assert!((1_900..2_100).contains(&armed), "{armed} rows");
    assert!(differ_unarmed > 1_000, "arming matters: {differ_unarmed}");
}

#[test]
fn one_seed_of_faults_gives_the_same_files_every_time() {
    let folder = |name: &str, seed: u64| {
        let case = Case::by_seed(seed);
        let outcome = case.fly_pooled(&POOL, &firmware()).unwrap();
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let labels = Labels {
            title: "title".into(),
            subtitle: "subtitle".into(),
        };
        outputs::write(&folder, &outcome, &labels).unwrap();
        folder
    };
    // 13: a brown-out; 42: another one, another flight.
    let (first, second, other) = (
        folder("faults-first", 13),
        folder("faults-second", 13),
        folder("faults-other", 42),
    );
    for file in [
        "attitude.csv",
        "bursts.csv",
        "truth.csv",
        "uart.log",
        "attitude.png",
    ] {
        let read = |folder: &Path| fs::read(folder.join(file)).unwrap();
        assert!(!read(&first).is_empty());
        assert!(
            read(&first) == read(&second),
            "{file} differs between two runs"
        );
        assert!(
            read(&first) != read(&other),
            "{file} does not depend on the seed"
        );
    }
}

#[test]
fn a_flight_with_a_used_processor_is_the_flight_with_a_new_one() {
    std::thread::scope(|scope| {
        for seeds in [7_000..7_011, 7_011..7_022] {
            scope.spawn(|| compare_used_and_new_processors(seeds));
        }
    });
}

/// The first seed warms the processor up. The kinds of faults follow one another, resets of the
/// core among them.
fn compare_used_and_new_processors(seeds: Range<u64>) {
    let pool = Arc::new(ProcessorPool::default());
    for seed in seeds {
        let case = Case::by_seed(seed);
        let cold = case.fly(&firmware()).unwrap();
        let warm = case.fly_pooled(&pool, &firmware()).unwrap();
        let trace = |outcome: &Outcome| format!("{:?}", outcome.record);
        assert!(trace(&cold) == trace(&warm), "seed {seed}");
        assert!(cold.uart_lines == warm.uart_lines, "seed {seed}");
        assert_eq!(cold.issues, warm.issues, "seed {seed}");
        assert!(cold.flash.bytes == warm.flash.bytes, "seed {seed}");
    }
}
