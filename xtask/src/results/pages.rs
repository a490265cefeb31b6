//! Renders the measured figures: `docs/results.md`, and the table in README.md.

use std::fmt::Write as _;

use super::data::{DATE, Data, REVISION, Section};
use super::measure::CAMPAIGN_RUNS;
use crate::build::BOARDS;

/// Lines around the generated part of README.md.
const START: &str = "<!-- results: written by `cargo xtask results` -->\n";
const END: &str = "<!-- end of results -->\n";

/// Longest line of a paragraph, in bytes.
const COLUMNS: usize = 98;

/// Filters in the tables of accuracy: key, text, and key of the cost.
const FILTERS: [(&str, &str); 7] = [
    ("kalman", "`kalman`, the default"),
    ("vqf", "VQF, with the tuning of its authors"),
    ("fusion", "Fusion, with gains found on BROAD and TUM-VI"),
    ("madgwick", "Madgwick, with gains found there"),
    ("mahony", "Mahony, with gains found there"),
    (
        "axis-kalman",
        "`axis-kalman`, the tutorial's with one filter per axis",
    ),
    ("classic", "`classic`, the tutorial's to the letter"),
];

/// Sets of recordings: key and title.
const SETS: [(&str, &str); 4] = [
    ("broad", "BROAD"),
    ("tumvi", "TUM-VI"),
    ("simulated", "simulated flights"),
    ("calibrated", "the same flights, calibrated in twelve poses"),
];

/// Returns README.md with the table that belongs there.
pub fn readme(before: &str, data: &Data) -> Result<String, String> {
    let missing = || format!("README.md needs the lines\n{START}{END}");
    let (head, rest) = before.split_once(START).ok_or_else(missing)?;
    let (_, tail) = rest.split_once(END).ok_or_else(missing)?;
    Ok(format!("{head}{START}{}{END}{tail}", summary(data)?))
}

/// Of a set that the default was tuned on: the median after a tuning on the others.
fn tuned_without(data: &Data, set: &str) -> Result<String, String> {
    let cells = data.section("leave-one-out")?.text(set)?;
    let tuned = cells.split(" | ").nth(2).unwrap_or(cells);
    let (median, _) = tuned.split_once('/').unwrap_or((tuned, ""));
    Ok(format!("; {median}° if tuned on the other sets"))
}

/// The table of README.md.
fn summary(data: &Data) -> Result<String, String> {
    let fly = data.section("fly")?;
    let [broad, tumvi, simulated, _] = SETS.map(|(set, _)| data.section(&format!("filters.{set}")));
    let (broad, tumvi, simulated) = (broad?, tumvi?, simulated?);
    let median = |section: &Section, filter: &str| {
        let pair = section.text(filter)?;
        let (median, _) = pair.split_once('/').unwrap_or((pair, ""));
        Ok::<String, String>(median.to_owned())
    };
    let mut text = String::from("| figure | measured |\n|---|---|\n");
    for (section, place, tuning) in [
        (
            broad,
            "{} recordings of BROAD: a sensor turned by a person",
            tuned_without(data, "BROAD")?,
        ),
        (
            tumvi,
            "{} recordings of TUM-VI: a sensor carried about",
            tuned_without(data, "TUM-VI")?,
        ),
        (
            simulated,
            "{} simulated quadrotor flights, gyroscope not calibrated",
            String::new(),
        ),
    ] {
        let place = place.replacen("{}", section.text("recordings")?, 1);
        let (ours, vqf) = (median(section, "kalman")?, median(section, "vqf")?);
        let _ = writeln!(
            text,
            "| tilt error, median of {place} | {ours}° (VQF: {vqf}°){tuning} |"
        );
    }
    let rows = [
        (
            "edge on INT to published attitude",
            format!(
                "{} on average, {} at most",
                us(fly, "edge_to_attitude_us_mean")?,
                us(fly, "edge_to_attitude_us_max")?
            ),
        ),
        (
            "instructions per sample",
            format!(
                "{}, of which {} in interrupts; {} at most",
                count(fly, "instructions_per_sample_mean")?,
                count(fly, "io_instructions_per_sample_mean")?,
                count(fly, "instructions_per_sample_max")?
            ),
        ),
        (
            "load of the core, telemetry included",
            format!("{} %", fixed(fly, "cpu_load_percent", 2)?),
        ),
        (
            "samples missed",
            format!("{} of {}", count(fly, "missed")?, count(fly, "samples")?),
        ),
        (
            "flash, RAM, stack",
            format!(
                "{}, {}, {} bytes",
                count(fly, "flash_bytes")?,
                count(fly, "ram_bytes")?,
                count(fly, "stack_bytes_used")?
            ),
        ),
    ];
    for (what, figure) in rows {
        let _ = writeln!(text, "| {what} | {figure} |");
    }
    Ok(text)
}

