//! MAVLink ground station: its requests become commands, and their answers go back to it.
//!
//! A command that takes time is answered twice, as the protocol requires: when it has begun, and
//! when it has ended.
//!
//! ```
//! use aplomb::console::ground_station::GroundStation;
//!
//! let mut station = GroundStation::new();
//! let mut received = b"status\n".iter().copied();
//! // Bytes that are no MAVLink frame are text for the console.
//! let text: Vec<_> = std::iter::from_fn(|| station.receive(0, || received.next())).collect();
//! assert_eq!(text, b"status\n");
//! assert_eq!(station.take_command(), None);
//! ```

use heapless::Deque;

use super::answer::Kind;
use super::command::{BAUD_RATES, Calibrate, Command, MountChoice, RATES_HZ};
use crate::telemetry::mavlink::{self, Action, Outcome, Session, Ticket};

/// Largest number of bytes that turn out to be text at once: one frame that was none.
const TEXT_CAPACITY: usize = 288;

/// Ground station at the other end of the line.
#[derive(Debug, Clone, Default)]
pub struct GroundStation {
    /// MAVLink session.
    pub session: Session,
    /// Received text for the console.
    text: Deque<u8, TEXT_CAPACITY>,
    /// Request that has begun, and needs a second answer.
    pending: Option<Ticket>,
}

impl GroundStation {
    /// Creates a station that has sent nothing.
    pub const fn new() -> Self {
        Self {
            session: Session::new(),
            text: Deque::new(),
            pending: None,
        }
    }

    /// Returns the next byte of text among the bytes of `source`. `now_us` is the time since boot,
    /// µs.
    pub fn receive(&mut self, now_us: u64, mut source: impl FnMut() -> Option<u8>) -> Option<u8> {
        let Self { session, text, .. } = self;
        loop {
            if let Some(byte) = text.pop_front() {
                return Some(byte);
            }
            // The queue holds all text that a session can release at once.
            let mut keep = |byte| {
                text.push_back(byte).ok();
            };
            match source() {
                Some(byte) => session.receive(byte, now_us, &mut keep),
                None => {
                    session.poll(now_us, &mut keep);
                    return text.pop_front();
                }
            }
        }
    }

    /// Returns the next requested command, and denies requests that are no command.
    #[inline(never)]
    pub fn take_command(&mut self) -> Option<(Ticket, Command)> {
        while let Some((ticket, action)) = self.session.take_action() {
            match command(action) {
                Some(command) => return Some((ticket, command)),
                None => self.session.answer(ticket, Outcome::Denied),
            }
        }
        None
    }

    /// Sends the first answer to a command, and before it the second one to a command that this one
    /// has ended. `is_working` is true if the console has a job or procedure under way.
    #[inline(never)]
    pub fn answer(
        &mut self,
        ticket: Ticket,
        command: Command,
        kind: Kind,
        is_working: bool,
        is_armed: bool,
    ) {
        if !is_working {
            self.cancel_pending();
        }
        // An unchanged record is not written.
        let takes_time = match command {
            Command::Save => is_working,
            Command::Calibrate(choice) => matches!(
                choice,
                Calibrate::Gyroscope
                    | Calibrate::Accelerometer
                    | Calibrate::Level
                    | Calibrate::Compass
            ),
            _ => false,
        };
        let outcome = match kind {
            Kind::Ok if takes_time => {
                self.pending = Some(ticket);
                Outcome::InProgress
            }
            Kind::Ok | Kind::Progress | Kind::Done => Outcome::Accepted,
            // A later attempt may succeed.
            Kind::Error if is_working || is_armed => Outcome::NotNow,
            Kind::Error | Kind::Failed => Outcome::Failed,
        };
        self.session.answer(ticket, outcome);
    }

    /// Discards text that was held back, and an incomplete frame. Call it while the format is not
    /// MAVLink: the text is not to run later.
    pub fn discard_text(&mut self) {
        self.text.clear();
        self.session.discard();
    }

    /// Discards received text and frames, and rejects the requests that no command has taken.
    pub fn discard(&mut self) {
        self.discard_text();
        while let Some((ticket, _)) = self.take_command() {
            self.session.answer(ticket, Outcome::NotNow);
        }
    }

    /// Sends the second answer to a command if this answer of the console ends it.
    #[inline(never)]
    pub fn on_answer(&mut self, kind: Kind) {
        let outcome = match kind {
            Kind::Done => Outcome::Accepted,
            Kind::Failed => Outcome::Failed,
            Kind::Ok | Kind::Error | Kind::Progress => return,
        };
        self.end_pending(outcome);
    }

    /// Returns whether a request waits for the console to end its work.
    #[inline]
    pub const fn has_pending(&self) -> bool {
        self.pending.is_some()
    }

