//! aplomb from C and C++: the pipeline behind functions with a C interface.
//!
//! Nothing is estimated here. Each function checks its pointers and calls the library, so that the
//! same bursts give the same bits. A pipeline lives in the caller's memory. Nothing allocates, and
//! nothing panics. `include/aplomb.h` is made from this code.
//!
//! A pointer may be null: the function then returns `APLOMB_STATUS_NULL_POINTER`. Any other pointer
//! has to point to a whole value, aligned as its type. One pipeline is used by one thread or
//! interrupt at a time.

#![no_std]

#[cfg(not(target_os = "none"))]
extern crate std;

mod compass;
mod learned;
mod mount;
mod record;
mod sensor;
mod settings;
mod state;
#[cfg(test)]
mod tests;

use core::ffi::{CStr, c_char};

use aplomb::attitude::Vector3;
use aplomb::estimator::Sample;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::Burst;
use aplomb::pipeline::{Pipeline, Snapshot};

pub use compass::{
    AplombField, aplomb_compass_awaits_scale_check, aplomb_compass_init,
    aplomb_compass_reading_age_us, aplomb_compass_set_armed, aplomb_compass_stale,
    aplomb_compass_update_burst, aplomb_compass_update_field, aplomb_compass_update_sample,
};
pub use learned::{
    APLOMB_WARM_START_BYTES, AplombWarmStart, aplomb_compass_learned, aplomb_compass_resume,
    aplomb_compass_warm_start, aplomb_learned, aplomb_resume, aplomb_warm_start,
};
pub use record::{
    APLOMB_RECORD_BYTES, AplombCalibration, AplombRecord, aplomb_decode_record,
    aplomb_encode_record,
};
pub use sensor::{
    APLOMB_CHECK_BYTES, AplombCheck, AplombStep, aplomb_configuration_step,
    aplomb_reconfiguration_step, aplomb_settings_check,
};
pub use settings::{
    AplombAccelerometerKnowledge, AplombCompassKnowledge, AplombSettings, aplomb_default_settings,
};
pub use state::{
    APLOMB_COMPASS_PIPELINE_WORDS, APLOMB_PIPELINE_WORDS, AplombCompassPipeline, AplombPipeline,
};

