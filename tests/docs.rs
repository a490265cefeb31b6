//! The pages for people: their length, their links, their commands and their figures.
//!
//! `cargo xtask results --check` compares the generated tables with `docs/results.toml`.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use aplomb::compass::{Choice, LONGEST_READ, Outcome, PartId, Session};
use aplomb::console::command::Command;
use aplomb::estimator::REVISION;
use aplomb::health::Flags;
use aplomb::mpu6050::PARTS;
use aplomb::settings::OutputFormat;
use aplomb::telemetry::{frame_length, largest_rate_hz};

/// Pages in the root folder. Those in `docs/` follow.
const ROOT_PAGES: [&str; 4] = [
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
];
/// Generated pages.
const GENERATED: [&str; 2] = ["docs/results.md", "docs/unsafe.md"];

const README_LINES: usize = 150;
const PAGE_LINES: usize = 199;
const SENTENCE_WORDS: usize = 25;

/// Largest number of functions and of files on the path of one sample.
const PATH_FUNCTIONS: usize = 20;
const PATH_FILES: usize = 10;

#[test]
fn pages_are_short() {
    for (name, text) in pages() {
        let lines = text.lines().count();
        let limit = match name.as_str() {
            "README.md" => README_LINES,
            name if name.starts_with("docs/") => PAGE_LINES,
            _ => continue,
        };
        assert!(lines <= limit, "{name} has {lines} lines of {limit}");
    }
}

#[test]
fn sentences_are_short() {
    for (name, text) in pages() {
        if GENERATED.contains(&name.as_str()) {
            continue;
        }
        for sentence in sentences(&text) {
            let words = sentence.split_whitespace().count();
            assert!(words <= SENTENCE_WORDS, "{name}: {words} words: {sentence}");
        }
    }
    let long = "one ".repeat(SENTENCE_WORDS + 1);
    assert_eq!(
        sentences(&long)[0].split_whitespace().count(),
        SENTENCE_WORDS + 1
    );
    assert_eq!(
        sentences("One two.\nThree: four\n\n- five `a b c` [six](x y)").len(),
        4
    );
}

#[test]
fn every_link_leads_somewhere() {
    let mut seen = 0;
    for (name, text) in pages() {
        for target in links(&text) {
            seen += 1;
            if let Err(error) = follow(&name, &target) {
                panic!("{name}: {error}");
            }
        }
    }
    assert!(seen > 40, "the search finds links at all: {seen}");
    assert!(follow("README.md", "docs/none.md").is_err());
    assert!(follow("README.md", "docs/faults.md#none").is_err());
    assert_eq!(follow("docs/faults.md", "../README.md#wire-it"), Ok(()));
}

#[test]
fn the_readme_leads_to_every_page() {
    let readme = read("README.md");
    let linked: BTreeSet<String> = links(&readme).into_iter().collect();
    for (name, _) in pages() {
        assert!(
            name == "README.md" || linked.contains(&name),
            "link {name} in README.md"
        );
    }
}

#[test]
fn commands_of_the_workspace_exist() {
    let sources = [read("xtask/src/main.rs"), read("virtual-board/src/main.rs")].concat();
    let bench = sources_below("bench/src");
    let mut seen = 0;
    for (name, text) in pages() {
        for command in commands(&text, "cargo xtask ") {
            let mut words = command.split_whitespace();
            let Some(verb) = words.next() else { continue };
            seen += 1;
            assert!(
                has_verb(&sources, verb),
                "{name}: there is no `cargo xtask {verb}`"
            );
            for option in words.filter(|word| word.starts_with("--")) {
                let is_known = has_option(&sources, option) || has_option(&bench, option);
                // The comparison of filters is a package that may be absent.
                let is_open = verb == "bench" && bench.is_empty();
                assert!(
                    is_known || is_open,
                    "{name}: `cargo xtask {verb}` has no {option}"
                );
            }
        }
    }
    assert!(seen > 30, "the search finds commands at all: {seen}");
    assert!(!has_verb(&sources, "flies") && !has_option(&sources, "--secons"));
}

