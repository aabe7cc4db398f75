//! How late interrupts are, and what of the timer differs in the emulator. The sampler knows of neither.

/// A timer's behaviour.
#[derive(Debug, Clone, Copy)]
pub(super) enum Timekeeping {
    /// The board's: its count starts at 0 with every period, and is how late the interrupt is.
    Board {
        /// Longest delay.
        latest_ticks: u32,
    },
    /// The emulator's, whose counts run on and whose alarms may be late: a period that begins late ends late. A delay that neighbours share is the
    /// alarm's; an interrupt that the program held up is later than the one after it.
    Emulated {
        /// Longest delay.
        latest_ticks: u32,
        /// The count when the next interrupt is due.
        due: u32,
        /// How late the last one was.
        last_ticks: i32,
    },
}

impl Timekeeping {
    /// Before the first period.
    pub(super) fn new(is_emulated: bool) -> Self {
        if is_emulated {
            Self::Emulated { latest_ticks: 0, due: 0, last_ticks: 0 }
        } else {
            Self::Board { latest_ticks: 0 }
        }
    }

    /// Whether the count starts at 0 with every period, which then has to be begun with an update. In the emulator, writing the period has set the
    /// alarm; an update would add its clock to every period.
    pub(super) fn counts_from_zero(&self) -> bool {
        matches!(self, Self::Board { .. })
    }

    /// Begins with a period of `reload` ticks, at a count.
    pub(super) fn begin(&mut self, start: u32, reload: u32) {
        if let Self::Emulated { due, last_ticks, .. } = self {
            (*due, *last_ticks) = (start.wrapping_add(reload), 0);
        }
    }

    /// Notes an interrupt that sees a count; the next period has `reload` ticks.
    pub(super) fn note(&mut self, count: u32, reload: u32) {
        match self {
            Self::Board { latest_ticks } => *latest_ticks = count.max(*latest_ticks),
            Self::Emulated { latest_ticks, due, last_ticks } => {
                let late = count.wrapping_sub(*due) as i32;
                let alike = late.min(*last_ticks);
                *latest_ticks = last_ticks.abs_diff(alike).max(*latest_ticks);
                *last_ticks = late.wrapping_sub(alike);
                *due = due.wrapping_add_signed(alike).wrapping_add(reload);
            }
        }
    }

    /// Longest delay so far.
    pub(super) fn latest_ticks(&self) -> u32 {
        match self {
            Self::Board { latest_ticks } | Self::Emulated { latest_ticks, .. } => *latest_ticks,
        }
    }
}
