//! Recorded log as a motion: the readings of a sensor on the recorded path, at any time.
//!
//! Time line: 3 s of rest, level; 1 s of smooth turn into the recording's first pose; then the
//! recording. The filter thus starts at rest, though recordings often begin in motion. Only the
//! recording's own time counts for scores.
//!
//! Specific force and rates are interpolated linearly between rows, the truth along the great
//! circle. A log's frames are sensor axes and an earth with z up; they become body axes and
//! north-east-down through the mount.

use std::path::Path;

use crate::log::{Log, LogError, Row};
use crate::units::RowOptions;
use aplomb_models::motion::geometry::{Quaternion, Vector, add, interpolate, norm, scale};
use aplomb_models::motion::truth::{ROOM_TEMPERATURE_C, Truth};
use aplomb_models::motion::turn::Turn;
use aplomb_models::motion::{Motion, Mount};
use aplomb_models::random::Random;

/// Level rest at the start, s.
pub const REST_S: f64 = 3.0;
/// Turn into the first pose, s.
pub const TURN_S: f64 = 1.0;

/// σ of an MPU-6050's rates, rad/s: 0.005 °/s/√Hz in 100 Hz (product specification §6.1).
const RATE_NOISE_RAD_S: f64 = 0.05 / 57.295_779_513;
/// σ of an MPU-6050's force, m/s²: 400 µg/√Hz in 100 Hz (product specification §6.2).
const FORCE_NOISE_M_S2: f64 = 4e-3 * 9.806_65;

/// Length of the part of the recording that shows the first pose, s.
const FIRST_POSE_S: f64 = 0.3;
/// Longest gap between two rows with a known truth between them, s.
const TRUTH_GAP_S: f64 = 0.1;

/// An earth with z up, in a motion's earth with z down: x stays, y and z turn around. Half a turn
/// about x.
///
/// So the first axis of a motion, which its yaw starts from, is the x axis of the log. In a log
/// with a compass that is east, and not north: [`simulated_compass`](crate::simulated_compass)
/// turns it.
const UP_TO_DOWN: Quaternion = Quaternion::new(0.0, 1.0, 0.0, 0.0);

/// Returns the attitude (body → earth, north-east-down) of a log's truth (sensor → earth with z
/// up).
#[must_use]
pub fn body_to_earth(truth: Quaternion, mount: Mount) -> Quaternion {
    UP_TO_DOWN.multiply(truth).multiply(mount.body_to_sensor())
}

/// Returns the truth of a log for this attitude (body → earth, north-east-down): the inverse of
/// [`body_to_earth`].
#[must_use]
pub fn truth_of(body_to_earth: Quaternion, mount: Mount) -> Quaternion {
    UP_TO_DOWN
        .conjugate()
        .multiply(body_to_earth)
        .multiply(mount.body_to_sensor().conjugate())
}

/// Recording that can be played once.
#[derive(Clone, Debug)]
pub struct Recording {
    samples: Vec<Sample>,
    /// Times of the changes of the armed state, s after power-up, with the state from there on.
    arming: Vec<(f64, bool)>,
    turn: Turn,
    /// Sample at or before the last requested time.
    cursor: usize,
    /// Noise of the sensor before the recording begins, which brings its own.
    noise: Option<Random>,
}

/// Row in body axes and north-east-down.
#[derive(Clone, Copy, Debug)]
struct Sample {
    /// Time since power-up.
    time_s: f64,
    specific_force_m_s2: Vector,
    body_rates_rad_s: Vector,
    attitude: Option<Quaternion>,
    /// True if the row counts for scores.
    scored: bool,
}

impl Recording {
    /// Reads the log of a sensor with this mount.
    ///
    /// # Errors
    ///
    /// See [`Log::read`].
    pub fn open(path: &Path, mount: Mount) -> Result<Self, LogError> {
        Ok(Self::new(&Log::read(path)?, mount))
    }

    /// Reads the log of a sensor with this mount, in these units.
    ///
    /// # Errors
    ///
    /// See [`Log::read_with`].
    pub fn open_with(path: &Path, mount: Mount, options: RowOptions) -> Result<Self, LogError> {
        Ok(Self::new(&Log::read_with(path, options)?, mount))
    }

