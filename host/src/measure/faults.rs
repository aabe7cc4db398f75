//! What was wrong with a setup's channels, and when, in sentences.

use std::collections::BTreeMap;

use super::epoch_s;
use super::fill::Filled;
use super::flat::Flat;
use super::jumps::Jumps;
use super::limits::{CutOff, MOST_CUT_OFF};
use super::spikes::Spikes;
use super::stream::Faults;
use crate::identify::Drift;
use crate::numbers::{counted, is_or_are};
use crate::record::{Affected, RecordWarning, time_of_day};
use crate::spectra::{LineGrid, Silenced, SpectraWarning};
use crate::study::{Sensor, Setup};

/// Which channels stood far off what is usual, and when: a line for all that did so in the same windows.
pub(super) fn silenced_sentences(setup: &Setup, grid: &LineGrid, silenced: &[Silenced]) -> Vec<String> {
    let hop_s = 0.5 * grid.segment as f64 / grid.sampling_rate_hz;
    let at = |window: u64| time_of_day(epoch_s(setup, grid) + window as f64 * hop_s);
    let when = |silenced: &Silenced| (silenced.first, silenced.last, silenced.windows);
    let alike = channels_by(setup, silenced.iter().map(|one| (one.windows > 0).then(|| when(one))));
    let sentence = |((first, last, windows), channels): ((u64, u64, usize), Affected)| {
        let when = if windows == 1 {
            format!("in one window, {} into the record", at(first))
        } else {
            format!("in {windows} windows, from {} to {} into the record", at(first), at(last + 2))
        };
        format!(
            "{channels} {} far off what is usual {when}: left out there; look for spikes, steps, blows or a loose cable",
            channels.verb("stands", "stand")
        )
    };
    alike.into_iter().map(sentence).collect()
}

/// Channels that have the same in common, in its order; those with nothing are left out.
fn channels_by<K: Ord>(setup: &Setup, what: impl Iterator<Item = Option<K>>) -> Vec<(K, Affected)> {
    let names = setup.sensors.iter().map(|sensor| sensor.channel.as_str());
    let mut alike = Affected::alike(names.zip(what));
    alike.sort_by(|(a, _), (b, _)| a.cmp(b));
    alike
}

