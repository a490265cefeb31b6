//! A pipeline with a compass: the attitude as without one, and a heading beside it.
//!
//! [`CompassPipeline`] does both in one call. Firmware publishes the attitude first: it calls
//! [`Pipeline::update`], publishes, and updates the heading with [`Pipeline::update_heading`].

use super::{Pipeline, Settings, Snapshot};
use crate::calibration::{Calibration, CompassAlignment};
use crate::estimator::Sample;
use crate::estimator::heading::{CompassKnowledge, Heading, HeadingEstimate, VALID_TILT_RAD};
use crate::health::{BoardFlags, Flags};
use crate::mpu6050::Burst;
use crate::serialize::StateVisitor;
use crate::units::MagneticField;

/// [`Pipeline`] with a compass.
///
/// Attitude, rates and σ of the tilt are those of the pipeline, to the bit. The snapshot's flags
/// have [`Flags::HEADING_VALID`] in addition. Before the first reading it costs nothing more.
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

/// Returns the knowledge of a compass with this alignment. A correction without soft iron is the
/// hard iron of an earlier run.
///
/// ```
/// use aplomb::calibration::{CompassAlignment, CompassCorrection, Mount};
/// use aplomb::estimator::heading::CompassKnowledge;
/// use aplomb::pipeline::compass_knowledge;
///
/// let correction = Some(CompassCorrection::NONE);
/// let alignment = CompassAlignment { mount: Mount::Z_UP, correction };
/// assert_eq!(compass_knowledge(&alignment), CompassKnowledge::HardIron);
/// ```
pub fn compass_knowledge(alignment: &CompassAlignment) -> CompassKnowledge {
    match alignment.correction {
        None => CompassKnowledge::Factory,
        Some(correction) if correction.has_soft_iron() => CompassKnowledge::Calibrated,
        Some(_) => CompassKnowledge::HardIron,
    }
}

/// Reading of a compass, with all that a heading filter needs of it. A flight log keeps it.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CompassReading {
    /// Number of readings that the module has taken before this one, since its start.
    pub number: u32,
    /// Time of the sample after which the heading filter took the reading, µs since start.
    pub sample_t_us: u64,
    /// Time of the middle of the measurement, µs since start: the low 32 bits.
    pub measured_us: u32,
    /// Field in body axes, corrected.
    pub field: MagneticField,
    /// Knowledge of the compass with which the filter has started.
    pub knowledge: CompassKnowledge,
    /// Declination of the place, rad, east positive.
    pub declination_rad: f32,
    /// True if the filter starts with this reading.
    pub starts_filter: bool,
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
        let snapshot = self.pipeline.update(burst, board);
        self.update_heading(snapshot)
    }

    /// Processes one calibrated sample in body axes like [`Pipeline::update_sample`].
    pub fn update_sample(&mut self, sample: &Sample) -> Snapshot {
        self.update_sample_with(sample, BoardFlags::empty())
    }

    /// Processes one sample like [`Pipeline::update_sample_with`].
    pub fn update_sample_with(&mut self, sample: &Sample, board: BoardFlags) -> Snapshot {
        let snapshot = self.pipeline.update_sample_with(sample, board);
        self.update_heading(snapshot)
    }

    /// Adds a reading of the compass in body axes, corrected as the [`CompassKnowledge`] states.
    /// `age_us` is how much older its motion is than that of the last sample. Call it after the
    /// update of that sample.
    pub fn update_field(&mut self, field: MagneticField, age_us: u32) {
        self.heading.add_field(field, age_us);
    }

    /// Replaces the calibration of the sensor like [`Pipeline::set_calibration`]. If that
    /// restarts the filter, the heading starts again too.
    pub fn set_calibration(&mut self, calibration: &Calibration) {
        if self.pipeline.set_calibration(calibration) {
            self.heading.reset();
        }
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

    /// Updates the heading filter with the last sample, and sets its flag.
    fn update_heading(&mut self, mut snapshot: Snapshot) -> Snapshot {
        self.pipeline.update_heading(&mut self.heading);
        snapshot.set_heading_valid(self.heading());
        snapshot
    }
}

impl Pipeline {
    /// Updates a heading filter with the last sample. Call it after each [`update`](Self::update).
    #[inline]
    pub fn update_heading(&self, heading: &mut Heading) {
        if let Some(t_us) = self.estimator.last_t_us() {
            heading.update_to(self.kalman(), t_us);
        }
    }

    /// Returns the age of a compass's reading for [`Heading::add_field`], µs: how much older its
    /// motion is than that of the last sample.
    ///
    /// `measured_us` is the time of the middle of the measurement, on the clock of the samples; its
    /// low 32 bits are enough. A sample's motion is older than its time by the sensor's delay:
    ///
    /// ```text
    /// age = (time of the sample − delay of the sensor) − time of the measurement
    /// ```
    pub fn reading_age_us(&self, measured_us: u32) -> u32 {
        let sample_us = self.estimator.last_t_us().unwrap_or(0) as u32;
        let motion_us = sample_us.wrapping_sub(self.settings.delay_us());
        let age_us = motion_us.wrapping_sub(measured_us) as i32;
        age_us.max(0).unsigned_abs()
    }
}

