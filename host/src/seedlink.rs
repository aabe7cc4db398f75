//! Recordings of existing accelerometer networks, live: a SeedLink server (version 3) sends miniSEED records of 512 bytes, and each goes to the file of its
//! channel and day, where a setup's `files` find it as they find any recording.
//!
//! How far each station came stands in `seedlink.json`. A connection that breaks is made again at the last record. What the file says may lie behind what
//! is on the disk, never before it: records that come again are known by their bytes.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::{self, File};
use std::io::{self, ErrorKind, Read, Seek, SeekFrom, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::archive::day;
use crate::files::{FolderLock, open_lock, write_whole};
use crate::patience::Patience;
use crate::record::mseed_head;
use crate::study::Study;

/// The port of a server whose address names none.
const PORT: u16 = 18_000;
/// Where the study keeps how far each station came.
pub const POSITION_FILE: &str = "seedlink.json";
/// Bytes before a record, and of it.
const HEADER: usize = 8;
const RECORD: usize = 512;
/// Records after which, or time after which, they are forced to the disk and the position is kept.
const KEPT_AFTER: usize = 64;
const KEPT_EVERY: Duration = Duration::from_secs(1);
/// So many of the newest records of a file may come again.
const MAY_COME_AGAIN: u64 = 4 * KEPT_AFTER as u64;
/// How long the server may take to answer, and be silent.
const ANSWER: Duration = Duration::from_secs(10);
const SILENCE: Duration = Duration::from_secs(600);
/// A server that has refused something is asked for it again after this time.
const ASK_AGAIN: Duration = Duration::from_secs(3600);
/// Locked by the one client of a study.
const LOCK_FILE: &str = "seedlink.lock";
/// How often it is looked whether it is to stop.
const LOOK: Duration = Duration::from_millis(200);

/// Why nothing comes.
#[derive(Debug, Error)]
pub enum SeedLinkError {
    /// The study names no channels of a network.
    #[error("no channel of {} is named as SeedLink names them, NET.STA.LOC.CHA (`CH.DAVOX..HGZ` without a location)", study.display())]
    NoChannels {
        /// The study's file.
        study: PathBuf,
    },
    /// A setup would not find what comes.
    #[error("setup \"{setup}\": `files` does not match {}, which the records of a day would be written to; name it as [\"seis/*.mseed\"]", file.display())]
    Pattern {
        /// The setup.
        setup: String,
        /// Such a file.
        file: PathBuf,
    },
    /// The server does not answer, or the connection has broken.
    #[error("SeedLink server {server}: {source}")]
    Connection {
        /// Its address.
        server: String,
        /// What the system said.
        source: io::Error,
    },
    /// It answers something else than it should.
    #[error("SeedLink server {server}: {why}")]
    Server {
        /// Its address.
        server: String,
        /// What is wrong.
        why: String,
    },
    /// Another client writes into the same files.
    #[error("{}: another `belfry collect` takes records into this study", study.display())]
    Taken {
        /// The study's folder.
        study: PathBuf,
    },
    /// A file cannot be read or written.
    #[error("{}: {source}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

impl SeedLinkError {
    /// Whether it may pass by itself.
    pub fn may_pass(&self) -> bool {
        matches!(self, Self::Connection { .. } | Self::Server { .. } | Self::File { .. })
    }
}

/// What happens while records come.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SeedLinkNews {
    /// Nothing comes, and why. It is tried again.
    Waiting {
        /// Why.
        reason: String,
    },
    /// Records come again, or for the first time.
    Connected,
    /// The server does not give these stations or channels. It is asked again when the connection is made anew, within an hour.
    Refused {
        /// Their names.
        names: Vec<String>,
    },
    /// So many records have come since the start.
    Records {
        /// Their number.
        count: u64,
    },
    /// A packet has no record that can be read, and is left out.
    LeftOut {
        /// Its number.
        sequence: u32,
    },
}

/// A channel that is wanted.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Channel {
    /// Network, station, location and channel.
    parts: [String; 4],
    /// Where its files go.
    folder: PathBuf,
}

impl Channel {
    fn name(&self) -> String {
        self.parts.join(".")
    }

