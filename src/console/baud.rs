//! Change of the baud rate, reverted if neither a command nor a frame arrives at the new one.

use super::answer::{Kind, Reply};
use super::line::LineAssembler;
use super::module::Module;

/// Time within which a command or a frame must arrive at the new baud rate, µs, or the old rate
/// returns.
const BAUD_TRIAL_US: u32 = 10_000_000;

/// State of a change of the baud rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BaudChange {
    /// No change is under way.
    Steady,
    /// The rate changes as soon as the answer is sent.
    Requested(u32),
    /// The rate has changed, and nothing has been understood yet.
    Trial { baud: u32, since_us: u32 },
    /// Nothing was understood in time: the old rate returns.
    Reverting { tried: u32 },
}

/// Result of a poll.
pub(super) enum BaudPoll {
    /// The console may continue.
    Idle,
    /// The rate is changing: the console must neither send nor receive.
    Busy,
    /// An answer was written.
    Answered(Kind),
}

impl BaudChange {
    /// Returns whether the rate is about to change.
    pub(super) const fn is_changing(&self) -> bool {
        matches!(self, Self::Requested(_) | Self::Reverting { .. })
    }

    /// Returns the rate that is requested or being tried.
    pub(super) const fn requested(&self) -> Option<u32> {
        match self {
            Self::Requested(baud) | Self::Trial { baud, .. } => Some(*baud),
            Self::Steady | Self::Reverting { .. } => None,
        }
    }

    /// Ends a trial because a command or a frame has arrived, and returns the new baud rate.
    pub(super) fn confirm(&mut self) -> Option<u32> {
        let Self::Trial { baud, .. } = *self else {
            return None;
        };
        *self = Self::Steady;
        Some(baud)
    }

    /// Continues a change from the rate `before`. `now_us` may wrap.
    pub(super) fn poll(
        &mut self,
        before: u32,
        now_us: u32,
        line: &mut LineAssembler,
        module: &mut dyn Module,
        reply: &mut Reply<'_>,
    ) -> BaudPoll {
        match *self {
            Self::Steady => BaudPoll::Idle,
            Self::Requested(baud) => {
                if module.set_baud(baud) {
                    *line = LineAssembler::new();
                    *self = Self::Trial {
                        baud,
                        since_us: now_us,
                    };
                }
                BaudPoll::Busy
            }
            Self::Trial { baud, since_us } => {
                if now_us.wrapping_sub(since_us) < BAUD_TRIAL_US {
                    return BaudPoll::Idle;
                }
                *self = Self::Reverting { tried: baud };
                BaudPoll::Busy
            }
            Self::Reverting { tried } => {
                if !module.set_baud(before) {
                    return BaudPoll::Busy;
                }
                *line = LineAssembler::new();
                *self = Self::Steady;
                BaudPoll::Answered(reply.write(
                    Kind::Failed,
                    format_args!("baud: nothing was understood at {tried}, it is {before} again"),
                ))
            }
        }
    }
}
