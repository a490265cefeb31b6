//! Checksums, independent of the library, so that random bytes pass the check before a decoder.

/// CRC-32 bit by bit: reflected, polynomial 0x04C11DB7.
pub fn crc_32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(u32::MAX, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |crc, _| {
            (crc >> 1) ^ (0xEDB8_8320 & 0_u32.wrapping_sub(crc & 1))
        })
    })
}
