//! Random answers on the bus: the driver ends within its time and reports errors, and a sensor that
//! it reports as configured has its settings.

use aplomb::mpu6050::registers::Register;
use aplomb::mpu6050::{
    ADDRESSES, AccelerometerRange, Config, GyroscopeRange, Mpu6050, PARTS, SettingsState,
};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{
    ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation, SevenBitAddress,
};

/// A probe takes 0.1 s, the configuration 0.23 s, the self-test 0.9 s, the reconfiguration 0.04 s.
const LONGEST_NS: u64 = 1_500_000_000;

/// Probes, configures and tests a sensor. The first byte selects the configuration, the second the
/// identity. Each other byte selects the behaviour of a transfer. Zero, or no byte, is a sensor
/// that keeps written values.
///
/// # Panics
///
/// Panics if an invariant is violated.
pub fn run(bytes: &[u8]) {
    let [settings, identity, fates @ ..] = bytes else {
        return;
    };
    let config = Config::DEFAULT
        .with_accelerometer_range(AccelerometerRange::ALL[usize::from(settings & 3)])
        .with_gyroscope_range(GyroscopeRange::ALL[usize::from(settings >> 2 & 3)]);
    let mut bus = Bus {
        registers: [0; 128],
        fates: fates.iter(),
        has_lied: false,
    };
    bus.registers[usize::from(Register::WhoAmI.address())] = *identity;
    let mut delay = Delay::default();
    match Mpu6050::probe(&mut bus, &mut delay) {
        Ok(sensor) => {
            assert!(PARTS.contains(sensor.part()) && ADDRESSES.contains(&sensor.address()));
            use_it(sensor, &config, &mut delay);
        }
        Err(failure) => {
            assert!(!failure.error.to_string().is_empty());
            let is_known = PARTS.iter().any(|part| part.who_am_i == *identity);
            let has_lied = failure.i2c.has_lied;
            assert!(!is_known || has_lied, "{}", failure.error);
        }
    }
    assert!(delay.ns <= LONGEST_NS, "{} ns", delay.ns);
}

fn use_it(mut sensor: Mpu6050<&mut Bus<'_>>, config: &Config, delay: &mut Delay) {
    if let Err(error) = sensor.configure(config, delay) {
        assert!(!error.to_string().is_empty());
    }
    match sensor.self_test(delay) {
        Ok(test) => {
            let axes = test.gyroscope.iter().chain(&test.accelerometer);
            for axis in axes {
                assert!(axis.response_counts.is_finite());
                assert!(axis.deviation().is_none_or(f32::is_finite));
            }
            assert!(!test.to_string().is_empty());
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    let configured = sensor.reconfigure(config, delay);
    let inspected = sensor.verify_config(config);
    let burst = sensor.read_burst(7);
    assert!(burst.is_err() || burst.is_ok_and(|burst| burst.captured_at_us == 7));
    if !sensor.release().has_lied {
        assert_eq!(configured, Ok(()));
        assert_eq!(inspected, Ok(SettingsState::Intact));
    }
}

/// Registers, and the behaviour of each transfer.
struct Bus<'a> {
    registers: [u8; 128],
    fates: std::slice::Iter<'a, u8>,
    /// True once a transfer has behaved differently from a sensor's.
    has_lied: bool,
}

impl ErrorType for Bus<'_> {
    type Error = ErrorKind;
}

impl I2c for Bus<'_> {
    fn transaction(
        &mut self,
        _address: SevenBitAddress,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        let fate = self.fates.next().copied().unwrap_or_default();
        self.has_lied |= fate != 0;
        match fate {
            1 => return Err(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address)),
            2 => return Err(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data)),
            3 => return Err(ErrorKind::Bus),
            _ => {}
        }
        let mut pointer = 0;
        for operation in operations {
            match operation {
                Operation::Write([register, values @ ..]) => {
                    pointer = usize::from(*register);
                    for value in values {
                        self.store(pointer, *value);
                        pointer += 1;
                    }
                }
                Operation::Write([]) => {}
                Operation::Read(values) => {
                    for value in values.iter_mut() {
                        *value = self.registers[pointer % 128] ^ fate;
                        pointer += 1;
                    }
                }
            }
        }
        Ok(())
    }
}

impl Bus<'_> {
    fn store(&mut self, register: usize, value: u8) {
        /// PWR_MGMT_1's bit that resets the sensor.
        const DEVICE_RESET: u8 = 0x80;
        let who_am_i = usize::from(Register::WhoAmI.address());
        let power = usize::from(Register::PowerManagement1.address());
        if register == power && value & DEVICE_RESET != 0 {
            let identity = self.registers[who_am_i];
            self.registers = [0; 128];
            self.registers[who_am_i] = identity;
            let part = PARTS.iter().find(|part| part.who_am_i == identity);
            self.registers[power] = part.map_or(0, |part| part.power_after_reset[0]);
        } else {
            self.registers[register % 128] = value;
        }
    }
}

/// Sum of the waits, without waiting.
#[derive(Default)]
struct Delay {
    ns: u64,
}

impl DelayNs for Delay {
    fn delay_ns(&mut self, ns: u32) {
        self.ns += u64::from(ns);
    }
}
