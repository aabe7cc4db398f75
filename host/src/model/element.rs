//! The Timoshenko beam element: stiffness and shape functions of one segment, in local and global axes.
//!
//! Formulas after Przemieniecki (1968), "Theory of Matrix Structural Analysis", section 5.6, and Friedman and Kosmatka
//! (1993), "An improved two-node Timoshenko beam finite element", Computers & Structures 47. With an
//! infinite shear stiffness they are the cubic Hermite functions.

use nalgebra::{DMatrix, Matrix4, RowVector4, SMatrix};

use super::DOFS_A_NODE;
use super::beam::Segment;

/// Degrees of freedom of a segment: bottom node, then top node.
pub(super) const DOFS_A_SEGMENT: usize = 2 * DOFS_A_NODE;

/// Local DOFs of bending along local axis 1: deflection and its slope-like rotation at both ends.
const PLANE_1: [usize; 4] = [0, 3, 5, 8];
/// Local DOFs of bending along local axis 2.
const PLANE_2: [usize; 4] = [1, 2, 6, 7];

/// Signs that turn a plane's rotations into the right-handed ones: `r2 = +du1/dz` but `r1 = -du2/dz`.
const HANDEDNESS: [f64; 2] = [1.0, -1.0];

/// A compression along a segment's axis.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Compression {
    /// Its force in N.
    pub force_n: f64,
    /// Its force times the square of its distance from the axis, in N m²: forces that stand apart lean when the section turns.
    pub polar_n_m2: f64,
}

impl Compression {
    /// Whether it is none.
    fn is_none(&self) -> bool {
        self.force_n == 0.0 && self.polar_n_m2 == 0.0
    }
}

impl std::iter::Sum for Compression {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |sum, one| Self {
            force_n: sum.force_n + one.force_n,
            polar_n_m2: sum.polar_n_m2 + one.polar_n_m2,
        })
    }
}

/// Stiffness of a segment in global axes, 10 x 10 (bottom node, top node), N/m, N and N m.
pub(super) fn stiffness(segment: &Segment) -> SMatrix<f64, DOFS_A_SEGMENT, DOFS_A_SEGMENT> {
    let length = segment.length_m();
    let plane = |axis: usize| plane_stiffness(length, segment.bending_n_m2[axis], shear_ratio(segment, axis));
    from_planes(segment, [plane(0), plane(1)], segment.torsion_n_m2 / length)
}

/// Geometric stiffness of a segment under a compression, to be taken off its stiffness; `None` where there is no compression. In each
/// plane it is the integral of the force times the products of the deflections' slopes, consistent with shear; turning, it is the
/// force times the square of its distance from the axis over the length.
pub(super) fn geometric_stiffness(
    segment: &Segment,
    compression: Compression,
) -> Option<SMatrix<f64, DOFS_A_SEGMENT, DOFS_A_SEGMENT>> {
    if compression.is_none() {
        return None;
    }
    let length = segment.length_m();
    let plane = |axis: usize| plane_geometric(length, shear_ratio(segment, axis)) * compression.force_n;
    Some(from_planes(segment, [plane(0), plane(1)], compression.polar_n_m2 / length))
}

/// A segment's matrix in global axes from those of its two planes, by deflection and slope at both ends, and from torsion.
fn from_planes(
    segment: &Segment,
    planes: [Matrix4<f64>; 2],
    torsion: f64,
) -> SMatrix<f64, DOFS_A_SEGMENT, DOFS_A_SEGMENT> {
    let mut local = SMatrix::<f64, DOFS_A_SEGMENT, DOFS_A_SEGMENT>::zeros();
    for ((plane, dofs), hand) in planes.iter().zip([PLANE_1, PLANE_2]).zip(HANDEDNESS) {
        let sign = [1.0, hand, 1.0, hand];
        for (i, &row) in dofs.iter().enumerate() {
            for (j, &column) in dofs.iter().enumerate() {
                local[(row, column)] += sign[i] * plane[(i, j)] * sign[j];
            }
        }
    }
    for (row, column, sign) in [(4, 4, 1.0), (9, 9, 1.0), (4, 9, -1.0), (9, 4, -1.0)] {
        local[(row, column)] += sign * torsion;
    }
    let axes = Axes::at(segment.axis_deg);
    axes.turn_rows(&mut local);
    axes.turn_columns(&mut local);
    local
}

/// Motion of the beam axis at `z_m` within a segment, 5 x 10: rows `ux, uy, rx, ry, rz` there, columns the segment's
/// global DOFs. These are the static shapes of the unloaded element, so a lumped load at `z_m` acts through the
/// transpose without error in the nodal displacements.
pub(super) fn interpolation(segment: &Segment, z_m: f64) -> SMatrix<f64, DOFS_A_NODE, DOFS_A_SEGMENT> {
    let length = segment.length_m();
    let xi = ((z_m - segment.z_bottom_m) / length).clamp(0.0, 1.0);
    let mut local = SMatrix::<f64, DOFS_A_NODE, DOFS_A_SEGMENT>::zeros();
    for (axis, dofs) in [PLANE_1, PLANE_2].iter().enumerate() {
        let (deflection, rotation) = plane_shapes(length, shear_ratio(segment, axis), xi);
        let hand = HANDEDNESS[axis];
        let sign = [1.0, hand, 1.0, hand];
        for (i, &column) in dofs.iter().enumerate() {
            local[(dofs[0], column)] = deflection[i] * sign[i];
            local[(dofs[1], column)] = hand * rotation[i] * sign[i];
        }
    }
    local[(4, 4)] = 1.0 - xi;
    local[(4, 9)] = xi;
    let axes = Axes::at(segment.axis_deg);
    axes.turn_rows(&mut local);
    axes.turn_columns(&mut local);
    local
}

