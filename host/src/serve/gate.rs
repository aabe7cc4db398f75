//! What lets a window in: the port that it asks, the token of the address that opens the page, and the session that this begins.

use rand::RngExt;
use rand::distr::Alphanumeric;

/// Letters of a token: 190 bits.
const TOKEN_LETTERS: usize = 32;

/// The secrets of a server.
#[derive(Debug, Clone)]
pub(super) struct Gate {
    port: u16,
    token: String,
    session: String,
}

impl Gate {
    /// Of a server on this port, with secrets that nobody can guess.
    pub(super) fn new(port: u16) -> Self {
        let secret = || rand::rng().sample_iter(Alphanumeric).take(TOKEN_LETTERS).map(char::from).collect::<String>();
        Self { port, token: secret(), session: secret() }
    }

    #[cfg(test)]
    pub(super) fn of(port: u16, token: &str, session: &str) -> Self {
        Self { port, token: token.to_owned(), session: session.to_owned() }
    }

    pub(super) fn token(&self) -> &str {
        &self.token
    }

    pub(super) fn session(&self) -> &str {
        &self.session
    }

    /// Cookies do not tell ports apart; their names do.
    pub(super) fn cookie_name(&self) -> String {
        format!("belfry_{}", self.port)
    }

    /// Names that this server answers to.
    pub(super) fn hosts(&self) -> [String; 2] {
        [format!("127.0.0.1:{}", self.port), format!("localhost:{}", self.port)]
    }

    pub(super) fn opening_address(&self) -> String {
        format!("http://127.0.0.1:{}/?token={}", self.port, self.token)
    }
}
