//! Tables of attitudes: the attitude CSV of `replay` and `fly`, and their truth.

use aplomb::attitude::{EulerAngles, Quaternion};
use aplomb::health::Flags;
use aplomb::units::{degrees, radians};

use crate::quote::quote;

/// Largest deviation of a quaternion's length from 1.
const LENGTH_TOLERANCE: f32 = 0.01;

/// Columns of a table, by their places.
#[derive(Debug)]
pub struct Columns {
    time: usize,
    attitude: Place,
    rates: Option<[usize; 3]>,
    sigma: Option<usize>,
    flags: Option<usize>,
    scored: Option<usize>,
}

/// Places of the attitude's columns.
#[derive(Debug)]
enum Place {
    /// Places of w, x, y and z.
    Quaternion([usize; 4]),
    /// Places of roll, pitch and yaw.
    Angles([usize; 3]),
}

/// Attitude in the form of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Attitude {
    /// Body to earth.
    Quaternion(Quaternion),
    /// Roll, pitch and yaw in degrees.
    Angles([f32; 3]),
}

/// Row of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Time, µs.
    pub t_us: i64,
    /// Attitude.
    pub attitude: Attitude,
    /// Rates about forward, right and down, °/s.
    pub rates_deg_s: Option<[f32; 3]>,
    /// σ of the tilt, degrees.
    pub tilt_sigma_deg: Option<f32>,
    /// Flags, if the table has them.
    pub flags: Option<Flags>,
    /// True if the row counts for scores.
    pub scored: bool,
}

impl Attitude {
    /// Returns the rotation body to earth.
    #[must_use]
    pub fn quaternion(self) -> Quaternion {
        match self {
            Self::Quaternion(quaternion) => quaternion,
            Self::Angles(angles) => {
                let [roll_rad, pitch_rad, yaw_rad] = angles.map(radians);
                Quaternion::from_euler(EulerAngles {
                    roll_rad,
                    pitch_rad,
                    yaw_rad,
                })
            }
        }
    }

    /// Returns roll, pitch and yaw, degrees.
    #[must_use]
    pub fn angles_deg(self) -> [f32; 3] {
        match self {
            Self::Quaternion(quaternion) => {
                let angles = quaternion.to_euler();
                [angles.roll_rad, angles.pitch_rad, angles.yaw_rad].map(degrees)
            }
            Self::Angles(angles) => angles,
        }
    }
}

impl Columns {
    /// Returns the columns of a header with a time and an attitude; `None` for others, and for
    /// logs.
    #[must_use]
    pub fn of(header: &str) -> Option<Self> {
        let names: Vec<&str> = header.split(',').collect();
        let place = |name: &str| names.iter().position(|other| *other == name);
        let all = |columns: [&str; 3]| {
            let [a, b, c] = columns.map(place);
            Some([a?, b?, c?])
        };
        if place("ax").is_some() {
            return None;
        }
        let attitude = match (place("qw"), all(["qx", "qy", "qz"])) {
            (Some(w), Some([x, y, z])) => Place::Quaternion([w, x, y, z]),
            _ => Place::Angles(all(["roll_deg", "pitch_deg", "yaw_deg"])?),
        };
        Some(Self {
            time: place("t_us")?,
            attitude,
            rates: all(["roll_rate_dps", "pitch_rate_dps", "yaw_rate_dps"]),
            sigma: place("tilt_sigma_deg"),
            flags: place("flags"),
            scored: place("scored"),
        })
    }

    /// Returns whether the table has flags.
    #[must_use]
    pub fn has_flags(&self) -> bool {
        self.flags.is_some()
    }

