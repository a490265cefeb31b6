//! Tests of the judge and the table on records that a sound firmware would leave, with changes.

use std::collections::BTreeSet;
use std::ops::Range;

use aplomb::attitude::{Quaternion as Attitude, Vector3};
use aplomb::estimator::heading::HeadingEstimate;
use aplomb::fault::FaultClass;
use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;
use aplomb_models::motion::inclination_error_rad;
use aplomb_models::sensor::{Burst, DataReady};
use rigless::time::VirtualNanos;

use super::*;
use crate::bus_step::BusStep;
use crate::flight::UartLine;
use crate::recorder::{HealthReading, Record, Sample, StaleSnapshot};

const MILLISECOND: u64 = 1_000_000;

fn case(text: &str) -> Case {
    Case::new(3, Schedule::parse("test", text).unwrap())
}

/// The record of a sound firmware: a right attitude every millisecond from 0.3 s on, valid from 1.2
/// s on, except for a gap.
fn record(case: &Case, without_ns: Range<u64>) -> Record {
    let end_ns = VirtualNanos((case.seconds * 1e9) as u64).0;
    let mut motion = case.motion();
    let mut record = Record {
        last: (0, end_ns),
        instructions: vec![0; 128],
        ..Record::default()
    };
    let mut counters = [0; FaultClass::COUNT];
    for fault in &case.schedule.faults {
        for &class in fault.kind.counted() {
            counters[class as usize] += 1;
        }
        record.health.push(HealthReading {
            at_ns: fault.start_ns + MILLISECOND,
            reset_cause: 0,
            counters,
        });
    }
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
        let shown = record.edges.iter().rev().nth(2).unwrap_or(&edge).truth;
        let [p, q, r] = shown.body_rates_rad_s.map(|rate| rate as f32);
        let mut snapshot = Snapshot {
            t_us: time_ns / 1000,
            body_rates_rad_s: Vector3::new(p, q, r),
            attitude: Attitude { w, x, y, z },
            flags: if is_known {
                Flags::VALID
            } else {
                Flags::CALIBRATING
            },
            tilt_variance_rad2: 1.0e-4,
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
            heading: None,
            is_armed: false,
            published_ns,
            burst: Burst {
                edge: Some(edge.index),
                bytes: [0; 14],
                completed_ns: published_ns,
            },
            is_new: true,
            edge: Some(edge),
            true_t_us: Some(time_ns as f64 * 1e-3),
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

/// A line by UART every 20 ms, for longer than any flight here.
fn telemetry() -> Vec<UartLine> {
    let line = |at_ms: u64| UartLine {
        at_ns: at_ms * MILLISECOND,
        text: "roll:0.0".to_owned(),
    };
    (0..30_000).step_by(20).map(line).collect()
}

#[track_caller]
fn assert_fails(case: &Case, record: &Record, why: &str) {
    let failures = judge(case, record, &telemetry()).failures;
    assert!(
        failures.iter().any(|failure| failure.contains(why)),
        "{failures:?}"
    );
}

#[test]
fn what_is_sound_passes_and_is_measured() {
    let (case, record) = sound();
    let report = judge(&case, &record, &telemetry());
    assert_eq!(report.failures, Vec::<String>::new());
    assert_eq!(report.faults.len(), 1);
    assert!(report.faults[0].is_detected);
    let recovery_ms = report.faults[0].recovery_ns.unwrap() as f64 * 1e-6;
    assert!((recovery_ms - 10.39).abs() < 0.01, "{recovery_ms}");
}

#[test]
fn every_kit_flies_and_a_fault_of_a_compass_has_a_compass() {
    let mut compasses = [0; 2];
    let mut kits = BTreeSet::new();
    for seed in 0..400 {
        let case = Case::by_seed(seed);
        let kit = case.kit();
        let mut faults = case.schedule.faults.iter();
        let is_asked_for = faults.any(|fault| fault.kind.is_of_compass());
        let has_compass = kit != (Kit::Mpu6050, None);
        assert!(has_compass || !is_asked_for, "{seed}");
        compasses[usize::from(is_asked_for)] += u32::from(has_compass);
        kits.insert(format!("{kit:?}"));
    }
    assert_eq!(kits.len(), 5, "{kits:?}");
    let [others, _] = compasses;
    assert!((10..60).contains(&others), "{others}");
}

#[test]
fn a_fault_that_is_not_counted_as_its_class_fails() {
    let (case, mut record) = sound();
    let [reading] = &mut record.health[..] else {
        panic!("one fault")
    };
    reading.counters = [0; FaultClass::COUNT];
    reading.counters[FaultClass::Frozen as usize] = 1;
    let report = judge(&case, &record, &telemetry());
    assert!(!report.faults[0].is_detected);
    assert_eq!(
        report.failures,
        ["not counted as one of [DataLineLow], but as [Frozen]: 1.8 0.03 sda-low"]
    );
    // It was counted before the fault, and not since.
    record.health[0].counters[FaultClass::DataLineLow as usize] = 1;
    record.health[0].at_ns = 1_700 * MILLISECOND;
    assert_fails(&case, &record, "not counted as one of [DataLineLow]");
}

#[test]
fn the_second_death_of_a_crystal_need_not_be_counted() {
    let by_internal = |faults: &str, reset_ms: Option<u64>| {
        let case = case(faults);
        let mut record = record(&case, 0..0);
        for sample in &mut record.samples {
            let is_internal = sample.published_ns > 1_800 * MILLISECOND;
            let internal = Flags::INTERNAL_CLOCK | Flags::DEGRADED;
            sample.snapshot.flags.set(internal, is_internal);
        }
        record.health.truncate(1);
        record
            .resets_ns
            .extend(reset_ms.map(|at_ms| at_ms * MILLISECOND));
        judge(&case, &record, &telemetry()).failures
    };
    let twice = "1.8 0.1 crystal-dies\n2.3 0.1 crystal-dies";
    assert_eq!(by_internal(twice, None), Vec::<String>::new());
    // After a reset the core runs by the crystal again.
    let failures = by_internal(twice, Some(2_200));
    let is_missing = |text: &String| text.starts_with("not counted as one of [ClockFailed]");
    assert!(failures.iter().any(is_missing), "{failures:?}");
    let other = by_internal("1.8 0.1 crystal-dies\n2.3 0.1 zeros", None);
    assert_eq!(
        other,
        ["not counted as one of [Rejected], but as []: 2.3 0.1 zeros"]
    );
}

#[test]
fn a_flag_that_a_fault_leaves_behind_fails() {
    let (case, mut record) = sound();
    record.samples[1200].snapshot.flags |= Flags::POLLED;
    assert_fails(
        &case,
        &record,
        "1 attitudes flagged without a fault, the first with VALID|POLLED",
    );
    // In time the fault may still show.
    let (case, mut record) = sound();
    let shows = |sample: &&mut Sample| {
        (1_840 * MILLISECOND..1_850 * MILLISECOND).contains(&sample.published_ns)
    };
    for sample in record.samples.iter_mut().filter(shows) {
        sample.snapshot.flags |= Flags::POLLED;
    }
    let failures = judge(&case, &record, &telemetry()).failures;
    assert_eq!(failures, Vec::<String>::new());
}

#[test]
fn a_condition_without_its_cause_fails() {
    const FREE: usize = 1_200; // 1.5 s, before the fault
    const LATER: usize = 1_700; // 2.0 s, long after its deadline
    for (faults, nth, flags, is_allowed) in [
        ("1.8 0.03 sda-low", FREE, Flags::COMPASS_FAULT, false),
        ("1.8 0.03 sda-low", LATER, Flags::COMPASS_FAULT, true),
        ("1.6 0.2 uart-flood", LATER, Flags::COMPASS_FAULT, false),
        ("1.8 0.03 sda-low", LATER, Flags::INTERNAL_CLOCK, false),
        ("1.8 0.03 sda-low", LATER, Flags::VIBRATION, false),
        (
            "1.7 0.03 frozen",
            LATER,
            Flags::ACCELEROMETER_SATURATED,
            false,
        ),
    ] {
        let case = case(faults);
        let mut record = record(&case, 1_800 * MILLISECOND..1_840 * MILLISECOND);
        record.samples[nth - 40 * usize::from(nth == LATER)]
            .snapshot
            .flags |= flags;
        let failures = judge(&case, &record, &telemetry()).failures;
        let is_flagged = |text: &String| text.contains("flagged without a fault");
        let is_found = failures.iter().any(is_flagged);
        assert_eq!(
            is_found, !is_allowed,
            "{faults} {nth} {flags}: {failures:?}"
        );
    }
}

#[test]
fn degraded_attitudes_without_a_cause_end_in_a_second() {
    for (faults, degraded_ms, is_allowed) in [
        ("1.4 0.03 sda-low", 990, true),
        ("1.4 0.03 sda-low", 1_010, false),
        ("1.4 0.06 sda-low", 1_010, true),
        ("1.4 0.03 frozen", 1_010, true),
        ("1.4 0.06 uart-flood", 1_010, false),
    ] {
        let mut case = case(faults);
        case.seconds = 3.5;
        let mut record = record(&case, 1_400 * MILLISECOND..1_440 * MILLISECOND);
        let is_degraded = |sample: &&mut Sample| {
            (2_000..2_000 + degraded_ms).contains(&(sample.published_ns / MILLISECOND))
        };
        for sample in record.samples.iter_mut().filter(is_degraded) {
            sample.snapshot.flags |= Flags::DEGRADED;
        }
        let failures = judge(&case, &record, &telemetry()).failures;
        let is_found = failures.iter().any(|text| text.starts_with("degraded for"));
        assert_eq!(
            is_found, !is_allowed,
            "{faults} {degraded_ms}: {failures:?}"
        );
    }
}

#[test]
fn flags_that_deny_their_sigma_and_an_old_attitude_fail() {
    for (sigma_deg, flags, is_allowed) in [
        (4.9, Flags::VALID, true),
        (5.1, Flags::VALID, false),
        (29.9, Flags::VALID | Flags::DEGRADED, true),
        (30.1, Flags::VALID | Flags::DEGRADED, false),
        (30.1, Flags::DEGRADED, true),
        (f32::NAN, Flags::VALID | Flags::DEGRADED, false),
        (f32::NAN, Flags::empty(), false),
    ] {
        let (case, mut record) = sound();
        let snapshot = &mut record.samples[1_000].snapshot;
        snapshot.tilt_variance_rad2 = sigma_deg.to_radians().powi(2);
        snapshot.flags = flags;
        let failures = judge(&case, &record, &telemetry()).failures;
        let is_found = failures
            .iter()
            .any(|text| text.contains("deny their sigma"));
        assert_eq!(is_found, !is_allowed, "{sigma_deg} {flags}: {failures:?}");
    }
    let (case, mut record) = sound();
    record.samples[1_000].is_new = false;
    assert_fails(
        &case,
        &record,
        "1 attitudes were valid without a whole new burst",
    );
}

#[test]
fn a_clock_that_a_fault_has_moved_and_wrong_rates_fail() {
    let (case, mut record) = sound();
    for sample in record.samples.iter_mut().skip(1_500) {
        sample.snapshot.t_us += 1_000;
    }
    assert_fails(
        &case,
        &record,
        "times were not those of their edges, the first off by 1000.0",
    );

    for (error_rad_s, is_allowed) in [(0.1, true), (0.2, false), (f32::NAN, false)] {
        let (case, mut record) = sound();
        record.samples[1_200].snapshot.body_rates_rad_s.y += error_rad_s;
        let failures = judge(&case, &record, &telemetry()).failures;
        let is_found = failures
            .iter()
            .any(|text| text.starts_with("1 rates were wrong"));
        assert_eq!(is_found, !is_allowed, "{error_rad_s}: {failures:?}");
    }
}

#[test]
fn a_stall_excuses_the_silence_of_its_own_time_alone() {
    let case = case("1.8 0.0015 core-stall");
    let record = record(&case, 1_800 * MILLISECOND..1_803 * MILLISECOND);
    let silence = |until_ms: u64| {
        let mut lines = telemetry();
        let dead = 1_790 * MILLISECOND..until_ms * MILLISECOND;
        lines.retain(|line| !dead.contains(&line.at_ns));
        let failures = judge(&case, &record, &lines).failures;
        failures.iter().any(|text| text.starts_with("no line came"))
    };
    assert!(!silence(1_870), "the pause is 100 ms");
    assert!(silence(1_890));
    assert!(silence(60_000), "to the end");
}

#[test]
fn a_violation_is_expected_only_with_the_fault_that_explains_it() {
    let [sag, overflow] = ["1.8 0.03 supply-sag:2500", "1.8 0 stack-overflow"].map(case);
    let wait_states = "FLASH.ACR: too few";
    let [stack, other] = [0x1FFF_FFF8_u64, 0x4001_4C00]
        .map(|at| format!("no such address: unmapped at={at:#010x} pc=0x0800c000"));
    for (violation, is_of_sag, is_of_overflow) in [
        (wait_states, true, false),
        (&stack, false, true),
        (&other, false, false),
    ] {
        assert_eq!(is_expected(&sag, violation), is_of_sag, "{violation}");
        assert_eq!(
            is_expected(&overflow, violation),
            is_of_overflow,
            "{violation}"
        );
    }
}

#[test]
fn an_entry_notes_a_valid_heading_of_a_valid_attitude() {
    let (case, mut record) = sound();
    let report = judge(&case, &record, &telemetry());
    let mut has_heading = |nth: usize, is_valid| {
        record.samples[nth].heading = Some(HeadingEstimate {
            yaw_offset_rad: 0.0,
            sigma_rad: 0.1,
            is_valid,
        });
        Entry::new(7, &report, Some(&record)).has_heading
    };
    assert!(!has_heading(1_000, false));
    assert!(!has_heading(0, true), "the attitude is not valid yet");
    assert!(has_heading(1_000, true));
    assert!(!Entry::new(7, &report, None).has_heading);
}

#[test]
fn a_wrong_heading_fails_only_if_it_is_valid() {
    let (case, mut record) = sound();
    let mut put = |offset_deg: f32, sigma_deg: f32, is_valid: bool| {
        record.samples[1000].heading = Some(HeadingEstimate {
            yaw_offset_rad: offset_deg.to_radians(),
            sigma_rad: sigma_deg.to_radians(),
            is_valid,
        });
        judge(&case, &record, &telemetry()).failures
    };
    for allowed in [(14.9, 0.5, true), (-23.0, 4.0, true), (90.0, 4.0, false)] {
        let (offset_deg, sigma_deg, is_valid) = allowed;
        let failures = put(offset_deg, sigma_deg, is_valid);
        assert_eq!(failures, Vec::<String>::new(), "{allowed:?}");
    }
    for (offset_deg, sigma_deg) in [(15.1, 0.5), (-25.0, 4.0), (180.0, 12.0), (0.0, f32::NAN)] {
        let failures = put(offset_deg, sigma_deg, true);
        let is_wrong = |text: &String| text.starts_with("1 headings published as valid");
        let is_allowed = offset_deg == 0.0;
        assert_eq!(failures.iter().any(is_wrong), !is_allowed, "{offset_deg}");
    }
    // A heading without an attitude is not valid.
    put(90.0, 0.5, true);
    record.samples[1000].snapshot.flags = Flags::DEGRADED;
    let failures = judge(&case, &record, &telemetry()).failures;
    assert!(!failures.iter().any(|text| text.contains("headings")));
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
    assert_eq!(
        judge(&case, &record, &telemetry()).faults[0].recovery_ns,
        None
    );
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
            health: record.health.clone(),
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
        let failures = judge(&case, &with_wrong_attitude(flags, sigma_deg), &telemetry()).failures;
        let is_wrong = failures.iter().any(|text| text.contains("were wrong"));
        assert!(!is_wrong, "{failures:?}");
    }
    let mut no_number = with_wrong_attitude(Flags::VALID, 0.1);
    no_number.samples[1000].snapshot.attitude.w = f32::NAN;
    assert_fails(&case, &no_number, "published as valid were wrong");
}

#[test]
fn a_stuck_axis_may_be_wrong_for_two_windows_and_no_longer() {
    let case = case("1.8 0.03 stuck:gx");
    for (time_ms, is_allowed) in [(1_795, false), (1_810, true), (2_050, true), (2_070, false)] {
        let mut record = record(&case, 0..0);
        let sample = &mut record.samples[time_ms - 300];
        sample.snapshot.attitude.x += 0.1;
        let failures = judge(&case, &record, &telemetry()).failures;
        let is_wrong = failures.iter().any(|text| text.contains("were wrong"));
        assert_eq!(is_wrong, !is_allowed, "{time_ms}: {failures:?}");
    }
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
        judge(&case, &record(&case, 0..0), &telemetry()).failures,
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
        &telemetry(),
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
    assert_eq!(
        judge(&case, &record, &telemetry()).failures,
        Vec::<String>::new()
    );
}

#[test]
fn the_table_counts_by_kind() {
    let (case, record) = sound();
    let mut table = Table::default();
    table.add(&judge(&case, &record, &telemetry()).faults);
    let text = table.to_string();
    let row = text
        .lines()
        .find(|line| line.starts_with("sda-low"))
        .unwrap();
    let cells: Vec<&str> = row.split_whitespace().collect();
    assert_eq!(cells, ["sda-low", "1", "1", "1", "10.4"]);
    // A heading, the kinds, and the start without a crystal.
    assert_eq!(text.lines().count(), Schedule::kinds().count() + 2);
}

#[test]
fn coverage_counts_pairs_that_are_close_and_the_steps_of_the_bus() {
    let mut coverage = Coverage::default();
    let (_, all_pairs) = coverage.pairs();
    let all_steps = 9 * 19;
    let kinds = Schedule::kinds().count() + 1;
    assert_eq!(all_pairs, kinds * (kinds + 1) / 2 - 14);
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
    let pairs = format!("pairs of faults within 50 ms: 1 of {all_pairs}");
    assert!(text.contains(&pairs), "{text}");
    assert!(
        text.lines()
            .any(|row| row.starts_with("sda-low") && row.contains(" 2 ")),
        "{text}"
    );
}

#[test]
fn conditions_are_drawn_within_their_limits_and_a_seed_keeps_its_faults() {
    let (mut without_crystal, mut errors, mut sags, mut cuts, mut on_top) = (0, 0, 0, 0, 0);
    let mut stuck = 0;
    for seed in 0..4_000 {
        let (case, plain) = (Case::by_seed(seed), Case::with_schedule_by_seed(seed));
        let conditions = case.conditions;
        assert!((17_000..=47_000).contains(&conditions.watchdog_hz));
        let error = conditions.internal_error;
        assert!((-0.08..=0.045).contains(&error), "{seed}: {error}");
        let faults = &case.schedule.faults;
        let dies = |fault: &ScheduledFault| fault.kind == FaultKind::CrystalDies;
        assert!(error == 0.0 || conditions.lacks_crystal || faults.iter().any(dies));
        without_crystal += u32::from(conditions.lacks_crystal);
        errors += u32::from(error != 0.0);
        let is_sag = |fault: &&ScheduledFault| matches!(fault.kind, FaultKind::SupplySag(_));
        let sag = faults.iter().find(is_sag);
        assert_eq!(sag.is_some(), conditions.save_s.is_some(), "{seed}");
        let is_stuck = |fault: &&ScheduledFault| matches!(fault.kind, FaultKind::Stuck(_));
        if faults.iter().any(|fault| is_stuck(&fault)) {
            assert!(!faults.iter().any(|fault| fault.kind.resets()), "{seed}");
            stuck += 1;
        }
        let others = faults
            .iter()
            .filter(|fault| !is_sag(fault) && !is_stuck(fault));
        let later_ns: BTreeSet<u64> = others
            .clone()
            .zip(&plain.schedule.faults)
            .map(|(drawn, plain)| {
                assert_eq!(drawn.kind, plain.kind, "{seed}");
                drawn.start_ns - plain.start_ns
            })
            .collect();
        assert_eq!(others.count(), plain.schedule.faults.len(), "{seed}");
        assert_eq!(later_ns.len(), 1, "{seed}: {later_ns:?}");
        let Some(sag) = sag else {
            assert_eq!(later_ns.first(), Some(&0), "{seed}");
            continue;
        };
        cuts += u32::from(sag.kind.stops_core());
        sags += u32::from(!sag.kind.stops_sensor());
        on_top += u32::from(later_ns.contains(&0));
    }
    assert!((150..250).contains(&without_crystal), "{without_crystal}");
    assert!((60..160).contains(&stuck), "{stuck}");
    assert!(errors > without_crystal + 80, "{errors}");
    assert!(
        sags > 100 && cuts > 50 && on_top > 20,
        "{sags} {cuts} {on_top}"
    );
}

#[test]
fn an_attitude_by_the_internal_oscillator_without_its_flags_fails() {
    let without_crystal = |flags: Flags| {
        let mut case = case("1.8 0.03 sda-low");
        case.conditions.lacks_crystal = true;
        let mut record = record(&case, 1800 * MILLISECOND..1840 * MILLISECOND);
        for sample in &mut record.samples {
            sample.snapshot.flags |= flags;
        }
        judge(&case, &record, &telemetry())
    };
    let sound = without_crystal(Flags::INTERNAL_CLOCK | Flags::DEGRADED);
    assert_eq!(sound.failures, Vec::<String>::new());
    assert!(sound.faults.iter().any(|fault| fault.kind == "no-crystal"));
    for flags in [Flags::empty(), Flags::INTERNAL_CLOCK, Flags::DEGRADED] {
        let failures = without_crystal(flags).failures;
        assert!(
            failures[0].contains("without INTERNAL_CLOCK"),
            "{failures:?}"
        );
    }
}

#[test]
fn a_dead_crystal_is_flagged_until_a_reset() {
    let case = case("1.8 0 crystal-dies");
    let mut record = record(&case, 0..0);
    assert_fails(&case, &record, "without INTERNAL_CLOCK");
    for sample in &mut record.samples {
        let is_late = sample.published_ns > 1_820 * MILLISECOND;
        let expected = Flags::INTERNAL_CLOCK | Flags::DEGRADED;
        sample.snapshot.flags.set(expected, is_late);
    }
    assert_eq!(
        judge(&case, &record, &telemetry()).failures,
        Vec::<String>::new()
    );
}

#[test]
fn a_flight_by_the_internal_oscillator_is_judged_by_its_own_time() {
    let mut case = case("1.8 0 crystal-dies");
    case.conditions.internal_error = -0.08;
    let (mut by_core, mut by_earth) = (case.motion_by_core_time(), case.motion());
    for (core_s, earth_s) in [(1.7, 1.7), (1.8, 1.8), (2.26, 2.3), (2.72, 2.8)] {
        let [shown, expected] = [by_core.at(core_s), by_earth.at(earth_s)];
        let [shown, expected] = [shown, expected].map(|truth| truth.attitude.unwrap());
        let error_rad = inclination_error_rad(shown, expected);
        assert!(error_rad < 1e-9, "{core_s}: {error_rad}");
    }
}

#[test]
fn a_save_may_pause_for_an_erase_and_no_longer() {
    let mut case = case("3.5 0.03 sda-low");
    case.conditions.save_s = Some(1.8);
    let pause = |until: u64| {
        let mut record = record(&case, 1810 * MILLISECOND..until * MILLISECOND);
        let fault = self::record(&case, 3500 * MILLISECOND..3540 * MILLISECOND);
        record.stale.clear();
        record.stale.extend(fault.stale);
        record.samples.retain(|sample| {
            !(3500 * MILLISECOND..3540 * MILLISECOND).contains(&sample.edge.unwrap().time_ns)
        });
        judge(&case, &record, &telemetry()).failures
    };
    assert_eq!(pause(2_320), Vec::<String>::new());
    let failures = pause(2_340);
    assert!(
        failures[0].starts_with("nothing was published for 531"),
        "{failures:?}"
    );
}

#[test]
fn a_save_in_which_the_crystal_dies_may_take_longer_by_an_erase() {
    for (faults, is_late) in [
        ("1.9 0.1 crystal-dies", false),
        ("1.9 0.03 sda-low", true),
        ("2.4 0.1 crystal-dies", true),
    ] {
        let mut case = case(faults);
        case.conditions.save_s = Some(1.8);
        case.seconds = 4.0;
        let mut record = record(&case, 1810 * MILLISECOND..3000 * MILLISECOND);
        for sample in &mut record.samples {
            let is_internal = faults.contains("crystal") && sample.published_ns > 1_900_000_000;
            let internal = Flags::INTERNAL_CLOCK | Flags::DEGRADED;
            sample.snapshot.flags.set(internal, is_internal);
        }
        let failures = judge(&case, &record, &telemetry()).failures;
        let found = failures.iter().any(|text| text.starts_with("valid again"));
        assert_eq!(found, is_late, "{faults}: {failures:?}");
    }
}

#[test]
fn telemetry_may_be_silent_until_the_sensor_is_back_after_a_reset() {
    let silence = |faults: &str| {
        let mut case = case(faults);
        case.seconds = 2.5;
        let mut record = record(&case, 1800 * MILLISECOND..1_990 * MILLISECOND);
        record.stale.clear();
        record.resets_ns.push(1_850 * MILLISECOND);
        let line = |at_ns| UartLine {
            at_ns,
            text: "roll:0.0".to_owned(),
        };
        let times = (300..1_850).chain(1_990..2_500).step_by(25);
        let mut lines: Vec<UartLine> = times.map(|at| line(at * MILLISECOND)).collect();
        lines.push(line(1_860 * MILLISECOND));
        lines.sort_by_key(|line| line.at_ns);
        let failures = judge(&case, &record, &lines).failures;
        failures.iter().any(|text| text.starts_with("no line came"))
    };
    assert!(!silence("1.8 0.05 sensor-brownout\n1.84 0 crash"));
    assert!(silence("1.84 0 crash"));
    assert!(silence("1.84 0 crash\n2.3 0.05 sensor-brownout"));
}

#[test]
fn telemetry_that_never_comes_or_not_after_a_reset_fails() {
    for fault in ["1.84 0 crash", "1.84 0 watchdog-hang"] {
        telemetry_must_come_after_reset(fault);
    }
}

/// Checks the judge with a flight that is reset at 1.85 s and has an attitude again at 1.99 s.
fn telemetry_must_come_after_reset(fault: &str) {
    let mut case = case(fault);
    case.seconds = 2.5;
    let mut record = record(&case, 1840 * MILLISECOND..1_990 * MILLISECOND);
    record.stale.clear();
    record.resets_ns.push(1_850 * MILLISECOND);
    let silence = |lines: &[UartLine]| {
        let failures = judge(&case, &record, lines).failures;
        failures
            .into_iter()
            .find(|text| text.starts_with("no line came"))
    };
    assert_eq!(silence(&telemetry()), None);
    let never = silence(&[]).unwrap();
    assert!(never.ends_with("from 1.9904 s on"), "{never}");
    let mut dead = telemetry();
    dead.retain(|line| line.at_ns < 1_850 * MILLISECOND);
    let failure = silence(&dead).unwrap();
    assert!(failure.ends_with("from 1.9904 s on"), "{failure}");
    let mut late = telemetry();
    late.retain(|line| !(1_850 * MILLISECOND..2_190 * MILLISECOND).contains(&line.at_ns));
    let failure = silence(&late).unwrap();
    assert!(
        failure.starts_with("no line came by UART for 209."),
        "{failure}"
    );
}

#[test]
fn a_failure_of_the_supply_resets_and_allows_the_time_of_a_start() {
    let case = case("1.8 0.1 supply-sag:1000");
    let mut record = record(&case, 1800 * MILLISECOND..3500 * MILLISECOND);
    assert_fails(&case, &record, "nothing reset it");
    record.resets_ns.push(1_900 * MILLISECOND);
    let report = judge(&case, &record, &telemetry());
    assert_eq!(report.failures, Vec::<String>::new());
    let recovery_ms = report.faults[0].recovery_ns.map(|ns| ns / MILLISECOND);
    assert_eq!(recovery_ms, Some(1_600));
}

/// The failures of a flight whose attitudes are flagged `COMPASS_FAULT` in this time, ms.
fn failures_with_flag(text: &str, save_s: Option<f64>, flagged_ms: Range<u64>) -> Vec<String> {
    let mut case = case(text);
    case.conditions.save_s = save_s;
    let mut record = record(&case, 0..0);
    for sample in &mut record.samples {
        if flagged_ms.contains(&(sample.published_ns / MILLISECOND)) {
            sample.snapshot.flags |= Flags::COMPASS_FAULT;
        }
    }
    let mut failures = Vec::new();
    compass::check_flags(&case, &record, &mut failures);
    failures
}

#[test]
fn a_fault_of_the_compass_is_flagged_in_time_unless_something_hides_it() {
    let zeros = "1.8 0.9 compass-zeros";
    let missed = ["no COMPASS_FAULT within 600 ms: 1.8 0.9 compass-zeros"];
    assert_eq!(failures_with_flag(zeros, None, 0..0), missed);
    assert_eq!(failures_with_flag(zeros, None, 1_700..1_799), missed);
    assert_eq!(failures_with_flag(zeros, None, 2_402..2_700), missed);
    assert!(failures_with_flag(zeros, None, 2_390..2_700).is_empty());
    assert!(failures_with_flag(zeros, Some(1.9), 0..0).is_empty());
    // A shorter fault, and one beside or soon after another.
    for hidden in [
        "1.8 0.5 compass-zeros",
        "1.8 0.9 compass-zeros\n2.3 0.01 scl-low",
        "1.5 0.01 scl-low\n3.1 0.9 compass-zeros",
    ] {
        let failures = failures_with_flag(hidden, None, 0..0);
        assert_eq!(failures, Vec::<String>::new(), "{hidden}");
    }
    let later = failures_with_flag("1.5 0.01 scl-low\n3.3 0.9 compass-zeros", None, 0..0);
    assert_eq!(later.len(), 1);
    let stall = "1.8 0.05 compass-stall";
    assert_eq!(
        failures_with_flag(stall, None, 0..0),
        ["no COMPASS_FAULT within 90 ms: 1.8 0.05 compass-stall"]
    );
    assert!(failures_with_flag(stall, None, 1_880..1_900).is_empty());
    assert!(failures_with_flag("1.8 0.03 compass-stall", None, 0..0).is_empty());
}
