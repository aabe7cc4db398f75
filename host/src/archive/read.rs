//! Reading: what a setup's nodes have sent in a range of time, and its windows in the order of the grid.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use belfry_shared::message::Configuration;
use belfry_shared::time::WindowGrid;

use super::asked::{Asked, unknown_settings};
use super::checksum::hour_of;
use super::damage::Damage;
use super::heads::{Head, Survey};
use super::range::moment;
use super::{Archive, ArchiveError, TimeRange};
use crate::spectra::{LineGrid, WindowLines};
use crate::study::Setup;
use crate::window::{ChannelData, NodeWindow, channels_by_node, node_lines, place_lines};

/// Newest windows that may still lack a node whose turn to send has not come.
const UNSETTLED: usize = 2;

/// What the archive holds of a setup.
#[derive(Debug, Clone, PartialEq)]
pub struct CollectedSetup {
    /// The lines that its windows carry.
    pub grid: LineGrid,
    /// Raw samples a decimated one.
    pub decimation: u32,
    /// Starts at which at least one node has a window.
    pub windows: usize,
    /// First start, in hops since the Unix epoch; windows are counted from there.
    pub first_grid_index: u64,
    /// The same in s of Unix time.
    pub start_s: f64,
    /// When the first window begins and the last ends, in words.
    pub span: [String; 2],
    /// Node windows that were measured with other lines, or averaged on the node, and are left out.
    pub other_windows: usize,
    /// Hashes of the configurations that make these lines.
    hashes: BTreeSet<u32>,
    /// µs of Unix time from and up to which middles of windows are asked for.
    middles_us: [i64; 2],
}

/// A setup's windows, and the archive that they are in.
pub struct Collected {
    /// What there is of them.
    pub setup: CollectedSetup,
    archive: Archive,
    asked: Vec<Asked>,
    survey: Survey,
    /// What is damaged of what was read so far.
    damages: Vec<Damage>,
}

impl std::fmt::Debug for Collected {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Collected").field("setup", &self.setup).field("archive", &self.archive).finish()
    }
}

/// What was counted of the windows of one configuration's lines.
#[derive(Default)]
struct Count {
    node_windows: usize,
    starts: usize,
    first: Option<u64>,
    last: Option<u64>,
}

impl Archive {
    /// What there is of a setup in a range of time: windows with the settings that were asked of its nodes last, as far as there are any.
    /// `None` where there are no windows at all.
    ///
    /// # Errors
    /// Where the archive cannot be read, or has windows, but none in the range.
    pub fn collected(self, setup: &Setup, range: &TimeRange) -> Result<Option<Collected>, ArchiveError> {
        // What is counted now is what is read later, whatever comes in between.
        self.connection.execute_batch("BEGIN").map_err(|source| self.failed(source))?;
        let (mut asked, mut damages) = self.asked().map_err(|source| self.failed(source))?;
        asked.retain(|one| one.setup == setup.name);
        let survey = Survey::new(&self, &setup.name).map_err(|source| self.failed(source))?;
        damages.extend(survey.damages.iter().cloned());
        let counted = self.count(&survey, &asked, range, &mut damages).map_err(|source| self.failed(source))?;
        let Some(Counted { counts, middles_us, bounds_us: [first_us, last_us] }) = counted else {
            // Nothing can be read, and that is not because nothing has come.
            return damages.first().map_or(Ok(None), |damage| Err(self.damaged(damage.to_string())));
        };
        if counts.is_empty() {
            if let Some(damage) = damages.first() {
                return Err(self.damaged(damage.to_string()));
            }
            return Err(ArchiveError::OutOfRange {
                range: range.to_string(),
                first: moment(first_us),
                last: moment(last_us),
            });
        }
        let lines = |one: &Asked| node_lines(&one.configuration);
        let with_windows =
            |one: &&Asked| lines(one).is_some_and(|lines| counts.iter().any(|(known, _)| *known == Some(lines)));
        let Some(newest) = asked.iter().rev().find(with_windows) else {
            return damages.first().map_or(Ok(None), |damage| Err(self.damaged(damage.to_string())));
        };
        let wanted = lines(newest);
        let (Some((grid, decimation)), Some((_, count))) = (wanted, counts.iter().find(|(lines, _)| *lines == wanted))
        else {
            return Ok(None);
        };
        let hashes = asked.iter().filter(|one| lines(one) == wanted).map(|one| one.configuration.hash()).collect();
        let first_grid_index = count.first.unwrap_or_default();
        let starts = clock(&newest.configuration);
        let start_us = starts.start(first_grid_index).0;
        let end_us = starts.start(count.last.unwrap_or_default().saturating_add(2)).0;
        let others = counts.iter().filter(|(lines, _)| *lines != wanted);
        let setup = CollectedSetup {
            grid,
            decimation,
            windows: count.starts,
            first_grid_index,
            start_s: start_us as f64 * 1e-6,
            span: [moment(start_us), moment(end_us)],
            other_windows: others.map(|(_, count)| count.node_windows).sum(),
            hashes,
            middles_us,
        };
        Ok(Some(Collected { setup, archive: self, asked, survey, damages }))
    }

