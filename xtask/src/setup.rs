//! Finds a compiler for the Cortex-M4F, or gets one; and QEMU.
//!
//! It tries, in this order: the target of the present compiler; `rustup target add`, unless
//! downloads are switched off (`RUSTUP_AUTO_INSTALL=0`); the packages of Debian and Ubuntu. From
//! their library sources the target's `core` is built once into `target/sysroot`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::step;

/// The target of every STM32F4.
pub const TARGET: &str = "thumbv7em-none-eabihf";

const PACKAGES: [&str; 5] = [
    "rustc-web",
    "cargo-web",
    "rust-web-src",
    "rust-web-clippy",
    "lld-22",
];

/// A cargo that builds for [`TARGET`].
pub enum Toolchain {
    /// The one on the path.
    Own,
    /// The distribution's, with this folder as the target's library.
    Distribution {
        /// Holds `lib/rustlib/<target>/lib`.
        sysroot: PathBuf,
    },
}

impl Toolchain {
    /// Finds or sets up what builds for [`TARGET`].
    pub fn for_target() -> Result<Self, String> {
        Self::for_any(TARGET)
    }

    /// Finds or sets up what builds for this target without an operating system.
    pub fn for_any(target: &str) -> Result<Self, String> {
        if target_is_there(target) {
            return Ok(Self::Own);
        }
        if may_download() {
            let added = step::timed("adding the target with rustup", || {
                step::run(step::command(Path::new("rustup")).args(["target", "add", target]))
            });
            if added.is_ok() && target_is_there(target) {
                return Ok(Self::Own);
            }
        }
        if !step::is_installed("apt-get") {
            return Err(format!(
                "no compiler for {target}: run `rustup target add {target}`, then this again"
            ));
        }
        install(&PACKAGES)?;
        let sysroot = build_sysroot(target)?;
        Ok(Self::Distribution { sysroot })
    }

    /// The compiler's name and version.
    pub fn compiler(&self) -> String {
        let rustc = match self {
            Self::Own => "rustc",
            Self::Distribution { .. } => "/usr/bin/rustc",
        };
        step::output(step::command(rustc.as_ref()).arg("--version")).unwrap_or_default()
    }

    /// A cargo command for [`TARGET`]: subcommand and `--target` are set.
    pub fn cargo(&self, subcommand: &str) -> Command {
        self.cargo_for(TARGET, subcommand)
    }

    /// A cargo command for the target that this was set up for.
    pub fn cargo_for(&self, target: &str, subcommand: &str) -> Command {
        let mut command = match self {
            Self::Own => step::command(Path::new("cargo")),
            Self::Distribution { sysroot } => {
                let mut command = distribution_cargo();
                let name = target.to_uppercase().replace('-', "_");
                for program in ["RUSTFLAGS", "RUSTDOCFLAGS"] {
                    command.env(
                        format!("CARGO_TARGET_{name}_{program}"),
                        format!("--sysroot={}", sysroot.display()),
                    );
                }
                command
            }
        };
        command.args([subcommand, "--target", target]);
        command
    }
}

/// Makes sure that `qemu-system-arm` is there.
pub fn qemu() -> Result<(), String> {
    if step::is_installed("qemu-system-arm") {
        return Ok(());
    }
    if !step::is_installed("apt-get") {
        return Err("qemu-system-arm is missing: install QEMU for ARM \
                    with your system's package manager, then run this again"
            .into());
    }
    install(&["qemu-system-arm"])
}

/// Returns true if rustup is there and may download.
pub fn may_download() -> bool {
    std::env::var("RUSTUP_AUTO_INSTALL").as_deref() != Ok("0") && step::is_installed("rustup")
}

fn target_is_there(target: &str) -> bool {
    let Some(sysroot) =
        step::output(step::command(Path::new("rustc")).args(["--print", "sysroot"]))
    else {
        return false;
    };
    holds_core(&library_of(Path::new(&sysroot), target))
}

fn library_of(sysroot: &Path, target: &str) -> PathBuf {
    sysroot.join("lib/rustlib").join(target).join("lib")
}

fn holds_core(library: &Path) -> bool {
    fs::read_dir(library).is_ok_and(|entries| {
        entries.flatten().any(|entry| {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            name.starts_with("libcore-") && name.ends_with(".rlib")
        })
    })
}

