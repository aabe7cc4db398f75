//! From the text of `study.toml` to its types: every key read once, every single value checked on the way.

use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use toml::de::DeTable;

use super::alarms::{Alarms, alarms};
use super::check;
use super::error::StudyError;
use super::section::{Entry, Section, Source, line_of};
use super::types::{
    Analysis, CustomSource, Direction, Drawing, Effect, GroupTerms, LayoutFile, MatrixSource, MatrixTerm,
    MeasuredSource, ModeChoice, Model, ModelSource, NO_KINDS, RunSource, STUDY_FILE, Sensor, Setup, Structure, Study,
    Unit,
};
use crate::archive::TimeRange;
use crate::model::effect::KINDS;
use crate::model::is_numbered;

const STUDY_KEYS: &[&str] = &["structure", "setup", "sensor", "measured", "analysis", "model", "alarms"];
const STRUCTURE_KEYS: &[&str] = &["name", "place_deg"];
const SETUP_KEYS: &[&str] = &[
    "name",
    "files",
    "variable",
    "live",
    "sampling_rate_hz",
    "block_s",
    "utc_offset_h",
    "unit",
    "temperature",
    "sensor",
];
const SENSOR_KEYS: &[&str] = &[
    "channel",
    "point",
    "node",
    "elevation_m",
    "azimuth_deg",
    "inclination_deg",
    "offset_m",
    "reference",
    "unit",
    "sensitivity_v_per_m_s2",
    "gain",
    "gain_std",
    "offset_m_s2",
    "dof",
    "model_node",
];
const ANALYSIS_KEYS: &[&str] =
    &["band_hz", "decimated_rate_hz", "segment", "modes_hz", "add_modes_hz", "drop_modes_hz", "mode_bands_hz"];
const MEASURED_KEYS: &[&str] = &["modes"];
const MATRICES_KEYS: &[&str] = &["file", "stiffness", "mass", "nodes", "dofs"];
const CUSTOM_KEYS: &[&str] = &["name", "file", "stiffness", "mass", "segments", "least", "greatest", "typical"];
const GROUP_KEYS: &[&str] = &[
    "name",
    "file",
    "stiffness",
    "mass",
    "segments",
    "std",
    "z_m",
    "least",
    "greatest",
    "typical",
    "tied_to",
    "channels",
];
const RUN_KEYS: &[&str] = &["changed", "by", "quantity", "modes"];
const MODEL_KEYS: &[&str] = &[
    "beam",
    "matrices",
    "modes",
    "run",
    "background_stiffness",
    "background_mass",
    "correlation_length_m",
    "effect",
    "custom",
    "group",
    "prior_odds",
    "points",
    "lines",
    "surfaces",
];

/// Reads and checks a whole study.
pub(super) fn study(text: &str, folder: &Path) -> Result<Study, StudyError> {
    let file = folder.join(STUDY_FILE);
    let document = DeTable::parse(text).map_err(|error| StudyError::Syntax {
        file: file.clone(),
        // An error without a span is about what is missing at the end.
        line: line_of(text.as_bytes(), error.span().map_or(text.len(), |span| span.start)),
        message: error.message().to_owned(),
    })?;
    let document = Section::document(Source { file: &file, text }, &document);
    document.allow_only(STUDY_KEYS)?;

    let structure = structure(
        &document
            .required("structure", "a [structure] section with the structure's name")?
            .section("a section, written [structure]")?,
    )?;
    let setup_sections = document.tables("setup")?;
    let setups = setup_sections.iter().map(setup).collect::<Result<Vec<_>, _>>()?;
    let measured = measured(&document, &setup_sections)?;
    if setups.is_empty() && measured.is_none() {
        return Err(StudyError::NothingMeasured { file });
    }
    check::setups(&setups, &setup_sections)?;

    let analysis = match document.get("analysis") {
        Some(entry) => {
            let section = entry.section("a section, written [analysis]")?;
            let analysis = analysis(&section)?;
            check::analysis(&analysis, &section, &setups)?;
            analysis
        }
        None => Analysis::default(),
    };

    let section = document.get("model").map(|entry| entry.section("a section, written [model]")).transpose()?;
    let model = section.as_ref().map(model).transpose()?;
    let alarms = match document.get("alarms") {
        Some(entry) => alarms(&entry.section("a section, written [alarms.email] or [alarms.mqtt]")?)?,
        None => Alarms::default(),
    };
    let folder = folder.to_owned();
    let study = Study { folder, structure, setups, measured, analysis, model, alarms, range: TimeRange::ALL };
    if let Some(section) = section {
        check::channels_of_groups(&study.sensors(), &section.tables("group")?)?;
    }
    Ok(study)
}

