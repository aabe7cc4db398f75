//! How far feeding has come: a bar on a terminal, a line now and then elsewhere.

use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use indicatif::ProgressBar;

use crate::command::Console;

/// Time between lines.
const LINE: Duration = Duration::from_secs(30);

/// Progress of all ports together.
pub(super) struct FeedingProgress {
    bar: ProgressBar,
    console: Console,
    total_rows: u64,
    start: Instant,
    /// Rows that were fed, and when that was said last.
    fed: Mutex<(u64, Instant)>,
}

impl FeedingProgress {
    pub(super) fn new(total_rows: u64, console: &Console) -> Self {
        let start = Instant::now();
        let bar = console.progress(total_rows, "feeding samples");
        Self { bar, console: *console, total_rows, start, fed: Mutex::new((0, start)) }
    }

    /// Counts rows that a node has taken.
    pub(super) fn add(&self, rows: u64) {
        self.bar.inc(rows);
        let mut fed = self.fed.lock().unwrap_or_else(PoisonError::into_inner);
        fed.0 += rows;
        if self.bar.is_hidden() && fed.1.elapsed() >= LINE {
            fed.1 = Instant::now();
            self.console.report(line(fed.0, self.total_rows, self.start.elapsed()));
        }
    }

    /// Takes the bar off the screen.
    pub(super) fn end(&self) {
        self.bar.finish_and_clear();
    }
}

/// How far it has come after some time, and how long the rest takes at that rate.
fn line(rows: u64, total_rows: u64, elapsed: Duration) -> String {
    let share = rows as f64 / total_rows.max(1) as f64;
    let whole_seconds = |time: Duration| humantime::format_duration(Duration::from_secs(time.as_secs()));
    let left = elapsed.mul_f64((1.0 / share.max(1e-6) - 1.0).max(0.0));
    format!(
        "{rows} of {total_rows} samples fed, {:.0} %, in {}; about {} left",
        100.0 * share,
        whole_seconds(elapsed),
        whole_seconds(left)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_says_how_far_it_has_come_and_how_long_the_rest_takes() {
        let said = line(50_000, 200_000, Duration::from_secs(90));
        assert_eq!(said, "50000 of 200000 samples fed, 25 %, in 1m 30s; about 4m 30s left");
    }
}
