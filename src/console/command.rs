//! Commands as text: one table of forms, for the parser, for `help` and for suggestions.
//!
//! Words are exact and lower case, so that noise is no command. The parser answers a nearly right
//! line with the right form. A number has digits and nothing else; degrees may have a sign and two
//! decimals, the elements of a matrix a sign.
//!
//! ```
//! use aplomb::console::command::{Calibrate, Command};
//!
//! let command: Command = "calibrate gyro".parse()?;
//! assert_eq!(command, Command::Calibrate(Calibrate::Gyroscope));
//! assert_eq!(command.to_string(), "calibrate gyro");
//!
//! let error = "baud 115000".parse::<Command>().unwrap_err();
//! assert_eq!(error.to_string(), "\"115000\" is no baud rate, did you mean \"baud 115200\"?");
//! # Ok::<(), aplomb::console::command::ParseError>(())
//! ```

use core::fmt;
use core::str::FromStr;

use super::answer::Decimal;
use super::line::LINE_CAPACITY;
use super::nearest::nearest;
use super::numbers::{centidegrees, elements, nearest_rate, number};
use crate::calibration::Mount;
use crate::compass::{self, Choice};
use crate::settings::OutputFormat;

/// Command. Its text is the line that requests it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Command {
    /// Prints every command on one line.
    Help,
    /// Prints the module's state.
    Status,
    /// Prints the working record: the one that `save` would store.
    Show,
    /// Stores the working record.
    Save,
    /// Clears the working record.
    Forget,
    /// Tests the sensor against its factory trim.
    SelfTest,
    /// Reads the sensor's settings back.
    Registers,
    /// Measures the module's own work.
    Measure(Measure),
    /// Arms: from now on nothing is done that is only safe on the ground.
    Arm,
    /// Disarms.
    Disarm,
    /// Starts or ends a calibration.
    Calibrate(Calibrate),
    /// Sets the gyroscope's matrix: its nine elements by rows, less those of the identity, in units
    /// of 10⁻⁴ and in [`MATRIX_ELEMENTS`]. `aplomb calibrate` prints them.
    GyroscopeMatrix([i16; 9]),
    /// Sets or finds the mount.
    Mount(MountChoice),
    /// Sets the compass, or its mount.
    Compass(CompassChoice),
    /// Sets the declination of the place, hundredths of a degree in [`DECLINATIONS_CENTIDEGREES`],
    /// east positive.
    Declination(i16),
    /// Sets the telemetry rate, frames per second in [`RATES_HZ`].
    Rate(u16),
    /// Sets the UART's baud rate, one of [`BAUD_RATES`].
    Baud(u32),
    /// Sets the telemetry format.
    Format(OutputFormat),
}

/// Argument of `calibrate`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Calibrate {
    /// Measures the gyroscope's offset, at rest.
    Gyroscope,
    /// Measures the accelerometer's offset and scales, in several poses.
    Accelerometer,
    /// Measures the level trim, at rest on a level surface.
    Level,
    /// Measures the gyroscope's offset over temperature, at rest while the temperature changes.
    Temperature,
    /// Fits the compass's hard and soft iron, while the vehicle is turned about all axes.
    Compass,
    /// Keeps the accelerometer's offset that the filter has found in motion.
    Keep,
    /// Ends the running calibration with the data so far.
    Done,
    /// Aborts the running calibration.
    Stop,
}

impl Calibrate {
    const ALL: [Self; 8] = [
        Self::Gyroscope,
        Self::Accelerometer,
        Self::Level,
        Self::Temperature,
        Self::Compass,
        Self::Keep,
        Self::Done,
        Self::Stop,
    ];

    /// Returns the word after `calibrate`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Gyroscope => "gyro",
            Self::Accelerometer => "accel",
            Self::Level => "level",
            Self::Temperature => "temperature",
            Self::Compass => "compass",
            Self::Keep => KEEP,
            Self::Done => "done",
            Self::Stop => "stop",
        }
    }
}

/// Argument of `measure`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Measure {
    /// Starts without figures.
    On,
    /// Prints the figures so far.
    Show,
    /// Ends the measurement.
    Off,
}

impl Measure {
    const ALL: [Self; 3] = [Self::On, Self::Show, Self::Off];
    const NAMES: [&str; 3] = [Self::On.name(), Self::Show.name(), Self::Off.name()];

