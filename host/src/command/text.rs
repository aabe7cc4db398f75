//! What the commands print with: tables that fit the terminal, numbers, probabilities, and the lines that say what comes next.

use std::borrow::Cow;
use std::fmt;
use std::path::Path;

use comfy_table::presets::UTF8_FULL_CONDENSED;
use comfy_table::{Cell, CellAlignment, ColumnConstraint, ContentArrangement, Table, Width};

use crate::diagnose::Estimate;
use crate::numbers::mac_words;

pub(super) use crate::numbers::{short, with_std};

/// A table that fits the terminal: where it is too wide its header wraps, and then columns that a reader can do without are left
/// out.
#[derive(Debug)]
pub(super) struct Columns {
    table: Table,
    /// Columns that a narrow terminal can do without, the least important first.
    expendable: Vec<usize>,
    /// Names of the columns, for the line that says what was left out.
    names: Vec<String>,
    width: Option<u16>,
}

/// A text as a terminal may have it: control characters, and those that turn the direction of writing, would let a name in a study write
/// anywhere on the screen. They are shown as escapes.
pub(crate) fn printable(text: &str) -> Cow<'_, str> {
    let is_harmless = |letter: char| {
        matches!(letter, '\n' | '\t')
            || !(letter.is_control() || matches!(letter, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}'))
    };
    if text.chars().all(is_harmless) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    for letter in text.chars() {
        if is_harmless(letter) {
            shown.push(letter);
        } else {
            shown.extend(letter.escape_unicode());
        }
    }
    Cow::Owned(shown)
}

/// A message in which no word is longer than anybody reads: a cell of a damaged file may have megabytes.
pub(crate) fn shortened(message: &str) -> Cow<'_, str> {
    /// Paths and names are shorter.
    const LONGEST: usize = 1000;
    const KEPT: usize = 60;
    if message.split_whitespace().all(|word| word.len() <= LONGEST) {
        return Cow::Borrowed(message);
    }
    let mut short = String::new();
    for word in message.split_inclusive(char::is_whitespace) {
        if word.len() <= LONGEST {
            short.push_str(word);
            continue;
        }
        let letters = word.trim_end().chars().count();
        short.extend(word.chars().take(KEPT));
        short.push_str(&format!("… ({letters} characters) "));
    }
    Cow::Owned(short)
}

/// Blanks beside a cell's text, and the line before it.
const AROUND_CELL: u16 = 3;

impl Columns {
    /// A table of numbers, right-aligned.
    pub(super) fn new<'a>(header: impl IntoIterator<Item = &'a str>) -> Self {
        let names: Vec<String> = header.into_iter().map(str::to_owned).collect();
        let mut table = Table::new();
        table.load_style(UTF8_FULL_CONDENSED);
        table.set_header(&names);
        Self { table, expendable: Vec::new(), names, width: width() }
    }

    /// Names the columns that a narrow terminal can do without, the least important first.
    pub(super) fn expendable(mut self, columns: &[usize]) -> Self {
        self.expendable = columns.to_vec();
        self
    }

    /// Appends a row.
    pub(super) fn row<T: Into<Cell>>(&mut self, cells: impl IntoIterator<Item = T>) {
        self.table.add_row(cells.into_iter().map(Into::into).collect::<Vec<Cell>>());
    }

    /// The table within `width` columns of text, and the names of what was left out.
    fn fitted(&self, width: u16) -> (Table, Vec<&str>) {
        let mut table = self.table.clone();
        let narrowest: Vec<u16> = (0..self.names.len()).map(|column| self.narrowest(column)).collect();
        let mut shown = vec![true; self.names.len()];
        let needed = |shown: &[bool]| -> u16 {
            1 + narrowest
                .iter()
                .zip(shown)
                .filter(|(_, shown)| **shown)
                .map(|(text, _)| text + AROUND_CELL)
                .sum::<u16>()
        };
        for &column in &self.expendable {
            if needed(&shown) > width {
                shown[column] = false;
            }
        }
        table.set_content_arrangement(ContentArrangement::Dynamic).set_width(width);
        for (index, column) in table.column_iter_mut().enumerate() {
            column.set_constraint(if shown[index] {
                ColumnConstraint::LowerBoundary(Width::Fixed(narrowest[index] + AROUND_CELL - 1))
            } else {
                ColumnConstraint::Hidden
            });
        }
        let left_out = self.names.iter().zip(&shown).filter(|(_, shown)| !**shown);
        (table, left_out.map(|(name, _)| name.as_str()).collect())
    }

    /// The narrowest that a column can be: as its longest line below the header, or the longest word in it.
    fn narrowest(&self, column: usize) -> u16 {
        let longest =
            |text: &str, split: fn(char) -> bool| text.split(split).map(|part| part.chars().count()).max().unwrap_or(0);
        let header = longest(&self.names[column], char::is_whitespace);
        let rows = self.table.row_iter().filter_map(|row| row.cell_iter().nth(column));
        let rows = rows.map(|cell| longest(&cell.content(), |c| c == '\n')).max().unwrap_or(0);
        u16::try_from(header.max(rows)).unwrap_or(u16::MAX / 64)
    }
}

