//! What frames say.

use std::sync::Arc;

use super::payload::{Decoded, Field, Payload};
use super::word::Reading;

/// One command of a protocol.
#[derive(Debug)]
pub struct Command {
    /// The numbers that call it; empty for the only command of a protocol without numbers.
    pub ids: Vec<u64>,
    /// Its name.
    pub name: Arc<str>,
    /// What people call it.
    pub title: Option<String>,
    /// Operations that the device's maker names for it; others are decoded all the same.
    pub operations: Vec<String>,
    /// What a request carries beside the command's number.
    pub args: Payload,
    /// What is read or set.
    pub fields: Payload,
    /// A request that says one operation and carries the data of another.
    pub by_data: Option<ByData>,
}

impl Command {
    /// The rule that applies to a request which says `operation` and carries `data`.
    pub fn by_data_of(&self, operation: Option<&Arc<str>>, data: &[u8]) -> Option<&ByData> {
        let rule = self.by_data.as_ref()?;
        (operation == Some(&rule.from) && self.fields.is_whole(data)).then_some(rule)
    }
}

/// A request that says one operation and carries the data of another.
#[derive(Debug)]
pub struct ByData {
    /// What it says.
    pub from: Arc<str>,
    /// What it is.
    pub to: Arc<str>,
    /// Under which name that is told.
    pub mark: Arc<str>,
}

/// What a request asked, as much as its answer needs.
#[derive(Clone, Debug, Default)]
pub struct Asked {
    /// The operation, if it has a name.
    pub operation: Option<Arc<str>>,
    /// The command's number.
    pub id: Option<Reading>,
    /// The command, if it is known.
    pub command: Option<Arc<Command>>,
    /// The decoded `args`.
    pub args: Vec<Field>,
}

/// Why an answer has no request.
pub type Reason = Arc<str>;

/// What a good frame says.
#[derive(Clone, Debug)]
pub enum Message {
    /// A command to a device.
    Request(Request),
    /// A device's answer to a command.
    Response(Response),
    /// A frame that says by itself what it carries.
    Report(Request),
    /// A frame of the asking side that carries no command.
    Link {
        /// What kind of frame it is.
        kind: Option<Reading>,
    },
    /// A frame of the answering side that carries no command's data.
    LinkReply {
        /// What kind of frame it is.
        kind: Option<Reading>,
        /// The frame that it answers.
        answers: Result<Answered, Reason>,
    },
    /// Too short to say anything.
    Malformed {
        /// A request or a response.
        response: bool,
        /// A response only: there was a request for it.
        paired: Option<bool>,
    },
}

impl Message {
    /// The decoded fields of the command.
    pub fn fields(&self) -> &[Field] {
        match self {
            Self::Request(request) | Self::Report(request) => &request.data.fields,
            Self::Response(response) => &response.data.fields,
            Self::Link { .. } | Self::LinkReply { .. } | Self::Malformed { .. } => &[],
        }
    }
}

/// A request, or a report.
#[derive(Clone, Debug)]
pub struct Request {
    /// What is asked.
    pub asked: Asked,
    /// Fields, and how the length fits.
    pub data: Decoded,
    /// Set when the operation is known from the data only.
    pub mark: Option<Arc<str>>,
}

/// The answer to a request.
#[derive(Clone, Debug)]
pub struct Response {
    /// What stands in front of the data.
    pub status: Vec<Reading>,
    /// The request, or why there is none.
    pub asked: Result<Asked, Reason>,
    /// Fields, and how the length fits.
    pub data: Decoded,
}

/// The frame that another frame answers.
#[derive(Clone, Debug)]
pub struct Answered {
    /// What kind of frame it is.
    pub kind: Option<Reading>,
    /// The request in it, if there is one.
    pub asked: Option<Asked>,
}
