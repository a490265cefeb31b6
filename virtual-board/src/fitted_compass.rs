//! The compass as it is fitted to the board: on the main bus, or behind the IMU, with its faults.

use aplomb_models::compass::{Compass, CompassConfig, CompassFault};
use aplomb_models::sensor::Sensor;

use crate::faults::{FaultKind, ScheduledFault};
use crate::wires::SharedWires;

/// The compass with its wires and their faults.
pub struct FittedCompass {
    compass: Compass,
    /// The scheduled faults of the compass.
    faults: Vec<ScheduledFault>,
    is_addressed: bool,
    was_absent: bool,
    had_other: bool,
}

impl FittedCompass {
    /// Fits a compass with the faults of a schedule that are its own.
    pub fn new(config: CompassConfig, faults: &[ScheduledFault]) -> Self {
        let is_own = |fault: &&ScheduledFault| fault.kind.is_of_compass();
        let mut compass = Compass::new(config);
        compass.power_up(0);
        Self {
            compass,
            faults: faults.iter().filter(is_own).copied().collect(),
            is_addressed: false,
            was_absent: false,
            had_other: false,
        }
    }

    /// The compass.
    pub fn compass(&self) -> &Compass {
        &self.compass
    }

    /// Returns true if the compass has acknowledged its address, and there has been no STOP since.
    pub fn is_addressed(&self) -> bool {
        self.is_addressed
    }

    /// The time of the next measurement.
    pub fn next_event_ns(&self) -> Option<u64> {
        self.compass.next_event_ns()
    }

    /// Advances the compass to `now_ns`, on the body of this sensor.
    pub fn advance_to(&mut self, now_ns: u64, sensor: &Sensor) {
        // Another chip in the compass's place has not been configured.
        let is_other = |fault: &ScheduledFault| {
            matches!(fault.kind, FaultKind::CompassIdentity(_)) && fault.lasts(now_ns)
        };
        let has_other = self.faults.iter().any(is_other);
        if has_other && !self.had_other {
            self.compass.power_up(now_ns);
        }
        self.had_other = has_other;
        let is_absent = self.lasts(now_ns, FaultKind::CompassSilent);
        if self.was_absent && !is_absent {
            self.compass.power_up(now_ns);
        }
        self.was_absent = is_absent;
        let faults = self.faults.iter().filter(|fault| fault.lasts(now_ns));
        let of_outputs = |fault: &ScheduledFault| match fault.kind {
            FaultKind::CompassFrozen => Some(CompassFault::Frozen),
            FaultKind::CompassZeros => Some(CompassFault::Zeros),
            FaultKind::CompassOverflow => Some(CompassFault::Overflow),
            FaultKind::CompassGarbled => Some(CompassFault::Garbled),
            FaultKind::CompassNeverReady => Some(CompassFault::NeverReady),
            FaultKind::CompassIdentity(identity) => Some(CompassFault::Identity(identity)),
            _ => None,
        };
        let faults = faults.filter_map(of_outputs).collect();
        self.compass.set_faults(faults);
        self.compass.advance_to(now_ns, &sensor.truth());
    }

    /// A start condition with an address. Returns the acknowledge.
    pub fn start(
        &mut self,
        now_ns: u64,
        address: u8,
        read: bool,
        sensor: &Sensor,
        wires: &SharedWires,
    ) -> bool {
        let is_reachable = !self.compass.config().is_behind_imu || sensor.has_bypass();
        self.is_addressed = is_reachable
            && !self.lasts(now_ns, FaultKind::CompassSilent)
            && self.compass.start(now_ns, address, read);
        if self.is_addressed
            && let Some(stall) = self
                .faults
                .iter()
                .find(|fault| fault.kind == FaultKind::CompassStall && fault.lasts(now_ns))
        {
            wires.lock().stretch_until(stall.end_ns());
        }
        self.is_addressed
    }

    /// A byte from the controller. Returns the acknowledge.
    pub fn write(&mut self, now_ns: u64, byte: u8) -> bool {
        !self.lasts(now_ns, FaultKind::CompassSilent) && self.compass.write(now_ns, byte)
    }

    /// A byte to the controller.
    pub fn read(&mut self, now_ns: u64) -> u8 {
        if self.lasts(now_ns, FaultKind::CompassSilent) {
            0xFF
        } else {
            self.compass.read()
        }
    }

    /// A stop condition.
    pub fn stop(&mut self) {
        self.is_addressed = false;
    }

    fn lasts(&self, now_ns: u64, kind: FaultKind) -> bool {
        let is_active = |fault: &ScheduledFault| fault.kind == kind && fault.lasts(now_ns);
        self.faults.iter().any(is_active)
    }
}
