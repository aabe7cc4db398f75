//! A channel's data as a row of the archive, and back.

use belfry_shared::message::{ChannelState, Peak};
use num_complex::Complex32;

use crate::window::ChannelData;

/// What stands in a row of the table `channel`.
#[derive(Debug, Default)]
pub(super) struct ChannelRow {
    pub(super) state: String,
    pub(super) segments: Option<u16>,
    pub(super) lines: Option<Vec<u8>>,
    pub(super) densities: Option<Vec<u8>>,
    pub(super) peaks: Option<String>,
}

impl ChannelRow {
    /// The columns that [`ChannelRow::read`] takes, in their order.
    pub(super) const COLUMNS: &str = "state, segments, lines, densities, peaks";

    /// Reads a row of a query for [`ChannelRow::COLUMNS`].
    pub(super) fn read(row: &rusqlite::Row<'_>) -> rusqlite::Result<Self> {
        Ok(Self {
            state: row.get(0)?,
            segments: row.get(1)?,
            lines: row.get(2)?,
            densities: row.get(3)?,
            peaks: row.get(4)?,
        })
    }
}

const SOUND: &str = "sound";
const UNSOUND: [(&str, ChannelState); 4] = [
    ("missing", ChannelState::Missing),
    ("clipped", ChannelState::Clipped),
    ("constant", ChannelState::Constant),
    ("overrun", ChannelState::Overrun),
];

/// The row of a channel's data.
pub(super) fn row(data: &ChannelData) -> ChannelRow {
    match data {
        ChannelData::Unsound(state) => {
            let name = UNSOUND.iter().find(|(_, known)| known == state).map_or("missing", |(name, _)| name);
            ChannelRow { state: name.to_owned(), ..ChannelRow::default() }
        }
        ChannelData::Lines(lines) => ChannelRow {
            state: SOUND.to_owned(),
            segments: Some(1),
            lines: Some(lines.iter().flat_map(|line| [line.re, line.im]).flat_map(f32::to_le_bytes).collect()),
            ..ChannelRow::default()
        },
        ChannelData::Psd { segments, densities, peaks } => ChannelRow {
            state: SOUND.to_owned(),
            segments: Some(*segments),
            densities: Some(densities.iter().flat_map(|density| density.to_le_bytes()).collect()),
            // Peaks are plain numbers, which JSON always takes.
            peaks: serde_json::to_string(peaks).ok(),
            ..ChannelRow::default()
        },
    }
}

/// The data of a row, or what is wrong with it.
pub(super) fn data(row: &ChannelRow) -> Result<ChannelData, String> {
    if let Some((_, state)) = UNSOUND.iter().find(|(name, _)| *name == row.state) {
        return Ok(ChannelData::Unsound(*state));
    }
    match (row.state.as_str(), &row.lines, &row.densities) {
        (SOUND, Some(lines), None) => {
            let (pairs, rest) = lines.as_chunks::<8>();
            if !rest.is_empty() {
                return Err(format!("{} bytes of lines are no whole number of complex values", lines.len()));
            }
            let line = |[a, b, c, d, e, f, g, h]: &[u8; 8]| {
                Complex32::new(f32::from_le_bytes([*a, *b, *c, *d]), f32::from_le_bytes([*e, *f, *g, *h]))
            };
            let lines: Vec<Complex32> = pairs.iter().map(line).collect();
            if lines.iter().all(|line| line.is_finite()) {
                Ok(ChannelData::Lines(lines))
            } else {
                Err("a line is no number".to_owned())
            }
        }
        (SOUND, None, Some(densities)) => {
            let (values, rest) = densities.as_chunks::<4>();
            if !rest.is_empty() {
                return Err(format!("{} bytes of densities are no whole number of values", densities.len()));
            }
            let peaks: Result<Vec<Peak>, _> = row.peaks.as_deref().map_or(Ok(Vec::new()), serde_json::from_str);
            Ok(ChannelData::Psd {
                segments: row.segments.unwrap_or(1),
                densities: values.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect(),
                peaks: peaks.map_err(|error| format!("peaks: {error}"))?,
            })
        }
        (state, ..) => Err(format!("a channel's state is \"{state}\" without data to it")),
    }
}
