//! The two lines of the sensor's bus, as open-drain wires: low if any device pulls them low.
//!
//! rigless transports the bytes without the lines. This module adds the lines: short circuits,
//! clock stretching, and pins that the firmware drives as outputs. A sensor that has lost count
//! within a byte holds SDA. The I2C controller ([`crate::i2c`]) and the port ([`PortB`]) both use
//! it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rigless::device::{Device, DeviceContext, Level, RegisterFile};
use rigless::soc::stm32f427::generated::gpioa::Register;
use rigless::soc::stm32f427::peripherals::gpio::{Gpio, Pin};
use rigless::time::VirtualNanos;

use crate::delegate::delegate;
use crate::faults::{BusLine, Fault, FaultKind, nanoseconds, scheduled};

/// SCL is PB8, SDA is PB9.
pub const BUS_PINS: [(BusLine, u8); 2] = [(BusLine::Clock, 8), (BusLine::Data, 9)];

/// The alternate function of I2C1 (STM32F405 datasheet, table 9).
const I2C_FUNCTION: u8 = 4;

/// The rest of a byte that the sensor sends or receives, after its controller has gone away
/// (UM10204, 3.1.16).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum LostByte {
    #[default]
    Nothing,
    /// The bits on SDA, the present one first, and how many they are.
    Sending { bits: u16, left: u8 },
    /// All bits are sent. With SDA low at the next rising edge of SCL another byte follows.
    Acknowledge,
    /// Another byte follows after the falling edge of SCL.
    Acknowledged,
    /// Bits are left of the byte that the sensor receives.
    Receiving { left: u8 },
    /// The sensor has received the byte, and will pull SDA low for the next clock.
    Received,
    /// The sensor acknowledges the byte.
    Accepting,
}

impl LostByte {
    /// Returns true if the sensor pulls SDA low.
    fn is_low(self) -> bool {
        match self {
            Self::Sending { bits, .. } => bits >> 15 == 0,
            Self::Accepting => true,
            _ => false,
        }
    }

    fn clock_falls(self) -> Self {
        match self {
            Self::Sending { left: 1, .. } => Self::Acknowledge,
            Self::Sending { bits, left } => Self::Sending {
                bits: bits << 1,
                left: left - 1,
            },
            Self::Acknowledged => Self::Sending { bits: 0, left: 8 },
            Self::Received => Self::Accepting,
            Self::Accepting => Self::Receiving { left: 8 },
            Self::Acknowledge | Self::Nothing | Self::Receiving { .. } => self,
        }
    }

    fn clock_rises(self, is_data_high: bool) -> Self {
        match self {
            Self::Acknowledge if is_data_high => Self::Nothing,
            Self::Acknowledge => Self::Acknowledged,
            Self::Receiving { left: 1 } => Self::Received,
            Self::Receiving { left } => Self::Receiving { left: left - 1 },
            _ => self,
        }
    }
}

/// The state of the lines.
#[derive(Debug, Default)]
pub struct Wires {
    /// Short circuits to ground, each with its time in ns.
    shorts: Vec<(BusLine, u64, u64)>,
    /// Times at which the sensor stretches the clock, if it is addressed.
    stretches: Vec<(u64, u64)>,
    /// End of the time in which the sensor holds SCL.
    stretched_until_ns: u64,
    /// The byte that the sensor has been left in.
    lost: LostByte,
    /// True where the firmware pulls a pin low as an output: SCL, SDA.
    driven_low: [bool; 2],
    /// The levels of the lines at the last check: SCL, SDA.
    levels: [bool; 2],
    /// Falling edges that the firmware made with the pin as an output: SCL, SDA.
    falls_made: [u32; 2],
    /// Times that a reset left the sensor waiting for a byte.
    writes_left: u32,
    /// Bytes that it then received from clocks that the firmware made by hand.
    bytes_made: u32,
    /// True if the lines have shown a STOP that the sensor has not received yet: the firmware made
    /// it with the pins as outputs, or a shorted SDA rose while SCL was high.
    has_stopped: bool,
}