/// The gyroscope's offset is not known. The reported sigma is much larger.
pub const APLOMB_FLAG_CALIBRATING: u32 = 1_u32 << 0;
/// The sensor moved before its offset was known.
pub const APLOMB_FLAG_MOVED: u32 = 1_u32 << 1;
/// Samples before this one were lost.
pub const APLOMB_FLAG_MISSED: u32 = 1_u32 << 2;
/// No sample came for more than half a second. Roll and pitch restarted from gravity. A shorter
/// pause of more than 3.5 sample periods has no flag of its own. Its sigma grows: after 61 ms in
/// flight, the attitude may be `APLOMB_FLAG_DEGRADED` for 13 s (docs/faults.md).
pub const APLOMB_FLAG_GAP: u32 = 1_u32 << 3;
/// The sample's time is not after the previous one. The attitude is held.
pub const APLOMB_FLAG_TIME: u32 = 1_u32 << 4;
/// A gyroscope axis reads full scale.
pub const APLOMB_FLAG_GYROSCOPE_SATURATED: u32 = 1_u32 << 5;
/// An accelerometer axis reads full scale.
pub const APLOMB_FLAG_ACCELEROMETER_SATURATED: u32 = 1_u32 << 6;
/// The specific force is too small to show where down is.
pub const APLOMB_FLAG_FREE_FALL: u32 = 1_u32 << 7;
/// The data repeat to the last bit: the sensor sleeps, or the bus or an axis is stuck. The attitude
/// is held.
pub const APLOMB_FLAG_FROZEN: u32 = 1_u32 << 8;
/// The sample was not a measurement and was ignored.
pub const APLOMB_FLAG_REJECTED: u32 = 1_u32 << 9;
/// The tilt is wrong by no more than the larger of 5 degrees and six sigma.
pub const APLOMB_FLAG_VALID: u32 = 1_u32 << 10;
/// The attitude is less certain than usual.
pub const APLOMB_FLAG_DEGRADED: u32 = 1_u32 << 11;
/// No sample came: the attitude is the last one, and its sigma grows.
pub const APLOMB_FLAG_STALE: u32 = 1_u32 << 12;
/// Bursts have failed since the previous sample. The caller reports it, as the next five.
pub const APLOMB_FLAG_BUS_FAULT: u32 = 1_u32 << 13;
/// The sensor had lost its settings, and has been configured again.
pub const APLOMB_FLAG_SENSOR_RESET: u32 = 1_u32 << 14;
/// A sample was lost because the previous one was still being processed.
pub const APLOMB_FLAG_LATE: u32 = 1_u32 << 15;
/// The die is outside -40 to 85 degrees Celsius.
pub const APLOMB_FLAG_TEMPERATURE: u32 = 1_u32 << 16;
/// Samples are polled: their time is uncertain by one period.
pub const APLOMB_FLAG_POLLED: u32 = 1_u32 << 17;
/// Times are those of an internal oscillator, accurate to 8 %. The attitude goes by the sensor's
/// clock, so the time of a burst has to be that of its edge, unless it was polled.
pub const APLOMB_FLAG_INTERNAL_CLOCK: u32 = 1_u32 << 18;
/// The heading is wrong by no more than the larger of 15 degrees and six sigma.
pub const APLOMB_FLAG_HEADING_VALID: u32 = 1_u32 << 19;
/// The compass gives no usable readings. The caller reports it. The attitude does not depend on it.
pub const APLOMB_FLAG_COMPASS_FAULT: u32 = 1_u32 << 20;
/// Vibration is so strong that the accelerometer may clip: the tilt can be wrong by degrees.
pub const APLOMB_FLAG_VIBRATION: u32 = 1_u32 << 21;
/// The full scales have been read back since the previous burst or sample, and are right. The
/// caller reports it. No attitude has this flag.
pub const APLOMB_FLAG_SCALES_VERIFIED: u32 = 1_u32 << 31;

/// Result of a function. `aplomb_status_text` describes it.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AplombStatus {
    /// Done.
    Ok = 0,
    /// A pointer is null.
    NullPointer = 1,
    /// The memory holds no pipeline of this program: call `aplomb_init` first.
    NotInitialised = 2,
    /// The mount is no name such as "+x-z", "z-up" or "z-down".
    WrongMount = 3,
    /// The ranges are 2, 4, 8 or 16 g, and 250, 500, 1000 or 2000 degrees per second.
    WrongRange = 4,
    /// The low-pass filters are 256, 188, 98, 42, 20, 10 and 5 Hz.
    WrongLowPass = 5,
    /// No part of the family answers WHO_AM_I like this. Begin with `aplomb_default_settings`.
    UnknownPart = 6,
    /// No more steps or checks: the list is complete.
    NoMoreSteps = 7,
    /// The bytes hold no whole record or state, or one of another version.
    NoRecord = 8,
    /// A number of the calibration is not finite.
    NotStorable = 9,
    /// The knowledge of the accelerometer or of the compass is none of its values.
    WrongKnowledge = 10,
    /// The declination is no angle from -pi to pi.
    WrongDeclination = 11,
    /// The offset of the accelerometer exceeds 0.2 g, or its matrix is more than 0.1 from the
    /// identity.
    WrongAccelerometer = 12,
    /// The offset of the gyroscope exceeds 41 degrees per second. It is in rad/s.
    WrongGyroscopeOffset = 13,
    /// The gyroscope's matrix is more than 0.1 from the identity.
    WrongGyroscopeMatrix = 14,
    /// The level is no unit quaternion, or tilts by more than 15 degrees.
    WrongLevel = 15,
    /// The sensor's delay exceeds a tenth of a second.
    WrongDelay = 16,
    /// The temperature model gives an offset above 41 degrees per second. It is in rad/s.
    WrongTemperatureOffset = 17,
    /// The temperature model's reference is not between its coldest and its warmest temperature, or
    /// no part can report one of them.
    WrongTemperatureRange = 18,
    /// The time is before that of the last sample. A clock of 32 bits has wrapped.
    WrongTime = 19,
    /// The compass's matrix is no correction: its mean gain is 0.1 to 10. All nine numbers
    /// are needed: 1, 0, 0, 0, 1, 0, 0, 0, 1 for hard iron alone.
    WrongCompass = 20,
    /// No compass gives this field, or the reading is older than a second: an age below zero has
    /// wrapped.
    WrongField = 21,
    /// No rest has measured the gyroscope's offset yet: there is no state to go on from.
    NoState = 22,
}

