//! Columns of a log by their names, and the first difference of a header from that of a log.

use crate::row::{ARMED, COLUMNS, COMPASS, SENSOR_COLUMNS};

/// Order of a table's cells, if it is not that of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Order {
    /// Places of the cells of a log.
    places: Vec<usize>,
    /// Cells of a row.
    pub(crate) cells: usize,
    /// Names of the columns that are not used.
    pub(crate) unused: Vec<String>,
}

impl Order {
    /// Returns the order of a table with this header, and the header of a log with its columns;
    /// `None` if columns of a log are missing, or occur twice.
    pub(crate) fn of(header: &str) -> Option<(Self, String)> {
        let names: Vec<&str> = header.split(',').map(str::trim).collect();
        let place = |name: &&'static str| {
            let mut found = names.iter().enumerate().filter(|(_, own)| *own == name);
            let place = found.next().map(|(place, _)| (*name, place));
            place.filter(|_| found.next().is_none())
        };
        let (sensor, truth) = COLUMNS.split_at(SENSOR_COLUMNS);
        let (truth, moving) = truth.split_at(truth.len() - 1);
        let mut used: Vec<(&str, usize)> = sensor.iter().map(place).collect::<Option<_>>()?;
        for group in [&COMPASS[..], truth, moving, &ARMED] {
            if group.iter().any(|name| names.contains(name)) {
                let group: Option<Vec<_>> = group.iter().map(place).collect();
                used.extend(group?);
            }
        }
        // Rows that count need a truth.
        if names.contains(&"mov") && !names.contains(&"qw") {
            return None;
        }
        let places: Vec<usize> = used.iter().map(|(_, place)| *place).collect();
        let unused = names.iter().enumerate();
        let unused = unused.filter(|(place, name)| !places.contains(place) && !name.is_empty());
        let names: Vec<&str> = used.iter().map(|(name, _)| *name).collect();
        let order = Self {
            cells: header.split(',').count(),
            unused: unused.map(|(_, name)| (*name).to_owned()).collect(),
            places,
        };
        Some((order, names.join(",")))
    }

    /// Puts the cells of a row in the order of a log. Returns false, if their number is another.
    pub(crate) fn arrange(&self, row: &str, arranged: &mut String) -> bool {
        arranged.clear();
        let cells: Vec<&str> = row.split(',').map(str::trim).collect();
        if cells.len() != self.cells {
            return false;
        }
        for (index, place) in self.places.iter().enumerate() {
            if index > 0 {
                arranged.push(',');
            }
            arranged.push_str(cells[*place]);
        }
        true
    }
}

