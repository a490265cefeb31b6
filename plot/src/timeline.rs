//! Values over time in fixed memory: what a picture can show of an hour as well as of a second.
//!
//! Time is cut into equal pieces, each of which keeps the least and the greatest value in it. When
//! there are too many pieces, two become one: so the length need not be known beforehand,
//! and no peak is lost.

/// No more pieces than this: in the end there are between half as many and all of them.
const PIECES: usize = 2_048;

/// The shortest piece, s.
const SHORTEST_S: f64 = 1e-3;

/// After so long a time without a value a curve is interrupted, s.
const GAP_S: f64 = 0.5;

/// Values of which two can be merged into one.
pub trait Merge: Copy {
    /// Takes in a later value.
    fn merge(&mut self, later: &Self);
}

/// Pieces of time and what is in them.
#[derive(Clone, Debug)]
pub struct Timeline<T> {
    start_s: f64,
    piece_s: f64,
    pieces: Vec<Option<T>>,
}

impl<T> Default for Timeline<T> {
    fn default() -> Self {
        Self {
            start_s: f64::NAN,
            piece_s: SHORTEST_S,
            pieces: Vec::new(),
        }
    }
}

impl<T: Merge> Timeline<T> {
    /// Adds what is at this time, in seconds. What comes from before the first time counts as the
    /// first.
    pub fn push(&mut self, time_s: f64, item: T) {
        if self.pieces.is_empty() {
            self.start_s = time_s;
        }
        let mut index = self.index(time_s);
        while index >= PIECES {
            self.halve();
            index = self.index(time_s);
        }
        if index >= self.pieces.len() {
            self.pieces.resize(index + 1, None);
        }
        match &mut self.pieces[index] {
            Some(piece) => piece.merge(&item),
            empty => *empty = Some(item),
        }
    }

    /// The pieces that have something in them: from when, until when, and what. One that is
    /// followed by empty pieces lasts until the next, unless that is a gap: so values may come
    /// irregularly.
    pub fn iter(&self) -> impl Iterator<Item = (f64, f64, &T)> {
        let at_s = |index: usize| self.start_s + index as f64 * self.piece_s;
        self.pieces
            .iter()
            .enumerate()
            .filter_map(move |(index, piece)| {
                let piece = piece.as_ref()?;
                let rest = self.pieces.get(index + 1..).unwrap_or_default();
                let empty = rest.iter().take_while(|piece| piece.is_none()).count();
                let is_gap = empty == rest.len() || empty as f64 * self.piece_s > GAP_S;
                let end = index + 1 + if is_gap { 0 } else { empty };
                Some((at_s(index), at_s(end), piece))
            })
    }

    fn index(&self, time_s: f64) -> usize {
        // A cast saturates.
        ((time_s - self.start_s) / self.piece_s) as usize
    }

    fn halve(&mut self) {
        self.piece_s *= 2.0;
        self.pieces = self
            .pieces
            .chunks(2)
            .map(|pair| match pair {
                [Some(first), Some(second)] => {
                    let mut both = *first;
                    both.merge(second);
                    Some(both)
                }
                [first, second] => first.or(*second),
                rest => rest.first().copied().flatten(),
            })
            .collect();
    }
}

/// The least and the greatest value of a piece, with their times in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Extremes {
    low: (f64, f64),
    high: (f64, f64),
    /// The curve is interrupted before it.
    is_start: bool,
}

impl Merge for Extremes {
    fn merge(&mut self, later: &Self) {
        if later.low.1 < self.low.1 {
            self.low = later.low;
        }
        if later.high.1 > self.high.1 {
            self.high = later.high;
        }
        self.is_start |= later.is_start;
    }
}

/// A curve over time.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    timeline: Timeline<Extremes>,
    last: Option<(f64, f64)>,
    wraps: bool,
    /// Whole turns to add to an angle so that it continues from the one before.
    turned: f64,
}

