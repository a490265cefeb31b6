//! Schedules of faults: read from a file, or drawn from a seed.
//!
//! A line is `start_s duration_s fault`, for instance `2.5 0.02 sda-low`; text after a `#` is a
//! comment.

use std::fmt;
use std::path::Path;

use aplomb_recordings::quote::quote;
use aplomb_recordings::text::read_small;

use thiserror::Error;

use crate::faults::{Axis, Direction, FaultKind, RestOfByte, ScheduledFault, nanoseconds};
use aplomb_models::random::Random;

/// Faults with their times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Schedule {
    /// The faults, in the order of their starts.
    pub faults: Vec<ScheduledFault>,
}

/// Every kind of fault: an example, its parameter, and how a parameter is read.
const FORMS: &[Form] = &[
    Form::new(
        FaultKind::AddressNack(None),
        "[:write|read]",
        |text| match text {
            "" => Some(FaultKind::AddressNack(None)),
            "write" => Some(FaultKind::AddressNack(Some(Direction::Write))),
            "read" => Some(FaultKind::AddressNack(Some(Direction::Read))),
            _ => None,
        },
    ),
    Form::new(FaultKind::DataNack(0), ":BYTE (0 to 15)", |text| {
        number(text, 0, 15).map(|byte| FaultKind::DataNack(byte as u8))
    }),
    Form::bare(FaultKind::BurstStall),
    Form::new(
        FaultKind::SdaLow(None),
        "[:CLOCKS[:BITS]] (1 to 9, 0x00 to 0x7f)",
        |text| {
            let (clocks, bits) = match text.split_once(':') {
                _ if text.is_empty() => return Some(FaultKind::SdaLow(None)),
                Some((clocks, bits)) => (clocks, number(bits, 0, 0x7F)?),
                None => (text, 0),
            };
            let clocks = number(clocks, 1, 9)? as u8;
            let bits = bits as u8;
            Some(FaultKind::SdaLow(Some(RestOfByte { clocks, bits })))
        },
    ),
    Form::bare(FaultKind::SclLow),
    Form::new(FaultKind::BusError(false), "[:flag]", |text| match text {
        "" => Some(FaultKind::BusError(false)),
        "flag" => Some(FaultKind::BusError(true)),
        _ => None,
    }),
    Form::bare(FaultKind::ArbitrationLost),
    Form::bare(FaultKind::DmaError),
    Form::bare(FaultKind::IntMissing),
    Form::bare(FaultKind::IntHigh),
    Form::bare(FaultKind::IntLow),
    Form::new(
        FaultKind::IntGlitch(1_000),
        ":HERTZ (1 to 100000)",
        |text| number(text, 1, 100_000).map(FaultKind::IntGlitch),
    ),
    Form::bare(FaultKind::SensorSilent),
    Form::bare(FaultKind::SensorBrownout),
    Form::new(
        FaultKind::RegisterFlip(0x1B, 0x08),
        ":REGISTER:VALUE (such as 0x1b:0x08)",
        |text| {
            let (register, value) = text.split_once(':')?;
            let [register, value] = [number(register, 0, 0x75)?, number(value, 0, 0xFF)?];
            Some(FaultKind::RegisterFlip(register as u8, value as u8))
        },
    ),
    Form::bare(FaultKind::Frozen),
    Form::bare(FaultKind::Zeros),
    Form::bare(FaultKind::Ones),
    Form::new(
        FaultKind::Saturated(Axis::GyroscopeX),
        ":ax|ay|az|gx|gy|gz",
        |text| axis(text).map(FaultKind::Saturated),
    ),
    Form::new(
        FaultKind::Temperature(120.0),
        ":CELSIUS (-59 to 132)",
        |text| {
            let celsius: f64 = text.parse().ok()?;
            ((-59.0..=132.0).contains(&celsius)).then_some(FaultKind::Temperature(celsius))
        },
    ),
    Form::bare(FaultKind::CoreStall),
    Form::bare(FaultKind::AttitudeLate),
    Form::bare(FaultKind::UartFlood),
    Form::bare(FaultKind::UartNoise),
    Form::bare(FaultKind::ProbeDetach),
    Form::bare(FaultKind::CrystalDies),
    Form::bare(FaultKind::WatchdogHang),
    Form::bare(FaultKind::Crash),
    Form::new(
        FaultKind::StackOverflow(8),
        "[:BYTES] (0 to 252, in fours)",
        |text| match text {
            "" => Some(FaultKind::StackOverflow(8)),
            _ => number(text, 0, 252)
                .filter(|bytes| bytes.is_multiple_of(4))
                .map(|bytes| FaultKind::StackOverflow(bytes as u8)),
        },
    ),
    Form::bare(FaultKind::CompassSilent),
    Form::bare(FaultKind::CompassFrozen),
    Form::bare(FaultKind::CompassZeros),
    Form::bare(FaultKind::CompassOverflow),
    Form::bare(FaultKind::CompassGarbled),
    Form::bare(FaultKind::CompassNeverReady),
    Form::new(
        FaultKind::CompassIdentity(0x55),
        ":BYTE (such as 0x55)",
        |text| number(text, 0, 0xFF).map(|identity| FaultKind::CompassIdentity(identity as u8)),
    ),
    Form::bare(FaultKind::CompassStall),
    Form::new(
        FaultKind::SupplySag(2_500),
        ":MILLIVOLTS (0 to 3300)",
        |text| number(text, 0, 3_300).map(FaultKind::SupplySag),
    )
    .beside(),
    Form::new(
        FaultKind::Stuck(Axis::GyroscopeX),
        ":ax|ay|az|gx|gy|gz",
        |text| axis(text).map(FaultKind::Stuck),
    )
    .beside(),
];

