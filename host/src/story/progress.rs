//! Progress of the steps that take their time.

use serde::Serialize;

/// How far a step has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Progress {
    /// What is going on, in a word or two.
    pub stage: &'static str,
    /// How much of it is done.
    pub done: u64,
    /// Of how much.
    pub total: u64,
}

/// Hears of progress, some times a second. Pass `&mut |_| {}` where nobody listens.
pub type OnProgress<'a> = &'a mut dyn FnMut(Progress);

/// What [`crate::measure`] counts, as progress of one stage.
pub(super) fn rows_of<'a>(stage: &'static str, on_progress: OnProgress<'a>) -> impl FnMut(u64, u64) + 'a {
    move |done, total| on_progress(Progress { stage, done, total })
}
