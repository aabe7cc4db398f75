//! Matrices by node and degree of freedom: files of pyNastran (made by `tests/foreign/files.py`), Abaqus' lines, and what is refused.

use std::path::Path;

use nalgebra::DMatrix;

use super::custom::Custom;
use super::matrices::WholeMatrices;
use super::node_files::{KnownRows, abaqus, dmig};
use crate::study::{CustomSource, GroupTerms, LayoutFile, MatrixSource, MatrixTerm};

fn term(name: &str) -> Vec<MatrixTerm> {
    vec![MatrixTerm { name: name.to_owned(), factor: 1.0 }]
}

fn source(file: Option<&str>, [stiffness, mass]: [&str; 2], layout: Option<LayoutFile>) -> MatrixSource {
    MatrixSource { file: file.map(Into::into), stiffness: term(stiffness), mass: term(mass), layout }
}

/// The chain of six springs that the files hold: 1e6 N/m each, and 2000 kg a node.
fn chain() -> DMatrix<f64> {
    DMatrix::from_fn(6, 6, |row, column| match row.abs_diff(column) {
        0 if row == 5 => 1e6,
        0 => 2e6,
        1 => -1e6,
        _ => 0.0,
    })
}

fn data() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data"))
}

#[test]
fn dmig_in_single_and_double_fields_is_the_chain_that_pynastran_wrote() {
    for file in ["pynastran_8.bdf", "pynastran_16.bdf"] {
        let read = WholeMatrices::read(&source(Some(file), ["KAAX", "maax"], None), data()).unwrap();
        assert_eq!(DMatrix::from(&read.stiffness), chain(), "{file}");
        assert_eq!(DMatrix::from(&read.mass), DMatrix::identity(6, 6) * 2e3);
        assert_eq!(read.places.join(" "), "11x 12x 13x 14x 15x 16x");
    }
}

#[test]
fn nodes_of_a_universal_file_place_the_rows() {
    let nodes = Some(LayoutFile::Numbered { file: "pyuff_nodes.unv".into(), factor: 1.0 });
    let read = WholeMatrices::read(&source(Some("pynastran_8.bdf"), ["KAAX", "MAAX"], nodes), data()).unwrap();
    let heights: Vec<f64> = read.nodes.iter().map(|node| node.position_m[2]).collect();
    assert_eq!(heights, [3.0, 6.0, 9.0, 12.0, 15.0, 18.0]);
    assert_eq!(read.nodes[4].name, "15");
    assert_eq!(read.nodes[4].rows, [Some(4), None, None, None, None, None]);
}

