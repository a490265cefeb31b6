//! Session: passes received frames to the inbox, and sends the messages that are due.

#[cfg(test)]
mod tests;

use ::mavlink::dialects::common::{
    MISSION_COUNT_DATA, MavParamType, MavSeverity, MavSysStatusSensor, PARAM_VALUE_DATA,
    STATUSTEXT_DATA, SYS_STATUS_DATA,
};
use ::mavlink::types::CharArray;
use ::mavlink::{MAVLinkV2MessageRaw, MavHeader, MessageData};
use heapless::Deque;

use super::super::message::Severity;
use super::super::output::Output;
use super::action::{Action, Outcome, Ticket};
use super::inbox::{Inbox, Reply};
use super::messages::{Vehicle, attitude, health, heartbeat, hud, imu, quaternion, version};
use super::parameter::{PARAMETERS, Parameter};
use super::receiver::Receiver;
use super::wire::{COMPONENT, Extended, SYSTEM};
use crate::health::Flags;
use crate::telemetry::{TEXT_FRAME_LENGTH, TEXT_LENGTH};
use crate::units::MagneticField;

/// Time without a measurement after which the module is in a critical state, µs.
const LONGEST_OUTAGE_US: u64 = 500_000;
/// Time between two heartbeats, and between two SYS_STATUS if no sensor's health changes, µs.
const HEARTBEAT_PERIOD_US: u64 = 1_000_000;
/// Shortest time between two SYS_STATUS, µs.
const SHORTEST_STATUS_PERIOD_US: u64 = 100_000;
/// Time between two VFR_HUD, µs.
const HUD_PERIOD_US: u64 = 500_000;
/// Header and checksum, the fields of version 1, and the two that version 2 has appended.
const _: () = assert!(TEXT_FRAME_LENGTH == 12 + STATUSTEXT_DATA::ENCODED_LEN + 3);

/// MAVLink session of the module.
#[derive(Debug, Clone)]
pub struct Session {
    receiver: Receiver,
    inbox: Inbox,
    sequence: u8,
    dropped: u16,
    next_heartbeat_us: u64,
    /// Time of the last SYS_STATUS, µs.
    status_us: u64,
    next_hud_us: u64,
    /// Time of the last measurement, µs.
    measured_us: u64,
    /// Healthy sensors in the last SYS_STATUS.
    reported: MavSysStatusSensor,
    /// Those of them that have not been healthy since, if only for one attitude.
    unhealthy: MavSysStatusSensor,
    /// Field in the last HIGHRES_IMU.
    sent_field: Option<MagneticField>,
    /// Next parameter of a requested list.
    listed: u16,
    text_id: u16,
}

impl Default for Session {
    fn default() -> Self {
        Self::new()
    }
}

impl Session {
    /// Creates a session that has sent and received nothing.
    pub const fn new() -> Self {
        Self {
            receiver: Receiver::new(),
            inbox: Inbox {
                replies: Deque::new(),
                actions: Deque::new(),
                lists_parameters: false,
                dropped: 0,
                has_frame: false,
            },
            sequence: 0,
            dropped: 0,
            next_heartbeat_us: 0,
            status_us: 0,
            next_hud_us: 0,
            measured_us: 0,
            reported: MavSysStatusSensor::empty(),
            unhealthy: MavSysStatusSensor::empty(),
            sent_field: None,
            listed: PARAMETERS.len() as u16,
            text_id: 0,
        }
    }

    /// Handles a received byte. Bytes that belong to no frame go to `text`. `now_us` is the time
    /// since boot, µs.
    pub fn receive(&mut self, byte: u8, now_us: u64, text: &mut impl FnMut(u8)) {
        let inbox = &mut self.inbox;
        self.receiver
            .push(byte, now_us, text, &mut |frame| inbox.take(frame));
    }

    /// Passes an incomplete frame to `text` after a timeout of 0.1 s. Call it whenever no received
    /// byte is left. Between two calls the rest of a frame may wait for any time.
    pub fn poll(&mut self, now_us: u64, text: &mut impl FnMut(u8)) {
        let inbox = &mut self.inbox;
        self.receiver
            .poll(now_us, text, &mut |frame| inbox.take(frame));
    }

    /// Returns whether a frame with a valid checksum has arrived since the last call.
    pub const fn take_has_frame(&mut self) -> bool {
        core::mem::replace(&mut self.inbox.has_frame, false)
    }

    /// Returns the oldest queued action. Its ticket is for [`answer`](Self::answer).
    pub fn take_action(&mut self) -> Option<(Ticket, Action)> {
        self.inbox.actions.pop_front()
    }

    /// Reports the result of an action. A parameter that was set is sent in any case, with its
    /// present value.
    pub fn answer(&mut self, ticket: Ticket, outcome: Outcome) {
        self.inbox.answer(ticket, outcome);
    }

    /// Discards an incomplete frame.
    pub const fn discard(&mut self) {
        self.receiver.clear();
    }

    /// Returns the number of messages that were dropped for lack of room.
    pub fn dropped(&self) -> u16 {
        self.dropped.saturating_add(self.inbox.dropped)
    }

