//! Which known word somebody may have meant.

/// Words longer than this are compared by their beginning.
const LONGEST: usize = 16;

/// The known word nearest to `word`, if one is near: an abbreviation of at least two letters, or at most one slip
/// (a letter too many, too few, wrong, or two swapped; capitals are none) in three letters. Among equals the first.
pub(super) fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let mut best = None;
    for candidate in known {
        let slips = slips(word, candidate);
        let is_near = slips <= (word.len().max(candidate.len()) / 3).max(1);
        if is_near && best.is_none_or(|(_, fewest)| slips < fewest) {
            best = Some((candidate, slips));
        }
    }
    best.map(|(candidate, _)| candidate)
}

/// The number of slips between two words: the optimal string alignment distance, or zero for an abbreviation.
fn slips(word: &str, known: &str) -> usize {
    let is_start_of = |long: &str, short: &str| {
        long.get(..short.len())
            .is_some_and(|start| start.eq_ignore_ascii_case(short))
    };
    if word.len() >= 2 && (is_start_of(known, word) || is_start_of(word, known)) {
        return 0;
    }
    distance(word.as_bytes(), known.as_bytes())
}

/// Three rows of the table of Wagner and Fischer, with swaps (Damerau, CACM 7, 1964).
fn distance(a: &[u8], b: &[u8]) -> usize {
    let (a, b) = (&a[..a.len().min(LONGEST)], &b[..b.len().min(LONGEST)]);
    let mut before = [0_usize; LONGEST + 1];
    let mut last: [usize; LONGEST + 1] = core::array::from_fn(|column| column);
    let mut previous_a = 0;
    for (row, &a_byte) in a.iter().enumerate() {
        let mut row_costs = [0; LONGEST + 1];
        let mut left = row + 1;
        let mut previous_b = 0;
        if let Some(first) = row_costs.first_mut() {
            *first = left;
        }
        for (column, &b_byte) in b.iter().enumerate() {
            let cost = |row: &[usize], column: usize| row.get(column).copied().unwrap_or(LONGEST);
            let is_same = a_byte.eq_ignore_ascii_case(&b_byte);
            let mut least = (cost(&last, column) + usize::from(!is_same))
                .min(cost(&last, column + 1) + 1)
                .min(left + 1);
            let is_swap = row > 0
                && column > 0
                && a_byte.eq_ignore_ascii_case(&previous_b)
                && b_byte.eq_ignore_ascii_case(&previous_a);
            if is_swap {
                least = least.min(cost(&before, column - 1) + 1);
            }
            if let Some(place) = row_costs.get_mut(column + 1) {
                *place = least;
            }
            left = least;
            previous_b = b_byte;
        }
        before = last;
        last = row_costs;
        previous_a = a_byte;
    }
    last.get(b.len()).copied().unwrap_or(LONGEST)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const WORDS: [&str; 6] = ["status", "show", "save", "calibrate", "rate", "temperature"];

    #[test]
    fn slips_of_the_finger_find_their_word() {
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
        ] {
            assert_eq!(nearest(typed, WORDS), Some(meant), "{typed}");
        }
        for typed in ["", "x", "s", "fly", "reboot", "löschen", "savetheworld!"] {
            let expected = if typed.starts_with("save") {
                Some("save")
            } else {
                None
            };
            assert_eq!(nearest(typed, WORDS), expected, "{typed}");
        }
    }

    /// The definition, by recursion.
    fn by_definition(a: &[u8], b: &[u8]) -> usize {
        let (Some((a_last, a_rest)), Some((b_last, b_rest))) = (a.split_last(), b.split_last())
        else {
            return a.len().max(b.len());
        };
        let mut least = (by_definition(a_rest, b_rest) + usize::from(a_last != b_last))
            .min(by_definition(a_rest, b) + 1)
            .min(by_definition(a, b_rest) + 1);
        if a.len() > 1
            && b.len() > 1
            && a[a.len() - 1] == b[b.len() - 2]
            && a[a.len() - 2] == b[b.len() - 1]
        {
            least = least.min(by_definition(&a[..a.len() - 2], &b[..b.len() - 2]) + 1);
        }
        least
    }

    proptest! {
        #[test]
        fn the_distance_is_the_defined_one(a in "[abc]{0,6}", b in "[abc]{0,6}") {
            prop_assert_eq!(distance(a.as_bytes(), b.as_bytes()), by_definition(a.as_bytes(), b.as_bytes()));
        }

        #[test]
        fn any_text_has_an_answer(word in "\\PC{0,40}") {
            if let Some(found) = nearest(&word, WORDS) {
                prop_assert!(WORDS.contains(&found));
            }
        }
    }
}
