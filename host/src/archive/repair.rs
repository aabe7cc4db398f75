//! Repair: what can be saved goes into a new archive, which takes the place of the damaged one. That stays under another name.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use belfry_shared::message::MAX_CHANNELS;
use belfry_shared::time::HostTime;
use rusqlite::types::Value;
use rusqlite::{Connection, OpenFlags};
use serde::Serialize;

use super::asked::unknown_settings;
use super::check::lost_in;
use super::checksum::{CHANNEL_COLUMNS, Kind, Tally, WINDOW_COLUMNS, hour_of, seal, seal_window};
use super::damage::Damage;
use super::loss::{DamagedHour, list_damaged, remember};
use super::mend::Values;
use super::{ARCHIVE_FILE, Archive, ArchiveError, PAGE_BYTES, VERSION, lock_file};
use crate::files::{UNFINISHED_SUFFIX, folder_of, sync_folder};

/// Where the first page says how large pages are, how often the file was changed, how many pages it has, which of them are free, and at which of
/// the changes they were counted.
const PAGE_SIZE: Range<usize> = 16..18;
const CHANGES: Range<usize> = 24..28;
const PAGES: Range<usize> = 28..32;
const FREE: Range<usize> = 32..40;
const COUNTED_AT: Range<usize> = 92..96;

