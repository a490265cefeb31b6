//! The bytes that the controller clocks in after a byte that it did not acknowledge. No device
//! drives the bus then, so they read 0xFF. (The manual's overrun, OVR, is another thing.)

use rigless::device::{Device, DeviceContext, RegisterFile};
use rigless::soc::stm32f427::generated::i2c3::{Register, ccr, cr2, sr1, sr2};
use rigless::time::{EventId, VirtualNanos};

use super::WiredI2c;

/// Periods of SCL in a byte with its acknowledge.
const PERIODS_OF_BYTE: u64 = 9;

/// The data on a bus that no device pulls low.
const RELEASED: u64 = 0xFF;

/// The byte after one that was not acknowledged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum TrailingByte {
    #[default]
    Nothing,
    /// The controller clocks another byte at this event, unless it is to make a STOP or START.
    Due(EventId),
    /// A byte is on the wire until this event.
    OnWire(EventId),
}

impl WiredI2c {
    /// A period of SCL, ns (27.6.8).
    pub(super) fn period_ns(registers: &RegisterFile) -> u64 {
        let control = registers.get(Register::Ccr);
        let periods = match (ccr::F_S.is_set(control), ccr::DUTY.is_set(control)) {
            (false, _) => 2,
            (true, false) => 3,
            (true, true) => 25,
        };
        let clock_mhz = cr2::FREQ.get(registers.get(Register::Cr2)).max(1);
        1_000 * periods * ccr::CCR.get(control) / clock_mhz
    }

    /// Clocks on after a byte that was not acknowledged. Returns false if the event is another.
    pub(super) fn clock_on(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> bool {
        match self.trailing {
            TrailingByte::Due(due) if due == event => {}
            TrailingByte::OnWire(end) if end == event => {
                self.trailing = TrailingByte::Nothing;
                let status = registers.get(Register::Sr1);
                let is_full = sr1::RXNE.is_set(status);
                self.is_behind |= is_full && self.released == 0;
                self.released += 1;
                let flag = if is_full { sr1::BTF } else { sr1::RXNE };
                registers.set(Register::Sr1, flag.set(status, 1));
                self.refresh_model(registers, context);
                if self.waiting != 0 {
                    // `follow_lines` carries STOP or START out.
                    return true;
                }
            }
            _ => return false,
        }
        self.trailing = TrailingByte::Nothing;
        let is_controller = sr2::MSL.is_set(registers.get(Register::Sr2));
        // With DR and the shift register full the clock is held.
        if is_controller && !sr1::BTF.is_set(registers.get(Register::Sr1)) {
            let byte_ns = PERIODS_OF_BYTE * Self::period_ns(registers);
            let end = context.schedule(VirtualNanos(context.now().0 + byte_ns));
            self.trailing = TrailingByte::OnWire(end);
        }
        true
    }

    /// Makes the model drive its interrupts and requests from the flags.
    pub(super) fn refresh_model(
        &mut self,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let control = registers.get(Register::Cr2);
        Device::write(&mut self.model, Register::Cr2, control, registers, context);
    }

    /// Forgets the bytes of the released bus.
    pub(super) fn drop_released(&mut self, registers: &mut RegisterFile) {
        self.trailing = TrailingByte::Nothing;
        self.is_behind = false;
        if std::mem::take(&mut self.released) > 0 {
            let status = registers.get(Register::Sr1);
            registers.set(Register::Sr1, sr1::RXNE.set(sr1::BTF.set(status, 0), 0));
        }
    }

    /// Reads DR, if bytes of the released bus are in it or behind it.
    pub(super) fn read_released(
        &mut self,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        let value = if std::mem::take(&mut self.is_behind) {
            Device::read(&mut self.model, Register::Dr, registers, context)
        } else {
            self.released = self.released.checked_sub(1)?;
            Some(RELEASED)
        };
        let status = registers.get(Register::Sr1);
        let is_held = sr1::BTF.is_set(status);
        let status = sr1::RXNE.set(sr1::BTF.set(status, 0), u64::from(self.released > 0));
        registers.set(Register::Sr1, status);
        self.refresh_model(registers, context);
        if is_held {
            // The clock goes on.
            self.trailing = TrailingByte::Due(context.schedule(context.now()));
        }
        value
    }
}
