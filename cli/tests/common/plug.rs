//! Module at the end of a pseudo-terminal that can be unplugged and plugged in again, under a
//! name that stays.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// Longest wait of the module.
const PATIENCE: Duration = Duration::from_secs(10);

/// Module's end, and the name of the port.
pub struct Plug {
    name: PathBuf,
    module: Option<File>,
    /// Beginning of the next line.
    heard: Vec<u8>,
    /// Last command that confirmed a baud rate. Repetitions of it may follow.
    confirmed: Option<String>,
}

impl Plug {
    /// Creates a module that is plugged in.
    pub fn new(test: &str) -> Self {
        let name = std::env::temp_dir().join(format!("aplomb-{test}-{}", std::process::id()));
        let mut plug = Self {
            name,
            module: None,
            heard: Vec::new(),
            confirmed: None,
        };
        plug.plug_in();
        plug
    }

    /// Returns the name of the port.
    pub fn name(&self) -> &str {
        self.name.to_str().expect("a name that is text")
    }

    /// Plugs the module in as another device, as after a real adapter's return.
    pub fn plug_in(&mut self) {
        // No child keeps it open when it is unplugged.
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let module = openpt(flags).expect("a pseudo-terminal");
        grantpt(&module).expect("it can be granted");
        unlockpt(&module).expect("it can be unlocked");
        let port = ptsname(&module, Vec::new()).expect("it has a name");
        let port = Path::new(std::ffi::OsStr::from_bytes(port.to_bytes()));
        std::fs::remove_file(&self.name).ok();
        symlink(port, &self.name).expect("a link");
        self.module = Some(module.into());
        self.heard.clear();
    }

    /// Unplugs the module.
    pub fn unplug(&mut self) {
        std::fs::remove_file(&self.name).expect("the link is there");
        self.module = None;
    }

    /// Sends bytes once the other end is open.
    pub fn send(&mut self, bytes: &[u8]) {
        self.send_within(bytes, PATIENCE).expect("somebody listens");
    }

    /// Sends bytes in pieces for which a pseudo-terminal has room. The error is that the other end
    /// is not open, or is slower than this.
    pub fn send_within(&mut self, bytes: &[u8], patience: Duration) -> io::Result<()> {
        for piece in bytes.chunks(512) {
            // What is sent to nobody would come back as an echo.
            self.wait_within(PollFlags::OUT, patience)?;
            let module = self.module.as_mut().expect("it is plugged in");
            module.write_all(piece).expect("it takes it");
            sleep(Duration::from_millis(2));
        }
        Ok(())
    }

    /// Returns the next line, or `None` after some seconds. Skips empty lines, and repetitions of
    /// a command that has confirmed a baud rate.
    pub fn hear(&mut self) -> Option<String> {
        self.hear_within(PATIENCE)
    }

    /// Like [`hear`](Self::hear), with a bound for the silence before each byte.
    pub fn hear_within(&mut self, patience: Duration) -> Option<String> {
        loop {
            self.wait_within(PollFlags::IN, patience).ok()?;
            let mut byte = [0];
            self.module.as_mut()?.read_exact(&mut byte).ok()?;
            if byte != *b"\n" {
                self.heard.extend(byte);
                continue;
            }
            let line = String::from_utf8(std::mem::take(&mut self.heard)).ok()?;
            if !line.is_empty() && self.confirmed.as_ref() != Some(&line) {
                self.confirmed = None;
                return Some(line);
            }
        }
    }

    /// Waits for the first command at a new baud rate, and answers it with these bytes.
    pub fn confirm_baud_with(&mut self, baud: u32, answer: &[u8]) {
        let command = format!("baud {baud}");
        while self.hear().expect("the rate is confirmed") != command {}
        self.confirmed = Some(command);
        self.send(answer);
    }

    /// Like [`confirm_baud_with`](Self::confirm_baud_with), with the module's answer.
    pub fn confirm_baud(&mut self, baud: u32) {
        let answer = format!("# ok baud {baud}: as before\n");
        self.confirm_baud_with(baud, answer.as_bytes());
    }

    /// Returns the baud rate of the port's side.
    pub fn baud(&self) -> u32 {
        let module = self.module.as_ref().expect("it is plugged in");
        let settings = rustix::termios::tcgetattr(module).expect("a terminal");
        settings.output_speed()
    }

    /// Waits until the line can be read or written, with the other end open.
    fn wait_within(&self, event: PollFlags, patience: Duration) -> io::Result<()> {
        let module = self.module.as_ref().ok_or(ErrorKind::NotConnected)?;
        let start = Instant::now();
        let mut has_waited = false;
        while start.elapsed() < patience {
            let mut polled = [PollFd::new(module, event)];
            let timeout = Timespec {
                tv_sec: 0,
                tv_nsec: 20_000_000,
            };
            poll(&mut polled, Some(&timeout))?;
            let found = polled[0].revents();
            // What was said before the end can still be heard.
            let is_heard = event == PollFlags::IN;
            if found.contains(event) && (is_heard || !found.contains(PollFlags::HUP)) {
                if has_waited {
                    // Whoever has just opened it has yet to set it up.
                    sleep(Duration::from_millis(50));
                }
                return Ok(());
            }
            has_waited = true;
            sleep(Duration::from_millis(5));
        }
        Err(ErrorKind::TimedOut.into())
    }
}

impl Drop for Plug {
    fn drop(&mut self) {
        std::fs::remove_file(&self.name).ok();
    }
}
