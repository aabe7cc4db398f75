//! How large a model may be: full matrices of all its unknowns have to fit into the memory that is free.

use std::fmt;

/// Full matrices that a comparison holds at once, its parallel parts together: measured with 500 and 1000 unknowns, 210 MB and 640 MB.
const MATRICES: u128 = 80;

/// Where it is not known how much memory is free.
const FREE_IF_UNKNOWN: u64 = 1 << 36;

/// A model needs more memory than there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TooManyUnknowns {
    unknowns: usize,
    /// Held at once.
    matrices: u128,
    needed_bytes: u128,
    free_bytes: u64,
}

impl fmt::Display for TooManyUnknowns {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let gigabytes =
            |bytes: f64| if bytes < 1e10 { format!("{:.1}", bytes * 1e-9) } else { format!("{:.0}", bytes * 1e-9) };
        write!(
            formatter,
            "a model of {} unknowns takes about {} GB of memory, and {} GB are free; up to {} unknowns fit",
            self.unknowns,
            gigabytes(self.needed_bytes as f64),
            gigabytes(self.free_bytes as f64),
            most_within(self.free_bytes, self.matrices)
        )
    }
}

/// Whether a model of so many unknowns fits into the memory that is free now.
///
/// # Errors
/// How much it would take, where it does not.
pub fn fits_in_full(unknowns: usize) -> Result<(), TooManyUnknowns> {
    fits_with(unknowns, 0)
}

/// The same with so many full matrices more than usual.
///
/// # Errors
/// As there.
pub(super) fn fits_with(unknowns: usize, more_matrices: usize) -> Result<(), TooManyUnknowns> {
    fit(unknowns, MATRICES + more_matrices as u128, free_bytes().unwrap_or(FREE_IF_UNKNOWN))
}

fn fit(unknowns: usize, matrices: u128, free_bytes: u64) -> Result<(), TooManyUnknowns> {
    let entries = (unknowns as u128).saturating_mul(unknowns as u128);
    let needed_bytes = entries.saturating_mul(matrices * size_of::<f64>() as u128);
    if needed_bytes <= u128::from(free_bytes) {
        return Ok(());
    }
    Err(TooManyUnknowns { unknowns, matrices, needed_bytes, free_bytes })
}

/// The largest number of unknowns that fits.
fn most_within(free_bytes: u64, matrices: u128) -> u64 {
    (free_bytes as f64 / (matrices as f64 * size_of::<f64>() as f64)).sqrt() as u64
}

/// Whether so many numbers fit into the memory that is free now.
///
/// # Errors
/// What they take and what is free, in GB.
pub(super) fn fit_numbers(numbers: usize) -> Result<(), [f64; 2]> {
    let needed = numbers as f64 * size_of::<f64>() as f64;
    let free = free_bytes().unwrap_or(FREE_IF_UNKNOWN) as f64;
    if needed <= free { Ok(()) } else { Err([needed * 1e-9, free * 1e-9]) }
}

/// Memory that this program may still take.
#[cfg(target_os = "linux")]
fn free_bytes() -> Option<u64> {
    use rustix::process::{Resource, getrlimit};
    let meminfo = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let available = line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?.saturating_mul(1024);
    let Some(limit) = getrlimit(Resource::As).current else { return Some(available) };
    let pages = std::fs::read_to_string("/proc/self/statm").ok()?;
    let taken = pages.split_whitespace().next()?.parse::<u64>().ok()?.saturating_mul(rustix::param::page_size() as u64);
    Some(available.min(limit.saturating_sub(taken)))
}

#[cfg(not(target_os = "linux"))]
fn free_bytes() -> Option<u64> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fits_into(unknowns: usize, free_bytes: u64) -> Result<(), TooManyUnknowns> {
        fit(unknowns, MATRICES, free_bytes)
    }

    #[test]
    fn what_does_not_fit_is_told_with_what_would() {
        const GB: u64 = 1_000_000_000;
        assert!(fits_into(1000, GB).is_ok());
        let error = fits_into(5000, 2 * GB).unwrap_err().to_string();
        for part in ["5000 unknowns", "16 GB", "2.0 GB are free", "up to 1767 unknowns"] {
            assert!(error.contains(part), "no {part:?} in: {error}");
        }
        assert!(fits_into(1767, 2 * GB).is_ok() && fits_into(1769, 2 * GB).is_err());
        // 8 TB a matrix.
        assert!(fits_into(1_000_000, 512 * GB).is_err());
        assert!(fits_into(usize::MAX, u64::MAX).is_err());
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn free_memory_is_known() {
        assert!(free_bytes().is_some_and(|bytes| bytes > 1 << 20));
    }
}
