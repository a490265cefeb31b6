//! The console's port to the module: implements what commands need with the firmware's shared
//! resources.

use core::sync::atomic::Ordering;

use aplomb::board::uart::{Receiver, Transmitter};
use aplomb::board::{measure, retained};
use aplomb::calibration::compass::CompassFitter;
use aplomb::calibration::{Calibration, Mount, StationaryProgress};
use aplomb::compass;
use aplomb::console::ground_station::GroundStation;
use aplomb::console::{Job, Module, Outcome, State};
use aplomb::fault::FaultClass;
use aplomb::health::WorkFigures;
use aplomb::settings::CompassSettings;
use aplomb::telemetry::heading::Line as HeadingLine;
use rtic::Mutex;

use crate::after_publication::BURST_COUNT;
use crate::estimation::{Estimation, Latest};
use crate::requests::{JOB, MEASUREMENT, NEW_MEASUREMENT, Requests, TO_SUPERVISOR};

/// Port to the module, for one telemetry tick.
pub struct ModulePort<'a, E, R> {
    /// Received bytes.
    pub receiver: &'a mut Receiver,
    /// Sends, and sets the baud rate.
    pub transmitter: &'a mut Transmitter,
    /// The pipeline and the stationary detector.
    pub estimation: E,
    /// Requests to the supervisor.
    pub requests: R,
    /// True if bytes were garbled or lost since the last poll of the console.
    pub has_reception_error: bool,
    /// The ground station's session.
    pub station: &'a mut GroundStation,
    /// True if the received bytes may contain MAVLink frames.
    pub is_mavlink: bool,
    /// Time since boot, µs.
    pub now_us: u64,
    /// Number of the first burst after a change of settings: the flight log restarts there.
    pub changed_at: Option<u32>,
    /// Bursts that failed since boot.
    pub bursts_failed: u16,
}

