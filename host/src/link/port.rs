//! Real ports: serial ports, and TCP or Unix sockets that carry the same bytes (an emulated board, a serial server).
//!
//! A port is named as the system names it (`/dev/ttyACM0`, `COM3`), or `tcp:HOST:PORT`, or `unix:PATH`.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use belfry_shared::frame::END_OF_FRAME;
use thiserror::Error;

use super::transport::Transport;

/// How long a look for bytes waits. More of a frame whose beginning has come is there by then.
const WAIT: Duration = Duration::from_millis(2);
/// Bytes that are taken while they are waited for.
const WAITED_BYTES: usize = 512;
/// How long a connection may take.
const CONNECT: Duration = Duration::from_secs(3);
/// How long bytes may wait for the line before it counts as dead.
const PATIENCE: Duration = Duration::from_secs(10);

/// A port that could not be opened.
#[derive(Debug, Error)]
#[error("the port {name} cannot be opened{hint}")]
pub struct PortError {
    name: String,
    hint: &'static str,
    source: io::Error,
}

#[derive(Debug)]
enum Line {
    Serial(Box<dyn serialport::SerialPort>),
    Tcp(TcpStream),
    #[cfg(unix)]
    Unix(std::os::unix::net::UnixStream),
}

/// An open port.
#[derive(Debug)]
pub struct Port {
    name: String,
    line: Line,
    /// What came while it was waited for, and has not been read yet.
    waited: VecDeque<u8>,
    /// Whether nothing came while it was waited for: then there is no need to look again.
    is_quiet: bool,
}

impl Port {
    /// Opens a port; `baud` is for serial ports. The first that goes out is an empty frame: what strayed onto the line before ends
    /// there, and does not spoil the first message.
    ///
    /// # Errors
    /// [`PortError`] names the port, and what may help.
    pub fn open(name: &str, baud: u32) -> Result<Self, PortError> {
        let open = || {
            let mut port =
                Self { name: name.to_owned(), line: Self::line(name, baud)?, waited: VecDeque::new(), is_quiet: false };
            port.write(&[END_OF_FRAME])?;
            Ok(port)
        };
        open().map_err(|source: io::Error| PortError {
            name: name.to_owned(),
            hint: match source.kind() {
                ErrorKind::PermissionDenied => " (is your user in the group that may use it, often `dialout`?)",
                ErrorKind::NotFound => " (`belfry ports` lists those that are there)",
                _ => "",
            },
            source,
        })
    }

    fn line(name: &str, baud: u32) -> io::Result<Line> {
        if let Some(address) = name.strip_prefix("tcp:") {
            let stream = connect(address)?;
            stream.set_nodelay(true)?;
            stream.set_read_timeout(Some(WAIT))?;
            stream.set_write_timeout(Some(PATIENCE))?;
            return Ok(Line::Tcp(stream));
        }
        #[cfg(unix)]
        if let Some(path) = name.strip_prefix("unix:") {
            let stream = std::os::unix::net::UnixStream::connect(path)?;
            stream.set_read_timeout(Some(WAIT))?;
            stream.set_write_timeout(Some(PATIENCE))?;
            return Ok(Line::Unix(stream));
        }
        let port = serialport::new(name, baud).timeout(WAIT).open()?;
        // What came before anybody listened is of no interest; that a port cannot drop it is no fault.
        let _ = port.clear(serialport::ClearBuffer::Input);
        Ok(Line::Serial(port))
    }

    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Has looks for bytes wait so long.
    fn set_wait(&mut self, longest: Duration) -> io::Result<()> {
        match &mut self.line {
            Line::Serial(port) => port.set_timeout(longest).map_err(io::Error::from),
            Line::Tcp(stream) => stream.set_read_timeout(Some(longest)),
            #[cfg(unix)]
            Line::Unix(stream) => stream.set_read_timeout(Some(longest)),
        }
    }

    /// Reads what the line has, or gets while a look for bytes waits.
    fn look(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let closed = || Err(io::Error::new(ErrorKind::UnexpectedEof, "the other end has closed it"));
        let read = match &mut self.line {
            Line::Serial(port) => port.read(buffer),
            Line::Tcp(stream) => match stream.read(buffer) {
                Ok(0) => closed(),
                read => read,
            },
            #[cfg(unix)]
            Line::Unix(stream) => match stream.read(buffer) {
                Ok(0) => closed(),
                read => read,
            },
        };
        match read {
            Err(error)
                if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted) =>
            {
                Ok(0)
            }
            read => read,
        }
    }
}

