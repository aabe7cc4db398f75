//! What is damaged is left out and told, and the rest is read.

use super::*;

/// Six windows of a node, of which something is changed by SQL.
fn damaged_by(change: &str) -> Read {
    let (bench, _) = Bench::of_one(6);
    bench.archive.connection.execute_batch(change).unwrap();
    read(bench.folder.path(), &TimeRange::ALL).unwrap().unwrap()
}

/// Starts of the windows that are read, the last two of which may wait for node 2.
fn starts((_, windows, _): &Read) -> Vec<u64> {
    windows.iter().map(|window| window.grid_index).collect()
}

#[test]
fn a_window_that_is_not_as_it_was_written_is_left_out_and_named() {
    for (change, what) in [
        ("UPDATE channel SET lines = x'0102' WHERE channel = 1 AND window = 3", "checksum"),
        ("UPDATE channel SET lines = NULL WHERE channel = 1 AND window = 3", "checksum"),
        ("UPDATE channel SET bits = 9 WHERE channel = 1 AND window = 3", "checksum"),
        ("DELETE FROM channel WHERE channel = 1 AND window = 3", "checksum"),
        ("UPDATE window SET drift_ppb = 1 WHERE id = 3", "checksum"),
        ("UPDATE window SET grid_index = 1, number = 17 WHERE id = 3", "checksum"),
        ("UPDATE window SET node = 99 WHERE id = 3", "checksum"),
    ] {
        let read = damaged_by(change);
        let words: Vec<String> = read.2.iter().map(ToString::to_string).collect();
        assert_eq!(starts(&read), [0, 1, 3], "{change}: {words:?}");
        assert_eq!(words.len(), 1, "{change}: {words:?}");
        let name = ["window ", " of node ", "(boot 7), begun 1970-01-01T00:00:10Z: ", what];
        assert!(name.iter().all(|part| words[0].contains(part)), "{words:?}");
    }
}

#[cfg(unix)]
#[test]
fn a_pipe_in_the_place_of_an_archive_is_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let made = std::process::Command::new("mkfifo").arg(folder.path().join(ARCHIVE_FILE)).status().unwrap();
    assert!(made.success());
    assert!(matches!(Archive::open(folder.path()), Err(ArchiveError::NotAnArchive { .. })));
    assert!(matches!(Archive::check(folder.path()), Err(ArchiveError::NotAnArchive { .. })));
    assert!(matches!(Archive::create(folder.path()), Err(ArchiveError::NotAnArchive { .. })));
}

#[test]
fn a_window_that_is_gone_is_missed() {
    let read = damaged_by("DELETE FROM channel WHERE window = 3; DELETE FROM window WHERE id = 3");
    assert_eq!(starts(&read), [0, 1, 3]);
    let [damage] = &read.2[..] else { panic!("{:?}", read.2) };
    assert_eq!(
        damage.to_string(),
        "the hour from 1970-01-01T00:00:00Z: 6 rows of setup \"now\" should be there, 5 are"
    );
    // One that comes from nowhere, too.
    let read = damaged_by("DELETE FROM tally WHERE kind = 'window'");
    assert!(read.2[0].to_string().contains("0 rows of setup \"now\" should be there, 6 are"), "{:?}", read.2);
}

#[test]
fn what_was_asked_is_held_against_its_checksum_too() {
    let bench = Bench::with_windows_of_both(4);
    // Were it believed, both channels of node 1 would stand in each other's place.
    let swap = "UPDATE asked SET channels = '[\"top\",\"low\"]' WHERE node = 1";
    bench.archive.connection.execute(swap, []).unwrap();
    let (_, windows, damages) = read(bench.folder.path(), &TimeRange::ALL).unwrap().unwrap();
    assert!(windows.iter().all(|window| window.channels[0].is_none() && window.channels[1].is_some()));
    let words: Vec<String> = damages.iter().map(ToString::to_string).collect();
    assert_eq!(
        words,
        [
            "row 1 of asked: it does not match its checksum",
            "asked: 4 windows name settings that nobody has asked for, and cannot be analysed; `belfry collect` with the same [analysis] \
             notes these again"
        ]
    );
    // With nothing to go by there is nothing to read.
    bench.archive.connection.execute("DELETE FROM asked", []).unwrap();
    let error = read(bench.folder.path(), &TimeRange::ALL).unwrap_err().to_string();
    assert!(error.contains("2 rows of setup \"now\" should be there, 0 are"), "{error}");
}

