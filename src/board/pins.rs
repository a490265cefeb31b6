//! Port A: the sensor's INT pin, for interrupt and capture, and the UART's pins.

use stm32f4xx_hal::pac::{EXTI, GPIOA, SYSCFG};

use super::clocks;

/// Connects PA1 to EXTI1 and to TIM5's channel 2, PA2 and PA3 to USART2. The interrupt line stays
/// masked.
pub fn start(port: GPIOA, routing: SYSCFG, lines: EXTI) {
    clocks::enable(|rcc| {
        rcc.ahb1enr().modify(|_, w| w.gpioaen().set_bit());
        rcc.apb2enr().modify(|_, w| w.syscfgen().set_bit());
    });
    port.afrl()
        .modify(|_, w| w.afrl1().af2().afrl2().af7().afrl3().af7());
    // An unconnected INT wire reads low instead of picking up edges; an idle UART line is high.
    port.pupdr()
        .modify(|_, w| w.pupdr1().pull_down().pupdr3().pull_up());
    // The pin's input feeds EXTI in alternate mode too (RM0090, 8.3.11 and 12.2.5).
    port.moder().modify(|_, w| {
        w.moder1()
            .alternate()
            .moder2()
            .alternate()
            .moder3()
            .alternate()
    });
    // SAFETY: 0 is port A (RM0090, 9.2.3).
    routing
        .exticr1()
        .modify(|_, w| unsafe { w.exti1().bits(0) });
    lines.imr().reset();
    lines.rtsr().write(|w| w.tr1().set_bit());
}

/// Returns whether the INT pin is high now.
pub fn interrupt_is_high() -> bool {
    // SAFETY: reading the pins has no side effect.
    unsafe { &*GPIOA::ptr() }.idr().read().idr1().bit()
}
