//! Places of effects as a study knows them: channels and nodes as typed flow in, those of the sensors flow out.

use super::error::EffectError;
use super::place::Where;
use crate::study::Sensor;

/// The same place with channels named as the study's sensors name them.
///
/// # Errors
/// [`EffectError::NoChannel`] and [`EffectError::NoNode`] where no sensor is there, for an effect of `kind`.
pub(super) fn in_study(place: &Where, kind: &'static str, sensors: &[Sensor]) -> Result<Where, EffectError> {
    match place {
        Where::Channels(names) => {
            let known = |name: &str| channel_in_study(name, sensors);
            if let Some(channels) = names.iter().map(|name| known(name)).collect::<Option<Vec<_>>>()
                && channels.len() <= 2
            {
                return Ok(Where::Channels(channels));
            }
            // A + may belong to a name.
            let whole = place.to_string();
            let halves = whole.match_indices('+').map(|(at, _)| (&whole[..at], &whole[at + 1..]));
            if names.len() > 1
                && let Some((one, other)) = halves.filter_map(|(one, other)| Some((known(one)?, known(other)?))).next()
            {
                return Ok(Where::Channels(vec![one, other]));
            }
            let unknown = names.iter().find(|name| known(name).is_none()).unwrap_or(&whole);
            let all = sensors.iter().map(|sensor| sensor.channel.as_str()).collect::<Vec<_>>().join(", ");
            Err(EffectError::NoChannel { kind, channel: unknown.clone(), known: or_none(all) })
        }
        &Where::Node(node) if sensors.iter().all(|sensor| sensor.node != node) => {
            let mut nodes: Vec<u16> = sensors.iter().map(|sensor| sensor.node).collect();
            nodes.sort_unstable();
            nodes.dedup();
            let known = nodes.iter().map(u16::to_string).collect::<Vec<_>>().join(", ");
            Err(EffectError::NoNode { kind, node, known: or_none(known) })
        }
        _ => Ok(place.clone()),
    }
}

/// The study's own name of a channel: as it is, or with or without the `ch` that stands in front of it.
fn channel_in_study(name: &str, sensors: &[Sensor]) -> Option<String> {
    let known = |name: &str| sensors.iter().any(|sensor| sensor.channel == name).then(|| name.to_owned());
    known(name).or_else(|| known(&format!("ch{name}"))).or_else(|| known(name.strip_prefix("ch")?))
}

fn or_none(known: String) -> String {
    if known.is_empty() { "none".to_owned() } else { known }
}
