//! A beam element by its flexibility: a cantilever's tip deflections under tip loads, inverted, with rigid-body motion put back.
//!
//! Bending, shear and a rotational joint anywhere inside simply add up as flexibilities, so that the element is exact for
//! end loads (Przemieniecki, "Theory of Matrix Structural Analysis", section 5.6).

use nalgebra::{Matrix2, Matrix4, Matrix4x2, RowVector4};

/// One plane of an element: DOFs are deflection and slope at the bottom, then at the top.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    pub(super) length_m: f64,
    pub(super) bending_n_m2: f64,
    /// 1/kGA.
    pub(super) shear_compliance_per_n: f64,
    /// Heights of rotational joints above the bottom, and their flexibilities in rad/(N m).
    pub(super) joint: Option<(f64, f64)>,
}

impl Plane {
    /// Tip deflection and slope under a unit tip force and a unit tip moment.
    fn flexibility(&self) -> Matrix2<f64> {
        let (l, ei) = (self.length_m, self.bending_n_m2);
        let cross = l * l / (2.0 * ei);
        let bent = Matrix2::new(l.powi(3) / (3.0 * ei) + self.shear_compliance_per_n * l, cross, cross, l / ei);
        match self.joint {
            Some((at, flexibility)) => {
                let arm = l - at;
                bent + flexibility * Matrix2::new(arm * arm, arm, arm, 1.0)
            }
            None => bent,
        }
    }

    /// Forces at both ends from the tip's force and moment: the bottom's balance them.
    fn equilibrium(&self) -> Matrix4x2<f64> {
        Matrix4x2::new(-1.0, 0.0, -self.length_m, -1.0, 1.0, 0.0, 0.0, 1.0)
    }

    /// Tip force and moment from the DOFs.
    fn tip_loads(&self) -> nalgebra::Matrix2x4<f64> {
        let flexibility = self.flexibility();
        let stiffness = flexibility.try_inverse().unwrap_or_else(Matrix2::zeros);
        stiffness * self.equilibrium().transpose()
    }

    pub(super) fn stiffness(&self) -> Matrix4<f64> {
        self.equilibrium() * self.tip_loads()
    }

    /// The deflection at a height above the bottom as a sum over the DOFs.
    pub(super) fn deflection(&self, height_m: f64) -> RowVector4<f64> {
        let (l, ei, x) = (self.length_m, self.bending_n_m2, height_m);
        let force = x * x * (3.0 * l - x) / (6.0 * ei) + self.shear_compliance_per_n * x;
        let moment = x * x / (2.0 * ei);
        let tip = self.tip_loads();
        let mut row = RowVector4::new(1.0, x, 0.0, 0.0) + tip.row(0) * force + tip.row(1) * moment;
        if let Some((at, flexibility)) = self.joint
            && x > at
        {
            row += (tip.row(0) * (l - at) + tip.row(1)) * (flexibility * (x - at));
        }
        row
    }

    /// The slope of the deflection at a height above the bottom; at a joint it jumps.
    fn slope(&self, height_m: f64) -> RowVector4<f64> {
        let (l, ei, x) = (self.length_m, self.bending_n_m2, height_m);
        let force = x * (2.0 * l - x) / (2.0 * ei) + self.shear_compliance_per_n;
        let tip = self.tip_loads();
        let mut row = RowVector4::new(0.0, 1.0, 0.0, 0.0) + tip.row(0) * force + tip.row(1) * (x / ei);
        if let Some((at, flexibility)) = self.joint
            && x > at
        {
            row += (tip.row(0) * (l - at) + tip.row(1)) * flexibility;
        }
        row
    }

    /// What a compressive force takes from the stiffness: its work in the slopes, by Gauss's rule, which is exact for them.
    pub(super) fn geometric(&self, compression_n: f64) -> Matrix4<f64> {
        let at = self.joint.map_or(self.length_m, |(at, _)| at);
        let over = |[from, to]: [f64; 2]| {
            let (half, middle) = (0.5 * (to - from), 0.5 * (to + from));
            let point = |(x, weight): (f64, f64)| {
                let slope = self.slope(middle + half * x);
                slope.transpose() * slope * (weight * half)
            };
            let outer = 0.6_f64.sqrt();
            [(-outer, 5.0 / 9.0), (0.0, 8.0 / 9.0), (outer, 5.0 / 9.0)].map(point).into_iter().sum::<Matrix4<f64>>()
        };
        (over([0.0, at]) + over([at, self.length_m])) * compression_n
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stiffness_is_the_textbook_timoshenko_element() {
        let (l, ei, kga) = (3.0, 7.0, 11.0);
        let plane = Plane { length_m: l, bending_n_m2: ei, shear_compliance_per_n: 1.0 / kga, joint: None };
        let phi = 12.0 * ei / (kga * l * l);
        let (a, b, c, d) = (12.0, 6.0 * l, (4.0 + phi) * l * l, (2.0 - phi) * l * l);
        let book =
            Matrix4::new(a, b, -a, b, b, c, -b, d, -a, -b, a, -b, b, d, -b, c) * (ei / (l.powi(3) * (1.0 + phi)));
        assert!((plane.stiffness() - book).amax() < 1e-12);
    }

    #[test]
    fn compression_takes_what_the_textbook_says_in_bending_and_leans_links_in_shear() {
        let l = 3.0;
        let geometric = |bending_n_m2: f64, shear_compliance_per_n: f64| {
            Plane { length_m: l, bending_n_m2, shear_compliance_per_n, joint: None }.geometric(30.0 * l)
        };
        let (a, b, c, d) = (36.0, 3.0 * l, 4.0 * l * l, l * l);
        let book = Matrix4::new(a, b, -a, b, b, c, -b, -d, -a, -b, a, -b, b, -d, -b, c);
        assert!((geometric(7.0, 0.0) - book).amax() < 1e-9);
        let sheared = geometric(7e9, 1.0);
        assert!((sheared[(0, 0)] - 30.0).abs() < 1e-6 && sheared[(0, 1)].abs() < 1e-6, "{sheared}");
    }

    #[test]
    fn inner_deflections_end_at_the_nodes_and_joints_kink() {
        let plane = Plane { length_m: 2.0, bending_n_m2: 5.0, shear_compliance_per_n: 0.1, joint: Some((0.5, 3.0)) };
        assert!((plane.deflection(0.0) - RowVector4::new(1.0, 0.0, 0.0, 0.0)).amax() < 1e-12);
        assert!((plane.deflection(2.0) - RowVector4::new(0.0, 0.0, 1.0, 0.0)).amax() < 1e-12);
        // Rigid motion bends nothing, joint or not.
        let rigid = nalgebra::Vector4::new(0.0, 1.0, 2.0, 1.0);
        assert!((plane.stiffness() * rigid).amax() < 1e-12);
        assert!(((plane.deflection(1.2) * rigid)[0] - 1.2).abs() < 1e-12);
    }
}
