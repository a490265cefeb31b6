//! Work of the attitude task after each publication: counts the burst. Passes it to a measurement,
//! a calibration procedure and the flight log, as [`AFTER_PUBLICATION`] requests.

use core::sync::atomic::{AtomicU32, Ordering};

use aplomb::board::burst_reader::ReceivedBurst;
#[cfg(feature = "full")]
use aplomb::board::measure;
use aplomb::calibration::{ImuReading, StationaryDetector, StationaryProgress};
use aplomb::health::Flags;
use aplomb::mpu6050::{Burst, Part, RawSample};
use aplomb::telemetry::log::NumberedBurst;
use heapless::spsc::Producer;

#[cfg(feature = "full")]
use crate::requests::FIGURES;
use crate::requests::{AFTER_PUBLICATION, LOG, STATIONARY};

/// Number of bursts that the pipeline has processed. Changes under the pipeline's lock.
pub static BURST_COUNT: AtomicU32 = AtomicU32::new(0);

/// Counts a burst that the pipeline has processed, and passes it on to those that need it. `flags`
/// are the published ones.
#[inline(always)]
pub fn after_publication(
    received: &ReceivedBurst,
    flags: Flags,
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
        pass_on(number, received, flags, part, measurement, to_log);
    }
}

/// Passes a burst on. A burst without room in the log's queue is missing in the log, where the
/// numbers show it.
#[inline(never)]
fn pass_on(
    number: u32,
    received: &ReceivedBurst,
    flags: Flags,
    part: &Part,
    measurement: &mut StationaryMeasurement,
    to_log: &mut Producer<'static, NumberedBurst>,
) {
    // A frozen sensor would be a perfect rest.
    if AFTER_PUBLICATION.contains(STATIONARY) && !flags.intersects(Flags::FROZEN | Flags::REJECTED)
    {
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
