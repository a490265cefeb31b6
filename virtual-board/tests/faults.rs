//! Every fault that shows from outside is reported on both outputs, UART and log, and is
//! recovered from.

mod common;

use aplomb::fault::FaultClass;
use aplomb::health::Flags;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::vibration::{Strength, Vibrating};
use common::pooled_run;
use virtual_board::faults::{BusByte, BusLine, Fault};
use virtual_board::flight::{Outcome, Run};
use virtual_board::kit::Kit;
use virtual_board::schedule::Schedule;

/// Makes a run that must be possible.
fn fly(run: Run) -> Outcome {
    run.run().unwrap()
}

/// A run at rest.
fn at_rest(seconds: f64) -> Run {
    pooled_run().seconds(seconds).motion(Rest::level())
}

/// All lines from the firmware, for the failing test's output.
fn transcript(outcome: &Outcome) -> String {
    let messages = outcome
        .uart_lines
        .iter()
        .filter(|line| line.text.starts_with('#'));
    messages
        .map(|line| format!("{:9.4} {}\n", line.at_ns as f64 * 1e-9, line.text))
        .collect()
}

#[track_caller]
fn assert_reports(outcome: &Outcome, text: &str) {
    assert!(
        outcome.uart_reports(text),
        "the UART does not report `{text}`:\n{}",
        transcript(outcome)
    );
    let log: Vec<&str> = outcome
        .log()
        .iter()
        .map(|line| line.text.as_str())
        .filter(|line| !line.contains("roll:"))
        .collect();
    assert!(
        outcome.reports(text),
        "the log does not report `{text}`:\n{}",
        log.join("\n")
    );
}

/// Holds the run to a sample for every millisecond of its last third of a second.
#[track_caller]
fn assert_recovered(outcome: &Outcome) {
    let end_ns = outcome.record.last.1;
    let late = outcome
        .samples()
        .iter()
        .filter(|sample| sample.published_ns > end_ns - 333_000_000)
        .count();
    assert!(
        (325..=340).contains(&late),
        "{late} samples at the end:\n{}",
        transcript(outcome)
    );
    assert!(outcome.issues.is_empty(), "{:?}", outcome.issues);
}

#[test]
fn sensor_absent_then_plugged_in() {
    let outcome = fly(at_rest(3.0).fault(Fault::SensorAbsent(0.0..1.5)));
    assert_reports(&outcome, "no sensor answers at 0x68 or 0x69");
    assert!(
        outcome
            .samples()
            .iter()
            .all(|sample| sample.published_ns > 1_500_000_000)
    );
    assert_reports(&outcome, "MPU-6050 at 0x68 configured");
    assert_recovered(&outcome);
}

#[test]
fn sensor_unplugged_in_flight_and_plugged_in_again() {
    let outcome = fly(at_rest(3.5).fault(Fault::SensorAbsent(1.6..2.2)));
    assert_reports(&outcome, "no sensor answers at 0x68 or 0x69");
    assert_recovered(&outcome);
}

#[test]
fn a_bus_line_held_low_then_free() {
    for (line, text) in [
        (BusLine::Clock, "SCL (PB8) stays low"),
        (BusLine::Data, "SDA (PB9) stays low"),
    ] {
        for start_s in [0.0, 1.6] {
            let outcome = fly(at_rest(3.5).fault(Fault::BusHeldLow(line, start_s..2.2)));
            assert_reports(&outcome, text);
            assert_recovered(&outcome);
        }
    }
}

#[test]
fn wrong_identity_then_the_right_one() {
    let outcome = fly(at_rest(3.0).fault(Fault::Identity(0x12, 0.0..1.2)));
    assert_reports(&outcome, "the chip at 0x68 has WHO_AM_I 0x12");
    assert_recovered(&outcome);
}

/// One refused byte of one burst costs that sample and no more.
#[track_caller]
fn assert_one_burst_is_lost(byte: BusByte, place: &str) {
    let outcome = fly(at_rest(2.5).fault(Fault::Nack {
        byte,
        from_s: 2.0,
        count: 1,
    }));
    assert_reports(
        &outcome,
        &format!("the sensor did not acknowledge at its {place}")
            .replace("its register", "the register"),
    );
    assert_eq!(outcome.summary.missed, 1, "{}", transcript(&outcome));
    let after = outcome.samples().iter().find(|sample| {
        sample.published_ns > 2_000_000_000 && sample.snapshot.flags != Flags::VALID
    });
    assert_eq!(
        after.map(|sample| sample.snapshot.flags),
        Some(Flags::MISSED | Flags::BUS_FAULT | Flags::VALID)
    );
    assert_recovered(&outcome);
}