/// The page `docs/results.md`.
pub fn results(data: &Data) -> Result<String, String> {
    let parts = [
        flight(data)?,
        boards(data)?,
        long_flights(data)?,
        day(data)?,
        filters(data)?,
        cost(data)?,
        calibration(data)?,
        campaign(data)?,
        by_hand(data)?,
    ];
    let mut text = format!(
        "# Results\n\n{}",
        paragraph(
            "`cargo xtask results` measures these figures and writes this page from \
             [results.toml](results.toml). Do not edit it. [accuracy.md](accuracy.md) explains the \
             method. Nothing here was measured on a real board. The virtual board counts \
             instructions, not cycles. Measurements that take hours are kept while the filters \
             change. They name the revision of the filters, which \
             [CHANGELOG.md](../CHANGELOG.md#revisions-of-the-filters) lists."
        )
    );
    for part in parts {
        text.push('\n');
        text.push_str(&part);
    }
    Ok(text)
}

fn flight(data: &Data) -> Result<String, String> {
    let fly = data.section("fly")?;
    let mut text = opening(
        "One minute on the default board",
        fly,
        "`cargo xtask fly --seconds 60`: a simulated quadrotor with manoeuvres of up to 1 g, on an \
         STM32F405 at 168 MHz with 1,000 samples a second, a bus of 400 kHz, and text at 50 Hz on \
         UART and in the firmware log. Two runs with one seed write identical files.",
    )?;
    let rows = [
        ("samples", count(fly, "samples")?),
        (
            "samples missed, from the first published one on",
            count(fly, "missed")?,
        ),
        (
            "error of the time stamp, against the model's true edge",
            format!("{} µs at most", fixed(fly, "timestamp_error_us_max", 2)?),
        ),
        (
            "instructions per sample: interrupts and hand-over",
            format!(
                "{} on average",
                count(fly, "io_instructions_per_sample_mean")?
            ),
        ),
        (
            "instructions per sample: all work",
            format!(
                "{} on average, {} at most",
                count(fly, "instructions_per_sample_mean")?,
                count(fly, "instructions_per_sample_max")?
            ),
        ),
        (
            "edge on INT to published attitude; the bus alone takes 384 µs",
            format!(
                "{} on average, {} at most",
                us(fly, "edge_to_attitude_us_mean")?,
                us(fly, "edge_to_attitude_us_max")?
            ),
        ),
        (
            "load of the core, telemetry included",
            format!("{} %", fixed(fly, "cpu_load_percent", 2)?),
        ),
        (
            "tilt error, root mean square",
            format!("{}°", fixed(fly, "inclination_rms_deg", 2)?),
        ),
        (
            "tilt error, largest",
            format!("{}°", fixed(fly, "inclination_max_deg", 2)?),
        ),
        ("flash", format!("{} bytes", count(fly, "flash_bytes")?)),
        (
            "RAM, without the stack",
            format!("{} bytes", count(fly, "ram_bytes")?),
        ),
        (
            "stack used",
            format!("{} bytes", count(fly, "stack_bytes_used")?),
        ),
    ];
    text.push_str(&table(["figure", "measured"], rows));
    let size = data.section("size")?;
    text.push('\n');
    text.push_str(&paragraph(&format!(
        "With the profile `firmware`, for size, the build without compass takes {} bytes of flash, \
         the minimal build (without commands, MAVLink, flight log and compass) {}, and the example \
         `rtic.rs` {}. The Kalman filter alone adds {} bytes to an empty image.",
        count(size, "without_compass_flash_bytes")?,
        count(size, "minimal_flash_bytes")?,
        count(size, "rtic_flash_bytes")?,
        count(size, "kalman_flash_bytes")?
    )));
    Ok(text)
}

