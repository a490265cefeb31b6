//! `aplomb plot`: a recording, or the attitudes that came of one, as a picture.
//!
//! Every row is read once and kept as what the picture can show of it, so that an hour takes no more memory than a minute; but
//! a flight log is read as a whole.

use std::error::Error;
use std::path::{Path, PathBuf};

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::calibration::Mount;
use aplomb::health::Flags;
use aplomb::units::{degrees, radians};
use aplomb_models::motion::geometry::Quaternion as Truth;
use aplomb_models::motion::{self, inclination_error_rad};
use aplomb_plot::chart::{
    Axis, Chart, Curve, FIRST, NARROWEST_DEG, Panel, SECOND, THIRD, TRUTH, error_panel, flag_lanes,
};
use aplomb_plot::timeline::{Merge, Timeline, Trace};
use aplomb_recordings::log::{Lines, LogFault, column_count, parse_row};
use aplomb_recordings::motion::body_to_earth;

use crate::attitude_table::Columns;
use crate::flight_log;
use crate::input;
use crate::output::OutputFile;
use crate::progress;
use crate::replay::{Kind, Point, Reading, Source};
use crate::spectrum::{Spectrum, Vibration, Welch};

const WIDTH: u32 = 1600;
/// The height of a panel with its name, and of what is above and beneath all of them.
const PANEL_HEIGHT: u32 = 215;
const MARGINS: u32 = 190;
const LANE_HEIGHT: u32 = 17;

/// Rows of a truth that are further away in time than this say nothing of an attitude, µs.
const TRUTH_WITHIN_US: u64 = 5_000;

/// The spectrum is shown over so many powers of ten, beneath its peak.
const DECADES: f64 = 7.0;

/// Draw a recording, or the attitudes that came of one.
///
/// INPUT is an attitude.csv (of `replay`, or of `cargo xtask fly`), or whatever `replay` reads: a log, a bursts.csv or a flight
/// log, which goes through the filter first. The picture shows roll, pitch, yaw and rates; where there is truth, the inclination error and
/// the filter's 3 sigma (the figure is over rows with mov 1 after 5 s, as in `replay`); which flags were set when, and when the attitude was not valid; and of a recording the spectrum of the specific force, with
/// the peak of the vibration.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb plot flight.log --output flight.png
  aplomb plot target/fly/attitude.csv --truth target/fly/truth.csv
  aplomb plot recording.csv.gz --filter classic --output classic.svg")]
pub struct Options {
    #[command(flatten)]
    reading: Reading,
    /// A file with the true attitudes at the same times: the truth.csv of a flight, or a log with truth
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// The picture, by its name a PNG or an SVG file
    #[arg(long, value_name = "OUT.png|OUT.svg", default_value = "plot.png")]
    output: PathBuf,
}

/// Does it.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let (input, output) = (&options.reading.input, &options.output);
    let is_vector = match output.extension().and_then(|extension| extension.to_str()) {
        Some("png") => false,
        Some("svg") => true,
        _ => {
            return Err(format!(
                "{}: the name has to end with .png or .svg, which says what to draw",
                output.display()
            )
            .into());
        }
    };
    let shown = if flight_log::is_one(input) {
        let log = flight_log::read(input)?;
        let flights = log.flown().count();
        let flight = if options.reading.flight.is_none() && flights > 1 {
            crate::say(&format!(
                "{}: the module started {flights} times in it; this is its longest flight",
                input.display()
            ));
            log.flown()
                .max_by_key(|flight| flight.bursts.len())
                .ok_or("there is no flight in it")?
        } else {
            log.flight(options.reading.flight)
                .map_err(|reason| format!("{}: {reason}", input.display()))?
        };
        let mut source = options.reading.open_flight(flight)?;
        let mount = source.mount();
        options.show(&mut source, mount)?
    } else {
        let mut lines = progress::lines(input)?;
        let mount = options.reading.mount();
        match Columns::of(&input::header(&mut lines)?) {
            Some(columns) => {
                let has_truth = options.truth.is_some();
                options.reading.check(Kind::Attitudes { has_truth })?;
                options.show(&mut Table { lines, columns }, mount)?
            }
            None => {
                lines.unread();
                options.show(&mut *options.reading.open(lines)?, mount)?
            }
        }
    };
    let name = input.file_name().unwrap_or(input.as_os_str());
    if shown.rows == 0 {
        return Err(format!("{}: there is no row after the header", input.display()).into());
    }
    if let Some(path) = options.truth.as_ref().filter(|_| shown.errors.is_empty()) {
        return Err(format!(
            "{}: none of its times is one of {}",
            path.display(),
            input.display()
        )
        .into());
    }
    let picture = shown.chart(&name.to_string_lossy()).draw();
    let contents = match is_vector {
        true => picture.svg().into_bytes(),
        false => picture.png(),
    };
    let mut inputs = vec![input.as_path()];
    inputs.extend(options.truth.as_deref());
    OutputFile::write(output, &inputs, &contents)?;
    crate::say(&format!("{}: {}", output.display(), shown.summary()));
    Ok(())
}

