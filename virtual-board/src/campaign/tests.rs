//! Tests of the judge and the table on records that a sound firmware would leave, with changes.

use aplomb::attitude::Quaternion as Attitude;
use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;
use aplomb_models::sensor::{Burst, DataReady};
use rigless::time::VirtualNanos;

use super::*;
use crate::bus_step::BusStep;
use crate::flight::UartLine;
use crate::recorder::{Record, Sample, StaleSnapshot};

const MILLISECOND: u64 = 1_000_000;

fn case(text: &str) -> Case {
    Case::new(3, Schedule::parse("test", text).unwrap())
}

/// The record of a sound firmware: a right attitude every millisecond from 0.3 s on, valid from 1.2
/// s on, except for a gap.
fn record(case: &Case, without_ns: std::ops::Range<u64>) -> Record {
    let end_ns = VirtualNanos((case.seconds * 1e9) as u64).0;
    let mut motion = case.motion();
    let mut record = Record {
        last: (0, end_ns),
        instructions: vec![0; 128],
        ..Record::default()
    };
    for (index, time_ns) in (300 * MILLISECOND..end_ns)
        .step_by(MILLISECOND as usize)
        .enumerate()
    {
        let truth = motion.at(time_ns as f64 * 1e-9);
        let edge = DataReady {
            index: index as u64,
            time_ns,
            truth,
        };
        record.edges.push(edge);
        let true_attitude = truth.attitude.unwrap();
        let [w, x, y, z] = [
            true_attitude.w,
            true_attitude.x,
            true_attitude.y,
            true_attitude.z,
        ]
        .map(|part| part as f32);
        let is_known = time_ns >= 1200 * MILLISECOND;
        let mut snapshot = Snapshot {
            t_us: time_ns / 1000,
            attitude: Attitude { w, x, y, z },
            flags: if is_known {
                Flags::VALID
            } else {
                Flags::CALIBRATING
            },
            tilt_variance_rad2: 1.0e-4,
            ..Snapshot::default()
        };
        let published_ns = time_ns + 390_000;
        if without_ns.contains(&time_ns) {
            snapshot.flags = Flags::STALE;
            record.stale.push(StaleSnapshot {
                snapshot,
                published_ns,
            });
            continue;
        }
        record.samples.push(Sample {
            snapshot,
            published_ns,
            burst: Burst {
                edge: Some(edge.index),
                bytes: [0; 14],
                completed_ns: published_ns,
            },
            edge: Some(edge),
            true_t_us: None,
            instructions: None,
            input_instructions: None,
        });
    }
    record
}

/// A gap of 40 ms for a fault of 30 ms, which is what is allowed.
fn sound() -> (Case, Record) {
    let case = case("1.8 0.03 sda-low");
    let record = record(&case, 1800 * MILLISECOND..1840 * MILLISECOND);
    (case, record)
}

#[track_caller]
fn assert_fails(case: &Case, record: &Record, why: &str) {
    let failures = judge(case, record, &[]).failures;
    assert!(
        failures.iter().any(|failure| failure.contains(why)),
        "{failures:?}"
    );
}

#[test]
fn what_is_sound_passes_and_is_measured() {
    let (case, record) = sound();
    let report = judge(&case, &record, &[]);
    assert_eq!(report.failures, Vec::<String>::new());
    assert_eq!(report.faults.len(), 1);
    assert!(report.faults[0].is_detected);
    let recovery_ms = report.faults[0].recovery_ns.unwrap() as f64 * 1e-6;
    assert!((recovery_ms - 10.39).abs() < 0.01, "{recovery_ms}");
}

#[test]
fn a_late_recovery_fails() {
    let case = case("1.8 0.03 sda-low");
    let record = record(&case, 1800 * MILLISECOND..1855 * MILLISECOND);
    assert_fails(
        &case,
        &record,
        "valid again after 25.4 ms, allowed are 20.0 ms",
    );
    assert_eq!(judge(&case, &record, &[]).faults[0].recovery_ns, None);
}

#[test]
fn a_wrong_attitude_fails_unless_its_sigma_or_its_flags_say_so() {
    let (case, record) = sound();
    let with_wrong_attitude = |flags: Flags, sigma_deg: f64| {
        let mut record = Record {
            samples: record.samples.clone(),
            edges: record.edges.clone(),
            stale: record.stale.clone(),
            instructions: record.instructions.clone(),
            last: record.last,
            ..Record::default()
        };
        let sample = &mut record.samples[1000];
        let wrong = Quaternion::from_rotation_vector([0.2, 0.0, 0.0])
            .multiply(sample.edge.unwrap().truth.attitude.unwrap());
        let [w, x, y, z] = [wrong.w, wrong.x, wrong.y, wrong.z].map(|part| part as f32);
        sample.snapshot.attitude = Attitude { w, x, y, z };
        sample.snapshot.flags = flags;
        let sigma_rad = (sigma_deg as f32).to_radians();
        sample.snapshot.tilt_variance_rad2 = sigma_rad * sigma_rad;
        record
    };
    assert_fails(
        &case,
        &with_wrong_attitude(Flags::VALID, 0.1),
        "1 attitudes published as valid were wrong, the worst by 11.",
    );
    for (flags, sigma_deg) in [(Flags::VALID, 2.0), (Flags::DEGRADED, 0.1)] {
        assert_eq!(
            judge(&case, &with_wrong_attitude(flags, sigma_deg), &[]).failures,
            Vec::<String>::new()
        );
    }
    let mut no_number = with_wrong_attitude(Flags::VALID, 0.1);
    no_number.samples[1000].snapshot.attitude.w = f32::NAN;
    assert_fails(&case, &no_number, "published as valid were wrong");
}

