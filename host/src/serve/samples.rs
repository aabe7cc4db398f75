//! Pieces of a recording, as fine as a picture can show them.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::SystemTime;

use serde::Serialize;

use crate::record::{Block, RecordError, Recording, matching_files};
use crate::study::{Setup, Study};

/// What a recording may take in memory, as four bytes a sample.
const MOST_BYTES: u64 = 1 << 30;
/// Points of an answer at most.
const MOST_BINS: usize = 4000;

/// A setup's recording in memory.
#[derive(Debug)]
pub(super) struct Loaded {
    setup: String,
    source: Source,
    sampling_rate_hz: f64,
    /// Channel by channel, in the recording's unit (in SI).
    channels: Vec<(String, Vec<f32>)>,
}

/// A piece of a channel: smallest and largest value of each bin; all values where there are few.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Samples {
    /// The middle of each bin, from the recording's first row on.
    time_s: Vec<f64>,
    min: Vec<Option<f32>>,
    max: Vec<Option<f32>>,
}

/// Why there are no samples.
#[derive(Debug, thiserror::Error)]
pub(super) enum SamplesError {
    /// There is no such setup, or it has no recording.
    #[error("setup \"{0}\" has no recording to look into")]
    NoRecording(String),
    /// There is no such channel.
    #[error("setup \"{setup}\" has no channel \"{channel}\"")]
    NoChannel { setup: String, channel: String },
    /// It does not fit into memory.
    #[error(
        "the recording of setup \"{setup}\" has {samples} samples, more than fit into memory; its overview is all there is to see"
    )]
    TooLarge { setup: String, samples: u64 },
    /// It cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
}

/// What a recording was read from: what the study says of it, and its files with their times and sizes.
#[derive(Debug, PartialEq)]
struct Source {
    setup: Setup,
    files: Vec<(PathBuf, Option<SystemTime>, u64)>,
}

impl Source {
    fn of(setup: &Setup, folder: &Path) -> Self {
        let about = |file: PathBuf| {
            let about = std::fs::metadata(&file).ok();
            let (modified, bytes) = about.map_or((None, 0), |about| (about.modified().ok(), about.len()));
            (file, modified, bytes)
        };
        // Files that cannot be found are an error when they are read.
        let files = matching_files(setup, folder).unwrap_or_default();
        Self { setup: setup.clone(), files: files.into_iter().map(about).collect() }
    }
}

impl Loaded {
    /// The recording of a setup: the one that is `known`, where it still is what the study names, else read anew.
    pub(super) fn of(
        known: &mut Option<Arc<Self>>,
        study: &Study,
        folder: &Path,
        name: &str,
    ) -> Result<Arc<Self>, SamplesError> {
        let setup = study.setups.iter().find(|setup| setup.name == name && !setup.live);
        let setup = setup.ok_or_else(|| SamplesError::NoRecording(name.to_owned()))?;
        let source = Source::of(setup, folder);
        if let Some(known) = known.as_ref().filter(|known| known.source == source) {
            return Ok(Arc::clone(known));
        }
        // Not two at once in memory.
        *known = None;
        let read = Arc::new(Self::read(setup, folder, source)?);
        *known = Some(Arc::clone(&read));
        Ok(read)
    }

    fn read(setup: &Setup, folder: &Path, source: Source) -> Result<Self, SamplesError> {
        let name = &setup.name;
        let mut recording = Recording::open(setup, folder)?;
        let rows = recording.total_rows()?;
        let samples = rows.saturating_mul(recording.channels() as u64);
        if samples.saturating_mul(size_of::<f32>() as u64) > MOST_BYTES {
            return Err(SamplesError::TooLarge { setup: name.clone(), samples });
        }
        let room = || Vec::with_capacity(usize::try_from(rows).unwrap_or(0));
        let mut channels: Vec<(String, Vec<f32>)> =
            setup.sensors.iter().map(|sensor| (sensor.channel.clone(), room())).collect();
        let mut block = Block::new();
        while recording.next_block(&mut block)? {
            for row in block.rows() {
                for ((_, values), value) in channels.iter_mut().zip(row) {
                    values.push(*value as f32);
                }
            }
        }
        Ok(Self { setup: name.clone(), source, sampling_rate_hz: setup.sampling_rate_hz, channels })
    }

