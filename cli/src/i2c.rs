//! A sensor on an I2C bus of this computer, such as a Raspberry Pi: options, bus, and edges of its
//! INT pin.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use aplomb::calibration::{Calibration, Mount};
use aplomb::mpu6050::{Burst, Config, LowPass, Part, RawSample};
use aplomb::pipeline::Settings;
use aplomb_recordings::rate::divider_of_period;
use aplomb_recordings::terminal::print_message;

use crate::calibration_file::CalibrationFile;
use crate::sampler::SensorSettings;

/// Samples a second without `--rate-hz`.
const RATE_HZ: u16 = 200;

/// Least samples a second: the sensor's divider ends at 256, so 4 is the lowest whole rate.
const LOWEST_RATE_HZ: u16 = 4;

/// Options for a sensor on a bus.
#[derive(clap::Args, Clone, Debug)]
pub struct I2cOptions {
    /// An MPU-6050 on this I2C bus of this computer, such as /dev/i2c-1 (Linux)
    #[arg(long, value_name = "DEVICE")]
    pub i2c: Option<PathBuf>,
    /// The sensor's address, 0x68 or 0x69 [default: whichever answers]
    #[arg(long, requires = "i2c", value_name = "ADDRESS", value_parser = parse_address)]
    address: Option<u8>,
    /// The GPIO line of the sensor's INT pin, such as gpiochip0:17. Without one the sensor is
    /// polled, and each attitude is flagged POLLED and DEGRADED
    #[arg(long, requires = "i2c", value_name = "CHIP:LINE")]
    interrupt: Option<String>,
    /// Samples a second of that sensor: 1000, 500, 333, 250, 200 and so on, down to 4
    #[arg(
        long,
        requires = "i2c",
        value_name = "N",
        default_value_t = RATE_HZ,
        value_parser = parse_rate
    )]
    rate_hz: u16,
    /// Mount of that sensor: the body's forward and down axes in sensor axes, such as +x-z
    #[arg(long = "sensor-mount", requires = "i2c", allow_hyphen_values = true)]
    pub mount: Option<Mount>,
    /// The calibration of accelerometer and gyroscope: what `aplomb calibrate` prints as JSON
    #[arg(long, requires = "i2c", value_name = "FILE")]
    pub calibration: Option<PathBuf>,
}

impl Default for I2cOptions {
    fn default() -> Self {
        Self {
            i2c: None,
            address: None,
            interrupt: None,
            rate_hz: RATE_HZ,
            mount: None,
            calibration: None,
        }
    }
}

fn parse_address(text: &str) -> Result<u8, &'static str> {
    match text {
        "0x68" => Ok(0x68),
        "0x69" => Ok(0x69),
        _ => Err("it is 0x68 (AD0 low) or 0x69 (AD0 high)"),
    }
}

/// Parses a rate of the sensor, which divides 1,000 samples a second by a whole number.
fn parse_rate(text: &str) -> Result<u16, String> {
    let rate: u16 = match text.parse() {
        Ok(rate @ LOWEST_RATE_HZ..=1000) => rate,
        _ => {
            return Err(format!(
                "it is a whole number from {LOWEST_RATE_HZ} to 1000"
            ));
        }
    };
    let rate_of = |divisor: u16| (1000.0 / f64::from(divisor)).round() as u16;
    // The first divisor whose rate is not above this one.
    let divisor = (1..=250).find(|divisor| rate_of(*divisor) <= rate);
    let divisor = divisor.unwrap_or(250);
    let (lower, higher) = (rate_of(divisor), rate_of(divisor.max(2) - 1));
    if lower == rate {
        return Ok(rate);
    }
    Err(format!(
        "the sensor divides 1000 by a whole number: choose {lower} or {higher}"
    ))
}

/// Returns the widest low-pass filter at this rate, Hz: its bandwidth is half the rate at most, so
/// that no vibration appears as a slow motion.
fn low_pass(rate_hz: u16) -> LowPass {
    let is_narrow = |filter: &LowPass| 2 * filter.gyroscope_bandwidth_hz() <= rate_hz;
    // The widest filter of all changes the sensor's clock, from 1 kHz to 8 kHz.
    let [_, usual @ ..] = LowPass::ALL;
    usual.into_iter().find(is_narrow).unwrap_or(LowPass::Hertz5)
}

