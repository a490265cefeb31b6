//! The pipeline in the caller's memory.

use core::mem::{MaybeUninit, align_of, size_of};

use aplomb::pipeline::Pipeline;

use crate::AplombStatus;

/// Size of a pipeline, in units of eight bytes. The same on every target.
pub const APLOMB_PIPELINE_WORDS: usize = 320;

/// First word of memory that holds a pipeline: no text, no pointer, no pattern of fresh memory.
const MARK: u64 = 0xA910_3B5E_7C1D_42F1;

/// Memory of a pipeline. Its contents are the library's own. It may be static, on the stack or in a
/// larger struct, and may be copied.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AplombPipeline {
    /// Contents of the library.
    pub opaque: [u64; APLOMB_PIPELINE_WORDS],
}

const _: () = assert!(
    size_of::<Pipeline>() <= 8 * (APLOMB_PIPELINE_WORDS - 1) && align_of::<Pipeline>() <= 8
);

impl AplombPipeline {
    /// Stores a pipeline.
    pub(crate) fn put(&mut self, pipeline: Pipeline) {
        self.place().write(pipeline);
        self.opaque[0] = MARK;
    }

    /// Returns the place of the pipeline behind the mark.
    #[allow(unsafe_code, reason = "C knows no Rust type of this size")]
    fn place(&mut self) -> &mut MaybeUninit<Pipeline> {
        let words = &raw mut self.opaque;
        // SAFETY: the words after the first are at least as large and as aligned as a pipeline,
        // which the assertion above checks. They are borrowed for as long as the result. Any bytes
        // are a `MaybeUninit`.
        unsafe { &mut *words.cast::<u64>().add(1).cast::<MaybeUninit<Pipeline>>() }
    }
}

/// Returns the pipeline in this memory.
#[allow(unsafe_code, reason = "the mark says that the memory is initialised")]
pub(crate) fn pipeline(state: Option<&mut AplombPipeline>) -> Result<&mut Pipeline, AplombStatus> {
    let state = state.ok_or(AplombStatus::NullPointer)?;
    if state.opaque[0] != MARK {
        return Err(AplombStatus::NotInitialised);
    }
    // SAFETY: only `put` writes the mark, after the pipeline. The header forbids others to write.
    Ok(unsafe { state.place().assume_init_mut() })
}
