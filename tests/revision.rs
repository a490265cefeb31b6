//! The filters' revision stands for their bits, and a filter's state holds all that its attitudes depend on.

use aplomb::estimator::{FilterKind, REVISION};
use aplomb::health::Flags;
use aplomb::mpu6050::{
    AccelerometerCounts, Burst, GyroscopeCounts, Part, RawSample, TemperatureCounts,
};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::state::{Reader, Window};

/// What each filter makes of the flight below, as a hash of all its attitudes. If this test fails, the filters give
/// other attitudes than logs of this revision were made with: raise `REVISION` in `src/estimator/mod.rs` and put the new
/// hashes here.
const EXPECTED: (u16, [u64; 3]) = (
    2,
    [
        0x41CA_4CD4_2E58_67FB,
        0xF91D_75FC_FD72_E659,
        0x3A4E_D1D3_FBFE_EE6B,
    ],
);

/// Ten seconds at about 1 kHz: rest, then turns and shaking, with gaps, saturation, free fall, data that freeze, and a sensor that
/// has lost its settings.
fn flight() -> impl Iterator<Item = (Burst, Flags)> {
    let mut random = 12_345_u32;
    let mut t_us = 2_000_000;
    let mut bytes = [0; 14];
    (0..10_000_i32).map(move |index| {
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
        let saturated = if index == 5_000 { 32_767 } else { 0 };
        let gyroscope = [
            20 + moves * wave(2_000, 2_500) + noise(4),
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
        if !(8_000..8_400).contains(&index) {
            bytes = sample.encode();
        }
        let burst = Burst {
            bytes,
            captured_at_us: t_us,
            missed_before: 0,
        };
        (burst, Flags::NONE.with(Flags::SENSOR_RESET, index == 9_000))
    })
}

fn settings(filter: FilterKind) -> Settings {
    Settings {
        filter,
        ..Settings::new(&Part::MPU_6050)
    }
}

fn step(pipeline: &mut Pipeline, (burst, flags): &(Burst, Flags)) -> ([u32; 4], Flags) {
    let snapshot = pipeline.update_with(burst, *flags, |_, _| {});
    pipeline.collect(burst);
    let q = snapshot.attitude;
    ([q.w, q.x, q.y, q.z].map(f32::to_bits), snapshot.flags)
}

#[test]
fn the_revision_stands_for_these_bits() {
    let found = FilterKind::ALL.map(|kind| {
        let mut pipeline = Pipeline::new(&settings(kind));
        // FNV-1a, 64 bits.
        flight().fold(0xCBF2_9CE4_8422_2325_u64, |hash, burst| {
            step(&mut pipeline, &burst)
                .0
                .iter()
                .flat_map(|bits| bits.to_le_bytes())
                .fold(hash, |hash, byte| {
                    (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01B3)
                })
        })
    });
    assert_eq!(
        (REVISION, found),
        EXPECTED,
        "raise REVISION and put these hashes into EXPECTED: {found:#x?}"
    );
}

#[test]
fn a_state_holds_all_that_attitudes_depend_on() {
    for kind in FilterKind::ALL {
        let bursts: Vec<_> = flight().collect();
        let mut pipeline = Pipeline::new(&settings(kind));
        let mut states = 0;
        let mut checked = Vec::new();
        for (index, burst) in bursts.iter().enumerate() {
            let expected = step(&mut pipeline, burst);
            for (restored, attitude) in &mut checked {
                *attitude = step(restored, burst);
                assert_eq!(*attitude, expected, "{}: burst {index}", kind.name());
            }
            // A prime, so that the phases of the filter's own work are met in turn; each state is followed for 650 samples, longer than
            // two of its covariance steps.
            if index % 13 != 0 {
                continue;
            }
            let mut bytes = [0; 4096];
            let mut window = Window::new(&mut bytes, 0);
            let mut copy = pipeline;
            copy.exchange(&mut window);
            let Some(length) = window.length() else {
                assert!(kind != FilterKind::Kalman, "it averages nothing");
                continue;
            };
            // Another filter with another past.
            let mut restored = Pipeline::new(&settings(FilterKind::ALL[index % 3]));
            for burst in bursts.iter().rev().take(50) {
                step(&mut restored, burst);
            }
            let mut reader = Reader::new(&bytes[..length]);
            restored.exchange(&mut reader);
            assert!(reader.is_complete());
            if checked.len() == 50 {
                checked.remove(0);
            }
            checked.push((restored, expected));
            states += 1;
        }
        assert!(states > 600, "{}: {states}", kind.name());
    }
}

#[test]
fn a_filter_of_one_kind_refuses_the_state_of_another() {
    use aplomb::estimator::kalman::Kalman;
    let mut other = Pipeline::new(&Settings {
        averaging_samples: 0,
        ..settings(FilterKind::AxisKalman)
    });
    let mut bytes = [0; 4096];
    let mut window = Window::new(&mut bytes, 0);
    other.exchange(&mut window);
    let length = window.length().expect("it averages nothing");
    let mut kalman = Pipeline::with_filter(&settings(FilterKind::Kalman), Kalman::new());
    let mut reader = Reader::new(&bytes[..length]);
    kalman.exchange(&mut reader);
    assert!(!reader.is_complete());
}
