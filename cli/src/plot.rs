//! `aplomb plot`: a recording, or the attitudes that came of one, as a picture.
//!
//! Every row is read once and merged into traces of fixed length, so an hour takes no more memory
//! than a minute.

mod figure;
mod spectrum;
mod truth;

use std::error::Error;
use std::path::{Path, PathBuf};

use aplomb::calibration::Mount;
use aplomb_recordings::attitude_table::Columns;
use aplomb_recordings::flight_log;
use aplomb_recordings::form::header;
use aplomb_recordings::output::OutputFile;
use aplomb_recordings::terminal::{print_line, print_message};

use crate::progress;
use crate::read_options::{Kind, ReadOptions};
use crate::source::Source;
use crate::usage::Usage;
use crate::vibration_monitor::VibrationMonitor;
use figure::Figure;
use truth::{Table, TruthFile};

/// Draw a recording, or the attitudes that came of one.
///
/// INPUT is an attitude.csv (of `replay`, or of `cargo xtask fly`), or whatever `replay` reads: a
/// recording, a bursts.csv or a flight log, which goes through the filter first. The picture shows
/// roll, pitch, yaw and rates; where there is truth, the inclination error and the filter's 3 sigma
/// (the figure is over rows with mov 1 after 5 s, as in `replay`); which flags were set when, and
/// when the attitude was not valid; and of a recording the spectrum of the specific force, with the
/// peak of the vibration.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb plot flight.log --output flight.png
  aplomb plot target/fly/attitude.csv --truth target/fly/truth.csv
  aplomb plot recording.csv.gz --filter classic --output classic.svg")]
pub struct Options {
    #[command(flatten)]
    reading: ReadOptions,
    /// A file with the true attitudes at the same times: the truth.csv of a flight, or a
    /// recording with truth, whose times have the unit of --time-unit too
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// The picture, by its name a PNG or an SVG file
    #[arg(long, value_name = "OUT.png|OUT.svg", default_value = "plot.png")]
    output: PathBuf,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let (input, output) = (&options.reading.input, &options.output);
    let is_vector = match output.extension().and_then(|extension| extension.to_str()) {
        Some("png") => false,
        Some("svg") => true,
        _ => {
            return Err(Usage::from(format!(
                "{}: the name has to end with .png or .svg, which says what to draw",
                output.display()
            ))
            .into());
        }
    };
    options.check_streams()?;
    let figure = if flight_log::is_flight_log(input) {
        let log = flight_log::read(input)?;
        let flights = log.flown().count();
        let flight = if options.reading.flight.is_none() && flights > 1 {
            print_line(&format!(
                "{}: the module started {flights} times in it; this is its longest flight",
                input.display()
            ));
            log.flown()
                .max_by_key(|flight| flight.bursts)
                .ok_or("there is no flight in it")?
        } else {
            log.flight(options.reading.flight)
                .map_err(|reason| format!("{}: {reason}", input.display()))?
        };
        let mut source = options.reading.open_flight(&log, flight)?;
        let mount = source.mount();
        options.figure(&mut source, mount, options.truth(mount)?)?
    } else {
        let mut lines = progress::lines(input)?;
        let mount = options.reading.mount();
        match Columns::of(&header(&mut lines)?) {
            Some(columns) => {
                let has_truth = options.truth.is_some();
                options.reading.check(Kind::Attitudes { has_truth })?;
                let truth = options.truth(mount)?;
                options.check_time_unit(truth.as_ref())?;
                options.figure(&mut Table { lines, columns }, mount, truth)?
            }
            None => {
                lines.unread();
                let mut source = options.reading.open(lines)?;
                options.figure(&mut *source, mount, options.truth(mount)?)?
            }
        }
    };
    let name = input.file_name().unwrap_or(input.as_os_str());
    if figure.rows == 0 {
        return Err(format!("{}: there is no row after the header", input.display()).into());
    }
    if let Some(path) = options.truth.as_ref().filter(|_| figure.errors.is_empty()) {
        return Err(format!(
            "{}: none of its times is one of {}",
            path.display(),
            input.display()
        )
        .into());
    }
    if let Some(path) = options.truth.as_ref().filter(|_| figure.has_two_truths) {
        print_message(&format!(
            "note: the truth is that of {}, not that of {}",
            path.display(),
            input.display()
        ));
    }
    let picture = figure.chart(&name.to_string_lossy()).draw();
    let contents = match is_vector {
        true => picture.svg().into_bytes(),
        false => picture.png(),
    };
    let mut inputs = options.reading.inputs();
    inputs.extend(options.truth.as_deref());
    OutputFile::write(output, &inputs, &contents)?;
    print_line(&format!("{}: {}", output.display(), figure.summary()));
    Ok(())
}

impl Options {
    /// Refuses standard input for both files: it can be read once.
    fn check_streams(&self) -> Result<(), Usage> {
        let stream = Some(Path::new("-"));
        if self.truth.as_deref() == stream && self.reading.input == Path::new("-") {
            return Err("-: INPUT and --truth cannot both be standard input".into());
        }
        Ok(())
    }

    /// Opens the file with the truth of a sensor with this mount, if there is one.
    fn truth(&self, mount: Mount) -> Result<Option<TruthFile>, Box<dyn Error>> {
        let truth = self.truth.as_ref();
        truth
            .map(|path| TruthFile::open(path, mount, self.reading.rows()))
            .transpose()
    }

    /// Refuses a unit of times if neither the attitudes nor the truth are a recording.
    fn check_time_unit(&self, truth: Option<&TruthFile>) -> Result<(), Usage> {
        if let Some(path) = &self.truth
            && self.reading.rows().time_unit.is_some()
            && truth.is_some_and(|truth| truth.is_table)
        {
            let reason = "--time-unit would change nothing: these are attitudes, in microseconds";
            return Err(Usage::from(format!("{}: {reason}", path.display())));
        }
        Ok(())
    }

    /// Reads all rows, with this truth.
    fn figure(
        &self,
        source: &mut dyn Source,
        mount: Mount,
        mut truth: Option<TruthFile>,
    ) -> Result<Figure, Box<dyn Error>> {
        let mut source = VibrationMonitor::new(source);
        let figure = Figure::read(&mut source, mount, truth.as_mut())?;
        for warning in source.warnings() {
            print_line(&warning);
        }
        Ok(figure)
    }
}
