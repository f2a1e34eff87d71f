//! Files as they are found in the field.

use super::super::can::Value;
use super::super::dbc::{self, DbcError, Number};
use super::{decoder, frame, names, parse, values};

const ONE: &str = "BO_ 16 A: 8 X\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" Y\n";

/// Lines of the oddities.
fn lines(text: &str) -> Vec<u32> {
    parse(text).oddities.list().iter().map(|oddity| oddity.line).collect()
}

#[test]
fn a_file_needs_no_header_and_may_have_any_line_ends_and_a_byte_order_mark() {
    assert_eq!(lines(ONE), Vec::<u32>::new());
    let commented = format!("// made by hand\n{}", ONE.replace("A: 8 X", "A: 8 X // first"));
    assert_eq!(lines(&commented), Vec::<u32>::new());
    let full =
        format!("VERSION \"1.0\"\n\nNS_ :\n\tCM_\n\tBA_DEF_\n\tVAL_\n\nBS_:\n\nBU_: X Y\n\n{ONE}");
    assert_eq!(lines(&full), Vec::<u32>::new());
    assert_eq!(parse(&full).database.nodes, ["X", "Y"]);
    for text in [full.replace('\n', "\r\n"), full.replace('\n', "\r"), format!("\u{FEFF}{full}")] {
        assert_eq!(lines(&text), Vec::<u32>::new());
        assert_eq!(parse(&text).database.messages[0].signals.len(), 1);
    }
}

#[test]
fn units_and_comments_are_read_in_both_encodings() {
    let text =
        "BO_ 16 A: 8 X\n SG_ t : 0|8@1+ (1,0) [0|0] \"°C\" Y\nCM_ SG_ 16 t \"Kühlmittel\";\n";
    let latin: Vec<u8> = text.chars().map(|c| u8::try_from(u32::from(c)).unwrap()).collect();
    for bytes in [text.as_bytes(), &latin] {
        let parsed = dbc::parse(bytes).unwrap();
        let signal = &parsed.database.messages[0].signals[0];
        assert_eq!((signal.unit.as_str(), signal.comment.as_str()), ("°C", "Kühlmittel"));
    }
}

#[test]
fn scaling_is_read_in_any_notation() {
    let all = [
        ("(1,0)", 1.0, 0.0),
        ("(1E-3,-.5)", 0.001, -0.5),
        ("(+1.5e+001, 5.)", 15.0, 5.0),
        ("( 0.01 , -40 )", 0.01, -40.0),
    ];
    for (text, factor, offset) in all {
        let parsed = parse(&ONE.replace("(1,0)", text));
        assert_eq!(parsed.oddities.list(), []);
        let signal = &parsed.database.messages[0].signals[0];
        assert_eq!((signal.factor, signal.offset), (factor, offset), "{text}");
    }
}

#[test]
fn a_line_that_means_nothing_costs_only_itself_and_is_said_with_its_number() {
    for bad in [
        " SG_ bad : 0|8@2+ (1,0) [0|0] \"\" Y",
        " SG_ bad : 0|0@1+ (1,0) [0|0] \"\" Y",
        " SG_ bad : 0|65@1+ (1,0) [0|0] \"\" Y",
        " SG_ bad : 505|8@1+ (1,0) [0|0] \"\" Y",
        " SG_ bad : 99999|8@1+ (1,0) [0|0] \"\" Y",
        " SG_ bad : 0|8@1+ (NaN,0) [0|0] \"\" Y",
        " SG_ bad : 0|8@1+ (1,inf) [0|0] \"\" Y",
        " SG_ bad z1 : 0|8@1+ (1,0) [0|0] \"\" Y",
        " SG_ bad",
        "VAL_ 16 nobody 0 \"x\" ;",
        "CM_ BO_ 99 \"nobody\";",
        "BO_ what A: 8 X",
        "SG_MUL_VAL_ 16 s nobody 0-0;",
    ] {
        let text = format!("{ONE}{bad}\nCM_ BO_ 16 \"read\";\n");
        let parsed = parse(&text);
        assert_eq!(lines(&text), [3], "{bad}");
        assert_eq!(parsed.oddities.lost(), 1, "{bad}");
        assert_eq!(parsed.database.messages[0].signals.len(), 1, "{bad}");
        assert_eq!(parsed.database.messages[0].comment, "read", "{bad}");
    }
}

#[test]
fn odd_but_clear_things_are_loaded_and_said() {
    for (odd, signals) in [
        (" SG_ s : 8|8@1+ (1,0) [0|0] \"\" Y", vec!["s", "s_2"]),
        (" SG_ past : 64|8@1+ (1,0) [0|0] \"\" Y", vec!["s", "past"]),
        (" SG_ zero : 8|8@1+ (0,0) [0|0] \"\" Y", vec!["s", "zero"]),
        (" SG_ bare : 8|8@1+", vec!["s", "bare"]),
        (" SG_ unsaid : 8|8@1 (1,0) [0|0] \"\" Y", vec!["s", "unsaid"]),
        (" SG_ range : 8|8@1+ (1,0) [?|?] \"\" Y", vec!["s", "range"]),
        ("NEW_SECTION_ 1 2 \"3\";", vec!["s"]),
        ("this is no DBC", vec!["s"]),
        ("BO_ 17 B: 5000 X", vec!["s"]),
        ("BS_: 500000 : 1,2\nnor this", vec!["s"]),
        ("SIG_GROUP_ 16 group 1 : s;\nnor this", vec!["s"]),
        ("VAL_ 16 s 1 \"one\" 1 \"another\" ;", vec!["s"]),
        ("SIG_VALTYPE_ 16 s : 1;", vec!["s"]),
    ] {
        let parsed = parse(&format!("{ONE}{odd}\n"));
        assert_eq!(parsed.oddities.list().len(), 1, "{odd}");
        assert_eq!(parsed.oddities.lost(), 0, "{odd}");
        let loaded = parsed.database.messages[0].signals.iter();
        assert_eq!(loaded.map(|s| s.name.as_str()).collect::<Vec<_>>(), signals, "{odd}");
    }
}