/// Fourteen bytes that the sensor returned from register 0x3B on.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct AplombBurst {
    /// Time of the data-ready edge, µs since start.
    pub captured_at_us: u64,
    /// Bytes as the sensor sent them.
    pub bytes: [u8; 14],
    /// Samples lost since the previous burst.
    pub missed_before: u8,
    /// Zero; reserved.
    pub reserved: u8,
    /// Flags that the caller reports: bus fault, sensor reset, late, polled, internal clock,
    /// compass fault, scales verified.
    pub board_flags: u32,
}

impl AplombBurst {
    /// Returns the burst of the library, and the caller's flags.
    fn converted(&self) -> (Burst, BoardFlags) {
        let burst = Burst {
            bytes: self.bytes,
            captured_at_us: self.captured_at_us,
            missed_before: self.missed_before,
        };
        let board = BoardFlags::from_bits_truncate(self.board_flags);
        (burst, board)
    }
}

/// Sample in SI units and in the sensor's axes, as the sensor read it. The calibration and the
/// mount of the settings are applied, as to a burst. For samples that are calibrated already, leave
/// the calibration empty, and set `accelerometer_knowledge`. `sample_rate_divider` has to match the
/// rate of the samples.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AplombSample {
    /// Time of the sample, µs since start.
    pub t_us: u64,
    /// Specific force, m/s². A sensor that lies face up reads +9.81 along z.
    pub specific_force_m_s2: [f32; 3],
    /// Angular rate, rad/s.
    pub angular_rate_rad_s: [f32; 3],
    /// Not 0 if an axis of the accelerometer reads full scale.
    pub is_force_saturated: u8,
    /// Not 0 if an axis of the gyroscope reads full scale.
    pub is_rate_saturated: u8,
    /// Flags that the caller reports, as with a burst.
    pub board_flags: u32,
}

impl AplombSample {
    /// Returns the sample of the library, calibrated and in body axes, and the caller's flags.
    fn converted(&self, pipeline: &Pipeline) -> (Sample, BoardFlags) {
        let vector = |[x, y, z]: [f32; 3]| Vector3::new(x, y, z);
        let force = vector(self.specific_force_m_s2);
        let rate = vector(self.angular_rate_rad_s);
        let mut sample = pipeline.calibrated_sample(self.t_us, force, rate);
        sample.is_force_saturated = self.is_force_saturated != 0;
        sample.is_rate_saturated = self.is_rate_saturated != 0;
        (sample, BoardFlags::from_bits_truncate(self.board_flags))
    }
}

/// Attitude at one moment, with its sigma and flags.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AplombSnapshot {
    /// Time of the sample, µs since start.
    pub t_us: u64,
    /// Quaternion w, x, y, z from body (forward, right, down) to earth (north, east, down).
    pub attitude: [f32; 4],
    /// Body rates p, q, r without bias, rad/s: those of the sample. The attitude is extrapolated to
    /// `t_us`, so the rates are older by the sensor's delay.
    pub body_rates_rad_s: [f32; 3],
    /// Right wing down positive, rad.
    pub roll_rad: f32,
    /// Nose up positive, rad.
    pub pitch_rad: f32,
    /// Clockwise from above positive, rad, relative to the heading at start.
    pub yaw_rad: f32,
    /// Sigma of the direction of down, both axes together, rad. Infinite if unknown.
    pub tilt_sigma_rad: f32,
    /// Sum of `APLOMB_FLAG_…`.
    pub flags: u32,
    /// Direction of forward, clockwise from north, rad in (-pi, pi]: yaw plus offset. Zero if
    /// unknown.
    pub heading_rad: f32,
    /// Sigma of the heading, rad. Infinite without a compass and while the heading is unknown.
    pub heading_sigma_rad: f32,
    /// Heading minus yaw, rad in (-pi, pi]. Zero if unknown.
    pub yaw_offset_rad: f32,
}

