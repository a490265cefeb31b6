//! Sensor bus as an embedded-hal `I2c` with a deadline on every wait, and its recovery.
//!
//! The idle task configures the sensor through this bus while the burst reader is disabled, and
//! never uses it otherwise. The HAL's blocking I2C waits without limits, so a bus held low would
//! hang the task. Multi-byte reads follow the stretching method of RM0090, 27.3.3 ("Closing the
//! communication"), which stays correct for any delay of a step by an interrupt.
//!
//! No write of CR1 comes while a START or STOP is pending. The port would keep the bit pending
//! until its reset (RM0090, 27.6.1, note on STOP and START).

use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};
use stm32f4xx_hal::pac::{GPIOB, I2C1, i2c1};

use super::boards::BOARD;
use super::clocks;
use super::retained;
use super::timebase;
use crate::fault::FaultClass;

/// Longest wait for one bus event, in microseconds. A byte takes 22 µs, and the sensor never
/// stretches the clock.
const STEP_DEADLINE_US: u32 = 2_000;
/// Half a clock period during the bus recovery, in microseconds: 100 kHz.
const RECOVERY_HALF_PERIOD_US: u32 = 5;
/// Clock pulses of a recovery: a device may hold SDA low for the rest of a byte and its acknowledge
/// (UM10204, 3.1.16).
const RECOVERY_CLOCKS: u32 = 9;
/// Pins: PB8 is SCL, PB9 is SDA.
const SCL: u8 = 8;
const SDA: u8 = 9;

/// Input clock of the port in MHz.
const CLOCK_MHZ: u8 = (BOARD.apb1_hz / 1_000_000) as u8;

/// Sets the field of CR2 with the port's input clock (RM0090, 27.6.2). Every write of CR2 needs it.
pub fn with_clock(w: &mut i2c1::cr2::W) -> &mut i2c1::cr2::W {
    const { assert!(CLOCK_MHZ >= 4 && CLOCK_MHZ <= 50) };
    // SAFETY: the manual allows 2 to 50 MHz, and 4 MHz or more for fast mode.
    unsafe { w.freq().bits(CLOCK_MHZ) }
}

/// I2C1 on PB8 and PB9 at 400 kHz, fast mode.
pub struct SensorBus {
    _port: I2C1,
    _pins: GPIOB,
}

/// Error of a bus that stays low after its recovery: SCL or SDA is shorted, unpowered or not
/// connected.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BusHeldLow {
    /// True if SCL is low; false if SDA is low.
    pub clock: bool,
}

impl SensorBus {
    /// Takes the port and its pins. [`SensorBus::recover`] makes the bus usable.
    pub fn new(port: I2C1, pins: GPIOB) -> Self {
        clocks::enable(|rcc| {
            rcc.ahb1enr().modify(|_, w| w.gpioben().set_bit());
            rcc.apb1enr().modify(|_, w| w.i2c1en().set_bit());
        });
        Self {
            _port: port,
            _pins: pins,
        }
    }

    /// Frees the bus from a sensor that was interrupted half-way through a byte, then resets and
    /// programs the port.
    ///
    /// # Errors
    ///
    /// Returns an error if a line is still low. Then the wiring or the supply is at fault, and no
    /// clocking helps.
    pub fn recover(&mut self) -> Result<(), BusHeldLow> {
        // High before the pins become outputs, so that no edge comes of it.
        self.drive(SCL, true);
        self.drive(SDA, true);
        self.set_pin_modes(PinMode::Output);
        wait_us(RECOVERY_HALF_PERIOD_US);
        // A START as soon as SDA is high: a sensor that was being written to would take the clocks
        // for a byte of ones. Always nine clocks, because a clone may be in a byte all the same.
        let mut has_started = false;
        for _ in 0..RECOVERY_CLOCKS {
            if !has_started && levels().1 {
                has_started = true;
                self.drive(SDA, false);
                wait_us(RECOVERY_HALF_PERIOD_US);
            }
            self.drive(SCL, false);
            self.drive(SDA, true);
            wait_us(RECOVERY_HALF_PERIOD_US);
            self.drive(SCL, true);
            wait_us(RECOVERY_HALF_PERIOD_US);
        }
        // START and STOP: SDA falls and rises while SCL is high.
        self.drive(SDA, false);
        wait_us(RECOVERY_HALF_PERIOD_US);
        self.drive(SDA, true);
        wait_us(RECOVERY_HALF_PERIOD_US);
        let (clock, data) = levels();
        // Before the port's reset, which clears a BUSY flag of edges that the port sees here.
        self.set_pin_modes(PinMode::Alternate);
        self.program_port();
        if clock && data {
            Ok(())
        } else {
            Err(BusHeldLow { clock: !clock })
        }
    }

