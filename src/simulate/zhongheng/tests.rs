//! Master and slave, each alone and with each other.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use super::fault::FAULTS;
use super::frame::{Control, Deframer, Escaping, Frame, link};
use super::layout::{Kind, command, commands};
use super::plant::{Plant, RECTIFIERS};
use super::slave::{SET, status};
use super::{Master, Slave};
use crate::frame::{Direction, Timestamp};
use crate::protocol::{Decoder, Item, Protocol, Settings, json};
use crate::simulate::faults::Rates;

const SECOND: u64 = 1_000_000_000;
const DAY_A_MINUTE: f64 = 1440.0;

/// Data length of every command, and of one record where there are records (section 8, overview).
#[rustfmt::skip]
const LENGTHS: [(u16, usize); 32] = [
    (0x0000, 1), (0x0001, 4), (0x0002, 4), (0x0064, 123), (0x0065, 1), (0x007c, 26),
    (0x00a2, 22), (0x00b6, 4), (0x00b9, 5), (0x00c8, 9), (0x012c, 5), (0x012d, 12),
    (0x0197, 123), (0x019a, 4), (0x01a8, 1), (0x01a9, 4), (0x0259, 3), (0x0289, 4),
    (0x028a, 56), (0x028b, 1), (0x028c, 1), (0x028d, 13), (0x407e, 48), (0x409c, 24),
    (0x40b0, 103), (0x40e2, 40), (0x40ec, 38), (0x40ed, 54), (0x40ee, 8), (0x40ef, 4),
    (0x40f0, 12), (0x414b, 80),
];

/// A good read answer of this slave: the records it has, the others once.
fn answer_length(id: u16) -> usize {
    let (_, one) = LENGTHS.into_iter().find(|(known, _)| *known == id).expect("unknown command");
    let records = match id {
        0x007c | 0x00b9 => 6,
        0x00a2 | 0x40ed => 4,
        0x01a9 => 24,
        0x0259 => 80,
        _ => 1,
    };
    1 + one * records
}

fn deframe(bytes: &[u8]) -> Vec<Frame> {
    let mut deframer = Deframer::default();
    bytes.iter().filter_map(|byte| deframer.push(*byte)).collect()
}

/// What `slave` answers to `data` in a data frame to address 1, at `now`.
fn ask(slave: &mut Slave, data: &[u8], now: u64) -> Vec<u8> {
    let request = Frame { address: 1, control: Control(0x45), data: data.to_vec() };
    let mut answers = deframe(&slave.feed(&request.encode(Escaping::Minimal), now));
    assert_eq!(answers.len(), 1, "one answer to {data:02X?}");
    let answer = answers.remove(0);
    assert_eq!((answer.address, answer.control), (1, Control(0x85)));
    answer.data
}

fn read(slave: &mut Slave, id: u16, now: u64) -> Vec<u8> {
    ask(slave, &id.to_be_bytes(), now)
}

fn set(slave: &mut Slave, id: u16, data: &[u8]) -> u8 {
    let answer = ask(slave, &[&(id | SET).to_be_bytes()[..], data].concat(), 0);
    assert_eq!(answer.len(), 1, "a set is answered with the status alone");
    answer[0] & !status::ALARM_BIT
}

#[test]
fn thirty_two_commands_with_405_fields_have_the_documented_lengths() {
    assert_eq!(commands().count(), 32);
    let fields: usize = commands().flat_map(|c| c.fields).map(|f| usize::from(f.count)).sum();
    assert_eq!(fields, 405);
    for (id, length) in LENGTHS {
        let command = command(id).expect("missing command");
        assert_eq!(command.record_length(), length, "{id:04x} {}", command.name);
    }
    assert_eq!(command(0x414F).map(|c| c.id), Some(0x414B));
    assert!(command(0x0003).is_none());
}

