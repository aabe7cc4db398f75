//! Windows that stand far off the others are silenced before anything is averaged: one blow against a sensor must not outweigh
//! a day.
//!
//! Windows flow in; the same windows flow out, some of them without some channels, and a tally of what was taken out. The level
//! of a channel in a window is the median of `ln |X|²` over the lines of a band, which modal peaks hardly move and which a
//! spike, a step or a loose cable does. It is held against the median of the channel's own last windows, and what all channels
//! have in common (the load rises and falls) is taken off first.

use std::collections::VecDeque;

use num_complex::Complex32;

use super::grid::WindowLines;
use crate::statistics::{MEDIAN_OF_ABSOLUTE, median};

/// Windows that a level is held against; the first of them wait until there are [`LEAST_HISTORY`].
const HISTORY: usize = 64;
const LEAST_HISTORY: usize = 16;
/// Fewer windows than this in all say nothing about what is usual.
const LEAST_WINDOWS: usize = 6;
/// Bands that are looked at on their own, and lines that a band has at least.
const BANDS: usize = 6;
const LEAST_LINES: usize = 8;
/// A channel stands out where its power in a band is this many times what it usually is beside the others...
const FACTOR: f64 = 30.0;
/// ...all channels do where their power in common is this many times the usual: a storm is welcome, a blast is not...
const COMMON_FACTOR: f64 = 1000.0;
/// ...and where that is as many robust standard deviations away.
const DEVIATIONS: f64 = 8.0;
/// With fewer channels there is no telling what they have in common.
const COMMON_CHANNELS: usize = 3;

/// What was taken out of one channel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Silenced {
    /// In how many windows.
    pub windows: usize,
    /// The first of them, as [`WindowLines::grid_index`].
    pub first: u64,
    /// The last of them.
    pub last: u64,
}

/// Levels of one window: by channel (`None` where it is silent) and band, in ln of density.
type Levels = Vec<Option<Vec<f64>>>;

/// Holds windows against those before them.
#[derive(Debug)]
pub struct StandOut {
    /// Levels of the last windows, silenced ones included: where a level lasts, it is the usual one.
    history: VecDeque<Levels>,
    waiting: Vec<WindowLines>,
    silenced: Vec<Silenced>,
}

impl StandOut {
    /// For a setup of `channels` channels.
    pub fn new(channels: usize) -> Self {
        Self { history: VecDeque::new(), waiting: Vec::new(), silenced: vec![Silenced::default(); channels] }
    }

    /// Takes a window, and hands out those that have been judged, in order.
    pub fn push(&mut self, window: WindowLines, on_window: &mut dyn FnMut(WindowLines)) {
        self.history.push_back(levels(&window));
        if self.history.len() > HISTORY {
            self.history.pop_front();
        }
        self.waiting.push(window);
        if self.history.len() >= LEAST_HISTORY {
            self.release(on_window);
        }
    }

    /// Hands out the windows that still wait; what was taken out, channel by channel.
    pub fn finish(mut self, on_window: &mut dyn FnMut(WindowLines)) -> Vec<Silenced> {
        self.release(on_window);
        self.silenced
    }

    fn release(&mut self, on_window: &mut dyn FnMut(WindowLines)) {
        let usual = if self.waiting.is_empty() { None } else { Usual::of(&self.history, self.silenced.len()) };
        let first = self.history.len() - self.waiting.len();
        for (at, mut window) in self.waiting.drain(..).enumerate() {
            let standing_out = usual.as_ref().map(|usual| usual.standing_out(&self.history[first + at]));
            for channel in standing_out.unwrap_or_default() {
                if let Some(lines) = window.channels.get_mut(channel)
                    && lines.take().is_some()
                {
                    let silenced = &mut self.silenced[channel];
                    if silenced.windows == 0 {
                        silenced.first = window.grid_index;
                    }
                    (silenced.windows, silenced.last) = (silenced.windows + 1, window.grid_index);
                }
            }
            on_window(window);
        }
    }
}

