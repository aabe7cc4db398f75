//! A short slice of the blind bench: structures of another simulator, of which the study's model lacks something or nothing.
//! The whole of it: `cargo run --release -p belfry-tests -- blind --cases 300 --seed 1`.

use belfry_tests::belfry_command;
use belfry_tests::blind::{Bench, Case, CaseRecord, Kinds, Options, line};

/// Cases of the slice: seven rounds over the three structures, of which three are sound, two lack one effect, one lacks two
/// and one has what the catalogue does not know.
const CASES: [std::ops::Range<u64>; 2] = [0..18, 33..36];

#[test]
fn what_another_simulator_hides_is_named_and_sound_structures_are_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let options = Options { seed: 41, structure: None, kinds: Kinds::Mix, hours: 12.0, uneven: false };
    let indices: Vec<u64> = CASES.into_iter().flatten().collect();
    // Two at a time: much of a case is the work of one core.
    let half = |first: usize| -> Vec<CaseRecord> {
        let folder = folder.path().join(first.to_string());
        std::fs::create_dir(&folder).unwrap();
        let program = belfry_command().get_program().into();
        let mut bench = Bench { program, folder, keep: false, diagnoses: true, leaves_out: false };
        let run = |&index: &u64| {
            let record = bench.run(&Case::draw(index, &options).unwrap()).unwrap();
            println!("{}", line(&record));
            record
        };
        indices.iter().skip(first).step_by(2).map(run).collect()
    };
    let records: Vec<CaseRecord> = std::thread::scope(|scope| {
        let halves = [0, 1].map(|first| scope.spawn(move || half(first)));
        halves.into_iter().flat_map(|half| half.join().unwrap()).collect()
    });
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
    assert!(records.iter().all(|record| record.failures.is_empty()), "no command may fail");
}
