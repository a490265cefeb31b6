//! Recordings of sensors: read, written, and played as motion.

#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod log;
pub mod motion;
