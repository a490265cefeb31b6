//! Times that come in batches, spread evenly.
//!
//! A host that stamps rows as they arrive by USB or radio gives several rows nearly one time, and
//! then none for a while. The sensor measured them at even intervals since the last arrival.

/// First rows that show whether times come in batches.
pub const ROWS_SHOWING: usize = 256;
/// Fewest whole batches that show it. Fewer long steps are pauses.
const FEWEST_BATCHES: usize = 4;
/// Least step before a batch, as a share of the long steps: a quarter.
const LONG_DIVISOR: u64 = 4;
/// Fewest rows of a batch, in the mean.
const FEWEST_ROWS: f64 = 1.5;
/// Largest step within a batch, µs. Sensors with longer steps may pause on purpose.
const LARGEST_STEP_US: u64 = 1_000;
/// Largest step within a batch, as a share of the period.
const LARGEST_STEP_SHARE: f64 = 0.2;
/// Longest usual time between batches, µs: a longer one is a gap.
const LONGEST_BATCH_US: f64 = 500_000.0;
/// Largest factor between the periods that single batches show.
const PERIOD_FACTOR: f64 = 2.0;
/// Most rows that wait for the end of their batch: a clock that stands gives no other.
const MOST_ROWS_WAITING: usize = 65_536;
/// Least share of batches with the usual period.
const LEAST_REGULAR: f64 = 0.75;

/// Spread of times that come in batches.
#[derive(Clone, Copy, Debug)]
pub struct Batches {
    /// Mean time between rows, µs.
    period_us: f64,
    /// Mean number of rows in a batch.
    rows: f64,
    /// Least time between the starts of batches, µs.
    gap_us: u64,
    /// Added to each time, µs, so that none is before zero.
    shift_us: i64,
    /// Start of the current batch and time of the last row, µs.
    current_us: Option<(i64, i64)>,
    /// Start of the last batch that was spread, µs.
    start_us: Option<i64>,
}

impl Batches {
    /// Finds the batches of these first times, µs: regular ones, in which a long step recurs.
    /// Returns `None` for even times, and for times with a few pauses.
    #[must_use]
    pub fn find(times_us: &[i64]) -> Option<Self> {
        let times_us = &times_us[..times_us.len().min(ROWS_SHOWING)];
        let pairs = times_us.windows(2);
        let steps_us: Vec<u64> = pairs.map(|pair| pair[0].abs_diff(pair[1])).collect();
        let mut sorted_us = steps_us.clone();
        sorted_us.sort_unstable();
        // Longer steps than this one are too few to be those before batches.
        let long_us = sorted_us[sorted_us.len().checked_sub(FEWEST_BATCHES)?];
        let gap_us = long_us / LONG_DIVISOR;
        let is_start = |row: &usize| steps_us[row - 1] > gap_us;
        let starts: Vec<usize> = (1..times_us.len()).filter(is_start).collect();
        let (first, last) = (*starts.first()?, *starts.last()?);
        let batches = starts.len() - 1;
        let rows = (last - first) as f64 / batches as f64;
        let within_us = &sorted_us[..sorted_us.partition_point(|step| *step <= gap_us)];
        let step_us = *within_us.get(within_us.len() / 2)?;
        if batches < FEWEST_BATCHES || rows < FEWEST_ROWS || step_us >= LARGEST_STEP_US {
            return None;
        }
        let spans = starts.windows(2).map(|pair| {
            let (start, end) = (pair[0], pair[1]);
            (
                times_us[end].abs_diff(times_us[start]) as f64,
                (end - start) as f64,
            )
        });
        let spans: Vec<(f64, f64)> = spans.collect();
        let mut periods_us: Vec<f64> = spans.iter().map(|(span, rows)| span / rows).collect();
        periods_us.sort_unstable_by(f64::total_cmp);
        let usual_us = periods_us[batches / 2];
        let usual = usual_us / PERIOD_FACTOR..=usual_us * PERIOD_FACTOR;
        let regular = spans
            .iter()
            .filter(|(span, rows)| usual.contains(&(span / rows)));
        let (count, span_us, regular_rows) = regular
            .fold((0.0, 0.0, 0.0), |(count, spans, sum), (span, rows)| {
                (count + 1.0, spans + span, sum + rows)
            });
        let period_us = span_us / regular_rows;
        let is_regular = count >= LEAST_REGULAR * batches as f64
            && (step_us as f64) < LARGEST_STEP_SHARE * period_us
            && span_us / count <= LONGEST_BATCH_US;
        let before_us = (first as f64 - 1.0) * period_us;
        is_regular.then_some(Self {
            period_us,
            rows,
            gap_us,
            shift_us: match times_us[0] {
                first_us @ 0.. => (before_us.ceil() as i64).saturating_sub(first_us).max(0),
                _ => 0,
            },
            current_us: None,
            start_us: None,
        })
    }

