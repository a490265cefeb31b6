//! The independent watchdog, with checks of the order in which its registers are written.
//!
//! The chip ignores a write of PR or RLR without the key, and one while the write before is still
//! on its way (RM0090, 21.3.2 and 21.4.4). A firmware that breaks the order then runs with another
//! limit than it believes.
//!
//! A value takes up to five cycles of the oscillator to reach the counter. ST's HAL and Zephyr
//! allow six cycles of the prescaler's output, which is longer by its division. The slow watchdog
//! takes five of those.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::stm32f427::generated::iwdg::{Register, kr, pr, sr};
use rigless::soc::stm32f427::peripherals::iwdg::Iwdg;
use rigless::time::{EventId, NANOS_PER_SECOND, VirtualNanos};

use crate::checks::{Checks, Rule};
use crate::delegate::delegate;

/// The key that opens PR and RLR; any other one closes them (RM0090, 21.4.1).
const OPENING_KEY: u64 = 0x5555;

/// The watchdog.
#[derive(Debug)]
pub struct CheckedWatchdog {
    /// The model of rigless.
    pub model: Iwdg,
    checks: Checks,
    /// True if the last key was the opening one.
    is_open: bool,
    /// True if a value takes cycles of the prescaler's output to reach the counter.
    pub is_slow: bool,
    clock_hz: u64,
    /// The model's events at which a value has arrived, and the later ones that stand for them.
    arrivals: Vec<EventId>,
    delayed: Vec<(EventId, EventId)>,
}

/// Cycles of the oscillator until a value has reached the counter (RM0090, 21.4.4).
const CROSSING_CYCLES: u64 = 5;

impl CheckedWatchdog {
    /// A watchdog that notes broken rules in `checks`.
    #[must_use]
    pub fn new(model: Iwdg, checks: Checks) -> Self {
        Self {
            model,
            checks,
            is_open: false,
            is_slow: false,
            clock_hz: 0,
            arrivals: Vec::new(),
            delayed: Vec::new(),
        }
    }

    /// Resets this layer.
    pub fn forget(&mut self) {
        self.is_open = false;
        self.clock_hz = 0;
        self.arrivals.clear();
        self.delayed.clear();
    }

    /// Schedules an event after so many cycles of the oscillator.
    fn after_cycles(&self, cycles: u64, context: &mut DeviceContext<'_>) -> Option<EventId> {
        // Rounded as in the model: two events at one time are one.
        let span_ns = (NANOS_PER_SECOND * cycles).checked_div(self.clock_hz)?;
        Some(context.schedule(VirtualNanos(context.now().0 + span_ns)))
    }

    fn check(&mut self, register: Register, value: u64, registers: &RegisterFile) {
        let crossing = match register {
            Register::Kr => {
                self.is_open = kr::KEY.get(value) == OPENING_KEY;
                return;
            }
            Register::Pr => sr::PVU,
            Register::Rlr => sr::RVU,
            Register::Sr => return,
        };
        if !self.is_open {
            self.checks.note(Rule::WatchdogOpen);
        }
        if crossing.is_set(registers.get(Register::Sr)) {
            self.checks.note(Rule::WatchdogUpdated);
        }
    }
}

impl Device for CheckedWatchdog {
    type Register = Register;

    delegate!(layout read peek on_request on_access on_refused reset_line);

    fn reset(&mut self) {
        Device::reset(&mut self.model);
        self.forget();
    }

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        self.check(register, value, registers);
        Device::write(&mut self.model, register, value, registers, context);
        if self.is_slow && matches!(register, Register::Pr | Register::Rlr) {
            let arrival = self.after_cycles(CROSSING_CYCLES, context);
            self.arrivals.extend(arrival);
        }
    }

    fn on_event(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        if self.arrivals.contains(&event) {
            self.arrivals.retain(|arrival| *arrival != event);
            let division = 4 << pr::PR.get(registers.get(Register::Pr)).min(6);
            if let Some(later) = self.after_cycles(CROSSING_CYCLES * (division - 1), context) {
                self.delayed.push((later, event));
                return;
            }
        }
        let original = self.delayed.iter().position(|(later, _)| *later == event);
        let event = original.map_or(event, |nth| self.delayed.swap_remove(nth).1);
        Device::on_event(&mut self.model, event, registers, context);
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.clock_hz = hz;
        Device::on_clock(&mut self.model, hz, registers, context);
        // What was written before the oscillator's start is on its way from now on.
        let is_new = self.arrivals.is_empty() && self.delayed.is_empty();
        if self.is_slow && is_new && registers.get(Register::Sr) != 0 {
            self.arrivals = Vec::from_iter(self.after_cycles(CROSSING_CYCLES, context));
        }
    }
}
