//! `aplomb`: shows and records a module, replays recordings through the library, draws, converts
//! and simulates them, and finds calibrations.

// Both panic once a terminal or a pipe is closed: `terminal` prints instead.
#![cfg_attr(not(test), deny(clippy::print_stdout, clippy::print_stderr))]

mod any_pipeline;
mod arming;
mod bring_up;
mod burst_rows;
mod calibrate;
mod calibration_file;
mod completions;
mod convert;
mod count_options;
mod end_request;
mod flight_replay;
mod i2c;
mod link;
mod measure;
mod plot;
mod poses;
mod progress;
mod read_options;
mod record;
mod replay;
mod sampler;
mod simulate;
mod source;
mod stream;
mod talk;
mod usage;
mod vibration_monitor;
mod view;

use std::process::ExitCode;

use aplomb_recordings::terminal::{self, print_message};
use clap::Parser;

/// Exit code of wrong usage, as that of clap.
const WRONG_USAGE: u8 = 2;

/// Attitude from an MPU-6050, on a computer.
#[derive(Parser)]
#[command(version, arg_required_else_help = true, name = "aplomb")]
#[command(after_help = "Examples:
  aplomb simulate --output flight.csv.gz
  aplomb replay flight.csv.gz --sensor-delay-us 1900 --output attitude.csv
  aplomb plot flight.csv.gz --sensor-delay-us 1900 --output flight.png
`aplomb COMMAND --help` has more of each.

Exit codes: 0 fine, 1 failed (the reason is on standard error), 2 wrong usage, such as
an option that means nothing for the input.")]
enum Command {
    Replay(replay::Options),
    Calibrate(calibrate::Options),
    Convert(convert::Options),
    View(view::Options),
    Record(record::Options),
    Measure(measure::Options),
    BringUp(bring_up::Options),
    Plot(plot::Options),
    Simulate(simulate::Options),
    Completions(completions::Options),
}

fn main() -> ExitCode {
    let result = match Command::parse() {
        Command::Replay(options) => replay::run(&options),
        Command::Calibrate(options) => calibrate::run(&options),
        Command::Convert(options) => convert::run(&options),
        Command::View(options) => view::run(&options),
        Command::Record(options) => record::run(&options),
        Command::Measure(options) => measure::run(&options),
        Command::BringUp(options) => bring_up::run(&options),
        Command::Plot(options) => plot::run(&options),
        Command::Simulate(options) => simulate::run(&options),
        Command::Completions(options) => {
            completions::run::<Command>(&options);
            Ok(())
        }
    };
    match result.and(terminal::finish().map_err(Into::into)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            print_message(&format!("error: {error}"));
            match error.is::<usage::Usage>() {
                true => ExitCode::from(WRONG_USAGE),
                false => ExitCode::FAILURE,
            }
        }
    }
}
