//! The profile of a study's model: what its measurement says of the stiffness and mass of segments, as figures and as a table.

use super::case::Case;
use super::change::named;
use super::error::StoryError;
use crate::diagnose::steps::Profiles;
use crate::diagnose::{Profile, QuantityProfile};
use crate::model::{Body, Structure};
use crate::progress::{Tally, UNHEARD};
use crate::study::STUDY_FILE;

/// The profile without and with the effects in the model, and one more (`KIND[@WHERE]`) where one is named.
///
/// # Errors
/// When the model has no segments, the study trusts them, or the effects cannot be fitted.
pub(super) fn profiles(case: &Case, with: Option<&str>, tally: &Tally) -> Result<Profiles, StoryError> {
    check_segments(case)?;
    let (setting, effects) = (case.setting(tally)?, &case.model.effects);
    Ok(match with {
        None => setting.profiles(effects)?,
        Some(word) => {
            let (kind, place) = named(word, &case.sensors)?;
            setting.profiles_with(effects, kind, place.as_ref())?
        }
    })
}

impl Case {
    /// The matrices of the model with its effects and its segments as they fit the measurement best.
    ///
    /// # Errors
    /// When the model has no segments, the study trusts them, or the effects cannot be fitted.
    pub fn fitted(&self) -> Result<Structure, StoryError> {
        check_segments(self)?;
        Ok(self.setting(&UNHEARD)?.fitted(&self.model.effects)?)
    }
}

/// Checks that there are segments to fit, and that the study lets them.
fn check_segments(case: &Case) -> Result<(), StoryError> {
    let file = || case.study.folder.join(STUDY_FILE);
    match (&case.tolerance, &case.model.body) {
        (Some(_), _) => Ok(()),
        (None, Body::Matrices(_)) => Err(StoryError::NoSegments { file: file() }),
        (None, Body::Beam(_)) => Err(StoryError::NoTolerance { file: file() }),
    }
}

const HEADER: [&str; 9] =
    ["model", "quantity", "unit", "z_bottom_m", "z_top_m", "given", "factor", "factor_std", "factor_prior_std"];

/// A row a model, quantity and segment.
pub(super) fn csv(profiles: &Profiles) -> std::io::Result<Vec<u8>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(HEADER)?;
    let models = std::iter::once(("as_given", &profiles.as_given));
    for (model, profile) in models.chain(profiles.with_effects.iter().map(|with| ("with_effects", with))) {
        write_rows(&mut writer, model, profile)?;
    }
    writer.into_inner().map_err(csv::IntoInnerError::into_error)
}

fn write_rows(writer: &mut csv::Writer<Vec<u8>>, model: &str, profile: &Profile) -> std::io::Result<()> {
    for group in &profile.groups {
        let words = [model.to_owned(), format!("group {}", group.name), "-".to_owned()];
        let span = [0, 1].map(|end| group.span_m.map_or_else(String::new, |span_m| span_m[end].to_string()));
        let numbers = [group.factor, group.std, group.prior_std].map(|number| number.to_string());
        writer.write_record(words.into_iter().chain(span).chain([String::new()]).chain(numbers))?;
    }
    for QuantityProfile { quantity, unit, segments } in &profile.quantities {
        for segment in segments {
            let given = segment.given.map_or_else(String::new, |given| given.to_string());
            let numbers = [segment.factor, segment.std, segment.prior_std].map(|number| number.to_string());
            let words = [model, quantity.name(), unit].map(str::to_owned);
            let heights = [segment.z_bottom_m, segment.z_top_m].map(|z_m| z_m.to_string());
            writer.write_record(words.into_iter().chain(heights).chain([given]).chain(numbers))?;
        }
    }
    Ok(())
}