impl Transport for Port {
    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        match &mut self.line {
            Line::Serial(port) => {
                // The wait for bytes to come is short; that for bytes to go must outlast a full buffer.
                port.set_timeout(PATIENCE)?;
                let written = port.write_all(bytes);
                port.set_timeout(WAIT)?;
                written
            }
            Line::Tcp(stream) => stream.write_all(bytes),
            #[cfg(unix)]
            Line::Unix(stream) => stream.write_all(bytes),
        }
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if std::mem::take(&mut self.is_quiet) {
            return Ok(0);
        }
        if self.waited.is_empty() {
            return self.look(buffer);
        }
        self.waited.read(buffer)
    }

    fn wait(&mut self, longest: Duration) -> io::Result<()> {
        // A wait of no time would be one without end.
        if !self.waited.is_empty() || longest <= WAIT {
            return Ok(());
        }
        self.set_wait(longest)?;
        let mut buffer = [0; WAITED_BYTES];
        let count = self.look(&mut buffer);
        self.set_wait(WAIT)?;
        self.waited.extend(&buffer[..count?]);
        self.is_quiet = self.waited.is_empty();
        Ok(())
    }
}

/// Whether a port leads to another computer: what goes over it passes a network, on which others may listen and speak.
pub fn is_remote(name: &str) -> bool {
    let Some(address) = name.strip_prefix("tcp:") else { return false };
    // What has no address now may have one of another computer later.
    address.to_socket_addrs().map_or(true, |mut addresses| addresses.any(|address| !address.ip().is_loopback()))
}

/// What to say of a node without a key on a port to another computer.
pub fn open_to_others(port: &str) -> String {
    format!(
        "{port} leads over a network, and its node has no key: whoever reaches it can make the node drop windows, and send invented ones; give the node a key (`belfry key new`), or connect through a tunnel that ends on this computer"
    )
}

/// Connects to the first of a name's addresses that answers; a host that is switched off must not hold anybody up for minutes.
fn connect(address: &str) -> io::Result<TcpStream> {
    let mut failure = io::Error::new(ErrorKind::NotFound, "the name has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT) {
            Ok(stream) => return Ok(stream),
            Err(error) => failure = error,
        }
    }
    Err(failure)
}

/// Names of the serial ports that there are, and what hangs on them where it is known.
///
/// # Errors
/// Where the system does not say.
pub fn serial_ports() -> io::Result<Vec<(String, String)>> {
    let describe = |port: serialport::SerialPortInfo| {
        let what = match port.port_type {
            serialport::SerialPortType::UsbPort(usb) => {
                [usb.manufacturer, usb.product].into_iter().flatten().collect::<Vec<_>>().join(" ")
            }
            serialport::SerialPortType::BluetoothPort => "Bluetooth".to_owned(),
            _ => String::new(),
        };
        (port.port_name, what)
    };
    Ok(serialport::available_ports()?.into_iter().map(describe).collect())
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::net::UnixListener;

    use belfry_shared::frame::{FrameDecoder, MAX_FRAME_BYTES};
    use belfry_shared::message::{self, Conversation, Greeting, HostMessage, InConversation};

    use super::*;

    #[test]
    fn only_a_network_leads_to_others() {
        for near in ["/dev/ttyACM0", "unix:/tmp/node", "tcp:127.0.0.1:4001", "tcp:[::1]:4001"] {
            assert!(!is_remote(near), "{near}");
        }
        for far in ["tcp:10.0.0.7:4001", "tcp:[2001:db8::1]:4001", "tcp:nobody.invalid:4001"] {
            assert!(is_remote(far), "{far}");
        }
    }

    #[test]
    fn what_strayed_onto_the_line_before_a_port_was_opened_does_not_spoil_the_first_message() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("line");
        let listener = UnixListener::bind(&socket).unwrap();
        let mut port = Port::open(&format!("unix:{}", socket.display()), 115_200).unwrap();
        let mut frame = [0; MAX_FRAME_BYTES];
        let greet = InConversation {
            conversation: Conversation([1, 2, 3, 4]),
            message: HostMessage::Greet(Greeting::OF_HOSTS),
        };
        let length = message::encode(&greet, &mut frame).unwrap();
        port.write(&frame[..length]).unwrap();
        drop(port);
        let mut said = Vec::new();
        listener.accept().unwrap().0.read_to_end(&mut said).unwrap();
        // A node that has a byte of noise in its decoder already.
        let mut decoder = FrameDecoder::new();
        assert!(decoder.push(0xA5).is_none());
        let frames: Vec<_> =
            said.iter().filter_map(|&byte| decoder.push(byte).map(|f| f.map(|f| f.message.to_vec()))).collect();
        let [Err(_), Ok(greeting)] = frames.as_slice() else { panic!("{frames:?}") };
        assert_eq!(message::decode::<InConversation>(greeting), Ok(greet));
    }
}