/// Number of kinds that [`Schedule::by_seed`] draws.
pub const DRAWN: usize = {
    let (mut drawn, mut nth) = (0, 0);
    while nth < FORMS.len() {
        drawn += FORMS[nth].is_drawn as usize;
        nth += 1;
    }
    drawn
};

/// Written form of a fault.
struct Form {
    /// A fault of the kind, with any parameter.
    example: FaultKind,
    parameter: &'static str,
    /// Reads the parameter, if the fault takes one.
    read: Option<fn(&str) -> Option<FaultKind>>,
    /// True if [`Schedule::by_seed`] draws the kind.
    is_drawn: bool,
}

impl Form {
    const fn new(
        example: FaultKind,
        parameter: &'static str,
        read: fn(&str) -> Option<FaultKind>,
    ) -> Self {
        Self {
            example,
            parameter,
            read: Some(read),
            is_drawn: true,
        }
    }

    const fn bare(kind: FaultKind) -> Self {
        Self {
            example: kind,
            parameter: "",
            read: None,
            is_drawn: true,
        }
    }

    /// Leaves the kind to the campaign, which draws it beside the schedule of a seed.
    const fn beside(self) -> Self {
        Self {
            is_drawn: false,
            ..self
        }
    }
}

/// A decimal number, or a hexadecimal one after `0x`, within these limits.
fn number(text: &str, low: u32, high: u32) -> Option<u32> {
    let value = match text.strip_prefix("0x") {
        Some(digits) => u32::from_str_radix(digits, 16).ok()?,
        None => text.parse().ok()?,
    };
    (low..=high).contains(&value).then_some(value)
}

/// An axis of the sensor by its name.
fn axis(text: &str) -> Option<Axis> {
    let mut names = Axis::NAMES.into_iter();
    names.find(|&(_, name)| name == text).map(|(axis, _)| axis)
}

