//! Where named nodes of a model stand: the table that places its rows, or one of points alone, flows in; places by name flow out, and sensors that
//! name a node get its place.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::types::{Direction, LayoutFile, Model, ModelSource, STUDY_FILE, Sensor, Study};
use crate::modes::node_and_direction;
use crate::table::{Table, TableError};

/// What names the tables.
const NAMED_BY: &str = "[model] in study.toml";
/// What the cells of a position are.
const METRES: &str = "a number in metres";

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
    /// The table itself.
    #[error(transparent)]
    Table(#[from] TableError),
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
    /// [`TableError`] names file, line and column.
    pub fn of(model: &Model, folder: &Path) -> Result<Option<Self>, TableError> {
        let layout = match &model.source {
            ModelSource::Matrices(source) => source.layout.as_ref(),
            ModelSource::Beam(_) | ModelSource::Modes(_) => None,
        };
        let of_layout = layout.and_then(|layout| match layout {
            // CalculiX' list of rows has names alone.
            LayoutFile::Dofs(path) if path.extension().is_some_and(|ending| ending == "dof") => None,
            LayoutFile::Dofs(path) | LayoutFile::Nodes(path) => Some(path),
        });
        model.drawing.points.as_ref().or(of_layout).map(|path| Self::read(folder.join(path))).transpose()
    }

    fn read(file: PathBuf) -> Result<Self, TableError> {
        let table = Table::read(&file, NAMED_BY)?;
        let expected = "node,x_m,y_m,z_m (x_m and y_m may be absent)";
        let (name, z) = (table.column("node", expected)?, table.column("z_m", expected)?);
        let plan = [(table.find("x_m"), "x_m"), (table.find("y_m"), "y_m")];
        let mut by_name = HashMap::new();
        for row in &table.rows {
            let mut place_m = [0.0, 0.0, table.number(row, z, "z_m", METRES)?];
            for (slot, (column, name)) in place_m.iter_mut().zip(plan) {
                if let Some(column) = column {
                    *slot = table.number(row, column, name, METRES)?;
                }
            }
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
        let similarity = |name: &str| strsim::jaro_winkler(node, name);
        let mut names: Vec<&String> = self.by_name.keys().collect();
        names.sort();
        let best = names.into_iter().max_by(|a, b| similarity(a).total_cmp(&similarity(b)))?;
        (similarity(best) > 0.7).then(|| best.clone())
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
