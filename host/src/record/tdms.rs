//! TDMS recordings of LabVIEW and FlexLogger: segments of channels, one after the other or in turn, also raw numbers of DAQmx with their scales.
//!
//! The format is that of NI's "TDMS File Format Internal Structure", versions 4712 and 4713, little-endian. Metadata is read on opening, samples
//! when rows reach them.

mod metadata;

use std::collections::HashMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use super::array::{Sample, Source};
use super::channels::{Channel, ChannelReader, Form, Stretch, UNSCALED, wrong_form};
use super::columns::Columns;
use super::error::{RecordError, listed, quoted};
use super::files::open_file;
use crate::study::Setup;
use metadata::{Fields, Index, Kind, Property, START_OFFSET, START_TIME, Scaler, read_object};

const LEAD_BYTES: u64 = 28;
const HAS_METADATA: u32 = 1 << 1;
const NEW_LIST: u32 = 1 << 2;
const HAS_DATA: u32 = 1 << 3;
const INTERLEAVED: u32 = 1 << 5;
const BIG_ENDIAN: u32 = 1 << 6;
/// The segment was being written when its program ended.
const UNFINISHED: u64 = u64::MAX;
const MOST_METADATA_BYTES: u64 = 1 << 26;
/// Pieces of all channels together.
const MOST_STRETCHES: usize = 1 << 22;
const MOST_OBJECTS: u32 = 1 << 16;

/// An object of the file: the file, a group or a channel.
#[derive(Debug, Default)]
struct Object {
    path: String,
    properties: HashMap<String, Property>,
    /// How its numbers stood in the last segment that said it.
    index: Option<Index>,
    stretches: Vec<Stretch>,
}

/// What of a file is read so far.
struct Scan<'a> {
    path: &'a Path,
    objects: Vec<Object>,
    known: HashMap<String, usize>,
    /// Objects with numbers in the segment, in their order.
    active: Vec<usize>,
    stretches: usize,
}

/// Opens a file for reading row by row. Channels are called `group/channel`.
pub(super) fn open(path: &Path, setup: &Setup) -> Result<ChannelReader, RecordError> {
    let (mut file, size) = open_file(path)?;
    let mut scan = Scan { path, objects: Vec::new(), known: HashMap::new(), active: Vec::new(), stretches: 0 };
    let mut offset = 0;
    while offset < size {
        offset = scan.segment(&mut file, offset, size)?;
    }
    // Of a file that is only looked into, text and the like are none.
    let is_channel = |object: &&Object| match &object.index {
        Some(Index { kind: Kind::Other(_), .. }) => !setup.sensors.is_empty(),
        index => index.is_some(),
    };
    let channels: Vec<&Object> = scan.objects.iter().filter(is_channel).collect();
    let names: Vec<String> = channels.iter().map(|object| name_of(&object.path)).collect();
    let columns = Columns::Paths(names.clone());
    let wanted = columns.find_all(&setup.sensors, path)?;
    let mut read = Vec::new();
    let mut start_ns = None;
    for (index, (object, name)) in channels.into_iter().zip(names).enumerate() {
        let scale = match object.scale() {
            Ok(scale) => scale,
            Err(reason) if wanted.contains(&index) => {
                return wrong_form(path, format!("channel {}: {reason}", listed([name], "`")));
            }
            Err(_) => UNSCALED,
        };
        let step_s = object.properties.get("wf_increment").and_then(Property::number).filter(|step_s| *step_s > 0.0);
        // Without sensors the file is looked into, not read.
        let is_wanted = wanted.contains(&index) || setup.sensors.is_empty();
        let stretches = if is_wanted { object.stretches.clone() } else { Vec::new() };
        if is_wanted {
            start_ns = start_ns.or_else(|| object.start_ns());
        }
        let unit = object.properties.get("unit_string").and_then(Property::text).map(str::to_owned);
        read.push(Channel { name, rate_hz: step_s.map(f64::recip), scale, stretches, unit });
    }
    let reader = ChannelReader::new(vec![(path.to_owned(), Source::File(file))], read, true, setup)?;
    Ok(match start_ns {
        Some(start_ns) => reader.from(start_ns, Vec::new()),
        None => reader,
    })
}

