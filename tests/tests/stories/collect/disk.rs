//! An archive that cannot be written for a while: the disk is full, or another program has it.

use std::time::Duration;

use belfry_host::collect::{Event, Happening};

use super::bench::{Bench, Host, options};
use super::mast::{archive, is_without_gaps, numbers};

/// How often it was said that the archive cannot be written, that it can again, and that windows are lost.
fn said(events: &[Event]) -> [usize; 3] {
    let count = |is: fn(&Happening) -> bool| events.iter().filter(|event| is(&event.what)).count();
    [
        count(|what| matches!(what, Happening::ArchiveAway { .. })),
        count(|what| matches!(what, Happening::ArchiveBack { .. })),
        count(|what| matches!(what, Happening::Lost { .. })),
    ]
}

/// Goes on until the archive cannot be written, and then for a while.
fn run_into_trouble(bench: &Bench, host: &mut Host<'_>, events: &mut Vec<Event>) -> String {
    let reason = loop {
        host.run(Duration::from_millis(500));
        events.extend(host.take_events());
        let reason = events.iter().find_map(|event| match &event.what {
            Happening::ArchiveAway { reason } => Some(reason.clone()),
            _ => None,
        });
        if let Some(reason) = reason {
            break reason;
        }
    };
    let before = [3, 8].map(|node| numbers(bench.folder(), node).len());
    // Longer than a node has room for: some fifty windows, one every 256 ms.
    host.run(Duration::from_secs(20));
    assert_eq!([3, 8].map(|node| numbers(bench.folder(), node).len()), before);
    events.extend(host.take_events());
    assert_eq!(said(events), [1, 0, 0], "said once, and nothing is lost");
    reason
}

/// Goes on until all windows that were made meanwhile are there.
fn run_out_of_trouble(bench: &Bench, host: &mut Host<'_>, events: &mut Vec<Event>) {
    let before = numbers(bench.folder(), 3).len();
    while said(events)[1] == 0 {
        host.run(Duration::from_millis(500));
        events.extend(host.take_events());
    }
    host.run(Duration::from_secs(4));
    for node in [3, 8] {
        host.wait_for_all(node);
    }
    events.extend(host.take_events());
    assert_eq!(said(events), [1, 1, 0], "said once each, and nothing is lost");
    let after = numbers(bench.folder(), 3).len();
    assert!(after > before + 100, "{before} windows before, {after} after");
}

#[test]
fn a_full_disk_is_waited_for_and_costs_no_window() {
    let bench = Bench::new();
    bench.collect_for(2).unwrap();
    let filler = "CREATE TABLE filler (bytes BLOB); INSERT INTO filler VALUES (zeroblob(1000000));
        PRAGMA wal_checkpoint(TRUNCATE)";
    archive(bench.folder()).execute_batch(filler).unwrap();
    bench.fill_disk(std::fs::metadata(bench.folder().join("archive.sqlite")).unwrap().len());
    let mut events = Vec::new();
    bench
        .collect(bench.folder(), &options(), |host| {
            let reason = run_into_trouble(&bench, host, &mut events);
            for part in ["archive.sqlite", "cannot be used", "disk is full"] {
                assert!(reason.contains(part), "no {part:?} in: {reason}");
            }
            // No window is kept in part.
            let count =
                |query: &str| -> usize { archive(bench.folder()).query_row(query, [], |row| row.get(0)).unwrap() };
            assert_eq!(count("SELECT count(*) FROM channel"), 2 * count("SELECT count(*) FROM window"));
            archive(bench.folder()).execute_batch("DROP TABLE filler").unwrap();
            run_out_of_trouble(&bench, host, &mut events);
        })
        .unwrap();
    assert!([3, 8].into_iter().all(|node| is_without_gaps(&numbers(bench.folder(), node))));
}

#[test]
fn another_program_that_writes_for_long_is_waited_for_and_costs_no_window() {
    let bench = Bench::new();
    let mut events = Vec::new();
    bench
        .collect(bench.folder(), &options(), |host| {
            host.run(Duration::from_secs(2));
            let other = archive(bench.folder());
            other.execute_batch("BEGIN IMMEDIATE; UPDATE window SET received_us = received_us").unwrap();
            let reason = run_into_trouble(&bench, host, &mut events);
            assert!(reason.contains("locked"), "{reason}");
            other.execute_batch("COMMIT").unwrap();
            run_out_of_trouble(&bench, host, &mut events);
        })
        .unwrap();
}

#[test]
fn windows_that_wait_are_stored_when_collecting_ends() {
    let bench = Bench::new();
    let mut before = 0;
    bench
        .collect(bench.folder(), &options(), |host| {
            host.run(Duration::from_secs(2));
            before = numbers(bench.folder(), 3).len();
            let other = archive(bench.folder());
            other.execute_batch("BEGIN IMMEDIATE").unwrap();
            // The next try would be a second later.
            host.run(Duration::from_secs(6));
            other.execute_batch("COMMIT").unwrap();
            assert_eq!(numbers(bench.folder(), 3).len(), before);
        })
        .unwrap();
    let after = [3, 8].map(|node| numbers(bench.folder(), node).len());
    assert!(after.iter().all(|&after| after > before + 15), "{before} windows before, {after:?} after");
}

#[test]
fn a_node_that_comes_while_the_archive_cannot_be_written_is_served_afterwards() {
    let bench = Bench::new();
    let mut events = Vec::new();
    bench
        .collect(bench.folder(), &options(), |host| {
            bench.hide("node8", true);
            host.run(Duration::from_secs(2));
            let other = archive(bench.folder());
            other.execute_batch("BEGIN IMMEDIATE").unwrap();
            bench.hide("node8", false);
            host.run(Duration::from_secs(6));
            other.execute_batch("COMMIT").unwrap();
            host.wait_until("node 8 measures", |statuses| super::bench::measures(statuses, "node8", 8));
            host.run(Duration::from_secs(6));
            host.wait_for_all(3);
            events.extend(host.take_events());
        })
        .unwrap();
    assert_eq!(said(&events), [1, 1, 0]);
    assert!(!numbers(bench.folder(), 8).is_empty());
}
