//! A user looks instead of reading: the report, and the page on the own machine, which nobody else can reach.

#[cfg(browser)]
mod browser;
#[cfg(browser)]
mod driver;
#[cfg(browser)]
mod fleet;
pub(crate) mod server;

use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_host::story::Project;
use belfry_tests::belfry_command;
use serde_json::{Value, json};

use server::Server;

fn run(arguments: &[&str]) -> String {
    let output = belfry_command().args(arguments).assert().success().get_output().stdout.clone();
    String::from_utf8(output).unwrap()
}

fn run_json(arguments: &[&str]) -> Value {
    let output = belfry_command().args(arguments).arg("--json").assert().success().get_output().stdout.clone();
    serde_json::from_slice(&output).unwrap()
}

/// An hour of a Canton Tower that rotates on its soil, which its model does not know. Its recording is there, nothing is identified.
fn study(folder: &Path) -> String {
    let study = folder.join("canton").to_str().unwrap().to_owned();
    run(&["init", &study, "--template", "canton"]);
    run(&["simulate", &study, "--effect", "base-rotation=1.2e-14", "--hours", "1", "--seed", "3", "--adopt"]);
    study
}

/// The object that a report's pictures are drawn from.
fn data_of(page: &str) -> Value {
    let open = "<script type=\"application/json\" id=\"data\">";
    let from = page.find(open).expect("the report has its data") + open.len();
    let to = from + page[from..].find("</script>").unwrap();
    serde_json::from_str(&page[from..to]).unwrap()
}

fn sentences(data: &Value, kind: &str) -> Vec<String> {
    let all = data["findings"].as_array().unwrap().iter().filter(|finding| finding["kind"] == kind);
    all.map(|finding| finding["text"].as_str().unwrap().to_owned()).collect()
}

/// Of which models there is a MAC matrix.
fn macs(data: &Value) -> Vec<&str> {
    data["mac"].as_array().unwrap().iter().map(|mac| mac["what"].as_str().unwrap()).collect()
}

