//! Words to a person on stderr, results on stdout, tables that align.

use std::fmt::Arguments;
use std::io::{self, BufWriter, StdoutLock, Write as _};
use std::os::fd::AsFd as _;
use std::sync::LazyLock;

use anstyle::{AnsiColor, Style};
use comfy_table::{CellAlignment, Table, presets};
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};

use crate::text::printable;

const ERROR: Style = AnsiColor::Red.on_default().bold();
const WARNING: Style = AnsiColor::Yellow.on_default().bold();
const HEADING: Style = Style::new().bold();

/// Where results go, in large pieces.
pub fn stdout() -> BufWriter<StdoutLock<'static>> {
    BufWriter::with_capacity(64 << 10, io::stdout().lock())
}

/// Prints a result on stdout, without colours where that is no terminal.
pub fn result(text: &str) -> io::Result<()> {
    let mut out = anstream::AutoStream::auto(io::stdout().lock());
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(|error| {
        // Its kind tells a reader that has gone away from a full disk.
        io::Error::new(error.kind(), format!("cannot write to stdout: {error}"))
    })
}

/// Why a command failed.
pub fn error(text: &str) {
    if to_journal() {
        return say(format_args!("<3>{}", printable(text)));
    }
    say(format_args!("{ERROR}error{ERROR:#}: {}", printable(text)));
}

/// Something was lost or is not as asked.
pub fn warning(text: &str) {
    if to_journal() {
        return say(format_args!("<4>{}", printable(text)));
    }
    say(format_args!("{WARNING}warning{WARNING:#}: {}", printable(text)));
}

/// Good to know.
pub fn note(text: &str) {
    if to_journal() {
        return say(format_args!("<6>{}", printable(text)));
    }
    say(format_args!("{}", printable(text)));
}

/// One line on stderr. There is nobody to tell that stderr itself is gone or full.
fn say(line: Arguments<'_>) {
    writeln!(anstream::stderr().lock(), "{line}").ok();
}

/// True where stderr goes to systemd's journal, which takes the level from a number in front
/// (sd-daemon(3)); `JOURNAL_STREAM` tells which file that is (systemd.exec(5)).
fn to_journal() -> bool {
    static JOURNAL: LazyLock<bool> = LazyLock::new(|| {
        let stream = std::env::var("JOURNAL_STREAM").unwrap_or_default();
        let about = nix::sys::stat::fstat(io::stderr());
        about.is_ok_and(|about| stream == format!("{}:{}", about.st_dev, about.st_ino))
    });
    *JOURNAL
}

/// False while the terminal behind stderr is stopped (Ctrl-S), or a pipe there is full: a write would
/// wait until somebody goes on.
pub fn takes_text() -> bool {
    let stderr = io::stderr();
    let mut ready = [PollFd::new(stderr.as_fd(), PollFlags::POLLOUT)];
    poll(&mut ready, PollTimeout::ZERO).is_ok_and(|ready| ready > 0)
}

/// A heading on stdout, bold on a terminal.
pub fn heading(out: &mut impl io::Write, text: &str) -> io::Result<()> {
    let mut styled = anstream::AutoStream::auto(io::stdout());
    out.flush()?;
    writeln!(styled, "{HEADING}{text}{HEADING:#}")?;
    styled.flush()
}

/// A table without lines; columns named in `right` align to the right.
pub fn table(head: &[&str], right: &[usize], rows: Vec<Vec<String>>) -> String {
    let mut table = Table::new();
    table.load_preset(presets::NOTHING);
    if !head.is_empty() {
        table.set_header(head);
    }
    for row in rows {
        table.add_row(row.iter().map(|cell| printable(cell)));
    }
    for &column in right {
        if let Some(column) = table.column_mut(column) {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    let text = table.trim_fmt();
    let mut lines = String::with_capacity(text.len());
    for line in text.lines() {
        // The library puts a blank in front of the first column.
        lines.push(' ');
        lines.push_str(line.trim_end());
        lines.push('\n');
    }
    lines
}

/// The reader of our output has gone away, which is its right.
pub fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error
        .chain()
        .filter_map(|cause| cause.downcast_ref::<io::Error>())
        .any(|cause| cause.kind() == io::ErrorKind::BrokenPipe)
}