impl I2cOptions {
    /// Returns the settings of the sensor.
    fn settings(&self) -> Result<SensorSettings, String> {
        let mut config = Config::DEFAULT;
        let period_ms = (1000.0 / f64::from(self.rate_hz)).round() as u64;
        config.sample_rate_divider = divider_of_period(1_000 * period_ms);
        config.low_pass = low_pass(self.rate_hz);
        let mut pipeline = Settings::new(&Part::MPU_6050);
        pipeline.mount = self.mount.unwrap_or(Mount::Z_UP);
        if let Some(path) = &self.calibration {
            let file = CalibrationFile::read(path)?;
            if file.sensors == Calibration::NONE {
                return Err(format!(
                    "{}: it calibrates a compass alone, and this sensor has none",
                    path.display()
                ));
            }
            pipeline.calibration = file.sensors;
        }
        Ok(SensorSettings {
            config,
            pipeline,
            address: self.address,
        })
    }
}

impl I2cOptions {
    /// Samples for so many seconds, to calibrate. Returns times, µs, counts and the configuration.
    pub fn collect(&self, seconds: u64) -> Result<(Vec<(i64, RawSample)>, Config), String> {
        let (mut sensor, config) = self.open()?;
        print_message(&format!(
            "lay the sensor on each of its six sides, then in six poses halfway between two \
             sides, 2 s in each; {seconds} s"
        ));
        let (started, duration) = (Instant::now(), Duration::from_secs(seconds));
        let mut samples = Vec::new();
        while started.elapsed() < duration {
            let burst = sensor.step()?;
            samples.extend(burst.map(|burst| {
                let raw = RawSample::decode(&burst.bytes);
                (burst.captured_at_us.cast_signed(), raw)
            }));
            // No log is kept.
            sensor.take_bytes();
        }
        Ok((samples, config))
    }
}

/// A sensor that is read sample by sample.
pub trait Sampled: Send {
    /// Waits for a sample; see [`Sampler::step`](crate::sampler::Sampler::step).
    fn step(&mut self) -> Result<Option<Burst>, String>;
    /// Configures the sensor again. Returns whether it answers.
    fn is_back(&mut self) -> bool;
    /// Returns whether the bus is too slow for the sample rate: to wait does not help.
    fn is_bus_too_slow(&self) -> bool;
    /// Returns the bytes of the flight log since the last call.
    fn take_bytes(&self) -> Vec<u8>;
    /// Writes a message into the flight log.
    fn say(&self, text: &str);
}

#[cfg(not(target_os = "linux"))]
impl I2cOptions {
    /// Refuses: the bus of another system is not known.
    pub fn open(&self) -> Result<(Box<dyn Sampled>, Config), String> {
        self.settings()?;
        Err("--i2c needs Linux, with its devices /dev/i2c-…".into())
    }
}

#[cfg(target_os = "linux")]
mod linux {
    use std::io;
    use std::path::Path;
    use std::time::{Duration, Instant};

    use gpiocdev::Request;
    use gpiocdev::line::{EdgeDetection, EdgeEvent};
    use linux_embedded_hal::{Delay, I2cdev};
    use rustix::time::{ClockId, clock_gettime};

    use super::{Burst, Config, I2cOptions, Sampled};
    use crate::sampler::{Edge, Edges, Sampler};

    /// Longest time without an edge.
    const SILENCE: Duration = Duration::from_secs(1);

    impl I2cOptions {
        /// Opens the bus, and finds and configures the sensor. Returns its configuration too.
        ///
        /// # Errors
        ///
        /// Returns what is wrong, and the command that helps.
        pub fn open(&self) -> Result<(Box<dyn Sampled>, Config), String> {
            let settings = self.settings()?;
            let config = settings.config;
            let path = self.i2c.as_deref().unwrap_or(Path::new("/dev/i2c-1"));
            let bus = I2cdev::new(path).map_err(|error| {
                let error = io::Error::from(error);
                format!(
                    "{}: {error}: {}",
                    path.display(),
                    advice_on_bus(error.kind())
                )
            })?;
            let at_bus = |reason: String| {
                let number = bus_number(path);
                format!(
                    "{}: {reason}; `i2cdetect -y {number}` (package i2c-tools) lists what answers",
                    path.display()
                )
            };
            match &self.interrupt {
                Some(line) => {
                    let sampler = Sampler::new(bus, Delay, Pin::open(line)?, &settings);
                    Ok((Box::new(sampler.map_err(at_bus)?), config))
                }
                None => {
                    let clock = Clock::new(config.sample_rate_divider);
                    let sampler = Sampler::new(bus, Delay, clock, &settings);
                    Ok((Box::new(sampler.map_err(at_bus)?), config))
                }
            }
        }
    }

    /// Returns the number of a bus, as `i2cdetect` takes it: 11 for /dev/i2c-11. A device with
    /// another name is passed as it is.
    fn bus_number(path: &Path) -> String {
        let name = path.to_string_lossy();
        let number = name.rsplit_once('-').map(|(_, number)| number);
        let is_number = |text: &&str| text.parse::<u32>().is_ok();
        number.filter(is_number).unwrap_or(&name).to_owned()
    }

