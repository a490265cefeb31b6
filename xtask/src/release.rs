//! `cargo xtask release --dry-run`: makes and checks the files of a release, and publishes nothing.
//!
//! The folder `target/release-files` then holds an archive of the program, one of the C library
//! with its header, the Python wheel and its sources. The library is packed and built as a registry
//! would have it.

use std::fs;
use std::path::{Path, PathBuf};

use crate::{build, c_library, package, python, step};

/// Files that ask for the packages of this version.
const MENTIONS: [&str; 4] = [
    "README.md",
    "docs/porting.md",
    "cli/Cargo.toml",
    "recordings/Cargo.toml",
];

/// Files of each archive.
const LICENCES: [&str; 3] = ["LICENSE-APACHE", "LICENSE-MIT", "CHANGELOG.md"];

/// Makes and checks a release.
pub fn dry_run() -> Result<(), String> {
    let version = version()?;
    step::timed("the library's package", package::check)?;
    step::timed(
        "publish --dry-run of library and program",
        package::publish_dry_run,
    )?;
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

/// Returns the version. All packages, the README's snippet and the changelog have to have it.
fn version() -> Result<String, String> {
    let read =
        |file: &str| fs::read_to_string(root(file)).map_err(|error| format!("{file}: {error}"));
    let version = version_of(&read("Cargo.toml")?).ok_or("Cargo.toml has no version")?;
    if version_of(&read("python/Cargo.toml")?).as_ref() != Some(&version) {
        return Err(format!(
            "python/Cargo.toml has another version than {version}"
        ));
    }
    for file in MENTIONS {
        check_mentions(file, &read(file)?, &version)?;
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

/// Returns the version of a manifest.
fn version_of(manifest: &str) -> Option<String> {
    let mut lines = manifest.lines();
    let rest = lines.find_map(|line| line.strip_prefix("version = \""))?;
    rest.strip_suffix('"').map(str::to_owned)
}

/// Fails unless this file asks for this version of the packages at least once, and for no other.
fn check_mentions(file: &str, text: &str, version: &str) -> Result<(), String> {
    let mentions = text
        .lines()
        .filter(|line| line.trim_start().starts_with("aplomb"));
    let mut found = mentions
        .filter_map(|line| line.split_once("version = \""))
        .peekable();
    if found.peek().is_none() {
        return Err(format!("{file} names no version of aplomb"));
    }
    match found.find(|(_, rest)| !rest.starts_with(&format!("{version}\""))) {
        Some((name, _)) => Err(format!(
            "{file}: `{name}…` asks for another version than {version}"
        )),
        None => Ok(()),
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_version_is_named() {
        let text = "x\naplomb = { version = \"0.1.0\", path = \"..\" }\nclap = { version = \"4\" }";
        assert_eq!(check_mentions("a", text, "0.1.0"), Ok(()));
        let older = format!("{text}\naplomb-plot = {{ version = \"0.0.9\" }}");
        let error = check_mentions("a", &older, "0.1.0").unwrap_err();
        assert!(error.contains("aplomb-plot"), "{error}");
        assert!(check_mentions("a", text, "0.1.1").is_err());
        assert!(check_mentions("a", "aplomb = { path = \"..\" }", "0.1.0").is_err());
    }

    #[test]
    fn the_version_of_a_manifest_is_found() {
        let manifest = "[package]\nversion = \"0.1.0\"\n[dependencies]\nversion = \"2\"";
        assert_eq!(version_of(manifest).as_deref(), Some("0.1.0"));
        assert_eq!(version_of("[package]\nversion.workspace = true"), None);
    }
}
