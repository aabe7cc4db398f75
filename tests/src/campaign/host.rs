//! The host: `belfry collect` as it is started, ended, killed and started again.

use std::collections::BTreeMap;
use std::fs;
use std::time::Duration;

use belfry_host::archive::{ARCHIVE_FILE, Archive};
use belfry_host::collect::{Clock, CollectOptions, Collection, Collector, PortServer};
use belfry_host::study::Study;
use rusqlite::Connection;

use super::report::Report;
use super::world::{BAUD, World};

/// Everything is looked at this often, whether or not bytes come.
const TICK: Duration = Duration::from_millis(250);
/// A host that could not start is started again after this time.
const RESTART: Duration = Duration::from_secs(10);
/// More than any archive here takes.
const NO_LIMIT: u64 = 1 << 40;

/// Has everything go its way up to `end`, with whatever fails.
pub(super) fn live_through(world: &World, end: Duration, report: &mut Report) -> Result<(), String> {
    while world.now() < end {
        let away_until = match host(world, &mut |world| world.now() >= end, report)? {
            Ended::Done => return Ok(()),
            Ended::Away(until) => until.max(world.now() + TICK),
        };
        // Another program that writes would hold up the start for as long as it writes.
        while world.now() < end && (world.now() < away_until || world.now() < world.troubles().busy_until) {
            world.fail();
            // Whoever would end the host finds it away.
            let _ = world.take_away();
            tick(world, &mut |_| {});
        }
    }
    Ok(())
}

/// Has what is left over be delivered: nodes go on for a while, then sample no more. A window that the host does not believe is asked for thirty times before
/// it is given up, which takes an hour or two where there are dozens.
pub(super) fn deliver_the_rest(
    world: &World,
    aftermath: Duration,
    patience: Duration,
    report: &mut Report,
) -> Result<(), String> {
    let begin = world.now();
    host(world, &mut |world| world.now() >= begin + aftermath, report)?;
    world.set_sampling(false);
    let stopped = world.now();
    // The host goes on where it was, and looks again at what it has missed.
    let is_done = &mut |world: &World| {
        let waited = world.now() - stopped;
        waited >= patience || waited >= aftermath && !world.holds_windows()
    };
    host(world, is_done, report)?;
    Ok(())
}

enum Ended {
    /// What was waited for has come.
    Done,
    /// It is away until then.
    Away(Duration),
}

/// Has the time between two looks at everything pass, or until something fails; `serve` gets the ports where something has happened.
fn tick(world: &World, serve: &mut dyn FnMut(&[String])) {
    let latest = world.now() + TICK;
    let end = world.next_fault().map_or(latest, |fault| fault.clamp(world.now(), latest));
    while world.now() < end {
        let ports = world.step(end);
        serve(&ports);
    }
}

/// Collects until `is_done`, or until the host is to end.
fn host(world: &World, is_done: &mut dyn FnMut(&World) -> bool, report: &mut Report) -> Result<Ended, String> {
    let told = |error: &dyn std::error::Error| error.to_string();
    let study = Study::load(&world.folder).map_err(|error| told(&error))?;
    let is_full = |world: &World| world.now() < world.troubles().disk_full_until;
    let started = || -> Result<(Archive, Collection), String> {
        let mut archive = Archive::create(&world.folder).map_err(|error| told(&error))?;
        let options = CollectOptions { baud: BAUD, keys: world.keys(), ..CollectOptions::default() };
        let collection = Collection::of(&study, &mut archive, &options, world.clock.unix());
        let (_, collection) = collection.map_err(|error| told(&error))?;
        Ok((archive, collection))
    };
    let (archive, collection) = match started() {
        Ok(started) => started,
        // A full disk keeps it from starting, as it would keep the command.
        Err(_) if is_full(world) => return Ok(Ended::Away(world.now() + RESTART)),
        Err(error) => return Err(error),
    };
    world.will_measure(&collection);
    let collector = Collector::new(&collection, archive, &world.clock);
    // The time that others are waited for would be this computer's.
    collector.with_archive(|archive| archive.wait_for_others(Duration::ZERO)).map_err(|error| told(&error))?;
    let mut servers: BTreeMap<String, PortServer> = BTreeMap::new();
    let mut was_full = false;
    let mut other = None;
    let ended = loop {
        world.fail();
        if let Some((until, is_killed)) = world.take_away() {
            if is_killed {
                // Whatever it is about: nothing is said or written any more.
                servers.clear();
                return Ok(Ended::Away(until));
            }
            break Ended::Away(until);
        }
        if is_done(world) {
            break Ended::Done;
        }
        if is_full(world) != was_full {
            was_full = is_full(world);
            let length = fs::metadata(world.folder.join(ARCHIVE_FILE)).map_or(0, |metadata| metadata.len());
            let limit = if was_full { length } else { NO_LIMIT };
            collector.with_archive(|archive| archive.limit_bytes(limit)).map_err(|error| told(&error))?;
        }
        let is_busy = world.now() < world.troubles().busy_until;
        if is_busy && other.is_none() {
            let connection = Connection::open(world.folder.join(ARCHIVE_FILE)).map_err(|error| told(&error))?;
            connection.execute_batch("BEGIN IMMEDIATE").map_err(|error| told(&error))?;
            other = Some(connection);
        } else if !is_busy {
            other = None;
        }
        for port in collector.new_ports(world) {
            servers.insert(port.clone(), PortServer::new(&collector, &port));
        }
        tick(world, &mut |ports| {
            for port in ports {
                if let Some(server) = servers.get_mut(port) {
                    server.step(&collector, world);
                }
            }
        });
        report.happened(&collector.take_events());
        if collector.is_over() {
            let said = collector.finish().err().map_or_else(|| "no port is of use".to_owned(), |error| told(&error));
            report.violations.push(format!("collecting ended by itself: {said}"));
            return Ok(Ended::Away(world.now() + RESTART));
        }
    };
    drop(other);
    servers.into_values().for_each(|server| server.end(&collector));
    report.happened(&collector.take_events());
    if let Err(error) = collector.finish() {
        report.violations.push(format!("collecting failed in the end: {error}"));
    }
    Ok(ended)
}
