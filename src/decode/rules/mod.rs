//! Rules beside a database: a TOML file that names a DBC file and says what that cannot say.
//!
//! The language is described in `docs/protocols.md`; fields are written as in definitions of serial
//! protocols.

mod answers;
mod assemblies;
mod compile;
mod forms;

pub use forms::{Rules, is_can};
