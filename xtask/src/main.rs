//! The commands of the README. Each command first sets up what it needs; see [`setup`].

mod agree;
mod api;
mod build;
mod c_cost;
mod c_library;
mod cost;
mod examples;
mod faults;
mod limit;
mod package;
mod panics;
mod python;
mod qemu;
mod recordings;
mod release;
mod results;
mod rigs;
mod setup;
mod size;
mod step;
mod test;
mod tools;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use build::{Board, Firmware, Kind};

const USAGE: &str = "\
usage: cargo xtask COMMAND

  fly [--log FILE] [--mount M] [--seconds S] [--seed N] [--board B] [--output DIR]
                      fly the firmware on the virtual board (more: `cargo xtask fly --help`)
                      --minimal flies the build without commands, MAVLink, flight log and
                      compass; --without-compass that without a compass
                      --faults FILE|seed:N adds faults
  view                fly it in real time and watch it on a terminal, with keys for commands
                      (more: `cargo xtask view --help`)
  faults [--runs N] [--seed S] [--jobs J] [--resume]
                      fly many times with random faults, and check each flight
                      (more: `cargo xtask faults --help`)
  test                run every check and test
  agree               board, replay and QEMU agree to the bit; a part of `test`
  package             pack the library, build the package, check what is in it; a part of `test`
  size [--board B]    flash, RAM and largest symbols of the firmware,
                      and flash of the Kalman filter alone
  cost [--bless]      cost of the filters on the Cortex-M4F, held to tests/golden/cost.txt
  api [--bless]       the public API, held to tests/golden/public-api.txt
                      --bless writes the golden file anew
  bench               compare filters on recordings or simulated flights
                      (more: `cargo xtask bench --help`)
  results [--long]    measure the figures of README.md, docs/results.md and
                      cli/src/virtual_board.toml, and write all three
                      --long adds flights of an hour and of a day, and 2000 with faults
                      --render writes the pages from docs/results.toml
                      --check fails if a page disagrees with it, and is a part of `test`
  c                   build the C library for this computer and three Cortex-M cores, and run its
                      programs; a part of `test`. Measures its cost beside Fusion's C code
  python              install the Python package into target/ and test it; a part of `test`
  release --dry-run   make and check the archives, the wheel and the package of a release
  flash [--board B]   write the firmware to a board with probe-rs and show its log
  setup               install and build what the others need, and nothing else

boards: stm32f405 (default), blackpill-f401, blackpill-f411, nucleo-f411, nucleo-f446";

/// Option of `fly` for the build without commands, MAVLink, flight log and compass.
const MINIMAL: &str = "--minimal";
/// Option of `fly` for the build without compass.
const WITHOUT_COMPASS: &str = "--without-compass";

