//! The I2C controller with what rigless leaves out: CR2.LAST, and lines that do not follow.
//!
//! Sections are those of RM0090.
//!
//! - With CR2.LAST set, the last byte that the DMA takes is not acknowledged. The sensor then lets
//!   go of the bus, and the STOP that follows is clean (27.3.7).
//! - After that byte the controller goes on to clock, unless STOP or START is requested within a
//!   bit: a released bus reads 0xFF. That byte sets RXNE, or BTF if DR is full, and requests DMA. A
//!   STOP that comes within it waits for its end (27.3.3: STOP ends the current byte).
//! - While SCL is held low no byte ends: it ends once SCL is free (27.3.3).
//! - SDA low where a one is sent is ARLO: the transfer ends, MSL is cleared, BUSY stays (27.3.4).
//! - A START or STOP of another device within a byte is BERR. The transfer continues, whatever the
//!   sensor does (27.3.4).
//! - BUSY is set while a line is low. Only SWRST or a STOP on the lines clears it; SDA rising with
//!   SCL high is a STOP (27.6.7).
//! - START and STOP are not carried out while a line is low, and read back set (27.6.1).
//! - A STOP takes a period of SCL. Until then it reads back set, and the bus is busy.
//! - A write of CR1 while START or STOP reads back set leaves that bit set, and nothing comes of it
//!   until SWRST (27.6.1, note on STOP and START; bugs of other drivers).
//! - A START takes no time, or 0.6 µs and 1.2 µs if asked for.
//! - A STOP requested while the peripheral is not the controller changes nothing (27.6.1).
//! - BERR and ARLO raise the error interrupt under ITERREN. A written zero or PE = 0 clears them
//!   (27.4, 27.6.6).
//!
//! Both errors show at the end of the byte, up to 22 µs later than on silicon. Events between two
//! bits are not modelled.

mod trailing;

use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::FieldSpec;
use rigless::soc::stm32f427::generated::dma2;
use rigless::soc::stm32f427::generated::i2c3::{Register, ccr, cr1, cr2, sr1, sr2};
use rigless::soc::stm32f427::peripherals::i2c::I2c;
use rigless::time::{EventId, VirtualNanos};

use crate::bus_step::BusStep;
use crate::checks::{Checks, Rule};
use crate::delegate::delegate;
use crate::faults::{BusLine, Fault, FaultKind, ScheduledFault, scheduled};
use crate::fitted::BusDevices;
use crate::wires::SharedWires;
use trailing::TrailingByte;

/// The channel and the streams of DMA1 that serve I2C1's receiver (RM0090, table 42), by their
/// control and count registers.
const RECEIVE_CHANNEL: u64 = 1;
const RECEIVE_STREAMS: [(dma2::Register, dma2::Register); 2] = [
    (dma2::Register::S0cr, dma2::Register::S0ndtr),
    (dma2::Register::S5cr, dma2::Register::S5ndtr),
];

/// The error interrupt's place among the instance's two (RM0090, table 62).
const ERROR_INTERRUPT: usize = 1;

/// From a clock that is let go to the end of the byte that waited for it: one bit at 400 kHz, ns.
const REST_OF_BYTE_NS: u64 = 2_500;

