//! What a mistyped word was most likely meant to be, for errors that offer it.

/// The known word that is most like the one found, where their likeness (Jaro and Winkler's, 0 to 1) is above `least`.
pub(crate) fn nearest<'a>(found: &str, known: impl IntoIterator<Item = &'a str>, least: f64) -> Option<&'a str> {
    let alike = known.into_iter().map(|word| (word, strsim::jaro_winkler(found, word)));
    let (best, likeness) = alike.max_by(|a, b| a.1.total_cmp(&b.1))?;
    (likeness > least).then_some(best)
}
