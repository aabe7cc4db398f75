//! What can be checked in a Markdown document: fenced blocks with the comments above them, commands in prose, headings and links.

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};

/// What the comment in the line above a block says of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Note {
    /// `<!-- not run: REASON -->`
    NotRun(String),
    /// `<!-- file: PATH -->`: the block is the content of this file, and is written before the next block runs.
    File(String),
    /// `<!-- output of: COMMAND -->`: an excerpt of what this earlier line has printed.
    OutputOf(String),
}

impl Note {
    fn parse(line: &str) -> Option<Self> {
        let text = line.trim().strip_prefix("<!--")?.strip_suffix("-->")?;
        let (word, rest) = text.split_once(": ")?;
        let rest = rest.trim().to_owned();
        match word.trim() {
            "not run" => Some(Self::NotRun(rest)),
            "file" => Some(Self::File(rest)),
            "output of" => Some(Self::OutputOf(rest)),
            other => panic!("no comment above a block begins with {other:?}"),
        }
    }
}

/// A fenced block.
#[derive(Debug)]
pub(crate) struct Block {
    pub(crate) language: String,
    /// The line of its first line in the document, from 1.
    pub(crate) first_line: usize,
    pub(crate) lines: Vec<String>,
    pub(crate) note: Option<Note>,
}

impl Block {
    /// Its commands, with their line in the document: blank lines and comments left out, lines that end in a backslash joined.
    pub(crate) fn commands(&self) -> Vec<(usize, String)> {
        let mut commands: Vec<(usize, String)> = Vec::new();
        let mut goes_on = false;
        for (offset, line) in self.lines.iter().enumerate() {
            let line = line.trim();
            let part = line.strip_suffix('\\').unwrap_or(line);
            if goes_on {
                commands.last_mut().unwrap().1 += part;
            } else if !line.is_empty() && !line.starts_with('#') {
                commands.push((self.first_line + offset, part.to_owned()));
            }
            goes_on = line.ends_with('\\');
        }
        commands
    }
}

/// A document of the repository.
#[derive(Debug)]
pub(crate) struct Document {
    /// Its path in the repository.
    pub(crate) name: String,
    pub(crate) path: PathBuf,
    pub(crate) line_count: usize,
    pub(crate) blocks: Vec<Block>,
    /// Lines outside blocks, by their number.
    pub(crate) prose: Vec<(usize, String)>,
}

impl Document {
    pub(crate) fn read(repository: &Path, name: &str) -> Self {
        let path = repository.join(name);
        let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
        let (mut blocks, mut prose) = (Vec::new(), Vec::new());
        let mut open: Option<Block> = None;
        let mut above = "";
        for (number, line) in (1..).zip(text.lines()) {
            let fence = line.trim_start().strip_prefix("```");
            open = match (open, fence) {
                (None, Some(language)) => {
                    let (language, note) = (language.trim().to_owned(), Note::parse(above));
                    Some(Block { language, first_line: number + 1, lines: Vec::new(), note })
                }
                (None, None) => {
                    prose.push((number, line.to_owned()));
                    None
                }
                (Some(block), Some(_)) => {
                    blocks.push(block);
                    None
                }
                (Some(mut block), None) => {
                    block.lines.push(line.to_owned());
                    Some(block)
                }
            };
            above = line;
        }
        assert!(open.is_none(), "{name}: a block has no end");
        Self { name: name.to_owned(), path, line_count: text.lines().count(), blocks, prose }
    }

    /// Commands between backticks in the prose, with their lines.
    pub(crate) fn commands_in_prose(&self) -> Vec<(usize, String)> {
        let is_command =
            |span: &&str| ["belfry ", "cargo ", "./test", "firmware/"].iter().any(|word| span.starts_with(word));
        let in_line = |(number, line): &(usize, String)| {
            let spans: Vec<String> = line.split('`').skip(1).step_by(2).filter(is_command).map(str::to_owned).collect();
            spans.into_iter().map(|span| (*number, span)).collect::<Vec<_>>()
        };
        self.prose.iter().flat_map(in_line).collect()
    }

    /// Targets of links and pictures, with their lines.
    pub(crate) fn links(&self) -> Vec<(usize, String)> {
        let in_line = |(number, line): &(usize, String)| {
            let targets = line.split("](").skip(1).filter_map(|rest| rest.split(')').next());
            targets.map(|target| (*number, target.to_owned())).collect::<Vec<_>>()
        };
        self.prose.iter().flat_map(in_line).collect()
    }
}

/// Names by which links reach a document's headings: lower case, words joined by hyphens, other signs left out.
pub(crate) fn headings(text: &str) -> HashSet<String> {
    let name = |heading: &str| -> String {
        let kept = |sign: &char| sign.is_alphanumeric() || [' ', '-', '_'].contains(sign);
        heading.trim().to_lowercase().chars().filter(kept).map(|sign| if sign == ' ' { '-' } else { sign }).collect()
    };
    text.lines().filter(|line| line.starts_with('#')).map(|line| name(line.trim_start_matches('#'))).collect()
}
