//! InfluxDB line protocol: `message,bus=can0 Speed=12.5,Gear=3i,Gear_label="D" 1700000000000000000`.

use std::io;

use super::prepared::{Escape, Tables};
use super::{put_float, put_integer, text_of};
use crate::export::rows::RowWriter;
use crate::export::stream::Stream;
use crate::export::table::{Column, Kind, Row, Table, Value};
use crate::frame::Timestamp;
use crate::text::printable;

/// Writes a line for each row: the message is the measurement, the bus a tag, signals are fields.
/// Columns of integers without sign that need 64 bits get the suffix `u`, other integers `i`.
pub struct InfluxWriter {
    stream: Stream,
    tables: Tables,
}

impl InfluxWriter {
    /// To `stream`.
    pub fn new(stream: Stream) -> Self {
        Self { stream, tables: Tables::default() }
    }
}

struct Lines;

impl Escape for Lines {
    fn head(table: &Table, out: &mut Vec<u8>) {
        // A measurement may not begin with an underscore, nor a line with #.
        if table.message.starts_with(['_', '#']) {
            out.push(b'm');
        }
        put_name(out, &table.message, b", ");
        out.extend_from_slice(b",bus=");
        put_name(out, &table.bus, b",= ");
    }

    fn name(name: &str, out: &mut Vec<u8>) {
        put_name(out, name, b",= ");
        out.push(b'=');
    }

    fn text(text: &str, out: &mut Vec<u8>) {
        put_string(out, text);
    }
}

/// Appends a name with a backslash before each of `special`; control characters, which no name may
/// have, are escaped first. A backslash at the end would escape what follows, so it becomes `/`.
fn put_name(out: &mut Vec<u8>, name: &str, special: &[u8]) {
    let name = printable(name);
    let name = match name.strip_suffix('\\') {
        Some(rest) => format!("{rest}/"),
        None => name,
    };
    for byte in name.bytes() {
        if special.contains(&byte) {
            out.push(b'\\');
        }
        out.push(byte);
    }
}

fn put_string(out: &mut Vec<u8>, text: &str) {
    out.push(b'"');
    for byte in printable(text).bytes() {
        if matches!(byte, b'"' | b'\\') {
            out.push(b'\\');
        }
        out.push(byte);
    }
    out.push(b'"');
}

fn put_value(out: &mut Vec<u8>, column: &Column, row: &Row, value: Value) {
    match value {
        // Rows of messages have no texts that the writer knows.
        Value::Absent | Value::Known(_) => {}
        Value::Unsigned(number) => {
            put_integer(out, number);
            out.push(if column.kind == Kind::Unsigned(64) { b'u' } else { b'i' });
        }
        Value::Signed(number) => {
            put_integer(out, number);
            out.push(b'i');
        }
        Value::Float(number) => put_float(out, number, column.kind == Kind::Float32),
        Value::Text(..) => put_string(out, &text_of(row, value, column.kind == Kind::Bytes)),
    }
}

impl RowWriter for InfluxWriter {
    fn row(&mut self, number: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()> {
        self.stream.at(time)?;
        let Some(names) = self.tables.of::<Lines>(number, table) else { return Ok(()) };
        let out = self.stream.buffer();
        let start = out.len();
        out.extend_from_slice(&names.head);
        let (index, values) = table.values(row);
        if let Some(index) = index {
            // A tag: InfluxDB keeps one line of those that have the same tags and time.
            out.extend_from_slice(b",index=");
            put_integer(out, index);
        }
        let mut before = b' ';
        let named = names.columns.iter_mut().skip(usize::from(table.repeats));
        for ((column, cell), named) in values.zip(named) {
            // The protocol has no numbers that are not finite.
            let absent = match cell.value {
                Value::Absent => true,
                Value::Float(number) => !number.is_finite(),
                _ => false,
            };
            if absent {
                continue;
            }
            out.push(std::mem::replace(&mut before, b','));
            out.extend_from_slice(&named.name);
            put_value(out, column, row, cell.value);
            if let Some((name, text)) = named.label::<Lines>(column, *cell) {
                out.push(b',');
                out.extend_from_slice(name);
                out.extend_from_slice(text);
            }
        }
        if before == b' ' {
            // A line without fields is none.
            out.truncate(start);
            return Ok(());
        }
        out.push(b' ');
        put_integer(out, time.nanos());
        out.push(b'\n');
        self.stream.pass_on()
    }

    fn finish(&mut self) -> io::Result<()> {
        self.stream.finish()
    }

    fn files(&self) -> u64 {
        self.stream.files()
    }
}
