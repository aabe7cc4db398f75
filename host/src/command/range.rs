//! Options that name a range of time among collected windows.

use std::time::Duration;

use anyhow::bail;
use clap::Args;

use crate::archive::{TimeRange, parse_moment};
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
