//! Generates the `kestrel` dialect (raw twins and our own messages) from its XML.

use std::error::Error;
use std::path::PathBuf;

fn main() -> Result<(), Box<dyn Error>> {
    let xml =
        PathBuf::from(std::env::var("CARGO_MANIFEST_DIR")?).join("message_definitions/kestrel.xml");
    println!("cargo:rerun-if-changed={}", xml.display());
    let out_dir = PathBuf::from(std::env::var("OUT_DIR")?);
    mavlink_bindgen::generate(mavlink_bindgen::XmlDefinitions::Files(vec![xml]), out_dir)?;
    Ok(())
}