#[test]
fn one_file_tells_what_was_found_and_asks_for_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path());
    // Before anything was found, it says what to do.
    run(&["report", &study]);
    let report = Path::new(&study).join("results/report.html");
    let data = data_of(&fs::read_to_string(&report).unwrap());
    assert_eq!((sentences(&data, "next"), &data["modes"]), (vec!["Identify the modes. Spectra, time histories, shapes and all that follows are drawn from what that finds.".to_owned()], &Value::Null));

    run(&["identify", &study, "--direct"]);
    run(&["update", &study]);
    run(&["covalidate", &study, "--channels", "09", "--direct"]);
    run(&["diagnose", &study]);
    let data = data_of(&{
        run(&["report", &study]);
        fs::read_to_string(&report).unwrap()
    });
    assert!(sentences(&data, "finding")[0].starts_with("The model lacks base-rotation"), "{data:?}");
    assert!(data["stale"].as_object().unwrap().is_empty(), "{}", data["stale"]);

    run(&["add", &study, "base-rotation"]);
    let elsewhere = folder.path().join("tower.html");
    let written = run_json(&["report", &study, "--output", elsewhere.to_str().unwrap()]);
    let page = fs::read_to_string(&elsewhere).unwrap();
    assert_eq!(written["bytes"], page.len());
    assert!(page.len() < 3_000_000, "{} bytes", page.len());
    for address in ["src=\"http", "href=\"http", "url(http", "@import"] {
        assert!(!page.contains(address), "{address}");
    }
    let data = data_of(&page);
    // The diagnosis is of the model before; the page says so and takes nothing from it.
    assert!(data["stale"]["diagnosis"].as_str().unwrap().contains("the model's effects changed since"));
    let found = sentences(&data, "finding");
    assert!(
        found[0].starts_with("With base-rotation (1.")
            && found[0].contains("rad/(N m)) in the model, the mean frequency error fell from"),
        "{found:?}"
    );
    // What it shows is what the command says.
    let compared = run_json(&["compare", &study]);
    let shown = &data["comparison"]["effects"];
    for key in ["chi_squared", "p_value", "mean_abs_frequency_error_percent", "mean_mac"] {
        let (shown, said) = (shown[key].as_f64().unwrap(), compared[key].as_f64().unwrap());
        assert!((shown - said).abs() <= 1e-6 * said.abs(), "{key}: {shown} {said}");
    }
    // An effect that was fitted counts as fitted wherever the model is tested.
    let step = data["history"].as_array().unwrap().last().unwrap();
    assert_eq!(step["degrees_of_freedom"], compared["degrees_of_freedom"], "{step}");
    let (shown, said) = (step["chi_squared"].as_f64().unwrap(), compared["chi_squared"].as_f64().unwrap());
    assert!((shown / said - 1.0).abs() < 0.01, "{shown} {said}");
    assert_eq!(
        data["method"]["commands"],
        json!([
            ["identify", "--direct"],
            ["update"],
            ["covalidate", "--channels", "09"],
            ["diagnose"],
            ["add", "base-rotation"]
        ])
    );
    let shown = &data["comparison"]["effects"];
    assert!(
        data["comparison"]["given"]["mean_abs_frequency_error_percent"].as_f64()
            > shown["mean_abs_frequency_error_percent"].as_f64()
    );
    let parts = data["model"]["parts"].as_array().unwrap();
    assert_eq!(parts.iter().map(|part| part["name"].as_str().unwrap()).collect::<Vec<_>>(), ["given", "effects"]);
    // It turns on its soil only with the effect: near the base it moves more, at the same motion above.
    let moves = |part: &Value, node: usize| {
        let motion = part["modes"][0]["motion"][node].as_array().unwrap();
        motion[0].as_f64().unwrap().hypot(motion[1].as_f64().unwrap())
    };
    let top = parts[0]["nodes"].as_array().unwrap().len() - 1;
    let near_base = |part: &Value| moves(part, 1) / moves(part, top);
    assert!(near_base(&parts[1]) > 1.05 * near_base(&parts[0]), "{} {}", near_base(&parts[0]), near_base(&parts[1]));
    assert!(parts.iter().all(|part| moves(part, 0) < 1e-9), "it stands where it stood");
    // The update is that of the model as given, which is shown as well.
    assert_eq!(macs(&data), ["given", "updated", "effects"]);
    assert_eq!(data["spectra"]["setups"][0]["psd"].as_array().unwrap().len(), 20);
    assert_eq!(data["record"]["setups"][0]["min"].as_array().unwrap().len(), 20);
    assert_eq!(data["curves"]["channels"][0]["channel"], "09");

    // The same modes once more change nothing.
    run(&["identify", &study, "--direct"]);
    run(&["report", &study]);
    let data = data_of(&fs::read_to_string(&report).unwrap());
    assert!(sentences(&data, "finding")[0].contains("fell from"), "{}", data["stale"]);

    // An update of the model with an effect is none of the model without it.
    run(&["update", &study]);
    run(&["report", &study]);
    assert_eq!(macs(&data_of(&fs::read_to_string(&report).unwrap())), ["given", "updated", "effects"]);
    let removed = run(&["remove", &study, "base-rotation"]);
    assert!(removed.contains("The data support it: without it, ln B = -"), "{removed}");
    run(&["report", &study]);
    assert_eq!(macs(&data_of(&fs::read_to_string(&report).unwrap())), ["given"]);
    run(&["add", &study, "base-rotation"]);

    // With other modes the fall is one of older ones; a result that holds nothing is named.
    let toml = Path::new(&study).join("study.toml");
    let text = fs::read_to_string(&toml).unwrap();
    let narrower = text.replace("band_hz = [0.05, 1.5]", "band_hz = [0.05, 1.3]");
    assert_ne!(narrower, text);
    fs::write(&toml, narrower).unwrap();
    run(&["identify", &study, "--direct"]);
    fs::write(Path::new(&study).join("results/diagnosis.json"), "{}").unwrap();
    run(&["report", &study]);
    let data = data_of(&fs::read_to_string(&report).unwrap());
    let found = sentences(&data, "finding");
    assert!(!found.iter().any(|text| text.contains("fell from")), "{found:?}");
    assert!(data["stale"]["history"].is_string(), "{}", data["stale"]);
    let damaged = sentences(&data, "warning");
    let is_named = |text: &String| text.ends_with("results/diagnosis.json is damaged: run `belfry diagnose` again.");
    assert!(damaged.iter().any(is_named), "{damaged:?}");
}

