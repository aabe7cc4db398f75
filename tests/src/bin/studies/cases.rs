//! The cases of a study, as its help lists them.

/// A line for each case: its name and what it is.
pub(super) fn cases_in_words<'a>(cases: impl IntoIterator<Item = (&'a str, &'a str)>) -> String {
    let lines: Vec<String> = cases.into_iter().map(|(name, what)| format!("  {name:14} {what}")).collect();
    format!("Cases:\n{}", lines.join("\n"))
}