    /// Creates the recording of a log, of a sensor with this mount.
    #[must_use]
    pub fn new(log: &Log, mount: Mount) -> Self {
        let rows = log.rows();
        let start_us = rows.first().map_or(0, |row| row.time_us);
        let samples: Vec<Sample> = rows
            .iter()
            .map(|row| Sample::new(row, start_us, mount))
            .collect();
        Self {
            turn: Turn::new(Quaternion::IDENTITY, first_pose(&samples), TURN_S),
            arming: arming(rows, start_us),
            samples,
            cursor: 0,
            noise: None,
        }
    }

    /// Adds the noise of an MPU-6050 to the rest and the turn before the recording. Without noise
    /// a sensor at rest repeats its data to the bit, as a broken one does.
    #[must_use]
    pub fn with_noise(mut self, seed: u64) -> Self {
        self.noise = Some(Random::new(seed, "noise before a recording"));
        self
    }

    /// Returns the end of the recording, s after power-up. Later the last row stays, without truth.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.samples.last().map_or(0.0, |sample| sample.time_s)
    }

    /// Returns the changes of the column `armed`: time, s after power-up, and the state from there
    /// on. It begins disarmed.
    #[must_use]
    pub fn arming(&self) -> &[(f64, bool)] {
        &self.arming
    }
}

impl Motion for Recording {
    fn at(&mut self, time_s: f64) -> Truth {
        if time_s < REST_S + TURN_S {
            let (attitude, body_rates_rad_s) = self.turn.at(time_s - REST_S);
            let at_rest = Truth::at_rest(attitude);
            let Some(random) = &mut self.noise else {
                return Truth {
                    body_rates_rad_s,
                    ..at_rest
                };
            };
            let mut noisy = |value: Vector, sigma: f64| value.map(|v| v + sigma * random.normal());
            return Truth {
                body_rates_rad_s: noisy(body_rates_rad_s, RATE_NOISE_RAD_S),
                specific_force_m_s2: noisy(at_rest.specific_force_m_s2, FORCE_NOISE_M_S2),
                ..at_rest
            };
        }
        while self
            .samples
            .get(self.cursor + 1)
            .is_some_and(|next| next.time_s <= time_s)
        {
            self.cursor += 1;
        }
        let current = self.samples[self.cursor];
        match self.samples.get(self.cursor + 1) {
            Some(next) => current.towards(next, time_s),
            None => Truth {
                attitude: None,
                scored: false,
                ..current.towards(&current, time_s)
            },
        }
    }
}

impl Sample {
    fn new(row: &Row, start_us: i64, mount: Mount) -> Self {
        Self {
            time_s: time_s(row, start_us),
            specific_force_m_s2: mount.to_body(row.specific_force_m_s2),
            body_rates_rad_s: mount.to_body(row.rates_rad_s),
            attitude: row.attitude.map(|truth| body_to_earth(truth, mount)),
            scored: row.scored,
        }
    }

    /// Returns the truth at `time_s`, between this sample and the next.
    fn towards(&self, next: &Self, time_s: f64) -> Truth {
        let gap_s = next.time_s - self.time_s;
        let share = if gap_s > 0.0 {
            (time_s - self.time_s) / gap_s
        } else {
            0.0
        };
        let attitude = match (self.attitude, next.attitude) {
            (Some(start), Some(end)) if gap_s <= TRUTH_GAP_S => Some(start.slerp(end, share)),
            _ => None,
        };
        Truth {
            specific_force_m_s2: interpolate(
                self.specific_force_m_s2,
                next.specific_force_m_s2,
                share,
            ),
            body_rates_rad_s: interpolate(self.body_rates_rad_s, next.body_rates_rad_s, share),
            attitude,
            temperature_c: ROOM_TEMPERATURE_C,
            thrust_g: 0.0,
            scored: attitude.is_some() && self.scored && next.scored,
        }
    }
}

