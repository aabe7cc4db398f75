//! The studies that `belfry init` writes, built into the program, and the stand-in tower that the demo simulates.

/// `study.toml` of a study to fill in: one setup of two sensors, every key explained.
pub const BLANK_STUDY: &str = include_str!("../../templates/blank/study.toml");

/// `study.toml` of the Canton Tower: 20 accelerometers at 8 levels, one sensor node a level, model in `beam.csv`.
pub const CANTON_STUDY: &str = include_str!("../../templates/canton/study.toml");

/// The tower's beam table, fitted to the published reduced model: 13 frequencies within 0.07 %, masses as published.
pub const CANTON_BEAM: &str = include_str!("../../templates/canton/beam.csv");

/// `study.toml` of a wind turbine on a monopile: eight accelerometers at four levels, model in `beam.csv`.
pub const TURBINE_STUDY: &str = include_str!("../../templates/turbine/study.toml");

/// The turbine's beam table, clamped at the mudline, from the published diameters and thicknesses of the NREL 5 MW reference turbine and the
/// monopile of OC3.
pub const TURBINE_BEAM: &str = include_str!("../../templates/turbine/beam.csv");

/// A building frame of five storeys: matrices with a group a storey, nodes, lines, and `study.toml` last.
pub const FRAME_FILES: &[(&str, &str)] = &[
    ("floors.mtx", include_str!("../../templates/frame/floors.mtx")),
    ("storey1.mtx", include_str!("../../templates/frame/storey1.mtx")),
    ("storey2.mtx", include_str!("../../templates/frame/storey2.mtx")),
    ("storey3.mtx", include_str!("../../templates/frame/storey3.mtx")),
    ("storey4.mtx", include_str!("../../templates/frame/storey4.mtx")),
    ("storey5.mtx", include_str!("../../templates/frame/storey5.mtx")),
    ("mass.mtx", include_str!("../../templates/frame/mass.mtx")),
    ("dofs.csv", include_str!("../../templates/frame/dofs.csv")),
    ("lines.csv", include_str!("../../templates/frame/lines.csv")),
    ("surfaces.csv", include_str!("../../templates/frame/surfaces.csv")),
    ("study.toml", include_str!("../../templates/frame/study.toml")),
];

/// A bridge of three spans: matrices with groups by span and bearing, nodes, lines, and `study.toml` last.
pub const BRIDGE_FILES: &[(&str, &str)] = &[
    ("deck.mtx", include_str!("../../templates/bridge/deck.mtx")),
    ("span1.mtx", include_str!("../../templates/bridge/span1.mtx")),
    ("span2.mtx", include_str!("../../templates/bridge/span2.mtx")),
    ("span3.mtx", include_str!("../../templates/bridge/span3.mtx")),
    ("piers.mtx", include_str!("../../templates/bridge/piers.mtx")),
    ("bearing-west.mtx", include_str!("../../templates/bridge/bearing-west.mtx")),
    ("bearing-pier1.mtx", include_str!("../../templates/bridge/bearing-pier1.mtx")),
    ("bearing-pier2.mtx", include_str!("../../templates/bridge/bearing-pier2.mtx")),
    ("bearing-east.mtx", include_str!("../../templates/bridge/bearing-east.mtx")),
    ("mass.mtx", include_str!("../../templates/bridge/mass.mtx")),
    ("dofs.csv", include_str!("../../templates/bridge/dofs.csv")),
    ("lines.csv", include_str!("../../templates/bridge/lines.csv")),
    ("surfaces.csv", include_str!("../../templates/bridge/surfaces.csv")),
    ("study.toml", include_str!("../../templates/bridge/study.toml")),
];

/// A stand-in for the real tower, whose recordings are not public. Synthetic: together with a base rotation flexibility
/// of 7.21e-15 rad/(N m) it has the measured frequencies of Lei, Wang, Shen (2012), table 1, within 0.03 %.
pub const CANTON_BEAM_FIELD: &str = include_str!("../../templates/canton/beam_field.csv");

/// The paper's Table 1: measured, model and updated frequencies in Hz, MAC of model and updated model.
pub const PAPER_TABLE_1: &str = include_str!("../../templates/canton/paper_table1.csv");

/// The paper's Table 2: errors at the sensors left out, before and after the update.
pub const PAPER_TABLE_2: &str = include_str!("../../templates/canton/paper_table2.csv");
