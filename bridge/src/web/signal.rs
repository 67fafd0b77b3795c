//! The WebSocket on which a viewer and the camera agree on a session: words are carried, not understood. Cockpit and other viewers
//! of MAVLink Camera Manager speak the same.

use super::aboard::Aboard;
use super::console::Server;
use super::gate::{Arrival, Caller, problem};
use axum::Extension;
use axum::extract::State;
use axum::extract::ws::{CloseFrame, Message as Ws, WebSocket, WebSocketUpgrade};
use axum::http::StatusCode;
use axum::response::Response;
use std::fmt::Debug;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, mpsc};

/// Sockets of viewers at once.
pub(super) const VIEWERS: usize = 24;
/// Largest message: an SDP.
const MESSAGE: usize = 64 * 1024;
/// What may wait for a viewer.
const UNREAD: usize = 64;
/// A viewer that does not read for this long is disconnected.
const PATIENCE: Duration = Duration::from_secs(5);
/// How often the session is looked at, and the viewer pinged.
const LOOK: Duration = Duration::from_secs(2);

/// Words for one viewer; false if they cannot be taken.
pub type Reply = Box<dyn Fn(String) -> bool + Send>;

/// Where viewers are attended to: the camera, if there is one. Nothing here waits.
pub trait Desk: Debug + Send + Sync {
    /// Somebody came, by this address of ours; none if there is no place.
    fn open(&self, local: IpAddr, reply: Reply) -> Option<u64>;
    /// He says something; false if it cannot be taken.
    fn say(&self, caller: u64, text: String) -> bool;
    /// He has left.
    fn close(&self, caller: u64);
}

pub(super) async fn open(
    State(server): State<Arc<Server>>,
    Extension(aboard): Extension<Arc<Aboard>>,
    Extension(arrival): Extension<Arrival>,
    Extension(caller): Extension<Caller>,
    upgrade: Result<WebSocketUpgrade, axum::extract::ws::rejection::WebSocketUpgradeRejection>,
) -> Response {
    let Some(desk) = aboard.camera.clone() else {
        return problem(StatusCode::NOT_FOUND, "there is no camera");
    };
    let Ok(upgrade) = upgrade else {
        return problem(StatusCode::UPGRADE_REQUIRED, "this is a WebSocket");
    };
    let Ok(place) = Arc::clone(&server.viewers).try_acquire_owned() else {
        return problem(StatusCode::SERVICE_UNAVAILABLE, "too many viewers");
    };
    upgrade
        .max_message_size(MESSAGE)
        .max_frame_size(MESSAGE)
        .on_upgrade(move |ws| serve(ws, server, desk, arrival, caller, place))
}

async fn serve(
    mut ws: WebSocket,
    server: Arc<Server>,
    desk: Arc<dyn Desk>,
    arrival: Arrival,
    caller: Caller,
    place: OwnedSemaphorePermit,
) {
    let _place = place;
    let (tell, mut told) = mpsc::channel(UNREAD);
    let reply = Box::new(move |text| tell.try_send(text).is_ok());
    let Some(id) = desk.open(arrival.local.ip().to_canonical(), reply) else {
        return;
    };
    let mut look = tokio::time::interval(LOOK);
    let code = loop {
        let sent = tokio::select! {
            got = ws.recv() => match got {
                Some(Ok(Ws::Text(text))) => {
                    desk.say(id, text.to_string());
                    continue;
                }
                Some(Ok(Ws::Close(_)) | Err(_)) | None => break 1000,
                Some(Ok(_)) => continue,
            },
            text = told.recv() => match text {
                Some(text) => Ws::text(text),
                // The camera has let go of it.
                None => break 1001,
            },
            _ = look.tick() => {
                if server.session(caller.id).is_none() {
                    break 4001;
                }
                Ws::Ping(Default::default())
            }
        };
        if !matches!(
            tokio::time::timeout(PATIENCE, ws.send(sent)).await,
            Ok(Ok(()))
        ) {
            break 1000;
        }
    };
    desk.close(id);
    let close = Ws::Close(Some(CloseFrame {
        code,
        reason: "".into(),
    }));
    let _ = tokio::time::timeout(Duration::from_secs(1), ws.send(close)).await;
}
