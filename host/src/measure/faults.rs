//! What was wrong with a setup's channels, and when, in sentences.

use std::collections::BTreeMap;

use super::epoch_s;
use super::fill::Filled;
use super::flat::Flat;
use super::jumps::Jumps;
use super::limits::{CutOff, MOST_CUT_OFF};
use super::spikes::Spikes;
use super::stream::Faults;
use crate::spectra::{LineGrid, Silenced, SpectraWarning};
use crate::study::{Sensor, Setup};

/// Which channels stood far off what is usual, and when: a line for all that did so in the same windows.
pub(super) fn silenced_sentences(setup: &Setup, grid: &LineGrid, silenced: &[Silenced]) -> Vec<String> {
    let hop_s = 0.5 * grid.segment as f64 / grid.sampling_rate_hz;
    let at = |window: u64| time_of_day(epoch_s(setup, grid) + window as f64 * hop_s);
    let when = |silenced: &Silenced| (silenced.first, silenced.last, silenced.windows);
    let alike = channels_by(setup, silenced.iter().map(|one| (one.windows > 0).then(|| when(one))));
    let sentence = |((first, last, windows), channels): ((u64, u64, usize), Vec<String>)| {
        let (noun, verb) = if channels.len() == 1 { ("channel", "stands") } else { ("channels", "stand") };
        let when = if windows == 1 {
            format!("in one window, {} into the record", at(first))
        } else {
            format!("in {windows} windows, from {} to {} into the record", at(first), at(last + 2))
        };
        format!(
            "{noun} {} {verb} far off what is usual {when}: left out there; look for spikes, steps, blows or a loose cable",
            channels.join(", ")
        )
    };
    alike.into_iter().map(sentence).collect()
}

/// The names of channels, in quotes, that have the same in common; those with nothing are left out.
fn channels_by<K: Ord>(setup: &Setup, what: impl Iterator<Item = Option<K>>) -> BTreeMap<K, Vec<String>> {
    let mut alike: BTreeMap<K, Vec<String>> = BTreeMap::new();
    for (sensor, what) in setup.sensors.iter().zip(what) {
        if let Some(what) = what {
            alike.entry(what).or_default().push(format!("\"{}\"", sensor.channel));
        }
    }
    alike
}

/// What was found in the rows. Channels in `left_out` are cut off so often that they are.
pub(super) fn fault_sentences(setup: &Setup, faults: &Faults, left_out: &[usize]) -> Vec<String> {
    let mut sentences = spike_sentences(setup, &faults.spikes);
    sentences.extend(filled_sentences(setup, &faults.filled));
    sentences.extend(flat_sentences(setup, &faults.flat, faults.rows));
    let cut_off = setup.sensors.iter().zip(&faults.cut_off).enumerate().filter(|(_, (_, cut))| cut.samples > 0);
    sentences.extend(
        cut_off.map(|(channel, (sensor, cut))| cut_off_sentence(setup, sensor, cut, left_out.contains(&channel))),
    );
    sentences.extend(jump_sentence(setup, &faults.jumps));
    sentences
}

fn cut_off_sentence(setup: &Setup, sensor: &Sensor, cut: &CutOff, is_left_out: bool) -> String {
    let what = match is_left_out {
        true => ", and is left out",
        false if cut.share > MOST_CUT_OFF => {
            ", and is used all the same, as most channels are like it: trust neither damping nor shapes"
        }
        false => "",
    };
    format!(
        "channel \"{}\" is cut off at {:.3e} (as recorded) in {} samples ({:.2} %), the first {} into the record{what}: the sensor or the recorder reaches the end of its range; set a wider range",
        sensor.channel,
        cut.limit,
        cut.samples,
        100.0 * cut.share,
        time_of_day(cut.first_row as f64 / setup.sampling_rate_hz)
    )
}

/// Which channels had missing samples that were filled: a line for all that had the same.
fn filled_sentences(setup: &Setup, filled: &[Filled]) -> Vec<String> {
    let alike = channels_by(setup, filled.iter().map(|one| (one.count > 0).then_some(*one)));
    let sentence = |(filled, channels): (Filled, Vec<String>)| {
        let at = time_of_day(filled.first_row as f64 / setup.sampling_rate_hz);
        let who = match channels.len() {
            all if all == setup.sensors.len() => "all channels".to_owned(),
            1 => format!("channel {}", channels[0]),
            _ => format!("channels {}", channels.join(", ")),
        };
        format!(
            "{who}: {} missing samples in short gaps, the first {at} into the record, are filled by straight lines",
            filled.count
        )
    };
    alike.into_iter().map(sentence).collect()
}