    /// Returns the word after `measure`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::On => "on",
            Self::Show => "show",
            Self::Off => "off",
        }
    }
}

/// Argument of `mount`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MountChoice {
    /// Sets this mount.
    Named(Mount),
    /// Finds the mount from two poses.
    Find,
}

/// Argument of `compass`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum CompassChoice {
    /// Uses this part.
    Part(Choice),
    /// Keeps the hard iron that the heading filter has found.
    Keep,
    /// Sets the mount of the compass.
    Mount(Mount),
}

impl fmt::Display for Command {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Help => formatter.write_str("help"),
            Self::Status => formatter.write_str("status"),
            Self::Show => formatter.write_str("show"),
            Self::Save => formatter.write_str("save"),
            Self::Forget => formatter.write_str("forget"),
            Self::SelfTest => formatter.write_str("self-test"),
            Self::Registers => formatter.write_str("registers"),
            Self::Measure(argument) => write!(formatter, "measure {}", argument.name()),
            Self::Arm => formatter.write_str("arm"),
            Self::Disarm => formatter.write_str("disarm"),
            Self::Calibrate(argument) => write!(formatter, "calibrate {}", argument.name()),
            Self::GyroscopeMatrix(elements) => {
                formatter.write_str("gyro-matrix")?;
                write_list(formatter, elements, ",")
            }
            Self::Mount(MountChoice::Find) => formatter.write_str("mount find"),
            Self::Mount(MountChoice::Named(mount)) => write!(formatter, "mount {mount}"),
            Self::Compass(CompassChoice::Part(choice)) => write!(formatter, "compass {choice}"),
            Self::Compass(CompassChoice::Mount(mount)) => write!(formatter, "compass {mount}"),
            Self::Compass(CompassChoice::Keep) => formatter.write_str("compass keep"),
            Self::Declination(angle) => write!(formatter, "declination {}", degrees(*angle)),
            Self::Rate(rate_hz) => write!(formatter, "rate {rate_hz}"),
            Self::Baud(baud) => write!(formatter, "baud {baud}"),
            Self::Format(format) => write!(formatter, "format {format}"),
        }
    }
}

/// Elements that `gyro-matrix` takes, in units of 10⁻⁴.
pub const MATRIX_ELEMENTS: core::ops::RangeInclusive<i16> = -999..=999;

/// Angles that `declination` takes, hundredths of a degree.
pub const DECLINATIONS_CENTIDEGREES: core::ops::RangeInclusive<i16> = -18_000..=18_000;

/// Returns the text of an angle in hundredths of a degree.
fn degrees(centidegrees: i16) -> Decimal {
    Decimal(f32::from(centidegrees) * 0.01, 2)
}

/// Rates that `rate` takes, frames per second: up to one per sample.
pub const RATES_HZ: core::ops::RangeInclusive<u16> = 1..=1000;

/// Rates that `baud` takes. Each is within 1 % on every board.
pub const BAUD_RATES: [u32; 8] = [
    9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600,
];

/// Name of a command, and the form of its argument.
#[derive(Debug, PartialEq, Eq)]
pub struct Form {
    name: &'static str,
    argument: Argument,
}

#[derive(Debug, PartialEq, Eq)]
enum Argument {
    Nothing,
    Word(&'static [&'static str]),
    Matrix,
    Mount,
    Compass,
    Degrees,
    Hertz,
    Baud,
}

const CALIBRATIONS: [&str; Calibrate::ALL.len()] = {
    let mut names = [""; Calibrate::ALL.len()];
    let mut index = 0;
    while index < names.len() {
        names[index] = Calibrate::ALL[index].name();
        index += 1;
    }
    names
};

/// Argument of `calibrate` and `compass` that keeps what a filter has found.
const KEEP: &str = "keep";

/// Words that `compass` takes, beside a mount.
const COMPASS_WORDS: [&str; Choice::WORDS.len() + 1] = {
    let mut words = [KEEP; Choice::WORDS.len() + 1];
    let mut index = 0;
    while index < Choice::WORDS.len() {
        words[index] = Choice::WORDS[index];
        index += 1;
    }
    words
};

