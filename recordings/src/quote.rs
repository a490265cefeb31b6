//! Quotations of input in messages: short, and without control characters.

/// Most characters of a quotation.
pub const LONGEST_QUOTE: usize = 80;

/// Returns a text of an input as a message may show it: at most 80 characters, with an ellipsis
/// in place of the rest. Control characters are escaped, so that a terminal does not obey them.
#[must_use]
pub fn quote(text: &str) -> String {
    let mut quoted = String::new();
    let mut length = 0;
    let mut fits = 0;
    for character in text.chars() {
        let start = quoted.len();
        if character.is_control() {
            quoted.extend(character.escape_default());
        } else {
            quoted.push(character);
        }
        length += quoted[start..].chars().count();
        if length > LONGEST_QUOTE {
            quoted.truncate(fits);
            quoted.push('…');
            return quoted;
        }
        if length < LONGEST_QUOTE {
            fits = quoted.len();
        }
    }
    quoted
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_short_text_is_itself_and_a_long_one_ends_early() {
        assert_eq!(quote("t_us,ax é"), "t_us,ax é");
        assert_eq!(quote(&"é".repeat(80)), "é".repeat(80));
        assert_eq!(quote(&"é".repeat(81)), format!("{}…", "é".repeat(79)));
        assert_eq!(quote("\u{1b}[2J\0"), "\\u{1b}[2J\\u{0}");
    }

    proptest! {
        #[test]
        fn a_quotation_is_short_and_obeyed_by_no_terminal(text in "(.|\u{1b}|\n){0,200}") {
            let quoted = quote(&text);
            prop_assert!(quoted.chars().count() <= LONGEST_QUOTE);
            prop_assert!(!quoted.contains(char::is_control));
        }
    }
}
