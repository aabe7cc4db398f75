//! A TOML table with its position in the text: hands out typed values, and errors that name file, line and key.

use std::ops::Range;
use std::path::{Path, PathBuf};

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::{FilePosition, StudyError};
use crate::nearest::nearest;

/// The text that all positions refer to.
#[derive(Debug, Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) file: &'a Path,
    pub(super) text: &'a str,
}

/// The 1-based line in which byte `offset` stands.
pub(super) fn line_of(text: &[u8], offset: usize) -> usize {
    1 + text.iter().take(offset).filter(|&&byte| byte == b'\n').count()
}

impl Source<'_> {
    fn position(&self, span: Range<usize>, key: String) -> FilePosition {
        FilePosition { file: self.file.to_owned(), line: line_of(self.text.as_bytes(), span.start), key }
    }
}

/// One table of the study.
#[derive(Debug, Clone)]
pub(super) struct Section<'a> {
    source: Source<'a>,
    table: &'a DeTable<'a>,
    span: Range<usize>,
    /// Dotted key, empty for the document itself.
    key: String,
}

/// One value of a table.
#[derive(Debug, Clone)]
pub(super) struct Entry<'a> {
    source: Source<'a>,
    value: &'a Spanned<DeValue<'a>>,
    key: String,
}

impl<'a> Section<'a> {
    /// The document as a whole.
    pub(super) fn document(source: Source<'a>, document: &'a Spanned<DeTable<'a>>) -> Self {
        Self { source, table: document.get_ref(), span: document.span(), key: String::new() }
    }

    /// Where the table starts.
    pub(super) fn position(&self) -> FilePosition {
        self.source.position(self.span.clone(), self.key.clone())
    }

    /// The study's file.
    pub(super) fn file(&self) -> PathBuf {
        self.source.file.to_owned()
    }

    /// Where `name` stands, or the table where it has no such key.
    pub(super) fn position_of(&self, name: &str) -> FilePosition {
        self.get(name).map_or_else(|| self.position(), |entry| entry.position())
    }

    fn dotted(&self, name: &str) -> String {
        if self.key.is_empty() { name.to_owned() } else { format!("{}.{name}", self.key) }
    }

    /// The value of `name`, where the table has one.
    pub(super) fn get(&self, name: &str) -> Option<Entry<'a>> {
        let value = self.table.get(name)?;
        Some(Entry { source: self.source, value, key: self.dotted(name) })
    }

    /// The value of `name`; `expected` says what should stand there when it is missing.
    pub(super) fn required(&self, name: &str, expected: &'static str) -> Result<Entry<'a>, StudyError> {
        self.get(name).ok_or_else(|| self.missing(name, expected))
    }

    /// The error that `name` is not there, or holds nothing.
    pub(super) fn missing(&self, name: &str, expected: &'static str) -> StudyError {
        StudyError::Missing { position: self.position(), name: name.to_owned(), expected, table: self.key.clone() }
    }

    /// Refuses keys that are not `known`: a misspelt key would silently be its default otherwise.
    pub(super) fn allow_only(&self, known: &'static [&'static str]) -> Result<(), StudyError> {
        let first_unknown = self
            .table
            .iter()
            .filter(|(name, _)| !known.contains(&name.get_ref().as_ref()))
            .min_by_key(|(name, _)| name.span().start);
        let Some((name, _)) = first_unknown else { return Ok(()) };
        let found = name.get_ref().to_string();
        Err(StudyError::UnknownKey {
            // As near as a slip of the finger, or a longer word cut short.
            near: nearest(&found, known.iter().copied(), 0.8),
            position: self.source.position(name.span(), self.dotted(&found)),
            known,
        })
    }

    /// The tables of `[[name]]`, none where there is none.
    pub(super) fn tables(&self, name: &str) -> Result<Vec<Section<'a>>, StudyError> {
        let Some(entry) = self.get(name) else { return Ok(Vec::new()) };
        let expected = "a list of tables, each under a header in double brackets";
        let array = entry.value.get_ref().as_array().ok_or_else(|| entry.wrong_type(expected))?;
        array.iter().map(|value| Entry { value, ..entry.clone() }.section(expected)).collect()
    }

    /// Every key but `names` as plain TOML, for what is kept without being understood.
    pub(super) fn rest(&self, names: &[&str]) -> Result<toml::Table, StudyError> {
        use serde::Deserialize;
        self.table
            .iter()
            .filter(|(name, _)| !names.contains(&name.get_ref().as_ref()))
            .map(|(name, value)| {
                let plain = toml::Value::deserialize(toml::de::ValueDeserializer::from(value.clone()));
                let name = name.get_ref().to_string();
                plain.map(|plain| (name.clone(), plain)).map_err(|error| StudyError::Syntax {
                    file: self.file(),
                    line: self.source.position(value.span(), String::new()).line,
                    message: format!("`{}` cannot be read: {}", self.dotted(&name), error.message()),
                })
            })
            .collect()
    }
}

