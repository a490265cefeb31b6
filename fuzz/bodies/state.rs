//! Random bytes as a filter's state, from a flight log or from RAM after a reset: later samples
//! still give attitudes.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::kalman::WarmStart;
use aplomb::health::BoardFlags;
use aplomb::mpu6050::{Burst, Part};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::serialize::{StateReader, StateWriter};

/// Bytes of a burst, its distance from the last one in ms, and the board's flags.
const STEP: usize = 14 + 2;

/// Limit of bias and σ, rad/s and rad: twice the sensor's range.
const USUAL: f32 = 70.0;

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
    let mut t_us = 1_000;
    let is_restored = kind & 8 == 0;
    let before = if is_restored { kind >> 4 } else { 0 };
    for _ in 0..before {
        t_us += 1_000;
        let mut bytes = [0x11; 14];
        bytes[13] = t_us as u8;
        pipeline.update(&burst(bytes, t_us), BoardFlags::empty());
    }
    let rest = if is_restored {
        let (changed, rest) = rest.split_at(rest.len().min(3 * usize::from(*changes)));
        restored(&mut pipeline, changed);
        rest
    } else {
        let Some((known, rest)) = rest.split_first_chunk() else {
            return;
        };
        resumed(&mut pipeline, known);
        rest
    };
    for step in rest.as_chunks::<STEP>().0 {
        let [bytes @ .., pause, flags] = *step;
        t_us += 1_000 * (1 + u64::from(pause).pow(2));
        let bits = u32::from(flags) << 13 | u32::from(flags) << 24;
        let flags = BoardFlags::from_bits_truncate(bits);
        let burst = burst(bytes, t_us);
        let snapshot = pipeline.update(&burst, flags);
        let stale = pipeline.stale(t_us + 5_000, flags);
        // After a state that no filter can reach, only finite output is required.
        if !is_restored {
            check(&snapshot);
            check(&stale);
        }
    }
}

/// Applies changes to the pipeline's state; a refused state changes nothing.
fn restored(pipeline: &mut Pipeline, changes: &[u8]) {
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

fn read(mut pipeline: Pipeline, state: &[u8]) -> Option<Pipeline> {
    let mut reader = StateReader::new(state);
    pipeline.visit_state(&mut reader);
    reader.is_complete().then_some(pipeline)
}

fn written(pipeline: &mut Pipeline) -> Vec<u8> {
    let mut bytes = vec![0; 4096];
    let mut window = StateWriter::new(&mut bytes, 0);
    pipeline.visit_state(&mut window);
    let length = window.length().expect("it goes into bytes");
    bytes.truncate(length);
    bytes
}

/// State of an earlier run, as kept in RAM.
fn resumed(pipeline: &mut Pipeline, bytes: &[u8; 48]) {
    let [w, x, y, z, tilt, p, q, r, bias, forward, right, velocity] =
        std::array::from_fn(|place| f32::from_le_bytes(bytes.as_chunks().0[place]));
    let attitude = Quaternion::new(w, x, y, z);
    // The firmware keeps the state of a filter, and checks that the attitude is a rotation.
    let is_usual = [tilt, p, q, r, bias, forward, right, velocity]
        .iter()
        .all(|number| number.abs() <= USUAL);
    let is_rotation = (attitude.dot(attitude) - 1.0).abs() < 0.01;
    if !is_usual || !is_rotation {
        return;
    }
    pipeline.resume(&WarmStart {
        attitude: attitude.normalize(),
        tilt_sigma_rad: tilt,
        bias_rad_s: Vector3::new(p, q, r),
        bias_sigma_rad_s: bias,
        accelerometer_bias_m_s2: [forward, right],
        squared_velocity_m2_s2: velocity,
    });
}

fn burst(bytes: [u8; 14], captured_at_us: u64) -> Burst {
    Burst {
        bytes,
        captured_at_us,
        missed_before: 0,
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
