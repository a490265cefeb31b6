//! Guard below the stack: the memory protection unit refuses every access to the 32 KiB below the
//! start of RAM.
//!
//! The stack lies at the start of RAM, so an overflow leaves RAM. What lies below differs by chip
//! and place: some addresses fault, others ignore a store. With the guard each faults. The default
//! memory map applies to all else (PM0214, 4.2).

use cortex_m::peripheral::MPU;

/// Address and size of the guard: the size is 2^(14 + 1) bytes.
const START: u32 = 0x1FFF_8000;
const SIZE: u32 = 14;

/// RBAR: the address is for region 0 (PM0214, 4.2.8).
const VALID: u32 = 1 << 4;
/// RASR: no access, no execution, and the region is on (PM0214, 4.2.9).
const ATTRIBUTES: u32 = 1 << 28 | SIZE << 1 | 1;
/// CTRL: on, with the default map for all else (PM0214, 4.2.6). Off in the handlers of hard faults
/// and the NMI.
const CONTROL: u32 = 1 << 2 | 1;

/// Sets the guard up, once.
pub fn start(unit: &MPU) {
    // SAFETY: nothing uses the refused addresses, and no other code sets the unit up.
    unsafe {
        unit.rbar.write(START | VALID);
        unit.rasr.write(ATTRIBUTES);
        unit.ctrl.write(CONTROL);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}
