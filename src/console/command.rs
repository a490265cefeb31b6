//! What can be asked for, as text: one table of words, read by the parser, by `help` and by the suggestions.
//!
//! Words are exact and in small letters, so that noise is no command; what is nearly right is answered with the
//! right form instead. A number has digits and nothing else.

use core::fmt;

use super::line::LINE_CAPACITY;
use super::nearest::nearest;
use crate::calibration::{Mount, OutputFormat};

/// What somebody asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Command {
    /// Every command on one line.
    Help,
    /// How the module is.
    Status,
    /// The working record: what `save` would store.
    Show,
    /// Stores the working record.
    Save,
    /// Makes the working record empty.
    Forget,
    /// Tests the sensor against its factory's figures.
    SelfTest,
    /// Nothing is done any more that is only safe on the ground.
    Arm,
    /// The opposite.
    Disarm,
    /// Measures something, or ends that.
    Calibrate(Calibrate),
    /// Says how the sensor is mounted, or has it found out.
    Mount(MountChoice),
    /// Telemetry lines per second, in [`RATES_HZ`].
    Rate(u16),
    /// Bits per second on the UART, one of [`BAUD_RATES`].
    Baud(u32),
    /// What the telemetry looks like.
    Format(OutputFormat),
}

/// What `calibrate` measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Calibrate {
    /// The gyroscope's offset, at rest.
    Gyroscope,
    /// The accelerometer's offset and scales, in several poses.
    Accelerometer,
    /// The level, at rest on something level.
    Level,
    /// How the gyroscope's offset goes with temperature, at rest while it changes.
    Temperature,
    /// What was collected so far is enough.
    Done,
    /// Nothing is wanted of it any more.
    Stop,
}

/// What `mount` takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MountChoice {
    /// This one.
    Named(Mount),
    /// Whichever two poses show.
    Find,
}

/// The rates that `rate` takes, in lines per second: up to one per sample.
pub const RATES_HZ: core::ops::RangeInclusive<u16> = 1..=1000;

/// The rates that `baud` takes. Each is within 1 % on every board.
pub const BAUD_RATES: [u32; 8] = [
    9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 921_600,
];

/// A command's name and what goes with it.
#[derive(Debug, PartialEq, Eq)]
pub struct Form {
    name: &'static str,
    argument: Argument,
}

#[derive(Debug, PartialEq, Eq)]
enum Argument {
    Nothing,
    Word(&'static [&'static str]),
    Mount,
    Hertz,
    Baud,
}

const CALIBRATIONS: [&str; 6] = ["gyro", "accel", "level", "temperature", "done", "stop"];

/// Every command, in the order in which `help` names them and suggestions prefer them.
static FORMS: [Form; 13] = [
    Form::alone("help"),
    Form::alone("status"),
    Form::alone("show"),
    Form::new("calibrate", Argument::Word(&CALIBRATIONS)),
    Form::new("mount", Argument::Mount),
    Form::alone("self-test"),
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

    /// Every command's form.
    pub fn all() -> &'static [Self] {
        &FORMS
    }
}

impl fmt::Display for Form {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name)?;
        match self.argument {
            Argument::Nothing => Ok(()),
            Argument::Word(words) => words.iter().enumerate().try_for_each(|(index, word)| {
                formatter.write_str(if index == 0 { " " } else { "|" })?;
                formatter.write_str(word)
            }),
            Argument::Mount => formatter.write_str(" find|<forward><down>"),
            Argument::Hertz => formatter.write_str(" <hz>"),
            Argument::Baud => formatter.write_str(" <bps>"),
        }
    }
}

