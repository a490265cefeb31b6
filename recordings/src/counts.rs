//! Logs of register counts instead of SI units.

use crate::log::Row;

/// Returns the register counts of a row: accelerometer, then gyroscope.
///
/// A logger that turns an axis around makes 32768 of the register's −32768: full scale too.
///
/// # Errors
///
/// Names the first cell that is no count of a 16-bit register.
pub fn counts(row: &Row) -> Result<[[i16; 3]; 2], String> {
    let mut counts = [[0; 3]; 2];
    let groups = [&row.specific_force_m_s2, &row.rates_rad_s];
    for (group, values) in groups.into_iter().enumerate() {
        for (axis, &value) in values.iter().enumerate() {
            // The conversion saturates.
            let count = value as i16;
            if value.fract() != 0.0 || !(-32_768.0..=32_768.0).contains(&value) {
                let column = ["ax", "ay", "az", "gx", "gy", "gz"][3 * group + axis];
                return Err(format!(
                    "{column} is {value}, which is not a count of a 16-bit register"
                ));
            }
            counts[group][axis] = count;
        }
    }
    Ok(counts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::{LogColumns, parse_row};

    #[test]
    fn counts_are_those_of_a_register_and_full_scale_may_be_turned_around() {
        let line = |cell: &str| format!("0,1,-2,{cell},4,5,-32768");
        let row = |cell: &str| parse_row(&line(cell), LogColumns::SENSOR).unwrap();
        let read = |cell: &str| counts(&row(cell));
        assert_eq!(read("3"), Ok([[1, -2, 3], [4, 5, i16::MIN]]));
        assert_eq!(read("32768"), Ok([[1, -2, i16::MAX], [4, 5, i16::MIN]]));
        for cell in ["0.5", "32769", "-32769", "inf", "nan"] {
            assert!(read(cell).unwrap_err().starts_with("az is "), "{cell}");
        }
    }
}
