//! Which protocol a person means: `hmi-can`, `FILE.dbc`, `FILE.dbc:j1939`.

use std::path::PathBuf;

/// The state, commands and settings of the hybrid solar power station.
pub const HMI_CAN: &str = include_str!("../../schemas/hmi-can.dbc");

/// Where a CAN database comes from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CanProtocol {
    /// Part of this program.
    BuiltIn {
        /// Its name.
        name: &'static str,
        /// The DBC file.
        text: &'static str,
    },
    /// A file of the user.
    File {
        /// The DBC file.
        path: PathBuf,
        /// Recognise 29-bit identifiers by their J1939 parameter group number.
        j1939: bool,
    },
}

impl CanProtocol {
    /// Understands a PROTOCOL of the command line; `None` when it is none for CAN.
    pub fn parse(text: &str) -> Option<Result<Self, String>> {
        if text == "hmi-can" {
            return Some(Ok(Self::BuiltIn { name: "hmi-can", text: HMI_CAN }));
        }
        let is_dbc = |name: &str| name.to_ascii_lowercase().ends_with(".dbc");
        if is_dbc(text) {
            return Some(Ok(Self::File { path: text.into(), j1939: false }));
        }
        let (path, setting) = text.rsplit_once(':').filter(|(path, _)| is_dbc(path))?;
        Some(match setting {
            "j1939" => Ok(Self::File { path: path.into(), j1939: true }),
            _ => Err(format!("\"{setting}\" is no setting of a .dbc file; the only one is j1939")),
        })
    }

    /// As a person knows it.
    pub fn name(&self) -> String {
        match self {
            Self::BuiltIn { name, .. } => (*name).to_owned(),
            Self::File { path, .. } => path.display().to_string(),
        }
    }
}
