//! A setup's files: patterns flow in, existing files in the order of time flow out, and open ones that hold something. The same of what a
//! user names before there is a setup.

use std::collections::HashSet;
use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::error::RecordError;
use super::source_file::is_recording;
use crate::study::Setup;

/// The files that the setup's patterns match below `folder`: pattern after pattern, those of one pattern by name.
pub(crate) fn matching_files(setup: &Setup, folder: &Path) -> Result<Vec<PathBuf>, RecordError> {
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

/// The files that a user names: files, patterns as `files` of a setup has them, and folders, which stand for the recordings in them.
pub(crate) fn named_files(named: &[PathBuf]) -> Result<Vec<PathBuf>, RecordError> {
    let mut files = Vec::new();
    for path in named {
        let of_one = if path.is_file() {
            vec![path.clone()]
        } else if path.is_dir() {
            recordings_in(path)?
        } else {
            match path.to_str().map(|pattern| matches(pattern, Path::new(""))) {
                // No pattern, but a file that is not there.
                None | Some(Err(RecordError::NothingMatches { .. } | RecordError::Pattern { .. })) => {
                    return Err(RecordError::io(path)(ErrorKind::NotFound.into()));
                }
                Some(found) => found?,
            }
        };
        for file in of_one {
            if files.contains(&file) {
                return Err(RecordError::FileTwice { file });
            }
            files.push(file);
        }
    }
    Ok(files)
}

fn recordings_in(folder: &Path) -> Result<Vec<PathBuf>, RecordError> {
    let mut found = Vec::new();
    for entry in folder.read_dir().map_err(RecordError::io(folder))? {
        let path = entry.map_err(RecordError::io(folder))?.path();
        let is_hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
        if path.is_file() && is_recording(&path) && !is_hidden {
            found.push(path);
        }
    }
    if found.is_empty() {
        let reason = "no file in this folder has the ending of a recording; name files or a pattern".to_owned();
        return Err(RecordError::Format { file: folder.to_owned(), reason });
    }
    alphanumeric_sort::sort_path_slice(&mut found);
    Ok(found)
}

/// Opens a file for reading; also its bytes, of which there is one at least.
pub(super) fn open_file(path: &Path) -> Result<(File, u64), RecordError> {
    let file = File::open(path).map_err(RecordError::io(path))?;
    match file.metadata().map_err(RecordError::io(path))?.len() {
        0 => Err(RecordError::Empty { file: path.to_owned() }),
        bytes => Ok((file, bytes)),
    }
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
    // `part_2` before `part_10`.
    alphanumeric_sort::sort_path_slice(&mut found);
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(names: &[&str]) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        for name in names {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let files = matches("*", folder.path()).unwrap();
        files.iter().filter_map(|file| Some(file.file_name()?.to_str()?.to_owned())).collect()
    }

    #[test]
    fn a_user_names_files_patterns_and_folders() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["part_10.csv", "part_2.csv", "other.npy", "notes.md", ".hidden.csv", "study.toml"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let path = |name: &str| folder.path().join(name);
        let named = |names: &[PathBuf]| {
            let found = named_files(names)?;
            let name = |file: &PathBuf| file.file_name().unwrap().to_str().unwrap().to_owned();
            Ok::<Vec<String>, RecordError>(found.iter().map(name).collect())
        };
        assert_eq!(named(&[path("part_*.csv")]).unwrap(), ["part_2.csv", "part_10.csv"]);
        assert_eq!(named(&[folder.path().to_owned()]).unwrap(), ["other.npy", "part_2.csv", "part_10.csv"]);
        assert_eq!(named(&[path("notes.md"), path("other.npy")]).unwrap(), ["notes.md", "other.npy"]);
        let twice = named(&[path("part_2.csv"), path("*.csv")]).unwrap_err();
        assert!(matches!(&twice, RecordError::FileTwice { file } if file.ends_with("part_2.csv")), "{twice}");
        for missing in ["gone.csv", "gone_*.csv", "gone_[.csv"] {
            let error = named(&[path(missing)]).unwrap_err();
            assert!(matches!(&error, RecordError::Io { file, .. } if file.ends_with(missing)), "{error}");
        }
        std::fs::create_dir(path("empty")).unwrap();
        assert!(named(&[path("empty")]).unwrap_err().to_string().contains("no file in this folder"));
    }

    #[test]
    fn numbers_in_names_count() {
        let names = found(&["b_1", "a_10", "a_9", "a_2", "a_002b", "a", "a_2b"]);
        assert_eq!(names, ["a", "a_2", "a_2b", "a_002b", "a_9", "a_10", "b_1"]);
        // Dates and times padded with zeros keep the order every listing shows.
        assert_eq!(found(&["20240201_0000.csv", "20240131_2350.csv"]), ["20240131_2350.csv", "20240201_0000.csv"]);
    }
}
