//! Checking, repairing, pruning and extracting.

use std::fs;
use std::time::Duration;

use super::*;

/// Hours of windows of both nodes, ten an hour, from the epoch on.
fn hours(hours: u32) -> Bench {
    let (mut bench, two, one) = Bench::of_both();
    for node in [1, 2] {
        bench.archive.meet("now", node, 7, 0, HostTime(0)).unwrap();
    }
    for number in 0..10 * hours {
        // A hop is 5.12 s.
        bench.store(&two, &sent(&two, 1, number, 70 * u64::from(number)));
        bench.store(&one, &sent(&one, 2, number, 70 * u64::from(number)));
    }
    bench
}

impl Bench {
    /// Its folder; the archive is closed.
    fn closed(self) -> tempfile::TempDir {
        self.folder
    }
}

fn change(folder: &Path, change: &str) {
    let archive = Connection::open(folder.join(ARCHIVE_FILE)).unwrap();
    archive.pragma_update(None, "foreign_keys", false).unwrap();
    archive.execute_batch(change).unwrap();
}

fn all(folder: &Path) -> Read {
    read(folder, &TimeRange::ALL).unwrap().unwrap()
}

#[test]
fn a_check_lists_what_is_damaged_and_changes_nothing() {
    let folder = hours(2).closed();
    let report = Archive::check(folder.path()).unwrap();
    assert_eq!((report.is_sound, report.sound_windows, report.damages), (true, 40, Vec::new()));
    change(
        folder.path(),
        "UPDATE channel SET lines = zeroblob(13) WHERE window = 3; DELETE FROM window WHERE id = 5;
        UPDATE service SET first_window = 4 WHERE node = 2",
    );
    let bytes = fs::read(folder.path().join(ARCHIVE_FILE)).unwrap();
    let report = Archive::check(folder.path()).unwrap();
    let words: Vec<String> = report.damages.iter().map(ToString::to_string).collect();
    assert_eq!(
        words,
        [
            "row 2 of service: it does not match its checksum",
            "the hour from 1970-01-01T00:00:00Z: 22 rows of setup \"now\" should be there, 21 are",
            "window 1 of node 1 (boot 7), begun 1970-01-01T00:05:58Z: it does not match its checksum",
        ]
    );
    assert_eq!((report.is_sound, report.sound_windows), (false, 38));
    assert_eq!(fs::read(folder.path().join(ARCHIVE_FILE)).unwrap(), bytes);
    assert!(matches!(Archive::check(Path::new("nowhere")), Err(ArchiveError::Absent { .. })));
}

