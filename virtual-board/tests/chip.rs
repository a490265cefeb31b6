//! The chip's behaviours that a forgiving model hides. docs/chip.md has the table of them.

mod common;

use aplomb::fault::{FaultClass, ResetCause};
use aplomb::health::Flags;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::bursts;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::swing::Swing;
use aplomb_models::motion::{Quaternion, inclination_error_rad};
use common::{firmware, pooled_run};
use virtual_board::faults::Fault;
use virtual_board::flight::{Outcome, Run};
use virtual_board::kit::Kit;
use virtual_board::outputs;
use virtual_board::schedule::Schedule;
use virtual_board::summary::larger;

fn fly(seconds: f64, schedule: &str) -> Outcome {
    let schedule = Schedule::parse("test", schedule).unwrap();
    let run = pooled_run().seconds(seconds).schedule(&schedule);
    run.run().unwrap()
}

/// The ends of the transfers after this time, ns.
fn ends_of_bursts(outcome: &Outcome, from_ns: u64) -> Vec<u64> {
    let samples = outcome.samples().iter();
    let ends_ns = samples.map(|sample| sample.burst.completed_ns);
    ends_ns.filter(|&end_ns| end_ns > from_ns).collect()
}

/// The number of samples whose attitude does not follow from the bytes that the bus delivered.
fn samples_of_other_bytes(outcome: &Outcome) -> usize {
    let mut file = Vec::new();
    outputs::write_bursts(&mut file, outcome.samples()).unwrap();
    let text = String::from_utf8(file).unwrap();
    let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
    let lines = text.lines().skip(1);
    lines
        .zip(outcome.samples())
        .filter(|(line, sample)| {
            let row = bursts::decode(line).unwrap();
            let replayed = pipeline.update(&row.burst, row.board).attitude;
            let flown = sample.snapshot.attitude;
            let bits = |q: aplomb::attitude::Quaternion| [q.w, q.x, q.y, q.z].map(f32::to_bits);
            bits(replayed) != bits(flown)
        })
        .count()
}

#[test]
fn a_core_that_stalls_when_the_transfer_is_complete_never_shifts_a_burst() {
    const FROM_NS: u64 = 1_500_000_000;
    let calm = fly(2.1, "");
    assert_eq!(samples_of_other_bytes(&calm), 0);
    // Every other burst: a stall of 2 to 60 us, from 1 us before the end of the transfer.
    let ends_ns = ends_of_bursts(&calm, FROM_NS).into_iter();
    let stalls: Vec<String> = (0_u64..)
        .zip(ends_ns.step_by(4))
        .map(|(nth, end_ns)| {
            let start_ns = end_ns - 1_000;
            let stall_ns = 3_000 + 500 * (nth % 116);
            format!(
                "{} {} core-stall",
                start_ns as f64 * 1e-9,
                stall_ns as f64 * 1e-9
            )
        })
        .collect();
    assert!(stalls.len() > 116, "each length: {}", stalls.len());
    let stalled = fly(2.1, &stalls.join("\n"));
    assert_eq!(
        samples_of_other_bytes(&stalled),
        0,
        "attitudes from other bytes"
    );
    assert_eq!(stalled.samples().len(), calm.samples().len(), "samples");
    let failures = stalled.record.health.last().map(|reading| reading.counters);
    assert_eq!(
        failures,
        calm.record.health.last().map(|reading| reading.counters)
    );
    // A late STOP is no held bus.
    assert_eq!(samples_of_other_flags(&stalled, &calm), 0);
}

/// The number of samples whose flags differ from those of the other flight.
fn samples_of_other_flags(outcome: &Outcome, other: &Outcome) -> usize {
    assert_eq!(outcome.samples().len(), other.samples().len(), "samples");
    let pairs = outcome.samples().iter().zip(other.samples());
    let differing = pairs.filter(|(one, other)| one.snapshot.flags != other.snapshot.flags);
    differing.count()
}