/// A bit of a stored checksum takes nothing with it; settings that are gone are said, by the check and by the repair.
#[test]
fn what_was_asked_is_saved_where_its_checksum_has_changed_and_missed_where_it_is_gone() {
    let bench = Bench::with_windows_of_both(4);
    for table in ["asked", "window"] {
        let flip = format!("UPDATE {table} SET checksum = (checksum | 4) - (checksum & 4) WHERE id = 1");
        bench.archive.connection.execute(&flip, []).unwrap();
    }
    let Bench { archive, folder } = bench;
    drop(archive);
    let folder = folder.path();
    assert!(!Archive::check(folder).unwrap().is_sound);
    let report = Archive::repair(folder).unwrap();
    assert_eq!((report.windows, report.mended, report.lost), (8, 2, vec![]));
    let checked = Archive::check(folder).unwrap();
    assert!(checked.is_sound, "{checked:?}");
    assert_eq!(read(folder, &TimeRange::ALL).unwrap().unwrap().2, []);

    let archive = Archive::create(folder).unwrap();
    archive.connection.execute("DELETE FROM asked WHERE node = 1", []).unwrap();
    drop(archive);
    let gone = "4 windows name settings that nobody has asked for";
    for _ in 0..2 {
        let checked = Archive::check(folder).unwrap();
        assert!(!checked.is_sound && checked.damages.iter().any(|damage| damage.what.contains(gone)), "{checked:?}");
        let report = Archive::repair(folder).unwrap();
        assert!(report.windows == 8 && report.lost.iter().any(|damage| damage.what.contains(gone)), "{report:?}");
    }
}

#[test]
fn numbers_that_cannot_be_are_left_out_also_where_their_checksum_is_right() {
    let mut bench = Bench::new();
    let two = configuration(2, 256);
    bench.ask(&two, 1);
    for number in 0..6 {
        let mut window = sent(&two, 1, number, u64::from(number));
        match number {
            1 => window.channels[0] = ChannelData::Lines(vec![Complex32::new(f32::NAN, 0.0); usize::from(LINES)]),
            2 => window.channels[0] = ChannelData::Lines(vec![Complex32::new(3e12, 0.0); usize::from(LINES)]),
            3 => window.channels[0] = ChannelData::Lines(vec![Complex32::default(); 2]),
            4 => window.drift_ppb = 2_000_000_000,
            _ => {}
        }
        bench.store(&two, &window);
    }
    let (_, windows, damages) = read(bench.folder.path(), &TimeRange::ALL).unwrap().unwrap();
    assert!(windows.iter().all(|window| window.grid_index == 0), "and the last waits for node 2");
    let words: Vec<String> = damages.iter().map(|damage| damage.what.clone()).collect();
    let parts = ["no number", "no number, or above", "2 lines where there should be 5", "drifts by 2000000000 ppb"];
    assert_eq!(words.len(), parts.len(), "{words:?}");
    assert!(words.iter().zip(parts).all(|(word, part)| word.contains(part)), "{words:?}");
}

#[test]
fn an_archive_without_any_sound_window_says_what_is_damaged() {
    let mut bench = Bench::new();
    let two = configuration(2, 256);
    bench.ask(&two, 1);
    bench.store(&two, &sent(&two, 1, 0, 0));
    bench.archive.connection.execute("UPDATE window SET grid_index = 5", []).unwrap();
    let error = read(bench.folder.path(), &TimeRange::ALL).unwrap_err().to_string();
    assert!(error.contains("window 0 of node 1") && error.contains("checksum"), "{error}");
}

#[test]
fn a_damaged_start_does_not_move_what_is_counted_back_from_the_last() {
    let (bench, _) = Bench::of_one(9);
    let last = TimeRange { last: Some(std::time::Duration::from_secs_f64(5.12 * 4.0)), ..TimeRange::ALL };
    let before = read(bench.folder.path(), &last).unwrap().unwrap();
    // One bit in the start of the second window, years later.
    bench.archive.connection.execute("UPDATE window SET start_us = start_us + (1 << 50) WHERE id = 2", []).unwrap();
    let (setup, windows, damages) = read(bench.folder.path(), &last).unwrap().unwrap();
    assert_eq!((setup, windows), (before.0, before.1));
    let words: Vec<String> = damages.iter().map(ToString::to_string).collect();
    assert!(words.iter().any(|word| word.contains("window 1 of node 1") && word.contains("checksum")), "{words:?}");
}

