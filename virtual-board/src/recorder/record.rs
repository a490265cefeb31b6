//! The record of a run.

use aplomb::estimator::heading::HeadingEstimate;
use aplomb::fault::FaultClass;
use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;
use aplomb_models::sensor::{Burst, DataReady};

use crate::bus_step::BusStep;
use crate::mcu::ReceivedByte;
use crate::probe::LogLine;

/// A published sample.
#[derive(Clone, Debug)]
pub struct Sample {
    /// The published snapshot.
    pub snapshot: Snapshot,
    /// The heading that was published until the next snapshot; `None` while it is unknown.
    pub heading: Option<HeadingEstimate>,
    /// True if the module was armed when it processed the sample.
    pub is_armed: bool,
    /// Time of publication, ns since power-up.
    pub published_ns: u64,
    /// The burst that it was made from, as far as its time tells.
    pub burst: Burst,
    /// True if that burst had not been published before. False too if the firmware took a burst
    /// for whole that the sensor had not delivered.
    pub is_new: bool,
    /// The edge that announced the burst's data, with the true motion at that instant.
    pub edge: Option<DataReady>,
    /// The true time of the edge by the firmware's clock, in microseconds with their fraction.
    pub true_t_us: Option<f64>,
    /// Instructions from the edge on, of all interrupts and of the attitude task. `None` if
    /// something else happened before the next edge than one publication.
    pub instructions: Option<u64>,
    /// Instructions from the edge on, without the attitude task.
    pub input_instructions: Option<u64>,
}

/// The record of a run.
#[derive(Debug, Default)]
pub struct Record {
    /// Published samples, in order.
    pub samples: Vec<Sample>,
    /// The snapshots published without a sample, in order.
    pub stale: Vec<StaleSnapshot>,
    /// Data-ready edges, in order.
    pub edges: Vec<DataReady>,
    /// The firmware's log, as the probe read it.
    pub log: Vec<LogLine>,
    /// The bytes from the UART.
    pub received: Vec<ReceivedByte>,
    /// Instructions executed and virtual time when the first sample was published.
    pub first: Option<(u64, u64)>,
    /// Instructions executed and virtual time at the end.
    pub last: (u64, u64),
    /// Accesses of peripherals from the first sample on.
    pub accesses: u64,
    /// Exceptions entered for the samples, from the first sample on.
    pub sample_exceptions: u64,
    /// All instructions executed, by exception number; 0 is thread mode.
    pub instructions: Vec<u64>,
    /// Bytes of the stack that were ever written.
    pub stack_bytes_used: u64,
    /// Number of random contents of the RAM: that of the start, and one after each loss.
    pub ram_power_ups: usize,
    /// The firmware's counters, at each change.
    pub health: Vec<HealthReading>,
    /// End of the sensor's start-up after each return of its supply, ns.
    pub sensor_ready_ns: Vec<u64>,
    /// Falling edges of SCL and of SDA that the firmware made with the pin as an output.
    pub falls_by_hand: [u32; 2],
    /// Times that a reset left the sensor waiting for a byte.
    pub writes_left: u32,
    /// Bytes that it then received from clocks that the firmware made by hand.
    pub bytes_by_hand: u32,
    /// True if the flash's prefetch is on at the end.
    pub prefetches: bool,
    /// Times of the processor's resets, ns.
    pub resets_ns: Vec<u64>,
    /// The steps of the bus in which the scheduled faults began, in the order of the faults.
    pub steps_at_faults: Vec<BusStep>,
}

impl Sample {
    /// The heading, if the firmware's outputs call it valid: the attitude has to be valid too.
    #[must_use]
    pub fn valid_heading(&self) -> Option<HeadingEstimate> {
        let has_tilt = self.snapshot.flags.contains(Flags::VALID);
        self.heading.filter(|heading| heading.is_valid && has_tilt)
    }
}

impl Record {
    /// Returns the classes whose counters are higher at the end of a time than before it.
    #[must_use]
    pub fn counted(&self, from_ns: u64, until_ns: u64) -> Vec<FaultClass> {
        let health = &self.health;
        let before = health.iter().rfind(|reading| reading.at_ns < from_ns);
        let after = health.iter().rfind(|reading| reading.at_ns <= until_ns);
        let count = |reading: Option<&HealthReading>, class: FaultClass| {
            reading.map_or(0, |reading| reading.counters[class as usize])
        };
        let classes = FaultClass::ALL.into_iter();
        classes
            .filter(|&class| count(after, class) > count(before, class))
            .collect()
    }

    /// Drops the parts that would grow without end.
    pub(super) fn forget(&mut self) {
        /// The edge of a burst is among the last ones.
        const EDGES_KEPT: usize = 8;
        self.samples.clear();
        self.stale.clear();
        self.edges
            .drain(..self.edges.len().saturating_sub(EDGES_KEPT));
        self.log.clear();
        self.received.clear();
        self.health.drain(..self.health.len().saturating_sub(1));
    }
}

/// A snapshot that the firmware published because no sample had come.
#[derive(Clone, Copy, Debug)]
pub struct StaleSnapshot {
    /// The published snapshot.
    pub snapshot: Snapshot,
    /// Time of publication, ns since power-up.
    pub published_ns: u64,
}

/// The firmware's health report at one time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HealthReading {
    /// Time of the reading, ns since power-up.
    pub at_ns: u64,
    /// The cause of the last reset, by the firmware's number.
    pub reset_cause: u32,
    /// Number of faults seen of each class, by the firmware's number of the class.
    pub counters: [u32; FaultClass::COUNT],
}
