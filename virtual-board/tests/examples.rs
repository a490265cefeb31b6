//! The examples for the target do on a board what they say: each shows the attitude of a sensor that lies tilted.

use virtual_board::flight::Run;
use virtual_board::motion::Quaternion;
use virtual_board::motion::rest::Rest;

/// Flies an example, and holds the last line of its log, `roll R pitch P`, to the truth.
fn shows_the_attitude(name: &str) {
    let variable = format!("APLOMB_EXAMPLE_{}", name.to_uppercase());
    let Some(image) = std::env::var_os(&variable) else {
        panic!("{variable} does not name the example: run `cargo xtask test`, which builds it");
    };
    let (roll_deg, pitch_deg) = (-35.0_f64, 20.0_f64);
    let attitude = Quaternion::from_euler(roll_deg.to_radians(), pitch_deg.to_radians(), 0.0);
    let run = Run::new(image).seconds(2.5).motion(Rest::new(attitude));
    let outcome = run.run().unwrap();
    let last = outcome
        .log()
        .iter()
        .rev()
        .find_map(|line| line.text.split_once("roll "))
        .unwrap_or_else(|| panic!("{name} shows no attitude: {:?}", outcome.remarks));
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
fn the_embassy_application_shows_the_attitude() {
    shows_the_attitude("embassy");
}
