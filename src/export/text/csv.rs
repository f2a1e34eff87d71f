//! Comma-separated values: RFC 4180, with other separators on request.

use std::io;

use super::{Clock, Known, TimeStyle, put_float, put_hex, put_integer};
use crate::export::rows::FlatWriter;
use crate::export::stream::Stream;
use crate::export::table::{Kind, Row, Table, Value};
use crate::frame::Timestamp;
use crate::text::printable;

/// How values are written.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    /// Between columns; ASCII.
    pub separator: u8,
    /// 1,5 instead of 1.5, in numbers.
    pub decimal_comma: bool,
    /// Units in the names of columns.
    pub units: bool,
    /// Times.
    pub time: TimeStyle,
}

/// Appends the names of the columns.
pub fn put_head(out: &mut Vec<u8>, table: &Table, style: Style) {
    out.extend_from_slice(b"time");
    for column in &table.columns {
        out.push(style.separator);
        if style.units && !column.unit.is_empty() {
            put_text(out, &format!("{} [{}]", column.name, column.unit), style.separator);
        } else {
            put_text(out, &column.name, style.separator);
        }
        if column.labels.is_some() {
            out.push(style.separator);
            put_text(out, &column.label_name(), style.separator);
        }
    }
    out.extend_from_slice(b"\r\n");
}

/// Appends a row; what is absent is empty.
pub fn put_row(
    out: &mut Vec<u8>,
    table: &Table,
    known: &Known,
    clock: &mut Clock,
    (time, row): (Timestamp, &Row),
    style: Style,
) {
    let start = out.len();
    clock.put(out, time);
    if style.time == TimeStyle::Epoch {
        with_comma(out, start, style);
    }
    for (column, cell) in table.columns.iter().zip(&row.cells) {
        out.push(style.separator);
        match cell.value {
            Value::Absent => {}
            Value::Unsigned(number) => put_integer(out, number),
            Value::Signed(number) => put_integer(out, number),
            Value::Float(number) if number.is_nan() => out.extend_from_slice(b"NaN"),
            Value::Float(number) if number.is_infinite() => {
                out.extend_from_slice(if number > 0.0 { b"inf" } else { b"-inf" });
            }
            Value::Float(number) => {
                let start = out.len();
                put_float(out, number, column.kind == Kind::Float32);
                with_comma(out, start, style);
            }
            Value::Text(..) if column.kind == Kind::Bytes => put_hex(out, row.bytes(cell.value)),
            Value::Text(..) => {
                put_text(out, &String::from_utf8_lossy(row.bytes(cell.value)), style.separator);
            }
            Value::Known(text) => out.extend_from_slice(known.get(text)),
        }
        if let Some(labels) = &column.labels {
            out.push(style.separator);
            if let Some(text) = cell.label.and_then(|label| labels.get(label as usize)) {
                put_text(out, text, style.separator);
            }
        }
    }
    out.extend_from_slice(b"\r\n");
}

/// Makes a comma of the point behind `start`.
fn with_comma(out: &mut [u8], start: usize, style: Style) {
    if style.decimal_comma
        && let Some(point) = out[start..].iter_mut().rev().find(|byte| **byte == b'.')
    {
        *point = b',';
    }
}

/// Appends a text from outside. A spreadsheet takes what begins with `=`, `+`, `-` or `@` for a
/// formula (also behind blanks): those get an apostrophe in front, which spreadsheets hide. Control
/// characters, which could drive a terminal, are escaped.
pub fn put_text(out: &mut Vec<u8>, text: &str, separator: u8) {
    let harmless = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b' ' | b'.');
    if text.bytes().all(|byte| harmless(byte) && byte != separator) {
        out.extend_from_slice(text.as_bytes());
        return;
    }
    let formula = text
        .trim_start()
        .starts_with(['=', '+', '-', '@', '\u{FF1D}', '\u{FF0B}', '\u{FF0D}', '\u{FF20}']);
    let number = text.parse::<f64>().is_ok();
    let text = printable(text);
    let quoted = text.bytes().any(|byte| byte == separator || matches!(byte, b'"' | b',' | b';'));
    if quoted {
        out.push(b'"');
    }
    if formula && !number {
        out.push(b'\'');
    }
    for byte in text.bytes() {
        if byte == b'"' {
            out.push(b'"');
        }
        out.push(byte);
    }
    if quoted {
        out.push(b'"');
    }
}

/// One table as CSV.
pub struct CsvWriter {
    table: Table,
    stream: Stream,
    clock: Clock,
    known: Known,
    style: Style,
}

impl CsvWriter {
    /// To `stream`.
    pub fn new(table: Table, stream: Stream, style: Style) -> Self {
        Self { table, stream, clock: Clock::new(style.time), known: Known::default(), style }
    }
}

impl FlatWriter for CsvWriter {
    fn know(&mut self, text: &str) -> u32 {
        let mut written = Vec::new();
        put_text(&mut written, text, self.style.separator);
        self.known.add(written)
    }

    fn row(&mut self, time: Timestamp, row: &Row) -> io::Result<()> {
        let new = self.stream.at(time)?;
        let out = self.stream.buffer();
        if new {
            put_head(out, &self.table, self.style);
        }
        put_row(out, &self.table, &self.known, &mut self.clock, (time, row), self.style);
        self.stream.pass_on()
    }

    fn finish(&mut self) -> io::Result<()> {
        if self.stream.begin_empty() {
            put_head(self.stream.buffer(), &self.table, self.style);
        }
        self.stream.finish()
    }

    fn files(&self) -> u64 {
        self.stream.files()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str, separator: u8) -> String {
        let mut out = Vec::new();
        put_text(&mut out, text, separator);
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn text_is_never_a_formula_and_never_drives_a_terminal() {
        assert_eq!(text("=1+1", b','), "'=1+1");
        assert_eq!(text("@SUM(A1;\"x\")", b','), "\"'@SUM(A1;\"\"x\"\")\"");
        assert_eq!(text(" -cmd|' /C calc'!A0", b','), "' -cmd|' /C calc'!A0");
        assert_eq!(text("\t=1", b','), "'\\u{9}=1");
        assert_eq!(text("-12.5", b','), "-12.5");
        assert_eq!(text("a\x1b[2J\r\nb", b','), "a\\u{1b}[2J\\u{d}\\u{a}b");
    }

    #[test]
    fn text_is_quoted_when_it_must_be() {
        assert_eq!(text("a,b", b','), "\"a,b\"");
        assert_eq!(text("a|b", b','), "a|b");
        assert_eq!(text("a|b", b'|'), "\"a|b\"");
        assert_eq!(text("say \"no\"", b','), "\"say \"\"no\"\"\"");
        assert_eq!(text("N\u{b7}m", b','), "N\u{b7}m");
    }
}