/// From the request of a START on a free bus to SB, ns: the hold time of fast mode. A START in a
/// transfer has the set-up time before it (UM10204, table 11).
const FIRST_START_NS: u64 = 600;
const NEXT_START_NS: u64 = 600 + 600;

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
pub struct WiredI2c {
    /// The model of rigless.
    pub model: I2c,
    /// The result of [`items_left`]. The caller sets it before each call.
    pub items_left: Option<u64>,
    /// True if the pins are connected to the controller. The caller sets it before each call.
    pub is_connected: bool,
    wires: SharedWires,
    /// The scheduled faults of the controller's own: bus errors and lost arbitration.
    faults: Vec<ScheduledFault>,
    /// The delayed end of a byte: the event that ends the wait for the clock, and the event that
    /// ends the byte.
    delayed: Option<(EventId, EventId)>,
    /// START and STOP that wait for the lines.
    waiting: u64,
    /// True if the byte on the wire is an address.
    is_addressing: bool,
    /// The direction of the transfer, from the last address.
    is_reading: bool,
    /// The byte that is sent.
    sent: u8,
    /// True if SDA was high at the last check.
    was_data_high: bool,
    /// The byte after one that was not acknowledged.
    trailing: TrailingByte,
    /// The event at which the STOP on the lines is over.
    stopping: Option<EventId>,
    /// START and STOP as CR1 last read back.
    requested: u64,
    /// True if a write of CR1 came while one of them was set.
    is_stuck: bool,
    /// The bytes of the released bus that wait to be read: in DR, and behind it.
    released: u8,
    /// True if a byte of the sensor is in DR, in front of these.
    is_behind: bool,
    /// True if one of the errors of this layer interrupts.
    interrupts: bool,
    checks: Checks,
    /// SR1 as the core has read it last.
    seen: u64,
    /// The clock of APB1, Hz; zero while the port has none.
    clock_hz: u64,
    /// True if the port was enabled before the present write.
    was_enabled: bool,
    /// True if a START takes its time: that of the first one, or of a repeated one.
    pub start_takes_time: bool,
    /// True if the port waits for STOP for a period after a byte that it did not acknowledge.
    pub waits_for_stop: bool,
    /// True if a device has acknowledged that it is written to, and waits for the next byte.
    is_written: bool,
    /// The event at which the START on the lines is over.
    starting: Option<EventId>,
}

impl WiredI2c {
    /// The controller on these wires with these faults.
    #[must_use]
    pub fn new(model: I2c, wires: SharedWires, faults: &[Fault], checks: Checks) -> Self {
        let is_own = |fault: &&ScheduledFault| {
            matches!(
                fault.kind,
                FaultKind::BusError(_) | FaultKind::ArbitrationLost
            )
        };
        Self {
            model,
            items_left: None,
            is_connected: false,
            wires,
            faults: scheduled(faults).filter(is_own).copied().collect(),
            delayed: None,
            waiting: 0,
            is_addressing: false,
            is_reading: false,
            sent: 0,
            was_data_high: true,
            trailing: TrailingByte::Nothing,
            stopping: None,
            requested: 0,
            is_stuck: false,
            released: 0,
            is_behind: false,
            interrupts: false,
            checks,
            seen: 0,
            clock_hz: 0,
            was_enabled: false,
            start_takes_time: false,
            waits_for_stop: true,
            is_written: false,
            starting: None,
        }
    }

    /// The lines may have changed: BUSY, and what waits for them.
    pub fn follow_lines(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let is_data_high = !self.is_low(BusLine::Data, context);
        let is_clock_high = !self.is_low(BusLine::Clock, context);
        let is_risen = is_data_high && !self.was_data_high;
        self.was_data_high = is_data_high;
        if self.is_connected {
            let status = registers.get(Register::Sr2);
            if !is_data_high || !is_clock_high {
                registers.set(Register::Sr2, sr2::BUSY.set(status, 1));
            } else if is_risen && !sr2::MSL.is_set(status) {
                registers.set(Register::Sr2, sr2::BUSY.set(status, 0));
            }
        }
        let is_byte_on_wire = matches!(self.trailing, TrailingByte::OnWire(_));
        let is_free = !is_byte_on_wire && self.starting.is_none();
        if is_data_high && is_clock_high && self.waiting != 0 && is_free {
            self.trailing = TrailingByte::Nothing;
            let waiting = std::mem::take(&mut self.waiting);
            let was_controller = sr2::MSL.is_set(registers.get(Register::Sr2));
            let control = registers.get(Register::Cr1) & !waiting;
            registers.set(Register::Cr1, control);
            Device::write(&mut self.model, Register::Cr1, control, registers, context);
            if cr1::PE.is_set(control) {
                self.pass_control(control | waiting, registers, context);
            }
            self.follow_requests(was_controller, registers, context);
            self.refresh_errors(registers, context);
        }
    }

    /// Returns the present step of the bus.
    pub fn step(&mut self, registers: &RegisterFile) -> BusStep {
        let is_controller = sr2::MSL.is_set(registers.get(Register::Sr2));
        let is_starting = cr1::START.is_set(registers.get(Register::Cr1))
            || sr1::SB.is_set(registers.get(Register::Sr1));
        let delivered = self
            .model
            .chip_mut::<BusDevices>(0)
            .map_or(0, |sensor| sensor.delivered());
        match (self.is_addressing, self.is_reading) {
            _ if is_starting && !self.is_addressing => BusStep::Start,
            _ if !is_controller => BusStep::Idle,
            (true, false) => BusStep::AddressWrite,
            (true, true) => BusStep::AddressRead,
            (false, false) => BusStep::Written,
            (false, true) => {
                let next = u8::try_from(delivered + 1).unwrap_or(u8::MAX);
                BusStep::Read(next.min(BusStep::LAST_BYTE))
            }
        }
    }

