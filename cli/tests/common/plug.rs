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
}

impl Plug {
    /// Creates a module that is plugged in.
    pub fn new(test: &str) -> Self {
        let name = std::env::temp_dir().join(format!("aplomb-{test}-{}", std::process::id()));
        let mut plug = Self { name, module: None };
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
    }

    /// Unplugs the module.
    pub fn unplug(&mut self) {
        std::fs::remove_file(&self.name).expect("the link is there");
        self.module = None;
    }

    /// Sends bytes in pieces for which a pseudo-terminal has room, once the other end is open.
    pub fn send(&mut self, bytes: &[u8]) {
        for piece in bytes.chunks(512) {
            // What is sent to nobody would come back as an echo.
            self.wait_for(PollFlags::OUT).expect("somebody listens");
            let module = self.module.as_mut().expect("it is plugged in");
            module.write_all(piece).expect("it takes it");
            sleep(Duration::from_millis(2));
        }
    }

    /// Returns the next line, or `None` after some seconds.
    pub fn hear(&mut self) -> Option<String> {
        let mut line = Vec::new();
        loop {
            self.wait_for(PollFlags::IN).ok()?;
            let mut byte = [0];
            self.module.as_mut()?.read_exact(&mut byte).ok()?;
            if byte == *b"\n" {
                return String::from_utf8(line).ok();
            }
            line.extend(byte);
        }
    }

    /// Returns the baud rate of the port's side.
    pub fn baud(&self) -> u32 {
        let module = self.module.as_ref().expect("it is plugged in");
        let settings = rustix::termios::tcgetattr(module).expect("a terminal");
        settings.output_speed()
    }

    /// Waits until the line can be read or written, with the other end open.
    fn wait_for(&self, event: PollFlags) -> io::Result<()> {
        let module = self.module.as_ref().ok_or(ErrorKind::NotConnected)?;
        let start = Instant::now();
        let mut has_waited = false;
        while start.elapsed() < PATIENCE {
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
