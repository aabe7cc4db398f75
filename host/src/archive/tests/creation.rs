//! Two programs make one archive at the same time, and a reader comes while it is being made.

use std::sync::Barrier;

use super::*;

#[test]
fn several_collectors_that_start_at_once_make_one_archive() {
    const COLLECTORS: u16 = 6;
    for round in 0..20 {
        let folder = tempfile::tempdir().unwrap();
        let barrier = Barrier::new(usize::from(COLLECTORS));
        std::thread::scope(|scope| {
            for node in 0..COLLECTORS {
                let (barrier, folder) = (&barrier, folder.path());
                scope.spawn(move || {
                    barrier.wait();
                    let mut archive =
                        Archive::create(folder).unwrap_or_else(|error| panic!("round {round}: {error:?}"));
                    let two = configuration(2, 256);
                    archive.store("now", &two, &window(&two, node, 0, 7), HostTime(0)).unwrap();
                });
            }
        });
        let archive = Archive::open(folder.path()).unwrap().unwrap();
        let count: u16 = archive.connection.query_row("SELECT count(*) FROM window", [], |row| row.get(0)).unwrap();
        assert_eq!(count, COLLECTORS);
        let mode: String = archive.connection.pragma_query_value(None, "journal_mode", |row| row.get(0)).unwrap();
        assert_eq!(mode, "wal");
    }
}

#[test]
fn an_archive_that_is_being_made_is_none_yet() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(ARCHIVE_FILE), "").unwrap();
    assert!(Archive::open(folder.path()).unwrap().is_none());
    drop(Archive::create(folder.path()).unwrap());
    assert!(Archive::open(folder.path()).unwrap().is_some());
}
