//! The rules of readability and layout that a machine can check. They cover lengths of lines,
//! functions and files, imports, dependencies, words, and openings of doc comments.
//!
//! Each rule is a function over text. Its test first shows that the rule finds a fault in a sample.

#[path = "layout/imports.rs"]
mod imports;
#[path = "layout/source.rs"]
mod source;
#[path = "layout/tree.rs"]
mod tree;

use std::collections::{BTreeMap, BTreeSet};

use imports::Crate;
use tree::{files_below, read, root};

const MOST_COLUMNS: usize = 100;
const MOST_LINES_OF_A_FILE: usize = 600;
const MOST_LINES_OF_A_FUNCTION: usize = 80;

/// Home-made terms, as the words of an identifier. The field has a standard term for each.
const BANNED: [&[&str]; 12] = [
    &["everyday"],
    &["stocktaking"],
    &["take", "stock"],
    &["aftermath"],
    &["remark"],
    &["remarks"],
    &["doubt"],
    &["desk"],
    &["hands"],
    &["upkeep"],
    &["spoils"],
    &["unsurprising"],
];

/// A doc comment says its subject first.
const BANNED_OPENINGS: [&str; 27] = [
    "What",
    "Whether",
    "That",
    "The same",
    "Which",
    "How",
    "Where",
    "When",
    "Why",
    "Who",
    "It",
    "Its",
    "This",
    "These",
    "They",
    "Their",
    "There",
    "So",
    "And",
    "By how",
    "By what",
    "For how",
    "From when",
    "In which",
    "Since when",
    "To what",
    "Until when",
];

/// Each package's folder with the folders of the workspace's packages that it may depend on.
const MAY_DEPEND: [(&str, &[&str]); 10] = [
    (".", &[]),
    ("c", &["."]),
    ("models", &[]),
    ("plot", &[]),
    ("recordings", &[".", "models"]),
    ("rigs", &["."]),
    ("virtual-board", &[".", "models", "plot", "recordings"]),
    ("cli", &[".", "models", "plot", "recordings"]),
    ("bench", &[".", "models", "plot", "recordings"]),
    ("xtask", &[]),
];

/// The file that the pages name and `build.rs` writes.
const WRITTEN_BY_BUILD: &str = "board.x";

/// Dependencies of tests alone.
const TESTS_MAY_DEPEND: [(&str, &str); 3] = [("models", "."), ("c", "models"), ("c", "recordings")];

#[test]
fn lines_have_at_most_100_columns() {
    let wide = [
        "é".repeat(50),
        "é".repeat(51),
        "─".repeat(33),
        "─".repeat(34),
    ]
    .join("\n");
    let finding = |line, columns: usize| (line, format!("{columns} columns"));
    assert_eq!(long_lines(&wide), [finding(2, 102), finding(4, 102)]);
    let link = format!("// <https://x.org/{}>", "x".repeat(101));
    assert_eq!(long_lines(&link), []);
    check(&["rs", "py"], |_, source| long_lines(source));
    let page = format!("| {} |\n{}\n", "x".repeat(101), "x".repeat(101));
    assert_eq!(long_lines_of_page(&page), [finding(2, 101)]);
    let pages = files_below("", &["md"]);
    assert!(pages.len() > 10, "the search finds pages at all");
    let of_page = |(path, text): (&String, &String)| {
        let place = |(number, finding)| format!("{path}:{number}: {finding}");
        long_lines_of_page(text)
            .into_iter()
            .map(place)
            .collect::<Vec<String>>()
    };
    report(&pages.iter().flat_map(of_page).collect::<Vec<String>>());
}

#[test]
fn functions_have_at_most_80_lines() {
    let function = |lines: usize| format!("fn f() {{\n{}}}\n", "x();\n".repeat(lines - 2));
    assert_eq!(long_functions(&function(80)), []);
    let finding = (1, "`f` has 81 lines".to_owned());
    assert_eq!(long_functions(&function(81)), [finding]);
    let of_tests = format!("#[cfg(test)]\nmod tests {{\n{}}}\n", function(81));
    assert_eq!(long_functions(&of_tests), []);
    check(&["rs"], |path, source| {
        let rule = if is_test(path) {
            |_: &str| Vec::new()
        } else {
            long_functions
        };
        rule(source)
    });
}

#[test]
fn files_have_at_most_600_lines_without_their_tests() {
    let tests = "#[cfg(test)]\nmod tests {\n}\n";
    assert_eq!(long_file(&format!("{}{tests}", "//\n".repeat(600))), []);
    let finding = (1, "601 lines without its tests".to_owned());
    assert_eq!(
        long_file(&format!("{}{tests}", "//\n".repeat(601))),
        [finding]
    );
    check(&["rs"], |path, source| {
        let rule = if is_test(path) {
            |_: &str| Vec::new()
        } else {
            long_file
        };
        rule(source)
    });
}

