//! Lists who can panic in a firmware image: only functions whose reason is known may.
//!
//! For the library alone `rigs/src/bin/no_panic.rs` is stricter: it does not link with any panic.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

/// A part of the firmware that may call panics, and why it never comes to that.
struct Expected {
    /// Start of its functions' names, without a leading `<`: a module, whatever the compiler
    /// inlines into what.
    path: &'static str,
    /// Known panics; another one is new.
    panics: &'static [&'static str],
    reason: &'static str,
}

/// All of them.
const EXPECTED: [Expected; 7] = [
    Expected {
        path: "flight::app::main::__rtic_init_resources",
        panics: &[PANIC, PANIC_FMT, BOUNDS, DIVISION, OPTION],
        reason: "start-up: checks of the clock settings, which are constants; \
                 wrong ones fail at the first start",
    },
    Expected {
        path: "SPI2",
        panics: &[DIVISION, RESUMED],
        reason: "RTIC's dispatcher: polling a task that has ended, which RTIC does not do, \
                 and the division by a queue's capacity, which is a constant above zero",
    },
    Expected {
        path: "heapless::spsc::",
        panics: &[DIVISION],
        reason: "the division by a queue's capacity, which is a constant above zero",
    },
    Expected {
        path: "aplomb::board::compass::CompassReader::take_reading",
        panics: &[DIVISION],
        reason: "the division by the capacity of the log's queue, which is a constant above zero",
    },
    Expected {
        path: "_defmt_acquire",
        panics: &[PANIC_FMT],
        reason: "defmt: logging while logging; only the telemetry task logs",
    },
    Expected {
        path: "mavlink_core::",
        panics: &[PANIC_FMT, BOUNDS, SLICE],
        reason: MAVLINK_BUFFER,
    },
    // The lints at the head of this module keep its own code from these.
    Expected {
        path: "aplomb::telemetry::mavlink::",
        panics: &[PANIC_FMT, BOUNDS, SLICE],
        reason: MAVLINK_BUFFER,
    },
];

/// Of the mavlink crate and those of our functions that it is inlined into.
const MAVLINK_BUFFER: &str = "the mavlink crate: the room in its buffer of 255 bytes, \
                              the length of what it reads, and an index that it has just \
                              compared with the length; every message is shorter";

const PANIC: &str = "core::panicking::panic";
const PANIC_FMT: &str = "core::panicking::panic_fmt";
const BOUNDS: &str = "core::panicking::panic_bounds_check";
const DIVISION: &str = "core::panicking::panic_const::panic_const_div_by_zero";
const RESUMED: &str = "core::panicking::panic_const::panic_const_async_fn_resumed";
const SLICE: &str = "core::slice::index::slice_index_fail";
const OPTION: &str = "core::option::";

/// Starts of the names of panics.
const PANICS: [&str; 4] = [
    "core::panicking::",
    "core::slice::index::slice_index_fail",
    "core::option::",
    "core::result::unwrap_failed",
];

/// Functions between a panic and its named caller: parts of `core` that are not inlined, and code
/// that the compiler has outlined from several functions.
const IN_BETWEEN: [&str; 3] = ["core::", "<core::", "OUTLINED_FUNCTION_"];

/// Checks who calls a panic in a firmware image, and prints the list.
pub fn check(elf: &Path) -> Result<(), String> {
    let bytes =
        std::fs::read(elf).map_err(|error| format!("cannot read {}: {error}", elf.display()))?;
    let mut unexpected = Vec::new();
    for (caller, panics) in &callers(&bytes)? {
        match reason(caller, panics) {
            Ok(reason) => eprintln!("   can panic: {caller}: {reason}"),
            Err(panic) => unexpected.push(format!("{caller} ({panic})")),
        }
    }
    if unexpected.is_empty() {
        return Ok(());
    }
    Err(format!(
        "{}: these functions can panic: {}. Take the panic out, \
         or add to `EXPECTED` in xtask/src/panics.rs why it cannot come to that",
        elf.display(),
        unexpected.join(", ")
    ))
}

/// Returns the reason why a function with these panics never panics, or the first unexpected panic.
fn reason<'a>(caller: &str, panics: &'a BTreeSet<String>) -> Result<&'static str, &'a str> {
    let expected = EXPECTED
        .iter()
        .find(|expected| caller.trim_start_matches('<').starts_with(expected.path));
    let is_new = |panic: &&String| {
        !expected.is_some_and(|expected| {
            expected
                .panics
                .iter()
                .any(|known| match known.strip_suffix("::") {
                    Some(_) => panic.starts_with(known),
                    None => panic == known,
                })
        })
    };
    match (panics.iter().find(is_new), expected) {
        (Some(panic), _) => Err(panic),
        (None, Some(expected)) => Ok(expected.reason),
        (None, None) => Err("no panic"),
    }
}