    /// Answers a request that has ended without an answer of the console: `arm` and
    /// `calibrate stop` give up a calibration. Call it while the console works on nothing.
    pub fn cancel_pending(&mut self) {
        self.end_pending(Outcome::Cancelled);
    }

    fn end_pending(&mut self, outcome: Outcome) {
        if let Some(ticket) = self.pending.take() {
            self.session.answer(ticket, outcome);
        }
    }
}

/// Returns the command for a request; `None` if a value is out of range.
fn command(action: Action) -> Option<Command> {
    Some(match action {
        Action::Calibrate(mavlink::Calibrate::Gyroscope) => {
            Command::Calibrate(Calibrate::Gyroscope)
        }
        Action::Calibrate(mavlink::Calibrate::Accelerometer) => {
            Command::Calibrate(Calibrate::Accelerometer)
        }
        Action::Calibrate(mavlink::Calibrate::Compass) => Command::Calibrate(Calibrate::Compass),
        Action::Calibrate(mavlink::Calibrate::Level) => Command::Calibrate(Calibrate::Level),
        Action::Calibrate(mavlink::Calibrate::Cancel) => Command::Calibrate(Calibrate::Stop),
        Action::SetRate(rate_hz) if RATES_HZ.contains(&rate_hz) => Command::Rate(rate_hz),
        Action::SetBaud(baud) if BAUD_RATES.contains(&baud) => Command::Baud(baud),
        Action::SetRate(_) | Action::SetBaud(_) => return None,
        Action::SetFormat(format) => Command::Format(format),
        Action::SetMount(mount) => Command::Mount(MountChoice::Named(mount)),
        Action::Save => Command::Save,
        Action::SetArmed(true) => Command::Arm,
        Action::SetArmed(false) => Command::Disarm,
    })
}

#[cfg(test)]
mod tests {
    use ::mavlink::MessageData;
    use ::mavlink::dialects::common::{COMMAND_ACK_DATA, COMMAND_LONG_DATA, MavCmd, MavResult};
    use ::mavlink::{MAVLinkV2MessageRaw, MavHeader, MavlinkVersion};

    use super::*;
    use crate::compass::CompassStatus;
    use crate::estimator::Sample;
    use crate::settings::Record;
    use crate::telemetry::Output;
    use crate::telemetry::mavlink::Vehicle;

    fn command_long(command: MavCmd, param1: f32) -> Vec<u8> {
        let mut raw = MAVLinkV2MessageRaw::new();
        raw.serialize_message_data(
            MavHeader::default(),
            &COMMAND_LONG_DATA {
                param1,
                command,
                target_system: 1,
                ..COMMAND_LONG_DATA::default()
            },
        );
        raw.raw_bytes().to_vec()
    }

    /// Results that the session sends.
    fn results(station: &mut GroundStation) -> Vec<MavResult> {
        let mut buffer = [0; 1024];
        let mut output = Output::new(&mut buffer);
        let (sample, record) = (Sample::default(), Record::default());
        let vehicle = Vehicle {
            snapshot: None,
            is_due: false,
            sample: &sample,
            temperature_celsius: 0.0,
            heading: None,
            compass: CompassStatus::default(),
            record: &record,
            baud: 115_200,
            is_armed: false,
            bursts_failed: 0,
        };
        station.session.fill(1, &vehicle, &mut output);
        let length = output.length();
        let mut bytes = &buffer[..length];
        let mut found = Vec::new();
        while let [_, payload, ..] = bytes {
            let (frame, rest) = bytes.split_at(12 + usize::from(*payload));
            if frame[7] == COMMAND_ACK_DATA::ID as u8 {
                let payload = &frame[10..frame.len() - 2];
                let ack = COMMAND_ACK_DATA::deser(MavlinkVersion::V2, payload);
                found.push(ack.expect("an acknowledgement").result);
            }
            bytes = rest;
        }
        found
    }

    fn receive(station: &mut GroundStation, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.iter().copied();
        std::iter::from_fn(|| station.receive(0, || bytes.next())).collect()
    }

    #[test]
    fn a_frame_counts_once_and_only_with_its_checksum() {
        let mut station = GroundStation::new();
        let frame = command_long(MavCmd::MAV_CMD_PREFLIGHT_STORAGE, 1.0);
        let mut damaged = frame.clone();
        damaged[20] ^= 1;
        for (bytes, counts) in [(damaged, false), (frame, true), (vec![], false)] {
            receive(&mut station, &bytes);
            assert_eq!(station.session.take_has_frame(), counts);
        }
    }

