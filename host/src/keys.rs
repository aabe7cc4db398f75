//! The nodes' keys: a file of the user's, a line a node.
//!
//! Whoever has a node's key can make it drop windows and can send invented ones. So the file lies outside every study, which people hand on, and
//! nobody else may read it. Keys come from the system's random source, and are never printed.

use std::collections::BTreeMap;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use belfry_shared::seal::{KEY_BYTES, Key};
use thiserror::Error;

use crate::files::{FolderLock, behind_links, folder_of, write_private};

/// A variable of the environment that names the file.
const VARIABLE: &str = "BELFRY_KEYS";
/// What stands above the keys.
const HEADING: &str = "# Keys of Belfry's sensor nodes: a line a node, its number and its key. Whoever has a key can write as its node and as its host.\n";
/// A file with more is no file of keys.
const MOST_BYTES: u64 = 1 << 23;

/// Why there is no key.
#[derive(Debug, Error)]
pub enum KeysError {
    /// The file cannot be read or written.
    #[error("the file of keys {file} cannot be used", file = .file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// Nobody knows where the file is.
    #[error("there is no home folder for the file of keys: name it in {VARIABLE}")]
    NoHome,
    /// Others may read or write it.
    #[error("others may read the keys in {file}: run `chmod 600` on it, and give the nodes new keys if somebody has", file = .file.display())]
    OpenToOthers {
        /// The file.
        file: PathBuf,
    },
    /// It lies in a study.
    #[error(
        "the file of keys {file} lies in the study {study}, and would be handed on with it: move it, and name its place in {VARIABLE}",
        file = .file.display(), study = .study.display()
    )]
    InStudy {
        /// The file.
        file: PathBuf,
        /// The study's folder.
        study: PathBuf,
    },
    /// A line is none of a key.
    #[error("line {line} of {file} is no key: expected a node's number and {digits} hexadecimal digits", file = .file.display(), digits = 2 * KEY_BYTES)]
    Line {
        /// The file.
        file: PathBuf,
        /// The line, from 1.
        line: usize,
    },
    /// A node has two keys.
    #[error("lines {first} and {line} of {file} both have a key of node {node}: remove the one that the node does not have", file = .file.display())]
    NodeTwice {
        /// The file.
        file: PathBuf,
        /// The node.
        node: u16,
        /// The first of its lines.
        first: usize,
        /// The second.
        line: usize,
    },
    /// Two nodes have one key.
    #[error("lines {first} and {line} of {file} have the same key: give one of the nodes a new one with `belfry key new`", file = .file.display())]
    KeyTwice {
        /// The file.
        file: PathBuf,
        /// The first of the lines.
        first: usize,
        /// The second.
        line: usize,
    },
    /// There is one already.
    #[error("node {node} has a key already, in {file}: for a new one remove its line first, and write the new image into the node", file = .file.display())]
    Exists {
        /// The node.
        node: u16,
        /// The file.
        file: PathBuf,
    },
    /// There is none.
    #[error("node {node} has no key in {file}: make one with `belfry key new {node}`", file = .file.display())]
    None {
        /// The node.
        node: u16,
        /// The file.
        file: PathBuf,
    },
    /// The system gives no random numbers.
    #[error("the system's random source gives no key")]
    Random(#[source] getrandom::Error),
}

/// The keys of nodes.
#[derive(Debug, Clone, Default)]
pub struct Keys(BTreeMap<u16, Key>);

impl Keys {
    /// The keys in the user's file; none where there is no file.
    ///
    /// # Errors
    /// [`KeysError`].
    pub fn load() -> Result<Self, KeysError> {
        let file = match file() {
            // Who has no home has no keys.
            Err(KeysError::NoHome) => return Ok(Self::default()),
            file => file?,
        };
        Self::of_file(&file)
    }

