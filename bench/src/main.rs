//! `aplomb-bench`: the library's filters beside those of other crates, on the same recordings.

mod accuracy;
mod clipping;
mod compare;
mod compass;
#[cfg(test)]
mod drift;
mod faulty_compass;
mod filter;
mod folders;
mod gains;
mod heading;
mod heading_picture;
#[cfg(test)]
mod interruptions;
#[cfg(test)]
mod kept_offset;
mod leave_one_out;
#[cfg(test)]
mod level_turns;
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
#[cfg(test)]
mod restarts;
mod results;
#[cfg(test)]
mod shaken_starts;
mod simulated;
#[cfg(test)]
mod starts;
#[cfg(test)]
mod steps;
#[cfg(test)]
mod straights;
mod throughput;
#[cfg(test)]
mod turns;
#[cfg(test)]
mod valid;
mod vibration;

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