#[test]
fn names_and_sentences_use_the_terms_of_the_field() {
    let banned = [
        "an everyday word",
        "Remark:",
        "has_remarks",
        "TakeStock",
        "take_stock()",
        "SPOILS",
        "self.desk2",
        "IDesk",
    ];
    for text in banned {
        assert_eq!(banned_words(text).len(), 1, "{text}");
    }
    for text in [
        "remarkable",
        "handshake",
        "every day",
        "undoubted",
        "take\nstock",
        "Desktop",
    ] {
        assert_eq!(banned_words(text), [], "{text}");
    }
    let text_files = ["rs", "md", "toml", "yml", "x", "py", "txt", "dict"];
    check(&text_files, |path, source| {
        // The list itself.
        if path == "tests/layout.rs" {
            return Vec::new();
        }
        banned_words(source)
    });
}

#[test]
fn doc_comments_open_with_a_verb_or_a_noun() {
    let sample = [
        "/// What it is.\nfn f();\n    //! That too.\n/// Good.\n/// The same, later.",
        "// What\n/// The same\n/// Thatch.\n//\n/// Its end.\n//\n/// Items.",
        "//\n/// This one.\n//\n/// By how much.\n//\n/// By halves.\n",
    ]
    .join("\n");
    let lines: Vec<usize> = doc_openings(&sample)
        .into_iter()
        .map(|(line, _)| line)
        .collect();
    assert_eq!(lines, [1, 3, 7, 10, 14, 16]);
    check(&["rs"], |_, source| doc_openings(source));
}

#[test]
fn no_two_files_import_each_other() {
    let mut crates: BTreeMap<String, Vec<(String, String)>> = BTreeMap::new();
    let files = files_below("", &["rs"]);
    let roots: BTreeSet<&str> = files
        .keys()
        .filter_map(|path| {
            path.strip_suffix("/lib.rs")
                .or(path.strip_suffix("/main.rs"))
        })
        .collect();
    for (path, source) in &files {
        let root = roots
            .iter()
            .filter(|root| is_below(path, root))
            .max_by_key(|root| root.len());
        // Programs in one file are crates of their own.
        let Some(root) = root.filter(|root| !is_below(path, &format!("{root}/bin"))) else {
            continue;
        };
        let file = path[root.len() + 1..].to_owned();
        let files = crates.entry((*root).to_owned()).or_default();
        files.push((file, source.clone()));
    }
    let mut imports_seen = 0;
    let mut found = Vec::new();
    for (root, files) in &crates {
        let package = Crate::new(files);
        imports_seen += package.imports_seen();
        for (a, b) in package.cycles() {
            found.push(format!("{root}/{a}: imports {root}/{b}, which imports it"));
        }
    }
    assert!(
        imports_seen > 200,
        "the search finds imports at all: {imports_seen}"
    );
    assert!(
        crates.len() > 6,
        "the search finds crates at all: {}",
        crates.len()
    );
    report(&found);
}

#[test]
fn packages_depend_only_on_those_below_them() {
    let manifest = "[dependencies]\naplomb = { path = \"..\" }\n\
                    [target.'cfg(unix)'.dependencies]\na = { path = \"../plot\" }\nb = \"1\"\n\
                    [build-dependencies.c]\npath = \"../cli\"\n\
                    [dev-dependencies]\nd = { path = \"../models\" }\n[[bin]]\npath = \"x.rs\"\n";
    let expected = [
        (".", false),
        ("plot", false),
        ("cli", false),
        ("models", true),
    ];
    let expected = expected.map(|(folder, tests)| (folder.to_owned(), tests));
    assert_eq!(path_dependencies("xtask", manifest), expected);

    let workspace = read("Cargo.toml");
    let members = workspace
        .lines()
        .find_map(|line| line.strip_prefix("members = ["))
        .expect("the members stand in one line");
    let members: Vec<&str> = members.split('"').skip(1).step_by(2).chain(["."]).collect();
    assert!(
        members.len() > 6,
        "the search finds members at all: {members:?}"
    );
    let allowed: BTreeMap<&str, &[&str]> = MAY_DEPEND.into_iter().collect();
    let mut found = Vec::new();
    for member in members {
        let may = allowed
            .get(member)
            .unwrap_or_else(|| panic!("add `{member}` to the table `MAY_DEPEND`"));
        let file = format!("{member}/Cargo.toml");
        for (dependency, in_tests) in path_dependencies(member, &read(&file)) {
            let is_allowed = may.contains(&dependency.as_str())
                || (in_tests && TESTS_MAY_DEPEND.contains(&(member, &dependency)));
            if !is_allowed {
                found.push(format!("{file}: may not depend on `{dependency}`"));
            }
        }
    }
    report(&found);
}

