//! Recordings of another make: faults that nothing in them says, machines, and cables. Each is told, or does no harm.

use belfry_tests::records::{CaseScore, ModeScore, case, run};

/// Drawn once; what is asked here holds for any.
const SEED: u64 = 20_261_123;

fn score(name: &str) -> CaseScore {
    let folder = tempfile::tempdir().unwrap();
    let mut score = CaseScore::default();
    run(case(name).unwrap(), SEED, "spectra", folder.path(), &mut score).unwrap();
    assert_eq!(score.refused, []);
    score
}

fn tells(score: &CaseScore, words: &str) -> bool {
    score.warnings.iter().any(|warning| warning.contains(words))
}

#[test]
fn missing_rows_that_nothing_says_are_suspected_aloud_and_only_where_they_are_missing() {
    let damaged = score("missing-rows");
    assert!(tells(&damaged, "all channels jump at once at"), "{:?}", damaged.warnings);
    let sound = score("wind");
    let whole: Vec<_> = sound.modes.iter().flat_map(|mode| mode.whole.iter().copied()).collect();
    let numbers: usize = whole.iter().map(|mode| mode.numbers).sum();
    let rms = (whole.iter().map(|mode| mode.joint).sum::<f64>() / numbers as f64).sqrt();
    assert!(whole.len() == 10 && (0.6..1.3).contains(&rms), "errors of whole modes over their covariance: {rms}");
    assert!(!tells(&sound, "jump") && !tells(&sound, "cut off"), "{:?}", sound.warnings);
}

#[test]
fn a_channel_that_is_cut_off_is_named_and_left_out_and_no_shape_is_bent() {
    let damaged = score("clipped");
    assert!(tells(&damaged, "is cut off at") && tells(&damaged, "and is left out"), "{:?}", damaged.warnings);
    assert!(damaged.modes.iter().all(|mode| mode.least_mac.is_some_and(|mac| mac > 0.999)), "{}", damaged.table());
}

/// What a sensor did not measure is left out, and what it measured of the rest of the record is believed.
#[test]
fn a_channel_that_is_stuck_has_gaps_or_drifts_is_named_and_costs_no_mode() {
    for (name, words) in [("stuck", "holds one value"), ("gaps", " gaps, "), ("gain-drifts", "its gain rises by")] {
        let damaged = score(name);
        assert!(tells(&damaged, words), "{name}: {:?}", damaged.warnings);
        assert_eq!(damaged.faults, [1, 1], "{name}: {:?}", damaged.warnings);
        let is_sound = |mode: &ModeScore| mode.missed == 0 && mode.least_mac.is_some_and(|mac| mac > 0.995);
        assert!(damaged.modes.iter().all(is_sound), "{name}: {}", damaged.table());
    }
}

#[test]
fn a_channel_that_is_reversed_and_two_that_are_exchanged_are_suspected_by_name_and_no_others() {
    let wrong = score("miswired");
    assert!(tells(&wrong, "channel 10 seems to be reversed"), "{:?}", wrong.warnings);
    assert!(tells(&wrong, "channels 14 and 17 seem to be exchanged"), "{:?}", wrong.warnings);
    assert_eq!(wrong.warnings.iter().filter(|warning| warning.contains(" seem")).count(), 2, "{:?}", wrong.warnings);
    assert!(!tells(&score("wind"), " seem"));
}

/// Records of noise in which the fit of spectra alone takes a peak for a mode, and in some of which the subspace has it too.
#[test]
fn a_structure_that_stands_still_has_no_modes_in_the_eyes_of_both_methods() {
    let unseen = [1_795_395_337, 1_795_395_482, 1_795_471_016, 1_795_476_624, 1_795_577_329, 1_795_577_386];
    let seen = [1_795_473_261, 1_795_473_278, 1_795_476_765];
    for seed in unseen.into_iter().chain(seen) {
        let folder = tempfile::tempdir().unwrap();
        let mut score = CaseScore::default();
        run(case("still").unwrap(), seed, "both", folder.path(), &mut score).unwrap();
        assert_eq!((score.invented_hz, score.refused), (vec![], vec![]), "seed {seed}");
    }
}

/// Records in which the fit alone, one mode after the other, leaves the place of most.
#[test]
#[cfg_attr(not(long_tests), ignore = "long: ./test --all runs it")]
fn what_the_subspace_shows_of_close_modes_is_where_the_fit_of_all_begins() {
    for (name, seed, modes) in [("alike", 510_003, 6), ("cables", 510_004, 8), ("cables", 510_007, 8)] {
        let folder = tempfile::tempdir().unwrap();
        let mut score = CaseScore::default();
        run(case(name).unwrap(), seed, "both", folder.path(), &mut score).unwrap();
        let found = score.modes.iter().filter(|mode| mode.missed == 0).count();
        assert_eq!((found, score.invented_hz.len()), (modes, 0), "{name}, seed {seed}");
        let z: Vec<f64> = score.modes.iter().flat_map(|mode| mode.shape_z.iter().copied()).collect();
        let rms = (z.iter().map(|z| z * z).sum::<f64>() / z.len() as f64).sqrt();
        assert!(rms < 1.5, "{name}, seed {seed}: errors of shapes over their deviations: {rms}");
    }
}

/// A machine two and a half bandwidths above a mode is told, is no mode, and costs the mode next to nothing.
fn is_told_and_does_no_harm(name: &str) {
    let shaken = score(name);
    assert_eq!(shaken.machines, [1, 1], "{}", shaken.table());
    assert_eq!(shaken.invented_hz, []);
    for mode in &shaken.modes {
        assert_eq!(mode.missed, 0, "{}", shaken.table());
        let errors = mode.frequency_over_bound.iter().chain(&mode.damping_over_bound);
        assert!(errors.into_iter().all(|error| error.abs() < 6.0), "{}", shaken.table());
        assert!(mode.least_mac.is_some_and(|mac| mac > 0.995), "{}", shaken.table());
    }
}

#[test]
fn a_machine_whose_speed_wanders_is_told_and_does_no_harm() {
    is_told_and_does_no_harm("tone-wanders");
}

#[test]
#[cfg_attr(not(long_tests), ignore = "long: ./test --all")]
fn machines_that_run_steadily_or_now_and_then_are_told_and_do_no_harm() {
    for name in ["tone-1", "tone-2.5", "tone-on-off"] {
        is_told_and_does_no_harm(name);
    }
}

/// Eight modes of 0.02 to 0.1 % damping within 4 % of frequency, two lines apart, and no band in the study: noise far above must not widen
/// it, and finer lines show the modes one by one.
#[test]
fn cables_are_found_one_by_one_and_their_damping_is_believed() {
    let cables = score("cables");
    assert_eq!(cables.invented_hz, [], "{}", cables.table());
    let missed: usize = cables.modes.iter().map(|mode| mode.missed).sum();
    assert!(missed <= 1, "{}", cables.table());
    // Few modes of eight are further off than four times the bound of the best method; none has another's shape.
    for mode in &cables.modes {
        let errors = mode.frequency_over_bound.iter().chain(&mode.damping_over_bound);
        assert!(errors.into_iter().all(|error| error.abs() < 6.0), "{}", cables.table());
        assert!(mode.least_mac.is_none_or(|mac| mac > 0.95), "{}", cables.table());
    }
}
