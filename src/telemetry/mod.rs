//! What leaves the module: one file per format, encoder and decoder together.

pub mod bursts;
pub mod classic;
mod decimal;
pub mod message;
pub mod text;
