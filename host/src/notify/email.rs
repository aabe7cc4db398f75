//! An e-mail for every event: its first sentence is the subject, and the event is attached as JSON.

use std::path::Path;
use std::time::Duration;

use crc::{CRC_64_XZ, Crc};
use lettre::message::header::ContentType;
use lettre::message::{Attachment, Mailbox, MultiPart, SinglePart};
use lettre::transport::smtp::authentication::Credentials;
use lettre::transport::smtp::client::{Certificate, Tls, TlsParameters};
use lettre::{Message, SmtpTransport, Transport};

use super::{Notice, NotifyError, password, tls};
use crate::link::with_cause;
use crate::study::alarms::{Email, Encryption};

/// How long the server may take to answer.
const ANSWER: Duration = Duration::from_secs(20);
/// A subject is cut behind so many letters.
const LONGEST_SUBJECT: usize = 120;

/// Sends an event to each recipient by itself, for one whose mailbox is closed must not keep it from the others; who has refused it, while others
/// have it.
pub(super) fn send(
    email: &Email,
    folder: &Path,
    structure: &str,
    notice: &Notice,
) -> Result<Vec<NotifyError>, NotifyError> {
    let server = &email.server;
    let failed = |error: &dyn std::error::Error| NotifyError::Email {
        server: format!("{}:{}", server.host, server.port),
        why: with_cause(error),
    };
    let parameters = || -> Result<TlsParameters, NotifyError> {
        let mut builder = TlsParameters::builder(server.host.clone());
        for certificate in tls::trusted(server, folder)? {
            builder = builder
                .add_root_certificate(Certificate::from_der(certificate.to_vec()).map_err(|error| failed(&error))?);
        }
        builder.build().map_err(|error| failed(&error))
    };
    let encryption = match server.encryption {
        Encryption::Plain => Tls::None,
        Encryption::StartTls => Tls::Required(parameters()?),
        Encryption::Tls => Tls::Wrapper(parameters()?),
    };
    let mut builder =
        SmtpTransport::builder_dangerous(&server.host).port(server.port).tls(encryption).timeout(Some(ANSWER));
    if let Some(login) = &server.login {
        let password = password(folder.join(&login.password_file))?;
        builder = builder.credentials(Credentials::new(login.user.clone(), password));
    }
    let transport = builder.build();
    let (mut refused, mut taken) = (Vec::new(), 0);
    for to in &email.to {
        let message = message(email, to, structure, notice).map_err(|error| failed(&*error))?;
        match transport.send(&message) {
            Ok(_) => taken += 1,
            Err(error) if error.is_permanent() => refused.push(failed(&error)),
            Err(error) => return Err(failed(&error)),
        }
    }
    // Where nobody has it, the fault is rather in the settings than in the mailboxes, and it is tried again.
    if taken == 0
        && let Some(first) = refused.pop()
    {
        Err(first)
    } else {
        Ok(refused)
    }
}

fn message(
    email: &Email,
    to: &str,
    structure: &str,
    notice: &Notice,
) -> Result<Message, Box<dyn std::error::Error + Send + Sync>> {
    let from: Mailbox = email.from.parse()?;
    // The same event has the same identity, so that a mailbox can tell that it has come twice.
    let identity = Crc::<u64>::new(&CRC_64_XZ).checksum(notice.json.as_bytes());
    let identity = format!("<belfry-{identity:016x}@{}>", from.email.domain());
    let builder = Message::builder().message_id(Some(identity)).from(from).to(to.parse()?);
    let attached =
        Attachment::new("event.json".to_owned()).body(notice.json.clone(), ContentType::parse("application/json")?);
    let text = SinglePart::plain(format!("{}\n\nBelfry, watching {structure}\n", notice.words));
    Ok(builder.subject(subject(&notice.words)).multipart(MultiPart::mixed().singlepart(text).singlepart(attached))?)
}

/// The first sentence, on one line, cut behind a word where it is long.
fn subject(words: &str) -> String {
    let line: String = words.chars().map(|letter| if letter.is_control() { ' ' } else { letter }).collect();
    let sentence = line.split_inclusive(". ").next().unwrap_or_default().trim();
    if sentence.chars().count() <= LONGEST_SUBJECT {
        return sentence.to_owned();
    }
    let cut: String = sentence.chars().take(LONGEST_SUBJECT).collect();
    cut.rsplit_once(' ').map_or(cut.clone(), |(cut, _)| cut.to_owned()) + " ..."
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subject_is_a_sentence_on_one_line() {
        assert_eq!(subject("Node 3 is silent. It last spoke\nat noon."), "Node 3 is silent.");
        assert_eq!(subject("A change\r\nBcc: you@example.org"), "A change  Bcc: you@example.org");
        let long = subject(&"mode 1 by -0.40 ± 0.01 %, ".repeat(30));
        assert!(long.chars().count() <= LONGEST_SUBJECT + 4 && long.ends_with(" ..."), "{long}");
    }
}
