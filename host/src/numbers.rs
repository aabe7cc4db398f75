//! Numbers as engineers write them, the same in what commands print, in pictures and on the page; and as Fortran writes them, to be read.

/// A number with so many digits after the point; never "-0.00".
pub(crate) fn fixed(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|byte| matches!(byte, b'0' | b'.')) => zero.to_owned(),
        _ => text,
    }
}

/// The same with its sign, but for what rounds to nothing.
pub(crate) fn signed(value: f64, digits: usize) -> String {
    let text = fixed(value, digits);
    if value > 0.0 && text.bytes().any(|byte| matches!(byte, b'1'..=b'9')) { format!("+{text}") } else { text }
}

/// "1 window", "3 windows", "0 windows".
pub(crate) fn counted(count: u64, one: &str) -> String {
    format!("{count} {one}{}", if count == 1 { "" } else { "s" })
}

/// The verb that goes with a count.
pub(crate) fn is_or_are(count: u64) -> &'static str {
    if count == 1 { "is" } else { "are" }
}

/// Three digits, with an exponent where the number is far from 1.
pub(crate) fn short(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let exponent = value.abs().log10().floor();
    if (-3.0..5.0).contains(&exponent) {
        format!("{value:.*}", (2.0 - exponent).max(0.0) as usize)
    } else {
        format!("{value:.2e}")
    }
}

/// A number with its deviation, both with an exponent or both without.
pub(crate) fn with_std(value: f64, std: f64) -> String {
    let value = short(value);
    let std = if value.contains('e') { format!("{std:.2e}") } else { short(std) };
    format!("{value} ± {std}")
}

/// A height, to a metre from 100 m on and to three digits below.
pub(crate) fn metres(height_m: f64) -> String {
    let text = format!("{height_m:.0}");
    if height_m.abs() >= 100.0 { text + " m" } else { short(height_m) + " m" }
}

/// A probability in percent.
pub(crate) fn probability_text(probability: f64) -> String {
    match 100.0 * probability {
        little if little < 0.1 => "< 0.1 %".to_owned(),
        most if most > 99.9 => "> 99.9 %".to_owned(),
        percent => format!("{percent:.1} %"),
    }
}

/// A MAC, never rounded up, so that only a perfect one reads 1.0000.
pub(crate) fn mac_words(mac: f64, digits: usize) -> String {
    let unit = 10f64.powi(digits as i32);
    format!("{:.digits$}", (mac * unit).floor() / unit)
}

/// A number whose exponent may begin with Fortran's letter for double precision: `1.5D+3`.
pub(crate) fn fortran(text: &str) -> Option<f64> {
    text.replace(['d', 'D'], "e").parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_has_no_sign() {
        assert_eq!(
            ["-0.00", "0.00", "-0.01", "1"].map(|text| text.parse::<f64>().unwrap()).map(|value| fixed(value, 2)),
            ["0.00", "0.00", "-0.01", "1.00"]
        );
        assert_eq!([-0.004, 0.004, -0.006, 0.006].map(|value| signed(value, 2)), ["0.00", "0.00", "-0.01", "+0.01"]);
        assert_eq!([-0.04, 12.0].map(|value| signed(value, 1)), ["0.0", "+12.0"]);
    }

    #[test]
    fn heights_of_small_structures_keep_their_decimals() {
        assert_eq!([14.7, 443.6, 0.0, -9.25, 1234.5].map(metres), ["14.7 m", "444 m", "0 m", "-9.25 m", "1234 m"]);
    }

    #[test]
    fn a_mac_is_never_rounded_up() {
        assert_eq!(
            [1.0, 0.999_99, 0.999_94, 0.5].map(|mac| mac_words(mac, 4)),
            ["1.0000", "0.9999", "0.9999", "0.5000"]
        );
    }
}
