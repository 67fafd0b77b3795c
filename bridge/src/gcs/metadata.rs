//! Component metadata: what a ground station shows beside each parameter, as files it fetches over FTP.
//!
//! | File | Holds |
//! | --- | --- |
//! | `/general.json`, `/general.json.xz` | which metadata there is, where, with which checksum (COMP_METADATA_TYPE_GENERAL) |
//! | `/parameters.json`, `/parameters.json.xz` | name, type, text, group, default, range and unit of each parameter (COMP_METADATA_TYPE_PARAMETER) |
//!
//! They say nothing that changes while the program runs, so they are made once, when somebody first asks. Source: MAVLink
//! guide, "Component Metadata Protocol"; schemas `general.schema.json`, `parameter.schema.json` version 1.

use crate::settings::Settings;
use serde_json::{Value, json};
use std::io::Write as _;
use std::sync::LazyLock;
use vehicle::{ParamKind, ParamMeta, ParamValue};

/// Where COMPONENT_METADATA sends stations.
pub const GENERAL_URI: &str = "mftp:///general.json.xz";
const PARAMETERS_URI: &str = "mftp:///parameters.json.xz";
/// Longest short description, characters; what is longer goes into the long one too.
const SHORT_LEN: usize = 80;

/// One file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MetadataFile {
    /// Name in the root of the FTP tree.
    pub name: &'static str,
    /// Content.
    pub bytes: Vec<u8>,
}

/// All files, the compressed general one first.
pub static FILES: LazyLock<[MetadataFile; 4]> = LazyLock::new(|| {
    let parameters = parameters(&Settings::default());
    let parameters_xz = xz(&parameters);
    let general = text(&json!({
        "version": 1,
        "metadataTypes": [{ "type": 1, "uri": PARAMETERS_URI, "fileCrc": crc32(0, &parameters_xz) }],
    }));
    let file = |name, bytes| MetadataFile { name, bytes };
    [
        file("general.json.xz", xz(&general)),
        file("general.json", general),
        file("parameters.json.xz", parameters_xz),
        file("parameters.json", parameters),
    ]
});

/// Checksum of the file at [`GENERAL_URI`].
#[must_use]
pub fn general_crc() -> u32 {
    crc32(0, &FILES[0].bytes)
}

/// CRC-32 as MAVLink FTP counts it: polynomial 0x04C11DB7 reflected, start 0, no final inversion. Feed a file in pieces by
/// giving back the result of the last piece.
#[must_use]
pub fn crc32(crc: u32, bytes: &[u8]) -> u32 {
    const TABLE: [u32; 256] = {
        let mut table = [0u32; 256];
        let mut i = 0;
        while i < 256 {
            let mut c = i as u32;
            let mut bit = 0;
            while bit < 8 {
                c = if c & 1 == 1 {
                    0xEDB8_8320 ^ (c >> 1)
                } else {
                    c >> 1
                };
                bit += 1;
            }
            table[i] = c;
            i += 1;
        }
        table
    };
    bytes.iter().fold(crc, |crc, b| {
        TABLE[((crc ^ u32::from(*b)) & 0xFF) as usize] ^ (crc >> 8)
    })
}

fn parameters(settings: &Settings) -> Vec<u8> {
    let rows: Vec<Value> = settings.rows().map(|r| entry(r.section, r.meta)).collect();
    text(&json!({ "version": 1, "parameters": rows }))
}

/// One parameter.
fn entry(group: &str, meta: &ParamMeta) -> Value {
    let doc = meta.doc.trim();
    let short: String = doc.chars().take(SHORT_LEN).collect();
    let mut entry = json!({
        "name": meta.id,
        "group": group,
        "shortDesc": short,
        "category": "Standard",
        "default": number(meta.default_value()),
    });
    if short.len() < doc.len() {
        entry["longDesc"] = json!(doc);
    }
    if meta.unit != "1" {
        entry["units"] = json!(meta.unit);
    }
    match meta.kind {
        ParamKind::Float { min, max, .. } => {
            entry["type"] = json!("Float");
            entry["min"] = number(ParamValue::Float(min));
            entry["max"] = number(ParamValue::Float(max));
            entry["decimalPlaces"] = json!(3);
        }
        ParamKind::Int { min, max, .. } => {
            entry["type"] = json!("Int32");
            entry["min"] = json!(min);
            entry["max"] = json!(max);
        }
        ParamKind::Bool { .. } => {
            entry["type"] = json!("Int32");
            entry["min"] = json!(0);
            entry["max"] = json!(1);
            entry["values"] = json!([
                { "value": 0, "description": "off" },
                { "value": 1, "description": "on" },
            ]);
        }
        ParamKind::Choice { names, .. } => {
            entry["type"] = json!("Int32");
            entry["values"] = names
                .iter()
                .map(|(name, code)| json!({ "value": code, "description": name }))
                .collect();
        }
    }
    entry
}

