//! The chip: registers, clock, signal path, interrupt and bus put together.
//!
//! Time is the caller's, in nanoseconds since power-up, and must not decrease. Nothing happens
//! between calls: every call first brings the chip up to its time, and [`Sensor::next_event_ns`]
//! says when to call again at the latest.

use super::bus::{Burst, Bus, DataRegisters};
use super::clock::{ClockErrors, SampleClock, TICKS_PER_SECOND};
use super::errors::SensorErrors;
use super::identity::Identity;
use super::interrupt::{Interrupt, PinLevel};
use super::registers::{DATA_LENGTH, RegisterFile, address, writable_bits};
use super::signal_path::{Settings, SignalPath};
use crate::motion::{Motion, Mount, Quaternion, Truth};
use crate::random::Random;

/// PWR_MGMT_1 (register map r4.2, section 4.28).
const DEVICE_RESET: u8 = 1 << 7;
const SLEEP: u8 = 1 << 6;
const CYCLE: u8 = 1 << 5;
const TEMPERATURE_DISABLE: u8 = 1 << 3;
const CLOCK_SELECT: u8 = 0x07;

/// USER_CTRL: reset of the signal paths and of the data registers (section 4.27).
const SIGNAL_CONDITION_RESET: u8 = 1 << 0;

/// USER_CTRL: the chip is the controller of the auxiliary bus (section 4.27).
const MASTER_ENABLE: u8 = 1 << 5;

/// INT_PIN_CFG: the auxiliary bus is connected to the main one (section 4.14).
const BYPASS_ENABLE: u8 = 1 << 1;

/// SIGNAL_PATH_RESET (section 4.26).
const GYROSCOPE_RESET: u8 = 1 << 2;
const ACCELEROMETER_RESET: u8 = 1 << 1;

/// Time from a signal path reset until the path works again: the wait that the register map asks
/// for (section 4.28). It states none for the reset by USER_CTRL, which resets the same paths.
const SIGNAL_PATH_RESET_NS: u64 = 100_000_000;

/// INT_ENABLE and INT_STATUS: data ready.
const DATA_READY: u8 = 1 << 0;

/// Wake-up frequencies by LP_WAKE_CTRL, Hz (section 4.29).
const WAKE_UP_HZ: [f64; 4] = [1.25, 5.0, 20.0, 40.0];

/// The chip: its identity, mount and errors.
#[derive(Clone, Debug)]
pub struct SensorConfig {
    /// Seeds the noise.
    pub seed: u64,
    /// 7-bit bus address: 0x68, or 0x69 with AD0 high.
    pub address: u8,
    /// The value of WHO_AM_I, which decides the part's other traits too; see [`Identity`].
    pub who_am_i: u8,
    /// Orientation of the chip on the body.
    pub mount: Mount,
    /// The chip's errors.
    pub errors: SensorErrors,
    /// Errors of its clocks.
    pub clock: ClockErrors,
    /// From power-up, or DEVICE_RESET, until the registers can be used; the chip does not
    /// acknowledge before.
    pub start_up_ns: u64,
    /// True if the low-pass filter works. A recording has passed its own sensor's filter already.
    pub filtered: bool,
    /// True if it has a self-test with factory trim; many clones do not.
    pub has_self_test: bool,
}

impl SensorConfig {
    /// A new chip for a simulated motion: an MPU-6050 at 0x68, face up, with typical errors.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            address: 0x68,
            who_am_i: 0x68,
            mount: Mount::default(),
            errors: SensorErrors::typical(seed),
            clock: ClockErrors::draw(seed),
            // Drivers are told to wait 100 ms after a reset; how much of it a chip needs is its own
            // affair.
            start_up_ns: Random::new(seed, "sensor start-up").uniform(20e6, 90e6) as u64,
            filtered: true,
            has_self_test: true,
        }
    }

    /// A chip that adds only its clock and its registers' resolution and range, for motion that a
    /// sensor has recorded.
    #[must_use]
    pub fn for_recording(seed: u64) -> Self {
        Self {
            errors: SensorErrors::none(),
            filtered: false,
            ..Self::new(seed)
        }
    }
}

/// The INT pin went from inactive to active because a sample was ready.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DataReady {
    /// Counts from zero at power-up.
    pub index: u64,
    /// The instant of the edge, ns since power-up.
    pub time_ns: u64,
    /// The true motion at that instant.
    pub truth: Truth,
}

