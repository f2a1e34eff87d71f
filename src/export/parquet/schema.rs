//! What a Parquet file says of its columns, and how they are encoded.

use std::sync::Arc;

use parquet::basic::{
    Compression, Encoding, LogicalType, Repetition, TimeUnit, Type as Physical, ZstdLevel,
};
use parquet::errors::Result;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties, WriterPropertiesPtr};
use parquet::schema::types::{ColumnPath, Type, TypePtr};

use crate::export::table::{Column, Kind, Table};

/// Integers of so many bits have few enough values for a dictionary.
const FEW_VALUES: u8 = 8;

/// The columns of a file: `time`, then a column or two for each signal.
pub fn schema(columns: &[Column]) -> Result<TypePtr> {
    let stamp = LogicalType::timestamp(true, TimeUnit::NANOS);
    let time = Type::primitive_type_builder("time", Physical::INT64)
        .with_logical_type(Some(stamp))
        .with_repetition(Repetition::REQUIRED);
    let mut fields = vec![Arc::new(time.build()?)];
    for column in columns {
        fields.push(field(&column.name, column.kind)?);
        if column.labels.is_some() {
            fields.push(field(&column.label_name(), Kind::Text)?);
        }
    }
    Ok(Arc::new(Type::group_type_builder("table").with_fields(fields).build()?))
}

fn field(name: &str, kind: Kind) -> Result<TypePtr> {
    let width = |bits: u8| match bits {
        0..=8 => 8,
        9..=16 => 16,
        17..=32 => 32,
        _ => 64,
    };
    let integer = |bits, signed| Some(LogicalType::integer(width(bits), signed));
    let whole = |bits| if bits <= 32 { Physical::INT32 } else { Physical::INT64 };
    let (physical, logical) = match kind {
        Kind::Unsigned(bits) => (whole(bits), integer(bits, false)),
        Kind::Signed(bits) => (whole(bits), integer(bits, true)),
        Kind::Float32 => (Physical::FLOAT, None),
        Kind::Float64 => (Physical::DOUBLE, None),
        Kind::Text => (Physical::BYTE_ARRAY, Some(LogicalType::String)),
        Kind::Bytes => (Physical::BYTE_ARRAY, None),
    };
    let field = Type::primitive_type_builder(name, physical)
        .with_logical_type(logical)
        .with_repetition(Repetition::OPTIONAL);
    Ok(Arc::new(field.build()?))
}

/// How the columns are encoded and compressed, and what the file says about its table.
pub fn properties(table: &Table, level: i32) -> Result<WriterPropertiesPtr> {
    let mut properties = WriterProperties::builder()
        .set_created_by(format!("bustape {}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(level)?))
        .set_dictionary_enabled(false)
        // Of each row group; those of pages would stay in memory until the file is finished.
        .set_statistics_enabled(EnabledStatistics::Chunk)
        .set_offset_index_disabled(true)
        .set_key_value_metadata(Some(facts(table)))
        .set_column_encoding(ColumnPath::from("time"), Encoding::DELTA_BINARY_PACKED);
    for column in &table.columns {
        let path = ColumnPath::new(vec![column.name.clone()]);
        properties = match column.kind {
            Kind::Unsigned(bits) | Kind::Signed(bits) if bits > FEW_VALUES => {
                properties.set_column_encoding(path, Encoding::DELTA_BINARY_PACKED)
            }
            Kind::Unsigned(_) | Kind::Signed(_) | Kind::Text => {
                properties.set_column_dictionary_enabled(path, true)
            }
            Kind::Float32 | Kind::Float64 => properties.set_column_encoding(path, Encoding::PLAIN),
            Kind::Bytes => properties,
        };
        if column.labels.is_some() {
            let path = ColumnPath::new(vec![column.label_name()]);
            properties = properties.set_column_dictionary_enabled(path, true);
        }
    }
    Ok(Arc::new(properties.build()))
}

/// What is known about the table, as key and value metadata of the file.
fn facts(table: &Table) -> Vec<KeyValue> {
    let mut facts = Vec::new();
    let mut put = |key: String, text: &str| {
        if !text.is_empty() {
            facts.push(KeyValue::new(key, text.to_owned()));
        }
    };
    put("bustape.bus".to_owned(), &table.bus);
    put("bustape.message".to_owned(), &table.message);
    put("bustape.comment".to_owned(), &table.comment);
    for (name, text) in &table.facts {
        put(format!("bustape.{name}"), text);
    }
    for column in &table.columns {
        put(format!("bustape.unit.{}", column.name), &column.unit);
        put(format!("bustape.comment.{}", column.name), &column.comment);
    }
    facts
}
