//! What the demo hides in its tower: an effect that the user chooses, or one that the seed draws.

use anyhow::bail;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::model::effect::Effect;
use crate::simulate::can_show;

/// Effects that the seed draws from, with the range of their value: each moves a frequency of the tower by some percent, or
/// spoils a channel.
const DRAWN: [(&str, f64, f64); 9] = [
    ("sensor-swap@11+12", 0.0, 0.0),
    ("added-mass@443.6m", 2e6, 6e6),
    ("added-mass@225.2m", 8e6, 2e7),
    ("shear-flexibility", 0.1, 0.4),
    ("connection-flexibility@443.6m", 2e-13, 2e-12),
    ("stiffness-loss@275.3m", 0.4, 0.7),
    ("axis-rotation", 6.0, 14.0),
    ("sensor-gain@13", 1.2, 1.6),
    ("base-rotation", 5e-15, 1.5e-14),
];

/// The effect that a seed hides.
pub(super) fn drawn(seed: u64) -> anyhow::Result<Effect> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // Far from the stream that the recording's load is drawn from.
    random.set_stream(u64::MAX);
    let Some(&(name, least, most)) = DRAWN.choose(&mut random) else { bail!("there is nothing to hide") };
    if least == most {
        return Ok(name.parse()?);
    }
    let value = (f64::ln(least) + random.random::<f64>() * (most / least).ln()).exp();
    // Three digits, as an engineer would give it.
    Ok(format!("{name}={value:.2e}").parse()?)
}

/// Whether the demo's simulated structure can have an effect.
pub(super) fn check(effect: &Effect) -> anyhow::Result<()> {
    if !can_show(effect.of_kind()) || effect.of_kind().is_of_the_study() {
        bail!(
            "the demo cannot hide {}: choose an effect of the structure, of its sensors or their clocks, or a harmonic",
            effect.kind()
        );
    }
    Ok(())
}
