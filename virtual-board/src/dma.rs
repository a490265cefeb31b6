//! The DMA controller of the sensor's bus, with memory that may refuse.
//!
//! Stream 0 serves the receiver of I2C1. While the fault lasts, the bus answers its accesses with
//! an error: TEIF is set, and the hardware clears EN (RM0090, section 10.3.18).

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::Layout;
use rigless::soc::stm32f427::generated::dma2::{Register, s0cr};
use rigless::soc::stm32f427::peripherals::dma::Dma;
use rigless::time::EventId;

use crate::checks::{Checks, Rule};
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
    checks: Checks,
    /// The streams that are on, before the present call, by bit.
    on: u8,
}

impl RefusedDma {
    /// The controller with these faults.
    #[must_use]
    pub fn new(model: Dma, faults: &[Fault], checks: Checks) -> Self {
        let is_own = |fault: &&ScheduledFault| fault.kind == FaultKind::DmaError;
        Self {
            model,
            faults: scheduled(faults).filter(is_own).copied().collect(),
            checks,
            on: 0,
        }
    }

    /// Resets this layer.
    pub fn forget(&mut self) {
        self.on = 0;
    }

    fn note_streams(&mut self, registers: &RegisterFile) {
        self.on = (0_u8..).zip(CONTROLS).fold(0, |on, (stream, control)| {
            on | u8::from(s0cr::EN.is_set(registers.get(control))) << stream
        });
    }

    /// Checks a write to a stream's registers (10.3.17, 10.5.5 to 10.5.10). Writing zero to EN is
    /// allowed at any time, with the rest of the register.
    fn check(&self, register: Register, value: u64, registers: &RegisterFile) {
        let Some((stream, place)) = stream_register(register) else {
            return;
        };
        let is_on = self.on >> stream & 1 == 1;
        let stays_on = place != 0 || s0cr::EN.is_set(value);
        if is_on && stays_on {
            self.checks.note(Rule::StreamOff);
        }
        if place == 0 && !is_on && s0cr::EN.is_set(value) {
            let status = if stream < 4 {
                Register::Lisr
            } else {
                Register::Hisr
            };
            let flags = registers.get(status) >> FLAG_SHIFTS[stream % 4] & ALL_FLAGS;
            if flags != 0 {
                self.checks.note(Rule::StreamFlags);
            }
        }
    }
}

/// The streams' control registers.
const CONTROLS: [Register; 8] = [
    Register::S0cr,
    Register::S1cr,
    Register::S2cr,
    Register::S3cr,
    Register::S4cr,
    Register::S5cr,
    Register::S6cr,
    Register::S7cr,
];
/// Offset of the first stream's registers, and from one stream's to the next (10.5.11).
const FIRST_STREAM: u32 = 0x10;
const STREAM_BYTES: u32 = 0x18;
/// Positions of a stream's flags in its status register, and all of them (10.5.1).
const FLAG_SHIFTS: [u32; 4] = [0, 6, 16, 22];
const ALL_FLAGS: u64 = 0b11_1101;

/// Returns the stream of a register and its place in words: 0 is the control register.
fn stream_register(register: Register) -> Option<(usize, u32)> {
    let offset = register.spec().offset.checked_sub(FIRST_STREAM)?;
    let stream = usize::try_from(offset / STREAM_BYTES).ok()?;
    Some((stream, offset % STREAM_BYTES / 4))
}

impl Device for RefusedDma {
    type Register = Register;

    delegate!(layout read peek on_request on_refused on_clock reset_line);

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
        self.note_streams(registers);
    }

    fn on_event(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::on_event(&mut self.model, event, registers, context);
        self.note_streams(registers);
    }

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
        self.note_streams(registers);
    }
}
