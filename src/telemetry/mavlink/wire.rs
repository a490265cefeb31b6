//! Wire types beyond those of the `mavlink` crate.
//!
//! The crate's commands are those of its dialect, but every command needs an answer: [`Command`]
//! holds any. The crate rejects a request with a value that its enumerations lack. So a [`Payload`]
//! is decoded by hand; the tests send requests of the crate. [`Extended`] appends the fields of
//! version 2. The crate's own option for them (0.21.0) pulls its code generator, which needs the
//! standard library, into the firmware.

use ::mavlink::dialects::common::{
    COMMAND_ACK_DATA, COMMAND_INT_DATA, COMMAND_LONG_DATA, MavMessage,
};
use ::mavlink::{MavlinkVersion, MessageData, bytes_mut::BytesMut, error::ParserError};

use super::action::Outcome;

/// System of the module's address: the first, which ground stations expect.
pub const SYSTEM: u8 = 1;
/// Component of the module's address: MAV_COMP_ID_AUTOPILOT1.
pub const COMPONENT: u8 = 1;

/// Length of the longest payload that is read, without its extensions: COMMAND_INT's.
const LONGEST_PAYLOAD: usize = 36;

/// Payload of a received message, with the zeros that a sender leaves out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Payload([u8; LONGEST_PAYLOAD]);

impl Payload {
    /// Creates a payload. Bytes beyond its capacity are left out.
    pub(super) fn new(received: &[u8]) -> Self {
        let mut bytes = [0; LONGEST_PAYLOAD];
        for (place, byte) in bytes.iter_mut().zip(received) {
            *place = *byte;
        }
        Self(bytes)
    }

    /// Returns the `N` bytes of the field at this place; zeros if there are fewer.
    pub(super) fn field<const N: usize>(&self, at: usize) -> [u8; N] {
        let bytes = self.0.get(at..).and_then(<[u8]>::first_chunk);
        bytes.copied().unwrap_or([0; N])
    }
}

/// COMMAND_LONG or COMMAND_INT, which differ in the type of two parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Command {
    /// Parameters 1 to 7; NaN if unused.
    pub(super) parameters: [f32; 7],
    pub(super) command: u16,
}

impl Command {
    pub(super) const LONG: u32 = COMMAND_LONG_DATA::ID;
    pub(super) const INT: u32 = COMMAND_INT_DATA::ID;

    /// Place of the target in the payload: its system, then its component.
    pub(super) const TARGET_AT: usize = 30;

    /// Decodes a command from this message.
    pub(super) fn read(message: u32, payload: &Payload) -> Self {
        let mut parameters = [0.0; 7];
        for (index, parameter) in parameters.iter_mut().enumerate() {
            let is_integer = message == Self::INT && (index == 4 || index == 5);
            let bytes = payload.field(4 * index);
            *parameter = match i32::from_le_bytes(bytes) {
                i32::MAX if is_integer => f32::NAN,
                integer if is_integer => integer as f32,
                _ => f32::from_le_bytes(bytes),
            };
        }
        Self {
            parameters,
            command: u16::from_le_bytes(payload.field(28)),
        }
    }
}

/// Message with the fields that version 2 appended, as bytes.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Extended<M, const N: usize> {
    pub(super) message: M,
    pub(super) extension: [u8; N],
}

impl<M: MessageData, const N: usize> MessageData for Extended<M, N> {
    type Message = M::Message;

    const ID: u32 = M::ID;
    const NAME: &'static str = M::NAME;
    // The extension is not part of it.
    const EXTRA_CRC: u8 = M::EXTRA_CRC;
    const ENCODED_LEN: usize = M::ENCODED_LEN + N;

    fn ser(&self, _: MavlinkVersion, payload: &mut [u8]) -> usize {
        // Version 1 keeps the zeros at the end.
        let length = self.message.ser(MavlinkVersion::V1, payload);
        if let Some(place) = payload.get_mut(length..length + N) {
            place.copy_from_slice(&self.extension);
        }
        mavlink::utils::remove_trailing_zeroes(payload.get(..length + N).unwrap_or_default())
    }

    fn deser(version: MavlinkVersion, payload: &[u8]) -> Result<Self, ParserError> {
        let mut extension = [0; N];
        for (place, byte) in extension
            .iter_mut()
            .zip(payload.get(M::ENCODED_LEN..).unwrap_or_default())
        {
            *place = *byte;
        }
        Ok(Self {
            message: M::deser(version, payload)?,
            extension,
        })
    }
}

/// COMMAND_ACK for any command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct CommandAck {
    pub(super) command: u16,
    /// MAV_RESULT.
    pub(super) result: u8,
    pub(super) target_system: u8,
    pub(super) target_component: u8,
}

impl MessageData for CommandAck {
    type Message = MavMessage;

    const ID: u32 = COMMAND_ACK_DATA::ID;
    const NAME: &'static str = COMMAND_ACK_DATA::NAME;
    const EXTRA_CRC: u8 = COMMAND_ACK_DATA::EXTRA_CRC;
    const ENCODED_LEN: usize = 10;

    fn ser(&self, _: MavlinkVersion, payload: &mut [u8]) -> usize {
        let mut bytes = BytesMut::new(payload);
        if bytes.remaining() < Self::ENCODED_LEN {
            return 0;
        }
        bytes.put_u16_le(self.command);
        bytes.put_u8(self.result);
        // Progress in percent: unknown while there is some. No second result.
        let is_in_progress = self.result == Outcome::InProgress.code();
        bytes.put_u8(if is_in_progress { u8::MAX } else { 0 });
        bytes.put_i32_le(0);
        bytes.put_u8(self.target_system);
        bytes.put_u8(self.target_component);
        let length = bytes.len();
        mavlink::utils::remove_trailing_zeroes(payload.get(..length).unwrap_or_default())
    }

    fn deser(_: MavlinkVersion, payload: &[u8]) -> Result<Self, ParserError> {
        let mut whole = [0; Self::ENCODED_LEN];
        for (place, byte) in whole.iter_mut().zip(payload) {
            *place = *byte;
        }
        let [
            low,
            high,
            result,
            _,
            _,
            _,
            _,
            _,
            target_system,
            target_component,
        ] = whole;
        Ok(Self {
            command: u16::from_le_bytes([low, high]),
            result,
            target_system,
            target_component,
        })
    }
}
