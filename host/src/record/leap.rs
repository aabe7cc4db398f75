//! Leap seconds: times of the calendar, counted from 1970 as if every day had 86 400 s, stand still where one was put in.

/// Days from 1970 that a leap second went before: IERS Bulletin C 52 and those before it. None has followed that of 2016.
const DAYS: [i64; 27] = [
    912, 1096, 1461, 1826, 2191, 2557, 2922, 3287, 3652, 4199, 4564, 4929, 5660, 6574, 7305, 7670, 8217, 8582, 8947,
    9496, 10043, 10592, 13149, 14245, 15522, 16617, 17167,
];
const SECOND_NS: i64 = 1_000_000_000;
const DAY_NS: i64 = 86_400 * SECOND_NS;

/// What the leap seconds between two times since 1970 took, in nanoseconds.
pub(super) fn between_ns(from_ns: i64, to_ns: i64) -> i64 {
    DAYS.iter().filter(|day| from_ns < **day * DAY_NS && **day * DAY_NS <= to_ns).count() as i64 * SECOND_NS
}

/// Whether a time may be within a leap second itself, which is counted as the first second of the day after it.
pub(super) fn may_be_within(ns: i64) -> bool {
    DAYS.iter().any(|day| (0..SECOND_NS).contains(&ns.saturating_sub(day * DAY_NS)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_calendar_has_them_where_the_earth_was_late() {
        // 2016-12-31T23:59:59Z and 2017-01-01T00:00:00Z.
        let [before, after] = [1_483_228_799 * SECOND_NS, 1_483_228_800 * SECOND_NS];
        assert_eq!(between_ns(before, after), SECOND_NS);
        assert_eq!(between_ns(after, after + DAY_NS), 0);
        assert_eq!(between_ns(0, after), 27 * SECOND_NS);
        assert!(may_be_within(after) && !may_be_within(before) && !may_be_within(after + SECOND_NS));
    }
}
