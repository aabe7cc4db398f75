//! HDF5 and MATLAB v7.3, as h5py and hdf5storage write them; `tests/foreign/files.py` made the files.

use super::*;
use crate::record::hdf5::Hdf5File;
use crate::record::mat::{Class, read_matrix, variables};

/// The folder of files that other programs wrote.
pub(super) fn foreign() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"))
}

/// The recording that all of them hold: 300 rows of two channels, in numbers that 24 bits hold exactly.
pub(super) fn same() -> Vec<Vec<f64>> {
    read(&setup(&["1", "2"], &["same.npy"]), foreign()).unwrap().0
}

#[test]
fn matrices_of_matlab_7_3_are_read_full_and_sparse() {
    let path = foreign().join("matlab73.mat");
    let found = variables(&path).unwrap();
    let told: Vec<String> = found.iter().map(ToString::to_string).collect();
    assert_eq!(told, ["`K` (6 × 6, sparse)", "`M` (6 × 6, numeric)", "`note` (1 × 7, char)"]);
    assert_eq!(found[0].class, Class::Sparse);
    let (k, m) = (read_matrix(&path, "K").unwrap(), read_matrix(&path, "M").unwrap());
    for row in 0..6_usize {
        for column in 0..6 {
            let spring = match row.abs_diff(column) {
                0 if row == 5 => 1e6,
                0 => 2e6,
                1 => -1e6,
                _ => 0.0,
            };
            assert_eq!(k[(row, column)], spring);
            assert_eq!(m[(row, column)], if row == column { 2e3 } else { 0.0 });
        }
    }
    let error = read_matrix(&path, "note").unwrap_err().to_string();
    assert!(error.contains("matlab73.mat, variable `note` is of class char"), "{error}");
}

#[test]
fn recordings_of_matlab_7_3_are_those_of_numpy() {
    let mut setup = setup(&["1", "2"], &["matlab73_record.mat"]);
    assert_eq!(read(&setup, foreign()).unwrap().0, same());
    setup.variable = Some("acc".to_owned());
    for file in ["matlab73_record.mat", "hdf5storage.mat"] {
        setup.files = vec![file.to_owned()];
        assert_eq!(read(&setup, foreign()).unwrap().0, same(), "{file}");
    }
}

/// What of a file is read, or the first error.
fn everything(path: &Path) -> Result<Vec<Vec<f64>>, String> {
    let file = Hdf5File::open(path).map_err(|error| error.to_string())?;
    let objects = file.objects().map_err(|error| error.to_string())?;
    let datasets = objects.iter().filter(|object| object.dataset.is_some());
    datasets.map(|object| file.all_numbers(object, 1 << 20).map_err(|error| error.to_string())).collect()
}

#[test]
fn layouts_and_filters_give_the_same_numbers() {
    let rows = same();
    let row_by_row: Vec<f64> = rows.iter().flatten().copied().collect();
    assert_eq!(everything(&foreign().join("h5py_matrix.h5")).unwrap().concat(), row_by_row);
    let column = |channel: usize| rows.iter().map(|row| row[channel]).collect::<Vec<f64>>();
    assert_eq!(everything(&foreign().join("h5py_channels.h5")).unwrap(), [column(0), column(1)]);
    let mut latest = everything(&foreign().join("h5py_latest.h5")).unwrap();
    latest.sort_by_key(Vec::len);
    assert_eq!(latest, [row_by_row[..6].to_vec(), row_by_row]);
    let error = everything(&foreign().join("h5py_unread.h5")).unwrap_err();
    for part in ["h5py_unread.h5, `listed`", "chunks", "libver='earliest'"] {
        assert!(error.contains(part), "no {part:?} in: {error}");
    }
}

#[test]
fn attributes_are_numbers_and_texts_wherever_they_stand() {
    let file = Hdf5File::open(&foreign().join("h5py_channels.h5")).unwrap();
    let objects = file.objects().unwrap();
    let paths: Vec<&str> = objects.iter().map(|object| object.path.as_str()).collect();
    assert_eq!(paths, ["", "run 1", "run 1/top-x", "run 1/top-y"]);
    assert_eq!(objects[0].text("title"), Some("a mast"));
    assert_eq!(objects[1].number("fs"), Some(50.0));
    assert_eq!(objects[3].text("units"), Some("m/s2"));
}

/// Files cut at every length, and with every byte changed: numbers or an error that names the file, and nothing that takes long.
#[test]
fn damage_ends_in_an_error_or_in_numbers() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["matlab73.mat", "h5py_matrix.h5", "h5py_channels.h5", "h5py_latest.h5"] {
        let whole = std::fs::read(foreign().join(name)).unwrap();
        let sound = everything(&foreign().join(name)).unwrap_or_default();
        let path = folder.path().join(name);
        let check = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let read = everything(&path);
            if let Err(error) = &read {
                assert!(error.contains(name) && error.len() < 1024, "{error}");
            }
            for variable in variables(&path).unwrap_or_default() {
                let _ = read_matrix(&path, &variable.name);
            }
            read
        };
        for length in (0..whole.len()).step_by(31) {
            if let Ok(read) = check(&whole[..length]) {
                assert_eq!(read, sound, "{name} cut to {length} bytes");
            }
        }
        for place in (0..whole.len()).step_by(17) {
            let mut changed = whole.clone();
            changed[place] ^= 0xff;
            let _ = check(&changed);
            changed[place] = whole[place] ^ 0x01;
            let _ = check(&changed);
        }
    }
}
