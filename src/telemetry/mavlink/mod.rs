//! MAVLink 2: what a ground station needs to connect quietly, show the horizon, and set the module up.
//!
//! | sent | how often |
//! |---|---|
//! | HEARTBEAT, SYS_STATUS | 1 Hz |
//! | ATTITUDE, ATTITUDE_QUATERNION, HIGHRES_IMU | at the rate that is set |
//! | STATUSTEXT | the module's messages, in pieces of 50 letters |
//! | PARAM_VALUE, COMMAND_ACK, MISSION_COUNT (0), AUTOPILOT_VERSION | when asked |
//!
//! | understood | what it does |
//! |---|---|
//! | PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET | see [`parameter`] |
//! | COMMAND_LONG, COMMAND_INT | [`Action`]s; each command is answered, known or not |
//! | MISSION_REQUEST_LIST | there is none |
//!
//! [`Session`] has no clock and no port. What it cannot answer itself it hands out as an [`Action`], and the owner says with
//! [`Session::answer`] what became of it. Nothing waits: a message for which there is no room is dropped and
//! counted, answers before attitudes, and only what is sent takes a sequence number, so that a gap in them is a loss on the line.
//!
//! # Text commands while this runs
//!
//! The console stays within reach. Whatever is not a MAVLink frame is handed on as text, byte for byte (`receiver`),
//! so that `format text`, on a line of its own, always brings text back. Its answers come as STATUSTEXT.
//!
//! # Whose code
//!
//! Types, field order, checksums and enumerations are those of the `mavlink` crate, dialect `common`. An experiment decided that, before
//! this was written (Cortex-M4F, release profile, ten messages out and six in; it is not kept): with the crate 7.4 KiB of flash and 410 to
//! 1,000 instructions a message, by hand 3.2 KiB and 170 to 860. Some 4 KiB, and a load of 0.05 % at 150 messages a second, do not
//! outweigh a definition that others maintain and test. The firmware as it is has 6.0 KiB of MAVLink, the crate's part of it
//! included: this module, the crate and `console::ground_station`, by the symbols of the default image (2026-11-21). What
//! the crate's types cannot hold is in `wire`: a command that its dialect does not know, and the fields that version 2 appended.

// The crate's panics cannot be told from our own in the firmware (`xtask/src/panics.rs`), so none of ours is let in.
#![cfg_attr(
    not(test),
    deny(
        clippy::expect_used,
        clippy::indexing_slicing,
        clippy::panic,
        clippy::todo,
        clippy::unimplemented,
        clippy::unreachable,
        clippy::unwrap_used
    )
)]

pub mod parameter;
mod receiver;
#[cfg(test)]
mod tests;
mod wire;

use ::mavlink::dialects::common::{
    ATTITUDE_DATA, ATTITUDE_QUATERNION_DATA, AUTOPILOT_VERSION_DATA, HEARTBEAT_DATA,
    HIGHRES_IMU_DATA, HighresImuUpdatedFlags, MISSION_COUNT_DATA, MISSION_REQUEST_LIST_DATA,
    MavAutopilot, MavModeFlag, MavParamType, MavProtocolCapability, MavSeverity, MavState,
    MavSysStatusSensor, MavType, PARAM_REQUEST_LIST_DATA, PARAM_REQUEST_READ_DATA, PARAM_SET_DATA,
    PARAM_VALUE_DATA, STATUSTEXT_DATA, SYS_STATUS_DATA,
};
use ::mavlink::types::CharArray;
use ::mavlink::{MAVLinkV2MessageRaw, MavHeader, MavlinkVersion, MessageData};
use heapless::Deque;

use super::Output;
use super::message::Severity;
use crate::calibration::{Mount, OutputFormat, Record};
use crate::estimator::Sample;
use crate::health::Flags;
use crate::pipeline::Snapshot;
use parameter::{PARAMETERS, Parameter};
use receiver::{Received, Receiver};
use wire::{Command, CommandAck, Extended};

/// The module's address: the first system, as its autopilot, since ground stations look for one.
pub const SYSTEM: u8 = 1;
/// MAV_COMP_ID_AUTOPILOT1.
pub const COMPONENT: u8 = 1;

