//! A user leaves Belfry alone with a structure, and wants to hear of it when something has changed, and not before.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use assert_cmd::prelude::*;
use belfry_tests::belfry_command;
use belfry_tests::post::{Begins, Certificate, Post};
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;
use serde_json::{Value, json};

use crate::said;

fn read(file: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(file).unwrap()).unwrap()
}

/// An hour of the template's tower, with its modes.
fn measured(folder: &Path) -> String {
    let place = folder.join("tower").to_str().unwrap().to_owned();
    belfry_command().args(["init", &place, "--template", "canton"]).assert().success();
    let study = Path::new(&place).join("study.toml");
    let text = fs::read_to_string(&study).unwrap();
    fs::write(&study, text.replace("sampling_rate_hz = 50.0", "sampling_rate_hz = 12.5")).unwrap();
    belfry_command().args(["simulate", &place, "--hours", "3", "--seed", "9", "--adopt"]).assert().success();
    belfry_command().args(["identify", &place, "--direct"]).assert().success();
    place
}

/// A mode that intervals show: its number, its frequency in Hz, and how much lower that is after the change, as a share.
type Mode = (usize, f64, f64);

/// What intervals of three hours would have shown of modes for so many days of mild weather; from a day on they are lower.
fn days(count: usize, change: usize, modes: &[Mode]) -> String {
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    // The sum of twelve uniform numbers is nearly normal.
    let mut normal = || {
        let mut sum = -6.0;
        for _ in 0..12 {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            sum += (state >> 11) as f64 / (1u64 << 53) as f64;
        }
        sum
    };
    let mut lines = String::new();
    for step in 0..8 * count {
        let day = step as f64 / 8.0;
        let turn = std::f64::consts::TAU;
        let degc = 15.0 + 4.0 * (turn * day / 11.0).sin() + 3.0 * (turn * day).sin() + 0.5 * normal();
        let mode = |&(number, hz, loss): &Mode| {
            let lost = if day >= change as f64 { loss } else { 0.0 };
            let frequency_hz = hz * (1.0 - 4e-4 * (degc - 15.0) - lost + 3e-4 * normal());
            json!({"number": number, "frequency_hz": frequency_hz, "frequency_std_hz": 3e-4 * hz, "response_rms": 1e-3})
        };
        let modes: Vec<Value> = modes.iter().map(mode).collect();
        let (start_s, end_s) = (86_400.0 * day, 86_400.0 * (day + 0.125));
        writeln!(lines, "{}", json!({"start_s": start_s, "end_s": end_s, "temperature_degc": degc, "modes": modes}))
            .unwrap();
    }
    lines
}

/// Two modes of the tower that are lower by a share.
fn two(loss: f64) -> [Mode; 2] {
    [(1, 0.105, loss), (2, 0.155, loss)]
}

