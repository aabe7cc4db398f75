//! Effects in words: what is typed, what is refused, and that what Belfry writes can be typed back.

use super::tests::sensor;
use super::*;
use crate::model::Structure;
use crate::model::tests::Uniform;
use crate::study::Sensor;

fn refusal(word: &str) -> String {
    word.parse::<Effect>().unwrap_err().to_string()
}

#[test]
fn words_become_effects_and_back() {
    let effect: Effect = "added-mass@443.6m=2e5".parse().unwrap();
    assert_eq!(effect.to_string(), "added-mass@443.6m");
    assert_eq!(effect.place(), Some(&Where::Height(443.6)));
    let record = effect.record();
    assert_eq!(record.r#where.as_deref(), Some("443.6m"));
    assert_eq!(record.parameters[0], ParameterRecord { name: "mass".into(), value: 2e5, std: None, unit: "kg".into() });
    let json = serde_json::to_value(&record).unwrap();
    assert_eq!(json["where"], "443.6m");

    let both: Effect = "base-rotation=flexibility_y=2e-14,flexibility_x=1e-14".parse().unwrap();
    let values: Vec<_> = both.parameters().map(|(parameter, value)| (parameter.name, value)).collect();
    assert_eq!(values, [("flexibility_x", 1e-14), ("flexibility_y", 2e-14)]);

    let height = PlaceKind::Height;
    assert_eq!(height.read("-10m"), Some(Where::Height(-10.0)));
    assert_eq!((height.read("10"), height.read("ch10m"), height.read("infm")), (None, None, None));
}

#[test]
fn wrong_words_are_refused_with_what_was_expected() {
    assert_eq!(
        refusal("base-rotaton=1e-14"),
        format!(
            "no effect is called `base-rotaton` (did you mean base-rotation?); there are {}",
            KINDS.iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", ")
        )
    );
    for (word, part) in [
        ("stiffness-loss@50m=1.5", "stiffness-loss: relative = 1.5 is out of range; it must be 0 to 0.99"),
        ("base-rotation=-1e-15", "flexibility = -0.000000000000001 is out of range; it must be 0 or more rad/(N m)"),
        ("added-mass@50m=nan", "mass = NaN is out of range; it must be 0 or more kg"),
        ("added-mass=5", "needs a height such as @225.2m, but got nothing"),
        ("added-mass@ch07=5", "but got @ch07"),
        ("mass-scale@50m=0.1", "takes no @WHERE; leave out @50m"),
        ("added-mass@50=5", "needs a height such as @225.2m, but got @50"),
        ("mass-scale", "no value"),
        ("mass-scale=", "no value"),
        ("mass-scale=much", "`much` is not a value for it; expected relative (-0.9 to 9)"),
        ("base-rotation=flexibility_x=1e-14", "expected flexibility (0 or more rad/(N m)), or flexibility_x"),
        ("base-rotation=1e-14,2e-14,3e-14,4e-14", "or base-rotation=flexibility_x=7e-15,flexibility_y=9e-15"),
        ("tuned-mass-damper@300m", "for instance tuned-mass-damper@300m=mass=1e5,frequency=0.14,damping_ratio=0.05 or"),
        ("tuned-mass-damper@300m=1e5", "for instance tuned-mass-damper@300m=mass=1e5,"),
    ] {
        let error = refusal(word);
        assert!(error.contains(part), "{word}: {error}");
    }
    let above: Effect = "added-mass@100.5m=5".parse().unwrap();
    let error = Structure::with_effects(Uniform::default().table(), &[above]).unwrap_err().to_string();
    assert_eq!(error, "added-mass@100.5m: the beam stands from 0 m to 100 m");
}

