//! An archive that has lost a part of its file: what cannot be saved is listed, all of it.

use std::collections::BTreeSet;
use std::fs;

use super::*;
use crate::window::{Assembler, Loss, LossReason};

const WINDOWS: u32 = 1000;

/// A life that is over, and one that is not, each with so many windows.
fn two_lives() -> Bench {
    let (mut bench, two) = Bench::of_one(0);
    for boot in [7, 8] {
        bench.archive.meet("now", 1, boot, 0, HostTime(i64::from(boot))).unwrap();
        bench.archive.end_before(1, boot, HostTime(i64::from(boot))).unwrap();
        for number in 0..WINDOWS {
            let mut window = sent(&two, 1, number, u64::from((boot - 7) * 2 * WINDOWS + number));
            window.name.boot = boot;
            bench.store(&two, &window);
        }
    }
    bench
}

/// Numbers of a life that are stored, and numbers that are listed as lost.
fn accounted(archive: &Archive, boot: u32) -> (BTreeSet<u32>, BTreeSet<u32>) {
    let stored = archive.kept(1, boot).unwrap().unwrap().numbers.into_iter().collect();
    let losses = archive.losses().unwrap().into_iter().map(|listed| listed.loss).filter(|loss| loss.boot == boot);
    let lost = losses.filter_map(|loss| Some(loss.first..=loss.last?)).flatten().collect();
    (stored, lost)
}

fn all_but(stored: &BTreeSet<u32>, end: u32) -> BTreeSet<u32> {
    (0..end).filter(|number| !stored.contains(number)).collect()
}

#[test]
fn what_a_repair_cannot_save_is_listed_whatever_part_of_the_file_is_gone() {
    let Bench { folder, archive } = two_lives();
    drop(archive);
    let file = folder.path().join(ARCHIVE_FILE);
    let whole = fs::read(&file).unwrap();
    let pages = whole.len() / PAGE_BYTES as usize;
    assert!(pages > 30, "{pages} pages");
    let cut = |part: usize| whole[..whole.len() * part / 8].to_vec();
    let overwritten = |first: usize, count: usize| {
        let mut bytes = whole.clone();
        bytes[first * PAGE_BYTES as usize..(first + count) * PAGE_BYTES as usize].fill(0x55);
        bytes
    };
    let damaged: Vec<Vec<u8>> = (4..8)
        .map(cut)
        .chain([overwritten(pages / 3, 2), overwritten(pages / 2, 6), overwritten(pages - 4, 4)])
        .collect();
    fs::write(&file, cut(4)).unwrap();
    let words = Archive::check(folder.path()).unwrap_err().to_string();
    assert!(words.contains("has been cut") && words.contains(&format!("of its {pages} pages")), "{words}");
    // Nothing, or too little to tell where its tables begin.
    for (bytes, words) in [(0, "has 0 bytes"), (5000, "nothing of the archive")] {
        fs::write(&file, &whole[..bytes]).unwrap();
        let error = Archive::repair(folder.path()).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
        assert_eq!(fs::read(&file).unwrap(), whole[..bytes]);
    }
    assert!(Archive::check(folder.path()).is_err());
    for (index, bytes) in damaged.into_iter().enumerate() {
        fs::write(&file, bytes).unwrap();
        let repaired = Archive::repair(folder.path()).unwrap_or_else(|error| panic!("{index}: {error}"));
        assert!(repaired.windows > 0 && repaired.windows < u64::from(2 * WINDOWS), "{index}: {repaired:?}");
        let report = Archive::check(folder.path()).unwrap();
        assert!(report.is_sound, "{index}: {report:?}");
        let archive = Archive::open(folder.path()).unwrap().unwrap();
        let (stored, lost) = accounted(&archive, 7);
        assert_eq!(lost, all_but(&stored, WINDOWS), "{index}: of the life that is over");
        // How many windows the newer life has made, only its node knows.
        let (stored, lost) = archive.kept(1, 8).unwrap().map(|_| accounted(&archive, 8)).unwrap_or_default();
        assert_eq!(lost, all_but(&stored, stored.last().copied().unwrap_or(0)), "{index}: of the other");
        let hours: u64 = report.lost_in_repairs.iter().map(|hour| hour.windows).sum();
        assert_eq!(hours, u64::from(2 * WINDOWS) - repaired.windows, "{index}");
        // It stays known when the archive is damaged once more.
        drop(archive);
        let archive = rusqlite::Connection::open(&file).unwrap();
        archive
            .execute("UPDATE window SET grid_index = grid_index + 3 * 1024 WHERE id = (SELECT min(id) FROM window)", [])
            .unwrap();
        drop(archive);
        Archive::repair(folder.path()).unwrap();
        let again = Archive::check(folder.path()).unwrap();
        assert_eq!(again.lost_in_repairs.iter().map(|hour| hour.windows).sum::<u64>(), hours + 1, "{index}");
    }
}

#[test]
fn channels_whose_index_is_gone_are_found_where_they_were_written() {
    let Bench { folder, archive } = two_lives();
    let query = "SELECT rootpage FROM sqlite_schema WHERE name = 'sqlite_autoindex_channel_1'";
    let root: usize = archive.connection.query_row(query, [], |row| row.get(0)).unwrap();
    drop(archive);
    let file = folder.path().join(ARCHIVE_FILE);
    let mut bytes = fs::read(&file).unwrap();
    bytes[(root - 1) * PAGE_BYTES as usize..root * PAGE_BYTES as usize].fill(0x55);
    fs::write(&file, bytes).unwrap();
    let repaired = Archive::repair(folder.path()).unwrap();
    assert_eq!((repaired.windows, repaired.lost.len()), (u64::from(2 * WINDOWS), 0));
    let report = Archive::check(folder.path()).unwrap();
    assert!(report.is_sound && report.lost_in_repairs.is_empty(), "{report:?}");
}

