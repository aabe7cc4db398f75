//! Ctrl-C and requests to end.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;

use crate::files::remove_unfinished;

/// Exit status of a program that Ctrl-C ended, as shells count it.
const INTERRUPTED: i32 = 130;

/// A flag that Ctrl-C and the system's request to end set, for commands that end in good order.
pub(super) fn stop_on_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed)).context("Ctrl-C cannot be waited for")?;
    Ok(stop)
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
