//! The firmware counts, shows and recovers from each kind of fault, as the table of
//! docs/faults.md requires.
//!
//! The table is read from there, so that it and the tests agree: each row with the name of a fault
//! is flown. The campaign (`cargo xtask faults`) draws such flights at random; here they are fixed.
//! The test of a kind fails when the firmware's detection of it is taken out.

mod common;

use std::collections::BTreeSet;

use aplomb::fault::FaultClass;
use aplomb::health::Flags;
use aplomb_models::motion::poses::Poses;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::{Quaternion, inclination_error_rad};
use common::{POOL, firmware, pooled_run};
use virtual_board::campaign::{self, Case};
use virtual_board::faults::{Fault, FaultKind, ScheduledFault};
use virtual_board::flight::{Outcome, Run};
use virtual_board::schedule::Schedule;

/// The table.
const DOCUMENT: &str = include_str!("../../docs/faults.md");

/// Start of the faults, s: the attitude is valid by then.
const START_S: f64 = 1.8;

/// Start of a stuck axis, s: it shows in motion alone, and the motion begins at 1.5 s.
const STUCK_START_S: f64 = 2.5;

/// The motion and the sensor of the flights: a swing, so that what is wrong shows.
const SEED: u64 = 5;

/// A row of the table.
#[derive(Clone, Debug, Default)]
struct Row {
    /// The faults, as a schedule has them.
    faults: Vec<String>,
    /// Most samples that may be lost, if the fault must leave no other trace.
    most_lost: Option<usize>,
    /// Flags that attitudes must have had.
    flags: Vec<Flags>,
    /// Lines that the UART must have.
    messages: Vec<String>,
    /// The classes that must have been counted, the first of them in time.
    counted: Vec<FaultClass>,
    noticed_ms: Option<f64>,
    back_ms: Option<f64>,
}

/// The pieces of a text between these marks.
fn marked(text: &str, mark: char) -> impl Iterator<Item = String> {
    text.split(mark).skip(1).step_by(2).map(String::from)
}

fn milliseconds(cell: &str) -> Option<f64> {
    match cell {
        "–" => None,
        _ => Some(cell.strip_suffix(" ms").unwrap().parse().unwrap()),
    }
}

/// The rows that a schedule can fly.
fn rows() -> Vec<Row> {
    let lines = DOCUMENT.lines();
    let table = lines
        .skip_while(|line| !line.starts_with("| fault |"))
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let mut rows: Vec<Row> = Vec::new();
    for line in table {
        let line = line.trim_matches(['|', ' ']).replace("\\|", "+");
        let cells: Vec<&str> = line.split('|').map(str::trim).collect();
        let [fault, seen, _, counted, noticed, back] = cells[..] else {
            panic!("six cells: {line}");
        };
        let mut row = if seen.starts_with("the same") {
            rows.last().unwrap().clone()
        } else {
            Row::default()
        };
        row.most_lost = match seen {
            "at most one lost sample" => Some(1),
            _ if seen.starts_with("nothing") => Some(0),
            _ => None,
        };
        row.faults = marked(fault, '`').collect();
        let class = |name: String| {
            let named = FaultClass::ALL
                .into_iter()
                .find(|class| class.name() == name);
            named.unwrap_or_else(|| panic!("no class `{name}`"))
        };
        row.counted = marked(counted, '`').map(class).collect();
        row.flags
            .extend(marked(seen, '`').map(|name| name.parse::<Flags>().unwrap()));
        row.messages
            .extend(marked(seen, '"').map(|text| text.replace('+', "|")));
        row.noticed_ms = milliseconds(noticed);
        row.back_ms = milliseconds(back);
        rows.push(row);
    }
    rows.retain(|row| !row.faults.is_empty());
    rows
}

/// Duration of a fault in these tests, s.
fn duration_s(kind: &str, fault: &str) -> f64 {
    match kind {
        // The fault lasts until somebody clocks.
        "sda-low" if fault != kind => 0.0,
        "core-stall" => 0.03,
        "attitude-late" => 0.01,
        "zeros" | "ones" | "saturated" | "temperature" => 0.1,
        "sensor-silent" | "int-missing" | "int-high" | "int-low" | "int-glitch" => 0.2,
        "compass-stall" => 0.05,
        compass if compass.starts_with("compass-") => 1.0,
        "frozen" | "stuck" => 0.4,
        "probe-detach" => 0.8,
        "uart-flood" | "uart-noise" => 0.6,
        "register-flip" | "crystal-dies" | "watchdog-hang" | "crash" | "stack-overflow" => 0.0,
        _ => 0.05,
    }
}

