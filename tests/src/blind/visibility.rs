//! How far an effect stands out of what nobody can know: an ideal observer's figure, to hold belfry's answers against.
//!
//! A case flows in, with how well modes were measured; out flows the distance of what the effect does to frequencies and shapes from
//! nothing, in standard deviations of scatter and measurement together (Mahalanobis). The observer knows the world that the case was drawn
//! in, its kernel and sizes, and what the effect is and where; it does not know how this structure happens to scatter. Below some four
//! deviations even it would name no effect: evidence of 20 to 1 for each of 20 kinds asks for that much.

use nalgebra::{DMatrix, DVector};

use super::cases::Case;
use super::magnitude::Band;

/// How well modes are measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct Measured {
    /// Relative standard deviation of a frequency.
    pub(super) frequency: f64,
    /// Standard deviation of a component of a shape of length 1.
    pub(super) shape: f64,
}

/// In standard deviations; of two effects that of the one that stands out less, beside the other. `None` where what is hidden is not in
/// undamped modes as real sensors see them: dampers, clocks, tones and weather, or nothing.
pub(super) fn visibility(case: &Case, measured: Measured) -> Option<f64> {
    let structure = &case.structure;
    let sound = Band::of(&case.sound, structure, None)?;
    let mut changes = Vec::new();
    for effect in &case.effects {
        let mut body = case.sound.clone();
        effect.apply(&mut body, structure);
        let is_seen = body.attachments.is_empty()
            && body.sensors.iter().all(|sensor| sensor.delay_s == 0.0)
            && body.tone_hz.is_none()
            && body.stiffness_per_kelvin == 0.0;
        changes.push(sound.change_to(&body, structure).filter(|_| is_seen)?);
    }
    let scatter = case.scatter.along_each(&case.sound);
    let scatter: Option<Vec<DVector<f64>>> = scatter.iter().map(|body| sound.change_to(body, structure)).collect();
    standing_out(&changes, &scatter?, &sound.variances(measured))
}

/// Of changes that are looked for at once, how far the one that stands out least is from none, where numbers scatter along some directions by
/// one deviation each, and have these variances besides.
fn standing_out(changes: &[DVector<f64>], scatter: &[DVector<f64>], variances: &DVector<f64>) -> Option<f64> {
    if changes.is_empty() {
        return None;
    }
    let mut covariance = DMatrix::from_diagonal(variances);
    scatter.iter().for_each(|direction| covariance.ger(1.0, direction, direction, 1.0));
    let changes = DMatrix::from_columns(changes);
    let precision = changes.transpose() * covariance.cholesky()?.solve(&changes);
    let Some(inverse) = precision.cholesky().map(|factor| factor.inverse()) else { return Some(0.0) };
    inverse.diagonal().iter().map(|variance| variance.sqrt().recip()).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::super::cases::{Kinds, Options};
    use super::super::world::Worlds;
    use super::*;

    #[test]
    fn a_change_stands_out_by_what_scatter_does_not_explain() {
        let [along, across] = [[3.0, 0.0], [0.0, 4.0]].map(|values| DVector::from_row_slice(&values));
        let variances = DVector::from_element(2, 1.0);
        let alone = |scatter: &[DVector<f64>]| standing_out(std::slice::from_ref(&along), scatter, &variances).unwrap();
        assert!((alone(&[]) - 3.0).abs() < 1e-12);
        // A scatter of 3 along it adds 9 to its variance of 1; across it, nothing.
        assert!((alone(std::slice::from_ref(&along)) - 3.0 / 10f64.sqrt()).abs() < 1e-12);
        assert!((alone(std::slice::from_ref(&across)) - 3.0).abs() < 1e-12);
        // Of two, the one that is less; of two that are the same, none.
        let two = standing_out(&[along.clone(), across], &[], &variances).unwrap();
        assert!((two - 3.0).abs() < 1e-12);
        assert!(standing_out(&[along.clone(), 2.0 * &along], &[], &variances).unwrap() < 1e-6);
        assert_eq!(standing_out(&[], &[], &variances), None);
    }

    /// Where segments scatter less, the same effect stands out more; where nothing is hidden, nothing does.
    #[test]
    fn what_scatters_hides_effects() {
        let of = |scatter: f64, kinds: Kinds| {
            let worlds = Worlds { scatter: Some(scatter), ..Worlds::default() };
            let options = Options { seed: 7, structure: Some("chimney".to_owned()), kinds, hours: 12.0, worlds };
            let case = Case::draw(1, &options).unwrap();
            visibility(&case, Measured { frequency: 5e-4, shape: 3e-3 })
        };
        let [much, little] = [2.0, 0.5].map(|scatter| of(scatter, Kinds::Kind("base-rotation")).unwrap());
        assert!(much > 0.0 && 1.5 * much < little && little < 6.0 * much, "{much} and {little}");
        assert_eq!(of(1.0, Kinds::Category(super::super::cases::Category::Nothing)), None);
        assert_eq!(of(1.0, Kinds::Kind("clock-offset")), None);
    }
}
