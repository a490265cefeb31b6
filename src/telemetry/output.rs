//! Output: a buffer of bytes to send.

/// Bytes to send, in a buffer of fixed size.
///
/// ```
/// use aplomb::telemetry::Output;
///
/// let mut buffer = [0; 4];
/// let mut output = Output::new(&mut buffer);
/// assert!(output.put(b"abc"));
/// assert!(!output.put(b"de"), "all or none");
/// assert_eq!(output.length(), 3);
/// ```
#[derive(Debug)]
pub struct Output<'a> {
    buffer: &'a mut [u8],
    length: usize,
}

impl<'a> Output<'a> {
    /// Creates an empty output in `buffer`.
    pub const fn new(buffer: &'a mut [u8]) -> Self {
        Self { buffer, length: 0 }
    }

    /// Returns the number of bytes.
    pub const fn length(&self) -> usize {
        self.length
    }

    /// Returns whether this many more bytes fit.
    pub const fn has_room(&self, bytes: usize) -> bool {
        self.buffer.len().saturating_sub(self.length) >= bytes
    }

    /// Adds bytes, all or none. Returns false if there is no room.
    #[inline(never)]
    pub fn put(&mut self, bytes: &[u8]) -> bool {
        let end = self.length + bytes.len();
        match self.buffer.get_mut(self.length..end) {
            Some(place) => {
                for (place, byte) in place.iter_mut().zip(bytes) {
                    *place = *byte;
                }
                self.length = end;
                true
            }
            None => false,
        }
    }
}