    fn station(&self) -> String {
        self.parts[..2].join(".")
    }
}

/// How far each station came: its last sequence number, which is of 24 bits.
#[derive(Debug, Default, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Position(BTreeMap<String, u32>);

/// A file that records are appended to, and its newest ones, oldest first.
struct Day {
    file: File,
    newest: VecDeque<Vec<u8>>,
}

/// A client.
pub struct SeedLink {
    server: String,
    position_file: PathBuf,
    channels: Vec<Channel>,
    position: Position,
    days: BTreeMap<PathBuf, Day>,
    /// Records since the position was kept, and when it was.
    waiting: usize,
    kept: Instant,
    count: u64,
    /// Stations and channels that the server has refused.
    refused: BTreeSet<String>,
    _lock: FolderLock,
}

impl SeedLink {
    /// A client of the server at `HOST` or `HOST:PORT` for the channels of a study.
    ///
    /// # Errors
    /// When the study has no such channels, or would not find their files.
    pub fn new(study: &Study, server: &str) -> Result<Self, SeedLinkError> {
        let mut channels = Vec::new();
        for setup in study.setups.iter().filter(|setup| !setup.live) {
            let folder = setup
                .files
                .first()
                .map_or(Path::new(""), |pattern| Path::new(pattern).parent().unwrap_or(Path::new("")));
            for sensor in &setup.sensors {
                let parts: Vec<String> = sensor.channel.split('.').map(str::to_owned).collect();
                let Ok(parts) = <[String; 4]>::try_from(parts) else { continue };
                let is_name =
                    |part: &String| part.len() <= 5 && part.bytes().all(|letter| letter.is_ascii_alphanumeric());
                if !parts.iter().all(is_name) || [0, 1, 3].iter().any(|&part: &usize| parts[part].is_empty()) {
                    continue;
                }
                let channel = Channel { parts, folder: study.folder.join(folder) };
                let file = folder.join(format!("{}.2027-01-15.mseed", channel.name()));
                let is_found = |pattern: &String| glob::Pattern::new(pattern).is_ok_and(|one| one.matches_path(&file));
                if !setup.files.iter().any(is_found) {
                    return Err(SeedLinkError::Pattern { setup: setup.name.clone(), file });
                }
                if !channels.contains(&channel) {
                    channels.push(channel);
                }
            }
        }
        if channels.is_empty() {
            return Err(SeedLinkError::NoChannels { study: study.folder.join(crate::study::STUDY_FILE) });
        }
        let lock = study.folder.join(LOCK_FILE);
        let file = open_lock(&lock).map_err(|source| SeedLinkError::File { file: lock, source })?;
        let lock = FolderLock::on_at_once(file).ok_or_else(|| SeedLinkError::Taken { study: study.folder.clone() })?;
        let position_file = study.folder.join(POSITION_FILE);
        let position = match fs::read(&position_file) {
            Ok(text) => serde_json::from_slice(&text)
                .map_err(|error| SeedLinkError::File { file: position_file.clone(), source: error.into() })?,
            Err(error) if error.kind() == ErrorKind::NotFound => Position::default(),
            Err(source) => return Err(SeedLinkError::File { file: position_file, source }),
        };
        let named_port = server.rsplit_once(':').is_some_and(|(_, port)| port.parse::<u16>().is_ok());
        let server = if named_port { server.to_owned() } else { format!("{server}:{PORT}") };
        Ok(Self {
            server,
            position_file,
            channels,
            position,
            days: BTreeMap::new(),
            waiting: 0,
            kept: Instant::now(),
            count: 0,
            refused: BTreeSet::new(),
            _lock: lock,
        })
    }

    /// Names of the channels that are asked for.
    pub fn channels(&self) -> Vec<String> {
        self.channels.iter().map(Channel::name).collect()
    }

