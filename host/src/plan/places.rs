//! Places where a sensor could stand: `channel,elevation_m,azimuth_deg` and, where a place is not on the axis,
//! `offset_x_m,offset_y_m`. A table flows in; sensors flow out.

use std::path::Path;

use super::error::PlacesError;
use crate::study::{Direction, Sensor};

const COLUMNS: [&str; 5] = ["channel", "elevation_m", "azimuth_deg", "offset_x_m", "offset_y_m"];
/// So many of them must be there.
const NEEDED: usize = 3;

/// A sensor at a place, of the unit of the others.
pub(crate) fn sensor_at(channel: String, elevation_m: f64, direction: Direction, offset_m: [f64; 2]) -> Sensor {
    Sensor {
        point: channel.clone(),
        channel,
        node: 0,
        elevation_m: Some(elevation_m),
        direction: Some(direction),
        offset_m,
        reference: false,
        unit: None,
        sensitivity_v_per_m_s2: None,
        dof: None,
    }
}

/// Reads a table of places; `sensors` are there already, and no place may have the channel of one.
///
/// # Errors
/// [`PlacesError`] names the file, the line and the column.
pub fn read_places(file: &Path, sensors: &[Sensor]) -> Result<Vec<Sensor>, PlacesError> {
    let unreadable = |source| PlacesError::Unreadable { file: file.to_owned(), source };
    let text = std::fs::read_to_string(file).map_err(unreadable)?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_reader(text.as_bytes());
    let not_csv = |error: csv::Error| PlacesError::NotCsv {
        file: file.to_owned(),
        line: error.position().map_or(1, csv::Position::line),
        reason: error.to_string(),
    };
    let header = reader.headers().map_err(not_csv)?.clone();
    let columns = columns_of(file, &header)?;
    let mut places: Vec<Sensor> = Vec::new();
    for record in reader.records() {
        let row = Row { file, columns, record: record.map_err(not_csv)? };
        let taken: Vec<&str> = sensors.iter().chain(&places).map(|sensor| sensor.channel.as_str()).collect();
        places.push(row.place(&taken)?);
    }
    if places.is_empty() { Err(PlacesError::Empty { file: file.to_owned() }) } else { Ok(places) }
}

/// Where each of [`COLUMNS`] stands.
fn columns_of(file: &Path, header: &csv::StringRecord) -> Result<[Option<usize>; COLUMNS.len()], PlacesError> {
    let wrong =
        |column: &str, problem| PlacesError::Column { file: file.to_owned(), column: column.to_owned(), problem };
    let mut columns = [None; COLUMNS.len()];
    for (position, name) in header.iter().enumerate() {
        let name = name.trim_start_matches('\u{feff}');
        let at = COLUMNS.iter().position(|column| *column == name).ok_or_else(|| wrong(name, "is unknown"))?;
        if columns[at].replace(position).is_some() {
            return Err(wrong(name, "stands twice"));
        }
    }
    match (0..NEEDED).find(|&at| columns[at].is_none()) {
        Some(missing) => Err(wrong(COLUMNS[missing], "is missing")),
        None => Ok(columns),
    }
}

struct Row<'a> {
    file: &'a Path,
    columns: [Option<usize>; COLUMNS.len()],
    record: csv::StringRecord,
}

impl Row<'_> {
    fn place(&self, taken: &[&str]) -> Result<Sensor, PlacesError> {
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
        self.columns[column].and_then(|position| self.record.get(position)).unwrap_or("")
    }

    fn number(&self, column: usize, expected: &str) -> Result<f64, PlacesError> {
        let number = self.cell(column).parse::<f64>().ok().filter(|number| number.is_finite());
        number.ok_or_else(|| self.value(column, expected))
    }

    fn value(&self, column: usize, expected: &str) -> PlacesError {
        PlacesError::Value {
            file: self.file.to_owned(),
            line: self.record.position().map_or(0, csv::Position::line),
            column: COLUMNS[column],
            value: self.cell(column).to_owned(),
            expected: expected.to_owned(),
        }
    }
}
