//! The wrapped processor that keeps the account.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

use rigless::emulator::{
    Access, AccessKind, BitAlias, CoreBus, DataModel, Error, Exit, HaltReason, HostCall, Processor,
    Queued,
};
use rigless::soc::{Endian, Width};
use rigless::time::VirtualNanos;

use super::pool::PooledProcessor;
use super::stretch::Stretch;
use super::{CRASHES, EXCEPTIONS, Profile, THREAD, Upset};
use crate::checks::{Checks, Reserved};
use crate::flash::{SLOTS, SharedCells};

/// A processor that keeps a [`Profile`] and otherwise does what the one inside does.
#[derive(Debug)]
pub struct ProfiledProcessor {
    inner: PooledProcessor,
    profile: Arc<Mutex<Profile>>,
    /// The part of the flash that the inner processor does not map.
    cells: SharedCells,
    checks: (Checks, Reserved),
    /// The handlers' first instructions, by exception number; at 0 that of a measurement.
    handlers: Vec<u64>,
    is_armed: bool,
    /// The exceptions that run or are interrupted, the outermost first.
    activations: Vec<Activation>,
    /// The addresses with a breakpoint at which idle loops go on.
    wakes_at: BTreeSet<u64>,
    /// Instructions executed when the core last slept.
    slept_at: u64,
}

/// An exception whose handler has been entered and has not returned.
#[derive(Clone, Copy, Debug)]
struct Activation {
    exception: usize,
    /// The stack pointer on entry, which is where the interrupted context's frame is.
    frame: u64,
    /// True if no breakpoint will show the return.
    is_stepped: bool,
}

/// Instructions that an idle loop may execute between the end of its sleep and the interrupt that
/// ended it. A loop that sleeps with interrupts masked has to unmask them first.
const WAKE_UP_INSTRUCTIONS: u64 = 32;

/// GDB's numbers for the registers (the target description of an M-profile core).
const STACK_POINTER: usize = 13;
const STATUS: usize = 16;

/// Offset of the return address in an exception frame (DDI 0403E.b, section B1.5.6).
const RETURN_ADDRESS: u64 = 24;

/// IPSR in the status register (section B1.4.2).
const EXCEPTION_NUMBER: u64 = 0x1FF;

/// EPSR.T in the status register (section B1.4.2).
const THUMB: u64 = 1 << 24;

/// ICSR with its bit NMIPENDSET, and the first of the registers that enable and disable interrupts
/// (PM0214, 4.3 and 4.4.3).
const ICSR: u64 = 0xE000_ED04;
const NMIPENDSET: u64 = 1 << 31;
/// AIRCR with its key and the bit SYSRESETREQ (PM0214, 4.4.5).
const AIRCR: u64 = 0xE000_ED0C;
const SYSRESETREQ: u64 = 0x05FA_0004;
const NVIC_ISER: u64 = 0xE000_E100;
const NVIC_ICER: u64 = 0xE000_E180;

impl ProfiledProcessor {
    /// Wraps a processor. `handlers` are the vector table's entries by exception number.
    #[must_use]
    pub fn new(
        inner: PooledProcessor,
        handlers: Vec<u32>,
        profile: Arc<Mutex<Profile>>,
        cells: SharedCells,
        checks: (Checks, Reserved),
    ) -> Self {
        Self {
            inner,
            profile,
            cells,
            checks,
            handlers: handlers
                .into_iter()
                .map(|handler| u64::from(handler & !1))
                .collect(),
            is_armed: false,
            activations: Vec::new(),
            wakes_at: BTreeSet::new(),
            slept_at: 0,
        }
    }

    fn register(&self, number: usize) -> u64 {
        let bytes = self.inner.gdb_register(number).unwrap_or_default();
        bytes
            .iter()
            .rev()
            .fold(0, |value, &byte| value << 8 | u64::from(byte))
    }

    fn set_register(&mut self, number: usize, value: u64) {
        let bytes = value.to_le_bytes();
        self.inner.set_gdb_register(number, &bytes[..4]);
    }

    /// Applies the upsets that are due.
    fn apply_upsets(&mut self) {
        let is_asleep = self.inner.waiting();
        let is_due = |upset: &mut Upset| is_asleep || !matches!(upset, Upset::StackPointer(_));
        let upsets: Vec<Upset> = match self.profile.lock() {
            Ok(mut profile) => profile.upsets.extract_if(.., is_due).collect(),
            Err(_) => return,
        };
        for upset in upsets {
            let store = match upset {
                Upset::ThumbStateLost => {
                    self.set_register(STATUS, self.register(STATUS) & !THUMB);
                    continue;
                }
                Upset::StackPointer(address) => {
                    self.set_register(STACK_POINTER, address.into());
                    continue;
                }
                Upset::NonMaskableInterrupt => (ICSR, NMIPENDSET),
                Upset::DebuggerReset => (AIRCR, SYSRESETREQ),
                Upset::Masked(interrupt, is_masked) => {
                    let first = if is_masked { NVIC_ICER } else { NVIC_ISER };
                    (first + u64::from(interrupt / 32 * 4), 1 << (interrupt % 32))
                }
            };
            // None of these registers depends on time.
            let now = VirtualNanos(0);
            self.inner
                .debugger_access(Some(store.1), store.0, Width::W32, now);
        }
    }

