//! Compasses: the magnetic field where they are, and what four chips make of it.
//!
//! - [`field`]: the earth's field by place, hard and soft iron, motor currents, a passing magnet;
//! - [`Part`]: the chips, each with a register table of its own, written from its datasheet;
//! - [`Compass`]: a chip on the body, on an I2C bus.
//!
//! Time is the caller's, as for [`sensor`](crate::sensor). A chip measures at the instants of its
//! own clock, from the last state of the body that the caller gave.

mod ak8963;
mod chip;
pub mod field;
mod hmc5883l;
mod qmc5883l;
mod qmc5883p;

pub use chip::{Chip, Conversion};
pub use field::{EarthField, Magnetism, PassingMagnet};

use crate::motion::geometry::Vector;
use crate::motion::{Mount, Truth};
use crate::random::Random;

/// A compass chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// AK8963, inside an MPU-9250.
    Ak8963,
    /// HMC5883L.
    Hmc5883l,
    /// A clone with the HMC5883L's registers, whose status stays zero (marked DA5883).
    Da5883,
    /// QMC5883L.
    Qmc5883l,
    /// QMC5883P.
    Qmc5883p,
}

/// A compass: its part, mount and errors.
#[derive(Clone, Debug)]
pub struct CompassConfig {
    /// Seeds noise, gain errors and trims.
    pub seed: u64,
    /// The part.
    pub part: Part,
    /// Orientation on the body. An AK8963 takes the accelerometer's.
    pub mount: Mount,
    /// True if the chip hangs behind the IMU, on its auxiliary bus.
    pub is_behind_imu: bool,
    /// The field at the chip.
    pub magnetism: Magnetism,
    /// Age of the field that a measurement shows, ns.
    pub lag_ns: u64,
}

impl CompassConfig {
    /// A chip behind the IMU in a vehicle with moderate iron.
    #[must_use]
    pub fn new(seed: u64, part: Part) -> Self {
        Self {
            seed,
            part,
            mount: Mount::default(),
            is_behind_imu: true,
            magnetism: Magnetism::typical(seed),
            lag_ns: 4_000_000,
        }
    }
}

/// A fault of a compass's outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CompassFault {
    /// The data registers keep their values, and are reported as new.
    Frozen,
    /// All data and status registers read zero.
    Zeros,
    /// A strong magnet is on the chip.
    Overflow,
    /// Bits of the data and status registers are random.
    Garbled,
    /// The identity registers read this value.
    Identity(u8),
    /// No measurement is ever reported.
    NeverReady,
}

/// A modelled compass on a bus.
pub struct Compass {
    config: CompassConfig,
    chip: Box<dyn Chip>,
    /// Time from which the registers can be used.
    ready_at_ns: u64,
    noise: Random,
    faults: Vec<CompassFault>,
    garble: Random,
    /// True field of the last steps, with their times, newest last: for the lag.
    history: Vec<(u64, Vector)>,
    pointer: u8,
    pointer_expected: bool,
    /// Field of the last measurement, µT in body axes, without noise.
    measured_ut: Vector,
}

impl Compass {
    /// A chip that is powered up at time zero.
    #[must_use]
    pub fn new(config: CompassConfig) -> Self {
        let chip = chip_of(&config);
        Self {
            noise: Random::new(config.seed, "compass noise"),
            garble: Random::new(config.seed, "compass garble"),
            chip,
            ready_at_ns: 0,
            config,
            faults: Vec::new(),
            history: Vec::new(),
            pointer: 0,
            pointer_expected: false,
            measured_ut: [0.0; 3],
        }
    }

    /// The configuration.
    #[must_use]
    pub fn config(&self) -> &CompassConfig {
        &self.config
    }

    /// The field of the last measurement, µT in body axes, iron included, without noise.
    #[must_use]
    pub fn measured_ut(&self) -> Vector {
        self.measured_ut
    }

    /// The supply comes (back): all registers at reset.
    pub fn power_up(&mut self, now_ns: u64) {
        self.chip = chip_of(&self.config);
        self.ready_at_ns = now_ns + self.chip.start_up_ns();
    }

    /// Sets the faults from now on.
    pub fn set_faults(&mut self, faults: Vec<CompassFault>) {
        self.faults = faults;
    }

    /// The time of the next measurement.
    #[must_use]
    pub fn next_event_ns(&self) -> Option<u64> {
        self.chip.next_conversion_ns()
    }

    /// Brings the chip up to `now_ns`, with the body in this state.
    pub fn advance_to(&mut self, now_ns: u64, truth: &Truth) {
        let body_ut = self.config.magnetism.at(now_ns as f64 * 1e-9, truth);
        self.history.push((now_ns, body_ut));
        let lag_ns = self.config.lag_ns;
        let old = |(time_ns, _): &(u64, Vector)| time_ns + lag_ns <= now_ns;
        let kept = self.history.iter().filter(|entry| old(entry)).count();
        self.history.drain(..kept.saturating_sub(1));
        while self
            .chip
            .next_conversion_ns()
            .is_some_and(|at_ns| at_ns <= now_ns)
        {
            self.measured_ut = self.history[0].1;
            let is_at_magnet = self.faults.contains(&CompassFault::Overflow);
            let field_ut = if is_at_magnet {
                [20_000.0; 3]
            } else {
                self.config.mount.to_sensor(self.measured_ut)
            };
            let noise = &mut self.noise;
            self.chip.convert(&mut Conversion {
                field_ut,
                normal: &mut || noise.normal(),
                is_frozen: self.faults.contains(&CompassFault::Frozen),
                is_never_ready: self.faults.contains(&CompassFault::NeverReady),
            });
        }
    }

    /// A start condition with a 7-bit address. Returns the acknowledge.
    pub fn start(&mut self, now_ns: u64, address: u8, read: bool) -> bool {
        let answers = address == self.chip.address() && now_ns >= self.ready_at_ns;
        if answers {
            self.pointer_expected = !read;
        }
        answers
    }

    /// A byte from the controller. Returns the acknowledge.
    pub fn write(&mut self, now_ns: u64, byte: u8) -> bool {
        if std::mem::take(&mut self.pointer_expected) {
            self.pointer = byte;
        } else {
            self.chip.write(self.pointer, byte, now_ns);
            self.pointer = self.chip.next(self.pointer);
        }
        true
    }

    /// A byte to the controller.
    pub fn read(&mut self) -> u8 {
        let register = self.pointer;
        self.pointer = self.chip.next(register);
        let value = self.chip.read(register);
        let is_output = self.chip.is_output(register);
        self.faults.iter().fold(value, |value, fault| match fault {
            CompassFault::Zeros if is_output => 0x00,
            CompassFault::Garbled if is_output => self.garble.uniform(0.0, 256.0) as u8,
            CompassFault::Identity(identity) if self.chip.is_identity(register) => *identity,
            _ => value,
        })
    }
}

fn chip_of(config: &CompassConfig) -> Box<dyn Chip> {
    match config.part {
        Part::Ak8963 => Box::new(ak8963::Ak8963::new(config.seed)),
        Part::Hmc5883l => Box::new(hmc5883l::Hmc5883l::new(false)),
        Part::Da5883 => Box::new(hmc5883l::Hmc5883l::new(true)),
        Part::Qmc5883l => Box::new(qmc5883l::Qmc5883l::default()),
        Part::Qmc5883p => Box::new(qmc5883p::Qmc5883p::default()),
    }
}

#[cfg(test)]
mod tests;
