//! Files that appear whole or not at all.
//!
//! Bytes flow in; a file flows out under its name once all of them are on disk. Until then they lie beside it under another
//! name. That file is removed when writing fails, and by [`remove_unfinished`] when the program is interrupted. A [`FolderLock`] keeps
//! programs apart that read a file, change it and write it.

use std::collections::BTreeSet;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tempfile::{Builder, NamedTempFile};

/// Bytes gathered before they are written: recordings come in small pieces.
const BUFFER: usize = 1 << 20;
/// How the name of an unfinished file ends.
pub(crate) const UNFINISHED_SUFFIX: &str = ".partial";

/// How it begins.
const UNFINISHED_PREFIX: &str = ".belfry-";
/// Nobody writes at one file for so long: it was left behind by a program that was killed.
const LEFT_BEHIND: Duration = Duration::from_secs(24 * 60 * 60);

/// The name of a folder's lock.
pub(crate) const LOCK_FILE: &str = ".belfry-lock";

/// Unfinished files of this program.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// A file that is being written. [`WholeFile::finish`] puts it in its place; dropped before that, it leaves nothing behind.
#[derive(Debug)]
pub struct WholeFile {
    // Dropped before its listing, so that an interruption in between still finds it.
    file: BufWriter<NamedTempFile>,
    listing: Listing,
    target: PathBuf,
}

impl WholeFile {
    /// Begins a file that will replace what is at `path`. Folders on the way are made. Where `path` is a symbolic link, what
    /// it points to is replaced and the link stays.
    ///
    /// # Errors
    /// When the folder cannot be made or written to.
    pub fn create(path: &Path) -> io::Result<Self> {
        Self::begun(fs::canonicalize(path).unwrap_or_else(|_| path.to_owned()))
    }

    /// The same, but a symbolic link at `path` is replaced itself: a folder from someone else may have one that points to a file of the
    /// user's.
    ///
    /// # Errors
    /// As [`WholeFile::create`].
    pub fn create_anew(path: &Path) -> io::Result<Self> {
        Self::begun(path.to_owned())
    }

    fn begun(target: PathBuf) -> io::Result<Self> {
        let folder = folder_of(&target);
        fs::create_dir_all(folder)?;
        let file = unfinished_file(folder, ANY_NEW)?;
        let listing = Listing::of(file.path());
        Ok(Self { file: BufWriter::with_capacity(BUFFER, file), listing, target })
    }

    /// Where it is until it is finished, for what writes it by itself.
    pub(crate) fn unfinished_path(&self) -> &Path {
        self.file.get_ref().path()
    }

    fn with_all(mut self, bytes: &[u8]) -> io::Result<()> {
        self.write_all(bytes)?;
        self.finish()
    }

    /// Puts the file in its place, once it is on disk.
    ///
    /// # Errors
    /// When the disk is full, or what is there cannot be replaced.
    pub fn finish(self) -> io::Result<()> {
        let Self { file, listing, target } = self;
        let file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
        // Who may read it stays as it was.
        if let Some(before) = fs::symlink_metadata(&target).ok().filter(fs::Metadata::is_file) {
            file.as_file().set_permissions(before.permissions())?;
        }
        file.as_file().sync_all()?;
        file.persist(&target)?;
        drop(listing);
        sync_folder(folder_of(&target))
    }
}

impl Write for WholeFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Opens a file to read it. A pipe or a device in its place, which may never end, is refused.
///
/// # Errors
/// When there is none, it cannot be read, or it is something else.
pub fn open_plain(path: &Path) -> io::Result<File> {
    if !fs::metadata(path)?.is_file() {
        return Err(io::Error::new(
            ErrorKind::InvalidInput,
            "it is a folder, a pipe or a device, where a file was expected",
        ));
    }
    File::open(path)
}

/// All bytes of a file, as [`open_plain`] opens it.
///
/// # Errors
/// As [`open_plain`].
pub fn read_plain(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open_plain(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// Writes a file whole, in place of what was there.
///
/// # Errors
/// As [`WholeFile::create`] and [`WholeFile::finish`].
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    WholeFile::create(path)?.with_all(bytes)
}

/// The same, but a symbolic link there is replaced itself.
///
/// # Errors
/// As [`write_whole`].
pub fn write_anew(path: &Path, bytes: &[u8]) -> io::Result<()> {
    WholeFile::create_anew(path)?.with_all(bytes)
}

/// Writes a file whole where there is none yet.
///
/// # Errors
/// As [`write_whole`], and where there is one.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_of_mode(path, bytes, ANY_NEW, false)
}