    fn exception(&self) -> usize {
        usize::try_from(self.register(STATUS) & EXCEPTION_NUMBER)
            .unwrap_or(THREAD)
            .min(EXCEPTIONS - 1)
    }

    /// Puts a breakpoint on every handler, and none on what the table leaves empty.
    fn arm(&mut self) {
        self.is_armed = true;
        let crashes_only = self
            .profile
            .lock()
            .is_ok_and(|profile| profile.crashes_only);
        let mut addresses: Vec<u64> = self
            .handlers
            .iter()
            .copied()
            .enumerate()
            .filter(|(exception, _)| !crashes_only || CRASHES.contains(exception))
            .map(|(_, address)| address)
            .filter(|&address| address != 0)
            .collect();
        addresses.sort_unstable();
        addresses.dedup();
        for address in addresses {
            self.inner.add_breakpoint(address);
        }
    }

    /// Determines the running exception, and credits the instructions since the last time.
    fn observe_context(&mut self, bus: &mut dyn CoreBus) {
        let exception = self.exception();
        let pc = self.inner.pc();
        // The entry at 0 handles all exceptions while the firmware measures itself.
        let is_handler = [exception, THREAD]
            .iter()
            .any(|&number| self.handlers.get(number) == Some(&pc));
        let is_entry = exception != THREAD && is_handler && self.enter(exception, bus);
        let is_explained = is_entry || self.leave_to(exception);
        let retired = self.inner.retired();
        if let Ok(mut profile) = self.profile.lock() {
            if profile.crashes_only {
                profile.counts[exception] += u64::from(is_entry);
                self.activations.clear();
                return;
            }
            profile.entries[exception] += u64::from(is_entry);
            profile.unexplained += u64::from(!is_explained);
            profile.switch(retired, exception);
        }
    }

    /// Observes the context again, unless the exception is still the same.
    fn observe_if_changed(&mut self, bus: &mut dyn CoreBus) {
        if self
            .profile
            .lock()
            .is_ok_and(|profile| !profile.crashes_only && profile.current != self.exception())
        {
            self.observe_context(bus);
        }
    }

    /// The core is at the first instruction of an exception's handler. Returns false if the
    /// exception runs already, and has called the handler.
    fn enter(&mut self, exception: usize, bus: &mut dyn CoreBus) -> bool {
        let frame = self.register(STACK_POINTER);
        let is_call = |last: &Activation| last.exception == exception && frame < last.frame;
        if self.activations.last().is_some_and(is_call) {
            return false;
        }
        if let Some(last) = self.activations.last_mut()
            && last.frame == frame
        {
            last.exception = exception;
            return true;
        }
        let is_awake_for = self.inner.retired() - self.slept_at;
        let will_wake = is_awake_for <= WAKE_UP_INSTRUCTIONS && self.activations.is_empty();
        if will_wake {
            let access = Access::new(AccessKind::Read, frame + RETURN_ADDRESS, Width::W32, 0);
            let wakes_at = bus.access(access, false).unwrap_or(0) & !1;
            if self.wakes_at.insert(wakes_at) {
                self.inner.add_breakpoint(wakes_at);
            }
        }
        self.activations.push(Activation {
            exception,
            frame,
            is_stepped: !will_wake,
        });
        true
    }

    /// Drops the activations that have ended, if `exception` runs now. Returns true if that
    /// explains it.
    fn leave_to(&mut self, exception: usize) -> bool {
        while self
            .activations
            .last()
            .is_some_and(|last| last.exception != exception)
        {
            self.activations.pop();
        }
        !self.activations.is_empty() || exception == THREAD
    }
}

impl Processor for ProfiledProcessor {
    fn run(&mut self, budget: u32, bus: &mut dyn CoreBus) -> (Exit, u64) {
        if !self.is_armed {
            self.arm();
        }
        self.apply_upsets();
        let start = self.inner.retired();
        if self.inner.waiting() {
            self.slept_at = start;
        }
        let steps_everything = self
            .profile
            .lock()
            .is_ok_and(|profile| profile.steps_everything);
        let mut stretch = Stretch {
            bus,
            cells: self.cells.clone(),
            checks: self.checks.clone(),
            until: start + u64::from(budget),
            is_stepped: false,
        };
        let exit = loop {
            stretch.is_stepped =
                steps_everything || self.activations.iter().any(|each| each.is_stepped);
            let left = stretch.until.saturating_sub(self.inner.retired());
            let budget = if stretch.is_stepped {
                1
            } else {
                u32::try_from(left).unwrap_or(u32::MAX)
            };
            match self.inner.run(budget, &mut stretch) {
                (Exit::Breakpoint, _) => {
                    self.observe_context(stretch.bus);
                    let here = self.inner.pc();
                    self.inner.pass_breakpoint(here);
                }
                (Exit::Budget, _) if stretch.is_stepped => self.observe_if_changed(stretch.bus),
                (exit, _) => break exit,
            }
            if self.inner.retired() >= stretch.until {
                break Exit::Budget;
            }
        };
        self.observe_if_changed(stretch.bus);
        (exit, self.inner.retired() - start)
    }