/// Letters in one STATUSTEXT.
const TEXT_LENGTH: usize = 50;
/// The time between two heartbeats, and between two SYS_STATUS, µs.
const HEARTBEAT_PERIOD_US: u64 = 1_000_000;
/// A frame takes at least so much: header and checksum.
const OVERHEAD: usize = 12;

/// What a ground station asks of the module.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Measure a calibration.
    Calibrate(Calibrate),
    /// Send so many attitudes a second.
    SetRate(u16),
    /// Send and receive at so many bits a second.
    SetBaud(u32),
    /// Send another format.
    SetFormat(OutputFormat),
    /// The sensor is mounted so.
    SetMount(Mount),
    /// Keep what is set, for the next start.
    Save,
    /// Arm or disarm.
    SetArmed(bool),
}

/// What MAV_CMD_PREFLIGHT_CALIBRATION can ask for here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Calibrate {
    /// Parameter 1 is 1: the gyroscope's offset.
    Gyroscope,
    /// Parameter 5 is 1: the accelerometer, pose by pose.
    Accelerometer,
    /// Parameter 5 is 2: where level is.
    Level,
    /// All parameters are zero: what is under way ends.
    Cancel,
}

/// What became of an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It is done.
    Accepted,
    /// It has begun; another answer follows.
    InProgress,
    /// Not now: the module is armed or busy.
    NotNow,
    /// Not with these parameters.
    Denied,
    /// It went wrong.
    Failed,
    /// It was ended before it was done.
    Cancelled,
    /// The module does not know how.
    Unsupported,
}

impl Outcome {
    /// MAV_RESULT.
    const fn code(self) -> u8 {
        match self {
            Self::Accepted => 0,
            Self::NotNow => 1,
            Self::Denied => 2,
            Self::Unsupported => 3,
            Self::Failed => 4,
            Self::InProgress => 5,
            Self::Cancelled => 6,
        }
    }
}

/// Who asked, and which command it was: to be handed back with the answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ticket {
    command: Option<u16>,
    system: u8,
    component: u8,
}

/// What the messages are made of.
#[derive(Debug, Clone, Copy)]
pub struct Vehicle<'a> {
    /// The latest attitude, if there is a new one.
    pub snapshot: Option<&'a Snapshot>,
    /// Its sample.
    pub sample: &'a Sample,
    /// The die temperature, °C.
    pub temperature_celsius: f32,
    /// What is set at present.
    pub record: &'a Record,
    /// Whether the module is armed.
    pub is_armed: bool,
    /// Bursts that failed.
    pub bursts_failed: u16,
}

/// One end of a connection.
#[derive(Debug, Clone)]
pub struct Session {
    receiver: Receiver,
    inbox: Inbox,
    sequence: u8,
    dropped: u16,
    next_heartbeat_us: u64,
    next_status_us: u64,
    /// The next parameter of a list that was asked for.
    listed: u16,
    text_id: u16,
}

/// What arrived and is not answered yet.
#[derive(Debug, Clone)]
struct Inbox {
    replies: Deque<Reply, 8>,
    actions: Deque<(Ticket, Action), 4>,
    lists_parameters: bool,
    dropped: u16,
}

/// What goes back as soon as there is room.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reply {
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

impl Default for Session {
    fn default() -> Self {
        Self::new()
    }
}

impl Session {
    /// A connection on which nothing has been said.
    pub const fn new() -> Self {
        Self {
            receiver: Receiver::new(),
            inbox: Inbox {
                replies: Deque::new(),
                actions: Deque::new(),
                lists_parameters: false,
                dropped: 0,
            },
            sequence: 0,
            dropped: 0,
            next_heartbeat_us: 0,
            next_status_us: 0,
            listed: PARAMETERS.len() as u16,
            text_id: 0,
        }
    }

    /// Takes a byte that was received; what belongs to no frame goes to `text`.
    pub fn receive(&mut self, byte: u8, now_us: u64, text: &mut impl FnMut(u8)) {
        let inbox = &mut self.inbox;
        self.receiver
            .push(byte, now_us, text, &mut |frame| inbox.take(frame));
    }

