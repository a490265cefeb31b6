//! Tests of the library's calibration on 200 modelled sensors within the datasheet's tolerance.
//! Each chip has its own offsets, scales, cross-axis terms, curved temperature drift and noise.
//!
//! Prints the figures that the README quotes:
//! `cargo test --profile host -p aplomb-models --test calibration -- --nocapture`.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::calibration::accelerometer::{Pose, PoseCollector, PoseError};
use aplomb::calibration::gyroscope::{TurnCollector, TurnIntegrator};
use aplomb::calibration::level;
use aplomb::calibration::temperature::TemperatureLearner;
use aplomb::calibration::{
    ImuReading, MotionReason, StationaryDetector, StationaryMean, StationaryProgress,
};
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{
    AccelerometerCounts, Burst, GyroscopeCounts, Part, RawSample, TemperatureCounts,
};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb_models::motion::geometry::{Quaternion as Rotation, add};
use aplomb_models::motion::geometry::{angle_between, cross, dot, norm, scale};
use aplomb_models::motion::truth::STANDARD_GRAVITY_M_S2;
use aplomb_models::motion::{Mount, Truth, Vector};
use aplomb_models::random::Random;
use aplomb_models::sensor::SensorErrors;
use aplomb_models::sensor::identity::Identity;
use aplomb_models::sensor::signal_path::{self, SignalPath};

const CHIPS: u64 = 200;
/// Temperature of the air on the bench, °C.
const ROOM_C: f64 = 25.0;
/// Temperature of the air before the warm-up, °C.
const COLD_C: f64 = 10.0;
/// Time after power-up at which the chip has warmed up.
const WARM_S: f64 = 3600.0;
/// Error of the poses, degrees.
const POSE_ERROR_DEGREES: f64 = 5.0;
/// Direction of the specific force in sensor axes: level, chip face up.
const FACE_UP: Vector = [0.0, 0.0, 1.0];

/// Chip on a bench, with the firmware's settings and pipeline.
struct Chip {
    errors: SensorErrors,
    path: SignalPath,
    pipeline: Pipeline,
    /// Integral of the rates since the last pose.
    integrator: TurnIntegrator,
    random: Random,
    now_us: u64,
}

impl Chip {
    fn new(seed: u64) -> Self {
        let errors = SensorErrors::anywhere_in_tolerance(seed);
        let settings = signal_path::Settings {
            gyroscope_range: 3,
            accelerometer_range: 3,
            gyroscope_filter: 1,
            accelerometer_filter: 1,
            gyroscope_self_test: [false; 3],
            accelerometer_self_test: [false; 3],
        };
        let identity = Identity::of(0x68);
        let pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
        Self {
            errors,
            path: SignalPath::new(seed, Mount::default(), errors, identity, settings),
            integrator: TurnIntegrator::new(&pipeline.settings().noise_model()),
            pipeline,
            random: Random::new(seed, "poses"),
            now_us: 0,
        }
    }

    /// Returns the next sample at this specific force (m/s²) and rate (rad/s), in air of this
    /// temperature (°C).
    fn sample(&mut self, force: Vector, rate: Vector, air_c: f64, awake_s: f64) -> Burst {
        let truth = Truth {
            // The model turns body axes into the sensor's; face up, y and z are reversed.
            specific_force_m_s2: [force[0], -force[1], -force[2]],
            body_rates_rad_s: [rate[0], -rate[1], -rate[2]],
            attitude: None,
            temperature_c: air_c,
            thrust_g: 0.0,
            scored: false,
        };
        for tick in 0..8 {
            self.path.convert(&truth, awake_s, tick == 7);
        }
        let counts = self.path.counts();
        self.now_us += 1000;
        self.integrator.update(counts.gyroscope, self.now_us);
        Burst {
            bytes: RawSample {
                accelerometer: AccelerometerCounts(counts.accelerometer),
                temperature: TemperatureCounts(counts.temperature),
                gyroscope: GyroscopeCounts(counts.gyroscope),
            }
            .encode(),
            captured_at_us: self.now_us,
            missed_before: 0,
        }
    }

