//! The I2C controller with the one behaviour that rigless leaves out: CR2.LAST.
//!
//! With LAST set, the controller does not acknowledge the last byte that the DMA takes (RM0090, section 27.3.7), so the
//! sensor lets go of the bus and the STOP that follows is clean. Without it, every burst after the first starts with
//! the sensor still sending. Here the acknowledge bit is taken away around a byte's end while the DMA stream that
//! serves the receiver has one item left.

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::RegisterSpec;
use rigless::soc::stm32f427::generated::dma2;
use rigless::soc::stm32f427::generated::i2c3::{Register, cr1, cr2};
use rigless::soc::stm32f427::peripherals::i2c::I2c;
use rigless::time::{EventId, VirtualNanos};

/// The channel and the streams of DMA1 that serve I2C1's receiver (RM0090, table 42), by their control and count registers.
const RECEIVE_CHANNEL: u64 = 1;
const RECEIVE_STREAMS: [(dma2::Register, dma2::Register); 2] = [
    (dma2::Register::S0cr, dma2::Register::S0ndtr),
    (dma2::Register::S5cr, dma2::Register::S5ndtr),
];

/// The items that the enabled stream has left to move for I2C1's receiver, from DMA1's registers.
#[must_use]
pub fn items_left(dma1: &RegisterFile) -> Option<u64> {
    RECEIVE_STREAMS.into_iter().find_map(|(control, count)| {
        let control = dma1.get(control);
        let serves =
            dma2::s0cr::EN.is_set(control) && dma2::s0cr::CHSEL.get(control) == RECEIVE_CHANNEL;
        serves.then(|| dma1.get(count))
    })
}

/// The controller.
#[derive(Debug)]
pub struct LastAware {
    /// What rigless models of it.
    pub model: I2c,
    /// What [`items_left`] says; whoever calls the controller sets it first.
    pub items_left: Option<u64>,
}

impl Device for LastAware {
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
    }

    fn on_event(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let control = registers.get(Register::Cr2);
        let is_last =
            cr2::LAST.is_set(control) && cr2::DMAEN.is_set(control) && self.items_left == Some(1);
        let acknowledge = cr1::ACK.mask();
        let before = registers.get(Register::Cr1);
        if is_last {
            registers.set(Register::Cr1, before & !acknowledge);
        }
        Device::on_event(&mut self.model, event, registers, context);
        if is_last {
            registers.restore(Register::Cr1, acknowledge, before);
        }
    }

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        Device::on_clock(&mut self.model, hz, registers, context);
    }

    fn reset(&mut self) {
        Device::reset(&mut self.model);
    }

    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        Device::reset_line(&mut self.model, registers, context);
    }
}
