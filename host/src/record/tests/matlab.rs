//! MATLAB v5: recordings and matrices, plain and compressed, in both byte orders.

use std::io::Write;

use proptest::prelude::*;

use super::*;
use crate::record::mat::{Class, read_matrix, variables};

/// Writes MATLAB v5 files as MathWorks' "MAT-File Format" describes them.
#[derive(Clone, Copy)]
pub(super) struct Writer {
    pub(super) big_endian: bool,
    pub(super) compressed: bool,
}

pub(super) const PLAIN: Writer = Writer { big_endian: false, compressed: false };
const DOUBLE: u32 = 6;
const MI_DOUBLE: u32 = 9;

impl Writer {
    fn word(self, word: u32) -> [u8; 4] {
        if self.big_endian { word.to_be_bytes() } else { word.to_le_bytes() }
    }

    fn element(self, kind: u32, content: &[u8]) -> Vec<u8> {
        let mut bytes = [self.word(kind), self.word(content.len() as u32)].concat();
        bytes.extend(content);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    }

    fn words(self, kind: u32, words: &[u32]) -> Vec<u8> {
        self.element(kind, &words.iter().flat_map(|word| self.word(*word)).collect::<Vec<_>>())
    }

    fn doubles(self, values: &[f64]) -> Vec<u8> {
        let bytes = |value: &f64| if self.big_endian { value.to_be_bytes() } else { value.to_le_bytes() };
        self.element(MI_DOUBLE, &values.iter().flat_map(bytes).collect::<Vec<_>>())
    }

    /// A variable of the given class flags and dimensions; `data` are the elements of its numbers.
    fn variable(self, name: &str, flags: u32, dimensions: &[u32], data: &[Vec<u8>]) -> Vec<u8> {
        let header = [self.words(6, &[flags, 0]), self.words(5, dimensions), self.element(1, name.as_bytes())].concat();
        let matrix = self.element(14, &[header, data.concat()].concat());
        if !self.compressed {
            return matrix;
        }
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(&matrix).unwrap();
        let deflated = encoder.finish().unwrap();
        [&self.word(15)[..], &self.word(deflated.len() as u32), &deflated].concat()
    }

    pub(super) fn matrix(self, name: &str, rows: u32, columns: u32, values: &[f64]) -> Vec<u8> {
        self.variable(name, DOUBLE, &[rows, columns], &[self.doubles(values)])
    }

    pub(super) fn file(self, variables: &[Vec<u8>]) -> Vec<u8> {
        let mut bytes = b"MATLAB 5.0 MAT-file".to_vec();
        bytes.resize(124, b' ');
        bytes.extend(if self.big_endian { *b"\x01\x00MI" } else { *b"\x00\x01IM" });
        bytes.extend(variables.concat());
        bytes
    }
}

fn all_writers() -> impl Iterator<Item = Writer> {
    [(false, false), (false, true), (true, false), (true, true)]
        .into_iter()
        .map(|(big_endian, compressed)| Writer { big_endian, compressed })
}

#[test]
fn recordings_lie_either_way() {
    let tall: Vec<f64> = (0..5000).map(f64::from).chain((0..5000).map(|row| f64::from(row) + 0.5)).collect();
    let wide: Vec<f64> = (0..5000).flat_map(|row| [f64::from(row), f64::from(row) + 0.5]).collect();
    for writer in all_writers() {
        let rate = writer.matrix("fs", 1, 1, &[50.0]);
        let time = writer.matrix("t", 1, 5000, &vec![0.0; 5000]);
        for data in [writer.matrix("acc", 5000, 2, &tall), writer.matrix("acc", 2, 5000, &wide)] {
            let file = writer.file(&[rate.clone(), data, time.clone()]);
            let rows = rows_of(&setup(&["2", "1"], &["a.mat"]), "a.mat", &file);
            assert_eq!(rows.len(), 5000);
            assert!((0..).zip(&rows).all(|(row, values)| *values == [f64::from(row) + 0.5, f64::from(row)]));
            let mut named = setup(&["1"], &["a.mat"]);
            named.variable = Some("t".to_owned());
            assert_eq!(rows_of(&named, "a.mat", &file), vec![[0.0]; 5000]);
        }
    }
}

