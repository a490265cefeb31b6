//! The figure: traces of everything that a plot shows, in little memory.

use std::error::Error;

use aplomb::attitude::Quaternion;
use aplomb::calibration::Mount;
use aplomb::health::Flags;
use aplomb::units::degrees;
use aplomb_models::motion::geometry::Quaternion as Truth;
use aplomb_models::motion::inclination_error_rad;
use aplomb_plot::chart::{
    Axis, Chart, Curve, FIRST, NARROWEST_DEG, Panel, SECOND, THIRD, TRUTH, error_panel, flag_lanes,
};
use aplomb_plot::timeline::{Merge, Timeline, Trace};
use aplomb_recordings::motion::body_to_earth;

use super::spectrum::{Spectrum, Vibration, Welch};
use super::truth::{TruthFile, modelled};
use crate::source::{Point, Source};

const WIDTH: u32 = 1600;
/// Height of a panel with its name.
const PANEL_HEIGHT: u32 = 215;
/// Height of everything above and below the panels.
const MARGINS: u32 = 190;
const LANE_HEIGHT: u32 = 17;

/// Powers of ten that the spectrum shows below its peak.
const DECADES: f64 = 7.0;

/// Contents of the picture.
pub struct Figure {
    /// Rows that were read.
    pub rows: u64,
    start_us: i64,
    end_us: i64,
    /// Roll, pitch and yaw, degrees.
    angles: [Trace; 3],
    true_angles: [Trace; 3],
    /// Estimated yaw minus the true one at the first comparison: the estimate starts at zero.
    yaw_difference_deg: Option<f64>,
    /// Rates about forward, right and down, degrees per second.
    rates: [Trace; 3],
    /// Inclination errors, in degrees.
    pub errors: Trace,
    /// Sum of the squared errors of the rows that count.
    squares: f64,
    scored: u64,
    /// The rows have a truth too, beside that of the file.
    pub has_two_truths: bool,
    three_sigma: Trace,
    flags: Timeline<FlagPiece>,
    /// Number of valid rows, if flags are known.
    valid: Option<u64>,
    welch: Welch,
    has_force: bool,
}

/// Flags of a piece of time: set at any time, and set all the time.
#[derive(Clone, Copy)]
struct FlagPiece {
    any: Flags,
    all: Flags,
}

impl Merge for FlagPiece {
    fn merge(&mut self, later: &Self) {
        self.any |= later.any;
        self.all &= later.all;
    }
}

impl Figure {
    /// Reads all rows. `truth` replaces the truth of the rows.
    pub fn read(
        source: &mut dyn Source,
        mount: Mount,
        mut truth: Option<&mut TruthFile>,
    ) -> Result<Self, Box<dyn Error>> {
        let mut figure = Self {
            rows: 0,
            start_us: 0,
            end_us: 0,
            angles: [(); 3].map(|()| Trace::of_angles()),
            true_angles: [(); 3].map(|()| Trace::of_angles()),
            yaw_difference_deg: None,
            rates: Default::default(),
            errors: Trace::default(),
            squares: 0.0,
            scored: 0,
            has_two_truths: false,
            three_sigma: Trace::default(),
            flags: Timeline::default(),
            valid: source.has_flags().then_some(0),
            welch: Welch::new(),
            has_force: false,
        };
        let mount = modelled(mount)?;
        while let Some(mut point) = source.next()? {
            let truth = match &mut truth {
                Some(file) => {
                    figure.has_two_truths |= point.truth.is_some();
                    let row = file.at(point.t_us)?;
                    point.scored = row.is_some_and(|row| row.scored);
                    row.and_then(|row| row.attitude)
                }
                None => point.truth.map(|truth| body_to_earth(truth, mount)),
            };
            figure.add(&point, truth);
        }
        Ok(figure)
    }