/// How often rows are looked for behind those that cannot be read, and over how many at once: pages between two that are gone have more.
const MOST_TRIES: u32 = 1_000_000;
const LONGEST_STEP: i64 = 16;

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
        if !file.exists() || fs::metadata(&file).is_ok_and(|metadata| metadata.len() == 0) {
            return Err(ArchiveError::absent(file));
        }
        // Where it is kept elsewhere, the new one is to stand there, and the link to it stays.
        let file = fs::canonicalize(&file).map_err(|source| ArchiveError::Write { file, source })?;
        let lock = lock_file(folder)?;
        // Some network file systems know no locks.
        if let Err(fs::TryLockError::WouldBlock) = lock.try_lock() {
            return Err(ArchiveError::InUse { file });
        }
        let checked = match Self::check(folder) {
            // The first page says how many there are.
            Err(error @ ArchiveError::Cut { .. }) => {
                let page = first_page(&file);
                let page = page.map_err(|source| ArchiveError::Write { file: file.clone(), source })?;
                return match Self::repair_with_page(&file, page) {
                    Err(without) if without.is_beyond_repair() => Self::repair_first_page(&file, error),
                    repaired => repaired,
                };
            }
            Err(error @ (ArchiveError::Unopenable { .. } | ArchiveError::NotAnArchive { .. })) => {
                return Self::repair_first_page(&file, error);
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
        Self::repair_from(&file, &file)
    }

    /// Repairs an archive whose first page is damaged, so that it does not open, or not as an archive. That page says where its tables begin. They begin where those of any archive do that
    /// was made with these tables: the first page of a fresh one takes its place in a copy, and checksums show whether that was right.
    fn repair_first_page(file: &Path, unopenable: ArchiveError) -> Result<RepairReport, ArchiveError> {
        match Self::repair_with_page(file, fresh_first_page(file)?) {
            // The tables began elsewhere.
            Err(error) if error.is_beyond_repair() => Err(match unopenable {
                other @ ArchiveError::NotAnArchive { .. } => other,
                _ => ArchiveError::NothingSaved { file: file.to_owned() },
            }),
            repaired => repaired,
        }
    }

    /// Repairs an archive in a copy that gets another first page.
    fn repair_with_page(file: &Path, page: Vec<u8>) -> Result<RepairReport, ArchiveError> {
        let copy = unfinished("copy-", file);
        let failed = |source| ArchiveError::Write { file: copy.clone(), source };
        remove(&copy)?;
        let with_page = fs::copy(file, &copy).and_then(|_| {
            // What a collector that was killed has left in its log is on no page yet.
            let log = |path: &Path| PathBuf::from(format!("{}-wal", path.display()));
            match fs::copy(log(file), log(&copy)) {
                Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
                _ => {}
            }
            write_first_page(&copy, page)
        });
        let repaired = match with_page.map_err(failed) {
            Ok(()) => Self::repair_from(&copy, file),
            Err(error) => Err(error),
        };
        // What has failed before is what counts.
        let removed = remove(&copy);
        repaired.and_then(|repaired| removed.map(|()| repaired))
    }

    /// Puts what can be saved of `source` in the place of the archive.
    fn repair_from(source: &Path, file: &Path) -> Result<RepairReport, ArchiveError> {
        let old = Self::connect(source.to_owned(), OpenFlags::default(), None)?;
        old.version()?;
        // So that the old file is all there is of it. Where that fails, its log is kept beside it.
        let _ = old.connection.pragma_update_and_check(None, "wal_checkpoint", "truncate", |_| Ok(()));
        let new_file = unfinished("", file);
        remove(&new_file)?;
        let mut new = Self::create_file(new_file.clone(), None)?;
        // One look at it for all of it; where that cannot be had, each row is looked at alone.
        let _ = old.connection.execute_batch("BEGIN");
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
            return Err(ArchiveError::NothingSaved { file: file.to_owned() });
        }
        let kept_as = swap(&new_file, file)?;
        Ok(RepairReport { archive: file.to_owned(), kept_as: Some(kept_as), windows, mended, lost })
    }

    /// Copies all rows that are sound, or can be mended; windows copied, rows mended, and what is lost.
    fn save_into(&self, new: &mut Connection) -> rusqlite::Result<(u64, u64, Vec<Damage>)> {
        let transaction = new.transaction()?;
        let (mut windows, mut mended, mut lost) = (0, 0, Vec::new());
        // Hashes of settings, and windows of others.
        let (mut known, mut unknown) = (BTreeSet::new(), 0);
        for kind in [Kind::Asked, Kind::Service, Kind::Loss] {
            let (table, columns) = (kind.name(), kind.columns());
            for id in self.row_ids(table) {
                match self.row(table, columns, id) {
                    Some((values, was_mended)) if copy_row(&values, kind, &transaction)? => {
                        mended += u64::from(was_mended);
                        if let (Kind::Asked, Some(&Value::Integer(configuration))) = (kind, values.0.get(4)) {
                            known.insert(configuration);
                        }
                    }
                    _ => lost.push(Damage::row(table, id, "it does not match its checksum")),
                }
            }
        }
        let mut saved: BTreeMap<(String, i64), Tally> = BTreeMap::new();
        let ids = every(self.window_ids());
        let mut failed = BTreeSet::new();
        let mut save = |id: i64, window: SavedWindow| -> rusqlite::Result<()> {
            let SavedWindow { head, channels, checksum, was_mended } = window;
            if write_window(&transaction, id, &head, &channels)? {
                if let (Some(Value::Text(setup)), Some(Value::Integer(start_us))) = (head.get(4), head.get(7)) {
                    saved.entry((setup.clone(), hour_of(*start_us))).or_default().add(checksum);
                }
                if let Some(&Value::Integer(configuration)) = head.get(5) {
                    unknown += u64::from(!known.contains(&configuration));
                }
                windows += 1;
                mended += u64::from(was_mended);
            }
            Ok(())
        };
        for &id in &ids {
            match self.indexed_channels(id).and_then(|channels| self.whole_window(id, channels)) {
                Some(window) => save(id, window)?,
                None => {
                    failed.insert(id);
                }
            }
        }
        // Where the way by the index is broken, the channels may still stand where they were written.
        // Rows were numbered as windows were, so many to each of them.
        let most_rows = ids.last().copied().unwrap_or(0).saturating_mul(MAX_CHANNELS as i64);
        if !failed.is_empty() {
            self.each_written(most_rows, &mut |id, mut channels| {
                if !failed.contains(&id) {
                    return Ok(());
                }
                channels.sort_by_key(|(channel, _)| *channel);
                let channels = channels.into_iter().flat_map(|(_, values)| values).collect();
                let Some(window) = self.whole_window(id, channels) else { return Ok(()) };
                failed.remove(&id);
                save(id, window)
            })?;
        }
        lost.extend(unknown_settings(unknown));
        for id in failed {
            if let Ok(Some(head)) = self.head(id) {
                lost.push(head.damaged("it does not match its checksum"));
            }
        }
        let named = lost.iter().filter_map(|damage| damage.start_s.map(|start_s| hour_of((start_s * 1e6) as i64)));
        let named: Vec<i64> = named.collect();
        // What is gone without a trace is known from the tallies.
        for setup in self.setups().unwrap_or_default() {
            for (hour, tally) in self.window_tallies(&setup)?.0 {
                let saved = saved.get(&(setup.clone(), hour)).copied().unwrap_or_default();
                // All of them, whatever the count says: that may be what is damaged.
                if saved.digest == tally.digest && saved.entries > 0 {
                    continue;
                }
                let seen = saved.entries + named.iter().filter(|&&other| other == hour).count() as u64;
                if tally.entries > seen {
                    lost.push(lost_in(&setup, hour, tally.entries - seen));
                }
                remember(&transaction, &setup, hour, tally.entries.saturating_sub(saved.entries))?;
            }
        }
        for DamagedHour { setup, hour, windows, .. } in self.damaged_hours().unwrap_or_default() {
            remember(&transaction, &setup, hour, windows)?;
        }
        meet_again(&transaction)?;
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        list_damaged(&transaction, HostTime::since_epoch(now))?;
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

    /// The channels of a window one after the other, as the index leads to them.
    fn indexed_channels(&self, id: i64) -> Option<Vec<Value>> {
        let query = format!("SELECT {CHANNEL_COLUMNS} FROM channel WHERE window = ?1 ORDER BY channel");
        let mut statement = self.connection.prepare_cached(&query).ok()?;
        let mut rows = statement.query([id]).ok()?;
        let mut values = Vec::new();
        while let Some(row) = rows.next().ok()? {
            values.extend(Values::read(row, CHANNEL_COLUMNS).ok()?.0);
        }
        Some(values)
    }

    /// Walks over rows of `channel` in the order in which they were written, up to a number, and over those that cannot be read: the channels of a
    /// window at a time, each with its number.
    fn each_written(
        &self,
        last: i64,
        take: &mut dyn FnMut(i64, Vec<Numbered>) -> rusqlite::Result<()>,
    ) -> rusqlite::Result<()> {
        let query =
            format!("SELECT {CHANNEL_COLUMNS}, rowid FROM channel NOT INDEXED WHERE rowid >= ?1 ORDER BY rowid");
        let Ok(mut statement) = self.connection.prepare(&query) else { return Ok(()) };
        let (mut next, mut window, mut channels) = (1, 0, Vec::new());
        // Each time takes microseconds; a number that is damaged must not make years of it.
        let mut tries = 0;
        while next <= last && tries < MOST_TRIES {
            let mut rows = statement.query([next])?;
            loop {
                match rows.next() {
                    Ok(None) => return take(window, channels),
                    Ok(Some(row)) => {
                        // One that is damaged leads nowhere.
                        let number = row.get("rowid").ok().filter(|&number: &i64| number <= last);
                        next = number.map_or(next, |number| next.max(number.saturating_add(1)));
                        let Ok(Values(values)) = Values::read(row, CHANNEL_COLUMNS) else { continue };
                        let (Some(&Value::Integer(of)), Some(&Value::Integer(channel))) =
                            (values.first(), values.get(1))
                        else {
                            continue;
                        };
                        if of != window {
                            take(window, std::mem::take(&mut channels))?;
                            window = of;
                        }
                        channels.push((channel, values));
                    }
                    // On a page that is gone: somewhere behind it.
                    Err(_) => break,
                }
            }
            drop(rows);
            tries += 1;
            let mut reads = |number: i64| statement.query([number]).is_ok_and(|mut rows| rows.next().is_ok());
            let mut step = 1;
            let (mut bad, mut good) = (next, next.saturating_add(1));
            while good <= last && tries < MOST_TRIES && !reads(good) {
                tries += 1;
                step = (2 * step).min(LONGEST_STEP);
                (bad, good) = (good, good.saturating_add(step));
            }
            while good - bad > 1 {
                let middle = bad + (good - bad) / 2;
                if reads(middle) { good = middle } else { bad = middle }
            }
            next = good;
        }
        take(window, channels)
    }

    /// A window with these channels, if they are its own.
    fn whole_window(&self, id: i64, channels: Vec<Value>) -> Option<SavedWindow> {
        let query = format!("SELECT {WINDOW_COLUMNS}, checksum FROM window WHERE id = ?1");
        let read = self.connection.prepare_cached(&query).and_then(|mut statement| {
            statement.query_row([id], |row| Ok((Values::read(row, WINDOW_COLUMNS)?, row.get::<_, i64>("checksum")?)))
        });
        let (Values(mut values), stored) = read.ok()?;
        let head = values.len();
        values.extend(channels);
        let mut values = Values(values);
        let was_mended = values.checksum() != stored;
        if was_mended && !values.mend(stored) {
            return None;
        }
        let checksum = values.checksum();
        let channels = values.0.split_off(head);
        Some(SavedWindow { head: values.0, channels, checksum, was_mended })
    }
}

