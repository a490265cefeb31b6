//! The external interrupt controller and the pin multiplexer in front of it (RM0090, sections 12.2,
//! 12.3 and 9.3).
//!
//! A pin's edge goes to the EXTI line of its number if SYSCFG_EXTICR routes its port there. The
//! line's trigger registers decide whether the edge sets the pending bit, and the mask whether the
//! pending bit interrupts the core. A masked line's pending bit is set all the same. A pending bit
//! is cleared by writing one to it.
//!
//! Not modelled: the event lines (EMR), and lines 16 to 22, which belong to other peripherals.

use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::stm32f427::generated::{exti, syscfg};

/// Lines that belong to pins.
const PIN_LINES: u64 = 0xFFFF;

/// The interrupts by their position in the part's description of the EXTI, each with the lines that
/// share it.
const INTERRUPTS: [(usize, u64); 7] = [
    (1, 1 << 0),
    (2, 1 << 1),
    (3, 1 << 2),
    (4, 1 << 3),
    (5, 1 << 4),
    (6, 0x03E0),
    (7, 0xFC00),
];

/// The controller.
#[derive(Debug, Default)]
pub struct Exti {
    pending: u64,
    /// The last level of each of [`INTERRUPTS`].
    driven: [bool; INTERRUPTS.len()],
}

impl Exti {
    /// A line's input changes: to high if `rising`, else to low.
    pub fn edge(
        &mut self,
        line: u8,
        rising: bool,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let trigger = if rising {
            exti::Register::Rtsr
        } else {
            exti::Register::Ftsr
        };
        self.pending |= registers.get(trigger) & (1 << line) & PIN_LINES;
        self.refresh(registers, context);
    }

    /// Shows the pending bits in the register and drives the interrupts.
    fn refresh(&mut self, registers: &mut RegisterFile, context: &mut DeviceContext<'_>) {
        registers.set(exti::Register::Pr, self.pending);
        let interrupting = self.pending & registers.get(exti::Register::Imr);
        for ((position, lines), driven) in INTERRUPTS.into_iter().zip(&mut self.driven) {
            let wanted = interrupting & lines != 0;
            if wanted != *driven {
                *driven = wanted;
                context.interrupt(position, Level::from(wanted));
            }
        }
    }
}

impl Device for Exti {
    type Register = exti::Register;

    fn write(
        &mut self,
        register: exti::Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        match register {
            exti::Register::Pr => {
                self.pending &= !value;
                // Clearing the pending bit clears the software trigger with it (section 12.3.5).
                registers.set(
                    exti::Register::Swier,
                    registers.get(exti::Register::Swier) & !value,
                );
            }
            exti::Register::Swier => self.pending |= value & PIN_LINES,
            _ => {}
        }
        self.refresh(registers, context);
    }

    fn reset(&mut self) {
        *self = Self::default();
    }
}

/// The multiplexer: registers that [`routes`] reads, and nothing that acts by itself.
#[derive(Debug, Default)]
pub struct Syscfg;

impl Device for Syscfg {
    type Register = syscfg::Register;
}

/// Returns true if SYSCFG routes pin `pin` of port number `port` (A is 0) to the EXTI line of that
/// number.
#[must_use]
pub fn routes(port: u8, pin: u8, registers: &RegisterFile) -> bool {
    let register = match pin / 4 {
        0 => syscfg::Register::Exticr1,
        1 => syscfg::Register::Exticr2,
        2 => syscfg::Register::Exticr3,
        _ => syscfg::Register::Exticr4,
    };
    (registers.get(register) >> (4 * (pin % 4))) & 0xF == u64::from(port)
}
