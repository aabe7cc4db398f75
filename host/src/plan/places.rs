//! Places where a sensor could stand: `channel,elevation_m,azimuth_deg` and, where a place is not on the axis,
//! `offset_x_m,offset_y_m`. A table flows in; sensors flow out.

use std::path::Path;

use crate::study::{Direction, Sensor};
use crate::table::{Table, TableError};

const COLUMNS: [&str; 5] = ["channel", "elevation_m", "azimuth_deg", "offset_x_m", "offset_y_m"];
const HEADER: &str = "channel,elevation_m,azimuth_deg and, where a place is not on the axis, offset_x_m,offset_y_m";
/// So many of them must be there.
const NEEDED: usize = 3;

/// A sensor at a place, of the unit of the others.
pub(crate) fn sensor_at(channel: String, elevation_m: f64, direction: Direction, offset_m: [f64; 2]) -> Sensor {
    Sensor { elevation_m: Some(elevation_m), direction: Some(direction), offset_m, ..Sensor::new(channel, 0) }
}

/// Reads a table of places; `sensors` are there already, and no place may have the channel of one.
///
/// # Errors
/// [`TableError`] names the file, the line and the column.
pub fn read_places(file: &Path, sensors: &[Sensor]) -> Result<Vec<Sensor>, TableError> {
    let table = Table::read(file, "--places")?;
    let columns = columns_of(&table)?;
    let mut places: Vec<Sensor> = Vec::new();
    for row in &table.rows {
        let taken: Vec<&str> = sensors.iter().chain(&places).map(|sensor| sensor.channel.as_str()).collect();
        places.push(Row { table: &table, columns, row }.place(&taken)?);
    }
    if places.is_empty() { Err(table.empty("places")) } else { Ok(places) }
}

/// Where each of [`COLUMNS`] stands.
fn columns_of(table: &Table<'_>) -> Result<[Option<usize>; COLUMNS.len()], TableError> {
    let mut columns = [None; COLUMNS.len()];
    for (position, name) in table.names().enumerate() {
        let at = COLUMNS.iter().position(|column| *column == name);
        let at = at.ok_or_else(|| table.wrong_column(name, "is unknown", HEADER))?;
        if columns[at].replace(position).is_some() {
            return Err(table.wrong_column(name, "stands twice", HEADER));
        }
    }
    match (0..NEEDED).find(|&at| columns[at].is_none()) {
        Some(missing) => Err(table.wrong_column(COLUMNS[missing], "is missing", HEADER)),
        None => Ok(columns),
    }
}

struct Row<'a> {
    table: &'a Table<'a>,
    columns: [Option<usize>; COLUMNS.len()],
    row: &'a csv::StringRecord,
}

impl Row<'_> {
    fn place(&self, taken: &[&str]) -> Result<Sensor, TableError> {
        let channel = self.cell(0);
        if channel.is_empty() || taken.contains(&channel) {
            return Err(self.value(0, "a name that no sensor and no other place has"));
        }
        let direction = match self.cell(2) {
            "up" => Direction::Up,
            _ => Direction::AzimuthDeg(self.number(2, "degrees anticlockwise from +X seen from above, or up")?),
        };
        let offset = |column: usize| match self.cell(column) {
            "" => Ok(0.0),
            _ => self.number(column, "a distance from the beam's axis in metres, or nothing for none"),
        };
        let elevation_m = self.number(1, "a height in metres")?;
        Ok(sensor_at(channel.to_owned(), elevation_m, direction, [offset(3)?, offset(4)?]))
    }

    fn cell(&self, column: usize) -> &str {
        self.columns[column].map_or("", |position| self.table.text(self.row, position))
    }

    fn number(&self, column: usize, expected: &str) -> Result<f64, TableError> {
        let position = self.columns[column].unwrap_or(usize::MAX);
        self.table.number(self.row, position, COLUMNS[column], expected)
    }

    fn value(&self, column: usize, expected: &str) -> TableError {
        self.table.value(self.row, self.columns[column].unwrap_or(usize::MAX), COLUMNS[column], expected)
    }
}
