//! From the motion to the converters' counts: errors, noise, saturation, low-pass filter,
//! quantisation.

use super::errors::SensorErrors;
use super::identity::Identity;
use super::low_pass::{LowPass, Response};
use super::registers::{RegisterFile, address};
use crate::motion::geometry::add;
use crate::motion::truth::STANDARD_GRAVITY_M_S2;
use crate::motion::{Mount, Truth, Vector};
use crate::random::Random;
use crate::sensor::clock::TICKS_PER_SECOND;

/// Nominal spacing of the converters' samples.
const TICK_S: f64 = 1.0 / TICKS_PER_SECOND;

/// The settings of the signal path, from the registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// FS_SEL, 0 to 3.
    pub gyroscope_range: u8,
    /// AFS_SEL, 0 to 3.
    pub accelerometer_range: u8,
    /// The gyroscope's filter setting, 0 to 7.
    pub gyroscope_filter: u8,
    /// The accelerometer's filter setting, 0 to 7.
    pub accelerometer_filter: u8,
    /// Self-test switched on for each axis.
    pub gyroscope_self_test: [bool; 3],
    /// Self-test switched on for each axis.
    pub accelerometer_self_test: [bool; 3],
}

/// The widest setting of the MPU-6500 family's gyroscope, 3600 Hz, as past the filter with
/// FCHOICE_B = 2 (RM-MPU-6500A r2.1, section 4.5).
const UNFILTERED: u8 = 7;

impl Settings {
    /// Reads the settings of the signal path from the registers.
    #[must_use]
    pub fn of(registers: &RegisterFile, identity: &Identity) -> Self {
        let gyroscope = registers.get(address::GYRO_CONFIG);
        let accelerometer = registers.get(address::ACCEL_CONFIG);
        // Self-test of X is bit 7, of Z bit 5; the full scale is in bits 4:3.
        let self_test = |register: u8| [0, 1, 2].map(|axis| register & (0x80 >> axis) != 0);
        let gyroscope_filter = if identity.bypasses_gyroscope_filter(registers) {
            UNFILTERED
        } else {
            registers.get(address::CONFIG) & 7
        };
        Self {
            gyroscope_range: gyroscope >> 3 & 3,
            accelerometer_range: accelerometer >> 3 & 3,
            gyroscope_filter,
            accelerometer_filter: registers.get(identity.accelerometer_filter_register) & 7,
            gyroscope_self_test: self_test(gyroscope),
            accelerometer_self_test: self_test(accelerometer),
        }
    }
}

/// The deflection that each axis's self-test makes, as the chip was measured at the factory.
#[derive(Clone, Copy, Debug)]
pub struct SelfTest {
    /// SELF_TEST_X, _Y, _Z and _A (register map r4.2, section 4.1).
    pub trims: [u8; 4],
    /// rad/s.
    gyroscope: Vector,
    /// m/s².
    accelerometer: Vector,
}

/// Trim codes of a typical chip, 5 bits each.
const GYROSCOPE_TRIM_CODES: [u8; 3] = [11, 14, 12];
const ACCELEROMETER_TRIM_CODES: [u8; 3] = [15, 17, 13];

impl SelfTest {
    /// A chip that has none.
    pub const NONE: Self = Self {
        trims: [0; 4],
        gyroscope: [0.0; 3],
        accelerometer: [0.0; 3],
    };

    /// The response drawn within the datasheet's ±14 % of the factory's, with room left for noise.
    #[must_use]
    pub fn typical(seed: u64) -> Self {
        let mut random = Random::new(seed, "self-test");
        let mut aged = |value: f64| value * (1.0 + random.within_tolerance(0.03, 0.10));
        // Factory trim (register map r4.2, section 4.1): 25·1.046^(c−1) °/s, Y negative.
        let gyroscope = [0, 1, 2].map(|axis| {
            let sign = if axis == 1 { -1.0 } else { 1.0 };
            let code = f64::from(GYROSCOPE_TRIM_CODES[axis]);
            aged(sign * 25.0_f64.to_radians() * libm::pow(1.046, code - 1.0))
        });
        // For the accelerometer: 0.34·(0.92/0.34)^((c−1)/30) g.
        let accelerometer = ACCELEROMETER_TRIM_CODES.map(|code| {
            aged(
                STANDARD_GRAVITY_M_S2
                    * 0.34
                    * libm::pow(0.92 / 0.34, (f64::from(code) - 1.0) / 30.0),
            )
        });
        let [x, y, z] = ACCELEROMETER_TRIM_CODES;
        let upper = [0, 1, 2]
            .map(|axis| (ACCELEROMETER_TRIM_CODES[axis] >> 2) << 5 | GYROSCOPE_TRIM_CODES[axis]);
        let lower = (x & 3) << 4 | (y & 3) << 2 | (z & 3);
        Self {
            trims: [upper[0], upper[1], upper[2], lower],
            gyroscope,
            accelerometer,
        }
    }
}

