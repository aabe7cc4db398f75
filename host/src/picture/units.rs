//! Units of what setups' spectra are of.

use crate::study::{Motion, Setup};

/// The unit of the motion; of setups that differ, all of them.
pub(super) fn motion_unit<'a>(setups: impl IntoIterator<Item = &'a Setup>) -> String {
    each(setups, |unit| unit.to_owned())
}

/// The same of a power spectral density.
pub(super) fn density_unit<'a>(setups: impl IntoIterator<Item = &'a Setup>) -> String {
    each(setups, |unit| format!("({unit})²/Hz"))
}

fn each<'a>(setups: impl IntoIterator<Item = &'a Setup>, word: impl Fn(&str) -> String) -> String {
    let mut words: Vec<String> = setups.into_iter().map(|setup| word(setup.motion().unit())).collect();
    if words.is_empty() {
        words.push(word(Motion::Acceleration.unit()));
    }
    words.sort();
    words.dedup();
    words.join(" or ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::{Study, template};

    #[test]
    fn the_unit_is_that_of_the_motion_and_of_setups_that_differ_both() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("beam.csv"), template::CANTON_BEAM).unwrap();
        let setup = |unit: &str| {
            let text = template::CANTON_STUDY.replace("unit = \"m/s2\"", &format!("unit = \"{unit}\""));
            assert!(text.contains(&format!("unit = \"{unit}\"")));
            Study::from_text(&text, folder.path()).unwrap().setups.remove(0)
        };
        let (acceleration, velocity) = (setup("m/s2"), setup("m/s"));
        assert_eq!((motion_unit([&velocity]), density_unit([&velocity])), ("m/s".to_owned(), "(m/s)²/Hz".to_owned()));
        assert_eq!(motion_unit([&setup("g")]), "m/s²");
        assert_eq!(density_unit([&acceleration, &velocity, &velocity]), "(m/s)²/Hz or (m/s²)²/Hz");
        assert_eq!(motion_unit([]), "m/s²");
    }
}
