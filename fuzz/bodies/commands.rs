//! Random bytes at the UART: the console answers within its bounds, and keeps a usable record.

use std::collections::VecDeque;

use aplomb::calibration::compass::CompassFitter;
use aplomb::calibration::{Calibration, Mount, StationaryProgress};
use aplomb::compass::Choice;
use aplomb::console::answer::ANSWER_CAPACITY;
use aplomb::console::command::{BAUD_RATES, Command, RATES_HZ};
use aplomb::console::{Console, Job, Module, Outcome, State};
use aplomb::health::WorkFigures;
use aplomb::mpu6050::Part;
use aplomb::pipeline::Settings;
use aplomb::settings::CompassSettings;
use aplomb::settings::storage::Loaded;
use aplomb::telemetry;

/// Runs the bytes through a console.
///
/// # Panics
///
/// Panics if an invariant is violated.
pub fn run(bytes: &[u8]) {
    let settings = Settings::new(&Part::MPU_6050);
    let mut console = Console::new(
        Loaded::default(),
        settings.noise_model(),
        settings.sensor.sample_rate_hz(),
        Mount::Z_UP,
        Choice::Auto,
        false,
    );
    let mut wire = Wire::default();
    let mut now_us = 0_u32;
    for chunk in bytes.chunks(64) {
        wire.received.extend(chunk);
        for _ in 0..4 {
            now_us = now_us.wrapping_add(20_000);
            let mut answer = String::new();
            if let Some(kind) = console.poll(now_us, &mut wire, &mut answer) {
                assert!(answer.len() <= ANSWER_CAPACITY, "{answer}");
                assert!(answer.starts_with(kind.name()), "{answer}");
                assert!(
                    answer.bytes().all(|byte| (b' '..=b'~').contains(&byte)),
                    "{answer}"
                );
            }
            let preferences = console.working().preferences;
            assert!(RATES_HZ.contains(&preferences.rate_hz));
            assert!(BAUD_RATES.contains(&preferences.baud));
            let max_hz = telemetry::largest_rate_hz(preferences.format, preferences.baud);
            assert!(u32::from(preferences.rate_hz) <= max_hz);
        }
    }
    if let Ok(line) = std::str::from_utf8(bytes)
        && let Err(error) = line.parse::<Command>()
    {
        assert!(!error.to_string().is_empty());
    }
}

/// Fake module with a UART only.
#[derive(Default)]
struct Wire {
    received: VecDeque<u8>,
    is_armed: bool,
    outcome: Option<Outcome>,
}

impl Module for Wire {
    fn receive(&mut self) -> Option<u8> {
        self.received.pop_front()
    }

    fn take_reception_error(&mut self) -> bool {
        false
    }

    fn state(&mut self) -> State {
        State {
            sensor: Some((&Part::MPU_6050, 0x68)),
            ..State::default()
        }
    }

    fn set_calibration(&mut self, _calibration: &Calibration) {
        assert!(!self.is_armed);
    }

    fn set_compass(&mut self, _settings: &CompassSettings, _imu_mount: Mount) {
        assert!(!self.is_armed);
    }

    fn start_compass_fitter(&mut self) {
        assert!(!self.is_armed);
    }

    fn stop_compass_fitter(&mut self) {}

    fn compass_fitter(&mut self) -> Option<CompassFitter> {
        None
    }

    fn start_detector(&mut self, samples: u16) {
        assert!(!self.is_armed && samples > 0);
    }

    fn stop_detector(&mut self) {}

    fn take_detector_progress(&mut self) -> Option<StationaryProgress> {
        None
    }

    fn detector_percent(&mut self) -> u8 {
        0
    }

    fn set_armed(&mut self, is_armed: bool) {
        self.is_armed = is_armed;
    }

    fn set_measuring(&mut self, is_on: bool) {
        assert!(!self.is_armed || !is_on);
    }

    fn work_figures(&mut self) -> WorkFigures {
        WorkFigures::default()
    }

    fn set_baud(&mut self, _baud: u32) -> bool {
        assert!(!self.is_armed);
        self.received.clear();
        true
    }

    fn begin(&mut self, _job: Job) {
        assert!(!self.is_armed && self.outcome.is_none());
        self.outcome = Some(Outcome::new(true, &"stored"));
    }

    fn take_outcome(&mut self) -> Option<Outcome> {
        self.outcome.take()
    }
}