    #[test]
    fn a_calibration_is_answered_when_it_begins_and_when_it_ends() {
        for (end, result) in [
            (Kind::Done, MavResult::MAV_RESULT_ACCEPTED),
            (Kind::Failed, MavResult::MAV_RESULT_FAILED),
        ] {
            let mut station = GroundStation::new();
            let bytes = command_long(MavCmd::MAV_CMD_PREFLIGHT_CALIBRATION, 1.0);
            assert_eq!(receive(&mut station, &bytes), b"");
            let (ticket, command) = station.take_command().expect("a command");
            assert_eq!(command, Command::Calibrate(Calibrate::Gyroscope));
            station.answer(ticket, command, Kind::Ok, true, false);
            assert_eq!(results(&mut station), [MavResult::MAV_RESULT_IN_PROGRESS]);
            station.on_answer(Kind::Progress);
            assert_eq!(results(&mut station), []);
            station.on_answer(end);
            station.on_answer(end);
            assert_eq!(results(&mut station), [result]);
        }
    }

    #[test]
    fn a_calibration_that_a_command_ends_is_answered_before_it() {
        let mut station = GroundStation::new();
        let mut request = |parameter, is_working| {
            let bytes = command_long(MavCmd::MAV_CMD_PREFLIGHT_CALIBRATION, parameter);
            receive(&mut station, &bytes);
            let (ticket, command) = station.take_command().expect("a command");
            station.answer(ticket, command, Kind::Ok, is_working, false);
            results(&mut station)
        };
        assert_eq!(request(1.0, true), [MavResult::MAV_RESULT_IN_PROGRESS]);
        let expected = [
            MavResult::MAV_RESULT_CANCELLED,
            MavResult::MAV_RESULT_ACCEPTED,
        ];
        assert_eq!(request(0.0, false), expected);
    }

    #[test]
    fn a_refused_command_is_rejected_for_a_while_or_has_failed() {
        let mut station = GroundStation::new();
        let bytes = command_long(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0);
        let later = MavResult::MAV_RESULT_TEMPORARILY_REJECTED;
        for (kind, (is_working, is_armed), result) in [
            (Kind::Error, (true, false), later),
            (Kind::Error, (false, true), later),
            (Kind::Error, (false, false), MavResult::MAV_RESULT_FAILED),
            (Kind::Ok, (true, false), MavResult::MAV_RESULT_ACCEPTED),
            (Kind::Ok, (false, true), MavResult::MAV_RESULT_ACCEPTED),
        ] {
            receive(&mut station, &bytes);
            let (ticket, command) = station.take_command().expect("a command");
            assert_eq!(command, Command::Arm);
            station.answer(ticket, command, kind, is_working, is_armed);
            assert_eq!(results(&mut station), [result]);
        }
    }

    #[test]
    fn a_save_takes_time_only_if_the_record_has_changed() {
        let bytes = command_long(MavCmd::MAV_CMD_PREFLIGHT_STORAGE, 1.0);
        for (is_working, result) in [
            (true, MavResult::MAV_RESULT_IN_PROGRESS),
            (false, MavResult::MAV_RESULT_ACCEPTED),
        ] {
            let mut station = GroundStation::new();
            receive(&mut station, &bytes);
            let (ticket, command) = station.take_command().expect("a command");
            station.answer(ticket, command, Kind::Ok, is_working, false);
            assert_eq!(results(&mut station), [result]);
        }
    }

    #[test]
    fn what_is_discarded_reaches_nobody_and_a_command_is_rejected() {
        let mut station = GroundStation::new();
        let frame = command_long(MavCmd::MAV_CMD_COMPONENT_ARM_DISARM, 1.0);
        // Two letters of a text remain in the queue, and a frame is incomplete.
        let mut bytes = frame.clone();
        bytes.extend(b"\xFD\x01\x80on");
        bytes.extend(frame.iter().take(20));
        let mut bytes = bytes.into_iter();
        assert_eq!(station.receive(0, || bytes.next()), Some(0xFD));
        assert_eq!(station.receive(0, || bytes.next()), Some(1));
        for byte in bytes {
            station.session.receive(byte, 0, &mut |_| {});
        }
        station.discard();
        assert_eq!(receive(&mut station, &frame[20..]), &frame[20..]);
        assert_eq!(station.take_command(), None);
        assert_eq!(
            results(&mut station),
            [MavResult::MAV_RESULT_TEMPORARILY_REJECTED]
        );
    }

    #[test]
    fn lines_between_frames_are_text() {
        let mut station = GroundStation::new();
        let mut bytes = b"status\n".to_vec();
        bytes.extend(command_long(MavCmd::MAV_CMD_PREFLIGHT_STORAGE, 1.0));
        bytes.extend(b"format text\n");
        assert_eq!(receive(&mut station, &bytes), b"status\nformat text\n");
        assert_eq!(
            station.take_command().map(|(_, command)| command),
            Some(Command::Save)
        );
    }
}
