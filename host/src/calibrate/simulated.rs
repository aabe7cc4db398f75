//! A sensor that is tumbled, for tests: gains, offsets, directions, noise, and a table that is not level.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::still::{Cell, Face};

/// How the faces come to lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Tilts {
    /// The table is tilted, and the box is turned on it anyhow.
    OfTheTable,
    /// Each face by itself.
    OfEachFace,
}

/// A sensor and what it reads.
#[derive(Debug, Clone)]
pub(crate) struct Tumbled {
    /// What an axis reads of accelerations along X, Y and Z.
    pub(crate) sensitivity: [[f64; 3]; 3],
    /// In m/s².
    pub(crate) offset: [f64; 3],
    /// Gravity along X, Y and Z on each face.
    gravity: [[f64; 3]; 6],
    random: ChaCha8Rng,
}

/// Of the mean over a second: 22.5 µg/√Hz.
const NOISE_M_S2: f64 = 22.5e-6 * 9.81 * std::f64::consts::FRAC_1_SQRT_2;

impl Tumbled {
    /// Within what an ADXL355's data sheet allows, on faces that lie level to `level_deg` in each direction.
    pub(crate) fn new(seed: u64, gravity_m_s2: f64, level_deg: f64, tilts: Tilts) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let sensitivity = std::array::from_fn(|axis| {
            let own = random.random_range(0.92..1.08);
            std::array::from_fn(|other| if other == axis { own } else { own * 0.01 * normal(&mut random) })
        });
        let offset = [0; 3].map(|_| random.random_range(-0.7..0.7));
        let tilt = |random: &mut ChaCha8Rng| [0; 2].map(|_| level_deg.to_radians() * normal(random));
        let table = tilt(&mut random);
        let gravity = Face::ALL.map(|face| {
            let [a, b] = match tilts {
                Tilts::OfEachFace => tilt(&mut random),
                Tilts::OfTheTable => {
                    let (sine, cosine) = random.random_range(0.0..std::f64::consts::TAU).sin_cos();
                    [table[0] * cosine - table[1] * sine, table[0] * sine + table[1] * cosine]
                }
            };
            let size = a.hypot(b);
            let lateral = if size > 0.0 { size.sin() / size } else { 1.0 };
            let mut along = [0.0; 3];
            along[face.axis] = gravity_m_s2 * face.sign() * size.cos();
            along[(face.axis + 1) % 3] = gravity_m_s2 * lateral * a;
            along[(face.axis + 2) % 3] = gravity_m_s2 * lateral * b;
            along
        });
        Self { sensitivity, offset, gravity, random }
    }

    /// A second on a face.
    pub(crate) fn second(&mut self, face: usize) -> Cell {
        let gravity = self.gravity[face % 6];
        let mean_m_s2 = std::array::from_fn(|axis| {
            let read: f64 = self.sensitivity[axis].iter().zip(gravity).map(|(share, gravity)| share * gravity).sum();
            read + self.offset[axis] + NOISE_M_S2 * normal(&mut self.random)
        });
        Cell { seconds: 1.0, mean_m_s2, variance: [1.2e-5; 3] }
    }

    /// A row at 1000 Hz on a face: 22.5 µg/√Hz over the sensor's 250 Hz.
    pub(crate) fn reading(&mut self, face: usize) -> [f32; 3] {
        let mean = self.second(face).mean_m_s2;
        mean.map(|value| (value + 3.5e-3 * normal(&mut self.random)) as f32)
    }

    /// Twelve seconds on each face, and two in the hand before each.
    pub(crate) fn tumble(&mut self) -> Vec<Cell> {
        let in_hand = Cell { seconds: 1.0, mean_m_s2: [5.0, 5.0, 5.0], variance: [4.0; 3] };
        (0..6)
            .flat_map(|face| [in_hand; 2].into_iter().chain((0..12).map(|_| self.second(face)).collect::<Vec<_>>()))
            .collect()
    }
}

fn normal(random: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(random)
}