    /// Returns the firmware's result for a motion: the first event of a rest of `samples` samples.
    fn watch(
        &mut self,
        samples: u16,
        mut motion: impl FnMut(f64) -> (Vector, Vector),
    ) -> StationaryProgress {
        // The filter settles.
        for _ in 0..30 {
            let (force, rate) = motion(0.0);
            let burst = self.sample(force, rate, ROOM_C, WARM_S);
            self.update(&burst);
        }
        let mut detector = self.pipeline.stationary_detector(samples);
        for index in 0..=samples {
            let (force, rate) = motion(f64::from(index) * 1e-3);
            let burst = self.sample(force, rate, ROOM_C, WARM_S);
            match self.detect(&mut detector, &burst) {
                StationaryProgress::Collecting => {}
                progress => return progress,
            }
        }
        panic!("neither rest nor motion");
    }

    fn update(&mut self, burst: &Burst) -> Snapshot {
        self.pipeline.update(burst, BoardFlags::empty())
    }

    /// Updates the pipeline and the detector with one burst.
    fn detect(&mut self, detector: &mut StationaryDetector, burst: &Burst) -> StationaryProgress {
        self.update(burst);
        let raw = RawSample::decode(&burst.bytes);
        detector.update(&ImuReading {
            gyroscope: raw.gyroscope.0,
            accelerometer: raw.accelerometer.0,
            temperature_celsius: self.pipeline.temperature_celsius(),
        })
    }

    fn rest(&mut self, up: Vector, samples: u16) -> StationaryMean {
        let force = scale(up, STANDARD_GRAVITY_M_S2);
        match self.watch(samples, |_| (force, [0.0; 3])) {
            StationaryProgress::Done(at_rest) => at_rest,
            progress => panic!("{progress:?}"),
        }
    }

    /// Returns a pose of the guide, with the error of a hand.
    fn about(&mut self, pose: Pose) -> Vector {
        let up = pose.up();
        let up = [up.x, up.y, up.z].map(f64::from);
        loop {
            let off = [0, 1, 2].map(|_| self.random.uniform(-0.1, 0.1));
            let held = [0, 1, 2].map(|axis| up[axis] + off[axis]);
            let held = scale(held, 1.0 / norm(held));
            if angle_between(held, up).to_degrees() <= POSE_ERROR_DEGREES {
                return held;
            }
        }
    }

    /// Turns from one direction of up, in sensor axes, to another: by way of a third one, and about
    /// the vertical too.
    fn turn(&mut self, from: Vector, to: Vector) {
        let way = [0, 1, 2].map(|_| self.random.normal());
        let way = scale(way, 1.0 / norm(way));
        let vertical_rad = self.random.uniform(-2.0, 2.0);
        let steps = 800 + (self.random.uniform(0.0, 400.0) as u32);
        for (from, to) in [(from, way), (way, to)] {
            let axis = cross(to, from);
            let axis = scale(axis, 1.0 / norm(axis));
            let angle_rad = angle_between(from, to);
            for step in 0..steps {
                let share = (f64::from(step) + 0.5) / f64::from(steps);
                // Slow at both ends: the integral of the bell is the angle.
                let phase = share * std::f64::consts::TAU;
                let turned = angle_rad * (share - phase.sin() / std::f64::consts::TAU);
                let per_s = (1.0 - phase.cos()) * 1000.0 / f64::from(steps);
                let up = Rotation::from_rotation_vector(scale(axis, -turned)).rotate(from);
                let rate = add(
                    scale(axis, angle_rad * per_s),
                    scale(up, vertical_rad * per_s),
                );
                self.sample(scale(up, STANDARD_GRAVITY_M_S2), rate, ROOM_C, WARM_S);
            }
        }
    }

    fn chip_c(&self, air_c: f64, awake_s: f64) -> f64 {
        self.errors.chip_temperature_c(air_c, awake_s)
    }

