//! The page as HTML: with everything in one file, or with addresses on a server.
//!
//! The front end's files are part of the program; data flows in as JSON, a document flows out.

use std::collections::VecDeque;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use include_dir::{Dir, include_dir};

use crate::colour;
use crate::command::printable;

static FRONT_END: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/page");
/// The frame, whose parts between `<!--name-->` and `<!--/name-->` are replaced.
const FRAME: &str = include_str!("../../page/index.html");
/// Bare names of modules begin with it.
const MODULES: &str = "@/";
/// The start of a fleet's page, which a report has no use for.
const FLEET: &str = "fleet.js";
/// Where a server has the front end's files.
const ASSETS: &str = "/assets/";
/// The style of curves, and that of the page.
const STYLES: [&str; 2] = [include_str!("../../page/vendor/uPlot.css"), include_str!("../../page/style.css")];
/// What a report may do: run what stands in it and draw; nothing from any network, and nothing to it.
const REPORT_POLICY: &str = "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'";

/// A file of the front end as a server gives it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Asset {
    /// Its address.
    pub path: String,
    /// Its media type.
    pub media_type: &'static str,
    /// Its text.
    pub text: String,
}

/// All files that a served page asks for.
pub fn assets() -> Vec<Asset> {
    let style = Asset { path: format!("{ASSETS}style.css"), media_type: "text/css; charset=utf-8", text: style() };
    let module = |(name, text): (String, String)| Asset {
        path: format!("{ASSETS}{name}"),
        media_type: "text/javascript; charset=utf-8",
        text,
    };
    std::iter::once(style).chain(modules().into_iter().map(module)).collect()
}

fn style() -> String {
    [&colour::style(), STYLES[0], STYLES[1]].join("\n")
}

/// Names and texts of all modules as the page gets them.
fn modules() -> Vec<(String, String)> {
    let mut folders = vec![&FRONT_END];
    let mut modules = Vec::new();
    while let Some(folder) = folders.pop() {
        folders.extend(folder.dirs());
        modules.extend(folder.files().filter_map(|file| {
            let (name, text) = (file.path().to_str()?, file.contents_utf8()?);
            let is_small = file.path().starts_with("vendor");
            let text = if is_small { text.to_owned() } else { bare(text) };
            (file.path().extension()? == "js").then_some((name.replace('\\', "/"), text))
        }));
    }
    modules.sort();
    modules
}

/// A module without comments and without spaces that mean nothing: three quarters of its size. Line ends stay, for they may end a statement.
/// No text in the front end goes over several lines, which would lose its indentation.
fn bare(module: &str) -> String {
    let lines = module.lines().map(str::trim).filter(|line| !line.is_empty());
    let code = Scanner { rest: lines.collect::<Vec<_>>().join("\n").chars().collect(), bare: String::new() }.scan();
    code.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join("\n")
}

/// Goes through a module's letters; texts and patterns keep all of theirs.
struct Scanner {
    rest: VecDeque<char>,
    bare: String,
}

impl Scanner {
    fn scan(mut self) -> String {
        // Braces that are open in each `${` of a text with values.
        let mut values: Vec<usize> = Vec::new();
        while let Some(letter) = self.rest.pop_front() {
            let next = self.rest.front().copied();
            match (letter, next) {
                ('/', Some('/')) => {
                    while self.rest.front().is_some_and(|letter| *letter != '\n') {
                        self.rest.pop_front();
                    }
                }
                // A notice of a licence stays.
                ('/', Some('*')) if self.rest.get(1) != Some(&'!') => self.skip_comment(),
                ('/', _) if self.begins_pattern() => self.copy(letter, '/'),
                ('"' | '\'', _) => self.copy(letter, letter),
                ('`', _) => self.copy_text(letter, &mut values),
                ('}', _) if values.last() == Some(&0) => {
                    values.pop();
                    self.copy_text(letter, &mut values);
                }
                (' ', Some(next)) => {
                    let before = self.bare.chars().next_back().unwrap_or('\n');
                    // `a + +b` is not `a ++b`.
                    if is_word(before) && is_word(next) || before == next {
                        self.bare.push(' ');
                    }
                }
                _ => {
                    match (letter, values.last_mut()) {
                        ('{', Some(open)) => *open += 1,
                        ('}', Some(open)) => *open -= 1,
                        _ => {}
                    }
                    self.bare.push(letter);
                }
            }
        }
        self.bare
    }

