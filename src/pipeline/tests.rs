//! Tests of the whole pipeline on simulated bursts.

use super::*;
use crate::attitude::{BodyVector, EulerAngles, Quaternion};
use crate::calibration::{
    AccelerometerCorrection, GyroscopeOffset, ImuReading, Matrix3, Mount, StationaryProgress,
    SymmetricMatrix, TemperatureModel,
};
use crate::health::LOST_TILT_RAD;
use crate::mpu6050::{AccelerometerCounts, Config, GyroscopeCounts, Part};
use crate::units::{STANDARD_GRAVITY_M_S2, degrees, radians};

/// Returns the burst of body-axis values (m/s², °/s) from a sensor in this mount at ±16 g and
/// ±2000 °/s.
pub(super) fn burst(
    mount: Mount,
    t_us: u64,
    force_m_s2: Vector3,
    rate_degrees_s: Vector3,
) -> Burst {
    let counts = |body: Vector3, counts_per_unit: f32| {
        let sensor = mount.to_sensor(BodyVector(body)).scale(counts_per_unit);
        [sensor.x, sensor.y, sensor.z].map(|value| value.round() as i16)
    };
    let sample = RawSample {
        accelerometer: AccelerometerCounts(counts(force_m_s2, 2048.0 / STANDARD_GRAVITY_M_S2)),
        temperature: TemperatureCounts(-3920),
        gyroscope: GyroscopeCounts(counts(rate_degrees_s, 16.4)),
    };
    Burst {
        bytes: sample.encode(),
        captured_at_us: t_us,
        missed_before: 0,
    }
}

pub(super) fn force(roll_degrees: f32, pitch_degrees: f32) -> Vector3 {
    let attitude = Quaternion::from_euler(EulerAngles {
        roll_rad: radians(roll_degrees),
        pitch_rad: radians(pitch_degrees),
        yaw_rad: 0.0,
    });
    -attitude.down_in_body().scale(STANDARD_GRAVITY_M_S2)
}

pub(super) const LEVEL: Vector3 = Vector3::new(0.0, 0.0, -STANDARD_GRAVITY_M_S2);

fn update(pipeline: &mut Pipeline, burst: &Burst) -> Snapshot {
    pipeline.update(burst, BoardFlags::empty())
}

pub(super) fn settings() -> Settings {
    Settings::new(&Part::MPU_6050)
}

#[test]
fn the_defaults_are_the_documented_ones() {
    let settings = settings();
    assert_eq!(settings.sensor, Config::default());
    assert_eq!(settings.mount, Mount::default());
    assert!(!settings.verifies_scales);
}

#[test]
fn the_default_filter_finds_the_offset_without_an_average() {
    let mut pipeline = Pipeline::new(&settings());
    let offset = Vector3::new(5.0, -3.0, 10.0);
    let mut last = Snapshot::default();
    let mut known = None;
    for index in 0..4000_u64 {
        // One count of noise, as the last digit of a sensor has it.
        let noise = Vector3::new(0.06, -0.06, 0.06).scale((index % 2) as f32);
        let burst = burst(Mount::Z_UP, index * 1000, LEVEL, offset + noise);
        last = update(&mut pipeline, &burst);
        if !last.flags.contains(Flags::CALIBRATING) {
            known.get_or_insert(index);
        }
    }
    let known = known.expect("an offset");
    assert!((800..2500).contains(&known), "{known} ms");
    assert_eq!(last.flags, Flags::VALID);
    assert!(last.body_rates_rad_s.norm().to_degrees() < 0.2);
    let found = pipeline
        .gyroscope_offset_body_rad_s()
        .scale(1_f32.to_degrees());
    assert!((found - offset).norm() < 0.2, "{found:?}");
    let angles = last.euler();
    assert!(angles.roll_rad.abs() < 0.01 && angles.pitch_rad.abs() < 0.01);

    let mut known = settings();
    known.calibration.gyroscope = Some(GyroscopeOffset {
        offset_rad_s: Mount::Z_UP.to_sensor(BodyVector(pipeline.gyroscope_offset_body_rad_s())),
        temperature_celsius: 25.0,
    });
    let mut pipeline = Pipeline::new(&known);
    let snapshot = update(&mut pipeline, &burst(Mount::Z_UP, 0, LEVEL, offset));
    assert!(snapshot.body_rates_rad_s.norm().to_degrees() < 0.2);
}

#[test]
fn the_delay_of_the_low_pass_filter_is_compensated() {
    let yaw_after = |low_pass, sensor_delay_us| {
        let mut settings = Settings {
            sensor_delay_us,
            ..settings()
        };
        settings.sensor.low_pass = low_pass;
        let mut pipeline = Pipeline::new(&settings);
        let mut last = Snapshot::default();
        for index in 0..10_u64 {
            let turn = Vector3::new(0.0, 0.0, 1000.0);
            last = update(
                &mut pipeline,
                &burst(Mount::Z_UP, index * 1000, LEVEL, turn),
            );
        }
        last.euler().yaw_rad.to_degrees()
    };
    // 9 ms at 1000 °/s, and 4.8 ms more; or the delay of the settings.
    let delayed = yaw_after(crate::mpu6050::LowPass::Hertz42, None);
    assert!((delayed - 13.8).abs() < 0.05, "{delayed}");
    let delayed = yaw_after(crate::mpu6050::LowPass::Hertz42, Some(1_000));
    assert!((delayed - 10.0).abs() < 0.05, "{delayed}");
    // 1.9 ms in ns would be 5 turns and 100° more.
    let delayed = yaw_after(crate::mpu6050::LowPass::Hertz42, Some(1_900_000));
    assert!((delayed - 9.0).abs() < 0.05, "{delayed}");
}

#[test]
fn every_mount_gives_the_same_attitude() {
    let mut stories = Mount::ALL.map(|mount| {
        let mut pipeline = Pipeline::new(&Settings {
            mount,
            ..settings()
        });
        let mut story = Vec::new();
        for index in 0..200_u64 {
            let rate = Vector3::new(30.0, -20.0, 50.0);
            let force = force(0.03 * index as f32, -0.02 * index as f32);
            story.push(update(
                &mut pipeline,
                &burst(mount, index * 1000, force, rate),
            ));
        }
        story
    });
    let [first, others @ ..] = &mut stories;
    assert!(
        first
            .iter()
            .any(|snapshot| snapshot.euler().roll_rad > 0.05)
    );
    for other in others {
        assert_eq!(first, other);
    }
}

/// Returns a calibration with every field set, which describes the sensor's errors exactly.
fn calibration() -> Calibration {
    Calibration {
        mount: Some(Mount::Z_DOWN),
        gyroscope: Some(GyroscopeOffset {
            offset_rad_s: Vector3::new(0.1, -0.2, 0.05),
            temperature_celsius: 25.0,
        }),
        temperature: None,
        accelerometer: Some(AccelerometerCorrection {
            offset_m_s2: Vector3::new(0.3, -0.4, 0.5),
            matrix: SymmetricMatrix {
                xx: 1.02,
                yy: 0.98,
                zz: 1.01,
                xy: 0.01,
                xz: -0.005,
                yz: 0.008,
            },
        }),
        level: Some(Quaternion::from_euler(EulerAngles {
            roll_rad: radians(2.0),
            pitch_rad: radians(-3.0),
            yaw_rad: 0.0,
        })),
        gyroscope_matrix: Some(Matrix3 {
            rows: [
                Vector3::new(1.02, -0.01, 0.005),
                Vector3::new(0.015, 0.97, -0.02),
                Vector3::new(-0.004, 0.012, 1.01),
            ],
        }),
    }
}

#[test]
fn a_calibration_is_applied_step_by_step_in_one_map() {
    let calibration = calibration();
    let mut pipeline = Pipeline::new(&Settings {
        calibration,
        ..settings()
    });
    let raw = RawSample {
        accelerometer: AccelerometerCounts([300, -1200, 1500]),
        temperature: TemperatureCounts(-3920),
        gyroscope: GyroscopeCounts([500, -700, 900]),
    };
    update(
        &mut pipeline,
        &Burst {
            bytes: raw.encode(),
            captured_at_us: 0,
            missed_before: 0,
        },
    );
    // Expected values: one step after the other.
    let config = settings().sensor;
    let reading = raw.accelerometer.to_m_s2(config.accelerometer_range);
    let corrected = calibration.accelerometer.expect("set above").apply(reading);
    let level = calibration.level.expect("set above");
    let force = level.rotate(Mount::Z_DOWN.to_body(corrected).0);
    let rate = raw.gyroscope.to_rad_s(config.gyroscope_range) - Vector3::new(0.1, -0.2, 0.05);
    let matrix = calibration.gyroscope_matrix.expect("set above");
    let rate = level.rotate(Mount::Z_DOWN.to_body(matrix.times(rate)).0);
    let sample = pipeline.sample();
    assert!(
        (sample.specific_force_m_s2 - force).norm() < 1e-5,
        "{sample:?} {force:?}"
    );
    assert!(
        (sample.angular_rate_rad_s - rate).norm() < 1e-6,
        "{sample:?} {rate:?}"
    );
    let offset = pipeline.gyroscope_offset_body_rad_s();
    let offset_in_sensor = matrix.times(Vector3::new(0.1, -0.2, 0.05));
    let expected = level.rotate(Mount::Z_DOWN.to_body(offset_in_sensor).0);
    assert!((offset - expected).norm() < 1e-6);
}

