//! Rust source as tokens with line numbers: enough to find functions, test modules and paths.

use std::ops::RangeInclusive;

/// A word or one character of punctuation, outside comments and literals.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// Counted from 1.
    pub line: usize,
    pub text: String,
}

/// A function with a body.
#[derive(Debug, PartialEq, Eq)]
pub struct Function {
    pub name: String,
    /// From `fn` to the closing brace.
    pub lines: RangeInclusive<usize>,
}

impl Function {
    pub fn length(&self) -> usize {
        self.lines.end() - self.lines.start() + 1
    }
}

/// The tokens of a file. Comments and the insides of string and character literals give none.
pub fn tokens(source: &str) -> Vec<Token> {
    let code: Vec<char> = blank_comments_and_literals(source).chars().collect();
    let mut found = Vec::new();
    let mut line = 1;
    let mut at = 0;
    while at < code.len() {
        let start = at;
        while at < code.len() && is_word(code[at]) {
            at += 1;
        }
        if at == start {
            at += 1;
        }
        if code[start] == '\n' {
            line += 1;
        } else if !code[start].is_whitespace() {
            let text = code[start..at].iter().collect();
            found.push(Token { line, text });
        }
    }
    found
}

/// All functions that have a body, nested ones too.
pub fn functions(tokens: &[Token]) -> Vec<Function> {
    let mut found = Vec::new();
    for (at, token) in tokens.iter().enumerate() {
        let Some(name) = tokens.get(at + 1) else {
            break;
        };
        // Without a name it is the type of a function pointer.
        if token.text != "fn" || !name.text.starts_with(is_word) {
            continue;
        }
        let Some(open) = body(tokens, at) else {
            continue;
        };
        let end = tokens[closing_brace(tokens, open)].line;
        found.push(Function {
            name: name.text.clone(),
            lines: token.line..=end,
        });
    }
    found
}

/// Index ranges in `tokens` of the inline modules that exist in tests only, attributes included.
pub fn test_modules(tokens: &[Token]) -> Vec<RangeInclusive<usize>> {
    let mut found = Vec::new();
    let mut at = 0;
    while at < tokens.len() {
        let start = at;
        let mut for_tests = false;
        while is(tokens, at, "#") && is(tokens, at + 1, "[") {
            let end = closing(tokens, at + 1, "[", "]");
            let words = &tokens[at..end];
            let has = |word: &str| words.iter().any(|token| token.text == word);
            for_tests |= has("cfg") && has("test") && !has("not");
            at = end + 1;
        }
        let module = is(tokens, at, "mod") && is(tokens, at + 2, "{");
        if for_tests && module {
            at = closing_brace(tokens, at + 2);
            found.push(start..=at);
        }
        if at == start {
            at += 1;
        }
    }
    found
}

/// The tokens that are not in a module for tests.
pub fn without_tests(tokens: &[Token]) -> Vec<Token> {
    let mut kept = Vec::new();
    let mut from = 0;
    for module in test_modules(tokens) {
        kept.extend_from_slice(&tokens[from..*module.start()]);
        from = module.end() + 1;
    }
    kept.extend_from_slice(&tokens[from..]);
    kept
}

/// The number of lines of a file, without those of its modules for tests.
pub fn lines_without_tests(source: &str) -> usize {
    let tokens = tokens(source);
    let of_tests: usize = test_modules(&tokens)
        .iter()
        .map(|module| tokens[*module.end()].line - tokens[*module.start()].line + 1)
        .sum();
    source.lines().count() - of_tests
}

/// True if the token at this index has this text.
pub fn is(tokens: &[Token], at: usize, text: &str) -> bool {
    tokens.get(at).is_some_and(|token| token.text == text)
}

/// Index of the `}` that closes the `{` at `open`.
pub fn closing_brace(tokens: &[Token], open: usize) -> usize {
    closing(tokens, open, "{", "}")
}

/// Index of the bracket that closes the one at `open`, or of the last token.
fn closing(tokens: &[Token], open: usize, opens: &str, closes: &str) -> usize {
    let mut depth = 0;
    for (at, token) in tokens.iter().enumerate().skip(open) {
        if token.text == opens {
            depth += 1;
        } else if token.text == closes {
            depth -= 1;
            if depth == 0 {
                return at;
            }
        }
    }
    tokens.len() - 1
}

/// Index of the `{` that opens the body of the function at `start`; none for a declaration.
fn body(tokens: &[Token], start: usize) -> Option<usize> {
    let mut depth = 0;
    for (at, token) in tokens.iter().enumerate().skip(start) {
        match token.text.as_str() {
            "(" | "[" => depth += 1,
            ")" | "]" => depth -= 1,
            "{" if depth == 0 => return Some(at),
            ";" if depth == 0 => return None,
            _ => {}
        }
    }
    None
}

fn is_word(character: char) -> bool {
    character.is_alphanumeric() || character == '_'
}