/// A channel's number within its window, and its columns.
type Numbered = (i64, Vec<Value>);

/// A window that is sound, or has been mended: its own columns, and those of its channels one after the other.
struct SavedWindow {
    head: Vec<Value>,
    channels: Vec<Value>,
    /// The checksum that it was written with.
    checksum: i64,
    was_mended: bool,
}

/// Writes a row of a small table under the number that it was written with; `false` where that is taken.
pub(super) fn copy_row(values: &Values, kind: Kind, into: &Connection) -> rusqlite::Result<bool> {
    // The number that leads to the row may be what was damaged.
    let Some(&Value::Integer(id)) = values.0.first() else { return Ok(false) };
    let is_new = insert_once(&values.0, kind, into)?;
    if is_new {
        seal(into, kind, id)?;
    }
    Ok(is_new)
}

/// Writes a row; `false` where one of its name is there already.
fn insert_once(values: &[Value], kind: Kind, into: &Connection) -> rusqlite::Result<bool> {
    match Values::insert(values, kind.name(), kind.columns(), true, into) {
        Err(error) if error.sqlite_error_code() == Some(rusqlite::ErrorCode::ConstraintViolation) => Ok(false),
        inserted => inserted.map(|()| true),
    }
}

/// All numbers between the first and the last of those that were found, as far as that is not far more: where pages are gone, so are the lists of
/// numbers on them, and windows are numbered without gaps.
fn every(found: BTreeSet<i64>) -> BTreeSet<i64> {
    const MOST_MORE: i64 = 1_000_000;
    let (Some(&first), Some(&last)) = (found.first(), found.last()) else { return found };
    let count = i64::try_from(found.len()).unwrap_or(i64::MAX);
    let more = last.saturating_sub(first).saturating_sub(count);
    if more < count.saturating_add(MOST_MORE) { (first..=last).collect() } else { found }
}

