//! State of the estimation, which the tasks share under one lock, and its result as telemetry sends
//! it.

use aplomb::board::compass::CompassReader;
use aplomb::board::{attitude_task, heading};
use aplomb::compass;
use aplomb::estimator::heading::HeadingEstimate;
use aplomb::pipeline::{Pipeline, Snapshot};

use crate::after_publication::StationaryMeasurement;

/// Data of the attitude task: the pipeline, the stationary detector of a calibration procedure, and
/// the compass.
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
    pub compass: CompassReader,
}

/// Latest attitude with its heading, as telemetry sends them.
pub struct Latest {
    /// Attitude. Its flags include that of the heading.
    pub snapshot: Snapshot,
    /// Heading; `None` while it is unknown.
    pub heading: Option<HeadingEstimate>,
}

impl Latest {
    /// Returns the latest attitude with its heading, and its number.
    #[inline(never)]
    pub fn read() -> Option<(Self, u32)> {
        let (mut snapshot, number) = attitude_task::latest()?;
        let mut heading = None;
        if compass::IS_BUILT_IN {
            heading = heading::latest();
            snapshot.set_heading_valid(heading);
        }
        Some((Self { snapshot, heading }, number))
    }
}