fn boards(data: &Data) -> Result<String, String> {
    let mut text = opening(
        "Every board",
        data.section("board.stm32f405")?,
        "`cargo xtask fly --seconds 20 --board NAME`.",
    )?;
    text.push_str(
        "| board | flash, bytes | RAM, bytes | edge to attitude, at most | load | missed |\n\
         |---|---|---|---|---|---|\n",
    );
    for board in BOARDS {
        let section = data.section(&format!("board.{}", board.name))?;
        let _ = writeln!(
            text,
            "| `{}` | {} | {} | {} | {} % | {} |",
            board.name,
            count(section, "flash_bytes")?,
            count(section, "ram_bytes")?,
            us(section, "edge_to_attitude_us_max")?,
            fixed(section, "cpu_load_percent", 2)?,
            count(section, "missed")?
        );
    }
    Ok(text)
}

fn long_flights(data: &Data) -> Result<String, String> {
    let (hour, recorded) = (data.section("hour")?, data.section("recorded")?);
    let flown = format!(
        "`cargo xtask fly --seconds 3600`, a part of `cargo xtask results --long`, takes 2 GB of \
         memory and some minutes: {} samples, {} missed, {} from edge to attitude at most, tilt \
         error {}° root mean square.",
        count(hour, "samples")?,
        count(hour, "missed")?,
        us(hour, "edge_to_attitude_us_max")?,
        fixed(hour, "inclination_rms_deg", 2)?
    );
    let mut text = opening("An hour, and recorded motion", hour, &flown)?;
    text.push_str(&paragraph(&format!(
        "`cargo xtask fly --log FILE` flies a recording of a real sensor's motion ({}):",
        recorded.text(DATE)?
    )));
    text.push('\n');
    let rows = [
        (
            "`broad/01.csv.gz`: slow rotation by a person",
            format!("{}°", fixed(recorded, "broad_01_rms_deg", 2)?),
        ),
        (
            "`tumvi/room1.csv.gz`: walking about",
            format!("{}°", fixed(recorded, "tumvi_room1_rms_deg", 2)?),
        ),
    ];
    text.push_str(&table(["recording", "tilt error, root mean square"], rows));
    Ok(text)
}

fn day(data: &Data) -> Result<String, String> {
    let section = data.section("day")?;
    let hours = section.number("hours")?;
    let flown = format!(
        "`cargo xtask bench --long {}`, a part of `cargo xtask results --long`: simulated flights \
         of {hours} h in memory, a sample each ms, factory accelerometer, gyroscope offset of \
         4 °/s. All but the first minute counts.",
        3_600.0 * hours
    );
    let mut text = opening("Hours in the air", section, &flown)?;
    text.push_str(
        "| seed | `VALID` | rms, hour 2 | rms, last hour | largest | within 3 σ | wrong while \
         `VALID` |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for (seed, cells) in section.figures().filter(|(key, _)| *key != "hours") {
        let _ = writeln!(text, "| {seed} | {cells} |");
    }
    Ok(text)
}

fn filters(data: &Data) -> Result<String, String> {
    let mut text = opening(
        "Filters side by side",
        data.section("filters.broad")?,
        "`cargo xtask bench`: the error of the tilt in degrees, root mean square over the rows \
         that count after 5 s, as median/mean over the recordings.",
    )?;
    text.push_str("| filter |");
    for (set, title) in SETS {
        let section = data.section(&format!("filters.{set}"))?;
        let _ = write!(text, " {title}, {} |", section.text("recordings")?);
    }
    text.push('\n');
    text.push_str(&"|---".repeat(1 + SETS.len()));
    text.push_str("|\n");
    for (filter, title) in FILTERS {
        let _ = write!(text, "| {title} |");
        for (set, _) in SETS {
            let section = data.section(&format!("filters.{set}"))?;
            let _ = write!(text, " {} |", section.text(filter)?);
        }
        text.push('\n');
    }
    let left_out = data.section("leave-one-out")?;
    text.push('\n');
    text.push_str(&paragraph(&format!(
        "`cargo xtask bench --leave-one-out` ({}, revision {}) tunes on all sets but one and \
         judges on it:",
        left_out.text(DATE)?,
        left_out.text(REVISION)?
    )));
    text.push_str(
        "\n| left out | default tuning | tuned, the sensor's known errors stay | tuned, every \
         number | VQF, as above |\n\
         |---|---|---|---|---|\n",
    );
    for (set, cells) in left_out.figures() {
        let _ = writeln!(text, "| {set} | {cells} |");
    }
    Ok(text)
}

