//! Counts instructions in QEMU: with `-icount shift=0` each takes one nanosecond, and TIM2 ticks at
//! 1 GHz there.

use stm32f4xx_hal::pac::{RCC, TIM2};

/// TIM2 as a free-running counter.
pub struct InstructionCounter {
    timer: TIM2,
}

impl InstructionCounter {
    /// Starts the timer.
    pub fn new(timer: TIM2, rcc: &RCC) -> Self {
        rcc.apb1enr().modify(|_, w| w.tim2en().enabled());
        timer.psc().write(|w| w.psc().set(0));
        timer.arr().write(|w| w.arr().set(u32::MAX));
        // QEMU takes prescaler and period over at an update event only.
        timer.egr().write(|w| w.ug().update());
        timer.cr1().write(|w| w.cen().enabled());
        Self { timer }
    }

    /// Returns the count of instructions; it wraps after 4.29 s.
    pub fn now(&self) -> u32 {
        self.timer.cnt().read().cnt().bits()
    }
}