/// Types of the fields of every command (section 8): b U8, h U16, w U32, f float, t text and r
/// raw bytes of that length; a number in front repeats.
#[rustfmt::skip]
const TYPES: [(u16, &str); 32] = [
    (0x0000, "b"),
    (0x0001, "w"),
    (0x0002, "w"),
    (0x0064, "3f 2b 2f b f 2h b f h b f b w 4b h 3w 4b h 3w 3b 4f w 5b h f 2h b"),
    (0x0065, "b"),
    (0x007c, "t20 6b"),
    (0x00a2, "t20 2b"),
    (0x00b6, "4b"),
    (0x00b9, "w b"),
    (0x00c8, "b w f"),
    (0x012c, "f b"),
    (0x012d, "f 2w"),
    (0x0197, "h b 6h 2b h 5b 2h 6b 2h 3b 3h 3b 2h 2b 2h 4b h b h 35b 2h r13 2b"),
    (0x019a, "w"),
    (0x01a8, "b"),
    (0x01a9, "f"),
    (0x0259, "3b"),
    (0x0289, "w"),
    (0x028a, "f b 2f b f w 2h b h 2b 2f b 4f"),
    (0x028b, "b"),
    (0x028c, "b"),
    (0x028d, "4b 2h w b"),
    (0x407e, "12f"),
    (0x409c, "6f"),
    (0x40b0, "b f b 2w b w f b 2w b f b w 2f b w b f b f b h 2b h 2b 2w b r20"),
    (0x40e2, "40b"),
    (0x40ec, "2f b f b w 2b f h f 2w"),
    (0x40ed, "b w b 3t16"),
    (0x40ee, "2f"),
    (0x40ef, "4b"),
    (0x40f0, "3w"),
    (0x414b, "80b"),
];

#[test]
fn every_field_has_its_documented_type() {
    for (id, types) in TYPES {
        let expected: Vec<String> = types
            .split(' ')
            .flat_map(|word| {
                let kind = word.trim_start_matches(|c: char| c.is_ascii_digit());
                let count = word[..word.len() - kind.len()].parse().unwrap_or(1);
                vec![kind.to_string(); count]
            })
            .collect();
        let command = command(id).expect("missing command");
        let found: Vec<String> = command
            .fields
            .iter()
            .flat_map(|field| {
                let kind = match field.kind {
                    Kind::U8 => "b".to_string(),
                    Kind::U16 => "h".to_string(),
                    Kind::U32 => "w".to_string(),
                    Kind::F32 => "f".to_string(),
                    Kind::Text(length) => format!("t{length}"),
                    Kind::Bytes(length) => format!("r{length}"),
                };
                vec![kind; usize::from(field.count)]
            })
            .collect();
        assert_eq!(found, expected, "{id:04x} {}", command.name);
    }
}

#[test]
fn the_layout_reads_the_sample_vectors() {
    // 0x40ec, the data of an answer in the samples.
    let data = [
        0xc1, 0x14, 0x28, 0xf6, 0x43, 0x0b, 0x00, 0x00, 0x63, 0x43, 0x4a, 0xde, 0xb8, 0x03, 0x00,
        0x01, 0x7b, 0x4a, 0xff, 0x4a, 0x43, 0xaf, 0xc2, 0x96, 0x9e, 0xa4, 0x39, 0x90, 0x66, 0x60,
        0x00, 0x00, 0x00, 0x00, 0xae, 0xcd, 0x54, 0x2c,
    ];
    let rectifier = command(0x40EC).expect("missing command");
    let number = |name| rectifier.number(name, &data);
    assert_eq!(number("output_voltage"), Some(-9.260_000_228_881_836));
    assert_eq!(number("output_current"), Some(139.0));
    assert_eq!(number("heatsink_temperature"), Some(99.0));
    assert_eq!(number("registration_state"), Some(3.0));
    assert_eq!(number("serial_number"), Some(97_098.0));
    assert_eq!(number("on_off_state"), Some(255.0));
    assert_eq!(number("run_time"), Some(f64::from(0xaecd_542c_u32)));
    assert_eq!(number("no such field"), None);
}