/// `[measured]` with its `[[sensor]]`s; a study has these or setups.
fn measured(document: &Section<'_>, setups: &[Section<'_>]) -> Result<Option<MeasuredSource>, StudyError> {
    const MODES: &str = "the name of a file of modes, in quotes, such as \"modes.csv\"";
    let sections = sensor_tables(document)?;
    let Some(entry) = document.get("measured") else {
        return match (sections.first(), setups.is_empty()) {
            (Some(section), false) => Err(StudyError::SensorOutsideSetup { position: section.position() }),
            (Some(_), true) => {
                Err(document.missing("measured", "[measured] with modes = \"modes.csv\", the modes of these sensors"))
            }
            (None, _) => Ok(None),
        };
    };
    if let Some(setup) = setups.first() {
        return Err(StudyError::MeasuredTwice { position: entry.position(), setup_line: setup.position().line });
    }
    let section = entry.section("a section, written [measured]")?;
    section.allow_only(MEASURED_KEYS)?;
    let modes = PathBuf::from(section.required("modes", MODES)?.text(MODES)?);
    let sensors = sections.iter().map(|section| sensor(section, false)).collect::<Result<Vec<_>, _>>()?;
    check::places(&sensors, &sections)?;
    Ok(Some(MeasuredSource { modes, sensors }))
}

/// Sensors of one measurement: spectra are kept of each against each.
const MOST_SENSORS: usize = 4096;

fn sensor_tables<'a>(section: &Section<'a>) -> Result<Vec<Section<'a>>, StudyError> {
    let tables = section.tables("sensor")?;
    match tables.first() {
        Some(first) if tables.len() > MOST_SENSORS => {
            let (position, found, most) = (first.position(), tables.len(), MOST_SENSORS);
            Err(StudyError::TooManySensors { position, found, most })
        }
        _ => Ok(tables),
    }
}

fn structure(section: &Section<'_>) -> Result<Structure, StudyError> {
    section.allow_only(STRUCTURE_KEYS)?;
    const NAME: &str = "the structure's name, in quotes";
    const PLACE: &str = "latitude and longitude in degrees, north and east above zero, such as [46.52, 6.63]";
    let name = section.required("name", NAME)?.text(NAME)?;
    let place_deg = section.get("place_deg").map(|entry| {
        let [latitude, longitude] = entry.pair(PLACE)?;
        let is_on_earth = latitude.abs() <= 90.0 && longitude.abs() <= 180.0;
        if is_on_earth { Ok([latitude, longitude]) } else { Err(entry.out_of_range(PLACE)) }
    });
    Ok(Structure { name, place_deg: place_deg.transpose()? })
}

fn setup(section: &Section<'_>) -> Result<Setup, StudyError> {
    section.allow_only(SETUP_KEYS)?;
    const NAME: &str = "a name for the setup, in quotes, such as \"january\"";
    const FILES: &str = "a list of file names or patterns, such as [\"day1_*.csv\"]";
    const NO_FILES: &str = "left out where `live` is true: windows come from the nodes, not from files";
    const VARIABLE: &str = "the name of a variable in the MATLAB file, in quotes";
    const RATE: &str = "the recording's rows per second, a number above 0";
    const TEMPERATURE: &str = "the name of a CSV table with time_s and temperature_degc, in quotes";

    let name = section.required("name", NAME)?.text(NAME)?;
    let live = section.get("live").map_or(Ok(false), |entry| entry.boolean())?;
    for (key, expected) in [("files", NO_FILES), ("variable", NO_FILES)] {
        if let Some(entry) = section.get(key).filter(|_| live) {
            return Err(entry.out_of_range(expected));
        }
    }
    let files = if live { Vec::new() } else { file_patterns(&section.required("files", FILES)?, FILES)? };
    let variable = section.get("variable").map(|entry| entry.text(VARIABLE)).transpose()?;
    let sampling_rate_hz = section.required("sampling_rate_hz", RATE)?.positive(RATE)?;
    let block_s = section.get("block_s").map(|entry| entry.positive(BLOCK)).transpose()?;
    if let Some(entry) = section.get("block_s").filter(|_| live) {
        return Err(entry.out_of_range(NO_FILES));
    }
    let utc_offset_h = section.get("utc_offset_h").map(|entry| utc_offset(&entry)).transpose()?;
    let unit = match section.get("unit") {
        // Nodes send accelerations.
        None if live => Unit::MetrePerSecondSquared,
        Some(entry) if live && unit(&entry, UNIT)? != Unit::MetrePerSecondSquared => {
            return Err(entry.out_of_range("\"m/s2\", in which nodes measure, or left out, where `live` is true"));
        }
        _ => unit(&section.required("unit", UNIT)?, UNIT)?,
    };
    let temperature = section.get("temperature").map(|entry| entry.text(TEMPERATURE)).transpose()?.map(PathBuf::from);

    let sensor_sections = sensor_tables(section)?;
    if sensor_sections.is_empty() {
        let expected = "one [[setup.sensor]] for each channel of the recording, below the setup's own keys";
        return Err(section.missing("sensor", expected));
    }
    let mut sensors = sensor_sections.iter().map(|section| sensor(section, true)).collect::<Result<Vec<_>, _>>()?;
    if matches!(unit, Unit::Radian | Unit::Strain) {
        // A model needs to know of each sensor that it is not of a point's motion.
        sensors.iter_mut().for_each(|sensor| sensor.unit = sensor.unit.or(Some(unit)));
    }
    let setup =
        Setup { name, files, live, variable, sampling_rate_hz, block_s, utc_offset_h, unit, temperature, sensors };
    check::sensors(&setup, &sensor_sections)?;
    Ok(setup)
}