/// Forms of every command, in the order of `help`. Of two equally near ones, suggestions prefer the
/// first.
static FORMS: [Form; 18] = [
    Form::alone("help"),
    Form::alone("status"),
    Form::alone("show"),
    Form::new("calibrate", Argument::Word(&CALIBRATIONS)),
    Form::new("gyro-matrix", Argument::Matrix),
    Form::new("mount", Argument::Mount),
    Form::new("compass", Argument::Compass),
    Form::new("declination", Argument::Degrees),
    Form::alone("self-test"),
    Form::alone("registers"),
    Form::new("measure", Argument::Word(&Measure::NAMES)),
    Form::new("rate", Argument::Hertz),
    Form::new("format", Argument::Word(&OutputFormat::NAMES)),
    Form::new("baud", Argument::Baud),
    Form::alone("save"),
    Form::alone("forget"),
    Form::alone("arm"),
    Form::alone("disarm"),
];

impl Form {
    const fn new(name: &'static str, argument: Argument) -> Self {
        Self { name, argument }
    }

    const fn alone(name: &'static str) -> Self {
        Self::new(name, Argument::Nothing)
    }

    /// Returns the forms of every command.
    pub fn all() -> &'static [Self] {
        &FORMS
    }
}

impl fmt::Display for Form {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name)?;
        match self.argument {
            Argument::Nothing => Ok(()),
            Argument::Word(words) => write_list(formatter, words, "|"),
            Argument::Compass => {
                write_list(formatter, &COMPASS_WORDS, "|")?;
                formatter.write_str("|<forward><down>")
            }
            Argument::Matrix => formatter.write_str(" <nine numbers>"),
            Argument::Mount => formatter.write_str(" find|<forward><down>"),
            Argument::Degrees => formatter.write_str(" <degrees>"),
            Argument::Hertz => formatter.write_str(" <hz>"),
            Argument::Baud => formatter.write_str(" <bps>"),
        }
    }
}

/// Writes a blank, and the items with this separator between them.
fn write_list<T: fmt::Display>(
    formatter: &mut fmt::Formatter<'_>,
    items: &[T],
    separator: &str,
) -> fmt::Result {
    items.iter().enumerate().try_for_each(|(index, item)| {
        let before = if index == 0 { " " } else { separator };
        write!(formatter, "{before}{item}")
    })
}

/// Forms of every command, separated by commas.
pub(super) struct CommandForms;

impl fmt::Display for CommandForms {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        Form::all()
            .iter()
            .enumerate()
            .try_for_each(|(index, form)| {
                let separator = if index == 0 { "" } else { ", " };
                write!(formatter, "{separator}{form}")
            })
    }
}

