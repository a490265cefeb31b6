//! The examples for the target work on a board: each shows the attitude of a sensor
//! that lies tilted.

use aplomb::health::Flags;
use aplomb_models::motion::Quaternion;
use aplomb_models::motion::rest::Rest;
use virtual_board::faults::{Fault, FaultKind, ScheduledFault};
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
