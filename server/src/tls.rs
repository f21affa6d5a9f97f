//! TLS on the one port, by configuration: rustls with ring; HTTP/2 and HTTP/1.1 by agreement.

use std::path::Path;
use std::sync::Arc;

use rustls_pki_types::pem::PemObject as _;
use rustls_pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring::default_provider;

use crate::StartError;

/// Reads certificate chain and private key.
pub fn acceptor(chain: &Path, key: &Path) -> Result<TlsAcceptor, StartError> {
    let of = |path: &Path, error: &dyn std::fmt::Display| StartError::Tls(path.to_owned(), error.to_string());
    let certificates = CertificateDer::pem_file_iter(chain).map_err(|error| of(chain, &error))?;
    let certificates: Vec<_> = certificates.collect::<Result<_, _>>().map_err(|error| of(chain, &error))?;
    if certificates.is_empty() {
        return Err(of(chain, &"no certificate in it"));
    }
    let secret = PrivateKeyDer::from_pem_file(key).map_err(|error| of(key, &error))?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|error| of(chain, &error))?
        .with_no_client_auth()
        .with_single_cert(certificates, secret)
        .map_err(|error| of(key, &error))?;
    config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
    Ok(TlsAcceptor::from(Arc::new(config)))
}
