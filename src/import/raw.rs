//! Bytes of a serial line without anything else: what a terminal program or logic analyser saved.

use std::io::{ErrorKind, Read};

use super::{ImportError, LogFrame, LogReader, Settings, Skipped};
use crate::frame::{Direction, Frame, SerialBytes, Stamped, Timestamp};

/// Bytes given as one read: some 13 ms at 19200 baud.
const PIECE: usize = 25;
/// Most pieces given at once.
const BATCH: usize = 2048;

/// The line that the bytes were on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Its name.
    pub bus: String,
    /// Which way the bytes went.
    pub direction: Direction,
    /// Bits a second, at least 1.
    pub baud: u32,
    /// Bits of a character on the line, start, parity and stop bits among them.
    pub bits: u32,
}

/// Reads a log.
pub struct Reader {
    input: Box<dyn Read>,
    line: Line,
    names: [String; 1],
    /// Bytes given so far.
    given: u64,
    skipped: Skipped,
    notes: Vec<String>,
}

/// A log of the line that `settings` tell of.
pub fn open(input: Box<dyn Read>, settings: &Settings) -> Result<Reader, ImportError> {
    let line = settings.line.clone().ok_or_else(|| {
        ImportError::Format(
            "raw bytes have no times: --baud (such as 19200,8N1) says how fast they came"
                .to_owned(),
        )
    })?;
    let names = [line.bus.clone()];
    let notes = vec![format!("times are those of bytes without pauses at {} baud", line.baud)];
    Ok(Reader { input, line, names, given: 0, skipped: Skipped::default(), notes })
}

impl LogReader for Reader {
    fn read(&mut self, into: &mut Vec<LogFrame>) -> Result<bool, ImportError> {
        let mut bytes = Vec::with_capacity(PIECE * BATCH);
        let read = self.input.by_ref().take((PIECE * BATCH) as u64).read_to_end(&mut bytes);
        let more = match read {
            Ok(count) => count == PIECE * BATCH,
            Err(error)
                if matches!(error.kind(), ErrorKind::InvalidData | ErrorKind::UnexpectedEof) =>
            {
                let at = self.given + bytes.len() as u64;
                self.skipped.add(|| format!("byte {at}"), || error.to_string());
                false
            }
            Err(error) => return Err(error.into()),
        };
        for piece in bytes.chunks(PIECE) {
            self.given += piece.len() as u64;
            // As with a port: the time is that of the last byte's end.
            let bits = u128::from(self.given) * u128::from(self.line.bits);
            let nanos = bits * 1_000_000_000 / u128::from(self.line.baud.max(1));
            let time = Timestamp(u64::try_from(nanos).unwrap_or(u64::MAX));
            let (direction, data) = (self.line.direction, piece.to_vec());
            let value = Frame::Serial(SerialBytes { direction, data, errors: Vec::new() });
            into.push(LogFrame { bus: 0, frame: Stamped { time, value } });
        }
        Ok(more)
    }

    fn buses(&self) -> &[String] {
        &self.names
    }

    fn skipped(&self) -> &Skipped {
        &self.skipped
    }

    fn times_are_relative(&self) -> bool {
        true
    }

    fn notes(&self) -> &[String] {
        &self.notes
    }
}