#[test]
fn commands_of_the_program_exist() {
    let main = read("cli/src/main.rs");
    let sources = sources_below("cli/src");
    let mut seen = 0;
    for (name, text) in pages() {
        if name == "CHANGELOG.md" {
            continue;
        }
        for command in commands(&text, "aplomb ") {
            let mut words = command.split_whitespace();
            let Some(verb) = words.next() else { continue };
            if !verb.starts_with(|c: char| c.is_ascii_lowercase()) {
                continue;
            }
            seen += 1;
            let words_of_verb = verb.split('-').filter(|word| !word.is_empty());
            let names = words_of_verb.map(|word| word[..1].to_uppercase() + &word[1..]);
            let variant = format!("    {}(", names.collect::<String>());
            assert!(
                main.contains(&variant),
                "{name}: there is no `aplomb {verb}`"
            );
            for option in words.filter(|word| word.starts_with("--")) {
                assert!(
                    has_option(&sources, option),
                    "{name}: `aplomb {verb}` has no {option}"
                );
            }
        }
    }
    assert!(seen > 15, "the search finds commands at all: {seen}");
}

#[test]
fn commands_at_the_uart_parse() {
    let mut seen = 0;
    for row in rows(
        "docs/commands.md",
        "| command | effect | needs `save` | while armed |",
    ) {
        let forms: Vec<String> = marked(&row[0]).collect();
        let first = forms[0].split(' ').next().unwrap_or_default().to_owned();
        for form in &forms {
            let is_whole = form.parse::<Command>().is_ok();
            let follows = format!("{first} {form}").parse::<Command>().is_ok();
            assert!(is_whole || follows, "`{form}` is no command");
            seen += 1;
        }
    }
    let page = read("docs/calibration.md");
    let typed = fences(&page, "text")
        .into_iter()
        .filter(|line| !line.starts_with(['#', '…']));
    for line in typed {
        assert!(line.parse::<Command>().is_ok(), "`{line}` is no command");
        seen += 1;
    }
    assert!(seen > 25, "the search finds commands at all: {seen}");
}

#[test]
fn the_formats_have_these_lengths_and_rates() {
    let table = "| format | for | bytes | largest rate at 115,200 baud | at 921,600 |";
    let rows = rows("docs/telemetry.md", table);
    assert_eq!(rows.len(), OutputFormat::ALL.len());
    for (row, format) in rows.iter().zip(OutputFormat::ALL) {
        let rate = |baud| match largest_rate_hz(format, baud).min(1000) {
            0 => "–".to_owned(),
            rate => rate.to_string(),
        };
        let expected = [
            frame_length(format).to_string(),
            rate(115_200),
            rate(921_600),
        ];
        assert_eq!(marked(&row[0]).next().as_deref(), Some(format.name()));
        assert_eq!(row[2..], expected, "{format}");
    }
}

#[test]
fn flags_and_chips_are_all_explained() {
    let rows_of_flags = rows("docs/faults.md", "| flag | meaning |");
    let explained: BTreeSet<String> = rows_of_flags
        .iter()
        .flat_map(|row| marked(&row[0]))
        .collect();
    for (name, _) in Flags::all().iter_names() {
        assert!(explained.contains(name), "explain {name} in docs/faults.md");
    }
    let chips = rows("docs/first-board.md", "| WHO_AM_I | chip |");
    let identities: Vec<String> = chips.iter().map(|row| row[0].clone()).collect();
    let expected = PARTS.iter().map(|part| format!("0x{:02x}", part.who_am_i));
    assert_eq!(identities, expected.collect::<Vec<String>>());
}

#[test]
fn the_page_on_headings_has_the_ages_of_readings() {
    let identities: [(PartId, &[u8], &str); 4] = [
        (PartId::Ak8963, &[0x48], "AK8963"),
        (PartId::Qmc5883l, &[0x01, 0xFF], "QMC5883"),
        (PartId::Qmc5883p, &[0x80], "QMC5883"),
        (PartId::Hmc5883l, b"H43", "HMC5883L"),
    ];
    let page = read("docs/heading.md");
    for (part, identity, name) in identities {
        let mut session = Session::new(Choice::Named(part));
        let mut bytes = [0; LONGEST_READ];
        bytes[..identity.len()].copy_from_slice(identity);
        for _ in 0..20 {
            if session.part().is_none() && session.next_transfer().is_some() {
                session.finish(&Outcome::Read(&bytes));
            }
        }
        assert_eq!(session.part(), Some(part));
        let text = format!("{} ms ({name})", f64::from(session.mean_age_us()) / 1e3);
        assert!(
            page.contains(&text),
            "docs/heading.md: the mean age is {text}"
        );
    }
}