    /// Lets go of what waits for the rest of a frame for too long; call it now and then.
    pub fn poll(&mut self, now_us: u64, text: &mut impl FnMut(u8)) {
        let inbox = &mut self.inbox;
        self.receiver
            .poll(now_us, text, &mut |frame| inbox.take(frame));
    }

    /// The oldest action that nobody has taken up. Its ticket belongs to [`answer`](Self::answer).
    pub fn take_action(&mut self) -> Option<(Ticket, Action)> {
        self.inbox.actions.pop_front()
    }

    /// Says what became of an action. A parameter that was set is sent in any case, as it now is.
    pub fn answer(&mut self, ticket: Ticket, outcome: Outcome) {
        self.inbox.answer(ticket, outcome);
    }

    /// Messages that were dropped because there was no room for them.
    pub fn dropped(&self) -> u16 {
        self.dropped.saturating_add(self.inbox.dropped)
    }

    /// Writes what is due, the most urgent first, as far as there is room.
    #[inline(never)]
    pub fn fill(&mut self, now_us: u64, vehicle: &Vehicle<'_>, output: &mut Output<'_>) {
        if now_us >= self.next_heartbeat_us {
            self.next_heartbeat_us = now_us + HEARTBEAT_PERIOD_US;
            self.send_or_drop(&heartbeat(vehicle), output);
        }
        while let Some(reply) = self.inbox.replies.front().copied() {
            if !self.reply(reply, vehicle, output) {
                break;
            }
            self.inbox.replies.pop_front();
        }
        if now_us >= self.next_status_us {
            self.next_status_us = now_us + HEARTBEAT_PERIOD_US;
            let status = self.status(vehicle);
            self.send_or_drop(&status, output);
        }
        if let Some(snapshot) = vehicle.snapshot {
            self.send_or_drop(&attitude(snapshot), output);
            self.send_or_drop(&quaternion(snapshot), output);
            self.send_or_drop(&imu(snapshot, vehicle), output);
        }
        // A list is long and has time: one at a time, where there is room.
        if core::mem::take(&mut self.inbox.lists_parameters) {
            self.listed = 0;
        }
        if usize::from(self.listed) < PARAMETERS.len()
            && self.reply(Reply::Parameter(self.listed), vehicle, output)
        {
            self.listed += 1;
        }
    }

    /// Writes a message of the module; false, and nothing of it, if there is no room.
    #[inline(never)]
    pub fn say(&mut self, severity: Severity, text: &str, output: &mut Output<'_>) -> bool {
        let chunks = text.len().div_ceil(TEXT_LENGTH).max(1);
        if !output.has_room(chunks * (OVERHEAD + STATUSTEXT_DATA::ENCODED_LEN + 3)) {
            return false;
        }
        let id = if chunks > 1 {
            self.text_id = self.text_id.wrapping_add(1).max(1);
            self.text_id
        } else {
            0
        };
        let [id_low, id_high] = id.to_le_bytes();
        let mut rest = text.as_bytes();
        for chunk in 0..chunks {
            let (these, others) = rest.split_at_checked(TEXT_LENGTH).unwrap_or((rest, &[]));
            rest = others;
            let mut letters = [0; TEXT_LENGTH];
            for (place, letter) in letters.iter_mut().zip(these) {
                *place = *letter;
            }
            self.send_or_drop(
                &Extended {
                    message: STATUSTEXT_DATA {
                        severity: match severity {
                            Severity::Information => MavSeverity::MAV_SEVERITY_INFO,
                            Severity::Warning => MavSeverity::MAV_SEVERITY_WARNING,
                            Severity::Error => MavSeverity::MAV_SEVERITY_ERROR,
                        },
                        text: CharArray::new(letters),
                    },
                    // Which message, and which piece of it.
                    extension: [id_low, id_high, chunk as u8],
                },
                output,
            );
        }
        true
    }

