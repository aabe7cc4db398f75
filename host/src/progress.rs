//! How far long work is: its stage, and a count in it. A computation tells a [`Tally`], from whatever thread; whoever asked for the work
//! hears of it as [`Progress`], and can [`give_up`] the work where it is.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use serde::Serialize;

/// How far a step has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Progress {
    /// What is going on, in a few words.
    pub stage: &'static str,
    /// How much of it is done.
    pub done: u64,
    /// Of how much.
    pub total: u64,
}

/// Hears of progress, some times a second. Pass `&mut |_| {}` where nobody listens. Within [`unless_given_up`] it may [`give_up`].
pub type OnProgress<'a> = &'a mut dyn FnMut(Progress);

/// What unwinds through work that is given up.
struct GivenUp;

/// Gives up the work that tells of its progress: unwinds to the [`unless_given_up`] around it, past destructors, which remove files that
/// are not finished. No panic is reported.
pub fn give_up() -> ! {
    resume_unwind(Box::new(GivenUp))
}

/// Does work whose listener may [`give_up`]; `None` where it did. What the work was changing in memory is lost with it.
pub fn unless_given_up<T>(work: impl FnOnce() -> T) -> Option<T> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(done) => Some(done),
        Err(panic) if panic.is::<GivenUp>() => None,
        Err(panic) => resume_unwind(panic),
    }
}

/// What [`crate::measure`] counts, as progress of one stage.
pub(crate) fn rows_of<'a>(stage: &'static str, on_progress: OnProgress<'a>) -> impl FnMut(u64, u64) + 'a {
    move |done, total| on_progress(Progress { stage, done, total })
}

/// Counts what a computation has done, stage by stage. Copies count together, on whatever threads; by default nobody listens.
#[derive(Debug, Clone, Default)]
pub struct Tally(Option<Arc<Counted>>);

#[derive(Debug)]
struct Counted {
    now: Mutex<Progress>,
    listener: Sender<Heard>,
    is_given_up: AtomicBool,
}

/// What the listening thread is told.
enum Heard {
    Progress(Progress),
    End,
}

/// Where nobody listens.
pub static UNHEARD: Tally = Tally(None);

impl Tally {
    /// Begins a stage of `total` pieces; one without any is none.
    pub fn stage(&self, stage: &'static str, total: usize) {
        if total == 0 {
            return;
        }
        self.tell(|now| *now = Progress { stage, done: 0, total: total as u64 });
    }

    /// Does one piece of the stage.
    pub fn piece<T>(&self, work: impl FnOnce() -> T) -> T {
        let done = work();
        self.one();
        done
    }

    /// One more piece of the stage is done.
    pub fn one(&self) {
        self.tell(|now| now.done = (now.done + 1).min(now.total));
    }

    fn tell(&self, change: impl FnOnce(&mut Progress)) {
        let Some(counted) = &self.0 else { return };
        if counted.is_given_up.load(Ordering::Relaxed) {
            give_up();
        }
        let mut now = counted.now.lock().unwrap_or_else(PoisonError::into_inner);
        change(&mut now);
        // Told under the lock, so that counts arrive in order. Work that goes on after its end has nobody to tell.
        let _ = counted.listener.send(Heard::Progress(*now));
    }
}

/// Does work that counts what it has done, and tells of it on the calling thread meanwhile. Where the listener gives up, the work ends at
/// its next piece.
pub fn counted<T: Send>(on_progress: OnProgress<'_>, work: impl FnOnce(&Tally) -> T + Send) -> T {
    let (sender, heard) = channel();
    let now = Mutex::new(Progress { stage: "", done: 0, total: 0 });
    let counted = Arc::new(Counted { now, listener: sender.clone(), is_given_up: AtomicBool::new(false) });
    let tally = Tally(Some(Arc::clone(&counted)));
    let is_given_up = &counted.is_given_up;
    thread::scope(|scope| {
        let working = scope.spawn(move || {
            // Also where the work panics: what it returns may hold copies of the tally, so nobody waits for the last of them.
            let _end = AtEnd(sender);
            work(&tally)
        });
        for progress in heard.iter().map_while(|heard| match heard {
            Heard::Progress(progress) => Some(progress),
            Heard::End => None,
        }) {
            if !is_given_up.load(Ordering::Relaxed) && unless_given_up(|| on_progress(progress)).is_none() {
                is_given_up.store(true, Ordering::Relaxed);
            }
        }
        let done = working.join().unwrap_or_else(|panic| resume_unwind(panic));
        // It may have been at its last piece.
        if is_given_up.load(Ordering::Relaxed) {
            give_up();
        }
        done
    })
}

/// Says that the work has ended, however it did.
struct AtEnd(Sender<Heard>);

impl Drop for AtEnd {
    fn drop(&mut self) {
        // The listener waits for this.
        let _ = self.0.send(Heard::End);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicU64;
    use std::time::Duration;

    use rayon::prelude::*;

    use super::*;

    #[test]
    fn counts_of_all_threads_arrive_in_order_and_end_with_the_work() {
        let mut heard = Vec::new();
        let kept = counted(&mut |progress| heard.push(progress), |tally| {
            tally.stage("first", 100);
            (0..100).into_par_iter().for_each(|_| tally.one());
            tally.stage("second", 1);
            tally.one();
            tally.one();
            tally.clone()
        });
        let done: Vec<u64> = heard.iter().filter(|told| told.stage == "first").map(|told| told.done).collect();
        assert_eq!(done, (0..=100).collect::<Vec<_>>());
        // No more than there is.
        assert_eq!(heard.last(), Some(&Progress { stage: "second", done: 1, total: 1 }));
        // What outlives the work tells nobody.
        kept.stage("later", 1);
        Tally::default().one();
    }

    #[test]
    #[should_panic(expected = "broken")]
    fn work_that_panics_does_not_keep_its_listener_waiting() {
        counted(&mut |_| {}, |tally| {
            let _copy = tally.clone();
            panic!("broken");
        })
    }

    #[test]
    fn work_that_is_given_up_ends_at_its_next_piece_on_every_thread() {
        for last in [3, 100] {
            let (mut heard, begun) = (0, AtomicU64::new(0));
            let [asked, done] = [AtomicBool::new(false), AtomicBool::new(false)];
            let outcome = unless_given_up(|| {
                let on_progress = &mut |progress: Progress| {
                    heard += 1;
                    if progress.done == last {
                        asked.store(true, Ordering::Relaxed);
                        give_up();
                    }
                };
                // What comes after the last piece that is wanted begins when the listener has heard of that.
                let work = || {
                    if begun.fetch_add(1, Ordering::Relaxed) > last {
                        while !asked.load(Ordering::Relaxed) {
                            thread::yield_now();
                        }
                        thread::sleep(Duration::from_millis(1));
                    }
                };
                counted(on_progress, |tally| {
                    tally.stage("pieces", 100);
                    (0..100).into_par_iter().for_each(|_| tally.piece(work));
                    done.store(true, Ordering::Relaxed);
                })
            });
            assert_eq!(outcome, None);
            // Stage and pieces up to the last, and nothing after it.
            assert_eq!(heard, last + 1);
            // The last piece is told of when nothing is left to be given up.
            assert_eq!(done.into_inner(), last == 100);
        }
        assert_eq!(unless_given_up(|| 7), Some(7));
    }

    #[test]
    #[should_panic(expected = "broken")]
    fn another_panic_is_not_taken_for_it() {
        unless_given_up(|| panic!("broken"));
    }
}