    fn skip_comment(&mut self) {
        let mut last = ' ';
        self.rest.pop_front();
        while let Some(letter) = self.rest.pop_front() {
            if (last, letter) == ('*', '/') {
                break;
            }
            last = letter;
        }
    }

    /// Whether a slash here divides nothing.
    fn begins_pattern(&self) -> bool {
        self.bare.trim_end_matches(' ').chars().next_back().is_none_or(|before| "(,=:[!&|?{;>\n".contains(before))
    }

    /// Copies up to the letter that ends what has begun.
    fn copy(&mut self, first: char, last: char) {
        self.bare.push(first);
        // In a pattern's brackets a slash is a slash.
        let mut is_class = false;
        while let Some(letter) = self.rest.pop_front() {
            self.bare.push(letter);
            match letter {
                '\\' => self.bare.extend(self.rest.pop_front()),
                '[' | ']' if last == '/' => is_class = letter == '[',
                _ if letter == last && !is_class => break,
                _ => {}
            }
        }
    }

    /// Copies a text with values up to its end, or to the next value.
    fn copy_text(&mut self, first: char, values: &mut Vec<usize>) {
        self.bare.push(first);
        while let Some(letter) = self.rest.pop_front() {
            self.bare.push(letter);
            match (letter, self.rest.front()) {
                ('\\', _) => self.bare.extend(self.rest.pop_front()),
                ('`', _) => break,
                ('$', Some('{')) => {
                    self.bare.extend(self.rest.pop_front());
                    values.push(0);
                    break;
                }
                _ => {}
            }
        }
    }
}

fn is_word(letter: char) -> bool {
    letter.is_alphanumeric() || matches!(letter, '_' | '$' | '#')
}

/// One file with everything: opens from disk, asks for nothing. `data` is JSON.
pub fn report(title: &str, data: &str) -> String {
    let modules: Vec<String> = modules()
        .into_iter()
        .filter(|(name, _)| name != FLEET)
        .map(|(name, text)| format!("\"{MODULES}{name}\": \"data:text/javascript;base64,{}\"", STANDARD.encode(text)))
        .collect();
    let policy = format!("<meta http-equiv=\"content-security-policy\" content=\"{REPORT_POLICY}\">\n");
    let page = with_part(FRAME, "style", &format!("{policy}<style>\n{}\n</style>", style()));
    let page = with_part(
        &page,
        "modules",
        &format!("<script type=\"importmap\">{{ \"imports\": {{ {} }} }}</script>", modules.join(", ")),
    );
    let page = with_part(&page, "start", &format!("<script type=\"module\">import \"{MODULES}main.js\"</script>"));
    // Nothing in the data may end the element that it stands in.
    let data = data.replace('<', "\\u003c");
    let page = with_part(&page, "data", &format!("<script type=\"application/json\" id=\"data\">{data}</script>"));
    page.replacen("<title>Belfry</title>", &format!("<title>{}</title>", escaped(title)), 1)
}

/// The page of a study that a server gives; its data comes later. `nonce` names the scripts that may run.
pub fn served(title: &str, nonce: &str) -> String {
    served_with(title, nonce, "main.js")
}

/// The page of a fleet.
pub fn served_fleet(nonce: &str) -> String {
    served_with("Fleet", nonce, FLEET)
}

fn served_with(title: &str, nonce: &str, start: &str) -> String {
    let page = with_part(FRAME, "style", &format!("<link rel=\"stylesheet\" href=\"{ASSETS}style.css\">"));
    let map = format!(
        "<script type=\"importmap\" nonce=\"{nonce}\">{{ \"imports\": {{ \"{MODULES}\": \"{ASSETS}\" }} }}</script>"
    );
    let page = with_part(&page, "modules", &map);
    let page = with_part(&page, "start", &format!("<script type=\"module\" src=\"{ASSETS}{start}\"></script>"));
    page.replacen("<title>Belfry</title>", &format!("<title>{}</title>", escaped(title)), 1)
}

