//! A mail server and an MQTT broker that speak just enough of their protocols for one client, and keep what they are given; plain, or encrypted by a
//! certificate that openssl makes for the occasion.

use std::error::Error;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::{ServerConfig, ServerConnection, StreamOwned};

/// A certificate of `localhost`, 127.0.0.1 and 0.0.0.0 that vouches for itself, and its key, as files.
#[derive(Debug)]
pub struct Certificate {
    /// The certificate, PEM.
    pub certificate: PathBuf,
    /// Its key, PEM.
    pub key: PathBuf,
}

impl Certificate {
    /// Has openssl make one in a folder.
    ///
    /// # Errors
    /// When openssl is not there, or fails.
    pub fn make(folder: &Path) -> io::Result<Self> {
        let (certificate, key) = (folder.join("server.pem"), folder.join("server.key"));
        let words = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=localhost \
             -addext subjectAltName=DNS:localhost,IP:127.0.0.1,IP:0.0.0.0 -addext basicConstraints=critical,CA:FALSE -keyout";
        let mut command = Command::new("openssl");
        command.args(words.split_whitespace()).arg(&key).arg("-out").arg(&certificate);
        let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status()?;
        if status.success() { Ok(Self { certificate, key }) } else { Err(io::Error::other("openssl req fails")) }
    }

    fn server(&self) -> Result<Arc<ServerConfig>, Box<dyn Error>> {
        let chain = CertificateDer::pem_file_iter(&self.certificate)?.collect::<Result<Vec<_>, _>>()?;
        let key = PrivateKeyDer::from_pem_file(&self.key)?;
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let builder = ServerConfig::builder_with_provider(provider).with_safe_default_protocol_versions()?;
        Ok(Arc::new(builder.with_no_client_auth().with_single_cert(chain, key)?))
    }
}

/// How a server begins.
#[derive(Debug, Clone, Copy)]
pub enum Begins<'a> {
    /// Plain, and so it stays.
    Plain,
    /// Encrypted from the first byte.
    Tls(&'a Certificate),
    /// Plain until the client says STARTTLS.
    StartTls(&'a Certificate),
}

/// What a server was given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Given {
    /// Who gave it: a name and a password, where they were said.
    pub login: Option<(String, String)>,
    /// Whom it is for: the recipients of a mail, the topic of a message.
    pub to: Vec<String>,
    /// Its content.
    pub content: String,
}

/// A server on a port of this computer; its threads end with the tests.
#[derive(Debug)]
pub struct Post {
    /// The port.
    pub port: u16,
    given: Arc<Mutex<Vec<Given>>>,
    refuses: Arc<AtomicUsize>,
}

trait Stream: Read + Write {}
impl<T: Read + Write> Stream for T {}

/// How a conversation goes on.
enum Next {
    Ends,
    Encrypts,
}

type Talk = fn(&mut dyn Stream, &Desk, Stage) -> io::Result<Next>;

/// Where a conversation is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// At its beginning.
    Whole,
    /// Before the client has asked for encryption.
    Before,
    /// After that.
    After,
}

/// What all conversations with a server share.
struct Desk {
    given: Arc<Mutex<Vec<Given>>>,
    refuses: Arc<AtomicUsize>,
}

impl Desk {
    /// Whether the next is refused.
    fn refuses(&self) -> bool {
        self.refuses.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).is_ok()
    }

    fn take(&self, given: Given) {
        self.given.lock().unwrap_or_else(PoisonError::into_inner).push(given);
    }
}

impl Post {
    /// A mail server.
    ///
    /// # Errors
    /// When there is no port, or the certificate cannot be used.
    pub fn mail(begins: Begins<'_>) -> Result<Self, Box<dyn Error>> {
        Self::start(begins, mail)
    }

    /// A broker.
    ///
    /// # Errors
    /// As [`Post::mail`].
    pub fn broker(begins: Begins<'_>) -> Result<Self, Box<dyn Error>> {
        Self::start(begins, broker)
    }

    fn start(begins: Begins<'_>, talk: Talk) -> Result<Self, Box<dyn Error>> {
        let (config, is_late) = match begins {
            Begins::Plain => (None, false),
            Begins::Tls(certificate) => (Some(certificate.server()?), false),
            Begins::StartTls(certificate) => (Some(certificate.server()?), true),
        };
        let listener = TcpListener::bind("127.0.0.1:0")?;
        let port = listener.local_addr()?.port();
        let (given, refuses) = (Arc::<Mutex<Vec<Given>>>::default(), Arc::<AtomicUsize>::default());
        let desk = Desk { given: Arc::clone(&given), refuses: Arc::clone(&refuses) };
        thread::spawn(move || {
            for mut stream in listener.incoming().flatten() {
                // A client that breaks off is the client's affair.
                let _ = converse(&mut stream, config.as_ref(), is_late, talk, &desk);
            }
        });
        Ok(Self { port, given, refuses })
    }

    /// Has the next ones refused.
    pub fn refuse(&self, count: usize) {
        self.refuses.store(count, Ordering::Relaxed);
    }

    /// How many are still to be refused.
    pub fn still_refuses(&self) -> usize {
        self.refuses.load(Ordering::Relaxed)
    }

