//! Excerpts of what a command prints, held against what it prints now.

use super::markdown::Block;

/// By how many units of its last digit a number may differ: processors round differently.
const LAST_DIGITS: f64 = 2.0;

/// Lines of the excerpt that the output does not have, in this order; `...` stands for whatever is left out.
pub(crate) fn lines_not_printed<'a>(block: &'a Block, output: &str) -> Vec<(usize, &'a str)> {
    let mut printed = output.lines();
    let mut missing = Vec::new();
    for (offset, line) in block.lines.iter().enumerate() {
        let is_drawn = line.chars().all(|sign| sign.is_whitespace() || ('\u{2500}'..='\u{257f}').contains(&sign));
        if is_drawn || line.trim() == "..." {
            continue;
        }
        // A line that is not there must not use up those that are.
        let mut ahead = printed.clone();
        if ahead.any(|other| is_same(line, other)) {
            printed = ahead;
        } else {
            missing.push((block.first_line + offset, line.as_str()));
        }
    }
    missing
}

/// Whether two lines have the same words, numbers but for their last digit; columns may be wider.
fn is_same(expected: &str, printed: &str) -> bool {
    let (mut expected, mut printed) = (expected.split_whitespace(), printed.split_whitespace());
    loop {
        match (expected.next(), printed.next()) {
            (None, None) => return true,
            (Some(a), Some(b)) if a == b || is_near(a, b) => {}
            _ => return false,
        }
    }
}

fn is_near(expected: &str, printed: &str) -> bool {
    let number = |word: &str| {
        let word = word.trim_matches([',', ';', ':', '(', ')']);
        Some((word.parse::<f64>().ok()?, unit_of_last_digit(word)))
    };
    match (number(expected), number(printed)) {
        (Some((a, unit)), Some((b, other_unit))) => (a - b).abs() <= (LAST_DIGITS + 0.01) * unit.max(other_unit),
        _ => false,
    }
}

/// The value of a number's last digit: 0.001 of 2.345, 1e-17 of 7.21e-15.
fn unit_of_last_digit(number: &str) -> f64 {
    let (mantissa, exponent) = number.split_once('e').unwrap_or((number, "0"));
    let decimals = mantissa.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    10f64.powi(exponent.parse::<i32>().unwrap_or(0) - decimals as i32)
}

#[test]
fn numbers_may_differ_in_their_last_digit_and_words_in_nothing() {
    assert!(is_same("│ 1 ┆ 0.1080 ┆ 7.21e-15 │", "│  1 ┆  0.1081 ┆ 7.22e-15 │"));
    assert!(!is_same("│ 1 ┆ 0.1080 │", "│ 1 ┆ 0.1090 │"));
    assert!(!is_same("Verdict: effect", "Verdict: unknown"));
    assert!(!is_same("a b", "a b c"));
}
