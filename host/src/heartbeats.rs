//! Heartbeats of nodes, kept beside the archive: one JSON object a line in the study's `heartbeats.jsonl`, some 170 bytes for three channels. A node says
//! one every two minutes, so that a day takes 0.12 MB and a year 45 MB, until they are pruned with the windows.
//!
//! Each is on the disk before the next is written. A line that a crash has cut ends where the next begins, and is left out.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufRead, BufReader, ErrorKind, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use belfry_shared::message::{Heartbeat, SensorState};
use belfry_shared::time::HostTime;
use serde::{Deserialize, Serialize};

use crate::files::{FolderLock, WholeFile, behind_links, open_lock, open_plain};

/// The file's name in the study's folder.
pub const HEARTBEATS_FILE: &str = "heartbeats.jsonl";
/// Who appends to it, or puts another in its place, holds a lock on this file.
const LOCK_FILE: &str = ".belfry-heartbeats-lock";
/// Heartbeats that wait while the file cannot be written: a day of one node's. Then the oldest go.
const MOST_WAITING: usize = 720;
/// No line that a heartbeat makes is as long.
pub(crate) const LONGEST_LINE: u64 = 4096;
/// Time between two of a node, in s, and more than nearly all of them take.
const EVERY_S: f64 = 120.0;
const LONG_LINE: u64 = 512;

/// A heartbeat, as it is kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeptHeartbeat {
    /// When it came, in s of Unix time.
    pub time_s: f64,
    /// The node.
    pub node: u16,
    /// Its boot id.
    pub boot: u32,
    /// The sensor's temperature in degrees Celsius.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_degc: Option<f64>,
    /// Mean of each channel since the heartbeat before, in m/s².
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mean_m_s2: Vec<f64>,
    /// Variance of each channel about that, in (m/s²)².
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub variance: Vec<f32>,
    /// Samples that never arrived since the node's start.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub lost_rows: u32,
    /// Pulses since then after which the sensor had taken no new sample.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub stale_rows: u32,
    /// Windows that the node has lost since then.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub lost_windows: u32,
    /// What is wrong with channels, by their number from 1.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<(usize, String)>,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it with a reference")]
fn is_zero(value: &u32) -> bool {
    *value == 0
}

impl KeptHeartbeat {
    /// A heartbeat that came at `now`.
    pub fn new(now: HostTime, heartbeat: &Heartbeat) -> Self {
        let rounded = |value: f64, step: f64| (value / step).round() * step;
        let hundredth = |centi_c: i16| f64::from(centi_c) / 100.0;
        let wrong = |(channel, state): (usize, &SensorState)| {
            // A name is enough, and its words may change.
            (*state != SensorState::Sound).then(|| (channel, format!("{state:?}").to_lowercase()))
        };
        Self {
            time_s: rounded(1e-3 * now.0 as f64, 1.0) / 1e3,
            node: heartbeat.node,
            boot: heartbeat.boot,
            temperature_degc: heartbeat.board.temperature_centi_c.map(hundredth),
            // Steps of 0.1 mm/s².
            mean_m_s2: heartbeat.mean.iter().map(|&steps| f64::from(steps) / 1e4).collect(),
            variance: heartbeat.variance.to_vec(),
            lost_rows: heartbeat.lost_rows,
            stale_rows: heartbeat.stale_rows,
            lost_windows: heartbeat.lost_windows,
            faults: (1..).zip(&heartbeat.sensors).filter_map(wrong).collect(),
        }
    }
}

/// The file, to be appended to.
#[derive(Debug)]
pub struct HeartbeatLog {
    folder: PathBuf,
    /// Lines that are not on the disk yet, oldest first.
    waiting: VecDeque<String>,
}

impl HeartbeatLog {
    /// Of the study in `folder`; nothing is written yet.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), waiting: VecDeque::new() }
    }

    /// The file.
    pub fn file(&self) -> PathBuf {
        self.folder.join(HEARTBEATS_FILE)
    }

    /// Keeps a heartbeat, until [`HeartbeatLog::write`] has it on the disk.
    pub fn push(&mut self, heartbeat: &KeptHeartbeat) {
        // Numbers and words are always written.
        let Ok(line) = serde_json::to_string(heartbeat) else { return };
        if self.waiting.len() == MOST_WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(line);
    }

    /// Puts what waits on the disk.
    ///
    /// # Errors
    /// When the file cannot be written; what waits is kept.
    pub fn write(&mut self) -> io::Result<()> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        let _lock = FolderLock::on(open_lock(&self.folder.join(LOCK_FILE))?, || {})?;
        let path = behind_links(&self.file())?;
        if std::fs::metadata(&path).is_ok_and(|metadata| !metadata.is_file()) {
            return Err(io::Error::new(ErrorKind::InvalidInput, "it is a folder, a pipe or a device"));
        }
        let mut file = File::options().create(true).append(true).read(true).open(path)?;
        let mut text = String::new();
        if ends_in_a_line(&mut file)? {
            text.push('\n');
        }
        for line in &self.waiting {
            text += line;
            text.push('\n');
        }
        file.write_all(text.as_bytes())?;
        file.sync_data()?;
        self.waiting.clear();
        Ok(())
    }
}

