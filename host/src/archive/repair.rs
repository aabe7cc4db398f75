//! Repair: what can be saved goes into a new archive, which takes the place of the damaged one. That stays under another name.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use belfry_shared::time::HostTime;
use rusqlite::types::Value;
use rusqlite::{Connection, OpenFlags};
use serde::Serialize;

use super::check::lost_in;
use super::checksum::{CHANNEL_COLUMNS, Kind, WINDOW_COLUMNS, hour_of, seal, seal_window};
use super::damage::Damage;
use super::loss::list_damaged;
use super::mend::Values;
use super::{ARCHIVE_FILE, Archive, ArchiveError, PAGE_BYTES, VERSION, lock_file};
use crate::files::{UNFINISHED_SUFFIX, sync_folder};

/// What a repair has done.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RepairReport {
    /// The archive.
    pub archive: PathBuf,
    /// Where the damaged one is now; none where it was sound, and stayed.
    pub kept_as: Option<PathBuf>,
    /// Windows that are in the archive now.
    pub windows: u64,
    /// Rows of which one bit was flipped, and is right again.
    pub mended: u64,
    /// What could not be saved.
    pub lost: Vec<Damage>,
}

impl Archive {
    /// Writes what can be saved of the archive of the study in `folder` into a new one. The old one is kept under another name. One
    /// that is sound stays.
    ///
    /// # Errors
    /// Where there is none, another program has it open for writing, it cannot be opened at all, or there is no room for another. The archive is then as
    /// it was.
    pub fn repair(folder: &Path) -> Result<RepairReport, ArchiveError> {
        let file = folder.join(ARCHIVE_FILE);
        if !file.exists() {
            return Err(ArchiveError::Absent { file });
        }
        let lock = lock_file(folder)?;
        // Some network file systems know no locks.
        if let Err(fs::TryLockError::WouldBlock) = lock.try_lock() {
            return Err(ArchiveError::InUse { file });
        }
        let checked = match Self::check(folder) {
            Err(error @ (ArchiveError::Unopenable { .. } | ArchiveError::NotAnArchive { .. })) => {
                return Self::repair_first_page(folder, error);
            }
            checked => checked?,
        };
        let checked = if checked.version == VERSION {
            checked
        } else {
            // Without checksums damage cannot be told from data; with them, what comes of it can.
            Self::create_file(file.clone(), None)?;
            Self::check(folder)?
        };
        if checked.is_sound {
            let windows = checked.sound_windows;
            return Ok(RepairReport { archive: file, kept_as: None, windows, mended: 0, lost: Vec::new() });
        }
        Self::repair_from(&folder.join(ARCHIVE_FILE), folder)
    }

    /// Repairs an archive whose first page is damaged, so that it does not open, or not as an archive. That page says where its tables begin. They begin where those of any archive do that
    /// was made with these tables: the first page of a fresh one takes its place in a copy, and checksums show whether that was right.
    fn repair_first_page(folder: &Path, unopenable: ArchiveError) -> Result<RepairReport, ArchiveError> {
        let file = folder.join(ARCHIVE_FILE);
        let copy = folder.join(format!(".belfry-copy-{ARCHIVE_FILE}{UNFINISHED_SUFFIX}"));
        let failed = |source| ArchiveError::Write { file: copy.clone(), source };
        remove(&copy)?;
        let with_page = fresh_first_page(folder)?.and_then(|page| {
            fs::copy(&file, &copy)?;
            // What a collector that was killed has left in its log is on no page yet.
            let log = |path: &Path| PathBuf::from(format!("{}-wal", path.display()));
            match fs::copy(log(&file), log(&copy)) {
                Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
                _ => {}
            }
            write_first_page(&copy, page)
        });
        let repaired = match with_page.map_err(failed) {
            Ok(()) => Self::repair_from(&copy, folder),
            Err(error) => Err(error),
        };
        // What has failed before is what counts.
        let removed = remove(&copy);
        match repaired {
            // The tables began elsewhere.
            Err(ArchiveError::Unopenable { .. } | ArchiveError::NothingSaved { .. } | ArchiveError::Damaged { .. }) => {
                Err(unopenable)
            }
            repaired => repaired.and_then(|repaired| removed.map(|()| repaired)),
        }
    }

    /// Puts what can be saved of `source` in the place of the archive.
    fn repair_from(source: &Path, folder: &Path) -> Result<RepairReport, ArchiveError> {
        let file = folder.join(ARCHIVE_FILE);
        let old = Self::connect(source.to_owned(), OpenFlags::default(), None)?;
        old.version()?;
        // So that the old file is all there is of it. Where that fails, its log is kept beside it.
        let _ = old.connection.pragma_update_and_check(None, "wal_checkpoint", "truncate", |_| Ok(()));
        let new_file = folder.join(format!(".belfry-{ARCHIVE_FILE}{UNFINISHED_SUFFIX}"));
        remove(&new_file)?;
        let mut new = Self::create_file(new_file.clone(), None)?;
        let saved = old.save_into(&mut new.connection).and_then(|saved| {
            // The new file is then all there is of it.
            new.connection.pragma_update_and_check(None, "journal_mode", "delete", |_| Ok(()))?;
            Ok(saved)
        });
        let (windows, mended, lost) = match saved {
            Ok(saved) => saved,
            Err(source) => {
                let failed = new.failed(source);
                drop(new);
                // The failure is what counts.
                let _ = remove(&new_file);
                return Err(failed);
            }
        };
        drop((new, old));
        if source != file && windows == 0 {
            remove(&new_file)?;
            return Err(ArchiveError::NothingSaved { file });
        }
        let kept_as = swap(&new_file, &file)?;
        Ok(RepairReport { archive: file, kept_as: Some(kept_as), windows, mended, lost })
    }

