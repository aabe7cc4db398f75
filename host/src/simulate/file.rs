//! Writing a simulated recording: rows flow in, one NPY file (f32, C order, rows x channels) comes out whole or not at all.

use std::io;
use std::path::Path;

use npyz::WriterBuilder;

use super::{Simulation, SimulationError};
use crate::files::WholeFile;

impl Simulation {
    /// Writes the next `rows` rows to `path`, and replaces what was there once they are complete. `progress` hears how many
    /// rows each block had.
    ///
    /// # Errors
    /// [`SimulationError::Write`] names the file.
    pub fn write(&mut self, path: &Path, rows: u64, progress: impl FnMut(u64)) -> Result<(), SimulationError> {
        let written = WholeFile::create(path).and_then(|file| self.write_npy(file, rows, progress));
        written.map_err(|source| SimulationError::Write { file: path.to_owned(), source })
    }

    fn write_npy(&mut self, mut file: WholeFile, rows: u64, mut progress: impl FnMut(u64)) -> io::Result<()> {
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
        file.finish()
    }
}
