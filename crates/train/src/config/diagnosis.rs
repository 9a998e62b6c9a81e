//! A config error the way a compiler shows one: file, line, column, the line itself, a caret and what to try.

use std::fmt;
use std::ops::Range;

/// One problem in one layer of the configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnosis {
    /// The file, or `--set` for an assignment of the command line.
    pub origin: String,
    /// Line and column, from 1; absent when the value comes from a default.
    pub position: Option<(usize, usize)>,
    /// The text of that line.
    pub line: String,
    /// How many characters the caret marks.
    pub width: usize,
    /// What was found.
    pub message: String,
    /// What to try.
    pub help: Vec<String>,
}

impl Diagnosis {
    /// A problem at a byte range of a source text.
    pub fn at(origin: &str, source: &str, span: Option<Range<usize>>, message: String, help: Vec<String>) -> Self {
        let Some(span) = span.filter(|span| span.start <= source.len()) else {
            return Self { origin: origin.into(), position: None, line: String::new(), width: 0, message, help };
        };
        let start = source[..span.start].rfind('\n').map_or(0, |at| at + 1);
        let end = source[span.start..].find('\n').map_or(source.len(), |at| span.start + at);
        let row = source[..start].matches('\n').count() + 1;
        let column = source[start..span.start].chars().count() + 1;
        let width = source[span.start..span.end.clamp(span.start, end)].chars().count().max(1);
        Self { origin: origin.into(), position: Some((row, column)), line: source[start..end].into(), width, message, help }
    }

    /// Turns an error of the TOML reader into one with a suggestion.
    pub fn from_toml(origin: &str, source: &str, error: &toml::de::Error) -> Self {
        Self::of_toml_message(origin, source, error.span(), error.message())
    }

    /// A message of the TOML reader at a place that only the caller knows.
    pub fn of_toml_message(origin: &str, source: &str, span: Option<Range<usize>>, message: &str) -> Self {
        let (message, help) = explain(message);
        Self::at(origin, source, span, message, help)
    }
}

impl fmt::Display for Diagnosis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.position {
            Some((row, column)) => {
                let gutter = " ".repeat(row.to_string().len());
                writeln!(f, "{}:{row}:{column}: {}", self.origin, self.message)?;
                writeln!(f, "{gutter} |")?;
                writeln!(f, "{row} | {}", self.line)?;
                write!(f, "{gutter} | {}{}", " ".repeat(column - 1), "^".repeat(self.width))?;
            }
            None => write!(f, "{}: {}", self.origin, self.message)?,
        }
        for help in &self.help {
            write!(f, "\n  = {help}")?;
        }
        Ok(())
    }
}

/// Adds the nearest known name to serde's "unknown field/variant `x`, expected …", and to "missing field `x`" what to do.
fn explain(message: &str) -> (String, Vec<String>) {
    let first_line = message.lines().next().unwrap_or_default().to_string();
    let mut names = first_line.split('`').skip(1).step_by(2).map(str::to_string);
    let kind = if first_line.starts_with("unknown field") {
        "key"
    } else if first_line.starts_with("unknown variant") {
        "value"
    } else if first_line.starts_with("missing field") {
        let help = "it has no default, because nothing here can tell what it must be: write it out".to_string();
        return (format!("missing key `{}`", names.next().unwrap_or_default()), vec![help]);
    } else {
        return (in_words(&first_line), Vec::new());
    };
    let found = names.next().unwrap_or_default();
    let known: Vec<String> = names.filter(|name| name != "extends").collect();
    let mut help = Vec::new();
    if let Some(name) = nearest(&found, known.iter().map(String::as_str)) {
        help.push(format!("did you mean `{name}`?"));
    }
    help.push(format!("known here: {}", known.join(", ")));
    (format!("unknown {kind} `{found}`"), help)
}

/// Puts the type that serde expected into a person's words: "expected usize" says nothing to who doesn't write Rust.
fn in_words(message: &str) -> String {
    let Some((found, expected)) = message.rsplit_once(", expected ") else { return message.into() };
    let expected = match expected {
        "usize" | "u64" | "u32" | "u16" | "u8" => "a whole number of at least 0",
        "isize" | "i64" | "i32" => "a whole number",
        "f64" | "f32" => "a number",
        "a sequence" => "a list, for example [1, 2]",
        name if name.starts_with("struct ") || name == "a map" => "a table of keys",
        other => other,
    };
    format!("{found}, expected {expected}")
}

/// The candidate most like the name, when any is like it at all.
pub fn nearest<'a>(name: &str, candidates: impl Iterator<Item = &'a str>) -> Option<String> {
    candidates
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.7)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, candidate)| candidate.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn caret_stands_under_the_marked_text() {
        let source = "[run]\nseed = 1\nstepz = 4\n";
        let at = source.find("stepz").unwrap();
        let text = Diagnosis::at("a.toml", source, Some(at..at + 5), "unknown key `stepz`".into(), vec![]).to_string();
        assert_eq!(text, "a.toml:3:1: unknown key `stepz`\n  |\n3 | stepz = 4\n  | ^^^^^");
    }

    #[test]
    fn a_span_over_two_lines_marks_only_the_first() {
        let source = "a = [\n1,\n]";
        let shown = Diagnosis::at("x", source, Some(4..source.len()), "m".into(), vec![]);
        assert_eq!((shown.position, shown.width), (Some((1, 5)), 1));
    }

    #[test]
    fn expected_types_are_told_in_words() {
        for (said, told) in [
            (
                "invalid type: string \"four\", expected usize",
                "invalid type: string \"four\", expected a whole number of at least 0",
            ),
            ("invalid type: string \"fast\", expected f64", "invalid type: string \"fast\", expected a number"),
            ("invalid type: integer `3`, expected struct SvbrdfStage", "invalid type: integer `3`, expected a table of keys"),
            ("invalid type: string \"x\", expected a boolean", "invalid type: string \"x\", expected a boolean"),
            ("something else", "something else"),
        ] {
            assert_eq!(explain(said), (told.to_string(), vec![]));
        }
    }

    #[test]
    fn unlike_names_suggest_nothing() {
        assert_eq!(nearest("qqq", ["steps", "batch"].into_iter()), None);
        assert_eq!(nearest("step", ["steps", "batch"].into_iter()).as_deref(), Some("steps"));
    }
}
