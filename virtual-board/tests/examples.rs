//! The examples for the target work on a board: each shows the attitude of a sensor
//! that lies tilted.

use aplomb::health::Flags;
use aplomb_models::motion::rest::Rest;
use aplomb_models::motion::swing::Swing;
use aplomb_models::motion::{Motion, Quaternion, inclination_error_rad};
use virtual_board::faults::{BusByte, Fault, FaultKind, ScheduledFault};
use virtual_board::flight::Run;

/// The image that `cargo xtask test` has built of an example.
fn image(name: &str) -> std::ffi::OsString {
    let variable = format!("APLOMB_EXAMPLE_{}", name.to_uppercase());
    std::env::var_os(&variable).unwrap_or_else(|| {
        panic!("{variable} does not name the example: run `cargo xtask test`, which builds it")
    })
}

/// Flies an example, and holds the last line of its log, `roll R pitch P`, to the truth.
fn shows_the_attitude(name: &str) {
    let (roll_deg, pitch_deg) = (-35.0_f64, 20.0_f64);
    let attitude = Quaternion::from_euler(roll_deg.to_radians(), pitch_deg.to_radians(), 0.0);
    let run = Run::new(image(name))
        .seconds(2.5)
        .motion(Rest::new(attitude));
    let outcome = run.run().unwrap();
    let last = outcome
        .log()
        .iter()
        .rev()
        .find_map(|line| line.text.split_once("roll "))
        .unwrap_or_else(|| panic!("{name} shows no attitude: {:?}", outcome.issues));
    let (roll, pitch) = last.1.split_once(" pitch ").expect("roll and pitch");
    let (roll, pitch): (f64, f64) = (roll.parse().unwrap(), pitch.parse().unwrap());
    // The sensor's own offsets of up to 50 mg tilt it by 3 degrees.
    assert!(
        (roll - roll_deg).abs() < 4.0 && (pitch - pitch_deg).abs() < 4.0,
        "{name}: {roll} {pitch}"
    );
}

#[test]
fn the_rtic_application_shows_the_attitude() {
    shows_the_attitude("rtic");
}

#[test]
fn the_rtic_application_notices_a_full_scale_that_has_changed() {
    let fault = ScheduledFault {
        start_ns: 2_000_000_000,
        duration_ns: 0,
        kind: FaultKind::RegisterFlip(0x1B, 0x00),
    };
    let run = Run::new(image("rtic")).seconds(2.5);
    let run = run.motion(Rest::new(Quaternion::from_euler(0.3, 0.2, 0.0)));
    let outcome = run.fault(Fault::Scheduled(fault)).run().unwrap();
    let has_seen_it = |flag| {
        let mut samples = outcome.samples().iter();
        samples.any(|sample| sample.snapshot.flags.contains(flag))
    };
    assert!(has_seen_it(Flags::SENSOR_RESET), "{:?}", outcome.issues);
    let last = outcome.samples().last().expect("samples");
    assert!(last.published_ns > 2_400_000_000);
    assert!(last.snapshot.flags.contains(Flags::VALID), "{last:?}");
}

#[test]
fn the_embassy_application_shows_the_attitude() {
    shows_the_attitude("embassy");
}

/// Flies Embassy's application through a swing with these faults between 3 s and 5 s. Its pipeline
/// has to outlast them: attitudes come without a pause, and are right and valid in motion.
fn embassy_outlasts(faults: Vec<Fault>) {
    let mut swing = Swing::by_seed(3, 2.0);
    let mut run = Run::new(image("embassy"))
        .seconds(6.0)
        .motion(swing.clone());
    for fault in faults {
        run = run.fault(fault);
    }
    let outcome = run.run().unwrap();
    let (mut last_ns, mut valid) = (2_000_000_000, 0);
    let log = outcome.log().iter();
    for line in log.skip_while(|line| line.at_ns < 2_000_000_000) {
        let shown = line.text.split_once("valid ");
        let (_, shown) = shown.unwrap_or_else(|| panic!("it shows no attitude: {line:?}"));
        let pause_ms = (line.at_ns - last_ns) / 1_000_000;
        assert!(pause_ms < 200, "a pause of {pause_ms} ms before {line:?}");
        last_ns = line.at_ns;
        let [is_valid, _, roll, _, pitch] = shown.split(' ').collect::<Vec<_>>()[..] else {
            panic!("{line:?}");
        };
        if is_valid == "false" && (3_000_000_000..5_000_000_000).contains(&line.at_ns) {
            continue; // a stale attitude
        }
        let [roll, pitch] = [roll, pitch].map(|angle| angle.parse::<f64>().unwrap().to_radians());
        let truth = swing.at(line.at_ns as f64 * 1e-9).attitude;
        let shown = Quaternion::from_euler(roll, pitch, 0.0);
        let error_rad = inclination_error_rad(shown, truth.expect("a swing has one"));
        // The sensor's own offsets tilt it by 3 degrees.
        assert!(
            is_valid == "true" && error_rad.to_degrees() < 5.0,
            "{line:?}"
        );
        valid += 1;
    }
    assert!(last_ns > 5_900_000_000 && valid > 30, "{last_ns} {valid}");
}

#[test]
fn the_embassy_application_outlasts_a_sensor_that_is_silent() {
    // Every burst and every check fails, and more than twenty in a row.
    embassy_outlasts(vec![Fault::SensorSilent(3.2..3.26)]);
}

#[test]
fn the_embassy_application_outlasts_an_error_in_a_check_of_the_settings() {
    // A check every 44 ms takes half of a millisecond: some of these hit one.
    let nack = |index: u32| Fault::Nack {
        byte: BusByte::AddressRead,
        from_s: 3.0 + 0.0103 * f64::from(index),
        count: 1,
    };
    embassy_outlasts((0..180).map(nack).collect());
}

#[test]
fn the_embassy_application_restores_a_full_scale_that_has_changed() {
    let fault = |start_ns, register, value| {
        Fault::Scheduled(ScheduledFault {
            start_ns,
            duration_ns: 0,
            kind: FaultKind::RegisterFlip(register, value),
        })
    };
    // The gyroscope's full scale, and a sensor that sleeps: it gives no edges.
    embassy_outlasts(vec![
        fault(3_200_000_000, 0x1B, 0x00),
        fault(4_000_000_000, 0x6B, 0x40),
    ]);
}
