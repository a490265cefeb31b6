//! The board's serial port for other programs: standard input and output, a pseudo-terminal, or a
//! TCP port. Raw bytes in both directions.
//!
//! Threads do the reading and the writing, so that no slow program delays the board. As on a real
//! port, bytes that nobody reads are lost.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

/// Pieces of output that wait for a slow reader. One has the bytes of a few milliseconds.
const WAITING_PIECES: usize = 1_000;

/// Ends of the port: bytes to the board, and bytes from it.
pub struct Port {
    received: Receiver<Vec<u8>>,
    to_send: SyncSender<Vec<u8>>,
    /// The other end of a pseudo-terminal, open so that it stays when a program leaves it.
    #[cfg(unix)]
    _kept: Option<std::os::fd::OwnedFd>,
}

impl Port {
    /// Uses standard input and output. Ends the program when either is closed.
    pub fn standard() -> Self {
        let (received_sender, received) = channel();
        let (to_send, pieces) = sync_channel(WAITING_PIECES);
        thread::spawn(move || {
            read_all(io::stdin(), &received_sender);
            process::exit(0);
        });
        thread::spawn(move || {
            write_all(io::stdout(), &pieces);
            process::exit(0);
        });
        Self {
            received,
            to_send,
            #[cfg(unix)]
            _kept: None,
        }
    }

    /// Opens a pseudo-terminal. Returns its name too.
    ///
    /// # Errors
    ///
    /// Returns the error of the system.
    #[cfg(unix)]
    pub fn pseudo_terminal() -> io::Result<(Self, String)> {
        use rustix::fs::{Mode, OFlags, open};
        use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
        use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
        let board = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&board)?;
        unlockpt(&board)?;
        let name = ptsname(&board, Vec::new())?;
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let other = open(&name, flags, Mode::empty())?;
        // No echo, no lines, all bytes.
        let mut settings = tcgetattr(&other)?;
        settings.make_raw();
        tcsetattr(&other, OptionalActions::Now, &settings)?;
        let name = name.to_string_lossy().into_owned();
        let writer = std::fs::File::from(board);
        let reader = writer.try_clone()?;
        let (received_sender, received) = channel();
        let (to_send, pieces) = sync_channel(WAITING_PIECES);
        thread::spawn(move || read_all(reader, &received_sender));
        thread::spawn(move || write_all(writer, &pieces));
        let port = Self {
            received,
            to_send,
            _kept: Some(other),
        };
        Ok((port, name))
    }

    /// Listens on a TCP port, to one program after another. Returns the address, which names the
    /// port that was chosen for port 0.
    ///
    /// # Errors
    ///
    /// Returns the error of the system.
    pub fn tcp(address: SocketAddr) -> io::Result<(Self, SocketAddr)> {
        let listener = TcpListener::bind(address)?;
        let address = listener.local_addr()?;
        let (received_sender, received) = channel();
        let (to_send, pieces) = sync_channel(WAITING_PIECES);
        let client: Arc<Mutex<Option<TcpStream>>> = Arc::default();
        let writing = Arc::clone(&client);
        thread::spawn(move || listen(&listener, &client, &received_sender));
        thread::spawn(move || serve(&writing, &pieces));
        let port = Self {
            received,
            to_send,
            #[cfg(unix)]
            _kept: None,
        };
        Ok((port, address))
    }

    /// Sends bytes of the board. Bytes that nobody takes are lost.
    pub fn send(&self, bytes: Vec<u8>) {
        if !bytes.is_empty() {
            let _ = self.to_send.try_send(bytes);
        }
    }

    /// Returns the bytes that have come for the board.
    pub fn receive(&self) -> Vec<u8> {
        self.received.try_iter().flatten().collect()
    }
}

/// Reads until the end.
fn read_all(mut from: impl Read, to: &Sender<Vec<u8>>) {
    let mut buffer = [0; 4096];
    loop {
        match from.read(&mut buffer) {
            Ok(0) => return,
            Ok(length) if to.send(buffer[..length].to_vec()).is_err() => return,
            Err(error) if error.kind() != io::ErrorKind::Interrupted => return,
            _ => {}
        }
    }
}

/// Writes until an error.
fn write_all(mut to: impl Write, from: &Receiver<Vec<u8>>) {
    for bytes in from {
        if to.write_all(&bytes).and_then(|()| to.flush()).is_err() {
            return;
        }
    }
}

/// Takes programs, one after the other, and reads from each until it leaves.
fn listen(listener: &TcpListener, client: &Mutex<Option<TcpStream>>, received: &Sender<Vec<u8>>) {
    for stream in listener.incoming().flatten() {
        // An attitude should not wait for the next.
        let _ = stream.set_nodelay(true);
        let Ok(writer) = stream.try_clone() else {
            continue;
        };
        *client.lock().unwrap_or_else(PoisonError::into_inner) = Some(writer);
        read_all(stream, received);
        *client.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

/// Writes to the program that is connected, if there is one.
fn serve(client: &Mutex<Option<TcpStream>>, pieces: &Receiver<Vec<u8>>) {
    for bytes in pieces {
        let stream = client
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .as_ref()
            .and_then(|stream| stream.try_clone().ok());
        if let Some(mut stream) = stream {
            // A program that has left is noticed by its reader.
            let _ = stream.write_all(&bytes);
        }
    }
}