/// The number as people write it: 0.35, not the 0.3499999940395355 that lies behind the f32.
fn number(value: ParamValue) -> Value {
    match value {
        ParamValue::Int(v) => json!(v),
        ParamValue::Float(v) => v
            .to_string()
            .parse::<f64>()
            .map_or(Value::Null, |v| json!(v)),
    }
}

fn text(value: &Value) -> Vec<u8> {
    // A Value has only string keys: it cannot fail to serialise.
    serde_json::to_vec(value).unwrap_or_default()
}

/// An .xz file with the checks that the smallest decoders know (CRC-32).
fn xz(bytes: &[u8]) -> Vec<u8> {
    // A small dictionary: the documents are small, and larger ones take 90 MB for a moment.
    let mut options = lzma_rust2::XzOptions::with_preset(1);
    options.set_check_sum_type(lzma_rust2::CheckType::Crc32);
    // Writing into a vector cannot fail.
    let written = lzma_rust2::XzWriter::new(Vec::new(), options).and_then(|mut out| {
        out.write_all(bytes)?;
        out.finish()
    });
    written.unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read as _;

    #[test]
    fn the_checksum_is_that_of_the_file_transfer_protocol() {
        // "123456789" by CRC-32 with start 0 and no final inversion.
        assert_eq!(crc32(0, b"123456789"), 0x2DFD_2D88);
        assert_eq!(crc32(crc32(0, b"1234"), b"56789"), 0x2DFD_2D88);
    }

    #[test]
    fn every_parameter_is_told_with_type_default_and_range() {
        let settings = Settings::default();
        let json: Value = serde_json::from_slice(&FILES[3].bytes).unwrap();
        let entries = json["parameters"].as_array().unwrap();
        assert_eq!(entries.len(), settings.count());
        for (entry, row) in entries.iter().zip(settings.rows()) {
            assert_eq!(entry["name"], row.meta.id);
            assert!(
                entry["default"].is_number() && entry["shortDesc"].is_string(),
                "{entry}"
            );
            let is_float = matches!(row.value, ParamValue::Float(_));
            assert_eq!(entry["type"], if is_float { "Float" } else { "Int32" });
            let has_range = entry["min"].is_number() && entry["max"].is_number();
            assert!(has_range || entry["values"].is_array(), "{entry}");
        }
        let takeoff = entries
            .iter()
            .find(|e| e["name"] == "MIS_TAKEOFF_ALT")
            .unwrap();
        assert_eq!(
            (&takeoff["type"], &takeoff["units"]),
            (&json!("Float"), &json!("m"))
        );
    }

    #[test]
    fn compressed_files_unpack_to_the_plain_ones_and_the_general_one_names_the_checksum_of_the_other()
     {
        for (packed, plain) in [(&FILES[0], &FILES[1]), (&FILES[2], &FILES[3])] {
            let mut got = Vec::new();
            lzma_rust2::XzReader::new(packed.bytes.as_slice(), false)
                .read_to_end(&mut got)
                .unwrap();
            assert_eq!(got, plain.bytes, "{}", packed.name);
            assert!(packed.bytes.len() < plain.bytes.len() || plain.bytes.len() < 200);
        }
        let general: Value = serde_json::from_slice(&FILES[1].bytes).unwrap();
        assert_eq!(
            general["metadataTypes"][0]["fileCrc"],
            json!(crc32(0, &FILES[2].bytes))
        );
    }
}