/// The first time from `from_ns` on at which a class has been counted once more, ns.
fn counted_at_ns(outcome: &Outcome, class: FaultClass, from_ns: u64) -> Option<u64> {
    let readings = outcome.record.health.windows(2);
    let counter =
        |reading: &virtual_board::recorder::HealthReading| reading.counters[class as usize];
    readings
        .filter(|pair| pair[1].at_ns >= from_ns && counter(&pair[1]) > counter(&pair[0]))
        .map(|pair| pair[1].at_ns)
        .next()
}

/// Everything published from `from_ns` to `to_ns`: when, and its flags.
fn published(outcome: &Outcome, from_ns: u64, to_ns: u64) -> Vec<(u64, Flags)> {
    let samples = outcome.samples().iter();
    let samples = samples.map(|sample| (sample.published_ns, sample.snapshot.flags));
    let stale = outcome.record.stale.iter();
    let stale = stale.map(|stale| (stale.published_ns, stale.snapshot.flags));
    let within = |(at_ns, _): &(u64, Flags)| (from_ns..to_ns).contains(at_ns);
    samples.chain(stale).filter(within).collect()
}

/// Checks that a fault has cost so many samples at most, and has left no other trace.
fn assert_lost(outcome: &Outcome, published: &[(u64, Flags)], most: usize, fault: &str) {
    let flags = published.iter().map(|(_, flags)| *flags);
    let marked: Vec<Flags> = flags.filter(|flags| *flags != Flags::VALID).collect();
    let is_missed = |flags: &Flags| *flags == Flags::VALID | Flags::MISSED;
    assert!(
        marked.len() <= most && marked.iter().all(is_missed),
        "{fault}: {marked:?}"
    );
    let missed = outcome.summary.missed;
    assert!(missed <= most, "{fault}: {missed} lost");
}

/// Flies the faults of a kind and holds the firmware to its rows.
fn assert_kind(kind: &str) {
    let mut flights = 0;
    for row in rows() {
        for fault in &row.faults {
            if fault.split(':').next() == Some(kind) {
                assert_row(&row, kind, fault);
                flights += 1;
            }
        }
    }
    assert!(flights > 0, "docs/faults.md has no row with `{kind}`");
}

fn assert_row(row: &Row, kind: &str, fault: &str) {
    let start_s = if kind == "stuck" {
        STUCK_START_S
    } else {
        START_S
    };
    let line = format!("{start_s} {} {fault}", duration_s(kind, fault));
    let case = Case::new(SEED, Schedule::parse("test", &line).unwrap());
    let outcome = case.fly_pooled(&POOL, &firmware()).unwrap();
    let report = campaign::report(&case, &outcome);
    assert_eq!(report.failures, Vec::<String>::new(), "{fault}");

    let scheduled: ScheduledFault = case.schedule.faults[0];
    let (start_ns, end_ns) = (scheduled.start_ns, outcome.record.last.1);
    let from_ns = if scheduled.kind == FaultKind::CoreStall {
        scheduled.end_ns()
    } else {
        start_ns
    };
    let transcript: Vec<String> = outcome
        .uart_lines
        .iter()
        .filter(|line| line.text.starts_with('#'))
        .map(|line| format!("{:.3} {}", line.at_ns as f64 * 1e-9, line.text))
        .collect();
    // The campaign asks for one of the classes that the table has for the fault.
    let asked_for = scheduled.kind.counted();
    let is_in_table = asked_for.iter().any(|class| row.counted.contains(class));
    assert!(
        asked_for.is_empty() || is_in_table,
        "{fault}: {asked_for:?}"
    );
    let mut noticed_ms = None;
    for &class in &row.counted {
        let at_ns = counted_at_ns(&outcome, class, start_ns);
        let counted: Vec<_> = FaultClass::ALL
            .into_iter()
            .map(|class| (class.name(), counted_at_ns(&outcome, class, start_ns)))
            .filter(|(_, at_ns)| at_ns.is_some())
            .collect();
        assert!(
            at_ns.is_some(),
            "{fault} is not counted as {}, but as {counted:?}: {transcript:?}",
            class.name()
        );
        let after_ms = at_ns.map(|at_ns| at_ns.saturating_sub(from_ns) as f64 * 1e-6);
        noticed_ms = noticed_ms.or(after_ms);
    }
    assert_eq!(row.noticed_ms.is_some(), noticed_ms.is_some(), "{fault}");
    assert!(
        noticed_ms <= row.noticed_ms,
        "{fault}: noticed after {noticed_ms:?} ms"
    );

    let published = published(&outcome, start_ns, end_ns);
    for &flag in &row.flags {
        let is_seen = published.iter().any(|&(_, flags)| flags.contains(flag));
        assert!(is_seen, "{fault}: {flag} is not seen");
    }
    if let Some(most) = row.most_lost {
        assert_lost(&outcome, &published, most, fault);
    }
    for message in &row.messages {
        assert!(
            outcome.uart_reports(message),
            "{fault}: not reported: `{message}`: {transcript:?}"
        );
    }

    let back_ms = report.faults[0]
        .recovery_ns
        .map(|back_ns| back_ns as f64 * 1e-6);
    let is_in_time = row
        .back_ms
        .is_none_or(|due_ms| back_ms.is_some_and(|back_ms| back_ms <= due_ms));
    assert!(is_in_time, "{fault}: back after {back_ms:?} ms");
    println!("{fault}: noticed after {noticed_ms:?} ms, back after {back_ms:?} ms");
}