    fn is_low(&self, line: BusLine, context: &DeviceContext<'_>) -> bool {
        self.wires.lock().holds_low(line, context.now().0)
    }

    fn lasts(&self, kind: FaultKind, context: &DeviceContext<'_>) -> bool {
        self.faults
            .iter()
            .any(|fault| fault.kind == kind && fault.lasts(context.now().0))
    }

    /// Holds a STOP that the model has made on the lines for its time, and notes the requests that
    /// CR1 shows. `was_controller` is MSL before.
    fn follow_requests(
        &mut self,
        was_controller: bool,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let (control, status) = (registers.get(Register::Cr1), registers.get(Register::Sr2));
        let has_stopped = was_controller
            && !sr2::MSL.is_set(status)
            && !sr2::BUSY.is_set(status)
            && cr1::PE.is_set(control);
        if has_stopped && !self.is_stuck {
            let end_ns = context.now().0 + Self::period_ns(registers);
            self.stopping = Some(context.schedule(VirtualNanos(end_ns)));
        }
        if self.stopping.is_some() {
            registers.set(Register::Cr1, cr1::STOP.set(control, 1));
            registers.set(Register::Sr2, sr2::BUSY.set(status, 1));
        }
        let requests = cr1::START.mask() | cr1::STOP.mask();
        self.requested = registers.get(Register::Cr1) & requests;
    }

    /// Ends a STOP on the lines. Returns false if the event is another.
    fn end_stop(&mut self, event: EventId, registers: &mut RegisterFile) -> bool {
        if self.stopping != Some(event) {
            return false;
        }
        if !self.is_stuck {
            self.stopping = None;
            let (control, status) = (registers.get(Register::Cr1), registers.get(Register::Sr2));
            registers.set(Register::Cr1, cr1::STOP.set(control, 0));
            registers.set(Register::Sr2, sr2::BUSY.set(status, 0));
        }
        true
    }

    /// Passes a value of CR1 to the model, without the bits that the model would misunderstand.
    fn pass_control(
        &mut self,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let is_controller = sr2::MSL.is_set(registers.get(Register::Sr2));
        let value = if is_controller || cr1::START.is_set(value) {
            value
        } else {
            cr1::STOP.set(value, 0)
        };
        registers.set(Register::Cr1, value);
        Device::write(&mut self.model, Register::Cr1, value, registers, context);
    }

    fn write_control(
        &mut self,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let is_reset = cr1::SWRST.is_set(value);
        if is_reset {
            self.is_stuck = false;
            self.stopping = None;
        } else if self.is_stuck || self.requested != 0 {
            self.is_stuck = true;
            self.waiting = 0;
            registers.set(Register::Cr1, value | self.requested);
            return;
        }
        if is_reset || !cr1::PE.is_set(value) {
            self.waiting = 0;
            self.starting = None;
            self.delayed = None;
            self.drop_released(registers);
            Device::write(&mut self.model, Register::Cr1, value, registers, context);
            if !is_reset {
                let status = registers.get(Register::Sr1);
                registers.set(Register::Sr1, sr1::BERR.set(sr1::ARLO.set(status, 0), 0));
            }
            return;
        }
        let asked = value & (cr1::START.mask() | cr1::STOP.mask());
        let is_byte_on_wire = matches!(self.trailing, TrailingByte::OnWire(_));
        if self.start_takes_time && cr1::START.is_set(value) {
            let is_controller = sr2::MSL.is_set(registers.get(Register::Sr2));
            let takes_ns = if is_controller {
                NEXT_START_NS
            } else {
                FIRST_START_NS
            };
            let end_ns = context.now().0 + takes_ns;
            self.starting = Some(context.schedule(VirtualNanos(end_ns)));
        }
        let is_held = is_byte_on_wire
            || self.starting.is_some()
            || self.is_low(BusLine::Clock, context)
            || self.is_low(BusLine::Data, context);
        if asked != 0 && !is_held {
            self.trailing = TrailingByte::Nothing;
        }
        if asked != 0 && is_held && self.is_connected {
            self.waiting = asked;
            let passed = value & !asked;
            registers.set(Register::Cr1, passed);
            Device::write(&mut self.model, Register::Cr1, passed, registers, context);
            registers.set(Register::Cr1, passed | asked);
        } else {
            self.waiting = 0;
            self.pass_control(value, registers, context);
        }
    }