/// The functions of an image that branch to a panic, but for the panics themselves, with those that
/// they branch to.
fn callers(elf: &[u8]) -> Result<BTreeMap<String, BTreeSet<String>>, String> {
    let file = object::File::parse(elf).map_err(|error| error.to_string())?;
    let mut functions = Vec::new();
    for symbol in file.symbols() {
        if symbol.kind() == SymbolKind::Text && symbol.size() > 0 {
            let name = symbol.name().map_err(|error| error.to_string())?;
            let name = format!("{:#}", rustc_demangle::demangle(name));
            // The lowest bit marks Thumb code.
            functions.push((symbol.address() & !1, symbol.size(), name));
        }
    }
    let is_panic = |name: &str| PANICS.iter().any(|panic| name.starts_with(panic));
    // Panics and what stands in between, by their addresses, each with the panics that it ends in.
    let mut panics: BTreeMap<u64, BTreeSet<String>> = functions
        .iter()
        .filter(|(_, _, name)| is_panic(name))
        .map(|(address, _, name)| (*address, BTreeSet::from([name.clone()])))
        .collect();
    if panics.is_empty() {
        return Err(
            "the image has no panic at all, which a firmware with start-up code \
                    cannot have: is it stripped?"
                .into(),
        );
    }
    let sections: Vec<_> = file
        .sections()
        .filter_map(|section| Some((section.address(), section.data().ok()?)))
        .collect();
    let called = |panics: &BTreeMap<u64, BTreeSet<String>>, address: u64, size: u64| {
        let code = sections.iter().filter_map(|(start, data)| {
            let offset = address.checked_sub(*start)?;
            data.get(offset as usize..(offset + size) as usize)
        });
        code.flat_map(|code| branches(address, code))
            .filter_map(|target| panics.get(&target))
            .flatten()
            .cloned()
            .collect::<BTreeSet<String>>()
    };
    loop {
        let mut callers: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        let mut is_known = true;
        for (address, size, name) in &functions {
            let found = called(&panics, *address, *size);
            if is_panic(name) || found.is_empty() {
                continue;
            }
            if IN_BETWEEN.iter().any(|start| name.starts_with(start)) {
                let ends = panics.entry(*address).or_default();
                let before = ends.len();
                ends.extend(found);
                is_known &= ends.len() == before;
            } else {
                callers.entry(name.clone()).or_default().extend(found);
            }
        }
        if is_known {
            return Ok(callers);
        }
    }
}

/// The targets of the long branches in Thumb code, with link or without. A constant between the
/// instructions may look like a branch; that it hits a panic is a matter of one in millions.
fn branches(address: u64, code: &[u8]) -> impl Iterator<Item = u64> {
    let half = |at: usize| {
        Some(u32::from(u16::from_le_bytes(
            *code.get(at..)?.first_chunk()?,
        )))
    };
    (0..code.len()).step_by(2).filter_map(move |at| {
        let (first, second) = (half(at)?, half(at + 2)?);
        // BL is encoding T1, B.W encoding T4 (ARMv7-M architecture manual, A7.7.12 and A7.7.18).
        let is_long_branch = first >> 11 == 0b11110 && second & 0x9000 == 0x9000;
        if !is_long_branch {
            return None;
        }
        let sign = first >> 10 & 1;
        let bit = |place: u32| !((second >> place & 1) ^ sign) & 1;
        let offset = sign << 24
            | bit(13) << 23
            | bit(11) << 22
            | (first & 0x3FF) << 12
            | (second & 0x7FF) << 1;
        let offset = (offset as i32) << 7 >> 7;
        Some(
            address
                .wrapping_add(at as u64 + 4)
                .wrapping_add_signed(offset.into()),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_expected_by_where_it_is_and_which_it_is() {
        let is_expected =
            |caller: &str, panic: &str| reason(caller, &BTreeSet::from([panic.to_owned()])).is_ok();
        for (caller, panic, expected) in [
            ("aplomb::telemetry::mavlink::Session::fill", PANIC_FMT, true),
            ("<aplomb::telemetry::mavlink::wire::X as Y>::z", SLICE, true),
            ("aplomb::telemetry::mavlink::Session::fill", DIVISION, false),
            ("aplomb::telemetry::log::Sender::fill", PANIC_FMT, false),
            ("mavlink_core::bytes_mut::BytesMut::put_f32", BOUNDS, true),
            (
                "mavlink_core::utils::x",
                "core::option::unwrap_failed",
                false,
            ),
            ("SPI2", RESUMED, true),
            ("SPI2", BOUNDS, false),
            ("SPI3", RESUMED, false),
            (
                "flight::app::main::__rtic_init_resources",
                "core::option::unwrap_failed",
                true,
            ),
            ("flight::app::main", PANIC, false),
        ] {
            assert_eq!(is_expected(caller, panic), expected, "{caller} {panic}");
        }
    }

    #[test]
    fn long_branches_are_found_where_they_go() {
        // As an assembler writes them: `bl` and `b.w` to 0x0801_702a, `bl` backwards, and a nop.
        let forwards = [0x0a, 0xf0, 0x9f, 0xf8];
        let targets: Vec<u64> = branches(0x0800_cee8, &forwards).collect();
        assert_eq!(targets, [0x0801_702a]);
        let without_link = [0x0a, 0xf0, 0x9f, 0xb8];
        let targets: Vec<u64> = branches(0x0800_cee8, &without_link).collect();
        assert_eq!(targets, [0x0801_702a]);
        let backwards = [0xff, 0xf7, 0xfe, 0xff];
        let targets: Vec<u64> = branches(0x0800_0000, &backwards).collect();
        assert_eq!(targets, [0x0800_0000]);
        assert_eq!(branches(0, &[0x00, 0xbf, 0x00, 0xbf]).count(), 0);
    }
}
