//! Options that name a range of time among collected windows.

use std::time::Duration;

use anyhow::bail;
use clap::Args;

use crate::archive::{TimeRange, moment, parse_moment};
use crate::study::Study;

/// Which part of what nodes have sent is meant.
#[derive(Debug, Clone, Default, Args)]
pub struct RangeArguments {
    /// Of windows collected live, those from this time in UTC on, such as 2026-11-02 or 2026-11-02T12:30
    #[arg(long, value_name = "TIME", value_parser = parse_moment)]
    pub from: Option<i64>,
    /// Those before this time in UTC
    #[arg(long, value_name = "TIME", value_parser = parse_moment)]
    pub to: Option<i64>,
    /// Those of the last such time, as 7d or 12h, up to the newest window or to --to
    #[arg(long, value_name = "DURATION", value_parser = duration, conflicts_with = "from")]
    pub last: Option<Duration>,
}

/// Reads a length of time.
pub(super) fn duration(text: &str) -> Result<Duration, String> {
    match humantime::parse_duration(text) {
        Ok(duration) if !duration.is_zero() => Ok(duration),
        Ok(_) => Err("expected more than no time".to_owned()),
        Err(error) => Err(format!("{error}; expected a time such as 30d, 12h or 40min")),
    }
}

/// A length of time as it is typed, in the largest unit that has a whole number of it.
fn typed(length: Duration) -> String {
    let milliseconds = length.as_millis();
    let units = [("d", 86_400_000), ("h", 3_600_000), ("min", 60_000), ("s", 1000)];
    let whole = units.iter().find(|(_, unit)| milliseconds.is_multiple_of(*unit));
    whole.map_or_else(|| format!("{milliseconds}ms"), |(name, unit)| format!("{}{name}", milliseconds / unit))
}

impl RangeArguments {
    /// The range.
    ///
    /// # Errors
    /// Where it ends before it begins.
    pub fn range(&self) -> anyhow::Result<TimeRange> {
        if let (Some(from), Some(to)) = (self.from, self.to)
            && from >= to
        {
            bail!("--from must be before --to");
        }
        Ok(TimeRange { from_us: self.from, to_us: self.to, last: self.last })
    }

    /// The options as they are typed.
    pub fn words(&self) -> Vec<String> {
        let mut words = Vec::new();
        for (option, us) in [("--from", self.from), ("--to", self.to)] {
            words.extend(us.into_iter().flat_map(|us| [option.to_owned(), moment(us)]));
        }
        words.extend(self.last.into_iter().flat_map(|last| ["--last".to_owned(), typed(last)]));
        words
    }

    /// The range among a study's windows.
    ///
    /// # Errors
    /// As [`RangeArguments::range`], or where the study has recordings alone.
    pub fn range_of(&self, study: &Study) -> anyhow::Result<TimeRange> {
        let range = self.range()?;
        if !range.is_all() && !study.setups.iter().any(|setup| setup.live) {
            bail!(
                "--from, --to and --last choose among windows that nodes have sent; this study has no setup with `live = true`"
            );
        }
        Ok(range)
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        range: RangeArguments,
    }

    #[test]
    fn a_range_that_is_typed_again_is_the_same() {
        for typed in [
            &["--last", "7d"][..],
            &["--last", "90min"],
            &["--last", "1500ms"],
            &["--from", "2026-11-02T12:30:00Z", "--to", "2026-11-03T00:00:00Z"],
            &["--to", "2026-11-03T00:00:00Z", "--last", "2h"],
            &[],
        ] {
            let read = |words: &[String]| {
                Line::parse_from(std::iter::once("line").chain(words.iter().map(String::as_str))).range
            };
            let words: Vec<String> = typed.iter().map(|&word| word.to_owned()).collect();
            let range = read(&words);
            assert_eq!(range.words(), words);
            assert_eq!(read(&range.words()).range().unwrap(), range.range().unwrap());
        }
        let backwards = Line::parse_from(["line", "--from", "2026-11-03", "--to", "2026-11-02"]).range;
        assert!(backwards.range().is_err_and(|error| error.to_string().contains("--from must be before --to")));
        assert!(Line::try_parse_from(["line", "--last", "0s"]).is_err());
        assert!(Line::try_parse_from(["line", "--from", "2026-11-02", "--last", "7d"]).is_err());
    }
}
