//! Windows on their way from one archive to another: each a message of its own, with what its node was asked.
//!
//! A message is a byte for its version, and a [`PackedWindow`] in postcard's encoding. Data of channels stand in it as in the table `channel`.

use belfry_shared::message::{Configuration, WindowName};
use belfry_shared::time::HostTime;
use rusqlite::params;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::asked::Asked;
use super::codec::{self, ChannelRow};
use super::heads::Head;
use super::read::hop_us;
use super::write::bits;
use super::{Archive, ArchiveError, Damage};
use crate::window::NodeWindow;

/// The first byte of a message.
const PACKED_VERSION: u8 = 1;

/// A window of a node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PackedWindow {
    /// The setup that its node served.
    pub setup: String,
    /// Its name.
    pub name: WindowName,
    /// What its node was asked to measure.
    pub configuration: Configuration,
    /// Names of its channels in the study.
    pub channels: Vec<String>,
    /// Start in hops since the epoch.
    pub grid_index: u64,
    /// Start in µs of Unix time.
    pub start_us: i64,
    /// When the segment's middle was, minus when it should have been by the grid, in µs.
    pub middle_offset_us: i32,
    /// How much faster the host's clock ran than the node's, in parts per thousand million.
    pub drift_ppb: i32,
    /// Each channel's data.
    rows: Vec<ChannelRow>,
}

/// Why a message is no window.
#[derive(Debug, Error)]
pub enum PackedError {
    /// It is of another version.
    #[error("version {found} of a window is unknown here; {PACKED_VERSION} is known")]
    Version {
        /// Its first byte.
        found: u8,
    },
    /// It is cut off or damaged.
    #[error("a window that cannot be read: {why}")]
    Damaged {
        /// What is wrong.
        why: String,
    },
}

impl PackedWindow {
    /// Middle of its segment in µs of Unix time: a window belongs to the interval that holds its middle.
    pub fn middle_us(&self) -> i64 {
        self.start_us.saturating_add(hop_us(&self.configuration))
    }

    /// The message.
    ///
    /// # Errors
    /// Where its encoding fails.
    pub fn encode(&self) -> Result<Vec<u8>, PackedError> {
        let encoded = postcard::to_extend(self, vec![PACKED_VERSION]);
        encoded.map_err(|error| PackedError::Damaged { why: error.to_string() })
    }

    /// Reads a message.
    ///
    /// # Errors
    /// [`PackedError`].
    pub fn decode(message: &[u8]) -> Result<Self, PackedError> {
        let damaged = |why: String| PackedError::Damaged { why };
        match message.split_first() {
            Some((&PACKED_VERSION, content)) => match postcard::take_from_bytes(content) {
                Ok((window, [])) => Ok(window),
                Ok((_, rest)) => Err(damaged(format!("{} bytes follow it", rest.len()))),
                Err(error) => Err(damaged(error.to_string())),
            },
            Some((&found, _)) => Err(PackedError::Version { found }),
            None => Err(damaged("it is empty".to_owned())),
        }
    }
}

/// A window behind others: the number of its row, and itself or what is wrong with it.
pub type Following = (i64, Result<PackedWindow, Damage>);

impl Archive {
    /// The windows behind the row `after`, in the order in which they were stored, `most` at most.
    ///
    /// # Errors
    /// Where the archive cannot be read.
    pub fn following(&self, after: i64, most: usize) -> Result<Vec<Following>, ArchiveError> {
        let read = || -> rusqlite::Result<Vec<Following>> {
            let query = format!("SELECT {}, checksum FROM window WHERE id > ?1 ORDER BY id LIMIT ?2", Head::COLUMNS);
            let mut statement = self.connection.prepare_cached(&query)?;
            let heads: Vec<Head> =
                statement.query_map(params![after, most], Head::read)?.collect::<rusqlite::Result<_>>()?;
            if heads.is_empty() {
                return Ok(Vec::new());
            }
            let (asked, _) = self.asked()?;
            heads.into_iter().map(|head| Ok((head.id, self.pack(&head, &asked)?))).collect()
        };
        read().map_err(|source| self.failed(source))
    }

    /// The number of a window's row; `None` where it is not kept.
    ///
    /// # Errors
    /// Where the archive cannot be read.
    pub fn row_of(&self, name: &WindowName) -> Result<Option<i64>, ArchiveError> {
        self.of_window(name, "id")
    }

    /// Keeps a window of another archive; one that is kept already stays as it is.
    ///
    /// # Errors
    /// Where its data are none, which is told as a damage, or the archive cannot be written.
    pub fn unpack(&mut self, packed: &PackedWindow, now: HostTime) -> Result<Result<(), String>, ArchiveError> {
        let PackedWindow { setup, name, configuration, grid_index, middle_offset_us, drift_ppb, .. } = packed;
        let channels = match packed.rows.iter().map(codec::data).collect() {
            Ok(channels) => channels,
            Err(what) => return Ok(Err(what)),
        };
        let window = NodeWindow {
            name: *name,
            configuration_hash: configuration.hash(),
            grid_index: *grid_index,
            middle_offset_us: *middle_offset_us,
            drift_ppb: *drift_ppb,
            channels,
        };
        let names: Vec<&str> = packed.channels.iter().map(String::as_str).collect();
        self.ask(setup, name.node, configuration, &names, HostTime(packed.start_us))?;
        self.store(setup, configuration, &window, now).map(Ok)
    }

    fn pack(&self, head: &Head, asked: &[Asked]) -> rusqlite::Result<Result<PackedWindow, Damage>> {
        let name = head.window.name;
        let mut known = asked
            .iter()
            .rev()
            .filter(|one| one.node == name.node && one.configuration.hash() == head.window.configuration_hash);
        let Some(one) = known.clone().find(|one| one.since_us <= head.start_us).or_else(|| known.next_back()) else {
            return Ok(Err(head.damaged("nothing says what its node was asked to measure")));
        };
        let bits = bits(&one.configuration);
        Ok(match self.channels(head)? {
            Ok(data) => Ok(PackedWindow {
                setup: head.setup.clone(),
                name,
                configuration: one.configuration.clone(),
                channels: one.names.clone(),
                grid_index: head.window.grid_index,
                start_us: head.start_us,
                middle_offset_us: head.window.middle_offset_us,
                drift_ppb: head.window.drift_ppb,
                rows: data.iter().map(|data| codec::row(data, bits)).collect(),
            }),
            Err(what) => Err(head.damaged(what)),
        })
    }
}
