//! `aplomb measure`: the module's own figures, beside those of the virtual board.

use std::error::Error;
use std::time::Duration;

use aplomb_recordings::terminal::print_line;
use serde::Serialize;

use crate::end_request::end_request;
use crate::link::{BAUD, which_port};
use crate::stream::{field, numbers};
use crate::talk::Talk;
use crate::usage::Usage;

/// Figures of the virtual board, as `cargo xtask results` has written them.
const RESULTS: &str = include_str!("virtual_board.toml");

/// Sensor's nominal sample rate, 1/s.
const NOMINAL_HZ: f64 = 1_000.0;

/// Have a module measure itself: cycles, latency, load, samples lost, jitter, stack, noise.
///
/// The module counts on its own while it flies as always. Keep it at rest for the noise. The table
/// has the virtual board's figures beside the module's. After Ctrl-C the module measures no more.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb measure --port /dev/ttyUSB0
  aplomb measure --port /dev/ttyUSB0 --seconds 60 --json

The virtual board counts instructions. A chip takes up to four times as many cycles.

JSON: module, with the figures of the table, names with units; and virtual_board, with its name and
those figures that were measured there.")]
pub struct Options {
    /// The module's serial port; without one the ports of this computer are listed
    #[arg(long)]
    port: Option<String>,
    /// The module's baud rate
    #[arg(long, default_value_t = BAUD)]
    baud: u32,
    /// Seconds to measure
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=3_600))]
    seconds: u32,
    /// Print the figures as JSON
    #[arg(long)]
    json: bool,
}

/// Figures of the module.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Duration, s.
    pub seconds: f64,
    /// Samples.
    pub samples: u64,
    /// Samples lost.
    pub missed: u64,
    /// Frequency of the core, MHz.
    pub core_mhz: f64,
    /// Cycles per sample: its interrupts and the attitude task.
    pub cycles_per_sample_mean: f64,
    /// The most for any sample.
    pub cycles_per_sample_max: f64,
    /// Cycles per sample in interrupts.
    pub interrupt_cycles_per_sample_mean: f64,
    /// The most for any sample.
    pub interrupt_cycles_per_sample_max: f64,
    /// Edge on INT to published attitude, µs.
    pub edge_to_attitude_us_mean: f64,
    /// The longest.
    pub edge_to_attitude_us_max: f64,
    /// Load of the core, percent.
    pub cpu_load_percent: f64,
    /// Period of the samples by the core's clock, µs.
    pub period_us_mean: f64,
    /// The shortest.
    pub period_us_min: f64,
    /// The longest.
    pub period_us_max: f64,
    /// Standard deviation of the period, µs.
    pub period_us_sigma: f64,
    /// Sensor's clock against the core's, percent too fast.
    pub sensor_clock_percent: f64,
    /// Bytes of the stack that were ever used.
    pub stack_bytes_used: f64,
    /// Size of the stack.
    pub stack_bytes: f64,
    /// Mean of the accelerometer in sensor axes, mg.
    pub accel_mg: Vec<f64>,
    /// Standard deviation of the accelerometer, mg.
    pub accel_sigma_mg: Vec<f64>,
    /// Mean of the gyroscope in sensor axes, °/s.
    pub gyro_dps: Vec<f64>,
    /// Standard deviation of the gyroscope, °/s.
    pub gyro_sigma_dps: Vec<f64>,
    /// Temperature of the sensor, °C.
    pub temperature_celsius: f64,
}

impl Figures {
    /// Reads the answer to `measure show`.
    pub fn parse(answer: &str) -> Result<Self, String> {
        let number = |name: &str, place: usize| {
            let found = numbers(answer, name).get(place).copied();
            found.ok_or_else(|| format!("the module's figures lack `{name}`: {answer}"))
        };
        let axes = |name: &str| {
            let found = numbers(answer, name);
            let is_whole = found.len() == 3;
            is_whole
                .then_some(found)
                .ok_or_else(|| format!("no three axes of `{name}`: {answer}"))
        };
        let period_us_mean = number("period_us", 0)?;
        let sensor_hz = if period_us_mean > 0.0 {
            1e6 / period_us_mean
        } else {
            0.0
        };
        Ok(Self {
            seconds: number("seconds", 0)?,
            samples: number("samples", 0)? as u64,
            missed: number("missed", 0)? as u64,
            core_mhz: number("core_mhz", 0)?,
            cycles_per_sample_mean: number("cycles", 0)?,
            cycles_per_sample_max: number("cycles", 1)?,
            interrupt_cycles_per_sample_mean: number("interrupt_cycles", 0)?,
            interrupt_cycles_per_sample_max: number("interrupt_cycles", 1)?,
            edge_to_attitude_us_mean: number("edge_to_attitude_us", 0)?,
            edge_to_attitude_us_max: number("edge_to_attitude_us", 1)?,
            cpu_load_percent: number("load_percent", 0)?,
            period_us_mean,
            period_us_min: number("period_us", 1)?,
            period_us_max: number("period_us", 2)?,
            period_us_sigma: number("period_sigma_us", 0)?,
            sensor_clock_percent: 100.0 * (sensor_hz / NOMINAL_HZ - 1.0),
            stack_bytes_used: number("stack_bytes", 0)?,
            stack_bytes: number("stack_bytes", 1)?,
            accel_mg: axes("accel_mg")?,
            accel_sigma_mg: axes("accel_sigma_mg")?,
            gyro_dps: axes("gyro_dps")?,
            gyro_sigma_dps: axes("gyro_sigma_dps")?,
            temperature_celsius: number("temperature_c", 0)?,
        })
    }

