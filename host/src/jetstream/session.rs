//! A worker's session: as long as its connection is whole. Everything begins anew with the next one, for all that counts is on the server.
//!
//! One loop reads the headers of what comes in the parts that its structures are in, keeps their ledgers, and hands intervals that are over to lanes. A
//! lane is a task a core, and a structure is always in the same one, so that its intervals follow each other.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use async_nats::jetstream::kv::Store;
use bytes::Bytes;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::task::JoinSet;
use tokio_stream::StreamExt;

use super::error::StreamError;
use super::follow::{Followed, IntervalResult};
use super::ledger::{Arrived, Due, Ledger};
use super::listen::Listening;
use super::names::Part;
use super::reading::Incoming;
use super::server::{ALIVE, Address, Server, entry};
use super::share::is_own;
use super::worker::WorkNews;
use crate::story::Event;

/// Time between signs of life, and looks at who else is alive.
const TICK: Duration = ALIVE.checked_div(5).expect("five is not zero");
/// Time between looks whether it is to stop.
const LOOK: Duration = Duration::from_millis(200);

/// What a lane is to do. Numbers are those of taking-over.
enum Job {
    Take(String, u64),
    Interval(String, Due, Instant),
    Leave(String),
}

/// What a lane has done.
enum Outcome {
    /// A structure is its own, with the ledger of what has come until now.
    Taken(String, u64, Box<Ledger>),
    Published(Box<IntervalResult>, Duration),
    Alarm(Box<Event>),
    /// A file of results cannot be written, and why.
    Untabulated(String),
    Failed(String, u64, StreamError),
}

/// A structure of this worker.
enum Own {
    /// A lane takes it over; what has come meanwhile.
    Taking(Vec<Arrived>),
    Taken(Box<Ledger>),
}

/// A structure that this worker has, or that could not be followed.
struct Held {
    /// The revision of its entry.
    revision: u64,
    /// The number of its taking-over.
    take: u64,
    /// `None` where it was refused.
    own: Option<Own>,
}

/// Works until it is to stop, or the connection is no longer whole. `on_ready` is called when it has begun, and says how long it could not.
pub(super) async fn session(
    address: &Address,
    tables: Option<&Arc<PathBuf>>,
    me: &str,
    stop: &AtomicBool,
    on_ready: &mut dyn FnMut() -> Option<Duration>,
    tell: &mut dyn FnMut(WorkNews),
) -> Result<(), StreamError> {
    let server = Server::connect(address).await?;
    let workers = server.workers().await?;
    let mut listening = Listening::new(&server);
    let (tell_outcome, mut outcomes) = unbounded_channel();
    let mut tasks = JoinSet::new();
    let lanes = std::thread::available_parallelism().map_or(1, usize::from);
    let lanes: Vec<UnboundedSender<Job>> = (0..lanes)
        .map(|_| {
            let (send, jobs) = unbounded_channel();
            tasks.spawn(lane(server.clone(), tables.cloned(), jobs, tell_outcome.clone()));
            send
        })
        .collect();
    let mut share = Share { me, lanes, held: BTreeMap::new(), takes: 0, looked_at: 0, told: None };
    put(&workers, me).await?;
    // Whatever takes long meanwhile: who does not say that it is alive loses its structures.
    let (of_me, its_workers) = (me.to_owned(), workers.clone());
    let mut signs = JoinSet::new();
    signs.spawn(async move {
        loop {
            tokio::time::sleep(TICK).await;
            if let Err(error) = put(&its_workers, &of_me).await {
                return error;
            }
        }
    });
    let mut tick = tokio::time::interval(TICK);
    let mut look = tokio::time::interval(LOOK);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    let mut is_first = true;
    loop {
        tokio::select! {
            message = listening.next() => share.take(&message?),
            outcome = outcomes.recv() => {
                if let Some(outcome) = outcome {
                    share.note(outcome, tell)?;
                }
            }
            Some(ended) = signs.join_next() => {
                return Err(ended.unwrap_or_else(|error| StreamError::server("saying that this worker is alive")(error.into())));
            }
            _ = tick.tick() => {
                server.is_whole()?;
                share.look([&server.structures, &workers], &mut listening, tell).await?;
                if std::mem::take(&mut is_first) && let Some(after) = on_ready() {
                    tell(WorkNews::Back { after_s: after.as_secs_f64() });
                }
            }
            _ = look.tick() => {
                if stop.load(Ordering::Relaxed) {
                    signs.abort_all();
                    // The others need not wait until it is no longer taken for alive.
                    let _ = workers.purge(me).await;
                    return Ok(());
                }
            }
        }
    }
}

