//! Numbers with two decimals, both ways, without the formatting machinery of `core`.

/// Text of a fixed largest size, written from the front.
///
/// The owner makes it large enough; a byte too many would be dropped, never written elsewhere.
pub(super) struct Writer<'a> {
    bytes: &'a mut [u8],
    length: usize,
}

impl<'a> Writer<'a> {
    pub(super) fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, length: 0 }
    }

    pub(super) fn text(&mut self, text: &str) {
        for byte in text.bytes() {
            self.byte(byte);
        }
    }

    /// Two decimals, rounded half away from zero, at most [`LARGEST`] either way; `nan` for none.
    pub(super) fn number(&mut self, value: f32) {
        if value.is_nan() {
            return self.text("nan");
        }
        self.hundredths(to_hundredths(value));
    }

    /// Like [`number`](Self::number), for an angle in (−180, 180] degrees: what rounds to −180.00 is
    /// written 180.00.
    pub(super) fn angle(&mut self, degrees: f32) {
        if !degrees.is_nan() && to_hundredths(degrees) == -HALF_TURN {
            return self.hundredths(HALF_TURN);
        }
        self.number(degrees);
    }

    pub(super) fn finish(self) -> &'a [u8] {
        let Self { bytes, length } = self;
        bytes.get(..length).unwrap_or(&[])
    }

    fn hundredths(&mut self, hundredths: i32) {
        if hundredths < 0 {
            self.byte(b'-');
        }
        let magnitude = hundredths.unsigned_abs();
        let mut divisor = 1_000_000;
        while divisor > 100 && magnitude < divisor {
            divisor /= 10;
        }
        let mut rest = magnitude;
        while divisor > 0 {
            self.byte(b'0' + (rest / divisor) as u8);
            rest %= divisor;
            if divisor == 100 {
                self.byte(b'.');
            }
            divisor /= 10;
        }
    }

    fn byte(&mut self, byte: u8) {
        if let Some(place) = self.bytes.get_mut(self.length) {
            *place = byte;
            self.length += 1;
        }
    }
}

/// The largest number written, either way; larger ones are written as this.
pub(super) const LARGEST: f32 = 99_999.99;

/// 180.00 in hundredths.
const HALF_TURN: i32 = 18_000;

/// The longest number: `-99999.99`.
pub(super) const LONGEST_NUMBER: usize = 9;

fn to_hundredths(value: f32) -> i32 {
    const LIMIT: i32 = 9_999_999;
    let scaled = value.clamp(-LARGEST, LARGEST) * 100.0;
    let rounding = if scaled < 0.0 { -0.5 } else { 0.5 };
    ((scaled + rounding) as i32).clamp(-LIMIT, LIMIT)
}

/// Reads what [`Writer::number`] writes, and nothing else: no exponent, no infinity, no blanks.
pub(super) fn parse(text: &str) -> Option<f32> {
    if text == "nan" {
        return Some(f32::NAN);
    }
    let magnitude = text.strip_prefix('-').unwrap_or(text);
    let (whole, decimals) = magnitude.split_once('.')?;
    let is_number = |digits: &str| digits.bytes().all(|byte| byte.is_ascii_digit());
    let is_written_so = (1..=5).contains(&whole.len())
        && decimals.len() == 2
        && is_number(whole)
        && is_number(decimals);
    if is_written_so {
        text.parse().ok()
    } else {
        None
    }
}
