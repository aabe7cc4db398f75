//! Whether a fault of sensors explains its own channels.
//!
//! A fit with such a fault flows in; a word flows out. A fault changes nothing but what its channels show, so what is left there is what
//! is left elsewhere. Where they still stand out in a fit that passes, a discrepancy has taken up what the structure lacks, and the fault
//! stands in for the rest of it. Measured: masses to one side of the template's tower, without their kind in the catalogue, pass for a swap of two
//! channels at the top (p 0.6, ln B 87), of which one leaves 4.0 per number then and the others 0.5.

use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::fit::Fit;
use super::problem::Problem;
use super::verdict::squares_by_sensor;
use crate::model::effect::Where;
use crate::model::row_of;

/// A channel that leaves this much more than the others by chance once in a thousand times does not.
const BY_CHANCE: f64 = 1e-3;

impl Problem {
    /// Whether the channels of an effect of a fit leave no more than the others. True of an effect that is at no channel.
    pub(super) fn explains_its_channels(&self, fit: &Fit, effect: usize) -> bool {
        let Some(Where::Channels(channels)) = fit.effects()[effect].place() else { return true };
        let squares = squares_by_sensor(self.sensors.len(), fit);
        let own: Vec<usize> = channels.iter().filter_map(|channel| row_of(channel, &self.sensors)).collect();
        let others = (0..squares.len()).filter(|sensor| !own.contains(sensor)).map(|sensor| squares[sensor]);
        let (sum, count) = others.fold((0.0, 0), |(sum, count), (more, by)| (sum + more, count + by));
        own.iter().all(|&sensor| is_no_more(squares[sensor], (sum, count)))
    }
}

/// Whether squares of standard normal numbers, given as a sum and a count, are no more than those of others: by Fisher's F.
fn is_no_more((sum, count): (f64, usize), (sum_of_others, others): (f64, usize)) -> bool {
    let (count, others) = (count as f64, others as f64);
    // Nothing at all on one side: nothing to compare.
    FisherSnedecor::new(count, others).map_or(true, |chance| {
        let ratio = (sum / count) / (sum_of_others / others);
        ratio.is_nan() || chance.sf(ratio) >= BY_CHANCE
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// F(13, 200) is exceeded once in a thousand times at 2.82 (by scipy.stats.f.isf).
    #[test]
    fn what_is_left_is_compared_by_its_mean_squares() {
        assert!(is_no_more((13.0 * 2.7 * 0.5, 13), (100.0, 200)));
        assert!(!is_no_more((13.0 * 2.95 * 0.5, 13), (100.0, 200)));
        assert!(is_no_more((1e6, 13), (0.0, 0)) && is_no_more((0.0, 0), (100.0, 200)));
        assert!(is_no_more((0.0, 13), (0.0, 200)));
    }
}