    fn reset(&mut self) {
        self.inner.reset();
        self.activations.clear();
        let retired = self.inner.retired();
        if let Ok(mut profile) = self.profile.lock() {
            profile.switch(retired, THREAD);
        }
    }

    #[expect(
        unsafe_code,
        reason = "the emulator passes its memory as a pointer, and this forwards it"
    )]
    unsafe fn map(&mut self, start: u64, length: u64, host: *mut u8, writable: bool) {
        let end = start + length;
        let below = start..end.min(SLOTS.start.max(start));
        let above = start.max(SLOTS.end.min(end))..end;
        // The slots stay out, so that accesses to them come to the bus, and there to the flash
        // model.
        for part in [below, above] {
            if !part.is_empty() {
                let offset = usize::try_from(part.start - start).unwrap_or(0);
                // SAFETY: the caller's promise for the whole range, passed on for a part of it. The
                // inner processor lives as long as this one.
                unsafe {
                    let first = host.add(offset);
                    self.inner
                        .map(part.start, part.end - part.start, first, writable);
                }
            }
        }
    }

    fn retired(&self) -> u64 {
        self.inner.retired()
    }

    fn ask(&mut self, queued: Queued) {
        self.inner.ask(queued);
    }

    fn maps(&self, start: u64, length: u64) -> bool {
        self.inner.maps(start, length)
    }

    fn page_size(&self) -> u64 {
        self.inner.page_size()
    }

    fn boot(&mut self, table: u64, read: &dyn Fn(u64, Width) -> Option<u64>) {
        self.inner.boot(table, read);
    }

    fn take_reset_request(&mut self) -> bool {
        self.inner.take_reset_request()
    }

    fn next_event(&self) -> Option<VirtualNanos> {
        self.inner.next_event()
    }

    fn on_event(&mut self, now: VirtualNanos) {
        self.inner.on_event(now);
    }

    fn waiting(&self) -> bool {
        self.inner.waiting()
    }

    fn pc(&self) -> u64 {
        self.inner.pc()
    }

    fn add_breakpoint(&mut self, address: u64) -> bool {
        self.inner.add_breakpoint(address)
    }

    fn remove_breakpoint(&mut self, address: u64) {
        self.inner.remove_breakpoint(address);
    }

    fn pass_breakpoint(&mut self, address: u64) {
        self.inner.pass_breakpoint(address);
    }

    fn attach_debugger(&mut self, attached: bool) {
        self.inner.attach_debugger(attached);
    }

    fn hold_interrupts(&mut self, held: bool) {
        self.inner.hold_interrupts(held);
    }

    fn gdb_register(&self, number: usize) -> Option<Vec<u8>> {
        self.inner.gdb_register(number)
    }

    fn set_gdb_register(&mut self, number: usize, bytes: &[u8]) -> bool {
        self.inner.set_gdb_register(number, bytes)
    }

    fn debugger_access(
        &mut self,
        write: Option<u64>,
        address: u64,
        width: Width,
        now: VirtualNanos,
    ) -> Option<u64> {
        self.inner.debugger_access(write, address, width, now)
    }

    fn take_debugger_trace(&mut self) -> Vec<u8> {
        self.inner.take_debugger_trace()
    }

    fn target_xml(&self) -> &'static str {
        self.inner.target_xml()
    }

    fn data_model(&self) -> DataModel {
        self.inner.data_model()
    }

    fn byte_order(&self, address: u64) -> Endian {
        self.inner.byte_order(address)
    }

    fn save(&self) -> Vec<u8> {
        self.inner.save()
    }

    fn load(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.inner.load(bytes)
    }

    fn monitor_command(&mut self, command: &str) -> Option<String> {
        self.inner.monitor_command(command)
    }

    fn debugger_halted(&mut self, why: HaltReason) -> bool {
        self.inner.debugger_halted(why)
    }

    fn bit_alias(&self, address: u64, width: Width) -> Option<BitAlias> {
        self.inner.bit_alias(address, width)
    }

    fn own_ranges(&self) -> Vec<std::ops::Range<u64>> {
        self.inner.own_ranges()
    }

    fn check_reads(&mut self, every: bool) {
        self.inner.check_reads(every);
    }

    fn check_words(&mut self, words: &[u64]) {
        self.inner.check_words(words);
    }

    fn host_call(&self, read: &mut dyn FnMut(u64, Width) -> Option<u64>) -> Option<HostCall> {
        self.inner.host_call(read)
    }

    fn answer_host_call(&mut self, answer: Option<u64>) {
        self.inner.answer_host_call(answer);
    }
}
