//! Blocking driver: a [`Session`] on any `embedded-hal` bus.

use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::I2c;

use super::choice::Choice;
use super::fault::Fault;
use super::part::{Bytes, LONGEST_READ};
use super::part_id::PartId;
use super::self_test::SelfTest;
use super::session::{Outcome, SLOT_MS, Session, Transfer, transfer_of};
use crate::attitude::Vector3;

/// Slots that a search and a configuration take at most.
const SLOTS_TO_START: u32 = 50;

/// Compass on a bus.
///
/// ```no_run
/// use aplomb::compass::{Choice, Compass, SLOT_MS};
/// use embedded_hal::delay::DelayNs;
/// use embedded_hal::i2c::I2c;
///
/// fn run(i2c: impl I2c, delay: &mut impl DelayNs) -> Option<()> {
///     let mut compass = Compass::find(i2c, Choice::Auto, delay)?;
///     loop {
///         // Between two samples of the IMU; here every 10 ms.
///         delay.delay_ms(SLOT_MS);
///         if let Some(field_ut) = compass.run_slot() {
///             // Give it to the mount, to the calibration, and to the pipeline.
///             let _ = field_ut;
///         }
///     }
/// }
/// ```
#[derive(Debug)]
pub struct Compass<I2C> {
    i2c: I2C,
    session: Session,
}

impl<I2C: I2c> Compass<I2C> {
    /// Searches and configures a compass, for half a second at most. `None` if there is none.
    ///
    /// A named compass that does not answer yet is returned with its [`fault`](Session::fault).
    pub fn find(i2c: I2C, choice: Choice, delay: &mut impl DelayNs) -> Option<Self> {
        let mut compass = Self {
            i2c,
            session: Session::new(choice),
        };
        for _ in 0..SLOTS_TO_START {
            compass.run_slot();
            if compass.session.is_running() {
                break;
            }
            delay.delay_ms(SLOT_MS);
        }
        let is_hopeless = compass.session.is_idle();
        (!is_hopeless).then_some(compass)
    }

    /// Performs the transfer of a slot, one at most. Call it every [`SLOT_MS`]. Returns a reading,
    /// µT along the chip's axes, in each second slot.
    pub fn run_slot(&mut self) -> Option<Vector3> {
        let transfer = self.session.next_transfer()?;
        let mut bytes = [0; LONGEST_READ];
        let is_done = perform(&mut self.i2c, transfer, &mut bytes);
        self.session.finish(&match (is_done, transfer) {
            (false, _) => Outcome::NoAnswer,
            (true, Transfer::Read { .. }) => Outcome::Read(&bytes),
            (true, Transfer::Write { .. }) => Outcome::Written,
        })
    }

    /// Returns the session, with the part and its fault.
    pub const fn session(&self) -> &Session {
        &self.session
    }

    /// Runs the part's self-test, for about 0.1 s, and configures the part again in the next slots.
    ///
    /// # Errors
    ///
    /// Returns [`Fault::Absent`] or [`Fault::Lost`] if the part does not answer.
    pub fn self_test(&mut self, delay: &mut impl DelayNs) -> Result<SelfTest, Fault> {
        let part = self.session.part().ok_or(Fault::Absent(PartId::Ak8963))?;
        let trims = self.session.trims();
        let result = self_test(&mut self.i2c, part, trims, delay);
        self.session.restart();
        result
    }

    #[cfg(test)]
    pub(super) fn bus_mut(&mut self) -> &mut I2C {
        &mut self.i2c
    }

    /// Returns the bus.
    pub fn release(self) -> I2C {
        self.i2c
    }
}

/// Runs the self-test of a part that a session has configured, and that has these factory trims.
///
/// # Errors
///
/// Returns [`Fault::Lost`] if the part does not answer.
pub(crate) fn self_test<I2C: I2c>(
    i2c: &mut I2C,
    part: PartId,
    trims: [u8; 3],
    delay: &mut impl DelayNs,
) -> Result<SelfTest, Fault> {
    let chip = part.part();
    let Some(plan) = chip.facts().self_test else {
        return Ok(SelfTest {
            part,
            response: None,
        });
    };
    let address = part.address();
    let mut bytes = [0; LONGEST_READ];
    for step in plan.steps {
        let transfer = transfer_of(*step, address);
        if !perform(i2c, transfer, &mut bytes) {
            return Err(Fault::Lost(part));
        }
        delay.delay_ms(2 * SLOT_MS);
    }
    let reading = chip.facts().reading;
    let transfer = Transfer::Read {
        address,
        register: reading.first,
        length: reading.length,
    };
    if !perform(i2c, transfer, &mut bytes) {
        return Err(Fault::Lost(part));
    }
    let response = chip.adjust(chip.counts(&bytes), trims);
    Ok(SelfTest {
        part,
        response: Some((response, plan.limits)),
    })
}

/// Performs a transfer. Returns whether the chip has acknowledged.
pub(super) fn perform<I2C: I2c>(i2c: &mut I2C, transfer: Transfer, bytes: &mut Bytes) -> bool {
    match transfer {
        Transfer::Read {
            address,
            register,
            length,
        } => bytes
            .get_mut(..usize::from(length))
            .is_some_and(|bytes| i2c.write_read(address, &[register], bytes).is_ok()),
        Transfer::Write {
            address,
            register,
            value,
        } => i2c.write(address, &[register, value]).is_ok(),
    }
}