    /// Returns whether the row at this time, µs, is the first of a new batch. Takes the time of
    /// each row in order.
    pub fn begins(&mut self, time_us: i64) -> bool {
        let Some((start_us, last_us)) = self.current_us else {
            self.current_us = Some((time_us, time_us));
            return false;
        };
        // A batch that lasts is none: the times are even from here on.
        let begins = time_us < last_us
            || time_us.abs_diff(last_us) > self.gap_us
            || time_us.abs_diff(start_us) > self.gap_us;
        self.current_us = Some((if begins { time_us } else { start_us }, time_us));
        begins
    }

    /// Returns the even times, µs, of a whole batch: its first time and its number of rows. They
    /// are spread over the time since the last batch, or as usual if rows are missing there.
    pub fn spread(&mut self, first_us: i64, rows: usize) -> impl Iterator<Item = i64> + use<> {
        let last_us = self.start_us.replace(first_us);
        let span_us = last_us.map_or(0, |last_us| first_us.saturating_sub(last_us));
        let mut step_us = span_us as f64 / rows as f64;
        if step_us <= 0.0 || step_us > PERIOD_FACTOR * self.period_us {
            step_us = self.period_us;
        }
        let end_us = first_us.saturating_add(self.shift_us);
        (1..=rows).map(move |row| {
            let before_us = (rows - row) as f64 * step_us;
            end_us.saturating_sub(before_us.round() as i64)
        })
    }

    /// Returns the message on the batches.
    #[must_use]
    pub fn message(&self) -> String {
        format!(
            "times come in batches of about {:.0} rows, as a host stamps them on arrival: they are \
             spread evenly, mostly {:.0} µs apart",
            self.rows, self.period_us
        )
    }
}

/// Row with a time.
pub trait Timed {
    /// Returns the time, µs.
    fn time_us(&mut self) -> &mut i64;
}

/// Rows whose times come in batches, spread batch by batch.
#[derive(Clone, Debug)]
pub struct EvenRows<T> {
    batches: Batches,
    /// Rows of the batch that is not over.
    waiting: Vec<T>,
}

impl<T: Timed> EvenRows<T> {
    /// Creates the queue for rows with these batches.
    #[must_use]
    pub fn new(batches: Batches) -> Self {
        Self {
            batches,
            waiting: Vec::new(),
        }
    }

    /// Takes the next row. Returns the rows of the last batch if this row begins another.
    pub fn push(&mut self, mut row: T) -> Vec<T> {
        let is_over =
            self.batches.begins(*row.time_us()) || self.waiting.len() >= MOST_ROWS_WAITING;
        let even = if is_over { self.end() } else { Vec::new() };
        self.waiting.push(row);
        even
    }

    /// Returns the rows of the last batch.
    pub fn end(&mut self) -> Vec<T> {
        let mut rows = std::mem::take(&mut self.waiting);
        let Some(first) = rows.first_mut() else {
            return rows;
        };
        let times_us = self.batches.spread(*first.time_us(), rows.len());
        for (row, even_us) in rows.iter_mut().zip(times_us) {
            *row.time_us() = even_us;
        }
        rows
    }
}

