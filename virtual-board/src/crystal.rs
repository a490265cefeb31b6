//! The clock controller with an oscillator input that may have nothing on it.
//!
//! rigless's clock controller reports the HSE ready whatever is at the pin. Here it becomes ready
//! only if the board has the requested source (RM0090, section 6.2.1): a crystal with HSEBYP clear,
//! or another chip's clock with HSEBYP set.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::FieldSpec;
use rigless::soc::stm32f427::generated::rcc::{Register, cr};
use rigless::soc::stm32f427::peripherals::rcc::Rcc;
use rigless::time::{EventId, VirtualNanos};

use crate::checks::{Checks, Rule};
use crate::delegate::delegate;
use crate::regulator::Regulator;

/// Cycles of the internal oscillator at 16 MHz in the start-up of a crystal, 2 ms, and of the PLL,
/// 0.3 ms (STM32F405 datasheet, "HSE oscillator characteristics" and "Main PLL characteristics").
const CRYSTAL_INSTRUCTIONS: u64 = 32_000;
const PLL_INSTRUCTIONS: u64 = 4_800;

/// The clock source at the high-speed oscillator's pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HighSpeedInput {
    /// Nothing, or a crystal that does not start.
    Nothing,
    /// A crystal, in hertz.
    Crystal(u64),
    /// A clock from another chip, in hertz.
    ExternalClock(u64),
}

impl HighSpeedInput {
    /// The frequency in hertz, zero if there is none.
    #[must_use]
    pub fn frequency_hz(self) -> u64 {
        match self {
            Self::Nothing => 0,
            Self::Crystal(hz) | Self::ExternalClock(hz) => hz,
        }
    }

    /// Returns true if the oscillator runs with HSEBYP set or clear.
    fn starts(self, bypassed: bool) -> bool {
        match self {
            Self::Nothing => false,
            Self::Crystal(_) => !bypassed,
            Self::ExternalClock(_) => bypassed,
        }
    }
}

/// The clock controller.
#[derive(Debug)]
pub struct CrystalAware {
    /// The model of rigless.
    pub model: Rcc,
    /// The board's clock source.
    pub input: HighSpeedInput,
    /// The board's clock source before the crystal stopped.
    pub stopped: Option<HighSpeedInput>,
    /// The regulator of the core's supply.
    pub regulator: Regulator,
    /// VOS in PWR_CR.
    pub voltage_scale: u64,
    /// Instructions that the core executes in a second.
    pub instructions_hz: u64,
    /// Events of the model that a start-up delays: the event at its end, and the model's.
    pub delayed: Vec<(EventId, EventId)>,
    /// The checks, which note a core that is too fast for the regulator.
    pub checks: Checks,
}

impl CrystalAware {
    /// The clock controller of an STM32F405 with this clock source.
    #[must_use]
    pub fn new(model: Rcc, input: HighSpeedInput, checks: Checks) -> Self {
        Self {
            model,
            input,
            stopped: None,
            regulator: Regulator::F405,
            voltage_scale: 1,
            instructions_hz: 168_000_000,
            delayed: Vec::new(),
            checks,
        }
    }

    /// The crystal, or the other chip's clock, stops. With the clock security system on, the
    /// hardware switches to the internal oscillator and sets CSSF (RM0090, section 7.2.7), which
    /// requests the NMI. Returns true if the system is off, so that the core has lost its clock.
    pub fn stop_crystal(
        &mut self,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> bool {
        let control = registers.get(Register::Cr);
        let is_used = cr::HSERDY.is_set(control);
        let is_guarded = cr::CSSON.is_set(control);
        self.stopped.get_or_insert(self.input);
        self.input = HighSpeedInput::Nothing;
        if is_guarded {
            self.model.fail_hse(registers, context);
        }
        // SWS: 0 is the internal oscillator; 1 and 2 are the crystal and the PLL, which runs from
        // it if PLLSRC says so.
        let switched = registers.get(Register::Cfgr) >> 2 & 3;
        let pll_from_crystal = registers.get(Register::Pllcfgr) >> 22 & 1 == 1;
        is_used && !is_guarded && (switched == 1 || switched == 2 && pll_from_crystal)
    }

    /// The crystal runs again.
    pub fn restart_crystal(&mut self) {
        if let Some(input) = self.stopped.take() {
            self.input = input;
        }
    }

    /// Returns the duration of the start-up that is under way, ns, if there is one.
    ///
    /// The core executes as many instructions in it as the internal oscillator has cycles, whatever
    /// the rate of the emulated core. So a poll has as many readings as on a chip, or fewer.
    fn startup_ns(&self, registers: &RegisterFile) -> Option<u64> {
        let control = registers.get(Register::Cr);
        let is_starting =
            |on: &FieldSpec, ready: &FieldSpec| on.is_set(control) && !ready.is_set(control);
        let instructions = if is_starting(cr::HSEON, cr::HSERDY) && !cr::HSEBYP.is_set(control) {
            CRYSTAL_INSTRUCTIONS
        } else if is_starting(cr::PLLON, cr::PLLRDY) {
            PLL_INSTRUCTIONS
        } else {
            return None;
        };
        Some(instructions * 1_000_000_000 / self.instructions_hz)
    }

    /// Notes a core that is too fast for the regulator's scale.
    fn check_voltage(&self, registers: &RegisterFile) {
        let limits_mhz = self.regulator.limits_mhz;
        let limit_mhz = limits_mhz[self.voltage_scale as usize % limits_mhz.len()];
        if self.model.sysclk(registers) > limit_mhz * 1_000_000 {
            self.checks.note(Rule::VoltageScale);
        }
    }

    /// Takes the ready flag back if the oscillator cannot run.
    fn refuse_readiness(&self, registers: &mut RegisterFile) {
        let control = registers.get(Register::Cr);
        if !self.input.starts(cr::HSEBYP.is_set(control)) {
            registers.set(Register::Cr, cr::HSERDY.set(control, 0));
        }
    }
}

impl Device for CrystalAware {
    type Register = Register;

    delegate!(layout read peek on_request on_access on_refused on_clock reset reset_line);

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::write(&mut self.model, register, value, registers, context);
        self.refuse_readiness(registers);
        self.check_voltage(registers);
    }

    fn on_event(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let ended = self.delayed.iter().position(|&(end, _)| end == event);
        let event = match (ended, self.startup_ns(registers)) {
            (Some(at), _) => self.delayed.swap_remove(at).1,
            (None, Some(startup_ns)) => {
                let end = context.schedule(VirtualNanos(context.now().0 + startup_ns));
                self.delayed.push((end, event));
                return;
            }
            (None, None) => event,
        };
        Device::on_event(&mut self.model, event, registers, context);
        self.refuse_readiness(registers);
        self.check_voltage(registers);
    }
}
