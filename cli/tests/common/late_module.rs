//! Module that changes its baud rate some time after its answer, and drops what it receives until
//! then, as the firmware does. It reads and sends only while both ends have its rate.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::plug::Plug;

/// Time from the answer to the change of the rate: that of a line at 9600 baud.
const LATE: Duration = Duration::from_millis(120);

/// Time at a new rate after which the old one returns, unless a command is understood.
const TRIAL: Duration = Duration::from_secs(10);

/// Time between two pieces of the stream.
const PERIOD: Duration = Duration::from_millis(20);

/// Fault of the module or its line.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// No fault.
    None,
    /// Nothing passes at this baud rate.
    DeafAt(u32),
    /// The module dies as soon as it has confirmed this baud rate.
    DiesAt(u32),
}

/// State of the module.
pub struct State {
    /// Present baud rate.
    pub baud: u32,
    /// Present format.
    pub format: String,
    /// Rate before the present one, and time of the change, until a command is understood.
    pub trial: Option<(u32, Instant)>,
}

/// Module in a thread.
pub struct LateModule {
    ends: Arc<AtomicBool>,
    thread: JoinHandle<State>,
}

impl LateModule {
    /// Starts a module that sends `line` in each format but the log, and `burst` there.
    pub fn start(mut plug: Plug, fault: Fault, line: &'static [u8], burst: Vec<u8>) -> Self {
        let ends = Arc::new(AtomicBool::new(false));
        let ended = Arc::clone(&ends);
        let thread = std::thread::spawn(move || {
            let mut state = State {
                baud: 115_200,
                format: "classic".to_owned(),
                trial: None,
            };
            let mut sent = Instant::now();
            let mut is_dead = false;
            while !ended.load(Ordering::Relaxed) {
                if let Some((before, since)) = state.trial
                    && since.elapsed() >= TRIAL
                {
                    (state.baud, state.trial) = (before, None);
                }
                let command = plug.hear_within(Duration::from_millis(5));
                let passes = plug.baud() == state.baud && fault != Fault::DeafAt(state.baud);
                is_dead |= fault == Fault::DiesAt(state.baud) && state.trial.is_some();
                if is_dead || !passes {
                    continue;
                }
                if let Some(command) = command {
                    state.obey(&command, &mut plug);
                } else if sent.elapsed() >= PERIOD {
                    sent = Instant::now();
                    let is_log = state.format == "log";
                    send(&mut plug, if is_log { &burst } else { line });
                }
            }
            state
        });
        Self { ends, thread }
    }

    /// Ends the module, and returns its state.
    pub fn end(self) -> State {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.join().expect("it does not fail")
    }
}

impl State {
    fn obey(&mut self, command: &str, plug: &mut Plug) {
        self.trial = None;
        let (name, argument) = command.split_once(' ').unwrap_or((command, ""));
        let answer = match name {
            "show" => format!("show: mount=default format={} rate=50", self.format),
            "status" => "status: flags=VALID".to_owned(),
            "format" => {
                argument.clone_into(&mut self.format);
                format!("{argument}, 50 a second")
            }
            "baud" if argument == self.baud.to_string() => format!("baud {argument}: as before"),
            "baud" => return self.change_baud(argument.parse().expect("a rate"), plug),
            _ => panic!("unexpected: {command}"),
        };
        send(plug, format!("# ok {answer}\n").as_bytes());
    }

    fn change_baud(&mut self, baud: u32, plug: &mut Plug) {
        let answer = format!("# ok baud {baud} from now on; say something\n");
        send(plug, answer.as_bytes());
        let answered = Instant::now();
        while answered.elapsed() < LATE {
            plug.hear_within(Duration::from_millis(5));
        }
        self.trial = Some((self.baud, Instant::now()));
        self.baud = baud;
    }
}

/// Sends bytes, unless the other end is closed.
fn send(plug: &mut Plug, bytes: &[u8]) {
    plug.send_within(bytes, Duration::from_millis(1)).ok();
}
