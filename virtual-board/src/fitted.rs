//! The sensor as it is fitted to the board: on the I2C bus, its INT pin on a wire, and the faults
//! in between.

use std::fmt;

use rigless::chip::Timeline;
use rigless::chip::i2c::Peer;
use rigless::snapshot::Store;

use crate::faults::{
    BusByte, BusLine, Direction, Fault, FaultKind, ScheduledFault, internal_time, nanoseconds,
    scheduled, within,
};
use crate::fitted_compass::FittedCompass;
use crate::wires::SharedWires;
use aplomb_models::compass::{Compass, CompassConfig};
use aplomb_models::sensor::registers::address;
use aplomb_models::sensor::{Burst, DataReady, OutputFault, Sensor};

/// Duration of a glitch on the INT wire, ns.
const GLITCH_NS: u64 = 1_000;

/// The devices on the bus: the sensor and perhaps a compass, with their wires and faults.
pub struct BusDevices {
    sensor: Sensor,
    compass: Option<FittedCompass>,
    wires: SharedWires,
    faults: Vec<Fault>,
    /// The faults of a schedule.
    scheduled: Vec<ScheduledFault>,
    /// Instants at which a fault begins or ends, in order; those that have passed are gone.
    fault_times_ns: Vec<u64>,
    /// The error of the core's time, and its beginning, ns.
    internal_time: Option<(f64, u64)>,
    /// The level that the board saw last.
    wire_high: bool,
    /// True if the microcontroller pulls the INT pin up.
    is_pulled_up: bool,
    /// True if the sensor has acknowledged its address, and there has been no STOP since.
    is_addressed: bool,
    /// True if the sensor sends.
    is_sending: bool,
    /// The number of the byte that is written next, the register's first.
    written: u8,
    /// The register that the next byte concerns, as the bus shows it.
    pointer: Option<u8>,
    /// The bytes that the bus has delivered in this transfer.
    delivered: Vec<u8>,
    edges: Vec<DataReady>,
    bursts: Vec<Burst>,
}

impl BusDevices {
    /// Fits a sensor.
    #[must_use]
    pub fn new(sensor: Sensor, faults: Vec<Fault>) -> Self {
        let mut fault_times_ns: Vec<u64> = faults
            .iter()
            .flat_map(|fault| match fault {
                Fault::SensorAbsent(range)
                | Fault::SensorSilent(range)
                | Fault::BusHeldLow(_, range)
                | Fault::InterruptStuck(_, range)
                | Fault::Supply(_, range) => {
                    vec![nanoseconds(range.start), nanoseconds(range.end)]
                }
                Fault::SensorReset(at_s) => vec![nanoseconds(*at_s)],
                Fault::Scheduled(fault) => vec![fault.start_ns, fault.end_ns()],
                Fault::Identity(..)
                | Fault::Nack { .. }
                | Fault::ReceptionGarbled { .. }
                | Fault::NoCrystal
                | Fault::InternalOscillator(_)
                | Fault::SlowStart
                | Fault::NoTimeForStop
                | Fault::SlowWatchdog
                | Fault::WatchdogClock(_)
                | Fault::ChipRevision(_)
                | Fault::TimerStartsAt(_) => vec![],
            })
            .collect();
        let internal_time = internal_time(&faults);
        fault_times_ns.extend(internal_time.map(|(_, from_ns)| from_ns));
        fault_times_ns.sort_unstable();
        fault_times_ns.dedup();
        fault_times_ns.retain(|&at_ns| at_ns != u64::MAX);
        Self {
            sensor,
            compass: None,
            wires: SharedWires::new(&faults),
            scheduled: scheduled(&faults).copied().collect(),
            faults,
            fault_times_ns,
            internal_time,
            wire_high: false,
            is_pulled_up: false,
            is_addressed: false,
            is_sending: false,
            written: 0,
            pointer: None,
            delivered: Vec::new(),
            edges: Vec::new(),
            bursts: Vec::new(),
        }
    }

    /// Fits a compass beside the sensor.
    #[must_use]
    pub fn with_compass(mut self, config: Option<CompassConfig>) -> Self {
        self.compass = config.map(|config| FittedCompass::new(config, &self.scheduled));
        self
    }

    /// The compass, if there is one.
    #[must_use]
    pub fn compass(&self) -> Option<&Compass> {
        self.compass.as_ref().map(FittedCompass::compass)
    }

    /// The lines of its bus.
    #[must_use]
    pub fn wires(&self) -> SharedWires {
        self.wires.clone()
    }

