//! The host's clock while it collects: Unix time that never jumps, until it has to.

use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use belfry_shared::time::HostTime;

use super::lock::lock;

/// A difference between the computer's clock and what has passed since it was read that means that it was set, or that the
/// computer slept.
const JUMP: Duration = Duration::from_millis(500);

/// What tells the time.
pub trait Clock: Sync {
    /// Time since a moment of its own, by a clock that nobody sets.
    fn steady(&self) -> Duration;
    /// Unix time by the computer's clock, which may be set.
    fn unix(&self) -> Duration;
}

/// The computer's clocks.
#[derive(Debug, Clone, Copy)]
pub struct SystemClock {
    start: Instant,
}

impl SystemClock {
    /// The clocks, with steady time from now on.
    #[expect(clippy::new_without_default, reason = "it begins to count now")]
    pub fn new() -> Self {
        Self { start: Instant::now() }
    }
}

impl Clock for SystemClock {
    fn steady(&self) -> Duration {
        self.start.elapsed()
    }

    /// A clock that stands before 1970 counts from there.
    fn unix(&self) -> Duration {
        SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
    }
}

/// Unix time, carried on by the steady clock: where the computer's clock is set while nodes measure, their windows must not
/// be torn apart. A jump begins a new generation.
pub(super) struct HostClock {
    base: Mutex<Base>,
}

#[derive(Clone, Copy)]
struct Base {
    unix: Duration,
    steady: Duration,
    generation: u64,
}

impl Base {
    /// Unix time at a moment of the steady clock, when the computer's clock shows `unix`. The computer may slow its clock down
    /// or hurry it; this counts only once it adds up to a jump.
    fn look(&mut self, unix: Duration, steady: Duration) -> Duration {
        let carried_on = self.unix + steady.saturating_sub(self.steady);
        if carried_on.abs_diff(unix) <= JUMP {
            return carried_on;
        }
        *self = Self { unix, steady, generation: self.generation + 1 };
        unix
    }
}

impl HostClock {
    pub(super) fn new(clock: &dyn Clock) -> Self {
        Self { base: Mutex::new(Base { unix: clock.unix(), steady: clock.steady(), generation: 0 }) }
    }

    /// Now, and how often the computer's clock has jumped.
    pub(super) fn look(&self, clock: &dyn Clock) -> (HostTime, u64) {
        let mut base = lock(&self.base);
        let now = base.look(clock.unix(), clock.steady());
        (HostTime::since_epoch(now), base.generation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn what_creeps_is_left_alone_and_a_jump_begins_anew_either_way() {
        let steady = 77 * SECOND;
        let mut base = Base { unix: 1000 * SECOND, steady, generation: 0 };
        // 400 ms ahead after an hour: nodes measure drifts against a clock that runs evenly.
        let hour = 3600 * SECOND;
        assert_eq!(base.look(4600 * SECOND + SECOND * 2 / 5, steady + hour), 4600 * SECOND);
        assert_eq!(base.generation, 0);
        // Set ahead by a day, as after a start without network.
        assert_eq!(base.look(91_000 * SECOND, steady + hour + SECOND), 91_000 * SECOND);
        assert_eq!(base.generation, 1);
        assert_eq!(base.look(91_001 * SECOND, steady + hour + 2 * SECOND), 91_001 * SECOND);
        // Set back.
        assert_eq!(base.look(90_999 * SECOND, steady + hour + 3 * SECOND), 90_999 * SECOND);
        assert_eq!(base.generation, 2);
    }
}