#[test]
fn of_two_messages_with_one_identifier_the_first_stays() {
    let text = format!("{ONE}BO_ 16 B: 8 X\n SG_ other : 0|8@1+ (1,0) [0|0] \"\" Y\n");
    assert_eq!(lines(&text), [3]);
    assert_eq!(names(&decoder(&text), &frame(16, &[0; 8])), ["s"]);
    // Two numbers for one identifier: 0x800 does not fit in 11 bits, so it has 29 as well.
    let text = "BO_ 2048 A: 8 X\n SG_ a : 0|8@1+ (1,0) [0|0] \"\" Y\n\
                BO_ 2147485696 B: 8 X\n SG_ b : 0|8@1+ (1,0) [0|0] \"\" Y\nCM_ BO_ 2147485696 \"of B\";\n";
    assert_eq!(lines(text), [1, 3]);
    let messages = parse(text).database.messages;
    assert_eq!((messages.len(), messages[0].comment.as_str()), (1, ""));
    let text = format!("{ONE}BO_ 17 A: 8 X\n");
    assert_eq!(parse(&text).database.messages[1].name, "A_2");
}

#[test]
fn a_missing_quote_does_not_swallow_the_rest() {
    let text = format!("{ONE}CM_ SG_ 16 s \"no end;\nCM_ BO_ 16 \"read\";\n");
    assert_eq!(lines(&text), [3]);
    assert_eq!(parse(&text).database.messages[0].comment, "read");
    let text = format!("{ONE}CM_ BO_ 16 \"two\nlines, a \\\"quote\\\" and a ; in it\";\nBS_:\n");
    assert_eq!(lines(&text), Vec::<u32>::new());
    let comment = &parse(&text).database.messages[0].comment;
    assert_eq!(comment, "two\nlines, a \"quote\" and a ; in it");
}

#[test]
fn floats_tables_and_identifiers() {
    let text = "VAL_TABLE_ yes 1 \"Yes\" 0 \"No\" ;\n\
        BO_ 2147549185 A: 8 Vector__XXX\n SG_ f : 0|32@1- (1,0) [0|0] \"\" Y\n\
         \x20SG_ i : 39|8@0- (1,0) [0|0] \"\" Y\n SG_ t : 40|8@1+ (1,0) [0|0] \"\" Y\n\
        BO_ 3221225472 VECTOR__INDEPENDENT_SIG_MSG: 0 Vector__XXX\n\
         \x20SG_ orphan : 0|8@1+ (1,0) [0|0] \"\" Vector__XXX\n\
        SIG_VALTYPE_ 2147549185 f : 1;\n\
        VAL_ 2147549185 i -1 \"none\" 255 \"never\" ;\nVAL_ 2147549185 t yes;\n\
        VAL_ Environment 0 \"x\" ;\nEV_ Environment: 0 [0|0] \"\" 0 1 DUMMY_NODE_VECTOR0 Vector__XXX;\n\
        BA_ \"GenMsgCycleTime\" BO_ 2147549185 100;\n";
    let parsed = parse(text);
    assert_eq!(parsed.oddities.list(), []);
    assert_eq!(parsed.database.messages.len(), 1);
    let message = &parsed.database.messages[0];
    assert_eq!((message.id, message.extended, message.cycle_time), (0x10001, true, 100));
    assert_eq!(message.signals[0].number, Number::Float32);
    assert_eq!(message.signals[1].label(0xFF), Some("none"));
    assert_eq!(message.signals[2].label(1), Some("Yes"));
    let nan = frame(0x10001, &[0, 0, 0xC0, 0x7F, 0xFF, 1, 0, 0]);
    let values = values(&decoder(text), &nan);
    assert!(matches!(values[0].1, Value::Float(float) if float.is_nan()));
    assert_eq!(values[1].1, Value::Signed(-1));
}

#[test]
fn what_is_no_dbc_is_refused_with_a_reason() {
    assert_eq!(dbc::parse(b"").unwrap_err(), DbcError::NoMessages);
    assert_eq!(dbc::parse(b"{\"json\": true}").unwrap_err(), DbcError::NoMessages);
    assert_eq!(dbc::parse(b"MDF \0\0").unwrap_err(), DbcError::NotText(4));
    assert_eq!(dbc::parse(&vec![b' '; dbc::MAX_FILE + 1]).unwrap_err(), DbcError::TooLarge);
}
