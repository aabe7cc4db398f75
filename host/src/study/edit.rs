//! Effects in `study.toml`: added, changed and removed; comments, order and everything else stay.

use std::path::Path;

use toml_edit::{ArrayOfTables, DocumentMut, Item, Table, TableLike, Value, value};

use super::error::StudyError;
use super::{ModeChoice, STUDY_FILE, Study};
use crate::files::write_whole;

/// An effect as it is to stand in `study.toml`.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectEntry {
    /// The kind.
    pub kind: String,
    /// The part after the @.
    pub location: Option<String>,
    /// Parameters: name, value, standard deviation.
    pub parameters: Vec<(String, f64, Option<f64>)>,
}

/// Makes `entries` the effects of the study in `folder`; those that are there already keep their place and comments.
///
/// The file is replaced whole, so that it is never half there.
///
/// # Errors
/// When the file cannot be read or written, or would no longer be a study.
pub fn set_effects(folder: &Path, entries: &[EffectEntry]) -> Result<(), StudyError> {
    edit(folder, |text| with_effects(text, entries))
}

/// Makes `choice` the study's choice of modes: `modes_hz`, `add_modes_hz`, `drop_modes_hz` and `mode_bands_hz` in `[analysis]`;
/// an empty list is taken out.
///
/// # Errors
/// As [`set_effects`].
pub fn set_mode_choice(folder: &Path, choice: &ModeChoice) -> Result<(), StudyError> {
    edit(folder, |text| with_choice(text, choice))
}

/// A sensor's calibration as it is to stand in `study.toml`.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationEntry {
    /// The sensor's setup.
    pub setup: String,
    /// Its channel.
    pub channel: String,
    /// What its readings are multiplied by, with the standard deviation.
    pub gain: f64,
    /// Its standard deviation.
    pub gain_std: f64,
    /// What it reads without acceleration, in m/s².
    pub offset_m_s2: f64,
}

/// Gives sensors of the study in `folder` their gains and offsets, in place of earlier ones; comments stay.
///
/// # Errors
/// As [`set_effects`].
pub fn set_calibration(folder: &Path, entries: &[CalibrationEntry]) -> Result<(), StudyError> {
    edit(folder, |text| with_calibration(text, entries))
}

/// Changes `study.toml` where what it comes to is a study.
fn edit(folder: &Path, change: impl FnOnce(&str) -> Result<String, String>) -> Result<(), StudyError> {
    let file = folder.join(STUDY_FILE);
    let text = std::fs::read_to_string(&file).map_err(|source| StudyError::Read { file: file.clone(), source })?;
    let changed = change(&text)
        .map(|changed| with_line_ends_of(&text, changed))
        .map_err(|message| StudyError::Syntax { file: file.clone(), line: 1, message })?;
    Study::from_text(&changed, folder)?;
    write_whole(&file, changed.as_bytes()).map_err(|source| StudyError::Write { file, source })
}

/// The text with the line ends, and the byte order mark, that an editor gave the file before.
pub(crate) fn with_line_ends_of(before: &str, text: String) -> String {
    const MARK: char = '\u{feff}';
    let is_windows = before.contains("\r\n") && !before.replace("\r\n", "").contains('\n');
    let text = if is_windows { text.replace("\r\n", "\n").replace('\n', "\r\n") } else { text };
    if before.starts_with(MARK) && !text.starts_with(MARK) { format!("{MARK}{text}") } else { text }
}

fn with_choice(text: &str, choice: &ModeChoice) -> Result<String, String> {
    let mut document: DocumentMut = text.parse().map_err(|error: toml_edit::TomlError| error.to_string())?;
    let section = document.entry("analysis").or_insert(Item::Table(Table::new()));
    let analysis = section.as_table_like_mut().ok_or("[analysis] is no table")?;
    let only = choice.only_hz.as_deref().unwrap_or_default();
    for (key, frequencies) in [("modes_hz", only), ("add_modes_hz", &choice.add_hz), ("drop_modes_hz", &choice.drop_hz)]
    {
        if frequencies.is_empty() {
            analysis.remove(key);
        } else {
            analysis.insert(key, value(frequencies.iter().copied().collect::<toml_edit::Array>()));
        }
    }
    if choice.bands_hz.is_empty() {
        analysis.remove("mode_bands_hz");
    } else {
        let bands = choice.bands_hz.iter().map(|band| Value::from_iter(*band));
        analysis.insert("mode_bands_hz", value(bands.collect::<toml_edit::Array>()));
    }
    Ok(document.to_string())
}