#[test]
fn a_repair_keeps_the_damaged_archive_and_all_that_is_sound() {
    let folder = hours(2).closed();
    let before = all(folder.path());
    assert_eq!(Archive::repair(folder.path()).unwrap().kept_as, None, "a sound one stays");
    // A window that is gone, one beyond mending, and two with a bit flipped: in its lines, and in what was asked.
    change(folder.path(), "DELETE FROM window WHERE id = 5; UPDATE channel SET lines = zeroblob(14) WHERE window = 3;
        UPDATE window SET drift_ppb = 1024 WHERE id = 9;
        UPDATE asked SET channels = replace(channels, 'top', 'tos') WHERE node = 1; UPDATE asked SET channels = replace(channels, 'tos', 'toq') WHERE node = 1");
    let damaged = fs::read(folder.path().join(ARCHIVE_FILE)).unwrap();
    #[cfg(unix)]
    fs::set_permissions(folder.path().join(ARCHIVE_FILE), std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
    let report = Archive::repair(folder.path()).unwrap();
    let kept_as = report.kept_as.unwrap();
    assert_eq!(fs::read(&kept_as).unwrap(), damaged);
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions();
    assert_eq!(mode(&folder.path().join(ARCHIVE_FILE)), mode(&kept_as), "who may read it stays");
    assert!(kept_as.file_name().unwrap().to_str().unwrap().starts_with("archive.damaged-"));
    assert_eq!((report.windows, report.mended), (38, 2));
    let words: Vec<String> = report.lost.iter().map(ToString::to_string).collect();
    assert_eq!(
        words,
        [
            "window 1 of node 1 (boot 7), begun 1970-01-01T00:05:58Z: it does not match its checksum",
            "the hour from 1970-01-01T00:00:00Z: 1 window of setup \"now\" is lost",
        ]
    );
    let after = all(folder.path());
    assert_eq!(after.2, []);
    assert!(Archive::check(folder.path()).unwrap().is_sound);
    // All but the two are as they were.
    let mut expected = before.1;
    for lost in [1, 2] {
        (expected[lost].channels[0], expected[lost].channels[2]) = (None, None);
    }
    assert_eq!(after.1, expected);
    // And collecting goes on.
    let two = configuration(2, 256);
    let mut archive = Archive::create(folder.path()).unwrap();
    archive.store("now", &two, &sent(&two, 1, 20, 1400), HostTime(0)).unwrap();
    assert!(
        fs::read_dir(folder.path()).unwrap().all(|entry| !entry
            .unwrap()
            .path()
            .to_str()
            .unwrap()
            .ends_with(".partial"))
    );
}

#[test]
fn an_archive_that_is_being_written_to_is_not_repaired_and_one_that_is_repaired_not_written_to() {
    let bench = hours(1);
    assert!(matches!(Archive::repair(bench.folder.path()), Err(ArchiveError::InUse { .. })));
    let folder = bench.closed();
    let lock = lock_file(folder.path()).unwrap();
    lock.try_lock().unwrap();
    let error = Archive::create(folder.path()).unwrap_err();
    assert!(error.may_pass(), "{error}");
    assert!(Archive::open(folder.path()).unwrap().is_some(), "reading goes on");
}

#[test]
fn pruning_keeps_what_it_is_told_and_a_dry_run_says_what_goes() {
    let mut bench = hours(5);
    let now = HostTime(40 * 3_600_000_000);
    let before = all(bench.folder.path());
    let found = bench.archive.prunable(Duration::from_secs(2 * 3600), now).unwrap();
    // Windows begin every 358.4 s, the newest at 49 of these.
    let gone: Vec<_> =
        found.nodes.iter().map(|node| (node.node, node.windows, node.first.as_str(), node.last.as_str())).collect();
    let times = ("1970-01-01T00:00:00Z", "1970-01-01T02:47:15Z");
    assert_eq!(gone, [(1, 29, times.0, times.1), (2, 29, times.0, times.1)]);
    assert_eq!((found.windows(), found.kept_windows), (58, 42));
    assert_eq!(all(bench.folder.path()), before, "nothing is dropped by asking");
    bench.archive.prune(&found).unwrap();
    let after = all(bench.folder.path());
    let rest: Vec<_> = after.1.iter().map(|window| &window.channels).collect();
    assert_eq!(rest, before.1[29..].iter().map(|window| &window.channels).collect::<Vec<_>>());
    assert!(Archive::check(bench.folder.path()).unwrap().is_sound);
    // What was dropped is not asked from the node again, and not counted as lost.
    assert_eq!(bench.archive.kept(1, 7).unwrap().unwrap().first, 29);
    assert_eq!(bench.archive.health().unwrap()[0].lost_windows, 0);
    // Nobody misses what was damaged before that.
    assert_eq!(
        bench.archive.connection.query_row("SELECT min(hour) FROM tally WHERE kind = 'window'", [], |row| row.get(0)),
        Ok(2)
    );
    // A clock that was years ahead once does not cost all the others.
    let two = configuration(2, 256);
    bench.store(&two, &sent(&two, 1, 50, 900_000_000));
    assert_eq!(bench.archive.prunable(Duration::from_secs(2 * 3600), now).unwrap().windows(), 0);
}

#[test]
fn pruning_gives_room_back() {
    let mut bench = Bench::new();
    let two = configuration(2, 256);
    for number in 0..400 {
        let lines = vec![Complex32::new(0.1, 0.2); 300];
        let window = NodeWindow {
            channels: vec![ChannelData::Lines(lines); 2],
            ..window(&two, 1, number, 70 * u64::from(number))
        };
        bench.store(&two, &window);
    }
    let size = |bench: &Bench| {
        bench.archive.connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(())).unwrap();
        fs::metadata(bench.archive.file()).unwrap().len()
    };
    let before = size(&bench);
    let found = bench.archive.prunable(Duration::from_secs(3600), HostTime(i64::MAX)).unwrap();
    bench.archive.prune(&found).unwrap();
    assert!(size(&bench) * 5 < before, "{before} -> {}", size(&bench));
}

#[test]
fn a_range_is_an_archive_of_its_own_or_a_table() {
    let bench = hours(3);
    let hour = 3_600_000_000;
    let range = TimeRange { from_us: Some(hour), to_us: Some(2 * hour), last: None };
    let (second, elsewhere) = (bench.folder.path().join("hour.sqlite"), tempfile::tempdir().unwrap());
    let extract = bench.archive.extract_archive(&range, &second).unwrap();
    assert_eq!((extract.windows, extract.damages), (20, Vec::new()));
    fs::copy(&second, elsewhere.path().join(ARCHIVE_FILE)).unwrap();
    let (found, expected) = (all(elsewhere.path()), read(bench.folder.path(), &range).unwrap().unwrap());
    assert_eq!((found.1, found.2), (expected.1, Vec::new()));
    let table = bench.folder.path().join("hour.csv");
    change(bench.folder.path(), "UPDATE window SET drift_ppb = 5 WHERE number = 12 AND node = 2");
    let extract = bench.archive.extract_csv(&range, &table).unwrap();
    assert_eq!((extract.windows, extract.damages.len()), (19, 1));
    let text = fs::read_to_string(&table).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
    assert_eq!(rows.len(), 1 + 5 * (10 * 2 + 9));
    assert_eq!(rows[1][..5], ["now", "1", "7", "11", "1970-01-01T01:05:42Z"]);
    // Lines are 25 Hz / 256 apart, the first is the third.
    assert_eq!(rows[1][8..11], ["low", "sound", "0.29296875"]);
    let ChannelData::Lines(lines) = &sent(&configuration(2, 256), 1, 11, 0).channels[0] else { panic!() };
    assert_eq!([rows[1][11].parse(), rows[1][12].parse()], [Ok(lines[0].re), Ok(lines[0].im)]);
}

#[test]
fn windows_that_damage_has_taken_are_not_missed_once_their_time_is_pruned() {
    let mut bench = hours(5);
    change(bench.folder.path(), "DELETE FROM channel WHERE window = 3; DELETE FROM window WHERE id = 3");
    assert!(!Archive::check(bench.folder.path()).unwrap().is_sound);
    let found = bench.archive.prunable(Duration::from_secs(2 * 3600), HostTime(i64::MAX)).unwrap();
    bench.archive.prune(&found).unwrap();
    assert_eq!(Archive::check(bench.folder.path()).unwrap().damages, []);
}

#[test]
fn pruning_waits_for_another_program_that_writes_and_says_so() {
    let (mut bench, _) = Bench::of_one(9);
    bench.archive.wait_for_others(std::time::Duration::from_millis(20)).unwrap();
    let found = bench.archive.prunable(std::time::Duration::from_secs(10), HostTime(i64::MAX)).unwrap();
    let file = bench.archive.file().to_owned();
    let (locked_sender, locked) = std::sync::mpsc::channel();
    let other = std::thread::spawn(move || {
        let other = rusqlite::Connection::open(file).unwrap();
        other.execute_batch("BEGIN IMMEDIATE").unwrap();
        locked_sender.send(()).unwrap();
        std::thread::sleep(std::time::Duration::from_millis(300));
        other.execute_batch("ROLLBACK").unwrap();
    });
    locked.recv().unwrap();
    let mut told = Vec::new();
    bench.archive.prune_patiently(&found, &mut |error| told.push(error.to_string())).unwrap();
    other.join().unwrap();
    assert!(told.len() == 1 && told[0].contains("locked"), "{told:?}");
    assert_eq!(Archive::check(bench.folder.path()).unwrap().sound_windows, 9 - found.windows());
}