/// Each reading goes in once as a burst and once in SI units, in motion from the first one on.
#[test]
fn readings_in_si_units_give_the_attitude_of_their_bursts() {
    let configured = Settings {
        calibration: calibration(),
        ..settings()
    };
    let mut of_bursts = Pipeline::new(&configured);
    let mut of_readings = Pipeline::new(&configured);
    for index in 0..4_000_u64 {
        let swing = libm::sinf(2.0e-3 * index as f32);
        let force = force(40.0 * swing, 20.0 * swing);
        let rate = Vector3::new(80.0, 40.0, 10.0).scale(libm::cosf(2.0e-3 * index as f32));
        let burst = burst(Mount::Z_DOWN, 1_000 * index, force, rate);
        let raw = RawSample::decode(&burst.bytes);
        let sample = of_readings.calibrated_sample(
            burst.captured_at_us,
            (raw.accelerometer).to_m_s2(configured.sensor.accelerometer_range),
            (raw.gyroscope).to_rad_s(configured.sensor.gyroscope_range),
        );
        let expected = update(&mut of_bursts, &burst);
        let found = of_readings.update_sample(&sample);
        let difference = (found.attitude.conjugate()).multiply(expected.attitude);
        let Quaternion { x, y, z, .. } = difference;
        assert!(
            Vector3::new(x, y, z).norm() < 1e-4,
            "{index}: {difference:?}"
        );
        assert_eq!(found.flags, expected.flags, "{index}");
        let ratio = found.tilt_sigma_rad() / expected.tilt_sigma_rad();
        assert!((ratio - 1.0).abs() < 0.01, "{index}: {ratio}");
    }
}

#[test]
fn readings_without_a_calibration_keep_their_digits() {
    let pipeline = Pipeline::new(&settings());
    let (force, rate) = (Vector3::new(0.1, -0.7, 9.3), Vector3::new(1.1, 1e-7, -3.3));
    let sample = pipeline.calibrated_sample(5, force, rate);
    let mount = Mount::Z_UP;
    assert_eq!(
        sample,
        Sample::new(5, mount.to_body(force), mount.to_body(rate))
    );
}

/// A matrix states that the gyroscope is calibrated: σ grows less in a turn, whether the pipeline
/// starts with the matrix or gets it later.
#[test]
fn a_gyroscope_matrix_narrows_the_prior_of_the_scale() {
    let known = Calibration {
        gyroscope_matrix: Some(Matrix3::IDENTITY),
        ..Calibration::NONE
    };
    let pipeline = |first: Calibration, second: Calibration| {
        let mut pipeline = Pipeline::new(&Settings {
            calibration: first,
            ..settings()
        });
        pipeline.set_calibration(&second);
        pipeline
    };
    let sigma_after_a_turn = |mut pipeline: Pipeline| {
        let mut last = Snapshot::default();
        for index in 0..4_000_u64 {
            let turned = index.saturating_sub(3_000) as f32 * 0.09;
            let rate = if turned > 0.0 { 90.0 } else { 0.0 };
            let rate = Vector3::new(rate, 0.0, 0.0);
            let burst = burst(Mount::Z_UP, index * 1000, force(turned, 0.0), rate);
            last = update(&mut pipeline, &with_noise(burst));
        }
        last.tilt_sigma_rad()
    };
    let factory = sigma_after_a_turn(pipeline(Calibration::NONE, Calibration::NONE));
    let started = sigma_after_a_turn(pipeline(known, known));
    let set = sigma_after_a_turn(pipeline(Calibration::NONE, known));
    let removed = sigma_after_a_turn(pipeline(known, Calibration::NONE));
    assert!(started < 0.95 * factory, "{started} of {factory}");
    assert_eq!((set, removed), (started, factory));
    // What is stated of the accelerometer does not take the matrix away.
    let mut stated = pipeline(known, known);
    stated.set_accelerometer_knowledge(AccelerometerKnowledge::Factory);
    assert_eq!(sigma_after_a_turn(stated), started);
}

/// Twelve poses, or the maker, calibrate both sensors.
#[test]
fn a_calibrated_accelerometer_implies_a_calibrated_gyroscope() {
    use AccelerometerKnowledge::{Calibrated, Factory, SixPoses};
    for (accelerometer, implied, other) in [
        (
            Calibrated,
            GyroscopeKnowledge::Calibrated,
            GyroscopeKnowledge::Factory,
        ),
        (
            SixPoses,
            GyroscopeKnowledge::Factory,
            GyroscopeKnowledge::Calibrated,
        ),
        (
            Factory,
            GyroscopeKnowledge::Factory,
            GyroscopeKnowledge::Calibrated,
        ),
    ] {
        let mut pipeline = Pipeline::new(&settings());
        pipeline.set_accelerometer_knowledge(accelerometer);
        let with = |gyroscope| {
            let mut stated = pipeline;
            stated.set_gyroscope_knowledge(gyroscope);
            stated
        };
        assert!(pipeline == with(implied), "{accelerometer:?}");
        assert!(pipeline != with(other), "{accelerometer:?}");
    }
}

#[test]
fn only_a_new_mount_or_gyroscope_matrix_restarts_the_filter() {
    let mut pipeline = Pipeline::new(&settings());
    let tilted = force(10.0, 0.0);
    let turn = Vector3::new(0.0, 0.0, 30.0);
    for index in 0..1000_u64 {
        let burst = burst(Mount::Z_UP, index * 1000, tilted, turn);
        update(&mut pipeline, &with_noise(burst));
    }
    let yaw = pipeline.estimator.estimate().attitude.to_euler().yaw_rad;
    assert!(yaw.to_degrees() > 20.0, "{yaw}");
    let mut known = Calibration {
        gyroscope: calibration().gyroscope,
        ..Calibration::NONE
    };
    let before = pipeline.gyroscope_offset_body_rad_s();
    pipeline.set_calibration(&known);
    assert!((pipeline.gyroscope_offset_body_rad_s() - before).norm() < 1e-6);
    let after = update(&mut pipeline, &burst(Mount::Z_UP, 1_000_000, tilted, turn));
    assert!((after.euler().yaw_rad - yaw).abs() < radians(0.1));
    let mut with_matrix = pipeline;
    assert!(with_matrix.set_calibration(&Calibration {
        gyroscope_matrix: calibration().gyroscope_matrix,
        ..known
    }));
    let next = burst(Mount::Z_UP, 1_001_000, tilted, turn);
    let after = update(&mut with_matrix, &next);
    assert!(after.euler().yaw_rad.abs() < radians(0.1), "{after:?}");
    known.mount = Some(Mount::Z_DOWN);
    pipeline.set_calibration(&known);
    let after = update(
        &mut pipeline,
        &burst(Mount::Z_DOWN, 1_001_000, tilted, turn),
    );
    assert!(after.euler().yaw_rad.abs() < radians(0.1), "{after:?}");
    assert!((after.euler().roll_rad.to_degrees() - 10.0).abs() < 0.5);
}

#[test]
fn the_temperature_model_moves_the_offset_within_its_range() {
    let mut calibration = Calibration::NONE;
    calibration.temperature = Some(TemperatureModel {
        reference_celsius: 25.0,
        offset_rad_s: Vector3::new(radians(1.0), 0.0, 0.0),
        slope_rad_s_per_celsius: Vector3::new(radians(0.1), 0.0, 0.0),
        curvature_rad_s_per_celsius2: Vector3::ZERO,
        coldest_celsius: 20.0,
        warmest_celsius: 40.0,
    });
    let mut pipeline = Pipeline::new(&Settings {
        calibration,
        ..settings()
    });
    let (mut celsius, mut index) = (25.0_f32, 0);
    // Moves the temperature by 0.45 °C/s, and returns the offset that is removed then.
    let mut offset_at = |end_celsius: f32| {
        for _ in 0..100 + ((end_celsius - celsius).abs() / 0.000_45) as u32 {
            celsius += (end_celsius - celsius).clamp(-0.000_45, 0.000_45);
            let mut sample = RawSample::decode(&burst(Mount::Z_UP, 0, LEVEL, Vector3::ZERO).bytes);
            sample.temperature = TemperatureCounts(((celsius - 36.53) * 340.0) as i16);
            let burst = Burst {
                bytes: sample.encode(),
                captured_at_us: index * 1000,
                missed_before: 0,
            };
            update(&mut pipeline, &with_noise(burst));
            index += 1;
        }
        pipeline.alignment.gyroscope_offset_rad_s().x.to_degrees()
    };
    for (celsius, expected) in [
        (25.0, 1.0),
        (40.0, 2.5),
        (45.0, 3.0),
        // Beyond the range and its margin the last value holds.
        (70.0, 3.0),
        (20.0, 0.5),
    ] {
        let offset = offset_at(celsius);
        assert!((offset - expected).abs() < 0.01, "{celsius}: {offset}");
    }
}

/// Returns the whole offset about the forward axis after a tenth of a second, °/s. At 25 °C a
/// model removes nothing, and 0.1 °/s more per °C.
fn offset_with_model(celsius_at: impl Fn(u64) -> f32, prepare: impl FnOnce(&mut Pipeline)) -> f32 {
    let mut settings = settings();
    settings.calibration.temperature = Some(TemperatureModel {
        reference_celsius: 25.0,
        offset_rad_s: Vector3::ZERO,
        slope_rad_s_per_celsius: Vector3::new(radians(0.1), 0.0, 0.0),
        curvature_rad_s_per_celsius2: Vector3::ZERO,
        coldest_celsius: 20.0,
        warmest_celsius: 60.0,
    });
    let mut pipeline = Pipeline::new(&settings);
    prepare(&mut pipeline);
    for index in 0..100 {
        let mut burst = noisy(index * 1_000, LEVEL);
        let mut sample = RawSample::decode(&burst.bytes);
        sample.temperature = TemperatureCounts(((celsius_at(index) - 36.53) * 340.0) as i16);
        burst.bytes = sample.encode();
        update(&mut pipeline, &burst);
    }
    pipeline.gyroscope_offset_body_rad_s().x.to_degrees()
}

#[test]
fn a_first_temperature_that_is_wrong_does_not_last() {
    let offset = offset_with_model(|index| if index == 0 { 45.0 } else { 25.0 }, |_| {});
    assert!(offset.abs() < 0.1, "{offset}");
}

#[test]
fn a_kept_offset_stays_when_the_model_begins() {
    let start = WarmStart {
        attitude: Quaternion::IDENTITY,
        tilt_sigma_rad: 0.01,
        bias_rad_s: Vector3::new(radians(1.0), 0.0, 0.0),
        bias_change_rad_s: Vector3::ZERO,
        bias_sigma_rad_s: radians(0.05),
        accelerometer_bias_m_s2: [0.0; 2],
        squared_velocity_m2_s2: 0.0,
    };
    let offset = offset_with_model(|_| 45.0, |pipeline| assert!(pipeline.resume(&start, 0)));
    assert!((offset - 1.0).abs() < 0.1, "{offset}");
}

