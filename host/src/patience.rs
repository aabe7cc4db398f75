//! Patience with what cannot be done for a while: an archive that another program writes, or a server that is away. It is tried again with
//! growing pauses.

use std::time::{Duration, Instant};

/// The pause after the first failure; each further one takes twice as long.
const FIRST_PAUSE: Duration = Duration::from_secs(1);
/// The longest pause: with a full disk, or without a device.
const LONGEST_PAUSE: Duration = Duration::from_secs(60);
/// The same with a server, which asking costs little, and whose data should not wait.
const LONGEST_PAUSE_WITH_SERVER: Duration = Duration::from_secs(4);

/// When to try again. Times are the steady clock's.
#[derive(Debug)]
pub(crate) struct Patience {
    trouble: Option<Trouble>,
    longest_pause: Duration,
}

#[derive(Debug)]
struct Trouble {
    since: Duration,
    pause: Duration,
    until: Duration,
}

impl Default for Patience {
    fn default() -> Self {
        Self { trouble: None, longest_pause: LONGEST_PAUSE }
    }
}

impl Patience {
    /// With a server.
    pub(crate) fn with_server() -> Self {
        Self { longest_pause: LONGEST_PAUSE_WITH_SERVER, ..Self::default() }
    }

    /// Whether the next try is still to come.
    pub(crate) fn is_waiting(&self, now: Duration) -> bool {
        self.trouble.as_ref().is_some_and(|trouble| now < trouble.until)
    }

    /// Ends the pause.
    pub(crate) fn try_now(&mut self, now: Duration) {
        if let Some(trouble) = &mut self.trouble {
            trouble.until = trouble.until.min(now);
        }
    }

    /// Takes note of a failure; whether it is the first after all went well.
    pub(crate) fn failed(&mut self, now: Duration) -> bool {
        match &mut self.trouble {
            None => {
                self.trouble = Some(Trouble { since: now, pause: FIRST_PAUSE, until: now + FIRST_PAUSE });
                true
            }
            // Another port has failed at the same time.
            Some(trouble) if now < trouble.until => false,
            Some(trouble) => {
                trouble.pause = (2 * trouble.pause).min(self.longest_pause);
                trouble.until = now + trouble.pause;
                false
            }
        }
    }

    /// Takes note that it has worked; how long it had not.
    pub(crate) fn worked(&mut self, now: Duration) -> Option<Duration> {
        self.trouble.take().map(|trouble| now.saturating_sub(trouble.since))
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

    /// Pauses in s while nothing works, and when the last of them ends.
    fn pauses(patience: &mut Patience, mut now: Duration) -> ([u64; 9], Duration) {
        assert!(!patience.is_waiting(now) && patience.failed(now) && !patience.failed(now));
        let pauses = [(); 9].map(|()| {
            let until = patience.trouble.as_ref().unwrap().until;
            let pause = (until - now).as_secs();
            assert!(patience.is_waiting(until - Duration::from_millis(1)) && !patience.is_waiting(until));
            now = until;
            assert!(!patience.failed(now));
            pause
        });
        (pauses, now)
    }

    #[test]
    fn pauses_grow_to_a_minute_and_the_next_trouble_begins_anew() {
        let (mut patience, start) = (Patience::default(), Duration::from_secs(100));
        let (grown, now) = pauses(&mut patience, start);
        assert_eq!(grown, [1, 2, 4, 8, 16, 32, 60, 60, 60]);
        assert_eq!(patience.worked(now), Some(now - start));
        assert_eq!((patience.worked(now), patience.failed(now)), (None, true));
        assert!(!patience.is_waiting(now + FIRST_PAUSE));
        patience.try_now(now);
        assert!(!patience.is_waiting(now));
        assert_eq!(pauses(&mut Patience::with_server(), start).0, [1, 2, 4, 4, 4, 4, 4, 4, 4]);
    }
}
