//! Each class of faults is counted as what it is, and the attitude is valid again in time: one schedule for each.
//!
//! The campaign (`cargo xtask faults`) draws such schedules by chance; here they are fixed, and each test fails when
//! the firmware's detection of its class is taken out.

mod common;

use aplomb::fault::FaultClass;
use aplomb::health::Flags;
use common::firmware;
use virtual_board::flight::{Outcome, Run};
use virtual_board::motion::rest::Rest;
use virtual_board::schedule::Schedule;

/// When the faults begin, s: the attitude is valid by then.
const START_S: f64 = 2.0;

/// A run at rest with these faults.
fn fly(schedule: &str, seconds: f64) -> Outcome {
    let schedule = Schedule::parse("test", schedule).unwrap();
    Run::new(firmware())
        .seconds(seconds)
        .motion(Rest::level())
        .schedule(&schedule)
        .without_account()
        .without_probe()
        .run()
        .unwrap()
}

/// How often a class has been counted by the end.
fn counted(outcome: &Outcome, class: FaultClass) -> u32 {
    let last = outcome.record.health.last().expect("a reading");
    last.counters[class as usize]
}

/// The counters that are not zero, for a failing test.
fn counters(outcome: &Outcome) -> Vec<(&'static str, u32)> {
    FaultClass::ALL
        .into_iter()
        .map(|class| (class.name(), counted(outcome, class)))
        .filter(|&(_, count)| count > 0)
        .collect()
}

/// Flies one fault for `duration_s` and holds the firmware to counting it as `class` and to a valid attitude, and
/// nothing but valid ones, from `deadline_ms` after its end on.
#[track_caller]
fn assert_recovers(fault: &str, duration_s: f64, class: FaultClass, deadline_ms: f64) -> Outcome {
    let outcome = fly(&format!("{START_S} {duration_s} {fault}"), 3.0);
    assert!(
        counted(&outcome, class) > 0,
        "{fault} is not counted as {}: {:?}",
        class.name(),
        counters(&outcome)
    );
    let due_ns = ((START_S + duration_s) * 1e9 + deadline_ms * 1e6) as u64;
    let late: Vec<_> = outcome
        .samples()
        .iter()
        .filter(|sample| sample.published_ns > due_ns)
        .collect();
    let invalid = late
        .iter()
        .filter(|sample| !sample.snapshot.flags.contains(Flags::VALID))
        .count();
    let expected = (3.0e9 - due_ns as f64) / 1.02e6;
    assert!(
        invalid == 0 && late.len() as f64 > expected,
        "{fault}: {invalid} of {} samples are not valid, expected {expected:.0}: {:?}",
        late.len(),
        counters(&outcome)
    );
    outcome
}

/// Deadlines after the end of a fault of the bus, and of what the sensor forgets, ms.
const BUS_MS: f64 = 20.0;
const RESET_MS: f64 = 250.0;

#[test]
fn the_bus() {
    for (fault, class) in [
        ("address-nack", FaultClass::AddressNotAcknowledged),
        ("address-nack:read", FaultClass::AddressNotAcknowledged),
        ("data-nack:0", FaultClass::DataNotAcknowledged),
        ("burst-stall", FaultClass::BurstDeadline),
        ("sda-low", FaultClass::DataLineLow),
        ("scl-low", FaultClass::ClockLineLow),
        ("bus-error", FaultClass::BusError),
        ("arbitration-lost", FaultClass::ArbitrationLost),
        ("dma-error", FaultClass::Dma),
        ("sensor-silent", FaultClass::SensorSilent),
    ] {
        let outcome = assert_recovers(fault, 0.05, class, BUS_MS);
        // It says so while it lasts: something is published every 10 ms, and none of it is taken for a sample.
        let during = 2_005_000_000..2_050_000_000;
        let said = outcome.record.stale.iter();
        let said = said.filter(|stale| during.contains(&stale.published_ns));
        let is_retried = matches!(class, FaultClass::Dma);
        assert!(is_retried || said.count() >= 4, "{fault}");
    }
}

#[test]
fn sigma_grows_while_nothing_comes() {
    let outcome = fly("2.0 0.5 sensor-silent", 3.0);
    let sigmas: Vec<f64> = outcome
        .record
        .stale
        .iter()
        .filter_map(|stale| stale.tilt_sigma_rad)
        .collect();
    assert!(sigmas.len() > 80);
    assert!(sigmas.windows(2).all(|pair| pair[0] <= pair[1]));
    // 30 °/s per axis for half a second.
    let last = sigmas.last().copied().unwrap_or(0.0).to_degrees();
    assert!((19.0..23.0).contains(&last), "{last}");
}

