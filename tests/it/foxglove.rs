//! Layouts for Foxglove and Lichtblick, and the tables that name what they show.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use crate::support::process::bustape;

/// Panels that both viewers have (Lichtblick 1.x and Foxglove name them alike).
const PANELS: [&str; 8] =
    ["Gauge", "Indicator", "Plot", "RawMessages", "RosOut", "StateTransitions", "Tab", "Table"];

fn layout(protocol: &str) -> Value {
    bustape(["protocols", "layout", protocol]).expect(0).json()
}

/// Every text of `value` that is a message path.
fn paths<'a>(value: &'a Value, found: &mut BTreeSet<&'a str>) {
    match value {
        Value::String(text) if text.starts_with('/') => {
            found.insert(text);
        }
        Value::Array(list) => list.iter().for_each(|value| paths(value, found)),
        Value::Object(map) => map.values().for_each(|value| paths(value, found)),
        _ => {}
    }
}

/// The panels that an arrangement shows, those of tabs too.
fn shown(arrangement: &Value, configs: &Value, found: &mut BTreeSet<String>) {
    let Some(id) = arrangement.as_str() else {
        assert!(["row", "column"].contains(&arrangement["direction"].as_str().unwrap()));
        let percent = arrangement["splitPercentage"].as_f64().unwrap();
        assert!((1.0..99.0).contains(&percent));
        shown(&arrangement["first"], configs, found);
        shown(&arrangement["second"], configs, found);
        return;
    };
    assert!(found.insert(id.to_owned()), "{id} is shown twice");
    for tab in configs[id]["tabs"].as_array().into_iter().flatten() {
        shown(&tab["layout"], configs, found);
    }
}

/// What a topic's messages have, with `true` where there is a label too.
fn fields(protocol: &str, topic: &str) -> Option<BTreeMap<String, bool>> {
    let serial = protocol == "zhongheng-09";
    let name = if serial { topic.strip_suffix("_response")? } else { topic };
    let shown = bustape(["protocols", "show", protocol, name, "--json"]);
    let object = (shown.status.code() == Some(0)).then(|| shown.json())?;
    let lists = if serial { ["fields", "args"] } else { ["signals", "signals"] };
    let list = lists.iter().flat_map(|list| object[list].as_array().unwrap());
    let named = list.map(|entry| {
        let name = entry.get("signal").or(entry.get("field")).unwrap().as_str().unwrap();
        (name.to_owned(), !entry["labels"].as_object().unwrap().is_empty())
    });
    Some(named.collect())
}

/// Fails unless the path names something that a recording of `bus` has.
fn check(
    protocol: &str,
    bus: &str,
    path: &str,
    known: &mut BTreeMap<String, BTreeMap<String, bool>>,
) {
    if path == "/bustape/log" {
        return;
    }
    let rest = path.strip_prefix(&format!("/{bus}/")).unwrap_or_else(|| panic!("{path}"));
    let (topic, field) = rest.split_once('.').unwrap_or((rest, ""));
    let (topic, filter) = topic.split_once('{').unwrap_or((topic, ""));
    let has = known
        .entry(topic.to_owned())
        .or_insert_with(|| fields(protocol, topic).unwrap_or_else(|| panic!("no topic of {path}")));
    let filter = filter.split_once("==").map_or("", |(name, _)| name);
    assert!(filter.is_empty() || has.contains_key(filter), "no such filter in {path}");
    let exists = match field.strip_suffix("_label") {
        Some(signal) => has.get(signal) == Some(&true),
        None => field.is_empty() || has.contains_key(field),
    };
    assert!(exists, "no such field in {path}");
}

#[test]
fn every_path_of_the_layouts_names_a_topic_and_field_that_recordings_have() {
    for (protocol, bus) in [("hmi-can", "station"), ("zhongheng-09", "rectifier")] {
        let layout = layout(protocol);
        let mut found = BTreeSet::new();
        paths(&layout, &mut found);
        assert!(found.len() > 40 && found.contains("/bustape/log"), "{found:?}");
        let mut known = BTreeMap::new();
        for path in found {
            check(protocol, bus, path, &mut known);
        }
    }
}

#[test]
fn every_panel_of_the_layouts_is_shown_once_and_is_of_a_kind_that_viewers_have() {
    for protocol in ["hmi-can", "zhongheng-09"] {
        let layout = layout(protocol);
        let configs = layout["configById"].as_object().unwrap();
        let mut found = BTreeSet::new();
        shown(&layout["layout"], &layout["configById"], &mut found);
        assert_eq!(found, configs.keys().cloned().collect());
        let kinds: BTreeSet<&str> = found.iter().map(|id| id.split('!').next().unwrap()).collect();
        assert!(kinds.iter().all(|kind| PANELS.contains(kind)), "{kinds:?}");
        for kind in ["Plot", "StateTransitions", "RosOut", "Gauge", "RawMessages"] {
            assert!(kinds.contains(kind), "no {kind} in the layout of {protocol}");
        }
    }
}

