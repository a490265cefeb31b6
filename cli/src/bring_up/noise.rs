//! Noise of the sensor at rest: Allan deviation and noise density, from a flight log.
//!
//! The overlapping estimator is that of IEEE Std 952-1997, annex C. White noise of the one-sided
//! density n has the Allan deviation n/√(2τ). So the density is read at 0.1 s, near the 10 Hz of
//! the datasheet.

use std::path::Path;

use aplomb::mpu6050::{Config, RawSample};
use aplomb::units::{STANDARD_GRAVITY_M_S2, degrees};
use aplomb_plot::chart::{Chart, Curve, FIRST, Panel, SECOND, Style, THIRD, TRUTH};
use aplomb_recordings::flight_log;

use super::report::Finding;

/// Sample rate of the module, 1/s.
const RATE_HZ: f64 = 1_000.0;
/// Averaging time at which the density is read, s.
const DENSITY_AT_S: f64 = 0.1;
/// Typical densities of the product specification, 6.1 and 6.2: °/s/√Hz and mg/√Hz.
const GYROSCOPE_DENSITY: f64 = 0.005;
const ACCELEROMETER_DENSITY: f64 = 0.4;
/// Largest and smallest ratio to those.
const MOST_RATIO: f64 = 2.5;
const LEAST_RATIO: f64 = 0.2;
/// Fewest samples.
const LEAST_SAMPLES: usize = 2_000;
/// Points of a curve per decade.
const POINTS: f64 = 8.0;

/// Readings of one sensor, by axis.
type Axes = [Vec<f64>; 3];

/// Allan deviations of one axis: averaging times in s with their values.
type Allan = Vec<(f64, f64)>;

/// Returns the overlapping Allan deviation of samples at this interval.
fn allan(samples: &[f64], interval_s: f64) -> Allan {
    let mut sums = vec![0.0];
    let mut sum = 0.0;
    // Without the mean, so that the sums stay small.
    let mean = samples.iter().sum::<f64>() / samples.len().max(1) as f64;
    sums.extend(samples.iter().map(|sample| {
        sum += sample - mean;
        sum
    }));
    let mut points = Allan::new();
    let mut length = 1;
    for step in 0.. {
        let next = 10_f64.powf(f64::from(step) / POINTS).round() as usize;
        if next * 5 > samples.len() {
            break;
        }
        if step > 0 && next == length {
            continue;
        }
        length = next;
        let differences = sums.windows(2 * length + 1).map(|window| {
            let (first, middle, last) = (window[0], window[length], window[2 * length]);
            (last - 2.0 * middle + first) / length as f64
        });
        let (count, squares) = differences.fold((0_usize, 0.0), |(count, squares), difference| {
            (count + 1, squares + difference * difference)
        });
        let variance = squares / (2.0 * count.max(1) as f64);
        points.push((length as f64 * interval_s, variance.sqrt()));
    }
    points
}

/// Returns the noise density of a curve, per √Hz.
fn density(curve: &Allan) -> Option<f64> {
    let distance = |(at_s, _): &&(f64, f64)| (at_s / DENSITY_AT_S).ln().abs();
    let nearest = curve
        .iter()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
    Some(nearest.1 * (2.0 * nearest.0).sqrt())
}

/// Readings of a log: mg and °/s.
fn readings(path: &Path) -> Result<(Axes, Axes), String> {
    let log = flight_log::read(path)?;
    let flight = log.flight(None)?;
    let (mut forces, mut rates) = (Axes::default(), Axes::default());
    for step in log.steps(flight)? {
        let raw = RawSample::decode(&step.numbered.burst.bytes);
        let force = raw
            .accelerometer
            .to_m_s2(Config::DEFAULT.accelerometer_range);
        let rate = raw.gyroscope.to_rad_s(Config::DEFAULT.gyroscope_range);
        let mg = 1_000.0 / STANDARD_GRAVITY_M_S2;
        for (axis, value) in forces.iter_mut().zip([force.x, force.y, force.z]) {
            axis.push(f64::from(value * mg));
        }
        for (axis, value) in rates.iter_mut().zip([rate.x, rate.y, rate.z]) {
            axis.push(f64::from(degrees(value)));
        }
    }
    Ok((forces, rates))
}

