//! Windows: what a node measures over one interval, and how windows of all nodes become those of a whole setup.
//!
//! A node's parts flow into an [`Assembler`], whole [`NodeWindow`]s flow out into a [`WindowSink`], each exactly once. On the
//! grid of host time the windows of all nodes stand side by side, as the averages need them. Nothing here knows of lines,
//! ports or disks.

pub mod assembly;
mod configuration;
mod gather;
mod loss;
mod node_window;
mod parts;
mod placement;
mod sink;

pub use assembly::{Assembler, Outcome};
pub use configuration::{Configurations, channels_by_node, node_configuration, node_lines};
pub(crate) use gather::GridAssembler;
pub(crate) use loss::without;
pub use loss::{Loss, LossReason};
pub use node_window::{ChannelData, NodeWindow};
pub(crate) use placement::place_lines;
pub use sink::{KeptWindows, WindowSink};