#[test]
fn an_archive_with_small_pages_is_saved_up_to_where_it_was_cut() {
    let Bench { folder, archive } = two_lives();
    // As version 1 began them.
    archive.connection.execute_batch("PRAGMA journal_mode = delete; PRAGMA page_size = 4096; VACUUM").unwrap();
    drop(archive);
    let file = folder.path().join(ARCHIVE_FILE);
    let bytes = fs::read(&file).unwrap();
    fs::write(&file, &bytes[..bytes.len() - 4096]).unwrap();
    let repaired = Archive::repair(folder.path()).unwrap();
    // One page has no more than some dozens of them.
    assert!(repaired.windows > u64::from(2 * WINDOWS) - 100, "{repaired:?}");
}

#[test]
fn a_number_and_a_count_that_are_damaged_cost_nothing() {
    let Bench { folder, archive } = two_lives();
    archive.connection.execute("UPDATE service SET id = id + 4 WHERE id = 1", []).unwrap();
    archive.connection.execute("UPDATE tally SET entries = entries + 16384 WHERE kind = 'window'", []).unwrap();
    drop(archive);
    let repaired = Archive::repair(folder.path()).unwrap();
    assert_eq!(
        (repaired.windows, repaired.mended, repaired.lost.len()),
        (u64::from(2 * WINDOWS), 1, 0),
        "{repaired:?}"
    );
    let report = Archive::check(folder.path()).unwrap();
    assert!(report.is_sound && report.lost_in_repairs.is_empty(), "{report:?}");
}

#[test]
fn a_node_that_still_has_what_an_archive_lost_is_asked_for_it_and_the_rest_is_lost_once() {
    let (mut bench, two) = Bench::of_one(20);
    bench.archive.meet("now", 1, 7, 0, HostTime(1)).unwrap();
    let change = "UPDATE window SET grid_index = grid_index + 3 * 1024 WHERE number BETWEEN 5 AND 9";
    bench.archive.connection.execute(change, []).unwrap();
    let Bench { folder, archive } = bench;
    drop(archive);
    Archive::repair(folder.path()).unwrap();
    let mut archive = Archive::create(folder.path()).unwrap();
    let loss = Loss { node: 1, boot: 7, first: 5, last: Some(9), reason: LossReason::Damaged };
    assert_eq!(archive.losses().unwrap().into_iter().map(|listed| listed.loss).collect::<Vec<_>>(), [loss]);
    let kept = archive.kept(1, 7).unwrap().unwrap();
    assert_eq!((kept.lost.len(), &kept.damaged[..]), (0, &[[5, 9]][..]));
    let mut assembler = Assembler::resuming(1, 7, &kept);
    // The node has it from window 8 on.
    assembler.heartbeat(8, 20);
    assert_eq!((assembler.below(), assembler.lost(), assembler.take_losses()), (8, 0, Vec::new()));
    let again = assembler.overdue(HostTime(9), HostTime(8), HostTime(9), false);
    assert_eq!(again.iter().map(|range| [range.first_window, range.last_window]).collect::<Vec<_>>(), [[8, 9]]);
    for number in [8, 9] {
        archive.store("now", &two, &sent(&two, 1, number, u64::from(number)), HostTime(0)).unwrap();
        assembler.stored(number);
    }
    assert_eq!((assembler.below(), assembler.lost()), (20, 0));
    assert_eq!(archive.losses().unwrap()[0].windows(), Some(3));
    // So it is when they have been dropped since.
    let found = archive.prunable(Duration::from_secs(20), HostTime(i64::MAX)).unwrap();
    assert!(found.windows() > 10);
    archive.prune(&found).unwrap();
    let lost: Vec<[u32; 2]> =
        archive.losses().unwrap().iter().map(|listed| [listed.loss.first, listed.loss.last.unwrap()]).collect();
    assert_eq!(lost, [[5, 7]]);
    assert!(Archive::check(folder.path()).unwrap().is_sound);
}

#[cfg(unix)]
#[test]
fn an_archive_that_is_kept_elsewhere_is_repaired_there_and_the_link_to_it_stays() {
    let Bench { folder, archive } = Bench::of_one(20).0;
    archive.connection.execute("UPDATE window SET grid_index = grid_index + 3 * 1024 WHERE number = 5", []).unwrap();
    drop(archive);
    let (elsewhere, link) = (tempfile::tempdir().unwrap(), folder.path().join(ARCHIVE_FILE));
    let real = elsewhere.path().join("tower.sqlite");
    fs::rename(&link, &real).unwrap();
    std::os::unix::fs::symlink(&real, &link).unwrap();
    let repaired = Archive::repair(folder.path()).unwrap();
    assert_eq!(repaired.windows, 19);
    assert!(link.symlink_metadata().unwrap().is_symlink());
    assert!(Archive::check(folder.path()).unwrap().is_sound);
    assert_eq!(repaired.kept_as.unwrap().parent(), real.canonicalize().unwrap().parent());
}
