//! The judgement of a case: what was hidden and what belfry said flow in as plain data, right or wrong flows out.
//!
//! A kind is right without its height, which is judged apart; sensors and clocks are right only at the right ones.

use super::answer::{Diagnosis, Name};
use super::cases::Category;
use super::effect::Place;
use super::honesty::Honesty;
use super::world::World;

/// Share of the height within which the place of an effect of a pair counts as found.
const NEAR_SHARE: f64 = 0.1;
/// Relative difference within which a tone's frequency does.
const NEAR_FREQUENCY: f64 = 0.02;
/// What is left of the frequency error where it counts as gone: a tenth, or 1.3 times what scatter leaves.
const FALLEN: [f64; 2] = [0.1, 1.3];

/// A hidden effect.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TrueEffect {
    pub(super) kind: &'static str,
    pub(super) place: Place,
    pub(super) parameters: Vec<(&'static str, f64)>,
}

/// All that is known of a case after it was run.
#[derive(Debug, Clone)]
pub struct CaseRecord {
    pub(super) index: u64,
    pub(super) structure: &'static str,
    pub(super) category: Category,
    /// The truth in words.
    pub(super) truth: String,
    pub(super) effects: Vec<TrueEffect>,
    pub(super) outside: Option<&'static str>,
    pub(super) height_m: f64,
    pub(super) world: World,
    /// Largest relative shift of a frequency by what is hidden; `None` where it moves none.
    pub(super) shift: Option<f64>,
    /// How far it stands out of scatter and measurement, in standard deviations, where that can be said.
    pub(super) visibility: Option<f64>,
    pub(super) honesty: Honesty,
    /// Mean frequency error in percent: of the model as given, after adding what was named, and of scatter alone.
    pub(super) error_before: f64,
    pub(super) error_after: Option<f64>,
    pub(super) floor: f64,
    pub(super) mac_before: f64,
    pub(super) diagnosis: Option<Diagnosis>,
    /// Without the true kind in the catalogue.
    pub(super) without: Option<String>,
    /// The effects that `--auto` left in the study.
    pub(super) found: Option<Vec<Name>>,
    pub(super) generation_s: f64,
    pub(super) identify_s: f64,
    pub(super) diagnose_s: f64,
    /// Commands that failed, and how.
    pub failures: Vec<String>,
}

/// Kinds that modes cannot tell apart have one name.
pub(super) fn canonical(kind: &str, whole: bool) -> &str {
    match kind {
        "mass-scale" => "stiffness-scale",
        "sensor-rotation" if whole => "axis-rotation",
        kind => kind,
    }
}

fn canonical_name(name: &Name) -> &str {
    canonical(&name.kind, name.place.is_none())
}

impl TrueEffect {
    pub(super) fn canonical(&self) -> &'static str {
        match canonical(self.kind, self.place == Place::Whole) {
            "stiffness-scale" => "stiffness-scale",
            "axis-rotation" => "axis-rotation",
            _ => self.kind,
        }
    }

    /// Whether a name means this effect; heights are free.
    pub(super) fn is(&self, name: &Name) -> bool {
        let same_sensors = match &self.place {
            Place::Label(label) => name.place.as_deref().is_some_and(|place| sorted(place) == sorted(label)),
            _ => true,
        };
        self.canonical() == canonical_name(name) && same_sensors
    }

    /// How far a name's height is from the truth, in m.
    pub(super) fn location_error_m(&self, name: &Name) -> Option<f64> {
        let Place::Height(z_m) = self.place else { return None };
        let named = name.place.as_deref()?.strip_suffix('m')?.parse::<f64>().ok()?;
        Some((named - z_m).abs())
    }

    /// Whether a name means this effect at its place.
    fn is_here(&self, name: &Name, height_m: f64) -> bool {
        let near = match &self.place {
            Place::Height(_) => self.location_error_m(name).is_some_and(|error| error <= NEAR_SHARE * height_m),
            Place::Frequency(hz) => {
                let named = name.place.as_deref().and_then(|place| place.strip_suffix("hz")?.parse::<f64>().ok());
                named.is_some_and(|named| (named / hz - 1.0).abs() < NEAR_FREQUENCY)
            }
            _ => true,
        };
        near && self.is(name)
    }
}

/// `a+b` with its parts in order.
fn sorted(place: &str) -> Vec<&str> {
    let mut parts: Vec<&str> = place.split('+').collect();
    parts.sort_unstable();
    parts
}

/// The kinds that a diagnosis names, best first, each once.
pub(super) fn named_set(diagnosis: &Diagnosis) -> Vec<&str> {
    let mut set = Vec::new();
    if names_effects(diagnosis) {
        for name in diagnosis.best.iter().chain(&diagnosis.ambiguous) {
            if !set.contains(&canonical_name(name)) {
                set.push(canonical_name(name));
            }
        }
    }
    set
}

fn names_effects(diagnosis: &Diagnosis) -> bool {
    matches!(diagnosis.verdict.as_str(), "effect" | "ambiguous")
}

impl CaseRecord {
    /// The single effect that is hidden, with what was said.
    fn single(&self) -> Option<(&TrueEffect, &Diagnosis)> {
        match (self.category, self.effects.as_slice(), &self.diagnosis) {
            (Category::Single, [effect], Some(diagnosis)) => Some((effect, diagnosis)),
            _ => None,
        }
    }

    /// Whether the truth is named first.
    pub fn first_right(&self) -> Option<bool> {
        let (effect, diagnosis) = self.single()?;
        Some(names_effects(diagnosis) && diagnosis.best.first().is_some_and(|name| effect.is(name)))
    }

