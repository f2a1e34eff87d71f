//! `bustape mark` and `bustape status`.

use clap::Args;

/// Options of `bustape mark`.
#[derive(Debug, Args)]
#[command(after_help = "\
The event stands on /bustape/event with the time of the call. A segment that holds an event, and the
one before it, are not deleted by --keep-size, --keep-time or --when-full ring.")]
pub struct MarkArgs {
    /// What happened, up to 4096 bytes
    #[arg(value_name = "TEXT", value_parser = mark_text)]
    pub text: String,

    /// Of the recorder with this --name (or, with --output, this file name) [default: the only one]
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,
}

/// Options of `bustape status`.
#[derive(Debug, Args)]
#[command(
    after_help = "Exit status: 0 all is well, 1 no recorder is running, 3 something was lost."
)]
pub struct StatusArgs {
    /// Only the recorder with this --name (or, with --output, this file name)
    #[arg(long, value_name = "NAME")]
    pub name: Option<String>,

    /// Print a JSON array with one object for each recorder
    #[arg(long)]
    pub json: bool,
}

/// Longest text of a mark, bytes.
pub const LONGEST_MARK: usize = 4096;

fn mark_text(text: &str) -> Result<String, String> {
    if text.trim().is_empty() || text.len() > LONGEST_MARK {
        return Err(format!("give 1 to {LONGEST_MARK} bytes of text"));
    }
    Ok(text.to_owned())
}
