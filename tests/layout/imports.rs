//! Imports between the files of a crate: the paths in a file, resolved to the files of modules.

use std::collections::{BTreeMap, BTreeSet};

use crate::source::{Token, closing_brace, is, tokens, without_tests};

/// The names of a path, for example `["crate", "a", "b"]`.
type Names = Vec<String>;

/// One import or path in an expression.
#[derive(Debug)]
struct Import {
    path: Names,
    /// The name that other modules see, if the item is exported again.
    exported_as: Option<String>,
}

/// A file of a crate.
struct Module {
    file: String,
    imports: Vec<Import>,
}

/// The modules of one crate by their paths; the crate's root has the empty path.
pub struct Crate(BTreeMap<Names, Module>);

impl Crate {
    /// Reads a crate from its files: each path, relative to the folder of the crate's root, with
    /// its source.
    pub fn new(files: &[(String, String)]) -> Self {
        let modules = files.iter().map(|(file, source)| {
            let imports = imports(&without_tests(&tokens(source)), &module_path(file));
            let file = file.clone();
            (module_path(&file), Module { file, imports })
        });
        Self(modules.collect())
    }

    /// Pairs of files that import each other, parents and their children excepted.
    pub fn cycles(&self) -> Vec<(String, String)> {
        let pairs: BTreeSet<(&Names, &Names)> = self
            .0
            .iter()
            .flat_map(|(from, module)| {
                let to = module
                    .imports
                    .iter()
                    .filter_map(|import| self.target(&import.path, 0));
                to.map(move |to| (from, to))
            })
            .collect();
        pairs
            .iter()
            .filter(|(from, to)| from < to && pairs.contains(&(to, from)))
            .filter(|(from, to)| !is_parent(from, to) && !is_parent(to, from))
            .map(|(from, to)| (self.0[*from].file.clone(), self.0[*to].file.clone()))
            .collect()
    }

    /// The number of imports of the crate's own files.
    pub fn imports_seen(&self) -> usize {
        let imports = self.0.values().flat_map(|module| &module.imports);
        imports
            .filter(|import| self.target(&import.path, 0).is_some())
            .count()
    }

    /// The module that defines the item at an absolute path, through exports of other modules.
    fn target(&self, path: &[String], depth: usize) -> Option<&Names> {
        let (module_path, module) = (0..=path.len())
            .rev()
            .find_map(|length| self.0.get_key_value(&path[..length]))?;
        let exported = path.get(module_path.len()).and_then(|name| {
            let mut imports = module.imports.iter();
            imports.find(|import| import.exported_as.as_ref() == Some(name))
        });
        match exported {
            Some(import) if depth < 8 => self.target(&import.path, depth + 1),
            _ => Some(module_path),
        }
    }
}

/// The path of the module in a file, relative to the folder of the crate's root.
fn module_path(file: &str) -> Names {
    let mut path: Names = file
        .trim_end_matches(".rs")
        .split('/')
        .map(str::to_owned)
        .collect();
    let is_folder = path.last().is_some_and(|name| name == "mod");
    let is_root = path.len() == 1 && ["lib", "main"].contains(&path[0].as_str());
    if is_folder || is_root {
        path.pop();
    }
    path
}

fn is_parent(parent: &[String], child: &[String]) -> bool {
    child.split_last().is_some_and(|(_, rest)| rest == parent)
}

/// The imports of a file as absolute paths without `crate`.
fn imports(tokens: &[Token], module: &[String]) -> Vec<Import> {
    let children: Vec<&str> = (0..tokens.len())
        .filter(|&at| is(tokens, at, "mod") && is(tokens, at + 2, ";"))
        .map(|at| tokens[at + 1].text.as_str())
        .collect();
    // The inline modules around the token, with the index of their closing braces.
    let mut inline: Vec<(String, usize)> = Vec::new();
    let mut found = Vec::new();
    for (at, token) in tokens.iter().enumerate() {
        inline.retain(|(_, end)| at < *end);
        if token.text == "mod" && is(tokens, at + 2, "{") {
            let end = closing_brace(tokens, at + 2);
            inline.push((tokens[at + 1].text.clone(), end));
        }
        let is_use = at > 0 && is(tokens, at - 1, "use");
        let keyword = ["crate", "super", "self"].contains(&token.text.as_str());
        let goes_on = is(tokens, at + 1, ":") && is(tokens, at + 2, ":");
        let inside = at > 0 && (is(tokens, at - 1, ":") || is(tokens, at - 1, "$"));
        let child = goes_on && children.contains(&token.text.as_str());
        if inside || !(keyword && goes_on || child) {
            continue;
        }
        let is_public = is_use && at > 1 && (is(tokens, at - 2, "pub") || is(tokens, at - 2, ")"));
        let mut here = module.to_vec();
        here.extend(inline.iter().map(|(name, _)| name.clone()));
        for (path, name) in paths(tokens, at).0 {
            let path = absolute(&path, &here);
            let exported_as = is_public.then_some(name);
            found.push(Import { path, exported_as });
        }
    }
    found
}

