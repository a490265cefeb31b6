//! A pipeline with a compass: the attitude as without one, and a heading beside it.

use aplomb::attitude::Vector3;
use aplomb::estimator::heading::Heading;
use aplomb::pipeline::{CompassPipeline, Snapshot};

use crate::state::{self, AplombCompassPipeline, WithCompass};
use crate::{AplombBurst, AplombSample, AplombSettings, AplombSnapshot, AplombStatus};
use crate::{not_null, stale, status_of};

/// Reading of a compass along its own axes. The calibration turns and corrects it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AplombField {
    /// Magnetic field, µT. One gauss is 100 µT.
    pub field_ut: [f32; 3],
    /// Age of the reading's motion against that of the last sample, µs:
    /// `aplomb_compass_reading_age_us` returns it.
    pub age_us: u32,
}

/// Starts a pipeline with a compass, in memory with any contents. Attitude, rates and tilt sigma
/// are those of `AplombPipeline`, to the bit. After an error the memory holds no pipeline.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_init(
    pipeline: Option<&mut AplombCompassPipeline>,
    settings: Option<&AplombSettings>,
) -> AplombStatus {
    status_of(start(pipeline, settings))
}

/// Processes one burst like `aplomb_update_burst`. Writes the attitude with its heading.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_update_burst(
    pipeline: Option<&mut AplombCompassPipeline>,
    burst: Option<&AplombBurst>,
    snapshot: Option<&mut AplombSnapshot>,
) -> AplombStatus {
    with(pipeline, burst, snapshot, |pipeline, burst| {
        let (burst, board) = burst.converted();
        Ok(pipeline.update(&burst, board))
    })
}

/// Processes one sample like `aplomb_update_sample`. Writes the attitude with its heading.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_update_sample(
    pipeline: Option<&mut AplombCompassPipeline>,
    sample: Option<&AplombSample>,
    snapshot: Option<&mut AplombSnapshot>,
) -> AplombStatus {
    with(pipeline, sample, snapshot, |pipeline, sample| {
        let (sample, board) = sample.converted(pipeline.pipeline());
        Ok(pipeline.update_sample_with(&sample, board))
    })
}

/// Takes a reading of the compass, after the update of the last sample before it. 50 to 100
/// readings a second are enough. The next updates use it. A reading that no update would use gives
/// `APLOMB_STATUS_WRONG_FIELD`: a field that is not finite or above 15,000 µT, or an age above a
/// second.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_update_field(
    pipeline: Option<&mut AplombCompassPipeline>,
    field: Option<&AplombField>,
) -> AplombStatus {
    status_of(update_field(pipeline, field))
}

fn update_field(
    pipeline: Option<&mut AplombCompassPipeline>,
    field: Option<&AplombField>,
) -> Result<(), AplombStatus> {
    let field = not_null(field)?;
    let state = state::with_compass(pipeline)?;
    let [x, y, z] = field.field_ut;
    let in_body = state.alignment.apply(Vector3::new(x, y, z));
    if !Heading::uses_field(in_body, field.age_us) {
        return Err(AplombStatus::WrongField);
    }
    state.pipeline.update_field(in_body, field.age_us);
    Ok(())
}

/// Returns the age of a reading for `AplombField`, µs: how much older its motion is than that of
/// the last sample, whose motion is older than its time by the sensor's delay. `measured_us` is the
/// time of the middle of the measurement, on the clock of the samples: its low 32 bits. Zero for a
/// later motion, and without a pipeline.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_reading_age_us(
    pipeline: Option<&mut AplombCompassPipeline>,
    measured_us: u32,
) -> u32 {
    state::with_compass(pipeline).map_or(0, |state| {
        state.pipeline.pipeline().reading_age_us(measured_us)
    })
}

/// Writes the attitude for a time without a sample, as `aplomb_stale` does. The heading is the last
/// one, without `APLOMB_FLAG_HEADING_VALID`.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_stale(
    pipeline: Option<&mut AplombCompassPipeline>,
    t_us: u64,
    snapshot: Option<&mut AplombSnapshot>,
) -> AplombStatus {
    with(pipeline, Some(&t_us), snapshot, |pipeline, t_us| {
        stale(pipeline.pipeline(), *t_us)
    })
}

/// Returns whether the full scales have to be read back, as `aplomb_awaits_scale_check` does.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_awaits_scale_check(
    pipeline: Option<&mut AplombCompassPipeline>,
) -> bool {
    let state = state::with_compass(pipeline);
    state.is_ok_and(|state| state.pipeline.pipeline().awaits_scale_check())
}

/// Switches between ground and flight like `aplomb_set_armed`.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_compass_set_armed(
    pipeline: Option<&mut AplombCompassPipeline>,
    is_armed: bool,
) -> AplombStatus {
    let state = state::with_compass(pipeline);
    status_of(state.map(|state| state.pipeline.pipeline_mut().set_armed(is_armed)))
}

/// Stores a pipeline with these settings. Moves it as little as possible: it is large for a stack.
fn start(
    state: Option<&mut AplombCompassPipeline>,
    settings: Option<&AplombSettings>,
) -> Result<(), AplombStatus> {
    let state = not_null(state)?;
    state.clear();
    let settings = not_null(settings)?;
    let alignment = settings.compass_alignment()?;
    let knowledge = settings.compass_knowledge(&alignment)?;
    let declination_rad = settings.declination()?;
    let checked = settings.checked()?;
    let accelerometer = settings.accelerometer()?;
    state.put(WithCompass {
        pipeline: CompassPipeline::new(&checked, knowledge),
        alignment,
    });
    let stored = &mut state::with_compass(Some(state))?.pipeline;
    stored.heading_filter_mut().set_declination(declination_rad);
    if let Some(knowledge) = accelerometer {
        stored.pipeline_mut().set_accelerometer_knowledge(knowledge);
    }
    Ok(())
}

/// Calls a function of the pipeline with this input, and writes its snapshot with the heading.
fn with<I>(
    pipeline: Option<&mut AplombCompassPipeline>,
    input: Option<&I>,
    snapshot: Option<&mut AplombSnapshot>,
    call: impl FnOnce(&mut CompassPipeline, &I) -> Result<Snapshot, AplombStatus>,
) -> AplombStatus {
    status_of((|| {
        let (input, out) = (not_null(input)?, not_null(snapshot)?);
        let pipeline = &mut state::with_compass(pipeline)?.pipeline;
        *out = call(pipeline, input)?.into();
        if let Some(heading) = pipeline.heading() {
            out.heading_rad = heading.heading_rad(out.yaw_rad);
            out.heading_sigma_rad = heading.sigma_rad;
            out.yaw_offset_rad = heading.yaw_offset_rad;
        }
        Ok(())
    })())
}