/// Columns of text that fit beside each other where standard output goes.
pub(super) fn width() -> Option<u16> {
    Table::new().width().or_else(width_by_environment)
}

/// Text with its paragraphs wrapped between words where they are wider than the terminal. Tables stay, and so do lines that begin
/// with a command to be typed.
pub(super) fn wrapped(text: &str) -> String {
    wrapped_to(width(), text)
}

/// The same where it goes to standard error.
pub(super) fn wrapped_for_errors(text: &str) -> String {
    wrapped_to(Table::new().use_stderr().width().or_else(width_by_environment), text)
}

fn wrapped_to(width: Option<u16>, text: &str) -> String {
    match width {
        Some(width) => {
            text.split('\n').map(|line| wrapped_line(line, usize::from(width))).collect::<Vec<_>>().join("\n")
        }
        None => text.to_owned(),
    }
}

fn wrapped_line(line: &str, width: usize) -> String {
    let text = line.trim_start();
    let stays = text.starts_with(['│', '┌', '└', '╞', '├']) || text.starts_with("Next:") || text.starts_with("belfry ");
    if stays || line.chars().count() <= width {
        return line.to_owned();
    }
    let indent = line.chars().count() - text.chars().count();
    let mut wrapped = " ".repeat(indent);
    let mut used = indent;
    for word in text.split(' ') {
        let length = word.chars().count();
        if used > indent && used + 1 + length > width {
            wrapped.push('\n');
            wrapped += &" ".repeat(indent);
            used = indent;
        } else if used > indent {
            wrapped.push(' ');
            used += 1;
        }
        wrapped += word;
        used += length;
    }
    wrapped
}

/// Columns that the environment asks for, as other programs do where standard output is no terminal.
fn width_by_environment() -> Option<u16> {
    std::env::var("COLUMNS").ok()?.parse().ok().filter(|&width| width > 0)
}

impl fmt::Display for Columns {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (mut table, mut left_out) = match self.width {
            Some(width) => self.fitted(width),
            None => (self.table.clone(), Vec::new()),
        };
        for column in table.column_iter_mut() {
            column.set_cell_alignment(CellAlignment::Right);
        }
        write!(formatter, "{table}")?;
        if !left_out.is_empty() {
            // Two columns of one name are told once.
            left_out.dedup();
            write!(formatter, "\nNot shown on so narrow a terminal: {}.", left_out.join(", "))?;
        }
        Ok(())
    }
}

/// Aligns the first `count` columns to the right, as numbers stand.
pub(super) fn align_right(table: &mut Table, count: usize) {
    for column in table.column_iter_mut().take(count) {
        column.set_cell_alignment(CellAlignment::Right);
    }
}

