//! Tests that the filters' revision identifies their bits, and that a filter's state is complete.

use aplomb::attitude::Vector3;
use aplomb::estimator::REVISION;
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{
    AccelerometerCounts, Burst, GyroscopeCounts, Part, RawSample, TemperatureCounts,
};
use aplomb::pipeline::{CompassPipeline, Pipeline, Settings};
use aplomb::serialize::{StateReader, StateWriter};
use aplomb::units::MagneticField;

/// Hash of all attitudes of the flight below. If this test fails, the filter's attitudes differ
/// from those in logs of this revision. Then increase `REVISION` in `src/estimator/mod.rs`, and put
/// the new hash here.
const EXPECTED: (u16, u64) = (35, 0x245F_CC9D_9EA2_6300);

/// Hash of all headings of that flight, likewise.
const EXPECTED_HEADINGS: (u16, u64) = (35, 0xABEA_1143_4DD2_3EDD);

/// Start of a hash.
const EMPTY_HASH: u64 = 0xCBF2_9CE4_8422_2325;

/// Flight of 45 seconds at about 1 kHz: rest, then turns and shaking. It includes gaps,
/// saturation, free fall, frozen data, a sensor that has lost its settings, and a crystal that
/// fails. Ten seconds before the end, the gyroscope's offset changes.
fn flight() -> impl Iterator<Item = (Burst, BoardFlags)> {
    let mut random = 12_345_u32;
    let mut t_us = 2_000_000;
    let mut bytes = [0; 14];
    (0..45_000_i32).map(move |index| {
        let mut noise = |size: i32| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 16) as i32 % size - size / 2
        };
        // A triangle wave of this period and height.
        let wave = |period: i32, height: i32| {
            let phase = index % period;
            (phase.min(period - phase) * 4 - period) * height / period
        };
        let moves = i32::from(index > 2_500);
        let falls = (7_000..7_200).contains(&index);
        let force = |g: i32, wave: i32, noise: i32| {
            if falls {
                noise
            } else {
                g + moves * wave + noise
            }
        };
        let accelerometer = [
            force(0, wave(900, 700), noise(20)),
            force(0, wave(1_300, 900), noise(20)),
            force(2048, wave(400, 300), noise(30)),
        ];
        let is_saturated = index == 5_000 || (5_500..5_520).contains(&index);
        let saturated = if is_saturated { 40_000 } else { 0 };
        let offset = if index > 35_000 { 500 } else { 20 };
        let gyroscope = [
            offset + moves * wave(2_000, 2_500) + noise(4),
            -31 + moves * wave(1_700, 1_800) + noise(4) + saturated,
            7 + moves * wave(3_100, 1_500) + noise(4),
        ];
        t_us += match index {
            4_000 => 700_000,
            6_000 => 40_000,
            _ => 1_000 + u64::from(index as u32 % 3),
        };
        let narrow = |values: [i32; 3]| values.map(|value| value.clamp(-32_768, 32_767) as i16);
        let sample = RawSample {
            accelerometer: AccelerometerCounts(narrow(accelerometer)),
            temperature: TemperatureCounts(-3_920 + (index / 10) as i16),
            gyroscope: GyroscopeCounts(narrow(gyroscope)),
        };
        if !(8_000..8_150).contains(&index) {
            bytes = sample.encode();
        }
        let burst = Burst {
            bytes,
            captured_at_us: t_us,
            missed_before: 0,
        };
        let mut board = BoardFlags::empty();
        board.set(BoardFlags::SENSOR_RESET, index == 9_000);
        board.set(BoardFlags::SCALES_VERIFIED, index % 44 == 0);
        board.set(BoardFlags::INTERNAL_CLOCK, index > 9_500);
        (burst, board)
    })
}

fn pipeline() -> Pipeline {
    Pipeline::new(&Settings {
        verifies_scales: true,
        ..Settings::new(&Part::MPU_6050)
    })
}

