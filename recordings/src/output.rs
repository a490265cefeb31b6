//! Output files. A file appears under its name when it is complete.
//!
//! `-` is standard output; then other text goes to standard error. A device or a pipe is written at
//! once. Through a link its target is written, so the link stays.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, MutexGuard};

use flate2::Compression;
use flate2::write::GzEncoder;

/// Name of an output that is standard output.
const STANDARD_OUTPUT: &str = "-";
/// Name of an input that is standard input.
const STANDARD_INPUT: &str = "-";
/// Links in a row that are followed; Linux follows 40.
const MOST_LINKS: usize = 64;
/// Exit code after Ctrl-C, by the custom of shells: 128 and the signal's number.
const ENDED_BY_CTRL_C: i32 = 130;

/// Output file, gzipped if its name ends with .gz.
#[derive(Debug)]
pub struct OutputFile {
    path: PathBuf,
    unfinished: Option<Unfinished>,
    sink: Sink,
}

/// Unfinished file, and the name that it gets in the end.
#[derive(Debug)]
struct Unfinished {
    path: PathBuf,
    target: PathBuf,
}

#[derive(Debug)]
enum Sink {
    Plain(BufWriter<File>),
    Zipped(Box<GzEncoder<BufWriter<File>>>),
    Standard(BufWriter<io::Stdout>),
}

impl OutputFile {
    /// Creates a file, which must not be one of these inputs.
    ///
    /// # Errors
    ///
    /// Returns a message with the path if the file cannot be created, or is an input.
    pub fn create(path: &Path, inputs: &[&Path]) -> Result<Self, String> {
        refuse_to_overwrite(path, inputs)?;
        let failed = |error: io::Error| cannot_write(path, &error);
        if path == Path::new(STANDARD_OUTPUT) {
            crate::terminal::use_standard_error();
            return Ok(Self {
                path: PathBuf::from("standard output"),
                unfinished: None,
                sink: Sink::Standard(BufWriter::with_capacity(256 * 1024, io::stdout())),
            });
        }
        let (unfinished, file) = match target(path).map_err(failed)? {
            None => (None, open(path).map_err(failed)?),
            Some(target) => {
                let (unfinished, file) = Unfinished::create(target).map_err(failed)?;
                (Some(unfinished), file)
            }
        };
        let file = BufWriter::with_capacity(256 * 1024, file);
        let sink = match path.extension() {
            Some(extension) if extension.eq_ignore_ascii_case("gz") => {
                Sink::Zipped(Box::new(GzEncoder::new(file, Compression::default())))
            }
            _ => Sink::Plain(file),
        };
        Ok(Self {
            path: path.to_owned(),
            unfinished,
            sink,
        })
    }

    /// Writes a whole file.
    ///
    /// # Errors
    ///
    /// Returns a message with the path if the file cannot be written, or is an input.
    pub fn write(path: &Path, inputs: &[&Path], contents: &[u8]) -> Result<(), String> {
        let mut file = Self::create(path, inputs)?;
        file.write_all(contents)
            .map_err(|error| cannot_write(path, &error))?;
        file.finish()
    }

    /// Completes the file, and gives it its name.
    ///
    /// # Errors
    ///
    /// Returns a message with the path if the file cannot be completed.
    pub fn finish(mut self) -> Result<(), String> {
        let written = match &mut self.sink {
            Sink::Plain(file) => file.flush(),
            Sink::Standard(output) => end_if_closed(output.flush()),
            Sink::Zipped(file) => file.try_finish().and_then(|()| file.get_mut().flush()),
        };
        written
            .and_then(|()| match &self.unfinished {
                Some(unfinished) => std::fs::rename(&unfinished.path, &unfinished.target),
                None => Ok(()),
            })
            .map_err(|error| self.failed(&error))
    }

