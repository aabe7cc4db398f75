//! The greeting: who is on a line, and whether this host speaks a version that the node speaks.

use std::io;
use std::time::{Duration, Instant};

use belfry_shared::message::{Hello, HostMessage, NodeMessage, Versions};
use thiserror::Error;

use super::transport::Transport;
use super::wire::{MOST_READS, NoCommonVersion, Untaken, Wire};

/// Time between greetings that nobody answers.
const RETRY: Duration = Duration::from_millis(500);

/// Why it is not known who is on a line.
#[derive(Debug, Error)]
pub enum GreetingError {
    /// The node that answers speaks other versions of the protocol.
    #[error("the node {0}")]
    Version(#[from] NoCommonVersion),
    /// The line failed.
    #[error("the line failed")]
    Line {
        /// The cause.
        source: io::Error,
    },
    /// Nothing answers.
    #[error("nothing answers on the line: is the node powered, and does no other program use the port?")]
    Silent,
}

/// Asks who is on a line, again and again, until a node answers. The node goes on listening to whom it listens (of version 5: it listens to
/// this host now).
#[derive(Debug)]
pub struct Greeting {
    wire: Wire,
    last_asked: Option<Duration>,
}

impl Default for Greeting {
    fn default() -> Self {
        Self::new()
    }
}

impl Greeting {
    /// A greeting that has not been said yet.
    pub fn new() -> Self {
        Self { wire: Wire::new(), last_asked: None }
    }

    /// Says what is due at `now` (since any moment) and looks at what has come; what the node says of itself, once it answers.
    ///
    /// # Errors
    /// [`GreetingError`], but for silence, which is the caller's to judge.
    pub fn service(&mut self, now: Duration, transport: &mut dyn Transport) -> Result<Option<Hello>, GreetingError> {
        let failed = |source| GreetingError::Line { source };
        if self.last_asked.is_none_or(|asked| now.saturating_sub(asked) >= RETRY) {
            self.last_asked = Some(now);
            self.wire.say(&HostMessage::Ask(Versions::OF_HOSTS));
        }
        self.wire.send(transport).map_err(failed)?;
        let mut buffer = [0; 512];
        for _ in 0..MOST_READS {
            let count = transport.read(&mut buffer).map_err(failed)?;
            if count == 0 {
                break;
            }
            for frame in self.wire.receive(&buffer[..count]) {
                let message = self.wire.message(&frame).map_err(|why| match why {
                    Untaken::Version(problem) => GreetingError::Version(problem),
                    // It is asked without a key: whose it is shows only now.
                    Untaken::Unsealed | Untaken::OtherKey => GreetingError::Silent,
                })?;
                if let Some(NodeMessage::Hello(hello)) = message
                    && self.wire.is_answered_by(&hello)
                {
                    return Ok(Some(hello));
                }
            }
        }
        Ok(None)
    }
}

/// Asks who is on a line, for as long as `patience` lasts.
///
/// # Errors
/// [`GreetingError::Silent`], the node's versions where this host speaks none of them, or what is wrong with the line.
pub fn who_is_there(transport: &mut dyn Transport, patience: Duration) -> Result<Hello, GreetingError> {
    let start = Instant::now();
    let mut greeting = Greeting::new();
    while start.elapsed() < patience {
        if let Some(hello) = greeting.service(start.elapsed(), transport)? {
            return Ok(hello);
        }
    }
    Err(GreetingError::Silent)
}