impl From<Snapshot> for AplombSnapshot {
    fn from(snapshot: Snapshot) -> Self {
        let (attitude, rates) = (snapshot.attitude, snapshot.body_rates_rad_s);
        let angles = snapshot.euler();
        Self {
            t_us: snapshot.t_us,
            attitude: [attitude.w, attitude.x, attitude.y, attitude.z],
            body_rates_rad_s: [rates.x, rates.y, rates.z],
            roll_rad: angles.roll_rad,
            pitch_rad: angles.pitch_rad,
            yaw_rad: angles.yaw_rad,
            tilt_sigma_rad: snapshot.tilt_sigma_rad(),
            flags: snapshot.flags.bits(),
            heading_rad: 0.0,
            heading_sigma_rad: f32::INFINITY,
            yaw_offset_rad: 0.0,
        }
    }
}

/// Returns the version of the library, such as "0.1.0". It differs from `APLOMB_VERSION` if the
/// header is that of another library.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_version() -> *const c_char {
    const VERSION: &str = concat!(env!("CARGO_PKG_VERSION"), "\0");
    VERSION.as_ptr().cast()
}

/// Returns what a status means and what to do, in English. Takes any number.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_status_text(status: u32) -> *const c_char {
    const TEXTS: [&CStr; 23] = [
        c"done",
        c"a pointer is null",
        c"the memory holds no pipeline of this program: call aplomb_init first",
        c"the mount is no name such as +x-z, z-up or z-down",
        c"the ranges are 2, 4, 8 or 16 g, and 250, 500, 1000 or 2000 degrees per second",
        c"the low-pass filters are 256, 188, 98, 42, 20, 10 and 5 Hz",
        c"no part answers WHO_AM_I like this: begin with aplomb_default_settings",
        c"there are no more steps or checks: the list is complete",
        c"the bytes hold no whole record or state, or one of another version",
        c"a number of the calibration is not finite",
        c"the knowledge of the accelerometer or of the compass is none of its values",
        c"the declination is no angle from -pi to pi",
        c"the accelerometer's offset exceeds 0.2 g, or its matrix is over 0.1 from the identity",
        c"the gyroscope's offset exceeds 41 degrees per second: it is in rad/s",
        c"the gyroscope's matrix is more than 0.1 from the identity: set all nine numbers",
        c"the level is no unit quaternion, or tilts by more than 15 degrees",
        c"the sensor's delay exceeds a tenth of a second, 100000 microseconds",
        c"the temperature model gives an offset above 41 degrees per second: it is in rad/s",
        c"the temperature model's reference is not in its range, or that is not in -80 to 135 C",
        c"the time is before that of the last sample: extend a clock of 32 bits",
        c"the compass's matrix is no correction: set all nine numbers, 1 on the diagonal for none",
        c"no compass gives this field, or its age is over a second: an age below zero has wrapped",
        c"no rest has measured the gyroscope's offset yet: there is no state to go on from",
    ];
    let text = TEXTS.get(status as usize).copied();
    text.unwrap_or(c"this is no status of aplomb").as_ptr()
}

/// Starts a pipeline with these settings, in memory with any contents. After an error the memory
/// holds no pipeline.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_init(
    pipeline: Option<&mut AplombPipeline>,
    settings: Option<&AplombSettings>,
) -> AplombStatus {
    status_of(start(pipeline, settings))
}

/// Processes one burst. Writes the attitude at the burst's time.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_update_burst(
    pipeline: Option<&mut AplombPipeline>,
    burst: Option<&AplombBurst>,
    snapshot: Option<&mut AplombSnapshot>,
) -> AplombStatus {
    with(pipeline, burst, snapshot, |pipeline, burst| {
        let (burst, board) = burst.converted();
        Ok(pipeline.update(&burst, board))
    })
}

