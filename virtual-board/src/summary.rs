//! The figures of a run.

use std::collections::BTreeMap;

use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;
use serde::Serialize;

use crate::cycles::Work;
use crate::image::Firmware;
use crate::recorder::{Record, Sample};
use aplomb_models::motion::{Quaternion, heading_error_rad, inclination_error_rad};

/// Edges this close to the end may have their sample published after it, ns.
const IN_FLIGHT_NS: u64 = 2_000_000;

/// The figures, by the names that `summary.json` has.
///
/// "Instructions" are counted, not timed: the emulated core has no wait states and no cost of
/// exception entry.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Published samples.
    pub samples: usize,
    /// Data-ready edges without a published sample, from the first sample on. (While the firmware
    /// reads its settings back, the bus is not free, so an edge cannot have one.)
    pub missed: usize,
    /// Virtual time, from power-up.
    pub virtual_seconds: f64,
    /// Real time that the run took.
    pub wall_seconds: f64,
    /// Instructions per sample of all interrupts and of the attitude task.
    pub instructions_per_sample_mean: Option<f64>,
    /// The most for any sample.
    pub instructions_per_sample_max: Option<u64>,
    /// Instructions per sample of all interrupts, without the attitude task.
    pub io_instructions_per_sample_mean: Option<f64>,
    /// Upper estimate of the cycles of a sample on a chip, telemetry's accesses included (see
    /// [`crate::cycles`]).
    pub cycles_per_sample_estimate: Option<f64>,
    /// Instructions executed of those the core could have executed, from the first sample on, in
    /// percent.
    pub cpu_load_percent: Option<f64>,
    /// From the data-ready edge to the published attitude.
    pub edge_to_attitude_us_mean: Option<f64>,
    /// The longest of these.
    pub edge_to_attitude_us_max: Option<f64>,
    /// Upper estimate of the longest on a chip.
    pub edge_to_attitude_us_estimate: Option<f64>,
    /// The largest difference between a sample's published time and its edge's true time on the
    /// firmware's clock.
    pub timestamp_error_us_max: Option<f64>,
    /// Root mean square of the inclination error over the scored samples after the start-up
    /// average.
    pub inclination_rms_deg: Option<f64>,
    /// The largest inclination error among them.
    pub inclination_max_deg: Option<f64>,
    /// Share of the samples whose heading is valid, percent; absent without a valid heading.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heading_valid_percent: Option<f64>,
    /// Root mean square of the error of the valid headings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heading_rms_deg: Option<f64>,
    /// The largest error among them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub heading_max_deg: Option<f64>,
    /// Number of published attitudes with each flag, by the flag's name. Those without a sample are
    /// included.
    pub flags: BTreeMap<&'static str, usize>,
    /// Bytes of flash that the image fills.
    pub flash_bytes: u64,
    /// Bytes of RAM with an address at link time; the stack is apart.
    pub ram_bytes: u64,
    /// Bytes of stack that were ever used.
    pub stack_bytes_used: u64,
}

impl Summary {
    /// The figures of a run.
    #[must_use]
    pub fn of(record: &Record, firmware: &Firmware, core_hz: u64, wall_seconds: f64) -> Self {
        let samples = &record.samples;
        let (last_instruction, last_ns) = record.last;
        let instructions: Vec<u64> = samples
            .iter()
            .filter_map(|sample| sample.instructions)
            .collect();
        let input: Vec<f64> = samples
            .iter()
            .filter_map(|sample| sample.input_instructions)
            .map(|count| count as f64)
            .collect();
        let latencies_us: Vec<f64> = samples
            .iter()
            .filter_map(|sample| {
                Some(sample.published_ns.checked_sub(sample.edge?.time_ns)? as f64 / 1000.0)
            })
            .collect();
        let time_errors_us: Vec<f64> = samples
            .iter()
            .filter_map(|sample| Some((sample.snapshot.t_us as f64 - sample.true_t_us?).abs()))
            .collect();
        let inclinations_deg: Vec<f64> =
            samples.iter().filter_map(scored_inclination_deg).collect();
        let work = work(record);
        let headings_deg: Vec<f64> = samples.iter().filter_map(valid_heading_deg).collect();
        Self {
            samples: samples.len(),
            missed: missed(record),
            virtual_seconds: last_ns as f64 / 1e9,
            wall_seconds,
            instructions_per_sample_mean: mean(
                &instructions
                    .iter()
                    .map(|&count| count as f64)
                    .collect::<Vec<_>>(),
            ),
            instructions_per_sample_max: instructions.iter().copied().max(),
            io_instructions_per_sample_mean: mean(&input),
            cycles_per_sample_estimate: work.map(|work| work.cycles()),
            cpu_load_percent: record
                .first
                .filter(|&(_, first_ns)| last_ns > first_ns)
                .map(|(first_instruction, first_ns)| {
                    let available = (last_ns - first_ns) as f64 * 1e-9 * core_hz as f64;
                    100.0 * (last_instruction - first_instruction) as f64 / available
                }),
            edge_to_attitude_us_mean: mean(&latencies_us),
            edge_to_attitude_us_max: maximum(&latencies_us),
            edge_to_attitude_us_estimate: work
                .zip(maximum(&latencies_us))
                .map(|(work, longest_us)| work.edge_to_attitude_us(longest_us, core_hz)),
            timestamp_error_us_max: maximum(&time_errors_us),
            inclination_rms_deg: root_mean_square(&inclinations_deg),
            inclination_max_deg: maximum(&inclinations_deg),
            heading_valid_percent: (!headings_deg.is_empty())
                .then(|| 100.0 * headings_deg.len() as f64 / samples.len() as f64),
            heading_rms_deg: root_mean_square(&headings_deg),
            heading_max_deg: maximum(&headings_deg),
            flags: flags(record),
            flash_bytes: firmware.flash_bytes,
            ram_bytes: firmware.ram_bytes,
            stack_bytes_used: record.stack_bytes_used,
        }
    }
}

