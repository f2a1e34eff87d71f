//! What a recording says of its making.

use crate::recording::definition::Facts;

/// What everybody will want to know about a file in a year.
pub fn about() -> Facts {
    let mut facts = Facts::from([
        ("format".to_owned(), "1".to_owned()),
        ("recorder".to_owned(), format!("bustape {}", env!("CARGO_PKG_VERSION"))),
    ]);
    let files = [
        ("session_id", "/proc/sys/kernel/random/uuid"),
        ("boot_id", "/proc/sys/kernel/random/boot_id"),
        ("host", "/proc/sys/kernel/hostname"),
        ("kernel", "/proc/sys/kernel/osrelease"),
    ];
    for (name, path) in files {
        // A sandbox may hide them; a recording is worth more than its description.
        if let Ok(text) = std::fs::read_to_string(path) {
            facts.insert(name.to_owned(), text.trim().to_owned());
        }
    }
    facts
}
