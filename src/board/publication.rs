//! Publication of a value to tasks of lower priority and to debuggers, without a lock.
//!
//! One task is the writer. It increments `sequence` last, so a reader of lower priority that finds
//! the same count before and after its copy holds one whole value. A debugger halts the core, and
//! reads the words at offset 0 and the count after them.

use core::sync::atomic::{AtomicU32, Ordering, fence};

/// The latest value, word by word, and the number of publications.
#[repr(C)]
pub(super) struct Publication<const WORDS: usize> {
    words: [AtomicU32; WORDS],
    /// Number of publications, zero until the first. It may wrap.
    sequence: AtomicU32,
}

impl<const WORDS: usize> Publication<WORDS> {
    /// Creates a publication without a value.
    pub(super) const fn new() -> Self {
        Self {
            words: [const { AtomicU32::new(0) }; WORDS],
            sequence: AtomicU32::new(0),
        }
    }

    /// Publishes the value that `store` writes, word by word. Only the writer calls this.
    #[inline(always)]
    pub(super) fn publish(&self, store: impl FnOnce(&[AtomicU32; WORDS])) {
        store(&self.words);
        let next = self.count().wrapping_add(1);
        self.sequence.store(next, Ordering::Release);
    }

    /// Returns the number of publications.
    #[inline(always)]
    pub(super) fn count(&self) -> u32 {
        self.sequence.load(Ordering::Relaxed)
    }

    /// Returns the latest value and its number; `None` before the first. Only for tasks of lower
    /// priority than the writer.
    #[inline(always)]
    pub(super) fn latest(&self) -> Option<([u32; WORDS], u32)> {
        loop {
            let before = self.sequence.load(Ordering::Acquire);
            if before == 0 {
                return None;
            }
            let words = self
                .words
                .each_ref()
                .map(|word| word.load(Ordering::Relaxed));
            // The copy is complete before the count is read again.
            fence(Ordering::Acquire);
            if self.count() == before {
                return Some((words, before));
            }
        }
    }
}
