//! Numbers from bytes: the text readers' inner loop.

/// Parses a decimal number without surrounding blanks; an empty cell and NaN in any case are NaN, anything else that
/// is not a number is `None`. The result is the double nearest to the text.
pub(super) fn parse_number(cell: &[u8]) -> Option<f64> {
    if cell.is_empty() { Some(f64::NAN) } else { fast_float2::parse(cell).ok() }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::parse_number;

    #[test]
    fn missing_samples_are_nan_and_words_are_nothing() {
        for cell in ["", "NaN", "nan", "NAN", "-nan"] {
            assert!(parse_number(cell.as_bytes()).is_some_and(f64::is_nan), "{cell}");
        }
        for cell in ["-", "+", ".", "e5", "1e", "1e+", "1,5", "1.2.3", "12a", "--1", "0x10", "1 2", "\u{ff11}"] {
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
            if !cell.is_empty() {
                prop_assert_eq!(parse_number(&cell).map(f64::to_bits), expected.map(f64::to_bits));
            }
        }
    }
}
