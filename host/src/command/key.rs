//! `belfry key`: the nodes' keys.

use std::path::{Path, PathBuf};

use anyhow::Context;
use belfry_shared::seal::Key;
use clap::{Args, Subcommand};
use serde::Serialize;

use super::Console;
use super::text::in_shell;
use crate::files::write_private;
use crate::keys::{Keys, KeysError, add_new, file, study_around};

/// Where a node's program looks for its key: the last sector of the board's flash.
const ADDRESS: u32 = 0x0806_0000;

const EXAMPLES: &str = "Examples:
  belfry key new 3                        a key for node 3
  belfry key image 3 --output 3.key       its image once more
  belfry key list                         which nodes have keys

A node with a key obeys nobody who does not have it, and this computer takes nothing from it that is not sealed with it. The key is drawn from the system's random source and kept in a file that only you can read: the one that BELFRY_KEYS names, else belfry/keys in your folder of settings. Copy its line to another computer that is to collect from the node.

The image goes into the node through its USB or SWD programmer, never over the line that it measures on. Delete the image then.";

/// Give nodes keys, so that nobody else can command or imitate them
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    #[command(subcommand)]
    step: Step,
}

#[derive(Debug, Subcommand)]
enum Step {
    /// Draw a key for a node, keep it, and write its image
    New(Image),
    /// Write the image of a key that there is
    Image(Image),
    /// List the nodes that have keys, without the keys
    List,
}

#[derive(Debug, Args)]
struct Image {
    /// The node's number
    #[arg(value_name = "NODE", value_parser = clap::value_parser!(u16).range(1..))]
    node: u16,
    /// Where the image goes; there must be no file of this name [default: node-NODE.key]
    #[arg(long, value_name = "FILE")]
    output: Option<PathBuf>,
}

#[derive(Debug, Serialize)]
struct Written {
    node: u16,
    keys: PathBuf,
    image: PathBuf,
    address: u32,
}

#[derive(Debug, Serialize)]
struct List {
    keys: PathBuf,
    nodes: Vec<u16>,
}

/// Runs the command.
///
/// # Errors
/// When the file of keys cannot be used, the node has a key already or has none, or the image cannot be written.
pub fn run(arguments: &Arguments, console: &Console) -> anyhow::Result<()> {
    let keys = file()?;
    match &arguments.step {
        Step::New(image) => {
            let output = free_output(image)?;
            let key = add_new(&keys, image.node)?;
            console.say(format!("The key of node {} is in {}, which only you can read.", image.node, keys.display()));
            write_image(image.node, &key, &output, keys, console)
        }
        Step::Image(image) => {
            let output = free_output(image)?;
            let known = Keys::of_file(&keys)?;
            let key = known.of(image.node).ok_or_else(|| KeysError::None { node: image.node, file: keys.clone() })?;
            write_image(image.node, key, &output, keys, console)
        }
        Step::List => {
            let nodes: Vec<u16> = Keys::of_file(&keys)?.nodes().collect();
            let numbers: Vec<String> = nodes.iter().map(u16::to_string).collect();
            match numbers.len() {
                0 => console.say(format!("No node has a key in {}.", keys.display())),
                _ => console.say(format!("Nodes with keys in {}: {}.", keys.display(), numbers.join(", "))),
            }
            console.json("key-list-1", &List { keys, nodes })
        }
    }
}

/// Where the image goes, which must be free before a key is made.
fn free_output(image: &Image) -> anyhow::Result<PathBuf> {
    let output = image.output.clone().unwrap_or_else(|| format!("node-{}.key", image.node).into());
    anyhow::ensure!(
        !output.exists(),
        "{} is there already: remove it, or name another file with --output",
        output.display()
    );
    if let Some(study) = study_around(&output)? {
        anyhow::bail!(
            "{} would lie in the study {}, and be handed on with it: it is the key; name another file with --output",
            output.display(),
            study.display()
        );
    }
    Ok(output)
}

fn write_image(node: u16, key: &Key, output: &Path, keys: PathBuf, console: &Console) -> anyhow::Result<()> {
    write_private(output, &key.image(node), false)
        .with_context(|| {
            format!(
                "the image of node {node}'s key cannot be written to {}; the key itself is in {}, and `belfry key image {node} --output FILE` writes its image elsewhere",
                output.display(),
                keys.display()
            )
        })?;
    let name = in_shell(output);
    console.say(format!(
        "Its image is {}. Write it into the node through the board's USB connector, and delete it:\n  probe-rs download --chip STM32F446RETx --binary-format bin --base-address {ADDRESS:#010x} {name}\n  probe-rs reset --chip STM32F446RETx\n  rm {name}",
        output.display()
    ));
    console.json("key-1", &Written { node, keys, image: output.to_owned(), address: ADDRESS })
}