    /// The keys in a file; none where there is no file. One that lies in a study is refused.
    ///
    /// # Errors
    /// [`KeysError`].
    pub fn of_file(file: &Path) -> Result<Self, KeysError> {
        let fail = |source| KeysError::File { file: file.to_owned(), source };
        let metadata = match fs::metadata(file) {
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self::default()),
            metadata => metadata.map_err(fail)?,
        };
        if !metadata.is_file() || metadata.len() > MOST_BYTES {
            return Err(fail(io::Error::new(ErrorKind::InvalidInput, "it is no file of keys")));
        }
        #[cfg(unix)]
        if std::os::unix::fs::PermissionsExt::mode(&metadata.permissions()) & 0o077 != 0 {
            return Err(KeysError::OpenToOthers { file: file.to_owned() });
        }
        // A comment may be in any encoding; in a key, what is no ASCII is refused with its line.
        let keys = Self::parse(file, &String::from_utf8_lossy(&fs::read(file).map_err(fail)?))?;
        if !keys.0.is_empty() {
            outside_studies(&fs::canonicalize(file).map_err(fail)?)?;
        }
        Ok(keys)
    }

    fn parse(file: &Path, text: &str) -> Result<Self, KeysError> {
        let file = || file.to_owned();
        let mut keys: BTreeMap<u16, Key> = BTreeMap::new();
        let mut lines: Vec<(usize, u16)> = Vec::new();
        for (index, text) in text.lines().enumerate() {
            let (line, text) = (index + 1, text.trim());
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            let (node, key) = key_of(text).ok_or_else(|| KeysError::Line { file: file(), line })?;
            let line_of = |wanted: u16| lines.iter().find(|(_, node)| *node == wanted).map_or(0, |(line, _)| *line);
            if keys.contains_key(&node) {
                return Err(KeysError::NodeTwice { file: file(), node, first: line_of(node), line });
            }
            if let Some((&other, _)) = keys.iter().find(|(_, known)| **known == key) {
                return Err(KeysError::KeyTwice { file: file(), first: line_of(other), line });
            }
            keys.insert(node, key);
            lines.push((line, node));
        }
        Ok(Self(keys))
    }

    /// A node's key.
    pub fn of(&self, node: u16) -> Option<&Key> {
        self.0.get(&node)
    }

    /// The nodes that have one.
    pub fn nodes(&self) -> impl Iterator<Item = u16> {
        self.0.keys().copied()
    }
}

impl FromIterator<(u16, Key)> for Keys {
    fn from_iter<T: IntoIterator<Item = (u16, Key)>>(keys: T) -> Self {
        Self(keys.into_iter().collect())
    }
}

/// Number and key of a line.
fn key_of(line: &str) -> Option<(u16, Key)> {
    let mut words = line.split_ascii_whitespace();
    let (node, digits, None) = (words.next()?.parse().ok()?, words.next()?, words.next()) else { return None };
    if digits.len() != 2 * KEY_BYTES || node == 0 {
        return None;
    }
    let mut bytes = [0; KEY_BYTES];
    for (byte, digits) in bytes.iter_mut().zip(digits.as_bytes().chunks_exact(2)) {
        let digit = |digit: u8| char::from(digit).to_digit(16);
        *byte = u8::try_from(16 * digit(digits[0])? + digit(digits[1])?).ok()?;
    }
    Some((node, Key::new(bytes)))
}

/// The user's file of keys: what BELFRY_KEYS names, else `belfry/keys` in the folder of settings.
///
/// # Errors
/// Where the user has no home folder.
pub fn file() -> Result<PathBuf, KeysError> {
    let folder = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(file) = folder(VARIABLE) {
        return Ok(file);
    }
    let settings = if cfg!(windows) {
        folder("APPDATA")
    } else {
        folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config")))
    };
    Ok(settings.ok_or(KeysError::NoHome)?.join("belfry").join("keys"))
}

/// Draws a key for a node and adds it to the file, which is made where there is none.
///
/// # Errors
/// [`KeysError`]; where the node has one already, too.
pub fn add_new(file: &Path, node: u16) -> Result<Key, KeysError> {
    let fail = |source| KeysError::File { file: file.to_owned(), source };
    // A link to it stays.
    let file = &behind_links(file).map_err(fail)?;
    outside_studies(file)?;
    let folder = folder_of(file);
    fs::create_dir_all(folder).map_err(fail)?;
    // Two at once must not lose a key.
    let _lock = FolderLock::take(folder, || {}).map_err(fail)?;
    if Keys::of_file(file)?.of(node).is_some() {
        return Err(KeysError::Exists { node, file: file.to_owned() });
    }
    let mut key = [0; KEY_BYTES];
    getrandom::fill(&mut key).map_err(KeysError::Random)?;
    let mut text = match fs::read(file) {
        Err(error) if error.kind() == ErrorKind::NotFound => HEADING.into(),
        text => text.map_err(fail)?,
    };
    if !text.ends_with(b"\n") {
        text.push(b'\n');
    }
    let digits: String = key.iter().map(|byte| format!("{byte:02x}")).collect();
    text.extend(format!("{node} {digits}\n").bytes());
    // Never readable by others, not for a moment.
    write_private(file, &text, true).map_err(fail)?;
    Ok(Key::new(key))
}

/// Refuses a place within a study.
fn outside_studies(file: &Path) -> Result<(), KeysError> {
    let study = study_around(file).map_err(|source| KeysError::File { file: file.to_owned(), source })?;
    match study {
        Some(study) => Err(KeysError::InStudy { file: file.to_owned(), study }),
        None => Ok(()),
    }
}

