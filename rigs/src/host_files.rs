//! Access to files of the computer that runs QEMU, by semihosting (Arm, "Semihosting for AArch32
//! and AArch64").

use core::fmt;

use cortex_m_semihosting::debug::{self, EXIT_FAILURE, EXIT_SUCCESS};
use cortex_m_semihosting::{nr, syscall};
use heapless::{String, Vec};

/// Longest path, in bytes.
const PATH_LENGTH: usize = 256;
/// Length of one read from the host, in bytes.
const BLOCK_LENGTH: usize = 512;

/// Returns the program's three arguments from QEMU's command line, or `None` if there are not
/// three.
pub fn arguments() -> Option<[String<PATH_LENGTH>; 3]> {
    let mut buffer = [0_u8; 3 * PATH_LENGTH];
    let mut block = [buffer.as_mut_ptr() as usize, buffer.len()];
    // SAFETY: the call writes at most `buffer.len()` bytes into the buffer, and the length into the
    // block's second word. The volatile read below sees that length.
    let (failed, length) = unsafe {
        let failed = cortex_m_semihosting::syscall1(nr::GET_CMDLINE, block.as_mut_ptr() as usize);
        (failed, block.as_ptr().add(1).read_volatile())
    };
    let text = core::str::from_utf8(buffer.get(..length)?).ok()?;
    let words: Vec<String<PATH_LENGTH>, 3> = text
        .split_ascii_whitespace()
        .map(String::try_from)
        .collect::<Result<_, _>>()
        .ok()?;
    (failed == 0).then_some(())?;
    words.into_array().ok()
}

/// Ends QEMU with status 0 if `succeeded`, else 1.
pub fn exit(succeeded: bool) -> ! {
    loop {
        debug::exit(if succeeded {
            EXIT_SUCCESS
        } else {
            EXIT_FAILURE
        });
    }
}

/// Open file, read or written in blocks.
pub struct HostFile {
    handle: usize,
    buffer: [u8; BLOCK_LENGTH],
    start: usize,
    end: usize,
}

impl HostFile {
    /// Opens a file to read; `None` if the host refuses.
    pub fn open(path: &str) -> Option<Self> {
        Self::with_mode(path, nr::open::R_BINARY)
    }

    /// Creates a file to write, or empties it; `None` if the host refuses.
    pub fn create(path: &str) -> Option<Self> {
        Self::with_mode(path, nr::open::W_TRUNC_BINARY)
    }

    /// Returns the next line without its end, `None` after the last. `line` is the buffer; a longer
    /// line is cut off.
    pub fn read_line<'a>(&mut self, line: &'a mut [u8]) -> Option<&'a str> {
        let mut length = 0;
        loop {
            if self.start == self.end {
                self.refill();
            }
            let Some(&byte) = self.buffer.get(self.start..self.end)?.first() else {
                break;
            };
            self.start += 1;
            if byte == b'\n' {
                return core::str::from_utf8(line.get(..length)?).ok();
            }
            if let Some(place) = line.get_mut(length) {
                *place = byte;
                length += 1;
            }
        }
        (length > 0).then_some(())?;
        core::str::from_utf8(line.get(..length)?).ok()
    }

    fn refill(&mut self) {
        // SAFETY: the call writes at most `buffer.len()` bytes into the buffer, and returns how
        // many it did not.
        let missing = unsafe {
            syscall!(
                READ,
                self.handle,
                self.buffer.as_mut_ptr(),
                self.buffer.len()
            )
        };
        self.start = 0;
        self.end = self.buffer.len().saturating_sub(missing);
    }

    fn with_mode(path: &str, mode: usize) -> Option<Self> {
        let mut terminated: String<{ PATH_LENGTH + 1 }> = String::new();
        terminated.push_str(path).ok()?;
        terminated.push('\0').ok()?;
        // SAFETY: the path ends with a zero, which the length does not count.
        let handle = unsafe { syscall!(OPEN, terminated.as_ptr(), mode, path.len()) };
        (handle != usize::MAX).then_some(Self {
            handle,
            buffer: [0; BLOCK_LENGTH],
            start: 0,
            end: 0,
        })
    }
}

impl fmt::Write for HostFile {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        // SAFETY: the call reads the text and returns how many bytes it did not write.
        let missing = unsafe { syscall!(WRITE, self.handle, text.as_ptr(), text.len()) };
        if missing == 0 {
            Ok(())
        } else {
            Err(fmt::Error)
        }
    }
}
