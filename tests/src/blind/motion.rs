//! Motion under noise: damped modes driven by white forces, step by step, exactly. Velocities' differences flow out, channel by
//! channel, each at its own clock.
//!
//! Over a time d a state turns by exp(pole d) and gains a Gaussian whose covariances are `(exp((p + conj q) d) - 1)/(p + conj q)`
//! times those of the forces, for poles p and q (Gardiner, "Handbook of Stochastic Methods", section 4.4.6).

use nalgebra::{Complex, DMatrix, SymmetricEigen};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::banded::Modes;
use super::body::{Body, DOFS};
use super::damped::DampedMode;

/// Torsional moments relative to those that would drive torsion as hard as bending.
const TORSION: f64 = 0.3;

/// The intensities of white forces on the undamped modes, modes x modes: independent noise on every node in X, Y and about Z, in
/// proportion to its mass. Uneven loads grow upwards, differ between X and Y and from node to node, so that modes are driven
/// together to some extent.
pub(super) fn modal_forces(body: &Body, modes: &Modes, uneven: bool, random: &mut impl Rng) -> DMatrix<f64> {
    let (_, mass) = body.matrices();
    // Accelerations of some 0.1 mm/s2.
    let level = 1e-5 * body.total_mass_kg().sqrt();
    let top_m = body.nodes.last().map_or(1.0, |node| node.z_m) - body.base_m();
    let [along_x, along_y] = [0; 2].map(|_| if uneven { random.random_range(0.7..1.3) } else { 1.0 });
    let mut loaded = DMatrix::zeros(mass.order(), modes.shapes.ncols());
    for (at, node) in body.nodes.iter().enumerate() {
        let height = (node.z_m - body.base_m()) / top_m;
        for (dof, share) in [(0, along_x), (1, along_y), (4, TORSION)] {
            let here = if uneven { (0.5 + height) * random.random_range(0.6..1.4) } else { 1.0 };
            let row = at * DOFS + dof;
            let strength = level * share * (mass.diagonal(row).max(0.0) * here).sqrt();
            loaded.row_mut(row).copy_from(&(modes.shapes.row(row) * strength));
        }
    }
    loaded.transpose() * &loaded
}

/// When channels are sampled: steps after the others, and the part of a step that remains.
pub(super) struct Clock {
    step_s: f64,
    pub(super) late: Vec<i64>,
    /// How long before a step's end late channels look; one for all of them.
    before_end_s: Option<f64>,
    is_late: Vec<bool>,
}

impl Clock {
    pub(super) fn of(body: &Body, rate: f64) -> Self {
        let delays = || body.sensors.iter().map(|sensor| sensor.delay_s * rate);
        let rest = delays().map(|steps| steps - steps.floor()).find(|rest| *rest > 0.0);
        Self {
            step_s: 1.0 / rate,
            late: delays().map(|steps| steps.floor() as i64).collect(),
            before_end_s: rest.map(|rest| rest / rate),
            is_late: delays().map(|steps| steps != steps.floor()).collect(),
        }
    }
}

/// What a stretch of time does to the states.
struct Stretch {
    turn: Vec<Complex<f64>>,
    /// From unit normals to the real parts of the states, then the imaginary ones.
    noise: DMatrix<f64>,
}