/// The wires, shared by their users.
#[derive(Clone, Debug)]
pub struct SharedWires(Arc<Mutex<Wires>>);

impl SharedWires {
    /// Wires with these faults.
    #[must_use]
    pub fn new(faults: &[Fault]) -> Self {
        let mut shorts: Vec<(BusLine, u64, u64)> = faults
            .iter()
            .filter_map(|fault| match fault {
                Fault::BusHeldLow(line, range) => {
                    Some((*line, nanoseconds(range.start), nanoseconds(range.end)))
                }
                _ => None,
            })
            .collect();
        let mut stretches = Vec::new();
        for fault in scheduled(faults) {
            let (start_ns, end_ns) = (fault.start_ns, fault.end_ns());
            match fault.kind {
                FaultKind::SdaLow(None) => shorts.push((BusLine::Data, start_ns, end_ns)),
                FaultKind::SclLow => shorts.push((BusLine::Clock, start_ns, end_ns)),
                FaultKind::BurstStall => stretches.push((start_ns, end_ns)),
                _ => {}
            }
        }
        Self(Arc::new(Mutex::new(Wires {
            shorts,
            stretches,
            levels: [true; 2],
            ..Wires::default()
        })))
    }

    /// The wires, to look at and to change.
    pub fn lock(&self) -> MutexGuard<'_, Wires> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Wires {
    /// Returns true if a device other than the microcontroller pulls a line low.
    #[must_use]
    pub fn holds_low(&self, line: BusLine, now_ns: u64) -> bool {
        let is_shorted = self
            .shorts
            .iter()
            .any(|&(short, start, end)| short == line && (start..end).contains(&now_ns));
        is_shorted
            || match line {
                BusLine::Clock => now_ns < self.stretched_until_ns,
                BusLine::Data => self.lost.is_low(),
            }
    }

    /// Returns the time at which a clock that is held low now will be free, as far as is known.
    #[must_use]
    pub fn clock_free_ns(&self, now_ns: u64) -> Option<u64> {
        let shorts = self
            .shorts
            .iter()
            .filter(|&&(line, start, end)| line == BusLine::Clock && (start..end).contains(&now_ns))
            .map(|&(_, _, end)| end);
        let stretch = Some(self.stretched_until_ns).filter(|&until_ns| now_ns < until_ns);
        shorts.chain(stretch).max()
    }

    /// A byte ends on the bus. The sensor stretches the clock from here on if it is to.
    pub fn byte_ends(&mut self, now_ns: u64) {
        let stretch = self
            .stretches
            .iter()
            .find(|&&(start, end)| (start..end).contains(&now_ns));
        if let Some(&(_, end)) = stretch {
            self.stretched_until_ns = self.stretched_until_ns.max(end);
        }
    }

    /// A device holds SCL from the end of this byte, until then.
    pub fn stretch_until(&mut self, end_ns: u64) {
        self.stretched_until_ns = self.stretched_until_ns.max(end_ns);
    }

    /// Leaves the sensor in a byte that it sends: so many clocks are left of it, with these bits,
    /// the present one first. With no clock left the sensor is in no byte.
    pub fn lose_count(&mut self, clocks: u8, bits: u8) {
        self.lost = match clocks {
            0 => LostByte::Nothing,
            left => LostByte::Sending {
                bits: u16::from(bits) << 8,
                left,
            },
        };
        // The line went low with a clock of the byte, not by a START.
        self.levels[1] &= !self.lost.is_low();
    }

    /// Leaves the sensor waiting for a byte.
    pub fn leave_write(&mut self) {
        self.lost = LostByte::Receiving { left: 8 };
        self.writes_left += 1;
    }

