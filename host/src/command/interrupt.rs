//! Ctrl-C and requests to end.

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;

use super::Console;
use crate::files::{FolderLock, remove_unfinished};
use crate::study::{STUDY_FILE, Study};

/// Exit status of a program that Ctrl-C ended, as shells count it.
const INTERRUPTED: i32 = 130;

/// A flag that Ctrl-C and the system's request to end set, for commands that end in good order.
pub(super) fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("Ctrl-C cannot be waited for")?;
    Ok(stop)
}

/// Takes the study's lock, so that no other command writes there meanwhile; waits for one that does. `None` where there is no study, or
/// nothing can be written into its folder: what writes there says so.
pub(super) fn alone(study: &Path, console: &Console) -> anyhow::Result<Option<FolderLock>> {
    let study = Study::folder_of(study);
    if study.join(STUDY_FILE).exists() { alone_in(study, console) } else { Ok(None) }
}

/// As [`alone`], of a folder that may become a study's.
pub(super) fn alone_in(folder: &Path, console: &Console) -> anyhow::Result<Option<FolderLock>> {
    let wait = || console.warn("another command is writing into this study; waiting for it to end");
    match FolderLock::take(folder, wait) {
        Err(error) if matches!(error.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem) => Ok(None),
        lock => lock.map(Some).with_context(|| format!("{} cannot be changed", folder.display())),
    }
}

/// From now on an interruption removes the files that are being written, and ends the program.
pub(super) fn leave_nothing_unfinished() -> anyhow::Result<()> {
    let end = || {
        remove_unfinished();
        // Where standard error is closed there is nobody left to tell.
        let _ = writeln!(std::io::stderr(), "\ninterrupted; files that were not finished are removed");
        std::process::exit(INTERRUPTED);
    };
    ctrlc::set_handler(end).context("Ctrl-C cannot be waited for")
}