/// Reason for which a schedule cannot be used.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum ScheduleError {
    /// The file cannot be read.
    #[error("{0}: {1}")]
    Unreadable(String, String),
    /// A line is not understood.
    #[error("{file}, line {line}: {reason}")]
    Line {
        /// The file, or what stands for it.
        file: String,
        /// Counted from 1.
        line: usize,
        /// The mistake, and the correct form.
        reason: String,
    },
    /// The seed is not a number.
    #[error("`{0}` is not a seed: after `seed:` comes a whole number, such as seed:7")]
    Seed(String),
}

impl Schedule {
    /// Reads the argument of `--faults`: the name of a file, or `seed:` and a number.
    ///
    /// # Errors
    ///
    /// When there is no such file, a line is not understood, or the seed is not a number.
    pub fn from_argument(argument: &str) -> Result<Self, ScheduleError> {
        if let Some(seed) = argument.strip_prefix("seed:") {
            let seed = seed
                .parse()
                .map_err(|_| ScheduleError::Seed(argument.into()))?;
            return Ok(Self::by_seed(seed));
        }
        let text = read_small(Path::new(argument))
            .map_err(|cause| ScheduleError::Unreadable(argument.into(), cause.to_string()))?;
        Self::parse(argument, &text)
    }

    /// Reads the text of a schedule; `file` names it in errors.
    ///
    /// # Errors
    ///
    /// When a line is not understood.
    pub fn parse(file: &str, text: &str) -> Result<Self, ScheduleError> {
        let mut faults = Vec::new();
        for (line, text) in (1..).zip(text.lines()) {
            let content = text.split('#').next().unwrap_or_default();
            let words: Vec<&str> = content.split_whitespace().collect();
            if words.is_empty() {
                continue;
            }
            faults.push(fault(&words).map_err(|reason| ScheduleError::Line {
                file: file.into(),
                line,
                reason,
            })?);
        }
        faults.sort_by_key(|fault: &ScheduledFault| fault.start_ns);
        Ok(Self { faults })
    }

    /// One to three faults for a flight, drawn from a seed; consecutive seeds begin with
    /// consecutive kinds. Most come one after another, with time to recover; now and then one
    /// comes on top of another.
    #[must_use]
    pub fn by_seed(seed: u64) -> Self {
        let mut random = Random::new(seed, "faults");
        let mut faults: Vec<ScheduledFault> = Vec::new();
        let mut start_s = FIRST_FAULT_S + random.uniform(0.0, 0.2);
        let count = [1, 1, 1, 1, 2, 2, 3][whole(&mut random, 7)];
        for nth in 0..count {
            let form = match nth {
                0 => (seed % DRAWN as u64) as usize,
                _ => whole(&mut random, DRAWN),
            };
            let mut drawn = FORMS.iter().filter(|form| form.is_drawn);
            let example = drawn.nth(form).unwrap_or(&FORMS[0]).example;
            let fault = draw(example, start_s, &mut random);
            let is_last = fault.kind.resets()
                || fault.kind == FaultKind::CrystalDies && fault.duration_ns == 0;
            faults.push(fault);
            if is_last {
                break;
            }
            start_s = if random.uniform(0.0, 1.0) < 0.15 {
                start_s + random.uniform(0.0, 0.02)
            } else {
                fault.end_ns() as f64 * 1e-9 + random.uniform(0.35, 0.55)
            };
        }
        faults.sort_by_key(|fault| fault.start_ns);
        Self { faults }
    }

    /// Returns the schedule with all faults later, to the microsecond.
    #[must_use]
    pub fn later(mut self, by_s: f64) -> Self {
        let by_ns = (by_s * 1e6).round() as u64 * 1_000;
        for fault in &mut self.faults {
            fault.start_ns += by_ns;
        }
        self
    }

    /// The names of all kinds of faults.
    pub fn kinds() -> impl Iterator<Item = &'static str> {
        Self::examples().map(|kind| kind.name())
    }

    /// A fault of each kind, with any parameter.
    pub fn examples() -> impl Iterator<Item = FaultKind> {
        FORMS.iter().map(|form| form.example)
    }
}