/// What a block's length is.
const BLOCK: &str = "the length in s of the blocks that each file is joined of";

fn file_patterns(entry: &Entry<'_>, expected: &'static str) -> Result<Vec<String>, StudyError> {
    let entries = entry.list(expected)?;
    if entries.is_empty() {
        return Err(entry.out_of_range(expected));
    }
    entries
        .iter()
        .map(|entry| {
            let pattern = entry.text(expected)?;
            match glob::Pattern::new(&pattern) {
                Ok(_) => Ok(pattern),
                Err(source) => Err(StudyError::Pattern { position: entry.position(), pattern, source }),
            }
        })
        .collect()
}

/// Hours by which a logger's clock is ahead of UTC: no place on Earth is further.
fn utc_offset(entry: &Entry<'_>) -> Result<f64, StudyError> {
    const OFFSET: &str = "hours by which the logger's clock is ahead of UTC, from -12 to 14, such as 1.0";
    let hours = entry.number(OFFSET)?;
    if (-12.0..=14.0).contains(&hours) { Ok(hours) } else { Err(entry.out_of_range(OFFSET)) }
}

const UNIT: &str = "one of \"m/s2\", \"g\", \"V\", \"m/s\", \"m\", \"rad\" and \"strain\"";

fn unit(entry: &Entry<'_>, expected: &'static str) -> Result<Unit, StudyError> {
    Unit::of_word(&entry.text(expected)?)
        .ok_or_else(|| StudyError::UnknownUnit { position: entry.position(), found: entry.written() })
}

/// `sampled`: by a node, as the sensors of a setup are.
fn sensor(section: &Section<'_>, sampled: bool) -> Result<Sensor, StudyError> {
    section.allow_only(SENSOR_KEYS)?;
    const CHANNEL: &str = "the column's name or its 1-based position, in quotes, such as \"01\"";
    const POINT: &str = "a name for the measurement point, in quotes";
    const NODE: &str = "the number of the sensor node that samples the channel, from 1 to 65535";
    const ELEVATION: &str = "a height in metres";
    const OFFSET: &str = "the plan position from the beam axis in metres, such as [-6.32, 3.65]";
    const SENSITIVITY: &str = "volts per m/s², a number above 0 (for a sensor mounted backwards turn `azimuth_deg`)";
    const GAIN_STD: &str = "the standard deviation of `gain`, a number above 0";
    const OFFSET_M_S2: &str = "what the sensor reads without acceleration, in m/s²";
    const DOF: &str = "the 1-based row of the model's matrices, a whole number from 1";

    let optional_number = |key, expected| section.get(key).map(|entry: Entry<'_>| entry.number(expected)).transpose();
    let channel = section.required("channel", CHANNEL)?.text(CHANNEL)?;
    let point = match section.get("point") {
        Some(entry) => entry.text(POINT)?,
        None => channel.clone(),
    };
    let node = match section.get("node") {
        // The range makes the conversion lossless.
        Some(entry) => entry.whole(1..65536, NODE)? as u16,
        None if sampled => return Err(section.missing("node", NODE)),
        None => 0,
    };
    const MODEL_NODE: &str = "the name of a node of the model, in quotes, such as \"B3\"";
    const NO_PLACE: &str = "left out beside model_node, which says where the sensor stands";
    let model_node = section.get("model_node").map(|entry| entry.text(MODEL_NODE)).transpose()?;
    for key in ["elevation_m", "offset_m", "dof"] {
        if let Some(entry) = section.get(key).filter(|_| model_node.is_some()) {
            return Err(entry.out_of_range(NO_PLACE));
        }
    }
    let dof = section.get("dof").map(|entry| entry.whole(1..i64::from(u32::MAX), DOF)).transpose()?;
    Ok(Sensor {
        channel,
        point,
        node,
        elevation_m: optional_number("elevation_m", ELEVATION)?,
        direction: direction_of(section)?,
        offset_m: section.get("offset_m").map_or(Ok([0.0, 0.0]), |entry| entry.pair(OFFSET))?,
        reference: section.get("reference").map_or(Ok(false), |entry| entry.boolean())?,
        unit: own_unit(section, sampled)?,
        sensitivity_v_per_m_s2: section
            .get("sensitivity_v_per_m_s2")
            .map(|entry| entry.positive(SENSITIVITY))
            .transpose()?,
        gain: gain_of(section, sampled)?,
        gain_std: of_readings(section, "gain_std", sampled)?.map(|entry| entry.positive(GAIN_STD)).transpose()?,
        offset_m_s2: of_readings(section, "offset_m_s2", sampled)?
            .map(|entry| entry.number(OFFSET_M_S2))
            .transpose()?,
        dof: dof.map(|dof| dof as usize),
        model_node,
    })
}

/// What is said of a sensor's readings; what was identified elsewhere has none.
fn of_readings<'a>(section: &Section<'a>, key: &str, sampled: bool) -> Result<Option<Entry<'a>>, StudyError> {
    match section.get(key) {
        Some(entry) if !sampled => Err(entry.out_of_range("left out: shapes from elsewhere are taken as they are")),
        entry => Ok(entry),
    }
}

