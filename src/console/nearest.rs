//! Suggestion of a known word for a misspelt one.

/// Returns the known word nearest to `word`, if one is near; of equals the first.
///
/// A word is near if one abbreviates the other, or if they differ in one place of at most a third
/// of the longer word. Case does not count.
pub(super) fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let mut best = None;
    for candidate in known {
        let length = difference(word.as_bytes(), candidate.as_bytes());
        let is_near = length <= (word.len().max(candidate.len()) / 3).max(1);
        if is_near && best.is_none_or(|(_, least)| length < least) {
            best = Some((candidate, length));
        }
    }
    best.map(|(candidate, _)| candidate)
}

/// Returns the length of the place in which two words differ: the longer one without their common
/// beginning and end. Returns 0 if one has at least two letters and begins the other.
fn difference(a: &[u8], b: &[u8]) -> usize {
    let shorter = a.len().min(b.len());
    let same = |(a, b): &(&u8, &u8)| a.eq_ignore_ascii_case(b);
    let start = a.iter().zip(b).take_while(same).count();
    if start == shorter && shorter >= 2 {
        return 0;
    }
    let end = a.iter().rev().zip(b.iter().rev()).take_while(same).count();
    a.len().max(b.len()) - (start + end).min(shorter)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const WORDS: [&str; 7] = [
        "status",
        "show",
        "save",
        "calibrate",
        "rate",
        "temperature",
        "self-test",
    ];

    #[test]
    fn typing_errors_find_their_word() {
        for (typed, meant) in [
            ("stauts", "status"),
            ("Save", "save"),
            ("SHOW", "show"),
            ("sho", "show"),
            ("callibrate", "calibrate"),
            ("cal", "calibrate"),
            ("temp", "temperature"),
            ("tempreture", "temperature"),
            ("rates", "rate"),
            ("selftest", "self-test"),
            ("savetheworld!", "save"),
        ] {
            assert_eq!(nearest(typed, WORDS), Some(meant), "{typed}");
        }
        for typed in ["", "x", "s", "fly", "reboot", "löschen"] {
            assert_eq!(nearest(typed, WORDS), None, "{typed}");
        }
    }

    proptest! {
        /// One letter more, less or otherwise, in any word, and it is found again.
        #[test]
        fn one_typing_error_is_accepted(
            which in 0..WORDS.len(),
            at in 0_usize..12,
            letter in b'a'..=b'z',
            kind in 0..3,
        ) {
            let word = WORDS[which];
            let mut typed = word.as_bytes().to_vec();
            let at = at % word.len();
            match kind {
                0 => typed.insert(at, letter),
                1 => typed[at] = letter,
                _ => drop(typed.remove(at)),
            }
            let typed = String::from_utf8(typed).expect("ASCII");
            let found = nearest(&typed, WORDS);
            prop_assert!(found.is_some(), "{}", typed);
            // Another word can be as near, but none is nearer.
            let length = |known: &str| difference(typed.as_bytes(), known.as_bytes());
            prop_assert!(found.is_some_and(|found| length(found) <= length(word)));
        }

        #[test]
        fn any_text_gives_an_answer(word in "\\PC{0,40}") {
            if let Some(found) = nearest(&word, WORDS) {
                prop_assert!(WORDS.contains(&found));
            }
        }
    }
}