/// What study.toml says can be typed, what Belfry writes can be typed back, and both mean the same.
#[test]
fn places_are_named_as_in_the_study() {
    let of = |channels: &[&str]| {
        let sensor_of = |(index, channel): (usize, &&str)| sensor(channel, index as u16 + 1, 0.0);
        channels.iter().enumerate().map(sensor_of).collect::<Vec<_>>()
    };
    let sensors = of(&["05", "06", "top-x", "chimney", "12+x", "a/3", "5m", "node3"]);
    let effect = |word: &str, sensors: &[Sensor]| word.parse::<Effect>().unwrap().in_study(sensors).unwrap();
    for (typed, name, written) in [
        ("05", "05", "ch05"),
        ("ch05", "05", "ch05"),
        ("top-x", "top-x", "top-x"),
        ("chtop-x", "top-x", "top-x"),
        ("chimney", "chimney", "chimney"),
        ("12+x", "12+x", "12+x"),
        ("cha/3", "a/3", "a/3"),
        ("5m", "5m", "5m"),
        ("node3", "node3", "node3"),
    ] {
        let gain = effect(&format!("sensor-gain@{typed}=1.5"), &sensors);
        assert_eq!(gain.place(), Some(&Where::Channels(vec![name.to_owned()])));
        assert_eq!(gain.to_string(), format!("sensor-gain@{written}"));
        assert_eq!(effect(&format!("{gain}=1.5"), &sensors).place(), gain.place(), "{gain}");
        assert_eq!(named_in_study(&gain.to_string(), &sensors).unwrap().1.as_ref(), gain.place());
    }
    // A study whose channels are called so.
    assert_eq!(effect("sensor-polarity@ch05", &of(&["ch05", "ch06"])).to_string(), "sensor-polarity@ch05");
    for (typed, written) in [("3", "node3"), ("node3", "node3"), ("node 3", "node3")] {
        assert_eq!(effect(&format!("clock-offset@{typed}=1"), &sensors).to_string(), format!("clock-offset@{written}"));
    }
    for (typed, written) in [
        ("05+06", "ch05+ch06"),
        ("ch05+ch06", "ch05+ch06"),
        ("top-x + 05", "top-x+ch05"),
        ("12+x+05", "12+x+ch05"),
        ("05+12+x", "ch05+12+x"),
    ] {
        let swap = effect(&format!("sensor-swap@{typed}"), &sensors);
        assert_eq!(swap.to_string(), format!("sensor-swap@{written}"));
        assert_eq!(effect(&swap.to_string(), &sensors).place(), swap.place());
    }
    for word in ["sensor-swap@05", "sensor-swap@05+ch05", "sensor-gain@=2", "clock-offset@x=1", "custom@=1"] {
        assert!(word.parse::<Effect>().is_err(), "{word}");
    }
    let unknown = |word: &str| word.parse::<Effect>().unwrap().in_study(&sensors).unwrap_err();
    assert!(matches!(unknown("sensor-swap@05+y"), EffectError::NoChannel { channel, .. } if channel == "y"));
    assert!(matches!(unknown("sensor-gain@05+06=2"), EffectError::NoChannel { channel, .. } if channel == "05+06"));
}

#[test]
fn every_kind_shows_how_each_of_its_parameter_sets_is_typed() {
    for kind in KINDS {
        let (examples, sets) = (kind.about().examples, kind.parameter_sets());
        assert_eq!(examples.len(), sets.len(), "{}", kind.name());
        for (example, set) in examples.iter().zip(sets) {
            let effect: Effect = example.parse().unwrap_or_else(|error| panic!("{example}: {error}"));
            assert_eq!((effect.kind(), effect.parameters().len()), (kind.name(), set.len()), "{example}");
            assert!(effect.parameters().map(|(parameter, _)| parameter).eq(set.iter()), "{example}");
        }
    }
    // Numbers alone, in the order of the catalogue.
    let values = |word: &str| word.parse::<Effect>().unwrap().parameters().map(|(_, value)| value).collect::<Vec<_>>();
    assert_eq!(values("tuned-mass-damper@300m=1e5,0.14,0.05,y"), [1e5, 0.14, 0.05, 2.0]);
    assert_eq!(values("base-rotation=1e-14, 2e-14"), [1e-14, 2e-14]);
}

#[test]
fn the_catalogue_says_what_each_effect_is_confused_with() {
    for kind in KINDS {
        let about = kind.about();
        assert!(
            kind.parameter_sets().iter().flat_map(|set| set.iter()).all(|p| p.least < p.greatest),
            "{}",
            about.name
        );
        for alike in about.look_alikes {
            assert!(find(alike.kind).is_ok() && alike.kind != about.name, "{}: {}", about.name, alike.kind);
        }
    }
    let names: std::collections::BTreeSet<_> = KINDS.iter().map(|kind| kind.name()).collect();
    assert_eq!(names.len(), KINDS.len());
}
