//! To a vehicle's console from one that is elsewhere: one connection for each request, encrypted, the certificate known.

use super::hex;
use super::key;
use super::place::{Opener, Place};
use super::role::Role;
use axum::body::Body;
use axum::http::{HeaderMap, Method, Request, Response, header};
use hyper::body::Incoming;
use hyper::client::conn::http1;
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use sha2::{Digest as _, Sha256};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use thiserror::Error;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpStream;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::client::danger::{
    HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier,
};
use tokio_rustls::rustls::crypto::{
    CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature,
};
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName, UnixTime};
use tokio_rustls::rustls::{self, ClientConfig, DigitallySignedStruct, SignatureScheme, version};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::{Role as Side, WebSocketConfig};

/// Time to connect, to agree on a key, to answer.
const PATIENCE: Duration = Duration::from_secs(5);
/// Largest message of a vehicle: a picture of many particles, a map.
const MESSAGE: usize = 256 * 1024;

/// Why a vehicle's console does not answer.
#[derive(Debug, Error)]
pub(super) enum Afar {
    /// No connection.
    #[error("it cannot be reached: {0}")]
    Unreachable(String),
    /// Another certificate than before.
    #[error(
        "its certificate is not the one that is known ({0}): if it was made anew, add the vehicle again"
    )]
    Certificate(String),
    /// It does not take our key.
    #[error(
        "it does not know this console's key (any more): make a new one there and add it again"
    )]
    Key,
    /// An answer that makes no sense.
    #[error("its answer was not understood: {0}")]
    Answer(String),
}

/// For whom we ask.
#[derive(Clone, Debug)]
pub(super) struct Guest {
    /// His name here.
    pub(super) user: String,
    /// His role here.
    pub(super) role: Role,
    /// His browser's session, for the vehicle: not the secret of the cookie.
    pub(super) session: String,
}

/// One request; the certificate that was seen.
pub(super) struct Answered {
    pub(super) response: Response<Incoming>,
    pub(super) seen: Option<[u8; 32]>,
}

/// Asks.
pub(super) async fn ask(
    place: &Place,
    guest: &Guest,
    method: Method,
    path: &str,
    headers: HeaderMap,
    body: Body,
) -> Result<Answered, Afar> {
    let stream = timeout(
        PATIENCE,
        TcpStream::connect((place.host.trim_matches(['[', ']']), place.port)),
    )
    .await
    .map_err(|_| Afar::Unreachable("no answer".to_owned()))?
    .map_err(|e| Afar::Unreachable(e.to_string()))?;
    let _ = stream.set_nodelay(true);
    // The address is a name by which every console lets itself be called.
    let site = stream
        .peer_addr()
        .map_err(|e| Afar::Unreachable(e.to_string()))?
        .to_string();
    let scheme = if place.is_tls { "https" } else { "http" };
    let mut request = Request::builder()
        .method(method)
        .uri(path)
        .header(header::HOST, &site)
        .header(header::ORIGIN, format!("{scheme}://{site}"))
        .header(key::USER, &guest.user)
        .header(key::ROLE, guest.role.name())
        .header(key::SESSION, &guest.session);
    if let Opener::Key(key) = &place.opener {
        request = request.header(header::AUTHORIZATION, format!("Bearer {}", key.to_hex()));
    }
    for (name, value) in &headers {
        request = request.header(name, value);
    }
    let request = request
        .body(body)
        .map_err(|e| Afar::Answer(e.to_string()))?;
    if !place.is_tls {
        let response = speak(stream, request).await?;
        return Ok(Answered {
            response,
            seen: None,
        });
    }
    let known = Arc::new(Known {
        pin: place.pin,
        seen: Mutex::default(),
        provider: Arc::new(ring::default_provider()),
    });
    let config = ClientConfig::builder_with_provider(Arc::clone(&known.provider))
        .with_protocol_versions(&[&version::TLS13, &version::TLS12])
        .map_err(|e| Afar::Answer(e.to_string()))?
        .dangerous()
        .with_custom_certificate_verifier(Arc::clone(&known) as Arc<dyn ServerCertVerifier>)
        .with_no_client_auth();
    let name = ServerName::try_from(place.host.trim_matches(['[', ']']).to_owned())
        .map_err(|e| Afar::Unreachable(e.to_string()))?;
    let stream = timeout(
        PATIENCE,
        TlsConnector::from(Arc::new(config)).connect(name, stream),
    )
    .await
    .map_err(|_| Afar::Unreachable("no answer".to_owned()))?;
    let seen = *known.seen.lock().unwrap_or_else(PoisonError::into_inner);
    let stream = stream.map_err(|e| match seen {
        Some(seen) if place.pin.is_some_and(|pin| pin != seen) => {
            Afar::Certificate(hex::text(&seen))
        }
        _ => Afar::Unreachable(e.to_string()),
    })?;
    let response = speak(stream, request).await?;
    Ok(Answered { response, seen })
}