/// A sensor's gain.
fn gain_of(section: &Section<'_>, sampled: bool) -> Result<Option<f64>, StudyError> {
    const GAIN: &str = "a number from 0.5 to 2 that the readings are multiplied by";
    let Some(entry) = of_readings(section, "gain", sampled)? else { return Ok(None) };
    let gain = entry.positive(GAIN)?;
    // Beyond that it is a unit, or a mistake.
    if (0.5..=2.0).contains(&gain) { Ok(Some(gain)) } else { Err(entry.out_of_range(GAIN)) }
}

/// A sensor's own unit; modes that were identified elsewhere have none.
fn own_unit(section: &Section<'_>, sampled: bool) -> Result<Option<Unit>, StudyError> {
    match section.get("unit") {
        Some(entry) if !sampled => {
            match unit(&entry, UNIT)? {
                rotation @ (Unit::Radian | Unit::Strain) => Ok(Some(rotation)),
                _ => Err(entry
                    .out_of_range("left out, or \"rad\" or \"strain\": shapes of all other units are displacements")),
            }
        }
        entry => entry.map(|entry| unit(&entry, UNIT)).transpose(),
    }
}

fn direction_of(section: &Section<'_>) -> Result<Option<Direction>, StudyError> {
    const INCLINATION: &str = "degrees above the horizontal, from -90 to 90, beside an azimuth_deg in degrees";
    let horizontal = section.get("azimuth_deg").map(|entry| direction(&entry)).transpose()?;
    let Some(entry) = section.get("inclination_deg") else { return Ok(horizontal) };
    let inclination_deg = entry.number(INCLINATION)?;
    match horizontal {
        Some(Direction::AzimuthDeg(azimuth_deg)) if (-90.0..=90.0).contains(&inclination_deg) => {
            Ok(Some(Direction::Inclined { azimuth_deg, inclination_deg }))
        }
        _ => Err(entry.out_of_range(INCLINATION)),
    }
}

fn direction(entry: &Entry<'_>) -> Result<Direction, StudyError> {
    const AZIMUTH: &str = "degrees anticlockwise from +X seen from above, or \"up\" for a vertical sensor";
    if !entry.is_text() {
        return Ok(Direction::AzimuthDeg(entry.number(AZIMUTH)?));
    }
    match entry.text(AZIMUTH)?.as_str() {
        "up" => Ok(Direction::Up),
        _ => Err(entry.out_of_range(AZIMUTH)),
    }
}

fn analysis(section: &Section<'_>) -> Result<Analysis, StudyError> {
    section.allow_only(ANALYSIS_KEYS)?;
    const BAND: &str = "the lowest and highest frequency of interest in Hz, both above 0, such as [0.05, 1.5]";
    const RATE: &str = "the sampling rate after decimation in Hz, a number above 0";
    const SEGMENT: &str = "a power of two from 256 to 65536 points, up to 4096 where nodes transform them";

    let band_hz = match section.get("band_hz") {
        Some(entry) => {
            let band = entry.pair(BAND)?;
            // Line 0 is the mean, which every sensor's offset drowns.
            if band.iter().any(|&end| end <= 0.0) {
                return Err(entry.out_of_range(BAND));
            }
            Some(band)
        }
        None => None,
    };
    let segment = match section.get("segment") {
        Some(entry) => {
            let segment = entry.whole(256..65_537, SEGMENT)? as usize;
            if !segment.is_power_of_two() {
                return Err(entry.out_of_range(SEGMENT));
            }
            Some(segment)
        }
        None => None,
    };
    let decimated_rate_hz = section.get("decimated_rate_hz").map(|entry| entry.positive(RATE)).transpose()?;
    Ok(Analysis { band_hz, decimated_rate_hz, segment, modes: mode_choice(section, band_hz)? })
}

