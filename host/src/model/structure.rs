//! From a structure (a body and what contributes to it) to its mass and stiffness matrices.

use std::ops::Add;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use super::DOFS_A_NODE;
use super::arms::{carry, upright};
use super::assembly::Assembly;
use super::base::BaseFlexibility;
use super::beam::{BeamTable, Segment, Stiffness};
use super::contribution::{Contribution, Factors, MassAbove};
use super::custom::Custom;
use super::distortion::Distortion;
use super::effect::mass_eccentricity::Eccentricity;
use super::effect::{Effect, EffectError};
use super::element::{Compression, DOFS_A_SEGMENT, scatter};
use super::joint::Element;
use super::layout::LayoutNode;
use super::mass_spread::{MassSpread, spread};
use super::matrices::{ImportedMatrices, WholeMatrices};
use super::sensing::Sensing;
use super::sensitivity::Change;
use super::storeys::Storeys;
use crate::study::GroupTerms;

/// What a model is made of.
#[derive(Debug, Clone, PartialEq)]
pub enum Body {
    /// A table of beam segments.
    Beam(BeamTable),
    /// Matrices from elsewhere.
    Matrices(ImportedMatrices),
}

/// A body and everything that contributes to it before it is assembled.
#[derive(Debug, Clone)]
pub struct Structure {
    /// What it is made of, as first given; a beam is clamped at the base.
    pub body: Body,
    /// The user's own hypotheses, which effects may name.
    pub customs: Arc<[Custom]>,
    contributions: Vec<Arc<dyn Contribution>>,
}

impl From<BeamTable> for Body {
    fn from(beam: BeamTable) -> Self {
        Self::Beam(beam)
    }
}

impl Structure {
    /// The body as it is given; a beam is clamped at the base.
    pub fn new(body: impl Into<Body>) -> Self {
        Self { body: body.into(), customs: Arc::new([]), contributions: Vec::new() }
    }

    /// The same with hypotheses of the user's own that effects may name.
    #[must_use]
    pub fn with_customs(self, customs: Arc<[Custom]>) -> Self {
        Self { customs, ..self }
    }

    /// Adds a contribution to the end of the list.
    pub fn push(&mut self, contribution: Arc<dyn Contribution>) {
        self.contributions.push(contribution);
    }

    /// Spreads this share of each node's mass evenly to the middles of the segments next to it, its centre staying; a table
    /// lumps all of it at the nodes. Leaves imported matrices as they are.
    pub fn spread_masses(&mut self, share: f64) {
        self.push(Arc::new(MassSpread(share)));
    }

    /// Moves the centres of mass of all nodes below a mast off the axis, along X and Y in m.
    pub fn shift_masses(&mut self, offset_m: [f64; 2]) {
        self.push(Arc::new(Eccentricity { offset_m }));
    }

    /// Lets sections distort in their own plane as the structure bends and twists: sensors off the axis see it.
    pub fn distort_sections(&mut self, distortion: Distortion) {
        self.push(Arc::new(distortion));
    }

    /// The same with groups that are trusted: they may still be effects.
    #[must_use]
    pub fn with_trusted_groups(self) -> Self {
        let trusted = |custom: &Custom| {
            let mut custom = custom.clone();
            custom.group = custom.group.map(|group| GroupTerms { std: 0.0, ..group });
            custom
        };
        Self { customs: self.customs.iter().map(trusted).collect(), ..self }
    }

    /// Changes groups of the model, in the order of [`Structure::groups`], by these shares of themselves.
    pub fn change_groups(&mut self, changes: &[f64]) {
        let groups: Vec<Arc<dyn Contribution>> = self
            .groups()
            .zip(changes)
            .filter(|(_, change)| **change != 0.0)
            .map(|((group, _), &change)| Arc::new(group.times(change)) as Arc<dyn Contribution>)
            .collect();
        self.contributions.extend(groups);
    }

    /// Parts of the model that are trusted to a standard deviation of their own, and no further.
    pub fn groups(&self) -> impl Iterator<Item = (&Custom, GroupTerms)> {
        self.customs.iter().filter_map(|custom| Some((custom, custom.group.filter(|group| group.std > 0.0)?)))
    }

