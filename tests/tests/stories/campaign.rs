//! A slice of the fault campaign. The whole of it is `cargo run --release -p belfry-tests -- campaign`.

use belfry_tests::campaign::{Campaign, run};

#[test]
fn every_window_is_stored_once_or_listed_as_lost_whatever_fails() {
    let seed = u64::from(rand::random::<u32>());
    let campaign = Campaign { node_days: 2.0, days_a_run: 0.25, intensity: 4.0, damaged: None, seed };
    let report = run(&campaign, &|_| {}).unwrap();
    println!("{report}");
    assert!(report.violations.is_empty(), "{report}");
    assert!(report.stored > 300 && report.lives > 16, "{report}");
    let kinds = [
        "archive busy",
        "cable pulled",
        "disk full",
        "frame dropped",
        "frame duplicated",
        "frame in two pieces",
        "frame with a byte too few",
        "frame with a byte too many",
        "frame with a flipped bit",
        "frames in another order",
        "host ended",
        "host killed",
        "host's frame forged",
        "host's frame repeated",
        "line stalled",
        "node restarted",
        "node's frame forged",
        "node's frame repeated",
        "readings missing",
        "sensor clipped",
        "sensor silent",
        "sensor stuck",
        "spikes",
    ];
    for kind in kinds {
        assert!(report.faults.contains_key(kind), "no {kind}: {report}");
    }
    let clock = ["computer's clock set ahead", "computer's clock set back"];
    assert!(clock.iter().any(|kind| report.faults.contains_key(kind)), "the clock was never set: {report}");
}

#[test]
fn no_window_is_lost_on_lines_that_damage_a_twentieth_of_all_frames() {
    let seed = u64::from(rand::random::<u32>());
    let campaign = Campaign { node_days: 0.5, days_a_run: 0.0625, intensity: 0.0, damaged: Some(0.05), seed };
    let report = run(&campaign, &|_| {}).unwrap();
    println!("{report}");
    assert!(report.violations.is_empty() && report.lost.is_empty(), "{report}");
    assert!(report.made == report.stored && report.made > 100, "{report}");
    assert!(report.faults["frame dropped"] > 10, "{report}");
}