    /// Counts the windows in a range, line grid by line grid; `None` where none at all is sound.
    fn count(
        &self,
        survey: &Survey,
        asked: &[Asked],
        range: &TimeRange,
        damages: &mut Vec<Damage>,
    ) -> rusqlite::Result<Option<Counted>> {
        let by_hash: BTreeMap<u32, &Configuration> =
            asked.iter().map(|one| (one.configuration.hash(), &one.configuration)).collect();
        let hop_of = |head: &Head| by_hash.get(&head.window.configuration_hash).map_or(0, |one| hop_us(one));
        let end_of = |head: &Head| head.start_us.saturating_add(2 * hop_of(head));
        // A damaged start must not move what is counted back from the last.
        let (Some(first), Some(last)) = (survey.outermost(self, false)?, survey.outermost(self, true)?) else {
            for hour in survey.hours() {
                let (heads, wrong) = survey.hour(self, hour)?;
                damages.extend(wrong);
                for head in heads {
                    damages.extend(self.channels(&head)?.err().map(|what| head.damaged(what)));
                }
            }
            return Ok(None);
        };
        let middles_us = range.middles(end_of(&last));
        let mut counts: Vec<(Option<(LineGrid, u32)>, Count)> = Vec::new();
        let mut unknown = 0;
        for hour in hours_of(survey, middles_us, by_hash.values().map(|one| hop_us(one)).max().unwrap_or(0)) {
            let (heads, wrong) = survey.hour(self, hour)?;
            damages.extend(wrong);
            for head in heads {
                let Some(configuration) = by_hash.get(&head.window.configuration_hash) else {
                    unknown += 1;
                    continue;
                };
                if !contains(middles_us, &head, hop_of(&head)) {
                    // It may be out of the range by damage alone.
                    damages.extend(self.channels(&head)?.err().map(|what| head.damaged(what)));
                    continue;
                }
                // Damaged, which is told when it is read; its place would set where all begin.
                if !is_in_place(&head, configuration) {
                    continue;
                }
                let lines = node_lines(configuration);
                let place = counts.iter().position(|(known, _)| *known == lines).unwrap_or(counts.len());
                if place == counts.len() {
                    counts.push((lines, Count::default()));
                }
                let count = &mut counts[place].1;
                count.node_windows += 1;
                if count.last != Some(head.window.grid_index) {
                    count.starts += 1;
                    count.last = Some(head.window.grid_index);
                    count.first =
                        Some(count.first.map_or(head.window.grid_index, |first| first.min(head.window.grid_index)));
                }
            }
        }
        damages.extend(unknown_settings(unknown));
        Ok(Some(Counted { counts, middles_us, bounds_us: [first.start_us, last.start_us] }))
    }
}

/// The windows in a range.
struct Counted {
    counts: Vec<(Option<(LineGrid, u32)>, Count)>,
    middles_us: [i64; 2],
    /// Starts of the first and the last window of all.
    bounds_us: [i64; 2],
}

pub(super) fn clock(configuration: &Configuration) -> WindowGrid {
    WindowGrid { sampling_rate_uhz: configuration.sampling_rate_uhz, hop_samples: configuration.hop_samples() }
}

/// Half a segment in µs.
pub(super) fn hop_us(configuration: &Configuration) -> i64 {
    clock(configuration).start(1).0
}

/// Whether a window begins where its place on the grid is.
fn is_in_place(head: &Head, configuration: &Configuration) -> bool {
    clock(configuration).start(head.window.grid_index).0 == head.start_us
}

/// Whether the middle of a window, a hop after its start, is in a range.
fn contains([from_us, to_us]: [i64; 2], head: &Head, hop_us: i64) -> bool {
    (from_us..to_us).contains(&head.start_us.saturating_add(hop_us))
}

/// The hours in which windows may begin whose middles are in a range.
fn hours_of(survey: &Survey, [from_us, to_us]: [i64; 2], longest_hop_us: i64) -> Vec<i64> {
    let hours = hour_of(from_us.saturating_sub(longest_hop_us))..=hour_of(to_us);
    survey.hours().filter(|hour| hours.contains(hour)).collect()
}

