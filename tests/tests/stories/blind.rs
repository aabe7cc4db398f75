//! A short slice of the blind bench: structures of another simulator, of which the study's model lacks something or nothing.
//! The whole of it: `cargo run --release -p belfry-tests -- blind --cases 300`.

use belfry_tests::belfry_command;
use belfry_tests::blind::{Bench, Case, CaseRecord, Category, Kinds, Options, Worlds, line};

/// Draws every case of the slices.
const SEED: u64 = 41;

/// Runs cases two at a time, for much of a case is the work of one core.
fn run(cases: &[(u64, Kinds)]) -> Vec<CaseRecord> {
    let folder = tempfile::tempdir().unwrap();
    let half = |first: usize| -> Vec<CaseRecord> {
        let folder = folder.path().join(first.to_string());
        std::fs::create_dir(&folder).unwrap();
        let program = belfry_command().get_program().into();
        let mut bench = Bench { program, folder, keep: false, diagnoses: true, leaves_out: false };
        let run = |(index, kinds): &(u64, Kinds)| {
            let kinds = kinds.clone();
            let worlds = Worlds::default();
            let options = Options { seed: SEED, structure: None, kinds, hours: 12.0, worlds };
            let record = bench.run(&Case::draw(*index, &options).unwrap()).unwrap();
            println!("{}", line(&record));
            record
        };
        cases.iter().skip(first).step_by(2).map(run).collect()
    };
    let records: Vec<CaseRecord> = std::thread::scope(|scope| {
        let halves = [0, 1].map(|first| scope.spawn(move || half(first)));
        halves.into_iter().flat_map(|half| half.join().unwrap()).collect()
    });
    assert!(records.iter().all(|record| record.failures.is_empty()), "no command may fail");
    records
}

#[test]
fn a_sound_structure_and_one_with_an_effect_are_told_apart() {
    are_told_apart(0, &[Category::Nothing, Category::Single]);
}

#[test]
#[cfg_attr(not(long_tests), ignore = "long: ./test --all runs it")]
fn two_effects_and_an_unknown_one_are_told_apart() {
    are_told_apart(2, &[Category::Pair, Category::Outside]);
}

/// One case of each sort, as they came out before.
fn are_told_apart(first: u64, categories: &[Category]) {
    let cases: Vec<(u64, Kinds)> = (first..).zip(categories.iter().copied().map(Kinds::Category)).collect();
    let judge = |record: &CaseRecord| {
        [record.false_alarm().map(|alarm| !alarm), record.in_set(), record.both_found(), record.known_unknown()]
    };
    let right: Vec<bool> = run(&cases).iter().flat_map(judge).flatten().collect();
    assert_eq!(right, vec![true; categories.len()]);
}

/// Seven rounds over the three structures, of which three are sound, two lack one effect, one lacks two and one has what the
/// catalogue does not know.
#[test]
#[cfg_attr(not(long_tests), ignore = "long: ./test --all")]
fn what_another_simulator_hides_is_named_and_sound_structures_are_left_alone() {
    let cases: Vec<(u64, Kinds)> = (0..18).chain(33..36).map(|index| (index, Kinds::Mix)).collect();
    let records = run(&cases);
    let rate = |judge: fn(&CaseRecord) -> Option<bool>| {
        let judged: Vec<bool> = records.iter().filter_map(judge).collect();
        (judged.iter().filter(|yes| **yes).count(), judged.len())
    };
    let (named, single) = rate(CaseRecord::in_set);
    assert!(single >= 6 && named + 1 >= single, "{named} of {single} effects named");
    let (first, _) = rate(CaseRecord::first_right);
    assert!(first + 2 >= single, "{first} of {single} effects named first");
    let (unknown, outside) = rate(CaseRecord::known_unknown);
    assert!(outside >= 3 && unknown + 1 >= outside, "{unknown} of {outside} unknown effects recognised");
    let (alarms, sound) = rate(CaseRecord::false_alarm);
    assert!(sound >= 6 && alarms == 0, "{alarms} false alarms on {sound} sound structures");
    let (both, pairs) = rate(CaseRecord::both_found);
    assert!(pairs >= 3 && both + 1 >= pairs, "{both} of {pairs} pairs found");
}