/// A test for each kind, and the list of them.
macro_rules! kinds {
    ($($test:ident: $kind:literal,)*) => {
        $(
            #[test]
            fn $test() {
                assert_kind($kind);
            }
        )*

        #[test]
        fn every_kind_has_its_test_and_every_row_its_kind() {
            let tested = BTreeSet::from([$($kind),*]);
            assert_eq!(tested, Schedule::kinds().collect());
            let rows = rows();
            let faults = rows.iter().flat_map(|row| &row.faults);
            let documented: BTreeSet<&str> =
                faults.filter_map(|fault| fault.split(':').next()).collect();
            assert_eq!(tested, documented);
        }
    };
}

kinds! {
    address_nack: "address-nack",
    data_nack: "data-nack",
    burst_stall: "burst-stall",
    sda_low: "sda-low",
    scl_low: "scl-low",
    bus_error: "bus-error",
    arbitration_lost: "arbitration-lost",
    dma_error: "dma-error",
    int_missing: "int-missing",
    int_high: "int-high",
    int_low: "int-low",
    int_glitch: "int-glitch",
    sensor_silent: "sensor-silent",
    sensor_brownout: "sensor-brownout",
    register_flip: "register-flip",
    frozen: "frozen",
    zeros: "zeros",
    ones: "ones",
    saturated: "saturated",
    temperature: "temperature",
    core_stall: "core-stall",
    attitude_late: "attitude-late",
    uart_flood: "uart-flood",
    uart_noise: "uart-noise",
    probe_detach: "probe-detach",
    crystal_dies: "crystal-dies",
    watchdog_hang: "watchdog-hang",
    crash: "crash",
    stack_overflow: "stack-overflow",
    compass_silent: "compass-silent",
    compass_frozen: "compass-frozen",
    compass_zeros: "compass-zeros",
    compass_overflow: "compass-overflow",
    compass_garbled: "compass-garbled",
    compass_never_ready: "compass-never-ready",
    compass_identity: "compass-identity",
    compass_stall: "compass-stall",
    supply_sag: "supply-sag",
    stuck: "stuck",
}

/// A run at rest with these faults, for rules that the table does not have.
fn fly(schedule: &str, seconds: f64) -> Outcome {
    fly_with(pooled_run(), schedule, seconds)
}

/// As [`fly`], with this processor.
fn fly_with(run: Run, schedule: &str, seconds: f64) -> Outcome {
    let schedule = Schedule::parse("test", schedule).unwrap();
    run.without_account()
        .seconds(seconds)
        .motion(Rest::level())
        .schedule(&schedule)
        .without_probe()
        .run()
        .unwrap()
}

#[test]
fn sigma_grows_while_nothing_comes() {
    let outcome = fly("2.0 0.5 sensor-silent", 3.0);
    let sigmas: Vec<f32> = outcome
        .record
        .stale
        .iter()
        .map(|stale| stale.snapshot.tilt_sigma_rad())
        .collect();
    assert!(sigmas.len() > 80, "every 5 ms: {}", sigmas.len());
    assert!(sigmas.windows(2).all(|pair| pair[0] <= pair[1]));
    // 30 °/s per axis for half a second.
    let last = sigmas.last().copied().unwrap_or(0.0).to_degrees();
    assert!((19.0..23.0).contains(&last), "{last}");
}