fn levels(window: &WindowLines) -> Levels {
    window.channels.iter().map(|lines| lines.as_deref().map(band_levels)).collect()
}

fn band_levels(lines: &[Complex32]) -> Vec<f64> {
    let bands = (lines.len() / LEAST_LINES).clamp(1, BANDS);
    let width = lines.len().div_ceil(bands).max(1);
    lines
        .chunks(width)
        .map(|band| {
            let mut powers: Vec<f64> =
                band.iter().map(|line| f64::from(line.norm_sqr()).max(f64::MIN_POSITIVE)).collect();
            median(&mut powers).map_or(0.0, f64::ln)
        })
        .collect()
}

/// What is usual, and how far windows scatter about it.
struct Usual {
    /// Median level of each channel and band.
    levels: Vec<Option<Vec<f64>>>,
    /// Robust standard deviation of what a channel has of its own, channel by channel and band by band.
    own: Vec<Vec<f64>>,
    /// The same of what all have in common, band by band.
    common: Vec<f64>,
}

impl Usual {
    /// `None` of too few windows.
    fn of(history: &VecDeque<Levels>, channels: usize) -> Option<Self> {
        if history.len() < LEAST_WINDOWS {
            return None;
        }
        let bands = history.iter().flatten().flatten().map(Vec::len).next().unwrap_or(0);
        let series = |channel: usize, band: usize| -> Vec<f64> {
            history.iter().filter_map(|window| Some(window.get(channel)?.as_ref()?[band])).collect()
        };
        let levels = (0..channels).map(|channel| (0..bands).map(|band| median(&mut series(channel, band))).collect());
        let mut usual =
            Self { levels: levels.collect(), own: vec![vec![0.0; bands]; channels], common: vec![0.0; bands] };
        let apart: Vec<Apart> = history.iter().map(|window| usual.apart(window)).collect();
        for band in 0..bands {
            usual.common[band] = scatter(apart.iter().map(|apart| apart.common[band]));
            for channel in 0..channels {
                let own = apart.iter().filter_map(|apart| Some(apart.own[channel].as_ref()?[band]));
                usual.own[channel][band] = scatter(own);
            }
        }
        Some(usual)
    }

    /// How far a window is from what is usual.
    fn apart(&self, window: &Levels) -> Apart {
        let away: Vec<Option<Vec<f64>>> = window
            .iter()
            .zip(&self.levels)
            .map(|(here, usual)| {
                Some(here.as_ref()?.iter().zip(usual.as_ref()?).map(|(here, usual)| here - usual).collect())
            })
            .collect();
        let sound = away.iter().flatten().count();
        let common = (0..self.common.len())
            .map(|band| {
                let mut all: Vec<f64> = away.iter().flatten().map(|away| away[band]).collect();
                if sound >= COMMON_CHANNELS { median(&mut all).unwrap_or(0.0) } else { 0.0 }
            })
            .collect::<Vec<f64>>();
        let own =
            away.into_iter().map(|away| Some(away?.iter().zip(&common).map(|(away, common)| away - common).collect()));
        Apart { own: own.collect(), common }
    }

    /// The channels of a window that stand out.
    fn standing_out(&self, window: &Levels) -> Vec<usize> {
        let apart = self.apart(window);
        let is_far = |value: f64, scatter: f64, factor: f64| value.abs() > factor.ln().max(DEVIATIONS * scatter);
        let all =
            apart.common.iter().zip(&self.common).any(|(&common, &scatter)| is_far(common, scatter, COMMON_FACTOR));
        let stands_out = |channel: &usize| {
            let own = apart.own[*channel].iter().flatten().zip(&self.own[*channel]);
            all || own.into_iter().any(|(&own, &scatter)| is_far(own, scatter, FACTOR))
        };
        (0..window.len()).filter(stands_out).collect()
    }
}

/// A window's distance from what is usual, in ln of density.
struct Apart {
    own: Vec<Option<Vec<f64>>>,
    common: Vec<f64>,
}