/// A number, or a dash where there is none.
pub(super) fn or_dash(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// A MAC, never rounded up to a perfect one.
pub(super) fn mac_text(mac: Option<f64>, digits: usize) -> String {
    mac.map_or_else(|| "-".to_owned(), |mac| mac_words(mac, digits))
}

/// Values with their deviations.
pub(super) fn values_text(parameters: &[Estimate]) -> String {
    values_before_units(parameters, " ")
}

/// The same, with something between a value and its unit.
pub(super) fn values_before_units(parameters: &[Estimate], between: &str) -> String {
    let several = parameters.iter().filter(|parameter| parameter.std.is_some()).count() > 1;
    let words: Vec<String> = parameters
        .iter()
        .map(|parameter| {
            let name = if several { format!("{} ", parameter.name) } else { String::new() };
            let unit = unit_after(between, &parameter.unit);
            match parameter.std {
                Some(std) => format!("{name}{}{unit}", with_std(parameter.value, std)),
                None => format!("{} {}{unit}", parameter.name, short(parameter.value)),
            }
        })
        .collect();
    words.join("\n")
}

/// A unit behind a number; nothing for a number without one.
pub(super) fn unit_text(unit: &str) -> String {
    unit_after(" ", unit)
}

fn unit_after(between: &str, unit: &str) -> String {
    if unit == "-" { String::new() } else { format!("{between}{unit}") }
}

/// A probability in a sentence.
pub(crate) fn p_is(p_value: f64) -> String {
    if p_value < 1e-4 { format!("p {}", p_text(p_value)) } else { format!("p = {}", p_text(p_value)) }
}

/// A probability in a table.
pub(super) fn p_text(p_value: f64) -> String {
    if p_value < 1e-4 { "< 0.0001".to_owned() } else { format!("{p_value:.4}") }
}

/// A study's folder as one types it in a shell.
pub(crate) fn in_shell(folder: &Path) -> String {
    let text = folder.to_string_lossy();
    // A name with a NUL byte cannot be typed; a file cannot have one either.
    shlex::try_quote(&text).unwrap_or(Cow::Borrowed(&text)).into_owned()
}

/// What one can do next: commands below each other, each with what it is for. Every line can be run as it stands.
pub(super) fn next_lines(commands: &[(String, &str)]) -> String {
    let widest = commands.iter().map(|(command, _)| command.chars().count()).max().unwrap_or(0);
    let line = |(index, (command, purpose)): (usize, &(String, &str))| {
        let label = if index == 0 { "Next:" } else { "     " };
        format!("{label} belfry {command:widest$}    # {purpose}")
    };
    commands.iter().enumerate().map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_write_elsewhere_on_the_screen() {
        assert_eq!(printable("a\u{1b}[2J\u{7}\r\u{9b}b\u{202e}c"), "a\\u{1b}[2J\\u{7}\\u{d}\\u{9b}b\\u{202e}c");
        for harmless in ["Großer Turm │ ± 0.1 Hz\n\tnext", "塔 \"north\"", ""] {
            assert!(matches!(printable(harmless), Cow::Borrowed(text) if text == harmless));
        }
    }

    #[test]
    fn a_word_of_megabytes_is_cut_in_messages() {
        let message = format!("line 3: `{}` where a number was expected", "塔".repeat(1_000_000));
        let short = shortened(&message);
        assert!(short.len() < 400 && short.contains("… (1000002 characters) where a number was expected"), "{short}");
        assert_eq!(shortened("a usual message\nof two lines"), "a usual message\nof two lines");
    }

    fn widest(text: &str) -> usize {
        text.lines().map(|line| line.chars().count()).max().unwrap_or(0)
    }

    #[test]
    fn a_table_fits_80_columns_and_no_number_is_broken() {
        let header =
            ["mode", "frequency Hz", "± Hz", "best ±", "damping %", "± %", "best ±", "collinearity", "moves most at"];
        let mut table = Columns::new(header).expendable(&[6, 3, 7, 8]);
        let cells = ["1", "0.108402", "0.000043", "0.000054", "0.73", "0.05", "0.05", "0.9998", "a long point"];
        table.row(cells);
        table.width = None;
        assert!(widest(&table.to_string()) > 80);
        for (width, hidden) in [(110, 0), (80, 2), (60, 4)] {
            table.width = Some(width);
            let text = table.to_string();
            let (_, left_out) = table.fitted(width);
            let body: Vec<&str> = text.lines().filter(|line| line.starts_with(['│', '┌', '└', '╞'])).collect();
            assert!(widest(&body.join("\n")) <= usize::from(width), "{width}:\n{text}");
            assert!(left_out.len() >= hidden && (hidden > 0 || left_out.is_empty()), "{width}: {left_out:?}");
            for cell in ["0.108402", "0.73", "0.000043"] {
                assert!(text.contains(cell), "{cell} is broken or gone at {width}:\n{text}");
            }
            assert_eq!(left_out.is_empty(), !text.contains("Not shown"), "{text}");
        }
    }

    #[test]
    fn paragraphs_wrap_between_words_and_keep_their_indent() {
        let line = "  by mode: frequency worst in mode 7 at 0.4755 Hz (+12.34 %), and more of it";
        let wrapped = wrapped_line(line, 40);
        assert!(widest(&wrapped) <= 40 && wrapped.lines().count() == 2, "{wrapped}");
        assert!(wrapped.lines().all(|part| part.starts_with("  ")), "{wrapped}");
        assert_eq!(wrapped.split_whitespace().collect::<Vec<_>>(), line.split_whitespace().collect::<Vec<_>>());
        let command = "Next: belfry covalidate a-study-of-a-long-name    # what it is for";
        assert_eq!(wrapped_line(command, 40), command);
    }

    #[test]
    fn next_lines_can_be_typed() {
        let folder = in_shell(Path::new("my tower/it's"));
        let lines = next_lines(&[
            (format!("compare {folder}"), "the model against these modes"),
            ("effects".to_owned(), "all"),
        ]);
        for (line, words) in lines.lines().zip([&["belfry", "compare", "my tower/it's"][..], &["belfry", "effects"]]) {
            let typed = line.strip_prefix("Next:").unwrap_or(line);
            // shlex knows comments, as a shell does.
            assert_eq!(shlex::split(typed).unwrap(), words);
        }
        assert_eq!(in_shell(Path::new("canton")), "canton");
    }

    #[test]
    fn numbers_are_never_rounded_up_to_perfection() {
        assert_eq!(mac_text(Some(0.999_99), 4), "0.9999");
        assert_eq!(p_text(0.000_01), "< 0.0001");
        assert_eq!(short(8.0e6), "8.00e6");
    }
}
