//! How a NATS server is reached.

use std::path::PathBuf;

use anyhow::anyhow;
use clap::Args;

use crate::jetstream::Address;

/// How a NATS server is reached.
#[derive(Debug, Args)]
pub(super) struct ServerArguments {
    /// A file of NATS credentials: a JWT and its nkey seed
    #[arg(long, value_name = "FILE")]
    credentials: Option<PathBuf>,
    /// A file of certificates (PEM) to trust beside the system's, for `tls://`
    #[arg(long, value_name = "FILE")]
    trust: Option<PathBuf>,
    /// Copies of each message that a cluster keeps, where Belfry makes the streams
    #[arg(long, value_name = "COUNT", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=5))]
    replicas: u8,
}

impl ServerArguments {
    /// Whether one of them was named.
    pub(super) fn are_given(&self) -> bool {
        self.credentials.is_some() || self.trust.is_some()
    }

    /// The server of these URLs.
    pub(super) fn address(&self, urls: &str) -> anyhow::Result<Address> {
        let address = Address::parse(urls).map_err(|why| anyhow!(why))?;
        Ok(Address {
            credentials: self.credentials.clone(),
            trusted: self.trust.clone(),
            replicas: usize::from(self.replicas),
            ..address
        })
    }
}
