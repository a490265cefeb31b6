//! The facts about a firmware image that the virtual board needs, from its ELF file.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use object::elf::{PT_LOAD, SHF_ALLOC, SHF_WRITE};
use object::read::elf::{ElfFile32, ProgramHeader};
use object::{Endianness, Object, ObjectSection, ObjectSymbol, SectionFlags};

use crate::Error;

/// The first address of the RAM on every board.
const RAM_START: u64 = 0x2000_0000;

/// A firmware image.
#[derive(Clone, Debug)]
pub struct Firmware {
    /// File that it was read from.
    pub path: PathBuf,
    /// The ELF file.
    pub bytes: Vec<u8>,
    /// The address of `APLOMB_SNAPSHOT`, if the image publishes its attitudes there. Any other
    /// image shows only its log.
    pub snapshot: Option<u64>,
    /// The address of `APLOMB_HEADING`, if the image publishes headings there.
    pub heading: Option<u64>,
    /// The address of `APLOMB_HEALTH`, if the image has it.
    pub health: Option<u64>,
    /// The address of `APLOMB_ARMED`, if the image can be armed.
    pub armed: Option<u64>,
    /// The address of the RTT control block, if the image logs.
    pub log_channel: Option<u64>,
    /// The vector table's entries, by exception number. At 0: the handler of all exceptions while
    /// the firmware measures itself, or 0.
    pub handlers: Vec<u32>,
    /// The addresses that the main stack may grow into.
    pub stack: Range<u64>,
    /// Bytes that the image occupies in flash: its loaded segments.
    pub flash_bytes: u64,
    /// Bytes of RAM that have an address at link time: initialised, zeroed and uninitialised data,
    /// not the stack.
    pub ram_bytes: u64,
}

impl Firmware {
    /// Reads an image.
    ///
    /// # Errors
    ///
    /// When the file cannot be read, is not an image for this processor, or has no stack.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let bytes =
            fs::read(path).map_err(|cause| Error::Firmware(path.into(), cause.to_string()))?;
        Self::parse(path, bytes).map_err(|reason| Error::Firmware(path.into(), reason))
    }

    fn parse(path: &Path, bytes: Vec<u8>) -> Result<Self, String> {
        let file: ElfFile32<'_, Endianness> =
            ElfFile32::parse(bytes.as_slice()).map_err(|cause| cause.to_string())?;
        let symbol = |name: &str| {
            file.symbols()
                .find(|symbol| symbol.name() == Ok(name))
                .map(|symbol| symbol.address())
        };
        let required = |name: &str| symbol(name).ok_or(format!("it has no symbol `{name}`"));

        let table = file
            .section_by_name(".vector_table")
            .ok_or("it has no section `.vector_table`")?;
        let handlers = table.data().map_err(|cause| cause.to_string())?;
        let mut handlers: Vec<u32> = handlers
            .as_chunks::<4>()
            .0
            .iter()
            .map(|&word| u32::from_le_bytes(word))
            .collect();
        // The table's first word is the stack pointer, and no exception has number 0.
        if let Some(first) = handlers.first_mut() {
            let measuring = symbol("APLOMB_MEASURED").and_then(|at| u32::try_from(at).ok());
            *first = measuring.unwrap_or(0);
        }

        let ram: Vec<Range<u64>> = file
            .sections()
            .filter(|section| is_data(section.flags()) && section.address() >= RAM_START)
            .map(|section| section.address()..section.address() + section.size())
            .collect();
        let stack_top = required("_stack_start")?;
        let stack_bottom = ram
            .iter()
            .map(|range| range.end)
            .filter(|&end| end <= stack_top)
            .max();
        Ok(Self {
            snapshot: symbol("APLOMB_SNAPSHOT"),
            heading: symbol("APLOMB_HEADING"),
            health: symbol("APLOMB_HEALTH"),
            armed: symbol("APLOMB_ARMED"),
            log_channel: symbol("_SEGGER_RTT"),
            handlers,
            stack: stack_bottom.unwrap_or(RAM_START)..stack_top,
            flash_bytes: file
                .elf_program_headers()
                .iter()
                .filter(|header| header.p_type(Endianness::Little) == PT_LOAD)
                .map(|header| u64::from(header.p_filesz(Endianness::Little)))
                .sum(),
            ram_bytes: ram.iter().map(|range| range.end - range.start).sum(),
            path: path.into(),
            bytes,
        })
    }
}

/// Returns true if a section is part of the memory image and can be written.
fn is_data(flags: SectionFlags) -> bool {
    let wanted = u64::from(SHF_ALLOC | SHF_WRITE);
    matches!(flags, SectionFlags::Elf { sh_flags } if sh_flags & wanted == wanted)
}