/// Channels by their indices in the setup's order.
fn channels_at(setup: &Setup, indices: &[usize]) -> Affected {
    let name = |index: &usize| setup.sensors.get(*index).map_or("?", |sensor| sensor.channel.as_str());
    Affected::new(indices.iter().map(name), setup.sensors.len())
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

/// What the recording's reader has to say, but of gaps that were filled.
pub(super) fn reader_sentences(setup: &Setup, warnings: &[RecordWarning], filled: &[Filled]) -> Vec<String> {
    let is_filled = |name: &String, samples: u64| {
        let channel = setup.sensors.iter().position(|sensor| sensor.channel == *name);
        channel.and_then(|channel| filled.get(channel)).is_some_and(|filled| filled.count == samples)
    };
    let is_told = |warning: &&RecordWarning| match warning {
        RecordWarning::MissingSamples { channels, samples, .. } => {
            !channels.names().iter().all(|name| is_filled(name, *samples))
        }
        _ => true,
    };
    warnings.iter().filter(is_told).map(ToString::to_string).collect()
}

/// Which channels had missing samples that were filled: a line for all that had the same.
fn filled_sentences(setup: &Setup, filled: &[Filled]) -> Vec<String> {
    let alike = channels_by(setup, filled.iter().map(|one| (one.count > 0).then_some(*one)));
    let sentence = |(filled, channels): (Filled, Affected)| {
        let at = time_of_day(filled.first_row as f64 / setup.sampling_rate_hz);
        let gaps = if filled.count == 1 { "," } else { " in short gaps, the first" };
        let (samples, are) = (counted(filled.count, "missing sample"), is_or_are(filled.count));
        format!("{channels}: {samples}{gaps} {at} into the record, {are} filled by straight lines")
    };
    alike.into_iter().map(sentence).collect()
}

/// Channels that are copies, a line each.
pub(super) fn copy_sentences(setup: &Setup, copies: &[[usize; 2]]) -> Vec<String> {
    let sentence = |&[copy, of]: &[usize; 2]| {
        let [copy, of] = [copy, of].map(|channel| channels_at(setup, &[channel]));
        format!(
            "{copy} has the same samples as {of} in every row, and is left out: two sensors never have; is one recorded twice, under the other's name?"
        )
    };
    copies.iter().map(sentence).collect()
}

/// Channels whose gain drifts, a line each.
pub(super) fn drift_sentences(setup: &Setup, drifts: &[Drift]) -> Vec<String> {
    let sentence = |drift: &Drift| {
        let change = format!("{:.0} %", 100.0 * drift.change.abs());
        let told = match drift.channels.as_slice() {
            [_] if drift.change > 0.0 => {
                format!("its gain rises by {change} over the record, as the other channels tell")
            }
            [_] => format!("its gain falls by {change} over the record, as the other channels tell"),
            _ => format!(
                "the gain of one of them drifts by {change} over the record, as the other channels tell, but not of which"
            ),
        };
        let channels = channels_at(setup, &drift.channels);
        format!(
            "{channels}: {told}; it stays, and its components of shapes are means, with half of the change as a deviation: check the sensor, its supply and its mounting"
        )
    };
    drifts.iter().map(sentence).collect()
}

/// Which channels hold one value at times: a line for all that do so in the same pieces.
fn flat_sentences(setup: &Setup, flat: &[Flat], rows: u64) -> Vec<String> {
    let alike = channels_by(setup, flat.iter().map(|one| (one.pieces > 0).then_some(*one)));
    let sentence = |(flat, channels): (Flat, Affected)| {
        let at = time_of_day(flat.first_row as f64 / setup.sampling_rate_hz);
        let which = if flat.pieces == 1 { "which begins" } else { "the first" };
        let pieces = counted(flat.pieces, "piece");
        format!(
            "{channels} {} one value in {pieces}, {:.1} % of the time, {which} {at} into the record: these samples are taken as missing; check {} and the recorder",
            channels.verb("holds", "hold"),
            100.0 * flat.samples as f64 / rows.max(1) as f64,
            channels.verb("the sensor, its cable", "the sensors, their cables")
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
            "all channels jump at once at {} places, the first {at} into the record; more may be hidden. Rows may be missing, parts may be joined, a machine may go on or off, or blows strike the structure. If single rows are missing here and there, 1 % of all, frequencies come out 1 % too high and damping too large: put empty cells in their place, or give the file a column of times in seconds, named time_s",
            jumps.places
        )
    })
}

/// Whether a number is a whole one, as well as places of jumps are known.
fn is_whole(value: f64) -> bool {
    value.round() >= 1.0 && (value / value.round() - 1.0).abs() < 2e-3
}

/// Which channels had spikes, how many, and the first: a line for all that had them at once.
fn spike_sentences(setup: &Setup, spikes: &[Spikes]) -> Vec<String> {
    let when = |spikes: &Spikes| (spikes.first_row, spikes.count);
    let alike = channels_by(setup, spikes.iter().map(|one| (one.count > 0).then(|| when(one))));
    let sentence = |((first_row, count), channels): ((u64, u64), Affected)| {
        let at = time_of_day(first_row as f64 / setup.sampling_rate_hz);
        let which = if count == 1 { "" } else { ", the first" };
        let spikes = counted(count, "spike");
        format!(
            "{channels}: {spikes} of a single sample{which} {at} into the record, replaced by the mean of the samples beside; check {}",
            channels.verb("the cable", "the cables and the recorder")
        )
    };
    alike.into_iter().map(sentence).collect()
}

/// Channels that are loud and have nothing in common with the others.
pub(super) fn noisy_sentence(setup: &Setup, channels: &[usize]) -> Option<String> {
    let channels = (!channels.is_empty()).then(|| channels_at(setup, channels))?;
    Some(format!(
        "{channels} {} left out: {} loud, and {} nothing in common with the other channels; check {}",
        channels.verb("is", "are"),
        channels.verb("it is", "they are"),
        channels.verb("has", "have"),
        channels.verb("the sensor and its cable", "the sensors and their cables")
    ))
}

