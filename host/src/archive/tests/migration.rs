//! An archive of version 1 becomes one of this version, with all that it holds.

use rusqlite::params;

use super::*;

/// The archive of two nodes as version 1 wrote it.
fn version_1(folder: &Path, windows: u32) {
    let archive = Connection::open(folder.join(ARCHIVE_FILE)).unwrap();
    archive.execute_batch(include_str!("schema_1.sql")).unwrap();
    archive.pragma_update(None, "application_id", APPLICATION_ID).unwrap();
    archive.pragma_update(None, "user_version", 1).unwrap();
    for (node, channels) in [(1, 2), (2, 1)] {
        let configuration = configuration(channels, 256);
        let names = if channels == 2 { "[\"low\",\"top\"]" } else { "[\"middle\"]" };
        let settings = serde_json::to_string(&configuration).unwrap();
        let asked = "INSERT INTO asked (setup, node, since_us, configuration, settings, channels) VALUES ('now', ?1, 1, ?2, ?3, ?4)";
        archive.execute(asked, params![node, configuration.hash(), settings, names]).unwrap();
        let service = "INSERT INTO service (setup, node, boot, first_window, since_us) VALUES ('now', ?1, 7, 0, 1)";
        archive.execute(service, [node]).unwrap();
        for number in 0..windows {
            let window = sent(&configuration, node, number, u64::from(number));
            let start_us = i64::from(number) * 5_120_000;
            let row = "INSERT INTO window (node, boot, number, setup, configuration, grid_index, start_us, middle_offset_us, drift_ppb, received_us)
                 VALUES (?1, 7, ?2, 'now', ?3, ?2, ?4, 0, 0, 5)";
            archive.execute(row, params![node, number, configuration.hash(), start_us]).unwrap();
            let id = archive.last_insert_rowid();
            for (index, data) in window.channels.iter().enumerate() {
                let ChannelData::Lines(lines) = data else { unreachable!("only lines are sent") };
                let bytes: Vec<u8> =
                    lines.iter().flat_map(|line| [line.re, line.im]).flat_map(f32::to_le_bytes).collect();
                let channel =
                    "INSERT INTO channel (window, channel, state, segments, lines) VALUES (?1, ?2, 'sound', 1, ?3)";
                archive.execute(channel, params![id, index, bytes]).unwrap();
            }
        }
    }
}

#[test]
fn an_archive_of_version_1_keeps_its_windows_and_gets_checksums() {
    let folder = tempfile::tempdir().unwrap();
    version_1(folder.path(), 50);
    let (setup, windows, damages) = read(folder.path(), &TimeRange::ALL).unwrap().unwrap();
    assert_eq!((setup.windows, windows.len(), damages), (50, 50, Vec::new()));
    for (number, whole) in (0..).zip(&windows) {
        let lines = |node, channels, place: usize| match &sent(&configuration(channels, 256), node, number, 0).channels
            [place]
        {
            ChannelData::Lines(lines) => Some(lines.clone()),
            _ => None,
        };
        assert_eq!(whole.channels, [lines(1, 2, 0), lines(2, 1, 0), lines(1, 2, 1)]);
    }
    // Lines take as many bits as they were sent in; what a node has delivered is known; collecting goes on.
    let mut archive = Archive::create(folder.path()).unwrap();
    let bits =
        archive.connection.query_row("SELECT min(bits), max(bits), max(length(lines)) FROM channel", [], |row| {
            Ok((row.get(0)?, row.get(1)?, row.get(2)?))
        });
    assert_eq!(bits, Ok((10, 10, encoded_bytes(usize::from(LINES), 10))));
    assert_eq!(archive.kept(1, 7).unwrap().unwrap().numbers.len(), 50);
    let two = configuration(2, 256);
    archive.store("now", &two, &sent(&two, 1, 50, 50), HostTime(0)).unwrap();
    let (_, _, damages) = read(folder.path(), &TimeRange::ALL).unwrap().unwrap();
    assert_eq!(damages, []);
    let tables = "SELECT count(*) FROM sqlite_schema WHERE name LIKE '%\\_1' ESCAPE '\\' AND type = 'table'";
    assert_eq!(archive.connection.query_row(tables, [], |row| row.get::<_, i64>(0)), Ok(0));
}

#[test]
fn a_sound_archive_of_version_1_is_brought_up_by_a_repair_and_no_other_is_made() {
    let folder = tempfile::tempdir().unwrap();
    version_1(folder.path(), 20);
    let checked = Archive::check(folder.path()).unwrap();
    assert_eq!((checked.version, checked.sound_windows), (1, 40));
    let repaired = Archive::repair(folder.path()).unwrap();
    assert_eq!((repaired.kept_as, repaired.windows), (None, 40));
    assert_eq!(Archive::check(folder.path()).unwrap().version, VERSION);
}

#[test]
fn several_programs_that_find_version_1_at_once_migrate_it_once() {
    let folder = tempfile::tempdir().unwrap();
    version_1(folder.path(), 20);
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| assert_eq!(read(folder.path(), &TimeRange::ALL).unwrap().unwrap().1.len(), 20));
        }
    });
}

#[test]
fn a_migration_that_fails_leaves_version_1_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    version_1(folder.path(), 20);
    let file = folder.path().join(ARCHIVE_FILE);
    let other = Connection::open(&file).unwrap();
    // A window that has no place among those of version 2.
    other.execute_batch("CREATE TABLE tally (kind TEXT)").unwrap();
    let error = read(folder.path(), &TimeRange::ALL).unwrap_err().to_string();
    assert!(error.contains("version 1") && error.contains("it is as it was"), "{error}");
    let count: i64 = other.query_row("SELECT count(*) FROM window WHERE setup = 'now'", [], |row| row.get(0)).unwrap();
    assert_eq!(count, 40);
    other.execute_batch("DROP TABLE tally").unwrap();
    assert_eq!(read(folder.path(), &TimeRange::ALL).unwrap().unwrap().1.len(), 20);
}

#[test]
fn an_archive_of_version_2_gets_a_list_of_what_is_lost() {
    let (bench, two) = Bench::of_one(30);
    let Bench { folder, archive } = bench;
    archive.connection.execute_batch("DROP TABLE loss; PRAGMA user_version = 2").unwrap();
    drop(archive);
    let checked = Archive::check(folder.path()).unwrap();
    assert_eq!((checked.version, checked.sound_windows, checked.is_sound), (2, 30, true));
    // Checksums are there already, so that damage shows before anything is changed.
    let database = Connection::open(folder.path().join(ARCHIVE_FILE)).unwrap();
    let damage = "UPDATE window SET drift_ppb = drift_ppb + 1 WHERE number = 3";
    database.execute(damage, []).unwrap();
    assert_eq!(Archive::check(folder.path()).unwrap().damages.len(), 1);
    database.execute("UPDATE window SET drift_ppb = drift_ppb - 1 WHERE number = 3", []).unwrap();
    let (_, windows, damages) = read(folder.path(), &TimeRange::ALL).unwrap().unwrap();
    // The newest two may still lack the other node.
    assert_eq!((windows.len(), damages), (28, Vec::new()));
    let checked = Archive::check(folder.path()).unwrap();
    assert_eq!((checked.version, checked.is_sound, checked.lost), (VERSION, true, Vec::new()));
    let mut archive = Archive::create(folder.path()).unwrap();
    archive.store("now", &two, &sent(&two, 1, 30, 30), HostTime(0)).unwrap();
}