    /// The arbitration is lost: the controller lets go of the lines and is one no longer.
    fn lose_arbitration(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        let control = registers.get(Register::Cr1);
        let kept = control & !(cr1::START.mask() | cr1::STOP.mask());
        // PE = 0 is how the model ends a transfer without a STOP; BUSY stays.
        for value in [kept & !cr1::PE.mask(), kept] {
            registers.set(Register::Cr1, value);
            Device::write(&mut self.model, Register::Cr1, value, registers, context);
        }
        self.waiting = 0;
        self.delayed = None;
        let status = registers.get(Register::Sr1);
        registers.set(Register::Sr1, sr1::ARLO.set(status, 1));
    }

    /// A byte has crossed the wire.
    fn byte_ends(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let now_ns = context.now().0;
        let free_ns = {
            let mut wires = self.wires.lock();
            wires.byte_ends(now_ns);
            wires.clock_free_ns(now_ns)
        };
        if let Some(free_ns) = free_ns {
            let wait = context.schedule(VirtualNanos(free_ns.saturating_add(REST_OF_BYTE_NS)));
            self.delayed = Some((wait, event));
            return;
        }
        let is_sending = self.is_addressing || !self.is_reading;
        let is_pulled =
            self.is_low(BusLine::Data, context) || self.lasts(FaultKind::ArbitrationLost, context);
        if is_sending && is_pulled && self.sent != 0 {
            self.is_addressing = false;
            self.lose_arbitration(registers, context);
            return;
        }
        let has_stop = self.lasts(FaultKind::BusError(false), context);
        if has_stop || self.lasts(FaultKind::BusError(true), context) {
            let status = registers.get(Register::Sr1);
            registers.set(Register::Sr1, sr1::BERR.set(status, 1));
            if has_stop && let Some(sensor) = self.model.chip_mut::<BusDevices>(0) {
                sensor.receive_stop(now_ns);
            }
        }
        let control = registers.get(Register::Cr2);
        let is_last =
            cr2::LAST.is_set(control) && cr2::DMAEN.is_set(control) && self.items_left == Some(1);
        let acknowledge = cr1::ACK.mask();
        let before = registers.get(Register::Cr1);
        if is_last {
            registers.set(Register::Cr1, before & !acknowledge);
        }
        self.is_addressing = false;
        Device::on_event(&mut self.model, event, registers, context);
        if is_last {
            registers.restore(Register::Cr1, acknowledge, before);
            let wait_ns = if self.waits_for_stop {
                Self::period_ns(registers)
            } else {
                0
            };
            let due_ns = now_ns + wait_ns;
            self.trailing = TrailingByte::Due(context.schedule(VirtualNanos(due_ns)));
        }
    }

    /// Drives the error interrupt for the errors that the model does not know.
    fn refresh_errors(&mut self, registers: &RegisterFile, context: &mut DeviceContext<'_>) {
        let status = registers.get(Register::Sr1);
        let is_enabled = cr2::ITERREN.is_set(registers.get(Register::Cr2));
        let interrupts = is_enabled && (sr1::BERR.is_set(status) || sr1::ARLO.is_set(status));
        if interrupts {
            context.interrupt(ERROR_INTERRUPT, Level::High);
        } else if self.interrupts {
            let is_refused = is_enabled && sr1::AF.is_set(status);
            context.interrupt(ERROR_INTERRUPT, Level::from(is_refused));
        }
        self.interrupts = interrupts;
    }
}

impl Device for WiredI2c {
    type Register = Register;

    delegate!(layout peek on_request on_access on_refused);

    fn on_clock(&mut self, hz: u64, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        self.clock_hz = hz;
        Device::on_clock(&mut self.model, hz, registers, context);
    }