#[test]
fn an_archive_whose_first_page_is_damaged_says_so_whatever_is_asked_of_it() {
    let Bench { folder, archive } = Bench::new();
    drop(archive);
    let file = folder.path().join(ARCHIVE_FILE);
    let mut bytes = std::fs::read(&file).unwrap();
    let table = b"CREATE TABLE window (";
    let at = bytes.windows(table.len()).position(|part| part == table).unwrap();
    bytes[at + 1] ^= 1;
    std::fs::write(&file, bytes).unwrap();
    let errors = [
        Archive::open(folder.path()).map(drop).unwrap_err(),
        Archive::check(folder.path()).map(drop).unwrap_err(),
        Archive::create(folder.path()).map(drop).unwrap_err(),
    ];
    for error in errors {
        assert!(matches!(error, ArchiveError::Unopenable { .. }), "{error}");
        assert!(error.to_string().contains("belfry archive repair"), "{error}");
    }
    // There is no window in it that would show where its tables begin.
    let error = Archive::repair(folder.path()).map(drop).unwrap_err();
    assert!(matches!(error, ArchiveError::NothingSaved { .. }), "{error}");
}

#[test]
fn a_damaged_first_page_is_rebuilt() {
    let (bench, _) = Bench::of_one(300);
    let sound = read(bench.folder.path(), &TimeRange::ALL).unwrap().unwrap();
    // As a collector leaves it that was killed: the last windows are in the log alone.
    let killed = tempfile::tempdir().unwrap();
    for name in [ARCHIVE_FILE.to_owned(), format!("{ARCHIVE_FILE}-wal")] {
        std::fs::copy(bench.folder.path().join(&name), killed.path().join(&name)).unwrap();
    }
    let mut page = std::fs::read(killed.path().join(ARCHIVE_FILE)).unwrap();
    page[..PAGE_BYTES as usize].fill(0x55);
    std::fs::write(killed.path().join(ARCHIVE_FILE), page).unwrap();
    let repaired = Archive::repair(killed.path()).unwrap();
    assert_eq!((repaired.windows, repaired.lost.len()), (300, 0));
    let Bench { folder, archive } = bench;
    drop(archive);
    let file = folder.path().join(ARCHIVE_FILE);
    let bytes = std::fs::read(&file).unwrap();
    assert!(bytes.len() > 4 * PAGE_BYTES as usize);
    let table = b"CREATE TABLE window (";
    let text = bytes.windows(table.len()).position(|part| part == table).unwrap();
    // The name of the format, the size of a page, the mark of an archive, where tables are listed, and the whole page.
    let damages: [(usize, usize); 5] = [(3, 1), (16, 1), (68, 1), (text + 1, 1), (0, PAGE_BYTES as usize)];
    for (at, length) in damages {
        let mut damaged = bytes.clone();
        damaged[at..at + length].iter_mut().for_each(|byte| *byte ^= 0x11);
        std::fs::write(&file, &damaged).unwrap();
        assert!(Archive::check(folder.path()).is_err(), "{length} bytes from {at}");
        let repaired = Archive::repair(folder.path()).unwrap();
        assert_eq!((repaired.windows, repaired.lost.len()), (300, 0), "{length} bytes from {at}");
        assert_eq!(std::fs::read(repaired.kept_as.unwrap()).unwrap(), damaged);
        assert!(Archive::check(folder.path()).unwrap().is_sound);
        let again = read(folder.path(), &TimeRange::ALL).unwrap().unwrap();
        assert_eq!((&again.0, &again.1), (&sound.0, &sound.1));
    }
    // Another program's database stays as it is.
    std::fs::remove_file(&file).unwrap();
    let other = rusqlite::Connection::open(&file).unwrap();
    other.execute_batch("CREATE TABLE notes (text TEXT); INSERT INTO notes VALUES ('mine')").unwrap();
    drop(other);
    let before = std::fs::read(&file).unwrap();
    assert!(matches!(Archive::repair(folder.path()).unwrap_err(), ArchiveError::NotAnArchive { .. }));
    assert_eq!(std::fs::read(&file).unwrap(), before);
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(left.iter().all(|name| !name.to_string_lossy().ends_with(".partial")), "{left:?}");
}
