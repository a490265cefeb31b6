//! USART2's transmitter on PA2, fed by DMA1 stream 6: a buffer goes out while the core does something else.

use core::sync::atomic::{Ordering, compiler_fence};

use stm32f4xx_hal::pac::{DMA1, USART2};

use super::boards::BOARD;
use super::clocks;

/// The longest text that goes out at once.
pub const CAPACITY: usize = 512;

/// The transmitter and the buffer that its DMA reads.
pub struct Uart {
    port: USART2,
    buffer: &'static mut [u8; CAPACITY],
}

impl Uart {
    /// Sets the port up at `baud`, 8N1. The pin is the caller's to switch to its alternate function 7.
    pub fn start(port: USART2, baud: u32, buffer: &'static mut [u8; CAPACITY]) -> Self {
        clocks::enable(|rcc| {
            rcc.apb1enr().modify(|_, w| w.usart2en().set_bit());
            rcc.ahb1enr().modify(|_, w| w.dma1en().set_bit());
        });
        // With 16-fold oversampling the register holds the divider in sixteenths (RM0090, 30.3.4).
        let divider = (BOARD.peripheral_hz + baud / 2) / baud;
        // SAFETY: every 16-bit value is a valid divider.
        port.brr().write(|w| unsafe { w.bits(divider as u16) });
        port.cr3().write(|w| w.dmat().set_bit());
        port.cr1().write(|w| w.ue().set_bit().te().set_bit());
        let stream = dma1().st(6);
        // SAFETY: the data register's address, as the manual asks (RM0090, 10.3.17).
        stream
            .par()
            .write(|w| unsafe { w.pa().bits(port.dr().as_ptr() as u32) });
        Self { port, buffer }
    }

    /// The buffer to write the next text into, or nothing while the last one is still going out.
    pub fn idle_buffer(&mut self) -> Option<&mut [u8; CAPACITY]> {
        if dma1().st(6).cr().read().en().bit_is_set() {
            return None;
        }
        compiler_fence(Ordering::Acquire);
        Some(self.buffer)
    }

    /// Sends the first `length` bytes of the buffer. Does nothing while the last text is still going out.
    pub fn send(&mut self, length: usize) {
        let stream = dma1().st(6);
        if length == 0 || length > CAPACITY || stream.cr().read().en().bit_is_set() {
            return;
        }
        compiler_fence(Ordering::Release);
        self.port.sr().write(|w| w.tc().clear_bit());
        // The flags of the last transfer would keep the stream from starting (RM0090, 10.3.17).
        dma1().hifcr().write(|w| {
            w.ctcif6()
                .set_bit()
                .chtif6()
                .set_bit()
                .cteif6()
                .set_bit()
                .cdmeif6()
                .set_bit()
                .cfeif6()
                .set_bit()
        });
        // SAFETY: the buffer lives for ever, and `idle_buffer` does not lend it before the stream is off.
        stream
            .m0ar()
            .write(|w| unsafe { w.m0a().bits(self.buffer.as_ptr() as u32) });
        stream.ndtr().write(|w| w.ndt().set(length as u16));
        stream.cr().write(|w| {
            w.chsel()
                .set(4)
                .dir()
                .memory_to_peripheral()
                .minc()
                .set_bit()
                .en()
                .set_bit()
        });
    }
}

fn dma1() -> &'static stm32f4xx_hal::pac::dma1::RegisterBlock {
    // SAFETY: this file writes stream 6 and its bits of the clear register alone, and the clear
    // registers ignore zeros, so it never disturbs the burst reader's stream 0.
    unsafe { &*DMA1::ptr() }
}