impl<E, R> Module for ModulePort<'_, E, R>
where
    E: Mutex<T = Estimation>,
    R: Mutex<T = Requests>,
{
    fn receive(&mut self) -> Option<u8> {
        let Self {
            station, receiver, ..
        } = self;
        if self.is_mavlink {
            station.receive(self.now_us, || receiver.receive())
        } else {
            station.discard_text();
            receiver.receive()
        }
    }

    fn take_reception_error(&mut self) -> bool {
        core::mem::take(&mut self.has_reception_error)
    }

    fn state(&mut self) -> State {
        let mut state = State {
            bursts_failed: self.bursts_failed,
            times_missed: times(&[FaultClass::SamplesMissed]),
            times_refused: times(&[FaultClass::Frozen, FaultClass::Rejected]),
            reception_errors: retained::counted(FaultClass::UartInput),
            frames_dropped: retained::counted(FaultClass::TelemetryLate),
            ..State::default()
        };
        if let Some((Latest { snapshot, heading }, _)) = Latest::read() {
            state.heading = heading.map(|heading| HeadingLine::new(&snapshot, &heading));
            state.flags = snapshot.flags;
            state.tilt_sigma_rad = snapshot.tilt_sigma_rad();
        }
        state.sensor = self.requests.lock(|requests| requests.sensor);
        self.estimation.lock(|estimation| {
            state.compass = estimation.compass.status();
            let Some(pipeline) = estimation.pipeline.as_ref() else {
                return;
            };
            let filter = pipeline.kalman();
            state.temperature_celsius = pipeline.temperature_celsius();
            state.bias_rad_s = pipeline.gyroscope_offset_body_rad_s();
            state.bias_sigma_rad_s = filter.largest_bias_sigma_rad_s();
            state.accelerometer_offset_m_s2 = pipeline.certain_accelerometer_offset_m_s2();
        });
        state
    }

    fn set_calibration(&mut self, calibration: &Calibration) {
        let mut has_restarted = false;
        self.changed_at = self.estimation.lock(|estimation| {
            let pipeline = estimation.pipeline.as_mut()?;
            has_restarted = pipeline.set_calibration(calibration);
            Some(BURST_COUNT.load(Ordering::Relaxed))
        });
        // A lock of its own: the attitude task waits for one restart, not for both.
        if compass::IS_BUILT_IN && has_restarted {
            self.estimation
                .lock(|estimation| estimation.compass.restart_heading());
        }
    }

    fn set_compass(&mut self, settings: &CompassSettings, imu_mount: Mount) {
        if !compass::IS_BUILT_IN {
            return;
        }
        let alignment = settings.alignment(imu_mount);
        let (mut has_changed, number) = self.estimation.lock(|estimation| {
            let compass = &mut estimation.compass;
            let is_other = compass.choice() != settings.choice;
            if is_other {
                compass.choose(settings.choice);
            }
            (is_other, BURST_COUNT.load(Ordering::Relaxed))
        });
        has_changed |= self.estimation.lock(|estimation| {
            let compass = &mut estimation.compass;
            let is_turned = compass.set_declination(settings.declination_rad);
            compass.set_alignment(alignment) || is_turned
        });
        if has_changed {
            self.changed_at.get_or_insert(number);
        }
    }

    fn start_compass_fitter(&mut self) {
        self.estimation
            .lock(|estimation| estimation.compass.start_fitter());
    }

    fn stop_compass_fitter(&mut self) {
        self.estimation
            .lock(|estimation| estimation.compass.stop_fitter());
    }

    fn compass_fitter(&mut self) -> Option<CompassFitter> {
        if !compass::IS_BUILT_IN {
            return None;
        }
        self.estimation
            .lock(|estimation| estimation.compass.fitter())
    }

    fn start_detector(&mut self, samples: u16) {
        self.estimation.lock(|estimation| {
            if let Some(pipeline) = &estimation.pipeline {
                estimation
                    .measurement
                    .start(pipeline.stationary_detector(samples));
            }
        });
    }

    fn stop_detector(&mut self) {
        self.estimation
            .lock(|estimation| estimation.measurement.stop());
    }

    fn take_detector_progress(&mut self) -> Option<StationaryProgress> {
        self.estimation
            .lock(|estimation| estimation.measurement.take_result())
    }

    fn detector_percent(&mut self) -> u8 {
        self.estimation
            .lock(|estimation| estimation.measurement.progress_percent())
    }

    fn set_armed(&mut self, is_armed: bool) {
        self.changed_at = self.estimation.lock(|estimation| {
            // No sample comes between the two.
            retained::set_armed(is_armed);
            estimation.pipeline.as_mut()?.set_armed(is_armed);
            Some(BURST_COUNT.load(Ordering::Relaxed))
        });
    }

    fn set_baud(&mut self, baud: u32) -> bool {
        let has_changed = self.transmitter.set_baud(baud);
        if has_changed {
            self.receiver.discard(baud);
            self.station.discard();
        }
        has_changed
    }

    fn begin(&mut self, job: Job) {
        self.requests.lock(|requests| {
            requests.job = Some(job);
            requests.outcome = None;
        });
        TO_SUPERVISOR.set(JOB, true);
    }

    fn set_measuring(&mut self, is_on: bool) {
        TO_SUPERVISOR.set(MEASUREMENT | NEW_MEASUREMENT, is_on);
    }

    fn work_figures(&mut self) -> WorkFigures {
        measure::figures()
    }

    fn take_outcome(&mut self) -> Option<Outcome> {
        self.requests.lock(|requests| requests.outcome.take())
    }
}

/// Returns the number of these faults since power-up, at most 65,535.
fn times(classes: &[FaultClass]) -> u16 {
    let count = |sum: u32, class: &FaultClass| sum.saturating_add(retained::counted(*class));
    classes.iter().fold(0, count).min(u16::MAX.into()) as u16
}
