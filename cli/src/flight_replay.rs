//! Replay of a flight: the logged bursts through the pipeline, compared with the logged attitudes.

use aplomb::attitude::Quaternion;
use aplomb::estimator::REVISION;
use aplomb::pipeline::{Settings, Snapshot};
use aplomb::serialize::StateReader;
use aplomb::telemetry::log::NumberedBurst;
use aplomb_recordings::flight_log::{Flight, FlightLog, Steps};

use crate::device::{Device, FilterName};

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
    /// Revision of the filters that flew, if it is not [`REVISION`]: then nothing is exact.
    pub other_revision: Option<u16>,
}

/// Replay of a flight, burst by burst.
pub struct Replay {
    steps: Steps,
    device: Device,
    settings: Settings,
    /// Number of the last burst.
    last: Option<u32>,
    is_exact: bool,
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
            device: Device::for_bursts(filter, &first.settings),
            settings: first.settings,
            last: None,
            is_exact: false,
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
        if let Some(next) = &step.configuration {
            self.change_settings(&next.settings);
        }
        if self.is_revision
            && let Some(state) = &step.state
            && let Some(pipeline) = self.device.kalman_mut()
        {
            let mut restored = *pipeline;
            let mut reader = StateReader::new(state);
            restored.visit_state(&mut reader);
            if reader.is_complete() {
                *pipeline = restored;
                self.is_exact = true;
            }
        }
        // The log does not hold the module's checks of the full scales. Only VALID depends on them.
        let snapshot = self.device.update(&burst, flags);
        self.agreement.bursts += 1;
        if self.is_exact {
            self.agreement.exact += 1;
            if let Some(flown) = &step.attitude {
                self.compare(&snapshot, flown);
            }
        }
        Some(snapshot)
    }

    /// Returns the pipeline.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Returns the agreement with the flight so far.
    pub fn agreement(&self) -> &Agreement {
        &self.agreement
    }

    fn change_settings(&mut self, settings: &Settings) {
        if *settings != self.settings {
            // The log does not say between which two samples the settings changed.
            self.is_exact = false;
            self.device.set_calibration(settings);
            self.settings = *settings;
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