/// Replaces what stands between a part's marks.
fn with_part(page: &str, name: &str, text: &str) -> String {
    let (open, close) = (format!("<!--{name}-->"), format!("<!--/{name}-->"));
    let (Some(start), Some(end)) = (page.find(&open), page.find(&close)) else { return page.to_owned() };
    format!("{}{text}{}", &page[..start], &page[end + close.len()..])
}

fn escaped(text: &str) -> String {
    printable(text).replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_holds_every_module_and_asks_for_nothing() {
        let page = report("Tower <1>\u{1b}[2J\u{202e}", "{\"name\": \"</script><script>alert(1)</script>\"}");
        assert!(
            page.contains("<title>Tower &lt;1&gt;\\u{1b}[2J\\u{202e}</title>") && !page.contains("alert(1)</script>")
        );
        for part in ["style", "modules", "start", "data"] {
            assert!(!page.contains(&format!("<!--{part}-->")), "{part} has its place in the frame");
        }
        for (name, text) in modules() {
            assert_eq!(page.contains(&format!("\"{MODULES}{name}\"")), name != FLEET, "{name}");
            // Every import has to be in the map.
            let imports = text.lines().filter(|line| line.starts_with("import"));
            for imported in
                imports.flat_map(|line| line.split("from\"").skip(1)).filter_map(|rest| rest.split('"').next())
            {
                assert!(imported.starts_with(MODULES), "{name} imports {imported}");
                assert!(
                    modules().iter().any(|(other, _)| *imported == format!("{MODULES}{other}")),
                    "{name}: {imported}"
                );
            }
        }
        for address in ["src=\"", "href=\"http", "@import", "url("] {
            assert!(!page.contains(address), "{address}");
        }
    }

    #[test]
    fn modules_lose_comments_and_nothing_else() {
        let module = "// What it is.\n/**\n * Adds.\n */\nexport const sum = (a, b) =>\n    a + +b // \"both\"\n\n/* one */\nexport const two = \"/* no  comment */\"\n";
        assert_eq!(bare(module), "export const sum=(a,b)=>\na+ +b\nexport const two=\"/* no  comment */\"");
        for (code, is) in [
            ("const way = text.replace(/ [/\"] /g, ' \\' ') / 2 / n", "const way=text.replace(/ [/\"] /g,' \\' ')/2/n"),
            (
                "say(`a  ${ b ? `${ c + 1 } of  ${{ d: 1 }.d}` : \"} \" } .  ` + e)",
                "say(`a  ${b?`${c+1} of  ${{d:1}.d}`:\"} \"} .  `+e)",
            ),
            ("return a in b // `\nnext", "return a in b\nnext"),
            ("/*! (c) */ try { x() } catch { /* nothing */ }", "/*! (c) */try{x()}catch{}"),
        ] {
            assert_eq!(bare(code), is);
        }
        // A text over several lines has an odd number of marks on its first.
        for file in FRONT_END
            .files()
            .chain(FRONT_END.dirs().flat_map(Dir::files))
            .filter(|file| file.path().extension().is_some_and(|end| end == "js") && !file.path().starts_with("vendor"))
        {
            for line in file.contents_utf8().unwrap().lines().filter(|line| !line.trim().starts_with(['/', '*'])) {
                assert!(
                    line.replace("\"`\"", "").matches('`').count().is_multiple_of(2),
                    "{}: {line}",
                    file.path().display()
                );
            }
        }
    }

    #[test]
    fn a_served_page_asks_for_files_that_are_there() {
        let page = served("Tower", "abc");
        let assets = assets();
        let asked: Vec<&str> = page.split('"').filter(|text| text.starts_with(ASSETS) && text.contains('.')).collect();
        assert_eq!(asked, ["/assets/style.css", "/assets/main.js"]);
        assert!(asked.iter().all(|path| assets.iter().any(|asset| asset.path == *path)));
        // No page asks for all: a study's leaves out the fleet's, which needs but a part of the others.
        let of_study = assets.iter().filter(|asset| asset.path.ends_with(".js") && !asset.path.ends_with(FLEET));
        let bytes: usize = of_study.map(|asset| asset.text.len()).sum();
        assert!(bytes < 200_000, "{bytes} bytes of JavaScript");
    }
}