    /// Takes records until it is to stop; how many.
    ///
    /// # Errors
    /// What does not pass by itself.
    pub fn collect(
        &mut self,
        stop: impl Fn() -> bool,
        mut tell: impl FnMut(SeedLinkNews),
    ) -> Result<u64, SeedLinkError> {
        let (start, mut patience) = (Instant::now(), Patience::with_server());
        while !stop() {
            let session = self.session(&stop, &mut || _ = patience.worked(start.elapsed()), &mut tell);
            match session.and_then(|()| self.keep()) {
                Err(error) if error.may_pass() => {
                    // What has come before it broke is kept.
                    let _ = self.keep();
                    if patience.failed(start.elapsed()) {
                        tell(SeedLinkNews::Waiting { reason: error.to_string() });
                    }
                }
                ended => ended?,
            }
            while patience.is_waiting(start.elapsed()) && !stop() {
                std::thread::sleep(LOOK);
            }
        }
        Ok(self.count)
    }

    fn session(
        &mut self,
        stop: &impl Fn() -> bool,
        on_ready: &mut dyn FnMut(),
        tell: &mut dyn FnMut(SeedLinkNews),
    ) -> Result<(), SeedLinkError> {
        let server = self.server.clone();
        let broken = |source: io::Error| SeedLinkError::Connection { server: server.clone(), source };
        let mut stream = connect(&self.server).map_err(broken)?;
        let mut line = Line { stream: &mut stream, server: &self.server };
        line.say("HELLO")?;
        line.answer()?;
        line.answer()?;
        let refused = self.ask(&mut line)?;
        line.say("END")?;
        on_ready();
        tell(SeedLinkNews::Connected);
        let asked = Instant::now();
        if !refused.is_empty() && refused != self.refused {
            tell(SeedLinkNews::Refused { names: refused.iter().cloned().collect() });
        }
        self.refused = refused;
        let mut packet = [0; HEADER + RECORD];
        let (mut filled, mut heard) = (0, Instant::now());
        while !stop() && (self.refused.is_empty() || asked.elapsed() < ASK_AGAIN) {
            match stream.read(&mut packet[filled..]) {
                Ok(0) => return Err(broken(ErrorKind::UnexpectedEof.into())),
                Ok(count) => (filled, heard) = (filled + count, Instant::now()),
                Err(error)
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                }
                Err(error) => return Err(broken(error)),
            }
            if heard.elapsed() > SILENCE {
                return Err(broken(ErrorKind::TimedOut.into()));
            }
            if filled == packet.len() {
                filled = 0;
                self.take(&packet, tell)?;
            }
            if self.waiting > 0 && (self.waiting >= KEPT_AFTER || self.kept.elapsed() > KEPT_EVERY) {
                self.keep()?;
                tell(SeedLinkNews::Records { count: self.count });
            }
        }
        Ok(())
    }

    /// Asks for all channels, from where each station came to; the stations and channels that the server refuses.
    fn ask(&self, line: &mut Line<'_>) -> Result<BTreeSet<String>, SeedLinkError> {
        let stations: BTreeSet<[String; 2]> =
            self.channels.iter().map(|one| [one.parts[0].clone(), one.parts[1].clone()]).collect();
        let (mut refused, mut given) = (BTreeSet::new(), 0);
        for [network, station] in &stations {
            let name = format!("{network}.{station}");
            if !line.is_granted(&format!("STATION {station} {network}"))? {
                refused.insert(name);
                continue;
            }
            let mut selected = 0;
            for channel in self.channels.iter().filter(|channel| channel.station() == name) {
                let [_, _, location, code] = &channel.parts;
                if line.is_granted(&format!("SELECT {location}{code}"))? {
                    selected += 1;
                } else {
                    refused.insert(channel.name());
                }
            }
            // Without one, everything of the station would come.
            if selected == 0 {
                continue;
            }
            // From the last one on, which is known by its bytes: some servers begin at the number that is named, some behind it.
            let data = match self.position.0.get(&name) {
                Some(last) => format!("DATA {:06X}", last & 0xFF_FFFF),
                None => "DATA".to_owned(),
            };
            if line.is_granted(&data)? {
                given += 1;
            } else {
                refused.insert(name);
            }
        }
        if given == 0 {
            let names: Vec<String> = refused.into_iter().collect();
            let why = format!("it refuses {}", names.join(", "));
            return Err(SeedLinkError::Server { server: self.server.clone(), why });
        }
        Ok(refused)
    }

    /// Puts a record into its file.
    fn take(&mut self, packet: &[u8], tell: &mut dyn FnMut(SeedLinkNews)) -> Result<(), SeedLinkError> {
        let wrong = |why: &str| SeedLinkError::Server { server: self.server.clone(), why: why.to_owned() };
        let (header, record) = packet.split_at(HEADER);
        if header.starts_with(b"SLINFO") {
            return Ok(());
        }
        let digits = header.strip_prefix(b"SL").and_then(|digits| std::str::from_utf8(digits).ok());
        let sequence = digits.and_then(|digits| u32::from_str_radix(digits, 16).ok());
        let sequence = sequence.ok_or_else(|| wrong("what it sends is no packet of SeedLink 3"))?;
        let Some((name, start_ns)) = mseed_head(record) else {
            tell(SeedLinkNews::LeftOut { sequence });
            return Ok(());
        };
        let Some(channel) = self.channels.iter().find(|channel| channel.name() == name) else { return Ok(()) };
        let station = channel.station();
        let path = channel.folder.join(format!("{name}.{}.mseed", day(start_ns / 1000)));
        let failed = |source| SeedLinkError::File { file: path.clone(), source };
        let file = match self.days.get_mut(&path) {
            Some(day) => day,
            None => {
                // One channel writes to one file at a time; those of yesterday are closed.
                let before = format!("{name}.");
                let is_other = |file: &PathBuf| {
                    !file.file_name().is_some_and(|other| other.to_string_lossy().starts_with(&before))
                };
                for (file, day) in &self.days {
                    if !is_other(file) {
                        day.file.sync_data().map_err(|source| SeedLinkError::File { file: file.clone(), source })?;
                    }
                }
                self.days.retain(|file, _| is_other(file));
                self.days.entry(path.clone()).or_insert(Day::open(&path).map_err(failed)?)
            }
        };
        if !file.newest.iter().any(|one| one == record) {
            if let Err(error) = file.file.write_all(record) {
                // Half of it may stand there: who opens the file again takes it off.
                self.days.remove(&path);
                return Err(failed(error));
            }
            if file.newest.len() >= MAY_COME_AGAIN as usize {
                file.newest.pop_front();
            }
            file.newest.push_back(record.to_vec());
            self.count += 1;
        }
        self.position.0.insert(station, sequence);
        self.waiting += 1;
        Ok(())
    }

    /// Forces what has come to the disk, and notes how far it came.
    fn keep(&mut self) -> Result<(), SeedLinkError> {
        if self.waiting == 0 {
            return Ok(());
        }
        for (path, day) in &self.days {
            day.file.sync_data().map_err(|source| SeedLinkError::File { file: path.clone(), source })?;
        }
        let failed = |source| SeedLinkError::File { file: self.position_file.clone(), source };
        let text = serde_json::to_vec(&self.position).map_err(|error| failed(error.into()))?;
        write_whole(&self.position_file, &text).map_err(failed)?;
        (self.waiting, self.kept) = (0, Instant::now());
        Ok(())
    }
}