#[test]
fn nack_on_the_address_for_writing() {
    assert_one_burst_is_lost(BusByte::AddressWrite, "address (write)");
}

#[test]
fn nack_on_the_register_pointer() {
    assert_one_burst_is_lost(BusByte::Pointer, "register pointer");
}

#[test]
fn nack_on_the_address_for_reading() {
    assert_one_burst_is_lost(BusByte::AddressRead, "address (read)");
}

#[test]
fn nack_on_a_value_while_configuring() {
    let outcome = fly(at_rest(2.5).fault(Fault::Nack {
        byte: BusByte::Value,
        from_s: 0.0,
        count: 1,
    }));
    assert_reports(&outcome, "failed: data not acknowledged");
    assert_recovered(&outcome);
}

#[test]
fn nacks_in_a_row_have_the_sensor_set_up_again() {
    for byte in [
        BusByte::AddressWrite,
        BusByte::Pointer,
        BusByte::AddressRead,
    ] {
        let outcome = fly(at_rest(3.5).fault(Fault::Nack {
            byte,
            from_s: 1.6,
            count: 4,
        }));
        assert_reports(&outcome, "the sensor did not acknowledge");
        assert_reports(&outcome, "setting the bus and the sensor up again");
        assert_recovered(&outcome);
    }
}

#[test]
fn sensor_silent_in_flight() {
    let outcome = fly(at_rest(3.5).fault(Fault::SensorSilent(1.6..2.2)));
    assert_reports(
        &outcome,
        "the sensor did not acknowledge at its address (write)",
    );
    assert_reports(&outcome, "no sensor answers");
    assert_recovered(&outcome);
}

#[test]
fn sensor_reset_in_flight() {
    let outcome = fly(at_rest(3.0).fault(Fault::SensorReset(1.6)));
    assert_reports(&outcome, "setting the bus and the sensor up again");
    assert_recovered(&outcome);
}

#[test]
fn moved_during_start_up() {
    let motion = Rest::level().nudged(0.8, 0.4, 0.5);
    let outcome = fly(pooled_run().seconds(6.0).motion(motion));
    assert_reports(
        &outcome,
        "moved while the gyroscope's offset was being measured",
    );
    assert_reports(&outcome, "gyroscope's offset measured, ready");
    let flags = |flag: Flags| {
        outcome
            .samples()
            .iter()
            .filter(|sample| sample.snapshot.flags.contains(flag))
            .count()
    };
    assert!(flags(Flags::MOVED) > 0);
    assert!(flags(Flags::CALIBRATING) > 1000, "the average starts again");
    assert_eq!(
        outcome.samples().last().map(|sample| sample.snapshot.flags),
        Some(Flags::VALID)
    );
    assert_recovered(&outcome);
}

#[test]
fn vibration_of_the_frame() {
    let flagged_s = |force_rms_g: f64| {
        let strength = Strength {
            force_rms_m_s2: force_rms_g * 9.80665,
            frequency_hz: 80.0,
            lever_m: 0.1,
            start_s: 3.0,
            growth_s: 0.5,
        };
        let motion = Vibrating::new(Rest::level(), strength, 5);
        let outcome = fly(pooled_run().seconds(7.0).motion(motion));
        let flags = outcome.samples().iter().map(|sample| sample.snapshot.flags);
        let flagged = flags.filter(|flags| flags.contains(Flags::VIBRATION));
        let is_degraded = |flags: Flags| flags.contains(Flags::DEGRADED);
        assert!(flagged.clone().all(is_degraded));
        (flagged.count() as f64 * 1e-3, outcome)
    };
    // All three axes shake: 3 g on each are 5.2 g, 5 g are 8.7 g.
    let (seconds, _) = flagged_s(3.0);
    assert!(seconds == 0.0, "{seconds}");
    let (seconds, outcome) = flagged_s(5.0);
    assert!(seconds > 1.5 && seconds < 4.0, "{seconds}");
    assert_reports(&outcome, "vibration too strong: balance the rotors");
    assert_reports(&outcome, "attitude: VALID|DEGRADED|VIBRATION");
}

