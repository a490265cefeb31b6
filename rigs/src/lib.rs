//! Shared parts of the programs under `bin/`, which run in QEMU or are only linked, never flashed.
//!
//! | program | proves or measures | called by |
//! |---|---|---|
//! | `qemu` | the pipeline under RTIC gives the host's attitudes to the bit | `cargo xtask agree` |
//! | `cost` | instructions and bytes of each filter's update | `cargo xtask cost` |
//! | `no_panic` | nothing in the library panics, or it would not link | `cargo xtask test` |
//! | `empty`, `kalman` | flash of the default filter alone: their difference | `cargo xtask size` |

#![no_std]

#[cfg(all(target_os = "none", any(feature = "qemu", feature = "cost")))]
#[allow(
    unsafe_code,
    reason = "a call by semihosting takes addresses of memory"
)]
pub mod host_files;
#[cfg(all(target_os = "none", feature = "cost"))]
pub mod instruction_counter;
