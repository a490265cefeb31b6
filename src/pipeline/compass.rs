//! A pipeline with a compass: the attitude as without one, and a heading beside it.

use super::{Pipeline, Settings, Snapshot};
use crate::estimator::Sample;
use crate::estimator::heading::{CompassKnowledge, Heading, HeadingEstimate};
use crate::health::{BoardFlags, Flags};
use crate::mpu6050::Burst;
use crate::serialize::StateVisitor;
use crate::units::{MagneticField, SECONDS_PER_MICROSECOND};

/// [`Pipeline`] with a compass.
///
/// Attitude, rates and σ of the tilt are those of the pipeline, to the bit. The snapshot's flags
/// have [`Flags::HEADING_VALID`] in addition. A pipeline without a compass pays nothing.
///
/// ```
/// use aplomb::attitude::BodyVector;
/// use aplomb::estimator::Sample;
/// use aplomb::estimator::heading::CompassKnowledge;
/// use aplomb::mpu6050::Part;
/// use aplomb::pipeline::{CompassPipeline, Settings};
/// use aplomb::units::MagneticField;
///
/// let settings = Settings::new(&Part::MPU_6050);
/// let mut pipeline = CompassPipeline::new(&settings, CompassKnowledge::Calibrated);
/// for index in 1..4_000_u64 {
///     let force = BodyVector::new(0.0, 0.0, -9.81);
///     pipeline.update_sample(&Sample::new(1_000 * index, force, BodyVector::ZERO));
///     if index % 10 == 0 {
///         // Level, nose to the west: north is to the right.
///         pipeline.update_field(MagneticField { ut: [0.0, 20.0, 45.0] }, 5_000);
///     }
/// }
/// let heading = pipeline.heading().expect("a heading");
/// assert!((heading.yaw_offset_rad.to_degrees() + 90.0).abs() < 1.0);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CompassPipeline {
    pipeline: Pipeline,
    heading: Heading,
}

impl CompassPipeline {
    /// Creates a pipeline without a burst.
    pub fn new(settings: &Settings, knowledge: CompassKnowledge) -> Self {
        Self::with_pipeline(Pipeline::new(settings), knowledge)
    }

    /// Adds a compass to a pipeline.
    pub fn with_pipeline(pipeline: Pipeline, knowledge: CompassKnowledge) -> Self {
        Self {
            pipeline,
            heading: Heading::new(knowledge),
        }
    }

    /// Processes one burst like [`Pipeline::update`].
    pub fn update(&mut self, burst: &Burst, board: BoardFlags) -> Snapshot {
        let before_us = self.pipeline.estimator.last_t_us();
        let snapshot = self.pipeline.update(burst, board);
        self.follow(before_us, snapshot)
    }

    /// Processes one calibrated sample like [`Pipeline::update_sample`].
    pub fn update_sample(&mut self, sample: &Sample) -> Snapshot {
        let before_us = self.pipeline.estimator.last_t_us();
        let snapshot = self.pipeline.update_sample(sample);
        self.follow(before_us, snapshot)
    }

    /// Adds a reading of the compass: calibrated, in body axes. `age_us` is how much older its
    /// motion is than that of the last sample. Call it after the update of that sample.
    pub fn update_field(&mut self, field: MagneticField, age_us: u32) {
        self.heading.add_field(field, age_us);
    }

    /// Returns the heading; `None` while it is unknown.
    pub const fn heading(&self) -> Option<HeadingEstimate> {
        self.heading.estimate()
    }

    /// Returns the pipeline without the compass.
    pub const fn pipeline(&self) -> &Pipeline {
        &self.pipeline
    }

    /// Returns the pipeline without the compass, to change its settings.
    pub const fn pipeline_mut(&mut self) -> &mut Pipeline {
        &mut self.pipeline
    }

    /// Returns the heading filter.
    pub const fn heading_filter(&self) -> &Heading {
        &self.heading
    }

    /// Returns the heading filter, to change its settings.
    pub const fn heading_filter_mut(&mut self) -> &mut Heading {
        &mut self.heading
    }

    /// Visits the settings and every field that later headings depend on.
    pub fn visit_state(&mut self, visitor: &mut impl StateVisitor) {
        self.pipeline.visit_state(visitor);
        self.heading.visit_state(visitor);
    }

    /// Lets the heading filter follow the sample, and sets its flag.
    fn follow(&mut self, before_us: Option<u64>, mut snapshot: Snapshot) -> Snapshot {
        let now_us = self.pipeline.estimator.last_t_us();
        if let (Some(before_us), Some(now_us)) = (before_us, now_us)
            && now_us > before_us
        {
            let step_us = u32::try_from(now_us - before_us).unwrap_or(u32::MAX);
            let dt_s = step_us as f32 * SECONDS_PER_MICROSECOND;
            self.heading.follow(self.pipeline.kalman(), dt_s);
        }
        let is_valid = self.heading().is_some_and(|heading| heading.is_valid);
        let has_tilt = snapshot.flags.contains(Flags::VALID);
        snapshot
            .flags
            .set(Flags::HEADING_VALID, is_valid && has_tilt);
        snapshot
    }
}
