//! A wrong definition says where it is wrong, and what is expected.

use proptest::prelude::*;

use crate::protocol::{BUILT_IN, Protocol, Settings};

const GOOD: &str = r#"name = "meter"
framing = { kind = "start_flag", start = [0x68], length = { field = "len", add = 3 } }
crc = { name = "SUM_8" }
header = [{ name = "len", type = "u8" }, { name = "id", type = "u8" }]
[report]
command = "id"
[[command]]
id = 1
name = "power"
fields = [{ name = "watts", type = "u16" }]
"#;

fn error(from: &str, to: &str) -> String {
    assert!(GOOD.contains(from), "{from}");
    let text = GOOD.replacen(from, to, 1);
    Protocol::parse("meter.toml", &text, Settings::default()).unwrap_err().to_string()
}

#[test]
fn an_error_names_file_line_what_is_wrong_and_what_is_expected() {
    assert!(Protocol::parse("meter.toml", GOOD, Settings::default()).is_ok());
    let cases = [
        ("\"u16\"", "\"u12\"", "meter.toml, line 10: type \"u12\" is not known; expected u8, u16"),
        ("id = 1", "ident = 1", "meter.toml, line 8: unknown field `ident`, expected one of `id`"),
        (
            "name = \"power\"",
            "name = \"1 W\"",
            "meter.toml, line 7: \"1 W\" cannot be a name; expected",
        ),
        (
            "start_flag",
            "start",
            "line 2: framing \"start\" is not known; expected one of start_flag",
        ),
        ("start = [0x68], ", "", "line 2: start of 0 bytes; expected 1 to 8"),
        (
            "start_flag",
            "silence",
            "line 2: framing \"silence\" has no start; expected one of gap_us",
        ),
        ("length = { field = \"len\", add = 3 }", "max = 9", "expected length"),
        (
            "field = \"len\"",
            "field = \"ln\"",
            "line 2: there is no \"ln\" in the header; expected one of len, id",
        ),
        (
            "SUM_8",
            "CRC_8_NOPE",
            "line 3: CRC \"CRC_8_NOPE\" is not in the catalogue; expected one of CRC_8_",
        ),
        (
            "command = \"id\"",
            "command = \"x\"",
            "there is no number \"x\"; expected one of len, id",
        ),
        (
            "type = \"u16\"",
            "type = \"u16\", values = \"v\"",
            "there is no table [values.v]; expected a table",
        ),
        (
            "type = \"u16\"",
            "type = \"f32\", values = { 1 = \"a\" }",
            "expected u8, u16, u32 or u64",
        ),
        (
            "type = \"u16\"",
            "type = \"u16\", count = 5000",
            "line 10: 5000 fields; expected 1 to 4096",
        ),
        ("[report]", "[request]", "nothing says who sent a frame; expected [direction]"),
        ("name = \"meter\"", "name = meter", "meter.toml, line 1: "),
    ];
    for (from, to, expected) in cases {
        let error = error(from, to);
        assert!(error.contains(expected), "{error}\nis not\n{expected}");
    }
}

#[test]
fn the_built_in_protocol_has_all_that_its_document_prints() {
    let protocol = Protocol::built_in("zhongheng-09", Settings::default()).unwrap().unwrap();
    let records = protocol.commands.iter().map(|command| command.fields.fields.len());
    assert_eq!((protocol.commands.len(), records.sum::<usize>()), (32, 405));
    let line = protocol.line.as_ref().unwrap();
    assert_eq!((line.baud, line.data_bits, line.stop_bits), (19200, 8, 1));
    let sizes = |name: &str| {
        let command = protocol.commands.iter().find(|command| &*command.name == name).unwrap();
        command.fields.size
    };
    let expected = [
        ("system_controls_config", 123),
        ("upload_config", 123),
        ("control_process", 103),
        ("alarm_configuration", 56),
        ("rectifier_data", 38),
        ("rxp_row", 54),
        ("warn_infor", 80),
    ];
    for (name, size) in expected {
        assert_eq!(sizes(name), size, "{name}");
    }
    assert!(Protocol::built_in("zhongheng-10", Settings::default()).is_none());
}

#[test]
fn a_definition_cannot_ask_for_more_fields_than_there_is_memory() {
    let command = |id: usize| {
        format!(
            "[[command]]\nid = {id}\nname = \"c{id}\"\n\
             fields = [{{ name = \"x\", type = \"u8\", count = 4096, title = \"{}\" }}]\n",
            "t".repeat(10_000)
        )
    };
    let text: String = (2..200).map(command).collect();
    let error = Protocol::parse("f", &format!("{GOOD}{text}"), Settings::default()).unwrap_err();
    assert!(error.to_string().contains("fields in all; expected 65536 at most"), "{error}");
    let long = GOOD.replace("power", &"p".repeat(1 << 20));
    let error = Protocol::parse("f", &long, Settings::default()).unwrap_err();
    assert!(error.to_string().len() < 2100);
}

#[test]
fn settings_are_read_and_wrong_ones_refused() {
    let settings = Settings::parse("byte_order=little,assume=true").unwrap();
    assert_eq!(format!("{settings:?}"), "Settings { byte_order: Some(Little), assume: true }");
    assert!(Settings::parse("byteorder=big").unwrap_err().contains("there are byte_order=big"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Whatever stands in a definition, it is read or refused.
    #[test]
    fn a_damaged_definition_never_panics(
        damage in prop::collection::vec((0_usize..8000, "[\\[\\]{}=\",0-9a-z#\n ]{0,3}"), 1..4),
    ) {
        let mut text = BUILT_IN[0].1.to_owned();
        for (at, with) in damage {
            if text.is_char_boundary(at) && text.is_char_boundary(at + 2) {
                text.replace_range(at..at + 2, &with);
            }
        }
        let _ = Protocol::parse("damaged.toml", &text, Settings::default());
    }
}