    /// What it was given so far.
    pub fn given(&self) -> Vec<Given> {
        self.given.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn converse(
    stream: &mut TcpStream,
    config: Option<&Arc<ServerConfig>>,
    is_late: bool,
    talk: Talk,
    desk: &Desk,
) -> io::Result<()> {
    let Some(config) = config else { return talk(stream, desk, Stage::Whole).map(drop) };
    if is_late && matches!(talk(stream, desk, Stage::Before)?, Next::Ends) {
        return Ok(());
    }
    let connection = ServerConnection::new(Arc::clone(config)).map_err(io::Error::other)?;
    let mut stream = StreamOwned::new(connection, stream.try_clone()?);
    talk(&mut stream, desk, if is_late { Stage::After } else { Stage::Whole }).map(drop)
}

/// A line without its end, read byte by byte: what follows may be encrypted.
fn line(stream: &mut dyn Stream) -> io::Result<String> {
    let mut line = Vec::new();
    loop {
        let mut byte = [0];
        stream.read_exact(&mut byte)?;
        if byte == *b"\n" {
            break;
        }
        line.push(byte[0]);
    }
    Ok(String::from_utf8_lossy(&line).trim_end_matches('\r').to_owned())
}

/// SMTP (RFC 5321) with AUTH PLAIN (RFC 4616).
fn mail(stream: &mut dyn Stream, desk: &Desk, stage: Stage) -> io::Result<Next> {
    let (mut login, mut to) = (None, Vec::new());
    let encrypts = stage == Stage::Before;
    if stage != Stage::After {
        stream.write_all(b"220 localhost\r\n")?;
    }
    loop {
        stream.flush()?;
        let said = line(stream)?;
        let word = said.split(' ').next().unwrap_or_default().to_ascii_uppercase();
        let answer = match word.as_str() {
            "EHLO" if encrypts => "250-localhost\r\n250 STARTTLS".to_owned(),
            "EHLO" => "250-localhost\r\n250-8BITMIME\r\n250 AUTH PLAIN".to_owned(),
            "STARTTLS" if encrypts => {
                stream.write_all(b"220 go on\r\n")?;
                return Ok(Next::Encrypts);
            }
            _ if encrypts && word != "QUIT" => "530 STARTTLS first".to_owned(),
            "AUTH" => {
                let said = said.rsplit(' ').next().and_then(|coded| STANDARD.decode(coded).ok()).unwrap_or_default();
                let said = String::from_utf8_lossy(&said).into_owned();
                let parts: Vec<&str> = said.split('\0').collect();
                login = parts.get(1).zip(parts.get(2)).map(|(name, word)| ((*name).to_owned(), (*word).to_owned()));
                "235 welcome".to_owned()
            }
            "RCPT" if said.contains("<closed@") => "550 no such mailbox".to_owned(),
            "RCPT" => {
                to.extend(said.split_once('<').and_then(|(_, rest)| Some(rest.split_once('>')?.0.to_owned())));
                "250 yes".to_owned()
            }
            "DATA" if desk.refuses() => "451 come back later".to_owned(),
            "DATA" => {
                stream.write_all(b"354 go on\r\n")?;
                let mut content = String::new();
                loop {
                    let next = line(stream)?;
                    if next == "." {
                        break;
                    }
                    content += next.strip_prefix('.').unwrap_or(&next);
                    content.push('\n');
                }
                desk.take(Given { login: login.clone(), to: std::mem::take(&mut to), content });
                "250 kept".to_owned()
            }
            "QUIT" => {
                stream.write_all(b"221 bye\r\n")?;
                return Ok(Next::Ends);
            }
            _ => "250 yes".to_owned(),
        };
        stream.write_all(format!("{answer}\r\n").as_bytes())?;
    }
}

/// MQTT 3.1.1: connections and messages of quality 1.
fn broker(stream: &mut dyn Stream, desk: &Desk, _stage: Stage) -> io::Result<Next> {
    let mut login = None;
    loop {
        let mut kind = [0];
        stream.read_exact(&mut kind)?;
        let (mut length, mut shift) = (0_usize, 0);
        loop {
            let mut byte = [0];
            stream.read_exact(&mut byte)?;
            length |= usize::from(byte[0] & 127) << shift;
            shift += 7;
            if byte[0] & 128 == 0 || shift > 21 {
                break;
            }
        }
        let mut packet = vec![0; length];
        stream.read_exact(&mut packet)?;
        let mut rest = packet.as_slice();
        match kind[0] >> 4 {
            1 => {
                let _protocol = text(&mut rest)?;
                let (flags, after) = (*rest.get(1).ok_or(ErrorKind::InvalidData)?, rest.get(4..));
                rest = after.ok_or(ErrorKind::InvalidData)?;
                let _name = text(&mut rest)?;
                if flags & 0xc0 == 0xc0 {
                    login = Some((text(&mut rest)?, text(&mut rest)?));
                }
                stream.write_all(&[0x20, 2, 0, 0])?;
            }
            // It breaks off.
            3 if desk.refuses() => return Ok(Next::Ends),
            3 => {
                let topic = text(&mut rest)?;
                let (identity, content) = rest.split_at_checked(2).ok_or(ErrorKind::InvalidData)?;
                let content = String::from_utf8_lossy(content).into_owned();
                desk.take(Given { login: login.clone(), to: vec![topic], content });
                stream.write_all(&[0x40, 2, identity[0], identity[1]])?;
            }
            12 => stream.write_all(&[0xd0, 0])?,
            14 => return Ok(Next::Ends),
            _ => {}
        }
        stream.flush()?;
    }
}

/// A text with its length before it.
fn text(rest: &mut &[u8]) -> io::Result<String> {
    let (length, after) = rest.split_at_checked(2).ok_or(ErrorKind::InvalidData)?;
    let length = usize::from(u16::from_be_bytes([length[0], length[1]]));
    let (text, after) = after.split_at_checked(length).ok_or(ErrorKind::InvalidData)?;
    *rest = after;
    Ok(String::from_utf8_lossy(text).into_owned())
}