/// Writes a file that only the user can read, whole or not at all. Without `replaces` there must be none.
///
/// # Errors
/// When it cannot be written.
pub fn write_private(path: &Path, bytes: &[u8], replaces: bool) -> io::Result<()> {
    write_of_mode(path, bytes, ONLY_THE_USERS, replaces)
}

fn write_of_mode(path: &Path, bytes: &[u8], mode: u32, replaces: bool) -> io::Result<()> {
    let folder = folder_of(path);
    let mut file = unfinished_file(folder, mode)?;
    let listing = Listing::of(file.path());
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    if replaces {
        file.persist(path)?;
    } else {
        file.persist_noclobber(path)?;
    }
    drop(listing);
    sync_folder(folder)
}

/// Takes away the links in a folder, and the folder where it is one: what is written there replaces them, and not what they lead to.
///
/// # Errors
/// When a link cannot be removed.
pub fn without_links(folder: &Path) -> io::Result<()> {
    let Ok(metadata) = fs::symlink_metadata(folder) else { return Ok(()) };
    if metadata.is_symlink() {
        return fs::remove_file(folder);
    }
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_symlink() {
            fs::remove_file(entry.path())?;
        }
    }
    Ok(())
}

/// A folder of which this program alone changes what it has read, until this is dropped or the program ends.
#[derive(Debug)]
pub struct FolderLock {
    // The system takes the lock back when the file is closed.
    _file: File,
}

impl FolderLock {
    /// Waits until no other program has the folder; `on_wait` is called where that is not at once.
    ///
    /// # Errors
    /// When nothing can be written in the folder.
    pub fn take(folder: &Path, on_wait: impl FnOnce()) -> io::Result<Self> {
        Self::on(Self::file(folder)?, on_wait)
    }

    /// The same by another file than a folder's own, as [`open_lock`] opens it.
    ///
    /// # Errors
    /// When it cannot be waited for.
    pub(crate) fn on(file: File, on_wait: impl FnOnce()) -> io::Result<Self> {
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                on_wait();
                file.lock()?;
            }
            // Some network file systems know no locks, and have more than one word for that; without one it goes as before.
            Err(TryLockError::Error(_)) => {}
        }
        Ok(Self { _file: file })
    }

    /// The same without waiting: `None` where another program has the folder.
    ///
    /// # Errors
    /// As [`FolderLock::take`].
    pub fn at_once(folder: &Path) -> io::Result<Option<Self>> {
        Self::file(folder).map(Self::on_at_once)
    }

    /// The same by another file.
    pub(crate) fn on_at_once(file: File) -> Option<Self> {
        let is_taken = matches!(file.try_lock(), Err(TryLockError::WouldBlock));
        (!is_taken).then_some(Self { _file: file })
    }

    fn file(folder: &Path) -> io::Result<File> {
        open_lock(&folder.join(LOCK_FILE))
    }
}

/// Opens a file that programs lock, and makes it where there is none. It is never removed: another program may just have opened it.
///
/// # Errors
/// When it cannot be made, or is none: a link in a folder from someone else may lead anywhere, and a pipe waits for ever.
pub(crate) fn open_lock(path: &Path) -> io::Result<File> {
    if fs::symlink_metadata(path).is_ok_and(|metadata| !metadata.is_file()) {
        let said = format!("{} is a link or something else, where a file was expected: remove it", path.display());
        return Err(io::Error::new(ErrorKind::InvalidInput, said));
    }
    match File::options().create(true).truncate(false).write(true).open(path) {
        // Another user's, in a folder that both may write to: it can be locked all the same.
        Err(error) if error.kind() == ErrorKind::PermissionDenied => File::open(path).map_err(|_| error),
        opened => opened,
    }
}

/// The file that a symbolic link leads to, so that it is changed and the link stays; any other path as it is.
///
/// # Errors
/// Where a link leads nowhere: what it led to may be away for a while.
pub(crate) fn behind_links(path: &Path) -> io::Result<PathBuf> {
    match fs::canonicalize(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => match fs::symlink_metadata(path) {
            Ok(_) => Err(io::Error::new(ErrorKind::NotFound, "it is a link that leads to no file")),
            Err(_) => Ok(path.to_owned()),
        },
        found => found,
    }
}