/// Returns the time of a row, s after power-up.
fn time_s(row: &Row, start_us: i64) -> f64 {
    REST_S + TURN_S + row.time_us.abs_diff(start_us) as f64 * 1e-6
}

/// Returns the changes of the armed state.
fn arming(rows: &[Row], start_us: i64) -> Vec<(f64, bool)> {
    let mut is_armed = false;
    let changes = rows.iter().filter_map(|row| {
        let before = is_armed;
        is_armed = row.armed.unwrap_or(before);
        (is_armed != before).then(|| (time_s(row, start_us), is_armed))
    });
    changes.collect()
}

/// Returns the attitude (body → earth) at the first row.
fn first_pose(samples: &[Sample]) -> Quaternion {
    let start_s = REST_S + TURN_S;
    let early = samples
        .iter()
        .take_while(|sample| sample.time_s <= start_s + FIRST_POSE_S);
    // Turn back by the gyroscope from the first known attitude to the first row.
    let mut turned = Quaternion::IDENTITY;
    let mut before = samples[0];
    for sample in early.clone() {
        let mean_rate = scale(add(before.body_rates_rad_s, sample.body_rates_rad_s), 0.5);
        let turn = scale(mean_rate, sample.time_s - before.time_s);
        turned = turned.multiply(Quaternion::from_rotation_vector(turn));
        if let Some(attitude) = sample.attitude {
            return attitude.multiply(turned.conjugate());
        }
        before = *sample;
    }
    level_by(
        early
            .map(|sample| sample.specific_force_m_s2)
            .fold([0.0; 3], add),
    )
}

