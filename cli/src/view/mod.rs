//! `aplomb view`: the module's attitude and health on a terminal, live or from a recording.

mod app;
mod compass;
mod dots;
mod horizon;
mod keys;
mod letters;
mod live;
mod model;
mod picture;
mod player;
mod screen;
#[cfg(test)]
mod tests;

use std::error::Error;
use std::io::{self, IsTerminal};
use std::mem::ManuallyDrop;
use std::path::{Path, PathBuf};
use std::process::Command;

use aplomb_recordings::output::OutputFile;
use aplomb_recordings::terminal::{print_line, print_message};
use ratatui::DefaultTerminal;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;

use crate::end_request::end_request;
use crate::i2c::I2cOptions;
use crate::link::which_port;
use crate::usage::Usage;
use app::{App, FRAME, Origin};
use model::{Connection, Model, Speaker};
use player::{Player, SPEEDS};

/// Sensor boards of the virtual board.
const VIRTUAL_SENSORS: [&str; 3] = ["mpu6050", "mpu9250", "gy87"];

/// Size of the picture, letters.
const PICTURE: Rect = Rect::new(0, 0, 110, 32);

/// Watch the attitude live: horizon, angles and rates over time, health, messages.
///
/// Shows a module on a serial port, the virtual board, or a recording: a flight log, what the
/// module sent in any format, or an attitude CSV. The format is found out, and the baud rate too. A
/// port that is unplugged is waited for.
///
/// Keys command the module (`?` lists them): calibrate, save, change the format, record to a file.
/// Health and σ are complete in the format `log`; in the others σ and the temperature are asked
/// for every two seconds.
#[derive(clap::Args)]
#[command(after_help = "Examples:
  aplomb view --port /dev/ttyUSB0
  aplomb view --i2c /dev/i2c-1 --interrupt gpiochip0:17
  aplomb view flight.log --speed 4
  aplomb view target/fly/attitude.csv
  cargo xtask view                  (builds the virtual board and shows it: no hardware needed)")]
pub struct Options {
    /// A recording to play
    #[arg(conflicts_with_all = ["port", "baud", "virtual_board", "elf", "virtual_sensor"])]
    #[arg(conflicts_with = "I2cOptions")]
    file: Option<PathBuf>,
    /// The module's serial port; without a port the ports of this computer are listed
    #[arg(long, conflicts_with_all = ["I2cOptions", "elf", "virtual_sensor"])]
    port: Option<String>,
    /// The module's baud rate. Default: found out, from 115200 on
    #[arg(long, requires = "port")]
    baud: Option<u32>,
    /// Show the firmware on the virtual board, in a simulated flight
    #[arg(long = "virtual", conflicts_with_all = ["port", "baud", "I2cOptions"])]
    virtual_board: bool,
    /// The firmware image for the virtual board. Default: the one that `cargo xtask view` builds
    #[arg(long, value_name = "FILE", requires = "virtual_board")]
    elf: Option<PathBuf>,
    /// The sensor board on the virtual board; mpu9250 and gy87 have a compass [default: mpu6050]
    #[arg(long = "sensor", value_name = "NAME", requires = "virtual_board")]
    #[arg(value_parser = VIRTUAL_SENSORS)]
    virtual_sensor: Option<String>,
    #[command(flatten)]
    sensor: I2cOptions,
    /// Play a recording so many times as fast
    #[arg(long, value_name = "TIMES", default_value_t = 1.0, value_parser = parse_speed)]
    speed: f64,
    /// Draw the screen of a recording as a PNG file instead
    #[arg(long, value_name = "FILE", requires = "file")]
    #[arg(conflicts_with_all = ["port", "virtual_board", "I2cOptions"])]
    picture: Option<PathBuf>,
    /// The time that the picture shows, in seconds from the recording's beginning
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 10.0,
        requires = "picture",
        allow_negative_numbers = true,
        value_parser = parse_time
    )]
    at: f64,
}

fn parse_speed(text: &str) -> Result<f64, String> {
    let speed = text.parse().ok();
    let (least, most) = (SPEEDS.start(), SPEEDS.end());
    speed
        .filter(|speed| SPEEDS.contains(speed))
        .ok_or_else(|| format!("it has to be a number from {least} to {most}"))
}

fn parse_time(text: &str) -> Result<f64, &'static str> {
    let time = text.parse().ok();
    time.filter(|time: &f64| time.is_finite() && *time >= 0.0)
        .ok_or("it has to be a number of seconds, 0 or more")
}

