//! The data file of the measured figures, `docs/results.toml`.
//!
//! A small part of TOML: sections, each with lines `key = value`. A number is plain, a text is in
//! quotes. The order of sections and lines is kept.

use std::fmt::Write as _;

/// First lines of the file.
const HEADER: &str = "\
# Measured figures. `cargo xtask results` measures and writes them, and README.md and
# docs/results.md with them. `cargo xtask results --render` writes the pages alone.
";

/// Name of a section's line with the date of its measurement.
pub const DATE: &str = "date";
/// Name of a section's line with the revision of the filters that were measured. Sections without
/// it are measured anew with each change of the filters.
pub const REVISION: &str = "revision";

/// The contents of the file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Data {
    sections: Vec<Section>,
}

/// Figures that were measured together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Section {
    name: String,
    lines: Vec<(String, String)>,
}

impl Section {
    /// An empty section of this name, dated.
    pub fn new(name: &str, date: &str) -> Self {
        let mut section = Self {
            name: name.to_owned(),
            lines: Vec::new(),
        };
        section.put(DATE, date);
        section
    }

    /// Adds the revision of the filters, after the date.
    pub fn with_revision(mut self, revision: u16) -> Self {
        let line = (REVISION.to_owned(), revision.to_string());
        self.lines.insert(1.min(self.lines.len()), line);
        self
    }

    /// Appends a line.
    pub fn put(&mut self, key: &str, value: impl ToString) {
        self.lines.push((key.to_owned(), value.to_string()));
    }

    /// All keys and values but date and revision.
    pub fn figures(&self) -> impl Iterator<Item = (&str, &str)> {
        let is_figure = |key: &str| ![DATE, REVISION].contains(&key);
        let lines = self.lines.iter().filter(move |(key, _)| is_figure(key));
        lines.map(|(key, value)| (key.as_str(), value.as_str()))
    }

    /// Returns the value of a key, or an error that names both.
    pub fn text(&self, key: &str) -> Result<&str, String> {
        let line = self.lines.iter().find(|(name, _)| name == key);
        line.map(|(_, value)| value.as_str())
            .ok_or_else(|| format!("[{}] has no `{key}`", self.name))
    }

    /// Returns the number of a key, or an error that names it.
    pub fn number(&self, key: &str) -> Result<f64, String> {
        let text = self.text(key)?;
        text.parse()
            .map_err(|_| format!("[{}] {key}: `{text}` is not a number", self.name))
    }
}

impl Data {
    /// Reads the file's text.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut data = Self::default();
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let place = || format!("line {}: `{line}`", index + 1);
            if let Some(name) = line.strip_prefix('[') {
                let name = name.strip_suffix(']').ok_or_else(place)?;
                let lines = Vec::new();
                data.sections.push(Section {
                    name: name.to_owned(),
                    lines,
                });
                continue;
            }
            let (key, value) = line.split_once('=').ok_or_else(place)?;
            let section = data.sections.last_mut().ok_or_else(place)?;
            let key = key.trim().trim_matches('"');
            section.put(key, unquoted(value.trim()).ok_or_else(place)?);
        }
        Ok(data)
    }

    /// Returns the section of this name, or an error that names it.
    pub fn section(&self, name: &str) -> Result<&Section, String> {
        let section = self.sections.iter().find(|section| section.name == name);
        section.ok_or_else(|| format!("there is no section [{name}]"))
    }

    /// Puts a section in the place of the one with its name, or at the end.
    pub fn replace(&mut self, section: Section) {
        let mut sections = self.sections.iter_mut();
        match sections.find(|before| before.name == section.name) {
            Some(before) => *before = section,
            None => self.sections.push(section),
        }
    }

    /// The sections whose names begin with `prefix`.
    pub fn part(&self, prefix: &str) -> Self {
        let sections = self.sections.iter();
        let sections = sections.filter(|section| section.name.starts_with(prefix));
        Self {
            sections: sections.cloned().collect(),
        }
    }

    /// The text of the file.
    pub fn to_text(&self) -> String {
        let mut text = HEADER.to_owned();
        for Section { name, lines } in &self.sections {
            let _ = writeln!(text, "\n[{name}]");
            for (key, value) in lines {
                let is_bare = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
                let quote = if key.chars().all(is_bare) { "" } else { "\"" };
                let _ = write!(text, "{quote}{key}{quote} = ");
                let _ = if value.parse::<f64>().is_ok() {
                    writeln!(text, "{value}")
                } else {
                    writeln!(text, "\"{value}\"")
                };
            }
        }
        text
    }
}

/// A number as it is, a text without its quotes.
fn unquoted(value: &str) -> Option<&str> {
    match value.strip_prefix('"') {
        Some(rest) => rest.strip_suffix('"').filter(|text| !text.contains('"')),
        None => value.parse::<f64>().is_ok().then_some(value),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_reads_back() {
        let mut section = Section::new("fly", "2026-11-22");
        section.put("missed", 0);
        section.put("load_percent", 0.89);
        section.put("kalman + sigma", "0.38/0.44");
        let mut data = Data::default();
        data.replace(section);
        let text = data.to_text();
        assert!(text.contains("[fly]\ndate = \"2026-11-22\"\nmissed = 0\n"));
        assert!(text.contains("\n\"kalman + sigma\" = \"0.38/0.44\"\n"));
        assert_eq!(Data::parse(&text), Ok(data.clone()));
        let fly = data.section("fly").expect("a section");
        assert_eq!(fly.number("load_percent"), Ok(0.89));
        assert_eq!(fly.figures().count(), 3);
        let fly = fly.clone().with_revision(19);
        assert_eq!(fly.figures().count(), 3);
        data.replace(fly);
        assert!(
            data.to_text()
                .contains("date = \"2026-11-22\"\nrevision = 19\nmissed = 0\n")
        );
        let fly = data.section("fly").expect("a section");
        assert!(
            fly.number("kalman + sigma")
                .is_err_and(|e| e.contains("0.38/0.44"))
        );
        assert!(fly.text("other").is_err_and(|e| e.contains("other")));
    }

    #[test]
    fn a_new_section_takes_the_place_of_the_old_one() {
        let mut data = Data::parse("[a]\nx = 1\n[b]\ny = 2\n").expect("a file");
        let mut section = Section::new("a", "2026-11-23");
        section.put("x", 3);
        data.replace(section);
        let keys = data.to_text();
        assert!(keys.find("[a]") < keys.find("[b]"));
        assert_eq!(data.section("a").and_then(|a| a.number("x")), Ok(3.0));
    }

    #[test]
    fn a_wrong_line_is_named() {
        for wrong in ["x = 1", "[a", "[a]\nx", "[a]\nx = y", "[a]\nx = \"y"] {
            let error = Data::parse(wrong).expect_err("this is wrong");
            assert!(error.starts_with("line "), "{error}");
        }
    }
}
