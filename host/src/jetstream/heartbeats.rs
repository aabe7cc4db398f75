//! The lines of a study's heartbeats that have come since a gateway looked last.

use std::io::{BufReader, ErrorKind, Seek, SeekFrom};
use std::path::Path;

use crate::files::open_plain;
use crate::heartbeats::{HEARTBEATS_FILE, KeptHeartbeat, LONGEST_LINE, read_line};

/// A heartbeat, the line that it is kept as, and where in the file that ends.
pub(super) struct Line {
    pub(super) heartbeat: KeptHeartbeat,
    pub(super) text: Vec<u8>,
    pub(super) end: u64,
}

impl Line {
    /// When it came, in µs of Unix time.
    pub(super) fn time_us(&self) -> i64 {
        (self.heartbeat.time_s * 1e6) as i64
    }
}

/// The heartbeats behind so many bytes, `most` at most. Where the file was cut, for it was pruned, it is read from its beginning.
pub(super) fn following(folder: &Path, after: u64, most: usize) -> std::io::Result<Vec<Line>> {
    let mut file = match open_plain(&folder.join(HEARTBEATS_FILE)) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
        file => file?,
    };
    let mut end = if file.metadata()?.len() < after { 0 } else { after };
    file.seek(SeekFrom::Start(end))?;
    let mut reader = BufReader::new(file);
    let mut lines = Vec::new();
    while lines.len() < most {
        let mut text = Vec::new();
        read_line(&mut reader, &mut text)?;
        // What has no end is still being written.
        if text.last() != Some(&b'\n') && (text.len() as u64) < LONGEST_LINE {
            break;
        }
        end += text.len() as u64;
        if let Ok(heartbeat) = serde_json::from_slice(&text) {
            text.pop();
            lines.push(Line { heartbeat, text, end });
        }
    }
    Ok(lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_read_once_and_half_a_line_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(HEARTBEATS_FILE);
        assert!(following(folder.path(), 0, 9).unwrap().is_empty());
        let line = |time: u32| format!("{{\"time_s\":{time}.5,\"node\":3,\"boot\":7}}\n");
        let half = line(3);
        std::fs::write(&file, line(1) + "no heartbeat\n" + &line(2) + &half[..9]).unwrap();
        let read = |after| following(folder.path(), after, 2).unwrap();
        let lines = read(0);
        let times: Vec<i64> = lines.iter().map(Line::time_us).collect();
        assert_eq!((times, lines[0].text.clone()), (vec![1_500_000, 2_500_000], line(1).trim().as_bytes().to_vec()));
        assert!(read(lines[1].end).is_empty());
        std::fs::write(&file, line(1) + "no heartbeat\n" + &line(2) + &half).unwrap();
        assert_eq!(read(lines[1].end).len(), 1);
        std::fs::write(&file, line(4)).unwrap();
        assert_eq!(read(lines[1].end)[0].time_us(), 4_500_000, "a file that was pruned is read anew");
    }
}
