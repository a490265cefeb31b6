//! The clock controller with an oscillator input that may have nothing on it.
//!
//! rigless's clock controller reports the HSE ready whatever is at the pin. Here it becomes ready only if the board
//! has what the firmware asked for: a crystal, with HSEBYP clear, or another chip's clock, with HSEBYP set (RM0090,
//! section 6.2.1).

use rigless::device::{Device, DeviceContext, RegisterFile, RequestChange};
use rigless::soc::RegisterSpec;
use rigless::soc::stm32f427::generated::rcc::{Register, cr};
use rigless::soc::stm32f427::peripherals::rcc::Rcc;
use rigless::time::{EventId, VirtualNanos};

/// What is connected to the high-speed oscillator's pins.
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

    /// Whether the oscillator runs with HSEBYP set or clear.
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
    /// What rigless models of it.
    pub model: Rcc,
    /// What the board has.
    pub input: HighSpeedInput,
}

impl CrystalAware {
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

    fn layout(&self) -> &'static [RegisterSpec] {
        Device::layout(&self.model)
    }

    fn read(
        &mut self,
        register: Register,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        Device::read(&mut self.model, register, registers, context)
    }

    fn peek(&self, register: Register, registers: &RegisterFile, now: VirtualNanos) -> Option<u64> {
        Device::peek(&self.model, register, registers, now)
    }

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::write(&mut self.model, register, value, registers, context);
        self.refuse_readiness(registers);
    }

    fn on_event(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::on_event(&mut self.model, event, registers, context);
        self.refuse_readiness(registers);
    }

    fn on_request(
        &mut self,
        request: RequestChange,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::on_request(&mut self.model, request, registers, context);
    }

    fn reset(&mut self) {
        Device::reset(&mut self.model);
    }
}
