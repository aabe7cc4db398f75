//! Times of day as loggers write them: `2026-03-01 12:00:00.05`, in UTC or in a time that is not moved for summer.

use super::traces::unix_ns;

/// Days before each month of a year without a leap day.
const DAYS_BEFORE: [i64; 12] = [0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334];

/// Seconds since 1970; `None` of what is no such time.
pub(super) fn seconds(text: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(text).ok()?.trim();
    let (date, time) = text.split_once([' ', 'T'])?;
    let mut parts = date.splitn(3, '-').map(|part| part.parse::<i64>().ok());
    let [year, month, day] = [parts.next()??, parts.next()??, parts.next()??];
    let mut parts = time.splitn(3, ':');
    let [hours, minutes] = [parts.next()?.parse::<i64>().ok()?, parts.next()?.parse::<i64>().ok()?];
    let (seconds, fraction) = parts.next().map_or(("0", ""), |part| part.split_once('.').unwrap_or((part, "")));
    let is_fraction = fraction.len() <= 9 && fraction.bytes().all(|byte| byte.is_ascii_digit());
    let ns = if is_fraction { format!("{fraction:0<9}").parse::<i64>().ok()? } else { return None };
    let is_leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
    let before = DAYS_BEFORE.get(usize::try_from(month.checked_sub(1)?).ok()?)?;
    let of_year = before + day + i64::from(is_leap && month > 2);
    let is_day = (1..=31).contains(&day);
    let ns = unix_ns(year, of_year, [hours, minutes, seconds.parse().ok()?], ns).filter(|_| is_day)?;
    Some(ns as f64 * 1e-9)
}

#[cfg(test)]
mod tests {
    use super::seconds;

    #[test]
    fn times_of_day_are_those_of_the_calendar() {
        // Python: datetime(2024, 3, 1, 12, 30, 15, 250000, tzinfo=timezone.utc).timestamp(), and others.
        for (text, expected) in [
            ("2024-03-01 12:30:15.25", 1_709_296_215.25),
            ("2024-02-29T23:59:59", 1_709_251_199.0),
            ("2023-12-31 23:59:59.999", 1_704_067_199.999),
            ("1970-01-01 00:01", 60.0),
        ] {
            let found = seconds(text.as_bytes()).unwrap();
            assert!((found - expected).abs() < 1e-6, "{text}: {found}");
        }
        for text in [
            "",
            "12:00:00",
            "2024-13-01 00:00:00",
            "2024-01-32 00:00:00",
            "2024-01-01 25:00:00",
            "2024-01-01 00:00:00.x",
        ] {
            assert_eq!(seconds(text.as_bytes()), None, "{text}");
        }
    }
}
