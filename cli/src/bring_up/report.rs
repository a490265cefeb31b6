//! Findings of a bring-up, and their report.

use std::fmt::Write as _;

use aplomb_recordings::terminal::print_line;

/// Verdict on a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The step found what it expects.
    Good,
    /// The step found something else.
    Bad,
    /// The step was not done.
    Skipped,
}

impl Verdict {
    /// Returns the word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Bad => "BAD",
            Self::Skipped => "skipped",
        }
    }
}

/// Result of a step.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Verdict.
    pub verdict: Verdict,
    /// Observation.
    pub saw: String,
    /// Advice to the person; empty if there is nothing to do.
    pub advice: String,
    /// Lines for the report alone.
    pub details: String,
}

impl Finding {
    /// Returns a finding without advice, as `is_good` says.
    pub fn new(is_good: bool, saw: impl Into<String>) -> Self {
        Self {
            verdict: if is_good { Verdict::Good } else { Verdict::Bad },
            saw: saw.into(),
            advice: String::new(),
            details: String::new(),
        }
    }

    /// Returns a bad finding.
    pub fn bad(saw: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::new(false, saw).advise(advice)
    }

    /// Returns the finding of a step that was not done.
    pub fn skipped(reason: impl Into<String>) -> Self {
        Self {
            verdict: Verdict::Skipped,
            ..Self::new(true, reason)
        }
    }

    /// Adds advice, which a good finding does not need.
    pub fn advise(mut self, advice: impl Into<String>) -> Self {
        if self.verdict != Verdict::Good {
            self.advice = advice.into();
        }
        self
    }

    /// Adds lines for the report.
    pub fn with_details(mut self, details: impl Into<String>) -> Self {
        self.details = details.into();
        self
    }
}

/// Report of all steps.
#[derive(Debug, Default)]
pub struct Report {
    findings: Vec<(&'static str, &'static str, Finding)>,
}

impl Report {
    /// Adds the finding of a step, and prints it.
    pub fn add(&mut self, step: &'static str, expected: &'static str, finding: Finding) {
        let (verdict, saw) = (finding.verdict.name(), &finding.saw);
        print_line(&format!("   {verdict}: {saw}"));
        if !finding.advice.is_empty() {
            print_line(&format!("   do: {}", finding.advice));
        }
        self.findings.push((step, expected, finding));
    }

    /// Returns the number of findings with this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        let findings = self.findings.iter();
        findings
            .filter(|(_, _, finding)| finding.verdict == verdict)
            .count()
    }

    /// Returns the report as Markdown. `picture` is the name of the picture's file.
    pub fn markdown(&self, picture: Option<&str>) -> String {
        let mut text = String::from("# Bring-up of a module\n\n");
        let version = env!("CARGO_PKG_VERSION");
        writeln!(
            text,
            "Written by `aplomb bring-up` {version}: {} good, {} bad, {} skipped. Attach this file \
             and its picture to an issue.\n",
            self.count(Verdict::Good),
            self.count(Verdict::Bad),
            self.count(Verdict::Skipped)
        )
        .ok();
        text.push_str("| step | verdict | expected | saw | do |\n|---|---|---|---|---|\n");
        for (step, expected, finding) in &self.findings {
            let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
            writeln!(
                text,
                "| {step} | {} | {} | {} | {} |",
                finding.verdict.name(),
                cell(expected),
                cell(&finding.saw),
                cell(&finding.advice)
            )
            .ok();
        }
        if let Some(picture) = picture {
            writeln!(
                text,
                "\n![Allan deviation of the sensor at rest]({picture})"
            )
            .ok();
        }
        for (step, _, finding) in &self.findings {
            if !finding.details.is_empty() {
                writeln!(
                    text,
                    "\n## {step}\n\n```text\n{}\n```",
                    finding.details.trim()
                )
                .ok();
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_counts_and_keeps_its_table_whole() {
        let mut report = Report::default();
        report.add("bus", "an answer", Finding::new(true, "flags=VALID|MISSED"));
        let bad = Finding::bad("nothing", "check the wire").with_details("line");
        report.add("INT pin", "edges", bad);
        report.add("poses", "1 g", Finding::skipped("as asked"));
        let text = report.markdown(Some("a.png"));
        assert!(text.contains("1 good, 1 bad, 1 skipped"), "{text}");
        assert!(
            text.contains("| bus | good | an answer | flags=VALID\\|MISSED |  |"),
            "{text}"
        );
        assert!(
            text.contains("| INT pin | BAD | edges | nothing | check the wire |"),
            "{text}"
        );
        assert!(
            text.contains("](a.png)") && text.contains("## INT pin"),
            "{text}"
        );
    }
}
