//! Simulated samples, at rest and in motion.

use super::super::noise::SensorSetup;
use super::*;

const LEVEL: [i16; 3] = [0, 0, 2048];
/// Samples of a window at the default settings.
const WINDOW: u32 = 86;

fn noise_model(
    gyroscope_counts_per_degree_s: f32,
    accelerometer_counts_per_g: f32,
    gyroscope_bandwidth_hz: f32,
    accelerometer_bandwidth_hz: f32,
    sample_rate_hz: f32,
) -> NoiseModel {
    NoiseModel::new(&SensorSetup {
        gyroscope_counts_per_degree_s,
        accelerometer_counts_per_g,
        gyroscope_bandwidth_hz,
        accelerometer_bandwidth_hz,
        sample_rate_hz,
    })
}

/// A reading at 25 °C.
fn reading(gyroscope: [i16; 3], accelerometer: [i16; 3]) -> ImuReading {
    ImuReading {
        gyroscope,
        accelerometer,
        temperature_celsius: 25.0,
    }
}

/// ±250 °/s and ±2 g at 1 kHz and 188 Hz.
fn fine() -> NoiseModel {
    noise_model(131.0, 16384.0, 188.0, 184.0, 1000.0)
}

/// ±2000 °/s and ±16 g, the default.
fn coarse() -> NoiseModel {
    noise_model(16.4, 2048.0, 188.0, 184.0, 1000.0)
}

/// Noise generator: a linear congruential one; a normal number is the sum of twelve uniform ones.
struct Noise(u32);

impl Noise {
    fn uniform(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / (1 << 24) as f32 - 0.5
    }

    fn next(&mut self, amplitude: i16) -> i16 {
        (self.uniform() * (2.0 * f32::from(amplitude) + 1.0)).round() as i16
    }

    fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.uniform()).sum()
    }

    /// Readings of a stationary sensor with a multiple of the datasheet's noise.
    fn sample(&mut self, scale: &NoiseModel, times: f32) -> ([i16; 3], [i16; 3]) {
        let mut axes = |sigma: f32, mean: [f32; 3]| {
            mean.map(|mean| (mean + times * sigma * self.normal()).round() as i16)
        };
        let gyroscope = axes(scale.gyroscope_sigma_counts, [20.3, -30.8, 5.5]);
        let level = [0.2, -0.4, scale.counts_per_g];
        (gyroscope, axes(scale.accelerometer_sigma_counts, level))
    }
}

/// Feeds samples until an event other than `Collecting`; returns its index and the event.
fn first_event(
    detector: &mut StationaryDetector,
    mut sample: impl FnMut(u32) -> ([i16; 3], [i16; 3]),
) -> (u32, StationaryProgress) {
    for index in 0..100_000 {
        let (gyroscope, accelerometer) = sample(index);
        match detector.update(&reading(gyroscope, accelerometer)) {
            StationaryProgress::Collecting => {}
            event => return (index, event),
        }
    }
    panic!("nothing happened");
}

fn done(progress: StationaryProgress) -> StationaryMean {
    let StationaryProgress::Done(mean) = progress else {
        panic!("{progress:?}");
    };
    mean
}

#[test]
fn the_classic_example_has_the_offset_minus_158_25() {
    // The readings have tenths, so a count here is a tenth of theirs.
    let tenths = [
        -1584, -1729, -1342, -1551, -1312, -1468, -1731, -1886, -1427, -1795,
    ];
    let scale = noise_model(1310.0, 16384.0, 188.0, 184.0, 1000.0);
    let mut detector = StationaryDetector::new(&scale, 10);
    let (index, event) = first_event(&mut detector, |index| {
        ([tenths[index as usize], 0, 0], [0, 0, -16384])
    });
    assert_eq!(index, 9);
    let mean = done(event);
    assert_eq!(mean.gyroscope_counts, Vector3::new(-1582.5, 0.0, 0.0));
    assert_eq!(mean.gyroscope_counts.x / 10.0, -158.25);
    // Face down, the classic accelerometer offset is the mean plus one g.
    assert_eq!(mean.accelerometer_counts.z + 16384.0, 0.0);
}