impl fmt::Display for Schedule {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.faults
            .iter()
            .try_for_each(|fault| writeln!(formatter, "{fault}"))
    }
}

/// Drawn faults begin after this time, when the gyroscope's offset has been measured, s.
pub const FIRST_FAULT_S: f64 = 1.7;

/// Settings of the sensor that a drawn flip changes: register, value with the settings by default,
/// and the bits that the firmware sets and the sensor keeps (MPU-6000 and MPU-6050 register map,
/// sections 4.2 to 4.28).
const SETTINGS: [(u8, u8, u8); 7] = [
    (0x19, 0x00, 0xFF),
    (0x1A, 0x01, 0x07),
    (0x1B, 0x18, 0xF8),
    (0x1C, 0x18, 0xF8),
    (0x37, 0x12, 0xFE),
    (0x38, 0x01, 0x19),
    (0x6B, 0x01, 0x6F),
];

/// A whole number below `count`.
fn whole(random: &mut Random, count: usize) -> usize {
    (random.uniform(0.0, count as f64) as usize).min(count - 1)
}

/// A fault of the example's kind that begins then.
fn draw(example: FaultKind, start_s: f64, random: &mut Random) -> ScheduledFault {
    let pick = whole(random, 1 << 16);
    let kind = draw_parameter(example, pick);
    let (shortest_s, longest_s) = durations_s(kind, pick);
    // Whole microseconds read back as themselves.
    let microseconds = |seconds: f64| (seconds * 1e6).round() as u64 * 1000;
    ScheduledFault {
        start_ns: microseconds(start_s),
        duration_ns: microseconds(random.uniform(shortest_s, longest_s)),
        kind,
    }
}

/// The example's kind with the parameter of this random number.
fn draw_parameter(example: FaultKind, pick: usize) -> FaultKind {
    match example {
        FaultKind::AddressNack(_) => {
            FaultKind::AddressNack([None, Some(Direction::Write), Some(Direction::Read)][pick % 3])
        }
        // Normal running writes one byte, the register number.
        FaultKind::DataNack(_) => FaultKind::DataNack(0),
        // Half of them are a sensor that has lost count.
        FaultKind::SdaLow(_) => FaultKind::SdaLow(pick.is_multiple_of(2).then_some(RestOfByte {
            clocks: (1 + pick / 2 % 9) as u8,
            bits: (pick / 18 % 128) as u8,
        })),
        FaultKind::BusError(_) => FaultKind::BusError(pick.is_multiple_of(2)),
        FaultKind::IntGlitch(_) => FaultKind::IntGlitch([200, 700, 1_900, 8_000][pick % 4]),
        FaultKind::RegisterFlip(..) => {
            let (register, setting, mask) = SETTINGS[pick % SETTINGS.len()];
            let value = (pick / 7 % 256) as u8;
            let is_change = (value ^ setting) & mask != 0;
            // The lowest bit of the setting changes at least.
            let lowest = mask & mask.wrapping_neg();
            FaultKind::RegisterFlip(register, if is_change { value } else { value ^ lowest })
        }
        // No room for the exception's frame of 32 bytes.
        FaultKind::StackOverflow(_) => FaultKind::StackOverflow([0, 8, 16, 24][pick % 4]),
        FaultKind::Saturated(_) => FaultKind::Saturated(Axis::NAMES[pick % 6].0),
        FaultKind::Stuck(_) => FaultKind::Stuck(Axis::NAMES[pick % 6].0),
        FaultKind::CompassIdentity(_) => FaultKind::CompassIdentity((pick % 64) as u8),
        FaultKind::SupplySag(_) => FaultKind::SupplySag((pick % 3_000) as u32),
        FaultKind::Temperature(_) => {
            FaultKind::Temperature(if pick.is_multiple_of(2) { -55.0 } else { 120.0 })
        }
        FaultKind::BurstStall
        | FaultKind::SclLow
        | FaultKind::ArbitrationLost
        | FaultKind::DmaError
        | FaultKind::IntMissing
        | FaultKind::IntHigh
        | FaultKind::IntLow
        | FaultKind::SensorSilent
        | FaultKind::SensorBrownout
        | FaultKind::Frozen
        | FaultKind::Zeros
        | FaultKind::Ones
        | FaultKind::CoreStall
        | FaultKind::UartFlood
        | FaultKind::UartNoise
        | FaultKind::ProbeDetach
        | FaultKind::CrystalDies
        | FaultKind::AttitudeLate
        | FaultKind::Crash
        | FaultKind::DebuggerReset
        | FaultKind::WatchdogHang
        | FaultKind::CompassSilent
        | FaultKind::CompassFrozen
        | FaultKind::CompassZeros
        | FaultKind::CompassOverflow
        | FaultKind::CompassGarbled
        | FaultKind::CompassNeverReady
        | FaultKind::CompassStall => example,
    }
}