#[test]
fn the_interrupt_wire() {
    for (fault, class) in [
        ("int-missing", FaultClass::InterruptMissing),
        ("int-low", FaultClass::InterruptMissing),
        ("int-high", FaultClass::InterruptStuckHigh),
    ] {
        let outcome = assert_recovers(fault, 0.2, class, BUS_MS);
        // Noticed within 3 ms, and the attitude goes on by timer.
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
    assert_recovers("int-glitch:3000", 0.2, FaultClass::InterruptGlitch, BUS_MS);
}

#[test]
fn the_sensor_forgets() {
    let outcome = assert_recovers("sensor-brownout", 0.05, FaultClass::SensorReset, RESET_MS);
    let flagged = outcome
        .samples()
        .iter()
        .any(|sample| sample.snapshot.flags.contains(Flags::SENSOR_RESET));
    assert!(flagged);
    for register in [
        "0x19:0x07",
        "0x1a:0x03",
        "0x1b:0x00",
        "0x1c:0x00",
        "0x37:0x80",
        "0x38:0x00",
        "0x6b:0x00",
        "0x6c:0x07",
    ] {
        let fault = format!("register-flip:{register}");
        assert_recovers(&fault, 0.0, FaultClass::RegisterChanged, RESET_MS);
    }
}

#[test]
fn a_flood_of_interrupts_at_8_khz() {
    // The widest low-pass filter: its output rate is 8 kHz, and so is INT's.
    let outcome = assert_recovers(
        "register-flip:0x1a:0x00",
        0.0,
        FaultClass::RegisterChanged,
        RESET_MS,
    );
    assert!(counted(&outcome, FaultClass::InterruptGlitch) > 30);
    assert_eq!(counted(&outcome, FaultClass::AttitudeLate), 0);
}

#[test]
fn the_data() {
    for (fault, class) in [
        ("frozen", FaultClass::Frozen),
        ("zeros", FaultClass::Rejected),
        ("ones", FaultClass::Rejected),
        ("saturated:gx", FaultClass::Saturated),
        ("saturated:az", FaultClass::Saturated),
        ("temperature:120", FaultClass::Temperature),
        ("temperature:-50", FaultClass::Temperature),
    ] {
        assert_recovers(fault, 0.1, class, RESET_MS);
    }
}

#[test]
fn the_core_stalls() {
    assert_recovers("core-stall", 0.03, FaultClass::SamplesMissed, BUS_MS);
}

#[test]
fn the_crystal_dies() {
    let outcome = assert_recovers("crystal-dies", 0.0, FaultClass::ClockFailed, RESET_MS);
    let last = outcome.samples().last().expect("samples").snapshot.flags;
    let said = Flags::VALID | Flags::DEGRADED | Flags::INTERNAL_CLOCK;
    assert_eq!(last, said);
    // Time goes on at its old pace: a sample is a millisecond of the sensor's clock, which is right to 1 %.
    let times: Vec<u64> = outcome
        .samples()
        .iter()
        .filter(|sample| sample.published_ns > 2_100_000_000)
        .map(|sample| sample.snapshot.t_us)
        .collect();
    assert!(
        times
            .windows(2)
            .all(|pair| (980..1020).contains(&(pair[1] - pair[0])))
    );
}

#[test]
fn the_watchdog_resets_what_hangs_and_the_attitude_goes_on() {
    let schedule = format!("{START_S} 0 watchdog-hang");
    let outcome = fly(&schedule, 3.0);
    assert_eq!(outcome.record.resets_ns.len(), 1);
    let reset_ns = outcome.record.resets_ns[0];
    assert!(
        (2_150_000_000..2_600_000_000).contains(&reset_ns),
        "{reset_ns}"
    );
    assert_eq!(counted(&outcome, FaultClass::Watchdog), 1);
    assert!(outcome.uart_says("reset by the watchdog"));
    // A warm start: no rest, no reset of the sensor, and yaw as it was.
    let first = outcome
        .samples()
        .iter()
        .find(|sample| {
            sample.published_ns > reset_ns && sample.snapshot.flags.contains(Flags::VALID)
        })
        .expect("an attitude");
    let after_ms = (first.published_ns - reset_ns) as f64 * 1e-6;
    assert!(after_ms < 60.0, "{after_ms} ms");
    assert!(!first.snapshot.flags.contains(Flags::CALIBRATING));
}