/// Installs Debian packages that are missing.
fn install(packages: &[&str]) -> Result<(), String> {
    let missing: Vec<&str> = packages
        .iter()
        .copied()
        .filter(|package| {
            step::output(Command::new("dpkg-query").args(["-W", "-f=${db:Status-Status}", package]))
                .as_deref()
                != Some("installed")
        })
        .collect();
    if missing.is_empty() {
        return Ok(());
    }
    let list = missing.join(" ");
    let by_hand =
        format!("run `sudo apt-get install --no-install-recommends {list}`, then this again");
    step::timed(&format!("installing {list}"), || {
        let is_root = step::output(Command::new("id").arg("-u")).as_deref() == Some("0");
        let apt = |arguments: &[&str]| {
            let mut command = if is_root {
                Command::new("apt-get")
            } else {
                let mut command = Command::new("sudo");
                command.args(["-n", "apt-get"]);
                command
            };
            command.env("DEBIAN_FRONTEND", "noninteractive");
            step::run(command.args(["-q", "-y"]).args(arguments))
        };
        // An old package list is no reason to give up: the installation decides.
        let updated = apt(&["update"]);
        let mut arguments = vec!["install", "--no-install-recommends"];
        arguments.extend(&missing);
        apt(&arguments).map_err(|error| match updated {
            Ok(()) => format!("{error}; {by_hand}"),
            Err(update) => format!("{update}; {error}; {by_hand}"),
        })
    })
}

/// The distribution's cargo and rustc by their paths, whatever toolchain is the default.
fn distribution_cargo() -> Command {
    let mut command = step::command(Path::new("/usr/bin/cargo"));
    let mut path = std::ffi::OsString::from("/usr/bin:");
    path.push(std::env::var_os("PATH").unwrap_or_default());
    command
        .env("PATH", path)
        .env("RUSTC", "/usr/bin/rustc")
        .env("RUSTDOC", "/usr/bin/rustdoc")
        .env_remove("RUSTUP_TOOLCHAIN");
    command
}

/// Returns the text after `label` in the output of the distribution's `rustc -vV`.
fn version_line(label: &str) -> Result<String, String> {
    step::output(Command::new("/usr/bin/rustc").arg("-vV"))
        .and_then(|text| {
            text.lines()
                .find_map(|line| line.strip_prefix(label).map(str::to_owned))
        })
        .ok_or_else(|| format!("/usr/bin/rustc -vV has no line `{label}`"))
}

/// Builds the target's `core` from the distribution's sources, once for each version of its
/// compiler.
fn build_sysroot(target: &str) -> Result<PathBuf, String> {
    let sysroot = step::target_folder()
        .join("sysroot")
        .join(version_line("release: ")?);
    if holds_core(&library_of(&sysroot, target)) {
        return Ok(sysroot);
    }
    step::timed("building the target's core library, once", || {
        let text = |error: std::io::Error| format!("cannot prepare the core library: {error}");
        let package = sysroot.join("package");
        fs::create_dir_all(package.join("src")).map_err(text)?;
        fs::write(
            package.join("Cargo.toml"),
            "[package]\nname = \"sysroot\"\nversion = \"0.0.0\"\nedition = \"2024\"\n[workspace]\n",
        )
        .map_err(text)?;
        fs::write(package.join("src/lib.rs"), "#![no_std]\n").map_err(text)?;
        let output = sysroot.join("build");
        step::run(
            distribution_cargo()
                .current_dir(&package)
                .args([
                    "build",
                    "--release",
                    "-Zbuild-std=core,alloc",
                    "--target",
                    target,
                ])
                .arg("--target-dir")
                .arg(&output)
                // Building the standard library is an unstable feature; the bitcode is for
                // link-time optimisation.
                .env("RUSTC_BOOTSTRAP", "1")
                .env("RUSTFLAGS", "-Cembed-bitcode=yes"),
        )?;
        let dependencies = output.join(target).join("release/deps");
        // Copied under another name and renamed, so that a stopped run leaves no half of a library.
        let partial = sysroot.join("partial");
        let _ = fs::remove_dir_all(&partial);
        fs::create_dir_all(&partial).map_err(text)?;
        for entry in fs::read_dir(&dependencies).map_err(text)?.flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if name.ends_with(".rlib") && !name.starts_with("libsysroot-") {
                fs::copy(entry.path(), partial.join(&*name)).map_err(text)?;
            }
        }
        // With a library folder of its own the compiler looks for its linker there too.
        let host = version_line("host: ")?;
        let programs = sysroot.join("lib/rustlib").join(host).join("bin");
        fs::create_dir_all(&programs).map_err(text)?;
        fs::copy("/usr/bin/lld-22", programs.join("rust-lld")).map_err(text)?;
        let library = library_of(&sysroot, target);
        let _ = fs::remove_dir_all(&library);
        fs::create_dir_all(library.parent().ok_or("the library has no folder")?).map_err(text)?;
        fs::rename(&partial, &library).map_err(text)?;
        let _ = fs::remove_dir_all(&output);
        Ok(())
    })?;
    Ok(sysroot)
}
