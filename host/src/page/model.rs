//! The model as the page draws it: nodes, what joins them, and the motion of each in every mode; and its MAC with what was measured.

use nalgebra::DMatrix;
use serde::Serialize;

use crate::compare::{ModelView, Pair, mac, scale};
use crate::model::{Assembly, LayoutNode, Wireframe};
use crate::modes::MeasuredMode;

/// Modes that are drawn beyond the highest that has a partner.
pub(super) const MODES_BEYOND: usize = 2;
/// `rz` among a layout node's rows.
const RZ: usize = 4;
/// Points of a line that is drawn, so that few long segments look as they bend.
const POINTS: usize = 60;

/// A model, or a version of it.
#[derive(Debug, Clone, Serialize)]
pub struct ModelPart {
    /// Which: `given` or `effects`.
    pub name: &'static str,
    /// Where points of it stand, in m: X, Y, and Z up; a line's from its base up.
    pub nodes: Vec<[f64; 3]>,
    /// Which of them are joined.
    pub lines: Vec<[usize; 2]>,
    /// Which of them stand around a surface.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub surfaces: Vec<Vec<usize>>,
    /// Whether lines are those of a structure in space, not of one axis.
    pub is_spatial: bool,
    /// Its modes.
    pub modes: Vec<ModeMotion>,
}

/// A mode's motion.
#[derive(Debug, Clone, Serialize)]
pub struct ModeMotion {
    /// The mode's number in the model, from 1.
    pub number: usize,
    /// Its frequency in Hz.
    pub frequency_hz: f64,
    /// Along X, Y and Z, and turning about Z in rad, node by node; at the scale of the measured shape, where there is one, else the largest 1.
    pub motion: Vec<[f32; 4]>,
}

impl ModelPart {
    /// The modes that have a partner, those between, and a few more.
    pub fn of(
        name: &'static str,
        assembly: &Assembly,
        look: Look<'_>,
        view: &ModelView,
        pairs: &[Pair],
        measured: &[MeasuredMode],
    ) -> Self {
        let points = Points::of(assembly, look);
        let last = pairs.iter().map(|pair| pair.model + 1).max().unwrap_or(0) + MODES_BEYOND;
        let count = last.min(view.modes.frequency_hz.len());
        let motions = points.motions(assembly, &view.modes.shapes.columns(0, count).into_owned());
        let mode = |index: usize| {
            let motion = &motions[index];
            let pair = pairs.iter().find(|pair| pair.model == index);
            let shape = pair.and_then(|pair| measured.get(pair.measured)?.shape.as_ref());
            let largest =
                motion.iter().flat_map(|motion| &motion[..3]).fold(0.0_f64, |most, part| most.max(part.abs()));
            let as_measured = shape.map(|shape| scale(view.shape(index), shape)).filter(|factor| *factor != 0.0);
            let factor = as_measured.unwrap_or(if largest > 0.0 { 1.0 / largest } else { 1.0 });
            ModeMotion {
                number: index + 1,
                frequency_hz: view.modes.frequency_hz[index],
                // Drawn to a pixel.
                motion: motion.iter().map(|parts| parts.map(|part| (factor * part) as f32)).collect(),
            }
        };
        Self {
            name,
            modes: (0..count).map(mode).collect(),
            lines: points.lines(),
            surfaces: points.surfaces(),
            is_spatial: matches!(points, Points::Frame(_)),
            nodes: points.into_places(),
        }
    }
}

/// Where a model is drawn.
enum Points<'a> {
    /// A line: heights.
    Line(Vec<f64>),
    /// Nodes anywhere; nobody says what joins them.
    Space(&'a [LayoutNode]),
    /// Nodes anywhere, and what joins them.
    Frame(&'a Wireframe),
}

/// What a model looks like.
#[derive(Clone, Copy)]
pub struct Look<'a> {
    /// Where its nodes stand.
    pub layout: &'a [LayoutNode],
    /// What joins them, where the study says so.
    pub frame: Option<&'a Wireframe>,
}

