//! Use of the chip by the firmware, and a check that it keeps off the calibration slots.

use std::ops::Range;
use std::path::Path;

use object::elf::{FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};
use object::{Endianness, Object, ObjectSymbol};

use crate::build::{Board, Firmware};
use crate::setup::Toolchain;
use crate::{panics, rigs};

/// Budget of the firmware's flash, well below the smallest board's chip.
const FLASH_BUDGET: u64 = 160 * 1024;
/// Budget of the flash of the build without compass.
const WITHOUT_COMPASS_FLASH_BUDGET: u64 = 128 * 1024;
/// Budget of the minimal build's flash.
const MINIMAL_FLASH_BUDGET: u64 = 64 * 1024;
/// Budget of its variables; the stack has a region of its own.
const RAM_BUDGET: u64 = 16 * 1024;
/// The most flash that the default filter alone may add to an empty image.
const KALMAN_BUDGET: u64 = 16 * 1024;
/// Flash sectors 1 and 2, which hold calibrations (see `memory.x`).
const CALIBRATION_SLOTS: Range<u64> = 0x0800_4000..0x0800_C000;
const FLASH: Range<u64> = 0x0800_0000..0x0810_0000;
const RAM: Range<u64> = 0x2000_0000..0x2002_0000;
const LARGEST_SHOWN: usize = 12;

/// Memory that an image takes.
pub struct Sizes {
    /// Bytes in flash: all loaded segments.
    pub flash: u64,
    /// Bytes of variables in RAM, initialised or not.
    pub ram: u64,
}

/// Builds the firmware and prints its sizes.
pub fn run(board: Board) -> Result<(), String> {
    let toolchain = Toolchain::for_target()?;
    let elf = Firmware::full(board).build(&toolchain)?;
    let sizes = check(&elf)?;
    let without_compass = Firmware::without_compass(board).build(&toolchain)?;
    let without_compass = check_without_compass(&without_compass)?;
    let minimal = check_minimal(&Firmware::minimal(board).build(&toolchain)?)?;
    panics::check(&elf)?;
    println!("\n{} ({})", board.name, board.chip);
    println!("flash {:>7} bytes of {FLASH_BUDGET}", sizes.flash);
    println!(
        "flash {:>7} bytes of {WITHOUT_COMPASS_FLASH_BUDGET}, without compass",
        without_compass.flash
    );
    println!(
        "flash {:>7} bytes of {MINIMAL_FLASH_BUDGET}, minimal build",
        minimal.flash
    );
    println!("ram   {:>7} bytes of {RAM_BUDGET}, stack apart", sizes.ram);
    println!(
        "Kalman{:>7} bytes of {KALMAN_BUDGET}, what the filter alone adds to an empty image",
        check_kalman(&toolchain)?
    );
    println!("\nlargest symbols");
    for (size, name) in largest_symbols(&elf)? {
        println!("{size:>7}  {name}");
    }
    Ok(())
}

/// Reads the sizes of an image. An error if it exceeds a budget or touches a calibration slot.
pub fn check(elf: &Path) -> Result<Sizes, String> {
    check_within(elf, FLASH_BUDGET)
}

/// Checks an image of the build without compass, as [`check`] does.
pub fn check_without_compass(elf: &Path) -> Result<Sizes, String> {
    check_within(elf, WITHOUT_COMPASS_FLASH_BUDGET)
}

/// Checks an image of the minimal build, as [`check`] does.
pub fn check_minimal(elf: &Path) -> Result<Sizes, String> {
    check_within(elf, MINIMAL_FLASH_BUDGET)
}

fn check_within(elf: &Path, flash_budget: u64) -> Result<Sizes, String> {
    let sizes = measure(elf)?;
    for (name, size, budget) in [
        ("flash", sizes.flash, flash_budget),
        ("RAM", sizes.ram, RAM_BUDGET),
    ] {
        if size == 0 || size > budget {
            return Err(format!(
                "{}: {size} bytes of {name}, and the budget is {budget}",
                elf.display()
            ));
        }
    }
    Ok(sizes)
}

/// Returns the bytes of flash that the default filter adds to an empty image.
///
/// Fails if they exceed the budget.
pub fn check_kalman(toolchain: &Toolchain) -> Result<u64, String> {
    let [empty, kalman] = rigs::empty_and_kalman(toolchain)?;
    let added = measure(&kalman)?
        .flash
        .saturating_sub(measure(&empty)?.flash);
    if added == 0 || added > KALMAN_BUDGET {
        return Err(format!(
            "the Kalman filter adds {added} bytes to an empty image, \
             and the budget is {KALMAN_BUDGET}"
        ));
    }
    Ok(added)
}