    /// Returns the true offset at rest, level, °/s.
    fn true_offset_dps(&self, chip_c: f64) -> Vector {
        let force = scale(FACE_UP, STANDARD_GRAVITY_M_S2);
        self.errors
            .distort_rates([0.0; 3], force, chip_c, WARM_S)
            .map(f64::to_degrees)
    }
}

/// Returns worst and median of a figure over the chips.
struct Figure(Vec<f64>);

impl Figure {
    fn worst(&self) -> f64 {
        self.0.iter().copied().fold(0.0, f64::max)
    }

    fn print(&self, name: &str, unit: &str) {
        let mut sorted = self.0.clone();
        sorted.sort_by(f64::total_cmp);
        let median = sorted[sorted.len() / 2];
        println!(
            "{name}: worst {:.3}{unit}, median {median:.3}{unit}",
            self.worst()
        );
    }
}

fn vector([x, y, z]: Vector) -> Vector3 {
    Vector3::new(x as f32, y as f32, z as f32)
}

fn array(v: Vector3) -> Vector {
    [v.x, v.y, v.z].map(f64::from)
}

fn largest_difference(a: Vector, b: Vector) -> f64 {
    (0..3)
        .map(|axis| (a[axis] - b[axis]).abs())
        .fold(0.0, f64::max)
}

/// Returns the rotation nearest to a matrix (rows): Q ← (Q + Q⁻ᵀ)/2, Higham's iteration.
fn nearest_rotation(matrix: [Vector; 3]) -> [Vector; 3] {
    let cross = |a: Vector, b: Vector| {
        [
            a[1] * b[2] - a[2] * b[1],
            a[2] * b[0] - a[0] * b[2],
            a[0] * b[1] - a[1] * b[0],
        ]
    };
    let mut q = matrix;
    for _ in 0..20 {
        let [a, b, c] = q;
        // The rows of the inverse's transpose.
        let determinant = dot(a, cross(b, c));
        let inverse = [cross(b, c), cross(c, a), cross(a, b)];
        for (row, other) in q.iter_mut().zip(inverse) {
            *row = [0, 1, 2].map(|axis| 0.5 * (row[axis] + other[axis] / determinant));
        }
    }
    q
}

/// Returns directions that cover the sphere evenly (Fibonacci's spiral).
fn directions() -> impl Iterator<Item = Vector> {
    (0..200).map(|index| {
        let z = 1.0 - (2.0 * f64::from(index) + 1.0) / 200.0;
        let across = (1.0 - z * z).sqrt();
        let angle = f64::from(index) * 2.399_963;
        [across * angle.cos(), across * angle.sin(), z]
    })
}

/// Errors of one chip, before and after calibration.
#[derive(Clone, Copy, Default)]
struct Errors {
    /// °/s: not calibrated, calibrated.
    offset: [f64; 2],
    /// Degrees against the triad: not calibrated, six poses, twelve poses.
    inclination: [f64; 3],
    /// Degrees against the body: not calibrated, calibrated.
    levelled: [f64; 2],
    /// Share of the rate, %, against the corrected accelerometer's triad: not calibrated, twelve
    /// poses.
    rate: [f64; 2],
    /// °/s: one stored offset, temperature model.
    temperature: [f64; 2],
}