/// Replaces comments and literals by spaces. All line breaks stay where they are.
fn blank_comments_and_literals(source: &str) -> String {
    let text: Vec<char> = source.chars().collect();
    let mut blanked = String::with_capacity(source.len());
    let mut at = 0;
    while at < text.len() {
        let end = end_of_blank(&text, at);
        if end == at {
            blanked.push(text[at]);
            at += 1;
            continue;
        }
        for &character in &text[at..end] {
            blanked.push(if character == '\n' { '\n' } else { ' ' });
        }
        at = end;
    }
    blanked
}

/// End of the comment or literal that begins at `at`; `at` itself if none does.
fn end_of_blank(text: &[char], at: usize) -> usize {
    let next = text.get(at + 1).copied();
    match text[at] {
        '/' if next == Some('/') => find(text, at, |rest| rest[0] == '\n'),
        '/' if next == Some('*') => end_of_block_comment(text, at),
        '"' => end_of_quoted(text, at, '"'),
        '\'' if next == Some('\\') || text.get(at + 2) == Some(&'\'') => {
            end_of_quoted(text, at, '\'')
        }
        'r' if at == 0 || !is_word(text[at - 1]) || is_raw_prefix(text, at) => {
            end_of_raw_string(text, at)
        }
        _ => at,
    }
}

/// True for the `r` of `br"` and `cr"`.
fn is_raw_prefix(text: &[char], at: usize) -> bool {
    matches!(text[at - 1], 'b' | 'c') && (at == 1 || !is_word(text[at - 2]))
}

fn end_of_block_comment(text: &[char], start: usize) -> usize {
    let mut depth = 0;
    let mut at = start;
    while at + 1 < text.len() {
        match (text[at], text[at + 1]) {
            ('/', '*') => depth += 1,
            ('*', '/') => depth -= 1,
            _ => {
                at += 1;
                continue;
            }
        }
        at += 2;
        if depth == 0 {
            return at;
        }
    }
    text.len()
}

fn end_of_quoted(text: &[char], start: usize, quote: char) -> usize {
    let mut at = start + 1;
    while at < text.len() && text[at] != quote {
        at += if text[at] == '\\' { 2 } else { 1 };
    }
    (at + 1).min(text.len())
}

/// End of the raw string whose `r` is at `start`; `start` if it is only the letter.
fn end_of_raw_string(text: &[char], start: usize) -> usize {
    let hashes = text[start + 1..].iter().take_while(|c| **c == '#').count();
    let quote = start + 1 + hashes;
    if text.get(quote) != Some(&'"') {
        return start;
    }
    let end = find(text, quote + 1, |rest| {
        rest[0] == '"' && rest[1..].iter().take_while(|c| **c == '#').count() >= hashes
    });
    (end + 1 + hashes).min(text.len())
}

fn find(text: &[char], from: usize, matches: impl Fn(&[char]) -> bool) -> usize {
    let mut at = from;
    while at < text.len() && !matches(&text[at..]) {
        at += 1;
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(source: &str) -> Vec<String> {
        tokens(source).into_iter().map(|token| token.text).collect()
    }

    #[test]
    fn comments_and_literals_give_no_tokens() {
        assert_eq!(words("a // b {\nc"), ["a", "c"]);
        assert_eq!(words("a /* b /* { */ c */ d"), ["a", "d"]);
        assert_eq!(words(r#"a "b \" {" c"#), ["a", "c"]);
        assert_eq!(words("a '{' '\\'' b\"{\" c"), ["a", "b", "c"]);
        assert_eq!(words("a r##\"{ \"# \"## b"), ["a", "b"]);
        assert_eq!(words("fn f<'a>"), ["fn", "f", "<", "'", "a", ">"]);
        assert_eq!(words("for r in r#try"), ["for", "r", "in", "r", "#", "try"]);
    }

    #[test]
    fn a_literal_of_several_lines_keeps_the_count_of_lines() {
        let found = tokens("a\n\"b\n{\n\"\n/*\n*/ c");
        assert_eq!(found[1].text, "c");
        assert_eq!(found[1].line, 6);
    }

    #[test]
    fn functions_are_counted_from_fn_to_the_closing_brace() {
        let source = "trait T { fn declared(a: [u8; 3]); }\n\
                      fn one() -> fn() { \"}\"; }\n\
                      fn three(a: [u8; 3])\n{\n    // }\n    if a { fn inner() {\n} }\n}\n";
        let found: Vec<_> = functions(&tokens(source))
            .iter()
            .map(|function| (function.name.clone(), function.length()))
            .collect();
        let expected = [("one", 1), ("three", 6), ("inner", 2)];
        assert_eq!(
            found,
            expected.map(|(name, lines)| (name.to_owned(), lines))
        );
    }

    #[test]
    fn modules_for_tests_do_not_count() {
        let source =
            "fn a() {}\n#[cfg(test)]\n#[allow(x)]\nmod tests {\n fn b() {}\n}\nfn c() {}\n";
        assert_eq!(lines_without_tests(source), 2);
        let names: Vec<_> = functions(&without_tests(&tokens(source)))
            .into_iter()
            .map(|function| function.name)
            .collect();
        assert_eq!(names, ["a", "c"]);
        for counted in ["#[cfg(not(test))]\nmod m {\n}\n", "mod tests {\n}\n\n"] {
            assert_eq!(lines_without_tests(counted), 3, "{counted}");
        }
    }
}
