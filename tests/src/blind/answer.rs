//! What belfry answers, as plain data: identification, comparison, diagnosis, effects in a study. JSON and TOML text flow in.

use serde_json::Value;

/// An effect as belfry names it: `kind` or `kind@where`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Name {
    pub(super) kind: String,
    pub(super) place: Option<String>,
}

impl Name {
    pub(super) fn parse(name: &str) -> Self {
        match name.split_once('@') {
            Some((kind, place)) => Self { kind: kind.to_owned(), place: Some(place.to_owned()) },
            None => Self { kind: name.to_owned(), place: None },
        }
    }
}

impl std::fmt::Display for Name {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match &self.place {
            Some(place) => write!(f, "{}@{place}", self.kind),
            None => f.write_str(&self.kind),
        }
    }
}

/// A parameter of a candidate.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Parameter {
    pub(super) name: String,
    pub(super) value: f64,
    pub(super) std: f64,
}

/// What `belfry diagnose` says.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Diagnosis {
    pub(super) verdict: String,
    pub(super) best: Vec<Name>,
    /// All names of all groups that the data cannot tell apart.
    pub(super) ambiguous: Vec<Name>,
    pub(super) p_value: f64,
    /// Parameters of the best name's candidate.
    pub(super) parameters: Vec<Parameter>,
    /// How probable it says that its verdict is: of all that it names together. NaN where the evidence is not in the modes.
    pub(super) probability: f64,
}

/// A mode as identified.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct IdentifiedMode {
    pub(super) frequency_hz: f64,
    pub(super) frequency_std_hz: f64,
    /// Real part, imaginary part, standard deviation.
    pub(super) shape: Vec<[f64; 3]>,
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

fn names(value: &Value) -> Vec<Name> {
    list(value).iter().filter_map(Value::as_str).map(Name::parse).collect()
}

/// Reads the object of `belfry diagnose --json`; `None` where it has no verdict.
pub(super) fn diagnosis(object: &Value) -> Option<Diagnosis> {
    let best = names(&object["best"]);
    let is = |candidate: &Value, name: &Name| {
        candidate["effect"].as_str() == Some(&name.kind) && candidate["where"].as_str() == name.place.as_deref()
    };
    let of_best = |candidate: &&Value| best.first().is_some_and(|name| is(candidate, name));
    let parameter = |value: &Value| {
        let name = value["name"].as_str()?.to_owned();
        Some(Parameter { name, value: number(&value["value"]), std: number(&value["std"]) })
    };
    let candidate = list(&object["candidates"]).iter().find(of_best);
    let verdict = object["verdict"].as_str()?.to_owned();
    let ambiguous: Vec<Name> = list(&object["ambiguous"]).iter().flat_map(names).collect();
    let is_named = |candidate: &&Value| best.iter().chain(&ambiguous).any(|name| is(candidate, name));
    let probability = match verdict.as_str() {
        "adequate" => number(&object["probabilities"]["adequate"]),
        "unknown" => number(&object["probabilities"]["something_else"]),
        _ => list(&object["candidates"]).iter().filter(is_named).map(|named| number(&named["probability"])).sum(),
    };
    Some(Diagnosis {
        verdict,
        probability,
        ambiguous,
        p_value: number(&object["goodness_of_fit"]["p_value"]),
        parameters: candidate.map_or_else(Vec::new, |c| list(&c["parameters"]).iter().filter_map(parameter).collect()),
        best,
    })
}

/// Reads the modes of `belfry identify --json`.
pub(super) fn modes(object: &Value) -> Vec<IdentifiedMode> {
    let mode = |mode: &Value| IdentifiedMode {
        frequency_hz: number(&mode["frequency_hz"]),
        frequency_std_hz: number(&mode["frequency_std_hz"]),
        shape: list(&mode["shape"]).iter().map(|part| ["re", "im", "std"].map(|key| number(&part[key]))).collect(),
    };
    list(&object["modes"]).iter().map(mode).collect()
}

/// Mean frequency error in percent and mean MAC of `belfry compare --json`.
pub(super) fn comparison(object: &Value) -> [f64; 2] {
    ["mean_abs_frequency_error_percent", "mean_mac"].map(|key| number(&object[key]))
}

/// The effects in a study: the values of `kind` and `where` below each `[[model.effect]]`.
pub(super) fn effects_of_study(study_toml: &str) -> Vec<Name> {
    let mut effects: Vec<Name> = Vec::new();
    let mut inside = false;
    for line in study_toml.lines().map(str::trim) {
        if line.starts_with('[') {
            inside = line.starts_with("[[model.effect]]");
            if inside {
                effects.push(Name { kind: String::new(), place: None });
            }
        } else if let (true, Some(effect), Some((key, value))) = (inside, effects.last_mut(), line.split_once('=')) {
            let text = value.split('"').nth(1).map(str::to_owned);
            match key.trim() {
                "kind" => effect.kind = text.unwrap_or_default(),
                "where" => effect.place = text,
                _ => {}
            }
        }
    }
    effects
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_contracts_object_is_read() {
        let object = serde_json::json!({
            "verdict": "ambiguous",
            "candidates": [
                {"effect": "added-mass", "where": "20.0m", "probability": 0.25,
                 "parameters": [{"name": "mass", "value": 1.0, "std": 0.5, "unit": "kg"}]},
                {"effect": "mass-scale", "where": null, "probability": 0.5,
                 "parameters": [{"name": "relative", "value": 0.1, "std": 0.01, "unit": "-"}]},
                {"effect": "p-delta", "where": null, "probability": 0.125, "parameters": []}
            ],
            "best": ["mass-scale"],
            "ambiguous": [["mass-scale", "stiffness-scale"], ["added-mass@20.0m"]],
            "probabilities": {"adequate": 0.03125, "something_else": 0.0625},
            "goodness_of_fit": {"chi_squared": 9.0, "degrees_of_freedom": 9, "p_value": 0.4},
        });
        let read = diagnosis(&object).expect("it has a verdict");
        assert_eq!(read.best, [Name::parse("mass-scale")]);
        assert_eq!(read.ambiguous.len(), 3);
        assert_eq!(read.ambiguous[2].place.as_deref(), Some("20.0m"));
        assert_eq!(read.probability, 0.75);
        let with = |verdict: &str| {
            let mut object = object.clone();
            object["verdict"] = verdict.into();
            diagnosis(&object).expect("it has a verdict").probability
        };
        assert_eq!((with("adequate"), with("unknown")), (0.03125, 0.0625));
        assert_eq!(read.parameters, [Parameter { name: "relative".into(), value: 0.1, std: 0.01 }]);
        assert!(diagnosis(&serde_json::json!({})).is_none());
    }

    #[test]
    fn effects_are_read_from_a_study() {
        let text = "[model]\nbeam = \"beam.csv\"\n\n[[model.effect]] # added\nkind = \"added-mass\"\nwhere = \"20m\" # here\nvalue = 1\n\n\
                    [[model.effect]]\nkind = \"p-delta\"\n\n[analysis]\nkind = \"x\"\n";
        assert_eq!(effects_of_study(text), [Name::parse("added-mass@20m"), Name::parse("p-delta")]);
    }
}
