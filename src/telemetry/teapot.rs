//! Packet of the well-known "teapot" demo, 14 bytes, which draws an attitude on a screen.
//!
//! | byte | content |
//! |---|---|
//! | 0, 1 | `$`, 0x02 |
//! | 2 to 9 | quaternion w, x, y, z, two bytes each, high byte first, in units of 1/16384 |
//! | 10 | 0 |
//! | 11 | counter of packets, modulo 256 |
//! | 12, 13 | carriage return, line feed |
//!
//! The layout is that of the MPU-6050 demo of I2Cdevlib. Its Processing sketch takes a number of 2
//! or more for negative: two's complement. The quaternion is the module's, body forward-right-down
//! to earth north-east-down.
//!
//! ```
//! use aplomb::attitude::Quaternion;
//! use aplomb::telemetry::teapot;
//!
//! let packet = teapot::encode(Quaternion::IDENTITY, 7);
//! assert_eq!(teapot::decode(&packet), Some((Quaternion::IDENTITY, 7)));
//! ```

use crate::attitude::Quaternion;

/// Length of a packet, in bytes.
pub const PACKET_LENGTH: usize = 14;

/// Counts per one, as in the sensor's own motion processor.
const COUNTS: f32 = 16_384.0;

const START: [u8; 2] = [b'$', 0x02];
const END: [u8; 2] = *b"\r\n";

/// Encodes a packet. `counter` is the number of packets sent so far, modulo 256.
pub fn encode(attitude: Quaternion, counter: u8) -> [u8; PACKET_LENGTH] {
    let [wh, wl] = counts(attitude.w);
    let [xh, xl] = counts(attitude.x);
    let [yh, yl] = counts(attitude.y);
    let [zh, zl] = counts(attitude.z);
    let [start, kind] = START;
    let [cr, lf] = END;
    [
        start, kind, wh, wl, xh, xl, yh, yl, zh, zl, 0, counter, cr, lf,
    ]
}

/// Decodes a packet: the quaternion, to 1/16384, and the counter; `None` if it is not one.
pub fn decode(packet: &[u8; PACKET_LENGTH]) -> Option<(Quaternion, u8)> {
    let &[
        start,
        kind,
        wh,
        wl,
        xh,
        xl,
        yh,
        yl,
        zh,
        zl,
        0,
        counter,
        cr,
        lf,
    ] = packet
    else {
        return None;
    };
    let number = |high, low| f32::from(i16::from_be_bytes([high, low])) / COUNTS;
    ([start, kind] == START && [cr, lf] == END).then_some((
        Quaternion {
            w: number(wh, wl),
            x: number(xh, xl),
            y: number(yh, yl),
            z: number(zh, zl),
        },
        counter,
    ))
}

/// Rounds to counts. The cast saturates, and turns a NaN into zero.
#[inline(never)]
fn counts(value: f32) -> [u8; 2] {
    let half = if value < 0.0 { -0.5 } else { 0.5 };
    ((value * COUNTS + half) as i16).to_be_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quaternion([w, x, y, z]: [f32; 4]) -> Quaternion {
        Quaternion { w, x, y, z }
    }

    #[test]
    fn the_packet_has_the_layout_of_the_demo() {
        let attitude = quaternion([0.5, -0.5, 0.25, 1.0]);
        assert_eq!(
            encode(attitude, 200),
            [
                0x24, 0x02, 0x20, 0x00, 0xE0, 0x00, 0x10, 0x00, 0x40, 0x00, 0x00, 200, 0x0D, 0x0A
            ]
        );
    }

    #[test]
    fn a_packet_is_read_back_within_half_a_count_and_a_broken_one_refused() {
        let attitude = quaternion([0.123_456, -0.654_321, 0.7, -0.259]);
        let packet = encode(attitude, 7);
        let (read, counter) = decode(&packet).expect("a packet");
        assert_eq!(counter, 7);
        for (one, other) in [
            (read.w, attitude.w),
            (read.x, attitude.x),
            (read.y, attitude.y),
            (read.z, attitude.z),
        ] {
            assert!((one - other).abs() <= 0.5 / 16_384.0, "{one} {other}");
        }
        for place in [0, 1, 10, 12, 13] {
            let mut broken = packet;
            broken[place] ^= 0x40;
            assert_eq!(decode(&broken), None, "{place}");
        }
    }

    #[test]
    fn numbers_beyond_the_range_saturate() {
        let packet = encode(
            quaternion([f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 2.5]),
            0,
        );
        assert_eq!(packet[2..10], [0x7F, 0xFF, 0x80, 0x00, 0, 0, 0x7F, 0xFF]);
    }
}
