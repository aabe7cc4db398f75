//! The link to the sensor nodes: transports and the host's end of the protocol.
//!
//! Bytes flow in from a [`Transport`], whole windows flow out of a [`Session`] into a
//! [`WindowSink`](crate::window::WindowSink), each exactly once. A session does not know whether its bytes come from a serial
//! port or from [`memory`], and its caller tells it the time. [`replay`] feeds a recording to a node over the same parts:
//! frames, greeting, and delivery of windows.

pub mod clock;
mod delivery;
mod error;
mod greeting;
pub mod memory;
pub mod port;
pub mod replay;
pub mod session;
mod transport;
mod wire;

pub use error::SessionError;
pub use greeting::{Greeting, GreetingError, who_is_there};
pub use session::{Session, SessionStatistics};
pub use transport::Transport;
pub use wire::NoCommonVersion;

/// An error with its causes, in one sentence.
pub(crate) fn with_cause(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let told = cause.to_string();
        if !text.contains(&told) {
            text += &format!(": {told}");
        }
        source = cause.source();
    }
    text
}
