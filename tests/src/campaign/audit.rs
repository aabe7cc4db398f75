//! The audit: every window that was made, against what the archive has and what it lists as lost.

use std::collections::BTreeMap;
use std::path::Path;

use belfry_host::archive::{ARCHIVE_FILE, Archive};
use belfry_host::window::{Loss, LossReason};
use rusqlite::Connection;

use super::node::{Life, fingerprint_of_rows};
use super::report::Report;

/// A window as it is in the archive.
struct Stored {
    count: u32,
    grid_index: u64,
    fingerprint: u64,
}

/// What windows can be dated.
#[derive(Debug, Clone, Copy)]
pub(super) struct Dates {
    /// The earliest Unix time in µs that the computer's clock has shown.
    pub(super) earliest_us: i64,
    /// From a window to the next.
    pub(super) hop_us: i64,
}

/// Windows that begin further ahead of the computer's clock are misdated.
const MOST_AHEAD_US: i64 = 86_400_000_000;

impl Dates {
    /// Whether the computer's clock has ever been so far behind a window that begins there.
    fn can_be_misdated(&self, grid_index: u64) -> bool {
        let start_us = i64::try_from(grid_index).unwrap_or(i64::MAX).saturating_mul(self.hop_us);
        start_us > self.earliest_us.saturating_add(MOST_AHEAD_US)
    }
}

/// Holds the lives of all nodes against the archive in `folder`.
pub(super) fn audit(
    folder: &Path,
    lives: &[Life],
    dates: Dates,
    report: &mut Report,
) -> Result<(), Box<dyn std::error::Error>> {
    let checked = Archive::check(folder)?;
    if !checked.is_sound {
        report.violations.push(format!("the archive is damaged: {:?} {:?}", checked.damages, checked.structure));
    }
    let losses: Vec<Loss> = checked.lost.iter().map(|listed| listed.loss).collect();
    let mut stored = read(folder, report)?;
    for life in lives {
        report.lives += 1;
        report.made += u64::from(life.made);
        let stored = stored.remove(&(life.node, life.boot)).unwrap_or_default();
        judge(life, &stored, &losses, dates, report);
    }
    for ((node, boot), windows) in stored {
        report.violations.push(format!("{} windows of node {node}, boot {boot}, which has not been", windows.len()));
    }
    Ok(())
}

/// The windows of every life in the archive.
fn read(folder: &Path, report: &mut Report) -> rusqlite::Result<BTreeMap<(u16, u32), BTreeMap<u32, Stored>>> {
    let archive = Connection::open(folder.join(ARCHIVE_FILE))?;
    let mut lives: BTreeMap<(u16, u32), BTreeMap<u32, Stored>> = BTreeMap::new();
    let mut windows = archive.prepare(
        "SELECT id, node, boot, number, grid_index, middle_offset_us, drift_ppb, configuration, sound < channels FROM window",
    )?;
    let mut channels =
        archive.prepare("SELECT state, coalesce(lines, x'') FROM channel WHERE window = ?1 ORDER BY channel")?;
    let mut rows = windows.query([])?;
    while let Some(row) = rows.next()? {
        let id: i64 = row.get(0)?;
        let parts: Vec<(String, Vec<u8>)> =
            channels.query_map([id], |row| Ok((row.get(0)?, row.get(1)?)))?.collect::<rusqlite::Result<_>>()?;
        report.gaps += u64::from(row.get::<_, bool>(8)?);
        let fingerprint = fingerprint_of_rows(row.get(5)?, row.get(6)?, row.get(7)?, &parts);
        let window = lives.entry((row.get(1)?, row.get(2)?)).or_default().entry(row.get(3)?);
        window.or_insert_with(|| Stored { count: 0, grid_index: row.get(4).unwrap_or_default(), fingerprint }).count +=
            1;
    }
    Ok(lives)
}