/// One sample as the registers hold it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// X, Y, Z.
    pub accelerometer: [i16; 3],
    /// By the part's own formula.
    pub temperature: i16,
    /// X, Y, Z.
    pub gyroscope: [i16; 3],
}

/// The analogue and digital path of one chip.
#[derive(Clone, Debug)]
pub struct SignalPath {
    mount: Mount,
    errors: SensorErrors,
    self_test: SelfTest,
    identity: Identity,
    settings: Settings,
    noise: Random,
    gyroscope: Channel,
    accelerometer: Channel,
    chip_temperature_c: f64,
}

/// Three axes of one kind.
#[derive(Clone, Debug)]
struct Channel {
    filter: LowPass,
    /// Standard deviation of the noise of one tick, in the sensor's unit.
    noise_per_tick: f64,
    /// Counts per unit at the selected range.
    counts_per_unit: f64,
    /// The last converted input, before the filter.
    input: Vector,
    /// The value for the registers, in the sensor's unit.
    output: Vector,
}

impl SignalPath {
    /// The path of a chip that has just been powered, at rest at zero.
    #[must_use]
    pub fn new(
        seed: u64,
        mount: Mount,
        errors: SensorErrors,
        identity: Identity,
        settings: Settings,
    ) -> Self {
        let gyroscope_filter =
            identity.gyroscope_filters[usize::from(settings.gyroscope_filter & 7)];
        let accelerometer_filter =
            identity.accelerometer_filters[usize::from(settings.accelerometer_filter & 7)];
        let mut path = Self {
            mount,
            errors,
            self_test: SelfTest::typical(seed),
            identity,
            settings,
            noise: Random::new(seed, "sensor noise"),
            gyroscope: Channel::new(gyroscope_filter, errors.gyroscope.noise_density),
            accelerometer: Channel::new(accelerometer_filter, errors.accelerometer.noise_density),
            chip_temperature_c: 0.0,
        };
        path.set_ranges();
        path
    }

    /// Removes the self-test, as in some clones: no trim codes, and nothing deflects.
    #[must_use]
    pub fn without_self_test(mut self) -> Self {
        self.self_test = SelfTest::NONE;
        self
    }

    /// The factory's trim codes, for the register file.
    #[must_use]
    pub fn self_test_trims(&self) -> [u8; 4] {
        self.self_test.trims
    }

    /// Takes over new settings. A changed filter starts settled on the last input.
    pub fn configure(&mut self, settings: Settings) {
        let before = std::mem::replace(&mut self.settings, settings);
        self.set_ranges();
        let identity = &self.identity;
        if settings.gyroscope_filter != before.gyroscope_filter {
            let filter = usize::from(settings.gyroscope_filter & 7);
            self.gyroscope
                .change_filter(identity.gyroscope_filters[filter]);
        }
        if settings.accelerometer_filter != before.accelerometer_filter {
            let filter = usize::from(settings.accelerometer_filter & 7);
            self.accelerometer
                .change_filter(identity.accelerometer_filters[filter]);
        }
    }

    /// Clears converters and filters, as a signal path reset does (register map r4.2, section
    /// 4.26).
    pub fn reset(&mut self) {
        self.reset_gyroscope();
        self.reset_accelerometer();
    }

    /// Clears the gyroscope's converters and filters.
    pub fn reset_gyroscope(&mut self) {
        self.gyroscope.reset();
    }

    /// Clears the accelerometer's converters and filters.
    pub fn reset_accelerometer(&mut self) {
        self.accelerometer.reset();
    }