/// Everything said between a master and a slave: (time, request, answer).
fn dialogue(seed: u64, time_scale: f64, seconds: u64) -> Vec<(u64, Frame, Frame)> {
    let mut master = Master::new(seed, 0);
    let mut slave = Slave::new(1, seed, time_scale);
    let mut said = Vec::new();
    while master.due() < seconds * SECOND {
        let now = master.due();
        let Some(request) = master.poll(now) else { continue };
        let then = now + slave.think_time().as_nanos() as u64;
        let answer = slave.feed(&request, then);
        master.feed(&answer, then + answer.len() as u64 * 520_833);
        let (mut request, mut answer) = (deframe(&request), deframe(&answer));
        assert_eq!((request.len(), answer.len()), (1, 1), "one answer to one request");
        said.push((now, request.remove(0), answer.remove(0)));
    }
    assert_eq!(master.answers(), said.len() as u64, "the master takes every answer");
    said
}

#[test]
fn every_request_of_the_master_gets_a_good_answer_of_the_right_length() {
    let mut seen: BTreeMap<u16, usize> = BTreeMap::new();
    let mut positions = BTreeSet::new();
    for (_, request, answer) in dialogue(1, DAY_A_MINUTE, 90) {
        if request.control.link() == link::CONNECT {
            assert_eq!((answer.control, answer.data), (Control(0x86), vec![0xFF]));
            continue;
        }
        let word = u16::from_be_bytes([request.data[0], request.data[1]]);
        let id = word & !SET;
        assert_eq!(answer.data[0] & !status::ALARM_BIT, status::OK, "{id:04x}");
        let length = if word & SET != 0 { 1 } else { answer_length(id) };
        assert_eq!(answer.data.len(), length, "{id:04x}");
        if id == 0x40EC {
            positions.insert(request.data[2]);
        }
        *seen.entry(id).or_default() += 1;
    }
    let all: BTreeSet<u16> = LENGTHS.iter().map(|(id, _)| *id).collect();
    assert_eq!(seen.keys().copied().collect::<BTreeSet<u16>>(), all);
    assert_eq!(positions, (0..RECTIFIERS as u8).collect());
}

#[test]
fn the_master_connects_once_and_then_alternates_45_and_65_at_its_pace() {
    let said = dialogue(2, 1.0, 60);
    let controls: Vec<u8> = said.iter().map(|(_, request, _)| request.control.0).collect();
    assert_eq!(controls[0], 0x40);
    for (index, control) in controls[1..].iter().enumerate() {
        assert_eq!(*control, [0x45, 0x65][index % 2], "request {index}");
    }
    for (_, request, answer) in &said {
        assert_eq!(answer.control.sequence(), request.control.sequence());
        assert_eq!((request.address, answer.address), (0, 1));
    }
    for pair in said.windows(2) {
        let pause = (pair[1].0 - pair[0].0) / 1_000_000;
        assert!((200..=300).contains(&pause), "{pause} ms");
    }
}

#[test]
fn a_silent_slave_is_asked_again_twice_and_then_connected_anew() {
    let mut master = Master::new(1, 0);
    let mut controls = Vec::new();
    while master.due() < 12 * SECOND {
        let now = master.due();
        if let Some(request) = master.poll(now) {
            let request = &deframe(&request)[0];
            controls.push(request.control.0);
            if controls.len() == 1 {
                let mut slave = Slave::new(1, 1, 1.0);
                master.feed(&slave.feed(&request.encode(Escaping::Full), now), now);
            }
        }
    }
    assert_eq!(controls[..6], [0x40, 0x45, 0x45, 0x45, 0x40, 0x40]);
}

#[test]
fn the_same_seed_says_the_same() {
    assert_eq!(dialogue(5, DAY_A_MINUTE, 30), dialogue(5, DAY_A_MINUTE, 30));
    assert_ne!(dialogue(5, DAY_A_MINUTE, 30), dialogue(6, DAY_A_MINUTE, 30));
}

