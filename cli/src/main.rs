//! `aplomb`: shows and records a module, replays recordings through the library, draws, converts and simulates them,
//! measures its filters, and finds calibrations.

mod accuracy;
mod bench;
mod calibrate;
mod completions;
mod convert;
mod counts;
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
mod throughput;
mod view;

use std::io::Write;
use std::process::ExitCode;

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
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Prints a text. That nobody reads on, as behind `head`, is no error.
fn say(text: &str) {
    let _ = writeln!(std::io::stdout(), "{text}");
}