#[test]
fn the_revision_of_the_filter_is_named() {
    let page = read("docs/flight-log.md");
    assert!(
        page.contains(&format!("it is {REVISION} now")),
        "docs/flight-log.md: {REVISION}"
    );
    assert!(read("CHANGELOG.md").contains(&format!("`estimator::REVISION` is {REVISION}")));
}

#[test]
fn the_path_of_a_sample_is_that_of_the_code() {
    let page = read("ARCHITECTURE.md");
    let steps = path_of_a_sample(&page);
    for (function, file) in &steps {
        let declared = [format!("fn {function}("), format!("fn {function}<")];
        let code = read(file);
        let is_there = declared.iter().any(|text| code.contains(text));
        assert!(is_there, "{file} has no function `{function}`");
    }
    let functions: BTreeSet<_> = steps.iter().collect();
    let files: BTreeSet<_> = steps.iter().map(|(_, file)| file).collect();
    assert_eq!(functions.len(), steps.len(), "a function occurs twice");
    assert!(
        (10..=PATH_FUNCTIONS).contains(&steps.len()),
        "{} functions",
        steps.len()
    );
    assert!(files.len() <= PATH_FILES, "{} files", files.len());
}

/// Figures that are longer than three digits stand in generated text alone.
#[test]
fn figures_come_from_the_data_file() {
    let figures = measured_figures(&read("docs/results.toml"));
    assert!(
        figures.len() > 10,
        "the search finds figures at all: {figures:?}"
    );
    for (name, text) in pages() {
        if GENERATED.contains(&name.as_str()) || name == "CHANGELOG.md" {
            continue;
        }
        if let Some((figure, line)) = copied_figure(&without_table(&text), &figures) {
            panic!("{name}: {figure} belongs to docs/results.md: {line}");
        }
    }
    let copied = copied_figure("It takes 106,208 bytes.", &["106,208".to_owned()]);
    assert!(copied.is_some());
    let other = copied_figure("It takes 1106,2081 bytes.", &["106,208".to_owned()]);
    assert_eq!(other, None);
}

/// The steps of the numbered list below the heading: function and file.
fn path_of_a_sample(page: &str) -> Vec<(String, String)> {
    let (_, rest) = page
        .split_once("## One sample, from EXTI1 to the snapshot")
        .expect("ARCHITECTURE.md has that heading");
    let (section, _) = rest.split_once("\n## ").unwrap_or((rest, ""));
    let mut steps = Vec::new();
    for line in section.lines() {
        let Some((number, step)) = line.split_once(". ") else {
            continue;
        };
        if number.parse() != Ok(steps.len() + 1) {
            continue;
        }
        let names: Vec<String> = marked(step).take(2).collect();
        let [function, file] = names.try_into().expect("a function and a file");
        steps.push((function, file));
    }
    steps
}

/// Numbers of four digits and more in the data file, as text has them.
fn measured_figures(data: &str) -> Vec<String> {
    let values = data.lines().filter_map(|line| line.split_once(" = "));
    let values = values.filter(|(key, _)| *key != "date" && *key != "runs");
    let numbers = values.filter_map(|(_, value)| value.parse::<f64>().ok().map(|_| value));
    let long = |value: &&str| value.chars().filter(char::is_ascii_digit).count() >= 4;
    let mut figures: BTreeSet<String> = BTreeSet::new();
    for value in numbers
        .filter(long)
        .filter_map(|value| value.parse::<f64>().ok())
    {
        let (whole, tenths) = (format!("{value:.0}"), format!("{value:.1}"));
        figures.insert(with_commas(&whole));
        if let Some((whole, tenth)) = tenths.split_once('.') {
            figures.insert(format!("{}.{tenth}", with_commas(whole)));
        }
    }
    // Rounding may have left fewer digits.
    let is_long = |text: &String| text.chars().filter(char::is_ascii_digit).count() >= 4;
    figures.into_iter().filter(is_long).collect()
}