/// Robust standard deviation about zero.
fn scatter(values: impl Iterator<Item = f64>) -> f64 {
    let mut magnitudes: Vec<f64> = values.map(f64::abs).collect();
    median(&mut magnitudes).unwrap_or(0.0) / MEDIAN_OF_ABSOLUTE
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise that all channels scale alike, from window to window, and each by itself a little.
    fn window(number: u64, channels: usize, factor: impl Fn(usize) -> f32) -> WindowLines {
        let load = 1.0 + 0.8 * (number as f32 * 0.7).sin();
        let lines = |channel: usize| -> Vec<Complex32> {
            (0..96_u64)
                .map(|line| {
                    let turn = ((number * 7919 + channel as u64 * 104_729 + line * 1_299_709) as f32 * 0.37).sin();
                    let size = load * factor(channel) * (1.0 + 0.5 * turn);
                    Complex32::from_polar(size, turn * 9.0)
                })
                .collect()
        };
        WindowLines { grid_index: number, channels: (0..channels).map(|channel| Some(lines(channel))).collect() }
    }

    /// Pushes windows through; in which of them each channel is silent, and the tally.
    fn through(windows: impl Iterator<Item = WindowLines>, channels: usize) -> (Vec<Vec<u64>>, Vec<Silenced>) {
        let mut silent = vec![Vec::new(); channels];
        let mut next = 0;
        let mut take = |window: WindowLines| {
            assert_eq!(window.grid_index, next, "in order, none lost");
            next += 1;
            for (channel, lines) in window.channels.iter().enumerate() {
                if lines.is_none() {
                    silent[channel].push(window.grid_index);
                }
            }
        };
        let mut stand_out = StandOut::new(channels);
        windows.for_each(|window| stand_out.push(window, &mut take));
        let tally = stand_out.finish(&mut take);
        (silent, tally)
    }

    #[test]
    fn a_channel_that_stands_out_is_silent_in_those_windows_and_no_other_is() {
        for bad in [3_u64, 40, 99] {
            let windows = (0..100).map(|number| {
                window(number, 5, |channel| if channel == 2 && number == bad { 50.0 } else { 1.0 + channel as f32 })
            });
            let (silent, tally) = through(windows, 5);
            assert_eq!(silent, [vec![], vec![], vec![bad], vec![], vec![]]);
            assert_eq!(tally[2], Silenced { windows: 1, first: bad, last: bad });
        }
    }

    #[test]
    fn a_load_that_rises_by_a_hundred_is_kept_and_a_blast_is_not() {
        let storm = (0..200).map(|number| window(number, 4, |_| if number > 100 { 10.0 } else { 1.0 }));
        assert!(through(storm, 4).0.iter().all(Vec::is_empty));
        let blast = (0..200).map(|number| window(number, 4, |_| if number == 100 { 300.0 } else { 1.0 }));
        assert!(through(blast, 4).0.iter().all(|silent| *silent == [100]));
    }

    #[test]
    fn what_lasts_becomes_usual() {
        let gain =
            (0..300).map(|number| window(number, 4, |channel| if channel == 1 && number >= 150 { 20.0 } else { 1.0 }));
        let (silent, _) = through(gain, 4);
        assert!(
            silent[1].first() == Some(&150) && silent[1].last().is_some_and(|last| *last < 150 + 64),
            "{:?}",
            silent[1]
        );
    }

    #[test]
    fn few_windows_and_single_channels_have_an_answer() {
        assert!(through((0..5).map(|number| window(number, 3, |_| 1.0)), 3).0.iter().all(Vec::is_empty));
        let alone = (0..50).map(|number| window(number, 1, |_| if number == 20 { 100.0 } else { 1.0 }));
        assert_eq!(through(alone, 1).0, [vec![20]]);
        assert!(through(std::iter::empty(), 2).1.iter().all(|silenced| silenced.windows == 0));
    }
}
