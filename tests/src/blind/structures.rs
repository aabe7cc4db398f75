//! The three structures of the bench, as their studies describe them: a broadcasting tower, a concrete chimney, a building.
//!
//! The tower's table is the template's, its sensors those of the benchmark; the other two are written here from continuous profiles.

use std::f64::consts::PI;
use std::path::Path;

use super::table::{Channel, Segment, read_channels, read_segments};

/// Names of the structures, in the order in which cases take turns.
pub(super) const NAMES: [&str; 3] = ["tower", "chimney", "shear-building"];

/// A structure as its study knows it.
#[derive(Debug, Clone)]
pub struct Structure {
    /// Its name.
    pub name: &'static str,
    pub(super) segments: Vec<Segment>,
    pub(super) channels: Vec<Channel>,
    pub(super) band_hz: [f64; 2],
    pub(super) sampling_rate_hz: f64,
}

impl Structure {
    /// One of the three.
    ///
    /// # Errors
    /// For an unknown name, or where the tower's files cannot be read.
    pub fn named(name: &str) -> Result<Self, String> {
        match name {
            "tower" => tower(),
            "chimney" => Ok(chimney()),
            "shear-building" => Ok(shear_building()),
            _ => Err(format!("there is no structure {name}; there are {}", NAMES.join(", "))),
        }
    }

    pub(super) fn base_m(&self) -> f64 {
        self.segments.first().map_or(0.0, |segment| segment.z_bottom_m)
    }

    pub(super) fn height_m(&self) -> f64 {
        self.segments.last().map_or(0.0, |segment| segment.z_top_m) - self.base_m()
    }

    pub(super) fn total_mass_kg(&self) -> f64 {
        self.segments.iter().map(|segment| segment.mass_top_kg).sum()
    }

    /// Over which the scatter is alike, and which the study states.
    pub(super) fn correlation_length_m(&self) -> f64 {
        (self.height_m() / 6.0).round()
    }

    /// The segment that holds a height.
    pub(super) fn segment_at(&self, z_m: f64) -> usize {
        self.segments.iter().position(|segment| z_m < segment.z_top_m).unwrap_or(self.segments.len() - 1)
    }
}

fn tower() -> Result<Structure, String> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../host/templates/canton"));
    Ok(Structure {
        name: "tower",
        segments: read_segments(&folder.join("beam.csv"))?,
        channels: read_channels(&folder.join("channels.csv"))?,
        band_hz: [0.05, 1.5],
        sampling_rate_hz: 5.0,
    })
}

/// Segments of equal length from properties at mid-height and masses per metre, each node's from half a segment on both sides.
fn from_profile(
    count: usize,
    height_m: f64,
    stiffness: impl Fn(f64) -> Segment,
    mass_kg_m: impl Fn(f64) -> f64,
    inertia_kg_m2: impl Fn(f64, f64) -> [f64; 3],
) -> Vec<Segment> {
    let length = height_m / count as f64;
    (0..count)
        .map(|at| {
            let (z_bottom_m, z_top_m) = (length * at as f64, length * (at + 1) as f64);
            let tributary = if at + 1 == count { 0.5 } else { 1.0 } * length;
            let mass_top_kg = (mass_kg_m(z_top_m) * tributary).round();
            let inertia_kg_m2 = inertia_kg_m2(z_top_m, mass_top_kg);
            Segment { z_bottom_m, z_top_m, mass_top_kg, inertia_kg_m2, ..stiffness(0.5 * (z_bottom_m + z_top_m)) }
        })
        .collect()
}