/// The model must not move the whole offset by what it removes or leaves.
#[test]
fn the_whole_offset_stays_where_the_model_fades_and_where_it_begins() {
    for stored_deg_s in [None, Some(0.5)] {
        let mut settings = settings();
        settings.calibration.temperature = Some(TemperatureModel {
            reference_celsius: 25.0,
            offset_rad_s: Vector3::new(radians(2.0), 0.0, 0.0),
            slope_rad_s_per_celsius: Vector3::ZERO,
            curvature_rad_s_per_celsius2: Vector3::ZERO,
            coldest_celsius: 20.0,
            warmest_celsius: 30.0,
        });
        settings.calibration.gyroscope = stored_deg_s.map(|degrees_s| GyroscopeOffset {
            offset_rad_s: Vector3::new(radians(degrees_s), 0.0, 0.0),
            temperature_celsius: 10.0,
        });
        let mut pipeline = Pipeline::new(&settings);
        // From the middle of the fade below the range into it, and out above.
        let (mut before, mut largest) = (None, 0.0_f32);
        for index in 1..30_000 {
            let celsius = 10.0 + index as f32 * 0.001_2;
            let mut burst = noisy(index * 1_000, LEVEL);
            let mut sample = RawSample::decode(&burst.bytes);
            sample.temperature = TemperatureCounts(((celsius - 36.53) * 340.0) as i16);
            burst.bytes = sample.encode();
            update(&mut pipeline, &burst);
            let offset = pipeline.gyroscope_offset_body_rad_s();
            // The first rest measures the offset.
            if index > 3_000 {
                let before: Vector3 = before.unwrap_or(offset);
                largest = largest.max((offset - before).norm());
            }
            before = Some(offset);
        }
        assert!(largest < radians(0.02), "{stored_deg_s:?}: {largest}");
    }
}

/// The offset of another temperature tells nothing, as if none were stored.
#[test]
fn an_offset_that_was_stored_far_from_the_temperature_does_not_count() {
    for (celsius, is_known) in [(25.0, true), (29.0, true), (31.0, false), (60.0, false)] {
        let mut settings = settings();
        settings.calibration.gyroscope = Some(GyroscopeOffset {
            offset_rad_s: Vector3::ZERO,
            temperature_celsius: 25.0,
        });
        let mut pipeline = Pipeline::new(&settings);
        let mut flags = Flags::empty();
        // For less than the second that a rest takes.
        for index in 1..400 {
            let mut burst = noisy(index * 1_000, LEVEL);
            let mut sample = RawSample::decode(&burst.bytes);
            sample.temperature = TemperatureCounts(((celsius - 36.53) * 340.0) as i16);
            burst.bytes = sample.encode();
            flags = update(&mut pipeline, &burst).flags;
        }
        assert_eq!(!flags.contains(Flags::CALIBRATING), is_known, "{celsius}");
    }
}

/// Without a temperature model the offset may follow the temperature.
#[test]
fn a_temperature_that_changes_widens_the_bias_unless_a_model_follows_it() {
    let sigma_rad_s = |celsius_per_minute: f32, has_model: bool| {
        let mut settings = settings();
        settings.calibration.temperature = has_model.then_some(TemperatureModel {
            reference_celsius: 25.0,
            offset_rad_s: Vector3::ZERO,
            slope_rad_s_per_celsius: Vector3::ZERO,
            curvature_rad_s_per_celsius2: Vector3::ZERO,
            coldest_celsius: 20.0,
            warmest_celsius: 60.0,
        });
        let mut pipeline = Pipeline::new(&settings);
        for index in 1..20_000 {
            let mut burst = noisy(index * 1_000, LEVEL);
            let mut sample = RawSample::decode(&burst.bytes);
            let celsius = 30.0 + celsius_per_minute * index as f32 / 60_000.0;
            sample.temperature = TemperatureCounts(((celsius - 36.53) * 340.0) as i16);
            burst.bytes = sample.encode();
            update(&mut pipeline, &burst);
        }
        pipeline.kalman().largest_bias_sigma_rad_s()
    };
    let steady = sigma_rad_s(0.0, false);
    let warming = sigma_rad_s(6.0, false);
    assert!(warming > 1.3 * steady, "{warming} {steady}");
    let followed = sigma_rad_s(6.0, true);
    assert!(followed < 1.2 * steady, "{followed} {steady}");
}

#[test]
fn a_stationary_mean_is_collected_while_the_pipeline_runs() {
    let expected = Vector3::new(radians(1.0), radians(-2.0), radians(-3.0));
    for is_stored in [false, true] {
        let mut settings = settings();
        settings.calibration.gyroscope = is_stored.then_some(GyroscopeOffset {
            offset_rad_s: expected,
            temperature_celsius: 25.0,
        });
        let mut pipeline = Pipeline::new(&settings);
        let mut detector = pipeline.stationary_detector(500);
        let mut done = None;
        for index in 0..500_u64 {
            let rate = Vector3::new(1.0, 2.0, 3.0);
            let burst = burst(Mount::Z_UP, index * 1000, LEVEL, rate);
            update(&mut pipeline, &burst);
            let raw = RawSample::decode(&burst.bytes);
            let reading = ImuReading {
                gyroscope: raw.gyroscope.0,
                accelerometer: raw.accelerometer.0,
                temperature_celsius: pipeline.temperature_celsius(),
            };
            match detector.update(&reading) {
                StationaryProgress::Done(at_rest) => done = Some((index, at_rest)),
                progress => assert_eq!(progress, StationaryProgress::Collecting, "{index}"),
            }
        }
        let (index, at_rest) = done.expect("it is stationary");
        assert_eq!(index, 499);
        let offset = at_rest.gyroscope_offset(&pipeline.settings().noise_model());
        assert!(
            (offset.offset_rad_s - expected).is_within(radians(0.04)),
            "{offset:?}"
        );
        let force = pipeline.mounted_force_m_s2(&at_rest);
        assert!((force - LEVEL).norm() < 0.01, "{force:?}");
    }
}

#[test]
fn the_signs_of_the_sensor_reach_the_snapshot() {
    let mut pipeline = Pipeline::new(&settings());
    let rates = Vector3::new(1.0, -2.0, 3.0);
    let snapshot = update(
        &mut pipeline,
        &burst(Mount::Z_UP, 0, force(30.0, 10.0), rates),
    );
    let angles = snapshot.euler();
    assert!((angles.roll_rad.to_degrees() - 30.0).abs() < 0.05);
    assert!((angles.pitch_rad.to_degrees() - 10.0).abs() < 0.05);
    let rates = snapshot.body_rates_rad_s;
    assert!((rates.x.to_degrees() - 1.0).abs() < 0.05);
    assert!((rates.y.to_degrees() + 2.0).abs() < 0.05);
    assert!((rates.z.to_degrees() - 3.0).abs() < 0.05);
}

#[test]
fn full_scale_is_flagged_and_blank_data_rejected_at_every_range_and_with_every_correction() {
    use crate::mpu6050::{AccelerometerRange, GyroscopeRange};
    let accelerometer = [
        AccelerometerRange::G2,
        AccelerometerRange::G4,
        AccelerometerRange::G8,
        AccelerometerRange::G16,
    ];
    let gyroscope = [
        GyroscopeRange::Degrees250,
        GyroscopeRange::Degrees500,
        GyroscopeRange::Degrees1000,
        GyroscopeRange::Degrees2000,
    ];
    let offset = 0.2 * STANDARD_GRAVITY_M_S2;
    // The largest corrections that a fit may have, by which readings grow and shrink most.
    let corrections = [
        (1.0, 0.0, 0.0),
        (0.9, -0.1, 1.0),
        (0.9, 0.1, -1.0),
        (1.1, 0.1, -1.0),
    ];
    for (range, (diagonal, cross, sign)) in
        (0..4).flat_map(|range| corrections.map(|correction| (range, correction)))
    {
        let mut settings = settings();
        settings.sensor.accelerometer_range = accelerometer[range];
        settings.sensor.gyroscope_range = gyroscope[range];
        settings.calibration.accelerometer = Some(AccelerometerCorrection {
            offset_m_s2: Vector3::new(sign * offset, sign * offset, sign * offset),
            matrix: SymmetricMatrix {
                xx: diagonal,
                yy: diagonal,
                zz: diagonal,
                xy: cross,
                xz: cross,
                yz: cross,
            },
        });
        settings.calibration.gyroscope = Some(GyroscopeOffset {
            offset_rad_s: Vector3::new(radians(40.0), radians(40.0), radians(-40.0)),
            temperature_celsius: 25.0,
        });
        let g = settings.sensor.accelerometer_range.counts_per_g() as i16;
        let mut pipeline = Pipeline::new(&settings);
        let mut t_us = 0;
        let mut flags = |accelerometer: [i16; 3], temperature, gyroscope: [i16; 3]| {
            t_us += 1_000;
            let sample = RawSample {
                accelerometer: AccelerometerCounts(accelerometer),
                temperature: TemperatureCounts(temperature),
                gyroscope: GyroscopeCounts(gyroscope),
            };
            let burst = Burst {
                bytes: sample.encode(),
                captured_at_us: t_us,
                missed_before: 0,
            };
            update(&mut pipeline, &burst).flags
        };
        let seldom = Flags::GYROSCOPE_SATURATED | Flags::ACCELEROMETER_SATURATED | Flags::REJECTED;
        for full in [i16::MIN, -i16::MAX, i16::MAX] {
            for axis in 0..3 {
                for others in [0, g / 3] {
                    let mut rate = [others; 3];
                    rate[axis] = full;
                    let found = flags([0, 0, g], -3920, rate) & seldom;
                    assert_eq!(found, Flags::GYROSCOPE_SATURATED, "{range} {rate:?}");
                    assert_eq!(flags([0, 0, g], -3920, [0; 3]) & seldom, Flags::empty());
                    let mut force = [others; 3];
                    force[axis] = full;
                    let found = flags(force, -3920, [0; 3]) & seldom;
                    assert_eq!(found, Flags::ACCELEROMETER_SATURATED, "{range} {force:?}");
                    assert_eq!(flags([0, 0, g], -3920, [0; 3]) & seldom, Flags::empty());
                }
            }
        }
        for blank in [0, -1] {
            let found = flags([blank; 3], blank, [blank; 3]) & seldom;
            assert_eq!(found, Flags::REJECTED, "{range} {blank}");
        }
    }
}

