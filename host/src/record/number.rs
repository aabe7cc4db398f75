//! Numbers from bytes: the text readers' inner loop.

/// Powers of ten that a double holds exactly.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// Parses a decimal number without surrounding blanks; an empty cell and NaN in any case are NaN, anything else that
/// is not a number is `None`. The result is the double nearest to the text.
pub(super) fn parse_number(cell: &[u8]) -> Option<f64> {
    match parse_short(cell) {
        Some(value) => Some(value),
        None if cell.is_empty() => Some(f64::NAN),
        None => std::str::from_utf8(cell).ok()?.parse().ok(),
    }
}

/// The short cut for numbers whose digits and power of ten are both exact doubles: one multiplication or division then
/// rounds correctly (Clinger 1990, "How to read floating point numbers accurately", the fast path). `None` says
/// nothing about the text.
fn parse_short(cell: &[u8]) -> Option<f64> {
    let (negative, mut rest) = match cell {
        [b'-', rest @ ..] => (true, rest),
        [b'+', rest @ ..] => (false, rest),
        rest => (false, rest),
    };
    let mut mantissa: u64 = 0;
    let mut digits = 0_usize;
    let mut exponent: i32 = 0;
    let mut after_point = false;
    while let [byte, tail @ ..] = rest {
        let digit = byte.wrapping_sub(b'0');
        if digit < 10 {
            // Up to 19 digits fit 64 bits; longer texts take the other way.
            mantissa = mantissa.wrapping_mul(10).wrapping_add(u64::from(digit));
            digits += 1;
            exponent -= i32::from(after_point);
        } else if *byte == b'.' && !after_point {
            after_point = true;
        } else {
            break;
        }
        rest = tail;
    }
    if digits == 0 || digits > 19 || mantissa > 1 << 53 {
        return None;
    }
    if let [b'e' | b'E', tail @ ..] = rest {
        let (down, tail) = match tail {
            [b'-', tail @ ..] => (true, tail),
            [b'+', tail @ ..] => (false, tail),
            tail => (false, tail),
        };
        if tail.is_empty() || tail.len() > 4 {
            return None;
        }
        let mut written = 0_i32;
        for byte in tail {
            let digit = byte.wrapping_sub(b'0');
            if digit >= 10 {
                return None;
            }
            written = written * 10 + i32::from(digit);
        }
        exponent += if down { -written } else { written };
    } else if !rest.is_empty() {
        return None;
    }
    let power = *EXACT_POWERS.get(exponent.unsigned_abs() as usize)?;
    let size = if exponent < 0 { mantissa as f64 / power } else { mantissa as f64 * power };
    Some(if negative { -size } else { size })
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
        /// Correct rounding is what the standard library promises: the short cut must not differ by a bit.
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