    #[inline(never)]
    fn reply(&mut self, reply: Reply, vehicle: &Vehicle<'_>, output: &mut Output<'_>) -> bool {
        match reply {
            Reply::Acknowledge(acknowledgement) => self.send(&acknowledgement, output),
            Reply::Parameter(index) => {
                let Some((parameter, name)) = PARAMETERS.get(usize::from(index)) else {
                    return true;
                };
                let value = PARAM_VALUE_DATA {
                    param_value: parameter.value(vehicle.record),
                    param_count: PARAMETERS.len() as u16,
                    param_index: index,
                    param_id: CharArray::new(padded(name)),
                    param_type: MavParamType::MAV_PARAM_TYPE_REAL32,
                };
                self.send(&value, output)
            }
            Reply::NoMission {
                system,
                component,
                kind,
            } => self.send(
                &Extended {
                    message: MISSION_COUNT_DATA {
                        count: 0,
                        target_system: system,
                        target_component: component,
                    },
                    extension: [kind],
                },
                output,
            ),
            Reply::Version => self.send(&version(), output),
        }
    }

    #[inline(never)]
    fn status(&self, vehicle: &Vehicle<'_>) -> SYS_STATUS_DATA {
        let all = MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO
            | MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL
            | MavSysStatusSensor::MAV_SYS_STATUS_AHRS;
        SYS_STATUS_DATA {
            onboard_control_sensors_present: all,
            onboard_control_sensors_enabled: all,
            onboard_control_sensors_health: health(vehicle.snapshot),
            // Not known.
            voltage_battery: u16::MAX,
            current_battery: -1,
            battery_remaining: -1,
            errors_comm: self.dropped(),
            errors_count1: vehicle.bursts_failed,
            ..SYS_STATUS_DATA::DEFAULT
        }
    }

    fn send_or_drop<M: MessageData>(&mut self, message: &M, output: &mut Output<'_>) {
        if !self.send(message, output) {
            self.dropped = self.dropped.saturating_add(1);
        }
    }

    /// Writes a message if it fits; only then it takes a number.
    fn send<M: MessageData>(&mut self, message: &M, output: &mut Output<'_>) -> bool {
        let mut frame = MAVLinkV2MessageRaw::new();
        let header = MavHeader {
            system_id: SYSTEM.into(),
            component_id: COMPONENT,
            sequence: self.sequence,
        };
        frame.serialize_message_data(header, message);
        let is_sent = output.put(frame.raw_bytes());
        self.sequence = self.sequence.wrapping_add(is_sent.into());
        is_sent
    }
}

impl Inbox {
    #[inline(never)]
    fn take(&mut self, frame: &Received) {
        let payload = frame.payload();
        let version = MavlinkVersion::V2;
        let is_ours = |system: u8, component: u8| {
            [0, SYSTEM].contains(&system) && [0, COMPONENT].contains(&component)
        };
        match frame.message {
            Command::LONG | Command::INT => {
                if let Some(command) = Command::read(frame.message, payload)
                    && is_ours(command.target_system, command.target_component)
                {
                    self.command(frame, &command);
                }
            }
            PARAM_REQUEST_LIST_DATA::ID => {
                if let Ok(request) = PARAM_REQUEST_LIST_DATA::deser(version, payload)
                    && is_ours(request.target_system, request.target_component)
                {
                    self.lists_parameters = true;
                }
            }
            PARAM_REQUEST_READ_DATA::ID => {
                if let Ok(request) = PARAM_REQUEST_READ_DATA::deser(version, payload)
                    && is_ours(request.target_system, request.target_component)
                {
                    // An index below zero stands for the name.
                    let index = u16::try_from(request.param_index)
                        .ok()
                        .or_else(|| Parameter::find(name(&request.param_id)));
                    if let Some(index) = index {
                        self.queue(Reply::Parameter(index));
                    }
                }
            }
            PARAM_SET_DATA::ID => {
                if let Ok(request) = PARAM_SET_DATA::deser(version, payload)
                    && is_ours(request.target_system, request.target_component)
                    && let Some(index) = Parameter::find(name(&request.param_id))
                {
                    self.set_parameter(frame, index, request.param_value);
                }
            }
            MISSION_REQUEST_LIST_DATA::ID => {
                type Request = Extended<MISSION_REQUEST_LIST_DATA, 1>;
                if let Ok(request) = Request::deser(version, payload)
                    && is_ours(
                        request.message.target_system,
                        request.message.target_component,
                    )
                {
                    let [kind] = request.extension;
                    self.queue(Reply::NoMission {
                        system: frame.system,
                        component: frame.component,
                        kind,
                    });
                }
            }
            _ => {}
        }
    }