    /// Writes the messages that are due, the most urgent first, as far as there is room. `now_us`
    /// is the time since boot, µs.
    #[inline(never)]
    pub fn fill(&mut self, now_us: u64, vehicle: &Vehicle<'_>, output: &mut Output<'_>) {
        let flags = vehicle.snapshot.map(|snapshot| snapshot.flags);
        let is_measured = flags.is_some_and(|flags| !flags.intersects(Flags::NO_MEASUREMENT));
        if is_measured {
            self.measured_us = now_us;
        }
        if now_us >= self.next_heartbeat_us {
            self.next_heartbeat_us = now_us + HEARTBEAT_PERIOD_US;
            let is_lost = now_us.saturating_sub(self.measured_us) >= LONGEST_OUTAGE_US;
            self.send_or_drop(&heartbeat(vehicle, is_lost), output);
        }
        while let Some(reply) = self.inbox.replies.front().copied() {
            if !self.reply(reply, vehicle, output) {
                break;
            }
            self.inbox.replies.pop_front();
        }
        self.report_health(now_us, vehicle, output);
        if let Some(snapshot) = &vehicle.attitude()
            && vehicle.is_due
        {
            self.send_or_drop(&attitude(snapshot), output);
            self.send_or_drop(&quaternion(snapshot), output);
            let has_new_field = vehicle.compass.field != self.sent_field;
            self.sent_field = vehicle.compass.field;
            self.send_or_drop(&imu(snapshot, vehicle, is_measured, has_new_field), output);
        }
        if let (Some(snapshot), Some(heading)) = (vehicle.snapshot, vehicle.valid_heading())
            && vehicle.is_due
            && now_us >= self.next_hud_us
        {
            self.next_hud_us = now_us + HUD_PERIOD_US;
            self.send_or_drop(&hud(snapshot, &heading), output);
        }
        // A parameter list is long and not urgent: one parameter a call, if there is room.
        if core::mem::take(&mut self.inbox.lists_parameters) {
            self.listed = 0;
        }
        if usize::from(self.listed) < PARAMETERS.len()
            && self.reply(Reply::Parameter(self.listed), vehicle, output)
        {
            self.listed += 1;
        }
    }

    /// Writes a message of the module as STATUSTEXT. Returns false, and writes nothing, if there is
    /// no room for all of it.
    #[inline(never)]
    pub fn send_text(&mut self, severity: Severity, text: &str, output: &mut Output<'_>) -> bool {
        // A zero ends the text, so a last piece of several has room for one.
        let chunks = if text.len() <= TEXT_LENGTH {
            1
        } else {
            text.len() / TEXT_LENGTH + 1
        };
        if !output.has_room(chunks * TEXT_FRAME_LENGTH) {
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
                    // Number of the message, and of its piece.
                    extension: [id_low, id_high, chunk as u8],
                },
                output,
            );
        }
        true
    }

    /// Writes an answer; false if there is no room.
    #[inline(never)]
    fn reply(&mut self, reply: Reply, vehicle: &Vehicle<'_>, output: &mut Output<'_>) -> bool {
        match reply {
            Reply::Acknowledge(acknowledgement) => self.send(&acknowledgement, output),
            Reply::Parameter(index) => {
                let Some((parameter, name)) = PARAMETERS.get(usize::from(index)) else {
                    return true;
                };
                let value = PARAM_VALUE_DATA {
                    param_value: match parameter {
                        // The record has a new one after its first command or frame.
                        Parameter::Baud => vehicle.baud as f32,
                        _ => parameter.value(vehicle.record),
                    },
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

    /// Writes SYS_STATUS if it is due, or if a sensor's health has changed. A sensor that was not
    /// healthy for one attitude is reported so once.
    fn report_health(&mut self, now_us: u64, vehicle: &Vehicle<'_>, output: &mut Output<'_>) {
        let all = vehicle.sensors();
        let flags = vehicle.snapshot.map(|snapshot| snapshot.flags);
        let healthy_now = health(flags, all);
        self.unhealthy |= self.reported - healthy_now;
        let healthy = healthy_now - self.unhealthy;
        let period_us = if healthy == self.reported {
            HEARTBEAT_PERIOD_US
        } else {
            SHORTEST_STATUS_PERIOD_US
        };
        if now_us < self.status_us + period_us {
            return;
        }
        self.status_us = now_us;
        let status = SYS_STATUS_DATA {
            onboard_control_sensors_present: all,
            onboard_control_sensors_enabled: all,
            onboard_control_sensors_health: healthy,
            // Unknown.
            voltage_battery: u16::MAX,
            current_battery: -1,
            battery_remaining: -1,
            errors_comm: self.dropped(),
            errors_count1: vehicle.bursts_failed,
            ..SYS_STATUS_DATA::DEFAULT
        };
        if self.send(&status, output) {
            self.reported = healthy;
            self.unhealthy = MavSysStatusSensor::empty();
        } else {
            self.dropped = self.dropped.saturating_add(1);
        }
    }

    /// Writes a message, or counts it as dropped.
    fn send_or_drop<M: MessageData>(&mut self, message: &M, output: &mut Output<'_>) {
        if !self.send(message, output) {
            self.dropped = self.dropped.saturating_add(1);
        }
    }

    /// Writes a message if it fits; only then it takes a sequence number.
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

/// Pads a name with zeros.
fn padded(name: &str) -> [u8; 16] {
    let mut padded = [0; 16];
    for (place, byte) in padded.iter_mut().zip(name.bytes()) {
        *place = byte;
    }
    padded
}
