//! Replay of a flight: the logged bursts through the pipeline, compared with the logged attitudes.

use aplomb::attitude::Quaternion;
use aplomb::estimator::REVISION;
use aplomb::pipeline::Snapshot;
use aplomb::serialize::StateReader;
use aplomb::telemetry::log::NumberedBurst;
use aplomb_recordings::flight_log::Flight;

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
pub struct Replay<'a> {
    flight: &'a Flight,
    next: usize,
    device: Device,
    /// Index of the present configuration.
    configuration: usize,
    is_exact: bool,
    /// Flown with these filters, so that its states apply.
    is_revision: bool,
    agreement: Agreement,
}

impl<'a> Replay<'a> {
    /// Creates a replay with the flight's settings. Only the Kalman filter can be exact.
    pub fn new(flight: &'a Flight, filter: FilterName) -> Result<Self, &'static str> {
        let Some(first) = flight.configurations.first() else {
            return Err(
                "there is no configuration in it, so that the bytes have no meaning: \
                 record a second or more",
            );
        };
        let is_revision = first.revision == REVISION;
        Ok(Self {
            flight,
            next: 0,
            device: Device::for_bursts(filter, &first.settings),
            configuration: 0,
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
        let NumberedBurst {
            number,
            flags,
            burst,
        } = *self.flight.bursts.get(self.next)?;
        let before = self.next.checked_sub(1);
        let follows = before.is_some_and(|before| self.flight.bursts[before].number + 1 == number);
        self.is_exact &= follows;
        self.next += 1;
        self.change_settings(number);
        if self.is_revision
            && let Some(state) = self.flight.state(number)
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
            self.compare(&snapshot);
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

    fn change_settings(&mut self, number: u32) {
        let Some(next) = self.flight.configurations.get(self.configuration + 1) else {
            return;
        };
        if number < next.from_number {
            return;
        }
        let before = &self.flight.configurations[self.configuration].settings;
        if next.settings != *before {
            // The log does not say between which two samples the settings changed.
            self.is_exact = false;
            self.device.set_calibration(&next.settings);
        }
        self.configuration += 1;
    }

    fn compare(&mut self, snapshot: &Snapshot) {
        let Some(flown) = self.flight.attitude(snapshot.t_us) else {
            return;
        };
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