impl Options {
    /// Reads everything, with the truth as a sensor of this mount has it.
    fn show(&self, source: &mut dyn Source, mount: Mount) -> Result<Shown, Box<dyn Error>> {
        let mut truth = match &self.truth {
            Some(path) => Some(TruthFile::open(path, mount)?),
            None => None,
        };
        Shown::of(source, mount, truth.as_mut())
    }
}

/// What the picture shows.
struct Shown {
    rows: u64,
    start_us: i64,
    end_us: i64,
    /// Roll, pitch and yaw, in degrees.
    angles: [Trace; 3],
    true_angles: [Trace; 3],
    /// What has to be added to the true yaw: the estimate's zero is the heading at its start.
    heading_degrees: Option<f64>,
    /// About forward, right and down, in degrees per second.
    rates: [Trace; 3],
    errors: Trace,
    /// Over the rows that count.
    squares: f64,
    scored: u64,
    three_sigma: Trace,
    flags: Timeline<FlagPiece>,
    /// So many rows, if flags are known.
    valid: Option<u64>,
    welch: Welch,
    has_force: bool,
}

/// The flags that were set at any time of a piece, and those that were set all the time.
#[derive(Clone, Copy)]
struct FlagPiece {
    any: Flags,
    all: Flags,
}

impl Merge for FlagPiece {
    fn merge(&mut self, later: &Self) {
        self.any |= later.any;
        self.all = self.all & later.all;
    }
}

