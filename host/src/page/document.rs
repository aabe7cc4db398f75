//! The page as HTML: with everything in one file, or with addresses on a server.
//!
//! The front end's files are part of the program; data flows in as JSON, a document flows out.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use include_dir::{Dir, include_dir};

static FRONT_END: Dir<'_> = include_dir!("$CARGO_MANIFEST_DIR/page");
/// The frame, whose parts between `<!--name-->` and `<!--/name-->` are replaced.
const FRAME: &str = include_str!("../../page/index.html");
/// Bare names of modules begin with it.
const MODULES: &str = "@/";
/// Where a server has the front end's files.
const ASSETS: &str = "/assets/";
/// The style of the page, and that of its curves.
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
    let style =
        Asset { path: format!("{ASSETS}style.css"), media_type: "text/css; charset=utf-8", text: STYLES.join("\n") };
    let module = |(name, text): (String, String)| Asset {
        path: format!("{ASSETS}{name}"),
        media_type: "text/javascript; charset=utf-8",
        text,
    };
    std::iter::once(style).chain(modules().into_iter().map(module)).collect()
}

/// Names and texts of all modules, without comments and indentation.
fn modules() -> Vec<(String, String)> {
    let mut folders = vec![&FRONT_END];
    let mut modules = Vec::new();
    while let Some(folder) = folders.pop() {
        folders.extend(folder.dirs());
        modules.extend(folder.files().filter_map(|file| {
            let name = file.path().to_str()?;
            (file.path().extension()? == "js").then_some((name.replace('\\', "/"), bare(file.contents_utf8()?)))
        }));
    }
    modules.sort();
    modules
}

/// A module without comments on lines of their own, and without indentation: a sixth of its size. No text in the front end goes over several
/// lines, which would lose its own.
fn bare(module: &str) -> String {
    let mut is_comment = false;
    let mut lines = Vec::new();
    for line in module.lines().map(str::trim).filter(|line| !line.is_empty()) {
        // A notice of a licence stays.
        is_comment |= line.starts_with("/*") && !line.starts_with("/*!");
        if !is_comment && !line.starts_with("//") {
            lines.push(line);
        }
        is_comment &= !line.ends_with("*/");
    }
    lines.join("\n")
}

/// One file with everything: opens from disk, asks for nothing. `data` is JSON.
pub fn report(title: &str, data: &str) -> String {
    let modules: Vec<String> = modules()
        .into_iter()
        .map(|(name, text)| format!("\"{MODULES}{name}\": \"data:text/javascript;base64,{}\"", STANDARD.encode(text)))
        .collect();
    let policy = format!("<meta http-equiv=\"content-security-policy\" content=\"{REPORT_POLICY}\">\n");
    let page = with_part(FRAME, "style", &format!("{policy}<style>\n{}\n</style>", STYLES.join("\n")));
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

/// The page that a server gives; its data comes later. `nonce` names the scripts that may run.
pub fn served(title: &str, nonce: &str) -> String {
    let page = with_part(FRAME, "style", &format!("<link rel=\"stylesheet\" href=\"{ASSETS}style.css\">"));
    let map = format!(
        "<script type=\"importmap\" nonce=\"{nonce}\">{{ \"imports\": {{ \"{MODULES}\": \"{ASSETS}\" }} }}</script>"
    );
    let page = with_part(&page, "modules", &map);
    let page = with_part(&page, "start", &format!("<script type=\"module\" src=\"{ASSETS}main.js\"></script>"));
    page.replacen("<title>Belfry</title>", &format!("<title>{}</title>", escaped(title)), 1)
}

/// Replaces what stands between a part's marks.
fn with_part(page: &str, name: &str, text: &str) -> String {
    let (open, close) = (format!("<!--{name}-->"), format!("<!--/{name}-->"));
    let (Some(start), Some(end)) = (page.find(&open), page.find(&close)) else { return page.to_owned() };
    format!("{}{text}{}", &page[..start], &page[end + close.len()..])
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_holds_every_module_and_asks_for_nothing() {
        let page = report("Tower <1>", "{\"name\": \"</script><script>alert(1)</script>\"}");
        assert!(page.contains("<title>Tower &lt;1&gt;</title>") && !page.contains("alert(1)</script>"));
        for part in ["style", "modules", "start", "data"] {
            assert!(!page.contains(&format!("<!--{part}-->")), "{part} has its place in the frame");
        }
        for (name, text) in modules() {
            assert!(page.contains(&format!("\"{MODULES}{name}\"")), "{name}");
            // Every import has to be in the map.
            for imported in text.split("from \"").skip(1).filter_map(|rest| rest.split('"').next()) {
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
        let module = "// What it is.\n/**\n * Adds.\n */\nexport const sum = (a, b) =>\n    a + b // \"both\"\n\n/* one */\nexport const two = \"/* no comment */\"\n";
        assert_eq!(
            bare(module),
            "export const sum = (a, b) =>\na + b // \"both\"\nexport const two = \"/* no comment */\""
        );
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
        let bytes: usize =
            assets.iter().filter(|asset| asset.path.ends_with(".js")).map(|asset| asset.text.len()).sum();
        assert!(bytes < 200_000, "{bytes} bytes of JavaScript");
    }
}