#[test]
fn sensor_noise_is_stationary_and_is_averaged_exactly() {
    let mut noise = Noise(1);
    let (mut gyroscope_sum, mut accelerometer_sum) = ([0_i64; 3], [0_i64; 3]);
    let mut detector = StationaryDetector::new(&coarse(), 1000);
    let (index, event) = first_event(&mut detector, |_| {
        // Three times the datasheet's noise; offsets of 12 °/s.
        let gyroscope = [200, -150, 7].map(|offset| offset + noise.next(5));
        let accelerometer = [40, -60, 2100].map(|mean| mean + noise.next(50));
        for axis in 0..3 {
            gyroscope_sum[axis] += i64::from(gyroscope[axis]);
            accelerometer_sum[axis] += i64::from(accelerometer[axis]);
        }
        (gyroscope, accelerometer)
    });
    assert_eq!(index, 999);
    let mean = done(event);
    let [gyroscope, accelerometer] = [gyroscope_sum, accelerometer_sum]
        .map(|sum| sum.map(|sum| (sum as f64 / 1000.0) as f32))
        .map(|[x, y, z]| Vector3::new(x, y, z));
    assert!((mean.gyroscope_counts - gyroscope).is_within(2e-5));
    assert!((mean.accelerometer_counts - accelerometer).is_within(2e-4));
    assert_eq!(mean.samples, 1000);
    assert!((mean.temperature_celsius - 25.0).abs() < 1e-3);
    // A uniform number of ±5.5 has σ = 11/√12.
    let sigma = mean.gyroscope_sigma_counts;
    assert!(
        (sigma - Vector3::new(3.18, 3.18, 3.18)).is_within(0.2),
        "{sigma:?}"
    );
}

#[test]
fn a_sensor_within_its_datasheet_or_a_noisy_clone_is_stationary() {
    for (scale, times) in [
        (coarse(), 1.0),
        (fine(), 1.0),
        (coarse(), 3.5),
        (fine(), 3.5),
    ] {
        let mut noise = Noise(7);
        let mut detector = StationaryDetector::new(&scale, 1000);
        for _ in 0..100 {
            let (index, event) = first_event(&mut detector, |_| noise.sample(&scale, times));
            assert_eq!(index, 999, "{times}: {event:?}");
            let error = done(event).gyroscope_counts - Vector3::new(20.3, -30.8, 5.5);
            let sigma = times * scale.gyroscope_sigma_counts / 1000_f32.sqrt();
            assert!(error.is_within(5.0 * sigma + 0.05), "{error:?}");
        }
    }
}

#[test]
fn vibration_is_motion_once_the_sensor_was_quiet() {
    let scale = coarse();
    let mut noise = Noise(3);
    let mut shaking = |index: u32, amplitude: f32| {
        let (gyroscope, [x, y, z]) = noise.sample(&scale, 1.0);
        let shake = amplitude * scale.counts_per_g * (index as f32 * 0.4).sin();
        (gyroscope, [x, y, z + shake as i16])
    };
    // 50 mg is more than any clone's noise; 25 mg could be a bad one's.
    let mut detector = StationaryDetector::new(&scale, 1000);
    let (index, event) = first_event(&mut detector, |index| shaking(index, 0.1));
    assert_eq!(index, WINDOW - 1);
    assert_eq!(
        event,
        StationaryProgress::Moved(MotionReason::Vibration(Axis::Z))
    );
    let (_, event) = first_event(&mut StationaryDetector::new(&scale, 1000), |index| {
        shaking(index, 0.025)
    });
    assert!(matches!(event, StationaryProgress::Done(_)), "{event:?}");
    // 25 mg after a quiet time is motion.
    let mut detector = StationaryDetector::new(&scale, 1000);
    let (index, event) = first_event(&mut detector, |index| {
        shaking(index, if index < 400 { 0.0 } else { 0.025 })
    });
    assert!(index < 400 + 2 * WINDOW, "{index}");
    assert_eq!(
        event,
        StationaryProgress::Moved(MotionReason::Vibration(Axis::Z))
    );
}

