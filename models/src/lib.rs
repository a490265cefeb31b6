//! Models of the world in which a module flies: how it moves, and what an MPU-6050 makes of that.
//!
//! | module | contents |
//! |---|---|
//! | [`compass`] | four compasses: registers, noise, and the field by place, iron and magnets |
//! | [`motion`] | motions with exact truth: a simulated quadrotor, swings, rests, poses |
//! | [`sensor`] | the MPU-6050: registers, clock, signal path with errors and noise, INT pin, I2C |
//! | [`random`] | seeded random numbers |
//!
//! Everything is in double precision, needs no emulator, and shares no code with the library and
//! the driver that it judges.

#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod compass;
pub mod motion;
pub mod random;
pub mod sensor;