/// The modes that the user adds, drops or fixes, all inside the band.
fn mode_choice(section: &Section<'_>, band_hz: Option<[f64; 2]>) -> Result<ModeChoice, StudyError> {
    const MODES: &str = "a list of frequencies in Hz within band_hz, each once, such as [0.138, 0.366]";
    const NO_MORE: &str = "left out beside modes_hz, which names all modes";
    let frequencies = |key| -> Result<Option<Vec<f64>>, StudyError> {
        let Some(entry) = section.get(key) else { return Ok(None) };
        let inside = |hz: f64| band_hz.is_none_or(|[low_hz, high_hz]| (low_hz..=high_hz).contains(&hz));
        let frequency = |entry: &Entry<'_>| {
            let hz = entry.positive(MODES)?;
            if inside(hz) { Ok(hz) } else { Err(entry.out_of_range(MODES)) }
        };
        let frequencies = entry.list(MODES)?.iter().map(frequency).collect::<Result<Vec<f64>, _>>()?;
        let twice = (1..frequencies.len()).any(|at| frequencies[..at].contains(&frequencies[at]));
        if frequencies.is_empty() || twice { Err(entry.out_of_range(MODES)) } else { Ok(Some(frequencies)) }
    };
    let only_hz = frequencies("modes_hz")?;
    if only_hz.is_some()
        && let Some(entry) = section.get("add_modes_hz").or_else(|| section.get("drop_modes_hz"))
    {
        return Err(entry.out_of_range(NO_MORE));
    }
    Ok(ModeChoice {
        only_hz,
        add_hz: frequencies("add_modes_hz")?.unwrap_or_default(),
        drop_hz: frequencies("drop_modes_hz")?.unwrap_or_default(),
        bands_hz: mode_bands(section)?,
    })
}

/// Bands of single modes, which do not overlap.
fn mode_bands(section: &Section<'_>) -> Result<Vec<[f64; 2]>, StudyError> {
    const BANDS: &str = "a list of bands in Hz that do not overlap, such as [[0.13, 0.15], [0.36, 0.4]]";
    let Some(entry) = section.get("mode_bands_hz") else { return Ok(Vec::new()) };
    let band = |entry: &Entry<'_>| {
        let ends = entry.list(BANDS)?.iter().map(|end| end.positive(BANDS)).collect::<Result<Vec<f64>, _>>()?;
        match ends[..] {
            [from, to] if from < to => Ok([from, to]),
            _ => Err(entry.out_of_range(BANDS)),
        }
    };
    let mut bands = entry.list(BANDS)?.iter().map(band).collect::<Result<Vec<[f64; 2]>, _>>()?;
    bands.sort_by(|a, b| a[0].total_cmp(&b[0]));
    if bands.windows(2).any(|pair| pair[0][1] > pair[1][0]) { Err(entry.out_of_range(BANDS)) } else { Ok(bands) }
}