    fn add(&mut self, point: &Point, truth: Option<Truth>) {
        if self.rows == 0 {
            self.start_us = point.t_us;
        }
        self.rows += 1;
        self.end_us = self.end_us.max(point.t_us);
        let time_s = point.t_us.saturating_sub(self.start_us) as f64 * 1e-6;
        let Quaternion { w, x, y, z } = point.attitude;
        let attitude = Truth::new(w.into(), x.into(), y.into(), z.into());
        let angles = attitude.to_euler_degrees();
        for (trace, angle) in self.angles.iter_mut().zip(angles) {
            trace.push(time_s, angle);
        }
        let rates = point.body_rates_rad_s;
        for (trace, rate) in self.rates.iter_mut().zip([rates.x, rates.y, rates.z]) {
            trace.push(time_s, degrees(rate).into());
        }
        self.flags.push(
            time_s,
            FlagPiece {
                any: point.flags,
                all: point.flags,
            },
        );
        if let Some(valid) = &mut self.valid {
            *valid += u64::from(point.flags.contains(Flags::VALID));
        }
        if let Some(force) = point.specific_force_m_s2 {
            self.has_force = true;
            let force = [force.x, force.y, force.z].map(f64::from);
            self.welch.add(time_s, force);
        }
        let Some(truth) = truth else { return };
        let error = inclination_error_rad(attitude, truth).to_degrees();
        self.errors.push(time_s, error);
        if point.is_scored_after_start(self.start_us) {
            self.squares += error * error;
            self.scored += 1;
        }
        if let Some(sigma_rad) = point.tilt_sigma_rad {
            self.three_sigma
                .push(time_s, 3.0 * f64::from(degrees(sigma_rad)));
        }
        let [roll, pitch, yaw] = truth.to_euler_degrees();
        let is_ready = !point.flags.contains(Flags::CALIBRATING);
        if is_ready && self.yaw_difference_deg.is_none() {
            self.yaw_difference_deg = Some(angles[2] - yaw);
        }
        // Before the difference is known, the true yaw has no place.
        let yaw = self
            .yaw_difference_deg
            .map_or(f64::NAN, |difference_deg| yaw + difference_deg);
        for (trace, angle) in self.true_angles.iter_mut().zip([roll, pitch, yaw]) {
            trace.push(time_s, angle);
        }
    }

    /// Returns the chart.
    pub fn chart(&self, name: &str) -> Chart {
        let mut panels = vec![
            self.angle_panel("roll (degrees)", 0),
            self.angle_panel("pitch (degrees)", 1),
            self.angle_panel("yaw, relative (degrees)", 2),
            self.rate_panel(),
        ];
        if !self.errors.is_empty() {
            let three_sigma = Some(&self.three_sigma).filter(|trace| !trace.is_empty());
            panels.push(error_panel(&self.errors, three_sigma));
        }
        let spectrum = self.welch.spectrum();
        let others: Vec<_> = spectrum.as_ref().map(spectrum_panel).into_iter().collect();
        let flags = Flags::all()
            .iter_names()
            .map(|(name, flag)| (name, self.spans(flag)));
        let lanes = flag_lanes(flags, "VALID");
        let height = PANEL_HEIGHT * (panels.len() + others.len()) as u32
            + LANE_HEIGHT * lanes.len() as u32
            + MARGINS;
        Chart {
            width: WIDTH,
            height,
            title: name.to_owned(),
            subtitle: self.summary(),
            legend: Vec::new(),
            time_s: (0.0, self.seconds().max(1e-3)),
            time_name: "time since the first row (s)",
            panels,
            shades: Vec::new(),
            lanes,
            others,
        }
    }

    fn seconds(&self) -> f64 {
        self.end_us.saturating_sub(self.start_us) as f64 * 1e-6
    }

    fn angle_panel(&self, name: &str, index: usize) -> Panel {
        let color = [FIRST, SECOND, THIRD][index];
        let mut curves = vec![(color, "estimate", &self.angles[index])];
        if !self.true_angles[index].is_empty() {
            curves.insert(0, (TRUTH, "truth", &self.true_angles[index]));
        }
        Panel::around(name, NARROWEST_DEG, curves)
    }

    fn rate_panel(&self) -> Panel {
        let [p, q, r] = &self.rates;
        let curves = vec![
            (THIRD, "about down", r),
            (SECOND, "about right", q),
            (FIRST, "about forward", p),
        ];
        Panel::around("body rates (degrees per second)", NARROWEST_DEG, curves)
    }

    /// Returns when a flag was set at any time; for `VALID`, when it was set all the time.
    fn spans(&self, flag: Flags) -> Vec<(f64, f64)> {
        let mut spans: Vec<(f64, f64)> = Vec::new();
        for (start_s, end_s, piece) in self.flags.iter() {
            let flags = if flag == Flags::VALID {
                piece.all
            } else {
                piece.any
            };
            match spans.last_mut() {
                _ if !flags.contains(flag) => {}
                Some(last) if start_s - last.1 < 1e-6 => last.1 = end_s,
                _ => spans.push((start_s, end_s)),
            }
        }
        spans
    }

    /// Returns the summary in one line.
    pub fn summary(&self) -> String {
        let mut text = format!("{} rows in {:.1} s", self.rows, self.seconds());
        if let Some(valid) = self.valid {
            let share = 100.0 * valid as f64 / self.rows.max(1) as f64;
            text += &format!("; valid {share:.1} % of the time");
        }
        if self.scored > 0 {
            let rms = (self.squares / self.scored as f64).sqrt();
            text += &format!("; inclination error {rms:.2} degrees rms (mov 1, after 5 s)");
        } else if !self.errors.is_empty() {
            text += "; no inclination error, since no row with truth counts (mov 1, after 5 s)";
        }
        let vibration = self
            .welch
            .spectrum()
            .and_then(|spectrum| spectrum.vibration());
        match vibration {
            Some(Vibration {
                peak_hz,
                rms_m_s2,
                from_hz,
            }) => {
                text += &format!("; vibration {rms_m_s2:.2} m/s² rms above {from_hz:.0} Hz");
                if let Some(peak_hz) = peak_hz {
                    text += &format!(", peak at {peak_hz:.0} Hz");
                }
            }
            None if self.has_force => text += "; too short or too slow to show vibration",
            None => text += "; no spectrum, since there is no specific force in it",
        }
        text
    }
}

