//! The INT pin: register map r4.2, sections 4.14 (INT_PIN_CFG), 4.15 (INT_ENABLE) and 4.16
//! (INT_STATUS).

/// INT_PIN_CFG: the pin is active low.
const ACTIVE_LOW: u8 = 1 << 7;
/// INT_PIN_CFG: the pin only pulls down.
const OPEN_DRAIN: u8 = 1 << 6;
/// INT_PIN_CFG: the pin stays active until the status is cleared.
const LATCH: u8 = 1 << 5;
/// INT_PIN_CFG: reading any register clears the status.
const READ_CLEARS: u8 = 1 << 4;

/// Length of the pulse without the latch, in ns (t_INT, product specification r3.4, section 6.4).
pub const PULSE_NS: u64 = 50_000;

/// State in which the pin drives its wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinLevel {
    /// Driven to ground.
    Low,
    /// Driven to the supply.
    High,
    /// Not driven; the level is the pull resistor's.
    Released,
}

/// The state of the data-ready interrupt.
#[derive(Clone, Debug, Default)]
pub struct Interrupt {
    /// INT_PIN_CFG.
    pub configuration: u8,
    /// DATA_RDY_INT in INT_STATUS.
    status: bool,
    latched: bool,
    pulse_end_ns: u64,
}

impl Interrupt {
    /// Notes a sample at `now_ns`. Returns true if the pin went from inactive to active.
    pub fn raise(&mut self, now_ns: u64) -> bool {
        let was_active = self.is_active(now_ns);
        self.status = true;
        if self.configuration & LATCH != 0 {
            self.latched = true;
        } else {
            self.pulse_end_ns = now_ns + PULSE_NS;
        }
        !was_active
    }

    /// Processes a read of a register over the bus. `is_status` is true for INT_STATUS.
    pub fn register_read(&mut self, is_status: bool) {
        if is_status || self.configuration & READ_CLEARS != 0 {
            self.status = false;
            self.latched = false;
        }
    }

    /// DATA_RDY_INT.
    #[must_use]
    pub fn status(&self) -> bool {
        self.status
    }

    /// Returns true if the pin signals an interrupt at `now_ns`.
    #[must_use]
    pub fn is_active(&self, now_ns: u64) -> bool {
        self.latched || now_ns < self.pulse_end_ns
    }

    /// Returns the end of a pulse that is active at `now_ns`.
    #[must_use]
    pub fn pulse_end_ns(&self, now_ns: u64) -> Option<u64> {
        (now_ns < self.pulse_end_ns).then_some(self.pulse_end_ns)
    }

    /// Returns how the pin drives its wire at `now_ns`.
    #[must_use]
    pub fn pin(&self, now_ns: u64) -> PinLevel {
        let low = self.is_active(now_ns) == (self.configuration & ACTIVE_LOW != 0);
        match (low, self.configuration & OPEN_DRAIN != 0) {
            (true, _) => PinLevel::Low,
            (false, false) => PinLevel::High,
            (false, true) => PinLevel::Released,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn configured(configuration: u8) -> Interrupt {
        Interrupt {
            configuration,
            ..Interrupt::default()
        }
    }

    #[test]
    fn a_pulse_lasts_50_microseconds() {
        let mut interrupt = configured(0);
        assert_eq!(interrupt.pin(0), PinLevel::Low);
        assert!(interrupt.raise(1000));
        assert_eq!(interrupt.pin(1000), PinLevel::High);
        assert_eq!(interrupt.pin(50_999), PinLevel::High);
        assert_eq!(interrupt.pin(51_000), PinLevel::Low);
        // The status outlives the pulse.
        assert!(interrupt.status());
    }

    #[test]
    fn polarity_and_open_drain_shape_the_pin() {
        for (configuration, idle, active) in [
            (0, PinLevel::Low, PinLevel::High),
            (ACTIVE_LOW, PinLevel::High, PinLevel::Low),
            (OPEN_DRAIN, PinLevel::Low, PinLevel::Released),
            (ACTIVE_LOW | OPEN_DRAIN, PinLevel::Released, PinLevel::Low),
        ] {
            let mut interrupt = configured(configuration);
            assert_eq!(interrupt.pin(0), idle, "{configuration:#04x}");
            interrupt.raise(0);
            assert_eq!(interrupt.pin(10), active, "{configuration:#04x}");
        }
    }

    #[test]
    fn a_latched_pin_waits_for_the_status_to_be_read() {
        let mut interrupt = configured(LATCH);
        assert!(interrupt.raise(0));
        assert!(!interrupt.raise(1_000_000), "still active: no new edge");
        interrupt.register_read(false);
        assert!(interrupt.is_active(2_000_000));
        interrupt.register_read(true);
        assert!(!interrupt.is_active(2_000_000));
        assert!(!interrupt.status());
        assert!(interrupt.raise(3_000_000));
    }

    #[test]
    fn any_read_clears_when_told_so() {
        let mut interrupt = configured(LATCH | READ_CLEARS);
        interrupt.raise(0);
        interrupt.register_read(false);
        assert!(!interrupt.is_active(10));
        assert!(!interrupt.status());
    }
}
