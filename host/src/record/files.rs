//! A setup's files: patterns flow in, existing files in the order of time flow out.

use std::cmp::Ordering;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

use super::error::RecordError;
use crate::study::Setup;

/// The files that the setup's patterns match below `folder`: pattern after pattern, those of one pattern by name.
pub(super) fn matching_files(setup: &Setup, folder: &Path) -> Result<Vec<PathBuf>, RecordError> {
    if setup.files.is_empty() {
        return Err(RecordError::NoFiles { setup: setup.name.clone() });
    }
    let mut files = Vec::new();
    let mut seen = HashSet::new();
    for pattern in &setup.files {
        for file in matches(pattern, folder)? {
            if !seen.insert(file.clone()) {
                return Err(RecordError::FileTwice { file });
            }
            files.push(file);
        }
    }
    Ok(files)
}

fn matches(pattern: &str, folder: &Path) -> Result<Vec<PathBuf>, RecordError> {
    let literal = folder.join(pattern);
    if literal.is_file() {
        return Ok(vec![literal]);
    }
    let bad = |reason: String| RecordError::Pattern { pattern: pattern.to_owned(), reason };
    // The folder's own name is no pattern, whatever characters it has.
    let full = if Path::new(pattern).is_absolute() {
        pattern.to_owned()
    } else {
        let folder = folder.to_str().ok_or_else(|| bad(format!("the folder {folder:?} is not named in UTF-8")))?;
        let folder = if folder.is_empty() { "." } else { folder };
        format!("{}/{pattern}", glob::Pattern::escape(folder.trim_end_matches('/')))
    };
    let mut found = Vec::new();
    for path in glob::glob(&full).map_err(|error| bad(error.to_string()))? {
        let path = path.map_err(|error| RecordError::Io { file: error.path().to_owned(), source: error.into() })?;
        if path.is_file() {
            found.push(path);
        }
    }
    if found.is_empty() {
        return Err(RecordError::NothingMatches { pattern: pattern.to_owned(), folder: folder.to_owned() });
    }
    found.sort_by(|one, other| by_name(&one.to_string_lossy(), &other.to_string_lossy()));
    Ok(found)
}

/// Order of names in which `part_2` stands before `part_10`: runs of digits count as numbers, the rest by its bytes.
fn by_name(one: &str, other: &str) -> Ordering {
    let (mut one_left, mut other_left) = (one.as_bytes(), other.as_bytes());
    while !one_left.is_empty() && !other_left.is_empty() {
        let (one_run, one_rest) = next_run(one_left);
        let (other_run, other_rest) = next_run(other_left);
        // Without leading zeros the longer number is the larger.
        let order = match (one_run, other_run) {
            (Run::Number(one), Run::Number(other)) => one.len().cmp(&other.len()).then_with(|| one.cmp(other)),
            (Run::Byte(one), Run::Byte(other)) => one.cmp(&other),
            (Run::Number(_), Run::Byte(byte)) => b'0'.cmp(&byte),
            (Run::Byte(byte), Run::Number(_)) => byte.cmp(&b'0'),
        };
        if order != Ordering::Equal {
            return order;
        }
        (one_left, other_left) = (one_rest, other_rest);
    }
    one_left.len().cmp(&other_left.len()).then_with(|| one.cmp(other))
}

enum Run<'a> {
    /// Digits without leading zeros.
    Number(&'a [u8]),
    Byte(u8),
}

fn next_run(text: &[u8]) -> (Run<'_>, &[u8]) {
    let digits = text.iter().take_while(|byte| byte.is_ascii_digit()).count();
    match text.split_at(digits) {
        ([], [byte, rest @ ..]) => (Run::Byte(*byte), rest),
        (number, rest) => {
            let zeros = number.iter().take_while(|byte| **byte == b'0').count();
            (Run::Number(number.get(zeros..).unwrap_or_default()), rest)
        }
    }
}

#[cfg(test)]
mod tests {
    use std::cmp::Ordering;

    use proptest::prelude::*;

    use super::by_name;

    #[test]
    fn numbers_in_names_count() {
        let mut names = ["b_1", "a_10", "a_9", "a_2", "a_002b", "a", "a_2b"];
        names.sort_by(|one, other| by_name(one, other));
        assert_eq!(names, ["a", "a_2", "a_002b", "a_2b", "a_9", "a_10", "b_1"]);
        // Dates and times padded with zeros keep the order every listing shows.
        assert_eq!(by_name("20240131_2350.csv", "20240201_0000.csv"), Ordering::Less);
    }

    proptest! {
        #[test]
        fn is_an_order(names in prop::array::uniform3("[a0-2_]{0,6}")) {
            let [one, two, three] = &names;
            prop_assert_eq!(by_name(one, two), by_name(two, one).reverse());
            prop_assert_eq!(by_name(one, two) == Ordering::Equal, one == two);
            if by_name(one, two).is_le() && by_name(two, three).is_le() {
                prop_assert!(by_name(one, three).is_le());
            }
        }
    }
}