fn with_calibration(text: &str, entries: &[CalibrationEntry]) -> Result<String, String> {
    let mut document: DocumentMut = text.parse().map_err(|error: toml_edit::TomlError| error.to_string())?;
    for setup in tables(document.get_mut("setup")) {
        let Some(name) = setup.get("name").and_then(Item::as_str).map(str::to_owned) else { continue };
        for sensor in tables(setup.get_mut("sensor")) {
            let channel = sensor.get("channel").and_then(Item::as_str);
            let of_sensor = |entry: &&CalibrationEntry| entry.setup == name && channel == Some(&entry.channel);
            let Some(entry) = entries.iter().find(of_sensor) else { continue };
            let values = [("gain", entry.gain), ("gain_std", entry.gain_std), ("offset_m_s2", entry.offset_m_s2)];
            for (key, number) in values {
                put(sensor, key, float(number));
            }
        }
    }
    Ok(document.to_string())
}

/// The tables of an array, in either way of writing them.
fn tables(item: Option<&mut Item>) -> Vec<&mut dyn TableLike> {
    match item {
        Some(Item::ArrayOfTables(tables)) => tables.iter_mut().map(|table| table as &mut dyn TableLike).collect(),
        Some(Item::Value(Value::Array(values))) => values
            .iter_mut()
            .filter_map(|value| value.as_inline_table_mut().map(|table| table as &mut dyn TableLike))
            .collect(),
        _ => Vec::new(),
    }
}

fn with_effects(text: &str, entries: &[EffectEntry]) -> Result<String, String> {
    let mut document: DocumentMut = text.parse().map_err(|error: toml_edit::TomlError| error.to_string())?;
    let model = document.get_mut("model").and_then(Item::as_table_like_mut).ok_or("there is no [model]")?;
    if entries.is_empty() {
        model.remove("effect");
        return Ok(document.to_string());
    }
    let old = match model.get("effect") {
        Some(Item::ArrayOfTables(tables)) => tables.clone(),
        _ => ArrayOfTables::new(),
    };
    let mut tables = ArrayOfTables::new();
    let mut taken = vec![false; old.len()];
    for entry in entries {
        let same = |table: &Table| {
            let text = |key: &str| table.get(key).and_then(Item::as_str);
            text("kind") == Some(&entry.kind) && text("where") == entry.location.as_deref()
        };
        let known = old.iter().enumerate().position(|(index, table)| !taken[index] && same(table));
        let mut table = match known.and_then(|index| Some((index, old.get(index)?))) {
            Some((index, table)) => {
                taken[index] = true;
                table.clone()
            }
            None => Table::new(),
        };
        fill(&mut table, entry);
        tables.push(table);
    }
    model.insert("effect", Item::ArrayOfTables(tables));
    Ok(document.to_string())
}

/// Writes an effect into its table; values that are there keep their comments.
fn fill(table: &mut Table, entry: &EffectEntry) {
    let mut pairs = vec![("kind".to_owned(), Value::from(entry.kind.as_str()))];
    pairs.extend(entry.location.as_ref().map(|location| ("where".to_owned(), Value::from(location.as_str()))));
    let single = entry.parameters.len() == 1;
    for (name, number, std) in &entry.parameters {
        let name = if single { "value" } else { name };
        pairs.push((name.to_owned(), float(*number)));
        if let Some(std) = std {
            pairs.push((if single { "std".to_owned() } else { format!("{name}_std") }, float(*std)));
        }
    }
    let wanted: Vec<&str> = pairs.iter().map(|(key, _)| key.as_str()).collect();
    let stale: Vec<String> =
        table.iter().map(|(key, _)| key.to_owned()).filter(|key| !wanted.contains(&key.as_str())).collect();
    for key in stale {
        table.remove(&key);
    }
    for (key, new) in pairs {
        put(table, &key, new);
    }
}