#[test]
fn without_edges_the_attitude_goes_on_by_timer() {
    for fault in ["int-missing", "int-low", "int-high"] {
        let outcome = fly(&format!("2.0 0.2 {fault}"), 2.4);
        let polled: Vec<u64> = outcome
            .samples()
            .iter()
            .filter(|sample| sample.snapshot.flags.contains(Flags::POLLED | Flags::VALID))
            .map(|sample| sample.published_ns)
            .collect();
        let first = polled.first().copied().unwrap_or(u64::MAX);
        assert!(first < 2_005_000_000, "{fault}: {first}");
        assert!(polled.len() > 170, "{fault}: {}", polled.len());
        let last = polled.last().copied().unwrap_or(0);
        assert!(last < 2_205_000_000, "{fault}: {last}");
    }
}

#[test]
fn after_the_crystal_has_died_time_goes_on_at_its_old_pace() {
    let outcome = fly("2.0 0 crystal-dies", 2.5);
    let last = outcome.samples().last().expect("samples").snapshot.flags;
    assert_eq!(last, Flags::VALID | Flags::DEGRADED | Flags::INTERNAL_CLOCK);
    // A sample is a millisecond of the sensor's clock, which is right to 1 %.
    let times: Vec<u64> = outcome
        .samples()
        .iter()
        .filter(|sample| sample.published_ns > 2_100_000_000)
        .map(|sample| sample.snapshot.t_us)
        .collect();
    assert!(times.len() > 350);
    let is_even = |pair: &[u64]| (980..1020).contains(&(pair[1] - pair[0]));
    assert!(times.windows(2).all(is_even));
}

#[test]
fn after_a_reset_the_attitude_goes_on_without_a_new_rest() {
    for fault in ["watchdog-hang", "crash", "stack-overflow"] {
        // With the memory protection unit, which guards the stack.
        let run = Run::new(firmware());
        let outcome = fly_with(run, &format!("2.0 0 {fault}"), 2.8);
        let [reset_ns] = outcome.record.resets_ns[..] else {
            panic!("{fault}: {:?}", outcome.record.resets_ns);
        };
        let mut after = outcome.samples().iter();
        let first = after
            .find(|sample| {
                sample.published_ns > reset_ns && sample.snapshot.flags.contains(Flags::VALID)
            })
            .expect("an attitude");
        let after_ms = (first.published_ns - reset_ns) as f64 * 1e-6;
        assert!(after_ms < 60.0, "{fault}: {after_ms} ms");
        let is_calibrating = |flags: Flags| flags.contains(Flags::CALIBRATING);
        assert!(
            after.all(|sample| !is_calibrating(sample.snapshot.flags)),
            "{fault}"
        );
        // The counters of the run before are still there.
        let last = outcome.record.health.last().expect("a reading");
        let class = FaultClass::ALL
            .into_iter()
            .find(|class| fault.starts_with(class.name()));
        assert_eq!(
            last.counters[class.expect("its class") as usize],
            1,
            "{fault}"
        );
    }
}

#[test]
fn a_reset_leaves_an_armed_module_armed_until_power_is_lost() {
    let hang = "2.0 0 watchdog-hang";
    for (commands, faults, is_armed) in [
        (&["arm"][..], hang, true),
        (&["arm"], "2.0 0 crash\n2.6 0 watchdog-hang", true),
        (&["arm", "disarm"], hang, false),
        (&[], hang, false),
        (&["arm"], "2.0 0.05 supply-sag:800", false),
    ] {
        let schedule = Schedule::parse("test", faults).unwrap();
        let mut run = pooled_run()
            .motion(Rest::level())
            .seconds(5.5)
            .schedule(&schedule);
        for (at_s, command) in [1.6, 1.8].into_iter().zip(commands) {
            run = run.command(at_s, command);
        }
        let outcome = run.command(5.0, "status").command(5.2, "save").run();
        let outcome = outcome.unwrap();
        let case = format!("{commands:?}, {faults:?}");
        assert!(!outcome.record.resets_ns.is_empty(), "{case}");
        assert_eq!(outcome.uart_reports("armed=yes"), is_armed, "{case}");
        assert_eq!(outcome.uart_reports("armed=no"), !is_armed, "{case}");
        let is_refused = outcome.uart_reports("error refused while armed");
        assert_eq!(is_refused, is_armed, "{case}");
        // A rest confirms the bias, unless the filter is armed.
        let last = outcome.samples().last().expect("samples").snapshot.flags;
        assert!(last.contains(Flags::VALID), "{case}: {last:?}");
        assert_eq!(last.contains(Flags::DEGRADED), is_armed, "{case}: {last:?}");
    }
}

