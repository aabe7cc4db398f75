//! `[alarms]` of study.toml: who hears of a watch's alarms besides the files in `results`.

use std::net::IpAddr;
use std::path::PathBuf;

use lettre::message::Mailbox;
use url::Url;

use super::error::StudyError;
use super::section::{Entry, Section};

/// `[alarms]`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Alarms {
    /// `[alarms.email]`.
    pub email: Option<Email>,
    /// `[alarms.mqtt]`.
    pub mqtt: Option<Mqtt>,
}

/// `[alarms.email]`: a server that takes mail, and whom it goes to.
#[derive(Debug, Clone, PartialEq)]
pub struct Email {
    /// The server.
    pub server: Server,
    /// The sender's address.
    pub from: String,
    /// Addresses, at least one.
    pub to: Vec<String>,
}

/// `[alarms.mqtt]`: a broker, and the topic.
#[derive(Debug, Clone, PartialEq)]
pub struct Mqtt {
    /// The broker.
    pub server: Server,
    /// The topic that events are published to.
    pub topic: String,
}

/// A server, and how it lets Belfry in.
#[derive(Debug, Clone, PartialEq)]
pub struct Server {
    /// Its name or address.
    pub host: String,
    /// Its port.
    pub port: u16,
    /// How the connection is encrypted.
    pub encryption: Encryption,
    /// Name and password, where it asks for them.
    pub login: Option<Login>,
    /// A file of certificates (PEM) to trust beside the system's, relative to the study's folder.
    pub trust: Option<PathBuf>,
}

/// How a connection is encrypted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encryption {
    /// Not at all.
    Plain,
    /// From the first byte.
    Tls,
    /// From SMTP's STARTTLS on, without which nothing is sent.
    StartTls,
}

/// Name and password.
#[derive(Debug, Clone, PartialEq)]
pub struct Login {
    /// The name.
    pub user: String,
    /// The file with the password on its first line, relative to the study's folder.
    pub password_file: PathBuf,
}

impl Alarms {
    /// Files with passwords, relative to the study's folder.
    pub fn secrets(&self) -> impl Iterator<Item = &PathBuf> {
        let servers = self.email.iter().map(|email| &email.server).chain(self.mqtt.iter().map(|mqtt| &mqtt.server));
        servers.filter_map(|server| server.login.as_ref()).map(|login| &login.password_file)
    }
}

const KEYS: &[&str] = &["email", "mqtt"];
const EMAIL_KEYS: &[&str] = &["server", "user", "password_file", "trust", "from", "to"];
const MQTT_KEYS: &[&str] = &["server", "user", "password_file", "trust", "topic"];
/// Ports of mail: encrypted from the first byte, to hand mail in, and between servers.
const SUBMISSIONS: u16 = 465;
const SUBMISSION: u16 = 587;
const SMTP: u16 = 25;
const MQTTS: u16 = 8883;
const MQTT: u16 = 1883;
/// The longest topic in bytes (MQTT 3.1.1, 1.5.3).
const LONGEST_TOPIC: usize = 65_535;

/// Reads and checks `[alarms]`.
pub(super) fn alarms(section: &Section<'_>) -> Result<Alarms, StudyError> {
    section.allow_only(KEYS)?;
    let below = |key: &str, expected| section.get(key).map(|entry| entry.section(expected)).transpose();
    Ok(Alarms {
        email: below("email", "a section, written [alarms.email]")?.map(|section| email(&section)).transpose()?,
        mqtt: below("mqtt", "a section, written [alarms.mqtt]")?.map(|section| mqtt(&section)).transpose()?,
    })
}