#[test]
fn a_change_is_told_once_with_its_date_and_size_and_weather_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let study = measured(folder.path());
    let results = Path::new(&study).join("results");
    // Of three hours nothing can be said but what was seen.
    let first = said::json(&["watch", &study, "--once", "--every", "1h", "--direct"]);
    assert_eq!((&first["judgement"]["standing"], &first["new_intervals"]), (&json!("learning"), &json!(3)));
    assert!(first["modes"].as_array().unwrap().len() >= 10);
    let seen = fs::read_to_string(results.join("watch.jsonl")).unwrap();
    assert_eq!(seen.lines().count(), 3);
    // Other intervals would not go with these.
    let other = belfry_command().args(["watch", &study, "--once", "--every", "30min", "--direct"]).assert().failure();
    other.stderr(contains("the watch has intervals of 3600 s until now, not of 1800 s"));
    // As if it had run for sixty days.
    fs::remove_file(results.join("watch.json")).unwrap();
    let watch = || said::json(&["watch", &study, "--once", "--every", "3h", "--direct"]);
    fs::write(results.join("watch.jsonl"), days(60, 1000, &two(0.0))).unwrap();
    let sound = watch();
    assert_eq!((&sound["judgement"]["standing"], &sound["judgement"]["alarms"]), (&json!("unchanged"), &json!([])));
    assert!(!results.join("alarms.jsonl").exists());
    fs::remove_file(results.join("watch.json")).unwrap();
    fs::write(results.join("watch.jsonl"), days(50, 45, &two(4e-3))).unwrap();
    let heard = folder.path().join("heard.json");
    let hook = format!("tee {}", heard.display());
    let told = belfry_command()
        .args(["watch", &study, "--once", "--every", "3h", "--direct", "--on-alarm", &hook])
        .assert()
        .success();
    told.stdout(contains("ALARM: ")).stdout(contains("Changed: 50 days judged"));
    let event = read(&heard);
    let alarm = &event["alarm"];
    assert_eq!((&event["event"], &alarm["state"]), (&json!("raised"), &json!("open")));
    let day = |value: &Value| value.as_f64().unwrap() / 86_400.0;
    assert!(day(&alarm["between_s"][0]) < 45.6 && day(&alarm["between_s"][1]) > 44.4, "{alarm}");
    // Of the others nothing was seen in all these days, so nothing is said.
    assert_eq!(alarm["modes"].as_array().unwrap().len(), 2);
    for mode in alarm["modes"].as_array().unwrap() {
        let [percent, std] = ["percent", "std_percent"].map(|key| mode[key].as_f64().unwrap());
        assert!((percent + 0.4).abs() < 4.0 * std + 0.02, "{mode}");
    }
    assert!(fs::read_to_string(results.join("watch.svg")).unwrap().contains("mode 1: frequency"));
    // What was told is not told again, and a line that is damaged is named and costs no other.
    let more = days(50, 45, &two(4e-3)) + "{\"start_s\": 4\n";
    fs::write(results.join("watch.jsonl"), more).unwrap();
    let again = watch();
    assert_eq!(again["events"], json!([]));
    assert!(
        again["warnings"][0].as_str().unwrap().contains("watch.jsonl, line 401: left out"),
        "{}",
        again["warnings"]
    );
    assert_eq!(fs::read_to_string(results.join("alarms.jsonl")).unwrap().lines().count(), 1);
}

/// Adds `[alarms]` to a study.
fn tells(study: &str, alarms: &str) {
    let file = Path::new(study).join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    fs::write(&file, format!("{text}\n{alarms}")).unwrap();
}

