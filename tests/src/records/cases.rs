//! Cases: what structure, what load, how long a record, what is wrong with it.

use rand::Rng;

use super::fault::Fault;
use super::load::Load;
use super::machine::{Machine, Runs};
use super::structure::Structure;

/// A kind of recording.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it is.
    pub what: &'static str,
    pub(super) build: Build,
    pub(super) load: Load,
    pub(super) rate_hz: f64,
    pub(super) seconds: f64,
    pub(super) fault: Option<Fault>,
    /// Where sensors are moved between setups, of this length each.
    pub(super) roving: Option<Roving>,
}

/// Sensors that are moved.
#[derive(Debug, Clone, Copy)]
pub(super) struct Roving {
    /// The channels that stay.
    pub(super) references: [usize; 2],
    /// How many setups share the others.
    pub(super) setups: usize,
}

/// How a structure is drawn.
#[derive(Debug, Clone, Copy)]
pub(super) enum Build {
    /// [`Structure::tower`].
    Tower { channels: usize, first_hz: f64, modes: usize, damping: [f64; 2], apart: f64 },
    /// [`Structure::random`].
    Random { channels: usize, first_hz: f64, modes: usize, damping: [f64; 2], apart: f64, alike: f64 },
}

impl Build {
    pub(super) fn structure(self, random: &mut impl Rng) -> Structure {
        match self {
            Self::Tower { channels, first_hz, modes, damping, apart } => {
                Structure::tower(channels, first_hz, modes, damping, apart, random)
            }
            Self::Random { channels, first_hz, modes, damping, apart, alike } => {
                Structure::random(channels, first_hz, modes, damping, apart, alike, random)
            }
        }
    }
}

const HOUR_S: f64 = 3600.0;

const TOWER: Build = Build::Tower { channels: 20, first_hz: 0.3, modes: 10, damping: [0.006, 0.014], apart: 4.0 };
const WIND: Load = Load::Wind { speed_m_s: 15.0 };
const WHITE: Load = Load::Modal { correlation: 0.0, colour: 0.0 };

const fn wind(name: &'static str, what: &'static str, fault: Option<Fault>) -> Case {
    Case { name, what, build: TOWER, load: WIND, rate_hz: 20.0, seconds: 6.0 * HOUR_S, fault, roving: None }
}

const fn correlated(name: &'static str, what: &'static str, correlation: f64) -> Case {
    let build =
        Build::Random { channels: 12, first_hz: 0.5, modes: 8, damping: [0.005, 0.02], apart: 12.0, alike: 0.3 };
    let load = Load::Modal { correlation, colour: -5.0 / 3.0 };
    Case { name, what, build, load, rate_hz: 20.0, seconds: 4.0 * HOUR_S, fault: None, roving: None }
}

const fn pairs(name: &'static str, what: &'static str, apart: f64) -> Case {
    let build = Build::Tower { channels: 12, first_hz: 0.4, modes: 6, damping: [0.008, 0.012], apart };
    Case { name, what, build, load: WIND, rate_hz: 20.0, seconds: 4.0 * HOUR_S, fault: None, roving: None }
}

const fn alike(name: &'static str, what: &'static str, apart: f64, alike: f64) -> Case {
    let build = Build::Random { channels: 12, first_hz: 0.5, modes: 6, damping: [0.01, 0.01], apart, alike };
    Case { name, what, build, load: WHITE, rate_hz: 20.0, seconds: 4.0 * HOUR_S, fault: None, roving: None }
}

const fn of_channels(name: &'static str, what: &'static str, channels: usize) -> Case {
    let build = Build::Tower { channels, first_hz: 0.4, modes: 6, damping: [0.006, 0.014], apart: 5.0 };
    Case { name, what, build, load: WIND, rate_hz: 20.0, seconds: 4.0 * HOUR_S, fault: None, roving: None }
}

const fn damped(name: &'static str, what: &'static str, damping: [f64; 2], seconds: f64) -> Case {
    let build = Build::Random { channels: 16, first_hz: 0.8, modes: 8, damping, apart: 6.0, alike: 0.3 };
    Case { name, what, build, load: WHITE, rate_hz: 50.0, seconds, fault: None, roving: None }
}

const fn roving(name: &'static str, what: &'static str, references: [usize; 2]) -> Case {
    let roving = Some(Roving { references, setups: 5 });
    Case { name, what, build: TOWER, load: WIND, rate_hz: 20.0, seconds: 4.0 * HOUR_S, fault: None, roving }
}

const fn machine(name: &'static str, what: &'static str, bandwidths: f64, runs: Runs) -> Case {
    wind(name, what, Some(Fault::Machine(Machine { mode: 4, bandwidths, runs })))
}