#[test]
fn a_port_that_leaves_no_time_for_stop_costs_no_sample() {
    let [calm, hasty] = [None, Some(Fault::NoTimeForStop)].map(|fault| {
        let run = pooled_run().seconds(2.5);
        let run = fault.into_iter().fold(run, Run::fault);
        run.run().unwrap()
    });
    assert_eq!(hasty.issues, Vec::<String>::new());
    assert_eq!(samples_of_other_bytes(&hasty), 0, "bytes after the NACK");
    assert_eq!(samples_of_other_flags(&hasty, &calm), 0);
    assert_eq!(hasty.summary.missed, 0);
}

#[test]
fn a_stall_over_the_deadline_of_a_burst_needs_no_recovery() {
    let calm = fly(2.2, "");
    let ends_ns = ends_of_bursts(&calm, 1_500_000_000);
    // From 200 us before the end of the transfer to 400 us after it and more: the interrupts of the
    // transfer and of the alarm are both pending then.
    let stalls: Vec<String> = (0_u64..)
        .zip(ends_ns.iter().step_by(30))
        .map(|(nth, &end_ns)| {
            let (start_s, stall_us) = ((end_ns - 200_000) as f64 * 1e-9, 560 + 20 * nth);
            format!("{start_s} {} core-stall", stall_us as f64 * 1e-6)
        })
        .collect();
    assert!(stalls.len() > 20, "up to 960 us: {}", stalls.len());
    let stalled = fly(2.2, &stalls.join("\n"));
    assert_eq!(samples_of_other_bytes(&stalled), 0);
    assert!(!stalled.reports("setting the bus and the sensor up again"));
}

#[test]
fn a_late_attitude_delays_no_burst() {
    let calm = fly(3.0, "");
    let ends_ns = ends_of_bursts(&calm, 1_500_000_000);
    // The stall begins behind the transfer's interrupt. Each length lasts for a round of checks.
    let stalls: Vec<String> = (0_u64..)
        .zip(&ends_ns)
        .map(|(nth, &end_ns)| {
            let (start_s, stall_us) = ((end_ns + 5_000) as f64 * 1e-9, 400 + nth / 44);
            format!("{start_s} {} core-stall", stall_us as f64 * 1e-6)
        })
        .collect();
    assert!(stalls.len() > 44 * 30, "up to 430 us: {}", stalls.len());
    let stalled = fly(3.0, &stalls.join("\n"));
    assert_eq!(samples_of_other_bytes(&stalled), 0);
    assert!(!stalled.reports("setting the bus and the sensor up again"));
    let bytes = |sample: &virtual_board::recorder::Sample| sample.burst.bytes;
    let repeated = stalled.samples().windows(2);
    let repeated = repeated.filter(|pair| bytes(&pair[0]) == bytes(&pair[1]));
    assert_eq!(repeated.count(), 0, "samples of the edge before");
}

#[test]
fn a_reset_within_a_write_writes_nothing_to_the_sensor() {
    // The sensor has acknowledged its address, and takes the next clocks for a byte.
    let calm = fly(1.6, "");
    let last = calm.samples().last().expect("a sample");
    let edge_ns = last.burst.completed_ns - 384_000;
    let crashes: Vec<String> = (0..12)
        .map(|nth| {
            let at_ns = edge_ns + 500_000_000 * nth + 5_000 * nth + 25_000;
            format!("{} 0 crash", at_ns as f64 * 1e-9)
        })
        .collect();
    let outcome = fly(8.0, &crashes.join("\n"));
    assert!(outcome.record.writes_left > 0, "no crash came in a write");
    assert_eq!(outcome.record.bytes_by_hand, 0);
}

