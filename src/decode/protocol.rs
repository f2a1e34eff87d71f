//! Which protocol a person means: `hmi-can`, `FILE.dbc`, `FILE.dbc:j1939`, `FILE.toml`.

use std::path::PathBuf;

/// The state, commands and settings of the hybrid solar power station.
pub const HMI_CAN: &str = include_str!("../../schemas/hmi-can.dbc");

/// What [`HMI_CAN`] cannot say.
pub const HMI_CAN_RULES: &str = include_str!("../../schemas/hmi-can.toml");

/// Where a CAN protocol comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CanProtocol {
    /// Part of this program.
    BuiltIn {
        /// Its name.
        name: &'static str,
        /// The DBC file.
        database: &'static str,
        /// The TOML file.
        rules: &'static str,
    },
    /// A database of the user.
    File {
        /// The DBC file.
        path: PathBuf,
        /// Recognise 29-bit identifiers by their J1939 parameter group number.
        j1939: bool,
    },
    /// Rules of the user, which name their database.
    Rules {
        /// The TOML file.
        path: PathBuf,
    },
}

impl CanProtocol {
    /// Understands a PROTOCOL of the command line; `None` when it is none for CAN. Of a `.toml` file
    /// only its content tells (see [`super::rules::is_can`]).
    pub fn parse(text: &str) -> Option<Result<Self, String>> {
        if text == "hmi-can" {
            let (database, rules) = (HMI_CAN, HMI_CAN_RULES);
            return Some(Ok(Self::BuiltIn { name: "hmi-can", database, rules }));
        }
        let is = |name: &str, end: &str| name.to_ascii_lowercase().ends_with(end);
        if is(text, ".dbc") {
            return Some(Ok(Self::File { path: text.into(), j1939: false }));
        }
        if is(text, ".toml") {
            return Some(Ok(Self::Rules { path: text.into() }));
        }
        let (path, setting) = text.rsplit_once(':')?;
        Some(match setting {
            "j1939" if is(path, ".dbc") => Ok(Self::File { path: path.into(), j1939: true }),
            _ if is(path, ".dbc") => {
                Err(format!("\"{setting}\" is no setting of a .dbc file; the only one is j1939"))
            }
            _ if is(path, ".toml") || path == "hmi-can" => {
                Err(format!("\"{setting}\": a protocol for CAN has no settings here; write {path}"))
            }
            _ => return None,
        })
    }

    /// As a person knows it.
    pub fn name(&self) -> String {
        match self {
            Self::BuiltIn { name, .. } => (*name).to_owned(),
            Self::File { path, .. } | Self::Rules { path } => path.display().to_string(),
        }
    }
}