async fn put(workers: &Store, me: &str) -> Result<(), StreamError> {
    let put = workers.put(me, Bytes::from_static(b"alive")).await;
    put.map(drop).map_err(|error| StreamError::server("saying that this worker is alive")(error.into()))
}

/// The keys of a bucket. Not by `keys`, which reads by a consumer on one server: a cluster puts those on a dead one until it has noticed its death.
pub(super) async fn keys(store: &Store) -> Result<Vec<String>, StreamError> {
    let failed = || StreamError::server(format!("the keys of {}", store.name));
    let subjects = store.stream.info_with_subjects(format!("{}>", store.prefix)).await;
    let mut subjects = subjects.map_err(|error| failed()(error.into()))?;
    let mut found = Vec::new();
    while let Some(subject) = subjects.next().await {
        let (subject, _) = subject.map_err(|error| failed()(error.into()))?;
        found.extend(subject.strip_prefix(&store.prefix).map(str::to_owned));
    }
    Ok(found)
}

/// Workers that are alive: one that has ended in good order has a mark in its place for some seconds.
pub(super) async fn alive(workers: &Store) -> Result<Vec<String>, StreamError> {
    let mut alive = Vec::new();
    for key in keys(workers).await? {
        let entry = workers.get(&key).await;
        if entry.map_err(|error| StreamError::server("the workers")(error.into()))?.is_some() {
            alive.push(key);
        }
    }
    Ok(alive)
}

/// What this worker has.
struct Share<'a> {
    me: &'a str,
    lanes: Vec<UnboundedSender<Job>>,
    held: BTreeMap<String, Held>,
    /// How often one was taken.
    takes: u64,
    /// The newest change of the bucket of structures that was looked at.
    looked_at: u64,
    told: Option<(usize, usize, usize)>,
}

