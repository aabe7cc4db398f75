//! What goes wrong with sensors and recorders.

use rand::{Rng, RngExt};

use super::machine::Machine;
use super::structure::{Structure, channel_name};

/// A fault of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// One sample of one channel is off by 9.81 m/s².
    Spike,
    /// One in a hundred samples of one channel is off by ten times its root mean square.
    Spikes,
    /// One channel jumps by 9.81 m/s² once.
    Step,
    /// One channel has added noise of ten times its root mean square.
    Noise,
    /// One in a hundred rows is missing, and nothing says so.
    MissingRows,
    /// One channel is cut at one and a half times its root mean square.
    Clipped,
    /// One channel holds its value for a tenth of the record.
    Stuck,
    /// One channel has no reading for two seconds, again and again, in all for a hundredth of the record.
    Gaps,
    /// One channel reads 30 % more at the end of the record than at its beginning.
    GainDrifts,
    /// Channel 10 is reversed, and channels 14 and 17 are exchanged.
    Miswired,
    /// The structure stands still: there is nothing but noise, of another size in each channel.
    StandsStill,
    /// A machine shakes it.
    Machine(Machine),
}

const G: f64 = 9.81;
/// How long a gap is.
const GAP_S: f64 = 2.0;

/// What a warning must hold to report a fault, or a part of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Sign {
    /// The names of all these channels; none where the fault is in all channels at once.
    channels: Vec<String>,
    /// And one of these words, in lower case: that a channel is named for another reason does not count.
    words: &'static [&'static str],
}

impl Sign {
    fn new(channels: &[usize], words: &'static [&'static str]) -> Self {
        Self { channels: channels.iter().map(|&channel| channel_name(channel)).collect(), words }
    }

    fn is_in(&self, warning: &str) -> bool {
        let lower = warning.to_lowercase();
        self.words.iter().any(|word| lower.contains(word)) && self.channels.iter().all(|name| names(warning, name))
    }
}

/// Whether warnings report a fault: each of its signs is in one of them.
pub(super) fn is_reported(signs: &[Sign], warnings: &[&str]) -> bool {
    signs.iter().all(|sign| warnings.iter().any(|warning| sign.is_in(warning)))
}

/// Whether a warning names a channel: `channel "07"`, `2 of 20 channels ("03", "07")`, `channel 07`, `channels 03 and 07`. Times and
/// percentages are no names.
fn names(warning: &str, channel: &str) -> bool {
    let words: Vec<&str> = warning.split_whitespace().collect();
    let before = |at: usize, by: usize| at.checked_sub(by).map_or("", |at| words[at]);
    words.iter().enumerate().any(|(at, word)| {
        let follows_channel = matches!(before(at, 1), "channel" | "channels");
        let is_second = before(at, 1) == "and" && before(at, 3) == "channels";
        word.trim_matches(|letter: char| !letter.is_alphanumeric()) == channel
            && (word.contains('"') || follows_channel || is_second)
    })
}

