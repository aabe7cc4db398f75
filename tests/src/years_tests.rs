//! Days and years of a structure that weather moves, with and without a change.

use belfry_host::watch::{JudgedBefore, Remembered, Standing, State};
use serde_json::json;

use super::*;

/// Hours from the first of April on.
fn weather(seed: u64, days: usize, change: Option<(f64, f64)>) -> Weather {
    Weather::draw(&mut ChaCha8Rng::seed_from_u64(seed), 90.0, days, change)
}

fn intervals(seed: u64, days: usize, change: Option<(f64, f64)>) -> Vec<SeenInterval> {
    weather(seed, days, change).intervals
}

#[test]
fn a_year_without_and_one_with_a_loss_are_judged_right() {
    let report = watch_years(20_261_129, 1, 1.0, |_| {});
    assert!(report.is_right(), "{report}");
}

#[test]
fn weather_raises_no_alarm() {
    let judgement = judged(&intervals(1, 150, None));
    assert_eq!((judgement.standing, &judgement.alarms), (Standing::Unchanged, &Vec::new()));
    assert!(judgement.log_evidence.unwrap() < 0.0, "{:?}", judgement.log_evidence);
    // What is left of the weather is less than what was there.
    let spread = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
    for (cleaned, seen) in judgement.cleaned_percent.iter().zip(&judgement.seen_percent) {
        let seen: Vec<f64> = seen.iter().flatten().copied().collect();
        assert!(spread(cleaned) < 0.3 * spread(&seen), "{} of {}", spread(cleaned), spread(&seen));
    }
}

/// One per cent of all stiffness, of which each mode feels a share: found within a week, with its date and sizes.
#[test]
fn a_hundredth_of_the_stiffness_is_missed_within_a_week() {
    let Weather { intervals, shares } = weather(2, 120, Some((80.0, 0.01)));
    let judgement = judged(&intervals);
    let [alarm] = &judgement.alarms[..] else { panic!("{:?}", judgement.alarms) };
    assert!((80.0..87.0).contains(&(alarm.raised_s / DAY_S)), "{}", alarm.raised_s / DAY_S);
    assert!(alarm.between_s[0] <= 80.5 * DAY_S && alarm.between_s[1] >= 79.5 * DAY_S, "{:?}", alarm.between_s);
    assert_eq!(alarm.state, State::Lasting);
    let lost = |mode: usize| -0.5 * shares[mode];
    for (mode, shift) in alarm.modes.iter().enumerate() {
        assert!((shift.percent - lost(mode)).abs() < 4.0 * shift.std_percent, "{shift:?} where {}", lost(mode));
    }
}

/// Whoever asks every day gets the alarms of one who asks at the end.
#[test]
fn a_watch_that_goes_on_judges_as_one_that_saw_all() {
    let all = intervals(3, 110, Some((75.0, 0.01)));
    let (mut before, mut alarms) = (JudgedBefore::default(), Vec::new());
    for days in [30, 70, 77, 78, 82, 100, 110] {
        let blocks = blocks(&all[..24 * days], &NUMBERS);
        let with = |learned: Option<Remembered>| {
            judge(&blocks, &NUMBERS, &Settings::default(), JudgedBefore { learned, ..before.clone() })
        };
        let (judgement, anew) = (with(before.learned.clone()), with(None));
        // What is remembered changes little but the time that it takes: levels of vibration are about the mean of all days, and it was another mean.
        let standing = |alarms: &[Alarm]| alarms.iter().map(|one| (one.first_day_s, one.state)).collect::<Vec<_>>();
        assert_eq!(standing(&judgement.alarms), standing(&anew.alarms));
        assert!(
            (judgement.log_evidence.unwrap() - anew.log_evidence.unwrap()).abs()
                < 0.02 * anew.log_evidence.unwrap().abs().max(1.0)
        );
        if days == 78 {
            // It is used where days are the same, and then alone.
            let mut other = serde_json::to_value(&before.learned).unwrap();
            other["sizes"][0][0] = json!(other["sizes"][0][0].as_f64().unwrap() + 1.0);
            let changed = with(serde_json::from_value(other.clone()).unwrap()).log_evidence;
            assert!((changed.unwrap() - anew.log_evidence.unwrap()).abs() > 0.1);
            other["fingerprint"] = json!(1);
            assert_eq!(with(serde_json::from_value(other).unwrap()).log_evidence, anew.log_evidence);
        }
        alarms.clone_from(&judgement.alarms);
        let until_s = blocks.last().map(|block| block.time_s);
        before = JudgedBefore { until_s, alarms: judgement.alarms, learned: judgement.learned };
    }
    let at_once = judged(&all).alarms;
    assert_eq!((alarms.len(), at_once.len()), (1, 1));
    assert_eq!((alarms[0].first_day_s, alarms[0].state), (at_once[0].first_day_s, at_once[0].state));
}

#[test]
fn a_mode_that_no_day_shows_any_more_is_told() {
    let mut all = intervals(4, 60, None);
    for interval in all.iter_mut().filter(|interval| interval.start_s > 50.0 * DAY_S) {
        interval.modes.retain(|mode| mode.number != 2);
    }
    assert_eq!(judged(&all).lost_modes, [2]);
}

/// Frost, and the days that it takes to leave the ground, are not judged.
#[test]
fn days_of_frost_are_left_out() {
    let winter = intervals(5, 300, None);
    let judgement = judged(&winter);
    assert!(judgement.frost_days > 20, "{}", judgement.frost_days);
    assert!(judgement.alarms.is_empty(), "{:?}", judgement.alarms);
    let of_all = Settings { frost_below_degc: None, ..Settings::default() };
    assert_eq!(
        judge(
            &blocks(&winter[..1200], &NUMBERS),
            &NUMBERS,
            &of_all,
            JudgedBefore { until_s: Some(0.0), ..JudgedBefore::default() }
        )
        .frost_days,
        0
    );
}

#[test]
fn few_days_say_nothing() {
    // Of June, which has no frost.
    let judgement = judged(&Weather::draw(&mut ChaCha8Rng::seed_from_u64(6), 150.0, 10, None).intervals);
    assert_eq!((judgement.standing, judgement.missing_days), (Standing::Learning, 14));
    assert_eq!(judged(&[]).standing, Standing::Learning);
    // Numbers that are none are left out.
    let mut broken = intervals(7, 40, None);
    broken[100].modes[0].frequency_hz = f64::NAN;
    broken[101].modes[1].frequency_std_hz = 0.0;
    broken[102].modes[2].response_rms = f64::INFINITY;
    assert_eq!(judged(&broken).standing, Standing::Unchanged);
}
