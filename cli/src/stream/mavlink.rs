//! MAVLink 2 from the module.

use aplomb::units::degrees;
use mavlink::dialects::common::{MavMessage, MavSysStatusSensor};
use mavlink::{MAVLinkV2MessageRaw, MavlinkVersion, Message};

use super::item::{Attitude, Counts, Item, Sensors};

/// Room for the longest frame of MAVLink 2, as the `mavlink` crate has it.
const MAVLINK_CAPACITY: usize = 283;

/// Decoder of MAVLink 2.
#[derive(Default)]
pub struct Mavlink {
    bytes: Vec<u8>,
    /// Sequence number of the last frame.
    pub sequence: Option<u8>,
    /// Pieces of a message, its number, and the number of its next piece.
    text: Vec<u8>,
    text_id: u16,
    next_piece: u8,
    damaged: u64,
}

impl Mavlink {
    pub const START: u8 = 0xFD;
    pub const OVERHEAD: usize = 12;
    const SIGNED: u8 = 1;

    /// Takes a byte, and returns whether a frame ends with it. A frame that is found late, behind a
    /// false start, does not: the byte may belong to another format.
    pub fn push(&mut self, byte: u8, counts: &mut Counts, items: &mut Vec<Item>) -> bool {
        if self.bytes.is_empty() && byte != Self::START {
            return false;
        }
        self.bytes.push(byte);
        let mut is_frame = false;
        while let [Self::START, length, flags, ..] = self.bytes[..] {
            let signature = if flags & Self::SIGNED != 0 { 13 } else { 0 };
            let whole = Self::OVERHEAD + usize::from(length) + signature;
            if self.bytes.len() < whole {
                break;
            }
            let mut frame = [0; MAVLINK_CAPACITY];
            frame[..whole].copy_from_slice(&self.bytes[..whole]);
            let raw = MAVLinkV2MessageRaw::from_bytes_unparsed(frame);
            let used = if raw.has_valid_crc::<MavMessage>() {
                is_frame = self.bytes.len() == whole;
                self.frame(&raw, counts, items);
                whole
            } else {
                self.damaged += 1;
                1
            };
            self.bytes.drain(..used);
            // The next frame may begin at the next start byte.
            let next = self.bytes.iter().position(|byte| *byte == Self::START);
            self.bytes.drain(..next.unwrap_or(self.bytes.len()));
        }
        is_frame
    }

    /// Returns the damaged pieces since the last call.
    pub fn take_damaged(&mut self) -> u64 {
        std::mem::take(&mut self.damaged)
    }

    fn frame(&mut self, raw: &MAVLinkV2MessageRaw, counts: &mut Counts, items: &mut Vec<Item>) {
        if let Some(last) = self.sequence.replace(raw.sequence()) {
            counts.lost += u64::from(raw.sequence().wrapping_sub(last).wrapping_sub(1));
        }
        let payload = raw.payload();
        let Ok(message) = MavMessage::parse(MavlinkVersion::V2, raw.message_id(), payload) else {
            return;
        };
        match message {
            MavMessage::ATTITUDE(attitude) => items.push(Item::Attitude(Attitude {
                t_us: Some(u64::from(attitude.time_boot_ms) * 1000),
                roll_deg: degrees(attitude.roll),
                pitch_deg: degrees(attitude.pitch),
                yaw_deg: Some(degrees(attitude.yaw)),
                rates_deg_s: [attitude.rollspeed, attitude.pitchspeed, attitude.yawspeed]
                    .map(|rate| Some(degrees(rate))),
                flags: None,
            })),
            MavMessage::HIGHRES_IMU(imu) => items.push(Item::Temperature(imu.temperature)),
            MavMessage::SYS_STATUS(status) => {
                let is_healthy = |sensor| status.onboard_control_sensors_health.contains(sensor);
                items.push(Item::Sensors(Sensors {
                    gyroscope: is_healthy(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_GYRO),
                    accelerometer: is_healthy(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_ACCEL),
                    attitude: is_healthy(MavSysStatusSensor::MAV_SYS_STATUS_AHRS),
                    compass: is_healthy(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_MAG)
                        || !(status.onboard_control_sensors_present)
                            .contains(MavSysStatusSensor::MAV_SYS_STATUS_SENSOR_3D_MAG),
                }));
            }
            MavMessage::STATUSTEXT(_) => self.text(payload, items),
            _ => {}
        }
    }

    /// Takes a piece of a message: severity, 50 letters, number of the message, number of the
    /// piece. Zeros at the end may be missing. An ellipsis stands for lost pieces.
    fn text(&mut self, payload: &[u8], items: &mut Vec<Item>) {
        const LETTERS: std::ops::Range<usize> = 1..51;
        let letters = payload
            .get(LETTERS.start..payload.len().min(LETTERS.end))
            .unwrap_or_default();
        let at = |place: usize| payload.get(place).copied().unwrap_or_default();
        let id = u16::from_le_bytes([at(LETTERS.end), at(LETTERS.end + 1)]);
        let piece = if id == 0 { 0 } else { at(LETTERS.end + 2) };
        if id != self.text_id || piece < self.next_piece {
            // The last pieces of the message before are lost.
            if !self.text.is_empty() {
                self.text.extend("…".as_bytes());
                self.end_text(items);
            }
            self.next_piece = 0;
        }
        if piece != self.next_piece {
            self.text.extend("…".as_bytes());
        }
        (self.text_id, self.next_piece) = (id, piece.saturating_add(1));
        let end = letters.iter().position(|letter| *letter == 0);
        self.text.extend(&letters[..end.unwrap_or(letters.len())]);
        let is_last = id == 0 || end.is_some() || letters.len() < LETTERS.len();
        if is_last {
            self.end_text(items);
        }
    }

    /// Ends a message. The next piece begins another.
    fn end_text(&mut self, items: &mut Vec<Item>) {
        let text = String::from_utf8_lossy(&std::mem::take(&mut self.text)).into_owned();
        items.push(Item::Message(text));
        (self.text_id, self.next_piece) = (0, 0);
    }
}
