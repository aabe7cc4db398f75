//! One mode as one setup shows it: what estimates flow in as, and what judging and merging start from.

use super::curve::{Curve, Misfit};
use super::resonance::Resonance;
use super::scatter::{GroupChanges, deviation};
use super::shape::Shape;

/// A frequency or a damping ratio that scatters by less than this share of it is stuck: a day's record knows them far worse.
const STUCK: [f64; 2] = [1e-9, 1e-4];
/// Of less damping than this, damping says nothing of it.
const WIDE: f64 = 0.04;

/// One mode in one setup.
#[derive(Debug, Clone)]
pub(super) struct SetupMode {
    /// Frequency and damping.
    pub(super) resonance: Resonance,
    /// Shape at the setup's kept channels, largest component 1.
    pub(super) shape: Shape,
    /// Standard deviations.
    pub(super) frequency_std_hz: f64,
    pub(super) damping_std: f64,
    pub(super) shape_std: Vec<f64>,
    /// How much of the shape is scatter, but for its direction among modes that are as close as it is wide.
    pub(super) shape_noise: f64,
    /// Density at resonance.
    pub(super) peak_density: f64,
    /// Root mean square of the mode's response where it moves most.
    pub(super) level: f64,
    /// Whether the bell has its top near the pick; otherwise this setup does not show the mode.
    pub(super) found: bool,
    /// Its spectrum as measured and as fitted.
    pub(super) curve: Curve,
    /// How far these are from each other.
    pub(super) misfit: Option<Misfit>,
    /// What each group of windows changes in its numbers.
    pub(super) changes: GroupChanges,
    /// The shape's phase collinearity before anything was taken for noise.
    pub(super) collinearity: f64,
    /// Whether it stands alone where the structure moves in two directions, so that its shape is any in their plane.
    pub(super) in_plane: bool,
    /// Distance of the lines that it was fitted to.
    pub(super) spacing_hz: f64,
}

impl SetupMode {
    /// Whether the fit has come to an end at the mode, with deviations.
    pub(super) fn is_sound(&self) -> bool {
        let is_known = |std: f64| std > 0.0 && std.is_finite();
        let is_certain = is_known(self.frequency_std_hz) && is_known(self.damping_std) && self.shape_noise.is_finite();
        self.found && is_certain
    }

    /// Whether the frequency or the damping is the same in all replicates.
    pub(super) fn is_stuck(&self) -> bool {
        is_stuck(&self.resonance, &self.changes)
    }

    /// With the shape of another estimate of the mode, and how the errors of its numbers go together there.
    pub(super) fn with_shape_of(self, other: Self) -> Self {
        Self {
            shape: other.shape,
            shape_std: other.shape_std,
            shape_noise: other.shape_noise,
            collinearity: other.collinearity,
            changes: other.changes,
            ..self
        }
    }

    /// With deviations that hold what the fit leaves unexplained too: it does not change from group to group, so it is not in the
    /// scatter. Whether there is a mode at all does not depend on it.
    pub(super) fn widened(&self) -> Self {
        let factor = self.misfit.filter(Misfit::is_significant).map_or(1.0, |misfit| misfit.ratio);
        Self {
            frequency_std_hz: factor * self.frequency_std_hz,
            damping_std: factor * self.damping_std,
            shape_std: self.shape_std.iter().map(|std| factor * std).collect(),
            ..self.clone()
        }
    }
}

/// Whether frequency or damping is the same in all replicates: the fit has run into a wall, or stands in another mode's way. What the
/// likelihood says of its deviation then means nothing.
pub(super) fn is_stuck(resonance: &Resonance, changes: &GroupChanges) -> bool {
    let [frequency, damping] = STUCK;
    // Narrow for its lines, a mode may have the same damping in all replicates: finer lines tell. A wide one is a fit at a limit.
    let is_wide = resonance.damping_ratio > WIDE;
    deviation(&changes.frequency_hz) < frequency * resonance.frequency_hz
        || (is_wide && deviation(&changes.damping_ratio) < damping * resonance.damping_ratio)
}

/// The modes of one setup, in the order of the picks.
#[derive(Debug, Clone)]
pub(super) struct SetupModes {
    pub(super) modes: Vec<SetupMode>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::resonance::Quantity;

    #[test]
    fn a_fit_that_never_moves_is_stuck() {
        let resonance = Resonance { frequency_hz: 1.0, damping_ratio: 0.01, quantity: Quantity::Acceleration };
        let moves_by = |change_hz: f64| {
            let changes = GroupChanges { frequency_hz: vec![change_hz, -change_hz], ..GroupChanges::unknown(2) };
            is_stuck(&resonance, &changes)
        };
        assert!(moves_by(0.0) && !moves_by(1e-4));
        assert!(!is_stuck(&resonance, &GroupChanges::unknown(2)), "a method without replicates says nothing");
    }
}
