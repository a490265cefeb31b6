//! State and offsets that a run has found, for the next one.

use aplomb::calibration::CompassCorrection;
use aplomb::estimator::kalman::WarmStart;
use aplomb::pipeline::Pipeline;
use aplomb::settings::Record;

use crate::state::{self, AplombCompassPipeline, AplombPipeline};
use crate::{AplombCalibration, AplombStatus, not_null, stale, status_of};

/// Bytes of a state to go on from.
pub const APLOMB_WARM_START_BYTES: usize = 64;

const _: () = assert!(APLOMB_WARM_START_BYTES == WarmStart::LENGTH);

/// Attitude and offsets of a run with a checksum, to go on from after a reset of the processor.
/// Keep it in memory that a reset leaves as it is.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AplombWarmStart {
    /// Contents, to be kept as they are.
    pub bytes: [u8; APLOMB_WARM_START_BYTES],
}

/// Writes the calibration in use, with the offsets that this run has found, for the settings of the
/// next run or for `aplomb_encode_record`. Offsets that are not certain stay as they are: the
/// gyroscope's is certain at rest, and the accelerometer's after motion. The compass's is left out:
/// `aplomb_compass_learned` writes it.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_learned(
    pipeline: Option<&mut AplombPipeline>,
    calibration: Option<&mut AplombCalibration>,
) -> AplombStatus {
    status_of((|| {
        let (out, pipeline) = (not_null(calibration)?, state::pipeline(pipeline)?);
        let mut record = Record::default();
        record.calibration = pipeline.learned_calibration();
        *out = AplombCalibration::from(&record);
        Ok(())
    })())
}

/// Writes the calibration like `aplomb_learned`, and the compass's with the hard iron that this run
/// has found, once it is certain.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_learned(
    pipeline: Option<&mut AplombCompassPipeline>,
    calibration: Option<&mut AplombCalibration>,
) -> AplombStatus {
    status_of((|| {
        let (out, state) = (not_null(calibration)?, state::with_compass(pipeline)?);
        let mut record = Record::default();
        record.calibration = state.pipeline.pipeline().learned_calibration();
        record.compass.mount = Some(state.alignment.mount);
        record.compass.correction = state.alignment.correction;
        if let Some(found_ut) = state.pipeline.heading_filter().certain_hard_iron_ut() {
            let correction = record.compass.correction;
            let correction = correction.unwrap_or(CompassCorrection::NONE);
            record.compass.correction = Some(CompassCorrection {
                hard_iron_ut: correction.hard_iron_ut + found_ut,
                ..correction
            });
        }
        *out = AplombCalibration::from(&record);
        Ok(())
    })())
}

/// Writes the state at this time, µs since start, not before the last sample. Only the latest
/// state is of use after a reset, so write it often, such as ten times a second. Write two in
/// turn: a reset may cut one. Gives `APLOMB_STATUS_NO_STATE` before a rest has measured the
/// gyroscope's offset.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_warm_start(
    pipeline: Option<&mut AplombPipeline>,
    t_us: u64,
    start: Option<&mut AplombWarmStart>,
) -> AplombStatus {
    status_of((|| {
        write(state::pipeline(pipeline)?, t_us, not_null(start)?)
    })())
}

/// Goes on from the state of an earlier run with the same settings. Call it after `aplomb_init` and
/// before the first sample, which comes after `t_us`, the present time. `age_us` is the longest
/// time since the state was written: sigma grows with it. Without a whole state it gives
/// `APLOMB_STATUS_NO_RECORD`, and the pipeline starts as without one. Do not call it after a
/// power-up.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_resume(
    pipeline: Option<&mut AplombPipeline>,
    start: Option<&AplombWarmStart>,
    t_us: u64,
    age_us: u32,
) -> AplombStatus {
    status_of((|| {
        resume(state::pipeline(pipeline)?, not_null(start)?, t_us, age_us)
    })())
}

/// Writes the state like `aplomb_warm_start`. It has no heading.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_warm_start(
    pipeline: Option<&mut AplombCompassPipeline>,
    t_us: u64,
    start: Option<&mut AplombWarmStart>,
) -> AplombStatus {
    status_of((|| {
        let state = state::with_compass(pipeline)?;
        write(state.pipeline.pipeline(), t_us, not_null(start)?)
    })())
}

/// Goes on from the state of an earlier run like `aplomb_resume`. The heading starts anew.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_resume(
    pipeline: Option<&mut AplombCompassPipeline>,
    start: Option<&AplombWarmStart>,
    t_us: u64,
    age_us: u32,
) -> AplombStatus {
    status_of((|| {
        let state = state::with_compass(pipeline)?;
        let pipeline = state.pipeline.pipeline_mut();
        resume(pipeline, not_null(start)?, t_us, age_us)
    })())
}

fn write(pipeline: &Pipeline, t_us: u64, out: &mut AplombWarmStart) -> Result<(), AplombStatus> {
    let latest = stale(pipeline, t_us)?;
    let start = pipeline.warm_start(&latest).ok_or(AplombStatus::NoState)?;
    out.bytes = start.to_bytes();
    Ok(())
}

fn resume(
    pipeline: &mut Pipeline,
    start: &AplombWarmStart,
    t_us: u64,
    age_us: u32,
) -> Result<(), AplombStatus> {
    let start = WarmStart::from_bytes(&start.bytes).ok_or(AplombStatus::NoRecord)?;
    if pipeline.resume_aged(&start, t_us, age_us) {
        Ok(())
    } else {
        Err(AplombStatus::NoRecord)
    }
}