/// The same chain from Abaqus' lines, whose order of nodes is another: one triangle, masses of some nodes, a group of two.
#[test]
fn lines_of_abaqus_keep_to_the_rows_of_the_stiffness_matrix() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    let mut stiffness = "** STIFFNESS\n*MATRIX INPUT, NAME=K\n".to_owned();
    for at in (0..6).rev() {
        stiffness += &format!("{0},1, {0},1, {1:E}\n", 11 + at, if at == 5 { 1e6 } else { 2e6 });
        if at > 0 {
            stiffness += &format!("{},1, {},1, -1.0E+06\n", 10 + at, 11 + at);
        }
    }
    write("k.mtx", &stiffness);
    write("m.mtx", "16,1, 16,1, 5.0\n12 1 12 1 7.0\n");
    write("group.mtx", "13,1, 12,1, -1.0\n12,1, 12,1, 1.0\n13,1, 13,1, 1.0\n");
    let read = WholeMatrices::read(&source(None, ["k.mtx", "m.mtx"], None), folder.path()).unwrap();
    assert_eq!(DMatrix::from(&read.stiffness), chain());
    assert_eq!(DMatrix::from(&read.mass).diagonal().as_slice(), [0.0, 7.0, 0.0, 0.0, 0.0, 5.0]);
    let known = KnownRows { least: 6, places: read.places.clone() };
    let group = CustomSource {
        line: 1,
        name: "second".to_owned(),
        file: None,
        stiffness: term("group.mtx"),
        mass: Vec::new(),
        segments: None,
        typical: None,
        least: None,
        greatest: None,
        tied_to: None,
        channels: Vec::new(),
        group: Some(GroupTerms { std: 0.1, span_m: None }),
    };
    let change = Custom::read_whole(&group, folder.path(), &known).unwrap().in_full();
    let change = change.stiffness.unwrap();
    assert_eq!((change.nrows(), change[(1, 1)], change[(1, 2)], change[(2, 1)]), (6, 1.0, -1.0, -1.0));
    write("other.mtx", "12,2, 12,2, 1.0\n");
    write("market.mtx", "%%MatrixMarket matrix coordinate real symmetric\n1 1 1\n1 1 1\n");
    for ([stiffness, mass], expected) in [
        (["k.mtx", "other.mtx"], "other.mtx: node 12, degree of freedom 2 is none of the stiffness matrix' rows"),
        (
            ["market.mtx", "m.mtx"],
            "m.mtx: its rows are nodes and degrees of freedom, those of the matrices before it are not",
        ),
    ] {
        let error = WholeMatrices::read(&source(None, [stiffness, mass], None), folder.path()).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn fields_may_touch_be_split_by_commas_and_lack_the_letter_of_the_exponent() {
    let fixed = "DMIG    K       0       6       1       0\nDMIG    K       4       1               4       1       2.0+3\n+       5       1       -1.-1\n";
    let free = "DMIG,K,0,6,1,0\n$ a comment\nGRID,4,,0.,0.,0.\nDMIG,K,4,1,,4,1,2.0D+3,,+a\n+a,5,1,-.1\n";
    for text in [fixed, free] {
        let mut known = KnownRows::default();
        let matrix = DMatrix::from(&dmig(text, "K").unwrap().in_rows(&mut known).unwrap());
        assert_eq!(matrix, DMatrix::from_row_slice(2, 2, &[2e3, -0.1, -0.1, 0.0]), "{text}");
        assert_eq!(known.places.join(" "), "4x 5x");
    }
    let scalar =
        "DMIG    K       0       1       2       0\nDMIG    K       9       0               9       0       3.\n";
    let mut known = KnownRows::default();
    dmig(scalar, "k").unwrap().in_rows(&mut known).unwrap();
    assert_eq!(known.places.join(" "), "9");
}

#[test]
fn what_is_no_matrix_is_told_with_its_line() {
    let head = "DMIG    K       0       6       1       0\n";
    for (text, expected) in [
        ("GRID,1\n", "no DMIG cards"),
        ("DMIG    M       0       6       1       0\n", "no DMIG matrix `K`: it has M"),
        ("DMIG    K       0       2       1       0\n", "line 1: DMIG K: `2`"),
        ("DMIG    K       0       6       3       0\n", "line 1: DMIG K: entries are complex"),
        ("DMIG    K       0       6       5       0\n", "`5` where the type of real numbers"),
        ("DMIG    K       4       1               4       1       2.\n", "line 1: DMIG K: `4` where its first card"),
        (head, "has no entries"),
    ] {
        assert!(dmig(text, "K").unwrap_err().contains(expected), "{text}");
    }
    let wrong = format!("{head}DMIG    K       4       1               4       1       two\n");
    assert!(dmig(&wrong, "K").unwrap_err().contains("line 2: DMIG K: `4 1 two"));
    assert!(abaqus("1,1,1,1,2.\n1,1,x,1,2.\n").unwrap_err().contains("line 2: `1,1,x,1,2.`"));
    let whole = std::fs::read_to_string(data().join("pynastran_8.bdf")).unwrap();
    for length in 0..whole.len() {
        let _ = dmig(&whole[..length], "KAAX").map(|matrix| matrix.in_rows(&mut KnownRows::default()));
        let _ = abaqus(&whole[..length]);
    }
}
