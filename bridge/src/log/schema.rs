//! JSON schemas of the topics. The `foxglove.*` ones have the fields that Foxglove's panels look for, so that plots and the 3D view
//! work without configuration.

use serde_json::{Value, json};

/// A schema's name and its text.
pub(super) type Schema = (&'static str, String);

fn object(title: &str, properties: Value, required: &[&str]) -> Value {
    json!({ "title": title, "type": "object", "properties": properties, "required": required })
}

fn time() -> Value {
    json!({
        "type": "object", "title": "time",
        "properties": {
            "sec": { "type": "integer", "minimum": 0 },
            "nsec": { "type": "integer", "minimum": 0, "maximum": 999_999_999 },
        },
        "required": ["sec", "nsec"],
    })
}

fn numbers(title: &str, names: &[&str]) -> Value {
    let properties: serde_json::Map<String, Value> = names
        .iter()
        .map(|name| ((*name).to_owned(), json!({ "type": "number" })))
        .collect();
    object(title, Value::Object(properties), names)
}

fn vector3() -> Value {
    numbers("foxglove.Vector3", &["x", "y", "z"])
}

fn quaternion() -> Value {
    numbers("foxglove.Quaternion", &["x", "y", "z", "w"])
}

fn pose() -> Value {
    object(
        "foxglove.Pose",
        json!({ "position": vector3(), "orientation": quaternion() }),
        &["position", "orientation"],
    )
}

fn fields() -> Value {
    json!({ "type": "array", "items": object(
        "foxglove.PackedElementField",
        json!({ "name": { "type": "string" }, "offset": { "type": "integer" }, "type": { "type": "integer" } }),
        &["name", "offset", "type"],
    ) })
}

fn base64() -> Value {
    json!({ "type": "string", "contentEncoding": "base64" })
}

fn named(name: &'static str, schema: &Value) -> Schema {
    (name, schema.to_string())
}

/// `foxglove.PoseInFrame`.
pub(super) fn pose_in_frame() -> Schema {
    let name = "foxglove.PoseInFrame";
    named(
        name,
        &object(
            name,
            json!({ "timestamp": time(), "frame_id": { "type": "string" }, "pose": pose() }),
            &["timestamp", "frame_id", "pose"],
        ),
    )
}

/// `foxglove.FrameTransform`.
pub(super) fn frame_transform() -> Schema {
    let name = "foxglove.FrameTransform";
    let required = [
        "timestamp",
        "parent_frame_id",
        "child_frame_id",
        "translation",
        "rotation",
    ];
    named(
        name,
        &object(
            name,
            json!({
                "timestamp": time(),
                "parent_frame_id": { "type": "string" }, "child_frame_id": { "type": "string" },
                "translation": vector3(), "rotation": quaternion(),
            }),
            &required,
        ),
    )
}

/// `foxglove.PointCloud`.
pub(super) fn point_cloud() -> Schema {
    let name = "foxglove.PointCloud";
    let required = [
        "timestamp",
        "frame_id",
        "pose",
        "point_stride",
        "fields",
        "data",
    ];
    named(
        name,
        &object(
            name,
            json!({
                "timestamp": time(), "frame_id": { "type": "string" }, "pose": pose(),
                "point_stride": { "type": "integer", "minimum": 0 }, "fields": fields(), "data": base64(),
            }),
            &required,
        ),
    )
}

/// `foxglove.Grid`.
pub(super) fn grid() -> Schema {
    let name = "foxglove.Grid";
    let count = json!({ "type": "integer", "minimum": 0 });
    let required = [
        "timestamp",
        "frame_id",
        "pose",
        "column_count",
        "cell_size",
        "row_stride",
        "cell_stride",
        "fields",
        "data",
    ];
    named(
        name,
        &object(
            name,
            json!({
                "timestamp": time(), "frame_id": { "type": "string" }, "pose": pose(),
                "column_count": count, "row_stride": count, "cell_stride": count,
                "cell_size": numbers("foxglove.Vector2", &["x", "y"]), "fields": fields(), "data": base64(),
            }),
            &required,
        ),
    )
}

/// `foxglove.Log`.
pub(super) fn log() -> Schema {
    let name = "foxglove.Log";
    let required = ["timestamp", "level", "message", "name", "file", "line"];
    named(
        name,
        &object(
            name,
            json!({
                "timestamp": time(),
                "level": { "title": "foxglove.LogLevel", "oneOf": [
                    { "title": "UNKNOWN", "const": 0 }, { "title": "DEBUG", "const": 1 }, { "title": "INFO", "const": 2 },
                    { "title": "WARNING", "const": 3 }, { "title": "ERROR", "const": 4 }, { "title": "FATAL", "const": 5 },
                ] },
                "message": { "type": "string" }, "name": { "type": "string" },
                "file": { "type": "string" }, "line": { "type": "integer", "minimum": 0 },
            }),
            &required,
        ),
    )
}

/// One of ours: an object with whatever is in it, which plots find by itself.
pub(super) fn own(name: &'static str) -> Schema {
    named(name, &object(name, json!({}), &[]))
}