    /// Returns the message of a failed write.
    #[must_use]
    pub fn failed(&self, error: &io::Error) -> String {
        cannot_write(&self.path, error)
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.sink {
            Sink::Plain(file) => file.write(bytes),
            Sink::Zipped(file) => file.write(bytes),
            Sink::Standard(output) => end_if_closed(output.write(bytes)),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.sink {
            Sink::Plain(file) => file.flush(),
            Sink::Zipped(file) => file.flush(),
            Sink::Standard(output) => end_if_closed(output.flush()),
        }
    }
}

/// Ends the program without an error if the reader of standard output has enough, as `head` has.
fn end_if_closed<T>(written: io::Result<T>) -> io::Result<T> {
    if let Err(error) = &written
        && error.kind() == io::ErrorKind::BrokenPipe
    {
        std::process::exit(0);
    }
    written
}

impl Unfinished {
    /// Creates a file beside the target, with a name that no other file has.
    fn create(target: PathBuf) -> io::Result<(Self, File)> {
        let mut number = 1;
        loop {
            let mut path = target.as_os_str().to_owned();
            path.push(".unfinished");
            if number > 1 {
                path.push(number.to_string());
            }
            let path = PathBuf::from(path);
            let mut all = all_unfinished();
            match File::create_new(&path) {
                Ok(file) => {
                    all.push(path.clone());
                    return Ok((Self { path, target }, file));
                }
                // A file of another run, or left by one that was killed.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(error),
            }
        }
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        all_unfinished().retain(|path| *path != self.path);
        // After `finish` the file has its final name.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// Returns the unfinished files of this run. Ctrl-C removes them.
fn all_unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    static ALL: LazyLock<Mutex<Vec<PathBuf>>> = LazyLock::new(|| {
        // Another handler, or ignored signals, stay.
        let _ = ctrlc::try_set_handler(|| {
            for path in all_unfinished().drain(..) {
                let _ = std::fs::remove_file(path);
            }
            std::process::exit(ENDED_BY_CTRL_C);
        });
        Mutex::default()
    });
    ALL.lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Returns the file to write, which need not exist: the target of links. Returns `None` for what is
/// written at once: a device, a pipe, or an open file such as /dev/stdout.
fn target(path: &Path) -> io::Result<Option<PathBuf>> {
    match path.metadata() {
        Ok(data) if data.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
        Ok(data) if data.is_file() => check_writable(path)?,
        Ok(data) if !data.is_file() => return Ok(None),
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mut path = path.to_owned();
    for _ in 0..MOST_LINKS {
        let folder = match path.parent() {
            Some(folder) if !folder.as_os_str().is_empty() => folder,
            _ => Path::new("."),
        };
        if folder
            .canonicalize()
            .is_ok_and(|folder| folder.starts_with("/proc") || folder.starts_with("/dev/fd"))
        {
            return Ok(None);
        }
        match path.read_link() {
            Ok(link) => path = folder.join(link),
            Err(_) => return Ok(Some(path)),
        }
    }
    Err(io::Error::other("too many links"))
}

/// Opens a file that is written at once. For standard output, uses the open one, so that later text
/// does not overwrite it.
fn open(path: &Path) -> io::Result<File> {
    #[cfg(unix)]
    if is_same_file(path, Path::new("/proc/self/fd/1")) {
        use std::os::fd::AsFd as _;
        return Ok(io::stdout().as_fd().try_clone_to_owned()?.into());
    }
    File::options().append(true).open(path)
}

/// Refuses an existing file that is read-only. A new file in its place would need the folder's
/// permission alone, and the administrator may write any file.
///
/// # Errors
///
/// Returns an error that says so.
pub fn check_writable(path: &Path) -> io::Result<()> {
    match path.metadata() {
        Ok(data) if data.is_file() && data.permissions().readonly() => Err(io::Error::new(
            io::ErrorKind::PermissionDenied,
            "the file is read-only",
        )),
        _ => Ok(()),
    }
}

/// Refuses an output that is one of these inputs. An input `-` is standard input: it is the output
/// if it comes from that file.
///
/// # Errors
///
/// Returns a message with both names.
pub fn refuse_to_overwrite(output: &Path, inputs: &[&Path]) -> Result<(), String> {
    let is_standard = |input: &Path| input == Path::new(STANDARD_INPUT);
    let is_output = |input: &Path| match is_standard(input) {
        true => is_standard_input(output),
        false => is_same_file(output, input),
    };
    let Some(input) = inputs.iter().find(|input| is_output(input)) else {
        return Ok(());
    };
    let input = match is_standard(input) {
        true => "on standard input".to_owned(),
        false => input.display().to_string(),
    };
    let output = output.display();
    Err(format!(
        "{output}: the output would replace the input {input}: choose another name"
    ))
}

/// Returns whether standard input comes from this file.
fn is_standard_input(path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::fd::AsFd as _;
        use std::os::unix::fs::MetadataExt as _;
        let input = io::stdin().as_fd().try_clone_to_owned();
        let input = input.and_then(|input| File::from(input).metadata()).ok();
        let files = input.zip(path.metadata().ok());
        // A device may be both, such as /dev/null.
        files.is_some_and(|(input, output)| {
            input.is_file() && (input.dev(), input.ino()) == (output.dev(), output.ino())
        })
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        false
    }
}

fn is_same_file(one: &Path, other: &Path) -> bool {
    // A missing file, or standard input, is no other file.
    let paths = one.canonicalize().ok().zip(other.canonicalize().ok());
    paths.is_some_and(|(one, other)| one == other)
}

/// Returns the message for a file that cannot be written.
#[must_use]
pub fn cannot_write(path: &Path, error: &io::Error) -> String {
    let mut message = format!("{}: cannot be written: {error}", path.display());
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        message.push_str(&format!("; there is no folder {}", folder.display()));
    }
    message
}
