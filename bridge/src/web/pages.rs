//! The page's files, in the binary, compressed once when first asked for.

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse as _, Response};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::Write as _;
use std::sync::OnceLock;

struct File {
    path: &'static str,
    bytes: &'static [u8],
    kind: &'static str,
}

macro_rules! files {
    ($($path:literal $name:literal $kind:literal)+) => {
        const FILES: &[File] = &[$(File {
            path: $path,
            bytes: include_bytes!(concat!("../../web/", $name)),
            kind: $kind,
        }),+];
    };
}

files! {
    "/" "index.html" "text/html; charset=utf-8"
    "/charts.js" "charts.js" "text/javascript; charset=utf-8"
    "/dom.js" "dom.js" "text/javascript; charset=utf-8"
    "/fly.js" "fly.js" "text/javascript; charset=utf-8"
    "/hangar.js" "hangar.js" "text/javascript; charset=utf-8"
    "/hud.js" "hud.js" "text/javascript; charset=utf-8"
    "/icon.svg" "icon.svg" "image/svg+xml"
    "/link.js" "link.js" "text/javascript; charset=utf-8"
    "/login.js" "login.js" "text/javascript; charset=utf-8"
    "/logs.js" "logs.js" "text/javascript; charset=utf-8"
    "/main.js" "main.js" "text/javascript; charset=utf-8"
    "/mavlink.js" "mavlink.js" "text/javascript; charset=utf-8"
    "/mission.js" "mission.js" "text/javascript; charset=utf-8"
    "/params.js" "params.js" "text/javascript; charset=utf-8"
    "/people.js" "people.js" "text/javascript; charset=utf-8"
    "/plan.js" "plan.js" "text/javascript; charset=utf-8"
    "/recorder.js" "recorder.js" "text/javascript; charset=utf-8"
    "/station.js" "station.js" "text/javascript; charset=utf-8"
    "/sticks.js" "sticks.js" "text/javascript; charset=utf-8"
    "/style.css" "style.css" "text/css; charset=utf-8"
    "/telemetry.js" "telemetry.js" "text/javascript; charset=utf-8"
    "/theme.js" "theme.js" "text/javascript; charset=utf-8"
    "/video.js" "video.js" "text/javascript; charset=utf-8"
    "/words.js" "words.js" "text/javascript; charset=utf-8"
}

/// Compressed, and the mark by which a browser knows that it has it already.
struct Packed {
    bytes: Vec<u8>,
    tag: String,
}

fn packed() -> &'static [Packed] {
    static PACKED: OnceLock<Vec<Packed>> = OnceLock::new();
    PACKED.get_or_init(|| {
        FILES
            .iter()
            .map(|f| {
                let mut gzip = GzEncoder::new(Vec::new(), Compression::best());
                let bytes = gzip
                    .write_all(f.bytes)
                    .and_then(|()| gzip.finish())
                    .unwrap_or_default();
                use sha2::Digest as _;
                let digest = sha2::Sha256::digest(f.bytes);
                let tag = digest
                    .iter()
                    .take(8)
                    .fold(String::from("\""), |s, b| s + &format!("{b:02x}"))
                    + "\"";
                Packed { bytes, tag }
            })
            .collect()
    })
}

/// A file of the page.
pub(super) fn serve(path: &str, headers: &HeaderMap) -> Option<Response> {
    let at = FILES.iter().position(|f| f.path == path)?;
    let (file, packed) = (&FILES[at], &packed()[at]);
    let has = |name, value: &str| {
        headers
            .get(name)
            .and_then(|v: &HeaderValue| v.to_str().ok())
            .is_some_and(|v| v.contains(value))
    };
    let mut response = if has(header::IF_NONE_MATCH, &packed.tag) {
        StatusCode::NOT_MODIFIED.into_response()
    } else if has(header::ACCEPT_ENCODING, "gzip") {
        let mut response = packed.bytes.as_slice().into_response();
        response
            .headers_mut()
            .insert(header::CONTENT_ENCODING, HeaderValue::from_static("gzip"));
        response
    } else {
        file.bytes.into_response()
    };
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(file.kind));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    headers.insert(header::VARY, HeaderValue::from_static("accept-encoding"));
    if let Ok(tag) = HeaderValue::from_str(&packed.tag) {
        headers.insert(header::ETAG, tag);
    }
    Some(response)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_of_the_page_is_in_the_table() {
        let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/web");
        for entry in std::fs::read_dir(folder).unwrap() {
            let name = entry.unwrap().file_name().into_string().unwrap();
            let is_there =
                FILES.iter().any(|f| f.path.ends_with(&format!("/{name}"))) || name == "index.html";
            assert!(is_there, "{name}");
        }
    }

    #[test]
    fn the_page_is_small_and_asks_nobody_else_for_anything() {
        let size: usize = packed().iter().map(|p| p.bytes.len()).sum();
        println!(
            "FIGURES\npage, compressed: {:.1} kB\nEND",
            size as f64 / 1e3
        );
        assert!(size < 250_000, "{size} bytes");
        for file in FILES {
            let text = String::from_utf8_lossy(file.bytes);
            for (at, _) in text.match_indices("://") {
                let around = &text[at.saturating_sub(6)..(at + 24).min(text.len())];
                // A name space, an address put together, the example in an empty field.
                let fine = ["http://www.w3.org/", "${", "https://drone.local"];
                assert!(
                    fine.iter().any(|f| around.contains(f)),
                    "{}: {around}",
                    file.path
                );
            }
        }
    }
}