/// Whether each window of a life is in the archive once, as it was sent, or listed as lost.
fn judge(life: &Life, stored: &BTreeMap<u32, Stored>, losses: &[Loss], dates: Dates, report: &mut Report) {
    let Life { node, boot, made, .. } = *life;
    let mut wrong = |number: u32, what: &str| {
        report.violations.push(format!("window {number} of {made} of node {node}, boot {boot}: {what}"));
    };
    if let Some((&last, _)) = stored.last_key_value()
        && last >= made
    {
        wrong(last, "it is in the archive and was never made");
    }
    for (&number, window) in stored {
        match life.sent.get(&number) {
            _ if window.count != 1 => wrong(number, "it is in the archive more than once"),
            None => wrong(number, "it is in the archive and was never sent whole"),
            Some(&sent) if sent != (window.grid_index, window.fingerprint) => {
                wrong(number, "it is in the archive as something else than was sent");
            }
            Some(_) => {}
        }
    }
    report.stored += stored.len() as u64;
    let listed: Vec<&Loss> = losses.iter().filter(|loss| (loss.node, loss.boot) == (node, boot)).collect();
    let mut lost = BTreeMap::new();
    for number in (0..made).filter(|number| !stored.contains_key(number)) {
        let is_listed = |loss: &&&Loss| loss.first <= number && loss.last.is_none_or(|last| number <= last);
        match listed.iter().find(is_listed) {
            Some(loss) => {
                *lost.entry(loss.reason).or_insert(0_u32) += 1;
                report.lose(&loss.reason.to_string());
                let sent = life.sent.get(&number);
                if loss.reason == LossReason::Misdated
                    && !sent.is_some_and(|&(grid_index, _)| dates.can_be_misdated(grid_index))
                {
                    report.violations.push(format!(
                        "window {number} of {made} of node {node}, boot {boot}: it is listed as misdated, and its date is possible"
                    ));
                }
            }
            None => report.violations.push(format!(
                "window {number} of {made} of node {node}, boot {boot}: it is neither in the archive nor listed as lost"
            )),
        }
    }
    for number in stored.keys() {
        let is_listed = |loss: &&Loss| loss.first <= *number && loss.last.is_some_and(|last| *number <= last);
        if listed.iter().any(is_listed) {
            report.violations.push(format!(
                "window {number} of {made} of node {node}, boot {boot}: it is in the archive and listed as lost"
            ));
        }
    }
    // What could be helped: the node still had it, or has given it away without need.
    let of = |reason| lost.get(&reason).copied().unwrap_or(0);
    if of(LossReason::Unreadable) > 0 {
        report.violations.push(format!(
            "{} windows of node {node}, boot {boot}, could not be read, and the node sends none such",
            of(LossReason::Unreadable)
        ));
    }
    let total = of(LossReason::Overwritten) + of(LossReason::Restarted);
    if total > life.dropped + life.held {
        report.violations.push(format!(
            "{total} windows of node {node}, boot {boot}, are lost; it has dropped {} and had {} in the end",
            life.dropped, life.held
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A life of ten windows of which window 9 was still held in the end, as it is judged with some of them in the archive.
    fn judged(stored: &[(u32, u32, u64)], losses: &[Loss]) -> Report {
        let sent = (0..10).map(|number| (number, (u64::from(number), 5))).collect();
        let life = Life { node: 1, boot: 7, made: 10, held: 1, dropped: 2, sent };
        let stored = stored.iter().map(|&(number, count, fingerprint)| {
            (number, Stored { count, grid_index: u64::from(number), fingerprint })
        });
        let mut report = Report::new(0);
        // Windows from 8 on are dated further ahead than a day.
        let dates = Dates { earliest_us: -MOST_AHEAD_US + 7, hop_us: 1 };
        judge(&life, &stored.collect(), losses, dates, &mut report);
        report
    }

    fn loss(first: u32, last: Option<u32>, reason: LossReason) -> Loss {
        Loss { node: 1, boot: 7, first, last, reason }
    }

    fn all_but(without: &[u32]) -> Vec<(u32, u32, u64)> {
        (0..10).filter(|number| !without.contains(number)).map(|number| (number, 1, 5)).collect()
    }

    #[test]
    fn what_is_stored_once_or_listed_is_right() {
        let lost = [
            loss(2, Some(3), LossReason::Overwritten),
            loss(8, Some(8), LossReason::Misdated),
            loss(9, None, LossReason::Restarted),
        ];
        let report = judged(&all_but(&[2, 3, 8, 9]), &lost);
        assert_eq!((report.violations, report.stored, report.lost.len()), (Vec::new(), 6, 3));
    }

    #[test]
    fn whatever_else_is_wrong() {
        let twice: Vec<_> = all_but(&[4]).into_iter().chain([(4, 2, 5)]).collect();
        let changed: Vec<_> = all_but(&[4]).into_iter().chain([(4, 1, 6)]).collect();
        let invented: Vec<_> = all_but(&[]).into_iter().chain([(10, 1, 5)]).collect();
        let cases = [
            (judged(&all_but(&[4]), &[]), "neither in the archive nor listed"),
            (judged(&all_but(&[4]), &[Loss { boot: 8, ..loss(4, Some(4), LossReason::Overwritten) }]), "neither"),
            (judged(&twice, &[]), "more than once"),
            (judged(&changed, &[]), "something else than was sent"),
            (judged(&invented, &[]), "never made"),
            (judged(&all_but(&[]), &[loss(4, Some(4), LossReason::Overwritten)]), "and listed as lost"),
            (judged(&all_but(&[4]), &[loss(4, Some(4), LossReason::Unreadable)]), "could not be read"),
            (judged(&all_but(&[4]), &[loss(4, Some(4), LossReason::Misdated)]), "its date is possible"),
            (
                judged(&all_but(&[1, 2, 3, 4]), &[loss(1, Some(4), LossReason::Overwritten)]),
                "are lost; it has dropped 2",
            ),
        ];
        for (report, what) in cases {
            assert!(report.violations.iter().any(|violation| violation.contains(what)), "{what}: {report}");
        }
    }
}
