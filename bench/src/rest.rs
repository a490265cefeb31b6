//! Rests of a recording: a check for recordings without truth.
//!
//! At rest the mean specific force points up. A filter with another "up" errs, by its start or by
//! the motion before. Errors of the accelerometer itself stay unseen. The search for rests uses no
//! filter.

use std::ops::Range;

use aplomb::attitude::Vector3;
use aplomb::estimator::Sample;

/// Length of a block, µs.
const BLOCK_US: u64 = 500_000;
/// Fewest blocks of a rest.
const FEWEST_BLOCKS: usize = 3;
/// Fewest samples of a block, so that noise shows.
const FEWEST_SAMPLES: usize = 10;
/// Largest range of a rate within a block: several times the noise of such a sensor (MPU-6050
/// product specification §6.1, §6.2), and less than a hand's tremor.
const LARGEST_RATE_SPREAD_RAD_S: f32 = aplomb::units::radians(3.0);
/// Largest range of a specific force within a block.
const LARGEST_FORCE_SPREAD_M_S2: f32 = 0.6;
/// Largest change of an axis' mean from a rest's first block to any other: one degree of tilt.
const LARGEST_FORCE_CHANGE_M_S2: f64 = 0.17;

/// Returns "up" in body axes for each sample of a rest: the direction of the mean specific force
/// over that rest.
pub fn up_at_rest(samples: &[Sample]) -> Vec<Option<[f64; 3]>> {
    let mut up = vec![None; samples.len()];
    for rest in rests(samples) {
        let mean = mean(&samples[rest.clone()], |sample| sample.specific_force_m_s2);
        let length = mean.iter().map(|part| part * part).sum::<f64>().sqrt();
        up[rest].fill(Some(mean.map(|part| part / length)));
    }
    up
}

fn rests(samples: &[Sample]) -> Vec<Range<usize>> {
    let mut rests = Vec::new();
    let mut blocks: Vec<Range<usize>> = Vec::new();
    for block in blocks_of(samples) {
        if !is_still(&samples[block.clone()]) {
            close(&mut blocks, &mut rests);
            continue;
        }
        let force = |block: &Range<usize>| {
            mean(&samples[block.clone()], |sample| sample.specific_force_m_s2)
        };
        let goes_on = blocks.first().is_none_or(|first| {
            let (first, now) = (force(first), force(&block));
            let mut changes = first
                .iter()
                .zip(now)
                .map(|(first, now)| (now - first).abs());
            changes.all(|change| change <= LARGEST_FORCE_CHANGE_M_S2)
        });
        if !goes_on {
            close(&mut blocks, &mut rests);
        }
        blocks.push(block);
    }
    close(&mut blocks, &mut rests);
    rests
}

/// Ends a rest, if it has enough blocks.
fn close(blocks: &mut Vec<Range<usize>>, rests: &mut Vec<Range<usize>>) {
    if let (Some(first), Some(last)) = (blocks.first(), blocks.last())
        && blocks.len() >= FEWEST_BLOCKS
    {
        rests.push(first.start..last.end);
    }
    blocks.clear();
}

fn blocks_of(samples: &[Sample]) -> Vec<Range<usize>> {
    let mut blocks = Vec::new();
    let mut start = 0;
    for (index, sample) in samples.iter().enumerate() {
        if sample.t_us.saturating_sub(samples[start].t_us) >= BLOCK_US {
            blocks.push(start..index);
            start = index;
        }
    }
    blocks.push(start..samples.len());
    blocks
}

fn is_still(block: &[Sample]) -> bool {
    block.len() >= FEWEST_SAMPLES
        && spread(block, |sample| sample.specific_force_m_s2) <= LARGEST_FORCE_SPREAD_M_S2
        && spread(block, |sample| sample.angular_rate_rad_s) <= LARGEST_RATE_SPREAD_RAD_S
}

/// Returns the largest range of an axis.
fn spread(block: &[Sample], of: fn(&Sample) -> Vector3) -> f32 {
    let ends = |axis: fn(Vector3) -> f32| {
        let values = block.iter().map(|sample| axis(of(sample)));
        let (low, high) = values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| {
            (low.min(value), high.max(value))
        });
        high - low
    };
    ends(|v| v.x).max(ends(|v| v.y)).max(ends(|v| v.z))
}

fn mean(samples: &[Sample], of: fn(&Sample) -> Vector3) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for vector in samples.iter().map(of) {
        for (sum, part) in sum.iter_mut().zip([vector.x, vector.y, vector.z]) {
            *sum += f64::from(part);
        }
    }
    sum.map(|sum| sum / samples.len() as f64)
}

#[cfg(test)]
mod tests {
    use aplomb::attitude::BodyVector;

    use super::*;

    /// Returns samples at 100 Hz: rest on one side until 3 s, a turn until 5 s, rest on another
    /// side until 10 s.
    fn turned_once() -> Vec<Sample> {
        let sample = |index: u64| {
            let time_s = index as f32 * 0.01;
            let turned = (time_s - 3.0).clamp(0.0, 2.0);
            let noise = 0.01 * (index % 5) as f32;
            let turning = (0.0..2.0).contains(&(time_s - 3.0));
            Sample::new(
                index * 10_000,
                BodyVector::new(noise, -9.8 * turned.sin(), -9.8 * turned.cos()),
                BodyVector::new(f32::from(u8::from(turning)) + 0.3, noise, 0.0),
            )
        };
        (0..1_000).map(sample).collect()
    }

    #[test]
    fn rests_are_found_with_their_direction_and_motion_is_not() {
        let samples = turned_once();
        let up = up_at_rest(&samples);
        for (index, angle) in [(0, 0.0_f64), (290, 0.0), (560, 2.0), (940, 2.0)] {
            let [_, y, z] = up[index].unwrap();
            assert!((y + angle.sin()).abs() < 0.01, "{index}: {y}");
            assert!((z + angle.cos()).abs() < 0.01, "{index}: {z}");
        }
        assert!(up[310..=490].iter().all(Option::is_none));
    }

    #[test]
    fn slow_turns_short_pauses_and_few_samples_are_no_rest() {
        // The mount turns by 3 °/s.
        let slow = |index: u64| {
            let turned = 0.05 * 0.01 * index as f32;
            Sample::new(
                index * 10_000,
                BodyVector::new(0.0, 9.8 * turned.sin(), -9.8 * turned.cos()),
                BodyVector::ZERO,
            )
        };
        let slow: Vec<Sample> = (0..3_000).map(slow).collect();
        assert!(rests(&slow).is_empty());
        assert!(rests(&turned_once()[..100]).is_empty());
        let rare: Vec<Sample> = turned_once().into_iter().step_by(10).collect();
        assert!(rests(&rare).is_empty());
        assert_eq!(up_at_rest(&[]), []);
    }
}
