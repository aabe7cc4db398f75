//! NPY: types, orders, shapes, damage.

use npyz::WriterBuilder;

use super::*;

/// An NPY file by the library that others use, so that reader and writer do not share a mistake.
fn npy<T: npyz::AutoSerialize + Clone>(values: &[T], shape: &[u64], order: npyz::Order) -> Vec<u8> {
    let mut bytes = Vec::new();
    let options = npyz::WriteOptions::new().default_dtype().shape(shape).order(order);
    let mut writer = options.writer(&mut bytes).begin_nd().unwrap();
    writer.extend(values.iter().cloned()).unwrap();
    writer.finish().unwrap();
    bytes
}

/// A file whose header is `dictionary`.
pub(super) fn with_header(dictionary: &str, data: &[u8]) -> Vec<u8> {
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((dictionary.len() as u16).to_le_bytes());
    bytes.extend(dictionary.as_bytes());
    bytes.extend(data);
    bytes
}

#[test]
fn both_orders_and_both_directions_give_the_same_rows() {
    let rows = 5000_u32;
    let by_row: Vec<f64> = (0..rows).flat_map(|row| [f64::from(row), f64::from(row) + 0.5]).collect();
    let by_column: Vec<f64> =
        [0.0, 0.5].into_iter().flat_map(|add| (0..rows).map(move |row| f64::from(row) + add)).collect();
    let (tall, wide) = ([u64::from(rows), 2], [2, u64::from(rows)]);
    let files = [
        npy(&by_row, &tall, npyz::Order::C),
        npy(&by_column, &tall, npyz::Order::Fortran),
        npy(&by_column, &wide, npyz::Order::C),
        npy(&by_row, &wide, npyz::Order::Fortran),
    ];
    for file in files {
        for (channels, add) in [(&["1", "2"][..], [0.0, 0.5]), (&["2", "1"], [0.5, 0.0])] {
            let read = rows_of(&setup(channels, &["a.npy"]), "a.npy", &file);
            assert_eq!(read.len(), 5000);
            assert!((0..).zip(&read).all(|(row, values)| *values == add.map(|add| f64::from(row) + add)));
        }
    }
}

#[test]
fn every_numeric_type_is_read() {
    let one = setup(&["1"], &["a.npy"]);
    let expected = [[1.0], [100.0]];
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_i8, 100], &[2], npyz::Order::C)), expected);
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_u8, 100], &[2], npyz::Order::C)), expected);
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_i16, 100], &[2], npyz::Order::C)), expected);
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_u16, 100], &[2], npyz::Order::C)), expected);
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_i32, 100], &[2], npyz::Order::C)), expected);
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_u32, 100], &[2], npyz::Order::C)), expected);
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_i64, 100], &[2], npyz::Order::C)), expected);
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_u64, 100], &[2], npyz::Order::C)), expected);
    assert_eq!(rows_of(&one, "a.npy", &npy(&[1_f32, 100.0], &[2], npyz::Order::C)), expected);
    let big_endian = with_header("{'descr': '>i2', 'fortran_order': False, 'shape': (2,), }\n", &[0, 1, 0, 100]);
    assert_eq!(rows_of(&one, "a.npy", &big_endian), expected);
    let rows = rows_of(&one, "a.npy", &npy(&[1.0, f64::NAN, -3.0], &[3, 1], npyz::Order::C));
    assert!(rows[1][0].is_nan() && rows[2][0] == -3.0);
}

#[test]
fn what_is_wrong_with_an_array_is_named() {
    let one = setup(&["1"], &["a.npy"]);
    let check = |file: &[u8], parts: &[&str]| expect_error(&one, &[("a.npy", file)], parts);
    let whole = npy(&[1.0, 2.0, 3.0], &[3], npyz::Order::C);
    check(&whole[..whole.len() - 1], &["a.npy is cut short", "24 bytes", "23 there"]);
    check(&[whole.as_slice(), &[0; 8]].concat(), &["a.npy is not a NumPy array file", "24 bytes", "32 follow"]);
    check(&whole[..20], &["a.npy", "ends within its header"]);
    check(b"", &["a.npy is empty"]);
    check(b"1 2 3 4 5 6", &["a.npy is not a NumPy array file", "`1 2 3 4 `"]);
    check(b"\x93NUMPY\x09\x00\x01\x00", &["version 9"]);
    check(b"\x93NUMPY\x02\x00\xff\xff\xff\xff", &["4294967295 bytes"]);
    check(&npy(&[0.0_f64; 8], &[2, 2, 2], npyz::Order::C), &["a.npy", "shape [2, 2, 2]", "rows × channels"]);
    check(&npy::<f64>(&[], &[0, 3], npyz::Order::C), &["a.npy is empty"]);
    let header = |descr: &str, shape: &str| {
        with_header(&format!("{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"), &[0; 64])
    };
    check(&header("'<c16'", "(4,)"), &["a.npy", "`<c16`", "f4, f8", "astype"]);
    check(&header("'|S8'", "(4,)"), &["`|S8`"]);
    check(&header("'|O'", "(4,)"), &["`|O`"]);
    check(&header("[('x', '<f8')]", "(4,)"), &["[(\\'x\\', \\'<f8\\')]"]);
    check(&header("'<f8'", "(4"), &["not a tuple"]);
    check(&header("'<f8'", "(a, 4)"), &["`shape` holds `a`"]);
    check(&header("'<f8'", "(18446744073709551615, 18446744073709551615)"), &["shape [18446744073709551615"]);
    check(&with_header("{'descr': '<f8'}", &[]), &["no `fortran_order`"]);
    let infinite = npy(&[1.0, 2.0, f64::INFINITY], &[3], npyz::Order::C);
    expect_impossible(&setup(&["1"], &["a.npy"]), "a.npy", &infinite, &["a.npy, row 3", "\"1\"", "inf"]);
    expect_error(&setup(&["2"], &["a.npy"]), &[("a.npy", &whole)], &["`2`", "1 column"]);
}
