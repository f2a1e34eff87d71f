//! Frames of a bus one after the other, with the rules of the built-in protocol and hostile ones.

use std::sync::{Arc, LazyLock};

use proptest::prelude::*;

use super::super::assembly::{Content, LONGEST};
use super::super::bus::{CanBus, CanItem};
use super::super::definition::CanDefinition;
use super::super::protocol::{HMI_CAN, HMI_CAN_RULES};
use super::super::rules::{Rules, is_can};
use super::parse;
use crate::frame::{CanFlags, CanFrame, Timestamp};
use crate::protocol::payload::{FieldType, Value};

fn hmi_can() -> Arc<CanDefinition> {
    static DEFINITION: LazyLock<Arc<CanDefinition>> = LazyLock::new(|| {
        let rules = Rules::read("hmi-can.toml", HMI_CAN_RULES).unwrap();
        Arc::new(rules.join(parse(HMI_CAN).database).unwrap())
    });
    DEFINITION.clone()
}

fn joined(dbc: &str, rules: &str) -> Arc<CanDefinition> {
    let rules = Rules::read("x.toml", &format!("name = \"x\"\ndbc = \"x.dbc\"\n{rules}")).unwrap();
    Arc::new(rules.join(parse(dbc).database).unwrap())
}

/// What each frame is called, and what its assemblies hold.
fn told(bus: &mut CanBus, time: u64, frame: &CanFrame) -> Vec<String> {
    let mut told = Vec::new();
    bus.feed(Timestamp(time), frame, &mut |item| told.push(word(&item)));
    told
}

fn word(item: &CanItem<'_>) -> String {
    match item {
        CanItem::Message(found) => format!("{} {}", found.message.name, found.check.name()),
        CanItem::Remote(remote) => remote.name.clone(),
        CanItem::Unknown => "unknown".to_owned(),
        CanItem::Assembly(a) => {
            let mut fields = Vec::new();
            a.decode(|field, content| fields.push((field, content)));
            format!("{} {} {:02X?} {fields:?}", a.assembly.name, a.complete, a.bytes)
        }
    }
}

#[test]
fn everything_that_can_be_yielded_is_known_before_any_frame() {
    let definition = hmi_can();
    let meaning = definition.messages().iter().find(|m| m.name == "CFG_SCR_FILE_1").unwrap();
    assert_eq!(definition.messages().len(), 171);
    assert_eq!(definition.direction(meaning).unwrap(), "hmi-to-ctrl");
    assert_eq!(meaning.signals[0].name, "value_8");
    assert_eq!(definition.remotes()[0].direction.as_deref(), Some("hmi-to-ctrl"));
    let answer = definition.assemblies().iter().find(|a| &*a.name == "MODBUS_ANS").unwrap();
    assert_eq!((&*answer.kind, answer.direction.as_deref()), ("modbus", Some("ctrl-to-hmi")));
    let [length, result, .., registers] = answer.fields.as_slice() else { panic!("{answer:?}") };
    assert_eq!(length.plan.unit.as_deref(), Some("B"));
    assert_eq!(result.plan.values.as_ref().unwrap().len(), 13);
    assert_eq!(&*result.plan.values.as_ref().unwrap()[&11], "No answer (timeout)");
    assert!(registers.repeated && registers.plan.kind == FieldType::Unsigned);
    assert_eq!(registers.plan.type_name(), "u16");
}

#[test]
fn lost_frames_end_what_is_open_and_what_went_before_says_nothing() {
    let mut bus = CanBus::new(hmi_can());
    let half = |id| CanFrame::new(id, CanFlags::EXTENDED, b"abcdefgh");
    assert_eq!(told(&mut bus, 0, &half(0x0013_0000)), ["CFG_SCR_FILE_0 exact"]);
    let mut given_up = Vec::new();
    bus.finish(&mut |item| given_up.push(word(&item)));
    assert_eq!(given_up.len(), 1);
    assert!(given_up[0].starts_with("CFG_SCR_FILE false"), "{given_up:?}");
    assert_eq!(told(&mut bus, 0, &half(0x0013_0001)), ["CONFIG_1 exact"]);
}