impl Options {
    /// Returns the source to view.
    fn origin(&self) -> Result<Origin, String> {
        if let Some(file) = &self.file {
            return Ok(Origin::File(file.clone(), self.speed));
        }
        if self.sensor.i2c.is_some() {
            return Ok(Origin::Sensor(self.sensor.clone()));
        }
        if self.virtual_board {
            let mut command = virtual_board(self.elf.as_deref())?;
            command.args(self.flight_arguments());
            return Ok(Origin::VirtualBoard(command));
        }
        Ok(Origin::Port(
            self.port.clone().unwrap_or_default(),
            self.baud,
        ))
    }

    /// Returns the arguments of the flight on the virtual board, beside those of its image.
    fn flight_arguments(&self) -> Vec<&str> {
        match &self.virtual_sensor {
            Some(name) => vec!["--sensor", name],
            None => Vec::new(),
        }
    }
}

/// Runs the command.
pub fn run(options: &Options) -> Result<(), Box<dyn Error>> {
    if let (Some(file), Some(picture)) = (&options.file, &options.picture) {
        return draw_picture(file, options.at, picture);
    }
    let has_source = options.port.is_some() || options.sensor.i2c.is_some();
    if options.file.is_none() && !has_source && !options.virtual_board {
        let hint = "Without a board: `cargo xtask view` shows the virtual one";
        return Err(Usage::from(format!("{}\n{hint}", which_port())).into());
    }
    if !io::stdout().is_terminal() || !io::stdin().is_terminal() {
        let instead = if options.file.is_some() {
            "`--picture FILE.png` draws its screen of a recording"
        } else if options.virtual_board {
            "`cargo xtask fly` flies the virtual board without one, and writes files"
        } else {
            "`aplomb record` writes what comes to a file"
        };
        return Err(format!("`view` needs a terminal; {instead}").into());
    }
    let ends = end_request()?;
    let mut app = App::new(options.origin()?)?;
    // The hook also restores the terminal before a panic is reported.
    let mut terminal = ratatui::try_init()?;
    let result = app.run(&mut terminal, ends);
    restore(terminal);
    result
}

/// Restores the terminal, which may be gone. Functions of the library that print an error would
/// then panic, before the module is restored.
fn restore(mut terminal: DefaultTerminal) {
    let is_gone = terminal.show_cursor().is_err();
    // Nothing is left to be restored on a terminal that is gone.
    ratatui::try_restore().ok();
    if is_gone {
        let _never_dropped = ManuallyDrop::new(terminal);
    }
}

/// Returns the command for the virtual board beside this program, with the firmware that `cargo
/// xtask view` builds.
fn virtual_board(elf: Option<&Path>) -> Result<Command, String> {
    const ADVICE: &str = "`cargo xtask view` builds what is needed and comes here";
    let own = std::env::current_exe().map_err(|error| format!("{error}: {ADVICE}"))?;
    let folder = own.parent().unwrap_or(Path::new("."));
    let program = folder.join(format!("virtual-board{}", std::env::consts::EXE_SUFFIX));
    let elf = match elf {
        Some(elf) => elf.to_owned(),
        None => folder.join("../firmware/flight-stm32f405-default.elf"),
    };
    for file in [&program, &elf] {
        if !file.is_file() {
            return Err(format!("{} is not there: {ADVICE}", file.display()));
        }
    }
    let mut command = Command::new(program);
    command.args(["fly", "--live", "--elf"]).arg(elf);
    Ok(command)
}

/// Draws the screen of a recording at a time.
fn draw_picture(file: &Path, at_s: f64, picture: &Path) -> Result<(), Box<dyn Error>> {
    if picture.extension().is_none_or(|ending| ending != "png") {
        let picture = picture.display();
        let reason = format!("{picture}: the name has to end with .png, which is what is drawn");
        return Err(Usage::from(reason).into());
    }
    let mut player = Player::open(file)?;
    let name = file.file_name().unwrap_or_default().display().to_string();
    let connection = Connection::Playing {
        speed: 1.0,
        is_over: false,
    };
    let mut model = Model::new(name, connection);
    // Steps as on the screen give the same rates.
    while player.position_s() < at_s && !player.is_over() {
        let step_s = FRAME.as_secs_f64().min(at_s - player.position_s());
        for (at_s, item) in player.advance(step_s) {
            model.take(at_s, item);
        }
        model.tick(player.position_s(), player.format(), player.counts());
        if let Some(error) = player.take_error() {
            print_message(&error);
            model.add_message(player.position_s(), Speaker::Program, error);
        }
    }
    let mut buffer = Buffer::empty(PICTURE);
    screen::draw(&model, PICTURE, &mut buffer);
    OutputFile::write(picture, &[file], &picture::picture(&buffer).png())?;
    print_line(&format!(
        "{}: the screen at {:.1} s",
        picture.display(),
        player.position_s()
    ));
    Ok(())
}
