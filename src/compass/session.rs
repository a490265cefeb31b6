//! Session with a compass: search, configuration, readings and supervision, as single transfers.
//!
//! The caller performs at most one transfer per slot of [`SLOT_MS`], whenever its bus is free, and
//! gives the outcome back. Nothing here waits, so a firmware can do it between two bursts.
//!
//! ```text
//! search: one identity per slot -> configuration: one step per slot -> readings: each second slot
//!    ^                                ^                                  |
//!    +---- lost: 3 times no answer ---|----------------------------------+
//!                                     +-- frozen, blank, garbled, never ready, settings lost
//! ```
//!
//! | fault | deadline |
//! |---|---|
//! | absent, wrong identity, another part | [`SEARCHES`] passes: 0.16 s after the first slot |
//! | lost | three transfers without an answer: 60 ms |
//! | holds the bus | at once; it is left alone for 0.1 s, then twice as long each time |
//! | blank, garbled | three readings: 60 ms |
//! | settings lost | [`CHECK_SLOTS`]: 0.32 s |
//! | never ready, overflow | ten readings: 0.2 s |
//! | frozen | 25 readings: 0.5 s |

use super::choice::Choice;
use super::fault::Fault;
use super::part::{Bytes, Registers, Status, Step};
use super::part_id::PartId;
use crate::attitude::Vector3;

/// Length of a slot, ms: the time for one transfer. It is longer than any part needs between two
/// steps of a configuration.
pub const SLOT_MS: u32 = 10;
/// Time between two readings, µs.
pub const READING_PERIOD_US: u32 = 2 * SLOT_MS * 1_000;

/// Passes of the search through all parts at the start: the slowest part is ready 50 ms after
/// power-up (HMC5883L). The first pass reads register 0 alone, without which some QMC5883L give no
/// identity.
const SEARCHES: u8 = 4;
/// Slots between two passes of the search for a part that was named or lost.
const PAUSE_SLOTS: u16 = 10;
/// Longest pause of a compass that has stopped the bus: 10 s. Each stop doubles the pause.
const LONGEST_PAUSE_SLOTS: u16 = 1_000;
/// Slots between two checks of the settings.
const CHECK_SLOTS: u8 = 32;
/// Bad outcomes in a row that make a fault.
const FEW: u8 = 3;
const MANY: u8 = 10;
/// Equal readings in a row that make a fault.
const EQUAL_READINGS: u8 = 25;
/// Good readings in a row that end a fault.
const READINGS_TO_RECOVER: u8 = 5;
/// Trials of a status that a clone never shows.
const STATUS_TRIALS: u8 = 4;

/// Transfer on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Transfer {
    /// Reads registers.
    Read {
        /// Bus address, 7 bits.
        address: u8,
        /// First register.
        register: u8,
        /// Number of registers, 2 to [`LONGEST_READ`](super::LONGEST_READ).
        length: u8,
    },
    /// Writes a register.
    Write {
        /// Bus address, 7 bits.
        address: u8,
        /// Register.
        register: u8,
        /// Value.
        value: u8,
    },
}

/// Outcome of a transfer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Outcome<'a> {
    /// The registers were read.
    Read(&'a Bytes),
    /// The register was written.
    Written,
    /// The chip did not acknowledge.
    NoAnswer,
    /// The bus stopped during the transfer, and had to be recovered.
    Hung,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Nothing to do.
    Idle,
    /// Asks the parts for their identity, one after the other.
    Searching { index: u8, pass: u8 },
    /// Waits between two passes.
    Pausing { slots: u16 },
    /// Takes the steps of a configuration.
    Configuring { part: PartId, step: u8, trials: u8 },
    /// Takes readings.
    Running { part: PartId, slot: u8 },
}

/// Session with a compass.
#[derive(Debug, Clone)]
pub struct Session {
    choice: Choice,
    state: State,
    /// Part that has shown its identity.
    known: Option<PartId>,
    /// Other part that has answered in this pass.
    other: Option<PartId>,
    /// Factory's sensitivity adjustments.
    trims: [u8; 3],
    /// True if the part lacks the status of a genuine one.
    is_clone: bool,
    fault: Option<Fault>,
    last_counts: [i16; 3],
    silent: u8,
    unready: u8,
    bad: u8,
    equal: u8,
    good: u8,
    /// Pause after the next stop of the bus.
    pause_slots: u16,
}

