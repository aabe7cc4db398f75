//! Cases: which structure, which defect, how large; all from a seed and the case's number, so that each can be made again.

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::body::Body;
use super::damped::{DampedMode, damped_modes};
use super::effect::Effect;
use super::magnitude::{Band, draw, log_uniform};
use super::outside;
use super::scatter::Scatter;
use super::structures::{NAMES, Structure};
use super::world::{Loads, World, Worlds};

/// Kinds that stand in the matrices.
const STRUCTURAL: [&str; 16] = [
    "stiffness-scale",
    "mass-scale",
    "base-rotation",
    "base-translation",
    "shear-flexibility",
    "rotary-inertia",
    "p-delta",
    "added-mass",
    "stiffness-loss",
    "connection-flexibility",
    "tuned-mass-damper",
    "mass-eccentricity",
    "axis-rotation",
    "outrigger",
    "lateral-support",
    "soil-springs",
];
/// Kinds that stand in the sensors.
const SENSORS: [&str; 5] = ["sensor-gain", "sensor-polarity", "sensor-swap", "sensor-rotation", "clock-offset"];
/// Kinds that stand in neither.
const OTHERS: [&str; 2] = ["harmonic", "temperature-stiffness"];
/// Of twenty cases a structure: sound ones, ones with one effect, pairs; the rest is outside the catalogue.
const MIX: [usize; 3] = [4, 10, 3];
const MOST_DRAWS: usize = 60;
/// Modes that a structure can have in its recording.
pub(super) const MODES: usize = 40;
/// Highest mode in a recording as a share of half its rate.
pub(super) const HIGHEST: f64 = 0.9;

/// What is to be drawn.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Kinds {
    /// The whole mix.
    Mix,
    /// One category.
    Category(Category),
    /// One kind of the catalogue, alone.
    Kind(&'static str),
}

impl Kinds {
    /// A kind's name, or nothing, pairs, outside.
    pub fn named(name: &str) -> Option<Self> {
        let kinds = STRUCTURAL.iter().chain(&SENSORS).chain(&OTHERS);
        match name {
            "nothing" => Some(Self::Category(Category::Nothing)),
            "single" => Some(Self::Category(Category::Single)),
            "pairs" => Some(Self::Category(Category::Pair)),
            "outside" => Some(Self::Category(Category::Outside)),
            _ => kinds.copied().find(|kind| *kind == name).map(Self::Kind),
        }
    }
}

/// What sort of case it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Category {
    /// A sound structure.
    Nothing,
    /// One effect of the catalogue.
    Single,
    /// Two.
    Pair,
    /// Something that the catalogue does not know.
    Outside,
}

/// Which cases, and of how long a record.
#[derive(Debug, Clone)]
pub struct Options {
    /// Seed of all cases.
    pub seed: u64,
    /// Only this structure.
    pub structure: Option<String>,
    /// Only these.
    pub kinds: Kinds,
    /// Length of the recordings.
    pub hours: f64,
    /// What of scatter, loads and sizes the study does not know.
    pub worlds: Worlds,
}

/// A structure with what is hidden in it.
#[derive(Debug, Clone)]
pub struct Case {
    /// Its number.
    pub index: u64,
    /// What sort it is.
    pub category: Category,
    /// As its study knows it.
    pub structure: Structure,
    pub(super) effects: Vec<Effect>,
    pub(super) outside: Option<&'static str>,
    /// As it truly is.
    pub(super) body: Body,
    /// As it would be without the defect.
    pub(super) sound: Body,
    /// How such structures scatter.
    pub(super) scatter: Scatter,
    pub(super) damping_ratios: Vec<f64>,
    pub(super) hours: f64,
    pub(super) world: World,
    /// What is left for the recording.
    pub(super) random: ChaCha8Rng,
}