/// Spreads all times, µs, of a recording that come in batches. Returns the message on them.
pub fn spread(times_us: &mut [i64]) -> Option<String> {
    let mut batches = Batches::find(times_us)?;
    let mut rest = times_us;
    while !rest.is_empty() {
        let end = rest.iter().position(|time_us| batches.begins(*time_us));
        let (batch, after) = rest.split_at_mut(end.unwrap_or(rest.len()).max(1));
        let even_us = batches.spread(batch[0], batch.len());
        for (time_us, even_us) in batch.iter_mut().zip(even_us) {
            *time_us = even_us;
        }
        rest = after;
    }
    Some(batches.message())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns times of rows each 5 ms that arrive in batches, their steps within 0.1 ms.
    fn arrivals(rows: i64, batch: i64) -> Vec<i64> {
        let arrival = |row: i64| (row / batch + 1) * batch * 5_000 + row % batch * 100;
        (0..rows).map(arrival).collect()
    }

    #[test]
    fn batches_of_any_size_become_even_rows() {
        for batch in [2, 3, 4, 10, 16, 25, 50] {
            let mut times_us = arrivals(4_800, batch);
            let message = spread(&mut times_us).expect("batches");
            assert!(message.contains("5000 µs apart"), "{batch}: {message}");
            let rows = format!("about {batch} rows");
            assert!(message.contains(&rows), "{message}");
            let even: Vec<i64> = (1..=4_800).map(|row| row * 5_000).collect();
            let late = even.iter().zip(&times_us).map(|(even, time)| time - even);
            assert!(
                late.clone().all(|late| late == 0),
                "{batch}: {:?}",
                late.max()
            );
        }
        // No time is before zero.
        let mut from_zero: Vec<i64> = arrivals(4_000, 10).iter().map(|t| t - 50_000).collect();
        assert!(spread(&mut from_zero).is_some());
        assert_eq!(from_zero[..3], [0, 5_000, 10_000]);
    }

    #[test]
    fn batches_with_pauses_and_late_ones_increase() {
        let mut times_us = arrivals(4_000, 10);
        for (row, time_us) in times_us.iter_mut().enumerate() {
            // Three pauses of 2 s, and arrivals that are up to 16 ms late.
            *time_us += 2_000_000 * [40, 120, 2_000].iter().filter(|at| row >= **at).count() as i64;
            *time_us += (row / 10 * 7_919 % 16_000) as i64;
        }
        assert!(spread(&mut times_us).is_some());
        let steps: Vec<i64> = times_us.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let pauses = steps.iter().filter(|step| **step > 1_900_000).count();
        assert_eq!(pauses, 3);
        let even = steps.iter().filter(|step| (3_000..=7_000).contains(*step));
        assert_eq!(even.count(), steps.len() - 3);
    }

    #[test]
    fn rows_after_the_last_batch_keep_their_steps() {
        let mut times_us = arrivals(1_000, 10);
        let end_us = times_us[999];
        times_us.extend((1..1_000).map(|row| end_us + row * 5_000));
        assert!(spread(&mut times_us).is_some());
        let steps = times_us[1_100..1_990]
            .windows(2)
            .map(|pair| pair[1] - pair[0]);
        assert!(
            steps.clone().all(|step| (4_999..=5_001).contains(&step)),
            "{:?}",
            steps.max()
        );
    }

    #[test]
    fn other_times_stay() {
        let even = |step_us: i64| (0..1_000).map(move |row| row * step_us);
        // Row and length of the pauses, µs.
        let paused = |step_us: i64, each: i64, pause_us: i64| -> Vec<i64> {
            let pause = |time: i64| time + time / step_us / each * pause_us;
            even(step_us).map(pause).collect()
        };
        for times_us in [
            Vec::new(),
            vec![0],
            vec![0; 300],
            vec![i64::MIN, i64::MAX, 0, 5, i64::MIN, i64::MAX],
            even(125).collect(),
            even(5_000).collect(),
            paused(5_000, 100, 300_000),
            paused(1_000, 20, 100_000),
            paused(5_000, 5, 100_000),
            paused(125, 64, 20_000),
            paused(100, 80, 1_000_000),
            // Rows with one time, now and then.
            even(5_000)
                .map(|time| time - time / 5_000 % 10 / 9 * 5_000)
                .collect(),
            // Two sensors in turn, and a clock of milliseconds.
            even(2_500)
                .map(|time| time / 5_000 * 5_000 + time % 5_000 / 5)
                .collect(),
            even(1_100).map(|time| time / 1_000 * 1_000).collect(),
        ] {
            let mut after = times_us.clone();
            assert_eq!(spread(&mut after), None, "{:?}", times_us.get(..50));
            assert_eq!(after, times_us);
        }
    }
}
