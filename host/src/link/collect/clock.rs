//! The host's clock while it collects: Unix time that never jumps, until it has to.

use std::sync::Mutex;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use belfry_shared::time::HostTime;

use super::lock;

/// A difference between the computer's clock and what has passed since it was read that means that it was set, or that the
/// computer slept.
const JUMP: Duration = Duration::from_millis(500);

/// Unix time, carried on by the steady clock: where the computer's clock is set while nodes measure, their windows must not
/// be torn apart. A jump begins a new generation.
pub(super) struct HostClock(Mutex<Base>);

#[derive(Clone, Copy)]
struct Base {
    unix: Duration,
    read: Instant,
    generation: u64,
}

impl Base {
    fn read(generation: u64) -> Self {
        Self { unix: unix_time(), read: Instant::now(), generation }
    }

    fn now(&self) -> Duration {
        self.unix + self.read.elapsed()
    }
}

/// Unix time by the computer's clock; one that stands before 1970 counts from there.
pub fn unix_time() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

impl HostClock {
    pub(super) fn new() -> Self {
        Self(Mutex::new(Base::read(0)))
    }

    /// Now, and how often the computer's clock has jumped.
    pub(super) fn look(&self) -> (HostTime, u64) {
        let mut base = lock(&self.0);
        if base.now().abs_diff(unix_time()) > JUMP {
            *base = Base::read(base.generation + 1);
        }
        let microseconds = i64::try_from(base.now().as_micros()).unwrap_or(i64::MAX);
        (HostTime(microseconds), base.generation)
    }
}
