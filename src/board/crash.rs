//! Records hard faults, panics and stack overflows in RAM that survives a reset, and then resets.
//!
//! Every fault of the core ends in HardFault, because no other handler is enabled. A panic causes
//! it by an undefined instruction. The stack lies below all variables, so an overflow faults at the
//! start of RAM. There is no room left for a handler's frame then. Therefore the entry below resets
//! the stack pointer to the top before it calls anything.

use core::arch::global_asm;

use cortex_m::peripheral::SCB;

use super::retained;
use crate::fault::FaultClass;

unsafe extern "C" {
    /// Lowest address of the stack (memory.x).
    static _stack_end: u32;
}

// Entry of a hard fault, in place of cortex-m-rt's endless loop.
global_asm!(
    ".section .HardFault.aplomb, \"ax\"",
    ".global HardFault",
    ".type HardFault, %function",
    ".thumb_func",
    "HardFault:",
    "mov r0, sp",
    "ldr r1, =_stack_start",
    "mov sp, r1",
    "bl {note_and_reset}",
    "udf #0",
    ".size HardFault, . - HardFault",
    note_and_reset = sym note_and_reset,
);

/// CFSR: an access to the guard, or stacking that failed, by the memory protection unit or the bus
/// (PM0214, 4.4.15). The first comes alone if a push crosses the guard, and the smaller frame of
/// the fault does not.
const STACK_OVERFLOWED: u32 = 1 << 1 | 1 << 4 | 1 << 12;
/// Index of the program counter in the frame that the processor pushes (PM0214, 2.3.7).
const PROGRAM_COUNTER: usize = 6;

/// Records the place of the fault, and resets. `frame` is the frame that the processor pushed, if
/// stacking succeeded.
extern "C" fn note_and_reset(frame: *const u32) -> ! {
    let bottom = &raw const _stack_end;
    // SAFETY: reading the fault status has no side effect, and no other code runs any more.
    let status = unsafe { (*SCB::PTR).cfsr.read() };
    let is_overflow = frame < bottom || status & STACK_OVERFLOWED != 0;
    let (class, address) = if is_overflow {
        (FaultClass::StackOverflow, 0)
    } else {
        // SAFETY: the frame lies in the stack, where the processor has just pushed its eight words.
        let address = unsafe { frame.add(PROGRAM_COUNTER).read_volatile() };
        (FaultClass::Crash, address)
    };
    retained::note_crash(class, address);
    SCB::sys_reset()
}