    fn read(
        &mut self,
        register: Register,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        self.follow_lines(registers, context);
        if register == Register::Sr2 {
            self.check_seen(sr1::ADDR, Rule::AddressSeen, registers);
        }
        let released = match register {
            Register::Dr => self.read_released(registers, context),
            _ => None,
        };
        let value =
            released.or_else(|| Device::read(&mut self.model, register, registers, context));
        self.refresh_errors(registers, context);
        if register == Register::Sr1 {
            self.seen = value.unwrap_or_else(|| registers.get(Register::Sr1));
        }
        value
    }

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let was_controller = sr2::MSL.is_set(registers.get(Register::Sr2));
        self.follow_lines(registers, context);
        if register == Register::Cr1 {
            self.check_clock(cr1::PE.is_set(value), registers);
        }
        match register {
            Register::Cr1 => self.write_control(value, registers, context),
            Register::Dr => {
                self.check_seen(sr1::SB, Rule::StartSeen, registers);
                // A write of DR clears RXNE and BTF (27.6.6).
                self.drop_released(registers);
                self.sent = value.to_le_bytes()[0];
                if sr1::SB.is_set(registers.get(Register::Sr1)) {
                    self.is_addressing = true;
                    self.is_reading = self.sent & 1 == 1;
                }
                Device::write(&mut self.model, register, value, registers, context);
            }
            _ => Device::write(&mut self.model, register, value, registers, context),
        }
        self.follow_lines(registers, context);
        self.follow_requests(was_controller, registers, context);
        self.refresh_errors(registers, context);
        self.is_written = self.step(registers) == BusStep::Written;
    }

    fn on_event(
        &mut self,
        event: EventId,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let was_controller = sr2::MSL.is_set(registers.get(Register::Sr2));
        match self.delayed {
            _ if self.starting == Some(event) => self.starting = None,
            Some((wait, byte)) if wait == event => {
                self.delayed = None;
                self.byte_ends(byte, registers, context);
            }
            _ => {
                if !self.end_stop(event, registers) && !self.clock_on(event, registers, context) {
                    self.byte_ends(event, registers, context);
                }
            }
        }
        self.follow_lines(registers, context);
        self.follow_requests(was_controller, registers, context);
        self.refresh_errors(registers, context);
        self.is_written = self.step(registers) == BusStep::Written;
    }

    fn reset(&mut self) {
        Device::reset(&mut self.model);
        self.forget();
    }

    fn reset_line(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        Device::reset_line(&mut self.model, registers, context);
        self.forget();
    }
}

impl WiredI2c {
    /// Checks that the core has seen a flag of SR1, if it is set.
    fn check_seen(&self, flag: &FieldSpec, rule: Rule, registers: &RegisterFile) {
        if flag.is_set(registers.get(Register::Sr1)) && !flag.is_set(self.seen) {
            self.checks.note(rule);
        }
    }

    /// Checks the port's clocks when it is enabled: SCL is at most 400 kHz, and the rise time that
    /// of the mode, 300 ns or 1,000 ns.
    fn check_clock(&mut self, is_enabled: bool, registers: &RegisterFile) {
        let was_enabled = std::mem::replace(&mut self.was_enabled, is_enabled);
        if was_enabled || !is_enabled {
            return;
        }
        let clock_mhz = cr2::FREQ.get(registers.get(Register::Cr2));
        let is_fast = ccr::F_S.is_set(registers.get(Register::Ccr));
        let (shortest_ns, rise_ns) = if is_fast {
            (2_500, 300)
        } else {
            (10_000, 1_000)
        };
        let fits = clock_mhz * 1_000_000 == self.clock_hz
            && clock_mhz > 0
            && Self::period_ns(registers) >= shortest_ns
            && registers.get(Register::Trise) == clock_mhz * rise_ns / 1_000 + 1;
        if !fits {
            self.checks.note(Rule::PortClock);
        }
    }

    /// Resets this layer.
    pub fn forget(&mut self) {
        self.delayed = None;
        self.waiting = 0;
        self.is_addressing = false;
        self.is_reading = false;
        self.trailing = TrailingByte::Nothing;
        self.stopping = None;
        self.requested = 0;
        self.is_stuck = false;
        self.released = 0;
        self.is_behind = false;
        self.interrupts = false;
        self.seen = 0;
        self.starting = None;
        self.was_enabled = false;
        if std::mem::take(&mut self.is_written) {
            // The device does not see the reset: it waits for the rest of the byte.
            self.wires.lock().leave_write();
        }
    }
}