/// `/'group'/'channel'` as people write it.
fn name_of(path: &str) -> String {
    let parts = path.trim_start_matches('/').split("'/'");
    let parts: Vec<String> = parts.map(|part| part.trim_matches('\'').replace("''", "'")).collect();
    parts.join("/").escape_debug().to_string()
}

/// What a message calls an object.
fn in_words(path: &str) -> String {
    match name_of(path).as_str() {
        "" => "the file itself".to_owned(),
        name => format!("object {}", listed([name], "`")),
    }
}

impl Scan<'_> {
    /// Reads what a segment says of its channels; where the next begins.
    fn segment(&mut self, file: &mut File, start: u64, size: u64) -> Result<u64, RecordError> {
        let wrong = |reason: &str| wrong_form(self.path, format!("byte {start}: {reason}"));
        if size - start < LEAD_BYTES {
            return wrong("the file is cut short; copy it again");
        }
        let mut lead = [0; LEAD_BYTES as usize];
        file.seek(SeekFrom::Start(start))
            .and_then(|_| file.read_exact(&mut lead))
            .map_err(RecordError::io(self.path))?;
        let mut fields = Fields::new(&lead);
        if fields.take(4) != Some(b"TDSm") {
            return wrong("no segment of a TDMS file starts here");
        }
        let (Some(contents), Some(_), Some(next), Some(raw)) =
            (fields.word(), fields.word(), fields.long(), fields.long())
        else {
            return wrong("the file is cut short; copy it again");
        };
        if contents & BIG_ENDIAN != 0 {
            return wrong("big-endian numbers; write it again on a computer that is little-endian, or export it");
        }
        let content = start + LEAD_BYTES;
        let end = if next == UNFINISHED { size } else { content.saturating_add(next) };
        let data = content.saturating_add(raw);
        if end > size || data > end {
            return wrong("the file is cut short: its segment reaches beyond its end; copy it again");
        }
        if raw > MOST_METADATA_BYTES {
            return wrong("more metadata than any segment has");
        }
        if contents & NEW_LIST != 0 {
            self.active.clear();
        }
        if contents & HAS_METADATA != 0 {
            let mut metadata = vec![0; raw as usize];
            file.read_exact(&mut metadata).map_err(RecordError::io(self.path))?;
            if let Err(reason) = self.metadata(&metadata) {
                return wrong_form(self.path, format!("the segment at byte {start}: {reason}"));
            }
        }
        if contents & HAS_DATA != 0 && end > data {
            let added = if self.active.iter().any(|at| self.daqmx(*at).is_some()) {
                self.add_daqmx(data, end - data)
            } else if contents & INTERLEAVED != 0 {
                self.add_interleaved(data, end - data)
            } else {
                self.add_chunks(data, end - data)
            };
            added.or_else(|reason| wrong_form(self.path, format!("the segment at byte {start}: {reason}")))?;
        }
        Ok(end.max(content))
    }

    fn metadata(&mut self, bytes: &[u8]) -> Result<(), String> {
        const SHORT: &str = "its metadata ends too early";
        let mut fields = Fields::new(bytes);
        let count = fields.word().filter(|count| *count <= MOST_OBJECTS).ok_or(SHORT)?;
        for _ in 0..count {
            let path = fields.text().ok_or(SHORT)?;
            let at = match self.known.get(&path) {
                Some(at) => *at,
                None => {
                    self.objects.push(Object { path: path.clone(), ..Object::default() });
                    self.known.insert(path.clone(), self.objects.len() - 1);
                    self.objects.len() - 1
                }
            };
            let Some(object) = self.objects.get_mut(at) else { continue };
            let has_data = read_object(&mut fields, &mut object.index, &mut object.properties)
                .map_err(|reason| format!("{}: {reason}", in_words(&path)))?;
            self.active.retain(|other| *other != at);
            if has_data {
                self.active.push(at);
            }
        }
        Ok(())
    }

    fn index(&self, at: usize) -> Option<&Index> {
        self.objects.get(at)?.index.as_ref()
    }

    fn daqmx(&self, at: usize) -> Option<&Index> {
        self.index(at).filter(|index| matches!(index.kind, Kind::Daqmx { .. }))
    }

    /// Adds numbers to a channel behind those that it has.
    fn push(&mut self, at: usize, count: u64, offset: u64, form: Form) -> Result<(), String> {
        self.stretches += 1;
        if self.stretches > MOST_STRETCHES {
            return Err("more pieces than are read; defragment it, as TDMS Defragment does in LabVIEW".to_owned());
        }
        if let Some(object) = self.objects.get_mut(at).filter(|_| count > 0) {
            let row = object.stretches.last().map_or(0, |last| last.row + last.count);
            object.stretches.push(Stretch { row, count, source: 0, offset, form });
        }
        Ok(())
    }

    /// One sample of every channel in turn.
    fn add_interleaved(&mut self, data: u64, bytes: u64) -> Result<(), String> {
        let active = self.active.clone();
        let kinds: Vec<(usize, Sample)> =
            active.iter().filter_map(|at| Some((*at, self.index(*at)?.sample()?))).collect();
        let width: u64 = kinds.iter().map(|(_, sample)| sample.bytes() as u64).sum();
        if kinds.len() != active.len() || width == 0 {
            return Err("channels in turn that are no numbers".to_owned());
        }
        let mut offset = data;
        for (at, sample) in kinds {
            let form = Form::Plain { sample, big_endian: false, stride: width, record: data };
            self.push(at, bytes / width, offset, form)?;
            offset += sample.bytes() as u64;
        }
        Ok(())
    }

    /// Chunks of so many numbers of each channel, one channel after the other.
    fn add_chunks(&mut self, data: u64, bytes: u64) -> Result<(), String> {
        let active = self.active.clone();
        let sizes = active.iter().map(|at| self.index(*at).map_or(0, |index| index.bytes));
        let chunk = sizes.fold(0_u64, u64::saturating_add);
        if chunk == 0 {
            return Err("numbers of no channel".to_owned());
        }
        // Where every chunk has one number of each, they stand in turn.
        if active.iter().all(|at| self.index(*at).is_some_and(|index| index.count == 1 && index.sample().is_some())) {
            return self.add_interleaved(data, bytes);
        }
        let mut from = data;
        let end = data + bytes;
        while from < end {
            for at in &active {
                let Some(index) = self.index(*at) else { continue };
                let (whole, count, sample) = (index.bytes, index.count, index.sample());
                let there = whole.min(end - from);
                if let Some(sample) = sample {
                    let size = sample.bytes() as u64;
                    let all_of_one = active.len() == 1;
                    let count = if all_of_one { (end - from) / size } else { count.min(there / size) };
                    self.push(*at, count, from, Form::packed(sample, false, from))?;
                    if all_of_one {
                        return Ok(());
                    }
                }
                from += there;
            }
        }
        Ok(())
    }

    /// Raw numbers of cards: of each card rows of so many bytes.
    fn add_daqmx(&mut self, data: u64, bytes: u64) -> Result<(), String> {
        let mut scalers: Vec<(usize, Scaler)> = Vec::new();
        let mut widths: Vec<u64> = Vec::new();
        let mut rows: Vec<u64> = Vec::new();
        for at in &self.active {
            let Some(Index { kind: Kind::Daqmx { scaler, widths: own, .. }, count, .. }) = self.daqmx(*at) else {
                return Err("raw numbers of DAQmx beside others".to_owned());
            };
            if widths.is_empty() {
                (widths, rows) = (own.clone(), vec![0; own.len()]);
            }
            match rows.get_mut(scaler.buffer) {
                Some(rows) if widths == *own => *rows = (*rows).max(*count),
                _ => return Err("channels that do not agree on the widths of rows".to_owned()),
            }
            scalers.push((*at, *scaler));
        }
        let chunk =
            widths.iter().zip(&rows).fold(0_u64, |sum, (width, rows)| sum.saturating_add(width.saturating_mul(*rows)));
        if chunk == 0 || widths.contains(&0) {
            return Err("raw numbers in rows of no bytes".to_owned());
        }
        let (mut from, end) = (data, data + bytes);
        // The chunks of a single card follow each other as its rows do.
        let is_single = widths.len() == 1;
        while from < end {
            let mut start = from;
            for (buffer, (width, rows)) in widths.iter().zip(&rows).enumerate() {
                let room = (end - start.min(end)) / width;
                let rows = if is_single { room } else { room.min(*rows) };
                for (at, scaler) in scalers.iter().filter(|(_, scaler)| scaler.buffer == buffer) {
                    if scaler.offset + scaler.sample.bytes() as u64 > *width {
                        return Err("a number that is not within its row".to_owned());
                    }
                    let form = Form::Plain { sample: scaler.sample, big_endian: false, stride: *width, record: start };
                    self.push(*at, rows, start + scaler.offset, form)?;
                }
                start = start.saturating_add(rows.saturating_mul(*width));
            }
            if is_single {
                break;
            }
            from = from.saturating_add(chunk);
        }
        Ok(())
    }
}

