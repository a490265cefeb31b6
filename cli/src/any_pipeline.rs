//! The library's pipelines behind one interface: a recording is replayed with the filter of choice.

use std::fmt;
use std::str::FromStr;

use aplomb::attitude::Vector3;
use aplomb::calibration::AccelerometerCorrection;
use aplomb::estimator::Sample;
use aplomb::estimator::classic::{AxisKalman, Tutorial};
use aplomb::estimator::heading::{CompassKnowledge, Heading, HeadingEstimate};
use aplomb::estimator::kalman::AccelerometerKnowledge;
use aplomb::health::{BoardFlags, Flags};
use aplomb::mpu6050::{Burst, RawSample};
use aplomb::pipeline::classic::{ClassicPipeline, Zero};
use aplomb::pipeline::{CompassPipeline, CompassReading, Pipeline, Settings, Snapshot};
use aplomb::units::MagneticField;
use aplomb_recordings::attitude::extrapolate;

/// Samples at rest that the tutorial's pipelines average at first, as the tutorial does.
pub const AVERAGED_SAMPLES: u16 = 1_000;

/// A filter of the library.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FilterName {
    /// The Kalman filter that flies.
    #[default]
    Kalman,
    /// The tutorial's two Kalman filters with exact kinematics.
    AxisKalman,
    /// The tutorial's formulas.
    Classic,
}

impl FilterName {
    /// Every filter, the default first.
    pub const ALL: [Self; 3] = [Self::Kalman, Self::AxisKalman, Self::Classic];

    /// Returns the name, as `--filter` takes it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Kalman => "kalman",
            Self::AxisKalman => "axis-kalman",
            Self::Classic => "classic",
        }
    }
}

impl fmt::Display for FilterName {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl FromStr for FilterName {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        let found = Self::ALL.into_iter().find(|filter| filter.name() == name);
        found.ok_or_else(|| format!("choose one of {}", Self::ALL.map(Self::name).join(", ")))
    }
}

/// A pipeline with the filter of choice, and the last specific force.
pub struct AnyPipeline {
    pipeline: Variant,
    settings: Settings,
    specific_force_m_s2: Vector3,
    /// Extrapolation of the tutorial's attitudes, s: their filters know no delay.
    delay_s: f32,
}

#[allow(
    clippy::large_enum_variant,
    reason = "there is one, and it is used for a whole recording"
)]
enum Variant {
    Kalman(Pipeline),
    WithCompass(CompassPipeline),
    AxisKalman(ClassicPipeline<AxisKalman>),
    Classic(ClassicPipeline<Tutorial>),
}

impl AnyPipeline {
    /// Creates a pipeline for bursts. The tutorial's filters first average offsets at rest.
    pub fn for_bursts(filter: FilterName, settings: &Settings) -> Self {
        Self::new(filter, settings, AVERAGED_SAMPLES, 0.0)
    }

    /// Creates a pipeline for samples in SI units that are `delay_us` late. Nothing is averaged.
    pub fn for_samples(filter: FilterName, settings: &Settings, delay_us: u32) -> Self {
        Self::new(filter, settings, 0, delay_us as f32 * 1e-6)
    }

    fn new(filter: FilterName, settings: &Settings, averaged: u16, delay_s: f32) -> Self {
        let pipeline = match filter {
            FilterName::Kalman => Variant::Kalman(Pipeline::new(settings)),
            FilterName::AxisKalman => Variant::AxisKalman(ClassicPipeline::new(
                settings,
                AxisKalman::new(),
                averaged,
                Zero::Gyroscope,
            )),
            FilterName::Classic => Variant::Classic(ClassicPipeline::new(
                settings,
                Tutorial::new(),
                averaged,
                Zero::BothSensors,
            )),
        };
        Self {
            pipeline,
            settings: *settings,
            specific_force_m_s2: Vector3::ZERO,
            delay_s,
        }
    }

    /// Takes a burst with the conditions of the board, and returns the attitude at its time.
    pub fn update(&mut self, burst: &Burst, board: BoardFlags) -> Snapshot {
        let mut snapshot = match &mut self.pipeline {
            Variant::Kalman(pipeline) => {
                let snapshot = pipeline.update(burst, board);
                self.specific_force_m_s2 = pipeline.sample().specific_force_m_s2;
                return snapshot;
            }
            Variant::WithCompass(pipeline) => {
                let snapshot = pipeline.update(burst, board);
                self.specific_force_m_s2 = pipeline.pipeline().sample().specific_force_m_s2;
                return snapshot;
            }
            Variant::AxisKalman(pipeline) => pipeline.update(burst),
            Variant::Classic(pipeline) => pipeline.update(burst),
        };
        self.specific_force_m_s2 = self.mounted_force_m_s2(burst);
        snapshot.flags |= Flags::from(board);
        if snapshot.flags.intersects(Flags::DEGRADING) {
            snapshot.flags |= Flags::DEGRADED;
        }
        snapshot
    }

