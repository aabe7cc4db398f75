//! Nastran's bulk data, as decks and punched files have it: text flows in, the fields of one kind of card flow out.
//!
//! Fields are 8 or 16 columns wide or stand between commas, as the "Quick Reference Guide" of MSC and NX Nastran has them.

use std::path::Path;

use crate::numbers::fortran;

/// Whether a file is one of Nastran, punched or of bulk data, by its ending.
pub(crate) fn is_nastran(file: &Path) -> bool {
    let ending = file.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    ["pch", "bdf", "nas", "dat", "blk", "dmig"].iter().any(|known| ending.eq_ignore_ascii_case(known))
}

/// A number as Nastran and Fortran write it: `1.5D+3`, `1.5+3`.
pub(super) fn real(word: &str) -> Option<f64> {
    let word = word.trim();
    let is_bare = |(at, c): &(usize, char)| *at > 0 && matches!(c, '+' | '-');
    match word.char_indices().find(is_bare) {
        Some((at, _)) if !word.contains(['d', 'D', 'e', 'E']) => fortran(&format!("{}e{}", &word[..at], &word[at..])),
        _ => fortran(word),
    }
}

/// A card of bulk data: the line that it starts on, and its fields behind the keyword.
pub(super) struct Card<'a> {
    pub(super) line: usize,
    pub(super) fields: Vec<&'a str>,
}

impl<'a> Card<'a> {
    /// A field behind the keyword, from 0; empty where there is none.
    pub(super) fn field(&self, at: usize) -> &'a str {
        self.fields.get(at).copied().unwrap_or_default()
    }
}

/// The cards of a keyword, with what continues them.
pub(super) fn cards<'a>(text: &'a str, wanted: &str) -> Vec<Card<'a>> {
    let mut cards: Vec<Card<'_>> = Vec::new();
    let mut in_card = false;
    for (index, line) in text.lines().enumerate() {
        let line = line.split('$').next().unwrap_or_default().trim_end();
        if line.is_empty() {
            continue;
        }
        let first = line.split(',').next().unwrap_or_default();
        let first = if line.contains(',') { first } else { first.get(..8).unwrap_or(first) }.trim();
        let keyword = first.trim_end_matches('*');
        let continues = first.is_empty() || first.starts_with(['+', '*']);
        if keyword.eq_ignore_ascii_case(wanted) {
            cards.push(Card { line: index + 1, fields: Vec::new() });
            in_card = true;
        } else if !continues {
            in_card = false;
        }
        if let (true, Some(card)) = (in_card, cards.last_mut()) {
            card.fields.extend(fields(line, first.starts_with('*') || first.ends_with('*')));
        }
    }
    cards
}

/// The fields of a line behind its first: eight, or four wide ones, and not the mark of what continues it.
fn fields(line: &str, is_wide: bool) -> impl Iterator<Item = &str> {
    let (count, width) = if is_wide { (4, 16) } else { (8, 8) };
    let by_commas = line.contains(',');
    let mut words = line.split(',').skip(1);
    (0..count).map(move |at| {
        if by_commas {
            return words.next().unwrap_or_default().trim();
        }
        let from = 8 + at * width;
        let to = (from + width).min(line.len());
        line.get(from.min(to)..to).unwrap_or_default().trim()
    })
}
