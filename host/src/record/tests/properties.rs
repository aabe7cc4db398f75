//! Whatever bytes a file holds, reading ends in rows or in an error, never in a panic.

use proptest::prelude::*;

use super::arrays::with_header;
use super::matlab::{PLAIN, Writer};
use super::*;
use crate::record::mat::{read_matrix, variables};

/// Reads a file in any format; that it comes back at all is what is checked.
fn survive(name: &str, content: &[u8]) {
    let folder = folder(&[(name, content)]);
    for channels in [&["1"][..], &["2", "a"], &["a"], &["3", "1", "2"]] {
        // Rows, where there are any, hold the promises that `read` checks.
        let _ = read(&setup(channels, &[name]), folder.path());
    }
    let path = folder.path().join(name);
    for variable in variables(&path).unwrap_or_default() {
        let _ = read_matrix(&path, &variable.name);
    }
}

/// A sound file with some bytes overwritten, and cut at some length.
fn damage(mut bytes: Vec<u8>, from: usize, places: &[(prop::sample::Index, u8)], cut: prop::sample::Index) -> Vec<u8> {
    for (place, byte) in places {
        let place = from + place.index(bytes.len() - from);
        bytes[place] = *byte;
    }
    if places.len() % 2 == 1 {
        bytes.truncate(cut.index(bytes.len()));
    }
    bytes
}

fn damages() -> impl Strategy<Value = Vec<(prop::sample::Index, u8)>> {
    prop::collection::vec(any::<(prop::sample::Index, u8)>(), 1..6)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn arbitrary_bytes(content in prop::collection::vec(any::<u8>(), 0..600)) {
        for name in ["a.txt", "a.csv", "a.npy", "a.mat", "a.parquet", "a.uff"] {
            survive(name, &content);
        }
    }

    #[test]
    fn arbitrary_text(content in "(([0-9.,;\te \"#%-]|nan|inf|a|t|\r?\n){0,20}\r?\n?){0,8}") {
        survive("a.txt", content.as_bytes());
        survive("a.csv", content.as_bytes());
        survive("a.csv", format!("t,a\n{content}").as_bytes());
    }

    #[test]
    fn arbitrary_times(times_s in prop::collection::vec(any::<f64>(), 0..8), scale in 0.0..0.1) {
        let wild: String = times_s.iter().map(|time_s| format!("{time_s},1\n")).collect();
        survive("a.csv", format!("time,a\n{wild}").as_bytes());
        let tame: String = (0..).zip(&times_s).map(|(row, _)| format!("{},1\n", scale * f64::from(row))).collect();
        survive("a.csv", format!("time,a\n{tame}").as_bytes());
    }

    #[test]
    fn arbitrary_headers_of_arrays(shape in "\\(?[0-9, ]{0,24}\\)?", descr in "'[<>|][fiucSO][0-9]{1,2}'", data in prop::collection::vec(any::<u8>(), 0..200)) {
        survive("a.npy", &with_header(&format!("{{'descr': {descr}, 'fortran_order': True, 'shape': {shape}}}"), &data));
    }

    #[test]
    fn damaged_arrays(places in damages(), cut: prop::sample::Index) {
        let sound = with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (4, 3), }", &[7; 96]);
        survive("a.npy", &damage(sound, 6, &places, cut));
    }

    #[test]
    fn damaged_matrices(places in damages(), cut: prop::sample::Index, big_endian: bool, compressed: bool) {
        let writer = Writer { big_endian, compressed };
        let variables = [writer.matrix("a", 4, 3, &[1.5; 12]), writer.matrix("b", 1, 3, &[0.5; 3])];
        survive("a.mat", &damage(writer.file(&variables), 128, &places, cut));
    }

    #[test]
    fn arbitrary_universal_files(words in prop::collection::vec("(-1|58|58b|1|2|4|11|12|0.02|1e9|x|99999999999999999999|\n)", 0..80)) {
        survive("a.uff", format!("    -1\n    58\na\nb\nc\nd\ne\n{}", words.join(" ")).as_bytes());
        survive("a.uff", format!("    -1\n    58b     1     2    11    16\na\nb\nc\nd\ne\n{}", words.join(" ")).as_bytes());
    }

    #[test]
    fn arbitrary_elements(words in prop::collection::vec(prop_oneof![0_u32..20, any::<u32>()], 0..60)) {
        let content: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        survive("a.mat", &PLAIN.file(&[content]));
    }
}