/// Whether a file ends in a line without an end, as a crash may leave it.
fn ends_in_a_line(file: &mut File) -> io::Result<bool> {
    if file.metadata()?.len() == 0 {
        return Ok(false);
    }
    file.seek(SeekFrom::End(-1))?;
    let mut last = [0];
    file.read_exact(&mut last)?;
    Ok(last != *b"\n")
}

/// Reads the heartbeats of the study in `folder`, one after the other, oldest first; how many lines are none. There are none where there is no file.
///
/// # Errors
/// When the file cannot be read.
pub fn read(folder: &Path, mut on_heartbeat: impl FnMut(KeptHeartbeat)) -> io::Result<u64> {
    let mut broken = 0;
    each_line(folder, |line| match serde_json::from_slice(line) {
        Ok(heartbeat) => on_heartbeat(heartbeat),
        Err(_) => broken += 1,
    })?;
    Ok(broken)
}

/// Reads the heartbeats of about the last `since_s` of so many nodes, oldest first, and some before them: a file of years is not read from its beginning.
///
/// # Errors
/// When the file cannot be read.
pub fn newest(
    folder: &Path,
    since_s: f64,
    nodes: usize,
    mut on_heartbeat: impl FnMut(KeptHeartbeat),
) -> io::Result<()> {
    let mut file = match open_plain(&folder.join(HEARTBEATS_FILE)) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        file => file?,
    };
    let wanted = (since_s / EVERY_S).ceil() as u64 * nodes as u64 * LONG_LINE;
    let start = file.metadata()?.len().saturating_sub(wanted);
    file.seek(SeekFrom::Start(start))?;
    // Half a line at the start is no heartbeat.
    each_line_of(BufReader::new(file), |line| {
        if let Ok(heartbeat) = serde_json::from_slice(line) {
            on_heartbeat(heartbeat);
        }
    })
}

/// The lines of the file, without their ends. Of one that is too long there is the beginning, which is no heartbeat.
fn each_line(folder: &Path, mut on_line: impl FnMut(&[u8])) -> io::Result<()> {
    let file = match open_plain(&folder.join(HEARTBEATS_FILE)) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(()),
        file => file?,
    };
    each_line_of(BufReader::new(file), &mut on_line)
}

fn each_line_of(mut reader: impl BufRead, mut on_line: impl FnMut(&[u8])) -> io::Result<()> {
    let mut line = Vec::new();
    loop {
        read_line(&mut reader, &mut line)?;
        if line.is_empty() {
            return Ok(());
        }
        let whole = line.strip_suffix(b"\n").unwrap_or(&line);
        if !whole.is_empty() {
            on_line(whole);
        }
    }
}

