//! Link to a module: a serial port, which may be unplugged and come back, the virtual board as
//! another process, or a sensor on a bus of this computer.
//!
//! A thread reads, so that no byte is lost while the screen is drawn, and carries out orders. It
//! ends when the [`Link`] is dropped.

mod baud;

use std::io::{self, Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use serialport::{ClearBuffer, ErrorKind, SerialPort, SerialPortType};

use crate::i2c::Sampled;
use baud::{Failure, Line};

/// Default baud rate of the module.
pub const BAUD: u32 = 115_200;

/// Baud rate for the flight log.
pub const LOG_BAUD: u32 = 921_600;

/// Timeout of a read. Orders wait as long.
const READ_TIMEOUT: Duration = Duration::from_millis(20);

/// Pause between reads: at 921,600 baud 460 bytes gather, and a terminal's buffer holds 4096.
const GATHER: Duration = Duration::from_millis(5);

/// Time between two attempts to open the port again.
const RETRY: Duration = Duration::from_millis(250);

/// Report of the thread.
#[derive(Debug, PartialEq, Eq)]
pub enum Report {
    /// Received bytes.
    Bytes(Vec<u8>),
    /// The port is back.
    Back,
    /// The port is gone, for this reason. The thread tries to open it again.
    Away(String),
    /// The source has ended, for this reason.
    Ended(String),
    /// The module and the port have changed to this baud rate; or neither has, for this reason.
    Switched(Result<u32, String>),
}

/// Order to the thread.
enum Order {
    /// Send a line.
    Send(String),
    /// Continue at this baud rate.
    SetBaud(u32),
    /// Have the module change to this baud rate, and continue at it.
    SwitchBaud(Switch),
}

/// Change of the baud rate of module and port.
struct Switch {
    baud: u32,
    /// Receiver of the result, if it is none of the reports.
    asker: Option<Sender<Result<u32, Failure>>>,
}

impl Switch {
    /// Reports the result. A dropped link needs none.
    fn report(self, result: Result<u32, Failure>, reports: &Sender<Report>) {
        match self.asker {
            Some(asker) => asker.send(result).ok(),
            None => {
                let result = result.map_err(|failure| failure.to_string());
                reports.send(Report::Switched(result)).ok()
            }
        };
    }
}

/// Connection to a module.
pub struct Link {
    reports: Receiver<Report>,
    orders: Option<Sender<Order>>,
    thread: Option<JoinHandle<()>>,
}

impl Link {
    /// Opens a serial port. Later it may go and come back.
    pub fn port(path: &str, baud: u32) -> Result<Self, String> {
        let port = open(path, baud).map_err(|error| explain(path, &error))?;
        let path = path.to_owned();
        Ok(Self::start(move |reports, orders| {
            Port { path, baud }.serve(port, &reports, &orders);
        }))
    }

    /// Starts a process: bytes from its standard output, lines to its standard input.
    pub fn process(mut command: Command) -> Result<Self, String> {
        let name = Path::new(command.get_program()).display().to_string();
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let child = command
            .spawn()
            .map_err(|error| format!("{name} cannot be started: {error}"))?;
        Ok(Self::start(|reports, orders| {
            serve_process(child, &reports, &orders);
        }))
    }

    /// Samples a sensor on a bus of this computer. Its log comes as that of a module.
    pub fn sensor(sensor: Box<dyn Sampled>) -> Self {
        Self::start(|reports, orders| serve_sensor(sensor, &reports, &orders))
    }

    fn start(serve: impl FnOnce(Sender<Report>, Receiver<Order>) + Send + 'static) -> Self {
        let (report, reports) = channel();
        let (orders, ordered) = channel();
        Self {
            reports,
            orders: Some(orders),
            thread: Some(std::thread::spawn(|| serve(report, ordered))),
        }
    }

    /// Returns the next report, or `None` after `timeout`.
    pub fn next(&self, timeout: Duration) -> Option<Report> {
        self.reports.recv_timeout(timeout).ok()
    }

    /// Sends a command.
    pub fn send_line(&self, line: &str) {
        self.order(Order::Send(line.to_owned()));
    }

    /// Changes the port's baud rate, from now on and when the port comes back.
    pub fn set_baud(&self, baud: u32) {
        self.order(Order::SetBaud(baud));
    }

    /// Has the module change its baud rate, and follows if the module confirms it. A
    /// [`Report::Switched`] has the result, as soon as the module answers at the new rate.
    pub fn switch_baud(&self, baud: u32) {
        self.order(Order::SwitchBaud(Switch { baud, asker: None }));
    }

    /// Restores a format and a baud rate of the module.
    ///
    /// # Errors
    ///
    /// Returns why the module may have another format or rate, and what to do.
    pub fn bring_back(&self, format: &str, baud: u32) -> Result<(), String> {
        let mut result = self.bring_back_once(format, baud);
        // Noise may have spoilt a line.
        if matches!(result, Err(Failure::Unanswered | Failure::Refused(_))) {
            result = self.bring_back_once(format, baud);
        }
        result.map(|_| ()).map_err(|failure| {
            let advice = match failure {
                Failure::Lost { .. } => "",
                _ => ". Switch it off and on: it then has its saved format and rate",
            };
            format!(
                "the module could not be brought back to `format {format}` at {baud} baud: \
                 {failure}{advice}"
            )
        })
    }

    fn bring_back_once(&self, format: &str, baud: u32) -> Result<u32, Failure> {
        let (asker, result) = channel();
        self.send_line(&format!("format {format}"));
        self.order(Order::SwitchBaud(Switch {
            baud,
            asker: Some(asker),
        }));
        // Another change may come first.
        match result.recv_timeout(2 * baud::LONGEST) {
            Ok(result) => result,
            Err(RecvTimeoutError::Timeout) => Err(Failure::Unanswered),
            Err(RecvTimeoutError::Disconnected) => Err(Failure::Gone),
        }
    }

    fn order(&self, order: Order) {
        if let Some(orders) = &self.orders {
            // A thread that has ended has sent a report of it.
            orders.send(order).ok();
        }
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        // The thread carries out its orders, and ends.
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// Samples until the link is dropped.
fn serve_sensor(mut sensor: Box<dyn Sampled>, reports: &Sender<Report>, orders: &Receiver<Order>) {
    loop {
        match orders.try_recv() {
            Ok(Order::Send(_) | Order::SwitchBaud(_)) => {
                sensor.say("error a sensor on a bus takes no commands: a module does");
            }
            Ok(Order::SetBaud(_)) | Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => return,
        }
        let step = sensor.step();
        let bytes = sensor.take_bytes();
        if !bytes.is_empty() && reports.send(Report::Bytes(bytes)).is_err() {
            return;
        }
        let Err(reason) = step else { continue };
        if sensor.is_bus_too_slow() {
            // If the channel is closed, nobody waits for the reason.
            reports.send(Report::Ended(reason)).ok();
            return;
        }
        if reports.send(Report::Away(reason)).is_err() {
            return;
        }
        while !sensor.is_back() {
            match orders.recv_timeout(RETRY) {
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
        if reports.send(Report::Back).is_err() {
            return;
        }
    }
}

fn open(path: &str, baud: u32) -> serialport::Result<Box<dyn SerialPort>> {
    serialport::new(path, baud).timeout(READ_TIMEOUT).open()
}

/// Text of the error of a file or device that is no terminal line: ENOTTY.
const NO_TERMINAL: &str = "typewriter";

/// Returns why a port cannot be opened, and what to do.
fn explain(path: &str, error: &serialport::Error) -> String {
    let advice = match error.kind() {
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => {
            "your user may not use it: on Linux, `sudo usermod -a -G dialout $USER`, \
             then log in again"
                .into()
        }
        ErrorKind::NoDevice if Path::new(path).exists() => {
            "another program has it open: close that one \
             (a serial monitor, a ground station, ModemManager)"
                .into()
        }
        ErrorKind::NoDevice | ErrorKind::Io(io::ErrorKind::NotFound) => {
            format!("there is no such port. {}", found())
        }
        _ if error.description.contains(NO_TERMINAL) => {
            return format!("{path}: it is no serial port. {}", found());
        }
        _ => found(),
    };
    format!("{path}: {error}: {advice}")
}

/// Returns the message for a missing `--port`.
pub fn which_port() -> String {
    format!("which port? {}", found())
}

/// Returns the ports of this computer, as a sentence.
fn found() -> String {
    let ports = serialport::available_ports().unwrap_or_default();
    if ports.is_empty() {
        return "No serial port was found: is the adapter plugged in, \
                and the cable one that carries data?"
            .into();
    }
    let lines: Vec<String> = ports
        .iter()
        .map(|port| {
            let what = match &port.port_type {
                SerialPortType::UsbPort(usb) => {
                    let name = usb.product.clone().unwrap_or_else(|| "USB".into());
                    format!("  ({name})")
                }
                _ => String::new(),
            };
            format!("  --port {}{what}", port.port_name)
        })
        .collect();
    format!("These were found:\n{}", lines.join("\n"))
}

/// Server of a port.
struct Port {
    path: String,
    baud: u32,
}

/// Reason why a port is served no longer.
enum End {
    /// The port is gone.
    Away(String),
    /// The link was dropped.
    Unwanted,
}

impl Port {
    fn serve(
        mut self,
        mut port: Box<dyn SerialPort>,
        reports: &Sender<Report>,
        orders: &Receiver<Order>,
    ) {
        loop {
            let End::Away(reason) = self.follow(port, reports, orders) else {
                return;
            };
            if reports.send(Report::Away(reason)).is_err() {
                return;
            }
            port = loop {
                match orders.recv_timeout(RETRY) {
                    Ok(Order::SetBaud(baud)) => self.baud = baud,
                    Ok(Order::SwitchBaud(switch)) => switch.report(Err(Failure::Gone), reports),
                    Ok(Order::Send(_)) | Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return,
                }
                if let Ok(port) = open(&self.path, self.baud) {
                    break port;
                }
            };
            if reports.send(Report::Back).is_err() {
                return;
            }
        }
    }

    /// Reads and carries out orders until the port is gone or the link is dropped.
    fn follow(
        &mut self,
        mut port: Box<dyn SerialPort>,
        reports: &Sender<Report>,
        orders: &Receiver<Order>,
    ) -> End {
        loop {
            let obeyed = match orders.try_recv() {
                Ok(order) => self.obey(order, port.as_mut(), reports),
                Err(TryRecvError::Empty) => Ok(()),
                Err(TryRecvError::Disconnected) => return End::Unwanted,
            };
            match obeyed.and_then(|()| forward(port.as_mut(), reports)) {
                Ok(true) => {}
                Ok(false) => return End::Unwanted,
                Err(error) => return End::Away(error.to_string()),
            }
        }
    }

    fn obey(
        &mut self,
        order: Order,
        port: &mut dyn SerialPort,
        reports: &Sender<Report>,
    ) -> io::Result<()> {
        match order {
            Order::Send(line) => {
                port.write_all(format!("{line}\n").as_bytes())?;
                port.flush()
            }
            Order::SetBaud(baud) if baud == self.baud => Ok(()),
            Order::SetBaud(baud) => {
                self.baud = baud;
                port.set_baud_rate(baud)?;
                Ok(port.clear(ClearBuffer::Input)?)
            }
            Order::SwitchBaud(switch) => {
                let line = &mut PortLine { port, reports };
                let result = baud::switch(switch.baud, self.baud, line)?;
                if let Ok(baud) = result {
                    self.baud = baud;
                }
                switch.report(result, reports);
                Ok(())
            }
        }
    }
}

/// Port while its baud rate changes. Received bytes are reported too.
struct PortLine<'a> {
    port: &'a mut dyn SerialPort,
    reports: &'a Sender<Report>,
}

impl Line for PortLine<'_> {
    fn send(&mut self, text: &str) -> io::Result<()> {
        self.port.write_all(format!("{text}\n").as_bytes())?;
        self.port.flush()
    }

    fn receive(&mut self) -> io::Result<Vec<u8>> {
        let bytes = read(self.port)?;
        if !bytes.is_empty() {
            self.reports.send(Report::Bytes(bytes.clone())).ok();
        }
        Ok(bytes)
    }

    fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        Ok(self.port.set_baud_rate(baud)?)
    }
}

/// Forwards received bytes. Returns false if the link was dropped.
fn forward(port: &mut dyn SerialPort, reports: &Sender<Report>) -> io::Result<bool> {
    let bytes = read(port)?;
    if bytes.is_empty() {
        return Ok(true);
    }
    let is_wanted = reports.send(Report::Bytes(bytes)).is_ok();
    std::thread::sleep(GATHER);
    Ok(is_wanted)
}

/// Reads the received bytes, perhaps none.
fn read(port: &mut dyn SerialPort) -> io::Result<Vec<u8>> {
    let mut buffer = [0; 4096];
    match port.read(&mut buffer) {
        Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
        Ok(length) => Ok(buffer[..length].to_vec()),
        Err(error)
            if matches!(
                error.kind(),
                io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
            ) =>
        {
            Ok(Vec::new())
        }
        Err(error) => Err(error),
    }
}

fn serve_process(mut child: Child, reports: &Sender<Report>, orders: &Receiver<Order>) {
    let (Some(mut input), Some(mut output), Some(mut errors)) =
        (child.stdin.take(), child.stdout.take(), child.stderr.take())
    else {
        return;
    };
    // The bytes go to the reports, and to a change of the baud rate.
    let (heard_sender, heard) = channel();
    let reader = {
        let reports = reports.clone();
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(length @ 1..) = output.read(&mut buffer) {
                let bytes = buffer[..length].to_vec();
                heard_sender.send(bytes.clone()).ok();
                if reports.send(Report::Bytes(bytes)).is_err() {
                    break;
                }
            }
        })
    };
    let errors = std::thread::spawn(move || {
        let mut text = String::new();
        errors.read_to_string(&mut text).ok();
        text
    });
    let mut line = ProcessLine {
        input: &mut input,
        heard: &heard,
    };
    let mut baud = BAUD;
    loop {
        let order = orders.recv_timeout(RETRY);
        // Answers to an order come after it.
        while line.heard.try_recv().is_ok() {}
        let obeyed = match order {
            Ok(Order::Send(text)) => line.send(&text),
            // A process has no baud rate, but the firmware on the virtual board has one.
            Ok(Order::SwitchBaud(switch)) => {
                baud::switch(switch.baud, baud, &mut line).map(|result| {
                    if let Ok(switched) = result {
                        baud = switched;
                    }
                    switch.report(result, reports);
                })
            }
            Ok(Order::SetBaud(_)) | Err(RecvTimeoutError::Timeout) if reader.is_finished() => break,
            Ok(Order::SetBaud(_)) | Err(RecvTimeoutError::Timeout) => Ok(()),
            Err(RecvTimeoutError::Disconnected) => break,
        };
        if obeyed.is_err() {
            break;
        }
    }
    child.kill().ok();
    child.wait().ok();
    let errors = errors.join().unwrap_or_default();
    let last = errors.lines().rfind(|line| !line.is_empty());
    let reason = last.unwrap_or("the virtual board has ended").to_owned();
    reports.send(Report::Ended(reason)).ok();
}