#[test]
fn a_layout_can_be_had_for_a_bus_of_any_name() {
    let ran = bustape(["protocols", "layout", "hmi-can", "--bus", "roof-7"]).expect(0);
    assert!(ran.out.contains("\"/roof-7/BATMON_2.voltage\"") && !ran.out.contains("/station/"));
    bustape(["protocols", "layout", "hmi-can", "--bus", "a/b"]).expect(2);
    let ran = bustape(["protocols", "layout", "car.dbc"]).expect(2);
    assert!(ran.err.contains("there are those of hmi-can and zhongheng-09"), "{}", ran.err);
}

#[test]
fn the_built_in_protocols_are_listed_and_shown() {
    let list = bustape(["protocols", "list", "--json"]).expect(0).json();
    // One of them is a second meaning of an identifier, which a DBC file cannot say.
    assert_eq!(list["protocols"][0]["messages"], 171);
    assert_eq!(
        (&list["protocols"][1]["commands"], &list["protocols"][1]["fields"]),
        (&32.into(), &405.into())
    );
    let table = bustape(["protocols", "list"]).expect(0).out;
    assert!(table.contains("171 messages") && table.contains("32 commands, 405 fields"), "{table}");

    let can = bustape(["protocols", "show", "hmi-can", "--json"]).expect(0).json();
    assert_eq!(can["messages"].as_array().unwrap().len(), 171);
    assert_eq!(can["remotes"][0]["message"], "CONFIG_REQUEST");
    assert_eq!(can["assemblies"].as_array().unwrap().len(), 8);
    let rows = bustape(["protocols", "show", "hmi-can"]).expect(0).out;
    // Messages and the remote frame, which have an identifier each.
    assert_eq!(rows.lines().filter(|line| line.contains("  0x")).count(), 172, "{rows}");
    // By name and by number, with value tables.
    for name in ["ALT_1", "0x90001"] {
        let shown = bustape(["protocols", "show", "hmi-can", name]).expect(0).out;
        assert!(shown.starts_with("0x00090001 ALT_1, 3 bytes, ctrl-to-hmi\n"), "{shown}");
        assert!(shown.contains("\n  3  Inverters\n"), "{shown}");
    }
    // And all else that the overview names.
    let shown = bustape(["protocols", "show", "hmi-can", "CONFIG_REQUEST"]).expect(0).out;
    assert!(shown.contains(" CONFIG_REQUEST, remote frame"), "{shown}");
    for assembly in can["assemblies"].as_array().unwrap() {
        let name = assembly["message"].as_str().unwrap();
        let one = bustape(["protocols", "show", "hmi-can", name, "--json"]).expect(0).json();
        let fields = one["fields"].as_array().unwrap().iter().map(|field| field["field"].clone());
        assert_eq!(fields.collect::<Value>(), assembly["fields"], "{one}");
        let shown = bustape(["protocols", "show", "hmi-can", name]).expect(0).out;
        assert!(shown.starts_with(name) && shown.contains(" of several frames"), "{shown}");
    }
    let serial =
        bustape(["protocols", "show", "zhongheng-09", "0x40ec", "--json"]).expect(0).json();
    assert_eq!(serial["args"][0]["field"], "module_position");
    assert_eq!(serial["fields"][12]["unit"], "s");
    assert_eq!(serial["fields"][11]["flags"]["256"], "shutdown");
    let shown = bustape(["protocols", "show", "zhongheng-09", "di_config"]).expect(0).out;
    assert!(shown.contains("Fields, 26 x n bytes"), "{shown}");
    for protocol in ["hmi-can", "zhongheng-09"] {
        bustape(["protocols", "show", protocol, "no_such_thing"]).expect(2);
    }
    bustape(["protocols", "show", "no-such-protocol"]).expect(2);
}

#[test]
fn the_source_of_a_definition_is_printed_byte_by_byte() {
    let schemas = concat!(env!("CARGO_MANIFEST_DIR"), "/schemas/");
    let text = |file: &str| std::fs::read_to_string(format!("{schemas}{file}")).unwrap();
    let source = |name: &str| bustape(["protocols", "show", name, "--source"]).expect(0).out;
    for file in ["hmi-can.dbc", "zhongheng-09.toml"] {
        assert!(source(&format!("{schemas}{file}")) == text(file), "{file}");
    }
    assert!(source("zhongheng-09") == text("zhongheng-09.toml"));
    // Two files, each behind its name.
    let (dbc, rules) = (text("hmi-can.dbc"), text("hmi-can.toml"));
    assert!(source("hmi-can") == format!("hmi-can.dbc\n{dbc}hmi-can.toml\n{rules}"));
}

#[test]
fn a_file_of_the_user_is_shown_like_the_built_in_ones() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("car.dbc");
    let text = "BU_: ECU\nBO_ 291 Engine: 8 ECU\n\
                \x20SG_ Page M : 0|8@1+ (1,0) [0|0] \"\" ECU\n\
                \x20SG_ Oil m3 : 15|16@0- (0.5,-40) [-40|120] \"degC\" ECU\n";
    std::fs::write(&path, text).unwrap();
    let path = path.to_str().unwrap();
    let shown = bustape(["protocols", "show", path, "Engine"]).expect(0).out;
    let row = shown.lines().find(|line| line.trim_start().starts_with("Oil")).unwrap();
    for part in ["signed motorola", "x 0.5 - 40", "degC", "-40..120", "Page=3"] {
        assert!(row.contains(part), "{part}: {row}");
    }
}
