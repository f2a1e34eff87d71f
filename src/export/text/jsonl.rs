//! JSON lines.

use std::io;

use super::{Clock, TimeStyle, put_float, put_integer, text_of};
use crate::export::rows::{FlatWriter, RowWriter};
use crate::export::stream::Stream;
use crate::export::table::{Cell, Column, Kind, Row, Table, Value};
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
fn put_value(out: &mut Vec<u8>, column: &Column, row: &Row, cell: Cell) {
    match cell.value {
        Value::Unsigned(number) => put_integer(out, number),
        Value::Signed(number) => put_integer(out, number),
        Value::Float(number) if number.is_finite() => {
            put_float(out, number, column.kind == Kind::Float32);
        }
        Value::Absent | Value::Float(_) => out.extend_from_slice(b"null"),
        Value::Text(..) => {
            let text = text_of(row, cell.value, column.kind == Kind::Bytes).unwrap_or_default();
            put_string(out, &text);
        }
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
    style: TimeStyle,
}

impl JsonRows {
    /// To `stream`.
    pub fn new(stream: Stream, style: TimeStyle) -> Self {
        Self { stream, clock: Clock::new(style), style }
    }
}

impl RowWriter for JsonRows {
    fn row(&mut self, _: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()> {
        self.stream.at(time)?;
        let out = self.stream.buffer();
        put_time(out, &mut self.clock, time, self.style);
        out.extend_from_slice(b",\"bus\":");
        put_string(out, &table.bus);
        out.extend_from_slice(b",\"message\":");
        put_string(out, &table.message);
        out.extend_from_slice(b",\"signals\":{");
        let present = || {
            let cells = table.columns.iter().zip(&row.cells);
            cells.filter(|(_, cell)| cell.value != Value::Absent)
        };
        for (number, (column, cell)) in present().enumerate() {
            if number > 0 {
                out.push(b',');
            }
            put_string(out, &column.name);
            out.push(b':');
            put_value(out, column, row, *cell);
        }
        out.extend_from_slice(b"},\"labels\":{");
        let labelled = present().filter_map(|(column, cell)| {
            let labels = column.labels.as_ref()?;
            Some((column, labels.get(cell.label? as usize)?))
        });
        for (number, (column, text)) in labelled.enumerate() {
            if number > 0 {
                out.push(b',');
            }
            put_string(out, &column.name);
            out.push(b':');
            put_string(out, text);
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
    style: TimeStyle,
}

impl JsonFlat {
    /// To `stream`.
    pub fn new(table: Table, stream: Stream, style: TimeStyle) -> Self {
        Self { table, stream, clock: Clock::new(style), style }
    }
}

impl FlatWriter for JsonFlat {
    fn row(&mut self, time: Timestamp, row: &Row) -> io::Result<()> {
        self.stream.at(time)?;
        let out = self.stream.buffer();
        put_time(out, &mut self.clock, time, self.style);
        for (column, cell) in self.table.columns.iter().zip(&row.cells) {
            out.push(b',');
            put_string(out, &column.name);
            out.push(b':');
            put_value(out, column, row, *cell);
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
