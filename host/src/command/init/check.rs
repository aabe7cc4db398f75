//! Reads what a new study names, as the commands that come next will: what a survey of the files cannot see shows here, and not only there.
//!
//! The setups as they were written flow in, their gaps filled with stand-ins; a sentence for each setup that cannot be read flows out.

use std::path::Path;

use super::from::filled;
use crate::record::survey::Surveyed;
use crate::record::{Block, RecordError, Recording};
use crate::study::Study;

/// So many numbers of a setup are read: some seconds of text, and at once of other formats.
const MOST_VALUES: usize = 1 << 21;

/// What cannot be read, and what to do.
pub(super) fn failures(found: &[Surveyed], folder: &Path) -> Vec<String> {
    let of_setup = |(one, number): (&Surveyed, usize)| {
        let reason = failure(one, number, folder)?;
        Some(format!(
            "setup-{number} cannot be read as it stands: {reason}. study.toml is written; mend the file, or take it or the channel out of study.toml"
        ))
    };
    found.iter().zip(1..).filter_map(of_setup).collect()
}

fn failure(one: &Surveyed, number: usize, folder: &Path) -> Option<String> {
    if !one.channels.iter().any(|channel| one.is_at_rate(channel)) {
        let file = one.files.first().map(|file| file.display().to_string()).unwrap_or_default();
        return Some(format!("{file} has no column that can be a channel"));
    }
    let study = match Study::from_text(&filled(one, number, folder), folder) {
        Ok(study) => study,
        Err(error) => return Some(error.to_string()),
    };
    let setup = study.setups.first()?;
    let needs_count = one.rows.is_none();
    let outcome = Recording::open(setup, folder).and_then(|recording| read(recording, needs_count));
    match outcome {
        Ok(()) => None,
        // The unit and the clock's offset are stand-ins.
        Err(RecordError::UffOrdinate { .. }) if one.channels.iter().all(|channel| channel.unit.is_none()) => None,
        Err(RecordError::LoggerTooLate { .. }) if one.has_mixed_clocks() => None,
        Err(error) => Some(with_advice(&error)),
    }
}

fn read(mut recording: Recording, needs_count: bool) -> Result<(), RecordError> {
    let mut block = Block::new();
    let mut values = 0;
    while values < MOST_VALUES && recording.next_block(&mut block)? {
        values += block.row_count() * block.channels();
    }
    if needs_count {
        recording.total_rows()?;
    }
    Ok(())
}

/// The error, and where its cells show another format than the ending says, that.
fn with_advice(error: &RecordError) -> String {
    match error {
        RecordError::NotANumber { text, .. } if text.replacen(',', ".", 1).parse::<f64>().is_ok() => {
            format!("{error}. A comma is a decimal point in CSV between semicolons or tabulators only: write points")
        }
        RecordError::NotANumber { position, text, .. } if is_like_csv(&position.file, text) => {
            format!("{error}. Cells parted by commas or semicolons are CSV: rename the file to end in .csv")
        }
        _ => error.to_string(),
    }
}

fn is_like_csv(file: &Path, cell: &str) -> bool {
    let is_csv = file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("csv"));
    !is_csv && cell.contains([',', ';'])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::survey::survey;

    /// What is told of one file of this content.
    fn told(name: &str, content: &[u8]) -> Vec<String> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(name);
        std::fs::write(&file, content).unwrap();
        failures(&survey(vec![file]).unwrap(), folder.path())
    }

    #[test]
    fn what_looks_sound_and_cannot_be_read_is_told_with_its_place() {
        assert_eq!(told("a.csv", b"x,y\n1,2\n3,4\n"), [""; 0]);
        for (name, content, parts) in [
            ("a.csv", &b"x,y\n1,2\n3,4\n5,bad\n"[..], ["a.csv, line 4", "channel `y`", "study.toml is written"]),
            ("a.dat", b"x,y\n1,2\n3,4\n", ["a.dat, line 1", "channel `1`", "rename the file to end in .csv"]),
            ("a.txt", b"1 2\n3 4\n5\n", ["a.txt, line 3", "setup-1", "1 values"]),
            (
                "a.csv",
                b"time,x\n0.00,1\n0.02,2\n0.04,3\n0.02,4\n",
                ["a.csv, line 5", "time goes from", "mend the file"],
            ),
        ] {
            let told = told(name, content);
            assert_eq!(told.len(), 1, "{name}: {told:?}");
            assert!(parts.iter().all(|part| told[0].contains(part)), "{parts:?} in {told:?}");
        }
    }

    #[test]
    fn lines_that_wait_for_the_user_are_no_failure() {
        let recordings = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"));
        for file in ["same.npy", "obspy_steim1.mseed", "soundfile_pcm24.wav", "pyuff_text.uff", "h5py_channels.h5"] {
            let found = survey(vec![recordings.join(file)]).unwrap();
            assert_eq!(failures(&found, recordings), [""; 0], "{file}");
        }
    }
}