#[test]
fn a_sensor_in_the_middle_of_a_byte_is_freed_at_the_first_try() {
    // Every rest of a byte that begins with a zero. At least eight faults, each at another phase of
    // the samples: the clocks of a burst that is under way may end the rest at once.
    const PERIOD_S: f64 = 0.0203;
    let mut failed = Vec::new();
    for clocks in 1_u32..=8 {
        let different = 1_u32 << (clocks - 1);
        let rests: Vec<u32> = (0..different.max(8)).map(|nth| nth % different).collect();
        let line = |(nth, rest): (usize, &u32)| {
            let bits = rest << (8 - clocks);
            let start_s = 1.5 + PERIOD_S * nth as f64;
            format!("{start_s:.4} 0 sda-low:{clocks}:{bits:#04x}")
        };
        let lines: Vec<String> = rests.iter().enumerate().map(line).collect();
        let outcome = fly(1.6 + PERIOD_S * rests.len() as f64, &lines.join("\n"));
        let counters = outcome.record.health.last().map(|reading| reading.counters);
        let held = counters.map_or(u32::MAX, |counters| {
            counters[FaultClass::DataLineLow as usize]
        });
        if held > 0 {
            failed.push(format!("{clocks} clocks: SDA stayed low {held} times"));
        }
        let resets = outcome.record.health.last().map_or(0, |reading| {
            reading.counters[FaultClass::BurstDeadline as usize]
        });
        assert!(resets > 0, "the line was never held");
    }
    assert_eq!(failed, Vec::<String>::new());
}

#[test]
fn a_bus_error_that_is_a_flag_alone_loses_no_sample() {
    let (calm, flagged) = (fly(2.1, ""), fly(2.1, "1.6 0.3 bus-error:flag"));
    let times = |outcome: &Outcome| -> Vec<u64> {
        let samples = outcome.samples().iter();
        samples.map(|sample| sample.snapshot.t_us).collect()
    };
    assert!(times(&calm) == times(&flagged), "samples are missing");
    let seen = |outcome: &Outcome| {
        let counters = outcome.record.health.last().map(|reading| reading.counters);
        counters.map_or(0, |counters| counters[FaultClass::BusError as usize])
    };
    assert_eq!(seen(&calm), 0);
    // Each byte of 300 bursts, but two flags may be one interrupt.
    assert!(seen(&flagged) > 300 * 10, "{}", seen(&flagged));
}

/// Flies by an internal oscillator that is off by a share, started without a crystal or with one
/// that dies in flight.
fn fly_by_internal_oscillator(error: f64, crystal_dies: &str) -> Outcome {
    let schedule = Schedule::parse("test", crystal_dies).unwrap();
    let mut run = pooled_run()
        .seconds(4.0)
        .fault(Fault::InternalOscillator(error))
        .schedule(&schedule)
        .motion(Swing::by_seed(2, 1.8));
    if crystal_dies.is_empty() {
        run = run.fault(Fault::NoCrystal);
    }
    run.run().unwrap()
}

/// The largest error of a valid tilt by the larger of 5° and six σ, of which it must be below 1.
/// NaN if one of them is no number.
fn worst_broken_promise(outcome: &Outcome) -> f64 {
    let ratios = outcome.samples().iter().filter_map(|sample| {
        let (snapshot, truth) = (sample.snapshot, sample.edge?.truth.attitude?);
        let q = snapshot.attitude;
        let [w, x, y, z] = [q.w, q.x, q.y, q.z].map(f64::from);
        let error_rad = inclination_error_rad(Quaternion { w, x, y, z }, truth);
        let six_sigma_rad = 6.0 * f64::from(snapshot.tilt_sigma_rad());
        let allowed_rad = larger(5_f64.to_radians(), six_sigma_rad);
        let is_valid = snapshot.flags.contains(Flags::VALID);
        is_valid.then_some(error_rad / allowed_rad)
    });
    ratios.fold(0.0, larger)
}

#[test]
fn an_internal_oscillator_at_its_limits_loses_no_edge() {
    for error in [-0.08, -0.04, 0.045] {
        for crystal_dies in ["", "2.5 0 crystal-dies"] {
            let outcome = fly_by_internal_oscillator(error, crystal_dies);
            let case = format!("{error} {crystal_dies}");
            let counters = outcome.record.health.last().map(|reading| reading.counters);
            let counters = counters.unwrap();
            let classes = [
                FaultClass::InterruptGlitch,
                FaultClass::InterruptMissing,
                FaultClass::InterruptStuckHigh,
            ];
            for class in classes {
                assert_eq!(counters[class as usize], 0, "{case}: {class:?}");
            }
            // The crystal's end may cost the sample of that moment.
            let missed = usize::from(!crystal_dies.is_empty());
            assert!(outcome.summary.missed <= missed, "{case}");
            let last = outcome.samples().last().unwrap().snapshot.flags;
            let expected = Flags::VALID | Flags::INTERNAL_CLOCK | Flags::DEGRADED;
            assert_eq!(last, expected, "{case}: {last}");
            let broken = worst_broken_promise(&outcome);
            assert!(broken < 1.0, "{case}: {broken}");
            // By the sensor's clock, the largest error is 2.03° to 2.07° at each limit. By the
            // oscillator alone it was 4.2° at -8 %.
            let largest = outcome.summary.inclination_max_deg.unwrap();
            assert!(largest < 2.2, "{case}: {largest}");
        }
    }
}

