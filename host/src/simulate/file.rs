//! Writing a simulated recording: rows flow in, one NPY file (f32, C order, rows x channels) comes out whole or not at all.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use npyz::WriterBuilder;

use super::{Simulation, SimulationError};

impl Simulation {
    /// Writes the next `rows` rows to `path`, under another name until they are complete, and replaces what was there.
    /// `progress` hears how many rows each block had.
    ///
    /// # Errors
    /// [`SimulationError::Write`] names the file.
    pub fn write(&mut self, path: &Path, rows: u64, progress: impl FnMut(u64)) -> Result<(), SimulationError> {
        let fail = |source| SimulationError::Write { file: path.to_owned(), source };
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder).map_err(fail)?;
        }
        let partial = partial_name(path);
        let written = self.write_npy(&partial, rows, progress).and_then(|()| fs::rename(&partial, path));
        written.map_err(|source| {
            // Nothing to save, and the first error is the one to tell.
            let _ = fs::remove_file(&partial);
            fail(source)
        })
    }

    fn write_npy(&mut self, path: &Path, rows: u64, mut progress: impl FnMut(u64)) -> io::Result<()> {
        let mut file = BufWriter::with_capacity(1 << 20, File::create(path)?);
        let shape = [rows, self.channels() as u64];
        let mut writer = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(&mut file).begin_nd()?;
        let mut left = rows;
        while left > 0 {
            let channels = self.channels();
            let block = self.next_rows(usize::try_from(left).unwrap_or(usize::MAX));
            let made = (block.len() / channels) as u64;
            for value in block {
                writer.push(value)?;
            }
            left -= made;
            progress(made);
        }
        writer.finish()?;
        file.flush()?;
        file.get_ref().sync_all()
    }
}

/// The name under which a file is written until it is complete, in the same folder so that it can be renamed.
pub(crate) fn partial_name(path: &Path) -> PathBuf {
    let mut name = path.file_name().map_or_else(OsString::new, ToOwned::to_owned);
    name.push(".partial");
    path.with_file_name(name)
}