impl Day {
    /// Opens a file, or makes it. Half a record, as a crash may leave it, is taken off; it comes again.
    fn open(path: &Path) -> io::Result<Self> {
        fs::create_dir_all(crate::files::folder_of(path))?;
        let mut file = File::options().create(true).read(true).append(true).open(path)?;
        let records = file.metadata()?.len() / RECORD as u64;
        file.set_len(records * RECORD as u64)?;
        let first = records.saturating_sub(MAY_COME_AGAIN);
        file.seek(SeekFrom::Start(first * RECORD as u64))?;
        let mut newest = Vec::new();
        file.read_to_end(&mut newest)?;
        Ok(Self { file, newest: newest.chunks_exact(RECORD).map(<[u8]>::to_vec).collect() })
    }
}

fn connect(server: &str) -> io::Result<TcpStream> {
    let mut failure = io::Error::new(ErrorKind::NotFound, "its name has no address");
    for address in server.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, ANSWER) {
            Ok(stream) => {
                stream.set_read_timeout(Some(LOOK))?;
                stream.set_write_timeout(Some(ANSWER))?;
                return Ok(stream);
            }
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// The beginning of a connection, where lines are said and answered.
struct Line<'a> {
    stream: &'a mut TcpStream,
    server: &'a str,
}

impl Line<'_> {
    fn broken(&self) -> impl FnOnce(io::Error) -> SeedLinkError + use<> {
        let server = self.server.to_owned();
        move |source| SeedLinkError::Connection { server, source }
    }

    fn say(&mut self, words: &str) -> Result<(), SeedLinkError> {
        let failed = self.broken();
        self.stream.write_all(format!("{words}\r\n").as_bytes()).map_err(failed)
    }

    fn answer(&mut self) -> Result<String, SeedLinkError> {
        const LONGEST: usize = 512;
        let (start, mut line) = (Instant::now(), Vec::new());
        loop {
            let mut byte = [0];
            match self.stream.read(&mut byte) {
                Ok(0) => return Err(self.broken()(ErrorKind::UnexpectedEof.into())),
                Ok(_) if byte == *b"\n" => return Ok(String::from_utf8_lossy(&line).trim().to_owned()),
                Ok(_) => line.push(byte[0]),
                Err(error)
                    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                }
                Err(error) => return Err(self.broken()(error)),
            }
            if start.elapsed() > ANSWER || line.len() > LONGEST {
                return Err(self.broken()(ErrorKind::TimedOut.into()));
            }
        }
    }

    /// Whether the server says OK to that.
    fn is_granted(&mut self, words: &str) -> Result<bool, SeedLinkError> {
        self.say(words)?;
        match self.answer()?.as_str() {
            "OK" => Ok(true),
            // Servers that speak version 4 as well say why.
            said if said.split(' ').next() == Some("ERROR") => Ok(false),
            said => Err(SeedLinkError::Server {
                server: self.server.to_owned(),
                why: format!("it answers `{}` to `{words}`", said.escape_debug()),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::net::TcpListener;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Arc, Mutex};

    use super::*;

    /// A record of 100 whole numbers at 50 samples a second, the first two seconds times `index` after the begin of a day; big-endian.
    fn record(station: &str, index: u16) -> Vec<u8> {
        let mut record = format!("{index:06}D {station:<5}00HNZCH").into_bytes();
        record.extend(2027_u16.to_be_bytes());
        record.extend(15_u16.to_be_bytes());
        let second = 2 * index;
        record.extend([(second / 3600) as u8, (second / 60 % 60) as u8, (second % 60) as u8, 0, 0, 0]);
        record.extend(100_u16.to_be_bytes());
        record.extend(50_i16.to_be_bytes());
        record.extend(1_i16.to_be_bytes());
        // Flags, one blockette, no correction, data from byte 64, blockettes from byte 48.
        record.extend([0, 0, 0, 1, 0, 0, 0, 0, 0, 64, 0, 48]);
        // Blockette 1000: whole numbers of 32 bits, big-endian, 512 bytes.
        record.extend([0x03, 0xe8, 0, 0, 3, 1, 9, 0]);
        record.resize(64, 0);
        (0..100).for_each(|row: i32| record.extend((i32::from(index) * 100 + row).to_be_bytes()));
        record.resize(RECORD, 0);
        record
    }

    /// What clients have said, a list of lines each.
    type Said = Arc<Mutex<Vec<Vec<String>>>>;

    /// A server with 30 records of two stations, which breaks off behind the packets that are counted, and then goes on where it is asked to.
    fn server(breaks_after: usize) -> (u16, Said) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let said = Said::default();
        let told = Arc::clone(&said);
        std::thread::spawn(move || {
            for (connection, mut stream) in listener.incoming().flatten().enumerate() {
                let mut lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
                let (mut heard, mut froms, mut station) = (Vec::new(), Vec::new(), String::new());
                for line in lines.by_ref() {
                    heard.push(line.clone());
                    let words: Vec<&str> = line.split(' ').collect();
                    let answer = match words[..] {
                        ["HELLO"] => "SeedLink v3.1\r\nof the tests\r\n",
                        ["STATION", name, _] if name.starts_with("DAMXA") => "ERROR UNSUPPORTED no such station\r\n",
                        ["STATION", name, _] if name.starts_with("DAMX") => "ERROR\r\n",
                        ["STATION", name, _] => {
                            name.clone_into(&mut station);
                            "OK\r\n"
                        }
                        ["DATA"] => {
                            froms.push((station.clone(), 0));
                            "OK\r\n"
                        }
                        ["DATA", from] => {
                            froms.push((station.clone(), usize::from_str_radix(from, 16).unwrap()));
                            "OK\r\n"
                        }
                        ["END"] => break,
                        _ => "OK\r\n",
                    };
                    stream.write_all(answer.as_bytes()).unwrap();
                }
                told.lock().unwrap().push(heard);
                let mut packets: Vec<(usize, &str)> = Vec::new();
                for (station, from) in &froms {
                    packets.extend((*from..30).map(|index| (index, station.as_str())));
                }
                packets.sort_unstable();
                let most = if connection == 0 { breaks_after } else { usize::MAX };
                for (index, station) in packets.into_iter().take(most) {
                    let mut packet = format!("SL{index:06X}").into_bytes();
                    packet.extend(record(station, index as u16));
                    if stream.write_all(&packet).is_err() {
                        break;
                    }
                }
                if connection > 0 {
                    // The connection stays, as a server's does that waits for news.
                    std::mem::forget(stream);
                }
            }
        });
        (port, said)
    }

    fn study(folder: &Path, files: &str) -> Study {
        let sensor = |station: &str| format!("[[setup.sensor]]\nchannel = \"CH.{station}.00.HNZ\"\nnode = 1\n");
        let text = format!(
            "[structure]\nname = \"Dam\"\n[[setup]]\nname = \"now\"\nfiles = [\"{files}\"]\nsampling_rate_hz = 50.0\nunit = \"m/s2\"\n{}{}",
            sensor("DAMA"),
            sensor("DAMB")
        );
        fs::write(folder.join("study.toml"), text).unwrap();
        Study::load(folder).unwrap()
    }

    /// Takes so many records, or what comes within a while; their number, and what was said.
    fn taken(study: &Study, port: u16, wanted: u64) -> (u64, Vec<SeedLinkNews>) {
        let mut client = SeedLink::new(study, &format!("127.0.0.1:{port}")).unwrap();
        let (is_over, mut news) = (AtomicBool::new(false), Vec::new());
        let start = Instant::now();
        let count = client.collect(
            || is_over.load(Ordering::Relaxed) || start.elapsed() > Duration::from_secs(20),
            |one| {
                if matches!(one, SeedLinkNews::Records { count } if count >= wanted) {
                    is_over.store(true, Ordering::Relaxed);
                }
                news.push(one);
            },
        );
        (count.unwrap(), news)
    }

    #[test]
    fn records_come_once_each_across_breaks_and_a_setup_reads_them() {
        let folder = tempfile::tempdir().unwrap();
        let study = study(folder.path(), "seis/*.mseed");
        let (port, said) = server(25);
        let (count, news) = taken(&study, port, 60);
        assert_eq!(count, 60);
        assert!(news.iter().any(|one| matches!(one, SeedLinkNews::Waiting { .. })), "{news:?}");
        let heard = said.lock().unwrap().clone();
        assert_eq!(heard[0][..4], ["HELLO", "STATION DAMA CH", "SELECT 00HNZ", "DATA"]);
        // Thirteen of the one had come, twelve of the other.
        assert_eq!([&heard[1][3], &heard[1][6]], ["DATA 00000C", "DATA 00000B"]);
        let file =
            |station: &str| fs::read(folder.path().join(format!("seis/CH.{station}.00.HNZ.2027-01-15.mseed"))).unwrap();
        let whole = |station: &str| (0..30).flat_map(|index| record(station, index)).collect::<Vec<u8>>();
        assert_eq!((file("DAMA"), file("DAMB")), (whole("DAMA"), whole("DAMB")));
        // Killed before the position was kept, in the middle of a record: nothing comes twice, and nothing is missing.
        fs::write(folder.path().join(POSITION_FILE), "{\"CH.DAMA\":19,\"CH.DAMB\":29}").unwrap();
        let cut = File::options().write(true).open(folder.path().join("seis/CH.DAMA.00.HNZ.2027-01-15.mseed")).unwrap();
        cut.set_len(25 * RECORD as u64 + 100).unwrap();
        let (count, _) = taken(&study, port, 5);
        assert_eq!((count, file("DAMA")), (5, whole("DAMA")));
        // What is no record, or one of another length, is told and left out.
        let mut client = SeedLink::new(&study, &format!("127.0.0.1:{port}")).unwrap();
        let mut longer = record("DAMA", 31);
        let exponent =
            longer.windows(2).position(|pair| pair == [1000_u16.to_be_bytes()[0], 1000_u16.to_be_bytes()[1]]);
        longer[exponent.unwrap() + 6] = 12;
        for bad in [vec![0; RECORD], longer] {
            let mut news = Vec::new();
            client.take(&[b"SL00001F".to_vec(), bad].concat(), &mut |one| news.push(one)).unwrap();
            assert!(matches!(news[..], [SeedLinkNews::LeftOut { sequence: 31 }]), "{news:?}");
        }
        assert_eq!(file("DAMA"), whole("DAMA"));
        let reader = crate::record::matching_files(&study.setups[0], &study.folder).unwrap();
        assert_eq!(reader.len(), 2);
        // Two of them would write into each other's files.
        let second = SeedLink::new(&study, "127.0.0.1").err().unwrap();
        assert!(second.to_string().contains("another `belfry collect` takes records into this study"), "{second}");
    }

    #[test]
    fn a_station_that_the_server_does_not_give_is_told_and_stops_no_other() {
        let folder = tempfile::tempdir().unwrap();
        study(folder.path(), "seis/*.mseed");
        let file = folder.path().join("study.toml");
        let with = |from: &str, to: &str| {
            let text = fs::read_to_string(&file).unwrap().replace(from, to);
            fs::write(&file, text).unwrap();
            Study::load(folder.path()).unwrap()
        };
        let (port, _) = server(10);
        let (count, news) = taken(&with("CH.DAMB", "CH.DAMX"), port, 30);
        assert_eq!(count, 30);
        let refused: Vec<_> = news.iter().filter(|one| matches!(one, SeedLinkNews::Refused { .. })).collect();
        assert_eq!(
            refused,
            [&SeedLinkNews::Refused { names: vec!["CH.DAMX".to_owned()] }],
            "told once for two connections"
        );
        let mut client = SeedLink::new(&with("CH.DAMA", "CH.DAMXA"), &format!("127.0.0.1:{port}")).unwrap();
        let (stop, mut told) = (AtomicBool::new(false), None);
        let tell = |news| {
            stop.store(true, Ordering::Relaxed);
            told.get_or_insert(news);
        };
        client.collect(|| stop.load(Ordering::Relaxed), tell).unwrap();
        let Some(SeedLinkNews::Waiting { reason }) = told else { panic!("{told:?}") };
        assert!(reason.ends_with("it refuses CH.DAMX, CH.DAMXA"), "{reason}");
    }

    #[test]
    fn a_study_that_names_no_such_channel_or_would_not_find_the_files_is_told() {
        let folder = tempfile::tempdir().unwrap();
        let other = study(folder.path(), "seis/*.csv");
        let error = SeedLink::new(&other, "127.0.0.1").err().unwrap();
        assert!(error.to_string().contains("does not match seis/CH.DAMA.00.HNZ.2027-01-15.mseed"), "{error}");
        let text = fs::read_to_string(folder.path().join("study.toml")).unwrap();
        fs::write(folder.path().join("study.toml"), text.replace("CH.DAM", "DAM")).unwrap();
        let error = SeedLink::new(&Study::load(folder.path()).unwrap(), "127.0.0.1").err().unwrap();
        assert!(error.to_string().contains("NET.STA.LOC.CHA"), "{error}");
    }
}