fn cost(data: &Data) -> Result<String, String> {
    let (cost, size) = (data.section("cost")?, data.section("size")?);
    let measured = format!(
        "`cargo xtask cost`: a sample in, quaternion and body rates out, on a Cortex-M4F in QEMU, \
         held to `tests/golden/cost.txt`. Flash and RAM are bytes. The profile is `rigs`, for \
         speed; with `firmware`, for size, `kalman` has {} bytes. VQF is not measured.",
        count(size, "kalman_flash_bytes")?
    );
    let mut text = opening("Cost of one update", cost, &measured)?;
    text.push_str(
        "| filter | instructions, mean | worst after the first | first | flash | RAM |\n\
         |---|---|---|---|---|---|\n",
    );
    for (filter, cells) in cost.figures() {
        let cells: Vec<&str> = cells.split(' ').collect();
        let _ = writeln!(text, "| {filter} | {} |", cells.join(" | "));
    }
    Ok(text)
}

fn calibration(data: &Data) -> Result<String, String> {
    let section = data.section("calibration")?;
    let mut text = opening(
        "Calibration of two hundred simulated chips",
        section,
        "Chips from anywhere in the datasheet's tolerance, poses up to 5° off \
         (`models/tests/calibration.rs`).",
    )?;
    text.push_str(&table(["figure", "measured"], section.figures()));
    Ok(text)
}

fn campaign(data: &Data) -> Result<String, String> {
    let campaign = data.section("campaign")?;
    let flown = format!(
        "`cargo xtask faults --runs {} --seed {}`: {} flights, {} failed. \
         `cargo xtask results --long` flies {CAMPAIGN_RUNS} from seed 1 on. \"Worst\" is the \
         longest recovery of an episode that the fault was a part of, often with another beside \
         it. [faults.md](faults.md) lists what must hold in every flight.",
        campaign.text("runs")?,
        campaign.text("seed")?,
        count(campaign, "runs")?,
        count(campaign, "failed")?
    );
    let mut text = opening("Flights with faults by chance", campaign, &flown)?;
    text.push_str("| fault | runs | recovered | worst |\n|---|---|---|---|\n");
    for (fault, cells) in campaign.figures() {
        if let [runs, recovered, worst] = cells.split(' ').collect::<Vec<_>>()[..] {
            let _ = writeln!(text, "| `{fault}` | {runs} | {recovered} | {worst} ms |");
        }
    }
    Ok(text)
}

fn by_hand(data: &Data) -> Result<String, String> {
    let section = data.section("by-hand")?;
    let mut text = String::from(
        "## Measured by hand\n\n\
         `cargo xtask results` keeps these as they are in results.toml.\n\n\
         | figure | measured | date, revision |\n|---|---|---|\n",
    );
    for (figure, cells) in section.figures() {
        let _ = writeln!(text, "| {figure} | {cells} |");
    }
    Ok(text)
}

/// A heading, and the paragraph below it: date, revision where the section has one, and the text.
fn opening(title: &str, section: &Section, text: &str) -> Result<String, String> {
    let revision = match section.text(REVISION) {
        Ok(revision) => format!(" with revision {revision} of the filters"),
        Err(_) => String::new(),
    };
    let date = section.text(DATE)?;
    let text = paragraph(&format!("Measured on {date}{revision}. {text}"));
    Ok(format!("## {title}\n\n{text}\n"))
}

/// Breaks a text into lines of at most [`COLUMNS`] bytes. A piece of code stays in one line.
fn paragraph(text: &str) -> String {
    let (mut lines, mut column) = (String::new(), 0);
    let mut is_code = false;
    for word in text.split_inclusive(|c| {
        is_code ^= c == '`';
        c == ' ' && !is_code
    }) {
        if column > 0 && column + word.trim_end().len() > COLUMNS {
            lines.truncate(lines.trim_end().len());
            lines.push('\n');
            column = 0;
        }
        lines.push_str(word);
        column += word.len();
    }
    lines.push('\n');
    lines
}

fn table<K: AsRef<str>, V: AsRef<str>>(
    [key, value]: [&str; 2],
    rows: impl IntoIterator<Item = (K, V)>,
) -> String {
    let mut text = format!("| {key} | {value} |\n|---|---|\n");
    for (key, value) in rows {
        let _ = writeln!(text, "| {} | {} |", key.as_ref(), value.as_ref());
    }
    text
}

