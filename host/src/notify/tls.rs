//! Certificates that a server may show.

use std::path::Path;
use std::sync::Arc;

use rustls::pki_types::CertificateDer;
use rustls::pki_types::pem::PemObject;
use rustls::{ClientConfig, RootCertStore};

use super::NotifyError;
use crate::link::with_cause;
use crate::study::alarms::Server;

/// The certificates of the server's `trust`; none where it has none.
pub(super) fn trusted(server: &Server, folder: &Path) -> Result<Vec<CertificateDer<'static>>, NotifyError> {
    let Some(file) = &server.trust else { return Ok(Vec::new()) };
    let file = folder.join(file);
    let wrong = |why: String| NotifyError::File { file: file.clone(), why };
    let certificates = CertificateDer::pem_file_iter(&file).and_then(Iterator::collect::<Result<Vec<_>, _>>);
    let certificates = certificates.map_err(|error| wrong(error.to_string()))?;
    if certificates.is_empty() { Err(wrong("it has no certificate (PEM)".to_owned())) } else { Ok(certificates) }
}

/// What a client needs: the certificates of the system and those of `trust`.
pub(super) fn client(server: &Server, folder: &Path) -> Result<Arc<ClientConfig>, NotifyError> {
    let mut roots = RootCertStore::empty();
    let own = trusted(server, folder)?;
    roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    roots.add_parsable_certificates(own);
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let builder = ClientConfig::builder_with_provider(provider).with_safe_default_protocol_versions();
    let builder =
        builder.map_err(|error| NotifyError::Mqtt { server: server.host.clone(), why: with_cause(&error) })?;
    Ok(Arc::new(builder.with_root_certificates(roots).with_no_client_auth()))
}
