//! Tools that tests of the workspace use where they are installed. Each test that lacks one passes
//! and says so, which `cargo test` hides. So `cargo xtask test` looks for them first.

use crate::step;

#[path = "../../c/tests/common/compilers.rs"]
mod compilers;
#[path = "../../tests/pymavlink/python.rs"]
mod pymavlink;

/// Reports the tests that will be skipped, because a tool is absent. Installs pymavlink where the
/// tests look for it.
pub fn report_absent() -> Result<(), String> {
    // The tests' `CARGO_TARGET_TMPDIR`.
    let folder = step::target_folder().join("tmp");
    let cannot = |error| format!("cannot make {}: {error}", folder.display());
    std::fs::create_dir_all(&folder).map_err(cannot)?;
    let empty = crate::root().join("c/tests/c/empty.c");
    let (_, absent) = compilers::compilers(&empty, &folder.join("probe-of-xtask"));
    for (name, options) in absent {
        let (work, reason) = absence(name, options);
        step::skip(&work, &reason);
    }
    if pymavlink::with_pymavlink(&folder).is_none() {
        let reason =
            "it cannot be installed: that takes Python 3 with venv and pip, and the network";
        step::skip("tests against pymavlink", reason);
    }
    if !step::is_installed("bash") {
        step::skip(
            "the test of the completion for bash",
            "bash is not installed",
        );
    }
    Ok(())
}

/// Returns the work that an absent compiler with these options leaves undone, and the reason.
fn absence(name: &str, options: &[&str]) -> (String, String) {
    let sanitizers = options.iter().find(|option| option.contains("sanitize"));
    match sanitizers {
        Some(sanitizers) => (
            format!("programs in C by {name} with sanitizers"),
            format!("{name} with {sanitizers} is not installed"),
        ),
        None => (
            format!("programs in C by {name}"),
            format!("{name} is not installed"),
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_absent_sanitizer_is_told_from_an_absent_compiler() {
        let work = |options: &[&str]| absence("gcc", options).0;
        assert_eq!(work(&["-std=c99"]), "programs in C by gcc");
        let sanitizers = work(&["-std=c99", "-fsanitize=address,undefined"]);
        assert_eq!(sanitizers, "programs in C by gcc with sanitizers");
    }

    #[test]
    fn a_compiler_that_is_not_there_is_absent() {
        let folder = std::env::temp_dir();
        let no_source = folder.join("no-such-source.c");
        let (found, absent) = compilers::compilers(&no_source, &folder.join("no-such-program"));
        assert_eq!((found.len(), absent.len()), (0, 6), "nothing compiles it");
    }
}