/// Reinforced concrete, 180 m, nearly axisymmetric: openings make one direction 6 % stiffer.
fn chimney() -> Structure {
    const HEIGHT_M: f64 = 180.0;
    let radius = |z: f64| 7.0 - 3.0 * z / HEIGHT_M;
    let thickness = |z: f64| 0.5 - 0.28 * z / HEIGHT_M;
    let (young, shear_modulus) = (32e9, 13.3e9);
    let area = move |z: f64| 2.0 * PI * radius(z) * thickness(z);
    let stiffness = move |z: f64| {
        let bending = young * PI * radius(z).powi(3) * thickness(z);
        // A thin ring's shear coefficient is one half (Cowper 1966).
        let shear = 0.5 * shear_modulus * area(z);
        Segment {
            z_bottom_m: 0.0,
            z_top_m: 0.0,
            bending_n_m2: [bending, 1.06 * bending],
            axis_deg: 25.0,
            shear_n: [shear; 2],
            torsion_n_m2: shear_modulus * 2.0 * PI * radius(z).powi(3) * thickness(z),
            mass_top_kg: 0.0,
            inertia_kg_m2: [0.0; 3],
        }
    };
    // The lining adds a fifth.
    let mass = move |z: f64| 1.2 * 2500.0 * area(z);
    let inertia = move |z: f64, mass: f64| {
        let squared = radius(z).powi(2);
        let rotary = mass * (squared / 2.0 + 6.0 * 6.0 / 12.0);
        [rotary, rotary, mass * squared]
    };
    let mut channels = Vec::new();
    for (level, z) in [30.0, 60.0, 90.0, 120.0, 150.0, 180.0].into_iter().enumerate() {
        let mut add = |azimuth_deg, offset_m| {
            channels.push(Channel { node: level + 1, elevation_m: z, azimuth_deg, offset_m });
        };
        add(0.0, [radius(z), 0.0]);
        add(90.0, [0.0, radius(z)]);
        // Along the circumference, where torsion moves them.
        if level == 4 {
            add(0.0, [0.0, radius(z)]);
            add(0.0, [0.0, -radius(z)]);
        }
    }
    Structure {
        name: "chimney",
        segments: from_profile(30, HEIGHT_M, stiffness, mass, inertia),
        channels,
        band_hz: [0.1, 5.0],
        sampling_rate_hz: 16.0,
    }
}

/// Twenty-four storeys of 3.5 m, 30 m by 20 m in plan; frames that give by shear.
fn shear_building() -> Structure {
    const STOREYS: usize = 24;
    const HEIGHT_M: f64 = 84.0;
    let taper = |z: f64| 1.4 - 0.8 * z / HEIGHT_M;
    let stiffness = move |z: f64| Segment {
        z_bottom_m: 0.0,
        z_top_m: 0.0,
        bending_n_m2: [1.2e14 * taper(z), 0.8e14 * taper(z)],
        axis_deg: 0.0,
        shear_n: [5.6e9 * taper(z), 4.3e9 * taper(z)],
        torsion_n_m2: 1.05e12 * taper(z),
        mass_top_kg: 0.0,
        inertia_kg_m2: [0.0; 3],
    };
    let mass = |z: f64| 480e3 / 3.5 * (1.05 - 0.1 * z / HEIGHT_M);
    // A slab of 30 m (X) by 20 m (Y).
    let inertia = |_: f64, mass: f64| [mass * 400.0 / 12.0, mass * 900.0 / 12.0, mass * 1300.0 / 12.0];
    let mut channels = Vec::new();
    for (level, storey) in [4, 8, 12, 16, 20, 24].into_iter().enumerate() {
        let elevation_m = 3.5 * f64::from(storey);
        let mut add = |azimuth_deg, offset_m| {
            channels.push(Channel { node: level + 1, elevation_m, azimuth_deg, offset_m });
        };
        add(0.0, [0.0, -9.0]);
        add(0.0, [0.0, 9.0]);
        add(90.0, [14.0, 0.0]);
    }
    Structure {
        name: "shear-building",
        segments: from_profile(STOREYS, HEIGHT_M, stiffness, mass, inertia),
        channels,
        band_hz: [0.25, 5.0],
        sampling_rate_hz: 16.0,
    }
}
