//! A flight for each class of faults: the firmware counts it as what it is, and all that must hold holds.

mod common;

use aplomb::fault::FaultClass;
use common::firmware;
use virtual_board::campaign::{self, Case};
use virtual_board::schedule::Schedule;

/// The faults begin here, s.
const BEGIN_S: f64 = 1.8;

/// Flies with this fault and holds the firmware to everything, and to having counted one of these classes. Without
/// classes nothing needs to be noticed, and nothing may be lost.
#[track_caller]
fn assert_counted_and_recovered(fault: &str, classes: &[FaultClass]) {
    let schedule = Schedule::parse("test", &format!("{BEGIN_S} {fault}")).unwrap();
    let case = Case::new(7, schedule);
    let outcome = case.fly(&firmware()).unwrap();
    let report = campaign::judge(&case, &outcome.record, &outcome.uart_lines);
    assert_eq!(report.failures, Vec::<String>::new(), "{fault}");
    let begin_ns = (BEGIN_S * 1e9) as u64;
    let readings = &outcome.record.health;
    let before = readings.iter().rfind(|reading| reading.at_ns < begin_ns);
    let last = readings.last().expect("the firmware reports its health");
    let counted: Vec<FaultClass> = FaultClass::ALL
        .into_iter()
        .filter(|&class| {
            let count = |counters: &[u32; FaultClass::COUNT]| counters[class as usize];
            count(&last.counters) > before.map_or(0, |before| count(&before.counters))
        })
        .collect();
    assert!(
        classes.is_empty() || classes.iter().any(|class| counted.contains(class)),
        "{fault}: counted as {counted:?}, expected one of {classes:?}"
    );
    if classes.is_empty() {
        let crashes = [
            FaultClass::Crash,
            FaultClass::StackOverflow,
            FaultClass::Watchdog,
        ];
        assert!(
            !crashes.iter().any(|class| counted.contains(class)),
            "{fault}: {counted:?}"
        );
    }
}

/// A test for each line: its name, the fault with its duration, and the classes that it may be counted as.
macro_rules! classes {
    ($($name:ident: $fault:literal => [$($class:ident),*];)*) => {
        $(
            #[test]
            fn $name() {
                assert_counted_and_recovered($fault, &[$(FaultClass::$class),*]);
            }
        )*
    };
}

classes! {
    address_nack: "0.01 address-nack" => [AddressNotAcknowledged];
    address_nack_for_reading: "0.01 address-nack:read" => [AddressNotAcknowledged];
    data_nack: "0.01 data-nack:0" => [DataNotAcknowledged];
    burst_stall: "0.02 burst-stall" => [BurstDeadline];
    data_line_shorted: "0.02 sda-low" => [DataLineLow, ArbitrationLost];
    sensor_lost_count: "0 sda-low:5" => [DataLineLow, BurstDeadline];
    clock_line_shorted: "0.02 scl-low" => [ClockLineLow, BurstDeadline];
    bus_error: "0.02 bus-error" => [BusError];
    arbitration_lost: "0.02 arbitration-lost" => [ArbitrationLost];
    dma_error: "0.02 dma-error" => [Dma];
    interrupt_missing: "0.05 int-missing" => [InterruptMissing];
    interrupt_high: "0.05 int-high" => [InterruptStuckHigh];
    interrupt_low: "0.05 int-low" => [InterruptMissing];
    interrupt_glitch: "0.1 int-glitch:1900" => [InterruptGlitch];
    interrupt_flood: "0.1 int-glitch:8000" => [InterruptGlitch];
    sensor_silent: "0.1 sensor-silent" => [SensorSilent, AddressNotAcknowledged];
    sensor_brownout: "0.02 sensor-brownout" => [SensorReset];
    range_of_the_gyroscope_changed: "0 register-flip:0x1b:0x08" => [RegisterChanged];
    range_of_the_accelerometer_changed: "0 register-flip:0x1c:0x10" => [RegisterChanged];
    filter_changed: "0 register-flip:0x1a:0x05" => [RegisterChanged];
    divider_changed: "0 register-flip:0x19:0x09" => [RegisterChanged];
    interrupt_pin_changed: "0 register-flip:0x37:0x80" => [RegisterChanged];
    interrupt_disabled: "0 register-flip:0x38:0x00" => [RegisterChanged];
    put_to_sleep: "0 register-flip:0x6b:0x40" => [SensorReset, RegisterChanged];
    frozen: "0.2 frozen" => [Frozen];
    zeros: "0.2 zeros" => [Rejected];
    ones: "0.2 ones" => [Rejected];
    saturated_accelerometer: "0.05 saturated:ax" => [Saturated];
    saturated_gyroscope: "0.005 saturated:gz" => [Saturated];
    temperature: "0.2 temperature:120" => [Temperature];
    core_stall: "0.02 core-stall" => [AttitudeLate, SamplesMissed];
    uart_flood: "0.2 uart-flood" => [];
    uart_noise: "0.2 uart-noise" => [];
    probe_detach: "0.2 probe-detach" => [];
    crystal_dies: "0 crystal-dies" => [ClockFailed];
    watchdog_hang: "0 watchdog-hang" => [Watchdog];
}