impl Trace {
    /// A curve of angles in degrees that wrap at ±180: as they are added they may go beyond.
    #[must_use]
    pub fn of_angles() -> Self {
        Self {
            wraps: true,
            ..Self::default()
        }
    }

    /// A curve through these points: seconds and values.
    #[must_use]
    pub fn through(points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        let mut trace = Self::default();
        for (time_s, value) in points {
            trace.push(time_s, value);
        }
        trace
    }

    /// Adds a value at a time, in seconds. What is not finite interrupts the curve.
    pub fn push(&mut self, time_s: f64, value: f64) {
        if !value.is_finite() {
            self.last = None;
            return;
        }
        let mut value = value + self.turned;
        if let Some((_, last)) = self.last.filter(|_| self.wraps) {
            let turn = ((last - value) / 360.0).round() * 360.0;
            self.turned += turn;
            value += turn;
        }
        let is_start = self
            .last
            .is_none_or(|(last_s, _)| !(0.0..=GAP_S).contains(&(time_s - last_s)));
        let at = (time_s, value);
        self.timeline.push(
            time_s,
            Extremes {
                low: at,
                high: at,
                is_start,
            },
        );
        self.last = Some(at);
    }

    /// Returns true if it has no values.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.timeline.pieces.is_empty()
    }

    /// The least and the greatest value, angles between −180 and 180; `None` if there is none.
    #[must_use]
    pub fn range(&self) -> Option<(f64, f64)> {
        let values = self
            .lines()
            .into_iter()
            .flatten()
            .map(|(_, value)| value)
            .map(|value| {
                if self.wraps {
                    value.clamp(-180.0, 180.0)
                } else {
                    value
                }
            });
        values.fold(None, |range, value| {
            let (low, high) = range.unwrap_or((value, value));
            Some((low.min(value), high.max(value)))
        })
    }

    /// The curve's parts, without interruption each: seconds and values. An angle that wraps leaves
    /// on one side, by less than a piece beyond ±180, and enters on the other.
    #[must_use]
    pub fn lines(&self) -> Vec<Vec<(f64, f64)>> {
        let mut lines: Vec<Vec<(f64, f64)>> = Vec::new();
        let turn_of = |value: f64| match self.wraps {
            true => (value / 360.0).round() * 360.0,
            false => 0.0,
        };
        let mut turn = 0.0;
        for (_, _, piece) in self.timeline.iter() {
            let mut points = [piece.low, piece.high];
            if piece.high.0 < piece.low.0 {
                points.reverse();
            }
            let is_one = piece.low == piece.high;
            for (nth, (time_s, value)) in points.into_iter().enumerate() {
                if nth == 1 && is_one {
                    continue;
                }
                let is_start = lines.is_empty() || (nth == 0 && piece.is_start);
                let own_turn = turn_of(value);
                if own_turn != turn && !is_start {
                    // The curve leaves on one side and enters on the other.
                    if let Some(line) = lines.last_mut() {
                        line.push((time_s, value - turn));
                    }
                }
                if is_start || own_turn != turn {
                    let before = lines
                        .last()
                        .and_then(|line| line.iter().rev().nth(1))
                        .copied();
                    let mut line = Vec::new();
                    if let Some((before_s, before)) = before.filter(|_| !is_start) {
                        line.push((before_s, before + turn - own_turn));
                    }
                    lines.push(line);
                    turn = own_turn;
                }
                if let Some(line) = lines.last_mut() {
                    line.push((time_s, value - turn));
                }
            }
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_curves_keep_every_point() {
        let points: Vec<_> = (0..500)
            .map(|nth| (f64::from(nth) * 0.002, f64::from(nth % 7)))
            .collect();
        let trace = Trace::through(points.iter().copied());
        assert_eq!(trace.lines(), [points]);
        assert_eq!(trace.range(), Some((0.0, 6.0)));
    }

    #[test]
    fn an_hour_keeps_its_peaks_in_little_memory() {
        let peak = |nth: u32| match nth {
            1_234_567 => 9.0,
            2_000_001 => -8.0,
            _ => (f64::from(nth) * 1e-3).sin(),
        };
        let trace = Trace::through((0..3_600_000).map(|nth| (f64::from(nth) * 1e-3, peak(nth))));
        let lines = trace.lines();
        assert_eq!(lines.len(), 1);
        assert!(
            (PIECES / 2..=2 * PIECES).contains(&lines[0].len()),
            "{}",
            lines[0].len()
        );
        assert!(lines[0].contains(&(1_234.567, 9.0)) && lines[0].contains(&(2_000.001, -8.0)));
        assert!(lines[0].is_sorted_by(|before, after| before.0 <= after.0));
        assert_eq!(trace.range(), Some((-8.0, 9.0)));
    }

    #[test]
    fn gaps_and_what_is_no_number_interrupt_a_curve() {
        let nothing = f64::NAN;
        let points = [
            (0.0, 1.0),
            (0.1, 2.0),
            (0.2, nothing),
            (0.3, 3.0),
            (1.0, 4.0),
            (1.1, 5.0),
        ];
        let lines = Trace::through(points).lines();
        let expected = [
            vec![(0.0, 1.0), (0.1, 2.0)],
            vec![(0.3, 3.0)],
            vec![(1.0, 4.0), (1.1, 5.0)],
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn an_angle_that_wraps_leaves_on_one_side_and_enters_on_the_other() {
        let mut trace = Trace::of_angles();
        // Two turns and a half, at 100 °/s.
        for nth in 0..900 {
            let angle = f64::from(nth);
            trace.push(angle * 0.01, (angle + 180.0).rem_euclid(360.0) - 180.0);
        }
        let lines = trace.lines();
        assert_eq!(lines.len(), 3, "{lines:?}");
        for line in &lines {
            for pair in line.windows(2) {
                assert!((pair[1].1 - pair[0].1 - 1.0).abs() < 1e-9, "{pair:?}");
            }
            assert!(line.iter().all(|(_, angle)| angle.abs() < 183.0));
        }
        assert_eq!(trace.range(), Some((-180.0, 180.0)));
    }

    #[test]
    fn what_is_in_a_piece_and_when_is_told() {
        #[derive(Clone, Copy)]
        struct Count(u32);
        impl Merge for Count {
            fn merge(&mut self, later: &Self) {
                self.0 += later.0;
            }
        }
        let mut timeline = Timeline::default();
        for nth in 0..100_000 {
            timeline.push(5.0 + f64::from(nth) * 1e-3, Count(1));
        }
        let total: u32 = timeline.iter().map(|(_, _, count)| count.0).sum();
        assert_eq!(total, 100_000);
        let (start_s, ..) = timeline.iter().next().unwrap();
        let (_, end_s, _) = timeline.iter().last().unwrap();
        assert_eq!(start_s, 5.0);
        assert!((105.0..105.2).contains(&end_s), "{end_s}");
        // What comes irregularly lasts until the next, but not over a gap.
        let mut timeline = Timeline::default();
        for time_s in [0.0, 0.0035, 0.01, 1.0] {
            timeline.push(time_s, Count(1));
        }
        let spans: Vec<(f64, f64)> = timeline
            .iter()
            .map(|(start, end, _)| (start, end))
            .collect();
        let expected = [(0.0, 0.003), (0.003, 0.01), (0.01, 0.011), (1.0, 1.001)];
        for (found, expected) in spans.iter().zip(expected) {
            assert!(
                (found.0 - expected.0).abs() + (found.1 - expected.1).abs() < 1e-9,
                "{spans:?}"
            );
        }
        assert_eq!(spans.len(), expected.len());
        // Time that goes back counts as the first.
        timeline.push(-1.0, Count(1));
        assert_eq!(timeline.iter().next().unwrap().2.0, 2);
    }
}
