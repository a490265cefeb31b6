//! The 14-byte packet of the well-known "teapot" demo, which draws an attitude on a screen.
//!
//! | byte | |
//! |---|---|
//! | 0, 1 | `$`, 0x02 |
//! | 2 to 9 | quaternion w, x, y, z, two bytes each, high byte first, in units of 1/16384 |
//! | 10 | 0 |
//! | 11 | a counter, one more for each packet |
//! | 12, 13 | carriage return, line feed |
//!
//! The layout is that of the MPU-6050 demo of I2Cdevlib, whose Processing sketch takes what reads as 2 or more for
//! negative: two's complement. The quaternion is the module's, body forward-right-down to earth north-east-down.

use crate::attitude::Quaternion;

/// Bytes of a packet.
pub const PACKET_LENGTH: usize = 14;

/// Counts of one, as in the sensor's own motion processor.
const COUNTS: f32 = 16_384.0;

const START: [u8; 2] = [b'$', 0x02];
const END: [u8; 2] = *b"\r\n";

/// Writes a packet. The counter is the owner's: one more for each packet that is sent.
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

/// Reads a packet: the quaternion, as far as its resolution goes, and the counter. `None` if it is not one.
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

/// Rounded to the nearest; a cast saturates, and turns what is not a number into zero.
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
    fn the_packet_is_the_demos() {
        let attitude = quaternion([0.5, -0.5, 0.25, 1.0]);
        assert_eq!(
            encode(attitude, 200),
            [
                0x24, 0x02, 0x20, 0x00, 0xE0, 0x00, 0x10, 0x00, 0x40, 0x00, 0x00, 200, 0x0D, 0x0A
            ]
        );
    }

    #[test]
    fn it_reads_back_within_half_a_count_and_nothing_else_does() {
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
    fn what_is_no_rotation_saturates() {
        let packet = encode(
            quaternion([f32::INFINITY, f32::NEG_INFINITY, f32::NAN, 2.5]),
            0,
        );
        assert_eq!(packet[2..10], [0x7F, 0xFF, 0x80, 0x00, 0, 0, 0x7F, 0xFF]);
    }
}