    /// Whether the truth is among all that is named.
    pub fn in_set(&self) -> Option<bool> {
        let (effect, diagnosis) = self.single()?;
        let mut named = diagnosis.best.iter().chain(&diagnosis.ambiguous);
        Some(names_effects(diagnosis) && named.any(|name| effect.is(name)))
    }

    /// Whether a sound structure is called defective.
    pub fn false_alarm(&self) -> Option<bool> {
        let diagnosis = self.diagnosis.as_ref().filter(|_| self.category == Category::Nothing)?;
        Some(diagnosis.verdict != "adequate")
    }

    /// Whether what no effect describes is said to be unknown.
    pub fn known_unknown(&self) -> Option<bool> {
        let diagnosis = self.diagnosis.as_ref().filter(|_| self.category == Category::Outside)?;
        Some(diagnosis.verdict == "unknown")
    }

    /// Whether the verdict is true. Two effects at once are something else than one of the catalogue.
    pub(super) fn is_true(&self) -> Option<bool> {
        let diagnosis = self.diagnosis.as_ref()?;
        Some(match diagnosis.verdict.as_str() {
            "adequate" => self.category == Category::Nothing,
            "effect" => self.first_right() == Some(true),
            "ambiguous" => self.in_set() == Some(true),
            _ => matches!(self.category, Category::Outside | Category::Pair),
        })
    }

    /// Whether it was unknown once the true kind was taken out of the catalogue.
    pub(super) fn unknown_without(&self) -> Option<bool> {
        self.without.as_deref().map(|verdict| verdict == "unknown")
    }

    /// Whether both of a pair were found, at their places.
    pub fn both_found(&self) -> Option<bool> {
        let found = self.found.as_ref().filter(|_| self.category == Category::Pair)?;
        Some(self.effects.iter().all(|effect| found.iter().any(|name| effect.is_here(name, self.height_m))))
    }

    /// Distance of the named from the true height in m, where the kind is right.
    pub(super) fn location_error_m(&self) -> Option<f64> {
        let (effect, diagnosis) = self.single().filter(|_| self.first_right() == Some(true))?;
        effect.location_error_m(diagnosis.best.first()?)
    }

    /// Errors of the parameters in stated standard deviations, where the kind is right.
    pub(super) fn parameter_z(&self) -> Vec<f64> {
        let Some((effect, diagnosis)) = self.single().filter(|_| self.first_right() == Some(true)) else {
            return Vec::new();
        };
        if diagnosis.best.first().is_none_or(|name| name.kind != effect.kind) {
            return Vec::new();
        }
        let of = |name: &str| diagnosis.parameters.iter().find(|parameter| parameter.name == name);
        let z = |&(name, truth): &(&str, f64)| of(name).map(|parameter| (parameter.value - truth) / parameter.std);
        effect.parameters.iter().filter_map(z).filter(|z| z.is_finite()).collect()
    }

    /// Whether the frequency error fell as far as it can.
    pub(super) fn error_fell(&self) -> Option<bool> {
        let after = self.error_after?;
        Some(after <= FALLEN[0] * self.error_before || after <= FALLEN[1] * self.floor)
    }

    /// What stands in the table of confusions: the truth's kind and what is said.
    pub(super) fn confusion(&self) -> Option<(String, String)> {
        let diagnosis = self.diagnosis.as_ref()?;
        let truth = match (self.category, self.outside, self.effects.first()) {
            (Category::Outside, Some(name), _) => format!("outside:{name}"),
            (Category::Single, _, Some(effect)) => effect.kind.to_owned(),
            (Category::Nothing, ..) => "nothing".to_owned(),
            _ => return None,
        };
        let named = match diagnosis.best.first() {
            Some(name) if names_effects(diagnosis) => name.kind.clone(),
            _ => diagnosis.verdict.clone(),
        };
        Some((truth, named))
    }
}

/// A case in a line.
pub fn line(record: &CaseRecord) -> String {
    let dash = || "-".to_owned();
    let list = |names: &[Name]| {
        if names.is_empty() { dash() } else { names.iter().map(Name::to_string).collect::<Vec<_>>().join(",") }
    };
    let after = record.error_after.map_or_else(dash, |after| format!("{after:.2}"));
    let said = record.diagnosis.as_ref().map_or_else(dash, |d| {
        format!("{} | {} | {} | p {:.3}", d.verdict, list(&d.best), list(&d.ambiguous), d.p_value)
    });
    let mut text = format!(
        "{:4} {:14} | {} | {said} | error {:.2} -> {after} % (floor {:.2}) MAC {:.3} | modes {}/{} +{} | {:.1} + {:.1} + {:.1} s",
        record.index,
        record.structure,
        record.truth,
        record.error_before,
        record.floor,
        record.mac_before,
        record.honesty.found,
        record.honesty.found + record.honesty.missed,
        record.honesty.invented,
        record.generation_s,
        record.identify_s,
        record.diagnose_s,
    );
    if let Some(visibility) = record.visibility {
        text += &format!(" | stands out by {visibility:.1}");
    }
    if let Some(found) = &record.found {
        text += &format!(" | auto {}", list(found));
    }
    if let Some(verdict) = &record.without {
        text += &format!(" | without it {verdict}");
    }
    for failure in &record.failures {
        text += &format!("\n     failed: {failure}");
    }
    text
}

#[cfg(test)]
#[path = "score_tests.rs"]
mod tests;
