//! `aplomb view` from the outside: on a pseudo-terminal as its screen, with a module at the end of
//! another.

#![cfg(target_os = "linux")]

mod common;
#[path = "common/plug.rs"]
mod plug;

use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread::sleep;
use std::time::{Duration, Instant};

use aplomb::attitude::{Quaternion, Vector3};
use aplomb::compass::CompassStatus;
use aplomb::estimator::Sample;
use aplomb::health::Flags;
use aplomb::pipeline::Snapshot;
use aplomb::settings::Record;
use aplomb::telemetry::Output;
use aplomb::telemetry::mavlink::{Session, Vehicle};
use aplomb::telemetry::message::Severity;
use common::{aplomb, file};
use plug::Plug;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize};

const LINE: &[u8] =
    b"roll:1.00\tpitch:-2.50\tyaw:9.00\troll_rate:0.00\tpitch_rate:0.12\tyaw_rate:-3.00\tvalid:1\n";

/// The program, and the terminal that it draws on.
struct View {
    child: Child,
    terminal: Option<Arc<File>>,
    drawn: Receiver<Vec<u8>>,
}

impl View {
    fn start(arguments: &[&str]) -> Self {
        Self::start_with(arguments, false)
    }

    /// Starts it with its errors on the terminal too, or else in a pipe.
    fn start_with(arguments: &[&str], has_errors: bool) -> Self {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let terminal = openpt(flags).expect("a pseudo-terminal");
        grantpt(&terminal).expect("it can be granted");
        unlockpt(&terminal).expect("it can be unlocked");
        let size = Winsize {
            ws_row: 30,
            ws_col: 100,
            ws_xpixel: 0,
            ws_ypixel: 0,
        };
        tcsetwinsize(&terminal, size).expect("it has a size");
        let name = ptsname(&terminal, Vec::new()).expect("it has a name");
        let open = || {
            let name = std::ffi::OsStr::from_bytes(name.to_bytes());
            File::options()
                .read(true)
                .write(true)
                .open(name)
                .expect("it opens")
        };
        let child = Command::new(env!("CARGO_BIN_EXE_aplomb"))
            .arg("view")
            .args(arguments)
            .stdin(open())
            .stdout(open())
            .stderr(match has_errors {
                true => Stdio::from(open()),
                false => Stdio::piped(),
            })
            .spawn()
            .expect("the program runs");
        let terminal = Arc::new(File::from(terminal));
        let (sender, drawn) = channel();
        let screen = Arc::downgrade(&terminal);
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            // Without keeping it open.
            while let Some(screen) = screen.upgrade() {
                let mut polled = [PollFd::new(&*screen, PollFlags::IN)];
                let timeout = Timespec {
                    tv_sec: 0,
                    tv_nsec: 20_000_000,
                };
                if !matches!(poll(&mut polled, Some(&timeout)), Ok(1..)) {
                    continue;
                }
                let length = (&*screen).read(&mut buffer).unwrap_or_default();
                if length == 0 || sender.send(buffer[..length].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self {
            child,
            terminal: Some(terminal),
            drawn,
        }
    }

    /// Waits until this is drawn.
    fn wait_for(&self, text: &str) {
        let start = Instant::now();
        let mut screen = Vec::new();
        while start.elapsed() < Duration::from_secs(10) {
            screen.extend(
                self.drawn
                    .recv_timeout(Duration::from_millis(50))
                    .unwrap_or_default(),
            );
            if String::from_utf8_lossy(&screen).contains(text) {
                return;
            }
        }
        panic!("{text} is not drawn: {}", String::from_utf8_lossy(&screen));
    }

    fn press(&mut self, keys: &str) {
        let mut terminal = self.terminal.as_deref().expect("it is open");
        terminal.write_all(keys.as_bytes()).expect("it takes keys");
    }

    /// Returns whether the terminal takes letters as they are typed, as only the program sets it.
    fn is_raw(&self) -> bool {
        let terminal = self.terminal.as_ref().expect("it is open");
        let settings = tcgetattr(terminal).expect("a terminal");
        !settings.local_modes.contains(LocalModes::ICANON)
    }

    /// Returns the processor time of the program, s: user's and system's time in hundredths
    /// (proc(5), fields 14 and 15).
    fn processor_s(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id()));
        let stat = stat.expect("it runs");
        let (_, fields) = stat.rsplit_once(") ").expect("its name is in parentheses");
        let ticks = fields.split(' ').skip(11).take(2);
        ticks
            .map(|ticks| ticks.parse::<f64>().expect("a number"))
            .sum::<f64>()
            / 100.0
    }

    fn signal(&self, name: &str) {
        let told = Command::new("kill")
            .args([name, &self.child.id().to_string()])
            .status();
        assert!(told.is_ok_and(|status| status.success()));
    }

    /// Returns the exit code and the errors, once the program has ended.
    fn end(mut self) -> (Option<i32>, String) {
        let start = Instant::now();
        while self.child.try_wait().expect("it is ours").is_none() {
            if start.elapsed() > Duration::from_secs(10) {
                self.child.kill().expect("it is ours");
                panic!("it does not end");
            }
            sleep(Duration::from_millis(20));
        }
        let mut errors = String::new();
        if let Some(mut stderr) = self.child.stderr.take() {
            stderr.read_to_string(&mut errors).expect("it is text");
        }
        (self.child.wait().expect("it is ours").code(), errors)
    }
}

