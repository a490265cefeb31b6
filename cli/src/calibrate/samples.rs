//! Samples of a recording, as register counts.

use std::error::Error;

use aplomb::mpu6050::{AccelerometerRange, Config, GyroscopeRange, RawSample};
use aplomb::telemetry::bursts;
use aplomb::units::{DEGREES_PER_RADIAN, STANDARD_GRAVITY_M_S2};
use aplomb_recordings::counts::counts;
use aplomb_recordings::log::{Row, Rows};
use aplomb_recordings::plateau::Plateaus;

use crate::burst_rows::BurstRows;

/// Sample of a recording.
pub struct Sample {
    /// Time, µs.
    pub t_us: i64,
    /// Register counts.
    pub raw: RawSample,
    /// New reading of the compass, µT in sensor axes.
    pub field_ut: Option<[f64; 3]>,
}

/// Returns the samples of bursts.
pub fn read_bursts(mut rows: BurstRows) -> Result<Vec<Sample>, String> {
    let mut samples = Vec::new();
    while let Some(bursts::Row { burst, .. }) = rows.next_row()? {
        let t_us = i64::try_from(burst.captured_at_us)
            .map_err(|reason| format!("{}: t_us: {reason}", rows.place()))?;
        let raw = RawSample::decode(&burst.bytes);
        samples.push(Sample {
            t_us,
            raw,
            field_ut: None,
        });
    }
    Ok(samples)
}

/// Returns the rows with the numbers of their lines.
pub fn read_rows(mut reader: Rows) -> Result<Vec<(u64, Row)>, Box<dyn Error>> {
    let mut rows = Vec::new();
    while let Some(row) = reader.next_row()? {
        rows.push((reader.line(), row));
    }
    Ok(rows)
}

/// Returns the smallest ranges that hold a recording's values. The error has the line of the
/// largest value, if none holds it.
pub fn finest_config(rows: &[(u64, Row)]) -> Result<Config, (u64, String)> {
    let largest = |values: fn(&Row) -> [f64; 3]| {
        let norms = rows.iter().map(|(line, row)| {
            let largest = values(row).into_iter().map(f64::abs).fold(0.0, f64::max);
            (*line, largest)
        });
        norms.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or_default()
    };
    let (force_line, m_s2) = largest(|row| row.specific_force_m_s2);
    let (rate_line, rad_s) = largest(|row| row.rates_rad_s);
    let g = m_s2 / f64::from(STANDARD_GRAVITY_M_S2);
    let degrees_s = rad_s * f64::from(DEGREES_PER_RADIAN);
    let fits = |value: f64, counts: f32| value * f64::from(counts) < 32_767.0;
    let refuse = |value: f64, unit: &str| {
        format!(
            "{value:.1} {unit} is more than any range of the sensor: if the recording holds \
             counts, add --raw; else remove this row"
        )
    };
    let accelerometer_range = AccelerometerRange::ALL
        .into_iter()
        .find(|range| fits(g, range.counts_per_g()))
        .ok_or_else(|| (force_line, refuse(g, "g")))?;
    let gyroscope_range = GyroscopeRange::ALL
        .into_iter()
        .find(|range| fits(degrees_s, range.counts_per_degree_s()))
        .ok_or_else(|| (rate_line, refuse(degrees_s, "°/s")))?;
    Ok(Config::DEFAULT
        .with_accelerometer_range(accelerometer_range)
        .with_gyroscope_range(gyroscope_range))
}

/// Returns the values at which axes of a recording in SI units are clipped, with their message.
/// `None` if no axis is clipped.
pub fn find_plateaus(rows: &[(u64, Row)]) -> Option<(Plateaus, String)> {
    let mut plateaus = Plateaus::default();
    for (_, row) in rows {
        plateaus.check(row.specific_force_m_s2, row.rates_rad_s);
    }
    let message = plateaus.message()?;
    Some((plateaus, message))
}

/// Sets the largest of three axes to full scale.
fn saturate(counts: &mut [i16; 3]) {
    if let Some(largest) = counts.iter_mut().max_by_key(|count| count.unsigned_abs()) {
        *largest = if *largest < 0 { i16::MIN } else { i16::MAX };
    }
}

/// Converts rows to counts. Clipped values in SI units read full scale. The error has the line of
/// the fault.
pub fn to_samples(
    rows: &[(u64, Row)],
    config: &Config,
    is_raw: bool,
    mut clipped: Option<Plateaus>,
) -> Result<Vec<Sample>, (u64, String)> {
    let per_m_s2 =
        f64::from(config.accelerometer_range.counts_per_g()) / f64::from(STANDARD_GRAVITY_M_S2);
    let per_rad_s =
        f64::from(config.gyroscope_range.counts_per_degree_s()) * f64::from(DEGREES_PER_RADIAN);
    let to_sample = |(line, row): &(u64, Row)| {
        let [mut accelerometer, mut gyroscope] = if is_raw {
            counts(row).map_err(|reason| (*line, reason))?
        } else {
            [
                row.specific_force_m_s2
                    .map(|value| (value * per_m_s2).round() as i16),
                row.rates_rad_s
                    .map(|value| (value * per_rad_s).round() as i16),
            ]
        };
        if let Some(clipped) = &mut clipped {
            let is_clipped = clipped.check(row.specific_force_m_s2, row.rates_rad_s);
            if is_clipped.force {
                saturate(&mut accelerometer);
            }
            if is_clipped.rate {
                saturate(&mut gyroscope);
            }
        }
        let mut raw = RawSample::default();
        raw.accelerometer.0 = accelerometer;
        raw.gyroscope.0 = gyroscope;
        Ok(Sample {
            t_us: row.time_us,
            raw,
            field_ut: row.field_ut,
        })
    };
    rows.iter().map(to_sample).collect()
}
