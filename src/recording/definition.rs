//! What stands in a file besides messages: facts, attachments, channels and their schemas.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use sha2::{Digest as _, Sha256};

/// A name and a text for each thing known.
pub type Facts = BTreeMap<String, String>;

/// Something attached to a recording as it is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Attachment {
    /// File name without folders.
    pub name: String,
    /// Media type such as `text/x-dbc`.
    pub media_type: String,
    /// The bytes.
    pub data: Vec<u8>,
}

impl Attachment {
    /// SHA-256 of the bytes, in hex.
    pub fn sha256(&self) -> String {
        hex(&Sha256::digest(&self.data))
    }
}

/// Two lower-case digits a byte.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::with_capacity(2 * bytes.len()), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// A channel to be defined.
#[derive(Clone, Debug, Default)]
pub struct ChannelDefinition<'a> {
    /// Topic.
    pub topic: String,
    /// Encoding of its messages, such as `protobuf`.
    pub encoding: String,
    /// What its messages look like.
    pub schema: Option<SchemaDefinition<'a>>,
    /// Whatever is worth noting.
    pub metadata: Facts,
}

impl ChannelDefinition<'_> {
    /// Name of its schema, empty without one.
    pub fn schema_name(&self) -> &str {
        self.schema.map_or("", |schema| schema.name)
    }
}

/// What the messages of a channel look like.
#[derive(Clone, Copy, Debug)]
pub struct SchemaDefinition<'a> {
    /// Type name.
    pub name: &'a str,
    /// Encoding of the data, such as `protobuf`.
    pub encoding: &'a str,
    /// The definition.
    pub data: &'a [u8],
}