/// A fault of the data registers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutputFault {
    /// All registers keep their values.
    Frozen,
    /// All registers read the given byte.
    All(u8),
    /// One axis reads positive full scale: 0 to 2 are the accelerometer's, 3 to 5 the gyroscope's.
    FullScale(usize),
    /// One axis keeps its value, numbered as for [`OutputFault::FullScale`].
    Stuck(usize),
    /// The temperature reads the given value, in °C.
    Temperature(f64),
}

/// A modelled chip.
pub struct Sensor {
    config: SensorConfig,
    identity: Identity,
    motion: Box<dyn Motion>,
    now_ns: u64,
    /// The registers cannot be used before this time.
    ready_at_ns: Option<u64>,
    registers: RegisterFile,
    /// `None` while nothing samples.
    clock: Option<SampleClock>,
    woken_at_ns: u64,
    path: SignalPath,
    /// End of the last reset of the gyroscope's path, and of the accelerometer's.
    paths_ready_ns: [u64; 2],
    interrupt: Interrupt,
    bus: Bus,
    /// The chip's own data registers, renewed by every sample.
    internal: DataRegisters,
    /// The data registers as the bus reads them: held still during a transaction (sections 4.17 to
    /// 4.19).
    visible: DataRegisters,
    edges: Vec<DataReady>,
    edge_count: u64,
    bursts: Vec<Burst>,
    output_faults: Vec<OutputFault>,
    truth: Truth,
}

impl Sensor {
    /// A chip that is powered up at time zero and feels `motion`.
    #[must_use]
    pub fn new(config: SensorConfig, motion: Box<dyn Motion>) -> Self {
        let identity = Identity::of(config.who_am_i);
        let reset = RegisterFile::at_reset(identity.who_am_i, identity.power_management_1, [0; 4]);
        let settings = Settings::of(&reset, &identity);
        let mut path =
            SignalPath::new(config.seed, config.mount, config.errors, identity, settings);
        if !config.has_self_test {
            path = path.without_self_test();
        }
        let mut sensor = Self {
            identity,
            motion,
            now_ns: 0,
            ready_at_ns: None,
            registers: reset,
            clock: None,
            woken_at_ns: 0,
            path,
            paths_ready_ns: [0; 2],
            interrupt: Interrupt::default(),
            bus: Bus::default(),
            internal: DataRegisters::default(),
            visible: DataRegisters::default(),
            edges: Vec::new(),
            edge_count: 0,
            bursts: Vec::new(),
            output_faults: Vec::new(),
            truth: Truth::at_rest(Quaternion::IDENTITY),
            config,
        };
        sensor.power_up(0);
        sensor
    }

    /// The supply comes (back) at `now_ns`: everything as after DEVICE_RESET.
    pub fn power_up(&mut self, now_ns: u64) {
        self.advance_to(now_ns);
        self.registers = RegisterFile::at_reset(
            self.identity.who_am_i,
            self.identity.power_management_1,
            self.path.self_test_trims(),
        );
        self.ready_at_ns = Some(self.now_ns + self.config.start_up_ns);
        self.clock = None;
        self.interrupt = Interrupt::default();
        self.bus = Bus::default();
        self.internal = DataRegisters::default();
        self.visible = DataRegisters::default();
        self.path
            .configure(Settings::of(&self.registers, &self.identity));
        self.path.reset();
        self.paths_ready_ns = [0; 2];
    }

    /// From now on time runs by another clock, which is off by `error`, as a share: +0.01 runs 1 %
    /// fast. The chip's own clocks are then off by as much the other way.
    pub fn change_time(&mut self, now_ns: u64, error: f64) {
        self.advance_to(now_ns);
        let seen = |own: f64| (1.0 + own) / (1.0 + error) - 1.0;
        let clock = &mut self.config.clock;
        clock.gyroscope = seen(clock.gyroscope);
        clock.internal = seen(clock.internal);
        self.restart_clock(false);
    }

    /// A start or repeated start condition with a 7-bit address and a direction. Returns the
    /// acknowledge.
    pub fn start(&mut self, now_ns: u64, address: u8, read: bool) -> bool {
        self.advance_to(now_ns);
        if address != self.config.address || self.ready_at_ns.is_some() {
            self.release_bus();
            return false;
        }
        self.bus.start(read);
        true
    }