fn step(pipeline: &mut Pipeline, (burst, board): &(Burst, BoardFlags)) -> ([u32; 5], Flags) {
    let snapshot = pipeline.update(burst, *board);
    let q = snapshot.attitude;
    let bits = [q.w, q.x, q.y, q.z, snapshot.tilt_variance_rad2].map(f32::to_bits);
    (bits, snapshot.flags)
}

/// Adds to a hash: FNV-1a, 64 bits.
fn add_to_hash(hash: u64, bits: &[u32]) -> u64 {
    let bytes = bits.iter().flat_map(|bits| bits.to_le_bytes());
    bytes.fold(hash, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
    })
}

#[test]
fn attitudes_of_this_revision_have_this_hash() {
    let mut pipeline = pipeline();
    let (mut found, mut rises) = (EMPTY_HASH, 0);
    for burst in flight() {
        let before = pipeline.kalman().largest_bias_sigma_rad_s();
        found = add_to_hash(found, &step(&mut pipeline, &burst).0);
        let sigma = pipeline.kalman().largest_bias_sigma_rad_s();
        rises += u32::from(burst.0.captured_at_us > 37_000_000 && sigma > 1.2 * before);
    }
    // The changed offset contradicts the filter's model.
    assert!(rises > 0);
    assert_eq!(
        (REVISION, found),
        EXPECTED,
        "raise REVISION and put this hash into EXPECTED: {found:#x?}"
    );
}

#[test]
fn headings_of_this_revision_have_this_hash() {
    let settings = Settings::new(&Part::MPU_6050);
    let mut pipeline = CompassPipeline::new(&settings, CompassKnowledge::Calibrated);
    let (mut found, mut headings) = (EMPTY_HASH, 0);
    for (index, (burst, board)) in flight().enumerate() {
        let attitude = pipeline.update(&burst, board).attitude;
        if index % 10 == 0 {
            let earth_ut = Vector3::new(20.0, 0.0, 44.0);
            let Vector3 { x, y, z } = attitude.conjugate().rotate(earth_ut);
            pipeline.update_field(MagneticField { ut: [x, y, z] }, 2_000);
        }
        if let Some(heading) = pipeline.heading() {
            let bits = [heading.yaw_offset_rad, heading.sigma_rad].map(f32::to_bits);
            found = add_to_hash(found, &bits);
            headings += 1;
        }
    }
    assert!(headings > 15_000, "{headings}");
    assert_eq!(
        (REVISION, found),
        EXPECTED_HEADINGS,
        "raise REVISION and put this hash into EXPECTED_HEADINGS: {found:#x?}"
    );
}

#[test]
fn a_restored_state_gives_the_same_attitudes() {
    let bursts: Vec<_> = flight().collect();
    let mut original = pipeline();
    let mut states = 0;
    let mut checked = Vec::new();
    for (index, burst) in bursts.iter().enumerate() {
        let expected = step(&mut original, burst);
        for (restored, attitude) in &mut checked {
            *attitude = step(restored, burst);
            assert_eq!(*attitude, expected, "burst {index}");
        }
        // A prime, so that every phase of the filter's work occurs. Each state is followed for 650
        // samples, longer than two covariance steps.
        if index % 13 != 0 {
            continue;
        }
        let mut bytes = [0; 4096];
        let mut writer = StateWriter::new(&mut bytes, 0);
        let mut copy = original;
        copy.visit_state(&mut writer);
        let length = writer.length().expect("a state");
        // A pipeline with another history.
        let mut restored = Pipeline::new(&Settings::new(&Part::MPU_6050));
        for burst in bursts.iter().rev().take(50) {
            step(&mut restored, burst);
        }
        let mut reader = StateReader::new(&bytes[..length]);
        restored.visit_state(&mut reader);
        assert!(reader.is_complete());
        if checked.len() == 50 {
            checked.remove(0);
        }
        checked.push((restored, expected));
        states += 1;
    }
    assert!(states > 2_500, "{states}");
}
