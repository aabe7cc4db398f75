//! The archive: windows that nodes have sent, kept in the study's `archive.sqlite`.
//!
//! Windows flow in one by one, each committed to the disk before [`Archive::store`] returns, so that it may be acknowledged;
//! windows of a whole setup flow out in the order of the grid, also while others come in. Every row has a checksum, and rows are
//! counted: what has changed or is gone is left out and told ([`Damage`]), and does not end anything. The tables are open to other
//! programs (`schema.sql`).

mod asked;
mod check;
mod checksum;
mod codec;
mod damage;
mod error;
mod extract;
mod heads;
mod health;
mod loss;
mod mend;
mod migrate;
mod packed;
mod prune;
mod range;
mod read;
mod repair;
mod write;

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rusqlite::{Connection, ErrorCode, OpenFlags};

use crate::files::open_lock;

pub use check::CheckReport;
pub use damage::Damage;
pub(crate) use damage::in_words as damage_in_words;
pub use error::ArchiveError;
pub use extract::Extract;
pub use health::NodeHealth;
pub use loss::{DamagedHour, ListedLoss};
pub use packed::{Following, PackedError, PackedWindow};
pub use prune::{PruneReport, PrunedNode};
pub use range::{TimeRange, parse_moment};
pub(crate) use range::{day, moment, now_s};
pub use read::{Collected, CollectedSetup};
pub use repair::RepairReport;

/// The archive's name in the study's folder.
pub const ARCHIVE_FILE: &str = "archive.sqlite";
/// Who writes into the archive holds a lock on this file together with others; who puts another archive in its place holds it alone.
const LOCK_FILE: &str = ".belfry-archive-lock";
/// "Blfr": what tells an archive from other databases.
const APPLICATION_ID: i32 = 0x426C_6672;
/// The version of the tables.
const VERSION: i32 = 3;
/// How long another program that writes is waited for.
const BUSY: Duration = Duration::from_secs(10);
/// Time between tries of what SQLite does not wait for by itself.
const TRY_AGAIN: Duration = Duration::from_millis(10);
/// Bytes of a page: a channel of some hundred lines takes kilobytes, and several share a page.
const PAGE_BYTES: i64 = 16384;
/// Pages in the log before they are moved into the file: 4 MB, some forty windows.
const LOG_PAGES: i64 = 256;

/// A study's archive.
#[derive(Debug)]
pub struct Archive {
    file: PathBuf,
    connection: Connection,
    /// Held as long as this one may write.
    _lock: Option<File>,
}

impl Archive {
    /// Opens the archive of the study in `folder` for writing; makes it where there is none. Several programs may do so at once.
    ///
    /// # Errors
    /// [`ArchiveError`]; a file that is something else stays as it is.
    pub fn create(folder: &Path) -> Result<Self, ArchiveError> {
        Self::create_file(folder.join(ARCHIVE_FILE), lock(folder)?)
    }

    /// Makes an archive for the moment, whose windows stand elsewhere as well: none waits for the disk.
    ///
    /// # Errors
    /// [`ArchiveError`].
    pub(crate) fn create_passing(folder: &Path) -> Result<Self, ArchiveError> {
        let archive = Self::create(folder)?;
        let unsafely = archive.connection.pragma_update(None, "synchronous", "off");
        unsafely.map_err(|source| archive.failed(source))?;
        Ok(archive)
    }

    /// The same of a file of any name.
    fn create_file(file: PathBuf, lock: Option<File>) -> Result<Self, ArchiveError> {
        let mut archive = Self::connect(file, OpenFlags::default(), lock)?;
        archive.prepare().map_err(|why| archive.unopened(why))?;
        match archive.version()? {
            VERSION => {}
            found => archive.migrate(found)?,
        }
        // Only now is it known to be an archive, so that writing to it does no harm.
        archive.log_ahead().map_err(|source| archive.failed(source))?;
        Ok(archive)
    }

    /// Opens the archive of the study in `folder` for reading; `None` where there is none. One of an older version is brought up to
    /// date.
    ///
    /// # Errors
    /// [`ArchiveError`].
    pub fn open(folder: &Path) -> Result<Option<Self>, ArchiveError> {
        let Some(archive) = Self::open_any(folder)? else { return Ok(None) };
        if archive.version()? == VERSION {
            return Ok(Some(archive));
        }
        drop(archive);
        drop(Self::create(folder)?);
        Self::open_any(folder)
    }

    /// Says that the file of a study's archive is there and empty, where [`Archive::open`] finds no archive.
    ///
    /// # Errors
    /// [`ArchiveError::Empty`].
    pub(crate) fn refuse_empty(folder: &Path) -> Result<(), ArchiveError> {
        let file = folder.join(ARCHIVE_FILE);
        if file.exists() { Err(ArchiveError::absent(file)) } else { Ok(()) }
    }

    /// Opens the archive for reading, of whichever version it is.
    fn open_any(folder: &Path) -> Result<Option<Self>, ArchiveError> {
        let file = folder.join(ARCHIVE_FILE);
        // A collector that is about to make it begins with an empty file.
        if std::fs::metadata(&file).map_or(true, |metadata| metadata.is_file() && metadata.len() == 0) {
            return Ok(None);
        }
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let archive = Self::connect(file, flags, None)?;
        archive.version()?;
        Ok(Some(archive))
    }

    fn connect(file: PathBuf, flags: OpenFlags, lock: Option<File>) -> Result<Self, ArchiveError> {
        // SQLite waits for ever for somebody to write into a pipe.
        if std::fs::metadata(&file).is_ok_and(|metadata| !metadata.is_file()) {
            return Err(ArchiveError::NotAnArchive { file });
        }
        let connection = Connection::open_with_flags(&file, flags)
            .and_then(|connection| connection.busy_timeout(BUSY).map(|()| connection))
            .map_err(|why| ArchiveError::Database { file: file.clone(), why })?;
        Ok(Self { file, connection, _lock: lock })
    }