impl Errors {
    fn of(seed: u64) -> Self {
        let mut chip = Chip::new(seed);
        let mut errors = Self::default();
        let scale_of = chip.pipeline.settings().noise_model();
        let chip_c = chip.chip_c(ROOM_C, WARM_S);

        // 1. The gyroscope at rest.
        let level_rest = chip.rest(FACE_UP, 1000);
        let found = level_rest.gyroscope_offset(&scale_of);
        let truth = chip.true_offset_dps(chip_c);
        let found_dps = array(found.offset_rad_s).map(f64::to_degrees);
        errors.offset = [
            largest_difference(truth, [0.0; 3]),
            largest_difference(found_dps, truth),
        ];

        // 2. The accelerometer in twelve poses; six of them leave the cross-axis terms open.
        let mut collector = PoseCollector::new(&scale_of);
        let mut turns = TurnCollector::new();
        let mut six = None;
        let mut before = FACE_UP;
        for number in 1..=12 {
            let pose = collector.next_pose();
            let held = chip.about(pose);
            chip.turn(before, held);
            before = held;
            let mean = chip.rest(held, 300);
            if let Some(turn) = chip.integrator.finish(&mean) {
                turns.add(&turn);
            }
            let accepted = collector.add(&mean).expect("a new pose");
            assert_eq!((accepted.count, accepted.pose), (number, Some(pose)));
            if number == 6 {
                six = Some(collector.fit().expect("six poses"));
            }
        }
        let fit = collector.fit().expect("twelve poses");
        assert!(fit.has_cross_axis && fit.residual_after_g < fit.residual_before_g);
        let six = six.expect("a fit after six");
        assert!(!six.has_cross_axis);
        let triad = nearest_rotation(chip.errors.accelerometer.sensitivity);
        for direction in directions() {
            let force = scale(direction, STANDARD_GRAVITY_M_S2);
            let reading = chip.errors.distort_specific_force(force, chip_c);
            let truth = triad.map(|row| dot(row, force));
            let readings = [
                reading,
                array(six.correction.apply(vector(reading))),
                array(fit.correction.apply(vector(reading))),
            ];
            for (worst, reading) in errors.inclination.iter_mut().zip(readings) {
                *worst = worst.max(angle_between(reading, truth).to_degrees());
            }
        }

        // 3. The gyroscope, by the turns between the poses.
        let found_turns = turns.fit(&fit.correction).expect("eleven turns");
        assert_eq!(found_turns.turns, 11);
        assert!(found_turns.residual_after_rad < found_turns.residual_before_rad);
        for direction in directions() {
            let reading = chip
                .errors
                .gyroscope
                .sensitivity
                .map(|row| dot(row, direction));
            let truth = triad.map(|row| dot(row, direction));
            let corrected = array(found_turns.matrix.times(vector(reading)));
            for (worst, found) in errors.rate.iter_mut().zip([reading, corrected]) {
                let wrong = norm(add(found, scale(truth, -1.0)));
                *worst = worst.max(100.0 * wrong);
            }
        }

        // 4. Level: the body's own axes, up to 30° of tilt.
        let mut calibration = *chip.pipeline.calibration();
        calibration.gyroscope = Some(found);
        calibration.accelerometer = Some(fit.correction);
        chip.pipeline.set_calibration(&calibration);
        let mounted = chip.pipeline.mounted_force_m_s2(&level_rest);
        let trim = level::trim(mounted).expect("it is level");
        for direction in directions().filter(|up| up[2] > 30_f64.to_radians().cos()) {
            let force = scale(direction, STANDARD_GRAVITY_M_S2);
            let reading = vector(chip.errors.distort_specific_force(force, chip_c));
            let before = array(reading);
            let mounted = |v: Vector3| Vector3::new(v.x, -v.y, -v.z);
            let body = trim.rotate(mounted(fit.correction.apply(reading)));
            let after = array(mounted(body));
            for (worst, found) in errors.levelled.iter_mut().zip([before, after]) {
                *worst = worst.max(angle_between(found, force).to_degrees());
            }
        }

        // 5. One warm-up at rest, from 10 °C air to 30: a point every other degree.
        let mut learner = TemperatureLearner::new();
        let force = scale(FACE_UP, STANDARD_GRAVITY_M_S2);
        for step in 0..11 {
            let air_c = COLD_C + 2.0 * f64::from(step);
            let awake_s = 10.0 + 60.0 * f64::from(step);
            for _ in 0..30 {
                chip.sample(force, [0.0; 3], air_c, awake_s);
            }
            let mut detector = chip.pipeline.stationary_detector(300);
            let at_rest = loop {
                let burst = chip.sample(force, [0.0; 3], air_c, awake_s);
                match chip.detect(&mut detector, &burst) {
                    StationaryProgress::Done(at_rest) => break at_rest,
                    StationaryProgress::Moved(reason) => {
                        panic!("chip {seed}, {air_c} °C: {reason}")
                    }
                    StationaryProgress::Collecting => {}
                }
            };
            learner.add(
                at_rest.temperature_celsius,
                at_rest.gyroscope_offset(&scale_of).offset_rad_s,
                at_rest.gyroscope_offset_sigma_rad_s(&scale_of),
            );
        }
        let model = learner.fit().expect("enough was seen");
        let first = f64::from(model.coldest_celsius) - 5.0;
        let last = f64::from(model.warmest_celsius) + 5.0;
        for step in 0..=50 {
            let celsius = first + (last - first) * f64::from(step) / 50.0;
            let truth = chip.true_offset_dps(celsius);
            let (modelled, weight) = model.offset_at(celsius as f32);
            assert!(weight > 0.999, "{celsius}: {weight}");
            let modelled = array(modelled).map(f64::to_degrees);
            for (worst, found) in errors.temperature.iter_mut().zip([found_dps, modelled]) {
                *worst = worst.max(largest_difference(found, truth));
            }
        }
        errors
    }
}