/// Makes a folder where there is none, and makes sure that files can be written in it.
///
/// # Errors
/// When it cannot be made, or nothing can be written there.
pub fn ready_folder(folder: &Path) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    unfinished_file(folder, ANY_NEW)?.close()
}

/// Removes the files that are being written; for a program that is interrupted and about to end.
pub fn remove_unfinished() {
    for path in std::mem::take(&mut *unfinished()) {
        // The program ends in any case, and there is nobody to tell.
        let _ = fs::remove_file(path);
    }
}

/// Notes an unfinished file for as long as it lives.
#[derive(Debug)]
struct Listing(PathBuf);

impl Listing {
    fn of(path: &Path) -> Self {
        unfinished().insert(path.to_owned());
        Self(path.to_owned())
    }
}

impl Drop for Listing {
    fn drop(&mut self) {
        unfinished().remove(&self.0);
    }
}

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // A set of paths is sound after a panic as well.
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The permissions of any new file, of which the system takes what the user wants taken.
const ANY_NEW: u32 = 0o666;
/// Those of a file that nobody else may read, not for a moment.
const ONLY_THE_USERS: u32 = 0o600;

/// An empty file of a name of its own, with these permissions where the system has such.
fn unfinished_file(folder: &Path, mode: u32) -> io::Result<NamedTempFile> {
    remove_left_behind(folder);
    let mut builder = Builder::new();
    builder.prefix(UNFINISHED_PREFIX).suffix(UNFINISHED_SUFFIX);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(mode));
    #[cfg(not(unix))]
    let _ = mode;
    builder.tempfile_in(folder)
}

/// Removes unfinished files of programs that were killed long ago. What cannot be removed does no harm.
fn remove_left_behind(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let is_unfinished =
            name.to_str().is_some_and(|name| name.starts_with(UNFINISHED_PREFIX) && name.ends_with(UNFINISHED_SUFFIX));
        let is_old = |metadata: fs::Metadata| {
            metadata.is_file()
                && metadata.modified().is_ok_and(|then| then.elapsed().is_ok_and(|age| age > LEFT_BEHIND))
        };
        if is_unfinished && entry.metadata().is_ok_and(is_old) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// The folder that a file stands in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    }
}

