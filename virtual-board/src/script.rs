//! Scripts of commands to the firmware's UART: a file with a line `seconds command` for each
//! command.
//!
//! Empty lines and lines that begin with `#` are comments.

use std::path::Path;

use aplomb_recordings::quote::quote;
use aplomb_recordings::text::read_small;

use crate::Error;

/// Commands with their times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Script(Vec<(f64, String)>);

impl Script {
    /// Reads a file.
    ///
    /// # Errors
    ///
    /// When it cannot be read, or a line does not begin with a time; the error names the line.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let refuse = |reason: String| Error::Script(path.to_owned(), reason);
        let text = read_small(path).map_err(|error| refuse(error.to_string()))?;
        Self::parse(&text).map_err(refuse)
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    ///
    /// The number of the line that is wrong, and why.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut lines = Vec::new();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let (seconds, command) = line.split_once(char::is_whitespace).ok_or_else(|| {
                let line = quote(line);
                format!("line {}: `{line}` is not `seconds command`", index + 1)
            })?;
            let at_s: f64 = seconds
                .parse()
                .ok()
                .filter(|at_s| (0.0..=86_400.0).contains(at_s))
                .ok_or_else(|| {
                    format!(
                        "line {}: `{}` is no time from 0 to 86400 s",
                        index + 1,
                        quote(seconds)
                    )
                })?;
            lines.push((at_s, command.trim_start().to_owned()));
        }
        Ok(Self(lines))
    }

    /// The commands with their times in seconds since power-up, as in the file.
    #[must_use]
    pub fn lines(&self) -> &[(f64, String)] {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn any_text_is_a_script_that_reads_back_or_a_line_that_is_wrong(
            lines in prop::collection::vec(
                "([0-9]{1,5}(\\.[0-9]{1,3})?|-1|x)?[ \t]{0,2}[ -~é]{0,8}|#.{0,5}",
                0..5,
            ),
        ) {
            match Script::parse(&lines.join("\n")) {
                Ok(script) => {
                    let lines = script.lines().iter();
                    let written: String =
                        lines.map(|(at_s, command)| format!("{at_s} {command}\n")).collect();
                    prop_assert_eq!(Script::parse(&written), Ok(script));
                }
                Err(reason) => {
                    let rest = reason.strip_prefix("line ");
                    let number = rest.and_then(|rest| rest.split(':').next()?.parse().ok());
                    let number: usize = number.expect("a line");
                    prop_assert!(Script::parse(&lines[..number - 1].join("\n")).is_ok());
                    prop_assert!(Script::parse(&lines[number - 1]).is_err(), "{}", reason);
                }
            }
        }
    }

    #[test]
    fn times_and_commands_are_read_and_comments_left_out() {
        let script = Script::parse("# greeting\n\n0.5 help\n 2\tmount  +x-z \n").unwrap();
        assert_eq!(
            script.lines(),
            [(0.5, "help".to_owned()), (2.0, "mount  +x-z".to_owned())]
        );
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (text, reason) in [
            ("1 help\nhelp\n", "line 2: `help` is not `seconds command`"),
            ("soon help", "line 1: `soon` is no time from 0 to 86400 s"),
            ("-1 help", "line 1: `-1` is no time from 0 to 86400 s"),
            ("nan help", "line 1: `nan` is no time from 0 to 86400 s"),
        ] {
            assert_eq!(Script::parse(text), Err(reason.to_owned()));
        }
    }
}