/// Returns the first difference of a header from that of a log, with what to do; empty if none is
/// certain.
pub(crate) fn difference(header: &str) -> String {
    let is_log = |header: &str| Order::of(header).is_some();
    if header.contains('\r') {
        return "the lines end with carriage returns alone; save the file with line feeds".into();
    }
    if header.contains(['[', '(']) && is_log(&without_units(header)) {
        return "the names hold units; write the names alone, such as ax, and name the units by \
                options such as --force-unit g and --rate-unit deg/s"
            .into();
    }
    for (separator, name) in [(';', "semicolons"), ('\t', "tabs"), (' ', "spaces")] {
        if header.contains(separator) && is_log(&header.replace(separator, ",")) {
            let decimals = if separator == ';' {
                ", with decimal points"
            } else {
                ""
            };
            return format!("{name} separate the columns; save the file with commas{decimals}");
        }
    }
    if is_log(&header.replace('"', "")) {
        return "the names are in quotes; remove the quotes".into();
    }
    if is_log(&header.to_lowercase()) {
        return "write the names in lower case".into();
    }
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    if names.len() >= SENSOR_COLUMNS && names.iter().all(|name| is_number(name)) {
        return "this is a row of numbers; add the header as the first line".into();
    }
    let known = || COLUMNS.iter().chain(&COMPASS).chain(&ARMED);
    let count = |name: &str| names.iter().filter(|own| **own == name).count();
    if let Some(name) = known().find(|name| count(name) > 1) {
        return format!("{name} is there twice");
    }
    if count("mov") > 0 && count("qw") == 0 {
        return "mov needs a truth, qw,qx,qy,qz; remove the column, or add these".into();
    }
    let missing = |group: &[&'static str]| group.iter().copied().find(|name| count(name) == 0);
    let (sensor, truth) = COLUMNS.split_at(SENSOR_COLUMNS);
    let groups = [sensor, &COMPASS, &truth[..4]];
    // Without any name of a sensor this is another table.
    let mut some = groups.iter().filter(|group| {
        let found = group.iter().filter(|name| count(name) > 0).count();
        (1..group.len()).contains(&found)
    });
    match some.next().and_then(|group| missing(group)) {
        Some(name) => format!("{name} is missing; rename the column, or add it"),
        None => String::new(),
    }
}

/// Returns a header whose names end before their first bracket.
fn without_units(header: &str) -> String {
    let names = header.split(',').map(|name| name.split(['[', '(']).next());
    let names: Vec<&str> = names.flatten().map(str::trim).collect();
    names.join(",")
}

fn is_number(cell: &str) -> bool {
    cell.is_empty() || cell.parse::<f64>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG: &str = "t_us,ax,ay,az,gx,gy,gz";

    #[test]
    fn columns_are_found_by_name_in_any_order() {
        let (order, header) = Order::of("t_us, gx,gy,gz ,temp,ax,ay,az,").expect("a log");
        assert_eq!((header.as_str(), order.cells), (LOG, 9));
        assert_eq!(order.unused, ["temp"]);
        let mut row = String::new();
        assert!(order.arrange("1,5,6,7,25,2,3,4,", &mut row));
        assert_eq!(row, "1,2,3,4,5,6,7");
        assert!(!order.arrange("1,5,6,7,25,2,3,4", &mut row));
        let (order, header) = Order::of(&format!("mov,qz,qy,qx,qw,{LOG},mz,my,mx")).expect("a log");
        assert_eq!(header, format!("{LOG},mx,my,mz,qw,qx,qy,qz,mov"));
        assert!(order.unused.is_empty());
        let (order, header) = Order::of(&format!("armed,{LOG}")).expect("a log");
        assert_eq!(header, format!("{LOG},armed"));
        assert!(order.unused.is_empty() && order.arrange("1,0,2,3,4,5,6,7", &mut row));
        assert_eq!(row, "0,2,3,4,5,6,7,1");
        for incomplete in [
            "t_us,ax,ay,az,gx,gy",
            &format!("{LOG},mov"),
            &format!("{LOG},mx"),
            &format!("{LOG},ax"),
            &format!("{LOG},armed,armed"),
        ] {
            assert_eq!(Order::of(incomplete), None, "{incomplete}");
        }
    }

    #[test]
    fn the_first_difference_of_a_header_is_named() {
        for (header, expected) in [
            (LOG.replace(',', ";"), "semicolons"),
            (LOG.replace(',', "\t"), "tabs"),
            (LOG.to_uppercase(), "lower case"),
            (LOG.replace("ax", "ax [g]"), "the names hold units"),
            (LOG.replace("gz", "gz (deg/s)"), "the names hold units"),
            (format!("\"{}\"", LOG.replace(',', "\",\"")), "in quotes"),
            (LOG.replace("t_us", "time"), "t_us is missing"),
            (LOG.replace(",gz", ""), "gz is missing"),
            (format!("{LOG},mx,my"), "mz is missing"),
            (format!("{LOG},gx"), "gx is there twice"),
            (format!("{LOG},armed,armed"), "armed is there twice"),
            (format!("{LOG},mov"), "mov needs a truth"),
            ("1000,0,0,9.81,0,0,0,,,".to_owned(), "a row of numbers"),
            (format!("{LOG}\r1,2,3,4,5,6,7"), "carriage returns"),
        ] {
            let found = difference(&header);
            assert!(found.contains(expected), "{header}: {found}");
        }
        assert_eq!(difference("time,roll,pitch,yaw"), "");
    }
}
