//! Watching: whether a structure has changed for good, and when, while weather and traffic move its frequencies every day.
//!
//! Modes of intervals flow in ([`SeenInterval`]); days flow out of them ([`Block`]), and of those a [`Judgement`]: which lasting changes there
//! are, with dates, sizes and how sure. What surroundings do is no parametric law but a Gaussian process of the temperatures and of the level
//! of vibration (Rasmussen and Williams 2006, "Gaussian Processes for Machine Learning", chapter 2), so that weather that no day
//! before has shown is not taken for a change. Days of frost are left out: below zero, concrete, ballast and ground stiffen by percents
//! (Peeters and De Roeck 2001, "One-year monitoring of the Z24-Bridge").

mod block;
mod channels;
mod evidence;
mod judge;
mod nodes;
mod surroundings;

pub use block::{Block, DAY_S, LogFrequency, SeenInterval, SeenMode, blocks, often_seen};
pub use evidence::Remembered;
pub use judge::{Alarm, JudgedBefore, Judgement, ModeShift, Settings, Standing, State, judge};
pub use nodes::{
    LOOKED_BACK_S, NEWEST_WINDOWS, NodeLimits, NodeNews, NodeState, OpenProblem, Problem, Turn, WindowHead,
    state as node_state, turns as node_turns,
};