#[test]
fn numbers_stored_small_are_read() {
    // MATLAB keeps a double that is a small whole number in a byte, four bytes of them within the tag.
    for writer in all_writers() {
        let packed = [&writer.word(3 << 16 | 2)[..], &[1, 2, 200, 0]].concat();
        let bytes = writer.variable("x", DOUBLE, &[3, 1], &[packed]);
        let one = setup(&["1"], &["a.mat"]);
        assert_eq!(rows_of(&one, "a.mat", &writer.file(&[bytes])), [[1.0], [2.0], [200.0]]);
        let number = if writer.big_endian { [0xff, 0xfe, 1, 0] } else { [0xfe, 0xff, 0, 1] };
        let shorts = writer.variable("x", 10, &[2, 1], &[writer.element(3, &number)]);
        assert_eq!(rows_of(&one, "a.mat", &writer.file(&[shorts])), [[-2.0], [256.0]]);
    }
}

#[test]
fn matrices_are_read_full_and_sparse() {
    for writer in all_writers() {
        let full = writer.matrix("k", 2, 3, &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        // [0 7; 8 9] column by column: row indices, where each column starts, values.
        let parts = [writer.words(5, &[1, 0, 1]), writer.words(5, &[0, 1, 3]), writer.doubles(&[8.0, 7.0, 9.0])];
        let sparse = writer.variable("m", 5, &[2, 2], &parts);
        let text = writer.variable("note", 4, &[1, 2], &[writer.element(4, &[0, 65, 0, 66])]);
        let folder = folder(&[("a.mat", &writer.file(&[text, full, sparse]))]);
        let path = folder.path().join("a.mat");
        assert_eq!(read_matrix(&path, "k").unwrap(), nalgebra::dmatrix![1.0, 3.0, 5.0; 2.0, 4.0, 6.0]);
        assert_eq!(read_matrix(&path, "m").unwrap(), nalgebra::dmatrix![0.0, 7.0; 8.0, 9.0]);
        let classes: Vec<Class> = variables(&path).unwrap().iter().map(|variable| variable.class).collect();
        assert_eq!(classes, [Class::Other("char"), Class::Numeric, Class::Sparse]);
        let error = read_matrix(&path, "c").unwrap_err().to_string();
        assert!(error.contains("no variable `c`") && error.contains("`k` (2 × 3, numeric)"), "{error}");
        assert!(read_matrix(&path, "note").unwrap_err().to_string().contains("class char"));
    }
}

#[test]
fn what_is_wrong_with_a_file_is_named() {
    let one = setup(&["1"], &["a.mat"]);
    let check = |file: &[u8], parts: &[&str]| expect_error(&one, &[("a.mat", file)], parts);
    let (a, b) = (PLAIN.matrix("a", 3, 2, &[1.0; 6]), PLAIN.matrix("b", 4, 2, &[1.0; 8]));
    check(&PLAIN.file(&[a.clone(), b]), &["a.mat has several matrices", "`a` (3 × 2", "`b` (4 × 2", "`variable`"]);
    check(&PLAIN.file(&[]), &["no matrix", "no variables"]);
    check(&PLAIN.file(&[PLAIN.matrix("fs", 1, 1, &[50.0])]), &["no matrix", "`fs` (1 × 1"]);
    check(b"", &["a.mat is empty"]);
    check(b"1 2 3", &["not a MATLAB file of version 5 or 7.3", "'-v7'"]);
    let mut hdf5 = b"MATLAB 7.3 MAT-file, Platform".to_vec();
    hdf5.resize(1000, 0);
    check(&hdf5, &["a.mat", "not an HDF5 file", "'-v7.3'"]);
    let whole = PLAIN.file(std::slice::from_ref(&a));
    check(&whole[..whole.len() - 8], &["a.mat is cut short", "variable `a`"]);
    check(&whole[..140], &["a.mat is cut short", "byte 128"]);
    let negative = PLAIN.matrix("a", 0xffff_fffb, 2, &[1.0; 6]);
    check(&PLAIN.file(&[negative]), &["a.mat", "a dimension of -5"]);
    let infinite = PLAIN.matrix("a", 3, 2, &[1.0, 1.0, f64::NEG_INFINITY, 1.0, 1.0, 1.0]);
    expect_impossible(&one, "a.mat", &PLAIN.file(&[infinite]), &["a.mat, row 3", "\"1\"", "inf"]);
    check(&PLAIN.file(&[PLAIN.matrix("a", 9, 2, &[1.0; 6])]), &["`a`", "48 bytes", "9 × 2 need 144"]);
    let mut named = one.clone();
    named.variable = Some("z".to_owned());
    expect_error(&named, &[("a.mat", &whole)], &["no variable `z`", "`a` (3 × 2, numeric)"]);
    named.variable = Some("a".to_owned());
    let numbers = || PLAIN.doubles(&[1.0; 6]);
    let complex = PLAIN.variable("a", DOUBLE | 0x800, &[3, 2], &[numbers(), numbers()]);
    expect_error(&named, &[("a.mat", &PLAIN.file(&[complex]))], &["`a` is complex", "real part"]);
    let cube = PLAIN.variable("a", DOUBLE, &[3, 2, 1], &[numbers()]);
    expect_error(&named, &[("a.mat", &PLAIN.file(&[cube]))], &["`a` is 3 × 2 × 1", "two dimensions"]);
    let empty = PLAIN.matrix("a", 0, 2, &[]);
    expect_error(&named, &[("a.mat", &PLAIN.file(&[empty]))], &["`a` is empty"]);
    let packed = Writer { big_endian: false, compressed: true };
    let mut damaged = packed.file(&[packed.matrix("a", 3, 2, &[1.0; 6])]);
    let length = damaged.len();
    damaged[140..length - 4].fill(0xff);
    expect_error(&named, &[("a.mat", &damaged)], &["a.mat"]);
}

/// 72 MB of numbers in a file of 70 KB: they are read in blocks from disk, and only those of the last rows are not zero.
#[test]
fn what_inflates_to_much_is_read_from_disk() {
    let writer = Writer { big_endian: false, compressed: true };
    let rows = 4_500_000;
    let mut values = vec![0.0; 2 * rows];
    (values[rows - 1], values[2 * rows - 1]) = (7.0, -3.0);
    let file = writer.file(&[writer.matrix("a", rows as u32, 2, &values)]);
    drop(values);
    assert!(file.len() < 1 << 20, "{} bytes", file.len());
    let folder = folder(&[("a.mat", &file)]);
    let setup = setup(&["1", "2"], &["a.mat"]);
    let mut recording = Recording::open(&setup, folder.path()).unwrap();
    let (mut block, mut last, mut count) = (Block::new(), Vec::new(), 0);
    while recording.next_block(&mut block).unwrap() {
        count += block.row_count();
        last = block.rows().last().unwrap().to_vec();
    }
    assert_eq!((count, last), (rows, vec![7.0, -3.0]));
    let numbers = crate::record::mat::inflated_into_memory(&folder.path().join("a.mat"));
    assert_eq!(numbers, Some(false));
}

proptest! {
    #[test]
    fn what_is_written_is_read(rows in 1_u32..40, columns in 1_u32..6, big_endian: bool, compressed: bool, seed in -1e3..1e3) {
        let writer = Writer { big_endian, compressed };
        let values: Vec<f64> = (0..rows * columns).map(|index| seed * f64::from(index)).collect();
        let folder = folder(&[("a.mat", &writer.file(&[writer.matrix("a", rows, columns, &values)]))]);
        let matrix = read_matrix(&folder.path().join("a.mat"), "a").unwrap();
        prop_assert_eq!(matrix.as_slice(), &values[..]);
    }
}

#[test]
fn a_small_sparse_matrix_that_announces_billions_of_entries_is_refused_before_they_are_read() {
    // As they compress best: 80 million zeros are 80 KB of file, and would be 640 MB of numbers.
    let many = vec![0; 80_000_000];
    let writer = Writer { compressed: true, ..PLAIN };
    let parts = [writer.element(2, &many), writer.words(5, &[0, 1, 2]), writer.element(2, &many)];
    let file = writer.file(&[writer.variable("k", 5, &[2, 2], &parts)]);
    assert!(file.len() < 400_000, "{} bytes", file.len());
    let folder = folder(&[("a.mat", &file)]);
    let error = read_matrix(&folder.path().join("a.mat"), "k").unwrap_err().to_string();
    for part in ["a.mat", "variable `k`", "80000000 numbers where there are 4 at most"] {
        assert!(error.contains(part), "no {part:?} in: {error}");
    }
}