    /// What a relative change of each group does to K and M, group by group; `here` is this structure, assembled.
    pub fn group_changes(&self, here: &Assembly) -> Vec<Change> {
        let factors = self.factors();
        // A base under matrices gives way last, whatever was added to K.
        let reshapes = self.reshapes() || matches!(self.body, Body::Matrices(_)) && !self.base().is_none();
        let change = |(group, _): (&Custom, GroupTerms)| {
            if let Some(change) = group.constant_change(&factors).filter(|_| !reshapes) {
                return change;
            }
            let mut there = self.clone();
            there.push(Arc::new(group.times(STEP)));
            let nothing = || Change::local(0, DMatrix::zeros(0, 0), true);
            here.change_to(&there.assemble(), STEP).unwrap_or_else(nothing)
        };
        self.groups().map(change).collect()
    }

    /// How much there is of a hypothesis or group of the user's own by all that contributes so far.
    pub(super) fn amount_of(&self, name: &str) -> f64 {
        let amounts = self.contributions.iter().filter_map(|contribution| contribution.amount_of());
        amounts.filter(|(other, _)| *other == name).map(|(_, amount)| amount).sum()
    }

    /// Whether K as a whole follows from what is added to it: in a model of storeys, as beams carry out the same segment by segment.
    fn reshapes(&self) -> bool {
        matches!(self.body, Body::Matrices(_)) && self.contributions.iter().any(|contribution| contribution.reshapes())
    }

    /// How many contributions are dampers.
    pub fn dampers(&self) -> usize {
        self.contributions.iter().filter(|contribution| contribution.is_damper()).count()
    }