    /// Reads a row.
    ///
    /// # Errors
    ///
    /// Returns the fault of the row.
    pub fn row(&self, line: &str) -> Result<Row, String> {
        let cells: Vec<&str> = line.split(',').collect();
        let cell = |index: usize| {
            let cell = cells.get(index).copied();
            cell.ok_or_else(|| format!("the row has {} columns only", cells.len()))
        };
        let number = |index: usize| -> Result<f32, String> {
            let cell = cell(index)?;
            let number = cell.parse().ok().filter(|number: &f32| number.is_finite());
            number.ok_or_else(|| format!("\"{}\" is not a number", quote(cell)))
        };
        let numbers = |[a, b, c]: [usize; 3]| Ok::<_, String>([number(a)?, number(b)?, number(c)?]);
        let attitude = match self.attitude {
            Place::Quaternion([w, x, y, z]) => {
                let [x, y, z] = numbers([x, y, z])?;
                let quaternion = Quaternion::new(number(w)?, x, y, z);
                let length = quaternion.dot(quaternion).sqrt();
                if (length - 1.0).abs() > LENGTH_TOLERANCE {
                    return Err(format!(
                        "qw,qx,qy,qz has the length {length:.4}, but a rotation's is 1"
                    ));
                }
                Attitude::Quaternion(quaternion)
            }
            Place::Angles(places) => Attitude::Angles(numbers(places)?),
        };
        let rates_deg_s = self.rates.map(numbers).transpose()?;
        let tilt_sigma_deg = match self.sigma {
            Some(index) if !cell(index)?.is_empty() => Some(number(index)?),
            _ => None,
        };
        let flags = |index| {
            let cell = cell(index)?;
            cell.parse::<Flags>()
                .map_err(|_| format!("\"{}\" are no flags", quote(cell)))
        };
        let scored = match self.scored.map(cell).transpose()? {
            None | Some("1") => true,
            Some("0") => false,
            Some(other) => {
                let other = quote(other);
                return Err(format!("scored is \"{other}\", but must be 0 or 1"));
            }
        };
        let time = cell(self.time)?;
        Ok(Row {
            t_us: time.parse().map_err(|_| {
                let time = quote(time);
                format!("t_us is \"{time}\", which is not a whole number of microseconds")
            })?,
            attitude,
            rates_deg_s,
            tilt_sigma_deg,
            flags: self.flags.map(flags).transpose()?,
            scored,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const HEADER: &str = "t_us,qw,qx,qy,qz,roll_deg,pitch_deg,yaw_deg,\
        roll_rate_dps,pitch_rate_dps,yaw_rate_dps,tilt_sigma_deg,flags,scored";

    #[test]
    fn each_fault_of_a_row_is_named() {
        let columns = Columns::of(HEADER).expect("a header");
        let good = "-5,1,0,0,0,0,0,0,1,2,3,0.5,VALID|MISSED,0";
        let row = columns.row(good).expect("a row");
        assert_eq!((row.t_us, row.scored), (-5, false));
        assert_eq!(row.rates_deg_s, Some([1.0, 2.0, 3.0]));
        assert_eq!(row.flags, Some(Flags::VALID | Flags::MISSED));
        for (from, to, reason) in [
            (
                "-5,",
                "0.5,",
                "t_us is \"0.5\", which is not a whole number of microseconds",
            ),
            (
                ",1,0",
                ",1.1,0",
                "qw,qx,qy,qz has the length 1.1000, but a rotation's is 1",
            ),
            (",1,0", ",nan,0", "\"nan\" is not a number"),
            (",2,", ",x,", "\"x\" is not a number"),
            ("0.5", "inf", "\"inf\" is not a number"),
            ("MISSED", "LOST", "\"VALID|LOST\" are no flags"),
            (
                "MISSED,0",
                "MISSED,2",
                "scored is \"2\", but must be 0 or 1",
            ),
            (",0.5,VALID|MISSED,0", "", "the row has 11 columns only"),
        ] {
            let line = good.replacen(from, to, 1);
            assert_eq!(columns.row(&line), Err(reason.to_owned()), "{line}");
        }
        for header in [
            "t_us,ax,qw,qx,qy,qz",
            "qw,qx,qy,qz",
            "t_us,qw,qx,qy",
            "t_us,roll_deg,yaw_deg",
            "",
        ] {
            assert!(Columns::of(header).is_none(), "{header}");
        }
    }

    proptest! {
        #[test]
        fn any_table_is_read_or_refused(
            header in prop::collection::vec(
                prop::sample::select(HEADER.split(',').collect::<Vec<_>>()),
                0..20,
            ),
            line in "(-?[0-9.]{0,3}|1|0|nan|VALID|é){0,1}(,(-?[0-9.]{0,3}|1|0|inf|GAP|)){0,18}",
        ) {
            let Some(columns) = Columns::of(&header.join(",")) else {
                return Ok(());
            };
            match columns.row(&line) {
                Ok(row) => {
                    let attitude = row.attitude.quaternion();
                    prop_assert!((attitude.dot(attitude) - 1.0).abs() < 0.03);
                    prop_assert!(row.attitude.angles_deg().iter().all(|angle| angle.is_finite()));
                }
                Err(reason) => prop_assert!(!reason.is_empty()),
            }
        }

        #[test]
        fn an_attitude_is_the_same_in_both_forms(
            roll in -179.0_f32..179.0,
            pitch in -85.0_f32..85.0,
            yaw in -179.0_f32..179.0,
        ) {
            let q = Attitude::Angles([roll, pitch, yaw]).quaternion();
            let columns = Columns::of("qx,qy,qz,qw,t_us").expect("a header");
            let line = format!("{},{},{},{},7", q.x, q.y, q.z, q.w);
            let row = columns.row(&line).map_err(TestCaseError::fail)?;
            for (read, written) in row.attitude.angles_deg().into_iter().zip([roll, pitch, yaw]) {
                prop_assert!((read - written).abs() < 1e-2, "{read} {written}");
            }
        }
    }
}