/// Returns the panel of the three densities over frequency.
fn spectrum_panel(spectrum: &Spectrum) -> (Panel, Axis) {
    // The lowest frequencies hold the motion, and the means that were removed.
    let points = |axis: &[f64]| -> Vec<(f64, f64)> {
        let points = axis.iter().enumerate().skip(1);
        points
            .map(|(index, power)| (index as f64 * spectrum.step_hz, power.max(1e-30).log10()))
            .collect()
    };
    let colors = [(FIRST, "forward"), (SECOND, "right"), (THIRD, "down")];
    let curves = colors.into_iter().zip(&spectrum.axes).rev();
    let curves: Vec<Curve> = curves
        .map(|((color, meaning), axis)| Curve {
            lines: vec![points(axis)],
            ..Curve::new(color, meaning, &Trace::default())
        })
        .collect();
    let all = curves.iter().flat_map(|curve| &curve.lines[0]);
    let (low, high) = all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), point| {
        (low.min(point.1), high.max(point.1))
    });
    let high = high.ceil().max(-20.0);
    let low = low.floor().max(high - DECADES).min(high - 1.0);
    let mut labels = Vec::new();
    if let Some(peak_hz) = spectrum.vibration().and_then(|found| found.peak_hz) {
        let index = (peak_hz / spectrum.step_hz).round() as usize;
        let highest = spectrum.axes.iter().map(|axis| axis[index]);
        let highest = highest.fold(1e-30, f64::max).log10().clamp(low, high);
        labels.push(((peak_hz, highest), format!("{peak_hz:.0} Hz")));
    }
    let panel = Panel {
        name: "specific force, power spectral density ((m/s²)²/Hz)".to_owned(),
        curves,
        range: (low, high),
        is_logarithmic: true,
        annotations: labels,
    };
    let axis = Axis {
        end: spectrum.end_hz(),
        name: "frequency (Hz)",
    };
    (panel, axis)
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb::attitude::{EulerAngles, Vector3};
    use aplomb::units::radians;
    use aplomb_models::motion;

    /// Rows of a body that turns about down. The truth has another heading, and the offset is
    /// unknown at first.
    struct Turning(i64);

    impl Source for Turning {
        fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
            let index = self.0;
            self.0 += 1;
            let is_ready = index >= 100;
            let yaw_degrees = index as f32 * 0.1 + if is_ready { 0.0 } else { 30.0 };
            let truth = Truth::from_euler(0.0, 0.0, (index as f64 * 0.1 + 70.0).to_radians());
            Ok((index < 1_000).then(|| Point {
                t_us: index * 1_000,
                attitude: Quaternion::from_euler(EulerAngles {
                    yaw_rad: radians(yaw_degrees),
                    ..EulerAngles::default()
                }),
                body_rates_rad_s: Vector3::ZERO,
                tilt_sigma_rad: Some(0.01),
                heading: None,
                flags: if is_ready {
                    Flags::VALID
                } else {
                    Flags::CALIBRATING
                },
                specific_force_m_s2: None,
                truth: Some(aplomb_recordings::motion::truth_of(
                    truth,
                    motion::Mount::Z_UP,
                )),
                scored: true,
            }))
        }
    }

    #[test]
    fn yaws_are_compared_from_when_the_gyroscopes_offset_is_known() {
        let figure = Figure::read(&mut Turning(0), Mount::Z_UP, None).unwrap();
        // Nothing counts in the first five seconds.
        assert_eq!((figure.errors.is_empty(), figure.scored), (false, 0));
        let (estimate, truth) = (&figure.angles[2], &figure.true_angles[2]);
        let of_truth = truth.lines().concat();
        assert_eq!(of_truth.len(), 900);
        for (at_s, yaw) in of_truth {
            assert!((yaw - at_s * 100.0).abs() < 1e-3, "{at_s} {yaw}");
        }
        let (low, high) = estimate.range().unwrap();
        assert!(
            (low - 10.0).abs() < 1e-3 && (high - 99.9).abs() < 1e-3,
            "{low} {high}"
        );
        // Flags are where they were.
        let spans = figure.spans(Flags::CALIBRATING);
        assert_eq!(spans.len(), 1);
        assert!(
            spans[0].0 == 0.0 && (spans[0].1 - 0.1).abs() < 2e-3,
            "{spans:?}"
        );
        assert!(figure.spans(Flags::GAP).is_empty());
    }
}