/// phi = 12 EI / (kGA L²), zero where the segment is rigid in shear.
fn shear_ratio(segment: &Segment, axis: usize) -> f64 {
    let length = segment.length_m();
    segment.shear_n[axis].map_or(0.0, |shear| 12.0 * segment.bending_n_m2[axis] / (shear * length * length))
}

/// Przemieniecki eq. 5.116, one plane: deflection and slope at the bottom, then at the top.
fn plane_stiffness(length: f64, bending: f64, phi: f64) -> Matrix4<f64> {
    let (l, l2) = (length, length * length);
    #[rustfmt::skip]
    let k = Matrix4::new(
         12.0,        6.0 * l, -12.0,        6.0 * l,
        6.0 * l, (4.0 + phi) * l2, -6.0 * l, (2.0 - phi) * l2,
        -12.0,       -6.0 * l,  12.0,       -6.0 * l,
        6.0 * l, (2.0 - phi) * l2, -6.0 * l, (4.0 + phi) * l2,
    );
    k * (bending / (length * l2 * (1.0 + phi)))
}

/// One plane under a unit compression: the integral of the products of the slopes of Friedman and Kosmatka's deflections. Without shear
/// it is Przemieniecki's eq. 15.19; in shear alone the segment is straight, and leans like a link.
fn plane_geometric(length: f64, phi: f64) -> Matrix4<f64> {
    let (l, l2, square) = (length, length * length, phi * phi);
    let a = 6.0 / 5.0 + 2.0 * phi + square;
    let b = l / 10.0;
    let c = l2 * (2.0 / 15.0 + phi / 6.0 + square / 12.0);
    let d = l2 * (1.0 / 30.0 + phi / 6.0 + square / 12.0);
    #[rustfmt::skip]
    let k = Matrix4::new(
         a,  b, -a,  b,
         b,  c, -b, -d,
        -a, -b,  a, -b,
         b, -d, -b,  c,
    );
    k / (length * (1.0 + phi) * (1.0 + phi))
}

/// Friedman and Kosmatka's shape functions: deflection and rotation at xi in 0 to 1, from the end values.
fn plane_shapes(length: f64, phi: f64, xi: f64) -> (RowVector4<f64>, RowVector4<f64>) {
    let (l, x, x2, x3) = (length, xi, xi * xi, xi * xi * xi);
    let deflection = RowVector4::new(
        2.0 * x3 - 3.0 * x2 - phi * x + 1.0 + phi,
        l * (x3 - (2.0 + phi / 2.0) * x2 + (1.0 + phi / 2.0) * x),
        -(2.0 * x3 - 3.0 * x2 - phi * x),
        l * (x3 - (1.0 - phi / 2.0) * x2 - phi / 2.0 * x),
    );
    let rotation = RowVector4::new(
        6.0 / l * (x2 - x),
        3.0 * x2 - (4.0 + phi) * x + 1.0 + phi,
        -6.0 / l * (x2 - x),
        3.0 * x2 - (2.0 - phi) * x,
    );
    (deflection / (1.0 + phi), rotation / (1.0 + phi))
}

/// Local axes in plan. Motions and rotations of a node are turned pair by pair: products with a 10 x 10 matrix of rotations, nearly
/// all of it zeros, took half of the time in which matrices are assembled.
struct Axes {
    sin: f64,
    cos: f64,
}

impl Axes {
    fn at(axis_deg: f64) -> Self {
        let (sin, cos) = axis_deg.to_radians().sin_cos();
        Self { sin, cos }
    }

    /// The first of each pair `[ux, uy]`, `[rx, ry]` among the DOFs of one node or two.
    fn pairs(dofs: usize) -> impl Iterator<Item = usize> {
        (0..dofs).step_by(DOFS_A_NODE).flat_map(|node| [node, node + 2])
    }

    /// The global components of what the rows give in local ones.
    fn turn_rows<const R: usize, const C: usize>(&self, matrix: &mut SMatrix<f64, R, C>) {
        for mut column in matrix.column_iter_mut() {
            for first in Self::pairs(R) {
                [column[first], column[first + 1]] = self.turned(column[first], column[first + 1]);
            }
        }
    }

    /// From a matrix by local DOFs to one by global DOFs.
    fn turn_columns<const R: usize, const C: usize>(&self, matrix: &mut SMatrix<f64, R, C>) {
        for row in 0..R {
            for first in Self::pairs(C) {
                [matrix[(row, first)], matrix[(row, first + 1)]] =
                    self.turned(matrix[(row, first)], matrix[(row, first + 1)]);
            }
        }
    }

    fn turned(&self, along_1: f64, along_2: f64) -> [f64; 2] {
        [self.cos * along_1 - self.sin * along_2, self.sin * along_1 + self.cos * along_2]
    }
}

/// Adds a segment's matrix into a matrix over all nodes, the base included; `segment` counts from 0.
pub(super) fn scatter(total: &mut DMatrix<f64>, part: &SMatrix<f64, DOFS_A_SEGMENT, DOFS_A_SEGMENT>, segment: usize) {
    let corner = segment * DOFS_A_NODE;
    let mut view = total.fixed_view_mut::<DOFS_A_SEGMENT, DOFS_A_SEGMENT>(corner, corner);
    view += part;
}
