//! `cargo xtask release --dry-run`: makes and checks the files of a release, and publishes nothing.
//!
//! The folder `target/release-files` then holds an archive of the program, one of the C library
//! with its header, the Python wheel and its sources. The library is packed and built as a registry
//! would have it.

use std::fs;
use std::path::{Path, PathBuf};

use crate::{build, c_library, package, python, step};

/// Files of each archive.
const LICENCES: [&str; 3] = ["LICENSE-APACHE", "LICENSE-MIT", "CHANGELOG.md"];

/// Makes and checks a release.
pub fn dry_run() -> Result<(), String> {
    let version = version()?;
    step::timed("the library's package", package::check)?;
    step::timed("licences of dependencies", crate::test::check_dependencies)?;
    let folder = step::target_folder().join("release-files");
    let text = |error: std::io::Error| format!("{}: {error}", folder.display());
    if folder.exists() {
        fs::remove_dir_all(&folder).map_err(text)?;
    }
    fs::create_dir_all(&folder).map_err(text)?;
    let host = host()?;
    step::timed("the program's archive", || {
        let program = build::program()?;
        let files = [program, root("README.md")].into_iter().chain(licences());
        let name = format!("aplomb-cli-{version}-{host}");
        pack(&folder, &name, files.map(|file| (file, String::new())))
    })?;
    step::timed("the archive of the C library", || {
        let files = [
            ("c/include/aplomb.h", "include"),
            ("docs/c.md", ""),
            ("c/examples/host.c", "examples"),
            ("c/examples/cube_loop.c", "examples"),
            ("c/examples/cube_loop.h", "examples"),
            ("c/examples/hal.h", "examples"),
            ("c/examples/scheduler_task.c", "examples"),
            ("c/examples/scheduler_task.h", "examples"),
        ];
        let files = files.map(|(file, folder)| (root(file), folder.to_owned()));
        let libraries = c_library::build(&host)?;
        let libraries = libraries
            .into_iter()
            .map(|(target, library)| (library, format!("lib/{target}")));
        let licences = licences().map(|file| (file, String::new()));
        let all = files.into_iter().chain(libraries).chain(licences);
        pack(&folder, &format!("aplomb-c-{version}"), all)
    })?;
    python::package(&folder)?;
    eprintln!("\nversion {version}, in {}:", folder.display());
    for entry in fs::read_dir(&folder).map_err(text)?.flatten() {
        let bytes = entry.metadata().map_err(text)?.len();
        eprintln!("   {} ({bytes} bytes)", entry.file_name().display());
    }
    eprintln!("nothing was published; CONTRIBUTING.md says how to");
    Ok(())
}

/// Returns the version. All packages have to have it, and the changelog a section.
fn version() -> Result<String, String> {
    let read =
        |file: &str| fs::read_to_string(root(file)).map_err(|error| format!("{file}: {error}"));
    let of = |manifest: &str| {
        let line = manifest
            .lines()
            .find_map(|line| line.strip_prefix("version = \""));
        line.and_then(|rest| rest.strip_suffix('"'))
            .map(str::to_owned)
    };
    let version = of(&read("Cargo.toml")?).ok_or("Cargo.toml has no version")?;
    if of(&read("python/Cargo.toml")?).as_ref() != Some(&version) {
        return Err(format!(
            "python/Cargo.toml has another version than {version}"
        ));
    }
    let heading = format!("## {version}");
    if !read("CHANGELOG.md")?
        .lines()
        .any(|line| line.starts_with(&heading))
    {
        return Err(format!("CHANGELOG.md has no section `{heading}`"));
    }
    Ok(version)
}

/// Returns this computer's target.
fn host() -> Result<String, String> {
    let text = step::output(step::command(Path::new("rustc")).arg("-vV")).unwrap_or_default();
    let host = text.lines().find_map(|line| line.strip_prefix("host: "));
    host.map(str::to_owned)
        .ok_or_else(|| "`rustc -vV` names no host".to_owned())
}

fn licences() -> impl Iterator<Item = PathBuf> {
    LICENCES.into_iter().map(root)
}

fn root(file: &str) -> PathBuf {
    crate::root().join(file)
}

/// Packs files, each into a folder of the archive, and checks that the archive can be read.
fn pack(
    folder: &Path,
    name: &str,
    files: impl Iterator<Item = (PathBuf, String)>,
) -> Result<(), String> {
    let staged = folder.join(name);
    let mut count = 0;
    for (file, place) in files {
        let to = staged.join(place);
        let text = |error: std::io::Error| format!("{}: {error}", file.display());
        fs::create_dir_all(&to).map_err(text)?;
        fs::copy(&file, to.join(file.file_name().unwrap_or_default())).map_err(text)?;
        count += 1;
    }
    let archive = folder.join(format!("{name}.tar.gz"));
    let mut tar = step::command(Path::new("tar"));
    step::run(
        tar.arg("-czf")
            .arg(&archive)
            .arg("-C")
            .arg(folder)
            .arg(name),
    )?;
    let listed = step::output(step::command(Path::new("tar")).arg("-tzf").arg(&archive));
    let listed = listed.unwrap_or_default();
    let packed = listed.lines().filter(|line| !line.ends_with('/')).count();
    if packed != count {
        return Err(format!("{}: {packed} files of {count}", archive.display()));
    }
    fs::remove_dir_all(&staged).map_err(|error| format!("{}: {error}", staged.display()))
}
