//! Mailbox: messages on their way from the tasks to telemetry.

use heapless::Deque;

use super::message::Message;

/// Queue of messages to the task that sends them.
///
/// ```
/// use aplomb::telemetry::Mailbox;
/// use aplomb::telemetry::message::Message;
///
/// let mut mailbox = Mailbox::new();
/// mailbox.post(Message::Recovering);
/// assert_eq!(mailbox.take(), Some(Message::Recovering));
/// assert_eq!(mailbox.take(), None);
/// ```
#[derive(Debug)]
pub struct Mailbox {
    messages: Deque<Message, 16>,
    lost: u16,
}

impl Mailbox {
    /// Creates an empty mailbox.
    pub const fn new() -> Self {
        Self {
            messages: Deque::new(),
            lost: 0,
        }
    }

    /// Adds a message. Without room it is lost; [`take`](Self::take) reports the number of lost
    /// ones.
    pub fn post(&mut self, message: Message) {
        if self.messages.push_back(message).is_err() {
            self.lost = self.lost.saturating_add(1);
        }
    }

    /// Removes the oldest message.
    pub fn take(&mut self) -> Option<Message> {
        self.messages.pop_front().or_else(|| {
            let count = core::mem::take(&mut self.lost);
            (count > 0).then_some(Message::MessagesLost { count })
        })
    }
}

impl Default for Mailbox {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mailbox_keeps_order_and_counts_lost_messages() {
        let mut mailbox = Mailbox::new();
        assert_eq!(mailbox.take(), None);
        for count in 0..20 {
            mailbox.post(Message::MessagesLost { count });
        }
        for count in 0..16 {
            assert_eq!(mailbox.take(), Some(Message::MessagesLost { count }));
        }
        assert_eq!(mailbox.take(), Some(Message::MessagesLost { count: 4 }));
        assert_eq!(mailbox.take(), None);
    }
}
