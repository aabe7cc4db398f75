//! Beam tables and sensors as a study writes them: what the study's model knows of the structure.
//!
//! Tables are read from and written as `beam.csv` (one row a segment, base first, masses at the top node).

use std::fmt::Write as _;
use std::path::Path;

/// The header of `beam.csv`.
const HEADER: &str = "z_bottom_m,z_top_m,bending_1_n_m2,bending_2_n_m2,axis_deg,shear_1_n,shear_2_n,torsion_n_m2,\
                      mass_top_kg,inertia_x_kg_m2,inertia_y_kg_m2,inertia_z_kg_m2";

/// A row of `beam.csv`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Segment {
    pub(super) z_bottom_m: f64,
    pub(super) z_top_m: f64,
    /// EI for motion along local axes 1 and 2.
    pub(super) bending_n_m2: [f64; 2],
    /// Local axis 1, degrees anticlockwise from +X.
    pub(super) axis_deg: f64,
    /// kGA for motion along local axes 1 and 2.
    pub(super) shear_n: [f64; 2],
    pub(super) torsion_n_m2: f64,
    pub(super) mass_top_kg: f64,
    /// About global X, Y, Z.
    pub(super) inertia_kg_m2: [f64; 3],
}

impl Segment {
    pub(super) fn length_m(&self) -> f64 {
        self.z_top_m - self.z_bottom_m
    }
}

/// A sensor as the study states it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Channel {
    pub(super) node: usize,
    pub(super) elevation_m: f64,
    pub(super) azimuth_deg: f64,
    pub(super) offset_m: [f64; 2],
}

/// The name of a channel: its column, counted from one.
pub(super) fn channel_name(channel: usize) -> String {
    format!("{:02}", channel + 1)
}

/// Rows of a CSV file by the names of its columns.
fn rows(path: &Path) -> Result<(Vec<String>, Vec<Vec<f64>>), String> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let mut lines = text.lines();
    let header = lines.next().unwrap_or_default().split(',').map(|name| name.trim().to_owned()).collect();
    let parse = |line: &str| -> Result<Vec<f64>, String> {
        let number = |cell: &str| cell.trim().parse().map_err(|_| format!("{}: {cell} is no number", path.display()));
        line.split(',').map(number).collect()
    };
    let rows = lines.filter(|line| !line.trim().is_empty()).map(parse).collect::<Result<_, _>>()?;
    Ok((header, rows))
}

/// The cell of a row under a column's name.
fn cell(path: &Path, header: &[String], row: &[f64], name: &str) -> Result<f64, String> {
    let place = header.iter().position(|column| column == name);
    place.and_then(|place| row.get(place).copied()).ok_or_else(|| format!("{}: no column {name}", path.display()))
}

/// Reads a beam table whose shear stiffness is the same in both directions.
pub(super) fn read_segments(path: &Path) -> Result<Vec<Segment>, String> {
    let (header, rows) = rows(path)?;
    rows.iter()
        .map(|row| {
            let get = |name| cell(path, &header, row, name);
            Ok(Segment {
                z_bottom_m: get("z_bottom_m")?,
                z_top_m: get("z_top_m")?,
                bending_n_m2: [get("bending_1_n_m2")?, get("bending_2_n_m2")?],
                axis_deg: get("axis_deg")?,
                shear_n: [get("shear_n")?; 2],
                torsion_n_m2: get("torsion_n_m2")?,
                mass_top_kg: get("mass_top_kg")?,
                inertia_kg_m2: [get("inertia_x_kg_m2")?, get("inertia_y_kg_m2")?, get("inertia_z_kg_m2")?],
            })
        })
        .collect()
}

/// Reads the sensors of the published benchmark; a section is a sensor node.
pub(super) fn read_channels(path: &Path) -> Result<Vec<Channel>, String> {
    let (header, rows) = rows(path)?;
    rows.iter()
        .map(|row| {
            let get = |name| cell(path, &header, row, name);
            Ok(Channel {
                node: get("section")? as usize,
                elevation_m: get("elevation_m")?,
                azimuth_deg: get("azimuth_deg")?,
                offset_m: [get("offset_x_m")?, get("offset_y_m")?],
            })
        })
        .collect()
}

/// A beam table as text.
pub(super) fn segments_csv(segments: &[Segment]) -> String {
    let mut text = HEADER.to_owned() + "\n";
    for s in segments {
        let [shear_1, shear_2] = s.shear_n;
        let [x, y, z] = s.inertia_kg_m2;
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{},{},{:.6e},{:.6e},{},{shear_1:.6e},{shear_2:.6e},{:.6e},{},{x:.6e},{y:.6e},{z:.6e}",
            s.z_bottom_m, s.z_top_m, s.bending_n_m2[0], s.bending_n_m2[1], s.axis_deg, s.torsion_n_m2, s.mass_top_kg
        );
    }
    text
}
