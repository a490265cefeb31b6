//! `aplomb`: replays recordings through the library, and measures its filters.

mod filter;
mod log;
mod number;
mod peers;
mod progress;
mod replay;
mod score;

use std::process::ExitCode;

use clap::Parser;

/// Attitude from an MPU-6050, on a computer.
#[derive(Parser)]
#[command(version, arg_required_else_help = true)]
enum Command {
    Replay(replay::Options),
}

fn main() -> ExitCode {
    let result = match Command::parse() {
        Command::Replay(options) => replay::run(&options),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
