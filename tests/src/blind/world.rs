//! The world of a case: what of its scatter, loads and sizes the study does not know.
//!
//! The bench first made its truths in the world that belfry assumes: the tolerance that the study states, its kernel and length, one
//! factor for all stiffnesses of a segment, noise as the load, defects that move frequencies by 3 to 15 %. A drawn world shares none of
//! these with the study.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::magnitude::log_uniform;

/// Covariance of the scatter over the height.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kernel {
    /// exp(-d²/2L²): smooth, as the study assumes.
    SquaredExponential,
    /// exp(-d/L): rough.
    Exponential,
    /// Each segment by itself.
    White,
}

impl Kernel {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::SquaredExponential => "squared exponential",
            Self::Exponential => "exponential",
            Self::White => "each segment by itself",
        }
    }
}

/// What shakes a structure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Loads {
    /// White noise on every node, in proportion to its mass: all modes are driven alike, each by itself.
    Even,
    /// The same, growing upwards and uneven, so that modes are driven together to some extent.
    Uneven,
    /// Wind: coherent over the height, coloured.
    Wind,
}

impl Loads {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Even => "even noise",
            Self::Uneven => "uneven noise",
            Self::Wind => "wind",
        }
    }
}

/// The world of one case.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct World {
    /// Covariance of the scatter over the height.
    pub kernel: Kernel,
    /// Its length over the one that the study states.
    pub length: f64,
    /// Its size over the one that the study is right about: 2 to 3 % of stiffness, 1 % of mass.
    pub scatter: f64,
    /// Whether bending along each axis, shear along each axis and torsion scatter each by itself.
    pub apart: bool,
    /// What shakes the structure.
    pub loads: Loads,
    /// Between which relative shifts of a frequency the sizes of effects are drawn.
    pub shift: [f64; 2],
}

/// Largest relative shift of a frequency by a defect that the study can be asked to tell.
pub(super) const SHIFT: [f64; 2] = [0.03, 0.15];
/// The same with those that hide in the scatter.
const ANY_SHIFT: [f64; 2] = [0.005, 0.15];

impl World {
    /// The world that belfry assumes.
    pub const ASSUMED: Self = Self {
        kernel: Kernel::SquaredExponential,
        length: 1.0,
        scatter: 1.0,
        apart: false,
        loads: Loads::Even,
        shift: SHIFT,
    };

    fn drawn(random: &mut impl Rng) -> Self {
        let kernels = [Kernel::SquaredExponential, Kernel::Exponential, Kernel::White];
        let loads = [Loads::Even, Loads::Uneven, Loads::Wind];
        Self {
            kernel: kernels[random.random_range(0..3)],
            length: log_uniform(random, [0.5, 2.0]),
            scatter: [0.5, 1.0, 2.0][random.random_range(0..3)],
            apart: random.random_bool(0.5),
            loads: loads[random.random_range(0..3)],
            shift: ANY_SHIFT,
        }
    }
}

/// The worlds of a bench.
#[derive(Debug, Clone, Copy, Default)]
pub struct Worlds {
    /// Whether each case has a world of its own; else all have the one that belfry assumes.
    pub are_drawn: bool,
    /// The scatter of all of them.
    pub scatter: Option<f64>,
    /// The loads of all of them.
    pub loads: Option<Loads>,
}

impl Worlds {
    /// The world of a case.
    pub(super) fn of(&self, seed: u64, index: u64) -> World {
        // Apart from the stream of the case itself, which stays the same in every world.
        let mut random = ChaCha8Rng::seed_from_u64(!seed);
        random.set_stream(index);
        let world = if self.are_drawn { World::drawn(&mut random) } else { World::ASSUMED };
        World { scatter: self.scatter.unwrap_or(world.scatter), loads: self.loads.unwrap_or(world.loads), ..world }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_of_a_world_is_drawn_and_can_be_stated() {
        let drawn = Worlds { are_drawn: true, ..Worlds::default() };
        let worlds: Vec<World> = (0..200).map(|index| drawn.of(5, index)).collect();
        assert_eq!(worlds[7], drawn.of(5, 7));
        let share = |is: &dyn Fn(&World) -> bool| worlds.iter().filter(|world| is(world)).count();
        for kernel in [Kernel::SquaredExponential, Kernel::Exponential, Kernel::White] {
            assert!(share(&|world| world.kernel == kernel) > 40, "{kernel:?}");
        }
        for scatter in [0.5, 1.0, 2.0] {
            assert!(share(&|world| world.scatter == scatter) > 40, "{scatter}");
        }
        assert!((70..130).contains(&share(&|world| world.apart)));
        assert!((70..130).contains(&share(&|world| world.length > 1.0)));
        let stated = Worlds { scatter: Some(3.0), loads: Some(Loads::Wind), ..drawn }.of(5, 7);
        assert_eq!(stated, World { scatter: 3.0, loads: Loads::Wind, ..worlds[7] });
        assert_eq!(Worlds::default().of(5, 7), World::ASSUMED);
    }
}