#[test]
fn an_alarm_goes_by_mail_and_mqtt_once_each_when_their_servers_are_back() {
    let folder = tempfile::tempdir().unwrap();
    let study = measured(folder.path());
    let certificate = Certificate::make(Path::new(&study)).unwrap();
    let mail = Post::mail(Begins::Tls(&certificate)).unwrap();
    let broker = Post::broker(Begins::Tls(&certificate)).unwrap();
    let login = "user = \"tower\"\npassword_file = \"word\"\ntrust = \"server.pem\"";
    tells(
        &study,
        &format!(
            "[alarms.email]\nserver = \"smtps://localhost:{}\"\n{login}\nfrom = \"Belfry <belfry@example.org>\"\nto = [\"me@example.org\", \"closed@example.org\", \"you@example.org\"]\n\
             [alarms.mqtt]\nserver = \"mqtts://127.0.0.1:{}\"\n{login}\ntopic = \"towers/alarms\"\n",
            mail.port, broker.port
        ),
    );
    fs::write(Path::new(&study).join("word"), "secret\n").unwrap();
    let results = Path::new(&study).join("results");
    fs::write(results.join("watch.jsonl"), days(50, 45, &two(4e-3))).unwrap();
    let watch = || {
        let mut command = belfry_command();
        command.args(["watch", &study, "--once", "--every", "3h", "--direct"]);
        command.assert()
    };
    // The one that fails holds up no other.
    mail.refuse(1);
    watch()
        .failure()
        .stderr(contains("e-mail by localhost").and(contains("come back later")))
        .stderr(contains("the next watch tries again"));
    assert_eq!((mail.given(), broker.given().len()), (vec![], 1));
    // A mailbox that is closed keeps nobody else from it, and is not tried again.
    watch().success().stderr(contains("no such mailbox").and(contains("the others have it")));
    // What was told is not told again.
    watch().success().stderr(contains("mailbox").not());
    let [message] = &broker.given()[..] else { panic!("{:?}", broker.given()) };
    let [letter, other] = &mail.given()[..] else { panic!("{:?}", mail.given()) };
    let known = Some(("tower".to_owned(), "secret".to_owned()));
    assert_eq!((&message.login, &letter.login), (&known, &known));
    assert_eq!(
        (&message.to[..], &letter.to[..]),
        (&["towers/alarms".to_owned()][..], &["me@example.org".to_owned()][..])
    );
    assert_eq!(other.to, ["you@example.org"]);
    let mut line: Value =
        serde_json::from_str(fs::read_to_string(results.join("alarms.jsonl")).unwrap().trim()).unwrap();
    line.as_object_mut().unwrap().remove("schema");
    assert_eq!(serde_json::from_str::<Value>(&message.content).unwrap(), line);
    let subject = letter.content.lines().find(|line| line.starts_with("Subject: ")).unwrap();
    assert!(subject.contains("ALARM: ") && letter.content.contains("Message-ID: <belfry-"), "{}", letter.content);
    assert!(letter.content.contains("event.json"), "{}", letter.content);
    // A certificate that nobody vouches for is not trusted, and a watch that cannot tell says so.
    let text = fs::read_to_string(Path::new(&study).join("study.toml")).unwrap();
    fs::write(Path::new(&study).join("study.toml"), text.replace("trust = \"server.pem\"\n", "")).unwrap();
    fs::remove_file(results.join("watch.json")).unwrap();
    let distrusted = watch().failure();
    distrusted.stderr(contains("e-mail by").and(contains("MQTT by")).and(contains("ertificate")));
    assert_eq!((mail.given().len(), broker.given().len()), (2, 1));
    // Mail for another computer is encrypted, or not sent; this is an address that is not this one's own, though it leads here.
    let (plain, encrypts) = (Post::mail(Begins::Plain).unwrap(), Post::mail(Begins::StartTls(&certificate)).unwrap());
    let by = |port: u16| {
        let own = format!("smtps://localhost:{}", mail.port);
        fs::write(Path::new(&study).join("study.toml"), text.replace(&own, &format!("smtp://0.0.0.0:{port}"))).unwrap();
        watch()
    };
    by(plain.port).failure().stderr(contains("e-mail by 0.0.0.0"));
    by(encrypts.port).success();
    assert_eq!((plain.given().len(), encrypts.given().len(), broker.given().len()), (0, 2, 2));
    assert_eq!(encrypts.given()[0].login, known);
}

#[test]
fn settings_of_alarms_that_cannot_be_meant_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("tower").to_str().unwrap().to_owned();
    belfry_command().args(["init", &place, "--template", "canton"]).assert().success();
    let file = Path::new(&place).join("study.toml");
    let text = fs::read_to_string(&file).unwrap();
    for (bad, said) in [
        ("[alarms.email]\nserver = \"mail.example.org\"", "alarms.email.server"),
        ("[alarms.email]\nserver = \"smtp://me:word@mail.example.org\"", "alarms.email.server"),
        (
            "[alarms.email]\nserver = \"smtps://mail\"\nfrom = \"nobody\"\nto = [\"me@example.org\"]",
            "alarms.email.from",
        ),
        ("[alarms.email]\nserver = \"smtps://mail\"\nfrom = \"a@b.org\"\nto = []", "alarms.email.to"),
        ("[alarms.mqtt]\nserver = \"mqtts://hub\"\ntopic = \"towers/#\"", "alarms.mqtt.topic"),
        ("[alarms.mqtt]\nserver = \"mqtts://hub\"\ntopic = \"towers\"\nuser = \"me\"", "password_file"),
        ("[alarms.pigeon]\ncolour = 1", "pigeon"),
    ] {
        fs::write(&file, format!("{text}\n{bad}\n")).unwrap();
        belfry_command().args(["look", &place]).assert().failure().stderr(contains("study.toml").and(contains(said)));
    }
}

