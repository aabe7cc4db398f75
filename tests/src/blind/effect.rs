//! The effects of the catalogue as the true structure has them, with the names and parameters of the reference's tables.
//!
//! A structure flows in and has the effect when it comes out; written anew from the definitions, not from belfry's code.

use super::body::{Attachment, Body};
use super::structures::Structure;
use super::table::channel_name;

/// Nodes below this share of the heaviest are a mast's, not the main body's.
const MAIN_BODY_SHARE: f64 = 0.05;

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Effect {
    StiffnessScale(f64),
    MassScale(f64),
    BaseRotation([f64; 2]),
    BaseTranslation([f64; 2]),
    ShearFlexibility(f64),
    RotaryInertia(f64),
    PDelta,
    AddedMass {
        z_m: f64,
        mass_kg: f64,
    },
    /// Segments from the first to the last, around z.
    StiffnessLoss {
        z_m: f64,
        segments: [usize; 2],
        relative: f64,
    },
    Connection {
        z_m: f64,
        flexibility: f64,
    },
    TunedMassDamper {
        z_m: f64,
        mass_kg: f64,
        frequency_hz: f64,
        damping_ratio: f64,
    },
    MassEccentricity([f64; 2]),
    AxisRotation(f64),
    Outrigger {
        z_m: f64,
        stiffness: f64,
    },
    /// Along X and Y.
    LateralSupport {
        z_m: f64,
        stiffness: [f64; 2],
    },
    /// Springs along X and Y from the base up to a height, in N/m on a metre.
    SoilSprings {
        z_m: f64,
        stiffness: [f64; 2],
    },
    SensorGain {
        channel: usize,
        factor: f64,
    },
    SensorPolarity(usize),
    SensorSwap([usize; 2]),
    /// Of one node's sensors, or of all.
    SensorRotation {
        node: Option<usize>,
        angle_deg: f64,
    },
    ClockOffset {
        node: usize,
        delay_s: f64,
    },
    Harmonic(f64),
    TemperatureStiffness(f64),
}

/// Where an effect is.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Place {
    /// Everywhere.
    Whole,
    /// At a height in m.
    Height(f64),
    /// At sensors, as belfry names them.
    Label(String),
    /// At a frequency in Hz.
    Frequency(f64),
}