/// Reads the sizes of an image. An error if it touches a calibration slot.
pub fn measure(elf: &Path) -> Result<Sizes, String> {
    let bytes = read(elf)?;
    let place = |error| format!("{} is not an ELF file: {error}", elf.display());
    let header = FileHeader32::<Endianness>::parse(&*bytes).map_err(place)?;
    let endian = header.endian().map_err(place)?;
    let mut sizes = Sizes { flash: 0, ram: 0 };
    for segment in header.program_headers(endian, &*bytes).map_err(place)? {
        if segment.p_type(endian) != PT_LOAD {
            continue;
        }
        let stored_at = u64::from(segment.p_paddr(endian));
        let stored = u64::from(segment.p_filesz(endian));
        let runs_at = u64::from(segment.p_vaddr(endian));
        if FLASH.contains(&stored_at) {
            sizes.flash += stored;
            let end = stored_at + stored;
            if stored > 0 && stored_at < CALIBRATION_SLOTS.end && end > CALIBRATION_SLOTS.start {
                return Err(format!(
                    "{}: the segment at {stored_at:#x}..{end:#x} lies in the calibration slots",
                    elf.display()
                ));
            }
        }
        if RAM.contains(&runs_at) {
            sizes.ram += u64::from(segment.p_memsz(endian));
        }
    }
    Ok(sizes)
}

fn largest_symbols(elf: &Path) -> Result<Vec<(u64, String)>, String> {
    let bytes = read(elf)?;
    let file = object::File::parse(&*bytes).map_err(|error| error.to_string())?;
    let mut symbols: Vec<(u64, String)> = file
        .symbols()
        .filter_map(|symbol| {
            let name = format!("{:#}", rustc_demangle::demangle(symbol.name().ok()?));
            Some((symbol.size(), name))
        })
        .collect();
    symbols.sort();
    symbols.dedup();
    Ok(symbols.into_iter().rev().take(LARGEST_SHOWN).collect())
}

fn read(path: &Path) -> Result<Vec<u8>, String> {
    std::fs::read(path).map_err(|error| format!("cannot read {}: {error}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An ELF file with one loaded segment at `address`, and one in RAM.
    fn image(address: u32, length: u32) -> Vec<u8> {
        let word = |value: u32| value.to_le_bytes();
        let half = |value: u16| value.to_le_bytes();
        let mut bytes = vec![0x7f, b'E', b'L', b'F', 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        bytes.extend([half(2), half(40)].concat());
        bytes.extend([word(1), word(address), word(52), word(0), word(0)].concat());
        bytes.extend([half(52), half(32), half(2), half(40), half(0), half(0)].concat());
        for (address, stored, taken) in [(address, length, length), (0x2000_2000, 0, 64)] {
            let fields = [PT_LOAD, 116, address, address, stored, taken, 5, 4];
            bytes.extend(fields.map(word).concat());
        }
        bytes.resize(116 + length as usize, 0);
        bytes
    }

    fn check_image(name: &str, address: u32, length: u32) -> Result<Sizes, String> {
        let path = std::env::temp_dir().join(format!("aplomb-size-{}-{name}", std::process::id()));
        std::fs::write(&path, image(address, length)).expect("the temporary folder can be written");
        let result = check(&path);
        let _ = std::fs::remove_file(path);
        result
    }

    #[test]
    fn sizes_are_those_of_the_segments() {
        let sizes = check_image("good", 0x0800_C000, 1_000).expect("the image is in its budget");
        assert_eq!((sizes.flash, sizes.ram), (1_000, 64));
    }

    #[test]
    fn slots_and_budgets_are_kept() {
        assert!(check_image("start", 0x0800_0000, 0x4001).is_err_and(|e| e.contains("slots")));
        assert!(check_image("inside", 0x0800_8000, 4).is_err_and(|e| e.contains("slots")));
        assert!(check_image("before", 0x0800_0000, 0x4000).is_ok());
        assert!(
            check_image("large", 0x0800_C000, FLASH_BUDGET as u32 + 1)
                .is_err_and(|e| e.contains("budget"))
        );
    }
}