#[test]
fn the_models_know_nothing_of_what_they_judge() {
    let manifest = read("models/Cargo.toml");
    let (dependencies, _) = manifest
        .split_once("[dev-dependencies]")
        .expect("tests compare the models with the library");
    assert!(
        !dependencies.contains("path = "),
        "a model that shares code with what it judges cannot disagree with it"
    );
}

#[test]
fn files_and_items_that_the_root_pages_name_exist() {
    let sample = "`src/lib.rs`, `a b/c`, `a::b`, `docs/`, `<a>/b.rs`, `Cargo.toml` and `Estimator`";
    assert_eq!(
        paths_in_backticks(sample),
        ["src/lib.rs", "docs/", "Cargo.toml"]
    );
    let files = files_below("", &["rs"]);
    let page = "In `src/estimator/kalman/`: `slice` in `slices.rs`, `none` in\n`slices.rs`,\n\
                `tests/no.rs`, `slice` in `mod.rs`, `Kalman::restart` in `mod.rs`.\n";
    assert_eq!(
        wrong_names(page, &files),
        [
            "`slices.rs` has no `none`",
            "`tests/no.rs` is missing",
            "`mod.rs` has no `slice`"
        ]
    );
    for page in ["CONTRIBUTING.md", "ARCHITECTURE.md"] {
        let text = read(page);
        let paths = paths_in_backticks(&text);
        assert!(paths.len() > 20, "the search finds paths at all: {paths:?}");
        let wrong = wrong_names(&text, &files);
        report(
            &wrong
                .iter()
                .map(|wrong| format!("{page}: {wrong}"))
                .collect::<Vec<String>>(),
        );
    }
}

/// Files that do not exist, and items that are not in the file that the page names after them.
///
/// A file's name without its folder belongs to the section's last folder that has such a file, or
/// else to any folder.
fn wrong_names(page: &str, files: &BTreeMap<String, String>) -> Vec<String> {
    let mut found = Vec::new();
    let mut folder = "";
    let parts: Vec<&str> = page.split('`').collect();
    // Odd parts are in backticks, and the text before each decides what it is.
    for at in (1..parts.len()).step_by(2) {
        let (before, name) = (parts[at - 1], parts[at]);
        if before.contains("\n#") {
            folder = "";
        }
        if paths_in_backticks(&format!("`{name}`")).is_empty() {
            continue;
        }
        if name.ends_with('/') {
            folder = name;
        }
        let in_folder = format!("{folder}{name}");
        let candidates: Vec<&str> = if let Some(text) = files.get(name) {
            vec![text]
        } else if let Some(text) = files.get(&in_folder) {
            vec![text]
        } else {
            let part = format!("/{name}");
            let is_named =
                |path: &str| path.ends_with(&part) || name.ends_with('/') && path.contains(&part);
            let named = files.iter().filter(|(path, _)| is_named(path));
            named.map(|(_, text)| text.as_str()).collect()
        };
        if candidates.is_empty() && name != WRITTEN_BY_BUILD && !root().join(name).exists() {
            found.push(format!("`{name}` is missing"));
        } else if before.split_whitespace().eq(["in"]) && name.ends_with(".rs") {
            let item = parts[at - 2].rsplit("::").next().unwrap_or_default();
            let declared = [
                "fn ITEM(",
                "fn ITEM<",
                "const ITEM:",
                "enum ITEM ",
                "trait ITEM ",
            ];
            let declared = declared.map(|text| text.replace("ITEM", item));
            let has = |text: &&str| declared.iter().any(|declared| text.contains(declared));
            if !candidates.iter().any(has) {
                found.push(format!("`{name}` has no `{item}`"));
            }
        }
    }
    found
}

/// A line's number and what is wrong with it.
type Finding = (usize, String);

/// The lines of a page that are too long, but for the rows of tables, which cannot be broken.
fn long_lines_of_page(page: &str) -> Vec<Finding> {
    let lines: Vec<&str> = page.lines().collect();
    let mut found = long_lines(page);
    found.retain(|(number, _)| !lines[number - 1].starts_with('|'));
    found
}

/// Counts bytes, as some tools do.
fn long_lines(source: &str) -> Vec<Finding> {
    numbered(source)
        .filter(|(_, line)| !line.contains("https://"))
        .map(|(number, line)| (number, line.len()))
        .filter(|(_, columns)| *columns > MOST_COLUMNS)
        .map(|(number, columns)| (number, format!("{columns} columns")))
        .collect()
}

fn long_functions(source: &str) -> Vec<Finding> {
    let tokens = source::without_tests(&source::tokens(source));
    source::functions(&tokens)
        .iter()
        .filter(|function| function.length() > MOST_LINES_OF_A_FUNCTION)
        .map(|function| {
            let finding = format!("`{}` has {} lines", function.name, function.length());
            (*function.lines.start(), finding)
        })
        .collect()
}

