//! Recordings of sensors and attitudes: one reader for every program, writers, and motion played
//! from a recording.
//!
//! - [`log`]: logs in SI units, plain or gzipped; [`counts`]: logs of register counts;
//! - [`units`]: units of a log's columns, and the rule for bad rows;
//! - [`form`]: logs and bursts apart, by their header;
//! - [`flight_log`]: the module's flight log;
//! - [`attitude_table`]: tables of attitudes;
//! - [`motion`]: a log as motion; [`simulated`]: simulated sensor data with its truth;
//!   [`simulated_compass`]: a compass beside it;
//! - [`rate`]: the sample rate of a log; [`wrap`]: clocks of 32 bits; [`batches`]: times that come
//!   in batches;
//! - [`plateau`]: clipping; [`vibration`]: vibration that is too strong;
//! - [`turns`]: rates that do not fit the force; [`unit_check`]: units of rows in memory;
//! - [`number`]: numbers as text, fast;
//! - [`distribution`]: quantiles in bounded memory;
//! - [`score`]: errors of attitudes against the truth, [`heading`]: those of headings;
//!   [`attitude`]: geometry for that;
//! - `output`, with the feature of this name: files that appear when they are complete;
//! - [`quote`]: quotations of input in messages;
//! - [`text`]: small text files;
//! - [`terminal`]: standard output.

#![forbid(unsafe_code)]
#![deny(missing_docs)]

#[doc(hidden)]
pub mod at_hand;
pub mod attitude;
pub mod attitude_table;
pub mod batches;
mod columns;
pub mod counts;
pub mod distribution;
mod fault;
pub mod flight_log;
mod foreign;
pub mod form;
pub mod heading;
mod lines;
pub mod log;
mod milliseconds;
pub mod motion;
pub mod number;
#[cfg(feature = "output")]
pub mod output;
pub mod plateau;
mod plausibility;
pub mod quote;
pub mod rate;
mod row;
mod rows;
pub mod score;
pub mod simulated;
pub mod simulated_compass;
mod statement;
mod still_rates;
pub mod terminal;
pub mod text;
pub mod turns;
pub mod unit_check;
pub mod units;
pub mod vibration;
pub mod wrap;