impl Stretch {
    fn new(poles: &[Complex<f64>], damped: &[DampedMode], forces: &DMatrix<f64>, duration_s: f64) -> Self {
        let count = poles.len();
        let input = DMatrix::from_fn(count, forces.nrows(), |mode, force| damped[mode].input[force]);
        let driven = &input * forces.map(Complex::from);
        let (hermitian, symmetric) = (&driven * input.adjoint(), &driven * input.transpose());
        let gathered = |pole: Complex<f64>| ((pole * duration_s).exp() - 1.0) / pole;
        let covariance = DMatrix::from_fn(2 * count, 2 * count, |i, j| {
            let (k, l) = (i % count, j % count);
            let p = hermitian[(k, l)] * gathered(poles[k] + poles[l].conj());
            let r = symmetric[(k, l)] * gathered(poles[k] + poles[l]);
            // For s = x + iy: P = E[s conj s'], R = E[s s'].
            0.5 * match (i < count, j < count) {
                (true, true) => (p + r).re,
                (false, false) => (p - r).re,
                (false, true) => (p + r).im,
                (true, false) => (r - p).im,
            }
        });
        let eigen = SymmetricEigen::new((&covariance + covariance.transpose()) * 0.5);
        let noise = DMatrix::from_fn(2 * count, 2 * count, |i, j| {
            eigen.eigenvectors[(i, j)] * eigen.eigenvalues[j].max(0.0).sqrt()
        });
        Self { turn: poles.iter().map(|pole| (pole * duration_s).exp()).collect(), noise }
    }

    fn normals(&self, steps: usize, random: &mut impl Rng) -> DMatrix<f64> {
        &self.noise * DMatrix::from_fn(self.noise.ncols(), steps, |_, _| StandardNormal.sample(random))
    }

    fn advance(&self, state: &mut [Complex<f64>], noise: &DMatrix<f64>, step: usize) {
        for (mode, state) in state.iter_mut().enumerate() {
            *state =
                self.turn[mode] * *state + Complex::new(noise[(mode, step)], noise[(mode + self.turn.len(), step)]);
        }
    }
}

/// The states, and what each step does.
pub(super) struct Motion {
    state: Vec<Complex<f64>>,
    /// One, or two where late channels look in between.
    stretches: Vec<Stretch>,
    /// To velocities: channels x damped modes, for the states' real and imaginary parts.
    output: [DMatrix<f64>; 2],
    velocity: Vec<f64>,
    is_late: Vec<bool>,
    step_s: f64,
}

impl Motion {
    /// At rest; `pace` scales the frequencies.
    pub(super) fn new(damped: &[DampedMode], forces: &DMatrix<f64>, clock: &Clock, pace: f64) -> Self {
        let mut motion = Self {
            state: vec![Complex::from(0.0); damped.len()],
            stretches: Vec::new(),
            output: [DMatrix::zeros(0, 0), DMatrix::zeros(0, 0)],
            velocity: vec![0.0; clock.late.len()],
            is_late: clock.is_late.clone(),
            step_s: clock.step_s,
        };
        motion.pace(damped, forces, clock, pace);
        motion
    }

    /// Goes on with other frequencies.
    pub(super) fn pace(&mut self, damped: &[DampedMode], forces: &DMatrix<f64>, clock: &Clock, pace: f64) {
        let poles: Vec<Complex<f64>> = damped.iter().map(|mode| mode.pole * pace).collect();
        let durations = match clock.before_end_s {
            Some(rest_s) => vec![clock.step_s - rest_s, rest_s],
            None => vec![clock.step_s],
        };
        let stretch = |duration_s| Stretch::new(&poles, damped, forces, duration_s);
        self.stretches = durations.into_iter().map(stretch).collect();
        // x' = 2 Re(shape pole s).
        let seen = |channel: usize, mode: usize| damped[mode].shape[channel] * poles[mode] * 2.0;
        let (channels, modes) = (clock.late.len(), damped.len());
        self.output = [
            DMatrix::from_fn(channels, modes, |i, j| seen(i, j).re),
            DMatrix::from_fn(channels, modes, |i, j| -seen(i, j).im),
        ];
    }