/// Why a line is not a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ParseError {
    /// No command has this name.
    UnknownCommand {
        /// The word.
        word: Word,
        /// The command that may have been meant.
        nearest: Option<&'static str>,
    },
    /// The command does not take this word.
    UnknownArgument {
        /// The command.
        form: &'static Form,
        /// The word.
        word: Word,
        /// The one that may have been meant.
        nearest: Option<&'static str>,
    },
    /// The command needs a word more.
    MissingArgument(&'static Form),
    /// The command does not take this word any more.
    ExtraWord {
        /// The command.
        form: &'static Form,
        /// The word.
        word: Word,
    },
    /// `rate` takes a number in [`RATES_HZ`].
    NotARate(Word),
    /// `baud` takes one of [`BAUD_RATES`].
    NotABaudRate {
        /// The word.
        word: Word,
        /// The rate that may have been meant.
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
                        "; it takes \"find\", or the sensor's axes that point forward and down, such as \"mount +x-z\"",
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

/// A word of a line, cut after [`Word::LENGTH`] bytes.
#[derive(Clone, PartialEq, Eq)]
pub struct Word {
    text: heapless::String<{ Word::LENGTH }>,
    is_cut: bool,
}

impl Word {
    /// The longest word kept whole.
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

/// Reads a line, without its end.
///
/// # Errors
///
/// What is wrong with it, with the nearest right form.
pub fn parse(line: &str) -> Result<Command, ParseError> {
    let mut words = line.split_ascii_whitespace();
    let name = words.next().unwrap_or_default();
    let Some(form) = FORMS.iter().find(|form| form.name == name) else {
        return Err(ParseError::UnknownCommand {
            word: Word::new(name),
            nearest: nearest(name, FORMS.iter().map(|form| form.name)),
        });
    };
    let argument = words.next();
    let extra = match form.argument {
        Argument::Nothing => argument,
        _ => words.next(),
    };
    if let Some(extra) = extra {
        return Err(ParseError::ExtraWord {
            form,
            word: Word::new(extra),
        });
    }
    if form.argument != Argument::Nothing && argument.is_none() {
        return Err(ParseError::MissingArgument(form));
    }
    let argument = argument.unwrap_or_default();
    let unknown = |known: &[&'static str]| ParseError::UnknownArgument {
        form,
        word: Word::new(argument),
        nearest: nearest(argument, known.iter().copied()),
    };
    Ok(match form.name {
        "help" => Command::Help,
        "status" => Command::Status,
        "show" => Command::Show,
        "save" => Command::Save,
        "forget" => Command::Forget,
        "self-test" => Command::SelfTest,
        "arm" => Command::Arm,
        "disarm" => Command::Disarm,
        "calibrate" => Command::Calibrate(match argument {
            "gyro" => Calibrate::Gyroscope,
            "accel" => Calibrate::Accelerometer,
            "level" => Calibrate::Level,
            "temperature" => Calibrate::Temperature,
            "done" => Calibrate::Done,
            "stop" => Calibrate::Stop,
            _ => return Err(unknown(&CALIBRATIONS)),
        }),
        "mount" if argument == "find" => Command::Mount(MountChoice::Find),
        "mount" => match Mount::parse(argument) {
            Some(mount) => Command::Mount(MountChoice::Named(mount)),
            None => return Err(unknown(&["find", "z-up", "z-down"])),
        },
        "rate" => match number(argument).and_then(|rate| u16::try_from(rate).ok()) {
            Some(rate) if RATES_HZ.contains(&rate) => Command::Rate(rate),
            _ => return Err(ParseError::NotARate(Word::new(argument))),
        },
        "format" => match OutputFormat::parse(argument) {
            Some(format) => Command::Format(format),
            None => return Err(unknown(&OutputFormat::NAMES)),
        },
        _ => match number(argument) {
            Some(rate) if BAUD_RATES.contains(&rate) => Command::Baud(rate),
            rate => {
                return Err(ParseError::NotABaudRate {
                    word: Word::new(argument),
                    nearest: rate.and_then(nearest_baud_rate),
                });
            }
        },
    })
}

/// Digits, and nothing else.
fn number(text: &str) -> Option<u32> {
    let is_number = text.bytes().all(|byte| byte.is_ascii_digit());
    if is_number { text.parse().ok() } else { None }
}

/// The rate within a tenth of this one.
fn nearest_baud_rate(rate: u32) -> Option<u32> {
    BAUD_RATES
        .into_iter()
        .find(|known| known.abs_diff(rate) <= known / 10)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn every_command_is_understood() {
        let commands = [
            ("help", Command::Help),
            ("status", Command::Status),
            ("show", Command::Show),
            ("save", Command::Save),
            ("forget", Command::Forget),
            ("self-test", Command::SelfTest),
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
            ("calibrate done", Command::Calibrate(Calibrate::Done)),
            ("calibrate stop", Command::Calibrate(Calibrate::Stop)),
            ("mount find", Command::Mount(MountChoice::Find)),
            (
                "mount z-down",
                Command::Mount(MountChoice::Named(Mount::Z_DOWN)),
            ),
            (
                "  mount   +x-z ",
                Command::Mount(MountChoice::Named(Mount::Z_UP)),
            ),
            ("rate 1", Command::Rate(1)),
            ("rate 1000", Command::Rate(1000)),
            ("baud 9600", Command::Baud(9600)),
            ("baud 921600", Command::Baud(921_600)),
            ("format text", Command::Format(OutputFormat::Text)),
            ("format classic", Command::Format(OutputFormat::Classic)),
        ];
        for (text, command) in commands {
            assert_eq!(parse(text), Ok(command), "{text}");
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
    fn wrong_input_is_told_what_is_wrong_and_the_nearest_right_form() {
        let forms = "calibrate gyro|accel|level|temperature|done|stop";
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
                "mount does not take \"+x+x\"; it takes \"find\", or the sensor's axes that point forward and down, \
                 such as \"mount +x-z\"",
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
                "\"1\" is no baud rate; there are 9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600",
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

    /// Text that is near to being a command.
    fn nearly() -> impl Strategy<Value = String> {
        let words =
            "(help|save|mount|rate|baud|calibrate|format|gyro|find|50|9600|text|\\+x-z|[ -~]{0,8})";
        proptest::collection::vec(words, 0..4).prop_map(|words| words.join(" "))
    }

    proptest! {
        #[test]
        fn any_line_has_an_answer(line in prop_oneof![nearly(), "[ -~]{0,64}", "\\PC{0,64}"]) {
            if let Err(error) = parse(&line) {
                let told = error.to_string();
                prop_assert!(!told.is_empty() && told.len() <= 180, "{}", told);
                // Whatever is suggested is itself a command, or needs a word more.
                if let Some((_, suggestion)) = told.split_once("did you mean \"") {
                    let suggestion = suggestion.trim_end_matches("\"?");
                    let result = parse(suggestion);
                    prop_assert!(matches!(result, Ok(_) | Err(ParseError::MissingArgument(_))), "{}", suggestion);
                }
            }
        }

        /// A word less, more or otherwise, and it is no command any more: nothing is guessed.
        #[test]
        fn a_changed_letter_is_no_command(at in 0_usize..4, letter in b'a'..=b'z') {
            let mut word = *b"save";
            word[at] = letter;
            let word = core::str::from_utf8(&word).expect("ASCII");
            prop_assert_eq!(parse(word).is_ok(), word == "save");
        }
    }
}