/// The study in whose folder a file is or would be.
///
/// # Errors
/// When the current folder is not known.
pub fn study_around(file: &Path) -> io::Result<Option<PathBuf>> {
    let absolute = std::path::absolute(file)?;
    let study = absolute.ancestors().skip(1).find(|folder| folder.join("study.toml").is_file());
    Ok(study.map(Path::to_owned))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ONE: &str = "1 00112233445566778899aabbccddeeff00112233445566778899AABBCCDDEEFF\n";

    fn error(text: &str) -> String {
        Keys::parse(Path::new("keys"), text).unwrap_err().to_string()
    }

    #[test]
    fn a_line_is_a_number_and_a_key_and_nothing_else() {
        let keys = Keys::parse(Path::new("keys"), &format!("# heading\n\n {ONE}")).unwrap();
        assert_eq!(keys.of(1).unwrap().bytes()[..4], [0, 0x11, 0x22, 0x33]);
        assert_eq!((keys.nodes().collect::<Vec<_>>(), keys.of(2)), (vec![1], None));
        for bad in ["1", "1 00", "0 ".to_owned().as_str(), &ONE.replace('a', "g"), &format!("{} more", ONE.trim())] {
            assert!(error(bad).contains("line 1 of keys is no key"), "{bad}");
        }
    }

    #[test]
    fn a_key_that_is_there_twice_is_refused_with_its_lines() {
        let other = ONE.replace("ff0", "fe0");
        assert!(error(&format!("{ONE}{other}")).contains("lines 1 and 2 of keys both have a key of node 1"));
        let twin = ONE.replacen('1', "2", 1);
        assert!(error(&format!("# keys\n{ONE}{twin}")).contains("lines 2 and 3 of keys have the same key"));
    }

    #[test]
    fn new_keys_differ_are_added_once_and_are_the_users_alone() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("settings/keys");
        let (first, second) = (add_new(&file, 1).unwrap(), add_new(&file, 2).unwrap());
        assert_ne!(first, second);
        let keys = Keys::of_file(&file).unwrap();
        assert_eq!((keys.of(1), keys.of(2)), (Some(&first), Some(&second)));
        assert!(matches!(add_new(&file, 1), Err(KeysError::Exists { node: 1, .. })));
        #[cfg(unix)]
        {
            let link = folder.path().join("link");
            std::os::unix::fs::symlink(&file, &link).unwrap();
            add_new(&link, 3).unwrap();
            assert!(link.symlink_metadata().unwrap().is_symlink());
            assert_eq!(Keys::of_file(&file).unwrap().nodes().collect::<Vec<_>>(), [1, 2, 3]);
            let nowhere = folder.path().join("nowhere");
            std::os::unix::fs::symlink(folder.path().join("away/keys"), &nowhere).unwrap();
            assert!(matches!(add_new(&nowhere, 4), Err(KeysError::File { .. })));
            assert!(nowhere.symlink_metadata().unwrap().is_symlink());
        }
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
            fs::set_permissions(&file, fs::Permissions::from_mode(0o640)).unwrap();
            assert!(matches!(Keys::of_file(&file), Err(KeysError::OpenToOthers { .. })));
        }
    }

    #[test]
    fn what_is_no_text_is_refused_with_its_line_but_for_comments() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("keys");
        add_new(&file, 1).unwrap();
        let with = |more: &[u8]| {
            let text = [fs::read(&file).unwrap(), more.to_vec()].concat();
            write_private(&file, &text, true).unwrap();
        };
        with(b"# Turm f\xfcr Messung\n");
        add_new(&file, 2).unwrap();
        assert_eq!(Keys::of_file(&file).unwrap().nodes().collect::<Vec<_>>(), [1, 2]);
        with(b"3 \xff\xfe\n");
        let error = Keys::of_file(&file).unwrap_err().to_string();
        let line = fs::read(&file).unwrap().iter().filter(|byte| **byte == b'\n').count();
        assert!(error.contains(&format!("line {line} of")) && error.contains("is no key"), "{error}");
    }

    #[test]
    fn keys_lie_in_no_study() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("study.toml"), "").unwrap();
        let file = folder.path().join("results/keys");
        assert!(matches!(add_new(&file, 1), Err(KeysError::InStudy { .. })));
        assert!(!file.exists());
        // Nor are they read there.
        let elsewhere = tempfile::tempdir().unwrap();
        add_new(&elsewhere.path().join("keys"), 1).unwrap();
        fs::copy(elsewhere.path().join("keys"), folder.path().join("keys")).unwrap();
        assert!(matches!(Keys::of_file(&folder.path().join("keys")), Err(KeysError::InStudy { .. })));
    }

    #[test]
    fn no_file_is_no_keys() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Keys::of_file(&folder.path().join("keys")).unwrap().nodes().count(), 0);
    }
}
