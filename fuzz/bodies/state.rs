//! Random bytes as the filters' state, from a flight log or from RAM after a reset: later samples
//! still give attitudes and headings.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::heading::CompassKnowledge;
use aplomb::estimator::kalman::WarmStart;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, Part};
use aplomb::pipeline::{CompassPipeline, Pipeline, Settings, Snapshot};
use aplomb::serialize::{StateReader, StateWriter};
use aplomb::units::MagneticField;

/// Bytes of a burst, its distance from the last one in ms, and the board's flags.
const STEP: usize = 14 + 2;

/// Changes bytes of a state, each by its offset and bits, and uses the rest as bursts.
///
/// # Panics
///
/// Panics if an invariant is violated.
pub fn run(bytes: &[u8]) {
    let [kind, changes, rest @ ..] = bytes else {
        return;
    };
    let settings = Settings {
        verifies_scales: kind & 1 != 0,
        ..Settings::new(&Part::MPU_6050)
    };
    let mut pipeline = Pipeline::new(&settings);
    let is_restored = kind & 8 == 0;
    let mut rest = rest;
    if !is_restored {
        let Some((known, later)) = rest.split_first_chunk() else {
            return;
        };
        resumed(&mut pipeline, known);
        rest = later;
    }
    let knowledge = [
        CompassKnowledge::Factory,
        CompassKnowledge::HardIron,
        CompassKnowledge::Calibrated,
        CompassKnowledge::Calibrated,
    ];
    let knowledge = knowledge[usize::from(kind >> 1 & 3)];
    let mut pipeline = CompassPipeline::with_pipeline(pipeline, knowledge);
    let mut t_us = 1_000;
    if is_restored {
        // Up to 0.5 s: longer than a step of the heading.
        for _ in 0..32 * u32::from(kind >> 4) {
            t_us += 1_000;
            let mut bytes = [0x11; 14];
            bytes[13] = t_us as u8;
            pipeline.update(&burst(bytes, t_us), BoardFlags::empty());
            pipeline.update_field(field([20, 1, 44]), 0);
        }
        let (changed, later) = rest.split_at(rest.len().min(3 * usize::from(*changes)));
        restored(&mut pipeline, changed);
        rest = later;
    }
    for step in rest.as_chunks::<STEP>().0 {
        let [bytes @ .., pause, flags] = *step;
        t_us += 1_000 * (1 + u64::from(pause).pow(2));
        let bits = u32::from(flags) << 13 | u32::from(flags) << 24;
        let flags = BoardFlags::from_bits_truncate(bits);
        let burst = burst(bytes, t_us);
        let snapshot = pipeline.update(&burst, flags);
        let stale = pipeline.pipeline().stale(t_us + 5_000, flags);
        let [x, y, z, age, ..] = bytes;
        pipeline.update_field(field([x, y, z]), 100 * u32::from(age));
        // After a state that no filter can reach, nothing may panic, and no more is required.
        if !is_restored {
            check(&snapshot);
            check(&stale);
            check_heading(&pipeline);
        }
    }
}

/// Applies changes to the pipeline's state; a refused state changes nothing.
fn restored(pipeline: &mut CompassPipeline, changes: &[u8]) {
    let mut state = written(pipeline);
    for [high, low, bits] in changes.as_chunks().0 {
        let place = usize::from(u16::from_be_bytes([*high, *low]));
        let length = state.len();
        state[place % length] ^= bits;
    }
    let Some(mut changed) = read(*pipeline, &state) else {
        return;
    };
    // Bytes without a meaning are not kept; a state that is written once reads back unchanged.
    let state = written(&mut changed);
    let mut again = read(*pipeline, &state).expect("what was written is read");
    assert!(written(&mut again) == state, "it does not come back");
    *pipeline = changed;
}

fn read(mut pipeline: CompassPipeline, state: &[u8]) -> Option<CompassPipeline> {
    let mut reader = StateReader::new(state);
    pipeline.visit_state(&mut reader);
    reader.is_complete().then_some(pipeline)
}

fn written(pipeline: &mut CompassPipeline) -> Vec<u8> {
    let mut bytes = vec![0; 8192];
    let mut window = StateWriter::new(&mut bytes, 0);
    pipeline.visit_state(&mut window);
    let length = window.length().expect("it goes into bytes");
    bytes.truncate(length);
    bytes
}

/// Continues from any state of an earlier run, damaged ones included.
fn resumed(pipeline: &mut Pipeline, bytes: &[u8; 60]) {
    let [
        w,
        x,
        y,
        z,
        tilt,
        p,
        q,
        r,
        dp,
        dq,
        dr,
        bias,
        forward,
        right,
        velocity,
    ] = std::array::from_fn(|place| f32::from_le_bytes(bytes.as_chunks().0[place]));
    let start = WarmStart {
        attitude: Quaternion::new(w, x, y, z),
        tilt_sigma_rad: tilt,
        bias_rad_s: Vector3::new(p, q, r),
        bias_change_rad_s: Vector3::new(dp, dq, dr),
        bias_sigma_rad_s: bias,
        accelerometer_bias_m_s2: [forward, right],
        squared_velocity_m2_s2: velocity,
    };
    pipeline.resume(&start, 0);
}

fn burst(bytes: [u8; 14], captured_at_us: u64) -> Burst {
    Burst {
        bytes,
        captured_at_us,
        missed_before: 0,
    }
}

/// A field of up to 127 µT per axis.
fn field(bytes: [u8; 3]) -> MagneticField {
    MagneticField {
        ut: bytes.map(|byte| f32::from(byte.cast_signed())),
    }
}

fn check_heading(pipeline: &CompassPipeline) {
    if let Some(heading) = pipeline.heading() {
        let is_angle = heading.yaw_offset_rad.abs() < 3.2;
        assert!(is_angle && heading.sigma_rad >= 0.0, "{heading:?}");
    }
}

fn check(snapshot: &Snapshot) {
    let attitude = snapshot.attitude;
    let length = attitude.dot(attitude);
    assert!((length - 1.0).abs() < 1e-3, "{attitude:?}");
    let rates = snapshot.body_rates_rad_s;
    assert!(
        rates.x.is_finite() && rates.y.is_finite() && rates.z.is_finite(),
        "{rates:?}"
    );
    let variance = snapshot.tilt_variance_rad2;
    assert!(variance >= 0.0, "{variance}");
}
