//! The other mode of two at one frequency, of which picking and fit have one.
//!
//! Of two modes at one frequency, as of a round chimney, the spectrum has one peak, and a fit that starts from one shape ends with one. A
//! basis whose fit left a mode alone in a plane flows in with the directions of that plane; both are fitted together from there and judged
//! as all picks are. The identification flows out as it was where that leads to no more modes.

use nalgebra::DVector;
use num_complex::Complex64;

use super::fit::{self, Basis};
use super::pick::{self, Pick};
use super::result::Identification;
use super::setup::MeasuredSetup;
use super::setup_mode::{SetupMode, SetupModes};
use super::{Mode, Suggestion};
use crate::spectra::LineGrid;

/// A mode that stands alone where the structure moves in two directions.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Lone {
    /// Its place among the picks.
    pick: usize,
    /// What was found, and the same with the other direction for a shape.
    both: [Suggestion; 2],
}

impl Lone {
    /// Those among the modes of all setups; where a setup does not show the other direction, the mode stands for itself.
    pub(super) fn all(setups: &[SetupModes]) -> Vec<Self> {
        let count = setups.iter().map(|setup| setup.modes.len()).min().unwrap_or(0);
        (0..count).filter_map(|pick| Self::of(pick, setups.iter().map(|setup| &setup.modes[pick]).collect())).collect()
    }

    fn of(pick: usize, modes: Vec<&SetupMode>) -> Option<Self> {
        let first = modes.first()?.resonance;
        let beside = |mode: &&SetupMode| {
            let direction: DVector<f64> = mode.changes.beside.column_iter().next()?.into_owned();
            mode.in_plane.then(|| direction.normalize().map(Complex64::from))
        };
        let suggestion =
            |shapes| Suggestion { frequency_hz: first.frequency_hz, damping_ratio: first.damping_ratio, shapes };
        let others = modes.iter().map(beside).collect::<Option<Vec<_>>>()?;
        let own = modes.iter().map(|mode| mode.shape.clone()).collect();
        Some(Self { pick, both: [suggestion(own), suggestion(others)] })
    }
}

/// The identification with the modes beside those that stand alone in a plane: all of them, or else those that stand by themselves.
pub(super) fn with_twins(measured: &[MeasuredSetup<'_>], grid: &LineGrid, found: Identification) -> Identification {
    let lone = found.basis.lone.clone();
    if lone.is_empty() {
        return found;
    }
    if let Some(all) = with(measured, grid, &found, &lone) {
        return all;
    }
    let one_by_one = if lone.len() > 1 { lone.as_slice() } else { &[] };
    // From the last to the first: a pick that is added does not move those before it.
    one_by_one
        .iter()
        .rev()
        .fold(found, |found, one| with(measured, grid, &found, std::slice::from_ref(one)).unwrap_or(found))
}

/// With both modes in the place of each of these; `None` where not all of them stand, or another mode does not.
fn with(
    measured: &[MeasuredSetup<'_>],
    grid: &LineGrid,
    found: &Identification,
    lone: &[Lone],
) -> Option<Identification> {
    let mut picks = found.basis.picks.clone();
    let known = |suggestion| Pick { is_known: true, is_twin: true, ..pick::suggested(grid, measured, suggestion) };
    for Lone { pick, both: [own, other] } in lone {
        let place = picks.get_mut(*pick)?;
        *place = Pick { by_user: place.by_user, asked_hz: place.asked_hz, ..known(own) };
        picks.push(known(other));
    }
    picks.sort_by_key(|pick| pick.line);
    let basis = Basis { picks, ..found.basis.clone() };
    let again = fit::fit(measured, grid, basis, found.singular_values.clone());
    let near = |identification: &Identification, mode: &Mode| {
        identification.modes.iter().filter(|other| mode.covers(other.frequency_hz, grid.spacing_hz())).count()
    };
    let is_still_there = |mode: &Mode| near(&again, mode) >= near(found, mode);
    let stand = again.modes.len() == found.modes.len() + lone.len() && found.modes.iter().all(is_still_there);
    stand.then_some(again)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::matrices::Source;
    use crate::identify::plane::tests::{recorded, two_modes};
    use crate::identify::singular::leading;
    use crate::simulate::modal::{Truth, points, setup};

    /// The fit of one pick at 0.5 Hz to a structure of eight channels, before and after twins were looked for.
    fn fitted(truth: &Truth, seed: u64) -> [Identification; 2] {
        let spectrum = recorded(truth, seed);
        let grid = *spectrum.grid();
        let line = grid.nearest_line(0.5);
        let pick = Pick::new(line, vec![leading(Source::Averages(&spectrum).matrix(line, None)).vector]);
        let setup = setup("one", &points(8), &[]);
        let measured = [MeasuredSetup { setup: &setup, spectrum }];
        let before = fit::fit(&measured, &grid, Basis { picks: vec![pick], ..Basis::default() }, Vec::new());
        let after = with_twins(&measured, &grid, before.clone());
        [before, after]
    }

    #[test]
    fn the_other_mode_of_one_frequency_is_found_and_told_as_a_pair() {
        let (mut found, mut sigmas) = (0, Vec::new());
        for seed in 0..10 {
            let [before, after] = fitted(&two_modes(0.5), seed);
            assert_eq!(before.modes.len(), 1, "seed {seed}");
            if let [a, b] = after.modes.as_slice() {
                found += 1;
                assert_eq!((a.pair_with, b.pair_with), (Some(2), Some(1)), "seed {seed}");
                sigmas.extend([a, b].map(|mode| ((mode.frequency_hz - 0.5) / mode.frequency_std_hz).abs()));
            }
        }
        // Chance leaves the directions of some so uncertain that the two may be one.
        assert!(found >= 8, "{found}");
        assert!(sigmas.iter().all(|sigmas| *sigmas < 4.0), "{sigmas:?}");
    }

    #[test]
    fn one_mode_stays_one() {
        let both = two_modes(0.5);
        let one = Truth { frequencies_hz: vec![0.5], shapes: both.shapes.columns(0, 1).into_owned(), ..both };
        for seed in 0..3 {
            let [before, after] = fitted(&one, seed);
            assert_eq!(before, after);
        }
    }
}
