//! Where named nodes of a model stand: the file that places its rows, or a table of points alone, flows in; places by name flow out, and sensors that
//! name a node get its place.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::types::{Direction, LayoutFile, Model, ModelSource, STUDY_FILE, Sensor, Study};
use crate::model::{LayoutError, is_list_of_rows, is_numbered, read_numbered_positions};
use crate::modes::node_and_direction;
use crate::nearest::nearest;
use crate::table::{Table, TableError};

/// What names the tables.
const NAMED_BY: &str = "[model] in study.toml";

/// Places of nodes by their names.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Places {
    /// X, Y, and Z up, in m.
    by_name: HashMap<String, [f64; 3]>,
    /// Where they were read.
    file: PathBuf,
}

/// Why nodes have no places.
#[derive(Debug, Error)]
pub enum PlacesError {
    /// The file itself.
    #[error(transparent)]
    Layout(#[from] LayoutError),
    /// A name that no node has.
    #[error("{}, channel {channel}: model_node = \"{node}\", but {} has no such node{}", study.display(), file.display(), nearest.as_ref().map_or_else(String::new, |name| format!("; did you mean \"{name}\"?")))]
    NoSuchNode {
        /// The study's file.
        study: PathBuf,
        /// The channel.
        channel: String,
        /// What it names.
        node: String,
        /// The table.
        file: PathBuf,
        /// The name that is most like it.
        nearest: Option<String>,
    },
    /// Nothing places the nodes.
    #[error(
        "{}, channel {channel}: model_node = \"{node}\", but nothing says where the model's nodes stand; name a table of them in [model], as `dofs` of matrices or `points` (node,x_m,y_m,z_m)", study.display()
    )]
    NoPlaces {
        /// The study's file.
        study: PathBuf,
        /// The channel.
        channel: String,
        /// What it names.
        node: String,
    },
}

impl Places {
    /// Places of a model's nodes: its `points`, else those that the layout of its matrices has; `None` where it has neither.
    ///
    /// # Errors
    /// [`LayoutError`] names the file, and the line.
    pub fn of(model: &Model, folder: &Path) -> Result<Option<Self>, LayoutError> {
        let layout = match &model.source {
            ModelSource::Matrices(source) => source.layout.as_ref(),
            ModelSource::Beam(_) | ModelSource::Modes(_) => None,
        };
        match (&model.drawing.points, layout) {
            (Some(path), _) if is_numbered(path) => Ok(Some(Self::by_number(folder.join(path), 1.0)?)),
            (Some(path), _) => Ok(Some(Self::read(folder.join(path))?)),
            (None, Some(LayoutFile::Numbered { file, factor })) => {
                Ok(Some(Self::by_number(folder.join(file), *factor)?))
            }
            // A list of rows has names alone.
            (None, Some(LayoutFile::Dofs(path))) if is_list_of_rows(path) => Ok(None),
            (None, Some(LayoutFile::Dofs(path) | LayoutFile::Nodes(path))) => Ok(Some(Self::read(folder.join(path))?)),
            (None, None) => Ok(None),
        }
    }

    /// Those of a universal file or one of Nastran, whose lengths are in m by a factor.
    fn by_number(file: PathBuf, factor: f64) -> Result<Self, LayoutError> {
        let positions = read_numbered_positions(&file, factor)?;
        let by_name = positions.into_iter().map(|(node, place_m)| (node.to_string(), place_m)).collect();
        Ok(Self { by_name, file })
    }

    fn read(file: PathBuf) -> Result<Self, TableError> {
        let table = Table::read(&file, NAMED_BY)?;
        let expected = "node,x_m,y_m,z_m (x_m and y_m may be absent)";
        let (name, columns) = (table.column("node", expected)?, table.place_columns(expected)?);
        let mut by_name = HashMap::new();
        for row in &table.rows {
            let place_m = table.place_m(row, &columns)?;
            let text = table.text(row, name);
            if by_name.insert(text.to_owned(), place_m).is_some_and(|before| before != place_m) {
                return Err(table.value(row, name, "node", "a node that stands nowhere else in an earlier line"));
            }
        }
        drop(table);
        Ok(Self { by_name, file })
    }

    /// Where a node stands, in m.
    pub fn find(&self, node: &str) -> Option<[f64; 3]> {
        self.by_name.get(node).copied()
    }