/// Returns attitudes of this many seconds, 50 a second.
fn send(plug: &mut Plug, seconds: f64) {
    let start = Instant::now();
    let mut sent = 0.0;
    while start.elapsed().as_secs_f64() < seconds {
        if start.elapsed().as_secs_f64() * 50.0 > sent {
            plug.send(LINE);
            sent += 1.0;
        }
        sleep(Duration::from_millis(5));
    }
}

#[test]
fn silence_is_seen_and_what_comes_takes_little_of_the_processor() {
    let mut plug = Plug::new("view-silence");
    let mut view = View::start(&["--port", plug.name()]);
    send(&mut plug, 1.5);
    view.wait_for("VALID");
    let before_s = view.processor_s();
    send(&mut plug, 4.0);
    let share = (view.processor_s() - before_s) / 4.0;
    println!("{:.1} % of a core", 100.0 * share);
    view.wait_for("NO ATTITUDE");
    assert!(share <= 0.05, "{:.1} % of a core", 100.0 * share);
    assert!(view.is_raw());
    plug.unplug();
    view.wait_for("UNPLUGGED");
    view.press("q");
    let (code, errors) = view.end();
    assert_eq!((code, errors.as_str()), (Some(0), ""));
}

#[test]
fn a_rate_that_the_module_refuses_leaves_the_port_as_it_is() {
    let mut plug = Plug::new("view-refused");
    let mut view = View::start(&["--port", plug.name(), "--baud", "115200"]);
    send(&mut plug, 1.0);
    view.wait_for("VALID");
    view.press(":baud 921600\r");
    while plug.hear().expect("it is said") != "baud 921600" {}
    plug.send(b"# error refused while armed: \"disarm\" first\n");
    view.wait_for("it stays at 115200 baud: error refused while armed");
    assert_eq!(plug.baud(), 115_200);
    view.press(":baud 57600\r");
    while plug.hear().expect("it is said") != "baud 57600" {}
    plug.send(b"# ok baud 57600 from now on; say something at 57600 within 10 s\n");
    plug.confirm_baud(57_600);
    assert_eq!(plug.baud(), 57_600);
    view.press("q");
    assert_eq!(view.end().0, Some(0));
}

/// Returns a round of MAVLink.
fn mavlink() -> Vec<u8> {
    messages(None)
}

/// Returns MAVLink messages with a text of the module.
fn said(text: &str) -> Vec<u8> {
    messages(Some(text))
}

fn messages(text: Option<&str>) -> Vec<u8> {
    let snapshot = Snapshot {
        t_us: 2_000_000,
        attitude: Quaternion::IDENTITY,
        body_rates_rad_s: Vector3::new(0.1, -0.2, 0.3),
        flags: Flags::VALID,
        tilt_variance_rad2: 1e-4,
    };
    let vehicle = Vehicle {
        snapshot: Some(&snapshot),
        is_due: true,
        sample: &Sample::default(),
        temperature_celsius: 31.5,
        heading: None,
        compass: CompassStatus::default(),
        record: &Record::default(),
        baud: 115_200,
        is_armed: false,
        bursts_failed: 0,
    };
    let mut buffer = [0; 2000];
    let mut output = Output::new(&mut buffer);
    let mut session = Session::new();
    session.fill(2_000_000, &vehicle, &mut output);
    if let Some(text) = text {
        assert!(session.send_text(Severity::Information, text, &mut output));
    }
    let length = output.length();
    buffer[..length].to_vec()
}

#[test]
fn a_signal_or_the_terminals_end_brings_the_terminal_and_the_module_back() {
    for (name, has_errors) in [("-TERM", false), ("-HUP", false), ("-HUP", true)] {
        let mut plug = Plug::new(&format!("view{name}-{has_errors}"));
        let mut view = View::start_with(&["--port", plug.name()], has_errors);
        send(&mut plug, 1.0);
        view.wait_for("VALID");
        // The format after MAVLink is the log.
        plug.send(&mavlink());
        view.wait_for("mavlink");
        view.press("f");
        while plug.hear().expect("it is said") != "baud 921600" {}
        plug.send(&said("ok baud 921600 from now on; say something"));
        plug.confirm_baud_with(921_600, &said("ok baud 921600: as before"));
        while plug.hear().expect("it is said") != "format log" {}
        assert_eq!(plug.baud(), 921_600);
        view.signal(name);
        if name == "-HUP" {
            // The terminal goes, as when the window is closed.
            view.terminal = None;
        }
        while plug.hear().expect("the module is brought back") != "format text" {}
        assert_eq!(plug.hear().as_deref(), Some("baud 115200"));
        plug.send(b"# ok baud 115200 from now on\n");
        plug.confirm_baud(115_200);
        if name == "-TERM" {
            // While it ends, its terminal is as it was already.
            assert!(!view.is_raw());
        }
        assert!(view.end().0.is_some(), "it ended by itself");
    }
}

#[test]
fn a_virtual_board_that_never_flies_says_why() {
    let result = aplomb(&["view", "--virtual"]);
    assert!(String::from_utf8_lossy(&result.stderr).contains("needs a terminal"));
    let image = file("view", "no.elf", "no image");
    let view = View::start(&["--virtual", "--elf", image.to_str().expect("a name")]);
    let (code, errors) = view.end();
    assert_eq!(code, Some(1), "{errors}");
    assert!(
        errors.contains("no attitude has come: ") || errors.contains("is not there"),
        "{errors}"
    );
}