    /// Times that a reset left the sensor waiting for a byte.
    #[must_use]
    pub fn writes_left(&self) -> u32 {
        self.writes_left
    }

    /// Bytes that it then received from clocks that the firmware made by hand.
    #[must_use]
    pub fn bytes_made(&self) -> u32 {
        self.bytes_made
    }

    /// Falling edges of SCL and of SDA that the firmware has made by hand.
    #[must_use]
    pub fn falls_made(&self) -> [u32; 2] {
        self.falls_made
    }

    /// Returns true if the lines have shown a STOP since the last call.
    pub fn take_stop(&mut self) -> bool {
        std::mem::take(&mut self.has_stopped)
    }

    /// Follows the edges as the sensor sees them, after a possible change of the pins or the lines.
    fn follow(&mut self, now_ns: u64) {
        loop {
            let before = self.levels;
            let level = |nth: usize, line| !self.driven_low[nth] && !self.holds_low(line, now_ns);
            let now = [level(0, BusLine::Clock), level(1, BusLine::Data)];
            self.levels = now;
            if before[0] && now[0] && before[1] != now[1] {
                // START or STOP: the sensor is in no byte any more.
                self.lost = LostByte::Nothing;
                self.has_stopped |= now[1];
            }
            if before[0] && !now[0] && self.driven_low[0] {
                self.falls_made[0] += 1;
                // The next bit may be another edge.
                self.lost = self.lost.clock_falls();
            }
            self.falls_made[1] += u32::from(before[1] && !now[1] && self.driven_low[1]);
            if !before[0] && now[0] {
                let lost = self.lost.clock_rises(now[1]);
                let is_new = lost == LostByte::Received && self.lost != lost;
                self.bytes_made += u32::from(is_new);
                self.lost = lost;
            }
            if before == now {
                return;
            }
        }
    }
}

/// The port with the sensor's bus on it: rigless's model, with the lines as they really are.
#[derive(Debug)]
pub struct PortB {
    /// The model of rigless.
    pub model: Gpio,
    /// The lines.
    pub wires: SharedWires,
}

impl PortB {
    /// Reads the levels that the pins drive, and puts the lines' levels on the pins.
    pub fn follow(
        &mut self,
        now: VirtualNanos,
        registers: &RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        let levels = {
            let mut wires = self.wires.lock();
            let (modes, outputs) = (registers.get(Register::Moder), registers.get(Register::Odr));
            for (nth, (_, pin)) in BUS_PINS.into_iter().enumerate() {
                let is_output = modes >> (2 * pin) & 3 == 1;
                wires.driven_low[nth] = is_output && outputs >> pin & 1 == 0;
            }
            wires.follow(now.0);
            BUS_PINS.map(|(line, _)| !wires.holds_low(line, now.0))
        };
        for ((_, pin), high) in BUS_PINS.into_iter().zip(levels) {
            if let Some(pin) = Pin::new(pin) {
                self.model
                    .drive(pin, Some(Level::from(high)), registers, context);
            }
        }
    }

    /// Returns true if both pins are connected to the I2C controller.
    #[must_use]
    pub fn is_connected(registers: &RegisterFile) -> bool {
        BUS_PINS.into_iter().all(|(_, pin)| {
            Pin::new(pin).and_then(|pin| Gpio::function(pin, registers)) == Some(I2C_FUNCTION)
        })
    }
}

impl Device for PortB {
    type Register = Register;

    delegate!(layout peek on_event on_request on_access on_refused on_clock reset reset_line);

    fn read(
        &mut self,
        register: Register,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) -> Option<u64> {
        self.follow(context.now(), registers, context);
        Device::read(&mut self.model, register, registers, context)
    }

    fn write(
        &mut self,
        register: Register,
        value: u64,
        registers: &mut RegisterFile,
        context: &mut DeviceContext<'_>,
    ) {
        Device::write(&mut self.model, register, value, registers, context);
        self.follow(context.now(), registers, context);
    }
}
