//! Files that are written: each appears under its name when it is complete. A device or a pipe is written as it goes.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

/// A file that is being written; gzipped if its name ends with .gz.
pub struct OutputFile {
    path: PathBuf,
    unfinished: Option<PathBuf>,
    sink: Sink,
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
        let is_device = path
            .metadata()
            .is_ok_and(|data| !data.is_file() && !data.is_dir());
        let (unfinished, file) = if is_device {
            let file = File::options().write(true).open(path);
            (None, file.map_err(failed)?)
        } else {
            let mut unfinished = path.as_os_str().to_owned();
            unfinished.push(".unfinished");
            let unfinished = PathBuf::from(unfinished);
            let file = File::create(&unfinished).map_err(failed)?;
            (Some(unfinished), file)
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
                Some(unfinished) => std::fs::rename(unfinished, &self.path),
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

impl Drop for OutputFile {
    fn drop(&mut self) {
        if let Some(unfinished) = &self.unfinished {
            // After `finish` it is gone already.
            let _ = std::fs::remove_file(unfinished);
        }
    }
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