    fn program_port(&self) {
        let i2c = port();
        // The reset also clears a BUSY flag that the recovery's edges have set (RM0090, 27.6.1,
        // SWRST).
        i2c.cr1().write(|w| w.swrst().set_bit());
        i2c.cr1().reset();
        i2c.cr2().write(|w| with_clock(w));
        // SCL low:high is 16:9 if that divides to 400 kHz exactly, else 2:1 (RM0090, 27.6.8).
        let (duty, periods) = if BOARD.apb1_hz.is_multiple_of(25 * 400_000) {
            (true, 25)
        } else {
            (false, 3)
        };
        let divider = BOARD.apb1_hz.div_ceil(periods * 400_000);
        i2c.ccr()
            // SAFETY: the divider is 5 or more, far below 12 bits, for every APB1 clock from 2 to
            // 50 MHz.
            .write(|w| unsafe {
                w.f_s()
                    .set_bit()
                    .duty()
                    .bit(duty)
                    .ccr()
                    .bits(divider as u16)
            });
        // Fast mode allows a rise time of 300 ns (UM10204, table 11; RM0090, 27.6.9).
        i2c.trise().write(|w| w.trise().set(CLOCK_MHZ * 3 / 10 + 1));
        i2c.cr1().write(|w| w.pe().set_bit());
    }

    fn set_pin_modes(&self, mode: PinMode) {
        let pins = pins();
        pins.otyper()
            .modify(|_, w| w.ot8().open_drain().ot9().open_drain());
        // Edges of 100 ns instead of a few: fast mode allows 20 ns to 300 ns (UM10204, table 11).
        pins.ospeedr()
            .modify(|_, w| w.ospeedr8().low_speed().ospeedr9().low_speed());
        // The breakout boards carry the real pull-ups; these define the level of an empty
        // connector.
        pins.pupdr()
            .modify(|_, w| w.pupdr8().pull_up().pupdr9().pull_up());
        pins.afrh().modify(|_, w| w.afrh8().af4().afrh9().af4());
        pins.moder().modify(|_, w| match mode {
            PinMode::Output => w.moder8().output().moder9().output(),
            PinMode::Alternate => w.moder8().alternate().moder9().alternate(),
        });
    }

    fn drive(&self, pin: u8, high: bool) {
        pins().bsrr().write(|w| {
            if high {
                w.bs(pin).set_bit()
            } else {
                w.br(pin).set_bit()
            }
        });
    }

    fn start(&mut self, address: u8, read: bool) -> Result<(), ErrorKind> {
        let i2c = port();
        // A repeated start after a read is under way already. The write also clears POS.
        let is_started = i2c.cr1().read().start().bit() || i2c.sr1().read().sb().bit();
        if !is_started {
            i2c.cr1()
                .write(|w| w.pe().set_bit().start().set_bit().ack().set_bit());
        }
        self.wait(|status| status.sb().bit(), NoAcknowledgeSource::Address)?;
        i2c.dr()
            .write(|w| w.dr().set(address << 1 | u8::from(read)));
        self.wait(|status| status.addr().bit(), NoAcknowledgeSource::Address)
    }

    fn write_bytes(&mut self, bytes: &[u8]) -> Result<(), ErrorKind> {
        for &byte in bytes {
            self.wait(|status| status.tx_e().bit(), NoAcknowledgeSource::Data)?;
            port().dr().write(|w| w.dr().set(byte));
        }
        if bytes.is_empty() {
            return Ok(());
        }
        self.wait(|status| status.btf().bit(), NoAcknowledgeSource::Data)
    }

