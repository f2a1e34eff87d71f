//! BLF as python-can writes and reads it, and as bustape does.

use std::fmt::Write as _;
use std::fs::File;
use std::path::Path;

use bustape::export::{BusHead, FrameWriter};
use bustape::frame::{CanFlags, Frame, Stamped, Timestamp};
use bustape::import::{LogFrame, LogReader};

use super::support::peers::python;
use super::support::process::spawn;

/// Runs the Python script with these words; what it printed.
pub fn peer(words: &[&str], file: &Path) -> String {
    let mut command = python("binary_logs.py");
    command.args(words).arg(file);
    let ran = spawn(command).wait().expect(0);
    ran.out
}

/// All frames of a log, and how many things in it could not be taken.
pub fn all(mut log: impl LogReader) -> (Vec<LogFrame>, Vec<String>, u64) {
    let mut frames = Vec::new();
    while log.read(&mut frames).expect("a log that can be read") {}
    (frames, log.buses().to_vec(), log.skipped().count)
}

/// Frames as the script prints them.
pub fn printed((frames, buses, skipped): &(Vec<LogFrame>, Vec<String>, u64)) -> String {
    assert_eq!(*skipped, 0, "nothing is skipped");
    let mut text = String::new();
    for LogFrame { bus, frame } in frames {
        let Frame::Can(can) = &frame.value else { panic!("{frame:?}") };
        let letters = [
            (CanFlags::EXTENDED, 'x'),
            (CanFlags::REMOTE, 'r'),
            (CanFlags::ERROR, 'e'),
            (CanFlags::FD, 'f'),
            (CanFlags::BRS, 'b'),
            (CanFlags::ESI, 's'),
            (CanFlags::TX, 't'),
        ];
        let flags: String =
            letters.iter().filter(|(f, _)| can.flags.has(*f)).map(|l| l.1).collect();
        let dlc = if can.flags.has(CanFlags::REMOTE) { can.dlc.to_string() } else { String::new() };
        let data: String = can.data().iter().map(|byte| format!("{byte:02x}")).collect();
        let (time, bus) = ((frame.time.nanos() + 500) / 1000, &buses[usize::from(*bus)]);
        writeln!(text, "{time} {bus} {:x} {flags} {dlc} {data}", can.id).unwrap();
    }
    text
}

/// Writes frames with bustape.
pub fn written<W: FrameWriter>(
    log: &(Vec<LogFrame>, Vec<String>, u64),
    create: impl FnOnce(&[BusHead]) -> std::io::Result<W>,
) {
    let head = |name: &String| BusHead { name: name.clone(), bitrate: None };
    let buses: Vec<BusHead> = log.1.iter().map(head).collect();
    let mut writer = create(&buses).unwrap();
    for LogFrame { bus, frame } in &log.0 {
        writer.write(*bus, frame).unwrap();
    }
    writer.finish().unwrap();
    assert!(writer.unkept().is_empty(), "{:?}", writer.unkept());
}

/// The same frames 1000 times, one after the other.
pub fn many(log: &(Vec<LogFrame>, Vec<String>, u64)) -> (Vec<LogFrame>, Vec<String>, u64) {
    let (frames, buses, _) = log;
    let times = 0..1000_u64;
    let shifted = |n: u64| {
        frames.iter().map(move |log| {
            let frame = &log.frame;
            let time = Timestamp(frame.time.nanos() + n * 1_000_000_000);
            LogFrame { bus: log.bus, frame: Stamped { time, value: frame.value.clone() } }
        })
    };
    (times.flat_map(shifted).collect(), buses.clone(), 0)
}

fn open(path: &Path) -> impl LogReader {
    bustape::import::blf::open(File::open(path).unwrap()).unwrap()
}

#[test]
fn what_python_can_writes_is_read_frame_for_frame() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("theirs.blf");
    peer(&["write"], &path);
    assert_eq!(printed(&all(open(&path))), peer(&["read"], &path));
}

#[test]
fn python_can_reads_what_bustape_writes_frame_for_frame() {
    let dir = tempfile::tempdir().unwrap();
    let (theirs, ours) = (dir.path().join("theirs.blf"), dir.path().join("ours.blf"));
    peer(&["write"], &theirs);
    let log = all(open(&theirs));
    written(&log, |buses| {
        bustape::export::frames::blf::create(File::create(&ours).unwrap(), buses)
    });
    assert_eq!(peer(&["read"], &ours), printed(&log));
    assert_eq!(all(open(&ours)), log);
    // Several containers.
    let log = many(&log);
    written(&log, |buses| {
        bustape::export::frames::blf::create(File::create(&ours).unwrap(), buses)
    });
    assert_eq!(all(open(&ours)), log);
    assert_eq!(peer(&["count"], &ours), format!("{}\n", log.0.len()));
}