/// Processes one sample in SI units and sensor axes, by the calibration and the mount of the
/// settings. Writes the attitude at the sample's time.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_update_sample(
    pipeline: Option<&mut AplombPipeline>,
    sample: Option<&AplombSample>,
    snapshot: Option<&mut AplombSnapshot>,
) -> AplombStatus {
    with(pipeline, sample, snapshot, |pipeline, sample| {
        let (sample, board) = sample.converted(pipeline);
        Ok(pipeline.update_sample_with(&sample, board))
    })
}

/// Writes the attitude for a time without a sample, µs since start: the last one, flagged
/// `APLOMB_FLAG_STALE`, with a sigma that grows. A time before the last sample gives
/// `APLOMB_STATUS_WRONG_TIME`, and no attitude.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_stale(
    pipeline: Option<&mut AplombPipeline>,
    t_us: u64,
    snapshot: Option<&mut AplombSnapshot>,
) -> AplombStatus {
    with(pipeline, Some(&t_us), snapshot, |pipeline, t_us| {
        stale(pipeline, *t_us)
    })
}

/// Returns whether the rate has jumped as if the gyroscope's full scale had changed. Then read the
/// settings back, and report `APLOMB_FLAG_SCALES_VERIFIED` with the next burst or sample if they
/// are right. Until then no attitude is valid. False without a pipeline, or unless
/// `verifies_scales` is set.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_awaits_scale_check(pipeline: Option<&mut AplombPipeline>) -> bool {
    state::pipeline(pipeline).is_ok_and(|pipeline| pipeline.awaits_scale_check())
}

/// Switches between ground and flight. Armed, the filter makes no zero-rate and no zero-velocity
/// updates, so it cannot mistake a steady turn for a rest.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(no_mangle)]
pub extern "C" fn aplomb_set_armed(
    pipeline: Option<&mut AplombPipeline>,
    is_armed: bool,
) -> AplombStatus {
    let armed = state::pipeline(pipeline).map(|pipeline| pipeline.set_armed(is_armed));
    status_of(armed)
}

/// Does nothing. Its name has a number that only this header has: a program with the header of
/// another library does not link. The macros `aplomb_init` and `aplomb_compass_init` call it.
#[allow(unsafe_code, reason = "C finds the function by this name")]
#[unsafe(export_name = "aplomb_header_b39d4de0")]
pub extern "C" fn aplomb_header() {}

/// Returns the attitude for a time without a sample.
fn stale(pipeline: &Pipeline, t_us: u64) -> Result<Snapshot, AplombStatus> {
    if t_us < pipeline.sample().t_us {
        return Err(AplombStatus::WrongTime);
    }
    Ok(pipeline.stale(t_us, BoardFlags::empty()))
}

/// Stores a pipeline with these settings. Moves it as little as possible: it is large for a stack.
fn start(
    state: Option<&mut AplombPipeline>,
    settings: Option<&AplombSettings>,
) -> Result<(), AplombStatus> {
    let state = not_null(state)?;
    state.clear();
    let settings = not_null(settings)?;
    let checked = settings.checked()?;
    let accelerometer = settings.accelerometer()?;
    state.put(Pipeline::new(&checked));
    if let Some(knowledge) = accelerometer {
        state::pipeline(Some(state))?.set_accelerometer_knowledge(knowledge);
    }
    Ok(())
}

/// Calls a function of the pipeline with this input, and writes its snapshot.
fn with<I>(
    pipeline: Option<&mut AplombPipeline>,
    input: Option<&I>,
    snapshot: Option<&mut AplombSnapshot>,
    call: impl FnOnce(&mut Pipeline, &I) -> Result<Snapshot, AplombStatus>,
) -> AplombStatus {
    status_of((|| {
        let (input, out) = (not_null(input)?, not_null(snapshot)?);
        *out = call(state::pipeline(pipeline)?, input)?.into();
        Ok(())
    })())
}

/// Returns what a pointer points to.
fn not_null<T>(pointer: Option<T>) -> Result<T, AplombStatus> {
    pointer.ok_or(AplombStatus::NullPointer)
}

/// Returns the status of a result.
fn status_of(result: Result<(), AplombStatus>) -> AplombStatus {
    result.err().unwrap_or(AplombStatus::Ok)
}

/// Stops: no function of this library panics, so nothing calls it.
#[cfg(target_os = "none")]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    loop {}
}
