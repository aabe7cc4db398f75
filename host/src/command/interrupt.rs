//! Ctrl-C and requests to end, for commands that write files.

use std::io::Write;

use crate::files::remove_unfinished;

/// Exit status of a program that Ctrl-C ended, as shells count it.
const INTERRUPTED: i32 = 130;

/// From now on an interruption removes the files that are being written, and ends the program.
pub(super) fn leave_nothing_unfinished() {
    let set = ctrlc::set_handler(|| {
        remove_unfinished();
        // Where standard error is closed there is nobody left to tell.
        let _ = writeln!(std::io::stderr(), "\ninterrupted; files that were not finished are removed");
        std::process::exit(INTERRUPTED);
    });
    // A second handler is refused: the first does the same.
    drop(set);
}
