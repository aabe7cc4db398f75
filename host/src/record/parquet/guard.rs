//! A fence around the Parquet library: where it panics on a damaged file, the caller gets an error.

use std::cell::Cell;
use std::panic::{self, AssertUnwindSafe};
use std::path::Path;
use std::sync::Once;

use crate::record::error::RecordError;

thread_local! {
    /// This thread is within [`guarded`].
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

static QUIET_HOOK: Once = Once::new();

/// Runs `work`, and makes an error of a panic in it.
///
/// The library checks most of what a file says, but not all: sizes and offsets of a damaged one reach slice indices and
/// additions in its decoders. Nobody but the process's panic hook could keep the panic's message from standard error, so
/// a hook that is silent within this function is put before the one there, once.
///
/// What `work` changes may be half done after a panic. That is sound here: the reader that fails is not read further.
pub(super) fn guarded<T>(path: &Path, work: impl FnOnce() -> Result<T, RecordError>) -> Result<T, RecordError> {
    QUIET_HOOK.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |information| {
            if !GUARDED.get() {
                before(information);
            }
        }));
    });
    let outer = GUARDED.replace(true);
    let outcome = panic::catch_unwind(AssertUnwindSafe(work));
    GUARDED.set(outer);
    outcome.unwrap_or_else(|_| Err(RecordError::parquet(path, "the description of its layout contradicts itself")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_an_error_that_names_the_file() {
        let error = guarded::<()>(Path::new("a.parquet"), || panic!("index out of bounds")).unwrap_err().to_string();
        assert!(error.contains("a.parquet") && error.contains("contradicts itself"), "{error}");
        assert_eq!(guarded(Path::new("a.parquet"), || Ok(7)).unwrap(), 7);
    }
}
