//! Any bytes as what a filter remembers, from a flight log or from before a reset: the samples after it give attitudes.

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::estimator::FilterKind;
use aplomb::estimator::kalman::Known;
use aplomb::health::Flags;
use aplomb::mpu6050::{Burst, Part};
use aplomb::pipeline::{Pipeline, Settings, Snapshot};
use aplomb::state::{Reader, Window};

/// A burst's bytes, how many milliseconds it comes after the one before, and the board's flags.
const STEP: usize = 14 + 2;

/// No bias and no σ is larger, rad/s and rad: twice what the sensor can measure.
const USUAL: f32 = 70.0;

/// Changes so many bytes of a state, each by its place and its bits, and lets the rest be bursts.
///
/// # Panics
///
/// When something is not as it should be.
pub fn run(bytes: &[u8]) {
    let [kind, changes, rest @ ..] = bytes else {
        return;
    };
    let settings = Settings {
        filter: FilterKind::ALL[usize::from(kind & 3) % FilterKind::ALL.len()],
        averaging_samples: 0,
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
        pipeline.update(&burst(bytes, t_us));
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
        let flags = Flags::from_bits(u32::from(flags) << 13);
        let burst = burst(bytes, t_us);
        let snapshot = pipeline.update_flagged(&burst, flags);
        pipeline.collect(&burst);
        let stale = pipeline.stale(t_us + 5_000, flags);
        // Of a state that no filter was ever in, nothing is asked but that it does no harm.
        if !is_restored {
            check(&snapshot, &pipeline);
            check(&stale, &pipeline);
        }
    }
}

/// The pipeline's state with changes in it; what is refused changes nothing.
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
    // Bytes that mean nothing beside others are not kept; what is written once comes back.
    let state = written(&mut changed);
    let mut again = read(*pipeline, &state).expect("what was written is read");
    assert!(written(&mut again) == state, "it does not come back");
    *pipeline = changed;
}

fn read(mut pipeline: Pipeline, state: &[u8]) -> Option<Pipeline> {
    let mut reader = Reader::new(state);
    pipeline.exchange(&mut reader);
    reader.is_complete().then_some(pipeline)
}

fn written(pipeline: &mut Pipeline) -> Vec<u8> {
    let mut bytes = vec![0; 4096];
    let mut window = Window::new(&mut bytes, 0);
    pipeline.exchange(&mut window);
    let length = window.length().expect("it goes into bytes");
    bytes.truncate(length);
    bytes
}

/// What an earlier run knew, as it lay in RAM.
fn resumed(pipeline: &mut Pipeline, bytes: &[u8; 36]) {
    let [w, x, y, z, tilt, p, q, r, bias] =
        std::array::from_fn(|place| f32::from_le_bytes(bytes.as_chunks().0[place]));
    let attitude = Quaternion::new(w, x, y, z);
    // What the firmware keeps is what a filter had, and it looks whether what it finds is a rotation.
    let is_usual = [tilt, p, q, r, bias]
        .iter()
        .all(|number| number.abs() <= USUAL);
    let is_rotation = (attitude.dot(attitude) - 1.0).abs() < 0.01;
    if !is_usual || !is_rotation {
        return;
    }
    pipeline.resume(&Known {
        attitude: attitude.normalize(),
        tilt_sigma_rad: tilt,
        bias_rad_s: Vector3::new(p, q, r),
        bias_sigma_rad_s: bias,
    });
}

fn burst(bytes: [u8; 14], captured_at_us: u64) -> Burst {
    Burst {
        bytes,
        captured_at_us,
        missed_before: 0,
    }
}

fn check(snapshot: &Snapshot, pipeline: &Pipeline) {
    let attitude = snapshot.attitude;
    let length = attitude.dot(attitude);
    assert!((length - 1.0).abs() < 1e-3, "{attitude:?}");
    let rates = snapshot.body_rates_rad_s;
    assert!(
        rates.x.is_finite() && rates.y.is_finite() && rates.z.is_finite(),
        "{rates:?}"
    );
    let variance = pipeline.tilt_variance_rad2(snapshot.t_us);
    assert!(variance >= 0.0, "{variance}");
}
