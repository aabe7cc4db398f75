//! Stable poles that are no modes of the subspaces alone, and why.
//!
//! The poles of all setups and those that were chosen flow in; what was rejected flows out, for the same list as the peaks that the
//! fit of spectra rejects.

use super::modes::mean_hz;
use super::stabilisation::StablePole;
use super::{SetupPoles, TRIED_SHARE, reach_hz};
use crate::identify::choice::meant_hz;
use crate::identify::result::{Rejected, RejectedBecause};
use crate::study::ModeChoice;

/// The poles, one of each setup in `common`, that are not among the `chosen`, and those that some setups have and others do not, lowest
/// first. What explains next to nothing of the response is left out, for there is no end of it; so is what the user dropped. Where the user
/// names all modes nothing is rejected.
pub(super) fn rejected(
    setups: &[SetupPoles],
    common: &[Vec<&StablePole>],
    chosen: &[Vec<&StablePole>],
    choice: &ModeChoice,
    spacing_hz: f64,
) -> Vec<Rejected> {
    if choice.only_hz.is_some() {
        return Vec::new();
    }
    let is_in = |groups: &[Vec<&StablePole>], pole: &StablePole| {
        groups.iter().flatten().any(|other| std::ptr::eq(*other, pole))
    };
    let explains =
        |poles: &[&StablePole]| 2 * poles.iter().filter(|pole| pole.share >= TRIED_SHARE).count() > poles.len();
    let of_all = common.iter().filter(|poles| !poles.iter().any(|pole| is_in(chosen, pole)) && explains(poles));
    let mut rejected: Vec<Rejected> =
        of_all.map(|poles| Rejected { frequency_hz: mean_hz(poles), because: because(poles) }).collect();
    // One that not even its own setup has for certain needs no list.
    let of_some = setups.iter().flat_map(|found| &found.stable).filter(|pole| pole.is_clear() && !is_in(common, pole));
    for pole in of_some {
        let reach_hz = reach_hz(spacing_hz, pole.damping_ratio, pole.frequency_hz);
        if rejected.iter().all(|other| (other.frequency_hz - pole.frequency_hz).abs() > reach_hz) {
            rejected.push(Rejected { frequency_hz: pole.frequency_hz, because: RejectedBecause::NotInAllSetups });
        }
    }
    let is_dropped =
        |one: &Rejected| choice.drop_hz.iter().any(|hz| (hz - one.frequency_hz).abs() < meant_hz(spacing_hz, *hz));
    rejected.retain(|one| !is_dropped(one));
    rejected.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    rejected
}

/// What most of the poles that are not clear lack.
fn because(poles: &[&StablePole]) -> RejectedBecause {
    let reasons: Vec<RejectedBecause> = poles.iter().filter_map(|pole| pole.unclear_because()).collect();
    let count = |because: RejectedBecause| reasons.iter().filter(|other| **other == because).count();
    let all = [RejectedBecause::Weak, RejectedBecause::Unstable, RejectedBecause::Damping];
    all.into_iter().rev().max_by_key(|because| count(*because)).unwrap_or(RejectedBecause::Weak)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::shape::Shape;

    fn pole(frequency_hz: f64, share: f64) -> StablePole {
        StablePole {
            order: 8,
            orders: (4..12).collect(),
            frequency_hz,
            frequency_std_hz: 1e-3,
            damping_ratio: 0.01,
            damping_ratio_std: 1e-3,
            shape: Shape::from_element(2, 1.0.into()),
            shape_std: vec![0.1; 2],
            power: 1.0,
            share,
        }
    }

    fn setup(stable: Vec<StablePole>) -> SetupPoles {
        SetupPoles { dots: Vec::new(), stable }
    }

    #[test]
    fn each_pole_that_is_no_mode_has_its_reason() {
        let seldom = StablePole { orders: vec![4, 5, 6, 7], ..pole(2.0, 0.9) };
        let uncertain = StablePole { damping_ratio_std: 0.008, ..pole(3.0, 0.9) };
        let one = setup(vec![pole(1.0, 0.9), pole(1.5, 0.3), seldom, uncertain, pole(4.0, 0.01)]);
        let setups = [one];
        let common: Vec<Vec<&StablePole>> = setups[0].stable.iter().map(|pole| vec![pole]).collect();
        let rejected = |choice: &ModeChoice| -> Vec<(f64, RejectedBecause)> {
            let found = rejected(&setups, &common, &common[..1], choice, 0.01);
            found.into_iter().map(|one| (one.frequency_hz, one.because)).collect()
        };
        let all = [(1.5, RejectedBecause::Weak), (2.0, RejectedBecause::Unstable), (3.0, RejectedBecause::Damping)];
        assert_eq!(rejected(&ModeChoice::default()), all);
        assert_eq!(rejected(&ModeChoice { drop_hz: vec![2.0], ..ModeChoice::default() }), [all[0], all[2]]);
        assert_eq!(rejected(&ModeChoice { only_hz: Some(vec![1.0]), ..ModeChoice::default() }), []);
    }

    #[test]
    fn a_pole_that_one_setup_lacks_is_told_once() {
        let setups = [setup(vec![pole(2.0, 0.9)]), setup(vec![pole(2.001, 0.9)]), setup(vec![])];
        let found = rejected(&setups, &[], &[], &ModeChoice::default(), 0.01);
        assert_eq!(found, [Rejected { frequency_hz: 2.0, because: RejectedBecause::NotInAllSetups }]);
    }
}