/// A whole number with commas.
fn count(section: &Section, key: &str) -> Result<String, String> {
    let digits = format!("{:.0}", section.number(key)?);
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index) % 3 == 0 {
            text.push(',');
        }
        text.push(digit);
    }
    Ok(text)
}

fn us(section: &Section, key: &str) -> Result<String, String> {
    Ok(format!("{} µs", fixed(section, key, 1)?))
}

fn fixed(section: &Section, key: &str, decimals: usize) -> Result<String, String> {
    Ok(format!("{:.decimals$}", section.number(key)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn committed() -> Data {
        let path = crate::root().join("docs/results.toml");
        let text = std::fs::read_to_string(path).expect("the data are committed");
        Data::parse(&text).expect("they are right")
    }

    #[test]
    fn counts_have_commas_and_figures_their_decimals() {
        let mut section = Section::new("a", "2026-11-22");
        for (key, value) in [("x", "7"), ("y", "1018.4"), ("z", "3574746")] {
            section.put(key, value);
        }
        let counts = ["x", "y", "z"].map(|key| count(&section, key).expect("a number"));
        assert_eq!(counts, ["7", "1,018", "3,574,746"]);
        assert_eq!(us(&section, "y"), Ok("1018.4 µs".to_owned()));
    }

    #[test]
    fn paragraphs_have_short_lines_and_whole_pieces_of_code() {
        let word = "x".repeat(48);
        assert_eq!(
            paragraph(&format!("{word} {word}")),
            format!("{word} {word}\n")
        );
        let broken = format!("{word} {word}\n`a b` c\n");
        assert_eq!(paragraph(&format!("{word} {word} `a b` c")), broken);
    }

    #[test]
    fn the_readme_keeps_all_but_the_table() {
        let data = committed();
        let before = format!("# a\n\n{START}old\n{END}\nrest\n");
        let after = readme(&before, &data).expect("the data are complete");
        assert!(after.starts_with("# a\n\n") && after.ends_with("\nrest\n"));
        assert!(!after.contains("old") && after.contains("BROAD"));
        assert_eq!(readme(&after, &data).as_ref(), Ok(&after));
        assert!(readme("# a\n", &data).is_err_and(|error| error.contains(START)));
    }

    #[test]
    fn a_figure_that_is_missing_is_named() {
        let error = results(&Data::default()).expect_err("nothing is there");
        assert!(error.contains("[fly]"), "{error}");
    }

    #[test]
    fn every_board_and_every_fault_has_a_row() {
        let page = results(&committed()).expect("the data are complete");
        for board in BOARDS {
            assert!(page.contains(&format!("| `{}` |", board.name)));
        }
        let faults = std::fs::read_to_string(crate::root().join("docs/faults.md")).expect("a page");
        let table = faults
            .lines()
            .skip_while(|line| !line.starts_with("| fault |"));
        let mut kinds = 0;
        for row in table.skip(2).take_while(|line| line.starts_with('|')) {
            let cell = row.split('|').nth(1).unwrap_or_default();
            for fault in cell.split('`').skip(1).step_by(2) {
                let kind = fault.split(':').next().unwrap_or_default();
                assert!(
                    page.contains(&format!("| `{kind}` |")),
                    "{kind} has no row: run `cargo xtask results --long`"
                );
                kinds += 1;
            }
        }
        assert!(kinds > 38, "docs/faults.md has {kinds} faults");
    }

    #[test]
    fn a_long_measurement_names_its_revision() {
        let section = Section::new("day", "2026-11-22");
        let short = "## A\n\nMeasured on 2026-11-22. B.\n\n".to_owned();
        assert_eq!(opening("A", &section, "B."), Ok(short));
        let long = "## A\n\nMeasured on 2026-11-22 with revision 19 of the filters. B.\n\n";
        let opened = opening("A", &section.with_revision(19), "B.");
        assert_eq!(opened.as_deref(), Ok(long));
        let data = committed();
        for name in ["hour", "day", "campaign", "leave-one-out"] {
            assert!(
                data.section(name).is_ok_and(|s| s.text(REVISION).is_ok()),
                "{name}"
            );
        }
    }
}