/// Reason why a line is not a command.
#[derive(Debug, Clone, PartialEq, Eq)]
#[non_exhaustive]
pub enum ParseError {
    /// No command has this name.
    UnknownCommand {
        /// First word of the line.
        word: Word,
        /// Suggested command.
        nearest: Option<&'static str>,
    },
    /// The command does not take this argument.
    UnknownArgument {
        /// Form of the command.
        form: &'static Form,
        /// Argument.
        word: Word,
        /// Suggested argument.
        nearest: Option<&'static str>,
    },
    /// The command needs an argument.
    MissingArgument(&'static Form),
    /// The line has a word too many.
    ExtraWord {
        /// Form of the command.
        form: &'static Form,
        /// First extra word.
        word: Word,
    },
    /// The argument of `gyro-matrix` is not nine elements of [`MATRIX_ELEMENTS`].
    NotAMatrix(Word),
    /// The argument of `declination` is not an angle of [`DECLINATIONS_CENTIDEGREES`].
    NotADeclination(Word),
    /// The argument of `rate` is not a number in [`RATES_HZ`].
    NotARate(Word),
    /// The argument of `baud` is not one of [`BAUD_RATES`].
    NotABaudRate {
        /// Argument.
        word: Word,
        /// Suggested baud rate.
        nearest: Option<u32>,
    },
}

impl fmt::Display for ParseError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownCommand { word, nearest } => {
                write!(formatter, "there is no command \"{word}\"")?;
                match nearest {
                    Some(nearest) => write!(formatter, ", did you mean \"{nearest}\"?"),
                    None => formatter.write_str("; \"help\" names all"),
                }
            }
            Self::UnknownArgument {
                form,
                word,
                nearest,
            } => {
                write!(formatter, "{} does not take \"{word}\"", form.name)?;
                match nearest {
                    Some(nearest) => {
                        write!(formatter, ", did you mean \"{} {nearest}\"?", form.name)
                    }
                    None if form.argument == Argument::Mount => formatter.write_str(
                        "; it takes \"find\", or the sensor's axes that point forward and down, \
                         such as \"mount +x-z\"",
                    ),
                    None => write!(formatter, "; its form is \"{form}\""),
                }
            }
            Self::MissingArgument(form) => {
                write!(formatter, "{} needs a word more: \"{form}\"", form.name)
            }
            Self::ExtraWord { form, word } => {
                write!(formatter, "\"{word}\" is too much, the form is \"{form}\"")
            }
            Self::NotAMatrix(word) => write!(
                formatter,
                "\"{word}\" is no matrix, which is nine numbers from {} to {} with commas, as \
                 \"aplomb calibrate\" prints them",
                MATRIX_ELEMENTS.start(),
                MATRIX_ELEMENTS.end()
            ),
            Self::NotADeclination(word) if compass::IS_BUILT_IN => write!(
                formatter,
                "\"{word}\" is no declination: -180 to 180 degrees, east positive, two decimals \
                 at most, such as \"declination 3.5\""
            ),
            // No angle is parsed without a compass.
            Self::NotADeclination(_) => Ok(()),
            Self::NotARate(word) => write!(
                formatter,
                "\"{word}\" is no rate, which is a number from {} to {}, such as \"rate 50\"",
                RATES_HZ.start(),
                RATES_HZ.end()
            ),
            Self::NotABaudRate { word, nearest } => {
                write!(formatter, "\"{word}\" is no baud rate")?;
                if let Some(nearest) = nearest {
                    return write!(formatter, ", did you mean \"baud {nearest}\"?");
                }
                formatter.write_str("; there are")?;
                BAUD_RATES.iter().enumerate().try_for_each(|(index, rate)| {
                    let separator = if index == 0 { "" } else { "," };
                    write!(formatter, "{separator} {rate}")
                })
            }
        }
    }
}

impl core::error::Error for ParseError {}

/// Word of a line, cut after [`Word::LENGTH`] bytes.
#[derive(Clone, PartialEq, Eq)]
pub struct Word {
    text: heapless::String<{ Word::LENGTH }>,
    is_cut: bool,
}

impl Word {
    /// Length of the longest word that is kept whole, in bytes.
    pub const LENGTH: usize = 20;

    fn new(text: &str) -> Self {
        let mut kept = heapless::String::new();
        let is_cut = text
            .chars()
            .try_for_each(|character| kept.push(character))
            .is_err();
        Self { text: kept, is_cut }
    }
}

impl fmt::Display for Word {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.text)?;
        formatter.write_str(if self.is_cut { "..." } else { "" })
    }
}

impl fmt::Debug for Word {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "Word({self})")
    }
}

const _: () = assert!(Word::LENGTH < LINE_CAPACITY);

impl FromStr for Command {
    type Err = ParseError;

    /// Parses a line, without its end. Words are separated by blanks.
    fn from_str(line: &str) -> Result<Self, ParseError> {
        let mut words = line.split_ascii_whitespace();
        let name = words.next().unwrap_or_default();
        let Some(form) = FORMS.iter().find(|form| form.name == name) else {
            return Err(ParseError::UnknownCommand {
                word: Word::new(name),
                nearest: nearest(name, FORMS.iter().map(|form| form.name)),
            });
        };
        let takes_argument = form.argument != Argument::Nothing;
        let argument = if takes_argument { words.next() } else { None };
        if let Some(extra) = words.next() {
            return Err(ParseError::ExtraWord {
                form,
                word: Word::new(extra),
            });
        }
        if takes_argument && argument.is_none() {
            return Err(ParseError::MissingArgument(form));
        }
        let argument = argument.unwrap_or_default();
        Ok(match form.name {
            "help" => Self::Help,
            "status" => Self::Status,
            "show" => Self::Show,
            "save" => Self::Save,
            "forget" => Self::Forget,
            "self-test" => Self::SelfTest,
            "registers" => Self::Registers,
            "arm" => Self::Arm,
            "disarm" => Self::Disarm,
            _ => return parse_argument(form, argument),
        })
    }
}