    /// Accelerations averaged over steps, channels x steps.
    pub(super) fn run(&mut self, steps: usize, random: &mut impl Rng) -> DMatrix<f64> {
        let noises: Vec<_> = self.stretches.iter().map(|stretch| stretch.normals(steps, random)).collect();
        let modes = self.state.len();
        // States where late channels look, and at the steps' ends.
        let mut seen = vec![[DMatrix::zeros(modes, steps), DMatrix::zeros(modes, steps)]; self.stretches.len()];
        for step in 0..steps {
            for ((stretch, noise), seen) in self.stretches.iter().zip(&noises).zip(&mut seen) {
                stretch.advance(&mut self.state, noise, step);
                for (mode, state) in self.state.iter().enumerate() {
                    (seen[0][(mode, step)], seen[1][(mode, step)]) = (state.re, state.im);
                }
            }
        }
        let velocities = seen.iter().map(|[re, im]| &self.output[0] * re + &self.output[1] * im);
        let velocities: Vec<DMatrix<f64>> = velocities.collect();
        DMatrix::from_fn(self.velocity.len(), steps, |channel, step| {
            let at = if self.is_late[channel] { 0 } else { velocities.len() - 1 };
            let now = velocities[at][(channel, step)];
            let before = std::mem::replace(&mut self.velocity[channel], now);
            (now - before) / self.step_s
        })
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// One mode of 0.7 Hz at 8 Hz, seen by a channel in time and by one that is late.
    fn one_mode(delay_steps: f64) -> DMatrix<f64> {
        let pole = Complex::new(-0.05, 4.4);
        let input = vec![Complex::new(0.0, 8.8).inv()];
        let damped = [DampedMode { pole, shape: vec![Complex::from(1.0); 2], input }];
        let clock = Clock {
            step_s: 0.125,
            late: vec![0, 0],
            before_end_s: Some(0.125 * delay_steps),
            is_late: vec![false, true],
        };
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut motion = Motion::new(&damped, &DMatrix::from_element(1, 1, 1.0), &clock, 1.0);
        motion.run(2000, &mut random);
        motion.run(400_000, &mut random)
    }

    #[test]
    fn a_mode_has_its_variance_and_its_peak() {
        let motion = one_mode(0.4);
        let samples: Vec<f64> = motion.row(0).iter().copied().collect();
        // The velocity's correlation is S/(4 zeta w) exp(-a t) (cos w t - a/w sin w t); a sample is a difference of two.
        let variance = samples.iter().map(|a| a * a).sum::<f64>() / samples.len() as f64;
        let later = 5.0 * (-0.05 * 0.125_f64).exp() * (0.55_f64.cos() - 0.05 / 4.4 * 0.55_f64.sin());
        let expected = 2.0 * (5.0 - later) / 0.125_f64.powi(2);
        // The record holds some 2500 independent stretches.
        assert!((variance / expected - 1.0).abs() < 0.06, "{variance}, not {expected}");
        let power = |omega: f64| -> f64 {
            let segments = samples.chunks_exact(2000);
            let line = |segment: &[f64]| {
                let sum: Complex<f64> = (segment.iter().enumerate())
                    .map(|(at, value)| Complex::from_polar(*value, omega * 0.125 * at as f64))
                    .sum();
                sum.norm_sqr()
            };
            segments.map(line).sum()
        };
        let peak = power(4.4);
        assert!(peak > 5.0 * power(4.2) && peak > 5.0 * power(4.6));
        // At half the bandwidth off, half the power.
        assert!((power(4.45) / peak - 0.5).abs() < 0.15, "{}", power(4.45) / peak);
    }

    #[test]
    fn a_late_clock_turns_the_phase() {
        let motion = one_mode(0.4);
        let turned: Complex<f64> = motion
            .row(0)
            .iter()
            .zip(motion.row(1).iter())
            .enumerate()
            .map(|(at, (a, b))| (at, a, b))
            .collect::<Vec<_>>()
            .chunks_exact(800)
            .map(|chunk| {
                let line = |late: bool| -> Complex<f64> {
                    let value = |&(at, a, b): &(usize, &f64, &f64)| (at, if late { *b } else { *a });
                    chunk.iter().map(value).map(|(at, v)| Complex::from_polar(v, -4.4 * 0.125 * at as f64)).sum()
                };
                line(true) * line(false).conj()
            })
            .sum();
        let expected = -4.4 * 0.125 * 0.4;
        assert!((turned.arg() / expected - 1.0).abs() < 0.03, "{} rad, not {expected}", turned.arg());
    }
}
