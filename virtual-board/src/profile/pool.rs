//! Processors that keep their translated code from one flight to the next.
//!
//! The emulator translates the firmware's instructions to code of the host while they run. That
//! takes a second of CPU, more than a short flight itself. A [`ProcessorPool`] keeps the processor
//! of a finished flight. The next flight of the same image loads the state of a new processor into
//! it, which leaves the translated code alone.

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

use rigless::emulator::{Error, Processor, Queued};

/// The processors between two flights.
#[derive(Debug, Default)]
pub struct ProcessorPool {
    idle: Mutex<Vec<Idle>>,
}

/// A processor with its key and its spares.
type Idle = (PoolKey, Box<dyn Processor>, Spares);

/// The conditions under which the translated code of one flight is right for another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PoolKey {
    /// The core's clock, Hz.
    pub core_hz: u64,
    /// The ELF file.
    pub image: Arc<[u8]>,
}

/// A pool, and the key of the processor that is wanted from it.
pub type PoolRequest = (Arc<ProcessorPool>, PoolKey);

/// The parts that turn a used processor into a new one with translated code.
#[derive(Debug)]
struct Spares {
    /// The state of a new processor.
    fresh: Vec<u8>,
    /// A processor without code. It computes the states after changes that would drop the code.
    scratch: Box<dyn Processor>,
    /// Memory to be mapped to between two flights: that of the last flight is gone.
    spare_memory: Vec<u8>,
}

/// A processor for one flight.
#[derive(Debug)]
pub struct PooledProcessor {
    /// Processor, until it goes back to the pool.
    processor: Option<Box<dyn Processor>>,
    /// Place of the return, and the parts that the processor needs there.
    returns: Option<(PoolRequest, Spares)>,
    /// The mapped ranges: start, length, and true if the firmware can write there.
    regions: Vec<(u64, u64, bool)>,
}

impl PooledProcessor {
    /// A processor that ends with its flight.
    #[must_use]
    pub fn unpooled(processor: Box<dyn Processor>) -> Self {
        Self {
            processor: Some(processor),
            returns: None,
            regions: Vec::new(),
        }
    }

    /// A processor from a pool, or from `make` where none is idle.
    ///
    /// # Errors
    ///
    /// When `make` fails, or a processor refuses the state of a new one.
    pub fn from_pool(
        request: PoolRequest,
        make: impl Fn() -> Result<Box<dyn Processor>, Error>,
    ) -> Result<Self, Error> {
        let found = {
            let mut idle = lock(&request.0.idle);
            let place = idle.iter().position(|(key, ..)| *key == request.1);
            place.map(|place| idle.swap_remove(place))
        };
        let (processor, spares) = match found {
            Some((_, mut processor, spares)) => {
                processor.load(&spares.fresh)?;
                // The address of no instruction: the flight before may have left another.
                processor.pass_breakpoint(u64::MAX);
                (processor, spares)
            }
            None => {
                let processor = make()?;
                let spares = Spares {
                    fresh: processor.save(),
                    scratch: make()?,
                    spare_memory: Vec::new(),
                };
                (processor, spares)
            }
        };
        Ok(Self {
            processor: Some(processor),
            returns: Some((request, spares)),
            regions: Vec::new(),
        })
    }

    /// Resets the processor.
    pub fn reset(&mut self) {
        self.take_reset_request();
        self.change_state(|processor| processor.reset());
    }

    /// Writes a register, as [`Processor::set_gdb_register`].
    pub fn set_gdb_register(&mut self, number: usize, bytes: &[u8]) -> bool {
        self.change_state(|processor| processor.set_gdb_register(number, bytes))
    }

    /// Makes a change that drops all translated code: if there is a scratch processor, on the
    /// state alone.
    fn change_state<T>(&mut self, change: impl Fn(&mut dyn Processor) -> T) -> T {
        if let (Some(processor), Some((_, spares))) = (&mut self.processor, &mut self.returns)
            && spares.scratch.load(&processor.save()).is_ok()
        {
            let result = change(&mut *spares.scratch);
            if processor.load(&spares.scratch.save()).is_ok() {
                return result;
            }
        }
        change(&mut **self)
    }

    /// Passes a request on, unless it drops translated code for an image that is the same.
    pub fn ask(&mut self, queued: Queued) {
        // Before the first instruction the memory holds the image, and RAM has no translated code.
        let is_same = matches!(queued, Queued::Invalidate(..))
            && self.returns.is_some()
            && self.retired() == 0;
        if !is_same {
            (**self).ask(queued);
        }
    }

    /// Maps memory.
    ///
    /// # Safety
    ///
    /// As for [`Processor::map`], but until this value is dropped.
    #[expect(
        unsafe_code,
        reason = "the emulator passes its memory as a pointer, and this forwards it"
    )]
    pub unsafe fn map(&mut self, start: u64, length: u64, host: *mut u8, writable: bool) {
        self.regions.push((start, length, writable));
        // SAFETY: the caller's promise. A processor that outlives this value is mapped elsewhere
        // before.
        unsafe { (**self).map(start, length, host, writable) };
    }
}

/// Removes the watches and the code from RAM, and maps the processor to memory of its own.
#[expect(
    unsafe_code,
    reason = "the emulator takes its memory as a pointer, and this gives it another"
)]
fn detach(processor: &mut dyn Processor, regions: &[(u64, u64, bool)], spare_memory: &mut Vec<u8>) {
    let page = processor.page_size();
    let page_bytes = usize::try_from(page).unwrap_or(1);
    let lengths = regions.iter().map(|&(_, length, _)| length);
    let bytes = usize::try_from(lengths.max().unwrap_or(0) + page).unwrap_or(0);
    if spare_memory.len() < bytes {
        *spare_memory = vec![0; bytes];
    }
    let unaligned = spare_memory.as_mut_ptr();
    let first = unaligned.wrapping_add(unaligned.align_offset(page_bytes));
    for &(start, length, is_writable) in regions {
        for address in (start..start + length).step_by(page_bytes) {
            processor.ask(Queued::Unroute(address));
        }
        if is_writable {
            processor.ask(Queued::Invalidate(start, start + length));
        }
        // SAFETY: `spare_memory` has a page more than the longest region, and `first` is its first
        // byte on a page boundary. Nothing else uses that memory. The pool keeps it with the
        // processor, until the next flight maps the same ranges anew before it runs.
        unsafe { processor.map(start, length, first, is_writable) };
    }
}

impl Drop for PooledProcessor {
    fn drop(&mut self) {
        let (Some(mut processor), Some(((pool, key), mut spares))) =
            (self.processor.take(), self.returns.take())
        else {
            return;
        };
        // A panic may have left the processor in the middle of an instruction.
        if std::thread::panicking() {
            return;
        }
        detach(&mut *processor, &self.regions, &mut spares.spare_memory);
        lock(&pool.idle).push((key, processor, spares));
    }
}

impl Deref for PooledProcessor {
    type Target = dyn Processor;

    fn deref(&self) -> &Self::Target {
        let processor = self.processor.as_deref();
        processor.expect("the processor is there until the drop")
    }
}

impl DerefMut for PooledProcessor {
    fn deref_mut(&mut self) -> &mut Self::Target {
        let processor = self.processor.as_deref_mut();
        processor.expect("the processor is there until the drop")
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
