//! Ranges of time: which part of what nodes have sent is meant.

use std::fmt;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// A range of time among collected windows. A window is in it when its middle is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct TimeRange {
    /// Its begin, in µs of Unix time; from the first window on where there is none.
    pub from_us: Option<i64>,
    /// Its end, which is not in it; up to the last window where there is none.
    pub to_us: Option<i64>,
    /// Its length, counted back from its end.
    pub last: Option<Duration>,
}

impl TimeRange {
    /// Everything.
    pub const ALL: Self = Self { from_us: None, to_us: None, last: None };

    /// Whether it is everything.
    pub fn is_all(&self) -> bool {
        *self == Self::ALL
    }

    /// The µs of Unix time from and up to which middles of windows are in it, where the last window ends at `last_end_us`.
    pub(super) fn middles(&self, last_end_us: i64) -> [i64; 2] {
        let end_us = self.to_us.unwrap_or(last_end_us);
        let back = |last: Duration| end_us.saturating_sub(i64::try_from(last.as_micros()).unwrap_or(i64::MAX));
        let from_us = self.from_us.into_iter().chain(self.last.map(back)).max();
        [from_us.unwrap_or(i64::MIN), self.to_us.unwrap_or(i64::MAX)]
    }
}

impl fmt::Display for TimeRange {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut parts = Vec::new();
        parts.extend(self.from_us.map(|from_us| format!("from {}", moment(from_us))));
        parts.extend(self.to_us.map(|to_us| format!("up to {}", moment(to_us))));
        parts.extend(self.last.map(|last| format!("in the last {}", in_words(last))));
        formatter.write_str(&parts.join(" "))
    }
}

/// A length of time, such as "7 days 12 h".
fn in_words(length: Duration) -> String {
    let seconds = length.as_secs_f64();
    let (days, rest) = ((seconds / 86_400.0).floor(), seconds % 86_400.0);
    let (hours, rest) = ((rest / 3600.0).floor(), rest % 3600.0);
    let (minutes, rest) = ((rest / 60.0).floor(), rest % 60.0);
    let day = if days == 1.0 { "day" } else { "days" };
    let parts = [(days, day), (hours, "h"), (minutes, "min"), (rest, "s")];
    let parts = parts.iter().filter(|(count, _)| *count > 0.0).map(|(count, unit)| format!("{count} {unit}"));
    parts.collect::<Vec<_>>().join(" ")
}

/// A moment in words, in UTC, to the second.
pub(crate) fn moment(us: i64) -> String {
    // Beyond the year 9999 there is no such form.
    let since_epoch = Duration::from_micros(u64::try_from(us).unwrap_or(0)).min(Duration::from_secs(253_402_300_799));
    humantime::format_rfc3339_seconds(UNIX_EPOCH + since_epoch).to_string()
}

/// The day of a moment in UTC, such as `2027-01-15`.
pub(crate) fn day(us: i64) -> String {
    let mut day = moment(us);
    day.truncate("2027-01-15".len());
    day
}

/// The time now, in s of Unix time; a clock that stands before 1970 counts from there.
pub(crate) fn now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}

/// Reads a moment in UTC: `2026-11-02`, `2026-11-02 12:30` or `2026-11-02T12:30:00Z`.
///
/// # Errors
/// A sentence that says what was expected.
pub fn parse_moment(text: &str) -> Result<i64, String> {
    let text = text.trim();
    let full = match text.len() {
        10 => format!("{text}T00:00:00Z"),
        16 => format!("{text}:00Z"),
        _ => text.to_owned(),
    };
    let expected = || format!("expected a time in UTC such as 2026-11-02 or 2026-11-02T12:30, not \"{text}\"");
    let time = humantime::parse_rfc3339_weak(&full).map_err(|_| expected())?;
    let since_epoch = time.duration_since(UNIX_EPOCH).map_err(|_| expected())?;
    i64::try_from(since_epoch.as_micros()).map_err(|_| expected())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_read_to_the_day_the_minute_or_the_second() {
        for text in
            ["2026-11-02", "2026-11-02 00:00", "2026-11-02T00:00", "2026-11-02 00:00:00", "2026-11-02T00:00:00Z"]
        {
            assert_eq!(parse_moment(text).map(moment), Ok("2026-11-02T00:00:00Z".to_owned()), "{text}");
        }
        for text in ["", "yesterday", "2026-13-01", "1930-01-01", "2026-11-02T25:00", "ü026-11-02"] {
            assert!(parse_moment(text).is_err_and(|said| said.contains("2026-11-02T12:30")), "{text}");
        }
    }

    #[test]
    fn what_is_counted_back_is_counted_from_the_end_that_is_named_or_that_of_the_last_window() {
        let last = Some(Duration::from_secs(3600));
        let of = |range: TimeRange| range.middles(10_000_000_000);
        assert_eq!(of(TimeRange::ALL), [i64::MIN, i64::MAX]);
        assert_eq!(of(TimeRange { from_us: Some(1000), to_us: Some(5000), last: None }), [1000, 5000]);
        assert_eq!(of(TimeRange { last, ..TimeRange::ALL }), [6_400_000_000, i64::MAX]);
        let named = TimeRange { to_us: Some(3_600_000_500), last, from_us: None };
        assert_eq!(
            (of(named), named.to_string()),
            ([500, 3_600_000_500], "up to 1970-01-01T01:00:00Z in the last 1 h".to_owned())
        );
        assert_eq!(of(TimeRange { from_us: Some(7000), ..named }), [7000, 3_600_000_500]);
        for (seconds, words) in [(604_800, "7 days"), (86_461, "1 day 1 min 1 s"), (2_678_400 + 43_200, "31 days 12 h")]
        {
            assert_eq!(in_words(Duration::from_secs(seconds)), words);
        }
    }
}
