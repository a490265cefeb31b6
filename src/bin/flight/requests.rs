//! Requests between the tasks, and the few words that they share without a lock.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use aplomb::board::burst_reader::ReceivedBurst;
use aplomb::board::compass::CompassTask;
use aplomb::calibration::{Calibration, ImuReading, StationaryDetector, StationaryProgress};
use aplomb::console::{Outcome, Task};
use aplomb::mpu6050::{Burst, Part, RawSample};
use aplomb::pipeline::Pipeline;
use aplomb::telemetry::log::NumberedBurst;
use heapless::spsc::Producer;

/// Requests of the console to the supervisor, and the supervisor's results.
pub struct Requests {
    /// The sensor and its address, once it is configured.
    pub sensor: Option<(&'static Part, u8)>,
    /// Calibration with which the pipeline starts.
    pub calibration: Calibration,
    /// True if the pipeline starts armed.
    pub is_armed: bool,
    /// Task that needs a pause of the sensor.
    pub task: Option<Task>,
    /// Outcome of the last task.
    pub outcome: Option<Outcome>,
}

/// True if [`Requests::task`] is set: the supervisor polls this without a lock.
static IS_TASK_PENDING: AtomicBool = AtomicBool::new(false);

/// Announces that a task has been requested.
#[cfg(feature = "full")]
pub fn announce_task() {
    IS_TASK_PENDING.store(true, Ordering::Release);
}

/// Returns whether a task has been requested.
pub fn is_task_pending() -> bool {
    IS_TASK_PENDING.load(Ordering::Acquire)
}

/// Returns whether a task has been requested since the last call.
pub fn take_pending_task() -> bool {
    IS_TASK_PENDING.swap(false, Ordering::Acquire)
}

/// True if the flight log needs bursts. Written by telemetry, read by the attitude task.
pub static IS_LOGGING: AtomicBool = AtomicBool::new(false);

/// Number of bursts that the pipeline has processed. Changes under the pipeline's lock.
pub static BURST_COUNT: AtomicU32 = AtomicU32::new(0);

/// Counts a burst that the pipeline has processed, and queues it for the flight log. A burst
/// without room in the queue is missing in the log, where the numbers show it.
pub fn log_burst(received: &ReceivedBurst, to_log: &mut Producer<'static, NumberedBurst>) {
    let number = BURST_COUNT.load(Ordering::Relaxed);
    BURST_COUNT.store(number.wrapping_add(1), Ordering::Relaxed);
    if IS_LOGGING.load(Ordering::Relaxed) {
        let burst = NumberedBurst {
            number,
            flags: received.flags,
            burst: received.burst,
        };
        to_log.enqueue(burst).ok();
    }
}

/// Data of the attitude task: the pipeline, and the stationary detector of a calibration procedure.
pub struct Estimation {
    /// The pipeline; `None` before the sensor is found.
    pub pipeline: Option<Pipeline>,
    /// The stationary measurement that a calibration procedure has started.
    pub measurement: StationaryMeasurement,
    /// The compass.
    pub compass: CompassTask,
}

/// Mean readings of a stationary sensor, as a calibration procedure collects them.
pub struct StationaryMeasurement {
    detector: Option<StationaryDetector>,
    result: Option<StationaryProgress>,
}

impl StationaryMeasurement {
    /// No measurement.
    pub const fn new() -> Self {
        Self {
            detector: None,
            result: None,
        }
    }

    /// Starts a detector.
    pub fn start(&mut self, detector: StationaryDetector) {
        self.detector = Some(detector);
    }

    /// Stops the detector.
    pub fn stop(&mut self) {
        self.detector = None;
    }

    /// Adds a burst of this part to the detector. Motion, or the complete mean, becomes the result.
    #[inline]
    pub fn update(&mut self, burst: &Burst, part: &Part) {
        let Some(detector) = &mut self.detector else {
            return;
        };
        let raw = RawSample::decode(&burst.bytes);
        let celsius = raw.temperature.to_celsius(part);
        match detector.update(&ImuReading {
            gyroscope: raw.gyroscope.0,
            accelerometer: raw.accelerometer.0,
            temperature_celsius: celsius,
        }) {
            StationaryProgress::Collecting => {}
            progress => {
                if let StationaryProgress::Done(_) = progress {
                    self.detector = None;
                }
                self.result = Some(progress);
            }
        }
    }

    /// Takes the latest result.
    pub fn take_result(&mut self) -> Option<StationaryProgress> {
        self.result.take()
    }

    /// Share of the samples that is collected, 0 to 100 %.
    pub fn progress_percent(&self) -> u8 {
        let detector = self.detector.as_ref();
        detector.map_or(0, StationaryDetector::progress_percent)
    }
}
