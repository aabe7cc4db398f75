//! Picks that modes were not identified with yet: how the choice of modes in study.toml differs from the one that stands with the modes.

use serde::Serialize;
use serde_json::Value;

use crate::identify::NEAR_SHARE;
use crate::study::{ModeChoice, Study, band_at};

/// What identifying the modes again would change.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Picks {
    /// Frequencies at which modes come.
    added_hz: Vec<f64>,
    /// Numbers of modes that go.
    dropped: Vec<u64>,
    /// Modes that are fitted to other lines.
    bands: Vec<PickedBand>,
    /// The choice that the modes were identified with; none where they were all picked automatically.
    #[serde(skip_serializing_if = "Option::is_none")]
    standing: Option<Standing>,
}

/// A choice that the modes were identified with.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Standing {
    /// Frequencies at which modes were dropped.
    dropped_hz: Vec<f64>,
    /// Frequencies at which modes were asked for and none was found.
    absent_hz: Vec<f64>,
    in_words: String,
}

/// The lines that a mode is to be fitted to; none, where they are chosen from the data.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct PickedBand {
    mode: u64,
    band_hz: Option<[f64; 2]>,
}

/// Frequencies that differ by less than this share are one number, rounded.
const ROUNDED: f64 = 1e-6;

impl Picks {
    /// Of a study whose modes are these, as modes.json has them; none, where it does not say with which choice they were identified.
    pub(super) fn of(study: &Study, modes: &Value) -> Self {
        let then = modes.get("choice").and_then(|choice| serde_json::from_value(choice.clone()).ok());
        then.map(|then: ModeChoice| Self::between(&then, &study.analysis.modes, modes)).unwrap_or_default()
    }

    fn between(then: &ModeChoice, now: &ModeChoice, modes: &Value) -> Self {
        let modes: Vec<KnownMode> = modes["modes"].as_array().into_iter().flatten().filter_map(KnownMode::of).collect();
        let mut added_hz = new_in(&now.wanted_hz(), &then.wanted_hz());
        added_hz.extend(new_in(&then.drop_hz, &now.drop_hz));
        let gone = new_in(&now.drop_hz, &then.drop_hz).into_iter().chain(new_in(&then.wanted_hz(), &now.wanted_hz()));
        let number = |hz: f64| {
            let off = |mode: &&KnownMode| (mode.asked_hz / hz - 1.0).abs();
            let nearest = modes.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
            nearest.filter(|mode| off(mode) <= NEAR_SHARE).map(|mode| mode.number)
        };
        let band = |mode: &KnownMode| {
            let band_hz = band_at(&now.bands_hz, mode.frequency_hz);
            let is_new = band_hz != band_at(&then.bands_hz, mode.frequency_hz);
            is_new.then_some(PickedBand { mode: mode.number, band_hz })
        };
        let standing = Standing::of(then, &modes);
        Self {
            standing,
            added_hz,
            dropped: gone.filter_map(number).collect(),
            bands: modes.iter().filter_map(band).collect(),
        }
    }
}

impl Standing {
    fn of(then: &ModeChoice, modes: &[KnownMode]) -> Option<Self> {
        let in_hz = |list: &[f64]| list.iter().map(|hz| short_hz(*hz)).collect::<Vec<_>>().join(", ");
        let bands: Vec<String> =
            then.bands_hz.iter().map(|[from, to]| format!("{} to {}", short_hz(*from), short_hz(*to))).collect();
        let parts = [
            then.only_hz.as_ref().map(|only| format!("only those near {} Hz", in_hz(only))),
            (!then.add_hz.is_empty()).then(|| format!("added at {} Hz", in_hz(&then.add_hz))),
            (!then.drop_hz.is_empty()).then(|| format!("dropped at {} Hz", in_hz(&then.drop_hz))),
            (!bands.is_empty()).then(|| format!("fitted to bands of {} Hz", bands.join(", "))),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        let in_words = format!("The modes were identified with the choice of study.toml: {}.", parts.join("; "));
        let found: Vec<f64> = modes.iter().map(|mode| mode.asked_hz).collect();
        let absent_hz = new_in(&then.wanted_hz(), &found);
        (!parts.is_empty()).then(|| Self { dropped_hz: then.drop_hz.clone(), absent_hz, in_words })
    }
}

/// A frequency without needless zeros.
fn short_hz(hz: f64) -> String {
    format!("{hz:.4}").trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// What of these frequencies the others lack.
fn new_in(these_hz: &[f64], others_hz: &[f64]) -> Vec<f64> {
    let is_there = |hz: &f64| others_hz.iter().any(|other| (other / hz - 1.0).abs() < ROUNDED);
    these_hz.iter().copied().filter(|hz| !is_there(hz)).collect()
}

/// A mode of modes.json.
struct KnownMode {
    number: u64,
    frequency_hz: f64,
    /// Where it was asked for; it may lie beside.
    asked_hz: f64,
}

impl KnownMode {
    fn of(mode: &Value) -> Option<Self> {
        let frequency_hz = mode["frequency_hz"].as_f64()?;
        let asked_hz = mode["asked_hz"].as_f64().unwrap_or(frequency_hz);
        Some(Self { number: mode["number"].as_u64()?, frequency_hz, asked_hz })
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn picks_are_what_has_changed_since_the_modes_were_identified() {
        let modes = json!({ "modes": [
            { "number": 1, "frequency_hz": 0.5 },
            { "number": 2, "frequency_hz": 0.803, "asked_hz": 0.8 },
            { "number": 3, "frequency_hz": 1.2 },
        ] });
        let then =
            ModeChoice { add_hz: vec![0.8], drop_hz: vec![1.0], bands_hz: vec![[0.4, 0.6]], ..Default::default() };
        let picks = |now: &ModeChoice| Picks { standing: None, ..Picks::between(&then, now, &modes) };
        let standing = Picks::between(&then, &then, &modes).standing.unwrap();
        assert_eq!(
            standing.in_words,
            "The modes were identified with the choice of study.toml: added at 0.8 Hz; dropped at 1 Hz; fitted to bands of 0.4 to 0.6 Hz."
        );
        assert!(standing.absent_hz.is_empty());
        let more = ModeChoice { add_hz: vec![0.8, 0.65], ..ModeChoice::default() };
        assert_eq!(Picks::between(&more, &more, &modes).standing.unwrap().absent_hz, [0.65]);
        assert_eq!(Picks::between(&ModeChoice::default(), &then, &modes).standing, None);
        assert_eq!(picks(&then), Picks::default());
        // What was added is taken back, what was dropped as well, one more is dropped and one is added.
        let now = ModeChoice { add_hz: vec![1.5], drop_hz: vec![1.2001], ..Default::default() };
        let bands = vec![PickedBand { mode: 1, band_hz: None }];
        assert_eq!(picks(&now), Picks { added_hz: vec![1.5, 1.0], dropped: vec![3, 2], bands, standing: None });
        let wider = ModeChoice { bands_hz: vec![[0.4, 0.65]], ..then.clone() };
        let bands = vec![PickedBand { mode: 1, band_hz: Some([0.4, 0.65]) }];
        assert_eq!(picks(&wider), Picks { bands, ..Picks::default() });
        // A frequency that lost its last digits on the way is the same.
        assert_eq!(picks(&ModeChoice { add_hz: vec![0.800_000_01], ..then.clone() }), Picks::default());
    }
}
