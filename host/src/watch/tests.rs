//! A year of a structure that weather moves, with and without a change. The year is made by other laws than those that the judgement
//! assumes: sections that follow the air by themselves, ice that grows smoothly, traffic by the hour.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::*;

const MODES: usize = 4;
const NUMBERS: [usize; MODES] = [1, 2, 3, 4];
const DAY_S: f64 = 86_400.0;

/// Intervals of three hours from the first of April on; from a day on each mode is lower by a half of its share of `loss`.
fn intervals(seed: u64, days: usize, change: Option<(f64, f64)>) -> Vec<SeenInterval> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut draw =
        |range: std::ops::Range<f64>| -> Vec<f64> { (0..MODES).map(|_| random.random_range(range.clone())).collect() };
    let (per_kelvin, ice_share) = (draw(-6e-4..-2e-4), draw(0.01..0.06));
    let (traffic, share, noise) = (draw(0.0..4e-3), draw(0.3..1.0), draw(2e-4..5e-4));
    let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
    let (mut weather, mut section, mut ice) = (0.0, 6.0, 0.0_f64);
    let seen = |hour: usize| {
        let day = hour as f64 / 24.0;
        weather += -weather / 24.0 + 4.0 * (2.0_f64 / 24.0).sqrt() * normal();
        let turn = std::f64::consts::TAU;
        let air = 9.0 - 10.0 * (turn * (day + 90.0) / 365.25).cos() + weather + 4.0 * (turn * (day - 0.4)).sin();
        section += (air - section) / 20.0;
        ice += (0.5 * (1.0 - ((section + 2.0) / 2.0).tanh()) - ice) / 13.0;
        let is_busy = (day as usize) % 7 < 5 && (6..20).contains(&(hour % 24));
        let level = if is_busy { 0.3 } else { -0.2 } + 0.15 * normal();
        let mode = |mode: usize| {
            let lost = change.map_or(0.0, |(from, loss)| if day >= from { 0.5 * loss * share[mode] } else { 0.0 });
            let moved =
                per_kelvin[mode] * (0.6 * section + 0.4 * air) + ice_share[mode] * ice - traffic[mode] * level - lost;
            let frequency_hz = (mode + 1) as f64 * (moved + noise[mode] * normal()).exp();
            let response_rms = 10f64.powf(level);
            SeenMode { number: mode + 1, frequency_hz, frequency_std_hz: noise[mode] * frequency_hz, response_rms }
        };
        let modes = (0..MODES).map(mode).collect();
        let start_s = day * DAY_S;
        SeenInterval { start_s, end_s: start_s + 3.0 * 3600.0, temperature_degc: Some(air), modes }
    };
    (0..days * 24).step_by(3).map(seen).collect()
}

fn judged(intervals: &[SeenInterval]) -> Judgement {
    judge(&blocks(intervals, &NUMBERS), &NUMBERS, &Settings::default(), Vec::new(), f64::NEG_INFINITY)
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
    let all = intervals(2, 120, Some((80.0, 0.01)));
    let judgement = judged(&all);
    let [alarm] = &judgement.alarms[..] else { panic!("{:?}", judgement.alarms) };
    assert!((80.0..87.0).contains(&(alarm.raised_s / DAY_S)), "{}", alarm.raised_s / DAY_S);
    assert!(alarm.between_s[0] <= 80.5 * DAY_S && alarm.between_s[1] >= 79.5 * DAY_S, "{:?}", alarm.between_s);
    assert_eq!(alarm.state, State::Lasting);
    // The shares are those of the generator: without noise, the same year with and without the loss.
    let lost = |mode: usize| {
        let [with, without] = [Some((80.0, 0.01)), None].map(|change| intervals(2, 120, change));
        100.0 * (with[700].modes[mode].frequency_hz / without[700].modes[mode].frequency_hz).ln()
    };
    for (mode, shift) in alarm.modes.iter().enumerate() {
        assert!((shift.percent - lost(mode)).abs() < 4.0 * shift.std_percent, "{shift:?} where {}", lost(mode));
    }
}

/// Whoever asks every day gets the alarms of one who asks at the end.
#[test]
fn a_watch_that_goes_on_judges_as_one_that_saw_all() {
    let all = intervals(3, 110, Some((75.0, 0.01)));
    let (mut alarms, mut until_s) = (Vec::new(), f64::NEG_INFINITY);
    for days in [30, 70, 77, 78, 82, 100, 110] {
        let blocks = blocks(&all[..8 * days], &NUMBERS);
        let judgement = judge(&blocks, &NUMBERS, &Settings::default(), alarms, until_s);
        (alarms, until_s) = (judgement.alarms, blocks.last().unwrap().time_s);
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
    assert_eq!(judge(&blocks(&winter[..400], &NUMBERS), &NUMBERS, &of_all, Vec::new(), 0.0).frost_days, 0);
}

#[test]
fn few_days_say_nothing() {
    let judgement = judged(&intervals(6, 10, None));
    assert_eq!((judgement.standing, judgement.missing_days), (Standing::Learning, 14));
    assert_eq!(judged(&[]).standing, Standing::Learning);
    // Numbers that are none are left out.
    let mut broken = intervals(7, 40, None);
    broken[100].modes[0].frequency_hz = f64::NAN;
    broken[101].modes[1].frequency_std_hz = 0.0;
    broken[102].modes[2].response_rms = f64::INFINITY;
    assert_eq!(judged(&broken).standing, Standing::Unchanged);
}
