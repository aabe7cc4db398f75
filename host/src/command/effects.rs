//! `belfry effects`: the catalogue of physical effects.

use anyhow::Context;
use clap::Args;
use comfy_table::{Table, presets::UTF8_FULL_CONDENSED};
use serde::Serialize;

use super::Console;
use crate::model::effect::{self, About, EffectKind, KINDS, Parameter, Prior};

const EXAMPLES: &str = "Examples:
  belfry effects                   all of them, a line each
  belfry effects base-rotation     one, in full
  belfry effects --json";

/// List and explain the physical effects that a model can lack
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// One effect, in full
    #[arg(value_name = "KIND")]
    pub kind: Option<String>,
}

/// What `--json` prints of all kinds.
#[derive(Debug, Serialize)]
struct Catalogue {
    effects: Vec<Entry>,
}

/// What `--json` prints of a kind.
#[derive(Debug, Serialize)]
struct Entry {
    #[serde(flatten)]
    about: &'static About,
    place: &'static str,
    parameter_sets: &'static [&'static [Parameter]],
}

/// Runs the command.
///
/// # Errors
/// When no effect has the name.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    if let Some(name) = &arguments.kind {
        let kind = effect::find(name)?;
        explain(kind, console);
        return console.json("effect-1", &entry(kind));
    }
    let mut table = Table::new();
    table.load_style(UTF8_FULL_CONDENSED);
    table.set_header(vec!["effect", "what it does", "how it shows"]);
    table.set_content_arrangement(comfy_table::ContentArrangement::Dynamic);
    if table.width().is_none() {
        table.set_width(WIDTH);
    }
    for kind in KINDS {
        let about = kind.about();
        let first = about.physics.split_once(". ").map_or(about.physics, |(first, _)| first);
        table.add_row(vec![
            format!("{}{}", about.name, kind.place().outline()),
            first.to_owned(),
            about.fingerprint.to_owned(),
        ]);
    }
    console.say(table);
    console.say("Next: belfry effects base-rotation    # one of them in full: formula, parameters, look-alikes");
    console
        .json("effects-1", &Catalogue { effects: KINDS.iter().map(|kind| entry(*kind)).collect() })
        .context("the catalogue")
}

/// Columns where standard output is no terminal.
const WIDTH: u16 = 110;

fn entry(kind: &'static dyn EffectKind) -> Entry {
    Entry { about: kind.about(), place: kind.place().in_words(), parameter_sets: kind.parameter_sets() }
}

fn explain(kind: &'static dyn EffectKind, console: &Console) {
    let about = kind.about();
    console.say(format!("{}{}", about.name, kind.place().outline()));
    console.say(format!("\n{}\n", about.physics));
    console.say(format!("Enters as:   {}", about.formula));
    console.say(format!("Fingerprint: {}", about.fingerprint));
    console.say(format!("Place:       {}", kind.place().in_words()));
    for (index, set) in kind.parameter_sets().iter().enumerate() {
        let label = if index == 0 { "Parameters: " } else { "        or: " };
        if set.is_empty() {
            console.say(format!("{label} none"));
        }
        for (row, parameter) in set.iter().enumerate() {
            let label = if row == 0 { label } else { "       and: " };
            let typical = match parameter.prior {
                Prior::Value(typical) if parameter.neutral == 0.0 => {
                    format!("; typically {typical}{}", unit(parameter))
                }
                Prior::Value(typical) => format!("; typically {typical}{} from {}", unit(parameter), parameter.neutral),
                Prior::FrequencyShift(share) => {
                    format!("; typically what moves a frequency by {:.0} %", 100.0 * share)
                }
                Prior::Share(share) => format!("; known to some {:.0} % before it is fitted", 100.0 * share),
                Prior::Given => String::new(),
            };
            console.say(format!("{label} {} ({}): {}{typical}", parameter.name, parameter.range(), parameter.meaning));
        }
    }
    for (index, example) in about.examples.iter().enumerate() {
        let label = if index == 0 { "Typed as:   " } else { "        or: " };
        console.say(format!("{label} {example}"));
    }
    for alike in about.look_alikes {
        console.say(format!("Looks like {}; what separates them: {}.", alike.kind, alike.separated_by));
    }
    console.say(format!("Source:      {}", about.source));
}

fn unit(parameter: &Parameter) -> String {
    if parameter.unit == "-" { String::new() } else { format!(" {}", parameter.unit) }
}