    /// The value comes back, changed or not: that is how the protocol answers.
    fn set_parameter(&mut self, frame: &Received, index: u16, value: f32) {
        let action = PARAMETERS
            .get(usize::from(index))
            .and_then(|(parameter, _)| parameter.action(value));
        if let Some(action) = action {
            let ticket = Ticket {
                command: None,
                system: frame.system,
                component: frame.component,
            };
            if self.actions.push_back((ticket, action)).is_err() {
                self.dropped = self.dropped.saturating_add(1);
            }
        }
        self.queue(Reply::Parameter(index));
    }

    #[inline(never)]
    fn command(&mut self, frame: &Received, command: &Command) {
        let ticket = Ticket {
            command: Some(command.command),
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
                } else if fifth == 1.0 && others_are_zero(4) {
                    Ok(Action::Calibrate(Calibrate::Accelerometer))
                } else if fifth == 2.0 && others_are_zero(4) {
                    Ok(Action::Calibrate(Calibrate::Level))
                } else if first == 0.0 && others_are_zero(0) {
                    Ok(Action::Calibrate(Calibrate::Cancel))
                } else {
                    // A compass, a barometer, a radio: there is none.
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
            REQUEST_MESSAGE
                if first == PARAM_VALUE_DATA::ID as f32 && second == second as u16 as f32 =>
            {
                self.queue(Reply::Parameter(second as u16));
                Err(Outcome::Accepted)
            }
            REQUEST_CAPABILITIES if first == 1.0 => Err(self.answer_version()),
            _ => Err(Outcome::Unsupported),
        };
        let outcome = match action {
            Ok(action) => match self.actions.push_back((ticket, action)) {
                // The owner answers.
                Ok(()) => return,
                Err(_) => Outcome::NotNow,
            },
            Err(outcome) => outcome,
        };
        self.answer(ticket, outcome);
    }

    fn answer_version(&mut self) -> Outcome {
        self.queue(Reply::Version);
        Outcome::Accepted
    }