impl Case {
    /// Draws a case.
    ///
    /// # Errors
    /// Where the structure's data are absent, or no draw of what is asked for can be seen.
    pub fn draw(index: u64, options: &Options) -> Result<Self, String> {
        let mut random = ChaCha8Rng::seed_from_u64(options.seed);
        random.set_stream(index);
        let turn = (index % NAMES.len() as u64) as usize;
        let round = (index / NAMES.len() as u64) as usize;
        let world = options.worlds.of(options.seed, index);
        let category = match options.kinds {
            Kinds::Mix => categories()[round % 20],
            Kinds::Category(category) => category,
            Kinds::Kind(_) => Category::Single,
        };
        // A kind that a structure cannot show is looked for on the next.
        for offset in 0..NAMES.len() {
            let name = options.structure.as_deref().unwrap_or(NAMES[(turn + offset) % NAMES.len()]);
            let structure = Structure::named(name)?;
            let (sound, scatter) = sound(&structure, &world, &mut random);
            let defect = hidden(category, &options.kinds, &world, &sound, &structure, &mut random);
            if let Some((body, effects, outside)) = defect {
                let damping_ratios = (0..MODES).map(|_| log_uniform(&mut random, [0.005, 0.02])).collect();
                let hours = options.hours;
                // Lines of a spectrum know no frequencies that move with a day's temperature.
                let is_noise = body.stiffness_per_kelvin != 0.0 && world.loads == Loads::Wind;
                let world = if is_noise { World { loads: Loads::Uneven, ..world } } else { world };
                return Ok(Self {
                    index,
                    category,
                    structure,
                    effects,
                    outside,
                    body,
                    sound,
                    scatter,
                    damping_ratios,
                    hours,
                    world,
                    random,
                });
            }
        }
        Err(format!("case {index}: no draw can be seen"))
    }

    /// Damped modes in the recording, those of the band first.
    pub(super) fn damped_modes(&self) -> Result<Vec<DampedMode>, String> {
        let modes = self.body.modes(MODES).ok_or("the structure buckles")?;
        let highest_hz = HIGHEST * 0.5 * self.structure.sampling_rate_hz;
        Ok(damped_modes(&self.body, &modes, &self.damping_ratios, highest_hz))
    }

    /// The largest relative shift of a frequency by what is hidden; `None` where it moves none.
    pub(super) fn shift(&self) -> Option<f64> {
        let sound = Band::of(&self.sound, &self.structure, None)?;
        let shift = sound.shift(&Band::of(&self.body, &self.structure, Some(sound.frequencies_hz.len()))?);
        (shift > 1e-9).then_some(shift)
    }

    /// The mean frequency error that scatter alone leaves.
    pub(super) fn floor_percent(&self) -> Option<f64> {
        let model = Band::of(&Body::coarse(&self.structure), &self.structure, None)?;
        let sound = Band::of(&self.sound, &self.structure, Some(model.frequencies_hz.len()))?;
        Some(sound.mean_error_percent(&model))
    }

    /// What is hidden, in words.
    pub fn truth(&self) -> String {
        let name = |effect: &Effect| {
            let values = effect.parameters().into_iter().map(|(name, value)| format!("{name}={value:.3e}"));
            let values = match values.collect::<Vec<_>>().join(",") {
                none if none.is_empty() => none,
                values => format!("({values})"),
            };
            let place = match effect.place() {
                super::effect::Place::Whole => String::new(),
                super::effect::Place::Height(z_m) => format!("@{z_m:.1}m"),
                super::effect::Place::Label(label) => format!("@{label}"),
                super::effect::Place::Frequency(hz) => format!("@{hz:.4}hz"),
            };
            format!("{}{place}{values}", effect.kind())
        };
        match (self.outside, self.effects.as_slice()) {
            (Some(outside), _) => format!("outside:{outside}"),
            (None, []) => "nothing".to_owned(),
            (None, effects) => effects.iter().map(name).collect::<Vec<_>>().join(" + "),
        }
    }
}

