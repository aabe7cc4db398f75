//! A message to a broker for every event (MQTT 3.1.1, quality of service 1): it counts as told when the broker has acknowledged it.

use std::path::Path;
use std::time::{Duration, Instant};

use rumqttc::{Client, Event, MqttOptions, Outgoing, Packet, QoS, RecvTimeoutError, TlsConfiguration, Transport};

use super::{Notice, NotifyError, password, tls};
use crate::link::with_cause;
use crate::study::alarms::{Encryption, Mqtt};

/// How long the broker may take to answer.
const ANSWER: Duration = Duration::from_secs(20);
/// Requests that wait within this program: a message and the end.
const WAITING: usize = 4;
/// More than an event and its topic take.
const LONGEST_PACKET: usize = 1 << 20;

/// Publishes an event.
pub(super) fn publish(mqtt: &Mqtt, folder: &Path, notice: &Notice) -> Result<(), NotifyError> {
    let server = &mqtt.server;
    let failed = |why: String| NotifyError::Mqtt { server: format!("{}:{}", server.host, server.port), why };
    let mut name = [0; 8];
    let random = |error: getrandom::Error| NotifyError::System {
        what: "the system gives no random number for a name at the broker",
        source: error.into(),
    };
    getrandom::fill(&mut name).map_err(random)?;
    // Brokers need to take names of 23 letters and no more (MQTT 3.1.1, 3.1.3.1).
    let name = format!("belfry{:016x}", u64::from_ne_bytes(name));
    let mut options = MqttOptions::new(name, server.host.clone(), server.port);
    options.set_keep_alive(ANSWER).set_max_packet_size(LONGEST_PACKET, LONGEST_PACKET);
    if let Some(login) = &server.login {
        options.set_credentials(login.user.clone(), password(folder.join(&login.password_file))?);
    }
    if server.encryption != Encryption::Plain {
        let client = tls::client(server, folder)?;
        options.set_transport(Transport::tls_with_config(TlsConfiguration::Rustls(client)));
    }
    let (client, mut connection) = Client::new(options, WAITING);
    let published = client.publish(mqtt.topic.as_str(), QoS::AtLeastOnce, false, notice.json.clone());
    published.map_err(|error| failed(with_cause(&error)))?;
    let start = Instant::now();
    let mut is_acknowledged = false;
    loop {
        let left = ANSWER.checked_sub(start.elapsed()).ok_or(RecvTimeoutError::Timeout);
        match left.and_then(|left| connection.recv_timeout(left)) {
            Ok(Ok(Event::Incoming(Packet::PubAck(_)))) => {
                is_acknowledged = true;
                if client.disconnect().is_err() {
                    return Ok(());
                }
            }
            Ok(Ok(Event::Outgoing(Outgoing::Disconnect))) if is_acknowledged => return Ok(()),
            Ok(Ok(_)) => {}
            // It has the message, whatever becomes of the connection.
            Ok(Err(_)) | Err(_) if is_acknowledged => return Ok(()),
            Ok(Err(error)) => return Err(failed(with_cause(&error))),
            Err(_) => return Err(failed(format!("no acknowledgement within {} s", ANSWER.as_secs()))),
        }
    }
}