#[test]
fn two_hundred_chips_are_calibrated() {
    let errors = all_errors();
    let of = |value: &dyn Fn(&Errors) -> f64| Figure(errors.iter().map(value).collect());
    let offset = [0, 1].map(|index| of(&|errors| errors.offset[index]));
    let inclination = [0, 1, 2].map(|index| of(&|errors| errors.inclination[index]));
    let levelled = [0, 1].map(|index| of(&|errors| errors.levelled[index]));
    let rate = [0, 1].map(|index| of(&|errors| errors.rate[index]));
    let temperature = [0, 1].map(|index| of(&|errors| errors.temperature[index]));
    println!(
        "{CHIPS} chips from anywhere within the datasheet's tolerance, \
         poses off by up to {POSE_ERROR_DEGREES}°"
    );
    offset[0].print("gyroscope offset, not calibrated", " °/s");
    offset[1].print("gyroscope offset, calibrated at rest", " °/s");
    inclination[0].print(
        "inclination against the sensor's triad, not calibrated",
        "°",
    );
    inclination[1].print("inclination against the sensor's triad, six poses", "°");
    inclination[2].print("inclination against the sensor's triad, twelve poses", "°");
    rate[0].print("rate, share of it, not calibrated", " %");
    rate[1].print("rate, share of it, twelve poses", " %");
    levelled[0].print(
        "inclination of the body within 30° of level, not calibrated",
        "°",
    );
    levelled[1].print(
        "inclination of the body within 30° of level, twelve poses and level",
        "°",
    );
    temperature[0].print(
        "gyroscope offset over 20 °C of warm-up and 5 °C beyond, one stored offset",
        " °/s",
    );
    temperature[1].print("gyroscope offset over the same, temperature model", " °/s");
    assert!(offset[1].worst() <= 0.05);
    assert!(inclination[2].worst() <= 0.3);
    assert!(rate[1].worst() <= 0.5);
    assert!(temperature[1].worst() <= 0.3);
    // The checks can fail: without a calibration the limits are exceeded.
    assert!(
        offset[0].worst() > 15.0
            && inclination[0].worst() > 3.0
            && rate[0].worst() > 3.0
            && temperature[0].worst() > 2.0
    );
}

/// Returns every chip's errors, computed on both cores.
fn all_errors() -> Vec<Errors> {
    let some = |first: u64| {
        (first..CHIPS)
            .step_by(2)
            .map(Errors::of)
            .collect::<Vec<_>>()
    };
    std::thread::scope(|scope| {
        let other = scope.spawn(|| some(1));
        let mut errors = some(0);
        errors.extend(other.join().expect("the other half"));
        errors
    })
}

