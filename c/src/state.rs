//! Pipelines in the caller's memory.

use core::mem::{MaybeUninit, align_of, size_of};

use aplomb::calibration::CompassAlignment;
use aplomb::estimator::REVISION;
use aplomb::mpu6050::PARTS;
use aplomb::pipeline::{CompassPipeline, Pipeline};

use crate::AplombStatus;

/// Size of a pipeline, in units of eight bytes. The same on every target.
pub const APLOMB_PIPELINE_WORDS: usize = 320;

/// Size of a pipeline with a compass, in units of eight bytes. The same on every target.
pub const APLOMB_COMPASS_PIPELINE_WORDS: usize = 480;

/// First word of memory that holds a pipeline, before [`of_this_program`]: no text, no pointer, no
/// pattern of fresh memory.
pub(crate) const MARK: u64 = 0xA910_3B5E_7C1D_42F1;

/// Mark of a pipeline with a compass.
const COMPASS_MARK: u64 = 0xC35D_90E7_1B64_A82F;

/// Returns a mark for this program. A pipeline has pointers to constants, whose addresses differ in
/// another program: it may be the new firmware after an update, and find the old one's memory.
fn of_this_program(mark: u64) -> u64 {
    of_program(mark, PARTS.as_ptr().addr())
}

/// Returns a mark for the program that has its constants at this address.
pub(crate) fn of_program(mark: u64, constants_at: usize) -> u64 {
    let size = size_of::<WithCompass>() as u64;
    mark ^ constants_at as u64 ^ u64::from(REVISION) << 32 ^ size << 48
}

/// Memory of a pipeline. Its contents are the library's own. It may be static, on the stack or in a
/// larger struct, aligned as its type: to eight bytes on most targets. It may be copied within one
/// run of one program. Memory that outlives a reset holds no pipeline: `aplomb_warm_start` and
/// `aplomb_learned` write what a later run can use.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AplombPipeline {
    /// Contents of the library.
    pub opaque: [u64; APLOMB_PIPELINE_WORDS],
}

/// Memory of a pipeline with a compass, used as `AplombPipeline` is.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct AplombCompassPipeline {
    /// Contents of the library.
    pub opaque: [u64; APLOMB_COMPASS_PIPELINE_WORDS],
}

/// Pipeline with a compass, and the compass's place in the vehicle.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WithCompass {
    pub(crate) pipeline: CompassPipeline,
    pub(crate) alignment: CompassAlignment,
}

impl AplombPipeline {
    /// Stores a pipeline.
    pub(crate) fn put(&mut self, pipeline: Pipeline) {
        place(&mut self.opaque).write(pipeline);
        self.opaque[0] = of_this_program(MARK);
    }

    /// Ends the pipeline that was stored, if there was one.
    pub(crate) fn clear(&mut self) {
        self.opaque[0] = 0;
    }
}

impl AplombCompassPipeline {
    /// Stores a pipeline with a compass.
    pub(crate) fn put(&mut self, pipeline: WithCompass) {
        place(&mut self.opaque).write(pipeline);
        self.opaque[0] = of_this_program(COMPASS_MARK);
    }

    /// Ends the pipeline that was stored, if there was one.
    pub(crate) fn clear(&mut self) {
        self.opaque[0] = 0;
    }
}

/// Returns the place of a value behind the mark.
#[allow(unsafe_code, reason = "C knows no Rust type of this size")]
fn place<T, const WORDS: usize>(opaque: &mut [u64; WORDS]) -> &mut MaybeUninit<T> {
    const { assert!(WORDS > 0 && size_of::<T>() <= 8 * (WORDS - 1) && align_of::<T>() <= 8) };
    let words = &raw mut *opaque;
    // SAFETY: the words after the first are at least as large and as aligned as the value, which
    // the assertion above checks. They are borrowed for as long as the result. Any bytes are a
    // `MaybeUninit`.
    unsafe { &mut *words.cast::<u64>().add(1).cast::<MaybeUninit<T>>() }
}

/// Returns the pipeline in this memory.
#[allow(unsafe_code, reason = "the mark says that the memory is initialised")]
pub(crate) fn pipeline(state: Option<&mut AplombPipeline>) -> Result<&mut Pipeline, AplombStatus> {
    let state = state.ok_or(AplombStatus::NullPointer)?;
    if state.opaque[0] != of_this_program(MARK) {
        return Err(AplombStatus::NotInitialised);
    }
    // SAFETY: only `put` writes the mark, after the pipeline. The header forbids others to write.
    Ok(unsafe { place(&mut state.opaque).assume_init_mut() })
}

/// Returns the pipeline with a compass in this memory.
#[allow(unsafe_code, reason = "the mark says that the memory is initialised")]
pub(crate) fn with_compass(
    state: Option<&mut AplombCompassPipeline>,
) -> Result<&mut WithCompass, AplombStatus> {
    let state = state.ok_or(AplombStatus::NullPointer)?;
    if state.opaque[0] != of_this_program(COMPASS_MARK) {
        return Err(AplombStatus::NotInitialised);
    }
    // SAFETY: only `put` writes the mark, after the pipeline. The header forbids others to write.
    Ok(unsafe { place(&mut state.opaque).assume_init_mut() })
}
