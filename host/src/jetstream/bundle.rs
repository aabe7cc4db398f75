//! A study's folder as one object: what `study.toml`, the model and its effects stand in, and the modes to follow. Recordings, the archive and
//! results stay where they are.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::StreamError;
use crate::archive::ARCHIVE_FILE;
use crate::files::read_plain;
use crate::heartbeats::HEARTBEATS_FILE;
use crate::record::matching_files;
use crate::results::{REFERENCE_FILE, Results};
use crate::study::Study;

/// The first byte of the object.
const BUNDLE_VERSION: u8 = 1;
/// What all files may take.
const MOST_BYTES: u64 = 64_000_000;
/// Folders within folders that are looked into.
const DEEPEST: usize = 4;

/// Files by their paths, with `/` between their parts.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Bundle {
    files: Vec<(String, Vec<u8>)>,
}

impl Bundle {
    /// Of a study, with these modes to follow.
    pub(super) fn of(study: &Study, reference: Vec<u8>) -> Result<Self, StreamError> {
        let recordings: BTreeSet<PathBuf> =
            study.setups.iter().flat_map(|setup| matching_files(setup, &study.folder).unwrap_or_default()).collect();
        // Workers send no mail: passwords stay here, however their paths are written, and through links.
        let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let secrets: Vec<PathBuf> = study.alarms.secrets().map(|file| real(&study.folder.join(file))).collect();
        let mut paths = Vec::new();
        walk(&study.folder, &study.folder, 0, &mut paths)?;
        let (mut files, mut bytes) = (vec![(reference_path(), reference)], 0);
        for (path, name) in paths {
            if recordings.contains(&path) || secrets.contains(&real(&path)) {
                continue;
            }
            let content = read_plain(&path).map_err(|source| StreamError::File { file: path, source })?;
            bytes += content.len() as u64;
            files.push((name, content));
            if bytes > MOST_BYTES {
                files.sort_by_key(|(_, content)| std::cmp::Reverse(content.len()));
                let largest: Vec<&str> = files.iter().take(3).map(|(name, _)| name.as_str()).collect();
                return Err(StreamError::Unfit {
                    study: study.folder.display().to_string(),
                    why: format!(
                        "its files take more than {} MB, and a server is to hold thousands of studies: move away what the model does not need, such as {}",
                        MOST_BYTES / 1_000_000,
                        largest.join(", ")
                    ),
                });
            }
        }
        Ok(Self { files })
    }

    /// The modes to follow.
    pub(super) fn reference(&self) -> Option<&[u8]> {
        let path = reference_path();
        self.files.iter().find(|(name, _)| *name == path).map(|(_, content)| content.as_slice())
    }

    /// The object.
    pub(super) fn encode(&self) -> Result<Vec<u8>, StreamError> {
        postcard::to_extend(self, vec![BUNDLE_VERSION]).map_err(|error| odd(error.to_string()))
    }

    /// Reads an object.
    pub(super) fn decode(object: &[u8]) -> Result<Self, StreamError> {
        match object.split_first() {
            Some((&BUNDLE_VERSION, content)) => postcard::from_bytes(content).map_err(|error| odd(error.to_string())),
            Some((version, _)) => Err(odd(format!("its version is {version}, and {BUNDLE_VERSION} is known here"))),
            None => Err(odd("it is empty".to_owned())),
        }
    }

    /// Writes the files into a folder. A path that leads out of it is none.
    pub(super) fn unpack(&self, folder: &Path) -> Result<(), StreamError> {
        for (name, content) in &self.files {
            let path = Path::new(name);
            if name.is_empty() || !path.components().all(|part| matches!(part, Component::Normal(_))) {
                return Err(odd(format!("\"{name}\" is no path below a study")));
            }
            let file = folder.join(path);
            let written = file.parent().map_or(Ok(()), fs::create_dir_all).and_then(|()| fs::write(&file, content));
            written.map_err(|source| StreamError::File { file, source })?;
        }
        Ok(())
    }
}

fn odd(why: String) -> StreamError {
    StreamError::Odd { what: "a study".to_owned(), why }
}

/// Where a study has the modes that are followed.
fn reference_path() -> String {
    let file = Results::in_study(Path::new("")).path(REFERENCE_FILE);
    file.components().map(|part| part.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/")
}

/// The files of a study, with their paths below it.
fn walk(folder: &Path, below: &Path, depth: usize, found: &mut Vec<(PathBuf, String)>) -> Result<(), StreamError> {
    let unread = |source| StreamError::File { file: folder.to_owned(), source };
    let mut entries = fs::read_dir(folder).map_err(unread)?.collect::<Result<Vec<_>, _>>().map_err(unread)?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let (path, name) = (entry.path(), entry.file_name());
        let Some(name) = name.to_str() else { continue };
        let is_left = name.starts_with('.')
            || (depth == 0
                && (name.starts_with(ARCHIVE_FILE)
                    || [HEARTBEATS_FILE, "results", super::position::POSITION_FILE].contains(&name)));
        if is_left {
            continue;
        }
        let kind = fs::metadata(&path).map_err(|source| StreamError::File { file: path.clone(), source })?;
        if kind.is_dir() && depth < DEEPEST {
            walk(&path, below, depth + 1, found)?;
        } else if kind.is_file() {
            let relative = path.strip_prefix(below).unwrap_or(&path);
            let parts: Vec<_> = relative.components().map(|part| part.as_os_str().to_string_lossy()).collect();
            let name = parts.join("/");
            found.push((path, name));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::STUDY_FILE;
    use crate::study::template::{CANTON_BEAM, CANTON_STUDY};

    #[test]
    fn a_study_comes_out_as_it_went_in_without_what_grows_and_never_beside_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let alarms = "[alarms.mqtt]\nserver = \"mqtts://hub\"\ntopic = \"towers\"\nuser = \"me\"\npassword_file = \"parts/word\"\n";
        fs::write(at(STUDY_FILE), format!("{CANTON_STUDY}\n{alarms}")).unwrap();
        fs::write(at("beam.csv"), CANTON_BEAM).unwrap();
        fs::create_dir_all(at("parts/one")).unwrap();
        fs::write(at("parts/word"), "secret").unwrap();
        fs::create_dir(at("results")).unwrap();
        fs::write(at("parts/one/k.mtx"), "matrix").unwrap();
        for name in ["archive.sqlite", "archive.sqlite-wal", "heartbeats.jsonl", ".belfry-lock", "results/modes.json"] {
            fs::write(at(name), "no").unwrap();
        }
        let study = Study::load(folder.path()).unwrap();
        let bundle = Bundle::of(&study, b"{}".to_vec()).unwrap();
        let names: Vec<&str> = bundle.files.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["results/watch_reference.json", "beam.csv", "parts/one/k.mtx", STUDY_FILE]);
        let back = Bundle::decode(&bundle.encode().unwrap()).unwrap();
        assert_eq!(back, bundle);
        let copy = tempfile::tempdir().unwrap();
        back.unpack(copy.path()).unwrap();
        assert_eq!(fs::read_to_string(copy.path().join("parts/one/k.mtx")).unwrap(), "matrix");
        assert_eq!(back.reference(), Some(&b"{}"[..]));
        for name in ["../out", "/out", "a/../../out", ""] {
            let bad = Bundle { files: vec![(name.to_owned(), Vec::new())] };
            assert!(bad.unpack(copy.path()).is_err(), "{name}");
        }
        assert!(Bundle::decode(&[]).is_err() && Bundle::decode(&[9, 0]).is_err() && Bundle::decode(&[1, 9]).is_err());
    }
}