#[test]
fn motion_is_rejected_with_its_reason() {
    let g = STANDARD_GRAVITY_M_S2;
    let level = [0.0, 0.0, g];
    for seed in 0..10 {
        let mut chip = Chip::new(seed);
        let moved = |progress: StationaryProgress| match progress {
            StationaryProgress::Moved(reason) => reason,
            other => panic!("chip {seed}: {other:?}"),
        };
        // A table that vibrates by 100 mg at 30 Hz.
        let reason = moved(chip.watch(1000, |t| {
            let shake = 0.1 * g * (t * 30.0 * std::f64::consts::TAU).sin();
            ([shake, 0.0, g], [0.0; 3])
        }));
        assert_eq!(reason.to_string(), "it vibrates along x");
        // A hand turns it.
        let reason = moved(chip.watch(1000, |t| {
            let rate = if t > 0.5 { 10_f64.to_radians() } else { 0.0 };
            (level, [0.0, rate, 0.0])
        }));
        assert_eq!(reason.to_string(), "it turned about y");
        // A slow tilt of 1 °/s, which the gyroscope cannot distinguish from an offset.
        let rate = 1_f64.to_radians();
        let reason = moved(chip.watch(1000, |t| {
            let angle = rate * t;
            ([0.0, g * angle.sin(), g * angle.cos()], [rate, 0.0, 0.0])
        }));
        assert!(matches!(reason, MotionReason::Tilt(_)), "{reason}");
        // A fall, and a turn beyond the gyroscope's range.
        let reason = moved(chip.watch(1000, |_| ([0.0; 3], [0.0; 3])));
        assert_eq!(reason.to_string(), "the accelerometer reads no gravity");
        let reason = moved(chip.watch(1000, |_| (level, [0.0, 0.0, 50.0])));
        assert_eq!(reason.to_string(), "the gyroscope reads full scale about z");
        // The same pose twice.
        let mut collector = PoseCollector::new(&chip.pipeline.settings().noise_model());
        let first = chip.rest(FACE_UP, 1000);
        collector.add(&first).expect("the first");
        let held = chip.about(Pose::GUIDE[0]);
        let again = collector.add(&chip.rest(held, 300));
        assert_eq!(again, Err(PoseError::Repeated { number: 1 }));
    }
}

#[test]
fn the_attitude_continues_during_a_calibration_and_a_stored_one_improves_the_start() {
    let mut chip = Chip::new(7);
    let force = scale(FACE_UP, STANDARD_GRAVITY_M_S2);
    let at_rest = chip.rest(FACE_UP, 1000);
    let mut before = Quaternion::IDENTITY;
    for _ in 0..1000 {
        let burst = chip.sample(force, [0.0; 3], ROOM_C, WARM_S);
        before = chip.update(&burst).attitude;
    }
    let scale_of = chip.pipeline.settings().noise_model();
    let mut calibration = *chip.pipeline.calibration();
    calibration.gyroscope = Some(at_rest.gyroscope_offset(&scale_of));
    let bias_before = chip.pipeline.gyroscope_offset_body_rad_s();
    chip.pipeline.set_calibration(&calibration);
    assert!((chip.pipeline.gyroscope_offset_body_rad_s() - bias_before).norm() < 1e-6);
    let burst = chip.sample(force, [0.0; 3], ROOM_C, WARM_S);
    let after = chip.update(&burst);
    assert!(
        after.attitude.dot(before).abs() > 0.999_99,
        "{after:?} {before:?}"
    );

    // The next power-up: right from the first sample.
    let mut settings = *chip.pipeline.settings();
    settings.calibration = calibration;
    for (settings, limit) in [(settings, 0.3), (Settings::new(&Part::MPU_6050), 50.0)] {
        let mut pipeline = Pipeline::new(&settings);
        let mut worst = 0.0_f32;
        for _ in 0..500 {
            let burst = chip.sample(force, [0.0; 3], ROOM_C, WARM_S);
            let rates = pipeline
                .update(&burst, BoardFlags::empty())
                .body_rates_rad_s;
            worst = worst.max(rates.norm().to_degrees());
        }
        assert!(worst < limit + 0.3, "{worst}");
        assert!(
            limit < 1.0 || worst > 2.0,
            "{worst}: the chip has an offset"
        );
    }
}
