//! Limits the answers to wrong input, so that noise on the line does not make more noise.

use super::answer::{Kind, Reply};

/// Largest number of error answers at once.
pub const MAX_ERROR_ANSWERS: u8 = 4;
/// Time after which one more error answer is allowed, µs.
const ERROR_ANSWER_PERIOD_US: u32 = 500_000;
/// Shortest time between two reports of dropped lines, µs.
const DROPPED_REPORT_PERIOD_US: u32 = 1_000_000;

/// Counter of dropped lines, and budget of error answers.
#[derive(Debug)]
pub(super) struct LineErrors {
    /// Dropped lines since start.
    pub(super) dropped: u32,
    /// Dropped lines since the last report.
    unreported: u32,
    reported_at_us: u32,
    answers_left: u8,
    refilled_at_us: u32,
}

impl LineErrors {
    pub(super) const fn new() -> Self {
        Self {
            dropped: 0,
            unreported: 0,
            reported_at_us: 0,
            answers_left: MAX_ERROR_ANSWERS,
            refilled_at_us: 0,
        }
    }

    /// Counts a line that gets no answer.
    pub(super) fn drop_line(&mut self) {
        self.dropped = self.dropped.saturating_add(1);
        self.unreported = self.unreported.saturating_add(1);
    }

    /// Returns whether the budget allows an error answer; takes it from the budget. `now_us` may
    /// wrap.
    pub(super) fn may_answer(&mut self, now_us: u32) -> bool {
        let periods = now_us.wrapping_sub(self.refilled_at_us) / ERROR_ANSWER_PERIOD_US;
        if periods > 0 {
            self.refilled_at_us = now_us;
            let refilled = u32::from(self.answers_left).saturating_add(periods);
            self.answers_left = refilled.min(u32::from(MAX_ERROR_ANSWERS)) as u8;
        }
        let is_left = self.answers_left > 0;
        self.answers_left = self.answers_left.saturating_sub(1);
        is_left
    }

    /// Reports dropped lines, at most once a second. `now_us` may wrap.
    pub(super) fn report_dropped(&mut self, now_us: u32, reply: &mut Reply<'_>) -> Option<Kind> {
        let is_due = now_us.wrapping_sub(self.reported_at_us) >= DROPPED_REPORT_PERIOD_US;
        if self.unreported == 0 || !is_due {
            return None;
        }
        self.reported_at_us = now_us;
        let count = core::mem::take(&mut self.unreported);
        let lines = if count == 1 { "line" } else { "lines" };
        Some(reply.error(format_args!(
            "{count} {lines} dropped: too long, unreadable or too many wrong ones; \
             is the baud rate right?"
        )))
    }
}
