//! The exact number of instructions that each exception executed.
//!
//! The emulated core is wrapped. A breakpoint on every handler of the vector table shows each
//! entry. A return shows in one of two ways. If the core has only just slept when it is
//! interrupted, a breakpoint where the idle loop continues shows it. Otherwise the handler is
//! executed one instruction at a time. (Breakpoints in busy code would slow the emulator down
//! permanently.) At each of these points IPSR names the running exception. The instructions since
//! the last such point belong to the exception before. Tail-chained entries keep the interrupted
//! context's frame, so the stack pointer tells them from nested ones. None of this takes an
//! instruction or virtual time, so the run is unchanged.
//!
//! Handlers are expected on the main stack, as RTIC and cortex-m-rt have them.

mod pool;
mod processor;
mod stretch;

pub use pool::{PoolKey, PoolRequest, PooledProcessor, ProcessorPool};
pub use processor::ProfiledProcessor;

/// One more than the highest exception number of the part: 16 of the core, 91 of the STM32F427, and
/// some to spare.
pub const EXCEPTIONS: usize = 128;

/// Thread mode, where no exception runs.
pub const THREAD: usize = 0;

/// The exception number of an interrupt.
#[must_use]
pub const fn exception_of(interrupt: usize) -> usize {
    16 + interrupt
}

/// Instructions executed, by exception number; [`THREAD`] is everything outside of exceptions.
pub type Counts = [u64; EXCEPTIONS];

/// The account that a [`ProfiledProcessor`] keeps.
#[derive(Debug)]
pub struct Profile {
    counts: Counts,
    /// Number of entries of each exception.
    entries: Counts,
    /// The exception that runs, and the count of all instructions when it was last credited.
    current: usize,
    credited_at: u64,
    /// Changes of context without an explanation. Zero in a correct account.
    unexplained: u64,
    /// True if every instruction is executed on its own.
    steps_everything: bool,
    /// True if only the fault handlers have breakpoints and no account is kept.
    crashes_only: bool,
    /// The upsets to come: before the core's next instruction, if nothing else is said.
    upsets: Vec<Upset>,
}

/// A disturbance of the core from outside of its program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Upset {
    /// The core leaves the Thumb state, the only one that it has.
    ThumbStateLost,
    /// The stack pointer is here when the core next wakes. Awake, it would soon return to addresses
    /// from memory that no frame was pushed to, and that is no overflow.
    StackPointer(u32),
    /// The non-maskable interrupt is requested.
    NonMaskableInterrupt,
    /// A debugger requests a reset of the chip.
    DebuggerReset,
    /// An interrupt is masked in the interrupt controller, or let through again.
    Masked(u16, bool),
}

/// The exceptions of a crash: HardFault, MemManage, BusFault, UsageFault (PM0214, table 16).
pub const CRASHES: std::ops::RangeInclusive<usize> = 3..=6;

impl Default for Profile {
    fn default() -> Self {
        Self {
            counts: [0; EXCEPTIONS],
            entries: [0; EXCEPTIONS],
            current: THREAD,
            credited_at: 0,
            unexplained: 0,
            steps_everything: false,
            crashes_only: false,
            upsets: Vec::new(),
        }
    }
}

impl Profile {
    /// An account that steps through every instruction: slow, and the reference for the others.
    #[must_use]
    pub fn stepping_everything() -> Self {
        Self {
            steps_everything: true,
            ..Self::default()
        }
    }

    /// No account, except that the handlers of a crash show as having executed something: quick.
    #[must_use]
    pub fn crashes_only() -> Self {
        Self {
            crashes_only: true,
            ..Self::default()
        }
    }

    /// Disturbs the core before its next instruction.
    pub fn upset(&mut self, upset: Upset) {
        self.upsets.push(upset);
    }

    /// Returns true if an account is kept.
    #[must_use]
    pub fn is_account(&self) -> bool {
        !self.crashes_only
    }

    /// Returns the account at `retired` instructions in all.
    #[must_use]
    pub fn counts(&self, retired: u64) -> Counts {
        let mut counts = self.counts;
        if self.crashes_only {
            return counts;
        }
        counts[self.current] += retired.saturating_sub(self.credited_at);
        counts
    }

    /// Returns the number of entries of each exception, if an account is kept.
    #[must_use]
    pub fn entries(&self) -> &Counts {
        &self.entries
    }

    /// The exception that runs.
    #[must_use]
    pub fn current(&self) -> usize {
        self.current
    }

    /// Changes of context that could not be explained. Zero, or the account is wrong.
    #[must_use]
    pub fn unexplained(&self) -> u64 {
        self.unexplained
    }

    fn switch(&mut self, retired: u64, exception: usize) {
        self.counts[self.current] += retired - self.credited_at;
        self.credited_at = retired;
        self.current = exception;
    }
}
