//! The Rust of `docs/porting.md`: compiled here, and compared with the page.

#![expect(
    dead_code,
    unused_variables,
    reason = "the code of the page is compiled, and does not run"
)]

use aplomb::calibration::{ImplausibleCalibration, Mount};
use aplomb::estimator::Sample;
use aplomb::estimator::kalman::WarmStart;
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
    kept_record: impl Fn() -> [u8; storage::LONGEST_RECORD],
) -> Result<Pipeline, Box<dyn std::error::Error>> {
    let mut settings = Settings::for_sensor(sensor.part(), &config);
    settings.mount = "+y-z".parse()?; // unless the chip is face up with X forward
    settings.verifies_scales = true; // step 6
    let bytes: [u8; storage::LONGEST_RECORD] = kept_record(); // as `storage::to_bytes` wrote them
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
    bytes: [u8; WarmStart::LENGTH],
    (now_us, age_us): (u64, u32),
    was_armed: bool,
) {
    if let Some(kept) = WarmStart::from_bytes(&bytes) {
        pipeline.resume_aged(&kept, now_us, age_us);
        pipeline.set_armed(was_armed); // `resume_aged` does not arm
    }
}

#[rustfmt::skip]
fn samples(
    mut next_sample: impl FnMut() -> Option<(u64, [f32; 3], [f32; 3])>,
    full_scale_rad_s: f32,
) -> Result<(), Box<dyn std::error::Error>> {
    let mut pipeline = Pipeline::new(&Settings::for_samples(200.0)); // samples a second
    let mount: Mount = "+y-z".parse()?; // the sensor's axes along forward and down
    while let Some((t_us, force_m_s2, rate_rad_s)) = next_sample() { // in the sensor's axes
        let body = |vector: [f32; 3]| mount.to_body(vector.into());
        let mut sample = Sample::new(t_us, body(force_m_s2), body(rate_rad_s));
        sample.is_rate_saturated = rate_rad_s.iter().any(|rate| rate.abs() >= full_scale_rad_s);
        let snapshot = pipeline.update_sample(&sample); // trust it only with `Flags::VALID`
    }
    Ok(())
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
