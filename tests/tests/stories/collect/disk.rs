//! A disk that is full.

use super::bench::Bench;
use super::mast::{archive, is_without_gaps, numbers};

#[test]
fn a_full_disk_ends_collecting_and_costs_no_window() {
    let bench = Bench::new();
    bench.collect_for(3).unwrap();
    let before = numbers(bench.folder(), 3).len();
    assert!(before > 0);
    let count = |query: &str| -> usize { archive(bench.folder()).query_row(query, [], |row| row.get(0)).unwrap() };
    // From the archive's point of view the disk is full in the middle of a window, some windows from now.
    let room = count("SELECT count(*) FROM window") + 10;
    let full = format!(
        "CREATE TRIGGER full BEFORE INSERT ON channel
         WHEN NEW.channel = 1 AND (SELECT count(*) FROM window) > {room}
         BEGIN SELECT RAISE(FAIL, 'database or disk is full'); END"
    );
    archive(bench.folder()).execute_batch(&full).unwrap();
    let said = bench.collect_for(60).unwrap_err();
    for part in ["archive.sqlite", "cannot be used", "disk is full"] {
        assert!(said.contains(part), "no {part:?} in: {said}");
    }
    // No window is kept in part.
    assert_eq!(count("SELECT count(*) FROM window"), room);
    assert_eq!(count("SELECT count(*) FROM channel"), 2 * room);
    // The nodes still have what could not be kept.
    archive(bench.folder()).execute_batch("DROP TRIGGER full").unwrap();
    bench.collect_rest(before);
    for node in [3, 8] {
        let numbers = numbers(bench.folder(), node);
        assert!(numbers.len() > before + 4, "{} windows of node {node}, {before} before", numbers.len());
        assert!(is_without_gaps(&numbers), "node {node}: {numbers:?}");
    }
}
