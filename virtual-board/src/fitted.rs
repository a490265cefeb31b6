//! The sensor as it is fitted to the board: on the I2C bus, its INT pin on a wire, and the faults in between.

use std::fmt;

use rigless::chip::Timeline;
use rigless::chip::i2c::Peer;
use rigless::snapshot::Store;

use crate::faults::{BusByte, BusLine, Fault, nanoseconds, within};
use crate::sensor::registers::address;
use crate::sensor::{Burst, DataReady, Sensor};

/// The sensor with its wires and their faults.
pub struct FittedSensor {
    sensor: Sensor,
    faults: Vec<Fault>,
    /// Instants at which a fault begins or ends, in order; those that have passed are gone.
    fault_times_ns: Vec<u64>,
    /// The level that the board saw last.
    wire_high: bool,
    /// The register that the next byte concerns, as the bus shows it.
    pointer: Option<u8>,
    edges: Vec<DataReady>,
    bursts: Vec<Burst>,
}

impl FittedSensor {
    /// Fits a sensor.
    #[must_use]
    pub fn new(sensor: Sensor, faults: Vec<Fault>) -> Self {
        let mut fault_times_ns: Vec<u64> = faults
            .iter()
            .flat_map(|fault| match fault {
                Fault::SensorAbsent(range)
                | Fault::SensorSilent(range)
                | Fault::BusHeldLow(_, range)
                | Fault::InterruptStuck(_, range) => {
                    vec![nanoseconds(range.start), nanoseconds(range.end)]
                }
                Fault::SensorReset(at_s) => vec![nanoseconds(*at_s)],
                Fault::Identity(..)
                | Fault::Nack { .. }
                | Fault::ReceptionGarbled { .. }
                | Fault::NoCrystal
                | Fault::TimerStartsAt(_) => vec![],
            })
            .collect();
        fault_times_ns.sort_unstable();
        Self {
            sensor,
            faults,
            fault_times_ns,
            wire_high: false,
            pointer: None,
            edges: Vec::new(),
            bursts: Vec::new(),
        }
    }

    /// Brings the sensor up to `now_ns` and says how the INT wire has changed since the last call, in order.
    pub fn advance_to(&mut self, now_ns: u64) -> Vec<bool> {
        let mut changes = Vec::new();
        while let Some(&at_ns) = self
            .fault_times_ns
            .first()
            .filter(|&&at_ns| at_ns <= now_ns)
        {
            self.fault_times_ns.remove(0);
            self.follow(at_ns, &mut changes);
            let restarts = self.faults.iter().any(|fault| match fault {
                Fault::SensorAbsent(range) => nanoseconds(range.end) == at_ns,
                Fault::SensorReset(at_s) => nanoseconds(*at_s) == at_ns,
                _ => false,
            });
            if restarts {
                self.sensor.power_up(at_ns);
            }
            self.show(at_ns, &mut changes);
        }
        self.follow(now_ns, &mut changes);
        changes
    }

    /// Whether a line of the bus is held low.
    #[must_use]
    pub fn holds_low(&self, line: BusLine, now_ns: u64) -> bool {
        let is_held = |fault: &Fault| matches!(fault, Fault::BusHeldLow(held, range) if *held == line && within(now_ns, range));
        self.faults.iter().any(is_held)
    }

    /// When the wire next changes, or a fault comes or goes, at the latest.
    #[must_use]
    pub fn next_event_ns(&self) -> Option<u64> {
        let fault = self.fault_times_ns.first().copied();
        [fault, self.sensor.next_event_ns()]
            .into_iter()
            .flatten()
            .min()
    }

    /// Takes the data-ready edges since the last call, whatever became of them on the wire.
    pub fn take_edges(&mut self) -> Vec<DataReady> {
        std::mem::take(&mut self.edges)
    }

    /// Takes the bursts that the bus has delivered since the last call.
    pub fn take_bursts(&mut self) -> Vec<Burst> {
        std::mem::take(&mut self.bursts)
    }

