//! The modelled sensor on an ideal bus, with a delay on the same time.

use std::cell::RefCell;
use std::rc::Rc;

use aplomb_models::motion::Motion;
use aplomb_models::sensor::{DataReady, Sensor, SensorConfig};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{ErrorKind, ErrorType, I2c, NoAcknowledgeSource, Operation};

/// Nine bits at 400 kHz.
const BYTE_NS: u64 = 22_500;

/// The sensor and the time, shared by the bus and the delay.
#[derive(Clone)]
pub struct IdealBus(pub Rc<RefCell<(Sensor, u64)>>);

impl IdealBus {
    /// Creates a sensor with this motion, at time zero.
    pub fn new(config: SensorConfig, motion: impl Motion + 'static) -> Self {
        Self(Rc::new(RefCell::new((
            Sensor::new(config, Box::new(motion)),
            0,
        ))))
    }

    /// Returns the data-ready edges since the last call.
    pub fn take_edges(&self) -> Vec<DataReady> {
        self.0.borrow_mut().0.take_edges()
    }

    /// Lets one byte's time pass, then does something with the sensor.
    fn after_a_byte<T>(&self, action: impl FnOnce(&mut Sensor, u64) -> T) -> T {
        let (sensor, now_ns) = &mut *self.0.borrow_mut();
        *now_ns += BYTE_NS;
        action(sensor, *now_ns)
    }
}

impl DelayNs for IdealBus {
    fn delay_ns(&mut self, duration_ns: u32) {
        let (sensor, now_ns) = &mut *self.0.borrow_mut();
        *now_ns += u64::from(duration_ns);
        sensor.advance_to(*now_ns);
    }
}

impl ErrorType for IdealBus {
    type Error = ErrorKind;
}

impl I2c for IdealBus {
    fn transaction(
        &mut self,
        address: u8,
        operations: &mut [Operation<'_>],
    ) -> Result<(), ErrorKind> {
        let mut result = Ok(());
        for operation in operations {
            let read = matches!(operation, Operation::Read(_));
            let mut acknowledged =
                self.after_a_byte(|sensor, now_ns| sensor.start(now_ns, address, read));
            match operation {
                _ if !acknowledged => {}
                Operation::Read(bytes) => {
                    for byte in bytes.iter_mut() {
                        *byte = self.after_a_byte(Sensor::read);
                    }
                }
                Operation::Write(bytes) => {
                    for &byte in *bytes {
                        acknowledged &=
                            self.after_a_byte(|sensor, now_ns| sensor.write(now_ns, byte));
                    }
                }
            }
            if !acknowledged {
                result = Err(ErrorKind::NoAcknowledge(NoAcknowledgeSource::Unknown));
                break;
            }
        }
        self.after_a_byte(Sensor::stop);
        result
    }
}