    /// Converts one instant and filters it. The accelerometer's output register moves only if
    /// `accelerometer_due`.
    pub fn convert(&mut self, truth: &Truth, awake_s: f64, accelerometer_due: bool) {
        self.sense(truth, awake_s);
        self.gyroscope.output = self.gyroscope.filter.update(self.gyroscope.input);
        let filtered = self.accelerometer.filter.update(self.accelerometer.input);
        if accelerometer_due {
            self.accelerometer.output = filtered;
        }
    }

    /// Converts one instant past the filters.
    pub fn convert_unfiltered(&mut self, truth: &Truth, awake_s: f64) {
        self.sense(truth, awake_s);
        self.gyroscope.output = self.gyroscope.input;
        self.accelerometer.output = self.accelerometer.input;
    }

    /// The outputs as counts at the selected ranges.
    #[must_use]
    pub fn counts(&self) -> Counts {
        let warmer = self.chip_temperature_c - self.identity.temperature_zero_c;
        Counts {
            accelerometer: self.accelerometer.counts(),
            temperature: to_count(warmer * self.identity.temperature_lsb_per_c),
            gyroscope: self.gyroscope.counts(),
        }
    }

    fn sense(&mut self, truth: &Truth, awake_s: f64) {
        let force = self.mount.to_sensor(truth.specific_force_m_s2);
        let rates = self.mount.to_sensor(truth.body_rates_rad_s);
        self.chip_temperature_c = self.errors.chip_temperature_c(truth.temperature_c, awake_s);
        let felt_force = self
            .errors
            .distort_specific_force(force, self.chip_temperature_c);
        let felt_rates = self
            .errors
            .distort_rates(rates, force, self.chip_temperature_c, awake_s);
        let tested = |on: [bool; 3], deflection: Vector| {
            [0, 1, 2].map(|axis| if on[axis] { deflection[axis] } else { 0.0 })
        };
        let force_test = tested(
            self.settings.accelerometer_self_test,
            self.self_test.accelerometer,
        );
        let rate_test = tested(self.settings.gyroscope_self_test, self.self_test.gyroscope);
        self.accelerometer
            .sample(add(felt_force, force_test), &mut self.noise);
        self.gyroscope
            .sample(add(felt_rates, rate_test), &mut self.noise);
    }

    fn set_ranges(&mut self) {
        // 131, 65.5, 32.8 and 16.4 LSB/(°/s); 16384 to 2048 LSB/g (product specification r3.4,
        // sections 6.1 and 6.2).
        let per_degree_s =
            [131.0, 65.5, 32.8, 16.4][usize::from(self.settings.gyroscope_range & 3)];
        self.gyroscope.counts_per_unit = per_degree_s * 1.0_f64.to_degrees();
        let per_g = f64::from(16384_u32 >> (self.settings.accelerometer_range & 3));
        self.accelerometer.counts_per_unit = per_g / STANDARD_GRAVITY_M_S2;
    }
}

impl Channel {
    fn new(response: Response, noise_density: f64) -> Self {
        Self {
            filter: LowPass::new(response, TICK_S),
            noise_per_tick: noise_density * (0.5 * TICKS_PER_SECOND).sqrt(),
            counts_per_unit: 1.0,
            input: [0.0; 3],
            output: [0.0; 3],
        }
    }

    fn change_filter(&mut self, response: Response) {
        self.filter = LowPass::new(response, TICK_S);
        self.filter.settle(self.input);
    }

    fn reset(&mut self) {
        self.filter.settle([0.0; 3]);
    }

    fn sample(&mut self, felt: Vector, noise: &mut Random) {
        let limit = 32768.0 / self.counts_per_unit;
        for (input, value) in self.input.iter_mut().zip(felt) {
            let disturbance = if self.noise_per_tick > 0.0 {
                self.noise_per_tick * noise.normal()
            } else {
                0.0
            };
            *input = (value + disturbance).clamp(-limit, limit);
        }
    }

    fn counts(&self) -> [i16; 3] {
        self.output
            .map(|value| to_count(value * self.counts_per_unit))
    }
}

/// The nearest count, saturated.
fn to_count(value: f64) -> i16 {
    // The conversion itself saturates.
    value.round() as i16
}