/// Returns the attitude with heading 0 in which a body at rest feels this specific force, in body
/// axes; any length.
fn level_by(specific_force: Vector) -> Quaternion {
    let [x, y, z] = specific_force;
    if norm(specific_force) == 0.0 {
        return Quaternion::IDENTITY;
    }
    Quaternion::from_euler(libm::atan2(-y, -z), libm::atan2(x, libm::hypot(y, z)), 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::at_hand;
    use aplomb_models::motion::geometry::{angle_between, subtract};
    use aplomb_models::motion::truth::{STANDARD_GRAVITY_M_S2, inclination_error_rad, up_in_body};
    use std::path::PathBuf;

    const LEAD_IN_S: f64 = REST_S + TURN_S;

    /// Writes a log to a file, and reads it through the whole path.
    fn recording(name: &str, text: &str, mount: Mount) -> Recording {
        let path =
            std::env::temp_dir().join(format!("aplomb-recording-{}-{name}", std::process::id()));
        std::fs::write(&path, text).unwrap();
        let result = Recording::open(&path, mount);
        std::fs::remove_file(&path).unwrap();
        result.unwrap()
    }

    fn difference(left: Quaternion, right: Quaternion) -> f64 {
        norm(left.conjugate().multiply(right).to_rotation_vector())
    }

    #[test]
    fn level_rest_in_the_log_is_level_rest_of_the_body() {
        let log = "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz\n0,0,0,9.80665,0,0,0,1,0,0,0\n\
                   100000,0,0,9.80665,0,0,0,1,0,0,0\n";
        let mut recording = recording("level", log, Mount::Z_UP);
        for time_s in [0.0, 3.5, 4.05] {
            let truth = recording.at(time_s);
            assert!(
                norm(subtract(
                    truth.specific_force_m_s2,
                    [0.0, 0.0, -STANDARD_GRAVITY_M_S2]
                )) < 1e-9
            );
            assert!(difference(truth.attitude.unwrap(), Quaternion::IDENTITY) < 1e-9);
            assert_eq!(truth.scored, time_s > LEAD_IN_S);
        }
    }

    #[test]
    fn values_are_interpolated_between_the_rows_and_the_frames_are_the_bodys() {
        // Sensor z up: x forward, y to the left. The sensor yaws left (positive about up) by 0.2
        // rad in 0.1 s.
        let (sine, cosine) = 0.1_f64.sin_cos();
        let log = format!(
            "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz,mov\n\
             50,1,2,9,0.1,0.2,0.3,1,0,0,0,1\n100050,3,6,9,0.3,0.2,0.3,{cosine},0,0,{sine},1\n\
             180050,3,6,9,0.3,0.2,0.3,{cosine},0,0,{sine},0\n"
        );
        let mut recording = recording("between", &log, Mount::Z_UP);
        let truth = recording.at(LEAD_IN_S + 0.05);
        assert!(norm(subtract(truth.specific_force_m_s2, [2.0, -4.0, -9.0])) < 1e-9);
        assert!(norm(subtract(truth.body_rates_rad_s, [0.2, -0.2, -0.3])) < 1e-9);
        // Left is negative in north-east-down.
        assert!(
            difference(
                truth.attitude.unwrap(),
                Quaternion::from_euler(0.0, 0.0, -0.1)
            ) < 1e-9
        );
        assert!(truth.scored);
        // The next row does not count, though its truth is known.
        let truth = recording.at(LEAD_IN_S + 0.15);
        assert!(truth.attitude.is_some() && !truth.scored);
        assert!((recording.end_s() - LEAD_IN_S - 0.18).abs() < 1e-12);
        let late = recording.at(LEAD_IN_S + 5.0);
        assert_eq!((late.attitude, late.scored), (None, false));
        assert_eq!(late.specific_force_m_s2, [3.0, -6.0, -9.0]);
    }

    #[test]
    fn the_armed_state_is_that_of_the_rows() {
        let row = "0,0,9.80665,0,0,0";
        let log = format!(
            "t_us,ax,ay,az,gx,gy,gz,armed\n7000,{row},0\n8000,{row},1\n9000,{row},\n\
             10000,{row},1\n11000,{row},0\n"
        );
        let armed = recording("armed", &log, Mount::Z_UP);
        let times = armed.arming().iter().map(|(at_s, is_armed)| {
            let after_us = (at_s - LEAD_IN_S) * 1e6;
            (after_us.round() as i64, *is_armed)
        });
        assert_eq!(times.collect::<Vec<_>>(), [(1000, true), (4000, false)]);
        let log = log.replace(",armed", ",other");
        let without = recording("unarmed", &log, Mount::Z_UP);
        assert_eq!(without.arming(), []);
    }

    #[test]
    fn the_truth_becomes_the_bodys_through_every_mount() {
        let sensor_to_up = Quaternion::from_rotation_vector([0.7, -1.1, 0.4]);
        let Quaternion { w, x, y, z } = sensor_to_up;
        let [ax, ay, az] = sensor_to_up
            .conjugate()
            .rotate([0.0, 0.0, STANDARD_GRAVITY_M_S2]);
        let row = format!("{ax},{ay},{az},0,0,0,{w},{x},{y},{z}");
        let log = format!("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz\n0,{row}\n9000,{row}\n");
        for name in Mount::names() {
            let mut recording = recording("mounts", &log, Mount::parse(&name).unwrap());
            let truth = recording.at(LEAD_IN_S + 0.005);
            let at_rest = Truth::at_rest(truth.attitude.unwrap()).specific_force_m_s2;
            let away = norm(subtract(at_rest, truth.specific_force_m_s2));
            assert!(away < 1e-9, "{name}: {away}");
        }
    }

    #[test]
    fn the_truth_of_an_attitude_is_that_attitude_again() {
        let attitude = Quaternion::from_euler(0.7, -1.1, 2.4);
        for name in Mount::names() {
            let mount = Mount::parse(&name).unwrap();
            let again = body_to_earth(truth_of(attitude, mount), mount);
            assert!(difference(attitude, again) < 1e-9, "{name}");
        }
    }

    #[test]
    fn truth_is_not_made_up_across_gaps_and_empty_cells() {
        let log = "t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz\n0,0,0,9.8,0,0,0,1,0,0,0\n\
                   50000,0,0,9.8,0,0,0,,,,\n\
                   60000,0,0,9.8,0,0,0,1,0,0,0\n70000,0,0,9.8,0,0,0,1,0,0,0\n\
                   500000,0,0,9.8,0,0,0,1,0,0,0\n";
        let mut recording = recording("gaps", log, Mount::Z_UP);
        for (elapsed_s, known) in [(0.01, false), (0.055, false), (0.065, true), (0.3, false)] {
            let truth = recording.at(LEAD_IN_S + elapsed_s);
            assert_eq!(
                (truth.attitude.is_some(), truth.scored),
                (known, known),
                "at {elapsed_s}"
            );
        }
    }

    #[test]
    fn the_time_before_the_recording_has_the_noise_of_a_sensor_and_the_recording_none_added() {
        let log = "t_us,ax,ay,az,gx,gy,gz\n0,0,0,9.81,0,0,0\n1000000,0,0,9.81,0,0,0\n";
        let mut recording = recording("noise", log, Mount::Z_UP).with_noise(1);
        let mut squares = [0.0; 2];
        for index in 0..3_000 {
            let truth = recording.at(f64::from(index) * 1e-3);
            squares[0] += truth.body_rates_rad_s[1].powi(2) / 3e3;
            squares[1] += truth.specific_force_m_s2[0].powi(2) / 3e3;
        }
        // An LSB of the gyroscope at 2,000 °/s is 0.06 °/s: bits change.
        let [rate, force] = squares.map(f64::sqrt);
        assert!((0.04..0.06).contains(&rate.to_degrees()), "{rate}");
        assert!((0.03..0.05).contains(&force), "{force}");
        let truth = recording.at(LEAD_IN_S + 0.5);
        assert_eq!(
            (truth.body_rates_rad_s, truth.specific_force_m_s2[0]),
            ([0.0; 3], 0.0)
        );
    }

    #[test]
    fn without_truth_the_first_pose_is_found_from_the_specific_force_in_any_attitude() {
        for (name, mount) in
            ["+x-z", "+x+z", "-y+x"].map(|name| (name, Mount::parse(name).unwrap()))
        {
            for up_in_sensor in [
                [0.0, 0.0, 1.0],
                [0.0, 0.0, -1.0],
                [0.6, -0.64, 0.48],
                [1.0, 0.0, 0.0],
            ] {
                let [x, y, z] = scale(up_in_sensor, STANDARD_GRAVITY_M_S2);
                let rows: Vec<String> = (0..100)
                    .map(|index| format!("{},{x},{y},{z},0,0,0", index * 10_000))
                    .collect();
                let log = format!("t_us,ax,ay,az,gx,gy,gz\n{}\n", rows.join("\n"));
                let mut recording = recording("pose", &log, mount);
                let before = recording.at(LEAD_IN_S - 1e-9);
                let after = recording.at(LEAD_IN_S);
                let step = norm(subtract(
                    before.specific_force_m_s2,
                    after.specific_force_m_s2,
                ));
                assert!(step < 1e-6, "{name} {up_in_sensor:?}: {step}");
                let up = up_in_body(before.attitude.unwrap());
                assert!(
                    angle_between(up, mount.to_body(up_in_sensor)) < 1e-6,
                    "{name} {up_in_sensor:?}"
                );
            }
        }
    }

    #[test]
    fn a_first_pose_known_late_is_turned_back_to_the_start() {
        // Rolling at 1 rad/s; the truth appears 0.1 s after the start.
        let mut log = String::from("t_us,ax,ay,az,gx,gy,gz,qw,qx,qy,qz\n");
        for index in 0..60 {
            let time_s = f64::from(index) * 0.01;
            let (sine, cosine) = (0.5 * time_s).sin_cos();
            let truth = if index < 10 {
                ",,,".to_owned()
            } else {
                format!("{cosine},{sine},0,0")
            };
            log += &format!("{},0,0,9.8,1,0,0,{truth}\n", index * 10_000);
        }
        let mut recording = recording("late", &log, Mount::Z_UP);
        let pose = recording.at(LEAD_IN_S - 1e-9).attitude.unwrap();
        assert!(difference(pose, Quaternion::IDENTITY) < 1e-9);
        let known = recording.at(LEAD_IN_S + 0.25).attitude.unwrap();
        assert!(difference(known, Quaternion::from_euler(0.25, 0.0, 0.0)) < 1e-9);
    }

    #[test]
    fn the_turn_is_smooth_and_its_rates_lead_to_the_first_pose() {
        let log = "t_us,ax,ay,az,gx,gy,gz\n0,0,7,-7,0,0,0\n1000000,0,7,-7,0,0,0\n";
        let mut recording = recording("turn", log, Mount::Z_UP);
        let mut attitude = recording.at(0.0).attitude.unwrap();
        let step_s = 1e-4;
        for index in 0..40_000 {
            let truth = recording.at((f64::from(index) + 0.5) * step_s);
            assert!(!truth.scored);
            assert!((norm(truth.specific_force_m_s2) - STANDARD_GRAVITY_M_S2).abs() < 1e-9);
            attitude = attitude.multiply(Quaternion::from_rotation_vector(scale(
                truth.body_rates_rad_s,
                step_s,
            )));
        }
        let end = recording.at(LEAD_IN_S - 1e-9).attitude.unwrap();
        assert!(difference(attitude, end) < 1e-6);
        assert!(
            inclination_error_rad(end, Quaternion::IDENTITY) > 2.0,
            "it ends upside down, on its side"
        );
    }

    /// Returns the recordings of a set, if they are at hand.
    fn recordings(set: &str) -> Vec<PathBuf> {
        let Some(folder) = at_hand::set(set) else {
            return Vec::new();
        };
        let entries = std::fs::read_dir(&folder).expect("the folder can be read");
        let entries = entries.map(|entry| entry.expect("the folder can be read").path());
        let mut files: Vec<PathBuf> = entries.collect();
        assert!(!files.is_empty(), "{} is empty", folder.display());
        files.sort();
        files
    }

    #[test]
    fn real_recordings_are_consistent_with_their_own_truth() {
        for file in recordings("broad").into_iter().chain(recordings("tumvi")) {
            let mut recording = Recording::open(&file, Mount::Z_UP).unwrap();
            // At the first pose gravity is where the truth says: within 15°, for some begin in
            // motion.
            let before = recording.at(LEAD_IN_S - 1e-9);
            let after = recording.at(LEAD_IN_S);
            let angle =
                angle_between(before.specific_force_m_s2, after.specific_force_m_s2).to_degrees();
            assert!(angle < 15.0, "{}: {angle}°", file.display());
            // Over stretches of a quarter of a second the rates turn the body as the truth turns.
            // Not exactly: these sensors lag their truth by some milliseconds.
            let (mut scored, mut differences_deg) = (0, Vec::new());
            let (mut start, mut turned) = (None, Quaternion::IDENTITY);
            let step_s = 1e-3;
            for index in 0..60_000 {
                let truth = recording.at(LEAD_IN_S + f64::from(index) * step_s);
                scored += u32::from(truth.scored);
                if index % 250 == 0 {
                    if let (Some(start), Some(end)) = (start, truth.attitude) {
                        let truly = Quaternion::conjugate(start).multiply(end);
                        differences_deg.push(difference(turned, truly).to_degrees());
                    }
                    (start, turned) = (truth.attitude, Quaternion::IDENTITY);
                }
                turned = turned.multiply(Quaternion::from_rotation_vector(scale(
                    truth.body_rates_rad_s,
                    step_s,
                )));
            }
            assert!(scored > 1000, "{}: {scored}", file.display());
            differences_deg.sort_by(f64::total_cmp);
            let median_deg = differences_deg[differences_deg.len() / 2];
            assert!(median_deg < 0.6, "{}: {median_deg}°", file.display());
        }
    }

    #[test]
    fn recordings_without_truth_play_and_raw_counts_are_refused() {
        for file in recordings("xio") {
            let mut recording = Recording::open(&file, Mount::Z_UP).unwrap();
            assert!(recording.end_s() > 100.0);
            let truth = recording.at(50.0);
            assert_eq!((truth.attitude, truth.scored), (None, false));
        }
        for file in recordings("mpu6050-raw") {
            let error = Recording::open(&file, Mount::Z_UP).unwrap_err();
            assert_eq!(error.line, Some(2), "{error}");
            assert!(
                error.to_string().contains("did you mean register counts"),
                "{error}"
            );
        }
    }
}