impl Collected {
    /// Hands out the windows of the whole setup in the order of the grid, counted from the first; `None` where a node has
    /// none. The newest are left out while nodes are still to send theirs. What is damaged is left out, and returned.
    ///
    /// # Errors
    /// Where the archive cannot be read; windows before that have been handed out.
    pub fn each_window(
        &self,
        setup: &Setup,
        on_window: &mut dyn FnMut(WindowLines),
    ) -> Result<Vec<Damage>, ArchiveError> {
        let nodes_expected = channels_by_node(setup).len();
        let columns = self.columns(setup);
        let failed = |source| self.archive.failed(source);
        let mut damages = self.damages.clone();
        // Starts whose nodes may not have sent all yet, oldest first.
        let mut waiting: VecDeque<(WindowLines, BTreeSet<u16>)> = VecDeque::new();
        let by_hash: BTreeMap<u32, &Configuration> =
            self.asked.iter().map(|one| (one.configuration.hash(), &one.configuration)).collect();
        let hop = by_hash.values().map(|one| hop_us(one)).max().unwrap_or(0);
        for hour in hours_of(&self.survey, self.setup.middles_us, hop) {
            let (heads, _) = self.survey.hour(&self.archive, hour).map_err(failed)?;
            for head in heads {
                let hash = head.window.configuration_hash;
                let Some(configuration) = by_hash.get(&hash).filter(|_| self.setup.hashes.contains(&hash)) else {
                    continue;
                };
                if !contains(self.setup.middles_us, &head, hop_us(configuration)) {
                    continue;
                }
                // Before it is asked whose it is: its node may be what is damaged.
                let data = match self.data(&head, configuration).map_err(failed)? {
                    Ok(data) => data,
                    Err(what) => {
                        damages.push(head.damaged(what));
                        continue;
                    }
                };
                let Some(channels) = columns.of(&head) else { continue };
                let grid_index = head.window.grid_index.saturating_sub(self.setup.first_grid_index);
                if waiting.back().is_none_or(|(last, _)| last.grid_index != grid_index) {
                    if waiting.len() > UNSETTLED
                        && let Some((settled, _)) = waiting.pop_front()
                    {
                        on_window(settled);
                    }
                    let channels = vec![None; setup.sensors.len()];
                    waiting.push_back((WindowLines { grid_index, channels }, BTreeSet::new()));
                }
                let Some((whole, nodes)) = waiting.back_mut() else { continue };
                // A node that started anew may have measured the same interval twice; the first stays.
                if nodes.insert(head.window.name.node) {
                    let window = NodeWindow { channels: data, ..head.window.clone() };
                    place_lines(&self.setup.grid, window, channels, whole);
                    calibrate(setup, channels, whole);
                }
            }
        }
        let is_whole = |(_, nodes): &(WindowLines, BTreeSet<u16>)| nodes.len() >= nodes_expected;
        let unsettled = waiting.iter().rev().take_while(|start| !is_whole(start)).count().min(UNSETTLED);
        waiting.truncate(waiting.len() - unsettled);
        waiting.into_iter().for_each(|(whole, _)| on_window(whole));
        Ok(damages)
    }

    /// The data of a window that is as its settings make it, or what is wrong with it.
    fn data(&self, head: &Head, configuration: &Configuration) -> rusqlite::Result<Result<Vec<ChannelData>, String>> {
        let data = match self.archive.channels(head)? {
            Ok(data) => data,
            Err(what) => return Ok(Err(what)),
        };
        let odd = data.iter().find_map(|data| match data {
            ChannelData::Lines(lines) if lines.len() != self.setup.grid.lines => Some(lines.len()),
            _ => None,
        });
        Ok(match odd {
            Some(lines) => Err(format!("{lines} lines where there should be {}", self.setup.grid.lines)),
            None if !is_in_place(head, configuration) => {
                Err("it does not begin where its place on the grid is".to_owned())
            }
            None => Ok(data),
        })
    }

    /// Which of the setup's channels a node's are, by what each node was asked.
    fn columns(&self, setup: &Setup) -> ChannelColumns {
        let mut columns = ChannelColumns::default();
        for Asked { node, since_us, configuration, names, .. } in &self.asked {
            let column = |name: &String| setup.sensors.iter().position(|sensor| sensor.channel == *name);
            // A channel that the study no longer has is none of them.
            let channels: Vec<usize> = names.iter().map(|name| column(name).unwrap_or(usize::MAX)).collect();
            if channels.iter().any(|&channel| channel < usize::MAX) {
                columns.0.entry((*node, configuration.hash())).or_default().push((*since_us, channels));
            }
        }
        columns
    }
}

/// Multiplies lines in these channels by their sensors' gains. Archives hold what nodes have sent; a calibration may come later.
fn calibrate(setup: &Setup, channels: &[usize], whole: &mut WindowLines) {
    for &channel in channels {
        let gain = setup.sensors.get(channel).and_then(|sensor| sensor.gain);
        if let (Some(gain), Some(Some(lines))) = (gain, whole.channels.get_mut(channel)) {
            lines.iter_mut().for_each(|line| *line *= gain as f32);
        }
    }
}

/// From when on, in µs of Unix time, a node's channels are which of the setup.
type Since = (i64, Vec<usize>);

/// Which of the setup's channels a node's are, by node and configuration.
#[derive(Debug, Default)]
struct ChannelColumns(BTreeMap<(u16, u32), Vec<Since>>);

impl ChannelColumns {
    fn of(&self, head: &Head) -> Option<&[usize]> {
        let asked = self.0.get(&(head.window.name.node, head.window.configuration_hash))?;
        let last = asked.iter().rev().find(|(since_us, _)| *since_us <= head.start_us).or(asked.first());
        last.map(|(_, channels)| channels.as_slice())
    }
}