impl Snapshot {
    /// Sets [`Flags::HEADING_VALID`] if the heading is valid, and the tilt is valid with a σ below
    /// 4°. Clears it otherwise.
    pub fn set_heading_valid(&mut self, heading: Option<HeadingEstimate>) {
        let is_valid = heading.is_some_and(|heading| heading.is_valid);
        let has_tilt = self.flags.contains(Flags::VALID)
            && self.tilt_variance_rad2 < VALID_TILT_RAD * VALID_TILT_RAD;
        self.flags.set(Flags::HEADING_VALID, is_valid && has_tilt);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::attitude::BodyVector;
    use crate::calibration::{AccelerometerCorrection, Mount};
    use crate::mpu6050::Part;

    #[test]
    fn the_age_is_that_of_the_motion_also_where_the_count_wraps() {
        let mut pipeline = Pipeline::new(&Settings::new(&Part::MPU_6050));
        for sample_us in [20_000, (1 << 32) + 500] {
            let force = BodyVector::new(0.0, 0.0, -9.81);
            pipeline.update_sample(&Sample::new(sample_us, force, BodyVector::ZERO));
            let measured_us = (sample_us as u32).wrapping_sub(10_300);
            // The low-pass filter delays the sample's motion by 1.9 ms.
            assert_eq!(pipeline.reading_age_us(measured_us), 8_400);
            // A reading of a later motion counts as one of the same motion.
            assert_eq!(pipeline.reading_age_us(sample_us as u32), 0);
        }
    }

    #[test]
    fn other_body_axes_and_accelerometers_restart_the_heading() {
        let settings = Settings::new(&Part::MPU_6050);
        let mut pipeline = CompassPipeline::new(&settings, CompassKnowledge::Calibrated);
        for index in 1..2_000_u64 {
            let force = BodyVector::new(0.0, 0.0, -9.81);
            pipeline.update_sample(&Sample::new(1_000 * index, force, BodyVector::ZERO));
            if index % 20 == 7 {
                let ut = [20.0, 0.0, 44.0];
                pipeline.update_field(MagneticField { ut }, 8_100);
            }
        }
        let before = pipeline.heading().expect("a heading");
        let mut calibration = Calibration {
            accelerometer: Some(AccelerometerCorrection::NONE),
            ..Calibration::NONE
        };
        pipeline.set_calibration(&calibration);
        assert_eq!(pipeline.heading(), Some(before));
        // The tilt filter starts its parameters anew, so the field is found anew too.
        let force = BodyVector::new(0.0, 0.0, -9.81);
        pipeline.update_sample(&Sample::new(2_000_000, force, BodyVector::ZERO));
        assert_eq!(pipeline.heading(), None);
        calibration.mount = Some(Mount::Z_DOWN);
        let changes = pipeline.heading_filter().changes();
        pipeline.set_calibration(&calibration);
        assert_eq!(pipeline.heading(), None);
        assert_ne!(pipeline.heading_filter().changes(), changes);
    }

    #[test]
    fn firmware_that_publishes_first_has_the_heading_of_the_compass_pipeline() {
        let settings = Settings::new(&Part::MPU_6050);
        let mut whole = CompassPipeline::new(&settings, CompassKnowledge::Calibrated);
        let mut pipeline = Pipeline::new(&settings);
        let mut heading = Heading::new(CompassKnowledge::Calibrated);
        for index in 1..12_000_u64 {
            // After two seconds at rest it turns to and fro.
            let phase = 2.0e-3 * index.saturating_sub(2_000) as f32;
            let turn_rad = 1.0 - libm::cosf(phase);
            let rate_rad_s = 2.0 * libm::sinf(phase);
            let force = BodyVector::new(0.0, 0.0, -9.81);
            let rate = BodyVector::new(0.0, 0.0, rate_rad_s);
            let sample = Sample::new(1_000 * index, force, rate);
            let expected = whole.update_sample(&sample);
            let mut snapshot = pipeline.update_sample(&sample);
            pipeline.update_heading(&mut heading);
            snapshot.set_heading_valid(heading.estimate());
            assert_eq!(snapshot, expected, "{index}");
            if index % 20 == 7 {
                let field = MagneticField {
                    ut: [
                        20.0 * libm::cosf(turn_rad),
                        -20.0 * libm::sinf(turn_rad),
                        44.0,
                    ],
                };
                whole.update_field(field, 8_100);
                heading.add_field(field, 8_100);
            }
        }
        assert_eq!(heading, *whole.heading_filter());
        let mut snapshot = pipeline.stale(13_000_000, BoardFlags::empty());
        let known = heading.estimate();
        assert!(known.is_some_and(|it| it.is_valid), "{known:?}");
        snapshot.set_heading_valid(heading.estimate());
        assert!(!snapshot.flags.contains(Flags::HEADING_VALID));
    }

    /// The heading's promise needs a tilt that is within 4° by its σ.
    #[test]
    fn a_heading_is_valid_with_a_certain_tilt_alone() {
        let heading = HeadingEstimate {
            yaw_offset_rad: 0.0,
            sigma_rad: 0.01,
            is_valid: true,
        };
        for (flags, sigma_deg, is_valid) in [
            (Flags::VALID, 3.9_f32, true),
            (Flags::VALID, 4.1, false),
            (Flags::empty(), 3.9, false),
        ] {
            let sigma_rad = sigma_deg.to_radians();
            let mut snapshot = Snapshot {
                flags: flags | Flags::HEADING_VALID,
                tilt_variance_rad2: sigma_rad * sigma_rad,
                ..Snapshot::default()
            };
            snapshot.set_heading_valid(Some(heading));
            let found = snapshot.flags.contains(Flags::HEADING_VALID);
            assert_eq!(found, is_valid, "{flags}, {sigma_deg}");
        }
    }
}