    /// Sets up a fresh archive. Whether it is fresh is asked within the transaction that makes its tables: another program may make them
    /// at the same time.
    fn prepare(&mut self) -> rusqlite::Result<()> {
        let is_fresh = |connection: &Connection| {
            let count = connection.query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get::<_, i64>(0));
            count.map(|tables| tables == 0)
        };
        if !is_fresh(&self.connection)? {
            return Ok(());
        }
        // Before there is anything in it; later they have no effect.
        self.connection.pragma_update(None, "page_size", PAGE_BYTES)?;
        self.connection.pragma_update(None, "auto_vacuum", "incremental")?;
        let transaction = self.connection.transaction_with_behavior(rusqlite::TransactionBehavior::Immediate)?;
        if is_fresh(&transaction)? {
            transaction.execute_batch(include_str!("schema.sql"))?;
            transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
            transaction.pragma_update(None, "user_version", VERSION)?;
        }
        transaction.commit()
    }

    /// The version of its tables, which is known here.
    fn version(&self) -> Result<i32, ArchiveError> {
        let asked = |query: &str| {
            let value = self.connection.query_row(query, [], |row| row.get::<_, i32>(0));
            value.map_err(|why| self.unopened(why))
        };
        if asked("PRAGMA application_id")? != APPLICATION_ID {
            return Err(ArchiveError::NotAnArchive { file: self.file.clone() });
        }
        let version = asked("PRAGMA user_version")?;
        if !(1..=VERSION).contains(&version) {
            return Err(ArchiveError::Version { file: self.file.clone(), found: version });
        }
        // Which tables there are is on the first page; so far nothing has asked for it.
        asked("SELECT count(*) FROM sqlite_schema")?;
        Ok(version)
    }

    /// Has changes written into a log first: others can read meanwhile, and a commit is on the disk when it returns.
    fn log_ahead(&self) -> rusqlite::Result<()> {
        let give_up = Instant::now() + BUSY;
        loop {
            let mode =
                self.connection.pragma_update_and_check(None, "journal_mode", "wal", |row| row.get::<_, String>(0));
            match mode {
                Ok(mode) if mode == "wal" => break,
                // SQLite does not wait here while another program has the archive.
                Ok(_) => {}
                Err(error)
                    if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy) && Instant::now() < give_up => {}
                Err(error) => return Err(error),
            }
            // Where the file system knows no such log, it goes without.
            if Instant::now() >= give_up {
                break;
            }
            std::thread::sleep(TRY_AGAIN);
        }
        self.connection.pragma_update_and_check(None, "wal_autocheckpoint", LOG_PAGES, |_| Ok(()))?;
        self.connection.pragma_update(None, "synchronous", "full")
    }

    /// Sets how long another program that writes is waited for before [`Archive::store`] fails.
    ///
    /// # Errors
    /// Where the database refuses.
    pub fn wait_for_others(&self, longest: Duration) -> Result<(), ArchiveError> {
        self.connection.busy_timeout(longest).map_err(|source| self.failed(source))
    }

    /// Lets the file grow no further than so many bytes while it is open here; what does not fit fails as on a full disk.
    ///
    /// # Errors
    /// Where the database refuses.
    pub fn limit_bytes(&self, most: u64) -> Result<(), ArchiveError> {
        let limit = || {
            let page: i64 = self.connection.pragma_query_value(None, "page_size", |row| row.get(0))?;
            let pages = (i64::try_from(most).unwrap_or(i64::MAX) / page.max(1)).max(1);
            self.connection.pragma_update_and_check(None, "max_page_count", pages, |_| Ok(()))
        };
        limit().map_err(|source| self.failed(source))
    }

    /// Why what every use begins with has failed.
    fn unopened(&self, why: rusqlite::Error) -> ArchiveError {
        if why.sqlite_error_code() != Some(ErrorCode::DatabaseCorrupt) {
            return self.failed(why);
        }
        let file = self.file.clone();
        match repair::cut(&file) {
            Some([has, of]) => ArchiveError::Cut { file, has, of },
            None => ArchiveError::Unopenable { file, why },
        }
    }

    fn failed(&self, source: rusqlite::Error) -> ArchiveError {
        match source.sqlite_error_code() {
            Some(ErrorCode::NotADatabase) => ArchiveError::NotAnArchive { file: self.file.clone() },
            Some(ErrorCode::DatabaseCorrupt) => self.damaged(source.to_string()),
            _ => ArchiveError::Database { file: self.file.clone(), why: source },
        }
    }

    fn damaged(&self, what: impl Into<String>) -> ArchiveError {
        ArchiveError::Damaged { file: self.file.clone(), what: what.into() }
    }

    /// The file.
    pub fn file(&self) -> &Path {
        &self.file
    }
}

/// Takes the lock of those who write into the archive of a folder.
fn lock(folder: &Path) -> Result<Option<File>, ArchiveError> {
    let file = lock_file(folder)?;
    match file.try_lock_shared() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Err(ArchiveError::InUse { file: folder.join(ARCHIVE_FILE) }),
        // Some network file systems know no locks.
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

fn lock_file(folder: &Path) -> Result<File, ArchiveError> {
    // Studies whose archives are links to one have one lock: beside it.
    let real = std::fs::canonicalize(folder.join(ARCHIVE_FILE)).ok();
    let path = real.as_deref().and_then(Path::parent).unwrap_or(folder).join(LOCK_FILE);
    open_lock(&path).map_err(|source| ArchiveError::Write { file: path, source })
}

#[cfg(test)]
mod tests;
