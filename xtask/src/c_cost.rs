//! The cost of the C library beside Fusion's C code, both on the Cortex-M4F.
//!
//! `c/tests/c/cost.c` counts the instructions of an update in QEMU, with one filter in an image.
//! The difference to an image without a filter is the filter's flash. Fusion's source comes with
//! its Python package, into the target folder. The project holds no copy.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::c_library::{COMPILER, CORES, flash, library, program};
use crate::{python, qemu, setup, step};

/// Package and version of Fusion's source.
const FUSION: &str = "imufusion";
const FUSION_VERSION: &str = "1.3.3";

/// Profiles of the library, with the same optimisation for C.
const PROFILES: [(&str, &str); 2] = [("firmware", "-Os"), ("rigs", "-O3")];

/// Filters by their number in the source.
const SUBJECTS: [(&str, &str); 3] = [
    ("1", "aplomb"),
    ("2", "aplomb with a compass"),
    ("3", "Fusion"),
];

const OPTIONS: [&str; 6] = [
    "-std=c99",
    "-mthumb",
    "-nostartfiles",
    "-fno-math-errno",
    "-ffunction-sections",
    "-fdata-sections",
];

/// Measures and prints the costs. Absent tools are named and skipped.
pub fn run() -> Result<(), String> {
    step::timed("the cost of the C library beside Fusion", || {
        if !has_mathematics() {
            step::skip(
                "the cost of the C library",
                &format!("{COMPILER} with newlib's mathematics is not installed"),
            );
            return Ok(());
        }
        setup::qemu()?;
        let fusion = fusion()?;
        println!(
            "\n{:<28}  mean  maximum  flash  state  stack: start  update",
            "one update"
        );
        for (profile, optimisation) in PROFILES {
            let library = library(&CORES[0], profile)?;
            let none = flash(&link("0", optimisation, &library, None)?)?;
            for (number, name) in SUBJECTS {
                if number == "3" && fusion.is_none() {
                    continue;
                }
                let program = link(number, optimisation, &library, fusion.as_deref())?;
                let costs = count(&program)?;
                let name = format!("{name}, {optimisation}");
                let flash = flash(&program)?.saturating_sub(none);
                println!("{name:<28}{}", costs.row(flash));
            }
        }
        Ok(())
    })
}

/// Returns whether the compiler and its mathematical library are there.
fn has_mathematics() -> bool {
    let found = step::output(Command::new(COMPILER).arg("-print-file-name=libm.a"));
    found.is_some_and(|path| Path::new(&path).is_absolute())
}

/// Returns the folder of Fusion's source. Without it says why.
fn fusion() -> Result<Option<PathBuf>, String> {
    let folder = step::target_folder().join("fusion");
    let name = format!("{FUSION}-{FUSION_VERSION}");
    let source = folder.join(&name).join("Fusion");
    if source.is_dir() {
        return Ok(Some(source));
    }
    let Some(python) = python::find() else {
        step::skip("Fusion", "python3 with venv is not installed");
        return Ok(None);
    };
    let mut pip = python::pip(&python::virtual_environment(&python)?, "download");
    pip.args(["--no-deps", "--no-binary", FUSION, "--dest"]);
    pip.arg(&folder).arg(format!("{FUSION}=={FUSION_VERSION}"));
    if let Err(reason) = step::run(&mut pip) {
        step::skip("Fusion", &format!("its source cannot be fetched: {reason}"));
        return Ok(None);
    }
    let mut tar = step::command(Path::new("tar"));
    tar.arg("-xzf")
        .arg(folder.join(format!("{name}.tar.gz")))
        .arg("-C")
        .arg(&folder);
    step::run(&mut tar)?;
    Ok(Some(source))
}

/// Links the program with the filter of this number.
fn link(
    number: &str,
    optimisation: &str,
    library: &Path,
    fusion: Option<&Path>,
) -> Result<PathBuf, String> {
    let program = program(&format!("cost-{number}{optimisation}"))?;
    let mut gcc = step::command(Path::new(COMPILER));
    gcc.args(OPTIONS).args(CORES[0].options).arg(optimisation);
    gcc.args(["-I", "c/include", "-Wl,--gc-sections,-z,noexecstack"]);
    gcc.arg("-Wl,--defsym=stack_top=0x20010000");
    gcc.args([
        "-T",
        "c/tests/c/core.ld",
        "c/tests/c/core.c",
        "c/tests/c/cost.c",
    ]);
    gcc.arg(format!("-DSUBJECT={number}"));
    if let (Some(source), "3") = (fusion, number) {
        gcc.arg("-I").arg(source);
        let files = std::fs::read_dir(source);
        let files = files.map_err(|error| format!("{}: {error}", source.display()))?;
        let is_c = |path: &PathBuf| path.extension().is_some_and(|end| end == "c");
        gcc.args(files.flatten().map(|file| file.path()).filter(is_c));
    }
    // The Rust library brings slower mathematics of the same names: newlib's comes first.
    gcc.arg("-lm").arg(library).args(["-lm", "-lgcc", "-o"]);
    gcc.arg(&program);
    step::run(&mut gcc)?;
    Ok(program)
}

/// Costs of an update: instructions, and bytes of state and stack.
#[derive(Debug, PartialEq)]
struct Costs {
    mean: f64,
    maximum: u64,
    state: u64,
    stack_of_start: u64,
    stack: u64,
}

impl Costs {
    /// Returns the columns after the name.
    fn row(&self, flash: u64) -> String {
        let Self {
            mean,
            maximum,
            state,
            stack_of_start,
            stack,
        } = self;
        format!("{mean:>6.0}{maximum:>9}{flash:>7}{state:>7}{stack_of_start:>14}{stack:>8}")
    }
}

/// Counts the instructions in QEMU.
fn count(program: &Path) -> Result<Costs, String> {
    let output = qemu::run_counting(program)?;
    let printed = [output.stdout, output.stderr].concat();
    let printed = String::from_utf8_lossy(&printed);
    parse(printed.trim()).ok_or_else(|| format!("{}: {printed}", program.display()))
}

/// Reads tenths of the mean, the maximum, the first, and bytes of state and stack.
fn parse(line: &str) -> Option<Costs> {
    let numbers: Result<Vec<u64>, _> = line.split(',').map(str::parse).collect();
    match numbers.ok()?[..] {
        [tenths, maximum, _, state, stack_of_start, stack] => Some(Costs {
            mean: tenths as f64 / 10.0,
            maximum,
            state,
            stack_of_start,
            stack,
        }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_program_prints_is_read() {
        let costs = Costs {
            mean: 563.7,
            maximum: 705,
            state: 124,
            stack_of_start: 64,
            stack: 240,
        };
        assert_eq!(costs.row(9).split_whitespace().count(), 6);
        assert_eq!(parse("5637,705,720,124,64,240"), Some(costs));
        assert_eq!(parse("a fault"), None);
        assert_eq!(parse("1,2,3"), None);
    }
}