impl Shown {
    fn of(
        source: &mut dyn Source,
        mount: Mount,
        mut truth: Option<&mut TruthFile>,
    ) -> Result<Self, Box<dyn Error>> {
        let mut shown = Self {
            rows: 0,
            start_us: 0,
            end_us: 0,
            angles: [(); 3].map(|()| Trace::of_angles()),
            true_angles: [(); 3].map(|()| Trace::of_angles()),
            heading_degrees: None,
            rates: Default::default(),
            errors: Trace::default(),
            squares: 0.0,
            scored: 0,
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
                    let row = file.at(point.t_us)?;
                    point.counts = row.is_some_and(|row| row.counts);
                    row.and_then(|row| row.attitude)
                }
                None => point.truth.map(|truth| body_to_earth(truth, mount)),
            };
            shown.add(&point, truth);
        }
        Ok(shown)
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
        if point.is_scored(self.start_us) {
            self.squares += error * error;
            self.scored += 1;
        }
        if let Some(sigma_rad) = point.tilt_sigma_rad {
            self.three_sigma
                .push(time_s, 3.0 * f64::from(degrees(sigma_rad)));
        }
        let [roll, pitch, yaw] = truth.to_euler_degrees();
        let is_ready = !point.flags.contains(Flags::CALIBRATING);
        if is_ready && self.heading_degrees.is_none() {
            self.heading_degrees = Some(angles[2] - yaw);
        }
        // Where the headings are not compared yet, there is nothing to draw.
        let yaw = self
            .heading_degrees
            .map_or(f64::NAN, |heading| yaw + heading);
        for (trace, angle) in self.true_angles.iter_mut().zip([roll, pitch, yaw]) {
            trace.push(time_s, angle);
        }
    }

    fn chart(&self, name: &str) -> Chart {
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

    /// When a flag was set; of `VALID`, when it was set all the time.
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

    /// In one line.
    fn summary(&self) -> String {
        let mut text = format!("{} rows in {:.1} s", self.rows, self.seconds());
        if let Some(valid) = self.valid {
            let share = 100.0 * valid as f64 / self.rows.max(1) as f64;
            text += &format!("; valid {share:.1} % of the time");
        }
        if self.scored > 0 {
            let rms = (self.squares / self.scored as f64).sqrt();
            text += &format!("; inclination error {rms:.2} degrees rms");
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

/// The three densities, over frequency.
fn spectrum_panel(spectrum: &Spectrum) -> (Panel, Axis) {
    // The lowest values are the motion and the means that were removed.
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
    let mut remarks = Vec::new();
    if let Some(peak_hz) = spectrum.vibration().and_then(|found| found.peak_hz) {
        let index = (peak_hz / spectrum.step_hz).round() as usize;
        let highest = spectrum.axes.iter().map(|axis| axis[index]);
        let highest = highest.fold(1e-30, f64::max).log10().clamp(low, high);
        remarks.push(((peak_hz, highest), format!("{peak_hz:.0} Hz")));
    }
    let panel = Panel {
        name: "specific force, power spectral density ((m/s²)²/Hz)".to_owned(),
        curves,
        range: (low, high),
        is_logarithmic: true,
        remarks,
    };
    let axis = Axis {
        end: spectrum.end_hz(),
        name: "frequency (Hz)",
    };
    (panel, axis)
}

/// The same mount, for the truth.
fn modelled(mount: Mount) -> Result<motion::Mount, String> {
    let name = mount.name();
    motion::Mount::parse(name).ok_or_else(|| format!("{name} is no mount of a recording"))
}

/// The rows of an attitude.csv, or of a truth.csv.
struct Table {
    lines: Lines,
    columns: Columns,
}

impl Source for Table {
    fn next(&mut self) -> Result<Option<Point>, Box<dyn Error>> {
        let Some(line) = self.lines.next_line()? else {
            return Ok(None);
        };
        let parsed = self.columns.row(line);
        let row = parsed.map_err(|reason| format!("{}: {reason}", self.lines.place()))?;
        let [p, q, r] = row.rates_deg_s.unwrap_or_default().map(radians);
        Ok(Some(Point {
            t_us: row.t_us,
            attitude: row.attitude.quaternion(),
            body_rates_rad_s: Vector3::new(p, q, r),
            tilt_sigma_rad: row.tilt_sigma_deg.map(radians),
            flags: row.flags.unwrap_or(Flags::empty()),
            specific_force_m_s2: None,
            truth: None,
            counts: row.counts,
        }))
    }

    fn has_flags(&self) -> bool {
        self.columns.has_flags()
    }
}

/// What is true at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct TrueRow {
    /// µs.
    t_us: i64,
    /// Body to earth, if it is known.
    attitude: Option<Truth>,
    /// Whether the row counts for scores.
    counts: bool,
}

/// The next row; `None` after the last.
type NextRow = dyn FnMut() -> Result<Option<TrueRow>, Box<dyn Error>>;

/// True attitudes over time, read along.
struct TruthFile {
    rows: Box<NextRow>,
    before: Option<TrueRow>,
    after: Option<TrueRow>,
}

impl TruthFile {
    fn open(path: &Path, mount: Mount) -> Result<Self, Box<dyn Error>> {
        let mount = modelled(mount)?;
        let mut lines = progress::lines(path)?;
        let header = lines.next_line()?.unwrap_or_default().to_owned();
        let mut file = if let Some(columns) = Columns::of(&header) {
            let mut table = Table { lines, columns };
            Self::new(move || {
                let point = table.next()?;
                Ok(point.map(|point| {
                    let Quaternion { w, x, y, z } = point.attitude;
                    let truth = Truth::new(w.into(), x.into(), y.into(), z.into());
                    TrueRow {
                        t_us: point.t_us,
                        attitude: Some(truth),
                        counts: point.counts,
                    }
                }))
            })
        } else if let Some(columns) = column_count(&header).filter(|columns| *columns > 7) {
            Self::new(move || {
                let Some(line) = lines.next_line()? else {
                    return Ok(None);
                };
                let row = parse_row(line, columns).map_err(|fault| lines.refuse(fault))?;
                Ok(Some(TrueRow {
                    t_us: row.time_us,
                    attitude: row.attitude.map(|truth| body_to_earth(truth, mount)),
                    counts: row.moving,
                }))
            })
        } else {
            let refused = lines.refuse(LogFault::Header(header));
            return Err(format!(
                "{refused}; or t_us,qw,qx,qy,qz,… or t_us,roll_deg,pitch_deg,yaw_deg,… for truth"
            )
            .into());
        };
        file.after = (file.rows)()?;
        Ok(file)
    }

    fn new(rows: impl FnMut() -> Result<Option<TrueRow>, Box<dyn Error>> + 'static) -> Self {
        Self {
            rows: Box::new(rows),
            before: None,
            after: None,
        }
    }

    /// The row nearest to this time, if it is near. Times do not go back.
    fn at(&mut self, t_us: i64) -> Result<Option<TrueRow>, Box<dyn Error>> {
        while let Some(after) = self.after
            && after.t_us < t_us
        {
            self.before = Some(after);
            self.after = (self.rows)()?;
        }
        let distance = |row: &TrueRow| row.t_us.abs_diff(t_us);
        let nearest = self
            .after
            .into_iter()
            .chain(self.before)
            .min_by_key(distance);
        Ok(nearest.filter(|row| distance(row) <= TRUTH_WITHIN_US))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb::attitude::EulerAngles;

    #[test]
    fn the_truth_is_the_nearest_if_it_is_near() {
        let attitude = |nth: i64| Truth::from_euler(nth as f64, 0.0, 0.0);
        let mut times = [0, 10_000, 50_000].into_iter();
        let row = move |t_us| TrueRow {
            t_us,
            attitude: Some(attitude(t_us)),
            counts: true,
        };
        let mut file = TruthFile::new(move || Ok(times.next().map(row)));
        file.after = (file.rows)().unwrap();
        for (t_us, expected) in [
            (-4_000, Some(0)),
            (0, Some(0)),
            (1_000, Some(0)),
            (9_000, Some(10_000)),
            (10_000, Some(10_000)),
            (14_000, Some(10_000)),
            (16_000, None),
            (46_000, Some(50_000)),
            (54_000, Some(50_000)),
            (60_000, None),
        ] {
            assert_eq!(file.at(t_us).unwrap(), expected.map(row), "{t_us}");
        }
    }

    /// Rows of a body that turns about down, whose heading is told from another zero; with an offset that is not known at first.
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
                counts: true,
            }))
        }
    }

    #[test]
    fn headings_are_compared_from_when_the_offset_is_known() {
        let shown = Shown::of(&mut Turning(0), Mount::Z_UP, None).unwrap();
        // Nothing counts in the first five seconds.
        assert_eq!((shown.errors.is_empty(), shown.scored), (false, 0));
        let (estimate, truth) = (&shown.angles[2], &shown.true_angles[2]);
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
        let spans = shown.spans(Flags::CALIBRATING);
        assert_eq!(spans.len(), 1);
        assert!(
            spans[0].0 == 0.0 && (spans[0].1 - 0.1).abs() < 2e-3,
            "{spans:?}"
        );
        assert!(shown.spans(Flags::GAP).is_empty());
    }
}