/// The counts of an average sample, if an account was kept.
fn work(record: &Record) -> Option<Work> {
    let counts = record
        .samples
        .iter()
        .filter_map(|sample| sample.instructions);
    let counts: Vec<f64> = counts.map(|count| count as f64).collect();
    let samples = record.samples.len() as f64;
    Some(Work {
        instructions: mean(&counts)?,
        exceptions: record.sample_exceptions as f64 / samples,
        accesses: record.accesses as f64 / samples,
    })
}

/// The inclination error of a sample in degrees, if the truth is known.
#[must_use]
pub fn inclination_deg(sample: &Sample) -> Option<f64> {
    let truth = sample.edge?.truth.attitude?;
    Some(inclination_error_rad(estimate(&sample.snapshot), truth).to_degrees())
}

/// The size of the error of a sample's valid heading in degrees, if the truth is known.
#[must_use]
pub fn valid_heading_deg(sample: &Sample) -> Option<f64> {
    let truth = sample.edge?.truth.attitude?;
    let offset_rad = f64::from(sample.valid_heading()?.yaw_offset_rad);
    let to_north = Quaternion::from_rotation_vector([0.0, 0.0, offset_rad]);
    let absolute = to_north.multiply(estimate(&sample.snapshot));
    Some(heading_error_rad(absolute, truth).to_degrees().abs())
}

/// Returns the published attitude in the models' numbers.
pub(crate) fn estimate(snapshot: &Snapshot) -> Quaternion {
    let attitude = snapshot.attitude;
    Quaternion {
        w: f64::from(attitude.w),
        x: f64::from(attitude.x),
        y: f64::from(attitude.y),
        z: f64::from(attitude.z),
    }
}

/// Returns the inclination error in degrees, if the sample counts.
fn scored_inclination_deg(sample: &Sample) -> Option<f64> {
    let is_scored =
        sample.edge?.truth.scored && !sample.snapshot.flags.contains(Flags::CALIBRATING);
    inclination_deg(sample).filter(|_| is_scored)
}

/// Counts the flags that occurred.
fn flags(record: &Record) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    let samples = record.samples.iter().map(|sample| sample.snapshot.flags);
    let stale = record.stale.iter().map(|stale| stale.snapshot.flags);
    for published in samples.chain(stale) {
        for (name, _) in published.iter_names() {
            *counts.entry(name).or_default() += 1;
        }
    }
    counts
}

/// Counts the edges without a sample, apart from those whose sample was still on its way at the
/// end.
fn missed(record: &Record) -> usize {
    let mut published: Vec<u64> = record
        .samples
        .iter()
        .filter_map(|sample| sample.edge)
        .map(|edge| edge.index)
        .collect();
    published.dedup();
    let in_flight_from_ns = record.last.1.saturating_sub(IN_FLIGHT_NS);
    let (Some(&first_published), Some(&last_published)) = (published.first(), published.last())
    else {
        return record.edges.len();
    };
    record
        .edges
        .iter()
        .filter(|edge| edge.index > first_published)
        .filter(|edge| edge.time_ns < in_flight_from_ns || edge.index < last_published)
        .filter(|edge| published.binary_search(&edge.index).is_err())
        .count()
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn root_mean_square(values: &[f64]) -> Option<f64> {
    let squares: Vec<f64> = values.iter().map(|value| value * value).collect();
    mean(&squares).map(f64::sqrt)
}

fn maximum(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(larger)
}

/// Returns the larger value: NaN if either is, because a NaN keeps no limit.
#[must_use]
pub fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() {
        f64::NAN
    } else {
        a.max(b)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_number_is_the_largest_value() {
        assert_eq!(maximum(&[]), None);
        assert_eq!(maximum(&[1.0, 3.0, 2.0]), Some(3.0));
        for values in [
            [f64::NAN, 1.0, 2.0],
            [1.0, f64::NAN, 2.0],
            [1.0, 2.0, f64::NAN],
        ] {
            assert!(maximum(&values).is_some_and(f64::is_nan), "{values:?}");
        }
    }
}
