//! Defects that no effect of the catalogue describes: a diagnosis should say that it knows none that fits.

use rand::{Rng, RngExt};

use super::body::{Attachment, Body};
use super::magnitude::Band;
use super::structures::Structure;
use super::world::SHIFT;

/// Their names.
pub(super) const NAMES: [&str; 4] = ["one-axis-bending", "jumping-storeys", "secondary-structure", "jumping-masses"];

/// Puts a defect into a structure; `None` where this draw cannot be seen.
pub(super) fn put(name: &str, sound: &Body, structure: &Structure, random: &mut impl Rng) -> Option<Body> {
    let mut body = sound.clone();
    let before = Band::of(sound, structure, None)?;
    match name {
        "jumping-masses" => {
            let factors: Vec<f64> = structure.segments.iter().map(|_| jumping(random)).collect();
            // A node goes with the segment below it.
            for (node, element) in body.nodes[1..].iter_mut().zip(&body.elements) {
                node.scale(factors[element.segment]);
            }
        }
        "one-axis-bending" => {
            let left = 1.0 - random.random_range(0.15..0.3);
            body.elements.iter_mut().for_each(|element| element.bending_n_m2[1] *= left);
        }
        "jumping-storeys" => {
            let factors: Vec<f64> = structure.segments.iter().map(|_| jumping(random)).collect();
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

/// As the table has it, or a quarter more or less.
fn jumping(random: &mut impl Rng) -> f64 {
    match (random.random_bool(0.5), random.random_bool(0.5)) {
        (false, _) => 1.0,
        (true, true) => 1.25,
        (true, false) => 0.75,
    }
}