impl Share<'_> {
    /// Looks at who is alive and which structures there are, and takes or leaves some.
    async fn look(
        &mut self,
        [structures, workers]: [&Store; 2],
        listening: &mut Listening,
        tell: &mut dyn FnMut(WorkNews),
    ) -> Result<(), StreamError> {
        let info = structures.stream.get_info().await;
        let newest = info.map_err(|error| StreamError::server("the bucket of structures")(error.into()))?;
        let newest = newest.state.last_sequence;
        let alive = alive(workers).await?;
        let all = keys(structures).await?;
        let alive: Vec<&str> = alive.iter().map(String::as_str).collect();
        let own: Vec<&String> = all.iter().filter(|key| is_own(self.me, key, alive.iter().copied())).collect();
        let gone: Vec<String> = self.held.keys().filter(|key| !own.contains(key)).cloned().collect();
        for key in gone {
            self.held.remove(&key);
            self.send(&key, Job::Leave(key.clone()));
        }
        // Before any is taken over: what comes meanwhile is not missed.
        listening.listen_to(&own.iter().map(|key| Part::of(key)).collect()).await?;
        let counts = (own.len(), all.len(), alive.len());
        for key in own {
            // As long as the bucket has not changed, none of its entries has.
            if newest == self.looked_at && self.held.contains_key(key) {
                continue;
            }
            let Some(revision) = entry(structures, key, "entry").await?.map(|entry| entry.revision) else { continue };
            if self.held.get(key).is_none_or(|held| held.revision != revision) {
                self.takes += 1;
                let held = Held { revision, take: self.takes, own: Some(Own::Taking(Vec::new())) };
                self.held.insert(key.clone(), held);
                self.send(key, Job::Take(key.clone(), self.takes));
            }
        }
        self.looked_at = newest;
        if self.told.replace(counts) != Some(counts) {
            let (own, all, workers) = counts;
            tell(WorkNews::Share { own, all, workers });
        }
        Ok(())
    }

    /// Takes a message's headers.
    fn take(&mut self, message: &Incoming) {
        let Some((key, arrived)) = message.arrived() else { return };
        let due = match self.held.get_mut(key).and_then(|held| held.own.as_mut()) {
            None => return,
            Some(Own::Taking(meanwhile)) => return meanwhile.push(arrived),
            Some(Own::Taken(ledger)) => ledger.take(arrived),
        };
        self.hand_over(key, due);
    }

    fn hand_over(&self, key: &str, due: Vec<Due>) {
        due.into_iter().for_each(|due| self.send(key, Job::Interval(key.to_owned(), due, Instant::now())));
    }

    fn send(&self, key: &str, job: Job) {
        let lane = key.bytes().fold(0_usize, |sum, byte| sum.wrapping_mul(31).wrapping_add(usize::from(byte)));
        if let Some(lane) = self.lanes.get(lane % self.lanes.len().max(1)) {
            // A lane ends with the session.
            let _ = lane.send(job);
        }
    }

    /// A structure, as long as it is held by this take: a lane may be behind with one that was left since, and taken anew.
    fn held_by(&mut self, key: &str, take: u64) -> Option<&mut Held> {
        self.held.get_mut(key).filter(|held| held.take == take)
    }

    /// Takes note of what a lane has done.
    fn note(&mut self, outcome: Outcome, tell: &mut dyn FnMut(WorkNews)) -> Result<(), StreamError> {
        match outcome {
            Outcome::Taken(key, take, mut ledger) => {
                let Some(held) = self.held_by(&key, take) else { return Ok(()) };
                let Some(Own::Taking(meanwhile)) = &mut held.own else { return Ok(()) };
                let meanwhile = std::mem::take(meanwhile);
                let due = meanwhile.into_iter().flat_map(|arrived| ledger.take(arrived)).collect();
                held.own = Some(Own::Taken(ledger));
                self.hand_over(&key, due);
            }
            Outcome::Published(result, after) => tell(WorkNews::Result { result, after_s: after.as_secs_f64() }),
            Outcome::Alarm(alarm) => tell(WorkNews::Alarm { alarm }),
            Outcome::Untabulated(reason) => tell(WorkNews::Unwritten { reason }),
            // It is taken anew, where it still is this worker's.
            Outcome::Failed(key, take, StreamError::Overtaken { .. }) => {
                if self.held_by(&key, take).is_some() {
                    self.held.remove(&key);
                }
            }
            Outcome::Failed(_, _, error) if error.may_pass() && !matches!(error, StreamError::Odd { .. }) => {
                return Err(error);
            }
            Outcome::Failed(key, take, error) => {
                let Some(held) = self.held_by(&key, take) else { return Ok(()) };
                held.own = None;
                tell(WorkNews::Refused { structure: key, reason: error.to_string() });
            }
        }
        Ok(())
    }
}

/// Follows structures one after the other.
async fn lane(
    server: Server,
    tables: Option<Arc<PathBuf>>,
    mut jobs: UnboundedReceiver<Job>,
    outcomes: UnboundedSender<Outcome>,
) {
    let mut followed: BTreeMap<String, (u64, Followed)> = BTreeMap::new();
    while let Some(job) = jobs.recv().await {
        let (key, number, done) = match job {
            Job::Leave(key) => {
                followed.remove(&key);
                continue;
            }
            Job::Take(key, number) => {
                followed.remove(&key);
                let taken = take(&server, &key, tables.clone(), number, &outcomes).await;
                (key.clone(), number, taken.map(|one| drop(followed.insert(key, (number, one)))))
            }
            Job::Interval(key, due, since) => {
                // It was left, or has failed, since this was handed over.
                let Some((number, one)) = followed.get_mut(&key) else { continue };
                let done = interval(&server, one, due, since, &outcomes).await;
                (key, *number, done)
            }
        };
        if let Err(error) = done {
            followed.remove(&key);
            let _ = outcomes.send(Outcome::Failed(key, number, error));
        }
    }
}

