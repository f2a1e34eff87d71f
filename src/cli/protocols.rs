//! `bustape protocols list`, `show` and `layout`.

use clap::Args;

/// Options of `bustape protocols list`.
#[derive(Debug, Args)]
pub struct ListArgs {
    /// Print one JSON object
    #[arg(long)]
    pub json: bool,
}

/// Options of `bustape protocols show`.
#[derive(Debug, Args)]
pub struct ShowArgs {
    /// A built-in name (hmi-can, zhongheng-09), a DBC file, or a definition in TOML
    #[arg(value_name = "PROTOCOL")]
    pub protocol: String,

    /// Only this message or command, with its signals or fields: its name, or its number as in 0x64
    #[arg(value_name = "NAME")]
    pub name: Option<String>,

    /// Print one JSON object
    #[arg(long)]
    pub json: bool,

    /// Print the definition itself; where it is more than one file, each behind its name
    #[arg(long, conflicts_with_all = ["json", "name"])]
    pub source: bool,
}

/// Options of `bustape protocols layout`.
#[derive(Debug, Args)]
pub struct LayoutArgs {
    /// A built-in protocol: hmi-can or zhongheng-09
    #[arg(value_name = "PROTOCOL")]
    pub protocol: String,

    /// Name of the bus in the recording [default: that of the demo, station or rectifier]
    #[arg(long, value_name = "NAME")]
    pub bus: Option<String>,
}