/// Process while the baud rate of its firmware changes.
struct ProcessLine<'a> {
    input: &'a mut ChildStdin,
    heard: &'a Receiver<Vec<u8>>,
}

impl Line for ProcessLine<'_> {
    fn send(&mut self, text: &str) -> io::Result<()> {
        writeln!(self.input, "{text}")?;
        self.input.flush()
    }

    fn receive(&mut self) -> io::Result<Vec<u8>> {
        match self.heard.recv_timeout(READ_TIMEOUT) {
            Ok(bytes) => Ok(bytes),
            Err(RecvTimeoutError::Timeout) => Ok(Vec::new()),
            Err(RecvTimeoutError::Disconnected) => Err(io::ErrorKind::UnexpectedEof.into()),
        }
    }

    fn set_baud(&mut self, _: u32) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(all(test, unix))]
#[path = "../tests/common/plug.rs"]
mod plug;

#[cfg(all(test, unix))]
mod tests {
    use std::time::Instant;

    use super::plug::Plug;
    use super::*;

    fn wait_for(link: &Link, what: impl Fn(&Report) -> bool) -> Report {
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(10) {
            if let Some(report) = link.next(Duration::from_millis(100)).filter(&what) {
                return report;
            }
        }
        panic!("nothing of the kind was reported");
    }

