//! Modes found interval by interval, linked over time.
//!
//! The intervals of a setup flow in one after the other; what each shows of every mode flows out. A mode is looked for where the
//! interval before had it, so that slow drifts are followed however far they go. What an interval shows and the whole record does
//! not, because there it was smeared, is followed from then on.

use super::IntervalMode;
use crate::identify::ssi::add_second_opinion;
use crate::identify::track::{REACH, REACH_LINES, Tracked, same_shape, track};
use crate::identify::{Harmonic, Identification, MeasuredSetup, Mode, identify};
use crate::study::ModeChoice;

/// A mode that the whole record does not show must be in this share of the intervals that follow its first, and in so many; less is
/// noise that was picked.
const LEAST_SHARE: f64 = 0.5;
const LEAST_INTERVALS: usize = 3;

/// The modes that are followed, as they were last seen.
pub(super) struct Follower<'a> {
    choice: &'a ModeChoice,
    /// Modes of the whole record first; their frequencies are those of the last interval that shows them.
    known: Vec<Mode>,
    of_whole_record: usize,
    /// Forced lines of the whole record.
    forced: Vec<Harmonic>,
    /// Of each mode beyond those of the whole record: the interval that first shows it.
    first_seen: Vec<usize>,
    /// Whether new modes are taken up.
    takes_new: bool,
    intervals: usize,
}

impl<'a> Follower<'a> {
    /// Follows the modes of `whole`; where `takes_new`, also what they lack.
    pub(super) fn new(whole: &Identification, choice: &'a ModeChoice, takes_new: bool) -> Self {
        let takes_new = takes_new && choice.only_hz.is_none();
        Self {
            choice,
            known: whole.modes.clone(),
            of_whole_record: whole.modes.len(),
            forced: whole.harmonics.clone(),
            first_seen: Vec::new(),
            takes_new,
            intervals: 0,
        }
    }

    /// The same where modes were last seen at these frequencies.
    pub(super) fn last_seen(mut self, last_hz: &[(usize, f64)]) -> Self {
        for mode in &mut self.known {
            if let Some((_, hz)) = last_hz.iter().find(|(number, _)| *number == mode.number) {
                mode.frequency_hz = *hz;
            }
        }
        self
    }

    /// The modes that the next interval shows.
    pub(super) fn take(&mut self, measured: MeasuredSetup<'_>) -> Vec<IntervalMode> {
        let mut forced = self.forced.clone();
        if self.takes_new {
            forced.extend(self.look(&measured));
        }
        self.intervals += 1;
        let tracked = track(measured, &self.known, &forced);
        for (mode, tracked) in self.known.iter_mut().zip(&tracked) {
            if let Some(tracked) = tracked {
                mode.frequency_hz = tracked.frequency_hz;
            }
        }
        let of = |(mode, tracked): (&Mode, Option<Tracked>)| tracked.map(|tracked| interval_mode(mode.number, tracked));
        self.known.iter().zip(tracked).filter_map(of).collect()
    }

    /// Finds the interval's own modes: where those that are followed are now, and which are new. Gives its forced lines.
    fn look(&mut self, measured: &MeasuredSetup<'_>) -> Vec<Harmonic> {
        let spacing_hz = measured.spectrum.grid().spacing_hz();
        // An interval that is too short for picking can be tracked all the same.
        let measured = std::slice::from_ref(measured);
        let Ok(mut found) = identify(measured, self.choice) else { return Vec::new() };
        // A neighbour that the fit alone does not see bends the mode beside it.
        if add_second_opinion(measured, self.choice, &mut found).is_err() {
            return Vec::new();
        }
        let reach_hz = |hz: f64| (REACH * hz).max(REACH_LINES * spacing_hz);
        let distance = |known: &Mode, mode: &Mode| (known.frequency_hz - mode.frequency_hz).abs();
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (place, known) in self.known.iter().enumerate() {
            for (at, mode) in found.modes.iter().enumerate() {
                if distance(known, mode) < reach_hz(known.frequency_hz) && same_shape(known, mode) {
                    pairs.push((distance(known, mode), place, at));
                }
            }
        }
        // The nearest first; each once.
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut is_linked, mut is_taken) = (vec![false; self.known.len()], vec![false; found.modes.len()]);
        for (_, place, at) in pairs {
            if !is_linked[place] && !is_taken[at] {
                (is_linked[place], is_taken[at]) = (true, true);
                self.known[place].frequency_hz = found.modes[at].frequency_hz;
            }
        }
        let new = found.modes.into_iter().zip(is_taken).filter(|(_, is_taken)| !is_taken).map(|(mode, _)| mode);
        for mut mode in new {
            // Beside a mode that is followed and was not found now, it may be that one with another shape.
            let is_near = |(known, is_linked): (&Mode, &bool)| {
                !is_linked && distance(known, &mode) < spacing_hz + 0.5 * mode.bandwidth_hz()
            };
            if self.known.iter().zip(&is_linked).any(is_near) {
                continue;
            }
            mode.number = self.known.iter().map(|known| known.number).max().unwrap_or(0) + 1;
            self.known.push(mode);
            self.first_seen.push(self.intervals);
            is_linked.push(true);
        }
        found.harmonics
    }

    /// The modes beyond those of the whole record that last, of what `intervals` show.
    pub(super) fn lasting<'b>(self, intervals: impl Iterator<Item = &'b [IntervalMode]> + Clone) -> Vec<Mode> {
        let lasts = |(mode, first_seen): &(Mode, usize)| {
            let seen = intervals.clone().filter(|modes| modes.iter().any(|seen| seen.number == mode.number)).count();
            seen >= LEAST_INTERVALS && seen as f64 >= LEAST_SHARE * (self.intervals - first_seen) as f64
        };
        let new = self.known.iter().skip(self.of_whole_record).cloned().zip(self.first_seen.iter().copied());
        new.filter(lasts).map(|(mode, _)| mode).collect()
    }
}

fn interval_mode(number: usize, tracked: Tracked) -> IntervalMode {
    let Tracked { frequency_hz, frequency_std_hz, damping_ratio, damping_ratio_std, mac, level } = tracked;
    IntervalMode { number, frequency_hz, frequency_std_hz, damping_ratio, damping_ratio_std, mac, response_rms: level }
}
