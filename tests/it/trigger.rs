//! Triggers: what fires, what it does, and what is refused before anything is recorded.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use bustape::decode::dbc;
use bustape::decode::definition::CanDefinition;
use bustape::frame::{
    CanFlags, CanFrame, Direction, Frame, Gap, GapReason, SerialBytes, Stamped, Timestamp, Unit,
};
use bustape::protocol::{Protocol, Settings};
use bustape::trigger::{Fired, Known, TriggerForm, Triggers};

use crate::support::mcap::{self, Mcap};
use crate::support::messages;
use crate::support::process::{BUSTAPE, Ran, Running, args, spawn};
use crate::support::terminal::open;
use crate::support::until;

const SECOND: u64 = 1_000_000_000;
const DBC: &str = "BU_: a\nBO_ 16 BAT: 2 a\n SG_ soc : 0|8@1+ (0.5,0) [0|0] \"%\" a\n \
                   SG_ mode M : 8|8@1+ (1,0) [0|0] \"\" a\nBO_ 17 WARN: 1 a\n \
                   SG_ ac_fail : 0|1@1+ (1,0) [0|0] \"\" a\n";

fn form(text: &str) -> TriggerForm {
    toml::from_str(text).unwrap()
}

fn triggers(forms: &[&str]) -> Result<Triggers, String> {
    let database = dbc::parse(DBC.as_bytes()).unwrap().database;
    let definition = CanDefinition::of_database("plant", database, false);
    let forms: Vec<_> = forms.iter().map(|text| form(text)).collect();
    let protocol = Protocol::built_in("zhongheng-09", Settings::default()).unwrap().unwrap();
    let buses = vec![
        ("can".to_owned(), Some(Known::Can(Arc::new(definition)))),
        ("line".to_owned(), None),
        ("rectifier".to_owned(), Some(Known::Serial(Arc::new(protocol)))),
    ];
    Triggers::new(&forms, buses)
}

fn can(second: u64, id: u32, data: &[u8]) -> Stamped<Frame> {
    let frame = CanFrame::new(id, CanFlags::default(), data);
    Stamped { time: Timestamp(second * SECOND), value: Frame::Can(frame) }
}

/// The times, in seconds, at which a trigger fires.
fn fires(form: &str, frames: &[(usize, Stamped<Frame>)]) -> Vec<u64> {
    let mut triggers = triggers(&[form]).unwrap();
    let mut fired = Vec::new();
    triggers.begin(Timestamp(0));
    for (bus, frame) in frames {
        triggers.pass(frame.time, &mut fired);
        triggers.take(*bus, frame, &mut fired);
    }
    fired.iter().map(|fired: &Fired| fired.time.nanos() / SECOND).collect()
}

fn soc(values: &[u8]) -> Vec<(usize, Stamped<Frame>)> {
    let frames = (1..).zip(values).map(|(second, soc)| (0, can(second, 16, &[2 * soc, 0])));
    frames.collect()
}

#[test]
fn a_comparison_fires_when_it_becomes_true_and_again_only_after_it_was_false() {
    let values = soc(&[30, 19, 18, 22, 19, 26, 19]);
    assert_eq!(fires("when = \"BAT.soc < 20\"", &values), [2, 5, 7]);
    // With hysteresis 22 is not enough.
    let form = "when = \"can: BAT.soc < 20\"\nuntil = \"BAT.soc > 25\"";
    assert_eq!(fires(form, &values), [2, 7]);
    let form = "when = \"BAT.soc < 20\"\nhold-off = \"4s\"";
    assert_eq!(fires(form, &values), [2, 7]);
    assert_eq!(fires("when = \"BAT.soc == 18\"", &values), [3]);
    // Physical values: 0.5 a bit.
    assert_eq!(fires("when = \"BAT.soc >= 26\"", &values), [1, 6]);
}

#[test]
fn a_signal_that_is_not_in_the_frame_says_nothing() {
    let frames = [(0, can(1, 16, &[10, 0])), (0, can(2, 16, &[])), (0, can(3, 16, &[10, 0]))];
    assert_eq!(fires("when = \"BAT.soc < 20\"", &frames), [1]);
}

