//! Inbox: decodes requests, answers the simple ones, and queues the others as actions.

use ::mavlink::MessageData;
use ::mavlink::dialects::common::{
    AUTOPILOT_VERSION_DATA, MISSION_REQUEST_LIST_DATA, PARAM_REQUEST_LIST_DATA,
    PARAM_REQUEST_READ_DATA, PARAM_SET_DATA, PARAM_VALUE_DATA,
};
use heapless::Deque;

use super::action::{Action, Calibrate, Outcome, Request, Ticket};
use super::parameter::{PARAMETERS, Parameter};
use super::receiver::Received;
use super::wire::{COMPONENT, Command, CommandAck, SYSTEM};

/// Requests without an answer, and answers to send.
#[derive(Debug, Clone)]
pub(super) struct Inbox {
    pub(super) replies: Deque<Reply, 8>,
    pub(super) actions: Deque<(Ticket, Action), 4>,
    pub(super) lists_parameters: bool,
    pub(super) dropped: u16,
    /// True if a frame has arrived.
    pub(super) has_frame: bool,
}

/// Answer that goes out as soon as there is room.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Reply {
    Acknowledge(CommandAck),
    Parameter(u16),
    NoMission {
        system: u8,
        component: u8,
        /// MAV_MISSION_TYPE.
        kind: u8,
    },
    Version,
}

impl Inbox {
    /// Handles a frame. One from the module's own address is an echo, and is ignored.
    #[inline(never)]
    pub(super) fn take(&mut self, frame: &Received) {
        if (frame.system, frame.component) == (SYSTEM, COMPONENT) {
            return;
        }
        self.has_frame = true;
        let payload = &frame.payload;
        let target_at = match frame.message {
            Command::LONG | Command::INT => Command::TARGET_AT,
            PARAM_REQUEST_LIST_DATA::ID | MISSION_REQUEST_LIST_DATA::ID => 0,
            PARAM_REQUEST_READ_DATA::ID => 2,
            PARAM_SET_DATA::ID => 4,
            _ => return,
        };
        let [system, component] = payload.field(target_at);
        if ![0, SYSTEM].contains(&system) || ![0, COMPONENT].contains(&component) {
            return;
        }
        match frame.message {
            PARAM_REQUEST_LIST_DATA::ID => self.lists_parameters = true,
            PARAM_REQUEST_READ_DATA::ID => {
                // A negative index means that the name counts.
                let index = u16::try_from(i16::from_le_bytes(payload.field(0)))
                    .ok()
                    .or_else(|| Parameter::find(name(&payload.field(4))));
                if let Some(index) = index {
                    self.queue(Reply::Parameter(index));
                }
            }
            PARAM_SET_DATA::ID => {
                if let Some(index) = Parameter::find(name(&payload.field(6))) {
                    // The type does not count: all values are floats.
                    self.set_parameter(frame, index, f32::from_le_bytes(payload.field(0)));
                }
            }
            MISSION_REQUEST_LIST_DATA::ID => {
                let [kind] = payload.field(2);
                self.queue(Reply::NoMission {
                    system: frame.system,
                    component: frame.component,
                    kind,
                });
            }
            _ => self.command(frame, &Command::read(frame.message, payload)),
        }
    }

    /// Queues the change of a parameter. The answer is its value, changed or not, once the change
    /// has run. Without room there is no answer, so that the station repeats the request.
    fn set_parameter(&mut self, frame: &Received, index: u16, value: f32) {
        let action = PARAMETERS
            .get(usize::from(index))
            .and_then(|(parameter, _)| parameter.action(value));
        if let Some(action) = action {
            let ticket = Ticket {
                request: Request::Parameter(index),
                system: frame.system,
                component: frame.component,
            };
            if self.actions.push_back((ticket, action)).is_err() {
                self.dropped = self.dropped.saturating_add(1);
            }
        } else {
            self.queue(Reply::Parameter(index));
        }
    }