    /// Receives `length` bytes into `sink`, and ends with NACK; with STOP too if `stop`.
    fn read_bytes<'a>(
        &mut self,
        length: usize,
        mut bytes: impl Iterator<Item = &'a mut u8>,
        stop: bool,
    ) -> Result<(), ErrorKind> {
        let i2c = port();
        let close = || {
            if stop {
                i2c.cr1().modify(|_, w| w.stop().set_bit());
            } else {
                i2c.cr1().modify(|_, w| w.start().set_bit());
            }
        };
        let mut take = || {
            let byte = i2c.dr().read().dr().bits();
            if let Some(place) = bytes.next() {
                *place = byte;
            }
        };
        match length {
            0 => {
                i2c.sr2().read();
                close();
            }
            1 => {
                i2c.cr1().modify(|_, w| w.ack().clear_bit());
                i2c.sr2().read();
                close();
                self.wait(|status| status.rx_ne().bit(), NoAcknowledgeSource::Data)?;
                take();
            }
            2 => {
                i2c.cr1().modify(|_, w| w.ack().clear_bit().pos().set_bit());
                i2c.sr2().read();
                self.wait(|status| status.btf().bit(), NoAcknowledgeSource::Data)?;
                close();
                take();
                take();
                // The next start clears POS: STOP or START is pending here.
            }
            _ => {
                i2c.sr2().read();
                for _ in 3..length {
                    self.wait(|status| status.btf().bit(), NoAcknowledgeSource::Data)?;
                    take();
                }
                self.wait(|status| status.btf().bit(), NoAcknowledgeSource::Data)?;
                i2c.cr1().modify(|_, w| w.ack().clear_bit());
                take();
                self.wait(|status| status.btf().bit(), NoAcknowledgeSource::Data)?;
                close();
                take();
                take();
            }
        }
        Ok(())
    }

    /// Waits for an event, an error, or the deadline.
    fn wait(
        &self,
        event: impl Fn(&i2c1::sr1::R) -> bool,
        source: NoAcknowledgeSource,
    ) -> Result<(), ErrorKind> {
        let start = timebase::now();
        loop {
            // Before the status: after a stall of the core, an event that came in time counts.
            let is_late = timebase::elapsed(start, STEP_DEADLINE_US);
            let status = port().sr1().read();
            if status.berr().bit() {
                // The chip flags bus errors that are none (errata). After a real one an event is
                // missing, or the sensor acknowledges nothing more.
                port().sr1().reset();
                retained::count(FaultClass::BusError);
            }
            let error = if status.af().bit() {
                Some(ErrorKind::NoAcknowledge(source))
            } else if status.arlo().bit() {
                Some(ErrorKind::ArbitrationLoss)
            } else if status.ovr().bit() {
                Some(ErrorKind::Overrun)
            } else if event(&status) {
                return Ok(());
            } else if is_late {
                Some(ErrorKind::Other)
            } else {
                None
            };
            if let Some(error) = error {
                // The error flags are cleared by writing zero; the other flags ignore writes.
                port().sr1().reset();
                if port().cr1().read().start().bit_is_clear() {
                    port().cr1().modify(|_, w| w.stop().set_bit());
                }
                return Err(error);
            }
        }
    }

    fn wait_until_free(&self) -> Result<(), ErrorKind> {
        let start = timebase::now();
        loop {
            let is_late = timebase::elapsed(start, STEP_DEADLINE_US);
            // A transaction that was given up may have left ADDR set. Reading SR1 and then SR2
            // clears it (RM0090, 27.6.7).
            port().sr1().read();
            let is_busy = port().sr2().read().busy().bit();
            if !is_busy && port().cr1().read().stop().bit_is_clear() {
                return Ok(());
            }
            if is_late {
                return Err(ErrorKind::Bus);
            }
        }
    }
}

impl ErrorType for SensorBus {
    type Error = ErrorKind;
}

impl I2c for SensorBus {
    /// Error of the bus; `ErrorKind::Other` is a missed deadline.
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        self.wait_until_free()?;
        let mut rest = operations;
        // Adjacent operations of one kind are one transfer, as the trait requires.
        while let Some(first) = rest.first() {
            let reads = matches!(first, Operation::Read(_));
            let run = rest
                .iter()
                .take_while(|operation| matches!(operation, Operation::Read(_)) == reads)
                .count();
            // The run is a part of the rest, so the split never fails.
            let Some((these, others)) = rest.split_at_mut_checked(run) else {
                return Ok(());
            };
            let last = others.is_empty();
            self.start(address, reads)?;
            if reads {
                let length = these.iter().map(operation_length).sum();
                let bytes = these.iter_mut().flat_map(|operation| match operation {
                    Operation::Read(buffer) => buffer.iter_mut(),
                    Operation::Write(_) => [].iter_mut(),
                });
                self.read_bytes(length, bytes, last)?;
            } else {
                port().sr2().read();
                for operation in these {
                    if let Operation::Write(bytes) = operation {
                        self.write_bytes(bytes)?;
                    }
                }
                if last {
                    port().cr1().modify(|_, w| w.stop().set_bit());
                }
            }
            rest = others;
        }
        Ok(())
    }
}

enum PinMode {
    Output,
    Alternate,
}

fn operation_length(operation: &Operation<'_>) -> usize {
    match operation {
        Operation::Read(buffer) => buffer.len(),
        Operation::Write(bytes) => bytes.len(),
    }
}

#[inline(never)]
fn wait_us(microseconds: u32) {
    let start = timebase::now();
    while !timebase::elapsed(start, microseconds + 1) {}
}

/// Returns the levels of SCL and SDA: true if high.
#[inline(never)]
pub(super) fn levels() -> (bool, bool) {
    let levels = pins().idr().read();
    (levels.idr(SCL).bit(), levels.idr(SDA).bit())
}

fn port() -> &'static i2c1::RegisterBlock {
    // SAFETY: the burst reader is disabled while the idle task uses this bus, and owns it
    // otherwise.
    unsafe { &*I2C1::ptr() }
}

fn pins() -> &'static stm32f4xx_hal::pac::gpiob::RegisterBlock {
    // SAFETY: `SensorBus` owns port B; nothing else uses its registers.
    unsafe { &*GPIOB::ptr() }
}
