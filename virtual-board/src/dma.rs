//! The DMA controller of the sensor's bus, with memory that may refuse.
//!
//! Stream 0 serves the receiver of I2C1. While the fault lasts, the bus answers its accesses with
//! an error: TEIF is set, and the hardware clears EN (RM0090, section 10.3.18).

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::stm32f427::generated::dma2::Register;
use rigless::soc::stm32f427::peripherals::dma::Dma;

use crate::delegate::delegate;
use crate::faults::{Fault, FaultKind, ScheduledFault, scheduled};

/// rigless numbers the accesses of its streams two to a stream: to its source, and to its
/// destination.
const ACCESSES_OF_STREAM_0: std::ops::Range<u64> = 0..2;

/// The controller.
#[derive(Debug)]
pub struct RefusedDma {
    /// The model of rigless.
    pub model: Dma,
    faults: Vec<ScheduledFault>,
}

impl RefusedDma {
    /// The controller with these faults.
    #[must_use]
    pub fn new(model: Dma, faults: &[Fault]) -> Self {
        let is_own = |fault: &&ScheduledFault| fault.kind == FaultKind::DmaError;
        Self {
            model,
            faults: scheduled(faults).filter(is_own).copied().collect(),
        }
    }
}

impl Device for RefusedDma {
    type Register = Register;

    delegate!(layout read peek write on_event on_request on_refused on_clock reset reset_line);

    fn on_access(
        &mut self,
        token: u64,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let is_refused = ACCESSES_OF_STREAM_0.contains(&token)
            && self.faults.iter().any(|fault| fault.lasts(context.now().0));
        if is_refused {
            Device::on_refused(&mut self.model, token, registers, context);
        } else {
            Device::on_access(&mut self.model, token, value, registers, context);
        }
    }
}