/// Which channels hold one value at times: a line for all that do so in the same pieces.
fn flat_sentences(setup: &Setup, flat: &[Flat], rows: u64) -> Vec<String> {
    let alike = channels_by(setup, flat.iter().map(|one| (one.pieces > 0).then_some(*one)));
    let sentence = |(flat, channels): (Flat, Vec<String>)| {
        let at = time_of_day(flat.first_row as f64 / setup.sampling_rate_hz);
        let (noun, verb) = if channels.len() == 1 { ("channel", "holds") } else { ("channels", "hold") };
        let (pieces, which) = match flat.pieces {
            1 => ("1 piece".to_owned(), "which begins"),
            pieces => (format!("{pieces} pieces"), "the first"),
        };
        format!(
            "{noun} {} {verb} one value in {pieces}, {:.1} % of the time, {which} {at} into the record: these samples are taken as missing; check the sensor, its cable and the recorder",
            channels.join(", "),
            100.0 * flat.samples as f64 / rows.max(1) as f64
        )
    };
    alike.into_iter().map(sentence).collect()
}

/// Where all channels jump. Not where study.toml says so: at the joints of blocks.
fn jump_sentence(setup: &Setup, jumps: &Jumps) -> Option<String> {
    let at = time_of_day(jumps.first_row as f64 / setup.sampling_rate_hz);
    if let Some(every) = jumps.every {
        let every_s = every as f64 / setup.sampling_rate_hz;
        if setup.block_s.is_some_and(|block_s| is_whole(every_s / block_s)) {
            return None;
        }
        let every_s = if is_whole(every_s) { every_s.round().to_string() } else { format!("{every_s:.2}") };
        return Some(format!(
            "all channels jump at once every {every_s} s, at {} places that were found, the first {at} into the record: blocks are joined that do not continue one another. If the recorder pauses between them, give block_s = {every_s} in [[setup]], and no segment reaches over a joint; if rows are lost there, put empty cells in their place",
            jumps.places
        ));
    }
    (jumps.places > 0).then(|| {
        format!(
            "all channels jump at once at {} places, the first {at} into the record; more may be hidden. Rows may be missing, parts may be joined, or blows strike the structure. If 1 % of the rows are missing, frequencies come out 1 % too high and damping too large: put empty cells in their place, or give the file a column of times",
            jumps.places
        )
    })
}

/// Whether a number is a whole one, as well as places of jumps are known.
fn is_whole(value: f64) -> bool {
    value.round() >= 1.0 && (value / value.round() - 1.0).abs() < 2e-3
}

/// Which channels had spikes, how many, and the first.
fn spike_sentences(setup: &Setup, spikes: &[Spikes]) -> Vec<String> {
    let with_spikes = setup.sensors.iter().zip(spikes).filter(|(_, spikes)| spikes.count > 0);
    let sentence = |(sensor, spikes): (&Sensor, &Spikes)| {
        let at = time_of_day(spikes.first_row as f64 / setup.sampling_rate_hz);
        let (noun, which) = if spikes.count == 1 { ("spike", "") } else { ("spikes", ", the first") };
        format!(
            "channel \"{}\": {} {noun} of a single sample{which} {at} into the record, replaced by the mean of the samples beside; check the cable",
            sensor.channel, spikes.count
        )
    };
    with_spikes.map(sentence).collect()
}

/// Hours, minutes and seconds.
fn time_of_day(seconds: f64) -> String {
    let seconds = seconds.round() as u64;
    format!("{}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60)
}

/// A channel that has nothing in common with the others.
pub(super) fn noisy_sentence(setup: &Setup, channel: usize) -> String {
    format!(
        "channel \"{}\" is left out: it is loud, and has nothing in common with the other channels; check the sensor and its cable",
        name(setup, channel)
    )
}

/// Channels that have nothing in common with the others, and are not loud.
pub(super) fn alone_sentence(setup: &Setup, channels: &[usize]) -> Option<String> {
    let names: Vec<String> = channels.iter().map(|channel| format!("\"{}\"", name(setup, *channel))).collect();
    let (noun, have, whose) = match names.len() {
        0 => return None,
        1 => ("channel", "has", "is its sensor connected? What it shows of the modes is"),
        _ => ("channels", "have", "are their sensors connected? What they show of the modes is"),
    };
    Some(format!(
        "{noun} {} {have} nothing in common with the others: {whose} noise, unless the structure does not move there",
        names.join(", ")
    ))
}

/// The name of a channel, by its index in the setup's order.
fn name(setup: &Setup, channel: usize) -> &str {
    setup.sensors.get(channel).map_or("?", |sensor| sensor.channel.as_str())
}

/// What was left out, with the channel's name.
pub(super) fn left_out_sentence(setup: &Setup, warning: SpectraWarning) -> String {
    match warning {
        SpectraWarning::ChannelLeftOut { channel, sound, windows } => format!(
            "channel \"{}\" is left out: it is sound in {sound} of {windows} windows; check the sensor and its cable",
            name(setup, channel)
        ),
        SpectraWarning::WindowsLeftOut { left_out, windows } => format!(
            "{left_out} of {windows} windows are left out: a channel has gaps, clipped or constant samples in them, or stands far off what is usual"
        ),
    }
}