#[test]
fn messages_gaps_error_frames_and_silence_fire() {
    let gap = Gap {
        count: 3,
        unit: Unit::Frames,
        reason: GapReason::KernelQueue,
        from: Timestamp(0),
        to: Timestamp(4 * SECOND),
    };
    let serial = SerialBytes { direction: Direction::Rx, data: vec![1], errors: Vec::new() };
    let frames = [
        (0, can(1, 17, &[1])),
        (0, can(2, 17, &[1])),
        (
            0,
            Stamped {
                time: Timestamp(3 * SECOND),
                value: Frame::Can(CanFrame::new(4, CanFlags::ERROR, &[0; 8])),
            },
        ),
        (0, Stamped { time: Timestamp(4 * SECOND), value: Frame::Gap(gap) }),
        (1, Stamped { time: Timestamp(5 * SECOND), value: Frame::Serial(serial) }),
        (0, can(9, 16, &[0, 0])),
        (0, can(10, 17, &[0])),
        (0, can(11, 16, &[0, 0])),
    ];
    assert_eq!(fires("when = \"WARN\"", &frames), [1, 2, 10]);
    assert_eq!(fires("when = \"WARN\"\nhold-off = \"5s\"", &frames), [1, 10]);
    assert_eq!(fires("when = \"WARN.ac_fail == 1\"", &frames), [1]);
    assert_eq!(fires("when = \"error frame\"", &frames), [3]);
    assert_eq!(fires("when = \"gap\"", &frames), [4]);
    assert_eq!(fires("when = \"line: gap\"", &frames), [0; 0]);
    // Fired as soon as somebody looks after the time is over; once for each silence.
    assert_eq!(fires("when = \"no WARN for 3s\"", &frames), [5]);
    assert_eq!(fires("when = \"line: no frames for 4s\"", &frames), [4, 9]);
    assert_eq!(fires("when = \"no frames for 4s\"", &frames), [9]);
}

#[test]
fn what_nobody_could_ever_see_is_refused_with_a_suggestion() {
    for (form, sentence) in [
        ("when = \"BAT.sock < 20\"", "BAT has no signal sock; did you mean soc?"),
        ("when = \"BAD.soc < 20\"", "there is no message BAD; did you mean BAT?"),
        ("when = \"cam: gap\"", "there is no bus cam; did you mean can?"),
        ("when = \"line: BAT\"", "nobody knows the message BAT"),
        (
            "when = \"rectifier: warn_infor.ac_fial == 1\"",
            "warn_infor has no signal ac_fial; did you mean ac_fail?",
        ),
        ("when = \"warn_info\"", "there is no message warn_info; did you mean warn_infor?"),
        ("when = \"error frame stuf\"", "there is no class of error frames stuf; there are "),
        ("when = \"BAT.soc\"", "is not a condition: write MESSAGE.SIGNAL < NUMBER"),
        ("when = \"no BAT for soon\"", "is not a duration"),
        ("when = \"gap\"\nuntil = \"gap\"", "until has to be a message"),
        ("when = \"no BAT for 1s\"\nuntil = \"BAT\"", "it has no until"),
        ("when = \"gap\"\nhold-off = \"x\"", "is not a duration"),
        ("name = \"low\"\nwhen = \"BAT.x < 1\"", "trigger low: BAT has no signal x"),
    ] {
        let Err(error) = triggers(&[form]) else { panic!("{form} was taken") };
        assert!(error.contains(sentence), "{form}: {error}");
    }
}

fn recorder(folder: &Path, text: &str) -> Running {
    let file = folder.join("plant.toml");
    std::fs::write(&file, text).unwrap();
    let mut command = Command::new(BUSTAPE);
    command.args(args(&[&"record", &"--config", &file])).env("RUNTIME_DIRECTORY", folder);
    spawn(command)
}

fn events(file: &Mcap) -> Vec<(u64, serde_json::Value)> {
    let all = messages::decoded(file).filter(|(m, _)| file.topic(m) == "/bustape/event");
    all.map(|(message, event)| (message.time, messages::as_python(&event))).collect()
}

fn configuration(folder: &Path, triggers: &str) -> (PathBuf, String) {
    let out = folder.join("a.mcap");
    let head = format!(
        "bus = [\"station=sim:hmi-can\"]\ndecode = [\"station=hmi-can\"]\noutput = \"{}\"\n",
        out.display()
    );
    (out, head + triggers)
}

#[test]
fn a_trigger_marks_the_recording_at_the_frame_s_own_time_and_runs_a_command() {
    let folder = tempfile::tempdir().unwrap();
    let said = folder.path().join("said");
    let (out, text) = configuration(
        folder.path(),
        &format!(
            "[[trigger]]\nname = \"charged\"\nwhen = \"station: BATMON_3.soc > 0\"\n\
             run = [\"sh\", \"-c\", \"echo $BUSTAPE_TRIGGER $BUSTAPE_BUS $BUSTAPE_VALUE > {0}.new; \
             mv {0}.new {0}\"]\n",
            said.display()
        ),
    );
    let running = recorder(folder.path(), &text);
    let words = until("the command", || std::fs::read_to_string(&said).ok());
    running.stop().expect(0);
    let file = mcap::finished(&out);
    let events = events(&file);
    assert_eq!(events.len(), 1);
    let (time, event) = &events[0];
    assert_eq!(event["event_type"]["name"], "charged");
    let property = |index: usize| event["event_properties"][index]["value"].as_str().unwrap();
    assert_eq!(property(0), "station: BATMON_3.soc > 0");
    assert_eq!(words, format!("charged station {}\n", property(2)));
    // It is the very frame: the first of its kind.
    let first = file.messages.iter().find(|message| file.topic(message) == "/station/BATMON_3");
    assert_eq!(first.unwrap().time, *time);
    // And the file says what was waited for.
    let attached = file.attachments.iter().find(|a| a.name == "bustape.toml").unwrap();
    let attached: toml::Table = std::str::from_utf8(&attached.data).unwrap().parse().unwrap();
    assert_eq!(attached["trigger"][0]["name"].as_str(), Some("charged"));
}