/// Twenty categories in an order that keeps any few of them mixed.
fn categories() -> [Category; 20] {
    std::array::from_fn(|at| match (at * 7) % 20 {
        place if place < MIX[0] => Category::Nothing,
        place if place < MIX[0] + MIX[1] => Category::Single,
        place if place < MIX[0] + MIX[1] + MIX[2] => Category::Pair,
        _ => Category::Outside,
    })
}

/// A structure without a defect, and how it scatters.
fn sound(structure: &Structure, world: &World, random: &mut impl Rng) -> (Body, Scatter) {
    let mut body = Body::fine(structure);
    let stiffness = random.random_range(0.02..0.03);
    let scatter = Scatter::of(&body, [stiffness, 0.01], structure.correlation_length_m(), world);
    scatter.draw(&mut body, random);
    (body, scatter)
}

type Hidden = (Body, Vec<Effect>, Option<&'static str>);

fn pick<'a>(kinds: &[&'a str], random: &mut impl Rng) -> &'a str {
    kinds[random.random_range(0..kinds.len())]
}

/// A structure with a defect of a category; `None` where none can be seen.
fn hidden(
    category: Category,
    kinds: &Kinds,
    world: &World,
    sound: &Body,
    structure: &Structure,
    random: &mut impl Rng,
) -> Option<Hidden> {
    for _ in 0..MOST_DRAWS {
        let wanted: Vec<&str> = match category {
            Category::Nothing => return Some((sound.clone(), Vec::new(), None)),
            Category::Outside => {
                let name = outside::NAMES[random.random_range(0..outside::NAMES.len())];
                match outside::put(name, sound, structure, random) {
                    Some(body) => return Some((body, Vec::new(), Some(name))),
                    None => continue,
                }
            }
            Category::Single => match kinds {
                Kinds::Kind(kind) => vec![kind],
                _ => vec![pick(&[&STRUCTURAL[..], &SENSORS, &OTHERS].concat(), random)],
            },
            Category::Pair => {
                vec![pick(&STRUCTURAL, random), pick(&[&STRUCTURAL[..], &SENSORS].concat(), random)]
            }
        };
        if let [first, second] = wanted[..]
            && (first == second || [first, second].iter().all(|kind| kind.ends_with("-scale")))
        {
            continue;
        }
        let effects: Option<Vec<_>> =
            wanted.iter().map(|kind| draw(kind, sound, structure, world.shift, random)).collect();
        if let Some(effects) = effects {
            let mut body = sound.clone();
            effects.iter().for_each(|effect| effect.apply(&mut body, structure));
            // Two of them can be too much together.
            if body.modes(1).is_some() {
                return Some((body, effects, None));
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(kinds: Kinds) -> Options {
        Options { seed: 3, structure: None, kinds, hours: 12.0, worlds: Worlds::default() }
    }

    #[test]
    fn a_case_is_the_same_when_drawn_again() {
        for index in [0, 4, 7] {
            let [a, b] = [0; 2].map(|_| Case::draw(index, &options(Kinds::Mix)).expect("drawn"));
            assert_eq!((a.truth(), a.category), (b.truth(), b.category));
            let [a, b] = [a, b].map(|case| case.damped_modes().expect("stable")[0].frequency_hz());
            assert_eq!(a, b);
        }
    }

    #[test]
    fn the_mix_has_its_shares() {
        let count = |category| categories().iter().filter(|c| **c == category).count();
        let all = [Category::Nothing, Category::Single, Category::Pair, Category::Outside];
        assert_eq!(all.map(count), [4, 10, 3, 3]);
    }

    #[test]
    fn every_kind_can_be_drawn_somewhere() {
        for kind in STRUCTURAL.into_iter().chain(SENSORS).chain(OTHERS) {
            let case = Case::draw(0, &options(Kinds::Kind(kind))).expect(kind);
            assert_eq!(case.effects[0].kind(), kind);
        }
    }
}
