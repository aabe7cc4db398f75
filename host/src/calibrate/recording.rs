//! A tumble that some logger has recorded: its rows as cells of a second.

use std::path::{Path, PathBuf};

use super::still::Cell;
use crate::record::{Block, RecordError, Recording};
use crate::study::{Sensor, Setup};

/// Length of a cell in s.
const CELL_S: f64 = 1.0;

/// The cells of three channels of a recording, as they were recorded: without the gains and offsets that the study has for them already. The units are
/// those of the setup and its sensors.
///
/// # Errors
/// Where the recording cannot be read.
pub fn cells_of(file: &Path, setup: &Setup, channels: [&str; 3]) -> Result<Vec<Cell>, RecordError> {
    let sensor = |channel: &str| {
        let known = setup.sensors.iter().find(|sensor| sensor.channel == channel);
        Sensor {
            unit: known.and_then(|known| known.unit),
            sensitivity_v_per_m_s2: known.and_then(|known| known.sensitivity_v_per_m_s2),
            ..Sensor::new(channel, 1)
        }
    };
    let path: PathBuf = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let tumbled = Setup {
        files: vec![glob::Pattern::escape(&path.to_string_lossy())],
        live: false,
        sensors: channels.map(sensor).into(),
        ..setup.clone()
    };
    let mut recording = Recording::open(&tumbled, Path::new("/"))?;
    let rows_a_cell = ((CELL_S * setup.sampling_rate_hz).round() as usize).max(1);
    let mut block = Block::new();
    let (mut cells, mut sums) = (Vec::new(), Sums::default());
    while recording.next_block(&mut block)? {
        for row in block.rows() {
            if let &[x, y, z] = row {
                sums.add([x, y, z]);
            }
            if sums.rows == rows_a_cell {
                cells.push(std::mem::take(&mut sums).cell(setup.sampling_rate_hz));
            }
        }
    }
    Ok(cells)
}

/// Sums over a cell's rows, about the first of them.
#[derive(Debug, Default)]
struct Sums {
    rows: usize,
    first: [f64; 3],
    sums: [f64; 3],
    squares: [f64; 3],
}

impl Sums {
    fn add(&mut self, row: [f64; 3]) {
        if self.rows == 0 {
            self.first = row;
        }
        for (axis, value) in row.into_iter().enumerate() {
            let about = value - self.first[axis];
            self.sums[axis] += about;
            self.squares[axis] += about * about;
        }
        self.rows += 1;
    }

    fn cell(self, sampling_rate_hz: f64) -> Cell {
        let rows = self.rows as f64;
        Cell {
            seconds: rows / sampling_rate_hz,
            mean_m_s2: std::array::from_fn(|axis| self.first[axis] + self.sums[axis] / rows),
            variance: std::array::from_fn(|axis| {
                (self.squares[axis] / rows - (self.sums[axis] / rows).powi(2)).max(0.0)
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::Study;

    #[test]
    fn rows_become_cells_of_a_second_in_si_units_without_the_gains_of_the_study() {
        let folder = tempfile::tempdir().unwrap();
        let text = "[structure]\nname = \"t\"\n[[setup]]\nname = \"a\"\nfiles = [\"a.csv\"]\nsampling_rate_hz = 10\nunit = \"g\"\n[[setup.sensor]]\nchannel = \"x\"\nnode = 1\ngain = 1.05\noffset_m_s2 = 0.3\n[[setup.sensor]]\nchannel = \"y\"\nnode = 1\n";
        let setup = Study::from_text(text, folder.path()).unwrap().setups.remove(0);
        // A name that is a pattern as well.
        let file = folder.path().join("tumble [1].csv");
        let rows: String =
            (0..25).map(|row| format!("0.5,{},{}\n", -0.1, if row % 2 == 0 { 0.9 } else { 1.1 })).collect();
        std::fs::write(&file, format!("x,y,z\n{rows}")).unwrap();
        let cells = cells_of(&file, &setup, ["x", "y", "z"]).unwrap();
        assert_eq!(cells.len(), 2, "the third is not whole");
        let g = 9.806_65;
        for cell in cells {
            let expected = [0.5 * g, -0.1 * g, g];
            assert!(cell.mean_m_s2.iter().zip(expected).all(|(mean, expected)| (mean - expected).abs() < 1e-12));
            assert!(cell.variance[0] < 1e-20 && (cell.variance[2] - (0.1 * g).powi(2)).abs() < 1e-12, "{cell:?}");
        }
        let error = cells_of(&file, &setup, ["x", "y", "w"]).unwrap_err().to_string();
        assert!(error.contains("`w`") || error.contains("\"w\""), "{error}");
    }
}
