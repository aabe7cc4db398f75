//! What a structure is made of besides its body: a list of contributions, each of which changes the stiffness K, the mass M,
//! the damping C, or what sensors see.
//!
//! [`Structure::assemble`](super::Structure::assemble) goes through the phases below one after the other, and in each phase
//! through all contributions in the order of the list. A new effect is a type with the phases in which it acts; all others
//! keep their default, which does nothing. Order matters to the last bit of K and M, and in a few places to the physics: a
//! mass that is attached adds to the weight that the beam below carries, and a factor on all of K acts on springs that were
//! attached before, not on the spring of a damper.
//!
//! | phase | what there is | method |
//! |---|---|---|
//! | 1 | the segments of a beam | [`change_segments`](Contribution::change_segments) |
//! | 2 | the element of each segment | sum of [`coupled_shear_m`](Contribution::coupled_shear_m), [`soften`](Contribution::soften), then the sums of [`frames_n`](Contribution::frames_n) and [`compression`](Contribution::compression) |
//! | 3 | the base node of a beam, which is eliminated | sum of [`base_flexibility`](Contribution::base_flexibility) |
//! | 4 | K and M of the body | [`rearrange`](Contribution::rearrange) |
//! | 5 | the same, and motion of the axis at any height | [`attach`](Contribution::attach) |
//! | 6 | the same with all that is attached | [`add_matrices`](Contribution::add_matrices) |
//! | 7 | the same with all that is added | [`reshape`](Contribution::reshape) |
//! | 8 | the same | sum of [`base_flexibility`](Contribution::base_flexibility) of imported matrices, then the product of [`factors`](Contribution::factors) |
//! | 9 | final K and M | [`hang`](Contribution::hang) |
//! | 10 | what sensors see | sum of [`distortion`](Contribution::distortion), [`sensor_change`](Contribution::sensor_change) |
//!
//! Phases 1 to 3 are those of a beam table; imported matrices start with phase 4, where `coupled_shear_m` acts on them as a whole.

use std::fmt;
use std::sync::Arc;

use super::assembly::Assembly;
use super::base::BaseFlexibility;
use super::beam::Segment;
use super::distortion::Distortion;
use super::element::Compression;
use super::joint::Element;
use super::matrices::WholeMatrices;
use super::sensing::SensorChange;
use super::storeys::Storeys;

/// One thing that makes a structure differ from its body; `model/contribution.rs` opens with the order of the phases.
pub trait Contribution: fmt::Debug + Send + Sync {
    /// Changes segments of a beam; their ends stay where they are.
    fn change_segments(&self, _segments: &mut [Segment]) {}

    /// How far above the nodes, for motion along X and Y in m, the points are that move as those of an ordinary beam: bending makes it
    /// shear, `u' = φ + V / GA - d φ'`, and as that term is a derivative along the beam, `u + d φ` is the sway of one without it.
    fn coupled_shear_m(&self) -> [f64; 2] {
        [0.0; 2]
    }

    /// Shear stiffness in N, along X and Y, of what stands beside the beam and is tied to it at the nodes.
    fn frames_n(&self) -> [f64; 2] {
        [0.0; 2]
    }

    /// Softens or stiffens the element of a segment.
    fn soften(&self, _element: &mut Element) {}

    /// The compression that it puts on a segment.
    fn compression(&self, _above: &MassAbove) -> Compression {
        Compression::default()
    }

    /// How far it lets the base of a beam give way.
    fn base_flexibility(&self) -> BaseFlexibility {
        BaseFlexibility::default()
    }

    /// Changes K and M of the body itself, such as where masses are.
    fn rearrange(&self, _assembly: &mut Assembly) {}

    /// Attaches masses or springs to the structure at a height.
    fn attach(&self, _assembly: &mut Assembly) {}

    /// The mass that it attaches, which weighs on what is below.
    fn attached_mass(&self) -> Option<PointMass> {
        None
    }

    /// Adds to K and M as a whole.
    fn add_matrices(&self, _assembly: &mut Assembly) {}

    /// Adds to K and M of a model that is reduced, as its files have them.
    fn add_to_whole(&self, _matrices: &mut WholeMatrices) {}

    /// Changes K by what the storeys are along X and Y, where the model is one of storeys; all of it will be multiplied with `factors`.
    fn reshape(&self, _storeys: &[Option<Storeys>; 2], _assembly: &mut Assembly, _factors: &Factors) {}

    /// Whether it does that: what is added to K is not all that K then changes by.
    fn reshapes(&self) -> bool {
        false
    }

    /// Factors on the whole of K and M.
    fn factors(&self) -> Factors {
        Factors::default()
    }

    /// Hangs something with DOFs of its own onto the structure.
    fn hang(&self, _assembly: &mut Assembly) {}

    /// Whether it hangs a damper there, which splits modes into twins.
    fn is_damper(&self) -> bool {
        false
    }

    /// How far it lets sections distort in their own plane.
    fn distortion(&self) -> Distortion {
        Distortion::default()
    }

    /// The name of a hypothesis or group of the user's own, and how much of it this is; `None` of all else.
    fn amount_of(&self) -> Option<(&str, f64)> {
        None
    }

    /// What it changes about the sensors.
    fn sensor_change(&self) -> Option<Arc<dyn SensorChange>> {
        None
    }

    /// A frequency in Hz at which it drives the structure: a line there is no mode.
    fn forced_hz(&self) -> Option<f64> {
        None
    }
}

/// What is above the middle of a segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MassAbove {
    /// Masses of the table and attached ones, in kg, without [`MassAbove::factors`].
    pub mass_kg: f64,
    /// Rotational inertia of the table about the axis, in kg m², without [`MassAbove::factors`].
    pub polar_kg_m2: f64,
    /// What K and M will be multiplied with.
    pub factors: Factors,
}

/// A mass without rotational inertia, fixed to the beam axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointMass {
    /// Its height in m, between base and top.
    pub z_m: f64,
    /// Its mass in kg.
    pub mass_kg: f64,
}

/// Factors on the whole of K and M.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factors {
    /// On K, springs of the base and attached ones included.
    pub stiffness: f64,
    /// On M, attached masses included.
    pub mass: f64,
}

impl Default for Factors {
    /// What leaves K and M as they are.
    fn default() -> Self {
        Self { stiffness: 1.0, mass: 1.0 }
    }
}

/// Nothing: for effects that show in how the modes move about the record's mean, and not in the mean.
#[derive(Debug, Clone, Copy)]
pub(super) struct OnlyOverTime;

impl Contribution for OnlyOverTime {}

/// The contribution of an effect that changes nothing but the sensors.
#[derive(Debug, Clone)]
pub(super) struct OnSensors(Arc<dyn SensorChange>);

impl OnSensors {
    /// Of what changes about them.
    pub(super) fn only(change: impl SensorChange + 'static) -> Arc<dyn Contribution> {
        Arc::new(Self(Arc::new(change)))
    }
}

impl Contribution for OnSensors {
    fn sensor_change(&self) -> Option<Arc<dyn SensorChange>> {
        Some(self.0.clone())
    }
}