    /// A byte from the controller: the register pointer first, then values. Returns the
    /// acknowledge.
    pub fn write(&mut self, now_ns: u64, byte: u8) -> bool {
        self.advance_to(now_ns);
        if self.ready_at_ns.is_some() {
            return false;
        }
        if self.bus.pointer_expected {
            self.bus.pointer_expected = false;
            self.bus.pointer = byte;
        } else {
            let register = self.bus.pointer;
            self.bus.advance_pointer();
            self.write_register(register, byte);
        }
        true
    }

    /// A byte to the controller. The bus reads all ones from a chip that is not there.
    pub fn read(&mut self, now_ns: u64) -> u8 {
        self.advance_to(now_ns);
        if self.ready_at_ns.is_some() || !self.bus.busy {
            return 0xFF;
        }
        let register = self.bus.pointer;
        self.bus.advance_pointer();
        let value = self.read_register(register);
        self.interrupt
            .register_read(register == address::INT_STATUS);
        if let Some(bytes) = self.bus.delivered(register, value) {
            self.bursts.push(Burst {
                edge: self.visible.edge,
                bytes,
                completed_ns: self.now_ns,
            });
        }
        value
    }

    /// A stop condition.
    pub fn stop(&mut self, now_ns: u64) {
        self.advance_to(now_ns);
        self.release_bus();
    }

    /// The time of the next event that is visible outside: end of a reset, sample, end of an
    /// interrupt pulse.
    #[must_use]
    pub fn next_event_ns(&self) -> Option<u64> {
        let sample = self.clock.map(|clock| {
            clock
                .instant_ns((clock.ticks() / self.ticks_per_sample() + 1) * self.ticks_per_sample())
        });
        let pulse_end = self.interrupt.pulse_end_ns(self.now_ns);
        [self.ready_at_ns, sample, pulse_end]
            .into_iter()
            .flatten()
            .min()
    }

    /// The time that the chip has been brought up to, ns since power-up.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }

    /// End of the time in which the registers cannot be used; `None` if they can.
    #[must_use]
    pub fn ready_at_ns(&self) -> Option<u64> {
        self.ready_at_ns
    }

    /// The value of a register, as a look inside the chip shows it.
    #[must_use]
    pub fn register(&self, register: u8) -> u8 {
        self.read_register(register)
    }

    /// Changes a register without a transfer on the bus. The bit that starts a reset is left out.
    pub fn corrupt_register(&mut self, now_ns: u64, register: u8, value: u8) {
        self.advance_to(now_ns);
        let is_trigger = register == address::PWR_MGMT_1;
        self.write_register(
            register,
            if is_trigger {
                value & !DEVICE_RESET
            } else {
                value
            },
        );
    }

    /// Sets the faults of the data registers, from the next sample on.
    pub fn set_output_faults(&mut self, faults: Vec<OutputFault>) {
        self.output_faults = faults;
    }

    /// Brings the chip up to `now_ns`.
    pub fn advance_to(&mut self, now_ns: u64) {
        if let Some(ready_at_ns) = self
            .ready_at_ns
            .filter(|&ready_at_ns| ready_at_ns <= now_ns)
        {
            self.now_ns = self.now_ns.max(ready_at_ns);
            self.ready_at_ns = None;
            self.restart_clock(true);
        }
        while let Some(instant_ns) = self
            .clock
            .as_mut()
            .and_then(|clock| clock.take_tick(now_ns))
        {
            self.now_ns = instant_ns;
            self.tick();
        }
        self.now_ns = self.now_ns.max(now_ns);
    }

    /// Returns how the INT pin drives its wire.
    #[must_use]
    pub fn interrupt_pin(&self) -> PinLevel {
        self.interrupt.pin(self.now_ns)
    }

    /// Returns true if the auxiliary bus is connected to the main one: BYPASS_EN without
    /// I2C_MST_EN (sections 4.14 and 4.27).
    #[must_use]
    pub fn has_bypass(&self) -> bool {
        let is_awake = self.ready_at_ns.is_none();
        is_awake
            && self.registers.get(address::INT_PIN_CFG) & BYPASS_ENABLE != 0
            && self.registers.get(address::USER_CTRL) & MASTER_ENABLE == 0
    }

