//! `bustape explain`: what frames mean.

mod assembly;
mod can;
mod json;
mod plain;
pub mod serial;

use std::io::{BufRead, BufReader, IsTerminal as _, Read as _, Write as _};

use anyhow::{Context as _, Result, bail};

use super::{Ended, UsageError, output, protocols};
use crate::cli::ExplainArgs;
use crate::decode::protocol::CanProtocol;
use can::Explainer;
use protocols::CanFiles;

/// The longest line that can be a frame; 64 bytes of data are 128 digits.
const MAX_LINE: u64 = 4096;
/// Most hexadecimal digits taken from stdin at once; larger captures are read with `--input`.
const MAX_HEX: u64 = 64 << 20;
/// So many oddities of a file, and lines that are no frames, are said; the others are counted.
const SAID: usize = 10;

/// Runs the command.
pub fn run(args: &ExplainArgs) -> Result<Ended> {
    if let Some(protocol) = serial::load(&args.decode)? {
        return explain_serial(protocol, args);
    }
    let protocol = protocols::named(&args.decode)?;
    let loaded = protocols::load(&protocol)?;
    say_oddities(&protocol, &loaded);
    let incomplete = loaded.oddities.lost() > 0;
    let mut explainer = Explainer::new(loaded.definition, args.json);
    if let Some(path) = &args.input {
        explain_lines(&mut explainer, open(path)?, &path.display().to_string())?;
    } else if args.frames.is_empty() {
        if std::io::stdin().is_terminal() {
            output::note("Type frames as candump prints them, one a line; Ctrl-D ends.");
        }
        explain_lines(&mut explainer, Box::new(std::io::stdin().lock()), "stdin")?;
    } else {
        for text in &args.frames {
            if let Err(why) = explainer.line(text)? {
                bail!(UsageError(format!("\"{text}\" is no frame: {why}")));
            }
        }
    }
    let skipped = explainer.finish()?;
    Ok(if incomplete || skipped { Ended::WithLoss } else { Ended::Well })
}

/// Says what is odd in the file of a protocol.
pub fn say_oddities(protocol: &CanProtocol, loaded: &CanFiles) {
    let (name, list) = (protocol.name(), loaded.oddities.list());
    for oddity in list.iter().take(SAID) {
        output::warning(&protocols::oddity_text(&loaded.database, oddity));
    }
    let more = list.len().saturating_sub(SAID) as u64 + loaded.oddities.unlisted();
    if more > 0 {
        output::warning(&format!("{more} more; \"bustape protocols check {name}\" lists them"));
    }
}

/// The bytes of a serial line: hex digits from the command line or stdin, or a file as it is.
fn explain_serial(protocol: crate::protocol::Protocol, args: &ExplainArgs) -> Result<Ended> {
    let mut out = output::stdout();
    if let Some(path) = &args.input {
        serial::explain(protocol, &mut open(path)?, args.json, &mut out)?;
    } else {
        let mut digits = args.frames.join(" ");
        if args.frames.is_empty() {
            std::io::stdin()
                .lock()
                .take(MAX_HEX + 1)
                .read_to_string(&mut digits)
                .context("cannot read hexadecimal digits from stdin; for raw bytes use --input")?;
            if digits.len() as u64 > MAX_HEX {
                bail!(UsageError(format!(
                    "stdin has more than {} MiB of hexadecimal digits; give the bytes themselves \
                     with --input",
                    MAX_HEX >> 20
                )));
            }
        }
        let bytes = serial::from_hex(&digits).map_err(|e| UsageError(e.to_string()))?;
        serial::explain(protocol, &mut &bytes[..], args.json, &mut out)?;
    }
    out.flush()?;
    Ok(Ended::Well)
}

/// A file, or stdin for `-`.
fn open(path: &std::path::Path) -> Result<Box<dyn std::io::Read>> {
    if path.as_os_str() == "-" {
        return Ok(Box::new(std::io::stdin().lock()));
    }
    let file = std::fs::File::open(path);
    Ok(Box::new(file.with_context(|| format!("cannot read {}", path.display()))?))
}

fn explain_lines(
    explainer: &mut Explainer,
    input: Box<dyn std::io::Read>,
    name: &str,
) -> Result<()> {
    let mut input = BufReader::new(input);
    let mut line = Vec::new();
    let mut number = 0_u64;
    while next_line(&mut input, &mut line)? {
        number += 1;
        let text = String::from_utf8_lossy(&line);
        let text = text.trim();
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        if let Err(why) = explainer.line(text)? {
            explainer.skip(&format!("line {number} of {name} is no frame: {why}"));
        }
        // The next read may wait, and somebody for this answer.
        if input.buffer().is_empty() {
            explainer.out.flush()?;
        }
    }
    Ok(())
}

/// The next line; of one that is too long only its beginning.
fn next_line(input: &mut impl BufRead, line: &mut Vec<u8>) -> Result<bool> {
    line.clear();
    let read = input.by_ref().take(MAX_LINE).read_until(b'\n', line);
    if read.context("cannot read stdin")? == 0 {
        return Ok(false);
    }
    while line.last() != Some(&b'\n') && line.len() as u64 == MAX_LINE {
        let mut rest = Vec::new();
        let read = input.by_ref().take(MAX_LINE).read_until(b'\n', &mut rest);
        if read.context("cannot read stdin")? == 0 || rest.last() == Some(&b'\n') {
            break;
        }
    }
    Ok(true)
}
