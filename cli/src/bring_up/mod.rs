//! `aplomb bring-up`: walks a person through the first board, step by step.
//!
//! Each step prints what it expects, what it saw, and what to do. The steps go on by themselves as
//! soon as the module reports the right thing. At the end there is one report.

mod movements;
mod noise;
mod report;
mod wiring;

use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use std::time::Duration;

use aplomb_recordings::output::OutputFile;
use aplomb_recordings::terminal::print_line;

use crate::end_request::{ENDED, end_request};
use crate::link::{BAUD, which_port};
use crate::record;
use crate::talk::Talk;
use crate::usage::Usage;
use report::{Finding, Report, Verdict};

/// Walk through the first board: bus, sensor, INT pin, self-test, noise, poses, signs, storage.
///
/// Each step says what it expects, what it saw and what to do. At the end there is a report in
/// Markdown with a picture, to attach to an issue. Wire the board as docs/bring-up.md shows.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb bring-up --port /dev/ttyUSB0
  aplomb bring-up --port /dev/ttyUSB0 --skip poses --skip turns --skip power

Exit code: 0 if no step is bad, 1 if one is. Ctrl-C ends it with code 1; the report then has the
steps before.")]
pub struct Options {
    /// The module's serial port; without one the ports of this computer are listed
    #[arg(long)]
    port: Option<String>,
    /// The module's baud rate
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
    /// The report; its picture and its flight log get the same name with .png and .log
    #[arg(long, value_name = "FILE", default_value = "bring-up.md")]
    output: PathBuf,
    /// Seconds at rest for the noise; the Allan deviation reaches a fifth of them
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(4..=7_200))]
    rest: u32,
    /// Seconds to wait for each movement by hand
    #[arg(long, default_value_t = 180, value_parser = clap::value_parser!(u32).range(1..=3_600))]
    patience: u32,
    /// Leave a step out; may be given several times
    #[arg(long, value_name = "STEP", value_enum)]
    skip: Vec<Step>,
}

/// Step of a bring-up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Step {
    Port,
    Bus,
    Identity,
    Registers,
    Edges,
    SelfTest,
    Noise,
    Temperature,
    Poses,
    Turns,
    Power,
}

impl Step {
    const ALL: [Self; 11] = [
        Self::Port,
        Self::Bus,
        Self::Identity,
        Self::Registers,
        Self::Edges,
        Self::SelfTest,
        Self::Noise,
        Self::Temperature,
        Self::Poses,
        Self::Turns,
        Self::Power,
    ];