    /// Frequencies in Hz at which something drives the structure: lines there are no modes.
    pub fn forced_hz(&self) -> impl Iterator<Item = f64> + '_ {
        self.contributions.iter().filter_map(|contribution| contribution.forced_hz())
    }

    /// Number of degrees of freedom of the body.
    pub fn dofs(&self) -> usize {
        match &self.body {
            Body::Beam(beam) => beam.segments().len() * DOFS_A_NODE,
            Body::Matrices(matrices) => matrices.stiffness.nrows(),
        }
    }

    /// Heights of base and top in m; `None` where the body is no line.
    pub fn z_range_m(&self) -> Option<[f64; 2]> {
        match &self.body {
            Body::Beam(beam) => Some([beam.z_base_m(), beam.z_top_m()]),
            Body::Matrices(matrices) => {
                matrices.is_line().then_some(())?;
                let (first, last) = (matrices.nodes.first()?, matrices.nodes.last()?);
                Some([first.position_m[2], last.position_m[2]])
            }
        }
    }

    /// Whether sections rotate about X or Y: those of a beam, or nodes of matrices that have rows for it.
    pub(super) fn has_rotations(&self) -> bool {
        match &self.body {
            Body::Beam(_) => true,
            Body::Matrices(matrices) => {
                matrices.nodes.iter().any(|node| node.rows[2].is_some() || node.rows[3].is_some())
            }
        }
    }

    /// Whether an effect changes K, M or C; faults of sensors and clocks, forced lines and trends do not.
    ///
    /// # Errors
    /// Where the structure cannot have the effect.
    pub fn is_changed_by(&self, effect: &Effect) -> Result<bool, EffectError> {
        let (without, with) = (self.assemble(), self.clone().and(std::slice::from_ref(effect))?.assemble());
        Ok(with.dofs() != without.dofs() || without.change_to(&with, 1.0).is_some())
    }

    /// Where the degrees of freedom of the body stand, lowest first: a beam's base, whose rows are left out, then five rows a node. Empty
    /// where nothing is known of them.
    pub fn layout(&self) -> Vec<LayoutNode> {
        let beam = match &self.body {
            Body::Beam(beam) => beam,
            Body::Matrices(matrices) => return matrices.nodes.clone(),
        };
        let heights_m = std::iter::once(beam.z_base_m()).chain(beam.segments().iter().map(|segment| segment.z_top_m));
        let node = |(index, z_m): (usize, f64)| {
            let above_base = index.checked_sub(1);
            let row = |dof: usize| above_base.filter(|_| dof < DOFS_A_NODE).map(|node| node * DOFS_A_NODE + dof);
            LayoutNode {
                name: (index + 1).to_string(),
                position_m: [0.0, 0.0, z_m],
                rows: std::array::from_fn(row),
                fixed: std::array::from_fn(|dof| above_base.is_none() && dof < DOFS_A_NODE),
            }
        };
        heights_m.enumerate().map(node).collect()
    }

    /// What the rows are called, where sensors name them; else empty.
    pub fn row_names(&self) -> &[String] {
        match &self.body {
            Body::Beam(_) => &[],
            Body::Matrices(matrices) => &matrices.places,
        }
    }

    /// The segments of a beam with all changes, base first; `None` for matrices.
    pub fn segments(&self) -> Option<Vec<Segment>> {
        let Body::Beam(beam) = &self.body else { return None };
        let mut segments = beam.segments().to_vec();
        for contribution in &self.contributions {
            contribution.change_segments(&mut segments);
        }
        Some(segments)
    }

    /// K and M, in the phases of [`Contribution`]. A beam has five DOFs a node, base first and left out.
    pub fn assemble(&self) -> Assembly {
        let mut assembly = match (&self.body, self.segments()) {
            (Body::Matrices(matrices), _) => {
                let mut assembly = Assembly::of_matrices(matrices);
                let arms = upright(assembly.node_rows(), self.coupled_shear_m());
                carry(&mut assembly.stiffness, &arms);
                assembly
            }
            (Body::Beam(_), segments) => self.beam(segments.unwrap_or_default()),
        };
        for contribution in &self.contributions {
            contribution.rearrange(&mut assembly);
        }
        for contribution in &self.contributions {
            contribution.attach(&mut assembly);
        }
        for contribution in &self.contributions {
            contribution.add_matrices(&mut assembly);
        }
        let factors = self.factors();
        if self.reshapes() {
            let storeys = Storeys::within(&assembly);
            for contribution in &self.contributions {
                contribution.reshape(&storeys, &mut assembly, &factors);
            }
        }
        let base = self.base();
        if matches!(self.body, Body::Matrices(_)) && !base.is_none() {
            assembly.stand_on(&base);
        }
        if factors != Factors::default() {
            assembly.stiffness *= factors.stiffness;
            assembly.mass *= factors.mass;
        }
        for contribution in &self.contributions {
            contribution.hang(&mut assembly);
        }
        let distortions = self.contributions.iter().map(|contribution| contribution.distortion());
        assembly.distortion = distortions.fold(Distortion::default(), Add::add);
        assembly.sensing = Sensing::of(self.contributions.iter().filter_map(|one| one.sensor_change()));
        assembly
    }

    /// K and M with all changes in the rows of the files that a reduced model was read from; `None` where the model is not reduced.
    pub fn whole_matrices(&self) -> Option<WholeMatrices> {
        let Body::Matrices(matrices) = &self.body else { return None };
        let mut whole = matrices.whole.as_deref()?.clone();
        for contribution in &self.contributions {
            contribution.add_to_whole(&mut whole);
        }
        let factors = self.factors();
        whole.stiffness *= factors.stiffness;
        whole.mass *= factors.mass;
        Some(whole)
    }

    /// A beam with all masses at its nodes.
    fn beam(&self, segments: Vec<Segment>) -> Assembly {
        let nodes = segments.len() + 1;
        let mut whole = DMatrix::zeros(nodes * DOFS_A_NODE, nodes * DOFS_A_NODE);
        let mut kinks = Vec::new();
        for (index, (segment, compression)) in segments.iter().zip(self.compressions(&segments)).enumerate() {
            let element = self.element(segment.clone(), compression);
            scatter(&mut whole, &element.stiffness, index);
            kinks.push(element.kinks);
        }
        let (stiffness, base_motion) = self.base().condense(&whole);
        Assembly::of_beam(segments, stiffness, kinks, base_motion)
    }

    fn element(&self, segment: Segment, compression: Compression) -> Element {
        let mut element = Element::of(segment);
        element.raise(self.coupled_shear_m());
        for contribution in &self.contributions {
            contribution.soften(&mut element);
        }
        element.stand_beside(self.frames_n());
        element.compress(compression);
        element
    }

    /// The compression of each segment: that of what stands above its middle.
    fn compressions(&self, segments: &[Segment]) -> Vec<Compression> {
        let factors = self.factors();
        let attached_above_kg = |z_m: f64| -> f64 {
            let attached = self.contributions.iter().filter_map(|contribution| contribution.attached_mass());
            attached.filter(|mass| mass.z_m > z_m).map(|mass| mass.mass_kg).sum()
        };
        let mut compressions = vec![Compression::default(); segments.len()];
        let (mut table_kg, mut polar_kg_m2) = (0.0, 0.0);
        for (compression, segment) in compressions.iter_mut().zip(segments).rev() {
            table_kg += segment.mass_top_kg;
            polar_kg_m2 += segment.inertia_kg_m2[2];
            let middle_m = 0.5 * (segment.z_bottom_m + segment.z_top_m);
            let above = MassAbove { mass_kg: table_kg + attached_above_kg(middle_m), polar_kg_m2, factors };
            *compression = self.contributions.iter().map(|contribution| contribution.compression(&above)).sum();
        }
        compressions
    }

    /// The springs under the base. K of the beam and what hangs on it is multiplied with a factor afterwards; soil does not get
    /// stiffer with the modulus of the structure, so springs are as much softer before.
    fn base(&self) -> BaseFlexibility {
        let mut base = BaseFlexibility::default();
        for contribution in &self.contributions {
            base.add(&contribution.base_flexibility());
        }
        base.times(self.factors().stiffness)
    }

    fn factors(&self) -> Factors {
        let product = |product: Factors, factors: Factors| Factors {
            stiffness: product.stiffness * factors.stiffness,
            mass: product.mass * factors.mass,
        };
        self.contributions.iter().map(|contribution| contribution.factors()).fold(Factors::default(), product)
    }

    fn coupled_shear_m(&self) -> [f64; 2] {
        sum(self.contributions.iter().map(|contribution| contribution.coupled_shear_m()))
    }

    fn frames_n(&self) -> [f64; 2] {
        sum(self.contributions.iter().map(|contribution| contribution.frames_n()))
    }

    /// What spreading all masses adds to M; zero for matrices.
    pub fn spread_change(&self) -> Change {
        let Some(segments) = self.segments() else { return Change::local(0, DMatrix::zeros(0, 0), false) };
        let spread = spread(&self.beam(segments));
        Change::of(&DMatrix::zeros(spread.nrows(), spread.ncols()), &(spread * self.factors().mass), None)
    }

    /// What a relative change of each stiffness of each segment does to K, and one of its mass to M, segment by segment; empty for
    /// matrices.
    ///
    /// Exact but for the weight of a segment's mass on those below, a change of a change.
    pub fn segment_changes(&self) -> Vec<SegmentChange> {
        let Some(segments) = self.segments() else { return Vec::new() };
        let (base, factors) = (self.base(), self.factors());
        let compressions = self.compressions(&segments);
        let element = |index: usize, stiffness: Stiffness, factor: f64| {
            let mut segment = segments[index].clone();
            segment.scale(stiffness, factor);
            self.element(segment, compressions[index]).stiffness
        };
        let slope = |index: usize, stiffness: Stiffness| {
            (element(index, stiffness, 1.0 + STEP) - element(index, stiffness, 1.0 - STEP)) / (2.0 * STEP)
        };
        // The lowest segment acts through the base as well; condensed, its change is that of the corner of K.
        let corner = |stiffness: Stiffness, factor: f64| {
            let mut whole = DMatrix::zeros(2 * DOFS_A_NODE, 2 * DOFS_A_NODE);
            scatter(&mut whole, &element(0, stiffness, factor), 0);
            let motion = base.motion(&whole);
            let base_free = whole.view((0, DOFS_A_NODE), (DOFS_A_NODE, DOFS_A_NODE)).into_owned();
            whole.view((DOFS_A_NODE, DOFS_A_NODE), (DOFS_A_NODE, DOFS_A_NODE)).into_owned() + base_free.tr_mul(&motion)
        };
        let mut changes = Vec::new();
        for (index, segment) in segments.iter().enumerate() {
            let stiffness = |stiffness: Stiffness| {
                let (first_row, part) = match index {
                    0 => (0, (corner(stiffness, 1.0 + STEP) - corner(stiffness, 1.0 - STEP)) / (2.0 * STEP)),
                    _ => {
                        let slope = slope(index, stiffness);
                        let part = DMatrix::from_column_slice(DOFS_A_SEGMENT, DOFS_A_SEGMENT, slope.as_slice());
                        ((index - 1) * DOFS_A_NODE, part)
                    }
                };
                Change::local(first_row, part * factors.stiffness, true)
            };
            let mass = DMatrix::from_diagonal(&DVector::from_column_slice(&segment.lumped_mass()));
            changes.push(SegmentChange {
                stiffness: Stiffness::ALL.map(stiffness),
                mass: Change::local(index * DOFS_A_NODE, mass * factors.mass, false),
            });
        }
        changes
    }
}

/// Of what contributions say for X and Y.
fn sum(of_all: impl Iterator<Item = [f64; 2]>) -> [f64; 2] {
    of_all.fold([0.0; 2], |[x, y], [more_x, more_y]| [x + more_x, y + more_y])
}

/// What a relative change of one segment does to K and M.
#[derive(Debug, Clone)]
pub struct SegmentChange {
    /// Each of its stiffnesses, in the order of [`Stiffness::ALL`].
    pub stiffness: [Change; Stiffness::ALL.len()],
    /// Its mass.
    pub mass: Change,
}

/// K is linear in a segment's stiffness, but for a flexible base or a joint, where it is smooth.
const STEP: f64 = 1e-3;