/// Digits in groups of three.
fn with_commas(digits: &str) -> String {
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A figure that occurs in the text as a whole number, and its line.
fn copied_figure<'a>(text: &'a str, figures: &[String]) -> Option<(String, &'a str)> {
    let is_digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
    for line in text.lines() {
        for figure in figures {
            for (at, _) in line.match_indices(figure.as_str()) {
                let before = line[..at].chars().next_back();
                let after = line[at + figure.len()..].chars().next();
                if !is_digit(before) && !is_digit(after) {
                    return Some((figure.clone(), line));
                }
            }
        }
    }
    None
}

/// The text without the part that `cargo xtask results` writes.
fn without_table(text: &str) -> String {
    match (
        text.split_once("<!-- results:"),
        text.split_once("<!-- end of results -->"),
    ) {
        (Some((head, _)), Some((_, tail))) => format!("{head}{tail}"),
        _ => text.to_owned(),
    }
}

/// Every page with its path from the root.
fn pages() -> Vec<(String, String)> {
    let mut names: Vec<String> = ROOT_PAGES.map(str::to_owned).to_vec();
    for path in listed("docs") {
        let name = path
            .file_name()
            .expect("a file")
            .to_string_lossy()
            .into_owned();
        if name.ends_with(".md") {
            names.push(format!("docs/{name}"));
        }
    }
    let read = |name: String| {
        let text = read(&name);
        (name, text)
    };
    names.into_iter().map(read).collect()
}

/// Sentences of the prose: no code, tables, headings or pictures. Code in a line is one word.
fn sentences(text: &str) -> Vec<String> {
    let mut paragraphs = vec![String::new()];
    let mut is_code = false;
    for line in text.lines() {
        let start = line.trim_start();
        is_code ^= start.starts_with("```");
        let is_item = start.starts_with("- ") || start.starts_with(|c: char| c.is_ascii_digit());
        if start.is_empty() || is_item {
            paragraphs.push(String::new());
        }
        if is_code || start.starts_with("```") {
            continue;
        }
        if start.starts_with(['|', '#', '!', '<']) {
            paragraphs.push(String::new());
            continue;
        }
        if let Some(paragraph) = paragraphs.last_mut() {
            paragraph.push(' ');
            paragraph.push_str(start);
        }
    }
    let mut found = Vec::new();
    for paragraph in paragraphs {
        let mut sentence = String::new();
        for word in plain(&paragraph).split_whitespace() {
            sentence.push_str(word);
            sentence.push(' ');
            if word.ends_with(['.', '?', '!', ':', ';']) {
                found.push(std::mem::take(&mut sentence));
            }
        }
        found.push(sentence);
    }
    found.retain(|sentence| !sentence.trim().is_empty());
    found
}

/// A paragraph with each piece of code as one word, and links as their text.
fn plain(paragraph: &str) -> String {
    let pieces = paragraph.split('`').enumerate();
    let text: String = pieces
        .map(|(index, piece)| if index % 2 == 1 { "code" } else { piece })
        .collect();
    let mut plain = String::new();
    let mut rest = text.as_str();
    while let Some((before, after)) = rest.split_once("](") {
        plain.push_str(before);
        rest = after.split_once(')').map_or("", |(_, rest)| rest);
    }
    plain + rest
}

/// Targets of the relative links and pictures.
fn links(text: &str) -> Vec<String> {
    let targets = text.split("](").skip(1);
    let targets = targets.filter_map(|rest| rest.split_once(')').map(|(target, _)| target));
    targets
        .filter(|target| !target.contains("://"))
        .map(str::to_owned)
        .collect()
}

