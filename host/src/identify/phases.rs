//! Channels whose phases the modes contradict: a quarter of a period off in all modes, or late.
//!
//! Modes and the setups' sensors flow in; a sentence for each suspicion flows out. The points of a lightly damped mode move in phase or
//! against phase. A velocity that is read as an acceleration is a quarter of a period off in every mode; a channel that is late is off
//! by a share that grows with the frequency. Only modes count whose other channels are in phase, so that a close pair, whose parts are
//! mixed, accuses nobody.

use std::f64::consts::{FRAC_PI_2, PI};

use num_complex::Complex64;

use super::result::Mode;
use super::setup::{MeasuredSetup, each_once, of_setup};
use super::shape::phase_collinearity;
use super::ssi::component_of;
use crate::study::{Sensor, Setup};

/// A component counts where it is this share of the mode's largest, and its phase is known within so many radians.
const LARGE: f64 = 0.03;
const KNOWN_RAD: f64 = 0.2;
/// A channel is suspected where its phase is so far off in half of the modes, and at most this share of the channels may be.
const OFF_RAD: f64 = 0.3;
const MOST: f64 = 0.34;
/// A mode counts where the channels that are not suspected are so collinear.
const COLLINEAR: f64 = 0.95;
/// So many modes at least, with a suspected channel within so many radians of what its fault makes, in root mean square.
const LEAST_MODES: usize = 3;
const NEAR_RAD: f64 = 0.2;
/// The highest mode's frequency over the lowest, at least, to tell a delay.
const APART: f64 = 1.5;
/// Delays that are looked for, in s, in steps that turn the highest mode by so many radians: up to half a period of the highest mode for
/// each mode that a delay and its check leave, and no more than the next number of periods, or chance finds one.
const LONGEST_S: f64 = 2.0;
const STEP_RAD: f64 = 0.02;
const MOST_PERIODS: f64 = 2.0;
/// Channels that are late by the same, within this share, are named together.
const SAME: f64 = 0.1;

/// What may be wrong with a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    /// A quarter of a period off in all modes.
    Quantity,
    /// Late by so many seconds; early where negative.
    Late(f64),
}

/// A channel: its name, and its components in the modes, where they count.
struct Channel {
    name: String,
    values: Vec<Option<Complex64>>,
}

