//! A channel's data as a row of the archive, and back.

use belfry_shared::message::{ChannelState, Peak};
use belfry_shared::quantise::{BLOCK_LINES, MAX_BITS, MIN_BITS, decode_lines, encode_decoded_lines, encoded_bytes};
use num_complex::Complex32;
use serde::{Deserialize, Serialize};

use crate::window::ChannelData;

/// What stands in a row of the table `channel`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ChannelRow {
    pub(super) state: String,
    pub(super) segments: Option<u16>,
    /// Bits per component of the lines; `None` where they are floating-point numbers.
    pub(super) bits: Option<u8>,
    pub(super) lines: Option<Vec<u8>>,
    pub(super) densities: Option<Vec<u8>>,
    pub(super) peaks: Option<String>,
}

impl ChannelRow {
    /// Reads a row of the table.
    pub(super) fn read(row: &rusqlite::Row<'_>) -> rusqlite::Result<Self> {
        Ok(Self {
            state: row.get("state")?,
            segments: row.get("segments")?,
            bits: row.get("bits")?,
            lines: row.get("lines")?,
            densities: row.get("densities")?,
            peaks: row.get("peaks")?,
        })
    }
}

const SOUND: &str = "sound";
const UNSOUND: [(&str, ChannelState); 5] = [
    ("missing", ChannelState::Missing),
    ("clipped", ChannelState::Clipped),
    ("constant", ChannelState::Constant),
    ("overrun", ChannelState::Overrun),
    ("unknown", ChannelState::Unknown),
];

/// No vibration sensor gives a line or a density beyond this, in m/s²/√Hz and its square.
const MOST_LINE: f32 = 1e6;

/// The row of a channel's data. Lines that were sent in `bits` a component take as many here.
pub(super) fn row(data: &ChannelData, bits: Option<u8>) -> ChannelRow {
    match data {
        ChannelData::Unsound(state) => ChannelRow { state: state_name(*state).to_owned(), ..ChannelRow::default() },
        ChannelData::Lines(lines) => {
            let (bits, lines) = match bits.and_then(|bits| Some((bits, as_sent(lines, bits)?))) {
                Some((bits, code)) => (Some(bits), code),
                None => (None, as_floats(lines)),
            };
            ChannelRow { state: SOUND.to_owned(), segments: Some(1), bits, lines: Some(lines), ..ChannelRow::default() }
        }
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

/// What a channel without data is called.
pub(super) fn state_name(state: ChannelState) -> &'static str {
    UNSOUND.iter().find(|(_, known)| *known == state).map_or("missing", |(name, _)| name)
}

/// Lines as the node coded them, without any loss; `None` where they do not come of such a code.
pub(super) fn as_sent(lines: &[Complex32], bits: u8) -> Option<Vec<u8>> {
    let mut code = vec![0; if (MIN_BITS..=MAX_BITS).contains(&bits) { encoded_bytes(lines.len(), bits) } else { 0 }];
    encode_decoded_lines(lines, bits, &mut code).is_ok_and(|is_same| is_same).then_some(code)
}

fn as_floats(lines: &[Complex32]) -> Vec<u8> {
    lines.iter().flat_map(|line| [line.re, line.im]).flat_map(f32::to_le_bytes).collect()
}

/// The data of a row, or what is wrong with it.
pub(super) fn data(row: &ChannelRow) -> Result<ChannelData, String> {
    if let Some((_, state)) = UNSOUND.iter().find(|(name, _)| *name == row.state) {
        return Ok(ChannelData::Unsound(*state));
    }
    match (row.state.as_str(), &row.lines, &row.densities) {
        (SOUND, Some(code), None) => {
            let lines = match row.bits {
                Some(bits) => sent(code, bits)?,
                None => floats(code)?,
            };
            let is_possible = |part: f32| part.abs() <= MOST_LINE;
            if lines.iter().all(|line| is_possible(line.re) && is_possible(line.im)) {
                Ok(ChannelData::Lines(lines))
            } else {
                Err(format!("a line is no number, or above {MOST_LINE} m/s²/√Hz"))
            }
        }
        (SOUND, None, Some(densities)) => {
            let (values, rest) = densities.as_chunks::<4>();
            if !rest.is_empty() {
                return Err(format!("{} bytes of densities are no whole number of values", densities.len()));
            }
            let densities: Vec<f32> = values.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
            if !densities.iter().all(|density| (0.0..=MOST_LINE * MOST_LINE).contains(density)) {
                return Err("a density is no number, negative or too large".to_owned());
            }
            let peaks: Result<Vec<Peak>, _> = row.peaks.as_deref().map_or(Ok(Vec::new()), serde_json::from_str);
            Ok(ChannelData::Psd {
                segments: row.segments.unwrap_or(1),
                densities,
                peaks: peaks.map_err(|error| format!("peaks: {error}"))?,
            })
        }
        (state, ..) => Err(format!("a channel's state is \"{state}\" without data to it")),
    }
}

/// Lines of a node's code. Their number follows from its length: blocks of [`BLOCK_LINES`] lines take a scale and whole bytes.
fn sent(code: &[u8], bits: u8) -> Result<Vec<Complex32>, String> {
    if !(MIN_BITS..=MAX_BITS).contains(&bits) {
        return Err(format!("{bits} bits a component; possible are {MIN_BITS} to {MAX_BITS}"));
    }
    let block = encoded_bytes(BLOCK_LINES, bits);
    let whole = code.len() / block * BLOCK_LINES;
    let lines = (whole..=whole + BLOCK_LINES).find(|&lines| encoded_bytes(lines, bits) == code.len());
    let lines = lines.ok_or_else(|| format!("{} bytes are no whole number of lines of {bits} bits", code.len()))?;
    let mut decoded = vec![Complex32::default(); lines];
    decode_lines(code, bits, &mut decoded).map_err(|error| error.to_string())?;
    Ok(decoded)
}

fn floats(bytes: &[u8]) -> Result<Vec<Complex32>, String> {
    let (pairs, rest) = bytes.as_chunks::<8>();
    if !rest.is_empty() {
        return Err(format!("{} bytes of lines are no whole number of complex values", bytes.len()));
    }
    let line = |[a, b, c, d, e, f, g, h]: &[u8; 8]| {
        Complex32::new(f32::from_le_bytes([*a, *b, *c, *d]), f32::from_le_bytes([*e, *f, *g, *h]))
    };
    Ok(pairs.iter().map(line).collect())
}
