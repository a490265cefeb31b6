//! Names of mounts as C has them: characters with zeros behind them.

use core::ffi::c_char;
use core::iter::repeat;

use aplomb::calibration::Mount;

/// Returns the mount of this name, which ends with the first zero or with the array.
pub fn parse(characters: &[c_char; 8]) -> Option<Mount> {
    let bytes = characters.map(|character| character.to_ne_bytes()[0]);
    let is = |name: &str| {
        name.bytes()
            .chain(repeat(0))
            .zip(bytes)
            .all(|(a, b)| a == b)
    };
    let mut names = Mount::ALL
        .iter()
        .map(|mount| mount.name())
        .chain(["z-up", "z-down"]);
    names.find(|name| is(name)).and_then(Mount::parse)
}

/// Returns a name with zeros behind it.
pub fn padded(name: &str) -> [c_char; 8] {
    let mut characters = [0; 8];
    for (character, byte) in characters.iter_mut().zip(name.bytes()) {
        *character = c_char::from_ne_bytes([byte]);
    }
    characters
}