#[test]
fn an_error_frame_is_no_frame_of_any_message() {
    let mut bus = CanBus::new(hmi_can());
    let half = |id, flags| CanFrame::new(id, flags, b"abcdefgh");
    let first = half(0x0013_0000, CanFlags::EXTENDED);
    let second = half(0x0013_0001, CanFlags::EXTENDED);
    let error = half(0x0013_0001, CanFlags::EXTENDED | CanFlags::ERROR);
    told(&mut bus, 0, &first);
    assert_eq!(told(&mut bus, 0, &error), ["unknown"]);
    assert_eq!(told(&mut bus, 0, &second)[0], "CFG_SCR_FILE_1 exact");
}

const LONG: &str = "BO_ 256 A_0: 8 X\n SG_ s : 0|8@1+ (1,0) [0|0] \"\" Y\n";
const COUNTED: &str = "[[assembly]]\nname = \"A\"\nkind = \"a\"\nfirst = \"A_0\"\nnumber = 0xFF\n\
    byte_order\nfields = [{ name = \"n\", type = \"u32\" }, { name = \"rest\", type = \"bytes\" }]\n";

#[test]
fn a_length_that_lies_takes_no_memory() {
    let rules = COUNTED.replace("byte_order", "length = { field = \"n\", add = 4 }");
    let definition = joined(LONG, &rules);
    for (length, starts) in [(u32::MAX, false), (0x7FFF_FFFF, false), (4092, true), (4093, false)] {
        let mut bus = CanBus::new(definition.clone());
        let mut data = length.to_be_bytes().to_vec();
        data.extend([0; 4]);
        told(&mut bus, 0, &CanFrame::new(0x100, CanFlags::default(), &data));
        let mut open = 0;
        bus.finish(&mut |_| open += 1);
        assert_eq!(open, i32::from(starts), "{length:#x}");
    }
}

#[test]
fn a_late_frame_is_not_part_of_what_came_before() {
    let rules = COUNTED.replace("byte_order", "length = { field = \"n\" }\ntimeout_ms = 10");
    let first = CanFrame::new(0x100, CanFlags::default(), &[0, 0, 0, 10, 1, 2, 3, 4]);
    let second = CanFrame::new(0x101, CanFlags::default(), &[5, 6]);
    let definition = joined(LONG, &rules);
    let mut bus = CanBus::new(definition.clone());
    told(&mut bus, 0, &first);
    assert!(told(&mut bus, 10_000_000, &second)[1].starts_with("A true"));
    let mut bus = CanBus::new(definition);
    told(&mut bus, 0, &first);
    assert!(told(&mut bus, 10_000_001, &second)[1].starts_with("A false"));
}

#[test]
fn what_a_file_is_about_is_told_by_its_content() {
    assert!(is_can(HMI_CAN_RULES));
    assert!(is_can("[[assembly]]\n"));
    assert!(!is_can(crate::protocol::BUILT_IN[0].1));
    assert!(!is_can("dbc = "));
}