#[test]
fn interrupt_never_coming_then_wired() {
    for level in [false, true] {
        let outcome = fly(at_rest(3.0).fault(Fault::InterruptStuck(level, 0.0..1.5)));
        assert_reports(
            &outcome,
            "no data-ready edge on the INT pin: check the wire from INT to PA1",
        );
        // The attitude continues by timer, with a flag; with the wire there are edges again. The
        // first comes within 1.01 ms, and a burst that the timer has started ends 0.4 ms later.
        for sample in outcome.samples() {
            let is_polled = sample.snapshot.flags.contains(Flags::POLLED);
            let at_us = sample.published_ns / 1000;
            assert!(is_polled || at_us >= 1_500_000, "{level}: {at_us} us");
            assert!(!is_polled || at_us < 1_501_420, "{level}: {at_us} us");
        }
        assert_recovered(&outcome);
    }
}

#[test]
fn interrupt_lost_in_flight() {
    let outcome = fly(at_rest(3.5).fault(Fault::InterruptStuck(false, 1.6..2.2)));
    assert_reports(&outcome, "no data-ready edge on the INT pin");
    assert_recovered(&outcome);
}

#[test]
fn no_crystal() {
    let outcome = fly(at_rest(2.5).fault(Fault::NoCrystal));
    assert_reports(&outcome, "no crystal answered");
    assert_recovered(&outcome);
    assert_eq!(outcome.summary.missed, 0);
    assert!(
        outcome
            .summary
            .timestamp_error_us_max
            .is_some_and(|it| it <= 1.0),
        "the emulated internal oscillator is exact"
    );
    let flags = |outcome: &Outcome| {
        let flags = outcome.samples().iter().map(|sample| sample.snapshot.flags);
        flags.fold(Flags::all(), |common, flags| common & flags)
    };
    let expected = Flags::INTERNAL_CLOCK | Flags::DEGRADED;
    assert!(flags(&outcome).contains(expected), "{}", flags(&outcome));
}

#[test]
fn the_log_without_a_reader_holds_nothing_up() {
    let outcome = fly(at_rest(3.0).without_probe());
    assert!(outcome.log().is_empty());
    assert_eq!(outcome.summary.missed, 0);
    assert!(outcome.uart_reports("gyroscope's offset measured, ready"));
    assert_recovered(&outcome);
}

#[test]
fn a_reset_of_the_sensor_is_counted_as_one_whatever_the_part() {
    for (name, kit) in Kit::ALL {
        let schedule = Schedule::parse("test", "1.8 0.05 sensor-brownout").unwrap();
        let run = at_rest(2.6).kit(kit).schedule(&schedule);
        let outcome = fly(run);
        let counters = outcome.record.health.last().unwrap().counters;
        let count = |class: FaultClass| counters[class as usize];
        assert!(count(FaultClass::SensorReset) > 0, "{name}");
        assert_eq!(count(FaultClass::RegisterChanged), 0, "{name}");
        assert_recovered(&outcome);
    }
}

/// FCHOICE_B of the gyroscope leads past its low-pass filter, and that of the accelerometer too.
#[test]
fn a_filter_that_an_mpu_9250_has_switched_off_is_switched_on_again() {
    for flip in ["0x1b:0x19", "0x1b:0x1a", "0x1b:0x1b", "0x1d:0x09"] {
        let schedule = Schedule::parse("test", &format!("1.8 0 register-flip:{flip}")).unwrap();
        let run = at_rest(3.4).kit(Kit::Mpu9250).schedule(&schedule);
        let outcome = fly(run.command(2.0, "registers"));
        let counters = outcome.record.health.last().unwrap().counters;
        let changed = counters[FaultClass::RegisterChanged as usize];
        assert_eq!(changed, 1, "{flip}: {}", transcript(&outcome));
        assert_reports(&outcome, "done registers: as configured");
        assert_recovered(&outcome);
    }
}

/// SIG_COND_RESET empties the data registers, and 100 ms pass without a sample.
#[test]
fn a_reset_of_the_signal_paths_is_no_attitude() {
    let schedule = Schedule::parse("test", "1.8 0 register-flip:0x6a:0x01").unwrap();
    let outcome = fly(at_rest(2.6).schedule(&schedule));
    let valid: Vec<u64> = outcome
        .samples()
        .iter()
        .filter(|sample| sample.snapshot.flags.contains(Flags::VALID))
        .map(|sample| sample.published_ns)
        .filter(|published_ns| *published_ns > 1_800_000_000)
        .collect();
    // A burst may be under way when the reset comes.
    let during = valid.iter().filter(|&&at_ns| at_ns < 1_900_000_000);
    assert!(during.count() <= 1, "{}", transcript(&outcome));
    let back = valid.iter().find(|&&at_ns| at_ns > 1_900_000_000);
    assert!(back.is_some_and(|&at_ns| at_ns < 2_150_000_000), "{back:?}");
    assert_recovered(&outcome);
}
