//! Defects that no effect of the catalogue describes: a diagnosis should say that it knows none that fits.

use rand::{Rng, RngExt};

use super::body::{Attachment, Body};
use super::magnitude::{Band, Reach, Wanted, sized};
use super::structures::Structure;
use super::world::SHIFT;

/// Their names.
pub(super) const NAMES: [&str; 4] = ["one-axis-bending", "jumping-storeys", "secondary-structure", "soil-springs"];

/// Puts a defect into a structure; `None` where this draw cannot be seen.
pub(super) fn put(name: &str, sound: &Body, structure: &Structure, random: &mut impl Rng) -> Option<Body> {
    let mut body = sound.clone();
    let before = Band::of(sound, structure, None)?;
    match name {
        "soil-springs" => {
            let below_m = structure.base_m() + 0.2 * structure.height_m();
            let nodes = (1..sound.nodes.len()).filter(|&node| sound.nodes[node].z_m < below_m);
            let springs = |size: f64| nodes.clone().flat_map(move |node| [(node, 0, size), (node, 1, size)]);
            let stiff = structure.total_mass_kg() * (std::f64::consts::TAU * before.frequencies_hz[0]).powi(2);
            let change = |body: &mut Body, size: f64| body.springs.extend(springs(size));
            let wanted = Wanted { bounds: [1e-4 * stiff, 1e3 * stiff], change: &change, by: Reach::Shift(SHIFT) };
            let size = sized(sound, structure, &wanted, random)?;
            change(&mut body, size);
            return Some(body);
        }
        "one-axis-bending" => {
            let left = 1.0 - random.random_range(0.15..0.3);
            body.elements.iter_mut().for_each(|element| element.bending_n_m2[1] *= left);
        }
        "jumping-storeys" => {
            let mut factors = vec![1.0; structure.segments.len()];
            for factor in &mut factors {
                if random.random_bool(0.5) {
                    *factor = if random.random_bool(0.5) { 1.25 } else { 0.75 };
                }
            }
            body.elements.iter_mut().for_each(|element| element.scale(factors[element.segment]));
        }
        "secondary-structure" => {
            let attachment = |azimuth_deg, frequency_hz| Attachment {
                z_m: structure.base_m() + 0.6 * structure.height_m(),
                azimuth_deg,
                mass_kg: 0.0,
                frequency_hz,
                damping_ratio: 0.005,
            };
            let mass_kg = structure.total_mass_kg() * random.random_range(0.08..0.15);
            let frequency_hz = before.frequencies_hz[random.random_range(0..4)] * random.random_range(0.9..1.1);
            let stiffer = random.random_range(1.0..1.2);
            for (azimuth_deg, hz) in [(0.0, frequency_hz), (90.0, frequency_hz * stiffer)] {
                body.attachments.push(Attachment { mass_kg, ..attachment(azimuth_deg, hz) });
            }
            return Some(body);
        }
        _ => return None,
    }
    let after = Band::of(&body, structure, Some(before.frequencies_hz.len()))?;
    (SHIFT[0]..SHIFT[1]).contains(&before.shift(&after)).then_some(body)
}