impl Object {
    /// When its first number was, in nanoseconds since 1970.
    fn start_ns(&self) -> Option<i64> {
        let offset_s = self.properties.get(START_OFFSET).and_then(Property::number).filter(|s| s.is_finite());
        let start_ns = self.properties.get(START_TIME)?.moment()?;
        Some(start_ns.saturating_add((offset_s.unwrap_or(0.0) * 1e9).round() as i64))
    }

    /// Slope and intercept of what makes the channel's quantity of its numbers.
    fn scale(&self) -> Result<[f64; 2], String> {
        if let Some(Index { kind: Kind::Other(what), .. }) = &self.index {
            return Err(format!("it holds {what}, where numbers were expected"));
        }
        let text = |name: &str| self.properties.get(name).and_then(Property::text);
        let number = |name: &str| self.properties.get(name).and_then(Property::number);
        let is_scaled = text("NI_Scaling_Status").is_some_and(|status| status == "scaled");
        let count = number("NI_Number_Of_Scales").filter(|count| *count >= 1.0 && !is_scaled);
        let Some(count) = count else { return Ok(UNSCALED) };
        const RAW: f64 = u32::MAX as f64;
        let (mut scale, mut at) = (UNSCALED, count - 1.0);
        // Each scale takes what another gives, down to the raw numbers.
        for _ in 0..count.min(64.0) as usize {
            let of = |name: &str| format!("NI_Scale[{at}]_{name}");
            let Some(kind) = text(&of("Scale_Type")) else {
                // A number of DAQmx itself.
                return match &self.index {
                    Some(Index { kind: Kind::Daqmx { scaler, scalers, .. }, .. })
                        if f64::from(scaler.id) == at || *scalers == 1 =>
                    {
                        Ok(scale)
                    }
                    Some(Index { kind: Kind::Daqmx { .. }, .. }) => Err("several raw numbers a sample".to_owned()),
                    _ => Err(format!("its scale {} is not described", quoted(at.to_string().as_bytes()))),
                };
            };
            let own = match kind {
                "Linear" => [number(&of("Linear_Slope")), number(&of("Linear_Y_Intercept"))],
                "Polynomial" if number(&of("Polynomial_Coefficients_Size")).is_some_and(|size| size <= 2.0) => {
                    [number(&of("Polynomial_Coefficients[1]")).or(Some(0.0)), number(&of("Polynomial_Coefficients[0]"))]
                }
                "AdvancedAPI" => [Some(1.0), Some(0.0)],
                other => {
                    return Err(format!(
                        "its numbers are scaled by `{}`; only straight lines are read: export it scaled",
                        quoted(other.as_bytes())
                    ));
                }
            };
            let [Some(slope), Some(intercept)] = own else {
                return Err(format!("its scale {} lacks a number", quoted(at.to_string().as_bytes())));
            };
            scale = [scale[0] * slope, scale[0] * intercept + scale[1]];
            at = number(&of(&format!("{kind}_Input_Source"))).unwrap_or(RAW);
            if at == RAW {
                return Ok(scale);
            }
        }
        Err("scales that lead to each other".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_begins_its_offset_after_its_start_time() {
        let mut object = Object::default();
        object.properties.insert(START_OFFSET.to_owned(), Property::Number(2.5));
        assert_eq!(object.start_ns(), None);
        object.properties.insert(START_TIME.to_owned(), Property::Moment(7_000_000_000));
        assert_eq!(object.start_ns(), Some(9_500_000_000));
        object.properties.insert(START_OFFSET.to_owned(), Property::Number(f64::NAN));
        assert_eq!(object.start_ns(), Some(7_000_000_000));
    }

    #[test]
    fn objects_are_named_as_people_write_them() {
        assert_eq!(in_words("/"), "the file itself");
        assert_eq!(in_words("/'run 1'/'top-x'"), "object `run 1/top-x`");
    }
}