    /// Copies all rows that are sound, or can be mended; windows copied, rows mended, and what is lost.
    fn save_into(&self, new: &mut Connection) -> rusqlite::Result<(u64, u64, Vec<Damage>)> {
        let transaction = new.transaction()?;
        let (mut windows, mut mended, mut lost) = (0, 0, Vec::new());
        for kind in [Kind::Asked, Kind::Service, Kind::Loss] {
            let (table, columns) = (kind.name(), kind.columns());
            for id in self.row_ids(table) {
                match self.row(table, columns, id) {
                    Some((values, was_mended)) => {
                        Values::insert(&values.0, table, columns, true, &transaction)?;
                        seal(&transaction, kind, id)?;
                        mended += u64::from(was_mended);
                    }
                    None => lost.push(Damage::row(table, id, "it does not match its checksum")),
                }
            }
        }
        let mut saved: BTreeMap<(String, i64), u64> = BTreeMap::new();
        let mut damaged = Vec::new();
        for id in self.window_ids() {
            match self.whole_window(id) {
                Some((head, channels, was_mended)) => {
                    if !write_window(&transaction, id, &head, &channels)? {
                        continue;
                    }
                    if let (Some(Value::Text(setup)), Some(Value::Integer(start_us))) = (head.get(4), head.get(7)) {
                        *saved.entry((setup.clone(), hour_of(*start_us))).or_default() += 1;
                    }
                    windows += 1;
                    mended += u64::from(was_mended);
                }
                None => {
                    if let Ok(Some(head)) = self.head(id) {
                        damaged.push(head.window.name);
                        lost.push(head.damaged("it does not match its checksum"));
                    }
                }
            }
        }
        let named = lost.iter().filter_map(|damage| damage.start_s.map(|start_s| hour_of((start_s * 1e6) as i64)));
        let named: Vec<i64> = named.collect();
        // What is gone without a trace is known from the tallies.
        for setup in self.setups().unwrap_or_default() {
            for (hour, tally) in self.window_tallies(&setup)?.0 {
                let seen = saved.get(&(setup.clone(), hour)).copied().unwrap_or(0)
                    + named.iter().filter(|&&other| other == hour).count() as u64;
                if tally.entries > seen {
                    lost.push(lost_in(&setup, hour, tally.entries - seen));
                }
            }
        }
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        list_damaged(&transaction, &damaged, HostTime::since_epoch(now))?;
        transaction.commit()?;
        Ok((windows, mended, lost))
    }

