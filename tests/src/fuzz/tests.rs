//! The corpora as they are, damaged, and any bytes, through every target.

use std::fs;

use proptest::prelude::*;

use super::{TARGETS, Target};
use crate::repository;

/// Inputs of a target that are kept in the repository: what is sound, and what once went wrong.
fn corpus(name: &str) -> Vec<Vec<u8>> {
    let folder = repository().join("fuzz/corpus").join(name);
    let mut files: Vec<_> = fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{} is empty", folder.display());
    files.into_iter().map(|file| fs::read(file).unwrap()).collect()
}

/// Some bytes overwritten, a piece cut out or put in twice.
fn damaged(
    mut bytes: Vec<u8>,
    places: &[(prop::sample::Index, u8)],
    piece: Option<[prop::sample::Index; 2]>,
) -> Vec<u8> {
    if bytes.is_empty() {
        return bytes;
    }
    for (place, byte) in places {
        let place = place.index(bytes.len());
        bytes[place] = *byte;
    }
    if let Some(ends) = piece {
        let mut ends = ends.map(|end| end.index(bytes.len()));
        ends.sort_unstable();
        let cut: Vec<u8> = bytes.drain(ends[0]..ends[1]).collect();
        if places.len() % 2 == 1 {
            bytes.extend(cut.repeat(2));
        }
    }
    bytes
}

/// Runs a target with its corpus, with damaged inputs, and with any bytes.
fn try_out(name: &str, target: Target) {
    let corpus = corpus(name);
    corpus.iter().for_each(|bytes| target(bytes));
    let any_bytes = prop::collection::vec(any::<u8>(), 0..300);
    let damage = (
        prop::sample::select(corpus),
        prop::collection::vec(any::<(prop::sample::Index, u8)>(), 0..6),
        prop::option::of(any::<[prop::sample::Index; 2]>()),
    );
    let mut runner = proptest::test_runner::TestRunner::new(ProptestConfig::with_cases(128));
    let tried = runner.run(&any_bytes, |bytes| {
        target(&bytes);
        Ok(())
    });
    tried.unwrap();
    let tried = runner.run(&damage, |(bytes, places, piece)| {
        target(&damaged(bytes, &places, piece));
        Ok(())
    });
    tried.unwrap();
}

macro_rules! tests {
    ($($name:ident)*) => {
        $(#[test]
        fn $name() {
            try_out(stringify!($name), super::$name);
        })*

        #[test]
        fn every_target_is_tried_out_and_has_a_program() {
            let tried = [$(stringify!($name)),*];
            assert_eq!(tried, TARGETS.map(|(name, _)| name));
            for name in tried {
                assert!(repository().join(format!("fuzz/fuzz_targets/{name}.rs")).is_file(), "{name}");
            }
        }
    };
}

tests! {
    frame message node host study beam layout mtx npy_matrix mat_matrix white_space table npy mat parquet uff hdf5 wav sac mseed tdms udbf dmig
}
