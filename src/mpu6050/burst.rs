//! Burst: the 14 bytes of one sample, and their counts.
//!
//! A bus delivers a [`Burst`]. [`RawSample`] holds its counts in sensor axes, in newtypes that
//! convert to SI units. Nothing here can fail: every 14 bytes are a sample.

use super::config::{AccelerometerRange, GyroscopeRange};
use super::part::Part;
use crate::attitude::Vector3;

/// Number of data registers per sample: 0x3B to 0x48 (register map §4.17 to §4.19).
pub const BURST_LENGTH: usize = 14;

/// Bytes of one sample, with the time of its data-ready edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Burst {
    /// Registers 0x3B to 0x48 in order.
    pub bytes: [u8; BURST_LENGTH],
    /// Time of the data-ready edge, µs since start.
    pub captured_at_us: u64,
    /// Samples lost between the last published burst and this one; 255 means that or more.
    pub missed_before: u8,
}

/// Sample in counts, in sensor axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct RawSample {
    /// Accelerometer counts.
    pub accelerometer: AccelerometerCounts,
    /// Counts of the die temperature.
    pub temperature: TemperatureCounts,
    /// Gyroscope counts.
    pub gyroscope: GyroscopeCounts,
}

impl RawSample {
    /// Decodes a burst: accelerometer x y z, temperature, gyroscope x y z, all big-endian.
    #[inline]
    pub const fn decode(bytes: &[u8; BURST_LENGTH]) -> Self {
        let &[
            axh,
            axl,
            ayh,
            ayl,
            azh,
            azl,
            th,
            tl,
            gxh,
            gxl,
            gyh,
            gyl,
            gzh,
            gzl,
        ] = bytes;
        Self {
            accelerometer: AccelerometerCounts([
                i16::from_be_bytes([axh, axl]),
                i16::from_be_bytes([ayh, ayl]),
                i16::from_be_bytes([azh, azl]),
            ]),
            temperature: TemperatureCounts(i16::from_be_bytes([th, tl])),
            gyroscope: GyroscopeCounts([
                i16::from_be_bytes([gxh, gxl]),
                i16::from_be_bytes([gyh, gyl]),
                i16::from_be_bytes([gzh, gzl]),
            ]),
        }
    }

    /// Encodes the sample to the bytes of a burst.
    pub const fn encode(&self) -> [u8; BURST_LENGTH] {
        let [ax, ay, az] = self.accelerometer.0;
        let [gx, gy, gz] = self.gyroscope.0;
        let [axh, axl] = ax.to_be_bytes();
        let [ayh, ayl] = ay.to_be_bytes();
        let [azh, azl] = az.to_be_bytes();
        let [th, tl] = self.temperature.0.to_be_bytes();
        let [gxh, gxl] = gx.to_be_bytes();
        let [gyh, gyl] = gy.to_be_bytes();
        let [gzh, gzl] = gz.to_be_bytes();
        [
            axh, axl, ayh, ayl, azh, azl, th, tl, gxh, gxl, gyh, gyl, gzh, gzl,
        ]
    }
}

/// Accelerometer counts along sensor x, y, z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct AccelerometerCounts(pub [i16; 3]);

impl AccelerometerCounts {
    /// Converts to the specific force, m/s² in sensor axes.
    #[inline]
    pub fn to_m_s2(self, range: AccelerometerRange) -> Vector3 {
        scale(self.0, range.m_s2_per_count())
    }

    /// Returns whether an axis reads full scale; the true value may be larger.
    #[inline]
    pub fn is_saturated(self) -> bool {
        is_saturated(self.0)
    }
}

/// Gyroscope counts about sensor x, y, z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct GyroscopeCounts(pub [i16; 3]);

impl GyroscopeCounts {
    /// Converts to the angular rate, rad/s in sensor axes.
    #[inline]
    pub fn to_rad_s(self, range: GyroscopeRange) -> Vector3 {
        scale(self.0, range.rad_s_per_count())
    }

    /// Returns whether an axis reads full scale; the true value may be larger.
    #[inline]
    pub fn is_saturated(self) -> bool {
        is_saturated(self.0)
    }
}

/// Counts of the die's temperature sensor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TemperatureCounts(pub i16);

impl TemperatureCounts {
    /// Converts to the die temperature, °C, by the formula of a part.
    #[inline]
    pub fn to_celsius(self, part: &Part) -> f32 {
        let temperature = part.temperature;
        f32::from(self.0) * temperature.celsius_per_count + temperature.celsius_at_zero
    }
}

#[inline]
fn scale([x, y, z]: [i16; 3], per_count: f32) -> Vector3 {
    Vector3::new(f32::from(x), f32::from(y), f32::from(z)).scale(per_count)
}

#[inline]
fn is_saturated([x, y, z]: [i16; 3]) -> bool {
    let largest = x.unsigned_abs().max(y.unsigned_abs()).max(z.unsigned_abs());
    largest >= i16::MAX.unsigned_abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mpu6050::PARTS;
    use crate::units::STANDARD_GRAVITY_M_S2;

    const BYTES: [u8; BURST_LENGTH] = [
        0x08, 0x00, // 2048
        0xF8, 0x00, // -2048
        0x00, 0x01, // 1
        0xFE, 0xAC, // -340
        0x00, 0xA4, // 164
        0xFF, 0x5C, // -164
        0x80, 0x00, // -32768
    ];

    #[test]
    fn bytes_are_big_endian_in_register_order() {
        let sample = RawSample::decode(&BYTES);
        assert_eq!(sample.accelerometer.0, [2048, -2048, 1]);
        assert_eq!(sample.temperature.0, -340);
        assert_eq!(sample.gyroscope.0, [164, -164, -32768]);
        assert_eq!(sample.encode(), BYTES);
    }

    #[test]
    fn counts_become_si() {
        let sample = RawSample::decode(&BYTES);
        let force = sample.accelerometer.to_m_s2(AccelerometerRange::G16);
        assert_eq!(force.x, STANDARD_GRAVITY_M_S2);
        assert_eq!(force.y, -STANDARD_GRAVITY_M_S2);
        let rate = sample.gyroscope.to_rad_s(GyroscopeRange::Degrees2000);
        assert!((rate.x.to_degrees() - 10.0).abs() < 1e-5);
        assert!((rate.y.to_degrees() + 10.0).abs() < 1e-5);
    }

    #[test]
    fn temperature_follows_the_part() {
        let expected = [
            (0x68, 1000, 39.471),
            (0x70, 1000, 23.995),
            (0x71, -3338, 11.002),
            (0x72, -340, 35.53),
            (0x73, 0, 21.0),
            (0x98, 1000, 28.0),
        ];
        assert_eq!(expected.len(), PARTS.len());
        for (who_am_i, counts, celsius) in expected {
            let part = Part::from_who_am_i(who_am_i).expect("in the table");
            let got = TemperatureCounts(counts).to_celsius(part);
            assert!((got - celsius).abs() < 1e-3, "{}: {got}", part.name);
        }
    }

    #[test]
    fn full_scale_is_saturation_on_any_axis_and_sign() {
        for axis in 0..3 {
            for (count, saturated) in [
                (32767, true),
                (-32767, true),
                (-32768, true),
                (32766, false),
                (-32766, false),
            ] {
                let mut counts = [0; 3];
                counts[axis] = count;
                assert_eq!(AccelerometerCounts(counts).is_saturated(), saturated);
                assert_eq!(GyroscopeCounts(counts).is_saturated(), saturated);
            }
        }
    }
}
