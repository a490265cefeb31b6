//! USART2 on PA2 and PA3, in both directions by DMA, without waits or interrupts of the core.
//!
//! DMA1 stream 6 sends a buffer. Stream 5 writes received bytes into a ring and never stops. The
//! reader finds the write position in the stream's counter. A flood of bytes at any rate costs no
//! interrupts. Bytes that are overwritten before they are read are lost; the loss is detected and
//! counted.

use core::sync::atomic::{AtomicU8, Ordering, compiler_fence};

use stm32f4xx_hal::pac::{DMA1, USART2, usart1};

use super::boards::BOARD;
use super::clocks;
use super::timebase;

/// Capacity of the transmit buffer, in bytes: the longest answer as MAVLink, 19 frames of 66 bytes.
pub const CAPACITY: usize = 1254;

/// Capacity of the ring of received bytes. At 921,600 baud the ring wraps in 22 ms, which is longer
/// than the period of the reads.
pub const RECEIVE_CAPACITY: usize = 2048;

/// Bits on the wire for a byte: start, eight data bits, stop.
const BITS_PER_BYTE: u32 = 10;

/// Error flags of the status register (RM0090, 30.6.1).
const FRAMING: u16 = 1 << 1;
const NOISE: u16 = 1 << 2;
const OVERRUN: u16 = 1 << 3;
const TRANSMISSION_COMPLETE: u16 = 1 << 6;
/// All flags of the status register.
const STATUS: u16 = 0x3FF;

/// Memory that the DMA writes.
pub type ReceiveRing = [AtomicU8; RECEIVE_CAPACITY];

/// Transmitting half, with its buffer. It owns the port's settings.
pub struct Transmitter {
    port: USART2,
    buffer: &'static mut [u8; CAPACITY],
    baud: u32,
}

/// Receiving half, with the ring that the DMA writes.
pub struct Receiver {
    ring: &'static ReceiveRing,
    /// Index of the next byte of the ring to read.
    read_at: usize,
    /// Count of the time base at the last poll.
    polled_at_us: u32,
    written_before: usize,
}

/// State of the reception since the last poll.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Reception {
    /// No error.
    Sound,
    /// Framing, noise or overrun: the bytes since the last poll are unreliable and discarded.
    Garbled,
    /// More bytes came than the ring holds; its rest is discarded.
    Lost,
}

/// Sets the port up at `baud` bits per second, 8N1. The caller switches the pins to their alternate
/// function 7.
pub fn start(
    port: USART2,
    baud: u32,
    buffer: &'static mut [u8; CAPACITY],
    ring: &'static ReceiveRing,
) -> (Transmitter, Receiver) {
    clocks::enable(|rcc| {
        rcc.apb1enr().modify(|_, w| w.usart2en().set_bit());
        rcc.ahb1enr().modify(|_, w| w.dma1en().set_bit());
    });
    set_divider(&port, baud);
    port.cr3().write(|w| w.dmat().set_bit().dmar().set_bit());
    port.cr1()
        .write(|w| w.ue().set_bit().te().set_bit().re().set_bit());
    let data = port.dr().as_ptr() as u32;
    for number in [5, 6] {
        // SAFETY: the data register's address, as the manual requires (RM0090, 10.3.17).
        dma1()
            .st(number)
            .par()
            .write(|w| unsafe { w.pa().bits(data) });
    }
    let stream = dma1().st(5);
    // SAFETY: the ring is static, and is read as atomics only.
    stream
        .m0ar()
        .write(|w| unsafe { w.m0a().bits(ring.as_ptr() as u32) });
    stream
        .ndtr()
        .write(|w| w.ndt().set(RECEIVE_CAPACITY as u16));
    stream.cr().write(|w| {
        w.chsel()
            .set(4)
            .minc()
            .set_bit()
            .circ()
            .set_bit()
            .en()
            .set_bit()
    });
    let transmitter = Transmitter { port, buffer, baud };
    let receiver = Receiver {
        ring,
        read_at: 0,
        polled_at_us: timebase::now(),
        written_before: 0,
    };
    (transmitter, receiver)
}