#[test]
fn a_short_movement_restarts_the_average_at_the_end_of_its_window() {
    let mut detector = StationaryDetector::new(&coarse(), 1000);
    // 50 °/s on one sample out of a thousand.
    let bump = |index: u32| ([if index == 640 { 820 } else { 0 }, 0, 0], LEVEL);
    let event = (
        8 * WINDOW - 1,
        StationaryProgress::Moved(MotionReason::Rotation(Axis::X)),
    );
    assert_eq!(first_event(&mut detector, bump), event);
    assert_eq!(detector.progress_percent(), 0);
    // From here on a full average is needed again.
    let (index, event) = first_event(&mut detector, |_| ([3, 0, 0], LEVEL));
    assert_eq!(index, 999);
    assert_eq!(done(event).gyroscope_counts, Vector3::new(3.0, 0.0, 0.0));
}

#[test]
fn progress_goes_from_zero_to_complete() {
    let mut detector = StationaryDetector::new(&coarse(), 1000);
    assert_eq!(detector.progress_percent(), 0);
    for _ in 0..500 {
        detector.update(&reading([0; 3], LEVEL));
    }
    assert_eq!(detector.progress_percent(), 50);
}

#[test]
fn a_movement_in_the_short_last_window_counts_too() {
    let mut detector = StationaryDetector::new(&coarse(), 350);
    let bump = |index: u32| ([if index == 345 { 820 } else { 0 }, 0, 0], LEVEL);
    let (index, event) = first_event(&mut detector, bump);
    assert_eq!(index, 349);
    assert_eq!(
        event,
        StationaryProgress::Moved(MotionReason::Rotation(Axis::X))
    );
}

#[test]
fn a_knock_is_detected_by_the_accelerometer() {
    let mut detector = StationaryDetector::new(&coarse(), 1000);
    let knock = |index: u32| ([0; 3], [0, 0, if index == 10 { 3600 } else { 2048 }]);
    let (index, event) = first_event(&mut detector, knock);
    assert_eq!(index, WINDOW - 1);
    assert_eq!(
        event,
        StationaryProgress::Moved(MotionReason::Vibration(Axis::Z))
    );
}

#[test]
fn a_slow_turn_about_a_level_axis_is_detected_by_the_accelerometer() {
    let mut noise = Noise(5);
    let scale = coarse();
    for degrees_s in [0.5_f32, 1.0, 3.0, 10.0, 19.0] {
        let mut detector = StationaryDetector::new(&scale, 1000);
        let (_, event) = first_event(&mut detector, |index| {
            let angle = (degrees_s * index as f32 * 1e-3).to_radians();
            let ([x, y, z], _) = noise.sample(&scale, 1.0);
            let (_, force) = noise.sample(&scale, 1.0);
            let tilted = [0.0, 2048.0 * angle.sin(), 2048.0 * (angle.cos() - 1.0)];
            let mut force = force;
            for (axis, change) in force.iter_mut().zip(tilted) {
                *axis += change.round() as i16;
            }
            ([x + (degrees_s * 16.4) as i16, y, z], force)
        });
        let tilted = StationaryProgress::Moved(MotionReason::Tilt(Axis::Y));
        let turned = StationaryProgress::Moved(MotionReason::Rotation(Axis::Y));
        assert!(event == tilted || event == turned, "{degrees_s}: {event:?}");
    }
}

