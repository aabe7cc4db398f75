//! A range of time reads what lies in it.

use std::time::Duration;

use super::*;

/// Ten windows of both nodes, one every 5.12 s from 1970-01-01T14:13:20 on.
fn bench() -> Bench {
    let (mut bench, two, one) = Bench::of_both();
    for number in 0..10 {
        bench.store(&two, &sent(&two, 1, number, 10_000 + u64::from(number)));
        bench.store(&one, &sent(&one, 2, number, 10_000 + u64::from(number)));
    }
    bench
}

#[test]
fn windows_whose_middle_is_in_the_range_are_read() {
    let bench = bench();
    let all = read(bench.folder.path(), &TimeRange::ALL).unwrap().unwrap();
    let of = |range: TimeRange| {
        let (setup, windows, damages) = read(bench.folder.path(), &range).unwrap().unwrap();
        assert_eq!((setup.windows, damages), (windows.len(), Vec::new()));
        let first = setup.first_grid_index - all.0.first_grid_index;
        // They are the same as without a range.
        for window in &windows {
            assert_eq!(window.channels, all.1[(first + window.grid_index) as usize].channels);
        }
        (first, windows.len())
    };
    let middle = |number: i64| (10_000 + number) * 5_120_000 + 5_120_000;
    assert_eq!(of(TimeRange { from_us: Some(middle(3)), ..TimeRange::ALL }), (3, 7));
    assert_eq!(of(TimeRange { from_us: Some(middle(3) + 1), to_us: Some(middle(6)), last: None }), (4, 2));
    // The last window ends a hop after its middle.
    assert_eq!(of(TimeRange { last: Some(Duration::from_secs_f64(5.12 * 3.0)), ..TimeRange::ALL }), (7, 3));
}

#[test]
fn a_range_without_windows_says_where_they_are() {
    let bench = bench();
    let range = TimeRange { from_us: parse_moment("2026-11-02").ok(), ..TimeRange::ALL };
    let error = read(bench.folder.path(), &range).unwrap_err().to_string();
    assert_eq!(
        error,
        "it has no window from 2026-11-02T00:00:00Z; its windows begin from 1970-01-01T14:13:20Z to 1970-01-01T14:14:06Z"
    );
}