/// The shortest and the longest duration of a drawn fault, s. A drawn crystal comes back or not, by
/// the random number.
fn durations_s(kind: FaultKind, pick: usize) -> (f64, f64) {
    match kind {
        FaultKind::SdaLow(Some(_)) | FaultKind::RegisterFlip(..) => (0.0, 0.0),
        FaultKind::WatchdogHang | FaultKind::Crash | FaultKind::StackOverflow(_) => (0.0, 0.0),
        FaultKind::DebuggerReset => (0.0, 0.0),
        FaultKind::AttitudeLate => (0.002, 0.015),
        FaultKind::ProbeDetach => (0.3, 0.8),
        FaultKind::CoreStall => (0.0015, 0.03),
        FaultKind::AddressNack(_) | FaultKind::DataNack(_) => (0.0015, 0.03),
        FaultKind::BusError(_) | FaultKind::ArbitrationLost | FaultKind::DmaError => (0.0015, 0.03),
        FaultKind::BurstStall
        | FaultKind::SdaLow(None)
        | FaultKind::SclLow
        | FaultKind::CompassStall => (0.0015, 0.08),
        FaultKind::CompassSilent
        | FaultKind::CompassFrozen
        | FaultKind::CompassZeros
        | FaultKind::CompassOverflow
        | FaultKind::CompassGarbled
        | FaultKind::CompassNeverReady
        | FaultKind::CompassIdentity(_) => (0.7, 1.0),
        FaultKind::IntMissing | FaultKind::IntHigh | FaultKind::IntLow => (0.004, 0.1),
        FaultKind::SensorSilent | FaultKind::SensorBrownout => (0.002, 0.15),
        FaultKind::CrystalDies if pick.is_multiple_of(2) => (0.0, 0.0),
        FaultKind::Saturated(_) => (0.005, 0.1),
        FaultKind::CrystalDies
        | FaultKind::IntGlitch(_)
        | FaultKind::Frozen
        | FaultKind::Zeros
        | FaultKind::Ones
        | FaultKind::Stuck(_)
        | FaultKind::Temperature(_)
        | FaultKind::UartFlood
        | FaultKind::UartNoise
        | FaultKind::SupplySag(_) => (0.05, 0.4),
    }
}

/// Reads a fault from the words of a line.
fn fault(words: &[&str]) -> Result<ScheduledFault, String> {
    let [start, duration, fault] = words else {
        return Err(format!(
            "a line is `start_s duration_s fault`, such as `2.5 0.02 sda-low`; \
             this one has {} words",
            words.len()
        ));
    };
    let seconds = |text: &str, what: &str| match text.parse::<f64>() {
        Ok(seconds) if (0.0..=86_400.0).contains(&seconds) => Ok(nanoseconds(seconds)),
        _ => Err(format!(
            "`{}` is not a {what}: it is in seconds, from 0 to 86400",
            quote(text)
        )),
    };
    Ok(ScheduledFault {
        start_ns: seconds(start, "start")?,
        duration_ns: seconds(duration, "duration")?,
        kind: kind(fault)?,
    })
}