    /// Sets what is known of the accelerometer's offset. Only the Kalman filter uses it.
    pub fn set_accelerometer_knowledge(&mut self, knowledge: AccelerometerKnowledge) {
        if let Some(pipeline) = self.kalman_mut() {
            pipeline.set_accelerometer_knowledge(knowledge);
        }
    }

    /// Arms (`true`) or disarms the filter. Only the Kalman filter uses it.
    pub const fn set_armed(&mut self, is_armed: bool) {
        if let Some(pipeline) = self.kalman_mut() {
            pipeline.set_armed(is_armed);
        }
    }

    /// Adds a compass of which this is known. Only the Kalman filter uses it.
    pub fn add_compass(&mut self, knowledge: CompassKnowledge, declination_rad: f32) {
        if let Variant::Kalman(pipeline) = self.pipeline {
            let mut pipeline = CompassPipeline::with_pipeline(pipeline, knowledge);
            let heading = pipeline.heading_filter_mut();
            heading.set_declination(declination_rad);
            self.pipeline = Variant::WithCompass(pipeline);
        }
    }

    /// Takes a reading of the compass in body axes, `age_us` older than the last sample.
    pub fn update_field(&mut self, field: MagneticField, age_us: u32) {
        if let Variant::WithCompass(pipeline) = &mut self.pipeline {
            pipeline.update_field(field, age_us);
        }
    }

    /// Takes a logged reading, as the module's heading filter took it after the last sample. Only
    /// the Kalman filter uses it.
    pub fn take_reading(&mut self, reading: &CompassReading) {
        let (pipeline, is_new) = match &self.pipeline {
            Variant::Kalman(pipeline) => (pipeline, true),
            Variant::WithCompass(pipeline) => (pipeline.pipeline(), reading.starts_filter),
            Variant::AxisKalman(_) | Variant::Classic(_) => return,
        };
        let age_us = pipeline.reading_age_us(reading.measured_us);
        if is_new {
            let mut heading = Heading::new(reading.knowledge);
            heading.set_declination(reading.declination_rad);
            self.restore_heading(Some(heading));
        } else if let Variant::WithCompass(pipeline) = &mut self.pipeline {
            let heading = pipeline.heading_filter_mut();
            if heading.declination_rad() != reading.declination_rad {
                heading.set_declination(reading.declination_rad);
            }
        }
        self.update_field(reading.field, age_us);
    }

    /// Replaces the heading filter. Without one there is no compass until the next reading.
    pub fn restore_heading(&mut self, heading: Option<Heading>) {
        let pipeline = match &self.pipeline {
            Variant::Kalman(pipeline) => *pipeline,
            Variant::WithCompass(pipeline) => *pipeline.pipeline(),
            Variant::AxisKalman(_) | Variant::Classic(_) => return,
        };
        self.pipeline = match heading {
            None => Variant::Kalman(pipeline),
            Some(heading) => {
                let knowledge = CompassKnowledge::Factory;
                let mut pipeline = CompassPipeline::with_pipeline(pipeline, knowledge);
                *pipeline.heading_filter_mut() = heading;
                Variant::WithCompass(pipeline)
            }
        };
    }

    /// Returns the heading, if a compass shows it.
    pub const fn heading(&self) -> Option<HeadingEstimate> {
        match &self.pipeline {
            Variant::WithCompass(pipeline) => pipeline.heading(),
            Variant::Kalman(_) | Variant::AxisKalman(_) | Variant::Classic(_) => None,
        }
    }

