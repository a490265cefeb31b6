//! Requests between the tasks, and the few words that they share without a lock.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use aplomb::board::burst_reader::ReceivedBurst;
use aplomb::board::compass::CompassTask;
#[cfg(feature = "full")]
use aplomb::board::measure;
use aplomb::calibration::{Calibration, ImuReading, StationaryDetector, StationaryProgress};
use aplomb::console::{Outcome, Task};
use aplomb::estimator::heading::HeadingEstimate;
use aplomb::mpu6050::{Burst, Part, RawSample};
use aplomb::pipeline::{Pipeline, Snapshot};
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

impl Requests {
    /// Creates requests without a task, for a pipeline that starts disarmed with this calibration.
    pub const fn new(calibration: Calibration) -> Self {
        Self {
            sensor: None,
            calibration,
            is_armed: false,
            task: None,
            outcome: None,
        }
    }
}

/// Requests to the supervisor, which polls them without a lock.
pub static TO_SUPERVISOR: RequestBits = RequestBits::new();
/// [`Requests::task`] is set.
pub const TASK: u8 = 1;
/// A measurement is wanted.
#[cfg(feature = "full")]
pub const MEASUREMENT: u8 = 2;
/// The measurement starts again without figures.
#[cfg(feature = "full")]
pub const NEW_MEASUREMENT: u8 = 4;

/// Work of the attitude task after each publication, besides counting it.
pub static AFTER_PUBLICATION: RequestBits = RequestBits::new();
/// The flight log needs bursts.
pub const LOG: u8 = 1;
/// A calibration procedure measures at rest.
pub const STATIONARY: u8 = 2;
/// A measurement runs.
#[cfg(feature = "full")]
pub const FIGURES: u8 = 4;

/// Latest attitude with its heading, as telemetry sends them.
pub struct Latest {
    /// Attitude. Its flags include that of the heading.
    pub snapshot: Snapshot,
    /// Heading; `None` while it is unknown.
    pub heading: Option<HeadingEstimate>,
}

/// Bits that one task sets and another polls.
pub struct RequestBits(AtomicU8);

impl RequestBits {
    const fn new() -> Self {
        Self(AtomicU8::new(0))
    }

    /// Returns all bits.
    #[inline(always)]
    pub fn bits(&self) -> u8 {
        self.0.load(Ordering::Acquire)
    }

    /// Returns whether this bit is set.
    pub fn contains(&self, bit: u8) -> bool {
        self.bits() & bit != 0
    }

    /// Sets or clears these bits. Returns whether one of them was set before.
    pub fn set(&self, bits: u8, is_set: bool) -> bool {
        let before = if is_set {
            self.0.fetch_or(bits, Ordering::AcqRel)
        } else {
            self.0.fetch_and(!bits, Ordering::AcqRel)
        };
        before & bits != 0
    }
}

/// Number of bursts that the pipeline has processed. Changes under the pipeline's lock.
pub static BURST_COUNT: AtomicU32 = AtomicU32::new(0);

/// Counts a burst that the pipeline has processed, and passes it on to those that need it.
#[inline(always)]
pub fn after_publication(
    received: &ReceivedBurst,
    part: &Part,
    measurement: &mut StationaryMeasurement,
    to_log: &mut Producer<'static, NumberedBurst>,
) {
    let number = BURST_COUNT.load(Ordering::Relaxed);
    BURST_COUNT.store(number.wrapping_add(1), Ordering::Relaxed);
    let work = AFTER_PUBLICATION.bits();
    if !cfg!(feature = "full") || work == 0 {
        return;
    }
    // First, because it takes the time of the publication.
    #[cfg(feature = "full")]
    if work & FIGURES != 0 {
        measure::on_published(&received.burst);
    }
    if work & (STATIONARY | LOG) != 0 {
        pass_on(number, received, part, measurement, to_log);
    }
}

/// Passes a burst on. A burst without room in the log's queue is missing in the log, where the
/// numbers show it.
#[inline(never)]
fn pass_on(
    number: u32,
    received: &ReceivedBurst,
    part: &Part,
    measurement: &mut StationaryMeasurement,
    to_log: &mut Producer<'static, NumberedBurst>,
) {
    if AFTER_PUBLICATION.contains(STATIONARY) {
        measurement.update(&received.burst, part);
    }
    if AFTER_PUBLICATION.contains(LOG) {
        let burst = NumberedBurst {
            number,
            flags: received.flags,
            burst: received.burst,
        };
        to_log.enqueue(burst).ok();
    }
}

/// Data of the attitude task: the pipeline, and the stationary detector of a calibration procedure.
///
/// The fields keep this order in memory, because a core reaches the first kilobyte with shorter
/// code.
#[repr(C)]
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
        AFTER_PUBLICATION.set(STATIONARY, true);
    }

    /// Stops the detector.
    pub fn stop(&mut self) {
        self.detector = None;
        AFTER_PUBLICATION.set(STATIONARY, false);
    }

    /// Adds a burst of this part to the detector. Motion, or the complete mean, becomes the result.
    fn update(&mut self, burst: &Burst, part: &Part) {
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
                    self.stop();
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