/// Says which channels are recorded as another quantity than study.toml says, or late.
pub(crate) fn phase_suspicions(modes: &[Mode], measured: &[MeasuredSetup<'_>]) -> Vec<String> {
    let sensors = measured.iter().flat_map(|m| m.setup.sensors.iter().map(|sensor| (m.setup, sensor)));
    let channel = |(setup, sensor): (&Setup, &Sensor)| Channel {
        name: format!("\"{}\"{}", sensor.channel, of_setup(&setup.name, measured.len() > 1)),
        values: modes.iter().map(|mode| counted(mode, &setup.name, sensor)).collect(),
    };
    let channels: Vec<Channel> = each_once(sensors).map(channel).collect();
    let frequencies_hz: Vec<f64> = modes.iter().map(|mode| mode.frequency_hz).collect();
    sentences(&channels, &suspected(&frequencies_hz, &channels))
}

/// A sensor's component in a mode, where it is large and its phase is known.
fn counted(mode: &Mode, setup: &str, sensor: &Sensor) -> Option<Complex64> {
    let component = component_of(&mode.shape, setup, sensor)?;
    let largest = mode.shape.iter().map(|part| part.value().norm()).fold(0.0, f64::max);
    let size = component.value().norm();
    (size > LARGE * largest && component.std < KNOWN_RAD * size).then(|| component.value())
}

/// The channels that are off, by their number, and how.
fn suspected(frequencies_hz: &[f64], channels: &[Channel]) -> Vec<(usize, Fault)> {
    let phases: Vec<Vec<Option<f64>>> = (0..frequencies_hz.len()).map(|mode| phases(channels, mode)).collect();
    let is_off = |channel: usize| {
        let known: Vec<f64> = phases.iter().filter_map(|mode| mode[channel]).collect();
        let off = known.iter().filter(|phase| phase.abs() > OFF_RAD).count();
        off > 0 && 2 * off >= known.len()
    };
    let off: Vec<usize> = (0..channels.len()).filter(|&channel| is_off(channel)).collect();
    if off.len() as f64 > MOST * channels.len() as f64 {
        return Vec::new();
    }
    let is_sound = |mode: usize| {
        let others = channels.iter().enumerate().filter(|(channel, _)| !off.contains(channel));
        let others: Vec<Complex64> = others.filter_map(|(_, channel)| channel.values[mode]).collect();
        others.len() > 1 && phase_collinearity(&others) > COLLINEAR
    };
    let sound: Vec<usize> = (0..frequencies_hz.len()).filter(|&mode| is_sound(mode)).collect();
    let fault = |&channel: &usize| {
        let known = sound.iter().filter_map(|&mode| Some((frequencies_hz[mode], phases[mode][channel]?)));
        Some((channel, fault_of(&known.collect::<Vec<_>>())?))
    };
    off.iter().filter_map(fault).collect()
}

/// What is wrong with a channel of these phases, each at its frequency.
fn fault_of(known: &[(f64, f64)]) -> Option<Fault> {
    if known.len() < LEAST_MODES {
        return None;
    }
    let misfit = |phase: &dyn Fn(f64) -> f64| {
        let square = |(frequency_hz, seen): &(f64, f64)| wrapped(seen - phase(*frequency_hz)).powi(2);
        (known.iter().map(square).sum::<f64>() / known.len() as f64).sqrt()
    };
    if misfit(&|_| FRAC_PI_2) < NEAR_RAD {
        return Some(Fault::Quantity);
    }
    let lowest_hz = known.iter().map(|(frequency_hz, _)| *frequency_hz).fold(f64::INFINITY, f64::min);
    let highest_hz = known.iter().map(|(frequency_hz, _)| *frequency_hz).fold(0.0, f64::max);
    if highest_hz < APART * lowest_hz {
        return None;
    }
    let turn = std::f64::consts::TAU;
    let longest_s = LONGEST_S.min(MOST_PERIODS.min(0.5 * (known.len() - 2) as f64) / highest_hz);
    let steps = (turn * highest_hz * longest_s / STEP_RAD) as i32;
    let delays = (-steps..=steps).map(|step| f64::from(step) * STEP_RAD / (turn * highest_hz));
    let of = |delay_s: f64| (misfit(&move |frequency_hz| -turn * frequency_hz * delay_s), delay_s);
    let (left, delay_s) = delays.map(of).min_by(|a, b| a.0.total_cmp(&b.0))?;
    (left < NEAR_RAD).then_some(Fault::Late(delay_s))
}

/// The channels' phases in a mode, within a quarter of a turn, against the line that most of the motion lies on: that of the channel from
/// which the others, by their size, are the least off. A mean would lean towards those that are wrong.
fn phases(channels: &[Channel], mode: usize) -> Vec<Option<f64>> {
    let values = || channels.iter().filter_map(|channel| channel.values[mode]);
    let off = |axis: f64| values().map(|value| value.norm() * (value.arg() - axis).sin().abs()).sum::<f64>();
    let axes = values().map(|value| value.arg());
    let Some(axis) = axes.min_by(|a, b| off(*a).total_cmp(&off(*b))) else { return vec![None; channels.len()] };
    channels.iter().map(|channel| Some(wrapped(channel.values[mode]?.arg() - axis))).collect()
}

/// An angle without half turns, which are only a sign.
fn wrapped(angle: f64) -> f64 {
    angle - PI * (angle / PI).round()
}

fn sentences(channels: &[Channel], found: &[(usize, Fault)]) -> Vec<String> {
    let mut groups: Vec<(Fault, Vec<&str>)> = Vec::new();
    for &(channel, fault) in found {
        let is_same = |other: &Fault| match (fault, *other) {
            (Fault::Late(one), Fault::Late(other)) => (one - other).abs() < SAME * one.abs(),
            (one, other) => one == other,
        };
        match groups.iter_mut().find(|(other, _)| is_same(other)) {
            Some((_, names)) => names.push(&channels[channel].name),
            None => groups.push((fault, vec![&channels[channel].name])),
        }
    }
    let sentence = |(fault, names): (Fault, Vec<&str>)| {
        let (noun, seem, are) = if names.len() == 1 { ("channel", "seems", "is") } else { ("channels", "seem", "are") };
        let names = names.join(", ");
        match fault {
            Fault::Quantity => format!(
                "{noun} {names} {seem} to be recorded as another quantity than the others: a quarter of a period off in all modes, as a velocity is among accelerations. Give the unit of such a sensor in study.toml, as unit = \"m/s\""
            ),
            Fault::Late(delay_s) => format!(
                "{noun} {names} {are} about {:.2} s {}: the phase off the other channels grows with the frequency. Check the clocks and the recorder's filters, and shift the samples in the file",
                delay_s.abs(),
                if delay_s > 0.0 { "late" } else { "early" }
            ),
        }
    };
    groups.into_iter().map(sentence).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FREQUENCIES_HZ: [f64; 5] = [0.31, 0.36, 0.95, 1.13, 1.9];

    /// Five modes of twelve channels, changed by `change`, which gets channel and frequency.
    fn found(change: impl Fn(usize, f64) -> Complex64) -> Vec<(usize, Fault)> {
        let value = |channel: usize, mode: usize| {
            let size = (1.3 * (channel + 1) as f64 * (mode + 1) as f64).sin();
            let value =
                size * change(channel, FREQUENCIES_HZ[mode]) * Complex64::cis(0.03 * ((channel * 7 + mode) % 5) as f64);
            (value.norm() > LARGE).then_some(value)
        };
        let channel = |channel: usize| Channel {
            name: channel.to_string(),
            values: (0..FREQUENCIES_HZ.len()).map(|mode| value(channel, mode)).collect(),
        };
        suspected(&FREQUENCIES_HZ, &(0..12).map(channel).collect::<Vec<_>>())
    }

    const SOUND: Complex64 = Complex64::new(1.0, 0.0);

    #[test]
    fn a_velocity_among_accelerations_is_found() {
        assert_eq!(found(|_, _| SOUND), []);
        let three = found(|channel, _| if [2, 3, 10].contains(&channel) { -Complex64::I } else { SOUND });
        assert_eq!(three, [(2, Fault::Quantity), (3, Fault::Quantity), (10, Fault::Quantity)]);
        // Where half are of one kind, nobody knows which are wrong.
        assert_eq!(found(|channel, _| if channel < 6 { Complex64::I } else { SOUND }), []);
    }

    #[test]
    fn a_late_channel_is_found_with_its_delay() {
        for delay_s in [0.2, -0.3, 0.6] {
            let late = |frequency_hz: f64| Complex64::cis(-std::f64::consts::TAU * frequency_hz * delay_s);
            let one = found(|channel, frequency_hz| if channel == 4 { late(frequency_hz) } else { SOUND });
            assert!(
                matches!(one.as_slice(), [(4, Fault::Late(found_s))] if (found_s - delay_s).abs() < 0.05),
                "{delay_s}: {one:?}"
            );
        }
        assert_eq!(fault_of(&[(0.3, 0.6), (0.9, -1.2), (1.1, 0.4), (1.9, 1.5)]), None);
    }

    #[test]
    fn a_close_pair_accuses_nobody() {
        // Two modes of mixed parts, the others sound.
        let mixed = found(
            |channel, frequency_hz| {
                if frequency_hz < 0.5 { Complex64::cis(0.5 * channel as f64) } else { SOUND }
            },
        );
        assert_eq!(mixed, []);
    }
}
