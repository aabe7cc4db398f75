//! Rows as they are, and the mending of a single flipped bit.
//!
//! The checksums of two rows that differ in one bit differ by what depends on that bit's distance from the end alone. So a flipped bit is
//! found from the checksum; that a row of megabytes with more damage is taken for one with a single flipped bit has odds of 1 to 10^11. Where
//! checksums differ in a single bit, it is the stored one that has flipped, and the row is as it was.

use rusqlite::types::{Value, ValueRef};
use rusqlite::{Connection, Row, ToSql, params_from_iter};

use super::checksum::Checksum;

/// The polynomial of CRC-64/XZ, its bits reflected.
const POLYNOMIAL: u64 = 0xC96C_5795_D787_0F42;
/// Bytes before a value: its type, and a number.
const BEFORE: usize = 9;

/// Some columns of rows, as one list of values.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Values(pub(super) Vec<Value>);

impl Values {
    /// The first `columns` of a row.
    pub(super) fn read(row: &Row<'_>, columns: &str) -> rusqlite::Result<Self> {
        (0..columns.split(", ").count()).map(|index| row.get::<_, Value>(index)).collect::<Result<_, _>>().map(Self)
    }

    /// Their checksum.
    pub(super) fn checksum(&self) -> i64 {
        let mut checksum = Checksum::new();
        self.0.iter().for_each(|value| checksum.add_value(ValueRef::from(value)));
        checksum.value()
    }

    /// Flips the one bit that makes them match `stored`, but for a bit that has flipped in that; `false` where there is no such bit.
    pub(super) fn mend(&mut self, stored: i64) -> bool {
        let difference = (self.checksum() ^ stored) as u64;
        if difference.is_power_of_two() {
            return true;
        }
        let table = table();
        // What a flip of each of a byte's bits makes of the checksum, for the last byte; for those before it is moved on.
        let mut flips: [u64; 8] = std::array::from_fn(|bit| table[1 << bit]);
        for value in self.0.iter_mut().rev() {
            let length = BEFORE + length(value);
            for place in (0..length).rev() {
                if let Some(bit) = flips.iter().position(|&flip| flip == difference) {
                    return flip(value, place, bit) && self.checksum() == stored;
                }
                flips = flips.map(|flip| table[usize::from(flip as u8)] ^ (flip >> 8));
            }
        }
        false
    }

    /// Writes them as a row of a table, with its checksum left open where `has_checksum`.
    pub(super) fn insert(
        values: &[Value],
        table: &str,
        columns: &str,
        has_checksum: bool,
        into: &Connection,
    ) -> rusqlite::Result<()> {
        let places = vec!["?"; values.len()].join(", ");
        let (column, place) = if has_checksum { (", checksum", ", 0") } else { ("", "") };
        let insert = format!("INSERT INTO {table} ({columns}{column}) VALUES ({places}{place})");
        into.prepare_cached(&insert)?
            .execute(params_from_iter(values.iter().map(|value| value as &dyn ToSql)))
            .map(drop)
    }
}

fn length(value: &Value) -> usize {
    match value {
        Value::Text(text) => text.len(),
        Value::Blob(bytes) => bytes.len(),
        Value::Null | Value::Integer(_) | Value::Real(_) => 0,
    }
}

/// Flips a bit of what a checksum is made of; `false` where that is not in the value itself.
fn flip(value: &mut Value, place: usize, bit: usize) -> bool {
    match (value, place.checked_sub(BEFORE)) {
        (Value::Integer(number), None) if place > 0 => *number ^= 1 << (8 * (place - 1) + bit),
        (Value::Blob(bytes), Some(at)) => bytes[at] ^= 1 << bit,
        (Value::Text(text), Some(at)) => {
            let mut bytes = std::mem::take(text).into_bytes();
            bytes[at] ^= 1 << bit;
            let Ok(mended) = String::from_utf8(bytes) else { return false };
            *text = mended;
        }
        _ => return false,
    }
    true
}

fn table() -> [u64; 256] {
    std::array::from_fn(|byte| {
        (0..8).fold(byte as u64, |rest, _| if rest & 1 == 1 { POLYNOMIAL ^ (rest >> 1) } else { rest >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_flipped_bit_is_mended_wherever_it_is_and_two_are_not() {
        let sound = Values(vec![
            Value::Integer(-7),
            Value::Text("now".to_owned()),
            Value::Null,
            Value::Blob((0..3000).map(|at| (at * 37 % 251) as u8).collect()),
            Value::Integer(1 << 40),
        ]);
        let stored = sound.checksum();
        let flipped = |flips: &[(usize, usize, usize)]| {
            let mut values = sound.clone();
            flips.iter().for_each(|&(value, place, bit)| assert!(flip(&mut values.0[value], place, bit)));
            values
        };
        for one in [(0, 1, 0), (0, 8, 7), (1, 9, 0), (1, 11, 4), (3, 9, 0), (3, 1800, 5), (3, 3008, 7), (4, 3, 3)] {
            let mut values = flipped(&[one]);
            assert_ne!(values, sound);
            assert!(values.mend(stored) && values == sound, "{one:?}");
        }
        assert!(!flipped(&[(3, 100, 0), (3, 2000, 1)]).mend(stored));
        for bit in [0, 31, 63] {
            let mut values = sound.clone();
            assert!(values.mend(stored ^ 1 << bit) && values == sound, "bit {bit} of the checksum");
        }
        assert!(!sound.clone().mend(stored ^ 0b11));
    }
}