    /// Returns what helps if a bus cannot be opened.
    fn advice_on_bus(kind: io::ErrorKind) -> String {
        match kind {
            io::ErrorKind::PermissionDenied => {
                "your user may not use it: `sudo usermod -a -G i2c $USER`, then log in again".into()
            }
            io::ErrorKind::NotFound => format!(
                "there is no such bus: on a Raspberry Pi `sudo raspi-config nonint do_i2c 0` \
                 enables /dev/i2c-1. {}",
                found_buses()
            ),
            _ => "is it an I2C bus?".into(),
        }
    }

    fn found_buses() -> String {
        let entries = std::fs::read_dir("/dev").into_iter().flatten().flatten();
        let names = entries.map(|entry| entry.path().display().to_string());
        let mut buses: Vec<String> = names.filter(|name| name.starts_with("/dev/i2c-")).collect();
        buses.sort();
        if buses.is_empty() {
            "This computer has none now".into()
        } else {
            format!("There are {}", buses.join(", "))
        }
    }

    impl<E: Edges + Send> Sampled for Sampler<I2cdev, Delay, E> {
        fn step(&mut self) -> Result<Option<Burst>, String> {
            Self::step(self)
        }

        fn is_back(&mut self) -> bool {
            Self::is_back(self)
        }

        fn is_bus_too_slow(&self) -> bool {
            Self::is_bus_too_slow(self)
        }

        fn take_bytes(&self) -> Vec<u8> {
            Self::take_bytes(self)
        }

        fn say(&self, text: &str) {
            Self::say(self, text);
        }
    }

    /// Edges of a GPIO line, with the time stamps of the kernel.
    struct Pin {
        name: String,
        request: Request,
        /// Number of the last edge, by the kernel's count.
        last: Option<u32>,
        /// Edge after it, which is still to be waited for.
        next: Option<EdgeEvent>,
    }

    impl Pin {
        /// Opens a line such as gpiochip0:17.
        fn open(name: &str) -> Result<Self, String> {
            let (chip, line) = name
                .rsplit_once(':')
                .and_then(|(chip, line)| Some((chip, line.parse().ok()?)))
                .ok_or_else(|| format!("--interrupt {name}: say for instance gpiochip0:17"))?;
            let chip = Path::new("/dev").join(chip);
            let request = Request::builder()
                .on_chip(&chip)
                .with_consumer("aplomb")
                .with_line(line)
                .with_edge_detection(EdgeDetection::RisingEdge)
                .request()
                .map_err(|error| {
                    format!(
                        "{} line {line}: {error}: `gpioinfo` lists the lines; if you may not use \
                         them: `sudo usermod -a -G gpio $USER`, then log in again",
                        chip.display()
                    )
                })?;
            Ok(Self {
                name: name.to_owned(),
                request,
                last: None,
                next: None,
            })
        }

        /// Returns the next edge in the kernel's buffer, without waiting.
        fn take_edge(&self) -> Result<Option<EdgeEvent>, String> {
            let failed = |error: gpiocdev::Error| format!("{}: {error}", self.name);
            if !self.request.has_edge_event().map_err(failed)? {
                return Ok(None);
            }
            self.request.read_edge_event().map(Some).map_err(failed)
        }
    }

    impl Edges for Pin {
        fn wait(&mut self) -> Result<Edge, String> {
            let failed = |error: gpiocdev::Error| format!("{}: {error}", self.name);
            let is_here = self.next.is_some();
            if !is_here && !self.request.wait_edge_event(SILENCE).map_err(failed)? {
                return Err(format!(
                    "no edge comes on {}: is the sensor's INT pin wired to it?",
                    self.name
                ));
            }
            let mut event = match self.next.take() {
                Some(event) => event,
                None => self.request.read_edge_event().map_err(failed)?,
            };
            // The newest edge: the data registers hold its sample.
            while let Some(newer) = self.take_edge()? {
                event = newer;
            }
            // The kernel counts those too that its buffer could not hold.
            let number = event.line_seqno;
            Ok(Edge {
                time_us: event.timestamp_ns / 1_000,
                skipped: skipped(self.last.replace(number), number),
            })
        }

        fn pending_us(&mut self) -> Result<Option<u64>, String> {
            if self.next.is_none() {
                self.next = self.take_edge()?;
            }
            Ok(self.next.as_ref().map(|event| event.timestamp_ns / 1_000))
        }

        fn now_us(&self) -> u64 {
            // The kernel stamps edges by this clock.
            let now = Duration::try_from(clock_gettime(ClockId::Monotonic));
            now.unwrap_or_default().as_micros() as u64
        }

        fn is_polled(&self) -> bool {
            false
        }
    }

