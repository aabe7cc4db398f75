//! Tones, as of machines: where they are, and the lines that they take from modes.
//!
//! A tone's line flows in; its frequency, and the lines in which it is, flow out. A mode beside it is fitted to the others.

use std::f64::consts::PI;

use super::pick::Pick;
use super::result::{Harmonic, OnInPart, SingularSpectrum};
use super::setup::MeasuredSetup;
use crate::spectra::{CrossSpectrum, ENVELOPE_HALF, LineGrid, around};

/// Lines to either side that are a tone's whatever its size: the Hann window's main lobe.
pub(super) const LOBE_LINES: f64 = 2.0;
/// Of a line's power, how much may be a tone's where modes are fitted.
const LEAST_SHARE: f64 = 0.03;
/// Lines to either side that a tone takes at most.
const MOST_LINES: usize = 40;

/// A tone: its strongest line, and the lines to either side over which its frequency wanders.
pub(super) type Tone = (usize, usize);

/// A forced line's tone among other lines.
pub(super) fn of(line: &Harmonic, grid: &LineGrid) -> Tone {
    let half = if line.on_share < 1.0 { ENVELOPE_HALF } else { (line.wanders_hz / grid.spacing_hz()).round() as usize };
    (grid.nearest_line(line.frequency_hz), half)
}

/// The lines that tones are in, in order.
pub(super) fn lines(spectrum: &CrossSpectrum, tones: &[Tone]) -> Vec<usize> {
    let power = |line: usize| spectrum.power(line);
    let mut taken: Vec<usize> = tones.iter().flat_map(|&tone| taken_by(tone, spectrum.grid().lines, power)).collect();
    taken.sort_unstable();
    taken.dedup();
    taken
}

/// The lines that a tone is in.
fn taken_by((line, wanders): Tone, lines: usize, power: impl Fn(usize) -> f64) -> Vec<usize> {
    let at = |line: usize| if line < lines { power(line) } else { 0.0 };
    let offset = if wanders == 0 { offset(at(line), at(line.wrapping_sub(1)), at(line + 1)) } else { 0.0 };
    let whole = at(line) / leak(offset);
    let is_taken = |other: &usize| {
        let distance = ((*other as f64 - line as f64 - offset).abs() - wanders as f64).max(0.0);
        distance < LOBE_LINES || whole * leak(distance) > LEAST_SHARE * at(*other)
    };
    let reach = MOST_LINES + wanders;
    around(line, reach, lines).filter(is_taken).collect()
}

