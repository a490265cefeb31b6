//! The independent watchdog, with checks of the order in which its registers are written.
//!
//! The chip ignores a write of PR or RLR without the key, and one while the write before is still
//! on its way (RM0090, 21.3.2 and 21.4.4). A firmware that breaks the order then runs with another
//! limit than it believes.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::stm32f427::generated::iwdg::{Register, kr, sr};
use rigless::soc::stm32f427::peripherals::iwdg::Iwdg;

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
}

impl CheckedWatchdog {
    /// A watchdog that notes broken rules in `checks`.
    #[must_use]
    pub fn new(model: Iwdg, checks: Checks) -> Self {
        Self {
            model,
            checks,
            is_open: false,
        }
    }

    /// Resets this layer.
    pub fn forget(&mut self) {
        self.is_open = false;
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

    delegate!(layout read peek on_event on_request on_access on_refused on_clock reset_line);

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
    }
}