/// Each path of the tree at `at` with the name that it gives; and the index behind the tree.
fn paths(tokens: &[Token], at: usize) -> (Vec<(Names, String)>, usize) {
    if is(tokens, at, "{") {
        let end = closing_brace(tokens, at);
        let mut found = Vec::new();
        let mut next = at + 1;
        while next < end {
            let (branches, behind) = paths(tokens, next);
            found.extend(branches);
            next = behind.max(next + 1);
            while next < end && !is(tokens, next - 1, ",") {
                next += 1;
            }
        }
        return (found, end + 1);
    }
    let Some(name) = tokens.get(at).map(|token| token.text.clone()) else {
        return (Vec::new(), at);
    };
    if is(tokens, at + 1, ":") && is(tokens, at + 2, ":") {
        let (branches, behind) = paths(tokens, at + 3);
        let branches = branches.into_iter().map(|(path, last)| {
            let last = if last == "self" { name.clone() } else { last };
            ([vec![name.clone()], path].concat(), last)
        });
        return (branches.collect(), behind);
    }
    if is(tokens, at + 1, "as") {
        let alias = tokens[at + 2].text.clone();
        return (vec![(vec![name], alias)], at + 3);
    }
    (vec![(vec![name.clone()], name)], at + 1)
}

/// Replaces `crate`, `super` and `self` at the start of a path in the module `here`.
fn absolute(path: &[String], here: &[String]) -> Names {
    let mut absolute = here.to_vec();
    let mut rest = path;
    while let Some((first, behind)) = rest.split_first() {
        match first.as_str() {
            "crate" => absolute.clear(),
            "super" => drop(absolute.pop()),
            "self" => {}
            _ => break,
        }
        rest = behind;
    }
    absolute.extend(rest.iter().filter(|name| *name != "self").cloned());
    absolute
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cycles(files: &[(&str, &str)]) -> Vec<(String, String)> {
        let owned = |(file, source): &(&str, &str)| ((*file).to_owned(), (*source).to_owned());
        Crate::new(&files.iter().map(owned).collect::<Vec<_>>()).cycles()
    }

    fn pair(a: &str, b: &str) -> Vec<(String, String)> {
        vec![(a.to_owned(), b.to_owned())]
    }

    #[test]
    fn two_files_that_import_each_other_are_found() {
        let a = ("a.rs", "use crate::{c::D, b::B};");
        assert_eq!(
            cycles(&[a, ("b.rs", "fn f() { crate::a::f() }")]),
            pair("a.rs", "b.rs")
        );
        assert_eq!(
            cycles(&[a, ("b.rs", "use super::a::{self};")]),
            pair("a.rs", "b.rs")
        );
        assert_eq!(
            cycles(&[a, ("b/mod.rs", "use crate::a;")]),
            pair("a.rs", "b/mod.rs")
        );
        assert_eq!(cycles(&[a, ("b.rs", "// use crate::a;\nuse x::a::Y;")]), []);
        assert_eq!(
            cycles(&[a, ("b.rs", "#[cfg(test)] mod tests { use crate::a::X; }")]),
            []
        );
    }

    #[test]
    fn imports_through_an_export_are_followed() {
        let root = (
            "lib.rs",
            "mod a; mod b; pub use a::A; pub(crate) use b::B as C;",
        );
        let a = ("a.rs", "use crate::C;");
        assert_eq!(
            cycles(&[root, a, ("b.rs", "use crate::A;")]),
            pair("a.rs", "b.rs")
        );
        assert_eq!(cycles(&[root, a, ("b.rs", "use crate::X;")]), []);
    }

    #[test]
    fn parents_and_children_may_import_each_other() {
        let parent = ("a.rs", "mod b; use b::B;");
        assert_eq!(
            cycles(&[parent, ("a/b.rs", "use super::A; use crate::a::C;")]),
            []
        );
        let grandparent = ("a.rs", "mod b; use b::c::C;");
        let files = [
            grandparent,
            ("a/b.rs", ""),
            ("a/b/c.rs", "use crate::a::A;"),
        ];
        assert_eq!(cycles(&files), pair("a.rs", "a/b/c.rs"));
    }

    #[test]
    fn super_counts_from_the_inline_module() {
        let a = ("a.rs", "mod inner { use super::super::b::B; }");
        let b = ("b.rs", "mod inner { use super::a::A; }");
        assert_eq!(cycles(&[a, b]), []);
        let b = ("b.rs", "mod inner { use super::super::a::A; }");
        assert_eq!(cycles(&[a, b]), pair("a.rs", "b.rs"));
    }
}