/// All cases.
pub const CASES: [Case; 39] = [
    wind("wind", "a tower of 20 channels and 10 modes under wind that is coherent up its height, 6 h at 20 Hz", None),
    correlated("correlated-0", "8 random modes, loads of f^(-5/3), modal forces uncorrelated, 4 h", 0.0),
    correlated("correlated-10", "the same with forces correlated by 0.1", 0.1),
    correlated("correlated-25", "the same with forces correlated by 0.25", 0.25),
    alike("alike", "6 modes 1.5 bandwidths apart whose neighbours' shapes have the correlation 0.5, 4 h", 1.5, 0.5),
    alike("alike-90", "6 modes 6 bandwidths apart whose neighbours' shapes have the correlation 0.9, 4 h", 6.0, 0.9),
    Case {
        name: "bursts",
        what: "8 random modes, loads in bursts of 15 s once a minute on average, 2 h",
        build: Build::Random { channels: 12, first_hz: 0.8, modes: 8, damping: [0.005, 0.02], apart: 8.0, alike: 0.3 },
        load: Load::Bursts,
        rate_hz: 20.0,
        seconds: 2.0 * HOUR_S,
        fault: None,
        roving: None,
    },
    Case {
        name: "forty-channels",
        what: "a tower of 40 channels and 14 modes under wind, 2 h",
        build: Build::Tower { channels: 40, first_hz: 0.3, modes: 14, damping: [0.006, 0.014], apart: 4.0 },
        load: WIND,
        rate_hz: 25.0,
        seconds: 2.0 * HOUR_S,
        fault: None,
        roving: None,
    },
    Case {
        name: "a-day",
        what: "a tower of 8 channels and 8 modes under wind, 24 h at 10 Hz",
        build: Build::Tower { channels: 8, first_hz: 0.15, modes: 8, damping: [0.006, 0.014], apart: 4.0 },
        load: WIND,
        rate_hz: 10.0,
        seconds: 24.0 * HOUR_S,
        fault: None,
        roving: None,
    },
    pairs("pairs-0", "pairs of modes at one frequency, as of an ideal chimney, under wind, 4 h", 0.0),
    pairs("pairs-0.1", "pairs of modes 0.1 bandwidths apart, as of chimneys, under wind, 4 h", 0.1),
    pairs("pairs-1", "pairs 1 bandwidth apart", 1.0),
    pairs("pairs-3", "pairs 3 bandwidths apart", 3.0),
    damped("damped-4", "8 modes of 3 to 5 % damping, an hour at 50 Hz", [0.03, 0.05], HOUR_S),
    damped("damped-8", "8 modes of 0.3 to 8 % damping, an hour at 50 Hz", [0.003, 0.08], HOUR_S),
    Case {
        name: "damped-correlated",
        what: "8 modes of 3 to 8 % damping, forces correlated by 0.3, 12 channels, an hour at 50 Hz",
        build: Build::Random { channels: 12, first_hz: 0.6, modes: 8, damping: [0.03, 0.08], apart: 3.5, alike: 0.3 },
        load: Load::Modal { correlation: 0.3, colour: 0.0 },
        rate_hz: 50.0,
        seconds: HOUR_S,
        fault: None,
        roving: None,
    },
    damped("cables", "8 modes of 0.02 to 0.1 % damping, four hours at 50 Hz", [2e-4, 1e-3], 4.0 * HOUR_S),
    damped("ten-minutes", "8 modes of 1 to 2 % damping, ten minutes at 50 Hz", [0.01, 0.02], 600.0),
    of_channels("one-channel", "one channel of a tower under wind, 4 h", 1),
    of_channels("two-channels", "two channels, 4 h", 2),
    of_channels("four-channels", "four channels, 4 h", 4),
    wind("spike", "`wind` with one spike of 1 g in one channel", Some(Fault::Spike)),
    wind("spikes", "`wind`, 1 % of one channel's samples off by ten times its root mean square", Some(Fault::Spikes)),
    wind("step", "`wind`, one channel jumps by 1 g once", Some(Fault::Step)),
    wind("noise", "`wind`, one channel with added noise of ten times its root mean square", Some(Fault::Noise)),
    wind("missing-rows", "`wind`, 1 % of rows missing, unsaid", Some(Fault::MissingRows)),
    wind("clipped", "`wind`, one channel cut at 1.5 times its root mean square", Some(Fault::Clipped)),
    wind("stuck", "`wind`, one channel holds its value for a tenth of the record", Some(Fault::Stuck)),
    wind(
        "gaps",
        "`wind`, one channel without a reading for two seconds again and again, 1 % in all",
        Some(Fault::Gaps),
    ),
    wind("gain-drifts", "`wind`, one channel's gain rises by 30 % over the record", Some(Fault::GainDrifts)),
    wind("miswired", "`wind`, one channel reversed and two exchanged", Some(Fault::Miswired)),
    machine("tone-1", "`wind`, and a machine one bandwidth above a mode", 1.0, Runs::Steadily),
    machine("tone-2.5", "the same two and a half bandwidths above", 2.5, Runs::Steadily),
    machine("tone-wanders", "the same, its frequency wandering by 0.3 %", 2.5, Runs::Wandering(3e-3)),
    machine("tone-on-off", "the same, on and off for five minutes each on average", 2.5, Runs::OnAndOff(300.0)),
    Case {
        name: "still",
        what: "a structure that stands still: 10 channels of noise, an hour at 20 Hz; there is no mode to find",
        build: Build::Tower { channels: 10, first_hz: 0.4, modes: 1, damping: [0.01, 0.01], apart: 1.0 },
        load: WHITE,
        rate_hz: 20.0,
        seconds: HOUR_S,
        fault: Some(Fault::StandsStill),
        roving: None,
    },
    Case {
        name: "still-short",
        what: "ten minutes of 20 channels of noise at 50 Hz, as few averages a channel as are taken",
        build: Build::Tower { channels: 20, first_hz: 0.4, modes: 1, damping: [0.01, 0.01], apart: 1.0 },
        load: WHITE,
        rate_hz: 50.0,
        seconds: 600.0,
        fault: Some(Fault::StandsStill),
        roving: None,
    },
    roving("setups", "`wind` in five setups of 4 h with references at the top", [18, 19]),
    roving("weak-references", "the same with references at a tenth of the height", [0, 1]),
];

/// The case of a name.
pub fn case(name: &str) -> Option<&'static Case> {
    CASES.iter().find(|case| case.name == name)
}