/// Notes lives of which there are windows, but no longer when they were met: without that, nothing of them would be missed.
fn meet_again(transaction: &Connection) -> rusqlite::Result<()> {
    // In the order in which they were met, as far as it is known. Of several columns beside a minimum, SQLite gives those of its row.
    let query = "INSERT INTO service (setup, node, boot, first_window, since_us, checksum)
                 SELECT setup, node, boot, number, start_us, 0 FROM
                     (SELECT setup, node, boot, min(number) AS number, start_us FROM window GROUP BY node, boot)
                 WHERE (node, boot) NOT IN (SELECT node, boot FROM service) ORDER BY start_us";
    let before: i64 = transaction.query_row("SELECT ifnull(max(id), 0) FROM service", [], |row| row.get(0))?;
    transaction.execute(query, [])?;
    let after: i64 = transaction.query_row("SELECT ifnull(max(id), 0) FROM service", [], |row| row.get(0))?;
    (before + 1..=after).try_for_each(|id| seal(transaction, Kind::Service, id))
}

/// Writes a window with its channels; `false` where it is there already.
pub(super) fn write_window(
    connection: &Connection,
    id: i64,
    head: &[Value],
    channels: &[Value],
) -> rusqlite::Result<bool> {
    // A damaged index lets a window in a second time.
    if !insert_once(head, Kind::Window, connection)? {
        return Ok(false);
    }
    for channel in channels.chunks(CHANNEL_COLUMNS.split(", ").count()) {
        Values::insert(channel, "channel", CHANNEL_COLUMNS, false, connection)?;
    }
    seal_window(connection, id)?;
    Ok(true)
}