fn main() -> ExitCode {
    if let Some(code) = api::run_as_rustdoc() {
        return code;
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("\nerror: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[String]) -> Result<(), String> {
    let (command, rest) = arguments.split_first().ok_or(USAGE)?;
    match command.as_str() {
        "fly" => fly(rest),
        "view" => view(rest),
        "faults" => faults::run(rest),
        "test" => no_more(rest).and_then(|()| test::run()),
        "agree" => no_more(rest).and_then(|()| agree::build_and_run()),
        "package" => no_more(rest).and_then(|()| package::check()),
        "size" => size::run(board_alone(rest)?),
        "cost" => {
            if bless_alone(rest)? {
                cost::bless().and_then(|()| results::take_costs())
            } else {
                cost::run()
            }
        }
        "api" => api::check(&setup::Toolchain::for_target()?, bless_alone(rest)?),
        "bench" => step::run(step::command(&build::bench()?).args(rest)),
        "results" => match results::Mode::parse(rest) {
            Some(mode) => results::run(mode),
            None => Err(format!("`results` takes one option\n\n{USAGE}")),
        },
        "c" => no_more(rest)
            .and_then(|()| c_library::run())
            .and_then(|()| c_cost::run()),
        "python" => no_more(rest).and_then(|()| python::run()),
        "release" if rest == ["--dry-run"] => release::dry_run(),
        "release" => Err(format!("`release` only knows --dry-run\n\n{USAGE}")),
        "flash" => flash(board_alone(rest)?),
        "setup" => no_more(rest).and_then(|()| {
            setup::Toolchain::for_target()?;
            setup::qemu()
        }),
        "help" | "--help" | "-h" => {
            println!("{USAGE}");
            Ok(())
        }
        other => Err(format!("there is no command `{other}`\n\n{USAGE}")),
    }
}

/// Builds the firmware and the virtual board, and passes the arguments to the virtual board.
fn fly(arguments: &[String]) -> Result<(), String> {
    let board = match value_of(arguments, "--board")? {
        Some(name) => Board::from_name(name)?,
        None => Board::default(),
    };
    let mount = mount(arguments, mount_of_environment())?;
    let has = |option: &str| arguments.iter().any(|argument| argument == option);
    let kind = match (has(MINIMAL), has(WITHOUT_COMPASS)) {
        (true, _) => Kind::Minimal,
        (false, true) => Kind::WithoutCompass,
        (false, false) => Kind::Full,
    };
    let virtual_board = build::virtual_board()?;
    let mut flight = step::command(&virtual_board);
    flight.arg("fly");
    let is_own = |argument: &&String| [MINIMAL, WITHOUT_COMPASS].contains(&argument.as_str());
    flight.args(arguments.iter().filter(|argument| !is_own(argument)));
    if arguments.iter().any(|a| a == "--help" || a == "-h") {
        return step::run(&mut flight);
    }
    let elf = Firmware { board, mount, kind }.build(&setup::Toolchain::for_target()?)?;
    flight.arg("--elf").arg(elf);
    // A failed flight has printed the reason already.
    step::run(&mut flight)
}

/// Builds the program `aplomb`, the virtual board and the firmware. Shows the flight with `aplomb
/// view`.
fn view(arguments: &[String]) -> Result<(), String> {
    let program = build::program()?;
    let mut view = step::command(&program);
    view.arg("view");
    if arguments.iter().any(|a| a == "--help" || a == "-h") {
        return step::run(view.arg("--help"));
    }
    build::virtual_board()?;
    // The virtual board takes the mount from the environment too.
    let firmware = Firmware {
        mount: mount(&[], mount_of_environment())?,
        ..Firmware::full(Board::default())
    };
    let elf = firmware.build(&setup::Toolchain::for_target()?)?;
    step::run(view.args(["--virtual", "--elf"]).arg(elf).args(arguments))
}

fn flash(board: Board) -> Result<(), String> {
    if !step::is_installed("probe-rs") {
        return Err("probe-rs is not installed: \
                    run `cargo install probe-rs-tools --locked`, then this again"
            .into());
    }
    let firmware = Firmware {
        mount: mount(&[], mount_of_environment())?,
        ..Firmware::full(board)
    };
    let elf = firmware.build(&setup::Toolchain::for_target()?)?;
    let mut probe = step::command(Path::new("probe-rs"));
    probe.args(["run", "--chip", board.chip]).arg(elf);
    step::run(&mut probe)
}

/// The mount in `APLOMB_MOUNT`, which every command that builds a firmware takes.
fn mount_of_environment() -> Option<String> {
    std::env::var("APLOMB_MOUNT").ok()
}

/// The mount of the option, or else of the environment.
fn mount(arguments: &[String], environment: Option<String>) -> Result<Option<String>, String> {
    let option = value_of(arguments, "--mount")?.map(str::to_owned);
    match option.or(environment) {
        Some(name) if !build::is_mount(&name) => Err(format!(
            "there is no mount `{name}`: \
             forward axis, then down axis, such as +x-z, or z-up or z-down"
        )),
        mount => Ok(mount),
    }
}

/// The value of an option given as `--name value` or `--name=value`.
fn value_of<'a>(arguments: &'a [String], name: &str) -> Result<Option<&'a str>, String> {
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        if argument == name {
            return match rest.next() {
                Some(value) => Ok(Some(value)),
                None => Err(format!("{name} needs a value")),
            };
        }
        if let Some(value) = argument
            .strip_prefix(name)
            .and_then(|end| end.strip_prefix('='))
        {
            return Ok(Some(value));
        }
    }
    Ok(None)
}

/// For commands that take `--board` and nothing else.
fn board_alone(arguments: &[String]) -> Result<Board, String> {
    let Some(name) = value_of(arguments, "--board")? else {
        no_more(arguments)?;
        return Ok(Board::default());
    };
    let used = if arguments[0].contains('=') { 1 } else { 2 };
    no_more(&arguments[used.min(arguments.len())..])?;
    Board::from_name(name)
}

/// For commands that take `--bless` and nothing else: whether it is there.
fn bless_alone(arguments: &[String]) -> Result<bool, String> {
    let bless = arguments.first().is_some_and(|first| first == "--bless");
    no_more(&arguments[usize::from(bless)..])?;
    Ok(bless)
}

fn no_more(arguments: &[String]) -> Result<(), String> {
    match arguments.first() {
        None => Ok(()),
        Some(extra) => Err(format!("`{extra}` is not understood here\n\n{USAGE}")),
    }
}

/// The folder of the workspace.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("xtask lies in the workspace")
        .to_path_buf()
}

#[cfg(test)]
mod tests {
    use super::mount;

    #[test]
    fn the_mount_is_that_of_the_option_or_else_of_the_environment() {
        let given = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        let environment = || Some("+y-z".to_owned());
        assert_eq!(mount(&[], None), Ok(None));
        assert_eq!(mount(&[], environment()), Ok(environment()));
        for option in ["--mount z-down", "--mount=z-down"] {
            let found = mount(&given(option), environment());
            assert_eq!(found, Ok(Some("z-down".to_owned())));
        }
        assert!(mount(&[], Some("+x-x".to_owned())).is_err());
        assert!(mount(&given("--mount up"), environment()).is_err());
    }
}
