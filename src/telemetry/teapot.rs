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
//! or more for negative: two's complement.
//!
//! The packet's quaternion has the axes of that sketch: right, forward, up, in body and earth. The
//! sketch draws the nose along Y, as of a sensor that lies face up. The module's axes are
//! forward-right-down and north-east-down: x and y change places, and z changes its sign.
//! [`encode`] and [`decode`] convert.
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

/// Encodes a packet from the quaternion of the module's axes. `counter` is the number of packets
/// sent so far, modulo 256.
pub fn encode(attitude: Quaternion, counter: u8) -> [u8; PACKET_LENGTH] {
    let [wh, wl] = counts(attitude.w);
    let [xh, xl] = counts(attitude.y);
    let [yh, yl] = counts(attitude.x);
    let [zh, zl] = counts(-attitude.z);
    let [start, kind] = START;
    let [cr, lf] = END;
    [
        start, kind, wh, wl, xh, xl, yh, yl, zh, zl, 0, counter, cr, lf,
    ]
}

/// Decodes a packet: the quaternion of the module's axes, to 1/16384, and the counter; `None` if it
/// is not one.
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
            x: number(yh, yl),
            y: number(xh, xl),
            z: -number(zh, zl),
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
    use crate::attitude::{EulerAngles, Vector3};

    fn quaternion([w, x, y, z]: [f32; 4]) -> Quaternion {
        Quaternion { w, x, y, z }
    }

    /// Returns a point of the demo's aeroplane on its screen: x to the right, y down, z towards the
    /// viewer. Follows the sketch and not the module: the axis of the quaternion, with the order
    /// (−x, z, y), goes into Processing's `rotate`, which is Rodrigues' formula.
    fn on_screen(packet: &[u8; PACKET_LENGTH], point: Vector3) -> Vector3 {
        let number = |place: usize| {
            let sum = u16::from_be_bytes([packet[place], packet[place + 1]]);
            let number = f32::from(sum) / 16_384.0;
            if number >= 2.0 { number - 4.0 } else { number }
        };
        let [w, x, y, z] = [2, 4, 6, 8].map(number);
        let scale = 1.0 / libm::sqrtf(1.0 - w * w).max(1e-6);
        let axis = Vector3::new(-x, z, y).scale(scale);
        let angle_rad = 2.0 * libm::acosf(w);
        let (sine, cosine) = (libm::sinf(angle_rad), libm::cosf(angle_rad));
        point.scale(cosine)
            + axis.cross(point).scale(sine)
            + axis.scale(axis.dot(point) * (1.0 - cosine))
    }

    #[test]
    fn the_aeroplane_of_the_demo_moves_as_the_body_does() {
        let poses = [
            ([0.0; 3], [0.0, 0.0, 0.0]),
            // Roll: the right wing comes down.
            ([40.0, 0.0, 0.0], [0.0, 0.643, 0.0]),
            // Pitch: the nose goes up.
            ([0.0, 30.0, 0.0], [0.0, 0.0, -0.5]),
            // Yaw: the nose goes to the right.
            ([0.0, 0.0, 50.0], [0.766, 0.0, 0.0]),
            // Right wing down, then nose up, then to the right.
            ([40.0, 30.0, 50.0], [0.663, 0.557, -0.5]),
        ];
        for ([roll, pitch, yaw], [nose_x, wing_y, nose_y]) in poses {
            let attitude = Quaternion::from_euler(EulerAngles {
                roll_rad: f32::to_radians(roll),
                pitch_rad: f32::to_radians(pitch),
                yaw_rad: f32::to_radians(yaw),
            });
            let packet = encode(attitude, 0);
            // The sketch draws the nose away from the viewer, and the wings to the sides.
            let nose = on_screen(&packet, Vector3::new(0.0, 0.0, -1.0));
            let wing = on_screen(&packet, Vector3::new(1.0, 0.0, 0.0));
            let found = [nose.x, wing.y, nose.y];
            let expected = [nose_x, wing_y, nose_y];
            for (one, other) in found.into_iter().zip(expected) {
                assert!(
                    (one - other).abs() < 1e-3,
                    "{roll} {pitch} {yaw}: {found:?}"
                );
            }
            let (read, _) = decode(&packet).expect("a packet");
            assert!(read.dot(attitude).abs() > 0.999_99, "{read:?}");
        }
    }

    #[test]
    fn the_packet_has_the_layout_and_the_axes_of_the_demo() {
        // Right is the module's y, forward its x, and up its −z.
        let attitude = quaternion([0.5, 0.25, -0.5, -1.0]);
        let packet = [
            0x24, 0x02, 0x20, 0x00, 0xE0, 0x00, 0x10, 0x00, 0x40, 0x00, 0x00, 200, 0x0D, 0x0A,
        ];
        assert_eq!(encode(attitude, 200), packet);
        assert_eq!(decode(&packet), Some((attitude, 200)));
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
            quaternion([f32::INFINITY, f32::NAN, f32::NEG_INFINITY, -2.5]),
            0,
        );
        assert_eq!(packet[2..10], [0x7F, 0xFF, 0x80, 0x00, 0, 0, 0x7F, 0xFF]);
    }
}