    /// Returns the number of edges between the last edge and this one, by their numbers. None count
    /// before the first.
    fn skipped(last: Option<u32>, number: u32) -> u32 {
        last.map_or(0, |last| number.wrapping_sub(last).saturating_sub(1))
    }

    /// Grid of times to poll at.
    struct Clock {
        started: Instant,
        period: Duration,
        next: Duration,
    }

    impl Clock {
        /// Starts a grid with the period of a sensor with this divider.
        fn new(divider: u8) -> Self {
            Self {
                started: Instant::now(),
                period: Duration::from_millis(1 + u64::from(divider)),
                next: Duration::ZERO,
            }
        }
    }

    impl Edges for Clock {
        fn wait(&mut self) -> Result<Edge, String> {
            let now = self.started.elapsed();
            let mut skipped = 0;
            if let Some(rest) = self.next.checked_sub(now) {
                std::thread::sleep(rest);
            } else {
                // A slow bus or a busy computer: no burst is made up for.
                skipped = (now - self.next).as_micros() / self.period.as_micros();
                self.next = now;
            }
            self.next += self.period;
            Ok(Edge {
                // The time before the transfer: the registers hold the sample from before it.
                time_us: self.now_us(),
                skipped: skipped as u32,
            })
        }

        fn pending_us(&mut self) -> Result<Option<u64>, String> {
            Ok(None)
        }

        fn now_us(&self) -> u64 {
            self.started.elapsed().as_micros() as u64
        }

        fn is_polled(&self) -> bool {
            true
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn the_clock_has_the_period_of_the_sensor() {
            for (rate_hz, period_ms) in [(1000, 1), (333, 3), (143, 7), (4, 250)] {
                let options = I2cOptions {
                    rate_hz,
                    ..I2cOptions::default()
                };
                let divider = options
                    .settings()
                    .expect("settings")
                    .config
                    .sample_rate_divider;
                let clock = Clock::new(divider);
                assert_eq!(clock.period, Duration::from_millis(period_ms), "{rate_hz}");
            }
        }

        #[test]
        fn edges_that_nobody_waited_for_are_counted() {
            for (last, number, count) in [
                (None, 900, 0),
                (Some(900), 901, 0),
                (Some(901), 904, 2),
                (Some(u32::MAX), 1, 1),
            ] {
                assert_eq!(skipped(last, number), count, "{last:?} {number}");
            }
        }

        #[test]
        fn the_clock_counts_the_periods_that_it_skips() {
            let mut clock = Clock::new(4);
            assert_eq!(clock.wait().map(|edge| edge.skipped), Ok(0));
            assert_eq!(clock.wait().map(|edge| edge.skipped), Ok(0));
            std::thread::sleep(Duration::from_millis(22));
            let skipped = clock.wait().map(|edge| edge.skipped).expect("it waits");
            assert!(skipped >= 3, "{skipped}");
        }

        #[test]
        fn the_number_of_a_bus_is_the_whole_one() {
            for (path, number) in [
                ("/dev/i2c-1", "1"),
                ("/dev/i2c-0", "0"),
                ("/dev/i2c-11", "11"),
                ("/dev/sensors", "/dev/sensors"),
            ] {
                assert_eq!(bus_number(Path::new(path)), number, "{path}");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_low_pass_filter_is_below_half_the_rate() {
        for (rate_hz, bandwidth_hz) in [
            (1000, 188),
            (500, 188),
            (333, 98),
            (200, 98),
            (100, 42),
            (50, 20),
            (20, 10),
            (10, 5),
            (4, 5),
        ] {
            let options = I2cOptions {
                rate_hz,
                ..I2cOptions::default()
            };
            let config = options.settings().expect("settings").config;
            assert_eq!(config.low_pass.gyroscope_bandwidth_hz(), bandwidth_hz);
            let rate = config.sample_rate_hz().round() as u16;
            assert_eq!(rate, rate_hz);
        }
    }

    #[test]
    fn a_rate_that_the_sensor_lacks_is_refused_with_its_neighbours() {
        for rate in [4, 5, 8, 10, 111, 143, 200, 250, 333, 500, 1000] {
            assert_eq!(parse_rate(&rate.to_string()), Ok(rate));
        }
        for (rate, neighbours) in [
            ("300", "choose 250 or 333"),
            ("999", "choose 500 or 1000"),
            ("199", "choose 167 or 200"),
        ] {
            let error = parse_rate(rate).expect_err(rate);
            assert!(error.ends_with(neighbours), "{rate}: {error}");
        }
        for rate in ["3", "1001", "0", "-5", "200.5", "fast"] {
            let error = parse_rate(rate).expect_err(rate);
            assert!(error.ends_with("from 4 to 1000"), "{rate}: {error}");
        }
    }
}