/// A tower's foundation gives way by as much as lowers its first frequency by a hundredth; the days have all its modes, each lower by as much as
/// simulated towers with and without are apart.
#[test]
fn an_alarm_says_what_has_come() {
    let folder = tempfile::tempdir().unwrap();
    let study = measured(folder.path());
    let results = Path::new(&study).join("results");
    let frequencies = |effect: &[&str]| -> Vec<f64> {
        let place = folder.path().join(format!("truth{}", effect.len())).to_str().unwrap().to_owned();
        belfry_command().args(["init", &place, "--template", "canton"]).assert().success();
        let words = [&["simulate", &place, "--hours", "0.05", "--seed", "9"], effect].concat();
        belfry_command().args(words).assert().success();
        let truth = read(&Path::new(&place).join("truth.json"));
        truth["modes"].as_array().unwrap().iter().map(|mode| mode["frequency_hz"].as_f64().unwrap()).collect()
    };
    let (sound, soft) = (frequencies(&[]), frequencies(&["--effect", "base-rotation=2e-15"]));
    let modes = read(&results.join("modes.json"));
    let modes = modes["modes"].as_array().unwrap().iter().map(|mode| {
        let hz = mode["frequency_hz"].as_f64().unwrap();
        let apart = |at: &usize| (sound[*at] / hz).ln().abs();
        let at = (0..sound.len()).min_by(|a, b| apart(a).total_cmp(&apart(b))).unwrap();
        (mode["number"].as_u64().unwrap() as usize, hz, 1.0 - soft[at] / sound[at])
    });
    let modes: Vec<Mode> = modes.collect();
    assert!(modes.len() >= 10 && modes[0].2 > 5e-3, "{modes:?}");
    fs::write(results.join("watch.jsonl"), days(50, 42, &modes)).unwrap();
    let watched = said::json(&["watch", &study, "--once", "--every", "3h", "--direct"]);
    let cause = &watched["events"][0]["cause"];
    // Frequencies hardly tell a foundation that turns from a joint just above it.
    let named: Vec<&str> = cause["named"].as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect();
    assert_eq!(named[0], "base-rotation", "{cause}");
    assert!(named[1..].iter().all(|name| name.starts_with("connection-flexibility@-")), "{cause}");
    assert_eq!((&cause["direction"], &watched["causes"][0]), (&json!("come"), cause));
    let [value, std] = ["value", "std"].map(|key| cause["effects"][0]["parameters"][0][key].as_f64().unwrap());
    assert!((value - 2e-15).abs() < 3.0 * std && std < 0.3e-15, "{value} +- {std}");
    // Whoever asks again is told again.
    let again = belfry_command().args(["watch", &study, "--once", "--every", "3h", "--direct"]).assert().success();
    again.stdout(contains("(open): ")).stdout(contains("base-rotation ("));
}

#[test]
fn a_watch_says_what_it_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("tower").to_str().unwrap().to_owned();
    belfry_command().args(["init", &place, "--template", "canton"]).assert().success();
    let nothing = belfry_command().args(["watch", &place, "--once"]).assert().failure();
    nothing.stderr(contains("has no modes to watch; run `belfry identify` first"));
    let quotes = belfry_command().args(["watch", &place, "--once", "--on-alarm", "mail 'tower"]).assert().failure();
    quotes.stderr(contains("are its quotes closed?"));
}
