//! From what the sensor says to what it means: how it is mounted, and its average at rest.

mod mount;
mod startup;

pub use mount::Mount;
pub use startup::{AtRest, Progress, StartupAverage, StartupScale};
