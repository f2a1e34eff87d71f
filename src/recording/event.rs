//! Events: marks that people set, and triggers.

use super::schema::foxglove;
use crate::frame::Timestamp;

/// What events of marks are called.
pub const MARK: &str = "mark";

/// Something that somebody will look for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Event {
    /// When.
    pub time: Timestamp,
    /// `mark`, or the name of a trigger.
    pub kind: String,
    /// What is known of it, by name.
    pub properties: Vec<(&'static str, String)>,
    /// Its name, unique in the world; the recorder gives it.
    pub id: String,
    /// The host it was recorded on; the recorder gives it.
    pub device: String,
}

impl Event {
    /// An event that the recorder has not taken yet.
    pub fn new(time: Timestamp, kind: &str, properties: Vec<(&'static str, String)>) -> Self {
        let (id, device) = (String::new(), String::new());
        Self { time, kind: kind.to_owned(), properties, id, device }
    }

    /// True of a mark that somebody has set; triggers have a condition.
    pub fn is_mark(&self) -> bool {
        self.kind == MARK && self.properties.iter().all(|(key, _)| *key != "condition")
    }

    /// Bytes of memory that its texts take.
    pub fn bytes(&self) -> usize {
        let properties = self.properties.iter();
        let properties: usize = properties.map(|(key, value)| key.len() + value.len()).sum();
        self.kind.len() + self.id.len() + self.device.len() + properties
    }

    /// A `foxglove.Event` message.
    pub(super) fn message(&self) -> foxglove::Event {
        use foxglove::event_property::Type;
        let seconds = i64::try_from(self.time.nanos() / 1_000_000_000).unwrap_or(i64::MAX);
        let nanos = i32::try_from(self.time.nanos() % 1_000_000_000).unwrap_or(0);
        let properties = self.properties.iter().map(|(key, value)| foxglove::EventProperty {
            key: (*key).to_owned(),
            r#type: Type::Text as i32,
            value: value.clone(),
        });
        foxglove::Event {
            timestamp: Some(prost_types::Timestamp { seconds, nanos }),
            duration: None,
            event_type: Some(foxglove::EventType {
                name: self.kind.clone(),
                color: None,
                id: None,
            }),
            event_properties: properties.collect(),
            id: self.id.clone(),
            device_id: self.device.clone(),
        }
    }
}