#[test]
fn a_slow_turn_is_detected_at_a_low_rate_and_rest_is_none() {
    let mut noise = Noise(6);
    for rate_hz in [4.0_f32, 8.0, 12.5, 20.0, 50.0] {
        let scale = noise_model(16.4, 2048.0, 188.0, 184.0, rate_hz);
        for duration_s in [2.0, 4.0] {
            let samples = (duration_s * rate_hz) as u16;
            let mut detector = StationaryDetector::new(&scale, samples);
            let (_, event) = first_event(&mut detector, |index| {
                let angle = (index as f32 / rate_hz).to_radians();
                let ([x, y, z], _) = noise.sample(&scale, 1.0);
                let (_, [forward, left, up]) = noise.sample(&scale, 1.0);
                let tilt = (2048.0 * angle.sin()).round() as i16;
                ([x + 16, y, z], [forward, left + tilt, up])
            });
            assert!(
                matches!(event, StationaryProgress::Moved(_)),
                "{rate_hz} Hz, {samples}: {event:?}"
            );
            let mut detector = StationaryDetector::new(&scale, samples);
            for _ in 0..200 {
                let (_, event) = first_event(&mut detector, |_| noise.sample(&scale, 1.0));
                assert!(
                    matches!(event, StationaryProgress::Done(_)),
                    "{rate_hz} Hz, {samples}: {event:?}"
                );
            }
        }
    }
}

#[test]
fn a_turn_that_begins_is_not_an_offset() {
    // 1 °/s about the vertical, from the middle on: the accelerometer sees nothing.
    let mut detector = StationaryDetector::new(&coarse(), 1000);
    let turn = |index: u32| ([0, 0, if index < 500 { 0 } else { 16 }], LEVEL);
    let (_, event) = first_event(&mut detector, turn);
    assert_eq!(
        event,
        StationaryProgress::Moved(MotionReason::Rotation(Axis::Z))
    );
}

#[test]
fn a_window_that_differs_from_the_previous_ones_is_motion_without_a_trend() {
    // Turned about the vertical by a tenth of a degree, in the middle: one window of eleven, still
    // in itself.
    let mut detector = StationaryDetector::new(&coarse(), 946);
    let turn = |index: u32| ([0, 0, if index / WINDOW == 5 { 16 } else { 0 }], LEVEL);
    let (index, event) = first_event(&mut detector, turn);
    assert_eq!(index, 6 * WINDOW - 1);
    assert_eq!(
        event,
        StationaryProgress::Moved(MotionReason::Rotation(Axis::Z))
    );
}

#[test]
fn a_saturated_axis_is_refused_by_name() {
    let mut detector = StationaryDetector::new(&coarse(), 1000);
    let (_, event) = first_event(&mut detector, |_| ([0, -32768, 0], LEVEL));
    let reason = MotionReason::GyroscopeSaturated(Axis::Y);
    assert_eq!(event, StationaryProgress::Moved(reason));
    assert_eq!(reason.to_string(), "the gyroscope reads full scale about y");
    let (_, event) = first_event(&mut detector, |index| {
        ([0; 3], [if index == 3 { 32767 } else { 0 }, 0, 2048])
    });
    let reason = MotionReason::AccelerometerSaturated(Axis::X);
    assert_eq!(event, StationaryProgress::Moved(reason));
}

#[test]
fn a_steady_turn_is_an_offset_only_within_the_datasheet() {
    let at = |degrees_s: f32, celsius: f32| {
        let mut detector = StationaryDetector::new(&coarse(), 100);
        let counts = (degrees_s * 16.4) as i16;
        let mut last = StationaryProgress::Collecting;
        for _ in 0..100 {
            last = detector.update(&ImuReading {
                temperature_celsius: celsius,
                ..reading([0, 0, counts], LEVEL)
            });
        }
        matches!(last, StationaryProgress::Done(_))
    };
    assert!(at(20.0, 25.0));
    assert!(at(-20.0, 25.0));
    assert!(!at(22.0, 25.0));
    assert!(!at(-22.0, 25.0));
    // Heat and cold allow more, and no temperature allows everything.
    assert!(at(39.0, 85.0));
    assert!(at(-32.0, -15.0));
    assert!(!at(42.0, 85.0));
    assert!(!at(42.0, 3000.0));
    assert!(!at(42.0, f32::NAN));
    assert!(!at(1900.0, 25.0));
}

