//! `aplomb`: shows and records a module, replays recordings through the library, measures its filters, and finds calibrations.

mod bench;
mod calibrate;
mod convert;
mod counts;
mod filter;
mod flight_log;
mod gains;
mod leave_one_out;
mod number;
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
mod throughput;
mod view;

use std::io::Write;
use std::process::ExitCode;

use clap::Parser;

/// Attitude from an MPU-6050, on a computer.
#[derive(Parser)]
#[command(version, arg_required_else_help = true)]
enum Command {
    Replay(replay::Options),
    Bench(bench::Options),
    Calibrate(calibrate::Options),
    Convert(convert::Options),
    View(view::Options),
    Record(record::Options),
}

fn main() -> ExitCode {
    let result = match Command::parse() {
        Command::Replay(options) => replay::run(&options),
        Command::Bench(options) => bench::run(&options),
        Command::Calibrate(options) => calibrate::run(&options),
        Command::Convert(options) => convert::run(&options),
        Command::View(options) => view::run(&options),
        Command::Record(options) => record::run(&options),
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
