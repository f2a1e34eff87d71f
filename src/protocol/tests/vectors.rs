//! The sample vectors of the Zhongheng protocol: bytes, and the items that must be found in them.

use std::sync::Arc;

use serde_json::{Value, json};

use crate::frame::{Direction, Timestamp};
use crate::protocol::{ByteOrder, Decoder, Protocol, Settings, json};

const VECTORS: &str = include_str!("../../../tests/data/zhongheng-vectors.json");

fn decode(order: &str, bytes: &[u8], pieces: impl Iterator<Item = usize>) -> Vec<Value> {
    let byte_order = Some(if order == "little" { ByteOrder::Little } else { ByteOrder::Big });
    let settings = Settings { byte_order, assume: false };
    let protocol = Protocol::built_in("zhongheng-09", settings).unwrap().unwrap();
    let mut decoder = Decoder::new(Arc::new(protocol));
    let mut items = Vec::new();
    let mut take = |item: crate::protocol::Item| items.push(json::item(&item));
    let mut rest = bytes;
    for piece in pieces {
        let (head, tail) = rest.split_at(piece.min(rest.len()));
        decoder.feed(Direction::Rx, Timestamp(0), head, &mut take);
        rest = tail;
    }
    decoder.feed(Direction::Rx, Timestamp(0), rest, &mut take);
    decoder.finish(&mut take);
    items
}

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
}

/// The totals of a stream, counted as the protocol's description says.
fn counts(items: &[Value]) -> Value {
    let count = |good: &dyn Fn(&Value) -> bool| items.iter().filter(|item| good(item)).count();
    let items_of = |kind: &'static str| count(&|item: &Value| item["item"] == kind);
    let kind = |kind: &'static str| count(&|item: &Value| item["message"]["kind"] == kind);
    let from = |who: &'static str| count(&|item: &Value| item["from"] == who);
    let answers = |item: &Value| {
        ["response", "link_reply"].contains(&item["message"]["kind"].as_str().unwrap_or_default())
    };
    let paired =
        |paired: bool| count(&|item: &Value| answers(item) && item["message"]["paired"] == paired);
    let code = |item: &Value| item["message"]["status"]["code"].as_u64().unwrap_or(0);
    let fields = |item: &Value| item["message"]["fields"].as_array().map_or(0, Vec::len);
    let garbage = |item: &Value| {
        if item["item"] == "garbage" { item["bytes"].as_u64().unwrap() } else { 0 }
    };
    json!({
        "frames": items_of("frame"),
        "from_master": from("master"),
        "from_slave": from("slave"),
        "requests": kind("request"),
        "responses": kind("response"),
        "paired": paired(true),
        "unpaired": paired(false),
        "link": kind("link") + kind("link_reply"),
        "malformed": kind("malformed"),
        "link_errors": count(&|item: &Value| item["link_error"].is_string()),
        "error_codes": count(&|item: &Value| code(item) != 0),
        "crc_error": items_of("crc_error"),
        "truncated": items_of("truncated"),
        "bad_escape": items_of("bad_escape"),
        "incomplete": items_of("incomplete"),
        "garbage": items_of("garbage"),
        "garbage_bytes": items.iter().map(garbage).sum::<u64>(),
        "fields": items.iter().map(fields).sum::<usize>(),
    })
}

#[test]
fn every_sample_vector_gives_exactly_its_items() {
    let vectors: Value = serde_json::from_str(VECTORS).unwrap();
    let vectors = vectors["vectors"].as_array().unwrap();
    let mut checked = 0;
    for vector in vectors {
        let id = &vector["id"];
        let order = vector["byte_order"].as_str().unwrap();
        for form in ["wire_full", "wire_min", "wire"] {
            let Some(wire) = vector[form].as_str().map(bytes) else { continue };
            let items_min = vector["items_min"].as_array().filter(|_| form == "wire_min");
            let expected = items_min.unwrap_or_else(|| vector["items"].as_array().unwrap());
            let chunks = vector["chunks"].as_array().into_iter().flatten();
            let chunks = chunks.map(|size| size.as_u64().unwrap() as usize);
            let ways: [Vec<usize>; 3] = [vec![], vec![1; wire.len()], chunks.collect()];
            for pieces in ways {
                let found = decode(order, &wire, pieces.iter().copied());
                for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
                    assert_eq!(found, expected, "{id} {form} item {at}");
                }
                assert_eq!(found.len(), expected.len(), "{id} {form}");
                if let Some(expected) = vector.get("counts") {
                    assert_eq!(&counts(&found), expected, "{id} {form}");
                }
            }
            checked += 1;
        }
    }
    assert_eq!((vectors.len(), checked), (46, 91));
}