/// Puts a folder's new names on disk, where the system can.
pub(crate) fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(not(unix)) {
        return Ok(());
    }
    match File::open(folder)?.sync_all() {
        // Some network file systems cannot.
        Err(error) if matches!(error.kind(), ErrorKind::InvalidInput | ErrorKind::Unsupported) => Ok(()),
        synced => synced,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_new_file_is_whole_and_takes_the_place_of_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("study.toml");
        write_new(&path, b"new").unwrap();
        assert_eq!(write_new(&path, b"other").unwrap_err().kind(), ErrorKind::AlreadyExists);
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
    }

    #[cfg(unix)]
    #[test]
    fn links_in_a_folder_and_a_folder_that_is_one_are_taken_away_and_what_they_lead_to_stays() {
        use std::os::unix::fs::symlink;

        let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let (file, results) = (elsewhere.path().join("mine.csv"), folder.path().join("export"));
        fs::write(&file, "mine").unwrap();
        without_links(&results).unwrap();
        fs::create_dir(&results).unwrap();
        fs::write(results.join("psd.csv"), "own").unwrap();
        symlink(&file, results.join("modes.csv")).unwrap();
        without_links(&results).unwrap();
        assert!(results.join("modes.csv").symlink_metadata().is_err() && results.join("psd.csv").exists());
        symlink(elsewhere.path(), folder.path().join("linked")).unwrap();
        without_links(&folder.path().join("linked")).unwrap();
        assert!(folder.path().join("linked").symlink_metadata().is_err());
        assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
    }

    #[cfg(unix)]
    #[test]
    fn a_lock_that_is_a_link_makes_no_file_where_it_leads() {
        let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let target = elsewhere.path().join("made");
        std::os::unix::fs::symlink(&target, folder.path().join(LOCK_FILE)).unwrap();
        let error = FolderLock::take(folder.path(), || {}).unwrap_err().to_string();
        assert!(error.contains(LOCK_FILE) && error.contains("remove it"), "{error}");
        assert!(!target.exists());
    }

    #[test]
    fn a_file_replaces_what_was_there_only_when_it_is_finished() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new").join("modes.json");
        write_whole(&path, b"old").unwrap();
        let mut file = WholeFile::create(&path).unwrap();
        file.write_all(b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"old");
        file.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        let abandoned = WholeFile::create(&path).unwrap();
        assert_eq!(names(path.parent().unwrap()).len(), 2);
        drop(abandoned);
        assert_eq!(names(path.parent().unwrap()), ["modes.json"]);
    }

    #[test]
    fn an_interrupted_program_leaves_no_unfinished_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = WholeFile::create(&folder.path().join("recording.npy")).unwrap();
        let unfinished_path = file.file.get_ref().path().to_owned();
        assert!(unfinished().contains(&unfinished_path) && unfinished_path.exists());
        // Not all of them: other tests of this program write files at the same time.
        fs::remove_file(&unfinished_path).unwrap();
        drop(file);
        assert!(!unfinished().contains(&unfinished_path));
        assert!(names(folder.path()).is_empty());
    }

    /// A program that is killed cannot remove its file; one that may still be writing keeps it.
    #[test]
    fn unfinished_files_of_long_ago_are_removed_and_no_others() {
        let folder = tempfile::tempdir().unwrap();
        let make = |name: &str, age: Duration| {
            let file = File::create(folder.path().join(name)).unwrap();
            file.set_modified(std::time::SystemTime::now() - age).unwrap();
        };
        make(".belfry-abcdef.partial", LEFT_BEHIND + Duration::from_secs(60));
        make(".belfry-ghijkl.partial", Duration::from_secs(60));
        make("own.partial", 3 * LEFT_BEHIND);
        make(".belfry-lock", 3 * LEFT_BEHIND);
        write_whole(&folder.path().join("modes.json"), b"new").unwrap();
        assert_eq!(names(folder.path()), [".belfry-ghijkl.partial", ".belfry-lock", "modes.json", "own.partial"]);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link_and_permissions_are_those_of_a_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real.toml"), folder.path().join("study.toml"));
        fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink("real.toml", &link).unwrap();
        write_whole(&link, b"new").unwrap();
        assert!(link.symlink_metadata().unwrap().is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"new");
        let plain = folder.path().join("plain");
        fs::write(&plain, "").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&real), mode(&plain));
        let new = folder.path().join("new");
        write_whole(&new, b"").unwrap();
        assert_eq!(mode(&new), mode(&plain));
    }

    #[cfg(unix)]
    #[test]
    fn who_may_read_a_file_stays_and_a_link_among_results_is_not_followed() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (own, result) = (folder.path().join("own.txt"), folder.path().join("fits.svg"));
        fs::write(&own, "mine").unwrap();
        fs::set_permissions(&own, fs::Permissions::from_mode(0o600)).unwrap();
        write_whole(&own, b"changed").unwrap();
        assert_eq!(fs::metadata(&own).unwrap().permissions().mode() & 0o777, 0o600);
        std::os::unix::fs::symlink(&own, &result).unwrap();
        write_anew(&result, b"<svg/>").unwrap();
        assert_eq!((fs::read(&own).unwrap(), fs::read(&result).unwrap()), (b"changed".to_vec(), b"<svg/>".to_vec()));
        assert!(!result.symlink_metadata().unwrap().is_symlink());
    }

    #[test]
    fn one_after_the_other_has_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let first = FolderLock::take(folder.path(), || panic!("nobody has it")).unwrap();
        let (waits, waiting) = std::sync::mpsc::channel();
        let path = folder.path().to_owned();
        let second = std::thread::spawn(move || {
            let lock = FolderLock::take(&path, || waits.send("waits").unwrap()).unwrap();
            waits.send("has it").unwrap();
            drop(lock);
        });
        assert_eq!(waiting.recv().unwrap(), "waits");
        assert!(FolderLock::at_once(folder.path()).unwrap().is_none());
        let has_it = waiting.recv_timeout(std::time::Duration::from_millis(200));
        assert!(has_it.is_err(), "the first has it still");
        drop(first);
        assert_eq!(waiting.recv().unwrap(), "has it");
        second.join().unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_is_noticed() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("results"), "a file").unwrap();
        assert!(ready_folder(&folder.path().join("results")).is_err());
        ready_folder(&folder.path().join("others")).unwrap();
        assert!(names(&folder.path().join("others")).is_empty());
    }
}