    fn wait_for_bytes(link: &Link, bytes: &[u8]) {
        let mut got = Vec::new();
        while got != bytes {
            match wait_for(link, |report| matches!(report, Report::Bytes(_))) {
                Report::Bytes(more) => got.extend(more),
                _ => unreachable!("it was asked for bytes"),
            }
            assert!(bytes.starts_with(&got), "{got:?}");
        }
    }

    #[test]
    fn a_port_that_goes_away_comes_back_and_takes_commands_again() {
        let mut plug = Plug::new("replug");
        let link = Link::port(plug.name(), BAUD).expect("it opens");
        plug.send(b"one\n\0\xFFtwo");
        wait_for_bytes(&link, b"one\n\0\xFFtwo");
        plug.unplug();
        wait_for(&link, |report| matches!(report, Report::Away(_)));
        link.send_line("lost");
        plug.plug_in();
        wait_for(&link, |report| *report == Report::Back);
        plug.send(b"three");
        wait_for_bytes(&link, b"three");
        link.send_line("status");
        assert_eq!(plug.hear().as_deref(), Some("status"));
    }

    #[test]
    fn the_port_changes_its_rate_only_if_the_module_does() {
        let mut plug = Plug::new("switch");
        let link = Link::port(plug.name(), BAUD).expect("it opens");
        let is_answer = |report: &Report| matches!(report, Report::Switched(_));
        let refusal = "error refused while armed: \"disarm\" first";
        for (answer, expected) in [
            (format!("# {refusal}\n"), Err(refusal.to_owned())),
            (String::new(), Err(Failure::Unanswered.to_string())),
            ("# ok baud 921600 from now on; say\n".into(), Ok(921_600)),
        ] {
            assert_eq!(plug.baud(), BAUD);
            link.switch_baud(921_600);
            assert_eq!(plug.hear().as_deref(), Some("baud 921600"));
            plug.send(answer.as_bytes());
            if expected.is_ok() {
                plug.confirm_baud(921_600);
            }
            assert_eq!(wait_for(&link, is_answer), Report::Switched(expected));
        }
        assert_eq!(plug.baud(), 921_600);
    }