    /// Numbers of the rows of a small table that can be reached.
    pub(super) fn row_ids(&self, table: &str) -> Vec<i64> {
        let mut ids = Vec::new();
        for order in ["id", "id DESC"] {
            let Ok(mut statement) = self.connection.prepare(&format!("SELECT id FROM {table} ORDER BY {order}")) else {
                continue;
            };
            let Ok(mut rows) = statement.query([]) else { continue };
            while let Ok(Some(row)) = rows.next() {
                ids.extend(row.get::<_, i64>(0));
            }
        }
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// A row that is sound, or has been mended, which is said.
    pub(super) fn row(&self, table: &str, columns: &str, id: i64) -> Option<(Values, bool)> {
        let query = format!("SELECT {columns}, checksum FROM {table} WHERE id = ?1");
        let read = self.connection.prepare_cached(&query).and_then(|mut statement| {
            statement.query_row([id], |row| Ok((Values::read(row, columns)?, row.get::<_, i64>("checksum")?)))
        });
        let (mut values, stored) = read.ok()?;
        if values.checksum() == stored {
            return Some((values, false));
        }
        values.mend(stored).then_some((values, true))
    }

    /// The same of a window, and of its channels one after the other.
    fn whole_window(&self, id: i64) -> Option<(Vec<Value>, Vec<Value>, bool)> {
        let query = format!("SELECT {WINDOW_COLUMNS}, checksum FROM window WHERE id = ?1");
        let read = self.connection.prepare_cached(&query).and_then(|mut statement| {
            statement.query_row([id], |row| Ok((Values::read(row, WINDOW_COLUMNS)?, row.get::<_, i64>("checksum")?)))
        });
        let (Values(mut values), stored) = read.ok()?;
        let head = values.len();
        let query = format!("SELECT {CHANNEL_COLUMNS} FROM channel WHERE window = ?1 ORDER BY channel");
        let mut statement = self.connection.prepare_cached(&query).ok()?;
        let mut rows = statement.query([id]).ok()?;
        while let Some(row) = rows.next().ok()? {
            values.extend(Values::read(row, CHANNEL_COLUMNS).ok()?.0);
        }
        let mut values = Values(values);
        let was_mended = values.checksum() != stored;
        if was_mended && !values.mend(stored) {
            return None;
        }
        let channels = values.0.split_off(head);
        Some((values.0, channels, was_mended))
    }
}

/// Writes a window with its channels; `false` where it is there already.
pub(super) fn write_window(
    connection: &Connection,
    id: i64,
    head: &[Value],
    channels: &[Value],
) -> rusqlite::Result<bool> {
    match Values::insert(head, "window", WINDOW_COLUMNS, true, connection) {
        // A damaged index lets a window in a second time.
        Err(error) if error.sqlite_error_code() == Some(rusqlite::ErrorCode::ConstraintViolation) => return Ok(false),
        inserted => inserted?,
    }
    for channel in channels.chunks(CHANNEL_COLUMNS.split(", ").count()) {
        Values::insert(channel, "channel", CHANNEL_COLUMNS, false, connection)?;
    }
    seal_window(connection, id)?;
    Ok(true)
}

/// The first page of an archive that has just been made.
fn fresh_first_page(folder: &Path) -> Result<io::Result<Vec<u8>>, ArchiveError> {
    let file = folder.join(format!(".belfry-fresh-{ARCHIVE_FILE}{UNFINISHED_SUFFIX}"));
    remove(&file)?;
    let fresh = Archive::create_file(file.clone(), None)?;
    // All of it is then in the file.
    let closed = fresh.connection.pragma_update_and_check(None, "journal_mode", "delete", |_| Ok(()));
    closed.map_err(|source| fresh.failed(source))?;
    drop(fresh);
    let page = fs::read(&file).map(|mut bytes| {
        bytes.truncate(PAGE_BYTES as usize);
        bytes
    });
    remove(&file)?;
    Ok(page)
}

/// Puts a first page into a database, with the count of its pages, none of which are free (SQLite's file format, section 1.3).
fn write_first_page(file: &Path, mut page: Vec<u8>) -> io::Result<()> {
    const PAGES: std::ops::Range<usize> = 28..32;
    const FREE: std::ops::Range<usize> = 32..40;
    let mut database = File::options().write(true).open(file)?;
    let pages = u32::try_from(database.metadata()?.len() / PAGE_BYTES as u64).unwrap_or(u32::MAX);
    if let Some(place) = page.get_mut(PAGES) {
        place.copy_from_slice(&pages.to_be_bytes());
    }
    if let Some(place) = page.get_mut(FREE) {
        place.fill(0);
    }
    database.write_all(&page)
}

/// Puts the new archive in the place of the old one, which gets another name. At no moment is there neither.
fn swap(new: &Path, file: &Path) -> Result<PathBuf, ArchiveError> {
    let fail = |path: &Path| {
        let path = path.to_owned();
        move |source| ArchiveError::Write { file: path, source }
    };
    let kept = free_name(file);
    // A second name first; a file system without such names has none for a moment.
    fs::hard_link(file, &kept).or_else(|_| fs::rename(file, &kept)).map_err(fail(&kept))?;
    // A log that is left belongs to the old one, and must not be taken for that of the new.
    for ending in ["-wal", "-shm"] {
        let with = |path: &Path| PathBuf::from(format!("{}{ending}", path.display()));
        match fs::rename(with(file), with(&kept)) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(fail(&with(&kept))(error)),
            _ => {}
        }
    }
    // Who may read it stays as it was.
    let before = fs::metadata(&kept).map_err(fail(&kept))?;
    fs::set_permissions(new, before.permissions()).map_err(fail(new))?;
    fs::rename(new, file).map_err(fail(file))?;
    let folder = file.parent().unwrap_or(Path::new("."));
    sync_folder(if folder == Path::new("") { Path::new(".") } else { folder }).map_err(fail(file))?;
    Ok(kept)
}

/// A name beside the archive that says what it is, and that nothing has.
fn free_name(file: &Path) -> PathBuf {
    let now = humantime::format_rfc3339_seconds(SystemTime::now()).to_string().replace(['-', ':'], "");
    let name = |count: u32| {
        let more = if count == 0 { String::new() } else { format!("-{count}") };
        file.with_file_name(format!("archive.damaged-{now}{more}.sqlite"))
    };
    (0..).map(name).find(|name| !name.exists()).unwrap_or_else(|| name(0))
}

fn remove(file: &Path) -> Result<(), ArchiveError> {
    for ending in ["", "-wal", "-shm", "-journal"] {
        let path = PathBuf::from(format!("{}{ending}", file.display()));
        match fs::remove_file(&path) {
            Err(source) if source.kind() != ErrorKind::NotFound => {
                return Err(ArchiveError::Write { file: path, source });
            }
            _ => {}
        }
    }
    Ok(())
}