#[test]
fn the_cut_of_the_bytes_does_not_matter() {
    let mut said = Vec::new();
    for cut in [1, 3, 1000] {
        let mut slave = Slave::new(1, 9, 1.0);
        let requests: Vec<u8> = [0x407E_u16, 0x0064, 0x414B]
            .into_iter()
            .flat_map(|id| {
                let data = id.to_be_bytes().to_vec();
                Frame { address: 1, control: Control(0x65), data }.encode(Escaping::Full)
            })
            .collect();
        let answers: Vec<u8> = requests.chunks(cut).flat_map(|c| slave.feed(c, 0)).collect();
        assert_eq!(deframe(&answers).len(), 3);
        said.push(answers);
    }
    assert!(said.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn what_was_set_is_read_back() {
    let mut slave = Slave::new(1, 1, 1.0);
    assert_eq!(set(&mut slave, 0x028C, &[0x15]), status::OK);
    assert_eq!(read(&mut slave, 0x028C, 0), [0, 0x15]);
    let mut config = read(&mut slave, 0x0064, 0)[1..].to_vec();
    config[..4].copy_from_slice(&54.0_f32.to_be_bytes());
    assert_eq!(set(&mut slave, 0x0064, &config), status::OK);
    assert_eq!(read(&mut slave, 0x0064, 0)[1..], config);
    assert!((slave.plant().float_voltage() - 54.0).abs() < 1e-6, "the plant obeys");
    // Three digital inputs instead of six: records are taken as they come (Z14).
    let inputs = read(&mut slave, 0x007C, 0)[1..=78].to_vec();
    assert_eq!(set(&mut slave, 0x007C, &inputs), status::OK);
    assert_eq!(read(&mut slave, 0x007C, 0)[1..], inputs);
    // The set of 0x00b9 as it is printed, without the CT bit (Z3).
    assert_eq!(ask(&mut slave, &[0x00, 0xB9, 0, 0, 0, 7, 2], 0), [0]);
    assert_eq!(read(&mut slave, 0x00B9, 0), [0, 0, 0, 0, 7, 2]);
}

#[test]
fn what_cannot_be_done_gets_its_code() {
    let mut slave = Slave::new(1, 1, 1.0);
    assert_eq!(read(&mut slave, 0x0003, 0), [status::INVALID_DATA_ID]);
    assert_eq!(set(&mut slave, 0x0003, &[1]), status::INVALID_DATA_ID);
    assert_eq!(ask(&mut slave, &[0x00], 0), [status::INVALID_DATA_ID]);
    assert_eq!(set(&mut slave, 0x0000, &[0x15]), status::FAIL);
    assert_eq!(set(&mut slave, 0x0064, &[1, 2, 3]), status::INVALID_DATA);
    assert_eq!(set(&mut slave, 0x0259, &[1, 2, 3, 4]), status::INVALID_DATA);
    assert_eq!(ask(&mut slave, &[0x40, 0xEC], 0), [status::INVALID_DATA]);
    assert_eq!(ask(&mut slave, &[0x40, 0xEC, 40], 0), [status::TOO_HIGH]);
    let mut config = read(&mut slave, 0x0064, 0)[1..].to_vec();
    for (volts, code) in [(40.0_f32, status::TOO_LOW), (60.0, status::TOO_HIGH)] {
        config[..4].copy_from_slice(&volts.to_be_bytes());
        assert_eq!(set(&mut slave, 0x0064, &config), code);
    }
    config[..4].copy_from_slice(&f32::NAN.to_be_bytes());
    assert_eq!(set(&mut slave, 0x0064, &config), status::INVALID_DATA);
}

#[test]
fn the_slave_speaks_only_when_it_is_spoken_to() {
    let mut slave = Slave::new(7, 1, 1.0);
    let mut send = |address: u16, control: u8, data: &[u8]| {
        let frame = Frame { address, control: Control(control), data: data.to_vec() };
        deframe(&slave.feed(&frame.encode(Escaping::Minimal), 0))
    };
    assert_eq!(send(7, 0x45, &[0, 0]).len(), 1, "own address");
    assert_eq!(send(0, 0x65, &[0, 0])[0].address, 7, "general address");
    assert_eq!(send(8, 0x45, &[0, 0]), [], "another slave");
    assert_eq!(send(0xFF00, 0x45, &[0, 0]), [], "broadcast to a class");
    assert_eq!(send(0xFFFF, 0x45, &[0, 0]), [], "broadcast");
    assert_eq!(send(7, 0x85, &[0, 0x13]), [], "another slave's answer");
    assert_eq!(send(7, 0x05, &[0, 0]), [], "no answer wanted");
    // Undefined and slave-only data link commands get DL_ERROR with the same sequence bit.
    for (control, answer) in [(0x49, 0x88), (0x42, 0x88), (0x66, 0xA8), (0x48, 0x88)] {
        assert_eq!(send(7, control, &[])[0].control, Control(answer), "{control:02x}");
    }
    assert_eq!(send(7, 0x41, &[])[0].control, Control(0x86), "disconnect");
}

#[test]
fn a_damaged_request_gets_no_answer() {
    let mut slave = Slave::new(1, 1, 1.0);
    let good = Frame { address: 1, control: Control(0x45), data: vec![0x40, 0x9C] };
    let mut bytes = good.encode(Escaping::Minimal);
    let last = bytes.len() - 1;
    bytes[last] ^= 0x40;
    assert!(slave.feed(&bytes, 0).is_empty());
    assert_eq!(deframe(&slave.feed(&good.encode(Escaping::Minimal), 0)).len(), 1);
}

#[test]
fn connect_with_data_1_asks_for_escaped_control_characters() {
    let mut slave = Slave::new(1, 1, 1.0);
    let mut connect = |escape: u8| {
        let frame = Frame { address: 0, control: Control(0x40), data: vec![escape] };
        slave.feed(&frame.encode(Escaping::Full), 0)
    };
    assert_eq!(connect(0), [0x7E, 0x00, 0x01, 0x86, 0x01, 0xFF, 0x17, 0xB0], "as printed");
    assert_eq!(connect(1)[..3], [0x7E, 0x7D, 0x20]);
}

#[test]
fn an_alarm_sets_the_status_bit_until_it_is_read() {
    let mut slave = Slave::new(1, 3, 1.0);
    let minute = 60 * SECOND;
    let raised = (1..20_000).find(|i| read(&mut slave, 0x407E, i * minute)[0] != 0);
    let now = raised.expect("no alarm in two weeks") * minute;
    assert_eq!(read(&mut slave, 0x407E, now)[0], status::ALARM_BIT);
    let list = read(&mut slave, 0x414B, now);
    assert_eq!(list[0], 0, "cleared by reading the list");
    assert!(list[1..].iter().any(|level| (1..=4).contains(level)), "{list:02X?}");
    assert_eq!(read(&mut slave, 0x407E, now)[0], 0);
}

/// Fails unless everything measurable is within what such a plant can show.
fn check_ranges(plant: &Plant, context: &str) {
    let rectifier = plant.rectifier(0).expect("no rectifier");
    let ranges = [
        ("bus V", plant.bus_voltage(), 44.0, 57.2),
        ("load A", plant.load_current(), 45.0, 150.0),
        ("battery A", plant.battery().current(), -140.0, 40.5),
        ("soc", plant.battery().soc(), 0.25, 1.0),
        ("battery °C", plant.battery().temperature(), 15.0, 40.0),
        ("rectifiers A", plant.rectifier_current(), 0.0, 195.0),
        ("rectifier A", rectifier.current(), 0.0, 51.5),
        ("rectifier °C", rectifier.temperature(), 20.0, 70.0),
        ("cell V", plant.cell_voltage(3), 1.8, 2.42),
        ("load %", plant.power_percent(), 0.0, 100.0),
        ("average W", plant.average_power(), 0.0, 9900.0),
        ("room °C", plant.ambient(), 15.0, 35.0),
    ];
    for (name, value, low, high) in ranges {
        assert!((low..=high).contains(&value), "{name} is {value} {context}");
    }
    let phase = plant.phase(1);
    assert!(phase == 0.0 || (190.0..250.0).contains(&phase), "phase is {phase} {context}");
    let sum: f64 = (0..RECTIFIERS)
        .filter_map(|i| plant.rectifier(i))
        .map(super::rectifier::Rectifier::current)
        .sum();
    assert!((sum - plant.rectifier_current()).abs() < 0.06 * sum + 0.01, "{sum} A {context}");
    let battery = plant.rectifier_current() - plant.load_current();
    assert!((battery - plant.battery().current()).abs() < 1e-9, "currents {context}");
}

#[test]
fn ten_days_of_twenty_seeds_stay_within_what_a_plant_can_show() {
    let mut outages = 0;
    for seed in 0..20 {
        let mut plant = Plant::new(seed);
        for minute in 0..10 * 1440 {
            plant.advance(60.0);
            check_ranges(&plant, &format!("in minute {minute} of seed {seed}"));
            outages += u32::from(plant.phase(0) == 0.0);
        }
    }
    assert!(outages > 1000, "the mains failed for {outages} minutes only");
}

/// Everything said in ten minutes, as one stream of bytes of both directions, through the
/// decoder that users have.
#[test]
fn ten_minutes_bring_every_command_read_and_set_and_all_of_it_decodes() {
    let protocol = Protocol::built_in("zhongheng-09", Settings::default()).unwrap().unwrap();
    let names: BTreeMap<String, bool> = protocol
        .commands
        .iter()
        .map(|c| (c.name.to_string(), c.operations.iter().any(|o| o == "set")))
        .collect();
    let mut decoder = Decoder::new(Arc::new(protocol));
    let mut items: Vec<Item> = Vec::new();
    for (time, request, answer) in dialogue(13, DAY_A_MINUTE, 600) {
        for (way, frame) in [(Direction::Tx, request), (Direction::Rx, answer)] {
            let bytes = frame.encode(Escaping::Minimal);
            decoder.feed(way, Timestamp(time), &bytes, &mut |item| items.push(item));
        }
    }
    let (mut read, mut set) = (BTreeSet::new(), BTreeSet::new());
    let mut values: BTreeMap<String, BTreeSet<u64>> = BTreeMap::new();
    for item in &items {
        let item = json::item(item);
        let (message, what) = (&item["message"], item.to_string());
        assert!(item["item"] == "frame" && item["link_error"].is_null(), "{what}");
        assert!(message["kind"] != "malformed" && message["paired"] != false, "{what}");
        if message["kind"] != "request" && message["kind"] != "response" {
            continue;
        }
        assert_eq!(message["check"], "exact", "{what}");
        let name = message["cmd"].as_str().expect("a known command").to_string();
        if message["kind"] == "response" {
            assert_eq!(message["status"]["code"], 0, "{what}");
            let seen = if message["op"] == "set" { &mut set } else { &mut read };
            seen.insert(name.clone());
        }
        for field in message["fields"].as_array().into_iter().flatten() {
            // A field with a table of values has one of them, and of flags only known ones.
            assert!(field.get("label").is_none_or(|label| !label.is_null()), "{field} in {name}");
            assert!(field.get("unknown_flags").is_none_or(|f| f == 0), "{field} in {name}");
            let number = field["value"].as_f64().map_or(0, f64::to_bits);
            let key = format!("{name}.{}", field["name"].as_str().unwrap_or_default());
            values.entry(key).or_default().insert(number);
        }
    }
    assert_eq!(read, names.keys().cloned().collect());
    let settable = names.iter().filter(|(_, settable)| **settable).map(|(name, _)| name.clone());
    assert_eq!(set, settable.collect());
    for field in ["system_analogs.bus_voltage", "rectifier_data.output_current"] {
        assert!(values[field].len() > 100, "{field} does not move");
    }
    assert!(values["real_time.real_time"].len() > 5);
}

#[test]
fn a_repeated_request_is_answered_alike_and_not_carried_out_again() {
    let mut slave = Slave::new(1, 4, DAY_A_MINUTE);
    let mut send = |control: u8, now: u64| {
        let frame = Frame { address: 1, control: Control(control), data: vec![0x40, 0x7E] };
        slave.feed(&frame.encode(Escaping::Minimal), now)
    };
    let first = send(0x45, SECOND);
    assert_eq!(send(0x45, 3 * SECOND / 2), first, "the same sequence bit, soon after");
    let toggled = send(0x65, 3 * SECOND / 2 + 1);
    assert_ne!(toggled[3..], first[3..], "the other sequence bit asks for new values");
    let later = send(0x65, 4 * SECOND);
    assert_ne!(later, toggled, "a master that never toggles gets new values too");
}

#[test]
fn a_broadcast_is_obeyed_without_an_answer() {
    let mut slave = Slave::new(7, 1, 1.0);
    let frame = Frame { address: 0xFFFF, control: Control(0x45), data: vec![0x82, 0x8C, 0x15] };
    assert!(slave.feed(&frame.encode(Escaping::Minimal), 0).is_empty());
    let ask = Frame { address: 7, control: Control(0x65), data: vec![0x02, 0x8C] };
    let answer = deframe(&slave.feed(&ask.encode(Escaping::Minimal), 0));
    assert_eq!(answer[0].data, [0, 0x15]);
}

/// The items that a decoder finds in an answer with a fault.
fn faulty(fault: &str) -> (Vec<serde_json::Value>, Vec<u8>) {
    let faults = Rates::parse(FAULTS, &format!("{fault}=1")).unwrap();
    let mut slave = Slave::new(1, 1, 1.0).with_faults(faults);
    let request = Frame { address: 1, control: Control(0x45), data: vec![0x82, 0x8C, 0x15] };
    let request = request.encode(Escaping::Minimal);
    let answer = slave.feed(&request, 0);
    let protocol = Protocol::built_in("zhongheng-09", Settings::default()).unwrap().unwrap();
    let mut decoder = Decoder::new(Arc::new(protocol));
    let mut items = Vec::new();
    let mut take = |item: Item| items.push(json::item(&item));
    decoder.feed(Direction::Tx, Timestamp(0), &request, &mut take);
    decoder.feed(Direction::Rx, Timestamp(1), &answer, &mut take);
    decoder.finish(&mut take);
    items.remove(0);
    (items, slave.settings.get(&0x028C).cloned().unwrap_or_default())
}

#[test]
fn each_fault_of_an_answer_does_what_it_is_called() {
    let kinds = |fault| -> Vec<String> {
        let (items, _) = faulty(fault);
        items.iter().map(|item| item["item"].as_str().unwrap_or("").to_string()).collect()
    };
    assert_eq!(kinds("bad-crc"), ["crc_error"]);
    assert_eq!(kinds("no-answer"), [""; 0]);
    assert_eq!(kinds("garbage"), ["garbage", "frame"]);
    let wrong = kinds("wrong-length");
    assert!(wrong == ["incomplete"] || wrong == ["crc_error", "garbage"], "{wrong:?}");
    let message = |fault| faulty(fault).0[0]["message"].clone();
    assert_eq!(message("link-error")["name"], "DL_ERROR");
    assert_eq!(message("wrong-sequence")["reason"], "sequence");
    assert_eq!(message("wrong-address")["reason"], "no_request");
    assert_eq!(message("busy")["status"]["name"], "SLAVE_BUSY_R");
    assert_eq!(message("late")["paired"], true);
    for (fault, done) in
        [("no-answer", true), ("bad-crc", true), ("busy", false), ("link-error", false)]
    {
        assert_eq!(faulty(fault).1 == [0x15], done, "{fault}");
    }
}