    /// The file that they were read from.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The name that is most like one that no node has.
    pub fn nearest_name(&self, node: &str) -> Option<String> {
        let mut names: Vec<&str> = self.by_name.keys().map(String::as_str).collect();
        // Of names that are equally near, always the same.
        names.sort_unstable();
        nearest(node, names, 0.7).map(str::to_owned)
    }
}

/// Directions as names of channels end in them: x, y, z.
const DIRECTIONS: [Direction; 3] = [Direction::AzimuthDeg(0.0), Direction::AzimuthDeg(90.0), Direction::Up];

/// Gives sensors that name a node of the model its place: by `model_node`, or by a channel or point such as `12x` that has no place of its own.
pub(super) fn place_sensors(study: &mut Study) -> Result<(), PlacesError> {
    let setups = study.setups.iter_mut().flat_map(|setup| &mut setup.sensors);
    let sensors = setups.chain(study.measured.iter_mut().flat_map(|measured| &mut measured.sensors));
    let mut unplaced: Vec<&mut Sensor> =
        sensors.filter(|sensor| sensor.dof.is_none() && sensor.elevation_m.is_none()).collect();
    let is_named = |sensor: &Sensor| sensor.model_node.is_some() || named_by_channel(sensor).is_some();
    if !unplaced.iter().any(|sensor| is_named(sensor)) {
        return Ok(());
    }
    let places = study.model.as_ref().map(|model| Places::of(model, &study.folder)).transpose()?.flatten();
    for sensor in &mut unplaced {
        let (channel, file) = (sensor.channel.clone(), study.folder.join(STUDY_FILE));
        let by_channel = named_by_channel(sensor);
        let place_m = match (&sensor.model_node, &places) {
            (Some(node), None) => return Err(PlacesError::NoPlaces { study: file, channel, node: node.clone() }),
            (Some(node), Some(places)) => Some(places.find(node).ok_or_else(|| PlacesError::NoSuchNode {
                study: file,
                channel,
                node: node.clone(),
                file: places.file.clone(),
                nearest: places.nearest_name(node),
            })?),
            (None, places) => {
                places.as_ref().zip(by_channel.as_ref()).and_then(|(places, (node, _))| places.find(node))
            }
        };
        let Some([x, y, z]) = place_m else { continue };
        (sensor.offset_m, sensor.elevation_m) = ([x, y], Some(z));
        if let Some((_, direction)) = by_channel.filter(|_| sensor.model_node.is_none()) {
            sensor.direction = sensor.direction.or(Some(direction));
        }
    }
    Ok(())
}

/// The node and the direction that a sensor's channel or point names.
fn named_by_channel(sensor: &Sensor) -> Option<(String, Direction)> {
    let (node, direction) = node_and_direction(&sensor.channel).or_else(|| node_and_direction(&sensor.point))?;
    Some((node.to_string(), *DIRECTIONS.get(direction)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The file is pyuff's, in mm.
    #[test]
    fn channels_stand_at_the_nodes_of_a_universal_file() {
        let folder = tempfile::tempdir().unwrap();
        let nodes = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests-data/pyuff_nodes.unv"));
        std::fs::copy(nodes, folder.path().join("nodes.unv")).unwrap();
        let load = |sensor: &str| {
            let text = format!(
                "[structure]\nname = \"Chain\"\n[measured]\nmodes = \"modes.csv\"\n[[sensor]]\n{sensor}\n\
                 [model.matrices]\nstiffness = \"k.mtx\"\nmass = \"m.mtx\"\nnodes = \"nodes.unv\"\n"
            );
            std::fs::write(folder.path().join(STUDY_FILE), text).unwrap();
            Study::load(folder.path())
        };
        for named in ["channel = \"12x\"", "channel = \"top\"\nmodel_node = \"12\"\nazimuth_deg = 0"] {
            let sensors = load(named).unwrap().sensors();
            assert_eq!((sensors[0].offset_m, sensors[0].elevation_m), ([0.0; 2], Some(6.0)), "{named}");
            assert_eq!(sensors[0].direction, Some(Direction::AzimuthDeg(0.0)), "{named}");
        }
        let unknown = load("channel = \"top\"\nmodel_node = \"122\"").unwrap_err().to_string();
        assert!(unknown.contains("nodes.unv has no such node; did you mean \"12\"?"), "{unknown}");
        std::fs::write(folder.path().join("nodes.unv"), "    -1\n    15\n  3 0 0 1 0.0 zero 1.0\n    -1\n").unwrap();
        let damaged = load("channel = \"12x\"").unwrap_err().to_string();
        assert!(damaged.contains("nodes.unv: line 3"), "{damaged}");
    }
}