impl Fault {
    /// Damages samples of a structure, row by row; what warnings have to say of it flows out.
    pub(super) fn damage(
        self,
        samples: &mut Vec<f32>,
        structure: &Structure,
        rate_hz: f64,
        random: &mut impl Rng,
    ) -> Vec<Sign> {
        let channels = structure.places.len();
        let rows = samples.len() / channels;
        let channel = random.random_range(0..channels);
        let sum: f64 = samples.iter().skip(channel).step_by(channels).map(|value| f64::from(*value).powi(2)).sum();
        let rms = (sum / rows as f64).sqrt();
        let at = random.random_range(rows / 4..3 * rows / 4);
        let own = |samples: &mut Vec<f32>, change: &mut dyn FnMut(usize, &mut f32)| {
            for (row, value) in samples.iter_mut().skip(channel).step_by(channels).enumerate() {
                change(row, value);
            }
        };
        match self {
            Self::Spike => samples[at * channels + channel] += G as f32,
            Self::Step => own(samples, &mut |row, value| *value += if row >= at { G as f32 } else { 0.0 }),
            Self::Spikes => own(samples, &mut |_, value| {
                if random.random_bool(0.01) {
                    *value += (10.0 * rms) as f32;
                }
            }),
            Self::Noise => own(samples, &mut |_, value| {
                let noise: f64 = rand_distr::Distribution::sample(&rand_distr::StandardNormal, random);
                *value += (10.0 * rms * noise) as f32;
            }),
            Self::Clipped => own(samples, &mut |_, value| *value = value.clamp(-1.5 * rms as f32, 1.5 * rms as f32)),
            Self::Stuck => {
                let held = samples[at * channels + channel];
                own(samples, &mut |row, value| {
                    if (at..at + rows / 10).contains(&row) {
                        *value = held;
                    }
                });
            }
            Self::Gaps => {
                let long = (GAP_S * rate_hz) as usize;
                let gaps: Vec<usize> = (0..rows / long / 100).map(|_| random.random_range(0..rows)).collect();
                for row in gaps.into_iter().flat_map(|gap| gap..(gap + long).min(rows)) {
                    samples[row * channels + channel] = f32::NAN;
                }
            }
            Self::GainDrifts => own(samples, &mut |row, value| *value *= 1.0 + 0.3 * row as f32 / rows as f32),
            Self::StandsStill => {
                let sizes: Vec<f64> = (0..channels).map(|_| random.random_range(0.3..3.0) * rms).collect();
                for row in samples.chunks_mut(channels) {
                    for (value, size) in row.iter_mut().zip(&sizes) {
                        let noise: f64 = rand_distr::Distribution::sample(&rand_distr::StandardNormal, random);
                        *value = (size * noise) as f32;
                    }
                }
            }
            Self::Miswired => {
                for row in samples.chunks_mut(channels) {
                    row[9] = -row[9];
                    row.swap(13, 16);
                }
            }
            Self::Machine(machine) => machine.shake(samples, structure, rate_hz, random),
            Self::MissingRows => {
                let kept: Vec<bool> = (0..rows).map(|_| !random.random_bool(0.01)).collect();
                let mut row = 0;
                samples.retain(|_| {
                    row += 1;
                    kept[(row - 1) / channels]
                });
            }
        }
        self.signs(channel)
    }

    /// The signs of a fault that hit a channel, where it hits one. A machine is no fault of the recording and is told as a tone; where
    /// nothing moves, there is nothing to report.
    pub(super) fn signs(self, channel: usize) -> Vec<Sign> {
        match self {
            Self::Spike | Self::Spikes => vec![Sign::new(&[channel], &["spike"])],
            Self::Step => vec![Sign::new(&[channel], &["step", "jump"])],
            Self::Noise => vec![Sign::new(&[channel], &["loud", "noise"])],
            Self::Clipped => vec![Sign::new(&[channel], &["cut off", "clipped"])],
            Self::Stuck => vec![Sign::new(&[channel], &["holds one value"])],
            Self::Gaps => vec![Sign::new(&[channel], &["gaps"])],
            Self::GainDrifts => vec![Sign::new(&[channel], &["gain rises"])],
            Self::MissingRows => vec![Sign::new(&[], &["rows may be missing", "jump at once"])],
            Self::Miswired => vec![Sign::new(&[9], &["reversed"]), Sign::new(&[13, 16], &["exchanged"])],
            Self::StandsStill | Self::Machine(_) => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_must_name_the_channel_and_the_fault() {
        let is_reported = |fault: Fault, warning: &str| is_reported(&fault.signs(12), &[warning]);
        let spike = "setup \"s\": channel \"13\": 1 spike of a single sample 0:12:24 into the record";
        assert!(is_reported(Fault::Spike, spike));
        assert!(!is_reported(Fault::Noise, spike), "the right channel, another fault");
        assert!(!is_reported(Fault::Spike, &spike.replace("\"13\"", "\"07\"")), "another channel");
        assert!(is_reported(Fault::Noise, "2 of 20 channels (\"07\", \"13\") are left out: they are loud"));
        let numbers = "channel \"07\" is cut off in 13 samples (13 %), the first 0:13 into the record";
        assert!(!is_reported(Fault::Clipped, numbers), "13 is no channel there");
        assert!(!is_reported(Fault::Clipped, "a channel has gaps, clipped or constant samples"), "no channel is named");
        assert!(is_reported(Fault::MissingRows, "all channels jump at once at 36 places. Rows may be missing"));
    }

    #[test]
    fn miswiring_is_reported_where_all_three_channels_are() {
        let signs = Fault::Miswired.signs(0);
        let (reversed, exchanged) = ("channel 10 seems to be reversed", "channels 14 and 17 seem to be exchanged");
        assert!(is_reported(&signs, &[exchanged, reversed]));
        assert!(!is_reported(&signs, &[reversed]));
        assert!(!is_reported(&signs, &[reversed, "channels 14 and 16 seem to be exchanged"]));
        assert!(!is_reported(&signs, &[exchanged, "channel 17 seems to be reversed"]));
    }
}