    /// Steps the sensor through its events up to `now_ns`, so that no pulse is lost between two calls.
    fn follow(&mut self, now_ns: u64, changes: &mut Vec<bool>) {
        while let Some(event_ns) = self
            .sensor
            .next_event_ns()
            .filter(|&event_ns| event_ns <= now_ns)
        {
            self.sensor.advance_to(event_ns);
            self.show(event_ns, changes);
        }
        self.sensor.advance_to(now_ns);
        self.show(now_ns, changes);
        let mut edges = self.sensor.take_edges();
        edges.retain(|edge| !self.is_absent(edge.time_ns));
        self.edges.append(&mut edges);
        self.bursts.append(&mut self.sensor.take_bursts());
    }

    /// Puts the level at `now_ns` on the wire.
    fn show(&mut self, now_ns: u64, changes: &mut Vec<bool>) {
        let stuck = self.faults.iter().find_map(|fault| match fault {
            Fault::InterruptStuck(level, range) if within(now_ns, range) => Some(*level),
            _ => None,
        });
        let high = stuck.unwrap_or(self.sensor.interrupt_level() && !self.is_absent(now_ns));
        if high != self.wire_high {
            self.wire_high = high;
            changes.push(high);
        }
    }

    fn is_absent(&self, now_ns: u64) -> bool {
        self.faults
            .iter()
            .any(|fault| matches!(fault, Fault::SensorAbsent(range) if within(now_ns, range)))
    }

    /// Whether the bus hears nothing of the sensor.
    fn is_deaf(&self, now_ns: u64) -> bool {
        let is_off = |fault: &Fault| match fault {
            Fault::SensorAbsent(range)
            | Fault::SensorSilent(range)
            | Fault::BusHeldLow(_, range) => within(now_ns, range),
            _ => false,
        };
        self.faults.iter().any(is_off)
    }

    /// Whether a fault refuses this byte; each refusal counts.
    fn refuses(&mut self, now_ns: u64, kind: BusByte) -> bool {
        self.faults.iter_mut().any(|fault| match fault {
            Fault::Nack {
                byte,
                from_s,
                count,
            } if *byte == kind && now_ns >= nanoseconds(*from_s) && *count > 0 => {
                *count -= 1;
                true
            }
            _ => false,
        })
    }
}

impl fmt::Debug for FittedSensor {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("FittedSensor")
            .field("faults", &self.faults)
            .finish_non_exhaustive()
    }
}

/// Runs start from reset alone, so nothing keeps a board.
impl Store for FittedSensor {}

impl Peer for FittedSensor {
    fn start(&mut self, address: u8, read: bool, context: &mut Timeline<'_, '_>) -> bool {
        let now_ns = context.now().0;
        let kind = if read {
            BusByte::AddressRead
        } else {
            BusByte::AddressWrite
        };
        if !read {
            self.pointer = None;
        }
        !self.is_deaf(now_ns)
            && !self.refuses(now_ns, kind)
            && self.sensor.start(now_ns, address, read)
    }

    fn write(&mut self, byte: u8, context: &mut Timeline<'_, '_>) -> bool {
        let now_ns = context.now().0;
        let kind = if self.pointer.is_none() {
            BusByte::Pointer
        } else {
            BusByte::Value
        };
        if self.is_deaf(now_ns) || self.refuses(now_ns, kind) {
            return false;
        }
        self.pointer = Some(self.pointer.map_or(byte, |pointer| pointer.wrapping_add(1)));
        self.sensor.write(now_ns, byte)
    }

    fn read(&mut self, _last: bool, context: &mut Timeline<'_, '_>) -> u8 {
        let now_ns = context.now().0;
        let value = self.sensor.read(now_ns);
        if self.is_deaf(now_ns) {
            return 0xFF;
        }
        let register = self.pointer;
        self.pointer = register.map(|pointer| pointer.wrapping_add(1));
        let identity = self.faults.iter().find_map(|fault| match fault {
            Fault::Identity(identity, range) if within(now_ns, range) => Some(*identity),
            _ => None,
        });
        match identity {
            Some(identity) if register == Some(address::WHO_AM_I) => identity,
            _ => value,
        }
    }

    fn stop(&mut self, context: &mut Timeline<'_, '_>) {
        self.sensor.stop(context.now().0);
    }
}