    /// Every fault of the board.
    #[must_use]
    pub fn faults(&self) -> &[Fault] {
        &self.faults
    }

    /// Sets the microcontroller's pull-up on the INT pin, which decides the level of an open wire.
    pub fn set_pull_up(&mut self, is_pulled_up: bool) {
        self.is_pulled_up = is_pulled_up;
    }

    /// Advances the sensor to `now_ns`. Returns the changes of the INT wire since the last call in
    /// order, each with its time and level.
    pub fn advance_to(&mut self, now_ns: u64) -> Vec<(u64, bool)> {
        let mut changes = Vec::new();
        while let Some(&at_ns) = self
            .fault_times_ns
            .first()
            .filter(|&&at_ns| at_ns <= now_ns)
        {
            self.fault_times_ns.remove(0);
            self.follow(at_ns, &mut changes);
            self.begin_and_end(at_ns);
            self.show(at_ns, &mut changes);
        }
        self.follow(now_ns, &mut changes);
        changes
    }

    /// Latest time of the next change of the wire, or of a fault that comes or goes.
    #[must_use]
    pub fn next_event_ns(&self) -> Option<u64> {
        let fault = self.fault_times_ns.first().copied();
        let glitch = self.next_glitch_ns(self.sensor.now_ns());
        let compass = self.compass.as_ref().and_then(FittedCompass::next_event_ns);
        [fault, glitch, compass, self.sensor.next_event_ns()]
            .into_iter()
            .flatten()
            .min()
    }

    /// Returns the end of the sensor's start-up, ns, while it acknowledges nothing.
    #[must_use]
    pub fn ready_at_ns(&self) -> Option<u64> {
        self.sensor.ready_at_ns()
    }

    /// Takes the data-ready edges since the last call, also those that a fault kept from the wire.
    pub fn take_edges(&mut self) -> Vec<DataReady> {
        std::mem::take(&mut self.edges)
    }

    /// Takes the bursts that the bus has delivered since the last call.
    pub fn take_bursts(&mut self) -> Vec<Burst> {
        std::mem::take(&mut self.bursts)
    }

    /// Returns how many bytes the bus has delivered since the last address.
    #[must_use]
    pub fn delivered(&self) -> usize {
        self.delivered.len()
    }

    /// Processes a STOP on the bus that the controller has not made.
    pub fn receive_stop(&mut self, now_ns: u64) {
        self.is_addressed = false;
        self.is_sending = false;
        self.sensor.stop(now_ns);
        if let Some(compass) = &mut self.compass {
            compass.stop();
        }
    }

    /// The microcontroller is reset. A sensor that was sending is left in the middle of a byte. It
    /// holds SDA until it has had the rest of its clocks (UM10204, 3.1.16).
    pub fn controller_restarts(&mut self, now_ns: u64) {
        if self.is_addressed && self.is_sending {
            let clocks = 1 + now_ns / 2_500 % 8;
            // The bits of the byte before stand for those of this one. The first holds the line.
            let bits = self.delivered.last().copied().unwrap_or(0) & 0x7F;
            self.wires.lock().lose_count(clocks as u8, bits);
        }
        self.receive_stop(now_ns);
    }

    /// Applies the faults that begin or end at this instant.
    fn begin_and_end(&mut self, at_ns: u64) {
        let restarts = self.faults.iter().any(|fault| match fault {
            Fault::SensorAbsent(range) => nanoseconds(range.end) == at_ns,
            Fault::SensorReset(at_s) => nanoseconds(*at_s) == at_ns,
            Fault::Scheduled(fault) => fault.kind.stops_sensor() && fault.end_ns() == at_ns,
            _ => false,
        });
        if restarts {
            self.receive_stop(at_ns);
            self.wires.lock().lose_count(0, 0);
            self.sensor.power_up(at_ns);
        }
        if let Some((error, from_ns)) = self.internal_time
            && from_ns == at_ns
        {
            self.sensor.change_time(at_ns, error);
        }
        for nth in 0..self.scheduled.len() {
            let fault = self.scheduled[nth];
            if fault.start_ns != at_ns {
                continue;
            }
            match fault.kind {
                FaultKind::RegisterFlip(register, value) => {
                    self.sensor.corrupt_register(at_ns, register, value);
                }
                FaultKind::SdaLow(Some(rest)) => {
                    self.receive_stop(at_ns);
                    self.wires.lock().lose_count(rest.clocks, rest.bits);
                }
                _ => {}
            }
        }
        let outputs = self
            .scheduled
            .iter()
            .filter(|fault| fault.lasts(at_ns))
            .filter_map(|fault| match fault.kind {
                FaultKind::Frozen => Some(OutputFault::Frozen),
                FaultKind::Zeros => Some(OutputFault::All(0x00)),
                FaultKind::Ones => Some(OutputFault::All(0xFF)),
                FaultKind::Saturated(axis) => Some(OutputFault::FullScale(axis as usize)),
                FaultKind::Stuck(axis) => Some(OutputFault::Stuck(axis as usize)),
                FaultKind::Temperature(celsius) => Some(OutputFault::Temperature(celsius)),
                _ => None,
            })
            .collect();
        self.sensor.set_output_faults(outputs);
    }

