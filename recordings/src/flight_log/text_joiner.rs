//! Joiner of a message's pieces: a frame of a flight log holds some 240 bytes.

use aplomb::telemetry::log::{TEXT_CAPACITY, Text};

/// Fewest bytes of a full piece of a message: it ends with a whole character.
const FULL_PIECE: usize = TEXT_CAPACITY - 3;
/// Most bytes of a message that is joined. The module has shorter ones.
const MOST_BYTES: usize = 4096;

/// Joiner of a message's pieces. They come without other frames between.
#[derive(Debug, Default)]
pub struct TextJoiner {
    /// Pieces of a message whose last piece was full, so that another may follow.
    text: String,
}

impl TextJoiner {
    /// Adds a piece. Returns the message that it completes.
    pub fn add(&mut self, piece: &Text) -> Option<String> {
        self.text += piece.as_str();
        let may_continue = piece.as_str().len() >= FULL_PIECE && self.text.len() < MOST_BYTES;
        if may_continue { None } else { self.end() }
    }

    /// Ends the message, because another frame comes or the log ends. Returns it if no piece before
    /// has completed it.
    pub fn end(&mut self) -> Option<String> {
        let text = std::mem::take(&mut self.text);
        (!text.is_empty()).then_some(text)
    }
}

#[cfg(test)]
mod tests {
    use aplomb::telemetry::Output;
    use aplomb::telemetry::log::{FRAME_CAPACITY, Frame, encode, put_text};

    use super::super::decode;

    #[test]
    fn a_long_message_of_a_log_is_whole() {
        let long = "ok status: ".to_owned() + &"°".repeat(300);
        let mut buffer = [0; 2000];
        let mut output = Output::new(&mut buffer);
        for text in ["short", &long, "after"] {
            assert!(put_text(text, &mut output));
        }
        let length = output.length();
        let log = decode(&buffer[..length]).expect("few flights");
        assert_eq!(log.messages, ["short", &long, "after"]);
        // A log that ends after a full piece has the first one alone.
        let mut first = [0; FRAME_CAPACITY];
        let piece = aplomb::telemetry::log::Text::new(&long);
        let bytes = encode(&Frame::Text(piece), &mut first);
        let log = decode(bytes).expect("few flights");
        assert_eq!(log.messages, [piece.as_str()]);
    }
}