/// A debugger resets the chip as the firmware itself does after a crash. But the new run may be
/// that of other firmware, on a bench.
#[test]
fn a_debugger_disarms_and_ends_the_attitude() {
    let reset = ScheduledFault {
        kind: FaultKind::DebuggerReset,
        start_ns: 2_000_000_000,
        duration_ns: 0,
    };
    let outcome = pooled_run()
        .motion(Rest::level())
        .seconds(3.0)
        .fault(Fault::Scheduled(reset))
        .command(1.8, "arm")
        .command(2.8, "status")
        .run()
        .unwrap();
    assert_eq!(outcome.record.resets_ns.len(), 1);
    assert!(outcome.uart_reports("the reset pin or a debugger"));
    assert!(outcome.uart_reports("armed=no"));
    let samples = outcome.samples().iter();
    let mut after = samples.filter(|sample| sample.published_ns > 2_050_000_000);
    let first = after.next().expect("samples").snapshot.flags;
    assert!(!first.contains(Flags::VALID), "{first:?}");
}

/// While no samples come, or none is a measurement, the attitude grows old. A reset must not make
/// it young again.
#[test]
fn a_reset_beside_a_long_silence_takes_the_tilt_from_gravity() {
    for faults in [
        "2.0 2.0 sensor-silent\n3.98 0 crash",
        "2.0 2.0 sensor-silent\n2.1 0 crash",
        "2.0 2.0 zeros\n2.1 0 crash",
        "2.0 2.0 frozen\n2.1 0 crash",
        "2.0 2.0 dma-error\n2.1 0 crash",
    ] {
        let rolled = Quaternion::from_euler(1.0, 0.0, 0.0);
        let outcome = pooled_run()
            .motion(Poses::new(&[(2.3, rolled)]))
            .schedule(&Schedule::parse("test", faults).unwrap())
            .seconds(4.6)
            .run()
            .unwrap();
        let mut valid = 0;
        for sample in outcome.samples() {
            let snapshot = sample.snapshot;
            if sample.published_ns < 3_900_000_000 || !snapshot.flags.contains(Flags::VALID) {
                continue;
            }
            let aplomb::attitude::Quaternion { w, x, y, z } = snapshot.attitude;
            let [w, x, y, z] = [w, x, y, z].map(f64::from);
            let truth = sample.edge.and_then(|edge| edge.truth.attitude);
            let error_rad = inclination_error_rad(Quaternion { w, x, y, z }, truth.unwrap());
            assert!(error_rad < 0.1, "{faults}: {error_rad}");
            valid += 1;
        }
        assert!(valid > 250, "{faults}: {valid}");
    }
}

/// A crash keeps what was not saved: other axes would turn the attitude by 180°.
#[test]
fn a_reset_keeps_settings_that_are_not_saved() {
    let outcome = pooled_run()
        .motion(Rest::level())
        .schedule(&Schedule::parse("test", "2.5 0 crash").unwrap())
        .command(1.0, "mount z-down\nrate 20")
        .command(3.2, "show\nsave")
        .seconds(5.5)
        .run()
        .unwrap();
    let is_upside_down =
        |quaternion: aplomb::attitude::Quaternion| quaternion.to_euler().roll_rad.abs() > 3.0;
    let mut valid = 0;
    for sample in outcome.samples() {
        let snapshot = sample.snapshot;
        if sample.published_ns > 2_000_000_000 && snapshot.flags.contains(Flags::VALID) {
            assert!(is_upside_down(snapshot.attitude), "{}", sample.published_ns);
            valid += 1;
        }
    }
    assert!(valid > 2_000, "{valid}");
    let lines = outcome.uart_lines.iter();
    let log: Vec<_> = lines
        .map(|line| &line.text)
        .filter(|line| !line.contains("roll:"))
        .collect();
    for text in ["mount=+x+z", "rate=20", "done save: stored"] {
        let is_shown = log.iter().any(|line| line.contains(text));
        assert!(is_shown, "{text}: {log:#?}");
    }
}

#[test]
fn a_fault_right_after_a_warm_start_is_reported() {
    let outcome = fly("2.0 0 crash\n2.1 0.02 sda-low", 2.5);
    let reports = outcome.uart_lines.iter().filter(|line| {
        line.at_ns > 2_100_000_000
            && line
                .text
                .contains("setting the bus and the sensor up again")
    });
    assert_eq!(reports.count(), 1);
}