#[test]
fn a_sensor_without_gravity_is_not_stationary() {
    for force in [[0, 0, 0], [0, 0, 1500], [1500, 1500, 1500], [-32000; 3]] {
        let mut detector = StationaryDetector::new(&coarse(), 1000);
        let (index, event) = first_event(&mut detector, |_| ([0; 3], force));
        assert_eq!(index, WINDOW - 1);
        assert_eq!(
            event,
            StationaryProgress::Moved(MotionReason::NoGravity),
            "{force:?}"
        );
    }
    // Any pose with one g will do, offsets included.
    for force in [
        [2048, 0, 0],
        [0, -2048, 0],
        [1182, -1182, 1182],
        [0, 0, 2300],
    ] {
        let mut detector = StationaryDetector::new(&coarse(), 1000);
        let (_, event) = first_event(&mut detector, |_| ([0; 3], force));
        assert!(matches!(event, StationaryProgress::Done(_)), "{force:?}");
    }
}

#[test]
fn a_confirmed_offset_shortens_the_average() {
    let scale = coarse();
    let stored = |degrees_s: f32| Vector3::new(radians(degrees_s), 0.0, 0.0);
    let length = |offset: Vector3, sigma: f32| {
        let mut detector =
            StationaryDetector::new(&scale, 1000).with_expected_offset(offset, radians(sigma));
        let (index, event) = first_event(&mut detector, |_| ([33, 0, 0], LEVEL));
        assert!((done(event).gyroscope_counts.x - 33.0).abs() < 1e-6);
        index + 1
    };
    assert_eq!(length(stored(2.0), 0.1), 3 * WINDOW);
    assert_eq!(length(stored(3.0), 0.1), 1000);
    assert_eq!(
        length(stored(2.0), 1.0),
        1000,
        "too vague to prove anything"
    );
}

#[test]
fn the_longest_average_of_the_largest_counts_is_exact() {
    // A scale at which large counts are a plausible offset and a plausible gravity.
    let scale = noise_model(32768.0 / 20.0, 32768.0, 188.0, 184.0, 1000.0);
    for extreme in [i16::MIN + 2, i16::MAX - 1] {
        let mut detector = StationaryDetector::new(&scale, u16::MAX);
        let (index, event) = first_event(&mut detector, |_| ([extreme; 3], [0, 0, extreme]));
        assert_eq!(index, u32::from(u16::MAX) - 1);
        let mean = done(event);
        let expected = f32::from(extreme);
        assert_eq!(
            mean.gyroscope_counts,
            Vector3::new(expected, expected, expected)
        );
        assert_eq!(mean.accelerometer_counts.z, f32::from(extreme));
    }
}

#[test]
fn every_length_ends_on_its_last_sample() {
    for samples in [0, 1, 2, 85, 86, 87, 149, 172, 173, 1001] {
        let mut detector = StationaryDetector::new(&coarse(), samples);
        let (index, event) = first_event(&mut detector, |_| ([1; 3], LEVEL));
        assert_eq!(index, u32::from(samples.max(1)) - 1);
        assert!(matches!(event, StationaryProgress::Done(_)), "{samples}");
    }
}

#[test]
fn narrow_filters_have_long_windows() {
    for (bandwidth, samples) in [(188.0, 86), (42.0, 380), (5.0, 3200), (0.1, 4096)] {
        let scale = noise_model(16.4, 2048.0, bandwidth, bandwidth, 1000.0);
        let detector = StationaryDetector::new(&scale, u16::MAX);
        assert!(
            detector.window_samples.abs_diff(samples) <= 2,
            "{bandwidth}"
        );
    }
    let aliased = noise_model(16.4, 2048.0, 188.0, 184.0, 100.0);
    assert_eq!(aliased.gyroscope_correlation, 1.0);
}