/// The first page of an archive that has just been made.
fn fresh_first_page(beside: &Path) -> Result<Vec<u8>, ArchiveError> {
    let file = unfinished("fresh-", beside);
    remove(&file)?;
    let fresh = Archive::create_file(file.clone(), None)?;
    // All of it is then in the file.
    let closed = fresh.connection.pragma_update_and_check(None, "journal_mode", "delete", |_| Ok(()));
    closed.map_err(|source| fresh.failed(source))?;
    drop(fresh);
    let page = first_page(&file).map_err(|source| ArchiveError::Write { file: file.clone(), source })?;
    remove(&file)?;
    Ok(page)
}

/// The first page of a file, or what there is of it.
fn first_page(file: &Path) -> io::Result<Vec<u8>> {
    let mut page = Vec::new();
    File::open(file)?.take(PAGE_BYTES as u64).read_to_end(&mut page)?;
    Ok(page)
}

/// Bytes of a page, as the first one says: an archive that version 1 began has smaller ones.
fn page_size(page: &[u8]) -> Option<u64> {
    let size = u16::from_be_bytes(page.get(PAGE_SIZE)?.try_into().ok()?);
    // Its greatest size does not fit.
    Some(if size == 1 { 65536 } else { u64::from(size) })
}

/// How many pages a database that is no longer whole has, and should have (SQLite's file format, section 1.3).
pub(super) fn cut(file: &Path) -> Option<[u64; 2]> {
    let bytes = fs::metadata(file).ok()?.len();
    let page = first_page(file).ok()?;
    let size = page_size(&page)?;
    let of = u64::from(u32::from_be_bytes(page.get(PAGES)?.try_into().ok()?));
    // The count holds where whoever wrote last has counted.
    let is_counted = page.get(CHANGES)? == page.get(COUNTED_AT)?;
    let has = bytes.checked_div(size)?;
    (is_counted && has < of).then_some([has, of])
}

/// Puts a first page into a database, with the count of its pages, none of which are free (SQLite's file format, section 1.3).
fn write_first_page(file: &Path, mut page: Vec<u8>) -> io::Result<()> {
    let mut database = File::options().write(true).open(file)?;
    let size = page_size(&page).filter(|&size| size > 0).unwrap_or(PAGE_BYTES as u64);
    page.truncate(size as usize);
    let pages = u32::try_from(database.metadata()?.len() / size).unwrap_or(u32::MAX);
    if let Some(place) = page.get_mut(PAGES) {
        place.copy_from_slice(&pages.to_be_bytes());
    }
    if let Some(place) = page.get_mut(FREE) {
        place.fill(0);
    }
    database.write_all(&page)
}

/// A file beside another that is unfinished as long as it is there.
fn unfinished(what: &str, file: &Path) -> PathBuf {
    let name = file.file_name().unwrap_or_else(|| ARCHIVE_FILE.as_ref()).to_string_lossy();
    file.with_file_name(format!(".belfry-{what}{name}{UNFINISHED_SUFFIX}"))
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
    sync_folder(folder_of(file)).map_err(fail(file))?;
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
