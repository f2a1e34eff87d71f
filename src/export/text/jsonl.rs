//! JSON lines.

use std::io;

use super::prepared::{Escape, Tables};
use super::{Clock, Known, TimeStyle, put_float, put_integer, text_of};
use crate::export::rows::{FlatWriter, RowWriter};
use crate::export::stream::Stream;
use crate::export::table::{Column, Kind, Row, Table, Value};
use crate::frame::Timestamp;
use crate::text::printable_json;

/// Appends a JSON string in which nothing drives a terminal.
fn put_string(out: &mut Vec<u8>, text: &str) {
    let plain = |byte: u8| (0x20..0x7F).contains(&byte) && byte != b'"' && byte != b'\\';
    if text.bytes().all(plain) {
        out.push(b'"');
        out.extend_from_slice(text.as_bytes());
        out.push(b'"');
        return;
    }
    let text = serde_json::Value::from(text).to_string();
    out.extend_from_slice(printable_json(&text).as_bytes());
}

/// Appends a value; JSON has no numbers that are not finite.
fn put_value(out: &mut Vec<u8>, column: &Column, row: &Row, value: Value) {
    match value {
        Value::Unsigned(number) => put_integer(out, number),
        Value::Signed(number) => put_integer(out, number),
        Value::Float(number) if number.is_finite() => {
            put_float(out, number, column.kind == Kind::Float32);
        }
        Value::Text(..) => put_string(out, &text_of(row, value, column.kind == Kind::Bytes)),
        Value::Absent | Value::Known(_) | Value::Float(_) => out.extend_from_slice(b"null"),
    }
}

fn put_time(out: &mut Vec<u8>, clock: &mut Clock, time: Timestamp, style: TimeStyle) {
    out.extend_from_slice(b"{\"time\":");
    let quote = style == TimeStyle::Iso;
    if quote {
        out.push(b'"');
    }
    clock.put(out, time);
    if quote {
        out.push(b'"');
    }
}

/// A line for each time a message was seen: signals and labels in objects of their own, those that
/// are absent left out.
pub struct JsonRows {
    stream: Stream,
    clock: Clock,
    tables: Tables,
    style: TimeStyle,
}

impl JsonRows {
    /// To `stream`.
    pub fn new(stream: Stream, style: TimeStyle) -> Self {
        Self { stream, clock: Clock::new(style), tables: Tables::default(), style }
    }
}

/// A comma between parts.
fn part(out: &mut Vec<u8>, first: &mut bool) {
    if !std::mem::replace(first, false) {
        out.push(b',');
    }
}

struct Objects;

impl Escape for Objects {
    fn head(table: &Table, out: &mut Vec<u8>) {
        out.extend_from_slice(b",\"bus\":");
        put_string(out, &table.bus);
        out.extend_from_slice(b",\"message\":");
        put_string(out, &table.message);
        out.extend_from_slice(b",\"signals\":{");
    }

    fn name(name: &str, out: &mut Vec<u8>) {
        put_string(out, name);
        out.push(b':');
    }

    // Texts stand in an object of their own.
    fn label_name(column: &Column) -> String {
        column.name.clone()
    }

    fn text(text: &str, out: &mut Vec<u8>) {
        put_string(out, text);
    }
}

impl RowWriter for JsonRows {
    fn row(&mut self, number: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()> {
        self.stream.at(time)?;
        let Some(names) = self.tables.of::<Objects>(number, table) else { return Ok(()) };
        let out = self.stream.buffer();
        put_time(out, &mut self.clock, time, self.style);
        out.extend_from_slice(&names.head);
        let cells = || table.columns.iter().zip(&row.cells);
        let mut first = true;
        for ((column, cell), named) in cells().zip(&names.columns) {
            if cell.value != Value::Absent {
                part(out, &mut first);
                out.extend_from_slice(&named.name);
                put_value(out, column, row, cell.value);
            }
        }
        out.extend_from_slice(b"},\"labels\":{");
        let mut first = true;
        for ((column, cell), named) in cells().zip(&mut names.columns) {
            let absent = cell.value == Value::Absent;
            let Some((name, text)) = named.label::<Objects>(column, *cell) else { continue };
            if !absent {
                part(out, &mut first);
                out.extend_from_slice(name);
                out.extend_from_slice(text);
            }
        }
        out.extend_from_slice(b"}}\n");
        self.stream.pass_on()
    }

    fn finish(&mut self) -> io::Result<()> {
        self.stream.finish()
    }

    fn files(&self) -> u64 {
        self.stream.files()
    }
}

/// One table: a key for each column, null where a value is absent.
pub struct JsonFlat {
    table: Table,
    stream: Stream,
    clock: Clock,
    known: Known,
    style: TimeStyle,
}

impl JsonFlat {
    /// To `stream`.
    pub fn new(table: Table, stream: Stream, style: TimeStyle) -> Self {
        Self { table, stream, clock: Clock::new(style), known: Known::default(), style }
    }
}

impl FlatWriter for JsonFlat {
    fn know(&mut self, text: &str) -> u32 {
        let mut written = Vec::new();
        put_string(&mut written, text);
        self.known.add(written)
    }

    fn row(&mut self, time: Timestamp, row: &Row) -> io::Result<()> {
        self.stream.at(time)?;
        let out = self.stream.buffer();
        put_time(out, &mut self.clock, time, self.style);
        for (column, cell) in self.table.columns.iter().zip(&row.cells) {
            out.push(b',');
            put_string(out, &column.name);
            out.push(b':');
            match cell.value {
                Value::Known(text) => out.extend_from_slice(self.known.get(text)),
                value => put_value(out, column, row, value),
            }
        }
        out.extend_from_slice(b"}\n");
        self.stream.pass_on()
    }

    fn finish(&mut self) -> io::Result<()> {
        self.stream.finish()
    }

    fn files(&self) -> u64 {
        self.stream.files()
    }
}