    /// Returns the table, with the virtual board's figures beside the module's.
    pub fn table(&self) -> String {
        let board = VirtualBoard::of(self.core_mhz);
        let head = [
            "figure".to_owned(),
            "this module".to_owned(),
            format!("virtual {}", board.name),
        ];
        let rows = [head]
            .into_iter()
            .chain(self.core_rows(&board))
            .chain(self.sensor_rows());
        let rows: Vec<String> = rows
            .map(|[name, own, expected]| format!("{name:<40}{own:<26}{expected}"))
            .collect();
        rows.join("\n")
    }

    /// Returns the rows of the core's work: name, own figure, and that of the virtual board.
    fn core_rows(&self, board: &VirtualBoard) -> Vec<[String; 3]> {
        let mean_and_most = |key: &str, decimals: usize| {
            let mean = board.text(&format!("{key}_mean"), decimals);
            format!("{mean} / {}", board.text(&format!("{key}_max"), decimals))
        };
        let row = |name: &str, own: String, expected: String| [name.to_owned(), own, expected];
        let (cycles, most) = (self.cycles_per_sample_mean, self.cycles_per_sample_max);
        let interrupts = self.interrupt_cycles_per_sample_mean;
        let interrupts_most = self.interrupt_cycles_per_sample_max;
        let (latency_us, latest_us) = (self.edge_to_attitude_us_mean, self.edge_to_attitude_us_max);
        vec![
            row(
                "samples, lost",
                format!("{}, {}", self.samples, self.missed),
                "-, 0".to_owned(),
            ),
            row(
                "cycles per sample, mean / most",
                format!("{cycles:.0} / {most:.0}"),
                mean_and_most("instructions_per_sample", 0),
            ),
            row(
                "of which in interrupts",
                format!("{interrupts:.0} / {interrupts_most:.0}"),
                board.text("io_instructions_per_sample_mean", 0),
            ),
            row(
                "edge to attitude, us, mean / most",
                format!("{latency_us:.1} / {latest_us:.0}"),
                mean_and_most("edge_to_attitude_us", 1),
            ),
            row(
                "load of the core, %",
                format!("{:.2}", self.cpu_load_percent),
                board.text("cpu_load_percent", 2),
            ),
            row(
                "stack, bytes used of all",
                format!("{} of {}", self.stack_bytes_used, self.stack_bytes),
                board.text("stack_bytes_used", 0),
            ),
        ]
    }

    /// Returns the rows of the samples.
    fn sensor_rows(&self) -> Vec<[String; 3]> {
        let axes = |axes: &[f64], decimals: usize| {
            let texts: Vec<String> = axes
                .iter()
                .map(|axis| format!("{axis:.decimals$}"))
                .collect();
            texts.join(", ")
        };
        let (least_us, most_us) = (self.period_us_min, self.period_us_max);
        [
            (
                "sample period, us, least / mean / most",
                format!("{least_us} / {:.2} / {most_us}", self.period_us_mean),
            ),
            ("its jitter, us", format!("{:.2}", self.period_us_sigma)),
            (
                "sensor's clock against the core's, %",
                format!("{:+.2}", self.sensor_clock_percent),
            ),
            ("accelerometer, mg", axes(&self.accel_mg, 1)),
            ("its noise, mg", axes(&self.accel_sigma_mg, 2)),
            ("gyroscope, deg/s", axes(&self.gyro_dps, 2)),
            ("its noise, deg/s", axes(&self.gyro_sigma_dps, 3)),
            ("temperature, C", format!("{:.1}", self.temperature_celsius)),
        ]
        .map(|(name, own)| [name.to_owned(), own, "-".to_owned()])
        .to_vec()
    }
}

/// Figures of a virtual board.
struct VirtualBoard {
    name: &'static str,
}

impl VirtualBoard {
    /// Returns the board whose core has this frequency.
    fn of(core_mhz: f64) -> Self {
        let name = match core_mhz {
            ..90.0 => "blackpill-f401",
            ..130.0 => "blackpill-f411",
            _ => "stm32f405",
        };
        Self { name }
    }