/// Edges that return may come just after the STOP of a burst that the timer has started. A START
/// written then sticks.
#[test]
fn edges_that_return_at_any_time_leave_the_bus_alone() {
    let mut random = 1_u32;
    let mut uniform = |low: u32, high: u32| {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        low + (random >> 8) % (high - low)
    };
    let mut at_us = 2_000_000;
    let mut schedule = String::new();
    for _ in 0..600 {
        let missing_us = uniform(5_000, 12_000);
        let (start_s, duration_s) = (f64::from(at_us) * 1e-6, f64::from(missing_us) * 1e-6);
        schedule += &format!("{start_s} {duration_s} int-missing\n");
        at_us += missing_us + uniform(5_000, 8_000);
    }
    let outcome = fly(&schedule, f64::from(at_us) * 1e-6);
    assert_eq!(
        reports(&outcome, "the bus"),
        [""; 0],
        "{:#?}",
        reports(&outcome, "# ")
    );
}

/// A stall that begins between two bursts hides edges as one that interrupts a burst does.
#[test]
fn samples_that_a_stall_hides_are_flagged_whatever_its_phase() {
    let mut schedule = String::new();
    for stall in 0..10 {
        let start_s = 2.0 + 0.0601 * f64::from(stall);
        schedule += &format!("{start_s} 0.0075 core-stall\n");
    }
    let outcome = fly(&schedule, 2.8);
    let samples = outcome.samples().iter().filter_map(|sample| {
        let is_missed = sample.snapshot.flags.contains(Flags::MISSED);
        sample.edge.map(|edge| (edge.index, is_missed))
    });
    let samples: Vec<_> = samples.collect();
    let mut gaps = 0;
    // The first sample follows no other.
    assert!(samples.first().is_some_and(|(_, is_missed)| !is_missed));
    for pair in samples.windows(2) {
        let [(before, _), (index, is_missed)] = [pair[0], pair[1]];
        assert_eq!(is_missed, index > before + 1, "{before}, {index}");
        gaps += u32::from(is_missed);
    }
    assert!(gaps >= 10, "{gaps}");
}

/// Returns the lines from 1 s on with this text.
fn reports<'a>(outcome: &'a Outcome, text: &str) -> Vec<&'a str> {
    let lines = outcome.uart_lines.iter();
    lines
        .filter(|line| line.at_ns > 1_000_000_000 && line.text.contains(text))
        .map(|line| line.text.as_str())
        .collect()
}

#[test]
fn a_save_cuts_off_no_burst_and_makes_no_second_recovery() {
    let save = |faults: &str| {
        pooled_run()
            .motion(Rest::level())
            .schedule(&Schedule::parse("test", faults).unwrap())
            .command(1.0, "mount z-down")
            .command(2.7, "save")
            .seconds(5.0)
            .run()
            .unwrap()
    };
    let polled = save("1.5 9 int-missing");
    assert_eq!(reports(&polled, "the bus"), [""; 0]);
    assert_eq!(reports(&polled, "stored").len(), 1);
    for stall in ["2.7095", "2.7100"] {
        let stalled = save(&format!("{stall} 0.002 burst-stall"));
        let recoveries = reports(&stalled, "setting the bus and the sensor up again");
        assert!(recoveries.len() <= 1, "{recoveries:?}");
        assert_eq!(reports(&stalled, "stored").len(), 1);
    }
}

#[test]
fn a_bus_error_that_is_a_flag_alone_fails_no_self_test() {
    let outcome = pooled_run()
        .motion(Rest::level())
        .schedule(&Schedule::parse("test", "2.0 2.5 bus-error:flag").unwrap())
        .command(2.0, "self-test")
        .seconds(5.0)
        .run()
        .unwrap();
    assert_eq!(reports(&outcome, "failed self-test"), [""; 0]);
    assert_eq!(reports(&outcome, "done self-test").len(), 1);
}