#[test]
fn the_page_takes_the_steps_of_the_commands_for_its_own_window_alone() {
    let folder = tempfile::tempdir().unwrap();
    let study = study(folder.path());
    let server = Server::start(&study);
    // Others: without the token, by another name for this machine, from another site.
    let (cookie, guess) = (server.cookie(), server.cookie().split('=').next().unwrap().to_owned() + "=guess");
    for (method, path, headers, status) in [
        ("GET", "/", &[][..], 401),
        ("GET", "/data", &[("cookie", guess.as_str())], 401),
        ("GET", "/?token=guess", &[], 401),
        ("GET", "/", &[("host", "tower.example")], 403),
        ("GET", "/data", &[("cookie", cookie), ("sec-fetch-site", "same-site")], 403),
        ("POST", "/run", &[("cookie", cookie), ("origin", "http://tower.example")], 403),
        ("POST", "/run", &[("cookie", cookie)], 403),
    ] {
        assert_eq!(server.ask_as(method, path, headers, "{}").status, status, "{method} {path} {headers:?}");
    }
    let page = server.get("/");
    assert!(
        page.body.contains("/assets/main.js")
            && page.header("content-security-policy").contains("script-src 'self' 'nonce-")
    );
    assert_eq!(server.get("/assets/../study.toml").status, 404);
    assert_eq!(server.get("/assets/main.js").status, 200);

    // The story: identify, compare, diagnose, add, and the error falls.
    assert_eq!(server.data()["modes"], Value::Null);
    let job = server.finish(&["identify", "--direct"]);
    assert_eq!(
        (&job["state"], job["command"].as_str().unwrap()),
        (&json!("done"), format!("belfry identify {study} --direct").as_str())
    );
    let before = server.data();
    assert_eq!(before["modes"]["modes"].as_array().unwrap().len(), 14);
    // It says how far it is, with counts.
    assert_eq!(server.post("/run", &json!({ "command": ["diagnose"] })).status, 202);
    let mut stages: Vec<(String, u64, u64)> = Vec::new();
    let job = server.job_until(|job| {
        let count = |key: &str| job[key].as_u64().unwrap();
        stages.extend(job["stage"].as_str().map(|stage| (stage.to_owned(), count("done"), count("total"))));
        job["state"] != "running"
    });
    assert_eq!(job["state"], "done", "{job}");
    assert!(stages.iter().all(|(_, done, total)| done <= total && *total > 0), "{stages:?}");
    let places = stages.iter().filter(|(stage, ..)| stage == "effects at every place");
    assert!(places.count() > 1, "{stages:?}");
    let lacks = sentences(&server.data(), "finding").remove(0);
    assert!(lacks.starts_with("The model lacks base-rotation"), "{lacks}");
    server.finish(&["add", "base-rotation"]);
    let after = server.data();
    let error = |part: &Value| part["mean_abs_frequency_error_percent"].as_f64().unwrap();
    assert!(error(&after["comparison"]["effects"]) < 0.5 * error(&before["comparison"]["given"]));
    assert!(after["version"].as_u64() > before["version"].as_u64());

    // A slider asks what another value would do; nothing is written.
    let toml = || fs::read_to_string(Path::new(&study).join("study.toml")).unwrap();
    let text = toml();
    let first_hz = |value: &str| {
        let answer = server.get(&format!("/try?effect=base-rotation%3D{value}"));
        assert_eq!(answer.status, 200, "{}", answer.body);
        answer.json()["model"]["modes"][0]["frequency_hz"].as_f64().unwrap()
    };
    assert!(first_hz("1e-13") < 0.9 * first_hz("1e-15"));
    // It looks for the lowest modes alone; they equal the lowest of all modes.
    let mut project = Project::open(Path::new(&study)).unwrap();
    for value in ["1.2e-15", "1.2e-14", "1.2e-13"] {
        let tried = server.get(&format!("/try?effect=base-rotation%3D{value}")).json();
        let effect = format!("base-rotation={value}").parse().unwrap();
        let whole = project.case().unwrap().compare_with(&[effect]).unwrap();
        let pairs = tried["comparison"]["pairs"].as_array().unwrap();
        assert_eq!(pairs.len(), whole.pairs.len(), "{value}");
        for (pair, whole) in pairs.iter().zip(&whole.pairs) {
            assert_eq!(pair["model"], whole.model, "{value}");
            let (hz, mac) = (pair["model_hz"].as_f64().unwrap(), pair["mac"].as_f64().unwrap());
            assert!((hz / whole.model_hz - 1.0).abs() < 1e-6, "{value}: {hz} Hz and {} Hz", whole.model_hz);
            assert!((mac - whole.mac.unwrap()).abs() < 1e-6, "{value}: MAC {mac} and {:?}", whole.mac);
        }
    }
    assert_eq!(server.get("/try?effect=base-rotation%3Dmuch").status, 400);
    assert_eq!(toml(), text);

    // A second of a channel, from a recording of an hour.
    let piece = server.get("/samples?setup=january&channel=09&from_s=100&to_s=101&bins=500").json();
    assert_eq!(piece["time_s"].as_array().unwrap().len(), 51, "{piece}");
    assert_eq!(server.get("/samples?setup=january&channel=99&from_s=0&to_s=1").status, 409);

    // Another window, a terminal: all see the same.
    run(&["remove", &study, "base-rotation"]);
    server.wait_for("the effect is gone", |data| data["model"]["effects"].as_array().is_some_and(Vec::is_empty));

    // A choice of modes stands in study.toml, with what else stands there.
    assert_eq!(server.post("/picks", &json!({ "add_hz": [0.66], "drop_hz": [1.4278] })).status, 204);
    let chosen = toml();
    assert!(chosen.contains("add_modes_hz = [0.66]") && chosen.contains("drop_modes_hz = [1.4278]"), "{chosen}");
    // Every window sees at once what modes were not identified with yet.
    let number = |hz: f64| {
        let modes = before["modes"]["modes"].as_array().unwrap().iter();
        let near = modes.filter(|mode| (mode["frequency_hz"].as_f64().unwrap() / hz - 1.0).abs() < 0.005);
        near.map(|mode| mode["number"].clone()).next().unwrap()
    };
    let picks = || server.data()["picks"].clone();
    assert_eq!(picks(), json!({ "added_hz": [0.66], "dropped": [number(1.4278)], "bands": [] }));
    let comments =
        |text: &str| text.lines().filter(|line| line.starts_with('#')).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(comments(&chosen), comments(&text));
    assert_eq!(server.post("/picks", &json!({ "add_hz": [-1.0] })).status, 409);
    let band = |band: Value| server.post("/picks", &json!({ "bands": [{ "hz": 1.4278, "band_hz": band }] }));
    assert_eq!(band(json!([1.3, 1.4])).status, 409, "it is no band of that mode");
    assert_eq!(band(json!([1.38, 1.47])).status, 204);
    assert!(toml().contains("mode_bands_hz = [[1.38, 1.47]]"), "{}", toml());
    assert_eq!(picks()["bands"], json!([{ "mode": number(1.4278), "band_hz": [1.38, 1.47] }]));
    assert_eq!(band(Value::Null).status, 204);
    assert_eq!(toml(), chosen);
    // The other way round takes both back.
    assert_eq!(server.post("/picks", &json!({ "add_hz": [1.4279], "drop_hz": [0.6601] })).status, 204);
    assert!(!toml().contains("_modes_hz ="), "{}", toml());
    assert_eq!(picks(), json!({ "added_hz": [], "dropped": [], "bands": [] }));

    // What the page may not ask, two at once, and one that is stopped.
    for words in [&["init", "elsewhere"][..], &["add", "--json"], &["report", "--output", "/tmp/x"], &[]] {
        assert_eq!(server.post("/run", &json!({ "command": words })).status, 400, "{words:?}");
    }
    let modes = fs::read(Path::new(&study).join("results/modes.json")).unwrap();
    assert_eq!(server.post("/run", &json!({ "command": ["identify"] })).status, 202);
    assert_eq!(server.post("/run", &json!({ "command": ["compare"] })).status, 409);
    assert_eq!(server.post("/cancel", &json!({})).status, 204);
    assert_eq!(server.job_ended()["state"], "cancelled");
    assert_eq!(fs::read(Path::new(&study).join("results/modes.json")).unwrap(), modes);
    // In the middle of a computation as well.
    let diagnosis = fs::read(Path::new(&study).join("results/diagnosis.json")).unwrap();
    assert_eq!(server.post("/run", &json!({ "command": ["diagnose"] })).status, 202);
    server.job_until(|job| job["state"] == "running" && job["total"].as_u64() > Some(0));
    assert_eq!(server.post("/cancel", &json!({})).status, 204);
    assert_eq!(server.job_ended()["state"], "cancelled");
    assert_eq!(fs::read(Path::new(&study).join("results/diagnosis.json")).unwrap(), diagnosis);
    // What fails says why.
    let failed = server.finish_with(&["add", "no-such-effect"]);
    assert_eq!(failed["state"], "failed");
    assert!(failed["output"].as_str().unwrap().contains("no-such-effect"), "{failed}");
}