#[test]
fn caution_without_a_fault_fails() {
    let (case, mut record) = sound();
    for sample in record.samples.iter_mut().rev().take(20) {
        sample.snapshot.flags = Flags::DEGRADED;
    }
    assert_fails(&case, &record, "% of the time without a fault");
}

#[test]
fn missed_samples_wrong_times_and_silence_fail() {
    let (case, mut record) = sound();
    record.samples.remove(1200);
    assert_fails(&case, &record, "1 samples missed without a fault");

    let (case, mut record) = sound();
    record.samples[1200].snapshot.t_us += 2;
    assert_fails(&case, &record, "a step of time was wrong by 2.0 us");

    let (case, mut record) = sound();
    record.samples[1200].snapshot.t_us -= 2_000;
    assert_fails(&case, &record, "time went back");

    let (case, mut record) = sound();
    record.stale.clear();
    assert_fails(&case, &record, "nothing was published for 41.0 ms");

    let (case, record) = sound();
    let line = |at_ns| UartLine {
        at_ns,
        text: String::new(),
    };
    let lines = [line(400 * MILLISECOND), line(510 * MILLISECOND)];
    let failures = judge(&case, &record, &lines).failures;
    assert!(
        failures[0].starts_with("no line came by UART for"),
        "{failures:?}"
    );
}

#[test]
fn resets_crashes_and_hangs_fail() {
    let (case, mut record) = sound();
    record.resets_ns.push(1900 * MILLISECOND);
    assert_fails(&case, &record, "1 resets, 0 asked for: at 1.9000 s");

    let (case, mut record) = sound();
    record.instructions[3] = 1;
    assert_fails(&case, &record, "a crash or a panic");

    let case = self::case("1.8 0 watchdog-hang");
    let record = self::record(&case, 0..0);
    assert_fails(&case, &record, "nothing reset it");
}

#[test]
fn a_firmware_that_is_never_ready_fails() {
    let (case, mut record) = sound();
    for sample in &mut record.samples {
        sample.snapshot.flags = Flags::CALIBRATING;
    }
    assert_fails(&case, &record, "never valid");
}

#[test]
fn nothing_may_be_seen_of_what_comes_in_by_uart() {
    let case = case("1.8 0.2 uart-flood");
    assert_eq!(
        judge(&case, &record(&case, 0..0), &[]).failures,
        Vec::<String>::new()
    );
    let record = record(&case, 1850 * MILLISECOND..1860 * MILLISECOND);
    assert_fails(&case, &record, "10 samples missed without a fault");
}

#[test]
fn faults_that_follow_closely_are_one_episode() {
    let case = case("1.8 0.03 sda-low\n1.84 0.02 frozen");
    let report = judge(
        &case,
        &record(&case, 1800 * MILLISECOND..2000 * MILLISECOND),
        &[],
    );
    assert_eq!(
        report.failures,
        Vec::<String>::new(),
        "250 ms after the second"
    );
    assert_eq!(report.faults.len(), 2);
}

#[test]
fn a_fault_that_leaves_no_trace_waits_for_one_that_does_shortly_after() {
    let case = case("1.8 0.2 uart-flood\n1.803 0.02 frozen");
    let record = record(&case, 1803 * MILLISECOND..1900 * MILLISECOND);
    assert_eq!(judge(&case, &record, &[]).failures, Vec::<String>::new());
}

#[test]
fn the_table_counts_by_class() {
    let (case, record) = sound();
    let mut table = Table::default();
    table.add(&judge(&case, &record, &[]));
    let text = table.to_string();
    let row = text
        .lines()
        .find(|line| line.starts_with("sda-low"))
        .unwrap();
    let cells: Vec<&str> = row.split_whitespace().collect();
    assert_eq!(cells, ["sda-low", "1", "1", "1", "10.4"]);
    assert_eq!(text.lines().count(), 38);
}

#[test]
fn coverage_counts_pairs_that_are_close_and_the_steps_of_the_bus() {
    let mut coverage = Coverage::default();
    let (_, all_pairs) = coverage.pairs();
    let all_steps = 9 * 19;
    assert_eq!(all_pairs, 37 * 38 / 2 - 6);
    assert_eq!(coverage.steps(), (0, all_steps));

    // 49 ms after the end, and 51 ms after it.
    let flown = case("1.0 0.010 sda-low\n1.059 0.01 frozen\n1.120 0.01 bus-error");
    coverage.add(&flown, &[BusStep::Read(3), BusStep::Idle, BusStep::Start]);
    assert_eq!(coverage.pairs(), (1, all_pairs));
    assert_eq!(coverage.steps(), (2, all_steps), "frozen is not of the bus");

    // Known combinations, in the other order.
    coverage.add(
        &case("1.0 0.010 frozen\n1.0 0.01 sda-low"),
        &[BusStep::Idle, BusStep::Read(3)],
    );
    assert_eq!(coverage.pairs(), (1, all_pairs));
    assert_eq!(coverage.steps(), (2, all_steps));
    let text = coverage.to_string();
    assert!(
        text.contains("pairs of faults within 50 ms: 1 of 697"),
        "{text}"
    );
    assert!(
        text.lines()
            .any(|row| row.starts_with("sda-low") && row.contains(" 2 ")),
        "{text}"
    );
}