impl Effect {
    pub(super) fn kind(&self) -> &'static str {
        match self {
            Self::StiffnessScale(_) => "stiffness-scale",
            Self::MassScale(_) => "mass-scale",
            Self::BaseRotation(_) => "base-rotation",
            Self::BaseTranslation(_) => "base-translation",
            Self::ShearFlexibility(_) => "shear-flexibility",
            Self::RotaryInertia(_) => "rotary-inertia",
            Self::PDelta => "p-delta",
            Self::AddedMass { .. } => "added-mass",
            Self::StiffnessLoss { .. } => "stiffness-loss",
            Self::Connection { .. } => "connection-flexibility",
            Self::TunedMassDamper { .. } => "tuned-mass-damper",
            Self::MassEccentricity(_) => "mass-eccentricity",
            Self::AxisRotation(_) => "axis-rotation",
            Self::Outrigger { .. } => "outrigger",
            Self::LateralSupport { .. } => "lateral-support",
            Self::SoilSprings { .. } => "soil-springs",
            Self::SensorGain { .. } => "sensor-gain",
            Self::SensorPolarity(_) => "sensor-polarity",
            Self::SensorSwap(_) => "sensor-swap",
            Self::SensorRotation { .. } => "sensor-rotation",
            Self::ClockOffset { .. } => "clock-offset",
            Self::Harmonic(_) => "harmonic",
            Self::TemperatureStiffness(_) => "temperature-stiffness",
        }
    }

    pub(super) fn place(&self) -> Place {
        match self {
            Self::AddedMass { z_m, .. }
            | Self::StiffnessLoss { z_m, .. }
            | Self::Connection { z_m, .. }
            | Self::TunedMassDamper { z_m, .. }
            | Self::LateralSupport { z_m, .. }
            | Self::SoilSprings { z_m, .. }
            | Self::Outrigger { z_m, .. } => Place::Height(*z_m),
            Self::SensorGain { channel, .. } | Self::SensorPolarity(channel) => {
                Place::Label(format!("ch{}", channel_name(*channel)))
            }
            Self::SensorSwap([a, b]) => Place::Label(format!("ch{}+ch{}", channel_name(*a), channel_name(*b))),
            Self::SensorRotation { node: Some(node), .. } | Self::ClockOffset { node, .. } => {
                Place::Label(format!("node{node}"))
            }
            Self::Harmonic(frequency_hz) => Place::Frequency(*frequency_hz),
            _ => Place::Whole,
        }
    }

    /// Parameters that belfry states in the same sense.
    pub(super) fn parameters(&self) -> Vec<(&'static str, f64)> {
        match *self {
            Self::StiffnessScale(v) | Self::MassScale(v) | Self::ShearFlexibility(v) | Self::RotaryInertia(v) => {
                vec![("relative", v)]
            }
            Self::BaseRotation([x, y]) | Self::BaseTranslation([x, y]) if x == y => vec![("flexibility", x)],
            Self::BaseRotation([x, y]) | Self::BaseTranslation([x, y]) => {
                vec![("flexibility_x", x), ("flexibility_y", y)]
            }
            Self::PDelta => vec![("factor", 1.0)],
            Self::AddedMass { mass_kg, .. } => vec![("mass", mass_kg)],
            // Of more than one segment the parameter means another thing than of belfry's zone.
            Self::StiffnessLoss { segments: [first, last], relative, .. } if first == last => {
                vec![("relative", relative)]
            }
            Self::StiffnessLoss { .. } | Self::SensorPolarity(_) | Self::SensorSwap(_) => Vec::new(),
            Self::Connection { flexibility, .. } => vec![("flexibility", flexibility)],
            Self::TunedMassDamper { mass_kg, frequency_hz, damping_ratio, .. } => {
                vec![("mass", mass_kg), ("frequency", frequency_hz), ("damping_ratio", damping_ratio)]
            }
            Self::MassEccentricity([x, y]) => vec![("x", x), ("y", y)],
            Self::AxisRotation(angle) | Self::SensorRotation { angle_deg: angle, .. } => vec![("angle", angle)],
            Self::Outrigger { stiffness, .. } => vec![("stiffness", stiffness)],
            Self::LateralSupport { stiffness: [x, y], .. } | Self::SoilSprings { stiffness: [x, y], .. } if x == y => {
                vec![("stiffness", x)]
            }
            Self::LateralSupport { stiffness: [x, y], .. } | Self::SoilSprings { stiffness: [x, y], .. } => {
                vec![("stiffness_x", x), ("stiffness_y", y)]
            }
            Self::SensorGain { factor, .. } => vec![("factor", factor)],
            Self::ClockOffset { delay_s, .. } => vec![("delay", delay_s)],
            Self::Harmonic(frequency_hz) => vec![("frequency", frequency_hz)],
            Self::TemperatureStiffness(per_kelvin) => vec![("relative_per_kelvin", per_kelvin)],
        }
    }

    pub(super) fn apply(&self, body: &mut Body, structure: &Structure) {
        match *self {
            Self::StiffnessScale(relative) => body.elements.iter_mut().for_each(|e| e.scale(1.0 + relative)),
            Self::MassScale(relative) => body.nodes.iter_mut().for_each(|node| node.scale(1.0 + relative)),
            // About X: rx, which bends along Y; about Y: ry.
            Self::BaseRotation([x, y]) => (body.base_flexibility[2], body.base_flexibility[3]) = (x, y),
            Self::BaseTranslation([x, y]) => (body.base_flexibility[0], body.base_flexibility[1]) = (x, y),
            Self::ShearFlexibility(relative) => {
                for compliance in body.elements.iter_mut().flat_map(|element| &mut element.shear_compliance_per_n) {
                    *compliance *= 1.0 + relative;
                }
            }
            Self::RotaryInertia(relative) => {
                for node in &mut body.nodes {
                    for (inertia, table) in node.inertia_kg_m2.iter_mut().zip(node.table_inertia_kg_m2) {
                        *inertia += relative * table;
                    }
                }
            }
            Self::PDelta => body.weight = 1.0,
            Self::AddedMass { z_m, mass_kg } => {
                let element = body.element_at(z_m);
                let share = (z_m - body.nodes[element].z_m) / body.length_m(element);
                body.nodes[element].mass_kg += mass_kg * (1.0 - share);
                body.nodes[element + 1].mass_kg += mass_kg * share;
            }
            Self::StiffnessLoss { segments: [first, last], relative, .. } => {
                let lost = body.elements.iter_mut().filter(|e| (first..=last).contains(&e.segment));
                lost.for_each(|element| element.scale(1.0 - relative));
            }
            Self::Connection { z_m, flexibility } => {
                let element = body.element_at(z_m);
                let at = z_m - body.nodes[element].z_m;
                body.elements[element].joint = Some((at, flexibility));
            }
            Self::TunedMassDamper { z_m, mass_kg, frequency_hz, damping_ratio } => {
                let along = |azimuth_deg| Attachment { z_m, azimuth_deg, mass_kg, frequency_hz, damping_ratio };
                body.attachments.extend([along(0.0), along(90.0)]);
            }
            Self::MassEccentricity(centre_m) => {
                let heaviest = structure.segments.iter().map(|s| s.mass_top_kg).fold(0.0, f64::max);
                let light = |s: &&super::table::Segment| s.mass_top_kg < MAIN_BODY_SHARE * heaviest;
                let ends_m = structure.segments.iter().find(light).map_or(f64::INFINITY, |s| s.z_bottom_m);
                for node in body.nodes.iter_mut().filter(|node| node.z_m <= ends_m) {
                    node.centre_m = centre_m;
                }
            }
            Self::AxisRotation(angle) => body.elements.iter_mut().for_each(|e| e.axis_deg += angle),
            Self::Outrigger { z_m, stiffness } => {
                let node = body.nearest_node(z_m);
                body.springs.extend([(node, 2, stiffness), (node, 3, stiffness)]);
            }
            Self::LateralSupport { z_m, stiffness: [x, y] } => {
                let node = body.nearest_node(z_m);
                body.springs.extend([(node, 0, x), (node, 1, y)]);
            }
            Self::SoilSprings { z_m, stiffness } => {
                for element in 0..body.elements.len() {
                    let bottom_m = body.nodes[element].z_m;
                    let held_m = body.nodes[element + 1].z_m.min(z_m) - bottom_m;
                    if held_m <= 0.0 {
                        break;
                    }
                    // Half of an element's bed at each of its ends, more below where it ends within.
                    let above = 0.5 * held_m * held_m / body.length_m(element);
                    for (node, metres) in [(element, held_m - above), (element + 1, above)] {
                        body.springs.extend([(node, 0, stiffness[0] * metres), (node, 1, stiffness[1] * metres)]);
                    }
                }
            }
            Self::SensorGain { channel, factor } => body.sensors[channel].factor *= factor,
            Self::SensorPolarity(channel) => body.sensors[channel].factor *= -1.0,
            Self::SensorSwap([a, b]) => body.sensors.swap(a, b),
            Self::SensorRotation { node, angle_deg } => {
                let turned = body.sensors.iter_mut().filter(|s| node.is_none_or(|node| s.place.node == node));
                turned.for_each(|sensor| sensor.place.azimuth_deg += angle_deg);
            }
            Self::ClockOffset { node, delay_s } => {
                let late = body.sensors.iter_mut().filter(|sensor| sensor.place.node == node);
                late.for_each(|sensor| sensor.delay_s += delay_s);
            }
            Self::Harmonic(frequency_hz) => body.tone_hz = Some(frequency_hz),
            Self::TemperatureStiffness(per_kelvin) => body.stiffness_per_kelvin = per_kelvin,
        }
    }
}
