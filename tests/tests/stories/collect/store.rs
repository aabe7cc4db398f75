//! Nodes with a memory chip, in outages and power cuts.

use std::time::Duration;

use belfry_firmware::Technology;
use belfry_host::archive::Archive;
use belfry_host::window::{Loss, LossReason};

use super::bench::Bench;
use super::mast::{is_without_gaps, lives, numbers};

fn losses(bench: &Bench, node: u16) -> Vec<Loss> {
    let archive = Archive::open(bench.folder()).unwrap().unwrap();
    archive.losses().unwrap().into_iter().map(|listed| listed.loss).filter(|loss| loss.node == node).collect()
}

#[test]
fn windows_of_an_outage_outlast_a_power_cut_and_come_once() {
    let bench = Bench::new();
    bench.give_chip(3, Technology::Fram, 512 << 10);
    bench.give_chip(8, Technology::Nor, 1 << 20);
    bench.collect_for(3).unwrap();
    // Twice as long as a node's memory lasts; then the supply fails in the middle of a write.
    bench.pass(Duration::from_secs(14));
    let cut = [(3, bench.cut(3, 1234)), (8, bench.cut(8, 777))];
    for (node, kept) in cut {
        // Of seventeen seconds, windows that begin every 0.256 s; the first two are the host's and the filters'.
        assert!(kept.next_window > 55, "node {node}: {kept:?}");
        // The host's clock is stored when it is set, and then every ten minutes.
        assert!(kept.last_time.is_some_and(|time| (time.0 as f64 * 1e-6 - bench.unix_s()).abs() < 20.0), "{kept:?}");
    }
    // Without a host the nodes have no time, so they measure nothing.
    bench.pass(Duration::from_secs(2));
    for _ in 0..4 {
        bench.collect_for(8).unwrap();
    }
    for (node, kept) in cut {
        let lives = lives(bench.folder(), node);
        assert_eq!(lives.len(), 2, "node {node}: {:?}", lives.keys());
        assert_eq!(lives[&kept.boot], (0..kept.next_window).collect::<Vec<_>>(), "node {node}");
        let after = &lives[&kept.boot.wrapping_add(1)];
        assert!(is_without_gaps(after) && after.len() > 60, "node {node}: {after:?}");
        // Whether the life had made more windows than it had kept, nobody knows.
        let (boot, first) = (kept.boot, kept.next_window);
        assert_eq!(losses(&bench, node), [Loss { node, boot, first, last: None, reason: LossReason::Restarted }]);
    }
    assert!(Archive::check(bench.folder()).unwrap().is_sound);
}

#[test]
fn what_an_outage_overwrites_on_the_chip_is_listed_and_the_rest_comes() {
    for technology in [Technology::Fram, Technology::Nor] {
        let bench = Bench::new();
        bench.give_chip(3, technology, 40 << 10);
        bench.collect_for(2).unwrap();
        let before = numbers(bench.folder(), 3);
        bench.pass(Duration::from_secs(30));
        let kept = bench.cut(3, 300);
        assert!(kept.oldest_window > before.len() as u32 + 20, "{kept:?}");
        for _ in 0..3 {
            bench.collect_for(6).unwrap();
        }
        let (boot, lives) = (kept.boot, lives(bench.folder(), 3));
        let expected: Vec<u32> = before.iter().copied().chain(kept.oldest_window..kept.next_window).collect();
        assert_eq!(lives[&boot], expected, "{technology:?}");
        let overwritten = Loss {
            node: 3,
            boot,
            first: before.len() as u32,
            last: Some(kept.oldest_window - 1),
            reason: LossReason::Overwritten,
        };
        let rest = Loss { first: kept.next_window, last: None, reason: LossReason::Restarted, ..overwritten };
        assert_eq!(losses(&bench, 3), [overwritten, rest], "{technology:?}");
    }
}

#[test]
fn windows_that_the_outbox_has_no_room_for_come_from_the_chip_without_a_cut() {
    let bench = Bench::new();
    bench.give_chip(3, Technology::Fram, 512 << 10);
    bench.collect_for(3).unwrap();
    bench.pass(Duration::from_secs(20));
    for _ in 0..3 {
        bench.collect_for(8).unwrap();
    }
    let numbers = numbers(bench.folder(), 3);
    assert!(is_without_gaps(&numbers) && numbers.len() > 150, "{numbers:?}");
    assert_eq!(losses(&bench, 3), []);
}