impl Receiver {
    /// Polls for bytes since the last poll, at this baud rate. Afterwards [`Self::receive`] returns
    /// the sound ones.
    pub fn poll(&mut self, baud: u32) -> Reception {
        let now = timebase::now();
        let elapsed_us = now.wrapping_sub(self.polled_at_us);
        self.polled_at_us = now;
        let is_garbled = usart2().sr().read().bits() & (FRAMING | NOISE | OVERRUN) != 0;
        if is_garbled {
            // After the status, reading the data clears the flags (RM0090, 30.6.1). If this takes a
            // byte from the DMA, that byte is discarded anyway.
            usart2().dr().read();
        }
        let is_complete = dma1().hisr().read().tcif5().bit();
        let written = written();
        let has_wrapped = is_complete || written < self.written_before;
        if has_wrapped {
            dma1().hifcr().write(|w| w.ctcif5().set_bit());
        }
        let lap = if has_wrapped { RECEIVE_CAPACITY } else { 0 };
        let new = lap + written - self.written_before;
        let unread = (self.written_before + RECEIVE_CAPACITY - self.read_at) % RECEIVE_CAPACITY;
        // Only the elapsed time reveals a second lap.
        let is_lost = unread + new >= RECEIVE_CAPACITY || has_wrapped && elapsed_us >= lap_us(baud);
        self.written_before = written;
        if is_garbled {
            self.read_at = written;
            Reception::Garbled
        } else if is_lost {
            self.read_at = written;
            Reception::Lost
        } else {
            Reception::Sound
        }
    }

    /// Discards the bytes received so far, at this baud rate.
    pub fn discard(&mut self, baud: u32) {
        self.poll(baud);
        self.read_at = self.written_before;
    }

    /// Returns the next byte that had arrived at the last poll.
    pub fn receive(&mut self) -> Option<u8> {
        if self.read_at == self.written_before {
            return None;
        }
        let byte = self.ring.get(self.read_at)?.load(Ordering::Relaxed);
        self.read_at = (self.read_at + 1) % RECEIVE_CAPACITY;
        Some(byte)
    }
}

impl Transmitter {
    /// Returns the baud rate, bits per second.
    pub fn baud(&self) -> u32 {
        self.baud
    }

    /// Changes the baud rate. Returns `false`, without a change, while a text is still being sent.
    pub fn set_baud(&mut self, baud: u32) -> bool {
        let is_sent = self.port.sr().read().bits() & TRANSMISSION_COMPLETE != 0;
        if self.is_sending() || !is_sent {
            return false;
        }
        set_divider(&self.port, baud);
        self.baud = baud;
        true
    }

    /// Returns whether the buffer is free.
    pub fn is_idle(&self) -> bool {
        !self.is_sending()
    }

    /// Returns the buffer for the next text, or `None` while the last one is still being sent.
    pub fn idle_buffer(&mut self) -> Option<&mut [u8; CAPACITY]> {
        if self.is_sending() {
            return None;
        }
        compiler_fence(Ordering::Acquire);
        Some(self.buffer)
    }

    /// Sends the first `length` bytes of the buffer. Does nothing while the last text is still
    /// being sent.
    pub fn send(&mut self, length: usize) {
        if length == 0 || length > CAPACITY || self.is_sending() {
            return;
        }
        let stream = dma1().st(6);
        compiler_fence(Ordering::Release);
        // SAFETY: writing zero clears a flag, and writing one has no effect (RM0090, 30.6.1).
        self.port
            .sr()
            .write(|w| unsafe { w.bits(STATUS & !TRANSMISSION_COMPLETE) });
        // The flags of the last transfer would prevent the stream's start (RM0090, 10.3.17).
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
        // SAFETY: the buffer is static, and `idle_buffer` does not lend it before the stream is
        // off.
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

    fn is_sending(&self) -> bool {
        dma1().st(6).cr().read().en().bit_is_set()
    }
}

/// Returns the time in µs in which the ring wraps at full rate.
fn lap_us(baud: u32) -> u32 {
    const BITS_PER_LAP: u32 = RECEIVE_CAPACITY as u32 * BITS_PER_BYTE;
    BITS_PER_LAP * 1_000 / (baud / 1_000).max(1)
}

fn usart2() -> &'static usart1::RegisterBlock {
    // SAFETY: the receiver only reads the status and the data, which clears error flags that the
    // transmitter does not use.
    unsafe { &*USART2::ptr() }
}

/// Returns the index in the ring of the next byte to be written.
fn written() -> usize {
    let left = usize::from(dma1().st(5).ndtr().read().ndt().bits());
    (RECEIVE_CAPACITY - left.min(RECEIVE_CAPACITY)) % RECEIVE_CAPACITY
}

fn set_divider(port: &usart1::RegisterBlock, baud: u32) {
    // With 16-fold oversampling the register holds the divider in sixteenths (RM0090, 30.3.4).
    let divider = (BOARD.apb1_hz + baud / 2) / baud.max(1);
    // SAFETY: every 16-bit value is a valid divider.
    port.brr().write(|w| unsafe { w.bits(divider as u16) });
}

fn dma1() -> &'static stm32f4xx_hal::pac::dma1::RegisterBlock {
    // SAFETY: this file writes only streams 5 and 6 and their bits of the clear registers. Those
    // ignore zeros, so the burst reader's stream 0 is never disturbed.
    unsafe { &*DMA1::ptr() }
}