    /// Steps the sensor through its events up to `now_ns`, so that no pulse is lost between two
    /// calls.
    fn follow(&mut self, now_ns: u64, changes: &mut Vec<(u64, bool)>) {
        loop {
            let glitch_ns = self.next_glitch_ns(self.sensor.now_ns());
            let next_ns = [glitch_ns, self.sensor.next_event_ns()]
                .into_iter()
                .flatten()
                .min();
            let Some(event_ns) = next_ns.filter(|&event_ns| event_ns <= now_ns) else {
                break;
            };
            self.sensor.advance_to(event_ns);
            self.show(event_ns, changes);
        }
        self.sensor.advance_to(now_ns);
        if let Some(compass) = &mut self.compass {
            compass.advance_to(now_ns, &self.sensor);
        }
        self.show(now_ns, changes);
        let mut edges = self.sensor.take_edges();
        edges.retain(|edge| !self.is_absent(edge.time_ns));
        self.edges.append(&mut edges);
        self.bursts.append(&mut self.sensor.take_bursts());
    }

    /// Puts the level at `now_ns` on the wire.
    fn show(&mut self, now_ns: u64, changes: &mut Vec<(u64, bool)>) {
        let stuck = self.faults.iter().find_map(|fault| match fault {
            Fault::InterruptStuck(level, range) if within(now_ns, range) => Some(*level),
            _ => None,
        });
        let mut high = stuck.unwrap_or(self.sensor.interrupt_level() && !self.is_absent(now_ns));
        for fault in self.scheduled.iter().filter(|fault| fault.lasts(now_ns)) {
            match fault.kind {
                FaultKind::IntMissing => high = self.is_pulled_up,
                FaultKind::IntHigh => high = true,
                FaultKind::IntLow => high = false,
                FaultKind::IntGlitch(hz) => high ^= is_glitch(fault, hz, now_ns),
                _ => {}
            }
        }
        if high != self.wire_high {
            self.wire_high = high;
            changes.push((now_ns, high));
        }
    }

    /// The next beginning or end of a glitch after `now_ns`.
    fn next_glitch_ns(&self, now_ns: u64) -> Option<u64> {
        let of = |fault: &ScheduledFault| {
            let FaultKind::IntGlitch(hz) = fault.kind else {
                return None;
            };
            let period_ns = 1_000_000_000 / u64::from(hz);
            let first_ns = fault.start_ns + period_ns / 2;
            let since_ns = now_ns.checked_sub(first_ns);
            let next_ns = match since_ns {
                None => first_ns,
                Some(since_ns) if since_ns % period_ns < GLITCH_NS => {
                    now_ns - since_ns % period_ns + GLITCH_NS
                }
                Some(since_ns) => now_ns - since_ns % period_ns + period_ns,
            };
            (next_ns < fault.end_ns()).then_some(next_ns)
        };
        self.scheduled.iter().filter_map(of).min()
    }

    fn addressed_compass(&mut self) -> Option<&mut FittedCompass> {
        self.compass
            .as_mut()
            .filter(|compass| compass.is_addressed())
    }

    fn is_absent(&self, now_ns: u64) -> bool {
        self.faults.iter().any(|fault| match fault {
            Fault::SensorAbsent(range) => within(now_ns, range),
            Fault::Scheduled(fault) => fault.kind.stops_sensor() && fault.lasts(now_ns),
            _ => false,
        })
    }

    /// Returns true if the sensor does not answer on the bus.
    fn is_deaf(&self, now_ns: u64) -> bool {
        let is_silent = |fault: &Fault| match fault {
            Fault::SensorSilent(range) => within(now_ns, range),
            Fault::Scheduled(fault) => fault.kind == FaultKind::SensorSilent && fault.lasts(now_ns),
            _ => false,
        };
        self.is_absent(now_ns) || self.faults.iter().any(is_silent)
    }