    /// Returns a figure; `None` if it was not measured.
    fn number(&self, key: &str) -> Option<f64> {
        let section = format!("[board.{}]", self.name);
        let lines = RESULTS.lines().skip_while(|line| *line != section).skip(1);
        let mut lines = lines.take_while(|line| !line.starts_with('['));
        lines.find_map(|line| {
            let (name, value) = line.split_once(" = ")?;
            (name == key).then(|| value.parse().ok()).flatten()
        })
    }

    /// Returns a figure as text.
    fn text(&self, key: &str, decimals: usize) -> String {
        let number = self.number(key);
        number.map_or("-".to_owned(), |number| format!("{number:.decimals$}"))
    }

    /// Returns all figures that the module measures too.
    fn figures(&self) -> serde_json::Map<String, serde_json::Value> {
        const KEYS: [&str; 7] = [
            "instructions_per_sample_mean",
            "instructions_per_sample_max",
            "io_instructions_per_sample_mean",
            "edge_to_attitude_us_mean",
            "edge_to_attitude_us_max",
            "cpu_load_percent",
            "stack_bytes_used",
        ];
        let known = KEYS
            .iter()
            .filter_map(|key| Some((*key, self.number(key)?)));
        let mut figures: serde_json::Map<_, _> = known
            .map(|(key, number)| (key.to_owned(), number.into()))
            .collect();
        figures.insert("board".to_owned(), self.name.into());
        figures
    }
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    let port = options.port.as_ref();
    let port = port.ok_or_else(|| Usage::from(which_port()))?;
    end_request()?;
    let mut talk = Talk::open(port, options.baud)?;
    let figures = measure(&mut talk, options.seconds)?;
    if options.json {
        let board = VirtualBoard::of(figures.core_mhz).figures();
        let both = serde_json::json!({ "module": figures, "virtual_board": board });
        print_line(&serde_json::to_string_pretty(&both)?);
    } else {
        print_line(&figures.table());
    }
    Ok(())
}

/// Has the module measure itself for this time. Afterwards, or after Ctrl-C, it measures no more.
pub fn measure(talk: &mut Talk, seconds: u32) -> Result<Figures, String> {
    let status = talk.ask("status")?;
    if field(&status, "sensor") == Some("none") {
        return Err("the module has no sensor: `aplomb bring-up` finds out why".into());
    }
    let figures = talk
        .ask("measure on")
        .and_then(|_| talk.wait(Duration::from_secs(seconds.into())))
        .and_then(|()| talk.ask("measure show"))
        .and_then(|answer| Figures::parse(&answer));
    let is_off = talk.ask_in_any_case("measure off");
    figures.and_then(|figures| is_off.map(|_| figures))
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Answer to `measure show`.
    pub const ANSWER: &str = "measure: seconds=10.0 samples=9931 missed=2 cycles=1023.25,2238 \
        interrupt_cycles=235.73,542 edge_to_attitude_us=390.92,397 load_percent=0.910 \
        period_us=1006.984,1006,1007 period_sigma_us=0.13 core_mhz=168 stack_bytes=7800,12288 \
        accel_mg=73.0,-81.6,1018.9 accel_sigma_mg=6.0,6.1,6.2 gyro_dps=7.9,1.8,18.4 \
        gyro_sigma_dps=0.1,0.1,0.1 temperature_c=20.5";

    #[test]
    fn an_answer_becomes_a_table_beside_the_virtual_boards_figures() {
        let figures = Figures::parse(ANSWER).expect("figures");
        assert_eq!((figures.samples, figures.missed), (9931, 2));
        assert!((figures.sensor_clock_percent + 0.6936).abs() < 1e-3);
        let table = figures.table();
        let row = |name: &str| {
            table
                .lines()
                .find(|line| line.starts_with(name))
                .expect(name)
        };
        assert!(row("figure").ends_with("virtual stm32f405"), "{table}");
        assert!(
            row("edge to attitude").contains("390.9 / 397   "),
            "{table}"
        );
        for name in ["cycles per sample", "edge to", "load of", "stack"] {
            assert!(!row(name).ends_with('-'), "{table}");
        }
        assert!(table.lines().all(|line| line.len() <= 100), "{table}");
    }

    #[test]
    fn an_answer_without_a_figure_is_refused_with_its_name() {
        let answer = ANSWER.replace("load_percent=0.910 ", "");
        let refused = Figures::parse(&answer).expect_err("it lacks one");
        assert!(refused.contains("load_percent"), "{refused}");
    }

    #[test]
    fn every_clock_has_its_board() {
        for (core_mhz, name) in [(84.0, "blackpill-f401"), (100.0, "blackpill-f411")] {
            let board = VirtualBoard::of(core_mhz);
            assert_eq!((board.name, board.figures().len()), (name, 8));
        }
    }
}