/// Puts a value into a table; one that is there keeps its comment.
fn put(table: &mut dyn TableLike, key: &str, mut new: Value) {
    if let Some(old) = table.get(key).and_then(Item::as_value) {
        *new.decor_mut() = old.decor().clone();
    }
    table.insert(key, value(new));
}

/// A number with seven digits, with an exponent where it is far from 1: values are known to a few.
fn float(number: f64) -> Value {
    let rounded: f64 = format!("{number:.6e}").parse().unwrap_or(number);
    let text = if rounded == 0.0 || (1e-3..1e7).contains(&rounded.abs()) {
        format!("{rounded:?}")
    } else {
        format!("{rounded:e}")
    };
    text.parse().unwrap_or_else(|_| Value::from(number))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::band_at;

    const STUDY: &str = "# my tower\n[structure]\nname = \"t\" # short\n\n[[setup]]\nname = \"a\"\nfiles = [\"a.npy\"]\nsampling_rate_hz = 50\nunit = \"m/s2\"\n[[setup.sensor]]\nchannel = \"1\"\nnode = 1\n\n[model]\nbeam = \"beam.csv\" # mine\n\n# soil, see report 3\n[[model.effect]]\nkind = \"base-rotation\"\nvalue = 1e-15 # first guess\n";

    fn entry(kind: &str, location: Option<&str>, parameters: &[(&str, f64, Option<f64>)]) -> EffectEntry {
        let parameters = parameters.iter().map(|(name, value, std)| ((*name).to_owned(), *value, *std)).collect();
        EffectEntry { kind: kind.to_owned(), location: location.map(str::to_owned), parameters }
    }

    #[test]
    fn effects_are_added_changed_and_removed_and_comments_stay() {
        let base = entry("base-rotation", None, &[("flexibility", 7.2104999e-15, Some(1.5e-16))]);
        let mass = entry("added-mass", Some("443.6m"), &[("mass", 2e5, None)]);
        let both = with_effects(STUDY, &[base.clone(), mass.clone()]).unwrap();
        for kept in ["# my tower", "name = \"t\" # short", "# mine", "# soil, see report 3", "# first guess"] {
            assert!(both.contains(kept), "{kept} is gone:\n{both}");
        }
        assert!(both.contains("value = 7.2105e-15 # first guess") && both.contains("std = 1.5e-16"), "{both}");
        let study = Study::from_text(&both, Path::new("s")).unwrap();
        let model = study.model.unwrap();
        assert_eq!(model.effects.len(), 2);
        assert_eq!(
            (model.effects[1].kind.as_str(), model.effects[1].location.as_deref()),
            ("added-mass", Some("443.6m"))
        );
        assert_eq!(model.effects[1].parameters["value"].as_float(), Some(2e5));

        let one = with_effects(&both, &[mass]).unwrap();
        assert!(!one.contains("base-rotation") && one.contains("added-mass"));
        let none = with_effects(&one, &[]).unwrap();
        assert!(!none.contains("model.effect") && none.contains("# mine"));
    }

    #[test]
    fn a_calibration_goes_to_its_sensor_in_place_of_an_earlier_one_and_comments_stay() {
        let entry = |setup: &str, channel: &str, gain| CalibrationEntry {
            setup: setup.to_owned(),
            channel: channel.to_owned(),
            gain,
            gain_std: 1.5e-4,
            offset_m_s2: -0.2,
        };
        let text = with_calibration(STUDY, &[entry("a", "1", 1.023), entry("b", "1", 2.0)]).unwrap();
        assert!(text.contains("# my tower") && text.contains("# first guess"), "{text}");
        let sensor = &Study::from_text(&text, Path::new("s")).unwrap().setups[0].sensors[0];
        let found = (sensor.gain, sensor.gain_std, sensor.offset_m_s2);
        assert_eq!(found, (Some(1.023), Some(1.5e-4), Some(-0.2)));
        let text = text.replace("gain = 1.023", "gain = 1.023 # of March");
        let again = with_calibration(&text, &[entry("a", "1", 1.024)]).unwrap();
        assert!(again.contains("gain = 1.024 # of March"), "{again}");
        assert_eq!(again.matches("gain_std").count(), 1);
        let inline = STUDY
            .replace("[[setup.sensor]]\nchannel = \"1\"\nnode = 1\n", "sensor = [{ channel = \"1\", node = 1 }]\n");
        let text = with_calibration(&inline, &[entry("a", "1", 0.97)]).unwrap();
        assert_eq!(Study::from_text(&text, Path::new("s")).unwrap().setups[0].sensors[0].gain, Some(0.97));
    }

    #[cfg(unix)]
    #[test]
    fn a_study_that_is_a_link_of_a_private_file_with_windows_line_ends_stays_so() {
        use std::os::unix::fs::{PermissionsExt, symlink};

        let (folder, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let real = elsewhere.path().join("tower.toml");
        std::fs::write(&real, STUDY.replace('\n', "\r\n")).unwrap();
        std::fs::set_permissions(&real, std::fs::Permissions::from_mode(0o600)).unwrap();
        let file = folder.path().join(STUDY_FILE);
        symlink(&real, &file).unwrap();
        set_effects(folder.path(), &[entry("added-mass", Some("443.6m"), &[("mass", 2e5, None)])]).unwrap();
        assert!(file.symlink_metadata().unwrap().is_symlink());
        assert_eq!(real.metadata().unwrap().permissions().mode() & 0o777, 0o600);
        let text = std::fs::read_to_string(&real).unwrap();
        assert!(text.contains("added-mass") && !text.replace("\r\n", "").contains('\n'), "{text}");
    }

    #[test]
    fn the_choice_of_modes_is_read_back_and_goes_where_nothing_is_chosen() {
        let mut choice = ModeChoice { add_hz: vec![1.28], ..ModeChoice::default() };
        choice.fit_to(0.366, Some([0.35, 0.38])).unwrap();
        choice.fit_to(0.14, Some([0.13, 0.15])).unwrap();
        let text = with_choice(STUDY, &choice).unwrap();
        assert!(text.contains("# my tower") && text.contains("# first guess"), "{text}");
        assert_eq!(Study::from_text(&text, Path::new("s")).unwrap().analysis.modes, choice);
        assert_eq!(band_at(&choice.bands_hz, 0.37), Some([0.35, 0.38]));
        // Another band of the same mode takes the place of its first.
        choice.fit_to(0.366, Some([0.36, 0.37])).unwrap();
        assert_eq!(choice.bands_hz, [[0.13, 0.15], [0.36, 0.37]]);
        assert!(choice.fit_to(0.5, Some([0.36, 0.37])).unwrap_err().contains("does not lie between"));
        assert!(choice.fit_to(0.5, Some([0.365, 0.6])).unwrap_err().contains("another mode is fitted"));
        choice.fit_to(0.366, None).unwrap();
        choice.fit_to(0.14, None).unwrap();
        choice.add_hz.clear();
        let text = with_choice(&text, &choice).unwrap();
        assert!(!text.contains("mode_bands_hz") && !text.contains("add_modes_hz"), "{text}");
        for bad in ["[[0.2, 0.1]]", "[[0.1, 0.2, 0.3]]", "[[0.1, 0.2], [0.15, 0.3]]", "[0.1, 0.2]"] {
            let text = format!("[analysis]\nmode_bands_hz = {bad}\n{STUDY}");
            let error = Study::from_text(&text, Path::new("s")).unwrap_err().to_string();
            assert!(error.contains("mode_bands_hz") && error.contains("line 2"), "{bad}: {error}");
        }
    }

    #[test]
    fn two_values_and_none_are_read_back() {
        let axes =
            entry("base-rotation", None, &[("flexibility_x", 1e-15, Some(1e-17)), ("flexibility_y", 2e-15, None)]);
        let swap = entry("sensor-swap", Some("ch01+ch02"), &[]);
        let text = with_effects(STUDY, &[axes, swap]).unwrap();
        let model = Study::from_text(&text, Path::new("s")).unwrap().model.unwrap();
        let values: Vec<_> = model.effects[0]
            .parameters
            .iter()
            .map(|(name, value)| (name.as_str(), value.as_float().unwrap()))
            .collect();
        assert_eq!(values, [("flexibility_x", 1e-15), ("flexibility_x_std", 1e-17), ("flexibility_y", 2e-15)]);
        assert_eq!(model.effects[1].location.as_deref(), Some("ch01+ch02"));
        assert!(model.effects[1].parameters.is_empty());
    }
}