#[test]
fn a_step_that_is_a_millisecond_after_the_counter_s_wrap_is_a_gap() {
    let mut pipeline = Pipeline::new(&settings());
    let mut flags = |t_us| {
        update(
            &mut pipeline,
            &burst(Mount::Z_UP, t_us, LEVEL, Vector3::ZERO),
        )
        .flags
    };
    for index in 1..10 {
        assert_eq!(flags(index * 1_000) & Flags::GAP, Flags::empty());
    }
    // 32 bits of the step are those of one millisecond.
    assert_eq!(flags(10_000 + (1 << 32)) & Flags::GAP, Flags::GAP);
    assert_eq!(flags(11_000) & Flags::TIME, Flags::TIME);
}

/// Returns a sample of a body that has rolled to this angle at this rate (degrees, °/s), with one
/// count of noise.
fn rolled(t_us: u64, roll_degrees: f32, rate_degrees_s: f32) -> Sample {
    let noise = Vector3::new(0.06, -0.06, 0.06).scale((t_us / 1_000 % 2) as f32);
    let rate = Vector3::new(rate_degrees_s, 0.0, 0.0) + noise;
    let force = force(roll_degrees, 0.0) + noise.scale(0.1);
    Sample::new(
        t_us,
        BodyVector(force),
        BodyVector(rate.scale(radians(1.0))),
    )
}

/// Returns a pipeline after three seconds of level rest, each millisecond.
fn rested() -> Pipeline {
    let mut pipeline = Pipeline::new(&settings());
    for millisecond in 0..3_000 {
        pipeline.update_sample(&rolled(1_000 * millisecond, 0.0, 0.0));
    }
    pipeline
}

/// Returns the error of a snapshot's roll, in degrees.
fn roll_error(snapshot: &Snapshot, roll_degrees: f32) -> f32 {
    (snapshot.euler().roll_rad.to_degrees() - roll_degrees).abs()
}

#[test]
fn samples_that_change_places_turn_the_attitude_once() {
    let roll = |t_us: u64| 40.0 * (t_us as f32 * 1e-6 - 3.0);
    for mut from_bursts in [None, Some(rested())] {
        let mut pipeline = rested();
        // Two and two change places: 3001, 3000, 3003, 3002 ms and so on.
        for pair in 1_500..2_000 {
            for t_us in [2_000 * pair + 1_000, 2_000 * pair] {
                let sample = rolled(t_us, roll(t_us), 40.0);
                let snapshot = match &mut from_bursts {
                    None => pipeline.update_sample(&sample),
                    Some(pipeline) => {
                        let rate = sample.angular_rate_rad_s.scale(degrees(1.0));
                        let force = sample.specific_force_m_s2;
                        update(pipeline, &burst(Mount::Z_UP, t_us, force, rate))
                    }
                };
                let is_late = t_us % 2_000 == 0;
                assert_eq!(snapshot.t_us, t_us);
                assert_eq!(snapshot.flags.contains(Flags::TIME), is_late, "{t_us}");
                assert_eq!(snapshot.flags.contains(Flags::VALID), !is_late, "{t_us}");
                // A late sample gets the attitude of the one before, a millisecond later.
                let error = roll_error(&snapshot, roll(t_us));
                assert!(error < 0.5, "{t_us}: {error}");
            }
        }
    }
}

#[test]
fn samples_that_come_twice_change_nothing() {
    let (mut once, mut twice) = (rested(), rested());
    for t_us in (3_000..4_000).map(|millisecond| 1_000 * millisecond) {
        let sample = rolled(t_us, 0.0, 0.0);
        let expected = once.update_sample(&sample);
        assert_eq!(twice.update_sample(&sample), expected);
        let again = twice.update_sample(&sample);
        assert_eq!(again.attitude, expected.attitude);
        assert!(again.flags.contains(Flags::TIME) && !again.flags.contains(Flags::VALID));
    }
}

/// Each late sample counts for a sample period at least, though the clock shows no time.
#[test]
fn a_clock_that_stands_still_hides_motion() {
    let mut pipeline = rested();
    assert!(pipeline.kalman().is_still());
    for _ in 0..300 {
        let snapshot = pipeline.update_sample(&rolled(2_999_000, 0.0, 0.0));
        assert!(!snapshot.flags.contains(Flags::VALID));
    }
    let sigma = pipeline
        .update_sample(&rolled(3_000_000, 0.0, 0.0))
        .tilt_sigma_rad();
    // 30 °/s per axis for 0.3 s.
    assert!(sigma > radians(9.0), "{}", degrees(sigma));
    assert!(!pipeline.kalman().is_still(), "the rest has ended");
}

#[test]
fn a_clock_that_is_set_back_never_gives_a_valid_attitude_that_is_wrong() {
    for back_us in [20_000, 100_000, 499_000, 502_000, 1_000_000, 2_900_000] {
        // The body rolls by 100 °/s in the time that the clock is set back, by 70° at most.
        let roll = (1e-4 * back_us as f32).min(70.0);
        let mut pipeline = rested();
        let mut valid = 0;
        for millisecond in 0..3_000 {
            let t_us = 3_000_000 - back_us + 1_000 * millisecond;
            let snapshot = pipeline.update_sample(&rolled(t_us, roll, 0.0));
            assert!(millisecond > 0 || snapshot.flags.contains(Flags::TIME));
            if snapshot.flags.contains(Flags::VALID) {
                valid += 1;
                let limit = (6.0 * snapshot.tilt_sigma_rad().to_degrees()).max(5.0);
                let error = roll_error(&snapshot, roll);
                assert!(error < limit, "{back_us} {millisecond}: {error}");
            }
        }
        assert!(valid > 2_000, "{back_us}: {valid}");
    }
}

#[test]
fn faults_are_flagged_on_their_sample_and_nowhere_else() {
    let mut pipeline = Pipeline::new(&settings());
    let mut t_us = 0;
    let mut update = |force, rate, step_us: i64, missed| {
        t_us += step_us;
        let mut burst = burst(Mount::Z_UP, t_us as u64, force, rate);
        burst.missed_before = missed;
        // The flags of σ and offset are not tested here.
        let flags = update(&mut pipeline, &burst).flags;
        flags - (Flags::CALIBRATING | Flags::MOVED | Flags::DEGRADED | Flags::VALID)
    };
    let still = Vector3::ZERO;
    let fast = Vector3::new(0.0, 0.0, 3000.0);
    let hard = Vector3::new(0.0, 0.0, 300.0);
    assert_eq!(update(LEVEL, still, 1000, 0), Flags::empty());
    assert_eq!(update(LEVEL, still, 1000, 3), Flags::MISSED);
    assert_eq!(update(LEVEL, fast, 1000, 0), Flags::GYROSCOPE_SATURATED);
    assert_eq!(update(LEVEL, still, 1000, 0), Flags::empty());
    assert_eq!(update(hard, still, 1000, 0), Flags::ACCELEROMETER_SATURATED);
    assert_eq!(update(still, still, 1000, 0), Flags::FREE_FALL);
    assert_eq!(update(LEVEL, still, 500_000, 0), Flags::empty());
    assert_eq!(update(LEVEL, still, 500_001, 0), Flags::GAP);
    assert_eq!(update(LEVEL, still, -5, 0), Flags::TIME);
    assert_eq!(update(LEVEL, still, 0, 255), Flags::TIME | Flags::MISSED);
    assert_eq!(update(LEVEL, still, 1000, 0), Flags::empty());
}

/// Returns a pipeline after three seconds at rest with one count of noise, and the time in µs.
fn settled() -> (Pipeline, u64) {
    settled_with(&settings(), LEVEL)
}

/// Returns a pipeline with these settings that has settled on this specific force, and the time.
fn settled_with(settings: &Settings, force_m_s2: Vector3) -> (Pipeline, u64) {
    let mut pipeline = Pipeline::new(settings);
    for index in 0..3000 {
        let burst = noisy(index * 1000, force_m_s2);
        update(&mut pipeline, &burst);
    }
    let flags = update(&mut pipeline, &noisy(3_000_000, force_m_s2)).flags;
    assert_eq!(flags, Flags::VALID);
    (pipeline, 3_000_000)
}

/// Returns settings with an offset that was stored for the forward axis, °/s, at the bursts'
/// temperature. With the first burst the filter restarts.
fn with_stored_offset(degrees_s: f32) -> Settings {
    let mut settings = settings();
    settings.calibration.gyroscope = Some(GyroscopeOffset {
        offset_rad_s: Vector3::new(radians(degrees_s), 0.0, 0.0),
        temperature_celsius: 25.0,
    });
    settings
}

/// Returns a burst without rotation, never equal to the previous one.
fn noisy(t_us: u64, force_m_s2: Vector3) -> Burst {
    with_noise(burst(Mount::Z_UP, t_us, force_m_s2, Vector3::ZERO))
}

/// Changes the lowest bit of each axis at times of its own, because no sensor repeats its readings.
fn with_noise(mut burst: Burst) -> Burst {
    let milliseconds = burst.captured_at_us / 1000;
    for (place, period) in [(1, 3), (3, 4), (5, 6), (9, 7), (11, 9), (13, 2)] {
        burst.bytes[place] ^= u8::from(milliseconds.is_multiple_of(period));
    }
    burst
}