impl<'a> Entry<'a> {
    /// Where the value stands.
    pub(super) fn position(&self) -> FilePosition {
        self.source.position(self.value.span(), self.key.clone())
    }

    /// The first line of the value as the user wrote it.
    pub(super) fn written(&self) -> String {
        let text = self.source.text.get(self.value.span()).unwrap_or_default();
        text.lines().next().unwrap_or_default().to_owned()
    }

    /// The error that something else than `expected` stands here.
    pub(super) fn wrong_type(&self, expected: &'static str) -> StudyError {
        let found = self.value.get_ref().type_str();
        StudyError::WrongType { position: self.position(), found, expected }
    }

    /// The error that the value has the right type but cannot be meant.
    pub(super) fn out_of_range(&self, expected: &'static str) -> StudyError {
        StudyError::OutOfRange { position: self.position(), found: self.written(), expected }
    }

    /// Whether the value is text.
    pub(super) fn is_text(&self) -> bool {
        self.value.get_ref().is_str()
    }

    /// Text that is not blank.
    pub(super) fn text(&self, expected: &'static str) -> Result<String, StudyError> {
        let text = self.value.get_ref().as_str().ok_or_else(|| self.wrong_type(expected))?;
        if text.trim().is_empty() { Err(self.out_of_range(expected)) } else { Ok(text.to_owned()) }
    }

    /// `true` or `false`.
    pub(super) fn boolean(&self) -> Result<bool, StudyError> {
        self.value.get_ref().as_bool().ok_or_else(|| self.wrong_type("true or false"))
    }

    /// A finite number, with or without a decimal point.
    pub(super) fn number(&self, expected: &'static str) -> Result<f64, StudyError> {
        let number = match self.value.get_ref() {
            DeValue::Integer(integer) => {
                i64::from_str_radix(integer.as_str(), integer.radix()).ok().map(|integer| integer as f64)
            }
            DeValue::Float(float) => float.as_str().parse::<f64>().ok(),
            _ => return Err(self.wrong_type(expected)),
        };
        number.filter(|number| number.is_finite()).ok_or_else(|| self.out_of_range(expected))
    }

    /// A finite number above zero.
    pub(super) fn positive(&self, expected: &'static str) -> Result<f64, StudyError> {
        let number = self.number(expected)?;
        if number > 0.0 { Ok(number) } else { Err(self.out_of_range(expected)) }
    }

    /// A relative standard deviation: a number above zero that is no percentage.
    pub(super) fn relative_std(&self, expected: &'static str) -> Result<f64, StudyError> {
        let number = self.positive(expected)?;
        if number <= 1.0 { Ok(number) } else { Err(self.out_of_range(expected)) }
    }

    /// A whole number within `range`.
    pub(super) fn whole(&self, range: Range<i64>, expected: &'static str) -> Result<i64, StudyError> {
        let integer = self.value.get_ref().as_integer().ok_or_else(|| self.wrong_type(expected))?;
        let number = i64::from_str_radix(integer.as_str(), integer.radix()).ok();
        number.filter(|number| range.contains(number)).ok_or_else(|| self.out_of_range(expected))
    }

    /// The elements of a list.
    pub(super) fn list(&self, expected: &'static str) -> Result<Vec<Entry<'a>>, StudyError> {
        let array = self.value.get_ref().as_array().ok_or_else(|| self.wrong_type(expected))?;
        Ok(array.iter().map(|value| Entry { value, ..self.clone() }).collect())
    }

    /// Two finite numbers.
    pub(super) fn pair(&self, expected: &'static str) -> Result<[f64; 2], StudyError> {
        match self.list(expected)?.as_slice() {
            [first, second] => Ok([first.number(expected)?, second.number(expected)?]),
            _ => Err(self.out_of_range(expected)),
        }
    }

    /// A table.
    pub(super) fn section(&self, expected: &'static str) -> Result<Section<'a>, StudyError> {
        let table = self.value.get_ref().as_table().ok_or_else(|| self.wrong_type(expected))?;
        Ok(Section { source: self.source, table, span: self.value.span(), key: self.key.clone() })
    }
}
