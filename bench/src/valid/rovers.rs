//! Rovers that nobody arms: they rest, turn on the spot at a steady rate, and stop, again and
//! again. Only the vibration of the drive tells a turn from a rest with another offset. The yaw
//! must follow the turns.

use std::f64::consts::PI;

use aplomb::attitude::Vector3;
use aplomb::estimator::Sample;
use aplomb::health::Flags;
use aplomb::mpu6050::Part;
use aplomb::pipeline::{Pipeline, Settings};
use aplomb_models::random::Random;
use aplomb_recordings::simulated::CONFIG;

use super::seeds;
use crate::parallel;

const PERIOD_US: u64 = 10_000;
const STEP_S: f64 = PERIOD_US as f64 * 1.0e-6;
const SECONDS: u64 = 120;
const GRAVITY_M_S2: f64 = 9.80665;
/// Noise of the gyroscope at 188 Hz, rad/s (product specification §6.1).
const SENSOR_NOISE_RAD_S: f64 = 0.0015;
/// Time in which a turn starts and stops, s.
const RAMP_S: f64 = 0.3;
/// Largest error of a yaw that follows the turns, degrees: noise and a bias of 0.1 °/s.
const LARGEST_ERROR_DEG: f64 = 12.0;

/// Rests and turns, sample by sample. The first rest begins with the first sample.
#[derive(Default)]
struct Drive {
    /// Time until the turn begins, and until it ends, s. Both are negative after a turn.
    begins_s: f64,
    ends_s: f64,
    rate_rad_s: f64,
}

impl Drive {
    fn next_rate_rad_s(&mut self, random: &mut Random) -> f64 {
        self.begins_s -= STEP_S;
        self.ends_s -= STEP_S;
        if self.ends_s < 0.0 {
            self.begins_s = random.uniform(3.0, 8.0);
            self.ends_s = self.begins_s + random.uniform(5.0, 20.0);
            let rate_deg_s = random.uniform(2.0_f64.ln(), 38.0_f64.ln()).exp();
            self.rate_rad_s = random.sign() * rate_deg_s.to_radians();
        }
        let nearest_s = self.ends_s.min(-self.begins_s);
        self.rate_rad_s * (nearest_s / RAMP_S).clamp(0.0, 1.0)
    }
}

/// Returns the yaw's largest error, degrees, and the share of the attitudes that were `VALID`.
fn yaw_error_and_valid(seed: u64, vibrations_deg_s: [f64; 2]) -> (f64, f64) {
    let random = &mut Random::new(seed, "rover");
    let mut settings = Settings::new(&Part::MPU_6050);
    settings.sensor = CONFIG.with_sample_rate_divider((PERIOD_US / 1_000 - 1) as u8);
    let mut pipeline = Pipeline::new(&settings);
    let offset_rad_s = [(); 3].map(|()| random.uniform(-5.0, 5.0).to_radians());
    let [least, most] = vibrations_deg_s;
    let vibration_rad_s = random.uniform(least, most).to_radians();
    let mut drive = Drive::default();
    let (mut yaw_rad, mut largest_rad, mut valid) = (0.0, 0.0_f64, 0);
    let samples = SECONDS * 1_000_000 / PERIOD_US;
    for index in 0..samples {
        let rate_rad_s = drive.next_rate_rad_s(random);
        yaw_rad += rate_rad_s * STEP_S;
        let is_turning = rate_rad_s != 0.0;
        let noise_rad_s = if is_turning {
            SENSOR_NOISE_RAD_S.hypot(vibration_rad_s)
        } else {
            SENSOR_NOISE_RAD_S
        };
        let mut reading = |value: f64, sigma: f64| (value + sigma * random.normal()) as f32;
        let [x, y, z] = offset_rad_s;
        let mut sample = Sample::default();
        sample.t_us = index * PERIOD_US;
        sample.angular_rate_rad_s = Vector3::new(
            reading(x, noise_rad_s),
            reading(y, noise_rad_s),
            reading(rate_rad_s + z, noise_rad_s),
        );
        sample.specific_force_m_s2 = Vector3::new(
            reading(0.0, 0.05),
            reading(0.0, 0.05),
            reading(-GRAVITY_M_S2, 0.05),
        );
        let snapshot = pipeline.update_sample(&sample);
        valid += u32::from(snapshot.flags.contains(Flags::VALID));
        let error_rad = f64::from(snapshot.euler().yaw_rad) - yaw_rad;
        let wrapped_rad = (error_rad + PI).rem_euclid(2.0 * PI) - PI;
        largest_rad = largest_rad.max(wrapped_rad.abs());
    }
    (largest_rad.to_degrees(), f64::from(valid) / samples as f64)
}

#[test]
fn the_yaw_follows_the_turns_of_a_rover_that_vibrates() {
    // Vibrations, and most rovers that may lose their yaw. Before revision 28 they were 17 and 120.
    const VIBRATIONS: [([f64; 2], usize); 2] = [([0.3, 2.0], 0), ([0.1, 0.3], 16)];
    let seeds = seeds(870_000..870_120);
    for (vibrations_deg_s, most) in VIBRATIONS {
        let rovers = parallel::map(&seeds, |seed| yaw_error_and_valid(*seed, vibrations_deg_s));
        let errors_deg = rovers.iter().map(|(error_deg, _)| *error_deg);
        let lost = errors_deg.filter(|it| *it > LARGEST_ERROR_DEG).count();
        let valid = rovers.iter().map(|(_, valid)| valid).sum::<f64>() / rovers.len() as f64;
        println!(
            "{} rovers, {vibrations_deg_s:?} °/s rms: {lost} lose their yaw; {valid:.3} VALID",
            seeds.len()
        );
        assert!(lost <= most && valid > 0.98, "{vibrations_deg_s:?}");
    }
}
