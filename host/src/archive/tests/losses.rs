//! What no longer exists anywhere is listed, once, with its reason, and stays listed.

use super::*;
use crate::window::{Loss, LossReason};

fn listed(archive: &Archive) -> Vec<Loss> {
    archive.losses().unwrap().into_iter().map(|listed| listed.loss).collect()
}

fn loss(first: u32, last: impl Into<Option<u32>>, reason: LossReason) -> Loss {
    Loss { node: 1, boot: 7, first, last: last.into(), reason }
}

#[test]
fn a_loss_is_listed_once_and_neither_asked_nor_lost_again() {
    let (mut bench, two) = Bench::of_one(0);
    bench.archive.meet("now", 1, 7, 0, HostTime(5)).unwrap();
    let losses = [loss(3, 9, LossReason::Overwritten), loss(20, 20, LossReason::Unreadable)];
    for lost in [losses[0], losses[1], losses[0], loss(4, 9, LossReason::Overwritten)] {
        bench.archive.lose(&lost, HostTime(2_500_000)).unwrap();
    }
    for number in [0, 1, 2, 10] {
        bench.store(&two, &sent(&two, 1, number, u64::from(number)));
    }
    assert_eq!(listed(&bench.archive), losses);
    assert_eq!(bench.archive.losses().unwrap()[0].noted_s, 2.5);
    let kept = bench.archive.kept(1, 7).unwrap().unwrap();
    assert_eq!(kept.lost, [[3, 9], [20, 20]]);
    let mut assembler = crate::window::Assembler::resuming(1, 7, &kept);
    assert_eq!(assembler.below(), 11, "of what is lost nothing is waited for");
    assembler.heartbeat(25, 30);
    let again = assembler.take_losses();
    assert_eq!(again, [loss(11, 19, LossReason::Overwritten), loss(21, 24, LossReason::Overwritten)]);
    assert_eq!((assembler.lost(), assembler.below()), (13, 25));
}

#[test]
fn what_a_node_still_had_when_it_started_anew_is_lost_and_so_is_whatever_came_behind() {
    let (mut bench, two) = Bench::of_one(0);
    bench.archive.meet("now", 1, 7, 2, HostTime(5)).unwrap();
    for number in [2, 3, 6, 9] {
        bench.store(&two, &sent(&two, 1, number, u64::from(number)));
    }
    bench.archive.lose(&loss(4, 4, LossReason::Unreadable), HostTime(6)).unwrap();
    // The same life again, and another node, end nothing.
    bench.archive.meet("then", 1, 7, 12, HostTime(7)).unwrap();
    bench.archive.meet("now", 2, 8, 0, HostTime(7)).unwrap();
    bench.archive.end_before(2, 8, HostTime(7)).unwrap();
    // The next life still has what was kept of this one, and the one after it has nothing.
    for boot in [8, 9] {
        bench.archive.meet("now", 1, boot, 0, HostTime(8)).unwrap();
        // What an earlier life says, late, ends no later one.
        bench.archive.end_before(1, 7, HostTime(8)).unwrap();
        assert_eq!(listed(&bench.archive).len(), 1);
    }
    for _ in 0..2 {
        bench.archive.end_before(1, 9, HostTime(8)).unwrap();
    }
    let restarted = |first, last: Option<u32>| loss(first, last, LossReason::Restarted);
    let expected = [
        loss(4, 4, LossReason::Unreadable),
        restarted(5, Some(5)),
        restarted(7, Some(8)),
        restarted(10, None),
        Loss { boot: 8, ..restarted(0, None) },
    ];
    assert_eq!(listed(&bench.archive), expected);
    // Should the life come back, it is asked for what it may still have.
    assert_eq!(bench.archive.kept(1, 7).unwrap().unwrap().lost, [[4, 4]]);
}

#[test]
fn what_has_come_all_the_same_does_not_count() {
    let (mut bench, two) = Bench::of_one(0);
    bench.archive.meet("now", 1, 7, 0, HostTime(5)).unwrap();
    bench.archive.lose(&loss(3, 9, LossReason::Restarted), HostTime(6)).unwrap();
    bench.archive.lose(&loss(10, None, LossReason::Restarted), HostTime(6)).unwrap();
    for number in [2, 4, 9, 12] {
        bench.store(&two, &sent(&two, 1, number, u64::from(number)));
    }
    let listed = bench.archive.losses().unwrap();
    let counts: Vec<_> = listed.iter().map(|listed| (listed.came, listed.windows())).collect();
    assert_eq!(counts, [(2, Some(5)), (1, None)]);
}

#[test]
fn windows_that_a_repair_cannot_save_are_listed_by_what_is_missing_and_not_by_damaged_names() {
    let (bench, _) = Bench::of_one(10);
    let change = |what: &str| bench.archive.connection.execute(what, []).unwrap();
    // Two bits of one number are no longer mended.
    change("UPDATE window SET grid_index = grid_index + 3 * 1024 WHERE number = 4");
    // Another name, which is not one that a window between others has.
    change("UPDATE window SET number = 77, middle_offset_us = middle_offset_us + 1000 WHERE number = 6");
    let folder = bench.folder.path();
    drop(bench.archive);
    let repaired = Archive::repair(folder).unwrap();
    assert_eq!(repaired.windows, 8, "{repaired:?}");
    let archive = Archive::open(folder).unwrap().unwrap();
    assert_eq!(listed(&archive), [loss(4, 4, LossReason::Damaged), loss(6, 6, LossReason::Damaged)]);
    assert!(Archive::check(folder).unwrap().is_sound);
}

#[test]
fn a_list_of_losses_is_checked_repaired_and_taken_elsewhere() {
    let (mut bench, _) = Bench::of_one(10);
    bench.archive.lose(&loss(10, 12, LossReason::Overwritten), HostTime(1)).unwrap();
    bench.archive.lose(&loss(14, 15, LossReason::Misdated), HostTime(1)).unwrap();
    let elsewhere = bench.folder.path().join("elsewhere.sqlite");
    bench.archive.extract_archive(&TimeRange::ALL, &elsewhere).unwrap();
    let there = Archive::create_file(elsewhere, None).unwrap();
    assert_eq!(listed(&there), listed(&bench.archive));
    let folder = bench.folder.path();
    let report = Archive::check(folder).unwrap();
    assert!(report.is_sound, "a loss is no damage: {report:?}");
    assert_eq!(report.lost.len(), 2);
    bench.archive.connection.execute("UPDATE loss SET last_number = 13 WHERE first_number = 10", []).unwrap();
    let report = Archive::check(folder).unwrap();
    let told: Vec<String> = report.damages.iter().map(ToString::to_string).collect();
    assert_eq!(told, ["row 1 of loss: it does not match its checksum"]);
    let Bench { folder, archive } = bench;
    drop(archive);
    // Twelve and thirteen differ in one bit.
    assert_eq!(Archive::repair(folder.path()).unwrap().mended, 1);
    assert_eq!(Archive::check(folder.path()).unwrap().lost[0].loss.last, Some(12));
}