#[test]
fn interrupts_at_8_khz_starve_nobody() {
    // First glitches all the time. Then the widest low-pass filter, whose output rate is 8 kHz, and
    // so is INT's. The firmware restores the filter, which takes 35 ms without samples.
    let flips = "2.0 0 register-flip:0x1a:0x00\n2.5 0 register-flip:0x1a:0x00";
    let undisturbed = fly("", 3.1);
    for (faults, least_glitches, least_samples, longest_ns) in [
        ("2.0 1.0 int-glitch:8000", 7_900, 998, 2_100_000),
        (flips, 50, 910, 45_000_000),
    ] {
        let outcome = fly(faults, 3.1);
        let during = 2_000_000_000..3_000_000_000;
        let health = |at_ns: u64| {
            let readings = outcome.record.health.iter();
            let last = readings.take_while(|reading| reading.at_ns <= at_ns).last();
            last.expect("a reading").counters
        };
        let (before, after) = (health(during.start), health(during.end));
        let counted = |class: FaultClass| after[class as usize] - before[class as usize];
        let glitches = counted(FaultClass::InterruptGlitch);
        assert!(glitches >= least_glitches, "{faults}: {glitches}");
        assert_eq!(counted(FaultClass::AttitudeLate), 0, "{faults}");
        assert_eq!(counted(FaultClass::TelemetryLate), 0, "{faults}");
        assert!(outcome.record.resets_ns.is_empty(), "{faults}");
        let lines = |outcome: &Outcome| {
            let lines = outcome.uart_lines.iter();
            let lines = lines.filter(|line| line.text.starts_with("roll:"));
            lines.filter(|line| during.contains(&line.at_ns)).count()
        };
        assert_eq!(lines(&outcome), lines(&undisturbed), "{faults}");
        let samples: Vec<u64> = outcome
            .samples()
            .iter()
            .filter(|sample| during.contains(&sample.published_ns))
            .map(|sample| sample.published_ns)
            .collect();
        assert!(
            samples.len() >= least_samples,
            "{faults}: {}",
            samples.len()
        );
        let gap_ns = samples.windows(2).map(|pair| pair[1] - pair[0]).max();
        assert!(
            gap_ns.is_some_and(|it| it <= longest_ns),
            "{faults}: {gap_ns:?}"
        );
    }
}

/// Changes a case beyond its seed, faults and watchdog.
type Course = fn(Case) -> Case;

fn plain(case: Case) -> Case {
    case
}

/// A flight of 20 s.
fn long(case: Case) -> Case {
    let seconds = 20.0;
    Case { seconds, ..case }
}

/// A start in motion.
fn moving(case: Case) -> Case {
    let moving_s = 2.0;
    Case { moving_s, ..case }
}

fn by_internal_oscillator(mut case: Case, error: f64) -> Case {
    case.conditions.internal_error = error;
    case
}

fn without_crystal(mut case: Case, error: f64) -> Case {
    case.conditions.lacks_crystal = true;
    by_internal_oscillator(case, error)
}

/// A flight with a save, which takes 1.3 s.
fn saving(mut case: Case, save_s: f64) -> Case {
    case.conditions.save_s = Some(save_s);
    case.seconds = case.seconds.max(save_s + 1.3);
    case
}