fn model(section: &Section<'_>) -> Result<Model, StudyError> {
    section.allow_only(MODEL_KEYS)?;
    const BEAM: &str = "the name of a beam table, in quotes, such as \"beam.csv\"";
    const MATRICES: &str =
        "a table such as { file = \"model.mat\", stiffness = \"K\", mass = \"M\", nodes = \"nodes.csv\" }";
    const BACKGROUND: &str = "a relative standard deviation, a number above 0 and up to 1 such as 0.03, which is 3 %";
    const LENGTH: &str = "a length in metres, a number above 0";

    let optional_positive =
        |key, expected| section.get(key).map(|entry: Entry<'_>| entry.positive(expected)).transpose();
    let relative_std = |key| section.get(key).map(|entry: Entry<'_>| entry.relative_std(BACKGROUND)).transpose();
    const MODES: &str = "the name of a file of modes, in quotes, such as \"base.csv\"";
    let source = match (section.get("beam"), section.get("matrices"), section.get("modes")) {
        (Some(beam), None, None) => ModelSource::Beam(PathBuf::from(beam.text(BEAM)?)),
        (None, Some(matrices), None) => ModelSource::Matrices(matrix_source(&matrices.section(MATRICES)?)?),
        (None, None, Some(modes)) => ModelSource::Modes(PathBuf::from(modes.text(MODES)?)),
        (None, None, None) => return Err(StudyError::ModelSource { position: section.position(), several: false }),
        _ => return Err(StudyError::ModelSource { position: section.position(), several: true }),
    };
    let (customs, runs) = customs(section, &source)?;
    Ok(Model {
        runs,
        source,
        background_stiffness: relative_std("background_stiffness")?,
        background_mass: relative_std("background_mass")?,
        correlation_length_m: optional_positive("correlation_length_m", LENGTH)?,
        effects: section.tables("effect")?.iter().map(effect).collect::<Result<Vec<_>, _>>()?,
        customs,
        prior_odds: section.get("prior_odds").map_or(Ok(Vec::new()), |entry| prior_odds(&entry))?,
        drawing: drawing(section)?,
    })
}

/// Tables of what the structure looks like.
fn drawing(section: &Section<'_>) -> Result<Drawing, StudyError> {
    const TABLE: &str = "the name of a CSV file, in quotes, such as \"lines.csv\"";
    let path = |key| section.get(key).map(|entry: Entry<'_>| entry.text(TABLE).map(PathBuf::from)).transpose();
    Ok(Drawing { points: path("points")?, lines: path("lines")?, surfaces: path("surfaces")? })
}

/// Odds by the name of a kind, of a sound model (`adequate`) or of something else.
fn prior_odds(entry: &Entry<'_>) -> Result<Vec<(String, f64)>, StudyError> {
    static NAMES: LazyLock<Vec<&'static str>> =
        LazyLock::new(|| KINDS.iter().map(|kind| kind.name()).chain(NO_KINDS).collect());
    const TABLE: &str =
        "a table of odds such as { base-rotation = 4, outrigger = 0.1, adequate = 20, something-else = 0.05 }";
    const ODDS: &str = "odds, a number above 0 such as 0.1";
    let section = entry.section(TABLE)?;
    section.allow_only(NAMES.as_slice())?;
    let odds = |name: &&'static str| section.get(name).map(|entry| Ok(((*name).to_owned(), entry.positive(ODDS)?)));
    NAMES.iter().filter_map(odds).collect()
}

fn matrix_source(section: &Section<'_>) -> Result<MatrixSource, StudyError> {
    section.allow_only(MATRICES_KEYS)?;
    const FILE: &str = "the name of a MATLAB, HDF5 or Nastran file, in quotes, such as \"model.mat\"";
    const STIFFNESS: &str =
        "the stiffness matrix: a name such as \"K\" or \"k.mtx\", or a list of names and [name, factor] pairs";
    const MASS: &str =
        "the mass matrix: a name such as \"M\" or \"m.mtx\", or a list of names and [name, factor] pairs";
    const LAYOUT: &str = "the name of a CSV or universal file, in quotes, such as \"nodes.csv\"";

    let path =
        |key, expected| section.get(key).map(|entry: Entry<'_>| entry.text(expected).map(PathBuf::from)).transpose();
    let layout = match (section.get("nodes"), path("dofs", LAYOUT)?) {
        (Some(_), Some(_)) => return Err(StudyError::LayoutTwice { position: section.position_of("dofs") }),
        (Some(nodes), None) => Some(nodes_of_layout(&nodes)?),
        (None, dofs) => dofs.map(LayoutFile::Dofs),
    };
    Ok(MatrixSource {
        file: path("file", FILE)?,
        stiffness: matrix_terms(&section.required("stiffness", STIFFNESS)?, STIFFNESS)?,
        mass: matrix_terms(&section.required("mass", MASS)?, MASS)?,
        layout,
    })
}

/// The file of a model's nodes; with a factor where its lengths are not in metres, which only one that has nodes by number may have.
fn nodes_of_layout(entry: &Entry<'_>) -> Result<LayoutFile, StudyError> {
    const NODES: &str = "the name of a CSV, universal or Nastran file, in quotes, such as \"nodes.csv\"; a universal or Nastran file may have a factor, [\"nodes.unv\", 0.001] where it is in mm";
    let (name, factor) = if entry.is_text() {
        (entry.text(NODES)?, None)
    } else {
        match entry.list(NODES)?.as_slice() {
            [name, factor] => (name.text(NODES)?, Some(factor.positive(NODES)?)),
            _ => return Err(entry.out_of_range(NODES)),
        }
    };
    let file = PathBuf::from(name);
    match (is_numbered(&file), factor) {
        (true, factor) => Ok(LayoutFile::Numbered { file, factor: factor.unwrap_or(1.0) }),
        (false, None) => Ok(LayoutFile::Nodes(file)),
        (false, Some(_)) => Err(entry.out_of_range(NODES)),
    }
}

/// A name, or a list of names and `[name, factor]` pairs.
fn matrix_terms(entry: &Entry<'_>, expected: &'static str) -> Result<Vec<MatrixTerm>, StudyError> {
    if entry.is_text() {
        return Ok(vec![MatrixTerm { name: entry.text(expected)?, factor: 1.0 }]);
    }
    let entries = entry.list(expected)?;
    if entries.is_empty() {
        return Err(entry.out_of_range(expected));
    }
    let term = |entry: &Entry<'_>| {
        if entry.is_text() {
            return Ok(MatrixTerm { name: entry.text(expected)?, factor: 1.0 });
        }
        match entry.list(expected)?.as_slice() {
            [name, factor] => Ok(MatrixTerm { name: name.text(expected)?, factor: factor.number(expected)? }),
            _ => Err(entry.out_of_range(expected)),
        }
    };
    entries.iter().map(term).collect()
}

/// Whether a word can stand after `custom@`: nothing that reads as a channel, a node, a height or a frequency.
fn is_name(word: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || c == '-' || c == '_';
    let reads_otherwise = word.starts_with("ch") || word.starts_with("node");
    word.starts_with(char::is_alphabetic) && word.chars().all(is_part) && !reads_otherwise
}

/// Hypotheses of the user's own, then groups of the model, each name once.
///
/// Each says itself what it changes, but in a model of modes, where runs do.
fn customs(section: &Section<'_>, source: &ModelSource) -> Result<(Vec<CustomSource>, Vec<RunSource>), StudyError> {
    const CONTENT: &str = "`stiffness`, `mass` or `segments`: what it changes";
    const BY_RUNS: &str =
        "neither `stiffness` nor `mass` nor `segments`: in a model of modes a [[model.run]] says what it changes";
    const HAS_RUN: &str =
        "a name that a [[model.run]] has as `changed`: nothing else says what it does to a model of modes";
    let (mut sections, groups) = (section.tables("custom")?, section.tables("group")?);
    let mut customs = sections.iter().map(custom).collect::<Result<Vec<_>, _>>()?;
    customs.extend(groups.iter().map(group).collect::<Result<Vec<_>, _>>()?);
    sections.extend(groups);
    let of_modes = matches!(source, ModelSource::Modes(_));
    let fault = |at: usize, expected| Err(sections[at].required("name", expected)?.out_of_range(expected));
    for (at, custom) in customs.iter().enumerate() {
        let says_itself = !custom.stiffness.is_empty() || !custom.mass.is_empty() || custom.segments.is_some();
        match (of_modes, says_itself) {
            (true, true) => return fault(at, BY_RUNS),
            (false, false) => return fault(at, CONTENT),
            _ => {}
        }
    }
    check::custom_names(&customs, &sections)?;
    check::ties(&customs, &sections)?;
    let runs = runs(section, &customs, of_modes)?;
    let has_run = |custom: &CustomSource| runs.iter().any(|run| run.changed == custom.name);
    match customs.iter().position(|custom| of_modes && !has_run(custom)) {
        Some(at) => fault(at, HAS_RUN),
        None => Ok((customs, runs)),
    }
}

/// What the user's own program computed with something changed: each run names a group or hypothesis.
fn runs(section: &Section<'_>, customs: &[CustomSource], of_modes: bool) -> Result<Vec<RunSource>, StudyError> {
    const ONLY_WITH_MODES: &str = "left out without [model] modes, the modes of the model as it is";
    let sections = section.tables("run")?;
    if let Some(entry) = section.get("run").filter(|_| !of_modes && !sections.is_empty()) {
        return Err(entry.out_of_range(ONLY_WITH_MODES));
    }
    let runs = sections.iter().map(|section| run(section, customs)).collect::<Result<Vec<_>, _>>()?;
    const ONE_QUANTITY: &str =
        "the same in all runs of one name: a group of stiffness and one of mass have names of their own";
    let first_of = |run: &RunSource| runs.iter().find(|other| other.changed == run.changed).map(|first| first.is_mass);
    if let Some((section, _)) = sections.iter().zip(&runs).find(|(_, run)| first_of(run) != Some(run.is_mass)) {
        let entry = section.get("quantity").map_or_else(|| section.required("changed", ONE_QUANTITY), Ok)?;
        return Err(entry.out_of_range(ONE_QUANTITY));
    }
    Ok(runs)
}

fn run(section: &Section<'_>, customs: &[CustomSource]) -> Result<RunSource, StudyError> {
    const CHANGED: &str = "the name of a [[model.group]] or [[model.custom]], in quotes";
    const BY: &str = "by how much it was changed, as a share of itself: a number such as 0.1 or -0.1, above -1 and 1e-6 to 1000 in size";
    const QUANTITY: &str = "\"stiffness\" or \"mass\"";
    const MODES: &str = "the name of a file of modes, in quotes, such as \"columns.csv\"";
    section.allow_only(RUN_KEYS)?;
    let changed = section.required("changed", CHANGED)?;
    let name = changed.text(CHANGED)?;
    if customs.iter().all(|custom| custom.name != name) {
        return Err(changed.out_of_range(CHANGED));
    }
    let by = section.required("by", BY)?;
    let change = by.number(BY)?;
    if change <= -1.0 || !(1e-6..=1e3).contains(&change.abs()) {
        return Err(by.out_of_range(BY));
    }
    let quantity = section.get("quantity");
    let is_mass = match quantity.as_ref().map(|entry| entry.text(QUANTITY)).transpose()?.as_deref() {
        None | Some("stiffness") => false,
        Some("mass") => true,
        Some(_) => return Err(section.required("quantity", QUANTITY)?.out_of_range(QUANTITY)),
    };
    let modes = PathBuf::from(section.required("modes", MODES)?.text(MODES)?);
    Ok(RunSource { line: section.position().line, changed: name, change, is_mass, modes })
}

fn custom(section: &Section<'_>) -> Result<CustomSource, StudyError> {
    section.allow_only(CUSTOM_KEYS)?;
    change_of_model(section)
}

fn group(section: &Section<'_>) -> Result<CustomSource, StudyError> {
    const STD: &str = "one relative standard deviation, a number above 0 and up to 1 such as 0.1, which is 10 %";
    const TIED: &str = "the name of another [[model.group]], in quotes";
    const OF_OTHER: &str = "left out beside tied_to: the group that it names has deviation and bounds for both";
    const SPAN: &str = "a height in metres, or two such as [3.0, 6.5]";
    section.allow_only(GROUP_KEYS)?;
    let channel = |entry: Entry<'_>| entry.text(check::CHANNELS);
    let channels = section.get("channels").map_or(Ok(Vec::new()), |entry| {
        entry.list(check::CHANNELS)?.into_iter().map(channel).collect::<Result<Vec<_>, _>>()
    })?;
    let tied_to = section.get("tied_to").map(|entry| entry.text(TIED)).transpose()?;
    let of_other = ["std", "least", "greatest", "typical"].into_iter().filter_map(|key| section.get(key)).next();
    if let Some(entry) = of_other.filter(|_| tied_to.is_some()) {
        return Err(entry.out_of_range(OF_OTHER));
    }
    let std = match tied_to {
        // That of the group that it is tied to.
        Some(_) => 0.0,
        None => section.required("std", STD)?.relative_std(STD)?,
    };
    let span = |entry: Entry<'_>| -> Result<[f64; 2], StudyError> {
        if let Ok(z_m) = entry.number(SPAN) {
            return Ok([z_m; 2]);
        }
        match entry.list(SPAN)?.as_slice() {
            [low, high] => {
                let span_m = [low.number(SPAN)?, high.number(SPAN)?];
                if span_m[0] <= span_m[1] { Ok(span_m) } else { Err(entry.out_of_range(SPAN)) }
            }
            _ => Err(entry.out_of_range(SPAN)),
        }
    };
    let span_m = section.get("z_m").map(span).transpose()?;
    Ok(CustomSource { group: Some(GroupTerms { std, span_m }), tied_to, channels, ..change_of_model(section)? })
}

/// A named change of the model, of a hypothesis or of a group.
fn change_of_model(section: &Section<'_>) -> Result<CustomSource, StudyError> {
    const NAME: &str =
        "a name of letters, digits, - and _ that starts with neither ch nor node, in quotes, such as \"cables\"";
    const FILE: &str = "the name of a MATLAB, HDF5 or Nastran file, in quotes, such as \"model.mat\"";
    const MATRIX: &str = "a matrix: a name such as \"dK\" or \"dk.mtx\", or a list of names and [name, factor] pairs";
    const SEGMENTS: &str = "the name of a CSV file of relative changes, in quotes, such as \"cables.csv\"";
    const NUMBER: &str = "a number";
    const TYPICAL: &str = "a number above 0: the value that is typical";
    let name = section.required("name", NAME)?;
    let text = name.text(NAME)?;
    if !is_name(&text) {
        return Err(name.out_of_range(NAME));
    }
    let path =
        |key, expected| section.get(key).map(|entry: Entry<'_>| entry.text(expected).map(PathBuf::from)).transpose();
    let terms = |key| -> Result<Vec<MatrixTerm>, StudyError> {
        section.get(key).map_or(Ok(Vec::new()), |entry: Entry<'_>| matrix_terms(&entry, MATRIX))
    };
    let number = |key| section.get(key).map(|entry: Entry<'_>| entry.number(NUMBER)).transpose();
    Ok(CustomSource {
        line: section.position().line,
        name: text,
        file: path("file", FILE)?,
        stiffness: terms("stiffness")?,
        mass: terms("mass")?,
        segments: path("segments", SEGMENTS)?,
        least: number("least")?,
        greatest: number("greatest")?,
        typical: section.get("typical").map(|entry: Entry<'_>| entry.positive(TYPICAL)).transpose()?,
        tied_to: None,
        channels: Vec::new(),
        group: None,
    })
}

fn effect(section: &Section<'_>) -> Result<Effect, StudyError> {
    const KIND: &str = "an effect of the catalogue, in quotes, such as \"base-rotation\"";
    const WHERE: &str = "the place of the effect, in quotes, such as \"225.2m\", \"07\" or \"node3\"";
    Ok(Effect {
        line: section.position().line,
        kind: section.required("kind", KIND)?.text(KIND)?,
        location: section.get("where").map(|entry| entry.text(WHERE)).transpose()?,
        parameters: section.rest(&["kind", "where"])?,
    })
}
