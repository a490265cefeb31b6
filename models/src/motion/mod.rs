//! Motion sources: where the sensor really is and what it really feels, at any time from power-up
//! on.
//!
//! - [`quadrotor`]: a simulated flight with physics, by seed. Its parts are [`airframe`],
//!   [`autopilot`], [`route`] and [`wind`];
//! - [`aeroplane`]: a simulated flight in long turns, or with push-overs;
//! - [`poses`]: a body that is laid down in one pose after the other, as a calibration asks for it,
//!   with a smooth [`turn`] between two poses;
//! - [`rest`]: a body that stands still, or is nudged once: for tests with closed-form answers;
//! - [`slow_turn`]: a body that turns slowly and steadily, which looks like rest;
//! - [`swing`]: a body that swings to and fro, for short flights, and motions that are under way at
//!   power-up or run by a wrong clock;
//! - [`vibration`]: the vibration of a vehicle, on top of any of them.
//!
//! All of them give a [`truth`], in the vectors and quaternions of [`geometry`]. A [`mount`] says
//! how the sensor sits on the body.
//!
//! Everything here is in double precision and shares no code with the library that is being judged.

pub mod aeroplane;
pub mod airframe;
pub mod autopilot;
pub mod geometry;
pub mod mount;
pub mod poses;
pub mod quadrotor;
pub mod rest;
pub mod route;
pub mod slow_turn;
pub mod swing;
pub mod truth;
pub mod turn;
pub mod vibration;
pub mod wind;

pub use geometry::{Quaternion, Vector};
pub use mount::Mount;
pub use truth::{Truth, heading_error_rad, inclination_error_rad};

/// A body's motion through time.
pub trait Motion: Send {
    /// The truth at `time_s` seconds after power-up. Calls come with non-decreasing times.
    fn at(&mut self, time_s: f64) -> Truth;
}