/// Returns the error for an argument that is not among the known ones.
#[inline(never)]
fn unknown_argument(form: &'static Form, argument: &str, known: &[&'static str]) -> ParseError {
    ParseError::UnknownArgument {
        form,
        word: Word::new(argument),
        nearest: nearest(argument, known.iter().copied()),
    }
}

/// Parses the argument of a command that takes one.
fn parse_argument(form: &'static Form, argument: &str) -> Result<Command, ParseError> {
    let unknown = |known| unknown_argument(form, argument, known);
    match form.name {
        "calibrate" => Calibrate::ALL
            .into_iter()
            .find(|known| known.name() == argument)
            .map(Command::Calibrate)
            .ok_or_else(|| unknown(&CALIBRATIONS)),
        "measure" => Measure::ALL
            .into_iter()
            .find(|known| known.name() == argument)
            .map(Command::Measure)
            .ok_or_else(|| unknown(&Measure::NAMES)),
        "gyro-matrix" => elements(argument, MATRIX_ELEMENTS)
            .map(Command::GyroscopeMatrix)
            .ok_or_else(|| ParseError::NotAMatrix(Word::new(argument))),
        "mount" if argument == "find" => Ok(Command::Mount(MountChoice::Find)),
        "mount" => Mount::parse(argument)
            .map(|mount| Command::Mount(MountChoice::Named(mount)))
            .ok_or_else(|| unknown(&["find", "z-up", "z-down"])),
        "compass" if argument == KEEP => Ok(Command::Compass(CompassChoice::Keep)),
        "compass" => (Choice::parse(argument).map(CompassChoice::Part))
            .or_else(|| Mount::parse(argument).map(CompassChoice::Mount))
            .map(Command::Compass)
            .ok_or_else(|| unknown(&COMPASS_WORDS)),
        // The console refuses it, whatever the angle.
        "declination" if !compass::IS_BUILT_IN => Ok(Command::Declination(0)),
        "declination" => centidegrees(argument)
            .filter(|angle| DECLINATIONS_CENTIDEGREES.contains(angle))
            .map(Command::Declination)
            .ok_or_else(|| ParseError::NotADeclination(Word::new(argument))),
        "rate" => (number(argument).and_then(|rate| u16::try_from(rate).ok()))
            .filter(|rate| RATES_HZ.contains(rate))
            .map(Command::Rate)
            .ok_or_else(|| ParseError::NotARate(Word::new(argument))),
        "format" => argument
            .parse()
            .map(Command::Format)
            .map_err(|_| unknown(&OutputFormat::NAMES)),
        _ => match number(argument) {
            Some(rate) if BAUD_RATES.contains(&rate) => Ok(Command::Baud(rate)),
            rate => Err(ParseError::NotABaudRate {
                word: Word::new(argument),
                nearest: rate.and_then(|rate| nearest_rate(rate, &BAUD_RATES)),
            }),
        },
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::compass::PartId;

    fn parse(line: &str) -> Result<Command, ParseError> {
        line.parse()
    }

    #[test]
    fn every_command_is_understood() {
        let commands = [
            ("help", Command::Help),
            ("status", Command::Status),
            ("show", Command::Show),
            ("save", Command::Save),
            ("forget", Command::Forget),
            ("self-test", Command::SelfTest),
            ("registers", Command::Registers),
            ("measure on", Command::Measure(Measure::On)),
            ("measure show", Command::Measure(Measure::Show)),
            ("measure off", Command::Measure(Measure::Off)),
            ("arm", Command::Arm),
            ("disarm", Command::Disarm),
            ("calibrate gyro", Command::Calibrate(Calibrate::Gyroscope)),
            (
                "calibrate accel",
                Command::Calibrate(Calibrate::Accelerometer),
            ),
            ("calibrate level", Command::Calibrate(Calibrate::Level)),
            (
                "calibrate temperature",
                Command::Calibrate(Calibrate::Temperature),
            ),
            ("calibrate compass", Command::Calibrate(Calibrate::Compass)),
            ("calibrate done", Command::Calibrate(Calibrate::Done)),
            ("calibrate stop", Command::Calibrate(Calibrate::Stop)),
            (
                "gyro-matrix -999,0,5,-1,999,0,0,40,-0",
                Command::GyroscopeMatrix([-999, 0, 5, -1, 999, 0, 0, 40, 0]),
            ),
            ("mount find", Command::Mount(MountChoice::Find)),
            (
                "mount z-down",
                Command::Mount(MountChoice::Named(Mount::Z_DOWN)),
            ),
            (
                "  mount   +x-z ",
                Command::Mount(MountChoice::Named(Mount::Z_UP)),
            ),
            (
                "compass auto",
                Command::Compass(CompassChoice::Part(Choice::Auto)),
            ),
            ("compass keep", Command::Compass(CompassChoice::Keep)),
            (
                "compass qmc5883l",
                Command::Compass(CompassChoice::Part(Choice::Named(PartId::Qmc5883l))),
            ),
            (
                "compass +y-z",
                Command::Compass(CompassChoice::Mount(Mount::parse("+y-z").expect("a mount"))),
            ),
            ("declination 3.5", Command::Declination(350)),
            ("declination -22.05", Command::Declination(-2_205)),
            ("declination +180", Command::Declination(18_000)),
            ("declination -0.01", Command::Declination(-1)),
            ("rate 1", Command::Rate(1)),
            ("rate 1000", Command::Rate(1000)),
            ("baud 9600", Command::Baud(9600)),
            ("baud 921600", Command::Baud(921_600)),
            ("format text", Command::Format(OutputFormat::Text)),
            ("format classic", Command::Format(OutputFormat::Classic)),
        ];
        for (text, command) in commands {
            assert_eq!(parse(text), Ok(command), "{text}");
            assert_eq!(parse(&command.to_string()), Ok(command), "{text}");
        }
        for form in Form::all() {
            let text = form.name;
            assert!(
                commands
                    .iter()
                    .any(|(known, _)| known.trim_start().starts_with(text)),
                "{text} is tested"
            );
            assert!(
                !matches!(parse(text), Err(ParseError::UnknownCommand { .. })),
                "{text}"
            );
        }
        for mount in Mount::ALL {
            let text = format!("mount {mount}");
            assert_eq!(parse(&text), Ok(Command::Mount(MountChoice::Named(mount))));
        }
    }

    #[test]
    fn an_error_has_the_reason_and_the_nearest_right_form() {
        let forms = "calibrate gyro|accel|level|temperature|compass|keep|done|stop";
        for (text, answer) in [
            (
                "stauts",
                "there is no command \"stauts\", did you mean \"status\"?",
            ),
            (
                "SAVE",
                "there is no command \"SAVE\", did you mean \"save\"?",
            ),
            (
                "selftest",
                "there is no command \"selftest\", did you mean \"self-test\"?",
            ),
            ("fly", "there is no command \"fly\"; \"help\" names all"),
            (
                "calibrate giro",
                "calibrate does not take \"giro\", did you mean \"calibrate gyro\"?",
            ),
            (
                "calibrate accelerometer",
                "calibrate does not take \"accelerometer\", did you mean \"calibrate accel\"?",
            ),
            (
                "calibrate",
                &format!("calibrate needs a word more: \"{forms}\""),
            ),
            (
                "calibrate everything",
                &format!("calibrate does not take \"everything\"; its form is \"{forms}\""),
            ),
            (
                "mount +x+x",
                "mount does not take \"+x+x\"; it takes \"find\", or the sensor's axes that point \
                 forward and down, \
                 such as \"mount +x-z\"",
            ),
            (
                "compass qmc5883",
                "compass does not take \"qmc5883\", did you mean \"compass qmc5883l\"?",
            ),
            (
                "compass",
                "compass needs a word more: \
                 \"compass auto|off|ak8963|qmc5883l|qmc5883p|hmc5883l|keep|<forward><down>\"",
            ),
            (
                "gyro-matrix 1,2,3",
                "\"1,2,3\" is no matrix, which is nine numbers from -999 to 999 with commas, as \
                 \"aplomb calibrate\" prints them",
            ),
            (
                "declination",
                "declination needs a word more: \"declination <degrees>\"",
            ),
            (
                "declination 180.01",
                "\"180.01\" is no declination: -180 to 180 degrees, east positive, two decimals \
                 at most, such as \"declination 3.5\"",
            ),
            (
                "declination 3.5 E",
                "\"E\" is too much, the form is \"declination <degrees>\"",
            ),
            ("save now", "\"now\" is too much, the form is \"save\""),
            (
                "rate 50 Hz",
                "\"Hz\" is too much, the form is \"rate <hz>\"",
            ),
            (
                "rate 0",
                "\"0\" is no rate, which is a number from 1 to 1000, such as \"rate 50\"",
            ),
            (
                "rate +50",
                "\"+50\" is no rate, which is a number from 1 to 1000, such as \"rate 50\"",
            ),
            (
                "baud 115000",
                "\"115000\" is no baud rate, did you mean \"baud 115200\"?",
            ),
            (
                "baud 1",
                "\"1\" is no baud rate; there are 9600, 19200, 38400, 57600, 115200, 230400, \
                 460800, 921600",
            ),
            (
                "format test",
                "format does not take \"test\", did you mean \"format text\"?",
            ),
            (
                "xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx",
                "there is no command \"xxxxxxxxxxxxxxxxxxxx...\"; \"help\" names all",
            ),
        ] {
            assert_eq!(parse(text).expect_err(text).to_string(), answer);
        }
    }

    #[test]
    fn a_matrix_has_nine_whole_numbers_and_fits_a_line() {
        let longest = Command::GyroscopeMatrix([*MATRIX_ELEMENTS.start(); 9]).to_string();
        assert!(longest.len() <= LINE_CAPACITY, "{longest}");
        assert!(parse(&longest).is_ok());
        for text in [
            "",
            ",",
            "0,0,0,0,0,0,0,0",
            "0,0,0,0,0,0,0,0,0,",
            "0,0,0,0,0,0,0,0,0,0",
            "0,0,0,0,0,0,0,0,1000",
            "0,0,0,0,0,0,0,0,-1000",
            "0,0,0,0,0,0,0,0,70000",
            "0,0,0,0,0.5,0,0,0,0",
            "0,0,0,0,--5,0,0,0,0",
            "0,0,0,0,+5,0,0,0,0",
            "0,0,0,0,x,0,0,0,0",
        ] {
            let error = parse(&format!("gyro-matrix {text}"));
            let is_refused = matches!(
                error,
                Err(ParseError::NotAMatrix(_) | ParseError::MissingArgument(_))
            );
            assert!(is_refused, "{text}: {error:?}");
        }
    }

    #[test]
    fn a_declination_has_a_sign_digits_and_up_to_two_decimals() {
        for text in [
            "3.",
            ".5",
            "3.517",
            "--3",
            "-+3",
            "3e1",
            "nan",
            "1_0",
            "-",
            "3.+5",
            "-180.01",
            "400",
            "3.-5",
            "4294967297",
            "99999999999.5",
            "3,5",
            "\u{663}",
        ] {
            let error = parse(&format!("declination {text}"));
            let is_refused = matches!(error, Err(ParseError::NotADeclination(_)));
            assert!(is_refused, "{text}: {error:?}");
        }
    }

    /// Text that is near to being a command.
    fn nearly() -> impl Strategy<Value = String> {
        let words = "(help|save|mount|rate|baud|calibrate|format|gyro|find|declination|50|9600|\
                     -3.5|text|\\+x-z|[ -~]{0,8})";
        proptest::collection::vec(words, 0..4).prop_map(|words| words.join(" "))
    }

    proptest! {
        #[test]
        fn any_line_has_an_answer(line in prop_oneof![nearly(), "[ -~]{0,64}", "\\PC{0,64}"]) {
            if let Err(error) = parse(&line) {
                let answer = error.to_string();
                prop_assert!(!answer.is_empty() && answer.len() <= 180, "{}", answer);
                // Every suggestion is a command, or needs an argument.
                if let Some((_, suggestion)) = answer.split_once("did you mean \"") {
                    let suggestion = suggestion.trim_end_matches("\"?");
                    let result = parse(suggestion);
                    let is_form = matches!(result, Ok(_) | Err(ParseError::MissingArgument(_)));
                    prop_assert!(is_form, "{}", suggestion);
                }
            }
        }

        /// The parser guesses nothing: a changed letter is no command.
        #[test]
        fn a_changed_letter_is_no_command(at in 0_usize..4, letter in b'a'..=b'z') {
            let mut word = *b"save";
            word[at] = letter;
            let word = core::str::from_utf8(&word).expect("ASCII");
            prop_assert_eq!(parse(word).is_ok(), word == "save");
        }
    }
}