#[test]
fn a_stored_offset_leaves_the_length_of_a_pause_known() {
    let (mut pipeline, t_us) = settled_with(&with_stored_offset(0.0), LEVEL);
    let sigma = update(&mut pipeline, &noisy(t_us + 200_000, LEVEL)).tilt_sigma_rad();
    // 30 °/s per axis for 0.2 s.
    assert!(sigma > radians(6.0), "{}", degrees(sigma));
}

/// Armed before the first burst, a pipeline measures no turn as the offset.
#[test]
fn a_stored_offset_leaves_the_pipeline_armed() {
    let mut pipeline = Pipeline::new(&with_stored_offset(0.0));
    pipeline.set_armed(true);
    let turn = Vector3::new(0.0, 0.0, 10.0);
    for millisecond in 0..8_000 {
        let burst = burst(Mount::Z_UP, 1_000 * millisecond, LEVEL, turn);
        update(&mut pipeline, &with_noise(burst));
        let offset = pipeline.gyroscope_offset_body_rad_s();
        assert!(offset.is_within(radians(0.5)), "{millisecond}: {offset:?}");
    }
}

#[test]
fn a_rejected_sample_is_not_valid_and_changes_nothing() {
    for byte in [0x00, 0xFF] {
        let (mut pipeline, t_us) = settled();
        let attitude = pipeline.estimator.estimate().attitude;
        for step in 1..=300 {
            let snapshot = update(
                &mut pipeline,
                &Burst {
                    bytes: [byte; 14],
                    captured_at_us: t_us + step * 1000,
                    missed_before: 0,
                },
            );
            assert!(snapshot.flags.contains(Flags::REJECTED | Flags::DEGRADED));
            assert!(!snapshot.flags.contains(Flags::VALID));
            assert_eq!(snapshot.attitude, attitude);
        }
        // The first good sample may still have the flag of frozen data.
        for step in 301..312 {
            update(&mut pipeline, &noisy(t_us + step * 1000, LEVEL));
        }
        let after = update(&mut pipeline, &noisy(t_us + 312_000, LEVEL));
        assert!(after.flags.contains(Flags::VALID), "{}", after.flags);
    }
}

#[test]
fn sigma_grows_while_samples_are_missing_and_the_next_one_keeps_it() {
    let (mut pipeline, t_us) = settled();
    let after = |pipeline: &Pipeline, age_us| {
        let stale = pipeline.stale(t_us + age_us, BoardFlags::BUS_FAULT);
        let flags = Flags::STALE | Flags::DEGRADED | Flags::BUS_FAULT;
        assert_eq!((stale.t_us, stale.flags), (t_us + age_us, flags));
        stale.tilt_variance_rad2
    };
    let before = after(&pipeline, 0);
    assert_eq!(after(&pipeline, 3_000), before);
    let mut last = before;
    for age_ms in [5, 20, 100, 300] {
        let variance = after(&pipeline, age_ms * 1000);
        assert!(variance > last, "{age_ms} ms");
        last = variance;
    }
    // 30 °/s per axis for 0.3 s.
    let sigma_deg = libm::sqrtf(last - before).to_degrees();
    assert!((sigma_deg - 12.73).abs() < 0.01, "{sigma_deg}");
    let next = update(&mut pipeline, &noisy(t_us + 300_000, LEVEL));
    assert_eq!(next.flags, Flags::VALID | Flags::DEGRADED);
    let kept = next.tilt_variance_rad2;
    assert!((kept / last - 1.0).abs() < 1e-3, "{kept} {last}");
    let flags = update(&mut pipeline, &noisy(t_us + 301_000, LEVEL)).flags;
    assert_eq!(flags, Flags::VALID | Flags::DEGRADED);
}

#[test]
fn a_gyroscope_stuck_at_full_scale_gives_no_valid_attitude() {
    for milliseconds in [1, 5, 9, 11, 50, 400] {
        let (mut pipeline, t_us) = settled();
        for step in 1..=milliseconds {
            let mut raw = RawSample::decode(&noisy(t_us + step * 1000, LEVEL).bytes);
            raw.gyroscope.0[0] = i16::MAX;
            let snapshot = update(
                &mut pipeline,
                &Burst {
                    bytes: raw.encode(),
                    captured_at_us: t_us + step * 1000,
                    missed_before: 0,
                },
            );
            assert!(!snapshot.flags.contains(Flags::VALID));
        }
        for step in milliseconds + 1..milliseconds + 300 {
            let snapshot = update(&mut pipeline, &noisy(t_us + step * 1000, LEVEL));
            let error = libm::acosf(snapshot.attitude.down_in_body().z.min(1.0));
            let sigma = snapshot.tilt_sigma_rad();
            let allowed = (6.0 * sigma).max(radians(5.0));
            let is_valid = snapshot.flags.contains(Flags::VALID);
            assert!(error < allowed || !is_valid, "{step}: {error} {sigma}");
            assert!(is_valid || step < milliseconds + 10, "{step}");
        }
    }
}

/// Bits that flip on the bus: the filter turns by a rate that never was.
#[test]
fn sigma_covers_a_false_jump_of_the_rate() {
    for (step_us, sigma_deg) in [(1_000, 1.5..4.0), (10_000, 8.0..15.0)] {
        let (mut pipeline, t_us) = settled();
        for step in 1..5 {
            let mut burst = noisy(t_us + step * step_us, LEVEL);
            let mut raw = RawSample::decode(&burst.bytes);
            // 1,000 °/s for one sample.
            raw.gyroscope.0[1] += if step == 1 { 16_384 } else { 0 };
            burst.bytes = raw.encode();
            let snapshot = update(&mut pipeline, &burst);
            let error = degrees(libm::acosf(snapshot.attitude.down_in_body().z.min(1.0)));
            let sigma = degrees(snapshot.tilt_sigma_rad());
            if step == 1 {
                assert!(!snapshot.flags.contains(Flags::VALID));
            } else {
                let is_covered = error < sigma && sigma_deg.contains(&sigma);
                assert!(is_covered, "{step} of {step_us}: {error} {sigma}");
            }
        }
    }
}

/// Returns σ and the error of the tilt, degrees, with the sample after a jump of the rate about
/// the right axis in a step of this length. The jump is in °/s.
fn after_a_jump(rate_degrees_s: f32, step_us: u64) -> (f32, f32) {
    let (mut pipeline, t_us) = settled();
    let mut burst = noisy(t_us + step_us, LEVEL);
    let mut raw = RawSample::decode(&burst.bytes);
    raw.gyroscope.0[1] += (16.4 * rate_degrees_s) as i16;
    burst.bytes = raw.encode();
    update(&mut pipeline, &burst);
    let next = update(&mut pipeline, &noisy(t_us + 2 * step_us, LEVEL));
    let error = libm::acosf(next.attitude.down_in_body().z.min(1.0));
    (degrees(next.tilt_sigma_rad()), degrees(error))
}

/// After a longer step the filter adds the change of the rate to σ itself.
#[test]
fn a_jump_of_the_rate_counts_once() {
    // 500 °/s for 14 ms are 7.0° about either axis, and a quarter of it for 16 ms is 2°.
    let (short_deg, _) = after_a_jump(500.0, 14_000);
    let (long_deg, _) = after_a_jump(500.0, 16_000);
    assert!((9.0..16.0).contains(&short_deg), "{short_deg}");
    assert!((2.0..8.0).contains(&long_deg), "{long_deg}");
}

#[test]
fn after_a_large_jump_of_the_rate_gravity_shows_the_tilt() {
    // 19° and 13°.
    let (_, lost_deg) = after_a_jump(1_900.0, 10_000);
    let (_, kept_deg) = after_a_jump(1_300.0, 10_000);
    assert!(lost_deg < 1.0, "{lost_deg}");
    assert!(kept_deg > 10.0, "{kept_deg}");
}

/// No sensor of this family gives such a rate, saturated or not.
#[test]
fn an_impossible_rate_is_rejected_also_at_full_scale() {
    for rate_rad_s in [101.0, 1.0e6, f32::INFINITY, f32::NAN] {
        let (mut pipeline, t_us) = settled();
        let usual = *pipeline.sample();
        let snapshot = pipeline.update_sample(&Sample {
            t_us: t_us + 1_000,
            angular_rate_rad_s: Vector3::new(0.0, rate_rad_s, 0.0),
            is_rate_saturated: true,
            ..usual
        });
        assert!(snapshot.flags.contains(Flags::REJECTED), "{rate_rad_s}");
        assert_eq!(*pipeline.sample(), usual, "{rate_rad_s}");
    }
}

#[test]
fn no_rejected_sample_is_the_last_measurement() {
    let (mut pipeline, t_us) = settled();
    let usual = *pipeline.sample();
    let next = |rate_rad_s: f32, step: u64| Sample {
        t_us: t_us + 1_000 * step,
        angular_rate_rad_s: Vector3::new(rate_rad_s, 0.0, 0.0),
        ..usual
    };
    for rate_rad_s in [f32::NAN, f32::INFINITY, 2.0e32] {
        let snapshot = pipeline.update_sample(&next(rate_rad_s, 1));
        assert!(snapshot.flags.contains(Flags::REJECTED));
        assert_eq!(*pipeline.sample(), usual);
    }
    // A jump of the rate is judged by the last measurement.
    let jump = pipeline.update_sample(&next(20.0, 2));
    assert!(jump.tilt_sigma_rad() > 0.0, "{}", jump.tilt_sigma_rad());
}

/// A sensor that repeats its registers for three seconds.
#[test]
fn frozen_data_measure_no_offset() {
    let mut pipeline = Pipeline::new(&settings());
    for step in 1..=3_000 {
        let frozen = burst(Mount::Z_UP, step * 1_000, LEVEL, Vector3::ZERO);
        let flags = update(&mut pipeline, &frozen).flags;
        assert!(flags.contains(Flags::CALIBRATING), "{step}");
    }
    let flags = update(&mut pipeline, &noisy(3_001_000, LEVEL)).flags;
    assert!(flags.contains(Flags::CALIBRATING), "{flags:?}");
}