    /// Queues the action of a command, or answers it.
    #[inline(never)]
    fn command(&mut self, frame: &Received, command: &Command) {
        let ticket = Ticket {
            request: Request::Command(command.command),
            system: frame.system,
            component: frame.component,
        };
        let [first, second, _, _, fifth, ..] = command.parameters;
        let others_are_zero = |but: usize| {
            command
                .parameters
                .iter()
                .enumerate()
                .all(|(index, value)| index == but || *value == 0.0 || value.is_nan())
        };
        let action = match command.command {
            PREFLIGHT_CALIBRATION => {
                if first == 1.0 && others_are_zero(0) {
                    Ok(Action::Calibrate(Calibrate::Gyroscope))
                } else if second == 1.0 && others_are_zero(1) {
                    Ok(Action::Calibrate(Calibrate::Compass))
                } else if fifth == 1.0 && others_are_zero(4) {
                    Ok(Action::Calibrate(Calibrate::Accelerometer))
                } else if fifth == 2.0 && others_are_zero(4) {
                    Ok(Action::Calibrate(Calibrate::Level))
                } else if first == 0.0 && others_are_zero(0) {
                    Ok(Action::Calibrate(Calibrate::Cancel))
                } else {
                    // No barometer or radio is fitted.
                    Err(Outcome::Unsupported)
                }
            }
            // Parameter 1 is 1: write.
            PREFLIGHT_STORAGE if first == 1.0 => Ok(Action::Save),
            PREFLIGHT_STORAGE => Err(Outcome::Unsupported),
            ARM_DISARM if first == 1.0 || first == 0.0 => Ok(Action::SetArmed(first == 1.0)),
            ARM_DISARM => Err(Outcome::Denied),
            REQUEST_MESSAGE if first == AUTOPILOT_VERSION_DATA::ID as f32 => {
                Err(self.answer_version())
            }
            REQUEST_MESSAGE if first == PARAM_VALUE_DATA::ID as f32 => {
                let index = second as u16;
                let is_known = usize::from(index) < PARAMETERS.len();
                Err(if is_known && f32::from(index) == second {
                    self.queue(Reply::Parameter(index));
                    Outcome::Accepted
                } else {
                    Outcome::Denied
                })
            }
            REQUEST_CAPABILITIES if first == 1.0 => Err(self.answer_version()),
            _ => Err(Outcome::Unsupported),
        };
        let outcome = match action {
            Ok(action) => match self.actions.push_back((ticket, action)) {
                // The owner of the session answers.
                Ok(()) => return,
                Err(_) => Outcome::NotNow,
            },
            Err(outcome) => outcome,
        };
        self.answer(ticket, outcome);
    }

    /// Queues the version.
    fn answer_version(&mut self) -> Outcome {
        self.queue(Reply::Version);
        Outcome::Accepted
    }

    /// Queues COMMAND_ACK, or the value of the parameter.
    #[inline(never)]
    pub(super) fn answer(&mut self, ticket: Ticket, outcome: Outcome) {
        self.queue(match ticket.request {
            Request::Command(command) => Reply::Acknowledge(CommandAck {
                command,
                result: outcome.code(),
                target_system: ticket.system,
                target_component: ticket.component,
            }),
            Request::Parameter(index) => Reply::Parameter(index),
        });
    }

    /// Queues an answer, or counts it as dropped.
    #[inline(never)]
    fn queue(&mut self, reply: Reply) {
        if self.replies.push_back(reply).is_err() {
            self.dropped = self.dropped.saturating_add(1);
        }
    }
}

/// MAV_CMD_PREFLIGHT_CALIBRATION.
const PREFLIGHT_CALIBRATION: u16 = 241;
/// MAV_CMD_PREFLIGHT_STORAGE.
const PREFLIGHT_STORAGE: u16 = 245;
/// MAV_CMD_COMPONENT_ARM_DISARM.
const ARM_DISARM: u16 = 400;
/// MAV_CMD_REQUEST_MESSAGE.
const REQUEST_MESSAGE: u16 = 512;
/// MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES.
const REQUEST_CAPABILITIES: u16 = 520;

/// Returns a name without its padding of zeros.
fn name(padded: &[u8; 16]) -> &[u8] {
    let length = padded.iter().take_while(|byte| **byte != 0).count();
    padded.get(..length).unwrap_or_default()
}
