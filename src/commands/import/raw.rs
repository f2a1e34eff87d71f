//! The lines that raw bytes were on.

use anyhow::{Result, bail};

use crate::address::check_name;
use crate::cli::import::ImportArgs;
use crate::commands::UsageError;
use crate::frame::Direction;
use crate::import::format::Format;
use crate::import::raw::Line;

/// The name of a line that nobody named.
const UNNAMED: &str = "serial";
/// Faster than any UART, bit/s.
const BAUD_MAX: u32 = 100_000_000;

/// One line for each log; none unless logs are raw bytes.
pub fn lines(args: &ImportArgs) -> Result<Vec<Line>> {
    if args.format != Some(Format::Raw) {
        if args.baud.is_some() {
            bail!(UsageError("--baud is for bytes of a serial line; add --format raw".to_owned()));
        }
        return Ok(Vec::new());
    }
    let Some(speed) = &args.baud else {
        bail!(UsageError(
            "--format raw needs --baud, such as --baud 19200,8N1: raw bytes have no times, so how \
             fast they came must be said"
                .to_owned()
        ));
    };
    let (baud, bits) = parse(speed).map_err(UsageError)?;
    let names: Vec<&str> = args.buses.iter().map(String::as_str).collect();
    let names = match names[..] {
        [] => vec![UNNAMED; args.logs.len()],
        [name] => vec![name; args.logs.len()],
        _ if names.len() == args.logs.len() => names,
        _ => bail!(UsageError(format!(
            "{} --bus for {} logs: give one for each, in their order, or one for all",
            names.len(),
            args.logs.len()
        ))),
    };
    names.into_iter().map(|name| line(name, baud, bits)).collect()
}

fn line(text: &str, baud: u32, bits: u32) -> Result<Line> {
    let (bus, direction) = match text.split_once(':') {
        None | Some((_, "rx")) => (text.trim_end_matches(":rx"), Direction::Rx),
        Some((bus, "tx")) => (bus, Direction::Tx),
        Some((_, other)) => {
            bail!(UsageError(format!("--bus {text}: \"{other}\" is neither rx nor tx")));
        }
    };
    check_name(bus).map_err(|why| UsageError(format!("--bus {text}: {why}")))?;
    Ok(Line { bus: bus.to_owned(), direction, baud, bits })
}

/// Bits per second, and the bits of a character: a start bit, the data, a parity bit, stop bits.
fn parse(text: &str) -> Result<(u32, u32), String> {
    let wrong = || format!("--baud {text}: write it like 19200 or 19200,8N1");
    let (baud, form) = text.split_once(',').unwrap_or((text, "8N1"));
    let baud = baud.parse().ok().filter(|baud| (1..=BAUD_MAX).contains(baud)).ok_or_else(wrong)?;
    let [data @ b'5'..=b'9', parity, stop @ b'1'..=b'2'] = form.as_bytes() else {
        return Err(wrong());
    };
    let parity = match parity.to_ascii_uppercase() {
        b'N' => 0,
        b'E' | b'O' | b'M' | b'S' => 1,
        _ => return Err(wrong()),
    };
    Ok((baud, 1 + u32::from(data - b'0') + parity + u32::from(stop - b'0')))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_character_has_as_many_bits_as_its_settings_say() {
        assert_eq!(parse("19200"), Ok((19200, 10)));
        assert_eq!(parse("9600,8E1"), Ok((9600, 11)));
        assert_eq!(parse("9600,7n2"), Ok((9600, 10)));
        for bad in ["", "0", "fast", "9600,", "9600,8X1", "9600,8N3", "9600,88N1"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }
}