    /// The motion at the last tick of the chip's clock; level and at rest before the first.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.truth
    }

    /// The level of the INT wire, which has no pull-up: released counts as low.
    #[must_use]
    pub fn interrupt_level(&self) -> bool {
        self.interrupt_pin() == PinLevel::High
    }

    /// Takes out the data-ready edges since the last call.
    pub fn take_edges(&mut self) -> Vec<DataReady> {
        std::mem::take(&mut self.edges)
    }

    /// Takes out the bursts that the bus has delivered since the last call.
    pub fn take_bursts(&mut self) -> Vec<Burst> {
        std::mem::take(&mut self.bursts)
    }

    /// One tick of the internal grid, at `self.now_ns`.
    fn tick(&mut self) {
        let Some(clock) = self.clock else { return };
        let is_sample = clock.ticks().is_multiple_of(self.ticks_per_sample());
        if self.is_cycling() || !self.config.filtered {
            if !is_sample {
                return;
            }
            let truth = self.motion.at(self.now_ns as f64 * 1e-9);
            self.truth = truth;
            self.path.convert_unfiltered(&truth, self.awake_s());
            self.publish(truth);
        } else {
            let truth = self.motion.at(self.now_ns as f64 * 1e-9);
            self.truth = truth;
            // The accelerometer's output rate is 1 kHz (section 4.2).
            self.path
                .convert(&truth, self.awake_s(), clock.ticks().is_multiple_of(8));
            self.hold_paths();
            if is_sample {
                self.publish(truth);
            }
        }
    }

    /// Keeps the paths empty whose reset goes on.
    fn hold_paths(&mut self) {
        let [gyroscope, accelerometer] = self.paths_ready_ns;
        if self.now_ns < gyroscope {
            self.path.reset_gyroscope();
        }
        if self.now_ns < accelerometer {
            self.path.reset_accelerometer();
        }
    }

    /// Puts a sample into the data registers and raises the interrupt. While a path is in reset
    /// there is none.
    fn publish(&mut self, truth: Truth) {
        if self
            .paths_ready_ns
            .iter()
            .any(|&end_ns| self.now_ns < end_ns)
        {
            return;
        }
        let before = self.internal.bytes;
        let counts = self.path.counts();
        let standby = self.registers.get(address::PWR_MGMT_2);
        // STBY_XA is bit 5, STBY_ZG bit 0. What does not measure keeps its last value.
        for axis in 0..3 {
            if standby & (0x20 >> axis) == 0 {
                self.internal.put(2 * axis, counts.accelerometer[axis]);
            }
            if standby & (0x04 >> axis) == 0 {
                self.internal.put(8 + 2 * axis, counts.gyroscope[axis]);
            }
        }
        if self.registers.get(address::PWR_MGMT_1) & TEMPERATURE_DISABLE == 0 {
            self.internal.put(6, counts.temperature);
        }
        self.apply_output_faults(before);
        self.internal.edge = None;
        if self.registers.get(address::INT_ENABLE) & DATA_READY != 0
            && self.interrupt.raise(self.now_ns)
        {
            self.internal.edge = Some(self.edge_count);
            self.edges.push(DataReady {
                index: self.edge_count,
                time_ns: self.now_ns,
                truth,
            });
            self.edge_count += 1;
        }
        self.show_data();
    }

    /// Shows the data registers to an idle bus.
    fn show_data(&mut self) {
        if !self.bus.busy {
            self.visible = self.internal;
        }
    }

    /// Applies the output faults to the data registers, which held `before` until now.
    fn apply_output_faults(&mut self, before: [u8; DATA_LENGTH]) {
        for fault in &self.output_faults {
            match *fault {
                OutputFault::Frozen => self.internal.bytes = before,
                OutputFault::All(byte) => self.internal.bytes = [byte; DATA_LENGTH],
                OutputFault::FullScale(axis) => self.internal.put(place_of(axis), i16::MAX),
                OutputFault::Stuck(axis) => {
                    let place = place_of(axis);
                    let counts = i16::from_be_bytes([before[place], before[place + 1]]);
                    self.internal.put(place, counts);
                }
                OutputFault::Temperature(celsius) => {
                    let warmer = celsius - self.identity.temperature_zero_c;
                    let counts = (warmer * self.identity.temperature_lsb_per_c).round();
                    self.internal.put(6, counts as i16);
                }
            }
        }
    }

    fn read_register(&self, register: u8) -> u8 {
        match register {
            address::ACCEL_XOUT_H..=address::GYRO_ZOUT_L => {
                self.visible.bytes[usize::from(register - address::ACCEL_XOUT_H)]
            }
            address::INT_STATUS => u8::from(self.interrupt.status()) * DATA_READY,
            _ => self.registers.get(register),
        }
    }

    fn write_register(&mut self, register: u8, value: u8) {
        let writable = writable_bits(register) | self.identity.additional_writable_bits(register);
        let before = self.registers.get(register);
        self.registers.write(register, value, writable);
        let changed = before ^ self.registers.get(register);
        match register {
            address::PWR_MGMT_1 if value & DEVICE_RESET != 0 => self.power_up(self.now_ns),
            address::PWR_MGMT_1 if changed & (SLEEP | CYCLE | CLOCK_SELECT) != 0 => {
                self.restart_clock(changed & SLEEP != 0);
            }
            address::PWR_MGMT_2 if changed & 0xC0 != 0 && self.is_cycling() => {
                self.restart_clock(false);
            }
            address::INT_PIN_CFG => self.interrupt.configuration = self.registers.get(register),
            address::SIGNAL_PATH_RESET => {
                let [gyroscope, accelerometer] = &mut self.paths_ready_ns;
                let end_ns = self.now_ns + SIGNAL_PATH_RESET_NS;
                if value & GYROSCOPE_RESET != 0 {
                    *gyroscope = end_ns;
                }
                if value & ACCELEROMETER_RESET != 0 {
                    *accelerometer = end_ns;
                }
                self.hold_paths();
            }
            address::USER_CTRL if value & SIGNAL_CONDITION_RESET != 0 => {
                self.paths_ready_ns = [self.now_ns + SIGNAL_PATH_RESET_NS; 2];
                self.hold_paths();
                self.internal = DataRegisters::default();
                self.show_data();
            }
            _ => {}
        }
        self.path
            .configure(Settings::of(&self.registers, &self.identity));
    }

    fn release_bus(&mut self) {
        self.bus.release();
        self.show_data();
    }

    /// Starts the sampling grid anew at this instant, or stops it, as the power registers require.
    fn restart_clock(&mut self, woken: bool) {
        let power = self.registers.get(address::PWR_MGMT_1);
        let error = self.config.clock.of_source(power & CLOCK_SELECT);
        self.clock = error.filter(|_| power & SLEEP == 0).map(|error| {
            let tick_s = if power & CYCLE != 0 {
                let wake_up = self.registers.get(address::PWR_MGMT_2) >> 6;
                1.0 / WAKE_UP_HZ[usize::from(wake_up)]
            } else {
                1.0 / TICKS_PER_SECOND
            };
            SampleClock::new(self.now_ns, tick_s, error)
        });
        if woken {
            self.woken_at_ns = self.now_ns;
            self.path.reset();
        }
    }

    fn is_cycling(&self) -> bool {
        self.registers.get(address::PWR_MGMT_1) & CYCLE != 0
    }

    fn awake_s(&self) -> f64 {
        (self.now_ns - self.woken_at_ns) as f64 * 1e-9
    }

    /// Sample rate = gyroscope output rate / (1 + SMPLRT_DIV), the former 8 kHz without filter,
    /// else 1 kHz (section 4.2). The MPU-6500 family divides only what has passed the filter
    /// (RM-MPU-6500A r2.1, section 4.4). Its 32 kHz past the filter are the grid's 8 kHz here.
    fn ticks_per_sample(&self) -> u64 {
        if self.is_cycling() {
            return 1;
        }
        let is_filtered = !matches!(self.registers.get(address::CONFIG) & 7, 0 | 7)
            && !self.identity.bypasses_gyroscope_filter(&self.registers);
        let divider = 1 + u64::from(self.registers.get(address::SMPLRT_DIV));
        match (is_filtered, self.identity.divides_unfiltered) {
            (true, _) => 8 * divider,
            (false, true) => divider,
            (false, false) => 1,
        }
    }
}

/// Place of an axis among the data registers: the temperature lies between the two sensors.
fn place_of(axis: usize) -> usize {
    2 * if axis < 3 { axis } else { axis + 1 }
}