    #[inline(never)]
    fn answer(&mut self, ticket: Ticket, outcome: Outcome) {
        let Some(command) = ticket.command else {
            return;
        };
        self.queue(Reply::Acknowledge(CommandAck {
            command,
            result: outcome.code(),
            target_system: ticket.system,
            target_component: ticket.component,
        }));
    }

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

#[inline(never)]
fn heartbeat(vehicle: &Vehicle<'_>) -> HEARTBEAT_DATA {
    let flags = vehicle.snapshot.map(|snapshot| snapshot.flags);
    HEARTBEAT_DATA {
        custom_mode: 0,
        mavtype: MavType::MAV_TYPE_GENERIC,
        // Ground stations ignore what claims to be no autopilot.
        autopilot: MavAutopilot::MAV_AUTOPILOT_GENERIC,
        base_mode: if vehicle.is_armed {
            MavModeFlag::MAV_MODE_FLAG_SAFETY_ARMED
        } else {
            MavModeFlag::empty()
        },
        system_status: match flags {
            None => MavState::MAV_STATE_CRITICAL,
            Some(flags) if flags.contains(Flags::CALIBRATING) => MavState::MAV_STATE_CALIBRATING,
            Some(_) if vehicle.is_armed => MavState::MAV_STATE_ACTIVE,
            Some(_) => MavState::MAV_STATE_STANDBY,
        },
        // The version of the protocol's definitions, by which version 2 goes too.
        mavlink_version: 3,
    }
}

/// Which sensors are well.
#[inline(never)]
fn health(snapshot: Option<&Snapshot>) -> MavSysStatusSensor {
    let Some(Snapshot { flags, .. }) = snapshot else {
        return MavSysStatusSensor::empty();
    };
    let unless = |spoiling: &[Flags], sensor: MavSysStatusSensor| {
        if spoiling.iter().any(|flag| flags.contains(*flag)) {
            MavSysStatusSensor::empty()
        } else {
            sensor
        }
    };
    unless(
        &[Flags::FROZEN, Flags::REJECTED, Flags::GYROSCOPE_SATURATED],
        MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO,
    ) | unless(
        &[
            Flags::FROZEN,
            Flags::REJECTED,
            Flags::ACCELEROMETER_SATURATED,
        ],
        MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL,
    ) | unless(
        &[
            Flags::CALIBRATING,
            Flags::FROZEN,
            Flags::REJECTED,
            Flags::GAP,
            Flags::TIME,
        ],
        MavSysStatusSensor::MAV_SYS_STATUS_AHRS,
    )
}

#[inline(never)]
fn attitude(snapshot: &Snapshot) -> ATTITUDE_DATA {
    let angles = snapshot.euler();
    let rates = snapshot.body_rates_rad_s;
    ATTITUDE_DATA {
        time_boot_ms: milliseconds(snapshot.t_us),
        roll: angles.roll_rad,
        pitch: angles.pitch_rad,
        yaw: angles.yaw_rad,
        rollspeed: rates.x,
        pitchspeed: rates.y,
        yawspeed: rates.z,
    }
}

#[inline(never)]
fn quaternion(snapshot: &Snapshot) -> ATTITUDE_QUATERNION_DATA {
    let attitude = snapshot.attitude;
    let rates = snapshot.body_rates_rad_s;
    ATTITUDE_QUATERNION_DATA {
        time_boot_ms: milliseconds(snapshot.t_us),
        q1: attitude.w,
        q2: attitude.x,
        q3: attitude.y,
        q4: attitude.z,
        rollspeed: rates.x,
        pitchspeed: rates.y,
        yawspeed: rates.z,
    }
}

#[inline(never)]
fn imu(snapshot: &Snapshot, vehicle: &Vehicle<'_>) -> HIGHRES_IMU_DATA {
    let force = vehicle.sample.specific_force_m_s2;
    let rates = snapshot.body_rates_rad_s;
    HIGHRES_IMU_DATA {
        time_usec: snapshot.t_us,
        xacc: force.x,
        yacc: force.y,
        zacc: force.z,
        xgyro: rates.x,
        ygyro: rates.y,
        zgyro: rates.z,
        temperature: vehicle.temperature_celsius,
        fields_updated: HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XACC
            | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_YACC
            | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZACC
            | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_XGYRO
            | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_YGYRO
            | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_ZGYRO
            | HighresImuUpdatedFlags::HIGHRES_IMU_UPDATED_TEMPERATURE,
        ..HIGHRES_IMU_DATA::DEFAULT
    }
}

fn version() -> AUTOPILOT_VERSION_DATA {
    AUTOPILOT_VERSION_DATA {
        capabilities: MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_MAVLINK2
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
            | MavProtocolCapability::MAV_PROTOCOL_CAPABILITY_COMMAND_INT,
        // One byte each, and 255 for a release.
        flight_sw_version: u32::from_be_bytes([
            number(env!("CARGO_PKG_VERSION_MAJOR")),
            number(env!("CARGO_PKG_VERSION_MINOR")),
            number(env!("CARGO_PKG_VERSION_PATCH")),
            255,
        ]),
        ..AUTOPILOT_VERSION_DATA::DEFAULT
    }
}

/// The clock of most messages wraps after 49 days. Division by hand, 16 bits at a time: that of 64 bits is a kilobyte of flash.
const fn milliseconds(t_us: u64) -> u32 {
    let [high, middle, low] = [t_us >> 32, (t_us >> 16) & 0xFFFF, t_us & 0xFFFF];
    let middle = ((high as u32 % 1000) << 16) | middle as u32;
    let low = ((middle % 1000) << 16) | low as u32;
    ((middle / 1000) << 16) | (low / 1000)
}

fn number(text: &str) -> u8 {
    text.parse().unwrap_or(u8::MAX)
}

/// A name without the zeros behind it.
fn name(padded: &[u8; 16]) -> &[u8] {
    let length = padded.iter().take_while(|byte| **byte != 0).count();
    padded.get(..length).unwrap_or_default()
}

fn padded(name: &str) -> [u8; 16] {
    let mut padded = [0; 16];
    for (place, byte) in padded.iter_mut().zip(name.bytes()) {
        *place = byte;
    }
    padded
}
