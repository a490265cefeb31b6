//! Properties of the library over many generated inputs, checked against independent formulas.

use aplomb::attitude::{EulerAngles, Quaternion, Vector3, sine_cosine, wrap_pi};
use aplomb::calibration::accelerometer::{PoseCollector, fit};
use aplomb::calibration::level;
use aplomb::calibration::mount_finder::MountFinder;
use aplomb::calibration::temperature::TemperatureLearner;
use aplomb::calibration::{
    AccelerometerCorrection, Calibration, GyroscopeOffset, ImuReading, Mount, NoiseModel,
    SensorSetup, StationaryDetector, StationaryMean, StationaryProgress, SymmetricMatrix,
    TemperatureModel,
};
use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{AccelerometerRange, Burst, GyroscopeRange, PARTS, RawSample};
use aplomb::pipeline::{Pipeline, Settings};
use aplomb::telemetry::{classic, text};
use aplomb::units::CounterExtender;
use proptest::prelude::*;
use std::f32::consts::{FRAC_PI_2, PI};

/// The default configuration of an MPU-6050.
const DEFAULT_SETUP: SensorSetup = SensorSetup {
    gyroscope_counts_per_degree_s: 16.4,
    accelerometer_counts_per_g: 2048.0,
    gyroscope_bandwidth_hz: 188.0,
    accelerometer_bandwidth_hz: 184.0,
    sample_rate_hz: 1000.0,
};

/// Every bit pattern: zeros, subnormals, infinities and NaNs included.
fn any_bits() -> impl Strategy<Value = f32> {
    prop_oneof![
        any::<u32>().prop_map(f32::from_bits),
        prop::sample::select(vec![
            0.0,
            -0.0,
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            f32::MAX,
            f32::MIN,
            f32::MIN_POSITIVE,
            PI,
            -PI,
            FRAC_PI_2,
        ]),
    ]
}

fn any_vector(limit: f32) -> impl Strategy<Value = Vector3> {
    (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| Vector3::new(x, y, z))
}

fn any_rotation() -> impl Strategy<Value = Quaternion> {
    (-1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32)
        .prop_filter("too short to have a direction", |(w, x, y, z)| {
            w * w + x * x + y * y + z * z > 0.01
        })
        .prop_map(|(w, x, y, z)| Quaternion::new(w, x, y, z).normalize())
}

/// Returns the largest difference of two rotations' matrices, which depends on neither sign nor
/// angles.
fn difference(a: Quaternion, b: Quaternion) -> f32 {
    [
        Vector3::new(1.0, 0.0, 0.0),
        Vector3::new(0.0, 1.0, 0.0),
        Vector3::new(0.0, 0.0, 1.0),
    ]
    .into_iter()
    .map(|axis| (a.rotate(axis) - b.rotate(axis)).norm())
    .fold(0.0, f32::max)
}