async fn speak<S>(stream: S, request: Request<Body>) -> Result<Response<Incoming>, Afar>
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let (mut sender, connection) = http1::handshake(TokioIo::new(stream))
        .await
        .map_err(|e| Afar::Unreachable(e.to_string()))?;
    tokio::spawn(async move {
        let _ = connection.with_upgrades().await;
    });
    timeout(PATIENCE, sender.send_request(request))
        .await
        .map_err(|_| Afar::Unreachable("no answer".to_owned()))?
        .map_err(|e| Afar::Unreachable(e.to_string()))
}

/// An open WebSocket to a vehicle.
pub(super) type Upstream = WebSocketStream<TokioIo<Upgraded>>;

/// Opens a WebSocket; or what was answered instead.
pub(super) async fn open(
    place: &Place,
    guest: &Guest,
    path: &str,
) -> Result<Result<Upstream, Response<Incoming>>, Afar> {
    let mut headers = HeaderMap::new();
    let mut set = |name, value: &'static str| {
        headers.insert(name, axum::http::HeaderValue::from_static(value));
    };
    set(header::UPGRADE, "websocket");
    set(header::CONNECTION, "Upgrade");
    set(header::SEC_WEBSOCKET_VERSION, "13");
    // Guards against caches that do not know WebSockets, of which there are none on this way.
    set(header::SEC_WEBSOCKET_KEY, "a2VzdHJlbCBjb25zb2xlIQ==");
    let Answered { response, .. } =
        ask(place, guest, Method::GET, path, headers, Body::empty()).await?;
    if response.status() != axum::http::StatusCode::SWITCHING_PROTOCOLS {
        return Ok(Err(response));
    }
    let upgraded = hyper::upgrade::on(response)
        .await
        .map_err(|e| Afar::Answer(e.to_string()))?;
    let config = WebSocketConfig::default()
        .max_message_size(Some(MESSAGE))
        .max_frame_size(Some(MESSAGE));
    let io = TokioIo::new(upgraded);
    Ok(Ok(WebSocketStream::from_raw_socket(
        io,
        Side::Client,
        Some(config),
    )
    .await))
}

/// Takes the certificate that is known, or the first one.
#[derive(Debug)]
struct Known {
    pin: Option<[u8; 32]>,
    seen: Mutex<Option<[u8; 32]>>,
    provider: Arc<CryptoProvider>,
}

impl ServerCertVerifier for Known {
    fn verify_server_cert(
        &self,
        end_entity: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, rustls::Error> {
        let digest: [u8; 32] = Sha256::digest(end_entity).into();
        *self.seen.lock().unwrap_or_else(PoisonError::into_inner) = Some(digest);
        match self.pin {
            Some(pin) if pin != digest => {
                Err(rustls::Error::General("another certificate".to_owned()))
            }
            _ => Ok(ServerCertVerified::assertion()),
        }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        let algorithms = &self.provider.signature_verification_algorithms;
        verify_tls12_signature(message, cert, dss, algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        cert: &CertificateDer<'_>,
        dss: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, rustls::Error> {
        let algorithms = &self.provider.signature_verification_algorithms;
        verify_tls13_signature(message, cert, dss, algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider
            .signature_verification_algorithms
            .supported_schemes()
    }
}
