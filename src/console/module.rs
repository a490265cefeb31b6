//! Port of the console to the rest of the module.

use core::fmt::{self, Write};

use crate::attitude::Vector3;
use crate::calibration::compass::CompassFitter;
use crate::calibration::{Calibration, Mount, StationaryProgress};
use crate::compass::CompassStatus;
use crate::health::{Flags, WorkFigures};
use crate::mpu6050::Part;
use crate::settings::CompassSettings;
use crate::telemetry::heading::Line as HeadingLine;

/// Services that the console needs from the module it commands.
pub trait Module {
    /// Returns the next received byte.
    fn receive(&mut self) -> Option<u8>;

    /// Returns whether received bytes were garbled or lost since the last call.
    fn take_reception_error(&mut self) -> bool;

    /// Returns the module's state.
    fn state(&mut self) -> State;

    /// Uses this calibration from the next sample on.
    fn set_calibration(&mut self, calibration: &Calibration);

    /// Uses these settings of the compass from now on. `imu_mount` is the mount in use of the IMU.
    fn set_compass(&mut self, settings: &CompassSettings, imu_mount: Mount);

    /// Collects readings of the compass from now on, for a fit.
    fn start_compass_fitter(&mut self);

    /// Stops collecting readings of the compass.
    fn stop_compass_fitter(&mut self);

    /// Returns the readings of the compass so far; `None` if none are collected.
    fn compass_fitter(&mut self) -> Option<CompassFitter>;

    /// Starts the stationary detector, for an average of this many samples.
    fn start_detector(&mut self, samples: u16);

    /// Stops the stationary detector.
    fn stop_detector(&mut self);

    /// Returns the detector's latest event since the last call: motion, or a completed average.
    fn take_detector_progress(&mut self) -> Option<StationaryProgress>;

    /// Returns the share of the average that is collected, 0 to 100.
    fn detector_percent(&mut self) -> u8;

    /// Arms or disarms. While armed, the module does nothing that is only safe on the ground.
    fn set_armed(&mut self, is_armed: bool);

    /// Starts a measurement of the module's own work without figures, or ends it.
    fn set_measuring(&mut self, is_on: bool);

    /// Returns the figures of the last measurement.
    fn work_figures(&mut self) -> WorkFigures;

    /// Sends and receives at this baud rate, and discards what was received before. Returns false,
    /// and changes nothing, while bytes are still being sent.
    fn set_baud(&mut self, baud: u32) -> bool;

    /// Starts a job. The console starts one at a time, and polls
    /// [`take_outcome`](Self::take_outcome) for its end.
    fn begin(&mut self, job: Job);

    /// Returns the result of the job once it has ended.
    fn take_outcome(&mut self) -> Option<Outcome>;
}

/// Job for which the sensor stops for a moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Job {
    /// Stores the record in use, which stays the same meanwhile.
    Save,
    /// Runs the self-tests of the sensor and of the compass.
    SelfTest,
    /// Reads the sensor's settings back.
    ReadBack,
}

/// Result of a [`Job`].
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// True if the job succeeded.
    pub is_ok: bool,
    /// Result or reason, for people.
    pub text: heapless::String<{ Outcome::CAPACITY }>,
}

impl Outcome {
    /// Largest length of the text, in bytes.
    pub const CAPACITY: usize = 240;

    /// Creates an outcome. Text beyond [`CAPACITY`](Self::CAPACITY) is left out.
    #[inline(never)]
    pub fn new(is_ok: bool, reason: &dyn fmt::Display) -> Self {
        let mut text = heapless::String::new();
        write!(text, "{reason}").ok();
        Self { is_ok, text }
    }
}

/// State of the module, as the command `status` prints it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// Flags of the latest attitude; none if there was no attitude yet.
    pub flags: Flags,
    /// Sensor and its bus address, once it is configured.
    pub sensor: Option<(&'static Part, u8)>,
    /// Compass.
    pub compass: CompassStatus,
    /// Heading at the latest attitude; `None` while it is unknown.
    pub heading: Option<HeadingLine>,
    /// Die temperature, °C.
    pub temperature_celsius: f32,
    /// Gyroscope offset that the filter estimates, rad/s in body axes.
    pub bias_rad_s: Vector3,
    /// σ of that offset, of the worst axis, rad/s.
    pub bias_sigma_rad_s: f32,
    /// Offset of the accelerometer that the filter has found, m/s² in body axes, beyond the
    /// calibration's; `None` until it is certain.
    pub accelerometer_offset_m_s2: Option<Vector3>,
    /// σ of the tilt, rad.
    pub tilt_sigma_rad: f32,
    /// Bursts that failed since start.
    pub bursts_failed: u16,
    /// Times that samples were lost, since power-up; at most 65,535.
    pub times_missed: u16,
    /// Times that samples began to be no measurements, frozen or rejected, since power-up; at most
    /// 65,535.
    pub times_refused: u16,
    /// Times that the receiver reported errors or lost bytes, since power-up: a reset keeps the
    /// count.
    pub reception_errors: u32,
    /// Snapshots that could not be sent in time, since power-up.
    pub frames_dropped: u32,
}
