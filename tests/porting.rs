//! The Rust of `docs/porting.md`: compiled here, and compared with the page.

#![expect(
    dead_code,
    reason = "the code of the page is compiled, and does not run"
)]

use aplomb::calibration::ImplausibleCalibration;
use aplomb::estimator::Estimator;
use aplomb::estimator::kalman::{AccelerometerKnowledge, GyroscopeKnowledge, WarmStart};
use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{Config, Mpu6050, SettingsState};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::settings::storage;
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;

/// Prints why a calibration is refused.
fn report(error: ImplausibleCalibration) {
    println!("{error}");
}

#[rustfmt::skip]
fn pipeline<I2C: I2c>(
    sensor: &Mpu6050<I2C>,
    config: Config,
    bytes: [u8; storage::LONGEST_RECORD],
) -> Result<Pipeline, Box<dyn std::error::Error>> {
    let mut settings = Settings::for_sensor(sensor.part(), &config);
    settings.mount = "+y-z".parse()?; // unless the chip is face up with X forward
    settings.verifies_scales = true; // step 6
    if let Some(record) = storage::from_bytes(&bytes).record {
        match record.calibration.check() {
            Ok(()) => settings.calibration = record.calibration, // a mount in it is taken
            Err(error) => report(error),
        }
    }
    let mut pipeline = Pipeline::new(&settings);
    pipeline.set_armed(false);
    Ok(pipeline)
}

#[rustfmt::skip]
fn check<I2C: I2c>(
    sensor: &mut Mpu6050<I2C>,
    config: Config,
    mut delay: impl DelayNs,
    (pipeline, number): (&Pipeline, u32),
) -> BoardFlags {
    let mut flags = BoardFlags::empty();
    if number.is_multiple_of(44) || pipeline.awaits_scale_check() {
        flags |= match sensor.verify_config(&config) { // of the next burst
            Ok(SettingsState::Intact) => BoardFlags::SCALES_VERIFIED,
            Ok(_) => {
                let _ = sensor.reconfigure(&config, &mut delay); // else the next check does
                BoardFlags::SENSOR_RESET
            }
            Err(_) => BoardFlags::BUS_FAULT, // leave neither the loop nor the pipeline
        };
    }
    flags
}

#[rustfmt::skip]
fn arm(pipeline: &mut Pipeline, snapshot: &Snapshot, wants_to_arm: bool) {
    if wants_to_arm && !snapshot.flags.contains(Flags::CALIBRATING) {
        pipeline.set_armed(true);
    }
}

#[rustfmt::skip]
fn resume(
    pipeline: &mut Pipeline,
    kept: [u8; WarmStart::LENGTH],
    (unseen_turn_rad, now_us): (f32, u64),
    was_armed: bool,
) {
    if let Some(mut start) = WarmStart::from_bytes(&kept) {
        start.tilt_sigma_rad += unseen_turn_rad; // since the state was kept
        pipeline.resume(&start, now_us);
        pipeline.set_armed(was_armed); // `resume` does not arm
    }
}

#[rustfmt::skip]
fn know_nothing(estimator: &mut Estimator) {
    estimator.filter_mut().set_accelerometer_knowledge(AccelerometerKnowledge::Factory);
    estimator.filter_mut().set_gyroscope_knowledge(GyroscopeKnowledge::Factory);
}

/// Returns the lines without their indentation.
fn trimmed(text: &str) -> String {
    text.lines()
        .map(|line| format!("{}\n", line.trim()))
        .collect()
}

#[test]
fn the_rust_of_the_page_compiles() {
    let page = trimmed(include_str!("../docs/porting.md"));
    let code = trimmed(include_str!("porting.rs"));
    let blocks: Vec<&str> = page.split("```rust\n").skip(1).collect();
    assert_eq!(blocks.len(), 5);
    for block in blocks {
        let (block, _) = block.split_once("```").expect("the block ends");
        assert!(code.contains(block), "not in tests/porting.rs:\n{block}");
    }
}
