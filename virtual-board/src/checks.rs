//! Rules for the core's accesses to registers: violations that a forgiving model lets pass.
//!
//! A chip does not report a broken rule; it behaves as no model says. Here each is noted once for
//! each instruction, with the address and the section of RM0090. Decorated devices note what they
//! see in their registers, and the bus adds address and program counter. The bus itself checks
//! reserved bits. Wait states and clocks are checked by rigless; the place of an access without a
//! clock is that of the first access to the address.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use rigless::emulator::{Access, AccessKind};
use rigless::soc::Bus;

/// A rule that the core must keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// A peripheral answers only while its clock is on.
    Clocked,
    /// A peripheral of the virtual board that the board's own chip lacks.
    Absent,
    /// The core is no faster than the regulator's scale allows.
    VoltageScale,
    /// Reserved bits stay zero.
    Reserved,
    /// The set-up of a stream changes only while the stream is off.
    StreamOff,
    /// No flag of the last transfer is set when a stream is enabled.
    StreamFlags,
    /// SR2 is read only after SR1 has shown ADDR, if ADDR is set.
    AddressSeen,
    /// DR is written only after SR1 has shown SB, if SB is set.
    StartSeen,
    /// FREQ, CCR and TRISE fit the clock of APB1 when the port is enabled.
    PortClock,
    /// PR and RLR of the watchdog are written only after the key that opens them.
    WatchdogOpen,
    /// PR and RLR of the watchdog are written only after PVU and RVU have cleared.
    WatchdogUpdated,
}

impl fmt::Display for Rule {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Clocked => "a peripheral without a clock (RM0090, 7.3.10 to 7.3.14)",
            Self::Absent => "the chip has no such peripheral (memory map of its manual)",
            Self::VoltageScale => "the core exceeds the limit of VOS in PWR_CR (RM0383, 5.1.3)",
            Self::Reserved => "a reserved bit is set (RM0090, 1.1)",
            Self::StreamOff => "the set-up of a stream changes while it is on (RM0090, 10.3.17)",
            Self::StreamFlags => "a stream is enabled with old flags (RM0090, 10.3.17)",
            Self::AddressSeen => "SR2 is read before SR1 has shown ADDR (RM0090, 27.6.7)",
            Self::StartSeen => "DR is written before SR1 has shown SB (RM0090, 27.3.3)",
            Self::PortClock => {
                "FREQ, CCR or TRISE do not fit APB1 (RM0090, 27.6.2, 27.6.8, 27.6.9)"
            }
            Self::WatchdogOpen => "PR or RLR is written without the key 0x5555 (RM0090, 21.3.2)",
            Self::WatchdogUpdated => "PR or RLR is written before SR is clear (RM0090, 21.4.4)",
        })
    }
}

/// A broken rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Violation {
    /// The rule.
    pub rule: Rule,
    /// The register's address.
    pub address: u64,
    /// The address of the instruction.
    pub program_counter: u64,
}

impl fmt::Display for Violation {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            rule,
            address,
            program_counter,
        } = self;
        write!(
            formatter,
            "{rule}: {address:#010x} accessed at {program_counter:#010x}"
        )
    }
}

/// The notes of all checks of a run.
#[derive(Clone, Debug, Default)]
pub struct Checks(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    /// True if a device has noted something since the last access.
    has_notes: AtomicBool,
    notes: Mutex<Vec<Rule>>,
    violations: Mutex<BTreeSet<Violation>>,
    /// The instruction of the first access to each address.
    first: Mutex<BTreeMap<u64, u64>>,
}

impl Checks {
    /// Notes a rule that the present access breaks.
    pub fn note(&self, rule: Rule) {
        lock(&self.0.notes).push(rule);
        self.0.has_notes.store(true, Ordering::Relaxed);
    }

    /// Takes the notes since the last call.
    #[must_use]
    pub fn take_notes(&self) -> Vec<Rule> {
        self.0.has_notes.store(false, Ordering::Relaxed);
        std::mem::take(&mut *lock(&self.0.notes))
    }

    /// Returns the broken rules.
    #[must_use]
    pub fn violations(&self) -> Vec<Violation> {
        lock(&self.0.violations).iter().copied().collect()
    }

    /// Notes a rule that accesses to this address break, at the place of the first of them.
    pub fn note_at(&self, rule: Rule, address: u64) {
        let first = lock(&self.0.first).get(&address).copied();
        lock(&self.0.violations).insert(Violation {
            rule,
            address,
            program_counter: first.unwrap_or(0),
        });
    }

    /// Notes accesses to peripherals that the chip lacks, by their names.
    pub fn note_absent(&self, bus: &Bus, is_absent: impl Fn(&str) -> bool) {
        let accessed: Vec<u64> = lock(&self.0.first).keys().copied().collect();
        for address in accessed {
            let slot = bus.slot_at(address).map(|at| bus.slots()[at].peripheral());
            if slot.is_some_and(|peripheral| is_absent(peripheral.name)) {
                self.note_at(Rule::Absent, address);
            }
        }
    }

    /// Checks an access of the core, and gives the devices' notes their place.
    pub fn complete(&self, access: &Access, reserved: &Reserved) {
        let program_counter = access.program_counter.unwrap_or(0);
        lock(&self.0.first)
            .entry(access.address)
            .or_insert(program_counter);
        if access.kind == AccessKind::Write && reserved.is_set_by(access) {
            self.note(Rule::Reserved);
        }
        if self.0.has_notes.load(Ordering::Relaxed) {
            let mut violations = lock(&self.0.violations);
            for rule in self.take_notes() {
                let violation = Violation {
                    rule,
                    address: access.address,
                    program_counter,
                };
                violations.insert(violation);
            }
        }
    }
}

/// Addresses of the peripherals on APB1, APB2 and AHB1 (RM0090, table 1).
const PERIPHERALS: std::ops::Range<u64> = 0x4000_0000..0x4008_0000;

/// The reserved bits of every register whose reset value is zero.
#[derive(Clone, Debug, Default)]
pub struct Reserved(Arc<BTreeMap<u64, u64>>);

impl Reserved {
    /// Reads the vendor's description of a part.
    #[must_use]
    pub fn of(bus: &Bus) -> Self {
        let mut registers = BTreeMap::new();
        let peripherals = bus.slots().iter().map(rigless::soc::Slot::peripheral);
        for peripheral in peripherals.filter(|each| PERIPHERALS.contains(&each.base)) {
            for register in peripheral.registers {
                let address = peripheral.base + u64::from(register.offset);
                let fields = register.fields.iter().map(rigless::soc::FieldSpec::mask);
                let known = fields.fold(0, |all, mask| all | mask);
                let all = u64::MAX >> (64 - 8 * register.width.bytes());
                // Two descriptions of one register, as of a timer's input and output.
                *registers.entry(address).or_insert(all) &= !(known | register.reset);
            }
        }
        Self(Arc::new(registers))
    }

    fn is_set_by(&self, access: &Access) -> bool {
        let register = self.0.get(&access.address);
        register.is_some_and(|&reserved| access.value & reserved != 0)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
