//! `aplomb`: shows and records a module, replays recordings through the library, draws, converts and simulates them,
//! measures its filters, and finds calibrations.

mod accuracy;
mod attitude_table;
mod bench;
mod calibrate;
mod completions;
mod convert;
mod counts;
mod device;
mod filter;
mod flight_log;
mod gains;
mod input;
mod leave_one_out;
mod number;
mod output;
mod parallel;
mod peers;
mod picture;
mod plot;
mod poses;
mod progress;
mod record;
mod recording;
mod replay;
mod rest;
mod score;
mod simulated;
mod spectrum;
#[cfg(test)]
mod starts;
mod throughput;
mod view;

use std::io::{ErrorKind, Write};
use std::process::ExitCode;
use std::sync::OnceLock;

use clap::Parser;

/// Attitude from an MPU-6050, on a computer.
#[derive(Parser)]
#[command(version, arg_required_else_help = true, name = "aplomb")]
#[command(after_help = "Examples:
  aplomb simulate --output flight.csv.gz
  aplomb replay flight.csv.gz --sensor-delay-us 1900 --output attitude.csv
  aplomb plot flight.csv.gz --sensor-delay-us 1900 --output flight.png
  aplomb bench --json
`aplomb COMMAND --help` has more of each.

Exit codes: 0 fine, 1 failed (the reason is on standard error), 2 wrong usage.")]
enum Command {
    Replay(replay::Options),
    Bench(bench::Options),
    Calibrate(calibrate::Options),
    Convert(convert::Options),
    View(view::Options),
    Record(record::Options),
    Plot(plot::Options),
    Simulate(simulated::Options),
    Completions(completions::Options),
}

fn main() -> ExitCode {
    let result = match Command::parse() {
        Command::Replay(options) => replay::run(&options),
        Command::Bench(options) => bench::run(&options),
        Command::Calibrate(options) => calibrate::run(&options),
        Command::Convert(options) => convert::run(&options),
        Command::View(options) => view::run(&options),
        Command::Record(options) => record::run(&options),
        Command::Plot(options) => plot::run(&options),
        Command::Simulate(options) => simulated::run(&options),
        Command::Completions(options) => {
            completions::run::<Command>(&options);
            Ok(())
        }
    };
    let lost = LOST.get().map_or(Ok(()), |error| {
        Err(format!("standard output cannot be written: {error}"))
    });
    match result.and(lost.map_err(Into::into)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Why something that was said is lost.
static LOST: OnceLock<std::io::Error> = OnceLock::new();

/// Prints a text. That nobody reads on, as behind `head`, is no error; a full disk is one in the end.
fn say(text: &str) {
    let mut output = std::io::stdout();
    if let Err(error) = writeln!(output, "{text}").and_then(|()| output.flush())
        && error.kind() != ErrorKind::BrokenPipe
    {
        LOST.get_or_init(|| error);
    }
}
