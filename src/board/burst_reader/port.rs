//! Registers of the I2C port that more than one step of a burst writes.

use stm32f4xx_hal::pac::{I2C1, i2c1};

use super::super::sensor_bus::{self, with_clock};
use super::super::timebase;

/// Time that the port itself holds a line low at most, in µs: an acknowledge and the STOP after
/// it, at 400 kHz, and some for the rising edges.
const LONGEST_LOW_US: u32 = 8;

/// Enables the interrupts of the port, and disables its DMA requests.
#[inline(always)]
pub(super) fn enable_event_interrupts() {
    i2c1()
        .cr2()
        .write(|w| with_clock(w).itevten().set_bit().iterren().set_bit());
}

/// Masks the events while a flag is set that the present step does not clear. Otherwise the
/// interrupt would repeat, and the alarm never run. The alarm ends the burst, and a failed burst
/// enables the events again.
#[cold]
#[inline(never)]
pub(super) fn mask_unexpected_event() {
    let i2c = i2c1();
    let status = i2c.sr1().read();
    let is_flagged = status.sb().bit() || status.addr().bit() || status.btf().bit();
    if is_flagged || status.add10().bit() || status.stopf().bit() {
        i2c.cr2().write(|w| with_clock(w).iterren().set_bit());
    }
}

#[inline(always)]
pub(super) fn send_stop() {
    i2c1()
        .cr1()
        .write(|w| w.pe().set_bit().ack().set_bit().stop().set_bit());
}

/// Returns whether something holds the bus after a burst: its STOP is still pending, and a line
/// stays low. The sensor may then have lost the clock within the burst, and the bytes after that
/// are false. Only the attitude task calls this, before it publishes: no other transaction is under
/// way then.
#[inline(always)]
pub fn is_bus_held() -> bool {
    i2c1().cr1().read().stop().bit_is_set() && stays_low()
}

/// Returns whether SCL or SDA stays low. A late STOP also waits for the byte that the port has
/// begun to clock; the lines go high within that one.
#[cold]
#[inline(never)]
fn stays_low() -> bool {
    let since = timebase::now();
    let mut was_high = (false, false);
    loop {
        // Before the lines are read: an interrupt may come in between.
        let is_late = timebase::elapsed(since, LONGEST_LOW_US);
        let (clock, data) = sensor_bus::levels();
        was_high = (was_high.0 | clock, was_high.1 | data);
        if is_late || was_high == (true, true) {
            return was_high != (true, true);
        }
    }
}

pub(super) fn i2c1() -> &'static i2c1::RegisterBlock {
    // SAFETY: while the reader is enabled it alone uses the bus; see `sensor_bus` for the rest of
    // the time.
    unsafe { &*I2C1::ptr() }
}