    #[test]
    fn a_port_that_another_has_says_so() {
        let plug = Plug::new("busy");
        let name = plug.name();
        let _other = open(name, BAUD).expect("it opens once");
        let error = Link::port(name, BAUD).err().expect("but not twice");
        assert!(error.contains("another program has it open"), "{error}");
        let error = Link::port("/dev/no-such-port", BAUD).err().expect("none");
        assert!(error.contains("there is no such port"), "{error}");
    }

    #[test]
    fn a_change_of_a_process_is_reported_once_it_is_confirmed() {
        let mut command = Command::new("sh");
        let script = "read a; echo '# ok baud 921600 from now on'
            read b; read c; read d; read e; echo \"# ok $e: as before\"; read f";
        command.args(["-c", script]);
        let link = Link::process(command).expect("there is a shell");
        link.switch_baud(921_600);
        let is_result = |report: &Report| matches!(report, Report::Switched(_));
        assert_eq!(wait_for(&link, is_result), Report::Switched(Ok(921_600)));
    }

    #[test]
    fn a_process_speaks_and_is_spoken_to_and_its_end_says_why() {
        let mut command = Command::new("sh");
        command.args([
            "-c",
            "echo hello; read line; echo \"got $line\"; echo 'error: no image' >&2",
        ]);
        let link = Link::process(command).expect("there is a shell");
        wait_for_bytes(&link, b"hello\n");
        link.send_line("status");
        wait_for_bytes(&link, b"got status\n");
        let end = wait_for(&link, |report| matches!(report, Report::Ended(_)));
        assert_eq!(end, Report::Ended("error: no image".into()));
    }
}
