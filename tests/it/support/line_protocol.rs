//! InfluxDB line protocol, as InfluxDB's own parser reads it.

use std::fs;
use std::path::Path;

use influxdb_line_protocol::{FieldValue, ParsedLine, parse_lines};
use serde_json::{Map, Value, json};

/// Each line of a file: `measurement`, `tags`, `fields`, `time` in nanoseconds.
pub fn read(path: &Path) -> Vec<Value> {
    let text = fs::read_to_string(path).unwrap();
    parse_lines(&text).map(|line| as_json(&line.unwrap())).collect()
}

fn as_json(line: &ParsedLine<'_>) -> Value {
    let tags = line.series.tag_set.iter().flatten();
    let tags = tags.map(|(key, text)| (key.to_string(), json!(text.as_str())));
    let fields = line.field_set.iter().map(|(key, value)| {
        let value = match value {
            FieldValue::I64(number) => json!(number),
            FieldValue::U64(number) => json!(number),
            FieldValue::F64(number) => json!(number),
            FieldValue::String(text) => json!(text.as_str()),
            FieldValue::Boolean(is) => json!(is),
        };
        (key.to_string(), value)
    });
    json!({
        "measurement": line.series.measurement.as_str(),
        "tags": tags.collect::<Map<_, _>>(),
        "fields": fields.collect::<Map<_, _>>(),
        "time": line.timestamp.unwrap(),
    })
}
