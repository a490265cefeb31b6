//! What a person or a program at the other end of the UART can ask for.

pub mod command;
pub mod line;
mod nearest;