/// Saves, with the longest erase and without a reset, hangs at 3 s, and returns the flight and the
/// time from the hang to its reset, ms.
fn hang_after_a_save(run: Run, hz: u64) -> (Outcome, f64) {
    let run = run
        .fault(Fault::WatchdogClock(hz))
        .motion(Rest::level())
        .command(1.3, "rate 20")
        .command(1.4, "save");
    let schedule = Schedule::parse("test", "3.0 0 watchdog-hang").unwrap();
    let outcome = run.schedule(&schedule).seconds(4.0).run();
    let outcome = outcome.unwrap();
    assert!(outcome.uart_reports("stored"), "{:?}", outcome.uart_lines);
    let [reset_ns] = outcome.record.resets_ns[..] else {
        panic!("{hz} Hz: resets at {:?}", outcome.record.resets_ns);
    };
    (outcome, (reset_ns as f64 - 3.0e9) * 1e-6)
}

#[test]
fn the_watchdog_keeps_its_limits_at_both_ends_of_its_oscillator() {
    for (hz, latest_ms) in [(17_000, 600.0), (32_000, 350.0), (47_000, 250.0)] {
        let (_, after_ms) = hang_after_a_save(pooled_run(), hz);
        // The last feed may be a tick of 20 ms before the hang.
        assert!(
            (178.0..latest_ms).contains(&after_ms),
            "{hz}: {after_ms} ms"
        );
    }
}

/// A self-test keeps the short limit: the idle task reports progress in it.
#[test]
fn a_self_test_is_not_reset_by_the_fastest_watchdog() {
    let run = pooled_run()
        .kit(Kit::Mpu9250)
        .fault(Fault::WatchdogClock(47_000))
        .motion(Rest::level())
        .command(1.4, "self-test");
    let outcome = run.seconds(4.0).run().unwrap();
    assert!(outcome.uart_reports("passed"), "{:?}", outcome.uart_lines);
    assert_eq!(outcome.record.resets_ns, Vec::<u64>::new());
}

#[test]
fn a_save_is_not_reset_by_a_watchdog_that_takes_a_limit_late() {
    for hz in [17_000, 25_000, 32_000, 47_000] {
        let run = pooled_run().fault(Fault::SlowWatchdog);
        let (outcome, after_ms) = hang_after_a_save(run, hz);
        assert_eq!(outcome.issues.len(), 1, "{:?}", outcome.issues);
        // The short limit is back.
        assert!(after_ms < 600.0, "{hz} Hz: {after_ms} ms");
    }
}

#[test]
fn the_guard_below_the_stack_stops_an_overflow_before_the_bus_does() {
    // The exception that wakes the core finds no room, or its handler, or a function that it calls.
    for room_bytes in [0, 8, 24, 36, 76, 124, 220] {
        let overflow = format!("0.6 0 stack-overflow:{room_bytes}");
        let schedule = Schedule::parse("test", &overflow).unwrap();
        // With the memory protection unit, which is the guard.
        let run = Run::new(firmware()).seconds(0.8).schedule(&schedule);
        let outcome = run.without_account().run().unwrap();
        assert_eq!(outcome.record.resets_ns.len(), 1, "{room_bytes}");
        let is_reported = outcome.uart_reports("last fault: stack-overflow");
        assert!(is_reported, "{room_bytes}: {:?}", outcome.uart_lines);
        // A store that passes the guard comes to the bus, which has nothing there.
        let passed = |issue: &&String| issue.starts_with("no such address");
        let passed: Vec<&String> = outcome.issues.iter().filter(passed).collect();
        assert_eq!(passed, Vec::<&String>::new(), "{room_bytes}");
    }
}

