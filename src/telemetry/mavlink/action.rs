//! Requests of a ground station to the module, and their results.

use crate::calibration::Mount;
use crate::settings::OutputFormat;

/// Request to the module.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Action {
    /// Starts or cancels a calibration.
    Calibrate(Calibrate),
    /// Sets the telemetry rate, attitudes per second.
    SetRate(u16),
    /// Sets the UART's baud rate.
    SetBaud(u32),
    /// Sets the telemetry format.
    SetFormat(OutputFormat),
    /// Sets the mount.
    SetMount(Mount),
    /// Stores the working record.
    Save,
    /// Arms or disarms.
    SetArmed(bool),
}

/// Calibration that MAV_CMD_PREFLIGHT_CALIBRATION can request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Calibrate {
    /// Parameter 1 is 1: measures the gyroscope's offset.
    Gyroscope,
    /// Parameter 2 is 1: calibrates the compass.
    Compass,
    /// Parameter 5 is 1: calibrates the accelerometer, pose by pose.
    Accelerometer,
    /// Parameter 5 is 2: measures the level trim.
    Level,
    /// All parameters are zero: cancels the running calibration.
    Cancel,
}

/// Result of an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Outcome {
    /// The action is done.
    Accepted,
    /// The action has begun; another answer follows.
    InProgress,
    /// The module is armed or busy: the station may repeat the request later.
    NotNow,
    /// The parameters are not valid.
    Denied,
    /// The action has failed.
    Failed,
    /// The action was cancelled before its end.
    Cancelled,
    /// The module does not support the action.
    Unsupported,
}

impl Outcome {
    /// Returns the MAV_RESULT.
    pub(super) const fn code(self) -> u8 {
        match self {
            Self::Accepted => 0,
            Self::NotNow => 1,
            Self::Denied => 2,
            Self::Unsupported => 3,
            Self::Failed => 4,
            Self::InProgress => 5,
            Self::Cancelled => 6,
        }
    }
}

/// Request that is answered once its action has run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Request {
    /// Command of this number.
    Command(u16),
    /// Change of the parameter of this index.
    Parameter(u16),
}

/// Sender of a request, and what was requested. The owner returns it with the answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ticket {
    pub(super) request: Request,
    pub(super) system: u8,
    pub(super) component: u8,
}
