//! Where an effect acts: the part after the @ of `KIND@WHERE`.
//!
//! Places are named as study.toml names them: the channel `"05"` is `05`, the channel `"top-x"` is `top-x`, node 3 is `3`. A
//! number alone does not say what it counts, so Belfry itself writes `ch05` and `node3`, and reads these as well.

use std::fmt;

/// What stands after the @ of an effect of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlaceKind {
    /// Nothing: the effect concerns the whole structure.
    Nowhere,
    /// A height on the beam.
    Height,
    /// A channel.
    Channel,
    /// Two channels.
    TwoChannels,
    /// A sensor node.
    Node,
    /// A sensor node, or nothing for all.
    NodeOrAll,
    /// A frequency.
    Frequency,
    /// The name of a `[[model.custom]]`.
    Name,
    /// The name of a `[[model.group]]`.
    Group,
}

/// The part after the @: where an effect acts.
#[derive(Debug, Clone, PartialEq)]
pub enum Where {
    /// `443.6m`: a height in m.
    Height(f64),
    /// `07`, `ch07` or `top-x`, or two of them: `04+05`.
    Channels(Vec<String>),
    /// `3` or `node3`: a sensor node.
    Node(u16),
    /// `0.83hz`: a frequency in Hz.
    Frequency(f64),
    /// `cables`: the name of a `[[model.custom]]` or `[[model.group]]`.
    Name(String),
}

impl PlaceKind {
    /// What a user types for it in the outline of a kind.
    pub fn outline(self) -> &'static str {
        match self {
            Self::Nowhere => "",
            Self::Height => "@HEIGHTm",
            Self::Channel => "@CHANNEL",
            Self::TwoChannels => "@CHANNEL+CHANNEL",
            Self::Node => "@NODE",
            Self::NodeOrAll => "[@NODE]",
            Self::Frequency => "@FREQUENCYhz",
            Self::Name => "@NAME",
            Self::Group => "@GROUP",
        }
    }

    /// What it is, in words.
    pub fn in_words(self) -> &'static str {
        match self {
            Self::Nowhere => "none: it acts on the whole structure",
            Self::Height => "a height such as @225.2m",
            Self::Channel => "a channel by its name in study.toml, such as @07",
            Self::TwoChannels => "two channels by their names in study.toml, such as @04+05",
            Self::Node => "a sensor node such as @node3",
            Self::NodeOrAll => "a sensor node such as @node3, or none for all sensors",
            Self::Frequency => "a frequency such as @0.83hz",
            Self::Name => "the name of a [[model.custom]] of the study, such as @cables",
            Self::Group => "the name of a [[model.group]] of the study, such as @storey3",
        }
    }

    /// Reads what a user typed after the @; `None` where it is not of this kind.
    pub fn read(self, text: &str) -> Option<Where> {
        let text = text.trim();
        let number =
            |suffix| text.strip_suffix(suffix).and_then(|n: &str| n.parse::<f64>().ok()).filter(|n| n.is_finite());
        match self {
            Self::Nowhere => None,
            Self::Height => number("m").map(Where::Height),
            Self::Channel => (!text.is_empty()).then(|| Where::Channels(vec![channel(text)])),
            Self::TwoChannels => {
                let channels: Vec<String> = text.split('+').map(|part| channel(part.trim())).collect();
                (channels.len() > 1 && channels.iter().all(|name| !name.is_empty()))
                    .then_some(Where::Channels(channels))
            }
            Self::Node | Self::NodeOrAll => {
                text.strip_prefix("node").unwrap_or(text).trim_start().parse().ok().map(Where::Node)
            }
            Self::Frequency => number("hz").or(number("Hz")).filter(|&hz| hz > 0.0).map(Where::Frequency),
            Self::Name | Self::Group => (!text.is_empty()).then(|| Where::Name(text.to_owned())),
        }
    }

    /// Whether an effect of this kind can act at a place.
    pub(super) fn takes(self, place: Option<&Where>) -> bool {
        match (self, place) {
            (Self::Nowhere | Self::NodeOrAll, None)
            | (Self::Height, Some(Where::Height(_)))
            | (Self::Node | Self::NodeOrAll, Some(Where::Node(_)))
            | (Self::Frequency, Some(Where::Frequency(_)))
            | (Self::Name | Self::Group, Some(Where::Name(_))) => true,
            (Self::Channel, Some(Where::Channels(channels))) => channels.len() == 1,
            // More parts than two are channels with a + in their names, which only the study can tell.
            (Self::TwoChannels, Some(Where::Channels(channels))) => channels.len() > 1 && channels[0] != channels[1],
            _ => false,
        }
    }
}

/// A channel's name as typed; the `ch` in front of a number is Belfry's.
fn channel(text: &str) -> String {
    text.strip_prefix("ch").filter(|rest| is_number(rest)).unwrap_or(text).to_owned()
}

fn is_number(name: &str) -> bool {
    !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_digit())
}

/// What Belfry writes, and [`PlaceKind::read`] reads.
impl fmt::Display for Where {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Height(z_m) => write!(f, "{z_m}m"),
            Self::Channels(channels) => {
                let word = |name: &String| if is_number(name) { format!("ch{name}") } else { name.clone() };
                f.write_str(&channels.iter().map(word).collect::<Vec<_>>().join("+"))
            }
            Self::Node(node) => write!(f, "node{node}"),
            Self::Frequency(frequency_hz) => write!(f, "{frequency_hz}hz"),
            Self::Name(name) => f.write_str(name),
        }
    }
}