/// Finds the file of a link, and the heading if it names one.
fn follow(page: &str, target: &str) -> Result<(), String> {
    let (file, heading) = target.split_once('#').unwrap_or((target, ""));
    let folder = root()
        .join(page)
        .parent()
        .map(Path::to_owned)
        .unwrap_or_default();
    let path = if file.is_empty() {
        root().join(page)
    } else {
        folder.join(file)
    };
    if !path.exists() {
        return Err(format!("there is no {target}"));
    }
    if heading.is_empty() {
        return Ok(());
    }
    let text = fs::read_to_string(&path).map_err(|error| format!("{target}: {error}"))?;
    let headings = text.lines().filter(|line| line.starts_with('#'));
    let anchors = headings.map(|line| {
        let title = line.trim_start_matches('#').trim().to_lowercase();
        let kept = title
            .chars()
            .filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        kept.collect::<String>().replace(' ', "-")
    });
    let mut anchors = anchors;
    if anchors.any(|anchor| anchor == heading) {
        Ok(())
    } else {
        Err(format!("{target} names no heading"))
    }
}

/// Commands that begin so, in fenced blocks and in pieces of code, without comments.
fn commands(text: &str, start: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut is_code = false;
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
            continue;
        }
        let pieces = if is_code {
            vec![line.to_owned()]
        } else {
            marked(line).collect()
        };
        for piece in pieces {
            let piece = piece.split(" #").next().unwrap_or_default().trim();
            let piece = piece.strip_prefix("target/release/").unwrap_or(piece);
            found.extend(piece.strip_prefix(start).map(str::to_owned));
        }
    }
    found
}

/// Searches the source for a command of this name.
fn has_verb(sources: &str, verb: &str) -> bool {
    sources.contains(&format!("        \"{verb}\" =>"))
}

/// Searches the source for an option of this name: in a usage, an attribute, or as a field.
fn has_option(sources: &str, option: &str) -> bool {
    let name = option.trim_start_matches('-');
    let name = name.split(['=', ',', ']', '[']).next().unwrap_or_default();
    let field = format!("    {}: ", name.replace('-', "_"));
    let is_quoted =
        sources.contains(&format!("\"--{name}\"")) || sources.contains(&format!("\"{name}\""));
    name == "help"
        || is_quoted
        || sources.contains(&field)
        || sources.contains(&format!("[--{name}"))
}

/// The lines of fenced blocks of this language.
fn fences(text: &str, language: &str) -> Vec<String> {
    let mut lines = Vec::new();
    let mut is_inside = false;
    for line in text.lines() {
        match line.strip_prefix("```") {
            Some(name) => is_inside = name == language,
            None if is_inside => lines.push(line.to_owned()),
            None => {}
        }
    }
    lines
}

/// The cells of a table's rows, below this title.
fn rows(page: &str, title: &str) -> Vec<Vec<String>> {
    let text = read(page);
    let (_, rest) = text
        .split_once(title)
        .unwrap_or_else(|| panic!("{page} has no {title}"));
    let lines = rest
        .lines()
        .skip(2)
        .take_while(|line| line.starts_with('|'));
    let cells = |line: &str| {
        let cells = line.trim_matches('|').split('|');
        cells.map(|cell| cell.trim().to_owned()).collect()
    };
    lines.map(cells).collect()
}

/// Pieces of a text between back-ticks.
fn marked(text: &str) -> impl Iterator<Item = String> {
    text.split('`').skip(1).step_by(2).map(str::to_owned)
}

/// The sources below a folder, as one text; empty if there is no such folder.
fn sources_below(folder: &str) -> String {
    if !root().join(folder).is_dir() {
        return String::new();
    }
    let mut text = String::new();
    for path in listed(folder) {
        let name = path
            .strip_prefix(root())
            .unwrap_or(&path)
            .to_string_lossy()
            .into_owned();
        if path.is_dir() {
            text.push_str(&sources_below(&name));
        } else if name.ends_with(".rs") {
            text.push_str(&read(&name));
        }
    }
    text
}

fn listed(folder: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(root().join(folder)).expect("the folder is there");
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| entry.expect("the folder can be listed").path())
        .collect();
    paths.sort();
    paths
}

fn read(file: &str) -> String {
    fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"))
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}
