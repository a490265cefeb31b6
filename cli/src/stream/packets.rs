//! Packets of the teapot demo.

use aplomb::attitude::Quaternion;
use aplomb::telemetry::teapot;

/// Decoder of the teapot demo's packets.
#[derive(Default)]
pub struct Packets {
    window: [u8; teapot::PACKET_LENGTH],
    /// Counter of the last packet.
    pub counter: Option<u8>,
}

impl Packets {
    /// Takes a byte, and returns the attitude and the counter of the packet that it ends.
    pub fn push(&mut self, byte: u8) -> Option<(Quaternion, u8)> {
        self.window.rotate_left(1);
        self.window[teapot::PACKET_LENGTH - 1] = byte;
        if byte != b'\n' {
            return None;
        }
        let found = teapot::decode(&self.window)?;
        // A packet has no checksum, but its quaternion has unit length.
        let length = found.0.dot(found.0);
        (0.99..1.01).contains(&length).then_some(found)
    }
}
