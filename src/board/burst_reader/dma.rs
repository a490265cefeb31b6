//! DMA1 stream 0, which moves the sensor's bytes from the I2C port to memory.

use stm32f4xx_hal::pac::{DMA1, I2C1, dma1};

use super::super::clocks;

/// Polls of the stream's status after which it must have stopped.
const STOP_POLLS: u32 = 1_000;

/// Sets the stream's source. Called once, by init.
pub(super) fn start() {
    // This clock also runs while the core sleeps, by its bit in AHB1LPENR after reset. With
    // DBG_SLEEP set and no DMA clock in sleep, a core that wakes may run wrong code (errata sheet
    // ES0182, 2.1.3).
    clocks::enable(|rcc| {
        rcc.ahb1enr().modify(|_, w| w.dma1en().set_bit());
    });
    // SAFETY: the address of the I2C data register, as the manual requires (RM0090, 10.3.17).
    stream().par().write(|w| unsafe {
        let data = (*I2C1::ptr()).dr().as_ptr();
        w.pa().bits(data as u32)
    });
}

/// Prepares a transfer of `length` bytes to this address, whose memory must belong to the reader.
/// The stream must have stopped, as it does at the end of a transfer.
#[inline(always)]
pub(super) fn prepare(address: u32, length: u16) {
    let stream = stream();
    // SAFETY: the callers own the memory at this address until the transfer is complete.
    stream.m0ar().write(|w| unsafe { w.m0a().bits(address) });
    stream.ndtr().write(|w| w.ndt().set(length));
}

/// Starts the prepared transfer, with the I2C port's first request.
#[inline(always)]
pub(super) fn enable() {
    stream().cr().write(|w| {
        w.chsel()
            .set(1)
            .pl()
            .very_high()
            .minc()
            .set_bit()
            .tcie()
            .set_bit()
            .teie()
            .set_bit()
            .en()
            .set_bit()
    });
}

/// Returns whether the transfer is complete. Clears the stream's flags.
#[inline(always)]
pub(super) fn take_complete() -> bool {
    let is_complete = dma1().lisr().read().tcif0().bit();
    clear_flags();
    is_complete
}

/// Stops the stream, if it is enabled, and clears its flags.
#[cold]
#[inline(never)]
pub(super) fn stop() {
    let stream = stream();
    stream.cr().reset();
    // The stream ends with the byte in flight (RM0090, 10.3, DMA transfer suspension), well within
    // the polls.
    for _ in 0..STOP_POLLS {
        if stream.cr().read().en().bit_is_clear() {
            break;
        }
    }
    clear_flags();
}

#[inline(always)]
fn clear_flags() {
    dma1().lifcr().write(|w| {
        w.ctcif0()
            .set_bit()
            .chtif0()
            .set_bit()
            .cteif0()
            .set_bit()
            .cdmeif0()
            .set_bit()
            .cfeif0()
            .set_bit()
    });
}

#[inline(always)]
fn stream() -> &'static dma1::ST {
    dma1().st(0)
}

#[inline(always)]
fn dma1() -> &'static dma1::RegisterBlock {
    // SAFETY: only this file writes stream 0 and its bits of the clear register. The clear
    // registers ignore zeros, so the UART's streams are never disturbed.
    unsafe { &*DMA1::ptr() }
}