/// Judges the noise in a flight log, and draws its Allan deviation.
pub fn judge(log: &Path) -> Result<(Finding, Vec<u8>), String> {
    let (forces, rates) = readings(log)?;
    let samples = rates[0].len();
    if samples < LEAST_SAMPLES {
        let reason = format!("{samples} samples are too few for it: a longer --rest");
        return Err(reason);
    }
    let curves = |axes: &Axes| axes.each_ref().map(|axis| allan(axis, 1.0 / RATE_HZ));
    let (forces, rates) = (curves(&forces), curves(&rates));
    let worst = |curves: &[Allan; 3], typical: f64| {
        let densities = curves
            .each_ref()
            .map(|curve| density(curve).unwrap_or(f64::NAN));
        let is_good = densities
            .iter()
            .all(|density| (LEAST_RATIO..=MOST_RATIO).contains(&(density / typical)));
        (densities, is_good)
    };
    let (force_densities, is_quiet) = worst(&forces, ACCELEROMETER_DENSITY);
    let (rate_densities, is_steady) = worst(&rates, GYROSCOPE_DENSITY);
    let lowest = |curve: &Allan| {
        curve
            .iter()
            .map(|point| point.1)
            .fold(f64::INFINITY, f64::min)
    };
    let [gx, gy, gz] = rate_densities;
    let [ax, ay, az] = force_densities.map(|density| 1_000.0 * density);
    let saw = format!(
        "gyroscope {gx:.4}, {gy:.4}, {gz:.4} deg/s/rtHz (typical 0.005); \
         accelerometer {ax:.0}, {ay:.0}, {az:.0} ug/rtHz (typical 400)"
    );
    let details = format!(
        "lowest Allan deviation: gyroscope {:.4} deg/s, accelerometer {:.3} mg; {samples} samples",
        rates.iter().map(lowest).fold(0.0, f64::max),
        forces.iter().map(lowest).fold(0.0, f64::max),
    );
    let finding = Finding::new(is_quiet && is_steady, saw)
        .advise(
            "repeat it on a firm table, away from fans and steps; noise that stays is the supply's \
             or a damaged part's",
        )
        .with_details(details);
    Ok((finding, picture(&rates, &forces)))
}

/// Draws the curves over the logarithm of the averaging time, as PNG.
fn picture(rates: &[Allan; 3], forces: &[Allan; 3]) -> Vec<u8> {
    let logarithms = |curve: &Allan| -> Vec<(f64, f64)> {
        let points = curve.iter().filter(|(_, value)| *value > 0.0);
        points
            .map(|(at_s, value)| (at_s.log10(), value.log10()))
            .collect()
    };
    let panel = |name: &str, curves: &[Allan; 3], typical: f64| {
        let expected = |curve: &Allan| -> Allan {
            let at = |(at_s, _): &(f64, f64)| (*at_s, typical / (2.0 * at_s).sqrt());
            curve.iter().map(at).collect()
        };
        let typical = (TRUTH, "typical", expected(&curves[0]));
        let axes = [(FIRST, "x"), (SECOND, "y"), (THIRD, "z")]
            .into_iter()
            .zip(curves);
        let axes = axes.map(|((color, name), curve)| (color, name, curve.clone()));
        let lines: Vec<_> = [typical].into_iter().chain(axes).collect();
        let values = lines.iter().flat_map(|(_, _, curve)| logarithms(curve));
        let range = values.fold((f64::INFINITY, f64::NEG_INFINITY), |range, (_, value)| {
            (range.0.min(value.floor()), range.1.max(value.ceil()))
        });
        Panel {
            name: name.to_owned(),
            curves: lines
                .into_iter()
                .map(|(color, meaning, curve)| Curve {
                    color,
                    lines: vec![logarithms(&curve)],
                    meaning: meaning.to_owned(),
                    style: Style::Line(2.0),
                })
                .collect(),
            range,
            is_logarithmic: true,
            annotations: Vec::new(),
        }
    };
    let end_s = rates[0].last().map_or(1.0, |point| point.0);
    Chart {
        width: 1_000,
        height: 760,
        title: "Allan deviation of the sensor at rest".to_owned(),
        subtitle: "typical: white noise of the product specification's density".to_owned(),
        legend: Vec::new(),
        time_s: ((1.0 / RATE_HZ).log10(), end_s.log10()),
        time_name: "power of ten of the averaging time in s",
        panels: vec![
            panel("gyroscope, deg/s", rates, GYROSCOPE_DENSITY),
            panel("accelerometer, mg", forces, ACCELEROMETER_DENSITY),
        ],
        shades: Vec::new(),
        lanes: Vec::new(),
        others: Vec::new(),
    }
    .draw()
    .png()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White noise from a linear congruential generator: sums of twelve uniform numbers.
    fn white(sigma: f64, count: usize) -> Vec<f64> {
        let mut state = 7_u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..count)
            .map(|_| sigma * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0))
            .collect()
    }

    #[test]
    fn white_noise_has_its_density_at_every_averaging_time() {
        // 0.005 per rtHz, one-sided, at 1 kHz.
        let curve = allan(&white(0.005 * 500_f64.sqrt(), 60_000), 1e-3);
        for (at_s, value) in curve.iter().filter(|(at_s, _)| *at_s < 0.3) {
            let expected = 0.005 / (2.0 * at_s).sqrt();
            assert!((value / expected - 1.0).abs() < 0.1, "{at_s}: {value}");
        }
        let density = density(&curve).expect("a curve");
        assert!((density / 0.005 - 1.0).abs() < 0.1, "{density}");
    }

    #[test]
    fn an_alternation_and_a_ramp_have_their_closed_forms() {
        let alternating: Vec<f64> = (0..1_000).map(|n| f64::from(n % 2)).collect();
        // Neighbours differ by 1: sqrt(1/2). Pairs do not differ.
        let curve = allan(&alternating, 1.0);
        assert!((curve[0].1 - 0.5_f64.sqrt()).abs() < 1e-12 && curve[1].1 < 1e-12);
        let ramp: Vec<f64> = (0..1_000).map(f64::from).collect();
        for (at_s, value) in allan(&ramp, 1.0) {
            assert!(
                (value - at_s / 2_f64.sqrt()).abs() < 1e-6,
                "{at_s}: {value}"
            );
        }
    }
}