    /// A piece of a channel in `bins` bins at most; times outside of the recording are its ends.
    pub(super) fn samples(&self, channel: &str, from_s: f64, to_s: f64, bins: usize) -> Result<Samples, SamplesError> {
        // Where names recur they stand behind that of the setup.
        let name = channel.strip_prefix(&format!("{}/", self.setup)).unwrap_or(channel);
        let values = self.channels.iter().find(|(known, _)| known == channel || known == name);
        let (_, values) =
            values.ok_or_else(|| SamplesError::NoChannel { setup: self.setup.clone(), channel: channel.to_owned() })?;
        let row = |time_s: f64| ((time_s * self.sampling_rate_hz).max(0.0) as usize).min(values.len());
        let (from, to) = (row(from_s), row(to_s).saturating_add(1).min(values.len()));
        let here = values.get(from..to).unwrap_or(&[]);
        let a_bin = here.len().div_ceil(bins.clamp(1, MOST_BINS)).max(1);
        let side = |least: bool| -> Vec<Option<f32>> {
            let better = |a: f32, b: f32| if least { a.min(b) } else { a.max(b) };
            here.chunks(a_bin).map(|bin| bin.iter().copied().filter(|value| !value.is_nan()).reduce(better)).collect()
        };
        let middle = |bin: usize| (from as f64 + (bin as f64 + 0.5) * a_bin as f64 - 0.5) / self.sampling_rate_hz;
        Ok(Samples { time_s: (0..here.len().div_ceil(a_bin)).map(middle).collect(), min: side(true), max: side(false) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The template's first setup, of ten rows a second.
    fn loaded(values: Vec<f32>) -> Loaded {
        let text = crate::study::template::CANTON_STUDY;
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("beam.csv"), crate::study::template::CANTON_BEAM).unwrap();
        let study = Study::from_text(text, folder.path()).unwrap();
        let source = Source::of(&study.setups[0], folder.path());
        Loaded { setup: "one".to_owned(), source, sampling_rate_hz: 10.0, channels: vec![("07".to_owned(), values)] }
    }

    #[test]
    fn pieces_hold_every_extreme_and_stay_inside_the_recording() {
        let values: Vec<f32> = (0..1000).map(|row| if row == 500 { f32::NAN } else { row as f32 }).collect();
        let loaded = loaded(values);
        let whole = loaded.samples("one/07", -5.0, 1e9, 10).unwrap();
        assert_eq!(
            whole.min,
            (0..10).map(|bin| Some(if bin == 5 { 501.0 } else { 100.0 * bin as f32 })).collect::<Vec<_>>()
        );
        assert_eq!(whole.max[9], Some(999.0));
        assert!((whole.time_s[0] - 4.95).abs() < 1e-9);
        let fine = loaded.samples("07", 49.8, 50.2, 100).unwrap();
        assert_eq!(fine.max, [Some(498.0), Some(499.0), None, Some(501.0), Some(502.0)]);
        assert_eq!((fine.time_s.first(), fine.time_s.len()), (Some(&49.8), 5));
        let none = loaded.samples("07", 200.0, 100.0, 0).unwrap();
        assert!(none.time_s.is_empty() && none.min.is_empty());
        assert!(loaded.samples("07", f64::NAN, f64::NAN, usize::MAX).unwrap().time_s.len() <= 1);
        assert!(matches!(loaded.samples("08", 0.0, 1.0, 10), Err(SamplesError::NoChannel { .. })));
    }
}