impl Session {
    /// Creates a session that searches a compass.
    pub const fn new(choice: Choice) -> Self {
        Self {
            choice,
            state: match choice {
                Choice::Off => State::Idle,
                Choice::Auto | Choice::Named(_) => State::Searching { index: 0, pass: 0 },
            },
            known: None,
            other: None,
            trims: [128; 3],
            is_clone: false,
            fault: None,
            last_counts: [0; 3],
            silent: 0,
            unready: 0,
            bad: 0,
            equal: 0,
            good: 0,
            pause_slots: PAUSE_SLOTS,
        }
    }

    /// Returns the transfer of this slot, if there is one. [`finish`](Self::finish) takes its
    /// outcome.
    #[inline(never)]
    pub fn next_transfer(&mut self) -> Option<Transfer> {
        match &mut self.state {
            State::Idle => None,
            State::Pausing { slots } => {
                *slots -= 1;
                if *slots == 0 {
                    self.state = State::Searching {
                        index: self.known.map_or(0, |part| part as u8),
                        pass: 0,
                    };
                }
                None
            }
            State::Searching { index, pass } => {
                let part = PartId::ALL.get(usize::from(*index))?;
                let identity = part.part().facts().identification;
                let first = if *pass == 0 { 0 } else { identity.first };
                Some(read(part.address(), Registers::new(first, identity.length)))
            }
            State::Configuring { part, step, .. } => {
                let step = part.part().facts().configuration.get(usize::from(*step))?;
                Some(transfer_of(*step, part.address()))
            }
            State::Running { part, slot } => {
                *slot = (*slot + 1) % CHECK_SLOTS;
                let (address, part, slot) = (part.address(), part.part(), *slot);
                if slot.is_multiple_of(2) {
                    Some(read(address, part.facts().reading))
                } else if slot == 1 {
                    let (register, _) = part.facts().setting;
                    Some(read(address, Registers::new(register, 2)))
                } else {
                    None
                }
            }
        }
    }

    /// Takes the outcome of the last transfer. Returns the field if it was a good reading, µT
    /// along the chip's axes.
    #[inline(never)]
    pub fn finish(&mut self, outcome: &Outcome<'_>) -> Option<Vector3> {
        if *outcome == Outcome::Hung {
            self.finish_hung();
            return None;
        }
        match self.state {
            State::Idle | State::Pausing { .. } => {}
            State::Searching { index, pass } => self.finish_search(index, pass, outcome),
            State::Configuring { part, step, trials } => {
                self.finish_step(part, step, trials, outcome);
            }
            State::Running { part, slot } => {
                return match outcome {
                    Outcome::Read(bytes) => {
                        self.silent = 0;
                        if slot.is_multiple_of(2) {
                            self.take_reading(part, bytes)
                        } else {
                            self.check_setting(part, part.part().facts().setting, bytes);
                            None
                        }
                    }
                    Outcome::Written | Outcome::NoAnswer | Outcome::Hung => {
                        self.silent += 1;
                        if self.silent >= FEW {
                            self.fault = Some(Fault::Lost(part));
                            self.state = State::Pausing { slots: PAUSE_SLOTS };
                        }
                        None
                    }
                };
            }
        }
        None
    }

    /// Returns the choice.
    pub const fn choice(&self) -> Choice {
        self.choice
    }

    /// Returns the compass that has shown its identity.
    pub const fn part(&self) -> Option<PartId> {
        self.known
    }