/// Flights of campaigns that broke a rule, each by another flaw: seed of motion and kit, frequency
/// of the watchdog in Hz, course, faults, and the flaw.
///
/// A seed draws the same flight, until a kind of fault is added to those that seeds draw.
const ONCE_FAILED: [(u64, u64, Course, &str, &str); 23] = [
    (
        160_000_236,
        37_047,
        plain,
        "1.82518 0 watchdog-hang\n",
        "corrections after a reset counted as a changed bias",
    ),
    (
        160_001_523,
        38_794,
        plain,
        "1.787423 0.008045 saturated:gy\n2.297487 0.995394 compass-zeros\n",
        "corrections after false full-scale readings counted as a changed bias",
    ),
    (
        160_004_010,
        40_939,
        long,
        "7.856856 0 watchdog-hang\n",
        "a warm start took the vehicle for one that stays in place",
    ),
    (
        200_000_862,
        25_888,
        long,
        "3.991758 0 watchdog-hang\n",
        "a gate that closed before the corrections after a reset had ended",
    ),
    (
        160_000_542,
        32_312,
        moving,
        "5.309871 0.015581 compass-stall\n",
        "turns counted for the heading before the bias was known",
    ),
    (
        160_002_857,
        28_847,
        plain,
        "1.728188 0.014938 core-stall\n1.731902 0 sda-low:8:0x3b\n",
        "an event of the port that no step expected came again for ever",
    ),
    (
        160_004_083,
        25_325,
        |case| saving(by_internal_oscillator(case, 0.0368), 1.779_966),
        "1.857648 0.79074 supply-sag:2552\n1.860513 0.226667 crystal-dies\n",
        "the rules had no time for a crystal that dies in an erase",
    ),
    (
        170_000_102,
        24_475,
        |case| without_crystal(case, -0.0724),
        "1.830121 0.03403 sensor-brownout\n1.839031 0 crash\n",
        "the rules asked for telemetry while the sensor had no supply",
    ),
    (
        210_000_570,
        39_590,
        plain,
        "1.848324 0 sda-low:9:0x12\n1.863888 0.115747 sensor-brownout\n\
         2.437494 0 stack-overflow:16\n",
        "the first correction after a warm start was late",
    ),
    (
        220_017_794,
        39_201,
        plain,
        "1.814353 0.951813 compass-overflow\n3.219091 0.860871 compass-silent\n\
         4.473015 0 watchdog-hang\n",
        "a warm start took the vehicle for one that stays in place, because it had hovered",
    ),
    (
        240_000_666,
        28_581,
        |case| without_crystal(long(case), -0.0757),
        "7.705695 0.009854 saturated:gz\n",
        "a false full-scale reading turned the attitude, and an acceleration then set the tilt",
    ),
    (
        260_001_681,
        34_413,
        plain,
        "1.777396 0.178008 ones\n2.422536 0.805087 compass-frozen\n3.608962 0.016912 core-stall\n",
        "an edge that was pending when the reader was disabled started a burst, again and again",
    ),
    (
        260_001_505,
        26_212,
        long,
        "5.297775 0 watchdog-hang\n",
        "corrections of a kept tilt that was 39 degrees wrong counted as a changed bias",
    ),
    (
        260_002_048,
        38_074,
        moving,
        "5.305925 0 register-flip:0x1c:0x48\n5.741303 0.883544 compass-zeros\n\
         7.062904 0 watchdog-hang\n",
        "the correction by the first rest counted as a changed bias",
    ),
    (
        280_006_098,
        44_033,
        plain,
        "1.853315 0 register-flip:0x1b:0x47\n1.856599 0.377846 frozen\n",
        "the rate that frozen data repeated was integrated",
    ),
    (
        280_006_349,
        25_922,
        plain,
        "1.862873 0.013976 arbitration-lost\n1.877739 0.006498 core-stall\n",
        "a stalled transaction left ADDR set, and SR2 was read without SR1",
    ),
    (
        280_016_663,
        42_187,
        long,
        "2.658328 0.917945 compass-never-ready\n3.943818 0 watchdog-hang\n",
        "a correction of the tilt counted as a turn about a second axis, for the heading",
    ),
    (
        1_346,
        37_990,
        plain,
        "1.808143 0 register-flip:0x37:0xea\n2.270533 0.026512 int-missing\n\
         2.784981 0.007372 dma-error\n",
        "a changed setting had latched the pin, and after the repair nothing ended that",
    ),
    (
        40_222,
        35_254,
        plain,
        "1.837622 0 sda-low:7:0x73\n",
        "a burst whose end the sensor had not sent was valid, with rates wrong by 148 degrees/s",
    ),
    (
        700_001_648,
        40_547,
        |case| saving(case, 1.807_269),
        "1.988445 0.076712 supply-sag:1337\n4.612824 0.391342 ones\n\
         5.459229 0.009458 data-nack:0\n6.012004 0.760401 compass-zeros\n",
        "a pause counted as time at rest, and its one sample began the drift",
    ),
    (
        4_000_114,
        18_187,
        plain,
        "1.893657 0.00869 dma-error\n2.284728 0.014615 core-stall\n",
        "samples that were lost long after a recovery counted as lost before its first edge",
    ),
    (
        1_300_001_813,
        26_126,
        plain,
        "1.865825 0.022861 bus-error\n",
        "a burst whose last byte the sensor had not sent was valid",
    ),
    (
        1_400_000_601,
        45_943,
        plain,
        "1.773367 0 sda-low:7:0x3c\n",
        "a setting that was garbled on its way was counted in no class",
    ),
];

#[test]
fn flights_that_once_failed_pass() {
    for (seed, watchdog_hz, course, faults, flaw) in ONCE_FAILED {
        let mut case = Case::new(seed, Schedule::parse("test", faults).unwrap());
        case.conditions.watchdog_hz = watchdog_hz;
        let case = course(case);
        let outcome = case.fly_pooled(&POOL, &firmware()).unwrap();
        let failures = campaign::report(&case, &outcome).failures;
        assert_eq!(failures, Vec::<String>::new(), "{seed}: {flaw}");
    }
}

/// The phase of false edges to the real ones decides which of those is taken for a false one.
#[test]
fn false_edges_cost_one_sample_at_most() {
    for rate in [3_000, 8_000] {
        for eighth in 0..8 {
            let start_s = START_S + 0.000_125 * f64::from(eighth);
            let line = format!("{start_s:.6} 0.2 int-glitch:{rate}");
            let case = Case::new(SEED, Schedule::parse("test", &line).unwrap());
            let outcome = case.fly_pooled(&POOL, &firmware()).unwrap();
            let failures = campaign::report(&case, &outcome).failures;
            assert_eq!(failures, Vec::<String>::new(), "{line}");
            let start_ns = case.schedule.faults[0].start_ns;
            let published = published(&outcome, start_ns, outcome.record.last.1);
            assert_lost(&outcome, &published, 1, &line);
        }
    }
}