fn email(section: &Section<'_>) -> Result<Email, StudyError> {
    const SERVER: &str =
        "\"smtps://HOST\" (encrypted from the start) or \"smtp://HOST\" (STARTTLS; plain on this computer)";
    const FROM: &str = "the sender's address, in quotes, such as \"belfry@example.org\"";
    const TO: &str = "a list of addresses, such as [\"me@example.org\"]";
    section.allow_only(EMAIL_KEYS)?;
    let of = |url: &Url, host: &str| match url.scheme() {
        "smtps" => Some((Encryption::Tls, SUBMISSIONS)),
        "smtp" if is_this_computer(host) => Some((Encryption::Plain, SMTP)),
        "smtp" => Some((Encryption::StartTls, SUBMISSION)),
        _ => None,
    };
    let server = server(section, SERVER, of)?;
    let from = address(&section.required("from", FROM)?, FROM)?;
    let entry = section.required("to", TO)?;
    let to = entry.list(TO)?.iter().map(|one| address(one, TO)).collect::<Result<Vec<_>, _>>()?;
    if to.is_empty() {
        return Err(entry.out_of_range(TO));
    }
    Ok(Email { server, from, to })
}

fn mqtt(section: &Section<'_>) -> Result<Mqtt, StudyError> {
    const SERVER: &str = "\"mqtts://HOST\" (encrypted) or \"mqtt://HOST\"";
    const TOPIC: &str = "a topic without + and #, in quotes, such as \"towers/alarms\"";
    section.allow_only(MQTT_KEYS)?;
    let of = |url: &Url, _: &str| match url.scheme() {
        "mqtts" => Some((Encryption::Tls, MQTTS)),
        "mqtt" => Some((Encryption::Plain, MQTT)),
        _ => None,
    };
    let server = server(section, SERVER, of)?;
    let entry = section.required("topic", TOPIC)?;
    let topic = entry.text(TOPIC)?;
    if topic.contains(['+', '#', '\0']) || topic.len() > LONGEST_TOPIC {
        return Err(entry.out_of_range(TOPIC));
    }
    Ok(Mqtt { server, topic })
}

/// The server of a section; `of` says what a scheme means.
fn server(
    section: &Section<'_>,
    expected: &'static str,
    of: impl Fn(&Url, &str) -> Option<(Encryption, u16)>,
) -> Result<Server, StudyError> {
    const USER: &str = "the name that the server knows, in quotes";
    const PASSWORD: &str = "the name of a file with the password, in quotes, such as \"mail.password\"";
    const TRUST: &str = "the name of a file of certificates (PEM), in quotes, such as \"ca.pem\"";
    let entry = section.required("server", expected)?;
    let url = Url::parse(&entry.text(expected)?).map_err(|_| entry.out_of_range(expected))?;
    // A password here would go wherever the study goes.
    let is_bare = url.username().is_empty()
        && url.password().is_none()
        && matches!(url.path(), "" | "/")
        && url.query().is_none();
    let host = url.host_str().filter(|host| !host.is_empty() && is_bare);
    let host = host.map(|host| host.trim_start_matches('[').trim_end_matches(']').to_owned());
    let found = host.and_then(|host| of(&url, &host).map(|(encryption, port)| (host, encryption, port)));
    let (host, encryption, port) = found.ok_or_else(|| entry.out_of_range(expected))?;
    let login = match (section.get("user"), section.get("password_file")) {
        (None, None) => None,
        (Some(user), Some(file)) => {
            Some(Login { user: user.text(USER)?, password_file: PathBuf::from(file.text(PASSWORD)?) })
        }
        (Some(_), None) => return Err(section.missing("password_file", PASSWORD)),
        (None, Some(_)) => return Err(section.missing("user", USER)),
    };
    let trust = section.get("trust").map(|entry| entry.text(TRUST)).transpose()?.map(PathBuf::from);
    Ok(Server { host, port: url.port().unwrap_or(port), encryption, login, trust })
}

fn is_this_computer(host: &str) -> bool {
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|address| address.is_loopback())
}

fn address(entry: &Entry<'_>, expected: &'static str) -> Result<String, StudyError> {
    let text = entry.text(expected)?;
    if text.parse::<Mailbox>().is_ok() { Ok(text) } else { Err(entry.out_of_range(expected)) }
}
