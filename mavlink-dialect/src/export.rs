//! Our own messages as XML for other generators: what `kestrel.xml` declares beyond the raw twins, on top of `common.xml`.

const XML: &str = include_str!("../message_definitions/kestrel.xml");
/// First id of our own.
const FIRST_OWN: u32 = 53_000;

/// A MAVLink definition file with our own messages, which includes `common.xml` of the reader's own copy.
///
/// ```
/// let xml = mavlink_dialect::export::client_xml();
/// assert!(xml.contains("KESTREL_LOCALIZATION") && !xml.contains("COMMAND_LONG"));
/// ```
#[must_use]
pub fn client_xml() -> String {
    let mut out = String::from(
        "<?xml version=\"1.0\"?>\n<!-- Messages of Kestrel, made by `kestrel mav dialect`. -->\n<mavlink>\n  <include>common.xml</include>\n  <messages>\n",
    );
    for message in XML.split("    <message id=\"").skip(1) {
        let id = message.split('"').next().and_then(|id| id.parse().ok());
        if id.is_some_and(|id: u32| id >= FIRST_OWN)
            && let Some((body, _)) = message.split_once("</message>")
        {
            out.push_str("    <message id=\"");
            out.push_str(body);
            out.push_str("</message>\n");
        }
    }
    out.push_str("  </messages>\n</mavlink>\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raw;
    use mavlink::Message as _;

    #[test]
    fn every_message_of_our_own_is_exported_and_no_twin() {
        let xml = client_xml();
        for id in raw::MavMessage::all_ids() {
            let is_in = xml.contains(&format!("<message id=\"{id}\" "));
            assert_eq!(is_in, *id >= FIRST_OWN, "{id}");
        }
        let name = raw::MavMessage::default_message_from_id(53_000).map(|m| m.message_name());
        assert_eq!(name, Some("KESTREL_LOCALIZATION"));
    }
}