/// What is told of a pick that is a forced line.
pub(super) fn harmonic(measured: &[MeasuredSetup<'_>], grid: &LineGrid, pick: &Pick, frequency_hz: f64) -> Harmonic {
    Harmonic {
        frequency_hz,
        kurtosis: pick.kurtosis.value,
        wanders_hz: pick.kurtosis.frequency_lines() as f64 * grid.spacing_hz(),
        on_share: pick.kurtosis.on_share,
        on_by_part: on_by_part(measured, pick),
    }
}

/// The share of the time that a tone is there, part by part of each setup: what its power there is of that
/// while it is on. None of a tone that is always there.
fn on_by_part(measured: &[MeasuredSetup<'_>], pick: &Pick) -> Vec<OnInPart> {
    let mut all = Vec::new();
    if !pick.kurtosis.is_at_times() {
        return all;
    }
    for (m, shape) in measured.iter().zip(&pick.shapes) {
        let grid = m.spectrum.grid();
        let band = around(pick.line, pick.kurtosis.wanders_lines, grid.lines);
        let parts = m.spectrum.power_by_group(band, shape.icamax());
        let windows: usize = parts.iter().map(|(windows, _)| windows).sum();
        let mean = parts.iter().map(|(windows, power)| *windows as f64 * power).sum::<f64>() / windows as f64;
        // Each setup was measured at another time.
        let [_, of_setup] = m.spectrum.envelope(pick.line, shape.icamax());
        // Windows overlap by half.
        let window_s = 0.5 / grid.spacing_hz();
        let mut from_s = 0.0;
        for (windows, power) in parts {
            let to_s = from_s + windows as f64 * window_s;
            let on_share = (of_setup * power / mean).min(1.0);
            all.push(OnInPart { setup: m.setup.name.clone(), from_s, to_s, on_share });
            from_s = to_s;
        }
    }
    all
}

/// Leaves of the picks of one wandering tone the one that shows it best.
pub(super) fn one_each(tones: &mut Vec<Pick>) {
    tones.sort_by(|a, b| b.kurtosis.sigmas_below.total_cmp(&a.kurtosis.sigmas_below));
    let mut kept: Vec<Pick> = Vec::new();
    for tone in tones.drain(..) {
        let is_same =
            |other: &Pick| other.line.abs_diff(tone.line) <= other.kurtosis.wanders_lines + tone.kurtosis.wanders_lines;
        if !kept.iter().any(is_same) {
            kept.push(tone);
        }
    }
    kept.sort_by_key(|tone| tone.line);
    *tones = kept;
}

/// The power that the Hann window lets through of a tone `distance` lines away, at most.
fn leak(distance: f64) -> f64 {
    let amplitude = if distance < LOBE_LINES - 0.5 {
        let x = PI * distance;
        let sinc = if x.abs() < 1e-6 { 1.0 } else { x.sin() / x };
        // At one line the zero of the sine meets that of the denominator.
        if (1.0 - distance * distance).abs() < 1e-6 { 0.5 } else { sinc / (1.0 - distance * distance) }
    } else {
        1.0 / (PI * distance * (distance * distance - 1.0))
    };
    amplitude * amplitude
}

/// How many lines a tone is from its strongest line, from the powers there and on both sides: the Hann window gives the magnitudes
/// of the two strongest the ratio r = (1 + d)/(2 - d) for a tone d lines from the strongest towards the other (Rife & Vincent
/// 1970).
fn offset(here: f64, left: f64, right: f64) -> f64 {
    let (stronger, side) = if left > right { (left, -1.0) } else { (right, 1.0) };
    let ratio = (stronger / here.max(f64::MIN_POSITIVE)).sqrt();
    side * ((2.0 * ratio - 1.0) / (1.0 + ratio)).clamp(0.0, 0.5)
}

/// A tone's frequency: of a steady one from the magnitudes of its strongest lines, pooled over the setups, of one that wanders
/// the centre of its power.
pub(super) fn frequency_hz(grid: &LineGrid, singular: &[SingularSpectrum], (line, wanders): Tone) -> f64 {
    let power = |line: usize| {
        let values = singular.iter().filter_map(|setup| setup.values.first()?.get(line));
        let (count, sum) =
            values.fold((0, 0.0), |(count, sum), value| (count + 1, sum + value.max(f64::MIN_POSITIVE).ln()));
        // Nothing is known of a line beyond the band.
        if count == 0 { 0.0 } else { (sum / f64::from(count)).exp() }
    };
    if wanders > 0 {
        let band = around(line, wanders, grid.lines);
        let (sum, moment) = band.fold((0.0, 0.0), |(sum, moment), line| {
            (sum + power(line), moment + power(line) * grid.frequency_hz(line))
        });
        return if sum > 0.0 { moment / sum } else { grid.frequency_hz(line) };
    }
    grid.frequency_hz(line) + offset(power(line), power(line.saturating_sub(1)), power(line + 1)) * grid.spacing_hz()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The power of a tone of unit power between lines, exactly.
    fn tone(at: f64) -> impl Fn(usize) -> f64 {
        move |line: usize| {
            let x = line as f64 - at;
            let value = if x.abs() < 1e-9 {
                1.0
            } else if (x.abs() - 1.0).abs() < 1e-9 {
                0.5
            } else {
                (PI * x).sin() / (PI * x * (1.0 - x * x))
            };
            value * value
        }
    }

    #[test]
    fn a_weak_tone_takes_its_lobe_and_a_strong_one_what_it_leaks_into() {
        for at in [50.0, 50.3, 49.6] {
            let with = |size: f64| {
                let tone = tone(at);
                taken_by((50, 0), 100, move |line| 1.0 + size * tone(line))
            };
            let weak = with(30.0);
            assert!((3..=5).contains(&weak.len()) && weak.contains(&50), "{at}: {weak:?}");
            let strong = with(1e6);
            let tone = tone(at);
            assert!(strong.len() < 30 && (0..100).all(|line| strong.contains(&line) || 1e6 * tone(line) < 0.04));
        }
        let wandering = taken_by((50, 4), 100, |line| if line.abs_diff(50) <= 4 { 30.0 } else { 1.0 });
        assert!((11..=13).contains(&wandering.len()), "{wandering:?}");
        // At the band's end.
        assert!(taken_by((0, 0), 100, tone(0.2)).contains(&0));
    }

    #[test]
    fn where_nothing_is_known_of_the_spectrum_a_tone_is_at_its_line() {
        let grid = LineGrid { sampling_rate_hz: 5.0, segment: 256, first_line: 5, lines: 70 };
        let tone_hz = |values: Vec<Vec<f64>>, wanders: usize| {
            let spectrum = SingularSpectrum { setup: "wind".to_owned(), frequency_hz: Vec::new(), values };
            frequency_hz(&grid, &[spectrum], (40, wanders)) - grid.frequency_hz(40)
        };
        assert_eq!([tone_hz(Vec::new(), 0), tone_hz(Vec::new(), 3)], [0.0; 2]);
        // Three lines of the band's end: the tone is above the middle one.
        let tone = tone(40.3);
        let values: Vec<f64> = (0..42).map(|line| 1e-9 + tone(line)).collect();
        assert!((tone_hz(vec![values], 0) / grid.spacing_hz() - 0.3).abs() < 1e-3);
    }

    #[test]
    fn the_offset_is_that_of_the_two_strongest_lines() {
        for at in [50.0, 50.3, 49.6, 50.49] {
            let power = tone(at);
            let line = at.round() as usize;
            let found = offset(power(line), power(line - 1), power(line + 1));
            assert!((line as f64 + found - at).abs() < 1e-9, "{at} {found}");
        }
    }
}