/// Takes a structure over and makes up for what was left undone.
async fn take(
    server: &Server,
    key: &str,
    tables: Option<Arc<PathBuf>>,
    number: u64,
    outcomes: &UnboundedSender<Outcome>,
) -> Result<Followed, StreamError> {
    let since = Instant::now();
    let mut one = Followed::take(server, key, tables).await?;
    tabulate(&mut one, None, outcomes).await?;
    judge(server, &mut one, outcomes).await?;
    let (ledger, due) = one.catch_up().await?;
    for due in due {
        interval(server, &mut one, due, since, outcomes).await?;
    }
    // Nobody listens any more where the session is over.
    let _ = outcomes.send(Outcome::Taken(key.to_owned(), number, Box::new(ledger)));
    Ok(one)
}

async fn interval(
    server: &Server,
    one: &mut Followed,
    due: Due,
    since: Instant,
    outcomes: &UnboundedSender<Outcome>,
) -> Result<(), StreamError> {
    let result = one.interval(server, due).await?;
    let _ = outcomes.send(Outcome::Published(Box::new(result.clone()), since.elapsed()));
    tabulate(one, Some(&result), outcomes).await?;
    judge(server, one, outcomes).await
}

/// A disk that does not take results holds up nothing: the stream has them, and they are written with the next.
async fn tabulate(
    one: &mut Followed,
    newest: Option<&IntervalResult>,
    outcomes: &UnboundedSender<Outcome>,
) -> Result<(), StreamError> {
    match one.tabulate(newest).await {
        Err(error @ StreamError::File { .. }) => {
            let _ = outcomes.send(Outcome::Untabulated(error.to_string()));
            Ok(())
        }
        done => done,
    }
}

async fn judge(server: &Server, one: &mut Followed, outcomes: &UnboundedSender<Outcome>) -> Result<(), StreamError> {
    for alarm in one.judge(server).await? {
        let _ = outcomes.send(Outcome::Alarm(Box::new(alarm)));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lane that is behind tells of a structure that was left and is being taken anew: that is not what is waited for.
    #[test]
    fn what_an_earlier_take_has_done_is_not_taken_for_the_present_one() {
        let mut share =
            Share { me: "me", lanes: Vec::new(), held: BTreeMap::new(), takes: 2, looked_at: 0, told: None };
        let own = Some(Own::Taking(Vec::new()));
        share.held.insert("tower".to_owned(), Held { revision: 1, take: 2, own });
        let ledger = || Box::new(Ledger::new(1, &[3], None));
        let mut said = Vec::new();
        let mut note = |share: &mut Share<'_>, outcome| share.note(outcome, &mut |news| said.push(news)).unwrap();
        let is_waiting = |share: &Share<'_>| matches!(share.held["tower"].own, Some(Own::Taking(_)));
        note(&mut share, Outcome::Taken("tower".to_owned(), 1, ledger()));
        assert!(is_waiting(&share));
        let odd = || StreamError::Odd { what: "a study".to_owned(), why: "it has no modes".to_owned() };
        note(&mut share, Outcome::Failed("tower".to_owned(), 1, odd()));
        note(
            &mut share,
            Outcome::Failed("tower".to_owned(), 1, StreamError::Overtaken { structure: "tower".to_owned() }),
        );
        assert!(is_waiting(&share));
        note(&mut share, Outcome::Taken("tower".to_owned(), 2, ledger()));
        assert!(matches!(share.held["tower"].own, Some(Own::Taken(_))));
        note(&mut share, Outcome::Failed("tower".to_owned(), 2, odd()));
        assert!(share.held["tower"].own.is_none());
        assert!(matches!(said[..], [WorkNews::Refused { .. }]), "{said:?}");
    }
}