fn long_file(source: &str) -> Vec<Finding> {
    let lines = source::lines_without_tests(source);
    if lines <= MOST_LINES_OF_A_FILE {
        return Vec::new();
    }
    vec![(1, format!("{lines} lines without its tests"))]
}

fn banned_words(text: &str) -> Vec<Finding> {
    let mut found = Vec::new();
    for (number, line) in numbered(text) {
        let words = words(line);
        for banned in BANNED {
            if words.windows(banned.len()).any(|window| window == banned) {
                found.push((
                    number,
                    format!("`{}`: use the field's term", banned.join("_")),
                ));
            }
        }
    }
    found
}

/// The words of a line in small letters, those of which its identifiers consist apart.
fn words(line: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let characters: Vec<char> = line.chars().collect();
    for (at, &character) in characters.iter().enumerate() {
        let before = at.checked_sub(1).map(|before| characters[before]);
        let begins_word = character.is_uppercase()
            && (before.is_some_and(char::is_lowercase)
                || characters
                    .get(at + 1)
                    .is_some_and(|next| next.is_lowercase()));
        if !character.is_alphabetic() || begins_word {
            words.push(String::new());
        }
        if let (true, Some(word)) = (character.is_alphabetic(), words.last_mut()) {
            word.extend(character.to_lowercase());
        }
    }
    words.retain(|word| !word.is_empty());
    words
}

fn doc_openings(source: &str) -> Vec<Finding> {
    let mut found = Vec::new();
    let mut before = None;
    for (number, line) in numbered(source) {
        let line = line.trim_start();
        let kind = ["///", "//!"]
            .into_iter()
            .find(|kind| line.starts_with(kind));
        if let Some(kind) = kind
            && before != Some(kind)
        {
            let text = line[kind.len()..].trim_start();
            let opens = |words: &&str| {
                let rest = text.strip_prefix(words);
                rest.is_some_and(|rest| !rest.starts_with(char::is_alphanumeric))
            };
            if let Some(words) = BANNED_OPENINGS.iter().find(|words| opens(words)) {
                found.push((
                    number,
                    format!("opens with `{words}`: name the subject first"),
                ));
            }
        }
        before = kind;
    }
    found
}

/// The folders of the workspace that a manifest names as dependencies, and if only tests use them.
fn path_dependencies(member: &str, manifest: &str) -> Vec<(String, bool)> {
    let mut found = Vec::new();
    let mut section = "";
    for line in manifest.lines() {
        if line.starts_with('[') {
            section = line;
        }
        let path = line
            .split_once("path = \"")
            .and_then(|(_, rest)| rest.split_once('"'));
        let (true, Some((path, _))) = (section.contains("dependencies"), path) else {
            continue;
        };
        let folder = match path {
            ".." if member != "." => ".",
            _ => path.trim_start_matches("../"),
        };
        found.push((folder.to_owned(), section.contains("dev-dependencies")));
    }
    found
}

/// The text in backticks that has the form of a path in the repository.
fn paths_in_backticks(page: &str) -> Vec<&str> {
    let is_path = |text: &&str| {
        let endings = [".md", ".toml", ".rs", ".x", ".txt", "/"];
        let is_word = |c: char| c.is_ascii_alphanumeric() || "._-/".contains(c);
        text.chars().all(is_word)
            && (text.contains('/') || endings.iter().any(|ending| text.ends_with(ending)))
    };
    page.split('`').skip(1).step_by(2).filter(is_path).collect()
}

/// Applies a rule to all files with one of these endings, and fails with the list of findings.
fn check(endings: &[&str], rule: impl Fn(&str, &str) -> Vec<Finding>) {
    let files = files_below("", endings);
    assert!(
        files.len() > 200,
        "the search finds files at all: {}",
        files.len()
    );
    let mut found = Vec::new();
    for (path, source) in &files {
        for (number, finding) in rule(path, source) {
            found.push(format!("{path}:{number}: {finding}"));
        }
    }
    report(&found);
}

fn report(found: &[String]) {
    assert!(
        found.is_empty(),
        "{} findings\n{}",
        found.len(),
        found.join("\n")
    );
}

fn numbered(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(index, line)| (index + 1, line))
}

/// True for files that hold nothing but tests.
fn is_test(path: &str) -> bool {
    let file = path.rsplit('/').next().unwrap_or(path);
    path.split('/').any(|folder| folder == "tests")
        || file == "tests.rs"
        || file.ends_with("_tests.rs")
}

fn is_below(path: &str, folder: &str) -> bool {
    path.strip_prefix(folder)
        .is_some_and(|rest| rest.starts_with('/'))
}
