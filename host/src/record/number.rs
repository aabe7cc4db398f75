//! Numbers from bytes: the text readers' inner loop.

/// What spreadsheets write where there is no value, in the languages in which they begin so.
const NOT_AVAILABLE: [&[u8]; 7] = [b"#N/A", b"#NA", b"#NV", b"#N/D", b"#N/B", b"#I/T", b"#N/A!"];

/// Parses a decimal number without surrounding blanks; an empty cell, NaN in any case and a spreadsheet's word for no value are NaN,
/// anything else that is not a number is `None`. The result is the double nearest to the text.
pub(super) fn parse_number(cell: &[u8]) -> Option<f64> {
    match cell.first() {
        None => Some(f64::NAN),
        Some(b'#') => NOT_AVAILABLE.contains(&cell).then_some(f64::NAN),
        Some(_) => fast_float2::parse(cell).ok(),
    }
}

/// The same of a cell between `separator`s: where that is no comma, a comma may stand for the decimal point, as in 1,5.
pub(super) fn parse_cell(cell: &[u8], separator: u8) -> Option<f64> {
    const LONGEST: usize = 64;
    let number = parse_number(cell);
    if number.is_some() || separator == b',' || cell.contains(&b'.') {
        return number;
    }
    let mut buffer = [0; LONGEST];
    let copy = buffer.get_mut(..cell.len())?;
    copy.copy_from_slice(cell);
    // A second one stays, and is no number's.
    *copy.iter_mut().find(|byte| **byte == b',')? = b'.';
    parse_number(copy)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{parse_cell, parse_number};

    #[test]
    fn a_comma_is_a_decimal_point_where_it_separates_no_cells() {
        assert_eq!(parse_cell(b"-1,5e-3", b';'), Some(-1.5e-3));
        assert_eq!(parse_cell(b"-1.5", b';'), Some(-1.5));
        for (cell, separator) in [(&b"1,5"[..], b','), (b"1,234.5", b';'), (b"1,234,567", b';'), (b",", b'\t')] {
            assert_eq!(parse_cell(cell, separator), None);
        }
        assert_eq!(parse_cell(&[b'1'; 400], b';'), Some(f64::INFINITY));
    }

    #[test]
    fn missing_samples_are_nan_and_words_are_nothing() {
        for cell in ["", "NaN", "nan", "NAN", "-nan", "#N/A", "#NV"] {
            assert!(parse_number(cell.as_bytes()).is_some_and(f64::is_nan), "{cell}");
        }
        for cell in [
            "-", "+", ".", "e5", "1e", "1e+", "1,5", "1.2.3", "12a", "--1", "0x10", "1 2", "\u{ff11}", "#", "#1",
            "#DIV/0!",
        ] {
            assert_eq!(parse_number(cell.as_bytes()), None, "{cell}");
        }
        assert_eq!(parse_number(b"\xff1"), None);
        assert_eq!(parse_number(b"-8.1722275e-002"), Some(-8.1722275e-2));
        assert_eq!(parse_number(b".5"), Some(0.5));
        assert_eq!(parse_number(b"5."), Some(5.0));
        assert_eq!(parse_number(b"1e999"), Some(f64::INFINITY));
    }

    proptest! {
        /// Correct rounding is what the standard library promises: the faster parser must not differ by a bit.
        #[test]
        fn agrees_with_the_standard_library(text in "[-+]?[0-9]{0,21}\\.?[0-9]{0,21}([eE][-+]?[0-9]{1,5})?") {
            let expected = if text.is_empty() { Some(f64::NAN) } else { text.parse::<f64>().ok() };
            prop_assert_eq!(parse_number(text.as_bytes()).map(f64::to_bits), expected.map(f64::to_bits));
        }

        #[test]
        fn agrees_on_what_programs_print(value in any::<f64>().prop_filter("finite", |value| value.is_finite())) {
            for text in [format!("{value}"), format!("{value:e}"), format!("{value:.6}")] {
                let expected: f64 = text.parse().unwrap();
                prop_assert_eq!(parse_number(text.as_bytes()).map(f64::to_bits), Some(expected.to_bits()));
            }
        }

        #[test]
        fn any_bytes_are_safe(cell in prop::collection::vec(any::<u8>(), 0..64)) {
            let expected = std::str::from_utf8(&cell).ok().and_then(|text| text.parse::<f64>().ok());
            if !cell.is_empty() && !cell.starts_with(b"#") {
                prop_assert_eq!(parse_number(&cell).map(f64::to_bits), expected.map(f64::to_bits));
            }
        }
    }
}
