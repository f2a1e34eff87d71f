//! The schema once more, as Arrow has it: `ARROW:schema` in the metadata of a file. Parquet itself
//! has no place for units and comments of columns; pyarrow, pandas and polars show them from here,
//! and read texts of value tables as categories.
//!
//! Source: Apache Arrow, `format/Schema.fbs` and `format/Message.fbs`, "Encapsulated message format".

use flatbuffers::{FlatBufferBuilder, TableFinishedWIPOffset, WIPOffset};

use crate::export::table::{Kind, Table};
use crate::export::text::put_base64;

/// Place of field number `index` of a table.
const fn slot(index: u16) -> u16 {
    4 + 2 * index
}

// Members of the union `Type`.
const INT: u8 = 2;
const FLOATING_POINT: u8 = 3;
const BINARY: u8 = 4;
const UTF8: u8 = 5;
const TIMESTAMP: u8 = 10;
/// `MetadataVersion.V5`.
const VERSION: i16 = 4;
/// Member `Schema` of the union `MessageHeader`.
const SCHEMA: u8 = 1;
/// `TimeUnit.NANOSECOND`.
const NANOSECOND: i16 = 3;

type Offset = WIPOffset<TableFinishedWIPOffset>;

/// Base64 of the encapsulated message. `facts` are what is known about the table as a whole: readers
/// of Arrow's schema take them from here only.
pub fn arrow_schema(table: &Table, facts: &[(String, String)]) -> String {
    let mut builder = Builder { flat: FlatBufferBuilder::new(), dictionaries: 0 };
    let mut fields = vec![builder.time()];
    for column in &table.columns {
        let texts = column.kind == Kind::Text && column.few_values;
        let facts = [("unit", column.unit.as_str()), ("comment", &column.comment)];
        fields.push(builder.field(&column.name, column.kind, texts, &facts));
        if column.labels.is_some() {
            fields.push(builder.field(&column.label_name(), Kind::Text, true, &[]));
        }
    }
    let facts: Vec<Offset> = facts.iter().map(|(key, text)| builder.fact(key, text)).collect();
    let flat = &mut builder.flat;
    let fields = flat.create_vector(&fields);
    let facts = flat.create_vector(&facts);
    let start = flat.start_table();
    flat.push_slot_always(slot(1), fields);
    flat.push_slot_always(slot(2), facts);
    let schema = flat.end_table(start);
    let start = flat.start_table();
    flat.push_slot_always(slot(3), 0_i64);
    flat.push_slot_always(slot(2), schema);
    flat.push_slot_always(slot(0), VERSION);
    flat.push_slot_always(slot(1), SCHEMA);
    let message = flat.end_table(start);
    flat.finish_minimal(message);
    let message = flat.finished_data();
    let padded = message.len().next_multiple_of(8);
    let mut bytes = vec![0xFF; 4];
    bytes.extend_from_slice(&u32::try_from(padded).unwrap_or(u32::MAX).to_le_bytes());
    bytes.extend_from_slice(message);
    bytes.resize(8 + padded, 0);
    let mut text = Vec::new();
    put_base64(&mut text, &bytes);
    String::from_utf8(text).unwrap_or_default()
}

struct Builder {
    flat: FlatBufferBuilder<'static>,
    /// Dictionaries so far, which are known by their number.
    dictionaries: i64,
}

impl Builder {
    fn time(&mut self) -> Offset {
        let zone = self.flat.create_string("UTC");
        let start = self.flat.start_table();
        self.flat.push_slot_always(slot(1), zone);
        self.flat.push_slot_always(slot(0), NANOSECOND);
        let kind = self.flat.end_table(start);
        self.finish_field("time", false, (TIMESTAMP, kind), None, &[])
    }

    fn field(&mut self, name: &str, kind: Kind, texts: bool, facts: &[(&str, &str)]) -> Offset {
        let kind = match kind {
            Kind::Unsigned(bits) => (INT, self.integer(width(bits), false)),
            Kind::Signed(bits) => (INT, self.integer(width(bits), true)),
            Kind::Float32 => (FLOATING_POINT, self.float(1)),
            Kind::Float64 => (FLOATING_POINT, self.float(2)),
            Kind::Text => (UTF8, self.empty()),
            Kind::Bytes => (BINARY, self.empty()),
        };
        let dictionary = texts.then(|| {
            let index = self.integer(32, true);
            let start = self.flat.start_table();
            self.flat.push_slot_always(slot(0), self.dictionaries);
            self.flat.push_slot_always(slot(1), index);
            self.dictionaries += 1;
            self.flat.end_table(start)
        });
        self.finish_field(name, true, kind, dictionary, facts)
    }

    fn finish_field(
        &mut self,
        name: &str,
        nullable: bool,
        (member, kind): (u8, Offset),
        dictionary: Option<Offset>,
        facts: &[(&str, &str)],
    ) -> Offset {
        let name = self.flat.create_string(name);
        let said = facts.iter().filter(|(_, text)| !text.is_empty());
        let facts: Vec<Offset> = said.map(|(key, text)| self.fact(key, text)).collect();
        let facts = self.flat.create_vector(&facts);
        // Readers want the list of children even where there are none.
        let children = self.flat.create_vector::<WIPOffset<TableFinishedWIPOffset>>(&[]);
        let start = self.flat.start_table();
        self.flat.push_slot_always(slot(0), name);
        self.flat.push_slot_always(slot(3), kind);
        if let Some(dictionary) = dictionary {
            self.flat.push_slot_always(slot(4), dictionary);
        }
        self.flat.push_slot_always(slot(5), children);
        self.flat.push_slot_always(slot(6), facts);
        self.flat.push_slot_always(slot(1), nullable);
        self.flat.push_slot_always(slot(2), member);
        self.flat.end_table(start)
    }

    fn fact(&mut self, key: &str, text: &str) -> Offset {
        let (key, text) = (self.flat.create_string(key), self.flat.create_string(text));
        let start = self.flat.start_table();
        self.flat.push_slot_always(slot(0), key);
        self.flat.push_slot_always(slot(1), text);
        self.flat.end_table(start)
    }

    fn integer(&mut self, bits: i32, signed: bool) -> Offset {
        let start = self.flat.start_table();
        self.flat.push_slot_always(slot(0), bits);
        self.flat.push_slot_always(slot(1), signed);
        self.flat.end_table(start)
    }

    fn float(&mut self, precision: i16) -> Offset {
        let start = self.flat.start_table();
        self.flat.push_slot_always(slot(0), precision);
        self.flat.end_table(start)
    }

    fn empty(&mut self) -> Offset {
        let start = self.flat.start_table();
        self.flat.end_table(start)
    }
}

/// Bits of the smallest type that has so many.
pub fn width(bits: u8) -> i32 {
    match bits {
        0..=8 => 8,
        9..=16 => 16,
        17..=32 => 32,
        _ => 64,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::table::Column;

    #[test]
    fn a_schema_is_a_whole_number_of_words() {
        let column = Column { name: "Speed".to_owned(), ..Column::default() };
        let table = Table { columns: vec![column], ..Table::default() };
        // 0xFFFFFFFF, then the length.
        assert!(arrow_schema(&table, &[]).starts_with("/////"));
    }
}