    /// Returns the part's name; a clone's is marked.
    pub const fn name(&self) -> Option<&'static str> {
        match self.known {
            Some(PartId::Hmc5883l) if self.is_clone => Some("HMC5883L/DA5883"),
            Some(part) => Some(part.name()),
            None => None,
        }
    }

    /// Returns the reason why there are no readings, until they are good again.
    pub const fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Returns whether the session takes readings.
    pub const fn is_running(&self) -> bool {
        matches!(self.state, State::Running { .. })
    }

    /// Returns whether the session asks for no transfers, because there is no compass.
    pub const fn is_idle(&self) -> bool {
        matches!(self.state, State::Idle)
    }

    /// Returns the mean age of a reading's field when the reading begins, µs.
    pub fn mean_age_us(&self) -> u32 {
        self.known.map_or(0, |part| part.part().facts().mean_age_us)
    }

    /// Returns the factory's sensitivity adjustments, 128 without.
    pub(crate) const fn trims(&self) -> [u8; 3] {
        self.trims
    }

    /// Configures the compass again, for example after a self-test.
    pub fn restart(&mut self) {
        if let Some(part) = self.known {
            self.configure(part);
        }
    }

    /// Leaves the bus alone for a while.
    fn finish_hung(&mut self) {
        self.fault = Some(Fault::HoldsBus);
        self.state = State::Pausing {
            slots: self.pause_slots,
        };
        self.pause_slots = (2 * self.pause_slots).min(LONGEST_PAUSE_SLOTS);
    }

    fn finish_search(&mut self, index: u8, pass: u8, outcome: &Outcome<'_>) {
        let Some(&part) = PartId::ALL.get(usize::from(index)) else {
            return;
        };
        if let Outcome::Read(bytes) = outcome
            && pass > 0
        {
            let chip = part.part();
            if !chip.is_identity(bytes) {
                let &&[a, b, c, ..] = bytes;
                let kept = if chip.facts().identification.length > 2 {
                    c
                } else {
                    0
                };
                let fault = Fault::WrongIdentity {
                    address: part.address(),
                    identity: [a, b, kept],
                };
                if self.known == Some(part) {
                    self.fault = Some(fault);
                }
                self.fault.get_or_insert(fault);
            } else if self.is_wanted(part) {
                self.configure(part);
                return;
            } else {
                self.other.get_or_insert(part);
            }
        }
        let next = index + 1;
        let is_last = self.known.is_some() || usize::from(next) == PartId::ALL.len();
        self.state = if is_last {
            self.end_pass(pass + 1)
        } else {
            State::Searching { index: next, pass }
        };
    }

    /// Returns whether the session takes this part: the one that it knows, or one of its choice.
    fn is_wanted(&self, part: PartId) -> bool {
        match self.known {
            Some(known) => known == part,
            None => self.choice.takes(part),
        }
    }

    /// Ends a pass without the part.
    fn end_pass(&mut self, passes: u8) -> State {
        if passes < SEARCHES {
            return State::Searching {
                index: self.known.map_or(0, |part| part as u8),
                pass: passes,
            };
        }
        if self.known.is_some() {
            return State::Pausing { slots: PAUSE_SLOTS };
        }
        let Choice::Named(named) = self.choice else {
            // A board without a compass is no fault. A restart searches again.
            if self.fault == Some(Fault::HoldsBus) {
                self.fault = None;
            }
            return State::Idle;
        };
        self.fault = Some(match self.other {
            Some(found) => Fault::Other { named, found },
            None => match self.fault {
                Some(fault @ Fault::WrongIdentity { address, .. })
                    if address == named.address() =>
                {
                    fault
                }
                _ => Fault::Absent(named),
            },
        });
        State::Pausing { slots: PAUSE_SLOTS }
    }

    /// Configures the part again, if it still has its identity.
    fn start_over(&mut self, part: PartId) {
        self.state = State::Searching {
            index: part as u8,
            pass: SEARCHES - 1,
        };
    }

    fn configure(&mut self, part: PartId) {
        if let Some(Fault::WrongIdentity { .. } | Fault::Absent(_) | Fault::Other { .. }) =
            self.fault
        {
            self.fault = None;
        }
        self.known = Some(part);
        self.state = State::Configuring {
            part,
            step: 0,
            trials: 0,
        };
    }

    #[inline(never)]
    fn finish_step(&mut self, part: PartId, step: u8, trials: u8, outcome: &Outcome<'_>) {
        let steps = part.part().facts().configuration;
        let failed = match (steps.get(usize::from(step)), *outcome) {
            (_, Outcome::NoAnswer) => {
                self.state = State::Pausing { slots: PAUSE_SLOTS };
                self.fault = Some(Fault::Lost(part));
                return;
            }
            (Some(&Step::Verify(register, written)), Outcome::Read(bytes)) => {
                if !self.check_setting(part, (register, written), bytes) {
                    return;
                }
                None
            }
            (Some(&Step::Trim(_)), Outcome::Read(&[x, y, z, ..])) => {
                self.trims = [x, y, z];
                let is_possible = self.trims.iter().all(|trim| !matches!(trim, 0x00 | 0xFF));
                (!is_possible).then_some(Fault::Trim(self.trims))
            }
            (Some(&Step::Genuine(_, bit)), Outcome::Read(&[status, ..])) => {
                self.is_clone = status & bit == 0;
                if self.is_clone && trials < STATUS_TRIALS {
                    self.state = State::Configuring {
                        part,
                        step,
                        trials: trials + 1,
                    };
                    return;
                }
                None
            }
            _ => None,
        };
        if let Some(fault) = failed {
            self.fault = Some(fault);
            self.start_over(part);
            return;
        }
        let next = step + 1;
        if usize::from(next) < steps.len() {
            self.state = State::Configuring {
                part,
                step: next,
                trials: 0,
            };
        } else {
            (self.silent, self.unready, self.bad) = (0, 0, 0);
            (self.equal, self.good) = (0, 0);
            self.state = State::Running { part, slot: 1 };
        }
    }

    /// Decodes a reading, and supervises it.
    #[inline(never)]
    fn take_reading(&mut self, id: PartId, bytes: &Bytes) -> Option<Vector3> {
        let part = id.part();
        let length = usize::from(part.facts().reading.length);
        let (used, _) = bytes.split_at_checked(length)?;
        let is_blank =
            matches!(used, [byte @ (0x00 | 0xFF), ..] if used.iter().all(|used| used == byte));
        let (counter, limit, fault) = if is_blank {
            (&mut self.bad, FEW, Fault::Blank)
        } else {
            match part.status(bytes) {
                Status::Garbled => (&mut self.bad, FEW, Fault::Garbled),
                Status::NotReady => (&mut self.unready, MANY, Fault::NeverReady),
                Status::Overflow => (&mut self.bad, MANY, Fault::Overflow),
                Status::Ready => {
                    let counts = part.counts(bytes);
                    let is_equal = core::mem::replace(&mut self.last_counts, counts) == counts;
                    self.equal = if is_equal { self.equal + 1 } else { 0 };
                    if self.equal < EQUAL_READINGS {
                        return self.accept(id, counts, is_equal);
                    }
                    (&mut self.equal, 0, Fault::Frozen)
                }
            }
        };
        *counter = counter.saturating_add(1);
        self.good = 0;
        if *counter >= limit {
            *counter = 0;
            self.fault = Some(fault);
            if fault != Fault::Overflow {
                self.start_over(id);
            }
        }
        None
    }

    /// Accepts a reading. After a fault the first ones are withheld.
    fn accept(&mut self, id: PartId, counts: [i16; 3], is_equal: bool) -> Option<Vector3> {
        (self.bad, self.unready) = (0, 0);
        if self.fault.is_some() {
            self.good = if is_equal { 0 } else { self.good + 1 };
            if self.good < READINGS_TO_RECOVER {
                return None;
            }
            self.fault = None;
            self.pause_slots = PAUSE_SLOTS;
        }
        let part = id.part();
        Some(part.field_ut(part.adjust(counts, self.trims)))
    }

    /// Returns true if a register reads as it was written, and else starts over.
    #[inline(never)]
    fn check_setting(
        &mut self,
        part: PartId,
        (register, written): (u8, u8),
        &[read, ..]: &Bytes,
    ) -> bool {
        if read != written {
            self.fault = Some(Fault::Settings {
                part,
                register,
                written,
                read,
            });
            self.start_over(part);
        }
        read == written
    }
}

/// Returns the transfer of a step.
///
/// A read has two bytes at least, so a `Verify` reads the next register too. Of the registers that
/// are verified or follow one, only the HMC5883L's mode register (0x02) has a side effect on
/// reading: it locks the data registers until all six are read. In the other parts, reading
/// data or status registers has one: AK8963 0x02 to 0x09, QMC5883L 0x00 to 0x06, QMC5883P 0x01 to
/// 0x09. No `Verify` reaches them.
#[inline(never)]
pub(super) const fn transfer_of(step: Step, address: u8) -> Transfer {
    let registers = match step {
        Step::Write(register, value) => {
            return Transfer::Write {
                address,
                register,
                value,
            };
        }
        Step::Verify(register, _) | Step::Genuine(register, _) => Registers::new(register, 2),
        Step::Trim(register) => Registers::new(register, 3),
        Step::Drop(registers) => registers,
    };
    read(address, registers)
}

const fn read(address: u8, registers: Registers) -> Transfer {
    Transfer::Read {
        address,
        register: registers.first,
        length: registers.length,
    }
}
