//! Where along the height an effect is, and how well that is known.
//!
//! An effect found at a place of the grid flows in; the same effect at its most probable height, with a standard deviation,
//! flows out.

use super::fit::Fit;
use super::found::{AtHeight, Found, HeightSpread, NEAR};
use super::problem::Problem;
use crate::model::effect::Where;

/// Steps to a neighbouring place of the grid.
const MOST_STEPS: usize = 8;
/// Fits between three neighbouring places.
const MOST_FITS: usize = 5;
/// A place within this of another, in m, is the same.
const SAME_PLACE_M: f64 = 0.05;
/// Evidence that differs by less than this is alike.
const ALIKE: f64 = 0.02;

impl Problem {
    /// Moves an effect at a height to where its evidence is the highest, from place to place of the grid and then between
    /// them; says how sure the height is.
    pub(super) fn settle_height(&self, found: &mut Found) {
        let (Some(Where::Height(start_m)), true) = (found.effect().place().cloned(), found.kind.may_be_anywhere())
        else {
            return;
        };
        let before = found.fit.log_evidence();
        let Some(mut around) = self.climb(found, start_m) else { return };
        for _ in 0..MOST_FITS {
            let Some(z_m) = around.next_m() else { break };
            let Some(fit) = self.fit_at(&around.best.1, z_m) else { break };
            around.insert(z_m, fit);
        }
        found.height = around.spread();
        let log_share = found.height.as_ref().and_then(|height| self.log_share(found.hypotheses, height.std_m));
        if let Some(log_share) = log_share {
            found.log_bayes_factor += log_share - found.log_share;
            found.log_share = log_share;
        }
        let (z_m, best) = around.best;
        let gain = best.log_evidence() - before;
        if gain > 0.0 {
            found.log_bayes_factor += gain;
            found.fit = best;
            let moved = |(place, below): (Where, f64)| Some((place, below + gain)).filter(|near| near.1 < NEAR);
            found.near = std::mem::take(&mut found.near).into_iter().filter_map(moved).collect();
            found.near.retain(|(place, _)| *place != Where::Height(z_m));
        }
    }

    /// Logarithm of the mean evidence over the height against that at the best height, for an effect that may be at any and whose
    /// evidence falls from there as a Gaussian of this standard deviation: `ln(sqrt(2 pi) std / height)`, the look-elsewhere
    /// factor; divided by the sets of parameters that were tried at each place. `None` where nothing is known of the height.
    fn log_share(&self, hypotheses: usize, std_m: f64) -> Option<f64> {
        let [z_base_m, z_top_m] = self.bare.z_range_m()?;
        let share = (std::f64::consts::TAU.sqrt() * std_m / (z_top_m - z_base_m)).min(1.0);
        let sets = (hypotheses as f64 / self.heights_m().len().max(1) as f64).max(1.0);
        (share > 0.0).then(|| (share / sets).ln())
    }

    /// A fit with its last effect at another height.
    fn fit_at(&self, fit: &Fit, z_m: f64) -> Option<Fit> {
        let mut effects = fit.state.effects.clone();
        let last = effects.last_mut()?;
        *last = last.moved_to(Where::Height(z_m));
        self.fit(effects, &fit.knobs, &fit.state.numbers, Some(&fit.state)).ok()
    }