impl<'a> Points<'a> {
    fn of(assembly: &Assembly, Look { layout, frame }: Look<'a>) -> Self {
        match frame {
            Some(frame) if !assembly.is_line() => return Self::Frame(frame),
            None if !assembly.is_line() => return Self::Space(layout),
            _ => {}
        }
        let mut heights_m = assembly.node_elevations_m();
        heights_m.insert(0, assembly.z_base_m());
        let (base_m, top_m) = (heights_m[0], heights_m.last().copied().unwrap_or(heights_m[0]));
        let step_m = (top_m - base_m) / POINTS as f64;
        // Between nodes that are far apart.
        let between = heights_m.windows(2).flat_map(|pair| {
            let pieces = if step_m > 0.0 { ((pair[1] - pair[0]) / step_m).round().max(1.0) as usize } else { 1 };
            (0..pieces).map(move |piece| pair[0] + (pair[1] - pair[0]) * piece as f64 / pieces as f64)
        });
        Self::Line(between.chain([top_m]).collect())
    }

    /// Point by point in each of these shapes over the degrees of freedom.
    fn motions(&self, assembly: &Assembly, shapes: &DMatrix<f64>) -> Vec<Vec<[f64; 4]>> {
        match self {
            Self::Line(heights_m) => {
                let along: Vec<DMatrix<f64>> =
                    heights_m.iter().map(|z_m| assembly.axis_motion(*z_m) * shapes).collect();
                let of = |mode: usize| {
                    let at = |motion: &DMatrix<f64>| [motion[(0, mode)], motion[(1, mode)], 0.0, motion[(4, mode)]];
                    along.iter().map(at).collect()
                };
                (0..shapes.ncols()).map(of).collect()
            }
            Self::Frame(frame) => {
                let motion = frame.motion(assembly, shapes);
                let of = |points: &[f64]| points.chunks_exact(3).map(|of| [of[0], of[1], of[2], 0.0]).collect();
                motion.column_iter().map(|column| of(column.as_slice())).collect()
            }
            Self::Space(nodes) => {
                let shapes = assembly.at_rows(shapes);
                let of = |mode: usize| {
                    let at = |row: Option<usize>| row.and_then(|row| shapes.get((row, mode))).copied().unwrap_or(0.0);
                    let parts = |node: &LayoutNode| {
                        let [x, y, z] = node.translations();
                        [x, y, z, node.rows[RZ]].map(at)
                    };
                    nodes.iter().map(parts).collect()
                };
                (0..shapes.ncols()).map(of).collect()
            }
        }
    }

    fn lines(&self) -> Vec<[usize; 2]> {
        match self {
            Self::Line(heights_m) => (1..heights_m.len()).map(|upper| [upper - 1, upper]).collect(),
            Self::Space(_) => Vec::new(),
            Self::Frame(frame) => frame.lines.clone(),
        }
    }

    fn surfaces(&self) -> Vec<Vec<usize>> {
        match self {
            Self::Frame(frame) => frame.surfaces.clone(),
            Self::Line(_) | Self::Space(_) => Vec::new(),
        }
    }

    fn into_places(self) -> Vec<[f64; 3]> {
        match self {
            Self::Line(heights_m) => heights_m.into_iter().map(|z_m| [0.0, 0.0, z_m]).collect(),
            Self::Space(nodes) => nodes.iter().map(|node| node.position_m).collect(),
            Self::Frame(frame) => frame.places_m.clone(),
        }
    }
}

/// MAC of measured modes with a model's.
#[derive(Debug, Clone, Serialize)]
pub struct MacMatrix {
    /// Of which model: `given`, `updated` or `effects`.
    pub what: &'static str,
    /// Numbers of the measured modes.
    pub measured: Vec<usize>,
    /// Numbers of the model's modes.
    pub model: Vec<usize>,
    /// A row a measured mode.
    pub values: Vec<Vec<f64>>,
}

impl MacMatrix {
    /// Of shapes at the sensors, each with its mode's number, with all measured modes whose shape is known; `None` where there is none.
    pub fn of<'a>(
        what: &'static str,
        shapes: impl Iterator<Item = (usize, &'a [f64])>,
        measured: &[MeasuredMode],
    ) -> Option<Self> {
        let (model, shapes): (Vec<usize>, Vec<&[f64]>) = shapes.unzip();
        let (numbers, values): (Vec<usize>, Vec<Vec<f64>>) = measured
            .iter()
            .filter_map(|mode| Some((mode.number, mode.shape.as_ref()?)))
            .map(|(number, shape)| (number, shapes.iter().map(|model| mac(model, shape)).collect()))
            .unzip();
        (!numbers.is_empty() && !model.is_empty()).then_some(Self { what, measured: numbers, model, values })
    }
}
