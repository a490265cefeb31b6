//! Files that are written: each appears under its name when it is complete. A device or a pipe is written as it goes, and
//! where a link leads is written, so that the link stays.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{LazyLock, Mutex, MutexGuard};

use flate2::Compression;
use flate2::write::GzEncoder;

/// More links in a row than any system follows (Linux: 40).
const MOST_LINKS: usize = 64;
/// What a program says that Ctrl-C ended, by the custom of shells: 128 and the signal's number.
const ENDED_BY_CTRL_C: i32 = 130;

/// A file that is being written; gzipped if its name ends with .gz.
pub struct OutputFile {
    path: PathBuf,
    unfinished: Option<Unfinished>,
    sink: Sink,
}

/// What is written until it is complete, and the name that it then gets.
struct Unfinished {
    path: PathBuf,
    target: PathBuf,
}

enum Sink {
    Plain(BufWriter<File>),
    Zipped(Box<GzEncoder<BufWriter<File>>>),
}

impl OutputFile {
    /// Begins a file that must not be one of these inputs.
    pub fn create(path: &Path, inputs: &[&Path]) -> Result<Self, String> {
        if inputs.iter().any(|input| is_same_file(path, input)) {
            return Err(format!(
                "{}: the output would replace the input",
                path.display()
            ));
        }
        let failed = |error: io::Error| cannot_write(path, &error);
        let (unfinished, file) = match target(path).map_err(failed)? {
            None => (None, open(path).map_err(failed)?),
            Some(target) => {
                let (unfinished, file) = Unfinished::create(target).map_err(failed)?;
                (Some(unfinished), file)
            }
        };
        let file = BufWriter::with_capacity(256 * 1024, file);
        let sink = match path.extension() {
            Some(extension) if extension == "gz" => {
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

    /// Writes a whole file at once.
    pub fn write(path: &Path, inputs: &[&Path], contents: &[u8]) -> Result<(), String> {
        let mut file = Self::create(path, inputs)?;
        file.write_all(contents)
            .map_err(|error| cannot_write(path, &error))?;
        file.finish()
    }

    /// Gives it its name.
    pub fn finish(mut self) -> Result<(), String> {
        let written = match &mut self.sink {
            Sink::Plain(file) => file.flush(),
            Sink::Zipped(file) => file.try_finish().and_then(|()| file.get_mut().flush()),
        };
        written
            .and_then(|()| match &self.unfinished {
                Some(unfinished) => std::fs::rename(&unfinished.path, &unfinished.target),
                None => Ok(()),
            })
            .map_err(|error| self.failed(&error))
    }

    /// What to say of an error.
    pub fn failed(&self, error: &io::Error) -> String {
        cannot_write(&self.path, error)
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.sink {
            Sink::Plain(file) => file.write(bytes),
            Sink::Zipped(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.sink {
            Sink::Plain(file) => file.flush(),
            Sink::Zipped(file) => file.flush(),
        }
    }
}

impl Unfinished {
    /// Beside the target, under a name that no other file has.
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
                // Another run's, or left by one that was killed.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
                Err(error) => return Err(error),
            }
        }
    }
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        all_unfinished().retain(|path| *path != self.path);
        // After `finish` it is gone already.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// The unfinished files of this run. Ctrl-C removes them.
fn all_unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    static ALL: LazyLock<Mutex<Vec<PathBuf>>> = LazyLock::new(|| {
        // Whoever set another handler, or has signals ignored, keeps that.
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

/// The file that gets this name, be it there yet or not: where links lead. `None` for what is written as it goes: a
/// device, a pipe, or what is open already, as /dev/stdout is.
fn target(path: &Path) -> io::Result<Option<PathBuf>> {
    match path.metadata() {
        Ok(data) if data.is_dir() => return Err(io::ErrorKind::IsADirectory.into()),
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

/// Opens what is written as it goes. Standard output is the one that is open already, so that what follows does not
/// overwrite it.
fn open(path: &Path) -> io::Result<File> {
    #[cfg(unix)]
    if is_same_file(path, Path::new("/proc/self/fd/1")) {
        use std::os::fd::AsFd as _;
        return Ok(io::stdout().as_fd().try_clone_to_owned()?.into());
    }
    File::options().append(true).open(path)
}

fn is_same_file(one: &Path, other: &Path) -> bool {
    // What is not there yet, or is standard input, is no other file.
    let paths = one.canonicalize().ok().zip(other.canonicalize().ok());
    paths.is_some_and(|(one, other)| one == other)
}

/// Why a file cannot be written, and what to do.
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
