//! InfluxDB line protocol: `message,bus=can0 Speed=12.5,Gear=3i,Gear_label="D" 1700000000000000000`.

use std::io;

use super::{put_float, put_integer, text_of};
use crate::export::rows::RowWriter;
use crate::export::stream::Stream;
use crate::export::table::{Kind, Row, Table, Value};
use crate::frame::Timestamp;
use crate::text::printable;

/// Writes a line for each row: the message is the measurement, the bus a tag, signals are fields.
/// Columns of integers without sign that need 64 bits get the suffix `u`, other integers `i`.
pub struct InfluxWriter {
    stream: Stream,
}

impl InfluxWriter {
    /// To `stream`.
    pub fn new(stream: Stream) -> Self {
        Self { stream }
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

impl RowWriter for InfluxWriter {
    fn row(&mut self, _: u32, table: &Table, time: Timestamp, row: &Row) -> io::Result<()> {
        self.stream.at(time)?;
        let out = self.stream.buffer();
        let start = out.len();
        // A measurement may not begin with an underscore, nor a line with #.
        if table.message.starts_with(['_', '#']) {
            out.push(b'm');
        }
        put_name(out, &table.message, b", ");
        out.extend_from_slice(b",bus=");
        put_name(out, &table.bus, b",= ");
        let mut before = b' ';
        for (column, cell) in table.columns.iter().zip(&row.cells) {
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
            put_name(out, &column.name, b",= ");
            out.push(b'=');
            match cell.value {
                Value::Absent => {}
                Value::Unsigned(number) => {
                    put_integer(out, number);
                    out.push(if column.kind == Kind::Unsigned(64) { b'u' } else { b'i' });
                }
                Value::Signed(number) => {
                    put_integer(out, number);
                    out.push(b'i');
                }
                Value::Float(number) => put_float(out, number, column.kind == Kind::Float32),
                Value::Text(..) => {
                    let hex = column.kind == Kind::Bytes;
                    put_string(out, &text_of(row, cell.value, hex).unwrap_or_default());
                }
            }
            let labels = column.labels.as_ref();
            let label = labels.and_then(|labels| labels.get(cell.label? as usize));
            if let Some(text) = label {
                out.push(b',');
                put_name(out, &column.label_name(), b",= ");
                out.push(b'=');
                put_string(out, text);
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