/// Channels that have nothing in common with the others, and are not loud.
pub(super) fn alone_sentence(setup: &Setup, channels: &[usize]) -> Option<String> {
    let channels = (!channels.is_empty()).then(|| channels_at(setup, channels))?;
    Some(format!(
        "{channels} {} nothing in common with the others: {} of the modes is noise, unless the structure does not move there",
        channels.verb("has", "have"),
        channels.verb("is its sensor connected? What it shows", "are their sensors connected? What they show")
    ))
}

/// What was left out, with the channels' names: a line for all that are sound in as many windows.
pub(super) fn left_out_sentences(setup: &Setup, warnings: &[SpectraWarning]) -> Vec<String> {
    let mut left_out: BTreeMap<(usize, usize), Vec<usize>> = BTreeMap::new();
    let mut sentences = Vec::new();
    for warning in warnings {
        match *warning {
            SpectraWarning::ChannelLeftOut { channel, sound, windows } => {
                left_out.entry((sound, windows)).or_default().push(channel);
            }
            SpectraWarning::WindowsLeftOut { left_out, windows } => {
                let joints = if setup.block_s.is_some() { "they reach over a joint of blocks, or " } else { "" };
                let are = is_or_are(left_out as u64);
                sentences.push(format!(
                    "{left_out} of {windows} windows {are} left out: {joints}a channel has gaps, clipped or constant samples in them, or stands far off what is usual"
                ));
            }
        }
    }
    let of_channels = left_out.into_iter().map(|((sound, windows), channels)| {
        let channels = channels_at(setup, &channels);
        format!(
            "{channels} {} left out: {} sound in {sound} of {windows} windows; check {}",
            channels.verb("is", "are"),
            channels.verb("it is", "they are"),
            channels.verb("the sensor and its cable", "the sensors and their cables")
        )
    });
    of_channels.chain(sentences).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{At, FilePosition};
    use crate::study::Study;

    fn setup() -> Setup {
        let sensor = |name: &str| {
            format!("[[setup.sensor]]\nchannel = \"{name}\"\nnode = 1\nelevation_m = 1.0\nazimuth_deg = 0.0\n")
        };
        let sensors: String = ["a", "b", "c"].into_iter().map(sensor).collect();
        let text = format!(
            "[structure]\nname = \"T\"\n[[setup]]\nname = \"s\"\nfiles = [\"a.csv\"]\nsampling_rate_hz = 50.0\nunit = \"g\"\n{sensors}"
        );
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("study.toml"), text).unwrap();
        Study::load(folder.path()).unwrap().setups.remove(0)
    }

    #[test]
    fn what_hits_channels_at_once_is_said_once() {
        let spikes = |first_row, count| Spikes { first_row, count };
        let told = spike_sentences(&setup(), &[spikes(3000, 1), spikes(3000, 1), spikes(9000, 2)]);
        assert_eq!(told.len(), 2, "{told:?}");
        assert!(
            told[0].starts_with("2 of 3 channels (\"a\", \"b\"): 1 spike of a single sample 0:01:00 into"),
            "{told:?}"
        );
        let out = |channel| SpectraWarning::ChannelLeftOut { channel, sound: 3, windows: 40 };
        let told = left_out_sentences(
            &setup(),
            &[out(0), out(2), SpectraWarning::WindowsLeftOut { left_out: 1, windows: 40 }],
        );
        assert_eq!(told.len(), 2, "{told:?}");
        assert!(
            told[0].starts_with("2 of 3 channels (\"a\", \"c\") are left out: they are sound in 3 of 40"),
            "{told:?}"
        );
    }

    #[test]
    fn a_gap_that_is_filled_is_not_said_to_cost_segments() {
        let gap = |channels: &[&str], samples| RecordWarning::MissingSamples {
            channels: Affected::new(channels.iter().copied(), 3),
            samples,
            seconds: 0.02 * samples as f64,
            gap_count: 1,
            first: FilePosition { file: "a.csv".into(), at: At::Line(4) },
            first_s: 0.04,
        };
        let filled = [2, 2, 0].map(|count| Filled { first_row: 2, count });
        let told = reader_sentences(&setup(), &[gap(&["a", "b"], 2), gap(&["c"], 50)], &filled);
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].starts_with("channel \"c\" has a gap of 50 samples"), "{told:?}");
    }
}