    /// Returns true if a fault refuses this byte. Counts the refusals of a counted fault.
    fn refuses(&mut self, now_ns: u64, kind: BusByte) -> bool {
        let number = self.written;
        self.faults.iter_mut().any(|fault| match fault {
            Fault::Nack {
                byte,
                from_s,
                count,
            } if *byte == kind && now_ns >= nanoseconds(*from_s) && *count > 0 => {
                *count -= 1;
                true
            }
            Fault::Scheduled(fault) if fault.lasts(now_ns) => match fault.kind {
                FaultKind::AddressNack(direction) => match kind {
                    BusByte::AddressWrite => direction != Some(Direction::Read),
                    BusByte::AddressRead => direction != Some(Direction::Write),
                    BusByte::Pointer | BusByte::Value => false,
                },
                FaultKind::DataNack(byte) => {
                    matches!(kind, BusByte::Pointer | BusByte::Value) && byte == number
                }
                _ => false,
            },
            _ => false,
        })
    }
}

/// Returns true during a glitch on the wire.
fn is_glitch(fault: &ScheduledFault, hz: u32, now_ns: u64) -> bool {
    let period_ns = 1_000_000_000 / u64::from(hz);
    let since_ns = now_ns.checked_sub(fault.start_ns + period_ns / 2);
    since_ns.is_some_and(|since_ns| since_ns % period_ns < GLITCH_NS)
}

impl fmt::Debug for BusDevices {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("BusDevices")
            .field("faults", &self.faults)
            .finish_non_exhaustive()
    }
}

/// Runs start from reset alone, so nothing keeps a board.
impl Store for BusDevices {}

impl Peer for BusDevices {
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
        self.written = 0;
        self.delivered.clear();
        // A START ends any byte.
        self.wires.lock().lose_count(0, 0);
        if self.wires.lock().take_stop() {
            self.receive_stop(now_ns);
        }
        self.is_addressed = !self.is_deaf(now_ns)
            && !self.refuses(now_ns, kind)
            && self.sensor.start(now_ns, address, read);
        let is_compass = self
            .compass
            .as_mut()
            .is_some_and(|compass| compass.start(now_ns, address, read, &self.sensor, &self.wires));
        self.is_sending = (self.is_addressed || is_compass) && read;
        self.is_addressed || is_compass
    }

    fn write(&mut self, byte: u8, context: &mut Timeline<'_, '_>) -> bool {
        let now_ns = context.now().0;
        if let Some(compass) = self.addressed_compass() {
            return compass.write(now_ns, byte);
        }
        let kind = if self.pointer.is_none() {
            BusByte::Pointer
        } else {
            BusByte::Value
        };
        let is_received = self.is_addressed && !self.is_deaf(now_ns) && !self.refuses(now_ns, kind);
        self.written = self.written.saturating_add(1);
        if !is_received {
            return false;
        }
        self.pointer = Some(self.pointer.map_or(byte, |pointer| pointer.wrapping_add(1)));
        self.sensor.write(now_ns, byte)
    }

    fn read(&mut self, _last: bool, context: &mut Timeline<'_, '_>) -> u8 {
        let now_ns = context.now().0;
        if let Some(compass) = self.addressed_compass() {
            let value = compass.read(now_ns);
            let is_low = self.wires.lock().holds_low(BusLine::Data, now_ns);
            self.delivered.push(if is_low { 0x00 } else { value });
            return if is_low { 0x00 } else { value };
        }
        let value = if self.is_addressed {
            self.sensor.read(now_ns)
        } else {
            0xFF
        };
        let register = self.pointer;
        self.pointer = register.map(|pointer| pointer.wrapping_add(1));
        let identity = self.faults.iter().find_map(|fault| match fault {
            Fault::Identity(identity, range) if within(now_ns, range) => Some(*identity),
            _ => None,
        });
        let delivered = match identity {
            _ if self.wires.lock().holds_low(BusLine::Data, now_ns) => 0x00,
            _ if self.is_deaf(now_ns) => 0xFF,
            Some(identity) if register == Some(address::WHO_AM_I) => identity,
            _ => value,
        };
        self.delivered.push(delivered);
        // What the bus has delivered counts, not what the sensor has sent.
        for mut burst in self.sensor.take_bursts() {
            let first = self.delivered.len().saturating_sub(burst.bytes.len());
            for (byte, &delivered) in burst.bytes.iter_mut().zip(&self.delivered[first..]) {
                *byte = delivered;
            }
            self.bursts.push(burst);
        }
        delivered
    }

    fn stop(&mut self, context: &mut Timeline<'_, '_>) {
        self.receive_stop(context.now().0);
    }
}
