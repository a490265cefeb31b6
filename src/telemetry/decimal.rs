//! Numbers with two decimals, encoded and decoded without the formatting machinery of `core`.

/// Writer of text into a buffer of fixed size.
///
/// The owner makes the buffer large enough; a byte without room is dropped.
pub(super) struct Writer<'a> {
    bytes: &'a mut [u8],
    length: usize,
}

impl<'a> Writer<'a> {
    pub(super) fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, length: 0 }
    }

    /// Writes text.
    #[inline(never)]
    pub(super) fn text(&mut self, text: &str) {
        for byte in text.bytes() {
            self.byte(byte);
        }
    }

    /// Writes a number with two decimals, rounded half away from zero, limited to ±[`LARGEST`]; a
    /// NaN as `nan`.
    #[inline(never)]
    pub(super) fn number(&mut self, value: f32) {
        if value.is_nan() {
            return self.text("nan");
        }
        self.hundredths(to_hundredths(value));
    }

    /// Writes an angle in (−180, 180] degrees: −180.00 after rounding becomes 180.00.
    pub(super) fn angle(&mut self, degrees: f32) {
        if !degrees.is_nan() && to_hundredths(degrees) == -HALF_TURN {
            return self.hundredths(HALF_TURN);
        }
        self.number(degrees);
    }

    /// Returns the text.
    pub(super) fn finish(self) -> &'a [u8] {
        let Self { bytes, length } = self;
        bytes.get(..length).unwrap_or(&[])
    }

    #[inline(never)]
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

/// Largest magnitude; larger numbers are written as this.
const LARGEST: f32 = 99_999.99;

/// 180.00 in hundredths.
const HALF_TURN: i32 = 18_000;

/// Length of the longest number, `-99999.99`.
pub(super) const LONGEST_NUMBER: usize = 9;

/// Converts to hundredths: the whole part apart from the rest, so that a large number keeps them.
fn to_hundredths(value: f32) -> i32 {
    let magnitude = value.abs().min(LARGEST);
    let whole = magnitude as i32;
    let rest = (magnitude - whole as f32) * 100.0 + 0.5;
    let hundredths = whole * 100 + rest as i32;
    if value < 0.0 { -hundredths } else { hundredths }
}

/// Parses the output of [`Writer::number`], and nothing else: no exponent, no infinity, no blanks.
pub(super) fn parse(text: &str) -> Option<f32> {
    if text == "nan" {
        return Some(f32::NAN);
    }
    let magnitude = text.strip_prefix('-').unwrap_or(text);
    let (whole, decimals) = magnitude.split_once('.')?;
    let is_number = |digits: &str| digits.bytes().all(|byte| byte.is_ascii_digit());
    let is_canonical = (1..=5).contains(&whole.len())
        && decimals.len() == 2
        && is_number(whole)
        && is_number(decimals);
    if is_canonical {
        text.parse().ok()
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(value: f32) -> String {
        let mut bytes = [0; LONGEST_NUMBER];
        let mut writer = Writer::new(&mut bytes);
        writer.number(value);
        String::from_utf8(writer.finish().to_vec()).expect("ASCII")
    }

    #[test]
    fn numbers_have_two_decimals() {
        for (value, text) in [
            (0.0, "0.00"),
            (-0.0, "0.00"),
            (0.004, "0.00"),
            (-0.004, "0.00"),
            (0.006, "0.01"),
            (-0.006, "-0.01"),
            (1.0, "1.00"),
            (-9.994, "-9.99"),
            (9.996, "10.00"),
            (123.45, "123.45"),
            (-2000.5, "-2000.50"),
            (99_999.9, "99999.90"),
            (1.0e6, "99999.99"),
            (f32::MAX, "99999.99"),
            (f32::NEG_INFINITY, "-99999.99"),
            (f32::INFINITY, "99999.99"),
            (f32::NAN, "nan"),
            (f32::MIN_POSITIVE, "0.00"),
        ] {
            assert_eq!(written(value), text);
        }
    }

    #[test]
    fn an_angle_never_reads_minus_180() {
        let angle = |degrees| {
            let mut bytes = [0; LONGEST_NUMBER];
            let mut writer = Writer::new(&mut bytes);
            writer.angle(degrees);
            String::from_utf8(writer.finish().to_vec()).expect("ASCII")
        };
        assert_eq!(angle(-179.998), "180.00");
        assert_eq!(angle(-179.99), "-179.99");
        assert_eq!(angle(180.0), "180.00");
        assert_eq!(angle(f32::NAN), "nan");
    }

    #[test]
    fn only_canonical_numbers_are_parsed() {
        assert_eq!(parse("-12.50"), Some(-12.5));
        assert_eq!(parse("99999.99"), Some(99_999.99));
        assert!(parse("nan").is_some_and(f32::is_nan));
        for text in [
            "",
            "-",
            ".",
            "1",
            "1.",
            ".50",
            "1.5",
            "1.500",
            "+1.50",
            "--1.50",
            "1.5e",
            " 1.50",
            "1.50 ",
            "inf",
            "NaN",
            "100000.00",
            "1,50",
            "1.-5",
            "०.००",
        ] {
            assert_eq!(parse(text), None, "{text:?}");
        }
    }

    #[test]
    fn bytes_without_room_are_dropped() {
        let mut bytes = [0; 3];
        let mut writer = Writer::new(&mut bytes);
        writer.number(-12.5);
        assert_eq!(writer.finish(), b"-12");
    }
}