proptest! {
    #[test]
    fn wrapping_is_the_same_angle_in_the_interval(angle in -1.0e4..1.0e4f32) {
        let wrapped = wrap_pi(angle);
        prop_assert!(wrapped > -PI && wrapped <= PI);
        let turns = (f64::from(angle) - f64::from(wrapped)) / std::f64::consts::TAU;
        // The subtracted turn is that of `f32`, which is 2e-7 too long.
        prop_assert!((turns - turns.round()).abs() < 1e-4, "{turns}");
    }

    #[test]
    fn wrapping_accepts_any_input(angle in any_bits()) {
        let wrapped = wrap_pi(angle);
        prop_assert!(wrapped > -PI && wrapped <= PI, "{wrapped}");
    }

    #[test]
    fn sines_accept_any_input(angle in any_bits()) {
        let (sine, cosine) = sine_cosine(angle);
        prop_assert!((sine * sine + cosine * cosine - 1.0).abs() < 1e-5);
    }

    #[test]
    fn euler_angles_survive_the_quaternion(
        roll_rad in -3.1..3.1f32,
        pitch_rad in -1.55..1.55f32,
        yaw_rad in -3.1..3.1f32,
    ) {
        let angles = EulerAngles { roll_rad, pitch_rad, yaw_rad };
        let back = Quaternion::from_euler(angles).to_euler();
        // Close to the pole roll and yaw become undefined.
        let tolerance = 3e-6 / pitch_rad.cos();
        prop_assert!((back.roll_rad - roll_rad).abs() < tolerance, "{back:?}");
        prop_assert!((back.pitch_rad - pitch_rad).abs() < 3e-6, "{back:?}");
        prop_assert!((back.yaw_rad - yaw_rad).abs() < tolerance, "{back:?}");
    }

    #[test]
    fn quaternions_survive_the_euler_angles(rotation in any_rotation()) {
        let angles = rotation.to_euler();
        prop_assert!(angles.pitch_rad.abs() <= FRAC_PI_2);
        prop_assert!(difference(Quaternion::from_euler(angles), rotation) < 1e-5);
    }

    #[test]
    fn rotations_at_the_poles_survive_the_euler_angles(
        roll_rad in -3.1..3.1f32,
        yaw_rad in -3.1..3.1f32,
        from_pole in -1.0e-3..1.0e-3f32,
        nose_up in any::<bool>(),
    ) {
        let pole = if nose_up { FRAC_PI_2 } else { -FRAC_PI_2 };
        let rotation =
            Quaternion::from_euler(EulerAngles { roll_rad, pitch_rad: pole + from_pole, yaw_rad });
        let angles = rotation.to_euler();
        prop_assert!((angles.pitch_rad.abs() - (FRAC_PI_2 - from_pole.abs())).abs() < 2e-6);
        prop_assert!(difference(Quaternion::from_euler(angles), rotation) < 1e-5);
    }

    #[test]
    fn any_quaternion_has_finite_angles(
        w in any_bits(), x in any_bits(), y in any_bits(), z in any_bits(),
    ) {
        let quaternion = Quaternion::new(w, x, y, z);
        let unit = quaternion.normalize();
        prop_assert!((unit.dot(unit) - 1.0).abs() < 1e-5, "{unit:?}");
        let angles = quaternion.to_euler();
        prop_assert!(angles.roll_rad > -PI && angles.roll_rad <= PI);
        prop_assert!(angles.pitch_rad.abs() <= FRAC_PI_2);
        prop_assert!(angles.yaw_rad > -PI && angles.yaw_rad <= PI);
    }

    #[test]
    fn any_angles_are_a_rotation(x in any_bits(), y in any_bits(), z in any_bits()) {
        let angles = EulerAngles { roll_rad: x, pitch_rad: y, yaw_rad: z };
        let rotation = Quaternion::from_euler(angles);
        prop_assert!((rotation.dot(rotation) - 1.0).abs() < 1e-4, "{rotation:?}");
        let rotation = Quaternion::from_rotation_vector(Vector3::new(x, y, z));
        prop_assert!((rotation.dot(rotation) - 1.0).abs() < 1e-4, "{rotation:?}");
    }

    #[test]
    fn rotations_compose_and_undo(
        a in any_rotation(), b in any_rotation(), vector in any_vector(10.0),
    ) {
        let both = a.multiply(b).rotate(vector);
        prop_assert!((both - a.rotate(b.rotate(vector))).norm() < 1e-4);
        prop_assert!((a.conjugate().rotate(a.rotate(vector)) - vector).norm() < 1e-4);
        prop_assert!((a.rotate(vector).norm() - vector.norm()).abs() < 1e-4);
    }

    #[test]
    fn a_rotation_vector_turns_by_its_length(axis in any_rotation(), angle in 0.0..3.1f32) {
        // Any unit vector as the axis; the angle is recovered from the trace of the matrix.
        let axis = axis.rotate(Vector3::new(1.0, 0.0, 0.0));
        let turn = Quaternion::from_rotation_vector(axis.scale(angle));
        let unit = |i| match i {
            0 => Vector3::new(1.0, 0.0, 0.0),
            1 => Vector3::new(0.0, 1.0, 0.0),
            _ => Vector3::new(0.0, 0.0, 1.0),
        };
        let trace: f32 = (0..3).map(|i| unit(i).dot(turn.rotate(unit(i)))).sum();
        prop_assert!((trace - (1.0 + 2.0 * angle.cos())).abs() < 1e-5);
        prop_assert!((turn.rotate(axis) - axis).norm() < 1e-5);
    }

    #[test]
    fn every_mount_is_a_proper_rotation(
        index in 0..24usize, a in any_vector(100.0), b in any_vector(100.0),
    ) {
        let mount = Mount::ALL[index];
        prop_assert_eq!(mount.to_sensor(mount.to_body(a)), a);
        let body = mount.to_body(a).0;
        prop_assert_eq!(body.dot(body).sqrt(), body.norm());
        // Only a proper rotation keeps the vector product.
        let turned = body.cross(mount.to_body(b).0);
        prop_assert!((turned - mount.to_body(a.cross(b)).0).norm() < 1e-2);
    }

    #[test]
    fn only_the_26_names_are_mounts(
        name in "[+-]?[xyz][+-][xyzw]|[-+xyz]{0,5}|z-up|z-down",
    ) {
        let bytes = name.as_bytes();
        let is_name = name == "z-up"
            || name == "z-down"
            || (bytes.len() == 4
                && b"+-".contains(&bytes[0])
                && b"xyz".contains(&bytes[1])
                && b"+-".contains(&bytes[2])
                && b"xyz".contains(&bytes[3])
                && bytes[1] != bytes[3]);
        prop_assert_eq!(Mount::parse(&name).is_some(), is_name);
    }

    #[test]
    fn bursts_decode_by_the_datasheet(bytes in any::<[u8; 14]>(), range in 0..4usize) {
        let sample = RawSample::decode(&bytes);
        prop_assert_eq!(sample.encode(), bytes);
        // Two's complement the long way round, from the register pairs at 0x3B and on.
        let register_pair = |index: usize| {
            let unsigned = i32::from(bytes[2 * index]) * 256 + i32::from(bytes[2 * index + 1]);
            f64::from(if unsigned > 32767 { unsigned - 65536 } else { unsigned })
        };
        let full_scale_g = [2.0, 4.0, 8.0, 16.0][range];
        let counts_per_degree_s = [131.0, 65.5, 32.8, 16.4][range];
        let force = sample.accelerometer.to_m_s2(AccelerometerRange::ALL[range]);
        let rate = sample.gyroscope.to_rad_s(GyroscopeRange::ALL[range]);
        for (index, value) in [force.x, force.y, force.z].into_iter().enumerate() {
            let expected = register_pair(index) / 32768.0 * full_scale_g * 9.80665;
            prop_assert!((f64::from(value) - expected).abs() <= 1e-6 * expected.abs());
        }
        for (index, value) in [rate.x, rate.y, rate.z].into_iter().enumerate() {
            let expected = (register_pair(4 + index) / counts_per_degree_s).to_radians();
            prop_assert!((f64::from(value) - expected).abs() <= 1e-6 * expected.abs());
        }
        for part in &PARTS {
            let raw = register_pair(3);
            let expected = match part.who_am_i {
                0x68 | 0x72 => raw / 340.0 + 36.53,
                0x98 => 0.003 * raw + 25.0,
                _ => raw / 333.87 + 21.0,
            };
            let celsius = f64::from(sample.temperature.to_celsius(part));
            prop_assert!((celsius - expected).abs() < 1e-4, "{}: {}", part.name, celsius);
        }
        let at_limit =
            |indices: [usize; 3]| indices.iter().any(|i| register_pair(*i).abs() >= 32767.0);
        prop_assert_eq!(sample.accelerometer.is_saturated(), at_limit([0, 1, 2]));
        prop_assert_eq!(sample.gyroscope.is_saturated(), at_limit([4, 5, 6]));
    }

    #[test]
    fn the_average_is_exact_or_motion_is_reported(
        seed in prop::collection::vec(-32_000..32_000i16, 1..8),
        samples in 1..=u16::MAX,
    ) {
        // Scales at which every count is within the limits: only the arithmetic is tested.
        let noise = NoiseModel {
            gyroscope_sigma_counts: 1.0e6,
            accelerometer_sigma_counts: 1.0e6,
            ..NoiseModel::new(&SensorSetup {
                gyroscope_counts_per_degree_s: 1.0e6,
                accelerometer_counts_per_g: 32_000.0,
                ..DEFAULT_SETUP
            })
        };
        let mut detector = StationaryDetector::new(&noise, samples);
        let gyroscope = |index: u32| seed[index as usize % seed.len()];
        let mut sum = 0_i64;
        for index in 0..u32::from(samples) {
            let value = gyroscope(index);
            sum += i64::from(value);
            let progress = detector.update(&ImuReading {
                gyroscope: [value, -(value / 2), 0],
                accelerometer: [0, 0, -32_000],
                temperature_celsius: 25.0,
            });
            if index + 1 < u32::from(samples) {
                prop_assert_eq!(progress, StationaryProgress::Collecting);
            } else if let StationaryProgress::Done(mean) = progress {
                let exact = sum as f64 / f64::from(samples);
                let error = (f64::from(mean.gyroscope_counts.x) - exact).abs();
                prop_assert!(error <= exact.abs() * 1.2e-7 + 1e-7, "{}", error);
                prop_assert_eq!(mean.accelerometer_counts.z, -32_000.0);
            } else {
                prop_assert!(false, "{:?}", progress);
            }
        }
    }

    #[test]
    fn any_samples_average_without_overflow(
        samples in 1..=3000u16,
        readings in prop::collection::vec(any::<[i16; 6]>(), 1..400),
        celsius in any_bits(),
        counts in (any_bits(), any_bits()),
        bandwidths in (any_bits(), any_bits(), any_bits()),
        expected in any_bits(),
    ) {
        for setup in [
            DEFAULT_SETUP,
            SensorSetup {
                gyroscope_counts_per_degree_s: counts.0,
                accelerometer_counts_per_g: counts.1,
                gyroscope_bandwidth_hz: bandwidths.0,
                accelerometer_bandwidth_hz: bandwidths.1,
                sample_rate_hz: bandwidths.2,
            },
        ] {
            let noise = NoiseModel::new(&setup);
            let vector = Vector3::new(expected, celsius, counts.0);
            let mut detector =
                StationaryDetector::new(&noise, samples).with_expected_offset(vector, expected);
            for &[a, b, c, d, e, f] in &readings {
                let reading = ImuReading {
                    gyroscope: [a, b, c],
                    accelerometer: [d, e, f],
                    temperature_celsius: celsius,
                };
                if let StationaryProgress::Done(mean) = detector.update(&reading) {
                    for mean in [mean.gyroscope_counts, mean.accelerometer_counts] {
                        prop_assert!(mean.is_within(32_768.0), "{mean:?}");
                    }
                }
                prop_assert!(detector.progress_percent() <= 100);
            }
        }
    }

    #[test]
    fn any_poses_are_fitted_or_refused(
        poses in prop::collection::vec((any_bits(), any_bits(), any_bits()), 0..30),
        near in prop::collection::vec(any_vector(1.3), 0..40),
    ) {
        let wild = poses.iter().map(|&(x, y, z)| Vector3::new(x, y, z)).collect::<Vec<_>>();
        let mut collector = PoseCollector::new(&NoiseModel::new(&DEFAULT_SETUP));
        for pose in wild.iter().chain(&near) {
            let mean = StationaryMean {
                accelerometer_counts: pose.scale(2048.0),
                ..StationaryMean::default()
            };
            if let Ok(accepted) = collector.add(&mean) {
                prop_assert_eq!(usize::from(accepted.count), collector.count());
            }
        }
        for fitted in [fit(&wild), fit(&near), collector.fit()] {
            match fitted {
                Ok(found) => {
                    prop_assert!(found.residual_after_g <= 0.05);
                    prop_assert!(found.correction.offset_m_s2.is_within(2.0));
                    prop_assert!(!found.to_string().is_empty());
                }
                Err(error) => prop_assert!(!error.to_string().is_empty()),
            }
        }
    }

    #[test]
    fn any_sensor_within_the_datasheet_tolerance_is_fitted(
        offset in any_vector(0.08),
        scales in any_vector(0.03),
        cross in any_vector(0.02),
        noise in prop::collection::vec(any_vector(3.0e-4), 12),
    ) {
        // In double precision and with a matrix of its own; every reading is S·f + o.
        let rows = [
            Vector3::new(1.0 + scales.x, cross.x, cross.y),
            Vector3::new(cross.x, 1.0 + scales.y, cross.z),
            Vector3::new(cross.y, cross.z, 1.0 + scales.z),
        ];
        let read =
            |f: Vector3| Vector3::new(rows[0].dot(f), rows[1].dot(f), rows[2].dot(f)) + offset;
        let poses = aplomb::calibration::accelerometer::Pose::GUIDE;
        let readings: Vec<_> = poses
            .iter()
            .zip(&noise)
            .map(|(pose, noise)| read(pose.up()) + *noise)
            .collect();
        let found = fit(&readings).expect("twelve good poses");
        prop_assert!(found.has_cross_axis);
        for pose in poses {
            let g = 9.80665;
            let corrected = found.correction.apply(read(pose.up()).scale(g)).scale(1.0 / g);
            prop_assert!((corrected - pose.up()).norm() < 3.0e-3, "{:?}", corrected);
        }
    }

    #[test]
    fn any_force_and_any_temperature_point_is_used_or_refused(
        numbers in prop::collection::vec(
            (any_bits(), any_bits(), any_bits(), any_bits(), any_bits()),
            1..20,
        ),
        near in prop::collection::vec(any_vector(12.0), 1..10),
    ) {
        let mut learner = TemperatureLearner::new();
        let mut finder = MountFinder::new();
        for &(x, y, z, celsius, sigma) in &numbers {
            let vector = Vector3::new(x, y, z);
            for force in near.iter().chain([&vector]) {
                if let Ok(trim) = level::trim(*force) {
                    prop_assert!((trim.dot(trim) - 1.0).abs() < 1e-3);
                }
                let _ = finder.add(*force);
            }
            learner.add(celsius, vector, sigma);
            learner.add(celsius % 100.0, near[0].scale(0.01), sigma);
            if let Ok(model) = learner.fit() {
                let (offset, weight) = model.offset_at(celsius);
                prop_assert!((0.0..=1.0).contains(&weight));
                prop_assert!(offset.is_within(f32::MAX), "{model:?}");
            }
        }
    }

    #[test]
    fn any_calibration_leaves_a_rotation(
        numbers in prop::array::uniform32(any_bits()),
        has in prop::array::uniform5(any::<bool>()),
        mount in 0..24usize,
        bursts in prop::collection::vec(any::<[u8; 14]>(), 1..100),
        changed_at in 0..100usize,
    ) {
        let v = |at: usize| Vector3::new(numbers[at], numbers[at + 1], numbers[at + 2]);
        let mut calibration = Calibration::NONE;
        calibration.mount = has[0].then(|| Mount::ALL[mount]);
        calibration.gyroscope = has[1].then(|| GyroscopeOffset {
            offset_rad_s: v(0),
            temperature_celsius: numbers[3],
        });
        calibration.temperature = has[2].then(|| TemperatureModel {
            reference_celsius: numbers[4],
            offset_rad_s: v(5),
            slope_rad_s_per_celsius: v(8),
            curvature_rad_s_per_celsius2: v(11),
            coldest_celsius: numbers[14],
            warmest_celsius: numbers[15],
        });
        calibration.accelerometer = has[3].then(|| AccelerometerCorrection {
            offset_m_s2: v(16),
            matrix: SymmetricMatrix {
                xx: numbers[19],
                yy: numbers[20],
                zz: numbers[21],
                xy: numbers[22],
                xz: numbers[23],
                yz: numbers[24],
            },
        });
        calibration.level =
            has[4].then(|| Quaternion::new(numbers[25], numbers[26], numbers[27], numbers[28]));
        let mut pipeline = Pipeline::new(&Settings::new(&PARTS[0]));
        for (index, bytes) in bursts.into_iter().enumerate() {
            if index == changed_at {
                pipeline.set_calibration(&calibration);
            }
            let burst = Burst { bytes, captured_at_us: index as u64 * 1000, missed_before: 0 };
            let snapshot = pipeline.update(&burst, BoardFlags::empty());
            let q = snapshot.attitude;
            prop_assert!((q.dot(q) - 1.0).abs() < 1e-3, "{q:?}");
            let rates = snapshot.body_rates_rad_s;
            prop_assert!(rates.x.is_finite() && rates.y.is_finite() && rates.z.is_finite());
        }
    }

    #[test]
    fn any_bytes_at_any_time_leave_a_rotation(
        bursts in prop::collection::vec(
            (any::<[u8; 14]>(), prop_oneof![0..2_000_000u64, any::<u64>()], any::<u8>()),
            1..200,
        ),
        range in 0..4usize,
        mount in 0..24usize,
    ) {
        let mut settings = Settings::new(&PARTS[range]);
        settings.sensor.accelerometer_range = AccelerometerRange::ALL[range];
        settings.sensor.gyroscope_range = GyroscopeRange::ALL[range];
        settings.mount = Mount::ALL[mount];
        let mut pipeline = Pipeline::new(&settings);
        let mut twin = Pipeline::new(&settings);
        for (bytes, captured_at_us, missed_before) in bursts {
            let burst = Burst { bytes, captured_at_us, missed_before };
            let snapshot = pipeline.update(&burst, BoardFlags::empty());
            let q = snapshot.attitude;
            prop_assert!((q.dot(q) - 1.0).abs() < 1e-3, "{q:?}");
            let rates = snapshot.body_rates_rad_s;
            prop_assert!(rates.x.is_finite() && rates.y.is_finite() && rates.z.is_finite());
            prop_assert_eq!(snapshot.t_us, captured_at_us);
            prop_assert_eq!(snapshot.flags.contains(Flags::MISSED), missed_before > 0);
            // The same bytes give the same bits.
            prop_assert_eq!(twin.update(&burst, BoardFlags::empty()), snapshot);
            let mut line = [0; text::LINE_LENGTH];
            let line = std::str::from_utf8(text::encode(&snapshot, &mut line)).expect("ASCII");
            prop_assert!(text::decode(line).is_ok(), "{}", line);
        }
    }

    #[test]
    fn text_reads_back_to_a_hundredth(
        numbers in prop::array::uniform6(-99_000.0..99_000.0f32),
        is_valid: bool,
    ) {
        let [roll_deg, pitch_deg, yaw_deg, roll_rate_deg_s, pitch_rate_deg_s, yaw_rate_deg_s] =
            numbers;
        let numbers = text::Line {
            roll_deg: wrap_pi(roll_deg).to_degrees(),
            pitch_deg,
            yaw_deg: wrap_pi(yaw_deg).to_degrees(),
            roll_rate_deg_s,
            pitch_rate_deg_s,
            yaw_rate_deg_s,
            is_valid,
        };
        let mut line = [0; text::LINE_LENGTH];
        let line = std::str::from_utf8(text::encode_line(&numbers, &mut line)).expect("ASCII");
        let back = text::decode(line).expect("our own line");
        prop_assert_eq!(back.is_valid, is_valid);
        for (there, here) in [
            (numbers.roll_deg, back.roll_deg),
            (numbers.pitch_deg, back.pitch_deg),
            (numbers.yaw_deg, back.yaw_deg),
            (numbers.roll_rate_deg_s, back.roll_rate_deg_s),
            (numbers.pitch_rate_deg_s, back.pitch_rate_deg_s),
            (numbers.yaw_rate_deg_s, back.yaw_rate_deg_s),
        ] {
            // Half a hundredth, and the grain of an `f32` of this size.
            let tolerance = 0.005 + 1e-6 * there.abs();
            let error = (there - here).abs();
            let is_close = error <= tolerance || (error - 360.0).abs() <= tolerance;
            prop_assert!(is_close, "{there} {here}");
        }
        // A second round trip changes nothing.
        let mut second = [0; text::LINE_LENGTH];
        prop_assert_eq!(text::encode_line(&back, &mut second), line.as_bytes());
    }

    #[test]
    fn any_number_fits_the_lines(numbers in prop::array::uniform6(any_bits())) {
        let [roll_deg, pitch_deg, yaw_deg, roll_rate_deg_s, pitch_rate_deg_s, yaw_rate_deg_s] =
            numbers;
        let mut line = [0; text::LINE_LENGTH];
        let line = text::encode_line(
            &text::Line {
                roll_deg, pitch_deg, yaw_deg, roll_rate_deg_s, pitch_rate_deg_s, yaw_rate_deg_s,
                is_valid: true,
            },
            &mut line,
        );
        let line = std::str::from_utf8(line).expect("ASCII");
        prop_assert!(text::decode(line).is_ok(), "{}", line);

        let angles = aplomb::estimator::classic::ClassicAngles {
            roll_deg, roll_rate_deg_s, pitch_deg, pitch_rate_deg_s,
        };
        let mut line = [0; classic::LINE_LENGTH];
        let line = std::str::from_utf8(classic::encode(&angles, &mut line)).expect("ASCII");
        prop_assert!(classic::decode(line).is_some(), "{}", line);
    }

    #[test]
    fn any_text_is_a_line_or_an_error(line in ".{0,120}") {
        if let Ok(numbers) = text::decode(&line) {
            prop_assert!(numbers.roll_deg.abs() < 1e5 || numbers.roll_deg.is_nan());
        }
        let _ = classic::decode(&line);
    }

    #[test]
    fn flags_survive_their_text(bits in any::<u32>()) {
        let flags = Flags::from_bits_truncate(bits);
        prop_assert_eq!(flags.to_string().parse(), Ok(flags));
    }

    #[test]
    fn counters_extend_counts_within_half_a_turn(
        start in any::<u32>(),
        steps in prop::collection::vec(-(1i64 << 31)..1 << 31, 1..50),
    ) {
        let mut extender = CounterExtender::new(start);
        let mut time = u64::from(start);
        for step in steps {
            // Counts from before the start have no time.
            time = time.saturating_add_signed(step);
            prop_assert_eq!(extender.extend(time as u32), time);
        }
    }
}