    /// From place to place of the grid while the evidence rises.
    fn climb(&self, found: &Found, start_m: f64) -> Option<Around> {
        let mut grid = self.heights_m();
        grid.retain(|z_m| (z_m - start_m).abs() > SAME_PLACE_M);
        let mut at = grid.partition_point(|&z_m| z_m < start_m);
        grid.insert(at, start_m);
        let known_at = |z_m: f64| found.known.iter().find(|known| (known.z_m - z_m).abs() < SAME_PLACE_M);
        let mut known: Vec<Option<AtHeight>> = grid.iter().map(|&z_m| known_at(z_m).cloned()).collect();
        let mut best = self.fit_at(&found.fit, start_m)?;
        known[at] = AtHeight::of(&best);
        for _ in 0..MOST_STEPS {
            let mut next: Option<(usize, Fit)> = None;
            for other in [at.wrapping_sub(1), at + 1].into_iter().filter(|&other| other < grid.len()) {
                if known[other].is_some() {
                    continue;
                }
                let Some(fit) = self.fit_at(&best, grid[other]) else { continue };
                known[other] = AtHeight::of(&fit);
                if fit.log_evidence() > next.as_ref().map_or(best.log_evidence(), |next| next.1.log_evidence()) {
                    next = Some((other, fit));
                }
            }
            match next {
                Some(next) => (at, best) = next,
                None => break,
            }
        }
        let value = |index: usize| known.get(index)?.clone();
        Some(Around { best: (grid[at], best), low: value(at.wrapping_sub(1)), high: value(at + 1) })
    }
}

/// The best height so far, with one on each side that is no better.
struct Around {
    best: (f64, Fit),
    low: Option<AtHeight>,
    high: Option<AtHeight>,
}

impl Around {
    /// Heights and evidence on both sides.
    fn ends(&self) -> Option<((f64, f64), (f64, f64))> {
        let pair = |at: &AtHeight| (at.z_m, at.log_evidence);
        Some((pair(self.low.as_ref()?), pair(self.high.as_ref()?)))
    }

    /// The parabola through the three: its top, and its curvature there.
    fn parabola(&self) -> Option<(f64, f64)> {
        let ((low_m, low), (high_m, high)) = self.ends()?;
        let (at_m, at) = (self.best.0, self.best.1.log_evidence());
        let (left, right) = ((at - low) / (at_m - low_m), (high - at) / (high_m - at_m));
        let curvature = 2.0 * (right - left) / (high_m - low_m);
        let slope = left + 0.5 * curvature * (at_m - low_m);
        (curvature < 0.0).then(|| (at_m - slope / curvature, curvature))
    }

    /// The height to look at next; `None` where nothing more is gained.
    fn next_m(&self) -> Option<f64> {
        let ((low_m, low), (high_m, high)) = self.ends()?;
        let (at_m, at) = (self.best.0, self.best.1.log_evidence());
        if at - low.max(high) < ALIKE {
            return None;
        }
        let (top_m, _) = self.parabola()?;
        let width = high_m - low_m;
        // Not closer to a known one than a tenth of the width: parabolas lie where elements meet.
        let mut next_m = top_m.clamp(low_m + 0.1 * width, high_m - 0.1 * width);
        if (next_m - at_m).abs() < 0.05 * width {
            next_m = if high_m - at_m > at_m - low_m { at_m + 0.1 * width } else { at_m - 0.1 * width };
        }
        let next_m = (10.0 * next_m).round() / 10.0;
        let apart = |known_m: f64| (next_m - known_m).abs() > SAME_PLACE_M;
        (apart(at_m) && apart(low_m) && apart(high_m)).then_some(next_m)
    }

    fn insert(&mut self, z_m: f64, fit: Fit) {
        let is_above = z_m > self.best.0;
        if fit.log_evidence() > self.best.1.log_evidence() {
            let known = AtHeight::of(&self.best.1);
            if is_above {
                self.low = known
            } else {
                self.high = known
            }
            self.best = (z_m, fit);
        } else if is_above {
            self.high = AtHeight::of(&fit);
        } else {
            self.low = AtHeight::of(&fit);
        }
    }

    /// How well the height is known, from the curvature of the evidence; `None` at an end of the structure, or where the
    /// evidence is flat.
    fn spread(&self) -> Option<HeightSpread> {
        let std_m = self.parabola().map(|(_, curvature)| (-curvature).recip().sqrt()).filter(|std| std.is_finite())?;
        let (low, high) = (self.low.as_ref()?, self.high.as_ref()?);
        let across = |(low_value, high_value): (&f64, &f64)| (high_value - low_value).abs() / (high.z_m - low.z_m);
        Some(HeightSpread {
            std_m,
            values: low.values.iter().zip(&high.values).map(across).map(|per_m| per_m * std_m).collect(),
        })
    }
}