/// A sensor at rest whose gyroscope reads this rate, in °/s, while its readings repeat: one that
/// was turning before, or whose self-test a flipped register has switched on.
#[test]
fn frozen_data_are_a_pause() {
    const FLAGGED: u64 = 22;
    for rate_degrees_s in [0.0, 100.0, 310.0] {
        for milliseconds in [23, 24, 26, 30, 100, 300, 490, 800, 3_000] {
            let (mut pipeline, t_us) = settled();
            let rate = Vector3::new(rate_degrees_s, 0.0, 0.0);
            let frozen = burst(Mount::Z_UP, 0, LEVEL, rate);
            let mut held = Snapshot::default();
            for step in 1..=milliseconds {
                let captured_at_us = t_us + step * 1000;
                let burst = Burst {
                    captured_at_us,
                    ..frozen
                };
                let snapshot = update(&mut pipeline, &burst);
                if step <= FLAGGED {
                    held = snapshot;
                    continue;
                }
                assert_eq!(snapshot.flags, Flags::FROZEN | Flags::DEGRADED, "{step}");
                assert_eq!(snapshot.attitude, held.attitude);
                assert_eq!(snapshot.t_us, captured_at_us);
            }
            for step in milliseconds + 1..milliseconds + 300 {
                let snapshot = update(&mut pipeline, &noisy(t_us + step * 1000, LEVEL));
                let error = libm::acosf(snapshot.attitude.down_in_body().z.min(1.0));
                let allowed = (6.0 * snapshot.tilt_sigma_rad()).max(radians(5.0));
                let is_valid = snapshot.flags.contains(Flags::VALID);
                let case = (rate_degrees_s, milliseconds, step);
                assert!(error < allowed || !is_valid, "{case:?}: {error} {allowed}");
                // From 0.3 s on the tilt comes from the mean force of 0.15 s.
                let invalid = if milliseconds >= 300 { 180 } else { 10 };
                assert!(is_valid || step < milliseconds + invalid, "{case:?}");
            }
        }
    }
}

/// Rolls at 50 °/s for 0.4 s, while the gyroscope's forward axis reads zero for 0.3 s.
#[test]
fn a_stuck_axis_is_frozen_and_gravity_shows_the_tilt_afterwards() {
    let (mut pipeline, t_us) = settled();
    let mut was_frozen = false;
    for step in 1..=800_u64 {
        let is_stuck = step <= 300;
        let roll_degrees = 50.0e-3 * step.min(400) as f32;
        let rate_degrees_s = if step < 400 { 50.0 } else { 0.0 };
        let captured_at_us = t_us + step * 1_000;
        let rate = Vector3::new(rate_degrees_s, 0.0, 0.0);
        let force = force(roll_degrees, 0.0);
        let mut burst = with_noise(burst(Mount::Z_UP, captured_at_us, force, rate));
        if is_stuck {
            burst.bytes[8..10].fill(0);
        }
        let snapshot = update(&mut pipeline, &burst);
        let is_frozen = snapshot.flags.contains(Flags::FROZEN);
        assert_eq!(is_frozen, (129..379).contains(&step), "{step}");
        assert!(!is_frozen || !snapshot.flags.contains(Flags::VALID));
        if was_frozen && !is_frozen {
            let roll = degrees(snapshot.euler().roll_rad);
            assert!((roll - 20.0).abs() < 1.0, "{roll}");
        }
        was_frozen = is_frozen;
    }
}

#[test]
fn a_temperature_outside_the_rated_range_is_not_valid() {
    for (counts, is_good) in [(-26_000, true), (-26_100, false), (16_500, false)] {
        let (mut pipeline, t_us) = settled();
        let mut flags = Flags::empty();
        for step in 1..=13 {
            let mut raw = RawSample::decode(&noisy(t_us + step * 1000, LEVEL).bytes);
            raw.temperature = TemperatureCounts(counts);
            flags = update(
                &mut pipeline,
                &Burst {
                    bytes: raw.encode(),
                    captured_at_us: t_us + step * 1000,
                    missed_before: 0,
                },
            )
            .flags;
        }
        assert_eq!(flags.contains(Flags::VALID), is_good, "{counts}");
        assert_eq!(flags.contains(Flags::TEMPERATURE), !is_good, "{counts}");
    }
}

#[test]
fn a_rate_jump_is_valid_after_the_full_scales_are_read_back() {
    for (before, after, is_jump) in [
        (10.0, 80.0, true), // ±2000 °/s become ±250 °/s.
        // ±2000 °/s become ±500 °/s: 30 °/s too much for 40 ms are 1.2°.
        (-10.0, -40.0, false),
        (-20.0, -80.0, true),
        (200.0, 220.0, false),
        (0.0, 49.0, false),
    ] {
        let (mut pipeline, mut t_us) = settled();
        pipeline.settings.verifies_scales = true;
        let mut turn = |pipeline: &mut Pipeline, rate, board| {
            t_us += 1000;
            let rates = Vector3::new(0.0, 0.0, rate + 0.1 * (t_us / 1000 % 2) as f32);
            let burst = burst(Mount::Z_UP, t_us, LEVEL, rates);
            pipeline.update(&burst, board).flags.contains(Flags::VALID)
        };
        for part in 1..=20 {
            let rate = before * 0.05 * part as f32;
            assert!(turn(&mut pipeline, rate, BoardFlags::empty()));
        }
        // A check before the jump does not confirm the scales.
        let board = BoardFlags::SCALES_VERIFIED;
        assert_eq!(turn(&mut pipeline, after, board), !is_jump);
        for _ in 0..3 {
            let is_valid = turn(&mut pipeline, after, BoardFlags::empty());
            assert_eq!(is_valid, !is_jump, "{before} {after}");
            assert_eq!(pipeline.awaits_scale_check(), is_jump);
        }
        assert!(turn(&mut pipeline, after, board), "{before} {after}");
        assert!(!pipeline.awaits_scale_check());
    }
}

#[test]
fn samples_in_si_units_wait_for_the_full_scales_too() {
    for verifies_scales in [false, true] {
        let mut pipeline = rested();
        pipeline.settings.verifies_scales = verifies_scales;
        for (step, board, is_valid) in [
            // The jump itself is never valid.
            (0, BoardFlags::empty(), false),
            (1, BoardFlags::empty(), !verifies_scales),
            (2, BoardFlags::SENSOR_RESET, !verifies_scales),
            (3, BoardFlags::SCALES_VERIFIED, true),
            (4, BoardFlags::empty(), true),
        ] {
            let sample = rolled(3_000_000 + 1_000 * step, 0.0, 80.0);
            let flags = pipeline.update_sample_with(&sample, board).flags;
            assert_eq!(flags.contains(Flags::VALID), is_valid, "{step}: {flags:?}");
            let is_waiting = verifies_scales && step < 3;
            assert_eq!(pipeline.awaits_scale_check(), is_waiting, "{step}");
            let is_reset = board == BoardFlags::SENSOR_RESET;
            assert_eq!(flags.contains(Flags::SENSOR_RESET), is_reset, "{flags:?}");
        }
    }
}