    /// Takes a sample in SI units, and returns the attitude at its time.
    pub fn update_sample(&mut self, sample: &Sample) -> Snapshot {
        self.specific_force_m_s2 = sample.specific_force_m_s2;
        let mut snapshot = match &mut self.pipeline {
            Variant::Kalman(pipeline) => return pipeline.update_sample(sample),
            Variant::WithCompass(pipeline) => return pipeline.update_sample(sample),
            Variant::AxisKalman(pipeline) => pipeline.update_sample(sample),
            Variant::Classic(pipeline) => pipeline.update_sample(sample),
        };
        if self.delay_s > 0.0 {
            let (attitude, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
            snapshot.attitude = extrapolate(attitude, rates, self.delay_s);
        }
        snapshot
    }

    /// Replaces the calibration from the next burst on. The tutorial's pipelines start again.
    pub fn set_calibration(&mut self, settings: &Settings) {
        self.settings.calibration = settings.calibration;
        match &mut self.pipeline {
            Variant::Kalman(pipeline) => {
                pipeline.set_calibration(&settings.calibration);
            }
            Variant::WithCompass(pipeline) => pipeline.set_calibration(&settings.calibration),
            Variant::AxisKalman(_) => *self = Self::for_bursts(FilterName::AxisKalman, settings),
            Variant::Classic(_) => *self = Self::for_bursts(FilterName::Classic, settings),
        }
    }

    /// Returns the pipeline that flies, if it is the one.
    pub const fn kalman_mut(&mut self) -> Option<&mut Pipeline> {
        match &mut self.pipeline {
            Variant::Kalman(pipeline) => Some(pipeline),
            Variant::WithCompass(pipeline) => Some(pipeline.pipeline_mut()),
            Variant::AxisKalman(_) | Variant::Classic(_) => None,
        }
    }

    /// Returns the σ of a snapshot's tilt, if the filter knows it. Before the first gravity it
    /// does not.
    pub fn tilt_sigma_rad(&self, snapshot: &Snapshot) -> Option<f32> {
        let sigma_rad = snapshot.tilt_sigma_rad();
        sigma_rad.is_finite().then_some(sigma_rad)
    }

    /// Returns the settings.
    pub const fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the specific force of the last sample, m/s² in body axes.
    pub const fn specific_force_m_s2(&self) -> Vector3 {
        self.specific_force_m_s2
    }

    /// Returns the specific force of a burst, m/s²: corrected, mounted and levelled.
    fn mounted_force_m_s2(&self, burst: &Burst) -> Vector3 {
        let calibration = &self.settings.calibration;
        let correction = calibration
            .accelerometer
            .unwrap_or(AccelerometerCorrection::NONE);
        let range = self.settings.sensor.accelerometer_range;
        let force = RawSample::decode(&burst.bytes).accelerometer.to_m_s2(range);
        let mounted = self.settings.mount().to_body(correction.apply(force)).0;
        calibration
            .level
            .map_or(mounted, |level| level.rotate(mounted))
    }
}

#[cfg(test)]
mod tests {
    use aplomb::attitude::BodyVector;
    use aplomb::mpu6050::Part;

    use super::*;

    #[test]
    fn names_choose_what_can_be_replayed() {
        for filter in FilterName::ALL {
            assert_eq!(filter.name().parse(), Ok(filter));
        }
        let refused = "vqf".parse::<FilterName>();
        assert!(refused.is_err_and(|error| error.contains("kalman, axis-kalman, classic")));
    }

    /// `declination` restarts no filter of the module, so later readings have another one.
    #[test]
    fn a_declination_that_changes_in_a_log_turns_the_heading() {
        let settings = Settings::new(&Part::MPU_6050);
        let mut pipeline = AnyPipeline::for_samples(FilterName::Kalman, &settings, 0);
        let mut heading_deg = |t_us: u64, degrees: f32| {
            let force = BodyVector::new(0.0, 0.0, -9.81);
            pipeline.update_sample(&Sample::new(t_us, force, BodyVector::ZERO));
            pipeline.take_reading(&CompassReading {
                number: 0,
                sample_t_us: t_us,
                measured_us: t_us as u32 - 10_000,
                field: MagneticField {
                    ut: [20.0, 0.0, 44.0],
                },
                knowledge: CompassKnowledge::Calibrated,
                declination_rad: degrees.to_radians(),
                starts_filter: t_us == 20_000,
            });
            let heading = pipeline.heading();
            heading.map_or(f32::NAN, |heading| heading.yaw_offset_rad.to_degrees())
        };
        let mut before_deg = f32::NAN;
        for index in 1..300 {
            before_deg = heading_deg(20_000 * index, 0.0);
        }
        let after_deg = heading_deg(6_000_000, 3.5);
        assert!(
            (after_deg - before_deg - 3.5).abs() < 1.0e-3,
            "{before_deg} {after_deg}"
        );
    }
}