#[test]
fn a_start_that_takes_time_delays_each_attitude_by_that_time() {
    let flight = || pooled_run().seconds(2.1);
    let [calm, slow] = [flight(), flight().fault(Fault::SlowStart)].map(|run| run.run().unwrap());
    assert_eq!(slow.samples().len(), calm.samples().len());
    assert_eq!(slow.summary.missed, 0);
    assert_eq!(slow.issues, Vec::<String>::new());
    let [calm_us, slow_us] = [calm, slow].map(|outcome| {
        let latency = outcome.summary.edge_to_attitude_us_mean;
        latency.expect("attitudes")
    });
    // A START and one in the transfer.
    let cost_us = slow_us - calm_us;
    assert!((1.7..1.9).contains(&cost_us), "{cost_us}");
}

#[test]
fn the_prefetch_is_off_on_revision_a_alone() {
    for revision in [0x1000, 0x1001, 0x100F] {
        let run = pooled_run().fault(Fault::ChipRevision(revision));
        let outcome = run.seconds(1.4).run().unwrap();
        assert_eq!(outcome.issues, Vec::<String>::new(), "{revision:#x}");
        let is_on = revision != 0x1000;
        assert_eq!(outcome.record.prefetches, is_on, "{revision:#x}");
    }
}

#[test]
fn the_first_set_up_of_the_pins_makes_no_edge() {
    let outcome = fly(0.5, "");
    // A START, nine clocks and a START for each try until the sensor has started, and no edge more.
    let [clocks, starts] = outcome.record.falls_by_hand;
    assert!(clocks > 0 && clocks.is_multiple_of(9), "{clocks}");
    assert_eq!(starts, 2 * clocks / 9);
    assert!(!outcome.samples().is_empty());
}

#[test]
fn random_ram_at_power_up_is_not_taken_for_an_earlier_run() {
    for seed in 1..=3 {
        let run = pooled_run().seed(seed).motion(Rest::level());
        let run = run.seconds(2.0).command(1.6, "status");
        let outcome = run.run().unwrap();
        assert_eq!(outcome.record.ram_power_ups, 1);
        let first = outcome.record.health.first().expect("a reading");
        assert_eq!(first.reset_cause, ResetCause::Power as u32, "seed {seed}");
        assert_eq!(first.counters, [0; FaultClass::COUNT], "seed {seed}");
        assert!(!outcome.reports("last fault"), "seed {seed}");
        assert!(outcome.uart_reports("armed=no"), "seed {seed}");
    }
}

#[test]
fn ram_that_survives_a_failure_of_the_supply_is_not_trusted() {
    for (millivolts, ram_power_ups) in [(1_500, 1), (800, 2)] {
        let faults = format!("1.7 0.003 address-nack\n2.0 0.05 supply-sag:{millivolts}");
        let run = pooled_run()
            .motion(Rest::level())
            .seconds(4.2)
            .schedule(&Schedule::parse("test", &faults).unwrap());
        let run = run.command(1.9, "arm").command(4.0, "status");
        let outcome = run.run().unwrap();
        assert_eq!(outcome.record.ram_power_ups, ram_power_ups);
        let health = &outcome.record.health;
        let before = health.iter().rfind(|reading| reading.at_ns < 2_000_000_000);
        let before = before.expect("a reading").counters;
        assert!(before[FaultClass::AddressNotAcknowledged as usize] > 0);
        // The counters that follow the power-up begin at zero.
        let after: Vec<_> = health
            .iter()
            .filter(|reading| reading.at_ns > 2_050_000_000)
            .collect();
        let begins_at_zero = after
            .iter()
            .any(|reading| reading.counters == [0; FaultClass::COUNT]);
        assert!(begins_at_zero, "{millivolts}: {after:?}");
        let last = after.last().expect("a reading");
        assert_eq!(last.reset_cause, ResetCause::Power as u32, "{millivolts}");
        assert!(!outcome.reports("last fault"), "{millivolts}");
        assert!(outcome.uart_reports("armed=no"), "{millivolts}");
    }
}