/// The rate is false from the first repetition on, for 0.1 s before the flag.
#[test]
fn after_frozen_samples_in_si_units_gravity_shows_the_tilt() {
    let mut pipeline = Pipeline::new(&settings());
    let mut noise = 1_u32;
    let mut sample = |millisecond: u64| {
        let mut next = || {
            // Numerical Recipes' linear congruential generator.
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (noise >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let mut axes = || Vector3::new(next(), next(), next());
        let force = BodyVector(LEVEL + axes().scale(0.02));
        Sample::new(1_000 * millisecond, force, BodyVector(axes().scale(0.002)))
    };
    for millisecond in 0..5_000 {
        pipeline.update_sample(&sample(millisecond));
    }
    let frozen = Sample {
        angular_rate_rad_s: Vector3::new(radians(45.0), 0.0, 0.0),
        ..sample(5_000)
    };
    let mut last = Snapshot::default();
    for millisecond in 5_000..5_200 {
        let t_us = 1_000 * millisecond;
        last = pipeline.update_sample(&Sample { t_us, ..frozen });
    }
    assert!(last.flags.contains(Flags::FROZEN), "{}", last.flags);
    assert!(roll_error(&last, 0.0) > 3.0, "{last:?}");
    // The monitor compares one sample in each 1/bandwidth.
    let mut after = (5_200..5_210).map(|millisecond| pipeline.update_sample(&sample(millisecond)));
    let first = after.find(|snapshot| !snapshot.flags.contains(Flags::FROZEN));
    let error = first.map(|snapshot| roll_error(&snapshot, 0.0));
    assert!(error.is_some_and(|error| error < 1.0), "{first:?}");
}

#[test]
fn samples_carry_the_conditions_that_a_board_reports() {
    let board = BoardFlags::BUS_FAULT | BoardFlags::LATE | BoardFlags::POLLED;
    let mut pipeline = rested();
    let next = pipeline.update_sample_with(&rolled(3_000_000, 0.0, 0.0), board);
    let late = pipeline.update_sample_with(&rolled(2_999_000, 0.0, 0.0), board);
    for (snapshot, more) in [(next, Flags::VALID), (late, Flags::TIME)] {
        let expected = Flags::from(board) | Flags::DEGRADED | more;
        assert_eq!(snapshot.flags, expected);
    }
}

#[test]
fn lost_settings_inflate_sigma_and_keep_the_attitude() {
    let (mut pipeline, t_us) = settled();
    let burst = noisy(t_us + 50_000, LEVEL);
    let snapshot = pipeline.update(&burst, BoardFlags::SENSOR_RESET);
    let flags = Flags::VALID | Flags::DEGRADED | Flags::SENSOR_RESET;
    assert_eq!(snapshot.flags, flags);
    let sigma = snapshot.tilt_sigma_rad().to_degrees();
    assert!((7.0..8.0).contains(&sigma), "{sigma}");
}

#[test]
fn a_resumed_pipeline_continues_the_earlier_run() {
    let (mut pipeline, t_us) = settled();
    let latest = update(&mut pipeline, &noisy(t_us + 1_000, LEVEL));
    let mut known = pipeline.warm_start(&latest).expect("it is settled");
    known.attitude = Quaternion::from_euler(EulerAngles {
        roll_rad: 0.1,
        pitch_rad: -0.2,
        yaw_rad: 0.3,
    });
    known.tilt_sigma_rad = 0.1;
    let mut pipeline = Pipeline::new(&settings());
    pipeline.resume(&known, 4_000);
    let first = update(&mut pipeline, &noisy(5_000, LEVEL));
    assert_eq!(first.flags & Flags::CALIBRATING, Flags::empty());
    let angles = first.euler();
    assert!((angles.roll_rad - 0.1).abs() < 0.01 && (angles.yaw_rad - 0.3).abs() < 0.01);
    let second = update(&mut pipeline, &noisy(6_000, LEVEL));
    assert!(second.flags.contains(Flags::VALID), "{}", second.flags);
    assert!(pipeline.gyroscope_offset_body_rad_s() == known.bias_rad_s);
}

/// The kept bias is the whole one. What the stored offset removes is not removed twice.
#[test]
fn a_resumed_pipeline_with_a_stored_offset_keeps_the_whole_bias() {
    let (mut pipeline, t_us) = settled();
    let latest = update(&mut pipeline, &noisy(t_us + 1_000, LEVEL));
    let known = pipeline.warm_start(&latest).expect("it is settled");
    let mut pipeline = Pipeline::new(&with_stored_offset(5.0));
    assert!(pipeline.resume(&known, 4_000));
    for t_us in [None, Some(5_000), Some(6_000)] {
        if let Some(t_us) = t_us {
            update(&mut pipeline, &noisy(t_us, LEVEL));
        }
        let error = pipeline.gyroscope_offset_body_rad_s() - known.bias_rad_s;
        assert!(error.norm() < 1.0e-6, "{t_us:?}: {error:?}");
    }
}

fn multiple(Quaternion { w, x, y, z }: Quaternion, factor: f32) -> Quaternion {
    Quaternion::new(factor * w, factor * x, factor * y, factor * z)
}

/// Memory that was cleared, or that kept something else, is no state of a filter.
#[test]
fn a_damaged_state_of_an_earlier_run_is_refused() {
    let (mut pipeline, t_us) = settled();
    let latest = update(&mut pipeline, &noisy(t_us + 1_000, LEVEL));
    let known = pipeline.warm_start(&latest).expect("it is settled");
    let fresh = Pipeline::new(&settings());
    let nan = f32::NAN;
    type Damage = fn(&mut WarmStart, f32);
    let damages: [(Damage, &[f32]); 9] = [
        (
            |start, value| start.attitude = multiple(start.attitude, value),
            &[nan, 0.0, 0.3, 2.0],
        ),
        (|start, value| start.attitude.w += value, &[nan, 0.5]),
        (
            |start, value| start.tilt_sigma_rad = value,
            &[nan, 0.0, -0.1, f32::INFINITY],
        ),
        (
            |start, value| start.bias_rad_s.y = value,
            &[nan, f32::INFINITY],
        ),
        (
            |start, value| start.bias_change_rad_s.z = value,
            &[nan, -1.0e9],
        ),
        (
            |start, value| start.bias_sigma_rad_s = value,
            &[nan, 0.0, f32::INFINITY],
        ),
        (
            |start, value| start.accelerometer_bias_m_s2[0] = value,
            &[nan, 1.0e9],
        ),
        (
            |start, value| start.accelerometer_bias_m_s2[1] = value,
            &[nan, -1.0e9],
        ),
        (
            |start, value| start.squared_velocity_m2_s2 = value,
            &[nan, f32::INFINITY],
        ),
    ];
    for (place, (damage, values)) in damages.into_iter().enumerate() {
        for &value in values {
            let mut start = known;
            damage(&mut start, value);
            let mut pipeline = fresh;
            assert!(!pipeline.resume(&start, 4_000), "{place}: {value}");
            assert!(pipeline == fresh, "{place}: {value}");
            assert_eq!(WarmStart::from_bytes(&start.to_bytes()), None);
        }
    }
    assert_eq!(WarmStart::from_bytes(&known.to_bytes()), Some(known));
    let mut pipeline = fresh;
    assert!(pipeline.resume(&known, 4_000));
}

/// A run may have lost its tilt, and still know its bias.
#[test]
fn a_kept_state_without_a_tilt_finds_it_again() {
    let (mut pipeline, t_us) = settled();
    let mut latest = update(&mut pipeline, &noisy(t_us + 1_000, LEVEL));
    latest.tilt_variance_rad2 = f32::INFINITY;
    let start = pipeline.warm_start(&latest).expect("it is settled");
    let mut pipeline = Pipeline::new(&settings());
    assert!(pipeline.resume(&start, 4_000));
    for millisecond in 5..3_000 {
        let snapshot = update(&mut pipeline, &noisy(1_000 * millisecond, LEVEL));
        let is_valid = snapshot.flags.contains(Flags::VALID);
        assert!(
            is_valid || millisecond < 300,
            "{millisecond}: {}",
            snapshot.flags
        );
        assert!(snapshot.attitude.dot(snapshot.attitude).is_finite());
    }
}

/// Without samples the state to continue from grows old, as the snapshots do.
#[test]
fn a_state_to_continue_from_is_as_uncertain_as_the_latest_snapshot() {
    let (pipeline, t_us) = settled();
    let stale = pipeline.stale(t_us + 3_000_000, BoardFlags::empty());
    let start = pipeline.warm_start(&stale).expect("the bias is measured");
    assert_eq!(start.tilt_sigma_rad, stale.tilt_sigma_rad());
    assert!(start.tilt_sigma_rad > LOST_TILT_RAD);
    // A kept state without a measured bias would be no better than a new start.
    let mut moving = Pipeline::new(&settings());
    let latest = update(&mut moving, &noisy(1_000, LEVEL));
    assert_eq!(moving.warm_start(&latest), None);
    // Without samples the offset stays as unknown as it was.
    let stale = moving.stale(5_000, BoardFlags::empty());
    assert!(stale.flags.contains(Flags::STALE | Flags::CALIBRATING));
}

/// Samples may fail to come after a reset, or be no measurements. The kept tilt then grows old.
#[test]
fn a_resumed_tilt_is_lost_if_no_sample_counts_for_half_a_second() {
    let (mut pipeline, t_us) = settled();
    let latest = update(&mut pipeline, &noisy(t_us + 1_000, LEVEL));
    let known = pipeline.warm_start(&latest).expect("it is settled");
    let rolled = Vector3::new(0.0, -LEVEL.z.abs(), 0.0);
    for is_blank in [true, false] {
        let mut pipeline = Pipeline::new(&settings());
        pipeline.resume(&known, 4_000);
        for millisecond in 5..600 {
            let blank = Burst {
                bytes: [0; 14],
                ..noisy(1_000 * millisecond, LEVEL)
            };
            let stale = if is_blank {
                update(&mut pipeline, &blank)
            } else {
                pipeline.stale(1_000 * millisecond, BoardFlags::empty())
            };
            assert!(!stale.flags.contains(Flags::VALID));
            let next = pipeline.warm_start(&stale).expect("the bias is measured");
            assert!(millisecond < 50 || next.tilt_sigma_rad > 1.3 * known.tilt_sigma_rad);
        }
        for millisecond in 600..900 {
            let burst = noisy(1_000 * millisecond, rolled);
            let snapshot = update(&mut pipeline, &burst);
            let roll_deg = snapshot.euler().roll_rad.to_degrees();
            assert!((roll_deg - 90.0).abs() < 2.0, "{millisecond}: {roll_deg}");
        }
    }
}

/// A kept tilt that is too uncertain for `VALID` comes from the specific force instead.
#[test]
fn a_resumed_attitude_is_valid_however_uncertain_the_kept_tilt_is() {
    let (mut pipeline, t_us) = settled();
    let latest = update(&mut pipeline, &noisy(t_us + 1_000, LEVEL));
    let known = pipeline.warm_start(&latest).expect("it is settled");
    for share in [0.1, 0.99, 1.01, 3.0] {
        let mut pipeline = Pipeline::new(&settings());
        let start = WarmStart {
            tilt_sigma_rad: share * LOST_TILT_RAD,
            ..known
        };
        pipeline.resume(&start, 4_000);
        // The tilt then comes from the mean specific force of 0.15 s.
        let until_ms = if share < 1.0 { 6 } else { 180 };
        let mut flags = Flags::empty();
        for millisecond in 5..=until_ms {
            flags = update(&mut pipeline, &noisy(1_000 * millisecond, LEVEL)).flags;
        }
        assert!(flags.contains(Flags::VALID), "{share}: {flags}");
    }
}

/// The kept offset of the accelerometer is the whole one. What the next run's calibration removes
/// is not removed twice.
#[test]
fn a_resumed_pipeline_knows_the_accelerometer_s_offset() {
    let mut calibrated = settings();
    let offset = Vector3::new(0.3, -0.2, 0.0);
    calibrated
        .calibration
        .add_accelerometer_offset(offset, Mount::Z_UP);
    let (mut pipeline, t_us) = settled_with(&calibrated, LEVEL + offset);
    let latest = update(&mut pipeline, &noisy(t_us + 1_000, LEVEL + offset));
    let known = pipeline.warm_start(&latest).expect("it is settled");
    let resumed_with = |settings: &Settings| {
        let mut pipeline = Pipeline::new(settings);
        pipeline.resume(&known, 4_000);
        pipeline.kalman().accelerometer_bias_m_s2()
    };
    let found = pipeline.kalman().accelerometer_bias_m_s2();
    let found = Vector3::new(found.x, found.y, 0.0);
    for (settings, expected) in [(&calibrated, found), (&settings(), found + offset)] {
        let resumed = resumed_with(settings);
        assert!((resumed - expected).norm() < 1.0e-6, "{resumed:?}");
    }
}

/// The level is where it was found, and the offset that was found there turns with it.
#[test]
fn an_offset_that_is_found_later_leaves_the_level() {
    let offset = Vector3::new(0.3, -0.2, 0.0);
    let mut settings = settings();
    let on_the_table = LEVEL + offset + Vector3::new(0.0, 0.4, 0.0);
    settings.calibration.level = crate::calibration::level::trim(on_the_table).ok();
    settings
        .calibration
        .add_accelerometer_offset(offset, Mount::Z_UP);
    let (mut pipeline, t_us) = settled_with(&settings, on_the_table);
    let angles = update(&mut pipeline, &noisy(t_us + 1_000, on_the_table)).euler();
    let tilt_deg = angles
        .roll_rad
        .abs()
        .max(angles.pitch_rad.abs())
        .to_degrees();
    assert!(tilt_deg < 0.1, "{tilt_deg}");
}

/// Blank data repeat too, but they count as a pause alone.
#[test]
fn a_pause_of_blank_data_counts_once() {
    // 0.4 s at 30 °/s about two axes are 17°. After 30 ms a changed rate gives 5°: 16° if the
    // filter had got the repeated data.
    for (milliseconds, rate_degrees_s, largest_degrees) in [(400, 0.0, 18.0), (30, 500.0, 8.0)] {
        let (mut pipeline, t_us) = settled();
        for step in 1..=milliseconds {
            let burst = Burst {
                bytes: [0xFF; 14],
                captured_at_us: t_us + step * 1000,
                missed_before: 0,
            };
            assert!(!update(&mut pipeline, &burst).flags.contains(Flags::VALID));
        }
        let t_us = t_us + (milliseconds + 1) * 1000;
        let rate = Vector3::new(rate_degrees_s, 0.0, 0.0);
        let first = update(&mut pipeline, &burst(Mount::Z_UP, t_us, LEVEL, rate));
        let sigma_degrees = first.tilt_sigma_rad().to_degrees();
        assert!(sigma_degrees < largest_degrees, "{sigma_degrees}");
    }
}

/// The supervisor has set the sensor up again, and its first bursts are blank, or still repeat.
#[test]
fn a_reset_of_the_sensor_counts_with_the_next_measurement() {
    for bytes in [[0xFF; 14], noisy(0, LEVEL).bytes] {
        let (mut pipeline, t_us) = settled();
        let mut board = BoardFlags::empty();
        for step in 1..=30 {
            let burst = Burst {
                bytes,
                captured_at_us: t_us + step * 1000,
                missed_before: 0,
            };
            pipeline.update(&burst, board);
            board.set(BoardFlags::SENSOR_RESET, step == 27);
        }
        let sigma = update(&mut pipeline, &noisy(t_us + 31_000, LEVEL)).tilt_sigma_rad();
        assert!(sigma > radians(7.0), "{sigma}");
    }
}

#[test]
fn repeated_samples_are_flagged_as_frozen() {
    let mut pipeline = Pipeline::new(&settings());
    for index in 0..200_u64 {
        let flags = update(
            &mut pipeline,
            &burst(Mount::Z_UP, index * 1000, LEVEL, Vector3::ZERO),
        )
        .flags;
        assert_eq!(flags.contains(Flags::FROZEN), index >= 22, "{index}");
    }
}

/// Rests for two seconds and rolls by 90° in one, by a clock that is 8 % slow. The sensor's clock
/// is right, and each tenth sample is lost. Returns the roll, degrees.
fn roll_by_slow_clock(board: BoardFlags) -> f32 {
    let mut pipeline = Pipeline::new(&settings());
    let mut t_us = 0_u64;
    let mut run = |rate_degrees_s: f32, milliseconds: u64| {
        let mut last = Snapshot::default();
        for millisecond in 0..milliseconds {
            t_us += 920;
            if millisecond % 10 == 5 {
                continue;
            }
            // The vehicle falls, so that the specific force shows no tilt.
            let rate = Vector3::new(rate_degrees_s, 0.0, 0.0);
            let force = if rate_degrees_s > 0.0 {
                Vector3::ZERO
            } else {
                LEVEL
            };
            let burst = burst(Mount::Z_UP, t_us, force, rate);
            last = pipeline.update(&with_noise(burst), board);
        }
        last.euler().roll_rad.to_degrees()
    };
    run(0.0, 2_000);
    run(90.0, 1_000)
}

#[test]
fn the_sensor_s_clock_corrects_the_internal_oscillator() {
    let crystal = roll_by_slow_clock(BoardFlags::empty());
    assert!((crystal - 0.92 * 90.0).abs() < 0.5, "{crystal}");
    let corrected = roll_by_slow_clock(BoardFlags::INTERNAL_CLOCK);
    assert!((corrected - 90.0).abs() < 0.5, "{corrected}");
    // A timer's bursts come at the times of the oscillator itself.
    let polled = roll_by_slow_clock(BoardFlags::INTERNAL_CLOCK | BoardFlags::POLLED);
    assert!((polled - crystal).abs() < 0.01, "{polled}");
}

/// Rolls at 30 °/s while the gyroscope's forward axis reads this, °/s, for 50 ms. Returns the
/// last snapshot and the true roll, degrees.
fn roll_through(reading_degrees_s: f32) -> (Snapshot, f32) {
    let (mut pipeline, mut t_us) = settled();
    let (mut snapshot, mut roll_degrees) = (Snapshot::default(), 0.0);
    for millisecond in 0..151 {
        t_us += 1_000;
        roll_degrees += 0.03;
        let is_disturbed = (100..150).contains(&millisecond);
        let reading = if is_disturbed {
            reading_degrees_s
        } else {
            30.0
        };
        let rate = Vector3::new(reading, 0.0, 0.0);
        let mut burst = burst(Mount::Z_UP, t_us, force(roll_degrees, 0.0), rate);
        if !is_disturbed {
            burst = with_noise(burst);
        }
        snapshot = update(&mut pipeline, &burst);
        let is_flagged = snapshot.flags.contains(Flags::GYROSCOPE_SATURATED);
        assert_eq!(is_flagged, is_disturbed);
        assert!(!is_flagged || !snapshot.flags.contains(Flags::VALID));
    }
    (snapshot, roll_degrees)
}

#[test]
fn a_false_full_scale_reading_turns_nothing() {
    // At full scale 50 ms would be 100°.
    for reading_degrees_s in [2_500.0, -2_500.0] {
        let (snapshot, roll_degrees) = roll_through(reading_degrees_s);
        let error = snapshot.euler().roll_rad.to_degrees() - roll_degrees;
        let sigma = snapshot.tilt_sigma_rad().to_degrees();
        assert!(error.abs() < 0.5, "{error}");
        assert!((2.0..10.0).contains(&sigma), "{sigma}");
        assert!(snapshot.flags.contains(Flags::VALID));
    }
}

#[test]
fn a_body_that_has_turned_at_full_scale_takes_its_tilt_from_gravity() {
    // Full scale faster than a body can reach it, but then the body still turns fast.
    let (mut pipeline, mut t_us) = settled();
    let mut run = |reading_degrees_s: f32, force_m_s2: Vector3| {
        t_us += 1_000;
        let rate = Vector3::new(reading_degrees_s, 0.0, 0.0);
        update(&mut pipeline, &burst(Mount::Z_UP, t_us, force_m_s2, rate))
    };
    for _ in 0..50 {
        run(2_500.0, force(0.0, 40.0));
    }
    // While the body falls, nothing shows the tilt.
    let falling = run(1_500.0, Vector3::ZERO);
    assert!(!falling.flags.contains(Flags::VALID));
    let snapshot = run(1_500.0, force(0.0, 40.0));
    let pitch_degrees = snapshot.euler().pitch_rad.to_degrees();
    let sigma_degrees = snapshot.tilt_sigma_rad().to_degrees();
    assert!((pitch_degrees - 40.0).abs() < 3.0, "{pitch_degrees}");
    assert!(sigma_degrees > 10.0, "{sigma_degrees}");
}

#[test]
fn full_scale_that_a_body_can_reach_is_a_turn() {
    let (mut pipeline, mut t_us) = settled();
    let (mut snapshot, mut turned_degrees) = (Snapshot::default(), 0.0);
    // 30 °/s more each millisecond, to full scale for 50 ms.
    for step in 0..117_u16 {
        let rate_degrees_s = (30.0 * f32::from(step)).min(32_767.0 / 16.4);
        turned_degrees += 1.0e-3 * rate_degrees_s;
        t_us += 1_000;
        let rate = Vector3::new(0.0, 0.0, rate_degrees_s);
        let burst = burst(Mount::Z_UP, t_us, LEVEL, rate);
        snapshot = update(&mut pipeline, &with_noise(burst));
    }
    assert!(snapshot.flags.contains(Flags::GYROSCOPE_SATURATED));
    let yaw_degrees = snapshot.euler().yaw_rad.to_degrees();
    let error_degrees = (yaw_degrees - turned_degrees + 180.0).rem_euclid(360.0) - 180.0;
    // The attitude leads by the delay of the low-pass filter.
    assert!(error_degrees.abs() < 5.0, "{error_degrees}");
    // The turn may have been faster.
    let sigma_degrees = snapshot.tilt_sigma_rad().to_degrees();
    assert!(sigma_degrees > 20.0, "{sigma_degrees}");
}

/// While the readings were spurious, the rate may have changed steadily to the one after them.
#[test]
fn a_false_full_scale_reading_hides_the_change_of_the_rate() {
    let sigma_deg = |rate_after_degrees_s: f32| {
        let (mut pipeline, mut t_us) = settled();
        let mut run = |reading_degrees_s: f32| {
            t_us += 1_000;
            let rate = Vector3::new(reading_degrees_s, 0.0, 0.0);
            // No sensor repeats its readings.
            let force = LEVEL.scale(1.0 + 0.002 * (t_us / 1_000 % 2) as f32);
            update(&mut pipeline, &burst(Mount::Z_UP, t_us, force, rate))
        };
        for _ in 0..50 {
            run(2_500.0);
        }
        degrees(run(rate_after_degrees_s).tilt_sigma_rad())
    };
    // 200 °/s for half of 50 ms are 5°.
    let (steady, changed) = (sigma_deg(0.0), sigma_deg(200.0));
    assert!(changed > 1.3 * steady, "{changed} {steady}");
}