/// Reads a line with its end, or as much of it as a heartbeat can have; nothing at the end of the file.
pub(crate) fn read_line(reader: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<()> {
    line.clear();
    reader.take(LONGEST_LINE).read_until(b'\n', line).map(drop)
}

/// Drops the heartbeats of the study in `folder` that came before `before` (and lines that are none); how many lines. `dry_run` only counts them.
///
/// # Errors
/// When the file cannot be read or written; it is then as it was.
pub fn prune(folder: &Path, before: HostTime, dry_run: bool) -> io::Result<u64> {
    let path = folder.join(HEARTBEATS_FILE);
    if !path.exists() {
        return Ok(0);
    }
    let _lock = FolderLock::on(open_lock(&folder.join(LOCK_FILE))?, || {})?;
    let before_s = 1e-6 * before.0 as f64;
    let mut kept = if dry_run { None } else { Some(WholeFile::create(&path)?) };
    let (mut dropped, mut failure) = (0, None);
    each_line(folder, |line| {
        let is_kept = serde_json::from_slice(line).is_ok_and(|kept: KeptHeartbeat| kept.time_s >= before_s);
        if !is_kept {
            dropped += 1;
        } else if let Some(file) = &mut kept {
            let written = file.write_all(line).and_then(|()| file.write_all(b"\n"));
            failure = failure.take().or(written.err());
        }
    })?;
    match (kept, failure) {
        (_, Some(error)) => Err(error),
        (Some(file), None) if dropped > 0 => file.finish().map(|()| dropped),
        _ => Ok(dropped),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use belfry_shared::message::BoardState;

    fn heartbeat() -> Heartbeat {
        Heartbeat {
            node: 3,
            boot: u32::MAX,
            next_window: 301,
            oldest_window: 299,
            lost_windows: 0,
            damaged_frames: 1,
            refused_messages: 6,
            level: [0.5; 3].into_iter().collect(),
            sensors: [SensorState::Sound; 3].into_iter().collect(),
            lost_rows: 0,
            board: BoardState { temperature_centi_c: Some(2135), ..BoardState::default() },
            unknown_messages: 0,
            unsealed_messages: 0,
            stale_rows: 0,
            variance: [1.234_567_8e-5; 3].into_iter().collect(),
            mean: Heartbeat::means_of(&[0.0123, -0.0456, 9.8012]),
        }
    }

    fn at(seconds: i64) -> HostTime {
        HostTime(1_800_000_000_000_000 + 1_000_000 * seconds)
    }

    fn all(folder: &Path) -> (Vec<KeptHeartbeat>, u64) {
        let mut found = Vec::new();
        let broken = read(folder, |one| found.push(one)).unwrap();
        (found, broken)
    }

    #[test]
    fn heartbeats_come_back_as_they_were_said_and_a_day_of_them_is_as_large_as_is_said() {
        let folder = tempfile::tempdir().unwrap();
        let mut log = HeartbeatLog::new(folder.path());
        let mut faulty = heartbeat();
        faulty.sensors[1] = SensorState::Clipped;
        faulty.lost_rows = 7;
        for (second, one) in [(0, &heartbeat()), (120, &faulty)] {
            log.push(&KeptHeartbeat::new(at(second), one));
            log.write().unwrap();
        }
        let (found, broken) = all(folder.path());
        assert_eq!((found.len(), broken), (2, 0));
        assert_eq!(found[0].temperature_degc, Some(21.35));
        assert_eq!(found[0].mean_m_s2, [0.0123, -0.0456, 9.8012]);
        assert_eq!(found[0].variance, heartbeat().variance.to_vec());
        assert_eq!((found[1].time_s, found[1].lost_rows), (1_800_000_120.0, 7));
        assert_eq!(found[1].faults, [(2, "clipped".to_owned())]);
        // 720 a day.
        let line = serde_json::to_string(&found[0]).unwrap().len() + 1;
        println!("{line} bytes a heartbeat, {} a day", 720 * line);
        assert!((150..=180).contains(&line), "{line}");
    }

    #[test]
    fn a_crash_at_any_byte_costs_the_line_that_was_being_written_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(HEARTBEATS_FILE);
        let mut log = HeartbeatLog::new(folder.path());
        for second in 0..2 {
            log.push(&KeptHeartbeat::new(at(second), &heartbeat()));
        }
        log.write().unwrap();
        let whole = std::fs::read(&file).unwrap();
        let first = whole.iter().position(|&byte| byte == b'\n').unwrap() + 1;
        for length in first..whole.len() {
            std::fs::write(&file, &whole[..length]).unwrap();
            log.push(&KeptHeartbeat::new(at(9), &heartbeat()));
            log.write().unwrap();
            let (found, broken) = all(folder.path());
            // Without its end alone the second is whole.
            let is_whole = length + 1 == whole.len();
            let seconds: Vec<f64> = found.iter().map(|one| one.time_s - 1.8e9).collect();
            assert_eq!(seconds, if is_whole { vec![0.0, 1.0, 9.0] } else { vec![0.0, 9.0] }, "{length}");
            assert_eq!(broken, u64::from(!is_whole && length > first), "{length}");
        }
    }

    #[test]
    fn what_cannot_be_written_waits_and_is_bounded() {
        let folder = tempfile::tempdir().unwrap();
        // A folder in the file's place, as a disk that is away.
        let file = folder.path().join(HEARTBEATS_FILE);
        std::fs::create_dir(&file).unwrap();
        let mut log = HeartbeatLog::new(folder.path());
        for second in 0..MOST_WAITING as i64 + 5 {
            log.push(&KeptHeartbeat::new(at(second), &heartbeat()));
        }
        assert!(log.write().is_err());
        std::fs::remove_dir(&file).unwrap();
        log.write().unwrap();
        let (found, _) = all(folder.path());
        assert_eq!((found.len(), found[0].time_s), (MOST_WAITING, 1_800_000_005.0));
        log.write().unwrap();
        assert_eq!(all(folder.path()).0.len(), MOST_WAITING, "once each");
    }

    #[test]
    fn old_heartbeats_are_dropped_and_a_line_without_end_is_no_heartbeat() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(prune(folder.path(), at(0), false).unwrap(), 0);
        let mut log = HeartbeatLog::new(folder.path());
        (0..10).for_each(|second| log.push(&KeptHeartbeat::new(at(second), &heartbeat())));
        log.write().unwrap();
        let file = folder.path().join(HEARTBEATS_FILE);
        let mut text = std::fs::read(&file).unwrap();
        text.splice(0..0, std::iter::repeat_n(b'x', 100_000).chain([b'\n']));
        std::fs::write(&file, &text).unwrap();
        let (found, broken) = all(folder.path());
        assert!(found.len() == 10 && broken > 0);
        assert_eq!(prune(folder.path(), at(4), true).unwrap(), 4 + broken);
        assert_eq!(std::fs::read(&file).unwrap(), text);
        assert_eq!(prune(folder.path(), at(4), false).unwrap(), 4 + broken);
        let (found, broken) = all(folder.path());
        assert_eq!((found.len(), broken, found[0].time_s), (6, 0, 1_800_000_004.0));
    }
}
