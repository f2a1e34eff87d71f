//! Triggers: conditions on what happens on the buses, checked while it is recorded.
//!
//! [`Condition`] is what a person writes, [`Triggers`] are all of a recording, resolved against its
//! buses and their definitions before it begins, and [`Commands`] runs what shall be run then.
//! `docs/triggers.md` tells the language.

mod commands;
mod condition;
mod listener;
mod resolve;
mod rule;
mod watch;

pub use commands::Commands;
pub use condition::{Comparison, Condition, What};
pub use listener::Known;
pub use watch::{Fired, Triggers, Window};

/// A trigger as it is configured.
#[derive(Clone, Debug, serde::Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct TriggerForm {
    /// What its events are called; its condition if it has no name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The condition.
    pub when: String,
    /// Once it has fired, it fires again only after this condition has been true.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until: Option<String>,
    /// Shortest time between two firings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hold_off: Option<String>,
    /// Keep what was recorded for this long before as a recording of its own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub before: Option<String>,
    /// The same for what follows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub after: Option<String>,
    /// Program and arguments to run.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub run: Vec<String>,
}

impl TriggerForm {
    /// The keys of its table.
    pub const KEYS: [&str; 7] = ["name", "when", "until", "hold-off", "before", "after", "run"];
}
