//! Patience with an archive that cannot be written for a while: another program writes, or the disk is full. It is tried again with
//! growing pauses; meanwhile nodes keep their windows, for nothing is acknowledged.

use std::time::{Duration, Instant};

/// The pause after the first failure; each further one takes twice as long.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// The longest pause.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);

/// When to try again. Times are the steady clock's.
#[derive(Debug, Default)]
pub(crate) struct Patience(Option<Trouble>);

#[derive(Debug)]
struct Trouble {
    since: Duration,
    pause: Duration,
    until: Duration,
}

impl Patience {
    /// Whether the next try is still to come.
    pub(crate) fn is_waiting(&self, now: Duration) -> bool {
        self.0.as_ref().is_some_and(|trouble| now < trouble.until)
    }

    /// Ends the pause.
    pub(crate) fn try_now(&mut self, now: Duration) {
        if let Some(trouble) = &mut self.0 {
            trouble.until = trouble.until.min(now);
        }
    }

    /// Takes note of a failure; whether it is the first after all went well.
    pub(crate) fn failed(&mut self, now: Duration) -> bool {
        match &mut self.0 {
            None => {
                self.0 = Some(Trouble { since: now, pause: FIRST_PAUSE, until: now + FIRST_PAUSE });
                true
            }
            // Another port has failed at the same time.
            Some(trouble) if now < trouble.until => false,
            Some(trouble) => {
                trouble.pause = (2 * trouble.pause).min(LONGEST_PAUSE);
                trouble.until = now + trouble.pause;
                false
            }
        }
    }

    /// Takes note that it has worked; how long it had not.
    pub(crate) fn worked(&mut self, now: Duration) -> Option<Duration> {
        self.0.take().map(|trouble| now.saturating_sub(trouble.since))
    }
}

/// Does what may fail for a while, again and again with growing pauses, as long as the failure `passes`; `on_wait` gets the first one. `None` where
/// it `stops` before.
///
/// # Errors
/// The first failure that does not pass.
pub(crate) fn patiently<T, E>(
    mut work: impl FnMut() -> Result<T, E>,
    passes: impl Fn(&E) -> bool,
    mut on_wait: impl FnMut(&E),
    stops: impl Fn() -> bool,
) -> Result<Option<T>, E> {
    const LOOK: Duration = Duration::from_millis(200);
    let (start, mut patience) = (Instant::now(), Patience::default());
    loop {
        match work() {
            Err(error) if passes(&error) => {
                if patience.failed(start.elapsed()) {
                    on_wait(&error);
                }
            }
            done => return done.map(Some),
        }
        while patience.is_waiting(start.elapsed()) {
            if stops() {
                return Ok(None);
            }
            std::thread::sleep(LOOK);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pauses_grow_to_a_minute_and_the_next_trouble_begins_anew() {
        let (mut patience, mut now) = (Patience::default(), Duration::from_secs(100));
        assert!(!patience.is_waiting(now) && patience.failed(now) && !patience.failed(now));
        let mut pauses = Vec::new();
        for _ in 0..9 {
            let until = patience.0.as_ref().unwrap().until;
            pauses.push((until - now).as_secs());
            assert!(patience.is_waiting(until - Duration::from_millis(1)) && !patience.is_waiting(until));
            now = until;
            assert!(!patience.failed(now));
        }
        assert_eq!(pauses, [1, 2, 4, 8, 16, 32, 60, 60, 60]);
        assert_eq!(patience.worked(now), Some(now - Duration::from_secs(100)));
        assert_eq!((patience.worked(now), patience.failed(now)), (None, true));
        assert!(!patience.is_waiting(now + FIRST_PAUSE));
        patience.try_now(now);
        assert!(!patience.is_waiting(now));
    }
}