/// Frames of few identifiers, so that rules meet.
fn some_frame() -> impl Strategy<Value = CanFrame> {
    let device = prop::sample::select(vec![0x11_u32, 0x12, 0x13, 0x13, 0x02, 0x0E]);
    let setting = prop::sample::select(vec![0_u32, 0, 0, 1, 2, 0xFF]);
    let packet = prop::sample::select(vec![0_u32, 0, 1, 1, 2, 3, 4, 0x1F, 0x20, 0xFF]);
    let flags = prop::sample::select(vec![1_u8, 1, 1, 1, 1, 1, 1, 0, 3, 5, 9]);
    let data = prop::collection::vec(prop_oneof![Just(0_u8), 0_u8..40, any::<u8>()], 0..=8);
    (device, setting, packet, flags, data).prop_map(|(device, setting, packet, flags, data)| {
        let id = device << 16 | setting << 8 | packet;
        let id = if flags & 1 == 0 { id & 0x7FF } else { id };
        CanFrame::new(id, CanFlags(flags), &data)
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Each frame is one thing, assemblies are bounded, and nothing panics.
    #[test]
    fn any_frames_in_any_order(frames in prop::collection::vec(some_frame(), 0..200)) {
        let mut bus = CanBus::new(hmi_can());
        for frame in &frames {
            let mut alone = 0;
            bus.feed(Timestamp(0), frame, &mut |item| match item {
                CanItem::Assembly(a) => {
                    assert!(a.bytes.len() <= LONGEST && a.frames > 0);
                    assert!(!a.complete || a.bytes.len() >= 8);
                    a.decode(|_, content| if let Content::Many(v) = content {
                        assert!(v.len() <= a.bytes.len());
                    });
                }
                CanItem::Remote(_) | CanItem::Message(_) | CanItem::Unknown => alone += 1,
            });
            prop_assert_eq!(alone, 1);
        }
        bus.finish(&mut |item| assert!(matches!(item, CanItem::Assembly(a) if !a.complete)));
    }

    /// A structure arrives whole, whatever passes on other identifiers.
    #[test]
    fn a_structure_arrives_whole_between_other_frames(
        registers in prop::collection::vec(any::<u16>(), 0..=123),
        others in prop::collection::vec(some_frame(), 0..40),
    ) {
        let mut bytes = vec![8 + 2 * registers.len() as u8, 0, 1, 3, 0, 0, 0, 0];
        bytes.extend(registers.iter().flat_map(|register| register.to_le_bytes()));
        let others = others.iter().filter(|frame| frame.id >> 16 != 0x12);
        let mut others = others.cycle().take(100);
        let mut bus = CanBus::new(hmi_can());
        let mut got = None;
        for (number, part) in (0..).zip(bytes.chunks(8)) {
            for frame in others.by_ref().take(3) {
                bus.feed(Timestamp(0), frame, &mut |_| {});
            }
            let frame = CanFrame::new(0x0012_0000 | number, CanFlags::EXTENDED, part);
            bus.feed(Timestamp(0), &frame, &mut |item| if let CanItem::Assembly(a) = item {
                assert!(a.complete && got.is_none());
                a.decode(|field, content| if field == 6 { got = Some(content) });
            });
        }
        let registers = registers.iter().map(|register| Value::Unsigned((*register).into()));
        prop_assert_eq!(got, Some(Content::Many(registers.collect())));
    }

    /// Two buses are told the same together as alone.
    #[test]
    fn buses_are_independent(
        frames in prop::collection::vec((any::<bool>(), some_frame()), 0..100),
    ) {
        let definition = hmi_can();
        let mut together = [CanBus::new(definition.clone()), CanBus::new(definition.clone())];
        let mut alone = [CanBus::new(definition.clone()), CanBus::new(definition)];
        let mut first = [Vec::new(), Vec::new()];
        for (bus, frame) in &frames {
            first[usize::from(*bus)].extend(told(&mut together[usize::from(*bus)], 0, frame));
        }
        for (at, bus) in alone.iter_mut().enumerate() {
            let own = frames.iter().filter(|(b, _)| usize::from(*b) == at);
            let second: Vec<_> = own.flat_map(|(_, frame)| told(bus, 0, frame)).collect();
            prop_assert_eq!(&first[at], &second);
        }
    }

    /// Whatever stands in a file of rules, it is joined or refused.
    #[test]
    fn damaged_rules_never_panic(
        damage in prop::collection::vec((0_usize..4200, "[\\[\\]{}=\",0-9a-zA-Z_#\n ]{0,3}"), 1..4),
    ) {
        let mut text = HMI_CAN_RULES.to_owned();
        for (at, with) in damage {
            if text.is_char_boundary(at) && text.is_char_boundary(at + 2) {
                text.replace_range(at..at + 2, &with);
            }
        }
        if let Ok(rules) = Rules::read("damaged.toml", &text) {
            let _ = rules.join(parse(HMI_CAN).database);
        }
    }
}
