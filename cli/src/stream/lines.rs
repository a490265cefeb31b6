//! Formats that are lines of text.

use aplomb::health::Flags;
use aplomb::settings::OutputFormat;
use aplomb::telemetry::text::Line;
use aplomb::telemetry::{classic, heading, teleplot, text};
use aplomb_recordings::attitude_table::Columns;

use super::item::{Attitude, Format, Item};

/// Longest line of the module, with a margin: a status has up to 610 letters.
const LONGEST_LINE: usize = 1024;

/// Content of a line.
pub enum Content {
    /// An attitude in this format.
    Attitude(Format),
    /// A message, a part of an attitude, or nothing.
    Other,
    /// A line of no known format.
    Unknown,
}

/// Returns the lasting flags that a message names: those that have changed, or those of a status.
fn flags_of(message: &str) -> Option<Flags> {
    let names = message.strip_prefix("attitude: ").or_else(|| {
        let status = message.strip_prefix("ok status: flags=")?;
        status.split(' ').next()
    })?;
    let flags: Flags = names.parse().ok()?;
    Some(flags & (Flags::LASTING | Flags::CALIBRATING))
}

/// Decoder of the formats that are lines of text.
#[derive(Default)]
pub struct Lines {
    bytes: Vec<u8>,
    /// The beginning of the present line has been seen.
    is_in_step: bool,
    columns: Option<Columns>,
    /// Variables of `teleplot` so far.
    variables: Line,
    heading: heading::Line,
    /// Flags that the module named last.
    named: Flags,
}

impl Lines {
    /// Expects the beginning of a line.
    pub fn restart(&mut self) {
        self.bytes.clear();
        self.is_in_step = true;
    }

    /// Takes a byte, and returns the content of the line that it ends.
    pub fn push(&mut self, byte: u8, items: &mut Vec<Item>) -> Option<Content> {
        match byte {
            b'\n' => {
                let was_in_step = std::mem::replace(&mut self.is_in_step, true);
                let bytes = std::mem::take(&mut self.bytes);
                let content = match std::str::from_utf8(&bytes) {
                    Ok(line) => self.line(line.trim_end_matches('\r'), items),
                    Err(_) => Content::Unknown,
                };
                self.bytes = bytes;
                self.bytes.clear();
                let is_half_line = !was_in_step && matches!(content, Content::Unknown);
                (!is_half_line).then_some(content)
            }
            // A text has no zeros. After one, a line may begin, or another format continues.
            0 => {
                self.bytes.clear();
                self.is_in_step = false;
                None
            }
            _ => {
                if self.bytes.len() < LONGEST_LINE {
                    self.bytes.push(byte);
                }
                None
            }
        }
    }

    fn line(&mut self, line: &str, items: &mut Vec<Item>) -> Content {
        let module = |format| Content::Attitude(Format::Module(format));
        if let Some(message) = line.strip_prefix("# ") {
            self.named = flags_of(message).unwrap_or(self.named);
            items.push(Item::Message(message.to_owned()));
            return Content::Other;
        }
        if let Ok(line) = text::decode(line) {
            self.attitude(&line, items);
            return module(OutputFormat::Text);
        }
        if let Some(heading) = heading::decode(line) {
            items.push(Item::Heading(heading));
            return Content::Other;
        }
        if let Some(angles) = classic::decode(line) {
            items.push(Item::Attitude(Attitude {
                roll_deg: angles.roll_deg,
                pitch_deg: angles.pitch_deg,
                rates_deg_s: [
                    Some(angles.roll_rate_deg_s),
                    Some(angles.pitch_rate_deg_s),
                    None,
                ],
                ..Attitude::default()
            }));
            return module(OutputFormat::Classic);
        }
        if let Some((label, value)) = teleplot::decode(line) {
            return self.variable(label, value, items);
        }
        if let Some(columns) = Columns::of(line) {
            self.columns = Some(columns);
            return Content::Other;
        }
        if let Some(columns) = &self.columns
            && let Ok(row) = columns.row(line)
        {
            items.push(Item::Attitude(Attitude::of_row(&row)));
            items.extend(row.tilt_sigma_deg.map(Item::TiltSigma));
            return Content::Attitude(Format::Table);
        }
        if line.is_empty() {
            Content::Other
        } else {
            Content::Unknown
        }
    }

    fn attitude(&mut self, line: &Line, items: &mut Vec<Item>) {
        let over = Flags::INVALIDATING | Flags::CALIBRATING;
        if line.is_valid && self.named.intersects(over) {
            // The condition that was named is over. No message ends `CALIBRATING`.
            self.named = Flags::empty();
        }
        items.push(Item::Attitude(Attitude::of_line(line, self.named)));
    }

    /// Takes a variable of `teleplot`. `valid` completes the attitude, `heading_valid` the heading.
    fn variable(&mut self, label: &str, value: f32, items: &mut Vec<Item>) -> Content {
        let variables = &mut self.variables;
        match label {
            "roll" => variables.roll_deg = value,
            "pitch" => variables.pitch_deg = value,
            "yaw" => variables.yaw_deg = value,
            "roll_rate" => variables.roll_rate_deg_s = value,
            "pitch_rate" => variables.pitch_rate_deg_s = value,
            "yaw_rate" => variables.yaw_rate_deg_s = value,
            "heading" => self.heading.heading_deg = value,
            "heading_sigma" => self.heading.sigma_deg = value,
            "heading_valid" => {
                self.heading.is_valid = value == 1.0;
                items.push(Item::Heading(self.heading));
            }
            "valid" => {
                variables.is_valid = value == 1.0;
                let line = *variables;
                self.attitude(&line, items);
                return Content::Attitude(Format::Module(OutputFormat::Teleplot));
            }
            // A label that belongs to neither.
            _ => {}
        }
        Content::Other
    }
}