#[test]
fn a_trigger_set_off_by_the_last_mark_is_in_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let (out, text) =
        configuration(folder.path(), "[[trigger]]\nname = \"marked\"\nwhen = \"mark\"\n");
    let running = recorder(folder.path(), &format!("chunk-time = \"60s\"\n{text}"));
    until("the recorder's ear", || {
        let mut command = Command::new(BUSTAPE);
        command.args(["mark", "the last"]).env("RUNTIME_DIRECTORY", folder.path());
        spawn(command).wait().status.success().then_some(())
    });
    running.stop().expect(0);
    let names: Vec<_> = events(&mcap::finished(&out))
        .iter()
        .map(|(_, event)| event["event_type"]["name"].as_str().unwrap().to_owned())
        .collect();
    assert!(names.iter().any(|name| name == "marked"), "{names:?}");
}

#[test]
fn commands_of_serial_lines_and_messages_of_several_frames_can_be_named() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("a.mcap");
    let text = format!(
        "bus = [\"station=sim:hmi-can\", \"rect=sim:zhongheng-09\"]\n\
         decode = [\"station=hmi-can\", \"rect=zhongheng-09\"]\noutput = \"{}\"\n\
         [[trigger]]\nname = \"answer\"\nwhen = \"rect: warn_infor.ac_fail >= 0\"\n\
         [[trigger]]\nname = \"request\"\nwhen = \"warn_infor_request\"\nhold-off = \"1h\"\n\
         [[trigger]]\nname = \"never\"\nwhen = \"warn_infor.ac_fail > 255\"\n",
        out.display()
    );
    let running = recorder(folder.path(), &text);
    let part = out.with_extension("mcap.part");
    until("both events", || {
        let file = mcap::parse(&std::fs::read(&part).ok()?, false).ok()?;
        (events(&file).len() >= 2).then_some(())
    });
    running.stop().expect(0);
    let file = mcap::finished(&out);
    for (time, event) in events(&file) {
        let name = event["event_type"]["name"].as_str().unwrap();
        let topic = match name {
            "answer" => "/rect/warn_infor_response",
            "request" => "/rect/warn_infor_request",
            other => panic!("{other} has fired"),
        };
        // It is the first of its kind, and an answer is with its value.
        assert_eq!(file.on(topic).next().unwrap().time, time, "{topic}");
    }
}

#[test]
fn commands_cannot_hold_up_the_end_and_failures_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let (out, text) = configuration(
        folder.path(),
        "count = 300\n[[trigger]]\nwhen = \"BATMON_3.soc > 0\"\nrun = [\"sleep\", \"1000\"]\n\
         [[trigger]]\nwhen = \"BATMON_2\"\nrun = [\"/no/such/program\"]\n",
    );
    let ran: Ran = recorder(folder.path(), &text).wait().expect(0);
    assert!(ran.err.contains("cannot run /no/such/program for trigger BATMON_2"), "{}", ran.err);
    assert!(events(&mcap::finished(&out)).len() > 1);
}

#[test]
fn a_silence_is_noticed_while_nothing_happens() {
    let folder = tempfile::tempdir().unwrap();
    let (out, tty) = (folder.path().join("a.mcap"), folder.path().join("tty"));
    let text = format!(
        "bus = [\"line=pty:{}\"]\noutput = \"{}\"\n[[trigger]]\nwhen = \"line: no frames for 300ms\"\n\
         run = [\"touch\", \"{}/silent\"]\n",
        tty.display(),
        out.display(),
        folder.path().display()
    );
    let running = recorder(folder.path(), &text);
    let mut line = until("the line", || tty.exists().then(|| open(&tty)));
    line.write_all(b"hello").unwrap();
    until("the command", || folder.path().join("silent").exists().then_some(()));
    running.stop().expect(0);
    let file = mcap::finished(&out);
    let events = events(&file);
    assert!(!events.is_empty());
    let heard = messages::raw(&file, "line").last().unwrap().0;
    let (time, _) = events.last().unwrap();
    assert!(time - heard >= 300_000_000, "{} ns after the last byte", time - heard);
}

#[test]
fn a_wrong_trigger_is_refused_before_a_file_is_made() {
    let folder = tempfile::tempdir().unwrap();
    for (trigger, sentence) in [
        ("[[trigger]]\nwhen = \"BATMON_3.sock < 20\"\n", "did you mean soc?"),
        ("[[trigger]]\nwhem = \"gap\"\n", "line 5: a trigger has no whem; did you mean \"when\"?"),
        ("[[trigger]]\nname = \"x\"\n", "line 4: missing field `when`"),
        ("trigger = 3\n", "line 4: invalid type"),
    ] {
        let (out, text) = configuration(folder.path(), trigger);
        let ran = recorder(folder.path(), &text).wait().expect(2);
        assert!(ran.err.contains(sentence), "{trigger}: {}", ran.err);
        assert!(!out.exists() && !out.with_extension("mcap.part").exists());
    }
}
