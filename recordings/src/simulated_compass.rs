//! Simulated compass: a QMC5883L beside the simulated MPU-6050, on the same mount.
//!
//! It measures at 100 Hz with its own clock, noise, lag and range. A reading belongs to the first
//! sample after it.
//!
//! In a log, earth axes are east, magnetic north, up. So the x axis of a motion points east.

use std::f64::consts::FRAC_1_SQRT_2;

use aplomb_models::compass::{Compass, CompassConfig, Magnetism, Part};
use aplomb_models::motion::{Quaternion, Truth};

use crate::simulated::MOUNT;

/// Age of a reading against the sample of its row, µs: the compass lags by 4,000 µs, the sample
/// by 1,900 µs.
pub const COMPASS_DELAY_US: u32 = 2_100;

/// Address and registers of the chip (QST datasheet 1.0, section 9).
const ADDRESS: u8 = 0x0D;
const STATUS: u8 = 0x06;
/// Status: a reading is ready; a component was beyond the range.
const READY: u8 = 0x01;
const OVERFLOW: u8 = 0x02;
/// Control: soft reset, then pointer roll-over; the set/reset period; ±8 G at 100 Hz, continuous.
const SET_UP: [[u8; 2]; 4] = [[0x0A, 0x80], [0x0A, 0x41], [0x0B, 0x01], [0x09, 0x19]];
/// Scale at ±8 G: 3,000 counts per gauss.
const UT_PER_COUNT: f64 = 100.0 / 3_000.0;
/// Time after power-up at which the chip is set up, ns.
const SET_UP_NS: u64 = 1_000_000;

/// Earth axes of a motion in north, east, down: a quarter turn about down.
const TO_NORTH: Quaternion = Quaternion::new(FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2);

/// Compass of simulated samples.
pub struct SimulatedCompass {
    chip: Compass,
}

impl SimulatedCompass {
    /// Creates a compass in this field. The seed decides its noise.
    #[must_use]
    pub fn new(seed: u64, magnetism: Magnetism) -> Self {
        let mut chip = Compass::new(CompassConfig {
            mount: MOUNT,
            magnetism,
            ..CompassConfig::new(seed, Part::Qmc5883l)
        });
        chip.power_up(0);
        for bytes in SET_UP {
            chip.start(SET_UP_NS, ADDRESS, false);
            for byte in bytes {
                chip.write(SET_UP_NS, byte);
            }
        }
        Self { chip }
    }

    /// Returns the reading that is new at this sample, if there is one: µT in sensor axes. Times
    /// increase.
    pub fn read(&mut self, t_us: u64, truth: &Truth) -> Option<[f64; 3]> {
        let now_ns = t_us * 1_000;
        let attitude = truth.attitude.map(|attitude| TO_NORTH.multiply(attitude));
        self.chip.advance_to(now_ns, &Truth { attitude, ..*truth });
        let [status] = self.read_registers(now_ns, STATUS);
        if status & READY == 0 {
            return None;
        }
        let bytes: [u8; 6] = self.read_registers(now_ns, 0x00);
        let (axes, _) = bytes.as_chunks::<2>();
        let field_ut = [axes[0], axes[1], axes[2]]
            .map(|axis| f64::from(i16::from_le_bytes(axis)) * UT_PER_COUNT);
        (status & OVERFLOW == 0).then_some(field_ut)
    }

    fn read_registers<const N: usize>(&mut self, now_ns: u64, first: u8) -> [u8; N] {
        self.chip.start(now_ns, ADDRESS, false);
        self.chip.write(now_ns, first);
        self.chip.start(now_ns, ADDRESS, true);
        [0; N].map(|_| self.chip.read())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use aplomb_models::compass::{EarthField, PassingMagnet};

    /// Returns the readings of 2 s, level and heading east.
    fn readings(magnetism: Magnetism) -> Vec<Option<[f64; 3]>> {
        let truth = Truth::at_rest(Quaternion::IDENTITY);
        let mut compass = SimulatedCompass::new(7, magnetism);
        (1..=2_000)
            .map(|millisecond| compass.read(1_000 * millisecond, &truth))
            .collect()
    }

    #[test]
    fn a_hundred_readings_a_second_show_the_field_in_sensor_axes() {
        let found = readings(Magnetism::clean(EarthField::default()));
        let found: Vec<[f64; 3]> = found.into_iter().flatten().collect();
        assert!((195..=200).contains(&found.len()), "{}", found.len());
        // Heading east, north is to the left; the chip face up has y to the left and z up.
        let [north, _, down] = EarthField::default().magnetic_ned_ut();
        let mut largest = 0.0_f64;
        for [x, y, z] in &found {
            for error in [*x, y - north, z + down] {
                largest = largest.max(error.abs());
            }
        }
        assert!((0.2..1.0).contains(&largest), "{largest}");
    }

    #[test]
    fn a_field_beyond_the_range_gives_no_reading() {
        let magnet = PassingMagnet {
            closest_s: 10.0,
            stands: true,
            closest_m: [0.05, 0.0, 0.0],
            velocity_m_s: [0.0; 3],
            moment_a_m2: [1.0, 0.0, 0.0],
        };
        let magnetism = Magnetism {
            magnet: Some(magnet),
            ..Magnetism::clean(EarthField::default())
        };
        assert!(readings(magnetism).iter().all(Option::is_none));
    }
}