    /// Returns the name, and what the step expects.
    const fn texts(self) -> (&'static str, &'static str) {
        match self {
            Self::Port => ("serial port", "the module answers `status`"),
            Self::Bus => ("bus", "a sensor answers at 0x68 or 0x69"),
            Self::Identity => ("identity", "a known part, by WHO_AM_I"),
            Self::Registers => ("registers", "all settings read back as written"),
            Self::Edges => (
                "INT pin",
                "an edge each 1000 us ± 5 %, jitter below 5 us, no loss",
            ),
            Self::SelfTest => ("self-test", "each axis within 14 % of its factory trim"),
            Self::Noise => (
                "noise",
                "0.2 to 2.5 times the typical density of the datasheet",
            ),
            Self::Temperature => ("temperature", "5 to 55 C, a few degrees above the room"),
            Self::Poses => (
                "six poses",
                "1 g in each: offset within 50 mg (z: 80 mg), scale within 3 %",
            ),
            Self::Turns => (
                "turns by hand",
                "roll, pitch and yaw follow with the right signs",
            ),
            Self::Power => ("power cycle", "the stored record is there after a start"),
        }
    }
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let port = options.port.as_ref();
    let port = port.ok_or_else(|| Usage::from(which_port()))?;
    options.check_output()?;
    let ends = end_request()?;
    // Before the steps, which take minutes: a name that cannot be written is refused at once.
    let mut file = OutputFile::create(&options.output, &[])?;
    let mut talk = Some(Talk::open(port, options.baud)?);
    let (mut report, mut picture) = (Report::default(), None);
    let mut blocked_by = None;
    for (number, step) in Step::ALL.into_iter().enumerate() {
        let (name, expected) = step.texts();
        let count = Step::ALL.len();
        print_line(&format!(
            "{}/{count} {name}: expects {expected}",
            number + 1
        ));
        let finding = if let Some(cause) = blocked_by {
            Finding::skipped(format!("needs the step \"{cause}\""))
        } else if options.skip.contains(&step) {
            Finding::skipped("as asked with --skip")
        } else if step == Step::Noise {
            // The recording has the port for itself.
            drop(talk.take());
            record_noise(options, port, &mut picture)
        } else {
            let talk = match &mut talk {
                Some(talk) => talk,
                None => talk.insert(Talk::open(port, options.baud)?),
            };
            take(step, talk, Duration::from_secs(options.patience.into()))
                .unwrap_or_else(|reason| Finding::bad(reason, "check the port, and start again"))
        };
        if matches!(step, Step::Port | Step::Bus) && finding.verdict == Verdict::Bad {
            blocked_by = Some(name);
        }
        if ends.load(Ordering::Relaxed) {
            report.add(name, expected, Finding::skipped(ENDED));
            break;
        }
        report.add(name, expected, finding);
    }
    let picture = picture
        .as_deref()
        .and_then(Path::file_name)
        .and_then(|name| name.to_str());
    let written = file.write_all(report.markdown(picture).as_bytes());
    written.map_err(|error| file.failed(&error))?;
    file.finish()?;
    print_line(&format!("the report is in {}", options.output.display()));
    if ends.load(Ordering::Relaxed) {
        return Err(ENDED.into());
    }
    match report.count(Verdict::Bad) {
        0 => Ok(()),
        bad => Err(format!("{bad} of {} steps are bad", Step::ALL.len()).into()),
    }
}

impl Options {
    /// Refuses a name of the report that its picture or its flight log would get too.
    fn check_output(&self) -> Result<(), Usage> {
        let ending = self.output.extension().unwrap_or_default();
        if ending == "png" || ending == "log" {
            let output = self.output.display();
            return Err(format!(
                "{output}: the report's picture and flight log end with .png and .log: choose \
                 another ending, such as .md"
            )
            .into());
        }
        Ok(())
    }
}

/// Takes a step that talks with the module.
fn take(step: Step, talk: &mut Talk, patience: Duration) -> Result<Finding, String> {
    match step {
        Step::Port => wiring::port(talk),
        Step::Bus => wiring::bus(talk),
        Step::Identity => wiring::identity(talk),
        Step::Registers => wiring::registers(talk),
        Step::Edges => wiring::edges(talk),
        Step::SelfTest => wiring::self_test(talk),
        Step::Temperature => wiring::temperature(talk),
        Step::Poses => movements::poses(talk, patience),
        Step::Turns => movements::turns(talk, patience),
        Step::Power => wiring::power_cycle(talk, patience),
        Step::Noise => Ok(Finding::skipped("it is recorded")),
    }
}

/// Records the sensor at rest, and judges its noise.
fn record_noise(options: &Options, port: &str, picture: &mut Option<PathBuf>) -> Finding {
    print_line(&format!("   keep it still for {} s", options.rest));
    let log = options.output.with_extension("log");
    let judged = record::record_log(port, options.baud, options.rest, &log)
        .map_err(|error| error.to_string())
        .and_then(|()| noise::judge(&log));
    let (finding, png) = match judged {
        Ok(judged) => judged,
        Err(reason) => {
            let advice = "use an adapter that carries 921,600 baud, or --skip noise";
            return Finding::bad(reason, advice);
        }
    };
    let path = options.output.with_extension("png");
    match OutputFile::write(&path, &[], &png) {
        Ok(()) => *picture = Some(path),
        Err(reason) => return Finding::bad(reason, "choose another --output"),
    }
    finding
}