/// The fault of this name and parameter.
fn kind(text: &str) -> Result<FaultKind, String> {
    let (name, parameter) = text.split_once(':').unwrap_or((text, ""));
    let Some(form) = FORMS.iter().find(|form| form.example.name() == name) else {
        let names: Vec<&str> = Schedule::kinds().collect();
        return Err(format!(
            "there is no fault `{}`; there are {}",
            quote(name),
            names.join(", ")
        ));
    };
    match form.read {
        None if text == name => Ok(form.example),
        None => Err(format!("`{name}` takes no parameter")),
        Some(read) => read(parameter).ok_or(format!(
            "`{}` is not a parameter of `{name}`: it is written {name}{}",
            quote(parameter),
            form.parameter
        )),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn any_text_is_a_schedule_that_reads_back_or_a_line_that_is_wrong(
            lines in prop::collection::vec(
                (
                    "[0-9]{1,5}(\\.[0-9]{1,9})?|-1|nan|é",
                    prop::sample::select(Schedule::kinds().collect::<Vec<_>>()),
                    "|:[0-9a-z]{1,4}(:0x[0-9a-f]{1,3})?|:-?[0-9.]{1,6}|:a[xyz]| #.{0,4}",
                )
                    .prop_map(|(time, kind, parameter)| {
                        format!("{time} {time} {kind}{parameter}")
                    }),
                0..4,
            ),
        ) {
            match Schedule::parse("f.txt", &lines.join("\n")) {
                Ok(schedule) => {
                    prop_assert_eq!(schedule.faults.len(), lines.len());
                    let again = Schedule::parse("f.txt", &schedule.to_string());
                    prop_assert_eq!(again, Ok(schedule));
                }
                Err(error) => {
                    let ScheduleError::Line { line, .. } = &error else {
                        return Err(TestCaseError::fail(error.to_string()));
                    };
                    // The entries before it are right, and it alone is not.
                    let before = &lines[..line - 1];
                    prop_assert!(Schedule::parse("f.txt", &before.join("\n")).is_ok());
                    prop_assert!(Schedule::parse("f.txt", &lines[line - 1]).is_err());
                    let place = format!("f.txt, line {line}: ");
                    prop_assert!(error.to_string().starts_with(&place), "{}", error);
                }
            }
        }
    }

    fn refusal(text: &str) -> String {
        Schedule::parse("f.txt", text).unwrap_err().to_string()
    }

    #[test]
    fn a_file_is_read_with_its_comments() {
        let text = "# two faults\n\n2.5 0.02 sda-low # shorted\n1 0 register-flip:0x1b:0x08\n";
        let schedule = Schedule::parse("f.txt", text).unwrap();
        assert_eq!(
            schedule.faults,
            [
                ScheduledFault {
                    start_ns: 1_000_000_000,
                    duration_ns: 0,
                    kind: FaultKind::RegisterFlip(0x1B, 0x08)
                },
                ScheduledFault {
                    start_ns: 2_500_000_000,
                    duration_ns: 20_000_000,
                    kind: FaultKind::SdaLow(None)
                },
            ],
            "in the order of their starts"
        );
    }

    /// One fault of a kind, its parameter and its times drawn from a seed.
    fn of_kind(example: FaultKind, seed: u64) -> Schedule {
        let mut random = Random::new(seed, "fault of a class");
        let start_s = FIRST_FAULT_S + random.uniform(0.0, 0.2);
        Schedule {
            faults: vec![draw(example, start_s, &mut random)],
        }
    }

    #[test]
    fn every_fault_reads_back_as_itself() {
        for kind in Schedule::examples() {
            for seed in 0..50 {
                let schedule = of_kind(kind, seed);
                assert_eq!(schedule.faults[0].kind.name(), kind.name());
                let text = schedule.to_string();
                assert_eq!(
                    Schedule::parse("f.txt", &text).as_ref(),
                    Ok(&schedule),
                    "{text}"
                );
            }
        }
    }

    #[test]
    fn a_drawn_flip_changes_bits_that_the_sensor_keeps() {
        use aplomb_models::sensor::registers::writable_bits;

        for seed in 0..2000 {
            let schedule = of_kind(FaultKind::RegisterFlip(0, 0), seed);
            let FaultKind::RegisterFlip(register, value) = schedule.faults[0].kind else {
                panic!("{schedule}")
            };
            let mut settings = SETTINGS.iter();
            let (_, setting, _) = settings.find(|(other, ..)| *other == register).unwrap();
            let kept = writable_bits(register);
            assert_ne!(value & kept, setting & kept, "{seed}: {schedule}");
        }
    }

    #[test]
    fn one_seed_gives_one_schedule_and_all_seeds_every_kind() {
        let mut names: Vec<&str> = Vec::new();
        for seed in 0..400 {
            let schedule = Schedule::by_seed(seed);
            assert_eq!(schedule, Schedule::by_seed(seed));
            let text = schedule.to_string();
            assert_eq!(
                Schedule::parse("f.txt", &text).as_ref(),
                Ok(&schedule),
                "{text}"
            );
            assert!((1..=3).contains(&schedule.faults.len()));
            names.extend(schedule.faults.iter().map(|fault| fault.kind.name()));
        }
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), DRAWN, "{names:?}");
        assert_ne!(Schedule::by_seed(1), Schedule::by_seed(2));
    }

    #[test]
    fn errors_say_where_what_and_what_is_allowed() {
        assert_eq!(
            refusal("1 0.1 frozen\n2.5 sda-low"),
            "f.txt, line 2: a line is `start_s duration_s fault`, such as `2.5 0.02 sda-low`; \
             this one has 2 words"
        );
        assert_eq!(
            refusal("\n-1 0.1 frozen"),
            "f.txt, line 2: `-1` is not a start: it is in seconds, from 0 to 86400"
        );
        assert_eq!(
            refusal("1 x frozen"),
            "f.txt, line 1: `x` is not a duration: it is in seconds, from 0 to 86400"
        );
        assert_eq!(
            refusal("1 nan frozen"),
            "f.txt, line 1: `nan` is not a duration: it is in seconds, from 0 to 86400"
        );
        assert!(refusal("1 1 melted").starts_with(
            "f.txt, line 1: there is no fault `melted`; there are address-nack, data-nack, "
        ));
        assert_eq!(
            refusal("1 1 frozen:2"),
            "f.txt, line 1: `frozen` takes no parameter"
        );
        assert_eq!(
            refusal("1 1 sda-low:10"),
            "f.txt, line 1: `10` is not a parameter of `sda-low`: \
             it is written sda-low[:CLOCKS[:BITS]] (1 to 9, 0x00 to 0x7f)"
        );
        for text in [
            "data-nack",
            "data-nack:16",
            "register-flip:0x1b",
            "register-flip:0x76:0",
            "register-flip:1:256",
            "saturated:mx",
            "temperature:200",
            "temperature:nan",
            "int-glitch:0",
            "supply-sag:3301",
            "address-nack:both",
        ] {
            let name = text.split(':').next().unwrap_or_default();
            assert!(
                refusal(&format!("1 1 {text}"))
                    .contains(&format!("is not a parameter of `{name}`")),
                "{text}"
            );
        }
    }

    #[test]
    fn an_argument_is_a_seed_or_a_file() {
        assert_eq!(Schedule::from_argument("seed:7"), Ok(Schedule::by_seed(7)));
        assert_eq!(
            Schedule::from_argument("seed:x").unwrap_err().to_string(),
            "`seed:x` is not a seed: after `seed:` comes a whole number, such as seed:7"
        );
        let missing = Schedule::from_argument("/no/such/file").unwrap_err();
        assert!(
            missing.to_string().starts_with("/no/such/file: "),
            "{missing}"
        );
    }
}
