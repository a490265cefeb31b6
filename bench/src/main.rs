//! `aplomb-bench`: the library's filters beside those of others, on the same recordings.

mod accuracy;
mod clipping;
mod compare;
mod compass;
mod faulty_compass;
mod filter;
mod folders;
mod gains;
mod heading;
mod heading_picture;
mod heading_promise;
mod leave_one_out;
mod long;
mod marg;
mod motion_starts;
mod parallel;
mod peers;
mod picture;
mod promise;
mod recording;
mod report;
mod rest;
mod results;
mod simulated;
mod throughput;
#[cfg(test)]
mod valid;
mod vibration;
mod vqf;

use std::process::ExitCode;

use aplomb_recordings::terminal;
use clap::Parser;

fn main() -> ExitCode {
    let result = compare::run(&compare::Options::parse());
    match result.and(terminal::finish().map_err(Into::into)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}
