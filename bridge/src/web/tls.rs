//! The certificate: the user's own, or one made at the first start for the names and addresses of this machine.

use super::hex;
use rcgen::{CertificateParams, DnType, KeyPair, SanType};
use sha2::{Digest as _, Sha256};
use std::net::IpAddr;
use std::path::Path;
use std::sync::Arc;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::{ServerConfig, version};

/// Files in the state folder: the user's own are taken as they are.
const CERTIFICATE: &str = "console-cert.pem";
const KEY: &str = "console-key.pem";

/// Reads or makes the certificate; its SHA-256 goes along. Without a folder it ends with the program.
pub(super) fn acceptor(
    folder: Option<&Path>,
    names: &[String],
    address: IpAddr,
) -> Result<(TlsAcceptor, [u8; 32]), String> {
    let (chain, key) = certificate(folder, names, address)?;
    let pin = fingerprint(&chain)?;
    let mut config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_protocol_versions(&[&version::TLS13, &version::TLS12])
        .map_err(|e| e.to_string())?
        .with_no_client_auth()
        .with_single_cert(chain, key)
        .map_err(|e| e.to_string())?;
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    Ok((TlsAcceptor::from(Arc::new(config)), pin))
}

/// SHA-256 of the certificate in a folder, which is made if there is none: what another console knows ours by.
///
/// # Errors
/// In words.
pub fn pin(folder: &Path, names: &[String]) -> Result<String, String> {
    let (chain, _) = certificate(Some(folder), names, IpAddr::from([0, 0, 0, 0]))?;
    fingerprint(&chain).map(|pin| hex::text(&pin))
}

fn fingerprint(chain: &[CertificateDer<'_>]) -> Result<[u8; 32], String> {
    let own = chain.first().ok_or("the file holds no certificate")?;
    Ok(Sha256::digest(own).into())
}

type Pair = (Vec<CertificateDer<'static>>, PrivateKeyDer<'static>);

fn certificate(folder: Option<&Path>, names: &[String], address: IpAddr) -> Result<Pair, String> {
    let files = folder.map(|f| (f.join(CERTIFICATE), f.join(KEY)));
    let pems = match &files {
        Some((certificate, key)) if certificate.exists() && key.exists() => Some((
            std::fs::read(certificate).map_err(|e| format!("{}: {e}", certificate.display()))?,
            std::fs::read(key).map_err(|e| format!("{}: {e}", key.display()))?,
        )),
        _ => None,
    };
    let (certificate, key) = match pems {
        Some(pems) => pems,
        None => {
            let (certificate, key) = make(names, address).map_err(|e| e.to_string())?;
            if let Some((to_certificate, to_key)) = &files {
                write_private(to_key, key.as_bytes()).map_err(|e| e.to_string())?;
                std::fs::write(to_certificate, &certificate).map_err(|e| e.to_string())?;
            }
            (certificate.into_bytes(), key.into_bytes())
        }
    };
    let chain: Vec<CertificateDer<'static>> = CertificateDer::pem_slice_iter(&certificate)
        .collect::<Result<_, _>>()
        .map_err(|e| e.to_string())?;
    let key = PrivateKeyDer::from_pem_slice(&key).map_err(|e| e.to_string())?;
    Ok((chain, key))
}

fn make(names: &[String], address: IpAddr) -> Result<(String, String), rcgen::Error> {
    let mut all = vec!["localhost".to_owned()];
    all.extend(names.iter().cloned());
    let mut params = CertificateParams::new(all)?;
    params
        .distinguished_name
        .push(DnType::CommonName, "Kestrel console");
    let mut addresses = vec![IpAddr::from([127, 0, 0, 1])];
    if address.is_unspecified() {
        addresses.extend(own_addresses());
    } else {
        addresses.push(address);
    }
    addresses.dedup();
    params
        .subject_alt_names
        .extend(addresses.into_iter().map(SanType::IpAddress));
    let key = KeyPair::generate()?;
    let certificate = params.self_signed(&key)?;
    Ok((certificate.pem(), key.serialize_pem()))
}

/// IPv4 addresses of this machine, as the kernel's routing table has them.
pub(super) fn own_addresses() -> Vec<IpAddr> {
    let table = std::fs::read_to_string("/proc/net/fib_trie").unwrap_or_default();
    let lines: Vec<&str> = table.lines().map(str::trim).collect();
    let mut out: Vec<IpAddr> = lines
        .windows(2)
        .filter(|w| w[1].starts_with("/32 host LOCAL"))
        .filter_map(|w| w[0].strip_prefix("|-- ")?.parse().ok())
        .collect();
    out.sort_unstable();
    out.dedup();
    out
}

fn write_private(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    use std::io::Write as _;
    use std::os::unix::fs::OpenOptionsExt as _;
    std::fs::OpenOptions::new()
        .create(true)
        .write(true)
        .truncate(true)
        .mode(0o600)
        .open(path)?
        .write_all(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    #[test]
    fn a_certificate_is_made_once_and_its_key_is_private() {
        let folder = std::env::temp_dir().join(format!("kestrel-tls-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let any = IpAddr::from([0, 0, 0, 0]);
        assert!(acceptor(Some(&folder), &["drone.local".to_owned()], any).is_ok());
        let first = std::fs::read(folder.join(KEY)).unwrap();
        let (_, seen) = acceptor(Some(&folder), &[], any).unwrap();
        assert_eq!(pin(&folder, &[]).unwrap(), hex::text(&seen), "known by it");
        assert_eq!(first, std::fs::read(folder.join(KEY)).unwrap());
        let mode = std::fs::metadata(folder.join(KEY))
            .unwrap()
            .permissions()
            .mode();
        assert_eq!(mode & 0o777, 0o600);
        std::fs::write(folder.join(KEY), "not a key").unwrap();
        assert!(acceptor(Some(&folder), &[], any).is_err());
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
