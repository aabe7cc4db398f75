//! One column of a row group: its type's numbers become doubles, its nulls NaN.

use parquet::basic::{ConvertedType, LogicalType, TimeUnit, Type};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::data_type::DataType;
use parquet::errors::ParquetError;
use parquet::schema::types::ColumnDescriptor;

/// What the numbers of a column are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Numbers {
    /// `FLOAT`.
    Single,
    /// `DOUBLE`.
    Double,
    /// Whole numbers of up to 64 bits.
    Signed,
    /// Whole numbers without a sign, which the file stores in the bits of signed ones.
    Unsigned,
    /// Times since an epoch, in this part of a second.
    Timestamp(f64),
}

impl Numbers {
    /// `None` for a column of lists, or of something that is no number.
    pub(super) fn of(descriptor: &ColumnDescriptor) -> Option<Self> {
        if descriptor.max_rep_level() > 0 {
            return None;
        }
        match descriptor.physical_type() {
            Type::FLOAT => Some(Self::Single),
            Type::DOUBLE => Some(Self::Double),
            Type::INT32 | Type::INT64 => match descriptor.logical_type_ref() {
                Some(LogicalType::Integer(integer)) if integer.is_signed => Some(Self::Signed),
                Some(LogicalType::Integer(_)) => Some(Self::Unsigned),
                Some(LogicalType::Timestamp(timestamp)) => Some(Self::Timestamp(match timestamp.unit {
                    TimeUnit::MILLIS => 1e-3,
                    TimeUnit::MICROS => 1e-6,
                    TimeUnit::NANOS => 1e-9,
                })),
                // What pyarrow writes where every cell is null.
                Some(LogicalType::Unknown) => Some(Self::Signed),
                Some(_) => None,
                // Writers before the format's version 2.4 say it in another field.
                None => match descriptor.converted_type() {
                    ConvertedType::NONE
                    | ConvertedType::INT_8
                    | ConvertedType::INT_16
                    | ConvertedType::INT_32
                    | ConvertedType::INT_64 => Some(Self::Signed),
                    ConvertedType::UINT_8
                    | ConvertedType::UINT_16
                    | ConvertedType::UINT_32
                    | ConvertedType::UINT_64 => Some(Self::Unsigned),
                    ConvertedType::TIMESTAMP_MILLIS => Some(Self::Timestamp(1e-3)),
                    ConvertedType::TIMESTAMP_MICROS => Some(Self::Timestamp(1e-6)),
                    _ => None,
                },
            },
            _ => None,
        }
    }

    /// Whether a sensor's samples may be such numbers.
    pub(super) fn is_sample(self) -> bool {
        !matches!(self, Self::Timestamp(_))
    }

    /// How far times of this type may be rounded: to their last decimal, or to what the type resolves at their size.
    pub(super) fn resolution_s(self, times_s: &[f64]) -> f64 {
        const MOST_DECIMALS: i32 = 9;
        let largest_s = times_s.iter().fold(0.0_f64, |largest, time_s| largest.max(time_s.abs()));
        let (type_step_s, unit_s): (f64, f64) = match self {
            Self::Single => (largest_s * f64::from(f32::EPSILON), 0.0),
            Self::Timestamp(unit_s) => (largest_s * f64::EPSILON, unit_s),
            Self::Double | Self::Signed | Self::Unsigned => (largest_s * f64::EPSILON, 0.0),
        };
        let has_decimals = |decimals: i32| {
            let scale = 10_f64.powi(decimals);
            let rest = |time_s: &f64| (time_s * scale - (time_s * scale).round()).abs();
            times_s.iter().all(|time_s| rest(time_s) <= (2.0 * type_step_s * scale).max(1e-6))
        };
        let decimals = (0..MOST_DECIMALS).find(|decimals| has_decimals(*decimals)).unwrap_or(MOST_DECIMALS);
        0.1_f64.powi(decimals).max(type_step_s).max(unit_s)
    }
}

/// Whether a column holds dates and times of day.
pub(super) fn is_timestamp(descriptor: &ColumnDescriptor) -> bool {
    matches!(Numbers::of(descriptor), Some(Numbers::Timestamp(_)))
}

/// Whether these are of no known zone; writers before the format's version 2.4 wrote UTC.
pub(super) fn is_local(descriptor: &ColumnDescriptor) -> bool {
    matches!(descriptor.logical_type_ref(), Some(LogicalType::Timestamp(timestamp)) if !timestamp.is_adjusted_to_u_t_c)
}

/// Working space that all columns share.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    levels: Vec<i16>,
    singles: Vec<f32>,
    doubles: Vec<f64>,
    shorts: Vec<i32>,
    longs: Vec<i64>,
}

/// How the cells of one column become doubles.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cells {
    numbers: Numbers,
    /// The definition level of a cell that is not null.
    present: i16,
}

impl Cells {
    pub(super) fn new(numbers: Numbers, descriptor: &ColumnDescriptor) -> Self {
        Self { numbers, present: descriptor.max_def_level() }
    }

    /// Decodes the next `rows` cells to `to` and returns how many there were.
    pub(super) fn read<'a>(
        self,
        reader: &mut ColumnReader,
        rows: usize,
        scratch: &mut Scratch,
        to: impl Iterator<Item = &'a mut f64>,
    ) -> Result<usize, ParquetError> {
        let Scratch { levels, singles, doubles, shorts, longs } = scratch;
        let present = self.present;
        match (reader, self.numbers) {
            (ColumnReader::FloatColumnReader(reader), _) => {
                decode(reader, rows, present, levels, singles, |value| f64::from(*value), to)
            }
            (ColumnReader::DoubleColumnReader(reader), _) => {
                decode(reader, rows, present, levels, doubles, |value| *value, to)
            }
            (ColumnReader::Int32ColumnReader(reader), Numbers::Unsigned) => {
                decode(reader, rows, present, levels, shorts, |value| f64::from(value.cast_unsigned()), to)
            }
            (ColumnReader::Int32ColumnReader(reader), _) => {
                decode(reader, rows, present, levels, shorts, |value| f64::from(*value), to)
            }
            (ColumnReader::Int64ColumnReader(reader), Numbers::Unsigned) => {
                decode(reader, rows, present, levels, longs, |value| value.cast_unsigned() as f64, to)
            }
            (ColumnReader::Int64ColumnReader(reader), Numbers::Timestamp(unit_s)) => {
                // Divided, as 0.001 is no double but 1000 is.
                let a_second = unit_s.recip().round();
                decode(reader, rows, present, levels, longs, |value| *value as f64 / a_second, to)
            }
            (ColumnReader::Int64ColumnReader(reader), _) => {
                decode(reader, rows, present, levels, longs, |value| *value as f64, to)
            }
            _ => Err(ParquetError::General("its type is not that of the schema".to_owned())),
        }
    }
}

fn decode<'a, T: DataType>(
    reader: &mut ColumnReaderImpl<T>,
    rows: usize,
    present: i16,
    levels: &mut Vec<i16>,
    raw: &mut Vec<T::T>,
    number: impl Fn(&T::T) -> f64,
    mut to: impl Iterator<Item = &'a mut f64>,
) -> Result<usize, ParquetError> {
    levels.clear();
    raw.clear();
    let (records, _, _) = reader.read_records(rows, Some(&mut *levels), None, raw)?;
    let mut values = raw.iter();
    for row in 0..records {
        let is_null = present > 0 && levels.get(row).is_none_or(|level| *level < present);
        let value = if is_null { None } else { values.next() };
        if let Some(to) = to.next() {
            *to = value.map_or(f64::NAN, &number);
        }
    }
    Ok(records)
}
