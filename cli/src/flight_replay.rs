//! Replay of a flight: the logged bursts through the pipeline, compared with the logged attitudes.

use aplomb::attitude::Quaternion;
use aplomb::estimator::REVISION;
use aplomb::estimator::heading::HeadingEstimate;
use aplomb::pipeline::{CompassReading, Settings, Snapshot};
use aplomb::serialize::StateReader;
use aplomb::telemetry::log::{Configuration, HeadingState, NumberedBurst, TimedHeading};
use aplomb_recordings::flight_log::{Flight, FlightLog, Step, Steps};

use crate::any_pipeline::{AnyPipeline, FilterName};

/// Agreement of a replay with its flight.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
pub struct Agreement {
    /// Replayed bursts.
    pub bursts: u64,
    /// Bursts whose attitudes are the flight's to the bit: a state and every burst since are known.
    pub exact: u64,
    /// Logged attitudes that were compared with an exact one.
    pub compared: u64,
    /// Compared attitudes that differ.
    pub different: u64,
    /// Time of the first difference, µs.
    pub first_difference_us: Option<u64>,
    /// Bursts whose headings are the flight's to the bit.
    pub heading_exact: u64,
    /// Logged headings that were compared with an exact one.
    pub heading_compared: u64,
    /// Compared headings that differ.
    pub heading_different: u64,
    /// Revision of the filters that flew, if it is not [`REVISION`]: then nothing is exact.
    pub other_revision: Option<u16>,
}

/// Replay of a flight, burst by burst.
pub struct Replay {
    steps: Steps,
    pipeline: AnyPipeline,
    settings: Settings,
    /// Number of the last burst.
    last: Option<u32>,
    is_exact: bool,
    is_heading_exact: bool,
    /// Number of the compass's next reading, if none is missing before.
    next_reading: Option<u32>,
    /// First burst of the present settings.
    from_number: u32,
    /// Flown with these filters, so that its states apply.
    is_revision: bool,
    agreement: Agreement,
}

impl Replay {
    /// Creates a replay with the flight's settings. Only the Kalman filter can be exact.
    pub fn new(log: &FlightLog, flight: &Flight, filter: FilterName) -> Result<Self, String> {
        let Some(first) = &flight.configuration else {
            return Err(
                "there is no configuration in it, so that the bytes have no meaning: \
                 record a second or more"
                    .into(),
            );
        };
        let is_revision = first.revision == REVISION;
        Ok(Self {
            steps: log.steps(flight)?,
            pipeline: AnyPipeline::for_bursts(filter, &first.settings),
            settings: first.settings,
            last: None,
            is_exact: false,
            is_heading_exact: false,
            next_reading: None,
            from_number: first.from_number,
            is_revision,
            agreement: Agreement {
                other_revision: (!is_revision).then_some(first.revision),
                ..Agreement::default()
            },
        })
    }

    /// Replays the next burst, and returns its snapshot.
    pub fn next(&mut self) -> Option<Snapshot> {
        let step = self.steps.next()?;
        let NumberedBurst {
            number,
            flags,
            burst,
        } = step.numbered;
        let before = self.last.replace(number);
        self.is_exact &= before.is_some_and(|before| before.checked_add(1) == Some(number));
        self.is_heading_exact &= self.is_exact;
        if let Some(next) = &step.configuration {
            self.change_settings(next);
        }
        if self.is_revision {
            self.restore(&step);
        }
        // The log does not hold the module's checks of the full scales. Only VALID depends on them.
        let snapshot = self.pipeline.update(&burst, flags);
        self.agreement.bursts += 1;
        if self.is_exact {
            self.agreement.exact += 1;
            if let Some(flown) = &step.attitude {
                self.compare(&snapshot, flown);
            }
        }
        if self.is_heading_exact {
            self.agreement.heading_exact += 1;
            if let Some(flown) = &step.heading {
                self.compare_heading(flown);
            }
        }
        if let Some(reading) = &step.reading {
            self.take_reading(reading, burst.captured_at_us);
        }
        Some(snapshot)
    }

    /// Continues from the states of the flight before this burst, if they are complete.
    fn restore(&mut self, step: &Step) {
        if let Some(state) = &step.state
            && let Some(pipeline) = self.pipeline.kalman_mut()
        {
            let mut restored = *pipeline;
            let mut reader = StateReader::new(state);
            restored.visit_state(&mut reader);
            if reader.is_complete() {
                *pipeline = restored;
                self.is_exact = true;
            }
        }
        if let Some(state) = &step.heading_state {
            let mut restored = HeadingState {
                next_reading: 0,
                filter: None,
            };
            let mut reader = StateReader::new(state);
            restored.visit_state(&mut reader);
            if reader.is_complete() {
                self.pipeline.restore_heading(restored.filter);
                self.next_reading = Some(restored.next_reading);
                self.is_heading_exact = self.is_exact;
            }
        }
    }

    /// Adds a reading of the compass after the burst of this time.
    fn take_reading(&mut self, reading: &CompassReading, t_us: u64) {
        let is_next = self.next_reading == Some(reading.number);
        let is_known = if reading.starts_filter {
            self.is_exact
        } else {
            self.is_heading_exact && is_next
        };
        self.is_heading_exact = is_known && reading.sample_t_us == t_us;
        self.next_reading = Some(reading.number.wrapping_add(1));
        self.pipeline.take_reading(reading);
    }

    /// Returns the pipeline.
    pub fn pipeline(&self) -> &AnyPipeline {
        &self.pipeline
    }

    /// Returns the agreement with the flight so far.
    pub fn agreement(&self) -> &Agreement {
        &self.agreement
    }

    fn change_settings(&mut self, next: &Configuration) {
        // The log does not say between which two samples the settings changed, nor which.
        // An armed filter and another compass do not show in the settings.
        if next.from_number != self.from_number {
            self.is_exact = false;
            self.is_heading_exact = false;
            self.from_number = next.from_number;
        }
        let settings = &next.settings;
        if *settings != self.settings {
            self.is_exact = false;
            self.is_heading_exact = false;
            self.pipeline.set_calibration(settings);
            self.settings = *settings;
        }
    }

    fn compare_heading(&mut self, flown: &TimedHeading) {
        self.agreement.heading_compared += 1;
        let bits = |heading: HeadingEstimate| {
            let (offset_rad, sigma_rad) = (heading.yaw_offset_rad, heading.sigma_rad);
            (offset_rad.to_bits(), sigma_rad.to_bits(), heading.is_valid)
        };
        if flown.estimate.map(bits) != self.pipeline.heading().map(bits) {
            self.agreement.heading_different += 1;
            self.agreement.first_difference_us.get_or_insert(flown.t_us);
        }
    }

    fn compare(&mut self, snapshot: &Snapshot, flown: &Snapshot) {
        self.agreement.compared += 1;
        let bits = |snapshot: &Snapshot| {
            let Quaternion { w, x, y, z } = snapshot.attitude;
            let rates = snapshot.body_rates_rad_s;
            [w, x, y, z, rates.x, rates.y, rates.z].map(f32::to_bits)
        };
        if bits(flown) != bits(snapshot) {
            self.agreement.different += 1;
            self.agreement
                .first_difference_us
                .get_or_insert(snapshot.t_us);
        }
    }
}

#[cfg(test)]
mod tests;
