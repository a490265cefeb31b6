//! That nothing panics: the library links with a panic handler that does not link, and in the firmware
//! only those functions call a panic of which it is known why it does not come to that.

use std::collections::BTreeSet;
use std::path::Path;

use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use crate::setup::Toolchain;
use crate::step;

/// Who may call a panic in the firmware (a part of the name), and why it never does.
const EXPECTED: [(&str, &str); 12] = [
    (
        "__rtic_init_resources",
        "start-up: checks of the clock settings, which are constants; wrong ones fail at the first start",
    ),
    (
        "SPI2",
        "RTIC's dispatcher: polling a task that has ended, which RTIC does not do",
    ),
    (
        "_defmt_acquire",
        "defmt: logging while logging; only the telemetry task logs",
    ),
    (
        "serialize_stx_and_header_and_crc",
        "the mavlink crate: a payload longer than its buffer of 255 bytes, which no message type has",
    ),
    (
        "remove_trailing_zeroes",
        "the mavlink crate: an index that it has just compared with the length",
    ),
    ("aplomb::telemetry::mavlink::Inbox::take", MAVLINK_BUFFER),
    ("aplomb::telemetry::mavlink::Session::fill", MAVLINK_BUFFER),
    ("aplomb::telemetry::mavlink::Session::reply", MAVLINK_BUFFER),
    ("aplomb::telemetry::mavlink::Session::say", MAVLINK_BUFFER),
    ("mavlink_core::bytes::Bytes::get_array", MAVLINK_BUFFER),
    ("mavlink_core::bytes_mut::BytesMut::put_u8", MAVLINK_BUFFER),
    (
        "heapless::spsc::QueueInner<T,S>::increment",
        "the division by a queue's capacity, which is a constant above zero",
    ),
];

/// Of the mavlink crate and those of our functions that it is inlined into.
const MAVLINK_BUFFER: &str = "the mavlink crate: the room in its buffer of 255 bytes, and the length of what it reads; every message is shorter";

/// What panics begin with.
const PANICS: [&str; 4] = [
    "core::panicking::",
    "core::slice::index::slice_index_fail",
    "core::option::",
    "core::result::unwrap_failed",
];

/// What stands between a panic and the function to name: parts of `core` that are not inlined, and what the compiler has
/// taken out of several functions to have it once.
const IN_BETWEEN: [&str; 3] = ["core::", "<core::", "OUTLINED_FUNCTION_"];

/// Builds the proof for the library.
pub fn prove_library(toolchain: &Toolchain) -> Result<(), String> {
    step::run(toolchain.cargo("build").args([
        "--release",
        "--bin",
        "no_panic",
        "--features",
        "proof",
    ]))
    .map_err(|error| {
        format!(
            "{error}: if the linker misses `a_panic_is_reachable`, something in the library can panic"
        )
    })
}

/// Checks who calls a panic in a firmware image, and prints the list.
pub fn check(elf: &Path) -> Result<(), String> {
    let bytes =
        std::fs::read(elf).map_err(|error| format!("cannot read {}: {error}", elf.display()))?;
    let callers = callers(&bytes)?;
    let mut unexpected = Vec::new();
    for caller in &callers {
        match EXPECTED.iter().find(|(name, _)| caller.contains(name)) {
            Some((_, reason)) => eprintln!("   can panic: {caller}: {reason}"),
            None => unexpected.push(caller.as_str()),
        }
    }
    if unexpected.is_empty() {
        return Ok(());
    }
    Err(format!(
        "{}: these functions can panic: {}. Take the panic out, or add to `EXPECTED` in xtask/src/panics.rs \
         why it cannot come to that",
        elf.display(),
        unexpected.join(", ")
    ))
}

/// The functions of an image that branch to a panic, but for the panics themselves.
fn callers(elf: &[u8]) -> Result<BTreeSet<String>, String> {
    let file = object::File::parse(elf).map_err(|error| error.to_string())?;
    let mut functions = Vec::new();
    for symbol in file.symbols() {
        if symbol.kind() == SymbolKind::Text && symbol.size() > 0 {
            let name = symbol.name().map_err(|error| error.to_string())?;
            let name = format!("{:#}", rustc_demangle::demangle(name));
            // The lowest bit says that the code is Thumb.
            functions.push((symbol.address() & !1, symbol.size(), name));
        }
    }
    let is_panic = |name: &str| PANICS.iter().any(|panic| name.starts_with(panic));
    let mut panics: BTreeSet<u64> = functions
        .iter()
        .filter(|(_, _, name)| is_panic(name))
        .map(|(address, ..)| *address)
        .collect();
    if panics.is_empty() {
        return Err("the image has no panic at all, which a firmware with start-up code cannot have: is it stripped?".into());
    }
    let sections: Vec<_> = file
        .sections()
        .filter_map(|section| Some((section.address(), section.data().ok()?)))
        .collect();
    let calls_one = |panics: &BTreeSet<u64>, address: u64, size: u64| {
        sections.iter().any(|(start, data)| {
            let code = address
                .checked_sub(*start)
                .and_then(|offset| data.get(offset as usize..(offset + size) as usize));
            code.is_some_and(|code| branches(address, code).any(|target| panics.contains(&target)))
        })
    };
    loop {
        let mut callers = BTreeSet::new();
        let known = panics.len();
        for (address, size, name) in &functions {
            if panics.contains(address) || !calls_one(&panics, *address, *size) {
                continue;
            }
            if IN_BETWEEN.iter().any(|start| name.starts_with(start)) {
                panics.insert(*address);
            } else {
                callers.insert(name.clone());
            }
        }
        if panics.len() == known {
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
